"""The article's nullspace law: move the base along the redundancy, uphill on V, while the end-point stays put.

In: a machine and a posture. Out: a `BaseTrajectory`. With z = [base, actuated joints], ξ = ∂V/∂z and J_B = ∂r/∂z the
law moves z by (I − J_B⁺ J_B) kξ ξ each sample (article, section 4). Steps are shortened where a limit asks for it;
after each one the joints, and they alone, are corrected by Newton's method until r(z) is back on its target.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, cast

import numpy as np

from flexopt.errors import NoSolutionFound
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import BaseLike, BaseRangeLike, MatrixLike, PostureLike, Vector
from flexopt.foundation.boundary import ArgumentCheck, by, number, of_machine, public, words
from flexopt.foundation.control import Control
from flexopt.foundation.coordinates import turned_into
from flexopt.foundation.documents import provenance
from flexopt.foundation.quantities import DURATION, Quantity, each_named, entries, vector
from flexopt.model import AnyMachine
from flexopt.model.choices import BASE_ACCELERATION, BASE_RATE, SINGULARITY_MARGIN_DEG
from flexopt.model.loop import control_of
from flexopt.plant.reach import outer_reach
from flexopt.robustness.evaluation import Evaluation
from flexopt.selection.nullspace.base_trajectory import BaseTrajectory, Descent, Stop
from flexopt.selection.nullspace.law import NullspaceLaw, PathPoint, climb, retime
from flexopt.selection.objective import Quantities, quantities, read_objectives

OnDescent = Literal["stop", "continue"]
SAMPLES_MAX = 1_000_000
# The default kξ climbs a hill as wide as the arm and as high as V's size with this time constant, s.
CLIMB_TIME = 0.5
# The default min_gain, of V's size, 1/s.
GAIN_SHARE = 1e-6
# Rounding in V, relative to its size.
ROUNDING = 1e-12


def _k_xi(value: Any, names: tuple[str, ...]) -> Vector:
    """kξ as a matrix (n_z, n_z)."""
    n_z, high = len(names), 1e30
    if not isinstance(value, list | tuple):
        return np.eye(n_z) * Quantity("", above=0.0, high=high)(value)
    rows, entry = entries(value), Quantity("", low=-high, high=high)
    shape = f"must be a positive number, {n_z} numbers ({', '.join(names)}), or {n_z} rows of {n_z}"
    if len(rows) != n_z:
        raise ValueError(shape)
    if not any(isinstance(row, list | tuple) for row in rows):
        matrix = np.diag(each_named(entry, rows, names))
    else:
        if any(len(entries(row)) != n_z for row in rows):
            raise ValueError(shape)
        labels = [f"row {a}, column {b}" for a in names for b in names]
        flat = each_named(entry, [x for row in rows for x in row], labels)
        matrix = np.array(flat).reshape(n_z, n_z)
    if not np.any(matrix):
        raise ValueError("must not be zero: nothing would move")
    return matrix


def _metric(value: Any, names: tuple[str, ...]) -> Vector:
    """Diagonal of the metric (n_z,)."""
    what = f"{len(names)} numbers, one for each of {', '.join(names)}"
    return np.array(vector(what, Quantity("", low=1e-12, high=1e12), names)(value))


def _named(check: Callable[[Any, tuple[str, ...]], Any]) -> ArgumentCheck:
    """A check that asks the names of z."""

    def asked(arguments: Arguments, machine: AnyMachine, field: str, value: Any) -> Any:
        names = (*machine.base_coordinates, *machine.joints)
        return arguments.checked(field, value, lambda v: check(v, names), None)

    return of_machine(asked)


def _together(arguments: Arguments, given: Mapping[str, Any]) -> None:
    machine = arguments.of
    if machine is not None and given["objective"] is not None:
        more = read_objectives(arguments, machine, given["objective"], given["weights"])[1:]
        if more:
            arguments.note("objective", "must be a single one: the law climbs one V", given["objective"])
    if given["duration"] and given["rate"] and given["duration"] * given["rate"] > SAMPLES_MAX:
        arguments.note("duration", f"times rate must be at most {SAMPLES_MAX} samples", given["duration"])
    if machine is None or arguments.faulty("base"):
        return
    within = _ends(machine, given["base_range"])
    placement = _placement(machine, given["base"], within)
    ends = zip(placement, *within, strict=True)
    for name, unit, (x, low, high) in zip(machine.base_coordinates, machine.base_units, ends, strict=True):
        if not low <= x <= high:
            arguments.note("base", f"must lie in base_range, {name} {low:g} to {high:g} {unit}", placement)


@public(
    step_gain=_named(_k_xi),
    metric=_named(_metric),
    rate=number("Hz", above=0.0, high=1e5),
    max_base_rate=by(BASE_RATE),
    max_turn_rate=by(BASE_RATE),
    max_joint_rate=number("rad/s or m/s", above=0.0, high=1e3),
    max_base_acceleration=by(BASE_ACCELERATION),
    min_gain=number("1/s", low=0.0, high=1e6),
    duration=by(DURATION),
    on_descent=words("stop", "continue"),
    together=_together,
)
def nullspace_trajectory(
    machine: AnyMachine,
    posture: PostureLike,
    *,
    base: BaseLike | None = None,
    objective: str = "w1",
    weights: Sequence[float] | None = None,
    control: Control | None = None,
    gain: float = 5e5,
    gravity: bool = False,
    step_gain: MatrixLike | None = None,
    metric: Sequence[float] | None = None,
    rate: float = 200.0,
    max_base_rate: float = 0.25,
    max_turn_rate: float = 0.25,
    max_joint_rate: float = 1.0,
    max_base_acceleration: float | None = None,
    base_range: BaseRangeLike | None = None,
    singularity_margin_deg: float = SINGULARITY_MARGIN_DEG,
    min_gain: float | None = None,
    duration: float = 60.0,
    on_descent: OnDescent = "stop",
) -> BaseTrajectory:
    """Drive the base uphill on V with the end-point in its place: Δq_d = S (I − J_B⁺ J_B) kξ ξ at every sample.

    J_B⁺ and the projector weigh metres against radians: in the coordinates √metric · z the law is the one above, so
    Δz = W^(−1/2) (I − Ĵ⁺ Ĵ) kξ W^(−1/2) ξ with Ĵ = J_B W^(−1/2), W = diag(metric). By default W = I in SI, as in the
    article: one metre counts as much as one radian. A scalar kξ never descends; a matrix may, which is seen before the
    step from ξᵀ Δz < 0. A step is shortened as a whole, so that the end-point stays: to the rates, to the end of
    `base_range` exactly, and before V would pass a maximum or a kink.

    Args:
        machine: from `flexopt.load`.
        posture: actuated joints at the start (n,), rad or m; with `base` it says where the end-point stays.
        base: placement at the start (n_b,), m or rad; zero by default.
        objective: `"w1"`, `"w2"`, …, `"epsilon_max"`, or `"V"` = Σ αi wi + β ε_max.
        weights: α of `"V"`, and β after them, as in `flexopt.build_selection`.
        control: Jacobian `"inverse"`, `"transpose"` or `"damped:LAMBDA"`, as in `flexopt.evaluate`; by default that of
            the machine's loop.
        gain: servo gain kr of ε_max.
        gravity: measures and end-point under static deflection.
        step_gain: kξ for each sample: a positive scalar, (n_z,) for a diagonal, or (n_z, n_z), n_z = n_b + n. By
            default the scalar L² / (size · 0.5 s · rate), L the arm's reach, size = Σ αi |a_i||b_i| + β at the start.
        metric: diagonal of W, (n_z,), positive, 1/m² and 1/rad², the joints' after the placement's.
        rate: samples a second, Hz.
        max_base_rate: greatest speed of the base over the ground, m/s;  max_turn_rate: of its yaw, rad/s.
        max_joint_rate: of each joint, rad/s (slides: m/s), corrections aside.
        max_base_acceleration: along the base's path over the ground, m/s²; turning is not counted. If given, the path
            is timed anew: it starts and ends at rest and is nowhere faster than the law. By default the base starts and
            stops at once.
        base_range: where the base may go, as in `flexopt.build_selection`; everywhere by default.
        singularity_margin_deg: as in `flexopt.build_selection`.
        min_gain: stop when the law's step changes V by less, V's unit per second; 1e-6 of the size above by default.
        duration: latest end, s.
        on_descent: `"stop"` before a step with ξᵀ Δz < 0, or `"continue"`; descents are recorded in the result.

    Raises:
        InputError: arguments of wrong shape, not finite or out of range, all in one message.
        SingularPosture: Jv loses rank at the start.
        NoSolutionFound: V cannot be computed at the start.

    Source: ASME Letters in Dynamic Systems and Control 1(2), 021001, section 4.

    Example:
        >>> machine = flexopt.load("excavator")
        >>> climb = flexopt.nullspace_trajectory(machine, (0.9929, -2.6306), base_range=(-1.5, 0.0), duration=2.0)
        >>> bool(climb.V[-1] > climb.V[0])
        True
        >>> climb.stop.value
        'the duration is over'
    """
    lower, upper = _ends(machine, cast("Mapping[str, tuple[float, float]] | None", base_range))
    placement = _placement(machine, cast("Vector | None", base), (lower, upper))
    held = cast(Vector, posture)
    goal = read_objectives(Arguments("nullspace_trajectory", machine), machine, objective, weights)[0]
    w = np.ones(placement.size + held.size) if metric is None else np.asarray(metric)
    margin = math.radians(singularity_margin_deg)

    control = control_of(control, None, machine)
    functions = quantities(machine, control, gravity, gain)
    start = np.concatenate([placement, held])
    initial = functions.evaluated(start)
    size = float(np.dot(goal.alpha, initial.scale)) + goal.beta or 1.0
    k_xi = _climbing_gain(functions, size, rate) if step_gain is None else cast(Vector, step_gain)
    least = GAIN_SHARE * size if min_gain is None else min_gain
    law = NullspaceLaw(
        functions=functions,
        objective=goal,
        k_xi=k_xi,
        root=np.sqrt(w),
        target=initial.end_point,
        rate=rate,
        base_step=max_base_rate / rate,
        turn_step=max_turn_rate / rate,
        joint_step=max_joint_rate / rate,
        lower=lower,
        upper=upper,
        sine_squared=math.sin(margin) ** 2,
    )
    first = law.point(start)
    _check_start(law, first, initial, margin)
    points, stop = climb(law, first, least, int(duration * rate + 1e-9), on_descent == "stop")
    if max_base_acceleration is not None:
        points, cut = retime(law, points, max_base_acceleration, duration)
        stop = Stop.DURATION if cut else stop

    options = {"base": placement.tolist(), "posture": held.tolist(), "objective": goal.name}
    options |= {"weights": goal.weights.tolist(), "control": control, "gain": gain, "gravity": gravity}
    options |= {"step_gain": k_xi.tolist(), "metric": w.tolist(), "rate": rate, "max_base_rate": max_base_rate}
    options |= {"max_turn_rate": max_turn_rate, "max_joint_rate": max_joint_rate}
    options |= {"max_base_acceleration": max_base_acceleration}
    ends = dict(zip(machine.base_coordinates, zip(lower.tolist(), upper.tolist(), strict=True), strict=True))
    options |= {"base_range": None if base_range is None else ends}
    options |= {"singularity_margin_deg": math.degrees(margin), "min_gain": least, "duration": duration}
    return _trajectory(law, points, stop, initial, size, provenance(machine, **options, on_descent=on_descent))


def _climbing_gain(functions: Quantities, size: float, rate: float) -> Vector:
    """The default kξ (n_z, n_z) for each sample."""
    plant = functions.measures.plant
    length = outer_reach(plant)[1] or 1.0
    return np.eye(plant.n_base + plant.n_actuated) * (length**2 / (size * CLIMB_TIME * rate))


def _trajectory(
    law: NullspaceLaw, points: list[PathPoint], stop: Stop, initial: Evaluation, size: float, origin: dict[str, Any]
) -> BaseTrajectory:
    """The result, from its samples."""
    machine, n_base = law.plant.machine, law.plant.n_base
    z, values = np.array([point.z for point in points]), np.array([point.value for point in points])
    predictions = np.array([point.gradient @ law.step(point)[0] for point in points])
    falls = np.flatnonzero(np.diff(values) < -ROUNDING * size).tolist()
    off = np.array([point.end_point - law.target for point in points])
    return BaseTrajectory(
        machine=machine.name,
        model=machine,
        objective=law.objective.name,
        control=law.functions.measures.control,
        base_coordinates=machine.base_coordinates,
        joints=machine.joints,
        target=law.target,
        time=np.arange(len(points)) / law.rate,
        base=z[:, :n_base],
        base_rate=np.vstack([np.diff(z[:, :n_base], axis=0) * law.rate, np.zeros((1, n_base))]),
        posture=z[:, n_base:],
        V=values,
        gradient=np.array([point.gradient for point in points]),
        prediction=predictions,
        end_point_error=np.sqrt(np.sum(off**2, axis=1)),
        stop=stop,
        descents=tuple(Descent(k, float(values[k] - values[k + 1]), bool(predictions[k] < 0)) for k in falls),
        initial=initial,
        final=law.functions.evaluated(points[-1].z),
        provenance=origin,
    )


def _check_start(law: NullspaceLaw, start: PathPoint, initial: Evaluation, margin: float) -> None:
    if law.objective.has_kinks and initial.epsilon_max is None:
        raise NoSolutionFound(f"V at the start: {'; '.join(initial.warnings)}", violations={}, iterate={})
    refused = law.refuses(start)
    if refused is Stop.UNSOLVED:
        raise NoSolutionFound("V or its gradient is no number at the start", violations={}, iterate={})
    if refused is Stop.SINGULAR:
        arguments = Arguments("nullspace_trajectory")
        sentence = f"comes closer than {math.degrees(margin):.4g}° to a singular posture; bend the arm or allow it by "
        sentence += "singularity_margin_deg"
        arguments.note("posture", sentence, start.z[law.plant.n_base :])
        arguments.done()


def _placement(machine: AnyMachine, base: Vector | None, ends: tuple[Vector, Vector]) -> Vector:
    """Where the base stands at the start, (n_b,), told by the whole turns that its ends allow."""
    return turned_into(np.zeros(len(machine.base_coordinates)) if base is None else base, ends, machine.base_units)


def _ends(machine: AnyMachine, ranges: Mapping[str, tuple[float, float]] | None) -> tuple[Vector, Vector]:
    """Lower and upper ends for each base coordinate, (n_b,) each."""
    ends = [(ranges or {}).get(name, (-math.inf, math.inf)) for name in machine.base_coordinates]
    lower, upper = np.array(ends).reshape(-1, 2).T
    return lower, upper
