"""The nullspace law: where it leads from the article's posture A, what it never does, and its step against NumPy's SVD."""

import json
import math

import casadi as ca
import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import flexopt
from flexopt.selection.nullspace import law
from flexopt.selection.nullspace.base_trajectory import Stop
from tests.oracles.machines import arm_at_rest, machines, regular_posture, seeds

TARGET = (0.0, 1.6)
SHOULDER = 0.541 * math.cos(1.2451)
CONTROLS = pytest.mark.parametrize("control", ["inverse", "transpose"])
# Random machines may have frequencies that meet, or leave ε_max unsolved: nothing here is about that.
QUIET = pytest.mark.filterwarnings("ignore::flexopt.errors.FlexoptWarning")


@pytest.fixture(scope="module")
def machine():
    return flexopt.load("excavator")


@pytest.fixture(scope="module")
def posture_a(machine):
    return flexopt.inverse_kinematics(machine, TARGET, base=0.0, elbow="up")[0]


@pytest.fixture(scope="module")
def unlimited(machine, posture_a):
    return flexopt.nullspace_trajectory(machine, posture_a)


def base_jacobian(machine, posture, base):
    """∂r/∂[x, joints] from the geometry: each joint turns the end-point about itself."""
    joints, tip = arm_at_rest(machine, posture, base)
    arms = tip - joints
    return np.column_stack([[1.0, 0.0], np.column_stack([-arms[:, 1], arms[:, 0]]).T])


def off_target(machine, trajectory):
    """Distance of the end-point from where it shall stay, from the geometry alone, at every sample."""
    tips = [arm_at_rest(machine, q, b[0])[1] for q, b in zip(trajectory.posture, trajectory.base, strict=True)]
    return np.linalg.norm(np.array(tips) - trajectory.target, axis=1)


def check_consistent(trajectory, rate=200.0):
    """What holds of every trajectory."""
    np.testing.assert_allclose(np.diff(trajectory.time), 1 / rate, rtol=1e-9)
    moved = trajectory.base[:-1] + trajectory.base_rate[:-1] / rate
    np.testing.assert_allclose(moved, trajectory.base[1:], rtol=0, atol=1e-14 * (1 + np.abs(trajectory.base).max()))
    assert np.all(trajectory.base_rate[-1] == 0)
    assert trajectory.end_point_error.max() <= 1e-9


@pytest.mark.long
def test_from_a_it_climbs_to_the_optimum_that_theory_names(machine, posture_a, unlimited):
    check_consistent(unlimited)
    np.testing.assert_allclose(unlimited.target, TARGET, atol=1e-14)
    np.testing.assert_array_equal(unlimited.posture[0], posture_a)
    assert unlimited.stop is Stop.GAIN
    assert -unlimited.base[-1, 0] - SHOULDER == pytest.approx(2.145, abs=0.005)
    assert unlimited.V[0] == pytest.approx(-0.29635e-3, rel=1e-4)
    assert -1e-10 < unlimited.V[-1] <= 0
    assert np.all(np.diff(unlimited.V) >= 0)
    assert unlimited.descents == ()
    assert np.all(unlimited.prediction >= 0)
    assert off_target(machine, unlimited).max() <= 1e-12
    speeds = np.abs(unlimited.base_rate[:, 0])
    assert 0.25 - 1e-9 <= speeds.max() <= 0.25 + 1e-9
    assert unlimited.final.w[0] == pytest.approx(unlimited.V[-1], rel=1e-9)
    np.testing.assert_array_equal(unlimited.final.base, unlimited.base[-1])


@pytest.mark.long
def test_values_and_gradients_are_those_of_evaluate(machine, unlimited):
    for k in (0, 700, 1500, unlimited.time.size - 1):
        e = flexopt.evaluate(machine, unlimited.posture[k], base=unlimited.base[k])
        assert unlimited.V[k] == pytest.approx(e.w[0], rel=1e-10)
        np.testing.assert_allclose(unlimited.gradient[k], e.gradient.w[0], rtol=1e-8, atol=1e-14)


