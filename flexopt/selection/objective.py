"""What a selection maximises: measures w_i, ε_max, weighted sums, Functions of the user's own, one after another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexopt.errors import Fault
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Vector
from flexopt.foundation.control import Control
from flexopt.foundation.kept import by_machine
from flexopt.model import AnyMachine
from flexopt.model.choices import OUTCOMES
from flexopt.model.constraints import Constraints
from flexopt.model.own import Constraint as OwnConstraint
from flexopt.model.own import OwnFunction
from flexopt.plant import build_plant
from flexopt.robustness.evaluation import Evaluation, evaluate_checked
from flexopt.robustness.margin import Margin, build_margin
from flexopt.robustness.measures import Measures, build_measures
from flexopt.robustness.posture_margin import evaluate_margin
from flexopt.robustness.residues import MIXED, residue_unit
from flexopt.selection.constraints import constraint_labels
from flexopt.selection.own import OwnGraphs, OwnTerm, own_faults, weights_of

# Two eigenvalues of XZ this close, in ε, both count where stationarity is checked.
KINK = 1e-5
# What results call the distance from singular postures.
MARGIN = "singularity margin"


@dataclass(frozen=True)
class Objective:
    """V(z) = Σ αi wi + β ε_max + U(z).

    Attributes:
        name: `"w1"`, …, `"V"` or `"epsilon_max"`; that of an own Function.
        alpha: α, (m,), as a tuple, so that an objective can be a key.
        beta: β; with β > 0 V has kinks where the two largest eigenvalues of XZ meet.
        own: U, or None.
        bounds: whether it is an own constraint: only kept, never sought, and travel costs it nothing.
    """

    name: str
    alpha: tuple[float, ...]
    beta: float
    own: OwnTerm | None = None
    bounds: bool = False

    @property
    def has_kinks(self) -> bool:
        """Whether ε_max takes part."""
        return self.beta > 0

    @property
    def label(self) -> str:
        """What it is called where it is kept."""
        return self.name if self.bounds else f"kept {self.name}"

    @property
    def uses(self) -> NDArray[np.bool_]:
        """Which w_i take part, (m,)."""
        own = self.own
        takes = [own is not None and own.own.takes("w", f"w{i + 1}") for i in range(len(self.alpha))]
        return np.array(takes) | (np.array(self.alpha) > 0)

    @property
    def weights(self) -> Vector:
        """α and, where ε_max takes part, β after it."""
        return np.array([*self.alpha, self.beta] if self.has_kinks else self.alpha)

    def unit(self, control: Control, joint_units: tuple[str, ...]) -> str:
        """Of V: that of the w_i where they alone take part; empty where it has none, or no one."""
        unit = residue_unit(control, joint_units)
        return "" if self.has_kinks or self.own is not None or unit == MIXED else unit

    def value(self, w: Vector, epsilon: float | None) -> float:
        """V from the measures (m,) and ε_max, without what is the user's own."""
        share = self.beta * (np.nan if epsilon is None else epsilon) if self.has_kinks else 0.0
        return float(np.dot(self.alpha, w) + share)


@dataclass(frozen=True)
class Quantities:
    """The Functions that objectives are made of, for one machine, controller, gravity option and gain."""

    measures: Measures
    margin: Margin
    gain: float

    def at(self, z: Vector) -> list[Any]:
        """Inputs base, posture, p of the Functions at z (n_z,), or at many (n_z, N)."""
        plant = self.measures.plant
        return [z[: plant.n_base], z[plant.n_base :], plant.parameter_values]

    def w_at(self, z: Vector) -> Vector:
        """The w_i at z (m, 1), or at many (m, N)."""
        found: Vector = self.measures.w.call(self.at(z))[0].full()
        return found

    def epsilon_max(self, bases: Vector, postures: Vector) -> Vector:
        """ε_max (N,) at many points (n_b, N), (n, N); compiled where that can be."""
        p = self.measures.plant.parameter_values.full().ravel()
        return self.margin.batched(bases, postures, p, [self.gain])[0][0]

    def own(self, term: OwnTerm) -> OwnGraphs:
        """The graphs of a Function of the user's."""
        return OwnGraphs(self.measures, term.own)

    def smooth(self, objective: Objective, bases: Vector, postures: Vector, w: Vector) -> Vector:
        """V (N,) without ε_max at points (n_b, N), (n, N) whose w_i are (m, N)."""
        values: Vector = np.array(objective.alpha) @ w
        if objective.own is None or not values.size:
            return values
        return values + self.of_own(objective.own, bases, postures)[objective.own.row] * objective.own.sign

    def of_own(self, term: OwnTerm, bases: Vector, postures: Vector, p: Any = None) -> Vector:
        """Every entry of an own Function at points, (k, N); with other numbers of the machine, p (n_par,)."""
        graphs, p = self.own(term), self.measures.plant.parameter_values if p is None else p
        return graphs.values_at.call([bases, postures, p, term.weights(), graphs.left()])[0].full()

    def pulls(self, objective: Objective, bases: Vector, postures: Vector) -> Vector:
        """∂V/∂w at points (n_b, N), (n, N): α, and what U adds, (m, N)."""
        alpha = np.repeat(
            np.array(objective.alpha)[:, None], np.reshape(postures, (len(postures), -1)).shape[1], axis=1
        )
        term = objective.own
        if term is None or not objective.uses.any() or not alpha.size:
            return alpha
        graphs, p = self.own(term), self.measures.plant.parameter_values
        return alpha + graphs.slope_at.call([bases, postures, p, term.weights(), graphs.left(term)])[2].full()

    def branches(
        self, objective: Objective, base: Vector, posture: Vector, *, exact: bool = False
    ) -> tuple[Vector, Vector]:
        """V with each of the two largest eigenvalues of XZ, (2,), and gradients by z, (3, n_z), as `Margin.gradients`.

        V itself is the smaller of the two. Without ε_max there is one branch: (1,) and (1, n_z). `exact`: ε_max and its
        gradient in extended precision, where it has no kink.
        """
        p, alpha, term = self.measures.plant.parameter_values, np.array(objective.alpha), objective.own
        value, gradient = np.zeros(1), np.zeros((1, len(base) + len(posture)))
        if alpha.any() or term is None:
            w = self.measures.w.call([base, posture, p])[0].full().ravel()
            value = np.atleast_1d(alpha @ w)
            gradient = self.measures.weighted_gradient.call([base, posture, p, alpha])[0].full()
        if term is not None:
            graphs = self.own(term)
            found = graphs.slope_at.call([base, posture, p, term.weights(), graphs.left(term)])
            value, gradient = value + float(found[0]), gradient + found[1].full().T
        if not objective.has_kinks:
            return value, gradient
        out = self.margin.gradients.call([base, posture, p, self.gain])
        margins, slopes = out[0].full().ravel(), out[1].full()
        told = evaluate_margin(self.margin, base, posture, self.gain, finest=True) if exact else None
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


