"""A way of the base along a path by what the loop does at the worst target, beside scans that climb nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import flexopt
from flexopt.foundation.arrays import Vector
from flexopt.loop.many import decays
from flexopt.loop.settings import loop_settings
from flexopt.model.loop import Loop
from flexopt.selection.outcomes.measures import Decay
from flexopt.selection.several import outcome_plan, ways
from flexopt.selection.several.outcome_plan import OutcomePlan
from tests.selection.loops import EXCAVATOR, posture_at
from tests.selection.several.redundant import HIGH, REDUNDANT, best_decays
from tests.study.machines import three_links

PATH = [(0.0, 1.6), (0.9, 1.1)]
LOOP: dict[str, Any] = {"kp": 1e4, "kv": 1e3, "dead_time": 0.0031}
# Placements that are looked at, in one zone of the elbow.
PART = (-2.3, -1.0)
SECONDS, RATE, JOINT = 4.0, 0.05, 0.3


def scanned(grid: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Decays (elbow, target, placement) and postures there; −∞ where a target is not reached."""
    settings = loop_settings(EXCAVATOR, Loop(**LOOP), flexopt.evaluate(EXCAVATOR, (0.5, -1.2)))
    found, held = np.full((2, 2, len(grid)), -np.inf), np.full((2, 2, len(grid), 2), np.nan)
    for i, elbow in enumerate(("up", "down")):
        for k, target in enumerate(PATH):
            for j, x in enumerate(grid):
                posture = posture_at(x, elbow, target)
                if posture is not None:
                    held[i, k, j] = posture
            known = np.isfinite(held[i, k, :, 0])
            varied = {"base": np.array(grid)[known][None], "posture": held[i, k, known].T}
            varied |= {"p": np.tile(np.array([p.value for p in EXCAVATOR.parameters])[:, None], known.sum())}
            varied |= {"dead_time": np.full((1, int(known.sum())), LOOP["dead_time"])}
            found[i, k, known] = decays(EXCAVATOR, settings, varied).decay
    return found, held


@pytest.mark.long
def test_no_way_of_a_scan_is_better() -> None:
    """Every pair of placements on a grid whose steps keep the rates; the best is on their edge, and standing is worse."""
    plan = flexopt.plan_base(
        EXCAVATOR, PATH, objective="decay", loop=LOOP, base_range=PART, duration=SECONDS, max_base_rate=RATE,
        max_joint_rate=JOINT, workers=1,
    )  # fmt: skip
    assert isinstance(plan, OutcomePlan)
    grid = np.linspace(*PART, 66)
    decay, held = scanned(grid.tolist())
    near = np.abs(grid[:, None] - grid) <= RATE * SECONDS + 1e-12
    best = -np.inf
    for i in range(2):
        steps = np.abs(held[i, 0, :, None] - held[i, 1, None, :]).max(axis=2)
        worst = np.minimum(decay[i, 0][:, None], decay[i, 1])
        best = max(best, float(worst[near & (steps <= JOINT * SECONDS)].max(initial=-np.inf)))
    assert best > 0
    assert plan.worth >= best * (1 - 1e-4)
    assert np.all(np.abs(np.diff(plan.base, axis=0)) <= RATE * SECONDS + 1e-8)
    assert np.all(np.abs(np.diff(plan.posture, axis=0)) <= JOINT * SECONDS + 1e-8)
    for place, target, value in zip(plan.places, PATH, plan.V, strict=True):
        assert place.evaluation.outcome is not None
        assert value == pytest.approx(place.evaluation.outcome.decay, rel=1e-9)
        np.testing.assert_allclose(place.evaluation.end_point, target, atol=1e-8)
    # Standing still is one of the ways; the shortest one may give up 1e-4.
    assert plan.still is not None
    assert plan.worth >= plan.standing * (1 - 1.01e-4)
    still = [flexopt.outcome(EXCAVATOR, q, base=plan.still.base, loop=LOOP).decay for q in plan.still.posture]
    np.testing.assert_allclose(plan.still.V, still, rtol=1e-9)
    # Postures between the targets, those at them too, are found by an iteration.
    assert plan.between[0] <= plan.worth * (1 + 1e-8)
    document = plan.to_dict()
    assert document["measure"] == "decay"
    assert document["worst"] == int(np.argmin(plan.V))
    assert f"worst decay {plan.worth:.4g} 1/s" in repr(plan)
    verdict = flexopt.verdict(
        flexopt.plan_base(
            EXCAVATOR, PATH, objective="decay", loop=LOOP, base_range=PART, start=plan.base[0], duration=SECONDS,
            max_base_rate=RATE, max_joint_rate=JOINT, workers=1,
        ), loop=LOOP, members=2, runs=0,
    )  # fmt: skip
    names = {place.name: place for place in verdict.places}
    assert names["candidate 1"].decay.nominal == pytest.approx(plan.worth, rel=1e-3)


