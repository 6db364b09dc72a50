"""The choice beside another method: random feasible configurations, the best of them improved without slopes.

Run: python -m benchmarks.choice [--cases N] [--machines NAME …] [--samples N] [--workers N]

Random targets, weights and sets of constraints on machines in space. The other method shares with `flexopt.select` what
values are computed by (w_i, end-point, rows of constraints), and neither starts, slopes, solvers nor steps onto the
target: samples are moved there by Newton's steps in NumPy with differences of the end-point, and improved by an
evolution strategy of one parent and one child each, which takes a child where it keeps everything and V is larger.

The gap is how much better the other method is, as a share of the scale of |a||b|; a failure is a problem that the first
call does not solve.
"""

from __future__ import annotations

import argparse
import functools
import math
import time
from collections.abc import Callable, Iterator, Sequence
from multiprocessing import get_context
from typing import Any

import numpy as np

import flexopt
from benchmarks.timing import table
from flexopt.errors import FlexoptError
from flexopt.foundation.arrays import Vector

MACHINES = ("slewing-excavator", "truck-crane", "mobile-manipulator", "boom-stick-bucket")
SAMPLES, PARENTS, STEPS = 2000, 200, 300
# Newton's steps onto the target, the step of their differences, how near is on it, and how much of a row's scale a
# feasible point may break: less than proofs allow.
NEWTON, DIFFERENCE, NEAR, KEPT = 8, 1e-6, 1e-10, 1e-9
FIRST, LEAST, MOST, LONGER, SHORTER = 0.2, 1e-7, 0.5, 1.5, 0.85
BAR = 1e-4
Row = tuple[str, int, float, float, float, str]


def chosen(name: str, number: int) -> tuple[Any, Vector, dict[str, Any]]:
    """A machine, a random target that it reaches, and options of `flexopt.select`."""
    machine = flexopt.load(name)
    rng = np.random.default_rng([number, sum(map(ord, name))])
    plant = flexopt.build_plant(machine)
    limits = np.array(machine.limits)
    low, high = np.clip(limits, -2.0, 2.0).T
    posture = low + (high - low) * rng.uniform(0.15, 0.85, len(low))
    base = np.zeros(len(machine.base_coordinates))
    p = plant.parameter_values
    target = plant.end_point(plant.rest(base, posture, p), base, p).full().ravel()
    m = plant.n_passive
    weights = np.where(rng.uniform(size=m) < 0.7, rng.uniform(0.1, 1.0, m), 0.0)
    weights[int(rng.integers(m))] = 1.0
    kinds: dict[str, Any] = {}
    if rng.uniform() < 0.5:
        kinds["joint_margin"] = 0.05
    if rng.uniform() < 0.4:
        kinds["clearance"] = {"distance": 0.1, "ground": float(min(target[-1], 0.0)) - 1.0}
    if rng.uniform() < 0.4 and "yaw" in machine.base_coordinates:
        x, y = target[0], target[1]
        kinds["keep_out"] = [[[x - 1, y - 1], [x + 1, y - 1], [x + 1, y + 1], [x - 1, y + 1]]]
        kinds["holds"] = "point"
    if rng.uniform() < 0.4:
        kinds["travel"] = {"cost": 1e-2, "base": base.tolist(), "posture": posture.tolist()}
    options: dict[str, Any] = {"objective": "V", "weights": weights.tolist(), "constraints": kinds or None}
    return machine, target, options | {"control": ("inverse", "transpose")[number % 2]}


