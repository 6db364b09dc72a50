"""Modes, residues and measures of a plant, with exact derivatives.

In: a `Plant` and an operating point. Out: frequencies, residues R_0 and R_i, measures w_i, in-phase flags, and their
derivatives, as Functions (`measures`) or as numbers: one posture in full (`evaluate`), w of thousands (`evaluate_w`).
"""

from typing import TYPE_CHECKING

from flexopt.foundation.later import later

if TYPE_CHECKING:
    from flexopt.robustness.batches import BatchedW as BatchedW
    from flexopt.robustness.batches import evaluate_w as evaluate_w
    from flexopt.robustness.evaluation import Evaluation as Evaluation
    from flexopt.robustness.evaluation import evaluate as evaluate
    from flexopt.robustness.measures import Measures as Measures
    from flexopt.robustness.measures import build_measures as build_measures

__getattr__ = later(
    __name__,
    batches="BatchedW evaluate_w",
    evaluation="Evaluation evaluate",
    measures="Measures build_measures",
)
