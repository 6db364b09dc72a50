{% set driver = "optimiser_driver" %}
/* Replays calls of the optimiser from a file, on a workstation or on a microcontroller with semihosting:
 * optimiser_driver INPUTS OUTPUTS.
 *
 * INPUTS: for each call four 32-bit words (faults to make, budget, own starts, evaluations until expired() says so or 0)
 * and reals: the tolerance, the problem, the start. OUTPUTS: two words, ticks of a known number of instructions and bytes of
 * the workspace; for each call six words (status, ticks, whether the result is as before, cost, iterations, bytes of
 * stack) and the result's reals. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "{{ prefix }}_optimiser.h"

{% include "export/templates/driver_clock.c" %}

enum { NULL_PROBLEM = 1, NULL_START = 2, NULL_OPTIONS = 4, NULL_WORKSPACE = 8, NULL_RESULT = 16, MISALIGNED = 32 };
enum { N_PROBLEM = sizeof({{ prefix }}_optimiser_problem) / sizeof({{ prefix }}_real), N_REALS = {{ PREFIX }}_OPTIMISER_N_Z + 6 };

static union {
  {{ prefix }}_optimiser_workspace inner;
  unsigned char bytes[sizeof({{ prefix }}_optimiser_workspace) + 1U];
} memory;
static uint32_t left;

static int expired(void *context)
{
  (void)context;
  left -= (left > 0U) ? 1U : 0U;
  return left == 0U;
}

int main(int argc, char **argv)
{
  FILE *source, *sink;
  uint32_t call[4], head[2];
  {{ prefix }}_real numbers[1 + N_PROBLEM + {{ PREFIX }}_OPTIMISER_N_Z];
{% include "export/templates/driver_files.c" %}
  head[0] = target_calibrate();
  head[1] = (uint32_t){{ PREFIX }}_OPTIMISER_WORKSPACE_SIZE;
  fwrite(head, sizeof head, 1, sink);
  while (fread(call, sizeof call, 1, source) == 1) {
    {{ prefix }}_optimiser_problem problem;
    {{ prefix }}_optimiser_options options;
    {{ prefix }}_optimiser_result result, before;
    {{ prefix }}_optimiser_workspace *workspace = &memory.inner;
    {{ prefix }}_real reals[N_REALS];
    uint32_t answer[6], began;
    if (fread(numbers, sizeof numbers, 1, source) != 1) {
      fputs("optimiser_driver: the input file is too short\n", stderr);
      return 2;
    }
    (void){{ prefix }}_optimiser_default_options(&options);
    options.budget = (int)(int32_t)call[1];
    options.starts = (int)(int32_t)call[2];
    options.tolerance = numbers[0];
    left = call[3];
    if (left > 0U) {
      options.expired = expired;
    }
    memcpy(&problem, &numbers[1], sizeof problem);
    memset(&result, 0x5A, sizeof result);
    memcpy(&before, &result, sizeof before);
    if (call[0] & NULL_WORKSPACE) {
      workspace = NULL;
    } else if (call[0] & MISALIGNED) {
      void *moved = &memory.bytes[1];
      workspace = ({{ prefix }}_optimiser_workspace *)moved;
    }
    target_paint_stack();
    began = target_ticks();
    answer[0] = (uint32_t){{ prefix }}_optimiser_solve(
        (call[0] & NULL_PROBLEM) ? NULL : &problem, (call[0] & NULL_START) ? NULL : &numbers[1 + N_PROBLEM],
        (call[0] & NULL_OPTIONS) ? NULL : &options, workspace, (call[0] & NULL_RESULT) ? NULL : &result);
    answer[1] = (target_ticks() - began) & 0xFFFFFFU; /* the counter has 24 bits */
    answer[5] = target_stack_used();
    answer[2] = memcmp(&before, &result, sizeof before) == 0;
    answer[3] = (uint32_t)result.cost;
    answer[4] = (uint32_t)result.iterations;
    memcpy(reals, result.z, sizeof result.z);
    reals[{{ PREFIX }}_OPTIMISER_N_Z] = result.value;
    reals[{{ PREFIX }}_OPTIMISER_N_Z + 1] = result.scale;
    reals[{{ PREFIX }}_OPTIMISER_N_Z + 2] = result.target_error;
    reals[{{ PREFIX }}_OPTIMISER_N_Z + 3] = result.bound_violation;
    reals[{{ PREFIX }}_OPTIMISER_N_Z + 4] = result.margin_slack;
    reals[{{ PREFIX }}_OPTIMISER_N_Z + 5] = result.stationarity;
    fwrite(answer, sizeof answer, 1, sink);
    fwrite(reals, sizeof reals, 1, sink);
  }
  fclose(source);
  return fclose(sink) == 0 ? EXIT_SUCCESS : EXIT_FAILURE;
}
