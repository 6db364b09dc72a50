/* The optimiser against optima that IPOPT found and flexopt verified, and its refusals. */
#ifndef {{ PREFIX }}_OPTIMISER_SELFTEST_H
#define {{ PREFIX }}_OPTIMISER_SELFTEST_H

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "{{ prefix }}_optimiser.h"

enum { OPTIMISER_CASES = {{ count }}, OPTIMISER_CASE_LENGTH = {{ length }} };

/* Which variables are angles, and so the same after a turn. */
static const int optimiser_turns[{{ PREFIX }}_OPTIMISER_N_Z] = { {{- turns | join(", ") -}} };

/* Rows: target, weights, start; V and its scale; whether that optimum is the only good one; z. */
static const {{ prefix }}_real optimiser_cases[OPTIMISER_CASES * OPTIMISER_CASE_LENGTH] = {{ listed(values, "") }};

static int optimiser_refuses(const char *what, const {{ prefix }}_optimiser_problem *problem, const {{ prefix }}_real *start,
                             const {{ prefix }}_optimiser_options *options, {{ prefix }}_optimiser_status wanted)
{
  static {{ prefix }}_optimiser_workspace memory;
  {{ prefix }}_optimiser_result answer, before;
  {{ prefix }}_optimiser_status status;
  memset(&answer, 0x5A, sizeof answer);
  memcpy(&before, &answer, sizeof before);
  status = {{ prefix }}_optimiser_solve(problem, start, options, &memory, &answer);
  if ((status != wanted) || (memcmp(&before, &answer, sizeof before) != 0)) {
    printf("FAILED  optimiser: %s gave status %d\n", what, (int)status);
    return 1;
  }
  return 0;
}

/* The result inside the workspace. */
static int optimiser_overlap(const {{ prefix }}_optimiser_options *options)
{
  static {{ prefix }}_optimiser_workspace memory;
  {{ prefix }}_optimiser_problem problem;
  void *inside = &memory;
  {{ prefix }}_optimiser_status status;
  (void){{ prefix }}_optimiser_default_problem(&problem);
  status = {{ prefix }}_optimiser_solve(&problem, NULL, options, &memory, ({{ prefix }}_optimiser_result *)inside);
  if (status != {{ PREFIX }}_OPTIMISER_BAD_WORKSPACE) {
    printf("FAILED  optimiser: a result inside the workspace gave status %d\n", (int)status);
    return 1;
  }
  return 0;
}

