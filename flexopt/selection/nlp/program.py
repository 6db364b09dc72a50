"""Configurations chosen together, one or many, as one program: its variables, bounds and values, and its solves.

In: one `SelectionProblem` for each configuration, of one machine and one set of constraints. Out: points x, which hold
the z of every configuration, and what they share once; the program there by functions that no solver uses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import casadi as ca
import numpy as np

from flexopt.compiled.cost import compilation_seconds, evaluation_seconds
from flexopt.foundation.arrays import Vector
from flexopt.foundation.kept import by_structure
from flexopt.model import AnyMachine
from flexopt.selection.ascent.member import AscentMember
from flexopt.selection.ascent.steps import STUCK, Ascent
from flexopt.selection.cones import Parallel
from flexopt.selection.constraints.kind import ScaledConstraint
from flexopt.selection.nlp.assembly import Goal, build_branched, build_solver, told_branches
from flexopt.selection.nlp.configuration import ConstraintRows
from flexopt.selection.nlp.coupling import Coupling, alone, widened
from flexopt.selection.nlp.member_graph import parameters_of
from flexopt.selection.nlp.solvers import Bounds, Local, confirm_once, run
from flexopt.selection.objective import Objective
from flexopt.selection.problem import SelectionProblem, packed_parameters

# Steps of an ascent; one that takes longer is taken up again where it is ahead of the best.
ASCENT_QUICK, ASCENT_LONG = 15, 60
# Points right beside each other, in scaled variables, over which ε_max differs by rounding alone.
NOISE_POINTS, NOISE_STEP = 4, 1e-11
# Starts of a problem that leaves their number open, where work is estimated.
STARTS_COUNTED = 64
SOLVED = ("Solve_Succeeded", "Solved_To_Acceptable_Level")


@dataclass(frozen=True)
class Linearisation:
    """A configuration of a program, by z / scale.

    Attributes:
        rows, row_slopes: (row − target) / scale of every constraint (n_rows,), and slopes (n_rows, n_z).
        values, slopes: V / size of each objective up to the one being solved, less travel, its branches, and slopes, as
            `SelectionProblem.branches`.
    """

    rows: Vector
    row_slopes: Vector
    values: list[Vector]
    slopes: list[Vector]


@dataclass(frozen=True)
class Program:
    """Problems k = 1 … K over shared variables x.

    Attributes:
        problems: with the same machine, objectives, scales and constraints; their targets differ.
        coupling: how they share x.
        steps: greatest |x_j − x_i| / scale for each of the pairs, ∞ where nothing bounds it.
        share: weights of the configurations, (K,), their sum 1.
        goal: what is sought;  level: V_k / size that "motion" keeps.
        fixed: indices of x that stay where a start has them.
        exact: whether ε_max is told in extended precision where solvers do not ask: ten times as dear.
    """

    problems: tuple[SelectionProblem, ...]
    coupling: Coupling
    steps: Vector
    share: Vector
    goal: Goal
    level: float = 0.0
    fixed: tuple[int, ...] = ()
    exact: bool = False

    @property
    def first(self) -> SelectionProblem:
        """The problem that scales and constraints are taken from."""
        return self.problems[0]

    @property
    def size(self) -> float:
        """What V is divided by."""
        return self.first.objective_scale

    @cached_property
    def scale(self) -> Vector:
        """Scales of x, (n_x,)."""
        return self._spread(self.first.scale)

    @cached_property
    def names(self) -> list[str]:
        """Names of the entries of x."""
        names = [""] * self.coupling.n_x
        for k, place in enumerate(self.coupling.places):
            for i, variable in zip(place, self.first.variables, strict=True):
                names[i] = self.prefix(k) + variable.name
        return names

    def prefix(self, k: int) -> str:
        """What stands before a name of configuration k; nothing where there is one configuration."""
        return f"target {k + 1}: " if self.coupling.count > 1 else ""

    def of(self, x: Vector, k: int) -> Vector:
        """The z of configuration k."""
        return x[list(self.coupling.places[k])]

    def packed(self, zs: Sequence[Vector]) -> Vector:
        """The x of one z for each configuration; what they share is taken from the last."""
        x = np.zeros(self.coupling.n_x)
        for place, z in zip(self.coupling.places, zs, strict=True):
            x[list(place)] = z
        return x

    @property
    def shift(self) -> tuple[Vector, Vector]:
        """Shift of z and of the targets to the origin: that of a single problem; none where several share variables."""
        of_z, of_target = self.first.shift
        return (of_z, of_target) if self.coupling.count == 1 else (0 * of_z, 0 * of_target)

    def _spread(self, of_z: Vector) -> Vector:
        return self.packed([of_z] * self.coupling.count)

    def bounds(self) -> tuple[Vector, Vector]:
        """Bounds of x (n_x,): the tightest of all configurations that share an entry."""
        lower, upper = np.full(self.coupling.n_x, -np.inf), np.full(self.coupling.n_x, np.inf)
        for place, problem in zip(self.coupling.places, self.problems, strict=True):
            at = list(place)
            lower[at], upper[at] = np.maximum(lower[at], problem.lower), np.minimum(upper[at], problem.upper)
        return lower, upper

    def constraints(self) -> list[ScaledConstraint]:
        """Every constraint in the solver's order, with bounds of what the solver sees."""
        n_task, found = self.first.target.size, list[ScaledConstraint]()
        for k in range(self.coupling.count):
            for number, row in enumerate(self.first.constraints):
                ends = (0.0, 0.0) if number < n_task else (row.lower / row.scale, row.upper / row.scale)
                found.append(ScaledConstraint(self.prefix(k) + row.name, row.unit, *ends, row.scale))
        found += [ScaledConstraint("steps between targets", "", -step, step, 1.0) for step in self.steps.tolist()]
        earlier = zip(self.first.objectives, self.first.kept, self.first.objective_scales, strict=False)
        for objective, kept, size in earlier:
            found += [ScaledConstraint(objective.label, "", kept / size, np.inf, size)] * self.coupling.count
        if self.goal != "weighted":
            found += [
                ScaledConstraint(f"least {self.first.objective.name}", "", 0.0, np.inf, self.size)
            ] * self.coupling.count
        return found

    def values(self, x: Vector) -> Vector:
        """V_k (K,), of ε_max the lower branch, the cost of travel taken off."""
        zs = [self.of(x, k) for k in range(self.coupling.count)]
        if self.first.objective.has_kinks:
            return np.array([p.branches(p.objective, z)[0][0] for p, z in zip(self.problems, zs, strict=True)])
        return values_of(self.first, np.array(zs).T)

    def worth(self, x: Vector) -> float:
        """What is maximised: the worst V_k, or Σ share_k V_k."""
        values = self.values(x)
        return float(self.share @ values) if self.goal == "weighted" else float(values.min())

    def solve(self, start: Vector, *, quick: bool = False, within: float = np.inf) -> tuple[Vector, int, str]:
        """One solve from x = start: the point reached, iterations, and the solver's own status.

        `within` limits how far it leads, in scaled variables.
        """
        first, start = self.first, np.clip(start, *self.bounds())
        if any(form.kinks for form in first.forms):
            return self.climbed(start, ASCENT_QUICK if quick else ASCENT_LONG, within) or (start, 0, STUCK)
        solver = build_solver(first.configuration, self.coupling, first.forms, self.goal, quick=quick)
        x0, lower, upper = self._limits(start, within)
        if self.goal == "worst":
            x0 = np.append(x0, self.values(start).min() / self.size)
            lower, upper = np.append(lower, -np.inf), np.append(upper, np.inf)
        rows = self.constraints()
        bounds = Bounds(lower, upper, np.array([row.lower for row in rows]), np.array([row.upper for row in rows]))
        x, iterations, status = run(solver, self._stated, x0, self.parameters(), bounds)
        return self.told(x[: self.coupling.n_x]), iterations, status

    def build(self) -> None:
        """Build the graphs that solves from many starts use: processes that are forked then inherit them."""
        first = self.first
        build_branched(first.configuration, first.forms, compiled=self._compiles)
        if not any(form.kinks for form in first.forms):
            build_solver(first.configuration, self.coupling, first.forms, self.goal, quick=True)

    def climbed(
        self,
        start: Vector,
        steps: int,
        within: float = np.inf,
        *,
        sought: int = 1,
        parallel: Parallel | None = None,
    ) -> tuple[Vector, int, str] | None:
        """`solve` by an ascent of so many steps; None where no constraints are near the start.

        Of one configuration, `sought`: of how many objectives, up to the one being solved, the smallest is climbed,
        each in its own scale;  `parallel`: what is kept, too.
        """
        ascent, x0 = self.ascent(start, within, sought=sought, parallel=parallel)
        found = ascent.climbed(x0, steps)
        if found is None:
            return None
        x, iterations, status = found
        return self.told(x), iterations, status

    def told(self, x: Vector) -> Vector:
        """The point of a solver's or an ascent's x, within the bounds."""
        x = x * self.scale + self._spread(self.shift[0])
        if not self.coupling.pairs:
            x = self.packed(list(self.first.wrapped(np.array([self.of(x, k) for k in range(self.coupling.count)]))))
        return np.clip(x, *self.bounds())

    def ascent(
        self, start: Vector, within: float = np.inf, *, sought: int = 1, parallel: Parallel | None = None
    ) -> tuple[Ascent, Vector]:
        """What `climbed` climbs by, and the start in its variables."""
        x0, lower, upper = self._limits(start, within)
        x0 = np.clip(x0, lower, upper)
        rows = self.constraints()[: len(self.first.constraints) * self.coupling.count + len(self.coupling.pairs)]
        further = np.zeros(0) if parallel is None else parallel.upper
        bounds = Bounds(
            lower,
            upper,
            np.append([row.lower for row in rows], np.zeros(further.size)),
            np.append([row.upper for row in rows], further),
        )
        members = tuple(self._member(k, x0, bounds, parallel) for k in range(self.coupling.count))
        mix, least = self._mixed(sought)
        noise, kinks, margin = 0.0, members[0].kinks[:-sought], members[0].functions.margin
        if kinks.any() and margin is not None:
            noise = float(kinks.max()) * margin_noise(self.first, margin, x0 * self.scale)
        steps, motion = self.coupling.steps(self.coupling.n_x), self.goal == "motion"
        return Ascent(members, mix, least, bounds, steps, motion, noise, len(mix) - len(least)), x0

    def _limits(self, start: Vector, within: float) -> tuple[Vector, Vector, Vector]:
        """A start and the bounds as solvers have them: no further away than `within`, what is fixed at the start."""
        shift = self._spread(self.shift[0])
        x0, lower, upper = ((end - shift) / self.scale for end in (start, *self.bounds()))
        lower, upper = np.maximum(lower, x0 - within), np.minimum(upper, x0 + within)
        held = list(self.fixed)
        lower[held] = upper[held] = x0[held]
        return x0, lower, upper

    def _mixed(self, sought: int) -> tuple[Vector, Vector]:
        """The sums of V_jk / size that are kept and then sought, (o, j, k), and how much is kept; see `Ascent`."""
        first, count, n_k = self.first, len(self.first.kept) + 1, self.coupling.count
        each = np.eye(count * n_k).reshape(count * n_k, count, n_k)
        before = (count - sought) * n_k
        kept = np.array(first.kept[: count - sought]) / np.array(first.objective_scales[: count - sought])
        least = np.repeat(kept, n_k)
        if self.goal == "motion":
            return np.concatenate([each, np.zeros((1, count, n_k))]), np.append(least, np.full(n_k, self.level))
        if self.goal == "worst":
            return each, least
        return np.concatenate([each[:before], np.eye(count)[-sought:, :, None] * self.share]), least

    def _member(self, k: int, x0: Vector, bounds: Bounds, parallel: Parallel | None) -> AscentMember:
        """Configuration k for an ascent from x0, whose slopes are confirmed there."""
        problem, place, shift = self.problems[k], self.coupling.places[k], self.shift
        own, count = list(place), len(problem.kept) + 1
        functions = build_branched(problem.configuration, problem.forms, compiled=self._compiles)
        parameters = packed_parameters((problem,), alone(len(place)), np.ones(1), 0.0, shift)
        objectives, sizes = problem.objectives[:count], np.array(problem.objective_scales[:count])
        scale = problem.scale

        def margin(x: Vector) -> Vector:
            # As the model is told z, without its shift.
            assert functions.margin is not None, "asked for without ε_max"
            at = problem.quantities.at(x[own] * scale)
            slopes: Vector = functions.margin.call([*at, problem.gain])[1].full()
            return slopes * scale

        def independent(x: Vector) -> Local:
            return _branched_local(self.linear_of(k, x * scale + shift[0]))

        limits = Bounds(bounds.x_lower[own], bounds.x_upper[own], bounds.g_lower, bounds.g_upper)
        given = partial(told_branches, functions, parameters)
        confirm_once(functions.model, parameters, given, independent, x0[own], limits)
        left = parameters_of(problem.configuration, alone(len(place)), count).slices["left"]

        def without(modes: list[int]) -> Vector:
            changed = parameters.copy()
            changed[left][modes] = 1.0
            return changed

        alphas = np.array([objective.alpha for objective in objectives]) / sizes[:, None]
        kinks = np.array([objective.beta for objective in objectives]) / sizes
        return AscentMember(functions, place, parameters, alphas, without, kinks, margin, parallel)

    @cached_property
    def _compiles(self) -> bool:
        """Whether ascents cost more than to compile ε_max: by counts, so that results do not depend on the moment."""
        first = self.first
        if first.redundancy < 2 or not any(form.kinks for form in first.forms):
            return False
        margin = first.quantities.margin
        calls = (first.starts or STARTS_COUNTED) * ASCENT_QUICK * (first.redundancy + 2)
        return calls * evaluation_seconds(margin.gradients) > compilation_seconds(margin.compacted.gradients)

    def parameters(self) -> Vector:
        """The numbers of this program for its solver, see `parameters_of`."""
        return packed_parameters(self.problems, self.coupling, self.share, self.level, self.shift)

    def _stated(self, x: Vector) -> Local:
        """Objective and constraints of the solver's program at the solver's x, with slopes."""
        there = x[: self.coupling.n_x] * self.scale + self._spread(self.shift[0])
        return self.local(there, self.linear(there), float(x[-1]))

    def linear(self, x: Vector) -> list[Linearisation]:
        """Objectives and constraints of every configuration at x, with slopes, by functions that no solver uses."""
        return [self.linear_of(k, self.of(x, k)) for k in range(self.coupling.count)]

    def linear_of(self, k: int, z: Vector) -> Linearisation:
        """Objectives and constraints of configuration k at z, with slopes."""
        problem, scale = self.problems[k], self.first.row_bounds[2]
        wanted = np.append(problem.target, np.zeros(scale.size - problem.target.size))
        return Linearisation((problem.rows(z) - wanted) / scale, *self.slopes_of(k, z))

    def slopes_of(self, k: int, z: Vector) -> tuple[Vector, list[Vector], list[Vector]]:
        """Slopes of the constraints, values and slopes of the objectives, as `Linearisation` has them."""
        problem, scale = self.problems[k], self.first.scale
        count = len(problem.kept) + 1
        found = [problem.branches(objective, z, exact=self.exact) for objective in problem.objectives[:count]]
        sizes = problem.objective_scales[:count]
        return (
            row_gradients(problem, z) / self.first.row_bounds[2][:, None] * scale,
            [values / size for (values, _), size in zip(found, sizes, strict=True)],
            [slopes / size * scale for (_, slopes), size in zip(found, sizes, strict=True)],
        )

    def local(self, x: Vector, members: Sequence[Linearisation], level: float) -> Local:
        """Objective and constraints at x, slopes by x / scale and, for "worst", by t, last; `members` from `linear`.

        Of V's branches the smallest one.
        """
        n_x, places = self.coupling.n_x, self.coupling.places
        steps = self.coupling.steps(n_x)
        kept: list[tuple[Vector, Vector]] = []
        last: list[tuple[Vector, Vector]] = []
        for j in range(len(members[0].values)):
            for member, place in zip(members, places, strict=True):
                ours = kept if j < len(members[0].values) - 1 else last
                ours.append((member.values[j][:1], widened(member.slopes[j][:1], place, n_x)))
        g = [*(member.rows for member in members), steps @ (x / self.scale), *(values for values, _ in kept)]
        of_rows = (widened(m.row_slopes, place, n_x) for m, place in zip(members, places, strict=True))
        jacobian = [*of_rows, steps, *(slopes for _, slopes in kept)]
        values, slopes = (np.concatenate(part) for part in zip(*last, strict=True))
        if self.goal == "weighted":
            return Local(-float(self.share @ values), -self.share @ slopes, np.concatenate(g), np.vstack(jacobian))
        above = values - (level if self.goal == "worst" else self.level)
        g, jacobian = np.concatenate([*g, above]), np.vstack([*jacobian, slopes])
        if self.goal == "motion":
            away = steps @ (x / self.scale)
            return Local(float(away @ away) / 2, steps.T @ away, g, jacobian)
        of_level = np.concatenate([np.zeros(len(jacobian) - values.size), np.full(values.size, -1.0)])
        return Local(-level, np.append(np.zeros(n_x), -1.0), g, np.column_stack([jacobian, of_level]))

    def length(self, x: Vector) -> float:
        """What "motion" makes smallest: Σ (x_j − x_i)² over the pairs, in scaled variables."""
        return float(np.sum((self.coupling.steps(self.coupling.n_x) @ (x / self.scale)) ** 2))

    def unwound(self, x: Vector) -> Vector:
        """The same way, unlimited angles shifted by whole turns so that it begins nearest to the present ones."""
        turns = self.first.wrapped(self.of(x, 0)) - self.of(x, 0)
        return self.packed([self.of(x, k) + turns for k in range(self.coupling.count)])

    def without_modes(self, modes: set[int]) -> Program:
        """The program with the w_i of these modes left out of every objective."""
        if not modes:
            return self

        def left(objective: Objective) -> Objective:
            own = objective.own and replace(objective.own, left=tuple(sorted(modes)))
            alpha = tuple(0.0 if i in modes else a for i, a in enumerate(objective.alpha))
            return replace(objective, alpha=alpha, own=own)

        objectives = tuple(left(objective) for objective in self.first.objectives)
        return replace(self, problems=tuple(replace(problem, objectives=objectives) for problem in self.problems))

    def kept(self, level: float) -> Program:
        """The program of the shortest way on which every V_k / size is at least the level."""
        return replace(self, goal="motion", level=level)


