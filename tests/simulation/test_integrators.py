"""Convergence orders against an independent ODE; what Gauss's method keeps: the symplectic form, and the way back."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from itertools import cycle

import casadi as ca
import numpy as np
import pytest

import flexopt
from flexopt import build_plant
from flexopt.errors import InputError
from flexopt.loop.closed import closed_loop
from flexopt.loop.integrators import StrongDampers
from flexopt.loop.tableaus import classical, dormand_prince, gauss, radau
from flexopt.model import machine_from_dict
from flexopt.plant.machine_motion import motion_of
from flexopt.simulation.scenario import Scenario
from tests.oracles.closed_loop_ode import Loop
from tests.oracles.machines import NumpySource, Structure, draw_machine
from tests.simulation.loops import EXCAVATOR, POSTURE_A, Case, scenario, stable_case, state_matrix

ORDERS = {"rk4": 4, "dop853": 8, "gauss": 6}
# First step in radians of the fastest mode: where the next two halvings show the order above rounding.
FIRST = {"rk4": 0.4, "dop853": 1.6, "gauss": 1.2}


def final(made: Scenario, steps: int) -> np.ndarray:
    """[q, v] after so many samples, step by step in CasADi's virtual machine."""
    loop, x, c = made.loop, made.start, made.constants
    signals = made.signals()
    for k in range(steps):
        x = loop.step(x, ca.DM.zeros(0) if signals is None else signals[k], c)[0]
    shown = loop.outputs(x, ca.DM.zeros(loop.signals.total), c)
    return np.concatenate([shown[0].full().ravel(), shown[1].full().ravel()])


def check_order(errors: list[float], order: int) -> None:
    """The order between the last two errors that rounding (10⁻¹³ and less) does not touch."""
    above = [error for error in errors if error > 5e-13]
    assert len(above) >= 2, errors
    assert above[0] < 1e-3, errors
    measured = math.log2(above[-2] / above[-1])
    # A method may gain on its order over a whole run; it may not lose.
    assert order - 0.4 < measured < order + 1.2, errors


PARTS = [
    {},
    {"feedback": "pid"},
    {"feedback": "pid", "actuator": "servo"},
    {"gravity": True},
    {"paths": True},
]


def both(case: Case, parts: dict, span: float) -> tuple[dict, Loop]:
    """The same loop as options of `simulate` and as the independent ODE."""
    o = case.options
    given = {name: o[name] for name in ("posture", "base", "control", "kp", "kv", "offset")}
    given |= {"nullspace_damping": o.get("nullspace_damping", 0.0)}
    words = {name: given[name] for name in ("base", "control", "kp", "kv", "nullspace_damping")}
    if parts.get("feedback") == "pid":
        ki = 0.5 * o["kp"]
        given |= {"feedback": "pid", "ki": ki}
        words |= {"ki": ki}
    if parts.get("actuator"):
        given |= {"actuator": {"bandwidth_hz": 20.0}}
        words |= {"bandwidth": 2 * math.pi * 20.0}
    if parts.get("gravity"):
        given |= {"gravity": True}
        words |= {"gravity": True}
    loop = Loop(case.machine, np.asarray(o["posture"]), **words)
    if parts.get("paths"):
        far, aside = o["base"] + 0.3 * span, loop.target + np.array([0.4, -0.2]) * span
        given["base_path"] = {"times": [0.0, span], "points": [[o["base"]], [far]]}
        given["target_path"] = {"times": [0.0, span], "points": [loop.target.tolist(), aside.tolist()]}
        base, target = o["base"], loop.target
        loop.base_path = lambda t: base + 0.3 * t
        loop.target_path = lambda t: target + np.array([0.4, -0.2]) * t
    return given, loop


# Methods and what they integrate in turns, each method on the bare loop.
@pytest.mark.parametrize(
    ("method", "parts"),
    [*((method, PARTS[0]) for method in ORDERS), *zip(cycle(ORDERS), PARTS[1:])],
)
def test_order_with_continuous_control(method, parts):
    structure = Structure(3, ("x", "rotation"), (1,))
    case = stable_case(3, structure, "inverse")
    fastest = 2 * math.pi * case.scenario.frequencies_hz[-1]
    span = 12 / fastest
    given, loop = both(case, parts, span)
    exact = loop.run(case.options["offset"], period=span, samples=1, hold=False, exact=True)[-1]
    size, errors = np.abs(exact).max(), list[float]()
    for halvings in range(3):
        steps = math.ceil(fastest * span / FIRST[method]) * 2**halvings
        made = scenario(
            case.machine, **given, hold=False, integrator=method, substeps=1, rate=steps / span, duration=span
        )
        assert made.samples == steps
        errors.append(float(np.abs(final(made, steps) - exact).max() / size))
    check_order(errors, ORDERS[method])


