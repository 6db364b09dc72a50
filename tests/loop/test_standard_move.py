"""The standard move of the sampled loop, beside nonlinear runs of small moves, and sampled by SciPy; derivatives."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy.differentiate import derivative
from scipy.linalg import eig, expm

import flexopt
from flexopt.loop.outcome import LoopPoint
from flexopt.loop.settings import LoopSettings, loop_settings
from flexopt.loop.standard_move import SETTLED
from flexopt.model.loop import Loop
from flexopt.robustness import Evaluation

SMALL = 1e-4
CASES = {
    "plane": ("excavator", (0.992, -1.4056), {"kp": 1e4, "kv": 1e3}),
    "filtered": ("excavator", (0.992, -1.4056), {"kp": 1e4, "kv": 1e3, "filter_hz": 20.0}),
    "an integral, late": (
        "boom-stick-bucket",
        (-0.9, -1.4, -0.6),
        {"kp": 3e5, "kv": 2e5, "ki": 1e5, "feedback": "pid", "dead_time": 0.123, "nullspace_damping": 1e4},
    ),
    "late": (
        "slewing-excavator",
        (0.2, 0.5, -1.2, -0.5),
        {"kp": 3e6, "kv": 6e5, "dead_time": 0.01, "nullspace_damping": 1e4},
    ),
}


# Everything that a loop may have, and dead times of whole samples and of others.
LOOPS: dict[str, tuple[str, tuple[float, ...], dict[str, Any], bool]] = {
    "at once": ("excavator", (0.992, -1.4056), {"kp": 1e4, "kv": 1e3}, False),
    "a whole sample late": ("excavator", (0.992, -1.4056), {"kp": 1e4, "kv": 1e3, "dead_time": 0.005}, False),
    "integral and filter": (
        "excavator", (0.992, -1.4056),
        {"kp": 1e4, "kv": 1e3, "ki": 2e3, "feedback": "pid", "filter_hz": 30.0, "dead_time": 0.0013}, True,
    ),
    "drives": (
        "boom-stick-bucket", (-0.9, -1.4, -0.6),
        {"kp": 1.2, "kv": 0.0, "drive": "velocity", "servo_gain": 2e5, "dead_time": 0.023, "bandwidth_hz": 30.0}, False,
    ),
    "redundant": (
        "slewing-excavator", (0.2, 0.5, -1.2, -0.5), {"kp": 3e6, "kv": 6e5, "dead_time": 0.0071}, False,
    ),
}  # fmt: skip

# Arms that their weight lets drift along the self-motion; beside it directions in which loops may rest anywhere.
DRIFTING: dict[str, tuple[str, tuple[float, ...], dict[str, Any], bool]] = {
    "in two ways": (
        "mobile-manipulator", (-0.02, -1.31, 1.6, -0.77, -0.22, 0.03), {"drive": "torque", "kp": 9.0, "kv": 10.8}, True,
    ),
    "in one way, late": ("truck-crane", (0.61, 0.8256, -0.939, 0.7858), {"drive": "torque", "dead_time": 0.0071}, True),
    "with idle integrals": (
        "boom-stick-bucket", (-0.5, -1.9, -1.0),
        {"drive": "torque", "kp": 5.42e5, "kv": 3.6e5, "ki": [0.0, 0.0], "feedback": "pid"}, True,
    ),
}  # fmt: skip


def point_of(name: str) -> LoopPoint:
    machine, posture, loop, gravity = (LOOPS | DRIFTING)[name]
    stand = flexopt.evaluate(flexopt.load(machine), posture, gravity=gravity)
    settings = loop_settings(flexopt.load(machine), Loop(control="inverse", **loop), stand, gravity=gravity)
    return settings.outcome(flexopt.load(machine), stand.base, stand.posture, gravity=gravity)


def made(name: str, posture: tuple[float, ...], loop: dict[str, Any]) -> tuple[Evaluation, LoopSettings, LoopPoint]:
    machine = flexopt.load(name)
    stand = flexopt.evaluate(machine, posture)
    settings = loop_settings(machine, Loop(control="inverse", **loop), stand)
    return stand, settings, settings.outcome(machine, stand.base, stand.posture, gravity=False)


def signals(point: LoopPoint, until: float, looks: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, |e| along each row and |base|, of the loop run event by event: measured, late, held."""
    p, plant, period = point.parts, point.motions.plant, point.period
    n, r, k, to_q = len(p.flow), plant.n_task, len(p.law), point.motions.loop.to_q
    jacobian = plant.rigid_jacobian(point.configuration, point.numbers["base"], point.numbers["p"]).full()
    s = np.zeros((n, r))
    s[: len(to_q)] = np.linalg.solve(to_q, np.vstack([np.zeros((plant.n_passive, r)), np.linalg.pinv(jacobian)]))
    block = np.zeros((n + p.drive.shape[1],) * 2)
    block[:n] = np.hstack([p.flow, p.drive])

    def advanced(s: np.ndarray, torque: np.ndarray, span: float) -> np.ndarray:
        return (expm(block * span) @ np.vstack([s, torque]))[:n]

    law, first = np.zeros((k, r)), p.measured @ s
    if point.motions.filtered:
        law[k - 2 * r :] = first
    # A measurement at the start of a sample, less the dead time, is what its force is made of.
    samples = point.dead_time / period
    whole, rest = int(samples + 1e-9), point.dead_time - int(samples + 1e-9) * period
    rest = 0.0 if rest < 1e-9 else rest
    waiting = list[np.ndarray]()
    for _ in range(whole + (1 if rest else 0)):
        # What is on its way was made of the start, and an integral grew meanwhile.
        waiting.append(p.force @ np.vstack([law, first]))
        law = p.law @ np.vstack([law, first])
    rows = list(point.motions.loop.shape.base_hinges) or list(range(plant.n_passive))
    times, errors, turns = list[float](), list[np.ndarray](), list[np.ndarray]()
    for j in range(round(until / period)):
        if not rest:
            seen = np.vstack([law, p.measured @ s])
            waiting.append(p.force @ seen)
            law = p.law @ seen
        torque = p.direct @ s + p.spread @ waiting.pop(0)
        for i in range(looks):
            here = advanced(s, torque, i * period / looks)
            times.append((j + i / looks) * period)
            errors.append(np.linalg.norm(p.measured[:r] @ here, axis=0))
            turns.append(np.abs((to_q @ here[: len(to_q)])[rows]).max(axis=0))
        if rest:
            seen = np.vstack([law, p.measured @ advanced(s, torque, period - rest)])
            waiting.append(p.force @ seen)
            law = p.law @ seen
        s = advanced(s, torque, period)
    return np.array(times), np.array(errors), np.array(turns)


