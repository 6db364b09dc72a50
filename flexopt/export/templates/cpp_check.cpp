{% from "export/templates/calls.h" import accepted with context %}
// The bundle from C++: the header compiles, the library links, a call succeeds and a refusal refuses.
#include <cstdio>
#include <cstring>
#include <vector>

#include "{{ prefix }}_control.h"

int main() {
  std::vector<{{ prefix }}_real> workspace({{ PREFIX }}_WORKSPACE);
{% if not baked %}
  const {{ prefix }}_parameters parameters = {{ PREFIX }}_DEFAULT_PARAMETERS;
{% endif %}
{{ accepted(o, values) | indent(2, first=True) }}
  const {{ prefix }}_status good = {{ prefix }}_{{ o.name }}(&in, {{ pass }}&out, workspace.data(), workspace.size());
  const {{ prefix }}_status bad = {{ prefix }}_{{ o.name }}(nullptr, {{ pass }}&out, workspace.data(), workspace.size());
  const bool same = std::strcmp({{ prefix }}_build_info()->bundle_sha256, {{ PREFIX }}_BUNDLE_SHA256) == 0;
  const bool passed = same && good == {{ PREFIX }}_OK && bad == {{ PREFIX }}_NULL_POINTER;
  std::printf("C++: %s\n", passed ? "passed" : "FAILED");
  return passed ? 0 : 1;
}
