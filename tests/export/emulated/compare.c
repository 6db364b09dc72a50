/* Instructions of the controller step three ways: CasADi's own single-precision export, the bundle's kernel, and the
 * bundle's function with its checks. Prints ticks for as many calls as it says first. */
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include "plain.h"
#include "{{ prefix }}_controller.c"

uint32_t target_ticks(void);
uint32_t target_calibrate(void);

enum { CALLS = 64 };
static const {{ prefix }}_real row[] = {{ listed(row) }};
static {{ prefix }}_torque_inverse_in in;
static {{ prefix }}_torque_inverse_out out;
static {{ prefix }}_real workspace[{{ PREFIX }}_TORQUE_INVERSE_WORKSPACE];
static float plain_result[{{ PREFIX }}_JOINTS + {{ o.guards | length }}];
{% if not baked %}
static const {{ prefix }}_parameters parameters = { {{- listed(parameters) -}} };
{% endif %}

int main(void)
{
  uint32_t start, plain, kernel, whole, k;
  const {{ prefix }}_real *arg[{{ kernel.sz_arg() }} + 1];
  {{ prefix }}_real *res[{{ kernel.sz_res() }} + 1];
  const float *plain_arg[{{ kernel.sz_arg() }} + 1];
  float *plain_res[{{ kernel.sz_res() }} + 1];
  memcpy(&in, row, sizeof in);
{% for f in o.inputs %}
  arg[{{ loop.index0 }}] = plain_arg[{{ loop.index0 }}] = {{ "" if f.dimensions else "&" }}in.{{ f.name }};
{% endfor %}
{% if not baked %}
  arg[{{ o.inputs | length }}] = plain_arg[{{ o.inputs | length }}] = parameters.value;
{% endif %}
  plain_res[0] = plain_result;
  res[0] = workspace;
{% for g in o.guards %}
  plain_res[{{ loop.index }}] = &plain_result[{{ o.n_out + loop.index0 }}];
  res[{{ loop.index }}] = &workspace[{{ o.n_out + loop.index0 }}];
{% endfor %}
  start = target_ticks();
  for (k = 0; k < CALLS; ++k) {
    torque_inverse(plain_arg, plain_res, NULL, NULL, 0);
  }
  plain = target_ticks() - start;
  start = target_ticks();
  for (k = 0; k < CALLS; ++k) {
    (void)kernel_torque_inverse(arg, res);
  }
  kernel = target_ticks() - start;
  start = target_ticks();
  for (k = 0; k < CALLS; ++k) {
    if (!{{ prefix }}_has_output({{ prefix }}_torque_inverse(&in, {% if not baked %}&parameters, {% endif %}&out, workspace, {{ PREFIX }}_TORQUE_INVERSE_WORKSPACE))) {
      return 1;
    }
  }
  whole = target_ticks() - start;
  printf("calls %u calibration %u plain %u kernel %u whole %u\n", (unsigned)CALLS, (unsigned)target_calibrate(),
         (unsigned)(plain & 0xFFFFFFu), (unsigned)(kernel & 0xFFFFFFu), (unsigned)(whole & 0xFFFFFFu));
  for (k = 0; k < (uint32_t){{ PREFIX }}_JOINTS; ++k) {
    const float error = plain_result[k] - (float)out.torque[k];
    const float size = plain_result[k] < 0.0f ? -plain_result[k] : plain_result[k];
    if (!(error <= 1e-4f * size && -error <= 1e-4f * size)) {
      return 1;
    }
  }
  return 0;
}
