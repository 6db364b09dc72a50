"""V, its gradient and Hessian through K_p, M̄, A, B against derivatives of the measures' own graph."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import flexopt
from flexopt import build_plant
from flexopt.model import tree_from_dict
from flexopt.robustness.expansion import Expansion
from flexopt.robustness.measures import build_measures
from tests.oracles.gradient_cases import near_repeated
from tests.oracles.machines import random_posture
from tests.oracles.spatial import grounded

# Second derivatives are divided by the squares of the gaps between frequencies, and rounding with them.
RELATIVE = 1e-9


def differentiated(measures):
    """(base, posture, p, held, alpha) -> V, gradient, Hessian."""
    g, alpha = measures.plant.graph, ca.SX.sym("alpha", measures.plant.n_passive)
    value = ca.dot(alpha, measures.graph.w)
    hessian, gradient = ca.hessian(value, ca.vertcat(g.base, g.posture))
    outputs = [ca.densify(x) for x in (value, gradient, hessian)]
    return ca.Function("reference", [g.base, g.posture, g.p, measures.held, alpha], outputs)


def compare(machine, posture, rng, control="inverse", gravity=False):
    measures = build_measures(machine, control, gravity)
    plant, expansion = measures.plant, Expansion(measures)
    at = [rng.standard_normal(plant.n_base), posture, plant.parameter_values]
    held, alpha = measures.called_hold.call(at)[0], rng.standard_normal(plant.n_passive)
    expected = [x.full() for x in differentiated(measures).call([*at, held, alpha])]
    inputs = [*at, held, alpha]
    got = [expansion.value.call(inputs)[0], *expansion.slope.call(inputs), expansion.curvature.call(inputs)[0]]
    assert np.all(np.isfinite(expected[2]))
    for ours, theirs in zip(got, [expected[0], *expected], strict=True):
        assert np.linalg.norm(ours.full() - theirs) <= RELATIVE * np.linalg.norm(theirs)


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
    inputs = [*at, measures.called_hold.call(at)[0], [1.0, 2.0]]
    _, gradient = Expansion(measures).slope.call(inputs)
    assert not np.any(gradient.full())
    assert not np.any(Expansion(measures).curvature.call(inputs)[0].full())


@pytest.mark.parametrize("gravity", [False, True])
@pytest.mark.parametrize("coupled", [False, True])
def test_called_and_written_iterations_agree(coupled, gravity):
    tree = tree_from_dict(grounded(3, 1, coupled=coupled))
    measures = build_measures(tree, gravity=gravity)
    at = [np.zeros(measures.plant.n_base), [0.4, 0.5, 0.6], measures.plant.parameter_values]
    called, written = (
        dict(zip(measures.held_parts, ca.vertsplit(f.call(at)[0], edges(measures)), strict=True))
        for f in (measures.called_hold, measures.hold)
    )
    # The vectors of the symmetric parts are left out where no mode needs them.
    for name in ("deflection", "omega_squared", "modes", "same"):
        ours, theirs = called[name].full(), written[name].full()
        assert np.linalg.norm(ours - theirs) <= 1e-12 * np.linalg.norm(theirs)


def edges(measures):
    return np.cumsum([0, *(part.numel() for part in measures.held_parts.values())]).tolist()
