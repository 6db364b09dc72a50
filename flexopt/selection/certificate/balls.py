"""Polynomials over a cell whose coefficients are balls of Arb, and small matrices of them, for `check` alone."""

from __future__ import annotations

from functools import reduce
from typing import Any

try:
    from flint import arb, arb_mat, arb_poly, arb_series, ctx
except ModuleNotFoundError:
    raise SystemExit("to check a certificate's log needs python-flint: pip install 'flexopt[certificates]'") from None

# Of polynomials.
DEGREE = 6
BallNumber = Any  # an int 0, an arb, or a Cell
BallVector = list[BallNumber]
BallMatrix = list[BallVector]


class Unknown(Exception):
    """A ball is too wide to divide by, or to take the root of."""


class BallSeries:
    """A function of h in a cell, |h| ≤ radius: Σ_k c_k h^k with c_k in balls that may depend on h."""

    def __init__(self, polynomial: arb_poly, h: arb) -> None:
        self.h = h
        if polynomial.degree() > DEGREE:
            c = polynomial.coeffs()
            polynomial = arb_poly([*c[:DEGREE], arb_poly(c[DEGREE:])(h)])
        self.polynomial = polynomial

    def _of(self, other: BallSeries | arb | int) -> arb_poly | arb | int:
        return other.polynomial if isinstance(other, BallSeries) else other

    def __add__(self, other: BallSeries | arb | int) -> BallSeries:
        return BallSeries(self.polynomial + self._of(other), self.h)

    def __sub__(self, other: BallSeries | arb | int) -> BallSeries:
        return BallSeries(self.polynomial - self._of(other), self.h)

    def __rsub__(self, other: arb | int) -> BallSeries:
        return BallSeries(other - self.polynomial, self.h)

    def __mul__(self, other: BallSeries | arb | int) -> BallSeries:
        return BallSeries(self.polynomial * self._of(other), self.h)

    __radd__, __rmul__ = __add__, __mul__

    @property
    def range(self) -> arb:
        """All values: of the parabola at its ends and its vertex, and of the rest."""
        c = [*self.polynomial.coeffs(), arb(0), arb(0), arb(0)]
        r, h2 = arb(self.h.rad()), self.h * self.h
        values = [c[0] + r * (c[1] + r * c[2]), c[0] - r * (c[1] - r * c[2])]
        vertex = -c[1] / (2 * c[2]) if not c[2].contains(0) else None
        if vertex is None:
            values = [c[0] + c[1] * self.h + c[2] * h2]
        elif vertex.overlaps(self.h):
            values.append(c[0] + vertex * c[1] / 2)
        hull = reduce(lambda one, other: one.union(other), values)
        return hull + arb_poly(c[3:])(self.h) * h2 * self.h

    def _approximate(self, root: bool) -> BallSeries:
        """The exact polynomial of 1/f or √f about the middle."""
        ctx.cap = DEGREE + 1
        middle = arb_series([x.mid() for x in self.polynomial.coeffs()] or [0])
        found = middle.sqrt() if root else 1 / middle
        return BallSeries(arb_poly([found[k].mid() for k in range(DEGREE + 1)]), self.h)

    def inverse(self) -> BallSeries:
        """1/f = q / (1 − e) with e = 1 − f q."""
        if self.polynomial[0].contains(0):
            raise Unknown
        q = self._approximate(root=False)
        off = (1 - self * q).range.abs_upper()
        if not off < 0.5:
            raise Unknown
        return q + arb(0, (q.range.abs_upper() * off / (1 - off)).upper())

    def root(self) -> BallSeries:
        """√f = s + (f − s²) / (√f + s)."""
        if not self.polynomial[0] > 0:
            raise Unknown
        s = self._approximate(root=True)
        off, least = (self - s * s).range.abs_upper(), s.range.lower()
        if not (least > 0 and off < least * least / 2):
            raise Unknown
        return s + arb(0, (off / least).upper())


def span(x: BallNumber) -> arb:
    """All values of a number."""
    return x.range if isinstance(x, BallSeries) else arb(x)


def zero(x: BallNumber) -> bool:
    """Whether a number is the int 0, which takes no part in anything."""
    return isinstance(x, int) and x == 0


def times(x: BallNumber, y: BallNumber) -> BallNumber:
    """X y."""
    return 0 if zero(x) or zero(y) else x * y


def plus(x: BallNumber, y: BallNumber) -> BallNumber:
    """X + y."""
    return y if zero(x) else x if zero(y) else x + y


def minus(x: BallNumber, y: BallNumber) -> BallNumber:
    """X − y."""
    return x if zero(y) else times(-1, y) if zero(x) else x - y


