"""`flexopt evaluate` and `flexopt select`."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import click

from flexopt.cli.common import (
    BASE,
    CONTROL,
    ELBOW,
    END_POINT,
    FAILED,
    GAIN,
    GRAVITY,
    JSON,
    OUT,
    WEIGHTS,
    announce,
    check_output,
    check_picture,
    given,
    leave_with,
    number,
    numbers,
    of_picture,
    option,
    print_json,
    ranges_table,
    read,
    say,
    tell,
    typed,
    value,
    whole,
    working,
    write_output,
)
from flexopt.cli.completing import argument
from flexopt.cli.judging import LOOP, RANGES, control_asked, real_loop
from flexopt.cli.postures import asked_posture, configuration, elbow_faults
from flexopt.errors import Fault, FlexoptError, InputError, raise_if_any
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Document, Progress
from flexopt.foundation.boundary import TABLE
from flexopt.foundation.documents import json_ready
from flexopt.foundation.writing import write_file
from flexopt.model import load, load_any
from flexopt.model.choices import OUTCOMES, asks_for_loop
from flexopt.model.loop import Loop, control_of, under_control
from flexopt.robustness import evaluate

if TYPE_CHECKING:
    from flexopt.identification import Identification
    from flexopt.selection import BasePlan, Selection, Stand
    from flexopt.study import Verdict


def ranges(text: str) -> Any:
    """`LO,HI`, or `x=LO,HI;yaw=LO,HI` as a table."""
    if "=" not in text:
        return numbers(text)
    named = (part.partition("=") for part in text.split(";") if part.strip())
    return {name.strip(): numbers(pair) for name, _, pair in named}


@click.command("evaluate", short_help="Frequencies, measures w_i and gradients in one posture.")
@argument("machine")
@configuration
@GAIN
@option("--damped", is_flag=True, help="Measures of the damped plant.")
@LOOP
@JSON
def evaluate_command(as_json: bool, machine: str, **options: Any) -> None:
    """Frequencies, measures w_i and gradients of MACHINE (a name or a file) in one posture."""
    loaded = read(load, machine)
    with working(options, as_json):
        loop = real_loop(loaded.loop, options.pop("loop"))
        posture = asked_posture("evaluate", loaded, options, loop)
        result = evaluate(loaded, posture, loop=loop, **given(options, "base", "control", "gain", "damped", "gravity"))
    tell(result, as_json=as_json)


@click.command("select", short_help="Best placement and posture for a target, or for several.")
@argument("machine", "machine or problem")
@END_POINT
@ELBOW
@BASE
@value("--posture", "A,B,…", "How the arm is held now, rad (slides: m), with --base.", numbers)
@value(
    "--base-range",
    "LO,HI|x=LO,HI;yaw=…",
    "Placements allowed, m and rad: of x, or by name; all that reach by default.",
    ranges,
)
@CONTROL
@value(
    "--objective",
    "w1|w2|…|V|epsilon_max|decay|…",
    "What to maximise (w1 by default), or of settling and swing to make small; of the loop (--loop): "
    f"{', '.join(OUTCOMES)}; several in order: w1,decay.",
)
@WEIGHTS
@value("--slack", "SHARE", "What an objective may give up for the next in order (1e-5 by default).", number)
@value("--singularity-margin-deg", "DEG", "Distance from singular postures (10 by default).", number)
@value(
    "--assume",
    "everything|nothing|WORDS",
    "What holds where nothing else is asked for: some of ground,limits,reach (everything by default).",
)
@value(
    "--starts",
    "N",
    "Starts at most (32 by default; in the plane every peak of the scan); better points that are seen are climbed "
    "from, too.",
    whole,
)
@value("--seed", "N", "Seed of the starts.", whole)
@value("--workers", "N", "Processes at most (one for each core by default); the result is the same.", whole)
@GAIN
@GRAVITY
@LOOP
@RANGES
@option("--certify", is_flag=True, help="Prove that no configuration is better; of arms of two hinges in a plane.")
@value(
    "--proof",
    "FILE.json",
    "With --certify: write what the proof stands on; flexopt check FILE.json computes it again.",
)
@value(
    "--log",
    "FILE.csv",
    "How the machine swings: springs and dampers are identified from it first, as `flexopt identify` does, the arm "
    "held as its joints or else --posture say.",
)
@value("--imu", "X,Y[,Z]", "With --log: where the accelerometer sits, as of `flexopt identify`.", numbers)
@of_picture("Draw the choice: .png, .svg or .pdf.")
@OUT
@JSON
def select_command(
    as_json: bool, machine: str, out: str | None, certify: bool, proof: str | None, log: str | None, **options: Any
) -> None:
    """Best placement and posture for a target, of MACHINE: a machine with --end-point, or a problem (name or file).

    A problem may ask for one placement for several targets, or for a way of the base along a path of them.
    """
    drawn, draw = options["plot"] is not None, check_picture(options)
    check_output("--out", out, (".json",))
    check_output("--proof", proof, (".json",))
    if log is not None and not log.lower().endswith(".csv"):
        sentence = "must be a .csv file of how the machine swings; --proof writes what a certificate stands on"
        raise InputError(f"select: --log = {log!r}: {sentence}", [Fault("--log", sentence, log)])
    imu = options.pop("imu")
    if imu is not None and log is None:
        raise InputError("select: --imu goes with --log", [Fault("--imu", "goes with --log", str(imu))])
    judged = {name: options.pop(name) for name in ("loop", "ranges")}
    settings, own = _selection_settings(machine, options, judged["loop"])
    with working(judged, as_json):
        _refuse_early(settings, judged, own)
    identified = None if log is None else _identified(log, imu, settings, as_json)
    # The file's may ask for another objective than the option does, the one of the loop or the other not.
    by_loop = asks_for_loop(settings.get("objective"), settings.get("constraints"))
    ground = ranges_table(judged["ranges"]) or settings.get("ranges") or own["ranges"]
    settings |= {"loop": _loop(own, judged["loop"]), "ranges": ground} if by_loop else {"loop": None, "ranges": None}
    if proof is not None and not certify:
        raise InputError("select: --proof goes with --certify", [Fault("--proof", "goes with --certify", proof)])
    if certify and "target" not in settings:
        sentence = "goes with a single target: of several no bound over all ways and placements is known"
        raise InputError(f"select: --certify {sentence}", [Fault("--certify", sentence)])
    with working(options | judged, as_json, "starts") as progress:
        result = _solver(settings)(**settings, progress=progress)
    certificate = _certificate(result, proof) if certify else None
    draw(result)
    judged_too = _is_judged(result, own, **judged)
    # Before the verdict, whose runs take minutes where an arm has many joints.
    if not as_json:
        _tell_choice(result, identified, certificate, judged=judged_too)
    said = _unchanged if identified is None else of_the_log
    more = {} if certificate is None else {"certificate": certificate}
    more |= {} if identified is None else {"identification": identified.to_dict()}
    judge = partial(_judgement, result, own, **judged) if judged_too else None
    place = _hand_out(said(result.to_dict()) | more, judge, judged, out, said, as_json=as_json)
    # Last: what cannot be drawn is no reason to lose a verdict.
    if drawn and place:
        from flexopt.study.reports.surroundings import spoken_of  # noqa: PLC0415  (what only verdicts need)

        if (about := spoken_of(result, place)) is not result:
            draw(about)
            announce(f"the picture shows {place} as the chosen one, of which the verdict speaks")
    if certificate is not None and certificate["verdict"] != "proven":
        sys.exit(FAILED)


def _hand_out(
    chosen: Document, judge: Callable[..., Verdict] | None, judged: dict[str, Any], out: str | None,
    said: Callable[[Any], Any], *, as_json: bool,
) -> str:  # fmt: skip
    """Write the choice, judge it where that is asked, and write both; it stands where no verdict is to be had.

    Of which place the verdict speaks; empty without one. `said`: what it says, in the words to say it in.
    """

    def write() -> None:
        if (file := out) is not None:
            text = json.dumps(chosen, indent=2, allow_nan=False) + "\n"
            write_output("--out", file, lambda: write_file(file, text))

    write()
    refused: FlexoptError | None = None
    place = ""
    if judge is not None:
        announce("the verdict follows, which may take minutes")
        try:
            with working(judged, as_json, "stages of the verdict") as progress:
                judgement = judge(progress=progress)
        except FlexoptError as error:
            refused = error
            chosen = chosen | {"verdict": {"status": "failed", "error": json_ready(error.to_dict())}}
        else:
            chosen, place = chosen | {"verdict": said(judgement.to_dict())}, judgement.place
            if not as_json:
                say(f"\n{said(repr(judgement))}")
        write()
    if as_json:
        print_json(chosen)
    if refused is not None:
        leave_with(refused)
    return place


def _tell_choice(
    result: Selection | Stand | BasePlan,
    identified: Identification | None,
    certificate: dict[str, Any] | None,
    *,
    judged: bool,
) -> None:
    from flexopt.selection import Selection  # noqa: PLC0415  (`evaluate` does not need it)

    text = _selection_text(result, judged=judged) if isinstance(result, Selection) else repr(result)
    if identified is not None:
        say(f"{identified!r}\n")
        say("the machine has these numbers now, which factors of ranges multiply: the log's, in what follows\n")
        text = of_the_log(text)
    say(text)
    if certificate is not None:
        say(f"\n{certificate['status']}")


# What results call the file's, of a machine whose numbers a log has told.
_OF_THE_LOG = {
    "of the file's": "of the log's",
    "than the file's": "than the log's",
    "with the file's numbers": "with the log's numbers",
    "with the numbers of the file": "with the numbers of the log",
    "than the machine's file has": "than the log or the machine's file has",
    "is as the machine's file has it": "is as the log and the machine's file have it",
}


def of_the_log(told: Any) -> Any:
    """Texts of an identified machine's result and document: its numbers are the log's, and not the file's."""
    if isinstance(told, str):
        for of_file, of_log in _OF_THE_LOG.items():
            told = told.replace(of_file, of_log)
        return told
    if isinstance(told, Mapping):
        return {name: of_the_log(each) for name, each in cast(Mapping[str, Any], told).items()}
    return [of_the_log(each) for each in cast("list[Any]", told)] if isinstance(told, list) else told


