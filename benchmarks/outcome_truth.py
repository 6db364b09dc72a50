"""Selections by what the real loop does, beside a search that shares nothing with the solver.

Run: python -m benchmarks.outcome_truth [--measures NAME …] [--seeds K …] [--targets N] [--points N]
     [--dead-times S …] [--workers N]

For each target N configurations are drawn at random, the end-point put on the target in closed form (here, in NumPy);
the best three of them are climbed by SciPy's Nelder and Mead along the configurations that reach it. No derivative
enters, and no solver of ours. The measure itself is the one that `flexopt.outcome` tells: `benchmarks.outcome` judges
its numbers, this its choice. Gains are those of the machine at the first configuration.
"""

from __future__ import annotations

import argparse
import functools
import math
import time
import traceback
import warnings
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any

import numpy as np
from scipy.optimize import minimize

import flexopt
from benchmarks.selection_truth import closed_arm, configurations, machines
from benchmarks.timing import table
from flexopt.errors import FlexoptError
from flexopt.loop.settings import LoopSettings, loop_settings
from flexopt.loop.uncertain import UncertainLoop
from flexopt.loop.uncertainty_box import UncertaintyBox
from flexopt.model import Machine
from flexopt.model.choices import OUTCOMES
from flexopt.model.loop import Loop
from flexopt.selection.broken import beyond_bounds
from flexopt.selection.outcomes.measures import MEASURES

BEST, EVALUATIONS = 3, 300
# By how much of its size a selection may be worse: Nelder and Mead end at it, and so do the climbs.
SHORT = 1e-3
Row = tuple[str, ...]


@dataclass(frozen=True)
class Judged:
    """One selection beside the search.

    Attributes:
        case: machine, target, dead time, measure.
        ours: what the selection tells, in the measure's unit, NaN where it tells an error.
        scan, search: the best of the drawn, and of the climbed configurations.
        gap: by how much the search is better, as a share of its value.
        unverified: what a climb came to that could not be verified.
        seconds: of the selection.
        failure: its error, in one line.
    """

    case: Row
    ours: float
    scan: float
    search: float
    gap: float
    unverified: float | None
    seconds: float
    failure: str


@dataclass(frozen=True)
class Search:
    """A measure over the configurations that reach a target."""

    machine: Machine
    target: np.ndarray
    measure: str
    settings: LoopSettings

    def value(self, z: np.ndarray) -> float:
        """The measure, larger is better; −∞ where it is not told."""
        box = UncertaintyBox(self.machine, (), self.settings.dead_time)
        loop = UncertainLoop(self.settings, z[:1], z[1:], False, box)
        try:
            return MEASURES[self.measure].value(loop, loop.outcome())
        except FlexoptError:
            return -math.inf

    def climbed(self, z: np.ndarray, problem: flexopt.SelectionProblem) -> float:
        """The best that Nelder and Mead find from z: placement and leading joints are free, the last two follow."""
        free = z.size - 2
        elbow = min((-1, 1), key=lambda sign: float(np.linalg.norm(self._reached(z[:free], sign) - z)))

        def cost(x: np.ndarray) -> float:
            at = self._reached(x, elbow)
            if not np.isfinite(at).all() or np.any(np.abs(beyond_bounds(problem, at)) > 1e-9):
                return math.inf
            return -self.value(at)

        if not math.isfinite(cost(z[:free])):
            return -math.inf
        options: Any = {"maxfev": EVALUATIONS, "xatol": 1e-9, "fatol": 1e-12}
        return -float(minimize(cost, z[:free], method="Nelder-Mead", options=options).fun)

    def _reached(self, x: np.ndarray, elbow: int) -> np.ndarray:
        joints = np.zeros((len(self.machine.joints), 1))
        joints[:-2, 0] = x[1:]
        posture = closed_arm(self.machine, self.target, x[:1], joints, np.array([elbow]))
        return np.concatenate([x[:1], posture[:, 0]])


