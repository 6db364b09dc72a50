"""Energy of undamped machines that nobody controls: kept by the accurate methods, lost by RK4 at the article's step."""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import flexopt
from flexopt.model import Machine, machine_from_dict
from flexopt.plant.machine_motion import motion_of
from flexopt.simulation.scenario import Scenario
from tests.oracles.machines import NumpySource, Structure, draw_machine
from tests.simulation.loops import POSTURE_A, POSTURE_B, run, scenario

# Of the energy above equilibrium, over 100 s.
DRIFT = 1e-8


def undamped_excavator() -> Machine:
    path = Path(flexopt.__file__).resolve().parents[1] / "models" / "excavator.toml"
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    del data["base"]["damping"]
    assert not any(link.get("joint_damping") for link in data["links"])
    return machine_from_dict(data)


def pushed(made: Scenario, kind: str) -> Scenario:
    """Started with energy: the base out of its place, in all modes, or the arm swinging as well."""
    n, x = len(made.q_design), made.start.copy()
    still = motion_of(made.loop.structure.motion, {}).n_translations
    x[:still] += np.array([2e-3, -1e-3])[:still]
    # Turned as a whole: the absolute angles of all bodies, so that the joints stay.
    x[still:n] += 0.02
    if kind == "swinging":
        x[still:n] -= 0.01
        x[n + still : 2 * n] = np.linspace(0.1, 0.6, n - still) * (-1.0) ** np.arange(n - still)
    return replace(made, start=x)


@pytest.mark.parametrize("posture", [POSTURE_A, POSTURE_B], ids="AB")
@pytest.mark.parametrize("kind", ["deflected", "swinging"])
@pytest.mark.parametrize("method", ["dop853", "gauss"])
def test_the_excavator_keeps_its_energy_over_100_seconds(method, kind, posture):
    """20,000 samples, 2,200 periods of the fastest mode; with no weight the energy at equilibrium is 0."""
    made = scenario(
        undamped_excavator(), posture=posture, feedback="none", integrator=method, offset=(0.0, 0.0), duration=100.0,
    )  # fmt: skip
    trajectory = run(pushed(made, kind))
    energy = trajectory.energy
    assert len(energy) == 20_001
    assert energy[0] > 100
    assert np.abs(trajectory.v).max() > 0.5
    assert np.abs(energy - energy[0]).max() < DRIFT * energy[0]
    if method == "gauss":
        # What there is swings about zero: over the second half no more than over the first.
        first, second = np.abs(energy[:10_000] / energy[0] - 1).max(), np.abs(energy[10_000:] / energy[0] - 1).max()
        assert second < 2 * first


def test_rk4_loses_energy_at_the_articles_step_and_less_at_shorter_ones():
    lost = []
    for substeps in (1, 2):
        made = scenario(
            undamped_excavator(), posture=POSTURE_A, feedback="none", offset=(0.0, 0.0), duration=100.0,
            substeps=substeps,
        )  # fmt: skip
        energy = run(pushed(made, "swinging")).energy
        lost.append(1 - energy[-1] / energy[0])
    assert lost[0] > 0.1
    # The damping ω (ωh)⁵/144 of RK4 falls by 32 when the step is halved; the fastest mode is gone by then.
    assert 1e-3 < lost[1] < lost[0] / 1.5


def test_rk4_damps_a_mode_as_its_stability_polynomial_says():
    """|R(iωh)| of the fastest mode: 0.16 1/s at 22 Hz and 5 ms (a free arm, the base deflected in that mode alone)."""
    made = scenario(undamped_excavator(), posture=POSTURE_A, feedback="none", offset=(0.0, 0.0), duration=2.0)
    n = len(made.q_design)
    x = made.start.copy()
    # Small, so that the motion stays linear.
    x[:n] += np.linalg.solve(made.loop.to_q, 1e-3 * made.modes[:, -1])
    trajectory = run(replace(made, start=x))
    y = 2 * math.pi * made.frequencies_hz[-1] * made.period
    growth = abs(1 + 1j * y - y**2 / 2 - 1j * y**3 / 6 + y**4 / 24)
    measured = 0.5 * math.log(trajectory.energy[-1] / trajectory.energy[0]) / 2.0
    assert measured == pytest.approx(math.log(growth) / made.period, rel=1e-3)
    assert measured == pytest.approx(-0.16, abs=0.01)


@pytest.mark.parametrize("structure", [Structure(3, ("x", "rotation"), (1,)), Structure(2, ("y",), ())], ids=str)
@pytest.mark.parametrize("method", ["dop853", "gauss"])
def test_other_machines_keep_theirs_under_their_weight(method, structure):
    """The arm falls freely: energy of the weight included, as a share of the largest kinetic energy."""
    rng = np.random.default_rng(8)
    data = draw_machine(NumpySource(rng), structure, spread=10.0, damping_ratio=0.0, joint_damping=False)
    posture = (0.4, 1.1)
    made = scenario(
        machine_from_dict(data), posture=posture, feedback="none", integrator=method, offset=(0.1, -0.1), gravity=True,
        gravity_compensation=False, duration=10.0, rate=500.0,
    )  # fmt: skip
    trajectory = run(made)
    plant = flexopt.build_plant(made.machine)
    kinetic = [
        v @ plant.mass(q, 0.0, plant.parameter_values).full() @ v / 2
        for q, v in zip(trajectory.q[::50], trajectory.v[::50], strict=True)
    ]
    assert np.ptp(trajectory.q[:, -1]) > 1.0
    assert np.abs(trajectory.energy - trajectory.energy[0]).max() < 1e-8 * max(kinetic)
