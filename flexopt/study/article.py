"""Table 2 of the article beside what flexopt computes, and where the table contradicts itself.

Source: ASME Letters in Dynamic Systems and Control 1(2), 021001.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from flexopt.model import load
from flexopt.model.arguments import Vector
from flexopt.model.documents import json_ready, provenance
from flexopt.plant import inverse_kinematics
from flexopt.plant.plant import build_plant
from flexopt.robustness import Evaluation, evaluate

PRINTED_W = {
    "A": (-0.2969e-3, -0.0308e-3, -0.001e-3),
    "B": (-0.0209e-4, -0.0683e-4, -0.3105e-4),
}
PRINTED_WORKSPACE = {"A": (-0.1733, 1.0870), "B": (1.32687, 1.0870)}
# Where the measures printed for posture B are found.
WORKSPACE_B_OF_MEASURES = (1.5575, 1.0870)
NOTE = (
    "Posture A is met to 0.1 %; its three inputs differ in the fourth digit. The measures printed for posture B do not "
    "belong to the end-point printed for it (workspace x = 1.32687 m): they are those of x = 1.5575 m. The article "
    "contradicts itself there. Posture B is no local maximum of w1 either; `flexopt select article` finds those. "
    "ε_max is not computed by this version."
)


@dataclass(frozen=True)
class ArticleRow:
    """One reading of a posture of Table 2: how it was put in, what came out, what is printed."""

    posture: str
    reading: str
    evaluation: Evaluation
    printed_w: tuple[float, ...]

    @property
    def deviation(self) -> Vector:
        """(computed − printed) / |printed|, for each w_i."""
        printed = np.array(self.printed_w)
        return (self.evaluation.w - printed) / np.abs(printed)


@dataclass(frozen=True)
class ArticleTable:
    """Every row, with the note on the contradiction."""

    rows: tuple[ArticleRow, ...]
    note: str = field(default=NOTE, repr=False)

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready dictionary."""
        rows = [
            {
                "posture": row.posture,
                "reading": row.reading,
                "printed_w": row.printed_w,
                "deviation": row.deviation,
                "evaluation": row.evaluation.to_dict(),
            }
            for row in self.rows
        ]
        return json_ready({"rows": rows, "note": self.note, "provenance": provenance(load("excavator"))})

    def __repr__(self) -> str:
        lines = ["Table 2, Jacobian inverse control: w_i computed, printed, and the relative deviation"]
        for row in self.rows:
            e = row.evaluation
            x = float(e.end_point[0]) - float(e.skeleton[0, 1])
            y = float(e.end_point[1]) - float(e.skeleton[1, 1])
            angles = ", ".join(f"{a:.4f}" for a in e.posture)
            lines.append(
                f"posture {row.posture}: {row.reading}; workspace ({x:.4f}, {y:.4f}) m, posture ({angles}) rad"
            )
            for i, w in enumerate(e.w):
                lines.append(f"  w{i + 1} {w:13.5e} {row.printed_w[i]:13.4e} {row.deviation[i]:+11.2e}")
        return "\n".join([*lines, "", self.note])


def reproduce_table2() -> ArticleTable:
    """Postures A and B of Table 2 from each input: inertial end-point, printed workspace point, rounded angles."""
    machine = load("excavator")
    shoulder = build_plant(machine).arm_segments(p=build_plant(machine).parameter_values)["first_joint"].full().ravel()

    def from_workspace(point: tuple[float, float]) -> Vector:
        # The base stands at 0: workspace and inertial frame differ by the shoulder at rest.
        return inverse_kinematics(machine, np.array(point) + shoulder, elbow="up")[0]

    def row(posture: str, reading: str, angles: Vector, base: float = 0.0) -> ArticleRow:
        return ArticleRow(posture, reading, evaluate(machine, angles, base=base), PRINTED_W[posture])

    target = (0.0, 1.6)
    at_a = inverse_kinematics(machine, target, base=0.0, elbow="up")[0]
    at_b = inverse_kinematics(machine, target, base=-1.5, elbow="up")[0]
    return ArticleTable(
        (
            row("A", "inertial end-point (0, 1.6) m, base at 0 m", at_a),
            row("A", "printed workspace point (-0.1733, 1.0870) m", from_workspace(PRINTED_WORKSPACE["A"])),
            row("A", "angles rounded to four digits", np.array([0.9929, -2.6306])),
            row("B", "inertial end-point (0, 1.6) m, base at -1.5 m", at_b, base=-1.5),
            row("B", "printed workspace point (1.32687, 1.0870) m", from_workspace(PRINTED_WORKSPACE["B"])),
            row("B", "workspace point (1.5575, 1.0870) m", from_workspace(WORKSPACE_B_OF_MEASURES)),
        )
    )
