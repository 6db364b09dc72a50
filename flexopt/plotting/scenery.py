"""What stands around a machine: obstacles, ground, and where it may stand.

In: the constraints of a problem. Out: artists in a view.
"""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations, product
from typing import Any, cast

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.colors import to_rgba
from matplotlib.patches import Circle, Polygon
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox, BboxBase

from flexopt.foundation.escapes import mathtext
from flexopt.foundation.palette import colors
from flexopt.model.constraints import Area, Box, Constraints, HalfPlane, Obstacle, Sphere
from flexopt.plotting.shape import Points, Shape, View

# Of the areas where the machine may stand, and of those where it must not.
MAY = {"footprint": "the whole footprint may stand here", "point": "the anchor point (ring) may stand here"}
MUST_NOT = {
    "footprint": "no part of the footprint may stand here",
    "point": "the anchor point (ring) may not stand here",
}
# Below this share a plane's normal is seen end-on: it has no trace in the view.
TRACE = 0.05
# Of an obstacle larger than all else, so much is seen beside that, as a share of it.
AROUND = 0.5
# Names that lie within such a share of the picture of each other are one.
TOGETHER = 0.03
# What is seen no higher than a name, by this share of the picture, has it so many points below it.
FLAT, BELOW = 0.05, 16.0
# By such a share of the picture the name of a half-plane moves along its border.
ALONG = 0.15
# So often names are parted, each time to so many pixels from each other.
ROUNDS, SLACK = 200, 0.5
# What knows the names of obstacles; about a cross nothing is written, points.
NAMED, CROSS = "_name", 5.0
# Shares of lengths and areas that come of rounding.
ALIKE = 1e-9


def held(constraints: Constraints, shape: Shape) -> str:
    """What of the machine the areas of its placement are meant for."""
    return constraints.holds or ("point" if shape.support is None else "footprint")


def draw_scenery(
    axes: Axes, view: View, constraints: Constraints, height: float, holds: str, crosses: Points, limits: Points
) -> None:
    """Obstacles of the clearance, and the areas of the placement, on the ground at `height`, m, where seen upright.

    `crosses`: targets (2, K) on which no name is written; `limits`: corners (2, 2) of the picture, m.
    """
    inks = colors()
    for obstacle in _obstacles(constraints):
        _draw_obstacle(axes, view, obstacle, crosses, limits)
    whole = float(np.ptp(limits, axis=1).max())
    for text, middle, height_seen in _names(view, constraints, limits):
        away = -BELOW if height_seen < FLAT * whole else 0.0
        _name(axes, text, middle, xytext=(0.0, away), textcoords="offset points")
    axes.add_artist(_Apart(crosses))
    for areas, color, label in (
        (constraints.region, inks.allowed, MAY[holds]),
        (constraints.keep_out, inks.forbidden, MUST_NOT[holds]),
    ):
        for k, area in enumerate(areas or ()):
            _draw_area(axes, view, area, color, label if k == 0 else "_", height)


def scenery_points(view: View, constraints: Constraints, others: Points) -> Points:
    """Points (2, K) of what has an end and shall be in the picture, beside the points (2, K) of what else is in it."""
    low, high = others.min(axis=1), others.max(axis=1)
    whole, found = float((high - low).max()), [np.zeros((2, 0))]
    for points in (_points(view, each) for each in _obstacles(constraints)):
        if points.size and np.ptp(points, axis=1).max() > whole:
            first = np.minimum(low, points.max(axis=1)) - AROUND * whole
            last = np.maximum(high, points.min(axis=1)) + AROUND * whole
            points = np.clip(points, first[:, None], last[:, None])  # noqa: PLW2901
        found.append(points)
    areas = () if view.upright else constraints.region or ()
    return np.hstack([*found, *(np.array(area, dtype=np.float64).T for area in areas)])


def named_points(view: View, constraints: Constraints | None, limits: Points) -> Points:
    """Points (2, K) on which names of obstacles are written in a picture with corners (2, 2)."""
    found = [] if constraints is None else [middle for _, middle, _ in _names(view, constraints, limits)]
    return np.array(found).reshape(-1, 2).T


def _obstacles(constraints: Constraints) -> tuple[Obstacle, ...]:
    return () if constraints.clearance is None else constraints.clearance.obstacles


def _points(view: View, obstacle: Obstacle) -> Points:
    """Points (2, K) between which an obstacle lies; none of a half-plane."""
    if isinstance(obstacle, Sphere):
        center = view.of(np.array(obstacle.center))[:, None]
        return np.hstack([center - obstacle.radius, center + obstacle.radius])
    return view.of(_corners(obstacle)) if isinstance(obstacle, Box) else np.zeros((2, 0))


