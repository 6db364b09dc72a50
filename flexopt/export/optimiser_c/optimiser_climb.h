/* One climb: steps of sequential quadratic programming from a feasible point to a local maximum. */
#ifndef OPTIMISER_CLIMB_H
#define OPTIMISER_CLIMB_H

#include "optimiser_plane.h"
#include SECOND_DERIVATIVES

/* s->memory.inverse: of the reduced Hessian, whose product with the basis is s->memory.turn, with its sign turned and its eigenvalues
 * made positive. Where V has positive curvature at a stationary point, a slope is added that leads away; returns whether
 * it was. */
static bool build_model(workspace_t *s, plane_t *at, bool stationary)
{
  bool kicked = false;
  const int d = at->d;
  for (int k = 0; k < d; k++) {
    for (int l = 0; l < d; l++) {
      real_t sum = R(0.0);
      for (int i = 0; i < at->n; i++) {
        sum += s->memory.basis[(i * NZ) + at->k + k] * s->memory.turn[(i * NZ) + l];
      }
      s->memory.reduced[(k * NZ) + l] = sum;
    }
  }
  diagonalise(s, d);
  for (int k = 0; k < d; k++) {
    const real_t curvature = s->memory.reduced[(k * NZ) + k];
    const real_t size = fabs(curvature);
    if ((curvature > CURVATURE) && stationary) {
      real_t along = R(0.0);
      for (int l = 0; l < d; l++) {
        along += s->memory.turn[(l * NZ) + k] * at->slope[l];
      }
      for (int l = 0; l < d; l++) {
        at->slope[l] += ((along < R(0.0)) ? -KICK : KICK) * size * s->memory.turn[(l * NZ) + k];
      }
      kicked = true;
    }
    s->memory.reduced[(k * NZ) + k] = (size > CURVATURE_MIN) ? size : CURVATURE_MIN;
  }
  for (int k = 0; k < d; k++) {
    for (int l = 0; l < d; l++) {
      real_t sum = R(0.0);
      for (int e = 0; e < d; e++) {
        sum += s->memory.turn[(k * NZ) + e] * s->memory.turn[(l * NZ) + e] / s->memory.reduced[(e * NZ) + e];
      }
      s->memory.inverse[(k * NZ) + l] = sum;
    }
  }
  return kicked;
}

/* Along y from s->present, back onto the target, until V is higher; s->gain: the rise of V/scale to first order. */
static bool search(const problem_t *problem, const options_t *options, workspace_t *s, const plane_t *at,
                  const real_t *y)
{
  real_t dx[NZ];
  real_t longest = R(0.0);
  real_t part;
  bool held[NZ];
  for (int i = 0; i < NZ; i++) {
    dx[i] = R(0.0);
    held[i] = true;
  }
  for (int j = 0; j < at->n; j++) {
    const int i = at->free_[j];
    held[i] = false;
    for (int l = 0; l < at->d; l++) {
      dx[i] += s->memory.basis[(j * NZ) + at->k + l] * y[l];
    }
    longest = (fabs(dx[i]) > longest) ? fabs(dx[i]) : longest;
  }
  part = (longest > STEP_MAX) ? (STEP_MAX / longest) : R(1.0);
  for (int halving = 0; halving < HALVINGS; halving++) {
    bool held_fast[NZ];
    bool on_margin = at->k > NT;
    real_t shorter = (halving < HALF_STEPS) ? R(0.5) : R(0.25);
    if (!may_spend(options, s, 1)) {
      return false;
    }
    for (int i = 0; i < NZ; i++) {
      s->memory.trial.z[i] = clamped(s->present.z[i] + (part * dx[i] * s->scales[i]), problem->lower[i], problem->upper[i]);
      held_fast[i] = held[i];
    }
    for (int r = 0; r < at->n_rows; r++) {
      /* A row that holds the step back stays active where it was, and becomes so after a whole step. */
      if ((s->memory.multipliers[r] > R(0.0)) && ((part >= R(1.0)) || at_limit(s, at, r))) {
        const int i = at->owner[r] / 2;
        if (at->owner[r] == (2 * NZ)) {
          on_margin = true;
        } else {
          s->memory.trial.z[i] = ((at->owner[r] % 2) == 0) ? problem->lower[i] : problem->upper[i];
          held_fast[i] = true;
        }
      }
    }
    /* The projection overwrites the basis; dx was taken from it before. */
    if (project(problem, s, &s->memory.trial, held_fast, on_margin) && evaluate(problem, s, &s->memory.trial)) {
      const real_t rise = s->memory.trial.value - s->present.value;
      if ((rise > R(0.0)) && (rise >= (RISE_SHARE * part * s->gain * s->present.scale))) {
        s->memory.trial.scale = s->present.scale; /* one climb, one scale */
        s->memory.trial.status = BUDGET_SPENT;
        s->present = s->memory.trial;
        return true;
      }
      if (s->gain > R(0.0)) {
        /* Where a parabola through both values has its top. */
        const real_t first = part * s->gain * s->present.scale;
        shorter = clamped(first / (R(2.0) * (first - rise)), R(0.1), R(0.5));
      }
    }
    part *= shorter;
  }
  return false;
}

