"""What one exported C function is: a kernel with named inputs and outputs, and everything its documentation says.

In: graphs from the plant and the measures. Out: an `Operation`, from which the header, the checks, the test vectors and
the verification are written.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Any, Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.errors import ExportError
from flexopt.foundation.arrays import Array

OperationStatus = Literal["SINGULAR_POSTURE", "NOT_ACCURATE"]
# Largest error of an output by rounding, as a share of its scale.
TOLERANCES = {"double": 1e-12, "float": 1e-4}
# A sample is drawn again where a guard refuses it; so often at most.
DRAWS_MAX = 100
# 2π in two parts, of which the first has so few digits that its multiples are exact in either precision.
TURN = (6.28125, 2 * math.pi - 6.28125)
# Share of the numbers in test inputs that lie beyond the machine's limits, or whole turns away.
DISPLACED, TURNS = 0.1, 3
# Random inputs by which it is told how many of them a function takes.
ACCEPTANCE_COUNT, ACCEPTANCE_SEED = 1000, 7


@dataclass(frozen=True)
class Field:
    """An input or output of an operation: a C array of reals, row-major where it has two dimensions.

    Attributes:
        name: as in C.
        dimensions: names of sizes (`Context.sizes`), none for a single number.
        shape: their values.
        unit: SI.
        text: what it is, and its frame.
        low, high: allowed range of each element; unused for outputs.
        sample: range from which test inputs are drawn; `low` and `high` where None.
        logarithmic: whether the logarithm is drawn evenly.
        design: the machine's own limits where measurements may lie beyond them, inside `low` and `high`.
        turning: for each element whether it is an angle that whole turns leave as it is; none where empty.
        scale: outputs: in words, the size by which errors are judged.
    """

    name: str
    dimensions: tuple[str, ...]
    shape: tuple[int, ...]
    unit: str
    text: str
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    sample: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    logarithmic: bool = False
    design: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    turning: tuple[bool, ...] = ()
    scale: str = ""

    @property
    def length(self) -> int:
        """Number of reals."""
        return math.prod(self.shape)

    @property
    def first(self) -> str:
        """Its first real, as C names it inside the structure."""
        return self.name + "[0]" * len(self.dimensions)

    @property
    def same_range(self) -> bool:
        """Whether all its elements have one range."""
        return len(set(self.low)) == len(set(self.high)) == 1

    @property
    def range_text(self) -> str:
        """Its range in words, after what it is."""
        if self.same_range:
            return f"; from {self.low[0]:g} to {self.high[0]:g}"
        low, high = (", ".join(f"{x:g}" for x in side) for side in (self.low, self.high))
        return f"; from [{low}] to [{high}]"

    @property
    def turns(self) -> bool:
        """Whether some of its elements are angles that turn freely."""
        return any(self.turning)

    @property
    def has_margin(self) -> bool:
        """Whether measurements may lie beyond the machine's limits."""
        return self.design is not None and self.design != (self.low, self.high)

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Random values (count, length)."""
        low, high = self.sample or (self.low, self.high)
        if self.logarithmic:
            return np.exp(rng.uniform(np.log(low), np.log(high), (count, self.length)))
        return rng.uniform(low, high, (count, self.length))

    def displaced(self, rng: np.random.Generator, values: Array) -> Array:
        """The same, some of them beyond the machine's limits and some whole turns away, as far as that is allowed."""
        if self.design is not None:
            share, upper = rng.uniform(0, 1, values.shape), rng.random(values.shape) < 0.5
            (low, high), shape = (np.asarray(side) for side in self.design), values.shape
            room = np.where(upper, self.high - high, low - np.asarray(self.low))
            beyond = np.where(upper, high + share * room, low - share * room)
            values = np.where((rng.random(shape) < DISPLACED) & (room > 0), beyond, values)
        if self.turns:
            turns = rng.integers(-TURNS, TURNS + 1, values.shape) * (rng.random(values.shape) < DISPLACED)
            values = values + 2 * math.pi * turns * np.asarray(self.turning)
        return values

    def within(self, values: Array, *, design: bool = False, room: float = 0.0) -> NDArray[np.bool_]:
        """Whether all numbers of each row lie in their ranges, or in the machine's own, `room` kept from the ends."""
        low, high = self.design if design and self.design is not None else (self.low, self.high)
        return np.asarray(((values >= np.add(low, room)) & (values <= np.subtract(high, room))).all(axis=1))

    def unwound(self, values: Array) -> Array:
        """Angles that turn freely, reduced to ±π as the C code does."""
        if not self.turns:
            return values
        turns = np.floor(values / (2 * math.pi) + 0.5)
        return np.where(self.turning, (values - turns * TURN[0]) - turns * TURN[1], values)


