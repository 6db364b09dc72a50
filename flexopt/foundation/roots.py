"""Where a function of one number is zero: SciPy's, without what it would keep."""

from __future__ import annotations

from collections.abc import Callable
from sys import float_info

Function = Callable[[float], float]
# The least relative error that SciPy takes.
LEAST = 4 * float_info.epsilon


def root(function: Function, low: float, high: float, *, xtol: float = 2e-12, rtol: float = LEAST) -> float:
    """A zero between two numbers at which the function has different signs, by Brent's method.

    SciPy wraps what it is given in a function that refers to itself. All that the function refers to, such as motions
    of megabytes, would stay until garbage is collected; what is passed as an argument does not.
    """
    from scipy.optimize import brentq  # noqa: PLC0415  (loads slowly)

    return float(brentq(_called, low, high, args=(function,), xtol=xtol, rtol=rtol))


def border(function: Function, low: float, high: float, *, xtol: float = 2e-12, rtol: float = LEAST) -> float:
    """As `root`, of two numbers whose signs were told by another way of computing the same.

    Where rounding decides, as of a motion that nothing damps, both may have one sign here: then it is the end at which
    the function is nearer to zero.
    """
    ends = {x: function(x) for x in (low, high)}
    if (ends[low] < 0) == (ends[high] < 0):
        return min(ends, key=lambda x: abs(ends[x]))
    return root(function, low, high, xtol=xtol, rtol=rtol)


def _called(x: float, function: Function) -> float:
    return function(x)
