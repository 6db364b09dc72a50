"""Several targets: the shipped problems, the planar one against an exhaustive search. `python -m benchmarks.several`.

The search knows nothing of the solver: for each target a grid of placements and, from each, of all postures; then
dynamic programming over all placements that the base reaches in time. It leaves the joints' rates aside, so that no way
through the grid is better than what it finds.
"""

from __future__ import annotations

import math
import time

import numpy as np
from numpy.typing import NDArray

import flexopt
from flexopt.plant.inverse_kinematics import branch
from flexopt.robustness import evaluate_w
from flexopt.selection.several import BasePlan, Stand

BASES, POSTURES = 281, 601
Floats = NDArray[np.float64]


def best_from(plan: BasePlan, k: int, bases: Floats) -> tuple[Floats, int]:
    """The best V (N,) at target k from each placement, −∞ where none is allowed; and how many postures are."""
    problem = plan.problems[k]
    plant = problem.measures.plant
    number, unit = (
        x.ravel() for x in np.meshgrid(np.arange(bases.size), np.linspace(0.0, 1.0, POSTURES), indexing="ij")
    )
    number, unit = number.astype(int), unit[None, :]
    best, count = np.full(bases.size, -np.inf), 0
    for sign in (-1.0, 1.0):
        postures, reaches = branch(plant, problem.target, bases[None, number], unit, sign)
        z, here = np.vstack([bases[None, number], postures])[:, reaches], number[reaches]
        good = np.all((z >= problem.lower[:, None]) & (z <= problem.upper[:, None]), axis=0)
        z, here = z[:, good], here[good]
        good = allowed(plan, k, z)
        z, here = z[:, good], here[good]
        value = np.array(problem.objective.alpha) @ evaluate_w(problem.measures, z[:1], z[1:]).w
        np.maximum.at(best, here, value)
        count += value.size
    return best, count


def allowed(plan: BasePlan, k: int, z: Floats) -> NDArray[np.bool_]:
    """Which configurations (n_z, N) keep the margin and the constraints."""
    problem = plan.problems[k]
    plant = problem.measures.plant
    at = [z[:1], z[1:], plant.parameter_values]
    rows = [plant.singularity_sine_squared.call(at)[0].full()]
    if problem.constraint_set is not None:
        rows.append(problem.constraint_set.function.call([*at, problem.constraint_set.constants])[0].full())
    asked = problem.constraints[problem.target.size :]
    lower, upper = (np.array([getattr(c, end) for c in asked])[:, None] for end in ("lower", "upper"))
    values = np.vstack(rows)
    good: NDArray[np.bool_] = np.all((values >= lower) & (values <= upper), axis=0)
    return good


def exhaustive(plan: BasePlan, base_rate: float) -> tuple[float, float, int]:
    """The best worst V of a way through the grid, and of one placement for all; configurations in all."""
    first = plan.problems[0]
    bases = np.linspace(first.lower[0], first.upper[0], BASES)
    level, still, count = np.full(BASES, np.inf), np.full(BASES, np.inf), 0
    for k in range(len(plan.problems)):
        best, looked = best_from(plan, k, bases)
        count += looked
        still = np.minimum(still, best)
        step = base_rate * (plan.time[k] - plan.time[k - 1]) if k else 0.0
        near = np.abs(bases[:, None] - bases) <= step + 1e-9
        level = np.minimum(best, np.where(near, level[:, None], -np.inf).max(axis=0))
    return float(level.max()), float(still.max()), count


def main() -> None:
    print(
        f"{'problem':<10} {'targets':>7} {'worst V moving':>15} {'standing still':>15} {'seconds':>8} {'once more':>9}"
    )
    plan: BasePlan | None = None
    for name in ("trench", "stations"):
        problem, seconds = flexopt.load_problem(name), []
        for _ in range(2):
            begin = time.perf_counter()
            result = flexopt.solve_problem(problem, workers=1)
            seconds.append(time.perf_counter() - begin)
        assert isinstance(result, BasePlan | Stand)
        plan = result if isinstance(result, BasePlan) else plan
        moving = f"{result.worth:15.5e}" if isinstance(result, BasePlan) else f"{'–':>15}"
        standing = result.standing if isinstance(result, BasePlan) else result.worth
        print(f"{name:<10} {len(result.places):7d} {moving} {standing:15.5e} {seconds[0]:8.2f} {seconds[1]:9.2f}")
    assert plan is not None
    begin = time.perf_counter()
    moving, standing, count = exhaustive(plan, 0.05)
    seconds = time.perf_counter() - begin
    best = f"{moving:.5e} moving, {standing:.5e} still"
    print(f"trench, exhaustive search over {count} configurations: {best}, {seconds:.1f} s")
    for what, found, grid in (("moving", plan.worth, moving), ("still", plan.standing, standing)):
        gain = (found - grid) / abs(grid)
        print(f"flexopt is {'better' if gain >= 0 else 'WORSE'} by {abs(gain):.3%}, {what}")
    if not math.isfinite(moving):
        print("no way through the grid: make it finer")


if __name__ == "__main__":
    main()
