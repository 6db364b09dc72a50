"""A Function at one point, called with arrays: for graphs that take less time than CasADi's conversions.

In: a Function of dense inputs and outputs, arrays. Out: arrays.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

import casadi as ca
import numpy as np

from flexopt.compiled.interpreted import succeeds
from flexopt.foundation.arrays import Array


class ArrayCall:
    """Calls a Function through buffers; each thread has its own."""

    def __init__(self, function: ca.Function) -> None:
        self._function = function
        self._own = threading.local()

    def __reduce__(self) -> tuple[type[ArrayCall], tuple[ca.Function]]:
        return ArrayCall, (self._function,)

    def __call__(self, *values: Array) -> list[Array]:
        """Each output, as its matrix; of inputs the entries in the order of columns count, as of CasADi's.

        Raises:
            RuntimeError: the Function failed.
        """
        if not hasattr(self._own, "buffers"):
            self._own.buffers = _Buffers(self._function)
        buffers: _Buffers = self._own.buffers
        return buffers(values)


class _Buffers:
    """Memory of one thread."""

    def __init__(self, function: ca.Function) -> None:
        f = function
        sparse = [*(f.sparsity_in(k) for k in range(f.n_in())), *(f.sparsity_out(k) for k in range(f.n_out()))]
        if not all(each.is_dense() for each in sparse):
            raise ValueError(f"{f.name()}: all inputs and outputs must be dense")
        # Rows of these are columns there.
        self._in = [np.zeros(f.size_in(k)[::-1]) for k in range(f.n_in())]
        self._out = [np.zeros(f.size_out(k)[::-1]) for k in range(f.n_out())]
        self._buffer, evaluate = f.buffer()
        self._evaluate: Callable[[], None] = evaluate
        for k, values in enumerate(self._in):
            self._buffer.set_arg(k, values.data)  # pyright: ignore[reportCallIssue] - the stubs ask for a size
        for k, values in enumerate(self._out):
            self._buffer.set_res(k, values.data)  # pyright: ignore[reportCallIssue]

    def __call__(self, given: tuple[Array, ...]) -> list[Array]:
        for buffer, values in zip(self._in, given, strict=True):
            buffer.T[...] = values if values.ndim == 2 else values[:, None]
        if not succeeds(self._buffer, self._evaluate):
            raise RuntimeError("a graph failed")
        return [values.T.copy() for values in self._out]
