"""Names of what stands around a machine, written where the machine leaves room.

In: names, each with the outline of what it names, and what is drawn of the machine. Out: texts that find their places.
"""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.path import Path
from matplotlib.patheffects import withStroke
from matplotlib.text import Annotation, Text
from matplotlib.transforms import Bbox, BboxBase
from numpy.typing import NDArray

from flexopt.foundation.palette import colors
from flexopt.plotting.shape import Points

# So often names are parted, each time to so many pixels from each other.
ROUNDS, SLACK = 200, 0.5
# About a cross nothing is written; from a border to the middle of a name along it; from an outline to a name beside it,
# and from a name to the machine, points.
CROSS, BORDER, BESIDE, CLEAR = 5.0, 8.0, 2.0, 1.0
# Places looked at: on what is named in each direction, and along each of its edges.
ON, EDGE = 21, 41
# Half of a cross; how near crosses are one to the eye; about a number its halo; steps away from its cross, points. So
# many steps are looked at, and from more than so many a line leads to the cross.
ARM, ONE, HALO, STEP = 6.0, 3.0, 1.25, 4.0
STEPS, LED = 24, 2
# Heights of a name that its place may lie farther from the middle before it changes from on to beside.
CHANGE = 12.0


@dataclass(frozen=True)
class Named:
    """A text and what it names, m.

    Attributes:
        text: whose turn does not change.
        outline: corners (2, k) of a convex polygon, in order, of which some may be beyond the picture.
        border: ends (2, 2) of the edge along which the name stands, what is named on its right; None: on any side.
    """

    text: Annotation
    outline: Points
    border: Points | None = None


def written(axes: Axes, text: str, at: Points, **settings: Any) -> Annotation:
    """What something is, readable on whatever else is drawn there."""
    inks = colors()
    return axes.annotate(
        text, (float(at[0]), float(at[1])), xytext=(0.0, 0.0), textcoords="offset points", fontsize="small",
        ha="center", va="center", zorder=7, annotation_clip=True,
        bbox={"boxstyle": "round,pad=0.1", "facecolor": inks.page, "edgecolor": "none", "alpha": 0.6}, **settings,
    )  # fmt: skip


def seen(outline: Points, frame: BboxBase) -> Points:
    """Corners (2, k) of what a frame shows of a convex polygon (2, n); none where it shows nothing."""
    if outline.shape[1] < 3:
        return np.zeros((2, 0))
    closed = Path(np.column_stack([outline, outline[:, 0]]).T, closed=True)
    parts = closed.clip_to_bbox(cast(Bbox, frame)).to_polygons(closed_only=False)
    return np.array(parts[0], dtype=np.float64)[:-1].T if parts else np.zeros((2, 0))


def centroid(corners: Points) -> Points:
    """Centre of area (2,) of a convex polygon (2, k); that of its corners where it has no area."""
    start = corners.mean(axis=1, keepdims=True)
    (x, y), (u, v) = corners - start, np.roll(corners, -1, axis=1) - start
    weights = x * v - y * u
    whole = float(np.sum(weights))
    if abs(whole) < 1e-12 * float(np.ptp(corners)) ** 2:
        return start[:, 0]
    return start[:, 0] + np.array([(x + u) @ weights, (y + v) @ weights]) / (3 * whole)


