"""Inverse kinematics against forward kinematics written here, and its errors against a numerical search."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from scipy.optimize import minimize, root

from flexopt import SingularPosture, UnreachableTarget, build_plant, evaluate, inverse_kinematics, load, tree_from_dict
from flexopt.model import machine_from_dict
from flexopt.plant.inverse_kinematics import distinct
from flexopt.plant.reach import arm_length
from tests.oracles.lagrange import lagrange
from tests.oracles.machines import (
    NumpySource,
    Structure,
    arm_at_rest,
    draw_machine,
    machines,
    random_posture,
    seeds,
    segment_lengths,
)

TWO = {"n_max": 2}
TURN = 2 * math.pi


def shoulder(machine, base):
    return arm_at_rest(machine, np.zeros(len(machine.joints)), base)[0][0]


def annulus(machine):
    lengths = segment_lengths(machine)
    return max(0.0, 2 * lengths.max() - lengths.sum()), lengths.sum()


def target_inside(rng, machine, base, low=0.2, high=0.8):
    inner, outer = annulus(machine)
    radius, angle = inner + rng.uniform(low, high) * (outer - inner), rng.uniform(-math.pi, math.pi)
    return shoulder(machine, base) + radius * np.array([math.cos(angle), math.sin(angle)])


def with_limits(machine, limits):
    data = machine.to_dict()
    links = [dict(link) for link in data["links"]]
    free = [link for link in links if not link.get("passive")]
    for link, pair in zip(free, limits, strict=True):
        link["limits"] = tuple(pair)
    return machine_from_dict(data | {"links": tuple(links)})


def wrapped(angle):
    return (np.asarray(angle) + math.pi) % TURN - math.pi


@pytest.mark.long
@settings(derandomize=True, max_examples=12)
@given(drawn=machines(), seed=seeds)
def test_every_branch_reaches_the_target(drawn, seed):
    _, machine = drawn
    rng = np.random.default_rng(seed)
    base = float(rng.uniform(-5, 5))
    target = target_inside(rng, machine, base)
    postures = inverse_kinematics(machine, target, base=base)
    assert len(postures) >= 2
    for posture in postures:
        assert np.abs(arm_at_rest(machine, posture, base)[1] - target).max() < 1e-12
    for i, one in enumerate(postures):
        assert all(np.abs(one - other).max() > 1e-7 for other in postures[:i])


@settings(derandomize=True, max_examples=12)
@given(drawn=machines(TWO), seed=seeds)
def test_two_links_give_their_two_branches_up_first(drawn, seed):
    _, machine = drawn
    rng = np.random.default_rng(seed)
    posture = random_posture(rng, machine)
    posture[1] = rng.choice([-1, 1]) * rng.uniform(0.1, 3.0)
    base = float(rng.uniform(-5, 5))
    found = inverse_kinematics(machine, arm_at_rest(machine, posture, base)[1], base=base)
    assert len(found) == 2
    assert found[0][1] < 0 < found[1][1]
    assert np.abs(wrapped(found[0 if posture[1] < 0 else 1] - posture)).max() < 1e-10  # 1e-15 / sin 0.1, squared once


def test_straight_arm_is_one_posture():
    machine = load("excavator")
    tip = arm_at_rest(machine, np.array([0.3, 0.0]))[1]
    # One ulp of the target bends the arm by sqrt(eps) ~ 1e-8 to either side; beyond 1e-7 they would be two postures.
    assert len(inverse_kinematics(machine, tip)) == 1


@settings(derandomize=True, max_examples=12)
@given(drawn=machines(TWO), seed=seeds)
def test_limits_are_kept_and_whole_turns_are_used(drawn, seed):
    _, machine = drawn
    rng = np.random.default_rng(seed)
    target = target_inside(rng, machine, 0.0)
    free = inverse_kinematics(machine, target)
    low = rng.uniform(-1.5 * math.pi, math.pi, 2)
    limits = np.stack([low, low + rng.uniform(1.0, TURN - 0.1, 2)], axis=1)
    check_limits(machine, target, free, limits)


@pytest.mark.parametrize(
    "window",
    [(-4 * math.pi, -TURN - 0.5), (TURN + 0.5, 4 * math.pi), (-TURN, -0.5), (1.0, TURN), (9.0, 12.0), (-12.0, -9.0)],
)
def test_limits_anywhere_in_the_allowed_range(window):
    machine, rng = load("excavator"), np.random.default_rng(1)
    for _ in range(30):
        target = target_inside(rng, machine, 0.0)
        check_limits(machine, target, inverse_kinematics(machine, target), np.array([window, window]))
        check_limits(machine, target, inverse_kinematics(machine, target), np.array([window, (-math.pi, math.pi)]))


def test_limits_wider_than_a_turn_leave_postures_near_their_middle():
    """The elbow's sign stays that of its branch, too."""
    free = inverse_kinematics(load("excavator"), (0.0, 1.6))
    wide = inverse_kinematics(with_limits(load("excavator"), np.full((2, 2), [-6.0, 6.0])), (0.0, 1.6))
    np.testing.assert_allclose(wide, free, atol=1e-12)
    arm = load("mobile-manipulator")
    plant = build_plant(arm)
    still = np.zeros(plant.n_base)
    q = plant.rest(still, [0.3, 0.5, 0.6, 0.1, 0.2, 0.1], plant.parameter_values)
    target = plant.end_point(q, still, plant.parameter_values).full().ravel()
    assert np.abs(inverse_kinematics(arm, target)).max() <= math.pi + 1e-11


