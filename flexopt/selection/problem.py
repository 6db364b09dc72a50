"""The configuration problem as a nonlinear program that can be inspected before it is solved."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.errors import InputError
from flexopt.foundation.arrays import Document, Vector
from flexopt.foundation.boundary import array_of, flag, instance, number, public
from flexopt.foundation.control import Control
from flexopt.foundation.plain import listed
from flexopt.model import AnyMachine
from flexopt.model.choices import Elbow
from flexopt.model.configuration import Configuration
from flexopt.model.constraints import Constraints as ConstraintsAsked
from flexopt.model.kinematic_tree import ORIENTATION_ROWS
from flexopt.model.loop import Loop
from flexopt.robustness.measures import Measures
from flexopt.selection.assumed import Assumption
from flexopt.selection.cones import split_factors
from flexopt.selection.constraints import ConstraintSet
from flexopt.selection.constraints.kind import ScaledConstraint
from flexopt.selection.held import held_with
from flexopt.selection.nlp.assembly import build_solver
from flexopt.selection.nlp.configuration import ConfigurationGraphs, build_configuration
from flexopt.selection.nlp.coupling import Coupling, alone
from flexopt.selection.nlp.member_graph import ObjectiveForm, parameters_of
from flexopt.selection.objective import Objective, Quantities, entry_names, quantities
from flexopt.selection.own import OwnTerm
from flexopt.selection.scan import Scan


@dataclass(frozen=True)
class DecisionVariable:
    """A decision variable: bounds and the scale that IPOPT sees it in, all in `unit`.

    `ranged`: of a placement, whether `base_range` bounds it: the base may stand nowhere else.
    """

    name: str
    unit: str
    lower: float
    upper: float
    scale: float
    ranged: bool = False


@dataclass(frozen=True)
class TravelCost:
    """What leaving z_now costs: V less by cost · objective_scale · Σ ((z − z_now) / scale_z)².

    Attributes:
        cost: as a share of the objective's scale.
        now: z_now (n_z,), m or rad.
    """

    cost: float
    now: Vector


@dataclass(frozen=True)
class StartRegion:
    """Finite ranges of z that samples are taken from: from low to high, (n_z,) each, m or rad."""

    low: Vector
    high: Vector


def _sizes(of: Any) -> dict[str, int]:
    return {"n_z": len(of.variables)}


# Objectives closer than this, relative to the problem's scale, rank as equal; IPOPT reaches an optimum at w = 0 to
# about the square of its step tolerance, far below.
TIE_TOLERANCE = 1e-9
# How far from its target an end-point may be and count as there, m.
THERE = 0.01
_OBJECTIVE = instance(Objective, "one of the problem's `objectives`")
# One configuration or many.
_MANY = array_of(("n_z",), ("N", "n_z"), ("K", "N", "n_z"), finite=False)


@dataclass(frozen=True)
class SelectionProblem:
    """argmax V(z), V = Σ αi wi + β ε_max + U(z), over z = [base, posture] with r(z) = target (article, section 4).

    Attributes:
        machine, target: what is asked for; target (n_task,), m, inertial frame.
        objectives: own constraints, see `bounding`; and after them what is maximised, in order of importance: each one
            among the configurations that keep those before.
        kept: values of V_1, V_2, … that a solution must keep, for the objectives before the one being solved.
        slack: what an objective may give up for the next, as a share; see `given_up`.
        control, gravity, gain: as in `flexopt.evaluate`.
        variables: the placement, then the actuated joints.
        constraints: the target's rows, the distance from singular postures as sin² of the margin, and the rows of
            `constraint_set`.
        constraint_set: what else a configuration must keep, or None.
        asked: the constraints as they were given.
        assumed: what holds beside them, see `flexopt.selection.assumed`.
        travel: what leaving the present configuration costs, or None.
        objective_scales: of each objective: typical |a||b| of its modes, or β of ε_max; V is divided by it before
            IPOPT sees it.
        scan: the redundancy seen coarsely; the starts come from it.
        region: where starts are looked for.
        present_base, present_posture: where the machine stands now and how it is held, for the tie-break and the
            initial evaluation, or None.
        elbow: branch of the initial posture of a planar arm.
        singularity_margin: rad.
        starts: how many are tried at most, or None for the default;  seed: of the scan's sample.
        bounding: how many of the objectives are own constraints: they come first, and are kept from the beginning.

    Example:
        >>> problem = flexopt.build_selection(flexopt.load("excavator"), (0.0, 1.6))
        >>> problem.objective.name, problem.rows([0.0, 0.9929, -2.6306]).shape
        ('w1', (3,))
    """

    machine: AnyMachine
    target: Vector
    objectives: tuple[Objective, ...]
    kept: tuple[float, ...]
    slack: float
    control: Control
    gravity: bool
    gain: float
    variables: tuple[DecisionVariable, ...]
    constraints: tuple[ScaledConstraint, ...]
    constraint_set: ConstraintSet | None
    asked: ConstraintsAsked
    assumed: tuple[Assumption, ...]
    travel: TravelCost | None
    objective_scales: tuple[float, ...]
    scan: Scan = field(repr=False)
    region: StartRegion = field(repr=False)
    present_base: Vector | None
    present_posture: Vector | None
    elbow: Elbow
    singularity_margin: float
    starts: int | None
    seed: int
    bounding: int = 0

    def __repr__(self) -> str:
        point = ", ".join(f"{x:g}" for x in self.target)
        return (
            f"SelectionProblem({self.machine.name!r}: {self.name} at ({point}) m, Jacobian {self.control} control, "
            f"{len(self.variables)} variables, {len(self.constraints)} constraints)"
        )

    @property
    def sought(self) -> tuple[Objective, ...]:
        """The objectives that are maximised, in order."""
        return self.objectives[self.bounding :]

    @property
    def first_scale(self) -> float:
        """Scale of the first of them."""
        return self.objective_scales[self.bounding]

    @property
    def measure_scale(self) -> float:
        """What differences of w_i are told by: the first objective's scale, where that is one of w_i."""
        first = self.sought[0]
        if not (first.has_kinks or first.own is not None) or not self.scan.factor.size:
            return self.first_scale
        return float(np.median(self.scan.factor)) or 1.0

    @property
    def quantities(self) -> Quantities:
        """The Functions that the objectives are made of."""
        return quantities(self.machine, self.control, self.gravity, self.gain)

    @property
    def measures(self) -> Measures:
        """The measures' Functions of this problem."""
        return self.quantities.measures

    @property
    def configuration(self) -> ConfigurationGraphs:
        """The graphs that the solver is made of."""
        return build_configuration(self.machine, self.control, self.gravity, self.constraint_set)

    @property
    def name(self) -> str:
        """Names of the objectives, in order."""
        return ",".join(objective.name for objective in self.sought)

    @property
    def objective(self) -> Objective:
        """The objective being solved: the first whose value is not kept."""
        return self.objectives[len(self.kept)]

    @property
    def objective_scale(self) -> float:
        """Scale of the objective being solved."""
        return self.objective_scales[len(self.kept)]

    @public(best=number("", low=-1e100, high=1e100))
    def given_up(self, best: float) -> float:
        """What the objective being solved, at most `best`, may give up for the next one, in V's unit.

        The share `slack` of |best|, or of the typical Σ αi |a_i||b_i| where that is more: the w_i are best at 0.

        Example:
            >>> machine = flexopt.load("excavator")
            >>> ordered = flexopt.build_selection(machine, (0.0, 1.6), objective="epsilon_max,w1", slack=1e-3)
            >>> round(ordered.given_up(0.38), 6)
            0.00038
        """
        return self.slack * max(abs(best), self.objective_scale - self.objective.beta)

    @property
    def bounded_by_zero(self) -> bool:
        """Whether no configuration can have V > 0: w_i ≤ 0 for two task rows and more, travel costs aside."""
        return not self.objective.has_kinks and self.objective.own is None and self.target.size > 1

    @property
    def lower(self) -> Vector:
        """Lower bounds of z."""
        return np.array([v.lower for v in self.variables])

    @property
    def upper(self) -> Vector:
        """Upper bounds of z."""
        return np.array([v.upper for v in self.variables])

    @property
    def scale(self) -> Vector:
        """Scales of z."""
        return np.array([v.scale for v in self.variables])

    @cached_property
    def row_bounds(self) -> tuple[Vector, Vector, Vector]:
        """Lower and upper bounds and scales of the constraints, (n_rows,) each."""
        lower, upper, scale = np.array([(row.lower, row.upper, row.scale) for row in self.constraints]).T
        return lower, upper, scale

    @property
    def constants(self) -> Vector:
        """The constraints' constants c."""
        return np.zeros(0) if self.constraint_set is None else self.constraint_set.constants.full().ravel()

    @property
    def shift(self) -> tuple[Vector, Vector]:
        """Shifts of z (n_z,) and of the target (n_task,), m, that put the target at the origin for IPOPT.

        Moving placement and target together changes nothing else, unless places in the inertial frame enter; far from
        the inertial origin the last digits of their difference would be lost.
        """
        of_z, of_target = np.zeros(len(self.variables)), np.zeros(self.target.size)
        placed = self.constraint_set is not None and self.constraint_set.placed
        if placed or any(objective.own is not None for objective in self.objectives):
            return of_z, of_target
        rows = self.machine.task_rows
        for k, name in enumerate(self.machine.base_coordinates):
            if name != "yaw" and name in rows:
                of_z[k] = of_target[rows.index(name)] = self.target[rows.index(name)]
        return of_z, of_target

    @public(sizes=_sizes, objective=_OBJECTIVE, z=array_of(("n_z",)), exact=flag)
    def branches(self, objective: Objective, z: Vector, *, exact: bool = False) -> tuple[Vector, Vector]:
        """V of an objective with each of the branches of ε_max, and gradients by z, as `Quantities.branches`.

        The cost of travel is taken off. `exact`: ε_max in extended precision.

        Example:
            >>> value, slope = problem.branches(problem.objective, [0.0, 0.9929, -2.6306])
            >>> value.shape, slope.shape
            ((1,), (1, 3))
        """
        n_base = len(self.machine.base_coordinates)
        values, gradients = self.quantities.branches(objective, z[:n_base], z[n_base:], exact=exact)
        cost, slope = self.travel_cost(objective, z)
        gradients = gradients.copy()
        gradients[: values.size] -= slope
        return values - cost, gradients

    @public(sizes=_sizes, z=array_of(("n_z",)))
    def factors(self, z: Vector) -> tuple[Vector, Vector, Vector]:
        """As `split_factors`, slopes by z; and of every mode how many have its frequency, (m,).

        Example:
            >>> factors, slopes, many = problem.factors([0.0, 0.9929, -2.6306])
            >>> many
            array([1., 1., 1.])
        """
        f, f_z, same = (out.full() for out in self.measures.factors.call(self.quantities.at(z)))
        return *split_factors(f, f_z), same.sum(axis=0)

    @public(sizes=_sizes, objective=_OBJECTIVE, z=_MANY)
    def travel_cost(self, objective: Objective, z: Vector) -> tuple[Vector, Vector]:
        """What V of an objective is less by at z (…, n_z), and its gradient.

        Example:
            >>> asked = {"travel": {"cost": 0.01, "base": 0.0, "posture": [0.9929, -2.6306]}}
            >>> near = flexopt.build_selection(flexopt.load("excavator"), (0.0, 1.6), constraints=asked)
            >>> cost, slope = near.travel_cost(near.objective, np.array([1.0, 0.9929, -2.6306]))
            >>> float(cost) > 0
            True
        """
        if self.travel is None or objective.bounds:
            return np.zeros(z.shape[:-1]), np.zeros(z.shape)
        size = self.travel.cost * self.objective_scales[self.objectives.index(objective)]
        away = (z - self.travel.now) / self.scale
        return size * np.sum(away**2, axis=-1), 2 * size * away / self.scale

    @property
    def turning(self) -> NDArray[np.bool_]:
        """Which entries of z are angles without limits, (n_z,): whole turns of theirs do not matter."""
        units = np.array((*self.machine.base_units, *self.machine.joint_units))
        free: NDArray[np.bool_] = ~np.isfinite(self.lower) & ~np.isfinite(self.upper)
        return free & (units == "rad")

    @public(sizes=_sizes, z=_MANY)
    def wrapped(self, z: Vector) -> Vector:
        """The same configurations (…, n_z) with unlimited angles within half a turn of the present ones, or of 0.

        Example:
            >>> problem.wrapped(np.array([0.0, 0.9929 + 2 * np.pi, -2.6306])).round(4)
            array([ 0.    ,  0.9929, -2.6306])
        """
        now = np.zeros(z.shape[-1]) if self.travel is None else self.travel.now
        away = (z - now + math.pi) % (2 * math.pi) - math.pi
        return np.where(self.turning, now + away, z)

    @public(sizes=_sizes, z=array_of(("n_z",)))
    def rows(self, z: Vector) -> Vector:
        """Values of all constraints, (n_rows,), in their units.

        Example:
            >>> problem.rows(np.array([0.0, 0.9929, -2.6306])).round(2).tolist()[1:]
            [1.6, 0.24]
        """
        return rows_with(self, z, self.measures.plant.parameter_values)

    @property
    def redundancy(self) -> int:
        """How many variables the target leaves free."""
        return int(np.sum(self.lower < self.upper)) - self.target.size

    @property
    def forms(self) -> tuple[ObjectiveForm, ...]:
        """What the objectives before the one being solved, and it, are made of."""
        objectives = self.objectives[: len(self.kept) + 1]
        return tuple(ObjectiveForm(smooth=any(o.alpha), kinks=o.has_kinks, own=o.own) for o in objectives)

    @property
    def own_constraints(self) -> tuple[ScaledConstraint, ...]:
        """The user's own, entry by entry."""
        sizes = {o.name: size for o, size in zip(self.objectives[: self.bounding], self.objective_scales, strict=False)}
        found = list[ScaledConstraint]()
        for constraint in self.asked.own or ():
            (low, high), names = constraint.bounds, entry_names(constraint)
            found += [ScaledConstraint(name, constraint.unit, low, high, sizes[name]) for name in names]
        return tuple(found)

    @public(sizes=_sizes, z=array_of(("n_z",)))
    def own_values(self, z: Vector) -> Vector:
        """The values of the user's own constraints at z, entry by entry.

        Example:
            >>> posture = ca.MX.sym("posture", 2)
            >>> flat = ca.Function("flat", [posture], [1 - posture[0]], ["posture"], ["g"])
            >>> bound = flexopt.build_selection(flexopt.load("excavator"), (0.0, 1.6), constraints=flat)
            >>> bound.own_values(np.array([0.0, 0.75, -2.0]))
            array([0.25])
        """
        return own_with(self, z, None)

    @public()
    def solver(self, *, quick: bool = False) -> ca.Function:
        """IPOPT on this problem: x = (z − shift) / scale, exact Hessian; its parameters: `solver_parameters`.

        Raises:
            InputError: ε_max takes part: it has kinks, which `flexopt.select` climbs without a solver.

        Example:
            >>> problem.solver().name_in()[:2]
            ['x0', 'p']
        """
        if any(form.kinks for form in self.forms):
            raise InputError("solver: objective: ε_max has kinks, which IPOPT is not told of; call flexopt.select")
        return build_solver(self.configuration, alone(self.scale.size), self.forms, "weighted", quick=quick)

    def solver_parameters(self) -> Vector:
        """The numbers of this problem for `solver`, see `member_graph.parameters_of`.

        Example:
            >>> problem.solver_parameters().ndim
            1
        """
        return packed_parameters((self,), alone(self.scale.size), np.ones(1), 0.0, self.shift)

    @property
    def stated(self) -> Document:
        """What was asked beside target and objective, as provenance has it."""
        places = self.variables[: len(self.machine.base_coordinates)]
        present = {"base": self.present_base, "posture": self.present_posture}
        return {
            "control": self.control,
            "gravity": self.gravity,
            "gain": self.gain,
            "constraints": self.asked.model_dump(exclude_none=True),
            "placements": {place.name: [place.lower, place.upper] for place in places},
            "singularity_margin": self.singularity_margin,
            **{name: None if value is None else value.tolist() for name, value in present.items()},
            "starts": self.starts,
            "seed": self.seed,
            "assumed": [vars(assumption) for assumption in self.assumed],
        }

    def to_dict(self) -> Document:
        """Target, objective, variables with bounds, constraints.

        Example:
            >>> problem.to_dict()["target"]
            [0.0, 1.6]
        """
        present = {"present_base": self.present_base, "present_posture": self.present_posture}
        return {
            "target": self.target.tolist(),
            "objective": self.name,
            "weights": self.sought[0].weights.tolist(),
            "slack": self.slack,
            "objective_scale": self.first_scale,
            "objectives": [
                {"name": objective.name, "weights": objective.weights.tolist(), "scale": size}
                for objective, size in zip(self.sought, self.objective_scales[self.bounding :], strict=True)
            ],
            "control": self.control,
            "gravity": self.gravity,
            "variables": [vars(v) for v in self.variables],
            "constraints": [vars(c) for c in self.constraints] + [vars(c) for c in self.own_constraints],
            "assumed": [vars(assumption) for assumption in self.assumed],
            "travel": self.travel and {"cost": self.travel.cost, "now": self.travel.now.tolist()},
            "gain": self.gain,
            "singularity_margin": self.singularity_margin,
            **{name: None if value is None else value.tolist() for name, value in present.items()},
            "starts": self.starts,
            "seed": self.seed,
            "scanned_points": self.scan.size,
        }


