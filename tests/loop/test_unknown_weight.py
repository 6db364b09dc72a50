"""A weight that the controller does not know: where feedback holds the machine, and what the loop does there.

Ensembles of the nonlinear loop judge: they find their own state of rest, from one sample of the controller that runs.
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from scipy.optimize import root

import flexopt
from flexopt.foundation.arrays import Vector
from flexopt.loop.evaluation import settings_at
from flexopt.loop.loop_motions import NOWHERE_HELD
from flexopt.loop.many import decays
from flexopt.loop.outcome import LoopPoint
from flexopt.loop.settings import LoopSettings, loop_settings
from flexopt.loop.uncertain import UncertainLoop
from flexopt.loop.uncertainty_box import UncertaintyBox
from flexopt.model import AnyMachine
from flexopt.model.loop import Loop
from flexopt.model.uncertainty import Uncertainty
from flexopt.plant import build_plant
from tests.oracles.lagrange import lagrange
from tests.study.machines import three_links

EXCAVATOR = flexopt.load("excavator")
POSTURE = (0.6, -1.6)
EXCAVATOR_END = flexopt.evaluate(EXCAVATOR, POSTURE, gravity=True).end_point
TORQUE: dict[str, Any] = {"drive": "torque", "kp": 1e5, "kv": 1e4, "rate": 200.0}
SERVED: dict[str, Any] = {
    "drive": "velocity",
    "servo_gain": 2e5,
    "kp": 1.0,
    "kv": 0.0,
    "rate": 200.0,
    "dead_time": 0.013,
}
LOOPS: dict[str, tuple[dict[str, Any], str]] = {
    "inverse": (TORQUE, "inverse"),
    "transpose": (TORQUE, "transpose"),
    "damped": (TORQUE, "damped:0.3"),
    "integral, filter, dead time": (
        TORQUE | {"feedback": "pid", "ki": 2e4, "dead_time": 0.013, "filter_hz": 20.0}, "inverse",
    ),
    "servos that lag": (TORQUE | {"bandwidth_hz": [8.0, 9.0]}, "inverse"),
    "velocity": (SERVED, "inverse"),
    "velocity, integral": (SERVED | {"feedback": "pid", "ki": 0.2}, "inverse"),
}  # fmt: skip
# What varies, and by which factors: weights, where they hang, and springs, by which the sag is another.
VARIED = {"stick.mass": (0.5, 1.0, 1.5), "boom.com": (0.8, 1.2), "base.stiffness.rotation": (0.5, 2.0)}


def settings_of(machine: AnyMachine, posture: tuple[float, ...], loop: dict[str, Any], control: str) -> LoopSettings:
    base = np.zeros(len(machine.base_coordinates))
    return settings_at(machine, np.array(posture), base, control, flexopt.Loop(**loop), gravity=True, call="test")[0]


def numbers(machine: AnyMachine, name: str, values: Vector) -> Vector:
    """Parameters (n_par, N) with one of them varied."""
    found = np.repeat(np.array([[each.value] for each in machine.parameters]), len(values), axis=1)
    found[[each.name for each in machine.parameters].index(name)] = values
    return found


def at(machine: AnyMachine, posture: tuple[float, ...], count: int) -> dict[str, Vector]:
    base = np.zeros((len(machine.base_coordinates), count))
    return {"base": base, "posture": np.repeat(np.array(posture)[:, None], count, axis=1)}


@pytest.mark.long(
    "velocity, integral-stick.mass",
    "damped-stick.mass",
    "integral, filter, dead time-stick.mass",
    "transpose-stick.mass",
    "servos that lag-stick.mass",
)
@pytest.mark.parametrize("varied", VARIED)
@pytest.mark.parametrize("name", LOOPS)
def test_decays_are_those_of_runs_that_find_their_own_rest(name: str, varied: str) -> None:
    loop, control = LOOPS[name]
    own = next(each.value for each in EXCAVATOR.parameters if each.name == varied)
    values = own * np.array(VARIED[varied])
    runs = flexopt.simulate_ensemble(
        EXCAVATOR, POSTURE, loop=loop, control=control, gravity=True, duration=0.1, vary={varied: values.tolist()}
    )
    given = {"p": numbers(EXCAVATOR, varied, values)} | at(EXCAVATOR, POSTURE, len(values))
    settings = settings_of(EXCAVATOR, POSTURE, loop, control)
    found = decays(EXCAVATOR, settings, given, gravity=True, own_model=True).decay
    np.testing.assert_allclose(found, -runs.linear_growth_rate, rtol=1e-8)
    # One at a time, too, and where the end-point then is: short of its target where no integral takes it there.
    target = settings.outcome(EXCAVATOR, np.zeros(1), np.array(POSTURE), gravity=True)
    plant = target.motions.plant
    for k, p in enumerate(given["p"].T):
        point = settings.outcome(EXCAVATOR, np.zeros(1), np.array(POSTURE), gravity=True, parameters=p, own_model=True)
        assert point.rate().value == pytest.approx(found[k], rel=1e-9)
        ends = (plant.end_point(each.configuration, [0.0], each.numbers["p"]) for each in (point, target))
        short = np.abs(np.subtract(*(end.full().ravel() for end in ends)))
        assert short.max() < 1e-9 if "integral" in name or values[k] == own else short.min() > 1e-6


def test_with_its_own_numbers_it_is_the_loop_that_knows_them():
    for loop, control in LOOPS.values():
        settings = settings_of(EXCAVATOR, POSTURE, loop, control)
        one, other = (
            settings.outcome(EXCAVATOR, np.zeros(1), np.array(POSTURE), gravity=True, own_model=own)
            for own in (True, False)
        )
        assert one.rate().value == pytest.approx(other.rate().value, rel=1e-9)
        np.testing.assert_allclose(one.configuration, other.configuration, atol=1e-12)


REDUNDANT: dict[str, tuple[tuple[float, ...], dict[str, Any], str, float]] = {
    "excavator": (POSTURE, LOOPS["integral, filter, dead time"][0], "stick.mass", 1.4),
    "boom-stick-bucket": (
        (-1.2, -1.6, -0.5),
        {"drive": "torque", "kp": 5e5, "kv": 5e5, "rate": 200.0, "nullspace_damping": 1e5}, "bucket.mass", 1.4,
    ),
    "truck-crane": (
        (0.3, 0.6, -0.8, 1.0), {"drive": "velocity", "servo_gain": 3e6, "kp": 1.0, "kv": 0.0, "rate": 100.0},
        "payload.mass", 1.4,
    ),
}  # fmt: skip


@pytest.mark.long("truck-crane")
@pytest.mark.parametrize("name", REDUNDANT)
def test_slopes_of_the_decay(name: str) -> None:
    """By central differences, of everything that it depends on, where none is 0."""
    posture, loop, varied, factor = REDUNDANT[name]
    machine = flexopt.load(name)
    settings = settings_of(machine, posture, loop, "inverse")
    own = next(each.value for each in machine.parameters if each.name == varied)
    p = numbers(machine, varied, np.array([factor * own]))[:, 0]
    base = np.zeros(len(machine.base_coordinates))
    point = settings.outcome(machine, base, np.array(posture), gravity=True, parameters=p, own_model=True)
    slopes = point.gradient(point.rate())
    known = settings.outcome(machine, base, np.array(posture), gravity=True, parameters=p)
    assert abs(point.rate().value / known.rate().value - 1) > 1e-4
    given = {key: np.array(value) for key, value in point.numbers.items() if key != "held"}

    def decay(key: str, k: int, step: float) -> float:
        there = given | {key: given[key] + step * np.eye(len(given[key]))[k]}
        return LoopPoint(point.motions, point.motions.numbers(there), point.dead_time).rate().value

    names = [each.name for each in machine.parameters]
    asked = [("posture", k) for k in range(len(posture))] + [("kp", 0), ("kv", 0)]
    asked += [("p", names.index(varied)), ("p", names.index("gravity"))]
    asked += [("ki", 0)] * ("ki" in loop) + [("servo_gain", 0)] * ("servo_gain" in loop)
    for key, k in asked:
        step = 1e-4 * max(abs(float(given[key][k])), 0.1)
        difference = (decay(key, k, step) - decay(key, k, -step)) / (2 * step)
        # Differences are off by step² and by rounding over the step.
        assert slopes[key][k] == pytest.approx(difference, rel=1e-4, abs=1e-9 / step), key
        assert slopes[key][k] != 0


def test_weak_feedback_is_followed_to_where_the_arm_hangs():
    """By most of a metre with another load; what feedback holds nowhere has no rate: it falls."""
    loop = SERVED | {"servo_gain": 2e4, "kp": 0.3}
    settings = settings_of(EXCAVATOR, POSTURE, loop, "inverse")
    values = np.array([0.2, 0.6, 1.0, 30.0]) * 458.2
    runs = flexopt.simulate_ensemble(
        EXCAVATOR, POSTURE, loop=loop, gravity=True, duration=0.1, vary={"stick.mass": values.tolist()}
    )
    given = {"p": numbers(EXCAVATOR, "stick.mass", values)} | at(EXCAVATOR, POSTURE, len(values))
    found = decays(EXCAVATOR, settings, given, gravity=True, own_model=True).decay
    np.testing.assert_allclose(found[:3], -runs.linear_growth_rate[:3], rtol=1e-8)
    assert found[3] == pytest.approx(-np.log(np.finfo(float).max) * 200.0)
    assert np.isnan(runs.linear_growth_rate[3])
    falling, hanging = (
        settings.outcome(EXCAVATOR, np.zeros(1), np.array(POSTURE), gravity=True, parameters=p, own_model=True)
        for p in given["p"].T[[3, 0]]
    )
    assert not falling.rests
    assert (falling.rate().value, falling.allowed_gain().value) == (found[3], 0.0)
    assert np.isnan(falling.delay_margin().value)
    end = hanging.motions.plant.end_point(hanging.configuration, [0.0], hanging.numbers["p"]).full().ravel()
    assert np.hypot(*(end - EXCAVATOR_END)) > 0.3


@pytest.mark.parametrize("feedback", ["pd", "pid", "integral"])
def test_a_redundant_arm_that_hangs_far_off_rests_where_its_runs_are_judged(feedback: str):
    """Of soft gains, also of a PID law whose integral has no gain: it carries no load. Each rest is one of the run's loop."""
    rng, low, high = np.random.default_rng(7), *np.nan_to_num(np.array(BUCKET.limits).T, posinf=1.5, neginf=-1.5)
    far = 0
    for _ in range(6):
        posture, kp = rng.uniform(low + 0.1 * (high - low), high - 0.1 * (high - low)), 10 ** rng.uniform(3.6, 4.8)
        load = float(rng.uniform(0.0, 3000.0))
        loop = {"kp": kp, "kv": 0.3 * kp, "rate": 100.0, "drive": "torque", "nullspace_damping": 1e4}
        loop |= {} if feedback == "pd" else {"feedback": "pid", "ki": 0.2 * kp * (feedback == "integral")}
        (linear,) = flexopt.simulate_ensemble(
            BUCKET, posture, loop=loop, gravity=True, duration=0.05, vary={"payload.mass": [load]}
        ).linear_loops
        point = settings_of(BUCKET, tuple(posture.tolist()), loop, "inverse").outcome(
            BUCKET, np.zeros(1), posture, gravity=True, own_model=True,
            parameters=numbers(BUCKET, "payload.mass", np.array([load]))[:, 0],
        )  # fmt: skip
        if not point.rests:
            assert linear == NOWHERE_HELD
            continue
        # A run's loop counts as at rest where it moves by 1e-9 in a sample, of which soft gains make more: with another
        # BLAS kernel that left 1.6e-9/s. Another rest is off by percents.
        assert linear.growth_rate == pytest.approx(point.loop.growth_rate, rel=1e-7, abs=2e-8)
        off = point.end_point - flexopt.evaluate(BUCKET, posture, base=0.0, gravity=True).end_point
        far += bool(np.linalg.norm(off) > 0.3)
    assert far >= (0 if feedback == "integral" else 2)


