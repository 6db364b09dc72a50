"""What the article says beside what the numbers say.

In: results of the other studies. Out: `ArticleFinding`s, each with a quotation, a verdict computed from numbers, a
sentence and the numbers themselves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from flexopt.article.curves import Curve, rank_correlation
from flexopt.article.tables import ArticleTable, epsilon_at
from flexopt.foundation.arrays import Vector
from flexopt.foundation.results import Result
from flexopt.model import AnyMachine
from flexopt.robustness import build_measures
from flexopt.robustness.margin import build_margin
from flexopt.selection import Selection
from flexopt.study.maps.workspace_map import WorkspaceMap

PRINTED_MAXIMUM = 0.3827
# Below this w_1 counts as 0: the machine's residues are of order 1e-4.
ROBUST = 1e-9
# What printed statements are called that the numbers, or others of the article, speak against or seem to.
DOUBTED = "Claims that the article itself or the numbers seem to contradict"


@dataclass(frozen=True)
class ArticleFinding(Result):
    """One statement of the article put to the test.

    Attributes:
        key: a short name.
        quote: the article's words or numbers.
        where: where they stand.
        holds: whether the numbers bear it out.
        sentence: what was found.
        numbers: on which that rests.
    """

    key: str
    quote: str
    where: str
    holds: bool
    sentence: str
    numbers: dict[str, Any]


def posture_b(table: ArticleTable) -> ArticleFinding:
    """Do the measures printed for posture B belong to the end-point printed for it?"""
    rows = {row.reading: row for row in table.rows if row.posture == "B"}
    worst = {reading: float(max(row.deviation, key=abs)) for reading, row in rows.items()}
    printed = next(reading for reading in worst if reading.startswith("printed"))
    other = next(reading for reading in worst if "1.5575" in reading)
    holds = abs(worst[printed]) <= 0.01
    sentence = (
        f"At the printed point a measure deviates by {100 * worst[printed]:+.0f} %, at (1.5575, 1.0870) m all three by "
        f"at most {100 * abs(worst[other]):.2f} %: the printed measures belong to that point."
    )
    return ArticleFinding(
        "posture B", "1.32687 m (workspace)", "Table 2, posture B", holds, sentence, {"deviation": worst}
    )


def below_maximum(lines: Sequence[Curve], inverse: WorkspaceMap) -> ArticleFinding:
    """Is ε_max always less than 0.3827 on the line of Fig. 8, elbow up as in Table 2? The other elbow stands beside."""
    limit = math.sin(math.pi / 8)
    largest = {f"{c.control}, elbow {c.elbow}": float(np.nanmax(c.epsilon_max)) for c in lines}
    drawn = max(float(np.nanmax(c.epsilon_max)) for c in lines if c.elbow == "up")
    listed = "; ".join(f"{name} {value:.6f}" for name, value in largest.items())
    values = inverse.array("epsilon_max")
    share, elsewhere = inverse.fraction(values > limit), float(np.nanmax(values))
    sentence = (
        f"Along y = {lines[0].y:g} m of the workspace ε_max is at most: {listed}. With the elbow up, as in Table 2, "
        f"this most is {'below' if drawn < PRINTED_MAXIMUM else 'not below'} {PRINTED_MAXIMUM}, and "
        f"{'above' if drawn > limit else 'below'} sin(π/8) = {limit:.6f}, the ε_max of a/s². Off that line, in the "
        f"mapped workspace, it reaches {elsewhere:.6f} and exceeds sin(π/8) on {100 * share:.1f} %."
    )
    numbers = {"largest": largest, "sin_pi_8": limit, "largest_in_workspace": elsewhere, "fraction_above": share}
    holds = drawn < PRINTED_MAXIMUM
    return ArticleFinding(
        "maximum of ε_max", "always less than its maximum of 0.3827", "Fig. 8", holds, sentence, numbers
    )


def union(inverse: WorkspaceMap) -> ArticleFinding:
    """Is the total in-phase region of Fig. 5(d) the union of (a) and (b)?"""
    in_phase = inverse.array("in_phase")[:2] == 1
    first, second = (inverse.fraction(mask) for mask in in_phase)
    either, both = inverse.fraction(in_phase.any(axis=0)), inverse.fraction(in_phase.all(axis=0))
    false = (either - both) / either
    sentence = (
        f"Mode 1 is in phase on {100 * first:.1f} % of the workspace, mode 2 on {100 * second:.1f} %, at least one on "
        f"{100 * either:.1f} %, both on {100 * both:.1f} %. On {100 * false:.1f} % of the union one of the two modes "
        "is out of phase, so a region that is in phase for both can only be the intersection."
    )
    numbers = {"mode_1": first, "mode_2": second, "union": either, "intersection": both, "union_out_of_phase": false}
    quote = "the total in-phase region for the first and second modes; the union of (a) and (b)"
    return ArticleFinding("union", quote, "Fig. 5(d)", bool(false < 1e-3), sentence, numbers)


def semidefinite(table: ArticleTable, inverse: WorkspaceMap, transpose: WorkspaceMap) -> ArticleFinding:
    """Are the residues positive semidefinite?"""
    shares = {m.options["control"]: [m.fraction(w < -ROBUST) for w in m.array("w")] for m in (inverse, transpose)}
    printed = max(w for row in table.rows for w in row.printed_w)
    sentence = (
        f"Every w_i = λmin(R_i + R_iᵀ) printed in Table 2 is negative, {printed:.3g} at most, and so is w_1 on "
        f"{100 * shares['inverse'][0]:.1f} % (inverse) and {100 * shares['transpose'][0]:.1f} % (transpose) of the "
        f"workspace (below −{ROBUST:g})."
    )
    holds = max(max(s) for s in shares.values()) == 0.0
    return ArticleFinding(
        "definiteness", "Ri is positive-semi-definite", "section 3.4", holds, sentence, {"fraction_negative": shares}
    )


def gain_independent(machine: AnyMachine, postures: dict[str, Vector], gain: float) -> ArticleFinding:
    """Does ε_max depend on the servo gain?"""
    margin = build_margin(machine)
    p = margin.plant.parameter_values
    gains = [gain * factor for factor in (0.01, 0.1, 1.0, 10.0)]
    values = {name: [epsilon_at(machine, q, kr) for kr in gains] for name, q in postures.items()}
    slopes = {n: float(margin.gradients.call([0.0, q, p, gain])[3][0]) for n, q in postures.items()}
    relative = {name: slopes[name] * gain / values[name][2] for name in postures}
    spread = max(max(v) - min(v) for v in values.values())
    sentence = "; ".join(
        f"at {name} ε_max is {', '.join(f'{v:.4f}' for v in values[name])} for kr = "
        f"{', '.join(f'{k:.3g}' for k in gains)} and kr/ε ∂ε/∂kr = {relative[name]:+.4f} at kr = {gain:.3g}"
        for name in postures
    )
    numbers = {"gains": gains, "epsilon_max": values, "derivative": slopes, "relative_derivative": relative}
    sentence = f"{sentence[0].upper()}{sentence[1:]}."
    return ArticleFinding("gain", "is gain independent", "section 3.5", spread < 1e-4, sentence, numbers)


def concave(curves: Sequence[Curve]) -> ArticleFinding:
    """Has w_1 one maximum along y_d, as a concave objective would?"""
    peaks = {f"{c.control}, elbow {c.elbow}": c.maxima() for c in curves}
    listed = "; ".join(f"{name}: x = {', '.join(f'{x:.3f}' for x in xs)} m" for name, xs in peaks.items())
    bent = f"the arm at least {curves[0].margin_deg:g}° from straight and from folded"
    sentence = f"w_1 has several local maxima along y = {curves[0].y:g} m of the workspace, {bent} ({listed})."
    holds = all(x.size <= 1 for x in peaks.values())
    quote = "a weighted sum … will violate the concavity of the objective function"
    return ArticleFinding("concavity", quote, "section 4", holds, sentence, {"maxima": peaks})


def b_is_optimal(machine: AnyMachine, points: dict[str, Vector], inverse_up: Curve) -> ArticleFinding:
    """Is w_1 stationary along the redundancy at Table 2's posture B?"""
    measures = build_measures(machine)
    plant = measures.plant
    p, base = plant.parameter_values, np.zeros(plant.n_base)
    slopes: dict[str, float] = {}
    for name, posture in points.items():
        jacobian = plant.base_jacobian(base=base, posture=posture, p=p)["J_B"].full()
        # Along the redundancy the end-point stays where it is: J_B dz = 0 with dz = (1, …).
        back = cast(Vector, np.linalg.solve(jacobian[:, 1:], jacobian[:, 0]))
        along = np.append(1.0, -back)
        # Moving the base by +1 m moves the end-point by −1 m in the workspace frame.
        slopes[name] = -float(measures.gradients.call([base, posture, p])[0].full()[0] @ along)
    peaks = inverse_up.maxima()
    nearest = float(peaks[np.argmin(np.abs(peaks - 1.5))])
    listed = ", ".join(f"{slope:+.3g} per m at {name}" for name, slope in slopes.items())
    sentence = (
        f"Along the redundancy ∂w_1/∂x is {listed}, not 0; the nearest local maximum of w_1 with the elbow up lies at "
        f"workspace x = {nearest:.3f} m."
    )
    holds = min(abs(slope) for slope in slopes.values()) < 1e-9
    quote = "the optimized position"
    return ArticleFinding(
        "B as an optimum", quote, "section 5.1", holds, sentence, {"slope": slopes, "maximum": nearest}
    )


