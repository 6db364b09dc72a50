"""The last steps onto an optimum: quadratic convergence, and optima that doubles do not tell."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import flexopt
from benchmarks.selection_truth import GAIN, machines
from flexopt.selection.nlp.program import Program, single
from flexopt.selection.proof.check import FIRST_ORDER, SECOND_ORDER, prove, prove_program
from flexopt.selection.proof.first_order import linearised
from flexopt.selection.proof.multipliers import multipliers_of
from flexopt.selection.proof.newton import polished, settled
from flexopt.selection.seen import settled as on_rows
from tests.oracles.machines import Structure, arm_at_rest, random_machine, regular_posture

EXCAVATOR = flexopt.load("excavator")


def _off(program: Program, x: np.ndarray) -> float:
    """Norm of the Lagrangian's gradient, ε_max in extended precision."""
    local = linearised(replace(program, exact=True), x)
    multipliers, kept = multipliers_of(local)
    return float(np.linalg.norm(local.gradient - multipliers @ local.rows(kept)))


@pytest.mark.long("epsilon_max")
@pytest.mark.parametrize("objective", ["w1", "epsilon_max"])
def test_a_point_beside_an_optimum_is_led_back_to_it(objective: str) -> None:
    selection = flexopt.select(EXCAVATOR, (0.0, 1.6), objective=objective, workers=1)
    program, best = single(selection.problem), selection.best.z
    at_best = prove_program(program, best)
    assert at_best.holds
    # Off the target by 1e-8, and along it by 1e-4.
    _, _, directions = np.linalg.svd(linearised(program, best).equalities)
    beside = best + 1e-4 * directions[-1] * program.scale
    found, proof = polished(program, beside, replace(at_best, violations={FIRST_ORDER: 1e-4}))
    assert proof.holds
    assert proof is not at_best
    # The proofs' tolerance of 1e-6 in the gradient, over the curvature.
    np.testing.assert_allclose(found / program.scale, best / program.scale, rtol=0, atol=1e-5)
    # A residual is told relative to the multiplier of what is kept: a large one is no reason not to begin.
    far = replace(at_best, violations={FIRST_ORDER: 0.2}, stationarity=0.2)
    assert polished(program, beside, far)[0] is beside
    assert polished(program, beside, replace(far, pull=400.0))[1].holds


@pytest.mark.long
def test_an_optimum_that_doubles_do_not_tell_is_found() -> None:
    """What keeps ε_max has a multiplier of 4,000 here, and the rounding of its gradient in doubles times that is 1e-4."""
    rng = np.random.default_rng(31)
    _, machine = random_machine(rng)
    targets = [arm_at_rest(machine, regular_posture(rng, machine))[1] for _ in range(2)]
    selection = flexopt.select(
        machine, targets[1], objective="epsilon_max,w1", control="inverse", gain=5e5, starts=4, workers=1
    )
    # As it was solved last: what is kept, is kept.
    program = single(replace(selection.problem, kept=tuple(kept.at_least for kept in selection.kept)))
    assert _off(program, selection.best.z) <= 1e-6
    assert selection.best.evaluation.epsilon_max >= selection.kept[0].at_least * (1 - 1e-9)


@pytest.mark.long
def test_an_optimum_whose_curvature_doubles_do_not_tell_is_found() -> None:
    """ε_max is told to 1e-8 here: its slopes to 1e-6, and differences of these not at all."""
    machine, targets = next((machine, targets) for _, machine, targets, _ in machines([2]))
    options: Any = {"objective": "epsilon_max", "control": "inverse", "gain": GAIN}
    problem = flexopt.build_selection(machine, targets[0], **options)
    program, rng, doubted = single(problem), np.random.default_rng(0), 0
    best = np.array([-4.7441573, 3.1131370, 2.8301796, -0.1139785, 0.0861952, -0.1501096])
    ends: list[np.ndarray] = []
    for _ in range(6):
        beside = on_rows(problem, best + 3e-6 * rng.uniform(-1, 1, best.size) * problem.scale)
        assert beside is not None
        proof = prove(problem, beside)
        assert set(proof.violations) <= {FIRST_ORDER, SECOND_ORDER}
        doubted += SECOND_ORDER in proof.violations
        end, proof = polished(program, beside, proof)
        assert proof.holds
        ends.append(end / problem.scale)
    assert doubted
    # By steps of Newton's method in extended precision; a proof that holds from the outset makes none.
    assert max(float(np.abs(end - best / problem.scale).max()) for end in ends) < 1e-5


@pytest.mark.long
def test_an_optimum_near_a_kink_of_what_is_kept_is_found() -> None:
    """The branches of ε_max meet 3e-3 away; what lies between it and the optimum gains less than ε_max's rounding."""
    machine, targets = next((machine, targets) for _, machine, targets, _ in machines([32]))
    options: Any = {"objective": "epsilon_max,w1", "control": "transpose", "gain": GAIN}
    problem = replace(flexopt.build_selection(machine, targets[0], **options), kept=(0.3829650072507612,))
    # Where ascents ended; none of further ones led on from there.
    stuck = np.array(
        [-1.7067482274787, 1.6445071333212, 0.1695954923781, 1.0725747747272, -1.0071281049306, 3.0365844714858]
    )
    proof = prove(problem, stuck)
    assert set(proof.violations) == {FIRST_ORDER}
    found, proof = polished(single(problem), stuck, proof)
    assert proof.holds
    assert proof.stationarity <= 1e-7
    assert np.abs((found - stuck) / problem.scale).max() < 1e-4


@pytest.mark.long
def test_where_a_solve_stops_near_a_flat_optimum_decides_nothing() -> None:
    _, machine = random_machine(np.random.default_rng(8), Structure(4, ("x", "y", "rotation"), (1,)))
    target = arm_at_rest(machine, np.array([0.7, -1.1, 0.6]))[1]
    selection = flexopt.select(
        machine, target, objective="V", weights=[1.0] * 4, base_range=(-2.0, 2.0), starts=4, workers=1
    )
    program, rng = single(selection.problem), np.random.default_rng(1)
    points = [candidate.z for candidate in selection.candidates if candidate.dimension == 0]
    assert points
    for z in points:
        proof = prove(selection.problem, z)
        bent = 1e-7 * rng.standard_normal((6, z.size)) * program.scale
        ends = [settled(program, z + each, proof) for each in bent]
        # Newton's steps leave the square of 1e-7, and rounding over the least curvature.
        assert np.ptp([end for end, _ in ends], axis=0).max() <= 1e-9
        assert all(found.holds and found.stationarity <= 1e-9 for _, found in ends)


def test_what_fails_otherwise_is_left_as_it_is() -> None:
    selection = flexopt.select(EXCAVATOR, (0.0, 1.6), workers=1)
    away = selection.best.z + 0.1
    proof = prove(selection.problem, away)
    assert FIRST_ORDER not in proof.violations or len(proof.violations) > 1
    found, same = polished(single(selection.problem), away, proof)
    assert found is away
    assert same is proof
