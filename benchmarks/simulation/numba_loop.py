"""The closed loop as a good Numba user writes it: closed form in absolute angles, x and y eliminated, one loop.

In: state q (5,), v (5,), the goal of the end-point (2,), a number of steps. Out: the state after them, in place. sin
and cos are evaluated at each stage; arithmetic is strict (letting multiplication and addition fuse made it no faster).
Importing this module needs Numba.
"""

from __future__ import annotations

from math import cos, sin

import numpy as np
from numba import njit

STEP, PROPORTIONAL, DERIVATIVE = 0.005, 1e5, 2e3
LB, LGB, L1, LG1, L2, LG2 = 0.541, 0.563, 1.918, 1.067, 1.097, 0.613
MB, M1, M2 = 5291.5, 766.6, 458.2
KX, KY, KT, DX, DY, DT, REST = 4e7, 4e7, 1.112e6, 50.0, 50.0, 25.0, 1.2451

MASS = MB + M1 + M2
C1, C2, C3 = MB * LGB + (M1 + M2) * LB, M1 * LG1 + M2 * L1, M2 * LG2
S11 = 1020.7 + MB * LGB**2 + (M1 + M2) * LB**2 - C1 * C1 / MASS
S22 = 214.9 + M1 * LG1**2 + M2 * L1**2 - C2 * C2 / MASS
S33 = 93.6 + M2 * LG2**2 - C3 * C3 / MASS
S12, S13, S23 = LB * C2 - C1 * C2 / MASS, LB * C3 - C1 * C3 / MASS, L1 * C3 - C2 * C3 / MASS
COS_REST, SIN_REST = cos(REST), sin(REST)

State = tuple[float, float, float, float, float]


@njit(inline="always")
def _acceleration(q: State, v: State, t2: float, t3: float) -> State:
    """(ẍ, ÿ, φ̈1, φ̈2, φ̈3) in absolute angles φ, with the joint torques t2, t3."""
    x, y, f1, f2, f3 = q
    vx, vy, w1, w2, w3 = v
    c1, s1, c2, s2, c3, s3 = cos(f1), sin(f1), cos(f2), sin(f2), cos(f3), sin(f3)
    a, b, c = S12 * (c1 * c2 + s1 * s2), S13 * (c1 * c3 + s1 * s3), S23 * (c2 * c3 + s2 * s3)
    a_sin, b_sin, c_sin = S12 * (s1 * c2 - c1 * s2), S13 * (s1 * c3 - c1 * s3), S23 * (s2 * c3 - c2 * s3)
    p1, p2, p3 = w1 * w1, w2 * w2, w3 * w3
    fx, fy = -KX * x - DX * vx, -KY * y - DY * vy
    r1 = -KT * (f1 - REST) - DT * w1 - t2 - C1 / MASS * (c1 * fy - s1 * fx) - a_sin * p2 - b_sin * p3
    r2 = t2 - t3 - C2 / MASS * (c2 * fy - s2 * fx) + a_sin * p1 - c_sin * p3
    r3 = t3 - C3 / MASS * (c3 * fy - s3 * fx) + b_sin * p1 + c_sin * p2
    # LDLᵀ of the 3×3 matrix
    i1 = 1.0 / S11
    l2, l3 = a * i1, b * i1
    d2, k = S22 - l2 * a, c - l2 * b
    i2 = 1.0 / d2
    m = k * i2
    y2 = r2 - l2 * r1
    z3 = (r3 - l3 * r1 - m * y2) / (S33 - l3 * b - m * k)
    z2 = y2 * i2 - m * z3
    z1 = r1 * i1 - l2 * z2 - l3 * z3
    ax = (fx + C1 * (s1 * z1 + c1 * p1) + C2 * (s2 * z2 + c2 * p2) + C3 * (s3 * z3 + c3 * p3)) * (1.0 / MASS)
    ay = (fy - C1 * (c1 * z1 - s1 * p1) - C2 * (c2 * z2 - s2 * p2) - C3 * (c3 * z3 - s3 * p3)) * (1.0 / MASS)
    return ax, ay, z1, z2, z3


@njit(inline="always")
def _plus(a: State, h: float, b: State) -> State:
    return a[0] + h * b[0], a[1] + h * b[1], a[2] + h * b[2], a[3] + h * b[3], a[4] + h * b[4]


@njit(inline="always")
def _torque(q: State, v: State, goal_x: float, goal_y: float) -> tuple[float, float]:
    """Jv⁻¹ (Kp (r_d − r) + Kv (0 − J v)), Jv at the measured joint angles with the base at its rest angle."""
    x, y, f1, f2, f3 = q
    vx, vy, w1, w2, w3 = v
    c1, s1, c2, s2, c3, s3 = cos(f1), sin(f1), cos(f2), sin(f2), cos(f3), sin(f3)
    fx = PROPORTIONAL * (goal_x - x - LB * c1 - L1 * c2 - L2 * c3)
    fy = PROPORTIONAL * (goal_y - y - LB * s1 - L1 * s2 - L2 * s3)
    fx -= DERIVATIVE * (vx - LB * s1 * w1 - L1 * s2 * w2 - L2 * s3 * w3)
    fy -= DERIVATIVE * (vy + LB * c1 * w1 + L1 * c2 * w2 + L2 * c3 * w3)
    c, s = COS_REST * c1 + SIN_REST * s1, COS_REST * s1 - SIN_REST * c1
    fx, fy = c * fx - s * fy, s * fx + c * fy  # turned by f1 − REST, it stands for links at the rest angle
    inverse = 1.0 / (c2 * s3 - s2 * c3)
    t2 = (c3 * fx + s3 * fy) * (inverse * (1.0 / L1))
    return t2, -(c2 * fx + s2 * fy) * (inverse * (1.0 / L2)) - t2


@njit
def run(q: np.ndarray, v: np.ndarray, goal: np.ndarray, steps: int) -> None:
    """Advance q, v in place by `steps` steps of RK4."""
    h = STEP
    p = (q[0], q[1], q[2], q[2] + q[3], q[2] + q[3] + q[4])
    w = (v[0], v[1], v[2], v[2] + v[3], v[2] + v[3] + v[4])
    for _ in range(steps):
        t2, t3 = _torque(p, w, goal[0], goal[1])
        a1 = _acceleration(p, w, t2, t3)
        w2 = _plus(w, h / 2, a1)
        a2 = _acceleration(_plus(p, h / 2, w), w2, t2, t3)
        w3 = _plus(w, h / 2, a2)
        a3 = _acceleration(_plus(p, h / 2, w2), w3, t2, t3)
        w4 = _plus(w, h, a3)
        a4 = _acceleration(_plus(p, h, w3), w4, t2, t3)
        p = _plus(_plus(_plus(_plus(p, h / 6, w), h / 3, w2), h / 3, w3), h / 6, w4)
        w = _plus(_plus(_plus(_plus(w, h / 6, a1), h / 3, a2), h / 3, a3), h / 6, a4)
    q[0], q[1], q[2], q[3], q[4] = p[0], p[1], p[2], p[3] - p[2], p[4] - p[3]
    v[0], v[1], v[2], v[3], v[4] = w[0], w[1], w[2], w[3] - w[2], w[4] - w[3]
