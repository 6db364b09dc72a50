/* The plane of a step: directions that leave the task as it is, what limits them, and the multipliers there. */
#ifndef OPTIMISER_PLANE_H
#define OPTIMISER_PLANE_H

#include "optimiser_project.h"

/* Directions that leave the task, held variables and perhaps the margin as they are, to first order. */
typedef struct {
  int free_[NZ];      /* variables that are not held */
  int n;              /* how many */
  int k;              /* rows of the task, and of the margin where it is held */
  int d;              /* directions: n - k */
  real_t slope[NZ]; /* of V along them */
  int owner[ROWS];    /* inequalities: 2 i lower, 2 i + 1 upper bound of variable i, 2 NZ margin */
  int n_rows;
} plane_t;

static void add_row(workspace_t *s, plane_t *at, int owner, real_t limit)
{
  s->memory.limits[at->n_rows] = (limit > R(0.0)) ? R(0.0) : limit;
  at->owner[at->n_rows] = owner;
  at->n_rows++;
}

/* Whether inequality r holds with equality, to rounding. */
static bool at_limit(const workspace_t *s, const plane_t *at, int r)
{
  return s->memory.limits[r] >= ((at->owner[r] == (2 * NZ)) ? -MARGIN_EDGE : -EDGE);
}

/* Null space into s->memory.basis (columns k to n - 1), rows and limits of the inequalities. false where the task loses rank. */
static bool build_plane(const problem_t *problem, workspace_t *s, const bool *held_fast, bool on_margin, plane_t *at)
{
  const point_t *x = &s->present;
  at->n = 0;
  at->k = NT + (on_margin ? 1 : 0);
  at->n_rows = 0;
  for (int i = 0; i < NZ; i++) {
    if (!held_fast[i]) {
      at->free_[at->n] = i;
      at->n++;
    }
  }
  at->d = at->n - at->k;
  if (at->d < 0) {
    return false;
  }
  for (int j = 0; j < at->n; j++) {
    const int i = at->free_[j];
    for (int k = 0; k < NT; k++) {
      s->memory.reflected[(k * NZ) + j] = x->jacobian[k + (NT * i)] * s->scales[i] / s->reach;
    }
    s->memory.reflected[(NT * NZ) + j] = x->sine_squared_z[i] * s->scales[i];
  }
  if (!factorise(s, at->k, at->n)) {
    return false;
  }
  for (int l = 0; l < at->d; l++) {
    at->slope[l] = R(0.0);
    for (int j = 0; j < at->n; j++) {
      at->slope[l] += s->memory.basis[(j * NZ) + at->k + l] * s->memory.gradient[at->free_[j]];
    }
  }
  for (int j = 0; j < at->n; j++) {
    const int i = at->free_[j];
    for (int side = 0; side < 2; side++) {
      const real_t bound = (side == 0) ? problem->lower[i] : problem->upper[i];
      const real_t sign = (side == 0) ? R(1.0) : -R(1.0);
      if (fabs(bound) < UNBOUNDED) {
        for (int l = 0; l < at->d; l++) {
          s->memory.rows[(at->n_rows * NZ) + l] = sign * s->memory.basis[(j * NZ) + at->k + l];
        }
        add_row(s, at, (2 * i) + side, sign * (bound - x->z[i]) / s->scales[i]);
      }
    }
  }
  if (!on_margin) {
    for (int l = 0; l < at->d; l++) {
      real_t sum = R(0.0);
      for (int j = 0; j < at->n; j++) {
        sum += x->sine_squared_z[at->free_[j]] * s->scales[at->free_[j]] * s->memory.basis[(j * NZ) + at->k + l];
      }
      s->memory.rows[(at->n_rows * NZ) + l] = sum;
    }
    add_row(s, at, 2 * NZ, problem->sine_squared_min - x->sine_squared);
  }
  return true;
}

/* Multipliers of the task and of the margin, by the projected gradient's program, into s->memory.pull; the variables and the
 * margin that it holds back go to held_fast and on_margin. Returns whether there are any. */
static bool hold_back(workspace_t *s, const plane_t *at, bool *held_fast, bool *on_margin)
{
  real_t pull[NZ];
  real_t *lambda = s->memory.pull;
  real_t mu = R(0.0);
  bool changed = false;
  for (int i = 0; i < NZ; i++) {
    pull[i] = s->memory.gradient[i];
  }
  for (int r = 0; r < at->n_rows; r++) {
    const int i = at->owner[r] / 2;
    const bool active = (s->memory.multipliers[r] > R(0.0)) && at_limit(s, at, r);
    if (at->owner[r] == (2 * NZ)) {
      mu = s->memory.multipliers[r];
      *on_margin = active;
      changed = changed || active;
    } else {
      pull[i] += ((at->owner[r] % 2) == 0) ? s->memory.multipliers[r] : -s->memory.multipliers[r];
      changed = changed || (active && !held_fast[i]);
      held_fast[i] = held_fast[i] || active;
    }
  }
  for (int i = 0; i < NZ; i++) {
    pull[i] += mu * s->present.sine_squared_z[i] * s->scales[i];
  }
  for (int k = NT - 1; k >= 0; k--) {
    lambda[k] = R(0.0);
    for (int j = 0; j < at->n; j++) {
      lambda[k] += s->memory.basis[(j * NZ) + k] * pull[at->free_[j]];
    }
    for (int l = k + 1; l < NT; l++) {
      lambda[k] -= s->memory.triangle[(k * (NT + 1)) + l] * lambda[l];
    }
    lambda[k] /= s->memory.triangle[(k * (NT + 1)) + k];
  }
  s->memory.pull[NT] = mu;
  return changed;
}

/* The Hessian times the basis of the plane, into s->memory.turn (n, d). */
static void times_basis(workspace_t *s, const plane_t *at)
{
  for (int l = 0; l < at->d; l++) {
    for (int i = 0; i < at->n; i++) {
      s->memory.turn[(i * NZ) + l] = R(0.0);
      for (int j = 0; j < at->n; j++) {
        s->memory.turn[(i * NZ) + l] += s->hessian[at->free_[i] + (NZ * at->free_[j])] * s->memory.basis[(j * NZ) + at->k + l];
      }
    }
  }
}

#endif /* OPTIMISER_PLANE_H */
