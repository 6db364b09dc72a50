/* ---- Configuration optimiser: sequential quadratic programming along the set r(z) = target ------------------------
 *
 * Each step: @HESSIAN@, of the Lagrangian on the null space of the task, its eigenvalues turned positive; a small
 * quadratic program with bounds and margin by active sets; Newton's method back onto the target; a line search that
 * accepts only a higher V. Internally x = z / scales and V / scale, so that every number below is of order one. */

#define NZ                @P@_N_Z
#define NT                @P@_N_TASK
#define ROWS              @P@_ROWS
#define EPSILON           @EPSILON@
/* Costs, in evaluations of V. */
#define COST_SLOPE        @COST_SLOPE@ /* of what each step needs */
#define COST_MODEL        @COST_MODEL@ /* the same with second derivatives */
#define PROJECTIONS       @PROJECTIONS@ /* steps onto the target that cost as much as one */
#define PAUSE             (@P@_BUDGET - (@P@_BUDGET / 8)) /* from here on the best climb is finished first */
/* One climb. */
#define PROJECTION_STEPS  @PROJECTION_STEPS@
#define HALVINGS          10
#define SWEEPS            8
#define CLIMB_STEPS       60
#define STEP_MAX          @STEP_MAX@              /* longest step in x */
#define KICK              R(0.05)               /* step away from a saddle */
#define CURVATURE         R(1e-6)               /* positive curvature of V above it is none of rounding */
#define CURVATURE_MIN     R(1e-7)               /* smallest curvature of the model */
#define STATIONARY_ENOUGH @STATIONARY_ENOUGH@ /* where rounding ends a climb, this is still a stationary point */
#define TIE               @TIE@               /* values of V/scale that count as equal */
#define EDGE              (R(@EDGE@) * EPSILON)   /* rounding of positions, relative to the reach */
#define FINE              (R(4.0) * EPSILON)    /* as near to the target as rounding lets most points come, */
#define SETTLING          @SETTLING@                   /* by so many more of Newton's steps */
#define MARGIN_EDGE       @MARGIN_EDGE@         /* rounding of the margin */
/* Steps for which the Hessian has been learned; before: */
#define OUTDATED          (-1)
#define UNKNOWN           (-2)
/* Several climbs: all but the best are given up early. */
#define ROUGH             @ROUGH@               /* stationarity that is enough to compare them by */
#define PATIENCE          2                     /* steps before one may be given up */
#define PROMISE           R(0.5)                /* share of what a step may bring that all after it may bring */
#define RIDGE_STEPS       5                     /* steps in which it must rise by this share, */
#define RIDGE_RISE        R(0.1)
#define RIDGE_SLOPE       R(1e-3)               /* unless it is nearly stationary */
#define ROUNDS            @ROUNDS@              /* of samples */
#define APART             R(0.7)                /* starts closer than this are one, at first */
#define REPLACEMENTS      6                     /* placements tried where the start cannot be brought onto the target */

typedef @p@_point point;
typedef @p@_workspace workspace_t;

static int is_finite(@real@ x) { return (x - x) == R(0.0); }

static int all_finite(int n, const @real@ *x)
{
  @real@ nothing = R(0.0);
  for (int i = 0; i < n; i++) {
    nothing += x[i] - x[i];
  }
  return nothing == R(0.0);
}

static @real@ clamped(@real@ x, @real@ low, @real@ high) { return (x < low) ? low : ((x > high) ? high : x); }

/* Whether a variable is in rad, not in m. */
static int is_angle(int i)
{
  static const int angle[NZ] = {@ANGLES@};
  return angle[i];
}

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
  const @real@ *arg[@ARG_position@] = {x->z, &x->z[@N_B@], parameters_of(problem)};
  @real@ *res[@RES_position@] = {x->end_point, x->jacobian};
  (void)KERNEL_position(arg, res);
  return all_finite(NT, x->end_point) && all_finite(NT * NZ, x->jacobian);
}

/* Distance from singular postures. */
static int clear(const @p@_problem *problem, point *x)
{
  const @real@ *arg[@ARG_distance@] = {x->z, &x->z[@N_B@], parameters_of(problem)};
  @real@ *res[@RES_distance@] = {&x->sine_squared};
  (void)KERNEL_distance(arg, res);
  return is_finite(x->sine_squared);
}

static int margin_slope(const @p@_problem *problem, point *x)
{
  const @real@ *arg[@ARG_margin@] = {x->z, &x->z[@N_B@], parameters_of(problem)};
  @real@ *res[@RES_margin@] = {x->sine_squared_z};
  (void)KERNEL_margin(arg, res);
  return all_finite(NZ, x->sine_squared_z);
}

