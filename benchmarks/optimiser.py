"""The generated posture optimiser against IPOPT: answers, and instructions on an emulated Cortex-M7.

Run: python -m benchmarks.optimiser [--machine NAME] [--pairs N] [--target host|cortex-m7|both]
    [--real double|float|both] [--control inverse|transpose|damped:LAMBDA|both] [--budget TIMES]

A machine that is named is measured alone; by default it is the excavator, then others. TIMES the default budget of a
call: it is made for the bar of five million instructions, which machines in space need more of to see all their optima.

Each pair is a random target, a random objective (w_1 alone, or random weights), a random range of placements (or all),
and a random start: half of them any numbers within the bounds, half on the target. Where postures have no closed form
the target is the end-point of a random posture at a random placement, and the ranges lie about that placement. IPOPT
solves from that start as `flexopt.select` does from a peak. An answer counts as the same or better where V is not below
IPOPT's by more than 1e-8 of the problem's scale; where IPOPT fails, any does. Instructions are counted by SysTick under
`qemu -icount shift=0`, calibrated by a loop of known length. Needs gcc for the host, arm-none-eabi-gcc with newlib and
qemu-system-arm for Cortex-M7; says what is missing.
"""

from __future__ import annotations

import argparse
import math
import shutil
import struct
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import flexopt
from benchmarks.timing import table
from flexopt.errors import FlexoptError, UnreachableTarget
from flexopt.export.kernels import Real
from flexopt.export.optimiser import OptimiserSources, build_optimiser
from flexopt.foundation.arrays import Vector
from flexopt.foundation.control import Control
from flexopt.foundation.quantities import COORDINATE_MAX
from flexopt.model import AnyMachine
from flexopt.plant import Plant, build_plant
from flexopt.plant.reach import arm_length, reach, sampled_ranges
from flexopt.selection.optima import run_solver

