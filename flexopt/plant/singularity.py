"""Postures where the rigid-body Jacobian Jv loses rank."""

from __future__ import annotations

import math
from typing import Any, cast

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.errors import SingularPosture
from flexopt.foundation.arrays import Vector, spread
from flexopt.foundation.control import Control, control_damping
from flexopt.foundation.kept import by_machine
from flexopt.model.file_model import quoted
from flexopt.plant.plant import Plant
from flexopt.plant.reach import arm_length, sampled_ranges

# Above this condition number Jv⁻¹ and its derivatives keep fewer than half of a double's digits.
CONDITION_MAX = 1e6
PROBE = 1e-3
# Within the joints' ranges, by which a machine is told whose joints never move some row of the task.
LOOKED_AT = 16


def _largest_and_condition(plant: Plant, q: Vector, base: Vector) -> tuple[float, float]:
    """The largest singular value of Jv(q), and its ratio to the smallest; infinite where that is zero.

    A single row has one singular value alone: it is compared with that of the end-point's position, if larger.
    """
    values = np.linalg.svd(plant.rigid_jacobian(q, base, plant.parameter_values).full(), compute_uv=False)
    largest = values[0]
    if plant.n_task == 1:
        largest = max(largest, np.linalg.norm(position_jacobian(plant, q, base), 2))
    return float(largest), float(largest / values[-1]) if values[-1] > 0 else math.inf


def position_jacobian(plant: Plant, q: Vector, base: Vector) -> Vector:
    """Of the end-point's position by the actuated joints (3, n), whatever the task."""
    g = plant.graph
    jacobian = ca.jacobian(g.skeleton[:, -1], g.q)[:, plant.n_passive :]
    return ca.Function("position_jacobian", [g.q, g.base, g.p], [jacobian])(q, base, plant.parameter_values).full()


def inverse_condition(condition: Vector, largest: Vector, control: Control) -> Vector:
    """Condition of what a control inverts: cond Jv, or that of [Jvᵀ; λ I] for a damped one, at any number of points.

    Args:
        condition: cond Jv.
        largest: the largest singular value of Jv.
        control: which.
    """
    damping = control_damping(control)
    if damping is None:
        return condition
    return np.hypot(largest, damping) / np.hypot(largest / condition, damping)


def screened(plant: Plant) -> dict[str, ca.SX]:
    """Graphs of base, posture and p that tell singular postures at rest, for many points at once by `singular_points`.

    With σ the singular values of Jv: `screen` = Π σ² / (Σ σ²)^r ≤ 1/cond², so that most points need no more; `jv`
    stacked, and of a single task row `position`, the Jacobian of the end-point's position, which it is compared with.
    """
    g, r = plant.graph, plant.n_task
    rest = plant.rest(g.base, g.posture, g.p)
    jv, position = plant.rigid_jacobian(rest, g.base, g.p), ca.SX(0, 1)
    gram, size = jv @ jv.T, ca.sumsqr(jv)
    if r == 1:
        by_joints = ca.jacobian(g.skeleton[:, -1], g.q)[:, plant.n_passive :]
        position = ca.Function("position_jacobian", [g.q, g.base, g.p], [by_joints])(rest, g.base, g.p)
        size += ca.sumsqr(position)
    return {"screen": ca.det(gram) / size**r, "jv": ca.vec(jv), "position": ca.vec(position)}


def singular_points(plant: Plant, control: Control, screen: Vector, jv: Vector, position: Vector) -> NDArray[np.bool_]:
    """Which of N points `check_regular` would refuse, (N,), from the outputs of `screened`, a column each."""
    # A NaN is suspect, too. Damping can only make a posture regular.
    suspects = np.flatnonzero(~(screen.ravel() > 2 / CONDITION_MAX**2))
    singular = np.zeros(screen.size, dtype=bool)
    if suspects.size:
        condition, largest = conditions(jv[:, suspects], plant.n_actuated)
        if plant.n_task == 1:
            compared = np.maximum(largest, conditions(position[:, suspects], plant.n_actuated)[1])
            with np.errstate(divide="ignore", invalid="ignore"):
                condition, largest = compared / largest, compared
        singular[suspects] = ~(inverse_condition(condition, largest, control) <= CONDITION_MAX)
    return singular


