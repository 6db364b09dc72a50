"""Time of all w_i at many postures at once, with and without the Jacobian, on one core, beside SciPy and NumPy.

Run: python -m benchmarks.batches

Bars: batch at least 60 times as fast as batched NumPy with AVX-512, 20 times without; value with Jacobian at most 4
times the value. "quick" is what maps call (`evaluate_w`), "full" the Functions that also handle clusters.

The peers get M, K, J and Jv ready made and solve the eigenproblem and the residues; flexopt's time includes computing
those matrices from the posture. No peer gives a Jacobian. Rounds of all of them are interleaved, so that what else the
machine does falls on all alike; each time is the least of its rounds.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import numpy as np
import scipy.linalg

import flexopt
from benchmarks.score import Row, has_avx512, means
from benchmarks.timing import fresh_process, least_of, table
from flexopt.compiled import Batch, batch
from flexopt.robustness.batches import evaluate_w
from flexopt.robustness.measures import Measures

POSTURES = 20_000
FEW = 500  # for the loop in Python
ROUNDS = 10
VALUE, BOTH = "quick, batch", "quick, batch, with Jacobian"


@dataclass(frozen=True)
class Peers:
    """The peers' work on ready-made matrices: K (n, n), M (N, n, n), J (N, r, n); m modes."""

    stiffness: np.ndarray
    mass: np.ndarray
    jacobian: np.ndarray
    inverse: np.ndarray
    m: int

    def scipy_loop(self) -> np.ndarray:
        """(m, FEW): a generalised eigenproblem for each posture."""
        w, m = np.empty((FEW, self.m)), self.m
        for k in range(FEW):
            _, modes = scipy.linalg.eigh(self.stiffness, self.mass[k])
            a, b = self.jacobian[k] @ modes[:, -m:], self.inverse[k].T @ modes[m:, -m:]
            w[k] = np.sum(a * b, axis=0) - np.linalg.norm(a, axis=0) * np.linalg.norm(b, axis=0)
        return w.T

    def numpy_batched(self) -> np.ndarray:
        """(m, N): the reduced eigenproblem of all postures in one call."""
        m = self.m
        root = np.sqrt(np.diag(self.stiffness)[:m])
        flexibility = np.linalg.inv(self.mass)
        values, z = np.linalg.eigh(root[:, None] * flexibility[:, :m, :m] * root)
        modes = flexibility[:, :, :m] @ (root[:, None] * z) / np.sqrt(values)[:, None, :]
        a, b = self.jacobian @ modes, self.inverse.transpose(0, 2, 1) @ modes[:, m:]
        return (np.sum(a * b, axis=1) - np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)).T


def peers(measures: Measures, postures: np.ndarray) -> Peers:
    """Their matrices, computed beforehand by the plant's Functions."""
    plant, n = measures.plant, postures.shape[1]
    p, m = plant.parameter_values, plant.n_passive
    mass, jacobian = np.empty((n, 5, 5)), np.empty((n, 2, 5))
    for k in range(n):
        q = plant.rest(0, postures[:, k], p)
        mass[k], jacobian[k] = plant.mass(q, 0, p).full(), plant.jacobian(q, 0, p).full()
    return Peers(plant.stiffness(p).full(), mass, jacobian, np.linalg.inv(jacobian[:, :, m:]), m)


def random_postures(count: int) -> np.ndarray:
    """Of the excavator, away from its singular ones."""
    rng = np.random.default_rng(0)
    return np.vstack([rng.uniform(-3, 3, count), rng.choice([-1, 1], count) * rng.uniform(0.2, 2.9, count)])


PEER = """
import sys, time
import numpy as np
from benchmarks.batches import Peers
given = np.load(sys.argv[1])
peers = Peers(given["stiffness"], given["mass"], given["jacobian"], given["inverse"], int(given["m"]))
least = float("inf")
for _ in range(int(sys.argv[2])):
    begin = time.perf_counter()
    peers.numpy_batched()
    least = min(least, time.perf_counter() - begin)
print(least)
"""


