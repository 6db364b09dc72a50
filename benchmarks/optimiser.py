"""The generated posture optimiser against IPOPT: answers, and instructions on an emulated Cortex-M7.

Run: python -m benchmarks.optimiser [--pairs N]

Each pair is a random target, a random objective (w_1 alone, or random weights), a random range of placements (or all),
and a random start: half of them any numbers within the bounds, half on the target. IPOPT solves from that start as
`flexopt.select` does from a peak. An answer counts as the same or better where V is not below IPOPT's by more than 1e-8
of the problem's scale. Instructions are counted by SysTick under `qemu -icount shift=0`, calibrated by a loop of known
length. Needs gcc; for the second half arm-none-eabi-gcc with newlib and qemu-system-arm; says what is missing.
"""

from __future__ import annotations

import argparse
import math
import shutil
import struct
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import flexopt
from benchmarks.timing import table
from flexopt.errors import FlexoptError
from flexopt.export.kernels import Real
from flexopt.export.optimiser import OptimiserSources, build_optimiser
from flexopt.model import Machine
from flexopt.model.arguments import Vector
from flexopt.model.problem import Control
from flexopt.model.quantities import COORDINATE_MAX
from flexopt.plant import build_plant
from flexopt.plant.reach import reach
from flexopt.selection.solve import _run_solver

