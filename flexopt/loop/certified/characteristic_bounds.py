"""Bounds on the characteristic function off the axis, from norms, and what they leave of an interpolation.

In: a `Characteristic`, cells of ω. Out: a part of the remainders R of its control points.
"""

from __future__ import annotations

import math

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.loop.certified.aliases import ELLIPSES
from flexopt.loop.certified.bernstein import lebesgue, nodes_of
from flexopt.loop.certified.characteristic import Characteristic

# Passes of scaling before Hadamard's inequality.
SCALINGS = 12
# Multiples of the aliases' error that bounds are taken over.
SOME, FARTHER = 10.0, (1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8)
TINY = float(np.finfo(float).tiny)


def remainders(of: Characteristic, degree: int, low: Vector, high: Vector, error: Vector) -> tuple[Vector, Vector]:
    """Of R (K,): what interpolation in ω makes, and what that in masses and dead time and second orders do.

    Multiples of the aliases' error are let in everywhere: Cauchy's bounds in it are those of the terms of higher order,
    and of what interpolation makes of the first one.
    """
    middle, half, still = (low + high) / 2, (high - low) / 2, np.zeros(len(low))
    sizes = np.array(ELLIPSES)[:, None]
    wide, tall = half * (sizes + 1 / sizes) / 2, half * (sizes - 1 / sizes) / 2
    near = of.aliases.near(wide.ravel(), tall.ravel()) + SOME * np.tile(error, (len(sizes), 1, 1))
    bound = _largest(of, (middle + wide).ravel(), tall.ravel(), near).reshape(wide.shape)
    cut = np.fmin.reduce((1 + 1 / SOME) * 4 * bound * sizes**-degree / (sizes - 1))
    aliases = of.aliases.near(still, still)
    bounds = [_largest(of, high, still, aliases + farther * error) for farther in FARTHER]
    second = np.min([b / (f * (f - 1)) for b, f in zip(bounds, FARTHER, strict=True)], axis=0)
    smooth = np.zeros(len(low))
    for axis in of.smooth:
        smooth = smooth + _smooth_remainder(of, axis, high, error)
    others = lebesgue(nodes_of(degree, chebyshev=True)) * math.prod(lebesgue(of.nodes(i)) for i in of.smooth)
    return cut, second + others * smooth


def _smooth_remainder(of: Characteristic, axis: int, high: Vector, error: Vector) -> Vector:
    """What the interpolation in a smooth θ leaves (K,)."""
    size, still, rows = of.decay + high, np.zeros(len(high)), len(ELLIPSES)
    half, ellipses = (of.high[axis] - of.low[axis]) / 2, np.array(ELLIPSES)[:, None]
    wide, tall = (ellipses + 1 / ellipses) / 2, (ellipses - 1 / ellipses) / 2
    near = np.concatenate([of.aliases.near(still, still, axis, each) for each in ELLIPSES])
    near, reach, still = near + SOME * np.tile(error, (rows, 1, 1)), np.tile(high, rows), np.tile(still, rows)
    if axis == of.late:
        turned = np.exp(of.decay * half * (1 + wide) + size * half * tall).ravel()
        bound = _largest(of, reach, still, near, turned=turned)
    else:
        bound = _largest(of, reach, still, near, stretch=np.repeat(wide, len(high)))
    bound = bound.reshape(rows, len(high))
    return np.asarray(np.fmin.reduce((1 + 1 / SOME) * 4 * bound * ellipses ** -of.degrees[axis] / (ellipses - 1)))


def _largest(
    of: Characteristic,
    reach: Vector,
    tall: Vector,
    aliases: Vector,
    turned: Vector | float = 1.0,
    stretch: Vector | float = 0.0,
) -> Vector:
    """A bound on q (K,) where |ω| ≤ reach, |Im ω| ≤ tall and aliases (K, 2r, r) are no larger than these.

    Where h is `turned`, and masses are complex, `stretch` times as far from the middle as those of the box.
    """
    law, (servo, into), k = of.law, of.servo, len(of.law.law)
    size, real = of.decay + reach, of.decay + tall
    z, at = np.exp(real * of.period), size[:, None, None]
    late = np.asarray(z * np.exp(real * of.dead_times.max()) * turned)[:, None, None]
    found, neutral, unbraked = np.ones(len(reach)), of.neutral[0].shape[1], of.neutral[1]
    farther = np.asarray(stretch)[..., None, None]
    for most, apart, ports in of.largest:
        n = len(most.mass)
        (_, (torque, force), (_, whole)) = of.places(n)
        bound = np.zeros((len(reach), whole, whole))
        mass = most.mass + farther * apart.mass
        bound[:, :n, :n] = at * at * mass + at * most.damping + most.stiffness
        bound[:, :n, :neutral] = at * mass[..., :neutral] + most.damping[:, :neutral]
        bound[:, :n, :unbraked] = mass[..., :unbraked]
        bound[:, :n, n:torque] = np.abs(ports.servo)
        bound[:, :n, torque:force] = late * np.abs(ports.force)
        bound[:, n:torque, n:torque] = at * np.eye(torque - n) + np.abs(servo)
        bound[:, n:torque, torque:force] = late * np.abs(into)
        measured = np.abs(ports.position) + at * np.abs(ports.rate)
        for rows, matrix in ((slice(torque, force), law.force), (slice(force, whole), law.law)):
            seen = np.abs(matrix[:, k:])
            bound[:, rows, :n] = seen @ measured
            bound[:, rows, torque:force] = seen @ aliases
            bound[:, rows, force:] = np.abs(matrix[:, :k])
        bound[:, torque:force, torque:force] += np.eye(force - torque)
        bound[:, force:, force:] += z[:, None, None] * np.eye(whole - force)
        found = found * _hadamard(bound)
    return found


def _hadamard(bound: Vector) -> Vector:
    """A bound on determinants (K,) from one on the entries (K, n, n): the product of rows, columns scaled before."""
    # Of squares, in units of the largest entry.
    largest = np.maximum(bound.max(axis=(1, 2)), TINY)
    squares, scale = (bound / largest[:, None, None]) ** 2, np.ones((len(bound), bound.shape[2], 1))
    for _ in range(SCALINGS):
        rows = np.maximum(squares @ (1 / scale), TINY)
        scale = np.maximum(squares.swapaxes(1, 2) @ (1 / rows), 1e-200)
    rows = squares @ (1 / scale)
    sizes = (np.log(np.maximum(rows, TINY)) + np.log(scale)).sum(axis=(1, 2)) / 2
    found: Vector = np.exp(sizes + bound.shape[1] * np.log(largest)) * (1 + 1e-9)
    return found
