"""How fast a loop decays at many configurations, gains, dead times and parameters at once.

In: a loop's numbers, and columns of what varies. Out: decay and frequency of the slowest motion of each, by the same
matrices, samples and eigenvalues as those of one loop (`outcome`), in stacks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.compiled import Economical
from flexopt.foundation.arrays import Progress, Vector, in_columns
from flexopt.foundation.kept import by_structure
from flexopt.foundation.turns import available_cores
from flexopt.loop.assembly import OneSample
from flexopt.loop.outcome import LoopPoint
from flexopt.loop.settings import LoopSettings
from flexopt.loop.small_motions import DEAD_TIME, Parts, SmallMotions
from flexopt.loop.spectrum import all_without_neutral, balance, neutral_directions, poles_of
from flexopt.model import AnyMachine

Stack = tuple[NDArray[np.int64], int]
# Loops of one stack, enough that calls cost little beside arithmetic; loops whose matrices are held at a time.
STACK, CHUNK = 256, 8192


class Decays(NamedTuple):
    """N loops; NaN where one is no finite number, or grows beyond the largest one within a sample.

    Attributes:
        decay: of the slowest motion, 1/s, negative where it grows, (N,).
        frequency_hz: its frequency, (N,).
    """

    decay: Vector
    frequency_hz: Vector


def expect_decays(
    count: int, machine: AnyMachine, settings: LoopSettings, *, gravity: bool, own_model: bool = False
) -> None:
    """Begin to compile what `decays` calls, where that is worth it for so many loops."""
    _stacked_matrices(settings.motions(machine, gravity=gravity, own_model=own_model)).expect(count)


def decays(
    machine: AnyMachine,
    settings: LoopSettings,
    varied: Mapping[str, Vector],
    *,
    gravity: bool = False,
    own_model: bool = False,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Decays:
    """The decay of the sampled loop at N points.

    Args:
        machine: the machine.
        settings: the loop's numbers.
        varied: of `INPUTS` and `dead_time` those that differ from them, (size, N) each, `base`, `posture` among them.
        gravity: whether under static deflection.
        own_model: whether the controller keeps the numbers of the machine's file, see `SmallMotions`.
        threads: how many to compute with; all processors by default. The numbers do not depend on it.
        progress: called with the number of loops done and of all.
    """
    threads = available_cores() if threads is None else threads
    motions = settings.motions(machine, gravity=gravity, own_model=own_model)
    count = next(iter(varied.values())).shape[1]
    given: dict[str, Vector] = {"p": motions.plant.parameter_values.full()} | settings.numbers
    given |= {name: values for name, values in varied.items() if name != DEAD_TIME}
    late = varied.get(DEAD_TIME, np.full((1, count), settings.dead_time))[0]
    numbers = {name: np.broadcast_to(_column(given, name, symbol.shape[0]), (symbol.shape[0], count))
               for name, symbol in motions.symbols.items() if name != "held"}  # fmt: skip
    held = motions.hold.call([numbers[name] for name in motions.hold.name_in()])[0].full()
    numbers["held"] = np.broadcast_to(held, (held.shape[0], count))
    found = Decays(*np.full((2, count), np.nan))
    of, alone = _stacked_matrices(motions), list[int]()
    # Threads ask for nothing that is public: this one has the turn.
    excess = motions.plant.n_actuated - motions.plant.n_task
    with ThreadPoolExecutor(threads) as pool:
        for start in range(0, count, CHUNK):
            here = slice(start, min(start + CHUNK, count))
            chunk = {name: np.ascontiguousarray(values[:, here]) for name, values in numbers.items()}
            parts = _unstacked(motions, of(*chunk.values(), threads=threads))
            stacks = list(_stacks(motions, chunk, late[here]))
            work = pool.map(partial(_slowest, excess, settings.rate, parts, late[here]), stacks)
            for (places, _), (values, known) in zip(stacks, work, strict=True):
                poles = poles_of(values, 1 / settings.rate)
                found.decay[start + places[known]] = -poles.real
                found.frequency_hz[start + places[known]] = np.abs(poles.imag) / math.tau
                alone += (start + places[~known]).tolist()
            if progress is not None:
                progress(here.stop, count)
    for k in alone:
        loop = LoopPoint(motions, {name: values[:, k] for name, values in numbers.items()}, float(late[k])).loop
        found.decay[k], found.frequency_hz[k] = -loop.growth_rate, loop.frequency_hz
    return found


def _column(given: Mapping[str, Vector], name: str, size: int) -> Vector:
    """What a loop lacks is 0."""
    return in_columns(np.atleast_1d(np.asarray(given.get(name, np.zeros(size)), dtype=np.float64)))


@by_structure
def _stacked_matrices(motions: SmallMotions) -> Economical:
    """`SmallMotions.matrices` with each as one column."""
    symbols = motions.symbols
    columns = [ca.vec(matrix) for matrix in motions.matrices.call(list(symbols.values()))]
    names = list(symbols), motions.matrices.name_out()
    return Economical(ca.Function("loop_matrices", list(symbols.values()), columns, *names, {"cse": True}))


def _unstacked(motions: SmallMotions, columns: list[Vector]) -> Parts:
    """The matrices (N, …, …) from columns."""
    shapes = [motions.matrices.size_out(k) for k in range(len(columns))]
    pairs = zip(columns, shapes, strict=True)
    return Parts(*(x.reshape(shape[1], shape[0], x.shape[1]).transpose(2, 1, 0) for x, shape in pairs))


def _stacks(motions: SmallMotions, numbers: Mapping[str, Vector], late: Vector) -> list[Stack]:
    """Numbers of loops with the same dead time, and in how many directions these may rest elsewhere; STACK at most."""
    unheld = np.vstack([late, numbers["kp"] == 0, numbers["ki"] == 0])
    _, group = np.unique(unheld, axis=1, return_inverse=True)
    order = np.argsort(group.ravel(), kind="stable")
    edges = np.flatnonzero(np.diff(group.ravel()[order])) + 1
    found: list[Stack] = []
    for alike in np.split(order, edges):
        first, joints = alike[0], motions.plant.n_actuated
        most = neutral_directions(motions.structure, joints, numbers["kp"][:, first], numbers["ki"][:, first])
        found += [(alike[k : k + STACK], most) for k in range(0, alike.size, STACK)]
    return found


def _slowest(
    excess: int, rate: float, parts: Parts, late: Vector, stack: Stack
) -> tuple[NDArray[np.complex128], NDArray[np.bool_]]:
    """The largest multipliers of loops of one dead time, and of which they are known.

    Not of those whose self-motion has to be told apart by its shape, nor of what is no number.
    """
    places, most = stack
    chosen = Parts(*(getattr(parts, name)[places] for name in Parts.__dataclass_fields__))
    matrices = OneSample(chosen, 1 / rate, float(late[places[0]])).matrix
    known = np.asarray(np.isfinite(matrices).all(axis=(1, 2)))
    finite = matrices[known]
    if most and len(finite):
        # One scale for all: eigenvalues do not depend on it.
        _, scale = balance(finite[len(finite) // 2])
        finite = finite / scale[:, None] * scale
    held, _, alike = all_without_neutral(finite, most)
    if matrices.shape[-1] - held.shape[-1] - (most - excess) < 2 * excess:
        return np.zeros(0, dtype=complex), np.zeros(len(places), dtype=bool)
    known[known] = alike
    values = np.linalg.eigvals(held).astype(complex)
    largest = np.abs(values).argmax(axis=1)
    return values[np.arange(len(values)), largest], known
