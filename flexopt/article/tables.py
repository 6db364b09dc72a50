"""Table 2 of the article beside what flexopt computes, and where the table contradicts itself.

Source: ASME Letters in Dynamic Systems and Control 1(2), 021001.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from flexopt.foundation.arrays import Document, Vector
from flexopt.foundation.documents import provenance
from flexopt.foundation.results import Result
from flexopt.foundation.roots import root
from flexopt.foundation.turns import in_turn
from flexopt.model import AnyMachine, load
from flexopt.model.choices import Elbow
from flexopt.plant import inverse_kinematics
from flexopt.plant.plant import build_plant
from flexopt.robustness import Evaluation, evaluate
from flexopt.robustness.margin import build_margin

PRINTED_W = {
    "A": (-0.2969e-3, -0.0308e-3, -0.001e-3),
    "B": (-0.0209e-4, -0.0683e-4, -0.3105e-4),
}
PRINTED_EPSILON = {"A": 0.2869, "B": 0.3826}
# Half a unit of the last digit printed.
EPSILON_RESOLUTION = 5e-5
PRINTED_WORKSPACE = {"A": (-0.1733, 1.0870), "B": (1.32687, 1.0870)}
# The target of both postures, inertial frame, m, and where the undercarriage stands, m.
TARGET = (0.0, 1.6)
X_MOBILE = {"A": 0.0, "B": -1.5}
# Where the measures printed for posture B are found.
WORKSPACE_B_OF_MEASURES = (1.5575, 1.0870)
# Where kr is looked for, log10.
GAIN_DECADES = (4.0, 7.0)
# What of the rows' deviations is told beside them.
DEVIATION = (
    "of w_i (computed − printed) / printed, + where it is larger in magnitude than printed; of ε_max computed − printed"
)
NOTE = (
    "Posture A is met to 0.25 % (w3 is printed with one digit); its three inputs differ in the fourth digit. The "
    "article does not print the servo gain kr of ε_max: it is inferred from posture A, so that posture B is the check. "
    "The measures printed for posture B do not belong to the end-point printed for it (workspace x = 1.32687 m): they "
    "are those of x = 1.5575 m. The article contradicts itself there. Posture B is no local maximum of w1 either; "
    "“flexopt select article” finds those."
)


@dataclass(frozen=True)
class ArticleRow(Result):
    """One reading of a posture of Table 2: how it was put in, what came out, what is printed.

    `epsilon_inferred` is ε_max with the gain inferred from posture A, that of `evaluation` with kr = 5e5.
    """

    DOCUMENT = """
    posture reading printed_w deviation printed_epsilon_max=printed_epsilon
    epsilon_max_at_inferred_gain=epsilon_inferred epsilon_max_deviation evaluation
    """

    posture: str
    reading: str
    evaluation: Evaluation
    printed_w: tuple[float, ...]
    printed_epsilon: float
    epsilon_inferred: float

    @property
    def deviation(self) -> Vector:
        """(computed − printed) / printed, for each w_i: above 0 where it is larger in magnitude than printed."""
        printed = np.array(self.printed_w)
        return (self.evaluation.w - printed) / printed

    @property
    def epsilon_max_deviation(self) -> float:
        """Computed − printed."""
        return self.epsilon_inferred - self.printed_epsilon


@dataclass(frozen=True)
class InferredGain:
    """The servo gain kr with which posture A has the printed ε_max.

    Attributes:
        reading: the input of posture A that was used.
        printed: ε_max of posture A.
        kr: the gain.
        interval: gains around it with which ε_max rounds to the printed digits.
        other: the second gain that gives posture A its printed ε_max.
        other_epsilon_b: ε_max of posture B with that gain, which rules it out.
    """

    reading: str
    printed: float
    kr: float
    interval: tuple[float, float]
    other: float
    other_epsilon_b: float


@dataclass(frozen=True)
class ArticleTable(Result):
    """Every row, with the inferred gain and the note on the contradiction."""

    DOCUMENT = "rows inferred_gain=inferred note provenance"

    rows: tuple[ArticleRow, ...]
    inferred: InferredGain
    note: str = field(default=NOTE, repr=False)

    @property
    def provenance(self) -> Document:
        """Of the article's machine."""
        return provenance(article_machine())

    def __repr__(self) -> str:
        gain = self.inferred
        lines = [
            f"Table 2, inverse control, w_i in 1/(kg m2): computed, printed, and the deviation: {DEVIATION}",
            f"kr = {gain.kr:.4g} N m gives posture A ({gain.reading}) its printed ε_max = {gain.printed}; "
            f"{gain.interval[0]:.4g} to {gain.interval[1]:.4g} round to it. kr = {gain.other:.4g} would, too, "
            f"but makes posture B, at the point of its measures, {gain.other_epsilon_b:.4f}, "
            f"printed {PRINTED_EPSILON['B']}.",
        ]
        for row in self.rows:
            e = row.evaluation
            x = float(e.end_point[0]) - float(e.skeleton[0, 1])
            y = float(e.end_point[1]) - float(e.skeleton[1, 1])
            angles = ", ".join(f"{a:.4f}" for a in e.posture)
            lines.append(
                f"posture {row.posture}: {row.reading}; workspace ({x:.4f}, {y:.4f}) m, posture ({angles}) rad"
            )
            for i, w in enumerate(e.w):
                lines.append(f"  w{i + 1} {w:13.5e} {row.printed_w[i]:13.4e} {row.deviation[i]:+11.2%}")
            off = f"{row.epsilon_max_deviation:+11.2e}"
            lines.append(f"  ε_max {row.epsilon_inferred:11.6f} {row.printed_epsilon:13.4f} {off}")
        return "\n".join([*lines, "", self.note])


