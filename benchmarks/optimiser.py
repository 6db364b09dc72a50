"""The generated posture optimiser against IPOPT: answers, and instructions on an emulated Cortex-M7.

Run: python -m benchmarks.optimiser [--machine NAME] [--pairs N] [--target host|cortex-m7|both]
    [--real double|float|both] [--control inverse|transpose|damped:LAMBDA|both] [--budget TIMES]

A machine that is named is measured alone; by default it is the excavator, then others. TIMES the default budget of a
call: it is made for the bar of five million instructions, which machines in space need more of to see all their optima.

Each pair is a random target, a random objective (w_1 alone, or random weights), a random range of placements (or all),
and a random start: half of them any numbers within the bounds, half on the target. Where postures have no closed form
the target is the end-point of a random posture at a random placement, and the ranges lie about that placement. IPOPT
solves from that start as `flexopt.select` does from a peak. An answer counts as the same or better where V is not below
IPOPT's by more than 1e-8 of the problem's scale; where IPOPT fails, any does. Programs are built and run, and their
instructions counted, as `flexopt verify` does. Needs gcc for the host, arm-none-eabi-gcc with newlib and
qemu-system-arm for Cortex-M7; says what is missing.
"""

from __future__ import annotations

import argparse
import math
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import flexopt
from benchmarks.timing import table
from flexopt.errors import FlexoptError, UnreachableTarget
from flexopt.export.bundle import build_library
from flexopt.export.kernels import Real
from flexopt.export.optimiser import FIRST_FAILURE, STARTS, STATUSES
from flexopt.export.sources import Library
from flexopt.export.verify.bench import Bench
from flexopt.export.verify.checks import VerifyTarget
from flexopt.export.verify.optimiser import PART, Solved, default_calls, host_runner, solve
from flexopt.export.verify.target import board_runner
from flexopt.foundation.arrays import Vector
from flexopt.foundation.control import Control
from flexopt.foundation.quantities import COORDINATE_MAX
from flexopt.foundation.writing import make_folder, write_file
from flexopt.model import AnyMachine
from flexopt.model.choices import SINGULARITY_MARGIN_DEG
from flexopt.plant import Plant, build_plant
from flexopt.plant.reach import arm_length, reach, sampled_ranges
from flexopt.selection.nlp.program import single

SAME = 1e-8
# Share of the scale that V may lose against IPOPT; how far from the target still counts as on it, m; by how much inputs
# are rounded.
ALLOWED: dict[Real, tuple[float, float, float]] = {"double": (SAME, 1e-8, 0.0), "float": (1e-6, 5e-5, 1e-6)}
BAR = 5_000_000


@dataclass(frozen=True)
class Pair:
    """A problem and a start, and what IPOPT makes of them.

    Attributes:
        problem: the selection problem, with its bounds and scale.
        start: z.
        ipopt: its V, or minus infinity where it failed or left the target.
    """

    problem: flexopt.SelectionProblem
    start: Vector
    ipopt: float


def value_of(problem: flexopt.SelectionProblem, z: Vector) -> tuple[float, float]:
    """V and |r − target| by flexopt's own Functions."""
    plant = problem.measures.plant
    w, _, r = problem.measures.w.call([z[: plant.n_base], z[plant.n_base :], plant.parameter_values])
    v = float(np.dot(problem.objective.alpha, w.full().ravel()))
    return v, float(np.abs(r.full().ravel() - problem.target).max())


def random_weights(rng: np.random.Generator, count: int) -> list[float]:
    """w_1 alone, or any."""
    first = [1.0] + [0.0] * (count - 1)
    return first if rng.random() < 0.5 else rng.uniform(0, 1, count).tolist()


def draw_in_plane(rng: np.random.Generator, plant: Plant) -> tuple[Any, list[float], Any]:
    """Target, weights and range of placements of a planar machine."""
    annulus = reach(plant)
    target = (rng.uniform(-1, 1), annulus.center[1] + annulus.outer * rng.uniform(-0.95, 0.95))
    weights = random_weights(rng, plant.n_passive)
    if rng.random() >= 0.5:
        return target, weights, None
    intervals = annulus.base_intervals(np.array(target))
    middle = rng.uniform(*intervals[rng.integers(len(intervals))])
    half = annulus.outer * rng.uniform(0.05, 1)
    return target, weights, (middle - half, middle + half)


def draw_by_posture(rng: np.random.Generator, plant: Plant) -> tuple[Any, list[float], Any]:
    """Target, weights and ranges of placements of any machine: a random posture leads to the target."""
    machine, length, p = plant.machine, arm_length(plant), plant.parameter_values
    sizes = np.array([math.pi if unit == "rad" else length for unit in machine.base_units])
    base, posture = rng.uniform(-sizes, sizes), rng.uniform(*sampled_ranges(machine, length).T)
    target = plant.end_point(plant.rest(base, posture, p), base, p).full().ravel()
    weights = random_weights(rng, plant.n_passive)
    if rng.random() >= 0.5:
        return target, weights, None
    half = sizes * rng.uniform(0.05, 1, sizes.size)
    ends = np.column_stack([base - half, base + half]).tolist()
    return target, weights, dict(zip(machine.base_coordinates, ends, strict=True))


