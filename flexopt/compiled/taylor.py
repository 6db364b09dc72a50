"""Taylor models: polynomials over an interval with a rigorous bound on what is left, many intervals at once.

In: an expanded CasADi Function, and the interval of one variable for each of N cells. Out: for each output and cell a
polynomial in t ∈ [−1, 1] and a bound r, so that the output is within r of the polynomial everywhere in the cell.

Every operation adds to r what it leaves out and bounds on its own rounding: sums and products are within one unit
roundoff of the exact ones (IEEE 754, rounding to nearest), the library's sin, cos and atan2 within `LIBRARY` units in
the last place. Numbers are doubles, or of `PRECISE` where the arguments are: 64 bits where the processor has them.
r is infinite where nothing is known, as next to a pole; NumPy's warnings of that are for callers to silence. Source:
Makino and Berz, "Taylor models and other validated functional inclusion methods", International Journal of Pure and
Applied Mathematics 4(4), 2003.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.compiled.instructions import Instructions

FloatArray = NDArray[Any]
DEGREE = 6
# Doubles with a longer fraction, where there are any; what some compilers make of two doubles is not rounded this way.
PRECISE: Any = np.longdouble if np.finfo(np.longdouble).nmant in (63, 112) else np.float64
# Units in the last place by which sin, cos and atan2 of the mathematical library may be wrong.
LIBRARY = 4.0
# More than rounding takes off a sum or product of some hundred non-negative numbers, and more than underflow takes.
_SAFE, _LEAST = 1.0 + 2.0**-44, 1e-290
# Up to this, tangents of what an angle turns by within a cell are developed into their series.
_TURN = 0.4


@dataclass(frozen=True, eq=False)
class TaylorModel:
    """Functions of t ∈ [−1, 1] in N cells: |f(t) − Σ_k c_k t^k| ≤ r.

    Attributes:
        c: coefficients (d + 1, N) or (d + 1, 1) of all cells alike.
        r: (N,) or (1,), infinite where nothing is known.
    """

    c: FloatArray
    r: FloatArray

    @staticmethod
    def constant(value: float) -> TaylorModel:
        """A double."""
        return TaylorModel(np.array([[value]]), np.zeros(1))

    @staticmethod
    def of_cells(low: FloatArray, high: FloatArray) -> TaylorModel:
        """The variable itself in the cells [low, high], (N,) each."""
        middle = (low + high) / 2
        radius = np.maximum(high - middle, middle - low) * _SAFE
        return TaylorModel(np.array([middle, radius]), np.full(radius.shape, _LEAST))

    @staticmethod
    def between(low: FloatArray, high: FloatArray) -> TaylorModel:
        """What is known to lie in [low, high], (N,) each, and nothing more."""
        middle = np.where(np.isfinite(low) & np.isfinite(high), (low + high) / 2, 0.0)
        radius = np.maximum(high - middle, middle - low)
        return TaylorModel(middle[None, :], _known(radius * _SAFE + _LEAST))

    def typed(self, kind: Any) -> TaylorModel:
        """The same in numbers of another precision, at least its own."""
        return TaylorModel(self.c.astype(kind), self.r)

    @cached_property
    def size(self) -> FloatArray:
        """Σ_k |c_k|, rounded up."""
        return np.abs(self.c).sum(axis=0) * _SAFE

    @property
    def largest(self) -> FloatArray:
        """A bound on |f|."""
        return (self.size + self.r) * _SAFE

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Bounds on f from below and above: those of the parabola, widened by all else."""
        c0, c1, c2 = (self.c[k] if k < len(self.c) else np.zeros_like(self.c[0]) for k in range(3))
        rest = np.abs(self.c[3:]).sum(axis=0) + self.r + 8 * _unit(self.c) * self.size + _LEAST
        vertex = np.where(np.abs(c1) < 2 * np.abs(c2), -c1 * c1 / (4 * c2), 0.0)
        ends = np.abs(c1) + c2
        up, down = np.maximum(ends, np.maximum(vertex, 0.0)), np.minimum(c2 - np.abs(c1), np.minimum(vertex, 0.0))
        low, high = c0 + down - rest * _SAFE, c0 + up + rest * _SAFE
        if low.dtype == np.float64:
            return low, high
        # As doubles, and outward.
        return np.nextafter(low.astype(float), -np.inf), np.nextafter(high.astype(float), np.inf)

    @property
    def changing(self) -> TaylorModel:
        """F less its value in the middle."""
        c = self.c.copy()
        c[0] = 0.0
        return TaylorModel(c, self.r)

    def at(self, chosen: Any) -> TaylorModel:
        """The same in some of the cells."""
        return TaylorModel(*(x if x.shape[-1] == 1 else x[..., chosen] for x in (self.c, self.r)))

    def __neg__(self) -> TaylorModel:
        return TaylorModel(-self.c, self.r)

    def __add__(self, other: TaylorModel) -> TaylorModel:
        long, short = (self, other) if len(self.c) >= len(other.c) else (other, self)
        shape = len(long.c), max(long.c.shape[1], short.c.shape[1])
        c = np.broadcast_to(long.c, shape).astype(np.result_type(long.c, short.c))
        c[: len(short.c)] += short.c
        return _rounded(c, self.r + other.r, 1.0)

    def __sub__(self, other: TaylorModel) -> TaylorModel:
        return self + -other

    def __mul__(self, other: TaylorModel) -> TaylorModel:
        a, b = self, other
        if len(a.c) > len(b.c):
            a, b = b, a
        if len(a.c) == 1:
            r = a.r * b.largest + np.abs(a.c[0]) * b.r
            return _rounded(a.c * b.c, r, 1.0)
        n_a, n_b = len(a.c) - 1, len(b.c) - 1
        most = min(DEGREE, n_a + n_b)
        c = np.zeros((most + 1, max(a.c.shape[1], b.c.shape[1])), dtype=np.result_type(a.c, b.c))
        for i in range(n_a + 1):
            n = min(n_b, most - i) + 1
            c[i : i + n] += a.c[i] * b.c[:n]
        r = a.r * b.largest + a.size * b.r + (n_a + 2) * _unit(c) * a.size * b.size
        if n_a + n_b > DEGREE:
            tails = np.cumsum(np.abs(b.c[::-1]), axis=0)[::-1]
            for i in range(max(0, DEGREE + 1 - n_b), n_a + 1):
                r = r + np.abs(a.c[i]) * tails[DEGREE + 1 - i]
        return TaylorModel(c, _known(r * _SAFE + _LEAST))

    def scaled(self, factor: FloatArray | float, roundoffs: float = 0.0) -> TaylorModel:
        """The product with numbers (N,) that are known to so many of their own unit roundoffs."""
        c, numbers = self.c * factor, np.asarray(factor)
        return _rounded(c, np.abs(numbers) * self.r, 1.0 + roundoffs * (_unit(numbers) / _unit(c)))

    def over(self, number: float) -> TaylorModel:
        """The quotient by a number > 0."""
        return _rounded(self.c / number, self.r / number, 1.0)

    def inverse(self) -> TaylorModel:
        """1 / f: the reciprocal's series, and a bound on its error from what f times it is short of 1."""
        f, n = self.c, len(self.c)
        q = np.zeros((1 if n == 1 else DEGREE + 1, f.shape[1]), dtype=f.dtype)
        q[0] = 1.0 / f[0]
        for k in range(1, len(q)):
            q[k] = -q[0] * sum(f[i] * q[k - i] for i in range(1, min(k, n - 1) + 1))
        inverse = TaylorModel(np.nan_to_num(q), np.zeros(q.shape[1]))
        off = (_ONE - self * inverse).largest
        r = np.where(off < 0.5, inverse.size * off / (1.0 - off), np.inf)
        return TaylorModel(inverse.c, _known(r * _SAFE + _LEAST))

    def sqrt(self) -> TaylorModel:
        """√f: the root's series s, and |√f − s| = |f − s²| / (√f + s)."""
        f, n = self.c, len(self.c)
        s = np.zeros((1 if n == 1 else DEGREE + 1, f.shape[1]), dtype=f.dtype)
        s[0] = np.sqrt(f[0])
        for k in range(1, len(s)):
            inner = sum((s[i] * s[k - i] for i in range(1, k)), start=np.zeros_like(s[0]))
            s[k] = ((f[k] if k < n else 0.0) - inner) / (2.0 * s[0])
        root = TaylorModel(np.nan_to_num(s), np.zeros(s.shape[1]))
        off = (self - root * root).largest
        least = (2.0 * s[0] - root.size) * (1.0 - 1e-12)
        r = np.where((least > 0) & (off <= 0.5 * least * least), off / least, np.inf)
        return TaylorModel(root.c, _known(r * _SAFE + _LEAST))

    def sine_cosine(self) -> tuple[TaylorModel, TaylorModel]:
        """Sin f and cos f, by the sums of angles and the series of what changes within the cell."""
        change = self.changing
        square, size = change * change, change.largest
        terms = DEGREE // 2 + 1
        sine, cosine = _ONE, _ONE
        for j in range(terms - 1, 0, -1):
            sine = _ONE - (square * sine).over(2.0 * j * (2 * j + 1))
            cosine = _ONE - (square * cosine).over((2 * j - 1) * 2.0 * j)
        sine = (change * sine).widened(size ** (2 * terms + 1) / math.factorial(2 * terms + 1))
        cosine = cosine.widened(size ** (2 * terms) / math.factorial(2 * terms))
        s, c = np.sin(self.c[0]), np.cos(self.c[0])
        both = (
            cosine.scaled(s, 2 * LIBRARY) + sine.scaled(c, 2 * LIBRARY),
            cosine.scaled(c, 2 * LIBRARY) - sine.scaled(s, 2 * LIBRARY),
        )
        return both[0].clipped(1.0), both[1].clipped(1.0)

    def widened(self, by: FloatArray | float) -> TaylorModel:
        """The same with more left over."""
        return TaylorModel(self.c, _known((self.r + by) * _SAFE))

    def clipped(self, bound: float) -> TaylorModel:
        """The same where it says more than |f| ≤ bound, which is known otherwise."""
        worse = ~(self.r <= bound)
        return TaylorModel(np.where(worse, 0.0, self.c), np.where(worse, bound, self.r))