def single(problem: SelectionProblem) -> Program:
    """The program of one configuration."""
    return Program((problem,), alone(problem.scale.size), np.zeros(0), np.ones(1), "weighted")


def margin_noise(problem: SelectionProblem, margin: ca.Function, z: Vector) -> float:
    """How much ε_max differs between points at z that are one but for rounding; `margin` is as `Margin.values`."""
    near = [problem.quantities.at(z + NOISE_STEP * k * problem.scale) for k in range(NOISE_POINTS)]
    epsilon = [float(margin.call([*at, problem.gain])[0][0]) for at in near]
    return max(epsilon) - min(epsilon)


def values_of(problem: SelectionProblem, z: Vector) -> Vector:
    """V (N,) of configurations z (n_z, N) without ε_max, the cost of travel taken off."""
    base, posture, _ = problem.quantities.at(z)
    values = problem.quantities.smooth(problem.objective, base, posture, problem.quantities.w_at(z))
    return values - problem.travel_cost(problem.objective, z.T)[0]


def _branched_local(member: Linearisation) -> Local:
    """One configuration as `told_branches` has it."""
    *kept, last = member.values
    g = [member.rows, *kept, last[1:]]
    before = zip(member.slopes, [*kept, last], strict=True)
    *kept_slopes, last_slopes = (slopes[: values.size] for slopes, values in before)
    jacobian = [member.row_slopes, *kept_slopes, last_slopes[1:]]
    return Local(float(last[0]), last_slopes[0], np.concatenate(g), np.vstack(jacobian))


@by_structure
def _extra_slopes(machine: AnyMachine, rows: ConstraintRows) -> ca.Function:  # noqa: ARG001 - with the rows a key
    """(base, posture, p, c) -> derivatives of the constraint rows by z, (k, n_z)."""
    f = rows.function
    base, posture, p, c = (ca.SX.sym(name, f.size1_in(k)) for k, name in enumerate(f.name_in()))
    slopes = ca.jacobian(f.call([base, posture, p, c])[0], ca.vertcat(base, posture))
    return ca.Function("constraint_slopes", [base, posture, p, c], [ca.densify(slopes)])


def row_gradients(problem: SelectionProblem, z: Vector) -> Vector:
    """Derivatives of all constraints by z, (n_rows, n_z), in their units."""
    at, measures = problem.quantities.at(z), problem.measures
    parts = [measures.end_point_gradient.call(at)[0], measures.plant.singularity_gradient.call(at)[0]]
    if problem.constraint_set is not None:
        extra = ConstraintRows(problem.constraint_set.structure, problem.constraint_set.function)
        slopes = _extra_slopes(problem.machine, extra)
        parts += slopes.call([*at, problem.constraint_set.constants])
    return np.vstack([part.full() for part in parts])