def conditions(stacked: Vector, n_actuated: int) -> tuple[Vector, Vector]:
    """Ratio of the extreme singular values of each of N Jacobians, stacked by columns, and the largest, (N,)."""
    jacobians = stacked.T.reshape(stacked.shape[1], n_actuated, stacked.shape[0] // n_actuated)
    finite = np.all(np.isfinite(jacobians), axis=(1, 2))
    values = np.linalg.svd(np.where(finite[:, None, None], jacobians, 0.0), compute_uv=False)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio: Vector = values[:, 0] / values[:, -1]
    return np.where(np.isnan(ratio), np.inf, ratio), values[:, 0]


@by_machine
def movable_rows(plant: Plant) -> tuple[str, ...]:
    """The task's rows; where no posture of a sample moves them all, the first of them that one moves together."""
    low, high = sampled_ranges(plant.machine, arm_length(plant)).T
    rows, most = plant.machine.task_rows, list[int]()
    for share in spread(LOOKED_AT, len(low) + plant.n_base):
        # What a row is moved by depends on how the base is turned.
        base = math.tau * share[len(low) :]
        posture: Vector = low + (high - low) * share[: len(low)]
        q: Vector = cast(Any, plant.rest)(base, posture, plant.parameter_values)
        if _largest_and_condition(plant, q, base)[1] <= CONDITION_MAX:
            return rows
        jacobian: Vector = cast(Any, plant.rigid_jacobian)(q, base, plant.parameter_values).full()
        kept, least = list[int](), np.linalg.norm(jacobian, 2) / CONDITION_MAX
        for row in range(len(rows)):
            if np.linalg.svd(jacobian[[*kept, row]], compute_uv=False)[-1] > least:
                kept.append(row)
        most = max(most, kept, key=len)
    return tuple(rows[row] for row in most)


def unmoved_told(plant: Plant) -> str:
    """Which rows of the task the joints never move together, as a sentence; empty where there are none."""
    rows, kept = plant.machine.task_rows, movable_rows(plant)
    if kept == rows:
        return ""
    together = f"no more than {', '.join(kept)}" if kept else "none of them"
    more = f": take rows = {quoted(kept)} in [end_point]" if kept else ""
    return f"in no posture do the joints move all task rows ({', '.join(rows)}), but {together}{more}"


def check_regular(plant: Plant, q: Vector, base: Vector, control: Control = "inverse", *, otherwise: str = "") -> float:
    """Return cond Jv, or raise `SingularPosture` naming the joint that would lead out of the singularity and its angle.

    Args:
        plant: the machine's plant.
        q: configuration (n_q,).
        base: placement (n_b,).
        control: a damped one is refused only where its damping is too small against Jv.
        otherwise: what else than another posture would help, in words.
    """
    largest, condition = _largest_and_condition(plant, q, base)
    if inverse_condition(np.array(condition), np.array(largest), control) <= CONDITION_MAX:
        return condition
    escape = [_smallest_singular_value(plant, q, base, i) for i in range(plant.n_passive, plant.n_coordinates)]
    index = int(np.argmax(escape))
    joint, angle = plant.machine.joints[index], float(q[plant.n_passive + index]) + 0.0
    hinge, rows = plant.machine.joint_units[index] == "rad", plant.n_task
    value = f"{angle:.6g} rad ({math.degrees(angle):.4g}°)" if hinge else f"{angle:.6g} m"
    sentences = {1: "the joints do not move the task row", 2: "the end-point can only move along one line"}
    stuck = sentences.get(rows, f"the joints do not move all {rows} task rows")
    never = unmoved_told(plant)
    remedy = "" if never else f"; {'bend' if hinge else 'move'} {joint}"
    raise SingularPosture(
        f"posture (joint {joint}) = {value} is singular: {never or stuck} "
        f"(cond Jv = {condition:.3g}, allowed up to {CONDITION_MAX:.0e}){remedy}{otherwise and f', or {otherwise}'}",
        joint=joint,
        angle=angle,
    )


def _smallest_singular_value(plant: Plant, q: Vector, base: Vector, index: int) -> float:
    moved = q.copy()
    moved[index] += PROBE
    jacobian = plant.rigid_jacobian(moved, base, plant.parameter_values).full()
    return float(np.linalg.svd(jacobian, compute_uv=False)[-1])
