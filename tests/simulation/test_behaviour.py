"""Growth rates, verdicts and settling times of signals that are known in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import linregress

import flexopt
from flexopt.simulation.behaviour import Grounds, behaviour
from flexopt.simulation.run import _overshoot

STEP, SLOWEST = 0.005, 3.0
TIMES = np.arange(2001) * STEP
AT = TIMES[:-1]


def judged(*energies, error=None, rotation=None, times=TIMES, end=None, still=0.0, slowest=SLOWEST):
    """Behaviour of one member whose modes have these energies."""
    n = len(times) - 1
    error = np.exp(-times[:-1]) if error is None else error
    rotation = np.zeros(n) if rotation is None else rotation
    monitors = np.stack([error**2, rotation**2, *energies], axis=1)[:, :, None]
    return behaviour(times, monitors, np.array([abs(error[-1]) if end is None else end]), Grounds(slowest, True, still))


def amplitude(rate, frequency=SLOWEST, phase=0.0, wobble=0.0):
    """Energy of a mode whose amplitude goes as exp(rate t); `wobble` lets it beat at twice the frequency."""
    return np.exp(2 * rate * AT) * (1 + wobble * np.cos(4 * math.pi * frequency * AT + phase))


@settings(derandomize=True)
@given(rate=st.floats(-3, 3), frequency=st.floats(3, 25), phase=st.floats(0, 6), wobble=st.floats(0, 0.9))
def test_one_mode(rate, frequency, phase, wobble):
    result = judged(amplitude(rate, frequency, phase, wobble))
    measured, error = float(result.growth_rate[0]), float(result.growth_rate_error[0])
    # Periods are whole samples, so the largest value wanders through them by up to half a period of what wobbles, a
    # twelfth of a second: over the five of the fit 2/60 of the rate.
    assert abs(measured - rate) <= 3 * error + (0.04 if wobble else 1e-6) * abs(rate) + 1e-9
    if abs(rate) > 0.01:
        assert result.grows[0] == (rate > 0)


@pytest.mark.parametrize("rate", [-2.0, -0.05, 0.05, 2.0])
def test_a_clean_exponential_gives_its_rate(rate):
    """Maxima over equal spans of an exponential are an exponential again: the fit is exact."""
    result = judged(amplitude(rate))
    assert result.growth_rate[0] == pytest.approx(rate, rel=1e-9)
    assert result.growth_rate_error[0] < 1e-8
    assert result.verdict() == ("grows" if rate > 0 else "converges")


def test_an_amplitude_that_levels_off_is_told_by_how_far_it_grew():
    """exp(0.6 t) up to 5 s, a slow swell after it: the second half tells no growth, the whole run does."""
    levelled = np.exp(2 * 0.6 * np.minimum(AT, 5.0)) * (1 + 0.2 * np.sin(2.5 * AT))
    run = judged(levelled, error=np.ones_like(AT)).shown()
    assert (run.word, run.levelled) == ("grows", True)
    assert run.rate <= run.error
    # Whole periods of 67 samples are counted from the end.
    first, last = levelled[2000 % 67 :][:67].max(), levelled[-67:].max()
    assert run.grown == pytest.approx(math.sqrt(last / first), rel=1e-12)
    assert not judged(amplitude(0.6), error=np.ones_like(AT)).shown().levelled
    assert not judged(amplitude(-0.6)).shown().levelled


def test_the_fit_is_a_linear_regression():
    """Of the second half's logarithms slope, standard error and what halves differ by beyond it, against SciPy's."""
    rng = np.random.default_rng(5)
    logarithms = 0.3 * np.arange(40) * 0.25 + rng.normal(0.0, 0.1, 40) + 0.02 * np.maximum(np.arange(40) - 30, 0)
    times = np.arange(2001) * STEP
    energy = np.repeat(np.exp(2 * logarithms), 50)
    monitors = np.stack([np.exp(-AT), 0 * AT, energy], axis=1)[:, :, None]
    result = behaviour(times, monitors, np.ones(1), Grounds(4.0, True))
    expected = linregress(0.25 * np.arange(20), logarithms[20:])
    early, late = (linregress(0.25 * np.arange(10), half).slope for half in (logarithms[20:30], logarithms[30:]))
    assert result.growth_rate[0] == pytest.approx(expected.slope, rel=1e-10)
    # What white scatter alone makes of the halves' difference: variances of slopes are as 1 / sum of squared times.
    spread, of_half = (np.sum((0.25 * (np.arange(n) - (n - 1) / 2)) ** 2) for n in (20, 10))
    bend = max((late - early) ** 2 - 2 * expected.stderr**2 * spread / of_half, 0.0)
    assert bend > 0
    assert result.growth_rate_error[0] == pytest.approx(math.sqrt(expected.stderr**2 + bend), rel=1e-10)


def test_the_error_of_scatter_alone_is_little_more_than_the_standard_error():
    """Of 2000 runs: halves of a line in noise differ by four standard errors of the whole one's slope, by chance."""
    logarithms = -0.2 * np.arange(40)[:, None] * 0.25 + np.random.default_rng(3).normal(0.0, 0.1, (40, 2000))
    energy = np.exp(2 * logarithms)
    monitors = np.stack([np.ones_like(energy), 0 * energy, energy], axis=1)
    result = behaviour(np.arange(41) * 0.25, monitors, np.ones(2000), Grounds(4.0, True))
    standard = 0.1 / np.sqrt(np.sum((0.25 * (np.arange(20) - 9.5)) ** 2))
    assert np.median(result.growth_rate_error) < 1.5 * standard
    assert np.mean(np.abs(result.growth_rate + 0.2) > 2 * result.growth_rate_error) < 0.05