def test_a_region_over_an_unknown_load_is_that_of_runs():
    """The slowest decay over the interval is that at one of its ends; a controller that knew the load would tell another."""
    low, high = 0.5 * 458.2, 1.5 * 458.2
    loop = SERVED | {"feedback": "pid", "ki": 0.2}
    runs = flexopt.simulate_ensemble(
        EXCAVATOR,
        POSTURE,
        loop=loop,
        gravity=True,
        duration=0.1,
        vary={"stick.mass": np.linspace(low, high, 9).tolist()},
    )
    region = flexopt.stable_region(
        EXCAVATOR, POSTURE, loop=loop, gravity=True, ranges={"stick.mass": (low, high)}, boxes=0
    )
    slowest = float(np.min(-runs.linear_growth_rate))
    assert region.decay == pytest.approx(slowest, rel=1e-6)
    assert region.critical["stick.mass"] == pytest.approx(low if slowest == -runs.linear_growth_rate[0] else high)


def test_a_region_tells_how_far_off_its_target_runs_end():
    """Of a controller that knows the file's weight alone, at the end of the interval where they end farthest."""
    loads = [0.0, 60.0, 120.0]
    loop = SERVED
    runs = flexopt.simulate_ensemble(
        EXCAVATOR, POSTURE, loop=loop, gravity=True, duration=60.0, vary={"payload.mass": loads}
    )
    asked = {"loop": loop, "ranges": {"payload.mass": (loads[0], loads[-1])}, "points": 8, "boxes": 0}
    region = flexopt.stable_region(EXCAVATOR, POSTURE, gravity=True, **asked)
    off = runs.dataset["end_error"].to_numpy()
    assert region.rests_off == pytest.approx(off.max(), rel=1e-3)
    assert region.rests_off_at["payload.mass"] == loads[int(off.argmax())]
    assert f"holds the end-point {region.rests_off:.3g} m off its target at rest, at payload.mass 120" in repr(region)
    assert region.rests_beyond == {}
    weightless = flexopt.stable_region(EXCAVATOR, POSTURE, **asked)
    assert weightless.rests_off == 0.0
    assert "at rest" not in repr(weightless)


