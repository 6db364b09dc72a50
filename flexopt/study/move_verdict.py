"""Does it pay to move, with my controller, on ground I do not know? The present configuration beside those chosen.

In: a configuration problem or its selection, a loop, what is uncertain. Out: a `Verdict`: for each configuration
what the loop does over the uncertainty, nonlinear runs, the drive that it costs, and a word by a stated rule.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Unpack, cast

import numpy as np

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Progress, TargetLike, Vector
from flexopt.foundation.boundary import Keywords, number, public, whole
from flexopt.foundation.documents import provenance
from flexopt.foundation.plain import shown
from flexopt.foundation.stages import Stages
from flexopt.loop.settings import loop_settings
from flexopt.loop.uncertain import UncertainLoop, UncertaintyBox, matters_most
from flexopt.model import AnyMachine, Problem
from flexopt.model.constraints import AnyConstraints
from flexopt.model.loop import Loop, LoopLike, gain_ranges, under_control
from flexopt.model.problem import SelectionKeywords, SelectionOptions
from flexopt.model.uncertainty import GROUND, RangesLike, Uncertainty
from flexopt.robustness import Evaluation
from flexopt.selection import Selection, SelectionProblem, select, solve_selection
from flexopt.selection.outcomes.result import OutcomeSelection
from flexopt.study.asked import one_target
from flexopt.study.confirmation import Runs, nonlinear_runs
from flexopt.study.decision import FASTER, MOST, Decision, Place, decide, faster
from flexopt.study.gain_search import best_gains
from flexopt.study.places import MOVE, STAY
from flexopt.study.verdict_result import Band, PlaceVerdict, Verdict

# Members that decays are computed of, nonlinear runs, and places besides the present one that are told.
MEMBERS, RUNS, TOLD = 64, 16, 3
# Candidates of which these are the best.
LOOKED = 12
# Members at whose corners gains, margins and moves are looked at: up to 2³ of them.
CORNERED = 3
# Choosing places, decays there, runs, and gains.
STAGES = 4
# Length of a nonlinear run, s.
DURATION = 20.0


def _judged(arguments: Arguments, field: str, value: Any) -> Any:
    """A problem as for a report, its answer, or a machine."""
    if isinstance(value, AnyMachine):
        arguments.of = value
    elif isinstance(value, Selection):
        arguments.of = value.problem.machine
    else:
        return one_target(arguments, field, value)
    return value


_KEYWORDS = Keywords(SelectionOptions, SelectionKeywords, together=True)


@public(
    problem=_judged,
    members=whole(2, 100_000),
    runs=whole(0, 100_000),
    duration=number("s", above=0.0, high=1e4),
    keywords=_KEYWORDS,
)
def verdict(
    problem: Problem | SelectionProblem | Selection | AnyMachine,
    target: TargetLike | None = None,
    *,
    constraints: AnyConstraints | None = None,
    loop: LoopLike | None = None,
    ranges: RangesLike | None = None,
    members: int = MEMBERS,
    runs: int = RUNS,
    duration: float = DURATION,
    progress: Progress | None = None,
    options: SelectionOptions | None = None,  # noqa: ARG001 - its fields come as keywords
    **keywords: Unpack[SelectionKeywords],
) -> Verdict:
    """Whether it pays to move: the present configuration beside the best of a selection, over what is uncertain.

    Args:
        problem: from `flexopt.load_problem` or `flexopt.build_selection`, with the present placement as `base`; an
            answer of `flexopt.select`; or a machine, with a target.
        target, constraints, options, keywords: of a machine, as in `flexopt.build_selection`.
        loop: the real controller, as of `flexopt.evaluate`; by default the problem's or machine's `[loop]`, or where
            there is none what follows from the machine. It is the same in every place; what it leaves out follows from
            the present one.
        ranges: what is uncertain: a table from names to (lower, upper), of `"stiffness"` and `"damping"` factors of all
            springs or dampers of passive coordinates, of `"dead_time"` s, of parameters in their own unit; or
            `flexopt.Uncertainty`s. By default the problem's or machine's `[[uncertainty]]`, or where there is none one
            factor ½ to 2 of all springs.
        members: how many points of the uncertainty decays are computed of.
        runs: how many of them are run nonlinearly in each place, too; 0 for none.
        duration: of a run, s.
        progress: called with the number of stages done and of all: places, decays, runs, gains.

    Raises:
        InputError: arguments are not usable; the problem has several targets, or no present placement.
        UnreachableTarget, NoSolutionFound: as `flexopt.select`.

    Example:
        >>> machine = flexopt.load("excavator")
        >>> loop = {"kp": 1e4, "kv": 1e3}
        >>> few = {"starts": 4, "members": 4, "runs": 1, "duration": 5.0}  # quick; leave them out
        >>> answer = flexopt.verdict(machine, (0.0, 1.6), base=0.0, loop=loop, **few)
        >>> answer.word
        'move'
    """
    stages = Stages(progress, STAGES)
    selection = _selected(problem, target, constraints, {k: v for k, v in keywords.items() if v is not None})
    solved = selection.problem
    machine = solved.machine
    asked, uncertain = _real(problem, selection, loop, ranges)
    stages.next()
    stands = _stands(selection)
    first = next(iter(stands.values()))
    settings = loop_settings(machine, asked, first, gravity=solved.gravity)
    box = UncertaintyBox(machine, uncertain, settings.dead_time)
    raise_if_any(InputError, "verdict", box.faults(settings.rate))
    points = box.members(members, solved.seed)
    loops = {
        name: UncertainLoop(settings, stand.base, stand.posture, solved.gravity, box) for name, stand in stands.items()
    }
    decays = {name: each.decays(points) for name, each in loops.items()}
    others = sorted((name for name in stands if name != STAY), key=lambda name: -float(decays[name].min()))[:TOLD]
    told = [name for name in (STAY, *others) if name in stands]
    slowest = {name: loops[name].slowest(points, decays[name]) for name in told}
    drives = {name: _drive(selection, stand) for name, stand in stands.items()}
    stages.next()
    shown = dict[str, Runs]()
    for name in told if runs else []:
        shown[name] = nonlinear_runs(loops[name], points[:runs], decays[name][:runs], duration)
    stages.next()
    known = {name: Place(name, decays[name], slowest[name][0], drives[name][0]) for name in told}
    stay, rest = known.get(STAY), [known[name] for name in told if name != STAY]
    unconfirmed = [name for name, each in shown.items() if each.confirming < MOST]
    tried = _tries(asked, known, unconfirmed)
    changed, gains = _changed(asked, known, loops, slowest, points) if tried else (None, {})
    if changed is not None and runs:
        confirmed = nonlinear_runs(changed[1], points[:runs], changed[0].decays[:runs], duration).confirming >= MOST
        changed = changed if confirmed else None
    stages.next()
    decision = decide(stay, rest, changed and changed[0], unconfirmed, tried=tried)
    places = tuple(
        _place(name, stands[name], loops[name], decays, slowest[name], drives[name], shown.get(name)) for name in told
    )
    return Verdict(
        word=decision.word,
        place=decision.place,
        reason=decision.reason,
        measure=_measure(decision, box, points, decays, stay) if decision.word == "cannot tell" else "",
        gains=gains if decision.word == "change gains" else {},
        places=places,
        settings=settings,
        uncertainty=uncertain,
        members=len(points),
        selection=selection,
        provenance=provenance(machine, members=members, runs=runs, duration=duration),
    )


def _selected(problem: Any, target: Any, constraints: Any, keywords: dict[str, Any]) -> Selection:
    """The problem's answer, or that of a machine with a target."""
    if isinstance(problem, AnyMachine):
        if target is None:
            raise_if_any(InputError, "verdict", [Fault("target", "is needed of a machine")])
        found = select(problem, cast(Vector, target), constraints=constraints, **keywords)
    else:
        brought = {"target": target, "constraints": constraints} | keywords
        sentence = "goes with a machine; the problem brings its own"
        faults = [Fault(name, sentence, shown(given)) for name, given in brought.items() if given is not None]
        raise_if_any(InputError, "verdict", faults)
        if isinstance(problem, Selection):
            found = problem
        elif isinstance(problem, SelectionProblem):
            found = solve_selection(problem)
        else:
            found = select(**problem.select_arguments())
    if found.problem.present_base is None:
        fault = Fault("base", "is needed: where the machine stands now, from which it may pay to move")
        raise_if_any(InputError, "verdict", [fault])
    return found


