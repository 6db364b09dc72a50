"""The best gains of a loop in one place: those with which its slowest member decays fastest, or nearly, with room.

In: a loop in a place, members, ranges of its gains. Out: the loop with other gains.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.foundation.plain import listed
from flexopt.loop.settings import LoopSettings
from flexopt.model.loop import NEAR_END, Loop, gain_ranges, least_tried, logarithms
from flexopt.study.verdicts.place_loops import PlaceLoops

# Gains tried along each range at first, evaluations of the search that follows, and by how much all gains together
# are tried where no range is given.
GRID, EVALUATIONS, LEAST, MOST = 9, 80, 1e-2, 10.0
# Times its gains that a loop is to bear, where any of those looked at does.
RESERVE = 1.1
# So many times as high gains are to hold, too; in which steps gains are lowered for that, and how often the last one is
# halved where it is too much.
ROOM, LOWER, HALVINGS = 2.0, 0.5**0.25, 6
OTHERS = "kp_range and kv_range of the loop have others tried"


def best_gains(loop: PlaceLoops, asked: Loop, members: Vector, does: Callable[[PlaceLoops], bool]) -> PlaceLoops:
    """The loop with the best gains within `asked`'s ranges; with none, all gains times one factor, 0.01 to 10.

    The criterion is the decay of the slowest of the members (n, k) at the worst target; they should be few. Of gains
    with which the loop does what it must: such that bear `RESERVE` times as much, where any of those looked at do.
    """
    from scipy.optimize import minimize  # noqa: PLC0415  (loads slowly)

    ranges = gain_ranges(asked)
    axes = [np.linspace(*logarithms(ends), GRID) for ends in ranges.values()]
    axes = axes or [np.linspace(math.log(LEAST), math.log(MOST), 2 * GRID)]

    def with_gains(x: Any) -> PlaceLoops:
        return loop.with_settings(_scaled(loop.settings, dict(zip(ranges, x, strict=True)) if ranges else x[0]))

    def growth(x: Any, times: float = 1.0) -> float:
        tried = with_gains(x)
        return -float((tried if times == 1.0 else lowered(tried, asked, times)).decays(members).min())

    def with_reserve(x: Any) -> bool:
        tried = with_gains(x)
        return has_reserve(tried, asked, members) and does(tried)

    def without(x: Any) -> bool:
        return does(with_gains(x))

    points = list(product(*(axis.tolist() for axis in axes)))
    values = [growth(point) for point in points]
    order: list[int] = np.argsort(values, kind="stable").tolist()
    bounds = [(float(axis[0]), float(axis[-1])) for axis in axes]

    def lowest(of: Callable[[Any], float], start: Any) -> Any:
        # The slowest decay of several is not smooth.
        return minimize(
            of, start, method="Nelder-Mead", bounds=bounds,
            options={"maxfev": EVALUATIONS, "initial_simplex": _simplex(start, axes)},
        )  # fmt: skip

    fits = with_reserve
    first = next((points[k] for k in order if values[k] < 0 and fits(points[k])), None)
    if first is None:
        # Those with a reserve may lie between the points of the grid.
        between = lowest(lambda x: max(growth(x), growth(x, RESERVE)), np.array(points[order[0]]))
        first = between.x if between.fun < 0 and fits(between.x) else None
    if first is None:
        fits = without
        first = next((points[k] for k in order if fits(points[k])), None)
    start = np.array(points[order[0]] if first is None else first)
    least = growth(start)

    def allowed(x: Any) -> float:
        # What is no better is not looked at: that takes its time.
        value = growth(x)
        return value if value >= least or first is None or fits(x) else math.inf

    found = lowest(allowed, start)
    return with_gains(found.x if found.fun < least else start)


def lowered(loop: PlaceLoops, asked: Loop, factor: float) -> PlaceLoops:
    """The loop with the gains that `best_gains` seeks times one factor."""
    ranges, now = gain_ranges(asked), loop.settings
    logs = {name: math.log(factor * getattr(now, name)[0]) for name in ranges} or math.log(factor)
    return loop.with_settings(_scaled(now, logs))


def has_reserve(loop: PlaceLoops, asked: Loop, members: Vector) -> bool:
    """Whether a loop decays for members (n, k), and with gains `RESERVE` times as high, too."""
    return all(float(each.decays(members).min()) > 0 for each in (loop, lowered(loop, asked, RESERVE)))


def most_room(
    loop: PlaceLoops, asked: Loop, now: LoopSettings, members: Vector, keeps: Callable[[float], bool]
) -> float:
    """The factor of the best gains, 1 at most, with which `ROOM` times as high ones do not grow, or as near as can be.

    Decay hardly falls up to the gain at which another motion grows, so that the best gains may lie right below it. They
    are lowered as long as the decay of the slowest member is as `keeps` asks, and not below `asked`'s ranges; with
    none, not below 0.01 times the gains `now`.
    """
    ends = {name: math.exp(logarithms(ends)[0]) for name, ends in gain_ranges(asked).items()}
    ends = ends or {name: LEAST * getattr(now, name).max() for name in ("kp", "kv")}
    gains = {name: getattr(loop.settings, name).max() for name in ends}
    least = min(1.0, max((ends[name] / gain for name, gain in gains.items() if gain > 0), default=1.0))

    def decay(factor: float) -> float:
        return float(lowered(loop, asked, factor).decays(members).min())

    kept = 1.0
    while kept > least and decay(ROOM * kept) <= 0:
        low = max(LOWER * kept, least)
        if keeps(decay(low)):
            kept = low
            continue
        for _ in range(HALVINGS):
            middle = math.sqrt(low * kept)
            low, kept = (low, middle) if keeps(decay(middle)) else (middle, kept)
        break
    return kept


def raised(loop: PlaceLoops, asked: Loop, now: LoopSettings, factor: float) -> PlaceLoops:
    """The loop with the gains that `best_gains` seeks times one factor, each at most the highest that it looks at.

    `now`: the gains that there are.
    """
    ranges, has = gain_ranges(asked), loop.settings
    if not ranges:
        return lowered(loop, asked, min(factor, _highest(asked, now, has)))
    logs = {name: min(math.log(factor * getattr(has, name)[0]), logarithms(ends)[1]) for name, ends in ranges.items()}
    return loop.with_settings(_scaled(has, logs))


def most_raised(
    loop: PlaceLoops,
    asked: Loop,
    now: LoopSettings,
    members: Vector,
    room: float,
    does: Callable[[PlaceLoops], bool],
) -> float:
    """The largest factor of the best gains, from 1 in steps of 2^(1/4), up to which the loop does what it must.

    With `raised` gains, and with `room` times as high ones, too, it decays for every member (n, k).
    """
    most, kept = _highest(asked, now, loop.settings), 1.0
    while kept < most:
        higher = min(kept / LOWER, most)
        tried = raised(loop, asked, now, higher)
        decays = (each.decays(members).min() for each in (tried, lowered(tried, asked, room)))
        if not (all(decay > 0 for decay in decays) and does(tried)):
            break
        kept = higher
    return kept


def _highest(asked: Loop, now: LoopSettings, has: LoopSettings) -> float:
    """How many times the Kp of a loop the highest is that `best_gains` looks at; 1 where it looks at no other Kp."""
    ranges, kp = gain_ranges(asked), float(has.kp.max())
    highest = (
        MOST * float(now.kp.max()) if not ranges else math.exp(logarithms(ranges["kp"])[1]) if "kp" in ranges else kp
    )
    return highest / kp if kp > 0 else 1.0


def tried_gains(asked: Loop) -> str:
    """Which gains `best_gains` looks at, in words."""
    if gain_ranges(asked):
        return "others in their ranges"
    return f"{LEAST:g} to {MOST:g} times these, all by one factor; {OTHERS}"


def gains_looked_at(asked: Loop) -> str:
    """The like, where they are told of by themselves."""
    if ranges := gain_ranges(asked):
        return f"other gains within {listed(f'{name}_range' for name in ranges)}"
    return f"gains {LEAST:g} to {MOST:g} times the present ones"


def one_factor(asked: Loop) -> str:
    """That gains were tried in one ratio alone, in words; empty where ranges have others tried."""
    return "" if gain_ranges(asked) else f"all gains were tried by one factor: {OTHERS}"


def at_ends(found: LoopSettings, asked: Loop, now: LoopSettings) -> str:
    """Which of the gains found lie at an end of what `best_gains` looks at, in words; empty where none does.

    `now`: the gains that there are.
    """
    ranges, told = gain_ranges(asked), list[str]()
    for name, ends in ranges.items():
        for side, end in zip(("lower", "upper"), map(math.exp, logarithms(ends)), strict=True):
            gain = float(getattr(found, name).max())
            if math.isclose(gain, end, rel_tol=NEAR_END) and ends[0] < ends[1]:
                told.append(least_tried(name, gain, ends) or f"{name} is the {side} end of its range")
    if ranges:
        return " and ".join(told)
    factor = found.kp.max() / now.kp.max() if now.kp.any() else found.kv.max() / now.kv.max() if now.kv.any() else 1.0
    for side, end in (("lower", LEAST), ("higher", MOST)):
        if math.isclose(factor, end, rel_tol=NEAR_END):
            return (
                f"no {side} ones were tried than {end:g} times the present ones: kp_range and kv_range have them tried"
            )
    return ""


def _simplex(start: Vector, axes: Sequence[Vector]) -> Vector:
    """Corners one step of the grid away, inside."""
    corners = [start]
    for k, axis in enumerate(axes):
        step = float(axis[1] - axis[0])
        corner = start.copy()
        corner[k] += step if start[k] + step <= axis[-1] else -step
        corners.append(corner)
    return np.array(corners)


def _scaled(settings: LoopSettings, logs: dict[str, float] | float) -> LoopSettings:
    if isinstance(logs, dict):
        given = {name: np.full(len(settings.kp), math.exp(x)) for name, x in logs.items()}
        return replace(settings, **given)
    factor = math.exp(logs)
    return replace(settings, kp=factor * settings.kp, kv=factor * settings.kv, ki=factor * settings.ki)
