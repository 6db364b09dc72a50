"""Constraints under gravity, of machines that sag, against the sagged machine by means of its own."""

from __future__ import annotations

from itertools import pairwise, product
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import root

import flexopt
from flexopt.model.constraints import read_constraints
from flexopt.plant import build_plant
from flexopt.plotting.shape import shape_at
from flexopt.selection.broken import broken_names
from flexopt.selection.constraints import build_constraints
from tests.selection.constraints.test_corners import SHIPPED, supported, values, with_numbers


def posture_of(machine: Any) -> np.ndarray:
    """Within the limits."""
    low, high = np.clip(np.array(machine.limits), -2.0, 2.0).T
    return low + 0.4 * (high - low)


def sagged(machine: Any, base: np.ndarray, posture: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Coordinates where springs and weight balance, by Newton's method with differences: K (q − q₀) + g(q) = 0."""
    plant = build_plant(machine)
    m, rest = plant.n_passive, plant.rest(base, posture, p).full().ravel()
    stiffness = plant.stiffness(p).full()[:m, :m]

    def force(passive: np.ndarray) -> np.ndarray:
        q = np.concatenate([passive, posture])
        return stiffness @ (passive - rest[:m]) + plant.gravity(q, base, p).full().ravel()[:m]

    passive, step = rest[:m].copy(), 1e-6
    for _ in range(30):
        slopes = np.array([(force(passive + step * e) - force(passive - step * e)) / (2 * step) for e in np.eye(m)]).T
        passive -= np.linalg.solve(slopes, force(passive))
    return np.concatenate([passive, posture])


def held(machine: Any, base: np.ndarray, posture: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """The posture, turned by Jvᵀ λ, with which the end-point of the machine with other numbers is where it was."""
    plant = build_plant(machine)
    own, m = plant.parameter_values.full().ravel(), plant.n_passive

    def end_point(q: np.ndarray) -> np.ndarray:
        return plant.end_point(q, base, own).full().ravel()

    at, there, step = sagged(machine, base, posture, own), sagged(machine, base, posture, numbers), 1e-6
    slopes = [(end_point(there + step * e) - end_point(there - step * e)) / (2 * step) for e in np.eye(at.size)[m:]]
    found: Any = root(
        lambda x: end_point(sagged(machine, base, posture + np.array(slopes) @ x, numbers)) - end_point(at),
        np.zeros(plant.n_task),
        tol=1e-13,
    )
    assert np.abs(found.fun).max() < 1e-10
    return posture + np.array(slopes) @ found.x


@pytest.mark.long("slewing-excavator")
@pytest.mark.parametrize("name", SHIPPED)
def test_volumes_and_the_centre_of_mass_are_those_of_the_sagged_machine(name: str) -> None:
    machine = supported(name)
    plant, d = build_plant(machine), build_plant(machine).frames.dimension
    base, posture, p = np.full(plant.n_base, 0.2), posture_of(machine), plant.parameter_values.full().ravel()
    wall = {"kind": "half_plane", "name": "wall", "point": [3.0] * d, "normal": [-1.0, *[0.2] * (d - 1)]}
    tank = {"kind": "sphere", "name": "tank", "center": [4.0] * d, "radius": 0.5}
    asked: dict[str, Any] = {"tip_over_margin": 0.01}
    if machine.capsules:
        asked["clearance"] = {"distance": 0.1, "obstacles": [wall, tank]}
    payload = "payload.mass"
    own = {each.name: each.value for each in machine.parameters}[payload]
    heavy = 2.0 * own + 0.05 * sum(each.value for each in machine.parameters if each.unit == "kg")
    rows = build_constraints(plant, read_constraints(asked | {"within": {payload: (own, heavy)}}), gravity=True)
    at_rest = build_constraints(plant, read_constraints(asked))
    found = values(machine, rows, base, posture, p)
    reported = dict(
        zip([row.name for row in rows.rows], rows.report(base, posture, p, rows.constants).full().ravel(), strict=True)
    )
    seen, moved = 0, 0.0
    for mass in (own, heavy):
        numbers = with_numbers(machine, {payload: mass})
        q = sagged(machine, base, held(machine, base, posture, numbers), numbers)
        assert np.abs(q - plant.rest(base, posture, numbers).full().ravel()).max() > 1e-4
        # The rounds that hold the end-point leave some of 1e-8 m.
        close = 1e-9 if mass == own else 1e-7
        where = f" where {payload} is {mass:.4g} kg" * (mass != own)
        centre = plant.centre_of_mass(q, base, numbers).full().ravel()
        unsagged = plant.centre_of_mass(plant.rest(base, posture, numbers), base, numbers).full().ravel()
        if d == 2:
            (low, high), x = np.sort(np.array(machine.support_points).ravel())[[0, -1]], centre[0] - base[0]
            margins = sorted([x - low, high - x])
            told = sorted(value for label, value in reported.items() if label.startswith("tip-over"))
            assert {round(m, 7) for m in margins} <= {round(t, 7) for t in told}
        moved = max(moved, float(np.abs(centre - unsagged)[: d - 1].max()))
        for (start, end, radius), capsule in zip(shape_at(machine, q, base).capsules, machine.capsules, strict=True):
            ends = [np.asarray(start), np.asarray(end)]
            along = (ends[1] - ends[0]) if capsule.start != capsule.end else None
            if len([each for each in machine.capsules if each.called == capsule.called]) > 1:
                continue
            normal = np.array(wall["normal"]) / np.linalg.norm(wall["normal"])
            walls = [float(normal @ (each - 3.0)) - radius for each in ends]
            labels = [f"{capsule.called} (start)", f"{capsule.called} (end)"] if along is not None else [capsule.called]
            for label, away in zip(labels, walls, strict=False):
                assert reported[f"clearance of {label} from wall{where}"] == pytest.approx(away, abs=close)
                seen += 1
            middle = np.full(d, 4.0)
            share = 0.0 if along is None else float(np.clip((middle - ends[0]) @ along / (along @ along), 0, 1))
            nearest = ends[0] if along is None else ends[0] + share * along
            gap = float(np.linalg.norm(middle - nearest)) - 0.5 - radius
            assert reported[f"clearance of {capsule.called} from tank{where}"] == pytest.approx(gap, abs=close)
    assert seen > 0 or not machine.capsules
    assert moved > 1e-5
    # At rest they are others.
    unmoved = values(machine, at_rest, base, posture, p)
    assert max(abs(found[label] - value) for label, value in unmoved.items()) > 1e-6


# A spring that the weight of the whole machine compresses, whatever the arm does, and one that the arm's place turns.
SPRINGS = {
    "boom-stick-bucket": ("base.stiffness.y", "base.stiffness.rotation"),
    "slewing-excavator": ("stiffness.base.z.base.z", "stiffness.base.pitch.base.pitch"),
    "truck-crane": ("stiffness.base.z.base.z", "stiffness.base.pitch.base.pitch"),
    "mobile-manipulator": ("heave.stiffness", "pitch.stiffness"),
}


@pytest.mark.long("slewing-excavator")
@pytest.mark.parametrize("name", SPRINGS)
def test_where_a_spring_only_lets_the_base_down_the_arm_that_is_held_on_its_target_turns(name: str) -> None:
    """Its angle counts at the ends of that spring, too: at the same joint angles it would not know of it."""
    machine, (heave, turn) = supported(name), SPRINGS[name]
    plant = build_plant(machine)
    base, posture, own = np.full(plant.n_base, 0.2), posture_of(machine), plant.parameter_values.full().ravel()
    asked = {"tool_angle": [-3.0, 3.0]}
    names = [each.name for each in machine.parameters]
    ends = {of: [factor * own[names.index(of)] for factor in (0.6, 1.4)] for of in (heave, turn)}
    plain = build_constraints(plant, read_constraints(asked), gravity=True)
    alone = build_constraints(plant, read_constraints(asked | {"within": {heave: ends[heave]}}), gravity=True)
    both = build_constraints(plant, read_constraints(asked | {"within": ends}), gravity=True)
    assert (len(alone), len(both)) == (3 * len(plain), 5 * len(plain))
    found = list(values(machine, both, base, posture, own).values())
    corners = [dict(zip(ends, each, strict=True)) for each in product(*ends.values())]
    angles = [*values(machine, plain, base, posture, own).values()]
    for numbers in (with_numbers(machine, corner) for corner in corners):
        there = held(machine, base, posture, numbers)
        angles += values(machine, plain, base, there, numbers).values()
    assert found == pytest.approx(angles, abs=1e-6)
    assert np.ptp(list(values(machine, alone, base, posture, own).values())) > 1e-4


@pytest.mark.parametrize("name", SPRINGS)
def test_joints_of_the_arm_that_is_held_keep_their_limits_at_corners_too(name: str) -> None:
    """With other springs it is turned, and with the file's numbers the bounds of variables are enough."""
    machine, of = supported(name), SPRINGS[name][1]
    plant = build_plant(machine)
    base, posture, own = np.full(plant.n_base, 0.2), posture_of(machine), plant.parameter_values.full().ravel()
    here = own[[each.name for each in machine.parameters].index(of)]
    within = {"within": {of: (0.6 * here, here)}}
    limits = np.column_stack([posture - 0.3, np.full(posture.size, np.inf)])
    there = held(machine, base, posture, with_numbers(machine, {of: 0.6 * here}))
    assert np.abs(there - posture).max() > 1e-5
    assert not len(build_constraints(plant, read_constraints({}), gravity=True, limits=limits))
    for margin, expected in (({}, there), ({"joint_margin": 0.1}, there - limits[:, 0] + 0.1)):
        rows = build_constraints(plant, read_constraints(within | margin), gravity=True, limits=limits)
        assert list(values(machine, rows, base, posture, own).values()) == pytest.approx(expected, abs=1e-6)
        ends = 0.1 if margin else limits[:, 0]
        np.testing.assert_allclose([row.lower for row in rows.rows], ends)


@pytest.mark.long("0.0", "0.01")
@pytest.mark.parametrize("margin", [None, 0.0, 0.01])
def test_a_choice_keeps_joints_within_their_limits_on_other_springs(margin: float | None) -> None:
    """Of an arm that is held on its target; without `within` it would not."""
    data = flexopt.load("excavator").to_dict() | {"gravity": 9.81}
    for link, ends in zip(data["links"], ([-1.22, 1.6], [-2.8, 1.485]), strict=True):
        link["limits"] = ends
    machine, few = flexopt.machine_from_dict(data), {"base": 0.0, "gravity": True, "starts": 4}
    asked = {} if margin is None else {"joint_margin": margin}
    low, high = np.array(machine.limits).T
    names = [each.name for each in machine.parameters]

    def room(found: Any) -> float:
        rooms = list[float]()
        for candidate, factor in product(found.candidates, (0.3, 2.0)):
            at, p = candidate.evaluation, build_plant(machine).parameter_values.full().ravel()
            p[["stiffness" in name for name in names]] *= factor
            there = held(machine, at.base, at.posture, p)
            rooms.append(float(np.minimum(there - low, high - there).min()))
        return min(rooms)

    assert room(flexopt.select(machine, (0.0, 1.6), constraints=asked, **few)) < -1e-3
    springs = {"within": [{"of": "stiffness", "factor": [0.3, 2.0]}]}
    assert room(flexopt.select(machine, (0.0, 1.6), constraints=asked | springs, **few)) > (margin or 0.0) - 1e-6


def test_a_margin_at_corners_is_told_of_the_nearer_end_of_each_joint() -> None:
    machine, factors = flexopt.load("boom-stick-bucket"), (0.5, 2.0)
    asked = {"joint_margin": 0.1, "within": [{"of": "stiffness", "factor": list(factors)}]}
    found = flexopt.select(machine, (7.0, 1.0), base=0.0, gravity=True, constraints=asked, starts=1, workers=1).best
    names = [each.name for each in machine.parameters]
    low, high = np.array(machine.limits).T
    for factor in factors:
        p = build_plant(machine).parameter_values.full().ravel()
        p[["stiffness" in name for name in names]] *= factor
        there = held(machine, found.evaluation.base, found.evaluation.posture, p)
        told = [
            found.constraints[f"joint margin of {name} where stiffness is {factor:g} of the file's"].value
            for name in machine.joints
        ]
        np.testing.assert_allclose(told, np.minimum(there - low, high - there), atol=1e-6)


@pytest.mark.long
def test_a_choice_keeps_the_angle_on_every_pair_of_springs() -> None:
    """Of one target and of several, by w and by the loop; without `within` it would not."""
    data = flexopt.load("boom-stick-bucket").to_dict()
    data["base"]["stiffness"] = {name: 0.3 * own for name, own in data["base"]["stiffness"].items()}
    machine = flexopt.machine_from_dict(data)
    factors = {"y": (0.5, 1.5), "rotation": (0.7, 1.5)}
    within = [{"of": f"base.stiffness.{name}", "factor": pair} for name, pair in factors.items()]
    lower, upper = -0.5, 0.1
    options: dict[str, Any] = {"base": 0.0, "gravity": True, "starts": 4}
    by_loop: dict[str, Any] = {"objective": "decay", "loop": {"kp": 1e4, "kv": 1e3}}

    def room(*evaluations: Any) -> float:
        """Of the last link's inclination from the range, at all pairs."""
        angles = list[float]()
        for at, pair in product(evaluations, product(*factors.values())):
            numbers = {name: x * data["base"]["stiffness"][name] for name, x in zip(factors, pair, strict=True)}
            p = with_numbers(machine, {f"base.stiffness.{name}": x for name, x in numbers.items()})
            q = sagged(machine, at.base, held(machine, at.base, at.posture, p), p)
            # Rotation of the base, which has its rest angle in it, and joints.
            angles.append(float(np.angle(np.exp(1j * q[2:].sum()))))
        return min(min(angles) - lower, upper - max(angles))

    asked: dict[str, Any] = {"tool_angle": [lower, upper]}
    target, further = (6.5, 1.0), (6.0, 1.5)
    for more in ({}, by_loop):
        plain = flexopt.select(machine, target, constraints=asked, **options, **more)
        assert min(room(each.evaluation) for each in plain.candidates) < -1e-3
        kept = flexopt.select(machine, target, constraints=asked | {"within": within}, **options, **more)
        assert min(room(each.evaluation) for each in kept.candidates) > -1e-6
        stand = flexopt.select_stand(
            machine, [target, further], constraints=asked | {"within": within}, **options, **more
        )
        assert room(*(place.evaluation for place in stand.places)) > -1e-6


@pytest.mark.parametrize("name", SHIPPED)
def test_slopes_of_rows_are_those_of_differences(name: str) -> None:
    machine = supported(name)
    plant = build_plant(machine)
    base, posture, p = np.full(plant.n_base, 0.2), posture_of(machine), plant.parameter_values
    asked: dict[str, Any] = {"tip_over_margin": 0.01, "manipulability": 0.1}
    if machine.capsules:
        far = {"kind": "sphere", "name": "tank", "center": [9.0] * plant.frames.dimension, "radius": 0.5}
        asked["clearance"] = {"distance": 0.1, "obstacles": [far]}
    rows = build_constraints(plant, read_constraints(asked), gravity=True)
    z = ca.SX.sym("z", plant.n_base + plant.n_actuated)
    n_b = plant.n_base
    graph = rows.function(z[:n_b], z[n_b:], p, rows.constants)
    slopes = ca.Function("slopes", [z], [ca.jacobian(graph, z)])
    at, step = np.concatenate([base, posture]), 1e-5

    def g(z: np.ndarray) -> np.ndarray:
        return rows.function(z[:n_b], z[n_b:], p, rows.constants).full().ravel()

    differences = np.array([(g(at + step * e) - g(at - step * e)) / (2 * step) for e in np.eye(at.size)]).T
    size = np.abs(differences).max()
    # Of central differences: step squared, and rounding over the step.
    assert np.abs(slopes(at).full() - differences).max() < 1e-7 * size


def test_what_is_chosen_keeps_its_distance_as_it_sags() -> None:
    """The bucket above a floor, as its springs and its weight have it."""
    machine = supported("boom-stick-bucket")
    tips = [capsule for capsule in machine.capsules if capsule.body == "bucket"]
    assert tips
    target = (7.0, 1.0)
    wall = {"kind": "half_plane", "name": "floor", "point": [0.0, 0.2], "normal": [0.0, 1.0]}
    constraints = {"clearance": {"distance": 0.05, "bodies": ["bucket"], "obstacles": [wall]}}
    chosen = flexopt.select(machine, target, base=0.0, gravity=True, constraints=constraints, starts=4)
    for candidate in chosen.candidates:
        e = candidate.evaluation
        q = sagged(machine, e.base, e.posture, build_plant(machine).parameter_values.full().ravel())
        least = min(
            min(start[1], end[1]) - 0.2 - radius
            for start, end, radius in shape_at(machine, q, e.base).capsules[-len(tips) :]
        )
        told = min(
            value.value for label, value in candidate.constraints.items() if "bucket" in label and "floor" in label
        )
        assert told == pytest.approx(least, abs=1e-8)
        assert told >= 0.05 - 1e-6
        assert e.end_point == pytest.approx(target, abs=1e-8)
    assert all(one.objective >= other.objective for one, other in pairwise(chosen.candidates))


def soft(rotation: float) -> Any:
    """The article's excavator with volumes and a load, on a rotational spring of so many N m/rad."""
    data = flexopt.load("excavator").to_dict() | {"payload": {"mass": 200.0}, "support": {"span": [-1.5, 1.5]}}
    data["base"]["stiffness"]["rotation"] = rotation
    data["capsules"] = [
        {"body": "boom", "start": [0.0, 0.0], "end": [1.918, 0.0], "radius": 0.15},
        {"body": "stick", "start": [0.0, 0.0], "end": [1.0, 0.0], "radius": 0.12},
    ]
    return flexopt.machine_from_dict(data)


def test_a_machine_that_sags_far_is_looked_at_where_it_reaches_the_target() -> None:
    """Postures that reach the target with unloaded springs break the clearance; those that reach it sagged keep it."""
    machine = soft(1.0e5)
    table = {"kind": "box", "name": "table", "center": [2.28475, 0.950797], "size": [0.642082, 0.439056]}
    constraints = {"tip_over_margin": 0.05, "clearance": {"distance": 0.05, "obstacles": [table]}}
    asked: dict[str, Any] = {"base_range": (1.2523218, 1.5023218), "objective": "w2", "gravity": True}
    target = (2.46847248, 1.40682062)
    chosen = flexopt.select(machine, target, base=1.2523218, constraints=constraints, **asked)
    e = chosen.best.evaluation
    assert np.abs(e.static_deflection).max() > 0.2
    # By Newton's method with differences, at the near end of the range.
    base, p = np.array([1.2523218]), build_plant(machine).parameter_values.full().ravel()

    def off(posture: np.ndarray) -> np.ndarray:
        q = sagged(machine, base, posture, p)
        return build_plant(machine).end_point(q, base, p).full().ravel() - np.array(target)

    there: Any = root(off, np.array([0.43, -2.4]), tol=1e-12)
    assert np.abs(there.fun).max() < 1e-10
    known = flexopt.evaluate(machine, there.x, base=1.2523218, gravity=True)
    assert chosen.best.objective >= known.w[1] * (1 + 1e-6)


def test_no_place_is_chosen_where_the_machine_falls_over_at_a_corner() -> None:
    """At a tenth of the stiffness it falls in some postures: there rows would be numbers of nothing."""
    machine = soft(2.5e5)
    constraints = {"tip_over_margin": 0.05, "within": [{"of": "stiffness", "factor": [0.1, 1.0]}]}
    with pytest.raises(flexopt.NoSolutionFound, match=r"static equilibrium where stiffness is 0\.1 of the file's"):
        flexopt.select(machine, (2.0, 1.2), base=0.0, gravity=True, constraints=constraints, starts=4)
    enough = constraints | {"within": [{"of": "stiffness", "factor": [0.8, 1.0]}]}
    chosen = flexopt.select(machine, (2.0, 1.2), base=0.0, gravity=True, constraints=enough, starts=4)
    assert any("where stiffness is 0.8 of the file's" in name for name in chosen.best.constraints)


def test_an_assumed_ground_is_asked_for_by_nobody_at_corners_either() -> None:
    machine = soft(2.5e5)
    kept = {"tip_over_margin": 0.05, "within": [{"of": "payload.mass", "value": [100.0, 300.0]}]}
    problem = flexopt.build_selection(machine, (2.0, 0.4), base=0.0, gravity=True, constraints=kept)
    z = np.array([0.0, -1.6, 1.5])
    below = [name for name in broken_names(problem, z) if "the assumed ground where payload.mass" in name]
    assert below
    assert not set(below) & set(broken_names(problem, z, asked=True))
