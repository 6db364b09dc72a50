"""LoopPoint measures of the sampled loop: against balls, nonlinear runs, the simulator's linear loop, and their meaning."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag, solve_discrete_lyapunov

import flexopt
from flexopt.article.loop_findings import _rate_near
from flexopt.loop.assembly import OneSample
from flexopt.loop.disturbance import left_over, summed, summed_to_rounding
from flexopt.loop.outcome import MEASURES, LoopPoint
from flexopt.loop.small_motions import AT_REST, SmallMotions
from flexopt.loop.spectrum import SampledLoop, spectrum
from flexopt.loop.tangent import exponential
from flexopt.selection.outcomes.branches import rates_of
from tests.oracles.late_cases import draw_case, nonlinear_growth, slopes_off
from tests.oracles.late_loop import LateLoop, directional
from tests.oracles.sampled_loop import multipliers
from tests.simulation.loops import EXCAVATOR, POSTURE_A, POSTURE_B

DIGGER, STAND = flexopt.load("slewing-excavator"), (0.2, 0.5, -1.2, -0.5)
THIRD = (0.992, -1.4056)


def outcome(machine, posture, dead_time=0.0, *, kp=1e4, kv=1e3, rate=200.0, control="inverse", ki=0.0, **more):
    """A loop at numbers; flags of `SmallMotions` and further numbers by name."""
    flags = {
        name: more.pop(name)
        for name in ("gravity", "integral", "filtered", "lagging", "damped", "served")
        if name in more
    }
    motions = SmallMotions(machine, control, **flags)
    r = motions.plant.n_task
    numbers = {"posture": posture, "p": motions.plant.parameter_values.full().ravel(), "period": [1 / rate]}
    numbers |= {"kp": np.resize(kp, r), "kv": np.resize(kv, r), "ki": np.resize(ki, r)}
    return LoopPoint(motions, motions.numbers(numbers | more), dead_time)


@pytest.mark.parametrize("number", range(12))
def test_decay_of_random_loops(number):
    """Machines in the plane and in space, dead times that are no multiples of the sample, servos; one of 500."""
    case = draw_case(number)
    ours, other = -case.outcome.decay().value, float(case.oracle.growth())
    assert ours == pytest.approx(other, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("number", [3, 4, 6, 7, 10])
def test_noise_on_the_base_of_random_loops(number):
    """The H2 norm beside 420 bits; those that decay of the like, redundant arms among them."""
    case = draw_case(number)
    measured, other = case.outcome.h2_norm(), float(case.oracle.h2_norm())
    # Loops that hardly decay add up what their rounding leaves.
    assert measured.value == pytest.approx(other, rel=1e-10)
    assert measured.slopes is not None


@pytest.mark.parametrize(
    ("number", "by"),
    # Gains change the norm by 1e-4 of it, and of the base's motion the end-point sees a thousandth. Two slow motions
    # lie close, and of two terms in which masses stand one cancels 99 % of the other.
    [pytest.param(4, "kp", id="hardly seen"), pytest.param(55, "posture", id="slow and close")],
)
def test_slopes_of_the_norm_that_are_small_beside_their_terms(number, by):
    case = draw_case(number)
    found, x = case.outcome.gradient(case.outcome.h2_norm())[by], np.asarray(getattr(case.oracle, by))
    for k, along in enumerate(np.eye(len(x))):
        truth = directional(lambda changed: replace(case.oracle, **changed).h2_norm(), {by: x}, {by: along})
        assert found[k] == pytest.approx(truth, rel=5e-8)


def test_what_a_sum_leaves_over_is_the_same_in_long_doubles_and_in_decimals():
    """And where it is added, more digits of X = A X Aᵀ + G Gᵀ are right than of the sum in doubles."""
    matrix = np.array([[1.0, 0.01, 0.0], [-0.001, 0.9999, 0.02], [0.0, -0.01, 0.999]])
    factor = np.array([[0.0], [1.0], [0.1]])
    rounded = solve_discrete_lyapunov(matrix, factor @ factor.T)
    left = left_over(matrix, factor, rounded, wide=False)
    assert left_over(matrix, factor, rounded) == pytest.approx(left, rel=1e-2, abs=1e-19 * np.abs(rounded).max())
    assert np.abs(left).max() > 0
    corrected = summed_to_rounding(matrix, factor, rounded)
    assert np.abs(left_over(matrix, factor, corrected, wide=False)).max() < 1e-15 * np.abs(rounded).max()


@pytest.mark.parametrize("largest", [1 - 1e-9, 1.0, 1 + 1e-12, 1 + 1e-3])
def test_a_motion_at_the_border_of_stability_has_no_variance(largest: float) -> None:
    """Nor does what overflows on the way there speak on its own."""
    matrix, factor = np.diag([largest, 0.5]), np.eye(2)
    found = summed(matrix, factor)
    if largest < 1:
        assert np.diag(found @ found.T) == pytest.approx([1 / (1 - largest**2), 4 / 3], rel=1e-6)
    else:
        assert np.isnan(found).all()


def test_near_its_border_a_loop_has_no_norm_that_rounding_decides() -> None:
    """The variance is as one over the decay there: a tenth of the way in dead time, ten times of it, until told no more."""
    margin = outcome(EXCAVATOR, POSTURE_B).delay_margin().value
    near = [outcome(EXCAVATOR, POSTURE_B, margin * (1 - off)).h2_norm().value for off in (1e-3, 1e-5, 1e-10, 1e-13)]
    # To first order in what is left of the margin.
    assert near[1] / near[0] == pytest.approx(10, rel=1e-2)
    assert np.isnan(near[2:]).all()


def test_a_loop_at_its_border_is_told_to_be_there() -> None:
    """Not to decay by what rounding makes of nothing, nor to be stable."""
    loop = {"kp": 1e4, "kv": 1e3}
    margin = flexopt.outcome(EXCAVATOR, POSTURE_B, loop=loop).delay_margin
    found = flexopt.outcome(EXCAVATOR, POSTURE_B, loop=loop | {"dead_time": margin})
    assert abs(found.decay) <= found.decay_rounding < 1e-9
    assert "neither decays nor grows to rounding" in repr(found)
    assert "at the border of stability" in repr(outcome(EXCAVATOR, POSTURE_B, margin).loop)
    assert "H2" not in repr(found)


@pytest.mark.parametrize("number", [18, 24])
def test_the_norm_is_told_with_more_doubt_than_it_is_wrong_by(number: int) -> None:
    """Beside 420 bits, of loops that hardly decay, or that the end-point hardly sees."""
    case = draw_case(number)
    point = case.outcome
    found = point.disturbed
    assert found is not None
    assert abs(found.norm / float(case.oracle.h2_norm()) - 1) < found.doubt < 1e-9


def test_variance_of_a_run_with_noise_on_the_base():
    """Samples of a linear loop under random forces, each held over a twentieth of a sample."""
    case, steps, runs = draw_case(7), 20, 200
    here = replace(case.outcome, dead_time=case.outcome.period)
    parts, h, decay = here.parts, here.period / steps, here.decay().value
    of = [here.numbers[name] for name in (*AT_REST, "held")]
    into, settled = here.motions.disturbance.call(of)[0].full(), round(4 / (decay * here.period))
    held, pushed = exponential(parts.flow, np.hstack([parts.drive, into]), h)
    rng, state, squares = np.random.default_rng(0), np.zeros((len(parts.flow), runs)), []
    waiting = [np.zeros((len(parts.force), runs))]
    for k in range(3 * settled):
        waiting.append(parts.force @ (parts.measured @ state))
        command = parts.direct @ state + parts.spread @ waiting.pop(0)
        if k >= settled:
            squares.append(np.sum((parts.measured[: len(parts.measured) // 2] @ state) ** 2, axis=0).mean())
        for _ in range(steps):
            noise = rng.standard_normal((into.shape[1], runs)) / math.sqrt(h)
            state = held @ state + pushed @ np.vstack([command, noise])
    # Some 1,600 independent samples: 2 % of the root.
    assert here.h2_norm().value == pytest.approx(math.sqrt(np.mean(squares)), rel=0.08)


@pytest.mark.parametrize("number", [2, 4, 7, 11])
def test_nonlinear_runs_along_the_slowest_motion(number):
    """A start of 1e-7 m or rad leaves what is nonlinear some 1e-7 of the rate."""
    case = draw_case(number)
    assert nonlinear_growth(case) == pytest.approx(-case.outcome.decay().value, rel=1e-3, abs=1e-4)


@pytest.mark.long
def test_gradients_of_every_measure():
    """Beside differences in balls; of 60 loops `benchmarks.outcome` tells."""
    found = list(slopes_off(draw_case(7), np.random.default_rng(7)))
    assert {by for _, by, _ in found} >= {"posture", "p", "kp", "kv", "dead_time"}
    assert {name for name, _, _ in found} == set(MEASURES) | {"damping_ratio"}
    assert max(off for _, _, off in found) < 1e-7, found


LOOPS = {
    "plain": ({}, {}, {}),
    "weight and servos": (
        {"gravity": True, "actuator": {"bandwidth_hz": [5.0, 9.0]}},
        {"gravity": True, "lagging": True}, {"bandwidth_hz": [5.0, 9.0]},
    ),
    "pid and filter": (
        {"feedback": "pid", "ki": 1e4, "sensor": {"filter_hz": 10.0}},
        {"integral": True, "filtered": True, "ki": 1e4}, {"filter_hz": [10.0]},
    ),
    "transpose": ({"control": "transpose"}, {"control": "transpose"}, {}),
    "damped": ({"control": "damped:0.3"}, {"control": "damped:0.3"}, {}),
}  # fmt: skip


@pytest.mark.parametrize("late", [0.0, 0.0031, 0.005, 0.0213])
@pytest.mark.parametrize("name", list(LOOPS))
def test_the_loop_of_the_simulator(name, late):
    """Eigenvalues as of `sampled_loop`, which delays the measurement and has no derivatives."""
    options, flags, numbers = LOOPS[name]
    ours = outcome(EXCAVATOR, POSTURE_B, late, **flags, **numbers)
    sensor = options.get("sensor", {}) | {"delay": late}
    other = flexopt.sampled_loop(EXCAVATOR, POSTURE_B, kp=1e4, kv=1e3, **options | {"sensor": sensor})
    for matrix in (ours.sample.matrix, ours.smooth.matrix):
        values = np.linalg.eigvals(matrix)
        # A queue's zeros come out as roots of rounding.
        large = other.multipliers[np.abs(other.multipliers) > 0.3]
        assert max(np.abs(values - mu).min() for mu in large) < 1e-11
    assert ours.loop.growth_rate == pytest.approx(other.growth_rate, abs=1e-10)


@pytest.mark.long
def test_a_redundant_arm_with_a_damper_under_its_weight():
    given = {"kp": 3e6, "kv": 6e5, "gravity": True}
    ours = outcome(DIGGER, STAND, 0.0031, damped=True, nullspace_damping=[1e4], **given)
    other = flexopt.sampled_loop(DIGGER, STAND, nullspace_damping=1e4, sensor={"delay": 0.0031}, **given)
    assert ours.loop.growth_rate == pytest.approx(other.growth_rate, abs=1e-10)
    assert (ours.loop.neutral, ours.loop.drift) == (other.neutral, pytest.approx(other.drift))


def test_velocity_served_joints_are_damped_ones():
    """Τ = k (q̇_ref − q̇): torques of gains k times as large, joints with friction k."""
    gain, kp = 400.0, 1.5
    ours = outcome(EXCAVATOR, POSTURE_B, 0.013, kp=kp, kv=0.0, rate=100.0, served=True, servo_gain=[gain])
    names = ours.motions.plant.parameter_names
    p = ours.numbers["p"] + gain * np.array([name.endswith("joint_damping") for name in names])
    other = LateLoop(EXCAVATOR, POSTURE_B, "inverse", [gain * kp] * 2, [0.0] * 2, 0.01, 0.013, p=p)
    assert ours.decay().value == pytest.approx(-float(other.growth()), abs=1e-10)
    slope = ours.gradient(ours.decay())["servo_gain"][0]
    near = [outcome(EXCAVATOR, POSTURE_B, 0.013, kp=kp, kv=0.0, rate=100.0, served=True, servo_gain=[gain + h]).decay().value
            for h in (1e-2, -1e-2)]  # fmt: skip
    assert slope == pytest.approx((near[0] - near[1]) / 2e-2, rel=1e-6)


def test_by_a_dead_time_of_whole_samples_the_derivative_is_that_of_a_longer_one():
    for late in (0.0, 0.01):
        here, near, far = (outcome(EXCAVATOR, POSTURE_B, late + k * 1e-5) for k in range(3))
        values = [each.decay().value for each in (here, near, far)]
        slope = here.gradient(here.decay())["dead_time"][0]
        assert slope == pytest.approx((4 * values[1] - 3 * values[0] - values[2]) / 2e-5, rel=1e-5)


# Of an independent computation: posture, dead time, and stable Kp at Kv / Kp of 0.1 s.
@pytest.mark.parametrize("late", [0.0, 0.005, 0.02])
@pytest.mark.parametrize("posture", [POSTURE_A, POSTURE_B, THIRD])
def test_allowed_gains_are_those_of_the_border(posture, late):
    found = outcome(EXCAVATOR, posture, late)
    border = flexopt.stability_border(EXCAVATOR, posture, kp=1e4, ratio=0.1, sensor={"delay": late})
    assert len(found.gain_intervals) == len(border.intervals)
    for (low, high), expected in zip(found.gain_intervals, border.intervals, strict=True):
        assert (1e4 * low, 1e4 * high) == pytest.approx(expected, rel=1e-6)
    allowed = found.allowed_gain().value
    if allowed:
        for factor, word in ((1 - 1e-6, True), (1 + 1e-6, False)):
            gains = {"kp": factor * allowed, "kv": 0.1 * factor * allowed}
            assert outcome(EXCAVATOR, posture, late, **gains).loop.stable == word
    else:
        assert all(low > 1 for low, _ in found.gain_intervals)


@pytest.mark.parametrize(("kp", "kv"), [(1e5, 1e6), (1e4, 1e8), (2e7, 1e7)])
def test_stable_gains_below_all_that_were_looked_at_are_not_denied(kp: float, kv: float) -> None:
    """420 bits tell that with Kv of 10 N m s, less than 1e-4 of the present one, the loop decays."""
    low = 10.0 / kv
    assert LateLoop(EXCAVATOR, POSTURE_A, "inverse", [low * kp] * 2, [10.0] * 2, 1 / 200).growth() < 0
    found = flexopt.outcome(EXCAVATOR, POSTURE_A, loop={"kp": kp, "kv": kv, "rate": 200.0, "drive": "torque"})
    assert (found.allowed_gain, found.gain_intervals) == (0.0, ())
    line = next(line for line in repr(found).splitlines() if "allowed gain" in line)
    looked = [float(x) for x in re.findall(r"from (\S+) to (?:the present )?([^\s)]+)", line) for x in x]
    assert looked == pytest.approx([1e-4 * kp, kp, 1e-4 * kp, 1e4 * kp], rel=1e-3)


@pytest.mark.parametrize("late", [0.0, 0.0031])
def test_margins_say_when_the_loop_grows(late):
    here = outcome(EXCAVATOR, POSTURE_B, late)
    margin = here.delay_margin().value
    assert outcome(EXCAVATOR, POSTURE_B, late + margin - 1e-7).loop.stable
    assert not outcome(EXCAVATOR, POSTURE_B, late + margin + 1e-7).loop.stable
    # No shorter one does.
    assert all(outcome(EXCAVATOR, POSTURE_B, late + x).loop.stable for x in np.linspace(0, margin, 40)[:-1])
    # The smallest gain factor 1 ± … that the disk allows is stable, in both rows alike and opposed.
    alpha = here.disk_margin().value
    low, high = (2 - alpha) / (2 + alpha), (2 + alpha) / (2 - alpha)
    for factors in ((low, low), (high, high), (low, high), (high, low)):
        gains = {"kp": 1e4 * np.array(factors), "kv": 1e3 * np.array(factors)}
        assert outcome(EXCAVATOR, POSTURE_B, late, **gains).loop.stable


@pytest.mark.parametrize("number", [3, 7, 14, 26, 27, 31])
def test_a_border_in_dead_time_by_the_response_is_that_of_the_eigenvalues(number, monkeypatch):
    by_eigenvalues = draw_case(number).outcome.delay_margin().value
    monkeypatch.setattr("flexopt.loop.outcome.DELAY_MAX", 0)
    assert draw_case(number).outcome.delay_margin().value == pytest.approx(by_eigenvalues, rel=1e-10)


@pytest.mark.parametrize("number", [4, 12, 24, 37])
def test_a_border_beyond_a_hundred_samples_is_found(number):
    here = draw_case(number).outcome
    margin = here.delay_margin().value
    assert 100 < (here.dead_time + margin) / here.period < 400
    assert replace(here, dead_time=here.dead_time + margin * (1 - 1e-4)).loop.stable
    assert not replace(here, dead_time=here.dead_time + margin * (1 + 1e-4)).loop.stable


@pytest.mark.parametrize("seed", range(6))
def test_margins_of_machines_without_damping(seed):
    """The loop broken is infinite on a pole that nothing damps; the border is that of 420 bits, and no earlier one."""
    data = EXCAVATOR.to_dict()
    data["base"].pop("damping")
    data["base"]["stiffness"] = {"rotation": data["base"]["stiffness"]["rotation"]}
    machine, rng = flexopt.machine_from_dict(data), np.random.default_rng(seed)
    loops = ((rng.uniform([0.0, -2.0], [1.2, -0.3]), rng.choice([1e3, 1e4])) for _ in range(20))
    points = (outcome(machine, posture, kp=kp, kv=kp / 5) for posture, kp in loops)
    here = next(point for point in points if point.loop.stable)
    margin, gain = here.delay_margin().value, float(here.numbers["kp"][0])
    assert 0 < margin < 100 * here.period
    late = LateLoop(machine, here.numbers["posture"], "inverse", [gain] * 2, [gain / 5] * 2, here.period)
    before, after = (replace(late, dead_time=margin * (1 + step)).growth() for step in (-1e-6, 1e-6))
    assert before < 0 < after
    assert all(replace(here, dead_time=x).loop.stable for x in np.linspace(0, margin, 40)[:-1])


@pytest.mark.parametrize("kp", [1e-5, 1e-3, 1.0])
@pytest.mark.parametrize("posture", [POSTURE_B, (1.89817845, -1.46504354)])
def test_a_delay_margin_beside_a_motion_that_hardly_depends_on_the_dead_time(posture, kp: float) -> None:
    """A low Kp leaves a slow drift of the end-point; another motion grows at the border, by 420 bits."""
    margin = flexopt.outcome(EXCAVATOR, posture, loop={"kp": kp, "kv": 1e3, "dead_time": 0.02}).delay_margin
    late = LateLoop(EXCAVATOR, posture, "inverse", [kp] * 2, [1e3] * 2, 0.005)
    before, after = (replace(late, dead_time=0.02 + margin * (1 + step)).growth() for step in (-1e-6, 1e-6))
    assert before < 0 < after


@pytest.mark.parametrize("kp", [(0.0, 0.0), (0.0, 1e4), (1e4, 1e4)])
def test_task_rows_without_a_gain_on_the_position_are_named(kp: tuple[float, float]) -> None:
    found = flexopt.outcome(EXCAVATOR, POSTURE_B, loop={"kp": kp, "kv": 1e3})
    assert found.to_dict()["settings"]["position_held"] == [gain > 0 for gain in kp]
    assert ("position is free" in repr(found)) == (0.0 in kp)


def test_a_border_that_is_near_zero_only_by_the_frequency_response_is_none():
    """What would be late by less than nothing; the margin stands where the decay does not beside it."""
    data = EXCAVATOR.to_dict()
    data["base"]["stiffness"] = {name: 0.59460355750 * value for name, value in data["base"]["stiffness"].items()}
    machine, posture, base = flexopt.machine_from_dict(data), (0.8029277051070434, 1.6900874123286727), 1.6154176528
    loop = {"dead_time": 0.01, "kp": 171.54280448824815, "kv": 15150.266050702685}
    margin = flexopt.outcome(machine, posture, base=base, loop=loop).delay_margin

    def decay(more: float) -> float:
        return flexopt.outcome(machine, posture, base=base, loop=loop | {"dead_time": 0.01 + more}).decay

    assert min(map(decay, np.linspace(0.0, 0.99 * margin, 12))) > 0 > decay(1.01 * margin)


def test_a_delay_margin_is_looked_for_up_to_what_is_asked():
    here = outcome(EXCAVATOR, POSTURE_B)
    margin = here.delay_margin().value
    assert 0 < margin < math.inf
    assert here.delay_margin(below=1.1 * margin).value == margin
    assert here.delay_margin(below=0.9 * margin).value in (margin, math.inf)
    assert here.delay_margin(below=1e-4 * margin).value == math.inf


def test_peaks_over_a_fine_grid():
    """‖S‖ and ‖T‖ from the response of the loop's parts, point by point."""
    here = outcome(DIGGER, STAND, 0.017, kp=3e6, kv=6e5, rate=100.0)
    sample, angles = here.sample, np.linspace(1e-4, math.pi, 4001)
    z = np.exp(1j * angles)[:, None, None]
    loop = -sample.force @ np.linalg.solve(z * np.eye(len(sample.open)) - sample.open, sample.into + 0j * z)
    identity = np.eye(loop.shape[1])
    s = np.linalg.inv(identity + loop)
    for found, response in ((here.sensitivity_peak(), s), (here.complementary_peak(), identity - s)):
        largest = np.linalg.norm(response, 2, axis=(1, 2)).max()
        assert found.value == pytest.approx(largest, rel=1e-3)
        assert found.value > largest * (1 - 1e-9)


