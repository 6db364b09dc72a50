/* Replays calls from a file, on a workstation or on a microcontroller with semihosting: driver INPUTS OUTPUTS.
 *
 * INPUTS: blocks of four 32-bit words (function, calls, repeats, 0), then for each call one word of faults to make and
 * the reals of the input and of the parameters. OUTPUTS: one word, the ticks of a known number of instructions; for each
 * block its calls, three words each (status, ticks of all repeats, whether the output is as before) and the reals of the
 * output; then one word, the bytes of stack used. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "{{ prefix }}_table.h"

/* What a microcontroller is asked for; a workstation has nothing of it. */
#ifdef FLEXOPT_TARGET
uint32_t target_calibrate(void);
uint32_t target_ticks(void);
void target_paint_stack(void);
uint32_t target_stack_used(void);
#else
static uint32_t target_calibrate(void) { return 0; }
static uint32_t target_ticks(void) { return 0; }
static void target_paint_stack(void) {}
static uint32_t target_stack_used(void) { return 0; }
#endif

enum { NULL_IN = 1, NULL_PARAMETERS = 2, NULL_OUT = 4, NULL_WORKSPACE = 8, MISALIGNED = 16, SHORT = 32 };

static {{ prefix }}_real in[LARGEST_IN], parameters[N_PARAMETERS + 1], out[LARGEST_OUT], before[LARGEST_OUT];
static {{ prefix }}_real workspace[{{ PREFIX }}_WORKSPACE + 1U];

static void read_words(FILE *file, void *target, size_t bytes)
{
  if (fread(target, 1, bytes, file) != bytes) {
    fputs("driver: the input file is too short\n", stderr);
    exit(2);
  }
}

static void replay(const table_entry *f, uint32_t repeats, FILE *source, FILE *sink)
{
  uint32_t fault, answer[3], r, start;
  /* Bytes, so that the misaligned address is never one of reals. */
  unsigned char *bytes = (unsigned char *)workspace;
  {{ prefix }}_real *memory = workspace;
  size_t length = f->workspace;
  read_words(source, &fault, sizeof fault);
  read_words(source, in, f->n_in * sizeof *in);
  read_words(source, parameters, f->n_parameters * sizeof *parameters);
  memset(out, 0xA5, sizeof out);
  memcpy(before, out, sizeof out);
  if (fault & NULL_WORKSPACE) {
    memory = NULL;
  } else if (fault & MISALIGNED) {
    void *moved = bytes + 1;
    memory = ({{ prefix }}_real *)moved;
  }
  length -= (fault & SHORT) ? 1U : 0U;
  start = target_ticks();
  answer[0] = 0;
  for (r = 0; r < repeats; ++r) {
    answer[0] = (uint32_t)f->call((fault & NULL_IN) ? NULL : in, (fault & NULL_PARAMETERS) ? NULL : parameters,
                                  (fault & NULL_OUT) ? NULL : out, memory, length);
  }
  answer[1] = (target_ticks() - start) & 0xFFFFFFU; /* the counter has 24 bits */
  answer[2] = memcmp(before, out, sizeof out) == 0;
  fwrite(answer, sizeof answer, 1, sink);
  fwrite(out, sizeof *out, f->n_out, sink);
}

int main(int argc, char **argv)
{
  FILE *source, *sink;
  uint32_t block[4], i, used;
  if (argc < 3) {
    fputs("driver INPUTS OUTPUTS\n", stderr);
    return 2;
  }
  source = fopen(argv[1], "rb");
  sink = fopen(argv[2], "wb");
  if ((source == NULL) || (sink == NULL)) {
    fputs("driver: a file cannot be opened\n", stderr);
    return 2;
  }
  used = target_calibrate();
  fwrite(&used, sizeof used, 1, sink);
  while (fread(block, sizeof block, 1, source) == 1) {
    if (block[0] >= (uint32_t)TABLE_LENGTH) {
      fputs("driver: no such function\n", stderr);
      return 2;
    }
    for (i = 0; i < block[1]; ++i) {
      replay(&table[block[0]], block[2], source, sink);
    }
    used = 0;
    if (block[1] > 0U) {
      const table_entry *f = &table[block[0]];
      target_paint_stack();
      (void)f->call(in, parameters, out, workspace, f->workspace);
      used = target_stack_used();
    }
    fwrite(&used, sizeof used, 1, sink);
  }
  fclose(source);
  return fclose(sink) == 0 ? EXIT_SUCCESS : EXIT_FAILURE;
}