@pytest.mark.parametrize(
    ("method", "parts"),
    [*((method, PARTS[4]) for method in ORDERS), *zip(cycle(ORDERS), (PARTS[1], PARTS[2]))],
)
def test_order_with_a_held_command(method, parts):
    structure = Structure(2, ("x", "y", "rotation"), ())
    case = stable_case(5, structure, "transpose")
    fastest = 2 * math.pi * case.scenario.frequencies_hz[-1]
    samples = 3
    period = 4 / fastest
    given, loop = both(case, parts, samples * period)
    exact = loop.run(case.options["offset"], period=period, samples=samples, exact=True)[-1]
    size, errors = np.abs(exact).max(), list[float]()
    first = math.ceil(4 / FIRST[method])
    for substeps in (first, 2 * first, 4 * first):
        made = scenario(
            case.machine, **given, integrator=method, substeps=substeps, rate=1 / period, duration=samples * period
        )
        errors.append(float(np.abs(final(made, samples) - exact).max() / size))
    check_order(errors, ORDERS[method])


@pytest.mark.long("3-transpose")
@pytest.mark.parametrize(("seed", "control"), list(enumerate(["inverse", "transpose"] * 2)))
# Eight samples: to compile their loop takes longer.
@pytest.mark.usefixtures("interpreted")
def test_accurate_methods_meet_the_ode_on_random_machines(seed, control):
    """At their default steps of 0.7 radians of the fastest mode."""
    structures = [Structure(2, ("y",), ()), Structure(3, ("rotation",), (0,)), Structure(4, ("x", "y"), ()),
                  Structure(5, ("x", "y", "rotation"), (2,))]  # fmt: skip
    case = stable_case(20 + seed, structures[seed], control)
    rate, samples = case.options["rate"], 8
    given, loop = both(case, {}, samples / rate)
    exact = loop.run(case.options["offset"], period=1 / rate, samples=samples, exact=True)[-1]
    for method, bound in (("dop853", 3e-8), ("gauss", 2e-6)):
        made = scenario(case.machine, **given, integrator=method, rate=rate, duration=samples / rate)
        error = np.abs(final(made, samples) - exact).max() / np.abs(exact).max()
        assert error < bound


@pytest.mark.parametrize("stages", [1, 2, 3, 4])
def test_strong_dampers_are_solved_for(stages):
    """(I + h kron(A, D M⁻¹)) x = y as NumPy solves it, dampers from none to very strong ones, some motions undamped."""
    rng, n = np.random.default_rng(stages), 5
    shape = rng.normal(size=(n, n))
    mass = shape @ shape.T + np.eye(n)
    tableau, h = gauss(stages), 0.3
    corrections = StrongDampers(tableau, ca.SX(h))
    for size in (0.0, 1.0, 1e3):
        along = rng.normal(size=(n, 3))
        damping, left = size * along @ along.T, rng.normal(size=(n, stages))
        factors = corrections.factors(ca.SX(mass), ca.SX(damping))
        found = ca.evalf(corrections.corrected(factors, ca.SX(left))).full()
        whole = np.eye(n * stages) + h * np.kron(tableau.a, damping @ np.linalg.inv(mass))
        exact = np.linalg.solve(whole, left.ravel(order="F")).reshape(n, stages, order="F")
        # The square of h B, up to some 1e4, is in the inverses.
        assert np.abs(found - exact).max() < 1e-7 * np.abs(exact).max()


def braked(case: Case, share: float) -> tuple[Case, float]:
    """The case with dampers in its joints that brake the fastest motion in this share of a sample; how fast, 1/s."""
    rate, plant = case.options["rate"], build_plant(case.machine)
    q = plant.rest(case.options["base"], case.options["posture"], plant.parameter_values)
    mass = plant.mass(q, case.options["base"], plant.parameter_values).full()
    n = len(case.options["posture"])
    on_joints = np.linalg.inv(mass)[-n:, -n:]
    unit = 1 / np.diag(on_joints)
    size = rate / share / np.abs(np.linalg.eigvals(on_joints * unit)).max()
    moved = iter(size * unit)
    links = [link if link.get("passive") else link | {"joint_damping": next(moved)} for link in case.data["links"]]
    data = case.data | {"links": links}
    return Case(data, machine_from_dict(data), case.options), rate / share