@dataclass(frozen=True)
class Guard:
    """A number that the kernel computes beside its results, and the range in which these may be used."""

    name: str
    text: str
    status: OperationStatus
    minimum: float | None = None
    maximum: float | None = None

    @property
    def refused(self) -> str:
        """What it refuses, in words."""
        return f"{self.name} < {self.minimum:.4g}" if self.minimum is not None else f"{self.name} > {self.maximum:.4g}"

    def passes(self, value: Array) -> NDArray[np.bool_]:
        """Whether the results may be used; a NaN may not."""
        low = -math.inf if self.minimum is None else self.minimum
        high = math.inf if self.maximum is None else self.maximum
        return (value >= low) & (value <= high)


@dataclass(frozen=True)
class Operation:
    """One exported function.

    Attributes:
        name: as in C, without the bundle's prefix.
        text: what it computes, in sentences; equations with their symbols.
        inputs, outputs: in the order of the kernel's.
        guards: the kernel's outputs after `outputs`.
        kernel: (inputs…, p) -> (outputs…, guards…); without p where the parameters are baked.
        scales: the kernel's inputs -> one size for each output, a scalar or one for each element.
    """

    name: str
    text: str
    inputs: tuple[Field, ...]
    outputs: tuple[Field, ...]
    guards: tuple[Guard, ...]
    kernel: ca.Function
    scales: ca.Function

    @property
    def baked(self) -> bool:
        """Whether the machine's parameters are constants."""
        return self.kernel.n_in() == len(self.inputs)

    @property
    def n_in(self) -> int:
        """Reals of its input structure."""
        return sum(field.length for field in self.inputs)

    @property
    def n_out(self) -> int:
        """Reals of its output structure."""
        return sum(field.length for field in self.outputs)

    @property
    def offsets(self) -> list[int]:
        """Where each output, then each guard begins in the workspace."""
        lengths = [*(field.length for field in self.outputs), *(1 for _ in self.guards)]
        return list(accumulate(lengths, initial=0))[:-1]

    def about(self, prefix: str) -> str:
        """What it computes and what its guards refuse; `prefix` of the statuses."""
        refusals = [f"{prefix}_{g.status} where {g.refused} ({g.text})" for g in self.guards]
        return self.text + (f" Refused: {'; '.join(refusals)}." if refusals else "")

    def random_rows(
        self, parameters: Parameters, rng: np.random.Generator, count: int, *, displaced: bool = False
    ) -> Array:
        """Random inputs, with parameters where they are inputs, as the C code will see them."""
        columns = [field.draw(rng, count) for field in self.inputs]
        if displaced:
            columns = [field.displaced(rng, part) for field, part in zip(self.inputs, columns, strict=True)]
        columns += [] if self.baked else [parameters.draw(rng, count)]
        return parameters.rounded(np.hstack(columns))

    def acceptance(self, parameters: Parameters) -> float:
        """Share of random inputs, inside the machine's limits, with its own parameters, that the guards let through."""
        own, rng = replace(parameters, spread=(0.0,) * len(parameters.spread)), np.random.default_rng(ACCEPTANCE_SEED)
        return float(np.mean(self.accepts(self.random_rows(own, rng, ACCEPTANCE_COUNT))))

    def draw(self, parameters: Parameters, count: int, seed: int, *, displaced: bool = True) -> Samples:
        """Random inputs that no guard refuses, and what the kernel makes of them in CasADi's virtual machine.

        Args:
            parameters: the machine's, of which every sample gets its own.
            count: how many.
            seed: the same one gives the same samples.
            displaced: whether some measurements lie beyond the machine's limits, and some whole turns away.

        Raises:
            ExportError: the guards refuse almost all inputs.
        """
        rng = np.random.default_rng(seed)
        kept: list[Array] = []
        for _ in range(DRAWS_MAX):
            if sum(len(part) for part in kept) >= count:
                break
            rows = self.random_rows(parameters, rng, count, displaced=displaced)
            kept.append(rows[self.accepts(rows)])
        rows = np.vstack(kept)[:count]
        if len(rows) < count:
            guards = "; ".join(f"{guard.name}: {guard.text}" for guard in self.guards)
            raise ExportError(
                f"{self.name}: only {len(rows)} of {count * DRAWS_MAX} random inputs pass the function's own checks "
                f"({guards}), so it would be of no use to this machine's controller; leave its part out"
            )
        return self.reference(rows)

    def reference(self, rows: Array) -> Samples:
        """The kernel at given inputs (count, inputs and parameters), by CasADi's virtual machine in double."""
        if not len(rows):
            empty = np.zeros((0, self.n_out))
            return Samples(rows, empty, empty, np.zeros(0, bool), np.zeros(0, bool))
        measured = [(f, part) for f, part in zip(self.inputs, self.split(rows), strict=False) if f.design is not None]
        beyond = np.zeros(len(rows), bool)
        for field, part in measured:
            beyond |= ~field.within(part, design=True)
        outputs, accepted = self._computed(rows)
        sizes = _mapped(self.scales, self._arguments(rows), len(rows))
        scales = [np.broadcast_to(s, (len(rows), f.length)) for s, f in zip(sizes, self.outputs, strict=True)]
        return Samples(rows, outputs, np.hstack(scales), accepted, beyond)

    def accepts(self, rows: Array) -> NDArray[np.bool_]:
        """Whether every guard lets the results of each row through."""
        return self._computed(rows)[1]

    def _computed(self, rows: Array) -> tuple[Array, NDArray[np.bool_]]:
        """The kernel's outputs at each row, and whether they may be used."""
        n, results = len(self.outputs), _mapped(self.kernel, self._arguments(rows), len(rows))
        outputs = np.hstack(results[:n])
        accepted = np.asarray(np.isfinite(outputs).all(axis=1))
        for guard, value in zip(self.guards, results[n:], strict=True):
            accepted = accepted & guard.passes(value[:, 0])
        return outputs, accepted

    def _arguments(self, rows: Array) -> list[ca.DM]:
        """Rows as the kernel takes them: one column each, free angles reduced."""
        parts = self.split(rows)
        arguments = [ca.DM(field.unwound(part).T) for field, part in zip(self.inputs, parts, strict=False)]
        return arguments + [ca.DM(part.T) for part in parts[len(self.inputs) :]]

    def split(self, rows: Array) -> list[Array]:
        """Columns of each input, and of the parameters where they are inputs."""
        edges = np.cumsum([self.kernel.nnz_in(k) for k in range(self.kernel.n_in())])[:-1]
        return np.split(rows, edges, axis=1)

    def takes(self, rows: Array, *, room: float) -> NDArray[np.bool_]:
        """Whether the C function takes each row without a remark, measurements `room` inside the machine's limits."""
        inside = [
            field.within(part, design=True, room=room if field.design is not None else 0.0)
            for field, part in zip(self.inputs, self.split(rows), strict=False)
        ]
        return self.accepts(rows) & np.all(inside, axis=0)


