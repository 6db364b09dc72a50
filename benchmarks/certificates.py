"""Certificates of the best beside a scan of the whole redundancy and beside the program that checks their logs.

Run: python -m benchmarks.certificates [--problems N] [--points N] [--seed N] [--unchecked]

The article's problem, with its three objectives, and random planar machines (up to five passive coordinates), targets,
weights, controls, joint limits, travel costs and ranges of the base. Each best of `flexopt.select` is certified; then V
is evaluated at many placements with either elbow, by the compiled measures, and compared with the bounds of the
placement's cell and of the certificate; and the log is checked by `flexopt.selection.certificate.check`, which shares
nothing with what wrote it.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections import Counter
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

import flexopt
from flexopt.errors import FlexoptError
from flexopt.foundation.arrays import Vector
from flexopt.plant.inverse_kinematics import branch, inside_limits
from flexopt.robustness.batches import evaluate_w
from flexopt.selection.certificate.check import check
from tests.oracles.machines import DIRECTIONS, Structure, arm_at_rest, random_machine

ARTICLE = ((("w1",), None), (("V",), (1.0, 1.0, 1.0)), (("w3",), None))
# What rounding in doubles may do to V at a point, as a share of the scale.
ROUNDING = 1e-11
BAR_ONE, BAR, SECONDS = 1e-8, 1e-5, 2.0


class Case(NamedTuple):
    """A problem and what it is called."""

    name: str
    machine: Any
    target: Vector
    options: dict[str, Any]


def article() -> Iterator[Case]:
    """The article's problem."""
    for control in ("inverse", "transpose"):
        for (objective,), weights in ARTICLE:
            options = {"objective": objective, "weights": weights, "control": control}
            yield Case(f"article {objective} {control}", flexopt.load("excavator"), np.array([0.0, 1.6]), options)


def random_case(seed: int) -> Case:
    """A machine with two actuated joints, and a target that it reaches."""
    rng = np.random.default_rng([seed, 14])
    free = tuple(d for d in DIRECTIONS if rng.uniform() < 0.75)
    passive = int(rng.integers(0, 3)) if free else int(rng.integers(1, 3))
    n = 2 + passive
    places = tuple(sorted(rng.permutation(n)[:passive].tolist()))
    _, machine = random_machine(rng, Structure(n, free, places))
    posture = rng.uniform(-3.0, 3.0, 2)
    posture[1] = rng.uniform(0.3, 2.8) * rng.choice([-1.0, 1.0])
    target = arm_at_rest(machine, posture)[1]
    m = machine_modes(machine)
    options: dict[str, Any] = {"control": ("inverse", "transpose", "damped:0.3")[int(rng.integers(0, 3))]}
    if rng.uniform() < 0.3:
        options["objective"] = f"w{rng.integers(1, m + 1)}"
    else:
        weights = np.where(rng.uniform(size=m) < 0.75, 10 ** rng.uniform(-2, 0, m), 0.0)
        weights[int(rng.integers(m))] = 1.0
        options |= {"objective": "V", "weights": weights.tolist()}
    if rng.uniform() < 0.4:
        options["base_range"] = sorted(rng.uniform(-2.0, 2.0, 2).tolist())
        options["base_range"] = [min(options["base_range"][0], -0.05), max(options["base_range"][1], 0.05)]
    if rng.uniform() < 0.3:
        travel = {"cost": 10 ** rng.uniform(-3, 0), "base": [0.0], "posture": posture.tolist()}
        options["constraints"] = {"travel": travel}
    if rng.uniform() < 0.3:
        options["singularity_margin_deg"] = 10 ** rng.uniform(-1, 1.4)
    if rng.uniform() < 0.5:
        data = machine.to_dict()
        for link, angle in zip((one for one in data["links"] if not one.get("passive")), posture, strict=True):
            link["limits"] = [angle - rng.uniform(0.05, 2.5), angle + rng.uniform(0.05, 2.5)]
        machine = flexopt.machine_from_dict(data)
    return Case(f"random {seed}", machine, target, options)


def machine_modes(machine: Any) -> int:
    """Number of passive coordinates."""
    return flexopt.build_plant(machine).n_passive


