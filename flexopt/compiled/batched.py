"""A Function at many points at once.

In: any CasADi Function; for each input an array with one column for each point. Out: for each output the like. Where a
compiler is found the points go several at a time through one instruction (`lanes`); else, or where the graph decides
its course by numbers, through CasADi's virtual machine (`interpreted`).
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from flexopt.compiled.interpreted import Interpreted
from flexopt.compiled.lanes import kernel_source
from flexopt.compiled.libraries import begin, load
from flexopt.compiled.waiting import awaited
from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arrays import Array

# A multiple of every processor's number of lanes, so that threads never share a group of points.
_GROUP = 64
# Tells the library from others of the same Function.
PURPOSE = "batch"


def batch(function: ca.Function) -> Batch:
    """`function` made ready to be evaluated at many points; compiled if that can be, and kept for the next process."""
    return Batch(function)


class Batch:
    """Evaluates a Function at N points.

    Attributes:
        function: the Function.
        compiled: whether compiled code evaluates it; else CasADi's virtual machine, with the same results to rounding.
    """

    def __init__(self, function: ca.Function, library: Callable[[], ctypes.CDLL | None] | None = None) -> None:
        self.function = function
        loaded = load_batch(function) if library is None else library()
        self._kernel = _kernel(loaded)
        self._lanes = loaded.flexopt_lanes() if loaded is not None else 0
        self._interpreted = Interpreted(function)
        self._in = [_Layout(function.sparsity_in(k)) for k in range(function.n_in())]
        self._out = [_Layout(function.sparsity_out(k)) for k in range(function.n_out())]

    @property
    def compiled(self) -> bool:
        """Whether compiled code evaluates the Function."""
        return self._kernel is not None

    @property
    def lanes(self) -> int:
        """How many points go through one instruction; 0 in the virtual machine."""
        return self._lanes

    def __repr__(self) -> str:
        return f"Batch({self.function}, {'compiled' if self.compiled else 'CasADi virtual machine'})"

    def __call__(self, *arrays: ArrayLike, threads: int = 1) -> list[NDArray[np.float64]]:
        """The outputs at N points, each (rows_out, N), float64, C-contiguous.

        Args:
            arrays: for each input (rows, N), or (rows,) or (rows, 1) for one value at all points. A matrix counts as
                the column of its stacked columns, structural zeros included. All of them single: N = 1.
            threads: among how many the points are divided; the results do not depend on it.

        Raises:
            InputError: a shape, a number of points or `threads` does not fit.
        """
        values, n_points = self._checked(arrays, threads)
        results = [layout.empty(n_points) for layout in self._out]
        inputs = [layout.nonzeros(value) for layout, value in zip(self._in, values, strict=True)]
        if self._kernel is None:
            outputs = [np.empty((len(layout.rows), n_points)) for layout in self._out]
            self._interpreted(inputs, outputs, 0, n_points)
            for layout, result, output in zip(self._out, results, outputs, strict=True):
                result[layout.rows] = output
        elif n_points:
            _run(self._kernel, inputs, list(zip(self._out, results, strict=True)), n_points, threads)
        return results

    def _checked(self, arrays: Sequence[ArrayLike], threads: int) -> tuple[list[Array], int]:
        """Arrays (rows, N) or (rows, 1), and N."""
        function = self.function
        if len(arrays) != len(self._in):
            raise InputError(f"{function.name()} takes {len(self._in)} arrays ({', '.join(function.name_in())}), "
                             f"got {len(arrays)}")  # fmt: skip
        # A caller without types may pass anything.
        if isinstance(threads, bool) or not isinstance(threads, int) or threads < 1:  # pyright: ignore
            fault = Fault("threads", "must be a whole number of at least 1", repr(threads))
            raise InputError(f"{function.name()}: {fault}", [fault], function.name())
        values: list[Array] = []
        faults: list[Fault] = []
        for name, layout, given in zip(function.name_in(), self._in, arrays, strict=True):
            try:
                value = np.asarray(given, dtype=np.float64)
            except Exception:  # a foreign object's own conversion raises whatever it likes
                faults.append(Fault(name, "must be numbers, as many in each row"))
                continue
            value = value.reshape(-1, 1) if value.ndim < 2 else value
            if value.ndim != 2 or value.shape[0] != layout.size:
                want = f"({layout.size}, number of points) or ({layout.size},)"
                faults.append(Fault(name, f"must have the shape {want}, not {np.shape(given)}"))
            values.append(value)
        raise_if_any(InputError, f"points of {function.name()}", faults)
        lengths = {value.shape[1] for value in values} - {1}
        if len(lengths) > 1:
            given = ", ".join(f"{n}: {v.shape[1]}" for n, v in zip(function.name_in(), values, strict=True))
            raise InputError(f"{function.name()}: the inputs have different numbers of points ({given})")
        return values, lengths.pop() if lengths else 1


class _Layout:
    """Which of the `size` stacked entries of an input or output are structural nonzeros."""

    def __init__(self, sparsity: ca.Sparsity) -> None:
        self.size = sparsity.numel()
        self.rows = np.array(sparsity.find(), dtype=np.int64)

    def nonzeros(self, values: Array) -> Array:
        """Rows of the nonzeros, each contiguous."""
        chosen = values if len(self.rows) == self.size else values[self.rows]
        return chosen if chosen.strides[1] == chosen.itemsize or chosen.shape[1] == 1 else np.ascontiguousarray(chosen)

    def empty(self, n_points: int) -> Array:
        """Room for the output, zero where it is structurally zero."""
        make = np.empty if len(self.rows) == self.size else np.zeros
        return make((self.size, n_points))


def _addresses(array: Array) -> list[int]:
    """Address of the first value of each row."""
    start: int = array.__array_interface__["data"][0]
    return [start + array.strides[0] * k for k in range(array.shape[0])]


def _run(
    kernel: Callable[..., int], inputs: list[Array], results: list[tuple[_Layout, Array]], n: int, threads: int
) -> None:
    """Call the kernel on all points, a contiguous part for each thread."""
    rows = [address for array in inputs for address in _addresses(array)]
    fixed = [n > 1 and array.shape[1] == 1 for array in inputs for _ in range(array.shape[0])]
    targets = list[int]()
    for layout, array in results:
        addresses = _addresses(array)
        targets += [addresses[row] for row in layout.rows.tolist()]
    tables = (ctypes.c_void_p * len(rows))(*rows), bytes(fixed), (ctypes.c_void_p * len(targets))(*targets)

    groups = -(-n // _GROUP)
    threads = min(threads, groups)
    edges = [min(n, _GROUP * (groups * k // threads)) for k in range(threads + 1)]
    parts = [(begin, end) for begin, end in pairwise(edges) if end > begin]

    def part(begin: int, end: int, _held: object = (inputs, results)) -> int:
        return kernel(*tables, begin, end)

    if any(awaited([partial(part, *edge) for edge in parts], n)):
        raise MemoryError("no memory for the working space of a compiled Function")


def load_batch(function: ca.Function) -> ctypes.CDLL | None:
    """The library that evaluates a Function at many points, or None where it cannot be."""
    return load([function], PURPOSE, lambda: kernel_source(function))


def begin_batch(function: ca.Function) -> Callable[[], ctypes.CDLL | None]:
    """`load_batch` in the background: call the result to wait for it."""
    return begin([function], PURPOSE, lambda: kernel_source(function))


def _kernel(library: ctypes.CDLL | None) -> Callable[..., int] | None:
    """The compiled loop over points."""
    if library is None:
        return None
    kernel = library.flexopt_kernel
    kernel.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p] + [ctypes.c_longlong] * 2
    return kernel