def _names(view: View, constraints: Constraints, limits: Points) -> list[tuple[str, Points, float]]:
    """Names of obstacles, each with middle and height of what is seen of it: of those that lie together, one."""
    found = list[tuple[str, Points, float]]()
    low, high = limits.min(axis=1, keepdims=True), limits.max(axis=1, keepdims=True)
    for obstacle in _obstacles(constraints):
        points = _points(view, obstacle)
        if not obstacle.name or not points.size:
            continue
        if (points.max(axis=1, keepdims=True) < low).any() or (points.min(axis=1, keepdims=True) > high).any():
            continue
        seen, text = np.clip(points, low, high), mathtext(obstacle.name)
        middle = (seen.min(axis=1) + seen.max(axis=1)) / 2
        for k, (other, there, high_seen) in enumerate(found):
            if np.hypot(*(middle - there)) < TOGETHER * float((high - low).max()):
                found[k] = f"{other}, {text}", there, high_seen
                break
        else:
            found.append((text, middle, float(np.ptp(seen[1]))))
    return found


def _draw_obstacle(axes: Axes, view: View, obstacle: Obstacle, crosses: Points, limits: Points) -> None:
    # Not among the data, which the limits may be fitted to.
    if isinstance(obstacle, Sphere):
        middle, radius = np.array(obstacle.center), obstacle.radius
        at = tuple(view.of(middle).tolist())
        depth = float(view.depth(middle[:, None])[0]) if _seen_from_the_side(view) else 0.0
        if depth:
            axes.add_artist(Circle(at, radius, **_style(beside=True)))
        if abs(depth) < radius:
            axes.add_artist(Circle(at, math.sqrt(radius**2 - depth**2), **_style()))
    elif isinstance(obstacle, Box):
        corners = _corners(obstacle)
        whole = _hull(view.of(corners))
        cut = _hull(view.of(_section(view, corners))) if _seen_from_the_side(view) else whole
        if _area(cut) < (1 - ALIKE) * _area(whole):
            axes.add_artist(Polygon(whole.T, closed=True, **_style(beside=True)))
        if _area(cut) > 0:
            axes.add_artist(Polygon(cut.T, closed=True, **_style()))
    else:
        _draw_half_plane(axes, view, obstacle, crosses, limits)


def _seen_from_the_side(view: View) -> bool:
    """Whether what is seen may stand beside the arm's plane."""
    return view.upright and view.axes.shape[1] == 3


def _section(view: View, corners: Points) -> Points:
    """Points (3, k) whose hull is what the plane cuts of the hull of corners (3, K)."""
    depth = view.depth(corners)
    depth[np.abs(depth) < ALIKE * np.abs(depth).max()] = 0.0
    pairs = [(i, j) for i, j in combinations(range(depth.size), 2) if depth[i] * depth[j] <= 0 and depth[i] != depth[j]]
    i, j = np.array(pairs, dtype=int).reshape(-1, 2).T
    return corners[:, i] + (corners[:, j] - corners[:, i]) * (depth[i] / (depth[i] - depth[j]))


def _area(corners: Points) -> float:
    """Of a polygon (2, k) whose corners come in order; 0 of fewer than three."""
    x, y = corners - corners[:, :1]
    return abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2


def _name(axes: Axes, text: str, at: Points, **placed: Any) -> None:
    """What something is, on it, readable on whatever else is drawn there."""
    inks = colors()
    axes.annotate(
        text, (float(at[0]), float(at[1])), fontsize="small", ha="center", va="center", zorder=7, annotation_clip=True,
        bbox={"boxstyle": "round,pad=0.1", "facecolor": inks.page, "edgecolor": "none", "alpha": 0.6},
        label=NAMED, **placed,
    )  # fmt: skip


class _Apart(Artist):
    """Moves names off each other and off crosses, when it is drawn: only then their sizes are known.

    One that lies above or beside another stays so. What is written in the axes besides, as of targets, stays in place.
    """

    def __init__(self, crosses: Points) -> None:
        """`crosses`: points (2, K) that are marked."""
        super().__init__()
        # Below the names.
        self.set(zorder=6.5, in_layout=False)
        self._crosses, self._own = crosses, dict[Annotation, tuple[float, float]]()

    def draw(self, renderer: RendererBase) -> None:
        """Move them."""
        axes = self.axes
        if axes is None:
            return
        point = float(cast(Any, renderer).points_to_pixels(1.0))
        names = [text for text in axes.texts if isinstance(text, Annotation) and text.get_label() == NAMED]
        for text in names:
            text.xyann = self._own.setdefault(text, text.xyann)
        written = [text.get_window_extent(renderer) for text in axes.texts if text not in names and text.get_text()]
        marks = axes.transData.transform(self._crosses.T)
        written += [Bbox([mark - CROSS * point, mark + CROSS * point]) for mark in marks]
        named = axes.transData.transform(np.reshape([text.xy for text in names], (-1, 2)))
        moves = _moves([text.get_window_extent(renderer) for text in names], named, written, axes.bbox) / point
        for text, (x, y) in zip(names, moves.tolist(), strict=True):
            text.xyann = self._own[text][0] + x, self._own[text][1] + y


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
        for i, j in combinations(range(len(every)), 2):
            over = half[i] + half[j] - np.abs(center[i] - center[j])
            if i >= count or over.min() <= 0:
                continue
            met, k = True, int(over[0] < over[1]) ^ 1
            sign = 1.0 if (order if j < count else own)[i, k] >= order[j, k] else -1.0
            away = (half[i, k] + half[j, k] - sign * (center[i, k] - center[j, k]) + SLACK) * sign
            center[i, k] += away if j >= count else away / 2
            center[j, k] -= 0.0 if j >= count else away / 2
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


