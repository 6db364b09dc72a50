/* Closes the loop: the exported controller (Jacobian inverse) moves the end-point of a simulated arm to a target.
 *
 * The arm here is a stand-in that keeps the example short: joints of equal inertia on rigid ground, measured without error.
 * On the machine the measurements come from sensors and the torques go to the drives; nothing else changes. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "{{ prefix }}_control.h"
{% for part in standalone %}
#include "{{ prefix }}_{{ part }}.h"
{% endfor %}

#define RATE_HZ {{ rate }}
#define DURATION_S {{ duration }}
#define INERTIA (({{ prefix }}_real){{ number(start.inertia) }}) /* kg m^2, of each joint of the stand-in: the mean of the machine's in the start posture */

static {{ prefix }}_real workspace[{{ PREFIX }}_WORKSPACE];

static void stop_on({{ prefix }}_status status)
{
  if (!{{ prefix }}_has_output(status)) {
    printf("refused: %s\n", {{ prefix }}_status_text(status));
    exit(EXIT_FAILURE);
  }
}

int main(void)
{
  static {{ prefix }}_torque_inverse_in controller;
  static {{ prefix }}_kinematics_in configuration;
  static const {{ prefix }}_real start[{{ PREFIX }}_COORDINATES] = {{ listed(coordinates) }};
  const {{ prefix }}_real step = ({{ prefix }}_real)1 / RATE_HZ;
{% if not baked %}
  const {{ prefix }}_parameters parameters = {{ PREFIX }}_DEFAULT_PARAMETERS;
{% endif %}
  {{ prefix }}_kinematics_out arm;
  {{ prefix }}_torque_inverse_out command;
  {{ prefix }}_real rate[{{ PREFIX }}_JOINTS] = {0};
  double error = 0.0;
  int failures = 0, k, i, j;

  printf("%s: machine %s\n", {{ prefix }}_build_info()->bundle_sha256, {{ prefix }}_build_info()->machine);
  controller.proportional_gain = {{ number(start.kp) }};
  controller.derivative_gain = {{ number(start.kv) }};
{% if start.nullspace_damping %}
  controller.nullspace_damping = {{ number(start.nullspace_damping) }}; /* of the arm's self-motion */
{% endif %}
  for (i = 0; i < {{ PREFIX }}_COORDINATES; ++i) {
    configuration.coordinates[i] = start[i];
  }
  for (k = 0; k <= DURATION_S * RATE_HZ; ++k) {
    stop_on({{ prefix }}_kinematics(&configuration, {{ pass }}&arm, workspace, {{ PREFIX }}_WORKSPACE));
    for (i = 0; i < {{ PREFIX }}_TASK; ++i) {
      controller.measured_point[i] = arm.end_point[i];
      controller.measured_rate[i] = 0;
      for (j = 0; j < {{ PREFIX }}_JOINTS; ++j) {
        controller.measured_rate[i] += arm.rigid_jacobian[i][j] * rate[j];
      }
      if (k == 0) {
        controller.target_point[i] = arm.end_point[i] + {{ number(distance) }};
      }
    }
    for (j = 0; j < {{ PREFIX }}_JOINTS; ++j) {
      controller.joint_angles[j] = configuration.coordinates[{{ PREFIX }}_COORDINATES - {{ PREFIX }}_JOINTS + j];
{% if start.nullspace_damping %}
      controller.joint_rates[j] = rate[j];
{% endif %}
    }
    stop_on({{ prefix }}_torque_inverse(&controller, {{ pass }}&command, workspace, {{ PREFIX }}_WORKSPACE));
    error = 0.0;
    for (i = 0; i < {{ PREFIX }}_TASK; ++i) {
      const double e = (double)(controller.target_point[i] - controller.measured_point[i]);
      error += e * e;
    }
    error = sqrt(error);
    if (k % RATE_HZ == 0) {
      printf("t = %d s: end-point %.6f m from its target, torque of the first joint %.6g N m\n", k / RATE_HZ, error,
             (double)command.torque[0]);
    }
    for (j = 0; j < {{ PREFIX }}_JOINTS; ++j) {
      rate[j] += step * command.torque[j] / INERTIA;
      configuration.coordinates[{{ PREFIX }}_COORDINATES - {{ PREFIX }}_JOINTS + j] += step * rate[j];
    }
  }
  failures += (error < {{ "%.4g" | format(start.settled) }}) ? 0 : 1;
  printf((error < {{ "%.4g" | format(start.settled) }}) ? "on target\n" : "NOT on target\n");
{% for part in standalone.values() %}
{{ part.example_call() -}}
{% endfor %}
  return failures ? EXIT_FAILURE : EXIT_SUCCESS;
}
