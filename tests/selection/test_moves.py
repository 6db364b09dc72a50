"""Configurations chosen by their standard move, settling and swing, beside scans that climb nothing."""

from __future__ import annotations

import itertools
from functools import cache

import numpy as np
import pytest

import flexopt
from flexopt.selection.outcomes.moves import OfMove
from flexopt.selection.outcomes.result import OutcomeSelection
from tests.selection.loops import EXCAVATOR, SMALL, TARGET, posture_at, told

LOOP = {"kp": 1e4, "kv": 1e3, "dead_time": 0.0031}


@pytest.fixture
def _few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Points that are looked at first: enough for these wide basins."""
    monkeypatch.setattr(OfMove, "looked", 200)


@cache
def scanned(name: str) -> np.ndarray:
    """A measure along the redundancy of both elbows."""
    places = itertools.product(np.linspace(-3.3, 3.3, 41).tolist(), ("up", "down"))
    found = ((x, posture_at(x, elbow)) for x, elbow in places)
    return np.array([told(name, x, posture, LOOP) for x, posture in found if posture is not None])


@pytest.mark.long
@pytest.mark.parametrize("name", ["settling", "swing"])
def test_no_point_of_a_scan_has_less(name: str, request: pytest.FixtureRequest) -> None:
    if name == "settling":
        request.getfixturevalue("_few")
    found = flexopt.select(EXCAVATOR, TARGET, objective=name, loop=LOOP, starts=8, workers=1)
    assert isinstance(found, OutcomeSelection)
    assert found.best.objective <= np.nanmin(scanned(name)) * (1 + 1e-6)
    e = found.best.evaluation
    assert found.best.objective == pytest.approx(getattr(e.outcome, name), rel=1e-6)
    # Candidates are ranked by it, and it reads as it is.
    assert [c.objective for c in found.candidates] == sorted(c.objective for c in found.candidates)
    assert f"objective {name}" in repr(found)
    assert found.to_dict()["measure"] == name


@pytest.mark.long
@pytest.mark.parametrize(("first", "second"), [("w1", "swing"), ("swing", "decay")])
@pytest.mark.usefixtures("_few")
def test_in_order(first: str, second: str) -> None:
    """What is kept is kept, and nothing of a scan that keeps it does better."""
    found = flexopt.select(EXCAVATOR, TARGET, objective=f"{first},{second}", loop=LOOP, slack=0.2, starts=8, workers=1)
    (kept,), outcome = found.kept, found.best.evaluation.outcome
    small = first in SMALL

    def keeps(values: np.ndarray, room: float = 0.0) -> np.ndarray:
        return values <= kept.at_most + room if small else values >= kept.at_least - room

    room = 1e-5 * abs(kept.best - (kept.at_most if small else kept.at_least))
    own = found.best.evaluation.w[0] if first == "w1" else getattr(outcome, first)
    assert keeps(np.array(own), room)
    sign = -1.0 if second in SMALL else 1.0
    values = sign * scanned(second)[keeps(scanned(first))]
    best = values[np.isfinite(values)].max()
    assert sign * found.best.objective >= best - 1e-6 * abs(best)
    assert f"{first} kept: at {'most' if small else 'least'}" in repr(found)


@pytest.mark.long
@pytest.mark.usefixtures("_few")
def test_bounds_bind_where_they_must() -> None:
    """The best w_1 without them swings more; with them no better place of a scan keeps them."""
    swings = scanned("swing")
    most = float(np.quantile(swings[np.isfinite(scanned("settling"))], 0.2))
    found = flexopt.select(EXCAVATOR, TARGET, loop=LOOP, constraints={"outcome": {"swing": most}}, starts=8, workers=1)
    kept = found.best.constraints["swing"]
    assert kept.upper == most
    assert kept.value <= most * (1 + 2e-6)
    assert found.best.objective >= scanned("w1")[swings <= most].max() - 1e-12
    with pytest.raises(flexopt.NoSolutionFound, match=r"settling at most 0\.01"):
        flexopt.select(EXCAVATOR, TARGET, loop=LOOP, constraints={"outcome": {"settling": 0.01}}, starts=2, workers=1)


@pytest.mark.long
def test_an_arm_that_drifts_everywhere_is_chosen_by_its_swing() -> None:
    """Under its weight it creeps away along its self-motion wherever it stands, which is no part of the swing."""
    machine, target = flexopt.load("boom-stick-bucket"), (4.65, 2.81)
    loop = {"drive": "torque", "kp": 1.8e4, "kv": 6.5e4, "nullspace_damping": 20.0, "rate": 200.0}
    found = flexopt.select(machine, target, objective="swing", loop=loop, gravity=True, starts=4, workers=1)
    chosen = found.best.evaluation.outcome
    assert isinstance(chosen, flexopt.Outcome)
    assert chosen.drift[0] > 0
    assert found.best.objective == pytest.approx(chosen.swing, rel=1e-6)
    points = [
        chosen.settings.outcome(machine, np.array([x]), posture, gravity=True)
        for x in np.linspace(-1.0, 2.5, 8).tolist()
        for posture in flexopt.inverse_kinematics(machine, target, base=x, gravity=True)[::4]
    ]
    decaying = [point for point in points if point.loop.stable]
    assert len(decaying) > 20
    assert all(point.loop.drift[0] > 0 for point in decaying)
    assert found.best.objective <= min(point.swing().value for point in decaying)