SAME = 1e-8
# Share of the scale that V may lose against IPOPT; how far from the target still counts as on it, m; by how much inputs
# are rounded.
ALLOWED: dict[Real, tuple[float, float, float]] = {"double": (SAME, 1e-8, 0.0), "float": (1e-6, 5e-5, 1e-6)}
BAR = 5_000_000
FEASIBLE_STATUSES = ("CONVERGED", "BUDGET_SPENT", "DEADLINE", "STALLED")
WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror")
CORTEX_M7 = ("-mcpu=cortex-m7", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv5-d16")
LOOP = 1_000_000
# Words of the stack that are watched.
PAINTED = 65536

DRIVER = """
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include "optimiser.h"
#ifdef __arm__
#define SYST ((volatile uint32_t *)0xE000E010u)
static volatile uint32_t wraps;
void SysTick_Handler(void);
void SysTick_Handler(void) { wraps++; }
static double ticks(void)
{
    uint32_t before, now;
    do { before = wraps; now = SYST[2]; } while (before != wraps);
    return (double)before * 16777216.0 + (double)(16777215u - now);
}
static double loop(void)
{
    double start;
    uint32_t n = LOOPu;
    start = ticks();
    __asm volatile("1: subs %0, #1\\n bne 1b" : "+r"(n) : : "cc");
    return ticks() - start;
}
static void begin(void) { SYST[1] = 0xFFFFFFu; SYST[2] = 0; SYST[0] = 7; while (SYST[2] == 0) {} }
static volatile uint32_t *stack_now(void) { uint32_t *at; __asm volatile("mov %0, sp" : "=r"(at)); return at; }
static void paint(void)
{
    volatile uint32_t *at = stack_now() - 16;
    for (int i = 0; i < PAINTED; i++) { at[-i] = 0xA5A5A5A5u; }
}
static double used(void)
{
    volatile uint32_t *at = stack_now();
    int i = PAINTED;
    while ((i > 0) && (at[-i] == 0xA5A5A5A5u)) { i--; }
    return 4.0 * i;
}
#else
static void paint(void) {}
static double used(void) { return 0.0; }
static double ticks(void) { return 0.0; }
static double loop(void) { return 1.0; }
static void begin(void) {}
#endif

static bench_optimiser_workspace workspace;

int main(void)
{
    double header[2] = {0.0, sizeof(workspace)}, numbers[CASE_LENGTH];
    FILE *in = fopen("cases.bin", "rb"), *out = fopen("answers.bin", "wb");
    if ((in == NULL) || (out == NULL)) { return 1; }
    begin();
    header[0] = loop();
    fwrite(header, sizeof header, 1, out);
    while (fread(numbers, sizeof numbers, 1, in) == 1) {
        bench_optimiser_problem problem;
        bench_optimiser_options options;
        bench_optimiser_result result;
        REAL start[N_Z];
        const double *next = numbers;
        double answer[N_Z + 8], from;
        int i;
        memset(&result, 0, sizeof result);
        (void)bench_optimiser_default_problem(&problem);
        (void)bench_optimiser_default_options(&options);
        for (i = 0; i < N_TASK; i++) { problem.target[i] = (REAL)*next++; }
        for (i = 0; i < N_Z; i++) { problem.lower[i] = (REAL)*next++; }
        for (i = 0; i < N_Z; i++) { problem.upper[i] = (REAL)*next++; }
        for (i = 0; i < N_MODES; i++) { problem.weights[i] = (REAL)*next++; }
        for (i = 0; i < N_Z; i++) { start[i] = (REAL)*next++; }
        options.starts = *next++ > 0.5 ? options.starts : 0;
        paint();
        from = ticks();
        answer[0] = (double)bench_optimiser_solve(&problem, start, &options, &workspace, &result);
        answer[1] = ticks() - from;
        answer[2] = (double)result.value; answer[3] = (double)result.stationarity;
        answer[4] = result.iterations; answer[5] = result.cost; answer[6] = result.starts;
        answer[7] = used();
        for (i = 0; i < N_Z; i++) { answer[8 + i] = (double)result.z[i]; }
        fwrite(answer, sizeof answer, 1, out);
    }
    fclose(out);
    return 0;
}
"""

STARTUP = """
#include <stdint.h>
extern uint32_t stack_top, data_load, data_start, data_end, bss_start, bss_end;
void _start(void);
void SysTick_Handler(void);
void reset(void);
static void halt(void) { for (;;) {} }
void reset(void)
{
    uint32_t *from = &data_load, *to;
    *(volatile uint32_t *)0xE000ED88u |= 0xFu << 20; /* floating-point unit on */
    for (to = &data_start; to < &data_end;) { *to++ = *from++; }
    for (to = &bss_start; to < &bss_end;) { *to++ = 0; }
    _start();
}
__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    &stack_top, (void *)reset, (void *)halt, (void *)halt, (void *)halt, (void *)halt, (void *)halt, 0, 0, 0, 0,
    (void *)halt, (void *)halt, 0, (void *)halt, (void *)SysTick_Handler };
"""

LAYOUT = """
MEMORY { ROM (rx) : ORIGIN = 0x00000000, LENGTH = 4M  RAM (rw) : ORIGIN = 0x20000000, LENGTH = 4M }
ENTRY(reset)
SECTIONS {
  .text : { KEEP(*(.vectors)) *(.text*) *(.rodata*) KEEP(*(.init)) KEEP(*(.fini)) . = ALIGN(8); } > ROM
  .ARM.exidx : { *(.ARM.exidx*) } > ROM
  .init_array : { __preinit_array_start = .; KEEP(*(.preinit_array*)) __preinit_array_end = .;
    __init_array_start = .; KEEP(*(.init_array*)) __init_array_end = .;
    __fini_array_start = .; KEEP(*(.fini_array*)) __fini_array_end = .; } > ROM
  .data : ALIGN(8) { data_start = .; *(.data*) . = ALIGN(8); data_end = .; } > RAM AT> ROM
  data_load = LOADADDR(.data);
  .bss : ALIGN(8) { bss_start = .; __bss_start__ = .; *(.bss*) *(COMMON) . = ALIGN(8);
    bss_end = .; __bss_end__ = .; } > RAM
  end = .; __end__ = .;
  stack_top = ORIGIN(RAM) + LENGTH(RAM);
}
"""


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


@dataclass(frozen=True)
class Answers:
    """What the generated code gave for each pair."""

    status: list[str]
    instructions: Vector
    value: Vector
    iterations: Vector
    cost: Vector
    z: Vector
    stack: int
    workspace: int


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
                machine, target, control=control, objective="V", weights=weights, base_range=base_range
            )
        except UnreachableTarget:
            continue
        start = rng.uniform(problem.region.low, problem.region.high)
        if rng.random() < 0.5:
            k = rng.integers(problem.scan.size)
            start = np.concatenate([problem.scan.base[:, k], problem.scan.posture[:, k]])
        z, _, status = run_solver(problem, start)
        v, error = value_of(problem, z)
        pairs.append(Pair(problem, start, v if status == "Solve_Succeeded" and error < 1e-8 else -math.inf))
    return pairs


def case_numbers(pair: Pair, own_starts: bool) -> list[float]:
    """A pair as the driver reads it. Bounds of this size, also of angles, mean none to the generated code."""
    bounds = [bound.clip(-COORDINATE_MAX, COORDINATE_MAX) for bound in (pair.problem.lower, pair.problem.upper)]
    parts = [pair.problem.target, *bounds, pair.problem.objective.alpha, pair.start, [float(own_starts)]]
    return np.concatenate(parts).tolist()


