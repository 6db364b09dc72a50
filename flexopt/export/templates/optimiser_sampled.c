#define SAMPLES @SAMPLES@

/* Row of the task along which variable i moves the machine, or -1. */
static int row_of(int i)
{
  static const int rows[NZ] = {@ROWS_OF@};
  return rows[i];
}

/* Where variable i is looked for: its bounds; as far as the arm reaches where it moves the machine along a row of the
 * task; else a whole turn, or the arm's length either way, in place of a bound that is absent. */
static void range_of(const @p@_problem *problem, const workspace_t *s, int i, @real@ *low, @real@ *high)
{
  const int row = row_of(i);
  const @real@ wide = (is_angle(i) != 0) ? @PI@ : s->reach;
  const int open_low = (problem->lower[i] <= -@P@_UNBOUNDED) ? 1 : 0;
  const int open_high = (problem->upper[i] >= @P@_UNBOUNDED) ? 1 : 0;
  *low = problem->lower[i];
  *high = problem->upper[i];
  if (row >= 0) {
    const @real@ middle = problem->target[row] - s->first_joint[row];
    *low = clamped(middle - s->reach, problem->lower[i], problem->upper[i]);
    *high = clamped(middle + s->reach, problem->lower[i], problem->upper[i]);
  } else if ((open_low != 0) && (open_high != 0)) {
    *low = -wide;
    *high = wide;
  } else if (open_low != 0) {
    *low = *high - (R(2.0) * wide);
  } else if (open_high != 0) {
    *high = *low + (R(2.0) * wide);
  } else {
    /* both bounds are there */
  }
}

/* Point number j of Kronecker's sequence on the generalised golden ratio, brought onto the target. */
static int draw(const @p@_problem *problem, workspace_t *s, int j, point *x)
{
  static const @real@ steps[NZ] = {@STEPS@};
  int held_fast[NZ];
  for (int i = 0; i < NZ; i++) {
    @real@ low;
    @real@ high;
    const @real@ along = ((@real@)j + R(0.5)) * steps[i];
    range_of(problem, s, i, &low, &high);
    x->z[i] = clamped(low + ((high - low) * (along - floor(along))), problem->lower[i], problem->upper[i]);
    held_fast[i] = (problem->lower[i] >= problem->upper[i]) ? 1 : 0;
  }
  return project(problem, s, x, held_fast, 0);
}

/* Look at the whole redundancy coarsely and keep the best starts. */
static void sample(const @p@_problem *problem, const @p@_options *options, workspace_t *s, int round)
{
  for (int j = round * SAMPLES; j < ((round + 1) * SAMPLES); j++) {
    if (may_spend(options, s, 1) == 0) {
      return;
    }
    if ((draw(problem, s, j, &s->present) != 0) && (evaluate(problem, s, &s->present) != 0)) {
      keep(s, options->starts, &s->present, 0);
    }
  }
}

/* Where Newton's method found no way from the start onto the target: the nearest of a few points of the sample that are
 * on it goes to s->present. */
static int replace_start(const @p@_problem *problem, const @real@ *start, const @p@_options *options,
                         workspace_t *s)
{
  @real@ nearest = -R(1.0);
  for (int j = 0; j < REPLACEMENTS; j++) {
    if (may_spend(options, s, 1) == 0) {
      return 0;
    }
    if (draw(problem, s, j, &s->trial) != 0) {
      nearest = keep_nearer(s, start, nearest);
    }
  }
  return (nearest >= R(0.0)) ? 1 : 0;
}