def check_limits(machine, target, free, limits):
    """Exactly those branches remain that some number of whole turns brings inside the limits."""
    expected = [
        posture
        for posture in free
        if all(
            any(low <= angle + k * TURN <= high for k in range(-3, 4))
            for angle, (low, high) in zip(posture, limits, strict=True)
        )
    ]
    limited = with_limits(machine, limits)
    if not expected:
        with pytest.raises(UnreachableTarget, match="limit") as caught:
            inverse_kinematics(limited, target)
        assert caught.value.miss == 0.0
        return
    found = inverse_kinematics(limited, target)
    assert len(found) == len(expected)
    for got, want in zip(found, expected, strict=True):
        assert np.abs(wrapped(got - want)).max() < 1e-12
        assert np.all(got >= limits[:, 0] - 1e-11)
        assert np.all(got <= limits[:, 1] + 1e-11)


@pytest.mark.long
@pytest.mark.parametrize("structure", [Structure(3, ("x",), ()), Structure(4, ("y",), ()), Structure(5, ("x",), (2,))])
def test_redundant_arm_gets_many_postures_and_repeats_them(structure):
    rng = np.random.default_rng(11)
    for _ in range(2):
        machine = machine_from_dict(draw_machine(NumpySource(rng), structure))
        target = target_inside(rng, machine, 0.0, 0.4, 0.6)
        first = inverse_kinematics(machine, target, seed=5)
        again = inverse_kinematics(machine, target, seed=5)
        assert len(first) == len(again) >= 4
        assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
        other = inverse_kinematics(machine, target, seed=6)
        assert not any(np.array_equal(a, b) for a in first for b in other)


@pytest.mark.long
@settings(derandomize=True, max_examples=6)
@given(drawn=machines(frequency=(4.0, 10.0)), seed=seeds)
def test_under_gravity_the_deflected_end_point_is_on_the_target(drawn, seed):
    data, machine = drawn
    rng = np.random.default_rng(seed)
    base = float(rng.uniform(-5, 5))
    target = target_inside(rng, machine, base, 0.3, 0.7)
    plant, oracle = build_plant(machine), lagrange(data)
    for posture in inverse_kinematics(machine, target, base=base, gravity=True)[:6]:
        q_p = plant.deflected(base, posture, plant.parameter_values).full().ravel()
        q = np.concatenate([q_p, posture])
        assert np.abs(oracle.dynamics(q, np.zeros(len(q)), base)[3].full().ravel() - target).max() < 1e-9


