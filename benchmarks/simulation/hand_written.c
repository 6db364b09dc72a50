// The limit for one simulation: the excavator's closed loop, by hand (excavator.h).
//
// In: state q (5), v (5) in joint coordinates, the goal of the end-point, a number of steps. Out: the state after them,
// in place.
//
// One simulation waits for its own results more than for the arithmetic units. So boom and stick share each
// instruction (a pair of numbers), what is known early is computed apart from what arrives late (a row of the inverse
// is ready before the right-hand side), and sums end with the term that is known last.

#include <math.h>

#include "excavator.h"

typedef double pair __attribute__((vector_size(16)));
#define FIRST(a) __builtin_shufflevector(a, a, 0, 0)
#define SECOND(a) __builtin_shufflevector(a, a, 1, 1)
#define SWAPPED(a) __builtin_shufflevector(a, a, 1, 0)
#define SUMS(a, b) (__builtin_shufflevector(a, b, 0, 2) + __builtin_shufflevector(a, b, 1, 3))

typedef struct {
  pair p, v;      // (x, y) of the base, scaled by μ
  pair e, x, y;   // base: κ (cos φ, sin φ); boom and stick: κ cos φ, κ sin φ
  double f1, u1;  // base: φ less its rest angle, and u
  pair f, u;      // boom and stick: the same, both less the base's rest angle
} state;

typedef struct {
  pair ab, ab_sin;  // the base's entries with boom and stick: κ_1 κ cos(φ_1 − φ), κ_1 κ sin(φ_1 − φ)
  pair c_sin;       // κ_2 κ_3 sin(φ_2 − φ_3), and its negative
  pair n, m, l;     // rows of the inverse: z = n s − m SWAPPED(s), z_1 = r_1 − l·s with s = r − ab r_1
  pair gx, gy;      // (c / m) e of boom and stick, scaled
  pair g, gs;       // of the base, and turned by −π/2
} geometry;

typedef struct {
  double z1;
  pair z, a;  // a: of the base, scaled by μ
} rates;

typedef struct {
  double r1;
  pair r;  // right-hand side
} load;

INLINE geometry measure(pair e, pair x, pair y) {
  const pair g = {G2, G3}, g1 = {G1, -G1};
  pair ex = FIRST(e), ey = SECOND(e), xs = SWAPPED(x), ys = SWAPPED(y);
  geometry o;
  o.ab = ex * x + ey * y, o.ab_sin = ey * x - ex * y, o.c_sin = y * xs - x * ys;
  pair k = (x * xs + y * ys) - o.ab * SWAPPED(o.ab), d = 1.0 - o.ab * o.ab, ds = SWAPPED(d);
  pair inverse = 1.0 / (d * ds - k * k);
  o.n = ds * inverse, o.m = k * inverse, o.l = (o.ab * ds - SWAPPED(o.ab) * k) * inverse;
  o.gx = g * x, o.gy = g * y, o.g = G1 * e, o.gs = SWAPPED(e) * g1;
  return o;
}

INLINE load loaded(geometry o, double u1, pair u, double q1, pair q, pair f) {
  pair w = u * u, fx = FIRST(f), fy = SECOND(f);
  load out;
  out.r = (q - o.c_sin * SWAPPED(w) + o.ab_sin * (u1 * u1)) - o.gx * fy + o.gy * fx;
  out.r1 = (q1 - o.ab_sin[0] * w[0] - o.ab_sin[1] * w[1]) - o.g[0] * fy[0] + o.gs[0] * fx[0];
  return out;
}

INLINE rates solved(geometry o, load b, double u1, pair u, pair f) {
  pair w = u * u, s = b.r - o.ab * b.r1;
  rates out;
  out.z = o.n * s - o.m * SWAPPED(s);
  out.z1 = b.r1 - o.l[0] * s[0] - o.l[1] * s[1];
  pair ax = o.gx * w + o.gy * out.z, ay = o.gy * w - o.gx * out.z;
  out.a = ((f + o.g * (u1 * u1)) + o.gs * out.z1) + SUMS(ax, ay);
  return out;
}

INLINE rates evaluate(geometry o, double u1, pair u, double q1, pair q, pair f) {
  return solved(o, loaded(o, u1, u, q1, q, f), u1, u, f);
}

