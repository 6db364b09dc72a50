"""One placement from which all of several targets can be worked at."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Unpack, cast

import numpy as np

from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Document, Progress, TargetsLike, Vector
from flexopt.foundation.boundary import Keywords, by, public, words
from flexopt.foundation.documents import provenance
from flexopt.foundation.turns import available_cores
from flexopt.model import AnyMachine
from flexopt.model.boundary import targets as several_targets
from flexopt.model.choices import COMBINES, asks_for_loop
from flexopt.model.constraints import AnyConstraints
from flexopt.model.loop import Loop, LoopLike, control_of
from flexopt.model.own import OBJECTIVES
from flexopt.model.problem import SelectionOptions, StandKeywords
from flexopt.model.targets import SOME_SHARES
from flexopt.model.uncertainty import RangesLike
from flexopt.robustness.plausibility import warn_implausible
from flexopt.selection.continua import nearest_stand, way_to
from flexopt.selection.nlp.program import Program
from flexopt.selection.outcomes.asked import Asked
from flexopt.selection.problem import TIE_TOLERANCE
from flexopt.selection.several.outcome_stand import outcome_stand
from flexopt.selection.several.postures import reached_from
from flexopt.selection.several.results import Stand
from flexopt.selection.several.solving import End, past_ends_of_joints, places_at
from flexopt.selection.several.standing import best_placements, default_starts, one_placement, other_placements
from flexopt.selection.several.targets import build_problems, none_reaches_all, sample_bases, single_measure
from flexopt.selection.solve import loop_notes
from flexopt.selection.starts import climbs

# Placements that are looked at, for one coordinate and for more.
BASES = 401, 512


def _together(arguments: Arguments, given: Mapping[str, Any]) -> None:
    loop_notes(arguments, given)
    single_measure(arguments, given)
    objective = given["objective"]
    by_loop = asks_for_loop(objective, given["constraints"])
    if by_loop and given["combine"] != "worst":
        arguments.note("combine", "must be 'worst' where the loop is asked: the worst target counts", given["combine"])
    shares, targets = given["shares"], given["targets"]
    if shares is not None and given["combine"] == "worst":
        arguments.note("shares", "go with combine = 'weighted' only", shares)
    elif shares is not None and targets is not None and len(shares) != len(targets):
        arguments.note("shares", f"needs {len(targets)} numbers, one for each target", shares)


@public(
    targets=several_targets(1),
    combine=words(*COMBINES),
    shares=by(SOME_SHARES),
    objective=OBJECTIVES,
    together=_together,
    keywords=Keywords(SelectionOptions, StandKeywords),
)
def select_stand(
    machine: AnyMachine,
    targets: TargetsLike,
    *,
    constraints: AnyConstraints | None = None,
    loop: LoopLike | None = None,
    ranges: RangesLike | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
    options: SelectionOptions | None = None,  # noqa: ARG001 - its fields come as keywords
    **keywords: Unpack[StandKeywords],
) -> Stand:
    """One placement good for several targets: max over base and postures of min_k V_k, or of Σ share_k V_k.

    Args:
        machine: from `flexopt.load`.
        targets: of the end-point, (K, n_task), m, inertial frame.
        constraints: as in `flexopt.build_selection`, at every target.
        options: how to choose, see `SelectionOptions`;  keywords: its fields, in place of its: objective, weights,
            control, gravity, base, posture, base_range, singularity_margin_deg, starts, seed, combine, shares.
        loop, ranges: as of `flexopt.select`, whose objectives of the loop these are, too: at every target the loop is
            the same, and the worst target counts.
        workers: as in `flexopt.solve_selection`.
        progress: called with (starts done, starts in all).

    Raises:
        InputError: arguments of wrong shape, not finite or out of range, all in one message.
        UnreachableTarget: a target cannot be reached, or no placement reaches all; says which.
        NoSolutionFound: no start led to a point that passes the checks.

    Example:
        >>> machine = flexopt.load("excavator")
        >>> stand = flexopt.select_stand(machine, [(0.0, 1.6), (0.2, 1.4)], starts=2, workers=1)
        >>> len(stand.places), stand.base.shape
        (2, (1,))
    """
    warn_implausible(machine)
    keywords["control"] = control_of(keywords.get("control"), cast("Loop | None", loop), machine)
    points, count, asked = (
        cast(Vector, targets),
        workers or available_cores(),
        SelectionOptions.model_construct(**keywords),
    )
    share = np.array(asked.shares or (1.0,) * len(points))
    share = share / share.sum()
    problems = build_problems("select_stand", machine, points, "targets", asked, constraints)
    bases = sample_bases(problems, *BASES, asked.seed)
    if not bases.shape[1]:
        raise none_reaches_all(len(points))
    word = cast(str, asked.objective)
    if asks_for_loop(word, constraints):
        sought = Asked.of("select_stand", problems[0], loop, ranges, word, constraints)
        return outcome_stand(problems, bases, sought, count, progress)
    program = one_placement(problems, share, weighted=asked.combine == "weighted")
    found = [reached_from(problem, bases, asked.seed) for problem in problems]
    good, unverified, started, worths = best_placements(
        program, bases, found, asked.starts or default_starts(program), asked.seed, count, progress,
        further=asked.starts is None and climbs(program.first),
    )  # fmt: skip
    further = len(good) - len(worths)
    good = past_ends_of_joints(program, good)
    ways = [nearest_stand(problems, [program.of(end.x, k) for k in range(len(problems))]) for end in good]
    order = _nearest_first(program, good, ways)
    good, ways = [good[k] for k in order], [ways[k] for k in order]
    best = program.packed(ways[0])
    places, n_base = places_at(program, best), len(machine.base_coordinates)
    found_at = [(program.worth(end.x), zs) for end, zs in zip(good, ways, strict=True)]
    stated: Document = {
        "objective": problems[0].name,
        "combine": asked.combine,
        "shares": share.tolist(),
        "targets": points.tolist(),
    }
    return Stand(
        places=places,
        worth=program.worth(best),
        **other_placements(found_at, program.first.scale[:n_base]),
        stationarity=good[0].stationarity,
        kinks=good[0].kinks,
        attempts=(started, len(worths)),
        ends=tuple(worths),
        further=further,
        problems=problems,
        unverified=unverified,
        provenance=provenance(machine, **problems[0].stated | stated),
    )


def _nearest_first(program: Program, good: list[End], ways: list[list[Vector]]) -> list[int]:
    """Best first, and among those of equal worth what is nearest to where the base stands now, or to zeros."""
    first, n_b = program.first, program.first.measures.plant.n_base
    worth = [program.worth(end.x) for end in good]
    away = [float(np.sum((way_to(first, way[0]) / first.scale)[:n_b] ** 2)) for way in ways]
    left, ordered = set(range(len(good))), list[int]()
    while left:
        least = max(worth[k] for k in left) - TIE_TOLERANCE * program.size
        ordered.append(min((k for k in sorted(left) if worth[k] >= least), key=away.__getitem__))
        left.remove(ordered[-1])
    return ordered
