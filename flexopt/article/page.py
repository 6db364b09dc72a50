"""The page of `flexopt reproduce`: one HTML file that needs no other.

In: a `Reproduction`. Out: HTML, its pictures inside.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from flexopt.article.findings import DOUBTED
from flexopt.article.tables import DEVIATION
from flexopt.foundation.rendering import OfNumbers, render
from flexopt.study.gains import BorderRow
from flexopt.study.page import PageTable, pictures

if TYPE_CHECKING:
    from flexopt.article.reproduction import Reproduction

DOUBT = "± of a decay is its standard error in the run, than which one in three is farther off."
FRAME = "Each end-point is reached with the elbow up; the workspace frame begins at the first joint at rest."
CAPTIONS = {
    "figure5": "Fig. 5. In-phase (yellow) and out-of-phase (blue) regions, Jacobian inverse control: trace R_i > 0. "
    "(d) is drawn as the intersection, which the caption's “union” must mean (see below). Red: Table 2's postures. "
    f"{FRAME}",
    "figure6": f"Fig. 6. ε_max over the workspace with the inferred servo gain. Red: Table 2's postures. {FRAME}",
    "figure7": f"Fig. 7. w_i over the workspace: (a) to (c) transpose, (d) to (f) inverse control. {FRAME}",
    "figure8": "Fig. 8. ε_max and w_1 along y_d, elbow up. Red lines: Table 2's end-points, and where the measures "
    "printed for posture B are found.",
    "figure9": "Fig. 9. Nonlinear closed loop at postures A and B of Table 2: base oscillation on the right, "
    "the article's (a) to (c). Gains and start are stated, not printed. The end-point error on the left and the "
    f"optimised posture are additions. {DOUBT}",
    "figure10": "Fig. 10. The base's way by nullspace augmentation from posture A, with the article's stop and without "
    "it: the machine on the left; on the right, from top to bottom, position and rate of the base and the objective.",
    "figures11and12": "Figs. 11 and 12. End-point error on the left, base oscillation on the right, with base "
    "adjustment from A to B along Fig. 10, and without at A. Gains and start are stated, not printed. "
    f"{DOUBT}",
    "gains": "Not in the article: decay of the sampled linear loop over both gains, exact between the samples, black "
    "where it is 0; marks: nonlinear runs by RK4 at 200 Hz, crosses where they show another sign than this decay.",
    "gaps": "Not in the article: ν-gap between kr R0/s² and the full plant, and ε_max, as the damping grows.",
}


def report_html(result: Reproduction) -> str:
    """The page."""
    return render(
        "article/templates/reproduction.html",
        title="The article, computed again",
        provenance=result.to_dict()["provenance"],
        result=result,
        doubted=DOUBTED,
        pictures={
            name: each._replace(caption=CAPTIONS[name])
            for name, each in pictures(lambda theme: result.figures(theme=theme)).items()
        },
        servo_gain=_servo_gain(result),
        deviation=f"Deviation: {DEVIATION}.",
        table2=_table2(result),
        frequencies=_frequencies(result),
        loops=_loops(result),
        borders=_borders(result),
        gaps=_gaps(result),
    )


def _servo_gain(result: Reproduction) -> str:
    gain = result.table.inferred
    return (
        f"The servo gain kr is not printed. kr = {gain.kr:.5g} gives posture A ({gain.reading}) its ε_max of "
        f"{gain.printed}, and {gain.interval[0]:.4g} to {gain.interval[1]:.4g} round to it; A is thus no test of "
        f"ε_max, but B is. kr = {gain.other:.4g} would suit A, too, but makes B, "
        f"at the point of its measures, {gain.other_epsilon_b:.4f}."
    )


def _table2(result: Reproduction) -> PageTable:
    rows = list[tuple[str, ...]]()
    for row in result.table.rows:
        name = f"{row.posture}: {row.reading}"
        for i, w in enumerate(row.evaluation.w):
            rows.append(
                (name if i == 0 else "", f"w{i + 1}", f"{row.printed_w[i]:.4e}", f"{w:.5e}", f"{row.deviation[i]:+.2%}")
            )
        off = f"{row.epsilon_max_deviation:+.1e}"
        rows.append(("", "ε_max", f"{row.printed_epsilon:.4f}", f"{row.epsilon_inferred:.5f}", off))
    numbers = map(OfNumbers, ("printed", "computed", "deviation"))
    header = ("posture and its input", "measure", *numbers)
    return header, rows


def _frequencies(result: Reproduction) -> PageTable:
    f = result.frequencies
    rows: list[tuple[str, ...]] = [("printed", *(f"{v:.4f}" for v in f.printed))]
    for name, values in f.means.items():
        rows.append((name, *(f"{v:.4f} ({d:+.2%})" for v, d in zip(values, f.deviation[name], strict=True))))
    return ("mean, Hz", *(OfNumbers(f"mode {i + 1}") for i in range(len(f.printed)))), rows


def _loops(result: Reproduction) -> PageTable:
    """Poles and runs of every posture with both pairs of gains."""
    rows: list[tuple[str, ...]] = []
    for row in result.loops.rows:
        stated, accurate = (f"{-x.growth_rate:+z.4f} at {x.frequency_hz:.2f} Hz" for x in (row.stated, row.accurate))
        run = row.run
        rate = "" if run.growth_rate is None else f" {-run.growth_rate:+z.4f}"
        turn = "" if run.peak_base_rotation is None else f"{1e3 * run.peak_base_rotation:.2f}"
        off = "" if run.end_error is None else f"{1e3 * run.end_error:.3f}"
        words = f"{run.verdict}{rate}, {run.time[-1]:g} s"
        rows.append((row.stand, f"{row.kp:g}", f"{row.kv:g}", stated, accurate, words, turn, off))
    header = (
        "posture", OfNumbers("Kp, N m"), OfNumbers("Kv, N m s"), "decay, RK4, 1/s", "decay, exact, 1/s",
        "nonlinear run, decay, 1/s", OfNumbers("largest base rotation, mrad"),
        OfNumbers("end-point at the end, mm off"),
    )  # fmt: skip
    return header, rows


def _borders(result: Reproduction) -> PageTable:
    """Stable Kp, a row for each posture and what is held, a column for each integrator."""
    g = result.gains
    methods = list(dict.fromkeys(row.integrator for row in g.borders))
    rows = [
        (row.stand, row.held, *(_border(g.border(row.stand, row.held, method)) for method in methods))
        for row in g.borders
        if row.integrator == methods[0]
    ]
    return ("stable Kp, N m", "held", *(f"{method} at 200 Hz" for method in methods)), rows


def _border(row: BorderRow) -> str:
    beyond = "" if row.frequency_hz is None else f" (then {row.frequency_hz:.2f} Hz grows)"
    return row.text + beyond


def _gaps(result: Reproduction) -> PageTable:
    g = result.gaps
    rows: list[tuple[str, ...]] = []
    for k, name in enumerate(g.names):
        cells = (
            f"{n:.5f} / {w:.5f} / {e:.4f}" for n, w, e in zip(g.nu_gap[k], g.gap[k], g.epsilon_max[k], strict=True)
        )
        rows.append((name, f"{g.w1[k]:.3e}", *cells))
    rows.append(("nearer than sin(π/8)", "", *(f"{n} of {len(g.names)}" for n in g.within)))
    rows.append(("rank correlation, ν-gap with ε_max", "", *(f"{c:+.2f}" for c in g.correlation_epsilon)))
    return ("ν-gap / gap / ε_max", OfNumbers("w1"), *(f"damping × {f:g}" for f in g.factors)), rows