@pytest.mark.long("at once", "a whole sample late", "integral and filter")
@pytest.mark.parametrize("name", LOOPS)
def test_moves_are_those_of_the_loop_run_event_by_event(name: str) -> None:
    """Filters, integrals, servos, any dead time: by SciPy's exponential from one event to the next."""
    point = point_of(name)
    settling, swing = point.settling().value, point.swing().value
    looks = 8
    times, errors, turns = signals(point, (1.3 * settling if math.isfinite(settling) else 10.0) + 0.1, looks)
    assert swing >= turns.max() * (1 - 1e-9)
    assert swing == pytest.approx(turns.max(), rel=2e-3)
    if math.isfinite(settling):
        loud = np.any(errors > SETTLED, axis=1)
        last = int(np.flatnonzero(loud)[-1])
        assert times[last] - 1e-9 <= settling <= times[last + 1] + 1e-9


def moved(point: LoopPoint, by: str, along: np.ndarray, h: float) -> LoopPoint:
    if by == "dead_time":
        return replace(point, dead_time=point.dead_time + h * float(along[0]))
    given = {name: value for name, value in point.numbers.items() if name != "held"}
    return replace(point, numbers=point.motions.numbers(given | {by: given[by] + h * along}))


def value_along(point: LoopPoint, measure: Any, by: str, along: np.ndarray, h: float) -> float:
    return measure(moved(point, by, along, float(h))).value


@pytest.mark.parametrize("name", DRIFTING)
def test_moves_of_an_arm_that_drifts_are_without_the_drift(name: str) -> None:
    """The whole motion, less what every growing eigenvector has of it: its share of the start times μᵏ."""
    point = point_of(name)
    move, settling = point.move, point.settling().value
    assert move is not None
    solved: Any = eig
    values, left, right = solved(point.smooth.matrix, left=True)
    drifts = np.abs(values) > 1 + 1e-7
    assert point.loop.drift[0] > 0
    assert np.count_nonzero(drifts) == sum(rate > 0 for rate in point.loop.drift)
    x, to_q = replace(move, drifts=False).start, point.motions.loop.to_q
    shares = (left.conj().T @ x) / np.sum(left.conj() * right, axis=0)[:, None]
    rows = list(point.motions.loop.shape.base_hinges)
    swing, last, longest = 0.0, 0.0, round((1.5 * settling + 1.0) / point.period)
    for k in range(longest):
        s = (x - (right[:, drifts] @ (values[drifts, None] ** k * shares[drifts])).real)[: len(point.parts.flow)]
        swing = max(swing, float(np.abs(to_q[rows] @ s[: len(to_q)]).max()))
        if np.linalg.norm(point.parts.measured[: point.motions.plant.n_task] @ s, axis=0).max() > SETTLED:
            last = k * point.period
        x = point.smooth.matrix @ x
    assert last <= settling <= last + point.period
    # The largest may lie between two samples.
    assert swing * (1 - 1e-9) <= point.swing().value <= swing * (1 + 5e-3)