def test_a_region_tells_which_joints_rest_beyond_their_limits():
    """By SciPy, which solves for where springs and feedback hold the load."""
    loads = (0.0, 120.0)
    plant = (
        settings_of(EXCAVATOR, POSTURE, SERVED, "inverse")
        .outcome(EXCAVATOR, [0.0], POSTURE, gravity=True)
        .motions.plant
    )
    own, heavy = numbers(EXCAVATOR, "payload.mass", np.array(loads)).T
    sag = plant.deflected([0.0], POSTURE, own).full().ravel()
    held = np.append(sag, POSTURE)
    m = len(sag)
    target = plant.end_point(held, [0.0], own).full().ravel()

    def unbalanced(q: Vector) -> Vector:
        """Springs against weight; Kp times the error against the rates that the servos need to carry what is unknown."""
        taken = np.append(sag, q[m:])
        pulls = plant.stiffness(heavy).full()[:m, :m] @ (q - plant.rest([0.0], q[m:], heavy).full().ravel())[:m]
        weight = plant.gravity(q, [0.0], heavy).full().ravel()
        carried = (weight - plant.gravity(taken, [0.0], own).full().ravel())[m:]
        error = target - plant.end_point(q, [0.0], heavy).full().ravel()
        rates = np.linalg.solve(plant.rigid_jacobian(taken, [0.0], own).full(), SERVED["kp"] * error)
        return np.append(pulls + weight[:m], SERVED["servo_gain"] * rates - carried)

    moved = root(unbalanced, held, tol=1e-12).x[m:] - POSTURE
    assert np.abs(moved).min() > 1e-3
    # A limit of each joint on the side that it rests on, at half the way.
    told = EXCAVATOR.model_dump(by_alias=True)
    for link, q, by in zip(told["links"], POSTURE, moved, strict=True):
        link["limits"] = tuple(np.sort([q + by / 2, q - np.sign(by)]))
    machine = type(EXCAVATOR)(**told)
    asked = {"loop": SERVED, "gravity": True, "ranges": {"payload.mass": loads}, "points": 8, "boxes": 0}
    region = flexopt.stable_region(machine, POSTURE, **asked)
    assert [*region.rests_beyond.values()] == pytest.approx(np.abs(moved) / 2, rel=1e-6)
    assert region.rests_beyond_at == {"payload.mass": loads[1]}
    boom, stick = region.rests_beyond.values()
    assert (
        f"beyond its limits at rest: boom by {boom:.3g} rad and stick by {stick:.3g} rad, at payload.mass 120"
        in repr(region)
    )
    # Of one that rests within, nothing; of the other, 0.
    told["links"][0]["limits"] = None
    one = flexopt.stable_region(type(EXCAVATOR)(**told), POSTURE, **asked)
    assert one.rests_beyond == {"boom": 0.0, "stick": pytest.approx(stick)}