def test_what_is_not_defined_is_nan():
    grows = outcome(EXCAVATOR, POSTURE_A)
    assert grows.decay().value < 0
    for name in ("delay_margin", "disk_margin", "sensitivity_peak", "complementary_peak", "h2_norm"):
        measured = MEASURES[name](grows)
        assert math.isnan(measured.value)
        assert all(np.isnan(slope).all() for slope in grows.gradient(measured).values())
    # Weaker feedback leaves the base's own damping.
    assert 0 < grows.allowed_gain().value < grows.numbers["kp"][0]


def test_poles_of_what_is_over_after_some_samples() -> None:
    """A pair and a decay by their s, beside a force that waits for two samples and then acts on nothing."""
    period, pair, slow = 0.01, complex(-0.3, 40.0), -7.0
    angle = pair.imag * period
    turn = np.exp(pair.real * period) * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    waiting = np.array([[0.0, 1.0], [0.0, 0.0]])
    loop = spectrum(block_diag(turn, np.exp(slow * period), waiting), period, 0, 0, own=lambda: pytest.fail("no arm"))
    found = sorted(loop.poles.tolist(), key=lambda s: (-s.real, -s.imag))
    np.testing.assert_allclose(found[:3], [pair, pair.conjugate(), slow], rtol=1e-12)
    assert found[3:] == [complex(-math.inf, 0.0)] * 2
    # The one next to any frequency has one.
    assert _rate_near(loop, 6.0) == pytest.approx(pair.real)
    # A loop of which all is over then, its zeros with signs.
    nothing = SampledLoop(np.array([-0.0, 0.0], dtype=complex), period)
    assert nothing.poles.tolist() == [complex(-math.inf, 0.0)] * 2
    assert nothing.growth_rate == -math.inf
    assert nothing.stable
    assert nothing.aperiodic


