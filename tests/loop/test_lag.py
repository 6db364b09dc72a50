"""What modes get to feel of the real controller: against closed-loop eigenvalues, balls and differences."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest

import flexopt
from flexopt.foundation import kept
from flexopt.loop.lag import BY, LaggedModes
from flexopt.loop.settings import loop_settings
from flexopt.model import tree_from_dict
from flexopt.model.loop import Loop
from tests.oracles.slopes import differences
from tests.oracles.spatial import in_space
from tests.simulation.loops import EXCAVATOR, POSTURE_A, POSTURE_B

STANDS = {
    "excavator": (POSTURE_B, Loop(kp=300.0, kv=30.0, dead_time=0.0031)),
    "boom-stick-bucket": ((-1.0, -1.2, -0.5), Loop(dead_time=0.1)),
    "slewing-excavator": (
        (0.2, 0.5, -1.2, -0.5),
        Loop(kp=3e4, kv=6e3, bandwidth_hz=[3, 4, 5, 6], filter_hz=20.0, feedback="pid", ki=3e3, rate=100.0),
    ),
}


def stand(name, *, gravity=False):
    posture, loop = STANDS[name]
    machine = flexopt.load(name)
    evaluation = flexopt.evaluate(machine, posture, gravity=gravity)
    settings = loop_settings(machine, loop, evaluation, gravity=gravity)
    return evaluation, settings, settings.outcome(machine, evaluation.base, evaluation.posture, gravity=gravity)


@pytest.mark.parametrize("posture", [POSTURE_A, POSTURE_B])
def test_the_allowance_is_the_smallest_gain_that_excites(posture):
    """Kv = κ n nᵀ, n the direction that R_i + R_iᵀ likes least: mode i of the continuous loop neither grows nor decays.

    To first order in the gain, which at this damping is four digits where the mode stands alone.
    """
    found = flexopt.evaluate(EXCAVATOR, posture, control="transpose", loop={"kp": 1e4, "kv": 1e3})
    plant = flexopt.build_plant(EXCAVATOR)
    a, b, c = (x.full() for x in plant.linearisation("transpose").call([[0.0], posture, plant.parameter_values]))
    rate = np.roll(c, -(len(a) // 2), axis=1)
    for i in np.flatnonzero(found.outcome.allowance < 500):
        normal = np.linalg.eigh(found.residues[i] + found.residues[i].T)[1][:, :1]

        def growth(kv, i=i, normal=normal):
            poles = np.linalg.eigvals(a - kv * b @ normal @ normal.T @ rate)
            return poles[np.argmin(np.abs(poles - 2j * math.pi * found.frequencies_hz[i]))].real

        kappa = found.outcome.allowance[i]
        assert growth(0.998 * kappa) < 0 < growth(1.002 * kappa)


@pytest.mark.long
def test_what_nothing_excites_allows_every_gain():
    """Turned by π the machine is as symmetric as at 0, but sines are rounding there, and so is w."""
    machine = flexopt.load("slewing-excavator")
    turned, straight = (flexopt.evaluate(machine, (slew, 0.5, -1.2, -0.5), loop={}) for slew in (math.pi, 0.0))
    rounding = np.abs(turned.w) < 1e-13 * turned.scale
    assert rounding.any()
    for name in ("allowance", "allowance_isotropic"):
        assert np.all(np.isinf(getattr(turned.outcome, name)[rounding])), name
        assert np.all(np.isinf(getattr(straight.outcome, name)[straight.w == 0])), name
        assert np.all(np.isnan(turned.outcome.gradient[name]["posture"][rounding])), name
        assert np.all(np.isfinite(turned.outcome.allowance[~rounding])), name


@pytest.mark.long
def test_allowances_beside_each_other():
    for name in STANDS:
        loop = stand(name)[0]
        found = flexopt.evaluate(flexopt.load(name), loop.posture, loop=STANDS[name][1]).outcome
        # In one direction is worse than in all alike.
        assert np.all(found.allowance <= found.allowance_isotropic * (1 + 1e-12))
        if found.settings.drive == "torque":
            omega, a_b = 2 * math.pi * loop.frequencies_hz, np.trace(loop.residues, axis1=1, axis2=2)
            expected = 4 * loop.damping_ratios * omega / np.abs(loop.w)
            np.testing.assert_allclose(found.allowance, expected, rtol=1e-9)
            harmless = a_b >= 0
            assert np.all(np.isinf(found.allowance_isotropic[harmless]))
            twin = (-2 * loop.damping_ratios * omega / a_b)[~harmless]
            np.testing.assert_allclose(found.allowance_isotropic[~harmless], twin, rtol=1e-9)


@pytest.mark.parametrize("name", list(STANDS))
def test_first_order_decay_is_that_of_the_sampled_loop(name):
    """Weak feedback: what the second order adds is small beside what feedback does."""
    evaluation, settings, outcome = stand(name)
    found = flexopt.evaluate(flexopt.load(name), evaluation.posture, loop=STANDS[name][1]).outcome
    exact = 2 * math.pi * found.frequencies_hz * found.damping_ratios
    bound = {"excavator": 2e-3, "boom-stick-bucket": 0.25, "slewing-excavator": 2e-3}[name]
    np.testing.assert_allclose(found.first_order_decay, exact, rtol=bound)
    assert settings.dead_time == outcome.dead_time


def test_lag_and_reserve():
    """Ψ = ω (d + T/2) + atan(Kp / (ω Kv)); past 90° what damped a mode excites it, and the other way round."""
    evaluation = flexopt.evaluate(EXCAVATOR, POSTURE_B)
    omega = 2 * math.pi * evaluation.frequencies_hz
    product = np.trace(evaluation.residues, axis1=1, axis2=2)
    ratio = evaluation.damping_ratios * omega
    for late in (0.0, 0.0031, 0.02, 0.05):
        kp, kv = 0.01, 1e-3
        found = flexopt.evaluate(EXCAVATOR, POSTURE_B, loop={"kp": kp, "kv": kv, "dead_time": late}).outcome
        expected = omega * (late + 0.0025) + np.arctan(kp / (omega * kv))
        np.testing.assert_allclose(found.lag, expected, rtol=1e-12)
        added = found.first_order_decay - ratio
        assert np.all(np.sign(found.lag_reserve) == np.sign(product * np.cos(expected)))
        # The feedback's part is a millionth of the decay and less.
        np.testing.assert_array_less(-1e-15, added * np.sign(found.lag_reserve))


@pytest.mark.parametrize(
    ("gains", "told"),
    [({"kp": 1e2, "kv": 10.0}, "mode 1, decaying with a reserve below 0: the feedback takes away less damping than the mode has of its own"),
     ({"kp": [1e2, 1e3], "kv": [10.0, 20.0]}, "mode 1, decaying with a reserve below 0: equal gains would take damping away; what the mode has of its own, "),
     ({"kp": 1e4, "kv": 1e3}, None)],
)  # fmt: skip
def test_a_mode_that_decays_without_a_reserve_is_explained(gains, told):
    """The mode's own damping is that of the machine without feedback."""
    found = flexopt.evaluate(EXCAVATOR, POSTURE_A, loop=gains)
    own = 2 * math.pi * found.frequencies_hz * found.damping_ratios
    fed = found.outcome.first_order_decay - own
    assert found.outcome.lag_reserve[0] < 0
    assert fed[0] < 0
    assert (found.outcome.first_order_decay[0] > 0) == bool(told)
    assert np.all((fed > 0)[1:] == (found.outcome.lag_reserve > 0)[1:])
    assert ("reserve below 0" in repr(found)) == bool(told)
    assert (told or "") in repr(found)
    why = flexopt.explain(EXCAVATOR, POSTURE_A, loop=gains)
    assert (found.outcome.despite_reserve in repr(why)) == bool(told)


