// The limit for many simulations: one member of an ensemble in each lane of a vector, by hand (excavator.h).
//
// In: states q (5, n), v (5, n) in joint coordinates, one member a column, the goals of their end-points (2, n), a
// number of steps. Out: the states after them, in place. Lanes that n does not fill repeat its last member.

#include <math.h>

#include "excavator.h"

#if defined(__AVX512F__)
#define LANES 8
#elif defined(__AVX__)
#define LANES 4
#else
#define LANES 2
#endif

typedef double real __attribute__((vector_size(8 * LANES)));

#define SIDE_BY_SIDE 2  // vectors advanced in turn: one alone leaves the processor waiting for its results

typedef struct {
  real x, y;  // κ (cos φ, sin φ)
} arrow;

typedef struct {
  real px, py, vx, vy;  // scaled by μ
  real f1, f2, f3;      // φ less the base's rest angle: only φ_1 enters the loop, the others serve resynchronisation
  real u1, u2, u3;
  arrow e1, e2, e3;
} state;

typedef struct {
  real q1, q2, q3, fx, fy;  // on the absolute angles, divided by σ; on the base, divided by μ
} force;

typedef struct {
  real z1, z2, z3, ax, ay;
} rates;

INLINE arrow turned(arrow e, real c, real s) {
  arrow r = {c * e.x - s * e.y, c * e.y + s * e.x};
  return r;
}

// Turned by k z, at most 2.5e-4 rad.
INLINE arrow nudged(arrow e, double k, real z) {
  real t = z * z;
  return turned(e, 1.0 - t * (k * k / 2), z * (k - k * k * k / 6 * t));
}

// cos and sin of k u, at most 0.03 rad.
INLINE void half_turn(double k, real u, real *c, real *s) {
  real t = u * u;
  const double k2 = k * k, k4 = k2 * k2;
  *c = 1.0 + t * (-k2 / 2 + t * (k4 / 24 + t * (-k4 * k2 / 720)));
  *s = u * (k + t * (-k2 * k / 6 + t * (k4 * k / 120 + t * (-k4 * k2 * k / 5040))));
}

INLINE rates evaluate(arrow e1, arrow e2, arrow e3, real u1, real u2, real u3, force f) {
  real a = e1.x * e2.x + e1.y * e2.y, b = e1.x * e3.x + e1.y * e3.y, c = e2.x * e3.x + e2.y * e3.y;
  real a_sin = e1.y * e2.x - e1.x * e2.y, b_sin = e1.y * e3.x - e1.x * e3.y, c_sin = e2.y * e3.x - e2.x * e3.y;
  real d2 = 1.0 - a * a, d3 = 1.0 - b * b, k = c - a * b;
  real inverse = 1.0 / (d2 * d3 - k * k);
  real w1 = u1 * u1, w2 = u2 * u2, w3 = u3 * u3;
  real g1x = G1 * e1.x, g1y = G1 * e1.y, g2x = G2 * e2.x, g2y = G2 * e2.y, g3x = G3 * e3.x, g3y = G3 * e3.y;
  real r1 = f.q1 - g1x * f.fy + g1y * f.fx - a_sin * w2 - b_sin * w3;
  real r2 = f.q2 - g2x * f.fy + g2y * f.fx + a_sin * w1 - c_sin * w3;
  real r3 = f.q3 - g3x * f.fy + g3y * f.fx + b_sin * w1 + c_sin * w2;
  real y2 = r2 - a * r1, y3 = r3 - b * r1;
  rates out;
  out.z2 = (d3 * y2 - k * y3) * inverse;
  out.z3 = (d2 * y3 - k * y2) * inverse;
  out.z1 = r1 - a * out.z2 - b * out.z3;
  out.ax = f.fx + g1x * w1 + g2x * w2 + g3x * w3 + g1y * out.z1 + g2y * out.z2 + g3y * out.z3;
  out.ay = f.fy + g1y * w1 + g2y * w2 + g3y * w3 - g1x * out.z1 - g2x * out.z2 - g3x * out.z3;
  return out;
}