@pytest.mark.parametrize("late", [0.005, 0.01, 0.03])
def test_a_law_that_acts_on_nothing_leaves_the_machine_alone(late: float) -> None:
    """Of a servo without gain nothing comes, so that commands wait whole samples in vain: multipliers that are 0.

    The rest is the machine with free joints, M q'' + D q' + K q = 0: its eigenvalues.
    """
    point = outcome(EXCAVATOR, POSTURE_A, late, served=True)
    q, of, plant = point.configuration, point.numbers, point.motions.plant
    inertia = plant.mass(q, of["base"], of["p"]).full()
    n = len(inertia)
    springs, dampers = plant.stiffness(of["p"]).full(), plant.damping(of["p"]).full()
    first = np.block(
        [[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(inertia, springs), -np.linalg.solve(inertia, dampers)]]
    )
    own = sorted((s for s in np.linalg.eigvals(first) if s.imag > 1.0), key=abs)
    assert len(own) == 3
    poles, waits = point.loop.poles, 2 * round(late / point.period)
    assert np.count_nonzero(point.loop.multipliers == 0) == waits
    assert np.count_nonzero(poles == complex(-math.inf, 0.0)) == waits
    assert not np.isnan(poles).any()
    np.testing.assert_allclose(sorted((s for s in poles if s.imag > 1.0), key=abs), own, rtol=1e-7)
    # Rates of all; of those that there are no search is told.
    rates = [point.rate(k) for k in range(len(point.upper))]
    assert [rate.value for rate in rates[-waits:]] == [math.inf] * waits
    assert all(rate.slopes is None for rate in rates[-waits:])
    assert all(math.isfinite(rate.value) for rate in rates[:-waits])
    assert all(map(math.isfinite, rates_of(point)))


