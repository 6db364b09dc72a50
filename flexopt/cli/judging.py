"""`flexopt verdict` and `flexopt region`, and the options of the real controller and of what is uncertain."""

from __future__ import annotations

from typing import Any

import click

from flexopt.cli.common import (
    BASE,
    CONTROL,
    ELBOW,
    GRAVITY,
    JSON,
    OUT,
    PDF,
    WEIGHTS,
    check_output,
    check_pdf,
    given,
    handing_out,
    number,
    numbers,
    of_picture,
    ranges_table,
    read,
    say_once,
    table,
    together,
    typed,
    value,
    whole,
    working,
    write_output,
)
from flexopt.cli.completing import argument
from flexopt.cli.postures import asked_posture, configuration, elbow_faults
from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.model import AnyMachine, load, load_any
from flexopt.model.choices import of_loop
from flexopt.model.loop import DEFAULT_LOOP, GAINS, RATES, Loop

LOOP = value(
    "--loop",
    "NAME=VALUE|default",
    "Of the real controller, may be repeated: kp, kv, rate, dead_time and the other keys of a file's [loop], each in "
    "place of the file's own; default: in place of the file's [loop] all follows from the machine.",
    multiple=True,
)
RANGES = value(
    "--ranges",
    "NAME=LO,HI",
    "What is known between two numbers only, may be repeated: stiffness or damping of all that gives, as factors "
    "(stiffness=0.5,2), parameters (payload.mass=0,300), or one factor of any (payload.mass=x0.5,x2), dead_time; in "
    "place of the file's [[uncertainty]].",
    multiple=True,
)
# What a verdict rests on.
judged = together(
    LOOP,
    RANGES,
    value(
        "--members", "N", "Points of the uncertainty that decays are computed of, corners at least (64 by default).",
        whole,
    ),
    value(
        "--runs", "N", "How many of them are run nonlinearly in each place, too (16 by default; 0: none confirm).",
        whole,
    ),
)  # fmt: skip
# What makes a problem of a machine, where no file does.
of_machine = together(
    value("--end-point", "X,Y[,Z]", "Of a machine: target of the end-point, inertial frame, m.", numbers),
    value("--posture", "A,B,…", "Of a machine: how it is held now, rad (slides: m), with --base.", numbers),
    BASE,
    ELBOW,
    CONTROL,
    value("--objective", "w1|w2|…|V|epsilon_max|decay|…", "Of a machine: by what places are chosen (w1 by default)."),
    WEIGHTS,
    GRAVITY,
)
OF_MACHINE = ("end_point", "posture", "base", "elbow", "control", "objective", "weights", "gravity")


def real_loop(own: Loop | None, entries: tuple[str, ...]) -> dict[str, Any] | None:
    """The table that was given, on top of the file's own, in place of it with `default`; None where none was."""
    asked = table("--loop", tuple(entry for entry in entries if entry != DEFAULT_LOOP)) or {}
    if not entries:
        return None
    known = own.model_dump(exclude_unset=True) if own else {}
    if DEFAULT_LOOP not in entries:
        return _beside(known, asked)
    if left_out := [name for name in known if name not in asked]:
        say_once(f"flexopt: --loop default stands in place of the file's [loop], without its {', '.join(left_out)}")
    return asked


def control_asked(own: Loop | None, entries: tuple[str, ...]) -> str:
    """Of the loop that was given."""
    return (real_loop(own, entries) or {}).get("control", "inverse")


def _beside(known: dict[str, Any], asked: dict[str, Any]) -> dict[str, Any]:
    """What was asked for on top of the file's own; of the file's that do not go with it the way out is told."""
    drive, own, faults = _drive(known | asked), _drive(known), list[Fault]()
    beside, way_out = "it is the file's own: --loop default leaves the file's [loop] out", dict[str, str]()
    if drive in RATES and drive != own:
        sentence = f"is for {own}-served joints; for {drive}-served ones it has another unit, and is to be given"
        names = (*GAINS, "kp_range", "kv_range")
        values = {name: [*known[name]] for name in names if name in known and name not in asked}
        values = {name: each for name, each in values.items() if any(each)}
        told = {name: str(each[0] if len(each) == 1 else each) for name, each in values.items()}
        faults += [Fault(name, sentence, value) for name, value in told.items()]
    try:
        Loop(**known | asked)
    except InputError as error:
        own_faults = [fault for fault in error.faults if fault.field in known and fault.field not in asked]
        # Of one key that is told once.
        named = {fault.field for fault in own_faults}
        faults = [*(fault for fault in faults if fault.field not in named), *own_faults]
        without = [each.field for each in own_faults if _fits(known | asked | {each.field: 0.0})]
        way_out = {name: beside.replace(": ", f": --loop {name}=0 takes it out, ") for name in without}
    faults = [Fault(each.field, f"{each.sentence}; {way_out.get(each.field, beside)}", each.value) for each in faults]
    raise_if_any(InputError, click.get_current_context().command_path.partition(" ")[2], faults)
    return known | asked


