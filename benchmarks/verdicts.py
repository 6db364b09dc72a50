"""Verdicts against eigenvalues, and the gains that the exact loop allows. `python -m benchmarks.verdicts [machines]`.

Random machines in the plane and in space, redundant arms included, random gains, dead times and lengths of the run:
the verdict of `simulate` beside the growth rate of the linear loop as SciPy's discretisation and python-control's
feedback make it. For every tenth the truth is looked up in a nonlinear run of order 8 that is long and small enough.
"""

from __future__ import annotations

import math
import os
import sys
import time
import warnings
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

import flexopt
from flexopt.model import AnyMachine, machine_from_dict, tree_from_dict
from flexopt.plant import build_plant
from tests.oracles.machines import NumpySource, Structure, draw_machine, regular_posture
from tests.oracles.sampled_loop import growth_rate
from tests.oracles.spatial import grounded

MACHINES, TRUTH, SEED = 500, 10, 12
# Slower growth than this is none to tell from the eigenvalues' rounding, 1/s.
NEUTRAL = 1e-7
STRUCTURES = (
    Structure(2, ("x", "y", "rotation"), ()),
    Structure(2, ("rotation",), ()),
    Structure(3, ("x", "rotation"), (1,)),
    Structure(3, ("x", "y", "rotation"), ()),
    Structure(4, ("y", "rotation"), ()),
)
RATES, DELAYS = (100.0, 200.0), (0, 1, 4)
POSTURES = {
    "A": (0.9929, -2.6306), "B": (0.0448, -2.0499), "(.992, −1.4056)": (0.992, -1.4056),
}  # fmt: skip
DEAD_TIMES, HELD = (0.0, 0.005, 0.02, 0.05, 0.1), (2e3, 1e3)


@dataclass(frozen=True)
class Case:
    """A machine and a loop around it."""

    machine: AnyMachine
    posture: np.ndarray
    options: dict[str, Any]

    @property
    def redundant(self) -> bool:
        """Whether its arm has a self-motion."""
        return len(self.machine.joints) > len(self.machine.task_rows)

    def expected(self) -> float:
        """Growth rate by the oracle, 1/s."""
        o = self.options
        return growth_rate(
            self.machine, self.posture, control=o["control"], kp=o["kp"], kv=o["kv"], period=1 / o["rate"],
            dead_time=o["sensor"]["delay"],
        )  # fmt: skip


def draw(number: int) -> Case:
    """The case of that number: gains from far below to far above what stability allows."""
    rng = np.random.default_rng([SEED, number])
    if number % 6 == 5:
        machine: AnyMachine = tree_from_dict(grounded(int(rng.integers(3, 5)), int(rng.integers(1000))))
        posture = np.array([0.3, 0.9, -1.4, 0.5][: len(machine.joints)]) + rng.uniform(-0.3, 0.3, len(machine.joints))
    else:
        structure = STRUCTURES[number % 6 % len(STRUCTURES)]
        data = draw_machine(
            NumpySource(rng), structure, spread=30.0, joint_damping=False, damping_ratio=10 ** rng.uniform(-2.5, -0.5)
        )
        machine = machine_from_dict(data)
        posture = regular_posture(rng, machine, condition=8.0)
    control = str(rng.choice(["inverse", "transpose"]))
    plant = build_plant(machine)
    base, p = np.zeros(plant.n_base), plant.parameter_values
    q = plant.rest(base, posture, p).full().ravel()
    n = plant.n_actuated
    inertia = float(np.linalg.eigvalsh(plant.mass(q, base, p).full()[-n:, -n:])[-1])
    if control == "transpose":
        inertia /= float(np.linalg.norm(plant.rigid_jacobian(q, base, p).full(), 2)) ** 2
    rate = float(rng.choice(RATES))
    corner = 2 * math.pi * 10 ** rng.uniform(-1.5, 1.0)
    kp, kv = inertia * corner**2, 2 * inertia * corner * rng.uniform(0.05, 1.5)
    options = {
        "control": control, "rate": rate, "kp": kp, "kv": kv,
        "sensor": {"delay": float(rng.choice(DELAYS)) / rate}, "duration": float(round(10 ** rng.uniform(0, 1.5), 2)),
        "offset": 0.01 * rng.choice([-1.0, 1.0], n),
    }  # fmt: skip
    return Case(machine, posture, options)