@pytest.mark.long
@CONTROLS
def test_the_end_agrees_with_select_and_with_scipy(machine, posture_a, control):
    end = flexopt.nullspace_trajectory(machine, posture_a, control=control, min_gain=0.0, duration=30.0)
    x = end.base[-1, 0]
    candidates = flexopt.select(machine, TARGET, control=control).candidates
    nearest = min(candidates, key=lambda c: abs(c.evaluation.base[0] - x))
    assert nearest.evaluation.base[0] == pytest.approx(x, abs=1e-5)
    np.testing.assert_allclose(nearest.evaluation.posture, end.posture[-1], atol=1e-5)

    def loss(x):
        posture = flexopt.inverse_kinematics(machine, TARGET, base=float(x), elbow="up")[0]
        return -flexopt.evaluate(machine, posture, base=float(x), control=control).w[0]

    found = scipy.optimize.minimize_scalar(loss, bounds=(x - 0.1, x + 0.1), method="bounded", options={"xatol": 1e-8})
    assert found.x == pytest.approx(x, abs=1e-5)


@pytest.mark.long
def test_the_base_stops_exactly_at_the_end_of_its_range(machine, posture_a, unlimited):
    limited = flexopt.nullspace_trajectory(machine, posture_a, base_range=(-1.5, 1.0))
    check_consistent(limited)
    assert limited.stop is Stop.BASE_RANGE
    assert limited.base[-1, 0] == -1.5
    assert limited.base.min() == -1.5
    n = limited.time.size - 1
    np.testing.assert_array_equal(limited.base[:n], unlimited.base[:n])
    again = flexopt.nullspace_trajectory(machine, limited.posture[-1], base=-1.5, base_range=(-1.5, 1.0))
    assert again.time.size == 1
    assert again.stop is Stop.BASE_RANGE


@pytest.mark.long("freely", "range", "duration")
@pytest.mark.parametrize(
    "stopped",
    [{}, {"base_range": (-1.5, 1.0)}, {"duration": 5.0}, {"duration": 0.004}],
    ids=["freely", "range", "duration", "at once"],
)
def test_with_an_acceleration_limit_it_starts_and_ends_at_rest(machine, posture_a, unlimited, stopped):
    limit, rate = 0.1, 200.0
    free = flexopt.nullspace_trajectory(machine, posture_a, **stopped)
    timed = flexopt.nullspace_trajectory(machine, posture_a, max_base_acceleration=limit, **stopped)
    check_consistent(timed)
    speeds = np.concatenate([[0.0], timed.base_rate[:, 0]])
    # Differences of x, of size 2.5, divided twice by 5 ms.
    assert np.abs(np.diff(speeds)).max() * rate <= limit + 1e-10
    assert np.abs(speeds).max() <= 0.25 + 1e-12
    assert np.all(np.diff(timed.V) >= 0)
    assert timed.time[-1] <= stopped.get("duration", 60.0)
    if "duration" in stopped:
        assert timed.stop is Stop.DURATION
    else:
        assert timed.stop is free.stop
        np.testing.assert_array_equal(timed.base[-1], free.base[-1])
        assert timed.time[-1] > free.time[-1]
    if stopped == {"base_range": (-1.5, 1.0)}:
        # The law is faster than the base all the way, so the profile is a trapezium.
        assert timed.time[-1] == pytest.approx(1.5 / 0.25 + 0.25 / limit, abs=1 / rate)


def test_duration_and_rate(machine, posture_a):
    short = flexopt.nullspace_trajectory(machine, posture_a, duration=0.5, rate=50.0, max_base_rate=0.1)
    check_consistent(short, 50.0)
    assert short.stop is Stop.DURATION
    assert short.time.size == 26
    assert np.abs(short.base_rate).max() <= 0.1 + 1e-12
    slow = flexopt.nullspace_trajectory(machine, posture_a, duration=0.5, max_joint_rate=0.02)
    # The correction adds what the path bends within a sample.
    assert np.abs(np.diff(slow.posture, axis=0)).max() * 200 == pytest.approx(0.02, rel=1e-3)