// τ_a = Jv⁻¹ (Kp (r_d − r) + Kv (0 − J v)), Jv at the measured joint angles with the base at its rest angle.
INLINE void control(const state *s, real goal_x, real goal_y, real *q1, real *q2, real *q3) {
  real k1 = VELOCITY_1 * s->u1, k2 = VELOCITY_2 * s->u2, k3 = VELOCITY_3 * s->u3;
  real fx = goal_x - (PROPORTIONAL / MU) * s->px - (DERIVATIVE / MU) * s->vx - POSITION_1 * s->e1.x -
            POSITION_2 * s->e2.x - POSITION_3 * s->e3.x + k1 * s->e1.y + k2 * s->e2.y + k3 * s->e3.y;
  real fy = goal_y - (PROPORTIONAL / MU) * s->py - (DERIVATIVE / MU) * s->vy - POSITION_1 * s->e1.y -
            POSITION_2 * s->e2.y - POSITION_3 * s->e3.y - k1 * s->e1.x - k2 * s->e2.x - k3 * s->e3.x;
  // Turned by the base's rotation, so that e_2 and e_3 stand for the directions at the rest angle, and projected on
  // them: rates of the absolute angles that Jv maps to f, (e_3·f) / (L1 sin θ3) and −(e_2·f) / (L2 sin θ3).
  real a = s->e1.x * s->e2.x + s->e1.y * s->e2.y, b = s->e1.x * s->e3.x + s->e1.y * s->e3.y;
  real a_sin = s->e1.y * s->e2.x - s->e1.x * s->e2.y, b_sin = s->e1.y * s->e3.x - s->e1.x * s->e3.y;
  real sine = 1.0 / (s->e2.y * s->e3.x - s->e2.x * s->e3.y);
  real one = (b * fx - b_sin * fy) * sine, two = (a * fx - a_sin * fy) * sine;
  *q1 = (-TO_ONE / SIGMA_1) * one;
  *q2 = (2 * TO_ONE / SIGMA_2) * one - (TO_TWO / SIGMA_2) * two;
  *q3 = (TO_TWO / SIGMA_3) * two - (TO_ONE / SIGMA_3) * one;
}