def value_at(problem: SelectionProblem, z: Vector, objective: Objective | None = None) -> float:
    """V of an objective at z, or of the one being solved; of ε_max the lower branch, the cost of travel taken off."""
    return float(problem.branches(objective or problem.objective, z)[0][0])


def elsewhere(problem: SelectionProblem, z: Vector) -> str:
    """Where a configuration that is not at the target holds the end-point; empty where it is there."""
    point = reached(problem, z)
    away = float(np.linalg.norm(point - problem.target))
    if away <= THERE:
        return ""
    told = f"not at the target but {away:.3g} m away{with_angles(problem.machine)}"
    return f"holds the end-point at ({', '.join(f'{x:.4g}' for x in point)}) m, {told}"


def with_angles(machine: AnyMachine) -> str:
    """That a distance in m counts task rows that are angles, in words; empty where none is."""
    angles = [row for row in machine.task_rows if row in ORIENTATION_ROWS]
    return f" ({listed(angles)} counted as angle times end_point.length)" if angles else ""


def reached(problem: SelectionProblem, z: Vector) -> Vector:
    """Where a configuration holds the end-point, (n_task,), m."""
    return problem.rows(z)[: problem.target.size]


def rows_with(problem: SelectionProblem, z: Vector, p: Any) -> Vector:
    """Values of all constraints, (n_rows,), of a machine with the numbers p (n_par,), held as `held_with` does."""
    return rows_held(problem, *held_with(problem.quantities, z, p), p)