@pytest.mark.parametrize(
    ("seed", "structure", "control"),
    [(20, Structure(2, ("y",), ()), "inverse"), (21, Structure(3, ("rotation",), (0,)), "transpose"),
     (22, Structure(4, ("x", "y"), ()), "inverse")],
)  # fmt: skip
@pytest.mark.usefixtures("interpreted")
def test_strong_dampers_meet_the_ode(seed, structure, control):
    """Joints braked within a thirtieth of a sample: few steps, few iterations, and the explicit oracle's states."""
    case, damper = braked(stable_case(seed, structure, control), 1 / 30)
    rate, samples = case.options["rate"], 6
    given, loop = both(case, {}, samples / rate)
    exact = loop.run(case.options["offset"], period=1 / rate, samples=samples, exact=True)[-1]
    made = scenario(case.machine, **given, integrator="gauss", rate=rate, duration=samples / rate)
    s = made.loop.structure
    assert s.damped
    # Each iteration of plain ones would have to be as short as half a time constant of the damper.
    assert s.substeps * s.iterations < 0.15 * (2 * damper / rate) * 19
    missed = [np.abs(final(made, samples) - exact).max() / np.abs(exact).max()]
    for more in (2, 4):
        finer = scenario(
            case.machine, **given, integrator="gauss", rate=rate, duration=samples / rate, substeps=more * s.substeps
        )
        missed.append(np.abs(final(finer, samples) - exact).max() / np.abs(exact).max())
    assert missed[0] < 1e-5
    # Order 6 is reached where a step is short against what is braked, and lost before, as of any such method.
    assert missed[2] < missed[0] / 50 or missed[2] < 1e-12


@pytest.mark.parametrize(
    ("seed", "structure", "control"),
    [(20, Structure(2, ("y",), ()), "inverse"), (21, Structure(3, ("rotation",), (0,)), "transpose")],
)  # fmt: skip
@pytest.mark.usefixtures("interpreted")
def test_dampers_of_robot_files_meet_the_ode(seed, structure, control):
    """Joints braked within a thousandth of a sample, as public files say of weightless wrists: as few steps as modes ask."""
    case, damper = braked(stable_case(seed, structure, control), 1e-3)
    rate, samples = case.options["rate"], 6
    given, loop = both(case, {}, samples / rate)
    exact = loop.run(case.options["offset"], period=1 / rate, samples=samples, exact=True)[-1]
    made = scenario(case.machine, **given, integrator="gauss", rate=rate, duration=samples / rate)
    s = made.loop.structure
    assert s.stiff
    assert s.substeps < 1e-2 * damper / rate
    missed = [np.abs(final(made, samples) - exact).max() / np.abs(exact).max()]
    finer = scenario(
        case.machine, **given, integrator="gauss", rate=rate, duration=samples / rate, substeps=4 * s.substeps
    )
    missed.append(np.abs(final(finer, samples) - exact).max() / np.abs(exact).max())
    assert missed[0] < 1e-4
    assert missed[1] < missed[0] / 10 or missed[1] < 1e-7


@pytest.mark.usefixtures("interpreted")
def test_what_a_stiff_base_makes_of_rounding_is_no_change_of_an_iteration():
    """A mode at 906 Hz; towards rest nothing but rounding is left, and the run goes on."""
    source = NumpySource(np.random.default_rng(512))
    machine = machine_from_dict(draw_machine(source, Structure(2, ("x", "y", "rotation"), ())))
    posture = source.uniform(-1, 1), source.uniform(0.5, 1.5)
    assert flexopt.evaluate(machine, posture).frequencies_hz[-1] > 900.0
    run = flexopt.simulate(machine, posture, kp=1e4, kv=320.0, offset=(1e-5, 0.0), duration=0.1, integrator="gauss")
    assert run.end_error < 1e-5


def test_radau_s_method():
    """Coefficients as printed by Hairer and Wanner (1996), IV.5, table 5.6; what is braked at once is at rest after a step."""
    root, tableau = math.sqrt(6), radau()
    printed = [
        [(88 - 7 * root) / 360, (296 - 169 * root) / 1800, (-2 + 3 * root) / 225],
        [(296 + 169 * root) / 1800, (88 + 7 * root) / 360, (-2 - 3 * root) / 225],
        [(16 - root) / 36, (16 + root) / 36, 1 / 9],
    ]
    np.testing.assert_allclose(tableau.a, printed, atol=1e-15)
    np.testing.assert_array_equal(tableau.b, tableau.a[-1])

    def after(z):
        return 1 + z * tableau.b @ np.linalg.solve(np.eye(3) - z * tableau.a, np.ones(3))

    assert abs(after(-1e6)) < 1e-5
    assert abs(after(-0.1) - math.exp(-0.1)) < 1e-9
    # Of a mode at the longest step that is taken for one: no damping that a run could show.
    assert 1 - 2e-7 < abs(after(0.3j)) < 1


