"""Starts of a stand from what its targets can have alone, and what is said of optima that no start led to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import flexopt
from flexopt.selection.chances import chance, chance_at_most, how_often
from flexopt.selection.continua import turned_about, turns
from flexopt.selection.several.alone import placements_alone
from flexopt.selection.several.postures import climbed_held, reached_from
from flexopt.selection.several.standing import one_placement

TARGETS = ((0.7, 0.3, 0.9), (0.6, -0.4, 0.7))


@pytest.fixture(scope="module")
def problems() -> tuple[flexopt.SelectionProblem, ...]:
    machine = flexopt.load("mobile-manipulator")
    asked = {"base": np.zeros(3), "objective": "V", "weights": [1.0, 1.0, 1.0]}
    return tuple(flexopt.build_selection(machine, target, **asked) for target in TARGETS)


def test_turned_placements_reach_the_target_with_the_same_posture(
    problems: tuple[flexopt.SelectionProblem, ...],
) -> None:
    """And have the same w_i, by `evaluate`: nothing on level ground tells north from east."""
    problem = problems[0]
    machine, z = problem.machine, problem.scan.z[:, 0]
    base, posture = np.split(z, [3])
    assert turns(problem)
    turned, postures = np.split(turned_about(problem, z, np.linspace(0.0, 6.0, 18)), [3])
    np.testing.assert_allclose(turned[:2, 0], base[:2])
    np.testing.assert_allclose(np.mod(postures - posture[:, None] + 1.0, 2 * np.pi), 1.0)
    assert np.ptp(turned[2]) > 5.0
    w = flexopt.evaluate(machine, posture, base=base).w
    for placed in turned[:, ::5].T:
        found = flexopt.evaluate(machine, posture, base=placed)
        np.testing.assert_allclose(found.end_point, problem.target, atol=1e-7)
        np.testing.assert_allclose(found.w, w, rtol=1e-6, atol=1e-9 * np.abs(w).max())
    # A bounded yaw comes into its bounds.
    bounded = replace(
        problem,
        variables=tuple(replace(v, lower=4.0, upper=11.0) if v.name == "base.yaw" else v for v in problem.variables),
    )
    there = turned_about(bounded, z, np.linspace(0.0, 6.0, 18))
    assert np.all((there[2] >= 4.0) & (there[2] <= 11.0))
    assert not turns(flexopt.build_selection(flexopt.load("excavator"), (0.0, 1.6)))


def test_postures_that_climb_stay_on_the_target_and_are_allowed(problems: tuple[flexopt.SelectionProblem, ...]) -> None:
    problem = problems[1]
    bases = problem.scan.base[:, :6]
    reached = reached_from(problem, bases, 0)
    climbed = climbed_held(problem, reached, 0)
    assert np.all(climbed.value.max(axis=1) >= reached.value.max(axis=1))
    assert np.any(climbed.value.max(axis=1) > reached.value.max(axis=1))
    best = climbed.value.argmax(axis=1)
    for k in np.flatnonzero(np.isfinite(climbed.value.max(axis=1))):
        base, posture = np.split(climbed.z[:, k, best[k]], [3])
        np.testing.assert_array_equal(base, bases[:, k])
        found = flexopt.evaluate(problem.machine, posture, base=base)
        np.testing.assert_allclose(found.end_point, problem.target, atol=1e-7)
        assert found.w.sum() == pytest.approx(climbed.value[k, best[k]], rel=1e-9)
        low, high = np.array(problem.machine.limits).T
        assert np.all((low - 1e-9 <= posture) & (posture <= high + 1e-9))


@pytest.mark.long
def test_a_stand_lies_between_few_starts_and_what_its_worst_target_can_have_alone(
    problems: tuple[flexopt.SelectionProblem, ...],
) -> None:
    machine, asked = problems[0].machine, {"base": np.zeros(3), "objective": "V", "weights": [1.0, 1.0, 1.0]}
    few, full = (flexopt.select_stand(machine, TARGETS, starts=starts, **asked) for starts in (2, None))
    alone = min(flexopt.solve_selection(problem).best.objective for problem in problems)
    size = 1e-6 * problems[0].first_scale
    assert few.worth - size <= full.worth <= alone + size
    # From what a target can have alone only those placements come that are better for it.
    program = one_placement(problems, np.full(2, 0.5), weighted=False)
    at = program.packed([place.evaluation.z for place in few.places])
    for base, posture in zip(*(columns.T[::24] for columns in placements_alone(program, at, 2)), strict=True):
        found = flexopt.evaluate(machine, posture, base=base)
        (number,) = [k for k, target in enumerate(TARGETS) if np.abs(found.end_point - target).max() < 1e-6]
        assert found.w.sum() > few.V[number]


@pytest.mark.parametrize("starts", [2, 6])
def test_what_more_starts_may_find_is_told(starts: int) -> None:
    """By where they ended; text and document. None of a curve of postures that is seen whole."""
    machine = flexopt.load("boom-stick-bucket")
    stand = flexopt.select_stand(machine, [(5.0, 1.0), (6.0, 2.0)], objective="w2", starts=starts)
    counts = how_often(stand.problems[0], stand.ends)
    assert counts.sum() == len(stand.ends) == stand.attempts[1]
    assert stand.missed_chance == chance(counts) == stand.to_dict()["missed_chance"]
    assert stand.missed_chance_at_most == chance_at_most(counts) == stand.to_dict()["missed_chance_at_most"]
    told = f"best found in {starts} starts, {len(stand.ends)} of which ended at an optimum"
    assert (told in repr(stand)) == (stand.stationarity > 0)
    if stand.alternatives and stand.stationarity > 0:
        assert f"the next best worth {stand.alternatives[0][0]:.4e}" in repr(stand)
    curve = flexopt.select_stand(flexopt.load("excavator"), [(0.0, 1.6), (0.6, 1.2)], objective="w2", starts=starts)
    for other in (replace(stand, ends=()), curve):
        assert other.missed_chance is None
        assert other.missed_chance_at_most is None
        assert "ended at an optimum" not in repr(other)