INLINE void advance_once(state *s, real goal_x, real goal_y) {
  const double h = STEP, j1 = h * RATE_1, j2 = h * RATE_2, j3 = h * RATE_3;  // z to u over a step, u to angle
  const double k = KXY / MASS, d = DXY / MASS;
  const double kt = KT / SIGMA_1, dt = DT * RATE_1 / SIGMA_1;
  force f;
  control(s, goal_x, goal_y, &f.q1, &f.q2, &f.q3);
  // Springs and dampers are linear: what the state at the start of the step gives, then what each stage adds.
  real x0 = -k * s->px, y0 = -k * s->py, t0 = f.q1 - kt * s->f1;
  real x2 = x0 - (d + h / 2 * k) * s->vx, y2 = y0 - (d + h / 2 * k) * s->vy, t2 = t0 - (dt + kt * j1 / 2) * s->u1;
  real x4 = x0 - (d + h * k) * s->vx, y4 = y0 - (d + h * k) * s->vy, t4 = t0 - (dt + kt * j1) * s->u1;

  f.q1 = t0 - dt * s->u1, f.fx = x0 - d * s->vx, f.fy = y0 - d * s->vy;
  rates k1 = evaluate(s->e1, s->e2, s->e3, s->u1, s->u2, s->u3, f);

  real c1, s1, c2, s2, c3, s3;
  half_turn(j1 / 2, s->u1, &c1, &s1), half_turn(j2 / 2, s->u2, &c2, &s2), half_turn(j3 / 2, s->u3, &c3, &s3);
  arrow m1 = turned(s->e1, c1, s1), m2 = turned(s->e2, c2, s2), m3 = turned(s->e3, c3, s3);
  f.q1 = t2 - (dt * j1 / 2) * k1.z1, f.fx = x2 - (d * h / 2) * k1.ax, f.fy = y2 - (d * h / 2) * k1.ay;
  rates k2 = evaluate(m1, m2, m3, s->u1 + (j1 / 2) * k1.z1, s->u2 + (j2 / 2) * k1.z2, s->u3 + (j3 / 2) * k1.z3, f);

  f.q1 = t2 - (kt * j1 * j1 / 4) * k1.z1 - (dt * j1 / 2) * k2.z1;
  f.fx = x2 - (k * h * h / 4) * k1.ax - (d * h / 2) * k2.ax;
  f.fy = y2 - (k * h * h / 4) * k1.ay - (d * h / 2) * k2.ay;
  rates k3 = evaluate(nudged(m1, j1 * j1 / 4, k1.z1), nudged(m2, j2 * j2 / 4, k1.z2),
                      nudged(m3, j3 * j3 / 4, k1.z3), s->u1 + (j1 / 2) * k2.z1, s->u2 + (j2 / 2) * k2.z2,
                      s->u3 + (j3 / 2) * k2.z3, f);

  // e(φ + 2δ) = 2 cos δ e(φ + δ) − e(φ)
  arrow w1 = {2 * c1 * m1.x - s->e1.x, 2 * c1 * m1.y - s->e1.y};
  arrow w2 = {2 * c2 * m2.x - s->e2.x, 2 * c2 * m2.y - s->e2.y};
  arrow w3 = {2 * c3 * m3.x - s->e3.x, 2 * c3 * m3.y - s->e3.y};
  f.q1 = t4 - (kt * j1 * j1 / 2) * k2.z1 - (dt * j1) * k3.z1;
  f.fx = x4 - (k * h * h / 2) * k2.ax - (d * h) * k3.ax;
  f.fy = y4 - (k * h * h / 2) * k2.ay - (d * h) * k3.ay;
  rates k4 = evaluate(nudged(w1, j1 * j1 / 2, k2.z1), nudged(w2, j2 * j2 / 2, k2.z2),
                      nudged(w3, j3 * j3 / 2, k2.z3), s->u1 + j1 * k3.z1, s->u2 + j2 * k3.z2, s->u3 + j3 * k3.z3, f);

  real a1 = k2.z1 + k3.z1, a2 = k2.z2 + k3.z2, a3 = k2.z3 + k3.z3, ax = k2.ax + k3.ax, ay = k2.ay + k3.ay;
  real b1 = k1.z1 + a1, b2 = k1.z2 + a2, b3 = k1.z3 + a3, bx = k1.ax + ax, by = k1.ay + ay;
  s->e1 = nudged(w1, j1 * j1 / 6, b1), s->e2 = nudged(w2, j2 * j2 / 6, b2), s->e3 = nudged(w3, j3 * j3 / 6, b3);
  s->f1 += j1 * s->u1 + (j1 * j1 / 6) * b1, s->f2 += j2 * s->u2 + (j2 * j2 / 6) * b2;
  s->f3 += j3 * s->u3 + (j3 * j3 / 6) * b3;
  s->px += h * s->vx + (h * h / 6) * bx, s->py += h * s->vy + (h * h / 6) * by;
  s->u1 += (j1 / 6) * (b1 + (a1 + k4.z1)), s->u2 += (j2 / 6) * (b2 + (a2 + k4.z2));
  s->u3 += (j3 / 6) * (b3 + (a3 + k4.z3));
  s->vx += (h / 6) * (bx + (ax + k4.ax)), s->vy += (h / 6) * (by + (ay + k4.ay));
}

static arrow exact(double length, real angle) {
  arrow e;
  for (int k = 0; k < LANES; ++k) e.x[k] = length * cos(angle[k]), e.y[k] = length * sin(angle[k]);
  return e;
}

typedef struct {
  long first, n;  // the members in a vector, and how many there are
} place;