@by_machine
def quantities(machine: AnyMachine, control: Control, gravity: bool, gain: float) -> Quantities:
    """The Functions for a problem (put together once, and kept: a selection asks thousands of times)."""
    return Quantities(build_measures(machine, control, gravity), build_margin(machine, control, gravity), gain)


def read_objectives(
    arguments: Arguments,
    machine: AnyMachine,
    objective: str | Sequence[str | OwnFunction],
    weights: Sequence[float] | None,
) -> tuple[Objective, ...]:
    """The objectives of a call, in order, of words and weights that are checked; other faults go to `arguments`."""
    m = build_plant(machine).n_passive
    parts = objective.split(",") if isinstance(objective, str) else objective
    if "V" not in parts and weights is not None:
        names = ",".join(part if isinstance(part, str) else part.name for part in parts)
        arguments.note("weights", f"go with objective V only, not with {names}", list(weights))
    found = list[Objective]()
    for part in parts:
        if isinstance(part, str) and part in OUTCOMES:
            sentence = "is for flexopt.select, select_stand and plan_base, or flexopt select: it wants a loop"
            arguments.note("objective", sentence, part)
        elif isinstance(part, str):
            found.append(_objective(arguments, machine, part, weights, m))
        else:
            faults = own_faults("objective", machine, part, scalar=True)
            arguments.faults += faults
            alpha = None if faults else weights_of(part, m)
            own = OwnTerm(part) if alpha is None else None
            found.append(Objective(part.name, alpha or (0.0,) * m, 0.0, own))
    return tuple(found)


def own_constraints(
    arguments: Arguments, machine: AnyMachine, constraints: Constraints
) -> tuple[tuple[Objective, float], ...]:
    """Of every own constraint, each entry and each bound, what is kept and its least value; faults to `arguments`."""
    plant, found = build_plant(machine), list[tuple[Objective, float]]()
    m, taken = plant.n_passive, {MARGIN, *(constraint_labels(plant, constraints) if constraints.own else ())}
    for constraint in constraints.own or ():
        faults = own_faults(f"constraints ({constraint.label})", machine, constraint.function, scalar=False)
        arguments.faults += faults
        names = [] if faults else entry_names(constraint)
        if not taken.isdisjoint(names):
            sentence = "has the name of a constraint of another kind, by which results tell both; names must differ"
            arguments.faults.append(Fault(f"constraints ({constraint.label})", sentence))
        lower, upper = constraint.bounds
        for row, name in enumerate(names):
            for sign, bound in ((1.0, lower), (-1.0, upper)):
                if np.isfinite(bound):
                    term = OwnTerm(constraint.function, row, sign)
                    found.append((Objective(name, (0.0,) * m, 0.0, term, bounds=True), sign * bound))
    return tuple(found)


def entry_names(constraint: OwnConstraint) -> list[str]:
    """What results call each entry of an own constraint."""
    size = int(constraint.function.function.numel_out(0))
    return [constraint.label] if size == 1 else [f"{constraint.label}[{k}]" for k in range(size)]


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
            arguments.faults.append(Fault("weights", f"is needed with objective V: {m} numbers, one for each mode"))
        return stand_in
    if len(weights) not in (m, m + 1):
        sentence = f"{machine.name} has {m} modes, so {m} weights are needed, or {m + 1} with the last for ε_max"
        arguments.note("weights", sentence, list(weights))
        return stand_in
    return Objective("V", tuple(weights[:m]), weights[m] if len(weights) > m else 0.0)