def test_iterations_for_strong_dampers_end_where_plain_ones_do():
    """The same step of the same method: what is iterated towards does not change."""
    case, _ = braked(stable_case(21, Structure(3, ("rotation",), (0,)), "inverse"), 1 / 8)
    rate = case.options["rate"]
    given, _ = both(case, {}, 4 / rate)
    made = scenario(case.machine, **given, integrator="gauss", rate=rate, duration=4 / rate, substeps=24)
    ends = [
        final(replace(made, loop=closed_loop(replace(made.loop.structure, damped=damped, iterations=60))), 4)
        for damped in (False, True)
    ]
    assert np.abs(ends[0] - ends[1]).max() < 1e-12 * np.abs(ends[0]).max()


@pytest.mark.parametrize("method", ["rk4", "dop853"])
def test_explicit_steps_too_long_for_a_damper_are_refused(method):
    """With as many as the message says no motion about equilibrium grows that decays, with one less one does."""
    case, damper = braked(stable_case(20, Structure(2, ("y",), ()), "inverse"), 1 / 30)
    given = case.options | {"integrator": method, "duration": 60 / case.options["rate"]}
    del given["substeps"]
    with pytest.raises(InputError, match=f"{method.upper()} is unstable for the dampers") as caught:
        scenario(case.machine, **given, substeps=1)
    told = float(re.search(r"brake a motion at (\S+) 1/s", str(caught.value))[1])
    # Springs and the base's dampers are in the pole.
    assert told == pytest.approx(damper, rel=0.01)
    need = int(str(caught.value).split("at least ")[1].split(",")[0])
    free = given | {"feedback": "none"}
    made = scenario(case.machine, **free, substeps=need)
    assert np.abs(np.linalg.eigvals(state_matrix(made))).max() < 1 + 1e-6
    loop = closed_loop(replace(made.loop.structure, substeps=need - 1))
    one_less = replace(made, loop=loop, parts=dict(made.parts) | {"h": made.period / (need - 1)})
    assert np.abs(np.linalg.eigvals(state_matrix(one_less))).max() > 1.01
    # Of itself it takes as many, and more, as masses change along the way.
    own = scenario(case.machine, **given)
    assert own.loop.structure.substeps == 2 * need
    assert np.abs(final(own, 60)).max() < 10


def conservative(seed: int, structure: Structure) -> Scenario:
    """No dampers, no controller; gravity acts and is not compensated at all."""
    rng = np.random.default_rng(seed)
    data = draw_machine(NumpySource(rng), structure, spread=30.0, damping_ratio=0.0, joint_damping=False)
    n = structure[0] - len(structure[2])
    return scenario(
        machine_from_dict(data), posture=0.5 + 0.3 * np.arange(n), offset=0 * np.arange(n), feedback="none",
        integrator="gauss", gravity=False, rate=50.0, duration=1.0,
    )  # fmt: skip


def canonical(made: Scenario, method: str, h: float) -> tuple[ca.Function, ca.Function]:
    """The step and its Jacobian in (u, p = M w), p in units that make u and p alike."""
    structure = replace(made.loop.structure, method=method, substeps=1, iterations=30)
    loop = replace(made.loop, structure=structure)
    motion = motion_of(structure.motion, {name: ca.SX(x) for name, x in made.parts.items() if np.ndim(x) == 0})
    n = motion.n
    u, w, p = (ca.SX.sym(name, n) for name in "uwp")
    angles = motion.angles(u)
    along = motion.with_base([(ca.cos(angles[k]), ca.sin(angles[k])) for k in range(angles.shape[0])])
    plant = build_plant(made.machine)
    unit = float(np.trace(plant.mass(made.q_design, made.base, plant.parameter_values).full())) / n / h
    to_rates = ca.Function("to_rates", [u, p], [motion.rates_of_momentum(u, unit * p, along)])
    to_momentum = ca.Function("to_momentum", [u, w], [motion.momentum(u, w, along) / unit])
    c = made.constants.copy()
    c[loop.constants.slices["h"]] = h
    start, here = ca.MX.sym("u", n), ca.MX.sym("p", n)
    after = loop.step(ca.vertcat(start, to_rates(start, here)), ca.DM.zeros(0), c)[0]
    end = ca.vertcat(after[:n], to_momentum(after[:n], after[n : 2 * n]))
    both = ca.vertcat(start, here)
    at = ca.MX.sym("at", 2 * n)
    step = ca.Function("canonical", [start, here], [end, ca.jacobian(end, both)])
    return ca.Function("of", [at], list(step(at[:n], at[n:]))), to_momentum


