/* Numbers of the search that are the same for every machine, each with its reason; the configuration has the others. */
#ifndef OPTIMISER_CONSTANTS_H
#define OPTIMISER_CONSTANTS_H

#include "optimiser_config.h"

#define FINE (R(4.0) * EPSILON) /* as near to the target as most points come: below it no further step helps */

/* One climb. */
#define HALVINGS      10       /* the step is then 1e-5 of the first: a V that does not rise there rises nowhere */
#define SWEEPS        8        /* Jacobi doubles its digits with each of the last ones; for so few variables six suffice */
#define CLIMB_STEPS   60       /* a bound alone: whole calls of the benchmark take fewer */
#define LAST_CLIMBS   9000     /* a bound alone: the largest budget has fewer climbs of so many steps, two units each */
#define KICK          R(0.05)  /* away from a saddle, in x: seen in V far above rounding, and inside the same basin */
#define CURVATURE     R(1e-6)  /* positive curvature above it is V's own: of second derivatives' rounding it is far less */
#define CURVATURE_MIN R(1e-7)  /* of the model, so that flat directions give long steps, which STEP_MAX cuts, not infinite ones */
#define RISE_SHARE    R(1e-4)  /* of the rise to first order that a step must bring (Armijo's usual number) */
#define HALF_STEPS    3        /* so many halvings; after them quarters, as the model was wrong at this length */

/* Several climbs: all but the best are given up early, and go on in the end. */
#define PAUSE       (BUDGET - (BUDGET / 8)) /* from here on the best climb is finished first: an eighth is some steps with derivatives */
#define PATIENCE    2         /* steps before one may be given up: the first one is long, and its promise says little */
#define PROMISE     R(0.5)    /* share of what a step may bring that all after it may bring; a Newton's step leaves less */
#define RIDGE_STEPS 5         /* steps in which V must rise by a tenth; */
#define RIDGE_RISE  R(0.1)    /* slower climbs crawl along a ridge, and eat the budget of other starts, */
#define RIDGE_SLOPE R(1e-3)   /* unless the climb is nearly stationary, where little is left to rise */

/* Starts. */
#define APART        R(0.7)  /* rad, or of the reach: starts closer than this, at first, mostly climb to one optimum */
#define REPLACEMENTS 6       /* placements tried where a start cannot be brought onto the target: a handful, as each costs a way onto it */

/* Steps for which the Hessian has been learned; before: */
#define OUTDATED (-1) /* it was, but not here */
#define UNKNOWN  (-2) /* nothing */

#endif /* OPTIMISER_CONSTANTS_H */
