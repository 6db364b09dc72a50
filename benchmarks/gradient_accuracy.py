"""Accuracy of ∂w over a wide range of machines: flexopt's doubles beside Appendix B in 45 digits.

`python -m benchmarks.gradient_accuracy [--cases N] [--seed N]`, from the root of the source tree.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np

from tests.oracles.gradient_cases import Case, cases, compare, near_repeated, near_singular

SPREADS = (1e4, 1e6, 1e8)
# Below 1e-6 two frequencies are one cluster, whose measure is that of the sum.
GAPS = ((1e-4, 1e-3), (1e-5, 1e-4), (2e-6, 1e-5))
CONDITIONS = ((50.0, 1e3), (1e3, 1e4))


def buckets(seed: int, count: int) -> Iterator[tuple[str, list[Case]]]:
    """Name and cases of each row of the table."""
    for spread in SPREADS:
        found = list(cases(seed, count, spread=spread))
        yield f"stiffness ratio up to {spread:.0e} (gaps of ω² above 1e-3, cond Jv below 50)", found
    rng = np.random.default_rng(seed)
    for low, high in GAPS:
        wanted = np.geomspace(low, high, count)
        yield f"gaps of ω² from {low:.0e} to {high:.0e}", [near_repeated(rng, gap) for gap in wanted]
    for low, high in CONDITIONS:
        wanted = np.geomspace(low, high, count)
        yield f"cond Jv from {low:.0e} to {high:.0e}", [near_singular(rng, cond) for cond in wanted]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=120)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    print("|∂w − ∂w_oracle| / ‖∂R_i‖_F over both controllers, all modes and posture variables")
    print(f"{'range':<76} {'cases':>6} {'median':>9} {'99 %':>9} {'worst':>9}")
    for name, found in buckets(arguments.seed, arguments.cases):
        errors = [result.errors.ravel() for case in found for result in compare(case)]
        flat = np.concatenate(errors)
        print(
            f"{name:<76} {len(found):6d} {np.median(flat):9.1e} {np.quantile(flat, 0.99):9.1e} {flat.max():9.1e}",
            flush=True,
        )


if __name__ == "__main__":
    main()