def _unchanged(told: Any) -> Any:
    return told


def _identified(swing: str, imu: Any, settings: dict[str, Any], as_json: bool) -> Identification:
    """The machine's numbers from a log; what is chosen is chosen for the machine that has them."""
    from flexopt.identification import identify  # noqa: PLC0415  (`evaluate` does not need it)

    held = {name: settings[name] for name in ("base", "gravity") if settings.get(name) is not None}
    held |= {} if imu is None else {"imu": imu}
    with working({"log": swing, **held}, as_json, "stages of the log") as progress:
        held |= {"progress": progress}
        try:
            found = identify(settings["machine"], swing, **held)
        except InputError as error:
            # The log has no joints: then it was taken as the arm is held now.
            if settings.get("posture") is None or not any(fault.field == "posture" for fault in error.faults):
                raise
            found = identify(settings["machine"], swing, posture=settings["posture"], **held)
    settings["machine"] = found.machine
    return found


def _certificate(result: Any, proof: str | None) -> dict[str, Any]:
    """The certificate's document; of a selection that cannot have one, the verdict "none" and why."""
    from flexopt.selection import certify  # noqa: PLC0415  (`evaluate` does not need it)

    try:
        certificate = certify(result)
    except InputError as error:
        return {"verdict": "none", "status": f"not certified: {error.faults[0]}"}
    if proof is not None:
        write_output("--proof", proof, lambda: certificate.write_log(proof))
    return certificate.to_dict()


