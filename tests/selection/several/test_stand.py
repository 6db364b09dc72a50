"""One placement for several targets: against a dense look at every placement, and every configuration checked anew."""

from __future__ import annotations

import itertools
import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import fsolve

import flexopt
from flexopt import FlexoptError, build_measures, build_selection, evaluate, inverse_kinematics, load, select
from flexopt.errors import InputError, UnreachableTarget
from flexopt.foundation.arrays import Vector
from flexopt.robustness import evaluate_w
from flexopt.selection import optima
from flexopt.selection.broken import broken
from flexopt.selection.nlp.program import Program
from flexopt.selection.proof import check
from flexopt.selection.several import Stand, select_stand, standing
from flexopt.study.verdicts.place_loops import held_from
from tests.oracles.lagrange import lagrange, rest_values, springs_and_dampers

TARGETS = [[0.0, 1.6], [0.3, 1.2], [-0.2, 1.9]]
MARGIN = math.sin(math.radians(10.0)) ** 2


@pytest.fixture(scope="module")
def excavator() -> flexopt.Machine:
    return load("excavator")


def best_at(machine: flexopt.Machine, target: list[float], x: float, alpha: list[float]) -> float:
    """V of the better elbow, from `evaluate`, one placement at a time."""
    values = [-math.inf]
    try:
        postures = inverse_kinematics(machine, target, base=x)
    except UnreachableTarget:
        return -math.inf
    for posture in postures:
        if math.sin(posture[-1]) ** 2 >= MARGIN:
            w = evaluate_w(build_measures(machine), [[x]], posture[:, None]).w
            values.append(float(np.dot(alpha, w[:, 0])))
    return max(values)


def dense(machine: flexopt.Machine, alpha: list[float], share: list[float] | None) -> float:
    """The best of 241 placements."""
    best = -math.inf
    for x in np.linspace(-3.2, 3.2, 241):
        values = [best_at(machine, target, float(x), alpha) for target in TARGETS]
        best = max(best, min(values) if share is None else float(np.dot(share, values)))
    return best


def check_places(machine: flexopt.Machine, stand: Stand) -> None:
    assert len(stand.places) == len(TARGETS)
    for place, target in zip(stand.places, TARGETS, strict=True):
        e = place.evaluation
        assert np.array_equal(e.base, stand.base)
        assert np.abs(e.end_point - target).max() < 1e-8
        again = evaluate(machine, e.posture, base=e.base)
        assert np.allclose(again.w, e.w, rtol=1e-12)
        assert math.sin(e.posture[-1]) ** 2 >= MARGIN - 1e-8
    assert stand.worst == int(np.argmin([place.objective for place in stand.places]))


@pytest.mark.long
def test_worst_is_at_least_that_of_a_dense_look(excavator: flexopt.Machine) -> None:
    stand = select_stand(excavator, TARGETS, workers=1)
    check_places(excavator, stand)
    scale = stand.problems[0].objective_scale
    assert stand.worth == min(place.objective for place in stand.places)
    assert stand.worth >= dense(excavator, [1.0, 0.0, 0.0], None) - 1e-9 * scale
    assert stand.stationarity < 1e-5


@pytest.mark.long
def test_weighted_sum_is_at_least_that_of_a_dense_look(excavator: flexopt.Machine) -> None:
    shares = np.array([1.0, 2.0, 3.0]) / 6
    stand = select_stand(
        excavator, TARGETS, combine="weighted", shares=[1, 2, 3], objective="V", weights=[1, 1, 1], workers=1
    )
    check_places(excavator, stand)
    assert stand.worth == pytest.approx(float(shares @ [place.objective for place in stand.places]), rel=1e-12)
    scale = stand.problems[0].objective_scale
    assert stand.worth >= dense(excavator, [1.0, 1.0, 1.0], shares.tolist()) - 1e-9 * scale
    worths = [stand.worth, *(worth for worth, _ in stand.alternatives)]
    assert worths == sorted(worths, reverse=True)


def test_one_target_is_a_selection(excavator: flexopt.Machine) -> None:
    stand = select_stand(excavator, [[0.0, 1.6]], objective="V", weights=[1, 1, 1], workers=1)
    single = select(excavator, [0.0, 1.6], objective="V", weights=[1, 1, 1], workers=1)
    assert stand.worth == pytest.approx(single.best.objective, abs=1e-8 * single.problem.objective_scale)
    assert stand.base == pytest.approx(single.best.evaluation.base, abs=1e-4)