static int optimiser_failures(void)
{
  static {{ prefix }}_optimiser_workspace memory;
  {{ prefix }}_optimiser_problem problem;
  {{ prefix }}_optimiser_options options;
  const {{ prefix }}_real *row = optimiser_cases;
  {{ prefix }}_real start[{{ PREFIX }}_OPTIMISER_N_Z] = {0};
  double worst = -1e300, off = 0.0;
  int failed = 0, others = 0, k, i, turn;
  (void){{ prefix }}_optimiser_default_options(&options);
  for (k = 0; k < OPTIMISER_CASES; ++k) {
    {{ prefix }}_optimiser_result answer;
    {{ prefix }}_optimiser_status status = {{ PREFIX }}_OPTIMISER_CONVERGED;
    {{ prefix }}_real value, scale;
    double lost = 0.0;
    int bad = 0, other, unique, again;
    (void){{ prefix }}_optimiser_default_problem(&problem);
    memcpy(problem.target, row, sizeof problem.target);
    row += {{ PREFIX }}_OPTIMISER_N_TASK;
    memcpy(problem.weights, row, sizeof problem.weights);
    row += {{ PREFIX }}_OPTIMISER_N_MODES;
    memcpy(start, row, sizeof start);
    row += {{ PREFIX }}_OPTIMISER_N_Z;
    value = row[0];
    scale = row[1];
    unique = row[2] > 0;
    row += 3;
    /* A climb along an edge may cost more than the default budget: it has to come there with enough. */
    again = 1;
    for (turn = 0; (turn < 2) && again; ++turn) {
      options.budget = (turn == 0) ? {{ PREFIX }}_OPTIMISER_BUDGET : {{ PREFIX }}_OPTIMISER_BUDGET_MAX;
      memset(&answer, 0, sizeof answer);
      status = {{ prefix }}_optimiser_solve(&problem, start, &options, &memory, &answer);
      scale = (answer.scale > scale) ? answer.scale : scale;
      lost = ((double)value - (double)answer.value) / (double)scale;
      again = (status == {{ PREFIX }}_OPTIMISER_BUDGET_SPENT) && !(lost <= (double){{ loss }});
    }
    if (status >= {{ PREFIX }}_OPTIMISER_NULL_POINTER) {
      printf("FAILED  optimiser: problem %d gave status %d\n", k, (int)status);
      failed = 1;
    } else {
      /* Stationary, and lower by so little: another optimum, of which a local search may find either. */
      other = (status == {{ PREFIX }}_OPTIMISER_CONVERGED) && (lost > (double){{ loss }}) && (lost <= {{ clearly }});
      others += other;
      worst = ((lost > worst) && (other == 0)) ? lost : worst;
      off = ((double)answer.target_error > off) ? (double)answer.target_error : off;
      bad = (!(lost <= (double){{ loss }}) && (other == 0)) || !(answer.target_error <= {{ on_target }});
      /* One that is better than the best one known stands elsewhere. */
      unique = unique && !(lost < -(double){{ loss }}) && (other == 0);
      for (i = 0; {{ compare_z }} && unique && (i < {{ PREFIX }}_OPTIMISER_N_Z); ++i) {
        double away = (double)answer.z[i] - (double)row[i];
        if (optimiser_turns[i] != 0) {
          away -= 6.283185307179586 * floor((away / 6.283185307179586) + 0.5);
        }
        bad |= !(fabs(away) <= (double){{ z_tolerance }});
      }
      if (bad) {
        printf("FAILED  optimiser: problem %d: V lower by %.2g of its scale, %.2g m off the target\n", k, lost,
               (double)answer.target_error);
        failed = 1;
      }
    }
    row += {{ PREFIX }}_OPTIMISER_N_Z;
  }
  if ((2 * others) > OPTIMISER_CASES) {
    printf("FAILED  optimiser: %d of %d answers are other optima, lower than IPOPT's\n", others, OPTIMISER_CASES);
    failed = 1;
  } else if (others > 0) {
    printf("note    optimiser: %d of %d answers are other optima, lower by at most %.2g of V's scale\n", others,
           OPTIMISER_CASES, {{ clearly }});
  }
  options.budget = {{ PREFIX }}_OPTIMISER_BUDGET;
  failed |= optimiser_refuses("a NULL problem", NULL, start, &options, {{ PREFIX }}_OPTIMISER_NULL_POINTER);
  failed |= optimiser_refuses("NULL options", &problem, start, NULL, {{ PREFIX }}_OPTIMISER_NULL_POINTER);
  options.budget = 0;
  failed |= optimiser_refuses("no budget", &problem, start, &options, {{ PREFIX }}_OPTIMISER_OUT_OF_RANGE);
  (void){{ prefix }}_optimiser_default_options(&options);
  start[0] = ({{ prefix }}_real)INFINITY;
  failed |= optimiser_refuses("an infinite start", &problem, start, &options, {{ PREFIX }}_OPTIMISER_NOT_FINITE);
  start[0] = 0;
  problem.target[0] = {{ nan_target }};
  failed |= optimiser_refuses("a NaN target", &problem, start, &options, {{ PREFIX }}_OPTIMISER_NOT_FINITE);
#if {{ far_known }}
  problem.target[0] = 0;
  problem.target[{{ far_row }}] = {{ far }};
  options.budget = {{ PREFIX }}_OPTIMISER_BUDGET_MAX; /* enough to try every start */
  failed |= optimiser_refuses("a target out of reach", &problem, start, &options, {{ PREFIX }}_OPTIMISER_NO_FEASIBLE);
#endif
  failed |= optimiser_overlap(&options);
  printf("%s  %-20s %d problems, V lower than IPOPT's by %.2g of its scale at most, %.2g m off the target\n",
         failed ? "FAILED" : "passed", "optimiser", OPTIMISER_CASES, (worst > 0.0) ? worst : 0.0, off);
  return failed;
}

#endif