def _fits(loop: dict[str, Any]) -> bool:
    """Whether these keys go together."""
    try:
        Loop(**loop)
    except InputError:
        return False
    return True


def _drive(loop: dict[str, Any]) -> str:
    """What the gains of these keys are for; without a drive or a servo gain torques."""
    return loop.get("drive") or ("velocity" if "servo_gain" in loop else "torque")


@click.command("verdict", short_help="Does it pay to move, with this controller, on this ground?")
@argument("problem")
@of_machine
@judged
@value("--duration", "S", "Of a run, s (by default 20; longer where a mode or the loop is slow).", number)
@of_picture("Draw the bands of every place: .png, .svg or .pdf.")
@value("--html", "FILE", "Write a page: the word, the bands, the table, the rule.")
@PDF
@OUT
@JSON
def verdict_command(as_json: bool, problem: str, html: str | None, pdf: str | None, **options: Any) -> None:
    """Move, stay, change gains, or cannot tell: PROBLEM is a problem file, or a machine with --end-point and --base.

    The present configuration beside the best ones found, with the controller of --loop, over all that is uncertain.
    """
    from flexopt.study import verdict  # noqa: PLC0415  (only this command needs it)

    hand_out = handing_out(options, ".json", as_json=as_json)
    check_output("--html", html, (".html",))
    check_pdf(pdf)
    with working(options, as_json, "percent") as progress:
        asked, own = asked_problem("verdict", problem, options)
        settings = given(options, "members", "runs", "duration")
        ranges = ranges_table(options["ranges"])
        result = verdict(asked, loop=real_loop(own, options["loop"]), ranges=ranges, progress=progress, **settings)
    if html is not None:
        write_output("--html", html, lambda: result.to_html(html))
    if pdf is not None:
        write_output("--pdf", pdf, lambda: result.to_pdf(pdf))
    hand_out(result)


@click.command("region", short_help="Is a loop stable over all that is uncertain, and is it proven?")
@argument("machine")
@configuration
@LOOP
@RANGES
@value("--points", "N", "Points of the ranges that decays are computed of (64 by default).", whole)
@value("--boxes", "N", "Parts of the ranges that a proof may look at (1,500 by default; 0: none).", whole)
@OUT
@JSON
def region_command(as_json: bool, machine: str, **options: Any) -> None:
    """Whether the loop of MACHINE (a name or a file) in one posture is stable over all that is uncertain.

    The least stable point, what share of the ranges is proven to be stable, and the radius of stability.
    """
    from flexopt.loop.certified.region import stable_region  # noqa: PLC0415  (only this command needs it)

    hand_out = handing_out(options, ".json", as_json=as_json)
    loaded = read(load, machine)
    with working(options, as_json, "parts") as progress:
        loop, ranges = real_loop(loaded.loop, options["loop"]), ranges_table(options["ranges"])
        posture = asked_posture("region", loaded, options, loop)
        settings = given(options, "base", "control", "gravity", "points", "boxes")
        result = stable_region(loaded, posture, loop=loop, ranges=ranges, progress=progress, **settings)
    hand_out(result)


def asked_problem(call: str, name: str, options: dict[str, Any]) -> tuple[Any, Loop | None]:
    """A problem file's problem, or that of a machine with a target; and the loop that belongs to it."""
    from flexopt.model import Problem  # noqa: PLC0415  (`evaluate` does not need them)
    from flexopt.selection import build_selection  # noqa: PLC0415

    loaded: AnyMachine | Problem = read(load_any, name)
    asked: dict[str, Any] = given(options, *OF_MACHINE)
    if options["loop"] and isinstance(loaded, AnyMachine):
        asked = {"control": control_asked(loaded.loop, options["loop"])} | asked
    if isinstance(loaded, Problem):
        if asked.pop("gravity", False):
            loaded = loaded.model_copy(update={"selection": loaded.selection.model_copy(update={"gravity": True})})
        sentence = "goes with a machine; the problem file brings its own"
        faults = [Fault(f"--{word.replace('_', '-')}", sentence, typed(v)) for word, v in asked.items()]
        raise_if_any(InputError, call, faults)
        return loaded, loaded.loop or loaded.loaded_machine.loop
    raise_if_any(InputError, call, elbow_faults(loaded, options))
    if "end_point" not in asked:
        raise InputError(f"{call}: a machine needs --end-point (m, inertial frame); a problem file brings its own")
    if of_loop(asked.get("objective")):
        target, described = {"end_point": asked.pop("end_point")}, f"{loaded.name}: {asked['objective']}"
        return Problem(name=described, machine=name, target=target, selection=asked).with_machine(loaded), loaded.loop
    return build_selection(loaded, asked.pop("end_point"), **asked), loaded.loop