def operation_of(
    name: str,
    text: str,
    inputs: Sequence[tuple[Field, Any]],
    p: Sequence[Any],
    outputs: Sequence[tuple[Field, Any, Any]],
    guards: Sequence[tuple[Guard, Any]],
    options: Mapping[str, Any] | None = None,
) -> Operation:
    """An operation of graphs: inputs with their symbols, `p` unless it is baked, outputs with their sizes, guards."""
    fields, results = tuple(field for field, _ in inputs), tuple(field for field, _, _ in outputs)
    refusing = tuple(guard for guard, _ in guards)
    symbols, names = [*(x for _, x in inputs), *p], [*(field.name for field in fields), *["p"] * len(p)]
    graphs, sizes = [*(x for _, x, _ in outputs), *(x for _, x in guards)], [size for _, _, size in outputs]
    told = [each.name for each in (*results, *refusing)]
    kernel = ca.Function(name, symbols, graphs, names, told, options or {})
    scales = ca.Function(f"{name}_scales", symbols, sizes, names, told[: len(sizes)], options or {})
    return Operation(name, text, fields, results, refusing, kernel, scales)


@dataclass(frozen=True)
class Samples:
    """Inputs (with parameters, where they are inputs) and what they give, one row each.

    Attributes:
        inputs: (count, n_in).
        outputs: (count, n_out), Python's.
        scales: sizes of the outputs, (count, n_out).
        accepted: whether every guard lets the results through.
        beyond: whether a measurement lies beyond the machine's limits.
    """

    inputs: Array
    outputs: Array
    scales: Array
    accepted: NDArray[np.bool_]
    beyond: NDArray[np.bool_]


@dataclass(frozen=True)
class Parameters:
    """The machine's parameters p as the C code takes them.

    Attributes:
        names, units, values: one each.
        low, high: allowed ranges.
        spread: how far from its value each is drawn.
        single: whether numbers are rounded to single precision before either side sees them.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    spread: tuple[float, ...]
    single: bool

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Values around the machine's own, (count, n_par)."""
        away = np.asarray(self.spread) * rng.uniform(-1, 1, (count, len(self.values)))
        return np.clip(np.asarray(self.values) + away, self.low, self.high)

    def rounded(self, rows: Array) -> Array:
        """Numbers as the C code will see them."""
        return rows.astype(np.float32).astype(np.float64) if self.single else rows


def _mapped(function: ca.Function, arguments: list[ca.DM], count: int) -> list[Array]:
    """Outputs, which are columns, at many points: (count, length) each."""
    # Several hundred points a call keep the virtual machine's own cost small and its memory, too.
    parts: list[list[Array]] = []
    for start in range(0, count, 250):
        chunk = [argument[:, start : min(start + 250, count)] for argument in arguments]
        parts.append([result.full().T for result in function.call(chunk)])
    return [np.vstack(columns) for columns in zip(*parts, strict=True)]