def same_shape(curves: Sequence[Curve]) -> ArticleFinding:
    """Do ε_max and w_1 follow the same shape along y_d? Curves of Fig. 8, elbow up as in Table 2."""
    numbers = {
        f"{c.control}, elbow {c.elbow}": rank_correlation(c.w[0][c.regular], c.epsilon_max[c.regular]) for c in curves
    }
    listed = ", ".join(f"{value:.3f} ({name})" for name, value in numbers.items())
    holds = min(numbers.values()) > 0.7
    lost: dict[str, float] = {}
    for c in curves:
        epsilon = c.epsilon_max[c.regular]
        lost[f"{c.control}, elbow {c.elbow}"] = float(epsilon.max() - epsilon[np.argmax(c.w[0][c.regular])])
    sentence = (
        f"Spearman's rank correlation of ε_max and w_1 along y = {curves[0].y:g} m, {curves[0].margin_deg:g}° and more "
        f"from straight: {listed}. Where w_1 is largest, ε_max is at most {max(lost.values()):.5f} below its own "
        "maximum."
    )
    return ArticleFinding(
        "same shape", "follow the same general shape", "section 4, Fig. 8", holds, sentence,
        {"rank_correlation": numbers, "epsilon_max_lost_by_choosing_w1": lost},
    )  # fmt: skip


