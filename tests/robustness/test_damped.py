"""Damped residues against the partial fractions of the plant A, B, C by mpmath, and against differences."""

from __future__ import annotations

from itertools import pairwise

import mpmath
import numpy as np
import pytest
from hypothesis import assume, given, settings

from flexopt import InputError, build_plant, evaluate, load
from flexopt.model import machine_from_dict
from tests.oracles.gradient_cases import omega_squared, relative_gap
from tests.oracles.machines import NumpySource, Structure, draw_machine, machines, regular_posture, seeds

# Undamped, random and nearly singular plants may leave ε_max unsolved, which is warned of; nothing here is about it.
pytestmark = pytest.mark.filterwarnings("ignore:ε_max:flexopt.errors.FlexoptWarning")
CONTROLS = pytest.mark.parametrize("control", ["inverse", "transpose"])
STRUCTURES = [
    Structure(2, ("x", "y", "rotation"), ()),
    Structure(2, ("rotation",), ()),
    Structure(3, ("x", "rotation"), ()),
    Structure(3, ("y",), (1,)),
    Structure(4, ("x", "y", "rotation"), (3,)),
]


def underdamped(machine, posture):
    """Whether every vibration keeps a complex pair with ζ < 0.9, by NumPy's eigenvalues of A."""
    plant = build_plant(machine)
    a = plant.linearisation("transpose")(0.0, posture, plant.parameter_values)[0].full()
    values, lowest = np.linalg.eigvals(a), np.sqrt(omega_squared(machine, posture)[0])
    # The double poles at zero come out as a cloud of radius 1e-8 or so of the largest.
    vibrating = (values.imag > 0.44 * np.abs(values)) & (np.abs(values) > 0.2 * lowest)
    return vibrating.sum() == plant.n_passive


def case(structure, seed, **options):
    """A machine with well separated frequencies, at a regular posture."""
    rng = np.random.default_rng(seed)
    while True:
        data = draw_machine(NumpySource(rng), structure, **options)
        machine = machine_from_dict(data)
        posture = regular_posture(rng, machine, 10.0)
        if relative_gap(omega_squared(machine, posture)) > 0.05 and underdamped(machine, posture):
            return machine, posture


def partial_fractions(machine, posture, control):
    """Poles with positive imaginary part by size, and N0, N1 of their pairs, from A, B, C in 40 digits."""
    plant = build_plant(machine)
    matrices = [x.full() for x in plant.linearisation(control)(0.0, posture, plant.parameter_values)]
    with mpmath.workdps(40):
        a, b, c = (mpmath.matrix(x.tolist()) for x in matrices)
        values, left, right = mpmath.eig(a, left=True, right=True)
        largest = max(abs(v) for v in values)
        chosen = sorted(
            (k for k in range(len(values)) if values[k].imag > 1e-6 * largest), key=lambda k: abs(values[k])
        )
        poles, n0, n1 = [], [], []
        for k in chosen:
            row, column = left[k, :], right[:, k]
            rho = (c * column) * (row * b) / (row * column)[0]
            poles.append(complex(values[k]))
            entries = [[rho[i, j] for j in range(2)] for i in range(2)]
            n1.append([[float(2 * e.real) for e in line] for line in entries])
            n0.append([[float(-2 * (e * values[k].conjugate()).real) for e in line] for line in entries])
    return np.array(poles), np.array(n0), np.array(n1)


