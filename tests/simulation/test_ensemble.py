"""Ensembles: every member is the run that `simulate` makes of it, and nothing depends on how they are grouped."""

from __future__ import annotations

import json
import math
import warnings

import numpy as np
import pytest
import xarray as xr

import flexopt
from flexopt.errors import FlexoptError, FlexoptWarning, InputError, NoSolutionFound
from flexopt.model import machine_from_dict
from tests.simulation.loops import EXCAVATOR, POSTURE_A, POSTURE_B

OFFSETS = np.random.default_rng(3).normal(0.0, 0.03, (21, 2))


def with_payload(mass):
    return machine_from_dict(EXCAVATOR.to_dict() | {"payload": {"mass": float(mass)}})


def test_peaks_are_the_largest_of_all_samples():
    """Also where a run grows until its end: the last sample is in no window."""
    one = flexopt.simulate(EXCAVATOR, POSTURE_A, kp=1e4, kv=1e3, duration=30.0)
    assert one.verdict == "grows"
    largest = np.abs(one.dataset["deflection"].to_numpy()).max(axis=0)[2]
    assert one.peak_base_rotation == pytest.approx(largest, rel=1e-12)
    many = flexopt.simulate_ensemble(EXCAVATOR, POSTURE_A, vary={"kp": [1e4]}, kv=1e3, duration=30.0).dataset
    assert float(many["peak_base_rotation"][0]) == pytest.approx(largest, rel=1e-9)
    off = np.linalg.norm(one.dataset["error"], axis=1)
    assert off[0] * (1 - 1e-9) <= float(many["start_error"][0]) <= off[: len(off) // 4].max() * (1 + 1e-9)
    assert float(many["peak_error"][0]) == pytest.approx(np.linalg.norm(one.dataset["error"], axis=1).max(), rel=1e-9)


def test_members_are_the_runs_of_simulate():
    kp, kv = np.linspace(2e4, 2e5, 21), np.linspace(1e3, 4e3, 21)
    many = flexopt.simulate_ensemble(EXCAVATOR, POSTURE_B, vary={"offset": OFFSETS, "kp": kp, "kv": kv}).dataset
    for k in (0, 7, 20):
        one = flexopt.simulate(EXCAVATOR, POSTURE_B, offset=OFFSETS[k], kp=kp[k], kv=kv[k])
        assert bool(many["grows"][k]) == (one.verdict == "grows")
        # Windows of an ensemble hold several samples, so periods begin a few samples apart.
        assert float(many["growth_rate"][k]) == pytest.approx(one.growth_rate, abs=3e-3)
        assert float(many["end_error"][k]) == pytest.approx(one.end_error, abs=1e-10)
        assert float(many["peak_base_rotation"][k]) == pytest.approx(one.peak_base_rotation, abs=1e-4)
        settled = float(many["settling_time"][k])
        assert (
            math.isnan(settled) if one.settling_time is None else settled == pytest.approx(one.settling_time, abs=0.05)
        )


def test_trajectories_of_members():
    kept = flexopt.simulate_ensemble(EXCAVATOR, POSTURE_B, vary={"offset": OFFSETS}, keep="trajectories", duration=2.0)
    one = flexopt.simulate(EXCAVATOR, POSTURE_B, offset=OFFSETS[5], duration=2.0)
    for name in ("q", "v", "end_point", "error", "torque", "energy"):
        member = kept.dataset[name][5].to_numpy()
        size = np.abs(getattr(one, name)).max()
        assert np.abs(member - getattr(one, name)).max() <= 1e-10 * size
    assert kept.dataset["time"].to_numpy() == pytest.approx(one.time)


def test_what_was_measured_before_the_start_is_of_the_member():
    """At rest a late measurement is the same as one in time."""
    options = {"vary": {"stick.length": [1.097, 1.2]}, "kp": 1e4, "kv": 1e3, "duration": 0.05, "keep": "trajectories"}
    now, late = (
        flexopt.simulate_ensemble(EXCAVATOR, POSTURE_B, **options, sensor={"delay": delay}).dataset["torque"].to_numpy()
        for delay in (0.0, 0.02)
    )
    np.testing.assert_allclose(late[:, 0], now[:, 0], rtol=1e-9)
    assert abs(now[0, 0, 0] - now[1, 0, 0]) > 100.0


def damped():
    """The excavator, whose base comes to rest within seconds."""
    data = EXCAVATOR.to_dict()
    data["base"] |= {"damping": {name: 300.0 * value for name, value in data["base"]["damping"].items()}}
    return machine_from_dict(data)


def test_members_that_hang_elsewhere_come_to_rest():
    """Softer springs let the base hang lower: bent without moving, which is neither growth nor decay."""
    options = {"gravity": True, "kp": 3e4, "kv": 3e3, "duration": 40.0, "integrator": "gauss"}
    factors, springs = np.array([0.6, 1.0, 1.5]), EXCAVATOR.to_dict()["base"]["stiffness"]
    vary = {f"base.stiffness.{name}": factors * value for name, value in springs.items()}
    found = flexopt.simulate_ensemble(damped(), POSTURE_B, vary=vary, **options)
    assert found.verdict.tolist() == ["converges"] * 3
    # Faster motions have their share in what is seen before the base stands still.
    rates = found.dataset["growth_rate"].to_numpy()
    assert ((2 * found.linear_growth_rate < rates) & (rates < 0.8 * found.linear_growth_rate)).all()


def test_a_machine_that_moves_under_its_weight_comes_to_rest():
    """Its base hangs elsewhere once the arm has gone to another target."""
    machine = damped()
    x, y = flexopt.evaluate(machine, POSTURE_B, gravity=True).end_point.tolist()
    path = {"times": [0.0, 2.0], "points": [[x, y], [x - 0.4, y + 0.3]]}
    run = flexopt.simulate(
        machine, POSTURE_B, gravity=True, kp=3e4, kv=3e3, target_path=path, duration=40.0, integrator="gauss"
    )
    assert run.verdict == "converges"
    assert 2 * run.linear_growth_rate < run.growth_rate < 0.8 * run.linear_growth_rate


def test_dead_times_vary_within_a_sample():
    """Up to a whole one; each is the run of its own, and its eigenvalues those of its own loop."""
    delays, options = [0.0051, 0.0073, 0.01], {"kp": 1e4, "kv": 1e3, "duration": 1.0, "integrator": "gauss"}
    many = flexopt.simulate_ensemble(EXCAVATOR, POSTURE_B, vary={"delay": delays}, keep="trajectories", **options)
    for k, delay in enumerate(delays):
        one = flexopt.simulate(EXCAVATOR, POSTURE_B, sensor={"delay": delay}, **options)
        # Of other steps: what is left is the integrator's error.
        np.testing.assert_allclose(many.dataset["error"][k], one.error, atol=1e-8)
        assert many.linear_growth_rate[k] == pytest.approx(one.linear_growth_rate, abs=1e-10)
    with pytest.raises(InputError, match=r"vary\['delay'\] = 1 to 2 samples: must be as many samples of 0.005 s"):
        flexopt.simulate_ensemble(EXCAVATOR, POSTURE_B, vary={"delay": [0.001, 0.006]}, **options)
    with pytest.raises(InputError, match=r"vary\['delay'\].*must not be negative"):
        flexopt.simulate_ensemble(EXCAVATOR, POSTURE_B, vary={"delay": [-0.001]}, **options)
    with pytest.raises(InputError, match=r"vary\['delay'\] = 0.502: must be at most 100 samples"):
        flexopt.simulate_ensemble(EXCAVATOR, POSTURE_B, vary={"delay": [0.502]}, **options)
    assert "sensor" not in many.provenance["options"]


def test_where_arms_with_a_self_motion_end():
    """The last of their trajectories, under loads that draw them off; of other arms none is kept."""
    machine, posture = flexopt.load("boom-stick-bucket"), (-1.2, -1.5, -0.8)
    options = {"vary": {"payload.mass": [650.0, 1350.0]}, "gravity": True, "duration": 0.5, "kp": 1e4, "kv": 1e3}
    ran = flexopt.simulate_ensemble(machine, posture, keep="trajectories", **options)
    angles = ran.dataset["q"].isel(time=-1).transpose("member", ...).to_numpy()[:, -3:]
    assert np.abs(np.diff(angles, axis=0)).max() > 1e-3
    np.testing.assert_allclose(ran.last_postures, angles, rtol=0, atol=1e-12)
    assert flexopt.simulate_ensemble(EXCAVATOR, POSTURE_B, vary={"offset": OFFSETS}, duration=0.1).last_postures is None


def test_members_start_in_the_same_posture_whatever_varies():
    """On a base that cannot turn, too, whose angle at rest then varies."""
    base = EXCAVATOR.to_dict()["base"] | {"stiffness": {"x": 4e7}, "damping": {"x": 50.0}}
    rigid = machine_from_dict(EXCAVATOR.to_dict() | {"base": base})
    angles = {"base.rest_angle": [1.2451, 1.0]}
    kept = flexopt.simulate_ensemble(rigid, POSTURE_B, vary=angles, duration=0.01, keep="trajectories").dataset
    np.testing.assert_allclose(kept["q"].to_numpy()[:, 0, 1:] - POSTURE_B, [[0.05, -0.05]] * 2, atol=1e-12)
    other = machine_from_dict(EXCAVATOR.to_dict() | {"base": base | {"rest_angle": 1.0}})
    alone = flexopt.simulate(other, POSTURE_B, duration=0.01)
    np.testing.assert_allclose(kept["end_point"].to_numpy()[1, 0], alone.end_point[0], rtol=1e-12)


def test_noise_ends_with_the_last_sample():
    """As of one run: the torques at the end are those of the end-point as it is."""
    options = {"kp": 1e4, "kv": 0.0, "sensor": {"noise": 1e-3}, "duration": 0.05}
    noisy = flexopt.simulate_ensemble(
        EXCAVATOR, POSTURE_B, vary={"offset": OFFSETS[:2]}, keep="trajectories", **options
    )
    for q, error, torque in zip(
        *(noisy.dataset[name].to_numpy()[:, -1] for name in ("q", "error", "torque")), strict=True
    ):
        plant = flexopt.build_plant(EXCAVATOR)
        known = np.concatenate([plant.rest([0.0], POSTURE_B, plant.parameter_values).full().ravel()[:3], q[3:]])
        jacobian = plant.rigid_jacobian(known, [0.0], plant.parameter_values).full()
        np.testing.assert_allclose(torque, np.linalg.solve(jacobian, 1e4 * error), rtol=1e-9)


def test_parameters_vary_the_machine_and_not_the_controller():
    masses = np.array([0.0, 150.0, 900.0])
    many = flexopt.simulate_ensemble(EXCAVATOR, POSTURE_B, vary={"payload.mass": masses}, keep="trajectories").dataset
    for k, mass in enumerate(masses):
        # The Jacobian knows no mass, so the controller is the same.
        one = flexopt.simulate(with_payload(mass), POSTURE_B)
        assert np.abs(many["q"][k].to_numpy() - one.q).max() < 1e-10
    lengths = flexopt.simulate_ensemble(
        EXCAVATOR, POSTURE_B, vary={"stick.length": [1.097, 1.2]}, duration=1.0, keep="trajectories"
    ).dataset
    # The target stays that of the machine in hand, so a longer stick begins with an error of its own.
    assert np.abs(lengths["error"][1, 0] - lengths["error"][0, 0]).max() > 0.05


@pytest.mark.parametrize("options", [{}, {"sensor": {"noise": 1e-3, "delay": 0.01}, "seed": 5}], ids=["exact", "noisy"])
def test_grouping_and_threads_do_not_matter(options, monkeypatch):
    vary = {"offset": OFFSETS}
    one = flexopt.simulate_ensemble(EXCAVATOR, POSTURE_B, vary=vary, threads=1, duration=2.0, **options)
    monkeypatch.setattr("flexopt.simulation.ensemble.GROUP", 3)
    done: list[tuple[int, int]] = []
    two = flexopt.simulate_ensemble(
        EXCAVATOR, POSTURE_B, vary=vary, threads=2, duration=2.0, progress=lambda *now: done.append(now), **options
    )
    xr.testing.assert_identical(one.dataset, two.dataset)
    assert done == [(min(6 * k, 21), 21) for k in range(1, 5)]


def test_start_states():
    deflection, rates = np.array([[1e-3, 0.0, 0.01], [0.0, 0.0, 0.0]]), np.array([[0.0] * 5, [0.0, 0.0, 0.1, 0.0, 0.2]])
    vary = {"deflection": deflection, "rates": rates, "offset": np.zeros((2, 2))}
    start = flexopt.simulate_ensemble(EXCAVATOR, POSTURE_A, vary=vary, keep="trajectories", duration=0.1).dataset
    rest = np.array([0.0, 0.0, 1.2451, *POSTURE_A])
    assert start["q"][0, 0].to_numpy() == pytest.approx(rest + np.array([1e-3, 0.0, 0.01, 0.0, 0.0]), abs=1e-15)
    assert start["v"][1, 0].to_numpy() == pytest.approx(rates[1], abs=1e-15)


def test_divergence_of_one_member_leaves_the_others_alone():
    kp = np.array([1e5, 1e12, 1e5])
    many = flexopt.simulate_ensemble(EXCAVATOR, POSTURE_B, vary={"kp": kp}).dataset
    assert many["grows"].to_numpy().tolist() == [False, True, False]
    assert many["finite_until"].to_numpy()[1] < 10.0
    assert float(many["end_error"][0]) == float(many["end_error"][2])
    assert math.isinf(float(many["end_error"][1]))


def test_a_member_that_outgrows_the_implicit_integrator_is_told_and_the_others_kept():
    """The machine of `simulate`'s own test, beside a member that settles: each is the run that it would be alone."""
    how = {"integrator": "gauss", "kv": 2e4, "rate": 50.0, "duration": 3.0}
    vary = {"kp": np.array([1e4, 1e6, 2e6])}
    told = r"2 members grew beyond what the implicit integrator follows at .* member 2 first; what follows"
    for keep in ("measures", "trajectories"):
        with pytest.warns(FlexoptWarning, match=told):
            many = flexopt.simulate_ensemble(EXCAVATOR, POSTURE_A, vary=vary, keep=keep, **how)
        for k, kp in enumerate(vary["kp"]):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", FlexoptWarning)
                one = flexopt.simulate(EXCAVATOR, POSTURE_A, kp=kp, **how)
            assert many.verdict[k] == one.verdict
            assert many.dataset["finite_until"][k] == one.run.ended
            assert many.dataset["end_error"][k] == pytest.approx(math.inf if one.end_error is None else one.end_error)
            if keep == "trajectories":
                np.testing.assert_allclose(many.dataset["q"][k], one.q, rtol=1e-6, atol=1e-9)
    assert many.verdict.tolist()[1:] == ["grows", "grows"]


def test_a_member_that_the_iterations_do_not_follow_and_that_does_not_grow_is_an_error():
    with pytest.raises(NoSolutionFound, match="more substeps"):
        flexopt.simulate_ensemble(
            EXCAVATOR, POSTURE_B, vary={"kp": [1e5, 1e7]}, hold=False, integrator="gauss", kv=2e5, duration=0.5
        )


def test_summary_and_file(tmp_path):
    ensemble = flexopt.simulate_ensemble(EXCAVATOR, POSTURE_B, vary={"kp": [1e5, 1e12]})
    document = json.loads(json.dumps(ensemble.to_dict(), allow_nan=False))
    assert document["members"] == 2
    assert document["growing"] == 0.5
    assert "50.0 % grow" in repr(ensemble)
    ensemble.to_netcdf(tmp_path / "e.nc")
    with xr.open_dataset(tmp_path / "e.nc") as back:
        assert back["grows"].to_numpy().tolist() == [0, 1]
        assert back["kp"].to_numpy().tolist() == [1e5, 1e12]


BAD = [
    ({}, "must be a dictionary"),
    (None, "must be a dictionary"),
    ({"kq": [1.0]}, "is not something that varies"),
    ({"kp": [1.0, math.nan]}, "is not at [1]"),
    ({"kp": [-1.0]}, "must not be negative"),
    ({"ki": [1.0]}, 'goes with feedback = "pid"'),
    ({"kp": []}, "must have the shape"),
    ({"kp": "many"}, "must be numbers"),
    ({"offset": [[0.1, 0.2, 0.3]]}, "(members, 2)"),
    ({"offset": [[0.1, 0.2]], "kp": [1.0, 2.0]}, "one number of members"),
    ({"payload.mass": [-1.0]}, "must not be negative"),
    ({"payload.mass": [1e12]}, "must be at most"),
    ({"boom.mass": [0.0]}, "greater than 0 kg"),
    ({"base.stiffness.x": [math.inf]}, "must be finite"),
]


@pytest.mark.parametrize(("vary", "message"), BAD, ids=lambda x: str(x)[:30])
def test_bad_input(vary, message):
    with pytest.raises(InputError, match="simulate_ensemble") as caught:
        flexopt.simulate_ensemble(EXCAVATOR, POSTURE_B, vary=vary)
    assert message in str(caught.value)


def test_all_faults_at_once():
    with pytest.raises(InputError) as caught:
        flexopt.simulate_ensemble(EXCAVATOR, POSTURE_B, vary={"kp": [-1.0], "kz": [1.0]}, keep="all", threads=0)
    assert len(caught.value.faults) == 4


def test_samples_that_would_fill_the_memory_are_refused():
    vary = {"offset": np.zeros((100_000, 2))}
    with pytest.raises(FlexoptError, match="GB"):
        flexopt.simulate_ensemble(EXCAVATOR, POSTURE_B, vary=vary, keep="trajectories")
