"""How right the margins are: oracle values, random plants by other routes, machines in 420-bit arithmetic.

Run: python -m benchmarks.margin_accuracy [--plants N] [--machines N] [--trees N] [--cases N]

The last table is about what `evaluate` tells: ε_max and its gradient of random machines, every fourth one extreme, and
the bounds beside them, against ball arithmetic. It ends with an error where a number is outside its bound.
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
from tests.oracles.high_precision import Comparison, compare
from tests.oracles.margin_cases import margin_case as machine_case
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
    refused = 0
    for k in range(count):
        case, kr = margin_case(k)
        ours = evaluate_margin(build_margin(case.tree), case.base, case.posture, kr).epsilon_max
        plant = scaled_plant(case.tree, case.posture, case.base, kr)
        slicot, exact = slicot_epsilon(plant), refined_epsilon(plant)
        if ours is None:
            refused += 1
            continue
        found[plant.A.shape[0] >= LARGE].append(
            (abs(ours / slicot - 1), abs(ours / exact - 1), abs(slicot / exact - 1))
        )
    for large, errors in found.items():
        if errors:
            apart, wrong, theirs = np.array(errors).T
            numbers = [np.median(apart), apart.max(), wrong.max(), theirs.max()]
            what = f"{LARGE} to 36" if large else f"below {LARGE}"
            rows.append((what, str(len(errors)), *(f"{number:.1e}" for number in numbers)))
    if refused:
        rows.append(("refused", str(refused), "", "", "", ""))
    return rows


def bounded(count: int) -> tuple[list[tuple[str, ...]], bool]:
    """ε_max and gradients beside their bounds, by kind of machine, and whether all are within."""
    heads = (
        "machines",
        "cases",
        "without number",
        "nothing stabilises: said / false",
        "without gradient",
        "outside bound",
    )
    rows: list[tuple[str, ...]] = [(*heads, "largest error", "bound", "largest gradient error", "bound", "in doubles")]
    found: dict[str, list[tuple[Comparison, float]]] = {}
    for k in range(count):
        case = machine_case(k)
        compared = compare(case.margin, case.base, case.posture, case.kr, k)
        p = case.margin.plant.parameter_values
        plain = float(case.margin.values.call([case.base, case.posture, p, case.kr])[0][0])
        found.setdefault(case.kind, []).append((compared, abs(plain / compared.epsilon - 1)))
    good = True
    for kind, pairs in [*found.items(), ("all", [pair for group in found.values() for pair in group])]:
        group = [pair[0] for pair in pairs]
        told = [c for c in group if c.found.epsilon_max is not None and c.slopes]
        said = [c for c in group if c.found.unstabilizable]
        outside = sum(not c.within for c in group)
        good &= outside == 0
        # Gradients beside ε_max, per radian, metre or relative change.
        slopes = [slope for c in told for slope in c.slopes if np.isfinite(slope[0])]
        counts = [len(group), sum(c.found.epsilon_max is None for c in group)]
        numbers = [
            max((c.error / c.epsilon for c in told), default=math.nan),
            max((c.found.error / c.epsilon for c in told), default=math.nan),
            max((slope[1] for slope in slopes), default=math.nan),
            max((slope[2] for slope in slopes), default=math.nan),
            np.nanmax([pair[1] for pair in pairs], initial=0.0),
        ]
        texts = [str(n) for n in counts] + [f"{len(said)} / {sum(c.epsilon > 1e-12 for c in said)}"]
        texts += [str(sum(not c.complete and c.found.epsilon_max is not None for c in group)), str(outside)]
        rows.append((kind, *texts, *(f"{x:.1e}" for x in numbers)))
    return rows, good


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
    parser.add_argument("--cases", type=int, default=200)
    options = parser.parse_args()
    warnings.simplefilter("ignore", FlexoptWarning)
    print(table("Known values", oracle_values()))
    print(table("Random plants, stable and unstable, with D", random_plants(options.plants)))
    title = "Trees in space, up to 12 passive coordinates and 6 task rows, gains over five decades"
    print(table(title, trees(options.trees)))
    print(table("Gradient of ε_max by posture, in doubles, relative to its size", gradients(options.machines)))
    rows, good = bounded(options.cases)
    print(table("ε_max and its gradient as `evaluate` tells them, by 420-bit arithmetic (ε_max relative)", rows))
    if not good:
        raise SystemExit("a number is outside its bound")


if __name__ == "__main__":
    main()
