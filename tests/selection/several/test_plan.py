"""A way of the base along a path: never worse than standing still, within its rates, every configuration checked."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import fsolve

import flexopt
from flexopt import build_measures, evaluate, load, simulate
from flexopt.errors import InputError, NoSolutionFound, UnreachableTarget
from flexopt.robustness import evaluate_w
from flexopt.selection.several import BasePlan, plan_base, select_stand
from flexopt.selection.several.postures import reached_from
from flexopt.selection.several.results import FixedPlacement
from flexopt.selection.several.ways import broken_on_lines, on_lines

PATH = np.array([[x, 1.6] for x in np.linspace(0.0, 1.5, 7)])


@pytest.fixture(scope="module")
def excavator() -> flexopt.Machine:
    return load("excavator")


@pytest.fixture(scope="module")
def plan(excavator: flexopt.Machine) -> BasePlan:
    return plan_base(excavator, PATH, objective="V", weights=[1, 1, 1], duration=6.0, workers=1)


@pytest.mark.long
def test_way_reaches_every_target_and_keeps_to_the_rates(excavator: flexopt.Machine, plan: BasePlan) -> None:
    assert plan.time == pytest.approx(np.linspace(0, 6, 7))
    for place, target in zip(plan.places, PATH, strict=True):
        e = place.evaluation
        assert np.abs(e.end_point - target).max() < 1e-8
        assert np.allclose(evaluate(excavator, e.posture, base=e.base).w.sum(), place.objective, rtol=1e-10)
        assert math.sin(e.posture[-1]) ** 2 >= math.sin(math.radians(10)) ** 2 - 1e-8
    assert np.abs(np.diff(plan.base[:, 0])).max() <= 0.25 * 1.0 + 1e-7
    assert plan.travelled[0] == pytest.approx(np.abs(np.diff(plan.base[:, 0])).sum())


def test_moving_is_not_worse_than_standing_still(excavator: flexopt.Machine, plan: BasePlan) -> None:
    stand = select_stand(excavator, PATH, objective="V", weights=[1, 1, 1], workers=1)
    scale = plan.problems[0].objective_scale
    assert plan.standing == pytest.approx(stand.worth, abs=1e-6 * scale)
    assert plan.worth > plan.standing + 0.01 * scale
    assert plan.worth == plan.V.min() == plan.V[plan.worst]


def test_what_a_way_breaks_between_its_targets_is_told(excavator: flexopt.Machine) -> None:
    """A pit between two targets that are farther from each other than the arm reaches: the base comes over it."""
    path, low, high = [(-2.2, 1.6), (4.2, 1.6)], 0.9, 1.1
    few: dict[str, Any] = {"starts": 1, "workers": 1, "duration": 60.0, "max_base_rate": 1.0, "base": 0.0}
    found = plan_base(excavator, path, constraints={"keep_out": [[low, high]]}, **few)
    assert found.base[0, 0] <= low < high <= found.base[1, 0]
    (told,) = found.broken_between
    assert told.startswith("on the straight way from target 1 to target 2 it breaks distance from keep_out[0], -")
    # The middle of the pit, as far as the sentence has digits: of 63 points on the way the deepest has 0.076 m.
    assert float(told.split()[-6]) == pytest.approx(-(high - low) / 2, rel=1e-3)
    assert f"  {told}\n" in repr(found)
    assert found.to_dict()["between"]["breaks"] == [told]
    judged = flexopt.verdict(found, loop={"kp": 1e3, "kv": 1e2}, members=2, runs=0)
    assert replace(judged, word="move", place="candidate 1").drawbacks.endswith(told)
    free = plan_base(excavator, path, **few)
    assert free.broken_between == ()
    assert "on the straight way" not in repr(free)


@pytest.mark.long
def test_no_way_of_a_dense_grid_is_better(excavator: flexopt.Machine, plan: BasePlan) -> None:
    """An exhaustive search over 161 placements and both elbows for each target, within the same rates."""
    bases = np.linspace(-2.2, 3.6, 161)
    level: np.ndarray | None = None
    for target in PATH:
        values = np.full((bases.size, 2), -np.inf)
        for k, x in enumerate(bases):
            try:
                postures = flexopt.inverse_kinematics(excavator, target, base=float(x))
            except UnreachableTarget:
                continue
            for posture in postures:
                if math.sin(posture[-1]) ** 2 >= math.sin(math.radians(10)) ** 2:
                    w = evaluate_w(build_measures(excavator), [[x]], posture[:, None]).w
                    values[k, int(posture[-1] > 0)] = w.sum()
        if level is not None:
            near = np.abs(bases[:, None] - bases) <= 0.25 + 1e-12
            reached = np.array([np.where(near, level[:, e][:, None], -np.inf).max(axis=0) for e in range(2)]).T
            values = np.minimum(values, reached)
        level = values
    assert level is not None
    assert np.isfinite(level.max())
    # The shortest way may give up 1e-4 of the scale.
    assert plan.worth >= level.max() - 1.01e-4 * plan.problems[0].objective_scale


def test_between_the_targets(excavator: flexopt.Machine, plan: BasePlan) -> None:
    value, when = plan.between
    assert 0 <= when <= 6
    k = min(int(when), 5)
    share = when - plan.time[k]
    target = PATH[k] + (PATH[k + 1] - PATH[k]) * share
    base = plan.base[k] + (plan.base[k + 1] - plan.base[k]) * share
    postures = flexopt.inverse_kinematics(excavator, target, base=base)
    best = min(float(np.abs(p - plan.posture[k]).max()) for p in postures)
    there = next(p for p in postures if float(np.abs(p - plan.posture[k]).max()) == best)
    assert evaluate(excavator, there, base=base).w.sum() == pytest.approx(value, rel=1e-6)
    assert value <= plan.worth + 1e-12


def test_where_v_is_no_number_between_the_targets_nothing_is_promised(
    excavator: flexopt.Machine, plan: BasePlan
) -> None:
    """Whatever it is elsewhere, as of an own Function with a root that has none there."""
    zs = [np.concatenate([place.evaluation.base, place.evaluation.posture]) for place in plan.places]
    half = (plan.base[0, 0] + plan.base[1, 0]) / 2

    def values(_: int, z: np.ndarray) -> np.ndarray:
        return np.where(np.abs(z[0] - half) < 1e-9, np.nan, 1.0)

    value, when = on_lines(plan.problems[:2], plan.time, zs[:2], values)
    assert value == -math.inf
    assert when == pytest.approx((plan.time[0] + plan.time[1]) / 2)


@pytest.mark.parametrize(
    ("name", "posture"),
    [("excavator", (0.99, -2.63)), ("boom-stick-bucket", (-0.9, -1.2, -0.6)), ("mobile-manipulator", (0.3,) * 6)],
)
def test_a_straight_way_is_that_of_the_end_point_as_the_machine_sags(name: str, posture: tuple[float, ...]) -> None:
    machine, there = flexopt.load(name), np.array(posture)
    base = np.zeros(len(machine.base_coordinates))
    zs = [np.concatenate([base, there]), np.concatenate([base + 0.2, there + 0.05])]
    ends = [evaluate(machine, z[base.size :], base=z[: base.size], gravity=True).end_point for z in zs]
    problems = [flexopt.build_selection(machine, end, gravity=True, starts=1) for end in ends]
    ways = list[np.ndarray]()

    def values(_: int, z: np.ndarray) -> np.ndarray:
        ways.append(z)
        return np.zeros(z.shape[1])

    assert on_lines(problems, np.array([0.0, 1.0]), zs, values)[0] == 0.0
    # The targets' own postures stay as they are.
    np.testing.assert_allclose(ways[0][:, [0, -1]], np.array(zs).T, atol=1e-9)
    for share, z in zip(np.linspace(0.0, 1.0, ways[0].shape[1]), ways[0].T, strict=True):
        e = evaluate(machine, z[base.size :], base=z[: base.size], gravity=True)
        np.testing.assert_allclose(e.base, base + 0.2 * share, atol=1e-12)
        np.testing.assert_allclose(e.end_point, ends[0] + share * (ends[1] - ends[0]), atol=1e-9)


def test_what_is_kept_all_the_way_under_gravity_is_not_told_as_broken(excavator: flexopt.Machine) -> None:
    """A tool angle between bounds that the way of the machine as it sags just keeps, by SciPy's roots, or just breaks."""
    ends, count = np.array([[0.0, 1.6], [0.4, 1.6]]), 65
    postures = [flexopt.inverse_kinematics(excavator, end, base=0.0, gravity=True)[0] for end in ends]

    plant = flexopt.build_plant(excavator)
    p = plant.parameter_values

    def sagged(posture: np.ndarray) -> np.ndarray:
        return np.append(plant.deflected.call([0.0, posture, p])[0].full(), posture)

    def held(share: float) -> float:
        target, start = ends[0] + share * (ends[1] - ends[0]), postures[0] + share * (postures[1] - postures[0])

        def off(posture: np.ndarray) -> np.ndarray:
            return plant.end_point.call([sagged(posture), 0.0, p])[0].full().ravel() - target

        turned = float(sagged(fsolve(off, start, xtol=1e-13))[2:].sum())
        return (turned + math.pi) % math.tau - math.pi

    angles = [held(share) for share in np.linspace(0.0, 1.0, count)[1:-1].tolist()]
    low, high = min(angles), max(angles)

    def told(lower: float, upper: float) -> tuple[str, ...]:
        kept = {"tool_angle": (lower, upper)}
        problems = [flexopt.build_selection(excavator, end, gravity=True, constraints=kept, starts=1) for end in ends]
        return broken_on_lines(problems, [np.append(0.0, posture) for posture in postures])

    # Far more than rounding, far less than the springs' share of the angle.
    assert told(low - 1e-5, high + 1e-5) == ()
    assert told(low + 1e-5, high + 1e-5)
    assert told(low - 1e-5, high - 1e-5)


