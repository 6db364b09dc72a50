/* The starts that wait, best first, none twice. */
#ifndef OPTIMISER_STARTS_H
#define OPTIMISER_STARTS_H

#include "optimiser_project.h"

/* Whether a climb has begun nearby. */
static bool tried(const workspace_t *s, const point_t *x)
{
  bool close = (s->climbed > 0) && near(s, x, &s->first, s->from, s->apart);
  for (int k = 0; (k < s->n_tried) && !close; k++) {
    close = near(s, x, &s->starts[k], s->from, s->apart);
  }
  return close;
}

/* Keep x among the best starts that wait, highest V first; grid says that it is a peak of a curve, else neighbours count
 * as one. */
static void keep(workspace_t *s, int most, const point_t *x, bool grid)
{
  int at = s->n_tried;
  int twin = -1;
  if (!grid && tried(s, x)) {
    return;
  }
  for (int k = s->n_tried; (k < s->n_starts) && !grid && (twin < 0); k++) {
    twin = near(s, x, &s->starts[k], s->from, s->apart) ? k : -1;
  }
  if (twin >= 0) {
    if (x->value <= s->starts[twin].value) {
      return;
    }
    for (int l = twin; l < (s->n_starts - 1); l++) {
      s->starts[l] = s->starts[l + 1];
    }
    s->n_starts--;
  }
  for (int k = s->n_tried; k < s->n_starts; k++) {
    at += (x->value > s->starts[k].value) ? 0 : 1;
  }
  if (at < most) {
    s->n_starts += s->n_starts < most;
    for (int l = s->n_starts - 1; l > at; l--) {
      s->starts[l] = s->starts[l - 1];
    }
    s->starts[at] = *x;
  }
}

/* The trial becomes the present point where it is nearer to start than `nearest`, a squared distance in x, or that is
 * negative: none yet. Returns the smaller one. */
static real_t keep_nearer(workspace_t *s, const real_t *start, real_t nearest)
{
  real_t square = R(0.0);
  for (int i = 0; i < NZ; i++) {
    const real_t away = (s->memory.trial.z[i] - start[i]) / s->scales[i];
    square += away * away;
  }
  if ((nearest < R(0.0)) || (square < nearest)) {
    s->present = s->memory.trial;
    return square;
  }
  return nearest;
}

#endif /* OPTIMISER_STARTS_H */
