"""Thousands of calls with broken inputs under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

import subprocess

import numpy as np
import pytest

import flexopt
from flexopt.model import AnyMachine
from tests.export.optimiser_library import WARNINGS, c_text, sources_of
from tests.export.programs import GCC
from tests.oracles.machines import random_machine

pytestmark = GCC

SANITIZERS = ["-O0", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]

DRIVER = """
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <float.h>

static uint32_t state = 12345u;
static uint32_t pick(uint32_t below)
{
    state ^= state << 13;
    state ^= state >> 17;
    state ^= state << 5;
    return state % below;
}
static double uniform(double low, double high) { return low + (high - low) * (double)pick(1000001u) / 1000000.0; }

static double broken(double was)
{
    static const double zero = 0.0;
    switch (pick(12u)) {
    case 0: return zero / zero;
    case 1: return 1.0 / zero;
    case 2: return -1.0 / zero;
    case 3: return DBL_MAX;
    case 4: return -DBL_MAX;
    case 5: return DBL_MIN / 1024.0;
    case 6: return 0.0;
    case 7: return -was;
    case 8: return was * 1e6;
    case 9: return was * 1e-6;
    case 10: return 1e6;
    default: return uniform(-10.0, 10.0);
    }
}

static int countdown;
static int expired(void *context) { (void)context; return countdown-- <= 0; }

static int finite_result(const case_optimiser_result *r)
{
    int ok = r->value - r->value == 0.0 && r->scale > 0.0;
    for (int i = 0; i < CASE_OPTIMISER_N_Z; i++) { ok = ok && (r->z[i] - r->z[i] == 0.0); }
    return ok;
}

int main(void)
{
    long counts[32] = {0};
    unsigned char *bytes = malloc(CASE_OPTIMISER_WORKSPACE_SIZE + 64);
    for (int call = 0; call < CALLS; call++) {
        case_optimiser_problem problem;
        case_optimiser_options options;
        case_optimiser_result result, before;
        double start[CASE_OPTIMISER_N_Z];
        void *workspace = bytes;
        case_optimiser_status status;
        const int faults = (int)pick(4u);
        int null = -1;
        (void)case_optimiser_default_problem(&problem);
        (void)case_optimiser_default_options(&options);
        for (int k = 0; k < CASE_OPTIMISER_N_TASK; k++) { problem.target[k] = uniform(-SPAN, SPAN); }
        for (int i = 0; i < CASE_OPTIMISER_N_Z; i++) { start[i] = uniform(-4.0, 4.0); }
        options.budget = (int)pick(60u) + 1;
        options.starts = (int)pick(3u);
        countdown = (int)pick(60u);
        if (pick(4u) == 0u) { options.expired = expired; }
        if (pick(3u) == 0u) { problem.lower[0] = uniform(-3.0, 0.0); problem.upper[0] = uniform(0.0, 3.0); }
        for (int f = 0; f < faults; f++) {
            double *numbers = (double *)&problem;
            size_t at = pick((uint32_t)(sizeof problem / sizeof(double)));
            switch (pick(8u)) {
            case 0: null = (int)pick(5u); break;
            case 1: workspace = bytes + 1 + pick(7u); break;
            case 2: options.budget = (int)pick(2000u) - 1000; break;
            case 3: options.tolerance = broken(options.tolerance); break;
            case 4: at = pick(CASE_OPTIMISER_N_Z); start[at] = broken(start[at]); break;
            default: numbers[at] = broken(numbers[at]); break;
            }
        }
        options.budget = options.budget > 60 ? 60 : options.budget;
        memset(&result, 0xA5, sizeof result);
        memcpy(&before, &result, sizeof result);
        status = case_optimiser_solve(null == 0 ? NULL : &problem, null == 1 ? NULL : start, null == 2 ? NULL : &options,
                                      null == 3 ? NULL : (case_optimiser_workspace *)workspace,
                                      null == 4 ? NULL : &result);
        if ((int)status < 0 || (int)status > 31) { puts("unknown status"); return 1; }
        counts[(int)status]++;
        if ((int)status >= 16) {
            if (memcmp(&before, &result, sizeof result) != 0) { puts("result changed by a failure"); return 1; }
        } else {
            double size = 10.0;
            if (!finite_result(&result)) { puts("success that is not finite"); return 1; }
            for (int i = 0; i < CASE_OPTIMISER_N_Z; i++) {
                size += result.z[i] < 0 ? -result.z[i] : result.z[i];
                if (result.z[i] < problem.lower[i] || result.z[i] > problem.upper[i]) {
                    puts("success outside the bounds");
                    return 1;
                }
            }
            for (int k = 0; k < CASE_OPTIMISER_N_TASK; k++) {
                size += problem.target[k] < 0 ? -problem.target[k] : problem.target[k];
            }
            for (int k = 0; k < (int)(sizeof lengths / sizeof lengths[0]); k++) {
                size += problem.parameters[lengths[k]] < 0 ? -problem.parameters[lengths[k]] : problem.parameters[lengths[k]];
            }
            if (!(result.target_error <= 1e-12 * size)) {
                printf("success off the target by %g\\n", result.target_error);
                return 1;
            }
        }
    }
    for (int s = 0; s < 32; s++) { printf("%ld ", counts[s]); }
    free(bytes);
    return 0;
}
"""


def fuzzed(machine: AnyMachine, folder, calls: int, span: float = 3.0) -> list[int]:
    """How often each status came; fails where the program did. Targets are drawn from a box of half the width `span`."""
    in_m = [str(k) for k, parameter in enumerate(machine.parameters) if parameter.unit == "m"]
    lengths = f"static const int lengths[] = {{{', '.join(in_m)}}};\n"
    (folder / "fuzz.c").write_text(f"{c_text(sources_of(machine), 'double')}{lengths}{DRIVER}")
    flags = [flag for flag in WARNINGS if flag not in {"-Wconversion", "-Wshadow"}]
    build = ["gcc", *flags, *SANITIZERS, f"-DCALLS={calls}", f"-DSPAN={span!r}", "fuzz.c", "-o", "fuzz", "-lm"]
    done = subprocess.run(build, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[:3000]
    run = subprocess.run(["./fuzz"], cwd=folder, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout[-1000:] + run.stderr[:3000]
    return [int(word) for word in run.stdout.split()]


@pytest.mark.long
def test_excavator(tmp_path):
    counts = fuzzed(flexopt.load("excavator"), tmp_path, 10_000)
    statuses = sources_of(flexopt.load("excavator")).statuses
    never = {name for name, value in statuses.items() if counts[value] == 0}
    assert never <= {"STALLED"}, "a fuzzer that does not reach every status proves little"


@pytest.mark.long
def test_a_random_machine(tmp_path):
    machine = random_machine(np.random.default_rng(5))[1]
    assert sum(fuzzed(machine, tmp_path, 2_000)) == 2_000


@pytest.mark.long
@pytest.mark.parametrize(("name", "span"), [("truck-crane", 6.0)])
def test_machines_in_space(name: str, span: float, tmp_path):
    machine = flexopt.load(name)
    counts = fuzzed(machine, tmp_path, 1_000, span)
    statuses = sources_of(machine).statuses
    assert sum(counts) == 1_000
    for status in (
        "CONVERGED",
        "BUDGET_SPENT",
        "DEADLINE",
        "NULL_POINTER",
        "NOT_FINITE",
        "OUT_OF_RANGE",
        "ENDED_EARLY",
    ):
        assert counts[statuses[status]] > 0, status
