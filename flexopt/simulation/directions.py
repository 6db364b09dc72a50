"""Cosines and sines of the bodies' angles through a step: computed anew, or carried along by small rotations.

In: angles as graphs. Out: pairs (cos, sin). The carried ones start from pairs that the caller keeps as states and turn
them by polynomials, so that a loop over the steps holds no trigonometry; `turn` says whether the rotations were small
enough for it: above 1, or not a number, the step must be done with the computed ones.
"""

from __future__ import annotations

from typing import Protocol

import casadi as ca

from flexopt.plant.motion import Directions, Pair

# Taylor's remainders at these limits are below half a unit in the last place of 1.
TURN_LIMIT = 0.06  # rad; sine to the 7th, cosine to the 8th power
DEFLECTION_LIMIT = 0.25  # rad; 11th, 12th


class Frame(Protocol):
    """Directions at the start of a step and after rotations."""

    def turned(self, rotation: ca.SX | None) -> Directions:
        """Directions after each has been turned by its entry of `rotation` (number of turning bodies,), rad."""
        ...

    def deflection(self, angle: ca.SX) -> Pair:
        """Cosine and sine of a passive hinge's deflection."""
        ...


class Computed:
    """From the angles themselves."""

    def __init__(self, angles: ca.SX) -> None:
        self._angles = angles

    def turned(self, rotation: ca.SX | None) -> Directions:
        """See `Frame`."""
        angles = self._angles if rotation is None else self._angles + rotation
        return [(ca.cos(angles[k]), ca.sin(angles[k])) for k in range(angles.shape[0])]

    def deflection(self, angle: ca.SX) -> Pair:
        """See `Frame`."""
        return ca.cos(angle), ca.sin(angle)


class Carried:
    """From pairs known at the start of the step, stacked as (cos, sin, cos, sin, …).

    Attributes:
        turn: largest rotation so far, as a share of what the polynomials allow.
    """

    def __init__(self, pairs: ca.SX) -> None:
        self._pairs = paired(pairs)
        self._rotations: list[ca.SX] = []
        self._deflections: list[ca.SX] = []

    def turned(self, rotation: ca.SX | None) -> Directions:
        """See `Frame`."""
        if rotation is None:
            return list(self._pairs)
        result: Directions = []
        for k, (c, s) in enumerate(self._pairs):
            self._rotations.append(rotation[k])
            # cos − 1 and sin, so that the pair loses nothing where the rotation is small.
            less, sine = _small(rotation[k], 4)
            result.append((c + (c * less - s * sine), s + (s * less + c * sine)))
        return result

    def deflection(self, angle: ca.SX) -> Pair:
        """See `Frame`."""
        self._deflections.append(angle)
        less, sine = _small(angle, 6)
        return 1 + less, sine

    @property
    def turn(self) -> ca.SX:
        """See the class; squares, so that the largest needs no absolute values."""
        largest = ca.SX(0)
        for angles, limit in ((self._rotations, TURN_LIMIT), (self._deflections, DEFLECTION_LIMIT)):
            square = ca.SX(0)
            for angle in angles:
                square = ca.fmax(square, angle * angle)
            largest = ca.fmax(largest, square * (1 / limit**2))
        return largest


def _small(angle: ca.SX, terms: int) -> Pair:
    """Cos − 1 and sin by Taylor's polynomial with so many terms each."""
    square = angle * angle
    less, sine = ca.SX(0), ca.SX(0)
    factorial = 1.0
    coefficients: list[float] = []
    for power in range(1, 2 * terms + 1):
        factorial *= power
        coefficients.append((-1.0) ** (power // 2) / factorial)
    for k in range(terms - 1, -1, -1):
        sine = coefficients[2 * k] + square * sine if k < terms - 1 else ca.SX(coefficients[2 * k])
        less = coefficients[2 * k + 1] + square * less if k < terms - 1 else ca.SX(coefficients[2 * k + 1])
    return square * less, angle * sine


def stacked(directions: Directions) -> ca.SX:
    """The pairs as one column."""
    return ca.vertcat(*(entry for pair in directions for entry in pair))


def paired(column: ca.SX) -> Directions:
    """The pairs of a column."""
    return [(column[2 * k], column[2 * k + 1]) for k in range(column.shape[0] // 2)]