@pytest.mark.long
def test_start_and_rates_bind(excavator: flexopt.Machine) -> None:
    from_here = plan_base(excavator, PATH, objective="w2", start=[-1.9], max_base_rate=0.1, duration=6.0, workers=1)
    assert from_here.base[0, 0] == -1.9
    assert np.abs(np.diff(from_here.base[:, 0])).max() <= 0.1 + 1e-7
    still = plan_base(excavator, PATH, objective="w2", max_base_rate=0.0, duration=6.0, workers=1)
    assert np.ptp(still.base) < 1e-7
    assert still.worth == pytest.approx(still.standing, abs=2e-4 * still.problems[0].objective_scale)


def test_a_way_that_gave_up_a_little_for_its_shortness_says_so(plan: BasePlan) -> None:
    assert plan.still is not None
    assert "move least so" not in repr(plan)
    better = replace(plan, still=replace(plan.still, V=0 * plan.still.V))
    assert better.worth < better.standing
    sentence = (
        "standing still; both count as best to 0.0001 of the objective's scale: base and joints together move least so)"
    )
    assert sentence in repr(better)


@pytest.mark.long
def test_what_stands_still_keeps_its_joints_rates() -> None:
    """A redundant arm whose best placement asks for faster joints; the next best is no worse than a scan of pairs."""
    machine, path, seconds, rate = flexopt.load("boom-stick-bucket"), [(4.0, 1.0), (4.6, 0.4)], 3.0, 0.05

    def still(most: float) -> tuple[BasePlan, FixedPlacement, float]:
        given: dict[str, Any] = {"objective": "w1", "duration": seconds, "starts": 1, "workers": 1}
        found = plan_base(machine, path, max_joint_rate=most, **given)
        assert found.still is not None
        return found, found.still, float(np.abs(np.diff(found.still.posture, axis=0)).max()) / seconds

    assert still(1.0)[2] > rate
    found, slow, fastest = still(rate)
    assert fastest <= rate + 1e-7
    first, second = (reached_from(problem, np.linspace(-4.0, 4.0, 41)[None], 7, 16) for problem in found.problems)
    away = np.abs(first.z[1:, :, :, None] - second.z[1:, :, None, :]).max(axis=0)
    both = np.minimum(first.value[:, :, None], second.value[:, None, :])
    best = float(both[away <= rate * seconds].max())
    # The scan finds pairs, and the placement is as good as the best of them.
    assert -np.inf < best <= slow.V.min() + 1e-7 * found.problems[0].objective_scale