def _known(r: FloatArray) -> FloatArray:
    """Infinite where r is no number."""
    return np.where(np.isnan(r), np.inf, r)


def _unit(c: Any) -> float:
    """The unit roundoff of numbers of that precision."""
    return 2.0 ** -(np.finfo(c.dtype).nmant + 1)


def _rounded(c: FloatArray, r: FloatArray, roundoffs: float) -> TaylorModel:
    """Coefficients each of which is wrong by so many roundings."""
    size = np.abs(c).sum(axis=0)
    return TaylorModel(c, _known((r + (roundoffs + 1e-9) * _unit(c) * size) * _SAFE + _LEAST))


def angle(y: TaylorModel, x: TaylorModel) -> TaylorModel:
    """The angle of (x, y), on one turn throughout each cell, wherever atan2 may jump."""
    y0, x0 = y.c[0], x.c[0]
    along, across = x.scaled(x0) + y.scaled(y0), y.scaled(x0) - x.scaled(y0)
    tangent = across * along.inverse()
    square, size = tangent * tangent, tangent.largest
    terms = DEGREE // 2 + 1
    series = _ZERO
    for j in range(terms - 1, -1, -1):
        series = _ONE.typed(square.c.dtype).over(2.0 * j + 1.0) - square * series
    left = np.where((along.bounds[0] > 0) & (size < _TURN), size ** (2 * terms + 1) / (2 * terms + 1), np.inf)
    turned = (tangent * series).widened(left)
    middle = np.arctan2(y0, x0)
    start = TaylorModel(middle[None, :], 2 * LIBRARY * _unit(middle) * np.abs(middle) + _LEAST)
    return turned + start


