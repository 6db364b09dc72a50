"""What a page computes with: the machine's own graphs, as Functions and in JavaScript.

In: a machine, a control and the parts of its loop. Out: Functions by name. None is written for the page: they are what
`Measures`, `Plant` and `SmallMotions` compute with. The browser adds what is no graph: eigenvalues and the like.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from flexopt.explorer.javascript import script_of
from flexopt.loop.small_motions import SmallMotions
from flexopt.plant.singularity import screened
from flexopt.robustness.measures import Measures
from flexopt.robustness.modes import CLUSTER_TOLERANCE
from flexopt.robustness.residues import measure, summed_residue

__all__ = ["CLUSTER_TOLERANCE", "explorer_functions", "moving_placement", "scripts"]


def explorer_functions(measures: Measures, motions: SmallMotions) -> dict[str, ca.Function]:
    """Functions by the names that the page has for them.

    `skeleton`, `frames`: where the machine is at q. `rest`: q at a posture. `reach`: r and J_B at rest. `reduced`: K_p,
    M̄ and F of the modes and `screen`, how far from singular (`screened`); `more` besides: follow, D. `measure` and
    `symmetric`: w_i of f, whose first columns are the mode, and what its eigenvectors `vectors` are of. `motions`: the
    linear loop; `own`: M and Jv at rest, for the self-motion.
    """
    plant, expansion, g = measures.plant, measures.expansion, measures.plant.graph
    at, names = measures.inputs, ["base", "posture", "p"]
    rest = plant.rest(*at)
    end_point = plant.end_point(rest, g.base, g.p)
    stiffness, mass, factors = expansion.graphs
    screen = screened(plant)["screen"]
    found = {
        "skeleton": plant.skeleton,
        "rest": plant.rest,
        "reach": _function("reach", at, names, {"r": end_point, "J": plant.base_jacobian(*at)}),
        "reduced": _function("reduced", at, names, {"K": stiffness, "M": mass, "F": factors, "screen": screen}),
        "more": _function("more", at, names, {"follow": expansion.pencil.follow, "D": expansion.point.damping}),
        "own": _function("own", at, names, {"M": plant.mass(rest, g.base, g.p),
                                            "Jv": plant.rigid_jacobian(rest, g.base, g.p)}),
        "motions": motions.matrices,
    }  # fmt: skip
    if measures.plant.machine.capsules:
        found["frames"] = plant.body_frames
    return found | _measure(plant.n_task, plant.n_passive)


def _measure(r: int, m: int) -> dict[str, ca.Function]:
    f, row, vectors = ca.SX.sym("f", 2 * r, m), ca.SX.sym("row", 1, m), ca.SX.sym("vectors", r, r)
    a, b = f[:r, :], f[r:, :]
    residue = summed_residue(a, b, row)
    return {
        "measure": _function("measure", [f, row, vectors], ["f", "row", "vectors"], {"w": measure(a, b, row, vectors)}),
        "symmetric": _function("symmetric", [f, row], ["f", "row"], {"S": residue + residue.T}),
    }


def _function(name: str, inputs: list[ca.SX], names: list[str], outputs: Mapping[str, ca.SX]) -> ca.Function:
    dense = [ca.densify(output) for output in outputs.values()]
    return ca.Function(name, inputs, dense, names, list(outputs), {"cse": True})


def moving_placement(functions: Mapping[str, ca.Function]) -> list[int]:
    """Numbers of the placement's coordinates that measures depend on."""
    reduced = functions["reduced"]
    at = reduced.sx_in()
    return [k for k, depends in enumerate(_depends(ca.veccat(*reduced.call(at)), at[0])) if depends]


def _depends(graph: ca.SX, by: ca.SX) -> list[bool]:
    return list(ca.which_depends(graph, by, 1, False)) if by.shape[0] else []


def scripts(functions: Mapping[str, ca.Function]) -> dict[str, str]:
    """The Functions in JavaScript, by name."""
    return {name: script_of(function) for name, function in functions.items()}