@pytest.mark.parametrize("periods", [4, 5])
def test_a_fit_takes_three_periods_at_least(periods):
    """A line through two points has no residual, which would be an error of 0."""
    logarithms = np.array([0.3, 0.1, 0.5, 0.2, 0.4])[:periods]
    times, energy = np.arange(50 * periods + 1) * STEP, np.repeat(np.exp(2 * logarithms), 50)
    result = judged(energy, times=times, error=np.ones(50 * periods), slowest=4.0)
    expected = linregress(0.25 * np.arange(3), logarithms[-3:])
    assert result.growth_rate[0] == pytest.approx(expected.slope, rel=1e-10)
    # Halves of a period or two say nothing of how it goes on.
    assert result.growth_rate_error[0] == pytest.approx(math.hypot(expected.stderr, expected.slope), rel=1e-10)
    assert not result.significant[0]


def test_of_two_periods_no_error_is_known():
    energy = np.repeat([0.0, 0.0, 1.0, 4.0], 50)
    result = judged(energy, times=np.arange(201) * STEP, error=np.ones(200), slowest=4.0)
    assert result.growth_rate[0] == pytest.approx(math.log(2.0) / 0.25, rel=1e-10)
    assert result.growth_rate_error[0] == result.growth_rate[0]


def test_periods_hide_what_happens_within_them():
    """A measure that touches zero twice in each period still gives its envelope's rate."""
    result = judged(np.exp(-0.6 * AT) * np.cos(2 * math.pi * SLOWEST * AT) ** 2)
    assert result.growth_rate[0] == pytest.approx(-0.3, rel=0.05)
    assert result.growth_rate_error[0] < 5e-3


def test_the_fastest_growing_mode_decides():
    both = judged(amplitude(-0.5), 1e-6 * amplitude(0.3, 13.0), amplitude(-2.0, 22.0))
    assert both.grows[0]
    assert both.growth_rate[0] == pytest.approx(0.3, rel=1e-6)
    calm = judged(amplitude(-0.5), 1e-6 * amplitude(-0.3, 13.0), amplitude(-2.0, 22.0))
    assert not calm.grows[0]
    assert calm.growth_rate[0] == pytest.approx(-0.3, rel=1e-6)


def test_a_mode_that_is_dragged_along_is_not_told():
    """What is moved by the square of another grows at twice its rate, and is small beside it."""
    result = judged(amplitude(0.4), 1e-6 * amplitude(0.8, 13.0), amplitude(-2.0, 22.0))
    assert result.grows[0]
    assert result.growth_rate[0] == pytest.approx(0.4, rel=1e-6)


@pytest.mark.long("article-move-17.0")
@pytest.mark.parametrize(
    ("name", "duration"), [("article-b", 5.0), ("article-b", 10.0), ("article-b", 15.0), ("article-move", 17.0)]
)
def test_the_error_of_a_decay_covers_what_the_loop_does(name, duration):
    """Of short runs, in which other modes have not died away and quiet ones show what louder ones lend them."""
    long = flexopt.load_experiment(name)
    short = long.model_copy(update={"simulation": long.simulation.model_copy(update={"duration": duration})})
    run = flexopt.run_experiment(short)
    # The article's RK4 makes 0.0297/s of both, a run of a minute, too.
    assert abs(run.growth_rate + 0.0297) < 2 * run.run.error
    assert run.run.error < (0.09 if duration < 10 else 0.03)


