"""The ascent of objectives with kinks: on toys whose optimum is known, and on machines beside a method without slopes."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

import flexopt
from flexopt.robustness.residues import rank_one_measure
from flexopt.selection.ascent.member import AscentMember
from flexopt.selection.ascent.steps import DONE, Ascent
from flexopt.selection.nlp.assembly import Branched
from flexopt.selection.nlp.program import single
from flexopt.selection.nlp.solvers import Bounds
from flexopt.selection.problem import value_at
from flexopt.selection.proof.check import prove
from flexopt.selection.seen import settled
from flexopt.selection.starts import starting_points

Entry = Callable[[ca.SX], ca.SX]
EXCAVATOR = flexopt.load("excavator")


def toy(n: int, smooth: Entry, entries: tuple[Entry, Entry, Entry], row: Entry) -> Ascent:
    """Maximise smooth(x) + λ_min of [[a, c], [c, b]](x) with row(x) = 0, as an ascent sees it: by its eigenvalues."""
    x, p = ca.SX.sym("x", n), ca.SX.sym("p")
    a, b, c = (entry(x) for entry in entries)
    middle, away = (a + b) / 2, ca.sqrt(((a - b) / 2) ** 2 + c**2)
    angle = ca.atan2(c, (a - b) / 2) / 2
    # Eigenvectors of the larger and the smaller eigenvalue.
    high, low = ca.vertcat(ca.cos(angle), ca.sin(angle)), ca.vertcat(-ca.sin(angle), ca.cos(angle))
    slopes = [ca.jacobian(each, x) for each in (a, b, c)]

    def between(u: ca.SX, v: ca.SX) -> ca.SX:
        return u[0] * v[0] * slopes[0] + u[1] * v[1] * slopes[1] + (u[0] * v[1] + u[1] * v[0]) * slopes[2]

    epsilon = ca.vertcat(middle - away, middle + away)
    epsilon_x = ca.vertcat(between(low, low), between(high, high), between(low, high))
    value, slope = smooth(x), ca.jacobian(smooth(x), x)
    rows, rows_x = row(x), ca.jacobian(row(x), x)
    pull, row_pull = ca.SX.sym("pull"), ca.SX.sym("row_pull")
    bent = pull * ca.hessian(value, x)[0] + row_pull * ca.hessian(rows, x)[0]
    last_x = ca.repmat(slope, 2, 1) + epsilon_x[:2, :]
    outputs = [value + epsilon, rows, last_x, rows_x, epsilon_x]
    margin = ca.Function("margin", [x], [ca.densify(epsilon_x)])
    # One task row: a_i·b_i has no kink.
    none = [ca.DM.zeros(2, 1), ca.DM.zeros(2, n), ca.DM.eye(1)]
    functions = Branched(
        ca.Function("model", [x, p], [ca.densify(each) for each in outputs]),
        ca.Function("rows", [x, p], [rows, ca.densify(rows_x)]),
        ca.Function("curvature", [x, p, pull, row_pull], [ca.densify(bent)]),
        ca.Function("factors", [x, p], none),
        margin,
    )
    bounds = Bounds(np.full(n, -3.0), np.full(n, 3.0), np.zeros(1), np.zeros(1))
    alphas, of_margin = np.zeros((1, 1)), lambda at: margin.call([at])[0].full()
    place = tuple(range(n))
    member = AscentMember(functions, place, np.zeros(1), alphas, lambda _: np.zeros(1), np.ones(1), of_margin)
    return Ascent((member,), np.ones((1, 1, 1)), np.zeros(0), bounds, np.zeros((0, n)))


def modes_toy(n: int, smooth: Entry, a: Entry, b: Entry, row: Entry) -> Ascent:
    """Maximise smooth(x) + Σ (a_i·b_i − |a_i||b_i|) with row(x) = 0; the columns of a(x) and b(x) are of modes."""
    x, p = ca.SX.sym("x", n), ca.SX.sym("p", ca.SX(a(ca.SX.zeros(n))).shape[1])
    f = ca.densify(ca.vertcat(a(x), b(x)))
    r, m = f.shape[0] // 2, f.shape[1]
    w = ca.vertcat(*(rank_one_measure(f[:r, i], f[r:, i]) for i in range(m)))
    value, rows = smooth(x) + ca.dot(p, w), row(x)
    pull, row_pull = ca.SX.sym("pull"), ca.SX.sym("row_pull")
    bent = pull * ca.hessian(value, x)[0] + row_pull * ca.hessian(rows, x)[0]
    rows_x = ca.densify(ca.jacobian(rows, x))
    outputs = [value, rows, ca.jacobian(value, x), rows_x, ca.SX(0, n)]
    functions = Branched(
        ca.Function("model", [x, p], [ca.densify(each) for each in outputs]),
        ca.Function("rows", [x, p], [rows, rows_x]),
        ca.Function("curvature", [x, p, pull, row_pull], [ca.densify(bent)]),
        ca.Function("factors", [x, p], [f, ca.densify(ca.jacobian(ca.vec(f), x)), ca.DM.eye(m)]),
        None,
    )
    bounds = Bounds(np.full(n, -3.0), np.full(n, 3.0), np.zeros(1), np.zeros(1))

    def without(modes: list[int]) -> np.ndarray:
        return np.array([0.0 if i in modes else 1.0 for i in range(m)])

    none, place = np.zeros((3, n)), tuple(range(n))
    member = AscentMember(functions, place, np.ones(m), np.ones((1, m)), without, np.zeros(1), lambda _: none)
    return Ascent((member,), np.ones((1, 1, 1)), np.zeros(0), bounds, np.zeros((0, n)))


def test_the_way_back_onto_a_row_does_not_lean_on_a_bound() -> None:
    """x_0 ≥ 0 holds with equality, and V grows along x_2, which bends the row."""
    far = (lambda _: ca.SX(0), lambda _: ca.SX(1), lambda _: ca.SX(0))
    ascent = toy(3, lambda x: -3 * x[0] + 0.3 * x[2] - 0.15 * x[2] ** 2, far,
                 lambda x: x[0] + 0.1 * x[1] + x[1] ** 2 / 2 + x[2] ** 2 / 2)  # fmt: skip
    ascent.bounds.x_lower[0] = 0.0
    found = ascent.climbed(np.array([0.0, -0.1, 0.05]), 30)
    assert found is not None
    # On the row with x_0 = 0: x_2² = −0.2 x_1 − x_1², largest at x_1 = −0.1, where x_2 = 0.1.
    np.testing.assert_allclose(found[0], [0.0, -0.1, 0.1], atol=1e-6)


def circle(x: ca.SX) -> ca.SX:
    """x_0² + x_1² = 1, other entries free."""
    return x[0] ** 2 + x[1] ** 2 - 1


def test_a_smooth_optimum_is_reached_quadratically() -> None:
    """The branches stay apart: max x_0 + λ_min on the circle, λ_min = −x_1² − 2 at the end of its smooth branch."""
    far = (lambda x: -(x[1] ** 2) - 2, lambda _: ca.SX(5), lambda _: ca.SX(0))
    ascent = toy(2, lambda x: x[0], far, circle)
    found = ascent.climbed(np.array([-0.2, 0.9]), 30)
    assert found is not None
    assert found[2] == DONE
    # The gradient is below 1e-7, and the curvature of order one.
    np.testing.assert_allclose(found[0], [1.0, 0.0], atol=1e-7)
    assert found[1] <= 10


@pytest.mark.parametrize("tip", [0.0, 0.3])
def test_the_tip_of_a_cone_is_found(tip: float) -> None:
    """λ_min of [[u, v], [v, −u]] is −√(u² + v²): a cone whose tip, at u = v = 0, is the optimum."""
    cone = (lambda x: x[2] - tip, lambda x: -(x[2] - tip), lambda x: x[3] + x[2] - tip)
    ascent = toy(4, lambda x: 0.2 * x[2] + 0.1 * x[0], cone, circle)
    found = ascent.climbed(np.array([0.3, -0.8, 0.9, -0.7]), 60)
    assert found is not None
    np.testing.assert_allclose(found[0], [1.0, 0.0, tip, 0.0], atol=1e-6)
    assert found[1] <= 30


@pytest.mark.parametrize("side", ["a", "b"])
@pytest.mark.parametrize("start", [(0.3, -0.8, 0.9, -0.7), (1.0, 0.0, 0.2, 1e-9), (-0.6, 0.8, -1.0, 2.0)])
def test_the_tip_of_a_measure_is_found(side: str, start: tuple[float, ...]) -> None:
    """w = o·c − |o||c| with c = 0 at (0.2, 0): near it V falls by more than a·b and the smooth part rise."""
    other = lambda x: ca.vertcat(1 + 0.1 * x[0], 0.3 + 0.1 * x[2])  # noqa: E731 - an entry like the others
    tip = lambda x: ca.vertcat(x[2] - 0.2, x[3] + 0.5 * (x[2] - 0.2) ** 2)  # noqa: E731
    a, b = (tip, other) if side == "a" else (other, tip)
    ascent = modes_toy(4, lambda x: 0.1 * x[0] - 0.4 * x[2] + 0.2 * x[3] - 0.05 * x[3] ** 2, a, b, circle)
    found = ascent.climbed(np.array(start), 60)
    assert found is not None
    # The gradient is below 1e-7, and V bends by 0.1.
    np.testing.assert_allclose(found[0], [1.0, 0.0, 0.2, 0.0], atol=1e-6)
    assert found[1] <= 25


def test_two_modes_share_a_point() -> None:
    """b_1 = 0 along a line, and b_2 = 0 across it: the optimum is where both vanish."""
    a = lambda x: ca.horzcat(ca.vertcat(1, 0.5), ca.vertcat(0.2, 1 + 0.1 * x[0]))  # noqa: E731
    b = lambda x: ca.horzcat(ca.vertcat(x[2], 2 * x[2]), ca.vertcat(x[3] - x[2], x[3] - 3 * x[2]))  # noqa: E731
    ascent = modes_toy(4, lambda x: 0.1 * x[0] - 0.3 * x[2] - 0.3 * x[3], a, b, circle)
    found = ascent.climbed(np.array([0.2, 0.9, 0.6, -0.5]), 60)
    assert found is not None
    np.testing.assert_allclose(found[0], [1.0, 0.0, 0.0, 0.0], atol=1e-6)


def test_a_bent_ridge_is_followed() -> None:
    """Along a parabola, across which V falls 10⁴ times as fast as it rises along it."""
    far = (lambda _: ca.SX(0), lambda _: ca.SX(1), lambda _: ca.SX(0))
    ascent = toy(3, lambda x: -1e2 * (x[1] - x[0] ** 2) ** 2 - 1e-2 * (x[0] - 1) ** 2, far, lambda x: x[2])
    found = ascent.climbed(np.array([-1.0, 1.0, 0.0]), 60)
    assert found is not None
    np.testing.assert_allclose(found[0], [1.0, 1.0, 0.0], atol=1e-4)


def test_a_bent_kink_is_followed_quadratically() -> None:
    """The tip of λ_min of [[u, v], [v, −u]] is a bent surface: how u and v bend along it says how far steps lead.

    On u = x_0 − 0.8 x_2² = 0, v = x_1 + x_2 x_3 = 0 what is left is 0.76 x_2² − 0.1 x_2 x_3 − (x_2 − 0.3)²
    − (x_3 − 0.2)² / 2.
    """
    u, v = (lambda x: x[0] - 0.8 * x[2] ** 2), (lambda x: x[1] + x[2] * x[3])
    smooth = lambda x: 0.95 * x[0] + 0.1 * x[1] - (x[2] - 0.3) ** 2 - (x[3] - 0.2) ** 2 / 2  # noqa: E731
    ascent = toy(5, smooth, (u, lambda x: -u(x), v), lambda x: x[4])
    best = np.linalg.solve([[-0.48, -0.1], [-0.1, -1.0]], [-0.6, -0.2])
    wanted = [0.8 * best[0] ** 2, -best[0] * best[1], *best, 0.0]
    found = ascent.climbed(np.array([0.1, 0.3, -0.2, 0.9, 0.0]), 60)
    assert found is not None
    assert found[2] == DONE
    # The gradient is below 1e-7, and V bends by 0.46 at least.
    np.testing.assert_allclose(found[0], wanted, atol=5e-7)
    assert found[1] <= 20


@pytest.mark.long("epsilon_max")
@pytest.mark.parametrize("objective", ["epsilon_max", "V"])
def test_steps_never_lead_down_nor_off_the_rows(objective: str) -> None:
    weights = [1.0, 0.3, 0.3, 1e-3] if objective == "V" else None
    problem = flexopt.build_selection(EXCAVATOR, (0.0, 1.6), objective=objective, weights=weights)
    program = single(problem)
    for start in starting_points(problem)[:4]:
        low = value_at(problem, start)
        for steps in (1, 2, 4, 8):
            found = program.climbed(start, steps)
            assert found is not None
            high = value_at(problem, found[0])
            # A start is on the rows to 1e-7, and ε_max told to some 1e-13.
            assert high >= low - (1e-8 if steps == 1 else 1e-12) * problem.objective_scale
            rows = problem.rows(found[0])[: problem.target.size]
            np.testing.assert_allclose(rows, problem.target, atol=1e-9)
            low = high


@pytest.fixture
def _interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is computed at many points of a machine in space takes less time than its compilation."""
    monkeypatch.setenv("FLEXOPT_COMPILE", "0")


