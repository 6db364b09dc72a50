/* Starts where postures have a closed form: placements on a grid, or a surface of them. */
#ifndef OPTIMISER_CLOSED_FORM_H
#define OPTIMISER_CLOSED_FORM_H

#include "optimiser_starts.h"

/* Posture in closed form at a placement; false where there is none inside limits and margin. */
static bool place(const problem_t *problem, workspace_t *s, real_t base, const real_t *unit, real_t elbow,
                 point_t *x)
{
  const real_t *arg[ARG_posture] = {problem->target, x->z, unit, &elbow, parameters_of(problem)};
  real_t cosine = R(2.0);
  real_t *res[RES_posture] = {&x->z[N_B], &cosine};
  bool held_fast[NZ] = {0};
  x->z[0] = base;
  call_posture(arg, res);
  if (!(fabs(cosine) <= R(1.0)) || !all_finite(NZ, x->z)) {
    return false;
  }
  for (int i = N_B; i < NZ; i++) {
    /* The same posture, a whole turn away, where that brings it inside the limits. */
    const real_t turn = TWO_PI;
    if (fabs(problem->lower[i]) < UNBOUNDED) {
      const real_t up = x->z[i] + (turn * -floor((x->z[i] - problem->lower[i]) / turn));
      x->z[i] = (up <= problem->upper[i]) ? up : x->z[i];
    }
    if ((x->z[i] < problem->lower[i]) || (x->z[i] > problem->upper[i])) {
      return false;
    }
  }
  held_fast[0] = problem->lower[0] >= problem->upper[0];
  return project(problem, s, x, held_fast, 0);
}

/* One elbow (-1 up, +1 down) over placements from low to high. */
static void sample_branch(const problem_t *problem, const options_t *options, workspace_t *s, real_t low,
                          real_t high, int elbow)
{
#if UNITS > 0
  /* A surface of configurations: Kronecker's sequence on the generalised golden ratio. */
  static const real_t steps[UNITS + 1] = SAMPLE_STEPS;
  for (int j = 0; j < SAMPLES; j++) {
    real_t unit[UNITS];
    const real_t along = ((real_t)j + R(0.5)) * steps[0];
    const real_t base = low + ((high - low) * (along - floor(along)));
    for (int k = 0; k < UNITS; k++) {
      unit[k] = ((real_t)j + R(0.5)) * steps[k + 1];
      unit[k] -= floor(unit[k]);
    }
    if (!may_spend(options, s, 1)) {
      return;
    }
    if (place(problem, s, base, unit, (real_t)elbow, &s->present) &&
        evaluate(problem, s, &s->present)) {
      keep(s, options->starts, &s->present, 0);
    }
  }
#else
  /* A curve: its peaks on a grid, denser at the ends, where the arm straightens. */
  const int count = (high > low) ? SAMPLES : 1;
  bool last = false;   /* whether trial holds the neighbour before */
  bool rising = true; /* and V rose towards it */
  for (int j = 0; j < count; j++) {
    const real_t turn = PI * (((real_t)j + R(0.5)) / (real_t)count);
    const real_t base = clamped(((low + high) - ((high - low) * cos(turn))) / R(2.0), low, high);
    bool there;
    if (!may_spend(options, s, 1)) {
      return;
    }
    there =
        place(problem, s, base, NULL, (real_t)elbow, &s->present) && evaluate(problem, s, &s->present);
    if (last && rising && (!there || (s->present.value <= s->memory.trial.value))) {
      keep(s, options->starts, &s->memory.trial, 1);
    }
    rising = !there || !last || (s->present.value > s->memory.trial.value);
    last = there;
    s->memory.trial = s->present;
  }
  if (last && rising) {
    keep(s, options->starts, &s->memory.trial, 1);
  }
#endif
}

/* Placements from which the target is no farther than the arm is long; false where there is none within the bounds. */
static bool reachable(const problem_t *problem, const workspace_t *s, real_t *low, real_t *high)
{
  const real_t rise = problem->target[1] - s->first_joint[1];
  const real_t square = (s->reach * s->reach) - (rise * rise);
  const real_t far = (square > R(0.0)) ? sqrt(square) : R(0.0);
  const real_t middle = problem->target[0] - s->first_joint[0];
  *low = clamped(middle - far, problem->lower[0], problem->upper[0]);
  *high = clamped(middle + far, problem->lower[0], problem->upper[0]);
  return (square >= R(0.0)) && ((middle - far) <= *high) && ((middle + far) >= *low);
}

/* Look at the whole redundancy coarsely and keep the best starts. */
static void sample(const problem_t *problem, const options_t *options, workspace_t *s, int round)
{
  real_t low;
  real_t high;
  (void)round; /* there is one */
  if (reachable(problem, s, &low, &high)) {
    sample_branch(problem, options, s, low, high, -1);
    sample_branch(problem, options, s, low, high, 1);
  }
}

/* Where Newton's method found no way from the start onto the target: the nearest of a few postures in closed form goes
 * to s->present. */
static bool replace_start(const problem_t *problem, const real_t *start, const options_t *options,
                         workspace_t *s)
{
  real_t low;
  real_t high;
  real_t nearest = -R(1.0);
  if (!reachable(problem, s, &low, &high)) {
    return false;
  }
  for (int j = 0; j <= REPLACEMENTS; j++) {
    const real_t part = ((real_t)j - R(0.5)) / (real_t)REPLACEMENTS;
    const real_t base = (j == 0) ? clamped(start[0], low, high) : (low + ((high - low) * part));
    for (int elbow = -1; elbow <= 1; elbow += 2) {
      real_t unit[UNITS + 1]; /* one more, so that it is never empty */
      for (int k = 0; k <= UNITS; k++) {
        unit[k] = R(0.5);
      }
      if (!may_spend(options, s, 1)) {
        return false;
      }
      if (place(problem, s, base, unit, (real_t)elbow, &s->memory.trial)) {
        nearest = keep_nearer(s, start, nearest);
      }
    }
  }
  return nearest >= R(0.0);
}

#endif /* OPTIMISER_CLOSED_FORM_H */