static int evaluate(const @p@_problem *problem, workspace_t *s, point *x)
{
  const @real@ *at[@ARG_hold@] = {x->z, &x->z[@N_B@], parameters_of(problem)@NEAR@};
  @real@ *held[@RES_hold@] = {s->held@NEXT@};
  const @real@ *arg[@ARG_value@] = {x->z, &x->z[@N_B@], parameters_of(problem), s->held, weights_of(problem)};
  @real@ *res[@RES_value@] = {&x->value, &x->scale};
  (void)KERNEL_hold(at, held);
@REMEMBER@  (void)KERNEL_value(arg, res);
  x->stationarity = -R(1.0);
  return is_finite(x->value) && is_finite(x->scale) && (x->scale > R(0.0));
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
  int turned = 1; /* whether a pair was not negligible */
  for (int i = 0; i < d; i++) {
    for (int j = 0; j < d; j++) {
      u[(i * NZ) + j] = (i == j) ? R(1.0) : R(0.0);
    }
  }
  for (int sweep = 0; (sweep < SWEEPS) && (turned != 0); sweep++) {
    turned = 0;
    for (int p = 0; p < (d - 1); p++) {
      for (int q = p + 1; q < d; q++) {
        const @real@ off = a[(p * NZ) + q];
        const @real@ half = (a[(q * NZ) + q] - a[(p * NZ) + p]) / R(2.0);
        const @real@ reach = fabs(half) + sqrt((half * half) + (off * off));
        turned = ((turned != 0) || ((off * off) > (EPSILON * EPSILON * fabs(a[(p * NZ) + p] * a[(q * NZ) + q])))) ? 1 : 0;
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

/* Whole turns off angles without limits. */
static void unwind(const @p@_problem *problem, point *x)
{
  for (int i = 0; i < NZ; i++) {
    if ((is_angle(i) != 0) && (fabs(problem->lower[i]) >= @P@_UNBOUNDED) && (fabs(problem->upper[i]) >= @P@_UNBOUNDED)) {
      x->z[i] -= @TWO_PI@ * floor((x->z[i] / @TWO_PI@) + R(0.5));
    }
  }
}

/* Newton's method of least steps onto r(z) = target inside bounds and margin. Variables in held_fast stay where they are;
 * with start_on_margin the margin holds with equality. */
static int project(const @p@_problem *problem, workspace_t *s, point *x, const int *held_fast, int start_on_margin)
{
  int on_margin = start_on_margin;
  int settled = 0;
  for (int step = 0; step < (PROJECTION_STEPS + SETTLING); step++) {
    @real@ miss[NT + 1];
    @real@ dx[NZ];
    @real@ longest = R(0.0);
    int free_[NZ];
    int blocked[NZ];
    @real@ error = R(0.0);
    int again = 1;
    s->newtons++;
    if ((s->newtons >= PROJECTIONS) && (s->cost < s->budget)) {
      s->newtons = 0;
      s->cost++;
    }
    if (locate(problem, x) == 0) {
      return 0;
    }
    for (int k = 0; k < NT; k++) {
      miss[k] = (problem->target[k] - x->end_point[k]) / s->reach;
      error = (fabs(miss[k]) > error) ? fabs(miss[k]) : error;
    }
    if ((error <= (EDGE * size_of(problem, s, x))) || (on_margin != 0)) {
      if (clear(problem, x) == 0) {
        return 0;
      }
      miss[NT] = problem->sine_squared_min - x->sine_squared;
    }
    if (error <= (EDGE * size_of(problem, s, x))) {
      if ((miss[NT] <= MARGIN_EDGE) && ((on_margin == 0) || (miss[NT] >= -MARGIN_EDGE))) {
        if ((settled >= SETTLING) || (error <= (FINE * size_of(problem, s, x)))) {
          return 1;
        }
        settled++;
      } else {
        on_margin = 1;
      }
    }
    if ((on_margin != 0) && (margin_slope(problem, x) == 0)) {
      return 0;
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
        s->reflected[(NT * NZ) + j] = (on_margin != 0) ? (x->sine_squared_z[i] * s->scales[i]) : R(0.0);
      }
      {
        @real@ u[NT + 1];
        for (int k = 0; k < k_rows; k++) {
          u[k] = miss[k];
          for (int l = 0; l <= k; l++) {
            @real@ dot = R(0.0);
            for (int j = 0; j < n; j++) {
              dot += s->reflected[(k * NZ) + j] * s->reflected[(l * NZ) + j];
            }
            s->schur[(k * NZ) + l] = dot;
          }
        }
        if (solve_schur(s, k_rows, u) == 0) {
          return 0;
        }
        for (int j = 0; j < n; j++) {
          for (int k = 0; k < k_rows; k++) {
            dx[free_[j]] += s->reflected[(k * NZ) + j] * u[k];
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

/* Whether variables from number `from` on differ by no more than the distance, in x. */
static int near(const workspace_t *s, const point *a, const point *b, int from, @real@ distance)
{
  int close = 1;
  for (int i = from; i < NZ; i++) {
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

/* Whether inequality r holds with equality, to rounding. */
static int at_limit(const workspace_t *s, const plane *at, int r)
{
  return s->limits[r] >= ((at->owner[r] == (2 * NZ)) ? -MARGIN_EDGE : -EDGE);
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

/* Multipliers of the task and of the margin, by the projected gradient's program, into s->pull; the variables and the
 * margin that it holds back go to held_fast and on_margin. Returns whether there are any. */
static int hold_back(workspace_t *s, const plane *at, int *held_fast, int *on_margin)
{
  @real@ pull[NZ];
  @real@ *lambda = s->pull;
  @real@ mu = R(0.0);
  int changed = 0;
  for (int i = 0; i < NZ; i++) {
    pull[i] = s->gradient[i];
  }
  for (int r = 0; r < at->n_rows; r++) {
    const int i = at->owner[r] / 2;
    const int active = ((s->multipliers[r] > R(0.0)) && (at_limit(s, at, r) != 0)) ? 1 : 0;
    if (at->owner[r] == (2 * NZ)) {
      mu = s->multipliers[r];
      *on_margin = active;
      changed = changed || (active != 0);
    } else {
      pull[i] += ((at->owner[r] % 2) == 0) ? s->multipliers[r] : -s->multipliers[r];
      changed = changed || ((active != 0) && (held_fast[i] == 0));
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
  s->pull[NT] = mu;
  return changed;
}

/* The Hessian times the basis of the plane, into s->turn (n, d). */
static void times_basis(workspace_t *s, const plane *at)
{
  for (int l = 0; l < at->d; l++) {
    for (int i = 0; i < at->n; i++) {
      s->turn[(i * NZ) + l] = R(0.0);
      for (int j = 0; j < at->n; j++) {
        s->turn[(i * NZ) + l] += s->hessian[at->free_[i] + (NZ * at->free_[j])] * s->basis[(j * NZ) + at->k + l];
      }
    }
  }
}

@DERIVATIVES@
/* s->inverse: of the reduced Hessian, whose product with the basis is s->turn, with its sign turned and its eigenvalues
 * made positive. Where V has positive curvature at a stationary point, a slope is added that leads away; returns whether
 * it was. */
static int build_model(workspace_t *s, plane *at, int stationary)
{
  int kicked = 0;
  const int d = at->d;
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

/* Along y from s->present, back onto the target, until V is higher; s->gain: the rise of V/scale to first order. */
static int search(const @p@_problem *problem, const @p@_options *options, workspace_t *s, const plane *at,
                  const @real@ *y)
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
    @real@ shorter = (halving < 3) ? R(0.5) : R(0.25);
    if (may_spend(options, s, 1) == 0) {
      return 0;
    }
    for (int i = 0; i < NZ; i++) {
      s->trial.z[i] = clamped(s->present.z[i] + (part * dx[i] * s->scales[i]), problem->lower[i], problem->upper[i]);
      held_fast[i] = held[i];
    }
    for (int r = 0; r < at->n_rows; r++) {
      /* A row that holds the step back stays active where it was, and becomes so after a whole step. */
      if ((s->multipliers[r] > R(0.0)) && ((part >= R(1.0)) || (at_limit(s, at, r) != 0))) {
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
      if ((rise > R(0.0)) && (rise >= (R(1e-4) * part * s->gain * s->present.scale))) {
        s->trial.scale = s->present.scale; /* one climb, one scale */
        s->trial.status = (int)@P@_BUDGET_SPENT;
        s->present = s->trial;
        return 1;
      }
      if (s->gain > R(0.0)) {
        /* Where a parabola through both values has its top. */
        const @real@ first = part * s->gain * s->present.scale;
        shorter = clamped(first / (R(2.0) * (first - rise)), R(0.1), R(0.5));
      }
    }
    part *= shorter;
  }
  return 0;
}

/* Variables of the base that others make up for, as long as these are free, add nothing but a direction along which V
 * stays. */
static void hold_spare(const @p@_problem *problem, const workspace_t *s, int *held_fast)
{
  static const int spare[NZ] = {@SPARE@};
  int all_free = 1;
  for (int i = 0; i < @N_B@; i++) {
    const @real@ z = s->present.z[i];
    all_free = all_free && ((spare[i] != 0) || ((z > problem->lower[i]) && (z < problem->upper[i])));
  }
  for (int i = 0; (i < @N_B@) && (all_free != 0); i++) {
    held_fast[i] = ((held_fast[i] != 0) || (spare[i] != 0)) ? 1 : 0;
  }
}

/* One step from s->present; 1 where it moved, else s->present.status says why not. */
static int step_up(const @p@_problem *problem, const @p@_options *options, workspace_t *s)
{
  plane at;
  int held_fast[NZ];
  int on_margin = 0;
  int stationary;
  int changed;
  @real@ y[NZ];
  @real@ square = R(0.0);
  for (int i = 0; i < NZ; i++) {
    held_fast[i] = (problem->lower[i] >= problem->upper[i]) ? 1 : 0;
  }
  hold_spare(problem, s, held_fast);
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
  s->steepness = s->present.stationarity;
  stationary = (s->present.stationarity <= ((s->rough != 0) ? ROUGH : options->tolerance)) ? 1 : 0;
  s->present.status = (int)(((s->present.stationarity <= options->tolerance) ||
                             (s->present.stationarity <= STATIONARY_ENOUGH)) ? @P@_CONVERGED : @P@_STALLED);
  /* Whether it is a maximum is asked where that costs nothing, and of the best point in the end. */
  if ((stationary != 0) && ((s->rough != 0) || ((s->last == 0) && (COST_MODEL > COST_SLOPE)))) {
    return 0;
  }
  changed = hold_back(s, &at, held_fast, &on_margin);
  /* A second time where what was learned of the Hessian led nowhere. */
  for (int attempt = 0; attempt < 2; attempt++) {
    int kicked;
    if ((changed != 0) && (build_plane(problem, s, held_fast, on_margin, &at) == 0)) {
      return 0;
    }
    changed = 1;
    if ((at.d == 0) || (curvatures(problem, options, s, &at) == 0)) {
      return 0;
    }
    kicked = build_model(s, &at, stationary);
    if ((stationary != 0) && ((kicked == 0) || (s->age > 1))) {
      return 0;
    }
    solve_program(s, at.d, at.n_rows, at.slope, y);
    s->gain = R(0.0);
    for (int k = 0; (k < at.d) && (kicked == 0); k++) {
      s->gain += at.slope[k] * y[k];
    }
    if (search(problem, options, s, &at, y) != 0) {
      return 1;
    }
    if ((s->age <= 1) || (s->stop != 0)) {
      return 0;
    }
    s->age = OUTDATED;
  }
  return 0;
}

/* From s->present, feasible and evaluated, to a local maximum; only nearly so where another point is the best. Every
 * accepted point goes to note(). */
static void climb(const @p@_problem *problem, const @p@_options *options, workspace_t *s)
{
  int moved = 1;
  @real@ low = s->present.value;
  if ((s->found != 0) && (s->best.scale > s->present.scale)) {
    s->present.scale = s->best.scale;
  }
  s->age = (s->last != 0) ? OUTDATED : UNKNOWN;
  s->present.status = (int)@P@_BUDGET_SPENT; /* until the next step says more */
  note(s, &s->present);
  for (int step = 0; (step < CLIMB_STEPS) && (moved != 0) && (may_spend(options, s, COST_SLOPE) != 0); step++) {
    const int is_best = near(s, &s->present, &s->best, 0, R(0.0));
    if ((is_best == 0) && (s->paused == 0) && (s->cost > PAUSE)) {
      return;
    }
    s->rough = (is_best == 0) ? 1 : 0;
    s->iterations++;
    s->present.status = (int)@P@_STALLED;
    moved = step_up(problem, options, s);
    if (moved != 0) {
      note(s, &s->present);
      if ((s->last == 0) && (step >= PATIENCE)) {
        /* Not where another climb has been higher than this one is going to be, nor along a ridge. */
        moved = ((s->present.value + (PROMISE * s->gain * s->present.scale)) >= s->best.value) ? 1 : 0;
        if (((step % RIDGE_STEPS) == 0) && (s->steepness > RIDGE_SLOPE)) {
          moved = ((s->present.value - low) > (RIDGE_RISE * fabs(low))) ? moved : 0;
          low = s->present.value;
        }
      }
    } else if (is_best != 0) {
      s->best.stationarity = s->present.stationarity;
      s->best.status = s->present.status;
    } else {
      /* the best point belongs to another climb */
    }
  }
}

/* ---- starts ---- */

/* Whether a climb has begun nearby. */
static int tried(const workspace_t *s, const point *x)
{
  int close = ((s->climbed > 0) && (near(s, x, &s->first, s->from, s->apart) != 0)) ? 1 : 0;
  for (int k = 0; (k < s->n_tried) && (close == 0); k++) {
    close = near(s, x, &s->starts[k], s->from, s->apart);
  }
  return close;
}

/* Keep x among the best starts that wait, highest V first; grid says that it is a peak of a curve, else neighbours count
 * as one. */
static void keep(workspace_t *s, int most, const point *x, int grid)
{
  int at = s->n_tried;
  int twin = -1;
  if ((grid == 0) && (tried(s, x) != 0)) {
    return;
  }
  for (int k = s->n_tried; (k < s->n_starts) && (grid == 0) && (twin < 0); k++) {
    twin = (near(s, x, &s->starts[k], s->from, s->apart) != 0) ? k : -1;
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
  for (int k = s->n_tried; k < s->n_starts; k++) {
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

/* The trial becomes the present point where it is nearer to start than `nearest`, a squared distance in x, or that is
 * negative: none yet. Returns the smaller one. */
static @real@ keep_nearer(workspace_t *s, const @real@ *start, @real@ nearest)
{
  @real@ square = R(0.0);
  for (int i = 0; i < NZ; i++) {
    const @real@ away = (s->trial.z[i] - start[i]) / s->scales[i];
    square += away * away;
  }
  if ((nearest < R(0.0)) || (square < nearest)) {
    s->present = s->trial;
    return square;
  }
  return nearest;
}

@SAMPLING@
/* ---- interface ---- */

/* Where the arm begins and how long it is. */
static int prepare(const @p@_problem *problem, workspace_t *s)
{
  const @real@ *arg[@ARG_reach@] = {parameters_of(problem)};
  @real@ *res[@RES_reach@] = {s->first_joint, &s->reach};
  (void)KERNEL_reach(arg, res);
  return all_finite(NT, s->first_joint) && is_finite(s->reach) && (s->reach > R(0.0));
}

/* Whether the target may be within reach: in the rows along which no placement moves the machine it is no farther from
 * where the arm begins than the arm is long. */
static int within_reach(const @p@_problem *problem, const workspace_t *s)
{
  static const int fixed[NT] = {@FIXED_ROWS@};
  int ok = 1;
  for (int k = 0; k < NT; k++) {
    const @real@ away = fabs(problem->target[k] - s->first_joint[k]);
    ok = ok && ((fixed[k] == 0) || (away <= (R(1.001) * s->reach)));
  }
  return ok;
}

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
      s->climbed = 1;
      s->first = s->present;
      climb(problem, options, s);
    }
  }
}

/* Whether V may still rise by more than a tie: with weights >= 0 and two task rows or more it is never above 0. */
static int could_rise(const workspace_t *s)
{
  return (s->found == 0) || (NT < 2) || (s->best.value < (-TIE * s->best.scale));
}

/* The best point's climb goes on where it was left, or, in the end, may have ended at a saddle. */
static void finish(const @p@_problem *problem, const @p@_options *options, workspace_t *s, int check)
{
  if ((s->found == 0) || (s->stop != 0) || ((s->best.status == (int)@P@_CONVERGED) && (check == 0))) {
    return;
  }
  s->last = 1;
  s->present = s->best;
  if ((may_spend(options, s, 1) != 0) && (evaluate(problem, s, &s->present) != 0)) {
    climb(problem, options, s);
  }
  s->last = 0;
}

/* Samples and climbs from the best of them, in rounds, each with starts closer together than the one before. */
static void climb_from_samples(const @p@_problem *problem, const @p@_options *options, workspace_t *s)
{
  s->apart = APART;
  for (int round = 0; (round < ROUNDS) && (s->stop == 0) && (could_rise(s) != 0); round++) {
    sample(problem, options, s, round);
    for (int k = s->n_tried; (k < s->n_starts) && (s->stop == 0) && (could_rise(s) != 0); k++) {
      const int had = s->found;
      const @p@_point before = s->best;
      if ((s->paused == 0) && (s->cost > PAUSE)) {
        s->paused = 1;
        finish(problem, options, s, 0);
      }
      s->present = s->starts[k];
      s->n_tried = k + 1;
      if ((may_spend(options, s, 1) != 0) && (evaluate(problem, s, &s->present) != 0)) {
        s->climbed++;
        climb(problem, options, s);
        if ((had != 0) && (s->best.value <= (before.value + (TIE * before.scale)))) {
          s->best = before;
        }
      }
    }
    s->apart *= R(0.5);
  }
}

/* Number of the first variable by which starts are told apart: where the base is free, only postures are, as to turn or
 * shift machine and target together changes no measure. */
static int first_that_tells(const @p@_problem *problem)
{
  int free_ = @BASE_IDLE@;
  for (int i = 0; i < @N_B@; i++) {
    free_ = free_ && (problem->lower[i] <= -@P@_UNBOUNDED) && (problem->upper[i] >= @P@_UNBOUNDED);
  }
  return (free_ != 0) ? @N_B@ : 0;
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

/* Whether an argument lies over the workspace, which is written while it is still read. */
static int overlaps(const void *workspace, const void *other, size_t size)
{
  const uintptr_t begin = (uintptr_t)workspace;
  const uintptr_t from = (uintptr_t)other;
  return ((other != NULL) && (from < (begin + sizeof(workspace_t))) && (begin < (from + size))) ? 1 : 0;
}

/* Nothing leaves unless the equations, evaluated once more, say that it is feasible. */
static int confirm(const @p@_problem *problem, workspace_t *s, @p@_result *found)
{
  point *x = &s->best;
  unwind(problem, x);
  if ((locate(problem, x) == 0) || (clear(problem, x) == 0)) {
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
  return (found->target_error <= (@P@_TARGET_TOLERANCE * s->reach * size_of(problem, s, x))) &&
         (found->bound_violation <= R(0.0)) && (found->margin_slack >= -@P@_MARGIN_TOLERANCE);
}

@p@_status @p@_solve(const @p@_problem *problem, const @real@ *start, const @p@_options *options,
                         @p@_workspace *workspace, @p@_result *result)
{
  workspace_t *s = workspace;
  @p@_result found;
  if ((problem == NULL) || (options == NULL) || (workspace == NULL) || (result == NULL)) {
    return @P@_NULL_POINTER;
  }
  if ((aligned(workspace) == 0) || (overlaps(workspace, problem, sizeof(*problem)) != 0) ||
      (overlaps(workspace, start, sizeof(@real@) * NZ) != 0) || (overlaps(workspace, options, sizeof(*options)) != 0) ||
      (overlaps(workspace, result, sizeof(*result)) != 0)) {
    return @P@_BAD_WORKSPACE;
  }
  if (inputs_finite(problem, start, options) == 0) {
    return @P@_NOT_FINITE;
  }
  if (in_range(problem, options) == 0) {
    return @P@_OUT_OF_RANGE;
  }
  s->cost = 0;
  s->budget = options->budget;
  s->newtons = 0;
  s->iterations = 0;
  s->n_starts = 0;
  s->n_tried = 0;
  s->climbed = 0;
  s->stop = 0;
  s->found = 0;
  s->last = 0;
  s->paused = 0;
  if (prepare(problem, s) == 0) {
    return @P@_OUT_OF_RANGE;
  }
  for (int i = 0; i < NZ; i++) {
    s->scales[i] = (is_angle(i) != 0) ? R(1.0) : s->reach;
  }
  s->from = first_that_tells(problem);
  if (within_reach(problem, s) == 0) {
    return @P@_NO_FEASIBLE;
  }
@FORGET@  if (start != NULL) {
    climb_from_start(problem, start, options, s);
  }
  if ((options->starts > 0) && (s->stop == 0) && (could_rise(s) != 0)) {
    climb_from_samples(problem, options, s);
  }
  s->paused = 1;
  finish(problem, options, s, (COST_MODEL > COST_SLOPE) ? 1 : 0);
  if (s->found == 0) {
    return (s->stop != 0) ? @P@_ENDED_EARLY : @P@_NO_FEASIBLE;
  }
  if (confirm(problem, s, &found) == 0) {
    return @P@_NO_FEASIBLE;
  }
  *result = found;
  return (s->stop != 0) ? (@p@_status)s->stop : (@p@_status)s->best.status;
}