BUCKET = flexopt.load("boom-stick-bucket")
HELD_OUT = (-1.0222685173091457, -1.20691908739466, -2.196673998356711)


def test_a_self_motion_that_swings_on_soft_springs_is_no_part_of_the_decay():
    """On stiff springs the arm creeps away along it, on soft ones it swings; eigenvectors tell which moves the end-point."""
    factors, springs = (1.2, 0.9, 0.8, 0.5), np.array(["stiffness" in each.name for each in BUCKET.parameters])
    own = np.array([each.value for each in BUCKET.parameters])
    settings, swinging = settings_of(BUCKET, HELD_OUT, {"drive": "torque"}, "inverse"), 0
    for factor in factors:
        p = np.where(springs, factor * own, own)
        point = settings.outcome(BUCKET, np.zeros(1), np.array(HELD_OUT), gravity=True, parameters=p, own_model=True)
        values, vectors = np.linalg.eig(point.sample.matrix)
        rates = np.log(np.abs(values) + (values == 0) * 1e-300) * settings.rate
        n = len(point.parts.flow)
        moved = np.linalg.norm(point.parts.measured[:2] @ vectors[:n], axis=0) / np.linalg.norm(vectors[:n], axis=0)
        order = np.argsort(-rates)
        # Two motions of which the end-point shows little, what springs give under them, and what is slowest besides.
        assert np.all(moved[order[:2]] < 0.1 * moved[order[2]])
        assert point.rate().value == pytest.approx(-rates[order[2]], rel=1e-6)
        assert len(point.loop.drift) == 2
        swinging += bool(np.abs(np.angle(values[order[0]])) > 1e-6)
    assert 0 < swinging < len(factors)


@pytest.mark.parametrize("posture", [(-0.51, -0.866, -0.634), (-0.666, -0.629, -0.809)])
def test_what_creeps_is_the_self_motion_whatever_the_load(posture: tuple[float, ...]) -> None:
    """Slowly the base and the end-point go with it to where they then rest: by a tenth of its energy and more."""
    loop = {"drive": "velocity", "kp": 1.0, "kv": 0.1, "servo_gain": 2.5e5, "nullspace_damping": 5e3, "rate": 100.0}
    settings = settings_of(BUCKET, posture, loop | {"dead_time": 0.03}, "inverse")
    for p in numbers(BUCKET, "payload.mass", np.linspace(0.0, 3000.0, 7)).T:
        point = settings.outcome(BUCKET, np.zeros(1), np.array(posture), gravity=True, parameters=p, own_model=True)
        rates = np.sort(-np.log(np.abs(np.linalg.eigvals(point.sample.matrix)) + 1e-300) * settings.rate)
        # One that takes minutes, and apart from it what takes seconds.
        assert abs(rates[0]) < 0.01 < 0.1 < rates[1]
        assert point.loop.drift == pytest.approx([-rates[0]], rel=1e-6, abs=point.loop.rounding)
        assert point.rate().value == pytest.approx(rates[1], rel=1e-6)


@pytest.mark.parametrize("loop", [{"drive": "torque", "kp": 2e5, "kv": 3e4}, {"drive": "velocity", "kp": 1.0}])
def test_along_what_a_loop_rests_is_a_kernel_of_what_is_zero_there(loop: dict[str, Any]) -> None:
    """By central differences of the equations, written out by themselves."""
    settings = settings_of(BUCKET, HELD_OUT, loop, "inverse")
    own = np.array([each.value for each in BUCKET.parameters])
    p = numbers(BUCKET, "payload.mass", np.array([1500.0]))[:, 0]
    point = settings.outcome(BUCKET, np.zeros(1), np.array(HELD_OUT), gravity=True, parameters=p, own_model=True)
    plant, m = point.motions.plant, 3
    kp = settings.kp * (settings.servo_gain if loop["drive"] == "velocity" else 1.0)
    sag = plant.deflected([0.0], HELD_OUT, own).full().ravel()
    target = plant.end_point(np.append(sag, HELD_OUT), [0.0], own).full().ravel()

    def off(q: Vector) -> Vector:
        taken = np.append(sag, q[m:])
        into = np.linalg.pinv(plant.rigid_jacobian(taken, [0.0], own).full())
        weight = plant.gravity(q, [0.0], p).full().ravel()
        more = weight[m:] - plant.gravity(taken, [0.0], own).full().ravel()[m:]
        pulls = plant.stiffness(p).full()[:m, :m] @ (q - plant.rest([0.0], q[m:], p).full().ravel())[:m]
        error = np.linalg.lstsq(into, more)[0] / kp
        return np.append(pulls + weight[:m], plant.end_point(q, [0.0], p).full().ravel() + error - target)

    rows, q = point._own.creeping, point.configuration
    assert np.abs(off(q)[m:]).max() < 1e-9
    step = 1e-5 * rows[:, 0]
    scale = np.array([np.abs(off(q + 1e-5 * e) - off(q - 1e-5 * e)) for e in np.eye(len(q))]).max(axis=0)
    # Differences are off by the square of the step.
    assert np.all(np.abs(off(q + step) - off(q - step)) < 1e-7 * scale)