@pytest.mark.long
def test_joint_limits(machine, posture_a):
    data = machine.to_dict()
    boom, stick = data["links"]
    limited = flexopt.machine_from_dict(data | {"links": [boom, stick | {"limits": [-2.7, -2.0]}]})
    trajectory = flexopt.nullspace_trajectory(limited, posture_a)
    assert trajectory.stop is Stop.JOINT_LIMIT
    assert -2.0 - 1e-5 <= trajectory.posture[-1, 1] <= -2.0
    assert trajectory.posture[:, 1].max() <= -2.0


def test_it_stops_near_singular_postures(machine):
    start = flexopt.inverse_kinematics(machine, TARGET, base=-2.7, elbow="up")[0]
    downhill = (-1e4 * np.eye(3)).tolist()
    for margin in (10.0, 20.0):
        trajectory = flexopt.nullspace_trajectory(
            machine, start, base=-2.7, step_gain=downhill, on_descent="continue", singularity_margin_deg=margin
        )
        assert trajectory.stop is Stop.SINGULAR
        assert abs(trajectory.posture[-1, 1]) == pytest.approx(math.radians(margin), abs=1e-4)
        assert abs(trajectory.posture[-1, 1]) >= math.radians(margin)


def test_a_matrix_gain_that_descends_is_seen_before_the_step(machine, posture_a):
    """One coordinate's gain alone, the others 0, is a positive semidefinite matrix; for one of them the step turns round."""
    e = flexopt.evaluate(machine, posture_a)
    projector = scipy.linalg.null_space(base_jacobian(machine, posture_a, 0.0))
    downhill = next(
        gain for gain in np.eye(3) * 1e3
        if e.gradient.w[0] @ projector @ projector.T @ (gain * e.gradient.w[0]) < 0
    )  # fmt: skip
    stopped = flexopt.nullspace_trajectory(machine, posture_a, step_gain=downhill.tolist())
    assert stopped.stop is Stop.DESCENDS
    assert stopped.time.size == 1
    assert stopped.prediction[0] < 0
    assert stopped.descents == ()
    forced = flexopt.nullspace_trajectory(
        machine, posture_a, step_gain=np.diag(downhill), on_descent="continue", duration=0.5
    )
    check_consistent(forced)
    assert [d.index for d in forced.descents] == np.flatnonzero(np.diff(forced.V) < 0).tolist()
    # 0.25 m/s for 0.15 s; the minimum of V lies 0.05 m from A.
    assert [d.index for d in forced.descents[:30]] == list(range(30))
    for descent in forced.descents:
        assert descent.predicted
        assert descent.amount == forced.V[descent.index] - forced.V[descent.index + 1] > 0


def test_a_matrix_that_is_a_multiple_of_the_identity_is_a_scalar(machine, posture_a):
    options = {"duration": 0.5}
    scalar = flexopt.nullspace_trajectory(machine, posture_a, step_gain=3.0, **options)
    for same in ([3.0, 3.0, 3.0], (3.0 * np.eye(3)).tolist(), 3.0 * np.eye(3)):
        other = flexopt.nullspace_trajectory(machine, posture_a, step_gain=same, **options)
        np.testing.assert_array_equal(other.base, scalar.base)


def test_a_metric_is_a_change_of_unit(machine, posture_a):
    """One degree of redundancy: the path is the same, only the speed differs, by what the metric makes of ∇V."""
    heavy = flexopt.nullspace_trajectory(machine, posture_a, step_gain=10.0, metric=[4.0, 1.0, 1.0], duration=0.1)
    plain = flexopt.nullspace_trajectory(machine, posture_a, step_gain=10.0, duration=0.1)
    jacobian = base_jacobian(machine, posture_a, 0.0)
    tangent = scipy.linalg.null_space(jacobian)[:, 0]
    weighted = tangent / math.sqrt(tangent @ np.diag([4.0, 1.0, 1.0]) @ tangent)
    expected = (weighted @ heavy.gradient[0]) ** 2 / (tangent @ plain.gradient[0]) ** 2
    assert heavy.prediction[0] / plain.prediction[0] == pytest.approx(expected, rel=1e-9)
    assert heavy.base_rate[0, 0] / plain.base_rate[0, 0] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("speed", [0.15, 0.2, 0.25, 0.31])
