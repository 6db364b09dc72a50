"""What a selection maximises: measures w_i, ε_max, weighted sums of them, one after another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from flexopt.errors import Fault
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Vector
from flexopt.foundation.control import Control
from flexopt.model import AnyMachine
from flexopt.plant import build_plant
from flexopt.robustness.evaluation import Evaluation, evaluate_checked
from flexopt.robustness.margin import Margin, build_margin
from flexopt.robustness.measures import Measures, build_measures
from flexopt.robustness.posture_margin import evaluate_margin

# Two eigenvalues of XZ this close, in ε, both count where stationarity is checked.
KINK = 1e-5


@dataclass(frozen=True)
class Objective:
    """V(z) = Σ αi wi + β ε_max.

    Attributes:
        name: `"w1"`, …, `"V"` or `"epsilon_max"`.
        alpha: α, (m,), as a tuple, so that an objective can be a key.
        beta: β; with β > 0 V has kinks where the two largest eigenvalues of XZ meet.
    """

    name: str
    alpha: tuple[float, ...]
    beta: float

    @property
    def has_kinks(self) -> bool:
        """Whether ε_max takes part."""
        return self.beta > 0

    @property
    def weights(self) -> Vector:
        """α and, where ε_max takes part, β after it."""
        return np.array([*self.alpha, self.beta] if self.has_kinks else self.alpha)

    def value(self, w: Vector, epsilon: float | None) -> float:
        """V from the measures (m,) and ε_max."""
        share = self.beta * (np.nan if epsilon is None else epsilon) if self.has_kinks else 0.0
        return float(np.dot(self.alpha, w) + share)


@dataclass(frozen=True)
class Quantities:
    """The Functions that objectives are made of, for one machine, controller, gravity option and gain."""

    measures: Measures
    margin: Margin
    gain: float

    def epsilon_max(self, bases: Vector, postures: Vector) -> Vector:
        """ε_max (N,) at many points (n_b, N), (n, N); compiled where that can be."""
        p = self.measures.plant.parameter_values.full().ravel()
        return self.margin.batched(bases, postures, p, [self.gain])[0][0]

    def branches(
        self, objective: Objective, base: Vector, posture: Vector, *, exact: bool = False
    ) -> tuple[Vector, Vector]:
        """V with each of the two largest eigenvalues of XZ, (2,), and gradients by z, (3, n_z), as `Margin.gradients`.

        V itself is the smaller of the two. Without ε_max there is one branch: (1,) and (1, n_z). `exact`: ε_max and its
        gradient in extended precision, where it has no kink.
        """
        p, alpha = self.measures.plant.parameter_values, np.array(objective.alpha)
        w = self.measures.w.call([base, posture, p])[0].full().ravel()
        value, gradient = (
            np.atleast_1d(alpha @ w),
            self.measures.weighted_gradient.call([base, posture, p, alpha])[0].full(),
        )
        if not objective.has_kinks:
            return value, gradient
        out = self.margin.gradients.call([base, posture, p, self.gain])
        margins, slopes = out[0].full().ravel(), out[1].full()
        told = evaluate_margin(self.margin, base, posture, self.gain) if exact else None
        if told is not None and told.epsilon_max is not None and told.kink is None and np.all(np.isfinite(told.z)):
            margins[0], slopes[0] = told.epsilon_max, told.z
        rows = objective.beta * slopes
        rows[:2] += gradient
        return value + objective.beta * margins, rows

    def evaluated(self, z: Vector) -> Evaluation:
        """Every measure at z."""
        measures, n_base = self.measures, self.measures.plant.n_base
        return evaluate_checked(
            measures.plant.machine,
            z[n_base:],
            z[:n_base],
            control=measures.control,
            gain=self.gain,
            damped=False,
            gravity=measures.gravity,
        )


@lru_cache(maxsize=64)
def quantities(machine: AnyMachine, control: Control, gravity: bool, gain: float) -> Quantities:
    """The Functions for a problem (put together once, and kept: a selection asks thousands of times)."""
    return Quantities(build_measures(machine, control, gravity), build_margin(machine, control, gravity), gain)


def read_objectives(
    arguments: Arguments, machine: AnyMachine, objective: str, weights: Sequence[float] | None
) -> tuple[Objective, ...]:
    """The objectives of a call, in order, of words and weights that are checked; other faults go to `arguments`."""
    m = build_plant(machine).n_passive
    names = objective.split(",")
    if "V" not in names and weights is not None:
        arguments.note("weights", f"go with objective V only, not with {','.join(names)}", list(weights))
    return tuple(_objective(arguments, machine, name, weights, m) for name in names)


def _objective(
    arguments: Arguments, machine: AnyMachine, name: str, weights: Sequence[float] | None, m: int
) -> Objective:
    if name == "epsilon_max":
        return Objective(name, (0.0,) * m, 1.0)
    if name == "V":
        return _weighted(arguments, machine, weights, m)
    mode = int(name[1:])
    if mode > m:
        modes = f"{machine.name} has {m} modes: w1 to w{m}, or V, or epsilon_max"
        arguments.faults.append(Fault("objective", modes, repr(name)))
    return Objective(name, tuple(1.0 if i == mode - 1 else 0.0 for i in range(m)), 0.0)


def _weighted(arguments: Arguments, machine: AnyMachine, weights: Sequence[float] | None, m: int) -> Objective:
    stand_in = Objective("V", (1.0,) * m, 0.0)
    if weights is None:
        if not arguments.faulty("weights"):
            arguments.faults.append(Fault("weights", f"objective V needs {m} of them, one for each mode"))
        return stand_in
    if len(weights) not in (m, m + 1):
        sentence = f"{machine.name} has {m} modes, so {m} weights are needed, or {m + 1} with the last for ε_max"
        arguments.note("weights", sentence, list(weights))
        return stand_in
    return Objective("V", tuple(weights[:m]), weights[m] if len(weights) > m else 0.0)
