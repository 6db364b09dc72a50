"""The measures made of calls against those written out: any machine, clusters of equal frequencies, both controllers."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import flexopt
from flexopt.algebra import called_eigen, symmetric_eigen
from flexopt.export.context import build_context
from flexopt.export.modal_kernels import ModalKernels
from flexopt.model import tree_from_dict
from flexopt.robustness.modes import called_modes, reduced_pencil, solve_modes
from tests.oracles.machines import Structure, random_machine
from tests.oracles.spatial import grounded, random_tree


def gantry():
    """Two equal slides carry three driven ones: two modes of one frequency."""
    inertia = [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]
    slide = {"kind": "slide"}
    bodies = []
    for name, axis in (("x", 0), ("y", 1)):
        joint = slide | {"name": f"foot {name}", "axis": list(np.eye(3)[axis]), "passive": True, "stiffness": 4e4}
        bodies.append({"name": f"foot{name}", "parent": bodies[-1]["name"] if bodies else None, "joint": joint})
    bodies[-1] |= {"mass": 50.0, "inertia": inertia}
    hinges = ((2, [0.0, 0.0, 0.5]), (1, [0.0, 0.0, 0.4]), (1, [0.7, 0.0, 0.0]))
    for k, (axis, position) in enumerate(hinges):
        joint = {"name": f"j{k}", "kind": "hinge", "axis": list(np.eye(3)[axis])}
        bodies.append({"name": f"b{k}", "parent": bodies[-1]["name"], "joint": joint, "position": position,
                       "mass": 0.0, "inertia": [0.2, 0.3, 0.4, 0.0, 0.0, 0.0]})  # fmt: skip
    end_point = {"body": "b2", "position": [0.8, 0.0, 0.0]}
    return tree_from_dict({"name": "gantry", "bodies": bodies, "end_point": end_point, "gravity": 9.81})


MACHINES = {
    "excavator": lambda: flexopt.load("excavator"),
    "slewing-excavator": lambda: flexopt.load("slewing-excavator"),
    "truck-crane": lambda: flexopt.load("truck-crane"),
    "grounded": lambda: tree_from_dict(grounded(4, 2)),
    "planar, redundant": lambda: random_machine(np.random.default_rng(4), Structure(4, ("x", "rotation"), (1,)))[1],
    "one mode": lambda: random_machine(np.random.default_rng(1), Structure(3, ("rotation",), ()))[1],
    "six rows": lambda: tree_from_dict(
        random_tree(11, rows=("x", "y", "z", "roll", "pitch", "yaw"), counts=(4, 7)) | {"placement": ["yaw"]}
    ),
    "gantry": gantry,
}


@pytest.mark.parametrize(
    ("name", "control"),
    [*((name, "inverse") for name in MACHINES), *((name, "transpose") for name in ("excavator", "grounded", "gantry"))],
)
def test_same_measures_and_gradients(name: str, control: str) -> None:
    machine = MACHINES[name]()
    at = build_context(machine, control=control, gain=5e5, single=False, baked=False, singularity_margin_deg=1.0)
    plant, kernels, rng = at.plant, ModalKernels(at), np.random.default_rng(0)
    inputs = [ca.MX.sym(f"x{k}", *symbol.shape) for k, symbol in enumerate(kernels.expansion.inputs.values())]
    alpha = ca.MX.sym("alpha", plant.n_passive)
    graph = kernels.graph(inputs, alpha)
    outputs = [graph.omega_squared, graph.w, graph.size, graph.gradient, graph.gradient_sizes, graph.gap]
    function = ca.Function("modal", [*inputs, alpha], outputs)
    tested = 0
    for posture in at.joint_angles.draw(rng, 40):
        base, weights, p = rng.uniform(-1, 1, plant.n_base), rng.uniform(0, 1, plant.n_passive), plant.parameter_values
        # The product of as many singular values as there are rows: far smaller with six of them.
        if tested == 3 or float(plant.singularity_sine_squared(base, posture, p)) < 10.0 ** (1 - plant.n_task):
            continue
        tested += 1
        placed = [base] if at.placement_matters else []
        squares, w, size, gradient, slopes, gap = (
            x.full().ravel() for x in function.call([*placed, posture, p, weights])
        )
        expected = at.measures.values(base=base, posture=posture, p=p)
        rows = at.measures.gradients(base=base, posture=posture, p=p)["w_z"].full()
        sizes = at.measures.w(base=base, posture=posture, p=p)["scale"].full().ravel()
        np.testing.assert_allclose(squares, expected["omega_squared"].full().ravel(), rtol=1e-12)
        # Modes of a cluster may be any in its plane, and so may be their factors; w and its gradient are not.
        apart = gap > 1e-6
        scale = np.maximum(size, sizes.max() * 1e-3)
        conditioned = np.where(apart, np.maximum(gap, 1e-6), 1.0)
        assert np.all(np.abs(w - expected["w"].full().ravel()) <= 1e-12 * scale / conditioned)
        np.testing.assert_allclose(size[apart], sizes[apart], rtol=0, atol=1e-11 * sizes.max())
        wanted, most = rows.T @ weights, (np.linalg.norm(rows, axis=1) + scale).max()
        np.testing.assert_allclose(gradient, wanted, rtol=0, atol=1e-11 * most / conditioned.min())
        np.testing.assert_allclose(slopes, np.linalg.norm(rows, axis=1), rtol=0, atol=1e-11 * most / conditioned.min())
        assert (name == "gantry") == bool((gap < 1e-9).any())
    assert tested == 3


@pytest.mark.parametrize("size", [1, 2, 3, 6])
def test_called_eigenpairs_are_the_same(size: int) -> None:
    matrix = np.random.default_rng(size).normal(size=(size, size))
    matrix = matrix @ matrix.T
    values, vectors = (x.full() for x in called_eigen(size).call([matrix]))
    symbol = ca.SX.sym("A", size, size)
    written = ca.Function("written", [symbol], list(symmetric_eigen(symbol))).call([matrix])
    # The same operations, sums in another order.
    np.testing.assert_allclose(values, written[0].full(), rtol=1e-13)
    np.testing.assert_allclose(vectors, written[1].full(), rtol=0, atol=1e-13)
    np.testing.assert_allclose(vectors @ np.diag(values.ravel()) @ vectors.T, matrix, atol=1e-13 * np.trace(matrix))


def test_called_modes_are_the_same() -> None:
    plant = flexopt.build_plant(flexopt.load("slewing-excavator"))
    g = plant.graph
    pencil = reduced_pencil(plant.operating_point(g.base, g.posture, g.p), 6)
    outputs = [ca.densify(pencil.stiffness), pencil.mass, *solve_modes(pencil.stiffness, pencil.mass)]
    at = [[0.0, 0.0, 0.0], [0.3, 0.2, -1.5, -0.5], plant.parameter_values]
    stiffness, mass, *written = ca.Function("f", [g.base, g.posture, g.p], outputs).call(at)
    for called, expected in zip(called_modes(6).call([stiffness, mass]), written, strict=True):
        np.testing.assert_allclose(called.full(), expected.full(), rtol=1e-12, atol=1e-15)
