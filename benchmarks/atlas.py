"""The atlas: the article's doubly robust postures beside brute force, and the same curves on finer grids.

Run: python -m benchmarks.atlas [--machines N]

First, for both controls and every pair of modes, the postures with w_i = w_j = 0 that `flexopt.atlas` finds without
hints, beside those of a 400 × 400 grid and SciPy's solver on the article's Table 1 written anew in NumPy; the largest
of their |w_i| over the map's largest and over their own |a_i||b_i|. Then, for the shipped machines in the plane and N
random ones, whether grids of half and of twice as many cells as the default find the same curves, ends and points.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

import flexopt
from benchmarks.timing import table
from tests.oracles.article import brute_force
from tests.oracles.machines import NumpySource, draw_machine, draw_structure

PAIRS = (1, 2), (1, 3), (2, 3)
CELLS = 64, 128, 256
DIGGER: tuple[tuple[tuple[str, str], tuple[float, ...]], ...] = (
    (("boom", "stick"), (-2.0, -0.5, 0.3)),
    (("boom", "bucket"), (-2.0, -1.2)),
    (("stick", "bucket"), (-1.5, -0.8)),
)


def article() -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for control in ("inverse", "transpose"):
        atlas = flexopt.atlas(flexopt.load("excavator"), control=control)
        for pair in PAIRS:
            points = [point for point in atlas.doubly_robust if point.modes == pair]
            theirs = brute_force(control, pair[0] - 1, pair[1] - 1).reshape(-1, 2)
            apart = [float(np.abs(p.posture - t).max()) for p, t in zip(points, theirs, strict=False)]
            w = [(abs(p.w[m - 1]), p.scale[m - 1]) for p in points for m in pair]
            largest = max((size / atlas.w_largest.max() for size, _ in w), default=0.0)
            own = max((size / scale for size, scale in w), default=0.0)
            name = f"{control}, w{pair[0]} = w{pair[1]} = 0"
            counts = str(len(points)), str(len(theirs)), "yes" if len(points) == len(theirs) else "NO"
            rows.append((name, *counts, f"{max(apart, default=0.0):.0e}", f"{largest:.0e}", f"{own:.0e}"))
    return rows


def found(atlas: flexopt.Atlas) -> tuple[Any, ...]:
    curves = sorted((c.mode, c.closed, tuple(sorted(c.ends))) for c in atlas.curves)
    points = [[(p.modes, p.vanishing) for p in each] for each in (atlas.doubly_robust, atlas.vanishing)]
    return curves, points


def finer(name: str, machine: Any, **options: Any) -> tuple[str, ...]:
    atlases = [flexopt.atlas(machine, cells=(n, n), **options) for n in CELLS]
    each = [found(atlas) for atlas in atlases]
    fine = np.array([p.posture for p in (*atlases[-1].doubly_robust, *atlases[-1].vanishing)])
    apart = 0.0
    for point in (p.posture for a in atlases[:-1] for p in (*a.doubly_robust, *a.vanishing) if fine.size):
        turned = np.mod(fine - point + np.pi, 2 * np.pi) - np.pi
        apart = max(apart, float(np.abs(turned).max(axis=1).min()))
    same = ["yes" if other == each[-1] else "NO" for other in each[:-1]]
    return name, str(len(atlases[-1].curves)), str(len(fine)), *same, f"{apart:.0e}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machines", type=int, default=20)
    count = parser.parse_args().machines
    head = ("", "atlas", "brute force", "same", "apart, rad", "|w|/largest", "|w|/|a||b|")
    print(table("Postures of the article's machine with two measures zero", [head, *article()]))
    rows: list[tuple[str, ...]] = [("", "curves", "points", "64 as 256", "128 as 256", "points apart")]
    digger = flexopt.load("boom-stick-bucket")
    for control in ("inverse", "transpose", "damped:0.5"):
        for gravity in (False, True):
            options: dict[str, Any] = {"control": control, "gravity": gravity}
            name = f"{control}{', gravity' * gravity}"
            rows.append(finer(f"excavator, {name}", flexopt.load("excavator"), **options))
            for joints, values in DIGGER:
                for value in values:
                    title = f"boom-stick-bucket, {'-'.join(joints)} ({value:g}), {name}"
                    rows.append(finer(title, digger, joints=joints, posture=[value], **options))
    for seed in range(count):
        rng = np.random.default_rng(seed)
        source = NumpySource(rng)
        machine = flexopt.machine_from_dict(draw_machine(source, draw_structure(source, n_max=4)))
        posture = rng.uniform(-1.0, 1.0, len(machine.joints) - 2).tolist() or None
        control = ("inverse", "transpose", "damped:0.3")[seed % 3]
        rows.append(finer(f"{machine.name} ({seed}), {control}", machine, control=control, posture=posture))
    print(table("The same atlas by other grids", rows))


if __name__ == "__main__":
    main()
