"""ε_max of postures: against SciPy's Riccati solver, closed forms and the article; gradients against differences."""

import re
import warnings
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import scipy.linalg
from scipy.optimize import minimize

import flexopt
from flexopt.robustness.margin import build_margin
from tests.oracles.gradient_cases import cases
from tests.oracles.machines import random_machine

GAIN = 5e5
# The rounding of ε_max, 1e-12 on badly conditioned machines, over the differences' best step.
NOISE = 5e-9
CONTROLS = ["inverse", "transpose"]


@pytest.fixture(scope="module")
def excavator():
    return flexopt.load("excavator")


def scipy_epsilons(margin, base, posture, p, gain):
    """(1 + λ)^(−1/2) of the two largest eigenvalues of XZ, ascending, by SciPy on the scaled plant."""
    held = margin.hold.call([base, posture, p, gain])
    a, b, c = (x.full() for x in margin.scaled_plant.call([base, posture, p, gain, *held]))
    unit = np.eye(b.shape[1])
    x = scipy.linalg.solve_continuous_are(a, b, c.T @ c, unit)
    z = scipy.linalg.solve_continuous_are(a.T, c.T, b @ b.T, unit)
    return np.sort((1 + np.sort(np.linalg.eigvals(x @ z).real)[-2:]) ** -0.5)


def damped(machine):
    """The same machine with 2 % modal damping or so: undamped modes that the arm hardly moves have no stable loop."""
    data = machine.to_dict()
    stiffness = data["base"].get("stiffness", {})
    data["base"] = data["base"] | {"damping": {k: 1e-3 * v for k, v in stiffness.items()}}
    data["links"] = [
        link | ({"damping": 1e-3 * link["stiffness"]} if link.get("passive") else {}) for link in data["links"]
    ]
    return flexopt.machine_from_dict(data)


def natural_gain(machine, control, posture):
    """A gain that puts the rigid part's crossing near the first mode."""
    margin = build_margin(machine, control)
    measures = flexopt.build_measures(machine, control)
    v = measures.values(base=0, posture=posture, p=margin.plant.parameter_values)
    return float(v["omega_squared"][0]) / float(np.linalg.norm(v["rigid"].full()))


