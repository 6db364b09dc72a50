"""The nullspace law itself: its step at a point, the limits that shorten it, and the walk along the redundancy.

In: the Functions of a machine, an objective, a gain matrix. Out: points z = [base, posture] with r(z) = target, one
after another, and why they end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.algebra.feasible import shortest_steps
from flexopt.compiled import accelerate
from flexopt.foundation.arrays import Vector
from flexopt.foundation.control import Control
from flexopt.foundation.kept import by_structure
from flexopt.model import AnyMachine
from flexopt.plant.inverse_kinematics import inside_limits
from flexopt.plant.plant import Plant
from flexopt.robustness.margin import build_margin
from flexopt.robustness.measures import build_measures
from flexopt.selection.nullspace.base_trajectory import Stop, retimed
from flexopt.selection.objective import KINK, Objective, Quantities

# A step is halved so often at most: a limit, a kink or a summit is then nearer than a thousandth of it.
HALVINGS = 10
# The base is at the end of its range where less of a step than this is left.
NO_ROOM = 1e-9
# Rounding in ξᵀ Δz, relative to |ξ||kξ ξ|.
ROUNDING = 1e-12


@dataclass(frozen=True)
class PathPoint:
    """A point z of the path: V, how far the next branch of ε_max is above it, ξ, r, J_B, and sin² of the margin."""

    z: Vector
    value: float
    gap: float
    gradient: Vector
    end_point: Vector
    jacobian: Vector
    sine_squared: float


@dataclass(frozen=True)
class NullspaceLaw:
    """Δz = W^(−1/2) (I − Ĵ⁺ Ĵ) kξ W^(−1/2) ξ, Ĵ = J_B W^(−1/2), and its limits.

    Attributes:
        functions, objective: what V is.
        k_xi: kξ (n_z, n_z);  root: √ of W's diagonal (n_z,).
        target: where the end-point stays (n_task,), m.
        rate: samples a second, Hz.
        base_step, turn_step, joint_step: how much the base may move (m) and turn (rad), and each joint (rad or m), in a
            sample.
        lower, upper: of the base (n_b,), m or rad.
        sine_squared: least distance from singular postures.
    """

    functions: Quantities
    objective: Objective
    k_xi: Vector
    root: Vector
    target: Vector
    rate: float
    base_step: float
    turn_step: float
    joint_step: float
    lower: Vector
    upper: Vector
    sine_squared: float

    @property
    def plant(self) -> Plant:
        """The machine's plant."""
        return self.functions.measures.plant

    @property
    def lengths(self) -> NDArray[np.bool_]:
        """Which of the base's coordinates are lengths, (n_b,); the others are angles."""
        return np.array([unit == "m" for unit in self.plant.machine.base_units], dtype=np.bool_)

    @property
    def _key(self) -> tuple[AnyMachine, Control, bool]:
        measures = self.functions.measures
        return measures.plant.machine, measures.control, measures.gravity

    def point(self, z: Vector) -> PathPoint:
        """Everything that the law needs at z, from the measures' own Functions."""
        n_base, p = self.plant.n_base, self.plant.parameter_values
        arguments = [z[:n_base], z[n_base:], p]
        of_point, _ = _functions(*self._key)
        out = [x.full() for x in of_point.call(arguments)]
        alpha = np.array(self.objective.alpha)
        value, gap, gradient = float(alpha @ out[0].ravel()), math.inf, cast(Vector, alpha @ out[1])
        if self.objective.has_kinks:
            of_margin = _margin_gradients(*self._key)
            epsilon, epsilon_z = (x.full() for x in of_margin.call([*arguments, self.functions.gain]))
            value += self.objective.beta * float(epsilon[0, 0])
            gap = float(epsilon[1, 0] - epsilon[0, 0])
            gradient = gradient + self.objective.beta * epsilon_z[0]
        return PathPoint(z, value, gap, gradient, out[2].ravel(), out[3], float(out[4][0, 0]))

    def step(self, point: PathPoint) -> tuple[Vector, bool]:
        """Δz of the law, and whether V descends along it to first order."""
        scaled = point.gradient / self.root
        wanted, jacobian = self.k_xi @ scaled, point.jacobian / self.root
        free = wanted - np.linalg.lstsq(jacobian, jacobian @ wanted, rcond=None)[0]
        downhill = float(scaled @ free) < -ROUNDING * float(np.linalg.norm(scaled) * np.linalg.norm(wanted))
        return free / self.root, downhill

    def limited(self, step: Vector) -> Vector:
        """The step, as a whole no faster than the rates allow."""
        n_base = self.plant.n_base
        moves, turns = step[:n_base][self.lengths], step[:n_base][~self.lengths]
        fastest = float(np.linalg.norm(moves)) / self.base_step, float(np.linalg.norm(turns)) / self.turn_step
        return step / max(1.0, *fastest, float(np.abs(step[n_base:]).max()) / self.joint_step)

    def room(self, z: Vector, step: Vector) -> float:
        """Which share of the step, at most 1, keeps the base in its range."""
        n_base = self.plant.n_base
        base, move = z[:n_base], step[:n_base]
        ahead = np.where(move > 0, self.upper - base, base - self.lower)
        return float(np.min(ahead[move != 0] / np.abs(move[move != 0]), initial=1.0))

    def moved(self, z: Vector, step: Vector) -> Vector | None:
        """Z + step with its joints corrected so that the end-point is on the target; None where that fails."""
        n_base, p = self.plant.n_base, self.plant.parameter_values
        _, of_end_point = _functions(*self._key)
        base, joints = np.clip(z[:n_base] + step[:n_base], self.lower, self.upper), z[n_base:] + step[n_base:]
        tolerance = 1e-14 * (1 + float(np.abs(self.target).max()))

        def linear(joints: Vector) -> tuple[Vector, Vector]:
            end_point, jacobian = (x.full() for x in of_end_point.call([base, joints, p]))
            return end_point.ravel() - self.target, jacobian[:, n_base:]

        joints, error = shortest_steps(linear, joints, np.ones(joints.size), tolerance)
        # Far from the origin rounding keeps the error above the tolerance.
        return np.concatenate([base, joints]) if error <= 1e3 * tolerance else None

    def refuses(self, point: PathPoint) -> Stop | None:
        """The limit that a point breaks, if any."""
        if not (math.isfinite(point.value) and np.all(np.isfinite(point.gradient))):
            return Stop.UNSOLVED
        if not inside_limits(self.plant.machine, point.z[self.plant.n_base :, None])[0]:
            return Stop.JOINT_LIMIT
        return None if point.sine_squared >= self.sine_squared else Stop.SINGULAR