// Turned by k z, at most 2.5e-4 rad.
INLINE pair nudged(pair e, double k, double z) {
  double t = z * z, c = t * (-k * k / 2), s = z * (k - k * k * k / 6 * t);
  return (e + SWAPPED(e) * ((pair){-1, 1} * s)) + c * e;
}

INLINE void nudge(pair *x, pair *y, pair k, pair z) {
  pair t = z * z, c = t * (-k * k / 2), s = z * (k - k * k * k / 6 * t);
  pair turned = (*x - s * *y) + c * *x;
  *y = (*y + s * *x) + c * *y, *x = turned;
}

// cos and sin of k u, at most 0.03 rad.
INLINE void half_turn(pair k, pair u, pair *c, pair *s) {
  pair t = u * u, k2 = k * k, k4 = k2 * k2;
  *c = 1.0 + t * (-k2 / 2 + t * (k4 / 24 + t * (-k4 * k2 / 720)));
  *s = u * (k + t * (-k2 * k / 6 + t * (k4 * k / 120 + t * (-k4 * k2 * k / 5040))));
}

// τ_a = Jv⁻¹ (Kp (r_d − r) + Kv (0 − J v)), Jv at the measured joint angles with the base at its rest angle: the force
// turned by the base's rotation and projected, −(e_2·f) / (L2 sin θ3) and −(e_3·f) / (L1 sin θ3) but for constants.
INLINE pair control(const state *s, geometry o, pair goal) {
  const pair position = {POSITION_2, POSITION_3}, velocity = {VELOCITY_2, VELOCITY_3};
  pair hx = o.ab / o.c_sin, hy = o.ab_sin / o.c_sin;
  pair early = goal - (PROPORTIONAL / MU) * s->p - POSITION_1 * s->e;
  pair fx = (velocity * s->y) * s->u - position * s->x, fy = -(velocity * s->x) * s->u - position * s->y;
  pair base = SWAPPED(s->e) * (pair){VELOCITY_1, -VELOCITY_1};
  pair f = (early - (DERIVATIVE / MU) * s->v + base * s->u1) + SUMS(fx, fy);
  return hx * FIRST(f) - hy * SECOND(f);
}

