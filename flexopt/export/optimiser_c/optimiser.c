/* Configuration optimiser: sequential quadratic programming along the set r(z) = target.
 *
 * Each step: the Hessian of the Lagrangian on the null space of the task, its eigenvalues turned positive; a small
 * quadratic program with bounds and margin by active sets; Newton's method back onto the target; a line search that accepts
 * only a higher V. Internally x = z / scales and V / scale, so that every number below is of order one. */
#include "optimiser_climb.h"
#include STARTS_FROM

/* Where the arm begins and how long it is. */
static bool prepare(const problem_t *problem, workspace_t *s)
{
  const real_t *arg[ARG_reach] = {parameters_of(problem)};
  real_t *res[RES_reach] = {s->first_joint, &s->reach};
  call_reach(arg, res);
  return all_finite(NT, s->first_joint) && is_finite(s->reach) && (s->reach > R(0.0));
}

/* How far target row k is from where the first joint can lie in it, m: from `middle`, shifted within the bounds. */
static real_t apart(const problem_t *problem, int k, real_t middle)
{
  static const int shifted_by[NT] = SHIFTED_BY;
  const int i = shifted_by[k];
  real_t low = middle;
  real_t high = middle;
  real_t away = R(0.0);
  if (i >= 0) {
    low = (problem->lower[i] <= -UNBOUNDED) ? problem->target[k] : (middle + problem->lower[i]);
    high = (problem->upper[i] >= UNBOUNDED) ? problem->target[k] : (middle + problem->upper[i]);
  }
  if (problem->target[k] < low) {
    away = low - problem->target[k] - (EDGE * (fabs(problem->target[k]) + fabs(low)));
  } else if (problem->target[k] > high) {
    away = problem->target[k] - high - (EDGE * (fabs(problem->target[k]) + fabs(high)));
  } else {
    /* inside */
  }
  return (away > R(0.0)) ? away : R(0.0);
}

/* Whether the target may be within reach: it is no farther from where the bounds let the arm begin than the arm is long.
 * Placements shift the machine along its rows and turn it about the origin from which they shift it; a placement that may
 * turn counts as one that turns any way. */
static bool within_reach(const problem_t *problem, const workspace_t *s)
{
  static const bool placed[NT] = PLACED_ROWS;
  real_t middle[NT];
  real_t around = R(0.0);
  real_t turned = R(0.0);
  real_t others = R(0.0);
  for (int k = 0; k < NT; k++) {
    middle[k] = s->first_joint[k];
  }
#if TURNED_BY >= 0
  {
    const real_t x = middle[TURNED_X];
    const real_t y = middle[TURNED_Y];
    const bool held = problem->lower[TURNED_BY] >= problem->upper[TURNED_BY];
    const real_t along = held ? cos(problem->lower[TURNED_BY]) : R(0.0);
    const real_t across = held ? sin(problem->lower[TURNED_BY]) : R(0.0);
    middle[TURNED_X] = (along * x) - (across * y);
    middle[TURNED_Y] = (across * x) + (along * y);
    around = held ? R(0.0) : sqrt((x * x) + (y * y));
  }
#endif
  for (int k = 0; k < NT; k++) {
    const real_t away = placed[k] ? apart(problem, k, middle[k]) : R(0.0);
    if ((k == TURNED_X) || (k == TURNED_Y)) {
      turned += away * away;
    } else {
      others += away * away;
    }
  }
  turned = sqrt(turned) - around;
  turned = (turned > R(0.0)) ? turned : R(0.0);
  return sqrt((turned * turned) + others) <= (R(1.001) * s->reach);
}

