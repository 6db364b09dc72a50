"""Where w_i = a_i·b_i − |a_i||b_i| has kinks: −|a_i||b_i| is a cone about a_i = 0 and about b_i = 0.

In: a_i and b_i with their slopes. Out: cones of objectives; and what is left of w_i that is smooth at a tip.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.selection.ascent_model import Cone

# Lengths below which there is no direction.
TINY = 1e-300
SIDES = "ab"
# Modes whose frequency fewer have stand alone: w_i of others is no product of two lengths.
SHARED = 1.5


def split_factors(f: Vector, slopes: Vector) -> tuple[Vector, Vector]:
    """F = [a_i; b_i] (2r, m) and slopes of its columns (2r m, n), as (m, 2, r) and (m, 2, r, n): a first, then b."""
    m = f.shape[1]
    return f.T.reshape(m, 2, -1), slopes.reshape(m, 2, -1, slopes.shape[1])


def mode_cones(f: Vector, slopes: Vector, alphas: Vector) -> list[Cone]:
    """Of every mode the cone of a_i, −α_i |b_i| |a_i|, and that of b_i; none with a single task row.

    Args:
        f, slopes: from `split_factors`.
        alphas: α of every objective, (j, m).
    """
    if f.shape[2] < 2:
        return []
    lengths = np.linalg.norm(f, axis=2)
    # As the graphs of w_i have it.
    units = f / np.sqrt(lengths**2 + TINY)[:, :, None]
    return [
        Cone(f[i, side], slopes[i, side], alpha * lengths[i, 1 - side], units[i, side])
        for i, alpha in enumerate(alphas.T)
        for side in range(2)
    ]


def name_of(number: int) -> str:
    """What is zero at the tip of the cone of this number in `mode_cones`."""
    return f"{SIDES[number % 2]}{number // 2 + 1} = 0"


def smooth_slope(f: Vector, slopes: Vector, held: Mapping[int, tuple[float, Vector]]) -> Vector:
    """The slope (n,) of Σ α (c·o − |o| ν·c) over some cones: w_i with the direction of its kink held.

    Args:
        f, slopes: from `split_factors`.
        held: by number of the cone α, and α ν (r,); c is what is zero at its tip, o the other one.
    """
    total = np.zeros(slopes.shape[-1])
    for number, (alpha, pull) in held.items():
        i, side = divmod(number, 2)
        tip, other = f[i, side], f[i, 1 - side]
        length = float(np.linalg.norm(other))
        total = total + (alpha * other - length * pull) @ slopes[i, side]
        total = total + (alpha * tip - (float(pull @ tip) / max(length, TINY)) * other) @ slopes[i, 1 - side]
    return total