@pytest.mark.parametrize("name", ["slewing-excavator", "truck-crane", "boom-stick-bucket"])
def test_the_border_of_the_reach_is_that_of_the_sagging_machine(name):
    """In corners of the joints' ranges: what is reached there as it sags may not be with springs unloaded."""
    machine, rng, told = load(name), np.random.default_rng(2), 0
    low, high = np.clip(np.array(machine.limits), -2.5, 2.5).T
    for _ in range(6):
        corner = np.where(rng.random(low.size) < 0.5, low + 2e-4, high - 2e-4)
        try:
            target = evaluate(machine, corner, gravity=True).end_point
        except SingularPosture:
            continue
        for posture in inverse_kinematics(machine, target, gravity=True)[:3]:
            np.testing.assert_allclose(evaluate(machine, posture, gravity=True).end_point, target, atol=1e-8)
            assert all(a - 1e-9 <= x <= b + 1e-9 for x, (a, b) in zip(posture, machine.limits, strict=True))
            told += 1
    assert told > 3


def missed_from(machine, bearing, beyond):
    """posture -> end-point of the machine as it sags less a target, from None less it alone: that far from the border."""
    plant = build_plant(machine)
    p, arm = plant.parameter_values, plant.arm_segments(p=plant.parameter_values)
    center, length = arm["first_joint"].full().ravel(), float(arm["lengths"].full().sum())
    target = center + (length + beyond) * np.array([np.cos(bearing), np.sin(bearing)])

    def off(posture):
        if posture is None:
            return -target
        q = ca.vertcat(plant.deflected(0.0, posture, p), posture)
        return plant.end_point(q, 0.0, p).full().ravel() - target

    return off


@pytest.mark.parametrize(("bearing", "beyond"), [(0.8, 0.003), (0.0, 0.01), (-0.8, 0.01), (3.14, 0.003), (0.0, -0.4)])
def test_under_gravity_each_elbow_is_found_up_to_the_border_of_the_reach(bearing, beyond):
    """Which elbow it is is that of the posture found, not of the one that it sags from; by SciPy from either side."""
    machine = load("excavator")
    off = missed_from(machine, bearing, beyond)
    target = -off(None)
    for elbow, sign in (("up", -1.0), ("down", 1.0)):
        near = [bearing - machine.base.rest_angle - sign * 0.1, sign * 0.2]
        by_scipy = root(off, near, tol=1e-12)
        assert by_scipy.success
        assert by_scipy.x[1] * sign > 0.01
        (found,) = inverse_kinematics(machine, target, gravity=True, elbow=elbow)
        turned = (found - by_scipy.x + np.pi) % (2 * np.pi) - np.pi
        np.testing.assert_allclose(turned, 0.0, atol=1e-7)
    assert len(inverse_kinematics(machine, target, gravity=True)) == 2


@pytest.mark.parametrize(
    ("softer", "posture"), [(0.1, (-1.2696, -0.03)), (0.06, (-1.7885, -0.1384)), (0.06, (-1.13, -0.3))]
)
def test_on_soft_springs_both_elbows_are_found(softer, posture):
    """Of a nearly straight arm steps from either elbow may all lead to one; by SciPy the other is there, too."""
    data = load("excavator").to_dict()
    springs = {name: softer * k for name, k in data["base"]["stiffness"].items()}
    machine = machine_from_dict(data | {"base": data["base"] | {"stiffness": springs}})
    plant = build_plant(machine)
    target = evaluate(machine, posture, base=[0.0], gravity=True).end_point

    def off(q):
        sagged = ca.vertcat(plant.deflected(0.0, q, plant.parameter_values), q)
        return plant.end_point(sagged, 0.0, plant.parameter_values).full().ravel() - target

    ends = [root(off, np.add(posture, by), tol=1e-12) for by in ([0.0, 0.0], [-0.1, 0.2], [-0.3, 0.5])]
    known = sorted({tuple((e.x + 0.0).round(7)) for e in ends if e.success}, key=lambda q: q[1])
    found = inverse_kinematics(machine, target, gravity=True)
    np.testing.assert_allclose(found, known, atol=1e-6)
    assert found[0][1] < 0 < found[1][1]
    for elbow, own in zip(("up", "down"), found, strict=True):
        np.testing.assert_allclose(inverse_kinematics(machine, target, gravity=True, elbow=elbow), [own], atol=1e-9)


