"""Bases that are driven and turned: a machine on driven joints, placements that name less, what is refused."""

from __future__ import annotations

import numpy as np
import pytest

import flexopt
from flexopt.errors import InputError
from flexopt.model import tree_from_dict
from flexopt.plant import build_plant
from tests.oracles.driven_base import driven_run
from tests.oracles.spatial import grounded
from tests.simulation.loops import run, scenario

pytestmark = pytest.mark.usefixtures("interpreted")

ARM = (0.3, 0.5, -1.0)
BASE = np.array([0.7, -0.4, 0.9])
TURNED = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
GAINS = {"control": "transpose", "kp": 3e4, "kv": 1e4}
TIMES = (0.1, 0.3, 0.6)
WAY = np.array([[0.0, 0.0, 0.0], [0.2, 0.1, 0.5], [0.15, -0.1, 0.2]])


def tracks(placement=("x", "y", "yaw"), *, seed=3, coupled=True):
    """Six coupled springs under a slewing arm; slides and the vertical hinge stand off the origin, either way round."""
    data = grounded(3, seed, coupled=coupled) | {"placement": list(placement)}
    rng = np.random.default_rng(seed)
    if coupled:
        matrix = np.array(data["stiffness_matrix"]["matrix"])
        data["damping_matrix"]["matrix"] = (5e-3 * matrix).tolist()
    ground = data["bodies"][:6]
    order = rng.permutation(3)
    for k, body in enumerate(ground):
        joint = body["joint"]
        if k < 3:
            joint["axis"] = (rng.choice([-1.0, 1.0]) * np.eye(3)[order[k]]).tolist()
        if k < 4:
            body["position"] = rng.uniform(-0.4, 0.4, 3).tolist()
        if k == 3:
            joint["axis"] = (rng.choice([-1.0, 1.0]) * TURNED[2]).tolist()
            body["rotation"] = TURNED.tolist()
        if k == 4:
            body["rotation"] = TURNED.T.tolist()
    return data


def path(way=WAY, base=BASE, times=TIMES):
    return {"times": times, "points": base + way}


@pytest.mark.long
@pytest.mark.parametrize(("seed", "gravity"), [(3, False), (4, True), (5, True)])
def test_a_base_that_turns_against_driven_joints(seed, gravity):
    data = tracks(seed=seed)
    options = {"posture": ARM, "base": BASE, "duration": 0.7, "rate": 50.0, "gravity": gravity, **GAINS}
    made = scenario(
        tree_from_dict(data), base_path=path(), integrator="dop853", substeps=40, offset=(0.0,) * 3, **options
    )
    ours = run(made)

    def drive(t):
        return BASE + np.array([np.interp(t, TIMES, column) for column in WAY.T])

    q, v, torque = driven_run(
        data, made.q_design, drive, target=made.target, kp=3e4, kv=1e4, period=0.02, steps=35, gravity=gravity
    )
    assert np.abs(ours.base - [drive(t) for t in ours.time]).max() < 1e-14
    # The machine is shaken by it, and turned against its anchor.
    assert np.abs(ours.deflection[:, 3]).max() > 1e-3
    np.testing.assert_allclose(ours.q, q, atol=1e-9)
    np.testing.assert_allclose(ours.v, v, atol=1e-8 * np.abs(v).max())
    np.testing.assert_allclose(ours.torque, torque, atol=1e-7 * np.abs(torque).max())
    # q and base are what the plant takes.
    plant = build_plant(tree_from_dict(data))
    for k in (0, 9, 21, 35):
        point = plant.end_point(ours.q[k], ours.base[k], plant.parameter_values).full().ravel()
        np.testing.assert_allclose(point, ours.end_point[k], atol=1e-12)


@pytest.mark.parametrize("integrator", ["rk4", "gauss"])
def test_other_integrators_agree(integrator):
    tree = tree_from_dict(tracks(coupled=False))
    options = {"posture": ARM, "base": BASE, "duration": 0.4, "base_path": path(), **GAINS}
    exact = run(scenario(tree, integrator="dop853", **options))
    # Fourth and sixth order in steps of a third of the fastest mode's radian and less.
    other = run(scenario(tree, integrator=integrator, substeps=16 if integrator == "rk4" else None, **options))
    np.testing.assert_allclose(other.q, exact.q, atol=1e-6)
    assert np.abs(exact.v).max() > 0.1


@pytest.mark.long("names0")
@pytest.mark.parametrize("names", [("x", "yaw"), ("yaw", "y"), ("yaw",)])
def test_a_placement_that_names_less(names):
    """Driving what is named is driving all three with the others held, and they count from 0."""
    columns = [("x", "y", "yaw").index(name) for name in names]
    held = np.isin(np.arange(3), columns)
    for turning in (False, True):
        way = WAY * held * ([1, 1, 1] if turning else [1, 1, 0])
        options = {"posture": ARM, "duration": 0.5, "gravity": True, **GAINS}
        whole = run(scenario(tree_from_dict(tracks()), base=BASE * held, base_path=path(way, BASE * held), **options))
        less = run(
            scenario(
                tree_from_dict(tracks(names)), base=BASE[columns],
                base_path={"times": TIMES, "points": (BASE + way)[:, columns]}, **options,
            )
        )  # fmt: skip
        assert turning or len(names) == 1 or np.abs(whole.deflection).max() > 1e-3
        for name in ("q", "v", "end_point", "deflection", "energy"):
            a, b = getattr(whole, name), getattr(less, name)
            assert np.abs(a - b).max() <= 1e-10 * max(1.0, np.abs(a).max()), name


