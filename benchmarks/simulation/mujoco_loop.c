// MuJoCo, all in C: mj_step in a loop, with the controller by hand.
//
// In: a model file that MuJoCo saved, with RK4, the step and the joints' order of q; state q (5), v (5) in joint
// coordinates, the goal of the end-point, a number of steps. Out: the state after them, in place.

#include <math.h>
#include <mujoco/mujoco.h>

#define LB 0.541
#define L1 1.918
#define L2 1.097
#define REST 1.2451
#define PROPORTIONAL 1e5
#define DERIVATIVE 2e3
#define PUBLIC __attribute__((visibility("default")))

typedef struct {
  mjModel *model;
  mjData *data;
} simulation;

// τ_a = Jv⁻¹ (Kp (r_d − r) + Kv (0 − J v)), Jv at the measured joint angles with the base at its rest angle.
static void control(const mjtNum *q, const mjtNum *v, const double *goal, mjtNum *torque) {
  const double a1 = q[2], a2 = a1 + q[3], a3 = a2 + q[4], w1 = v[2], w2 = w1 + v[3], w3 = w2 + v[4];
  const double c1 = LB * cos(a1), s1 = LB * sin(a1), c2 = L1 * cos(a2), s2 = L1 * sin(a2);
  const double c3 = L2 * cos(a3), s3 = L2 * sin(a3);
  const double fx = PROPORTIONAL * (goal[0] - q[0] - c1 - c2 - c3) - DERIVATIVE * (v[0] - s1 * w1 - s2 * w2 - s3 * w3);
  const double fy = PROPORTIONAL * (goal[1] - q[1] - s1 - s2 - s3) - DERIVATIVE * (v[1] + c1 * w1 + c2 * w2 + c3 * w3);
  const double c = cos(a1 - REST), s = sin(a1 - REST);  // f turned by it stands for links at the rest angle
  const double gx = c * fx - s * fy, gy = s * fx + c * fy, determinant = c2 * s3 - s2 * c3;
  const double one = (c3 * gx + s3 * gy) / determinant, two = -(c2 * gx + s2 * gy) / determinant;
  torque[3] = one, torque[4] = two - one;
}

PUBLIC simulation *excavator_load(const char *path) {
  simulation *s = mju_malloc(sizeof(simulation));
  s->model = mj_loadModel(path, NULL);
  if (!s->model) {
    mju_free(s);
    return NULL;
  }
  s->data = mj_makeData(s->model);
  return s;
}

PUBLIC void excavator_run(simulation *s, double *q, double *v, const double *goal, long steps) {
  mj_resetData(s->model, s->data);
  mju_copy(s->data->qpos, q, 5), mju_copy(s->data->qvel, v, 5);
  for (long k = 0; k < steps; ++k) {
    control(s->data->qpos, s->data->qvel, goal, s->data->qfrc_applied);
    mj_step(s->model, s->data);
  }
  mju_copy(q, s->data->qpos, 5), mju_copy(v, s->data->qvel, 5);
}