def test_too_long_steps_are_shortened_and_never_pass_the_top(machine, unlimited, speed):
    """The last full step would land anywhere within a step of the top, on either side."""
    wild = flexopt.nullspace_trajectory(
        machine, unlimited.posture[2000], base=unlimited.base[2000], step_gain=1e9, max_base_rate=speed
    )
    check_consistent(wild)
    assert wild.stop in (Stop.GAIN, Stop.SUMMIT)
    assert np.all(np.diff(wild.V) >= 0)
    steps = np.diff(np.hstack([wild.base, wild.posture]), axis=0)
    # Slopes near the top are of 1e-8 per m, steps of 1e-3 m; rounding is far below.
    assert np.sum(steps * wild.gradient[1:], axis=1).min() >= -1e-18
    assert wild.base[-1, 0] == pytest.approx(unlimited.base[-1, 0], abs=0.005)


@pytest.mark.long
def test_epsilon_max_climbs_to_its_nearest_maximum(machine, posture_a):
    trajectory = flexopt.nullspace_trajectory(machine, posture_a, objective="epsilon_max")
    check_consistent(trajectory)
    assert np.all(np.diff(trajectory.V) >= 0)
    assert trajectory.V[0] == pytest.approx(0.28655, abs=1e-4)
    assert trajectory.final.epsilon_max == pytest.approx(trajectory.V[-1], rel=1e-9)
    x = trajectory.base[-1, 0]

    def loss(x):
        posture = flexopt.inverse_kinematics(machine, TARGET, base=float(x), elbow="up")[0]
        return -flexopt.evaluate(machine, posture, base=float(x)).epsilon_max

    found = scipy.optimize.minimize_scalar(loss, bounds=(x - 0.005, x + 0.005), method="bounded")
    # min_gain stops it where V is within about a millionth of the maximum.
    assert found.x == pytest.approx(x, abs=2e-3)
    assert -found.fun == pytest.approx(trajectory.V[-1], abs=1e-6)


def test_a_kink_of_epsilon_max_stops_it(machine, posture_a, monkeypatch):
    """V = min of two branches that cross along the path: the law comes to the crossing and says so."""
    crossing = -0.3
    base, posture = ca.SX.sym("base"), ca.SX.sym("posture", 2)
    height = ca.fabs(base - crossing)
    slope = ca.horzcat(-ca.sign(base - crossing), 0, 0)
    tent = ca.Function(
        "tent",
        [base, posture, ca.SX.sym("p", len(machine.parameters)), ca.SX.sym("kr")],
        [ca.vertcat(0.3 - height, 0.3 + height), ca.vertcat(slope, -slope)],
    )
    monkeypatch.setattr(law, "_margin_gradients", lambda *key: tent)
    trajectory = flexopt.nullspace_trajectory(machine, posture_a, objective="epsilon_max")
    assert trajectory.stop is Stop.KINK
    assert trajectory.base[-1, 0] == pytest.approx(crossing, abs=1e-5)
    assert np.all(np.diff(trajectory.V) >= 0)


def test_weighted_sum_and_gravity(machine, posture_a):
    weights = (1.0, 0.5, 0.0, 1e-3)
    mixed = flexopt.nullspace_trajectory(machine, posture_a, objective="V", weights=weights, duration=2.0)
    e = mixed.final
    assert mixed.V[-1] == pytest.approx(e.w[0] + 0.5 * e.w[1] + 1e-3 * e.epsilon_max, rel=1e-9)
    assert np.all(np.diff(mixed.V) >= 0)
    loaded = flexopt.nullspace_trajectory(machine, posture_a, gravity=True, duration=2.0)
    check_consistent(loaded)
    np.testing.assert_allclose(loaded.final.end_point, loaded.target, atol=1e-9)
    assert np.linalg.norm(loaded.target - TARGET) > 1e-4


@pytest.mark.long
def test_far_from_the_origin(machine, posture_a, unlimited):
    far = flexopt.nullspace_trajectory(machine, posture_a, base=1000.0)
    assert far.end_point_error.max() <= 1e-9
    assert far.base[-1, 0] - 1000.0 == pytest.approx(unlimited.base[-1, 0], abs=1e-6)


