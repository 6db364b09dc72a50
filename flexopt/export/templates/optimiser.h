/* The posture optimiser of the bundle; {{ prefix }}_control.h has the rest. Made for the machine and the bundle whose hashes
 * stand there. */
#ifndef {{ PREFIX }}_OPTIMISER_H
#define {{ PREFIX }}_OPTIMISER_H

#include <stdbool.h>

#include "{{ prefix }}_control.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Configuration optimiser of {{ machine.name | c_text }}, Jacobian {{ control }} control.
 *
 * Climbs to a local maximum of V(z) = sum_i alpha_i w_i(z) over z = [{% for z in variables %}{{ z | c_text }}{% if not loop.last %}, {% endif %}{% endfor %}]
 * (m, rad) subject to r(z) = target, lower <= z <= upper, and a distance from singular postures.
 * Every accepted iterate is feasible and V never falls, so whenever the call ends, by budget or by deadline, the best
 * point so far is a valid configuration. An answer is the best of what climbs from the starts came to within the budget;
 * whether there is a better one elsewhere is not known. It is checked once more in the end, in the precision of the call: bounds exactly, target
 * and margin to the tolerances below; what does not pass is refused.
 * No heap, no recursion, every loop bounded, no static data that changes. The workspace may not share memory with the other
 * arguments. Not for -ffast-math: a NaN is found by comparing. */

#define {{ P }}_N_Z                    {{ variables | length }}     /* variables: placement, then actuated joints */
#define {{ P }}_N_TASK                 {{ n_task }}  /* coordinates of the target */
#define {{ P }}_N_MODES                {{ n_modes }} /* measures w_1, w_2, ... */
#define {{ P }}_N_PARAMETERS           {{ parameter_names | length }}     /* machine parameters */
#define {{ P }}_WEIGHTS_AT_RUN_TIME    1
#define {{ P }}_PARAMETERS_AT_RUN_TIME {{ parameters_at_run_time | int }}
#define {{ P }}_UNBOUNDED              {{ number(unbounded) }}     /* a bound of this size or more counts as absent */
/* Tolerances of an answer. target_error is at most the first times the arm's reach, and times the largest of |z_i|, m over
 * the reach or rad, and |target_k| over the reach, where that is more than 1; margin_slack is not below minus the second. */
#define {{ P }}_TARGET_TOLERANCE       {{ number(target_tolerance) }}
#define {{ P }}_MARGIN_TOLERANCE       {{ number(margin_tolerance) }}
#define {{ P }}_STARTS_MAX             {{ starts }} /* most own starts */
#define {{ P }}_BUDGET                 {{ budget }} /* default budget; unit: one evaluation of V */
#define {{ P }}_BUDGET_MAX             {{ budget_max }}

/* Index of each variable in z; a number follows where another name of this header is the same. */
enum {
{% for word in indices %}
  {{ P }}_{{ word }} = {{ loop.index0 }}{% if not loop.last %},{% endif +%}
{% endfor %}
};

typedef enum {
{% for name, (value, text) in statuses.items() %}
{% if value == first_failure %}
  /* From here on: no answer; result is as it was. */
{% endif %}
{{ comment(text, "  ") }}
  {{ P }}_{{ name }} = {{ value }}{% if not loop.last %},{% endif +%}
{% endfor %}
} {{ p }}_status;

typedef struct {
  {{ real_type }} target[{{ P }}_N_TASK]; /* end-point, m, {{ task_frame }} */
  {{ real_type }} lower[{{ P }}_N_Z];     /* m, rad */
  {{ real_type }} upper[{{ P }}_N_Z];
  {{ real_type }} sine_squared_min; /* sin^2 of the margin from singular postures, in (0, 1) */
  {{ real_type }} weights[{{ P }}_N_MODES]; /* alpha_i >= 0 */
#if {{ P }}_PARAMETERS_AT_RUN_TIME
  {{ real_type }} parameters[{{ P }}_N_PARAMETERS]; /* {% for name in parameter_names %}{{ name | c_text }}{% if not loop.last %}, {% endif %}{% endfor %} */
#endif
} {{ p }}_problem;

typedef struct {
  int budget;         /* evaluations of V that the call may cost; {{ cost_model }} for one with its derivatives */
  int starts;         /* own starts beside the given one, 0 to {{ P }}_STARTS_MAX */
  {{ real_type }} tolerance; /* stationarity at which a climb ends, in (0, 1) */
  int (*expired)(void *context); /* asked before each evaluation; not 0 ends the call. May be NULL */
  void *context;                 /* handed to expired */
} {{ p }}_options;

typedef struct {
  {{ real_type }} z[{{ P }}_N_Z];    /* the configuration */
  {{ real_type }} value;           /* V(z) */
  {{ real_type }} scale;           /* sum_i alpha_i |a_i||b_i| where the climb began: what V is measured against */
  {{ real_type }} target_error;    /* largest |r - target|, m; see TARGET_TOLERANCE */
  {{ real_type }} bound_violation; /* how far outside its bounds a variable is: 0 */
  {{ real_type }} margin_slack;    /* sin^2 minus sine_squared_min; see MARGIN_TOLERANCE */
  {{ real_type }} stationarity;    /* projected gradient of V/scale, base in units of the reach; -1: not reached */
  int cost;                 /* of the budget */
  int iterations;           /* climbing steps, over all starts */
  int starts;               /* starts climbed from */
} {{ p }}_result;

