"""The box of what is uncertain of a machine and its loop's dead time, each number known as an interval only.

In: `Uncertainty`s and a machine. Out: members of the box, their numbers of the machine, which of them matters most.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from flexopt.errors import Fault
from flexopt.foundation.arrays import Vector
from flexopt.model import AnyMachine
from flexopt.model.loop import DELAY_MAX
from flexopt.model.uncertainty import LATE, Uncertainty, parameters_of, told_numbers
from flexopt.plant import build_plant, moving_end_point

# Corners are members up to that many intervals.
CORNERED = 6
# Least eigenvalue, in units of the diagonal, as of the matrices of a file.
INDEFINITE = 1e-12
# So near to an end of an interval, as a share of it, a member is at that end: searches come there to rounding.
AT_END = 1e-9
# As how likely to be chance a correlation is none.
CHANCE = 0.05


def _singly_then_odd(word: int) -> tuple[bool, bool, int, int]:
    """How columns of an array are ordered, by the factors they are products of, the bits of a word."""
    count = word.bit_count()
    return count != 1, count % 2 == 0, -count, word


@dataclass(frozen=True)
class UncertaintyBox:
    """All machines that the uncertainty allows: points u in [0, 1]^k, k intervals.

    A factor runs from its lower to its upper end evenly in its logarithm, a value evenly.

    Attributes:
        machine: with the nominal numbers.
        uncertainty: what is not known.
        nominal_dead_time: of the loop, s, where it is known.
    """

    machine: AnyMachine
    uncertainty: tuple[Uncertainty, ...]
    nominal_dead_time: float

    def faults(self, rate: float) -> list[Fault]:
        """What a loop sampled at `rate`, Hz, cannot be told of: longer dead times, and other geometry.

        Where the end-point depends on what is uncertain, a posture that reaches the target does so no more.
        """
        found, plant = self.indefinite(), build_plant(self.machine)
        for k, (each, entries) in enumerate(zip(self.uncertainty, self.entries, strict=True)):
            if each.of == (LATE,) and each.value is not None and each.value[1] * rate > DELAY_MAX:
                sentence = f"must be at most {DELAY_MAX} samples of {1 / rate:g} s"
                found.append(Fault(f"ranges[{k}].value", sentence, f"{each.value[1]:g}"))
            if names := moving_end_point(plant, entries):
                found.append(Fault(f"ranges[{k}].of", f"moves the end-point ({names}): postures would miss", each.name))
        return found

    def indefinite(self) -> list[Fault]:
        """Springs that hold the base no more, or dampers that drive it, at a corner of what is uncertain.

        Their matrices are linear in each number by itself: what is definite at all corners is so in between.
        """
        plant = build_plant(self.machine)
        m, names = plant.n_passive, ("the springs' stiffness matrix", "the dampers' matrix")
        for name, of, least in zip(names, (plant.stiffness, plant.damping), (INDEFINITE, -INDEFINITE), strict=True):
            entries = set(of.jac_sparsity(0, 0).get_triplet()[1])
            on = [k for k, own in enumerate(self.entries) if entries & set(own)]
            for ends in product((0.0, 1.0), repeat=len(on)):
                u = np.full(len(self.uncertainty), 0.5)
                u[on] = ends
                p = np.where(np.isin(np.arange(self.nominal.size), [*entries]), self.numbers(u)[0], self.nominal)
                matrix = of(p).full()[:m, :m]
                size = np.sqrt(np.where(np.diag(matrix) > 0, np.diag(matrix), 1.0))
                if np.linalg.eigvalsh(matrix / np.outer(size, size))[0] <= least:
                    word = "definite" if least > 0 else "semidefinite"
                    sentence = f"{name} is not positive {word} where {told_numbers(self.machine, p.tolist())}"
                    return [Fault("ranges", sentence)]
        return []

    @property
    def names(self) -> tuple[str, ...]:
        """Of the intervals."""
        return tuple(each.name for each in self.uncertainty)

    @cached_property
    def nominal(self) -> Vector:
        """The machine's own parameters (n_par,)."""
        return np.array([parameter.value for parameter in self.machine.parameters])

    @cached_property
    def entries(self) -> list[list[int]]:
        """Of the parameters, what each interval concerns."""
        return [list(parameters_of(each.of, self.machine)) for each in self.uncertainty]

    @property
    def holds_nominal(self) -> bool:
        """Whether the machine's own numbers, and the loop's dead time, lie in all intervals."""
        for each, entries in zip(self.uncertainty, self.entries, strict=True):
            low, high = each.factor or each.value or (0.0, 0.0)
            own = [1.0] if each.factor else [self.nominal_dead_time] if each.of == (LATE,) else self.nominal[entries]
            if not all(low <= x <= high for x in own):
                return False
        return True

    @property
    def judged_over(self) -> str:
        """What a choice by the worst counts, in words: the machine's own numbers, too; empty where all is known."""
        names = ", ".join(self.names)
        return f"{names}{', and with the own numbers, which lie outside' * (not self.holds_nominal)}" if names else ""

    def corners(self, most: int) -> Vector:
        """Corners (2^min(k, most), k): all of them, or of more intervals such that both ends of any two meet.

        An orthogonal array of strength 2 of up to 2^most − 1 intervals, of 3 where half of them are enough; of more of
        them several go together. It is the same in whatever order the intervals are named.
        """
        k = len(self.uncertainty)
        factors = min(k, most)
        # Columns of the array: factors by themselves, then products of odd and of even numbers of them.
        words = sorted(range(1, 2**factors), key=_singly_then_odd)
        found = np.full((2**factors, k), 0.5)
        for row, number in enumerate(range(2**factors)):
            for n, name in enumerate(self._by_name if factors else []):
                found[row, name] = (number & words[n % len(words)]).bit_count() % 2
        return found

    @property
    def _by_name(self) -> list[int]:
        return sorted(range(len(self.uncertainty)), key=lambda k: self.uncertainty[k].name)

    def members(self, count: int, seed: int = 0, first: int = 0) -> Vector:
        """Points (n, k): corners, of 6 intervals at most, then a scrambled Sobol sequence; `count` or more.

        `first`: so many are to be taken for all of them, and are the `corners` that are no more than that.
        """
        from scipy.stats.qmc import Sobol  # noqa: PLC0415  (loads slowly)

        k = len(self.uncertainty)
        begin: Vector = self.corners(int(math.log2(first))) if first > 1 else np.zeros((0, k))
        every: Vector = self.corners(k) if k <= CORNERED else np.zeros((0, k))
        rows: list[list[float]] = np.concatenate([begin, every]).tolist()
        corners = np.array(list(dict.fromkeys(map(tuple, rows)))).reshape(-1, k)
        more = max(0, count - len(corners))
        drawn = Sobol(k, seed=seed).random(1 << math.ceil(math.log2(max(more, 1))))[:more]
        drawn[:, self._by_name] = drawn.copy()
        return np.concatenate([corners, drawn])

    def cross(self, u: Vector, levels: int) -> Vector:
        """Members that differ from u (k,) in one interval alone, in so many even steps each: (levels k, k)."""
        found = np.tile(u, (levels * len(u), 1))
        for k in range(len(u)):
            found[k * levels : (k + 1) * levels, k] = np.linspace(0.0, 1.0, levels)
        return found

    def numbers(self, u: Vector) -> tuple[Vector, float]:
        """Parameters (n_par,) and dead time of a member."""
        p, late = self.numbers_at(self.theta(u))
        return p, float(late)

    def numbers_at(self, theta: Vector) -> tuple[Vector, Vector]:
        """The like, from the factors and values (k,) themselves; of N members (k, N): (n_par, N) and (N,)."""
        p, late = (
            np.multiply.outer(self.nominal, np.ones(theta.shape[1:])),
            np.full(theta.shape[1:], self.nominal_dead_time),
        )
        for each, entries, x in zip(self.uncertainty, self.entries, theta, strict=True):
            if each.of == (LATE,):
                late = x
            elif each.value is not None:
                p[entries] = x
            else:
                p[entries] *= x
        return p, late

    def theta(self, u: Vector) -> Vector:
        """Factors and values (k,) of a member."""
        return np.array([
            math.exp(_between(_logs(each.factor), x)) if each.value is None else _between(each.value, x)
            for each, x in zip(self.uncertainty, u.tolist(), strict=True)
        ])  # fmt: skip

    def slopes(self, u: Vector, by_p: Vector, by_dead_time: float) -> Vector:
        """A derivative by u (k,), from those by the parameters and the dead time."""
        p, found = self.numbers(u)[0], list[float]()
        for each, entries in zip(self.uncertainty, self.entries, strict=True):
            if each.of == (LATE,):
                found.append(by_dead_time * _width(each.value))
            elif each.value is not None:
                found.append(float(by_p[entries].sum()) * _width(each.value))
            else:
                found.append(float(by_p[entries] @ p[entries]) * _width(_logs(each.factor)))
        return np.array(found)

    def told(self, u: Vector) -> dict[str, float]:
        """A member by the names of its intervals: factors and values, at an end that which was given."""
        found = dict[str, float]()
        for each, x, value in zip(self.uncertainty, u.tolist(), self.theta(u).tolist(), strict=True):
            low, high = each.factor or each.value or (value, value)
            found[each.name] = low if x <= AT_END else high if x >= 1 - AT_END else value
        return found


