{# The library's functions in the bundle's precision: generated text and hand-written one name those for double. #}
{% if real == "float" %}
/* Single precision throughout. */
{% for name in ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "sqrt", "exp", "log", "log10", "fabs", "floor", "ceil", "expm1", "log1p", "erf") %}
#define {{ name }}(x) {{ name }}f(x)
{% endfor %}
{% for name in ("atan2", "pow", "fmin", "fmax", "fmod", "copysign", "hypot") %}
#define {{ name }}(x, y) {{ name }}f((x), (y))
{% endfor %}

{% endif %}