static real gathered(const double *row, place at) {
  real r;
  for (long k = 0; k < LANES; ++k) r[k] = row[at.first + k < at.n ? at.first + k : at.n - 1];
  return r;
}

static void scattered(double *row, place at, real value) {
  for (long k = 0; k < LANES && at.first + k < at.n; ++k) row[at.first + k] = value[k];
}

// (x, y) scaled, and turned into the frame of the base at rest; and back.
static void enter(const double *rows, place at, double scale, real *x, real *y) {
  const double c = scale * cos(REST), n = scale * sin(REST);
  real a = gathered(rows, at), b = gathered(rows + at.n, at);
  *x = c * a + n * b, *y = c * b - n * a;
}

static void leave(double *rows, place at, double scale, real x, real y) {
  const double c = cos(REST) / scale, n = sin(REST) / scale;
  scattered(rows, at, c * x - n * y), scattered(rows + at.n, at, c * y + n * x);
}

static state load(const double *q, const double *v, place at) {
  state s;
  enter(q, at, MU, &s.px, &s.py), enter(v, at, MU, &s.vx, &s.vy);
  s.f1 = gathered(q + 2 * at.n, at) - REST, s.f2 = s.f1 + gathered(q + 3 * at.n, at);
  s.f3 = s.f2 + gathered(q + 4 * at.n, at);
  real r1 = gathered(v + 2 * at.n, at), r2 = r1 + gathered(v + 3 * at.n, at), r3 = r2 + gathered(v + 4 * at.n, at);
  s.u1 = r1 / RATE_1, s.u2 = r2 / RATE_2, s.u3 = r3 / RATE_3;
  return s;
}

static void store(double *q, double *v, place at, const state *s) {
  real r1 = RATE_1 * s->u1, r2 = RATE_2 * s->u2, r3 = RATE_3 * s->u3;
  leave(q, at, MU, s->px, s->py), leave(v, at, MU, s->vx, s->vy);
  scattered(q + 2 * at.n, at, s->f1 + REST), scattered(q + 3 * at.n, at, s->f2 - s->f1);
  scattered(q + 4 * at.n, at, s->f3 - s->f2);
  scattered(v + 2 * at.n, at, r1), scattered(v + 3 * at.n, at, r2 - r1), scattered(v + 4 * at.n, at, r3 - r2);
}

static void run(double *q, double *v, const double *goal, place at, long steps) {
  state s[SIDE_BY_SIDE];
  real goal_x[SIDE_BY_SIDE], goal_y[SIDE_BY_SIDE];
  for (int i = 0; i < SIDE_BY_SIDE; ++i) {
    place here = {at.first + i * LANES, at.n};
    s[i] = load(q, v, here);
    enter(goal, here, PROPORTIONAL, &goal_x[i], &goal_y[i]);
  }
  for (long done = 0; done < steps;) {
    long end = done + RESYNCHRONISE < steps ? done + RESYNCHRONISE : steps;
    for (int i = 0; i < SIDE_BY_SIDE; ++i) {
      s[i].e1 = exact(KAPPA_1, s[i].f1), s[i].e2 = exact(KAPPA_2, s[i].f2), s[i].e3 = exact(KAPPA_3, s[i].f3);
    }
    for (; done < end; ++done) {
      for (int i = 0; i < SIDE_BY_SIDE; ++i) advance_once(&s[i], goal_x[i], goal_y[i]);
    }
  }
  for (int i = 0; i < SIDE_BY_SIDE; ++i) {
    place here = {at.first + i * LANES, at.n};
    store(q, v, here, &s[i]);
  }
}

PUBLIC int excavator_lanes(void) { return LANES * SIDE_BY_SIDE; }

// Members first … last − 1 of n; `first` is a multiple of `excavator_lanes()`.
PUBLIC void excavator_run_lanes(double *q, double *v, const double *goal, long first,
                                                                long last, long n, long steps) {
  for (; first < last; first += LANES * SIDE_BY_SIDE) {
    place at = {first, n};
    run(q, v, goal, at, steps);
  }
}