@pytest.mark.long
def test_small_ones_and_gains_along_a_way() -> None:
    """What shall be small is the largest at the worst target; gains are chosen with the way, the same at every target."""
    ranges = {"kp_range": (1e3, 1e5), "kv_range": (1e2, 1e4)}
    plan = flexopt.plan_base(
        EXCAVATOR, [(0.0, 1.6), (0.2, 1.5)], objective="decay", loop={"dead_time": 0.02, **ranges},
        base_range=(-1.9, -1.5), starts=4, workers=1,
    )  # fmt: skip
    assert isinstance(plan, OutcomePlan)
    assert plan.gains.keys() == {"kp", "kv"}
    assert 1e3 * (1 - 1e-9) <= plan.gains["kp"] <= 1e5 * (1 + 1e-9)
    for place, value in zip(plan.places, plan.V, strict=True):
        stand = place.evaluation
        own = {"dead_time": 0.02, **plan.gains}
        assert flexopt.outcome(EXCAVATOR, stand.posture, base=stand.base, loop=own).decay == pytest.approx(value)
    # No gains of a grid do better along this way.
    for kp in np.geomspace(*ranges["kp_range"], 5):
        for kv in np.geomspace(*ranges["kv_range"], 5):
            own = {"dead_time": 0.02, "kp": float(kp), "kv": float(kv)}
            each = [
                flexopt.outcome(EXCAVATOR, place.evaluation.posture, base=place.evaluation.base, loop=own).decay
                for place in plan.places
            ]
            assert min(each) <= plan.worth * (1 + 2e-4)


@pytest.mark.long
def test_the_postures_of_a_redundant_arm_do_not_multiply_what_is_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 100 points that a measure looks at a target has four times its half; a placement at least four postures."""
    monkeypatch.setattr(Decay, "looked", 100)
    placements, postures = 4 * 100 // len(HIGH), 4
    sizes, values, lengths = list[int](), outcome_plan.values_at, ways.ways_of_lengths

    def noted(target: Any, ys: list[np.ndarray], workers: int) -> list[float]:
        sizes.append(len(ys))
        assert len(ys) <= placements * postures
        return values(target, ys, workers)

    def joined(program: Any, layers: list[ways.Layer]) -> list[tuple[float, Vector]]:
        assert layers[0][1].size * layers[1][1].size <= placements**2
        return lengths(program, layers)

    monkeypatch.setattr(outcome_plan, "values_at", noted)
    monkeypatch.setattr(outcome_plan, "ways_of_lengths", joined)
    monkeypatch.setattr(ways, "ways_of_lengths", joined)
    plan = flexopt.plan_base(three_links(), HIGH, starts=1, **REDUNDANT)
    assert max(sizes) > placements
    assert isinstance(plan, OutcomePlan)
    assert plan.worth >= plan.standing * (1 - 1.01e-4)


@pytest.mark.long
def test_no_placement_of_a_redundant_arm_of_a_scan_is_better() -> None:
    """Placements by angles of the last link by elbows; the joints have no rates, so each target has its own best."""
    machine = three_links()
    plan = flexopt.plan_base(machine, HIGH, starts=5, **REDUNDANT)
    assert isinstance(plan, OutcomePlan)
    best = best_decays()
    assert best.min(axis=0).max() > 0.015
    assert plan.standing >= best.min(axis=0).max()
    assert plan.worth >= best.max(axis=1).min() * (1 - 1.01e-4)
    assert plan.still is not None
    for q, target, value in zip(plan.still.posture, HIGH, plan.still.V, strict=True):
        np.testing.assert_allclose(flexopt.evaluate(machine, q, base=plan.still.base).end_point, target, atol=1e-8)
        assert flexopt.outcome(machine, q, base=plan.still.base, loop=REDUNDANT["loop"]).decay == pytest.approx(value)


def test_what_is_refused() -> None:
    with pytest.raises(flexopt.InputError, match="must be a single one"):
        flexopt.plan_base(EXCAVATOR, PATH, objective="w1,decay", loop=LOOP)
    with pytest.raises(flexopt.InputError, match="goes with an objective of the loop"):
        flexopt.plan_base(EXCAVATOR, PATH, loop=LOOP)


def test_what_keeps_a_target_from_every_configuration_is_told() -> None:
    """The constraint, and by how much it is short, at each target."""
    with pytest.raises(
        flexopt.NoSolutionFound, match=r"target 1: .* none keeps manipulability, .* m\^2 short.*target 2"
    ):
        flexopt.plan_base(EXCAVATOR, PATH, objective="decay", loop=LOOP, constraints={"manipulability": 100.0})