@pytest.mark.parametrize(
    ("softer", "posture"),
    [(2.592105560548508, (-0.611877976, 0.000341044176)), (0.09820129205410259, (-1.04047384, 2.70723915))],
)
def test_under_gravity_no_posture_is_told_twice(softer, posture):
    """Steps onto a nearly straight arm end a little apart, and turned hinges by whole turns."""
    data = load("excavator").to_dict()
    springs = {name: softer * k for name, k in data["base"]["stiffness"].items()}
    machine = machine_from_dict(data | {"base": data["base"] | {"stiffness": springs}})
    target = evaluate(machine, posture, base=[0.0], gravity=True).end_point
    found = inverse_kinematics(machine, target, gravity=True)
    assert len(found) == 2
    assert np.abs(wrapped(found[0] - found[1])).max() > 5e-5
    assert min(np.abs(wrapped(each - posture)).max() for each in found) < 1e-4


@pytest.mark.parametrize("gravity", [False, True])
@pytest.mark.parametrize("end", [3.49, 7.0])
def test_straight_behind_a_slew_of_more_than_a_turn_is_one_way_to_hold_it(gravity, end):
    """Half a turn to either side is one posture."""
    car = {"name": "pitch", "kind": "hinge", "axis": (0, 1, 0), "passive": True, "stiffness": 3e5, "damping": 1e2}
    bodies = [{"name": "car", "parent": None, "joint": car, "mass": 900.0, "com": (0, 0, 0.5),
               "inertia": (90.0, 95.0, 99.0, 0, 0, 0)}]  # fmt: skip
    for name, axis, position, com, limits in (
        ("slew", (0, 0, 1), (0, 0, 1.0), (0, 0, 0.1), (-end, end)),
        ("boom", (0, 1, 0), (0, 0, 0.5), (0.7, 0, 0), (-1.4, 0.5)),
        ("stick", (0, 1, 0), (1.5, 0, 0), (0.6, 0, 0), (0.1, 2.7)),
    ):
        joint = {"name": name, "kind": "hinge", "axis": axis, "limits": limits}
        bodies.append({"name": name, "parent": bodies[-1]["name"], "joint": joint, "position": position, "com": com,
                       "mass": 60.0 * com[0] + 10.0, "inertia": (5.0, 6.0, 5.5, 0, 0, 0)})  # fmt: skip
    end_point = {"body": "stick", "position": (1.2, 0, 0), "rows": ("x", "y", "z")}
    machine = tree_from_dict({"name": "crane", "bodies": bodies, "end_point": end_point, "placement": ("x",)})
    (found,) = inverse_kinematics(machine, (-1.8, 0.0, 1.5), gravity=gravity)
    assert abs(found[0]) == pytest.approx(math.pi)


@pytest.mark.parametrize(
    ("softer", "posture"),
    [(2.1426462416416516, (-0.565865638, 1.99770235e-05)), (2.2762418351681615, (-0.480902188, 4.06611682e-05))],
)
def test_a_small_machine_has_no_posture_told_twice(softer, posture):
    """An arm of 4 cm, its springs so that it sags as one of 4 m does: that two postures are one is no matter of size."""
    data, size = load("excavator").to_dict(), 0.01
    powers = {"length": 1, "com": 1, "mass": 3, "inertia": 5, "x": 2, "y": 2, "rotation": 4}

    def scaled(table):
        own = {name: value * size ** powers[name] for name, value in table.items() if name in powers}
        return {name: scaled(value) if isinstance(value, dict) else value for name, value in table.items()} | own

    base = data["base"] | {"stiffness": {name: softer * k for name, k in data["base"]["stiffness"].items()}}
    small = {"base": scaled(base), "links": tuple(map(scaled, data["links"]))}
    machine = machine_from_dict({"name": "small", "schema": 1} | small)
    plant = build_plant(machine)
    sagged = ca.vertcat(plant.deflected(0.0, posture, plant.parameter_values), posture)
    target = plant.end_point(sagged, 0.0, plant.parameter_values).full().ravel()
    found = inverse_kinematics(machine, target, gravity=True)
    assert 1 <= len(found) <= 2
    assert min(np.abs(each - posture).max() for each in found) < 2e-4


