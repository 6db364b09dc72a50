"""A machine in one posture, in the plane or as seen from one side: links with their pins, a base on its springs."""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patches import FancyBboxPatch, Polygon, Rectangle
from matplotlib.transforms import Affine2D, Bbox

from flexopt.foundation.palette import colors
from flexopt.plotting.shape import Points, Shape, View, capsule_outline, chain, links_of, spring_line, views

# Shares of the machine's size: half the width of an undercarriage of which nothing is known; heights of the springs
# below it and of itself.
HALF_WIDTH, SPRING, HEIGHT = 0.16, 0.04, 0.045
FAINT = 0.4
# Depth of the ground in a picture, m: farther than any shows.
DEEP = 1e3


def draw_shape(axes: Axes, view: View, shape: Shape, color: str, *, ghost: bool = False, label: str = "") -> None:
    """A machine in one view, its capsules behind it and what it stands on below.

    Args:
        axes: with equal aspect, m.
        view: one of `views(shape)`.
        shape: the machine.
        color: of the arm.
        ghost: drawn faintly, for a posture that is not the one chosen.
        label: for the legend.
    """
    alpha, order, inks = (FAINT, 2.0, colors()) if ghost else (1.0, 3.0, colors())
    for start, end, radius in shape.capsules:
        outline = capsule_outline(view.of(start), view.of(end), radius)
        axes.add_patch(
            Polygon(
                outline, closed=True, facecolor=(*to_rgb(color), 0.16 * alpha), edgecolor=(*to_rgb(color), 0.6 * alpha),
                linewidth=0.7, zorder=order - 0.3,
            )
        )  # fmt: skip
    if view.upright:
        _draw_undercarriage(axes, view, shape, alpha, order)
    elif shape.support is not None:
        axes.add_patch(
            Polygon(
                view.of(shape.support).T, closed=True, facecolor=(*to_rgb(inks.undercarriage), 0.05 if ghost else 0.2),
                edgecolor=inks.undercarriage, linewidth=1.0, linestyle="--" if ghost else "-", zorder=1.8,
            )
        )  # fmt: skip
    for segment, outline in links_of(shape, view):
        axes.add_patch(
            Polygon(
                outline, closed=True, facecolor=inks.base if segment in shape.base else color, edgecolor=inks.edge,
                linewidth=0.6, joinstyle="round", alpha=alpha, zorder=order + 0.1,
            )
        )  # fmt: skip
    joints = view.of(shape.skeleton[:, 1:-1])
    axes.plot(
        joints[0], joints[1], "o", color=inks.page, markeredgecolor=inks.edge, markersize=3.5, markeredgewidth=0.8,
        alpha=min(1.0, 2 * alpha), zorder=order + 0.2,
    )  # fmt: skip
    if shape.elastic:
        springs = view.of(shape.skeleton[:, list(shape.elastic)])
        axes.plot(
            springs[0], springs[1], "o", markerfacecolor="none", markeredgecolor=inks.undercarriage, markersize=7.5,
            alpha=min(1.0, 2 * alpha), zorder=order + 0.2,
        )  # fmt: skip
    axes.plot([], [], color=color, linewidth=5, alpha=alpha, label=label)


def undercarriage(view: View, shape: Shape) -> tuple[Bbox, Affine2D]:
    """The box that a machine stands on, its springs unloaded, in an upright view; and how these have moved it, m.

    It is as wide as the support where that is known, and stands on the ground, on springs where it gives.
    """
    size, foot = shape.size, view.of(shape.foot)
    wide = HALF_WIDTH * size * np.array([-1.0, 1.0]) + foot[0] if shape.support is None else view.of(shape.support)[0]
    low = float(foot[1]) + (SPRING * size if shape.springs else 0.0)
    turn, there = view.axes @ shape.motion[0] @ view.axes.T, view.of(shape.moved(shape.foot[:, None]))[:, 0]
    moved = Affine2D(np.block([[turn, (there - turn @ foot)[:, None]], [np.eye(3)[2:]]]))
    return Bbox([[float(wide.min()), low], [float(wide.max()), low + HEIGHT * size]]), moved


def _draw_undercarriage(axes: Axes, view: View, shape: Shape, alpha: float, order: float) -> None:
    """The box, and springs from the ground to it."""
    inks, (box, moved) = colors(), undercarriage(view, shape)
    round_by = min(0.45 * box.height, 0.25 * box.width)
    axes.add_patch(
        FancyBboxPatch(
            (box.x0 + round_by, box.y0 + round_by), box.width - 2 * round_by, box.height - 2 * round_by,
            boxstyle=f"round,pad={round_by},rounding_size={round_by}", facecolor=inks.undercarriage,
            edgecolor=inks.edge, linewidth=0.6, alpha=alpha, zorder=order, transform=moved + axes.transData,
        )
    )  # fmt: skip
    floor = float(view.of(shape.foot)[1])
    for share in (0.14, 0.86) if shape.springs else ():
        x = box.x0 + share * box.width
        line = spring_line(np.array([x, floor]), moved.transform((x, box.y0)), 0.3 * (box.y0 - floor))
        axes.plot(*line.T, color=inks.undercarriage, linewidth=0.9, alpha=alpha, zorder=order - 0.1)


def draw_ground(axes: Axes, height: float) -> None:
    """Ground up to a height, m, as wide as the axes."""
    # Not among the data, which the limits may be fitted to.
    axes.add_artist(
        Rectangle(
            (0.0, height - DEEP), 1.0, DEEP, facecolor=colors().ground, edgecolor="none", zorder=0,
            transform=axes.get_yaxis_transform(),
        )
    )  # fmt: skip
    axes.axhline(height, color=colors().ground_line, linewidth=1.2, zorder=1)


def draw_target(
    axes: Axes, point: Points, name: str = "", *, line: bool = False, side: tuple[int, int] = (1, 1)
) -> None:
    """Where the end-point shall be, one point (2,) or several (2, K), joined where they are a path.

    `side`: where the first one's name stands: right (1) or left (-1) of it, above (1) or below (-1) it.
    """
    inks, points = colors(), np.reshape(point, (2, -1))
    axes.plot(
        points[0], points[1], "+", color=inks.target, markersize=11, markeredgewidth=1.5, linewidth=0.7,
        linestyle="-" if line else "none", zorder=6,
    )  # fmt: skip
    if name:
        axes.annotate(
            name, (float(points[0, 0]), float(points[1, 0])), xytext=(6 * side[0], 6 * side[1]), zorder=6,
            textcoords="offset points", ha="left" if side[0] > 0 else "right",
            va="baseline" if side[1] > 0 else "top", fontsize="small",
            bbox={"boxstyle": "round,pad=0.1", "facecolor": inks.page, "edgecolor": "none", "alpha": 0.7},
        )  # fmt: skip


def bars(skeleton: Points) -> list[Points]:
    """Outlines of the links of a planar machine, a body without a length as a point."""
    shape = chain(skeleton)
    found = dict(links_of(shape, views(shape)[0]))
    return [found.get((k, k + 1), skeleton[:, [k, k]].T) for k in range(skeleton.shape[1] - 1)]
