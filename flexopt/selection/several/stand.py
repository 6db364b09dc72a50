"""One placement from which all of several targets can be worked at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from flexopt.compiled.turns import in_turn
from flexopt.errors import Fault
from flexopt.model import AnyMachine
from flexopt.model.arguments import Arguments, Vector, shown
from flexopt.model.constraints import Constraints
from flexopt.model.documents import provenance
from flexopt.model.problem import COMBINES, SINGULARITY_MARGIN_DEG, Control
from flexopt.model.quantities import check_number
from flexopt.selection.parallel import check_workers
from flexopt.selection.several.joined import Joined
from flexopt.selection.several.postures import reached_from
from flexopt.selection.several.results import Stand
from flexopt.selection.several.solving import Progress, places_at
from flexopt.selection.several.standing import best_placements, default_starts, one_placement
from flexopt.selection.several.targets import build_problems, entries, none_reaches_all, read_targets, sample_bases

# Placements that are looked at, for one coordinate and for more.
BASES = 401, 512
SAME_BASE = 1e-4


@in_turn
def select_stand(
    machine: AnyMachine,
    targets: Any,
    *,
    combine: str = "worst",
    shares: Sequence[float] | None = None,
    objective: str = "w1",
    control: Control = "inverse",
    weights: Sequence[float] | None = None,
    gravity: bool = False,
    base: Any = None,
    posture: Any = None,
    base_range: Any = None,
    constraints: Constraints | Mapping[str, Any] | None = None,
    singularity_margin_deg: float = SINGULARITY_MARGIN_DEG,
    starts: int | None = None,
    seed: int = 0,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Stand:
    """One placement good for several targets: max over base and postures of min_k V_k, or of Σ share_k V_k.

    Args:
        machine: from `flexopt.load`.
        targets: of the end-point, (K, n_task), m, inertial frame.
        combine: `"worst"` maximises the smallest V_k, `"weighted"` the sum Σ share_k V_k.
        shares: of the targets in the sum, (K,), positive; even by default.
        objective: `"w1"`, `"w2"`, … or `"V"`: one, without ε_max.
        control, weights, gravity, base, posture, base_range, constraints, singularity_margin_deg, seed: as in
            `flexopt.build_selection`; constraints hold at every target.
        starts: placements that IPOPT starts from; 8 by default where targets leave one degree of freedom, else 32.
        workers: as in `flexopt.solve_selection`.
        progress: called with (starts done, starts in all).

    Raises:
        InputError: arguments of wrong shape, not finite or out of range, all in one message.
        UnreachableTarget: a target cannot be reached, or no placement reaches all; says which.
        NoSolutionFound: no start led to a point that passes the checks.
    """
    arguments = Arguments("select_stand")
    machine = arguments.machine(machine)
    points = read_targets(arguments, machine, targets, "targets", 1)
    combine = arguments.choice("combine", combine, COMBINES)
    share = _shares(arguments, shares, combine, len(points))
    count = check_workers(arguments, workers)
    arguments.done()
    options: dict[str, Any] = {"objective": objective, "control": control, "weights": weights, "gravity": gravity}
    options |= {"base": base, "posture": posture, "base_range": base_range, "constraints": constraints}
    options |= {"singularity_margin_deg": singularity_margin_deg, "starts": starts, "seed": seed}
    problems = build_problems("select_stand", machine, points, "targets", options)
    joined = one_placement(problems, share, weighted=combine == "weighted")
    bases = sample_bases(problems, *BASES, seed)
    if not bases.shape[1]:
        raise none_reaches_all(len(points))
    found = [reached_from(problem, bases, seed) for problem in problems]
    good, tried = best_placements(joined, bases, found, starts or default_starts(joined), seed, count, progress)
    best = good[0].x
    places = places_at(joined, best)
    stated = {"combine": combine, "shares": share.tolist(), "targets": points.tolist()}
    return Stand(
        places=places,
        worth=joined.worth(best),
        alternatives=tuple(_alternatives(joined, [end.x for end in good])),
        stationarity=good[0].stationarity,
        attempts=(tried, len(good)),
        problems=problems,
        provenance=provenance(machine, **stated, objective=problems[0].name, control=control, seed=seed),
    )


def _shares(arguments: Arguments, shares: Any, combine: str, count: int) -> Vector:
    even = np.full(count, 1 / count)
    if shares is None:
        return even
    if combine != "weighted":
        arguments.faults.append(Fault("shares", "go with combine = 'weighted' only", shown(shares)))
        return even
    values = entries(shares)
    if len(values) != count:
        arguments.faults.append(Fault("shares", f"needs {count} numbers, one for each target", shown(shares)))
        return even
    numbers = [
        arguments.checked(f"shares[{k}]", x, lambda v: check_number(v, "", above=0.0, high=1e6), 1.0)
        for k, x in enumerate(values)
    ]
    return np.array(numbers) / sum(numbers)


def _alternatives(joined: Joined, points: list[Vector]) -> list[tuple[float, Vector]]:
    """Worth and placement of the optima after the first, those at the same place once."""
    n_b = joined.first.measures.plant.n_base
    scale = joined.first.scale[:n_b]
    bases = [points[0][:n_b]]
    others: list[tuple[float, Vector]] = []
    for x in points[1:]:
        if all(np.abs(x[:n_b] - other).max(initial=0.0) > SAME_BASE for other in bases):
            bases.append(x[:n_b])
            others.append((joined.worth(x), x[:n_b] * scale))
    return others