class Names(Artist):
    """Puts names in their places when they are drawn: only then their sizes and the picture's limits are known.

    A name stands on or right beside what is seen of what it names, as near to the middle of that as the machine,
    crosses and what else is written there leave room. Names that meet part; one that lies above or beside another
    stays so. What is written in the axes besides, as of targets, stays in place.
    """

    def __init__(self, names: Sequence[Named], crosses: Points, machine: Sequence[Patch]) -> None:
        """`crosses`: points (2, K) that are marked."""
        super().__init__()
        # Below the names.
        self.set(zorder=6.5, in_layout=False)
        self._names, self._crosses, self._machine = names, crosses, machine
        self._given = [named.text.xy for named in names]

    def draw(self, renderer: RendererBase) -> None:
        """Place them."""
        axes = self.axes
        if axes is None:
            return
        point = float(cast(Any, renderer).points_to_pixels(1.0))
        own = [named.text for named in self._names]
        others = [text.get_window_extent(renderer) for text in axes.texts if text not in own and text.get_text()]
        marks = axes.transData.transform(self._crosses.T)
        others += [Bbox([mark - CROSS * point, mark + CROSS * point]) for mark in marks]
        paths = [patch.get_transform().transform_path(patch.get_path()) for patch in self._machine]
        extents = [path.get_extents() for path in paths]
        anchors, centers, boxes = list[Points](), list[Points](), list[Bbox]()
        for named, given in zip(self._names, self._given, strict=True):
            # An annotation beyond the axes would have no size.
            half = np.array(Text.get_window_extent(named.text, renderer).size) / 2
            outline, border, start = (
                None if each is None else axes.transData.transform(np.transpose(each)).T
                for each in (named.outline, named.border, np.reshape(given, (2, 1)))
            )
            shown = seen(cast(Points, outline), axes.bbox)
            if border is not None:
                places = _along(shown, border, cast(Points, start), BORDER * point)
            else:
                places = _about(shown, half, BESIDE * point)
            away = np.abs(places[1] - np.mean(axes.bbox.get_points(), axis=0))
            inside = (away + half <= np.array(axes.bbox.size) / 2).all(axis=1)
            places = places[:, inside] if inside.any() else places
            if not places.shape[1]:
                places = np.repeat(cast(Points, start).T[None], 2, axis=0)
            k = _free(places[1], half + CLEAR * point, paths, extents, others, boxes)
            anchors.append(places[0, k])
            centers.append(places[1, k])
            boxes.append(Bbox([places[1, k] - half, places[1, k] + half]))
        moves = _moves(boxes, np.reshape(anchors, (-1, 2)), others, axes.bbox)
        for text, anchor, center, move in zip(own, anchors, centers, moves, strict=True):
            text.xy = tuple(axes.transData.inverted().transform(anchor).tolist())
            text.xyann = tuple(((center + move - anchor) / point).tolist())


class TargetNumbers(Artist):
    """Puts numbers beside the crosses that they name when they are drawn, on no cross and on no other number.

    Each stands as near to its cross as there is room, and no nearer to another one; far from it, a line leads to it.
    Crosses that are one to the eye have their numbers in one text.
    """

    def __init__(self, axes: Axes, marks: Points, numbered: Sequence[int], ink: str, halo: str) -> None:
        """`marks`: points (2, K) that are marked;  numbered: which of these are named, by their number from 1 on."""
        super().__init__()
        # Below other names, which give way to what is written.
        self.set(zorder=6.4, in_layout=False)
        self._marks, self._ink = marks, ink
        self._texts = {
            k: axes.annotate(
                str(k + 1), (float(marks[0, k]), float(marks[1, k])), xytext=(0.0, 0.0), textcoords="offset points",
                ha="center", va="center", zorder=7, path_effects=[withStroke(linewidth=2 * HALO, foreground=halo)],
            )
            for k in numbered
        }  # fmt: skip

    def draw(self, renderer: RendererBase) -> None:
        """Place them."""
        axes = self.axes
        if axes is None:
            return
        point = float(cast(Any, renderer).points_to_pixels(1.0))
        marks = axes.transData.transform(self._marks.T)
        taken = [Bbox([mark - ARM * point, mark + ARM * point]) for mark in marks]
        alike = dict[int, list[int]]()
        for k, text in self._texts.items():
            first = next((i for i in alike if np.abs(marks[i] - marks[k]).max() < ONE * point), k)
            alike.setdefault(first, []).append(k)
            text.set_text("")
        for first, numbers in alike.items():
            text, mark = self._texts[first], marks[first]
            text.set_text(", ".join(str(k + 1) for k in numbers))
            half = np.array(Text.get_window_extent(text, renderer).size) / 2 + HALO * point
            centers, steps = _around(mark, half, point)
            away = np.abs(centers - np.mean(axes.bbox.get_points(), axis=0)) + half > np.array(axes.bbox.size) / 2
            met = _meeting(centers - half, centers + half, taken).sum(axis=1) + len(taken) * away.any(axis=1)
            distances = np.hypot(*(centers[:, None] - marks).transpose(2, 0, 1))
            others = np.abs(marks - mark).max(axis=1) >= ONE * point
            misread = distances[:, first] > distances[:, others].min(axis=1, initial=np.inf)
            k = int(np.lexsort((steps, misread, met))[0])
            text.xyann = tuple(((centers[k] - mark) / point).tolist())
            taken.append(Bbox([centers[k] - half, centers[k] + half]))
            if steps[k] > LED:
                toward = (mark - centers[k]) / distances[k, first]
                start = centers[k] + toward * float((half / np.maximum(np.abs(toward), 1e-9)).min())
                Line2D(*np.transpose([start, mark]), color=self._ink, linewidth=0.7).draw(renderer)