def crane(size, *, upper, fore):
    """A slew on a pedestal of 1.5 m, a boom and a stick of these lengths, on a spring that hardly gives; all scaled."""
    spring = {"name": "pitch", "kind": "hinge", "axis": (0, 1, 0), "passive": True, "damping": 1e3}
    spring["stiffness"] = 3e14 * size**4
    bodies = [
        {
            "name": "car",
            "parent": None,
            "joint": spring,
            "mass": 900.0 * size**3,
            "inertia": (90.0 * size**5,) * 3 + (0, 0, 0),
        }
    ]
    for name, axis, position, limits, length in (
        ("slew", (0, 0, 1), (0, 0, 1.0), (-1.5, 1.5), 1.0),
        ("boom", (0, 1, 0), (0, 0, 0.5), (-1.4, 0.5), upper),
        ("stick", (0, 1, 0), (upper, 0, 0), (-2.7, 2.7), fore),
    ):
        joint = {"name": name, "kind": "hinge", "axis": axis, "limits": limits}
        inertia = (*(x * length**2 * size**5 for x in (5.0, 6.0, 5.5)), 0, 0, 0)
        bodies.append({"name": name, "parent": bodies[-1]["name"], "joint": joint, "inertia": inertia,
                       "position": tuple(size * x for x in position), "mass": 50.0 * length * size**3,
                       "com": (0.5 * length * size, 0, 0)})  # fmt: skip
    end_point = {"body": "stick", "position": (fore * size, 0, 0), "rows": ("x", "y", "z")}
    return tree_from_dict({"name": "crane", "bodies": bodies, "end_point": end_point})


@pytest.mark.parametrize("gravity", [False, True])
@pytest.mark.parametrize(
    ("size", "upper", "fore"), [(1.0, 1.5, 1.2), (1.0, 1.5, 0.02), (1.0, 0.015, 0.012), (1e-2, 1.5, 1.2)]
)
def test_a_straight_arm_is_one_posture_whatever_its_links(size, upper, fore, gravity):
    """Steps leave its elbow as far bent as that is off by 10⁻¹⁰ m, which a short link makes much."""
    machine = crane(size, upper=upper, fore=fore)
    along = np.array([math.cos(0.4) * math.cos(0.3), math.cos(0.4) * math.sin(0.3), math.sin(0.4)])
    target = size * (np.array([0.0, 0.0, 1.5]) + (upper + fore) * along)
    [only] = inverse_kinematics(machine, target, gravity=gravity)
    assert only == pytest.approx([0.3, -0.4, 0.0], abs=2e-2)
    nearer = size * (np.array([0.0, 0.0, 1.5]) + (1 - 1e-4) * (upper + fore) * along)
    assert len(inverse_kinematics(machine, nearer, gravity=gravity)) == 2


def test_postures_along_a_self_motion_are_told_apart_at_every_size():
    """Three hinges in a plane that no closed form is used of, and two rows."""
    counts = []
    for size in (1.0, 1e-3):
        spring = {
            "name": "base.z",
            "kind": "slide",
            "axis": [0, 0, 1],
            "passive": True,
            "stiffness": 1e7,
            "damping": 0.0,
        }
        body = {"mass": size**3, "com": [0, 0, 0], "inertia": [size**5] * 3 + [0] * 3}
        bodies = [{"name": "base", "parent": None, "joint": spring} | body]
        for k, length in enumerate((0.0, 1.0, 0.8)):
            joint = {"name": f"q{k}", "kind": "hinge", "axis": [0, 1, 0], "limits": [-1.5, 1.5]}
            place = {"position": [size * length, 0, 0]}
            bodies.append({"name": f"link {k}", "parent": bodies[-1]["name"], "joint": joint} | place | body)
        end_point = {"body": "link 2", "position": [0.6 * size, 0, 0], "rows": ["x", "z"]}
        machine = tree_from_dict({"name": "three", "bodies": bodies, "end_point": end_point})
        counts.append(len(inverse_kinematics(machine, size * np.array([1.5, 0.4]))))
    assert counts[0] > 50
    # Of the small one those a milliradian apart are one: what lies between them is on the target to 10⁻¹⁰ m as they are.
    assert counts[1] >= 0.7 * counts[0]


