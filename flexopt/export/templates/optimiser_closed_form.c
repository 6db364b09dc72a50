#define UNITS   @UNITS@
#define SAMPLES @SAMPLES@ /* of each elbow */

/* Posture in closed form at a placement; 0 where there is none inside limits and margin. */
static int place(const @p@_problem *problem, workspace_t *s, @real@ base, const @real@ *unit, @real@ elbow,
                 point *x)
{
  const @real@ *arg[@ARG_posture@] = {problem->target, x->z, unit, &elbow, parameters_of(problem)};
  @real@ cosine = R(2.0);
  @real@ *res[@RES_posture@] = {&x->z[@N_B@], &cosine};
  int held_fast[NZ] = {0};
  x->z[0] = base;
  (void)KERNEL_posture(arg, res);
  if (!(fabs(cosine) <= R(1.0)) || (all_finite(NZ, x->z) == 0)) {
    return 0;
  }
  for (int i = @N_B@; i < NZ; i++) {
    /* The same posture, a whole turn away, where that brings it inside the limits. */
    const @real@ turn = @TWO_PI@;
    if (fabs(problem->lower[i]) < @P@_UNBOUNDED) {
      const @real@ up = x->z[i] + (turn * -floor((x->z[i] - problem->lower[i]) / turn));
      x->z[i] = (up <= problem->upper[i]) ? up : x->z[i];
    }
    if ((x->z[i] < problem->lower[i]) || (x->z[i] > problem->upper[i])) {
      return 0;
    }
  }
  held_fast[0] = (problem->lower[0] >= problem->upper[0]) ? 1 : 0;
  return project(problem, s, x, held_fast, 0);
}

/* One elbow (-1 up, +1 down) over placements from low to high. */
static void sample_branch(const @p@_problem *problem, const @p@_options *options, workspace_t *s, @real@ low,
                          @real@ high, int elbow)
{
#if UNITS > 0
  /* A surface of configurations: Kronecker's sequence on the generalised golden ratio. */
  static const @real@ steps[UNITS + 1] = {@STEPS@};
  for (int j = 0; j < SAMPLES; j++) {
    @real@ unit[UNITS];
    const @real@ along = ((@real@)j + R(0.5)) * steps[0];
    const @real@ base = low + ((high - low) * (along - floor(along)));
    for (int k = 0; k < UNITS; k++) {
      unit[k] = ((@real@)j + R(0.5)) * steps[k + 1];
      unit[k] -= floor(unit[k]);
    }
    if (may_spend(options, s, 1) == 0) {
      return;
    }
    if ((place(problem, s, base, unit, (@real@)elbow, &s->present) != 0) &&
        (evaluate(problem, s, &s->present) != 0)) {
      keep(s, options->starts, &s->present, 0);
    }
  }
#else
  /* A curve: its peaks on a grid, denser at the ends, where the arm straightens. */
  const int count = (high > low) ? SAMPLES : 1;
  int last = 0;   /* whether trial holds the neighbour before */
  int rising = 1; /* and V rose towards it */
  for (int j = 0; j < count; j++) {
    const @real@ turn = @PI@ * (((@real@)j + R(0.5)) / (@real@)count);
    const @real@ base = clamped(((low + high) - ((high - low) * cos(turn))) / R(2.0), low, high);
    int there;
    if (may_spend(options, s, 1) == 0) {
      return;
    }
    there =
        (place(problem, s, base, NULL, (@real@)elbow, &s->present) != 0) && (evaluate(problem, s, &s->present) != 0);
    if ((last != 0) && (rising != 0) && ((there == 0) || (s->present.value <= s->trial.value))) {
      keep(s, options->starts, &s->trial, 1);
    }
    rising = (there == 0) || (last == 0) || (s->present.value > s->trial.value);
    last = there;
    s->trial = s->present;
  }
  if ((last != 0) && (rising != 0)) {
    keep(s, options->starts, &s->trial, 1);
  }
#endif
}

/* Placements from which the target is no farther than the arm is long; 0 where there is none within the bounds. */
static int reachable(const @p@_problem *problem, const workspace_t *s, @real@ *low, @real@ *high)
{
  const @real@ rise = problem->target[1] - s->first_joint[1];
  const @real@ square = (s->reach * s->reach) - (rise * rise);
  const @real@ far = (square > R(0.0)) ? sqrt(square) : R(0.0);
  const @real@ middle = problem->target[0] - s->first_joint[0];
  *low = clamped(middle - far, problem->lower[0], problem->upper[0]);
  *high = clamped(middle + far, problem->lower[0], problem->upper[0]);
  return (square >= R(0.0)) && ((middle - far) <= *high) && ((middle + far) >= *low);
}

/* Look at the whole redundancy coarsely and keep the best starts. */
static void sample(const @p@_problem *problem, const @p@_options *options, workspace_t *s, int round)
{
  @real@ low;
  @real@ high;
  (void)round; /* there is one */
  if (reachable(problem, s, &low, &high) != 0) {
    sample_branch(problem, options, s, low, high, -1);
    sample_branch(problem, options, s, low, high, 1);
  }
}

/* Where Newton's method found no way from the start onto the target: the nearest of a few postures in closed form goes
 * to s->present. */
static int replace_start(const @p@_problem *problem, const @real@ *start, const @p@_options *options,
                         workspace_t *s)
{
  @real@ low;
  @real@ high;
  @real@ nearest = -R(1.0);
  if (reachable(problem, s, &low, &high) == 0) {
    return 0;
  }
  for (int j = 0; j <= REPLACEMENTS; j++) {
    const @real@ part = ((@real@)j - R(0.5)) / (@real@)REPLACEMENTS;
    const @real@ base = (j == 0) ? clamped(start[0], low, high) : (low + ((high - low) * part));
    for (int elbow = -1; elbow <= 1; elbow += 2) {
      @real@ unit[UNITS + 1]; /* one more, so that it is never empty */
      for (int k = 0; k <= UNITS; k++) {
        unit[k] = R(0.5);
      }
      if (may_spend(options, s, 1) == 0) {
        return 0;
      }
      if (place(problem, s, base, unit, (@real@)elbow, &s->trial) != 0) {
        nearest = keep_nearer(s, start, nearest);
      }
    }
  }
  return (nearest >= R(0.0)) ? 1 : 0;
}