def _real(problem: Any, selection: Selection, loop: Any, ranges: Any) -> tuple[Loop, tuple[Uncertainty, ...]]:
    """The loop with the problem's control, and what is uncertain; both from where they are first given."""
    machine, control = selection.problem.machine, selection.problem.control
    own = cast("Loop | None", loop or getattr(problem, "loop", None) or machine.loop) or Loop()
    own = under_control(own, machine, control, "verdict")
    # Gains that were chosen with the best configuration are those that the machine would have.
    gains = dict(selection.gains[0]) if isinstance(selection, OutcomeSelection) else dict[str, float]()
    own = own.model_copy(update={name: (gain,) for name, gain in gains.items()})
    return own, ranges or getattr(problem, "uncertainty", None) or machine.uncertainty or GROUND


def _stands(selection: Selection) -> dict[str, Evaluation]:
    """Configurations by name, the present one first where it reaches the target."""
    found = {} if selection.initial is None else {STAY: selection.initial}
    return found | {f"candidate {k}": each.evaluation for k, each in enumerate(selection.candidates[:LOOKED], start=1)}


def _drive(selection: Selection, stand: Evaluation) -> tuple[float, float]:
    """From the present placement, m and rad."""
    now = selection.problem.present_base
    assert now is not None
    away = dict(zip(stand.base_coordinates, (stand.base - now).tolist(), strict=True))
    turn = abs(math.remainder(away.pop("yaw", 0.0), math.tau))
    return math.hypot(*away.values()), turn


