"""Two eigenvalues that meet: what is smooth there, beside matrices whose eigenvalues are known."""

from __future__ import annotations

import cmath
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import block_diag

from flexopt.foundation.arrays import Vector
from flexopt.loop.meeting import meeting, nearest
from flexopt.loop.spectrum import balance

SIZE = 8
AT = {"oscillations": 0.9 * cmath.exp(0.3j), "real": 0.9, "below zero": -0.9}


def blocks(kind: str, apart: float) -> tuple[Vector, complex]:
    """Block diagonal, eigenvalues c ± √(1 + .3j) √apart or c ± √apart twice next to c; and their squared distance."""
    value = complex(AT[kind])
    if kind != "oscillations":
        return np.array([[value.real, 1.0], [apart, value.real]]), complex(apart)
    turn = np.array([[value.real, value.imag], [-value.imag, value.real]])
    lower = apart * np.array([[1.0, 0.3], [-0.3, 1.0]])
    return np.block([[turn, np.eye(2)], [lower, turn]]), apart * (1 + 0.3j)


def in_all(kind: str, apart: float, rng: np.random.Generator) -> tuple[Vector, complex]:
    """The like among other eigenvalues, in a basis of very different units."""
    block, squared = blocks(kind, apart)
    whole, n = np.diag(rng.uniform(-0.5, 0.5, SIZE)), len(block)
    whole[:n, :n] = block
    basis, units = rng.normal(size=(SIZE, SIZE)), np.exp(rng.uniform(-3, 3, SIZE))
    return basis @ whole @ np.linalg.inv(basis) * units[:, None] / units, squared


@pytest.mark.parametrize("kind", AT)
@pytest.mark.parametrize("apart", [1e-3, -1e-3, 1e-9, 0.0])
def test_mean_and_squared_difference(kind: str, apart: float) -> None:
    """To rounding, where eigenvalues have half of the digits; slopes beside differences, at the meeting itself, too."""
    rng = np.random.default_rng(5)
    matrix, squared = in_all(kind, apart, rng)
    values, at = np.linalg.eigvals(matrix), AT[kind]
    pair = values[np.argsort(np.abs(values - at))[:2]]
    found = meeting(balance(matrix), *pair.tolist())
    assert found is not None
    root = cmath.sqrt(squared)
    one, other = (cmath.log((at + sign * root) / at) for sign in (1, -1))
    # The basis has a condition of some hundreds.
    assert found.mean == pytest.approx(math.log(abs(at)) + ((one + other) / 2).real, abs=1e-13)
    assert found.squared == pytest.approx(((one - other) / 2) ** 2, abs=1e-13)
    change, step = rng.normal(size=matrix.shape) * np.abs(matrix), 1e-6
    ends = [meeting(balance(matrix + sign * step * change), *pair.tolist()) for sign in (1, -1)]
    up, down = (end for end in ends if end is not None)
    # Differences of a step of 1e-6 keep nine digits.
    for name, by in (("mean", found.by_mean), ("squared", found.by_squared)):
        central = (getattr(up, name) - getattr(down, name)) / (2 * step)
        slope = complex(np.sum(by * change))
        assert slope == pytest.approx(central, rel=1e-7, abs=1e-7)


def test_three_do_not_make_a_pair() -> None:
    matrix = np.diag([0.9, 0.9 + 1e-9, 0.9 - 1e-9, 0.2]) + np.diag([1.0, 1.0, 0.0], 1)
    assert meeting(balance(matrix), 0.9, 0.9) is None


def test_what_is_over_after_some_samples_meets_nothing() -> None:
    """Two oscillations near to each other, beside multipliers that are 0 and as near."""
    block, squared = blocks("oscillations", 1e-6)
    matrix = block_diag(block, np.array([[0.0, 1.0], [0.0, 0.0]]))
    root, at = cmath.sqrt(squared), AT["oscillations"]
    upper = np.array([*sorted([at + root, at - root], key=abs, reverse=True), 0.0, 0.0])
    smooth = SimpleNamespace(matrix=matrix, slopes=lambda by: by)
    point: Any = SimpleNamespace(upper=upper, period=0.5, smooth=smooth)
    found = nearest(point, 0.1)
    assert found is not None
    assert found.branches == (0, 1)
    assert found.oscillate
    assert found.mean.value == pytest.approx(-math.log(abs(at)) / 0.5, abs=1e-5)
