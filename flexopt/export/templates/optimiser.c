/* ---- Configuration optimiser: sequential quadratic programming along the set r(z) = target ------------------------
 *
 * Each step: exact Hessian of the Lagrangian on the null space of the task, its eigenvalues turned positive; a small
 * quadratic program with bounds and margin by active sets; Newton's method back onto the target; a line search that
 * accepts only a higher V. Internally x = z / scales and V / scale, so that every number below is of order one. */

#define NZ                @P@_N_Z
#define NT                @P@_N_TASK
#define ROWS              @P@_ROWS
#define EPSILON           @EPSILON@
#define UNITS             @UNITS@
#define SAMPLES           @SAMPLES@    /* of each elbow */
#define COST_MODEL        @COST_MODEL@ /* of the model, in evaluations of V */
#define PROJECTION_STEPS  15
#define HALVINGS          10
#define SWEEPS            8
#define CLIMB_STEPS       60
#define REPLACEMENTS      6                     /* placements tried where the start cannot be brought onto the target */
#define STEP_MAX          R(0.5)                /* longest step in x */
#define KICK              R(0.05)               /* step away from a saddle */
#define CURVATURE         R(1e-6)               /* positive curvature of V above it is none of rounding */
#define CURVATURE_MIN     R(1e-7)               /* smallest curvature of the model */
#define STATIONARY_ENOUGH @STATIONARY_ENOUGH@ /* where rounding ends a climb, this is still a stationary point */
#define TIE               @TIE@               /* values of V/scale that count as equal */
#define EDGE              (R(32.0) * EPSILON)   /* rounding of positions, relative to the reach */
#define APART             R(0.3)                /* starts closer than this are one */

typedef @p@_point point;
typedef @p@_workspace workspace_t;

static int is_finite(@real@ x) { return (x - x) == R(0.0); }

static int all_finite(int n, const @real@ *x)
{
  int ok = 1;
  for (int i = 0; i < n; i++) {
    ok = ok && is_finite(x[i]);
  }
  return ok;
}

static @real@ clamped(@real@ x, @real@ low, @real@ high) { return (x < low) ? low : ((x > high) ? high : x); }

static int may_spend(const @p@_options *options, workspace_t *s, int cost)
{
  if (s->stop != 0) {
    return 0;
  }
  if ((s->cost + cost) > options->budget) {
    s->stop = (int)@P@_BUDGET_SPENT;
    return 0;
  }
  if ((options->expired != NULL) && (options->expired(options->context) != 0)) {
    s->stop = (int)@P@_DEADLINE;
    return 0;
  }
  s->cost += cost;
  return 1;
}

static const @real@ *parameters_of(const @p@_problem *problem)
{
#if @P@_PARAMETERS_AT_RUN_TIME
  return problem->parameters;
#else
  (void)problem;
  return NULL;
#endif
}

static const @real@ *weights_of(const @p@_problem *problem)
{
#if @P@_WEIGHTS_AT_RUN_TIME
  return problem->weights;
#else
  (void)problem;
  return NULL;
#endif
}

/* ---- kernels ---- */

static int locate(const @p@_problem *problem, point *x)
{
  const @real@ *arg[3] = {x->z, &x->z[@N_B@], parameters_of(problem)};
  @real@ *res[4] = {x->end_point, x->jacobian, &x->sine_squared, x->sine_squared_z};
  (void)KERNEL_position(arg, res);
  return all_finite(NT, x->end_point) && all_finite(NT * NZ, x->jacobian) && is_finite(x->sine_squared) &&
         all_finite(NZ, x->sine_squared_z);
}

static int evaluate(const @p@_problem *problem, workspace_t *s, point *x)
{
  const @real@ *at[3] = {x->z, &x->z[@N_B@], parameters_of(problem)};
  @real@ *held[1] = {s->held};
  const @real@ *arg[5] = {x->z, &x->z[@N_B@], parameters_of(problem), s->held, weights_of(problem)};
  @real@ *res[2] = {&x->value, &x->scale};
  (void)KERNEL_hold(at, held);
  (void)KERNEL_value(arg, res);
  x->stationarity = -R(1.0);
  return is_finite(x->value) && is_finite(x->scale) && (x->scale > R(0.0));
}

/* Derivatives at x, whose evaluation was the last one; in x and V/scale. */
static int differentiate(const @p@_problem *problem, workspace_t *s, const point *x)
{
  const @real@ *arg[5] = {x->z, &x->z[@N_B@], parameters_of(problem), s->held, weights_of(problem)};
  @real@ *res[4] = {s->gradient, s->hessian, s->end_point_hessian, s->sine_squared_hessian};
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
  return all_finite(NZ, s->gradient) && all_finite(NZ * NZ, s->hessian) &&
         all_finite(NT * NZ * NZ, s->end_point_hessian) && all_finite(NZ * NZ, s->sine_squared_hessian);
}

/* ---- dense algebra, row-major with NZ columns ---- */

