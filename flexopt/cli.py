"""The command line: `flexopt evaluate | select | map | reproduce | doctor`.

In: options as text. Out: a result as text or, with `--json`, one JSON document on standard output; progress and errors
go to standard error. Exit codes: 0 success, 2 bad input, 3 a solve that did not converge or a check that failed.
"""

from __future__ import annotations

import io
import json
import sys
import warnings
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import click

from flexopt.errors import Fault, FlexoptError, FlexoptWarning, InputError, raise_if_any
from flexopt.model import Machine, Problem, load, load_any
from flexopt.model.arguments import Arguments
from flexopt.model.documents import json_ready, package_version
from flexopt.model.problem import CONTROLS, ELBOWS
from flexopt.plant import inverse_kinematics
from flexopt.robustness import evaluate
from flexopt.selection import Selection, select

BAD_INPUT, FAILED = 2, 3
FILE_NAME_MAX = 255
PICTURES = (".png", ".svg", ".pdf")
REPORT_FOLDER = "flexopt-reproduce"

Decorator = Callable[[Callable[..., None]], Callable[..., None]]


def main(arguments: list[str] | None = None) -> None:
    """Entry point of the `flexopt` command."""
    given = sys.argv[1:] if arguments is None else arguments
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # Greek letters on a console that has none
    try:
        cli.main(args=given, prog_name="flexopt", standalone_mode=False)
    except click.exceptions.Exit as leave:
        sys.exit(leave.exit_code)
    except click.Abort:
        sys.exit(130)
    except click.ClickException as error:
        _fail(InputError(error.format_message()), "--json" in given)
    except FlexoptError as error:
        _fail(error, "--json" in given)


def _fail(error: FlexoptError, as_json: bool) -> None:
    click.echo(f"flexopt: {error}", err=True)
    if as_json:
        _print_json({"status": "failed", "converged": False, "error": json_ready(error.to_dict())})
    sys.exit(BAD_INPUT if isinstance(error, InputError) else FAILED)


def _print_json(document: dict[str, Any]) -> None:
    click.echo(json.dumps(document, indent=2, allow_nan=False))


def _option(*names: str, **settings: Any) -> Decorator:
    return cast(Decorator, click.option(*names, **settings))


JSON = _option("--json", "as_json", is_flag=True, help="Print one JSON document.")
CONTROL = _option("--control", metavar="|".join(CONTROLS), help="Jacobian inverse (default) or transpose control.")
GRAVITY = _option("--gravity", is_flag=True, help="Measures under static deflection.")
GAIN = _option("--gain", metavar="KR", help="Servo gain of the margin ε_max (5e5 by default).")
BASE = _option("--base", metavar="X", help="Placement of the base, m; for select, where it stands now.")
END_POINT = _option("--end-point", metavar="X,Y", help="Target of the end-point, inertial frame, m.")
ELBOW = _option("--elbow", metavar="|".join(ELBOWS), help="With --end-point: which branch (up by default).")


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_version("flexopt"), prog_name="flexopt")
def cli() -> None:
    """Configurations of a machine on a compliant base in which end-point feedback does not excite the base."""


@cli.command("evaluate")
@click.argument("machine")
@_option("--posture", metavar="A,B,…", help="Angles of the actuated joints, rad.")
@END_POINT
@ELBOW
@BASE
@CONTROL
@GAIN
@_option("--damped", is_flag=True, help="Measures of the damped plant.")
@GRAVITY
@JSON
def evaluate_command(as_json: bool, machine: str, **options: Any) -> None:
    """Frequencies, measures w_i and gradients of MACHINE (a name or a file) in one posture."""
    loaded = load(machine)
    base = 0.0 if options["base"] is None else _base(options["base"])
    control = options["control"] or "inverse"
    gravity = bool(options["gravity"])
    gain = _number(options["gain"]) if options["gain"] is not None else 5e5
    with _option_names(options), _warnings_to_stderr(as_json):
        angles = _posture(loaded, options, base, gravity)
        result = evaluate(
            loaded, angles, base=base, control=control, gain=gain, damped=bool(options["damped"]), gravity=gravity
        )
    if as_json:
        _print_json(result.to_dict())
    else:
        click.echo(repr(result))


