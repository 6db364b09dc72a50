"""`flexopt map`, `flexopt report`, `flexopt reproduce` and `flexopt doctor`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from flexopt.cli.common import (
    BASE,
    CONTROL,
    FAILED,
    GAIN,
    GRAVITY,
    JSON,
    PICTURES,
    check_folder,
    check_output,
    number,
    numbers,
    option,
    option_names,
    placement,
    print_json,
    progress_bar,
    read,
    say,
    warnings_to_stderr,
    whole,
    write_output,
)
from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.model import Problem, load, load_any, load_experiment
from flexopt.model.choices import ELBOWS
from flexopt.selection import SelectionProblem, build_selection

REPORT_FOLDER, PROBLEM_FOLDER = "flexopt-reproduce", "flexopt-report"


@click.command("map", short_help="Measures over end-points, two joints or placements.")
@click.argument("machine")
@option("--points", metavar="N,M", help="Points along x and y (400,400; 60,60 with four passive coordinates and more).")
@CONTROL
@GAIN
@GRAVITY
@option(
    "--elbow", metavar="|".join(ELBOWS), help="Which posture of a two-joint arm reaches an end-point (up by default)."
)
@option("--over", metavar="end_point|posture|base", help="What varies: end-point (default), two joints or placement.")
@option("--joints", metavar="A,B", help="With --over posture: the two that vary (the first two by default).")
@option("--rows", metavar="R,S", help="With --over end_point: the two task rows that vary (the first two by default).")
@option("--coordinates", metavar="X,Y", help="With --over base: the two of the placement that vary (the first two).")
@option(
    "--posture",
    metavar="A,…",
    help="With --over posture: the joints that do not vary, rad (slides: m). Else, but for two-joint planar arms: all "
    "joints, the posture that is followed from point to point.",
)
@option("--end-point", metavar="X,Y,…", help="With --over base: where it is held; else its rows that do not vary, m.")
@option("--base", metavar="X[,Y,YAW]", help="Placement where following starts, and of what does not vary, m and rad.")
@option("--x-range", metavar="LO,HI", help="Of the first that varies, m or rad; all of it by default.")
@option("--y-range", metavar="LO,HI", help="Of the second that varies, m or rad; all of it by default.")
@option("--out", metavar="FILE.nc", help="Write the map to a netCDF file.")
@option("--plot", metavar="FILE.png", help="Draw the map: .png, .svg or .pdf.")
@JSON
def map_command(as_json: bool, machine: str, plot: str | None, out: str | None, **options: Any) -> None:
    """Frequencies, w_i, in-phase regions and ε_max of MACHINE over end-points, two joints or its placement.

    End-points of a planar arm of two joints are in the workspace frame, which has the axes of the inertial one and its
    origin at the first joint at rest; those of other machines in the inertial frame.
    """
    from flexopt.study import map_workspace  # noqa: PLC0415  (only this command needs it)

    check_output("--plot", plot, PICTURES)
    check_output("--out", out, (".nc",))
    loaded = read(load, machine)
    points = numbers(options["points"])
    given: dict[str, Any] = {
        "points": points and [int(n) if isinstance(n, float) and n.is_integer() else n for n in points],
        "control": options["control"],
        "gain": None if options["gain"] is None else number(options["gain"]),
        "elbow": options["elbow"],
        "over": options["over"],
        "joints": _names(options["joints"]),
        "rows": _names(options["rows"]),
        "coordinates": _names(options["coordinates"]),
        "posture": numbers(options["posture"]),
        "end_point": numbers(options["end_point"]),
        "base": placement(options["base"]),
        "x_range": numbers(options["x_range"]),
        "y_range": numbers(options["y_range"]),
    }
    settings = {name: value for name, value in given.items() if value is not None}
    with option_names(options), warnings_to_stderr(as_json), progress_bar("postures") as progress:
        result = map_workspace(loaded, gravity=bool(options["gravity"]), progress=progress, **settings)
    if out is not None:
        write_output("--out", out, lambda: result.to_netcdf(out))
    if plot is not None:
        write_output("--plot", plot, lambda: result.plot(plot))
    if as_json:
        print_json(result.to_dict())
    else:
        say(repr(result))


def _names(text: str | None) -> list[str] | None:
    return None if text is None else [part.strip() for part in text.split(",")]


@click.command("reproduce", short_help="The article computed again and checked.")
@option("--out", metavar="DIR", help="Folder of report.html and report.json (flexopt-reproduce by default).")
@JSON
def reproduce_command(as_json: bool, out: str | None) -> None:
    """The article computed again: Table 2, Figs. 5 to 12, mean frequencies, its claims and contradictions.

    Writes one HTML report and one JSON file into a folder, which is made if it is missing.
    """
    from flexopt.article import reproduce  # noqa: PLC0415  (only this command needs it)

    folder = out or REPORT_FOLDER
    check_folder("--out", folder)
    with warnings_to_stderr(as_json), progress_bar("stages") as progress:
        result = reproduce(progress=progress)
    write_output("--out", folder, lambda: result.write(folder))
    if as_json:
        print_json(result.to_dict())
    else:
        say(f"{result!r}\n\nreport: {Path(folder) / 'report.html'}, {Path(folder) / 'report.json'}")


@click.command("report", short_help="Everything about a problem on one page.")
@click.argument("problem")
@option("--end-point", metavar="X,Y[,Z]", help="Of a machine: target of the end-point, inertial frame, m.")
@option("--posture", metavar="A,B,…", help="Of a machine: how it is held now, with --base.")
@BASE
@CONTROL
@option("--objective", metavar="w1|w2|…|V|epsilon_max", help="Of a machine: what to maximise (w1 by default).")
@option("--experiment", metavar="NAME", help="Experiment (name or file) that gives the closed loops' gains and start.")
@option("--kp", metavar="KP", help="Gain on the end-point error, one number or one for each axis (1e5 by default).")
@option("--kv", metavar="KV", help="Gain on its rate (2e3 by default).")
@option("--duration", metavar="S", help="Seconds of the closed loops (10 by default).")
@option("--rate", metavar="HZ", help="Their sampling rate (200 by default).")
@option("--offset", metavar="A,B,…", help="Displacement of the joints at the start, rad (slides: m).")
@option("--integrator", metavar="rk4|dop853|gauss", help="Integration method (rk4 by default).")
@option("--points", metavar="N", help="Of the map along each axis (160; 48 with four passive coordinates and more).")
@option("--out", metavar="DIR", help="Folder of report.html and report.json (flexopt-report by default).")
@JSON
def report_command(as_json: bool, problem: str, out: str | None, **options: Any) -> None:
    """Everything about PROBLEM (a problem file, or a machine with --end-point): choice, map, closed loops, gains.

    Writes one HTML report and one JSON file into a folder, which is made if it is missing.
    """
    from flexopt.study import report  # noqa: PLC0415  (only this command needs it)

    folder = out or PROBLEM_FOLDER
    check_folder("--out", folder)
    single = {name: number(options[name]) for name in ("duration", "rate") if options[name] is not None}
    lists = {name: numbers(options[name]) for name in ("kp", "kv", "offset") if options[name] is not None}
    words = {} if options["integrator"] is None else {"integrator": options["integrator"]}
    experiment = None if options["experiment"] is None else read(load_experiment, options["experiment"])
    with option_names(options), warnings_to_stderr(as_json), progress_bar("stages") as progress:
        asked = _problem(problem, options)
        points = whole(options["points"])
        simulation = single | lists | words
        result = report(asked, experiment=experiment, simulation=simulation, points=points, progress=progress)
    write_output("--out", folder, lambda: result.write(folder))
    if as_json:
        print_json(result.to_dict())
    else:
        say(f"{result!r}\n\nreport: {Path(folder) / 'report.html'}, {Path(folder) / 'report.json'}")


def _problem(name: str, options: dict[str, Any]) -> Problem | SelectionProblem:
    """A problem file's problem, or that of a machine with a target."""
    loaded = read(load_any, name)
    own = ("end_point", "posture", "base", "control", "objective")
    if isinstance(loaded, Problem):
        faults = [
            Fault(f"--{word.replace('_', '-')}", "goes with a machine; the problem file brings its own", options[word])
            for word in own
            if options[word] is not None
        ]
        raise_if_any(InputError, "report", faults)
        return loaded
    if options["end_point"] is None:
        raise InputError("report: a machine needs --end-point (m, inertial frame); a problem file brings its own")
    given: dict[str, Any] = {
        "base": placement(options["base"]),
        "posture": numbers(options["posture"]),
        "control": options["control"],
        "objective": options["objective"],
    }
    settings = {word: value for word, value in given.items() if value is not None}
    return build_selection(loaded, numbers(options["end_point"]), **settings)


@click.command("doctor", short_help="What this installation can do.")
@JSON
def doctor_command(as_json: bool) -> None:
    """What this installation can do: versions, solver, compiler, shipped machines and problems."""
    from flexopt.study.doctor import examine  # noqa: PLC0415  (only this command needs it)

    report = examine()
    if as_json:
        print_json(report.to_dict())
    else:
        say(repr(report))
    if not report.healthy:
        sys.exit(FAILED)