@pytest.mark.long("(4, ('x', 'y', 'rotation'), (3,))-True-inverse", "(4, ('x', 'y', 'rotation'), (3,))-True-transpose")
@CONTROLS
@pytest.mark.parametrize("joint_damping", [False, True])
@pytest.mark.parametrize("structure", STRUCTURES, ids=str)
def test_numerators_equal_the_partial_fractions_of_the_plant(structure, joint_damping, control):
    machine, posture = case(structure, 3, damping_ratio=0.3, joint_damping=joint_damping)
    result = evaluate(machine, posture, control=control, damped=True)
    poles, n0, n1 = partial_fractions(machine, posture, control)
    d = result.damped
    assert len(poles) == len(d.poles) == build_plant(machine).n_passive
    # A holds M⁻¹K in doubles: its rounding is some 1e-16 cond M of the largest pole.
    size = np.abs(poles).max()
    assert np.abs(d.poles - poles).max() <= 1e-11 * size
    assert np.linalg.norm(d.n0 - n0) <= 1e-9 * np.linalg.norm(n0)
    assert np.linalg.norm(d.n1 - n1) <= 1e-9 * (np.linalg.norm(n1) + np.linalg.norm(n0) / size)
    smallest = [np.linalg.eigvalsh(n + n.T)[0] for n in n0]
    assert np.abs(result.w - smallest).max() <= 1e-9 * np.linalg.norm(n0)
    assert np.allclose(result.damping_ratios, -poles.real / np.abs(poles), rtol=0, atol=1e-10)
    assert np.allclose(2 * np.pi * result.frequencies_hz, np.abs(poles), rtol=1e-9)


@CONTROLS
@settings(derandomize=True, max_examples=8)
@given(drawn=machines({"n_max": 3, "m_max": 3}, joint_damping=False, damping_ratio=0.1), seed=seeds)
def test_pairs_and_rigid_part_recombine_to_the_transfer_function(control, drawn, seed):
    _, machine = drawn
    rng = np.random.default_rng(seed)
    posture = regular_posture(rng, machine)
    assume(relative_gap(omega_squared(machine, posture)) > 1e-2)
    # Dampers are drawn for the whole mass; a light mode may be overdamped by them.
    assume(underdamped(machine, posture))
    result = evaluate(machine, posture, control=control, damped=True)
    plant = build_plant(machine)
    m, p = plant.n_passive, plant.parameter_values
    q = plant.rest(0.0, posture, p)
    mass, jacobian = plant.mass(q, 0.0, p).full(), plant.jacobian(q, 0.0, p).full()
    stiffness, damping, jv = plant.stiffness(p).full(), plant.damping(p).full(), jacobian[:, m:]
    task = jv.T if control == "transpose" else np.linalg.pinv(jv)
    d = result.damped
    for _ in range(3):
        s = rng.choice(np.abs(d.poles)) * rng.uniform(0.3, 3.0) * np.exp(1j * rng.uniform(-1.2, 1.2))
        dynamic = s**2 * mass + s * damping + stiffness
        by = np.diag(1 / np.sqrt(np.abs(np.diag(dynamic))))
        direct = jacobian @ by @ np.linalg.solve(by @ dynamic @ by, by @ np.vstack([np.zeros((m, 2)), task]))
        # Without joint damping D φ = 0 for the rigid modes, so their part stays R0 / s² exactly.
        terms = [result.rigid_residue / s**2]
        terms += [
            (n1 * s + n0) / ((s - pole) * (s - pole.conjugate()))
            for n0, n1, pole in zip(d.n0, d.n1, d.poles, strict=True)
        ]
        assert np.linalg.norm(sum(terms) - direct) <= 1e-9 * sum(np.linalg.norm(term) for term in terms)


@pytest.mark.long("(2, ('x', 'y', 'rotation'), ())-False-inverse", "(3, ('x', 'rotation'), ())-False-inverse")
@CONTROLS
@pytest.mark.parametrize(
    ("structure", "gravity"),
    [*((structure, False) for structure in STRUCTURES[:4]), (STRUCTURES[2], True)],
    ids=str,
)
def test_gradients_equal_central_differences(structure, gravity, control):
    machine, posture = case(structure, 5, damping_ratio=0.3, spread=100.0, frequency=(4.0, 10.0))
    options = {"control": control, "damped": True, "gravity": gravity}
    result = evaluate(machine, posture, **options)
    size, step = np.abs(result.damped.n0).max(), 1e-3
    # Fourth order: step⁴ = 1e-12 times a fifth derivative, and rounding of w, some 1e-12, over the step.
    weights = {1: 8, 2: -1}

    def posture_w(k, shift):
        moved = posture.copy()
        moved[k] += shift
        return evaluate(machine, moved, **options).w

    for k in range(len(posture)):
        difference = sum(c * (posture_w(k, j * step) - posture_w(k, -j * step)) for j, c in weights.items())
        assert np.abs(result.gradient.w[:, 1 + k] - difference / (12 * step)).max() <= 1e-8 * size
    assert np.abs(result.gradient.w[:, 0]).max() <= 1e-12 * size

    if gravity:
        return
    data = machine.to_dict()
    keys = list(data["base"]["damping"])[-1:]
    for kind in ("stiffness", "damping"):
        for key in keys:
            value = data["base"][kind][key]

            def w(factor, kind=kind, key=key, value=value):
                table = dict(data["base"][kind]) | {key: value * factor}
                return evaluate(
                    machine_from_dict(data | {"base": dict(data["base"]) | {kind: table}}), posture, **options
                ).w

            difference = sum(c * (w(1 + j * step) - w(1 - j * step)) for j, c in weights.items()) / (12 * step)
            column = result.gradient.parameters.index(f"base.{kind}.{key}")
            assert np.abs(result.gradient.w_parameters[:, column] * value - difference).max() <= 1e-8 * size


