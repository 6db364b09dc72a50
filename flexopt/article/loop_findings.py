"""What the article says of its closed loops beside what they do.

In: `ClosedLoops` and a `GainMap`. Out: `ArticleFinding`s.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from flexopt.article.closed_loops import OPTIMUM, WITH, WITHOUT, ClosedLoops, peak_error
from flexopt.article.findings import ArticleFinding
from flexopt.simulation import SampledLoop, Trajectory
from flexopt.simulation.linear import EXACT
from flexopt.study.gains import KV_HELD, RATIOS, GainMap, held_words

# A step whose own damping changes the slowest decay by more than this share is no faithful one.
FAITHFUL = 0.1
# Borders within this share of the rigid plant's own are that.
SAME_BORDER = 0.01
# Motions below this, m or rad, are rounding.
NOTHING = 1e-9


def better_convergence(loops: ClosedLoops) -> ArticleFinding:
    """Fig. 9: does the oscillation grow at A, and converge at B?"""
    runs = loops.figure9
    holds = runs["A"].verdict == "grows" and runs["B"].verdict == "converges"
    listed = "; ".join(f"{name} {_outcome(run)}" for name, run in runs.items())
    low = "; ".join(f"{row.stand} {_outcome(row.run)}" for row in loops.rows[len(runs) :])
    kp, kv = loops.rows[len(runs)].kp, loops.rows[len(runs)].kv
    sentence = (
        f"Rates of {loops.stated['integrator'].upper()}'s runs, and of the exact linear loop beside them. With the "
        f"stated gains: {listed}. With Kp = {kp:g} N m, Kv = {kv:g} N m s: {low}. "
        "The optimised posture is no part of Fig. 9."
    )
    numbers = {name: _numbers(run) for name, run in runs.items()}
    quote = "there is better performance for the optimized position that has a higher robustness"
    return ArticleFinding("better convergence", quote, "section 5.1, Fig. 9", holds, sentence, numbers)


def stability_by_moving(loops: ClosedLoops) -> ArticleFinding:
    """Figs. 11 and 12: does driving the base from A to B stabilise the loop?"""
    runs = loops.adjustment
    holds = runs[WITH].verdict == "converges" and runs[WITHOUT].verdict == "grows"
    sentence = (
        f"In the last of {runs[WITH].time[-1]:g} s the end-point is up to {1e3 * _at_last(runs[WITH]):.2f} mm off its "
        f"target with base adjustment and {1e3 * _at_last(runs[WITHOUT]):.0f} mm without; in the "
        f"whole run the base turned by up to {1e3 * _turn(runs[WITH]):.1f} and {1e3 * _turn(runs[WITHOUT]):.0f} mrad. "
        "With base adjustment the "
        f"oscillation {_outcome(runs[WITH])}, without it {_outcome(runs[WITHOUT])}; the base takes "
        f"{loops.stopped.time[-1]:.1f} s for its way. With the second pair of gains and base adjustment it "
        f"{_outcome(loops.low_adjustment)} over {loops.low_adjustment.time[-1]:g} s."
    )
    numbers = {name: _numbers(run) for name, run in (*runs.items(), ("second gains", loops.low_adjustment))}
    quote = "by moving the system from a configuration of low robustness to one of high robustness, manipulator "
    quote += "stability can be achieved"
    return ArticleFinding("base adjustment", quote, "section 5.1, Figs. 11, 12", holds, sentence, numbers)


def motion_excites(loops: ClosedLoops) -> ArticleFinding:
    """Does the motion of the base itself excite oscillation and error?"""
    run = loops.from_rest
    error, turn = peak_error(run), _turn(run)
    sentence = (
        f"Started at rest on its target, the end-point is moved off it by up to {1e3 * error:.2f} mm and the base "
        f"turned by up to {1e3 * turn:.2f} mrad by the motion alone (at most {loops.stated['max_base_rate']:g} m/s, "
        f"{loops.stated['max_base_acceleration']:g} m/s²); at the end {1e3 * _end(run):.3f} mm are left."
    )
    numbers = {"peak_error": error, "peak_base_rotation": turn, "end_error": _end(run)}
    quote = "does excite some base oscillation and end-point error"
    holds = error > NOTHING and turn > NOTHING
    return ArticleFinding("excitation", quote, "section 5.1, Fig. 10", holds, sentence, numbers)


def higher_gain(loops: ClosedLoops, gains: GainMap) -> ArticleFinding:
    """Does a posture of higher margin allow a higher gain?"""
    numbers: dict[str, Any] = {}
    holds, parts = True, list[str]()
    for ratio in (None, *RATIOS):
        held = held_words(ratio)
        rows = {name: gains.border(name, held, EXACT) for name in gains.names}
        allowed = {name: row.border.largest or 0.0 for name, row in rows.items()}
        holds = holds and allowed["A"] < min(allowed["B"], allowed[OPTIMUM])
        numbers[held] = allowed
        parts.append(f"{held}: " + ", ".join(f"{name} {row.text}" for name, row in rows.items()))
    factors = [numbers[held_words(r)][OPTIMUM] / numbers[held_words(r)]["B"] for r in RATIOS]
    margins = ", ".join(f"{name} {e.epsilon_max:.4f}" for name, e in loops.stands.items() if e.epsilon_max is not None)
    sentence = (
        f"Gains Kp, N m, for which the sampled linear loop is stable, exact between the samples. {'. '.join(parts)}. "
        f"ε_max: {margins}. With Kv in proportion to Kp the optimised posture allows {min(factors):.0f} to "
        f"{max(factors):.0f} times the gain of B. "
    )
    held = numbers[held_words(None)]
    rigid = 2 * KV_HELD * loops.stated["rate"]
    if max(abs(held[name] / rigid - 1) for name in ("B", OPTIMUM)) < SAME_BORDER:
        sentence += (
            f"With {held_words(None)} the two are level: they end where any sampled double integrator does, at "
            f"2 Kv/T = {rigid:.3g}, and not at a mode of the base."
        )
    else:
        sentence = sentence.rstrip()
    quote = "The occupation of a configuration with a high stability margin allows for the use of a controller with a "
    quote += "higher feedback gain"
    return ArticleFinding("higher gain", quote, "section 5.2", holds, sentence, numbers)


def stable_at_high_margin(gains: GainMap) -> ArticleFinding:
    """Is the loop stable as long as the margin is high, whatever the gains?"""
    rows = [row for row in gains.borders if row.integrator == EXACT and row.stand != "A"]
    bounded = [row for row in rows if row.frequency_hz is not None]
    listed = "; ".join(f"{row.stand}, {row.held}: {row.text}, then {row.frequency_hz:.2f} Hz grows" for row in bounded)
    sentence = "No gain was found too high."
    if bounded:
        sentence = f"A high margin is not enough: gains bound it, too; Kp in N m, Kv in N m s. {listed}."
    numbers = {f"{row.stand}, {row.held}": [row.border.largest, row.frequency_hz] for row in rows}
    quote = "As long as the configuration for the manipulator is chosen to have a high stability margin … the feedback "
    quote += "system is stable and does not excite unstable vibration modes"
    return ArticleFinding("stable by configuration", quote, "section 6", not bounded, sentence, numbers)


def integration_step(loops: ClosedLoops, gains: GainMap) -> ArticleFinding:
    """Is the step of 0.005 s short enough for RK4 to show the loop's own damping?"""
    rows = {(row.stand, row.kp): row for row in loops.rows}
    shares = {
        f"{row.stand}, Kp = {row.kp:g}": abs(row.stated.growth_rate / row.accurate.growth_rate - 1)
        for row in rows.values()
    }
    at_b = rows["B", loops.stated["kp"]]
    slow = at_b.accurate.frequency_hz
    damped = _rate_near(at_b.stated, slow)
    highest = max(float(run.frequencies_hz[-1]) for run in loops.figure9.values())
    held = held_words(RATIOS[0])
    stated, accurate = (gains.border("B", held, method) for method in (loops.stated["integrator"], EXACT))
    rate = loops.stated["rate"]
    sentence = (
        f"As a ratio it is: {rate / highest:.1f} times the highest resonance, {highest:.2f} Hz, and RK4 shows A's "
        f"growth to within {shares[f'A, Kp = {at_b.kp:g}']:.0e} of it. For slow decay it is too long: at B with "
        f"the stated gains the last to die away is the mode at {slow:.2f} Hz with a decay of "
        f"{-at_b.accurate.growth_rate:+z.4f}/s; RK4 makes that {-damped:+z.3f}/s and leaves "
        f"{-at_b.stated.growth_rate:+z.4f}/s at "
        f"{at_b.stated.frequency_hz:.2f} Hz. With {held} RK4 has B stable {stated.text}, the exact loop "
        f"{accurate.text}."
    )
    numbers = {
        "relative_difference_of_slowest": shares,
        "B": {
            "accurate": [at_b.accurate.growth_rate, slow],
            "stated": [at_b.stated.growth_rate, at_b.stated.frequency_hz],
            "accurate_mode_with_stated_integrator": damped,
        },
        "highest_resonance_hz": highest, "border_B": {row.integrator: row.border.largest for row in (stated, accurate)},
    }  # fmt: skip
    quote = "0.005 s (i.e., 200 Hz), which is significantly higher than the resonant frequencies of the flexible system"
    return ArticleFinding("integration step", quote, "section 5.1", max(shares.values()) < FAITHFUL, sentence, numbers)


