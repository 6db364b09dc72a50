/* $title
 *
 * Written by flexopt $flexopt for the machine "$machine".
 *   machine  sha256 $machine_hash
 *   bundle   sha256 $bundle_hash
 *
 * Units are SI, angles in radians, counter-clockwise positive; points in the inertial frame, origin on the ground. All
 * reals are $real. Two-dimensional arrays are row-major. Every function
 *   - checks each input, and leaves its output as it was unless it returns ${PREFIX}_OK;
 *   - keeps no state, allocates nothing, does not recurse: it may be interrupted and called again with another workspace;
 *   - runs the same bounded number of steps whatever the numbers.
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

$enums
/* What a function returns. */
typedef enum {
$statuses
} ${prefix}_status;

/* A sentence for a status; never NULL. */
const char *${prefix}_status_text(${prefix}_status status);

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
