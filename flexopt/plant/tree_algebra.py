"""Vectors in space, turns about z and a symmetric solve, of graphs by scalars: zeros fold as they are written.

In: SX scalars, alone and in tuples. Out: the same. Whatever is exactly zero drops out term by term.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce

import casadi as ca

from flexopt.model.kinematic_tree import INERTIA_ENTRIES
from flexopt.plant.tree_structure import MatrixRows

Scalar = ca.SX
Triple = tuple[Scalar, Scalar, Scalar]
Pair = tuple[Scalar, Scalar]
Wrench = tuple[Triple, Triple]  # force, moment about the body's origin
AXES = "xyz"
SECOND = INERTIA_ENTRIES
ZERO = ca.SX(0)
ORIGIN: Triple = (ZERO, ZERO, ZERO)
ONE = ca.SX(1)
UNITS: tuple[Triple, Triple, Triple] = ((ONE, ZERO, ZERO), (ZERO, ONE, ZERO), (ZERO, ZERO, ONE))
NOWHERE: dict[str, Scalar] = dict.fromkeys(SECOND, ZERO)


def _plus(a: Scalar, b: Scalar) -> Scalar:
    """The sum; the operator takes seven times as long, because it looks for other types first."""
    return ca.SX.binary(ca.OP_ADD, a, b)


def _minus(a: Scalar, b: Scalar) -> Scalar:
    return ca.SX.binary(ca.OP_SUB, a, b)


def _times(a: Scalar, b: Scalar) -> Scalar:
    return ca.SX.binary(ca.OP_MUL, a, b)


def add(a: Triple, b: Triple) -> Triple:
    """Sum of two vectors."""
    return _plus(a[0], b[0]), _plus(a[1], b[1]), _plus(a[2], b[2])


def scaled(factor: Scalar, a: Triple) -> Triple:
    """A vector times a number."""
    return _times(factor, a[0]), _times(factor, a[1]), _times(factor, a[2])


def dot(a: Triple, b: Triple) -> Scalar:
    """Scalar product."""
    return _plus(_plus(_times(a[0], b[0]), _times(a[1], b[1])), _times(a[2], b[2]))


def cross(a: Triple, b: Triple) -> Triple:
    """Vector product."""
    x, y, z = (_minus(_times(a[i], b[j]), _times(a[j], b[i])) for i, j in ((1, 2), (2, 0), (0, 1)))
    return x, y, z


def turned(matrix: MatrixRows, a: Triple) -> Triple:
    """Constant matrix times vector."""
    x, y, z = (_combined(row, a) for row in matrix)
    return x, y, z


def turned_back(matrix: MatrixRows, a: Triple) -> Triple:
    """Transposed constant matrix times vector."""
    return turned((_column(matrix, 0), _column(matrix, 1), _column(matrix, 2)), a)


def _column(matrix: MatrixRows, k: int) -> tuple[float, float, float]:
    return matrix[0][k], matrix[1][k], matrix[2][k]


def _combined(row: Sequence[float], a: Triple) -> Scalar:
    terms = [part if entry == 1 else _times(ca.SX(entry), part) for entry, part in zip(row, a, strict=True) if entry]
    return reduce(_plus, terms) if terms else ZERO


def times(rows: tuple[Triple, Triple, Triple], a: Triple) -> Triple:
    """Rows times vector."""
    return dot(rows[0], a), dot(rows[1], a), dot(rows[2], a)


def reversed_turn(turn: Pair | None) -> Pair | None:
    """The turn back."""
    return None if turn is None else (turn[0], -turn[1])


def about_z(turn: Pair | None, a: Triple) -> Triple:
    """A vector turned about z by an angle given as (cos, sin)."""
    if turn is None:
        return a
    c, s = turn
    x, y = _minus(_times(c, a[0]), _times(s, a[1])), _plus(_times(s, a[0]), _times(c, a[1]))
    return x, y, a[2]


def second_about_z(turn: Pair | None, second: Mapping[str, Scalar]) -> Mapping[str, Scalar]:
    """A second moment turned about z."""
    if turn is None:
        return second
    c, s = turn
    xx, yy, zz, xy, xz, yz = (second[name] for name in SECOND)
    # s² (xx − yy) + 2 c s xy leaves xx and enters yy.
    difference = xx - yy
    exchanged = s * (s * difference + 2 * c * xy)
    across = (1 - 2 * s * s) * xy + c * s * difference
    return {"xx": xx - exchanged, "yy": yy + exchanged, "zz": zz, "xy": across,
            "xz": c * xz - s * yz, "yz": s * xz + c * yz}  # fmt: skip


def second_turned(matrix: MatrixRows, second: Mapping[str, Scalar]) -> dict[str, Scalar]:
    """A second moment S turned by a constant matrix, E S Eᵀ."""
    rows = [[second["".join(sorted(a + b))] for b in AXES] for a in AXES]
    half = [turned(matrix, (row[0], row[1], row[2])) for row in rows]  # S Eᵀ
    columns = [turned(matrix, (half[0][k], half[1][k], half[2][k])) for k in range(3)]
    return {name: columns[AXES.index(name[1])][AXES.index(name[0])] for name in SECOND}


@dataclass(frozen=True, eq=False)
class Moments:
    """Mass, first and second moment of what is rigid, about an origin, in some axes."""

    mass: Scalar
    first: Triple
    second: Mapping[str, Scalar]

    def __add__(self, other: Moments) -> Moments:
        second = {name: _plus(self.second[name], other.second[name]) for name in SECOND}
        return Moments(_plus(self.mass, other.mass), add(self.first, other.first), second)

    def moved(self, at: Triple) -> Moments:
        """About the point from which the origin lies `at`."""
        second: dict[str, Scalar] = {}
        for name in SECOND:
            a, b = AXES.index(name[0]), AXES.index(name[1])
            both = _times(self.first[a], at[b])
            both = _plus(both, both if a == b else _times(self.first[b], at[a]))
            second[name] = _plus(_plus(self.second[name], both), _times(_times(self.mass, at[a]), at[b]))
        return Moments(self.mass, add(self.first, scaled(self.mass, at)), second)


@dataclass(frozen=True, eq=False)
class Spin:
    """How a body's axes turn: rate ω, its square's and its derivative's part in U (rows), all in its axes."""

    omega: Triple
    alpha: Triple

    @cached_property
    def u(self) -> tuple[Triple, Triple, Triple]:
        """[α]× + [ω]×², by rows."""
        (x, y, z), (ax, ay, az) = self.omega, self.alpha
        xy, xz, yz = x * y, x * z, y * z
        xx, yy, zz = x * x, y * y, z * z
        return (-yy - zz, xy - az, xz + ay), (xy + az, -xx - zz, yz - ax), (xz - ay, yz + ax, -xx - yy)

    def moment(self, second: Mapping[str, Scalar]) -> Triple:
        """Σ r × U r dm."""
        (x, y, z), u = self.omega, self.u
        xx, yy, zz, xy, xz, yz = (second[name] for name in SECOND)
        return (
            u[2][1] * yy - u[1][2] * zz + (z * z - y * y) * yz + u[2][0] * xy - u[1][0] * xz,
            u[0][2] * zz - u[2][0] * xx + (x * x - z * z) * xz + u[0][1] * yz - u[2][1] * xy,
            u[1][0] * xx - u[0][1] * yy + (y * y - x * x) * xy + u[1][2] * xz - u[0][2] * yz,
        )


