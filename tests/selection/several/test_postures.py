"""Postures that are moved into what must be kept, their placements held."""

from __future__ import annotations

import numpy as np
import pytest

import flexopt
from flexopt import build_selection
from flexopt.foundation.arrays import Vector
from flexopt.selection.places import FEASIBLE
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.several import postures
from flexopt.selection.starts import moved, rows_at, violated

TARGET = (6.0, 1.5)
ASKED = {"holding": 0.9, "tip_over_margin": 0.3, "joint_margin": 0.03}
WITHIN = [{"of": "payload.mass", "value": (0.0, 2000.0)}]


@pytest.fixture(scope="module")
def machine() -> flexopt.Machine:
    data = flexopt.load("boom-stick-bucket").to_dict() | {"support": {"span": [-1.8, 1.9]}}
    return flexopt.machine_from_dict(data)


def placed(problem: SelectionProblem, seed: int) -> Vector:
    """Placements all over, with postures at random."""
    rng, count = np.random.default_rng(seed), 200
    low, high = (np.nan_to_num(ends, posinf=3.0, neginf=-3.0) for ends in (problem.lower, problem.upper))
    low[0], high[0] = -4.0, 4.0
    return rng.uniform(low[:, None], high[:, None], (low.size, count))


def test_without_corners_a_problem_is_that_in_which_nobody_asked_for_them(machine: flexopt.Machine) -> None:
    problem = build_selection(machine, TARGET, gravity=True, constraints={**ASKED, "within": WITHIN})
    alone = build_selection(machine, TARGET, gravity=True, constraints=ASKED)
    own = postures.without_corners(problem)
    assert len(own.constraints) < len(problem.constraints)
    assert own.constraints == alone.constraints
    assert postures.without_corners(alone) is alone
    z = placed(problem, 1)
    np.testing.assert_array_equal(rows_at(own, z), rows_at(alone, z))


def test_rows_at_corners_are_asked_only_of_what_keeps_the_others(
    machine: flexopt.Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They cost many times as much. What is found so keeps all, and is nearly as much as by all of them at once."""
    problem = build_selection(machine, TARGET, gravity=True, constraints={**ASKED, "within": WITHIN})
    z, counts = placed(problem, 2), list[tuple[int, int]]()

    def counted(which: SelectionProblem, at: Vector, *, standing: bool) -> tuple[Vector, Vector]:
        counts.append((len(which.constraints), at.shape[1]))
        return moved(which, at, standing=standing)

    monkeypatch.setattr(postures, "moved", counted)
    there, left = postures._moved_inside(problem, z)
    inside = left <= FEASIBLE
    assert violated(problem, there[:, inside]).max() <= FEASIBLE
    np.testing.assert_array_equal(there[0], z[0])
    (few, every), (most, some) = counts
    assert (few, every, most) == (len(postures.without_corners(problem).constraints), 200, len(problem.constraints))
    assert 0 < inside.sum() <= some < 200
    at_once = moved(problem, z, standing=True)[1] <= FEASIBLE
    assert np.sum(at_once & ~inside) <= 0.02 * at_once.sum()
