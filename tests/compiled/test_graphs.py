"""Matrix operations, loops, sparse and empty shapes, and graphs that cannot be batched."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

import flexopt
from flexopt.compiled import batch, find_compiler
from tests.compiled.comparison import QUIET, check_agreement, interpreted

pytestmark = pytest.mark.filterwarnings(QUIET)

RNG = np.random.default_rng(2)
X, A, N = RNG.normal(size=(3, 11)), RNG.normal(size=(9, 11)) + 3 * np.eye(3).ravel()[:, None], RNG.normal(size=(1, 11))


def _step() -> ca.Function:
    x = ca.SX.sym("x", 3)
    return ca.Function("step", [x], [ca.vertcat(ca.sin(x[0]), x[1] * x[2], ca.if_else(x[0] > 0, x[2], 1))])


def _one_of_many() -> ca.Function:
    """By 0, 1 or any other number; two outputs, of which the first has structural zeros that differ."""
    x, a = ca.SX.sym("x", 3), ca.SX.sym("a", 3, 3)
    outputs = [ca.diag(x), x], [a[ca.Sparsity.lower(3)], 2 * x], [a @ a, ca.sin(x)]
    zero, one, other = (ca.Function(f"case{k}", [x, a], pair) for k, pair in enumerate(outputs))
    return ca.Function.conditional("one_of_many", [zero, one], other)


def _nested() -> ca.Function:
    """Takes the first sum where the first number is not 0, else what another choice gives."""
    n, x, a = ca.MX.sym("n"), ca.MX.sym("x", 3), ca.MX.sym("a", 3, 3)
    inner = ca.Function("inner", [n, x, a], [ca.sum1(_one_of_many()(ca.floor(n) + 1, x, a)[0]).T + x])
    outer = ca.Function("outer", [n, x, a], [x * n])
    return ca.Function.if_else("nested", inner, outer)


MATRIX: dict[str, Callable[[ca.MX, ca.MX, ca.MX], ca.MX]] = {
    "product": lambda x, a, _: a @ x,
    "solve": lambda x, a, _: ca.solve(a, x),
    "inverse": lambda _, a, __: ca.inv(a),
    "determinant": lambda _, a, __: ca.det(a),
    "norms": lambda x, a, _: ca.vertcat(ca.norm_1(x), ca.norm_2(x), ca.norm_inf(x), ca.norm_fro(a)),
    "extremes": lambda x, _, __: ca.vertcat(ca.mmax(x), ca.mmin(x)),
    "choice": lambda x, _, n: ca.if_else(n > 0, _step()(x), x),
    "short circuit": lambda x, _, n: ca.if_else(n > 0, _step()(x), x, True),
    "one of many": lambda x, a, n: ca.vertcat(*(ca.vec(y) for y in _one_of_many()(ca.floor(2 * n), x, a))),
    "choices in choices": lambda x, a, n: _nested()(n > 0, n, x, a),
    "dot": lambda x, _, __: ca.dot(x, x),
    "bilinear": lambda x, a, _: ca.bilin(a, x, x),
    "rank1": lambda x, a, n: ca.rank1(a, n, x, x),
    "sums": lambda _, a, __: ca.vertcat(ca.sum1(a).T, ca.sum2(a)),
    "transpose": lambda _, a, __: a.T,
    "slices": lambda x, a, n: ca.vertcat(a[1, :].T, x[::-1], n),
    "sparse": lambda x, _, n: ca.diag(x) * n,
    "made dense": lambda x, _, n: ca.densify(ca.diag(x) * n),
    "cumulative": lambda x, _, __: ca.cumsum(x),
    "repeated": lambda x, _, __: _step()(_step()(x)),
    "map": lambda x, a, _: _step().map(3)(a),
    "accumulated": lambda x, _, __: _step().mapaccum(20)(x),
    "fold": lambda x, _, __: _step().fold(20)(x),
    "constants": lambda x, _, __: ca.vertcat(x, ca.MX(ca.DM([1, np.inf, -2.5]))),
}


@pytest.mark.parametrize("name", MATRIX)
def test_matrix_operations_and_loops(name: str) -> None:
    x, a, n = ca.MX.sym("x", 3), ca.MX.sym("a", 3, 3), ca.MX.sym("n")
    function = ca.Function("f", [x, a, n], [MATRIX[name](x, a, n)])
    check_agreement(function, [X, A, N], rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize("name", ["short circuit", "one of many", "choices in choices"])
def test_a_point_that_chooses_gives_the_same_bits_in_any_company(name: str) -> None:
    """Where each of a group of points takes another way, one of them by a number that is none."""
    x, a, n = ca.MX.sym("x", 3), ca.MX.sym("a", 3, 3), ca.MX.sym("n")
    machine = batch(ca.Function("f", [x, a, n], [MATRIX[name](x, a, n)]))
    assert machine.compiled == (find_compiler() is not None)
    chosen = N.copy()
    chosen[0, 4] = np.nan
    (together,) = machine(X, A, chosen)
    for k in range(11):
        (alone,) = machine(X[:, k], A[:, k], chosen[:, k])
        assert alone[:, 0].tobytes() == together[:, k].tobytes()


def test_sparse_inputs_and_outputs_are_given_as_dense_columns() -> None:
    x = ca.SX.sym("x", ca.Sparsity.lower(3))
    function = ca.Function("f", [x], [x @ x, ca.SX(2, 2), x[0, 0]])
    expected = check_agreement(function, [RNG.normal(size=(9, 10))])
    assert expected[0].shape == (9, 10)
    assert not expected[1].any()


def test_inputs_that_are_empty_and_functions_without_inputs() -> None:
    x, nothing = ca.SX.sym("x"), ca.SX.sym("nothing", 0)
    check_agreement(ca.Function("f", [x, nothing], [x + 1, nothing]), [N, np.zeros((0, 1))])
    (constant,) = batch(ca.Function("f", [], [ca.SX(3)]))()
    assert constant.tolist() == [[3.0]]


def _rootfinder() -> ca.Function:
    x, p = ca.SX.sym("x"), ca.SX.sym("p")
    return ca.rootfinder("root", "newton", ca.Function("g", [x, p], [x**3 + x - p]))


def _branches(kind: str) -> ca.Function:
    x, n = ca.MX.sym("x", 3), ca.MX.sym("n")
    table = ca.interpolant("table", "linear", [[-2.0, 0.0, 2.0]], [0.0, 1.0, 4.0])
    graph = {
        "rootfinder": lambda: _rootfinder()(0.0, n),
        "table": lambda: table(n),
        "indexed by a number": lambda: x[ca.fmod(ca.fabs(n), 3)],
        "symbolic QR": lambda: ca.solve(ca.diag(x) + 1, x, "symbolicqr"),
    }[kind]()
    return ca.Function("f", [x, n], [graph])


@pytest.mark.parametrize("kind", ["rootfinder", "table", "indexed by a number", "symbolic QR"])
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_what_decides_its_course_by_numbers_is_left_to_the_virtual_machine(kind: str) -> None:
    function = _branches(kind)
    for _ in range(2):  # the second time it is known
        machine = batch(function)
        assert not machine.compiled
    results, expected = machine(X, N)[0], interpreted(function)(X, N)[0]
    np.testing.assert_array_equal(results, expected)
    for k in range(11):
        np.testing.assert_allclose(results[:, k], np.array(function(X[:, k], N[:, k])).ravel(), rtol=1e-12)


@pytest.mark.parametrize("nested", [False, True])
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_point_at_which_the_evaluation_fails_is_nan(nested: bool) -> None:
    x, p = ca.SX.sym("x"), ca.SX.sym("p")
    hopeless = ca.rootfinder("root", "newton", ca.Function("g", [x, p], [x**2 + p]), {"max_iter": 30})
    if nested:
        inputs = ca.MX.sym("x"), ca.MX.sym("p")
        hopeless = ca.Function("outer", list(inputs), [hopeless(*inputs)])
    (result,) = batch(hopeless)([1.0], np.array([[-4.0, 1.0, -9.0] * 20]))
    assert np.isnan(result[0, 1::3]).all()
    np.testing.assert_allclose(result[0, 0::3], 2.0)


@pytest.mark.long
@pytest.mark.parametrize("name", ["w", "gradients"])
def test_measures_of_the_excavator(name: str) -> None:
    measures = flexopt.build_measures(flexopt.load("excavator"))
    function = getattr(measures, name)
    rng = np.random.default_rng(3)
    postures = np.vstack([rng.uniform(-3, 3, 400), rng.choice([-1, 1], 400) * rng.uniform(0.2, 2.9, 400)])
    parameters = np.array(measures.plant.parameter_values).ravel()
    results = batch(function)([0.0], postures, parameters)
    expected = interpreted(function)([0.0], postures, parameters)
    for result, reference in zip(results, expected, strict=True):
        scale = np.abs(reference).max(axis=1, keepdims=True)
        # Some derivatives, such as those by the base's rest angle, are zero but for rounding.
        assert (np.abs(result - reference) <= 1e-12 * scale + 1e-14 * scale.max()).all()
