"""Gains from the machine: its closed loop on a rigid base, and machines of many sizes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import null_space

import flexopt
from flexopt.model import machine_from_dict
from flexopt.study import gains as gains_map
from flexopt.study.default_gains import default_gains, rigid_gains
from tests.simulation.loops import EXCAVATOR, POSTURE_B

STANDS = {
    "excavator": POSTURE_B,
    "boom-stick-bucket": (-1.0, -1.2, -0.5),
    "slewing-excavator": (0.2, 0.5, -1.2, -0.5),
    "truck-crane": (0.3, 0.6, -1.0, 1.0),
    "mobile-manipulator": (0.3, -1.2, 1.4, -0.8, -1.2, 0.2),
}


@pytest.mark.parametrize("control", ["inverse", "transpose", "damped:0.05"])
@pytest.mark.parametrize("name", list(STANDS))
def test_poles_of_the_arm_on_a_rigid_base(name: str, control: str) -> None:
    """The axes' poles multiply to corner**(2 p), and their traces add to the damping ratio's, by SciPy and NumPy."""
    machine = flexopt.load(name)
    plant = flexopt.build_plant(machine)
    stand = flexopt.evaluate(machine, STANDS[name], base=np.zeros(plant.n_base), control=control)
    gains = rigid_gains(machine, stand, 1000.0)
    p, n = plant.parameter_values, plant.n_actuated
    q = plant.rest(stand.base, stand.posture, p).full().ravel()
    inertia = plant.mass(q, stand.base, p).full()[-n:, -n:]
    jv = plant.rigid_jacobian(q, stand.base, p).full()
    size = 0.05 if control.startswith("damped") else 0.0
    mapped = jv.T if control == "transpose" else jv.T @ np.linalg.inv(jv @ jv.T + size**2 * np.eye(len(jv)))
    a = jv @ np.linalg.solve(inertia, mapped)
    corner = 0.3 * 2 * math.pi * stand.frequencies_hz[0]
    squares = np.linalg.eigvals(gains["kp"] * a)
    # Gains are rounded to four digits.
    assert np.abs(np.prod(squares)) ** (1 / len(a)) == pytest.approx(corner**2, rel=1e-3)
    assert gains["kv"] / (2 * math.sqrt(gains["kp"])) * np.prod(np.linalg.eigvals(a)).real ** (
        0.5 / len(a)
    ) == pytest.approx(0.7, rel=1e-3)
    assert ("nullspace_damping" in gains) == (n > len(jv))
    if n > len(jv):
        free = null_space(jv)
        fastest = gains["nullspace_damping"] * np.linalg.eigvalsh(free.T @ np.linalg.solve(inertia, free)).max()
        assert fastest == pytest.approx(1.4 * corner, rel=1e-3)


@pytest.mark.long("slewing-excavator", "truck-crane", "mobile-manipulator")
@pytest.mark.filterwarnings("ignore:nothing in this run:flexopt.errors.FlexoptWarning")
@pytest.mark.parametrize("name", list(STANDS))
def test_each_machine_comes_to_its_target(name: str) -> None:
    """With 1e5 and 2e3, the defaults of `simulate`, the 22 t machines are still far off after ten seconds."""
    machine = flexopt.load(name)
    base = np.zeros(flexopt.build_plant(machine).n_base)
    stand = flexopt.evaluate(machine, STANDS[name], base=base)
    gains = default_gains(machine, stand, 200.0)
    run = flexopt.simulate(machine, STANDS[name], base=base, **gains)
    linear = flexopt.sampled_loop(machine, STANDS[name], base=base, **gains)
    assert run.verdict == "converges"
    assert linear.stable
    if name == "excavator":
        # Its lowest mode's gains let a mode at 22.7 Hz grow: two halvings of the corner calm it.
        assert gains == rigid_gains(machine, stand, 200.0, 0.25)
        assert not flexopt.sampled_loop(
            machine, STANDS[name], base=base, **rigid_gains(machine, stand, 200.0, 0.5)
        ).stable
        return
    assert gains == rigid_gains(machine, stand, 200.0)
    assert run.settling_time is not None
    assert run.settling_time < 6.0


def test_gains_are_chosen_for_the_loop_they_are_for() -> None:
    """A dead time of 100 ms asks for slower ones; where none is stable the formula's own come back."""
    machine = flexopt.load("slewing-excavator")
    stand = flexopt.evaluate(machine, STANDS["slewing-excavator"], base=np.zeros(3))
    late = {"sensor": {"delay": 0.1}}
    fast, slow = default_gains(machine, stand, 200.0), default_gains(machine, stand, 200.0, late)
    assert slow["kp"] < fast["kp"]
    assert flexopt.sampled_loop(machine, stand.posture, **slow | late).stable
    assert not flexopt.sampled_loop(machine, stand.posture, **fast | late).stable
    never = flexopt.evaluate(EXCAVATOR, (0.9929, -2.6306))
    assert default_gains(EXCAVATOR, never, 200.0) == rigid_gains(EXCAVATOR, never, 200.0)


def test_a_slow_controller_gets_slower_gains() -> None:
    stand = flexopt.evaluate(EXCAVATOR, POSTURE_B)
    fast, slow = (rigid_gains(EXCAVATOR, stand, rate) for rate in (1000.0, 4.0))
    corners = [gains["kp"] / gains["kv"] * 1.4 for gains in (fast, slow)]
    assert corners[0] == pytest.approx(0.3 * 2 * math.pi * stand.frequencies_hz[0], rel=1e-3)
    assert corners[1] == pytest.approx(1.0, rel=1e-3)


@pytest.mark.long
def test_a_report_says_which_gains_it_chose(monkeypatch: pytest.MonkeyPatch) -> None:
    # The map of gains is about others; a coarse one will do.
    monkeypatch.setattr(gains_map, "POINTS", 5)
    monkeypatch.setattr(gains_map, "RATIOS", ())
    heavy = EXCAVATOR.to_dict()
    for body in (heavy["base"], *heavy["links"]):
        body["mass"], body["inertia"] = 9 * body["mass"], 9 * body["inertia"]
    heavy["base"]["stiffness"] = {name: 9 * value for name, value in heavy["base"]["stiffness"].items()}
    found = []
    for machine in (EXCAVATOR, machine_from_dict(heavy)):
        problem = flexopt.build_selection(machine, (0.0, 1.6), base=0.0, starts=2)
        made = flexopt.report(problem, simulation={"duration": 1.0}, points=3)
        best = made.selection.best.evaluation
        assert {name: made.simulation[name] for name in ("kp", "kv")} == default_gains(machine, best, 200.0)
        found.append(made.simulation["kp"])
    assert found[1] == pytest.approx(9 * found[0], rel=1e-2)
    own = flexopt.report(problem, simulation={"duration": 1.0, "kv": 1e3}, points=3)
    assert "kp" not in own.simulation
