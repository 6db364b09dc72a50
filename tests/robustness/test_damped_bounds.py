"""Damped measures where poles come close: derivatives against differences in 50 digits, and consistency of what is told."""

from __future__ import annotations

import json

import numpy as np
import pytest

import flexopt
from flexopt.robustness.damped import damped_modes
from tests.oracles.machines import NumpySource, Structure, draw_machine
from tests.robustness.test_damped import case, partial_fractions

pytestmark = pytest.mark.filterwarnings("ignore:ε_max:flexopt.errors.FlexoptWarning")


def close_poles(seed: int, apart: float):
    """A machine two of whose frequencies meet within `apart` or so, relative, by its vertical stiffness."""
    rng = np.random.default_rng(seed)
    data = draw_machine(NumpySource(rng), Structure(2, ("x", "y", "rotation"), ()), spread=10.0, joint_damping=False)
    posture = rng.uniform(-2, 2, 2)
    measures = flexopt.build_measures(flexopt.machine_from_dict(data))
    p = measures.plant.parameter_values.full().ravel()
    k = measures.plant.parameter_names.index("base.stiffness.y")

    def closest(stiffness):
        p[k] = stiffness
        omega = np.sqrt(measures.values(base=0, posture=posture, p=p)["omega_squared"].full().ravel())
        return np.min(np.diff(omega) / omega[1:])

    best = min(np.geomspace(p[k] / 10, p[k] * 10, 60), key=closest)
    for width in (0.2, 0.02, 0.002):
        best = min(best * (1 + width * np.linspace(-1, 1, 21)), key=closest)
    data["base"]["stiffness"]["y"] = best * (1 + apart)
    return flexopt.machine_from_dict(data), posture


@pytest.mark.long
@pytest.mark.parametrize("control", ["inverse", "transpose", "damped:0.2"])
@pytest.mark.parametrize("seed", range(2))
def test_gradients_near_a_meeting_of_frequencies(seed, control):
    machine, posture = close_poles(seed, 1e-9)
    base = np.zeros(1)

    def at(q):
        lowest = 2 * np.pi * 0.1
        return damped_modes(machine, base, q, control, False, lowest)

    here = at(posture)
    size = np.linalg.norm(here.n0, axis=(1, 2))
    direction = np.random.default_rng(seed).normal(size=2)
    for i in range(3):
        exact, bound = here.w_z[i, 1:] @ direction, here.w_z_error[i] @ np.abs(np.append(0.0, direction))
        if not np.isfinite(exact):
            continue
        # Sixth order; the closer the poles the shorter the way over which w is smooth, so the best of several steps.
        found = []
        for h in (1e-3, 3e-4, 1e-4, 3e-5):
            w = {k: at(posture + k * h * direction).w[i] for k in (-3, -2, -1, 1, 2, 3)}
            found.append((45 * (w[1] - w[-1]) - 9 * (w[2] - w[-2]) + (w[3] - w[-3])) / (60 * h))
        assert min(abs(f - exact) for f in found) <= 2e-9 * (size[i] + abs(exact))
        assert bound <= 1e-9 * (size[i] + abs(exact))


def test_numbers_beside_damped_measures_are_damped_too():
    machine, posture = case(Structure(3, ("x", "rotation"), ()), 3, damping_ratio=0.3, joint_damping=True)
    result = flexopt.evaluate(machine, posture, damped=True)
    _, n0, _ = partial_fractions(machine, posture, "inverse")
    np.testing.assert_allclose(result.residues, n0, atol=1e-9 * np.abs(n0).max())
    np.testing.assert_allclose(result.scale, np.linalg.norm(n0, axis=(1, 2)), rtol=1e-9)
    assert result.in_phase == tuple(np.trace(n0, axis1=1, axis2=2) > 0)
    assert result.in_phase_strict == tuple(np.all(np.diagonal(n0, axis1=1, axis2=2) >= 0, axis=1))
    smallest = [np.linalg.eigvalsh(n + n.T)[0] for n in result.residues]
    np.testing.assert_allclose(result.w, smallest, atol=1e-12 * np.abs(n0).max())
    plain = flexopt.evaluate(machine, posture)
    assert np.abs(result.residues - plain.residues).max() > 1e-4 * np.abs(n0).max()
    document = json.loads(json.dumps(result.to_dict()))
    assert np.shape(document["damped"]["w_error"]) == result.gradient.w.shape


def test_without_damping_the_damped_numbers_are_the_undamped_ones():
    machine, posture = case(Structure(2, ("x", "y", "rotation"), ()), 3, damping_ratio=0.0, joint_damping=False)
    plain, damped = (flexopt.evaluate(machine, posture, damped=d) for d in (False, True))
    np.testing.assert_allclose(damped.residues, plain.residues, atol=1e-10 * np.abs(plain.residues).max())
    np.testing.assert_allclose(damped.scale, plain.scale, rtol=1e-9)
    np.testing.assert_allclose(damped.gradient.w, plain.gradient.w, atol=1e-9 * np.abs(plain.gradient.w).max())
    assert damped.in_phase == plain.in_phase
