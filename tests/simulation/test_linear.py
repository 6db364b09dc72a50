"""The sampled linear loop against the matrix exponential of the linear plant, and verdicts against its eigenvalues."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
from scipy.linalg import expm

import flexopt
from flexopt.errors import FlexoptWarning, InputError
from flexopt.model import machine_from_dict
from flexopt.plant import build_plant
from tests.oracles.machines import NumpySource, Structure, draw_machine, heavier, regular_posture
from tests.simulation.loops import EXCAVATOR, POSTURE_A, POSTURE_B

STRUCTURES = [
    Structure(2, ("x", "y", "rotation"), ()),
    Structure(2, ("y",), ()),
    Structure(3, ("x", "rotation"), (1,)),
    Structure(3, ("x", "y", "rotation"), ()),
    Structure(4, ("rotation",), ()),
]


def held(machine, posture, control, kp, kv, period, base=(0.0,)):
    """Eigenvalues of the sampled loop, held input: x = [v; q − q_d], f = −(Kp C + Kv C') x."""
    plant = build_plant(machine)
    a, b, c = (x.full() for x in plant.linearisation(control).call([base, posture, plant.parameter_values]))
    n, r = len(a) // 2, b.shape[1]
    rate = np.hstack([c[:, n:], np.zeros((r, n))])
    block = np.zeros((2 * n + r, 2 * n + r))
    block[: 2 * n, : 2 * n], block[: 2 * n, 2 * n :] = a, b
    whole = expm(block * period)
    loop = whole[: 2 * n, : 2 * n] - whole[: 2 * n, 2 * n :] @ (kp * c + kv * rate)
    return np.linalg.eigvals(loop)


def without_self_motion(values, excess):
    """A double eigenvalue 1 for each degree of redundancy left out; rounding splits them by its square root."""
    return values[np.argsort(np.abs(values - 1))][2 * excess :]


def apart(a, b):
    """Largest distance between two sets of numbers, matched greedily."""
    left, worst = list(b), 0.0
    for value in a:
        k = int(np.argmin(np.abs(np.array(left) - value)))
        worst = max(worst, abs(left.pop(k) - value))
    return worst


@pytest.mark.parametrize("structure", STRUCTURES, ids=str)
@pytest.mark.parametrize("control", ["inverse", "transpose", "damped:0.3"])
def test_multipliers_are_those_of_the_held_linear_plant(structure, control):
    rng = np.random.default_rng(STRUCTURES.index(structure))
    data = draw_machine(NumpySource(rng), structure, spread=30.0, joint_damping=False)
    machine = machine_from_dict(data)
    posture = regular_posture(rng, machine, condition=8.0)
    mass = sum(link["mass"] for link in data["links"])
    kp, kv = 3.0 * mass, 1.0 * mass
    loop = flexopt.sampled_loop(machine, posture, control=control, kp=kp, kv=kv, rate=200.0, integrator="dop853")
    expected = without_self_motion(held(machine, posture, control, kp, kv, 1 / 200), len(posture) - 2)
    assert loop.multipliers.shape == expected.shape
    # The integrator's error (order 8, at most 0.7 rad a step) and eigenvalues that nearly repeat.
    assert apart(loop.multipliers, expected) < 1e-7
    assert loop.growth_rate == pytest.approx(math.log(np.abs(expected).max()) * 200, abs=2e-5)


def test_articles_poles():
    """Notes on the article, section 6: Kp = 1e4, Kv = 1e3: +.07 at A, −.013 at B."""
    gains = {"kp": 1e4, "kv": 1e3, "integrator": "dop853"}
    assert flexopt.sampled_loop(EXCAVATOR, POSTURE_A, **gains).growth_rate == pytest.approx(0.07, abs=5e-3)
    assert flexopt.sampled_loop(EXCAVATOR, POSTURE_B, **gains).growth_rate == pytest.approx(-0.013, abs=5e-4)


@pytest.mark.long
def test_a_border_is_where_the_growth_rate_changes_sign():
    border = flexopt.stability_border(EXCAVATOR, POSTURE_B, kv=2e3)
    (low, high) = border.intervals[-1]
    assert border.largest == border.intervals[0][1]

    def growth(kp):
        return flexopt.sampled_loop(EXCAVATOR, POSTURE_B, kp=float(kp), kv=2e3).growth_rate

    assert growth(high * (1 - 1e-6)) < 0 < growth(high * (1 + 1e-6))
    assert growth(math.sqrt(low * high)) < 0
    assert low == border.searched[0]
    assert flexopt.stability_border(EXCAVATOR, POSTURE_A, kv=2e3).intervals == ()
    by_ratio = flexopt.stability_border(EXCAVATOR, POSTURE_A, ratio=0.1)
    assert by_ratio.ratio
    assert by_ratio.largest < 1e3


@pytest.mark.parametrize("factor", [1e-8, 1e-4, 1e4])
def test_borders_are_looked_for_where_a_machine_as_heavy_has_them(factor: float) -> None:
    """The linear loop is linear in masses, springs, dampers and gains: all times c, it is the same."""
    small = heavier(EXCAVATOR.to_dict(), factor)
    for given in ({"ratio": 0.1}, {"kv": 2e3}):
        whole = flexopt.stability_border(EXCAVATOR, POSTURE_B, **given)
        own = {name: value * (factor if name == "kv" else 1.0) for name, value in given.items()}
        found = flexopt.stability_border(small, POSTURE_B, **own)
        # `rigid_gains` are told to four digits.
        assert found.searched == pytest.approx(factor * np.array(whole.searched), rel=2e-3)
        assert whole.searched[0] < whole.largest < whole.searched[1]
        assert found.largest == pytest.approx(factor * whole.largest, rel=1e-6)


def test_borders_are_looked_for_about_a_gain_that_is_given() -> None:
    border = flexopt.stability_border(EXCAVATOR, POSTURE_B, kp=[0.0, 3e2], ratio=0.1)
    assert border.searched == pytest.approx((3e-2, 3e6))
    none = flexopt.stability_border(EXCAVATOR, POSTURE_B, kp=0.0, ratio=0.1)
    assert none.searched == flexopt.stability_border(EXCAVATOR, POSTURE_B, ratio=0.1).searched
    assert border.largest == pytest.approx(none.largest, rel=1e-6)


def test_a_border_is_that_of_each_row_of_kv():
    border = flexopt.stability_border(EXCAVATOR, POSTURE_B, kv=[2e3, 2e2])
    assert border.kv == (2e3, 2e2)
    for kp in (1e3, 1e5, 1.2e5, 3e5, 7e5):
        grows = flexopt.sampled_loop(EXCAVATOR, POSTURE_B, kp=kp, kv=[2e3, 2e2]).growth_rate > 0
        assert grows != any(low < kp < high for low, high in border.intervals)


@pytest.mark.parametrize("feedback", ["none", "robust"])
def test_what_has_no_gain_has_no_border(feedback):
    with pytest.raises(flexopt.InputError, match=f"feedback = '{feedback}': has no gain Kp"):
        flexopt.stability_border(EXCAVATOR, POSTURE_B, feedback=feedback)


@pytest.mark.long
def test_verdicts_agree_with_the_linear_loop_over_a_grid_of_gains():
    """60 s, small start, both by RK4; where they differ the growth rate is within 0.01/s, which such a run does not tell from 0."""
    best = flexopt.select(EXCAVATOR, (0.0, 1.6)).best.evaluation
    kp, kv = (g.ravel() for g in np.meshgrid(np.logspace(3, 6.3, 14), np.logspace(2, 4.3, 14)))
    stable = 0
    for posture, base in ((POSTURE_A, 0.0), (POSTURE_B, 0.0), (best.posture, float(best.base[0]))):
        linear = np.array(
            [
                flexopt.sampled_loop(
                    EXCAVATOR, posture, base=base, kp=float(p), kv=float(v), integrator="rk4"
                ).growth_rate
                for p, v in zip(kp, kv, strict=True)
            ]
        )
        vary = {"kp": kp, "kv": kv, "offset": np.tile([0.005, -0.005], (kp.size, 1))}
        grows = flexopt.simulate_ensemble(EXCAVATOR, posture, base=base, duration=60.0, vary=vary).dataset["grows"]
        differ = grows.to_numpy() != (linear > 0)
        assert np.all(np.abs(linear[differ]) < 0.01)
        assert differ.mean() < 0.1
        stable += int(np.sum(linear < 0))
    assert 0 < stable < 3 * kp.size


def test_the_optimised_posture_converges_where_a_grows():
    best = flexopt.select(EXCAVATOR, (0.0, 1.6)).best.evaluation
    gains = {"kp": 1e5, "kv": 2e3}
    assert flexopt.simulate(EXCAVATOR, POSTURE_A, **gains).verdict == "grows"
    assert flexopt.simulate(EXCAVATOR, POSTURE_B, **gains).verdict == "converges"
    assert flexopt.simulate(EXCAVATOR, best.posture, base=best.base, **gains).verdict == "converges"


@pytest.mark.parametrize("kp", [1e5, 1e9, 1e12])
def test_what_gains_make_of_rounding_is_no_motion(kp):
    """Servos' torques then change by it at every sample; no weight acts."""
    for posture in np.random.default_rng(0).uniform([-0.5, -2.6], [1.0, -0.5], (6, 2)):
        options = {"kp": kp, "kv": 0.02 * kp, "actuator": {"bandwidth_hz": 10.0}}
        assert np.isfinite(flexopt.sampled_loop(EXCAVATOR, posture, **options).growth_rate)


def test_weight_without_compensation_is_no_equilibrium():
    with pytest.raises(InputError, match="no equilibrium"):
        flexopt.sampled_loop(EXCAVATOR, POSTURE_B, gravity=True, gravity_compensation=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error", FlexoptWarning)
        assert flexopt.sampled_loop(EXCAVATOR, POSTURE_B, gravity=True).stable
