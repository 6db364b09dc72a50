"""The machine's own step against the closed loop's, and against an ODE solver."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import flexopt
from flexopt.loop.machine_step import machine_step
from flexopt.model import machine_from_dict
from flexopt.plant import build_plant
from tests.oracles.machines import NumpySource, Structure, draw_machine
from tests.simulation.loops import EXCAVATOR, POSTURE_B


def test_steps_with_the_loops_torques_are_the_loop():
    run = flexopt.simulate(EXCAVATOR, POSTURE_B, base=2.5, duration=1.0)
    step, p = machine_step(EXCAVATOR), build_plant(EXCAVATOR).parameter_values
    q, v = run.q[0], run.v[0]
    for torque in run.torque[:-1]:
        q, v = (x.full().ravel() for x in step.call([q, v, torque, 2.5, p, 0.005]))
    assert np.abs(q - run.q[-1]).max() < 1e-11
    assert np.abs(v - run.v[-1]).max() < 1e-10


@pytest.mark.parametrize("gravity", [False, True])
@pytest.mark.parametrize(
    "structure",
    [Structure(2, ("x", "y", "rotation"), ()), Structure(3, ("y",), (0,)), Structure(3, ("rotation",), (1,))],
    ids=str,
)
def test_against_an_ode_solver(structure, gravity):
    rng = np.random.default_rng(4)
    machine = machine_from_dict(draw_machine(NumpySource(rng), structure, spread=30.0))
    plant, n = build_plant(machine), build_plant(machine).n_coordinates
    p, m, base = plant.parameter_values, plant.n_passive, 0.4
    torque = rng.uniform(-1, 1, n - m)
    rest = plant.rest(base, np.zeros(n - m), p).full().ravel()
    stiffness, damping = plant.stiffness(p).full(), plant.damping(p).full()

    def rate(_, x):
        q, v = x[:n], x[n:]
        force = -plant.bias(q, v, base, p).full().ravel() - stiffness @ (q - rest) - damping @ v
        force -= gravity * plant.gravity(q, base, p).full().ravel()
        force[m:] += torque
        return np.concatenate([v, np.linalg.solve(plant.mass(q, base, p).full(), force)])

    start = np.concatenate([rest + rng.uniform(-0.05, 0.05, n), rng.uniform(-0.2, 0.2, n)])
    exact = solve_ivp(rate, (0.0, 0.02), start, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    step, misses = machine_step(machine, gravity=gravity), []
    for steps in (64, 128):
        q, v = start[:n], start[n:]
        for _ in range(steps):
            q, v = (x.full().ravel() for x in step.call([q, v, torque, base, p, 0.02 / steps]))
        misses.append(np.abs(np.concatenate([q, v]) - exact).max())
    # Fourth order, down to rounding.
    assert misses[1] < max(misses[0] / 12, 1e-11)
