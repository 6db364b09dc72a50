"""flexopt's rows of the simulator's benchmark.

In: the same states, goals and steps as the peers (`peers`). Out: the same `Run`s, from the code that `flexopt.simulate`
and `flexopt.simulate_ensemble` run. Ours does more in a step than the peers: it sums up its rotations and steps aside
to computed sines and cosines where they exceed what the carried ones allow; the machine's numbers, gains and target are
run-time constants (`baked`: folded, as the peers'); and an ensemble's step gives what members are judged by: squared
error, squared base rotation and the energy of three modes.
"""

from __future__ import annotations

import tempfile
import time
from typing import Any

import numpy as np

import flexopt
from benchmarks.simulation.peers import POSTURE, Missing, Run
from benchmarks.timing import fresh_process, median_seconds
from flexopt.compiled import Recurrence
from flexopt.simulation.run import runners
from flexopt.simulation.scenario import Scenario, build_scenario, checked_options

POSTURE_B = list(POSTURE)


class Ours:
    """`flexopt`'s compiled loop, one member or many.

    Args:
        baked: constants folded into the code.
        watched: as ensembles run it.
        threads: members divided among them.
    """

    def __init__(self, *, baked: bool = False, watched: bool = False, threads: int = 1) -> None:
        machine = flexopt.load("excavator")
        options = checked_options("benchmark", machine, {"posture": POSTURE_B})
        self.scenario: Scenario = build_scenario(machine, options, watched=watched)
        self.threads, self.baked = threads, baked
        constants = self.scenario.constants if baked else None
        self.runner: Recurrence = runners(self.scenario.loop.structure, constants)[0]
        if not self.runner.compiled:
            raise Missing("no compiler")

    def run(self, q: np.ndarray, v: np.ndarray, goal: np.ndarray, steps: int) -> Run:
        """`steps` steps; the time is that of the loop: a call without steps is taken off."""
        loop = self.scenario.loop
        to_u = np.linalg.inv(loop.to_q)
        x = np.concatenate([to_u @ q, to_u @ v])
        c = np.zeros(0) if self.baked else loop.constants.packed(self.scenario.parts | {"target": goal})
        settings: dict[str, Any] = {"threads": self.threads, "keep": "monitors"}
        least = min(self._seconds(x, c, 0, settings) for _ in range(3))
        begin = time.perf_counter()
        last = self.runner(x, c, steps=steps, stride=max(1, steps), **settings).last
        seconds = time.perf_counter() - begin - least
        last = last[:, 0] if q.ndim == 1 else last
        return Run(loop.to_q @ last[:5], loop.to_q @ last[5:10], seconds)

    def _seconds(self, x: np.ndarray, c: np.ndarray, steps: int, settings: dict[str, Any]) -> float:
        begin = time.perf_counter()
        self.runner(x, c, steps=steps, **settings)
        return time.perf_counter() - begin


def python_call() -> tuple[float, float]:
    """Seconds of `flexopt.simulate` of the article's 10 s, and with its dataset: medians of many, after warm-up."""
    machine = flexopt.load("excavator")

    def once() -> None:
        flexopt.simulate(machine, POSTURE_B)

    def with_dataset() -> None:
        _ = flexopt.simulate(machine, POSTURE_B).dataset

    return median_seconds(once, repeats=60, seconds=0), median_seconds(with_dataset, repeats=60, seconds=0)


FIRST_CALL = """
import time
import flexopt
machine = flexopt.load("excavator")
from flexopt import simulate
from flexopt.compiled import find_compiler
find_compiler()
begin = time.perf_counter()
simulate(machine, {posture})
print(time.perf_counter() - begin)
"""
ENSEMBLE = """
import resource, time
import numpy as np, flexopt
machine = flexopt.load("excavator")
offsets = np.random.default_rng(0).uniform(-0.05, 0.05, ({members}, 2))
begin = time.perf_counter()
flexopt.simulate_ensemble(machine, {posture}, vary={{"offset": offsets}})
print(time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024)
"""


def first_use() -> tuple[float, float]:
    """Seconds of a process' first `simulate`, imports done: with nothing compiled yet, and with code in the cache."""
    with tempfile.TemporaryDirectory() as folder:
        empty = float(_process(FIRST_CALL.format(posture=POSTURE_B), folder))
        return empty, min(float(_process(FIRST_CALL.format(posture=POSTURE_B), folder)) for _ in range(5))


def large_ensemble(members: int = 100_000) -> tuple[float, float]:
    """Seconds and peak memory (bytes, the whole process) of an ensemble of 2,000 steps that keeps measures only."""
    with tempfile.TemporaryDirectory() as folder:
        words = _process(ENSEMBLE.format(members=members, posture=POSTURE_B), folder).split()
    return float(words[0]), float(words[1])


def _process(program: str, cache: str) -> str:
    return fresh_process(program, environment={"FLEXOPT_CACHE": cache})[1]
