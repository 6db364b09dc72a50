"""What a solver is told, beside independent numbers: a wrong slope raises, it never leads to an answer."""

import dataclasses

import numpy as np
import pytest

import flexopt
from flexopt.errors import WrongSlope
from flexopt.selection.nlp import solvers
from flexopt.selection.nlp.program import Program
from flexopt.selection.objective import Quantities
from flexopt.selection.proof.check import prove

TARGET = (0.0, 1.6)


@pytest.fixture
def machine():
    solvers._confirmed.clear()
    yield flexopt.load("excavator")
    solvers._confirmed.clear()


@pytest.mark.parametrize("objective", ["w1", "epsilon_max", "w1,epsilon_max"])
def test_a_wrong_slope_is_no_answer(machine, objective, monkeypatch):
    problem = flexopt.build_selection(machine, TARGET, objective=objective)
    right = Quantities.branches

    def wrong(self, objective, base, posture, **options):
        values, gradients = right(self, objective, base, posture, **options)
        return values, gradients * np.array([1.0, 1.01, 1.0])

    monkeypatch.setattr(Quantities, "branches", wrong)
    with pytest.raises(WrongSlope, match="slope"):
        flexopt.solve_selection(problem)


def test_a_wrong_row_is_no_answer(machine, monkeypatch):
    """The solver's target is another one than the problem's."""
    problem = flexopt.build_selection(machine, TARGET)
    packed = Program.parameters

    def elsewhere(self):
        (one,) = self.problems
        off = dataclasses.replace(one, target=one.target + np.array([0.0, 1e-3]))
        return packed(dataclasses.replace(self, problems=(off,)))

    monkeypatch.setattr(Program, "parameters", elsewhere)
    with pytest.raises(WrongSlope, match="value of constraint 2"):
        flexopt.solve_selection(problem)


@pytest.mark.parametrize("combine", ["worst", "weighted"])
def test_a_wrong_slope_is_no_stand(machine, combine, monkeypatch):
    right = Program.linear_of

    def wrong(self, k, z):
        member = right(self, k, z)
        return dataclasses.replace(member, slopes=[1.01 * slopes for slopes in member.slopes])

    monkeypatch.setattr(Program, "linear_of", wrong)
    with pytest.raises(WrongSlope):
        flexopt.select_stand(machine, [(0.0, 1.6), (0.2, 1.5)], combine=combine)


def test_a_point_without_digits_is_no_evidence(machine, monkeypatch):
    problem = flexopt.build_selection(machine, TARGET)
    right, calls = Quantities.branches, []

    def noisy(self, objective, base, posture, **options):
        values, gradients = right(self, objective, base, posture, **options)
        calls.append(1)
        return values, gradients * (np.nan if len(calls) < 3 else 1.0)

    monkeypatch.setattr(Quantities, "branches", noisy)
    assert flexopt.solve_selection(problem).candidates


def test_nearly_equal_branches_do_not_prove_what_is_no_optimum(machine):
    """With a small β the branches of ε_max are alike everywhere: their difference must not stand in for a slope."""
    problem = flexopt.build_selection(machine, TARGET, objective="w1")
    mixed = dataclasses.replace(
        problem,
        objectives=(dataclasses.replace(problem.objective, beta=1e-9),),
        objective_scales=problem.objective_scales,
    )
    z = np.append(problem.scan.base[:, 300], problem.scan.posture[:, 300])
    plain, kinked = prove(problem, z), prove(mixed, z)
    assert "kink of ε_max" not in kinked.active
    assert plain.stationarity > 1e-3
    assert kinked.stationarity == pytest.approx(plain.stationarity, rel=1e-3)
    assert not kinked.holds