static bool in_range(const problem_t *problem, const options_t *options)
{
  bool ok = (options->budget >= 1) && (options->budget <= BUDGET_MAX) && (options->starts >= 0) &&
           (options->starts <= STARTS_MAX) && (options->tolerance > R(0.0)) && (options->tolerance < R(1.0)) &&
           (problem->sine_squared_min > R(0.0)) && (problem->sine_squared_min < R(1.0));
  real_t sum = R(0.0);
  for (int i = 0; i < NZ; i++) {
    ok = ok && (problem->lower[i] <= problem->upper[i]) && (fabs(problem->lower[i]) <= UNBOUNDED) &&
         (fabs(problem->upper[i]) <= UNBOUNDED);
  }
  for (int k = 0; k < NT; k++) {
    ok = ok && (fabs(problem->target[k]) <= UNBOUNDED);
  }
#if PARAMETERS_AT_RUN_TIME
  {
    static const real_t low[N_PARAMETERS] = PARAMETERS_LOW;
    static const real_t high[N_PARAMETERS] = PARAMETERS_HIGH;
    for (int i = 0; i < N_PARAMETERS; i++) {
      ok = ok && (problem->parameters[i] >= low[i]) && (problem->parameters[i] <= high[i]);
    }
  }
#endif
  for (int i = 0; i < N_MODES; i++) {
    ok = ok && (problem->weights[i] >= R(0.0)) && (problem->weights[i] <= R(1e6));
    sum += problem->weights[i];
  }
  return ok && (sum > R(0.0));
}

static bool inputs_finite(const problem_t *problem, const real_t *start, const options_t *options)
{
  bool ok = all_finite(NT, problem->target) && all_finite(NZ, problem->lower) && all_finite(NZ, problem->upper) &&
           all_finite(N_MODES, problem->weights) && is_finite(problem->sine_squared_min) &&
           is_finite(options->tolerance);
#if PARAMETERS_AT_RUN_TIME
  ok = ok && all_finite(N_PARAMETERS, problem->parameters);
#endif
  return ok && ((start == NULL) || all_finite(NZ, start));
}

static void climb_from_start(const problem_t *problem, const real_t *start, const options_t *options,
                             workspace_t *s)
{
  bool held_fast[NZ];
  bool ready = true;
  for (int i = 0; i < NZ; i++) {
    ready = ready && (fabs(start[i]) <= UNBOUNDED);
    s->present.z[i] = clamped(start[i], problem->lower[i], problem->upper[i]);
    held_fast[i] = problem->lower[i] >= problem->upper[i];
  }
  unwind(problem, &s->present);
  if (may_spend(options, s, 1)) {
    ready = ready && project(problem, s, &s->present, held_fast, 0);
    ready = ready || replace_start(problem, start, options, s);
    if (ready && evaluate(problem, s, &s->present)) {
      s->climbed = 1;
      s->first = s->present;
      (void)climb(problem, options, s);
    }
  }
}

/* Whether V may still rise by more than a tie: with weights >= 0 and two task rows or more it is never above 0. */
static bool could_rise(const workspace_t *s)
{
  return !s->found || (NT < 2) || (s->best.value < (-TIE * s->best.scale));
}

/* The best point's climb goes on where it was left, or, in the end, may have ended at a saddle. */
static void finish(const problem_t *problem, const options_t *options, workspace_t *s, bool check)
{
  bool unfinished = true;
  if (!s->found || (s->stop != CONVERGED) || ((s->best.status == CONVERGED) && !check)) {
    return;
  }
  s->last = true;
  /* A climb that ends after its number of steps is not at its end: it goes on while there is budget. */
  for (int k = 0; (k < LAST_CLIMBS) && unfinished; k++) {
    s->present = s->best;
    unfinished = may_spend(options, s, 1) && evaluate(problem, s, &s->present);
    if (unfinished) {
      (void)climb(problem, options, s);
      unfinished = (s->stop == CONVERGED) && (s->best.status == BUDGET_SPENT);
    }
  }
  s->last = false;
}