@pytest.mark.long
@pytest.mark.usefixtures("_interpreted")
@pytest.mark.parametrize(("machine", "target"), [("excavator", (0.0, 1.6)), ("truck-crane", (6.0, 0.0, 3.0))])
def test_no_point_nearby_is_better(machine: str, target: tuple[float, ...]) -> None:
    """Random points about the optimum, moved onto the rows by other steps: V alone is looked at."""
    selection = flexopt.select(flexopt.load(machine), target, objective="epsilon_max", starts=2, workers=1)
    problem, best = selection.problem, selection.best
    value, rng, compared = value_at(problem, best.z), np.random.default_rng(0), 0
    for size in (1e-1, 1e-2, 1e-3, 1e-4):
        for _ in range(6):
            beside = best.z + size * rng.standard_normal(best.z.size) * problem.scale
            there = settled(problem, np.clip(beside, problem.lower, problem.upper))
            if there is not None and np.abs((there - best.z) / problem.scale).max() <= 3 * size:
                compared += 1
                assert value_at(problem, there) <= value + 1e-9
    assert compared >= 6


@pytest.mark.long
@pytest.mark.usefixtures("_interpreted")
def test_what_is_on_the_way_is_not_proved() -> None:
    """V bends little here, so that branches far apart in place are near in value: no reason to take a mean of both."""
    problem = flexopt.build_selection(flexopt.load("slewing-excavator"), (3.5, 1.0, 1.2), objective="epsilon_max",
                                      starts=2, assume="ground,limits")  # fmt: skip
    program, proved = single(problem), 0
    for start in starting_points(problem):
        there = [program.climbed(start, steps) for steps in (2, 4, 6, 8, 10, 40)]
        ends = [found[0] for found in there if found is not None]
        values, proofs = [value_at(problem, z) for z in ends], [prove(problem, z) for z in ends]
        proved += proofs[-1].holds
        for value, proof in zip(values, proofs, strict=True):
            assert not proof.holds or value >= values[-1] - 1e-8
    assert proved
