{# What a function of FMI refuses before all else. #}
{# A call in none of these modes. #}
{% macro refuse_unless(name, modes) %}
if (!permitted(m, {{ modes }}, "{{ fmi }}{{ name }}")) {
    return {{ fmi }}Error;
  }
{%- endmacro %}
{# Pointers, named after it, of which one is NULL. #}
{% macro refuse_null(name) %}
if ({{ varargs | join(" == NULL || ") }} == NULL) {
    return ({{ fmi }}Status)report(m, ERROR, "{{ fmi }}{{ name }}: a pointer is NULL");
  }
{%- endmacro %}
