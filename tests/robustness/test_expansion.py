"""Derivatives through K_p, M̄, A, B against those that CasADi takes of one expression."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import flexopt
from flexopt import build_plant
from flexopt.model import tree_from_dict
from flexopt.robustness.measures import build_measures
from flexopt.robustness.modes import called_modes, solve_modes
from flexopt.robustness.residues import measure
from tests.export.test_modal_kernels import gantry
from tests.oracles.gradient_cases import near_repeated
from tests.oracles.machines import random_posture
from tests.oracles.perturbation import perturbed_pencil
from tests.oracles.spatial import grounded

# Second derivatives are divided by the squares of the gaps between frequencies, and rounding with them.
RELATIVE = 1e-9


def differentiated(measures):
    """(base, posture, p, held, alpha, vectors) -> V, gradient, Hessian, by CasADi from one expression."""
    g, expansion, alpha = measures.plant.graph, measures.expansion, ca.SX.sym("alpha", measures.plant.n_passive)
    m, r, held = measures.plant.n_passive, measures.plant.n_task, expansion.held_parts
    vectors = ca.SX.sym("vectors", r, r * m)
    stiffness, mass, factors = expansion.graphs
    modes = perturbed_pencil(stiffness, mass, held["omega_squared"], held["modes"], held["same"])[1]
    a, b = (factors @ modes)[:r, :], (factors @ modes)[r:, :]
    w: list[ca.SX] = []
    for i in range(m):
        order = [i, *(k for k in range(m) if k != i)]
        w.append(measure(a[:, order], b[:, order], held["same"][i, order], vectors[:, i * r : (i + 1) * r]))
    value = ca.dot(alpha, ca.vertcat(*w))
    hessian, gradient = ca.hessian(value, ca.vertcat(g.base, g.posture))
    outputs = [ca.densify(x) for x in (value, gradient, hessian)]
    return ca.Function("reference", [g.base, g.posture, g.p, expansion.held, alpha, vectors], outputs)


def symmetric_part_vectors(parts, r):
    """Eigenvectors of each cluster's summed residue with its transpose, ascending."""
    f, same = parts["f"].full(), parts["same"].full()
    sums = ((f[:r] * row) @ f[r:].T for row in same)
    return np.hstack([np.linalg.eigh(x + x.T)[1] for x in sums])


def compare(machine, posture, rng, control="inverse", gravity=False):
    measures = build_measures(machine, control, gravity)
    plant, expansion = measures.plant, measures.expansion
    at = [rng.standard_normal(plant.n_base), posture, plant.parameter_values]
    held, alpha = measures.hold.call(at)[0], rng.standard_normal(plant.n_passive)
    vectors = symmetric_part_vectors(expansion.parts(held), plant.n_task)
    expected = [x.full() for x in differentiated(measures).call([*at, held, alpha, vectors])]
    inputs = [*at, held, alpha]
    got = [expansion.value.call(inputs)[0], *expansion.slope.call(inputs), expansion.curvature.call(inputs)[0]]
    assert np.all(np.isfinite(expected[2]))
    for ours, theirs in zip(got, [expected[0], *expected], strict=True):
        assert np.linalg.norm(ours.full() - theirs) <= RELATIVE * np.linalg.norm(theirs)
    # The other ways to the same numbers.
    w_z = measures.gradients.call(at)[0].full()
    for slope in (alpha @ w_z, measures.weighted_gradient.call([*at, alpha])[0].full().ravel()):
        assert np.linalg.norm(slope - expected[1].ravel()) <= RELATIVE * np.linalg.norm(expected[1])
    w_posture = measures.w_with_gradient.call(at)[1].full()
    assert np.linalg.norm(w_posture - w_z[:, plant.n_base :]) <= RELATIVE * np.linalg.norm(w_z)


@pytest.mark.parametrize("gravity", [False, True])
@pytest.mark.parametrize("control", ["inverse", "transpose", "damped:0.2"])
@pytest.mark.parametrize(("arm", "rows"), [(3, "xyz"), (4, "xyz"), (4, "xz"), (2, "z")])
def test_trees(arm, rows, control, gravity):
    data, rng = grounded(arm, arm), np.random.default_rng(arm)
    data["end_point"]["rows"] = list(rows)
    compare(tree_from_dict(data), rng.uniform(0.3, 0.9, arm), rng, control, gravity)


