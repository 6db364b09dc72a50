"""Configurations chosen by their standard move, settling and swing, beside scans that climb nothing."""

from __future__ import annotations

import itertools
import math
from functools import lru_cache

import numpy as np
import pytest

import flexopt
from flexopt.model.parameter_values import with_parameters
from flexopt.selection.outcomes.result import OutcomeSelection

EXCAVATOR, TARGET = flexopt.load("excavator"), (0.0, 1.6)
LOOP = {"kp": 1e4, "kv": 1e3, "dead_time": 0.0031}
STRAIGHT = math.radians(10.0)
Outcomes = list[tuple[float, "flexopt.Outcome"]]


@lru_cache(maxsize=4)
def scanned(points: int) -> Outcomes:
    """w_1 and what the loop does, along the redundancy of both elbows."""
    found: Outcomes = []
    for x, elbow in itertools.product(np.linspace(-3.3, 3.3, points), ("up", "down")):
        try:
            posture = flexopt.inverse_kinematics(EXCAVATOR, TARGET, base=x, elbow=elbow)[0]
        except flexopt.UnreachableTarget:
            continue
        if STRAIGHT <= abs(math.remainder(posture[1], math.tau)) <= math.pi - STRAIGHT:
            e = flexopt.evaluate(EXCAVATOR, posture, base=x, loop=LOOP)
            found.append((float(e.w[0]), e.outcome))
    return found


@pytest.mark.parametrize("name", ["settling", "swing"])
def test_no_point_of_a_scan_has_less(name: str) -> None:
    found = flexopt.select(EXCAVATOR, TARGET, objective=name, loop=LOOP, workers=1)
    assert isinstance(found, OutcomeSelection)
    values = np.array([getattr(outcome, name) for _, outcome in scanned(161)])
    assert found.best.objective <= np.nanmin(values) * (1 + 1e-6)
    e = found.best.evaluation
    assert found.best.objective == pytest.approx(getattr(e.outcome, name), rel=1e-6)
    # Candidates are ranked by it, and it reads as it is.
    assert [c.objective for c in found.candidates] == sorted(c.objective for c in found.candidates)
    assert f"objective {name}" in repr(found)
    assert found.to_dict()["measure"] == name


@pytest.mark.parametrize(("first", "second"), [("w1", "swing"), ("swing", "decay"), ("settling", "swing")])
def test_in_order(first: str, second: str) -> None:
    """What is kept is kept, and nothing of a scan that keeps it does better."""
    found = flexopt.select(EXCAVATOR, TARGET, objective=f"{first},{second}", loop=LOOP, slack=0.2, workers=1)
    (kept,), outcome = found.kept, found.best.evaluation.outcome
    small = first in ("settling", "swing")

    def keeps(w: float, other: flexopt.Outcome, room: float = 0.0) -> bool:
        value = w if first == "w1" else getattr(other, first)
        return value <= kept.at_most + room if small else value >= kept.at_least - room

    room = 1e-5 * abs(kept.best - (kept.at_most if small else kept.at_least))
    assert keeps(float(found.best.evaluation.w[0]), outcome, room)
    sign = -1.0 if second in ("settling", "swing") else 1.0
    values = [sign * getattr(other, second) for w, other in scanned(161) if keeps(w, other)]
    best = max(value for value in values if math.isfinite(value))
    assert sign * found.best.objective >= best - 1e-6 * abs(best)
    assert f"{first} kept: at {'most' if small else 'least'}" in repr(found)


def test_bounds_bind_where_they_must() -> None:
    """The best w_1 without them swings more; with them no better place of a scan keeps them."""
    swings = [outcome.swing for _, outcome in scanned(161) if math.isfinite(outcome.settling)]
    most = float(np.quantile(swings, 0.2))
    found = flexopt.select(EXCAVATOR, TARGET, loop=LOOP, constraints={"outcome": {"swing": most}}, workers=1)
    kept = found.best.constraints["swing"]
    assert kept.upper == most
    assert kept.value <= most * (1 + 2e-6)
    assert found.best.objective >= max(w for w, outcome in scanned(161) if outcome.swing <= most) - 1e-12
    with pytest.raises(flexopt.NoSolutionFound, match=r"settling at most 0\.01"):
        flexopt.select(EXCAVATOR, TARGET, loop=LOOP, constraints={"outcome": {"settling": 0.01}}, starts=2, workers=1)


def test_the_worst_over_a_soil_is_no_better_anywhere_in_it() -> None:
    found = flexopt.select(
        EXCAVATOR, TARGET, objective="swing", loop=LOOP, ranges={"stiffness": (0.8, 1.25)}, base_range=(-2.2, -1.4),
        starts=2, workers=1,
    )  # fmt: skip
    e = found.best.evaluation
    springs = [parameter.name for parameter in EXCAVATOR.parameters if "stiffness" in parameter.name]
    own = {parameter.name: parameter.value for parameter in EXCAVATOR.parameters}
    for factor in (0.8, 1.0, 1.25):
        soil = with_parameters(EXCAVATOR, {name: own[name] * factor for name in springs})
        value = flexopt.outcome(soil, e.posture, base=e.base, loop=LOOP).swing
        assert value <= found.best.objective * (1 + 1e-9)