def test_dead_times_beside_whole_samples():
    """What is a whole number of samples but for rounding is one."""
    parts = outcome(EXCAVATOR, POSTURE_B).parts
    assert OneSample(parts, 0.005, 0.015 + 1e-12).waiting == (3, 0.0)
    assert OneSample(parts, 0.005, 0.0151).waiting == (4, pytest.approx(1e-4))


@pytest.mark.long
def test_a_loop_that_alternates_from_sample_to_sample_is_told_why() -> None:
    """Gains and dampers that a rate is too slow for; growth of a mode of the base is none of these."""

    def told(loop: dict[str, float]) -> str:
        return str(flexopt.outcome(EXCAVATOR, POSTURE_B, loop=loop))

    assert "100 Hz, half the sampling rate: the velocity gain is too much for 200 Hz" in told({"kp": 1e4, "kv": 5e5})
    # With Kv and without it grows at 773/s: it is not that.
    for kv in (0.0, 1e3):
        assert "100 Hz, half the sampling rate: the position gain is too much for 200 Hz" in told({"kp": 1e9, "kv": kv})
    # Without Kp it alternates, too, and without Kv it does not.
    for kp in (0.0, 8e7):
        assert "half the sampling rate: the velocity gain is" in told({"kp": kp, "kv": 1.2e5})
    assert "half the sampling rate" not in told({"kp": 8e7, "kv": 0.0})
    assert "half the sampling rate" not in told({"kp": 1e6, "kv": 1e3})
    assert "half the sampling rate" not in told({"kp": 1e4, "kv": 1e3})
    arm = flexopt.load("mobile-manipulator")
    damper = {"kp": 10.0, "kv": 1.0, "drive": "torque", "nullspace_damping": 1e4}
    grows = str(flexopt.outcome(arm, (0.0, -1.2, 1.5, -0.5, 0.6, 0.0), loop=damper))
    # Whatever the gains: it grows as fast without them.
    assert "half the sampling rate: the damper of the self-motion is too much for" in grows
    both = str(flexopt.outcome(arm, (0.0, -1.2, 1.5, -0.5, 0.6, 0.0), loop=damper | {"kv": 1e5}))
    assert "the velocity gain and the damper of the self-motion are too much for" in both


