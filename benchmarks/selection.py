"""Time of one warm IPOPT solve and of the whole `select`, beside SciPy's SLSQP on the same problem.

Run: python -m benchmarks.selection

The peer gets the same objective, gradient, constraints and starts, from the same CasADi Functions; it has no exact
Hessian, and its answers are not verified afterwards. The whole `select` includes the scan of the redundancy, every
IPOPT solve, the independent checks and the evaluation of each candidate.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import minimize

import flexopt
from benchmarks.timing import fresh_process, median_seconds, table
from flexopt.foundation.arrays import Vector
from flexopt.selection.nlp.program import single
from flexopt.selection.scan import peaks

COLD_SELECT = """
import time, flexopt
problem = flexopt.load_problem("article")
start = time.perf_counter()
flexopt.solve_problem(problem)
print(time.perf_counter() - start)
"""
IMPORT = "import time; start = time.perf_counter(); import flexopt; print(time.perf_counter() - start)"


def _fresh(code: str, repeats: int = 7) -> float:
    """Median of what a fresh process prints, s."""
    runs = [float(fresh_process(code)[1]) for _ in range(repeats)]
    return float(np.median(runs))


def _process(arguments: list[str], repeats: int = 7) -> float:
    """Median wall time of the command line as a process, s."""
    program = "from flexopt.cli import main; main()"
    times = [fresh_process(program, *arguments)[0] for _ in range(repeats)]
    return float(np.median(times))


def _slsqp(problem: flexopt.SelectionProblem, start: Vector) -> Vector:
    plant, measures = problem.measures.plant, problem.measures
    p, scale, alpha = plant.parameter_values, problem.scale, np.array(problem.objective.alpha)

    def value(x: Vector) -> float:
        z = x * scale
        return -float(alpha @ measures.w.call([z[:1], z[1:], p])[0].full().ravel()) / problem.objective_scale

    def gradient(x: Vector) -> Vector:
        z = x * scale
        return -(alpha @ measures.gradients.call([z[:1], z[1:], p])[0].full()) * scale / problem.objective_scale

    def target(x: Vector) -> Vector:
        z = x * scale
        return (measures.w.call([z[:1], z[1:], p])[2].full().ravel() - problem.target) / scale[0]

    def target_jacobian(x: Vector) -> Vector:
        z = x * scale
        return measures.gradients.call([z[:1], z[1:], p])[2].full() * scale / scale[0]

    def margin(x: Vector) -> Vector:
        z = x * scale
        return plant.singularity_sine_squared(z[:1], z[1:], p).full().ravel() - problem.constraints[-1].lower

    def margin_jacobian(x: Vector) -> Vector:
        z = x * scale
        return plant.singularity_gradient(z[:1], z[1:], p).full() * scale

    constraints: Any = [
        {"type": "eq", "fun": target, "jac": target_jacobian},
        {"type": "ineq", "fun": margin, "jac": margin_jacobian},
    ]
    result = minimize(
        value,
        start / scale,
        jac=gradient,
        method="SLSQP",
        constraints=constraints,
        options={"ftol": 1e-14, "maxiter": 200},
    )
    return result.x * scale


def main() -> None:
    """Print the tables."""
    machine = flexopt.load("excavator")
    rows: list[tuple[str, ...]] = [
        ("control", "IPOPT, one warm solve", "SLSQP, one solve", "IPOPT : SLSQP", "worst IPOPT start")
    ]
    for control in ("inverse", "transpose"):
        problem = flexopt.build_selection(machine, (0.0, 1.6), control=control, base=0.0)
        starts = [np.concatenate([problem.scan.base[:, k], problem.scan.posture[:, k]]) for k in peaks(problem.scan)]
        ours = [median_seconds(partial(single(problem).solve, start)) for start in starts]
        theirs = [median_seconds(partial(_slsqp, problem, start)) for start in starts]
        median, peer = float(np.median(ours)), float(np.median(theirs))
        rows.append(
            (
                control,
                f"{1e3 * median:.2f} ms",
                f"{1e3 * peer:.2f} ms",
                f"1 : {peer / median:.1f}",
                f"{1e3 * max(ours):.2f} ms",
            )
        )
    print(table("One solve from a peak of the scan (median over the starts)", rows))

    warm = median_seconds(lambda: flexopt.select(machine, (0.0, 1.6), base=0.0))
    posture = ["evaluate", "excavator", "--posture", "0.9929,-2.6306"]
    print(
        table(
            "Whole runs",
            [
                ("what", "time", "bar"),
                (
                    "select, article's problem, all branches, first call after import",
                    f"{1e3 * _fresh(COLD_SELECT):.0f} ms",
                    "300 ms",
                ),
                ("the same, warm", f"{1e3 * warm:.0f} ms", ""),
                ("import flexopt", f"{1e3 * _fresh(IMPORT):.0f} ms", "300 ms"),
                ("flexopt evaluate excavator, a process", f"{1e3 * _process(posture):.0f} ms", "1000 ms"),
                ("flexopt select article, a process", f"{1e3 * _process(['select', 'article']):.0f} ms", ""),
            ],
        )
    )


if __name__ == "__main__":
    main()
