{% set state, rates = ("machine", "machine.rates") if of_machine else ("configuration", "(" ~ prefix ~ "_real)rate") %}
{% set moving, jacobian = ("COORDINATES", "jacobian") if of_machine else ("JOINTS", "rigid_jacobian") %}
{% set first = PREFIX ~ "_COORDINATES - " ~ PREFIX ~ "_JOINTS + " %}
{% set effort, unit = ("torque", "N m") if machine.joint_units[0] == "rad" else ("force", "N") %}
{% if of_machine %}
/* Closes the loop: the exported controller (Jacobian inverse) moves the end-point of the exported model of the machine, which
 * gives way at its flexible coordinates, to a target. Hardware in the loop looks like this, with the controller on the
 * other side of a wire: measurements go out, torques come back. */
{% else %}
/* Closes the loop: the exported controller (Jacobian inverse) moves the end-point of a simulated arm to a target.
 *
 * The arm here is a stand-in that keeps the example short: joints of equal inertia on rigid ground, measured without error.
 * On the machine the measurements come from sensors and the torques go to the drives; nothing else changes. */
{% endif %}
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "{{ prefix }}_control.h"

#define RATE_HZ {{ rate }}
#define DURATION_S {{ duration }}
{% if of_machine %}
#define STEPS {{ start.substeps }} /* of the machine in a sample of the controller: RK4 wants angular frequency times step below 2.8 */
{% else %}
#define INERTIA ((double){{ number(start.gains.inertia) }}) /* {{ inertia_unit }}, of each joint of the stand-in: the mean of the machine's in the start posture */
{% endif %}

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
{% if of_machine %}
  static {{ prefix }}_machine_step_in machine;
{% endif %}
  static const {{ prefix }}_real start[{{ PREFIX }}_COORDINATES] = {{ listed(coordinates) }};
{% if not of_machine %}
  const double step = 1.0 / RATE_HZ;
{% endif %}
{% if not baked %}
  const {{ prefix }}_parameters parameters = {{ PREFIX }}_DEFAULT_PARAMETERS;
{% endif %}
  {{ prefix }}_kinematics_out arm;
  {{ prefix }}_torque_inverse_out command;
{% if of_machine %}
  {{ prefix }}_machine_step_out moved;
{% else %}
  /* The stand-in moves in double, whatever the controller computes in: small steps would be lost in a float's rounding. */
  double angle[{{ PREFIX }}_JOINTS], rate[{{ PREFIX }}_JOINTS] = {0};
{% endif %}
  double error = 0.0;
  int failures = 0, k, i, j;

  printf("%s: machine %s\n", {{ prefix }}_build_info()->bundle_sha256, {{ prefix }}_build_info()->machine);
{% if start.decays %}
  /* With these gains, at RATE_HZ, the machine's loop about rest decays in the start posture, with every other sample
   * lost, too. Elsewhere it may not; flexopt evaluate tells. */
{% elif of_machine %}
  /* Gains for this move alone: about rest the machine's loop may grow with them. flexopt evaluate tells which do not. */
{% endif %}
  controller.proportional_gain = {{ number(start.gains.kp) }};
  controller.derivative_gain = {{ number(start.gains.kv) }};
{% if start.gains.nullspace_damping %}
  controller.nullspace_damping = {{ number(start.gains.nullspace_damping) }}; /* of the arm's self-motion */
{% endif %}
{% if of_machine %}
  machine.step = ({{ prefix }}_real)1 / RATE_HZ / STEPS;
{% endif %}
  for (i = 0; i < {{ PREFIX }}_COORDINATES; ++i) {
    {{ state }}.coordinates[i] = start[i];
  }
{% if not of_machine %}
  for (j = 0; j < {{ PREFIX }}_JOINTS; ++j) {
    angle[j] = (double)start[{{ first }}j];
  }
{% endif %}
  for (k = 0; k <= DURATION_S * RATE_HZ; ++k) {
{% if of_machine %}
    /* What sensors measure: end-point, its rate, joint angles. */
    for (i = 0; i < {{ PREFIX }}_COORDINATES; ++i) {
      configuration.coordinates[i] = machine.coordinates[i];
    }
{% endif %}
    stop_on({{ prefix }}_kinematics(&configuration, {{ pass }}&arm, workspace, {{ PREFIX }}_WORKSPACE));
    for (i = 0; i < {{ PREFIX }}_TASK; ++i) {
      controller.measured_point[i] = arm.end_point[i];
      controller.measured_rate[i] = 0;
      for (j = 0; j < {{ PREFIX }}_{{ moving }}; ++j) {
        controller.measured_rate[i] += arm.{{ jacobian }}[i][j] * {{ rates }}[j];
      }
      if (k == 0) {
        controller.target_point[i] = arm.end_point[i] + {{ number(distance) }};
      }
    }
    for (j = 0; j < {{ PREFIX }}_JOINTS; ++j) {
      controller.joint_angles[j] = {{ state }}.coordinates[{{ first }}j];
{% if start.gains.nullspace_damping %}
      controller.joint_rates[j] = {{ rates }}[{{ first if of_machine else "" }}j];
{% endif %}
    }
    /* What the controller asks for. */
    stop_on({{ prefix }}_torque_inverse(&controller, {{ pass }}&command, workspace, {{ PREFIX }}_WORKSPACE));
    error = 0.0;
    for (i = 0; i < {{ PREFIX }}_TASK; ++i) {
      const double e = (double)(controller.target_point[i] - controller.measured_point[i]);
      error += e * e;
    }
    error = sqrt(error);
    if (k % RATE_HZ == 0) {
      printf("t = %2d s: end-point %.3g m from its target, {{ effort }} of the first joint %.6g {{ unit }}\n", k / RATE_HZ, error,
             (double)command.torque[0]);
    }
{% if of_machine %}
    /* What the machine does until the next sample. */
{% endif %}
    for (j = 0; j < {{ PREFIX }}_JOINTS; ++j) {
{% if of_machine %}
      machine.torque[j] = command.torque[j];
    }
    for (i = 0; i < STEPS; ++i) {
      stop_on({{ prefix }}_machine_step(&machine, {{ pass }}&moved, workspace, {{ PREFIX }}_WORKSPACE));
      for (j = 0; j < {{ PREFIX }}_COORDINATES; ++j) {
        machine.coordinates[j] = moved.next_coordinates[j];
        machine.rates[j] = moved.next_rates[j];
      }
{% else %}
      rate[j] += step * (double)command.torque[j] / INERTIA;
      angle[j] += step * rate[j];
      configuration.coordinates[{{ first }}j] = ({{ prefix }}_real)angle[j];
{% endif %}
    }
  }
  failures += (error < {{ "%.4g" | format(start.settled) }}) ? 0 : 1;
  printf((error < {{ "%.4g" | format(start.settled) }}) ? "on target\n" : "NOT on target\n");
  return failures ? EXIT_FAILURE : EXIT_SUCCESS;
}