def test_simulation_follows_the_plan(excavator: flexopt.Machine, plan: BasePlan) -> None:
    run = simulate(
        excavator, plan.posture[0], base=plan.base[0], base_path=plan.base_path, target_path=plan.target_path,
        offset=[0.0, 0.0], duration=8.0,
    )  # fmt: skip
    # The base starts and stops at once, which shakes the machine; nothing but the modes' own damping calms it.
    assert run.verdict == "converges"
    assert run.end_error < 0.05


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"path": [[0.0, 1.6]]}, "list of 2 to"),
        ({"times": [0.0, 1.0]}, "needs 7 numbers"),
        ({"times": [0, 1, 2, 3, 3, 4, 5]}, "must increase"),
        ({"times": [1, 2, 3, 4, 5, 6, 7]}, "from 0"),
        ({"duration": -1.0}, "duration"),
        ({"duration": 1.0, "times": list(range(7))}, "without times"),
        ({"max_base_rate": [0.1, 0.2]}, "max_base_rate"),
        ({"max_joint_rate": math.nan}, "max_joint_rate"),
        ({"start": [1.0, 2.0]}, "start"),
        ({"objective": "epsilon_max"}, "without ε_max"),
    ],
)
def test_bad_input(excavator: flexopt.Machine, given: dict[str, object], words: str) -> None:
    with pytest.raises(InputError) as caught:
        plan_base(excavator, **({"path": PATH} | given))  # pyright: ignore[reportArgumentType]
    assert words in str(caught.value)


def test_a_path_faster_than_the_machine(excavator: flexopt.Machine) -> None:
    far = [[0.0, 1.6], [30.0, 1.6]]
    with pytest.raises(NoSolutionFound) as caught:
        plan_base(excavator, far, duration=1.0, workers=1)
    assert "way" in str(caught.value)


def test_unreachable_points_are_named(excavator: flexopt.Machine) -> None:
    with pytest.raises(UnreachableTarget) as caught:
        plan_base(excavator, [[0.0, 1.6], [0.0, 30.0]])
    assert "path[1]" in str(caught.value)
