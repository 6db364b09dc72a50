"""Branch and bound over the redundancy: cells of the placement, an elbow each, split until none may hold much more.

In: a problem's `Curve`, a value and by how much more than it is still sought. Out: the cells, with why each is left
out, or a bound on the objective in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexopt.compiled.taylor import Array
from flexopt.plant.inverse_kinematics import ELBOW_SIGN
from flexopt.selection.certificate.curve import Curve

# Cells that each elbow begins with, parts of one that is split, cells looked at in one go and in all at most.
FIRST, PARTS, AT_ONCE, MOST = 48, 3, 1024, 60_000
# Cells no wider than this share of the whole are not split.
NARROWEST = 1e-14
# What the cells that could not be decided are like.
UNKNOWN = "unknown"


@dataclass(frozen=True)
class Cells:
    """A covering of the redundancy: all placements in the range, for each elbow.

    Attributes:
        elbow: −1 (up) or +1 (down);  low, high: ends, m;  (N,) each.
        outside: why a cell holds no allowed configuration, "" where it may hold some.
        bound: what the objective is at most there; −∞ where the cell is left out, ∞ where nothing is known.
        floor: what it is at least in a cell, if the cell holds an allowed configuration; −∞ where that is not known.
        decided: whether all cells are left out or bounded by what was sought.
    """

    elbow: Array
    low: Array
    high: Array
    outside: list[str]
    bound: Array
    floor: Array
    decided: bool

    @property
    def upper(self) -> float:
        """What the objective is at most anywhere; −∞ where no configuration is allowed."""
        return float(self.bound.max(initial=-np.inf))


def branch_and_bound(curve: Curve, sought: float) -> Cells:
    """Cells in each of which V ≤ `sought`, as far as that can be shown."""
    variable = curve.problem.variables[0]
    edges = np.linspace(variable.lower, variable.upper, FIRST + 1 if variable.lower < variable.upper else 2)
    low, high = (np.tile(each, len(ELBOW_SIGN)) for each in (edges[:-1], edges[1:]))
    elbow = np.repeat(list(ELBOW_SIGN.values()), edges.size - 1)
    narrowest = NARROWEST * max(abs(variable.lower), abs(variable.upper), variable.upper - variable.lower)
    done: list[tuple[Array, Array, Array, list[str], Array, Array]] = []
    seen, decided = 0, True
    while low.size:
        now, later = slice(0, AT_ONCE), slice(AT_ONCE, None)
        found = curve.see(low[now], high[now], elbow[now])
        seen += found.high.size
        left = np.array([bool(word) for word in found.outside])
        bound = np.where(left, -np.inf, found.high)
        hopeless = (high[now] - low[now] <= narrowest) | (seen >= MOST)
        stop = (bound <= sought) | hopeless
        decided = decided and not np.any(stop & ~(bound <= sought))
        words = [word for word, ends in zip(found.outside, stop, strict=True) if ends]
        done.append((elbow[now][stop], low[now][stop], high[now][stop], words, bound[stop], found.low[stop]))
        ends = [low[now][~stop] + (high[now][~stop] - low[now][~stop]) * (k / PARTS) for k in range(PARTS)]
        ends.append(high[now][~stop])
        low, high, elbow = (
            np.concatenate([*ends[:-1], low[later]]),
            np.concatenate([*ends[1:], high[later]]),
            np.concatenate([np.tile(elbow[now][~stop], PARTS), elbow[later]]),
        )
    words = [word for each in done for word in each[3]]
    sides, lows, highs, bounds, floors = (np.concatenate([each[k] for each in done]) for k in (0, 1, 2, 4, 5))
    order = np.lexsort([lows, sides])
    return Cells(
        sides[order], lows[order], highs[order], [words[k] for k in order], bounds[order], floors[order], decided
    )