def contradictions(selection: flexopt.Selection, certificate: flexopt.Certificate, points: int) -> tuple[int, float]:
    """Allowed points that have more than their cell's bound allows, or than the certificate's; the best V seen."""
    problem, log = selection.problem, certificate.log
    plant, variable = problem.measures.plant, problem.variables[0]
    x = np.linspace(variable.lower, variable.upper, max(2, points // 2))
    wrong, best, rounding = 0, -math.inf, ROUNDING * problem.objective_scale
    for elbow in (-1.0, 1.0):
        posture, reaches = branch(plant, problem.target, x[None, :], np.zeros((0, x.size)), elbow)
        sines = plant.singularity_sine_squared(x[None, :], posture, plant.parameter_values).full().ravel()
        allowed = reaches & inside_limits(problem.machine, posture) & (sines >= problem.constraints[2].lower)
        w = evaluate_w(problem.measures, x[None, allowed], posture[:, allowed], threads=2).w
        value = np.array(problem.objective.alpha) @ w
        if problem.travel is not None:
            z = np.vstack([x[None, allowed], posture[:, allowed]]).T
            value = value - problem.travel_cost(problem.objective, z)[0]
        cells = [(low, high, why, bound) for side, low, high, why, bound in log["cells"] if side == elbow]
        limit = np.full(value.size, certificate.upper)
        if cells:
            lows = np.array([cell[0] for cell in cells])
            bounds = np.array([-math.inf if cell[2] else math.inf if cell[3] is None else cell[3] for cell in cells])
            number = np.searchsorted(lows, x[allowed], side="right") - 1
            # A point on the edge of two cells, or within rounding of bounds, may count for either.
            beside = (np.searchsorted(lows, x[allowed] + shift, side="right") - 1 for shift in (1e-9, -1e-9))
            limit = np.minimum(limit, np.maximum.reduce([bounds[number], *(bounds[np.maximum(k, 0)] for k in beside)]))
        known = np.isfinite(value)
        wrong += int(np.sum(value[known] > limit[known] + rounding))
        best = max(best, float(value[known].max(initial=-math.inf)))
    return wrong, best


def examine(case: Case, points: int, checked: bool) -> dict[str, Any] | str:
    """What became of a problem, or why there is none."""
    try:
        selection = flexopt.select(case.machine, case.target, **case.options, workers=1)
    except FlexoptError as error:
        return str(error)
    start = time.perf_counter()
    certificate = flexopt.certify(selection)
    seconds = time.perf_counter() - start
    wrong, best = contradictions(selection, certificate, points) if points else (0, -math.inf)
    begin = time.perf_counter()
    faults, trusted = check(json.loads(json.dumps(certificate.log))) if checked and certificate.proven else ([], 0)
    return {
        "verdict": certificate.verdict,
        "gap": certificate.gap / certificate.scale,
        "asked": certificate.gap_asked / certificate.scale,
        "cells": certificate.cells,
        "seconds": seconds,
        "wrong": wrong,
        "beyond": (best - certificate.value) / certificate.scale,
        "faults": faults,
        "trusted": trusted,
        "checking": time.perf_counter() - begin,
        "status": certificate.status,
    }


def main() -> int:
    """Ends with 1 where anything contradicts, or a bar is missed."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.certificates", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--problems", type=int, default=100, help="random ones")
    parser.add_argument("--points", type=int, default=1_000_000, help="of each scan")
    parser.add_argument("--seed", type=int, default=0, help="of the first random problem")
    parser.add_argument("--unchecked", action="store_true", help="leave the logs unchecked")
    options = parser.parse_args()
    # What is imported and compiled once is no part of a certificate's time.
    flexopt.certify(flexopt.select(flexopt.load("excavator"), (0.0, 1.6), objective="w2", base_range=(0.0, 0.1)))
    found: list[dict[str, Any]] = []
    number = options.seed
    cases = list(article())
    while len(found) < len(cases) + options.problems:
        random = len(found) >= len(cases)
        case = random_case(number) if random else cases[len(found)]
        number += random
        row = examine(case, options.points, not options.unchecked)
        if isinstance(row, str):
            print(f"{case.name}: no selection: {row[:150]}", flush=True)
            if not random:
                return 1
            continue
        found.append(row)
        if row["verdict"] != "proven" or row["wrong"] or row["faults"] or row["gap"] > row["asked"]:
            print(f"{case.name}: {row['status']}; {row['wrong']} contradictions; {row['faults'][:2]}", flush=True)
    proven = [row for row in found if row["verdict"] == "proven"]
    single = [row["gap"] for row in proven if row["asked"] <= BAR_ONE]
    sums = [row["gap"] for row in proven if row["asked"] > BAR_ONE]
    times, cells = np.array([row["seconds"] for row in found]), np.array([row["cells"] for row in found])
    checking = np.array([row["checking"] for row in found])
    wrong, faults = sum(row["wrong"] for row in found), sum(len(row["faults"]) for row in found)
    print(f"problems {len(found)}: {dict(Counter(row['verdict'] for row in found))}; points each {options.points}")
    print(f"contradictions: {wrong} by the scans, {faults} by the other program ({checking.max():.1f} s at most)")
    print(f"best of a scan beyond the best selected: {max(row['beyond'] for row in found):.2e} of the scale at most")
    print(f"gap: one w_i {max(single, default=0):.1e} (bar {BAR_ONE:g}), sums {max(sums, default=0):.1e} (bar {BAR:g})")
    print(f"cells: median {np.median(cells):.0f}, most {cells.max()}")
    print(f"seconds: median {np.median(times):.2f}, most {times.max():.2f} (bar {SECONDS:g})")
    return int(bool(wrong or faults or len(proven) < len(found) or times.max() > SECONDS))


if __name__ == "__main__":
    raise SystemExit(main())
