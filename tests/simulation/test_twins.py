"""One trajectory by every way of computing it: virtual machine, compiled, in lanes, with constants folded in."""

from __future__ import annotations

import os
from dataclasses import replace
from functools import lru_cache
from unittest import mock

import numpy as np
import pytest

from flexopt.compiled import find_compiler, recurrence
from flexopt.simulation.run import runners
from flexopt.simulation.scenario import Scenario
from tests.oracles.machines import Structure
from tests.simulation.loops import EXCAVATOR, POSTURE_B, run, scenario, stable_case

GAINS = {"kp": 2e4, "kv": 3e3}
ABSOLUTE = 1e-10

LOOPS = {
    "article": {},
    "servo, delay, limits": {
        "gravity": True, "feedback": "pid", "ki": 1e4,
        "sensor": {"noise": 1e-4, "resolution": 1e-5, "delay": 0.01},
        "actuator": {"torque_limit": 3e4, "bandwidth_hz": 30.0, "rate_limit": 1e6},
    },
    "continuous": {"hold": False},
    "dop853": {"integrator": "dop853"},
    "gauss": {"integrator": "gauss"},
}  # fmt: skip


@lru_cache
def made(name: str) -> Scenario:
    return scenario(EXCAVATOR, posture=POSTURE_B, duration=1.5, **(GAINS | LOOPS[name]))


@lru_cache
def interpreted(name: str) -> np.ndarray:
    of = made(name)
    with mock.patch.dict(os.environ, FLEXOPT_COMPILE="0"):
        machine = recurrence(of.loop.step)
    assert not machine.compiled
    return machine(of.start, of.constants, steps=of.samples, e=of.signals()).x


def members(of: Scenario, n: int) -> np.ndarray:
    """Starts around that of the scenario, itself the fourth."""
    around = of.start[:, None] * np.ones(n)
    k = len(of.q_design)
    around[:k] += 0.02 * np.random.default_rng(0).uniform(-1, 1, (k, n))
    around[:, 3] = of.start
    return around


@pytest.mark.parametrize("name", list(LOOPS))
def test_compiled_and_interpreted(name):
    of = made(name)
    runner, _, _ = runners(of.loop.structure)
    assert runner.compiled == (find_compiler() is not None)
    ours = runner(of.start, of.constants, steps=of.samples, e=of.signals())
    assert np.abs(ours.x - interpreted(name)).max() <= ABSOLUTE * max(1.0, np.abs(interpreted(name)).max())
    trajectory = run(of)
    n = len(of.q_design)
    q = of.loop.to_q @ ours.x[:, :n, 0].T
    np.testing.assert_allclose(trajectory.q[1:], q.T, atol=1e-14)


@pytest.mark.parametrize("name", list(LOOPS))
def test_a_member_is_the_same_alone_and_among_others(name):
    of = made(name)
    runner, _, _ = runners(of.loop.structure)
    alone = runner(of.start, of.constants, steps=of.samples, e=of.signals())
    for n, threads in ((5, 1), (19, 2)):
        among = runner(members(of, n), of.constants, steps=of.samples, e=of.signals(), threads=threads)
        assert among.x[:, :, 3].tobytes() == alone.x[:, :, 0].tobytes()
        assert among.monitor[:, :, 3].tobytes() == alone.monitor[:, :, 0].tobytes()
        # The others go elsewhere.
        assert np.abs(among.last - alone.last).max(axis=0)[4] > 1e-6


@pytest.mark.parametrize("name", ["article", "servo, delay, limits"])
def test_folded_constants_change_nothing(name):
    of = made(name)
    parametric = run(of)
    folded = run(replace(of, options=of.options.model_copy(update={"baked": True})))
    for field in ("q", "v", "end_point", "energy"):
        ours, theirs = getattr(folded, field), getattr(parametric, field)
        assert np.abs(ours - theirs).max() <= ABSOLUTE * max(1.0, np.abs(theirs).max())
    assert folded.verdict == parametric.verdict