def many_in_phase(inverse: WorkspaceMap) -> ArticleFinding:
    """How many configurations are in phase for the first two modes?"""
    both, strict = inverse.in_phase_fraction(1, 2), inverse.in_phase_fraction(1, 2, strict=True)
    sentence = (
        f"{100 * both:.1f} % of the workspace is in phase for the first two modes by the sign of trace R_i, "
        f"{100 * strict:.1f} % by the stricter reading (no diagonal element negative); for all three modes "
        f"{100 * inverse.in_phase_fraction(1, 2, 3):.1f} %."
    )
    numbers = {"first_two": both, "first_two_strict": strict, "all_three": inverse.in_phase_fraction(1, 2, 3)}
    quote = "many configurations that are in-phase for the first two vibrational modes"
    return ArticleFinding("in phase", quote, "section 3.5", both > 0.1, sentence, numbers)


def passive(selection: Selection, rigid: dict[str, Vector]) -> ArticleFinding:
    """Is the plant passive in robust configurations?

    Args:
        selection: local optima of w_1, Jacobian inverse control.
        rigid: λmin(R_0 + R_0ᵀ) of random postures, by control.
    """
    robust = [c.evaluation for c in selection.candidates if c.evaluation.w[0] > -ROBUST]
    indefinite = {control: float(np.mean(values[np.isfinite(values)] < 0)) for control, values in rigid.items()}
    r0, others = [e.rigid for e in robust], [float(e.w[1:].min()) for e in robust]
    positive = sum(value >= 0 for value in r0)
    holds = bool(robust) and positive == len(robust) and min(others) > -ROBUST
    sentence = (
        f"Of the {len(robust)} local optima with w_1 = 0, {positive} have a positive semidefinite R_0 + R_0ᵀ (λmin "
        f"from {min(r0):.3g} to {max(r0):.3g}), and the lowest of their other w_i lies between {min(others):.3g} and "
        f"{max(others):.3g}: "
        f"w_1 = 0 alone makes no plant passive. R_0 + R_0ᵀ is indefinite at {100 * indefinite['inverse']:.1f} % of "
        f"random postures with inverse control and {100 * indefinite['transpose']:.1f} % with transpose control."
    )
    numbers = {"optima_rigid": r0, "optima_other_w": others, "fraction_indefinite": indefinite}
    return ArticleFinding("passivity", "positive real and therefore passive", "section 3.5", holds, sentence, numbers)


def features(maps: Sequence[WorkspaceMap]) -> ArticleFinding:
    """Do features of the w_i surfaces appear in that of ε_max?"""
    numbers: dict[str, list[float]] = {}
    for result in maps:
        epsilon, w = result.array("epsilon_max"), result.array("w")
        sums = [*w, w.sum(axis=0)]
        numbers[result.options["control"]] = [rank_correlation(x.ravel(), epsilon.ravel()) for x in sums]
    listed = "; ".join(
        f"{control}: {', '.join(f'w_{i + 1} {v:+.2f}' for i, v in enumerate(values[:-1]))}, their sum {values[-1]:+.2f}"
        for control, values in numbers.items()
    )
    first = min(values[0] for values in numbers.values())
    verdicts: list[str] = []
    for mode, values in enumerate(zip(*numbers.values(), strict=True)):
        low, high = min(values), max(values)
        word = "appear" if low > 0.5 else "run against it" if high < -0.3 else "hardly appear"
        verdicts.append(f"those of w_{mode + 1} {word}")
    sentence = f"Rank correlation of ε_max with w_i over the map ({listed}): {', '.join(verdicts[:-1])}."
    quote = "features in the modal-based robustness surfaces appear in the coprime factorization surfaces"
    return ArticleFinding(
        "features", quote, "section 3.5, Figs. 6, 7", first > 0.5, sentence, {"rank_correlation": numbers}
    )