def judged(case: Case, **more: Any) -> flexopt.Trajectory | None:
    """The run with as many RK4 steps in a sample as it asks for; None where that is more than a sample can hold."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for substeps in (1, 4, 16, 64):
            try:
                return flexopt.simulate(case.machine, case.posture, **{"substeps": substeps} | case.options | more)
            except flexopt.InputError as error:
                if "substeps of at least" not in str(error):
                    raise
    return None


def truth(case: Case, rate: float) -> str | None:
    """What a small, long, accurate nonlinear run shows; None where that would take too long."""
    needed = 8.0 / abs(rate)
    if needed > 400.0:
        return None
    n = len(case.machine.joints)
    small: dict[str, Any] = {"offset": 1e-6 * np.resize([1.0, -1.0], n), "duration": max(needed, 2.0)}
    small |= {"integrator": "dop853", "substeps": None}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        run = flexopt.simulate(case.machine, case.posture, **case.options | small)
    return run.run.word


@dataclass
class Counts:
    """What came out."""

    verdicts: Counter[tuple[str, str]]
    contradictions: list[int]
    off: list[float]
    true: Counter[str]
    redundant: int = 0


def count(machines: int) -> Counts:
    """Judge that many machines."""
    found = Counts(Counter(), [], [], Counter())
    for number in range(machines):
        case = draw(number)
        rate = case.expected()
        run = judged(case)
        if run is None or abs(rate) < NEUTRAL:
            found.verdicts["left out", "–"] += 1
            continue
        word = "grows" if rate > 0 else "converges"
        found.redundant += case.redundant
        found.verdicts[word, run.verdict] += 1
        assert run.linear is not None, run.verdict_reason
        found.off.append(abs(run.linear.growth_rate - rate) / max(1.0, abs(rate)))
        if run.verdict not in (word, "undecided"):
            found.contradictions.append(number)
        if number % TRUTH == 0:
            shown = truth(case, rate)
            found.true["too slow to look" if shown is None else "as the eigenvalues" if shown == word else "other"] += 1
    return found


def intervals() -> list[list[str]]:
    """Stable Kp of the article's machine for dead times and postures, a row for each dead time."""
    machine = flexopt.load("excavator")
    rows: list[list[str]] = []
    for dead_time in DEAD_TIMES:
        row = [f"{1e3 * dead_time:g} ms"]
        for posture in POSTURES.values():
            for kv in HELD:
                border = flexopt.stability_border(machine, posture, kp=1e5, kv=kv, sensor={"delay": dead_time})
                row.append(", ".join(f"{low:.3g}–{high:.3g}" for low, high in border.intervals) or "none")
        rows.append(row)
    return rows


def main() -> None:
    # Every machine wants code of its own, which takes longer to compile than to interpret once.
    os.environ.setdefault("FLEXOPT_COMPILE", "0")
    machines = int(sys.argv[1]) if len(sys.argv) > 1 else MACHINES
    start = time.perf_counter()
    found = count(machines)
    print(f"{machines} random machines, {found.redundant} with a self-motion, {time.perf_counter() - start:.0f} s")
    for (word, verdict), times in sorted(found.verdicts.items()):
        print(f"  eigenvalues (SciPy, python-control): {word:10} verdict: {verdict:10} {times}")
    print(f"contradictions: {len(found.contradictions)} {found.contradictions}")
    print(f"growth rates off by {max(found.off):.1e} at most (relative, or 1/s below 1)")
    print("long accurate runs: " + ", ".join(f"{what} {times}" for what, times in sorted(found.true.items())))
    print("\nStable Kp (searched 10 … 1e9), excavator, inverse control, 200 Hz")
    print("dead time | " + " | ".join(f"{name}, Kv {kv:g}" for name in POSTURES for kv in HELD))
    for row in intervals():
        print(" | ".join(row))


if __name__ == "__main__":
    main()
