"""A choice by decay that ends where two oscillations meet: the shipped pipe-laying problem with plain feedback."""

from __future__ import annotations

from dataclasses import fields
from functools import cache
from typing import Any

import numpy as np
import pytest

import flexopt
from flexopt.foundation.arrays import Vector
from flexopt.loop.meeting import nearest
from flexopt.loop.settings import LoopSettings, loop_settings
from flexopt.loop.uncertain import UncertainLoop
from flexopt.loop.uncertainty_box import UncertaintyBox
from flexopt.model.loop import Loop
from flexopt.selection.nlp.coupling import Coupling
from flexopt.selection.outcomes.climb import ACTIVE, Climbed, _searched, climbed, first_order, onto_rows
from flexopt.selection.outcomes.program import MEETING, MEETS, TOGETHER, OutcomeProgram
from flexopt.selection.outcomes.result import OutcomeSelection
from flexopt.selection.outcomes.shared import SharedProgram, ShortestWay
from tests.oracles.machines import arm_at_rest, random_machine, regular_posture

LOOP = {"kp": 3e6, "kv": 6e5}


@cache
def chosen() -> OutcomeSelection:
    """By decay, from few starts."""
    arguments = flexopt.load_problem("pipe-laying").select_arguments()
    arguments.pop("weights", None)
    found = flexopt.select(**arguments | {"objective": "decay", "loop": LOOP, "starts": 8})
    assert isinstance(found, OutcomeSelection)
    return found


def program() -> tuple[OutcomeProgram, Vector]:
    """What was climbed, and where it led."""
    found = chosen()
    settings = found.settings[0]
    assert isinstance(settings, LoopSettings)
    e, problem = found.best.evaluation, found.problem
    box = UncertaintyBox(problem.machine, (), settings.dead_time)
    loop = UncertainLoop(settings, e.base, e.posture, problem.gravity, box)
    return OutcomeProgram(problem, loop, {}, np.zeros((0, 0)), found.best.objective), found.best.z / problem.scale


@pytest.mark.long
def test_every_constraint_is_kept_and_it_is_faster_than_the_best_of_modes() -> None:
    found, problem = chosen(), flexopt.load_problem("pipe-laying")
    for constraint in found.best.constraints.values():
        assert constraint.lower - 1e-6 <= constraint.value <= constraint.upper + 1e-6
    by_measure = flexopt.select(**problem.select_arguments() | {"starts": 4})
    assert isinstance(by_measure, flexopt.Selection)
    e = by_measure.best.evaluation
    other = flexopt.outcome(found.problem.machine, e.posture, base=e.base, loop=LOOP)
    assert found.best.objective > other.decay


@pytest.mark.long
def test_it_is_proven_where_no_rate_has_a_slope() -> None:
    """The two slowest are one to half of the digits; apart their slopes are huge, and the proof of one by one fails."""
    found = chosen()
    assert MEETING in found.best.active
    assert found.best.stationarity < 1e-8
    assert found.unverified is None
    own, y = program()
    (point,) = own.points(y)
    near = nearest(point, TOGETHER)
    assert near is not None
    assert near.oscillate
    assert np.hypot(*(part.value for part in near.squared)) < (1e-4 * near.mean.value) ** 2
    assert near.mean.value == pytest.approx(found.best.objective, rel=1e-5)
    assert first_order(own, y, own.value(y))[0] > 1e-4


@pytest.mark.long
def test_nothing_near_it_is_better() -> None:
    """Random steps of many sizes, put back onto the constraints: no derivative is asked."""
    own, y = program()
    best, rng, tried = own.value(y), np.random.default_rng(2), 0
    for size in np.geomspace(1e-6, 0.1, 240):
        there = onto_rows(own, y + size * rng.normal(size=y.size))
        if there is not None:
            tried += 1
            # Where eigenvalues meet they have half of the digits.
            assert own.value(there) <= best * (1 + ACTIVE)
    assert tried > 200


