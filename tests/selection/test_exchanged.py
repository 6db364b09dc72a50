"""Where two frequencies meet modes exchange their numbers, and a sum that tells them apart jumps."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest

import flexopt
from flexopt.selection.exchanged import APART, kept_apart
from flexopt.selection.problem import value_at
from flexopt.selection.proof.check import prove
from flexopt.selection.seen import settled

MACHINE, TARGET = flexopt.load("slewing-excavator"), (1.6155, 6.4194, 0.9496)
# Weights, tool angle, and V that a search without slopes found, at the edge.
KNOWN = {
    "fifth mode free": ((0.3, 0, 0.02, 1, 0.02, 0.3), (-1.1, -0.6), -2.319e-6),
    "fourth mode free": ((1, 0, 0.2, 0.5, 0, 0.2), (-1.2, -0.6), -8.165e-7),
}


@functools.cache
def chosen(name: str) -> flexopt.Selection:
    weights, angles, _ = KNOWN[name]
    given: dict[str, Any] = {"constraints": {"tool_angle": list(angles)}, "weights": list(weights)}
    return flexopt.select(MACHINE, TARGET, objective="V", control="transpose", starts=4, workers=1, **given)


@pytest.mark.long
@pytest.mark.parametrize("name", KNOWN)
def test_the_best_at_an_edge_is_found_and_told(name: str) -> None:
    selection = chosen(name)
    problem, best = selection.problem, selection.best
    assert best.objective >= KNOWN[name][2] - 1e-4 * problem.first_scale
    assert "frequencies of modes 1 and 2 apart" in best.active
    f = best.evaluation.frequencies_hz
    np.testing.assert_allclose(1 - f[0] / f[1], APART, rtol=1e-3)
    (sentence,) = selection.edges
    assert sentence in repr(selection)
    assert list(selection.edges) == selection.to_dict()["edges"]


@pytest.mark.long
@pytest.mark.parametrize("name", KNOWN)
def test_beyond_the_edge_v_is_what_the_sentence_says(name: str) -> None:
    """Points on the rows a little farther than the edge: V takes values near both, and none is above the best."""
    selection = chosen(name)
    problem, best = selection.problem, selection.best
    told = float(selection.edges[0].rsplit(" ", 1)[1])
    rng, seen = np.random.default_rng(0), list[float]()
    for _ in range(60):
        step = rng.standard_normal(best.z.size) * problem.scale * rng.choice([1e-5, 1e-4, 1e-3])
        there = settled(problem, np.clip(best.z + step, problem.lower, problem.upper))
        if there is not None:
            seen.append(value_at(problem, there))
    assert len(seen) > 20
    apart = best.objective - told
    assert apart > 0
    assert min(seen) < best.objective - apart / 2
    assert min(seen) > told - apart / 10
    # What stands nearer to where the frequencies meet has a little more: less than is ever told apart.
    assert max(seen) < best.objective + 1e-4 * problem.first_scale


@pytest.mark.long
def test_frequencies_are_kept_apart_only_where_it_matters() -> None:
    selection = chosen("fifth mode free")
    problem = selection.problem
    plain = flexopt.build_selection(
        MACHINE, TARGET, objective="w4", control="transpose", constraints={"tool_angle": [-1.1, -0.6]}
    )
    # Modes 1 and 2 meet there, which is nothing to w4; and what is kept apart already is not once more.
    assert kept_apart(plain, [selection.best.z], []) is plain
    assert kept_apart(problem, [selection.best.z], []) is problem
    assert prove(problem, selection.best.z).holds


def test_elsewhere_nothing_is_said() -> None:
    selection = flexopt.select(flexopt.load("excavator"), (0.0, 1.6))
    assert selection.edges == ()
    assert selection.problem.bounding == 0