@pytest.mark.parametrize("loop", [{"drive": "torque"}, {"drive": "velocity", "kp": 1.0}], ids=["torque", "velocity"])
def test_an_integral_without_gain_is_none(loop: dict[str, Any]) -> None:
    """Of an arm that drifts, too: what its integral keeps is not taken for the self-motion."""
    asked = {"base": 0.0, "gravity": True}
    with_none, without = (
        flexopt.evaluate(BUCKET, HELD_OUT, **asked, loop=loop | {"feedback": law}).outcome for law in ("pid", "pd")
    )
    assert with_none.decay == pytest.approx(without.decay, rel=1e-8)
    assert with_none.drift == pytest.approx(without.drift, rel=1e-6)
    assert with_none.allowed_gain == pytest.approx(without.allowed_gain, rel=1e-6)
    # In stacks, too.
    settings = settings_of(BUCKET, HELD_OUT, loop | {"feedback": "pid"}, "inverse")
    assert decays(BUCKET, settings, at(BUCKET, HELD_OUT, 3), gravity=True).decay == pytest.approx(
        without.decay, rel=1e-8
    )


def test_what_drives_a_self_motion_under_an_unknown_weight() -> None:
    """Of equations of motion written out by themselves: what is left of the unknown weight in the null space of J."""
    posture, factor, loop = np.array([-1.072, -1.225, -0.748]), 1.4, {"drive": "torque", "kp": 5e5, "kv": 5e5}
    data: dict[str, Any] = BUCKET.model_dump(exclude_none=True)
    own = data["links"][2]["mass"]
    weight = lagrange(data).dynamics
    heavier = lagrange(data | {"links": [*data["links"][:2], data["links"][2] | {"mass": factor * own}]}).dynamics
    p = np.array([each.value * (factor if each.name == "bucket.mass" else 1.0) for each in BUCKET.parameters])
    settings = settings_of(BUCKET, tuple(posture), loop, "inverse")
    point = settings.outcome(BUCKET, np.zeros(1), posture, gravity=True, parameters=p, own_model=True)
    q, m = point.configuration, 3
    sag = point.motions.plant.deflected([0.0], posture, [each.value for each in BUCKET.parameters]).full().ravel()
    taken, still = np.concatenate([sag, q[m:]]), np.zeros(len(q))
    heavy, file = (
        of.call([*where])[2].full().ravel()[m:]
        for of, where in ((heavier, (q, still, 0.0)), (weight, (taken, still, 0.0)))
    )
    more, jacobian = heavy - file, weight(taken, still, 0.0)[4].full()[:, m:]
    driven = more - np.linalg.pinv(jacobian) @ jacobian @ more
    np.testing.assert_allclose(point.unheld, driven, rtol=1e-6)
    # Less than a hundredth of what a joint carries is left out.
    np.testing.assert_allclose(point.carried, np.abs(heavy), rtol=1e-6)
    driven = np.where(np.abs(driven) > 0.01 * np.abs(heavy), driven, 0.0)
    assert np.flatnonzero(driven).tolist() == [2]
    # A region tells the end of the interval where that is, and nothing of a load at the teeth, which moves them alone.
    asked: dict[str, Any] = {"gravity": True, "loop": loop, "points": 4, "boxes": 0}
    region = flexopt.stable_region(BUCKET, posture, ranges={"bucket.mass": (own, factor * own)}, **asked)
    assert region.unheld == pytest.approx(dict(zip(BUCKET.joints, driven.tolist(), strict=True)), rel=1e-6)
    assert region.unheld_at == pytest.approx({"bucket.mass": factor * own})
    assert "drives the arm's self-motion, by up to 370 N m of bucket, at bucket.mass 1260" in repr(region)
    loaded = flexopt.stable_region(BUCKET, posture, ranges={"payload.mass": (1000.0, 2000.0)}, **asked)
    assert loaded.unheld == {}


@pytest.mark.long("truck-crane")
@pytest.mark.parametrize("name", ["slewing-excavator", "truck-crane"])
def test_no_weight_turns_a_slew_along_the_machine_whatever_its_heading(name: str) -> None:
    """By mirror symmetry: a machine whose arm lies in its plane sags in it, so that its slew carries nothing at all."""
    machine, rng = flexopt.load(name), np.random.default_rng(7)
    own, told = np.array([each.value for each in machine.parameters]), list[float]()
    springs = np.array(["stiffness" in each.name for each in machine.parameters])
    for _ in range(6):
        low, high = np.clip(np.array(machine.limits), -1.5, 1.5).T
        posture = np.append(0.0, rng.uniform(low, high)[1:])
        base = rng.uniform(-3.0, 3.0, len(machine.base_coordinates))
        settings = settings_at(machine, posture, base, None, None, gravity=True, call="test")[0]
        for factor in (0.5, 1.6):
            p = np.where(springs, factor * own, own)
            point = settings.outcome(machine, base, posture, gravity=True, parameters=p, own_model=True)
            told.append(float(point.unheld[0]))
    assert told == [0.0] * 12


@pytest.mark.parametrize("name", ["excavator", "boom-stick-bucket", "slewing-excavator", "mobile-manipulator"])
def test_no_joint_carries_more_than_the_bound_by_the_machines_mass(name: str) -> None:
    """Of a potential differentiated numerically: m g times the height of the centre of mass."""
    plant, rng = build_plant(flexopt.load(name)), np.random.default_rng(8)
    own = plant.parameter_values.full().ravel()
    value = dict(zip(plant.parameter_names, own.tolist(), strict=True))
    entries = plant.machine.kinematic_tree.entries
    masses = {named for entry, named in entries.items() if entry.startswith("mass")} | {entries["payload"]}
    weight = value[entries["gravity"]] * sum(value[name] for name in masses)
    base = np.zeros(plant.n_base)
    for _ in range(20):
        q, step = rng.uniform(-1.5, 1.5, plant.n_coordinates), 1e-6 * np.eye(plant.n_coordinates)
        high, low = (
            [float(plant.centre_of_mass(q + sign * each, base, own).full()[-1, 0]) for each in step] for sign in (1, -1)
        )
        carried = weight * (np.array(high) - low) / 2e-6
        most = plant.most_weight(q, base, own).full().ravel()
        # Of central differences some 1e-9 of weight times arm is rounding.
        assert np.all(np.abs(carried) <= most + 1e-8 * most.max())


