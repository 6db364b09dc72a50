/* Texts, build information{% if not baked %}, default parameters{% endif %}. */
#include "{{ prefix }}_internal.h"

const char *{{ prefix }}_status_text({{ prefix }}_status status)
{
  const char *text = "unknown status";
  switch (status) {
{% for name, text in statuses.items() %}
  case {{ PREFIX }}_{{ name }}:
    text = "{{ text }}";
    break;
{% endfor %}
  default:
    break;
  }
  return text;
}

int {{ prefix }}_has_output({{ prefix }}_status status)
{
  return ((status == {{ PREFIX }}_OK) || (status == {{ PREFIX }}_BEYOND_LIMIT)) ? 1 : 0;
}

const {{ prefix }}_info *{{ prefix }}_build_info(void)
{
  static const {{ prefix }}_info info = {
    {{ PREFIX }}_FLEXOPT_VERSION,
    {{ PREFIX }}_MACHINE,
    {{ PREFIX }}_MACHINE_SHA256,
    {{ PREFIX }}_BUNDLE_SHA256,
    "{{ real }}",
    "{{ parts | join(", ") }}"
  };
  return &info;
}
{% if not baked %}

{{ prefix }}_status {{ prefix }}_default_parameters({{ prefix }}_parameters *parameters)
{
  static const {{ prefix }}_real values[{{ PREFIX }}_PARAMETERS] = {{ listed(parameters) }};
  {{ prefix }}_status status = {{ PREFIX }}_NULL_POINTER;
  size_t i;
  if (parameters != NULL) {
    for (i = 0U; i < (size_t){{ PREFIX }}_PARAMETERS; ++i) {
      parameters->value[i] = values[i];
    }
    status = {{ PREFIX }}_OK;
  }
  return status;
}
{% endif %}
