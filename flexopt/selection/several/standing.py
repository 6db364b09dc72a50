"""The best single placement for several configuration problems.

In: problems, and what their postures are worth from a sample of placements. Out: starts, and verified local optima.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Progress, Vector
from flexopt.selection.chances import chance, how_often
from flexopt.selection.nlp.coupling import Coupling
from flexopt.selection.nlp.program import Program
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.rounds import LEFT_OPEN
from flexopt.selection.several.alone import placements_alone
from flexopt.selection.several.postures import Reached, climbed_held, joined, reached_by, reached_from
from flexopt.selection.several.solving import End, end_from, ends_from, not_below, taken_up, verified
from flexopt.selection.several.targets import none_reaches_all
from flexopt.selection.starts import beyond_rows, short_told

# V stands in for where a target has no allowed posture in a sum.
NOTHING = -1e300
# Starts where a target leaves one degree of freedom, and where it leaves more: then there are many summits.
FEW, MANY = 8, 32
# Starts are not nearer to each other than this share of the placements' range.
NEAREST = 1e-3
# Placements for each start that are looked at again, with so many times the postures.
AGAIN, FINER = 2, 6
# Starts that follow from what targets can have alone.
FURTHER = 16
# Of the optima found so many have their postures exchanged; what that must gain, relative to the objective's scale.
EXCHANGED, GAIN = 2, 1e-7
# Placements, the best that were looked at, that no answer may be worse than.
SEEN = 32
# Placements that differ by less, in scaled variables, are one.
SAME_BASE = 1e-4


def one_placement(problems: tuple[SelectionProblem, ...], share: Vector, *, weighted: bool) -> Program:
    """The program with one placement for all: max min_k V_k, or max Σ share_k V_k."""
    plant = problems[0].measures.plant
    n_b, n = plant.n_base, plant.n_actuated
    places = tuple((*range(n_b), *range(n_b + k * n, n_b + (k + 1) * n)) for k in range(len(problems)))
    return Program(problems, Coupling(places, ()), np.zeros(0), share, "weighted" if weighted else "worst")


def other_placements(found: list[tuple[float, list[Vector]]], scale: Vector) -> dict[str, Any]:
    """What a `Stand` has of the optima after the first, those at the same place once.

    `found`: worth and [base, posture] at each target, best first; `scale`: of the base's variables (n_b,).
    """
    n_b = scale.size
    bases, others = [found[0][1][0][:n_b]], list[tuple[float, list[Vector]]]()
    for worth, zs in found[1:]:
        if all(np.abs((zs[0][:n_b] - other) / scale).max(initial=0.0) > SAME_BASE for other in bases):
            bases.append(zs[0][:n_b])
            others.append((worth, zs))
    return {
        "alternatives": tuple((worth, zs[0][:n_b]) for worth, zs in others),
        "alternative_postures": tuple(np.array([z[n_b:] for z in zs]) for _, zs in others),
    }


class Standing(NamedTuple):
    """A way on which the base stands still.

    Attributes:
        coupling: one placement for all, and the joints' steps;  steps: how far these may be.
        of_way: steps of the way itself with 0 where the placement's are.
    """

    coupling: Coupling
    steps: Vector
    of_way: Vector


def standing_along(way: Program) -> Standing:
    """The way from one placement whose joints keep their rates."""
    n_z, n_b = way.first.scale.size, way.first.measures.plant.n_base
    places = one_placement(way.problems, way.share, weighted=False).coupling.places
    joints = np.array([i % n_z >= n_b for i, _ in way.coupling.pairs], dtype=bool)
    entries = [(places[i // n_z][i % n_z], places[j // n_z][j % n_z]) for i, j in way.coupling.pairs]
    pairs = tuple(entries[number] for number in np.flatnonzero(joints))
    return Standing(Coupling(places, pairs), way.steps[joints], np.where(joints, way.steps, 0.0))


def default_starts(program: Program) -> int:
    """How many starts find the best summit, or one that is hardly lower, more often than not."""
    return FEW if program.first.redundancy <= 1 else MANY


def best_placements(
    program: Program,
    bases: Vector,
    found: list[Reached],
    starts: int,
    seed: int,
    workers: int,
    progress: Progress | None,
    *,
    further: bool = False,
) -> tuple[list[End], float | None, int, list[float]]:
    """Verified optima, best first, what an unverified end is worth more; how many starts, and where those led to one.

    Args:
        program: from `one_placement`.
        bases: placements (n_b, N).
        found: for each problem what is reached from them.
        starts: how many at most.
        seed: of samples of postures.
        workers, progress: as in `ends_from`.
        further: whether starts follow from what targets can have alone, where the first leave it open what is best.

    Raises:
        UnreachableTarget: from none of the placements all targets are reached.
        NoSolutionFound: no start led to a point that passes the checks.
    """
    begins = _starts(program, bases, found, starts, seed)
    ends = ends_from(program, begins, workers, progress)
    good = verified(program, ends, "placement", partial(_kept_from_none, program, found))
    worths = [program.worth(end.x) for end in good]
    if further and (chance(how_often(program.first, worths)) or 0.0) > LEFT_OPEN:
        ends += ends_from(program, _starts_alone(program, good[0].x, seed, workers), workers, None)
        good = verified(program, ends, "placement")
    for end in good[:EXCHANGED]:
        better = _exchanged(program, end.x, seed)
        if better is not None:
            ends.append(end_from(program, better))
    if progress is not None and len(ends) > len(begins):
        progress(len(ends), len(ends))
    picks = [_picks(reached) for reached in found]
    best = np.argsort(-_worth(program, found), kind="stable")[:SEEN]
    seen = [program.packed([r.z[:, j, pick[j]] for r, pick in zip(found, picks, strict=True)]) for j in best]
    good = not_below(program, verified(program, ends, "placement"), [*begins, *seen], "placement")
    return *taken_up(program, good, ends, "placement"), len(begins), worths


def kept_somewhere(
    problems: tuple[SelectionProblem, ...], bases: Vector, found: list[Reached], workers: int
) -> tuple[Vector, list[Reached]]:
    """Placements (n_b, N) that keep all constraints where none of those looked at does, and what is reached there.

    They are the best by the problems' own objective: its solver goes along constraints to where all are kept.

    Args:
        problems, bases, found, workers: as of `best_placements`.

    Raises:
        UnreachableTarget, NoSolutionFound: as `best_placements`; what is short is named.
    """
    program = one_placement(problems, np.full(len(problems), 1 / len(problems)), weighted=False)
    count = program.first.starts or default_starts(program)
    good = best_placements(program, bases, found, count, program.first.seed, workers, None)[0]
    zs = [np.array([program.of(end.x, k) for end in good]).T[:, :, None] for k in range(len(problems))]
    kept = np.zeros((len(good), 1))
    return zs[0][: bases.shape[0], :, 0], [Reached(z, kept, kept) for z in zs]


def spread(bases: Vector, worth: Vector, count: int) -> list[int]:
    """Numbers of up to `count` placements, the best first, none near a better one.

    How near is near: half of what `count` points on a grid would be apart, less where not as many are found so.
    """
    order = [int(k) for k in np.argsort(-worth, kind="stable") if np.isfinite(worth[k])]
    widths = np.ptp(bases[:, order], axis=1) if order and bases.size else np.zeros(0)
    x = bases[widths > 0] / widths[widths > 0, None] if widths.size else np.zeros((0, bases.shape[1]))
    if not x.shape[0]:
        return order[:1]
    radius = 0.5 * count ** (-1 / x.shape[0])
    taken: list[int] = []
    while len(taken) < min(count, len(order)) and radius > NEAREST:
        for k in order:
            if len(taken) < count and all(np.abs(x[:, k] - x[:, j]).max() > radius for j in taken):
                taken.append(k)
        radius /= 2
    return sorted(taken, key=order.index)


def _starts(program: Program, bases: Vector, found: list[Reached], count: int, seed: int) -> list[Vector]:
    """Up to `count` starts x, the most promising first, no two near each other."""
    reaches = np.array([np.isfinite(reached.violation).any(axis=1) for reached in found])
    if not reaches.all(axis=0).any():
        best = int(reaches.sum(axis=0).argmax()) if reaches.size else 0
        raise none_reaches_all(len(found), np.flatnonzero(~reaches[:, best]).tolist() if reaches.size else None)
    near = spread(bases, _worth(program, found), AGAIN * count)
    bases = bases[:, near]
    again = [reached_from(problem, bases, seed, FINER) for problem in program.problems]
    both = [joined(reached.of(near), more) for reached, more in zip(found, again, strict=True)]
    picks = [_picks(reached) for reached in both]
    chosen = spread(bases, _worth(program, both), count)
    return [program.packed([r.z[:, j, pick[j]] for r, pick in zip(both, picks, strict=True)]) for j in chosen]


def _starts_alone(program: Program, best: Vector, seed: int, workers: int) -> list[Vector]:
    """Starts from placements that are better for a target alone than the best so far."""
    bases, carried = placements_alone(program, best, workers)
    if not bases.shape[1]:
        return []
    found = [
        climbed_held(
            problem, joined(reached_from(problem, bases, seed), reached_by(problem, bases, carried[:, :, None])), seed
        )
        for problem in program.problems
    ]
    return _starts(program, bases, found, FURTHER, seed) if np.isfinite(_worth(program, found)).any() else []


def _kept_from_none(program: Program, found: list[Reached]) -> str:
    """Which constraints, each by itself, none of the placements keeps at all targets; empty where none is so."""
    first, each = program.first, list[Vector]()
    for problem, reached in zip(program.problems, found, strict=True):
        z = reached.z.reshape(reached.z.shape[0], -1)
        inside = np.isfinite(reached.violation).ravel() & (z >= first.lower[:, None]).all(axis=0)
        inside &= (z <= first.upper[:, None]).all(axis=0)
        beyond = np.where(inside[:, None], beyond_rows(problem, z), np.inf)
        each.append(beyond.reshape(*reached.violation.shape, -1).min(axis=1))
    worst = np.max(each, axis=0)
    # Those from which the targets are reached within the joints' limits: there the target's own rows hold.
    worst = worst[np.isfinite(worst[:, : first.target.size]).all(axis=1)]
    return short_told(first, worst, f"{len(worst)} placements that reach all targets") if len(worst) else ""


def _picks(reached: Reached) -> NDArray[np.int64]:
    """For each placement the number of the best posture, or of the one that violates least where none is allowed."""
    allowed = np.isfinite(reached.value).any(axis=1)
    return cast(NDArray[np.int64], np.where(allowed, reached.value.argmax(axis=1), reached.violation.argmin(axis=1)))


def _worth(program: Program, found: list[Reached]) -> Vector:
    """What each placement may be worth, (N,); −∞ where not all targets are reached.

    Where a constraint is broken everywhere, the less it is broken the better: IPOPT then starts from there.
    """
    values = np.array([reached.value.max(axis=1) for reached in found])
    whole = np.isfinite(values).all(axis=0)
    if whole.any():
        worth = values.min(axis=0)
        if program.goal == "weighted":
            worth = program.share @ np.maximum(values, NOTHING)
        return np.where(whole, worth, -np.inf)
    off = np.array([reached.violation.min(axis=1) for reached in found])
    return np.where(np.isfinite(off).all(axis=0), -off.max(axis=0), -np.inf)


def _exchanged(program: Program, x: Vector, seed: int) -> Vector | None:
    """The same placement with better postures, of a finer sample; None where no posture is better.

    With the placement given the targets have nothing to do with each other.
    """
    n_b = program.first.measures.plant.n_base
    zs = [program.of(x, k) for k in range(program.coupling.count)]
    values, gained = program.values(x), False
    for k, (problem, value) in enumerate(zip(program.problems, values, strict=True)):
        found = reached_from(problem, zs[k][:n_b, None], seed, FINER**2)
        best = int(found.value[0].argmax())
        if found.value[0, best] > value + GAIN * program.size:
            zs[k], gained = found.z[:, 0, best], True
    return program.packed(zs) if gained else None
