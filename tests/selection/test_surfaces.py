"""Optima that are surfaces: equations of a ∥ b, dimensions, the best along a surface, the nearest of what is alike."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.optimize import brentq, least_squares

import flexopt
from benchmarks.choice import chosen
from benchmarks.dimensions import cases, examined
from flexopt.model import tree_from_dict
from flexopt.selection.cones import Parallel, split_factors
from flexopt.selection.continua import nearest, travel
from flexopt.selection.starts import apart, idle_joints
from flexopt.selection.surfaces import STARTS
from tests.oracles.machines import random_machine
from tests.oracles.spatial import pinocchio_tree, telescope


@pytest.mark.parametrize("task_rows", [2, 3, 4])
def test_equations_of_parallel_factors_are_zero_there_alone_and_have_their_slopes(task_rows: int) -> None:
    """Beside differences; r − 1 of them, of full rank where a ∥ b."""
    rng = np.random.default_rng(task_rows)
    n, m = 5, 2
    tangent = rng.normal(size=(2 * task_rows * m, n))

    def factors(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        f = (np.sin(tangent) @ x + 0.3 * np.cos(tangent @ x)).reshape(m, 2 * task_rows).T
        slopes = np.sin(tangent) - 0.3 * np.sin(tangent @ x)[:, None] * tangent
        return split_factors(f, slopes)

    start = rng.normal(size=n)
    chart = Parallel.at(*factors(start), (0, 1))
    assert chart.equations == m * (task_rows - 1)
    x = start + 0.05 * rng.normal(size=n)
    step = 1e-6 * np.eye(n)
    told = chart.slopes(*factors(x))
    beside = [(chart.values(factors(x + d)[0]) - chart.values(factors(x - d)[0])) / 2e-6 for d in step]
    # Rounding of the differences: 1e-16 / 1e-6.
    assert np.abs(told - np.array(beside).T).max() <= 1e-8 * np.abs(told).max()

    f, slopes = factors(start)
    f[:, 1] = f[:, 0] * [[2.0], [0.7]]
    assert np.abs(Parallel.at(f, slopes, (0, 1)).values(f)[: chart.equations]).max() <= 1e-15
    aside = f.copy()
    aside[0, 1] += 1e-3 * np.linalg.norm(f[0, 1]) * np.linalg.svd(f[0, :1])[2][-1]
    assert np.abs(Parallel.at(f, slopes, (0, 1)).values(aside)[: chart.equations]).max() >= 1e-4
    # Along each other inside the inequalities, against each other outside.
    assert Parallel.at(f, slopes, (0, 1)).values(f)[chart.equations :].min() > 0
    f[:, 1] *= -1
    assert np.all(Parallel.at(f, slopes, (0, 1)).values(f)[chart.equations :].reshape(-1, 2).min(axis=1) < 0)


def test_equations_of_a_factor_that_stays_zero_are_zero_with_it_and_have_their_slopes() -> None:
    """One of two modes has a_i = s u, s a number: one equation, and no inequalities, of s = 0; beside differences."""
    rng = np.random.default_rng(4)
    n, along = 4, np.array([0.6, -0.8])
    slope, tangent = rng.normal(size=n), rng.normal(size=(6, n))

    def factors(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        s, others = np.sin(slope @ x), np.cos(tangent @ x) + 0.5
        f = np.array([[s * along, others[:2]], [others[2:4], others[4:]]])
        f_x = np.empty((2, 2, 2, n))
        f_x[0, 0] = np.cos(slope @ x) * np.outer(along, slope)
        f_x.reshape(8, n)[2:] = -np.sin(tangent @ x)[:, None] * tangent
        return f, f_x

    start = rng.normal(size=n)
    start -= slope * (slope @ start) / (slope @ slope)
    axes = np.array([along])
    chart = Parallel.at(*factors(start), (0, 1), {0: axes})
    assert chart.equations == 1 + 1
    assert chart.upper.size == 1 + 1 + 2
    x = start + 0.05 * rng.normal(size=n)
    beside = [(chart.values(factors(x + d)[0]) - chart.values(factors(x - d)[0])) / 2e-6 for d in 1e-6 * np.eye(n)]
    told = chart.slopes(*factors(x))
    # Rounding of the differences: 1e-16 / 1e-6.
    assert np.abs(told - np.array(beside).T).max() <= 1e-8 * np.abs(told).max()
    on = x - slope * (slope @ x) / (slope @ slope)
    assert abs(chart.values(factors(on)[0])[0]) <= 1e-14 < 1e-3 < abs(chart.values(factors(x)[0])[0])


@pytest.mark.long("0", "1", "7")
@pytest.mark.parametrize("seed", [0, 1, 5, 7])
def test_a_curve_along_which_a_factor_stays_zero_is_one_optimum(seed: int) -> None:
    """a_1 = 0 as a telescope goes out, by Pinocchio's masses and Jacobians and SciPy's modes.

    Curves are followed from each candidate to the limits by steps of 0.04 and Newton's with differences: all the other
    candidates lie off it, and what was found of its set and rests on the kink lies on it.
    """
    data, step = telescope(seed), 0.04
    oracle = pinocchio_tree(data)
    springs = np.diag([body["joint"].get("stiffness", 0.0) for body in data["bodies"]])
    lower, upper = np.transpose([body["joint"]["limits"] for body in data["bodies"][3:]])

    def modes(posture: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """a_i (2, 3) and w_i (3,); and how high the end-point is."""
        q = np.append(np.zeros(3), posture)
        r, jacobian, _ = oracle.task(q, np.zeros(3))
        shapes = eigh(springs, oracle.mass(q))[1][:, 3:]
        shapes *= np.sign(shapes[np.abs(shapes[:3]).argmax(axis=0), range(3)])
        a, b = jacobian @ shapes, np.linalg.pinv(jacobian[:, 3:]).T @ shapes[3:]
        return a, np.sum(a * b, axis=0) - np.linalg.norm(a, axis=0) * np.linalg.norm(b, axis=0), float(r[1])

    # A place on the curve, which sets the target's height.
    lift = brentq(lambda lift: modes(np.array([lift, 1.2, -0.4]))[0][1, 0], lower[0], upper[0], xtol=1e-15)
    a, _, height = modes(np.array([lift, 1.2, -0.4]))
    assert np.linalg.norm(a[:, 0]) <= 1e-15
    found = flexopt.select(tree_from_dict(data), (4.0, height), objective="w1", starts=8, workers=1)

    def off(posture: np.ndarray) -> np.ndarray:
        a, _, z = modes(posture)
        return np.append(1e3 * a[:, 0], z - height)

    def slopes(posture: np.ndarray) -> np.ndarray:
        return np.transpose([(off(posture + d) - off(posture - d)) / 2e-6 for d in 1e-6 * np.eye(3)])

    def followed(posture: np.ndarray, way: float) -> list[np.ndarray]:
        path, ahead = list[np.ndarray](), way * np.linalg.svd(slopes(posture))[2][-1]
        while np.all((posture >= lower - 1e-9) & (posture <= upper + 1e-9)):
            path.append(posture)
            posture = posture + step * ahead
            for _ in range(3):
                # Of three equations two are left where a_1 has one direction.
                posture = posture - np.linalg.pinv(slopes(posture), rcond=1e-5) @ off(posture)
            assert np.abs(off(posture)).max() <= 1e-10
            assert np.linalg.norm(posture - path[-1]) <= 1.5 * step
            after = np.linalg.svd(slopes(posture))[2][-1]
            ahead = after * np.sign(after @ ahead)
        return path

    def away(posture: np.ndarray, curve: np.ndarray) -> float:
        return float(np.linalg.norm(curve - posture, axis=1).min())

    resting = [candidate for candidate in found.candidates if "kink of w1: a1 = 0" in candidate.kinks]
    assert resting
    for candidate in resting:
        assert candidate.dimension == 1
        assert candidate.unsurpassed
        curve = np.array([*followed(candidate.z[1:], 1.0), *followed(candidate.z[1:], -1.0)])
        assert len(curve) > 10
        others = [other.z[1:] for other in found.candidates if other is not candidate]
        # Points of the curve are no further than a step from the next of it, beyond which it may end.
        assert min((away(posture, curve) for posture in others), default=1.0) > step
        points = [np.array(z)[1:] for z in candidate.representatives]
        on = [away(posture, curve) for posture in points if np.linalg.norm(modes(posture)[0][:, 0]) <= 1e-12]
        assert on
        assert max(on) <= step
        ends = np.transpose(list(candidate.extent.values()))[:, 1:]
        assert np.all(np.ptp(ends, axis=0) > 0)
        # Nothing beside it along the curve is better.
        beside = curve[np.linalg.norm(curve - candidate.z[1:], axis=1) < 5 * step]
        worst = [modes(posture)[1][1:].min() for posture in beside]
        assert max(worst) <= candidate.w[1:].min() + 1e-9 * found.problem.objective_scale


@pytest.mark.long("boom-stick-bucket 7", "2: random-5-x-y-")
@pytest.mark.parametrize("case", [*list(cases(6))[2::2], list(cases(8))[7]], ids=lambda case: case[0])
def test_dimensions_are_those_of_a_walk(case) -> None:
    """By least squares of SciPy's with its own differences; V = 0 at each of these."""
    _, _, told, walked, why = examined(case)
    assert not why or why == "V is not 0"
    assert told == walked or why


