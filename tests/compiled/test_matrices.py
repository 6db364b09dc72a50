"""Dense matrices of many points: products in blocks, symmetric sums, largest elements."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from flexopt.compiled import batch, find_compiler, lanes
from flexopt.foundation.kernels import DENSE_PRODUCT, SYMMETRIC_SUM
from tests.compiled.comparison import QUIET

pytestmark = pytest.mark.filterwarnings(QUIET)

# Sizes of one block, of several, and of blocks that are not equally large; of wide and of narrow registers.
SHAPES = [(1, 2, 1), (2, 1, 3), (3, 4, 5), (5, 5, 5), (6, 2, 7), (10, 10, 10), (11, 3, 13), (17, 9, 4)]
POINTS = 19


def _drawn(*sizes: int) -> np.ndarray:
    return np.random.default_rng(sum(sizes)).normal(size=(*sizes, POINTS))


def _columns(matrices: np.ndarray) -> np.ndarray:
    """(rows, columns, N) -> stacked columns (rows · columns, N)."""
    return matrices.transpose(1, 0, 2).reshape(-1, POINTS)


@pytest.mark.long("11-3-13-SX", "10-10-10-SX")
@pytest.mark.parametrize("graph", [ca.SX, ca.MX])
@pytest.mark.parametrize(("rows", "inner", "columns"), SHAPES)
def test_products_by_name_and_as_they_are_written(graph, rows, inner, columns):
    a, b = graph.sym("A", rows, inner), graph.sym("B", inner, columns)
    left, right = _drawn(rows, inner), _drawn(inner, columns)
    expected = _columns(np.einsum("ikn,kjn->ijn", left, right))
    scale = _columns(np.einsum("ikn,kjn->ijn", abs(left), abs(right)))
    for name in (DENSE_PRODUCT, "other"):
        function = ca.Function(name, [a, b], [a @ b])
        found = batch(function)(_columns(left), _columns(right))[0]
        assert np.all(abs(found - expected) <= inner * 2.3e-16 * scale)
        if find_compiler() is not None:
            # CasADi names no number of columns of vectors, which are not worth a block.
            blocked = name == DENSE_PRODUCT and min(rows, inner, columns) > 1
            assert ("flexopt_dense_product(arg[0]" in lanes.kernel_source(function)) == blocked


def test_sums_of_products_and_products_with_a_transposed_matrix():
    a, b, c = (ca.MX.sym(name, *shape) for name, shape in (("A", (7, 6)), ("B", (6, 4)), ("C", (7, 4))))
    function = ca.Function("f", [a, b, c], [ca.mac(a, b, c), a.T @ c])
    given = [_drawn(7, 6), _drawn(6, 4), _drawn(7, 4)]
    found = batch(function)(*map(_columns, given))
    expected = given[2] + np.einsum("ikn,kjn->ijn", *given[:2]), np.einsum("kin,kjn->ijn", given[0], given[2])
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_allclose(ours, _columns(theirs), rtol=0, atol=1e-14)


@pytest.mark.parametrize("size", [2, 3, 5, 8, 11])
def test_symmetric_sums_are_symmetric_to_the_bit(size):
    a, b = ca.MX.sym("A", size, size), ca.MX.sym("B", size, size)
    function = ca.Function(SYMMETRIC_SUM, [a, b], [((a + b) + (a + b).T) / 2])
    left, right = _drawn(size, size), _drawn(size, size)[::-1]
    found = batch(function)(_columns(left), _columns(right))[0].reshape(size, size, POINTS)
    assert np.array_equal(found, found.transpose(1, 0, 2))
    total = left + right
    np.testing.assert_allclose(found, (total + total.transpose(1, 0, 2)) / 2, rtol=1e-15)


@pytest.mark.parametrize("size", [1, 2, 3, 4, 5, 9, 16])
def test_largest_element_leaves_out_what_is_no_number_as_the_virtual_machine_does(size):
    x = ca.MX.sym("x", size)
    function = ca.Function("f", [x], [ca.norm_inf(x)])
    given = _drawn(size)
    given[size // 2, ::3] = np.nan
    found = batch(function)(given)[0][0]
    kept = np.where(np.isnan(given), 0.0, abs(given))
    assert np.array_equal(found, kept.max(axis=0))
    assert np.array_equal(found, [float(function(column)) for column in given.T])
