"""The quadratic program of one step: the largest smallest of linear functions, less a quadratic form.

Not CasADi's: of its solvers for quadratic programs one loses the digits where curvatures differ by 1e7, one is in newer
releases only, one writes a banner to the standard output, and all want a solver for each number of rows.

In: matrices. Out: the solution and multipliers. Pure NumPy; knows nothing of selections.
"""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Vector
from flexopt.selection.programs import Bounds

# Singular values below this share of the largest are rounding.
DEPENDENT = 1e-12
# Interior-point iterations at most; the mean complementarity from which on active rows are tried, and the last one; the
# share of the way to the boundary that a step goes.
ITERATIONS, NEAR, KNOWN, SHORT = 60, 1e-2, 1e-13, 0.995
# How far a solution with known active rows may break the others, or have multipliers of the wrong sign: of a problem
# whose gradient and box are of order one.
TOLERANCE = 1e-10


def best_gain(bend: Vector, rows: Vector, bounds: Bounds) -> tuple[Vector, float, Vector] | None:
    """The d (n,) and t of max t − dᵀ bend d / 2 within bounds of d and of rows @ [d, t], and the rows' multipliers.

    Mehrotra's predictor and corrector (1992) to tell which rows are active, then the equations of these. Multipliers
    are positive at upper bounds, negative at lower ones. None where no solution is found.

    Args:
        bend: positive definite, (n, n).
        rows: (k, n + 1), the last column for t, which rows bound from above.
        bounds: of d, finite and about 0, and of the rows.
    """
    n = bend.shape[0]
    equal, fixed = bounds.g_lower >= bounds.g_upper, bounds.x_lower >= bounds.x_upper
    equations = np.vstack([rows[equal, :n], np.eye(n)[fixed]])
    first, free = np.zeros(n), np.eye(n)
    if len(equations):
        first = np.linalg.pinv(equations, DEPENDENT) @ np.concatenate([bounds.g_lower[equal], bounds.x_lower[fixed]])
        _, singular, directions = np.linalg.svd(equations)
        free = directions[int(np.sum(singular > DEPENDENT * singular[0])) :]
    # Variables [u, τ]: d = first + reach freeᵀ u, t = gain τ.
    reach = float(np.maximum(-bounds.x_lower, bounds.x_upper).max(initial=0.0)) or 1.0
    sought = rows[:, n] != 0
    gain = reach * float(np.linalg.norm(rows[sought, :n] @ free.T, axis=1).max(initial=0.0)) or 1.0
    second = np.zeros((len(free) + 1, len(free) + 1))
    second[:-1, :-1] = reach**2 / gain * (free @ bend @ free.T)
    every = np.vstack([rows, np.eye(n, n + 1)])
    low, high = np.concatenate([bounds.g_lower, bounds.x_lower]), np.concatenate([bounds.g_upper, bounds.x_upper])
    moved = every[:, :n] @ first
    scaled = np.column_stack([reach * (every[:, :n] @ free.T), gain * every[:, n]])
    limited = ~np.concatenate([equal, fixed])
    above, below = limited & np.isfinite(high), limited & np.isfinite(low)
    sides = np.vstack([scaled[above], -scaled[below]])
    ends = np.concatenate([(high - moved)[above], (moved - low)[below]])
    lengths = np.linalg.norm(sides, axis=1)
    lengths[lengths == 0] = 1.0
    # Of what contradicts itself the multipliers grow without bound.
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        found = _solved(second, sides / lengths[:, None], ends / lengths)
    if found is None:
        return None
    u, pulls = found[0], found[1] * gain / lengths
    d: Vector = first + reach * (u[:-1] @ free)
    multipliers = np.zeros(len(every))
    multipliers[above] += pulls[: int(above.sum())]
    multipliers[below] -= pulls[int(above.sum()) :]
    if len(equations):
        left: Vector = -(bend @ d) - every[:, :n].T @ multipliers
        multipliers[: len(rows)][equal] = (np.linalg.pinv(equations.T, DEPENDENT) @ left)[: int(np.sum(equal))]
    return d, gain * float(u[-1]), multipliers[: len(rows)]