def test_a_mode_that_nobody_sought_is_told_of_where_gains_excite_it(excavator: flexopt.Machine) -> None:
    found = flexopt.select_stand(excavator, [(0.0, 1.6), (0.2, 1.4)], starts=2, workers=1)

    def told(factor: float) -> str:
        e = found.places[1].evaluation
        bad = replace(found.places[1], evaluation=replace(e, w=np.array([0.0, 0.0, -factor * e.scale[2]])))
        good = replace(found.places[0], evaluation=replace(found.places[0].evaluation, w=np.zeros(3)))
        return replace(found, places=(good, bad)).unweighted

    assert told(0.9) == ""  # a and b lie less than 90° apart
    assert told(1.1).startswith("the objective leaves w3 out: -")
    assert "at target 2, where equal gains take damping from mode 3" in told(1.1)
    every = flexopt.select_stand(
        excavator, [(0.0, 1.6), (0.2, 1.4)], starts=2, workers=1, objective="V", weights=[1, 1, 1]
    )
    assert every.unweighted == ""


@pytest.mark.long
def test_an_epsilon_that_nobody_sought_is_told_of_where_it_is_small(excavator: flexopt.Machine) -> None:
    found = flexopt.select_stand(excavator, [(0.0, 1.6), (0.2, 1.4)], starts=2, workers=1)
    assert found.left_out == ""
    thin = replace(found.places[1], evaluation=replace(found.places[1].evaluation, epsilon_max=0.1))
    told = replace(found, places=(found.places[0], thin))
    assert told.left_out == "the objective leaves ε_max out: 0.1 at target 2, of 0.3827 of a rigid machine"
    assert told.left_out in repr(told)
    assert "  0.100000" in repr(told)
    # Every w_i, once; a rigid part that is not passive; others that are as good.
    assert repr(found).count(" w1 ") == 1
    assert " w2 " in repr(found)
    assert f"{found.places[1].evaluation.w[2]:13.4e}" in repr(found)
    assert "rigid part" not in repr(found)
    rigid = replace(found.places[1], evaluation=replace(found.places[1].evaluation, rigid=-0.5))
    active = repr(replace(found, places=(found.places[0], rigid)))
    assert "λmin(R0 + R0ᵀ) is negative at target 2, -5.00000e-01 1/(kg m2): equal gains" in active
    others = ((found.worth, found.base + 1.0), (found.worth, found.base - 2.0), (found.worth - 1.0, found.base + 9.0))
    assert (
        "equals: 2 other placements found are as good, to 0.0001 of the objective's scale, 1 to 2 m from this one"
        in repr(replace(found, alternatives=others))
    )
    assert "among equals" not in repr(replace(found, alternatives=others[2:]))
    # Bars that are 0 are said to be.
    bare = replace(found, places=tuple(replace(place, objective=0.0) for place in found.places))
    written = [text.get_text() for drawn in (found, bare) for axes in drawn.plot().axes for text in axes.texts]
    assert written.count("0 at every target") == 1
    # What is equal has no worst.
    far = [replace(place, objective=value) for place, value in zip(found.places, (-1.0, -2.0), strict=True)]
    assert "the worst" in repr(replace(found, places=tuple(far)))
    assert "the worst" not in repr(replace(found, places=(far[0], far[0])))


