"""The quadratic program of a step, beside SciPy and beside its own conditions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog, minimize

from flexopt.selection.programs import Bounds
from flexopt.selection.quadratic import best_gain


def random_problem(rng: np.random.Generator, lowest: float) -> tuple[np.ndarray, np.ndarray, Bounds]:
    """Curvatures over decades down to `lowest`, equations, inequalities some of which are active at 0, and cuts."""
    n = int(rng.integers(2, 7))
    equal, unequal, cuts = int(rng.integers(0, min(n, 3))), int(rng.integers(0, 4)), int(rng.integers(1, 6))
    axes = np.linalg.qr(rng.normal(size=(n, n)))[0]
    bend = (axes * 10.0 ** rng.uniform(lowest, 1, n)) @ axes.T
    slope = rng.normal(size=n) * 10.0 ** rng.uniform(-6, 0)
    slopes = slope + rng.normal(size=(cuts, n)) * 10.0 ** rng.uniform(-6, 0)
    values = np.append(0.0, np.abs(rng.normal(size=cuts - 1)) * 10.0 ** rng.uniform(-6, -1))
    level = np.column_stack([rng.normal(size=(equal + unequal, n)), np.zeros(equal + unequal)])
    rows = np.vstack([level, np.column_stack([slopes, -np.ones(cuts)])])
    room = np.abs(rng.normal(size=unequal)) * 0.1 * (rng.uniform(size=unequal) > 0.3)
    low = np.concatenate([np.zeros(equal), -room, -values])
    high = np.concatenate([np.zeros(equal), np.full(unequal + cuts, np.inf)])
    distance = 10.0 ** rng.uniform(-4, 0)
    return bend, rows, Bounds(np.full(n, -distance), np.full(n, distance), low, high)


@pytest.mark.parametrize("seed", range(60))
def test_conditions_of_an_optimum(seed: int) -> None:
    """Of a convex problem they are sufficient: feasible, stationary, multipliers of the right signs, complementary."""
    bend, rows, bounds = random_problem(np.random.default_rng(seed), -7)
    found = best_gain(bend, rows, bounds)
    assert found is not None
    d, t, multipliers = found
    values, reach = rows @ np.append(d, t), bounds.x_upper[0]
    size = float(np.linalg.norm(rows[:, :-1], axis=1).max())
    assert np.all(values >= bounds.g_lower - 1e-9 * size * reach)
    assert np.all(values <= bounds.g_upper + 1e-9 * size * reach)
    assert np.abs(d).max() <= reach * (1 + 1e-9)
    unequal = bounds.g_lower < bounds.g_upper
    assert np.all(multipliers[unequal] <= 0)
    assert abs(multipliers[rows[:, -1] != 0].sum() + 1) <= 1e-8
    # What the rows leave of the gradient is what the box takes up.
    left = -bend @ d - multipliers @ rows[:, :-1]
    gradient = float(np.abs(rows[rows[:, -1] != 0, :-1]).max())
    inside = np.abs(d) < reach * (1 - 1e-6)
    assert np.abs(left[inside]).max(initial=0.0) <= 1e-7 * gradient
    assert np.all((left * np.sign(d))[~inside] >= -1e-7 * gradient)
    slack = np.where(unequal, values - bounds.g_lower, 0.0)
    assert abs(float(multipliers @ slack)) <= 1e-7 * gradient * reach


@pytest.mark.parametrize("seed", range(12))
def test_scipy_finds_nothing_better(seed: int) -> None:
    bend, rows, bounds = random_problem(np.random.default_rng(100 + seed), -1)
    found = best_gain(bend, rows, bounds)
    assert found is not None
    d, t, _ = found
    sought = rows[:, -1] != 0

    def loss(x: np.ndarray) -> float:
        return float(x[:-1] @ bend @ x[:-1] / 2 - x[-1])

    equal = bounds.g_lower == bounds.g_upper
    conditions = [
        {"type": "ineq", "fun": lambda x: (rows @ x - bounds.g_lower)[~equal], "jac": lambda _: rows[~equal]},
    ]
    if equal.any():
        conditions.append({"type": "eq", "fun": lambda x: rows[equal] @ x, "jac": lambda _: rows[equal]})
    box = [*zip(bounds.x_lower, bounds.x_upper, strict=True), (None, None)]
    start = np.append(np.zeros(d.size), float((-bounds.g_lower[sought]).min() - 1e-3))
    other = minimize(loss, start, jac=lambda x: np.append(bend @ x[:-1], -1.0), bounds=box, constraints=conditions,
                     method="SLSQP", options={"ftol": 1e-14, "maxiter": 500})  # fmt: skip
    assert loss(np.append(d, t)) <= other.fun + 1e-9


def test_without_curvature_it_is_a_linear_program() -> None:
    rng = np.random.default_rng(5)
    bend, rows, bounds = random_problem(rng, 0)
    found = best_gain(1e-9 * bend, rows, bounds)
    equal = bounds.g_lower == bounds.g_upper
    other = linprog(
        np.append(np.zeros(len(bend)), -1.0),
        A_ub=-rows[~equal], b_ub=-bounds.g_lower[~equal],
        A_eq=rows[equal] if equal.any() else None, b_eq=np.zeros(int(equal.sum())) if equal.any() else None,
        bounds=[*zip(bounds.x_lower, bounds.x_upper, strict=True), (None, None)],
    )  # fmt: skip
    assert found is not None
    # What the curvature takes: 1e-9 times the square of the step.
    assert abs(found[1] + other.fun) <= 1e-7


def test_what_contradicts_itself_has_no_solution() -> None:
    rows = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, -1.0]])
    bounds = Bounds(np.full(2, -1.0), np.full(2, 1.0), np.array([0.1, 0.1, 0.0]), np.full(3, np.inf))
    assert best_gain(np.eye(2), rows, bounds) is None