@pytest.mark.parametrize(
    ("kp", "kv", "named"),
    [
        (1e8, 8e4, ("kp",)),
        (1e8, 7e4, ("kp",)),
        (8e7, 9.5e4, ("kp",)),
        (1e9, 1e3, ("kp",)),
        (8e7, 1.2e5, ("kv",)),
        (0.0, 1.2e5, ("kv",)),
        (1e9, 1.2e5, ("kv", "kp")),
        (1e8, 4e4, ()),
        (0.0, 8e4, ()),
    ],
)
def test_named_is_the_gain_without_which_nothing_alternates(kp: float, kv: float, named: tuple[str, ...]) -> None:
    """By SciPy's discretisation: a multiplier left of −1, and how fast the loop grows without either gain."""
    posture = np.array([0.6, -1.6])

    def looked_at(**gains: float) -> tuple[bool, float]:
        of = multipliers(EXCAVATOR, posture, control="inverse", period=0.005, **gains)
        return bool(np.any((np.abs(of.imag) < 1e-9) & (of.real < -1))), float(np.abs(of[0]))

    gains = {"kp": kp, "kv": kv}
    without = {name: looked_at(**gains | {name: 0.0}) for name in gains}
    assert looked_at(**gains)[0] == bool(named)
    assert flexopt.outcome(EXCAVATOR, posture, loop=gains).too_much == named
    if len(named) == 1:
        assert not without[named[0]][0]
        assert without[named[0]] == min(without.values())
    elif named:
        assert all(alternates for alternates, _ in without.values())


def test_a_self_motion_slower_than_the_decay_is_told():
    """Of three links over two rows: what brakes their self-motion does so slowly; eigenvalues of the matrices judge."""
    machine, posture = flexopt.load("boom-stick-bucket"), (-1.21844, -1.65556, -2.17534)
    loop = {"drive": "torque", "rate": 200.0, "kp": 5.42e5, "kv": 3.6e5}
    slow = flexopt.outcome(machine, posture, loop=loop | {"nullspace_damping": 26.0})
    assert 0 < -slow.drift[0] < slow.decay / 100
    assert f"self-motion, no part of the decay, dies away at {-slow.drift[0]:.3g}/s" in repr(slow)
    assert "dies away" not in repr(flexopt.outcome(flexopt.load("excavator"), (0.0448, -2.0499), loop=loop))
