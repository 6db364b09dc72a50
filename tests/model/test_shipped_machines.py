"""The machines in `models/`: that their numbers are those of machines, and that they stand, hold and swing as such do."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import flexopt
from flexopt import build_plant, evaluate, load
from flexopt.model import Machine, Tree
from tests.model.robots.tree_oracle import TreeOracle

MODELS = Path(__file__).parents[2] / "models"
SHIPPED = sorted(path.stem for path in MODELS.glob("*.toml"))
# The article's excavator is its Table 1, which gives neither limits nor drives.
COMPLETE = [name for name in SHIPPED if name != "excavator"]
SPATIAL = [name for name in COMPLETE if isinstance(load(name), Tree)]
# Mass without payload, kg: data sheets' or the class's; published masses add up exactly.
MASSES = {
    "boom-stick-bucket": (22_500, 22_500),
    "slewing-excavator": (22_500, 22_500),
    "truck-crane": (12_000, 18_000),
    "mobile-manipulator": (350, 370),
}
# A working posture; the share of the way to the edge of the support that may be used up there.
POSTURES: dict[str, list[float]] = {
    "boom-stick-bucket": [-0.9, -1.2, -0.8],
    "slewing-excavator": [0.3, 0.55, -1.2, -0.8],
    "truck-crane": [1.2, 0.8, -0.9, 1.5],
    "mobile-manipulator": [0.4, -1.0, 1.6, -0.6, 1.57, 0.0],
}
# Farthest out, over the side where that is the weaker one.
REACHING: dict[str, list[float]] = {
    "boom-stick-bucket": [-1.4, -0.44, 0.0],
    "slewing-excavator": [1.5708, 0.1, -0.44, 0.0],
    "truck-crane": [1.5708, 0.0, 0.0, 3.2],
    "mobile-manipulator": [1.5708, 0.0, 0.0, 0.0, 0.0, 0.0],
}


def test_every_machine_has_its_numbers_here() -> None:
    assert set(MASSES) == set(POSTURES) == set(REACHING) == set(COMPLETE)


Frames = dict[str, tuple[np.ndarray, np.ndarray]]


def frames(machine: Machine | Tree, posture: list[float]) -> Frames:
    """Origin and axes, as columns, of every body and of the end-point, everything at rest."""
    if isinstance(machine, Tree):
        rest = {body.joint.name: body.joint.rest for body in machine.passive_bodies}
        oracle = TreeOracle(machine, rest | dict(zip(machine.joints, posture, strict=True)))
        poses = oracle.poses | {"end_point": oracle.end_point()}
        return {name: (pose[:3, 3], pose[:3, :3]) for name, pose in poses.items()}
    found: Frames = {}
    angle, at, command = machine.base.rest_angle, np.zeros(2), iter(posture)
    for name, body in [("base", machine.base), *((link.name, link) for link in machine.links)]:
        angle += 0.0 if name == "base" else next(command)
        axes = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        found[name] = (at, axes)
        at = at + body.length * axes[:, 0]
    return found | {"end_point": (at, np.eye(2))}


def point_masses(machine: Machine | Tree, posture: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Masses (k,) and where their centres are (k, 2 or 3), the payload last."""
    of = frames(machine, posture)
    if isinstance(machine, Tree):
        parts = [(body.name, body.mass, body.com) for body in machine.bodies]
    else:
        parts = [("base", machine.base.mass, (machine.base.com, machine.base.com_offset))]
        parts += [(link.name, link.mass, (link.com, link.com_offset)) for link in machine.links]
    places = [of[name][0] + of[name][1] @ com for name, _, com in parts]
    masses = [mass for _, mass, _ in parts]
    return np.array([*masses, machine.payload.mass]), np.array([*places, of["end_point"][0]])


def tip_over_margin(machine: Machine | Tree, posture: list[float]) -> float:
    """Least distance of the centre of mass from the edges of the support, m, by the edges' own equations."""
    masses, places = point_masses(machine, posture)
    centre = masses @ places / masses.sum()
    corners = np.array(machine.support_points)
    if corners.shape[1] == 1:
        return float(min(centre[0] - corners[0, 0], corners[1, 0] - centre[0]))
    sides = np.roll(corners, -1, axis=0) - corners
    inward = np.stack([-sides[:, 1], sides[:, 0]], axis=1) / np.linalg.norm(sides, axis=1)[:, None]
    return float(np.min(np.sum(inward * (centre[:2] - corners), axis=1)))


