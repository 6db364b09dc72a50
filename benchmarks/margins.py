"""Time of one ε_max, beside SLICOT and SciPy on the same scaled plants.

Run: python -m benchmarks.margins

SLICOT and SciPy get the scaled A, B, C ready made and solve the two Riccati equations and the eigenproblem of X Z;
flexopt's time includes computing the plant from the posture. SLICOT's and SciPy's times are for one call at a time
(they have no batches); flexopt's batch evaluates several postures at once on one core.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import scipy.linalg
import slycot

import flexopt
from benchmarks.timing import median_seconds, table
from flexopt.compiled import batch, find_compiler
from flexopt.robustness.margin import build_margin

POSTURES = 2048
SAMPLE = 200
GAIN = 5e5


def _epsilon(x: np.ndarray, z: np.ndarray) -> float:
    return float((1 + np.linalg.eigvals(x @ z).real.max()) ** -0.5)


def _slicot(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    n = len(a)
    x = slycot.sb02md(n, a, b @ b.T, c.T @ c, "C", "D", "U", "N", "S")[0]
    z = slycot.sb02md(n, a.T, c.T @ c, b @ b.T, "C", "D", "U", "N", "S")[0]
    return _epsilon(x, z)


def _scipy(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    unit = np.eye(b.shape[1])
    x = scipy.linalg.solve_continuous_are(a, b, c.T @ c, unit)
    return _epsilon(x, scipy.linalg.solve_continuous_are(a.T, c.T, b @ b.T, unit))


def main() -> None:
    """Print the table."""
    machine = flexopt.load("excavator")
    margin = build_margin(machine, "inverse")
    p = margin.plant.parameter_values.full()
    rng = np.random.default_rng(0)
    sides = rng.choice([-1, 1], POSTURES)
    postures = np.vstack([rng.uniform(-3, 3, POSTURES), sides * rng.uniform(0.2, 2.9, POSTURES)])
    plants = []
    for posture in postures[:, :SAMPLE].T:
        held = margin.hold.call([0, posture, p, GAIN])
        plants.append([x.full() for x in margin.scaled_plant.call([0, posture, p, GAIN, *held])])
    fast = build_margin(machine, "inverse", doublings=17, compact=True)
    compiled = batch(fast.values)

    def ours() -> np.ndarray:
        epsilon, rest, _ = compiled(np.zeros((1, POSTURES)), postures, p, np.array([GAIN]))
        assert rest.max() < 1e-3, "the doublings were too few"
        return epsilon[0]

    def in_the_vm() -> list[float]:
        return [float(margin.values.call([0, posture, p, GAIN])[0][0]) for posture in postures[:, :SAMPLE].T]

    values = ours()[:SAMPLE]
    timed = {
        "SLICOT sb02md, twice": (lambda: [_slicot(*plant) for plant in plants], SAMPLE),
        "SciPy solve_continuous_are, twice": (lambda: [_scipy(*plant) for plant in plants], SAMPLE),
        "flexopt, CasADi VM": (in_the_vm, SAMPLE),
        f"flexopt, batch ({'compiled' if find_compiler() else 'no compiler: VM'})": (ours, POSTURES),
    }
    seconds = {name: median_seconds(work, repeats=5, seconds=1.0) / count for name, (work, count) in timed.items()}
    slicot = seconds["SLICOT sb02md, twice"]
    rows: list[tuple[str, ...]] = [("who", "µs each", "SLICOT : this", "largest difference from flexopt's batch")]
    for name, (work, _) in timed.items():
        difference = float(np.abs(np.asarray(work())[:SAMPLE] - values).max())
        rows.append((name, f"{1e6 * seconds[name]:.2f}", f"{slicot / seconds[name]:.1f}", f"{difference:.1e}"))
    print(table(f"One ε_max, {margin.n_states} states, random postures of the excavator, one core", rows))


if __name__ == "__main__":
    main()
