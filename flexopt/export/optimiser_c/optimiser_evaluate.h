/* What the optimiser asks of the machine: V, end-point, distance from singular postures, and what a call may cost. */
#ifndef OPTIMISER_EVALUATE_H
#define OPTIMISER_EVALUATE_H

#include "optimiser_constants.h"

static bool is_finite(real_t x) { return (x - x) == R(0.0); }

static bool all_finite(int n, const real_t *x)
{
  real_t nothing = R(0.0);
  for (int i = 0; i < n; i++) {
    nothing += x[i] - x[i];
  }
  return nothing == R(0.0);
}

static real_t clamped(real_t x, real_t low, real_t high) { return (x < low) ? low : ((x > high) ? high : x); }

/* Whether a variable is in rad, not in m. */
static bool is_angle(int i)
{
  static const bool angle[NZ] = ANGLES;
  return angle[i];
}

/* Whether the call may go on and cost so much more; says why not in s->stop. */
static bool may_spend(const options_t *options, workspace_t *s, int cost)
{
  if (s->stop != CONVERGED) {
    return false;
  }
  if ((s->cost + cost) > options->budget) {
    s->stop = BUDGET_SPENT;
    return false;
  }
  if ((options->expired != NULL) && (options->expired(options->context) != 0)) {
    s->stop = DEADLINE;
    return false;
  }
  s->cost += cost;
  return true;
}

static const real_t *parameters_of(const problem_t *problem)
{
#if PARAMETERS_AT_RUN_TIME
  return problem->parameters;
#else
  (void)problem;
  return NULL;
#endif
}

/* End-point and its Jacobian. */
static bool locate(const problem_t *problem, point_t *x)
{
  const real_t *arg[ARG_position] = {x->z, &x->z[N_B], parameters_of(problem)};
  real_t *res[RES_position] = {x->end_point, x->jacobian};
  call_position(arg, res);
  return all_finite(NT, x->end_point) && all_finite(NT * NZ, x->jacobian);
}

/* Distance from singular postures. */
static bool clear(const problem_t *problem, point_t *x)
{
  const real_t *arg[ARG_distance] = {x->z, &x->z[N_B], parameters_of(problem)};
  real_t *res[RES_distance] = {&x->sine_squared};
  call_distance(arg, res);
  return is_finite(x->sine_squared);
}

/* How that distance changes with z. */
static bool margin_slope(const problem_t *problem, point_t *x)
{
  const real_t *arg[ARG_margin] = {x->z, &x->z[N_B], parameters_of(problem)};
  real_t *res[RES_margin] = {x->sine_squared_z};
  call_margin(arg, res);
  return all_finite(NZ, x->sine_squared_z);
}

/* Iterations for eigenvectors begin at those of the point before; for the first one at the axes. */
static void forget(workspace_t *s)
{
#if WARM_STARTED
  for (int i = 0; i < (N_MODES * N_MODES); i++) {
    s->near[i] = ((i % (N_MODES + 1)) == 0) ? R(1.0) : R(0.0);
  }
#else
  (void)s;
#endif
}

/* V and its scale; false where they are no numbers. */
static bool evaluate(const problem_t *problem, workspace_t *s, point_t *x)
{
#if WARM_STARTED
  const real_t *at[ARG_hold] = {x->z, &x->z[N_B], parameters_of(problem), s->near};
  real_t *held[RES_hold] = {s->memory.held, s->memory.next};
#else
  const real_t *at[ARG_hold] = {x->z, &x->z[N_B], parameters_of(problem)};
  real_t *held[RES_hold] = {s->memory.held};
#endif
  const real_t *arg[ARG_value] = {x->z, &x->z[N_B], parameters_of(problem), s->memory.held, problem->weights};
  real_t *res[RES_value] = {&x->value, &x->scale};
  call_hold(at, held, s->memory.work);
#if WARM_STARTED
  for (int i = 0; i < (N_MODES * N_MODES); i++) {
    s->near[i] = s->memory.next[i];
  }
#endif
  call_value(arg, res, s->memory.work);
  x->stationarity = -R(1.0);
  return is_finite(x->value) && is_finite(x->scale) && (x->scale > R(0.0));
}

#endif /* OPTIMISER_EVALUATE_H */
