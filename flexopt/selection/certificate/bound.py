"""Branch and bound over the redundancy: cells of the placement, an elbow each, split until none may hold much more.

In: a problem's `RedundancyCurve`, a value and by how much more than it is still sought. Out: a `Covering` by cells,
with why each is left out, or a bound on the objective in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flexopt.compiled.taylor import FloatArray
from flexopt.foundation.arrays import Vector
from flexopt.plant.inverse_kinematics import ELBOW_SIGN, branch
from flexopt.selection.broken import beyond_bounds
from flexopt.selection.certificate.curve import CellBounds, RedundancyCurve

# Cells that each elbow begins with, parts of one that is split, cells looked at in one go and in all at most.
FIRST, PARTS, AT_ONCE, MOST = 48, 3, 1024, 60_000
# A cell's share of what was known of V in the larger one, above which rounding is what is left.
SHRINKS = 0.5
# Cells no wider than this share of the whole are not split.
NARROWEST = 1e-14


@dataclass(frozen=True)
class Covering:
    """A covering of the redundancy: all placements in the range, for each elbow.

    Attributes:
        elbow: −1 (up) or +1 (down);  low, high: ends, m;  (N,) each.
        outside: why a cell holds no allowed configuration, "" where it may hold some.
        bound: what the objective is at most there; −∞ where the cell is left out, ∞ where nothing is known.
        decided: whether all cells are left out or bounded by what was sought.
        better: an allowed configuration z = [base, posture], (n_z,), that has more; the search ends there.
    """

    elbow: FloatArray
    low: FloatArray
    high: FloatArray
    outside: list[str]
    bound: FloatArray
    decided: bool
    better: Vector | None

    @property
    def upper(self) -> float:
        """What the objective is at most anywhere; −∞ where no configuration is allowed."""
        return float(self.bound.max(initial=-np.inf))

    def rows(self) -> list[tuple[float, float, float, str]]:
        """Elbow, ends, and why it is left out, of every cell, by elbow and placement."""
        return list(zip(*(x.tolist() for x in (self.elbow, self.low, self.high)), self.outside, strict=True))


def branch_and_bound(curve: RedundancyCurve, sought: float) -> Covering:
    """Cells in each of which V ≤ `sought`, as far as that can be shown."""
    variable = curve.problem.variables[0]
    edges = np.linspace(variable.lower, variable.upper, FIRST + 1 if variable.lower < variable.upper else 2)
    low, high = (np.tile(each, len(ELBOW_SIGN)) for each in (edges[:-1], edges[1:]))
    elbow = np.repeat(list(ELBOW_SIGN.values()), edges.size - 1)
    # How much is known of V where a cell came from; infinite where nothing is.
    before = np.full(low.size, np.inf)
    narrowest = NARROWEST * max(abs(variable.lower), abs(variable.upper), variable.upper - variable.lower)
    done: list[tuple[FloatArray, FloatArray, FloatArray, list[str], FloatArray]] = []
    seen, decided = 0, True
    better: Vector | None = None
    while low.size and better is None:
        now, later = slice(0, AT_ONCE), slice(AT_ONCE, None)
        found, known = _seen(curve, low[now], high[now], elbow[now], before[now], sought)
        seen += found.high.size
        left = np.array([bool(word) for word in found.outside])
        bound = np.where(left, -np.inf, found.high)
        better = _better(curve, np.flatnonzero(~left & (found.low > sought)), low[now], high[now], elbow[now])
        hopeless = (high[now] - low[now] <= narrowest) | (seen >= MOST) | (better is not None)
        stop = (bound <= sought) | hopeless
        decided = decided and not np.any(stop & ~(bound <= sought))
        words = [word for word, ends in zip(found.outside, stop, strict=True) if ends]
        done.append((elbow[now][stop], low[now][stop], high[now][stop], words, bound[stop]))
        ends = [low[now][~stop] + (high[now][~stop] - low[now][~stop]) * (k / PARTS) for k in range(PARTS)]
        ends.append(high[now][~stop])
        low, high = np.concatenate([*ends[:-1], low[later]]), np.concatenate([*ends[1:], high[later]])
        elbow, before = (
            np.concatenate([np.tile(each[~stop], PARTS), rest])
            for each, rest in ((elbow[now], elbow[later]), (known, before[later]))
        )
    words = [word for each in done for word in each[3]]
    sides, lows, highs, bounds = (np.concatenate([each[k] for each in done]) for k in (0, 1, 2, 4))
    order = np.lexsort([lows, sides])
    return Covering(sides[order], lows[order], highs[order], [words[k] for k in order], bounds[order], decided, better)


def _seen(
    curve: RedundancyCurve, low: FloatArray, high: FloatArray, elbow: FloatArray, before: FloatArray, sought: float
) -> tuple[CellBounds, FloatArray]:
    """What is known of cells, and to what in V, (N,).

    Where that is hardly less than of the larger cell they are part of, rounding is what is left: more digits are taken.
    """
    found = curve.see(low, high, elbow)
    known = found.high - found.low
    rounded = ~(found.high <= sought) & ~(known < SHRINKS * before) & np.isfinite(before)
    rounded &= np.array([not word for word in found.outside])
    if rounded.any():
        again = curve.see(low[rounded], high[rounded], elbow[rounded], precise=True)
        words, places = list(found.outside), np.flatnonzero(rounded).tolist()
        for k, word in zip(places, again.outside, strict=True):
            words[k] = word
        lows, highs = found.low.copy(), found.high.copy()
        lows[rounded], highs[rounded] = again.low, again.high
        found, known = CellBounds(words, lows, highs), highs - lows
        # Whatever comes of such a cell is looked at with more digits, too.
        known[rounded] = 0.0
    return found, known


def _better(
    curve: RedundancyCurve, cells: NDArray[np.int64], low: FloatArray, high: FloatArray, elbow: FloatArray
) -> Vector | None:
    """The middle of the first of these cells that is allowed, in all of which V is more than what was sought."""
    problem = curve.problem
    for k in cells.tolist():
        x = np.array([[(low[k] + high[k]) / 2]])
        posture, reaches = branch(problem.measures.plant, problem.target, x, np.zeros((0, 1)), float(elbow[k]))
        z = np.concatenate([x.ravel(), posture.ravel()])
        inside = np.all((z >= problem.lower) & (z <= problem.upper))
        kept = all(
            problem.branches(objective, z)[0][0] >= least
            for objective, least in zip(problem.objectives, problem.kept, strict=False)
        )
        if reaches[0] and inside and kept and not np.any(beyond_bounds(problem, z)[problem.target.size :]):
            return z
    return None