INLINE void advance_once(state *s, pair goal) {
  const double h = STEP, j1 = h * RATE_1;  // z to u over a step, u to angle
  const pair j = {h * RATE_2, h * RATE_3};
  const double k = KXY / MASS, d = DXY / MASS, kt = KT / SIGMA_1, dt = DT * RATE_1 / SIGMA_1;
  geometry o = measure(s->e, s->x, s->y);
  pair both = control(s, o, goal);
  double q1 = (TO_ONE / SIGMA_1) * both[1];
  pair own = {-TO_TWO / SIGMA_2, TO_ONE / SIGMA_3}, other = {-2 * TO_ONE / SIGMA_2, TO_TWO / SIGMA_3};
  pair q = both * own + SWAPPED(both) * other;
  // Springs and dampers are linear: what the state at the start of the step gives, then what each stage adds.
  pair p0 = -k * s->p, p2 = p0 - (d + h / 2 * k) * s->v, p4 = p0 - (d + h * k) * s->v;
  double t0 = -kt * s->f1, t2 = q1 + (t0 - (dt + kt * j1 / 2) * s->u1), t4 = q1 + (t0 - (dt + kt * j1) * s->u1);

  pair f = p0 - d * s->v;
  load b = loaded(o, s->u1, s->u, t0 - dt * s->u1, (pair){0, 0}, f);
  b.r1 += q1, b.r = (b.r + both * own) + SWAPPED(both) * other;
  rates k1 = solved(o, b, s->u1, s->u, f);

  pair c1, s1, c2, s2;
  half_turn((pair){j1 / 2, j1 / 2}, (pair){s->u1, s->u1}, &c1, &s1), half_turn(j / 2, s->u, &c2, &s2);
  pair m1 = c1 * s->e + SWAPPED(s->e) * ((pair){-1, 1} * s1);
  pair mx = c2 * s->x - s2 * s->y, my = c2 * s->y + s2 * s->x;
  rates k2 = evaluate(measure(m1, mx, my), s->u1 + (j1 / 2) * k1.z1, s->u + (j / 2) * k1.z, t2 - (dt * j1 / 2) * k1.z1,
                      q, p2 - (d * h / 2) * k1.a);

  pair nx = mx, ny = my;
  nudge(&nx, &ny, j * j / 4, k1.z);
  rates k3 = evaluate(measure(nudged(m1, j1 * j1 / 4, k1.z1), nx, ny), s->u1 + (j1 / 2) * k2.z1, s->u + (j / 2) * k2.z,
                      t2 - (kt * j1 * j1 / 4) * k1.z1 - (dt * j1 / 2) * k2.z1, q,
                      p2 - (k * h * h / 4) * k1.a - (d * h / 2) * k2.a);

  // e(φ + 2δ) = 2 cos δ e(φ + δ) − e(φ)
  pair w1 = 2 * c1 * m1 - s->e, wx = 2 * c2 * mx - s->x, wy = 2 * c2 * my - s->y;
  nx = wx, ny = wy;
  nudge(&nx, &ny, j * j / 2, k2.z);
  rates k4 = evaluate(measure(nudged(w1, j1 * j1 / 2, k2.z1), nx, ny), s->u1 + j1 * k3.z1, s->u + j * k3.z,
                      t4 - (kt * j1 * j1 / 2) * k2.z1 - (dt * j1) * k3.z1, q,
                      p4 - (k * h * h / 2) * k2.a - (d * h) * k3.a);

  double a1 = k2.z1 + k3.z1, b1 = k1.z1 + a1;
  pair az = k2.z + k3.z, bz = k1.z + az, ap = k2.a + k3.a, bp = k1.a + ap;
  s->e = nudged(w1, j1 * j1 / 6, b1), s->x = wx, s->y = wy;
  nudge(&s->x, &s->y, j * j / 6, bz);
  s->f1 += j1 * s->u1 + (j1 * j1 / 6) * b1, s->f += j * s->u + (j * j / 6) * bz;
  s->p += h * s->v + (h * h / 6) * bp;
  s->u1 = (s->u1 + (j1 / 6) * (b1 + a1)) + (j1 / 6) * k4.z1, s->u = (s->u + (j / 6) * (bz + az)) + (j / 6) * k4.z;
  s->v = (s->v + (h / 6) * (bp + ap)) + (h / 6) * k4.a;
}

// (x, y) scaled, and turned by an angle.
static pair turned(const double *xy, double scale, double angle) {
  const double c = scale * cos(angle), n = scale * sin(angle);
  return (pair){c * xy[0] - n * xy[1], c * xy[1] + n * xy[0]};
}

PUBLIC void excavator_run(double *q, double *v, const double *goal, long steps) {
  state s;
  s.p = turned(q, MU, -REST), s.v = turned(v, MU, -REST);
  s.f1 = q[2] - REST, s.f = (pair){s.f1 + q[3], s.f1 + q[3] + q[4]};
  s.u1 = v[2] / RATE_1, s.u = (pair){(v[2] + v[3]) / RATE_2, (v[2] + v[3] + v[4]) / RATE_3};
  const pair to = turned(goal, PROPORTIONAL, -REST);
  for (long done = 0; done < steps;) {
    long end = done + RESYNCHRONISE < steps ? done + RESYNCHRONISE : steps;
    s.e = KAPPA_1 * (pair){cos(s.f1), sin(s.f1)};
    s.x = (pair){KAPPA_2 * cos(s.f[0]), KAPPA_3 * cos(s.f[1])};
    s.y = (pair){KAPPA_2 * sin(s.f[0]), KAPPA_3 * sin(s.f[1])};
    for (; done < end; ++done) advance_once(&s, to);
  }
  double p[2] = {s.p[0], s.p[1]}, w[2] = {s.v[0], s.v[1]};
  pair at = turned(p, 1 / MU, REST), rate = turned(w, 1 / MU, REST);
  q[0] = at[0], q[1] = at[1], q[2] = s.f1 + REST, q[3] = s.f[0] - s.f1, q[4] = s.f[1] - s.f[0];
  v[0] = rate[0], v[1] = rate[1], v[2] = RATE_1 * s.u1, v[3] = RATE_2 * s.u[0] - v[2];
  v[4] = RATE_3 * s.u[1] - RATE_2 * s.u[0];
}
