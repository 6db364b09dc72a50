"""A program to first order at a point, and the multipliers that prove an optimum there, on kinks too.

In: gradients of what is maximised and of what is active. Out: multipliers of the right signs, those of kinks no larger
than Clarke's generalised gradient allows. Knows nothing of machines.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.selection.proof.nonnegative import nonnegative_least_squares

STATIONARITY_TOLERANCE = 1e-6
# Rounds in which multipliers of kinks are looked for where the nearest are too large, and by how much they may be.
ROUNDS, OVER = 200, 1e-9
# Of kinks by configuration and number in `mode_cones`, what `smooth_slope` holds.
HeldCones = dict[tuple[int, int], tuple[float, Vector]]
# Of kinks of ε_max by configuration and objective the p (2,).
HeldMargins = dict[tuple[int, int], Vector]


@dataclass(frozen=True)
class Kink:
    """A term −|c| of an objective where c = 0: −pᵀC is part of its gradients for every p with |p| ≤ 1.

    Attributes:
        name: see `Proof`;  rows: which of the equalities are C, along its axes.
        first: number of the objective among the inequalities, whose multiplier limits |p|; None of what is sought.
        member: number of the configuration;  number: of the cone in `mode_cones`, None of ε_max.
        axes: of C, (k, r);  alpha: α_i / size of the objective.
        objective: number of the objective;  value: c along the axes, in the units of the rows, (k,).
    """

    name: str
    rows: slice
    first: int | None
    member: int = 0
    number: int | None = None
    axes: Vector | None = None
    alpha: float = 0.0
    objective: int = 0
    value: Vector | None = None


@dataclass(frozen=True)
class FirstOrderModel:
    """First-order model at a point, in y = x / scale, and t last where the program has one.

    Attributes:
        level: t, the smallest V / size.
        value, gradient: of what is maximised.
        g: values of the constraints, as `Program.constraints` lists them.
        equal, active: numbers of the equalities among them; of the active inequalities, with their sense.
        equalities: gradients of equality rows, of c at the kinks, of fixed variables.
        inequalities: gradients of the active ones c ≥ 0;  names: theirs.
        moving: 0 for variables that are fixed or at a bound, else 1.
        kinks: of the objective that is sought and of those that are kept; their gradients are those without −|c|.
    """

    level: float
    value: float
    gradient: Vector
    g: Vector
    equal: list[int]
    active: list[tuple[int, float]]
    equalities: Vector
    inequalities: Vector
    names: tuple[str, ...]
    moving: Vector
    kinks: tuple[Kink, ...]

    def rows(self, kept: list[int]) -> Vector:
        """Gradients of the equalities and of the inequalities numbered in `kept`."""
        return np.vstack([self.equalities, self.inequalities[kept]])

    def pulls(self, multipliers: Vector, kept: list[int]) -> Vector:
        """Multipliers of all inequalities, none positive."""
        pulls = np.zeros(len(self.inequalities))
        pulls[kept] = multipliers[len(self.equalities) :]
        return pulls

    def limits(self, multipliers: Vector, kept: list[int]) -> list[float]:
        """How large |p| of every kink may be."""
        pulls = self.pulls(multipliers, kept)
        return [1.0 if kink.first is None else -float(pulls[kink.first]) for kink in self.kinks]

    def shares(self, multipliers: Vector, kept: list[int]) -> list[float]:
        """|p| of every kink as a share of that."""
        sizes = [float(np.linalg.norm(multipliers[kink.rows])) for kink in self.kinks]
        pairs = zip(sizes, self.limits(multipliers, kept), strict=True)
        return [size / limit if limit > 0 else (np.inf if size > OVER else 0.0) for size, limit in pairs]

    def held(self, multipliers: Vector, kept: list[int]) -> HeldCones:
        """What `smooth_slope` holds of the kinks."""
        found: HeldCones = {}
        limits = self.limits(multipliers, kept)
        none: tuple[float, Vector] = (0.0, np.zeros(1))
        for kink, limit in zip(self.kinks, limits, strict=True):
            if kink.number is not None and kink.axes is not None:
                of = kink.member, kink.number
                alpha, pull = found.get(of, none)
                more = kink.alpha * (multipliers[kink.rows] @ kink.axes)
                found[of] = alpha + kink.alpha * limit, pull + more
        return found

    def held_margins(self, multipliers: Vector) -> HeldMargins:
        """What kinks of ε_max pull: −pᵀ C is part of the Lagrangian's gradient, the mean of the branches the rest."""
        return {
            (kink.member, kink.objective): multipliers[kink.rows] @ kink.axes
            for kink in self.kinks
            if kink.number is None and kink.axes is not None
        }

    def weights(self, multipliers: Vector, kept: list[int]) -> Vector:
        """Multipliers of the constraints, (n_g,): the Lagrangian is V − weightsᵀ g."""
        pulls = self.pulls(multipliers, kept)
        weights = np.zeros(self.g.size)
        weights[self.equal] = multipliers[: len(self.equal)]
        for (number, sense), pull in zip(self.active, pulls, strict=False):
            weights[number] = sense * pull
        return weights


