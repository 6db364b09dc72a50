"""Steps of the doubling iteration where rounding decides what is left."""

from __future__ import annotations

import numpy as np
import pytest

from flexopt.algebra import riccati
from flexopt.compiled import batch
from tests.compiled.comparison import QUIET


@pytest.mark.filterwarnings(QUIET)
@pytest.mark.parametrize("size", [4, 14])
def test_products_below_rounding_beside_one_count_by_their_sum(size):
    """(I + G H)⁻¹ has 1 − 2e-16 on its diagonal where G H is 2e-16, and each product in that is lost beside 1."""
    step = riccati._doubling(size)
    each = 2e-16
    ones = np.full((size, size), np.sqrt(each / size))
    given = [np.eye(size), ones, ones]
    for found in (step(*given)[0].full(), batch(step)(*(m.reshape(-1, 1) for m in given))[0].reshape(size, size)):
        assert np.all(abs(np.diag(found) - (1 - each)) < 0.6 * each)
