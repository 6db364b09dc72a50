{% from "export/templates/calls.h" import prototype with context %}
{% macro member(f, range) %}
{{ comment((f.unit or "dimensionless") ~ "; " ~ f.text ~ range, "  ") }}
  {{ prefix }}_real {{ f.name }}{% for d in f.dimensions %}[{{ PREFIX }}_{{ d }}]{% endfor %};
{%- endmacro %}
/* Controller functions of the machine {{ machine.name | c_text }}: {{ parts | join(", ") }}.
 *
 * Written by flexopt {{ flexopt }} for the machine "{{ machine.name | c_text }}".
 *   machine  sha256 {{ machine.content_hash }}
 *   bundle   sha256 {{ bundle_hash }}
 *
 * Units are SI, angles in radians, positive about the axes of the joints, in a plane counter-clockwise; points in the
 * inertial frame, origin on the ground. All reals are {{ real }}. Two-dimensional arrays are row-major. Every function
 *   - checks each input, and writes its output where it returns {{ PREFIX }}_OK, or {{ PREFIX }}_BEYOND_LIMIT, a warning; with every
 *     other status the output stays as it was ({{ prefix }}_has_output());
 *   - keeps no state, allocates nothing, does not recurse: it may be interrupted and called again with another workspace;
 *   - runs the same bounded number of steps whatever the numbers.
 * Input and output may share memory; the workspace may not share any with them.
 */
#ifndef {{ PREFIX }}_CONTROL_H
#define {{ PREFIX }}_CONTROL_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

#define {{ PREFIX }}_FLEXOPT_VERSION "{{ flexopt }}"
#define {{ PREFIX }}_MACHINE "{{ machine.name | c_text }}"
#define {{ PREFIX }}_MACHINE_SHA256 "{{ machine.content_hash }}"
#define {{ PREFIX }}_BUNDLE_SHA256 "{{ bundle_hash }}"
{% for part in parts %}
#define {{ PREFIX }}_HAS_{{ part | upper }} 1
{% endfor %}

typedef {{ real }} {{ prefix }}_real;

/* Sizes. */
enum {
{% for name, value in sizes.items() %}
  {{ PREFIX }}_{{ name }} = {{ value }}{% if not loop.last %},{% endif %} {{ comment(size_texts[name]) }}
{% endfor %}
};

/* Measured joints may lie beyond the machine's limits by so much: sensors are calibrated to a degree or so, end stops give
 * way, a loop overshoots. The outputs are then computed as ever and come with {{ PREFIX }}_BEYOND_LIMIT; farther out a sensor has failed.
 * Hinges without limits, and the placement's angles, may have been counted on over many turns, up to {{ "%g" | format(counted_max) }} rad: whole turns
 * are taken off. */
#define {{ PREFIX }}_LIMIT_ALLOWANCE_RAD {{ number(allowance.rad) }} /* rad, of hinges */
#define {{ PREFIX }}_LIMIT_ALLOWANCE_M {{ number(allowance.m) }} /* m, of slides */

{% for about, kind, entries in enumerations if entries %}
{{ comment(about) }}
{% for text in orientation.values() if kind == "AXIS" %}
{{ comment(text) }}
{% endfor %}
enum {
{% for word, unit in entries %}
  {{ PREFIX }}_{{ kind }}_{{ word }} = {{ loop.index0 }}{% if not loop.last %},{% endif %}{{ " " ~ comment(unit) if unit else "" }}
{% endfor %}
};

{% endfor %}
/* What a function returns. */
typedef enum {
{% for name, text in statuses.items() %}
  {{ PREFIX }}_{{ name }} = {{ loop.index0 }}{% if not loop.last %},{% endif %} {{ comment(text) }}
{% endfor %}
} {{ prefix }}_status;

/* A sentence for a status; never NULL. */
const char *{{ prefix }}_status_text({{ prefix }}_status status);

/* 1 where a function that returned this status wrote its output, else 0. */
int {{ prefix }}_has_output({{ prefix }}_status status);

/* Where the library comes from, to be compared with the macros above. */
typedef struct {
  const char *flexopt_version;
  const char *machine;
  const char *machine_sha256;
  const char *bundle_sha256;
  const char *real;
  const char *parts;
} {{ prefix }}_info;

const {{ prefix }}_info *{{ prefix }}_build_info(void);

{% if baked %}
/* The machine's parameters are constants inside the functions. */
{% else %}
{{ comment("The machine's parameters, indexed by the enumeration above; change them (the payload, say) whenever you like. They "
           "are checked at each call, as far as the function called uses them.") }}
typedef struct {
  {{ prefix }}_real value[{{ PREFIX }}_PARAMETERS];
} {{ prefix }}_parameters;

/* The machine as it was exported. */
#define {{ PREFIX }}_DEFAULT_PARAMETERS { {{ listed(parameters, "") | replace("\n", " \\\n") }} }

/* Write the same into *parameters. */
{{ prefix }}_status {{ prefix }}_default_parameters({{ prefix }}_parameters *parameters);
{% endif %}

/* Caller-owned memory: an array of {{ prefix }}_real, at least as long as the function's own macro says; this length suits
 * all of them. Its content need not be kept between calls, and two calls at a time need two of them. */
#define {{ PREFIX }}_WORKSPACE {{ workspaces.values() | max }}U

{% for o in operations %}
{% set name = prefix ~ "_" ~ o.name %}
{{ comment(o.about(PREFIX)) }}
typedef struct {
{% for f in o.inputs %}
{{ member(f, f.range_text) }}
{% endfor %}
} {{ name }}_in;

typedef struct {
{% for f in o.outputs %}
{{ member(f, "") }}
{% endfor %}
} {{ name }}_out;

#define {{ PREFIX }}_{{ o.name | upper }}_WORKSPACE {{ workspaces[o.name] }}U

{{ prototype(o) }};

{% endfor %}
#ifdef __cplusplus
}
#endif

#endif