@pytest.mark.long
@pytest.mark.parametrize("targets", [1, 2])
def test_slopes_beside_differences(targets: int) -> None:
    """Of rows and branches of the program that holds the two together, at a point that is no optimum.

    Of one target, and of two that share nothing, of which the second has no motions that meet.
    """
    own, y = program()
    y = np.clip(y + 1e-4 * np.random.default_rng(3).normal(size=y.size), *own.bounds)
    if targets > 1:
        n = y.size
        options: dict[str, Any] = {each.name: getattr(own, each.name) for each in fields(own)}
        apart = Coupling((tuple(range(n)), tuple(range(n, 2 * n))))
        own = SharedProgram(**options, problems=(own.problem,) * 2, coupling=apart)
        # One whose own slowest motion is faster, so that those that meet decide.
        rng, ends = np.random.default_rng(4), [end[:n] for end in own.bounds]
        others = (np.append(y, np.clip(y + 0.05 * rng.normal(size=n), *ends)) for _ in range(20))
        y = next(each for each in others if own.meeting(each, own.level(own.value(each))) is not None)
    met = own.meeting(y, own.level(own.value(y)))
    assert met is not None
    assert len(met.row_names) == len(own.row_names) + 2
    level, step = met.level(met.value(y)), 1e-6
    found, rows = met.branches(y, level), met.row_slopes(y)
    assert len(rows) == len(met.row_names) == len(met.row_bounds[0]) == len(met.rows(y))
    for i, way in enumerate(np.eye(y.size) * step):
        up, down = met.branches(y + way, level), met.branches(y - way, level)
        central = (up.values - down.values) / (2 * step)
        np.testing.assert_allclose(found.slopes[:, i], central, rtol=1e-5, atol=1e-5)
        changed = (met.rows(y + way) - met.rows(y - way)) / (2 * step)
        # Rows of motions that meet are in small units.
        np.testing.assert_allclose(rows[:, i], changed, rtol=1e-5, atol=1e-7 / MEETS**2)


@pytest.mark.long
def test_the_shortest_way_holds_together_what_decays_as_its_measure_must() -> None:
    """Whatever its length, which is told in other units."""
    own, y = program()
    options: dict[str, Any] = {each.name: getattr(own, each.name) for each in fields(own)}
    apart = Coupling((tuple(range(y.size)), tuple(range(y.size, 2 * y.size))))
    shared = SharedProgram(**options, problems=(own.problem,) * 2, coupling=apart)
    both, kept = np.append(y, y), own.value(y)
    way = ShortestWay(**{each.name: getattr(shared, each.name) for each in fields(shared)}, kept=kept)
    for length in (-100.0, 0.0):
        found, same = way.meeting(both, length), shared.meeting(both, shared.level(kept))
        assert isinstance(found, ShortestWay)
        assert same is not None
        assert found.met_at == same.met_at
        assert all(found.met_at)


@pytest.mark.long
def test_it_is_found_again_from_beside_it() -> None:
    """From most of the starts: where rates meet rounding alone may end a climb a little before, which says so."""
    own, y = program()
    found = list[Climbed]()
    for seed in range(6):
        beside = onto_rows(own, y + 1e-3 * np.random.default_rng(seed).normal(size=y.size))
        assert beside is not None
        again = climbed(own, beside)
        assert isinstance(again, Climbed)
        found.append(again)
    proven = [each for each in found if each.holds]
    assert len(proven) >= 3
    for each in proven:
        assert each.value == pytest.approx(chosen().best.objective, rel=1e-5)


@pytest.mark.long
def test_steps_that_never_lead_down_go_on_where_a_search_stops() -> None:
    """Sampled slowly beside its modes a machine has rates whose slopes change abruptly: a search alone stops far below.

    Sequential quadratic programming stops at 20.66/s; a scan of 8,000 configurations has 21.3/s at most.
    """
    rng = np.random.default_rng(3)
    _, machine = random_machine(rng)
    target = [arm_at_rest(machine, regular_posture(rng, machine))[1] for _ in range(2)][1]
    problem = flexopt.build_selection(machine, target)
    start = np.array([4.40791, -3.6347, -0.76778, -3.10845, 0.70201, 2.72033])
    stand = flexopt.evaluate(machine, start[1:], base=start[:1])
    settings = loop_settings(machine, Loop(control="inverse", kp=8.65e6, kv=2.422e5), stand)
    loop = UncertainLoop(settings, stand.base, stand.posture, False, UncertaintyBox(machine, (), 0.0))
    own = OutcomeProgram(problem, loop, {}, np.zeros((0, 0)), 13.0)
    y = onto_rows(own, start / problem.scale)
    assert y is not None
    alone, found = _searched(own, y), climbed(own, y)
    assert alone is not None
    assert not alone.holds
    assert found is not None
    assert found.holds
    assert found.value > 35.0
    assert np.abs(own.rows(found.y)[:2]).max() < 1e-7
