/* Second derivatives: exact. */
#ifndef OPTIMISER_EXACT_H
#define OPTIMISER_EXACT_H

#include "optimiser_plane.h"

/* Derivatives at x, whose evaluation was the last one; in x and V/scale. */
static bool differentiate(const problem_t *problem, workspace_t *s, point_t *x)
{
  const real_t *arg[ARG_model] = {x->z, &x->z[N_B], parameters_of(problem), s->memory.held, problem->weights};
  real_t *res[RES_model] = {s->memory.gradient, s->hessian, s->memory.end_point_hessian, s->memory.sine_squared_hessian};
  call_model(arg, res, s->memory.work);
  for (int i = 0; i < NZ; i++) {
    s->memory.gradient[i] *= s->scales[i] / x->scale;
    for (int j = 0; j < NZ; j++) {
      const real_t both = s->scales[i] * s->scales[j];
      s->hessian[i + (NZ * j)] *= both / x->scale;
      s->memory.sine_squared_hessian[i + (NZ * j)] *= both;
      for (int k = 0; k < NT; k++) {
        s->memory.end_point_hessian[(NZ * NZ * k) + i + (NZ * j)] *= both / s->reach;
      }
    }
  }
  return margin_slope(problem, x) && all_finite(NZ, s->memory.gradient) && all_finite(NZ * NZ, s->hessian) &&
         all_finite(NT * NZ * NZ, s->memory.end_point_hessian) && all_finite(NZ * NZ, s->memory.sine_squared_hessian);
}

/* Hessian of the Lagrangian times the basis of the plane, into s->memory.turn (n, d). */
static bool curvatures(const problem_t *problem, const options_t *options, workspace_t *s, const plane_t *at)
{
  (void)problem;
  (void)options;
  for (int i = 0; i < (NZ * NZ); i++) {
    s->hessian[i] += s->memory.pull[NT] * s->memory.sine_squared_hessian[i];
    for (int k = 0; k < NT; k++) {
      s->hessian[i] -= s->memory.pull[k] * s->memory.end_point_hessian[(NZ * NZ * k) + i];
    }
  }
  s->age = 1;
  times_basis(s, at);
  return true;
}

#endif /* OPTIMISER_EXACT_H */