def robust_controller(loops: ClosedLoops, gains: GainMap) -> ArticleFinding:
    """Does the controller that attains ε_max stabilise the nonlinear loop at A?"""
    by_method = {row.integrator: row for row in loops.robust}
    accurate, stated = by_method[EXACT].linear, by_method[loops.stated["integrator"]].linear
    run = by_method[EXACT].run
    assert run is not None
    holds = accurate.stable and run.verdict == "converges"
    kr = float(run.provenance["options"].get("gain", 5e5))
    sentence = (
        f"At A PD control with {held_words(None)} has stable Kp: {gains.border('A', held_words(None), EXACT).text}. "
        f"There the controller that attains ε_max at kr = {kr:g}, sampled at {loops.stated['rate']:g} Hz, "
        f"{'stabilises' if accurate.stable else 'does not stabilise'} the linear loop "
        f"(decay {-accurate.growth_rate:+z.3f}/s); "
        f"the nonlinear one {_outcome(run)} and is {1e6 * _end(run):.2g} µm off after {run.time[-1]:g} s. Integrated "
        f"by {loops.stated['integrator'].upper()} at {1e3 / loops.stated['rate']:g} ms the same linear loop is "
        f"{'stable' if stated.stable else 'unstable'} (decay {-stated.growth_rate:+z.4f}/s at "
        f"{stated.frequency_hz:.2f} Hz)."
    )
    numbers: dict[str, Any] = {
        row.integrator: [row.linear.growth_rate, row.linear.frequency_hz] for row in loops.robust
    }
    numbers["run"] = _numbers(run)
    return ArticleFinding(
        "robust controller", "Kc is the stabilizing controller", "Appendix A", holds, sentence, numbers
    )