def chosen(low: FloatArray, high: FloatArray, first: TaylorModel, second: TaylorModel) -> TaylorModel:
    """The first where a number in [low, high] is positive, the second where it is negative; what holds both else."""
    length, count = max(len(first.c), len(second.c)), max(first.c.shape[1], second.c.shape[1], low.size)
    found: list[tuple[FloatArray, FloatArray]] = []
    for model in (first, second):
        c = np.zeros((length, count), dtype=model.c.dtype)
        c[: len(model.c)] = model.c
        found.append((c, np.broadcast_to(model.r, (count,))))
    (a, r_a), (b, r_b) = found
    lows, highs = zip(first.bounds, second.bounds, strict=True)
    hull = TaylorModel.between(*np.broadcast_arrays(np.minimum(*lows), np.maximum(*highs), low)[:2])
    both = np.zeros((length, count))
    both[0] = hull.c[0]
    c = np.where(low >= 0, a, np.where(high <= 0, b, both))
    return TaylorModel(c, np.where(low >= 0, r_a, np.where(high <= 0, r_b, hull.r)))


_ONE, _ZERO = TaylorModel.constant(1.0), TaylorModel.constant(0.0)


def _truth(holds: NDArray[np.bool_], fails: NDArray[np.bool_]) -> TaylorModel:
    return TaylorModel.between(np.where(holds, 1.0, 0.0), np.where(fails, 0.0, 1.0))


def _less(a: TaylorModel, b: TaylorModel) -> TaylorModel:
    low, high = (a - b).bounds
    return _truth(high < 0, low >= 0)


def _less_or_equal(a: TaylorModel, b: TaylorModel) -> TaylorModel:
    low, high = (a - b).bounds
    return _truth(high <= 0, low > 0)


