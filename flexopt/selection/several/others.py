"""Another placement that was found for several targets, as a stand of its own.

In: a `Stand` and the number of one of its placements. Out: a `Stand` with the configuration of every target there.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from flexopt.selection.several.by_loop import ByLoop, places_by_loop, shared_program
from flexopt.selection.several.results import Stand
from flexopt.selection.several.solving import places_at
from flexopt.selection.several.standing import one_placement

T = TypeVar("T")


def other_stand(stand: Stand, number: int) -> Stand:
    """The placement of this number, the chosen one being 1; the loop is that of the chosen one."""
    if number == 1:
        return stand
    worth, base = stand.alternatives[number - 2]
    zs = [np.append(base, posture) for posture in stand.alternative_postures[number - 2]]
    problems = stand.problems
    held = one_placement(problems, np.ones(len(problems)), weighted=False)
    if isinstance(stand, ByLoop):
        asked = replace(stand.asked, loop=stand.settings.fixed)
        program = shared_program(asked, problems, held.coupling, np.zeros(0), zs[0])
        y = program.joined([z / problem.scale for problem, z in zip(problems, zs, strict=True)])
        places, worth = places_by_loop(program, y), program.measure.sign * float(min(program.values(y)))
    else:
        places = places_at(held, held.packed(zs))
    # What is told of the search for the chosen one is not of this.
    exchanged = {
        "alternatives": _with(stand.alternatives, number - 2, (stand.worth, stand.base)),
        "alternative_postures": _with(
            stand.alternative_postures, number - 2, np.array([place.evaluation.posture for place in stand.places])
        ),
    }
    return replace(stand, places=places, worth=worth, number=number, ends=(), unverified=None, **exchanged)


def _with(found: tuple[T, ...], k: int, other: T) -> tuple[T, ...]:
    return (*found[:k], other, *found[k + 1 :])