def draw_pairs(machine: AnyMachine, control: Control, count: int, seed: int) -> list[Pair]:
    """Random pairs, each with IPOPT's answer."""
    rng = np.random.default_rng(seed)
    plant = build_plant(machine)
    draw = draw_in_plane if plant.closed_form else draw_by_posture
    pairs: list[Pair] = []
    while len(pairs) < count:
        target, weights, base_range = draw(rng, plant)
        try:
            problem = flexopt.build_selection(
                machine, target, control=control, objective="V", weights=weights, base_range=base_range, assume="limits"
            )
        except UnreachableTarget:
            continue
        start = rng.uniform(problem.region.low, problem.region.high)
        if rng.random() < 0.5:
            k = rng.integers(problem.scan.size)
            start = np.concatenate([problem.scan.base[:, k], problem.scan.posture[:, k]])
        z, _, status = single(problem).solve(start)
        v, error = value_of(problem, z)
        pairs.append(Pair(problem, start, v if status == "Solve_Succeeded" and error < 1e-8 else -math.inf))
    return pairs


def built(machine: AnyMachine, control: Control, real: Real) -> Library:
    """The C library of a machine with its optimiser."""
    return build_library(
        machine, ("kinematics", PART), real=real, control=control, gain=1.0, baked=False, prefix="bench",
        singularity_margin_deg=SINGULARITY_MARGIN_DEG,
    )  # fmt: skip


def run(library: Library, pairs: list[Pair], *, own_starts: bool, target: VerifyTarget, times: int = 1) -> Solved:
    """Compile for "host" or "cortex-m7" and solve every pair there, with `times` the default budget."""
    part = library.standalone[PART]
    calls = default_calls(part, len(pairs))
    # Bounds of this size, also of angles, mean none to the generated code.
    bounds = [(each.problem.lower, each.problem.upper) for each in pairs]
    calls.lower[:], calls.upper[:] = np.clip(np.swapaxes(bounds, 0, 1), -COORDINATE_MAX, COORDINATE_MAX)
    calls.target[:] = [each.problem.target for each in pairs]
    calls.weights[:] = [each.problem.objective.alpha for each in pairs]
    calls.start[:] = [each.start for each in pairs]
    calls.words[:, 1:3] = times * part.sources.budget, STARTS if own_starts else 0
    with tempfile.TemporaryDirectory(prefix="flexopt-") as name:
        folder = Path(name)
        driver = {"test/optimiser_driver.c": part.writer.render("optimiser_driver.c")}
        for path, text in (library.files("") | driver).items():
            write_file(make_folder((folder / path).parent) / Path(path).name, text)
        bench = Bench(folder, folder, {}, library, len(pairs), 0)
        runner = host_runner(bench, "gcc", bench.sources) if target == "host" else board_runner(bench, target)
        return solve(bench, calls, runner)


def summary(pairs: list[Pair], answers: Solved, real: Real = "double") -> tuple[str, ...]:
    """Same or better, infeasible successes, answered, converged, failures of IPOPT."""
    same_as, off, rounding = ALLOWED[real]
    same = infeasible = answered = failures = 0
    for pair, status, z in zip(pairs, answers.status, answers.z, strict=True):
        problem, plant = pair.problem, pair.problem.measures.plant
        failures += pair.ipopt == -math.inf
        if status >= FIRST_FAILURE:
            same += pair.ipopt == -math.inf
            continue
        answered += 1
        v, error = value_of(problem, z)
        at = [z[: plant.n_base], z[plant.n_base :], plant.parameter_values]
        slack = rounding * np.maximum(1.0, np.abs(z))
        inside = np.all(z >= problem.lower - slack) and np.all(z <= problem.upper + slack)
        # The rows are those of the target, then this one.
        apart = float(plant.singularity_sine_squared.call(at)[0]) >= problem.constraints[plant.n_task].lower - off
        infeasible += not (inside and error <= off and apart)
        same += v >= pair.ipopt - same_as * problem.objective_scale
    n = len(pairs)
    share = f"{same} of {n} ({100 * same / n:.1f} %)"
    return share, str(infeasible), f"{answered}", f"{(answers.status == STATUSES['CONVERGED'][0]).sum()}", f"{failures}"


def spread(values: Vector) -> tuple[str, ...]:
    """Median, 95th percentile and worst, with separators."""
    return tuple(f"{round(float(v)):,}" for v in (np.median(values), np.percentile(values, 95), values.max()))


def missing_tools(tools: tuple[str, ...]) -> list[str]:
    """Those not on PATH."""
    return [tool for tool in tools if shutil.which(tool) is None]


def machines() -> list[tuple[str, AnyMachine]]:
    """Others than the excavator: a third joint, joint limits, a placement in three coordinates."""
    data = flexopt.load("excavator").to_dict()
    bucket = {"name": "bucket", "length": 0.6, "com": 0.3, "mass": 150.0, "inertia": 12.0, "limits": [-2.5, 2.5]}
    boom, stick = data["links"]
    limited = [boom | {"limits": [-0.5, 1.2]}, stick | {"limits": [-2.6, -0.4]}]
    return [
        ("with a bucket, 3 joints", flexopt.machine_from_dict(data | {"links": [boom, stick, bucket]})),
        ("with joint limits", flexopt.machine_from_dict(data | {"links": limited})),
        ("slewing-excavator", flexopt.load("slewing-excavator")),
    ]


