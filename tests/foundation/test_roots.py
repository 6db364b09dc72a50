"""Zeros by Brent's method, after which nothing of the function is kept."""

from __future__ import annotations

import gc
import math
import weakref

import pytest

from flexopt.foundation.roots import border, root


class Heavy:
    """What a function computes with."""

    def __call__(self, x: float) -> float:
        return math.cos(x) - x


def test_a_zero_is_found() -> None:
    # The Dottie number.
    assert root(Heavy(), 0.0, 1.0, xtol=1e-15) == pytest.approx(0.7390851332151607, abs=1e-15)
    with pytest.raises(ValueError, match="different signs"):
        root(Heavy(), 1.0, 2.0)


def test_the_function_goes_without_a_collection_of_garbage() -> None:
    heavy = Heavy()
    there = weakref.ref(heavy)
    gc.disable()
    try:
        root(heavy, 0.0, 1.0)
        del heavy
        assert there() is None
    finally:
        gc.enable()


def test_ends_that_rounding_puts_on_one_side_are_a_border_themselves() -> None:
    assert border(lambda x: x - 0.25, 0.0, 1.0) == pytest.approx(0.25)
    assert border(lambda x: 1e-17 * (2 - x), 0.0, 1.0) == 1.0
    assert border(lambda x: -1e-17 * (1 + x), 0.0, 1.0) == 0.0