/* Householder: rows (k of n free variables) = [T' 0] Q'; basis holds Q, triangle T (upper). 0 where rank is lost. */
static int factorise(workspace_t *s, int k, int n)
{
  @real@ *a = s->reflected;
  for (int i = 0; i < n; i++) {
    for (int j = 0; j < n; j++) {
      s->basis[(i * NZ) + j] = (i == j) ? R(1.0) : R(0.0);
    }
  }
  for (int j = 0; j < k; j++) {
    @real@ whole = R(0.0);
    @real@ rest = R(0.0);
    for (int i = 0; i < n; i++) {
      const @real@ square = a[(j * NZ) + i] * a[(j * NZ) + i];
      whole += square;
      rest += (i >= j) ? square : R(0.0);
    }
    if (!(rest > (EDGE * whole))) {
      return 0;
    }
    {
      const @real@ norm = sqrt(rest);
      const @real@ corner = (a[(j * NZ) + j] > R(0.0)) ? -norm : norm;
      @real@ v[NZ] = {R(0.0)};
      @real@ square = R(0.0);
      for (int i = j; i < n; i++) {
        v[i] = a[(j * NZ) + i] - ((i == j) ? corner : R(0.0));
        square += v[i] * v[i];
      }
      for (int l = j; l < k; l++) {
        @real@ dot = R(0.0);
        for (int i = j; i < n; i++) {
          dot += a[(l * NZ) + i] * v[i];
        }
        for (int i = j; i < n; i++) {
          a[(l * NZ) + i] -= R(2.0) * dot * v[i] / square;
        }
      }
      for (int l = 0; l < n; l++) {
        @real@ dot = R(0.0);
        for (int i = j; i < n; i++) {
          dot += s->basis[(l * NZ) + i] * v[i];
        }
        for (int i = j; i < n; i++) {
          s->basis[(l * NZ) + i] -= R(2.0) * dot * v[i] / square;
        }
      }
      for (int l = j; l < k; l++) {
        s->triangle[(j * (NT + 1)) + l] = a[(l * NZ) + j];
      }
    }
  }
  return 1;
}

/* Cyclic Jacobi on reduced (d, d): eigenvalues on its diagonal, eigenvectors as columns of turn. */
static void diagonalise(workspace_t *s, int d)
{
  @real@ *a = s->reduced;
  @real@ *u = s->turn;
  for (int i = 0; i < d; i++) {
    for (int j = 0; j < d; j++) {
      u[(i * NZ) + j] = (i == j) ? R(1.0) : R(0.0);
    }
  }
  for (int sweep = 0; sweep < SWEEPS; sweep++) {
    for (int p = 0; p < (d - 1); p++) {
      for (int q = p + 1; q < d; q++) {
        const @real@ off = a[(p * NZ) + q];
        const @real@ half = (a[(q * NZ) + q] - a[(p * NZ) + p]) / R(2.0);
        const @real@ reach = fabs(half) + sqrt((half * half) + (off * off));
        if (reach > R(0.0)) {
          const @real@ tangent = ((half < R(0.0)) ? -off : off) / reach;
          const @real@ cosine = R(1.0) / sqrt(R(1.0) + (tangent * tangent));
          const @real@ sine = tangent * cosine;
          for (int k = 0; k < d; k++) {
            const @real@ left = a[(k * NZ) + p];
            const @real@ right = a[(k * NZ) + q];
            const @real@ first = u[(k * NZ) + p];
            const @real@ second = u[(k * NZ) + q];
            a[(k * NZ) + p] = (cosine * left) - (sine * right);
            a[(k * NZ) + q] = (sine * left) + (cosine * right);
            u[(k * NZ) + p] = (cosine * first) - (sine * second);
            u[(k * NZ) + q] = (sine * first) + (cosine * second);
          }
          for (int k = 0; k < d; k++) {
            const @real@ upper = a[(p * NZ) + k];
            const @real@ lower = a[(q * NZ) + k];
            a[(p * NZ) + k] = (cosine * upper) - (sine * lower);
            a[(q * NZ) + k] = (sine * upper) + (cosine * lower);
          }
        }
      }
    }
  }
}

/* Solves S x = b for the symmetric positive definite schur (w, w), which is destroyed; b becomes x. */
static int solve_schur(workspace_t *s, int w, @real@ *b)
{
  @real@ *a = s->schur;
  for (int j = 0; j < w; j++) {
    const @real@ whole = a[(j * NZ) + j];
    for (int k = 0; k < j; k++) {
      a[(j * NZ) + j] -= a[(j * NZ) + k] * a[(j * NZ) + k];
    }
    if (!(a[(j * NZ) + j] > (EDGE * whole))) {
      return 0;
    }
    a[(j * NZ) + j] = sqrt(a[(j * NZ) + j]);
    for (int i = j + 1; i < w; i++) {
      for (int k = 0; k < j; k++) {
        a[(i * NZ) + j] -= a[(i * NZ) + k] * a[(j * NZ) + k];
      }
      a[(i * NZ) + j] /= a[(j * NZ) + j];
    }
  }
  for (int i = 0; i < w; i++) {
    for (int k = 0; k < i; k++) {
      b[i] -= a[(i * NZ) + k] * b[k];
    }
    b[i] /= a[(i * NZ) + i];
  }
  for (int i = w - 1; i >= 0; i--) {
    for (int k = i + 1; k < w; k++) {
      b[i] -= a[(k * NZ) + i] * b[k];
    }
    b[i] /= a[(i * NZ) + i];
  }
  return 1;
}

/* Maximise g'y - y'By/2 subject to rows y >= limits, limits <= 0; inverse holds the inverse of B. Primal active sets
 * from y = 0; multipliers of the rows go to s->multipliers. Whatever ends the loop, y is feasible. */
