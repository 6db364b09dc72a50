"""A Function at many points, compiled once that pays.

In: the Function in the form for CasADi's virtual machine, in that for a compiler, and how many points are to come. Out:
its values, by compiled code where the cache holds it or the points cost more than compiling; else by the virtual
machine, on several threads. Which of the two a call takes is settled before it begins, by counts alone: not by when a
compiler is done, nor by the number of threads. Both agree to rounding.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable

import casadi as ca

from flexopt.compiled.batched import PURPOSE, Batch, begin_batch
from flexopt.compiled.compilers import find_compiler
from flexopt.compiled.cost import compilation_seconds, evaluation_seconds
from flexopt.compiled.libraries import is_kept
from flexopt.compiled.threaded import Interpreter
from flexopt.foundation.arrays import Array

# Work of this share of a compilation's cost starts the compiler in the background; it is used from the whole cost on.
_AHEAD = 0.5


class Economical:
    """Evaluates a Function at N points; called like a `Batch`.

    Attributes:
        function: the Function in the form for the virtual machine.
        worth: number of points from which on compiling pays.
    """

    def __init__(self, function: ca.Function, compact: ca.Function | None = None) -> None:
        """`compact`: the same Function in the form for a compiler, where that is another."""
        self.function = function
        self._compact = function if compact is None else compact
        self.worth = compilation_seconds(self._compact) / evaluation_seconds(function)
        self._interpreter = Interpreter(function)
        self._begun: Callable[[], ctypes.CDLL | None] | None = None
        self._batch: Batch | None = None
        self._asked = self._decided = False
        self._spent = 0

    @property
    def compiled(self) -> bool:
        """Whether compiled code evaluates the next call."""
        if self._decided and self._batch is None and self._begun is not None:
            self._batch = Batch(self._compact, self._begun)
        return self._decided and self._batch is not None and self._batch.compiled

    def expect(self, points: int) -> None:
        """Settle what the calls until the next `expect` take, and begin to compile where that pays.

        Args:
            points: how many are to come at most; those that the virtual machine has evaluated so far count, too.
        """
        if self._decided or find_compiler() is None:
            return
        work = self._spent + points
        # Asked once: writing a graph down for its key takes longer than evaluating it at some points.
        kept, self._asked = not self._asked and is_kept([self._compact], PURPOSE), True
        if self._begun is None and (kept or work >= _AHEAD * self.worth):
            self._begun = begin_batch(self._compact)
        self._decided = kept or work >= self.worth

    def __call__(self, *arrays: Array, threads: int = 1) -> list[Array]:
        """The outputs at N points, each (rows_out, N); see `Batch`."""
        if self.compiled:
            assert self._batch is not None
            return self._batch(*arrays, threads=threads)
        values = self._interpreter(*arrays, threads=threads)
        self._spent += values[0].shape[1]
        return values