@functools.cache
def slewing(seed: int) -> flexopt.Selection:
    """w_1 of the slewing excavator, a surface of dimension 2."""
    return flexopt.select(flexopt.load("slewing-excavator"), (6, 2, 1), objective="w1", seed=seed, starts=4, workers=1)


@pytest.mark.long
def test_chance_does_not_decide_what_is_recommended() -> None:
    """Nor how many surfaces there are."""
    first, second = slewing(0), slewing(3)
    away = (first.best.z - second.best.z + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(away / first.problem.scale).max() <= 1e-3
    for found in (first, second):
        assert found.best.unsurpassed
        assert found.best.dimension == 2
        assert sum(candidate.unsurpassed for candidate in found.candidates) == 2
        assert "worst of the other w_i" in repr(found)


@pytest.mark.long
def test_nor_where_the_surface_has_an_edge() -> None:
    """Optima of the truck crane stand where a_1 = 0, in its plane of symmetry."""
    machine, target, options = chosen("truck-crane", 1)
    found = [
        flexopt.select(machine, target, objective="w1", control=options["control"], seed=seed, starts=2, workers=1)
        for seed in (0, 2)
    ]
    assert all("kink of w1: a1 = 0" in each.best.kinks and each.best.dimension == 2 for each in found)
    resting = [[c for c in each.candidates if "kink of w1: a1 = 0" in c.kinks] for each in found]
    worst = [[c.w[1:].min() for c in each] for each in resting]
    np.testing.assert_allclose(worst[0], worst[1], rtol=0, atol=1e-8 * found[0].problem.objective_scale)
    away = (found[0].best.z - found[1].best.z)[np.array([0, 1, 6])]
    turned = np.sin((found[0].best.z - found[1].best.z)[2:6] / 2)
    assert max(np.abs(away).max(), 2 * np.abs(turned).max()) <= 1e-3


@pytest.mark.long
def test_no_point_of_the_surface_nearby_has_better_other_modes() -> None:
    """Points that least squares, with differences of SciPy's, move onto the surface from around the best."""
    found = slewing(0)
    problem, best = found.problem, found.best
    n_base, p = problem.measures.plant.n_base, problem.measures.plant.parameter_values
    rng = np.random.default_rng(1)

    def residual(z: np.ndarray) -> np.ndarray:
        out = problem.measures.w.call([z[:n_base], z[n_base:], p])
        a, b = problem.factors(z)[0][0]
        return np.append(out[2].full().ravel() - problem.target, np.cross(a, b) / np.linalg.norm(a) / np.linalg.norm(b))

    tried = 0
    for _ in range(15):
        z = least_squares(residual, best.z + 0.03 * rng.normal(size=best.z.size), xtol=1e-15, ftol=1e-15, gtol=1e-15).x
        if np.abs(residual(z)).max() > 1e-9 or np.any(z < problem.lower) or np.any(z > problem.upper):
            continue
        tried += 1
        w = problem.measures.w.call([z[:n_base], z[n_base:], p])[0].full().ravel()
        assert w[1:].min() <= best.w[1:].min() + 1e-9 * problem.objective_scale
    assert tried >= 4


@pytest.mark.long
def test_extents_hold_the_representatives() -> None:
    """And the candidate itself; a point alone has none."""
    for candidate in slewing(0).candidates:
        points = [candidate.z, *candidate.representatives] if candidate.extent else []
        for z in points[1:]:
            for value, (low, high) in zip(z, candidate.extent.values(), strict=True):
                assert low <= value <= high
    assert slewing(0).best.to_dict()["dimension"] == 2
    assert len(slewing(0).best.to_dict()["representatives"]) >= 1


@pytest.mark.parametrize("name", ["slewing-excavator", "mobile-manipulator"])
def test_nothing_that_is_alike_is_nearer(name: str) -> None:
    """Than what `nearest` gives: among random turns about the target, whole turns of joints, and rolls of a tool."""
    machine, target, options = chosen(name, 0)
    problem = flexopt.build_selection(
        machine, target, objective="w1", control=options["control"], assume="ground,limits"
    )
    plant, rng = problem.measures.plant, np.random.default_rng(3)
    n_base, p = plant.n_base, plant.parameter_values
    z = np.concatenate([problem.scan.base[:, 0], problem.scan.posture[:, 0]])
    near = nearest(problem, z)
    w, _, r = (x.full().ravel() for x in problem.measures.w.call([near[:n_base], near[n_base:], p])[:3])
    before, size = (x.full().ravel() for x in problem.measures.w.call([z[:n_base], z[n_base:], p])[:2])
    assert np.abs(w - before).max() <= 1e-9 * size.max()
    assert np.abs(r - target).max() <= 1e-8
    x, y = target[:2]
    for _ in range(200):
        angle, other = rng.uniform(-np.pi, np.pi), near.copy()
        turn = np.exp(1j * angle) * complex(near[0] - x, near[1] - y)
        other[:3] = x + turn.real, y + turn.imag, near[2] + angle
        for k in range(n_base, z.size):
            if not problem.turning[k]:
                whole = other[k] + 2 * np.pi * rng.integers(-2, 3)
                other[k] = whole if problem.lower[k] <= whole <= problem.upper[k] else other[k]
        assert travel(problem, near) <= travel(problem, other) + 1e-9


@pytest.mark.long
def test_nothing_to_gain_is_said_where_the_machine_stands_well() -> None:
    """And not where it does not."""
    best = slewing(0).best.z
    again = flexopt.select(
        flexopt.load("slewing-excavator"),
        (6, 2, 1),
        objective="w1",
        base=best[:3],
        posture=best[3:],
        starts=4,
        workers=1,
    )
    assert again.nothing_to_gain.startswith("nothing to gain")
    assert again.nothing_to_gain in repr(again)
    elsewhere = flexopt.select(
        flexopt.load("excavator"), (0, 1.6), objective="w1", base=[-2.9738], posture=[-0.9382, 0.1745]
    )
    assert elsewhere.nothing_to_gain == ""


@pytest.mark.long
def test_a_planar_arm_of_more_joints_has_curves_of_optima() -> None:
    """Dimension n + 1 − 2 − 1, and the second mode decides."""
    for seed in range(40):
        rng = np.random.default_rng(seed)
        _, machine = random_machine(rng)
        if len(machine.joints) == 3 and flexopt.build_plant(machine).n_passive > 1:
            break
    plant = flexopt.build_plant(machine)
    base, posture = np.zeros(1), np.array([0.9, -1.1, 0.8])
    target = plant.end_point(plant.rest(base, posture, plant.parameter_values), base, plant.parameter_values)
    found = [
        flexopt.select(machine, target.full().ravel(), objective="w1", seed=seed, starts=3, workers=1)
        for seed in (0, 1)
    ]
    assert all(each.best.dimension == 1 for each in found)
    worst = [each.best.w[1:].min() for each in found]
    assert abs(worst[0] - worst[1]) <= 1e-6 * found[0].problem.objective_scale


def test_starts_apart_are_no_copies_by_whole_turns_or_idle_joints() -> None:
    """The roll of the mobile manipulator's tool moves nothing, and its joints may make two turns."""
    machine = flexopt.load("mobile-manipulator")
    problem = flexopt.build_selection(machine, (1.1, 0.1, 0.4), objective="w1", starts=2)
    z = np.append(problem.region.low[:3], [0.3, -0.5, 1.1, -0.7, 0.4, 0.0])
    assert idle_joints(problem, z) == [z.size - 1]
    columns = np.repeat(z[:, None], 6, axis=1)
    columns[3, 1] -= 2 * np.pi
    columns[7, 2] += 2 * np.pi
    columns[8, 3] = 3.0
    columns[:3, 4] += 0.5
    columns[5, 5] += 0.2
    assert [tuple(start) for start in apart(problem, columns, 2)] == [tuple(z), tuple(columns[:, 5])]


def test_an_epsilon_that_nobody_sought_is_told_of_where_others_have_twice_as_much() -> None:
    found = flexopt.select(flexopt.load("excavator"), (0, 1.6), base=0.0, starts=8, workers=1)
    assert found.left_out == ""
    thin = replace(found.best.evaluation, epsilon_max=0.1)
    best = replace(found.best, evaluate=lambda: thin)
    told = replace(found, best=best, candidates=(best, *found.candidates[1:]))
    most = max(candidate.evaluation.epsilon_max or 0.0 for candidate in found.candidates[1:])
    assert told.left_out.startswith(f"the objective leaves ε_max out: 0.1 at the best, {most:.4g} at candidate ")
    assert told.left_out in repr(told)
    assert told.to_dict()["left_out"] == told.left_out


def test_a_present_configuration_that_is_better_is_told() -> None:
    selection = flexopt.select(flexopt.load("excavator"), (0.0, 1.6), base=0.0)
    last = selection.candidates[-1]
    poorer = replace(selection, initial=selection.best.evaluation, best=last, candidates=(last,))
    more = selection.best.objective - last.objective
    assert more > 1e-3 * selection.problem.objective_scale
    assert f"the present configuration has {more:.3g} more w1 than what is chosen" in repr(poorer)


@pytest.mark.long
def test_the_points_that_bring_more_optima_than_starts_are_told() -> None:
    selection = flexopt.select(flexopt.load("boom-stick-bucket"), (3.0, 0.5), starts=1, workers=1)
    assert selection.climbed == STARTS
    assert selection.status.endswith(f"verified from 1 start and from {STARTS} more points along surfaces w1 = 0")
    point = flexopt.select(flexopt.load("excavator"), (0.0, 1.6), starts=1, workers=1)
    assert point.status.endswith("verified from 1 start")
