"""The estimated chance of another value and its bound, beside the chance itself of draws that are independent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import flexopt
from flexopt.selection.chances import Attempt, chance_at_most
from tests.oracles.spatial import grounded


@pytest.fixture(scope="module")
def found() -> flexopt.Selection:
    """A selection of a machine in space, whose attempts are replaced."""
    tree = flexopt.tree_from_dict(grounded(4, 3, coupled=False))
    plant = flexopt.build_plant(tree)
    q = plant.rest(np.zeros(3), [0.3, 0.5, -1.0, -0.6], plant.parameter_values)
    point = plant.end_point(q, np.zeros(3), plant.parameter_values).full().ravel()
    return flexopt.select(tree, point, objective="w1", starts=2, workers=1)


def after(selection: flexopt.Selection, values: list[float | None]) -> flexopt.Selection:
    return replace(selection, attempts=tuple(Attempt((0.0,), "", value) for value in values))


def with_values(selection: flexopt.Selection, values: list[float | None]) -> float | None:
    return after(selection, values).missed_chance


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


def distributions() -> list[np.ndarray]:
    """Chances of values: equal, falling fast and slowly, one large beside few or many small, drawn from Dirichlet's."""
    rng = np.random.default_rng(1)
    chances = [np.ones(k) for k in (1, 2, 3, 4, 6, 10, 20, 100)]
    chances += [ratio ** np.arange(200) for ratio in (0.5, 0.7, 0.85, 0.95)]
    chances += [1.0 / np.arange(1, 300) ** power for power in (0.7, 1.0, 1.5, 2.0)]
    chances += [np.r_[1 - rest, np.full(k, rest / k)] for rest in (0.1, 0.3, 0.5, 0.7) for k in (3, 10, 300)]
    chances += [rng.dirichlet(np.full(rng.integers(3, 60), spread)) for spread in (0.1, 0.3, 1.0) for _ in range(5)]
    return [each / each.sum() for each in chances]


@pytest.mark.parametrize("draws", [3, 8, 16, 32, 64])
def test_the_bound_holds_as_often_as_it_says(draws: int) -> None:
    rng, held = np.random.default_rng(draws), list[float]()
    for chances in distributions():
        counts = rng.multinomial(draws, chances, size=1500)
        missed = (counts == 0) @ chances
        held.append(float(np.mean([rest <= chance_at_most(c) + 1e-12 for rest, c in zip(missed, counts, strict=True)])))
    # 1500 draws tell a share of 95 % to 0.6 %, and the bound is a large-number one.
    assert min(held) > 0.93
    assert np.mean(held) > 0.95


def test_few_draws_are_not_sure() -> None:
    """Of n draws that all gave one value, what has a chance of 3 in n stays unseen once in twenty times."""
    assert chance_at_most(np.array([30])) == pytest.approx(1 - 0.05 ** (1 / 30), rel=0.1)
    assert chance_at_most(np.array([2, 2, 2, 2])) > 0.5
    assert chance_at_most(np.array([1])) == 1.0


@pytest.mark.long
def test_estimate_and_bound_are_told_together(found: flexopt.Selection) -> None:
    size = found.problem.objective_scale
    pairs = after(found, [-size * (1 + k) for k in (0, 0, 1, 1, 2, 2, 3, 3)])
    assert pairs.missed_chance == pairs.to_dict()["missed_chance"] == 0.0
    assert pairs.missed_chance_at_most == pairs.to_dict()["missed_chance_at_most"] == pytest.approx(0.775, abs=1e-3)
    pairs = replace(pairs, best=replace(pairs.best, unsurpassed=False))
    assert "up to 78 % of further ones drawn alike may end at a value not found yet (estimate 0 %" in repr(pairs)
    assert after(found, [None]).missed_chance_at_most is None


def test_a_redundancy_that_was_seen_whole_has_none() -> None:
    selection = flexopt.select(flexopt.load("excavator"), (0.0, 1.6), workers=1)
    assert selection.missed_chance is None
    assert selection.missed_chance_at_most is None
    assert selection.to_dict()["missed_chance"] is None


@pytest.mark.long
def test_every_start_tells_its_value(found: flexopt.Selection) -> None:
    ended = [attempt.value for attempt in found.attempts if attempt.value is not None]
    assert ended
    assert max(ended) == pytest.approx(found.best.objective, abs=1e-6 * found.problem.objective_scale)