def numpy_in_its_own_process(others: Peers, calls: int) -> float:
    """Seconds of NumPy's work in a process that has done nothing else: elsewhere its time varies twofold."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "peers.npz"
        np.savez(file, stiffness=others.stiffness, mass=others.mass, jacobian=others.jacobian,
                 inverse=others.inverse, m=others.m)  # fmt: skip
        return float(fresh_process(PEER, str(file), str(calls))[1])


def rows(quick: bool) -> list[Row]:
    """All w_i of many postures beside NumPy, and with their Jacobian beside without."""
    measures, count = flexopt.build_measures(flexopt.load("excavator")), 500 if quick else POSTURES
    postures, p = random_postures(count), np.array(measures.plant.parameter_values).ravel()
    value, both = measures.quick_batch, measures.quick_batch_with_gradient
    theirs, least = float("inf"), dict.fromkeys(("value", "both"), float("inf"))
    others = peers(measures, postures)
    for _ in range(1 if quick else 4):
        theirs = min(theirs, numpy_in_its_own_process(others, 2 if quick else 8))
        found = least_of(
            {"value": lambda: value([0.0], postures, p), "both": lambda: both([0.0], postures, p)}, 2 if quick else 15
        )
        least = {name: min(least[name], found[name]) for name in least}
    bar = 60.0 if has_avx512() else 20.0
    return [
        Row("NumPy / flexopt, all w_i, excavator", theirs / least["value"], bar, at_least=True, ran=means(value)),
        Row(
            "w_i with Jacobian / without, excavator",
            least["both"] / least["value"],
            4.0,
            at_least=False,
            ran=means(both),
        ),
    ]


def main() -> None:
    """Print the table."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    measures = flexopt.build_measures(flexopt.load("excavator"))
    postures = random_postures(POSTURES)
    parameters = np.array(measures.plant.parameter_values).ravel()
    others = peers(measures, postures)

    def work(evaluate: Batch) -> Callable[[], np.ndarray]:
        return lambda: evaluate([0.0], postures, parameters)[0]

    with mock.patch.dict(os.environ, FLEXOPT_COMPILE="0"):
        machine, machine_both = batch(measures.quick), batch(measures.quick_with_gradient)
    works: dict[str, Callable[[], object]] = {
        "SciPy eigh, loop": others.scipy_loop,
        "NumPy eigh, batched": others.numpy_batched,
        "full, batch": work(batch(measures.w)),
        "full, batch, with Jacobian": work(batch(measures.w_with_gradient)),
        "quick, CasADi VM": work(machine),
        "quick, CasADi VM, with Jacobian": work(machine_both),
        VALUE: work(measures.quick_batch),
        BOTH: work(measures.quick_batch_with_gradient),
        "evaluate_w": lambda: evaluate_w(measures, [0.0], postures).w,
        "evaluate_w, with Jacobian": lambda: evaluate_w(measures, [0.0], postures, gradient=True).w,
    }
    reference = others.numpy_batched()
    seconds = least_of(works, ROUNDS)
    per_posture = {name: seconds[name] / (FEW if "loop" in name else POSTURES) for name in works}
    rows: list[tuple[str, ...]] = [("who", "µs a posture", "NumPy / this", "largest difference from NumPy / |w|max")]
    for name, function in works.items():
        result = np.asarray(function())
        difference = np.abs(result - reference[:, : result.shape[1]]).max() / np.abs(reference).max()
        ratio = per_posture["NumPy eigh, batched"] / per_posture[name]
        rows.append((name, f"{1e6 * per_posture[name]:.4f}", f"{ratio:.2f}", f"{difference:.1e}"))
    print(table(f"All w_i of {POSTURES} random postures of the excavator, one core; {measures.quick_batch}", rows))
    speed = per_posture["NumPy eigh, batched"] / per_posture[VALUE]
    quotient = per_posture[BOTH] / per_posture[VALUE]
    bar = 60 if has_avx512() else 20
    print(f"batched NumPy / {VALUE}: {speed:.1f} (bar: at least {bar})")
    print(f"value with Jacobian / value: {quotient:.2f} (bar: at most 4)")
    print(f"instructions {measures.quick.n_instructions()}, {measures.quick_with_gradient.n_instructions()}")


if __name__ == "__main__":
    main()
