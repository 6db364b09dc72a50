"""Polynomials of one variable in [0, 1] by values at nodes, by control points, and by Chebyshev coefficients."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from flexopt.foundation.arrays import Vector


def nodes_of(degree: int, *, chebyshev: bool = False) -> Vector:
    """Of a polynomial over [0, 1]: its ends among them, or where interpolation is best."""
    if chebyshev:
        return (1 - np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))) / 2
    return np.linspace(0.0, 1.0, degree + 1) if degree else np.array([0.5])


def bernstein(degree: int, at: Vector) -> Vector:
    """The polynomials (len(at), degree + 1)."""
    return np.array([math.comb(degree, i) * at**i * (1 - at) ** (degree - i) for i in range(degree + 1)]).T


@lru_cache(maxsize=64)
def _to_bernstein(nodes: tuple[float, ...]) -> Vector:
    return np.asarray(np.linalg.inv(bernstein(len(nodes) - 1, np.array(nodes))), dtype=np.float64)


def to_bernstein(nodes: Vector) -> Vector:
    """From values at nodes to control points, in whose hull all values lie."""
    return _to_bernstein(tuple(nodes.tolist()))


@lru_cache(maxsize=64)
def _lebesgue(nodes: tuple[float, ...]) -> float:
    fine = np.linspace(0, 1, 401)
    return 1.05 * float(np.abs(bernstein(len(nodes) - 1, fine) @ _to_bernstein(nodes)).sum(axis=1).max())


def lebesgue(nodes: Vector) -> float:
    """The Lebesgue constant of interpolation, a little more: how far values are above those at nodes at most."""
    return _lebesgue(tuple(nodes.tolist()))


@lru_cache(maxsize=256)
def splitting(degree: int, at: float) -> tuple[Vector, Vector]:
    """From control points over [0, 1] to those over [0, at] and [at, 1], after de Casteljau."""
    left, right = np.zeros((degree + 1, degree + 1)), np.zeros((degree + 1, degree + 1))
    for i in range(degree + 1):
        left[i, : i + 1] = bernstein(i, np.array([at]))[0]
        right[i, i:] = bernstein(degree - i, np.array([at]))[0]
    return left, right


def to_chebyshev(nodes: Vector) -> Vector:
    """From values at Chebyshev nodes in [−1, 1] to coefficients."""
    found: Vector = 2 / len(nodes) * np.cos(np.outer(np.arange(len(nodes)), np.arccos(nodes)))
    found[0] /= 2
    return found


def chebyshev(size: int, at: Vector) -> Vector:
    """The polynomials (…, size) at points in [−1, 1]."""
    found: Vector = np.cos(np.arange(size) * np.arccos(np.clip(at, -1, 1))[..., None])
    return found