def solve_symmetric(
    entries: Mapping[tuple[int, int], ca.SX], right: list[ca.SX], order: list[int], known: Mapping[int, ca.SX]
) -> list[ca.SX]:
    """Solution of a positive definite system, eliminated in `order`; entries that are not there are zero.

    Args:
        entries: (i, j) for i ≥ j.
        right: right-hand side.
        order: of elimination.
        known: reciprocals of diagonal entries, used where no elimination has changed them.
    """
    block = {key: entry for key, entry in entries.items() if not entry.is_zero()}
    right, left = list(right), list(order)
    changed: set[int] = set()
    factors: list[tuple[int, ca.SX, dict[int, ca.SX]]] = []
    while left:
        k = left.pop(0)
        inverse = known[k] if k in known and k not in changed else 1 / block[k, k]
        column = {j: block[max(j, k), min(j, k)] for j in left if (max(j, k), min(j, k)) in block}
        factor = {j: entry * inverse for j, entry in column.items()}
        for j, by in factor.items():
            right[j] = right[j] - by * right[k]
            for m, entry in column.items():
                if m <= j:
                    block[j, m] = block.get((j, m), ZERO) - by * entry
            changed.add(j)
        factors.append((k, inverse, factor))
    result = [ZERO] * len(right)
    for k, inverse, factor in reversed(factors):
        result[k] = right[k] * inverse
        for j, by in factor.items():
            result[k] = result[k] - by * result[j]
    return result
