"""One placement for several targets by what the loop does at the worst of them, beside scans that climb nothing."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import differential_evolution

import flexopt
from flexopt.model import tree_from_dict
from flexopt.selection.outcomes.measures import Decay
from flexopt.selection.outcomes.moves import OfMove
from flexopt.selection.several import outcome_stand
from flexopt.selection.several.by_loop import ByLoop
from flexopt.selection.several.others import other_stand
from flexopt.selection.several.outcome_stand import OutcomeStand
from flexopt.study.page import number
from flexopt.study.reports import page
from flexopt.study.verdicts.place_loops import configurations_of, held_at
from tests.oracles.spatial import in_space
from tests.selection.loops import EXCAVATOR, posture_at, worth
from tests.selection.several.redundant import HIGH, REDUNDANT, best_decays
from tests.study.machines import three_links

TARGETS = [(0.0, 1.6), (0.3, 1.3)]
LOOP = {"kp": 1e4, "kv": 1e3, "dead_time": 0.0031}
# Placements that are looked at.
PART = (-2.3, -1.4)


def worst(name: str, x: float, loop: dict[str, Any]) -> float:
    """The worst target's measure, of the better posture at each, such that more is better."""
    return min(
        max(worth(name, x, posture_at(x, elbow, target), loop) for elbow in ("up", "down")) for target in TARGETS
    )


@pytest.mark.long("decay")
@pytest.mark.parametrize("objective", ["V", "decay"])
def test_a_base_that_no_target_sees_stays_where_it_is(objective: str) -> None:
    """Of tasks of the height alone placements are all alike: one stand is told, where the machine stands."""
    data = in_space(EXCAVATOR.model_dump(by_alias=True))
    data["end_point"]["rows"] = ["z"]
    loop = LOOP | {"nullspace_damping": 3e3, "drive": "torque"}
    options: dict[str, Any] = {"base": 0.7, "starts": 2, "workers": 1, "objective": objective}
    given = options | ({"loop": loop} if objective == "decay" else {"weights": (1.0, 1.0, 1.0)})
    found = flexopt.select_stand(tree_from_dict(data), [(1.6,), (1.3,)], **given)
    assert found.base == 0.7
    assert [place.evaluation.end_point[0] for place in found.places] == pytest.approx([1.6, 1.3], abs=1e-8)
    assert not found.alternatives