static void solve_program(workspace_t *s, int d, int n_rows, const @real@ *g, @real@ *y)
{
  int working[NZ] = {0};
  int n_working = 0;
  int done = 0;
  for (int i = 0; i < d; i++) {
    y[i] = R(0.0);
  }
  for (int j = 0; j < n_rows; j++) {
    s->multipliers[j] = R(0.0);
  }
  for (int turn = 0; (turn < (4 * ROWS)) && (done == 0); turn++) {
    @real@ goal[NZ];
    @real@ nu[NZ];
    int block = -1;
    @real@ part = R(1.0);
    for (int w = 0; w < n_working; w++) {
      const @real@ *row = &s->rows[working[w] * NZ];
      nu[w] = s->limits[working[w]];
      for (int i = 0; i < d; i++) {
        @real@ sum = R(0.0);
        for (int k = 0; k < d; k++) {
          sum += s->inverse[(i * NZ) + k] * row[k];
        }
        s->through[(w * NZ) + i] = sum;
        nu[w] -= sum * g[i];
      }
      for (int v = 0; v <= w; v++) {
        @real@ sum = R(0.0);
        for (int i = 0; i < d; i++) {
          sum += s->through[(w * NZ) + i] * s->rows[(working[v] * NZ) + i];
        }
        s->schur[(w * NZ) + v] = sum;
      }
    }
    if (solve_schur(s, n_working, nu) == 0) {
      break;
    }
    for (int i = 0; i < d; i++) {
      goal[i] = R(0.0);
      for (int k = 0; k < d; k++) {
        goal[i] += s->inverse[(i * NZ) + k] * g[k];
      }
      for (int w = 0; w < n_working; w++) {
        goal[i] += s->through[(w * NZ) + i] * nu[w];
      }
    }
    for (int j = 0; (j < n_rows) && (n_working < d); j++) {
      @real@ slope = R(0.0);
      @real@ slack = -s->limits[j];
      @real@ size = R(0.0);
      int in = 0;
      for (int w = 0; w < n_working; w++) {
        in = in || (working[w] == j);
      }
      for (int i = 0; i < d; i++) {
        const @real@ along = s->rows[(j * NZ) + i] * (goal[i] - y[i]);
        slope += along;
        size += fabs(along);
        slack += s->rows[(j * NZ) + i] * y[i];
      }
      if ((in == 0) && (slope < (-EPSILON * R(10.0) * size)) && (slack < (-slope * part))) {
        part = (slack > R(0.0)) ? (slack / -slope) : R(0.0);
        block = j;
      }
    }
    for (int i = 0; i < d; i++) {
      y[i] += part * (goal[i] - y[i]);
    }
    if (block >= 0) {
      working[n_working] = block;
      n_working++;
    } else {
      int worst = -1;
      @real@ lowest = R(0.0);
      for (int w = 0; w < n_working; w++) {
        if (nu[w] < lowest) {
          lowest = nu[w];
          worst = w;
        }
      }
      if (worst < 0) {
        for (int w = 0; w < n_working; w++) {
          s->multipliers[working[w]] = nu[w];
        }
        done = 1;
      } else {
        n_working--;
        working[worst] = working[n_working];
      }
    }
  }
}

/* ---- feasibility ---- */

/* The largest number that enters the position, in x: what its rounding is relative to. */
static @real@ size_of(const @p@_problem *problem, const workspace_t *s, const point *x)
{
  @real@ size = R(1.0);
  for (int k = 0; k < NT; k++) {
    const @real@ part = fabs(problem->target[k]) / s->reach;
    size = (part > size) ? part : size;
  }
  for (int i = 0; i < NZ; i++) {
    const @real@ part = fabs(x->z[i]) / s->scales[i];
    size = (part > size) ? part : size;
  }
  return size;
}

/* Whole turns off joints without limits. */
static void unwind(const @p@_problem *problem, point *x)
{
  for (int i = @N_B@; i < NZ; i++) {
    if ((fabs(problem->lower[i]) >= @P@_UNBOUNDED) && (fabs(problem->upper[i]) >= @P@_UNBOUNDED)) {
      x->z[i] -= @TWO_PI@ * floor((x->z[i] / @TWO_PI@) + R(0.5));
    }
  }
}

/* Newton's method of least steps onto r(z) = target inside bounds and margin. Variables in held_fast stay where they are;
 * with start_on_margin the margin holds with equality. */