@pytest.mark.long
def test_the_document(machine, unlimited):
    document = unlimited.to_dict()
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert document["stop"] == "gain"
    assert document["status"] == unlimited.stop.value
    assert len(document["base"]) == len(document["time"]) == unlimited.time.size
    options = document["provenance"]["options"]
    # What was left to its default is written down as the number that was used.
    same = flexopt.nullspace_trajectory(
        machine,
        options["posture"],
        step_gain=options["step_gain"],
        min_gain=options["min_gain"],
        duration=options["duration"],
    )
    np.testing.assert_array_equal(same.posture, unlimited.posture)
    text = repr(unlimited)
    assert "objective w1" in text
    assert unlimited.status in text


@pytest.mark.long
@QUIET
@settings(max_examples=10, derandomize=True)
@given(
    made=machines(structure={"n_min": 2, "n_max": 4}),
    seed=seeds,
    control=st.sampled_from(["inverse", "transpose"]),
    weighted=st.booleans(),
)
def test_the_step_is_that_of_an_svd_projector(made, seed, control, weighted):
    _, machine = made
    rng = np.random.default_rng(seed)
    posture, base = regular_posture(rng, machine), float(rng.uniform(-1.0, 1.0))
    gain = rng.normal(size=(posture.size + 1,) * 2)
    metric = rng.uniform(0.2, 5.0, posture.size + 1) if weighted else np.ones(posture.size + 1)
    evaluation = flexopt.evaluate(machine, posture, base=base, control=control)
    gradient = evaluation.gradient.w[0]
    # Of a mode that the end-point does not see there is nothing to climb.
    assume(np.linalg.norm(gradient) > 1e-9 * np.linalg.norm(evaluation.rigid_residue))
    root = np.sqrt(metric)
    basis = scipy.linalg.null_space(base_jacobian(machine, posture, base) / root)
    assert basis.shape[1] == posture.size - 1
    step = basis @ basis.T @ gain @ (gradient / root) / root
    # Small enough for the correction, which is of second order, to be a millionth of it.
    gain *= 1e-6 / np.linalg.norm(step)
    step *= 1e-6 / np.linalg.norm(step)
    trajectory = flexopt.nullspace_trajectory(
        machine, posture, base=base, control=control, step_gain=gain.tolist(), metric=metric.tolist(),
        duration=0.005, on_descent="continue", min_gain=0.0, singularity_margin_deg=0.01,
    )  # fmt: skip
    size = np.linalg.norm(gradient) * np.linalg.norm(gain @ (gradient / root) / root)
    assert trajectory.prediction[0] == pytest.approx(gradient @ step, abs=1e-9 * size)
    if trajectory.time.size == 2:
        # The whole step, or one that was halved because V has a maximum on the way.
        moved = np.concatenate([trajectory.base[1] - base, trajectory.posture[1] - posture])
        share = np.linalg.norm(moved) / 1e-6
        assert min(abs(share - 2.0**-k) for k in range(11)) < 1e-3 * share
        np.testing.assert_allclose(moved / share, step, atol=1e-9)


@pytest.mark.long
@QUIET
@settings(max_examples=6, derandomize=True)
@given(
    made=machines(structure={"n_min": 3, "n_max": 4, "passive_joints": False}),
    seed=seeds,
    control=st.sampled_from(["inverse", "transpose"]),
)
def test_a_scalar_gain_never_descends_and_keeps_every_limit(made, seed, control):
    """Redundant arms: two degrees of redundancy and more."""
    _, machine = made
    posture = regular_posture(np.random.default_rng(seed), machine)
    trajectory = flexopt.nullspace_trajectory(
        machine, posture, control=control, base_range=(-0.02, 0.03), duration=0.3, singularity_margin_deg=0.1
    )
    check_consistent(trajectory)
    assert off_target(machine, trajectory).max() <= 1e-9
    assert np.all(np.diff(trajectory.V) >= 0)
    assert trajectory.descents == ()
    assert np.abs(trajectory.base_rate).max() <= 0.25 + 1e-9
    assert trajectory.base.min() >= -0.02
    assert trajectory.base.max() <= 0.03
    if trajectory.stop is Stop.BASE_RANGE:
        assert trajectory.base[-1, 0] in (-0.02, 0.03)
    limited = flexopt.nullspace_trajectory(
        machine, posture, control=control, base_range=(-0.02, 0.03), duration=0.3, singularity_margin_deg=0.1,
        max_base_acceleration=0.5,
    )  # fmt: skip
    check_consistent(limited)
    speeds = np.concatenate([[0.0], limited.base_rate[:, 0]])
    assert np.abs(np.diff(speeds)).max() * 200 <= 0.5 + 1e-8
    assert limited.time[-1] <= 0.3


