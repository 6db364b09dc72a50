"""What a solver is told, beside independent numbers: a wrong slope raises, it never leads to an answer."""

import dataclasses

import numpy as np
import pytest

import flexopt
from flexopt.errors import WrongSlope
from flexopt.selection import programs
from flexopt.selection.objective import Quantities
from flexopt.selection.several.joined import Joined

TARGET = (0.0, 1.6)


@pytest.fixture
def machine():
    programs._confirmed.clear()
    yield flexopt.load("excavator")
    programs._confirmed.clear()


@pytest.mark.parametrize("objective", ["w1", "epsilon_max", "w1,epsilon_max"])
def test_a_wrong_slope_is_no_answer(machine, objective, monkeypatch):
    problem = flexopt.build_selection(machine, TARGET, objective=objective)
    right = Quantities.branches

    def wrong(self, objective, base, posture):
        values, gradients = right(self, objective, base, posture)
        return values, gradients * np.array([1.0, 1.01, 1.0])

    monkeypatch.setattr(Quantities, "branches", wrong)
    with pytest.raises(WrongSlope, match="slope"):
        flexopt.solve_selection(problem)


def test_a_wrong_row_is_no_answer(machine, monkeypatch):
    """The solver's target is another one than the problem's."""
    problem = flexopt.build_selection(machine, TARGET)
    packed = type(problem).solver_parameters

    def elsewhere(self):
        return packed(dataclasses.replace(self, target=self.target + np.array([0.0, 1e-3])))

    monkeypatch.setattr(type(problem), "solver_parameters", elsewhere)
    with pytest.raises(WrongSlope, match="value of constraint 2"):
        flexopt.solve_selection(problem)


@pytest.mark.parametrize("combine", ["worst", "weighted"])
def test_a_wrong_slope_is_no_stand(machine, combine, monkeypatch):
    right = Joined._value_gradient
    monkeypatch.setattr(Joined, "_value_gradient", lambda self, x, k: 1.01 * right(self, x, k))
    with pytest.raises(WrongSlope):
        flexopt.select_stand(machine, [(0.0, 1.6), (0.2, 1.5)], combine=combine)


def test_a_point_without_digits_is_no_evidence(machine, monkeypatch):
    problem = flexopt.build_selection(machine, TARGET)
    right, calls = Quantities.branches, []

    def noisy(self, objective, base, posture):
        values, gradients = right(self, objective, base, posture)
        calls.append(1)
        return values, gradients * (np.nan if len(calls) < 3 else 1.0)

    monkeypatch.setattr(Quantities, "branches", noisy)
    assert flexopt.solve_selection(problem).candidates
