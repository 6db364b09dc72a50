"""Several objectives in order where the later ones are hard to solve: second answers, refusals, no better point near."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

import flexopt
from flexopt.errors import NoSolutionFound
from flexopt.selection import optima
from flexopt.selection.nlp.program import Program, single
from flexopt.selection.proof.check import prove
from flexopt.selection.starts import starting_points

# Machine, target, objectives: solves from the optima of the objective before end in a saddle's alarm or nowhere.
HARD = {
    "derivatives that jump": ("slewing-excavator", [5.335, 1.429, 5.53], "w1,V"),
    "a narrow valley": ("mobile-manipulator", [-0.445, -0.072, 0.555], "w1,w2,V"),
}


def selected(name: str):
    machine, target, objective = HARD[name]
    loaded = flexopt.load(machine)
    weights = [1.0] * flexopt.build_plant(loaded).n_passive
    return flexopt.select(loaded, target, objective=objective, weights=weights, workers=1)


def test_no_solver_is_built_ahead_of_what_it_cannot_solve() -> None:
    problem = flexopt.build_selection(flexopt.load("excavator"), (0.0, 1.6), objective="epsilon_max")
    program = single(problem)
    program.build()
    assert program.solve(starting_points(problem)[0], quick=True)[1] > 0


@pytest.mark.long("epsilon_max")
@pytest.mark.parametrize("last", ["w2", "epsilon_max"])
def test_what_the_last_objective_decided_was_no_tie(last: str) -> None:
    """All candidates have w1 = 0; those behind the best have less of the last objective."""
    found = flexopt.select(flexopt.load("excavator"), (0.0, 1.6), objective=f"w1,{last}", starts=8, workers=1)
    size, (_, objective) = found.problem.objective_scales[0], found.problem.sought
    values = [float(found.problem.branches(objective, candidate.z)[0][0]) for candidate in found.candidates]
    assert max(candidate.objective for candidate in found.candidates) < found.best.objective + 1e-9 * size
    assert values[1] < values[0] - 1e-8 * found.problem.objective_scale
    assert found.decided_by == ""
    twice = replace(found, candidates=(found.best, *found.candidates))
    assert twice.decided_by.startswith("among those as good")


@pytest.mark.long
@pytest.mark.parametrize("name", ["slewing-excavator", "truck-crane"])
def test_the_margin_follows_in_space(name: str) -> None:
    """IPOPT solves for no ε_max, nor are its graphs built ahead for it."""
    machine = flexopt.load(name)
    found = flexopt.select(machine, (7.0, 1.0, 2.5), objective="w1,epsilon_max", starts=1, base=[0.0] * 3)
    first = flexopt.select(machine, (7.0, 1.0, 2.5), objective="w1", starts=1, base=[0.0] * 3)
    scale = first.problem.objective_scale
    assert found.best.w[0] >= found.kept[0].at_least - 1e-9 * scale
    assert found.kept[0].best == pytest.approx(first.best.objective, abs=1e-6 * scale)
    e = found.best.evaluation
    again = flexopt.evaluate(machine, e.posture, base=e.base).epsilon_max
    assert found.best.objective == pytest.approx(again, rel=1e-9) or e.epsilon_max == pytest.approx(again, rel=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("name", list(HARD))
def test_a_later_objective_is_solved_and_no_point_nearby_is_better(name: str) -> None:
    found = selected(name)
    problem = found.problem
    assert problem.name == HARD[name][2]
    best, scales = found.best, problem.objective_scales
    earlier, last = list(zip(problem.objectives[:-1], scales[:-1], strict=True)), problem.objectives[-1]
    firsts = [problem.branches(objective, best.z)[0][0] / size for objective, size in earlier]

    def value(x: np.ndarray, which, size: float) -> float:
        return float(problem.branches(which, x * problem.scale)[0][0]) / size

    def slope(x: np.ndarray, which, size: float) -> np.ndarray:
        return problem.branches(which, x * problem.scale)[1][0] * problem.scale / size

    n_task = problem.target.size
    constraints = [{"type": "eq", "fun": lambda x: problem.rows(x * problem.scale)[:n_task] - problem.target}]
    for (objective, size), first in zip(earlier, firsts, strict=True):
        constraints.append(
            {"type": "ineq", "fun": lambda x, o=objective, s=size, k=first: value(x, o, s) - k,
             "jac": lambda x, o=objective, s=size: slope(x, o, s)}
        )  # fmt: skip
    own = value(best.z / problem.scale, last, scales[-1])
    rng = np.random.default_rng(0)
    for distance in (0.0, 1e-4, 1e-3):
        done = minimize(
            lambda x: -value(x, last, scales[-1]), best.z / problem.scale + distance * rng.standard_normal(best.z.size),
            jac=lambda x: -slope(x, last, scales[-1]), method="SLSQP", constraints=constraints,
            bounds=list(zip(problem.lower / problem.scale, problem.upper / problem.scale, strict=True)),
            options={"maxiter": 100, "ftol": 1e-12},
        )  # fmt: skip
        rows = problem.rows(done.x * problem.scale)[:n_task] - problem.target
        kept = [value(done.x, o, s) - k for (o, s), k in zip(earlier, firsts, strict=True)]
        # A point off the target, or that gives up more of what is kept, is no better one.
        if np.abs(rows).max() < 1e-8 and min(kept) > -1e-8:
            assert -done.fun <= own + 1e-5 * max(1.0, abs(own))


def test_an_objective_that_nobody_solves_has_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    machine = flexopt.load("excavator")
    honest, tries = Program.solve, []

    def stuck(self, start, **options):
        if not self.first.kept:
            return honest(self, start, **options)
        tries.append(start)
        return start, 0, "Restoration_Failed"

    climbed = Program.climbed

    def off_the_rows(self, start, *more):
        return None if self.first.kept else climbed(self, start, *more)

    monkeypatch.setattr(Program, "solve", stuck)
    monkeypatch.setattr(Program, "climbed", off_the_rows)
    with pytest.raises(NoSolutionFound, match="as an optimum of w2 among those that keep w1 in"):
        flexopt.select(machine, [3.0, 0.5], objective="w1,w2", workers=1)
    # Points further and further away were tried.
    assert len(np.unique(np.round(tries, 12), axis=0)) >= 3 * optima.AROUND_STARTS


def test_an_optimum_of_the_objective_before_may_be_one_of_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same objective twice: where the solver fails, the proof says that the first answer is the second, too."""
    machine = flexopt.load("excavator")
    whole = flexopt.select(machine, [3.0, 0.5], objective="w1", workers=1)
    problem = replace(
        whole.problem, objectives=whole.problem.objectives * 2, objective_scales=whole.problem.objective_scales * 2
    )
    honest = Program.solve

    def stuck(self, start, **options):
        return (start, 0, "Restoration_Failed") if self.first.kept else honest(self, start, **options)

    monkeypatch.setattr(Program, "solve", stuck)
    twice = flexopt.solve_selection(problem, workers=1)
    np.testing.assert_allclose(twice.best.w[0], whole.best.w[0], atol=1e-9 * whole.problem.objective_scale)


