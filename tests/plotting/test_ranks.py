"""Candidates by rank, of a choice that travel costs something."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import flexopt


def test_what_travel_costs_is_said_on_the_axis_of_ranks() -> None:
    """The present place, away from where travel counts from, and the candidates are in the same measure."""
    machine, posture = flexopt.load("slewing-excavator"), [0.2, 0.5, -1.2, -0.5]
    travel = {"cost": 0.5, "base": [1.0, 0.0, 0.0], "posture": posture}
    chosen = flexopt.select(
        machine, flexopt.evaluate(machine, posture).end_point, base=(0.0, 0.0, 0.0), posture=posture, starts=1,
        constraints={"travel": travel},
    )  # fmt: skip
    axes = next(each for each in chosen.plot().axes if each.get_xlabel() == "candidate, by rank")
    assert axes.get_ylabel().startswith("objective w1 less travel, 1/(kg m")
    lines = [np.asarray(line.get_ydata(), dtype=float) for line in axes.get_lines()]
    ranked = np.concatenate([line for line in lines if line.size == len(chosen.candidates) - 1 or line.size == 1])
    assert sorted(ranked) == pytest.approx(sorted(each.objective for each in chosen.candidates))
    assert chosen.initial is not None
    problem = chosen.problem
    away = (chosen.initial.z - np.array([1.0, 0.0, 0.0, *posture])) / problem.scale
    less = 0.5 * problem.objective_scales[0] * float(away @ away)
    assert less > 0
    assert lines[-1][0] == pytest.approx(chosen.initial.w[0] - less)


@pytest.mark.long
def test_rounding_is_no_difference_between_ranks() -> None:
    """A machine held in its plane of symmetry: a mode out of the plane has w = 0 everywhere, to rounding."""
    machine, posture = flexopt.load("slewing-excavator"), [0.0, 0.5, -1.2, -0.5]
    chosen = flexopt.select(
        machine, flexopt.evaluate(machine, posture).end_point, base=(0.0, 0.0, 0.0), posture=posture, starts=1,
    )  # fmt: skip
    nothing = [replace(each, objective=-5e-40 * (k % 2)) for k, each in enumerate(chosen.candidates)]
    drawn = replace(chosen, candidates=tuple(nothing), best=nothing[0], initial=None)
    axes = next(each for each in drawn.plot().axes if each.get_xlabel() == "candidate, by rank")
    low, high = axes.get_ylim()
    assert high - low >= 1e-4 * chosen.problem.objective_scale
    assert low < 0.0 < high


def test_an_axis_of_objectives_in_order_is_that_of_the_first() -> None:
    """ε_max, the last, is of another size."""
    machine, posture = flexopt.load("slewing-excavator"), [0.2, 0.5, -1.2, -0.5]
    target, few = (
        flexopt.evaluate(machine, posture).end_point,
        {"base": (0.0, 0.0, 0.0), "posture": posture, "starts": 1},
    )
    chosen = flexopt.select(machine, target, objective="V,epsilon_max", weights=[1] * 6, slack=1e-2, **few)
    two = replace(chosen, candidates=(chosen.best, replace(chosen.best, objective=chosen.best.objective - 1e-6)))
    axes = next(each for each in two.plot().axes if each.get_xlabel() == "candidate, by rank")
    assert two.initial is not None
    assert chosen.problem.objective_scale > 1e3 * chosen.problem.first_scale
    values = [*(each.objective for each in two.candidates), float(two.initial.w.sum())]
    assert np.ptp(axes.get_ylim()) == pytest.approx(np.ptp(values), rel=0.5)
