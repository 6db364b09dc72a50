{# What the search in optimiser_c/ needs to know of one machine. #}
{% macro table(name, values) %}
#define {{ name }} { {{- values | join(", ") -}} }
{% endmacro %}
{% macro reals(name, values) %}
#define {{ name }} {{ listed(values, "") | replace("\n", " \\\n") }}
{% endmacro %}
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

{% include "export/templates/single_precision.h" %}
{{ kernels }}
/* Names. */
typedef {{ real_type }} real_t;
{% for name in ("status", "problem", "options", "result", "point", "workspace") %}
typedef {{ p }}_{{ name }} {{ name }}_t;
{% endfor %}
{% for name in ("default_problem", "default_options", "solve") %}
#define {{ name }} {{ p }}_{{ name }}
{% endfor %}
{% for name in statuses | list + ["N_MODES", "N_PARAMETERS", "PARAMETERS_AT_RUN_TIME", "UNBOUNDED", "TARGET_TOLERANCE", "MARGIN_TOLERANCE", "STARTS_MAX", "BUDGET", "BUDGET_MAX", "ROWS"] %}
#define {{ name }} {{ P }}_{{ name }}
{% endfor %}
#define NZ {{ P }}_N_Z
#define NT {{ P }}_N_TASK
#define N_B {{ n_base }} /* variables of the placement */
#define R(x) {% if real == "float" %}x##f{% else %}x{% endif %} /* a constant in the precision */

/* Which way derivatives and starts are found, and whether eigenvectors are iterated from those of the point before. */
#define SECOND_DERIVATIVES "optimiser_{{ "exact" if exact else "differences" }}.h"
#define STARTS_FROM "optimiser_{{ "closed_form" if closed_form else "sampled" }}.h"
#define WARM_STARTED {{ (not exact) | int }}

/* Costs, in evaluations of V: counts of operations. */
#define COST_SLOPE {{ cost_slope }} /* of what each step needs */
#define COST_MODEL {{ cost_model }} /* the same with second derivatives */
#define PROJECTIONS {{ projections }} /* steps onto the target that cost as much as one */

/* Precision. */
#define EPSILON {{ number(epsilon) }}
#define EDGE {{ number(edge * epsilon) }} /* rounding of positions, relative to the reach: sums of lengths times sines, each with its own */
#define TOLERANCE {{ number(tolerance) }} /* stationarity at which a climb ends: its square, what V may still gain, is rounding */
#define STATIONARY_ENOUGH {{ number(enough) }} /* where rounding ends a climb, this is still a stationary point */
#define TIE {{ number(tie) }} /* values of V/scale that count as equal: one optimum reached twice differs by less, as V is flat there */
#define ROUGH {{ number(rough) }} /* stationarity that is enough to compare climbs by: V/scale is its square off its top */
#define SETTLING {{ settling }} /* more steps of Newton's after the first that is on the target: in double it ends at rounding by itself */
#define MARGIN_EDGE {% if margin_edge %}{{ number(margin_edge) }} /* a product of many sines, each rounded */{% else %}EDGE{% endif +%}
#define PI {{ number(pi) }}
#define TWO_PI {{ number(2 * pi) }}

/* Steps, in x: within half a radian a linearised arm is still of use; longer and fewer ones where each costs many times more. */
#define STEP_MAX {{ number(step_max) }}
#define PROJECTION_STEPS {{ projection_steps }} /* of Newton's, which doubles its digits with each of the last ones */
{% if not exact %}
#define PROBE {{ number(probe) }} /* step of differences of slopes: the root of a slope's rounding error */
{% endif %}

/* Starts: points of the redundancy that are looked at, in so many rounds. */
#define SAMPLES {{ samples }}
#define ROUNDS {{ rounds }}
{% if closed_form %}
#define UNITS {{ units }} /* postures left free by target and placement */
{% else %}
{{ table("ROWS_OF", rows_of) -}}
{% endif %}
{{ reals("SAMPLE_STEPS", sample_steps) }}

/* Variables: whether each is an angle; may be held as others make up for it; whether the base alone turns no measure. */
{{ table("ANGLES", angles) -}}
{{ table("SPARE", spare) -}}

/* Rows of the target in which it is known where the arm begins, the variable that shifts it along each (-1: none); the one
 * that turns it, and the rows that this turns. */
{{ table("PLACED_ROWS", placed_rows) -}}
{{ table("SHIFTED_BY", shifted_by) -}}
#define TURNED_BY {{ turned_by }}
#define TURNED_X {{ turned_rows[0] }}
#define TURNED_Y {{ turned_rows[1] }}
#define BASE_IDLE {{ "true" if base_idle else "false" }}

/* The default problem. */
#define SINE_SQUARED_MIN {{ number(sine_squared_min) }}
{{ reals("LOWER", lower) -}}
{{ reals("UPPER", upper) -}}
{% if parameters_at_run_time %}
{{ reals("PARAMETERS", parameters) -}}
{{ reals("PARAMETERS_LOW", parameters_low) -}}
{{ reals("PARAMETERS_HIGH", parameters_high) -}}
{% endif %}

/* The generated functions. */
{% for name, kernel in kernel_table.items() %}
{% set works = name in with_work %}
#define ARG_{{ name }} {{ kernel.sz_arg }}
#define RES_{{ name }} {{ kernel.sz_res }}
static void call_{{ name }}(const real_t **arg, real_t **res{% if works %}, real_t *work{% endif %})
{
{% for given, taken in (("arg", "arg"), ("res", "res"), ("work", "w")) if taken not in kernel.parameters and (works or given != "work") %}
  (void){{ given }};
{% endfor %}
  (void){{ kernel.name }}({{ kernel.parameters | join(", ") | replace("w", "work") }});
}
{% endfor %}
