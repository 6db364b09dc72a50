"""Closed loops of random machines that are stable and well damped, and what their tests share."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from flexopt import build_plant, load
from flexopt.errors import FlexoptWarning, InputError
from flexopt.model import Machine, machine_from_dict
from flexopt.simulation.run import simulate_checked
from flexopt.simulation.scenario import Scenario, build_scenario, checked_options, start_states
from tests.oracles.machines import NumpySource, Structure, draw_machine, regular_posture

EXCAVATOR = load("excavator")
POSTURE_A = (0.9929, -2.6306)
POSTURE_B = (0.0448, -2.0499)


def scenario(machine: Machine, **options: Any) -> Scenario:
    return build_scenario(machine, checked_options("simulate", machine, options))


def run(of: Scenario) -> Any:
    """The trajectory, whatever it warns of."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FlexoptWarning)
        return simulate_checked(of)


def state_matrix(of: Scenario) -> np.ndarray:
    """∂x_next/∂x at equilibrium."""
    loop = of.loop
    x, e = ca.MX.sym("x", loop.states.total), ca.DM.zeros(loop.signals.total)
    tangent = ca.Function("tangent", [x], [ca.jacobian(loop.step(x, e, of.constants)[0], x)])
    at = start_states(of.machine, loop, of.parts, of.q_design[:, None])
    return tangent(at).full()


@dataclass
class Case:
    """A machine, and options of `simulate` for a loop about a regular posture of it."""

    data: dict[str, Any]
    machine: Machine
    options: dict[str, Any]

    @property
    def scenario(self) -> Scenario:
        return scenario(self.machine, **self.options)


def stable_case(seed: int, structure: Structure, control: str, *, samples: int = 2000, **options: Any) -> Case:
    """The first random machine with gains that let every mode of the sampled loop decay by a tenth of 1/s at least.

    Two integrations by different operations part by rounding times the loop's amplification of it; a loop that decays
    everywhere forgets its rounding, and what is left measures the equations. The one exception are the positions of a
    redundant arm's self-motion: poles at 1, which keep rounding but do not amplify it.
    """
    rng = np.random.default_rng(seed)
    while True:
        data = draw_machine(NumpySource(rng), structure, spread=30.0, damping_ratio=0.5, frequency=(0.7, 2.0))
        machine = machine_from_dict(data)
        plant, p = build_plant(machine), build_plant(machine).parameter_values
        posture = regular_posture(rng, machine, condition=8.0)
        n = len(posture)
        base = float(rng.uniform(-1, 1))
        q = plant.rest(base, posture, p).full().ravel()
        mass = plant.mass(q, base, p).full()[-n:, -n:]
        rigid = plant.rigid_jacobian(q, base, p).full()
        reach = np.linalg.norm(rigid, 2) ** 2
        inertia = float(np.linalg.eigvalsh(mass)[-1]) * (1.0 if control == "inverse" else 1 / reach)
        offset = 0.2 * rng.uniform(0.3, 1.0, n) * rng.choice([-1.0, 1.0], n)
        for corner in (10.0, 5.0, 2.5, 1.2):
            kp = inertia * corner**2 * rng.uniform(0.5, 1.5, 2)
            given = {"posture": posture, "base": base, "control": control, "kp": kp, "kv": 2 * kp / corner}
            given |= {"offset": offset, "duration": 0.1, "rate": 100.0, "substeps": 100} | options
            if n > 2:
                given["nullspace_damping"] = 2 * inertia * (1.0 if control == "inverse" else reach)
            try:
                made = scenario(machine, **given)
            except ValueError:  # falls over under gravity
                break
            fastest = 2 * math.pi * made.frequencies_hz[-1]
            rate = math.ceil(2 * fastest / 10) * 10.0
            given |= {"rate": rate, "duration": samples / rate, "substeps": options.get("substeps", 1)}
            case = Case(data, machine, given)
            try:
                poles = np.sort(np.abs(np.linalg.eigvals(state_matrix(case.scenario))))
            except InputError:  # the joints' dampers are too fast for RK4's step
                continue
            settled = poles[: len(poles) - (n - 2)]
            # Far from the posture even such a loop may run away.
            if settled[-1] < math.exp(-0.1 / rate) and np.all(np.abs(run(case.scenario).v) < 5):
                return case