def test_the_generalised_measure_is_an_eigenvalue():
    """Λmin of the Hermitian part of 2 e^{jψ} R; without lag w."""
    for name, (posture, loop) in STANDS.items():
        found = flexopt.evaluate(flexopt.load(name), posture, loop=loop)
        for lag, residue, value in zip(found.outcome.lag, found.residues, found.outcome.w_lagged, strict=True):
            turned = np.exp(1j * lag) * residue
            expected = np.linalg.eigvalsh(turned + turned.conj().T)[0]
            assert value == pytest.approx(expected, abs=1e-12 * np.abs(residue).max())


@pytest.mark.parametrize(("name", "gravity"), [("boom-stick-bucket", True), ("slewing-excavator", False)])
def test_gradients(name, gravity):
    """Beside differences of sixth order, each input in units of its own size."""
    _, settings, outcome = stand(name, gravity=gravity)
    modes = LaggedModes(outcome.motions)
    at = dict(outcome.numbers) | {"dead_time": np.array([settings.dead_time])}
    values, slopes = modes.at(outcome.numbers, settings.dead_time)
    names = list(modes.values.name_in())
    for by in BY:
        size = (
            np.where(np.abs(at[by]) > 0, np.abs(at[by]), 1.0) if by not in ("posture", "base") else np.ones(len(at[by]))
        )
        size = size if by != "p" else size * (np.abs(at[by]) > 0)

        def moved(x, by=by, size=size):
            given = [at[name] + (size * x if name == by else 0) for name in names]
            found = np.concatenate([out.full().ravel() for out in modes.values.call(given)])
            return np.where(np.isfinite(found), found, 0.0)

        expected = differences(moved, np.zeros(len(size)), 1e-4)
        given = np.vstack([slopes[name][by] * size for name in values])
        scale = np.concatenate([np.full(len(x), np.abs(x[np.isfinite(x)]).max(initial=0)) for x in values.values()])
        # Differences lose what rounding and the step to the sixth leave of each measure's size.
        assert np.all(np.abs(given - expected) <= 2e-6 * (scale[:, None] + np.abs(expected))), by


