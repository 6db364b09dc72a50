/* Second derivatives: by differences of exact slopes now and then, and by what the steps between have shown. */
#ifndef OPTIMISER_DIFFERENCES_H
#define OPTIMISER_DIFFERENCES_H

#include "optimiser_plane.h"

#define COST_PROBE ((COST_MODEL - COST_SLOPE) / (NZ - NT))
#define REFRESH    5      /* steps between them: by then the learned Hessian is of another posture */
#define FLAT       R(3.0) /* curvature that a climb takes V to have before it has seen any: first steps of a third of a radian */

/* Slope of V/scale in x at a point whose evaluation was the last one. */
static bool slope_at(const problem_t *problem, workspace_t *s, const point_t *x, real_t scale, real_t *slope)
{
  const real_t *arg[ARG_slope] = {x->z, &x->z[N_B], parameters_of(problem), s->memory.held, problem->weights};
  real_t *res[RES_slope] = {slope};
  call_slope(arg, res, s->memory.work);
  for (int i = 0; i < NZ; i++) {
    slope[i] *= s->scales[i] / scale;
  }
  return all_finite(NZ, slope);
}

/* First derivatives at x, whose evaluation was the last one. */
static bool differentiate(const problem_t *problem, workspace_t *s, point_t *x)
{
  return (slope_at(problem, s, x, x->scale, s->memory.gradient)) && margin_slope(problem, x);
}

/* Slope of the Lagrangian from that of V, in place. */
static void with_constraints(const workspace_t *s, const point_t *x, real_t *slope)
{
  for (int i = 0; i < NZ; i++) {
    slope[i] += s->memory.pull[NT] * x->sine_squared_z[i] * s->scales[i];
    for (int k = 0; k < NT; k++) {
      slope[i] -= s->memory.pull[k] * x->jacobian[k + (NT * i)] * s->scales[i] / s->reach;
    }
  }
}

/* Hessian of the Lagrangian on the plane by differences of exact slopes; what lies outside counts as straight. */
static bool fresh_hessian(const problem_t *problem, workspace_t *s, const plane_t *at, const real_t *here)
{
  point_t *probe = &s->memory.trial;
  for (int i = 0; i < (NZ * NZ); i++) {
    s->hessian[i] = R(0.0);
  }
  for (int l = 0; l < at->d; l++) {
    real_t direction[NZ] = {R(0.0)};
    real_t there[NZ];
    real_t along[NZ];
    *probe = s->present;
    for (int j = 0; j < at->n; j++) {
      direction[at->free_[j]] = s->memory.basis[(j * NZ) + at->k + l];
    }
    for (int i = 0; i < NZ; i++) {
      probe->z[i] += PROBE * s->scales[i] * direction[i];
    }
    if (!locate(problem, probe) || !evaluate(problem, s, probe) ||
        !slope_at(problem, s, probe, s->present.scale, there) ||
        ((s->memory.pull[NT] > R(0.0)) && !margin_slope(problem, probe))) {
      return false;
    }
    with_constraints(s, probe, there);
    /* What the directions before have brought along this one must not count twice. */
    for (int i = 0; i < NZ; i++) {
      there[i] = (there[i] - here[i]) / PROBE;
      along[i] = there[i];
      for (int j = 0; j < NZ; j++) {
        along[i] -= s->hessian[i + (NZ * j)] * direction[j];
      }
    }
    {
      real_t both = R(0.0);
      for (int i = 0; i < NZ; i++) {
        both += direction[i] * along[i];
      }
      for (int i = 0; i < NZ; i++) {
        for (int j = 0; j < NZ; j++) {
          s->hessian[i + (NZ * j)] +=
              (along[i] * direction[j]) + (direction[i] * along[j]) - (both * direction[i] * direction[j]);
        }
      }
    }
  }
  return true;
}

/* The symmetric change of rank one that makes the Hessian see the last step as it was. */
static void learn(workspace_t *s, const real_t *here)
{
  real_t step[NZ];
  real_t missed[NZ];
  real_t along = R(0.0);
  real_t steps = R(0.0);
  real_t misses = R(0.0);
  for (int i = 0; i < NZ; i++) {
    step[i] = (s->present.z[i] - s->before.z[i]) / s->scales[i];
    missed[i] = s->gradient_before[i];
  }
  with_constraints(s, &s->before, missed);
  for (int i = 0; i < NZ; i++) {
    missed[i] = here[i] - missed[i];
    for (int j = 0; j < NZ; j++) {
      missed[i] -= s->hessian[i + (NZ * j)] * step[j];
    }
  }
  for (int i = 0; i < NZ; i++) {
    along += missed[i] * step[i];
    steps += step[i] * step[i];
    misses += missed[i] * missed[i];
  }
  if (fabs(along) > (R(1e-6) * sqrt(steps * misses))) {
    for (int i = 0; i < NZ; i++) {
      for (int j = 0; j < NZ; j++) {
        s->hessian[i + (NZ * j)] += missed[i] * missed[j] / along;
      }
    }
  }
}

/* Hessian of the Lagrangian times the basis of the plane, into s->memory.turn (n, d): by differences now and then, else by what
 * the steps between have shown. */
static bool curvatures(const problem_t *problem, const options_t *options, workspace_t *s, const plane_t *at)
{
  real_t here[NZ];
  for (int i = 0; i < NZ; i++) {
    here[i] = s->memory.gradient[i];
  }
  with_constraints(s, &s->present, here);
  if (s->age == UNKNOWN) {
    for (int i = 0; i < (NZ * NZ); i++) {
      s->hessian[i] = ((i % (NZ + 1)) == 0) ? -FLAT : R(0.0);
    }
    s->age = 1;
  } else if ((s->age == OUTDATED) || (s->age >= REFRESH)) {
    if (!may_spend(options, s, COST_PROBE * at->d) || !fresh_hessian(problem, s, at, here)) {
      return false;
    }
    s->age = 0;
  } else {
    learn(s, here);
  }
  s->age++;
  s->before = s->present;
  for (int i = 0; i < NZ; i++) {
    s->gradient_before[i] = s->memory.gradient[i];
  }
  times_basis(s, at);
  return true;
}

#endif /* OPTIMISER_DIFFERENCES_H */
