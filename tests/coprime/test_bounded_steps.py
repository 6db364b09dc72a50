"""What a last correction leaves over is bounded in doubles: never below what decimals find."""

import numpy as np
import pytest

from flexopt.compiled.extended import digits, exact, largest, rounded
from flexopt.coprime import riccati
from flexopt.coprime.decimals import solve, times
from flexopt.coprime.extended import Equation, goal, newton
from tests.coprime.plants import random_plant

SEEDS = range(24)


def refined(seed: int):
    plant = random_plant(seed, 1 + seed % 10)
    equation = Equation(*(exact(M) for M in (plant.A, plant.B, plant.C)))
    found = riccati.doubling(plant.A, plant.B @ plant.B.T, plant.C.T @ plant.C, discrete=False)
    assert found is not None
    return newton(equation, exact(found[0]))


@pytest.mark.parametrize("seed", SEEDS)
def test_of_newton(seed):
    with digits():
        solution = refined(seed)
        left, size = solution.equation.residual(solution.X)
        assert np.linalg.norm(rounded(left), 2) <= solution.residual
        assert solution.residual <= 2 * goal() * size * len(left)
        # The loop that goes with X, and how far the one in doubles is from it.
        loop = solution.equation.loop(solution.X)
        assert largest(loop - solution.loop) <= 1e-45 * largest(loop)
        assert np.linalg.norm(rounded(loop - exact(solution.lyapunov.A)), 2) <= solution.off


@pytest.mark.parametrize("seed", SEEDS)
def test_of_adjoint_equations(seed):
    with digits():
        solution = refined(seed)
        n = len(solution.X)
        rng = np.random.default_rng(seed)
        right = rng.normal(size=n)
        Q = exact(np.outer(right, right))
        rough, bound = solution.adjoint(Q, 1e-20)
        fine, _ = solution.adjoint(Q, goal())
        assert bound <= 1e-20
        assert np.linalg.norm(rounded(rough - fine), 2) <= bound * largest(rough)


def test_zeros_may_be_skipped():
    rng = np.random.default_rng(0)
    with digits():
        for density in (0.0, 0.1, 0.5, 1.0):
            a, b = (exact(rng.normal(size=(7, 7)) * (rng.uniform(size=(7, 7)) < density)) for _ in range(2))
            assert largest(times(a, b) - a @ b) <= 1e-47
            assert largest((a + exact(np.eye(7) * 9)) @ solve(a + exact(np.eye(7) * 9), b) - b) <= 1e-45
