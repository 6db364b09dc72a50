"""How right the margins are: oracle values, random plants by other routes, and the gradient of ε_max by differences.

Run: python -m benchmarks.margin_accuracy [--plants N] [--machines N] [--trees N]
"""

from __future__ import annotations

import argparse
import math
import warnings

import numpy as np

import flexopt
from benchmarks.timing import table
from flexopt.errors import FlexoptError, FlexoptWarning
from flexopt.robustness.margin import build_margin
from flexopt.robustness.posture_margin import evaluate_margin
from tests.coprime.oracles import hankel_epsilon, refined_epsilon, scipy_epsilon, slicot_epsilon
from tests.coprime.plants import chain, random_plant
from tests.robustness.test_margin import CONTROLS, gradient_errors
from tests.robustness.test_spatial import margin_case, scaled_plant

LARGE = 30  # states
SLOW = ([[0.001]], [[1.0]], [[4.0]])
HANKEL = "Hankel norm from Gramians, ‖·‖_H² (absolute)"
# The example of MATLAB's ncfmargin.
FIRST = ([[0, 1], [-10, -5]], [[0], [1]], [[2, 1]])
SECOND = ([[0, 1], [-10, -3]], [[0], [1]], [[1, 1]])
INTEGRAL = ([[0.0]], [[1.0]], [[4.4]])


def oracle_values() -> list[tuple[str, ...]]:
    """What is printed elsewhere or known in closed form, beside what flexopt computes."""
    plus, minus = ([[0.001]], [[1.0]], [[1.0]]), ([[-0.001]], [[1.0]], [[1.0]])
    shaped = ([[0, 1, 0], [0, 0, 1], [0, -10, -2]], [[0], [0], [1]], [[5, 1, 0]])
    scaled = max(abs(float(flexopt.robust_margin(*chain(2, 10.0**k))) - math.sin(math.pi / 8)) for k in range(-6, 7))
    cases = [
        ("1/s", math.sin(math.pi / 4), float(flexopt.robust_margin(*chain(1)))),
        ("1/s²", math.sin(math.pi / 8), float(flexopt.robust_margin(*chain(2)))),
        ("1/s³", 0.16910, float(flexopt.robust_margin(*chain(3)))),
        ("a/s², a = 1e-6 … 1e6, largest deviation", 0.0, scaled),
        ("4/(s − 0.001), C = 1", 0.7069, flexopt.ncf_margin(SLOW, 1.0)),
        ("4/(s − 0.001), C = 10", 0.0995, flexopt.ncf_margin(SLOW, 10.0)),
        ("(s + 2)/(s² + 5s + 10), C = 4.4/s", 0.1961, flexopt.ncf_margin(FIRST, INTEGRAL)),
        ("gap of it and (s + 1)/(s² + 3s + 10)", 0.1391, flexopt.gap(FIRST, SECOND)),
        ("(s + 5)/(s² + 2s + 10)/s", 0.6325, float(flexopt.robust_margin(*shaped))),
        ("gap of 1/(s ∓ 0.001)", 0.0021, flexopt.gap(plus, minus)),
        ("ν-gap of 1/(s ∓ 0.001)", 0.0020, flexopt.nu_gap(plus, minus)),
    ]
    rows: list[tuple[str, ...]] = [("what", "known", "flexopt", "difference")]
    rows += [(name, f"{known:.5f}", f"{ours:.7f}", f"{ours - known:+.1e}") for name, known, ours in cases]
    return rows


def random_plants(count: int) -> list[tuple[str, ...]]:
    """Worst relative deviation of ε_max from each other route, over plants whose condition estimate is below 1e7."""
    worst = {"SLICOT sb02md": 0.0, "SciPy solve_continuous_are": 0.0, HANKEL: 0.0}
    compared = 0
    for seed in range(count):
        plant = random_plant(seed, 1 + seed % 10)
        try:
            result = flexopt.robust_margin(plant)
        except FlexoptError:
            continue
        if result.condition > 1e7:
            continue
        compared += 1
        for name, oracle in zip(worst, (slicot_epsilon, scipy_epsilon, hankel_epsilon), strict=True):
            ours, other = float(result), oracle(plant)
            # 1 − ‖·‖_H² cancels where ε_max is small, so that route is compared in ‖·‖_H² itself.
            worst[name] = max(worst[name], abs(other**2 - ours**2) if name == HANKEL else abs(other / ours - 1))
    rows: list[tuple[str, ...]] = [("route", f"worst relative deviation of {compared} plants, n ≤ 10")]
    return rows + [(name, f"{value:.1e}") for name, value in worst.items()]


def trees(count: int) -> list[tuple[str, ...]]:
    """ε_max of random trees in postures, as `evaluate` gives it: by SLICOT and in extended precision."""
    rows: list[tuple[str, ...]] = [
        ("states", "trees", "from SLICOT, median", "largest", "from extended precision", "SLICOT from it")
    ]
    found: dict[bool, list[tuple[float, float, float]]] = {False: [], True: []}
    for k in range(count):
        case, kr = margin_case(k)
        ours = evaluate_margin(build_margin(case.tree), case.base, case.posture, kr).epsilon_max
        plant = scaled_plant(case.tree, case.posture, case.base, kr)
        slicot, exact = slicot_epsilon(plant), refined_epsilon(plant)
        assert ours is not None
        found[plant.A.shape[0] >= LARGE].append(
            (abs(ours / slicot - 1), abs(ours / exact - 1), abs(slicot / exact - 1))
        )
    for large, errors in found.items():
        if errors:
            apart, wrong, theirs = np.array(errors).T
            numbers = [np.median(apart), apart.max(), wrong.max(), theirs.max()]
            what = f"{LARGE} to 36" if large else f"below {LARGE}"
            rows.append((what, str(len(errors)), *(f"{number:.1e}" for number in numbers)))
    return rows


def gradients(count: int) -> list[tuple[str, ...]]:
    """Errors of the exact gradient against differences of fourth order."""
    rows: list[tuple[str, ...]] = [("control", "cases", "median", "95 %", "worst", "of them above 1e-7")]
    for control in CONTROLS:
        errors = np.array([error for error, _ in gradient_errors(control, count)])
        quantiles = [f"{np.quantile(errors, q):.1e}" for q in (0.5, 0.95, 1.0)]
        rows.append((control, str(errors.size), *quantiles, str(int(np.sum(errors > 1e-7)))))
    return rows


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plants", type=int, default=400)
    parser.add_argument("--machines", type=int, default=135)
    parser.add_argument("--trees", type=int, default=36)
    options = parser.parse_args()
    warnings.simplefilter("ignore", FlexoptWarning)
    print(table("Known values", oracle_values()))
    print(table("Random plants, stable and unstable, with D", random_plants(options.plants)))
    title = "Trees in space, up to 12 passive coordinates and 6 task rows, gains over five decades"
    print(table(title, trees(options.trees)))
    print(table("Gradient of ε_max by posture, random machines, relative to its size", gradients(options.machines)))


if __name__ == "__main__":
    main()
