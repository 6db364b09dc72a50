"""A planar machine in one posture, from the points of its skeleton."""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon, Rectangle
from numpy.typing import NDArray

Points = NDArray[np.float64]
UNDERCARRIAGE, BASE = "#444444", "#777777"


def draw_machine(axes: Axes, skeleton: Points, color: str, *, ghost: bool = False, label: str = "") -> None:
    """Undercarriage, bodies as tapered bars, joints and end-point.

    Args:
        axes: with equal aspect, m.
        skeleton: ground point, joints and end-point, (2, n_bodies + 1), m, inertial frame.
        color: of the bodies.
        ghost: drawn faintly, for a posture that is not the one chosen.
        label: for the legend.
    """
    alpha, order = (0.35, 2.0) if ghost else (1.0, 3.0)
    size = reach(skeleton)
    width = 0.32 * size
    x, y = skeleton[:, 0]
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


def reach(skeleton: Points) -> float:
    """Length of all bodies, m."""
    return float(np.linalg.norm(np.diff(skeleton, axis=1), axis=0).sum())


def bars(skeleton: Points) -> list[Points]:
    """Outlines (4, 2) of the bodies, each a bar that tapers towards the end-point; a point without length is one."""
    size, count = reach(skeleton), skeleton.shape[1] - 1
    outlines: list[Points] = []
    for k, (start, end) in enumerate(zip(skeleton.T[:-1], skeleton.T[1:], strict=True)):
        along = end - start
        across = np.array([-along[1], along[0]]) / (float(np.hypot(*along)) or 1.0)
        thick, thin = size * (0.028 - 0.016 * k / count), size * (0.028 - 0.016 * (k + 1) / count)
        outlines.append(
            np.array([start + thick * across, end + thin * across, end - thin * across, start - thick * across])
        )
    return outlines


def draw_ground(axes: Axes, low: float, high: float, height: float) -> None:
    """A hatched line at the height of the ground."""
    axes.fill_between([low, high], height - 10.0, height, color="#efe9df", zorder=0)
    axes.plot([low, high], [height, height], color="#8a7a5c", linewidth=1.2, zorder=1)