@pytest.mark.parametrize("control", CONTROLS)
def test_random_postures_of_the_excavator_against_scipy(excavator, control):
    margin = build_margin(excavator, control)
    p = margin.plant.parameter_values
    rng = np.random.default_rng(1)
    for _ in range(25):
        posture = [rng.uniform(-3, 3), rng.choice([-1, 1]) * rng.uniform(0.2, 2.9)]
        gain = 10 ** rng.uniform(3, 7)
        epsilon, rest, residual = (x.full().ravel() for x in margin.values.call([0, posture, p, gain]))
        assert max(rest[0], residual[0]) < 1e-9
        np.testing.assert_allclose(epsilon, scipy_epsilons(margin, 0, posture, p, gain), rtol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("control", CONTROLS)
def test_random_machines_against_scipy(control):
    compared = 0
    for case in cases(seed=5, count=40, m_max=3):
        machine = damped(case.machine)
        margin = build_margin(machine, control)
        p, gain = margin.plant.parameter_values, natural_gain(machine, control, case.posture)
        epsilon, _, residual = (x.full().ravel() for x in margin.values.call([0, case.posture, p, gain]))
        if residual[0] < 1e-9:
            # A residual of 1e-9 times the conditioning of lightly damped plants, in either solver. The second eigenvalue
            # is as good as the third one is far.
            reference = scipy_epsilons(margin, 0, case.posture, p, gain)
            assert epsilon[0] == pytest.approx(reference[0], rel=1e-7)
            assert epsilon[1] == pytest.approx(reference[1], rel=1e-5)
            compared += 1
    assert compared >= 35


def test_the_graph_agrees_with_the_general_solver(excavator):
    margin = build_margin(excavator, "inverse")
    for posture in ([0.9929, -2.6306], [0.0448, -2.0499], [1.2, 0.4], [-2.0, 1.1]):
        a, b, c = (x.full() for x in margin.physical_plant.call([0, posture, margin.plant.parameter_values]))
        general = flexopt.robust_margin(a, GAIN * b, c)
        ours = margin.values.call([0, posture, margin.plant.parameter_values, GAIN])[0].full()[0, 0]
        assert ours == pytest.approx(float(general), rel=1e-9)


@pytest.mark.long
def test_the_left_out_self_motion_changes_nothing(excavator):
    """The transfer function of a redundant arm from 2 (m + 2) states equals that of the whole plant."""
    data = excavator.to_dict()
    bucket = {"name": "bucket", "length": 0.6, "com": 0.3, "mass": 150.0, "inertia": 12.0}
    redundant = flexopt.machine_from_dict(data | {"links": [*data["links"], bucket]})
    posture = np.array([0.7, -1.2, 0.4])
    for control in CONTROLS:
        margin = build_margin(redundant, control)
        assert margin.n_states == 2 * (3 + 2)
        p = margin.plant.parameter_values
        a, b, c = (x.full() for x in margin.physical_plant.call([0, posture, p]))
        full = [x.full() for x in margin.plant.linearisation(control).call([0, posture, p])]
        for s in (3j, 20 + 40j, 100j):
            reduced = c @ np.linalg.solve(s * np.eye(len(a)) - a, b)
            whole = full[2] @ np.linalg.solve(s * np.eye(len(full[0])) - full[0], full[1])
            np.testing.assert_allclose(reduced, whole, rtol=1e-9, atol=1e-12 * np.abs(whole).max())
        evaluation = flexopt.evaluate(redundant, posture, control=control)
        assert evaluation.self_motion_unstabilised
        assert 0 < evaluation.epsilon_max < 1
        with pytest.raises(flexopt.NotStabilizable):
            flexopt.robust_margin(*full)


def test_joint_damping_of_a_redundant_arm_keeps_every_rate(excavator):
    data = excavator.to_dict()
    bucket = {"name": "bucket", "length": 0.6, "com": 0.3, "mass": 150.0, "inertia": 12.0}
    links = [link | {"joint_damping": 200.0} for link in (*data["links"], bucket)]
    machine = flexopt.machine_from_dict(data | {"links": links})
    for control in CONTROLS:
        margin = build_margin(machine, control)
        assert margin.n_states == 3 + 3 + 3 + 2
        posture = np.array([0.7, -1.2, 0.4])
        p = margin.plant.parameter_values
        a, b, c = (x.full() for x in margin.physical_plant.call([0, posture, p]))
        full = [x.full() for x in margin.plant.linearisation(control).call([0, posture, p])]
        for s in (3j, 20 + 40j, 100j):
            reduced = c @ np.linalg.solve(s * np.eye(len(a)) - a, b)
            whole = full[2] @ np.linalg.solve(s * np.eye(len(full[0])) - full[0], full[1])
            np.testing.assert_allclose(reduced, whole, rtol=1e-9, atol=1e-12 * np.abs(whole).max())


def test_table_2_and_the_gain_it_implies(excavator):
    """Posture A's 0.2869 fixes the gain that the article does not print; posture B is then the check."""
    postures = {k: flexopt.inverse_kinematics(excavator, (0.0, 1.6), base=b)[0] for k, b in (("A", 0.0), ("B", -1.5))}
    assert flexopt.evaluate(excavator, postures["A"], gain=5e5).epsilon_max == pytest.approx(0.2869, abs=5e-4)
    assert flexopt.evaluate(excavator, postures["B"], gain=5e5).epsilon_max == pytest.approx(0.3826, abs=5e-4)
    at_other_reading = flexopt.inverse_kinematics(excavator, (1.5575 + 0.1733, 1.087 + 0.5126))[0]
    assert flexopt.evaluate(excavator, at_other_reading).epsilon_max == pytest.approx(0.3826, abs=5e-5)


def test_the_bound_of_a_double_integrator_is_exceeded_slightly(excavator):
    epsilon = flexopt.evaluate(excavator, [0.992, -1.4056]).epsilon_max
    assert np.sin(np.pi / 8) < epsilon == pytest.approx(0.38279, abs=5e-6)


def difference(f, exact):
    """Central difference of fourth order, the best of four steps: truncation at one end, rounding at the other."""
    steps = (1e-3, 4e-4, 1.5e-4, 6e-5)
    found = [(8 * (f(h) - f(-h)) - (f(2 * h) - f(-2 * h))) / (12 * h) for h in steps]
    return min(found, key=lambda value: abs(value - exact))


def fitted_slope(f, reach=2e-3, count=400):
    """Slope at 0 of the polynomial of degree 8 fitted to f at Chebyshev points within `reach`."""
    points = reach * np.cos(np.pi * (np.arange(count) + 0.5) / count)
    fit = np.polynomial.chebyshev.Chebyshev.fit(points, [f(h) for h in points], 8, domain=[-reach, reach])
    return float(fit.deriv()(0.0))


def regular_cases(control, count):
    """Margin, posture, p and gain of random damped machines, away from kinks."""
    for case in cases(seed=11, count=count, m_max=3):
        machine = damped(case.machine)
        margin = build_margin(machine, control)
        p, gain = margin.plant.parameter_values.full().ravel(), natural_gain(machine, control, case.posture)
        epsilon, _, residual = (x.full().ravel() for x in margin.values.call([0, case.posture, p, gain]))
        if residual[0] < 1e-10 and epsilon[1] - epsilon[0] > 1e-3:
            yield margin, case.posture, p, gain


def gradient_errors(control, count):
    """(relative error, size) of the gradient by posture along a random direction, a pair for each case."""
    for number, (margin, posture, p, gain) in enumerate(regular_cases(control, count)):
        slope = margin.gradients.call([0, posture, p, gain])[1].full()[0, 1:]
        direction = np.random.default_rng(number).normal(size=len(posture))
        exact, size = slope @ direction, np.linalg.norm(slope) * np.linalg.norm(direction)

        def along(h, margin=margin, z=posture, d=direction, p=p, gain=gain):
            return float(margin.values.call([0, z + h * d, p, gain])[0][0])

        error = abs(difference(along, exact) - exact) / size
        if error > 1e-8:
            # Rounding, or truncation: a polynomial through many points averages the one and has little of the other.
            error = min(error, abs(fitted_slope(along) - exact) / size)
        yield error, size


@pytest.mark.long
@pytest.mark.parametrize("control", CONTROLS)
def test_gradient_by_posture_over_random_machines(control):
    """Some 40 machines and postures for each controller; `python -m benchmarks.margin_accuracy` tries 200."""
    found = list(gradient_errors(control, 54))
    assert len(found) >= 40
    assert max(error for error, _ in found) <= 1e-7


@pytest.mark.long
@pytest.mark.parametrize("control", CONTROLS)
def test_gradient_by_parameters_and_gain(control):
    for number, (margin, posture, p, gain) in enumerate(regular_cases(control, 40)):
        _, by_z, by_p, by_kr = (x.full() for x in margin.gradients.call([0, posture, p, gain]))
        k = int(np.random.default_rng(number).integers(len(p)))
        unit = np.eye(len(p))[k] * (abs(p[k]) or 1e-3)

        def value(parameters, kr, margin=margin, z=posture):
            return float(margin.values.call([0, z, parameters, kr])[0][0])

        exact = by_p[0] @ unit
        by_parameter = difference(lambda h, u=unit, p=p, g=gain, f=value: f(p + h * u, g), exact)
        assert abs(by_parameter - exact) <= 1e-7 * abs(exact) + NOISE
        exact = by_kr[0, 0] * gain
        by_gain = difference(lambda h, p=p, g=gain, f=value: f(p, g * (1 + h)), exact)
        assert abs(by_gain - exact) <= 1e-7 * abs(exact) + NOISE
        assert by_z[0, 0] == pytest.approx(0.0, abs=1e-15)


def test_under_gravity_the_gradient_is_exact_too(excavator):
    margin = build_margin(excavator, "inverse", gravity=True)
    p, posture = margin.plant.parameter_values, np.array([0.9, -1.9])
    by_z = margin.gradients.call([0, posture, p, GAIN])[1].full()
    h = 1e-5
    for k, d in enumerate(np.eye(2)):
        high, low = (float(margin.values.call([0, posture + s * h * d, p, GAIN])[0][0]) for s in (1, -1))
        assert by_z[0, 1 + k] == pytest.approx((high - low) / (2 * h), rel=1e-6)


def test_at_a_kink_both_directional_derivatives_are_right(excavator):
    """Where the two largest eigenvalues of XZ meet, one-sided differences in any direction against the 2 × 2 rule."""
    margin = build_margin(excavator, "inverse")
    p = margin.plant.parameter_values

    def gap(x):
        low, high = margin.values.call([0, x, p, GAIN])[0].full().ravel()
        return high - low

    meeting = minimize(gap, [-0.588, -1.245], method="Nelder-Mead", options={"xatol": 1e-12, "fatol": 1e-16}).x
    assert gap(meeting) < 1e-12
    with pytest.warns(flexopt.FlexoptWarning, match="kink"):
        evaluation = flexopt.evaluate(excavator, meeting, gain=GAIN)
    assert evaluation.gradient.epsilon_max_kink is not None
    h = 1e-6
    for angle in np.linspace(0, 2 * np.pi, 13):
        direction = np.array([0.0, np.cos(angle), np.sin(angle)])
        moved = margin.values.call([0, meeting + h * direction[1:], p, GAIN])[0].full().ravel()
        slopes = (moved - evaluation.epsilon_max) / h
        # The step's own curvature and the rounding over it.
        np.testing.assert_allclose(slopes, evaluation.gradient.epsilon_max_along(direction), atol=3e-6)


def test_where_the_rigid_part_rules_values_that_never_meet_are_no_kink(excavator):
    """At large gains both values come close to sin(π/8), and ε_max is smooth: its two one-sided differences agree."""
    direction, h = np.array([0.6, 0.8]), 1e-3
    for posture in ([0.5, -1.1], [0.9, -1.6], [1.2, -2.1]):
        at, high, low = (flexopt.evaluate(excavator, posture + s * h * direction, gain=1e14) for s in (0, 1, -1))
        margin = build_margin(excavator, "inverse")
        first, second = margin.values.call([0, posture, margin.plant.parameter_values, 1e14])[0].full().ravel()
        assert 0 <= second - first < 1e-7
        assert (at.warnings, at.gradient.epsilon_max_kink) == ((), None)
        slopes = [(high.epsilon_max - at.epsilon_max) / h, (at.epsilon_max - low.epsilon_max) / h]
        told = at.gradient.epsilon_max_along(np.array([0.0, *direction]))
        np.testing.assert_allclose(slopes, told, rtol=3e-2, atol=1e-11)


def test_a_table_without_gradients_does_not_warn_of_them(excavator):
    """At a kink: what is told of the gradient stands in the evaluation."""
    problem = flexopt.select(excavator, (0.0, 1.6), workers=1)
    margin = build_margin(excavator, "inverse")

    def gap(x):
        low, high = margin.values.call([0, x, margin.plant.parameter_values, GAIN])[0].full().ravel()
        return high - low

    meeting = minimize(gap, [-0.588, -1.245], method="Nelder-Mead", options={"xatol": 1e-12, "fatol": 1e-16}).x
    z = np.array([0.0, *meeting])
    evaluate = partial(problem.problem.quantities.evaluated, z)
    candidate = replace(problem.best, z=z, evaluate=evaluate)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        repr(replace(problem, best=candidate, candidates=(candidate,)))
    assert any("kink" in sentence for sentence in candidate.evaluation.warnings)


def test_the_two_vector_step_is_right_where_one_vector_is_not(excavator):
    """Near the optima the two largest eigenvalues of XZ nearly coincide (5.86 and 5.79)."""
    margin = build_margin(excavator, "inverse")
    p = margin.plant.parameter_values
    posture = [0.0448, -2.0499]
    ours = margin.values.call([0, posture, p, GAIN])[0].full().ravel()
    np.testing.assert_allclose(ours, scipy_epsilons(margin, 0, posture, p, GAIN), rtol=1e-10)
    lambdas = ours**-2 - 1
    assert lambdas[1] / lambdas[0] > 0.98


def test_generates_to_c_without_malloc_and_with_one_doubling_in_a_loop(excavator, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    margin = build_margin(excavator, "inverse")
    margin.values.generate("margin.c")
    source = (tmp_path / "margin.c").read_text()
    assert not re.search(r"\b(malloc|calloc|realloc)\s*\(", source)
    # One doubling is some 17,000 instructions; unrolled they would be 22 times that.
    assert source.count("\n") < 150_000
    margin.gradients.generate("gradients.c")
    assert "malloc(" not in (tmp_path / "gradients.c").read_text()


def test_an_unreachable_mode_is_said_and_not_nan(excavator):
    """With no damping, a base direction that the arm cannot move at all cannot be stabilised."""
    data = excavator.to_dict()
    data["base"] = data["base"] | {"stiffness": {"rotation": 1e6}, "damping": {}, "length": 0.0}
    data["links"] = [link | {"com": 0.0} for link in data["links"]]
    machine = flexopt.machine_from_dict(data)
    with pytest.warns(flexopt.FlexoptWarning, match="ε_max"):
        evaluation = flexopt.evaluate(machine, [0.5, np.pi / 2])
    assert evaluation.epsilon_max is None or 0 < evaluation.epsilon_max < 1


@pytest.mark.long
def test_random_structures_always_give_a_number_or_a_sentence():
    rng = np.random.default_rng(3)
    for _ in range(30):
        _, machine = random_machine(rng)
        posture = rng.uniform(0.3, 1.2, len(machine.joints))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            evaluation = flexopt.evaluate(machine, posture)
        if evaluation.epsilon_max is None:
            assert any("ε_max" in str(w.message) for w in caught)
        else:
            assert 0 < evaluation.epsilon_max < 1
