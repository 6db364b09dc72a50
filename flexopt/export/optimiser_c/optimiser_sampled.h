/* Starts where postures have no closed form: points of the whole range, brought onto the target. */
#ifndef OPTIMISER_SAMPLED_H
#define OPTIMISER_SAMPLED_H

#include "optimiser_starts.h"

/* Row of the task along which variable i moves the machine, or -1. */
static int row_of(int i)
{
  static const int rows[NZ] = ROWS_OF;
  return rows[i];
}

/* Where variable i is looked for: its bounds; as far as the arm reaches where it moves the machine along a row of the
 * task; else a whole turn, or the arm's length either way, in place of a bound that is absent. */
static void range_of(const problem_t *problem, const workspace_t *s, int i, real_t *low, real_t *high)
{
  const int row = row_of(i);
  const real_t wide = is_angle(i) ? PI : s->reach;
  const bool open_low = problem->lower[i] <= -UNBOUNDED;
  const bool open_high = problem->upper[i] >= UNBOUNDED;
  *low = problem->lower[i];
  *high = problem->upper[i];
  if (row >= 0) {
    const real_t middle = problem->target[row] - s->first_joint[row];
    *low = clamped(middle - s->reach, problem->lower[i], problem->upper[i]);
    *high = clamped(middle + s->reach, problem->lower[i], problem->upper[i]);
  } else if (open_low && open_high) {
    *low = -wide;
    *high = wide;
  } else if (open_low) {
    *low = *high - (R(2.0) * wide);
  } else if (open_high) {
    *high = *low + (R(2.0) * wide);
  } else {
    /* both bounds are there */
  }
}

/* Point number j of Kronecker's sequence on the generalised golden ratio, brought onto the target. */
static bool draw(const problem_t *problem, workspace_t *s, int j, point_t *x)
{
  static const real_t steps[NZ] = SAMPLE_STEPS;
  bool held_fast[NZ];
  for (int i = 0; i < NZ; i++) {
    real_t low;
    real_t high;
    const real_t along = ((real_t)j + R(0.5)) * steps[i];
    range_of(problem, s, i, &low, &high);
    x->z[i] = clamped(low + ((high - low) * (along - floor(along))), problem->lower[i], problem->upper[i]);
    held_fast[i] = problem->lower[i] >= problem->upper[i];
  }
  return project(problem, s, x, held_fast, 0);
}

/* Look at the whole redundancy coarsely and keep the best starts. */
static void sample(const problem_t *problem, const options_t *options, workspace_t *s, int round)
{
  for (int j = round * SAMPLES; j < ((round + 1) * SAMPLES); j++) {
    if (!may_spend(options, s, 1)) {
      return;
    }
    if (draw(problem, s, j, &s->present) && evaluate(problem, s, &s->present)) {
      keep(s, options->starts, &s->present, 0);
    }
  }
}

/* Where Newton's method found no way from the start onto the target: the nearest of a few points of the sample that are
 * on it goes to s->present. */
static bool replace_start(const problem_t *problem, const real_t *start, const options_t *options,
                         workspace_t *s)
{
  real_t nearest = -R(1.0);
  for (int j = 0; j < REPLACEMENTS; j++) {
    if (!may_spend(options, s, 1)) {
      return false;
    }
    if (draw(problem, s, j, &s->memory.trial)) {
      nearest = keep_nearer(s, start, nearest);
    }
  }
  return nearest >= R(0.0);
}

#endif /* OPTIMISER_SAMPLED_H */
