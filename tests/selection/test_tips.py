"""Optima where a_i = 0 or b_i = 0: w_i has a kink there, on which the best configurations often stand."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import flexopt
from benchmarks.choice import Other, chosen
from flexopt.selection.problem import value_at
from flexopt.selection.proof.check import prove
from flexopt.selection.seen import settled

# A configuration of the problem pipe-laying that a search without slopes found, and its V / |a||b|: within 1e-4.
FOUND, WORTH = (4.1764, -6.0, -1.9542, np.pi, 0.72008, -1.54933, 0.10836), -0.11820
SLEWING = flexopt.load("slewing-excavator")


def pipe_laying(**changes: Any) -> flexopt.SelectionProblem:
    return flexopt.build_selection(**flexopt.load_problem("pipe-laying").select_arguments() | changes)


@functools.cache
def pipe_laid(seed: int) -> flexopt.Selection:
    return flexopt.solve_selection(pipe_laying(seed=seed))


def no_better_nearby(problem: flexopt.SelectionProblem, z: np.ndarray, seed: int) -> int:
    """Random points about z on the rows, by steps that know no V: none is better. How many there were."""
    rng, best, compared = np.random.default_rng(seed), value_at(problem, z), 0
    for size in (1e-1, 1e-2, 1e-3, 1e-4, 1e-5):
        for _ in range(8):
            beside = np.clip(z + size * rng.standard_normal(z.size) * problem.scale, problem.lower, problem.upper)
            there = settled(problem, beside)
            if there is not None and np.abs((there - z) / problem.scale).max() <= 3 * size:
                compared += 1
                assert value_at(problem, there) <= best + 1e-9 * problem.objective_scale
    return compared


@pytest.mark.long
@pytest.mark.parametrize("seed", [0])
def test_the_best_of_pipe_laying_stands_on_a_kink(seed: int) -> None:
    selection = pipe_laid(seed)
    best, problem = selection.best, selection.problem
    assert best.objective / problem.objective_scale >= WORTH - 1e-4
    np.testing.assert_allclose(best.z, FOUND, atol=2e-3)
    assert list(best.kinks) == ["kink of w5: b5 = 0"]
    assert 0 < best.kinks["kink of w5: b5 = 0"] < 1
    assert best.to_dict()["kinks"] == best.kinks
    assert no_better_nearby(problem, best.z, seed) >= 10


@pytest.mark.long
def test_where_every_solve_stalls_at_the_kink_there_is_an_answer() -> None:
    selection = flexopt.solve_selection(
        pipe_laying(base_range={"x": (3.88, 4.48), "y": (-6.0, -5.7), "yaw": (-2.25, -1.65)})
    )
    np.testing.assert_allclose(selection.best.z, FOUND, atol=2e-3)


@pytest.mark.long
def test_an_optimum_at_a_equal_to_zero() -> None:
    selection = flexopt.select(SLEWING, (6.0, 2.0, 1.0), objective="V", weights=[1.0] * 6, assume="limits")
    assert any("a6 = 0" in name for name in selection.best.kinks)
    assert not selection.best.unsurpassed
    assert "no configuration has a larger" not in repr(selection)
    assert no_better_nearby(selection.problem, selection.best.z, 1) >= 10


@pytest.mark.long
def test_a_kink_does_not_prove_what_can_be_left_upwards() -> None:
    """With other weights the same point has multipliers that are too large, or a gradient along the kink."""
    problem, best = pipe_laid(0).problem, pipe_laid(0).best.z
    assert prove(problem, best).holds
    for mode in (0, 1, 4):
        alpha = tuple(5.0 if i == mode else a for i, a in enumerate(problem.objective.alpha))
        other = replace(problem, objectives=(replace(problem.objective, alpha=alpha),))
        proof = prove(other, best)
        # A larger weight of w_5 alone makes its kink steeper: the point stays one.
        assert proof.holds == (mode == 4), mode


@pytest.mark.long
@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_method_without_slopes_finds_nothing_better(number: int) -> None:
    """`python -m benchmarks.choice` tries more."""
    name = ("slewing-excavator", "truck-crane", "mobile-manipulator")[number]
    machine, target, options = chosen(name, number)
    selection = flexopt.select(machine, target, **options)
    value, _ = Other(selection.problem, number).best(60, 12, 40)
    assert value <= selection.best.objective + 1e-4 * selection.problem.objective_scale


def test_zero_is_the_most_there_is() -> None:
    selection = flexopt.solve_problem(flexopt.load_problem("article"))
    assert selection.best.unsurpassed
    assert "no configuration has a larger w1: 0 is the most there is" in repr(selection)
    assert not all(candidate.unsurpassed for candidate in selection.candidates)
