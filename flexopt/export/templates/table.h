/* Every function of the bundle behind one signature, for the self-test and for flexopt verify. */
#ifndef ${PREFIX}_TABLE_H
#define ${PREFIX}_TABLE_H

#include "${prefix}_control.h"

typedef struct {
  const char *name;
  ${prefix}_status (*call)(const void *in, const void *parameters, void *out, ${prefix}_real *workspace, size_t length);
  unsigned n_in;         /* reals of its input */
  unsigned n_parameters; /* reals of the machine's parameters; 0 where they are baked */
  unsigned n_out;        /* reals of its output */
  unsigned workspace;    /* reals of its workspace */
} table_entry;

$adapters
enum { TABLE_LENGTH = $length, LARGEST_IN = $largest_in, LARGEST_OUT = $largest_out, N_PARAMETERS = $n_parameters };

static const table_entry table[TABLE_LENGTH] = {
$entries
};

#endif
