"""Choices that leave a file's limits out: verdicts run there as if the file had wider ones, and say so."""

from __future__ import annotations

import json
import re
from itertools import product
from typing import Any, cast

import numpy as np
import pytest

import flexopt
from flexopt.loop.evaluation import settings_at
from flexopt.loop.uncertain import UncertainLoop
from flexopt.loop.uncertainty_box import UncertaintyBox
from flexopt.model.beyond_limits import beyond_limits, holding
from flexopt.model.uncertainty import GROUND
from flexopt.study.verdicts.confirmation import nonlinear_runs

BUCKET = flexopt.load("boom-stick-bucket")


def limited(boom: tuple[float, float], stick: tuple[float, float]) -> Any:
    data = flexopt.load("excavator").to_dict()
    links = zip(data["links"], (boom, stick), strict=True)
    return flexopt.machine_from_dict(data | {"links": [link | {"limits": list(ends)} for link, ends in links]})


@pytest.mark.long
def test_a_verdict_beyond_left_out_limits_is_that_of_a_machine_with_wider_ones() -> None:
    """No equation knows limits: a file with wider ones, which are kept, has the same runs, and nothing to tell."""
    narrow, wide = limited((0.9, 1.1), (-2.7, -2.5)), limited((-6.0, 6.0), (-6.0, 6.0))
    asked: dict[str, Any] = {"base": 0.0, "starts": 4, "seed": 1, "assume": "nothing"}
    chosen, other = (flexopt.select(each, (0.0, 1.6), **asked) for each in (narrow, wide))
    runs: dict[str, Any] = {"loop": {"kp": 1e4, "kv": 1e3}, "members": 4, "runs": 1, "duration": 5.0}
    found, same = flexopt.verdict(chosen, **runs), flexopt.verdict(other, **runs)
    assert found.sentence == same.sentence
    assert found.judged == same.judged
    for place, twin in zip(found.places, same.places, strict=True):
        assert place.runs is not None
        assert twin.runs is not None
        assert place.runs.verdicts == twin.runs.verdicts
        # The same loop, compiled again: rounding alone.
        np.testing.assert_allclose(place.runs.turn, twin.runs.turn, rtol=1e-6)
        assert not twin.beyond_limits
        boom, stick = place.posture.tolist()
        outside = [name for name, q, (low, high) in (("boom", boom, (0.9, 1.1)), ("stick", stick, (-2.7, -2.5)))
                   if not low <= q <= high]  # fmt: skip
        assert bool(outside) == bool(place.beyond_limits)
        assert all(f"{name} at " in place.beyond_limits for name in outside)
        assert place.beyond_limits in repr(found)
    there = next(place for place in found.places if place.name == found.place)
    assert "beyond the limits of the machine's file, which are left out (assume)" in there.beyond_limits
    document = json.loads(json.dumps(found.to_dict()))
    assert [place["beyond_limits"] for place in document["places"]] == [each.beyond_limits for each in found.places]
    assert "beyond the limits of the machine" in found._html()
    # The choice itself tells it of its candidates.
    told = chosen.beyond_limits
    assert told
    assert all(sentence in repr(chosen) for sentence in told)
    assert chosen.to_dict()["beyond_limits"] == list(told)
    assert not other.beyond_limits
    # What a user asks for keeps the limits.
    with pytest.raises(flexopt.InputError, match="must lie between"):
        flexopt.simulate_ensemble(narrow, there.posture, base=there.base, vary={"kp": [1e4]})