@pytest.mark.parametrize("posture", [(1.9, -2.0), (-0.6, -1.0), (-1.5, -0.6)])
def test_a_base_that_sinks_by_metres_is_held_as_far_as_the_arm_reaches(posture: tuple[float, float]) -> None:
    """A soft spring below it gives way by weight through stiffness; where the arm then reaches its target it rests."""
    here = flexopt.evaluate(EXCAVATOR, posture, gravity=True)
    stiff = next(each.value for each in EXCAVATOR.parameters if each.name == "base.stiffness.y")
    weight, settings = -stiff * here.static_deflection[1], loop_settings(EXCAVATOR, Loop(**TORQUE), here, gravity=True)
    rested = 0
    # None is short of its reach by as little as the error that stands.
    for sunk in (0.1, 0.5, 1.0, 1.5, 2.0, 2.5, 3.1):
        box = UncertaintyBox(
            EXCAVATOR, (Uncertainty(of="base.stiffness.y", value=(weight / sunk, stiff)),), settings.dead_time
        )
        loop = UncertainLoop(settings, here.base, here.posture, True, box)
        point = loop.outcome(np.zeros(1))
        try:
            flexopt.inverse_kinematics(EXCAVATOR, here.end_point + np.array([0.0, sunk]), gravity=True)
        except flexopt.UnreachableTarget:
            assert not point.rests
            continue
        assert point.rests
        rested += 1
        assert point.configuration[1] == pytest.approx(-sunk, rel=1e-9)
    assert rested


@pytest.mark.parametrize(
    ("posture", "kp", "load"), [((0.6, -0.45), 13308.0, 1300.0), ((1.3348, 0.478), 13308.0, 1232.0)]
)
def test_a_heavy_load_on_soft_springs_leaves_the_arm_on_its_elbow(posture: Any, kp: float, load: float) -> None:
    """Where SciPy follows the rest to, the load put on in small steps and the springs softened in small ones."""
    plant = build_plant(EXCAVATOR)
    settings = settings_of(EXCAVATOR, posture, {"drive": "torque", "kp": kp, "kv": kp / 10, "rate": 200.0}, "inverse")
    own, base, m = plant.parameter_values.full().ravel(), np.zeros(1), plant.n_passive
    names = [each.name for each in EXCAVATOR.parameters]
    springs = np.array(["stiffness" in name for name in names])
    sag = plant.deflected.call([base, posture, own])[0].full().ravel()
    design = np.append(sag, posture)
    target = plant.end_point.call([design, base, own])[0].full().ravel()
    jacobian = plant.rigid_jacobian.call([design, base, own])[0].full()

    def q_at(v: Vector) -> Vector:
        return np.append(v[:m], posture + np.linalg.solve(jacobian, v[m:]))

    def off(v: Vector, p: Vector) -> Vector:
        q = q_at(v)
        taken = np.append(sag, q[m:])
        stiffness, rest = plant.stiffness.call([p])[0].full()[:m, :m], plant.rest.call([base, posture, p])[0].full()
        weight = plant.gravity.call([q, base, p])[0].full().ravel()
        more = weight[m:] - plant.gravity.call([taken, base, own])[0].full().ravel()[m:]
        force = plant.rigid_jacobian.call([taken, base, own])[0].full() @ more
        reached = plant.end_point.call([q, base, p])[0].full().ravel()
        pull = stiffness @ (v[:m] - rest.ravel()[:m]) + weight[:m]
        return np.append(pull / stiffness.diagonal(), reached + force / kp - target)

    assert np.abs(off(np.append(sag, [0.0, 0.0]), own)).max() < 1e-9
    v, loads = np.append(sag, [0.0, 0.0]), np.linspace(0.0, load, 120)
    ways = [(x, 1.0) for x in loads] + [(load, factor) for factor in np.geomspace(1.0, 0.15, 40)]
    for x, factor in ways:
        p = own.copy()
        p[names.index("payload.mass")] = x
        p[springs] *= factor
        found = root(off, v, args=(p,), tol=1e-12)
        # In steps so small that no other elbow is near.
        assert found.success
        assert np.abs(found.x - v).max() < 0.2
        v = found.x
        there = settings.outcome(EXCAVATOR, base, np.array(posture), gravity=True, parameters=p, own_model=True)
        np.testing.assert_allclose(there.configuration, q_at(v), atol=1e-8)


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_a_self_motion_that_is_driven_grows_as_its_drive_does_along_it(factor: float) -> None:
    """Heavily damped it drifts at −u/D, with u what drives it where the end-point is held, by SciPy: d/ds of that.

    What is left of masses is of the order of rate M/D.
    """
    machine = flexopt.machine_from_dict(three_links().to_dict() | {"gravity": 9.81})
    plant, damping, posture = build_plant(machine), 2e4, np.array([0.7, -1.4, 0.5])
    loop = {"drive": "torque", "feedback": "pid", "kp": 1e5, "kv": 2e4, "ki": 5e4, "rate": 1000.0}
    settings = settings_of(machine, tuple(posture), loop | {"nullspace_damping": damping}, "inverse")
    own, names, m = plant.parameter_values.full().ravel(), [each.name for each in machine.parameters], plant.n_passive
    p = own.copy()
    p[["stiffness" in name for name in names]] *= factor
    p[names.index("stick.mass")] *= 1.6
    base = np.zeros(1)
    point = settings.outcome(machine, base, posture, gravity=True, parameters=p, own_model=True)
    assert np.abs(point.unheld).max() > 50.0
    sag = plant.deflected.call([base, posture, own])[0].full().ravel()
    target, rests = point.end_point, point.configuration
    stiffness, rest = plant.stiffness.call([p])[0].full()[:m, :m], plant.rest.call([base, posture, p])[0].full().ravel()

    def along(q: Vector) -> Vector:
        jacobian = plant.rigid_jacobian.call([np.append(sag, q[m:]), base, own])[0].full()
        found = np.linalg.svd(jacobian)[2][-1]
        return found * np.sign(found[0])

    def drive(s: float) -> float:
        first = along(rests)

        def off(q: Vector) -> Vector:
            weight = plant.gravity.call([q, base, p])[0].full().ravel()[:m]
            away = plant.end_point.call([q, base, p])[0].full().ravel() - target
            return np.concatenate(
                [stiffness @ (q[:m] - rest[:m]) + weight, 1e4 * away, [1e4 * (first @ (q - rests)[m:] - s)]]
            )

        q = root(off, rests, tol=1e-13).x
        assert np.abs(off(q)).max() < 1e-6
        known = plant.gravity.call([np.append(sag, q[m:]), base, own])[0].full().ravel()[m:]
        return float(along(q) @ (plant.gravity.call([q, base, p])[0].full().ravel()[m:] - known))

    step = 1e-3
    expected = -(drive(step) - drive(-step)) / (2 * step) / damping
    (found,) = point.loop.drift
    assert abs(expected) > 1e-3
    assert found == pytest.approx(expected, rel=1e-3)


