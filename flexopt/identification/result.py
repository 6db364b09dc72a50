"""What `flexopt.identify` found: numbers with their intervals, what the log leaves open, modes and residuals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Array, Document, Vector
from flexopt.foundation.pictures import Pictured
from flexopt.foundation.results import Result
from flexopt.model import AnyMachine

OPEN = "not identifiable from this log"


@dataclass(frozen=True)
class IdentifiedMode(Result):
    """A mode of the machine with its arm held, before and after.

    Attributes:
        words: which it is, such as "mode 1, 2.1 Hz: mostly base.pitch": where its springs' energy sits.
        frequency_hz, damping_ratio: as identified;  frequency_before_hz, damping_ratio_before: by the machine's file.
        shares: of the springs' energy, by passive coordinate.
        signal_to_noise: how much of it the log shows, root mean square over the noise, in the column that shows most.
    """

    words: str
    frequency_hz: float
    damping_ratio: float
    frequency_before_hz: float
    damping_ratio_before: float
    shares: Mapping[str, float]
    signal_to_noise: float

    DOCUMENT = (
        "words frequency_hz[Hz] damping_ratio frequency_before_hz[Hz] damping_ratio_before shares signal_to_noise"
    )


@dataclass(frozen=True)
class FittedColumn(Result):
    """One column of the log beside the fit.

    Attributes:
        name, unit: of the quantity, SI.
        samples: how many were fitted;  left_out: how many more there are, spikes and outliers.
        offset: what was added to the simulated quantity, such as a gyroscope's bias.
        residual_rms: of what the fit leaves;  motion_rms: of the column about its mean.
        white: whether the residuals know nothing of each other.
    """

    name: str
    unit: str
    samples: int
    left_out: int
    offset: float
    residual_rms: float
    motion_rms: float
    white: bool


@dataclass(frozen=True, eq=False)
class Identification(Pictured, Result):
    """Parameters of a machine as a log of its free swing has them. N samples, c columns.

    `plot` draws every column with the fit and its residuals.

    Attributes:
        machine: with the identified numbers; of what the log leaves open, what goes with the others and is nearest to
            the file.
        before: the machine that was given.
        posture: how its arm was held, rad or m;  base: where it stood.
        values: by the parameters' names, in their units; None: not identifiable from this log.
        intervals: of 95 % confidence, (lower, upper); None likewise.
        units: of the parameters.
        factors: identified value over the file's; None likewise, and where the file has 0.
        open_directions: what the log leaves open, in words: parameters, or combinations of them.
        modes: of the machine with its arm held.
        columns: of the log.
        notes: what was found and mended: gaps, spikes, a window.
        doubts: what should be looked at before the numbers are used.
        duration: of what was used, s.
        converged: whether the least squares came to their end.
        time: (N,), s;  measured: (N, c), NaN where left out;  fitted: (N, c), with offsets.
        provenance: where the result comes from.

    Example:
        >>> found.units["base.stiffness.rotation"]
        'N m/rad'
        >>> low, high = found.intervals["base.stiffness.rotation"]
        >>> low < found.values["base.stiffness.rotation"] < high
        True
    """

    DOCUMENT = """
        status machine=machine.name machine_sha256=machine.content_hash posture base converged duration[s] values
        intervals units factors unidentified open_directions modes columns notes doubts provenance"""

    machine: AnyMachine
    before: AnyMachine
    posture: Vector
    base: Vector
    values: Mapping[str, float | None]
    intervals: Mapping[str, tuple[float, float] | None]
    units: Mapping[str, str]
    factors: Mapping[str, float | None]
    open_directions: tuple[str, ...]
    modes: tuple[IdentifiedMode, ...]
    columns: tuple[FittedColumn, ...]
    notes: tuple[str, ...]
    doubts: tuple[str, ...]
    duration: float
    converged: bool
    time: Vector = field(repr=False)
    measured: Array = field(repr=False)
    fitted: Array = field(repr=False)
    provenance: Document = field(repr=False)

    @property
    def unidentified(self) -> tuple[str, ...]:
        """Parameters that this log does not tell."""
        return tuple(name for name, value in self.values.items() if value is None)

    @property
    def status(self) -> str:
        """`"identified"`, `"partly identified"`, or `"not identified"`."""
        known = len(self.values) - len(self.unidentified)
        return "not identified" if not known else "partly identified" if self.unidentified else "identified"

    @property
    def residuals(self) -> NDArray[np.float64]:
        """Log minus fit (N, c), SI; NaN where left out."""
        return self.measured - self.fitted

    def __repr__(self) -> str:
        width = max(len(name) for name in self.values)
        lines = [f"{self.before.name}: {self.status} from {self.duration:.4g} s of free swing, 95 % intervals"]
        for name, value in self.values.items():
            interval, factor = self.intervals[name], self.factors[name]
            if value is None or interval is None:
                lines.append(f"  {name:{width}}  {OPEN}")
                continue
            times = "" if factor is None else f", {factor:.3g} times the file's"
            lines.append(
                f"  {name:{width}}  {value:.5g} {self.units[name]} ({interval[0]:.5g} … {interval[1]:.5g}){times}"
            )
        lines += [f"  left open: {sentence}" for sentence in self.open_directions]
        if self.unidentified:
            nearest = "what goes with the others and is nearest to its file, which is no measurement"
            lines.append(f"  the machine has, of what is left open, {nearest}")
        for mode in self.modes:
            seen = "" if mode.signal_to_noise >= 1 else "; hidden in the noise"
            lines.append(
                f"  {mode.words}; damping ratio {mode.damping_ratio:.3g}; by the file "
                f"{mode.frequency_before_hz:.4g} Hz, {mode.damping_ratio_before:.3g}{seen}"
            )
        for column in self.columns:
            left = f", {column.left_out} left out" if column.left_out else ""
            white = "" if column.white else ", not white"
            lines.append(
                f"  {column.name}: residuals {column.residual_rms:.3g} {column.unit} of {column.motion_rms:.3g}, "
                f"{column.samples} samples{left}{white}"
            )
        lines += [f"  note: {sentence}" for sentence in self.notes]
        return "\n".join([*lines, *(f"  doubt: {sentence}" for sentence in self.doubts)])