def test_a_run_at_large_turns_tells_the_rate_of_the_linear_loop():
    """At 10 s the base turns by 0.2 rad; its stiff springs are then dragged along, at 0.74/s beside 0.48/s."""
    run = flexopt.simulate(flexopt.load("excavator"), (0.99288, -2.6302), kp=28010.0, kv=6858.0)
    assert run.peak_base_rotation is not None
    assert run.peak_base_rotation > 0.15
    # Large turns soften the loop a little.
    assert run.growth_rate == pytest.approx(run.linear_growth_rate, rel=5e-3)


@pytest.mark.parametrize("rate", [-0.3, 0.3])
@pytest.mark.parametrize("beat", [0.4, 1.1])
def test_two_modes_that_beat(rate, beat):
    """Energy that swings to and fro between a mode and a neighbour: the error says what the fit is worth."""
    shape = np.exp(2 * rate * AT) * (1 + 0.5 * np.cos(2 * math.pi * beat * AT))
    result = judged(shape)
    assert abs(result.growth_rate[0] - rate) <= 3 * result.growth_rate_error[0]
    assert result.growth_rate_error[0] > 1e-3
    assert result.grows[0] == (rate > 0)


def test_a_transient_that_dies_before_the_oscillation_grows():
    shape = 100 * amplitude(-5.0) + 1e-3 * amplitude(0.4)
    result = judged(shape)
    assert result.grows[0]
    assert result.growth_rate[0] == pytest.approx(0.4, rel=0.02)


def test_nothing_moves():
    result = judged(np.zeros(2000), error=np.zeros(2000))
    assert not result.grows[0]
    assert result.verdict() == "converges"
    assert np.isnan(result.growth_rate[0])
    assert np.isnan(result.growth_rate_error[0])
    assert result.settling_time[0] == 0.0
    assert result.end_error[0] == 0.0
    assert result.peak_error[0] == 0.0
    assert result.finite_until[0] == TIMES[-1]
    np.testing.assert_array_equal(result.residual_oscillation, [[0.0]])


def test_a_mode_that_never_moves_beside_one_that_does():
    result = judged(np.zeros(2000), amplitude(-0.4))
    assert not result.grows[0]
    assert result.growth_rate[0] == pytest.approx(-0.4, rel=1e-6)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("at", [1, 700, 1999])
def test_a_run_that_leaves_the_finite_numbers(bad, at):
    energy, error = amplitude(0.2), np.ones(2000)
    energy[at:] = bad
    error[at:] = bad
    result = judged(energy, error=error, end=np.nan)
    assert result.grows[0]
    assert result.finite_until[0] == pytest.approx(at * STEP)
    assert result.end_error[0] == np.inf
    assert result.peak_error[0] == np.inf
    assert np.isnan(result.settling_time[0])
    if at > 600:
        assert result.growth_rate[0] == pytest.approx(0.2, rel=0.02)


def test_only_the_end_is_not_finite():
    """The state after the last sample, which no monitor sees."""
    result = judged(amplitude(-0.2), end=np.nan)
    assert result.grows[0]
    assert result.end_error[0] == np.inf


def test_rounding_is_no_oscillation():
    """A decay of −20/s meets rounding, at 1e-26 of where it began, after 1.5 s; what follows is not fitted."""
    rng = np.random.default_rng(0)
    noise = 1e-26 * rng.uniform(0.5, 2.0, 2000) * np.exp(0.2 * AT)
    result = judged(amplitude(-20.0) + noise)
    assert not result.grows[0]
    assert result.growth_rate[0] == pytest.approx(-20.0, rel=0.02)


def test_a_noise_floor_seldom_counts_as_growth():
    """Sensor noise keeps the base moving at a level: the rate is zero within its error, and seldom called growth.

    The verdict takes a slope of more than twice its error for growth: 2.5 % of the slopes of pure noise.
    """
    grown = 0
    for seed in range(300):
        noise = np.random.default_rng(seed).chisquare(2, 2000) * 1e-4
        result = judged(amplitude(-3.0) + noise)
        assert abs(result.growth_rate[0]) < 5 * result.growth_rate_error[0]
        grown += bool(result.grows[0])
    assert grown / 300 < 0.06


