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
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.patches import Circle, Patch, Polygon
from matplotlib.transforms import Bbox

from flexopt.foundation.escapes import mathtext
from flexopt.foundation.palette import colors
from flexopt.model.constraints import Area, Box, Constraints, HalfPlane, Obstacle, Sphere
from flexopt.plotting.naming import Named, Names, centroid, seen, written
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
# Corners by which a circle is followed.
ROUND = 64
# Shares of lengths and areas that come of rounding.
ALIKE = 1e-9


def held(constraints: Constraints, shape: Shape) -> str:
    """What of the machine the areas of its placement are meant for."""
    return constraints.holds or ("point" if shape.support is None else "footprint")


def draw_scenery(axes: Axes, view: View, constraints: Constraints, height: float, holds: str) -> None:
    """Obstacles of the clearance, and the areas of the placement, on the ground at `height`, m, where seen upright."""
    inks = colors()
    for obstacle in _obstacles(constraints):
        _draw_obstacle(axes, view, obstacle)
    for areas, color, label in (
        (constraints.region, inks.allowed, MAY[holds]),
        (constraints.keep_out, inks.forbidden, MUST_NOT[holds]),
    ):
        for k, area in enumerate(areas or ()):
            _draw_area(axes, view, area, color, label if k == 0 else "_", height)


def name_obstacles(
    axes: Axes, view: View, constraints: Constraints, crosses: Points, limits: Points, machine: Sequence[Patch]
) -> None:
    """Write the names of obstacles, where they are in sight, but on the machine, which is drawn.

    `crosses`: targets (2, K) on which no name is written; `limits`: corners (2, 2) of the picture, m.
    """
    names = [Named(written(axes, text, at), outline) for text, outline, at in _names(view, constraints, limits)]
    for obstacle in _obstacles(constraints):
        outline = _outline(view, obstacle)
        if isinstance(obstacle, HalfPlane) and obstacle.name and outline.size:
            along = outline[:, 1] - outline[:, 0]
            upright = (math.degrees(math.atan2(along[1], along[0])) + 90.0) % 180.0 - 90.0
            text = written(axes, mathtext(obstacle.name), outline[:, :2].mean(axis=1), rotation=upright)
            names.append(Named(text, outline, outline[:, :2]))
    axes.add_artist(Names(names, crosses, machine))


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
    found = [] if constraints is None else [at for *_, at in _names(view, constraints, limits)]
    return np.array(found).reshape(-1, 2).T


def _obstacles(constraints: Constraints) -> tuple[Obstacle, ...]:
    return () if constraints.clearance is None else constraints.clearance.obstacles


def _points(view: View, obstacle: Obstacle) -> Points:
    """Points (2, K) between which an obstacle lies; none of a half-plane."""
    if isinstance(obstacle, Sphere):
        center = view.of(np.array(obstacle.center))[:, None]
        return np.hstack([center - obstacle.radius, center + obstacle.radius])
    return view.of(_corners(obstacle)) if isinstance(obstacle, Box) else np.zeros((2, 0))


def _outline(view: View, obstacle: Obstacle) -> Points:
    """Corners (2, k) in order; none of a half-plane that is seen face-on."""
    if isinstance(obstacle, Sphere):
        turns = np.linspace(0.0, math.tau, ROUND, endpoint=False)
        return view.of(np.array(obstacle.center))[:, None] + obstacle.radius * np.array([np.cos(turns), np.sin(turns)])
    return _hull(view.of(_corners(obstacle))) if isinstance(obstacle, Box) else _half_plane(view, obstacle)


def _names(view: View, constraints: Constraints, limits: Points) -> list[tuple[str, Points, Points]]:
    """Names of obstacles with an end, each with outline and middle of what is seen of it: of those together, one."""
    found, frame = list[tuple[str, Points, Points]](), Bbox([limits.min(axis=1), limits.max(axis=1)])
    for obstacle in _obstacles(constraints):
        outline = _outline(view, obstacle)
        shown = seen(outline, frame)
        if not obstacle.name or isinstance(obstacle, HalfPlane) or not shown.size:
            continue
        text, at = mathtext(obstacle.name), centroid(shown)
        for k, (other, whole, there) in enumerate(found):
            if np.hypot(*(at - there)) < TOGETHER * float(np.ptp(limits, axis=1).max()):
                found[k] = f"{other}, {text}", whole, there
                break
        else:
            found.append((text, outline, at))
    return found


def _draw_obstacle(axes: Axes, view: View, obstacle: Obstacle) -> None:
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
    elif (corners := _half_plane(view, obstacle)).size:
        axes.add_artist(
            Polygon(
                corners.T, closed=True, facecolor=colors().obstacle, edgecolor=colors().edge, linewidth=0.8, alpha=0.3,
                zorder=1.2,
            )
        )  # fmt: skip


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


def _style(*, beside: bool = False) -> dict[str, Any]:
    """Fainter and dashed what stands beside the arm's plane, seen from the side."""
    return {
        "facecolor": colors().obstacle, "edgecolor": colors().edge, "linewidth": 0.8, "alpha": 0.2 if beside else 0.55,
        "linestyle": "--" if beside else "-", "zorder": 1.5,
    }  # fmt: skip


def _half_plane(view: View, obstacle: HalfPlane) -> Points:
    """Corners (2, 4) of the side that is filled, its border, the trace of the obstacle's plane in the view's, first.

    None where the plane is seen face-on.
    """
    normal = view.of(np.array(obstacle.normal))
    length = float(np.hypot(*normal))
    if length < TRACE:
        return np.zeros((2, 0))
    away = float(np.dot(obstacle.normal, np.array(obstacle.point) - view.origin))
    point, normal = view.of(view.origin) + normal * away / length**2, normal / length
    along, far = np.array([-normal[1], normal[0]]), 1e3
    border = np.column_stack([point + far * along, point - far * along])
    return np.hstack([border, border[:, ::-1] - far * normal[:, None]])


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