def _around(mark: Points, half: Points, point: float) -> tuple[Points, NDArray[np.int64]]:
    """Middles (n, 2) of a number around a cross, and how many steps away from it each is; `half`: its size, px."""
    sides = np.array([[1, 1], [-1, 1], [1, -1], [-1, -1], [0, 1], [1, 0], [-1, 0], [0, -1]], dtype=np.float64)
    steps = np.repeat(np.arange(STEPS), len(sides))
    away = half + (ARM + STEP * steps[:, None]) * point + SLACK
    return mark + np.tile(sides, (STEPS, 1)) * away, steps


def _about(shown: Points, half: Points, gap: float) -> Points:
    """Places (2, n, 2) on and beside a polygon (2, k), the best first: points of it, and middles of a name there.

    `half`: half the name's size, px. What is lower than its name has it beside it, below rather than above.
    """
    if not shown.size:
        return np.zeros((2, 0, 2))
    center, low, high = centroid(shown), shown.min(axis=1), shown.max(axis=1)
    steps: Points = np.linspace(0.0, 1.0, ON)
    grid = low + np.column_stack([np.tile(steps, ON), np.repeat(steps, ON)]) * (high - low)
    on = np.vstack([center, grid[Path(shown.T).contains_points(grid)]])
    start, shares = shown.T, np.linspace(0.0, 1.0, EDGE)
    along = np.roll(start, -1, axis=0) - start
    lengths = np.hypot(*along.T)
    start, along = start[lengths > 0], along[lengths > 0]
    rim = (start[:, None] + shares[:, None] * along[:, None]).reshape(-1, 2)
    outward = np.column_stack([along[:, 1], -along[:, 0]]) / np.hypot(*along.T)[:, None]
    outward *= np.sign(np.sum(outward * (start + along / 2 - center), axis=1, keepdims=True))
    outward = np.repeat(outward, EDGE, axis=0)
    beside = rim + outward * (np.abs(outward) @ half + gap)[:, None]
    change, flat = CHANGE * 2 * half[1], bool(high[1] - low[1] < 2 * half[1])
    cost = np.hypot(*(np.vstack([on, rim]) - center).T)
    cost[: len(on)] += change if flat else 0.0
    cost[len(on) :] += half[1] * (outward[:, 1] > 0) + (0.0 if flat else change)
    return np.stack([np.vstack([on, rim]), np.vstack([on, beside])])[:, np.argsort(cost, kind="stable")]


def _along(shown: Points, border: Points, start: Points, away: float) -> Points:
    """Places (2, n, 2) as `_about`, along the border (2, 2) of a polygon, on its right rather than its left.

    The nearest to a point (2, 1) come first.
    """
    along = border[:, 1] - border[:, 0]
    along = along / np.hypot(*along)
    right = np.array([along[1], -along[0]])
    edge = along @ shown[:, np.abs(right @ (shown - border[:, :1])) < SLACK]
    if edge.size < 2:
        return np.zeros((2, 0, 2))
    least, most = float(edge.min()), float(edge.max())
    there = min(max(float(along @ start[:, 0]), least), most)
    shares: Points = np.append(there, np.linspace(least, most, EDGE))
    points = (right @ border[:, 0]) * right + shares[:, None] * along
    far = np.abs(shares - there)
    cost = np.concatenate([far, far + CHANGE * away])
    return np.stack([np.tile(points, (2, 1)), np.vstack([points + away * right, points - away * right])])[
        :, np.argsort(cost, kind="stable")
    ]