static int project(const @p@_problem *problem, workspace_t *s, point *x, const int *held_fast, int start_on_margin)
{
  int on_margin = start_on_margin;
  for (int step = 0; step < PROJECTION_STEPS; step++) {
    @real@ miss[NT + 1];
    @real@ dx[NZ];
    @real@ longest = R(0.0);
    int free_[NZ];
    int blocked[NZ];
    @real@ error = R(0.0);
    int again = 1;
    if (locate(problem, x) == 0) {
      return 0;
    }
    for (int k = 0; k < NT; k++) {
      miss[k] = (problem->target[k] - x->end_point[k]) / s->reach;
      error = (fabs(miss[k]) > error) ? fabs(miss[k]) : error;
    }
    miss[NT] = problem->sine_squared_min - x->sine_squared;
    if (error <= (EDGE * size_of(problem, s, x))) {
      if ((miss[NT] <= EDGE) && ((on_margin == 0) || (miss[NT] >= -EDGE))) {
        return 1;
      }
      on_margin = 1;
    }
    for (int i = 0; i < NZ; i++) {
      blocked[i] = held_fast[i];
    }
    for (int pass = 0; (pass <= NZ) && (again != 0); pass++) {
      const int k_rows = NT + ((on_margin != 0) ? 1 : 0);
      int n = 0;
      again = 0;
      for (int i = 0; i < NZ; i++) {
        dx[i] = R(0.0);
        if (blocked[i] == 0) {
          free_[n] = i;
          n++;
        }
      }
      if (n < k_rows) {
        return 0;
      }
      for (int j = 0; j < n; j++) {
        const int i = free_[j];
        for (int k = 0; k < NT; k++) {
          s->reflected[(k * NZ) + j] = x->jacobian[k + (NT * i)] * s->scales[i] / s->reach;
        }
        s->reflected[(NT * NZ) + j] = x->sine_squared_z[i] * s->scales[i];
      }
      if (factorise(s, k_rows, n) == 0) {
        return 0;
      }
      {
        @real@ u[NT + 1];
        for (int k = 0; k < k_rows; k++) {
          u[k] = miss[k];
          for (int l = 0; l < k; l++) {
            u[k] -= s->triangle[(l * (NT + 1)) + k] * u[l];
          }
          u[k] /= s->triangle[(k * (NT + 1)) + k];
        }
        for (int j = 0; j < n; j++) {
          for (int k = 0; k < k_rows; k++) {
            dx[free_[j]] += s->basis[(j * NZ) + k] * u[k];
          }
        }
      }
      for (int i = 0; i < NZ; i++) {
        const int out = ((x->z[i] <= problem->lower[i]) && (dx[i] < R(0.0))) ||
                        ((x->z[i] >= problem->upper[i]) && (dx[i] > R(0.0)));
        if ((blocked[i] == 0) && (out != 0)) {
          blocked[i] = 1;
          again = 1;
        }
      }
    }
    if (again != 0) {
      return 0;
    }
    for (int i = 0; i < NZ; i++) {
      longest = (fabs(dx[i]) > longest) ? fabs(dx[i]) : longest;
    }
    for (int i = 0; i < NZ; i++) {
      const @real@ part = (longest > STEP_MAX) ? (STEP_MAX / longest) : R(1.0);
      x->z[i] = clamped(x->z[i] + (part * dx[i] * s->scales[i]), problem->lower[i], problem->upper[i]);
    }
  }
  return 0;
}

static int near(const workspace_t *s, const point *a, const point *b, @real@ distance)
{
  int close = 1;
  for (int i = 0; i < NZ; i++) {
    close = close && (fabs(a->z[i] - b->z[i]) <= (distance * s->scales[i]));
  }
  return close;
}

static void note(workspace_t *s, const point *x)
{
  if ((s->found == 0) || (x->value > s->best.value)) {
    s->best = *x;
    s->found = 1;
  }
}

/* ---- one climb ---- */

/* Directions that leave the task, held variables and perhaps the margin as they are, to first order. */
typedef struct {
  int free_[NZ];      /* variables that are not held */
  int n;              /* how many */
  int k;              /* rows of the task, and of the margin where it is held */
  int d;              /* directions: n - k */
  @real@ slope[NZ]; /* of V along them */
  int owner[ROWS];    /* inequalities: 2 i lower, 2 i + 1 upper bound of variable i, 2 NZ margin */
  int n_rows;
} plane;

static void add_row(workspace_t *s, plane *at, int owner, @real@ limit)
{
  s->limits[at->n_rows] = (limit > R(0.0)) ? R(0.0) : limit;
  at->owner[at->n_rows] = owner;
  at->n_rows++;
}

/* Null space into s->basis (columns k to n - 1), rows and limits of the inequalities. 0 where the task loses rank. */
static int build_plane(const @p@_problem *problem, workspace_t *s, const int *held_fast, int on_margin, plane *at)
{
  const point *x = &s->present;
  at->n = 0;
  at->k = NT + ((on_margin != 0) ? 1 : 0);
  at->n_rows = 0;
  for (int i = 0; i < NZ; i++) {
    if (held_fast[i] == 0) {
      at->free_[at->n] = i;
      at->n++;
    }
  }
  at->d = at->n - at->k;
  if (at->d < 0) {
    return 0;
  }
  for (int j = 0; j < at->n; j++) {
    const int i = at->free_[j];
    for (int k = 0; k < NT; k++) {
      s->reflected[(k * NZ) + j] = x->jacobian[k + (NT * i)] * s->scales[i] / s->reach;
    }
    s->reflected[(NT * NZ) + j] = x->sine_squared_z[i] * s->scales[i];
  }
  if (factorise(s, at->k, at->n) == 0) {
    return 0;
  }
  for (int l = 0; l < at->d; l++) {
    at->slope[l] = R(0.0);
    for (int j = 0; j < at->n; j++) {
      at->slope[l] += s->basis[(j * NZ) + at->k + l] * s->gradient[at->free_[j]];
    }
  }
  for (int j = 0; j < at->n; j++) {
    const int i = at->free_[j];
    for (int side = 0; side < 2; side++) {
      const @real@ bound = (side == 0) ? problem->lower[i] : problem->upper[i];
      const @real@ sign = (side == 0) ? R(1.0) : -R(1.0);
      if (fabs(bound) < @P@_UNBOUNDED) {
        for (int l = 0; l < at->d; l++) {
          s->rows[(at->n_rows * NZ) + l] = sign * s->basis[(j * NZ) + at->k + l];
        }
        add_row(s, at, (2 * i) + side, sign * (bound - x->z[i]) / s->scales[i]);
      }
    }
  }
  if (on_margin == 0) {
    for (int l = 0; l < at->d; l++) {
      @real@ sum = R(0.0);
      for (int j = 0; j < at->n; j++) {
        sum += x->sine_squared_z[at->free_[j]] * s->scales[at->free_[j]] * s->basis[(j * NZ) + at->k + l];
      }
      s->rows[(at->n_rows * NZ) + l] = sum;
    }
    add_row(s, at, 2 * NZ, problem->sine_squared_min - x->sine_squared);
  }
  return 1;
}

