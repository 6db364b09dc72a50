"""CasADi Functions evaluated and differentiated in decimals of any precision, instruction by instruction.

In: an expanded Function and arguments as arrays of `Decimal`. Out: its outputs, the gradient of any linear combination
of them, and how far rounding in double precision would move that combination. For single points whose numbers lose too
many digits in double precision; a graph of a thousand instructions takes some milliseconds.
"""

from __future__ import annotations

import decimal
import math
import operator
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from decimal import Decimal
from functools import cached_property, lru_cache
from typing import Any, NamedTuple, cast

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from flexopt.compiled.instructions import Instructions

Exact = NDArray[np.object_]
DIGITS = 50
UNIT_ROUNDOFF = 2.0**-53
_ONE, _ZERO = Decimal(1), Decimal(0)
# A remainder by π/2 may begin with so many zeros.
_GUARD = 12
# Decimals of so many digits become doubles in half the time, still within 0.5001 units in the last place.
_SHORT = decimal.Context(prec=22, Emin=-(10**9), Emax=10**9, traps=[])


def digits(count: int = DIGITS) -> AbstractContextManager[decimal.Context]:
    """Within it decimals are rounded to `count` digits; overflow and 0/0 give infinities and NaN, not exceptions."""
    return decimal.localcontext(decimal.Context(prec=count, Emin=-(10**9), Emax=10**9, traps=[]))


def exact(values: ArrayLike) -> Exact:
    """Doubles as decimals, to the precision set."""
    array = np.asarray(values, dtype=float)
    converted = np.empty(array.size, dtype=object)
    shares, exponents = np.frexp(array.ravel())
    if np.all(np.isfinite(shares)) and np.min(exponents, initial=0) > -900:
        # The product of two exact decimals is rounded once.
        wholes, powers = (shares * 2.0**53).astype(np.int64).tolist(), (exponents - 53).tolist()
        converted[:] = [Decimal(whole) * _power(power) for whole, power in zip(wholes, powers, strict=True)]
    else:
        converted[:] = [+Decimal(x) for x in array.ravel().tolist()]
    return converted.reshape(array.shape)


@lru_cache(maxsize=4096)
def _power(exponent: int) -> Decimal:
    return Decimal(math.ldexp(1.0, exponent))


def rounded(values: Exact) -> NDArray[np.float64]:
    """Doubles within 0.5001 units in their last place."""
    return np.array(plain(values.ravel().tolist())).reshape(values.shape)


def plain(values: Sequence[Decimal]) -> list[float]:
    """Doubles within 0.5001 units in their last place."""
    return list(map(float, map(_SHORT.plus, values)))


def largest(values: Exact) -> float:
    """Largest absolute value; NaN where one is."""
    flat = cast(list[Decimal], values.ravel().tolist())
    if not all(map(Decimal.is_finite, flat)):
        return float("nan")
    return float(max(map(abs, flat), default=_ZERO))


def _sine_cosine(x: Decimal) -> tuple[Decimal, Decimal]:
    """(sin x, cos x) to the precision set."""
    return _sine_cosine_to(x, decimal.getcontext().prec)


@lru_cache(maxsize=256)
def _sine_cosine_to(x: Decimal, precision: int) -> tuple[Decimal, Decimal]:  # noqa: ARG001  # that of the context
    """By their series, once x is reduced to |x| ≤ π/4."""
    if not x.is_finite():
        return Decimal("NaN"), Decimal("NaN")
    context = decimal.getcontext()
    with decimal.localcontext(context) as wider:
        wider.prec = context.prec + _GUARD + max(0, x.adjusted())
        quarter = _pi(wider.prec) / 2
        turns = (x / quarter).to_integral_value()
        rest = x - turns * quarter
        squared, smallest, k = rest * rest, Decimal(10) ** -(wider.prec + 1), 1
        even, odd = _ONE, rest
        sine, cosine = odd, even
        while abs(even) > smallest:
            even = -even * squared / ((2 * k - 1) * (2 * k))
            odd = -odd * squared / ((2 * k) * (2 * k + 1))
            sine, cosine, k = sine + odd, cosine + even, k + 1
    quadrant = int(turns) % 4
    turned = [(sine, cosine), (cosine, -sine), (-sine, -cosine), (-cosine, sine)][quadrant]
    return +turned[0], +turned[1]


