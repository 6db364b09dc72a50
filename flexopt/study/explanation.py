"""Why a posture is good or bad, mode by mode, and what to move and which way: `flexopt.explain`."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from flexopt.errors import FlexoptWarning
from flexopt.foundation.arrays import BaseLike, PostureLike, Vector
from flexopt.foundation.boundary import public
from flexopt.foundation.control import Control
from flexopt.foundation.doubt import in_degrees
from flexopt.foundation.pictures import Pictured
from flexopt.foundation.results import Result
from flexopt.loop.evaluation import Outcome, swing_of
from flexopt.model import AnyMachine
from flexopt.model.loop import LoopLike
from flexopt.plant.reach import arm_length
from flexopt.robustness import Evaluation, Measures, build_measures, evaluate
from flexopt.robustness.evaluation import unreached
from flexopt.robustness.plausibility import warn_implausible
from flexopt.robustness.residues import residue_unit
from flexopt.selection.proof.nonnegative import nonnegative_least_squares

ModeStatus = Literal[
    "move", "stationary", "optimum", "at a limit", "end-point fixed", "singular", "shared", "unexcited"
]

# Slopes of w_i along all that keeps the end-point, below this share of |a_i||b_i| per rad or arm's length, are what
# solving for a posture and rounding leave: verified optima have some 1e-11 of it, other postures 1e-2 to 10.
STATIONARY = 1e-8
# A measure of at most this share of |a_i||b_i| below 0 is as good as 0, its greatest value.
NOTHING = 1e-12
# Singular values of the end-point's motion below this share of the largest are none; limits nearer than this, m or rad,
# hold: postures that were solved for stand beside theirs by rounding.
DEPENDENT, AT_LIMIT = 1e-9, 1e-6
# Modes whose frequencies are so near, as a share, trade their shapes where the posture changes by little.
NEIGHBOURS = 0.01
WHY: Mapping[ModeStatus, str] = {
    "stationary": "to first order no motion that keeps the end-point changes it: an optimum, or another point where "
    "its slope is nothing to rounding (`flexopt select` tells which)",
    "optimum": "it is 0, its greatest value",
    "at a limit": "what would raise it while the end-point stays goes beyond joint limits",
    "end-point fixed": "nothing can be moved without moving the end-point",
    "singular": "here the end-point cannot be moved every way, and to first order nothing says how to keep it",
    "shared": "its frequency is that of another mode, too: only the sum of both means something",
    "unexcited": "the end-point does not see it, or does not excite it",
}


@dataclass(frozen=True)
class ModeMove(Result):
    """What raises one w_i most while the end-point stays, the passive coordinates settled.

    The direction is the projection of ∂w_i/∂z, z = [base, posture], onto all motions that keep the end-point and do not
    pass joint limits; metres count in lengths of the arm, so that they compare with radians.

    Attributes:
        status: `"move"`, or why there is no direction.
        variable: what moves most, a joint or a coordinate of the base; None where nothing does. unit: its own.
        direction: all of z for each unit of it, (n_b + n,), its own entry 1 or −1; NaN where there is none.
        rate: ∂w_i along it, for each unit, positive.
        effects: ∂w of each mode along it, (m,).
        room: how far it may go, in its unit, until the first joint meets a limit, along the straight line; infinite
            (JSON: null) without limits.
    """

    DOCUMENT = "status variable unit direction rate effects room"

    status: ModeStatus
    variable: str | None
    unit: str
    direction: Vector
    rate: float
    effects: Vector
    room: float

    @property
    def why(self) -> str:
        """Why there is nothing to move; empty where there is."""
        return WHY.get(self.status, "")


@dataclass(frozen=True)
class Explanation(Pictured, Result):
    """Why a posture is good or bad. m modes, ordered by frequency; r task rows. SI and radians.

    Attributes:
        evaluation: the posture, its modes and w, as of `flexopt.evaluate`; its `scale`, here size, is |a_i||b_i|,
            how strongly the end-point sees and excites the mode.
        w_unit: of w and size, in words where rows differ.
        angle: between a_i, how the end-point moves in the mode, and b_i, how its feedback acts on it, (m,), rad;
            w_i = −2 |a_i||b_i| sin²(angle/2) for two and more task rows. NaN where frequencies are shared.
        a, b: (r, m).
        moves: for each mode what to move and which way.
        model: the machine.

    Its picture shows for each mode a_i and b_i, each of length 1, at the end-point, and how far every coordinate goes.

    Example:
        >>> found = flexopt.explain(flexopt.load("excavator"), [0.9929, -2.6306])
        >>> found.moves[0].status, found.moves[0].variable
        ('move', 'boom')
    """

    DOCUMENT = """
    machine=evaluation.machine control=evaluation.control base=evaluation.base
    base_coordinates=evaluation.base_coordinates base_units=evaluation.base_units posture=evaluation.posture
    joints=evaluation.joints joint_units=evaluation.joint_units end_point=evaluation.end_point[m] variables
    variable_units frequencies_hz=evaluation.frequencies_hz[Hz] damping_ratios=evaluation.damping_ratios
    w=evaluation.w w_unit size=evaluation.scale angle[rad] a b moves outcome sentences
    provenance=evaluation.provenance
    """

    evaluation: Evaluation
    w_unit: str
    angle: Vector
    a: Vector
    b: Vector
    moves: tuple[ModeMove, ...]
    model: AnyMachine = field(repr=False)

    @property
    def variables(self) -> tuple[str, ...]:
        """Coordinates of the base, then actuated joints: z = [base, posture]."""
        return self.evaluation.gradient.variables

    @property
    def variable_units(self) -> tuple[str, ...]:
        """M or rad, of each."""
        return (*self.evaluation.base_units, *self.evaluation.joint_units)

    @property
    def outcome(self) -> Outcome | None:
        """What the loop allows and does; None without a loop."""
        found = self.evaluation.outcome
        return found if isinstance(found, Outcome) else None

    @property
    def sentences(self) -> tuple[str, ...]:
        """All of it in words, for each mode."""
        parts = ((self._measure(i), self._loop(i), self._move(i, move)) for i, move in enumerate(self.moves))
        return tuple(" ".join(part for part in of_mode if part) for of_mode in parts)

    def __repr__(self) -> str:
        of = self.evaluation
        named = zip(self.variables, (*of.base, *of.posture), self.variable_units, strict=True)
        point = ", ".join(f"{x:z.4f}" for x in of.end_point)
        head = f"  mode   frequency    damping        |a||b|    angle             w   [{self.w_unit}]"
        gain = "" if self.outcome is None else self.outcome.settings.force_units[1]
        wide = max(12, len(gain) + 3)
        told = f"{f'κ, {gain}':>{wide}} {'reserve':>8} {'1st order':>13}" if gain else ""
        lines = [
            f"{of.machine}, Jacobian {of.control} control: "
            + ", ".join(f"{name} {value:z.4f} {unit}" for name, value, unit in named)
            + f"; end-point ({point}) m",
            f"{head} {told}".rstrip(),
        ]
        for i, w in enumerate(of.w):
            row = (
                f"  {i + 1:4d} {of.frequencies_hz[i]:8.4f} Hz {of.damping_ratios[i]:10.3e} {of.scale[i]:13.5e} "
                f"{in_degrees(self.angle[i], 8, 2)} {w:13.5e}"
            )
            if self.outcome is not None:
                row += f"{'':{len(self.w_unit) + 5}} {self.outcome.allowance[i]:{wide}.4g} "
                row += f"{in_degrees(self.outcome.lag_reserve[i], 8, 1)} "
                row += f"{self.outcome.first_order_decay[i]:+9.4g} 1/s"
            lines.append(row)
        lines += [f"Mode {i}: {sentence}" for i, sentence in enumerate(self.sentences, 1)]
        if self.outcome is not None:
            verb = "decays" if self.outcome.decay > 0 else "grows"
            lines.append(f"All together, with this loop: it {verb} at {abs(self.outcome.decay):.4g}/s.")
        return "\n".join(lines)

    def _measure(self, i: int) -> str:
        hertz, w, size = self.evaluation.frequencies_hz[i], self.evaluation.w[i], self.evaluation.scale[i]
        first = f"{hertz:.4g} Hz, damping ratio {self.evaluation.damping_ratios[i]:.3g}."
        if math.isnan(self.angle[i]):
            return first
        share = f"w{i + 1} = {w:.4g} {self.w_unit}, {w / size:+.3g} of |a||b|"
        degrees = math.degrees(self.angle[i])
        if len(self.evaluation.end_point) > 1 and w >= -NOTHING * size:
            why = "good: a and b point the same way, and no velocity feedback, whatever its gains, excites it"
        elif degrees < 90:
            unequal = "equal gains in all rows damp it, some unequal ones excite it"
            if self.evaluation.in_phase_strict[i]:
                unequal = "gains of the rows damp it, equal or not; some that couple rows excite it"
            why = f"a and b are {degrees:.3g}° apart: {unequal}"
        else:
            why = f"bad: a and b are {degrees:.3g}° apart: velocity feedback with equal gains takes damping from it"
        if len(self.evaluation.end_point) == 1:
            why = "good: velocity feedback damps it" if w > 0 else "bad: velocity feedback takes damping from it"
        return f"{first} {share}; {why}."

    def _loop(self, i: int) -> str:
        if self.outcome is None or math.isnan(self.outcome.lag_reserve[i]):
            return ""
        of, settings = self.outcome, self.outcome.settings
        gain, unit = (settings.servo_gain or 1.0) * float(settings.kv.max()), settings.force_units[1]
        allowed = of.allowance[i]
        against = "no velocity gain is too much without lag" if math.isinf(allowed) else (
            f"velocity gain {gain:.4g} {'below' if gain < allowed else 'above'} the allowance κ = {allowed:.4g} {unit}"
        )  # fmt: skip
        lag, reserve = math.degrees(of.lag[i]), math.degrees(of.lag_reserve[i])
        effect = "equal gains damp it" if reserve > 0 else "equal gains feed it"
        decay = of.first_order_decay[i]
        told = f"{'decays' if decay > 0 else 'grows'} at {abs(decay):.4g}/s"
        fails = of.first_order_fails[i]
        despite = f": {of.despite_reserve}" if reserve < 0 < decay and not fails else ""
        exact = of.mode_decay[i]
        if math.isfinite(exact):
            swing = swing_of(of.frequencies_hz[i], of.damping_ratios[i])
            despite += f"; exactly, it swings at {swing:.4g} Hz and {'decays' if exact > 0 else 'grows'} at "
            despite += f"{abs(exact):.4g}/s"
            despite += f": {of.why_first_order_fails}" if fails else ""
        return (
            f"With this loop: {against}; the feedback lags by {lag:.4g}°, a reserve of {reserve:.4g}°, so that "
            f"{effect}; to first order it {told}{despite}."
        )

    def _move(self, i: int, move: ModeMove) -> str:
        if move.variable is None:
            return f"Nothing to move for w{i + 1}: {move.why}."
        names = self.variables
        lead = names.index(move.variable)
        sign = "positive" if move.direction[lead] > 0 else "negative"
        others = [
            f"{name} {rate:+.4g} {unit}"
            for name, rate, unit in zip(names, move.direction, self.variable_units, strict=True)
            if name != move.variable and abs(rate) > DEPENDENT
        ]
        which = "the base's " if move.variable in self.evaluation.base_coordinates else ""
        keeping = f" with {', '.join(others)} for each {move.unit}, so that the end-point stays" if others else ""
        worse = [
            f"w{j + 1} by {-effect:.4g}" for j, effect in enumerate(move.effects) if effect < -STATIONARY * move.rate
        ]
        cost = f", while it lowers {', '.join(worse)}" if worse else ""
        room = "" if math.isinf(move.room) else f"; a joint meets its limit after some {move.room:.3g} {move.unit}"
        return (
            f"Move {which}{move.variable} the {sign} way{keeping}: to first order this raises w{i + 1} by "
            f"{move.rate:.4g} {self.w_unit} per {move.unit}{cost}{room}.{self._neighbours(i)}"
        )

    def _neighbours(self, i: int) -> str:
        hertz = self.evaluation.frequencies_hz
        near = [j for j in range(len(hertz)) if j != i and abs(hertz[j] - hertz[i]) <= NEIGHBOURS * hertz[i]]
        if not near:
            return ""
        names = " and ".join(f"w{j + 1}" for j in sorted([i, *near]))
        apart = max(abs(hertz[j] - hertz[i]) for j in near) / hertz[i]
        return (
            f" That holds for small steps only: {names} are of modes whose frequencies lie {100 * apart:.2g} % "
            "apart and which mix as the posture changes; judge them together."
        )


@public()
def explain(
    machine: AnyMachine,
    posture: PostureLike,
    *,
    base: BaseLike | None = None,
    control: Control | None = None,
    gravity: bool = False,
    loop: LoopLike | None = None,
) -> Explanation:
    """Why a posture is good or bad: for each mode its size, angle, damping and lag, and what to move and which way.

    R_i = a_i b_iᵀ; w_i = a_i·b_i − |a_i||b_i| is 0 where a_i and b_i point the same way, and the more negative the
    larger the mode and the angle between them. Directions are first order: exact gradients, projected onto what keeps
    the end-point.

    Args:
        machine, posture, base, control, gravity, loop: as of `flexopt.evaluate`. With a loop, its own or the machine's,
            the damping against it (allowance κ_i) and the lag reserve are told, too.

    Raises:
        InputError, SingularPosture, NoSolutionFound: as `flexopt.evaluate`.

    Example:
        >>> import flexopt
        >>> found = flexopt.explain(flexopt.load("excavator"), (0.9929, -2.6306))
        >>> found.moves[0].status, found.moves[0].variable
        ('move', 'boom')
    """
    warn_implausible(machine)
    with warnings.catch_warnings():
        # Of ε_max, which nobody asked for; of shared frequencies, which the result tells itself.
        warnings.simplefilter("ignore", FlexoptWarning)
        stand = evaluate(machine, posture, base=base, control=control, gravity=gravity, loop=loop)
    measures = build_measures(machine, stand.control, gravity)
    at = {"base": stand.base, "posture": stand.posture, "p": measures.plant.parameter_values}
    held: dict[str, Any] = measures.values(**at)
    a, b = held["a"].full(), held["b"].full()
    shared = {i for group in stand.clusters for i in group}
    hidden = unreached(stand.scale)
    angle = np.array([math.nan if i in shared or hidden[i] else _angle(a[:, i], b[:, i]) for i in range(len(stand.w))])
    unit = residue_unit(stand.control, machine.joint_units)
    unit = "in mixed units" if unit == "mixed" else unit
    return Explanation(stand, unit, angle, a, b, tuple(_moves(machine, measures, stand, shared)), machine)


def _angle(a: Vector, b: Vector) -> float:
    """Between two vectors, rad, to all digits near 0 and π, too (Kahan); NaN where one is nothing."""
    lengths = float(np.linalg.norm(a)), float(np.linalg.norm(b))
    if not min(lengths) > 0:
        return math.nan
    along, across = a / lengths[0], b / lengths[1]
    return 2 * math.atan2(float(np.linalg.norm(along - across)), float(np.linalg.norm(along + across)))


def _moves(machine: AnyMachine, measures: Measures, stand: Evaluation, shared: set[int]) -> Iterator[ModeMove]:
    """For each mode what raises its measure most."""
    plant, names = measures.plant, stand.gradient.variables
    units = (*stand.base_units, *stand.joint_units)
    z = stand.z
    free = np.full((len(stand.base), 2), [-math.inf, math.inf])
    limits = np.concatenate([free, np.array(machine.limits, dtype=np.float64).reshape(-1, 2)])
    scale = np.array([1.0 if unit == "rad" else arm_length(plant) for unit in units])
    slope = measures.end_point_gradient.call([stand.base, stand.posture, plant.parameter_values])[0].full() * scale
    _, sizes, rows = np.linalg.svd(slope)
    rank = int(np.sum(sizes > DEPENDENT * sizes.max(initial=0.0)))
    kept = rows[rank:].T
    at_low, at_high = z - limits[:, 0] <= AT_LIMIT * scale, limits[:, 1] - z <= AT_LIMIT * scale
    walls = np.concatenate([np.eye(len(z))[at_low], -np.eye(len(z))[at_high]])

    def none(status: ModeStatus) -> ModeMove:
        nothing: Vector = np.full(len(stand.w), math.nan)
        return ModeMove(status, None, "", np.full(len(z), math.nan), math.nan, nothing, math.nan)

    hidden = unreached(stand.scale)
    for i, (w, size) in enumerate(zip(stand.w, stand.scale, strict=True)):
        whole = stand.gradient.w[i] * scale
        if i in shared:
            yield none("shared")
        elif hidden[i]:
            yield none("unexcited")
        elif plant.n_task > 1 and w >= -NOTHING * size:
            yield none("optimum")
        elif rank < plant.n_task:
            yield none("singular")
        elif not kept.shape[1]:
            yield none("end-point fixed")
        elif np.linalg.norm(kept.T @ whole) <= STATIONARY * size:
            yield none("stationary")
        else:
            step = kept @ _inside(kept.T @ whole, walls @ kept)
            if np.linalg.norm(step) <= STATIONARY * size:
                yield none("at a limit")
                continue
            lead = int(np.argmax(np.abs(step)))
            direction = step * scale / abs(step[lead] * scale[lead])
            effects = stand.gradient.w @ direction
            effects[list(shared)] = math.nan
            room = _room(z, direction, limits)
            yield ModeMove("move", names[lead], units[lead], direction, float(effects[i]), effects, room)


def _inside(slope: Vector, walls: Vector) -> Vector:
    """The point of the cone walls @ y ≥ 0 that is nearest to a slope: slope + wallsᵀ λ, λ ≥ 0 (Moreau)."""
    if not len(walls):
        return slope
    return slope + walls.T @ nonnegative_least_squares(walls.T, -slope)


def _room(z: Vector, direction: Vector, limits: Vector) -> float:
    """How many units of the direction until the first coordinate meets a limit."""
    ends = np.where(direction > 0, limits[:, 1], limits[:, 0])
    moving = np.abs(direction) > DEPENDENT
    return float(np.min((ends - z)[moving] / direction[moving], initial=math.inf))
