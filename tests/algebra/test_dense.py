"""Solves and pseudo-inverses against NumPy."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from flexopt.algebra import (
    apply_pseudo_inverse,
    apply_pseudo_inverse_transposed,
    diagonal,
    safe_norm,
    solve_spd,
)


def evaluated(function, *arguments):
    symbols = [ca.SX.sym(f"a{i}", *np.shape(a)) for i, a in enumerate(arguments)]
    return ca.Function("f", symbols, [ca.densify(function(*symbols))])(*arguments).full()


@pytest.mark.parametrize("rows", [1, 2, 3])
@pytest.mark.parametrize("extra", [0, 1, 3])
@pytest.mark.parametrize("condition", [1.0, 1e3, 1e7])
def test_pseudo_inverse_loses_cond_not_its_square(rows, extra, condition):
    rng = np.random.default_rng(rows + 10 * extra)
    for _ in range(10):
        columns = rows + extra
        left = np.linalg.qr(rng.standard_normal((rows, rows)))[0]
        right = np.linalg.qr(rng.standard_normal((columns, columns)))[0][:, :rows]
        matrix = left * np.geomspace(1, 1 / condition, rows) @ right.T
        expected = np.linalg.pinv(matrix)
        tolerance = 1e-14 * np.linalg.cond(matrix) * np.linalg.norm(expected)
        given = rng.standard_normal((rows, 2))
        assert np.linalg.norm(evaluated(apply_pseudo_inverse, matrix, np.eye(rows)) - expected) <= tolerance
        got = evaluated(apply_pseudo_inverse, matrix, given)
        assert np.linalg.norm(got - expected @ given) <= tolerance * np.linalg.norm(given)
        across = rng.standard_normal((columns, 2))
        got = evaluated(apply_pseudo_inverse_transposed, matrix, across)
        assert np.linalg.norm(got - expected.T @ across) <= tolerance * np.linalg.norm(across)


@pytest.mark.parametrize("size", [1, 2, 4, 8])
def test_symmetric_positive_definite_solve(size):
    rng = np.random.default_rng(size)
    factor = rng.standard_normal((size, size))
    matrix = factor @ factor.T + np.eye(size)
    right = rng.standard_normal((size, 3))
    got, expected = evaluated(solve_spd, matrix, right), np.linalg.solve(matrix, right)
    assert np.linalg.norm(got - expected) <= 1e-15 * np.linalg.cond(matrix) * 10 * np.linalg.norm(expected)


def test_norm_has_finite_derivatives_at_zero():
    x = ca.SX.sym("x", 3)
    norm = safe_norm(x)
    f = ca.Function("norm", [x], [norm, ca.jacobian(norm, x)])
    assert np.array_equal(f([0, 0, 0])[1].full(), np.zeros((1, 3)))
    value, slope = (y.full() for y in f([3, 0, 4]))
    assert value == 5.0
    assert np.allclose(slope, [[0.6, 0, 0.8]], rtol=1e-15, atol=0)


def test_diagonal_is_dense():
    assert diagonal(ca.SX.sym("x", 3)).is_dense()
    assert np.array_equal(evaluated(diagonal, np.array([[1.0], [2.0]])), np.diag([1.0, 2.0]))