def judged(search: Search, case: Row, drawn: np.ndarray, dead_time: float) -> Judged:
    """One selection."""
    settings, measure = search.settings, MEASURES[search.measure]
    options: dict[str, Any] = {
        "objective": search.measure, "control": "inverse", "workers": 1,
        "loop": {"kp": float(settings.kp[0]), "kv": float(settings.kv[0]), "dead_time": dead_time},
    }  # fmt: skip
    values = np.array([search.value(z) for z in drawn.T])
    problem = flexopt.select(search.machine, search.target, objective="w1", starts=1, workers=1).problem
    inside = [bool(np.all(np.abs(beyond_bounds(problem, z)) <= 1e-9)) for z in drawn.T]
    values[~np.array(inside)] = -math.inf
    order = np.argsort(-values)[:BEST]
    searched = max(search.climbed(drawn[:, k], problem) for k in order)
    best, unverified, failure, start = math.nan, None, "", time.perf_counter()
    try:
        found = flexopt.select(search.machine, search.target, **options)
        best, unverified = measure.sign * found.best.objective, found.unverified
    except FlexoptError as error:
        failure = " ".join(str(error).split())[:300]
    except Exception:
        failure = traceback.format_exc()[-300:]
    seconds, scan = time.perf_counter() - start, float(values[order[0]])
    searched = max(searched, scan)
    gap = (searched - best) / abs(searched) if math.isfinite(searched) and searched else math.nan
    return Judged(case, best, scan, searched, gap, unverified, seconds, failure)


def examined(points: int, targets: int, dead_times: tuple[float, ...], task: tuple[str, int]) -> list[Judged]:
    """A measure on one machine."""
    warnings.simplefilter("ignore")
    measure, seed = task
    found: list[Judged] = []
    for name, machine, places, _ in machines([seed]):
        for number, target in enumerate(places[:targets]):
            drawn = configurations(machine, target, points, 1000 * seed + number)
            present = flexopt.evaluate(machine, drawn[1:, 0], base=drawn[:1, 0])
            for dead_time in dead_times:
                settings = loop_settings(machine, Loop(control="inverse", dead_time=dead_time), present)
                search = Search(machine, np.asarray(target), measure, settings)
                case = (name, str(number), f"{1e3 * dead_time:g} ms", measure)
                found.append(judged(search, case, drawn, dead_time))
    return found


def main() -> None:
    """Print each selection, and the worst."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.outcome_truth")
    parser.add_argument("--measures", nargs="*", choices=OUTCOMES, default=list(OUTCOMES))
    parser.add_argument("--seeds", type=int, nargs="*", default=[0, 1, 2, 3], help="of random machines; 0: excavator")
    parser.add_argument("--targets", type=int, default=2)
    parser.add_argument("--points", type=int, default=400)
    parser.add_argument("--dead-times", type=float, nargs="*", default=[0.0, 0.013], help="s")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    tasks = [(measure, seed) for seed in options.seeds for measure in options.measures]
    work = functools.partial(examined, options.points, options.targets, tuple(options.dead_times))
    every: list[Judged] = []
    with get_context("spawn").Pool(options.workers, maxtasksperchild=1) as pool:
        for done in pool.imap_unordered(work, tasks):
            every += done
            for each in done:
                print("  ".join(_told(each)), flush=True)
    short = [each for each in every if each.gap > SHORT]
    silent = [each for each in short if each.unverified is None]
    failed = [each for each in every if each.failure]
    heading = (
        f"{len(every)} selections: {len(short)} worse than the search by more than {SHORT:g}, {len(silent)} of them "
        f"without a word; {len(failed)} errors"
    )
    names = ("machine", "target", "dead time", "measure", "selection", "scan", "search", "gap", "time", "said")
    print(table(heading, [names, *map(_told, sorted(short, key=lambda each: -each.gap) + failed)]))


def _told(each: Judged) -> Row:
    said = each.failure or ("" if each.unverified is None else f"unverified {each.unverified:.6g}")
    numbers = (f"{x:.6g}" for x in (each.ours, each.scan, each.search))
    return (*each.case, *numbers, f"{each.gap:+.1e}", f"{each.seconds:.1f} s", said)


if __name__ == "__main__":
    main()
