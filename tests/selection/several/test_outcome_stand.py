"""One placement for several targets by what the loop does at the worst of them, beside scans that climb nothing."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import differential_evolution

import flexopt
from flexopt.selection.several.outcome_stand import OutcomeStand
from flexopt.study import problem_page
from flexopt.study.page import number

EXCAVATOR = flexopt.load("excavator")
TARGETS = [(0.0, 1.6), (0.3, 1.3)]
LOOP = {"kp": 1e4, "kv": 1e3, "dead_time": 0.0031}
# Placements that are looked at.
PART = (-2.3, -1.4)
STRAIGHT = math.radians(10.0)


def told(name: str, x: float, loop: dict[str, Any]) -> float:
    """The worst target's measure, of the better posture at each; worse than all where one is out of reach."""
    sign = -1.0 if name in ("settling", "swing") else 1.0
    worst = math.inf
    for target in TARGETS:
        best = -math.inf
        for elbow in ("up", "down"):
            try:
                posture = flexopt.inverse_kinematics(EXCAVATOR, target, base=x, elbow=elbow)[0]
            except flexopt.UnreachableTarget:
                continue
            if STRAIGHT <= abs(math.remainder(posture[1], math.tau)) <= math.pi - STRAIGHT:
                value = sign * float(getattr(flexopt.outcome(EXCAVATOR, posture, base=x, loop=loop), name))
                best = max(best, value if math.isfinite(value) else -math.inf)
        worst = min(worst, best)
    return worst


@pytest.mark.parametrize("name", ["decay", "swing"])
def test_no_placement_of_a_scan_is_better(name: str) -> None:
    found = flexopt.select_stand(EXCAVATOR, TARGETS, objective=name, loop=LOOP, base_range=PART, workers=1)
    assert isinstance(found, OutcomeStand)
    sign = -1.0 if name == "swing" else 1.0
    best = max(told(name, float(x), LOOP) for x in np.linspace(*PART, 25))
    assert sign * found.worth >= best - 1e-6 * abs(best)
    each = [getattr(place.evaluation.outcome, name) for place in found.places]
    np.testing.assert_allclose(found.V, each, rtol=1e-9)
    assert found.worth == pytest.approx(min(each) if sign > 0 else max(each), rel=1e-9)
    for place, target in zip(found.places, TARGETS, strict=True):
        np.testing.assert_allclose(place.evaluation.end_point, target, atol=1e-8)
        np.testing.assert_array_equal(place.evaluation.base, found.base)
    assert f"objective {name}" in repr(found)
    assert found.to_dict()["measure"] == name
    # What a report says of it.
    report: Any = SimpleNamespace(problem=found.problems[0], selection=found)
    assert f"Objective {name}, Jacobian inverse control" in problem_page._sentence(report)
    told_there = [each.remark.removesuffix(", the worst") for each in problem_page._listed(report)]
    assert told_there == [f"{name} {number(value, 4)} {found.unit}" for value in found.V]


def test_gains_are_chosen_with_the_placement() -> None:
    """Beside differential evolution over placement and gains, in one elbow's zone."""
    ranges = {"kp": (1e3, 1e5), "kv": (1e2, 1e4)}
    loop = {"kp_range": ranges["kp"], "kv_range": ranges["kv"], "dead_time": 0.02}
    found = flexopt.select_stand(EXCAVATOR, TARGETS, objective="decay", loop=loop, base_range=PART, starts=3, workers=1)
    assert isinstance(found, OutcomeStand)
    other: Any = differential_evolution(
        lambda x: -max(told("decay", x[0], {"kp": math.exp(x[1]), "kv": math.exp(x[2]), "dead_time": 0.02}), -10.0),
        [PART, *(tuple(np.log(ends)) for ends in ranges.values())],
        maxiter=4, popsize=5, rng=0, polish=False,
    )  # fmt: skip
    assert found.worth >= -other.fun * (1 - 1e-6)
    assert set(found.gains) == {"kp", "kv"}


def test_what_does_not_go_together() -> None:
    for options, sentence in (
        ({"objective": "decay", "combine": "weighted"}, "must be 'worst'"),
        ({"objective": "decay,w1"}, "must be a single one"),
        ({"objective": "w1", "loop": LOOP}, "goes with an objective of the loop"),
    ):
        with pytest.raises(flexopt.InputError, match=sentence):
            flexopt.select_stand(EXCAVATOR, TARGETS, **options)
    with pytest.raises(flexopt.InputError, match="it wants a loop"):
        flexopt.plan_base(EXCAVATOR, TARGETS, objective="decay")


def test_bounds_hold_at_every_target() -> None:
    loop = LOOP
    found = flexopt.select_stand(
        EXCAVATOR,
        TARGETS,
        objective="w1",
        loop=loop,
        constraints={"outcome": {"decay": 0.005}},
        base_range=PART,
        starts=3,
        workers=1,
    )
    assert all(place.constraints["decay"].value >= 0.005 * (1 - 2e-6) for place in found.places)
