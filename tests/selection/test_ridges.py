"""Optima on a ridge of ε_max, where the two largest eigenvalues of XZ are one: found, and no saddles.

A random machine of five joints, whose arm is folded at its best: `benchmarks.selection_truth`, seed 33.
"""

from dataclasses import replace

import numpy as np
import pytest

import flexopt
from benchmarks.selection_truth import GAIN, doubled_margins, machines
from flexopt.selection.nlp.program import single
from flexopt.selection.problem import TravelCost, value_at
from flexopt.selection.proof.check import FIRST_ORDER, prove
from flexopt.selection.proof.first_order import linearised
from flexopt.selection.proof.multipliers import multipliers_of
from flexopt.selection.proof.second_order import lagrangian_hessian

CONTROL = "transpose"
pytestmark = pytest.mark.filterwarnings("ignore:ε_max has a kink")


@pytest.fixture(scope="module")
def machine():
    return next((machine, targets[0]) for _, machine, targets, _ in machines([33]))


@pytest.fixture(scope="module")
def selection(machine):
    options = {"objective": "epsilon_max", "control": CONTROL, "gain": GAIN}
    return flexopt.solve_selection(flexopt.build_selection(*machine, starts=8, **options), workers=1)


@pytest.mark.long
def test_a_hill_that_no_point_of_the_scan_shows(machine, selection):
    """On a surface the best points of a scan are of one wide hill; a higher one is narrow."""
    folded = np.array([1.22289, 2.73154, 0.16878, -3.07209, -3.08174, -3.02446])
    # The oracle doubles in plain NumPy.
    (high,) = doubled_margins(machine[0], CONTROL, folded[:, None])
    best = selection.best
    assert selection.problem.scan.epsilon.max() < high - 1e-3
    assert best.objective > high
    assert abs(doubled_margins(machine[0], CONTROL, best.z[:, None])[0] - best.objective) < 1e-8


def ridge(problem, z):
    """The program at a point of a ridge, directions along it (d, n_z), and how V bends along them."""
    program = single(problem)
    local = linearised(program, z)
    multipliers, kept = multipliers_of(local)
    _, singular, directions = np.linalg.svd(local.rows(kept))
    free = directions[int(np.sum(singular > 1e-9 * singular[0])) :]
    return free, lagrangian_hessian(program, z, free, local, multipliers, kept)


def onto_ridge(problem, z):
    """The point of the ridge and of the target nearest to z, to first order."""
    program = single(problem)
    for _ in range(12):
        local = linearised(program, z)
        (kink,) = local.kinks
        off = np.concatenate([local.g[local.equal], kink.value])
        if np.abs(off).max() < 1e-13:
            break
        z = z - np.linalg.pinv(local.equalities) @ off * problem.scale
    return z


@pytest.mark.long
def test_a_ridge_bends_as_v_does_along_it(selection):
    """To both sides along the ridge V falls by half the second derivative times the square of the way."""
    problem, best = selection.problem, selection.best
    assert set(best.kinks) == {"kink of ε_max"}
    free, bent = ridge(problem, best.z)
    values, vectors = np.linalg.eigh(bent)
    assert len(values) == 2
    for value, vector in zip(values, vectors.T, strict=True):
        way = 3e-3 * (vector @ free) * problem.scale
        sides = [value_at(problem, onto_ridge(problem, best.z + sign * way)) for sign in (1, -1)]
        told = (np.mean(sides) - best.objective) / problem.objective_scale * 2 / 3e-3**2
        # What is left is of the square of the way, some 1e-3.
        assert told == pytest.approx(value, rel=3e-3)
    proof = prove(problem, best.z)
    assert proof.curvature == pytest.approx(values[-1], abs=1e-8)
    assert proof.dimension == best.dimension == 0


@pytest.mark.long
def test_a_saddle_on_a_ridge_is_refused(selection):
    """A cost of travel that is a reward makes V rise to both sides, however steep it falls off the ridge."""
    problem, best = selection.problem, selection.best
    _, bent = ridge(problem, best.z)
    largest = float(np.linalg.eigvalsh(bent)[-1])
    for share in (0.8, 1.2):
        reward = replace(problem, travel=TravelCost(now=best.z, cost=share * largest / 2))
        proof = prove(reward, best.z)
        assert FIRST_ORDER not in proof.violations
        assert ("second-order optimality" in proof.violations) == (share > 1)
        assert proof.curvature == pytest.approx((1 - share) * largest, abs=1e-8)