def rows_held(problem: SelectionProblem, base: Vector, posture: Vector, p: Any) -> Vector:
    """The same of an arm that is held in a posture."""
    at = [base, posture, p]
    parts = [problem.measures.w.call(at)[2], problem.measures.plant.singularity_sine_squared.call(at)[0]]
    if problem.constraint_set is not None:
        parts += problem.constraint_set.function.call([*at, problem.constraint_set.constants])
    return np.concatenate([part.full().ravel() for part in parts])


def own_with(problem: SelectionProblem, z: Vector, p: Any) -> Vector:
    """The values of the user's own constraints at z, of a machine with the numbers p (n_par,); None: with its own."""
    return own_held(problem, *held_with(problem.quantities, z, p), p)


def own_held(problem: SelectionProblem, base: Vector, posture: Vector, p: Any) -> Vector:
    """The same of an arm that is held in a posture."""
    terms = [OwnTerm(constraint.function) for constraint in problem.asked.own or ()]
    found = [problem.quantities.of_own(term, base, posture, p).ravel() for term in terms]
    return np.concatenate([np.zeros(0), *found])


def packed_parameters(
    problems: tuple[SelectionProblem, ...],
    coupling: Coupling,
    share: Vector,
    level: float,
    shift: tuple[Vector, Vector],
) -> Vector:
    """The numbers of problems with the same machine, objective, scales and constraints, see `parameters_of`.

    `shift` of z and of the targets is as in `SelectionProblem.shift`.
    """
    first = problems[0]
    count, (of_z, of_target) = len(first.kept) + 1, shift
    objectives = first.objectives[:count]
    now = np.zeros(first.scale.size) if first.travel is None else (first.travel.now - of_z) / first.scale
    parts = {
        "target": np.concatenate([problem.target - of_target for problem in problems]),
        "row_scale": first.row_bounds[2],
        "z_scale": first.scale,
        "alpha": np.array([objective.alpha for objective in objectives]),
        "beta": [objective.beta for objective in objectives],
        "size": first.objective_scales[:count],
        "cost": [0.0 if first.travel is None or o.bounds else first.travel.cost for o in objectives],
        "now": now,
        "left": np.zeros(first.measures.plant.n_passive),
        "share": share,
        "level": level,
        "gain": first.gain,
        "c": first.constants,
        "p": first.measures.plant.parameter_values.full(),
    }
    return parameters_of(first.configuration, coupling, count).packed(parts).ravel()


def chosen_configuration(problem: SelectionProblem, z: Vector, loop: Loop | None = None) -> Configuration:
    """Return the configuration z = [base, posture] under the problem's control and weight."""
    n_base = problem.measures.plant.n_base
    return Configuration(problem.machine, z[n_base:], z[:n_base], problem.control, problem.gravity, loop)
