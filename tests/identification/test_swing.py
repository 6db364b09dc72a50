"""The simulated swing and what is measured of it, beside SciPy's integration; its derivatives beside differences."""

from __future__ import annotations

import numpy as np
import pytest

import flexopt
from flexopt.identification.fitting import SwingProblem, longest_step
from flexopt.identification.log import MeasuredLog
from flexopt.identification.measured import quantities
from flexopt.identification.small_swing import of_roots
from flexopt.identification.swing import HeldSwing
from flexopt.identification.unknown import references
from flexopt.model.parameter_values import with_parameters
from tests.identification.swings import Swung, planar, spatial
from tests.oracles.free_swing import FreeSwing


def held(swung: Swung, columns: list[str], *, gravity: bool = False, imu: tuple[float, ...] | None = None) -> HeldSwing:
    """The fit's swing, its θ = 0 at the truth."""
    true = with_parameters(swung.machine, swung.truth)
    known = quantities(true)
    entries, reference = references(true, list(swung.truth))
    base, place = np.zeros(len(true.base_coordinates)), np.zeros(len(true.kinematic_tree.axes))
    channels = tuple(known[name] for name in columns)
    posture = np.array(swung.posture)
    return HeldSwing(
        true, posture, base, gravity, entries, reference, channels, place if imu is None else np.array(imu)
    )


@pytest.mark.parametrize("swung", [planar(), spatial()], ids=["plane", "space"])
def test_every_quantity_is_what_its_definition_says(swung: Swung) -> None:
    """Coordinates, rates, gyroscopes, accelerometers and end-point, all of a machine, by the oracle's own means."""
    known = quantities(swung.machine)
    columns = [name for name, each in known.items() if each.kind not in ("time", "joint")]
    imu = (0.3, 0.4) if len(swung.posture) == 3 else (0.3, -0.2, 0.5)
    swing, time = held(swung, columns, imu=imu), swung.time[::20]
    theta = np.zeros(len(swung.truth))
    longest = longest_step(swing, theta, time)
    states, slopes = swing.run(swung.swing.start, theta, time, longest)
    found = swing.observed(states, slopes, theta)[0]
    for k, name in enumerate(columns):
        expected = swung.swing.column(name, time, imu)
        # The oracle's rates and accelerations are differences.
        allowed = 1e-4 if name.startswith("acc") else 1e-6
        assert np.abs(found[:, k] - expected).max() < allowed * np.ptp(expected), name


def test_a_swing_under_gravity() -> None:
    swung = planar()
    swing = held(swung, ["base.y", "base.rotation"], gravity=True)
    theta = np.zeros(len(swung.truth))
    rest = swing.rest(theta)
    oracle = FreeSwing(swing.machine, swung.posture, [0.0, 1e-3, 2e-3], [0.0] * 3, gravity=True)
    assert np.abs(oracle.rate(0.0, rest)).max() < 1e-6
    assert np.abs(rest[:3] - oracle.rest[:3]).max() > 1e-3
    found = swing.run(oracle.start, theta, swung.time[::20], longest_step(swing, theta, swung.time))[0]
    assert np.abs(found - oracle.states(swung.time[::20])).max() < 1e-7