def test_every_fault_is_named_at_once(machine):
    with pytest.raises(flexopt.InputError) as caught:
        flexopt.nullspace_trajectory(
            machine, [0.9, float("nan")], base=2.0, objective="w7", control="sideways", gain=-1.0, gravity=1,
            step_gain=[1.0, 2.0], metric=[1.0, 0.0, 1.0], rate=0.0, max_base_rate=-0.1, max_joint_rate=float("inf"),
            max_base_acceleration=0.0, base_range=(-1.0, 1.0), singularity_margin_deg=90.0, min_gain=-1.0,
            duration="long", on_descent="jump",
        )  # fmt: skip
    fields = {fault.field for fault in caught.value.faults}
    assert fields == {
        "posture (stick)", "base", "objective", "control", "gain", "gravity", "step_gain", "metric", "rate",
        "max_base_rate", "max_joint_rate", "max_base_acceleration", "singularity_margin_deg", "min_gain", "duration",
        "on_descent",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"step_gain": 0.0}, "step_gain"),
        ({"step_gain": -2.0}, "step_gain"),
        ({"step_gain": True}, "step_gain"),
        ({"step_gain": "fast"}, "step_gain"),
        ({"step_gain": [0.0, 0.0, 0.0]}, "nothing would move"),
        ({"step_gain": [1.0, float("nan"), 1.0]}, "boom must be finite"),
        ({"step_gain": [[1.0, 0.0], [0.0, 1.0]]}, "3 rows of 3"),
        ({"step_gain": [[1.0, 0.0, 0.0], [0.0, 1.0], [0.0, 0.0, 1.0]]}, "3 rows of 3"),
        ({"step_gain": [[1.0, 0.0, 0.0], 2.0, [0.0, 0.0, 1.0]]}, "3 rows of 3"),
        ({"step_gain": [[1.0, 0.0, 0.0], [0.0, float("inf"), 0.0], [0.0, 0.0, 1.0]]}, "row boom, column boom"),
        ({"metric": [1.0, 1.0]}, "metric"),
        ({"metric": 3.0}, "metric"),
        ({"objective": "w1,epsilon_max"}, "a single one"),
        ({"objective": "V"}, "weights"),
        ({"weights": [1.0, 0.0, 0.0]}, "weights"),
        ({"objective": 3}, "objective"),
        ({"base_range": (1.0, -1.0)}, "base_range"),
        ({"base_range": (0.5, 1.0)}, "must lie in base_range"),
        ({"base": [0.0, 1.0]}, "base"),
        ({"duration": 1e5}, "samples"),
        ({"duration": float("nan")}, "duration"),
        ({"singularity_margin_deg": 35.0}, "closer than 35°"),
    ],
)
def test_bad_inputs(machine, posture_a, options, sentence):
    with pytest.raises(flexopt.InputError, match=sentence):
        flexopt.nullspace_trajectory(machine, posture_a, **options)


@pytest.mark.parametrize("posture", [[0.9], [0.9, -2.0, 0.1], 0.9, "A", [0.9, float("inf")], None])
def test_bad_postures(machine, posture):
    with pytest.raises(flexopt.InputError, match="posture"):
        flexopt.nullspace_trajectory(machine, posture)


def test_singular_start_and_no_machine(machine):
    with pytest.raises(flexopt.SingularPosture, match="bend stick"):
        flexopt.nullspace_trajectory(machine, [0.4, 0.0])
    with pytest.raises(flexopt.InputError, match="must be a Machine"):
        flexopt.nullspace_trajectory("excavator", [0.9, -2.6])