/* Variables of the base that others make up for, as long as these are free, add nothing but a direction along which V
 * stays. */
static void hold_spare(const problem_t *problem, const workspace_t *s, bool *held_fast)
{
  static const bool spare[NZ] = SPARE;
  bool all_free = true;
  for (int i = 0; i < N_B; i++) {
    const real_t z = s->present.z[i];
    all_free = all_free && (spare[i] || ((z > problem->lower[i]) && (z < problem->upper[i])));
  }
  for (int i = 0; (i < N_B) && all_free; i++) {
    held_fast[i] = held_fast[i] || spare[i];
  }
}

/* One step from s->present; true where it moved, else s->present.status says why not. */
static bool step_up(const problem_t *problem, const options_t *options, workspace_t *s)
{
  plane_t at;
  bool held_fast[NZ];
  bool on_margin = false;
  bool stationary;
  bool enough;
  bool changed;
  real_t y[NZ];
  real_t square = R(0.0);
  for (int i = 0; i < NZ; i++) {
    held_fast[i] = problem->lower[i] >= problem->upper[i];
  }
  hold_spare(problem, s, held_fast);
  if (!differentiate(problem, s, &s->present) || !build_plane(problem, s, held_fast, false, &at)) {
    return false;
  }
  for (int k = 0; k < at.d; k++) {
    for (int l = 0; l < at.d; l++) {
      s->memory.inverse[(k * NZ) + l] = (k == l) ? R(1.0) : R(0.0);
    }
  }
  solve_program(s, at.d, at.n_rows, at.slope, y);
  for (int k = 0; k < at.d; k++) {
    square += y[k] * y[k];
  }
  s->present.stationarity = sqrt(square);
  s->steepness = s->present.stationarity;
  stationary = s->present.stationarity <= (s->rough ? ROUGH : options->tolerance);
  enough = (s->present.stationarity <= options->tolerance) || (s->present.stationarity <= STATIONARY_ENOUGH);
  s->present.status = enough ? CONVERGED : STALLED;
  /* Whether it is a maximum is asked where that costs nothing, and of the best point in the end. */
  if (stationary && (s->rough || (!s->last && (COST_MODEL > COST_SLOPE)))) {
    return false;
  }
  changed = hold_back(s, &at, held_fast, &on_margin);
  /* A second time where what was learned of the Hessian led nowhere. */
  for (int attempt = 0; attempt < 2; attempt++) {
    bool kicked;
    if (changed && !build_plane(problem, s, held_fast, on_margin, &at)) {
      return false;
    }
    changed = true;
    if ((at.d == 0) || !curvatures(problem, options, s, &at)) {
      return false;
    }
    kicked = build_model(s, &at, stationary);
    if (stationary && (!kicked || (s->age > 1))) {
      return false;
    }
    solve_program(s, at.d, at.n_rows, at.slope, y);
    s->gain = R(0.0);
    for (int k = 0; (k < at.d) && !kicked; k++) {
      s->gain += at.slope[k] * y[k];
    }
    if (search(problem, options, s, &at, y)) {
      return true;
    }
    if ((s->age <= 1) || (s->stop != CONVERGED)) {
      return false;
    }
    s->age = OUTDATED;
  }
  return false;
}

/* From s->present, feasible and evaluated, to a local maximum; only nearly so where another point is the best. Every
 * accepted point goes to note(). Returns whether it was given up where it promised less than the best point has. */
static bool climb(const problem_t *problem, const options_t *options, workspace_t *s)
{
  bool moved = true;
  bool given_up = false;
  real_t low = s->present.value;
  if (s->found && (s->best.scale > s->present.scale)) {
    s->present.scale = s->best.scale;
  }
  s->age = s->last ? OUTDATED : UNKNOWN;
  s->present.status = BUDGET_SPENT; /* until the next step says more */
  note(s, &s->present);
  for (int step = 0; (step < CLIMB_STEPS) && moved && may_spend(options, s, COST_SLOPE); step++) {
    const bool is_best = near(s, &s->present, &s->best, 0, R(0.0));
    if (!is_best && !s->paused && (s->cost > PAUSE)) {
      return given_up;
    }
    s->rough = !is_best && !s->thorough;
    s->iterations++;
    s->present.status = STALLED;
    moved = step_up(problem, options, s);
    if (moved) {
      note(s, &s->present);
      if (!s->last && (step >= PATIENCE)) {
        /* Not where another climb has been higher than this one is going to be, nor along a ridge. */
        given_up = !s->thorough && ((s->present.value + (PROMISE * s->gain * s->present.scale)) < s->best.value);
        if (((step % RIDGE_STEPS) == 0) && (s->steepness > RIDGE_SLOPE)) {
          given_up = given_up || (!s->thorough && ((s->present.value - low) <= (RIDGE_RISE * fabs(low))));
          low = s->present.value;
        }
        moved = !given_up;
      }
    } else if (is_best) {
      s->best.stationarity = s->present.stationarity;
      s->best.status = s->present.status;
    } else {
      /* the best point belongs to another climb */
    }
  }
  return given_up;
}

#endif /* OPTIMISER_CLIMB_H */
