/* {{ title | c_text }} */

#include <math.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

#define MODEL_TOKEN "{{ token }}"
#define MODEL_KEY 0x{{ "%016x" | format(key) }}ULL
{{ content }}
{% include "export/fmu/templates/fmi" ~ version[0] ~ ".c" %}
