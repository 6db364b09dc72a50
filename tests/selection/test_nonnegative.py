"""Non-negative least squares against SciPy, and the conditions of its optimum where columns depend on each other."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import scipy.optimize

from flexopt.selection.proof.nonnegative import nonnegative_least_squares

SOLVES = """
import sys
import flexopt
flexopt.select(**flexopt.load_problem("article").select_arguments(), workers=1)
print("scipy.optimize" in sys.modules)
"""


@pytest.mark.parametrize("seed", range(200))
def test_scipy_finds_the_same(seed):
    rng = np.random.default_rng(seed)
    rows, columns = int(rng.integers(1, 9)), int(rng.integers(1, 40))
    matrix = rng.standard_normal((rows, columns)) * 10.0 ** rng.uniform(-3, 3, columns)
    right = rng.standard_normal(rows) if seed % 2 else matrix @ np.maximum(rng.standard_normal(columns), 0)
    ours, (theirs, _) = nonnegative_least_squares(matrix, right), scipy.optimize.nnls(matrix.copy(), right)
    assert np.all(ours >= 0)
    left = [np.linalg.norm(matrix @ x - right) for x in (ours, theirs)]
    assert abs(left[0] - left[1]) <= 1e-10 * np.linalg.norm(right)
    if columns <= rows:
        assert np.allclose(ours, theirs, rtol=1e-6, atol=1e-9 * np.abs(theirs).max(initial=0.0))


@pytest.mark.parametrize("seed", range(100))
def test_dependent_columns(seed):
    """Columns in a subspace, as projections of constraints' gradients are: no slope is left along any of them."""
    rng = np.random.default_rng(seed)
    rows, columns = int(rng.integers(2, 9)), int(rng.integers(2, 40))
    basis = np.linalg.qr(rng.standard_normal((rows, int(rng.integers(1, rows + 1)))))[0]
    matrix, right = basis @ basis.T @ rng.standard_normal((rows, columns)), rng.standard_normal(rows)
    x = nonnegative_least_squares(matrix, right)
    slope = matrix.T @ (right - matrix @ x)
    tolerance = 1e-10 * np.linalg.norm(right) * np.linalg.norm(matrix)
    assert np.all(x >= 0)
    assert slope.max() <= tolerance
    assert np.abs(slope[x > 0]).max(initial=0.0) <= tolerance


def test_nothing_to_solve():
    assert nonnegative_least_squares(np.zeros((3, 0)), np.ones(3)).shape == (0,)
    assert not nonnegative_least_squares(np.zeros((3, 2)), np.ones(3)).any()


@pytest.mark.long
def test_a_selection_does_without_scipy():
    """Its import would take longer than the selection."""
    out = subprocess.run([sys.executable, "-c", SOLVES], capture_output=True, text=True, timeout=120, check=True)
    assert out.stdout.split() == ["False"]
