"""Time of one ε_max, beside SLICOT and SciPy on the same scaled plants.

Run: python -m benchmarks.margins

SLICOT and SciPy get the scaled A, B, C ready made and solve the two Riccati equations and the eigenproblem of X Z;
flexopt's time includes computing the plant from the posture. SLICOT's and SciPy's times are for one call at a time
(they have no batches); flexopt's batch evaluates several postures at once on one core.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import scipy.linalg
import slycot

import flexopt
from benchmarks.score import Row, means
from benchmarks.timing import least_of, median_seconds, table
from flexopt.compiled import Batch
from flexopt.robustness.margin import Margin, build_margin

POSTURES = 2048
SAMPLE = 200
FEW = 256  # short calls, of which the least is undisturbed
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


@dataclass(frozen=True)
class Case:
    """One machine's margins at random postures, and the plants of some of them."""

    margin: Margin
    runner: Batch
    postures: np.ndarray

    @property
    def p(self) -> np.ndarray:
        """The machine's parameters."""
        return self.margin.plant.parameter_values.full()

    @property
    def bases(self) -> np.ndarray:
        """Where it stands."""
        return np.zeros((self.margin.plant.n_base, 1))

    def ours(self) -> np.ndarray:
        """ε_max of all postures."""
        return self.runner(self.bases, self.postures, self.p, np.array([GAIN]))[0][0]

    def in_the_vm(self) -> list[float]:
        """ε_max of the sample, call by call."""
        calls = (self.margin.values.call([self.bases, q, self.p, GAIN]) for q in self.postures[:, :SAMPLE].T)
        return [float(call[0][0]) for call in calls]

    def plants(self) -> list[list[np.ndarray]]:
        """Scaled A, B, C of the sample."""
        found = []
        for q in self.postures[:, :SAMPLE].T:
            held = self.margin.hold.call([self.bases, q, self.p, GAIN])
            found.append([x.full() for x in self.margin.scaled_plant.call([self.bases, q, self.p, GAIN, *held])])
        return found


def case(name: str, postures: int = POSTURES) -> Case:
    """The code that maps and scans run."""
    margin = build_margin(flexopt.load(name), "inverse")
    rng = np.random.default_rng(0)
    if name == "excavator":
        sides = rng.choice([-1, 1], postures)
        at = np.vstack([rng.uniform(-3, 3, postures), sides * rng.uniform(0.2, 2.9, postures)])
    else:
        at = rng.uniform(-1.5, 1.5, (margin.plant.n_actuated, postures))
    return Case(margin, margin.batched, at)


def rows(quick: bool) -> list[Row]:
    """ε_max beside SLICOT: of three passive coordinates, and of six."""
    found = []
    for name, bar in (("excavator", 18.0), ("truck-crane", 5.0), ("slewing-excavator", 5.0)):
        of = case(name, 64 if quick else FEW)
        plants = of.plants()[: 8 if quick else 40]
        least = least_of(
            {"ours": of.ours, "theirs": lambda plants=plants: [_slicot(*plant) for plant in plants]}, 2 if quick else 60
        )
        ratio = least["theirs"] / len(plants) / (least["ours"] / of.postures.shape[1])
        what = f"SLICOT / flexopt, ε_max, {name}, {of.margin.plant.n_passive} passive coordinates"
        found.append(Row(what, ratio, bar, at_least=True, ran=means(of.runner)))
    return found


def main() -> None:
    """Print the table."""
    of = case("excavator")
    plants, values = of.plants(), of.ours()[:SAMPLE]
    timed = {
        "SLICOT sb02md, twice": (lambda: [_slicot(*plant) for plant in plants], SAMPLE),
        "SciPy solve_continuous_are, twice": (lambda: [_scipy(*plant) for plant in plants], SAMPLE),
        "flexopt, CasADi VM": (of.in_the_vm, SAMPLE),
        f"flexopt, batch ({means(of.runner)})": (of.ours, POSTURES),
    }
    seconds = {name: median_seconds(work, repeats=5, seconds=1.0) / count for name, (work, count) in timed.items()}
    slicot = seconds["SLICOT sb02md, twice"]
    lines: list[tuple[str, ...]] = [("who", "µs each", "SLICOT : this", "largest difference from flexopt's batch")]
    for name, (work, _) in timed.items():
        difference = float(np.abs(np.asarray(work())[:SAMPLE] - values).max())
        lines.append((name, f"{1e6 * seconds[name]:.2f}", f"{slicot / seconds[name]:.1f}", f"{difference:.1e}"))
    print(table(f"One ε_max, {of.margin.n_states} states, random postures of the excavator, one core", lines))


if __name__ == "__main__":
    main()
