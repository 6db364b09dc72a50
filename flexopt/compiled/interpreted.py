"""A Function at many points by CasADi's virtual machine: what `Batch` does where nothing can be compiled.

In: a Function and one row of values for each nonzero of its inputs. Out: one row for each nonzero of its outputs.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np

from flexopt.foundation.arrays import Array

_CHUNKS = (256, 16, 1)
# Seconds that a call of many steps may take: Ctrl-C is seen between two calls.
CALL = 0.5


class Interpreted:
    """Evaluates in chunks of several points, which costs one call of the virtual machine each."""

    def __init__(self, function: ca.Function) -> None:
        self._function = function
        self._chunks = dict[int, _Chunk]()

    def __call__(self, inputs: Sequence[Array], outputs: Sequence[Array], begin: int, end: int) -> None:
        """Points begin .. end-1. `inputs` (nonzeros, N) or (nonzeros, 1), `outputs` (nonzeros, N), written in place."""
        while begin < end:
            size = next(size for size in _CHUNKS if size <= end - begin)
            if size not in self._chunks:
                self._chunks[size] = _Chunk(self._function, size)
            self._chunks[size](inputs, outputs, begin)
            begin += size


class _Chunk:
    """The Function at `size` points, called through buffers that are kept with it."""

    def __init__(self, function: ca.Function, size: int) -> None:
        mapped = function if size == 1 else function.map(size)
        self._size = size
        self._points = Interpreted(function) if size > 1 else None
        self._x = [np.zeros((size, function.nnz_in(k))) for k in range(function.n_in())]
        self._y = [np.zeros((size, function.nnz_out(k))) for k in range(function.n_out())]
        self._buffer, evaluate = mapped.buffer()
        self._evaluate: Callable[[], None] = evaluate
        for k, x in enumerate(self._x):
            self._buffer.set_arg(k, x.data)  # pyright: ignore[reportCallIssue] - the stubs ask for a size
        for k, y in enumerate(self._y):
            self._buffer.set_res(k, y.data)  # pyright: ignore[reportCallIssue]

    def __call__(self, inputs: Sequence[Array], outputs: Sequence[Array], begin: int) -> None:
        at = slice(begin, begin + self._size)
        for x, values in zip(self._x, inputs, strict=True):
            x[:] = values[:, at].T if values.shape[1] != 1 else values.T
        failed = not succeeds(self._buffer, self._evaluate)
        if failed and self._points is not None:
            for k in range(at.start, at.stop):
                self._points(inputs, outputs, k, k + 1)
            return
        for y, values in zip(self._y, outputs, strict=True):
            values[:, at] = np.nan if failed else y.T


class Accumulated:
    """Runs a step x_next, monitor = step(x, e, c) of one member over many steps, a call for each chunk of them."""

    def __init__(self, step: ca.Function) -> None:
        self._step = step
        self._chunks = dict[int, _Run]()
        self._largest = 0

    def __call__(self, x0: Array, e: Array, c: Array, x: Array, monitor: Array) -> None:
        """`e` (steps, n_e); the results x (steps, n) and monitor (steps, n_m) are written in place."""
        begin, end = 0, x.shape[0]
        # The first step tells how many a call may take.
        largest = self._largest or 1
        while begin < end:
            size = next(size for size in _CHUNKS if size <= min(end - begin, largest))
            if size not in self._chunks:
                self._chunks[size] = _Run(self._step, size)
            at, began = slice(begin, begin + size), time.monotonic()
            held = self._chunks[size](x0, e[at], c, x[at], monitor[at])
            if not self._largest:
                spent = max(time.monotonic() - began, 1e-9)
                self._largest = largest = next(each for each in _CHUNKS if each * spent <= CALL or each == 1)
            if not held:
                if size > 1:  # closer to the step that failed
                    largest = size - 1
                    continue
                x[at], monitor[at] = np.nan, np.nan
            x0 = x[begin + size - 1]
            begin += size


class _Run:
    """`size` steps in one call, through buffers that are kept with it."""

    def __init__(self, step: ca.Function, size: int) -> None:
        self._in = [np.zeros((size if k else 1, step.nnz_in(k))) for k in range(3)]
        self._out = [np.zeros((size, step.nnz_out(k))) for k in range(2)]
        self._buffer, evaluate = step.mapaccum(size).buffer()
        self._evaluate: Callable[[], None] = evaluate
        for k, values in enumerate(self._in):
            self._buffer.set_arg(k, values.data)  # pyright: ignore[reportCallIssue] - the stubs ask for a size
        for k, values in enumerate(self._out):
            self._buffer.set_res(k, values.data)  # pyright: ignore[reportCallIssue]

    def __call__(self, x0: Array, e: Array, c: Array, x: Array, monitor: Array) -> bool:
        for buffer, values in zip(self._in, (x0, e, c), strict=True):
            buffer[:] = values
        succeeded = succeeds(self._buffer, self._evaluate)
        x[:], monitor[:] = self._out
        return succeeded


def succeeds(buffer: ca.FunctionBuffer, evaluate: Callable[[], None]) -> bool:
    """Evaluate; a failing Function returns a status, or raises where it is called by another.

    So it does on Ctrl-C, which is no failure.
    """
    try:
        evaluate()
    except RuntimeError as error:
        if "KeyboardInterrupt" in str(error):
            raise KeyboardInterrupt from None
        return False
    return buffer.ret() == 0
