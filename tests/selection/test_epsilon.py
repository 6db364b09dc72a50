"""Selection by ε_max, by mixes and in order of importance: never below a dense scan, kinks and all."""

import casadi as ca
import numpy as np
import pytest

import flexopt
from flexopt.robustness.margin import build_margin
from flexopt.selection.nlp.configuration import build_configuration

TARGET = (0.0, 1.6)


@pytest.fixture(scope="module")
def machine():
    return flexopt.load("excavator")


def dense_scan(machine, target, control, count=1000):
    """ε_max of `count` placements on both branches, evenly spaced in x: not the scan that the solver starts from."""
    margin = build_margin(machine, control)
    best = 0.0
    for elbow in ("up", "down"):
        for x in np.linspace(-3.0, 2.7, count // 2):
            try:
                posture = flexopt.inverse_kinematics(machine, target, base=x, elbow=elbow)[0]
            except flexopt.UnreachableTarget:
                continue
            if abs(np.sin(posture[1])) >= np.sin(np.radians(10)):
                value = margin.values.call([x, posture, margin.plant.parameter_values, 5e5])[0].full()[0, 0]
                best = max(best, value)
    return best


@pytest.mark.long
@pytest.mark.parametrize("control", ["inverse", "transpose"])
def test_never_below_a_scan_of_a_thousand_points(machine, control):
    selection = flexopt.select(machine, TARGET, objective="epsilon_max", control=control)
    assert selection.best.evaluation.epsilon_max >= dense_scan(machine, TARGET, control)
    # The program's graphs are in doubles, the evaluation's bound is proven beyond them.
    assert selection.best.objective == pytest.approx(selection.best.evaluation.epsilon_max, rel=1e-10)
    assert selection.best.stationarity < 1e-6


@pytest.mark.long
@pytest.mark.parametrize("target", [(0.0, 0.9), (0.4, 2.4), (-0.3, -0.6)])
def test_every_peak_of_the_scan_is_improved_or_kept(machine, target):
    problem = flexopt.build_selection(machine, target, objective="epsilon_max")
    selection = flexopt.solve_selection(problem)
    assert selection.best.objective >= problem.scan.objective.max() - 1e-12


@pytest.mark.long
def test_a_mix_lies_between_its_parts(machine):
    by_w = flexopt.select(machine, TARGET, objective="w1")
    by_epsilon = flexopt.select(machine, TARGET, objective="epsilon_max")
    mixed = flexopt.select(machine, TARGET, objective="V", weights=(1.0, 0.0, 0.0, 1e-3))
    e = mixed.best.evaluation
    assert mixed.best.objective == pytest.approx(e.w[0] + 1e-3 * e.epsilon_max, rel=1e-12)
    for other in (by_w.best.evaluation, by_epsilon.best.evaluation):
        assert mixed.best.objective >= other.w[0] + 1e-3 * other.epsilon_max - 1e-15


@pytest.mark.long
def test_in_order_of_importance(machine):
    first = flexopt.select(machine, TARGET, objective="w1")
    both = flexopt.select(machine, TARGET, objective="w1,epsilon_max")
    slack = 1e-4 * both.problem.objective_scales[0]
    assert both.best.evaluation.w[0] >= first.best.evaluation.w[0] - 1.01 * slack
    among = [c.evaluation.epsilon_max for c in first.candidates if c.evaluation.w[0] >= -slack]
    assert both.best.evaluation.epsilon_max >= max(among)
    assert "kept w1" in both.best.active


def test_ties_in_w_go_to_the_larger_margin(machine):
    """With every other w_i equal too (they are the objective's own), ε_max decides."""
    selection = flexopt.select(machine, TARGET, objective="V", weights=(1.0, 1.0, 1.0))
    ranked = [(c.objective, c.evaluation.epsilon_max) for c in selection.candidates]
    assert ranked == sorted(ranked, key=lambda pair: -pair[0])


@pytest.mark.long
def test_the_gain_matters(machine):
    soft = flexopt.select(machine, TARGET, objective="epsilon_max", gain=1e4)
    hard = flexopt.select(machine, TARGET, objective="epsilon_max", gain=5e5)
    assert abs(soft.best.evaluation.base[0] - hard.best.evaluation.base[0]) > 1e-3


@pytest.mark.long
@pytest.mark.parametrize("control", ["inverse", "transpose"])
def test_a_mix_is_climbed_on_its_own_slope(machine, control):
    """The modes turn with the posture: with the slope of held ones no start led to an optimum."""
    problem = flexopt.build_selection(machine, TARGET, objective="V", weights=(1.0, 0.3, 0.3, 1e-3), control=control)
    selection = flexopt.solve_selection(problem)
    assert selection.best.objective >= problem.scan.objective.max()
    assert all("optimum" in attempt.outcome for attempt in selection.attempts)


def test_functions_of_held_modes_cannot_be_differentiated(machine):
    expansion = build_configuration(machine).expansion
    for function in (expansion.value, expansion.slope, expansion.curvature):
        symbols = function.mx_in()
        with pytest.raises(RuntimeError, match="erivative"):
            ca.Function("wrong", symbols, [ca.jacobian(function.call(symbols)[0], symbols[1])])