/* Hessian of the Lagrangian into s->hessian, with the multipliers of the projected gradient's program; the variables and
 * the margin that it holds back go to held_fast and on_margin. */
static void add_constraints(workspace_t *s, const plane *at, int *held_fast, int *on_margin)
{
  @real@ pull[NZ];
  @real@ lambda[NT];
  @real@ mu = R(0.0);
  for (int i = 0; i < NZ; i++) {
    pull[i] = s->gradient[i];
  }
  for (int r = 0; r < at->n_rows; r++) {
    const int i = at->owner[r] / 2;
    const int active = ((s->multipliers[r] > R(0.0)) && (s->limits[r] >= -EDGE)) ? 1 : 0;
    if (at->owner[r] == (2 * NZ)) {
      mu = s->multipliers[r];
      *on_margin = active;
    } else {
      pull[i] += ((at->owner[r] % 2) == 0) ? s->multipliers[r] : -s->multipliers[r];
      held_fast[i] = ((held_fast[i] != 0) || (active != 0)) ? 1 : 0;
    }
  }
  for (int i = 0; i < NZ; i++) {
    pull[i] += mu * s->present.sine_squared_z[i] * s->scales[i];
  }
  for (int k = NT - 1; k >= 0; k--) {
    lambda[k] = R(0.0);
    for (int j = 0; j < at->n; j++) {
      lambda[k] += s->basis[(j * NZ) + k] * pull[at->free_[j]];
    }
    for (int l = k + 1; l < NT; l++) {
      lambda[k] -= s->triangle[(k * (NT + 1)) + l] * lambda[l];
    }
    lambda[k] /= s->triangle[(k * (NT + 1)) + k];
  }
  for (int i = 0; i < (NZ * NZ); i++) {
    s->hessian[i] += mu * s->sine_squared_hessian[i];
    for (int k = 0; k < NT; k++) {
      s->hessian[i] -= lambda[k] * s->end_point_hessian[(NZ * NZ * k) + i];
    }
  }
}

/* s->inverse: of the reduced Hessian with its sign turned and its eigenvalues made positive. Where V has positive
 * curvature at a stationary point, a slope is added that leads away; returns whether it was. */
static int build_model(workspace_t *s, plane *at, int stationary)
{
  int kicked = 0;
  const int d = at->d;
  for (int l = 0; l < d; l++) {
    for (int i = 0; i < at->n; i++) {
      s->turn[(i * NZ) + l] = R(0.0);
      for (int j = 0; j < at->n; j++) {
        s->turn[(i * NZ) + l] += s->hessian[at->free_[i] + (NZ * at->free_[j])] * s->basis[(j * NZ) + at->k + l];
      }
    }
  }
  for (int k = 0; k < d; k++) {
    for (int l = 0; l < d; l++) {
      @real@ sum = R(0.0);
      for (int i = 0; i < at->n; i++) {
        sum += s->basis[(i * NZ) + at->k + k] * s->turn[(i * NZ) + l];
      }
      s->reduced[(k * NZ) + l] = sum;
    }
  }
  diagonalise(s, d);
  for (int k = 0; k < d; k++) {
    const @real@ curvature = s->reduced[(k * NZ) + k];
    const @real@ size = fabs(curvature);
    if ((curvature > CURVATURE) && (stationary != 0)) {
      @real@ along = R(0.0);
      for (int l = 0; l < d; l++) {
        along += s->turn[(l * NZ) + k] * at->slope[l];
      }
      for (int l = 0; l < d; l++) {
        at->slope[l] += ((along < R(0.0)) ? -KICK : KICK) * size * s->turn[(l * NZ) + k];
      }
      kicked = 1;
    }
    s->reduced[(k * NZ) + k] = (size > CURVATURE_MIN) ? size : CURVATURE_MIN;
  }
  for (int k = 0; k < d; k++) {
    for (int l = 0; l < d; l++) {
      @real@ sum = R(0.0);
      for (int e = 0; e < d; e++) {
        sum += s->turn[(k * NZ) + e] * s->turn[(l * NZ) + e] / s->reduced[(e * NZ) + e];
      }
      s->inverse[(k * NZ) + l] = sum;
    }
  }
  return kicked;
}

