#define PROBE      @PROBE@ /* step of the differences, in x */
#define COST_PROBE ((COST_MODEL - COST_SLOPE) / (NZ - NT))
#define REFRESH    5           /* steps between them */
#define FLAT       R(3.0)      /* curvature that a climb takes V to have before it has seen any */

/* Slope of V/scale in x at a point whose evaluation was the last one. */
static int slope_at(const @p@_problem *problem, workspace_t *s, const point *x, @real@ scale, @real@ *slope)
{
  const @real@ *arg[@ARG_slope@] = {x->z, &x->z[@N_B@], parameters_of(problem), s->held, weights_of(problem)};
  @real@ *res[@RES_slope@] = {slope};
  (void)KERNEL_slope(arg, res);
  for (int i = 0; i < NZ; i++) {
    slope[i] *= s->scales[i] / scale;
  }
  return all_finite(NZ, slope);
}

/* First derivatives at x, whose evaluation was the last one. */
static int differentiate(const @p@_problem *problem, workspace_t *s, point *x)
{
  return (slope_at(problem, s, x, x->scale, s->gradient) != 0) && (margin_slope(problem, x) != 0);
}

/* Slope of the Lagrangian from that of V, in place. */
static void with_constraints(const workspace_t *s, const point *x, @real@ *slope)
{
  for (int i = 0; i < NZ; i++) {
    slope[i] += s->pull[NT] * x->sine_squared_z[i] * s->scales[i];
    for (int k = 0; k < NT; k++) {
      slope[i] -= s->pull[k] * x->jacobian[k + (NT * i)] * s->scales[i] / s->reach;
    }
  }
}

/* Hessian of the Lagrangian on the plane by differences of exact slopes; what lies outside counts as straight. */
static int fresh_hessian(const @p@_problem *problem, workspace_t *s, const plane *at, const @real@ *here)
{
  point *probe = &s->trial;
  for (int i = 0; i < (NZ * NZ); i++) {
    s->hessian[i] = R(0.0);
  }
  for (int l = 0; l < at->d; l++) {
    @real@ direction[NZ] = {R(0.0)};
    @real@ there[NZ];
    @real@ along[NZ];
    *probe = s->present;
    for (int j = 0; j < at->n; j++) {
      direction[at->free_[j]] = s->basis[(j * NZ) + at->k + l];
    }
    for (int i = 0; i < NZ; i++) {
      probe->z[i] += PROBE * s->scales[i] * direction[i];
    }
    if ((locate(problem, probe) == 0) || (evaluate(problem, s, probe) == 0) ||
        (slope_at(problem, s, probe, s->present.scale, there) == 0) ||
        ((s->pull[NT] > R(0.0)) && (margin_slope(problem, probe) == 0))) {
      return 0;
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
      @real@ both = R(0.0);
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
  return 1;
}

/* The symmetric change of rank one that makes the Hessian see the last step as it was. */
static void learn(workspace_t *s, const @real@ *here)
{
  @real@ step[NZ];
  @real@ missed[NZ];
  @real@ along = R(0.0);
  @real@ steps = R(0.0);
  @real@ misses = R(0.0);
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

/* Hessian of the Lagrangian times the basis of the plane, into s->turn (n, d): by differences now and then, else by what
 * the steps between have shown. */
static int curvatures(const @p@_problem *problem, const @p@_options *options, workspace_t *s, const plane *at)
{
  @real@ here[NZ];
  for (int i = 0; i < NZ; i++) {
    here[i] = s->gradient[i];
  }
  with_constraints(s, &s->present, here);
  if (s->age == UNKNOWN) {
    for (int i = 0; i < (NZ * NZ); i++) {
      s->hessian[i] = ((i % (NZ + 1)) == 0) ? -FLAT : R(0.0);
    }
    s->age = 1;
  } else if ((s->age == OUTDATED) || (s->age >= REFRESH)) {
    if ((may_spend(options, s, COST_PROBE * at->d) == 0) || (fresh_hessian(problem, s, at, here) == 0)) {
      return 0;
    }
    s->age = 0;
  } else {
    learn(s, here);
  }
  s->age++;
  s->before = s->present;
  for (int i = 0; i < NZ; i++) {
    s->gradient_before[i] = s->gradient[i];
  }
  times_basis(s, at);
  return 1;
}
