"""Calls with arrays beside CasADi's own."""

from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor

import casadi as ca
import numpy as np
import pytest

from flexopt.compiled import ArrayCall


def _function() -> ca.Function:
    a, b, nothing = ca.SX.sym("a", 3, 2), ca.SX.sym("b", 2), ca.SX.sym("nothing", 0)
    return ca.Function("f", [a, b, nothing], [a @ b, ca.sin(a.T), ca.SX(0, 1)], ["a", "b", "nothing"], ["x", "y", "z"])


def test_the_same_as_casadi_by_many_threads() -> None:
    function, rng = _function(), np.random.default_rng(0)
    points = [(rng.normal(size=(3, 2)), rng.normal(size=2), np.zeros(0)) for _ in range(200)]
    call = pickle.loads(pickle.dumps(ArrayCall(function)))
    with ThreadPoolExecutor(4) as pool:
        found = [each.result() for each in [pool.submit(call, *point) for point in points]]
    for point, outputs in zip(points, found, strict=True):
        for output, theirs in zip(outputs, function.call(list(point)), strict=True):
            np.testing.assert_array_equal(output, theirs.full())


def test_results_stay_as_they_are() -> None:
    call = ArrayCall(_function())
    first = call(np.ones((3, 2)), np.ones(2), np.zeros(0))[0]
    call(np.zeros((3, 2)), np.ones(2), np.zeros(0))
    np.testing.assert_array_equal(first.ravel(), [2.0, 2.0, 2.0])


def test_what_is_sparse_is_refused() -> None:
    x = ca.SX.sym("x", 2)
    with pytest.raises(ValueError, match="dense"):
        ArrayCall(ca.Function("f", [x], [ca.diag(x)]))(np.ones(2))
