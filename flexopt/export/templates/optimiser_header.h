/* The posture optimiser of the bundle; {{ prefix }}_control.h has the rest. Made for the machine and the bundle whose hashes
 * stand there. */
#ifndef {{ PREFIX }}_OPTIMISER_H
#define {{ PREFIX }}_OPTIMISER_H

#include "{{ prefix }}_control.h"

#ifdef __cplusplus
extern "C" {
#endif

{{ declarations }}

#ifdef __cplusplus
}
#endif

#endif
