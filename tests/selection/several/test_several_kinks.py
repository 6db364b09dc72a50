"""Stands and plans whose optimum stands on kinks of w_i (a_i = 0 or b_i = 0 at a target), beside another method."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import flexopt
from benchmarks.together import RATE, SECONDS, Together, asked, program_of
from flexopt.selection.nlp.program import Program
from flexopt.selection.proof.check import infeasible, prove_program
from flexopt.selection.several import TargetConfiguration
from flexopt.selection.several.results import KEPT
from flexopt.selection.several.solving import end_from

MACHINE = "truck-crane"


def no_better_nearby(program: Program, x: np.ndarray, seed: int) -> int:
    """Random points about x on the targets, by steps that know no V: none is better. How many there were."""
    other, worth, compared = Together(program, seed), program.worth(x), 0
    for size in (1e-1, 1e-2, 1e-3, 1e-4, 1e-5):
        there = other.beside(np.repeat(x[:, None], 60, axis=1), size)
        values = other.values(there)
        near = np.isfinite(values) & (np.abs((there - x[:, None]) / program.scale[:, None]).max(axis=0) <= 4 * size)
        compared += int(near.sum())
        assert np.all(values[near] <= worth + 1e-8 * program.size)
    return compared


def packed(program: Program, places: tuple[TargetConfiguration, ...]) -> np.ndarray:
    return program.packed([np.append(place.evaluation.base, place.evaluation.posture) for place in places])


@pytest.fixture(scope="module")
def stand() -> tuple[flexopt.Stand, Program, np.ndarray]:
    machine, targets, options = asked(MACHINE, 1, 2)
    found = flexopt.select_stand(machine, targets, starts=8, workers=1, **options)
    program = program_of(found.problems, moving=False)
    return found, program, packed(program, found.places)


@pytest.mark.long
def test_a_stand_on_kinks(stand: tuple[flexopt.Stand, Program, np.ndarray]) -> None:
    found, program, x = stand
    assert found.kinks
    assert all(re.fullmatch(r"target [12]: kink of w(\d): [ab]\1 = 0", name) for name in found.kinks)
    assert all(0 <= share < 1 for share in found.kinks.values())
    assert found.to_dict()["kinks"] == found.kinks
    assert prove_program(program, x).kinks == pytest.approx(found.kinks, abs=1e-6)
    assert no_better_nearby(program, x, 1) >= 10
    value, _ = Together(program, 1).best(80, 16, 50)
    assert value <= found.worth + 1e-4 * program.size


@pytest.mark.long
def test_with_other_weights_the_same_stand_is_proved_or_left_upwards(
    stand: tuple[flexopt.Stand, Program, np.ndarray],
) -> None:
    """Where the multipliers of kinks are too large, or a gradient along them is left, there is a better point."""
    _, program, x = stand
    objective, m = program.first.objective, len(program.first.objective.alpha)
    changes = [2.0 * np.eye(m)[i] for i in range(m)] + [-0.9 * np.eye(m)[i] * objective.alpha[i] for i in range(m)]
    refused = 0
    for change in changes:
        other = replace(objective, alpha=tuple((np.array(objective.alpha) + change).tolist()))
        problems = tuple(replace(problem, objectives=(other,)) for problem in program.problems)
        changed = replace(program, problems=problems)
        if prove_program(changed, x).holds:
            assert no_better_nearby(changed, x, 5) >= 10
            continue
        refused += 1
        found = changed.climbed(x, 30)
        assert found is not None
        assert not infeasible(changed, found[0])
        assert changed.worth(found[0]) > changed.worth(x) + 1e-7 * changed.size, change
    assert 0 < refused < len(changes)


@pytest.mark.long
def test_a_stand_of_shares_on_a_kink() -> None:
    """What is sought is the sum: kinks are its own, not those of a row."""
    machine, targets, options = asked(MACHINE, 1, 2)
    found = flexopt.select_stand(
        machine, targets, combine="weighted", shares=[0.7, 0.3], starts=4, workers=1, **options
    )
    program = program_of(found.problems, moving=False)
    program = replace(program, goal="weighted", share=np.array([0.7, 0.3]))
    assert found.kinks
    assert no_better_nearby(program, packed(program, found.places), 2) >= 10


@pytest.mark.long
def test_a_plan_on_kinks() -> None:
    machine, targets, options = asked(MACHINE, 7, 2)
    found = flexopt.plan_base(machine, targets, duration=SECONDS, max_base_rate=RATE, starts=4, workers=1, **options)
    assert found.kinks
    assert all(re.fullmatch(r"target [12]: kink of w(\d): [ab]\1 = 0", name) for name in found.kinks)
    assert all(0 <= share < 1 for share in found.kinks.values())
    program = program_of(found.problems, moving=True)
    # The shortest way gives up a little: what it is near is the best.
    best = end_from(program, packed(program, found.places))
    assert not best.violations
    assert program.worth(best.x) - found.worth <= (KEPT + 1e-6) * program.size
    assert no_better_nearby(program, best.x, 3) >= 10