def compare(
    machine: AnyMachine,
    controls: Sequence[Control],
    runs: Sequence[tuple[Real, bool]],
    places: Sequence[VerifyTarget],
    count: int,
    times: int = 1,
) -> None:
    """Print both tables of a machine; a run is a precision and whether own starts are allowed.

    The budget of a call is `times` the default.
    """
    quality: list[tuple[str, ...]] = [
        ("where", "control", "real", "starts", "same or better", "infeasible", "answered", "converged", "IPOPT failed")
    ]
    effort: list[tuple[str, ...]] = [
        (
            *("control", "real", "starts", "instructions: median", "95 %", "worst", "bar", "worst a unit of budget"),
            *("steps: median", "95 %", "worst", "stack, bytes", "workspace, bytes"),
        )
    ]
    for control in controls:
        pairs = draw_pairs(machine, control, count, seed=2026)
        for real, own_starts in runs:
            library = built(machine, control, real)
            word = "given and own" if own_starts else "given only"
            for place in places:
                answers = run(library, pairs, own_starts=own_starts, target=place, times=times)
                quality.append((place, control, real, word, *summary(pairs, answers, real)))
                if place == "host":
                    continue
                # Without an answer there is no cost.
                told = answers.cost > 0
                unit = round(float((answers.instructions[told] / answers.cost[told]).max()))
                numbers = (*spread(answers.instructions), f"{BAR:,}", f"{unit:,}", *spread(answers.iterations))
                effort.append((control, real, word, *numbers, f"{answers.stack.max():,}", f"{answers.workspace:,}"))
    allowed = "" if times == 1 else f", {times} times the default budget"
    print(table(f"{machine.name}: answers against IPOPT, {count} random targets and starts each{allowed}", quality))
    if effort[1:]:
        print(table(f"{machine.name}: one call on an emulated Cortex-M7", effort))


def compare_others(count: int) -> None:
    """Print one table of the other machines."""
    rows: list[tuple[str, ...]] = [
        (
            *("machine", "same or better", "infeasible", "answered", "converged", "IPOPT failed", "steps: median"),
            *("95 %", "worst", "cost: median", "95 %", "worst"),
        )
    ]
    for name, machine in machines():
        pairs = draw_pairs(machine, "inverse", count, seed=2027)
        answers = run(built(machine, "inverse", "double"), pairs, own_starts=True, target="host")
        rows.append((name, *summary(pairs, answers), *spread(answers.iterations), *spread(answers.cost)))
    print(table(f"The same on the host for other machines, inverse control, given and own starts, {count} each", rows))


def places_of(target: str) -> list[VerifyTarget]:
    """Where to run; of both, those that there are tools for."""
    tools: dict[VerifyTarget, tuple[str, ...]] = {
        "host": ("gcc",),
        "cortex-m7": ("arm-none-eabi-gcc", "qemu-system-arm"),
    }
    asked = [place for place in tools if target in (place, "both")]
    absent = {place: missing_tools(tools[place]) for place in asked}
    for place, names in absent.items():
        if names:
            print(f"Not measured on {place}: {', '.join(names)} missing")
    found = [place for place in asked if not absent[place]]
    if not found:
        raise SystemExit("nothing can be measured")
    return found


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machine", help="shipped machine or path of a file; measured alone")
    parser.add_argument("--pairs", type=int, default=200)
    parser.add_argument("--target", choices=("host", "cortex-m7", "both"), default="both")
    parser.add_argument("--real", choices=("double", "float", "both"), default="both")
    parser.add_argument("--control", default="both", help="inverse, transpose, damped:LAMBDA or both of the first two")
    parser.add_argument("--budget", type=int, default=1, metavar="TIMES", help="times the default budget of a call")
    options = parser.parse_args()
    if min(options.pairs, options.budget) < 1:
        parser.error("--pairs, --budget: must be 1 or more")
    places = places_of(options.target)
    controls: Sequence[Control] = ("inverse", "transpose") if options.control == "both" else (options.control,)
    every: tuple[tuple[Real, bool], ...] = (("double", True), ("double", False), ("float", True))
    runs = [(real, own_starts) for real, own_starts in every if options.real in (real, "both")]
    try:
        compare(flexopt.load(options.machine or "excavator"), controls, runs, places, options.pairs, options.budget)
        if options.machine is not None:
            return
        if "host" in places:
            compare_others(max(1, options.pairs // 2))
        if "cortex-m7" in places:
            spatial = [(real, own_starts) for real, own_starts in runs if own_starts]
            compare(flexopt.load("slewing-excavator"), controls[:1], spatial, ["cortex-m7"], max(1, options.pairs // 4))
    except FlexoptError as error:
        raise SystemExit(str(error)) from None


if __name__ == "__main__":
    main()
