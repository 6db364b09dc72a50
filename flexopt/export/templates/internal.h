/* Checks that every function of the bundle makes. Not for users. */
#ifndef ${PREFIX}_INTERNAL_H
#define ${PREFIX}_INTERNAL_H

#include <float.h>
#include <stdint.h>

#include "${prefix}_control.h"

/* Pointers and workspace; `given` says whether no pointer is NULL. */
static inline ${prefix}_status ${prefix}_check_call(int given, const ${prefix}_real *workspace, size_t length,
                                                    size_t needed)
{
  ${prefix}_status status = ${PREFIX}_OK;
  if ((given == 0) || (workspace == NULL)) {
    status = ${PREFIX}_NULL_POINTER;
  } else if (((uintptr_t)workspace % sizeof(${prefix}_real)) != 0U) {
    status = ${PREFIX}_BAD_WORKSPACE;
  } else if (length < needed) {
    status = ${PREFIX}_BAD_WORKSPACE;
  } else {
    status = ${PREFIX}_OK;
  }
  return status;
}

/* What is wrong with a number outside its range. A NaN fails every comparison. */
static inline ${prefix}_status ${prefix}_fault_of(${prefix}_real value)
{
  ${prefix}_status status = ${PREFIX}_NOT_FINITE;
  if ((value >= -$REAL_MAX) && (value <= $REAL_MAX)) {
    status = ${PREFIX}_OUT_OF_RANGE;
  }
  return status;
}

/* One number in its range. */
static inline ${prefix}_status ${prefix}_check_number(${prefix}_real value, ${prefix}_real low, ${prefix}_real high)
{
  ${prefix}_status status = ${PREFIX}_OK;
  if (!((value >= low) && (value <= high))) {
    status = ${prefix}_fault_of(value);
  }
  return status;
}

/* Numbers in the same range. */
static inline ${prefix}_status ${prefix}_check_alike(const ${prefix}_real *values, size_t length, ${prefix}_real low,
                                                     ${prefix}_real high)
{
  ${prefix}_status status = ${PREFIX}_OK;
  size_t i;
  for (i = 0U; i < length; ++i) {
    if (!((values[i] >= low) && (values[i] <= high))) {
      status = ${prefix}_fault_of(values[i]);
    }
  }
  return status;
}

/* Numbers in a range each. */
static inline ${prefix}_status ${prefix}_check_each(const ${prefix}_real *values, size_t length,
                                                    const ${prefix}_real *low, const ${prefix}_real *high)
{
  ${prefix}_status status = ${PREFIX}_OK;
  size_t i;
  for (i = 0U; i < length; ++i) {
    if (!((values[i] >= low[i]) && (values[i] <= high[i]))) {
      status = ${prefix}_fault_of(values[i]);
    }
  }
  return status;
}

/* Results. */
static inline ${prefix}_status ${prefix}_check_results(const ${prefix}_real *values, size_t length)
{
  ${prefix}_status status = ${PREFIX}_OK;
  size_t i;
  for (i = 0U; i < length; ++i) {
    if (!((values[i] >= -$REAL_MAX) && (values[i] <= $REAL_MAX))) {
      status = ${PREFIX}_NUMERICAL_FAILURE;
    }
  }
  return status;
}

#endif