def multipliers_of(local: FirstOrderModel) -> tuple[Vector, list[int]]:
    """Multipliers of a maximum: gradient = λᵀ equalities − μᵀ inequalities, μ ≥ 0, and the inequalities that pull.

    The nearest there are: non-negative least squares on what the equalities cannot take up.
    """
    every = list(range(len(local.inequalities)))
    if not np.all(np.isfinite(local.gradient)) or not np.all(np.isfinite(local.rows(every))):
        return np.full(len(local.equalities) + len(every), np.nan), every
    inverse = np.linalg.pinv(local.equalities.T)
    free = np.eye(local.gradient.size) - local.equalities.T @ inverse
    pull = nonnegative_least_squares(-free @ local.inequalities.T, free @ local.gradient)
    kept: list[int] = np.flatnonzero(pull > 0).tolist()
    of_equalities = inverse @ (local.gradient + pull @ local.inequalities)
    return np.concatenate([of_equalities, -pull[kept]]), kept


def certified(local: FirstOrderModel) -> tuple[Vector, list[int]]:
    """As `multipliers_of`, with |p| of every kink no larger than an optimum's.

    Where the nearest multipliers have larger ones, p is moved by projected gradients of what is left; others follow.
    """
    multipliers, kept = multipliers_of(local)
    if all(share <= 1 + OVER for share in local.shares(multipliers, kept)) or not np.isfinite(multipliers).all():
        return multipliers, kept
    corners = np.vstack([local.equalities[kink.rows] for kink in local.kinks])
    others = np.ones(len(local.equalities), dtype=np.bool_)
    for kink in local.kinks:
        others[kink.rows] = False
    # Its own share of a step each time, and the momentum of Nesterov.
    short = 1.0 / float(np.linalg.norm(corners, 2)) ** 2
    pulls = np.concatenate([multipliers[kink.rows] for kink in local.kinks])
    ends = np.cumsum([0, *(kink.rows.stop - kink.rows.start for kink in local.kinks)]).tolist()
    limits = local.limits(multipliers, kept)
    best: tuple[float, Vector, list[int]] = (np.inf, multipliers, kept)
    before = ahead = _clipped(pulls, ends, limits)
    for number in range(ROUNDS):
        plain = replace(local, gradient=local.gradient - ahead @ corners, equalities=local.equalities[others], kinks=())
        found, pulling = multipliers_of(plain)
        left = plain.gradient - found @ plain.rows(pulling)
        whole = np.zeros(len(local.equalities) + len(pulling))
        whole[: len(others)][others] = found[: int(others.sum())]
        whole[: len(others)][~others] = ahead
        whole[len(others) :] = found[int(others.sum()) :]
        size = float(np.linalg.norm(left))
        if size < best[0] and all(share <= 1 + OVER for share in local.shares(whole, pulling)):
            best = size, whole, pulling
        if best[0] <= STATIONARITY_TOLERANCE / 10:
            break
        limits = local.limits(whole, pulling)
        now = _clipped(ahead + short * (corners @ left), ends, limits)
        ahead, before = _clipped(now + number / (number + 3) * (now - before), ends, limits), now
    return (best[1], best[2]) if np.isfinite(best[0]) else (multipliers, kept)


def _clipped(pulls: Vector, ends: list[int], limits: list[float]) -> Vector:
    """The p of all kinks, each no longer than its limit."""
    parts: list[Vector] = []
    for i, j, limit in zip(ends[:-1], ends[1:], limits, strict=True):
        size = float(np.linalg.norm(pulls[i:j]))
        parts.append(pulls[i:j] * min(1.0, limit / size) if size > 0 else pulls[i:j])
    return np.concatenate(parts)