def run(
    sources: OptimiserSources, pairs: list[Pair], *, own_starts: bool, target: str, real: str = "double"
) -> Answers:
    """Compile for "host" or "cortex-m7" and solve every pair there."""
    n_z, n_task = pairs[0].start.size, pairs[0].problem.target.size
    n_modes = len(pairs[0].problem.objective.alpha)
    cases = [case_numbers(pair, own_starts) for pair in pairs]
    with tempfile.TemporaryDirectory(prefix="flexopt-") as name:
        folder = Path(name)
        (folder / "optimiser.h").write_text(sources.header)
        includes = '#include <math.h>\n#include <stddef.h>\n#include <stdint.h>\n#include "optimiser.h"\n'
        (folder / "optimiser.c").write_text(includes + sources.source)
        (folder / "cases.bin").write_bytes(b"".join(struct.pack(f"<{len(c)}d", *c) for c in cases))
        (folder / "driver.c").write_text(DRIVER.replace("LOOPu", f"{LOOP}u"))
        sizes = {"N_Z": n_z, "N_TASK": n_task, "N_MODES": n_modes, "CASE_LENGTH": len(cases[0]), "REAL": real}
        sizes |= {"PAINTED": PAINTED}
        defines = [f"-D{key}={value}" for key, value in sizes.items()]
        if target == "host":
            command = ["gcc", "-O2", *WARNINGS, *defines, "optimiser.c", "driver.c", "-o", "program", "-lm"]
            launch = ["./program"]
        else:
            (folder / "startup.c").write_text(STARTUP)
            (folder / "layout.ld").write_text(LAYOUT)
            command = ["arm-none-eabi-gcc", "-O2", "-std=gnu99", "-Wall", "-Wextra", "-Werror", *CORTEX_M7, *defines]
            command += ["optimiser.c", "driver.c", "startup.c", "-specs=rdimon.specs", "-lm"]
            command += ["-T", "layout.ld", "-o", "program"]
            launch = ["qemu-system-arm", "-M", "mps2-an500", "-cpu", "cortex-m7", "-nographic", "-monitor", "none"]
            launch += ["-semihosting-config", "enable=on,target=native", "-icount", "shift=0", "-kernel", "program"]
        subprocess.run(command, cwd=folder, check=True)
        subprocess.run(launch, cwd=folder, check=True, stdin=subprocess.DEVNULL)
        numbers = np.frombuffer((folder / "answers.bin").read_bytes())
    loop_ticks, workspace = numbers[:2]
    rows = numbers[2:].reshape(len(pairs), 8 + n_z)
    names = {value: name for name, value in sources.statuses.items()}
    return Answers(
        status=[names[int(s)] for s in rows[:, 0]],
        instructions=rows[:, 1] * (2 * LOOP / loop_ticks),
        value=rows[:, 2],
        iterations=rows[:, 4],
        cost=rows[:, 5],
        stack=int(rows[:, 7].max()),
        z=rows[:, 8:],
        workspace=int(workspace),
    )


def summary(pairs: list[Pair], answers: Answers, real: Real = "double") -> tuple[str, ...]:
    """Same or better, infeasible successes, answered, converged, failures of IPOPT."""
    same_as, off, rounding = ALLOWED[real]
    same = infeasible = answered = failures = 0
    for pair, status, z in zip(pairs, answers.status, answers.z, strict=True):
        problem, plant = pair.problem, pair.problem.measures.plant
        failures += pair.ipopt == -math.inf
        if status not in FEASIBLE_STATUSES:
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
    return share, str(infeasible), f"{answered}", f"{sum(s == 'CONVERGED' for s in answers.status)}", f"{failures}"


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
    places: Sequence[str],
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
            sources = build_optimiser(machine, control=control, prefix="bench", real=real)
            if times > 1:
                budget = times * sources.budget
                sources = build_optimiser(machine, control=control, prefix="bench", real=real, budget=budget)
            word = "given and own" if own_starts else "given only"
            for place in places:
                answers = run(sources, pairs, own_starts=own_starts, target=place, real=real)
                quality.append((place, control, real, word, *summary(pairs, answers, real)))
                if place == "host":
                    continue
                # Without an answer there is no cost.
                told = answers.cost > 0
                unit = round(float((answers.instructions[told] / answers.cost[told]).max()))
                numbers = (*spread(answers.instructions), f"{BAR:,}", f"{unit:,}", *spread(answers.iterations))
                stack = f"{answers.stack:,}" if answers.stack < 4 * PAINTED else f"{4 * PAINTED:,} or more"
                effort.append((control, real, word, *numbers, stack, f"{answers.workspace:,}"))
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
        answers = run(build_optimiser(machine, prefix="bench"), pairs, own_starts=True, target="host")
        rows.append((name, *summary(pairs, answers), *spread(answers.iterations), *spread(answers.cost)))
    print(table(f"The same on the host for other machines, inverse control, given and own starts, {count} each", rows))


def places_of(target: str) -> list[str]:
    """Where to run; of both, those that there are tools for."""
    tools = {"host": ("gcc",), "cortex-m7": ("arm-none-eabi-gcc", "qemu-system-arm")}
    asked = list(tools) if target == "both" else [target]
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
