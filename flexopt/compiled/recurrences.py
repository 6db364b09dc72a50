"""A discrete-time recurrence, run over thousands of steps in one call, for one member or for many at once.

In: the step as a CasADi Function, and if there is one its fast twin; start states, constants and what enters from
outside. Out: states, maxima of the monitored quantities, final states. Where a compiler is found a group of members
goes through all its steps in one loop (`recurrence.hpp`), one member to each lane; else, or where the graph decides its
course by numbers, CasADi's virtual machine takes the exact step.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Literal

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from flexopt.compiled.cost import compilation_seconds, evaluation_seconds
from flexopt.compiled.interpreted import Accumulated
from flexopt.compiled.lanes import brief_level, level, recurrence_source
from flexopt.compiled.libraries import is_kept, load
from flexopt.compiled.members import checked_arguments, checked_functions, densified
from flexopt.compiled.waiting import awaited
from flexopt.foundation.arrays import Array

# A multiple of every processor's number of lanes, so that threads never share a group of members.
_GROUP = 8
# Shares by which steps take longer, and by which compiling takes less, where it is not optimised fully.
_SLOWER, _SOONER = 0.15, 0.4
# How much faster compiled steps are than the virtual machine's at least: of few members, of many.
_FEW_FASTER, _MANY_FASTER = 8, 40
# Up to so many members run in vectors of half the width at most, in which a step is done sooner.
_FEW = 4


@dataclass(frozen=True, eq=False)
class Records:
    """What a recurrence left behind.

    Attributes:
        k: (records,) number of steps taken at each record; the last may end a shorter window.
        x: (records, n, N) states x_k; with keep="monitors" (0, n, N).
        monitor: (records, n_m, N) maximum of each monitor over the steps of the record's window; NaN if any is.
        last: (n, N) final states.
    """

    k: NDArray[np.int64]
    x: Array
    monitor: Array
    last: Array


def recurrence(
    step: ca.Function,
    *,
    fast: ca.Function | None = None,
    refresh: ca.Function | None = None,
    every: int = 100,
    many: bool = False,
    brief: bool = False,
) -> Recurrence:
    """The recurrence x_{k+1}, monitor = step(x_k, e_k, c), compiled if that can be, and kept for the next process.

    Args:
        step: x (n), e (n_e), c (n_c) -> x_next (n), monitor (n_m); n_e, n_c, n_m may be 0. Told apart by their order.
        fast: x, d (n_d), e, c -> x_next, d_next, monitor, turn: the same step with carried quantities d, for compiled
            code. Where the scalar `turn` is not ≤ 1 it is not valid: x_next and monitor are then those of `step`, and
            d = refresh(x_next, c). Each member decides for itself. A member whose states `step` made NaN too stays
            with the fast step while its `turn` is NaN.
        refresh: x, c -> d: exact d of a state; needed with `fast`, at the start and every `every` steps.
        every: number of steps between two refreshes.
        many: whether the first call is for many members, rather than one to four; code for the other is compiled when
            it is first called, and gives the same bits.
        brief: whether so few steps are to come in all (`is_brief`) that compiling would take longest: it takes half the
            time then, the steps a seventh longer, and they give the same bits.

    Raises:
        InputError: shapes that do not belong together; `fast` without `refresh` or the reverse; `every` below 1.
    """
    return Recurrence(step, fast=fast, refresh=refresh, every=every, many=many, brief=brief)


def is_brief(step: ca.Function, steps: int, *, many: bool = False) -> bool:
    """Whether optimising a recurrence fully would take longer than it saves in so many steps of all members."""
    seconds = steps * evaluation_seconds(step) / (_MANY_FASTER if many else _FEW_FASTER)
    return _SLOWER * seconds < _SOONER * compilation_seconds(step)


class Recurrence:
    """Runs a recurrence from start states to final states.

    Attributes:
        step: the exact step.
        compiled: whether compiled code runs it; else CasADi's virtual machine, by the exact step.
    """

    def __init__(
        self,
        step: ca.Function,
        *,
        fast: ca.Function | None = None,
        refresh: ca.Function | None = None,
        every: int = 100,
        many: bool = False,
        brief: bool = False,
    ) -> None:
        given = {"step": step, "fast": fast, "refresh": refresh}
        functions = {name: function for name, function in given.items() if function is not None}
        self.step = step
        self._sizes = checked_functions(functions, every)
        self._every = int(every)
        dense = {name: densified(function) for name, function in functions.items()}
        self._functions, self._brief = dense, brief
        self._libraries = {not many: self._loaded(narrow=not many)}
        self._interpreted = Accumulated(dense["step"])

    @property
    def compiled(self) -> bool:
        """Whether compiled code runs the recurrence."""
        return all(library is not None for library in self._libraries.values())

    def lanes(self, n_members: int) -> int:
        """How many members go through one instruction where there are so many; 0 in the virtual machine."""
        library = self._library_for(n_members)
        return 0 if library is None else library.flexopt_lanes()

    def __repr__(self) -> str:
        return f"Recurrence({self.step}, {'compiled' if self.compiled else 'CasADi virtual machine'})"

    def __call__(
        self,
        x0: ArrayLike,
        c: ArrayLike,
        *,
        steps: int,
        e: ArrayLike | None = None,
        stride: int = 1,
        threads: int = 1,
        keep: Literal["records", "monitors"] = "records",
    ) -> Records:
        """States after every `stride`-th step, and the maxima of the monitors in between.

        Records stand at k = stride, 2·stride, …; the start is not repeated. Where `stride` does not divide `steps` a
        last, shorter window ends at k = steps. States that are not finite propagate.

        Args:
            x0: (n, N) start states, or (n,) or (n, 1) for one that all members share.
            c: (n_c, N) constants of each member, or (n_c,) or (n_c, 1).
            steps: number of steps, 0 or more.
            e: (n_e,) or (n_e, 1) held constant, (steps, n_e) the same for all members, or (steps, n_e, N); row k enters
                step k -> k + 1. None where n_e = 0.
            stride: number of steps to a record.
            threads: among how many the members are divided; the results do not depend on it.
            keep: "monitors" leaves out the states between, so that memory does not grow with their number; one window
                over all steps is stride = steps.

        Raises:
            InputError: a shape, a number of members, or an option does not fit; every fault is named.
        """
        options = {"steps": steps, "stride": stride, "threads": threads, "keep": keep}
        arguments, n_members = checked_arguments(self.step.name(), self._sizes, x0, c, e, options)
        n, n_m = self._sizes["x"], self._sizes["monitor"]
        k = np.minimum(np.arange(1, -(-steps // stride) + 1) * stride, steps)
        records = Records(
            k=k, x=np.empty((len(k) if keep == "records" else 0, n, n_members)),
            monitor=np.empty((len(k), n_m, n_members)), last=np.empty((n, n_members)),
        )  # fmt: skip
        if not n_members:
            return records
        library = self._library_for(n_members)
        if library is None:
            self._interpret(arguments, records, steps, stride)
        else:
            job = _job(arguments, records, steps, stride, self._every)
            _run(library.flexopt_recurrence, job, n_members, threads, steps)
        return records

    def _library_for(self, n_members: int) -> ctypes.CDLL | None:
        """The loop for so many members, compiled when it is first needed; members give the same bits in each."""
        narrow = n_members <= _FEW
        if self.compiled and narrow not in self._libraries:
            self._libraries[narrow] = self._loaded(narrow=narrow)
        return self._libraries[narrow] if self.compiled else None

    def _loaded(self, *, narrow: bool) -> ctypes.CDLL | None:
        """The compiled loop over the steps, or None where it cannot be."""
        n = self._sizes
        rows = {"N": n["x"], "N_E": n["e"], "N_C": n["c"], "N_D": n["d"], "N_M": n["monitor"]}
        functions, chosen = list(self._functions.values()), level
        purpose = "recurrence of few" if narrow else "recurrence"
        # What is there is used, however hard it was to make.
        if self._brief and not is_kept(functions, purpose):
            purpose, chosen = f"brief {purpose}", brief_level
        library = load(functions, purpose, lambda: recurrence_source(self._functions, rows, narrow=narrow), chosen)
        if library is not None:
            library.flexopt_recurrence.argtypes = [ctypes.c_void_p, ctypes.c_longlong, ctypes.c_longlong]
        return library

    def _interpret(self, arguments: Sequence[Array], records: Records, steps: int, stride: int) -> None:
        """All members through the virtual machine, one after the other."""
        x0, c, e = arguments
        n_members = records.last.shape[1]
        x, monitor = np.empty((steps, self._sizes["x"])), np.empty((steps, self._sizes["monitor"]))
        starts = np.arange(0, steps, stride)
        for i in range(n_members):
            start, constants, moving = (a[..., i if a.shape[-1] > 1 else 0] for a in (x0, c, e))
            self._interpreted(start, np.broadcast_to(moving, (steps, moving.shape[1])), constants, x, monitor)
            records.last[:, i] = x[-1] if steps else start
            if steps:
                records.monitor[..., i] = np.maximum.reduceat(monitor, starts, axis=0)
            if len(records.x):
                records.x[..., i] = x[records.k - 1]


class _Job(ctypes.Structure):
    """`job` of recurrence.hpp."""

    _fields_ = [(name, ctypes.c_void_p) for name in ("x0", "c", "e", "x", "monitor", "last")] + [
        (name, ctypes.c_longlong)
        for name in ("members", "steps", "stride", "every", "x0_row", "x0_member", "c_row", "c_member",
                     "e_step", "e_row", "e_member")
    ]  # fmt: skip


def _address(array: Array) -> int:
    return array.__array_interface__["data"][0]


def _strided(array: Array) -> tuple[Array, list[int]]:
    """The array and its strides counted in numbers, 0 along what is single."""
    if any(stride % array.itemsize for stride in array.strides) or not array.flags.aligned:
        array = np.ascontiguousarray(array)
    return array, [s // array.itemsize if n > 1 else 0 for s, n in zip(array.strides, array.shape, strict=True)]


def _job(arguments: Sequence[Array], records: Records, steps: int, stride: int, every: int) -> tuple[_Job, list[Array]]:
    """The job, and the arrays that must live as long: all that it points to."""
    alive, strides = list[Array](), list[int]()
    for argument in arguments:
        array, counted = _strided(argument)
        alive.append(array)
        strides += counted
    x, monitor, last = records.x, records.monitor, records.last
    job = _Job(*map(_address, alive), _address(x) if len(x) else None, _address(monitor), _address(last),
               last.shape[1], steps, stride, every, *strides)  # fmt: skip
    return job, [*alive, x, monitor, last]


def _run(kernel: Callable[..., int], job: tuple[_Job, list[Array]], n: int, threads: int, steps: int) -> None:
    """All members, a contiguous part for each thread."""

    def part(begin: int, end: int) -> int:
        # The job holds the arrays that it points to, also after an interrupt.
        return kernel(ctypes.byref(job[0]), begin, end)

    groups = -(-n // _GROUP)
    threads = min(threads, groups)
    edges = [min(n, _GROUP * (groups * k // threads)) for k in range(threads + 1)]
    if any(awaited([partial(part, *edge) for edge in pairwise(edges)], n * steps)):
        raise MemoryError("no memory for the working space of a compiled recurrence")