def _refuse_early(settings: dict[str, Any], judged: dict[str, tuple[str, ...]], own: dict[str, Any]) -> None:
    """What no verdict and no choice by the loop can be had of, before anything is solved."""
    faults = list[Fault]()
    by_loop = asks_for_loop(settings.get("objective"), settings.get("constraints"))
    if any(judged.values()) and not by_loop and settings.get("base") is None and settings["machine"].base_coordinates:
        faults.append(Fault("--base", "is needed for a verdict: where the machine stands now"))
    raise_if_any(InputError, "select", faults)
    arguments = Arguments("select", settings["machine"])
    for name, asked in (
        ("loop", real_loop(own["loop"], judged["loop"])),
        ("ranges", ranges_table(judged["ranges"])),
    ):
        if asked is not None:
            TABLE[name](arguments, name, asked)
    arguments.done()
    real = _loop(own, judged["loop"])
    # Of a choice that a verdict follows; else no loop is looked at.
    if real is not None and settings.get("base") is not None and not by_loop:
        loop, machine = Loop.model_validate(real), settings["machine"]
        under_control(loop, machine, control_of(settings.get("control"), loop, machine), "select")


def _is_judged(
    result: Selection | Stand | BasePlan, own: dict[str, Any], loop: tuple[str, ...], ranges: tuple[str, ...]
) -> bool:
    """Whether a controller is known and a present placement: asked for, or of the files."""
    from flexopt.study.verdicts.place_loops import problems_of  # noqa: PLC0415  (`evaluate` does not need it)

    return bool(loop or ranges or own["loop"]) and problems_of(result)[0].present_base is not None


