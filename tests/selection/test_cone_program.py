"""The cone program of a step, beside SciPy and beside its own conditions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog, minimize

from flexopt.selection.ascent.cone_interior import interior
from flexopt.selection.ascent.cone_newton import ConicPoint, ConicProgram, newton
from flexopt.selection.ascent.cone_program import Cones, Gain, best_gain
from flexopt.selection.nlp.solvers import Bounds


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
    d, t, multipliers = found.d, found.rise, found.multipliers
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
    d, t = found.d, found.rise
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
    assert abs(found.rise + other.fun) <= 1e-7


def test_what_contradicts_itself_has_no_solution() -> None:
    rows = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, -1.0]])
    bounds = Bounds(np.full(2, -1.0), np.full(2, 1.0), np.array([0.1, 0.1, 0.0]), np.full(3, np.inf))
    assert best_gain(np.eye(2), rows, bounds) is None


def test_what_a_cone_forbids_has_no_solution() -> None:
    """0.5 − |d| ≥ 0 with d_0 ≥ 0.6: the box alone would allow it."""
    rows = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 1.0, -1.0]])
    bounds = Bounds(np.full(2, -1.0), np.full(2, 1.0), np.array([0.6, -0.5, 0.0]), np.full(3, np.inf))
    cones = Cones(np.zeros((1, 2)), np.eye(2)[None], np.array([[0.0], [1.0], [0.0]]))
    assert best_gain(np.eye(2), rows, bounds, cones) is None
    bounds.g_lower[0] = 0.3
    found = best_gain(np.eye(2), rows, bounds, cones)
    assert found is not None
    # On the circle: d_1 = √(0.5² − 0.3²).
    np.testing.assert_allclose(found.d, [0.3, 0.4], atol=1e-12)


def random_cones(
    rng: np.random.Generator, rows: np.ndarray, bounds: Bounds, kept: int
) -> tuple[np.ndarray, Bounds, Cones]:
    """Up to four cones, some of less rank than rows and some with d = 0 or a random d at their tips.

    Sizes differ by 1e6; `kept` more rows with cones do not bound t, and hold at d = 0 with little or no room.
    """
    n, m, r = rows.shape[1] - 1, int(rng.integers(1, 5)), int(rng.integers(2, 7))
    slopes = rng.normal(size=(m, r, n)) * 10.0 ** rng.uniform(-2, 2, (m, 1, 1))
    for i in np.flatnonzero(rng.uniform(size=m) < 0.4):
        slopes[i] = np.outer(rng.normal(size=r), rng.normal(size=n))
    tips = rng.uniform(-1, 1, (m, n)) * bounds.x_upper * (rng.uniform(size=(m, 1)) < 0.6)
    values = -(slopes @ tips[:, :, None])[:, :, 0]
    values += 0.1 * bounds.x_upper[0] * rng.normal(size=(m, r)) * (rng.uniform(size=(m, 1)) < 0.4)
    more = np.column_stack([rng.normal(size=(kept, n)), np.zeros(kept)])
    every = np.concatenate([rows, more])
    counts = np.append(rows[:, -1] != 0, np.full(kept, fill_value=True))
    sizes = counts[:, None] * 10.0 ** rng.uniform(-6, 0, (len(every), m))
    room = np.append(np.zeros(len(rows)), 0.1 * bounds.x_upper[0] * (rng.uniform(size=kept) < 0.7))
    low = np.append(bounds.g_lower, np.zeros(kept)) - sizes @ np.linalg.norm(values, axis=1) - room
    high = np.append(bounds.g_upper, np.full(kept, np.inf))
    return every, Bounds(bounds.x_lower, bounds.x_upper, low, high), Cones(values, slopes, sizes)


def gap(bend: np.ndarray, rows: np.ndarray, bounds: Bounds, cones: Cones, found: Gain) -> tuple[float, float]:
    """How far a solution is from one that its own multipliers allow, and how far from what is feasible; scaled.

    With u_i = forces_i / Λ_i in |c_i + C_i d| ≥ u_i · (c_i + C_i d) the problem is linear in d but for the curvature,
    and by how much d can be beaten within the box is told by the gradient and by the slack of rows.
    """
    multipliers, equal = found.multipliers, bounds.g_lower == bounds.g_upper
    assert np.all(multipliers[~equal] <= 0)
    assert abs(multipliers @ rows[:, -1] - 1) <= 1e-9
    total = np.where(equal, 0.0, -multipliers) @ cones.sizes
    assert np.all(np.linalg.norm(found.forces, axis=1) <= total * (1 + 1e-9) + 1e-12)
    after = cones.values + cones.slopes @ found.d
    lengths = np.linalg.norm(after, axis=1)
    reach = float(bounds.x_upper[0])
    values = rows @ np.append(found.d, found.rise) - cones.sizes @ lengths
    size = np.linalg.norm(rows[:, :-1], axis=1) + cones.sizes @ np.linalg.norm(cones.slopes, axis=(1, 2))
    beyond = float((np.maximum(bounds.g_lower - values, values - bounds.g_upper) / size).max()) / reach
    gradient = -bend @ found.d - multipliers @ rows[:, :-1] - np.einsum("ir,irn->n", found.forces, cones.slopes)
    slack = np.where(np.isfinite(bounds.g_lower) & ~equal, values - bounds.g_lower, 0.0)
    lost = float(-multipliers @ slack + total @ lengths - (found.forces * after).sum())
    lost += float(np.maximum(gradient, 0.0) @ (bounds.x_upper - found.d))
    lost += float(np.maximum(-gradient, 0.0) @ (found.d - bounds.x_lower))
    sought = rows[:, -1] != 0
    return abs(lost) / (float(size[sought].max()) * reach), beyond


@pytest.mark.parametrize("seed", range(80))
def test_conditions_of_an_optimum_with_cones(seed: int) -> None:
    """Forces within |p| ≤ Λ, complementary, stationary: sufficient, as the program is convex."""
    rng = np.random.default_rng(seed)
    bend, rows, bounds = random_problem(rng, -7)
    rows, bounds, cones = random_cones(rng, rows, bounds, seed % 3)
    found = best_gain(bend, rows, bounds, cones)
    assert found is not None
    lost, beyond = gap(bend, rows, bounds, cones, found)
    # Equations hold to 1e-10 of the box in the program's scale, and as much for each of some ten entries.
    assert lost <= 1e-8
    assert beyond <= 1e-9
    assert np.abs(found.d).max() <= bounds.x_upper[0] * (1 + 1e-9)
    # From its own multipliers the same solution is found.
    again = best_gain(bend, rows, bounds, cones, (found.multipliers, found.forces))
    assert again is not None
    assert abs(float(again.rise - again.d @ bend @ again.d / 2 - found.rise + found.d @ bend @ found.d / 2)) <= 1e-9


@pytest.mark.long("4")
@pytest.mark.parametrize("seed", range(12))
def test_scipy_finds_nothing_better_with_cones(seed: int) -> None:
    """SLSQP on the same program with heights h_i, h_i² ≥ |c_i + C_i d|²; where it ends off the rows it tells nothing."""
    rng = np.random.default_rng(200 + seed)
    bend, rows, bounds = random_problem(rng, -1)
    rows, bounds, cones = random_cones(rng, rows, bounds, seed % 2)
    found = best_gain(bend, rows, bounds, cones)
    assert found is not None
    n, equal = len(bend), bounds.g_lower == bounds.g_upper

    def value(d: np.ndarray) -> float:
        """The model at d, where rows that do not bound t hold."""
        kept = rows @ np.append(d, 0.0) - cones.sizes @ np.linalg.norm(cones.values + cones.slopes @ d, axis=1)
        sought = rows[:, -1] != 0
        return float((kept - bounds.g_lower)[sought].min() - d @ bend @ d / 2)

    def parts(x: np.ndarray) -> np.ndarray:
        return np.asarray((cones.values + cones.slopes @ x[:n])[:, :, None])

    conditions = [
        {"type": "ineq", "fun": lambda x: (rows @ x[: n + 1] - cones.sizes @ x[n + 1 :] - bounds.g_lower)[~equal]},
        {"type": "ineq", "fun": lambda x: x[n + 1 :] ** 2 - (parts(x)[:, :, 0] ** 2).sum(1)},
    ]
    if equal.any():
        conditions.append({"type": "eq", "fun": lambda x: (rows @ x[: n + 1])[equal]})
    assert abs(value(found.d) - found.rise + found.d @ bend @ found.d / 2) <= 1e-9
    first = np.linalg.norm(cones.values, axis=1)
    box = [*zip(bounds.x_lower, bounds.x_upper, strict=True), (None, None), *([(0.0, None)] * len(first))]
    other = minimize(lambda x: float(x[:n] @ bend @ x[:n] / 2 - x[n]), np.concatenate([np.zeros(n + 1), first]),
                     bounds=box, constraints=conditions, method="SLSQP",
                     options={"ftol": 1e-13, "maxiter": 400})  # fmt: skip
    off = (rows @ np.append(other.x[:n], 0.0))[equal]
    level = ~equal & (rows[:, -1] == 0)
    low = rows @ np.append(other.x[:n], 0.0)
    low = low - cones.sizes @ np.linalg.norm(cones.values + cones.slopes @ other.x[:n], axis=1) - bounds.g_lower
    if np.abs(off).max(initial=0.0) <= 1e-9 and low[level].min(initial=0.0) >= -1e-9:
        assert value(other.x[:n]) <= value(found.d) + 1e-7


@pytest.mark.parametrize("rank", [1, 2])
@pytest.mark.parametrize(("slope", "at_tip"), [(0.9, True), (1.1, False)])
def test_the_tip_of_a_cone(rank: int, *, slope: float, at_tip: bool) -> None:
    """t ≤ slope d_0 − |C d − c|: at the tip while slope ≤ |C|, else beyond it as far as the box or curvature lets."""
    slopes = np.array([[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]]) if rank == 2 else np.array([[[0.6, 0, 0], [0.8, 0, 0]]])
    tip = np.array([0.1, 0.2 if rank == 2 else 0.0, 0.0])
    cones = Cones(-(slopes @ tip), slopes, np.ones((1, 1)))
    box = Bounds(np.full(3, -1.0), np.full(3, 1.0), np.zeros(1), np.full(1, np.inf))
    found = best_gain(1e-3 * np.eye(3), np.array([[slope, 0.0, 0.0, -1.0]]), box, cones)
    assert found is not None
    if at_tip:
        np.testing.assert_allclose(found.d, tip, atol=1e-14)
        np.testing.assert_allclose(found.rise, slope * tip[0], atol=1e-14)
        # Stationary: the slope less what curvature takes is the force through C.
        np.testing.assert_allclose(slopes[0].T @ found.forces[0], [slope - 1e-4, -1e-3 * tip[1], 0], atol=1e-14)
    else:
        np.testing.assert_allclose(found.d[0], 1.0, atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(found.forces[0]), 1.0, atol=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_what_equations_hold_bounds_nothing(seed: int) -> None:
    """An entry that an equation holds, but for rounding: the solution is that of the program without the entry."""
    rng = np.random.default_rng(1000 + seed)
    bend, rows, bounds = random_problem(rng, -1)
    rows, bounds, cones = random_cones(rng, rows, bounds, 0)
    n = bend.shape[0]
    without = best_gain(bend, rows, bounds, cones)
    assert without is not None
    # Another entry, coupled to the others by rounding alone, in an equation and in a row of its own.
    wider = np.zeros((n + 1, n + 1))
    wider[:n, :n] = bend
    held = np.append(1e-16 * rng.normal(size=n), [5.0, 0.0])
    own = np.append(1e-16 * rng.normal(size=n), [1e-15, 0.0])
    more = np.vstack([held, own, np.insert(rows, n, 1e-16 * rng.normal(size=len(rows)), axis=1)])
    ends = Bounds(
        np.append(bounds.x_lower, -0.1),
        np.append(bounds.x_upper, 0.1),
        np.append([1e-16, -0.3], bounds.g_lower),
        np.append([1e-16, np.inf], bounds.g_upper),
    )
    slopes = np.concatenate([cones.slopes, np.zeros((*cones.slopes.shape[:2], 1))], axis=2)
    found = best_gain(
        wider, more, ends, Cones(cones.values, slopes, np.vstack([np.zeros((2, len(cones.values))), cones.sizes]))
    )
    assert found is not None
    reach = float(bounds.x_upper[0])
    assert abs(found.d[n]) <= 1e-14
    assert np.abs(found.d[:n] - without.d).max() <= 1e-7 * reach


def test_a_cone_far_smaller_than_its_neighbours_keeps_its_digits() -> None:
    """Two cones with one tip, of sizes 1 and 1e-6: d_1 follows from the small one to all digits."""
    values, slopes = np.zeros((2, 2)), np.zeros((2, 2, 3))
    slopes[0, 0, 0] = slopes[1, 0, 1] = slopes[1, 1, 2] = 1.0
    values[1] = [-0.3, 1e-3]
    box = Bounds(np.full(3, -1.0), np.full(3, 1.0), np.array([-1e-6 * np.hypot(0.3, 1e-3)]), np.full(1, np.inf))
    cones = Cones(values, slopes, np.array([[1.0, 1e-6]]))
    found = best_gain(np.diag([1.0, 1e-9, 1e-9]), np.array([[0.5, 0.0, 0.0, -1.0]]), box, cones)
    assert found is not None
    np.testing.assert_allclose(found.d, [0.0, 0.3, -1e-3], atol=1e-10)


@pytest.mark.parametrize("seed", range(8))
def test_both_ways_lead_to_one_solution(seed: int) -> None:
    """The interior method alone, to its last iteration, and Newton's steps from its end."""
    rng = np.random.default_rng(300 + seed)
    n, m, r, k = 4, 3, 3, 2
    axes = np.linalg.qr(rng.normal(size=(n, n)))[0]
    second = np.zeros((n + 1, n + 1))
    second[:n, :n] = (axes * 10.0 ** rng.uniform(-2, 0, n)) @ axes.T
    cuts = np.column_stack([-0.3 * rng.normal(size=(k, n)), np.ones(k)])
    box = np.concatenate([np.eye(n, n + 1), -np.eye(n, n + 1)])
    values = 0.3 * rng.normal(size=(m, r)) * (np.arange(m) > 0)[:, None]
    sizes = np.concatenate([rng.uniform(0, 1, (k, m)), np.zeros((2 * n, m))])
    # As much as keeps the first cone, of rank 2, at its tip.
    sizes[:k, 0] += 3.0
    slopes = 0.3 * rng.normal(size=(m, r, n))
    slopes[0, :, 2:] = slopes[0, :, :2] @ rng.normal(size=(2, 2))
    program = ConicProgram(second, np.concatenate([cuts, box]), np.append(rng.uniform(0, 0.1, k), np.ones(2 * n)), sizes,
                      values, slopes)  # fmt: skip
    _, error, last = min(interior(program), key=lambda point: point[1])
    # Equations whose coefficients differ by 1 / error: half the digits are sure.
    assert error <= 1e-8
    found = newton(program, last, 12)
    assert found is not None
    np.testing.assert_allclose(found.v, last.v, atol=1e-4)
    assert np.linalg.norm(program.slopes[0] @ found.v[:-1]) <= 1e-12
    # From a few percent beside, too: quadratically, at tips as off them.
    noise = 1 + 0.03 * rng.uniform(-1, 1, (m, r))
    beside = ConicPoint(found.v * noise[0, 0], found.pulls * noise[1, 0], found.forces * noise, found.active)
    again = newton(program, beside, 6)
    assert again is not None
    np.testing.assert_allclose(again.v, found.v, atol=1e-9)
    loss = [float(v @ second @ v / 2 - v[-1]) for v in (found.v, last.v)]
    assert abs(loss[0] - loss[1]) <= 1e-7
