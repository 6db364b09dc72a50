/* Instructions of the controller step three ways: CasADi's own single-precision export, the bundle's kernel, and the
 * bundle's function with its checks. Prints ticks for as many calls as it says first. */
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include "plain.h"
#include "${prefix}_controller.c"

uint32_t target_ticks(void);
uint32_t target_calibrate(void);

enum { CALLS = 64 };
static const ${prefix}_real row[] = $row;
static ${prefix}_torque_inverse_in in;
static ${prefix}_torque_inverse_out out;
static ${prefix}_real workspace[${PREFIX}_TORQUE_INVERSE_WORKSPACE];
static float plain_result[${PREFIX}_JOINTS + $n_guards];
$parameters

int main(void)
{
  uint32_t start, plain, kernel, whole, k;
  const ${prefix}_real *arg[$sz_arg + 1];
  ${prefix}_real *res[$sz_res + 1];
  const float *plain_arg[$sz_arg + 1];
  float *plain_res[$sz_res + 1];
  memcpy(&in, row, sizeof in);
$pointers
  plain_res[0] = plain_result;
  res[0] = workspace;
$guard_pointers
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
    if (!${prefix}_has_output(${prefix}_torque_inverse(&in, ${pass}&out, workspace, ${PREFIX}_TORQUE_INVERSE_WORKSPACE))) {
      return 1;
    }
  }
  whole = target_ticks() - start;
  printf("calls %u calibration %u plain %u kernel %u whole %u\n", (unsigned)CALLS, (unsigned)target_calibrate(),
         (unsigned)(plain & 0xFFFFFFu), (unsigned)(kernel & 0xFFFFFFu), (unsigned)(whole & 0xFFFFFFu));
  for (k = 0; k < (uint32_t)${PREFIX}_JOINTS; ++k) {
    const float error = plain_result[k] - (float)out.torque[k];
    const float size = plain_result[k] < 0.0f ? -plain_result[k] : plain_result[k];
    if (!(error <= 1e-4f * size && -error <= 1e-4f * size)) {
      return 1;
    }
  }
  return 0;
}