def member_in_words(told: Mapping[str, float]) -> str:
    """A member as `UncertaintyBox.told` has it."""
    return ", ".join(f"{name} {value:.4g}" for name, value in told.items())


def _between(ends: tuple[float, float] | None, x: float) -> float:
    low, high = ends or (0.0, 0.0)
    return low + x * (high - low)


def _width(ends: tuple[float, float] | None) -> float:
    return _between(ends, 1.0) - _between(ends, 0.0)


def _logs(ends: tuple[float, float] | None) -> tuple[float, float]:
    low, high = ends or (1.0, 1.0)
    return math.log(low), math.log(high)


def matters_most(box: UncertaintyBox, members: Vector, values: Sequence[float]) -> tuple[str, float]:
    """The interval that a value goes with most closely, and their rank correlation; no name where chance may be it."""
    from scipy.stats import spearmanr  # noqa: PLC0415  (loads slowly)

    varied = [k for k, column in enumerate(members.T) if np.ptp(column)]
    if np.ptp(values) == 0 or not varied:
        return "", 0.0
    found: list[Any] = [spearmanr(members[:, k], values) for k in varied]
    first = max(range(len(found)), key=lambda k: abs(found[k].statistic))
    # Of several intervals the closest is the likelier to be so by chance.
    sure = found[first].pvalue * len(found) < CHANCE
    return box.names[varied[first]] if sure else "", float(found[first].statistic)
