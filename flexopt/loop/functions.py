"""LoopPoint measures as CasADi Functions, with exact derivatives: for solvers, and for whoever asks for one number.

In: a loop for small motions. Out: Functions of placement, posture, parameters, gains and dead time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arrays import Vector
from flexopt.loop.outcome import MEASURES, LoopPoint, Measured
from flexopt.loop.small_motions import BY, DEAD_TIME, SmallMotions


@dataclass(frozen=True)
class _Measure:
    """A measure of a loop whose samples are `period` apart, at arrays in the order of `BY`."""

    motions: SmallMotions
    name: str
    period: float

    @property
    def sizes(self) -> list[int]:
        return [1 if name == DEAD_TIME else self.motions.symbols[name].shape[0] for name in BY]

    def at(self, given: Sequence[Any]) -> tuple[LoopPoint, Measured]:
        """The loop there, and the measure."""
        numbers = {name: ca.DM(x).full().ravel() for name, x in zip(BY, given, strict=False)}
        late = float(numbers.pop(DEAD_TIME)[0])
        outcome = LoopPoint(self.motions, self.motions.numbers(numbers | {"period": np.array([self.period])}), late)
        return outcome, MEASURES[self.name](outcome)


class OutcomeFunction(ca.Callback):
    """One measure as a Function; see `outcome_function`."""

    def __init__(self, measure: _Measure) -> None:
        ca.Callback.__init__(self)
        self.measure = measure
        self._kept: list[ca.Callback] = []
        self.construct(measure.name, {})

    def get_n_in(self) -> int:
        """See `casadi.Callback`."""
        return len(BY)

    def get_n_out(self) -> int:
        """See `casadi.Callback`."""
        return 1

    def get_name_in(self, i: int) -> str:
        """See `casadi.Callback`."""
        return BY[i]

    def get_name_out(self, i: int) -> str:  # noqa: ARG002
        """See `casadi.Callback`."""
        return self.measure.name

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """See `casadi.Callback`."""
        return ca.Sparsity.dense(self.measure.sizes[i], 1)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:  # noqa: ARG002
        """See `casadi.Callback`."""
        return ca.Sparsity.dense(1, 1)

    def eval(self, arg: Sequence[Any]) -> list[Any]:
        """See `casadi.Callback`."""
        return [self.measure.at(arg)[1].value]

    def has_jacobian(self) -> bool:
        """See `casadi.Callback`."""
        return True

    def get_jacobian(self, name: str, inames: Sequence[str], onames: Sequence[str], opts: Any) -> ca.Function:
        """See `casadi.Callback`."""
        jacobian = _Jacobian(self.measure, name, inames, onames, opts)
        self._kept.append(jacobian)
        return jacobian


class _Jacobian(ca.Callback):
    """Its derivative by each input; by CasADi's rule the nominal output is an input, too."""

    def __init__(self, measure: _Measure, name: str, inames: Sequence[str], onames: Sequence[str], opts: Any) -> None:
        ca.Callback.__init__(self)
        self.measure, self._in, self._out = measure, inames, onames
        self.construct(name, opts)

    def get_n_in(self) -> int:
        return len(BY) + 1

    def get_n_out(self) -> int:
        return len(BY)

    def get_name_in(self, i: int) -> str:
        return self._in[i]

    def get_name_out(self, i: int) -> str:
        return self._out[i]

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense([*self.measure.sizes, 1][i], 1)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(1, self.measure.sizes[i])

    def eval(self, arg: Sequence[Any]) -> list[Any]:
        outcome, measured = self.measure.at(arg)
        found: dict[str, Vector] = outcome.gradient(measured)
        return [ca.DM(found[name]).T for name in BY]


@lru_cache(maxsize=64)
def outcome_function(motions: SmallMotions, name: str, rate: float) -> ca.Function:
    """A measure of the sampled loop as a Function, which CasADi differentiates once, exactly.

    Args:
        motions: from `small_motions` or `LoopSettings.motions`.
        name: `"decay"`, `"allowed_gain"`, `"delay_margin"`, `"disk_margin"`, `"h2_norm"`,
            `"sensitivity_peak"`, `"complementary_peak"`, `"settling"` or `"swing"`; see `LoopPoint`.
        rate: of the samples, Hz.

    Returns:
        Function of base (n_b,), posture (n,), p (n_par,), kp, kv, ki (r,), nullspace_damping, servo_gain, filter_hz
        (1,), bandwidth_hz (n,) and dead_time (1,), of what a loop lacks any numbers. NaN where there is no such number,
        and derivatives where eigenvalues meet.

    Raises:
        InputError: there is no such measure.
    """
    known = ", ".join(MEASURES)
    raise_if_any(InputError, "outcome_function", [] if name in MEASURES else [Fault("name", f"must be {known}", name)])
    return OutcomeFunction(_Measure(motions, name, 1 / rate))