@pytest.mark.long
def test_a_damper_brakes_a_drift_without_another_swing() -> None:
    """The swing follows gently while the drift gets slower by far: it is not what that makes of it in some minute."""
    machine, posture, loop, gravity = DRIFTING["in two ways"]
    found = [
        flexopt.outcome(flexopt.load(machine), posture, loop=loop | {"nullspace_damping": float(d)}, gravity=gravity)
        for d in (0.0, *np.geomspace(0.02, 0.5, 6))
    ]
    assert all(each.drift[0] > 0 for each in found)
    assert found[0].drift[0] > 4 * found[-1].drift[0]
    assert all(math.isfinite(each.settling) for each in found)
    assert all("standard move, without that drift: settles in" in repr(each) for each in found)
    swings = np.array([each.swing for each in found])
    assert np.ptp(np.log(swings)) < 0.15


@pytest.mark.long
@pytest.mark.parametrize("name", LOOPS | DRIFTING)
def test_derivatives_beside_differences(name: str) -> None:
    """SciPy's adaptive differences; of what the balls of `late_cases` do not have: filters, weight, servos."""
    point, rng = point_of(name), np.random.default_rng(0)
    compared = 0
    for measure in (LoopPoint.settling, LoopPoint.swing):
        found = measure(point)
        if found.slopes is None:
            continue
        gradient = point.gradient(found)
        for by in ("posture", "base", "p", "kp", "kv", "ki", "servo_gain", "filter_hz", "bandwidth_hz", "dead_time"):
            x = np.array([point.dead_time]) if by == "dead_time" else point.numbers[by]
            if by == "dead_time" and abs(point.dead_time / point.period - round(point.dead_time / point.period)) < 1e-9:
                continue
            along = rng.uniform(0.5, 1.0, len(x)) * (np.ones(len(x)) if by in ("posture", "base") else np.abs(x))
            terms = gradient[by] * along
            if not np.abs(terms).sum() > 1e-9 * abs(found.value):
                continue
            values = np.vectorize(partial(value_along, point, measure, by, along))
            size, each = float(np.abs(terms).sum()), list[Any]()
            for h in (5e-4, 6e-5, 4e-3):
                each.append(derivative(values, 0.0, initial_step=h, step_factor=2.0, order=8))
                if each[-1].error < 1e-10 * size:
                    break
            truth = min(each, key=lambda found: float(found.error))
            assert truth.error < 2e-5 * size
            assert abs(float(terms.sum() - truth.df)) <= 1e-7 * size + 3 * float(truth.error), (by, measure)
            compared += 1
    assert compared >= 5


@pytest.mark.long("late", "filtered", "an integral, late")
@pytest.mark.parametrize("name", CASES)
def test_moves_are_those_of_nonlinear_runs(name: str) -> None:
    """Of 0.1 mm, along each row by itself."""
    machine, posture, loop = CASES[name]
    stand, settings, point = made(machine, posture, loop)
    plant = flexopt.build_plant(flexopt.load(machine))
    at = plant.rest(stand.base, stand.posture, plant.parameter_values)
    jacobian = plant.rigid_jacobian(at, stand.base, plant.parameter_values).full()
    sensor = {"delay": settings.dead_time} | ({"filter_hz": settings.filter_hz} if settings.filter_hz else {})
    runs = [
        flexopt.simulate(
            plant.machine, posture, offset=SMALL * column, rate=settings.rate, duration=30.0, integrator="gauss",
            sensor=sensor, **{name: gain for name, gain in loop.items() if name not in {"dead_time", "filter_hz"}},
        )
        for column in np.linalg.pinv(jacobian).T
    ]  # fmt: skip
    swing = max(run.peak_base_rotation or 0.0 for run in runs) / SMALL
    settling = max(run.settling_time or math.inf for run in runs)
    # What is not linear in a run of this size; a sample's width at the border of 2 %.
    # Runs are looked at where samples begin, and a peak may lie between two.
    assert swing * (1 - 1e-4) <= point.swing().value <= swing * (1 + 5e-3)
    assert point.settling().value == pytest.approx(settling, abs=1.5 / settings.rate)


def test_a_loop_that_grows_has_no_move() -> None:
    _, _, point = made("excavator", (0.0448, -2.0499), {"kp": 1e5, "kv": 2e3, "dead_time": 0.1})
    for measured in (point.settling(), point.swing()):
        assert math.isnan(measured.value)
        assert all(np.isnan(slope).all() for slope in point.gradient(measured).values())


