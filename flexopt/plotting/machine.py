"""A machine in one posture, in the plane or as seen from one side."""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patches import Polygon, Rectangle

from flexopt.plotting.shape import Points, Shape, View, bar, bars_of, capsule_outline

UNDERCARRIAGE, BASE = "#444444", "#777777"


def draw_machine(
    axes: Axes, skeleton: Points, color: str, *, ghost: bool = False, label: str = "", plate: bool = True
) -> None:
    """Undercarriage, bodies as tapered bars, joints and end-point.

    Args:
        axes: with equal aspect, m.
        skeleton: ground point, joints and end-point, (2, n_bodies + 1), m, inertial frame.
        color: of the bodies.
        ghost: drawn faintly, for a posture that is not the one chosen.
        label: for the legend.
        plate: whether an undercarriage is drawn about the ground point.
    """
    alpha, order = (0.35, 2.0) if ghost else (1.0, 3.0)
    size = reach(skeleton)
    width = 0.32 * size
    x, y = skeleton[:, 0]
    if plate:
        axes.add_patch(
            Rectangle(
                (x - width / 2, y - 0.035 * size), width, 0.07 * size,
                facecolor=UNDERCARRIAGE, edgecolor="#222222", alpha=alpha, zorder=order,
            )
        )  # fmt: skip
    for k, outline in enumerate(bars(skeleton)):
        axes.add_patch(
            Polygon(
                outline, closed=True, facecolor=BASE if k == 0 else color, edgecolor="black", linewidth=0.6,
                alpha=alpha, zorder=order + 0.1,
            )
        )  # fmt: skip
    axes.plot(
        skeleton[0, 1:-1], skeleton[1, 1:-1], "o", color="white", markeredgecolor="black", markersize=4.5,
        alpha=min(1.0, 2 * alpha), zorder=order + 0.2,
    )  # fmt: skip
    axes.plot([], [], color=color, linewidth=6, alpha=alpha, label=label)


def draw_shape(axes: Axes, view: View, shape: Shape, color: str, *, ghost: bool = False, label: str = "") -> None:
    """A machine in one view, its capsules behind it and what it stands on below.

    Args:
        axes: with equal aspect, m.
        view: one of `views(shape)`.
        shape: the machine.
        color: of the bodies.
        ghost: drawn faintly, for a posture that is not the one chosen.
        label: for the legend.
    """
    alpha, order = (0.35, 2.0) if ghost else (1.0, 3.0)
    for start, end, radius in shape.capsules:
        outline = capsule_outline(view.of(start), view.of(end), radius)
        axes.add_patch(
            Polygon(
                outline, closed=True, facecolor=(*to_rgb(color), 0.12 * alpha), edgecolor=(*to_rgb(color), 0.6 * alpha),
                linewidth=0.7, zorder=order - 0.3,
            )
        )  # fmt: skip
    if shape.support is not None:
        _draw_support(axes, view, shape.support, ghost=ghost)
    if shape.skeleton.shape[0] == 2:
        draw_machine(axes, shape.skeleton, color, ghost=ghost, label=label, plate=shape.support is None)
        return
    if shape.support is None:
        _draw_undercarriage(axes, view, shape, alpha, order)
    for outline in bars_of(shape, view):
        axes.add_patch(
            Polygon(
                outline, closed=True, facecolor=color, edgecolor="black", linewidth=0.6, alpha=alpha, zorder=order + 0.1
            )
        )
    joints = view.of(shape.skeleton[:, 1:-1])
    axes.plot(
        joints[0], joints[1], "o", color="white", markeredgecolor="black", markersize=3.5, markeredgewidth=0.8,
        alpha=min(1.0, 2 * alpha), zorder=order + 0.2,
    )  # fmt: skip
    axes.plot([], [], color=color, linewidth=6, alpha=alpha, label=label)


def _draw_support(axes: Axes, view: View, support: Points, *, ghost: bool) -> None:
    """The polygon or span on which the machine stands."""
    corners = view.of(support)
    if view.upright:
        axes.plot(
            [corners[0].min(), corners[0].max()], [corners[1].mean()] * 2, color=UNDERCARRIAGE, linewidth=2.5,
            alpha=0.35 if ghost else 1.0, solid_capstyle="butt", marker="|", markersize=8, zorder=2.6,
        )  # fmt: skip
        return
    axes.add_patch(
        Polygon(
            corners.T, closed=True, facecolor=(0.27, 0.27, 0.27, 0.05 if ghost else 0.18), edgecolor=UNDERCARRIAGE,
            linewidth=1.0, linestyle="--" if ghost else "-", zorder=1.8,
        )
    )  # fmt: skip


def _draw_undercarriage(axes: Axes, view: View, shape: Shape, alpha: float, order: float) -> None:
    """A plate where the ground point is."""
    half, thick = 0.16 * shape.size, 0.035 * shape.size
    x, y = view.of(shape.skeleton[:, 0])
    high = thick if view.upright else half
    axes.add_patch(
        Rectangle(
            (x - half, y - high), 2 * half, 2 * high, facecolor=UNDERCARRIAGE, edgecolor="#222222",
            alpha=alpha if view.upright else 0.4 * alpha, zorder=order - 0.1,
        )
    )  # fmt: skip


def reach(skeleton: Points) -> float:
    """Length of all bodies, m."""
    return float(np.linalg.norm(np.diff(skeleton, axis=1), axis=0).sum())


def bars(skeleton: Points) -> list[Points]:
    """Outlines (4, 2) of the bodies, each a bar that tapers towards the end-point; a point without length is one."""
    size, count = reach(skeleton), skeleton.shape[1] - 1
    outlines: list[Points] = []
    for k, (start, end) in enumerate(zip(skeleton.T[:-1], skeleton.T[1:], strict=True)):
        thick, thin = size * (0.028 - 0.016 * k / count), size * (0.028 - 0.016 * (k + 1) / count)
        outlines.append(bar(start, end, thick, thin))
    return outlines


def draw_ground(axes: Axes, low: float, high: float, height: float) -> None:
    """A hatched line at the height of the ground."""
    axes.fill_between([low, high], height - 10.0, height, color="#efe9df", zorder=0)
    axes.plot([low, high], [height, height], color="#8a7a5c", linewidth=1.2, zorder=1)
