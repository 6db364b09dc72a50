"""Time of a workspace map, whole and a point, beside SciPy and NumPy on the same postures, and without a compiler.

Run: python -m benchmarks.maps

The peers get their matrices ready made (M, K, J and Jv; the scaled state space for ε_max), while flexopt computes
them from the posture. SciPy's ε_max is that of `solve_continuous_are` twice. The compiled code is made before
the clock starts. What the first map costs with an empty cache is printed beside (bar: 5 s).
"""

from __future__ import annotations

import os
import tempfile
import warnings
from collections.abc import Callable
from unittest import mock

import numpy as np
import scipy.linalg

import flexopt
from benchmarks.batches import peers
from benchmarks.timing import fresh_process, least_of, table
from flexopt.foundation import kept
from flexopt.foundation.turns import available_cores
from flexopt.robustness.margin import build_margin
from flexopt.study.maps import points

WHOLE, SMALL, FEW, LOOP = (400, 400), (60, 60), 2000, 300
GAIN = 5e5


def seconds(work: Callable[[], object]) -> float:
    """The least of four calls."""
    return least_of({"": work}, 2)[""]


def scipy_margins(postures: np.ndarray) -> tuple[float, np.ndarray]:
    """Seconds and ε_max from two Riccati equations each; matrices made outside the clock."""
    margin = build_margin(flexopt.load("excavator"))
    p = margin.plant.parameter_values
    ready = []
    for q in postures.T:
        held = margin.hold(0.0, q, p, GAIN)
        ready.append([x.full() for x in margin.scaled_plant.call([0.0, q, p, GAIN, held])])

    def work() -> None:
        for k, (a, b, c) in enumerate(ready):
            x = scipy.linalg.solve_continuous_are(a, b, c.T @ c, np.eye(2))
            z = scipy.linalg.solve_continuous_are(a.T, c.T, b @ b.T, np.eye(2))
            result[k] = (1 + np.linalg.eigvals(x @ z).real.max()) ** -0.5

    result = np.empty(len(ready))
    return seconds(work), result


FIRST = """
import os, sys, time, warnings
import flexopt
from flexopt.study.maps import points
machine, size = flexopt.load("excavator"), int(sys.argv[1])
start, before = time.perf_counter(), os.times()
flexopt.map_workspace(machine, points=(size, size))
seconds, after = time.perf_counter() - start, os.times()
of_map = points.expect_points(0, machine, control="inverse", gravity=False, epsilon_max=True)
user = after.user - before.user, after.children_user - before.children_user
print(f"{seconds:.1f} s; processor time {user[0]:.1f} s, of compilers {user[1]:.1f} s; compiled: "
      f"measures {of_map.values.compiled}, ε_max {of_map.margins.compiled}")
"""


def first_map(size: tuple[int, int]) -> str:
    """What the first map costs, and what of it was worth compiling."""
    with tempfile.TemporaryDirectory() as folder:
        return fresh_process(FIRST, str(size[0]), environment={"FLEXOPT_CACHE": folder})[1].strip()


def main() -> None:
    """Print the table."""
    machine = flexopt.load("excavator")
    rng = np.random.default_rng(0)
    postures = np.vstack([rng.uniform(-3, 3, FEW), rng.choice([-1, 1], FEW) * rng.uniform(0.2, 2.9, FEW)])
    whole = seconds(lambda: flexopt.map_workspace(machine, points=WHOLE))
    result = flexopt.map_workspace(machine, points=WHOLE)
    mapped = np.isfinite(result.array("condition")).sum()

    many = np.tile(postures, 20)
    each = {
        "flexopt, all of a map": seconds(lambda: points.evaluate_points(machine, many)) / many.shape[1],
        "flexopt, without ε_max": seconds(lambda: points.evaluate_points(machine, many, epsilon_max=False))
        / many.shape[1],
    }
    reference = points.evaluate_points(machine, postures)
    with mock.patch.dict(os.environ, FLEXOPT_COMPILE="0"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        kept.forget_all()
        each["flexopt, all of a map, no compiler"] = seconds(lambda: points.evaluate_points(machine, postures)) / FEW
    kept.forget_all()
    others = peers(flexopt.build_measures(machine), postures)
    each["NumPy eigh, batched: w_i only"] = seconds(others.numpy_batched) / FEW
    each["SciPy eigh, loop: w_i only"] = seconds(others.scipy_loop) / 500
    spent, epsilon = scipy_margins(postures[:, :LOOP])
    each["SciPy CARE twice, loop: ε_max only"] = spent / LOOP
    base = each["flexopt, all of a map"]
    rows: list[tuple[str, ...]] = [("who", "µs a posture", "ratio to flexopt")]
    rows += [(name, f"{1e6 * value:.2f}", f"{value / base:.2f}") for name, value in each.items()]
    print(table(f"A posture of a map, {available_cores()} threads for flexopt", rows))
    print(f"map of {WHOLE[0]} × {WHOLE[1]} points, {mapped} of them reached: {whole:.2f} s")
    for size in (SMALL, WHOLE):
        print(f"first map of {size[0]} × {size[1]} points in a new process, with an empty cache: {first_map(size)}")
    print(f"largest difference of ε_max from SciPy: {np.abs(epsilon - reference.epsilon_max[:LOOP]).max():.1e}")


if __name__ == "__main__":
    main()