@pytest.mark.long
@pytest.mark.parametrize("name", ["decay", "swing"])
def test_no_placement_of_a_scan_is_better(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # Points that are looked at first: enough for this part.
    monkeypatch.setattr(OfMove, "looked", 200)
    found = flexopt.select_stand(EXCAVATOR, TARGETS, objective=name, loop=LOOP, base_range=PART, starts=4, workers=1)
    assert isinstance(found, OutcomeStand)
    sign = -1.0 if name == "swing" else 1.0
    best = max(worst(name, x, LOOP) for x in np.linspace(*PART, 19).tolist())
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
    report: Any = SimpleNamespace(problem=found.problems[0], selection=found, about=found)
    assert f"Objective {name}, Jacobian inverse control" in page._sentence(report)
    told_there = [each.remark.removesuffix(", the worst") for each in page._listed(report)]
    assert told_there == [f"{name} {number(value, 4)} {found.unit}" for value in found.V]


@pytest.mark.long
@pytest.mark.parametrize("starts", [5, None])
def test_no_placement_of_a_redundant_arm_of_a_scan_is_better(starts: int | None) -> None:
    """The best posture of each target is narrower than the spacing of a few."""
    machine, best = three_links(), best_decays().min(axis=0).max()
    assert best > 0.015
    found = flexopt.select_stand(machine, HIGH, starts=starts, **REDUNDANT)
    assert found.worth >= best
    each = list[float]()
    for place, target in zip(found.places, HIGH, strict=True):
        own = place.evaluation
        np.testing.assert_array_equal(own.base, found.base)
        np.testing.assert_allclose(own.end_point, target, atol=1e-8)
        each.append(flexopt.outcome(machine, own.posture, base=own.base, loop=REDUNDANT["loop"]).decay)
    assert min(each) == pytest.approx(found.worth, rel=1e-9)


@pytest.mark.long
def test_gains_are_chosen_with_the_placement() -> None:
    """Beside differential evolution over placement and gains, in one elbow's zone."""
    ranges = {"kp": (1e3, 1e5), "kv": (1e2, 1e4)}
    loop = {"kp_range": ranges["kp"], "kv_range": ranges["kv"], "dead_time": 0.02}
    found = flexopt.select_stand(EXCAVATOR, TARGETS, objective="decay", loop=loop, base_range=PART, starts=3, workers=1)
    assert isinstance(found, OutcomeStand)
    other: Any = differential_evolution(
        lambda x: -max(worst("decay", float(x[0]), {"kp": math.exp(x[1]), "kv": math.exp(x[2]), "dead_time": 0.02}), -10.0),
        [PART, *(tuple(np.log(ends)) for ends in ranges.values())],
        maxiter=4, popsize=5, rng=0, polish=False,
    )  # fmt: skip
    assert found.worth >= -other.fun * (1 - 1e-6)
    assert set(found.gains) == {"kp", "kv"}


@pytest.mark.long
def test_where_the_base_stands_the_arm_is_held_for_the_gains_that_were_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside both elbows at each target."""
    monkeypatch.setattr(Decay, "looked", 100)
    ranges = {"kp_range": (1e3, 1e5), "kv_range": (1e2, 1e4)}
    base = -1.8
    options: dict[str, Any] = {"objective": "decay", "loop": ranges, "base": base, "base_range": PART, "starts": 1}
    for found in (
        flexopt.select_stand(EXCAVATOR, TARGETS, workers=1, **options),
        flexopt.plan_base(EXCAVATOR, TARGETS, times=[0.0, 5.0], max_base_rate=0.2, workers=1, **options),
    ):
        assert isinstance(found, ByLoop)
        for e, target in zip(configurations_of(found)["stay"], TARGETS, strict=True):
            postures = [posture_at(base, elbow, target) for elbow in ("up", "down")]
            each = [worth("decay", base, posture, found.gains) for posture in postures]
            assert worth("decay", base, tuple(e.posture), found.gains) == pytest.approx(max(each), rel=1e-9)


@pytest.mark.long
def test_another_placement_and_staying_have_the_loop_of_the_chosen_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """The default gains follow from a posture: those of the chosen stand are kept elsewhere, beside both elbows."""
    monkeypatch.setattr(Decay, "looked", 100)
    base = -1.8
    options: dict[str, Any] = {"objective": "decay", "loop": "default", "base": base, "workers": 1}
    found = flexopt.select_stand(EXCAVATOR, TARGETS, **options)
    assert isinstance(found, OutcomeStand)
    assert len(found.alternatives) >= 2
    loop = found.settings.fixed
    assert None not in (loop.kp, loop.kv)

    def decay(base: float, posture: Any) -> float:
        return flexopt.outcome(EXCAVATOR, posture, base=[base], loop=loop).decay

    for count, (told, (x,)) in enumerate(found.alternatives, start=2):
        other = other_stand(found, count)
        each = [decay(x, place.evaluation.posture) for place in other.places]
        np.testing.assert_allclose(other.V, each, rtol=1e-9)
        assert other.worth == pytest.approx(told, rel=1e-9)
        assert min(each) == pytest.approx(told, rel=1e-9)
        np.testing.assert_array_equal(other.base, [x])
        # The chosen one is then one of the others.
        assert other.number == count
        assert found.worth in [worth for worth, _ in other.alternatives]
        assert min(abs(base[0] - x) for _, base in other.alternatives) > 1e-3
        assert "0 m from this one" not in repr(other)
        for place, target in zip(other.places, TARGETS, strict=True):
            np.testing.assert_allclose(place.evaluation.end_point, target, atol=1e-8)
    for e, target in zip(configurations_of(found)["stay"], TARGETS, strict=True):
        each = [decay(base, posture_at(base, elbow, target)) for elbow in ("up", "down")]
        assert decay(base, e.posture) == pytest.approx(max(each), rel=1e-9)


@pytest.mark.long
def test_nothing_is_looked_at_twice_and_where_the_base_stands_the_arm_is_held_for_the_loop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Over one placement all postures of a fine sample are looked at, each once, and what is found is no worse."""
    machine, base = flexopt.load("boom-stick-bucket"), -3.0
    stand = flexopt.select_stand(
        machine, TARGETS, objective="decay", loop=LOOP, base=base, base_range=(-3.2, -2.8), starts=1, workers=1
    )
    looked, usual = list[np.ndarray](), outcome_stand.values_at

    def noted(target: Any, ys: list[np.ndarray], workers: int) -> list[float]:
        looked.append(np.array(ys))
        return usual(target, ys, workers)

    monkeypatch.setattr(outcome_stand, "values_at", noted)
    stay = configurations_of(stand)["stay"]
    assert len(looked) == len(TARGETS)
    held = [flexopt.outcome(machine, e.posture, base=e.base, loop=LOOP).decay for e in stay]
    best = []
    for problem, ys in zip(stand.problems, looked, strict=True):
        assert 12 < len(ys) == len(np.unique(ys, axis=0))
        postures = (ys * problem.scale)[:, 1:]
        best.append(max(flexopt.outcome(machine, q, base=base, loop=LOOP).decay for q in postures[::6]))
    np.testing.assert_array_equal([e.base for e in stay], [[base]] * len(TARGETS))
    assert min(held) >= min(best) * (1 - 1e-6)
    shown = held_at(stand, 0)
    assert shown is not None
    np.testing.assert_array_equal(shown.posture, stay[0].posture)
    # Where the base stands in one placement the choice is no worse than staying there.
    fixed = flexopt.select_stand(
        machine, TARGETS, objective="decay", loop=LOOP, base=base, base_range=(base, base), starts=1, workers=1
    )
    assert fixed.worth >= min(held) * (1 - 1e-6)


def test_what_does_not_go_together() -> None:
    for options, sentence in (
        ({"objective": "decay", "combine": "weighted"}, "must be 'worst'"),
        ({"objective": "decay,w1"}, "must be a single one"),
        ({"objective": "w1", "loop": LOOP}, "goes with an objective of the loop"),
    ):
        with pytest.raises(flexopt.InputError, match=sentence):
            flexopt.select_stand(EXCAVATOR, TARGETS, **options)


@pytest.mark.long
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


@pytest.mark.parametrize(("several", "low"), [(True, -1.703), (False, -1.703), (True, -2.2), (True, -1.95)])
def test_a_narrow_region_that_no_point_looked_at_is_in_is_found(*, several: bool, low: float) -> None:
    """3 mm wide; the same in a region of 1 m that is cut to it afterwards, whose points were looked at."""
    asked: dict[str, Any] = {"base": 0.0, "objective": "decay", "loop": {"kp": 1e4, "kv": 1e3}, "starts": 4}
    machine, targets = flexopt.load("excavator"), [(0.0, 1.6), (0.3, 1.3)]
    high = low + 0.003

    def chosen(region: tuple[float, float], **more: Any) -> Any:
        given = asked | more | {"constraints": {"region": [region]}}
        if several:
            return flexopt.select_stand(machine, targets, **given)
        return flexopt.select(machine, targets[0], **given)

    def at(answer: Any) -> tuple[float, float]:
        if several:
            return float(answer.base[0]), float(answer.worth)
        return float(answer.best.evaluation.base[0]), answer.best.objective

    (x, decay), wide = at(chosen((low, high))), at(chosen((-2.5, -1.2), base_range=(low, high)))
    assert low - 1e-7 <= x <= high + 1e-7
    assert (x, decay) == pytest.approx(wide, rel=1e-5)


@pytest.mark.long
def test_to_say_where_the_arm_is_now_makes_no_answer_worse() -> None:
    """In a region that nothing looked at is in, with the arm in it; and where it breaks what is asked for."""
    machine, loop = flexopt.load("excavator"), {"kp": 1e4, "kv": 1e3}
    asked: dict[str, Any] = {"objective": "decay", "loop": loop, "constraints": {"region": [(-1.703, -1.7)]}}
    now = flexopt.select(machine, (0.0, 1.6), base=-1.7015, posture=(-1.21299, 1.90080), **asked)
    assert now.best.objective == pytest.approx(flexopt.select(machine, (0.0, 1.6), base=0.0, **asked).best.objective)
    asked |= {"constraints": {"tool_angle": (-1.008, -1.0079)}}
    digger = flexopt.load("boom-stick-bucket")
    few = flexopt.select(digger, (7.17, 1.337), base=1.68, starts=1, **asked)
    assert few.best.objective == pytest.approx(flexopt.select(digger, (7.17, 1.337), starts=1, **asked).best.objective)


def test_what_keeps_targets_from_one_placement_is_told() -> None:
    """The constraint where they are reached, and what is out of reach where they are not."""
    asked: dict[str, Any] = {"base": 0.0, "objective": "decay", "loop": {"kp": 1e4, "kv": 1e3}, "starts": 2}
    machine = flexopt.load("excavator")
    with pytest.raises(flexopt.NoSolutionFound, match=r"in 2 starts .*violates .*target 1: manipulability by"):
        flexopt.select_stand(machine, [(0.0, 1.6), (0.3, 1.3)], constraints={"manipulability": 100.0}, **asked)
    with pytest.raises(flexopt.UnreachableTarget, match="the best reaches all but number 2"):
        flexopt.select_stand(machine, [(0.0, 1.6), (7.0, 1.3)], base_range=(-4.0, 5.0), **asked)


@pytest.mark.parametrize("objective", ["decay", "w1"])
@pytest.mark.parametrize("several", [True, False])
def test_a_wider_region_has_no_worse_an_answer(*, several: bool, objective: str) -> None:
    """A good slot of 3 mm, alone and beside a wide part that is worse."""
    asked: dict[str, Any] = {"base": 0.0, "objective": objective, "workers": 1}
    asked |= {"loop": {"kp": 1e4, "kv": 1e3}} if objective == "decay" else {}

    def worth(*region: tuple[float, float]) -> float:
        given: dict[str, Any] = asked | {"constraints": {"region": region}}
        if several:
            return flexopt.select_stand(EXCAVATOR, TARGETS, **given).worth
        return flexopt.select(EXCAVATOR, TARGETS[0], **given).best.objective

    slot = worth((-1.703, -1.7))
    assert worth((-1.703, -1.7), (0.0, 0.5)) >= slot - 1e-5 * abs(slot)


def test_a_slot_between_keep_outs_is_looked_into() -> None:
    """What areas to keep out of leave between them is one to stand in."""
    asked: dict[str, Any] = {"base": 0.0, "objective": "decay", "loop": {"kp": 1e4, "kv": 1e3}, "workers": 1}
    inside = flexopt.select_stand(EXCAVATOR, TARGETS, constraints={"region": [(-1.703, -1.7)]}, **asked)
    outside = {"keep_out": [(-9.0, -1.703), (-1.7, 0.0), (0.5, 9.0)]}
    between = flexopt.select_stand(EXCAVATOR, TARGETS, constraints=outside, **asked)
    assert between.worth == pytest.approx(inside.worth, rel=1e-6)


@pytest.mark.long("0.083244")
@pytest.mark.parametrize("tolerance", [0.083244, 0.05])
def test_a_wider_tool_angle_has_no_worse_an_answer(tolerance: float) -> None:
    """Few placements of a sample keep a thin angle: beside an even thinner one, and configurations that keep both."""
    digger, top = flexopt.load("boom-stick-bucket"), -1.001276
    targets, loop = [(6.2693, 1.7306), (5.4746, -0.1475)], {"kp": 10157.87, "kv": 219.498}

    def worth(tolerance: float) -> float:
        angle = {"tool_angle": (top - tolerance, top)}
        asked: dict[str, Any] = {"base": 0.0, "objective": "decay", "loop": loop, "workers": 1, "constraints": angle}
        return flexopt.select_stand(digger, targets, **asked).worth

    found = worth(tolerance)
    assert found >= worth(0.01) * (1 - 1e-5)
    if tolerance > 0.0833 - 1e-3:
        postures = (-0.77682357, -1.7211117, 0.03355938), (-1.06655898, -1.98670577, 0.50564462)
        known = [flexopt.outcome(digger, posture, base=[-0.61390439], loop=loop).decay for posture in postures]
        assert found >= min(known)


@pytest.mark.parametrize(
    ("target", "angle", "tolerance"),
    [
        ((-0.004564912908059049, 1.2494910647887383), -0.5452210818317111, 0.0023236464709276102),
        ((0.262280082457942, 0.8021060533511107), -1.1638384178355956, 0.001460898681179782),
    ],
)
def test_a_window_that_no_point_of_the_scan_is_in_counts_beside_one_that_some_are_in(
    target: tuple[float, float], angle: float, tolerance: float
) -> None:
    """Of a tool angle whose windows along the placements are narrower than the scan's spacing."""
    asked: dict[str, Any] = {"base": 0.0, "objective": "decay", "loop": {"kp": 1e4, "kv": 1e3}, "workers": 1}

    def decay(tolerance: float) -> float:
        given = {"tool_angle": (angle - tolerance, angle)}
        return flexopt.select(EXCAVATOR, target, constraints=given, **asked).best.objective

    tight = decay(tolerance / 10)
    assert decay(tolerance) >= tight * (1 - 1e-5)