def test_threefold_growth_counts_whatever_comes_last():
    shape = np.where(AT < 5, np.exp(1.0 * AT), np.exp(5.0) * np.exp(-0.2 * (AT - 5)))
    result = judged(shape)
    assert result.growth_rate[0] < 0
    assert result.grows[0]


def test_what_stays_below_rounding_has_no_rate():
    still = np.array([1e-18])
    result = judged(1e-20 * amplitude(0.1), still=still)
    assert result.verdict() == "converges"
    assert np.isnan(result.growth_rate[0])


def test_growth_out_of_rounding_is_seen():
    """Noise below the floor for a second, then exp(0.8 t) rises from it."""
    shape = 1e-20 * np.random.default_rng(1).uniform(0.5, 2.0, 2000) + 1e-19 * amplitude(0.8)
    result = judged(shape, still=np.array([1e-18]))
    assert result.verdict() == "grows"
    assert result.growth_rate[0] == pytest.approx(0.8, rel=0.02)


def test_decay_into_rounding_is_fitted_down_to_it():
    shape = np.maximum(amplitude(-4.0), 1e-19 * (1 + AT))
    result = judged(shape, still=np.array([1e-18]))
    assert result.verdict() == "converges"
    assert result.growth_rate[0] == pytest.approx(-4.0, rel=0.01)


def test_a_mode_that_is_pushed_later_and_then_decays():
    """Zero for two seconds, driven for one, and free from there: its rise is no growth."""
    shape = np.where(AT < 2, 0.0, np.where(AT < 3, (AT - 2) ** 2, np.exp(-0.6 * (AT - 3))))
    result = judged(amplitude(-1.0), shape, still=np.full(2, 1e-18))
    assert result.verdict() == "converges"
    assert result.growth_rate[0] == pytest.approx(-0.3, rel=0.01)


@pytest.mark.parametrize("decay", [0.8, 2.0, 10.0])
def test_settling_time_of_a_decay(decay):
    """e = e₀ exp(−σ t) stays below 2 % from ln 50/σ on."""
    result = judged(amplitude(-1.0), error=0.3 * np.exp(-decay * AT))
    exact = math.log(50) / decay
    assert exact <= result.settling_time[0] <= exact + STEP * (1 + 1e-9)
    assert result.peak_error[0] == pytest.approx(0.3)
    assert result.end_error[0] == pytest.approx(0.3 * np.exp(-decay * AT[-1]))


def test_settling_waits_for_the_last_time_it_is_left():
    error = np.full(2000, 0.001)
    error[0], error[900] = 1.0, 0.021
    assert judged(amplitude(-1.0), error=error).settling_time[0] == pytest.approx(901 * STEP)
    error[900] = 0.02
    assert judged(amplitude(-1.0), error=error).settling_time[0] == pytest.approx(STEP)
    error[-1] = 0.5
    assert np.isnan(judged(amplitude(-1.0), error=error).settling_time[0])


def test_peak_rotation_is_the_largest():
    turn = 0.04 * np.exp(-AT) * np.abs(np.cos(7 * AT))
    assert judged(amplitude(-1.0), rotation=turn).peak_base_rotation[0] == pytest.approx(turn.max())
    monitors = np.ones((10, 3, 1))
    rigid = behaviour(np.arange(11.0), monitors, np.ones(1), Grounds(SLOWEST, False))
    assert np.isnan(rigid.peak_base_rotation[0])


@pytest.mark.parametrize("rate", [-1.0, -0.02, 0.02, 1.0])
@pytest.mark.parametrize("window", [2, 7, 40])
def test_windows_and_samples_give_the_same_verdict(rate, window):
    error = np.exp(-0.7 * AT)
    rows = np.stack([error**2, 0 * AT, amplitude(rate, 3.0, 0.4, 0.5), amplitude(-2.0, 13.0)], axis=1)
    starts = np.arange(0, 2000, window)
    edges = np.append(AT[starts], TIMES[-1])
    fine = behaviour(TIMES, rows[:, :, None], error[-1:], Grounds(SLOWEST, True))
    coarse = behaviour(edges, np.maximum.reduceat(rows, starts)[:, :, None], error[-1:], Grounds(SLOWEST, True))
    assert fine.grows[0] == coarse.grows[0] == (rate > 0)
    allowed = 3 * (fine.growth_rate_error[0] + coarse.growth_rate_error[0]) + 2e-3
    assert abs(fine.growth_rate[0] - coarse.growth_rate[0]) <= allowed + 0.02 * abs(rate)
    assert abs(fine.settling_time[0] - coarse.settling_time[0]) <= window * STEP + 1e-12
    assert fine.peak_error[0] == coarse.peak_error[0]