def _posture(machine: Machine, options: dict[str, Any], base: Any, gravity: bool) -> Any:
    """The posture given, or the one that reaches the end-point given."""
    posture, end_point = _numbers(options["posture"]), _numbers(options["end_point"])
    faults: list[Fault] = []
    if (posture is None) == (end_point is None):
        faults.append(Fault("--posture, --end-point", "give one of the two"))
    if posture is not None and options["elbow"] is not None:
        faults.append(Fault("--elbow", "goes with --end-point only", options["elbow"]))
    joints = machine.joints
    if end_point is not None and len(joints) > 2:
        sentence = f"does not name one posture of {len(joints)} actuated joints; use select, or --posture"
        faults.append(Fault("--end-point", sentence, options["end_point"]))
    raise_if_any(InputError, "evaluate", faults)
    if posture is not None:
        return posture
    arguments = Arguments("evaluate")
    elbow = arguments.choice("elbow", options["elbow"] or "up", ELBOWS)
    arguments.point(end_point, "end-point")
    arguments.base(base)
    arguments.control(options["control"] or "inverse")
    arguments.done()
    return inverse_kinematics(machine, end_point, base=base, gravity=gravity, elbow=elbow)[0]


@cli.command("select")
@click.argument("machine")
@END_POINT
@ELBOW
@BASE
@_option("--base-range", metavar="LO,HI", help="Placements allowed, m; all that reach by default.")
@CONTROL
@_option(
    "--objective",
    metavar="w1|w2|…|V|epsilon_max",
    help="What to maximise (w1 by default); several in order: w1,epsilon_max.",
)
@_option("--weights", metavar="A1,A2,…", help="Weights α of the objective V = Σ αi wi, and β of ε_max after them.")
@_option("--singularity-margin-deg", metavar="DEG", help="Distance from singular postures (10 by default).")
@_option("--starts", metavar="N", help="Starts at most (every peak of the scan by default).")
@_option("--seed", metavar="N", help="Seed of the scan.")
@GAIN
@GRAVITY
@_option("--plot", metavar="PATH", help="Draw the choice: .png, .svg or .pdf.")
@_option("--out", metavar="PATH", help="Write the JSON document to a file, too.")
@JSON
def select_command(as_json: bool, machine: str, plot: str | None, out: str | None, **options: Any) -> None:
    """Best placement and posture for a target, of MACHINE: a machine with --end-point, or a problem (name or file)."""
    _check_output("--plot", plot, PICTURES)
    _check_output("--out", out, (".json",))
    settings = _selection_settings(machine, options)
    with _option_names(options), _warnings_to_stderr(as_json), _progress() as progress:
        result = select(**settings, progress=progress)
    if plot is not None:
        _write("--plot", plot, lambda: result.plot(plot))
    if out is not None:
        text = json.dumps(result.to_dict(), indent=2, allow_nan=False) + "\n"
        _write("--out", out, lambda: Path(out).write_text(text, encoding="utf-8"))
    if as_json:
        _print_json(result.to_dict())
    else:
        click.echo(_selection_text(result))


def _selection_settings(machine: str, options: dict[str, Any]) -> dict[str, Any]:
    """Arguments of `flexopt.select`: from the problem file, where one is named, overridden by the options given."""
    loaded = load_any(machine)
    settings: dict[str, Any] = loaded.select_arguments() if isinstance(loaded, Problem) else {"machine": loaded}
    margin = options["singularity_margin_deg"]
    given = {
        "target": _numbers(options["end_point"]),
        "base": _base(options["base"]),
        "base_range": _numbers(options["base_range"]),
        "elbow": options["elbow"],
        "control": options["control"],
        "objective": options["objective"],
        "weights": _numbers(options["weights"]),
        "singularity_margin_deg": None if margin is None else _number(margin),
        "starts": _whole(options["starts"]),
        "seed": _whole(options["seed"]),
        "gain": None if options["gain"] is None else _number(options["gain"]),
        "gravity": True if options["gravity"] else None,
    }
    if given["objective"] not in (None, "V") and given["weights"] is None:
        settings.pop("weights", None)
    settings |= {name: value for name, value in given.items() if value is not None}
    if "target" not in settings:
        raise InputError("select: a machine needs --end-point X,Y (m, inertial frame); a problem file brings its own")
    return settings