def _absolute(a: TaylorModel) -> TaylorModel:
    return chosen(*a.bounds, a, -a)


def _largest(a: TaylorModel, b: TaylorModel) -> TaylorModel:
    return chosen(*(a - b).bounds, a, b)


def _smallest(a: TaylorModel, b: TaylorModel) -> TaylorModel:
    return chosen(*(a - b).bounds, b, a)


def _where(condition: TaylorModel, value: TaylorModel) -> TaylorModel:
    low, high = condition.bounds
    # True and false are 1 and 0.
    return chosen(low - 0.75, high - 0.75, value, _ZERO)


def _arccosine(a: TaylorModel) -> TaylorModel:
    return angle((_ONE - a * a).sqrt(), a)


TaylorOperation = Callable[[TaylorModel, TaylorModel], TaylorModel]
# For each operation its value from both operands (a single one is given twice).
OPERATIONS: dict[int, TaylorOperation] = {
    ca.OP_ASSIGN: lambda a, _: a,
    ca.OP_ADD: lambda a, b: a + b,
    ca.OP_SUB: lambda a, b: a - b,
    ca.OP_MUL: lambda a, b: a * b,
    ca.OP_DIV: lambda a, b: a * b.inverse(),
    ca.OP_NEG: lambda a, _: -a,
    ca.OP_SQ: lambda a, _: a * a,
    ca.OP_TWICE: lambda a, _: a + a,
    ca.OP_INV: lambda a, _: a.inverse(),
    ca.OP_SQRT: lambda a, _: a.sqrt(),
    ca.OP_SIN: lambda a, _: a.sine_cosine()[0],
    ca.OP_COS: lambda a, _: a.sine_cosine()[1],
    ca.OP_ACOS: lambda a, _: _arccosine(a),
    ca.OP_ATAN2: angle,
    ca.OP_FABS: lambda a, _: _absolute(a),
    ca.OP_SIGN: lambda a, _: chosen(*a.bounds, _ONE, -_ONE),
    ca.OP_FMIN: _smallest,
    ca.OP_FMAX: _largest,
    ca.OP_LT: _less,
    ca.OP_LE: _less_or_equal,
    ca.OP_NOT: lambda a, _: _ONE - a,
    ca.OP_AND: lambda a, b: a * b,
    ca.OP_OR: lambda a, b: _ONE - (_ONE - a) * (_ONE - b),
    ca.OP_IF_ELSE_ZERO: _where,
}


class TaylorFunction:
    """An expanded (SX) Function evaluated in Taylor models; nothing is known of what unknown operations give."""

    def __init__(self, function: ca.Function) -> None:
        self._graph = Instructions(function)

    @np.errstate(all="ignore")
    def __call__(self, *inputs: Sequence[TaylorModel]) -> list[list[TaylorModel]]:
        """The entries of each output, column by column, from those of each input."""
        graph, values = self._graph, list[TaylorModel]()
        kind = np.result_type(*(model.c for given in inputs for model in given))
        inputs = tuple([model.typed(kind) for model in given] for given in inputs)
        unknown = TaylorModel(np.zeros((1, 1)), np.full(1, np.inf))
        sines: dict[int, tuple[TaylorModel, TaylorModel]] = {}
        for node, (operation, first, second) in enumerate(graph.instructions):
            if operation == ca.OP_INPUT:
                values.append(inputs[first][second])
            elif operation == ca.OP_CONST:
                values.append(TaylorModel.constant(graph.constants[node]).typed(kind))
            elif operation in (ca.OP_SIN, ca.OP_COS):
                if first not in sines:
                    sines[first] = values[first].sine_cosine()
                values.append(sines[first][operation == ca.OP_COS])
            elif operation in OPERATIONS:
                values.append(OPERATIONS[operation](values[first], values[second]))
            else:
                values.append(unknown)
        outputs: list[list[TaylorModel]] = [[_ZERO] * (rows * columns) for rows, columns in graph.shapes_out]
        for node, output, element in graph.results:
            outputs[output][element] = values[node]
        return outputs


@lru_cache(maxsize=8)
def taylor(function: ca.Function) -> TaylorFunction:
    """`function` in Taylor models; translated once and kept."""
    return TaylorFunction(function)


def matrix(entries: Sequence[TaylorModel], rows: int) -> list[list[TaylorModel]]:
    """Entries column by column as a list of rows."""
    return [list(entries[k::rows]) for k in range(rows)]


def dot(a: Sequence[TaylorModel], b: Sequence[TaylorModel]) -> TaylorModel:
    """Σ a_k b_k."""
    return sum((x * y for x, y in zip(a, b, strict=True)), start=_ZERO)