/* Along y from s->present, back onto the target, until V is higher. gain: the rise of V/scale to first order. */
static int search(const @p@_problem *problem, const @p@_options *options, workspace_t *s, const plane *at,
                  const @real@ *y, @real@ gain)
{
  @real@ dx[NZ];
  @real@ longest = R(0.0);
  @real@ part;
  int held[NZ];
  for (int i = 0; i < NZ; i++) {
    dx[i] = R(0.0);
    held[i] = 1;
  }
  for (int j = 0; j < at->n; j++) {
    const int i = at->free_[j];
    held[i] = 0;
    for (int l = 0; l < at->d; l++) {
      dx[i] += s->basis[(j * NZ) + at->k + l] * y[l];
    }
    longest = (fabs(dx[i]) > longest) ? fabs(dx[i]) : longest;
  }
  part = (longest > STEP_MAX) ? (STEP_MAX / longest) : R(1.0);
  for (int halving = 0; halving < HALVINGS; halving++) {
    int held_fast[NZ];
    int on_margin = (at->k > NT) ? 1 : 0;
    if (may_spend(options, s, 1) == 0) {
      return 0;
    }
    for (int i = 0; i < NZ; i++) {
      s->trial.z[i] = clamped(s->present.z[i] + (part * dx[i] * s->scales[i]), problem->lower[i], problem->upper[i]);
      held_fast[i] = held[i];
    }
    for (int r = 0; r < at->n_rows; r++) {
      /* A row that holds the step back stays active where it was, and becomes so after a whole step. */
      if ((s->multipliers[r] > R(0.0)) && ((part >= R(1.0)) || (s->limits[r] >= -EDGE))) {
        const int i = at->owner[r] / 2;
        if (at->owner[r] == (2 * NZ)) {
          on_margin = 1;
        } else {
          s->trial.z[i] = ((at->owner[r] % 2) == 0) ? problem->lower[i] : problem->upper[i];
          held_fast[i] = 1;
        }
      }
    }
    /* The projection overwrites the basis; dx was taken from it before. */
    if ((project(problem, s, &s->trial, held_fast, on_margin) != 0) && (evaluate(problem, s, &s->trial) != 0)) {
      const @real@ rise = s->trial.value - s->present.value;
      if ((rise > R(0.0)) && (rise >= (R(1e-4) * part * gain * s->present.scale))) {
        s->trial.scale = s->present.scale; /* one climb, one scale */
        s->trial.status = (int)@P@_BUDGET_SPENT;
        s->present = s->trial;
        return 1;
      }
    }
    part *= (halving < 3) ? R(0.5) : R(0.25);
  }
  return 0;
}

/* One step from s->present; 1 where it moved, else s->present.status says why not. */
static int step_up(const @p@_problem *problem, const @p@_options *options, workspace_t *s)
{
  plane at;
  int held_fast[NZ];
  int on_margin = 0;
  int kicked;
  int stationary;
  @real@ y[NZ];
  @real@ square = R(0.0);
  @real@ gain = R(0.0);
  for (int i = 0; i < NZ; i++) {
    held_fast[i] = (problem->lower[i] >= problem->upper[i]) ? 1 : 0;
  }
  if ((differentiate(problem, s, &s->present) == 0) || (build_plane(problem, s, held_fast, 0, &at) == 0)) {
    return 0;
  }
  for (int k = 0; k < at.d; k++) {
    for (int l = 0; l < at.d; l++) {
      s->inverse[(k * NZ) + l] = (k == l) ? R(1.0) : R(0.0);
    }
  }
  solve_program(s, at.d, at.n_rows, at.slope, y);
  for (int k = 0; k < at.d; k++) {
    square += y[k] * y[k];
  }
  s->present.stationarity = sqrt(square);
  stationary = (s->present.stationarity <= options->tolerance) ? 1 : 0;
  s->present.status =
      (int)(((stationary != 0) || (s->present.stationarity <= STATIONARY_ENOUGH)) ? @P@_CONVERGED : @P@_STALLED);
  add_constraints(s, &at, held_fast, &on_margin);
  if ((build_plane(problem, s, held_fast, on_margin, &at) == 0) || (at.d == 0)) {
    return 0;
  }
  kicked = build_model(s, &at, stationary);
  if ((stationary != 0) && (kicked == 0)) {
    return 0;
  }
  solve_program(s, at.d, at.n_rows, at.slope, y);
  for (int k = 0; (k < at.d) && (kicked == 0); k++) {
    gain += at.slope[k] * y[k];
  }
  return search(problem, options, s, &at, y, gain);
}

/* From s->present, feasible and evaluated, to a local maximum. Every accepted point goes to note(). */
static void climb(const @p@_problem *problem, const @p@_options *options, workspace_t *s)
{
  int moved = 1;
  if ((s->found != 0) && (s->best.scale > s->present.scale)) {
    s->present.scale = s->best.scale;
  }
  s->climbed++;
  s->present.status = (int)@P@_BUDGET_SPENT; /* until the next step says more */
  note(s, &s->present);
  for (int step = 0; (step < CLIMB_STEPS) && (moved != 0) && (may_spend(options, s, COST_MODEL) != 0); step++) {
    const int is_best = near(s, &s->present, &s->best, R(0.0));
    s->iterations++;
    s->present.status = (int)@P@_STALLED;
    moved = step_up(problem, options, s);
    if (moved != 0) {
      note(s, &s->present);
    } else if (is_best != 0) {
      s->best.stationarity = s->present.stationarity;
      s->best.status = s->present.status;
    } else {
      /* the best point belongs to another climb */
    }
  }
}

/* ---- starts ---- */