@pytest.mark.parametrize("size", [1.0, 1e-3])
def test_slides_are_told_apart_as_shares_of_the_arm(size):
    """A lift, a boom and a telescope of 1 m and of 1 mm: a hundredth of it apart is another posture, a 10⁻⁵th none."""
    parts, bodies = (("lift", "slide", 0.0), ("boom", "hinge", 0.2), ("telescope", "slide", 1.0)), []
    for parent, (name, kind, x) in zip(("base", "lift", "boom"), parts, strict=True):
        joint = {"name": name, "kind": kind, "axis": [0, 1, 0] if kind == "hinge" else [1, 0, 0], "limits": [-1, 1]}
        numbers = {"mass": 1.0, "com": [0, 0, 0], "inertia": [1e-6, 1e-6, 1e-6, 0, 0, 0]}
        bodies.append({"name": name, "parent": parent, "joint": joint, "position": [size * x, 0, 0]} | numbers)
    spring = {"name": "base.z", "kind": "slide", "axis": [0, 0, 1], "passive": True, "stiffness": 1e7, "damping": 0.0}
    bodies = [
        {"name": "base", "parent": None, "joint": spring, "mass": 1.0, "com": [0, 0, 0]}
        | {"inertia": [1e-6] * 3 + [0] * 3},
        *bodies,
    ]
    end_point = {"body": "telescope", "position": [0.2 * size, 0, 0], "rows": ["x", "z"]}
    plant = build_plant(tree_from_dict({"name": "small", "bodies": bodies, "end_point": end_point}))
    assert arm_length(plant) == pytest.approx(1.4 * size, rel=1e-9)
    posture = np.array([0.0, 0.3, 0.0])
    for moved, count in ((1e-2, 2), (1e-5, 1)):
        assert len(distinct(plant, [posture, posture + moved * size * np.eye(3)[2]], 1e-3)) == count
        assert len(distinct(plant, [posture, posture + moved * np.eye(3)[1]], 1e-3)) == count


def test_a_last_link_of_next_to_no_length_is_no_fault_of_its_own():
    data = load("excavator").to_dict()
    data["links"] = (data["links"][0], dict(data["links"][1]) | {"length": 5e-4, "com": 2e-4})
    with pytest.raises(UnreachableTarget, match="of the machine as it sags"):
        inverse_kinematics(machine_from_dict(data), (1.5, 1.6), gravity=True)


@pytest.mark.parametrize(("bearing", "beyond"), [(0.0, 0.03), (0.8, 0.01), (1.57, -0.003)])
def test_beyond_the_border_of_the_sagging_reach_it_is_told_by_how_much(bearing, beyond):
    """Upwards what is within reach with springs unloaded is not as the machine sags."""
    machine = load("excavator")
    off = missed_from(machine, bearing, beyond)
    target = -off(None)
    with pytest.raises(UnreachableTarget, match="of the machine as it sags") as caught:
        inverse_kinematics(machine, target, gravity=True)

    straight = bearing - machine.base.rest_angle
    nearest = min(
        minimize(lambda x: np.linalg.norm(off(x)), [straight, bend], method="Nelder-Mead").fun for bend in (-0.1, 0.1)
    )
    # Told is the larger of two rows, at a posture of which springs may be off by a hundredth of that.
    assert 0.7 * nearest < caught.value.miss < 1.02 * nearest


@pytest.mark.parametrize("seed", range(6))
def test_with_joint_limits_the_nearest_posture_is_told(seed):
    """By a grid of 80 x 80 postures within the limits; told is what was found, which may be nearer."""
    rng = np.random.default_rng(seed)
    data, limits = load("excavator").to_dict(), []
    for link in data["links"]:
        low = rng.uniform(-3.0, 2.0)
        limits.append((low, min(low + rng.uniform(0.7, 2.5), 3.1)))
        link["limits"] = limits[-1]
    machine = machine_from_dict(data)
    plant = build_plant(machine)
    p, grid = plant.parameter_values, np.stack(np.meshgrid(*(np.linspace(*ends, 80) for ends in limits))).reshape(2, -1)
    bases = np.zeros((1, grid.shape[1]))
    q = np.vstack([plant.deflected.call([bases, grid, p])[0].full(), grid])
    ends = plant.end_point.call([q, bases, p])[0].full()
    for bearing in (-2.0, 0.0, 2.0):
        target = np.array([0.17, 0.51]) + 3.2 * np.array([np.cos(bearing), np.sin(bearing)])
        with pytest.raises(UnreachableTarget) as caught:
            inverse_kinematics(machine, target, gravity=True)
        least = np.linalg.norm(ends - target[:, None], axis=0).min()
        assert caught.value.miss < 1.02 * least