def _selection_text(result: Selection) -> str:
    best, problem = result.best.evaluation, result.problem
    base = ", ".join(f"{name} = {x:.4f} m" for name, x in zip(best.base_coordinates, best.base, strict=True))
    angles = ", ".join(f"{name} {a:.4f} rad" for name, a in zip(best.joints, best.posture, strict=True))
    lines = [repr(result), "", f"Stand at {base} and hold {angles}.", repr(best)]
    if result.initial is not None:
        first = problem.objectives[0]
        before, after = (first.value(e.w, e.epsilon_max) for e in (result.initial, best))
        lines.append(f"{first.name}: {before:.5e} in the present posture, {after:.5e} in the chosen one")
    return "\n".join(lines)


@cli.command("map")
@click.argument("machine")
@_option("--points", metavar="N,M", help="Points along x and y (400,400 by default).")
@CONTROL
@GAIN
@GRAVITY
@_option("--elbow", metavar="|".join(ELBOWS), help="Which posture reaches an end-point (up by default).")
@_option("--over", metavar="end_point|posture", help="Map over end-points (default) or over the first two joints.")
@_option("--posture", metavar="C,…", help="With --over posture: the joints from the third on, rad.")
@_option("--x-range", metavar="LO,HI", help="Workspace frame, m, or first joint, rad; all of it by default.")
@_option("--y-range", metavar="LO,HI", help="Workspace frame, m, or second joint, rad; all of it by default.")
@_option("--out", metavar="FILE.nc", help="Write the map to a netCDF file.")
@_option("--plot", metavar="FILE.png", help="Draw the map: .png, .svg or .pdf.")
@JSON
def map_command(as_json: bool, machine: str, plot: str | None, out: str | None, **options: Any) -> None:
    """Frequencies, w_i, in-phase regions and ε_max of MACHINE over its workspace.

    The workspace frame has the axes of the inertial one and its origin at the first joint at rest.
    """
    from flexopt.study import map_workspace  # noqa: PLC0415  (only this command needs it)

    _check_output("--plot", plot, PICTURES)
    _check_output("--out", out, (".nc",))
    loaded = load(machine)
    points = _numbers(options["points"])
    given: dict[str, Any] = {
        "points": points and [int(n) if isinstance(n, float) and n.is_integer() else n for n in points],
        "control": options["control"],
        "gain": None if options["gain"] is None else _number(options["gain"]),
        "elbow": options["elbow"],
        "over": options["over"],
        "posture": _numbers(options["posture"]),
        "x_range": _numbers(options["x_range"]),
        "y_range": _numbers(options["y_range"]),
    }
    settings = {name: value for name, value in given.items() if value is not None}
    with _option_names(options), _warnings_to_stderr(as_json), _progress("postures") as progress:
        result = map_workspace(loaded, gravity=bool(options["gravity"]), progress=progress, **settings)
    if out is not None:
        _write("--out", out, lambda: result.to_netcdf(out))
    if plot is not None:
        _write("--plot", plot, lambda: result.plot(plot))
    if as_json:
        _print_json(result.to_dict())
    else:
        click.echo(repr(result))


@cli.command("reproduce")
@_option("--out", metavar="DIR", help="Folder of report.html and report.json (flexopt-reproduce by default).")
@JSON
def reproduce_command(as_json: bool, out: str | None) -> None:
    """The article computed again: Table 2, Figs. 5 to 8, mean frequencies, its claims and contradictions.

    Writes one HTML report and one JSON file into a folder, which is made if it is missing.
    """
    from flexopt.study import reproduce  # noqa: PLC0415  (only this command needs it)

    folder = out or REPORT_FOLDER
    _check_folder("--out", folder)
    with _warnings_to_stderr(as_json), _progress("stages") as progress:
        result = reproduce(progress=progress)
    _write("--out", folder, lambda: result.write(folder))
    if as_json:
        _print_json(result.to_dict())
    else:
        click.echo(f"{result!r}\n\nreport: {Path(folder) / 'report.html'}, {Path(folder) / 'report.json'}")