@CONTROLS
def test_vanishing_damping_leads_to_the_undamped_measures(control):
    machine, posture = case(Structure(3, ("x", "y", "rotation"), ()), 1, damping_ratio=0.5, joint_damping=False)
    data = machine.to_dict()

    def with_damping(factor):
        damping = {k: c * factor for k, c in data["base"]["damping"].items()}
        return evaluate(
            machine_from_dict(data | {"base": dict(data["base"]) | {"damping": damping}}),
            posture,
            control=control,
            damped=True,
        )

    undamped = evaluate(machine, posture, control=control)
    differences = [with_damping(f).damped_difference for f in (1e-1, 1e-2, 1e-3, 1e-5)]
    # At least first order in the damping.
    assert all(later <= 0.2 * earlier for earlier, later in pairwise(differences))
    last = with_damping(0.0)
    assert np.abs(last.w - undamped.w).max() <= 1e-10 * undamped.scale.max()
    assert np.abs(last.damped.n1).max() <= 1e-10 * undamped.scale.max()
    assert np.linalg.norm(last.damped.n0 - undamped.residues) <= 1e-10 * undamped.scale.max()
    assert np.abs(last.gradient.w - undamped.gradient.w).max() <= 1e-8 * np.abs(undamped.gradient.w).max()


def test_damping_ratios_of_light_damping_to_first_order():
    machine, posture = load("excavator"), [0.5, -1.5]
    light, exact = evaluate(machine, posture), evaluate(machine, posture, damped=True)
    # First order in ζ ≈ 2e-4: the rest is of its square.
    assert np.allclose(light.damping_ratios, exact.damping_ratios, rtol=1e-6)
    assert exact.damped_difference <= 1e-5


@pytest.mark.parametrize("direction", ["x", "y", "rotation"])
def test_overdamped_mode_is_refused(direction):
    data = load("excavator").to_dict()
    damping = dict(data["base"]["damping"]) | {direction: 1e9}
    machine = machine_from_dict(data | {"base": dict(data["base"]) | {"damping": damping}})
    with pytest.raises(InputError, match="overdamped"):
        evaluate(machine, [0.5, -1.5], damped=True)
    assert np.isfinite(evaluate(machine, [0.5, -1.5]).w).all()


@pytest.mark.parametrize("spread", [1e4, 1e6, 1e8])
def test_every_vibration_pole_is_found_whatever_the_spread_of_stiffness(spread):
    rng, compared = np.random.default_rng(12), 0
    for _ in range(5):
        structure = Structure(3, ("x", "y", "rotation"), ())
        data = draw_machine(NumpySource(rng), structure, spread=spread, damping_ratio=1e-7, joint_damping=False)
        machine = machine_from_dict(data)
        posture = regular_posture(rng, machine)
        values = omega_squared(machine, posture)
        if relative_gap(values) < 1e-3:
            continue
        result = evaluate(machine, posture, damped=True)
        assert np.allclose(np.abs(result.damped.poles), np.sqrt(values), rtol=1e-6)
        compared += 1
    assert compared >= 3
