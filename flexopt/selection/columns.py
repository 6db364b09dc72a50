"""Placements, postures and measures in columns of text, as wide as their names.

In: an `Evaluation`. Out: rows, the heads above them, what they are in.
"""

from __future__ import annotations

import re

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.foundation.rounding import without_rounding
from flexopt.robustness.evaluation import Evaluation
from flexopt.robustness.residues import residue_unit, unit_in_words
from flexopt.selection.problem import TIE_TOLERANCE, SelectionProblem

# Names longer than this are folded in the heads of tables.
NAME_WIDTH = 10


def units_told(e: Evaluation) -> str:
    """What the columns of a table are in."""
    return f"in {units_of_columns(e)}; w_i in {unit_in_words(residue_unit(e.control, e.joint_units))}"


def units_of_columns(e: Evaluation) -> str:
    """Of placement and posture."""
    return " and ".join(dict.fromkeys((*e.base_units, *e.joint_units)))


def in_columns(e: Evaluation) -> str:
    """Placement and posture in columns as wide as their names."""
    values, names = (*e.base, *e.posture), _folded_names(e)
    return " ".join(f"{x:>z{max(map(len, name))}.4f}" for x, name in zip(values, names, strict=True))


def column_heads(before: str, e: Evaluation, after: str) -> list[str]:
    """Lines with the names of these columns; what stands before and after them is in the last one."""
    names = _folded_names(e)
    depth = max(map(len, names), default=1)
    lines = list[str]()
    for k in range(depth):
        row = " ".join(name[k - depth + len(name)] if k >= depth - len(name) else " " * len(name[0]) for name in names)
        last = k == depth - 1
        lines.append(f"{before if last else ' ' * len(before)} {row}{after if last else ''}".rstrip())
    return lines


def _folded_names(e: Evaluation) -> list[list[str]]:
    """Each name in parts as wide as its column, cut behind underscores where it is long."""
    folded = list[list[str]]()
    for name in (*e.base_coordinates, *e.joints):
        parts = [""]
        for piece in re.findall(r"[^_]*_+|[^_]+", name):
            if parts[-1] and len(parts[-1] + piece) > NAME_WIDTH:
                parts.append("")
            parts[-1] += piece
        width = max(9, *map(len, parts))
        folded.append([part.rjust(width) for part in parts])
    return folded


def shown_measures(problem: SelectionProblem, evaluation: Evaluation) -> Vector:
    """The w_i (m,) in tables, 0 where they are rounding or rank as equal to it."""
    first = problem.sought[0]
    # The scale of ε_max, or of an objective of the user's own, is none of w_i.
    equal = 0.0 if first.has_kinks or first.own is not None else TIE_TOLERANCE * problem.first_scale
    shown: Vector = np.where(np.abs(evaluation.w) > equal, without_rounding(evaluation.w, evaluation.scale), 0.0)
    return shown


def measures_in_columns(problem: SelectionProblem, evaluation: Evaluation) -> str:
    """The w_i and ε_max in columns."""
    shown = shown_measures(problem, evaluation).tolist()
    return "".join(f"{w:13.4e}" for w in shown) + in_margin(evaluation)


def in_margin(e: Evaluation) -> str:
    """ε_max in a column."""
    return f"{'–':>10}" if e.epsilon_max is None else f"{e.epsilon_max:10.6f}"
