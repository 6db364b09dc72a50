"""Stands and plans beside another method, as `benchmarks.choice` is for single configurations.

Run: python -m benchmarks.together [--cases N] [--machines NAME …] [--samples N] [--workers N]

Random targets near each other, weights and constraints, for one placement and for a way of the base in turn. The other
method samples placements, for each target postures by Newton's steps in NumPy, and improves the best sets by an
evolution strategy that takes a child where it keeps everything, rates among it, and what is sought is larger. It shares
with `flexopt` neither starts, slopes, solvers nor steps onto targets.
"""

from __future__ import annotations

import functools
import math
import time
from typing import Any

import numpy as np

import flexopt
from benchmarks.choice import FIRST, LEAST, LONGER, MOST, SHORTER, Other, Row, chosen, compare
from flexopt.errors import FlexoptError, UnreachableTarget
from flexopt.foundation.arrays import Vector
from flexopt.selection.nlp.program import Program
from flexopt.selection.several.plan import _along as along
from flexopt.selection.several.standing import one_placement

# Targets, how far the next one is, m; of a plan the time for all and the rates of the base.
TARGETS, APART, SECONDS, RATE = 3, 1.0, 20.0, 0.1
# Postures tried from each placement.
POSTURES = 16
PARENTS, STEPS = 48, 250


class Together:
    """The other method on configurations that share variables."""

    def __init__(self, program: Program, seed: int) -> None:
        """Of a program whose objectives are sought together."""
        self.program, self.rng = program, np.random.default_rng(seed)
        self.each = [Other(problem, seed) for problem in program.problems]
        self.n_base = self.each[0].n_base
        self.places = [list(place) for place in program.coupling.places]
        taken = np.concatenate(self.places)
        self.shared = len(set(taken.tolist())) < taken.size
        for other in self.each:
            # A placement for all stays where it is; postures move onto the targets.
            other.moving[: self.n_base] *= not self.shared
        self.lower, self.upper = (end[:, None] for end in program.bounds())
        fixed = list(program.fixed)
        self.moving = (program.scale * (self.lower < self.upper)[:, 0])[:, None]
        self.moving[fixed] = 0.0

    def values(self, x: Vector) -> Vector:
        """What is sought of points (n_x, N); −∞ where anything is broken."""
        each = np.array([other.values(x[place]) for other, place in zip(self.each, self.places, strict=True)])
        steps = self.program.coupling.steps(len(x)) @ (x / self.program.scale[:, None])
        near = np.all(np.abs(steps) <= self.program.steps[:, None] + 1e-9, axis=0)
        total = self.program.share @ each if self.program.goal == "weighted" else each.min(axis=0)
        return np.where(near & np.isfinite(total), total, -np.inf)

    def onto(self, x: Vector) -> Vector:
        """Points (n_x, N), every configuration moved to its target; where Newton's steps do not lead there, NaN."""
        x, lost = x.copy(), np.zeros(x.shape[1], dtype=bool)
        for other, place in zip(self.each, self.places, strict=True):
            z = other.onto(x[place])
            off = ~np.isfinite(z).all(axis=0)
            lost |= off
            x[place] = np.where(off, x[place], z)
        return np.where(lost, np.nan, x)

    def sampled(self, samples: int) -> Vector:
        """Points (n_x, N) from one placement each, of every target the best of some postures."""
        low = np.max([problem.region.low for problem in self.program.problems], axis=0)[:, None]
        high = np.min([problem.region.high for problem in self.program.problems], axis=0)[:, None]
        spread = low + (high - low) * self.rng.uniform(size=(len(low), samples))
        base, x = np.repeat(spread[: self.n_base], POSTURES, axis=1), np.zeros((self.program.coupling.n_x, samples))
        for other, place in zip(self.each, self.places, strict=True):
            postures = low[self.n_base :] + (high - low)[self.n_base :] * self.rng.uniform(
                size=(len(low) - self.n_base, base.shape[1])
            )
            moving, other.moving = other.moving, other.moving.copy()
            other.moving[: self.n_base] = 0.0
            z = other.onto(np.vstack([base, postures]))
            other.moving = moving
            best = other.values(z).reshape(samples, POSTURES).argmax(axis=1)
            x[place] = z[:, np.arange(samples) * POSTURES + best]
        return x

    def beside(self, x: Vector, size: Vector | float) -> Vector:
        """Points (n_x, N) moved at random by so much, in scaled variables, and back onto the targets."""
        ahead = x + size * self.moving * self.rng.standard_normal(x.shape)
        return self.onto(np.clip(ahead, self.lower, self.upper))

    def best(self, samples: int, parents: int, steps: int) -> tuple[float, Vector]:
        """The largest value that steps at random lead to, and where; −∞ where no sample keeps everything."""
        x = self.sampled(samples)
        values = self.values(x)
        good = np.isfinite(values)
        if not good.any():
            return -math.inf, np.full(len(x), np.nan)
        order = np.argsort(-values[good])[:parents]
        x, values, step = x[:, good][:, order], values[good][order], np.full(len(order), FIRST)
        for _ in range(steps):
            child = self.beside(x, step)
            new = self.values(child)
            better = new > values
            x, values = np.where(better, child, x), np.where(better, new, values)
            step = np.clip(step * np.where(better, LONGER, SHORTER), LEAST, MOST)
        top = int(np.argmax(values))
        return float(values[top]), x[:, top]


def asked(name: str, number: int, count: int = TARGETS) -> tuple[Any, Vector, dict[str, Any]]:
    """A machine, targets on a random line, and options of `select_stand` and `plan_base`."""
    machine, target, options = chosen(name, number)
    way = np.random.default_rng([number, count]).standard_normal(target.size)
    targets = target + np.outer(np.arange(count) - (count - 1) / 2, APART * way / np.linalg.norm(way))
    return machine, targets, options


def program_of(problems: tuple[flexopt.SelectionProblem, ...], *, moving: bool) -> Program:
    """What `select_stand`, or `plan_base`, maximises."""
    count, machine = len(problems), problems[0].machine
    if not moving:
        return one_placement(problems, np.full(count, 1 / count), weighted=False)
    rates = np.array([*(RATE for _ in machine.base_coordinates), *machine.speeds])
    return along(problems, np.linspace(0.0, SECONDS, count), rates, None)


def examined(samples: int, case: tuple[str, int]) -> Row:
    """A case: machine, number, gap, seconds of both, failure."""
    machine, targets, options = asked(*case)
    moving = bool(case[1] // 4 % 2)
    what, start, best = "plan" if moving else "stand", time.perf_counter(), -math.inf
    plan = functools.partial(flexopt.plan_base, duration=SECONDS, max_base_rate=RATE)
    try:
        found = (plan if moving else flexopt.select_stand)(machine, targets, workers=1, **options)
        best, problems, sentence = found.worth, found.problems, ", ".join(found.kinks)
    except UnreachableTarget as error:
        return *case, math.nan, time.perf_counter() - start, 0.0, f"{what} {error}"[:250]
    except FlexoptError as error:
        problems = tuple(flexopt.build_selection(machine, target, **options) for target in targets)
        sentence = str(error)[:250]
    middle = time.perf_counter()
    program = program_of(problems, moving=moving)
    value, _ = Together(program, case[1]).best(samples, PARENTS, STEPS)
    gap = (value - best) / program.size if value > -math.inf else math.nan
    return *case, gap, middle - start, time.perf_counter() - middle, f"{what} {sentence}"


def main() -> None:
    """The comparison."""
    compare(__doc__ or "", 16, examined)


if __name__ == "__main__":
    main()
