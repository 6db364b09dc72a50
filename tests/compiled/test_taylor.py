"""Taylor models against 50 digits: what is enclosed is inside, rounding included, in doubles and with 64 bits."""

from __future__ import annotations

from decimal import Decimal
from functools import reduce
from typing import Any

import casadi as ca
import numpy as np
import pytest

from flexopt.compiled.extended import digits, exact, extended
from flexopt.compiled.taylor import DEGREE, PRECISE, TaylorModel, taylor

X = ca.SX.sym("x")
GRAPHS = {
    "rational": (1 + X) * X**2 / (X + 4) - 3 * X,
    "quotient of sines": ca.sin(3 * X) / (2 + ca.cos(X)),
    "root": ca.sqrt(1 + X * X),
    "angle": ca.atan2(ca.sin(X) + 2, ca.cos(X) - 0.3),
    "kinks": ca.fmax(X, 0.5) * ca.fabs(X - 0.1) + ca.fmin(X, -0.2),
    "choice": ca.if_else(X < 0.3, X * X, 1 / (X + 4)),
    "cancelling": (1e8 + X) - 1e8 + (ca.sin(X) ** 2 + ca.cos(X) ** 2 - 1),
}
# Places in a cell, from −1 to 1.
PLACES = (-1.0, -0.6, 0.0, 0.3, 1.0)


def of(function: ca.Function, x: Any) -> Decimal:
    """The value in 50 digits."""
    point = np.array([Decimal(0)], dtype=object)
    # A longer number than a double is the sum of two.
    first = float(x)
    point[0] = exact(first).item() + exact(float(x - np.longdouble(first))).item()
    return extended(function)(point).outputs[0].item()


@pytest.mark.parametrize("name", GRAPHS)
@pytest.mark.parametrize("kind", [np.float64, PRECISE], ids=["double", "precise"])
def test_nothing_is_outside(name: str, kind: Any) -> None:
    """Random cells of any width: the polynomial is within r, and the value between the bounds."""
    function = ca.Function("f", [X], [GRAPHS[name]])
    rng = np.random.default_rng(0)
    low = rng.uniform(-2.0, 2.0, 60)
    high = low + 10.0 ** rng.uniform(-12.0, -0.3, low.size)
    cells = TaylorModel.of_cells(low.astype(kind), high.astype(kind))
    with np.errstate(all="ignore"):
        model = taylor(function)([cells])[0][0]
        least, most = (np.broadcast_to(bound, low.shape) for bound in model.bounds)
    c = np.broadcast_to(model.c, (len(model.c), low.size))
    r = np.broadcast_to(model.r, low.shape)
    assert len(c) <= DEGREE + 1
    assert np.isfinite(r).mean() > 0.9
    middle, radius = cells.c
    with digits():
        for k in np.flatnonzero(np.isfinite(r)).tolist():
            for place in PLACES:
                x = np.clip(middle[k] + place * radius[k], low[k].astype(kind), high[k].astype(kind))
                value = of(function, x)
                assert exact(least[k]).item() <= value <= exact(most[k]).item()
                # Rounded as x is, t is not quite `place`.
                t = (_decimal(x) - _decimal(middle[k])) / _decimal(radius[k])
                polynomial = reduce(lambda total, each, t=t: total * t + _decimal(each), c[::-1, k], Decimal(0))
                assert abs(value - polynomial) <= exact(float(r[k])).item()


def _decimal(x: Any) -> Decimal:
    first = float(x)
    return exact(first).item() + exact(float(np.longdouble(x) - np.longdouble(first))).item()


def test_what_is_left_falls_with_the_cell() -> None:
    """Of order DEGREE + 1: a cell a tenth as wide leaves 1e-7 as much, down to rounding."""
    function = ca.Function("f", [X], [GRAPHS["quotient of sines"]])
    left = []
    for width in (0.4, 0.04):
        low = np.array([0.5], dtype=PRECISE)
        left.append(float(taylor(function)([TaylorModel.of_cells(low, low + width)])[0][0].r[0]))
    assert left[1] < 10.0 ** -(DEGREE + 0.5) * left[0]


def test_nothing_is_claimed_where_nothing_is_known() -> None:
    """Poles, roots of what may be negative, unknown operations."""
    low, high = np.array([-0.1]), np.array([0.1])
    with np.errstate(all="ignore"):
        for graph in (1 / X, ca.sqrt(X), ca.acos(1 + X), ca.atan2(X, X), ca.exp(X)):
            model = taylor(ca.Function("f", [X], [graph]))([TaylorModel.of_cells(low, high)])[0][0]
            assert np.all(np.isinf(model.r))