SYMPLECTIC = [Structure(2, ("x", "y", "rotation"), ()), Structure(3, ("x",), (1,)), Structure(3, ("y", "rotation"), ())]


@pytest.mark.parametrize("structure", SYMPLECTIC, ids=str)
def test_gauss_keeps_the_symplectic_form_and_rk4_does_not(structure):
    made = conservative(3, structure)
    h = 1.0 / (2 * math.pi * made.frequencies_hz[-1])
    rng = np.random.default_rng(0)
    n = len(made.q_design)
    omega = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])
    left = {}
    for method in ("gauss", "rk4"):
        step, to_momentum = canonical(made, method, h)
        w = rng.uniform(-1, 1, n)
        u = made.start[:n] + 0.05 * rng.uniform(-1, 1, n)
        at = np.concatenate([u, to_momentum(u, w).full().ravel()])
        jacobian = step(at)[1].full()
        # Rounding of the Jacobian's entries, which differ in size by the spread of the inertias.
        size = np.linalg.norm(jacobian) ** 2
        left[method] = np.linalg.norm(jacobian.T @ omega @ jacobian - omega) / size
    assert left["gauss"] < 1e-12
    assert left["rk4"] > 1e-6


@pytest.mark.parametrize("structure", SYMPLECTIC, ids=str)
def test_gauss_goes_back_the_way_it_came_and_rk4_does_not(structure):
    """Symmetric method, reversible machine: turn the rates round and the start comes back, rates turned round."""
    made = conservative(4, structure)
    h = 1.0 / (2 * math.pi * made.frequencies_hz[-1])
    rng = np.random.default_rng(1)
    n = len(made.q_design)
    x0 = np.concatenate([made.start[:n] + 0.05 * rng.uniform(-1, 1, n), rng.uniform(-1, 1, n)])
    turned = np.concatenate([np.ones(n), -np.ones(n)])
    missed = {}
    for method in ("gauss", "rk4"):
        loop = replace(made.loop, structure=replace(made.loop.structure, method=method, substeps=1, iterations=30))
        c = made.constants.copy()
        c[loop.constants.slices["h"]] = h
        x = x0
        for _ in range(2):
            for _ in range(10):
                x = loop.step(x, ca.DM.zeros(0), c)[0].full().ravel()
            x = x * turned
        missed[method] = np.abs(x - x0).max()
    assert missed["gauss"] < 1e-11
    assert missed["rk4"] > 1e-5


@pytest.mark.parametrize(("tableau", "order"), [(classical(), 4), (dormand_prince(), 8), (gauss(), 6), (gauss(2), 4)])
def test_tableaus_meet_the_conditions_of_their_order(tableau, order):
    """Quadrature: Σ b c^(k−1) = 1/k for k ≤ p, and not beyond; rows sum to c; exp to order p on the linear equation."""
    np.testing.assert_allclose(tableau.a.sum(axis=1), tableau.c, atol=1e-15)
    for k in range(1, order + 1):
        assert tableau.b @ tableau.c ** (k - 1) == pytest.approx(1 / k, abs=1e-15)
    power = np.ones(len(tableau.b))
    for k in range(1, order + 1):
        assert tableau.b @ power == pytest.approx(1 / math.factorial(k), rel=1e-12)
        power = tableau.a @ power
    assert abs(tableau.b @ power - 1 / math.factorial(order + 1)) > 1e-9


@pytest.mark.parametrize("stages", [1, 2, 3])
def test_gauss_is_symplectic_by_its_coefficients(stages):
    """b_i a_ij + b_j a_ji = b_i b_j (Sanz-Serna 1988), and |R(iω)| = 1."""
    t = gauss(stages)
    weighted = t.b[:, None] * t.a
    np.testing.assert_allclose(weighted + weighted.T, np.outer(t.b, t.b), atol=1e-16)
    for reach in (0.1, 1.0, 10.0):
        z = 1j * reach
        growth = 1 + z * t.b @ np.linalg.solve(np.eye(stages) - z * t.a, np.ones(stages))
        assert abs(growth) == pytest.approx(1.0, abs=1e-14)


def test_iterations_converge_at_the_default_step():
    """The residual that the implicit method leaves on the excavator, hard driven."""
    made = scenario(EXCAVATOR, posture=POSTURE_A, integrator="gauss", duration=0.5)
    x, worst = made.start, 0.0
    for _ in range(made.samples):
        x, monitor = made.loop.step(x, ca.DM.zeros(0), made.constants)
        worst = max(worst, float(monitor[-1]))
    assert math.sqrt(worst) < 1e-14