@pytest.mark.long
def test_a_minimum_along_what_is_kept_is_refused() -> None:
    """Where w1 is held at a level by its multiplier and V is least along that level, the proof finds better points."""
    machine = flexopt.load("boom-stick-bucket")
    weights = [1.0] * 3
    problem = flexopt.build_selection(machine, [7.5, -1.0], objective="w1,V", weights=weights, starts=4)
    (first, last), (small, large) = problem.objectives, problem.objective_scales
    scale, rng, refused = problem.scale, np.random.default_rng(0), 0

    def part(which, size):
        return (
            lambda x: float(problem.branches(which, x * scale)[0][0]) / size,
            lambda x: problem.branches(which, x * scale)[1][0] * scale / size,
        )

    (w, w_slope), (v, v_slope) = part(first, small), part(last, large)
    bounds = list(zip(problem.lower / scale, problem.upper / scale, strict=True))
    for start in starting_points(problem) * 6:
        level = w(start / scale) * rng.uniform(0.5, 1.5) - 1e-2
        done = minimize(
            v, start / scale + 0.1 * rng.standard_normal(start.size), jac=v_slope, method="SLSQP", bounds=bounds,
            constraints=[
                {"type": "eq", "fun": lambda x: problem.rows(x * scale)[:2] - problem.target},
                {"type": "eq", "fun": lambda x, at=level: w(x) - at, "jac": w_slope},
            ],
            options={"maxiter": 200, "ftol": 1e-15},
        )  # fmt: skip
        held = replace(problem, kept=(w(done.x) * small,))
        found = prove(held, done.x * scale)
        if "kept w1" in found.active and set(found.violations) == {"second-order optimality"}:
            refused += 1
            assert found.curvature > 1e-3
            break
    assert refused >= 1