@lru_cache(maxsize=64)
def _pi(precision: int) -> Decimal:
    """π by Machin's formula, 16 arctan(1/5) − 4 arctan(1/239)."""

    def arctangent_of_inverse(n: int) -> Decimal:
        power, total, k = _ONE / n, _ZERO, 1
        while abs(power) > Decimal(10) ** -(precision + 9):
            total += power / k
            power, k = -power / (n * n), k + 2
        return total

    with digits(precision + 10):
        return +(16 * arctangent_of_inverse(5) - 4 * arctangent_of_inverse(239))


def _arctangent(y: Decimal, x: Decimal) -> Decimal:
    """The angle of (x, y), from the double's by steps that cube its error."""
    if not (x.is_finite() and y.is_finite()) or not (x or y):
        return _ZERO if x.is_finite() and y.is_finite() else Decimal("NaN")
    size = max(abs(x), abs(y))
    angle = Decimal(math.atan2(float(y / size), float(x / size)))
    for _ in range(2 + decimal.getcontext().prec // 50):
        sine, cosine = _sine_cosine(angle)
        angle += (y * cosine - x * sine) / (x * cosine + y * sine)
    return angle


def _of_arctangent(y: Decimal, x: Decimal, value: Decimal) -> tuple[Decimal, Decimal]:  # noqa: ARG001
    square = x * x + y * y
    return x / square, -y / square


def _choose(condition: Decimal, value: Decimal) -> Decimal:
    return value if condition else _ZERO


def _test(holds: Callable[[Decimal, Decimal], bool]) -> Callable[[Decimal, Decimal], Decimal]:
    return lambda a, b: _ONE if holds(a, b) else _ZERO


def _flat(a: Decimal, b: Decimal, value: Decimal) -> tuple[Decimal, Decimal]:  # noqa: ARG001  # of a step
    return _ZERO, _ZERO


def _sign(a: Decimal) -> Decimal:
    return _ONE.copy_sign(a) if a else _ZERO


Value = Callable[[Decimal, Decimal], Decimal]
Partials = Callable[[Decimal, Decimal, Decimal], tuple[Decimal, Decimal]]
# For each operation its value from both operands (a single one is given twice), and the partial derivatives by them
# from operands and value.
OPERATIONS: dict[int, tuple[Value, Partials]] = {
    ca.OP_ASSIGN: (lambda a, _b: a, lambda _a, _b, _v: (_ONE, _ZERO)),
    ca.OP_ADD: (operator.add, lambda _a, _b, _v: (_ONE, _ONE)),
    ca.OP_SUB: (operator.sub, lambda _a, _b, _v: (_ONE, -_ONE)),
    ca.OP_MUL: (operator.mul, lambda a, b, _v: (b, a)),
    ca.OP_DIV: (lambda a, b: a / b, lambda _a, b, v: (_ONE / b, -v / b)),
    ca.OP_NEG: (lambda a, _b: -a, lambda _a, _b, _v: (-_ONE, _ZERO)),
    ca.OP_SQ: (lambda a, _b: a * a, lambda a, _b, _v: (a + a, _ZERO)),
    ca.OP_TWICE: (lambda a, _b: a + a, lambda _a, _b, _v: (_ONE + _ONE, _ZERO)),
    ca.OP_INV: (lambda a, _b: _ONE / a, lambda _a, _b, v: (-v * v, _ZERO)),
    ca.OP_SQRT: (lambda a, _b: a.sqrt(), lambda _a, _b, v: (_ONE / (v + v), _ZERO)),
    ca.OP_SIN: (lambda a, _b: _sine_cosine(a)[0], lambda a, _b, _v: (_sine_cosine(a)[1], _ZERO)),
    ca.OP_COS: (lambda a, _b: _sine_cosine(a)[1], lambda a, _b, _v: (-_sine_cosine(a)[0], _ZERO)),
    ca.OP_ATAN2: (_arctangent, _of_arctangent),
    ca.OP_FABS: (lambda a, _b: abs(a), lambda a, _b, _v: (_sign(a), _ZERO)),
    ca.OP_SIGN: (lambda a, _b: _sign(a), _flat),
    ca.OP_FMIN: (min, lambda a, b, _v: (_ONE, _ZERO) if a <= b else (_ZERO, _ONE)),
    ca.OP_FMAX: (max, lambda a, b, _v: (_ONE, _ZERO) if a >= b else (_ZERO, _ONE)),
    ca.OP_LT: (_test(operator.lt), _flat),
    ca.OP_LE: (_test(operator.le), _flat),
    ca.OP_EQ: (_test(operator.eq), _flat),
    ca.OP_NE: (_test(operator.ne), _flat),
    ca.OP_NOT: (_test(lambda a, _b: not a), _flat),
    ca.OP_AND: (_test(lambda a, b: bool(a and b)), _flat),
    ca.OP_OR: (_test(lambda a, b: bool(a or b)), _flat),
    ca.OP_IF_ELSE_ZERO: (_choose, lambda a, _b, _v: (_ZERO, _ONE if a else _ZERO)),
}


class _Tables(NamedTuple):
    """Operands of each instruction, 0 where it has none; which are products, and those that are no sums either."""

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    products: NDArray[np.bool_]
    others: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Evaluated:
    """A Function's instructions at one point.

    Attributes:
        function: whose they are.
        values: what each instruction gave.
        outputs: the Function's outputs, matrices.
    """

    function: ExtendedFunction
    values: list[Decimal]
    outputs: list[Exact]

    def gradient(self, seeds: Sequence[Exact]) -> tuple[list[Exact], float]:
        """Derivatives of Σ ⟨seed_k, output_k⟩ by each input (vectors), and how far double precision would move the sum.

        The latter is 2⁻⁵³ Σ |∂/∂v| |v| over all intermediate results and inputs v: each is wrong by up to half a unit
        in its last place where the graph is evaluated in doubles. To first order.
        """
        f = self.function
        adjoints, flat = [_ZERO] * len(self.values), [seed.T.ravel() for seed in seeds]
        for node, output, element in f.results:
            adjoints[node] += flat[output][element]
        gradient = [np.full(rows, _ZERO, dtype=object) for rows in f.rows_in]
        values, partials = self.values, self._partials
        multiply, add, subtract = ca.OP_MUL, ca.OP_ADD, ca.OP_SUB
        for node in range(len(values) - 1, -1, -1):
            adjoint = adjoints[node]
            if not adjoint:
                continue
            operation, first, second = f.instructions[node]
            # Most are products and sums.
            if operation == multiply:
                adjoints[first] += adjoint * values[second]
                adjoints[second] += adjoint * values[first]
            elif operation == add:
                adjoints[first] += adjoint
                adjoints[second] += adjoint
            elif operation == subtract:
                adjoints[first] += adjoint
                adjoints[second] -= adjoint
            elif operation == ca.OP_INPUT:
                gradient[first][second] += adjoint
            elif operation != ca.OP_CONST:
                by_first, by_second = partials[node]
                if by_first:
                    adjoints[first] += adjoint * by_first
                if by_second:
                    adjoints[second] += adjoint * by_second
        moved = float(sum(map(abs, map(operator.mul, adjoints, values))))
        return gradient, UNIT_ROUNDOFF * moved

    def influence(self, seeds: Sequence[NDArray[np.floating[Any]]]) -> list[NDArray[np.float64]]:
        """Σ over all ways through the graph of |products of partial derivatives|, by each input; seeds absolute values.

        An upper bound on what seeds wrong by as much do to `gradient`, whatever their signs.
        """
        f = self.function
        adjoints, flat = [0.0] * len(self.values), [np.abs(seed.T.ravel()).tolist() for seed in seeds]
        for node, output, element in f.results:
            adjoints[node] += flat[output][element]
        found = [np.zeros(rows) for rows in f.rows_in]
        by = (reversed(sizes) for sizes in self._sizes())
        for (operation, first, second), adjoint, by_first, by_second in zip(
            reversed(f.instructions), reversed(adjoints), *by, strict=True
        ):
            if adjoint == 0.0 or operation == ca.OP_CONST:
                continue
            if operation == ca.OP_INPUT:
                found[first][second] += adjoint
            else:
                adjoints[first] += adjoint * by_first
                adjoints[second] += adjoint * by_second
        return found

    @cached_property
    def _partials(self) -> dict[int, tuple[Decimal, Decimal]]:
        """Partial derivatives of results that are neither products nor sums, by their operands."""
        values, instructions = self.values, self.function.instructions
        found: dict[int, tuple[Decimal, Decimal]] = {}
        for node in cast(list[int], self.function.tables.others.tolist()):
            operation, first, second = instructions[node]
            found[node] = OPERATIONS[operation][1](values[first], values[second], values[node])
        return found

    def _sizes(self) -> list[list[float]]:
        """Absolute values of the partial derivatives by either operand, as doubles."""
        tables, values = self.function.tables, np.abs(plain(self.values))
        found: list[list[float]] = []
        for side, operand in enumerate((tables.second, tables.first)):
            sizes = np.where(tables.products, values[operand], 1.0)
            sizes[tables.others] = np.abs(plain([pair[side] for pair in self._partials.values()]))
            found.append(sizes.tolist())
        return found


class ExtendedFunction:
    """An expanded (SX) Function as a list of operations on earlier results."""

    def __init__(self, function: ca.Function) -> None:
        graph = Instructions(function)
        self.rows_in, self.shapes_out, self.instructions = graph.rows_in, graph.shapes_out, graph.instructions
        self.constants = {node: Decimal(value) for node, value in graph.constants.items()}
        self.results = graph.results
        known = {*OPERATIONS, ca.OP_INPUT, ca.OP_CONST}
        strange = next((operation for operation, _, _ in self.instructions if operation not in known), None)
        self.unknown = ""
        if strange is not None:
            self.unknown = f"CasADi's operation {strange} in {function.name()} is not known in extended precision"

    @cached_property
    def tables(self) -> _Tables:
        """Its instructions as arrays."""
        operations, first, second = np.array(self.instructions, dtype=int).reshape(-1, 3).T
        products, leaves = operations == ca.OP_MUL, np.isin(operations, (ca.OP_INPUT, ca.OP_CONST))
        others = np.flatnonzero(~(products | leaves | np.isin(operations, (ca.OP_ADD, ca.OP_SUB))))
        return _Tables(np.where(leaves, 0, first), np.where(leaves, 0, second), products, others)

    def __call__(self, *inputs: Exact) -> Evaluated:
        """Outputs at `inputs`, vectors of decimals, to the precision set.

        Raises:
            LinAlgError: the Function has an operation that is not in `OPERATIONS`.
        """
        if self.unknown:
            raise np.linalg.LinAlgError(self.unknown)
        values: list[Decimal] = []
        tables, append = [given.ravel().tolist() for given in inputs], values.append
        multiply, add, subtract = ca.OP_MUL, ca.OP_ADD, ca.OP_SUB
        for node, (operation, first, second) in enumerate(self.instructions):
            if operation == multiply:
                append(values[first] * values[second])
            elif operation == add:
                append(values[first] + values[second])
            elif operation == subtract:
                append(values[first] - values[second])
            elif operation == ca.OP_INPUT:
                append(tables[first][second])
            elif operation == ca.OP_CONST:
                append(+self.constants[node])
            else:
                append(OPERATIONS[operation][0](values[first], values[second]))
        outputs: list[Any] = [np.full(rows * columns, _ZERO, dtype=object) for rows, columns in self.shapes_out]
        for node, output, element in self.results:
            outputs[output][element] = values[node]
        shaped = [flat.reshape(shape[::-1]).T for flat, shape in zip(outputs, self.shapes_out, strict=True)]
        return Evaluated(self, values, shaped)


@lru_cache(maxsize=8)
def extended(function: ca.Function) -> ExtendedFunction:
    """`function` in extended precision; translated once and kept."""
    return ExtendedFunction(function)
