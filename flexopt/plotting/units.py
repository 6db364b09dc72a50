"""What axes are called: a quantity and its unit, by one rule: `name, unit`, and `name, –` where there is none."""

from __future__ import annotations

from flexopt.foundation.escapes import mathtext
from flexopt.robustness.evaluation import Evaluation
from flexopt.robustness.residues import residue_unit, written_unit
from flexopt.selection.objective import Objective

NONE = "–"


def labelled(name: str, unit: str) -> str:
    """The label of an axis; `1` and the empty word are no units."""
    return f"{name}, {NONE if unit in ('', '1') else written_unit(unit)}"


def measure_label(evaluation: Evaluation, index: str = "i") -> str:
    """Of w_i."""
    return labelled(f"$w_{{{index}}}$", residue_unit(evaluation.control, evaluation.joint_units))


def objective_label(objective: Objective, evaluation: Evaluation) -> str:
    """Of what is maximised; an own Function's unit is its author's affair."""
    name = f"objective {mathtext(objective.name)}"
    if objective.own is not None:
        return f"{name}, own unit"
    if objective.has_kinks:
        # Weights of w_i beside that of ε_max have the inverse unit.
        return labelled(name, "")
    return labelled(name, residue_unit(evaluation.control, evaluation.joint_units))
