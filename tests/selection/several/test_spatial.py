"""Sets of targets and paths in space: a slewing excavator and a random tree, every result computed anew."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import flexopt
from flexopt import BasePlan, build_measures, build_selection, evaluate, plan_base, select_stand
from flexopt.selection.several import TargetConfiguration
from flexopt.selection.several.postures import reached_from
from flexopt.study.verdicts.place_loops import configurations_of, held_from
from tests.oracles.spatial import pinocchio_tree, random_tree

WEIGHTS = [1.0] * 6
CONSTRAINTS = {"holding": 0.9, "tip_over_margin": 0.3, "joint_margin": 0.03}
TRENCH = np.array([[x, 6.0, -1.0] for x in np.linspace(-1.0, 2.0, 4)])


@pytest.fixture(scope="module")
def excavator() -> flexopt.Tree:
    machine = flexopt.load("slewing-excavator")
    assert isinstance(machine, flexopt.Tree)
    return machine


@pytest.fixture(scope="module")
def plan(excavator: flexopt.Tree) -> BasePlan:
    return plan_base(
        excavator, TRENCH, objective="V", weights=WEIGHTS, constraints=CONSTRAINTS, duration=15.0, max_base_rate=0.1,
        starts=2, workers=1,
    )  # fmt: skip


def check_place(machine: flexopt.Tree, place: TargetConfiguration, target: np.ndarray, alpha: list[float]) -> None:
    """Target, V, limits and margin from `evaluate` and the constraints' own Functions."""
    e = place.evaluation
    again = evaluate(machine, e.posture, base=e.base)
    assert np.abs(again.end_point - target).max() < 1e-8
    assert place.objective == pytest.approx(float(np.dot(alpha, again.w)), rel=1e-9, abs=1e-20)
    plant = build_measures(machine).plant
    sine = float(plant.singularity_sine_squared(e.base, e.posture, plant.parameter_values))
    assert sine >= np.sin(np.radians(10.0)) ** 2 - 1e-8
    assert len(place.constraints) >= 1
    for name, value in place.constraints.items():
        slack = 1e-6 * max(1.0, abs(value.value))
        assert value.lower - slack <= value.value <= value.upper + slack, name


