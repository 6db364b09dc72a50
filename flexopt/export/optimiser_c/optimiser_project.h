/* The way back onto the target, inside bounds and margin. */
#ifndef OPTIMISER_PROJECT_H
#define OPTIMISER_PROJECT_H

#include "optimiser_algebra.h"

/* The largest number that enters the position, in x: what its rounding is relative to. */
static real_t size_of(const problem_t *problem, const workspace_t *s, const point_t *x)
{
  real_t size = R(1.0);
  for (int k = 0; k < NT; k++) {
    const real_t part = fabs(problem->target[k]) / s->reach;
    size = (part > size) ? part : size;
  }
  for (int i = 0; i < NZ; i++) {
    const real_t part = fabs(x->z[i]) / s->scales[i];
    size = (part > size) ? part : size;
  }
  return size;
}

/* Whole turns off angles without limits. */
static void unwind(const problem_t *problem, point_t *x)
{
  for (int i = 0; i < NZ; i++) {
    if (is_angle(i) && (fabs(problem->lower[i]) >= UNBOUNDED) && (fabs(problem->upper[i]) >= UNBOUNDED)) {
      x->z[i] -= TWO_PI * floor((x->z[i] / TWO_PI) + R(0.5));
    }
  }
}

/* Newton's method of least steps onto r(z) = target inside bounds and margin. Variables in held_fast stay where they are;
 * with start_on_margin the margin holds with equality. */
static bool project(const problem_t *problem, workspace_t *s, point_t *x, const bool *held_fast, bool start_on_margin)
{
  bool on_margin = start_on_margin;
  int settled = 0;
  for (int step = 0; step < (PROJECTION_STEPS + SETTLING); step++) {
    real_t miss[NT + 1];
    real_t dx[NZ];
    real_t longest = R(0.0);
    int free_[NZ];
    bool blocked[NZ];
    real_t error = R(0.0);
    bool again = true;
    s->newtons++;
    if ((s->newtons >= PROJECTIONS) && (s->cost < s->budget)) {
      s->newtons = 0;
      s->cost++;
    }
    if (!locate(problem, x)) {
      return false;
    }
    for (int k = 0; k < NT; k++) {
      miss[k] = (problem->target[k] - x->end_point[k]) / s->reach;
      error = (fabs(miss[k]) > error) ? fabs(miss[k]) : error;
    }
    if ((error <= (EDGE * size_of(problem, s, x))) || on_margin) {
      if (!clear(problem, x)) {
        return false;
      }
      miss[NT] = problem->sine_squared_min - x->sine_squared;
    }
    if (error <= (EDGE * size_of(problem, s, x))) {
      if ((miss[NT] <= MARGIN_EDGE) && (!on_margin || (miss[NT] >= -MARGIN_EDGE))) {
        if ((settled >= SETTLING) || (error <= (FINE * size_of(problem, s, x)))) {
          return true;
        }
        settled++;
      } else {
        on_margin = true;
      }
    }
    if (on_margin && !margin_slope(problem, x)) {
      return false;
    }
    for (int i = 0; i < NZ; i++) {
      blocked[i] = held_fast[i];
    }
    for (int pass = 0; (pass <= NZ) && again; pass++) {
      const int k_rows = NT + (on_margin ? 1 : 0);
      int n = 0;
      again = false;
      for (int i = 0; i < NZ; i++) {
        dx[i] = R(0.0);
        if (!blocked[i]) {
          free_[n] = i;
          n++;
        }
      }
      if (n < k_rows) {
        return false;
      }
      for (int j = 0; j < n; j++) {
        const int i = free_[j];
        for (int k = 0; k < NT; k++) {
          s->memory.reflected[(k * NZ) + j] = x->jacobian[k + (NT * i)] * s->scales[i] / s->reach;
        }
        s->memory.reflected[(NT * NZ) + j] = (on_margin) ? (x->sine_squared_z[i] * s->scales[i]) : R(0.0);
      }
      {
        real_t u[NT + 1];
        for (int k = 0; k < k_rows; k++) {
          u[k] = miss[k];
          for (int l = 0; l <= k; l++) {
            real_t dot = R(0.0);
            for (int j = 0; j < n; j++) {
              dot += s->memory.reflected[(k * NZ) + j] * s->memory.reflected[(l * NZ) + j];
            }
            s->memory.schur[(k * NZ) + l] = dot;
          }
        }
        if (!solve_schur(s, k_rows, u)) {
          return false;
        }
        for (int j = 0; j < n; j++) {
          for (int k = 0; k < k_rows; k++) {
            dx[free_[j]] += s->memory.reflected[(k * NZ) + j] * u[k];
          }
        }
      }
      for (int i = 0; i < NZ; i++) {
        const bool out = ((x->z[i] <= problem->lower[i]) && (dx[i] < R(0.0))) ||
                        ((x->z[i] >= problem->upper[i]) && (dx[i] > R(0.0)));
        if (!blocked[i] && out) {
          blocked[i] = true;
          again = true;
        }
      }
    }
    if (again) {
      return false;
    }
    for (int i = 0; i < NZ; i++) {
      longest = (fabs(dx[i]) > longest) ? fabs(dx[i]) : longest;
    }
    for (int i = 0; i < NZ; i++) {
      const real_t part = (longest > STEP_MAX) ? (STEP_MAX / longest) : R(1.0);
      x->z[i] = clamped(x->z[i] + (part * dx[i] * s->scales[i]), problem->lower[i], problem->upper[i]);
    }
  }
  return false;
}

/* Whether variables from number `from` on differ by no more than the distance, in x. */
static bool near(const workspace_t *s, const point_t *a, const point_t *b, int from, real_t distance)
{
  bool close = true;
  for (int i = from; i < NZ; i++) {
    close = close && (fabs(a->z[i] - b->z[i]) <= (distance * s->scales[i]));
  }
  return close;
}

static void note(workspace_t *s, const point_t *x)
{
  if (!s->found || (x->value > s->best.value)) {
    s->best = *x;
    s->found = true;
  }
}

#endif /* OPTIMISER_PROJECT_H */