def climb(
    law: NullspaceLaw, point: PathPoint, min_gain: float, steps: int, stop_on_descent: bool
) -> tuple[list[PathPoint], Stop]:
    """The law from a point on, one point a sample, and why it ends."""
    points = [point]
    while len(points) <= steps:
        step, downhill = law.step(point)
        if downhill and stop_on_descent:
            return points, Stop.DESCENDS
        step = law.limited(step)
        if abs(float(point.gradient @ step)) * law.rate <= min_gain:
            return points, Stop.GAIN
        room = law.room(point.z, step)
        found = _next(law, point, room * step, downhill) if room > NO_ROOM else Stop.BASE_RANGE
        if isinstance(found, Stop):
            return points, found
        point, whole = found
        points.append(point)
        if whole and room < 1:
            return points, Stop.BASE_RANGE
    return points, Stop.DURATION


def _next(law: NullspaceLaw, point: PathPoint, step: Vector, downhill: bool) -> tuple[PathPoint, bool] | Stop:
    """The next point, and whether the whole step leads there; or what stands in the way of any.

    Uphill, V must not be lower there nor its slope along the step reversed: no maximum was passed.
    """
    why = Stop.UNSOLVED
    for halvings in range(HALVINGS + 1):
        z = law.moved(point.z, step / 2**halvings)
        if z is None:
            why = Stop.UNSOLVED
            continue
        there = law.point(z)
        refused = law.refuses(there)
        if refused is not None:
            why = refused
        elif downhill or (there.value >= point.value and float(there.gradient @ (z - point.z)) >= 0):
            return there, halvings == 0
        else:
            why = Stop.KINK if point.gap <= KINK else Stop.SUMMIT
    return why


def retime(
    law: NullspaceLaw, points: list[PathPoint], acceleration: float, duration: float
) -> tuple[list[PathPoint], bool]:
    """The same path at rest at both ends; and whether it was cut short."""
    n_base = law.plant.n_base
    z = np.array([point.z for point in points])
    samples, cut = retimed(z[:, :n_base][:, law.lengths], law.rate, acceleration, duration)
    timed: list[PathPoint] = []
    for interval, share in samples:
        here, there = points[interval], points[min(interval + 1, len(points) - 1)]
        between = law.moved(here.z, share * (there.z - here.z)) if 0 < share < 1 else None
        timed.append(law.point(between) if between is not None else there if share == 1 else here)
    return timed, cut


@by_structure
def _functions(machine: AnyMachine, control: Control, gravity: bool) -> tuple[ca.Function, ca.Function]:
    """(base, posture, p) -> w, ∂w/∂z, r, ∂r/∂z, sine_squared in one Function; and r, ∂r/∂z in another."""
    measures = build_measures(machine, control, gravity)
    plant = measures.plant
    at = [plant.graph.base, plant.graph.posture, plant.graph.p]
    w, _, r = measures.w.call(at)
    w_z, _, r_z = measures.gradients.call(at)
    sine_squared = plant.singularity_sine_squared.call(at)[0]
    names, options = ["base", "posture", "p"], {"cse": True}
    outputs = ["w", "w_z", "end_point", "end_point_z", "sine_squared"]
    return (
        ca.Function("nullspace_point", at, [w, w_z, r, r_z, sine_squared], names, outputs, options),
        ca.Function("nullspace_end_point", at, [r, r_z], names, outputs[2:4], options),
    )


@by_structure
def _margin_gradients(machine: AnyMachine, control: Control, gravity: bool) -> ca.Function:
    """(base, posture, p, kr) -> epsilon, ∂epsilon/∂z, compiled where that can be."""
    gradients = build_margin(machine, control, gravity).gradients
    symbols = gradients.mx_in()
    outputs, names = gradients.call(symbols)[:2], ["base", "posture", "p", "kr"]
    return accelerate(ca.Function("nullspace_margin", symbols, outputs, names, ["epsilon", "epsilon_z"]), order=0)
