"""Rotation vectors as smooth graphs.

In: a rotation matrix. Out: the vector θ a of its axis and angle, exact and with exact derivatives for θ < π, θ = 0
included; at θ = π the direction of the axis is lost, and every three-number description of a rotation has such a place.
"""

from __future__ import annotations

import math

import casadi as ca

# Above this cos θ, where sin² θ < 0.01, θ / sin θ comes from its series: what is left out is below the last place of 1.
SERIES_ABOVE, TERMS = 0.995, 8


def rotation_vector(matrix: ca.SX) -> ca.SX:
    """θ a (3,) of a rotation matrix (3, 3), rad.

    With s = sin θ a, half of what is antisymmetric, and cos θ = (tr − 1)/2, it is s · atan2(|s|, cos θ)/|s|.
    """
    s = 0.5 * ca.vertcat(matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1])
    cosine = 0.5 * (matrix[0, 0] + matrix[1, 1] + matrix[2, 2] - 1)
    square = ca.dot(s, s)
    near = cosine > SERIES_ABOVE
    # asin(x)/x = Σ (2k)! / (4^k k!² (2k + 1)) x^2k
    coefficients = [math.comb(2 * k, k) / (4**k * (2 * k + 1)) for k in range(TERMS + 1)]
    series = ca.SX(coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        series = coefficient + square * series
    # A root's derivative at zero is infinite, and infinity times zero is no number: the other branch gets 1 there.
    sine = ca.sqrt(ca.if_else(near, 1.0, square))
    return s * ca.if_else(near, series, ca.atan2(sine, cosine) / sine)
