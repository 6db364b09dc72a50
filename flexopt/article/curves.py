"""The measures along a line of end-points at one height: what moving the base does to them.

In: a machine, a height and an elbow branch. Out: a `Curve`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Vector
from flexopt.foundation.control import Control
from flexopt.foundation.turns import in_turn
from flexopt.model import AnyMachine
from flexopt.model.choices import Elbow
from flexopt.plant import build_plant
from flexopt.plant.reach import reach
from flexopt.study.maps.grid import end_point_grid
from flexopt.study.maps.points import evaluate_points

POINTS = 2001


@dataclass(frozen=True)
class Curve:
    """N end-points (x, y) of the workspace frame, m, from left to right; NaN where the arm is straight or folded.

    Attributes:
        control, elbow, y: what is shown.
        x: (N,), m.
        posture: (n, N), rad.
        w: (m, N).
        epsilon_max: (N,).
        regular: (N,), whether the arm is at least `margin_deg` from straight and from folded.
        margin_deg: degrees.
    """

    control: Control
    elbow: Elbow
    y: float
    x: Vector
    posture: Vector
    w: Vector
    epsilon_max: Vector
    regular: NDArray[np.bool_]
    margin_deg: float

    def peaks(self) -> NDArray[np.int64]:
        """Indices of the local maxima of w_1 inside the regular part."""
        w = self.w[0]
        inner = (w[1:-1] > w[:-2]) & (w[1:-1] > w[2:]) & self.regular[1:-1] & self.regular[:-2] & self.regular[2:]
        return np.flatnonzero(inner) + 1

    def maxima(self) -> Vector:
        """Where these maxima are, m: the tops of parabolas through each and its neighbours, which stand evenly."""
        k = self.peaks()
        before, here, after = self.w[0][k - 1], self.w[0][k], self.w[0][k + 1]
        step = (self.x[k + 1] - self.x[k - 1]) / 2
        return np.asarray(self.x[k] + step * (after - before) / (4 * here - 2 * before - 2 * after), dtype=np.float64)


@in_turn
def curve(
    machine: AnyMachine, y: float, *, control: Control, elbow: Elbow, gain: float = 5e5, margin_deg: float = 10.0
) -> Curve:
    """Evaluate the measures along the height y (workspace frame, m), a two-joint arm's whole reach."""
    plant = build_plant(machine)
    far = math.sqrt(reach(plant).outer ** 2 - y**2)
    grid = end_point_grid(machine, (-far, far), (y, y), (POINTS, 1), elbow)
    where = grid.reachable[0]
    posture, x = grid.posture[:, 0, where], grid.x.values[where]
    values = evaluate_points(machine, posture, control=control, gain=gain)
    bases = np.zeros((plant.n_base, x.size))
    sines = plant.singularity_sine_squared(bases, posture, plant.parameter_values).full().ravel()
    regular = (sines >= math.sin(math.radians(margin_deg)) ** 2) & np.isfinite(values.epsilon_max)
    return Curve(control, elbow, y, x, posture, values.w, values.epsilon_max, regular, margin_deg)


def rank_correlation(first: Vector, second: Vector) -> float:
    """Spearman's rank correlation of the points where both are finite."""
    from scipy.stats import spearmanr  # noqa: PLC0415  (slow to import)

    both = np.isfinite(first) & np.isfinite(second)
    return float(spearmanr(first[both], second[both])[0])  # pyright: ignore[reportUnknownArgumentType]
