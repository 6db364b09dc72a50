"""First and second derivatives of what solvers are given, beside differences of the values: for any program.

Differences are central, of sixth order. A derivative that is wrong is wrong at every point, while differences lose
their digits where a distance changes its nearest feature: of several points the best one counts.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

STEP = 2e-3
POINTS = 4
Values = Callable[[np.ndarray], np.ndarray]


def differences(values: Values, x: np.ndarray, step: float = STEP) -> np.ndarray:
    """∂values/∂x (k, n) at x."""
    columns = []
    for i in range(x.size):
        e = step * np.eye(x.size)[i]
        near, far, farther = (values(x + k * e) - values(x - k * e) for k in (1, 2, 3))
        columns.append((45 * near - 9 * far + farther) / (60 * step))
    return np.array(columns).T


def away(derivative: np.ndarray, values: Values, x: np.ndarray) -> float:
    """Largest difference of a derivative (k, n) from differences, relative to its row's largest entry or 1."""
    expected = differences(values, x)
    size = np.maximum(1.0, np.abs(expected).max(axis=1, keepdims=True))
    return float((np.abs(derivative - expected) / size).max(initial=0.0))


def of_function(function: ca.Function, inputs: list[np.ndarray], value: int, slope: int, by: list[int]) -> float:
    """The same of a Function with a value among its outputs and its derivative by some of the inputs as another."""
    edges = np.cumsum([0, *(inputs[k].size for k in by)])

    def at(x: np.ndarray) -> list[np.ndarray]:
        given = list(inputs)
        for k, low, high in zip(by, edges[:-1], edges[1:], strict=True):
            given[k] = x[low:high]
        return [out.full() for out in function.call(given)]

    x = np.concatenate([inputs[k] for k in by])
    return away(at(x)[slope], lambda z: at(z)[value].ravel(), x)


def of_solver(solver: ca.Function, x: np.ndarray, p: np.ndarray, rng: np.random.Generator) -> dict[str, float]:
    """Gradient and Jacobian that a solver is given and, where it is given them, second derivatives."""
    names = ("nlp_f", "nlp_g", "nlp_grad_f", "nlp_jac_g", "nlp_hess_l")
    f, g, grad_f, jac_g, hess_l = (solver.get_function(name) for name in names)

    def values(z: np.ndarray) -> np.ndarray:
        return np.append(f.call([z, p])[0].full().ravel(), g.call([z, p])[0].full().ravel())

    gradient, jacobian = grad_f.call([x, p])[1].full().reshape(1, -1), jac_g.call([x, p])[1].full()
    of_f, of_g = rng.uniform(0.5, 1.5), rng.uniform(-1, 1, jacobian.shape[0])

    def lagrangian(z: np.ndarray) -> np.ndarray:
        return of_f * grad_f.call([z, p])[1].full().ravel() + of_g @ jac_g.call([z, p])[1].full()

    upper = hess_l.call([x, p, of_f, of_g])[0].full()
    hessian = upper + np.triu(upper, 1).T
    return {"first": away(np.vstack([gradient, jacobian]), values, x), "second": away(hessian, lagrangian, x)}


def best_of(
    check: Callable[[np.ndarray], dict[str, float]], points: list[np.ndarray], bar: float, **bars: float
) -> dict[str, float]:
    """The smallest of each figure over points, up to that by which all are below their bars: `bar`, or their own."""
    found: dict[str, float] = {}
    for x in points:
        found = {name: np.nanmin([value, found.get(name, np.nan)]) for name, value in check(x).items()}
        if all(value < bars.get(name, bar) for name, value in found.items()):
            break
    return found
