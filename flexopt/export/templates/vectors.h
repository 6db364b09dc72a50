/* Rows of inputs, parameters, 1 where a joint lies beyond its limit, outputs computed in Python, and the errors
 * allowed, for each function. */
#ifndef {{ PREFIX }}_VECTORS_H
#define {{ PREFIX }}_VECTORS_H

#include "{{ prefix }}_control.h"

enum { VECTOR_COUNT = {{ count }} };

{% for name, values in vectors.items() %}
static const {{ prefix }}_real {{ name }}_vectors[{{ values | length }}] = {{ listed(values, "") }};

{% endfor %}
static const {{ prefix }}_real *const vectors[{{ vectors | length }}] = { {{- vectors | join("_vectors, ") }}_vectors};

#endif