@pytest.mark.parametrize("gravity", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_plane(seed, gravity):
    rng = np.random.default_rng(seed)
    machine = flexopt.load("excavator")
    compare(machine, random_posture(rng, machine), rng, gravity=gravity)


@pytest.mark.parametrize("seed", range(4))
def test_repeated_frequencies(seed):
    rng = np.random.default_rng(seed)
    case = near_repeated(rng, 0.0, condition=20.0)
    same = build_measures(case.machine).values.call([0.0, case.posture, build_plant(case.machine).parameter_values])
    assert same[build_measures(case.machine).values.index_out("same")].full()[0, 1] == 1.0
    compare(case.machine, case.posture, rng)


def test_a_gantry_of_one_frequency_has_a_hessian():
    """Both modes are one cluster, and by symmetry their measure is the same everywhere."""
    measures, rng = build_measures(gantry()), np.random.default_rng(0)
    plant, posture, alpha = measures.plant, [0.3, 0.5, -0.7], rng.standard_normal(2)
    at = [np.zeros(plant.n_base), posture, plant.parameter_values]
    hessian = measures.expansion.curvature.call([*at, measures.hold.call(at)[0], alpha])[0].full()
    slopes = [
        measures.weighted_gradient.call([at[0], np.array(posture) + step, at[2], alpha])[0].full()
        for step in 1e-4 * np.vstack([np.eye(3), -np.eye(3)])
    ]
    expected = np.vstack(slopes[:3]) - np.vstack(slopes[3:])
    size = measures.w.call(at)[1].full().max()
    assert np.abs(hessian[plant.n_base :] - expected / 2e-4).max() <= 1e-6 * size


def test_a_machine_of_slides_whose_posture_changes_nothing():
    """Mass and Jacobian are constant, and so is V."""
    names = [("sway", [1.0, 0, 0]), ("heave", [0, 0, 1.0]), ("reach", [1.0, 0, 0.5]), ("lift", [0.2, 0, 1.0])]
    bodies = []
    for k, (name, axis) in enumerate(names):
        joint = {"name": name, "kind": "slide", "axis": axis}
        if k < 2:
            joint |= {"passive": True, "stiffness": 1e4 * (k + 1), "damping": 10.0}
        parent = bodies[-1]["name"] if bodies else None
        bodies.append(
            {"name": f"b{k}", "parent": parent, "joint": joint, "mass": 3.0 + k, "inertia": [1.0, 1, 1, 0, 0, 0]}
        )
    tree = tree_from_dict({"name": "slides", "bodies": bodies, "end_point": {"body": "b3", "rows": ["z"]}})
    measures = build_measures(tree, "transpose")
    at = [np.zeros(measures.plant.n_base), [0.1, 0.2], measures.plant.parameter_values]
    inputs = [*at, measures.hold.call(at)[0], [1.0, 2.0]]
    _, gradient = measures.expansion.slope.call(inputs)
    assert not np.any(gradient.full())
    assert not np.any(measures.expansion.curvature.call(inputs)[0].full())


@pytest.mark.parametrize("gravity", [False, True])
@pytest.mark.parametrize("coupled", [False, True])
def test_called_and_written_iterations_agree(coupled, gravity):
    tree = tree_from_dict(grounded(3, 1, coupled=coupled))
    measures = build_measures(tree, gravity=gravity)
    expansion = measures.expansion
    at, symbols = [np.zeros(measures.plant.n_base), [0.4, 0.5, 0.6], measures.plant.parameter_values], measures.inputs
    pencil = [ca.SX.sym(name, 6, 6) for name in ("K", "M")]
    iterations = called_modes(6), ca.Function("written", pencil, list(solve_modes(*pencil)))
    called, written = (
        dict(zip(found, ca.Function("hold", symbols, list(found.values())).call(at), strict=True))
        for found in (expansion.hold(symbols, modes)[0] for modes in iterations)
    )
    for name in called:
        ours, theirs = called[name].full(), written[name].full()
        assert np.linalg.norm(ours - theirs) <= 1e-12 * np.linalg.norm(theirs)
