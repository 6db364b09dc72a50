"""Cosines and sines of the bodies' angles through a step: computed anew, or carried along by small rotations.

In: angles as graphs. Out: `Heading`s, pairs (cos, sin). The carried ones start from pairs that the caller keeps as
states and turn them by polynomials, so that a loop over the steps holds no trigonometry; `turn` says whether the
rotations were small enough for it: above 1, or not a number, the step must be done with the computed ones.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import casadi as ca

from flexopt.plant.motion import CosSin, Directions

# What Taylor's polynomials leave out at these limits is below a fifth of the last place of 1.
TURN_LIMIT, TURN_TERMS = 0.03, (3, 4)  # rad; cosine to the 6th, sine to the 7th power
NUDGE_LIMIT, NUDGE_TERMS = 1.2e-3, (2, 2)  # rad; 4th and 3rd


@dataclass(frozen=True)
class Heading:
    """Directions of the bodies that turn.

    Attributes:
        pairs: (cos φ_k, sin φ_k).
        angles: φ_k where they are known, (number of turning bodies,).
        rotated: pairs (cos, sin) of the rotation since the start of the step, where it was made by `turned`.
    """

    pairs: Directions
    angles: ca.SX | None = None
    rotated: Directions | None = None


class TurningFrame(Protocol):
    """Directions at the start of a step and after rotations (number of turning bodies,), rad."""

    @property
    def start(self) -> Heading:
        """At the start of the step."""
        ...

    def turned(self, rotation: ca.SX) -> Heading:
        """The start, turned."""
        ...

    def nudged(self, heading: Heading, rotation: ca.SX) -> Heading:
        """A heading, turned by very little."""
        ...

    def doubled(self, heading: Heading) -> Heading:
        """The start, turned twice as far as `heading` is from it."""
        ...


class Computed:
    """From the angles themselves."""

    def __init__(self, angles: ca.SX) -> None:
        self.start = self._at(angles)

    def turned(self, rotation: ca.SX) -> Heading:
        """See `TurningFrame`."""
        return self._at(_angles(self.start) + rotation)

    def nudged(self, heading: Heading, rotation: ca.SX) -> Heading:
        """See `TurningFrame`."""
        return self._at(_angles(heading) + rotation)

    def doubled(self, heading: Heading) -> Heading:
        """See `TurningFrame`."""
        return self._at(2 * _angles(heading) - _angles(self.start))

    @staticmethod
    def _at(angles: ca.SX) -> Heading:
        return Heading([(ca.cos(angles[k]), ca.sin(angles[k])) for k in range(angles.shape[0])], angles)


def _angles(heading: Heading) -> ca.SX:
    assert heading.angles is not None
    return heading.angles


class Carried:
    """From pairs known at the start of the step, stacked as (cos, sin, cos, sin, …).

    Attributes:
        turn: sum of the squares of all rotations, as shares of what the polynomials allow.
    """

    def __init__(self, pairs: ca.SX) -> None:
        self.start = Heading(paired(pairs))
        self._turns: list[ca.SX] = []
        self._nudges: list[ca.SX] = []

    def turned(self, rotation: ca.SX) -> Heading:
        """See `TurningFrame`."""
        self._turns.append(rotation)
        small = [_small(rotation[k], TURN_TERMS) for k in range(rotation.shape[0])]
        return Heading(_turned(self.start.pairs, small), rotated=small)

    def nudged(self, heading: Heading, rotation: ca.SX) -> Heading:
        """See `TurningFrame`."""
        self._nudges.append(rotation)
        small = [_small(rotation[k], NUDGE_TERMS) for k in range(rotation.shape[0])]
        return Heading(_turned(heading.pairs, small))

    def doubled(self, heading: Heading) -> Heading:
        """See `TurningFrame`; e(φ + 2δ) = 2 cos δ e(φ + δ) − e(φ)."""
        assert heading.rotated is not None
        result: Directions = []
        for (c0, s0), (c, s), (cosine, _) in zip(self.start.pairs, heading.pairs, heading.rotated, strict=True):
            twice = 2 * cosine
            result.append((twice * c - c0, twice * s - s0))
        return Heading(result)

    @property
    def turn(self) -> ca.SX:
        """See the class."""
        total = ca.SX(0)
        for rotations, limit in ((self._turns, TURN_LIMIT), (self._nudges, NUDGE_LIMIT)):
            total += (1 / limit**2) * sum((ca.dot(rotation, rotation) for rotation in rotations), start=ca.SX(0))
        return total


def _turned(pairs: Directions, by: Directions) -> Directions:
    return [(c * cosine - s * sine, s * cosine + c * sine) for (c, s), (cosine, sine) in zip(pairs, by, strict=True)]


def _small(angle: ca.SX, terms: tuple[int, int]) -> CosSin:
    """Cosine and sine by Taylor's polynomials: so many even powers beyond 1, and so many odd ones."""
    square, (even, odd) = angle * angle, terms
    cosine = _series([(-1.0) ** k / math.factorial(2 * k) for k in range(even + 1)], square)
    return cosine, angle * _series([(-1.0) ** k / math.factorial(2 * k + 1) for k in range(odd)], square)


def _series(coefficients: list[float], x: ca.SX) -> ca.SX:
    """Horner's scheme."""
    result = ca.SX(coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        result = coefficient + x * result
    return result


def stacked(directions: Directions) -> ca.SX:
    """The pairs as one column."""
    return ca.vertcat(*(entry for pair in directions for entry in pair))


def paired(column: ca.SX) -> Directions:
    """The pairs of a column."""
    return [(column[2 * k], column[2 * k + 1]) for k in range(column.shape[0] // 2)]
