/* Configuration optimiser of @MACHINE@, @CONTROL@ control@GRAVITY@.
 *
 * Climbs to a local maximum of V(z) = sum_i alpha_i w_i(z) over z = [@VARIABLES@]
 * (m, rad) subject to r(z) = target, lower <= z <= upper, and a distance from singular postures.
 * Every accepted iterate is feasible and V never falls, so whenever the call ends, by budget or by deadline, the best
 * point so far is a valid configuration. An answer is the best of the local maxima that the starts led to; whether there is
 * a better one elsewhere is not known. It is checked once more in the end, in the precision of the call: bounds exactly, target
 * and margin to the tolerances below; what does not pass is refused.
 * No heap, no recursion, every loop bounded, no static data that changes. The workspace may not share memory with the other
 * arguments. Not for -ffast-math: a NaN is found by comparing. */

#define @P@_N_Z                    @N_Z@     /* variables: placement, then actuated joints */
#define @P@_N_TASK                 @N_TASK@  /* coordinates of the target */
#define @P@_N_MODES                @N_MODES@ /* measures w_1, w_2, ... */
#define @P@_N_PARAMETERS           @N_P@     /* machine parameters */
#define @P@_WEIGHTS_AT_RUN_TIME    @WEIGHTS_AT_RUN_TIME@
#define @P@_PARAMETERS_AT_RUN_TIME @PARAMETERS_AT_RUN_TIME@
#define @P@_UNBOUNDED              R(1e6)     /* a bound of this size or more counts as absent */
/* Tolerances of an answer. target_error is at most the first times the arm's reach, and times the largest of |z_i|, m over
 * the reach or rad, and |target_k| over the reach, where that is more than 1; margin_slack is not below minus the second. */
#define @P@_TARGET_TOLERANCE       @TARGET_TOLERANCE@
#define @P@_MARGIN_TOLERANCE       @MARGIN_TOLERANCE@
#define @P@_STARTS_MAX             @STARTS@ /* most own starts */
#define @P@_BUDGET                 @BUDGET@ /* default budget; unit: one evaluation of V */
#define @P@_BUDGET_MAX             @BUDGET_MAX@

/* Index of each variable in z. */
enum { @INDICES@ };

typedef enum {
  @P@_CONVERGED = 0,    /* a local optimum: feasible, and stationary to the tolerance, or to @STATIONARY_ENOUGH@ where rounding
                           * allows no more; not proved to be the best of all */
  @P@_BUDGET_SPENT = 1, /* feasible; the budget ended before it was proved stationary, or before every start */
  @P@_DEADLINE = 2,     /* the same, ended by expired() */
  @P@_STALLED = 3,      /* feasible, not stationary, and no step raises V in this precision */
  /* From here on: no answer; result is as it was. */
  @P@_NULL_POINTER = 16,  /* a pointer is NULL; start alone may be */
  @P@_BAD_WORKSPACE = 17, /* the workspace is not aligned as its type asks, or overlaps another argument */
  @P@_NOT_FINITE = 18,    /* an input is NaN or infinite */
  @P@_OUT_OF_RANGE = 19,  /* bounds reversed, margin or tolerance outside (0, 1), weights negative or all 0, budget,
                             * starts, a machine parameter outside the range of machine files */
  @P@_NO_FEASIBLE = 20,   /* the target is out of reach, or no start could be brought to a feasible point */
  @P@_ENDED_EARLY = 21    /* budget or deadline ended before the first feasible point */
} @p@_status;

typedef struct {
  @real@ target[@P@_N_TASK]; /* end-point, m, inertial frame */
  @real@ lower[@P@_N_Z];     /* m, rad */
  @real@ upper[@P@_N_Z];
  @real@ sine_squared_min; /* sin^2 of the margin from singular postures, in (0, 1) */
#if @P@_WEIGHTS_AT_RUN_TIME
  @real@ weights[@P@_N_MODES]; /* alpha_i >= 0 */
#endif
#if @P@_PARAMETERS_AT_RUN_TIME
  @real@ parameters[@P@_N_PARAMETERS]; /* @PARAMETERS@ */
#endif
} @p@_problem;