@pytest.mark.parametrize("name", COMPLETE)
def test_mass_is_that_of_the_class(name: str) -> None:
    masses, _ = point_masses(load(name), POSTURES[name])
    low, high = MASSES[name]
    assert low - 1e-9 <= masses[:-1].sum() <= high + 1e-9
    assert masses[-1] > 0


@pytest.mark.parametrize("name", SPATIAL)
def test_every_inertia_is_one_that_a_body_has(name: str) -> None:
    seen = 0
    for body in load(name).bodies:
        xx, yy, zz, xy, xz, yz = body.inertia
        least, middle, most = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        assert least >= 0
        assert most <= (least + middle) * (1 + 1e-12)
        seen += body.mass > 0
    assert seen >= 4


@pytest.mark.parametrize("name", COMPLETE)
def test_limits_drives_capsules_and_support_are_given(name: str) -> None:
    machine = load(name)
    assert np.isfinite([machine.efforts, machine.speeds]).all()
    assert len(machine.capsules) >= 4
    assert len(machine.support_points) >= 2
    # Only a slewing ring may turn without end.
    endless = [
        joint for joint, limits in zip(machine.joints, machine.limits, strict=True) if not np.isfinite(limits).all()
    ]
    assert endless in ([], ["slew"])
    assert "illustrative" in machine.source


@pytest.mark.parametrize("name", COMPLETE)
def test_bodies_stand_on_the_ground_and_not_in_it(name: str) -> None:
    """The lowest point of what the bodies fill; tracks and chassis are the lowest, at most half a metre up."""
    machine = load(name)
    of = frames(machine, POSTURES[name])
    lowest: dict[str, float] = {}
    for capsule in machine.capsules:
        origin, axes = of[capsule.body]
        low = min(float((origin + axes @ end)[-1]) for end in (capsule.start, capsule.end)) - capsule.radius
        lowest[capsule.body] = min(low, lowest.get(capsule.body, math.inf))
    first = machine.capsules[0].body
    assert min(lowest, key=lambda body: lowest[body]) == first
    assert -0.01 <= lowest[first] <= 0.5
    # The end-point's body is among them, and reaches about as far as it works.
    last = machine.capsules[-1]
    origin, axes = of[last.body]
    ends = [origin + axes @ end for end in (last.start, last.end)]
    assert min(np.linalg.norm(end - of["end_point"][0]) for end in ends) <= last.radius + 0.5


@pytest.mark.parametrize("name", COMPLETE)
def test_base_swings_at_half_a_hertz_to_ten(name: str) -> None:
    result = evaluate(load(name), posture=POSTURES[name], gravity=True)
    assert 0.5 < result.frequencies_hz[0] < 10
    assert (result.damping_ratios > 0.01).all()
    assert (result.damping_ratios < 0.5).all()
    assert (result.w <= 0).all()


@pytest.mark.parametrize("name", COMPLETE)
def test_machine_stands_where_it_works_and_where_it_reaches(name: str) -> None:
    machine = load(name)
    half = min(np.ptp(np.array(machine.support_points), axis=0)) / 2
    assert tip_over_margin(machine, POSTURES[name]) > 0.25 * half
    assert tip_over_margin(machine, REACHING[name]) > 0.1 * half


@pytest.mark.parametrize("name", COMPLETE)
def test_drives_hold_the_machine_and_its_payload_wherever_it_may_be(name: str) -> None:
    """At rest; and one of the reaching postures asks for the most of the joint that lifts."""
    machine, rng = load(name), np.random.default_rng(0)
    plant = build_plant(machine)
    low, high = np.clip(np.array(machine.limits).T, -math.pi, math.pi)
    postures = [POSTURES[name], REACHING[name], *rng.uniform(low, high, (300, len(low)))]
    base, p = np.zeros(len(machine.base_coordinates)), plant.parameter_values
    shares = [
        np.abs(np.array(plant.gravity(plant.rest(base, posture, p), base, p)).ravel()[plant.n_passive :])
        / machine.efforts
        for posture in postures
    ]
    assert np.max(shares) < 0.9
    assert np.max(shares[1]) > 0.3


