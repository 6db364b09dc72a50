{# One public function: the checks of its arguments, the call of its kernel, the copies of its results. #}
{% from "export/templates/calls.h" import prototype with context %}
{% macro unless_failed() %}
  if (status == {{ PREFIX }}_OK) {
    status = {{ caller() }};
  }
{% endmacro %}
{% set given = ["(in != NULL)", "(out != NULL)"] + ([] if baked else ["(parameters != NULL)"]) %}
{% set needed = PREFIX ~ "_" ~ o.name | upper ~ "_WORKSPACE" %}
{% set work = {"arg": "arg", "res": "res", "iw": "iw", "w": "&workspace[%d]" | format(o.n_out + o.guards | length)} %}
{% set measured = o.inputs | selectattr("has_margin") | list %}
{{ prototype(o) }}
{
{% for f in o.inputs if f.dimensions and not f.same_range %}
  static const {{ prefix }}_real {{ f.name }}_low[{{ f.length }}] = {{ listed(f.low) }};
  static const {{ prefix }}_real {{ f.name }}_high[{{ f.length }}] = {{ listed(f.high) }};
{% endfor %}
{% for f in o.inputs if f.turns %}
  static const int {{ f.name }}_turns[{{ f.length }}] = { {{- f.turning | map("int") | join(", ") -}} };
  {{ prefix }}_real turned_{{ f.name }}[{{ f.length }}];
{% endfor %}
{% for f in measured %}
  static const {{ prefix }}_real {{ f.name }}_least[{{ f.length }}] = {{ listed(f.design[0]) }};
  static const {{ prefix }}_real {{ f.name }}_most[{{ f.length }}] = {{ listed(f.design[1]) }};
{% endfor %}
  const {{ prefix }}_real *arg[{{ kernel.sz_arg }}];
  {{ prefix }}_real *res[{{ kernel.sz_res }}];
{% if "iw" in kernel.parameters %}
  int iw[{{ kernel.sz_iw }}];
{% endif %}
{% if measured %}
  {{ prefix }}_status remark = {{ PREFIX }}_OK;
{% endif %}
  {{ prefix }}_status status = {{ prefix }}_check_call({{ given | join(" && ") }},
      workspace, workspace_length, {{ needed }});
{% for where, f in (("in", o.inputs[0]), ("out", o.outputs[0])) %}
{% call unless_failed() %}{{ prefix }}_check_apart(workspace, {{ needed }}, &{{ where }}->{{ f.first }}, sizeof(*{{ where }})){% endcall %}
{% endfor %}
{% if not baked %}
{% call unless_failed() %}{{ prefix }}_check_apart(workspace, {{ needed }}, parameters->value, sizeof(*parameters)){% endcall %}
{% endif %}
{% for f in o.inputs %}
{% if not f.dimensions %}
{% call unless_failed() %}{{ prefix }}_check_number(in->{{ f.name }}, {{ number(f.low[0]) }}, {{ number(f.high[0]) }}){% endcall %}
{% elif f.same_range %}
{% call unless_failed() %}{{ prefix }}_check_alike(in->{{ f.name }}, {{ f.length }}U, {{ number(f.low[0]) }}, {{ number(f.high[0]) }}){% endcall %}
{% else %}
{% call unless_failed() %}{{ prefix }}_check_each(in->{{ f.name }}, {{ f.length }}U, {{ f.name }}_low, {{ f.name }}_high){% endcall %}
{% endif %}
{% endfor %}
{% for name, low, high in read %}
{% call unless_failed() %}{{ prefix }}_check_number(parameters->value[{{ name }}], {{ number(low) }}, {{ number(high) }}){% endcall %}
{% endfor %}
  if (status == {{ PREFIX }}_OK) {
{% for f in o.inputs if f.turns %}
    {{ prefix }}_unwind(in->{{ f.name }}, {{ f.length }}U, {{ f.name }}_turns, turned_{{ f.name }});
{% endfor %}
{% for f in measured %}
    if ({{ prefix }}_check_each(in->{{ f.name }}, {{ f.length }}U, {{ f.name }}_least, {{ f.name }}_most) != {{ PREFIX }}_OK) {
      remark = {{ PREFIX }}_BEYOND_LIMIT;
    }
{% endfor %}
{% for f in o.inputs %}
    arg[{{ loop.index0 }}] = {{ "turned_" if f.turns else "in->" if f.dimensions else "&in->" }}{{ f.name }};
{% endfor %}
{% if not baked %}
    arg[{{ o.inputs | length }}] = parameters->value;
{% endif %}
{% for offset in o.offsets %}
    res[{{ loop.index0 }}] = &workspace[{{ offset }}];
{% endfor %}
    if ({{ kernel.name }}({% for p in kernel.parameters %}{{ work[p] }}{% if not loop.last %}, {% endif %}{% endfor %}) != 0) {
      status = {{ PREFIX }}_NUMERICAL_FAILURE;
    }
  }
{% for g in o.guards %}
  if ((status == {{ PREFIX }}_OK) && !(workspace[{{ o.n_out + loop.index0 }}]
      {%- if g.minimum is not none %} >= {{ number(g.minimum) }}{% else %} <= {{ number(g.maximum) }}{% endif %})) {
    status = {{ PREFIX }}_{{ g.status }};
  }
{% else %}

{% endfor %}
  if (status == {{ PREFIX }}_OK) {
    status = {{ prefix }}_check_results(workspace, {{ o.n_out }}U);
  }
  if (status == {{ PREFIX }}_OK) {
{% if o.outputs | selectattr("dimensions") | list %}
    size_t i;
{% endif %}
{% for f in o.outputs %}
{% set offset = o.offsets[loop.index0] %}
{% if f.dimensions %}
    for (i = 0U; i < {{ f.length }}U; ++i) {
      out->{{ f.name }}{% if f.shape | length == 2 %}[i / {{ f.shape[1] }}U][i % {{ f.shape[1] }}U]{% else %}[i]{% endif %} = workspace[{% if offset %}{{ offset }}U + {% endif %}i];
    }
{% else %}
    out->{{ f.name }} = workspace[{{ offset }}];
{% endif %}
{% endfor %}
    status = {{ "remark" if measured else PREFIX ~ "_OK" }};
  }
  return status;
}