def inverted(x: BallNumber) -> BallNumber:
    """1 / x; `Unknown` where x may be 0."""
    if isinstance(x, BallSeries):
        return x.inverse()
    if arb(x).contains(0):
        raise Unknown
    return 1 / x


def root(x: BallNumber) -> BallNumber:
    """√x; `Unknown` where x may be 0."""
    if isinstance(x, BallSeries):
        return x.root()
    if not x > 0:
        raise Unknown
    return x.sqrt()


def total(terms: Any) -> BallNumber:
    """Σ x_i."""
    return reduce(plus, terms, 0)


def dot(x: BallVector, y: BallVector) -> BallNumber:
    """Σ x_i y_i; polynomials are brought back to their degree once, in the end."""
    found: Any = 0
    cell: BallSeries | None = None
    for a, b in zip(x, y, strict=True):
        if zero(a) or zero(b):
            continue
        p, q = a, b
        if isinstance(a, BallSeries):
            cell, p = a, a.polynomial
        if isinstance(b, BallSeries):
            cell, q = b, b.polynomial
        found = p * q if zero(found) else found + p * q
    return found if cell is None else BallSeries(found, cell.h)


def product(x: BallMatrix, y: BallMatrix) -> BallMatrix:
    """X Y."""
    columns = transposed(y)
    return [[dot(row, column) for column in columns] for row in x]


def added(x: BallMatrix, y: BallMatrix) -> BallMatrix:
    """X + Y."""
    return [[plus(a, b) for a, b in zip(*rows, strict=True)] for rows in zip(x, y, strict=True)]


def transposed(x: BallMatrix) -> BallMatrix:
    """Xᵀ."""
    return [list(column) for column in zip(*x, strict=True)]


def identity(n: int) -> BallMatrix:
    """The unit matrix."""
    return [[arb(1) if i == j else 0 for j in range(n)] for i in range(n)]


def cross(x: BallVector, y: BallVector) -> BallVector:
    """X × y."""
    return [minus(times(x[i], y[j]), times(x[j], y[i])) for i, j in ((1, 2), (2, 0), (0, 1))]


def number(x: float) -> BallNumber:
    """A double."""
    return arb(x) if x else 0


def numbers(x: list[float]) -> BallVector:
    """Doubles."""
    return [number(each) for each in x]


def solved(a: BallMatrix, b: BallMatrix) -> BallMatrix:
    """A⁻¹ B by elimination along the diagonal."""
    n = len(a)
    rows = [[*left, *right] for left, right in zip(a, b, strict=True)]
    for k in range(n):
        over = inverted(rows[k][k])
        # Columns up to the k-th are done with.
        rows[k][k + 1 :] = ahead = [times(x, over) for x in rows[k][k + 1 :]]
        for i in range(n):
            if i != k and not zero(share := rows[i][k]):
                rows[i][k + 1 :] = [minus(x, times(share, y)) for x, y in zip(rows[i][k + 1 :], ahead, strict=True)]
    return [row[n:] for row in rows]


def pivots_of(a: BallMatrix) -> BallVector:
    """The pivots of A by elimination downwards alone, whose product is det A."""
    rest, pivots = a, list[BallNumber]()
    while len(rest) > 1:
        (pivot, *first), *others = rest
        pivots.append(pivot)
        over = inverted(pivot)
        rest = [
            [minus(x, times(share, y)) for x, y in zip(row, first, strict=True)]
            for share, row in ((times(head, over), row) for head, *row in others)
        ]
    return [*pivots, rest[0][0]]


def inverse_of_lower(k: BallMatrix) -> BallMatrix:
    """L⁻¹ of K = L Lᵀ."""
    n = len(k)
    lower = [[arb(0)] * n for _ in range(n)]
    for i in range(n):
        for j in range(i + 1):
            left = k[i][j] - sum((lower[i][q] * lower[j][q] for q in range(j)), arb(0))
            lower[i][j] = left.sqrt() if i == j else left / lower[j][j]
    inverse = arb_mat(lower).inv()
    return [[inverse[i, j] if j <= i else arb(0) for j in range(n)] for i in range(n)]


def rotation(axis: list[float], cosine: BallNumber, sine: BallNumber) -> BallMatrix:
    """About a unit axis: c I + s [a]× + (1 − c) a aᵀ."""
    a = x, y, z = numbers(axis)
    skew = [[0, times(-1, z), y], [z, 0, times(-1, x)], [times(-1, y), x, 0]]
    rest = minus(arb(1), cosine)
    return [
        [total((cosine if i == j else 0, times(sine, skew[i][j]), times(rest, times(a[i], a[j])))) for j in range(3)]
        for i in range(3)
    ]