def _style(*, beside: bool = False) -> dict[str, Any]:
    """Fainter and dashed what stands beside the arm's plane, seen from the side."""
    return {
        "facecolor": colors().obstacle, "edgecolor": colors().edge, "linewidth": 0.8, "alpha": 0.2 if beside else 0.55,
        "linestyle": "--" if beside else "-", "zorder": 1.5,
    }  # fmt: skip


def _draw_half_plane(axes: Axes, view: View, obstacle: HalfPlane, crosses: Points, limits: Points) -> None:
    """The trace of the obstacle's plane in the view's, and the side that is filled; nothing where seen face-on.

    Its name stands along it, so far from crosses that it is not on their names.
    """
    normal = view.of(np.array(obstacle.normal))
    length = float(np.hypot(*normal))
    if length < TRACE:
        return
    away = float(np.dot(obstacle.normal, np.array(obstacle.point) - view.origin))
    point, normal = view.of(view.origin) + normal * away / length**2, normal / length
    along, far = np.array([-normal[1], normal[0]]), 1e3
    corners = [point + far * along, point - far * along, point - far * along - far * normal]
    corners.append(point + far * along - far * normal)
    axes.add_artist(
        Polygon(
            np.array(corners), closed=True, facecolor=colors().obstacle, edgecolor=colors().edge, linewidth=0.8,
            alpha=0.3, zorder=1.2,
        )
    )  # fmt: skip
    if obstacle.name:
        angle = math.degrees(math.atan2(along[1], along[0]))
        upright = (angle + 90.0) % 180.0 - 90.0
        whole = float(np.ptp(limits, axis=1).max())
        places = [point + k * ALONG * whole * along for k in (0, 1, -1, 2, -2)]
        inside = [at for at in places if (limits.min(axis=1) <= at).all() and (at <= limits.max(axis=1)).all()]
        away = [float(np.min(np.hypot(*(crosses - at[:, None])), initial=math.inf)) for at in inside]
        at = next((at for at, far in zip(inside, away, strict=True) if far > ALONG / 1.5 * whole), point)
        _name(axes, mathtext(obstacle.name), at, xytext=tuple(-8.0 * normal), textcoords="offset points",
              rotation=upright)  # fmt: skip


def _corners(box: Box) -> Points:
    """Corners (d, 2^d), m, inertial frame."""
    half = np.array(box.size) / 2
    signs = np.array(list(product((-1.0, 1.0), repeat=half.size))).T
    local = half[:, None] * signs
    c, s = math.cos(box.yaw), math.sin(box.yaw)
    local[:2] = np.array([[c, -s], [s, c]]) @ local[:2]
    return np.array(box.center)[:, None] + local


def _hull(points: Points) -> Points:
    """Corners of the convex hull (2, k) in order; none where the points lie on a line."""
    from scipy.spatial import ConvexHull  # noqa: PLC0415  (slow to import)

    size = float(np.ptp(points, axis=1).max()) if points.size else 0.0
    if not size or np.linalg.svd(points - points.mean(axis=1, keepdims=True), compute_uv=False)[-1] < ALIKE * size:
        return np.zeros((2, 1))
    order = cast(list[int], ConvexHull(points.T).vertices.tolist())
    return points[:, order]


def _draw_area(axes: Axes, view: View, area: Area, color: str, label: str, height: float) -> None:
    """A polygon seen from above; seen upright, what it covers of the ground."""
    corners = np.array(area, dtype=np.float64)
    if corners.ndim == 2 and not view.upright:
        axes.add_patch(
            Polygon(
                corners, closed=True, facecolor=to_rgba(color, 0.13), edgecolor=color, linewidth=1.2, zorder=0.5,
                label=label,
            )
        )  # fmt: skip
    elif corners.ndim == 1:
        axes.plot(corners, [height, height], color=color, linewidth=4.0, solid_capstyle="butt", label=label, zorder=1.6)