def test_in_space_too_it_is_told_by_how_much_the_sagging_machine_is_short():
    """A millimetre above the highest point with springs unloaded; by Nelder and Mead's method."""
    machine = load("slewing-excavator")
    plant = build_plant(machine)
    p, base, bounds = plant.parameter_values, np.zeros(3), [(a, b) for a, b in machine.limits]

    def at(posture, *, sags):
        q_p = plant.deflected(base, posture, p) if sags else plant.rest(base, posture, p)[: plant.n_passive]
        return plant.end_point(ca.vertcat(q_p, posture), base, p).full().ravel()

    middle = np.array([0.3, *(np.mean(ends) for ends in bounds[1:])])
    bounds[0] = (-3.0, 3.0)
    high = minimize(lambda x: -at(x, sags=False)[2], middle, method="Nelder-Mead", bounds=bounds).x
    target = at(high, sags=False) + np.array([0.0, 0.0, 1e-3])
    with pytest.raises(UnreachableTarget) as caught:
        inverse_kinematics(machine, target, base=base, gravity=True)
    nearest = minimize(
        lambda x: np.linalg.norm(at(x, sags=True) - target), high, method="Nelder-Mead", bounds=bounds,
        options={"maxiter": 2000, "xatol": 1e-9, "fatol": 1e-12},
    ).fun  # fmt: skip
    assert nearest > 2e-3
    assert 0.57 * nearest < caught.value.miss < 1.02 * nearest


def test_limits_hold_under_gravity_too():
    machine, target = load("excavator"), [2.0, 1.0]
    at_rest, loaded = inverse_kinematics(machine, target)[0], inverse_kinematics(machine, target, gravity=True)[0]
    assert np.abs(loaded - at_rest).max() > 1e-4
    for joint in range(2):
        # A limit between the two: the posture at rest keeps it, the loaded one does not.
        limits = np.array([[-3.2, 3.2], [-3.2, -1e-3]])
        limits[joint, int(loaded[joint] > at_rest[joint])] = (loaded[joint] + at_rest[joint]) / 2
        limited = with_limits(machine, limits)
        try:
            found = inverse_kinematics(limited, target, gravity=True)
        except UnreachableTarget:
            continue
        for posture in found:
            assert np.all((posture >= limits[:, 0]) & (posture <= limits[:, 1]))
        # And the other way round: what only the load brings inside the limits is a posture.
    for joint in range(2):
        limits = np.array([[-3.2, 3.2], [-3.2, -1e-3]])
        limits[joint, int(loaded[joint] < at_rest[joint])] = (loaded[joint] + at_rest[joint]) / 2
        found = inverse_kinematics(with_limits(machine, limits), target, gravity=True)
        assert np.abs(found[0] - loaded).max() < 1e-9


@pytest.mark.long
@settings(derandomize=True, max_examples=6)
@given(drawn=machines({"n_max": 3}), seed=seeds)
def test_miss_is_the_distance_to_the_nearest_point_that_can_be_reached(drawn, seed):
    _, machine = drawn
    rng = np.random.default_rng(seed)
    base = float(rng.uniform(-5, 5))
    inner, outer = annulus(machine)
    angle, inside = rng.uniform(-math.pi, math.pi), inner > 0.05 and rng.random() < 0.5
    radius = rng.uniform(0.1, 0.9) * inner if inside else outer * rng.uniform(1.02, 2.0)
    target = shoulder(machine, base) + radius * np.array([math.cos(angle), math.sin(angle)])
    with pytest.raises(UnreachableTarget) as caught:
        inverse_kinematics(machine, target, base=base)

    def distance(posture):
        gap = arm_at_rest(machine, posture, base)[1] - target
        return gap @ gap

    starts = [random_posture(rng, machine) for _ in range(8)]
    nearest = math.sqrt(min(minimize(distance, start, tol=1e-12).fun for start in starts))
    # BFGS with differences stops at a relative 1e-6 of the squared distance.
    assert math.isclose(caught.value.miss, nearest, rel_tol=1e-5, abs_tol=1e-6)


