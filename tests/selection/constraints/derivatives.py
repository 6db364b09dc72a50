"""Derivatives of a Function's only output: finite everywhere, and equal to central differences where it is smooth."""

from __future__ import annotations

import casadi as ca
import numpy as np


def with_derivatives(function: ca.Function) -> ca.Function:
    """Value, gradient and Hessian of a scalar Function by all its inputs, stacked."""
    symbols = [ca.SX.sym(f"x{i}", *function.size_in(i)) for i in range(function.n_in())]
    value = function.call(symbols)[0]
    hessian, gradient = ca.hessian(value, ca.vertcat(*map(ca.vec, symbols)))
    return ca.Function("derivatives", symbols, [value, gradient, hessian])


def all_finite(function: ca.Function, *arguments) -> bool:
    return all(np.isfinite(np.array(part)).all() for part in function.call([ca.DM(np.asarray(a)) for a in arguments]))


def difference_error(function: ca.Function, arguments, step: float = 1e-6) -> float:
    """Largest error of the gradient (output 1) against central differences of the value (output 0), by all inputs."""
    sizes = [np.size(a) for a in arguments]
    flat = np.concatenate([np.ravel(a) for a in arguments])
    split = lambda x: [np.asarray(part) for part in np.split(x, np.cumsum(sizes)[:-1])]  # noqa: E731
    value = lambda x: float(function.call(split(x))[0])  # noqa: E731
    steps = step * np.eye(flat.size)
    numeric = np.array([(value(flat + e) - value(flat - e)) / (2 * step) for e in steps])
    return float(np.abs(np.array(function.call(split(flat))[1]).ravel() - numeric).max())
