/* Every function of the bundle behind one signature, for the self-test and for flexopt verify. */
#ifndef {{ PREFIX }}_TABLE_H
#define {{ PREFIX }}_TABLE_H

#include "{{ prefix }}_control.h"

typedef struct {
  const char *name;
  {{ prefix }}_status (*call)(const void *in, const void *parameters, void *out, {{ prefix }}_real *workspace, size_t length);
  unsigned n_in;         /* reals of its input */
  unsigned n_parameters; /* reals of the machine's parameters; 0 where they are baked */
  unsigned n_out;        /* reals of its output */
  unsigned workspace;    /* reals of its workspace */
} table_entry;

{% for o in operations %}
{% set name = prefix ~ "_" ~ o.name %}
/* The structures hold reals alone. */
typedef char {{ o.name }}_in_is_plain[(sizeof({{ name }}_in) == {{ o.n_in }}U * sizeof({{ prefix }}_real)) ? 1 : -1];
typedef char {{ o.name }}_out_is_plain[(sizeof({{ name }}_out) == {{ o.n_out }}U * sizeof({{ prefix }}_real)) ? 1 : -1];
static {{ prefix }}_status call_{{ o.name }}(const void *in, const void *parameters, void *out,
    {{ prefix }}_real *workspace, size_t length)
{
{% if baked %}
  (void)parameters;
{% endif %}
  return {{ name }}((const {{ name }}_in *)in, {% if not baked %}(const {{ prefix }}_parameters *)parameters, {% endif %}({{ name }}_out *)out, workspace, length);
}

{% endfor %}
enum { TABLE_LENGTH = {{ operations | length }}, LARGEST_IN = {{ operations | map(attribute="n_in") | max }}, LARGEST_OUT = {{ operations | map(attribute="n_out") | max }}, N_PARAMETERS = {{ sizes.PARAMETERS | default(0) }} };

static const table_entry table[TABLE_LENGTH] = {
{% for o in operations %}
  {"{{ o.name }}", call_{{ o.name }}, {{ o.n_in }}U, {{ sizes.PARAMETERS | default(0) }}U, {{ o.n_out }}U, {{ PREFIX }}_{{ o.name | upper }}_WORKSPACE}{% if not loop.last %},{% endif +%}
{% endfor %}
};

#endif
