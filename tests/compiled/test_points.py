"""Numbers of points, shapes, threads, and lanes that do not disturb each other."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from flexopt.compiled import Batch, batch
from flexopt.errors import InputError
from tests.compiled.comparison import QUIET, interpreted

pytestmark = pytest.mark.filterwarnings(QUIET)


@pytest.fixture(scope="module")
def function() -> ca.Function:
    x, a = ca.SX.sym("x", 2), ca.SX.sym("a", 2, 2)
    return ca.Function("f", [x, a], [a @ x, ca.sin(x[0]) / a[1, 1]], ["x", "a"], ["y", "s"])


@pytest.fixture(scope="module")
def evaluate(function: ca.Function) -> Batch:
    return batch(function)


def _reference(x: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    y = np.stack([a[0] * x[0] + a[2] * x[1], a[1] * x[0] + a[3] * x[1]])
    return y, (np.sin(x[0]) / a[3])[None]


@pytest.mark.parametrize("n", [0, 1, 2, 7, 8, 9, 15, 16, 17, 63, 64, 65, 255, 256, 257, 1000])
@pytest.mark.parametrize("threads", [1, 3])
def test_any_number_of_points(function: ca.Function, evaluate: Batch, n: int, threads: int) -> None:
    rng = np.random.default_rng(n)
    x, a = rng.normal(size=(2, n)), rng.normal(size=(4, n))
    for way in (evaluate, interpreted(function)):
        results = way(x, a, threads=threads)
        for result, expected in zip(results, _reference(x, a), strict=True):
            assert result.shape == expected.shape
            assert result.dtype == np.float64
            assert result.flags.c_contiguous
            np.testing.assert_allclose(result, expected, rtol=1e-13, atol=1e-15)


def test_one_value_for_all_points(function: ca.Function, evaluate: Batch) -> None:
    rng = np.random.default_rng(0)
    x, a = rng.normal(size=(2, 50)), rng.normal(size=4)
    expected = _reference(x, np.tile(a[:, None], 50))
    for way in (evaluate, interpreted(function)):
        for given in (a, a[:, None], a.tolist()):
            for result, reference in zip(way(x, given), expected, strict=True):
                np.testing.assert_allclose(result, reference, rtol=1e-13, atol=1e-15)
        assert way(x[:, 0], a)[0].shape == (2, 1)
        assert way(np.zeros((2, 0)), a)[0].shape == (2, 0)


def test_one_value_for_all_points_keeps_the_sign_of_a_zero() -> None:
    x, a = ca.SX.sym("x"), ca.SX.sym("a")
    evaluate = batch(ca.Function("f", [x, a], [ca.atan2(a, x), 1 / a]))
    x = np.full((1, 17), -1.0)
    for way in (-0.0, 0.0):
        angle, inverse = evaluate(x, [way])
        assert np.array_equal(angle, np.full((1, 17), np.copysign(np.pi, way)))
        assert np.array_equal(inverse, np.full((1, 17), np.copysign(np.inf, way)))


@pytest.mark.parametrize("layout", ["Fortran", "strided", "reversed", "integers"])
def test_arrays_in_any_layout(evaluate: Batch, layout: str) -> None:
    rng = np.random.default_rng(0)
    x, a = rng.integers(-9, 9, (2, 60)), rng.integers(1, 9, (4, 60))
    change = {"Fortran": lambda v: np.asfortranarray(v * 1.0), "strided": lambda v: np.repeat(v, 3, axis=1)[:, ::3] * 1.0,
              "reversed": lambda v: (v * 1.0)[:, ::-1], "integers": lambda v: v}[layout]  # fmt: skip
    expected = evaluate(np.ascontiguousarray(change(x) * 1.0), np.ascontiguousarray(change(a) * 1.0))
    for result, reference in zip(evaluate(change(x), change(a)), expected, strict=True):
        np.testing.assert_array_equal(result, reference)


@pytest.mark.parametrize("threads", [2, 3, 8])
def test_threads_give_the_same_bits(evaluate: Batch, threads: int) -> None:
    rng = np.random.default_rng(1)
    x, a = rng.normal(size=(2, 4099)), rng.normal(size=(4, 4099))
    for result, reference in zip(evaluate(x, a, threads=threads), evaluate(x, a), strict=True):
        assert result.tobytes() == reference.tobytes()


def test_a_point_gives_the_same_bits_wherever_it_stands(evaluate: Batch) -> None:
    rng = np.random.default_rng(1)
    x, a = rng.normal(size=(2, 100)), rng.normal(size=(4, 100))
    together = evaluate(x, a)
    for start in (1, 3, 96):
        for result, reference in zip(evaluate(x[:, start:], a[:, start:]), together, strict=True):
            assert result.tobytes() == np.ascontiguousarray(reference[:, start:]).tobytes()


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e300])
def test_a_bad_point_spoils_no_other(evaluate: Batch, bad: float) -> None:
    rng = np.random.default_rng(1)
    x, a = rng.normal(size=(2, 40)), rng.normal(size=(4, 40))
    good = evaluate(x, a)
    x[0, 13] = bad
    others = np.arange(40) != 13
    for result, reference in zip(evaluate(x, a), good, strict=True):
        np.testing.assert_array_equal(result[:, others], reference[:, others])
    if np.isnan(bad):
        assert all(np.isnan(result[:, 13]).all() for result in evaluate(x, a))


def test_inputs_are_left_alone(evaluate: Batch) -> None:
    x, a = np.ones((2, 9)), np.ones((4, 9))
    x.flags.writeable = a.flags.writeable = False
    evaluate(x, a)


def test_wrong_calls_are_refused_in_one_sentence(evaluate: Batch) -> None:
    x, a = np.ones((2, 9)), np.ones((4, 9))
    for arrays, part in (
        ((x,), "takes 2 arrays (x, a), got 1"),
        ((np.ones((3, 9)), a), "x: must have the shape (2, number of points) or (2,), not (3, 9)"),
        ((x, np.ones((4, 8))), "x: 9, a: 8"),
        ((x, np.ones((4, 9, 1))), "not (4, 9, 1)"),
        ((x, [["one"] * 9] * 4), "a: must be numbers"),
    ):
        with pytest.raises(InputError) as caught:
            evaluate(*arrays)
        assert part in str(caught.value)
    with pytest.raises(InputError, match="threads = 0"):
        evaluate(x, a, threads=0)


def test_its_repr_names_function_and_way(function: ca.Function) -> None:
    assert repr(interpreted(function)).startswith("Batch(f:(x[2],a[2x2])->(y[2],s)")
    assert "virtual machine" in repr(interpreted(function))