@pytest.mark.long
def test_way_along_a_trench(excavator: flexopt.Tree, plan: BasePlan) -> None:
    for place, target in zip(plan.places, TRENCH, strict=True):
        check_place(excavator, place, target, WEIGHTS)
        low, high = np.array(excavator.limits).T
        assert np.all(place.evaluation.posture >= low + 0.03 - 1e-8)
        assert np.all(place.evaluation.posture <= high - 0.03 + 1e-8)
        assert any("tip-over" in name for name in place.constraints)
    assert np.abs(np.diff(plan.base, axis=0)).max() <= 0.1 * 5.0 + 1e-7
    assert np.all(np.abs(np.diff(plan.posture, axis=0)) <= np.array(excavator.speeds) * 5.0 + 1e-7)
    assert plan.worth == plan.V.min()
    assert plan.worth >= plan.standing
    assert plan.still is not None
    for base, posture, value, target in zip(
        [plan.still.base] * len(TRENCH), plan.still.posture, plan.still.V, TRENCH, strict=True
    ):
        there = evaluate(excavator, posture, base=base)
        assert np.abs(there.end_point - target).max() < 1e-8
        assert there.w.sum() == pytest.approx(value, rel=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("combine", ["worst", "weighted"])
def test_stand_for_three_targets(excavator: flexopt.Tree, combine: str) -> None:
    targets = [[6.0, -2.0, 1.0], [7.0, 0.5, -1.0], [5.0, 3.0, 0.5]]
    stand = select_stand(
        excavator, targets, combine=combine, objective="w2", constraints=CONSTRAINTS, starts=3, workers=1
    )
    alpha = [0.0, 1.0, 0.0, 0.0, 0.0, 0.0]
    for place, target in zip(stand.places, targets, strict=True):
        assert np.array_equal(place.evaluation.base, stand.base)
        check_place(excavator, place, np.array(target), alpha)
    values = [place.objective for place in stand.places]
    assert stand.worth == pytest.approx(min(values) if combine == "worst" else np.mean(values), rel=1e-12)
    assert stand.stationarity < 1e-5


@pytest.mark.long
@pytest.mark.parametrize("seed", [3])
def test_random_trees(seed: int) -> None:
    """Two passive and five actuated joints; the targets are where two of its own postures put the end-point."""
    data = random_tree(seed, counts=(2, 5))
    machine, oracle = flexopt.tree_from_dict(data), pinocchio_tree(data)
    rng = np.random.default_rng(seed)
    rest = {body["joint"]["name"]: body["joint"].get("rest", 0.0) for body in data["bodies"]}

    def end_point(posture: np.ndarray, base: np.ndarray) -> np.ndarray:
        q = np.array([rest[b.joint.name] for b in machine.passive_bodies] + posture.tolist())
        return oracle.task(q, base)[0]

    targets = [end_point(rng.uniform(-1, 1, 5), np.zeros(3)) for _ in range(2)]
    stand = select_stand(machine, targets, objective="w1", starts=4, workers=1)
    plan = plan_base(machine, targets, objective="w1", duration=5.0, max_joint_rate=0.5, starts=1, workers=1)
    for result in (stand, plan):
        for place, target in zip(result.places, targets, strict=True):
            e = place.evaluation
            assert np.abs(end_point(e.posture, e.base) - target).max() < 1e-7
            check_place(machine, place, target, [1.0, 0.0])
    assert np.ptp([place.evaluation.base for place in stand.places], axis=0).max() == 0.0
    assert np.abs(np.diff(plan.base, axis=0)).max() <= 0.25 * 5.0 + 1e-7
    assert np.abs(np.diff(plan.posture, axis=0)).max() <= 0.5 * 5.0 + 1e-7


@pytest.mark.long
def test_whole_turns_do_not_stand_in_the_way(excavator: flexopt.Tree) -> None:
    """Targets round the machine, which stays where it is: slew goes on beyond half a turn."""
    angles = np.linspace(0.75 * np.pi, 1.25 * np.pi, 4)
    path = np.column_stack([7 * np.cos(angles), 7 * np.sin(angles), np.zeros(4)])
    fixed = {"x": (0.0, 0.0), "y": (0.0, 0.0), "yaw": (0.0, 0.0)}
    plan = plan_base(excavator, path, objective="w2", base_range=fixed, duration=4.0, starts=1, workers=1)
    assert np.abs(np.diff(plan.posture[:, 0])).max() <= 1.183 * 4.0 / 3 + 1e-7
    assert np.ptp(plan.posture[:, 0]) < np.pi


@pytest.mark.long
@pytest.mark.parametrize(
    "how", [{"objective": "w1"}, {"objective": "allowance", "loop": {"kp": 50.0, "kv": 10.0}}], ids=["w1", "allowance"]
)
def test_a_stand_holds_no_joint_a_whole_turn_farther_than_it_needs(how: dict[str, Any]) -> None:
    machine = flexopt.load("mobile-manipulator")
    targets = [(0.9, -0.3, 1.0), (0.9, 0.3, 1.2)]
    stand = select_stand(machine, targets, base=(0.0, 0.0, 0.0), starts=1, seed=2, workers=1, **how)
    held = held_from(stand.problems, stand.base, allowed=False)  # as a verdict has it, from a placement alone
    assert held is not None
    for e, target in zip([*(place.evaluation for place in stand.places), *held], [*targets, *targets], strict=True):
        assert np.abs(evaluate(machine, e.posture, base=stand.base).end_point - target).max() < 1e-7
        assert np.abs(e.posture).max() <= np.pi + 1e-6


@pytest.mark.long
def test_a_verdict_holds_the_arm_as_the_placements_found_do() -> None:
    """Candidates are worth what the choice says; from the present placement nothing of a sample of postures is better."""
    machine = flexopt.load("mobile-manipulator")
    targets = [(0.9, -0.3, 1.0), (0.9, 0.3, 1.2)]
    stand = select_stand(machine, targets, base=(0.0, 0.0, 0.0), objective="w1", starts=2, seed=2, workers=1)
    places = configurations_of(stand)
    found = [each for name, each in places.items() if name != "stay"]
    worths = [stand.worth, *(worth for worth, _ in stand.alternatives)]
    np.testing.assert_allclose([min(e.w[0] for e in each) for each in found], worths, rtol=1e-6, atol=1e-12)
    for problem, e in zip(stand.problems, places["stay"], strict=True):
        np.testing.assert_array_equal(e.base, np.zeros(3))
        sample = reached_from(problem, e.base[:, None], 5, 12)
        assert e.w[0] >= sample.value.max()


def test_where_the_base_may_not_move_to_the_arm_is_held_as_well() -> None:
    """A range of the base is where it may move, and does not say how the arm is held where it stands."""
    machine, base = flexopt.load("mobile-manipulator"), np.zeros(3)
    options: Any = {"base": base, "objective": "w1", "starts": 2, "seed": 2}
    ranges = [None, {"x": (0.1, 1.0)}]
    target = (0.9, -0.3, 1.0)
    held = [held_from([build_selection(machine, target, base_range=each, **options)], base) for each in ranges]
    inside, outside = (float(each[0].w[0]) for each in held if each is not None)
    assert outside == pytest.approx(inside, rel=1e-6)


@pytest.mark.long
def test_a_verdict_by_the_loop_holds_the_arm_for_the_loop_where_it_stands() -> None:
    machine, loop = flexopt.load("mobile-manipulator"), {"kp": 50.0, "kv": 10.0}
    targets = [(0.9, -0.3, 1.0), (0.9, 0.3, 1.2)]
    stand = select_stand(
        machine, targets, base=(0.0, 0.0, 0.0), objective="decay", loop=loop, starts=1, seed=2, workers=1
    )
    stay = configurations_of(stand)["stay"]
    held = min(flexopt.outcome(machine, e.posture, base=e.base, loop=loop).decay for e in stay)
    sampled = []
    for problem in stand.problems:
        reached = reached_from(problem, np.zeros((3, 1)), 5, 3)
        allowed = reached.z[3:, 0, np.isfinite(reached.value[0])].T
        sampled.append(max(flexopt.outcome(machine, q, base=np.zeros(3), loop=loop).decay for q in allowed))
    # The worst target's best; a climb ends within 1e-6 of an optimum.
    assert held >= min(sampled) * (1 - 1e-6)