@pytest.mark.long("(4, ('y',), (1,))")
@pytest.mark.parametrize("structure", [Structure(4, ("y",), (1,)), Structure(3, ("x", "y"), ())], ids=str)
def test_random_machines_compiled_and_interpreted(structure):
    case = stable_case(31, structure, "transpose", samples=400)
    of = case.scenario
    with mock.patch.dict(os.environ, FLEXOPT_COMPILE="0"):
        machine = recurrence(of.loop.step)
    expected = machine(of.start, of.constants, steps=400).x
    runner, _, _ = runners(of.loop.structure)
    assert np.abs(runner(of.start, of.constants, steps=400).x - expected).max() <= ABSOLUTE


@pytest.mark.parametrize("options", [{}, {"hold": False}, {"integrator": "dop853"}, {"gravity": True}], ids=str)
def test_carried_directions_are_exact_where_they_say_so(options):
    """One step from random states, slow to whirling: where `turn` is 1 at most, no digit is lost; beyond, none is used."""
    of = scenario(EXCAVATOR, posture=POSTURE_B, duration=0.1, **(GAINS | options))
    loop, c, n = of.loop, of.constants, len(of.q_design)
    rng = np.random.default_rng(7)
    turns = []
    for speed in [*np.geomspace(1e-2, 1e2, 200), *np.linspace(0.3, 30, 300)]:
        x = of.start.copy()
        x[:n] += 10 ** rng.uniform(-4, -1) * rng.uniform(-1, 1, n)
        # All bodies alike in every other state: where they whirl together, the rotations are all there is.
        x[n + 2 : 2 * n] = speed * (rng.uniform(-1, 1, n - 2) if len(turns) % 2 else np.ones(n - 2))
        d = loop.refresh(x, c)
        fast, carried, _, turn = loop.fast(x, d, [], c)
        turns.append(float(turn))
        if turns[-1] <= 1:
            exact = loop.step(x, [], c)[0].full().ravel()
            size = np.abs(exact[n:]).max() + np.abs(exact[:n]).max()
            np.testing.assert_allclose(fast.full().ravel(), exact, atol=5e-15 * size, rtol=0)
            angles = loop.refresh(exact, c).full()
            np.testing.assert_allclose(carried.full(), angles, atol=1e-15, rtol=0)
    assert max(turn for turn in turns if turn <= 1) > 0.5
    assert max(turns) > 1


def test_turns_too_large_for_the_polynomials():
    """An arm that whirls: rotations of up to 0.3 rad in a step, five times what the carried directions allow."""
    of = made("article")
    n = len(of.q_design)
    start = of.start.copy()
    start[n:][-1] = 60.0
    free = scenario(EXCAVATOR, posture=POSTURE_B, duration=0.25, feedback="none")
    runner, _, _ = runners(free.loop.structure)
    with mock.patch.dict(os.environ, FLEXOPT_COMPILE="0"):
        machine = recurrence(free.loop.step)
    expected = machine(start, free.constants, steps=50).x
    ours = runner(start, free.constants, steps=50).x
    assert np.abs(np.diff(expected[:, n - 1, 0])).max() > 0.25
    assert np.abs(ours - expected).max() <= ABSOLUTE * np.abs(expected).max()


def test_signals_are_each_members_own():
    of = made("servo, delay, limits")
    runner, _, _ = runners(of.loop.structure)
    signals = np.stack([of.signals(np.random.default_rng(seed)) for seed in range(4)], axis=2)
    among = runner(of.start, of.constants, steps=of.samples, e=signals)
    for seed in range(4):
        alone = runner(of.start, of.constants, steps=of.samples, e=of.signals(np.random.default_rng(seed)))
        assert among.last[:, seed].tobytes() == alone.last[:, 0].tobytes()
    assert len({among.last[:, seed].tobytes() for seed in range(4)}) == 4