def _free(
    centers: Points,
    half: Points,
    machine: Sequence[Path],
    extents: Sequence[BboxBase],
    others: Sequence[BboxBase],
    names: Sequence[BboxBase],
) -> int:
    """The first of places (n, 2) with a clear view; where there is none, that which least is drawn on.

    The very first need be clear of the machine and the others alone: names that meet there part.

    `extents`: of the machine's outlines.
    """
    low, high = centers - half, centers + half
    near = _meeting(low, high, extents)
    # Two names in a row nearer than their height would read as one.
    gap = np.array([2 * half[1], 0.0])
    among = _meeting(low - gap, high + gap, names)
    among[0] = False
    met = _meeting(low, high, others).sum(axis=1) + among.sum(axis=1)
    # Outlines of the machine are slow to ask: only those near to a place that may yet be the best.
    most = met + near.sum(axis=1)
    best = int(most.argmin())
    fewest = int(most[best])
    for k in np.argsort(met, kind="stable").tolist():
        count = int(met[k])
        if (count, k) >= (fewest, best):
            break
        box = Bbox([low[k], high[k]])
        for i in np.flatnonzero(near[k]).tolist():
            count += machine[i].intersects_bbox(box)
            if count > fewest:
                break
        fewest, best = min((fewest, best), (count, k))
    return best


def _meeting(low: Points, high: Points, boxes: Sequence[BboxBase]) -> NDArray[np.bool_]:
    """Which of rectangles with these corners (n, 2) overlap which of boxes, (n, boxes)."""
    found = np.ones((len(low), len(boxes)), dtype=bool)
    least, most = (np.reshape([getattr(box, end) for box in boxes], (-1, 2)) for end in ("min", "max"))
    for i in range(2):
        found &= (low[:, i, None] <= most[:, i]) & (least[:, i] <= high[:, i, None])
    return found


def _moves(boxes: Sequence[BboxBase], named: Points, still: Sequence[BboxBase], frame: BboxBase) -> Points:
    """By how much boxes move, (n, 2), to be on no other and on nothing that stands still, all inside the frame.

    In a crowd some may still be on others after `ROUNDS`.

    Two that overlap part along the side on which they overlap less, each half the way, in the order of the points
    (n, 2) that they name.
    """
    count = len(boxes)
    if not count:
        return np.zeros((0, 2))
    every = [*boxes, *_merged(still, min(box.height for box in boxes))]
    low, high = np.array([each.min for each in every]), np.array([each.max for each in every])
    own, half = (low + high) / 2, (high - low) / 2
    center, order = own.copy(), np.vstack([named, own[count:]])
    room = np.maximum(np.array(frame.max) - np.array(frame.min) - 2 * half[:count], 0.0) / 2
    middle = (np.array(frame.min) + np.array(frame.max)) / 2
    inside = (np.abs(own[:count] - middle) <= room).all(axis=1)
    for _ in range(ROUNDS):
        met = False
        for i in range(count):
            j = i + 1
            while len(over := half[i] + half[j:] - np.abs(center[i] - center[j:])):
                hits = np.flatnonzero((over > 0).all(axis=1))
                if not hits.size:
                    break
                j += int(hits[0])
                met, k = True, int(over[hits[0], 0] < over[hits[0], 1]) ^ 1
                sign = 1.0 if (order if j < count else own)[i, k] >= order[j, k] else -1.0
                away = (half[i, k] + half[j, k] - sign * (center[i, k] - center[j, k]) + SLACK) * sign
                center[i, k] += away if j >= count else away / 2
                center[j, k] -= 0.0 if j >= count else away / 2
                j += 1
        kept = np.clip(center[:count], middle - room, middle + room)
        center[:count][inside] = kept[inside]
        if not met:
            break
    return center[:count] - own[:count]


def _merged(boxes: Sequence[BboxBase], gap: float) -> list[BboxBase]:
    """Boxes between which there is no room for what is as high as the gap, as one."""
    found = list[BboxBase]()
    for box in boxes:
        near = [other for other in found if other.padded(gap).overlaps(box)]
        found = [*(other for other in found if other not in near), Bbox.union([box, *near])]
    return found