@pytest.mark.parametrize("swung", [planar(), spatial()], ids=["plane", "space"])
def test_the_jacobian_of_the_residuals(swung: Swung) -> None:
    """By the first state, by logarithms of parameters and by offsets, at a point that is no optimum."""
    columns = ["base.x", "gyro_z", "acc_x", "end_point.x"]
    swing = held(swung, columns)
    rng, time = np.random.default_rng(2), np.sort(np.random.default_rng(3).uniform(0.0, 0.6, 40))
    theta, n = 0.3 * rng.standard_normal(len(swung.truth)), len(columns)
    values = rng.standard_normal((time.size, n))
    used = rng.random((time.size, n)) > 0.1
    log = MeasuredLog(time, swing.channels, values)
    problem = SwingProblem(swing, log, np.full(n, 0.01), used, longest_step(swing, theta, time))
    start = swung.swing.start + 1e-2 * rng.standard_normal(2 * swing.m)
    z = np.concatenate([start, theta, rng.standard_normal(n)])
    exact = problem.jacobian(z)
    assert exact.shape == (used.sum() + theta.size, z.size)
    assert np.linalg.norm(exact.T @ problem.residuals(z)) > 1.0
    m, p = start.size, start.size + theta.size
    for part in (slice(0, m), slice(m, m + 3), slice(m + 3, p), slice(p, None)):
        step = np.zeros(z.size)
        step[part] = rng.standard_normal(z[part].size)
        difference = (problem.residuals(z + 1e-5 * step) - problem.residuals(z - 1e-5 * step)) / 2e-5
        assert np.abs(difference - exact @ step).max() < 1e-6 * max(1.0, np.abs(exact @ step).max())


def test_parameters_put_back_into_a_machine() -> None:
    """Every parameter of the shipped machines but pins of cylinders."""
    for name in ("excavator", "slewing-excavator", "truck-crane", "mobile-manipulator"):
        machine = flexopt.load(name)
        assert with_parameters(machine, {}) == machine
        pins = tuple(f"{cylinder.name}." for cylinder in machine.cylinders)
        # Products of inertia that were 0 could belong to no body at all.
        values = {
            each.name: each.value * 1.01 for each in machine.parameters if not each.name.startswith(pins) and each.value
        }
        found = {each.name: each.value for each in with_parameters(machine, values).parameters}
        assert {key: found[key] for key in values} == values
    with pytest.raises(flexopt.InputError, match=r"did you mean 'boom\.length'"):
        with_parameters(flexopt.load("excavator"), {"boom.lenght": 1.0})


@pytest.mark.parametrize(("swung", "gravity"), [(planar(), False), (planar(), True), (spatial(), False)])
def test_eigenvalues_of_many_at_once_are_those_of_the_swing_s_own_slopes(swung: Swung, gravity: bool) -> None:
    """About rest the whole field's slopes are those of the small motions; one θ whose springs hold nothing has none."""
    swing = held(
        swung, ["base.y" if "base.y" in swung.machine.coordinates else swung.machine.coordinates[0]], gravity=gravity
    )
    m, thetas = swing.m, np.random.default_rng(1).normal(0.0, 0.3, (4, len(swung.truth)))
    if gravity:
        thetas[2] = np.nan  # as where the search for a deflection fails
    many = swing.roots_of(thetas)
    for theta, roots in zip(thetas, many, strict=True):
        if np.isnan(theta[0]):
            assert roots.size == 0
            with pytest.raises(flexopt.NoSolutionFound):
                swing.rest(theta)
            continue
        slopes = swing.field.call([swing.rest(theta), theta])[1].full()[:, : 2 * m]
        a = np.block([[np.zeros((m, m)), np.eye(m)], [slopes]])
        np.testing.assert_allclose(swing.linear(theta)[0], a, rtol=1e-12, atol=1e-12 * np.abs(a).max())
        expected = np.linalg.eigvals(a)
        expected = expected[expected.imag > 0]
        np.testing.assert_allclose(roots, expected[np.argsort(np.abs(expected))], rtol=1e-9)


def test_slopes_that_a_search_of_poles_is_given() -> None:
    """Beside central differences, at a θ that is no optimum: one-sided ones keep half of the digits."""
    swing, theta = held(planar(), ["base.y"]), np.array([0.3, -0.2, 0.5, 1.4, -0.7, 0.1])
    value, slopes = of_roots(swing, lambda roots, at: np.concatenate([np.log(roots).real, np.log(roots).imag, at**2]))
    h = 1e-5
    central = np.array([(value(theta + step) - value(theta - step)) / (2 * h) for step in h * np.eye(theta.size)]).T
    np.testing.assert_allclose(slopes(theta), central, atol=1e-6)