/* Keep x among the best starts, highest V first; grid says that it is a peak of a curve, else neighbours count as one. */
static void keep(workspace_t *s, int most, const point *x, int grid)
{
  int at;
  int twin = -1;
  for (int k = 0; (k < s->n_starts) && (grid == 0) && (twin < 0); k++) {
    twin = (near(s, x, &s->starts[k], APART) != 0) ? k : -1;
  }
  if (twin >= 0) {
    if (x->value <= s->starts[twin].value) {
      return;
    }
    for (int l = twin; l < (s->n_starts - 1); l++) {
      s->starts[l] = s->starts[l + 1];
    }
    s->n_starts--;
  }
  at = 0;
  for (int k = 0; k < s->n_starts; k++) {
    at += (x->value > s->starts[k].value) ? 0 : 1;
  }
  if (at < most) {
    s->n_starts += (s->n_starts < most) ? 1 : 0;
    for (int l = s->n_starts - 1; l > at; l--) {
      s->starts[l] = s->starts[l - 1];
    }
    s->starts[at] = *x;
  }
}

/* Posture in closed form at a placement; 0 where there is none inside limits and margin. */
static int place(const @p@_problem *problem, workspace_t *s, @real@ base, const @real@ *unit, @real@ elbow,
                 point *x)
{
  const @real@ *arg[5] = {problem->target, x->z, unit, &elbow, parameters_of(problem)};
  @real@ cosine = R(2.0);
  @real@ *res[2] = {&x->z[@N_B@], &cosine};
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
static void sample(const @p@_problem *problem, const @p@_options *options, workspace_t *s)
{
  @real@ low;
  @real@ high;
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
      @real@ square = R(0.0);
      for (int k = 0; k <= UNITS; k++) {
        unit[k] = R(0.5);
      }
      if (may_spend(options, s, 1) == 0) {
        return 0;
      }
      if (place(problem, s, base, unit, (@real@)elbow, &s->trial) != 0) {
        for (int i = 0; i < NZ; i++) {
          const @real@ away = (s->trial.z[i] - start[i]) / s->scales[i];
          square += away * away;
        }
        if ((nearest < R(0.0)) || (square < nearest)) {
          nearest = square;
          s->present = s->trial;
        }
      }
    }
  }
  return (nearest >= R(0.0)) ? 1 : 0;
}

/* ---- interface ---- */

static int in_range(const @p@_problem *problem, const @p@_options *options)
{
  int ok = (options->budget >= 1) && (options->budget <= @P@_BUDGET_MAX) && (options->starts >= 0) &&
           (options->starts <= @P@_STARTS_MAX) && (options->tolerance > R(0.0)) && (options->tolerance < R(1.0)) &&
           (problem->sine_squared_min > R(0.0)) && (problem->sine_squared_min < R(1.0));
  for (int i = 0; i < NZ; i++) {
    ok = ok && (problem->lower[i] <= problem->upper[i]) && (fabs(problem->lower[i]) <= @P@_UNBOUNDED) &&
         (fabs(problem->upper[i]) <= @P@_UNBOUNDED);
  }
  for (int k = 0; k < NT; k++) {
    ok = ok && (fabs(problem->target[k]) <= @P@_UNBOUNDED);
  }
#if @P@_PARAMETERS_AT_RUN_TIME
  {
    static const @real@ low[@P@_N_PARAMETERS] = {@P_LOW@};
    static const @real@ high[@P@_N_PARAMETERS] = {@P_HIGH@};
    for (int i = 0; i < @P@_N_PARAMETERS; i++) {
      ok = ok && (problem->parameters[i] >= low[i]) && (problem->parameters[i] <= high[i]);
    }
  }
#endif
#if @P@_WEIGHTS_AT_RUN_TIME
  {
    @real@ sum = R(0.0);
    for (int i = 0; i < @P@_N_MODES; i++) {
      ok = ok && (problem->weights[i] >= R(0.0)) && (problem->weights[i] <= R(1e6));
      sum += problem->weights[i];
    }
    ok = ok && (sum > R(0.0));
  }
#endif
  return ok;
}

static int inputs_finite(const @p@_problem *problem, const @real@ *start, const @p@_options *options)
{
  int ok = all_finite(NT, problem->target) && all_finite(NZ, problem->lower) && all_finite(NZ, problem->upper) &&
           is_finite(problem->sine_squared_min) && is_finite(options->tolerance);
#if @P@_WEIGHTS_AT_RUN_TIME
  ok = ok && all_finite(@P@_N_MODES, problem->weights);
#endif
#if @P@_PARAMETERS_AT_RUN_TIME
  ok = ok && all_finite(@P@_N_PARAMETERS, problem->parameters);
#endif
  return ok && ((start == NULL) || all_finite(NZ, start));
}

static void climb_from_start(const @p@_problem *problem, const @real@ *start, const @p@_options *options,
                             workspace_t *s)
{
  int held_fast[NZ];
  int ready = 1;
  for (int i = 0; i < NZ; i++) {
    ready = ((ready != 0) && (fabs(start[i]) <= @P@_UNBOUNDED)) ? 1 : 0;
    s->present.z[i] = clamped(start[i], problem->lower[i], problem->upper[i]);
    held_fast[i] = (problem->lower[i] >= problem->upper[i]) ? 1 : 0;
  }
  unwind(problem, &s->present);
  if (may_spend(options, s, 1) != 0) {
    ready = ((ready != 0) && (project(problem, s, &s->present, held_fast, 0) != 0)) ? 1 : 0;
    ready = ((ready != 0) || (replace_start(problem, start, options, s) != 0)) ? 1 : 0;
    if ((ready != 0) && (evaluate(problem, s, &s->present) != 0)) {
      climb(problem, options, s);
    }
  }
}