def test_no_more_starts_are_counted_than_are_asked_for(
    excavator: flexopt.Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Better postures that are seen at an optimum, as of arms in space, are climbed from, and are no starts."""
    monkeypatch.setattr(standing, "_exchanged", lambda program, x, seed: x)
    found = select_stand(excavator, TARGETS[:2], starts=1, workers=1)
    assert (found.attempts, found.further) == ((1, 1), 1)
    assert "1 of 1 start led to a verified placement for 2 targets, and 1 further climb" in found.status


def test_number_of_workers_does_not_matter(excavator: flexopt.Machine) -> None:
    one, two = (select_stand(excavator, TARGETS, objective="w2", starts=4, workers=n) for n in (1, 2))
    assert one.to_dict() == two.to_dict()


@pytest.mark.long
def test_constraints_hold_at_every_target(excavator: flexopt.Machine) -> None:
    free = select_stand(excavator, TARGETS, objective="w2", workers=1)
    x = float(free.base[0])
    constraints = {"keep_out": [[x - 0.3, x + 0.3]], "manipulability": 0.5}
    stand = select_stand(excavator, TARGETS, objective="w2", constraints=constraints, workers=1)
    assert abs(float(stand.base[0]) - x) >= 0.3 - 1e-7
    for place in stand.places:
        assert place.constraints["manipulability"].value >= 0.5 - 1e-7
    assert stand.worth <= free.worth + 1e-9 * free.problems[0].objective_scale


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"targets": []}, "targets = []: must be a list of 1 to"),
        ({"targets": [[0.0, 1.6], [math.nan, 1.0]]}, "targets[1]"),
        ({"targets": [[0.0, 1.6, 2.0]]}, "targets[0]"),
        ({"targets": 3}, "must be a list"),
        ({"combine": "best"}, "combine"),
        ({"shares": [1, 2, 3]}, "shares"),
        ({"combine": "weighted", "shares": [1, 2]}, "needs 3 numbers"),
        ({"combine": "weighted", "shares": [1, 0, 2]}, "entry 2"),
        ({"objective": "epsilon_max"}, "without ε_max"),
        ({"objective": "w1,w2"}, "a single one"),
        ({"workers": 0}, "workers"),
    ],
)
def test_bad_input(excavator: flexopt.Machine, given: dict[str, object], words: str) -> None:
    with pytest.raises(InputError) as caught:
        select_stand(excavator, **({"targets": TARGETS} | given))  # pyright: ignore[reportArgumentType]
    assert words in str(caught.value)


def test_every_unreachable_target_is_named(excavator: flexopt.Machine) -> None:
    with pytest.raises(UnreachableTarget) as caught:
        select_stand(excavator, [[0.0, 1.6], [0.0, 30.0], [0.0, -30.0]])
    assert "targets[1]" in str(caught.value)
    assert "targets[2]" in str(caught.value)
    assert "targets[0]" not in str(caught.value)


@pytest.mark.parametrize("far", [2.0 * 4.5, 100.0])
def test_targets_too_far_apart(excavator: flexopt.Machine, far: float) -> None:
    with pytest.raises(FlexoptError) as caught:
        select_stand(excavator, [[0.0, 1.6], [far, 1.6]])
    assert isinstance(caught.value, UnreachableTarget)
    assert "no placement reaches all of the 2 targets" in str(caught.value)


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 2])
def test_three_times_as_many_starts_find_hardly_more(seed: int) -> None:
    """Three joints leave two degrees of freedom and many summits; the scale is what V is divided by."""
    machine, rng = load("boom-stick-bucket"), np.random.default_rng(seed)
    targets = np.column_stack([rng.uniform(-2, 2, 3), rng.uniform(-3, 2, 3)])
    few = select_stand(machine, targets, objective="V", weights=[1, 1, 1], workers=1)
    many = select_stand(machine, targets, objective="V", weights=[1, 1, 1], starts=96, seed=1, workers=1)
    # Over eight sets of targets the difference is 0.006 at most.
    assert few.worth >= many.worth - 0.01 * few.problems[0].objective_scale


@pytest.mark.parametrize("combine", ["worst", "weighted"])
@pytest.mark.parametrize("weights", [[1.0, 0.0, 0.0], [1.0, 0.3, 0.3]])
def test_a_stand_for_one_target_is_a_choice_for_it(
    excavator: flexopt.Machine, combine: str, weights: list[float]
) -> None:
    """V = w_1 is 0 on a whole line of optima, which no second variable may hide."""
    asked = {"objective": "V", "weights": weights, "starts": 6}
    stand = select_stand(excavator, [(0.0, 1.6)], combine=combine, **asked)
    best = select(excavator, (0.0, 1.6), **asked).best
    assert stand.worth == pytest.approx(best.objective, rel=1e-7, abs=1e-12)
    assert "1 target from" in repr(stand)
    assert "the worst" not in repr(stand)
    assert stand.shown_objective[0] == (0.0 if weights[1] == 0.0 else stand.worth)


@pytest.mark.long
def test_an_end_that_could_not_be_verified_is_told(excavator: flexopt.Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    options: dict[str, Any] = {"objective": "w2", "starts": 6, "workers": 1}
    whole = select_stand(excavator, TARGETS[:2], **options)
    assert whole.unverified is None
    assert whole.to_dict()["unverified"] is None
    low = whole.alternatives[0][0]

    def doubted(program: Program, x: Vector) -> check.Proof:
        proof = check.prove_program(program, x)
        violations = {"second-order optimality": 1.0} if program.worth(x) > low + 1e-3 * abs(low) else {}
        return replace(proof, violations=proof.violations | violations)

    monkeypatch.setattr(optima, "prove_program", doubted)
    monkeypatch.setattr(standing, "not_below", lambda program, good, seen, what: good)
    lesser = select_stand(excavator, TARGETS[:2], **options)
    assert lesser.worth == pytest.approx(low, rel=1e-6)
    assert lesser.unverified == pytest.approx(whole.worth, rel=1e-6)
    assert f"a climb that could not be verified came to w2 {whole.worth:.6g}" in repr(lesser)


@pytest.mark.long
def test_among_places_of_equal_worth_the_nearest_to_the_present_one_is_chosen() -> None:
    """Machine and targets are symmetric, so every optimum has a mirror image of the same worth."""
    machine, chosen = flexopt.load("slewing-excavator"), list[np.ndarray]()
    for side in (1.0, -1.0):
        present = np.array([9.0, 4.0 * side, 2.0 * side])
        stand = flexopt.select_stand(
            machine, [(6.0, -3.0, 2.2), (6.0, 3.0, 2.2)], objective="w1", base=present.tolist(), starts=4, workers=1
        )
        ties = [
            base
            for worth, base in stand.alternatives
            if worth >= stand.worth - 1e-9 * stand.problems[0].objective_scale
        ]
        assert ties
        scale = stand.problems[0].scale[:3]
        away = [np.linalg.norm((base - present) / scale) for base in (stand.base, *ties)]
        assert away[0] == min(away)
        chosen.append(stand.base)
    np.testing.assert_allclose(chosen[1], chosen[0] * [1.0, -1.0, -1.0], rtol=0, atol=1e-6)


@pytest.mark.filterwarnings("ignore::flexopt.ImplausibleMachine")
@pytest.mark.parametrize("gap", [0.05, 0.3])
def test_a_window_of_a_whole_turn_holds_the_stands_of_a_free_joint(excavator: flexopt.Machine, gap: float) -> None:
    """Worth of every placement found; at one of them a climb is stopped by the joint's end at one target, or at both."""
    targets, asked = [[0.0, 1.6], [0.3, 1.4]], {"base": 0.0, "starts": 4, "objective": "w1"}
    free = select_stand(excavator, targets, **asked)
    data, stick = excavator.to_dict(), float(free.places[0].evaluation.posture[1])
    data["links"][1]["limits"] = sorted([stick - gap, stick - (gap + 0.1 + math.tau)])
    held = select_stand(flexopt.machine_from_dict(data), targets, assume="limits", **asked)
    worths = [[found.worth, *(worth for worth, _ in found.alternatives)] for found in (held, free)]
    np.testing.assert_allclose(*worths, rtol=1e-6)


def test_what_no_placement_keeps_at_all_targets_is_named(excavator: flexopt.Machine) -> None:
    """Beside a dense look at placements, with elbows in closed form: each target alone is reached with the angle."""
    data, targets, (low, high) = excavator.to_dict(), np.array([[0.0, 1.6], [0.8, 0.6]]), (-0.3, -0.2)
    (one, other), base = (link["length"] for link in data["links"]), data["base"]
    shoulder = base["length"] * np.array([math.cos(base["rest_angle"]), math.sin(base["rest_angle"])])
    x = np.linspace(-4.0, 4.0, 8001)
    away = targets[:, :, None] - shoulder[:, None] - np.array([x, 0 * x])
    cosine = ((away**2).sum(axis=1) - one**2 - other**2) / (2 * one * other)
    elbow = np.arccos(np.where(abs(cosine) < 1, cosine, np.nan))
    short = np.inf
    for turn in (elbow, -elbow):
        arm = np.arctan2(away[:, 1], away[:, 0]) - np.arctan2(other * np.sin(turn), one + other * np.cos(turn))
        angle = np.angle(np.exp(1j * (arm + turn)))
        short = np.fmin(short, np.maximum(np.maximum(low - angle, angle - high), 0.0))
    short = np.where(np.isnan(elbow), np.inf, short)
    assert (short.min(axis=1) == 0).all()
    with pytest.raises(flexopt.NoSolutionFound) as caught:
        select_stand(excavator, targets, base=0.0, constraints={"tool_angle": (low, high)}, starts=2)
    found = re.search(r"placements that reach all .* none keeps tool angle, (\S+) rad short at best", str(caught.value))
    assert found is not None
    least = short.max(axis=0).min()
    assert least - 1e-3 < float(found[1]) < 1.2 * least
    with pytest.raises(flexopt.NoSolutionFound, match=r"target 1: of \d+ .* none keeps tool angle"):
        select_stand(excavator, targets, base=0.0, constraints={"tool_angle": (-1.5, -1.4)}, starts=2)


def test_of_a_redundant_arm_what_its_limits_leave_is_found_however_thin() -> None:
    """Beside a scan of the last link's direction, the two joints before it by the law of cosines: is a target reached?"""
    data, limits = flexopt.load("boom-stick-bucket").to_dict() | {"cylinders": []}, (-1.57, -1.56)
    data["links"][1]["limits"] = limits
    machine, base = flexopt.machine_from_dict(data), data["base"]
    lengths, turn = [link["length"] for link in data["links"]], base["rest_angle"]
    low, high = np.array([link["limits"] for link in data["links"]]).T[:, :, None]
    last, seen = np.linspace(-math.pi, math.pi, 20001), set[bool]()
    for x, height in itertools.product((-3.0, -1.0, 1.0), (-1.0, 0.0, 1.0)):
        first = np.array([x + base["length"] * math.cos(turn), base["length"] * math.sin(turn)])
        wrist = np.array([[6.0], [height]]) - lengths[2] * np.array([np.cos(last), np.sin(last)]) - first[:, None]
        cosine = (np.sum(wrist**2, axis=0) - lengths[0] ** 2 - lengths[1] ** 2) / (2 * lengths[0] * lengths[1])
        stick = -np.arccos(np.where(np.abs(cosine) <= 1, cosine, np.nan))  # limits leave one elbow
        ahead = np.arctan2(lengths[1] * np.sin(stick), lengths[0] + lengths[1] * np.cos(stick))
        boom = np.arctan2(wrist[1], wrist[0]) - ahead - turn
        postures = np.array([boom, stick, last - turn - boom - stick])
        postures += math.tau * np.ceil((low - postures) / math.tau)
        reached = bool(np.any(np.all(postures <= high, axis=0)))
        problem = build_selection(machine, (6.0, height), base=x, base_range=(-8, 4), objective="w1", assume="limits")
        held = held_from([problem], np.array([x]), allowed=False)
        assert (held is not None) == reached
        seen.add(reached)
        if held is not None:
            assert np.all((held[0].posture >= low[:, 0] - 1e-7) & (held[0].posture <= high[:, 0] + 1e-7))
            assert broken(problem, held[0].z) == ""
            assert np.abs(held[0].end_point - problem.target).max() < 1e-7
    assert seen == {False, True}


def test_a_stand_reaches_what_only_the_sagging_machine_does():
    """One of its targets is 3 mm beyond the reach with springs unloaded; the base stands still."""
    machine = flexopt.load("excavator")
    arm = flexopt.build_plant(machine).arm_segments(p=flexopt.build_plant(machine).parameter_values)
    far = arm["first_joint"].full().ravel() + np.array([float(arm["lengths"].full().sum()) + 0.003, 0.0])
    targets = [(1.5, 1.0), far]
    asked = {"base": 0.0, "base_range": (0.0, 0.0), "starts": 2, "workers": 1}
    with pytest.raises(flexopt.UnreachableTarget):
        flexopt.select_stand(machine, targets, **asked)
    stand = flexopt.select_stand(machine, targets, gravity=True, **asked)
    for target, place in zip(targets, stand.places, strict=True):
        held = flexopt.evaluate(machine, place.evaluation.posture, base=place.evaluation.base, gravity=True)
        np.testing.assert_allclose(held.end_point, target, atol=1e-8)


def test_the_sag_is_told_of_each_coordinate_where_it_is_most(excavator: flexopt.Machine) -> None:
    """SciPy's root of Lagrange's equations at every target, to the three digits that are told."""
    data = excavator.model_dump(by_alias=True, exclude_none=True)
    oracle, springs = lagrange(data), springs_and_dampers(data)[0]
    stand = select_stand(excavator, TARGETS, gravity=True, starts=1, workers=1)
    sags = list[Vector]()
    for place in stand.places:
        rest = rest_values(data, float(place.evaluation.base[0]), place.evaluation.posture)

        def unbalanced(passive: Vector, rest: Vector = rest) -> Vector:
            q = np.concatenate([passive, rest[3:]])
            gravity = oracle.dynamics.call([q, np.zeros(5), 0.0])[2].full().ravel()
            return (springs @ (q - rest) + gravity)[:3]

        sags.append(fsolve(unbalanced, rest[:3], xtol=1e-12) - rest[:3])
    x, y, rotation = np.array(sags).T
    # No force acts along x, and the weight is the same everywhere; the arm reaches farther to one target than to others.
    assert np.abs(x).max() < 1e-9
    k = int(np.abs(rotation).argmax())
    assert np.sort(np.abs(rotation))[-2] < 0.99 * abs(rotation[k])
    told = f"{y[0]:.3g} m at every target, base.rotation {rotation[k]:.3g} rad at target {k + 1}"
    where = "from where the file has it with springs unloaded, each coordinate's most"
    assert f"sag under the weight, {where}: base.y {told}" in stand.remarks
    assert stand.worst != k