def test_names_of_inputs_and_outputs():
    _, _, outcome = stand("excavator")
    modes = LaggedModes(outcome.motions)
    assert set(modes.values.name_in()) == {*BY, "period"}
    assert tuple(modes.values.name_out()) == modes.NAMES
    assert set(modes.slopes.name_out()) == {f"{name}_{by}" for name in modes.NAMES for by in BY}


@pytest.mark.long
def test_a_plant_that_the_cache_has_dropped():
    """Motions keep the plant that they were made of; measures asked for later may be of a plant built anew."""
    evaluation, settings, here = stand("boom-stick-bucket")
    # As where many other machines were looked at in between.
    kept.forget_all()
    found = LaggedModes(here.motions).at(here.numbers, settings.dead_time)[0]
    again = stand("boom-stick-bucket")[2]
    assert np.array_equal(found["lag"], LaggedModes(again.motions).at(again.numbers, settings.dead_time)[0]["lag"])
    assert found["lag"].size == evaluation.w.size


def rolling(**spring):
    """The excavator's base also rolls about the plane's own x."""
    data = in_space(flexopt.load("excavator").model_dump(by_alias=True))
    k = next(k for k, body in enumerate(data["bodies"]) if body["name"] == "base.rotation")
    joint = {"name": "base.roll", "kind": "hinge", "axis": [1.0, 0.0, 0.0], "passive": True, "stiffness": 3e6} | spring
    data["bodies"].insert(k, {"name": "base.roll", "parent": data["bodies"][k]["parent"], "joint": joint})
    data["bodies"][k + 1]["parent"] = "base.roll"
    return data


def test_what_does_not_move_the_end_point_may_have_any_gain() -> None:
    """A base that also rolls about the plane's own x: no end-point feels it, no feedback excites it.

    Nothing damps the roll, so that the loop is stable at no gain, whatever the sign of the rounding.
    """
    data = rolling()
    loop = {"kp": 1e4, "kv": 1e3, "drive": "torque"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", flexopt.FlexoptWarning)
        found = flexopt.evaluate(tree_from_dict(data), (0.9929, -2.6306), loop=loop)
    unmoved = found.scale <= 1e-20 * found.scale.max()
    assert np.flatnonzero(unmoved).tolist() == [1]
    assert found.w[1] == 0.0
    assert np.isinf(found.outcome.allowance[unmoved]).all()
    assert np.isfinite(found.outcome.allowance[~unmoved]).all()
    assert found.outcome.allowed_gain == 0.0
    assert found.outcome.gain_intervals == ()


def test_what_no_feedback_excites_decays_as_the_machine_does() -> None:
    """The roll of an arm that moves in a plane: at ζ ω, whatever the gains; of the others none is unseen."""
    data = rolling(damping=2e3)
    loop = {"kp": 1e3, "kv": 1e3, "drive": "torque"}
    found = flexopt.evaluate(tree_from_dict(data), (0.9929, -2.6306), loop=loop)
    point = found.outcome.settings.outcome(tree_from_dict(data), found.base, found.posture, gravity=False)
    rate = found.damping_ratios[1] * math.tau * found.frequencies_hz[1]
    modes, rounding = LaggedModes(point.motions), point.loop.rounding
    assert modes.is_unseen(point.numbers, rate, rounding)
    assert not modes.is_unseen(point.numbers, 1.001 * rate, rounding)
    assert np.min(np.abs(np.log(np.abs(point.loop.multipliers)) / point.period + rate)) < 1e-9
    settings = flexopt.outcome(EXCAVATOR, POSTURE_B, loop=loop).settings
    plain = settings.outcome(EXCAVATOR, np.zeros(1), np.array(POSTURE_B), gravity=False)
    assert not LaggedModes(plain.motions).is_unseen(plain.numbers, plain.decay().value, 0.0)


@pytest.mark.long
def test_who_chooses_by_the_decay_hears_that_no_loop_changes_it() -> None:
    """Where the roll decays slowest at the best place; with more damping the loop's own motions are slower."""
    loop = {"kp": 1e3, "kv": 1e3, "drive": "torque"}
    for damping, hidden in ((10.0, True), (1e6, False)):
        machine = tree_from_dict(rolling(damping=damping))
        found = flexopt.select(machine, (0.0, 1.6), objective="decay", loop=loop, starts=2)
        chosen = found.best.evaluation.outcome
        told = "the slowest motion of the best is one that the end-point does not show" in repr(found)
        assert (chosen.unseen, told) == (hidden, hidden)
        assert ("slowest motion of the loop is one that the end-point" in repr(chosen)) == hidden


@pytest.mark.long
def test_a_verdict_says_whose_its_slowest_motion_is() -> None:
    machine = tree_from_dict(rolling(damping=10.0))
    options = {"base": 0.0, "loop": {"kp": 1e3, "kv": 1e3, "drive": "torque"}, "members": 2, "runs": 0, "starts": 2}
    found = flexopt.verdict(machine, (0.0, 1.6), **options)
    assert any(place.unseen for place in found.places)
    assert "one that the end-point does not show and no feedback excites" in repr(found)