def _solved(second: Vector, rows: Vector, ends: Vector) -> tuple[Vector, Vector] | None:
    """The v of min vᵀ second v / 2 − v_last with rows @ v ≤ ends, and multipliers (k,)."""
    n, k = second.shape[0], len(ends)
    cost = -np.eye(n)[-1]
    v, pulls, slacks = cast(tuple[Vector, Vector, Vector], (np.zeros(n), np.ones(k), np.maximum(ends, 1.0)))
    # Most often one row bounds t and no other matters: the one that is lowest at first.
    tried: NDArray[np.bool_] = np.arange(k) == int(np.argmin(np.where(rows[:, -1] > 0, ends, np.inf)))
    exact = _with_active(second, cost, rows, ends, tried)
    if exact is not None:
        return exact
    best: tuple[float, Vector, Vector] | None = None
    for _ in range(ITERATIONS):
        off: Vector = second @ v + cost + rows.T @ pulls
        beyond: Vector = rows @ v + slacks - ends
        gap = float(slacks @ pulls) / k
        error = max(gap, float(np.abs(off).max()), float(np.abs(beyond).max()))
        if not np.isfinite(error):
            break
        if best is None or error < best[0]:
            best = error, v, pulls
        active = pulls > slacks
        if gap < NEAR and (active != tried).any():
            tried, exact = active, _with_active(second, cost, rows, ends, active)
            if exact is not None:
                return exact
        if error <= KNOWN:
            break
        try:
            inverse = cast(Vector, np.linalg.inv(second + (rows.T * (pulls / slacks)) @ rows))
        except np.linalg.LinAlgError:
            break
        # Straight to the solution first; then with what that misses, towards the middle by as much as it fell short.
        _, ds, dp = _towards(inverse, rows, off, beyond, slacks, pulls, np.zeros(k))
        share = min(_share(slacks, ds), _share(pulls, dp))
        ahead = float((slacks + share * ds) @ (pulls + share * dp)) / k
        dv, ds, dp = _towards(inverse, rows, off, beyond, slacks, pulls, gap * (ahead / gap) ** 3 - ds * dp)
        share = SHORT * min(_share(slacks, ds), _share(pulls, dp))
        v, slacks, pulls = v + share * dv, slacks + share * ds, pulls + share * dp
    return None if best is None or best[0] > TOLERANCE else best[1:]


def _towards(
    inverse: Vector, rows: Vector, off: Vector, beyond: Vector, slacks: Vector, pulls: Vector, products: Vector
) -> tuple[Vector, Vector, Vector]:
    """Newton's step of v, slacks and multipliers to where slack times multiplier are `products`."""
    aim = slacks * pulls - products
    dv: Vector = -inverse @ (off + rows.T @ ((pulls * beyond - aim) / slacks))
    ds: Vector = -beyond - rows @ dv
    dp: Vector = -(aim + pulls * ds) / slacks
    return dv, ds, dp


def _share(values: Vector, change: Vector) -> float:
    """The largest share of a change, at most 1, that leaves all values positive."""
    falls = change < 0
    return min(1.0, float((-values[falls] / change[falls]).min(initial=1.0)))


def _with_active(
    second: Vector, cost: Vector, rows: Vector, ends: Vector, active: NDArray[np.bool_]
) -> tuple[Vector, Vector] | None:
    """The solution where exactly these rows hold with equality; None where it breaks others or they do not pull."""
    n, some = second.shape[0], rows[active]
    matrix = np.block([[second, some.T], [some, np.zeros((len(some), len(some)))]])
    found = cast(Vector, np.linalg.lstsq(matrix, np.concatenate([-cost, ends[active]]), rcond=1e-15)[0])
    v, own = found[:n], found[n:]
    fits = float((rows @ v - ends).max(initial=0.0)) <= TOLERANCE and own.min(initial=0.0) >= -TOLERANCE
    if not fits or float(np.abs(second @ v + cost + some.T @ own).max()) > TOLERANCE:
        return None
    pulls = np.zeros(len(ends))
    pulls[active] = np.maximum(own, 0.0)
    return v, pulls
