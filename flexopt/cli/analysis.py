"""`flexopt evaluate` and `flexopt select`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from flexopt.cli.common import (
    BASE,
    CONTROL,
    ELBOW,
    END_POINT,
    GAIN,
    GRAVITY,
    JSON,
    PICTURES,
    check_output,
    number,
    numbers,
    option,
    option_names,
    placement,
    print_json,
    progress_bar,
    warnings_to_stderr,
    whole,
    write_file,
)
from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.model import AnyMachine, Machine, Problem, load, load_any
from flexopt.model.arguments import Arguments
from flexopt.model.problem import ELBOWS
from flexopt.plant import inverse_kinematics
from flexopt.robustness import evaluate
from flexopt.selection import Selection, select


@click.command("evaluate")
@click.argument("machine")
@option("--posture", metavar="A,B,…", help="Actuated joints, rad (slides: m).")
@END_POINT
@ELBOW
@BASE
@CONTROL
@GAIN
@option("--damped", is_flag=True, help="Measures of the damped plant.")
@GRAVITY
@JSON
def evaluate_command(as_json: bool, machine: str, **options: Any) -> None:
    """Frequencies, measures w_i and gradients of MACHINE (a name or a file) in one posture."""
    with warnings_to_stderr(True):
        loaded = load(machine)
    base = placement(options["base"])
    control = options["control"] or "inverse"
    gravity = bool(options["gravity"])
    gain = number(options["gain"]) if options["gain"] is not None else 5e5
    with option_names(options), warnings_to_stderr(as_json):
        angles = _posture(loaded, options, base, gravity)
        result = evaluate(
            loaded, angles, base=base, control=control, gain=gain, damped=bool(options["damped"]), gravity=gravity
        )
    if as_json:
        print_json(result.to_dict())
    else:
        click.echo(repr(result))


def _posture(machine: AnyMachine, options: dict[str, Any], base: Any, gravity: bool) -> Any:
    """The posture given, or the one that reaches the end-point given."""
    posture, end_point = numbers(options["posture"]), numbers(options["end_point"])
    faults: list[Fault] = []
    if (posture is None) == (end_point is None):
        faults.append(Fault("--posture, --end-point", "give one of the two"))
    if posture is not None and options["elbow"] is not None:
        faults.append(Fault("--elbow", "goes with --end-point only", options["elbow"]))
    joints = machine.joints
    if end_point is not None and not isinstance(machine, Machine):
        faults.append(Fault("--end-point", "is for planar machines; give --posture", options["end_point"]))
    elif end_point is not None and len(joints) > 2:
        sentence = f"does not name one posture of {len(joints)} actuated joints; use select, or --posture"
        faults.append(Fault("--end-point", sentence, options["end_point"]))
    raise_if_any(InputError, "evaluate", faults)
    if posture is not None:
        return posture
    arguments = Arguments("evaluate")
    elbow = arguments.choice("elbow", options["elbow"] or "up", ELBOWS)
    arguments.point(end_point, "end-point")
    base = 0.0 if base is None else base
    arguments.base(machine, base)
    arguments.control(options["control"] or "inverse")
    arguments.done()
    return inverse_kinematics(machine, end_point, base=base, gravity=gravity, elbow=elbow)[0]


@click.command("select")
@click.argument("machine")
@END_POINT
@ELBOW
@BASE
@option("--base-range", metavar="LO,HI", help="Placements allowed, m; all that reach by default.")
@CONTROL
@option(
    "--objective",
    metavar="w1|w2|…|V|epsilon_max",
    help="What to maximise (w1 by default); several in order: w1,epsilon_max.",
)
@option("--weights", metavar="A1,A2,…", help="Weights α of the objective V = Σ αi wi, and β of ε_max after them.")
@option("--singularity-margin-deg", metavar="DEG", help="Distance from singular postures (10 by default).")
@option("--starts", metavar="N", help="Starts at most (every peak of the scan by default).")
@option("--seed", metavar="N", help="Seed of the scan.")
@GAIN
@GRAVITY
@option("--plot", metavar="PATH", help="Draw the choice: .png, .svg or .pdf.")
@option("--out", metavar="PATH", help="Write the JSON document to a file, too.")
@JSON
def select_command(as_json: bool, machine: str, plot: str | None, out: str | None, **options: Any) -> None:
    """Best placement and posture for a target, of MACHINE: a machine with --end-point, or a problem (name or file)."""
    check_output("--plot", plot, PICTURES)
    check_output("--out", out, (".json",))
    settings = _selection_settings(machine, options)
    with option_names(options), warnings_to_stderr(as_json), progress_bar() as progress:
        result = select(**settings, progress=progress)
    if plot is not None:
        write_file("--plot", plot, lambda: result.plot(plot))
    if out is not None:
        text = json.dumps(result.to_dict(), indent=2, allow_nan=False) + "\n"
        write_file("--out", out, lambda: Path(out).write_text(text, encoding="utf-8"))
    if as_json:
        print_json(result.to_dict())
    else:
        click.echo(_selection_text(result))


def _selection_settings(machine: str, options: dict[str, Any]) -> dict[str, Any]:
    """Arguments of `flexopt.select`: from the problem file, where one is named, overridden by the options given."""
    loaded = load_any(machine)
    settings: dict[str, Any] = loaded.select_arguments() if isinstance(loaded, Problem) else {"machine": loaded}
    margin = options["singularity_margin_deg"]
    given = {
        "target": numbers(options["end_point"]),
        "base": placement(options["base"]),
        "base_range": numbers(options["base_range"]),
        "elbow": options["elbow"],
        "control": options["control"],
        "objective": options["objective"],
        "weights": numbers(options["weights"]),
        "singularity_margin_deg": None if margin is None else number(margin),
        "starts": whole(options["starts"]),
        "seed": whole(options["seed"]),
        "gain": None if options["gain"] is None else number(options["gain"]),
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