def test_limits_that_hold_a_posture_are_those_of_a_file_beside() -> None:
    """Both of a joint without and of one with a cylinder; where the linkage does not close nothing does."""
    within = np.array([-1.0, -1.2, -0.7])
    assert holding(BUCKET, within) is BUCKET
    (low, high), *_ = BUCKET.limits
    beyond = np.array([high + 0.01, -1.2, -0.7])
    wider = holding(BUCKET, beyond)
    assert wider.limits[0] == pytest.approx((low, high + 0.01))
    assert wider.limits[1:] == BUCKET.limits[1:]
    assert wider.parameters == BUCKET.parameters
    crane = flexopt.load("slewing-excavator")
    turned = np.array([0.0, crane.limits[1][1] + 0.2, -1.2, -0.5])
    assert holding(crane, turned).limits[1] == pytest.approx((crane.limits[1][0], turned[1]))


@pytest.mark.parametrize("name", ["boom-stick-bucket", "slewing-excavator", "truck-crane"])
def test_limits_hold_a_posture_or_there_are_none(name: str) -> None:
    """One joint at a time all the way around, past dead centres of its cylinder, too."""
    machine = flexopt.load(name)
    middle = np.clip(machine.limits, -1.0, 1.0).mean(axis=1)
    held, refused = 0, list[str]()
    for joint, q in product(range(len(middle)), np.linspace(-3.1, 3.1, 63).tolist()):
        posture = middle.copy()
        posture[joint] = q
        try:
            low, high = holding(machine, posture).limits[joint]
        except flexopt.InputError as error:
            refused.append(str(error))
        else:
            # To rounding of a stroke's end, found by bisection of a length that is.
            assert low - 1e-9 <= q <= high + 1e-9
            held += 1
    assert held > 0
    assert any("beyond a dead centre" in each for each in refused) == (name != "truck-crane")


@pytest.mark.parametrize("off", [2e-6, 5e-6, 1e-4, 0.05, 0.3])
@pytest.mark.parametrize("name", ["boom-stick-bucket", "mobile-manipulator", "truck-crane"])
def test_a_joint_beyond_its_limits_is_told_apart_from_them(name: str, off: float) -> None:
    machine = flexopt.load(name)
    for end, sign in ((0, -1.0), (1, 1.0)):
        told = beyond_limits(machine, np.array(machine.limits)[:, end] + sign * off)
        assert len(told) == len(machine.joints)
        for each in told:
            q, low, high = map(float, re.findall(r"-?\d[\d.e+-]*", each[each.index(" at ") :]))
            assert (q > high) if end else (q < low)


@pytest.mark.parametrize("bucket", [1.31, 1.5])
def test_where_no_limits_hold_a_posture_runs_say_so(bucket: float) -> None:
    """Past a dead centre, so that a stroke ends before or has two ranges: a place there is undecided, and no error."""
    posture, base = np.array([-1.0, -1.2, bucket]), np.zeros(1)
    with pytest.raises(flexopt.InputError):
        holding(BUCKET, posture)
    loop = flexopt.Loop(drive="torque", kp=1e4, kv=1e4)
    settings, _ = settings_at(BUCKET, np.array([-1.0, -1.2, -0.7]), base, None, loop, gravity=False, call="test")
    box = UncertaintyBox(BUCKET, GROUND, settings.dead_time)
    runs = nonlinear_runs(UncertainLoop(settings, base, posture, False, box), np.ones((1, 1)), np.array([0.1]), 1.0)
    assert runs.verdicts == ("undecided",)
    assert cast(str, runs.reasons[0]).startswith("no run holds the arm beyond its limits: ")


@pytest.mark.long
def test_a_report_has_gains_for_what_limits_hold_where_they_do_not_hold_what_is_chosen() -> None:
    asked: dict[str, Any] = {"base": 0.0, "assume": "ground,reach", "starts": 4, "seed": 0}
    problem = flexopt.build_selection(BUCKET, (4.0, 0.5), **asked)
    report = flexopt.report(problem, points=2)
    with pytest.raises(flexopt.InputError):
        holding(BUCKET, cast(flexopt.Selection, report.selection).best.evaluation.posture)
    assert list(report.loops) == ["present"]
    assert report.loops["present"].run.verdict == "converges"
    assert any(note.startswith("the closed loop, chosen: ") for note in report.notes)