def test_what_does_not_settle_in_a_minute() -> None:
    _, _, point = made("excavator", (0.992, -1.4056), {"kp": 10.0, "kv": 1e3})
    assert math.isnan(point.settling().value)
    assert point.swing().value > 0


@pytest.mark.long
def test_slow_motions_do_not_come_back() -> None:
    """Weak gains swing so slowly that the error is quiet for many seconds, and loud again: no settling is told then."""
    told = list[bool]()
    for share in np.linspace(1.0, 3.0, 17):
        point = made("excavator", (0.905, 1.4827), {"kp": 25.8 * share**2, "kv": 196.0 * share})[2]
        move, settling, last = point.move, point.settling().value, 0.0
        assert move is not None
        to_error, state = point.parts.measured[: point.motions.plant.n_task], move.start
        for k in range(round(400.0 / point.period)):
            if np.linalg.norm(to_error @ state[: to_error.shape[1]], axis=0).max() > SETTLED:
                last = k * point.period
            state = move.sample.matrix @ state
        told.append(math.isfinite(settling))
        assert last > 60.0 if math.isnan(settling) else last - 1e-9 <= settling <= last + 2 * point.period
    assert 3 <= sum(told) <= 14


@pytest.mark.long
def test_settling_jumps_where_an_excursion_leaves_the_band() -> None:
    """Along a gain, where it jumps, the peak that begins to count touches 2 %."""

    def at(kv: float) -> LoopPoint:
        return made("excavator", (0.992, -1.4056), {"kp": 1e4, "kv": kv})[2]

    gains = np.linspace(6e2, 7e2, 21)
    times = np.array([at(float(kv)).settling().value for kv in gains])
    jump = int(np.argmax(np.abs(np.diff(times))))
    assert abs(times[jump + 1] - times[jump]) > 1.0
    low, high = float(gains[jump]), float(gains[jump + 1])
    for _ in range(45):
        middle = (low + high) / 2
        below = at(middle).settling().value > (times[jump] + times[jump + 1]) / 2
        low, high = (middle, high) if below else (low, middle)
    move = at(low).move
    assert move is not None
    after = move.peaks((0,), at(high).settling().value, 20)
    assert min(abs(peak.size - SETTLED) for peak in after) < 1e-5 * SETTLED
    # So near to it there is no derivative.
    assert at(high).settling().slopes is None


@pytest.mark.long
def test_an_elastic_root_of_the_arm_is_not_the_base() -> None:
    """Softer, it turns farther than the base does; the turn that is told stays the base's."""
    data = flexopt.load("excavator").to_dict()
    root = {"name": "root", "length": 0.3, "com": 0.15, "mass": 60.0, "inertia": 0.6, "passive": True, "damping": 200.0}
    loop = {"kp": 8e3, "kv": 3e3, "drive": "torque"}
    swings = list[float]()
    for stiffness in (1e9, 2e5):
        links = [root | {"stiffness": stiffness}, *data["links"]]
        machine = flexopt.machine_from_dict({**data, "links": links})
        posture = (0.0448, -2.0499)
        swings.append(flexopt.outcome(machine, posture, loop=loop).swing)
        run = flexopt.simulate(machine, posture, loop=loop, duration=4.0)
        turns = np.abs(run.q[:, :4] - run.q[0, :4]).max(axis=0)
        rows = [run.coordinates.index(name) for name in ("base.rotation", "root")]
        assert run.peak_base_rotation == pytest.approx(turns[rows[0]], rel=1e-9)
        assert (turns[rows[1]] > 2 * turns[rows[0]]) == (stiffness == 2e5)
    assert swings[1] == pytest.approx(swings[0], rel=0.5)


@pytest.mark.long
def test_a_base_whose_axles_have_masses_turns_as_one_without() -> None:
    """Bodies between its springs are the base's, too, as light as these are."""
    data, posture = flexopt.load("truck-crane").to_dict(), (0.61, 0.8256, -0.939, 0.7858)
    heavy = [body | {"mass": 1e-3} if body["name"].startswith("truck.") else body for body in data["bodies"]]
    loop = {"kp": 1e4, "kv": 5e3, "drive": "torque", "nullspace_damping": 1e3}
    plain, split = (
        flexopt.outcome(flexopt.tree_from_dict({**data, "bodies": bodies}), posture, loop=loop)
        for bodies in (data["bodies"], heavy)
    )
    assert (plain.swing_unit, split.swing_unit) == ("rad", "rad")
    assert split.swing == pytest.approx(plain.swing, rel=1e-4)