def test_members_do_not_touch_each_other():
    rng = np.random.default_rng(3)
    rates = rng.uniform(-1, 1, 9)
    monitors = np.stack(
        [np.stack([np.exp(-AT), 0 * AT, amplitude(rate, 3.0), amplitude(rate - 1, 13.0)], axis=1) for rate in rates],
        axis=2,
    )
    monitors[300:, :, 4] = np.nan
    monitors[:, 2:, 6] = 0.0
    together = behaviour(TIMES, monitors, np.ones(9), Grounds(SLOWEST, True))
    for i in range(9):
        alone = behaviour(TIMES, monitors[:, :, i : i + 1], np.ones(1), Grounds(SLOWEST, True))
        for name in ("grows", "growth_rate", "growth_rate_error", "settling_time", "finite_until", "peak_error"):
            np.testing.assert_allclose(getattr(together, name)[i], getattr(alone, name)[0], rtol=1e-12)
        np.testing.assert_array_equal(together.residual_oscillation[:, i], alone.residual_oscillation[:, 0])


@pytest.mark.parametrize("samples", [1, 2, 3, 5, 17])
def test_short_runs_are_judged_without_complaint(samples):
    times = np.arange(samples + 1) * STEP
    monitors = np.ones((samples, 4, 2))
    monitors[:, 2:, 1] = 0.0
    result = behaviour(times, monitors, np.ones(2), Grounds(SLOWEST, True))
    assert result.grows.shape == (2,)
    assert result.residual_oscillation.shape == (2, 2)
    assert not result.grows[1]


@pytest.mark.parametrize("zeta", [0.1, 0.4, 0.7])
def test_overshoot_of_the_second_order_response(zeta):
    """exp(−π ζ/√(1 − ζ²)), in whatever direction the error points."""
    root = math.sqrt(1 - zeta**2)
    t = np.linspace(0, 10, 20_001)
    e = np.exp(-zeta * t) * (np.cos(root * t) + zeta / root * np.sin(root * t))
    error = np.outer(e, [0.3, -0.4])
    assert _overshoot(error) == pytest.approx(math.exp(-math.pi * zeta / root), rel=1e-6)
    assert _overshoot(np.outer(np.exp(-t), [0.0, 1.0])) == 0.0
    assert _overshoot(np.zeros((5, 2))) is None
    error[7] = np.nan
    assert _overshoot(error) is None


def test_growth_is_judged_after_the_last_push():
    """A path that ends at 4 s leaves the modes larger than the start did; from there they decay."""
    energy = np.where(TIMES[:-1] < 4.0, 1e-8, np.exp(-0.2 * TIMES[:-1]))
    monitors = np.stack([np.full_like(energy, 1e-6), np.zeros_like(energy), energy], axis=1)[:, :, None]
    pushed = behaviour(TIMES, monitors, np.ones(1), Grounds(SLOWEST, True))
    after = behaviour(TIMES, monitors, np.ones(1), Grounds(SLOWEST, True, undisturbed_from=4.0))
    assert pushed.verdict() == "grows"
    assert after.verdict() == "converges"
    assert after.growth_rate[0] == pytest.approx(-0.1, abs=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_noise_that_keeps_a_mode_moving_is_no_growth(seed):
    """An amplitude that wanders slowly has slopes far beyond their standard errors."""
    rng = np.random.default_rng(seed)
    wander = np.cumsum(rng.normal(0.0, 0.02, len(TIMES) - 1))
    energy = np.exp(wander - wander.mean())
    monitors = np.stack([np.full_like(energy, 1e-6), np.zeros_like(energy), energy], axis=1)[:, :, None]
    judged = behaviour(TIMES, monitors, np.ones(1), Grounds(SLOWEST, True, noisy=True))
    assert judged.verdict() == "converges"
    growing = monitors * np.array([1.0, 1.0, 1.0])[None, :, None]
    growing[:, 2, 0] *= np.exp(2 * 0.5 * TIMES[:-1])
    assert behaviour(TIMES, growing, np.ones(1), Grounds(SLOWEST, True, noisy=True)).verdict() == "grows"
