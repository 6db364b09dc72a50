"""What one exported C function is: a kernel with named inputs and outputs, and everything its documentation says.

In: graphs from the plant and the measures. Out: an `Operation`, from which the header, the checks, the test vectors and
the verification are written.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.errors import ExportError

Array = NDArray[np.float64]
Status = Literal["SINGULAR_POSTURE", "NOT_ACCURATE"]
# A sample is drawn again where a guard refuses it; so often at most.
DRAWS_MAX = 100


@dataclass(frozen=True)
class Field:
    """An input or output of an operation: a C array of reals, row-major where it has two dimensions.

    Attributes:
        name: as in C.
        dimensions: names of the sizes (`Sizes`), none for a single number.
        shape: their values.
        unit: SI.
        text: what it is, and its frame.
        low, high: allowed range of each element; unused for outputs.
        sample: range from which test inputs are drawn; `low` and `high` where None.
        logarithmic: whether the logarithm is drawn evenly.
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
    scale: str = ""

    @property
    def length(self) -> int:
        """Number of reals."""
        return math.prod(self.shape)

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Random values (count, length)."""
        low, high = self.sample or (self.low, self.high)
        if self.logarithmic:
            return np.exp(rng.uniform(np.log(low), np.log(high), (count, self.length)))
        return rng.uniform(low, high, (count, self.length))


@dataclass(frozen=True)
class Guard:
    """A number that the kernel computes beside its results, and the range in which these may be used."""

    name: str
    text: str
    status: Status
    minimum: float | None = None
    maximum: float | None = None

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

    def draw(self, parameters: Parameters, count: int, seed: int) -> Samples:
        """Random inputs that no guard refuses, and what the kernel makes of them in CasADi's virtual machine.

        Args:
            parameters: the machine's, of which every sample gets its own.
            count: how many.
            seed: the same one gives the same samples.

        Raises:
            ExportError: the guards refuse almost all inputs.
        """
        rng = np.random.default_rng(seed)
        kept: list[Array] = []
        for _ in range(DRAWS_MAX):
            if sum(len(part) for part in kept) >= count:
                break
            columns = [field.draw(rng, count) for field in self.inputs]
            columns += [] if self.baked else [parameters.draw(rng, count)]
            rows = parameters.rounded(np.hstack(columns))
            kept.append(rows[self.reference(rows).accepted])
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
            empty = np.zeros((0, sum(field.length for field in self.outputs)))
            return Samples(rows, empty, empty, np.zeros(0, bool))
        edges = np.cumsum([self.kernel.nnz_in(k) for k in range(self.kernel.n_in())])[:-1]
        arguments = [ca.DM(part.T) for part in np.split(rows, edges, axis=1)]
        results = _mapped(self.kernel, arguments, len(rows))
        sizes = _mapped(self.scales, arguments, len(rows))
        n = len(self.outputs)
        scales = [np.broadcast_to(s, (len(rows), f.length)) for s, f in zip(sizes, self.outputs, strict=True)]
        outputs = np.hstack(results[:n])
        accepted = np.asarray(np.isfinite(outputs).all(axis=1))
        for guard, value in zip(self.guards, results[n:], strict=True):
            accepted = accepted & guard.passes(value[:, 0])
        return Samples(rows, outputs, np.hstack(scales), accepted)


@dataclass(frozen=True)
class Samples:
    """Inputs (with parameters, where they are inputs) and what they give, one row each.

    Attributes:
        inputs: (count, n_in).
        outputs: (count, n_out), Python's.
        scales: sizes of the outputs, (count, n_out).
        accepted: whether every guard lets the results through.
    """

    inputs: Array
    outputs: Array
    scales: Array
    accepted: NDArray[np.bool_]


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

    def near(self, rows: Array) -> NDArray[np.bool_]:
        """Whether all values of a row (count, n_par) are as close to the machine's own as those drawn."""
        with np.errstate(invalid="ignore"):
            close = np.abs(rows - np.asarray(self.values)) <= 1.05 * np.asarray(self.spread)
        return np.asarray(close.all(axis=1))

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


@dataclass(frozen=True)
class Sizes:
    """Named array sizes of a bundle: `JOINTS` -> n and the like."""

    values: Mapping[str, int]

    def field(
        self,
        name: str,
        dimensions: str,
        unit: str,
        text: str,
        *,
        low: float | tuple[float, ...] = 0.0,
        high: float | tuple[float, ...] = 0.0,
        sample: tuple[float | tuple[float, ...], float | tuple[float, ...]] | None = None,
        logarithmic: bool = False,
        scale: str = "",
    ) -> Field:
        """A field whose dimensions are given by name, `"TASK JOINTS"`; numbers stand for all elements."""
        names = tuple(dimensions.split())
        shape = tuple(self.values[n] for n in names)
        length = math.prod(shape)

        def spread(value: float | tuple[float, ...]) -> tuple[float, ...]:
            return value if isinstance(value, tuple) else (value,) * length

        drawn = None if sample is None else (spread(sample[0]), spread(sample[1]))
        return Field(name, names, shape, unit, text, spread(low), spread(high), drawn, logarithmic, scale)
