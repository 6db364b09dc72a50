"""Every operation a graph may contain, in all three ways of evaluation."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import mpmath
import numpy as np
import pytest

from flexopt.compiled import batch
from tests.compiled.comparison import QUIET, check_agreement

pytestmark = pytest.mark.filterwarnings(QUIET)

BINARY: dict[str, Callable[[ca.SX, ca.SX], ca.SX]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "pow": lambda a, b: ca.fabs(a) ** b,
    "constpow": lambda a, _: ca.fabs(a) ** 2.5,
    "base": lambda a, _: 2**a,
    "fmin": ca.fmin,
    "fmax": ca.fmax,
    "atan2": ca.atan2,
    "fmod": ca.fmod,
    "remainder": ca.remainder,
    "hypot": ca.hypot,
    "copysign": ca.copysign,
    "less": lambda a, b: a < b,
    "less_equal": lambda a, b: a <= b,
    "equal": ca.eq,
    "unequal": ca.ne,
    "and": ca.logic_and,
    "or": ca.logic_or,
    "if_else": lambda a, b: ca.if_else(a < b, ca.sin(a), b / 3),
    "if_else_number": lambda a, b: ca.if_else(a, b, 7),
}
UNARY = (
    "sqrt", "sq", "fabs", "sign", "floor", "ceil", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh",
    "asinh", "acosh", "atanh", "exp", "log", "log10", "log1p", "expm1", "erf", "logic_not",
)  # fmt: skip
OWN = {"negative": lambda a: -a, "inverse": lambda a: 1 / a, "twice": lambda a: 2 * a, "cube": lambda a: a**3}
SPECIAL = np.array([0.0, -0.0, 1.0, -1.0, 0.5, np.inf, -np.inf, np.nan, 5e-324, 1e308, -1e308, 3.5, 1e7])
RNG_POINTS = 203


def _points(rows: int) -> np.ndarray:
    rng = np.random.default_rng(4)
    scattered = rng.normal(size=(rows, RNG_POINTS)) * 10 ** rng.uniform(-3, 1.5, (rows, RNG_POINTS))
    pairs = np.array(np.meshgrid(*[SPECIAL] * rows)).reshape(rows, -1)
    return np.hstack([scattered, pairs])


@pytest.mark.long
def test_unary_operations() -> None:
    x = ca.SX.sym("x")
    graphs = {name: getattr(ca, name)(x) for name in UNARY if name != "sq"} | {n: f(x) for n, f in OWN.items()}
    graphs["sq"] = ca.sq(x) if hasattr(ca, "sq") else x * x
    function = ca.Function("unary", [x], list(graphs.values()), ["x"], list(graphs))
    check_agreement(function, [_points(1)], rtol=2e-15)


def test_binary_operations() -> None:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    graphs = {name: graph(x, y) for name, graph in BINARY.items()}
    function = ca.Function("binary", [x, y], list(graphs.values()), ["x", "y"], list(graphs))
    a, b = _points(2)
    check_agreement(function, [a[None], b[None]], rtol=2e-15)


def test_quotients_by_one_divisor_are_rounded_to_nearest() -> None:
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y")
    function = ca.Function("quotients", [x, y], [x[0] / y, x[1] / y], ["x", "y"], ["first", "second"])
    rng = np.random.default_rng(8)
    scattered = rng.normal(size=(3, 200_000)) * 2.0 ** rng.integers(-300, 300, (3, 200_000))
    # Divisors whose reciprocal is hardest to round: significands of ones, and next to powers of two.
    scattered[2, :2000] = np.nextafter(2.0 ** rng.integers(-300, 300, 2000), rng.choice([0, np.inf], 2000))
    points = np.hstack([scattered, np.array(np.meshgrid(*[SPECIAL] * 3)).reshape(3, -1)])
    with np.errstate(all="ignore"):
        expected = points[:2] / points[2]
    for result, exact in zip(batch(function)(points[:2], points[2:]), expected, strict=True):
        np.testing.assert_array_equal(result[0], exact)
        np.testing.assert_array_equal(np.signbit(result[0]) | np.isnan(exact), np.signbit(exact) | np.isnan(exact))


@pytest.mark.parametrize("name", ["sin", "cos"])
def test_sine_and_cosine_to_two_units_in_the_last_place(name: str) -> None:
    x = ca.SX.sym("x")
    function = batch(ca.Function(name, [x], [getattr(ca, name)(x)]))
    rng = np.random.default_rng(0)
    # The doubles next to the multiples of π/2 are where the reduction of the argument must be exact.
    hard = np.arange(1, 63_661) * (np.pi / 2)
    for points in (rng.uniform(-1e5, 1e5, 600_000), rng.uniform(-4, 4, 400_000), hard, 10 ** rng.uniform(5, 300, 2000)):
        (result,) = function(points[None])
        if np.finfo(np.longdouble).nmant > 60:
            exact = getattr(np, name)(points.astype(np.longdouble))
            error = np.abs(result[0] - exact) / np.spacing(np.abs(exact.astype(float)))
            assert error.max() <= 2
        with mpmath.workdps(400):
            for k in rng.choice(points.size, 150, replace=False):
                exact = getattr(mpmath, name)(mpmath.mpf(points[k]))
                assert abs(result[0, k] - exact) <= 2 * np.spacing(abs(float(exact)))


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [("tan", -1e5, 1e5), ("exp", -740, 705), ("log", 1e-9, 1e9), ("log", 0.5, 2), ("atan", -20, 20), ("asin", -1, 1),
     ("acos", -1, 1)],
)  # fmt: skip
def test_other_elementary_functions_to_four_units(name: str, low: float, high: float) -> None:
    x = ca.SX.sym("x")
    points = np.random.default_rng(1).uniform(low, high, 300)
    (result,) = batch(ca.Function(name, [x], [getattr(ca, name)(x)]))(points[None])
    with mpmath.workdps(60):
        for point, value in zip(points, result[0], strict=True):
            exact = getattr(mpmath, name)(mpmath.mpf(point))
            assert abs(value - exact) <= 4 * np.spacing(abs(float(exact)))


def _random_graph(rng: np.random.Generator, inputs: list, size: int) -> list:
    """Nodes with values of order one, so that rounding does not grow."""
    unary = [ca.sin, ca.cos, ca.atan, ca.fabs, ca.tanh, ca.erf, lambda v: ca.sqrt(1 + v * v), lambda v: ca.exp(-v * v),
             lambda v: ca.log(1 + v * v), lambda v: 1 / (1 + v * v), lambda v: -v]  # fmt: skip
    binary = [lambda a, b: a + b, lambda a, b: a - b, lambda a, b: a * b, lambda a, b: a / (1 + b * b), ca.fmin, ca.fmax,
              lambda a, b: ca.if_else(a < b, a, 2 * b), lambda a, b: ca.atan2(a, 1 + b * b), ca.hypot,
              lambda a, b: ca.if_else(ca.logic_and(a > 0, b > 0), a, b)]  # fmt: skip
    nodes = list(inputs)
    for _ in range(size):
        a, b = (nodes[k] for k in rng.integers(0, len(nodes), 2))
        node = unary[rng.integers(len(unary))](a) if rng.random() < 0.4 else binary[rng.integers(len(binary))](a, b)
        nodes.append(ca.sin(node) if rng.random() < 0.3 else node)
    return nodes[-6:]


@pytest.mark.parametrize("seed", range(4))
def test_random_sx_graphs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = ca.SX.sym("x", 3), ca.SX.sym("y", 2)
    outputs = _random_graph(rng, [*ca.vertsplit(x), *ca.vertsplit(y)], 60)
    function = ca.Function("random", [x, y], [ca.vertcat(*outputs[:3]), ca.vertcat(*outputs[3:])])
    check_agreement(function, [rng.normal(size=(3, 45)), rng.normal(size=(2, 1))], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_random_mx_graphs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = ca.MX.sym("x", 3), ca.MX.sym("y", 3)
    outputs = _random_graph(rng, [x, y], 30)
    function = ca.Function("random", [x, y], [ca.vertcat(*outputs[:3]), ca.horzcat(*outputs[3:])])
    check_agreement(function, [rng.normal(size=(3, 21)), rng.normal(size=(3, 21))], rtol=1e-9, atol=1e-9)