def check_intervals(machine, rng, just):
    """Placements just inside an interval reach the target, those just outside do not."""
    inner, outer = annulus(machine)
    center = shoulder(machine, 0.0)
    # Far to the side, and at a height that the arm has; sometimes lower than the hole, which gives two intervals.
    rise = rng.uniform(-0.9, 0.9) * (inner if inner > 0.1 and rng.random() < 0.5 else outer)
    target = np.array([rng.uniform(-5, 5), center[1] + rise])
    far = target[0] - center[0] + 3 * outer
    with pytest.raises(UnreachableTarget) as caught:
        inverse_kinematics(machine, target, base=far)
    intervals = caught.value.base_intervals
    assert len(intervals) == (2 if abs(rise) < inner else 1)
    for low, high in intervals:
        assert low < high
        for inside, outside in ((low + just, low - just), (high - just, high + just)):
            for posture in inverse_kinematics(machine, target, base=inside):
                assert np.abs(arm_at_rest(machine, posture, inside)[1] - target).max() < 1e-12
            with pytest.raises(UnreachableTarget):
                inverse_kinematics(machine, target, base=outside)


@settings(derandomize=True, max_examples=8)
@given(drawn=machines(TWO), seed=seeds)
def test_base_intervals_of_two_joints(drawn, seed):
    check_intervals(drawn[1], np.random.default_rng(seed), 1e-7)


@pytest.mark.parametrize(
    "structure", [Structure(3, ("x",), ()), Structure(4, ("y",), (1,)), Structure(5, ("rotation",), ())]
)
def test_base_intervals_of_more_joints(structure):
    rng = np.random.default_rng(7)
    for _ in range(2):
        check_intervals(machine_from_dict(draw_machine(NumpySource(rng), structure)), rng, 1e-3)


@pytest.mark.parametrize("n", [3, 4, 5])
def test_target_of_a_known_posture_is_never_called_unreachable(n):
    rng = np.random.default_rng(n)
    for _ in range(12):
        machine = machine_from_dict(draw_machine(NumpySource(rng), Structure(n, ("x",), ())))
        target = arm_at_rest(machine, random_posture(rng, machine))[1]
        assert inverse_kinematics(machine, target)


def test_target_that_is_too_high_has_no_base_interval():
    with pytest.raises(UnreachableTarget) as caught:
        inverse_kinematics(load("excavator"), [0.0, 10.0])
    assert caught.value.base_intervals == ()
    inner, outer = annulus(load("excavator"))
    assert inner < outer < caught.value.miss + outer


@settings(derandomize=True, max_examples=6)
@given(drawn=machines({"n_min": 3}), seed=seeds)
def test_passive_arm_joints_stay_at_rest_in_the_chain(drawn, seed):
    data, machine = drawn
    rng = np.random.default_rng(seed)
    plant, target = build_plant(machine), target_inside(rng, machine, 0.0)
    for posture in inverse_kinematics(machine, target)[:4]:
        q = plant.rest(0.0, posture, plant.parameter_values).full().ravel()
        tip = lagrange(data).dynamics(q, np.zeros(len(q)), 0.0)[3].full().ravel()
        assert np.abs(tip - target).max() < 1e-12


def test_rounding_of_a_placement_is_told_as_zero() -> None:
    with pytest.raises(UnreachableTarget, match=r"with the base at x 0\.5 m, y -0\.25 m, yaw 0 rad: ") as caught:
        inverse_kinematics(load("slewing-excavator"), (50.0, 0.0, 1.0), base=(0.5, -0.25, 1.31836e-28))
    assert caught.value.miss > 30
