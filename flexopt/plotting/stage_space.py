"""The scene of a film of a machine in space: seen from the side and from above, error and a deflection beside it.

In: a `Film`. Out: pictures, one for each row, as from `stage.Stage`. What does not move is drawn once.
"""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb

from flexopt.foundation.palette import colors
from flexopt.plotting.machine import draw_ground
from flexopt.plotting.scene import target_point
from flexopt.plotting.shape import Shape, View, bars_of, capsule_outline, shape_at, views
from flexopt.plotting.stage import AxesPlace, Film, Shots, usual

SIZE = (8.6, 6.4)
SCENES = ((0.075, 0.545, 0.46, 0.36), (0.075, 0.08, 0.46, 0.35))
PANELS = ((0.63, 0.56, 0.345, 0.32), (0.63, 0.11, 0.345, 0.32))


@dataclass(frozen=True)
class _Scene:
    """One view: its axes, and what moves in it."""

    axes: Axes
    view: View
    capsules: PolyCollection
    bars: PolyCollection
    joints: Any
    trace: Any
    target: Any

    @property
    def moving(self) -> list[Artist]:
        """In the order they are drawn."""
        return [self.capsules, self.bars, self.joints, self.trace, self.target]


class SpaceStage(Shots):
    """The figure: what stays in it, and the artists that move."""

    def __init__(self, film: Film) -> None:
        super().__init__(film, SIZE)
        t = film.trajectory
        self.shapes = {int(k): shape_at(t.model, film.q[k], film.base[k]) for k in np.unique(film.frames)}
        self.target = [
            target_point(tip, t.model.task_rows, at) for tip, at in zip(film.skeleton[:, -1], film.target, strict=True)
        ]
        first = self.shapes[int(film.frames[0])]
        seen = views(first)
        self.scenes = [self._scene(place, view, first) for place, view in zip(SCENES, seen, strict=True)]
        clock = self.scenes[0].axes.text(0.03, 0.955, "", transform=self.scenes[0].axes.transAxes, fontsize=9, va="top")
        moving = [artist for scene in self.scenes for artist in scene.moving]
        self._finish(moving, clock, PANELS, 0.985)

    def _scene(self, place: AxesPlace, view: View, first: Shape) -> _Scene:
        axes = self.figure.add_axes(place)
        self._set_limits(axes, view, first)
        color = to_rgb(colors().present)
        capsules = PolyCollection(
            [], facecolors=[(*color, 0.12)], edgecolors=[(*color, 0.6)], linewidths=0.7, zorder=2.7
        )
        bars = PolyCollection([], facecolors=[colors().present], edgecolors=colors().edge, linewidths=0.6, zorder=3)
        for collection in (capsules, bars):
            axes.add_collection(collection, autolim=False)
        (joints,) = axes.plot([], [], "o", color=colors().page, markeredgecolor=colors().edge, markersize=3.5, zorder=4)
        (trace,) = axes.plot([], [], color=colors().chosen, linewidth=0.8, zorder=5)
        (target,) = axes.plot([], [], "+", color=colors().target, markersize=10, markeredgewidth=1.3, zorder=6)
        return _Scene(axes, view, capsules, bars, joints, trace, target)

    def _set_limits(self, axes: Axes, view: View, first: Shape) -> None:
        """Limits that hold the machine's usual motion, not a run that flies away; the same scale on both axes."""
        film, size = self.film, first.size
        points = np.einsum("ij,kpj->kpi", view.axes, film.skeleton)
        low, high = usual(points, view.of(film.anchor.T).T, size)
        for start, end, radius in first.capsules:
            both = view.of(np.column_stack([start, end]))
            low, high = np.minimum(low, both.min(axis=1) - radius), np.maximum(high, both.max(axis=1) + radius)
        low, high = low - 0.06 * size, high + np.array([0.06, 0.14 if view.upright else 0.06]) * size
        if view.upright:
            draw_ground(axes, float(view.of(first.foot)[1]))
        caption = f"{view.name}; {film.caption}" if view.upright else view.name
        self._frame(axes, low, high, 0.5, *view.labels, caption)

    def _move(self, k: int) -> None:
        for scene in self.scenes:
            self._move_scene(scene, k)

    def _move_scene(self, scene: _Scene, k: int) -> None:
        """What one view shows in row k."""
        shape, view = self.shapes[k], scene.view
        scene.capsules.set_verts([capsule_outline(view.of(a), view.of(b), radius) for a, b, radius in shape.capsules])
        scene.bars.set_verts(bars_of(shape, view))
        joints, tips = view.of(shape.skeleton[:, 1:-1]), view.of(self.film.skeleton[: k + 1, -1].T)
        scene.joints.set_data(joints[0], joints[1])
        scene.trace.set_data(tips[0], tips[1])
        target = view.of(self.target[k])
        scene.target.set_data(target[:1], target[1:])
