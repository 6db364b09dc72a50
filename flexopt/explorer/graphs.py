"""What a page computes with: the machine's own graphs.

In: a machine, a control and the parts of its loop. Out: Functions by name. None is written for the page: they are what
`Measures`, `Plant` and `SmallMotions` compute with. The browser adds what is no graph: eigenvalues and the like.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from flexopt.loop.lag import LaggedModes
from flexopt.loop.small_motions import SmallMotions
from flexopt.plant.singularity import screened
from flexopt.plant.statics import left_over
from flexopt.robustness.measures import Measures
from flexopt.robustness.residues import measure, summed_residue


def explorer_functions(measures: Measures, motions: SmallMotions, *, frames: bool) -> dict[str, ca.Function]:
    """Functions by the names that the page has for them; `frames`: whether bodies are drawn.

    `skeleton`, `frames`: where the machine is at q. `unloaded`: q at a posture; under the weight `sink`: a step towards
    the static deflection, `held`, about which all others are: `rest`: q; `reach`: r and its derivative by base and
    posture; `reduced`: K_p, M̄ and F of the modes, `screen`, how far from singular (`screened`), and `left_over` of the
    deflection; `more` besides: follow, D; `own`: M and Jv, for the self-motion and what modes have become; `motions`:
    the linear loop; under the weight `resting_rows`, along whose kernel a redundant arm creeps; `first_order`: the
    decay of its modes to first order, see `LaggedModes.of_known`. `measure` and `symmetric`: w_i of f, whose first
    columns are the mode, and what its eigenvectors `vectors` are of.
    """
    plant, expansion, g = measures.plant, measures.expansion, measures.plant.graph
    point, (stiffness, mass, factors) = expansion.point, expansion.graphs
    about = {
        "rest": {"q": point.q},
        "reach": {"r": point.end_point, "J": ca.jacobian(point.end_point, ca.vertcat(g.base, g.posture))},
        "reduced": {"K": stiffness, "M": mass, "F": factors, "screen": screened(plant)["screen"],
                    "left_over": left_over(plant, point.q, point.static_residual) if measures.gravity else ca.SX(0)},
        "more": {"follow": expansion.pencil.follow, "D": point.damping},
        "own": {"M": point.mass, "Jv": point.rigid_jacobian},
    }  # fmt: skip
    at, names = [*measures.inputs, expansion.held_parts["deflection"]], ["base", "posture", "p", "held"]
    found = {
        "skeleton": plant.skeleton,
        "unloaded": plant.rest,
        "motions": motions.matrices,
        "first_order": LaggedModes(motions).of_known,
    } | {name: _function(name, at, names, outputs) for name, outputs in about.items()}
    if measures.gravity:
        found["sink"] = plant.static_step
    if measures.gravity and plant.n_actuated > plant.n_task:
        found["resting_rows"] = motions.resting_rows
    if frames:
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