def test_a_rest_is_the_same_in_axes_that_are_turned_by_half_a_turn() -> None:
    """Of springs that are coupled: with the axes the couplings change their sign."""
    told = flexopt.load("truck-crane").to_dict() | {"gravity": 9.81, "capsules": [], "support": None, "visuals": []}
    stiff, away, turn = 2e7, 3.5, np.diag([-1.0, -1.0, 1.0, -1.0, -1.0, 1.0])
    told["stiffness_matrix"]["matrix"] = np.array(told["stiffness_matrix"]["matrix"])
    told["stiffness_matrix"]["matrix"][np.ix_([2, 4], [2, 4])] = [
        [stiff, stiff * away], [stiff * away, 2.5e7 + stiff * away**2],
    ]  # fmt: skip
    rests = list[Vector]()
    for way in (np.eye(6), turn):
        data = copy.deepcopy(told)
        for springs in ("stiffness_matrix", "damping_matrix"):
            data[springs]["matrix"] = (way @ np.array(data[springs]["matrix"]) @ way).tolist()
        bodies = {body["name"]: body for body in data["bodies"]}
        for body, field, entries in (
            ("truck", "com", (0, 1)),
            ("truck", "inertia", (4, 5)),
            ("column", "position", (0, 1)),
        ):
            numbers_of = np.array(bodies[body][field])
            numbers_of[[*entries]] *= way[0, 0]
            bodies[body][field] = numbers_of.tolist()
        bodies["column"]["joint"]["limits"] = [-6.0, 6.0]
        machine = flexopt.tree_from_dict(data)
        posture = (0.3 + np.pi * (way[0, 0] < 0), 0.6, -0.8, 1.0)
        loop = {"drive": "torque", "kp": 2e4, "kv": 2e4, "rate": 200.0}
        p = build_plant(machine).parameter_values.full().ravel()
        p[["stiffness" in each.name for each in machine.parameters]] *= 0.3
        base = np.zeros(len(machine.base_coordinates))
        there = settings_of(machine, posture, loop, "inverse").outcome(
            machine, base, np.array(posture), gravity=True, parameters=p, own_model=True
        )
        assert there.rests
        # Of x, y, z, yaw, pitch, roll.
        rests.append(way.diagonal()[[0, 1, 2, 5, 4, 3]] * there.configuration[:6])
    np.testing.assert_allclose(rests[1], rests[0], atol=1e-9)


