{% from "export/templates/calls.h" import accepted with context %}
/* Calls every function of the bundle once, with inputs that it accepts. */
#include <stdio.h>
#include <stdlib.h>

#include "{{ prefix }}_control.h"

static {{ prefix }}_real workspace[{{ PREFIX }}_WORKSPACE];

int main(void)
{
{% if not baked %}
  const {{ prefix }}_parameters parameters = {{ PREFIX }}_DEFAULT_PARAMETERS;
{% endif %}
  {{ prefix }}_status status;
  int failures = 0;
  printf("%s: machine %s\n", {{ prefix }}_build_info()->bundle_sha256, {{ prefix }}_build_info()->machine);
{% for o, values in calls %}
{% set value = o.outputs[0].first %}
  {
{{ accepted(o, values) | indent(4, first=True) }}
    status = {{ prefix }}_{{ o.name }}(&in, {{ pass }}&out, workspace, {{ PREFIX }}_WORKSPACE);
    printf("{{ o.name }}: %s", {{ prefix }}_status_text(status));
    if ({{ prefix }}_has_output(status)) {
      printf("; {{ o.outputs[0].name }} %.9g ...", (double)out.{{ value }});
    } else {
      ++failures;
    }
    printf("\n");
  }
{% endfor %}
  return failures ? EXIT_FAILURE : EXIT_SUCCESS;
}
