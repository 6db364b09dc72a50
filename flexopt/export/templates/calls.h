{# How functions of the bundle are declared and called. #}
{# The line that declares and begins a function. #}
{% macro prototype(o) %}
{% set name = prefix ~ "_" ~ o.name %}
{% set next = "\n" ~ " " * (prefix ~ "_status " ~ name ~ "(") | length %}
{{ prefix }}_status {{ name }}(const {{ name }}_in *in,{{ next }}
{%- if not baked %}const {{ prefix }}_parameters *parameters,{{ next }}{% endif -%}
{{ name }}_out *out,{{ next }}{{ prefix }}_real *workspace,{{ next }}size_t workspace_length)
{%- endmacro %}
{# Declarations of an input that is accepted, and of an output. #}
{% macro accepted(o, values) %}
const {{ prefix }}_{{ o.name }}_in in = { {%- for f, part in values %}{% if not loop.first %}, {% endif %}
{% if f.dimensions %}{ {%- endif %}{% for x in part %}{{ number(x) }}{% if not loop.last %}, {% endif %}{% endfor %}{% if f.dimensions -%} }{% endif %}
{% endfor -%} };
{{ prefix }}_{{ o.name }}_out out;
{%- endmacro %}
{# The same for people: members by name, with what they are. #}
{% macro named(o, values) %}
const {{ prefix }}_{{ o.name }}_in in = {
{% for f, part in values %}
  .{{ f.name }} = {% if f.dimensions %}{ {%- endif %}{% for x in part %}{{ number(x) }}{% if not loop.last %}, {% endif %}{% endfor %}{% if f.dimensions -%} }{% endif %}, /* {% if f.unit %}{{ f.unit | c_text }}; {% endif %}{{ f.text | c_text }} */
{% endfor %}
};
{{ prefix }}_{{ o.name }}_out out;
{%- endmacro %}
