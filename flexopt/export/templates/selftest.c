/* Compares every function with what flexopt computed in Python, and tries its refusals. Prints a line for each function;
 * exit status 0 when all agree. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "{{ prefix }}_table.h"
#include "{{ prefix }}_vectors.h"

static {{ prefix }}_real in[LARGEST_IN], parameters[N_PARAMETERS + 1], out[LARGEST_OUT], before[LARGEST_OUT];
static {{ prefix }}_real workspace[{{ PREFIX }}_WORKSPACE + 1U];

static int expect(const char *name, const char *what, {{ prefix }}_status status, {{ prefix }}_status wanted)
{
  int untouched = memcmp(out, before, sizeof out) == 0;
  if ((status != wanted) || !untouched) {
    printf("FAILED  %s: %s gave \"%s\"%s\n", name, what, {{ prefix }}_status_text(status), untouched ? "" : " and wrote output");
    return 1;
  }
  return 0;
}

int main(void)
{
  int failures = 0, k;
  printf("%s, flexopt %s, %s\n", {{ prefix }}_build_info()->machine, {{ prefix }}_build_info()->flexopt_version,
         {{ prefix }}_build_info()->real);
  if (strcmp({{ prefix }}_build_info()->bundle_sha256, {{ PREFIX }}_BUNDLE_SHA256) != 0) {
    printf("FAILED  header and library are of different bundles\n");
    ++failures;
  }
  for (k = 0; k < TABLE_LENGTH; ++k) {
    const table_entry *f = &table[k];
    const {{ prefix }}_real *row = vectors[k];
    double worst = 0.0;
    int i, failed = 0, refused = 0;
    unsigned j;
    for (i = 0; i < VECTOR_COUNT; ++i) {
      {{ prefix }}_status status, wanted;
      memcpy(in, row, f->n_in * sizeof *row);
      row += f->n_in;
      memcpy(parameters, row, f->n_parameters * sizeof *row);
      row += f->n_parameters;
      wanted = (*row > 0) ? {{ PREFIX }}_BEYOND_LIMIT : {{ PREFIX }}_OK;
      ++row;
      status = f->call(in, parameters, out, workspace, f->workspace);
      if (status == {{ PREFIX }}_NOT_ACCURATE) {
        ++refused;
      } else if (status != wanted) {
        printf("FAILED  %s: %s\n", f->name, {{ prefix }}_status_text(status));
        failed = 1;
      }
      for (j = 0; {{ prefix }}_has_output(status) && (j < f->n_out); ++j) {
        /* The error as a share of what is allowed. */
        double share = fabs((double)out[j] - (double)row[j]) / (double)row[f->n_out + j];
        if (!(share <= worst)) {
          worst = share;
        }
      }
      row += (size_t)2 * f->n_out;
    }
    failed |= !(worst <= 1.0) || (2 * refused > VECTOR_COUNT);
    /* The last input again, spoilt in several ways; the output must stay as it is. */
    memcpy(before, out, sizeof out);
    failed |= expect(f->name, "a NULL input", f->call(NULL, parameters, out, workspace, f->workspace), {{ PREFIX }}_NULL_POINTER);
    failed |= expect(f->name, "a NULL workspace", f->call(in, parameters, out, NULL, f->workspace), {{ PREFIX }}_NULL_POINTER);
    failed |= expect(f->name, "a short workspace", f->call(in, parameters, out, workspace, f->workspace - 1U),
                     {{ PREFIX }}_BAD_WORKSPACE);
    for (j = 0; j < f->n_in; ++j) {
      {{ prefix }}_real kept = in[j];
      in[j] = ({{ prefix }}_real)NAN;
      failed |= expect(f->name, "a NaN", f->call(in, parameters, out, workspace, f->workspace), {{ PREFIX }}_NOT_FINITE);
      in[j] = -({{ prefix }}_real)INFINITY;
      failed |= expect(f->name, "an infinite input", f->call(in, parameters, out, workspace, f->workspace), {{ PREFIX }}_NOT_FINITE);
      in[j] = ({{ prefix }}_real){{ huge }};
      failed |= expect(f->name, "a huge input", f->call(in, parameters, out, workspace, f->workspace), {{ PREFIX }}_OUT_OF_RANGE);
      in[j] = kept;
    }
    failed |= expect(f->name, "a workspace over the input", f->call(workspace, parameters, out, workspace, f->workspace),
                     {{ PREFIX }}_BAD_WORKSPACE);
    printf("%s  %-20s %d vectors, %d not accurate, largest error %.2g of what is allowed ({{ bar }} of each output's size)\n",
           failed ? "FAILED" : "passed", f->name, VECTOR_COUNT, refused, worst);
    failures += failed;
  }
  printf(failures ? "%d FAILED\n" : "all passed\n", failures);
  return failures ? EXIT_FAILURE : EXIT_SUCCESS;
}
