"""How many dimensions sets of optima have, beside a walk along them that knows nothing of charts and slopes.

Run: python -m benchmarks.dimensions [--cases N] [--workers N]

For an optimum with w_i = 0 points about it, at random, are moved back by the shortest steps of least squares, with
differences for slopes, to where the end-point is on the target and a_i bᵢᵀ is symmetric. What they then lie on has as
many dimensions as the matrix of their displacements has singular values that are no share of the step's length.
"""

from __future__ import annotations

import argparse
import functools
from collections.abc import Iterator
from multiprocessing import get_context
from typing import Any

import numpy as np

import flexopt
from benchmarks.choice import MACHINES, chosen
from benchmarks.timing import table
from flexopt.errors import FlexoptError
from tests.oracles.machines import arm_at_rest, random_machine, regular_posture

STEP, POINTS, SHARE = 2e-4, 24, 0.05
# Steps of least squares, of differences, and the share of the largest singular value below which one is none: the
# equations are more than they hold, and what they do not hold must not be slid along.
STEPS, ASIDE, DEPENDENT = 8, 1e-6, 1e-6
# A target and what is asked of it.
Case = tuple[str, Any, Any, dict[str, Any]]


def walked(problem: flexopt.SelectionProblem, z: np.ndarray, modes: list[int], seed: int) -> int:
    """The dimension of the set about z on which the w_i of these modes are 0 and the target is reached."""
    rng = np.random.default_rng(seed)
    plant, scale = problem.measures.plant, problem.scale
    free = np.flatnonzero(problem.lower < problem.upper)

    @functools.cache
    def sizes_of(start: bytes) -> np.ndarray:
        lengths = np.linalg.norm(problem.factors(np.frombuffer(start))[0], axis=2)
        return lengths.prod(axis=1)[modes]

    def sizes_at(start: np.ndarray) -> np.ndarray:
        """|a_i||b_i| where a walk begins: one of them may be zero on the way."""
        return sizes_of(start.tobytes())

    def residual(y: np.ndarray, start: np.ndarray) -> np.ndarray:
        there = start.copy()
        there[free] += y * scale[free]
        n_base, p = plant.n_base, plant.parameter_values
        out = problem.measures.w.call([there[:n_base], there[n_base:], p])
        f = problem.factors(there)[0]
        crossed = [np.outer(f[i, 0], f[i, 1]) / size for i, size in zip(modes, sizes_at(start), strict=True)]
        across = [(each - each.T)[np.triu_indices(len(each), 1)] for each in crossed]
        return np.concatenate([(out[2].full().ravel() - problem.target) / scale.max(), *across])

    moved = []
    for _ in range(POINTS):
        start = z.copy()
        start[free] += STEP * rng.standard_normal(free.size) * scale[free]
        y = np.zeros(free.size)
        for _ in range(STEPS):
            each = ASIDE * np.eye(free.size)
            slopes = [(residual(y + e, start) - residual(y - e, start)) / (2 * ASIDE) for e in each]
            y -= np.linalg.pinv(np.transpose(slopes), rcond=DEPENDENT) @ residual(y, start)
        moved.append((start - z)[free] / scale[free] + y)
    sizes = np.linalg.svd(np.array(moved) / STEP, compute_uv=False) / np.sqrt(POINTS)
    return int(np.sum(sizes > SHARE))


def cases(count: int) -> Iterator[Case]:
    """Random planar machines, and the shipped ones in space with random targets; w_1, or two modes together."""
    for number in range(count):
        if number % 2:
            name = MACHINES[number // 2 % len(MACHINES)]
            machine, target, options = chosen(name, number)
            yield f"{name} {number}", machine, target, {"control": options["control"], "objective": "w1", "starts": 6}
            continue
        rng = np.random.default_rng(number)
        name, machine = random_machine(rng)
        target = arm_at_rest(machine, regular_posture(rng, machine))[1]
        m = flexopt.build_plant(machine).n_passive
        weights = [1.0] * min(m, 1 + number % 4 // 2) + [0.0] * max(0, m - 1 - number % 4 // 2)
        yield f"{number}: {machine.name}", machine, target, {"objective": "V", "weights": weights, "starts": 6}


def examined(case: Case) -> tuple[str, int, int | None, int | None, str]:
    """Name, joints, dimension told, dimension walked, and what happened otherwise."""
    name, machine, target, options = case
    try:
        found = flexopt.select(machine, target, workers=1, **options)
    except FlexoptError as error:
        return name, len(machine.joints), None, None, str(error)[:60]
    best, problem = found.best, found.problem
    if not best.unsurpassed or best.dimension is None:
        return name, len(machine.joints), best.dimension, None, "V is not 0" if not best.unsurpassed else "not told"
    modes = [i for i, alpha in enumerate(problem.objectives[0].alpha) if alpha > 0]
    return name, len(machine.joints), best.dimension, walked(problem, best.z, modes, 0), ""


def main() -> None:
    """Print a row for each case, and how many agree."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--cases", type=int, default=50, help="that many with V = 0")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    rows = [("case", "joints", "told", "walked", "")]
    right = told = 0
    with get_context("spawn").Pool(options.workers) as pool:
        for row in pool.imap(functools.partial(examined), cases(4 * options.cases)):
            rows.append((row[0], *(str(x) for x in row[1:])))
            right += row[3] is not None and row[2] == row[3]
            told += row[3] is not None
            if told == options.cases:
                break
        pool.terminate()
    print(table(f"{right} of {told} right; {len(rows) - 1 - told} left out, V < 0 or not told", rows))


if __name__ == "__main__":
    main()