@pytest.mark.parametrize("name", COMPLETE)
def test_springs_hardly_give_under_the_weight(name: str) -> None:
    """Deflections under gravity are those of a machine on its feet: centimetres and hundredths of a radian."""
    machine = load(name)
    plant = build_plant(machine)
    base, p = np.zeros(len(machine.base_coordinates)), plant.parameter_values
    rest = np.array(plant.rest(base, POSTURES[name], p)).ravel()[: plant.n_passive]
    deflected = np.array(plant.deflected(base, POSTURES[name], p)).ravel()
    assert np.abs(deflected - rest).max() < 0.06


def test_slewing_excavator_is_boom_stick_bucket_seen_from_the_side() -> None:
    """Straight ahead, with the coordinates that the plane has, M is the same to the digits that the files print."""
    plane, space = load("boom-stick-bucket"), load("slewing-excavator")
    flat, whole = build_plant(plane), build_plant(space)
    rng = np.random.default_rng(0)
    shared = ["base.x", "base.z", "base.pitch", "boom", "stick", "bucket"]
    kept = [space.coordinates.index(name) for name in shared]
    for _ in range(5):
        arm = rng.uniform(-1.5, 1.0, 3)
        q = np.zeros(len(space.coordinates))
        q[kept] = [0.1, -0.05, 0.02, arm[0], arm[1], arm[2]]
        # The plane turns anticlockwise, pitch lowers the front; the boom's angle is to the base there.
        angle = plane.base.rest_angle
        flat_q = [0.1, -0.05, angle - 0.02, arm[0] - angle, arm[1], arm[2]]
        sign = np.diag([1.0, 1.0, -1.0, 1.0, 1.0, 1.0])
        ours = whole.mass(q, np.zeros(3), whole.parameter_values).full()[np.ix_(kept, kept)]
        theirs = flat.mass(flat_q, 0.0, flat.parameter_values).full()
        np.testing.assert_allclose(sign @ ours @ sign, theirs, rtol=2e-4, atol=2e-4 * np.abs(theirs).max())
    tip = whole.end_point(
        whole.rest(np.zeros(3), [0.0, 0.1, -0.5, -0.2], whole.parameter_values), np.zeros(3), whole.parameter_values
    )
    other = flat.end_point(flat.rest(0.0, [0.1 - angle, -0.5, -0.2], flat.parameter_values), 0.0, flat.parameter_values)
    np.testing.assert_allclose(np.array(tip).ravel()[[0, 2]], np.array(other).ravel(), atol=2e-4)


def test_reach_at_ground_level_is_the_data_sheets() -> None:
    """9.86 m: bucket and stick as far out as they go, the boom where the teeth touch the ground."""
    machine = load("boom-stick-bucket")
    plant = build_plant(machine)
    low, high = machine.limits[0]
    best = 0.0
    for boom in np.linspace(low, high, 4001):
        tip = np.array(
            plant.end_point(
                plant.rest(0.0, [boom, machine.limits[1][1], 0.0], plant.parameter_values), 0.0, plant.parameter_values
            )
        )
        if abs(tip[1, 0]) < 0.005:
            best = max(best, float(tip[0, 0]))
    assert best == pytest.approx(9.86, abs=0.01)


def test_crane_reaches_what_it_says() -> None:
    machine = load("truck-crane")
    plant = build_plant(machine)
    tip = plant.end_point(
        plant.rest(np.zeros(3), [0.0, 0.0, 0.0, 3.2], plant.parameter_values), np.zeros(3), plant.parameter_values
    )
    assert float(ca.DM(tip)[0]) == pytest.approx(8.1)


def test_trees_and_their_readers_are_at_the_top() -> None:
    tree = flexopt.load_robot(MODELS / "truck-crane.toml")
    assert isinstance(tree, flexopt.Tree)
    assert tree == load("truck-crane") == flexopt.tree_from_dict(tree.to_dict())
    code = "import sys, flexopt; assert 'flexopt.model.robots' not in sys.modules; flexopt.load_robot"
    subprocess.run([sys.executable, "-c", code], check=True)