def _loop(own: dict[str, Any], entries: tuple[str, ...]) -> Any:
    """The controller that was asked for, which may be all by default; else the file's own."""
    asked = real_loop(own["loop"], entries)
    return own["loop"] if asked is None else asked


def _judgement(
    result: Selection | Stand | BasePlan,
    own: dict[str, Any],
    loop: tuple[str, ...],
    ranges: tuple[str, ...],
    progress: Progress,
) -> Verdict:
    from flexopt.study import verdict  # noqa: PLC0415  (`evaluate` does not need it)

    ground = ranges_table(ranges) or own["uncertainty"]
    return verdict(result, loop=_loop(own, loop), ranges=ground, progress=progress)


def _selection_settings(
    machine: str, options: dict[str, Any], loop: tuple[str, ...]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Arguments of `flexopt.select`: from the problem file, where one is named, overridden by the options given.

    Also the loop and the uncertainty of the file or its machine, and as `ranges` those of a problem's own.
    """
    from flexopt.model import Problem  # noqa: PLC0415  (`evaluate` does not need it)

    loaded = read(load_any, machine)
    whose = loaded.loaded_machine if isinstance(loaded, Problem) else loaded
    own = {name: getattr(loaded, name) or getattr(whose, name) or None for name in ("loop", "uncertainty")}
    own["ranges"] = loaded.uncertainty or None if isinstance(loaded, Problem) else None
    settings: dict[str, Any] = loaded.select_arguments() if isinstance(loaded, Problem) else {"machine": loaded}
    if isinstance(loaded, Problem) and loaded.target.kind != "end_point":
        single = [name for name in ("end_point", "elbow", "gain", "slack") if options[name] is not None]
        sentence = f"goes with a single target; {loaded.name} has target.{loaded.target.kind}"
        faults = [Fault(f"--{name.replace('_', '-')}", sentence, typed(options[name])) for name in single]
        raise_if_any(InputError, "select", faults)
    asked = given(options) | {"target": options["end_point"]}
    asked.pop("end_point", None)
    if loop and not (isinstance(loaded, Problem) and loaded.selection.control):
        settings["control"] = control_asked(own["loop"], loop)
    if options["objective"] not in (None, "V") and options["weights"] is None:
        settings.pop("weights", None)
    settings |= given(asked)
    raise_if_any(InputError, "select", elbow_faults(settings["machine"], options))
    if not {"target", "targets", "path"} & set(settings):
        rows = ",".join(row.upper() for row in settings["machine"].task_rows)
        raise InputError(
            f"select: a machine needs --end-point {rows} (m, inertial frame); a problem file brings its own"
        )
    return settings, own


def _solver(settings: dict[str, Any]) -> Callable[..., Selection | Stand | BasePlan]:
    from flexopt.selection import plan_base, select, select_stand  # noqa: PLC0415  (`evaluate` does not need it)

    return select_stand if "targets" in settings else plan_base if "path" in settings else select


def _selection_text(result: Selection, *, judged: bool) -> str:
    """The result in words; where a verdict follows, which may be to stay, the best is that of the objective alone."""
    best, problem = result.best.evaluation, result.problem
    placed = zip(best.base_coordinates, best.base, best.base_units, strict=True)
    base = ", ".join(f"{name} = {x:z.4f} {unit}" for name, x, unit in placed)
    held = zip(best.joints, best.posture, best.joint_units, strict=True)
    angles = ", ".join(f"{name} {a:z.4f} {unit}" for name, a, unit in held)
    stand = f"Stand at {base} and hold" if base else "Hold"
    if judged:
        stand = f"Best by {result.objective}, whether it pays is told below: {stand[0].lower()}{stand[1:]}"
    unjudged = ""
    if not judged and result.measure is None:
        known = f"Best by {result.objective}, which knows no controller"
        unjudged = f" {known}: --loop, or flexopt verdict, tells what it is worth."
    # By how much it sags is among the choice's remarks already.
    shown = [line for line in repr(best).splitlines() if not best.sag_told or line.strip() != best.sag_told]
    lines = [repr(result), "", f"{stand} {angles}.{unjudged}", *shown]
    if result.initial is not None and result.measure is None:
        from flexopt.selection.columns import shown_measures  # noqa: PLC0415  (`evaluate` does not need it)

        first = problem.sought[0]
        ends = (result.initial, best)
        before, after = (first.value(shown_measures(problem, e), e.epsilon_max) for e in ends)
        lines.append(f"{first.name}: {before:.5e} in the present posture, {after:.5e} in the chosen one")
    return "\n".join(lines)
