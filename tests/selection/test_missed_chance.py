"""The estimated chance of another value, beside the chance itself of starts that are drawn independently."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import flexopt
from flexopt.selection.result import Attempt
from tests.oracles.spatial import grounded


@pytest.fixture(scope="module")
def found() -> flexopt.Selection:
    """A selection of a machine in space, whose attempts are replaced."""
    tree = flexopt.tree_from_dict(grounded(4, 3, coupled=False))
    plant = flexopt.build_plant(tree)
    q = plant.rest(np.zeros(3), [0.3, 0.5, -1.0, -0.6], plant.parameter_values)
    point = plant.end_point(q, np.zeros(3), plant.parameter_values).full().ravel()
    return flexopt.select(tree, point, objective="w1", starts=2, workers=1)


def with_values(selection: flexopt.Selection, values: list[float | None]) -> float | None:
    attempts = tuple(Attempt((0.0,), "", value) for value in values)
    return replace(selection, attempts=attempts).missed_chance


@pytest.mark.long
def test_values_found_once(found: flexopt.Selection) -> None:
    size = found.problem.objective_scale
    assert with_values(found, [None, None]) is None
    assert with_values(found, [-size]) == 1.0
    assert with_values(found, [-size, None, -size * (1 + 1e-9)]) == 0.0
    assert with_values(found, [-size, -2 * size, -size, -3 * size, None]) == 0.5


@pytest.mark.long
def test_on_average_it_is_the_chance_itself(found: flexopt.Selection) -> None:
    """Of 12 draws from 20 values of unequal chance: Good and Turing's estimate has no more than the bias of one draw."""
    rng, size = np.random.default_rng(0), found.problem.objective_scale
    chance = 0.75 ** np.arange(20)
    chance /= chance.sum()
    told, true = [], []
    for _ in range(400):
        draws = rng.choice(20, 12, p=chance)
        told.append(with_values(found, [-size * (1 + k) for k in draws.tolist()]))
        true.append(1.0 - chance[np.unique(draws)].sum())
    # The estimate's mean is the chance left before the last draw: larger by a 12th of what the values found once have.
    assert np.mean(true) < np.mean(told) < np.mean(true) + 0.05


def test_a_redundancy_that_was_seen_whole_has_none() -> None:
    selection = flexopt.select(flexopt.load("excavator"), (0.0, 1.6), workers=1)
    assert selection.missed_chance is None
    assert selection.to_dict()["missed_chance"] is None


@pytest.mark.long
def test_every_start_tells_its_value(found: flexopt.Selection) -> None:
    ended = [attempt.value for attempt in found.attempts if attempt.value is not None]
    assert ended
    assert max(ended) == pytest.approx(found.best.objective, abs=1e-6 * found.problem.objective_scale)