/* A climb from a sample; among equals what was there before wins. */
static void climb_from_sample(const problem_t *problem, int k, const options_t *options, workspace_t *s)
{
  const bool had = s->found;
  const point_t before = s->best;
  s->present = s->starts[k];
  s->given_up[k] = false;
  if (may_spend(options, s, 1) && evaluate(problem, s, &s->present)) {
    s->climbed += s->thorough ? 0 : 1;
    s->given_up[k] = climb(problem, options, s);
    if (had && (s->best.value <= (before.value + (TIE * before.scale)))) {
      s->best = before;
    }
  }
}

/* Samples and climbs from the best of them, in rounds, each with starts closer together than the one before. */
static void climb_from_samples(const problem_t *problem, const options_t *options, workspace_t *s)
{
  s->apart = APART;
  for (int round = 0; (round < ROUNDS) && (s->stop == CONVERGED) && could_rise(s); round++) {
    sample(problem, options, s, round);
    for (int k = s->n_tried; (k < s->n_starts) && (s->stop == CONVERGED) && could_rise(s); k++) {
      if (!s->paused && (s->cost > PAUSE)) {
        s->paused = true;
        finish(problem, options, s, 0);
      }
      s->n_tried = k + 1;
      climb_from_sample(problem, k, options, s);
    }
    s->apart *= R(0.5);
  }
}

/* What was given up promised less than the best point has, which is an estimate: with what is left of the budget it is
 * climbed to its end. The best point is a local maximum by then, so that a call that ends meanwhile has converged. */
static void climb_again(const problem_t *problem, const options_t *options, workspace_t *s)
{
  if (!s->found || (s->stop != CONVERGED) || (s->best.status != CONVERGED)) {
    return;
  }
  s->thorough = true;
  for (int k = 0; (k < s->n_tried) && (s->stop == CONVERGED) && could_rise(s); k++) {
    if (s->given_up[k]) {
      climb_from_sample(problem, k, options, s);
    }
  }
  s->thorough = false;
  finish(problem, options, s, false);
  if (s->best.status == CONVERGED) {
    s->stop = CONVERGED;
  }
}

/* Number of the first variable by which starts are told apart: where the base is free, only postures are, as to turn or
 * shift machine and target together changes no measure. */
static int first_that_tells(const problem_t *problem)
{
  bool all_free = BASE_IDLE;
  for (int i = 0; i < N_B; i++) {
    all_free = all_free && (problem->lower[i] <= -UNBOUNDED) && (problem->upper[i] >= UNBOUNDED);
  }
  return all_free ? N_B : 0;
}

status_t default_problem(problem_t *problem)
{
  static const real_t lower[NZ] = LOWER;
  static const real_t upper[NZ] = UPPER;
#if PARAMETERS_AT_RUN_TIME
  static const real_t parameters[N_PARAMETERS] = PARAMETERS;
#endif
  if (problem == NULL) {
    return NULL_POINTER;
  }
  for (int k = 0; k < NT; k++) {
    problem->target[k] = R(0.0);
  }
  for (int i = 0; i < NZ; i++) {
    problem->lower[i] = lower[i];
    problem->upper[i] = upper[i];
  }
  problem->sine_squared_min = SINE_SQUARED_MIN;
  for (int i = 0; i < N_MODES; i++) {
    problem->weights[i] = R(1.0);
  }
#if PARAMETERS_AT_RUN_TIME
  for (int i = 0; i < N_PARAMETERS; i++) {
    problem->parameters[i] = parameters[i];
  }
#endif
  return CONVERGED;
}

status_t default_options(options_t *options)
{
  if (options == NULL) {
    return NULL_POINTER;
  }
  options->budget = BUDGET;
  options->starts = STARTS_MAX;
  options->tolerance = TOLERANCE;
  options->expired = NULL;
  options->context = NULL;
  return CONVERGED;
}

static bool aligned(const void *pointer)
{
  struct probe {
    char byte;
    workspace_t inner;
  };
  return ((uintptr_t)pointer % offsetof(struct probe, inner)) == 0U;
}

