"""`flexopt map`, `flexopt reproduce` and `flexopt doctor`."""

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
    PICTURES,
    check_folder,
    check_output,
    number,
    numbers,
    option,
    option_names,
    print_json,
    progress_bar,
    warnings_to_stderr,
    write_file,
)
from flexopt.model import load
from flexopt.model.problem import ELBOWS

REPORT_FOLDER = "flexopt-reproduce"


@click.command("map")
@click.argument("machine")
@option("--points", metavar="N,M", help="Points along x and y (400,400 by default).")
@CONTROL
@GAIN
@GRAVITY
@option("--elbow", metavar="|".join(ELBOWS), help="Which posture reaches an end-point (up by default).")
@option("--over", metavar="end_point|posture", help="Map over end-points (default) or over the first two joints.")
@option("--posture", metavar="C,…", help="With --over posture: the joints from the third on, rad.")
@option("--x-range", metavar="LO,HI", help="Workspace frame, m, or first joint, rad; all of it by default.")
@option("--y-range", metavar="LO,HI", help="Workspace frame, m, or second joint, rad; all of it by default.")
@option("--out", metavar="FILE.nc", help="Write the map to a netCDF file.")
@option("--plot", metavar="FILE.png", help="Draw the map: .png, .svg or .pdf.")
@JSON
def map_command(as_json: bool, machine: str, plot: str | None, out: str | None, **options: Any) -> None:
    """Frequencies, w_i, in-phase regions and ε_max of MACHINE over its workspace.

    The workspace frame has the axes of the inertial one and its origin at the first joint at rest.
    """
    from flexopt.study import map_workspace  # noqa: PLC0415  (only this command needs it)

    check_output("--plot", plot, PICTURES)
    check_output("--out", out, (".nc",))
    loaded = load(machine)
    points = numbers(options["points"])
    given: dict[str, Any] = {
        "points": points and [int(n) if isinstance(n, float) and n.is_integer() else n for n in points],
        "control": options["control"],
        "gain": None if options["gain"] is None else number(options["gain"]),
        "elbow": options["elbow"],
        "over": options["over"],
        "posture": numbers(options["posture"]),
        "x_range": numbers(options["x_range"]),
        "y_range": numbers(options["y_range"]),
    }
    settings = {name: value for name, value in given.items() if value is not None}
    with option_names(options), warnings_to_stderr(as_json), progress_bar("postures") as progress:
        result = map_workspace(loaded, gravity=bool(options["gravity"]), progress=progress, **settings)
    if out is not None:
        write_file("--out", out, lambda: result.to_netcdf(out))
    if plot is not None:
        write_file("--plot", plot, lambda: result.plot(plot))
    if as_json:
        print_json(result.to_dict())
    else:
        click.echo(repr(result))


@click.command("reproduce")
@option("--out", metavar="DIR", help="Folder of report.html and report.json (flexopt-reproduce by default).")
@JSON
def reproduce_command(as_json: bool, out: str | None) -> None:
    """The article computed again: Table 2, Figs. 5 to 12, mean frequencies, its claims and contradictions.

    Writes one HTML report and one JSON file into a folder, which is made if it is missing.
    """
    from flexopt.study import reproduce  # noqa: PLC0415  (only this command needs it)

    folder = out or REPORT_FOLDER
    check_folder("--out", folder)
    with warnings_to_stderr(as_json), progress_bar("stages") as progress:
        result = reproduce(progress=progress)
    write_file("--out", folder, lambda: result.write(folder))
    if as_json:
        print_json(result.to_dict())
    else:
        click.echo(f"{result!r}\n\nreport: {Path(folder) / 'report.html'}, {Path(folder) / 'report.json'}")


@click.command("doctor")
@JSON
def doctor_command(as_json: bool) -> None:
    """What this installation can do: versions, solver, compiler, shipped machines and problems."""
    from flexopt.study.doctor import examine  # noqa: PLC0415  (only this command needs it)

    report = examine()
    if as_json:
        print_json(report.to_dict())
    else:
        click.echo(repr(report))
    if not report.healthy:
        sys.exit(FAILED)
