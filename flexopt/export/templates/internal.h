/* Checks that every function of the bundle makes. Not for users. */
#ifndef {{ PREFIX }}_INTERNAL_H
#define {{ PREFIX }}_INTERNAL_H

#include <float.h>
#include <math.h>
#include <stdint.h>

#include "{{ prefix }}_control.h"

/* Checks for NaN compare numbers, which these options take to be needless. */
#if defined(__FAST_MATH__) || defined(_M_FP_FAST) || (defined(__FINITE_MATH_ONLY__) && (__FINITE_MATH_ONLY__ > 0))
#error "compile without -ffast-math and -ffinite-math-only (MSVC: /fp:fast): refusals rely on NaN and infinity"
#endif

{% if real == "float" %}
/* Single precision throughout. */
{% for name in ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "sqrt", "exp", "log", "log10", "fabs", "floor", "ceil", "expm1", "log1p", "erf") %}
#define {{ name }}(x) {{ name }}f(x)
{% endfor %}
{% for name in ("atan2", "pow", "fmin", "fmax", "fmod", "copysign", "hypot") %}
#define {{ name }}(x, y) {{ name }}f((x), (y))
{% endfor %}

{% endif %}
/* Pointers and workspace; `given` says whether no pointer is NULL. */
static inline {{ prefix }}_status {{ prefix }}_check_call(int given, const {{ prefix }}_real *workspace, size_t length,
                                                    size_t needed)
{
  {{ prefix }}_status status = {{ PREFIX }}_OK;
  if ((given == 0) || (workspace == NULL)) {
    status = {{ PREFIX }}_NULL_POINTER;
  } else if (((uintptr_t)workspace % sizeof({{ prefix }}_real)) != 0U) {
    status = {{ PREFIX }}_BAD_WORKSPACE;
  } else if (length < needed) {
    status = {{ PREFIX }}_BAD_WORKSPACE;
  } else {
    status = {{ PREFIX }}_OK;
  }
  return status;
}

/* The workspace is written while the other arguments are still read. */
static inline {{ prefix }}_status {{ prefix }}_check_apart(const {{ prefix }}_real *workspace, size_t needed,
                                                     const {{ prefix }}_real *other, size_t size)
{
  const uintptr_t begin = (uintptr_t)workspace;
  const uintptr_t from = (uintptr_t)other;
  {{ prefix }}_status status = {{ PREFIX }}_OK;
  if ((from < (begin + (needed * sizeof({{ prefix }}_real)))) && (begin < (from + size))) {
    status = {{ PREFIX }}_BAD_WORKSPACE;
  }
  return status;
}

/* What is wrong with a number outside its range. A NaN fails every comparison. */
static inline {{ prefix }}_status {{ prefix }}_fault_of({{ prefix }}_real value)
{
  {{ prefix }}_status status = {{ PREFIX }}_NOT_FINITE;
  if ((value >= -{{ "DBL_MAX" if real == "double" else "FLT_MAX" }}) && (value <= {{ "DBL_MAX" if real == "double" else "FLT_MAX" }})) {
    status = {{ PREFIX }}_OUT_OF_RANGE;
  }
  return status;
}

/* One number in its range. */
static inline {{ prefix }}_status {{ prefix }}_check_number({{ prefix }}_real value, {{ prefix }}_real low, {{ prefix }}_real high)
{
  {{ prefix }}_status status = {{ PREFIX }}_OK;
  if (!((value >= low) && (value <= high))) {
    status = {{ prefix }}_fault_of(value);
  }
  return status;
}

/* Numbers in the same range. */
static inline {{ prefix }}_status {{ prefix }}_check_alike(const {{ prefix }}_real *values, size_t length, {{ prefix }}_real low,
                                                     {{ prefix }}_real high)
{
  {{ prefix }}_status status = {{ PREFIX }}_OK;
  size_t i;
  for (i = 0U; i < length; ++i) {
    if (!((values[i] >= low) && (values[i] <= high))) {
      status = {{ prefix }}_fault_of(values[i]);
    }
  }
  return status;
}

/* Numbers in a range each. */
static inline {{ prefix }}_status {{ prefix }}_check_each(const {{ prefix }}_real *values, size_t length,
                                                    const {{ prefix }}_real *low, const {{ prefix }}_real *high)
{
  {{ prefix }}_status status = {{ PREFIX }}_OK;
  size_t i;
  for (i = 0U; i < length; ++i) {
    if (!((values[i] >= low[i]) && (values[i] <= high[i]))) {
      status = {{ prefix }}_fault_of(values[i]);
    }
  }
  return status;
}

/* Angles that turn freely without their whole turns, the others as they are. The first part of a turn has so few digits
 * that its multiples are exact. */
static inline void {{ prefix }}_unwind(const {{ prefix }}_real *values, size_t length, const int *turns, {{ prefix }}_real *turned)
{
  size_t i;
  for (i = 0U; i < length; ++i) {
    turned[i] = values[i];
    if (turns[i] != 0) {
      const {{ prefix }}_real count = floor((values[i] / {{ number(turn) }}) + {{ number(0.5) }});
      turned[i] = (values[i] - (count * {{ number(turn_parts[0]) }})) - (count * {{ number(turn_parts[1]) }});
    }
  }
}

/* Results. */
static inline {{ prefix }}_status {{ prefix }}_check_results(const {{ prefix }}_real *values, size_t length)
{
  {{ prefix }}_status status = {{ PREFIX }}_OK;
  size_t i;
  for (i = 0U; i < length; ++i) {
    if (!((values[i] >= -{{ "DBL_MAX" if real == "double" else "FLT_MAX" }}) && (values[i] <= {{ "DBL_MAX" if real == "double" else "FLT_MAX" }}))) {
      status = {{ PREFIX }}_NUMERICAL_FAILURE;
    }
  }
  return status;
}

#endif