@pytest.mark.parametrize("turned", [0.06, 0.08, 0.045])
@pytest.mark.parametrize("along", [1e-5, 1e-3, 1e3])
def test_a_spring_that_carries_nothing_changes_no_rest(turned: float, along: float) -> None:
    """Along a level ground no weight pulls: however that spring softens, others give way as without it."""
    names, base, posture = [each.name for each in EXCAVATOR.parameters], np.zeros(1), np.array([0.6, -1.6])
    own = np.array([each.value for each in EXCAVATOR.parameters])
    settings, rests = settings_of(EXCAVATOR, (0.6, -1.6), TORQUE, "inverse"), list[Vector]()
    for factor in (1.0, along):
        p = own.copy()
        p[[names.index("base.stiffness.x"), names.index("base.stiffness.rotation")]] *= factor, turned
        there = settings.outcome(EXCAVATOR, base, posture, gravity=True, parameters=p, own_model=True)
        assert there.rests
        rests.append(there.configuration)
    # Angles of about 1 rad, of two solves.
    np.testing.assert_allclose(rests[1], rests[0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("load", [500.0, 1000.0])
def test_stiffer_springs_carry_a_load_before_it_comes(load: float) -> None:
    """On its own springs the machine would fall over under it, as with half of both; by SciPy from the rest without it."""
    data = EXCAVATOR.to_dict()
    data["base"] |= {"mass": 150.0, "inertia": 30.0}
    data["base"]["stiffness"]["rotation"] = 5e3
    data["links"] = [link | {"mass": 0.2 * link["mass"], "inertia": 0.2 * link["inertia"]} for link in data["links"]]
    machine, posture = flexopt.machine_from_dict(data | {"payload": {"mass": 1.0}}), (0.6, -1.6)
    settings = settings_of(machine, posture, {"kp": 1e5, "kv": 1e4, "drive": "torque"}, "inverse")
    names, own = zip(*((each.name, each.value) for each in machine.parameters), strict=True)
    plant, base, m = build_plant(machine), np.zeros(1), 3
    sag = plant.deflected(base, posture, own).full().ravel()
    target = plant.end_point(np.append(sag, posture), base, own).full().ravel()

    def numbers_at(factor: float, mass: float) -> Vector:
        stiff = [value * (factor if "stiffness" in name else 1.0) for name, value in zip(names, own, strict=True)]
        return np.array([mass if name == "payload.mass" else value for name, value in zip(names, stiff, strict=True)])

    def left(q: Vector, p: Vector) -> Vector:
        taken = np.append(sag, q[m:])
        weight, known = plant.gravity(q, base, p).full().ravel(), plant.gravity(taken, base, own).full().ravel()
        into = np.linalg.pinv(plant.rigid_jacobian(taken, base, own).full())
        force = np.linalg.lstsq(into, weight[m:] - known[m:])[0]
        rest = plant.rest(base, q[m:], p).full().ravel()
        pulls = (plant.stiffness(p).full() @ (q - rest) + weight)[:m] / 1e4
        return np.append(pulls, plant.end_point(q, base, p).full().ravel() + force / settings.kp - target)

    q = np.append(sag, posture)
    steps = [numbers_at(factor, 1.0) for factor in np.geomspace(1.0, 10.0, 60)]
    for p in [*steps, *(numbers_at(10.0, mass) for mass in np.linspace(1.0, load, 120))]:
        found = root(left, q, args=(p,), tol=1e-12)
        assert np.abs(found.x - q).max() < 0.1
        q = found.x
    there = settings.outcome(machine, base, np.array(posture), gravity=True, parameters=p, own_model=True)
    assert there.rests
    np.testing.assert_allclose(there.configuration, q, atol=1e-6)


@pytest.mark.parametrize("factor", [2.5, 5.0, 20.0])
def test_where_a_rest_ends_none_is_found_beyond(factor: float) -> None:
    """Weak feedback under a stick of twice its weight: up to there slopes by its mass grow without bound."""
    loop = SERVED | {"servo_gain": 2e4, "kp": 0.3}
    settings = settings_of(EXCAVATOR, POSTURE, loop, "inverse")
    masses = np.linspace(1.0, 2.05, 211) * 458.2
    found = list[Vector]()
    for p in numbers(EXCAVATOR, "stick.mass", masses).T:
        there = settings.outcome(EXCAVATOR, np.zeros(1), np.array(POSTURE), gravity=True, parameters=p, own_model=True)
        if not there.rests:
            break
        found.append(there.configuration[3:])
    slopes = np.abs(np.diff(found, axis=0)).max(axis=1)
    # As of a root: without bound where it ends.
    assert 150 < len(found) < 211
    assert slopes[-1] > 3 * slopes[len(slopes) // 2]
    beyond = numbers(EXCAVATOR, "stick.mass", np.array([factor * 458.2]))[:, 0]
    assert not settings.outcome(
        EXCAVATOR, np.zeros(1), np.array(POSTURE), gravity=True, parameters=beyond, own_model=True
    ).rests


def test_what_the_rate_of_a_region_stands_for_where_the_arm_falls_is_told() -> None:
    soft = {"base.stiffness.y": (2e3, 3e3)}
    found = flexopt.stable_region(EXCAVATOR, POSTURE, gravity=True, loop=TORQUE, ranges=soft, points=2, boxes=0)
    assert found.stable is False
    assert "that rate stands for an arm that falls: there the feedback is not found to hold the weight" in repr(found)
    stands = flexopt.stable_region(EXCAVATOR, POSTURE, gravity=True, loop=TORQUE, points=2, boxes=0)
    assert "falls" not in repr(stands)


@pytest.mark.parametrize("control", ["inverse", "transpose"])
def test_a_base_that_cannot_turn_may_stand_at_another_angle_than_the_controller_takes_it_for(control: str) -> None:
    """The controller adds the angles of the joints that it measures to the one that its file has; so do the runs."""
    numbers_of = EXCAVATOR.to_dict()
    for table in ("stiffness", "damping"):
        del numbers_of["base"][table]["rotation"]
    numbers_of["base"]["damping"] = dict.fromkeys(numbers_of["base"]["damping"], 30000.0)
    machine = flexopt.machine_from_dict(numbers_of)
    angles = [machine.base.rest_angle + change for change in (-0.2, 0.0, 0.3)]
    runs = flexopt.simulate_ensemble(
        machine, POSTURE, loop=TORQUE, control=control, gravity=True, duration=10.0, keep="trajectories",
        vary={"base.rest_angle": angles},
    )  # fmt: skip
    settings = settings_of(machine, POSTURE, TORQUE, control)
    given = numbers(machine, "base.rest_angle", np.array(angles))
    for p, linear, q in zip(given.T, runs.linear_loops, runs.dataset["q"].to_numpy(), strict=True):
        point = settings.outcome(machine, np.zeros(1), np.array(POSTURE), gravity=True, parameters=p, own_model=True)
        assert not isinstance(linear, str)
        assert linear.growth_rate == pytest.approx(point.loop.growth_rate, rel=1e-8)
        # What the start is off by, 0.4 rad, decays by e^-15 at least.
        assert point.loop.growth_rate < -1.5
        np.testing.assert_allclose(q[-1], point.configuration, rtol=0, atol=1e-6)
