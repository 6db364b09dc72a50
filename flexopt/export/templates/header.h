/* $title
 *
 * Written by flexopt $flexopt for the machine "$machine".
 *   machine  sha256 $machine_hash
 *   bundle   sha256 $bundle_hash
 *
 * Units are SI, angles in radians, counter-clockwise positive; points in the inertial frame, origin on the ground. All
 * reals are $real. Two-dimensional arrays are row-major. Every function
 *   - checks each input, and writes its output where it returns ${PREFIX}_OK, or ${PREFIX}_BEYOND_LIMIT, a warning; with every
 *     other status the output stays as it was (${prefix}_has_output());
 *   - keeps no state, allocates nothing, does not recurse: it may be interrupted and called again with another workspace;
 *   - runs the same bounded number of steps whatever the numbers.
 * Input and output may share memory; the workspace may not share any with them.
 */
#ifndef ${PREFIX}_CONTROL_H
#define ${PREFIX}_CONTROL_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

#define ${PREFIX}_FLEXOPT_VERSION "$flexopt"
#define ${PREFIX}_MACHINE "$machine"
#define ${PREFIX}_MACHINE_SHA256 "$machine_hash"
#define ${PREFIX}_BUNDLE_SHA256 "$bundle_hash"
$part_macros

typedef $real ${prefix}_real;

/* Sizes. */
enum {
$sizes
};

/* Measured joints may lie beyond the machine's limits by so much: sensors are calibrated to a degree or so, end stops give
 * way, a loop overshoots. The outputs are then computed as ever and come with ${PREFIX}_BEYOND_LIMIT; farther out a sensor has failed.
 * Hinges without limits, and the placement's angles, may have been counted on over many turns, up to $counted_max rad: whole turns
 * are taken off. */
#define ${PREFIX}_LIMIT_ALLOWANCE_RAD $allowance_rad /* rad, of hinges */
#define ${PREFIX}_LIMIT_ALLOWANCE_M $allowance_m /* m, of slides */

$enums
/* What a function returns. */
typedef enum {
$statuses
} ${prefix}_status;

/* A sentence for a status; never NULL. */
const char *${prefix}_status_text(${prefix}_status status);

/* 1 where a function that returned this status wrote its output, else 0. */
int ${prefix}_has_output(${prefix}_status status);

/* Where the library comes from, to be compared with the macros above. */
typedef struct {
  const char *flexopt_version;
  const char *machine;
  const char *machine_sha256;
  const char *bundle_sha256;
  const char *real;
  const char *parts;
} ${prefix}_info;

const ${prefix}_info *${prefix}_build_info(void);

$parameters
/* Caller-owned memory: an array of ${prefix}_real, at least as long as the function's own macro says; this length suits
 * all of them. Its content need not be kept between calls, and two calls at a time need two of them. */
#define ${PREFIX}_WORKSPACE ${workspace}U

$operations
$others#ifdef __cplusplus
}
#endif

#endif
