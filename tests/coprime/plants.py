"""Plants for the tests: integrator chains, random ones, and changes of coordinates."""

from __future__ import annotations

import warnings

import numpy as np
from hypothesis import assume, reject
from hypothesis import strategies as st

from flexopt.coprime import RobustMargin, StateSpace, robust_margin
from flexopt.errors import FlexoptWarning, NoSolutionFound

seeds = st.integers(0, 2**32 - 1)
orders = st.integers(1, 10)


def chain(k: int, gain: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """gain / s^k (or a chain of k delays), in controller form."""
    A = np.diag(np.ones(k - 1), 1)
    B, C = np.zeros((k, 1)), np.zeros((1, k))
    B[-1], C[0, 0] = gain, 1.0
    return A, B, C


def random_plant(seed: int, n: int, dt: float = 0.0, size: tuple[int, int] | None = None) -> StateSpace:
    """Stable and unstable modes mixed, one to three inputs and outputs, with D."""
    rng = np.random.default_rng(seed)
    p, m = size or tuple(int(k) for k in rng.integers(1, 4, 2))
    A = rng.normal(size=(n, n)) / np.sqrt(n) - (0.3 * np.eye(n) if dt == 0 else 0.0)
    return StateSpace(A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), 0.5 * rng.normal(size=(p, m)), dt)


def margin_or_reject(plant: StateSpace, limit: float = 1e7) -> RobustMargin:
    """The plant's margin, where its condition estimate leaves the digits that a test compares."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FlexoptWarning)
        try:
            result = robust_margin(plant)
        except NoSolutionFound:
            reject()
    assume(result.condition < limit)
    return result


def near(plant: StateSpace, seed: int, change: float) -> StateSpace:
    """The plant with every entry disturbed."""
    rng = np.random.default_rng(seed)
    parts = [M + change * rng.normal(size=M.shape) for M in (plant.A, plant.B, plant.C, plant.D)]
    return StateSpace(*parts, plant.dt)


def in_coordinates(plant: StateSpace, T: np.ndarray) -> StateSpace:
    """The same plant for the state T x."""
    inverse = np.linalg.inv(T)
    return StateSpace(T @ plant.A @ inverse, T @ plant.B, plant.C @ inverse, plant.D, plant.dt)


def sampled_twin(plant: StateSpace) -> StateSpace:
    """The sampled plant whose response at z is that of the continuous one at s = (z − 1)/(z + 1)."""
    n = plant.A.shape[0]
    inverse = np.linalg.inv(np.eye(n) - plant.A)
    return StateSpace(
        inverse @ (np.eye(n) + plant.A),
        np.sqrt(2) * inverse @ plant.B,
        np.sqrt(2) * plant.C @ inverse,
        plant.D + plant.C @ inverse @ plant.B,
        1.0,
    )


def parts(plant: StateSpace) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    return plant.A, plant.B, plant.C, plant.D
