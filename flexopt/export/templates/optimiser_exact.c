/* Derivatives at x, whose evaluation was the last one; in x and V/scale. */
static int differentiate(const @p@_problem *problem, workspace_t *s, point *x)
{
  const @real@ *arg[@ARG_model@] = {x->z, &x->z[@N_B@], parameters_of(problem), s->held, weights_of(problem)};
  @real@ *res[@RES_model@] = {s->gradient, s->hessian, s->end_point_hessian, s->sine_squared_hessian};
  (void)KERNEL_model(arg, res);
  for (int i = 0; i < NZ; i++) {
    s->gradient[i] *= s->scales[i] / x->scale;
    for (int j = 0; j < NZ; j++) {
      const @real@ both = s->scales[i] * s->scales[j];
      s->hessian[i + (NZ * j)] *= both / x->scale;
      s->sine_squared_hessian[i + (NZ * j)] *= both;
      for (int k = 0; k < NT; k++) {
        s->end_point_hessian[(NZ * NZ * k) + i + (NZ * j)] *= both / s->reach;
      }
    }
  }
  return margin_slope(problem, x) && all_finite(NZ, s->gradient) && all_finite(NZ * NZ, s->hessian) &&
         all_finite(NT * NZ * NZ, s->end_point_hessian) && all_finite(NZ * NZ, s->sine_squared_hessian);
}

/* Hessian of the Lagrangian times the basis of the plane, into s->turn (n, d). */
static int curvatures(const @p@_problem *problem, const @p@_options *options, workspace_t *s, const plane *at)
{
  (void)problem;
  (void)options;
  for (int i = 0; i < (NZ * NZ); i++) {
    s->hessian[i] += s->pull[NT] * s->sine_squared_hessian[i];
    for (int k = 0; k < NT; k++) {
      s->hessian[i] -= s->pull[k] * s->end_point_hessian[(NZ * NZ * k) + i];
    }
  }
  s->age = 1;
  times_basis(s, at);
  return 1;
}
