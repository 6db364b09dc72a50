"""Configuration problems solved together and proved from their equations.

In: one `SelectionProblem` for each target, of one machine and one set of constraints. Out: points x, and what they
violate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.selection.check import row_gradients
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.programs import Bounds, Local, run
from flexopt.selection.several.postures import value_of
from flexopt.selection.several.program import Goal, Joint, build_joint_solver, layout

TARGET_TOLERANCE = BOUND_TOLERANCE = 1e-8
# The interior point leaves a gap of about its barrier over the multiplier: more than 1e-6 where a multiplier is small.
ACTIVE_TOLERANCE = 1e-5
STATIONARITY_TOLERANCE = 1e-5
SOLVED = ("Solve_Succeeded", "Solved_To_Acceptable_Level")
# V this near to what no configuration exceeds, relative to its scale, is a maximum whatever its derivatives.
BEST_TOLERANCE = 1e-8


@dataclass(frozen=True)
class Joined:
    """Problems k = 1 … K over shared variables x, in units of z_scale.

    Attributes:
        problems: with the same machine, objective, scales and constraints; their targets differ.
        joint: how they share x.
        steps: greatest |x_j − x_i| for each of the pairs, ∞ where nothing bounds it.
        share: weights of the targets, (K,), their sum 1.
        goal: what is sought;  level: V_k / size that "motion" keeps.
        fixed: indices of x that stay where a start has them.
    """

    problems: tuple[SelectionProblem, ...]
    joint: Joint
    steps: Vector
    share: Vector
    goal: Goal
    level: float = 0.0
    fixed: tuple[int, ...] = ()

    @property
    def first(self) -> SelectionProblem:
        """The problem that scales and constraints are taken from."""
        return self.problems[0]

    @property
    def size(self) -> float:
        """What V is divided by."""
        return self.first.objective_scale

    def of(self, x: Vector, k: int) -> Vector:
        """Configuration k: its z."""
        return x[list(self.joint.places[k])] * self.first.scale

    def packed(self, zs: list[Vector]) -> Vector:
        """The x of one z for each configuration; what they share is taken from the last."""
        x = np.zeros(self.joint.n_x)
        for place, z in zip(self.joint.places, zs, strict=True):
            x[list(place)] = z / self.first.scale
        return x

    def bounds(self) -> tuple[Vector, Vector]:
        """Bounds of x (n_x,): the tightest of all configurations that share an entry."""
        lower, upper = np.full(self.joint.n_x, -np.inf), np.full(self.joint.n_x, np.inf)
        for place, problem in zip(self.joint.places, self.problems, strict=True):
            at = list(place)
            lower[at] = np.maximum(lower[at], problem.lower / self.first.scale)
            upper[at] = np.minimum(upper[at], problem.upper / self.first.scale)
        return lower, upper

    def values(self, x: Vector) -> Vector:
        """V_k (K,), the cost of travel taken off."""
        return value_of(self.first, np.array([self.of(x, k) for k in range(self.joint.count)]).T)

    def worth(self, x: Vector) -> float:
        """What is maximised: the worst V_k, or Σ share_k V_k."""
        values = self.values(x)
        return float(self.share @ values) if self.goal == "weighted" else float(values.min())

    def length(self, x: Vector) -> float:
        """What "motion" makes smallest: Σ (x_j − x_i)² over the pairs."""
        return float(sum((x[j] - x[i]) ** 2 for i, j in self.joint.pairs))

    def unwound(self, x: Vector) -> Vector:
        """The same way, all of it turned by whole turns so that it begins within half a turn of the present angles."""
        turns = self.first.wrapped(self.of(x, 0)) - self.of(x, 0)
        return self.packed([self.of(x, k) + turns for k in range(self.joint.count)])

    def solve(self, start: Vector) -> tuple[Vector, int, str]:
        """The point that IPOPT reaches from x = start, its iterations and its status."""
        solver = build_joint_solver(self.first.configuration, self.joint, self.goal)
        lower, upper = self.bounds()
        x0 = np.clip(start, lower, upper)
        for i in self.fixed:
            lower[i] = upper[i] = x0[i] = start[i]
        rows = self.first.constraints[self.first.target.size :]
        none = np.zeros(self.first.target.size)
        at_least = np.tile(np.concatenate([none, [row.lower / row.scale for row in rows]]), self.joint.count)
        at_most = np.tile(np.concatenate([none, [row.upper / row.scale for row in rows]]), self.joint.count)
        more = 0 if self.goal == "weighted" else self.joint.count
        if self.goal == "worst":
            x0 = np.append(x0, self.values(x0).min() / self.size)
            lower, upper = np.append(lower, -np.inf), np.append(upper, np.inf)
        bounds = Bounds(
            lower,
            upper,
            np.concatenate([at_least, -self.steps, np.zeros(more)]),
            np.concatenate([at_most, self.steps, np.full(more, np.inf)]),
        )
        reached = run(solver, self._stated, x0, self._parameters(), bounds)
        x = reached.x[: self.joint.n_x]
        if not self.joint.pairs:
            x = self.packed(list(self.first.wrapped(np.array([self.of(x, k) for k in range(self.joint.count)]))))
        return np.clip(x, *self.bounds()), reached.iterations, reached.status

    def _stated(self, x: Vector) -> Local:
        """The program that IPOPT climbs, at its x, by functions that it does not use."""
        n_x, scales = self.joint.n_x, np.array([row.scale for row in self.first.constraints])
        values, steps = self.values(x[:n_x]) / self.size, np.zeros((len(self.joint.pairs), n_x))
        for row, (i, j) in enumerate(self.joint.pairs):
            steps[row, i], steps[row, j] = -1.0, 1.0
        g: list[Vector] = []
        jacobian: list[Vector] = []
        for k, problem in enumerate(self.problems):
            z, slopes = self.of(x, k), np.zeros((scales.size, n_x))
            wanted = np.concatenate([problem.target, np.zeros(scales.size - problem.target.size)])
            slopes[:, list(self.joint.places[k])] = row_gradients(problem, z) * self.first.scale / scales[:, None]
            g.append((problem.rows(z) - wanted) / scales)
            jacobian.append(slopes)
        of_values = np.array([self._value_gradient(x, k) for k in range(self.joint.count)])
        g, jacobian = [*g, steps @ x[:n_x]], [*jacobian, steps]
        if self.goal == "weighted":
            return Local(-float(self.share @ values), -self.share @ of_values, np.concatenate(g), np.vstack(jacobian))
        level = float(x[-1]) if self.goal == "worst" else self.level
        g, every = [*g, values - level], np.vstack([*jacobian, of_values])
        if self.goal == "motion":
            away = steps @ x
            return Local(float(away @ away) / 2, steps.T @ away, np.concatenate(g), every)
        of_level = np.concatenate([np.zeros(len(every) - values.size), np.full(values.size, -1.0)])
        down = np.append(np.zeros(n_x), -1.0)
        return Local(-level, down, np.concatenate(g), np.column_stack([every, of_level]))

    def _parameters(self) -> Vector:
        first = self.first
        set_of = first.constraint_set
        return layout(first.configuration, self.joint).packed(
            {
                "target": np.concatenate([problem.target for problem in self.problems]),
                "share": self.share,
                "row_scale": [constraint.scale for constraint in first.constraints],
                "z_scale": first.scale,
                "alpha": first.objective.alpha,
                "size": self.size,
                "cost": 0.0 if first.travel is None else first.travel.cost,
                "now": np.zeros(first.scale.size) if first.travel is None else first.travel.now / first.scale,
                "level": self.level,
                "c": np.zeros(0) if set_of is None else set_of.constants.full(),
                "p": first.measures.plant.parameter_values.full(),
            }
        )

    def violations(self, x: Vector) -> dict[str, float]:
        """What is violated beyond its tolerance, in its unit: bounds, every row of every configuration, steps."""
        found: dict[str, float] = {}
        for k, problem in enumerate(self.problems):
            z, where = self.of(x, k), f"target {k + 1}: "
            for number, (row, value) in enumerate(zip(problem.constraints, problem.rows(z), strict=True)):
                tolerance = TARGET_TOLERANCE if number < problem.target.size else BOUND_TOLERANCE * row.scale
                _note(found, where + row.name, max(row.lower - value, value - row.upper), tolerance)
            for variable, value in zip(problem.variables, z, strict=True):
                beyond = max(variable.lower - value, value - variable.upper)
                _note(found, f"{where}{variable.name} range", beyond, BOUND_TOLERANCE)
        for (i, j), limit in zip(self.joint.pairs, self.steps, strict=True):
            _note(found, "steps between targets", abs(x[j] - x[i]) - limit, BOUND_TOLERANCE)
        return found

    def stationarity(self, x: Vector) -> float:
        """Norm of what multipliers of the right signs leave of the objective's gradient, relative to its scale.

        The problem is seen to first order: V_k, rows, steps and bounds that are active.
        """
        from scipy.optimize import lsq_linear  # noqa: PLC0415  (slow to import)

        n_x = self.joint.n_x
        values = self.values(x) / self.size
        if self.first.bounded_by_zero and self.goal != "motion" and -self.worth(x) / self.size <= BEST_TOLERANCE:
            return 0.0
        gradients = np.array([self._value_gradient(x, k) for k in range(self.joint.count)])
        equal, active = self._active(x)
        if self.goal == "weighted":
            goal = self.share @ gradients
        elif self.goal == "worst":
            # In (x, t): maximise t below every V_k.
            near = gradients[values <= values.min() + ACTIVE_TOLERANCE]
            active = [np.append(row, 0.0) for row in active] + [np.append(row, -1.0) for row in near]
            equal = [np.append(row, 0.0) for row in equal]
            goal = np.append(np.zeros(n_x), 1.0)
        else:
            active += list(gradients[values <= self.level + ACTIVE_TOLERANCE])
            differences = np.zeros(n_x)
            for i, j in self.joint.pairs:
                differences[j] += x[j] - x[i]
                differences[i] -= x[j] - x[i]
            goal = -differences
        rows = np.array([*equal, *active]).reshape(-1, goal.size)
        # goal + Σ μ_i c_i + Σ λ_j e_j = 0 with μ ≥ 0 for constraints c ≥ 0.
        low = np.concatenate([np.full(len(equal), -np.inf), np.zeros(len(active))])
        if not rows.size:
            return float(np.linalg.norm(goal))
        fit = lsq_linear(rows.T, -goal, bounds=(low, np.full(low.size, np.inf)), tol=1e-14, lsmr_tol="auto")
        return float(np.linalg.norm(rows.T @ fit.x + goal))

    def _value_gradient(self, x: Vector, k: int) -> Vector:
        gradient = np.zeros(self.joint.n_x)
        slope = self.problems[k].branches(self.first.objective, self.of(x, k))[1][0]
        gradient[list(self.joint.places[k])] = slope * self.first.scale / self.size
        return gradient

    def _active(self, x: Vector) -> tuple[list[Vector], list[Vector]]:
        """Gradients of the equalities, and of the active inequalities c ≥ 0, by x."""
        equal: list[Vector] = []
        active: list[Vector] = []
        for k, problem in enumerate(self.problems):
            z = self.of(x, k)
            slopes = row_gradients(problem, z) * self.first.scale
            for row, value, slope in zip(problem.constraints, problem.rows(z), slopes, strict=True):
                whole = np.zeros(self.joint.n_x)
                whole[list(self.joint.places[k])] = slope / row.scale
                if row.lower == row.upper:
                    equal.append(whole)
                    continue
                near = ACTIVE_TOLERANCE * row.scale
                active += [whole] if value - row.lower <= near else []
                active += [-whole] if row.upper - value <= near else []
        identity = np.eye(self.joint.n_x)
        lower, upper = self.bounds()
        for i in range(self.joint.n_x):
            if lower[i] == upper[i] or i in self.fixed:
                equal.append(identity[i])
                continue
            active += [identity[i]] if x[i] - lower[i] <= ACTIVE_TOLERANCE else []
            active += [-identity[i]] if upper[i] - x[i] <= ACTIVE_TOLERANCE else []
        for (i, j), limit in zip(self.joint.pairs, self.steps, strict=True):
            step = identity[j] - identity[i]
            if limit == 0.0:
                equal.append(step)
                continue
            active += [-step] if limit - (x[j] - x[i]) <= ACTIVE_TOLERANCE else []
            active += [step] if limit + (x[j] - x[i]) <= ACTIVE_TOLERANCE else []
        return equal, active

    def kept(self, level: float) -> Joined:
        """The problem of the shortest way that keeps every V_k / size at the level."""
        return replace(self, goal="motion", level=level)


def _note(found: dict[str, float], name: str, beyond: float, tolerance: float) -> None:
    if not beyond <= tolerance:
        found[name] = max(float(beyond), found.get(name, 0.0))