class Other:
    """The other method on a selection's problem."""

    def __init__(self, problem: flexopt.SelectionProblem, seed: int) -> None:
        self.problem, self.rng = problem, np.random.default_rng(seed)
        self.plant, self.measures = problem.measures.plant, problem.measures
        self.n_base, self.p = self.plant.n_base, self.plant.parameter_values
        self.lower, self.upper = problem.lower[:, None], problem.upper[:, None]
        self.moving = (problem.scale * (problem.lower < problem.upper))[:, None]
        self.alpha = np.array(problem.objective.alpha)

    def values(self, z: Vector) -> Vector:
        """V (N,), the cost of travel taken off; −∞ where anything is broken."""
        problem = self.problem
        at = [z[: self.n_base], z[self.n_base :], self.p]
        value = self.alpha @ self.measures.w.call(at)[0].full()
        if problem.travel is not None:
            away = (z - problem.travel.now[:, None]) / problem.scale[:, None]
            value = value - problem.travel.cost * problem.objective_scale * (away**2).sum(axis=0)
        rows = problem.configuration.rows_alone.call([*at, problem.constants])[0].full()
        lower, upper, scale = (x[:, None] for x in problem.row_bounds)
        broken = np.maximum(lower - rows, rows - upper) / scale
        inside = np.all((z >= self.lower) & (z <= self.upper), axis=0)
        return np.where(inside & (broken.max(axis=0) <= KEPT) & np.isfinite(value), value, -np.inf)

    def end_points(self, z: Vector) -> Vector:
        """(r, N), at rest."""
        at = [z[: self.n_base], z[self.n_base :], self.p, self.problem.constants]
        return self.problem.configuration.rows_alone.call(at)[0].full()[: self.problem.target.size]

    def onto(self, z: Vector) -> Vector:
        """Points (n, N) moved to the target by Newton's shortest steps; where they do not lead there, NaN."""
        target, n = self.problem.target[:, None], z.shape[0]
        for _ in range(NEWTON):
            off = self.end_points(z) - target
            if np.abs(off).max() <= NEAR:
                break
            slopes = np.zeros((z.shape[1], off.shape[0], n))
            for k in range(n):
                step = np.zeros((n, 1))
                step[k] = DIFFERENCE * self.moving[k]
                slopes[:, :, k] = ((self.end_points(z + step) - self.end_points(z - step)) / (2 * DIFFERENCE)).T
            change = -np.einsum("nkr,rn->kn", np.linalg.pinv(slopes, 1e-9), off)
            size = np.maximum(1.0, np.abs(change).max(axis=0) / MOST)
            z = np.clip(z + self.moving * change / size, self.lower, self.upper)
        return np.where(np.abs(self.end_points(z) - target).max(axis=0) <= NEAR, z, np.nan)

    def best(self, samples: int, parents: int, steps: int) -> tuple[float, Vector]:
        """The largest V that is found, and where; −∞ where no sample keeps everything."""
        region, found = self.problem.region, list[Vector]()
        for _ in range(20):
            z = region.low[:, None] + (region.high - region.low)[:, None] * self.rng.uniform(
                size=(len(region.low), samples)
            )
            z = self.onto(z)
            found.append(z[:, np.isfinite(self.values(z))])
            if sum(each.shape[1] for each in found) >= samples:
                break
        z = np.hstack(found)
        if not z.size:
            return -math.inf, np.full(len(region.low), np.nan)
        values = self.values(z)
        order = np.argsort(-values)[:parents]
        z, values, step = z[:, order], values[order], np.full(min(parents, len(order)), FIRST)
        for _ in range(steps):
            child = self.onto(
                np.clip(z + step * self.moving * self.rng.standard_normal(z.shape), self.lower, self.upper)
            )
            new = self.values(child)
            better = new > values
            z, values = np.where(better, child, z), np.where(better, new, values)
            step = np.clip(step * np.where(better, LONGER, SHORTER), LEAST, MOST)
        top = int(np.argmax(values))
        return float(values[top]), z[:, top]


def beside(
    samples: int, case: tuple[str, int], asked: tuple[Any, Any, dict[str, Any]], other: Callable[..., Other]
) -> Row:
    """A case: machine, number, gap, seconds of both, failure; `other`: of the problem, the other method."""
    machine, target, options = asked
    start = time.perf_counter()
    sentence, best = "", -math.inf
    try:
        selection = flexopt.select(machine, target, workers=1, **options)
        best, problem = selection.best.objective, selection.problem
    except FlexoptError as error:
        sentence = str(error)[:250]
        problem = flexopt.build_selection(machine, target, **options)
    middle = time.perf_counter()
    value, z = other(problem).best(samples, PARENTS, STEPS)
    if value > best + BAR * problem.objective_scale:
        sentence = f"{sentence} better: {np.array2string(z, precision=5, separator=', ')}"
    gap = (value - best) / problem.objective_scale if value > -math.inf else math.nan
    if math.isnan(gap):
        sentence = f"{sentence} the other method finds nothing feasible"
    return *case, gap, middle - start, time.perf_counter() - middle, sentence


def examined(samples: int, case: tuple[str, int]) -> Row:
    """As `beside`."""
    return beside(samples, case, chosen(*case), functools.partial(Other, seed=case[1]))


def cases(names: Sequence[str], count: int) -> Iterator[tuple[str, int]]:
    """As many cases, the machines in turn."""
    for number in range(count):
        yield names[number % len(names)], number


def compare(description: str, count: int, examine: Callable[[int, tuple[str, int]], Row]) -> None:
    """Print the gap of every case, and the worst; `examine`: of samples and a case, its row."""
    parser = argparse.ArgumentParser(description=description.split("\n", 1)[0])
    parser.add_argument("--cases", type=int, default=count)
    parser.add_argument("--machines", nargs="*", default=MACHINES)
    parser.add_argument("--samples", type=int, default=SAMPLES)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    rows: list[Row] = []
    with get_context("spawn").Pool(options.workers, maxtasksperchild=4) as pool:
        work = functools.partial(examine, options.samples)
        for row in pool.imap_unordered(work, cases(options.machines, options.cases)):
            rows.append(row)
            name, number, gap, ours, others, sentence = row
            print(f"{number:3d} {name:30s} {gap:+.1e} {ours:6.1f} s {others:6.1f} s  {sentence}", flush=True)
    gaps = np.array([row[2] for row in rows if not math.isnan(row[2])])
    failures = int(np.sum(np.isinf(gaps)))
    lines = [("what", "read", "bar"), ("worst gap", f"{gaps[np.isfinite(gaps)].max():+.1e}", f"{BAR:.0e}")]
    lines += [("above the bar", str(int(np.sum(gaps > BAR)) - failures), "0"), ("not solved", str(failures), "2 %")]
    lines += [("nothing feasible to compare with", str(len(rows) - gaps.size), "")]
    print(table(f"{len(rows)} cases beside {options.samples} samples", lines))


if __name__ == "__main__":
    compare(__doc__ or "", 60, examined)