/* A point of the search; for the workspace only. */
typedef struct {
  {{ real_type }} z[{{ P }}_N_Z];
  {{ real_type }} value;
  {{ real_type }} scale;
  {{ real_type }} stationarity;
  {{ real_type }} end_point[{{ P }}_N_TASK];
  {{ real_type }} jacobian[{{ P }}_N_TASK * {{ P }}_N_Z];
  {{ real_type }} sine_squared;
  {{ real_type }} sine_squared_z[{{ P }}_N_Z];
  {{ p }}_status status;
} {{ p }}_point;

#define {{ P }}_ROWS (2 * {{ P }}_N_Z + 1)

/* Scratch: what it holds means nothing to the next step. */
typedef struct {
  {{ real_type }} held[{{ n_held }}];
  {{ real_type }} work[{{ n_work }}];
  {{ real_type }} gradient[{{ P }}_N_Z];
{% if exact %}
  {{ real_type }} end_point_hessian[{{ P }}_N_TASK * {{ P }}_N_Z * {{ P }}_N_Z];
  {{ real_type }} sine_squared_hessian[{{ P }}_N_Z * {{ P }}_N_Z];
{% else %}
  {{ real_type }} next[{{ P }}_N_MODES * {{ P }}_N_MODES];
{% endif %}
  {{ real_type }} pull[{{ P }}_N_TASK + 1];
  {{ real_type }} basis[{{ P }}_N_Z * {{ P }}_N_Z];
  {{ real_type }} triangle[({{ P }}_N_TASK + 1) * ({{ P }}_N_TASK + 1)];
  {{ real_type }} reflected[({{ P }}_N_TASK + 1) * {{ P }}_N_Z];
  {{ real_type }} reduced[{{ P }}_N_Z * {{ P }}_N_Z];
  {{ real_type }} turn[{{ P }}_N_Z * {{ P }}_N_Z];
  {{ real_type }} inverse[{{ P }}_N_Z * {{ P }}_N_Z];
  {{ real_type }} rows[{{ P }}_ROWS * {{ P }}_N_Z];
  {{ real_type }} limits[{{ P }}_ROWS];
  {{ real_type }} multipliers[{{ P }}_ROWS];
  {{ real_type }} schur[{{ P }}_N_Z * {{ P }}_N_Z];
  {{ real_type }} through[{{ P }}_N_Z * {{ P }}_N_Z];
  {{ p }}_point trial;
} {{ p }}_memory;

/* One call, owned by the caller: its scratch, and the state of the search. Calls with different workspaces may run at the
 * same time. */
typedef struct {
  {{ p }}_memory memory;
  /* The problem's sizes. */
  {{ real_type }} scales[{{ P }}_N_Z];
  {{ real_type }} first_joint[{{ P }}_N_TASK];
  {{ real_type }} reach;
  /* What was found. */
  {{ p }}_point present;
  {{ p }}_point before;
  {{ p }}_point first;
  {{ p }}_point best;
  bool found;
  /* What was learned of V where the climb is. */
  {{ real_type }} hessian[{{ P }}_N_Z * {{ P }}_N_Z];
  {{ real_type }} gradient_before[{{ P }}_N_Z];
{% if not exact %}
  {{ real_type }} near[{{ P }}_N_MODES * {{ P }}_N_MODES];
{% endif %}
  {{ real_type }} gain;
  {{ real_type }} steepness;
  int age;
  bool rough;
  bool last;
  bool paused;
  bool thorough;
  /* Starts. */
  {{ p }}_point starts[{{ P }}_STARTS_MAX];
  bool given_up[{{ P }}_STARTS_MAX];
  {{ real_type }} apart;
  int from;
  int n_starts;
  int n_tried;
  int climbed;
  /* What was spent. */
  int cost;
  int budget;
  int newtons;
  int iterations;
  {{ p }}_status stop; /* why the call ends; converged as long as it goes on */
} {{ p }}_workspace;

#define {{ P }}_WORKSPACE_SIZE (sizeof({{ p }}_workspace)) /* bytes */

/* The machine's own parameters, equal weights (all 1), joint limits, every placement within reach, a margin of
 * {{ "%g" | format(margin_deg) }} degrees from singular postures; the target is left at 0. */
{{ p }}_status {{ p }}_default_problem({{ p }}_problem *problem);

/* The default budget, all own starts, tolerance {{ number(tolerance) }}, no deadline. */
{{ p }}_status {{ p }}_default_options({{ p }}_options *options);

/* Solve. start may be NULL (own starts only) and need not be feasible: it is brought to the nearest feasible point first.
 * The climb from start comes first; the own starts, sampled over the whole redundancy, follow, best first. A climb is
 * given up where its last step promises less than the best one has, and goes on in the end, as far as the budget lasts.
 * Among equals the result of start wins. On failure *result is as it was. */
{{ p }}_status {{ p }}_solve(const {{ p }}_problem *problem, const {{ real_type }} *start, const {{ p }}_options *options,
                         {{ p }}_workspace *workspace, {{ p }}_result *result);

#ifdef __cplusplus
}
#endif

#endif