/* Whether an argument lies over the workspace, which is written while it is still read. */
static bool overlaps(const void *workspace, const void *other, size_t size)
{
  const uintptr_t begin = (uintptr_t)workspace;
  const uintptr_t from = (uintptr_t)other;
  return (other != NULL) && (from < (begin + sizeof(workspace_t))) && (begin < (from + size));
}

/* Nothing leaves unless the equations, evaluated once more, say that it is feasible. */
static bool confirm(const problem_t *problem, workspace_t *s, result_t *found)
{
  point_t *x = &s->best;
  unwind(problem, x);
  if (!locate(problem, x) || !clear(problem, x)) {
    return false;
  }
  found->target_error = R(0.0);
  found->bound_violation = R(0.0);
  for (int k = 0; k < NT; k++) {
    const real_t error = fabs(x->end_point[k] - problem->target[k]);
    found->target_error = (error > found->target_error) ? error : found->target_error;
  }
  for (int i = 0; i < NZ; i++) {
    const real_t below = problem->lower[i] - x->z[i];
    const real_t above = x->z[i] - problem->upper[i];
    found->bound_violation = (below > found->bound_violation) ? below : found->bound_violation;
    found->bound_violation = (above > found->bound_violation) ? above : found->bound_violation;
    found->z[i] = x->z[i];
  }
  found->margin_slack = x->sine_squared - problem->sine_squared_min;
  found->value = x->value;
  found->scale = x->scale;
  found->stationarity = x->stationarity;
  found->cost = s->cost;
  found->iterations = s->iterations;
  found->starts = s->climbed;
  return (found->target_error <= (TARGET_TOLERANCE * s->reach * size_of(problem, s, x))) &&
         (found->bound_violation <= R(0.0)) && (found->margin_slack >= -MARGIN_TOLERANCE);
}

status_t solve(const problem_t *problem, const real_t *start, const options_t *options,
                         workspace_t *workspace, result_t *result)
{
  workspace_t *s = workspace;
  result_t found;
  if ((problem == NULL) || (options == NULL) || (workspace == NULL) || (result == NULL)) {
    return NULL_POINTER;
  }
  if (!aligned(workspace) || overlaps(workspace, problem, sizeof(*problem)) ||
      overlaps(workspace, start, sizeof(real_t) * NZ) || overlaps(workspace, options, sizeof(*options)) ||
      overlaps(workspace, result, sizeof(*result))) {
    return BAD_WORKSPACE;
  }
  if (!inputs_finite(problem, start, options)) {
    return NOT_FINITE;
  }
  if (!in_range(problem, options)) {
    return OUT_OF_RANGE;
  }
  s->cost = 0;
  s->budget = options->budget;
  s->newtons = 0;
  s->iterations = 0;
  s->n_starts = 0;
  s->n_tried = 0;
  s->climbed = 0;
  s->stop = CONVERGED;
  s->found = false;
  s->last = false;
  s->paused = false;
  s->thorough = false;
  if (!prepare(problem, s)) {
    return OUT_OF_RANGE;
  }
  for (int i = 0; i < NZ; i++) {
    s->scales[i] = is_angle(i) ? R(1.0) : s->reach;
  }
  s->from = first_that_tells(problem);
  if (!within_reach(problem, s)) {
    return NO_FEASIBLE;
  }
  forget(s);
  if (start != NULL) {
    climb_from_start(problem, start, options, s);
  }
  if ((options->starts > 0) && (s->stop == CONVERGED) && could_rise(s)) {
    climb_from_samples(problem, options, s);
  }
  s->paused = true;
  finish(problem, options, s, COST_MODEL > COST_SLOPE);
  climb_again(problem, options, s);
  if (!s->found) {
    return (s->stop != CONVERGED) ? ENDED_EARLY : NO_FEASIBLE;
  }
  if (!confirm(problem, s, &found)) {
    return NO_FEASIBLE;
  }
  *result = found;
  return (s->stop != CONVERGED) ? s->stop : s->best.status;
}
