"""Time of one closed-loop step of the excavator, and of one step of each member of an ensemble, beside the peers.

Run: python -m benchmarks.simulation

What a step is, and where the peers come from, says `peers`. Every row runs the same 2,000 steps (10 s) from the same
states; each time is the least of its rounds, and rounds are interleaved, so that what else the machine does falls on
all alike. Differences are from the hand-written C, the largest of any coordinate or rate after 200 and after 2,000
steps; MuJoCo shares no equation with it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from benchmarks.score import Row, has_avx512, means
from benchmarks.simulation.ours import Ours, first_use, large_ensemble, python_call
from benchmarks.simulation.peers import (
    WITHOUT_AVX512,
    HandWritten,
    HandWrittenLanes,
    Missing,
    MujocoLoop,
    NumbaLoop,
    Run,
    flags,
    start,
    worst_difference,
)
from benchmarks.timing import table

STEPS, SHORT = 2000, 200
MEMBERS = 1024  # a whole number of vectors for every row
ROUNDS = 20
SECONDS = 0.02  # of each row in each round, or one run


class Simulator(Protocol):
    """What a row needs: states (5,) or (5, members) in, the state after the steps and the seconds out."""

    def run(self, q: np.ndarray, v: np.ndarray, goal: np.ndarray, steps: int) -> Run:
        """`steps` steps from (q, v)."""
        ...


States = tuple[np.ndarray, np.ndarray, np.ndarray]  # q, v and goal
Rows = dict[str, Callable[[], Simulator]]  # name -> constructor, which may raise Missing

LIMIT = "hand-written C"
SINGLE_PEERS: Rows = {LIMIT: HandWritten}
MANY_LIMIT = "hand-written C, a member in each lane"
MANY_PEERS: Rows = {MANY_LIMIT: HandWrittenLanes}
if has_avx512():
    SINGLE_PEERS[f"{LIMIT}, no AVX-512"] = lambda: HandWritten(WITHOUT_AVX512)
    MANY_PEERS[f"{MANY_LIMIT}, no AVX-512"] = lambda: HandWrittenLanes(WITHOUT_AVX512)
SINGLE_PEERS |= {"Numba, one compiled loop": NumbaLoop, "MuJoCo, all C": MujocoLoop}
MANY_PEERS[f"{MANY_LIMIT}, two threads"] = lambda: HandWrittenLanes(threads=2)

# flexopt's rows: a constructor each, as for the peers.
SINGLE_OURS: Rows = {"flexopt": Ours, "flexopt, baked": lambda: Ours(baked=True)}
MANY_OURS: Rows = {
    "flexopt, as simulate_ensemble runs it": lambda: Ours(watched=True),
    "flexopt, the steps alone": Ours,
    "flexopt, as simulate_ensemble runs it, two threads": lambda: Ours(watched=True, threads=2),
}


def built(rows: Rows) -> tuple[dict[str, Simulator], dict[str, str]]:
    """The simulators that could be built, and why the others could not."""
    there: dict[str, Simulator] = {}
    reasons: dict[str, str] = {}
    for name, constructor in rows.items():
        try:
            there[name] = constructor()
        except Missing as reason:
            reasons[name] = str(reason)
    return there, reasons


def least_seconds(simulators: dict[str, Simulator], states: States) -> dict[str, float]:
    """The least time of a run of each."""
    least = dict.fromkeys(simulators, np.inf)
    for _ in range(ROUNDS):
        for name, simulator in simulators.items():
            spent = 0.0
            while spent < SECONDS:
                seconds = simulator.run(*states, STEPS).seconds
                least[name], spent = min(least[name], seconds), spent + seconds
    return least


def compare(title: str, rows: Rows, states: States, references: dict[int, Run], limit: str) -> None:
    """Print a table; `references` are the states after some numbers of steps, by which all are judged."""
    simulators, reasons = built(rows)
    members = 1 if states[0].ndim == 1 else states[0].shape[1]
    least = least_seconds(simulators, states)
    lines: list[tuple[str, ...]] = [("who", "ns", "this / limit", "worst difference")]
    worst = 0.0
    for name in rows:
        if name in reasons:
            lines.append((name, "–", "–", reasons[name]))
            continue
        difference = max(worst_difference(simulators[name].run(*states, n), run) for n, run in references.items())
        worst = max(worst, difference)
        ratio = f"{least[name] / least[limit]:.2f}" if limit in least else "–"
        lines.append((name, f"{1e9 * least[name] / STEPS / members:.2f}", ratio, f"{difference:.1e}"))
    print(table(title, lines))
    print(f"worst difference of all: {worst:.1e} (bar: at most 1e-10)\n")


def one_by_one(states: States, steps: int, simulator: Simulator) -> Run:
    """Each member of an ensemble by a simulator of one."""
    q, v, goal = states
    runs = [simulator.run(q[:, k], v[:, k], goal[:, k], steps) for k in range(q.shape[1])]
    columns = [np.stack([getattr(run, name) for run in runs], axis=1) for name in ("q", "v")]
    return Run(columns[0], columns[1], sum(run.seconds for run in runs))


def reference() -> Simulator | None:
    """The hand-written C, or Numba where there is no compiler."""
    return next(iter(built({LIMIT: HandWritten, "Numba": NumbaLoop})[0].values()), None)


def rows(quick: bool) -> list[Row]:
    """A step of one simulation, and of each of many, beside the hand-written limits."""
    one, many = Ours(), Ours(watched=True)
    steps, members = (200, 64) if quick else (STEPS, MEMBERS)
    found = []
    for what, limit, ours, states, n, bar in (
        ("one simulation", HandWritten(), one, start(), 1, 1.55),
        ("ensemble", HandWrittenLanes(), many, start(members), members, None),
    ):
        least = [np.inf, np.inf]
        for _ in range(2 if quick else 400 if n == 1 else 15):
            for k, simulator in enumerate((limit, ours)):
                least[k] = min(least[k], simulator.run(*states, steps).seconds)
        name = f"closed-loop step / hand-written C, {what}, excavator"
        found.append(Row(name, least[1] / least[0], bar, at_least=False, ran=means(ours.runner, members=n)))
    return found


def main() -> None:
    """Print the tables."""
    judge = reference()
    if judge is None:
        print("neither a compiler nor Numba: no peer to compare with")
        return
    print(f"hand-written C: -march=native {flags()}\n")
    single, many = start(), start(MEMBERS)
    counts = (SHORT, STEPS)
    title = f"One simulation of the excavator in closed loop, ns a step of {STEPS}"
    compare(title, SINGLE_PEERS | SINGLE_OURS, single, {n: judge.run(*single, n) for n in counts}, LIMIT)
    title = f"{MEMBERS} simulations at once, ns a step and member"
    references = {n: one_by_one(many, n, judge) for n in counts}
    compare(title, MANY_PEERS | MANY_OURS, many, references, MANY_LIMIT)
    plain, whole = python_call()
    empty, cached = first_use()
    seconds, memory = large_ensemble()
    rows = [
        ("what", "measured", "bar"),
        ("flexopt.simulate of 10 s at 200 Hz, from Python", f"{1e3 * plain:.2f} ms", ""),
        ("the same, its dataset included", f"{1e3 * whole:.2f} ms", "2 ms"),
        ("first simulate of a process, nothing compiled yet", f"{empty:.2f} s", "3 s"),
        ("first simulate of a process, code in the cache", f"{1e3 * cached:.0f} ms", "50 ms"),
        ("simulate_ensemble, 100,000 members, 2,000 steps", f"{seconds:.1f} s", ""),
        ("peak memory of that process", f"{memory / 2**20:.0f} MiB", "1024 MiB"),
    ]
    print(table("Whole calls", rows))


if __name__ == "__main__":
    main()