def test_turning_everything_turns_the_run():
    """The same way seen from inertial axes that are turned: the same motion against the anchor."""
    tree, (c, s) = tree_from_dict(tracks()), (np.cos(1.1), np.sin(1.1))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    options, aside = {"posture": ARM, "duration": 0.5, **GAINS}, BASE + np.array([0.0, 0.0, 1.1])
    here = run(scenario(tree, base=BASE, base_path=path(), **options))
    there = run(scenario(tree, base=aside, base_path=path(WAY @ turn.T, aside), **options))
    np.testing.assert_allclose(there.q, here.q, atol=1e-10)
    np.testing.assert_allclose(there.torque, here.torque, atol=1e-10 * np.abs(here.torque).max())


def test_a_run_settles_after_the_turn():
    """What is left once the base stands is the run's own oscillation, in the anchor's axes."""
    tree = tree_from_dict(tracks())
    way = {"times": (0.0, 0.5), "points": [BASE, BASE + np.array([0.0, 0.0, 0.6])]}
    settled = run(scenario(tree, posture=ARM, base=BASE, base_path=way, duration=4.0, offset=(0.0,) * 3, **GAINS))
    assert settled.verdict == "converges"
    assert np.abs(settled.deflection[-1]).max() < 1e-3
    assert settled.end_error < 1e-2
    assert settled.residual_oscillation.max() < 1e-3 * settled.energy.max()


def refused(tree, **options) -> str:
    with pytest.raises(InputError) as caught:
        flexopt.simulate(tree, posture=ARM, duration=0.1, **options)
    return str(caught.value)


def test_a_rigid_yaw_is_not_turned():
    data = tracks(coupled=False)
    fixed = data["bodies"].pop(3)
    data["bodies"][3] |= {"parent": "ground2", "position": fixed["position"]}
    tree = tree_from_dict(data)
    message = refused(tree, base=BASE, base_path=path())
    assert "base_path: needs a base that gives in yaw; a rigid one would jerk the machine along" in message
    # Without the turn the same machine goes its way.
    run(scenario(tree, posture=ARM, base=BASE, base_path=path(WAY * [1, 1, 0]), duration=0.05, **GAINS))
    for body in data["bodies"][:3]:
        body["joint"] |= {"kind": "slide", "axis": [0.0, 0.0, 1.0]} if abs(body["joint"]["axis"][1]) == 1 else {}
    data["bodies"] = [body for body in data["bodies"] if body["name"] != "ground1"]
    data["bodies"][next(i for i, b in enumerate(data["bodies"]) if b["parent"] == "ground1")]["parent"] = "ground0"
    assert "gives in" in refused(tree_from_dict(data), base=BASE, base_path=path())


def test_a_rotor_on_the_springs_is_not_turned():
    data = tracks(coupled=False)
    data["bodies"][0]["joint"]["armature"] = 10.0
    message = refused(tree_from_dict(data), base=BASE, base_path=path())
    assert "base_path.points: cannot turn a base whose joints g0 have an armature" in message


@pytest.mark.long
def test_a_planned_way_that_turns_is_simulated():
    """What `plan_base` gives is what `simulate` takes: the end-point stays near its path while the base turns."""
    machine = flexopt.load("truck-crane")
    bounds = {"x": (-4.0, 3.0), "y": (-4.0, 4.0), "yaw": (-1.5, 1.5)}
    plan = flexopt.plan_base(
        machine, [[5.0, -2.0, 2.0], [5.0, 2.0, 2.0]], duration=6.0, weights=[1.0] * 6, objective="V",
        base_range=bounds, starts=1, workers=1,
    )  # fmt: skip
    assert np.ptp(plan.base[:, 2]) > 0.1
    made = scenario(
        machine, posture=plan.posture[0], base=plan.base[0], base_path=plan.base_path, target_path=plan.target_path,
        duration=8.0, offset=(0.0,) * 4, kp=1e5, kv=5e4, nullspace_damping=5e3,
    )  # fmt: skip
    driven = run(made)
    np.testing.assert_allclose(driven.base[-1], plan.base[-1], atol=1e-12)
    held = run(
        scenario(
            machine, posture=plan.posture[0], base=plan.base[0], target_path=plan.target_path, duration=8.0,
            offset=(0.0,) * 4, kp=1e5, kv=5e4, nullspace_damping=5e3,
        )
    )  # fmt: skip
    # Joints of a base that is driven hardly differ from the planned ones at the end; those of one that stands do.
    away = [np.abs(one.q[-1, -4:] - plan.posture[-1]).max() for one in (driven, held)]
    # An arm held straight is slow to follow at these gains; it ends up on the path all the same.
    assert np.linalg.norm(driven.error, axis=1).max() < 0.6
    assert away[0] < 0.5 * away[1]