typedef struct {
  int budget;         /* evaluations of V that the call may cost; @COST_MODEL@ for one with its derivatives */
  int starts;         /* own starts beside the given one, 0 to @P@_STARTS_MAX */
  @real@ tolerance; /* stationarity at which a climb ends, in (0, 1) */
  int (*expired)(void *context); /* asked before each evaluation; not 0 ends the call. May be NULL */
  void *context;                 /* handed to expired */
} @p@_options;

typedef struct {
  @real@ z[@P@_N_Z];    /* the configuration */
  @real@ value;           /* V(z) */
  @real@ scale;           /* sum_i alpha_i |a_i||b_i| where the climb began: what V is measured against */
  @real@ target_error;    /* largest |r - target|, m; see TARGET_TOLERANCE */
  @real@ bound_violation; /* how far outside its bounds a variable is: 0 */
  @real@ margin_slack;    /* sin^2 minus sine_squared_min; see MARGIN_TOLERANCE */
  @real@ stationarity;    /* projected gradient of V/scale, base in units of the reach; -1: not reached */
  int cost;                 /* of the budget */
  int iterations;           /* climbing steps, over all starts */
  int starts;               /* starts climbed from */
} @p@_result;

/* A point of the search; for the workspace only. */
typedef struct {
  @real@ z[@P@_N_Z];
  @real@ value;
  @real@ scale;
  @real@ stationarity;
  @real@ end_point[@P@_N_TASK];
  @real@ jacobian[@P@_N_TASK * @P@_N_Z];
  @real@ sine_squared;
  @real@ sine_squared_z[@P@_N_Z];
  int status;
} @p@_point;

#define @P@_ROWS (2 * @P@_N_Z + 1)

/* Memory of one call, owned by the caller; calls with different workspaces may run at the same time. */
typedef struct {
  @real@ held[@N_HELD@];
  @real@ gradient[@P@_N_Z];
  @real@ hessian[@P@_N_Z * @P@_N_Z];
@SECOND@@NEAR_FIELDS@  @real@ gradient_before[@P@_N_Z];
  @real@ pull[@P@_N_TASK + 1];
  @real@ work[@N_WORK@];
  @real@ basis[@P@_N_Z * @P@_N_Z];
  @real@ triangle[(@P@_N_TASK + 1) * (@P@_N_TASK + 1)];
  @real@ reflected[(@P@_N_TASK + 1) * @P@_N_Z];
  @real@ reduced[@P@_N_Z * @P@_N_Z];
  @real@ turn[@P@_N_Z * @P@_N_Z];
  @real@ inverse[@P@_N_Z * @P@_N_Z];
  @real@ rows[@P@_ROWS * @P@_N_Z];
  @real@ limits[@P@_ROWS];
  @real@ multipliers[@P@_ROWS];
  @real@ schur[@P@_N_Z * @P@_N_Z];
  @real@ through[@P@_N_Z * @P@_N_Z];
  @real@ scales[@P@_N_Z];
  @p@_point present;
  @p@_point before;
  @p@_point first;
  @p@_point trial;
  @p@_point best;
  @p@_point starts[@P@_STARTS_MAX];
  @real@ first_joint[@P@_N_TASK];
  @real@ reach;
  @real@ gain;
  @real@ steepness;
  int rough;
  int last;
  int paused;
  int from;
  int age;
  int cost;
  int budget;
  int newtons;
  int iterations;
  @real@ apart;
  int n_starts;
  int n_tried;
  int climbed;
  int stop;
  int found;
} @p@_workspace;

#define @P@_WORKSPACE_SIZE (sizeof(@p@_workspace)) /* bytes */

/* The machine's own parameters, equal weights (all 1), joint limits, every placement within reach, a margin of
 * @MARGIN_DEG@ degrees from singular postures; the target is left at 0. */
@p@_status @p@_default_problem(@p@_problem *problem);

/* The default budget, all own starts, tolerance @TOLERANCE@, no deadline. */
@p@_status @p@_default_options(@p@_options *options);

/* Solve. start may be NULL (own starts only) and need not be feasible: it is brought to the nearest feasible point first.
 * The climb from start comes first; the own starts, sampled over the whole redundancy, follow, best first, and only
 * where they could still be better. Among equals the result of start wins. On failure *result is as it was. */
@p@_status @p@_solve(const @p@_problem *problem, const @real@ *start, const @p@_options *options,
                         @p@_workspace *workspace, @p@_result *result);
