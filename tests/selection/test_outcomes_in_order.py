"""Objectives in order with measures of the loop: what is kept is kept, and a scan that climbs nothing sees no better."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

import flexopt
from flexopt.selection.outcomes.result import OutcomeSelection
from tests.selection.loops import EXCAVATOR, TARGET, posture_at, told, worth

LOOP = {"kp": 1e4, "kv": 1e3, "dead_time": 0.0031}


@pytest.mark.long
@pytest.mark.parametrize("objective", ["w1,decay", "decay,w1", "decay,allowance", "decay,epsilon_max"])
def test_no_point_of_a_scan_keeps_the_first_and_has_more_of_the_second(objective: str) -> None:
    first, second = objective.split(",")
    found = flexopt.select(EXCAVATOR, TARGET, objective=objective, loop=LOOP, slack=0.2, starts=8, workers=1)
    assert isinstance(found, OutcomeSelection)
    (kept,), e = found.kept, found.best.evaluation
    assert kept.objective == first
    here = float(e.base[0]), tuple(e.posture.tolist())
    # The climbs keep their bounds to a millionth.
    room = 1e-5 * abs(kept.best - kept.at_least)
    assert told(first, *here, LOOP) >= kept.at_least - room
    assert found.best.objective == pytest.approx(told(second, *here, LOOP), rel=1e-6, abs=1e-12)
    best_first = best = -math.inf
    for x, elbow in itertools.product(np.linspace(-3.3, 3.3, 61).tolist(), ("up", "down")):
        posture = posture_at(x, elbow)
        if posture is None:
            continue
        value = worth(first, x, posture, LOOP)
        best_first = max(best_first, value)
        if value >= kept.at_least:
            best = max(best, worth(second, x, posture, LOOP))
    assert kept.best >= best_first - 1e-12
    assert best > -math.inf
    assert found.best.objective >= best - 1e-6 * abs(best)
    unit = {"decay": "1/s", "delay_margin": "s", "w1": "1/(kg m2)"}[first]
    assert f"{first} kept: at least {kept.at_least:.6g} {unit}, " in repr(found)
    assert f"objective {objective}:" in repr(found)
    asked = found.provenance["options"]
    assert (asked["objective"], asked["slack"]) == (objective, 0.2)
    assert [each["name"] for each in asked["objectives"]] == [first, second]
    assert found.to_dict()["kept"][0]["at_least"] == kept.at_least


@pytest.mark.long
def test_gains_are_kept_with_the_configuration() -> None:
    """The largest decay by gains, then of all that decay nearly as fast the one that bears most."""
    loop = {"kp_range": (1e3, 1e5), "kv_range": (1e2, 1e4), "dead_time": 0.01}
    options = {"loop": loop, "base": 0.5, "starts": 4, "workers": 1, "base_range": (0.4, 0.6)}
    fast = flexopt.select(EXCAVATOR, TARGET, objective="decay", **options)
    found = flexopt.select(EXCAVATOR, TARGET, objective="decay,delay_margin", slack=0.1, **options)
    assert found.kept[0].best == pytest.approx(fast.best.objective, rel=1e-6)
    assert found.best.evaluation.outcome.decay >= 0.9 * fast.best.objective * (1 - 1e-5)
    assert found.best.objective > fast.best.evaluation.outcome.delay_margin


def test_what_does_not_go_together() -> None:
    for options, sentence in (
        ({"objective": "decay,decay"}, "names the same objective twice"),
        ({"objective": "decay,w1", "weights": [1.0, 1.0, 1.0]}, "go with objective V only"),
        ({"objective": "speed,w1"}, "must be w1, w2"),
    ):
        with pytest.raises(flexopt.InputError, match=sentence):
            flexopt.select(EXCAVATOR, TARGET, loop=LOOP, **options)
    with pytest.raises(flexopt.InputError, match="it wants a loop"):
        flexopt.build_selection(EXCAVATOR, TARGET, objective="w1,decay")


@pytest.mark.long
def test_robust_margins_beside_what_a_loop_must_do() -> None:
    """Of a small part of the redundancy: ε_max first, a weighted sum with it, and ε_max where the decay is bounded."""
    options = {"loop": LOOP, "base_range": (-2.1, -1.4), "starts": 2, "workers": 1}
    places = [(x, posture_at(x, "up")) for x in np.linspace(-2.1, -1.4, 15).tolist()]
    margin, decay, w1 = (
        np.array([worth(name, *place, LOOP) for place in places]) for name in ("epsilon_max", "decay", "w1")
    )

    first = flexopt.select(EXCAVATOR, TARGET, objective="epsilon_max,decay", slack=1e-3, **options)
    kept = first.kept[0]
    assert kept.best >= margin.max() - 1e-9
    assert first.best.objective >= decay[margin >= kept.at_least].max() - 1e-9
    assert first.best.evaluation.epsilon_max >= kept.at_least - 1e-9

    weights = [1.0, 0.0, 0.0, 1e-3]
    mixed = flexopt.select(EXCAVATOR, TARGET, objective="decay,V", weights=weights, slack=0.05, **options)
    able = decay >= mixed.kept[0].at_least
    assert mixed.best.objective >= (w1 + 1e-3 * margin)[able].max() - 1e-10

    bounded = flexopt.select(
        EXCAVATOR, TARGET, objective="epsilon_max", constraints={"outcome": {"decay": 0.0155}}, **options
    )
    assert bounded.best.objective >= margin[decay >= 0.0155].max() - 1e-9
    assert bounded.best.evaluation.outcome.decay >= 0.0155 * (1 - 1e-5)


@pytest.mark.long
def test_who_compares_choices_is_told_what_else_was_asked() -> None:
    """Weights and slack of what is kept, too."""
    given = [
        {"objective": "decay"}, {"objective": "w1,decay"}, {"objective": "w1,decay", "slack": 0.05},
        {"objective": "V,decay", "weights": [1.0, 1.0, 1.0]}, {"objective": "V,decay", "weights": [1.0, 0.1, 0.0]},
    ]  # fmt: skip
    chosen = [flexopt.select(EXCAVATOR, TARGET, base=0.0, loop=LOOP, starts=2, workers=1, **each) for each in given]
    options = [each.provenance["options"] for each in chosen]
    assert [each["objective"] for each in options] == [each["objective"] for each in given]
    assert all(one != other for one, other in itertools.combinations(options, 2))