def article_machine() -> AnyMachine:
    """The article's excavator."""
    return load("excavator")


def workspace_origin(machine: AnyMachine) -> Vector:
    """The first joint at rest with the base at 0, (2,), m, inertial frame: the workspace frame's origin."""
    plant = build_plant(machine)
    return plant.arm_segments(p=plant.parameter_values)["first_joint"].full().ravel()


def workspace_posture(machine: AnyMachine, point: tuple[float, float], elbow: Elbow = "up") -> Vector:
    """The posture with the end-point on a point of the workspace frame, m."""
    return inverse_kinematics(machine, np.array(point) + workspace_origin(machine), elbow=elbow)[0]


def infer_gain(machine: AnyMachine, posture: Vector, reading: str) -> InferredGain:
    """The gains with which `posture` has the ε_max printed for posture A: ε_max first falls with kr, then rises."""
    from scipy.optimize import minimize_scalar  # noqa: PLC0415  (slow to import)

    def epsilon(exponent: float) -> float:
        return epsilon_at(machine, posture, 10.0**exponent)

    low, high = GAIN_DECADES
    lowest = float(minimize_scalar(epsilon, bounds=GAIN_DECADES, method="bounded").x)  # pyright: ignore

    def gain(wanted: float, between: tuple[float, float]) -> float:
        return 10.0 ** root(lambda k: epsilon(k) - wanted, *between, xtol=1e-12, rtol=1e-13)

    printed = PRINTED_EPSILON["A"]
    ends = sorted(gain(printed + side * EPSILON_RESOLUTION, (low, lowest)) for side in (-1, 1))
    other = gain(printed, (lowest, high))
    at_b = workspace_posture(machine, WORKSPACE_B_OF_MEASURES)
    kr = gain(printed, (low, lowest))
    return InferredGain(reading, printed, kr, (ends[0], ends[1]), other, epsilon_at(machine, at_b, other))


def epsilon_at(machine: AnyMachine, posture: Vector, kr: float) -> float:
    """ε_max of a posture, Jacobian inverse control."""
    margin = build_margin(machine)
    return float(margin.values.call([0.0, posture, margin.plant.parameter_values, kr])[0][0])


@in_turn
def reproduce_table2() -> ArticleTable:
    """Postures A and B of Table 2 from each input: inertial end-point, printed workspace point, rounded angles."""
    machine = article_machine()
    at_a, at_b = (inverse_kinematics(machine, TARGET, base=base, elbow="up")[0] for base in X_MOBILE.values())
    printed_a = "printed workspace point (-0.1733, 1.0870) m"
    readings: list[tuple[str, str, Vector, float]] = [
        ("A", "inertial end-point (0, 1.6) m, base at 0 m", at_a, 0.0),
        ("A", printed_a, workspace_posture(machine, PRINTED_WORKSPACE["A"]), 0.0),
        ("A", "angles rounded to four digits", np.array([0.9929, -2.6306]), 0.0),
        ("B", "inertial end-point (0, 1.6) m, base at -1.5 m", at_b, -1.5),
        ("B", "printed workspace point (1.32687, 1.0870) m", workspace_posture(machine, PRINTED_WORKSPACE["B"]), 0.0),
        ("B", "workspace point (1.5575, 1.0870) m", workspace_posture(machine, WORKSPACE_B_OF_MEASURES), 0.0),
    ]
    inferred = infer_gain(machine, readings[1][2], printed_a)
    rows = tuple(
        ArticleRow(
            name, reading, evaluate(machine, angles, base=base), PRINTED_W[name], PRINTED_EPSILON[name],
            epsilon_at(machine, angles, inferred.kr),
        )
        for name, reading, angles, base in readings
    )  # fmt: skip
    return ArticleTable(rows, inferred)
