"""A sampled loop in space on a base that is driven along x, y and yaw: Pinocchio's equations, SciPy's integrator.

The drive is three more joints before the machine's own, whose motion is given: of the whole M v̇ + h = τ only the
machine's rows are solved. Where the drive's rates jump, the machine's follow from M (v₊ − v₋) = 0 in these rows.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from tests.oracles.spatial import Data, coordinate_order, pinocchio_tree

DRIVE = (("slide", [1.0, 0.0, 0.0]), ("slide", [0.0, 1.0, 0.0]), ("hinge", [0.0, 0.0, 1.0]))


def with_drive(data: Data) -> Data:
    """The machine on three massless bodies that place its anchor frame."""
    whole = copy.deepcopy(data)
    for body in whole["bodies"]:
        body["parent"] = body.get("parent") or "drive2"
    bodies = []
    for k, (kind, axis) in enumerate(DRIVE):
        joint = {"name": f"drive{k}", "kind": kind, "axis": axis, "passive": False}
        bodies.append({"name": f"drive{k}", "parent": f"drive{k - 1}" if k else None, "joint": joint})
    whole["bodies"] = bodies + whole["bodies"]
    return whole


def driven_run(
    data: Data, start: np.ndarray, drive: Callable[[float], np.ndarray], *, target: np.ndarray, kp: float, kv: float,
    period: float, steps: int, gravity: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Coordinates and rates (steps + 1, n_q) that count from the anchor, and torques, from rest at `start`.

    Transpose control; the command is held and carries the arm's weight where gravity acts. `drive` gives (x, y, yaw) at
    a time and is linear between samples.
    """
    if not gravity:
        data = data | {"gravity": 0.0}
    whole = with_drive(data)
    known, tree = pinocchio_tree(data), pinocchio_tree(whole)
    names = [whole["bodies"][i]["joint"]["name"] for i in coordinate_order(whole)]
    own = [data["bodies"][i]["joint"]["name"] for i in coordinate_order(data)]
    free, driven = [names.index(name) for name in own], [names.index(f"drive{k}") for k in range(3)]
    n, m = len(own), sum(body["joint"].get("passive", False) for body in data["bodies"])
    stiffness, damping = (_coupled(data, f"{word}_matrix", word, own) for word in ("stiffness", "damping"))

    def whole_of(q: Any, base: Any) -> np.ndarray:
        column = np.zeros(len(names))
        column[free], column[driven] = q, base
        return column

    def rate(t: float, x: np.ndarray, at: np.ndarray, speed: np.ndarray, torque: np.ndarray) -> np.ndarray:
        q, v = x[:n], x[n:]
        here = whole_of(q, at + t * speed)
        force = -tree.nonlinear_effects(here, whole_of(v, speed))[free] - stiffness @ q - damping @ v
        force[m:] += torque
        return np.concatenate([v, np.linalg.solve(tree.mass(here)[np.ix_(free, free)], force)])

    x, before = np.concatenate([start, np.zeros(n)]), np.zeros(3)
    rows, torques = [], []
    for k in range(steps + 1):
        at = drive(k * period)
        speed = (drive((k + 1) * period) - at) / period if k < steps else np.zeros(3)
        here = whole_of(x[:n], at)
        mass = tree.mass(here)
        x[n:] -= np.linalg.solve(mass[np.ix_(free, free)], mass[np.ix_(free, driven)] @ (speed - before))
        rows.append(x.copy())
        before = speed
        point, jacobian, _ = tree.task(here, np.zeros(3))
        force = kp * (target - point) - kv * (jacobian @ whole_of(x[n:], speed))
        belief = np.concatenate([start[:m], x[m:n]])
        torque = known.task(belief, at)[1][:, m:].T @ force + known.gravity(belief)[m:]
        torques.append(torque)
        x = solve_ivp(
            rate, (0.0, period), x, args=(at, speed, torque), method="DOP853", rtol=1e-12, atol=1e-13
        ).y[:, -1]  # fmt: skip
    rows = np.array(rows)
    return rows[:, :n], rows[:, n:], np.array(torques)


def _coupled(data: Data, table: str, word: str, own: list[str]) -> np.ndarray:
    matrix = np.zeros((len(own), len(own)))
    for body in data["bodies"]:
        k = own.index(body["joint"]["name"])
        matrix[k, k] = body["joint"].get(word, 0.0)
    if table in data:
        at = [own.index(name) for name in data[table]["joints"]]
        matrix[np.ix_(at, at)] = np.array(data[table]["matrix"])
    return matrix
