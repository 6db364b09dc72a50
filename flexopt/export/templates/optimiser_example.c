static {{ prefix }}_optimiser_workspace memory;
static const {{ prefix }}_real near_optimum[{{ PREFIX }}_OPTIMISER_N_Z] = {
{%- for x in start %}{{ number(x) }}{% if not loop.last %}, {% endif %}{% endfor -%}
}; /* or NULL */
{{ prefix }}_optimiser_problem problem;
{{ prefix }}_optimiser_options options;
{{ prefix }}_optimiser_result answer;
{{ prefix }}_optimiser_status found;
(void){{ prefix }}_optimiser_default_problem(&problem);
(void){{ prefix }}_optimiser_default_options(&options);
{% for x in target %}
problem.target[{{ loop.index0 }}] = {{ number(x) }};
{% endfor %}
found = {{ prefix }}_optimiser_solve(&problem, near_optimum, &options, &memory, &answer);
