"""`flexopt map`, `flexopt report`, `flexopt reproduce` and `flexopt doctor`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from flexopt.cli.common import (
    CONTROL,
    FAILED,
    GAIN,
    GRAVITY,
    JSON,
    PDF,
    announce,
    check_folder,
    check_pdf,
    check_sheet,
    given,
    handing_out,
    numbers,
    of_picture,
    of_sheet,
    option,
    placement,
    ranges_table,
    read,
    table,
    tell,
    value,
    whole,
    wholes,
    working,
    write_output,
)
from flexopt.cli.completing import argument
from flexopt.cli.judging import LOOP, asked_problem, judged, of_machine, real_loop
from flexopt.cli.postures import elbow_faults
from flexopt.cli.simulation import loop_options
from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.escapes import of_option_list
from flexopt.model import load, load_experiment
from flexopt.model.choices import ELBOWS

# Options of the closed loops that a report has.
LOOPS = ("kp", "kv", "duration", "rate", "offset", "integrator")
REPORT_FOLDER, PROBLEM_FOLDER = "flexopt-reproduce", "flexopt-report"


@click.command("map", short_help="Measures over end-points, two joints or placements.")
@argument("machine")
@value(
    "--points",
    "N,M",
    "Points along x and y (400,400; 60,60 in space and with four passive ones or more).",
    wholes,
)
@CONTROL
@GAIN
@GRAVITY
@option(
    "--elbow", metavar="|".join(ELBOWS), help="Which posture of a two-joint arm reaches an end-point (up by default)."
)
@value("--over", "end_point|posture|base", "What varies: end-point (default), two joints or placement.")
@value("--joints", "A,B", "With --over posture: the two that vary (the first two by default).", of_option_list)
@value(
    "--rows", "R,S", "With --over end_point: the two task rows that vary (the first two by default).", of_option_list
)
@value("--coordinates", "X,Y", "With --over base: the two of the placement that vary (the first two).", of_option_list)
@value(
    "--posture",
    "A,…",
    "With --over posture: the joints that do not vary, rad (slides: m). Else, but for two-joint planar arms: all "
    "joints, the posture that is followed from point to point.",
    numbers,
)
@value("--end-point", "X,Y,…", "With --over base: where it is held; else its rows that do not vary, m.", numbers)
@value("--base", "X[,Y,YAW]", "Placement where following starts, and of what does not vary, m and rad.", placement)
@LOOP
@value(
    "--vary",
    "NAME=LO,HI",
    "Twice: a map of the loop in --posture over two of kp, kv, ki, dead_time (s), stiffness, damping (factors) and the "
    "machine's parameters, the first along x.",
    multiple=True,
)
@value("--x-range", "LO,HI", "Of the first that varies, m or rad; all of it by default.", numbers)
@value("--y-range", "LO,HI", "Of the second that varies, m or rad; all of it by default.", numbers)
@value("--out", "FILE.nc", "Write the map to a netCDF file.")
@of_picture("Draw the map: .png, .svg or .pdf.")
@JSON
def map_command(as_json: bool, machine: str, **options: Any) -> None:
    """Frequencies, w_i, in-phase regions and ε_max of MACHINE over end-points, two joints or its placement.

    With --loop how fast its controller's loop decays, too; with --vary that alone, over gains, dead time or soil.

    End-points of a planar arm of two joints are, without --posture, in the workspace frame, which has the axes of the
    inertial one and its origin at the first joint at rest; all others in the inertial frame. With --gravity they are
    those of the machine as it sags.
    """
    from flexopt.study import map_loop, map_workspace  # noqa: PLC0415  (only this command needs them)

    hand_out = handing_out(options, ".nc", as_json=as_json)
    loaded = read(load, machine)
    elbow, others = options["elbow"], options["over"] not in (None, "end_point")
    if elbow is not None and (others or elbow_faults(loaded, options, options["posture"])):
        sentence = "goes with end-points of planar arms, without --posture"
        raise_if_any(InputError, "map", [Fault("--elbow", sentence, elbow)])
    vary, options["loop"] = options.pop("vary"), real_loop(loaded.loop, options["loop"])
    with working(options, as_json, "loops" if vary else "postures") as progress:
        if vary:
            result = map_loop(loaded, **_of_loop(given(options), vary), progress=progress)
        else:
            result = map_workspace(loaded, progress=progress, **given(options))
    hand_out(result)


def _of_loop(options: dict[str, Any], vary: tuple[str, ...]) -> dict[str, Any]:
    """What a map of the loop takes; other options are faults."""
    takes = ("posture", "base", "control", "gravity", "loop", "points")
    faults = [Fault(f"--{name.replace('_', '-')}", "does not go with --vary") for name in options if name not in takes]
    if "posture" not in options:
        faults.append(Fault("--posture", "is required with --vary: the posture that the loop is looked at in"))
    raise_if_any(InputError, "map", faults)
    return options | {"vary": table("--vary", vary)}


@click.command("reproduce", short_help="The article computed again and checked.")
@value("--out", "DIR", "Folder of report.html and report.json (flexopt-reproduce by default).")
@value("--figures", "pdf|svg|png", "Each figure as a file of its own in that folder, too.")
@of_sheet("--figures")
@JSON
def reproduce_command(as_json: bool, out: str | None, figures: str | None, **options: Any) -> None:
    """The article computed again: Table 2, Figs. 5 to 12, mean frequencies, its claims and contradictions.

    Writes one HTML report and one JSON file into a folder, which is made if it is missing; with --figures each figure
    as a file of its own, too: figure5 to figures11and12, and two that the article does not have: gains (the loop's
    decay over Kp and Kv) and gaps (ν-gap to the rigid plant and ε_max as the damping grows).
    """
    from flexopt.article import reproduce  # noqa: PLC0415  (only this command needs it)
    from flexopt.article.reproduction import FORMS  # noqa: PLC0415

    arguments = Arguments("reproduce")
    form = arguments.choice("--figures", figures or "pdf", FORMS)
    look = check_sheet(arguments, options, "--figures", given=figures is not None)
    arguments.done()

    folder, drawn = out or REPORT_FOLDER, list[Path]()
    check_folder("--out", folder)
    with working({}, as_json, "stages") as progress:
        result = reproduce(progress=progress)
    write_output("--out", folder, lambda: result.write(folder))
    if figures is not None:
        write_output("--out", folder, lambda: drawn.extend(result.write_figures(folder, form=form, **look)))
    figures_told = f"\nfigures: {', '.join(map(str, drawn))}" if drawn else ""
    tell(result, f"{_report_told(folder)}{figures_told}", as_json=as_json)


def _report_told(folder: str, *more: str) -> str:
    """Where a report is."""
    files = [str(Path(folder) / "report.html"), str(Path(folder) / "report.json"), *more]
    return f"\n\nreport: {', '.join(files)}"


@click.command("report", short_help="Everything about a problem on one page.")
@argument("problem")
@of_machine
@value("--experiment", "NAME", "Experiment (name or file) that gives the closed loops' gains and start.")
@loop_options("", *LOOPS)
@judged
@value(
    "--points", "N", "Of the map along each axis (160; 48 in space and with four passive coordinates or more).", whole
)
@value("--out", "DIR", "Folder of report.html and report.json (flexopt-report by default).")
@PDF
@JSON
def report_command(as_json: bool, problem: str, out: str | None, pdf: str | None, **options: Any) -> None:
    """Everything about PROBLEM (a problem file, or a machine with --end-point): verdict, choice, map, closed loops.

    Writes one HTML report and one JSON file into a folder, which is made if it is missing. Where a controller is known
    (a [loop] in the file, or --loop) the page begins with whether it pays to move.
    """
    from flexopt.study import report  # noqa: PLC0415  (only this command needs it)

    folder = out or PROBLEM_FOLDER
    check_folder("--out", folder)
    check_pdf(pdf)
    experiment = None if options["experiment"] is None else read(load_experiment, options["experiment"])
    with working(options, as_json, "percent") as progress:
        asked, own = asked_problem("report", problem, options)
        simulation = given(options, *LOOPS)
        result = report(
            asked, experiment=experiment, simulation=simulation, points=options["points"], progress=progress,
            loop=real_loop(own, options["loop"]), ranges=ranges_table(options["ranges"]),
            **given(options, "members", "runs"),
        )  # fmt: skip
    announce("the pictures are drawn", always=True)
    write_output("--out", folder, lambda: result.write(folder))
    if pdf is not None:
        announce("the page is printed", always=True)
        write_output("--pdf", pdf, lambda: result.to_pdf(pdf))
    tell(result, _report_told(folder, *filter(None, [pdf])), as_json=as_json)


@click.command("doctor", short_help="What this installation can do.")
@JSON
def doctor_command(as_json: bool) -> None:
    """What this installation can do: versions, solver, compiler, shipped machines and problems."""
    from flexopt.study.doctor import examine  # noqa: PLC0415  (only this command needs it)

    report = examine()
    tell(report, as_json=as_json)
    if not report.healthy:
        sys.exit(FAILED)