def _outcome(run: Trajectory) -> str:
    word = "is undecided" if run.verdict == "undecided" else run.verdict
    linear = run.linear
    exact = "" if linear is None else f"; exactly {-linear.growth_rate:+z.4f}/s at {linear.frequency_hz:.2f} Hz"
    return word + ("" if run.growth_rate is None else f" (decay {-run.growth_rate:+z.4f}/s{exact})")


def _end(run: Trajectory) -> float:
    return math.nan if run.end_error is None else run.end_error


def _at_last(run: Trajectory) -> float:
    """Largest |r_d − r| in the last second, m."""
    late = run.error[run.time > run.time[-1] - 1.0]
    return float(np.sqrt(np.max(np.sum(late**2, axis=1))))


def _turn(run: Trajectory) -> float:
    return math.nan if run.peak_base_rotation is None else run.peak_base_rotation


def _numbers(run: Trajectory) -> dict[str, Any]:
    return {
        "verdict": run.verdict, "growth_rate": run.growth_rate, "linear_growth_rate": run.linear_growth_rate,
        "end_error": run.end_error,
        "peak_base_rotation": run.peak_base_rotation,
    }  # fmt: skip


def _rate_near(loop: SampledLoop, frequency: float) -> float:
    """Growth rate of the pole nearest to a frequency, Hz."""
    poles = loop.poles
    return float(poles[np.argmin(np.abs(np.abs(poles.imag) / (2 * np.pi) - frequency))].real)