SAME = 1e-8
# Share of the scale that V may lose against IPOPT; how far from the target still counts as on it, m; by how much inputs
# are rounded.
ALLOWED: dict[Real, tuple[float, float, float]] = {"double": (SAME, 1e-8, 0.0), "float": (1e-6, 5e-5, 1e-6)}
BAR = 5_000_000
FEASIBLE_STATUSES = ("CONVERGED", "BUDGET_SPENT", "DEADLINE", "STALLED")
WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror")
CORTEX_M7 = ("-mcpu=cortex-m7", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv5-d16")
LOOP = 1_000_000

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
#define PAINTED 8192
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
    w, _, r = problem.measures.w.call([z[:1], z[1:], problem.measures.plant.parameter_values])
    v = float(np.dot(problem.objective.alpha, w.full().ravel()))
    return v, float(np.abs(r.full().ravel() - problem.target).max())


def draw_pairs(machine: Machine, control: Control, count: int, seed: int) -> list[Pair]:
    """Random pairs, each with IPOPT's answer."""
    rng = np.random.default_rng(seed)
    plant = build_plant(machine)
    annulus = reach(plant)
    pairs: list[Pair] = []
    while len(pairs) < count:
        target = (rng.uniform(-1, 1), annulus.center[1] + annulus.outer * rng.uniform(-0.95, 0.95))
        first = [1.0] + [0.0] * (plant.n_passive - 1)
        weights = first if rng.random() < 0.5 else rng.uniform(0, 1, plant.n_passive).tolist()
        base_range = None
        if rng.random() < 0.5:
            intervals = annulus.base_intervals(np.array(target))
            middle = rng.uniform(*intervals[rng.integers(len(intervals))])
            half = annulus.outer * rng.uniform(0.05, 1)
            base_range = (middle - half, middle + half)
        try:
            problem = flexopt.build_selection(
                machine, target, control=control, objective="V", weights=weights, base_range=base_range
            )
        except FlexoptError:
            continue
        lower = np.concatenate([problem.lower[:1], np.maximum(problem.lower[1:], -math.pi)])
        upper = np.concatenate([problem.upper[:1], np.minimum(problem.upper[1:], math.pi)])
        start = rng.uniform(lower, upper)
        if rng.random() < 0.5:
            k = rng.integers(problem.scan.size)
            start = np.concatenate([problem.scan.base[:, k], problem.scan.posture[:, k]])
        z, _, status = _run_solver(problem, start)
        v, error = value_of(problem, z)
        pairs.append(Pair(problem, start, v if status == "Solve_Succeeded" and error < 1e-8 else -math.inf))
    return pairs


def case_numbers(pair: Pair, own_starts: bool) -> list[float]:
    """A pair as the driver reads it."""
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
        problem = pair.problem
        failures += pair.ipopt == -math.inf
        if status not in FEASIBLE_STATUSES:
            same += pair.ipopt == -math.inf
            continue
        answered += 1
        v, error = value_of(problem, z)
        sine = float(
            problem.measures.plant.singularity_sine_squared(z[:1], z[1:], problem.measures.plant.parameter_values)
        )
        inside = np.all(z >= problem.lower - rounding) and np.all(z <= problem.upper + rounding)
        infeasible += not (inside and error <= off and sine >= problem.constraints[-1].lower - off)
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


def machines() -> list[tuple[str, Machine]]:
    """Others than the excavator: a third joint, joint limits."""
    data = flexopt.load("excavator").to_dict()
    bucket = {"name": "bucket", "length": 0.6, "com": 0.3, "mass": 150.0, "inertia": 12.0, "limits": [-2.5, 2.5]}
    boom, stick = data["links"]
    limited = [boom | {"limits": [-0.5, 1.2]}, stick | {"limits": [-2.6, -0.4]}]
    return [
        ("with a bucket, 3 joints", flexopt.machine_from_dict(data | {"links": [boom, stick, bucket]})),
        ("with joint limits", flexopt.machine_from_dict(data | {"links": limited})),
    ]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=200)
    options = parser.parse_args()
    if missing_tools(("gcc",)):
        raise SystemExit("gcc is missing: nothing can be measured")
    absent = missing_tools(("arm-none-eabi-gcc", "qemu-system-arm"))
    places = ("host",) if absent else ("host", "cortex-m7")
    machine = flexopt.load("excavator")
    quality: list[tuple[str, ...]] = [
        ("where", "control", "real", "starts", "same or better", "infeasible", "answered", "converged", "IPOPT failed")
    ]
    effort: list[tuple[str, ...]] = [
        (
            *("control", "real", "starts", "instructions: median", "95 %", "worst", "bar", "worst a unit of budget"),
            *("steps: median", "95 %", "worst", "stack, bytes", "workspace, bytes"),
        )
    ]
    controls: tuple[Control, ...] = ("inverse", "transpose")
    runs: tuple[tuple[Real, bool, str], ...] = (
        ("double", True, "given and own"),
        ("double", False, "given only"),
        ("float", True, "given and own"),
    )
    for control in controls:
        pairs = draw_pairs(machine, control, options.pairs, seed=2026)
        for real, own_starts, word in runs:
            sources = build_optimiser(machine, control=control, prefix="bench", real=real)
            for place in places:
                answers = run(sources, pairs, own_starts=own_starts, target=place, real=real)
                quality.append((place, control, real, word, *summary(pairs, answers, real)))
            if not absent:
                unit = round(float((answers.instructions / answers.cost).max()))
                numbers = (*spread(answers.instructions), f"{BAR:,}", f"{unit:,}", *spread(answers.iterations))
                effort.append((control, real, word, *numbers, f"{answers.stack:,}", f"{answers.workspace:,}"))
    print(table(f"Answers against IPOPT, {options.pairs} random targets and starts each", quality))
    if absent:
        print(f"Not measured on Cortex-M7: {', '.join(absent)} missing")
    else:
        print(table("One call on an emulated Cortex-M7", effort))
    others: list[tuple[str, ...]] = [
        (
            *("machine", "same or better", "infeasible", "answered", "converged", "IPOPT failed", "steps: median"),
            *("95 %", "worst", "cost: median", "95 %", "worst"),
        )
    ]
    for name, other in machines():
        pairs = draw_pairs(other, "inverse", options.pairs // 2, seed=2027)
        answers = run(build_optimiser(other, prefix="bench"), pairs, own_starts=True, target="host")
        others.append((name, *summary(pairs, answers), *spread(answers.iterations), *spread(answers.cost)))
    print(table("The same on the host for other machines, inverse control, given and own starts", others))


if __name__ == "__main__":
    main()
