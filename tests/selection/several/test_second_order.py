"""A point that is stationary and no maximum is no stand and no way, whatever its first derivatives say."""

from dataclasses import replace

import numpy as np
import pytest

import flexopt
from flexopt.selection.nlp.program import Program, row_gradients, single
from flexopt.selection.objective import Objective
from flexopt.selection.proof.check import prove, prove_program
from flexopt.selection.scan import peaks
from flexopt.selection.several.plan import _along
from flexopt.selection.several.standing import one_placement

TARGET = (0.0, 1.6)


def stationary(sense: float) -> tuple[flexopt.SelectionProblem, np.ndarray]:
    """A problem, and a maximum (1) or a minimum (−1) of its w2 along the redundancy, away from every bound."""
    problem = flexopt.build_selection(flexopt.load("excavator"), TARGET, objective="w2")
    objective = Objective("V", tuple(sense * a for a in problem.objective.alpha), 0.0)
    wanted = replace(problem, objectives=(objective,))
    for number in peaks(problem.scan, sense * problem.scan.objective):
        start = np.concatenate([problem.scan.base[:, number], problem.scan.posture[:, number]])
        z, _, _ = single(wanted).solve(start)
        proof = prove(wanted, z)
        if (
            proof.holds
            and not proof.active
            and abs(problem.branches(problem.objective, z)[0][0]) > 1e-3 * wanted.objective_scale
        ):
            return problem, z
    raise AssertionError("no such point")


def programs(problem: flexopt.SelectionProblem) -> dict[str, Program]:
    """The problem twice: from one placement, and as a way with steps that bound nothing."""
    both, share = (problem, problem), np.array([0.3, 0.7])
    found = {goal: one_placement(both, share, weighted=goal == "weighted") for goal in ("weighted", "worst")}
    return found | {"way": _along(both, np.array([0.0, 10.0]), np.full(problem.scale.size, 5.0), None)}


@pytest.mark.parametrize("kind", ["weighted", "worst", "way"])
def test_a_minimum_is_refused_and_a_maximum_proved(kind):
    for sense in (1.0, -1.0):
        problem, z = stationary(sense)
        program = programs(problem)[kind]
        # On a way only the worst configuration counts; the other one is anywhere above it.
        best = peaks(problem.scan)[0]
        above = np.concatenate([problem.scan.base[:, best], problem.scan.posture[:, best]])
        other = above if kind == "way" and sense < 0 else z
        found, alone = prove_program(program, program.packed([z, other])), prove(problem, z)
        assert found.stationarity < 1e-6
        assert (set(found.violations) == {"second-order optimality"}) == (sense < 0), found
        assert (set(alone.violations) == {"second-order optimality"}) == (sense < 0), alone
        if sense < 0:
            # From one placement both postures move: the same curve, but the unit of length along it is another one.
            along = np.linalg.svd(row_gradients(problem, z)[:2] * problem.scale)[2][2]
            length = 1.0 if kind == "way" else 1.0 + np.sum(along[1:] ** 2)
            assert found.curvature == pytest.approx(alone.curvature / length, rel=1e-5)