/* Whether V may still rise by more than a tie: with weights >= 0 and two task rows or more it is never above 0. */
static int could_rise(const workspace_t *s)
{
  return (s->found == 0) || (NT < 2) || (s->best.value < (-TIE * s->best.scale));
}

static void climb_from_samples(const @p@_problem *problem, const @p@_options *options, workspace_t *s)
{
  sample(problem, options, s);
  for (int k = 0; (k < s->n_starts) && (s->stop == 0) && (could_rise(s) != 0); k++) {
    const int had = s->found;
    const @p@_point before = s->best;
    s->present = s->starts[k];
    if ((may_spend(options, s, 1) != 0) && (evaluate(problem, s, &s->present) != 0)) {
      climb(problem, options, s);
      if ((had != 0) && (s->best.value <= (before.value + (TIE * before.scale)))) {
        s->best = before;
      }
    }
  }
}

@p@_status @p@_default_problem(@p@_problem *problem)
{
  static const @real@ lower[NZ] = {@LOWER@};
  static const @real@ upper[NZ] = {@UPPER@};
#if @P@_PARAMETERS_AT_RUN_TIME
  static const @real@ parameters[@P@_N_PARAMETERS] = {@P_VALUES@};
#endif
  if (problem == NULL) {
    return @P@_NULL_POINTER;
  }
  for (int k = 0; k < NT; k++) {
    problem->target[k] = R(0.0);
  }
  for (int i = 0; i < NZ; i++) {
    problem->lower[i] = lower[i];
    problem->upper[i] = upper[i];
  }
  problem->sine_squared_min = @SINE_SQUARED_MIN@;
#if @P@_WEIGHTS_AT_RUN_TIME
  for (int i = 0; i < @P@_N_MODES; i++) {
    problem->weights[i] = R(1.0);
  }
#endif
#if @P@_PARAMETERS_AT_RUN_TIME
  for (int i = 0; i < @P@_N_PARAMETERS; i++) {
    problem->parameters[i] = parameters[i];
  }
#endif
  return @P@_CONVERGED;
}

@p@_status @p@_default_options(@p@_options *options)
{
  if (options == NULL) {
    return @P@_NULL_POINTER;
  }
  options->budget = @P@_BUDGET;
  options->starts = @P@_STARTS_MAX;
  options->tolerance = @TOLERANCE@;
  options->expired = NULL;
  options->context = NULL;
  return @P@_CONVERGED;
}

static int aligned(const void *pointer)
{
  struct probe {
    char byte;
    workspace_t inner;
  };
  return ((uintptr_t)pointer % offsetof(struct probe, inner)) == 0U;
}

/* Nothing leaves unless the equations, evaluated once more, say that it is feasible. */
static int confirm(const @p@_problem *problem, workspace_t *s, @p@_result *found)
{
  point *x = &s->best;
  unwind(problem, x);
  if (locate(problem, x) == 0) {
    return 0;
  }
  found->target_error = R(0.0);
  found->bound_violation = R(0.0);
  for (int k = 0; k < NT; k++) {
    const @real@ error = fabs(x->end_point[k] - problem->target[k]);
    found->target_error = (error > found->target_error) ? error : found->target_error;
  }
  for (int i = 0; i < NZ; i++) {
    const @real@ below = problem->lower[i] - x->z[i];
    const @real@ above = x->z[i] - problem->upper[i];
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
  return (found->target_error <= (R(4.0) * EDGE * s->reach * size_of(problem, s, x))) &&
         (found->bound_violation <= R(0.0)) && (found->margin_slack >= (-R(4.0) * EDGE));
}

@p@_status @p@_solve(const @p@_problem *problem, const @real@ *start, const @p@_options *options,
                         @p@_workspace *workspace, @p@_result *result)
{
  workspace_t *s = workspace;
  @p@_result found;
  if ((problem == NULL) || (options == NULL) || (workspace == NULL) || (result == NULL)) {
    return @P@_NULL_POINTER;
  }
  if (aligned(workspace) == 0) {
    return @P@_BAD_WORKSPACE;
  }
  if (inputs_finite(problem, start, options) == 0) {
    return @P@_NOT_FINITE;
  }
  if (in_range(problem, options) == 0) {
    return @P@_OUT_OF_RANGE;
  }
  s->cost = 0;
  s->iterations = 0;
  s->n_starts = 0;
  s->climbed = 0;
  s->stop = 0;
  s->found = 0;
  {
    const @real@ *arg[1] = {parameters_of(problem)};
    @real@ *res[2] = {s->first_joint, &s->reach};
    (void)KERNEL_reach(arg, res);
    if ((all_finite(NT, s->first_joint) == 0) || (is_finite(s->reach) == 0) || !(s->reach > R(0.0))) {
      return @P@_OUT_OF_RANGE;
    }
  }
  for (int i = 0; i < NZ; i++) {
    s->scales[i] = (i < @N_B@) ? s->reach : R(1.0);
  }
  if (start != NULL) {
    climb_from_start(problem, start, options, s);
  }
  if ((options->starts > 0) && (s->stop == 0) && (could_rise(s) != 0)) {
    climb_from_samples(problem, options, s);
  }
  if (s->found == 0) {
    return (s->stop != 0) ? @P@_ENDED_EARLY : @P@_NO_FEASIBLE;
  }
  if (confirm(problem, s, &found) == 0) {
    return @P@_NO_FEASIBLE;
  }
  *result = found;
  return (s->stop != 0) ? (@p@_status)s->stop : (@p@_status)s->best.status;
}
