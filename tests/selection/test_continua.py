"""Optima that differ by a turn about the target: one, unless something in the yard tells them apart."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import flexopt
from flexopt.model import tree_from_dict
from flexopt.selection import SelectionProblem
from flexopt.selection.continua import grouped, past_stops
from flexopt.selection.outcomes import choice
from flexopt.selection.outcomes.starting import starting_points
from tests.oracles.spatial import grounded
from tests.simulation.loops import EXCAVATOR

POSTURE = [0.3, 0.5, -1.0, -0.6]


def standing(problem: SelectionProblem, yaw: float, posture=POSTURE) -> np.ndarray:
    """The configuration that reaches the target in a posture, the machine turned by yaw."""
    plant = problem.measures.plant
    at = plant.rest([0.0, 0.0, yaw], posture, plant.parameter_values)
    reached = plant.end_point(at, [0.0, 0.0, yaw], plant.parameter_values).full().ravel()
    return np.array([problem.target[0] - reached[0], problem.target[1] - reached[1], yaw, *posture])


def free(**options) -> SelectionProblem:
    """A problem whose target is where POSTURE reaches."""
    tree = tree_from_dict(grounded(4, 3, coupled=False))
    plant = flexopt.build_plant(tree)
    q = plant.rest(np.zeros(3), POSTURE, plant.parameter_values)
    point = plant.end_point(q, np.zeros(3), plant.parameter_values).full().ravel()
    return flexopt.build_selection(
        tree, [4.0, 1.0, point[2]], objective="w1", starts=4, assume="ground,limits", **options
    )


@pytest.mark.long
def test_a_turn_about_the_target_is_no_new_optimum() -> None:
    problem = free()
    points = [standing(problem, yaw) for yaw in (0.2, -2.9, 3.0, 1.0)]
    assert grouped(problem, points) == [[0, 1, 2, 3]]
    # Other joints, whatever they give, are another posture.
    other = standing(problem, 0.2, [POSTURE[0] + 1e-2, *POSTURE[1:]])
    assert grouped(problem, [points[0], other, points[1]]) == [[0, 2], [1]]
    # The same joints off the target are not on the way.
    aside = points[1] + np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert grouped(problem, [points[0], aside]) == [[0], [1]]


def test_the_nearest_to_the_present_base_stands_for_all() -> None:
    problem = free()
    points = [standing(problem, yaw) for yaw in (0.2, -2.9, 1.0)]
    assert grouped(replace(problem, present_base=points[2][:3] + 0.01), points)[0][0] == 2


@pytest.mark.long
def test_a_wall_between_keeps_them_apart() -> None:
    """Keep-out wedges cut the circle of anchor points in two; along each arc the machine may be turned."""
    plain = free()
    angles = np.radians([0.0, 80.0, 180.0, 260.0])
    places = [standing(plain, float(angle)) for angle in angles]
    assert grouped(plain, places) == [[0, 1, 2, 3]]
    # Squares on the circle, between the second and the third, and between the fourth and the first.
    walls = []
    for degrees in (130.0, 310.0):
        x, y = standing(plain, math.radians(degrees))[:2]
        walls.append([[x - 0.3, y - 0.3], [x + 0.3, y - 0.3], [x + 0.3, y + 0.3], [x - 0.3, y + 0.3]])
    walled = free(constraints={"keep_out": walls})
    assert grouped(walled, places) == [[0, 1], [2, 3]]
    one = free(constraints={"keep_out": walls[:1]})
    # The other way round is open.
    assert grouped(one, places) == [[0, 1, 2, 3]]


def test_travel_and_bounds_tell_placements_apart() -> None:
    costly = free(constraints={"travel": {"cost": 0.1}}, base=[0.0, 0.0, 0.0], posture=POSTURE)
    assert grouped(costly, [standing(costly, yaw) for yaw in (0.2, 1.0)]) == [[0], [1]]
    plain = free()
    points = [standing(plain, yaw) for yaw in (-1.5, 1.5)]
    x = sorted(point[0] for point in points)
    lowest = min(standing(plain, yaw)[0] for yaw in np.linspace(-1.5, 1.5, 50))
    highest = max(standing(plain, yaw)[0] for yaw in np.linspace(1.5, 2 * math.pi - 1.5, 50))
    assert lowest < x[0] - 0.1 or highest > x[1] + 0.1
    between = free(base_range={"x": (x[0] - 1e-3, x[1] + 1e-3), "y": (-20.0, 20.0)})
    assert grouped(between, points) == [[0], [1]]


def test_machines_that_cannot_turn_have_points() -> None:
    found = flexopt.select(EXCAVATOR, [3.0, 0.5], objective="w1", workers=1)
    assert all(candidate.continuum == () for candidate in found.candidates)


@pytest.mark.long
def test_a_selection_names_each_continuum_once() -> None:
    machine = flexopt.load("slewing-excavator")
    found = flexopt.select(machine, [7.0, 1.0, 2.5], objective="V", weights=[1.0] * 6, workers=1)
    postures = np.array([candidate.z[3:] for candidate in found.candidates])
    for k, one in enumerate(postures):
        assert all(np.abs(one - other).max() > 1e-3 for other in postures[:k])
    wide = [candidate for candidate in found.candidates if candidate.continuum]
    assert wide
    assert "placements alike" in repr(found)
    assert "several placements alike" in found.status
    for candidate in wide:
        for base in candidate.continuum:
            there = flexopt.evaluate(machine, candidate.z[3:], base=base)
            np.testing.assert_allclose(there.end_point, [7.0, 1.0, 2.5], atol=1e-6)
            np.testing.assert_allclose(there.w, candidate.w, atol=1e-6 * found.problem.objective_scale)
    document = found.to_dict()["candidates"]
    assert [len(c["continuum"]) for c in document] == [len(c.continuum) for c in found.candidates]


@pytest.mark.long("decay-1", "decay--1")
@pytest.mark.filterwarnings("ignore::flexopt.ImplausibleMachine")
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("objective", ["w1", "decay"])
def test_a_window_of_a_whole_turn_holds_the_optima_of_a_free_joint(objective: str, side: int) -> None:
    """Its end lies just short of the best: climbs that it stops go on a turn away, and none rests at an end."""
    asked = {"objective": objective, "starts": 8} | ({"loop": {"kp": 1e4, "kv": 1e3}} if objective == "decay" else {})
    free = flexopt.select(EXCAVATOR, (0.0, 1.6), base=0.0, **asked)
    data, best = EXCAVATOR.to_dict(), float(free.best.z[2])
    data["links"][1]["limits"] = sorted([best - 0.2 * side, best - side * (0.3 + math.tau)])
    held = flexopt.select(flexopt.machine_from_dict(data), (0.0, 1.6), base=0.0, assume="limits", **asked)
    assert not [name for each in held.candidates for name in each.active if name.startswith("stick")]

    def apart(one: np.ndarray, other: np.ndarray) -> float:
        away = one - other
        away[1:] = (away[1:] + math.pi) % math.tau - math.pi
        return float(np.abs(away).max())

    # Stationary to 1e-4 of the gradient, so that climbs from elsewhere end 1e-4 apart.
    assert max(min(apart(each.z, one.z) for one in free.candidates) for each in held.candidates) < 1e-3
    assert apart(held.best.z, free.best.z) < 1e-3 or objective == "w1"


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::flexopt.ImplausibleMachine")
def test_joints_come_the_fewest_turns_where_members_were_added_to_a_climb(monkeypatch: pytest.MonkeyPatch) -> None:
    """Optima over what is uncertain are so for members that climbs add; a joint a turn away is the same for them."""

    def with_few(*args):
        program, starts = starting_points(*args)
        return replace(program, members=program.members[-1:]), starts

    monkeypatch.setattr(choice, "starting_points", with_few)
    data, now = EXCAVATOR.to_dict(), (0.9929, -2.6306 + math.tau)
    data["links"][1]["limits"] = (-9.0, 9.0)
    asked = {"loop": {"kp": 1e4, "kv": 1e3}, "ranges": {"stiffness": (0.5, 2.0)}, "starts": 2}
    machine = flexopt.machine_from_dict(data)
    found = flexopt.select(machine, (0.0, 1.6), base=0.0, posture=now, objective="decay", **asked)
    assert max(abs(each.z[2] - now[1]) for each in found.candidates) < math.pi


def test_past_an_end_of_a_joint_is_the_same_configuration_a_turn_away() -> None:
    """Where the range allows that; with ends a turn apart each is the other."""
    data = EXCAVATOR.to_dict()
    for limits, at, there in (
        ((-7.0, 1.2), 1.2, 1.2 - math.tau),
        ((-7.0, 1.2), -7.0, -7.0 + math.tau),
        ((1.2 - math.tau, 1.2), 1.2, 1.2 - math.tau),
        ((-7.0, 1.2), 1.1, None),
        ((-4.0, 1.2), 1.2, None),
    ):
        data["links"][1]["limits"] = limits
        machine = flexopt.machine_from_dict(data)
        target = flexopt.evaluate(machine, [0.3, at], base=0.0).end_point
        problem = flexopt.build_selection(machine, target, starts=1, assume="limits")
        found = past_stops(problem, np.array([0.0, 0.3, at]))
        if there is None:
            assert found is None
        else:
            np.testing.assert_allclose(found, [0.0, 0.3, there], atol=1e-12)
