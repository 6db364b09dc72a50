"""The last line of defence: no raw NumPy or LAPACK exception, and no floating-point warning, reaches the caller.

In: a public function. Out: the same function, whose numerical breakdowns become `NoSolutionFound`.
"""

from __future__ import annotations

from collections.abc import Callable
from contextvars import ContextVar
from functools import wraps
from typing import ParamSpec, TypeVar

import numpy as np

from flexopt.errors import NoSolutionFound

P = ParamSpec("P")
T = TypeVar("T")
# Whether a guarded function runs, whose intermediate systems are its own to check.
INSIDE: ContextVar[bool] = ContextVar("INSIDE", default=False)


def guarded(function: Callable[P, T]) -> Callable[P, T]:
    """`function`, with overflow kept silent (its results are checked) and singular matrices turned into a sentence."""

    @wraps(function)
    def inner(*args: P.args, **kwargs: P.kwargs) -> T:
        outside = INSIDE.set(True)
        try:
            with np.errstate(all="ignore"):
                return function(*args, **kwargs)
        except (np.linalg.LinAlgError, OverflowError, ZeroDivisionError) as error:
            raise NoSolutionFound(
                f"{function.__name__}: the numbers span too many orders of magnitude for double precision ({error}); "
                "choose units in which they are closer together",
                violations={},
                iterate={},
            ) from None
        finally:
            INSIDE.reset(outside)

    return inner