def _tries(asked: Loop, known: Mapping[str, Place], unconfirmed: Sequence[str]) -> bool:
    """Whether other gains are looked for: where ranges are given, or no place can be had with these."""
    return bool(gain_ranges(asked)) or not any(
        place.holds and place.name not in unconfirmed for place in known.values()
    )


def _changed(
    asked: Loop,
    known: Mapping[str, Place],
    loops: Mapping[str, UncertainLoop],
    slowest: Mapping[str, tuple[float, Vector]],
    points: Vector,
) -> tuple[tuple[Place, UncertainLoop] | None, dict[str, list[float]]]:
    """The place that is best with other gains, its loop, and the gains; the present one where it is nearly as good.

    Gains are those of `[loop]`'s ranges; without ranges, all gains times a factor.
    """
    found = list[tuple[Place, UncertainLoop]]()
    for name, place in known.items():
        few = np.concatenate([loops[name].box.corners(CORNERED), slowest[name][1][None]])
        best = best_gains(loops[name], asked, few)
        decays = best.decays(points)
        found.append((Place(name, decays, best.slowest(points, decays)[0], place.drive), best))
    most = max(place.slowest for place, _ in found)
    near = [each for each in found if each[0].slowest >= most - FASTER * abs(most)]
    place, loop = min(near, key=lambda each: each[0].drive)
    names = ("kp", "kv", *(["ki"] if loop.settings.feedback == "pid" else []))
    return (place, loop), {name: getattr(loop.settings, name).tolist() for name in names}


def _place(
    name: str,
    stand: Evaluation,
    loop: UncertainLoop,
    decays: Mapping[str, Vector],
    slowest: tuple[float, Vector],
    drive: tuple[float, float],
    runs: Runs | None,
) -> PlaceVerdict:
    few = [None, *loop.box.corners(CORNERED), slowest[1]]
    outcomes = [loop.outcome(u) for u in few]
    own = decays[name]
    nominal = outcomes[0].decay().value
    stay = decays.get(STAY)
    return PlaceVerdict(
        name=name,
        base=stand.base,
        posture=stand.posture,
        w=stand.w,
        drive=drive[0],
        turn=drive[1],
        decay=Band(nominal, slowest[0], float(own.max())),
        stable_share=float(np.mean(own > 0)),
        slowest_at=loop.box.told(slowest[1]),
        slowest_hz=outcomes[-1].loop.frequency_hz,
        better=math.nan if stay is None else float(np.mean(faster(own, stay))),
        allowed_gain=_band([outcome.allowed_gain().value for outcome in outcomes]),
        delay_margin=_band([outcome.delay_margin().value for outcome in outcomes]),
        settling=_band([outcome.settling().value for outcome in outcomes]),
        swing=_band([MOVE * outcome.swing().value for outcome in outcomes]),
        swing_unit="rad" if outcomes[0].motions.loop.shape.base_hinges else "m",
        runs=runs,
    )


def _band(values: Sequence[float]) -> Band:
    """NaN at an end where one of them is none: of a loop that grows there is no margin, and no settling."""
    return Band(values[0], float(np.min(values)), float(np.max(values)))


def _measure(
    decision: Decision, box: UncertaintyBox, points: Vector, decays: Mapping[str, Vector], stay: Place | None
) -> str:
    """Which uncertain number decides."""
    name = decision.place or max(decays, key=lambda each: float(decays[each].min()))
    values = decays[name] - (0.0 if stay is None or name == stay.name else stay.decays)
    # What has one sign everywhere no measurement changes.
    which, rank = matters_most(box, points, values.tolist()) if values.min() < 0 < values.max() else ("", 0.0)
    if not which:
        return ""
    what = "its decay" if stay is None or name == stay.name else "what is gained by moving there"
    return f"to tell, measure {which}: at {name} {what} goes with it (rank correlation {rank:+.2f})"
