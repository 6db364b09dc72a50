{# What depends on the model: tables, kernels, and a wrapper with one pointer for each input and output of a kernel. #}
{% macro table(declaration, size, entries) %}
static const {{ declaration }}[{{ size }}] = {
{{ wrapped(entries, "  ") }}
};
{% endmacro %}
{% macro reals(name, values) %}
{% set entries %}{% for value in values %}{{ real(value) }}{% if not loop.last %}, {% endif %}{% endfor %}{% endset %}
{{ table("double " ~ name, values | length, entries) -}}
{% endmacro %}
{% macro texts(name, values) %}
static const char *const {{ name }}[{{ values | length }}] = {
{% for text in values %}
  "{{ text | c_text }}"{% if not loop.last %},{% endif +%}
{% endfor %}
};
{% endmacro %}
{% macro variables(group, listed) %}
{{ texts(group ~ "_name", listed | map(attribute="name") | list) -}}
{% for field in ("start", "low", "high") %}
{{ reals(group ~ "_" ~ field, listed | map(attribute=field) | list) -}}
{% endfor %}
{% endmacro %}
{% for name, value in sizes.items() %}
#define {{ name }} {{ value }}
{% endfor %}
{{ variables("parameter", model.parameters) -}}
{{ table("unsigned char parameter_tunable", model.parameters | length, model.parameters | map(attribute="tunable") | map("int") | join(", ")) -}}
{{ variables("input", model.inputs) -}}
{% if sizes.MODEL_EXCHANGE %}
{{ reals("state_nominal", model.states | map(attribute="nominal") | list) -}}
{% else %}
{{ table("int input_rate", model.inputs | length, model.rate_of | join(", ")) -}}
{% endif %}
{{ texts("output_name", model.outputs | map(attribute="name") | list) -}}
{{ reals("guard_low", model.guards | map(attribute="low") | list) -}}
{{ reals("guard_high", model.guards | map(attribute="high") | list) -}}
{{ texts("guard_text", model.guards | map(attribute="text") | list) }}
{{ kernels }}
{% for name, inputs, outputs, kernel in wrappers %}
static void {{ name }}(const double *{{ inputs | join(", const double *") }}, double *{{ outputs | join(", double *") }}, double *w) {
{% if "arg" in kernel.parameters %}
  const double *arg[{{ kernel.sz_arg }}] = { {{- inputs | join(", ") -}} };
{% endif %}
{% if "res" in kernel.parameters %}
  double *res[{{ kernel.sz_res }}] = { {{- outputs | join(", ") -}} };
{% endif %}
{% if "iw" in kernel.parameters %}
  int iw[{{ [1, kernel.sz_iw] | max }}];
{% endif %}
{% if "w" not in kernel.parameters %}
  (void)w;
{% endif %}
  (void){{ kernel.name }}({{ kernel.parameters | join(", ") }});
}
{{ "\n" if not loop.last else "" }}
{%- endfor %}