@cli.command("doctor")
@JSON
def doctor_command(as_json: bool) -> None:
    """What this installation can do: versions, solver, compiler, shipped machines and problems."""
    from flexopt.study.doctor import examine  # noqa: PLC0415  (only this command needs it)

    report = examine()
    if as_json:
        _print_json(report.to_dict())
    else:
        click.echo(repr(report))
    if not report.healthy:
        sys.exit(FAILED)


@contextmanager
def _option_names(options: dict[str, Any]) -> Generator[None]:
    """Faults of arguments under the names of the options they were given by."""
    spelled = {"target": "end_point", "end-point": "end_point"}
    try:
        yield
    except InputError as error:
        renamed: list[Fault] = []
        for fault in error.faults:
            name, _, rest = fault.field.partition(" ")
            option = spelled.get(name, name)
            given = options.get(option) is not None
            field = f"--{option.replace('_', '-')} {rest}".strip() if given else fault.field
            renamed.append(Fault(field, fault.sentence, fault.value))
        if type(error) is InputError:
            raise_if_any(InputError, error.heading, renamed)
        raise


@contextmanager
def _warnings_to_stderr(as_json: bool) -> Generator[None]:
    """Flexopt's warnings as lines on standard error; in text they are part of the result itself."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", FlexoptWarning)
        yield
    for warning in caught:
        if not issubclass(warning.category, FlexoptWarning):
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
        elif as_json:
            click.echo(f"flexopt: warning: {warning.message}", err=True)


@contextmanager
def _progress(what: str = "starts") -> Generator[Callable[[int, int], None]]:
    """A bar on standard error where that is a terminal, else one line at the end."""
    if not sys.stderr.isatty():
        yield lambda done, total: click.echo(f"{what} {done}/{total}", err=True) if done == total else None
        return
    with click.progressbar(length=1, label=what, file=sys.stderr, show_pos=True) as bar:

        def show(done: int, total: int) -> None:
            bar.length = total
            bar.update(done - bar.pos)

        yield show


def _check_folder(option: str, path: str) -> None:
    """Find out that a folder cannot be made before the work is done."""
    target = Path(path)
    made = next((folder for folder in (target, *target.parents) if folder.exists()), None)
    if made is None or not made.is_dir():
        raise InputError(f"{option} = {path!r}: {str(made or target)!r} is no folder")


def _check_output(option: str, path: str | None, suffixes: tuple[str, ...]) -> None:
    """Find out that a file cannot be written before the work is done."""
    if path is None:
        return
    target = Path(path)
    if len(target.name.encode()) > FILE_NAME_MAX:
        raise InputError(f"{option}: the file name is too long, {len(target.name.encode())} bytes of {FILE_NAME_MAX}")
    if target.suffix.lower() not in suffixes:
        raise InputError(f"{option} = {path!r}: the name must end in {' or '.join(suffixes)}")
    if target.is_dir() or not target.parent.is_dir():
        raise InputError(f"{option} = {path!r}: there is no folder {str(target.parent)!r} to write a file into")


def _write(option: str, path: str, write: Callable[[], object]) -> None:
    try:
        write()
    except OSError as error:
        raise InputError(f"{option} = {path!r}: cannot be written ({error.strerror})") from None


def _numbers(text: str | None) -> list[Any] | None:
    """`1,2.5` as numbers; what is no number stays text, for the checks to name."""
    return None if text is None else [_number(part) for part in text.split(",")]


def _base(text: str | None) -> Any:
    """A placement: one number alone, or a list."""
    numbers = _numbers(text)
    return numbers[0] if numbers is not None and len(numbers) == 1 else numbers


def _number(text: str) -> Any:
    try:
        return text.strip() if "_" in text else float(text)
    except ValueError:
        return text.strip()


def _whole(text: str | None) -> Any:
    if text is None:
        return None
    value = _number(text)
    return int(value) if isinstance(value, float) and value.is_integer() else value
