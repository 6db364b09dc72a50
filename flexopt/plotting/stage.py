"""The scene of a film in the plane: the machine on its springs, its end-point's trace, error and base motion beside it.

In: a `Film`, the rows of a run that are drawn. Out: pictures, one for each row. What does not move is drawn once.
"""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Affine2D, Bbox
from numpy.typing import NDArray

from flexopt.foundation.arrays import Vector
from flexopt.foundation.palette import colors
from flexopt.plant import build_plant
from flexopt.plotting.machine import SPRING, bars, draw_ground, undercarriage
from flexopt.plotting.panels import draw_panel
from flexopt.plotting.shape import Shape, shape_at, spring_line, views
from flexopt.plotting.trajectory import deflection_panel, error_panel, title
from flexopt.simulation.trajectory import Trajectory

# Left, bottom, width and height, shares of the figure.
AxesPlace = tuple[float, float, float, float]
DPI, SIZE, SCENE = 100, (7.2, 4.6), (0.075, 0.11, 0.43, 0.77)
PANELS = ((0.605, 0.56, 0.365, 0.32), (0.605, 0.11, 0.365, 0.32))
# Share of the time for which each point of the machine is surely in the picture; a run that flies away leaves it.
USUAL = 0.97
# How far beside the undercarriage the wall is that springs lead to, a share of the machine's length.
WALL = 0.085


@dataclass(frozen=True)
class Film:
    """What is drawn: `frames` are rows of `skeleton`, shown for `delay` hundredths of a second each.

    Attributes:
        q: coordinates (K, n_q), deflections magnified;  base: placements (K, n_b).
        skeleton: at these (K, points, d), d = 2 in the plane, 3 in space;  anchor: where the ground point is at
            equilibrium (K, d).
        target: of the end-point (K, n_task).
    """

    trajectory: Trajectory
    time: Vector
    q: Vector
    base: Vector
    skeleton: Vector
    anchor: Vector
    target: Vector
    frames: NDArray[np.int64]
    delay: int
    caption: str


def usual(points: Vector, anchor: Vector, size: float) -> tuple[Vector, Vector]:
    """Least and greatest of points (K, points, 2), most of the time: not where a run flies away from the anchor."""
    center = anchor[:, None]
    ends = np.quantile(np.clip(points, center - 1.1 * size, center + 1.1 * size), [1 - USUAL, USUAL], axis=0)
    return ends[0].min(axis=0), ends[1].max(axis=0)


def _widest(t: Trajectory) -> int:
    """The passive coordinate shown: the hinge that turns most, or else the slide that moves most."""
    units = build_plant(t.model).graph.coordinate_units[: t.n_passive]
    size = np.nanmax(np.where(np.isfinite(t.deflection), np.abs(t.deflection), 0.0), axis=0)
    hinges = [k for k, unit in enumerate(units) if unit == "rad"]
    return max(hinges or range(t.n_passive), key=lambda k: float(size[k]))


class Shots(ABC):
    """What films have in common: panels beside the scene, each with a cursor, a clock, a background drawn once."""

    def __init__(self, film: Film, size: tuple[float, float]) -> None:
        self.film = film
        self.figure = Figure(figsize=size, dpi=DPI)
        self.canvas = FigureCanvasAgg(self.figure)
        # Of the clock: as many as tell the frames apart.
        steps = np.diff(film.time[film.frames])
        self.decimals = max(1, math.ceil(-math.log10(float(steps[steps > 0].min()))))

    def _finish(self, moving: list[Artist], clock: Text, places: Sequence[AxesPlace], top: float) -> None:
        """Draw what stays.

        Args:
            moving: what moves in the scene, in the order it is drawn.
            clock: text of the time.
            places: of the panels.
            top: where the title stands.
        """
        t = self.film.trajectory
        panels = error_panel(t), deflection_panel({"deflection": t}, _widest(t))
        self.clock, self.cursors = clock, list[tuple[Axes, Any]]()
        for place, panel in zip(places, panels, strict=True):
            axes = self.figure.add_axes(place)
            draw_panel(axes, panel)
            (cursor,) = axes.plot([], [], color=colors().text, linewidth=1.0, zorder=5)
            self.cursors.append((axes, cursor))
        self.cursors[-1][0].set_xlabel("time, s", fontsize=8)
        self.figure.text(0.5, top, title(t), fontsize=9.5, ha="center", va="top")
        self.moving: list[Artist] = [*moving, clock, *(cursor for _, cursor in self.cursors)]
        for artist in self.moving:
            artist.set_animated(True)
        self.canvas.draw()
        self.background: Any = self.canvas.copy_from_bbox(self.figure.bbox)

    def shot(self, k: int) -> NDArray[np.uint8]:
        """The picture at row k, (height, width, 3)."""
        self.canvas.restore_region(self.background)
        self._move(k)
        self.clock.set_text(f"t = {self.film.time[k]:.{self.decimals}f} s")
        for axes, cursor in self.cursors:
            cursor.set_data([self.film.time[k]] * 2, axes.get_ylim())
        for artist in self.moving:
            artist.draw(self.canvas.get_renderer())
        picture: Any = self.canvas.buffer_rgba()
        rgba: NDArray[np.uint8] = np.array(picture)
        return rgba[..., :3].copy()

    def _frame(self, axes: Axes, low: Vector, high: Vector, above: float, x: str, y: str, title: str) -> None:
        """A scene at one scale, in a frame that is filled: what is too narrow is given more, heights so much above."""
        frame = np.array(axes.get_position().size) * self.figure.get_size_inches()
        more = frame * np.max((high - low) / frame) - (high - low)
        low, high = low - more * [0.5, 1.0 - above], high + more * [0.5, above]
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        axes.set_xlabel(x, fontsize=8)
        axes.set_ylabel(y, fontsize=8)
        axes.tick_params(labelsize=7.5)
        axes.set_title(title, fontsize=8, pad=3)

    @abstractmethod
    def _move(self, k: int) -> None:
        """Put everything where it is in row k."""


class Stage(Shots):
    """The figure: what stays in it, and the artists that move."""

    def __init__(self, film: Film) -> None:
        super().__init__(film, SIZE)
        t = film.trajectory
        self.shapes = {int(k): shape_at(t.model, film.q[k], film.base[k]) for k in np.unique(film.frames)}
        first = self.shapes[int(film.frames[0])]
        (self.view,), self.length = views(first), first.size
        self.scene = self.figure.add_axes(SCENE)
        self._draw_scene(self.scene, first)
        bodies = film.skeleton.shape[1] - 1
        inks = colors()
        faces = [inks.undercarriage, inks.base, *[inks.present] * (bodies - 1)]
        self.bodies = PolyCollection([], facecolors=faces, edgecolors=inks.edge, linewidths=0.6, zorder=3)
        self.scene.add_collection(self.bodies, autolim=False)
        (self.springs,) = self.scene.plot([], [], color=inks.undercarriage, linewidth=1.0, zorder=2)
        (self.joints,) = self.scene.plot(
            [], [], "o", color=inks.page, markeredgecolor=inks.edge, markersize=4, zorder=4
        )
        (self.trace,) = self.scene.plot([], [], color=inks.chosen, linewidth=0.8, zorder=5)
        (self.target,) = self.scene.plot([], [], "+", color=inks.target, markersize=11, markeredgewidth=1.3, zorder=6)
        clock = self.scene.text(0.03, 0.965, "", transform=self.scene.transAxes, fontsize=9, va="top")
        moving: list[Artist] = [self.springs, self.bodies, self.joints, self.trace, self.target]
        self._finish(moving, clock, PANELS, 0.975)

    def _draw_scene(self, axes: Axes, first: Shape) -> None:
        """Ground, limits and labels; limits hold the machine's usual motion, not a run that flies away."""
        skeleton, anchor, length = self.film.skeleton, self.film.anchor[:, 0], self.length
        low, high = usual(skeleton, self.film.anchor, length)
        x, floor = first.foot
        box, _ = undercarriage(self.view, first)
        low = np.minimum(low, [float(anchor.min()) + box.x0 - x - WALL * length, floor]) - 0.06 * length
        high = np.maximum(high, [float(anchor.max()) + box.x1 - x + WALL * length, high[1]])
        high += np.array([0.06, 0.2]) * length
        draw_ground(axes, float(floor))
        self._frame(axes, low, high, 1.0, "x, m (inertial frame)", "y, m", self.film.caption)

    def _move(self, k: int) -> None:
        film, length = self.film, self.length

        def near(points: Vector) -> Vector:
            """Farther away than this nothing is in sight."""
            return np.clip(points, film.anchor[k] - 50 * length, film.anchor[k] + 50 * length)

        skeleton, points, (box, moved) = near(film.skeleton[k]), near(film.skeleton[: k + 1, -1]), self._stand(k)
        corners = near(moved.transform(box.corners()[[0, 2, 3, 1]]))
        self.bodies.set_verts([corners, *bars(skeleton.T)])
        self.joints.set_data(skeleton[1:-1, 0], skeleton[1:-1, 1])
        springs = near(self._springs(k))
        self.springs.set_data(springs[:, 0], springs[:, 1])
        self.trace.set_data(points[:, 0], points[:, 1])
        self.target.set_data(film.target[k, :1], film.target[k, 1:2])

    def _stand(self, k: int) -> tuple[Bbox, Affine2D]:
        return undercarriage(self.view, self.shapes[k])

    def _springs(self, k: int) -> Vector:
        """Two from below and one from the side, straight where the base does not give; from plates that stay put."""
        t, length, floor, (box, moved) = self.film.trajectory, self.length, self.shapes[k].foot[1], self._stand(k)
        free = t.coordinates[: t.n_passive]
        wide = 0.3 * SPRING * length
        upright = not {"base.y", "base.rotation"}.isdisjoint(free)
        gap = np.full((1, 2), np.nan)
        parts: list[Vector] = []
        for x in box.x0 + np.array([0.15, 0.85]) * box.width:
            parts += [spring_line(np.array([x, floor]), moved.transform((x, box.y0)), wide if upright else 0.0), gap]
        middle = (box.y0 + box.y1) / 2
        wall = np.array([box.x0 - WALL * length, middle])
        post = np.array([[wall[0], floor], [wall[0], box.y1]])
        parts += [post, gap, spring_line(wall, moved.transform((box.x0, middle)), wide if "base.x" in free else 0.0)]
        return np.concatenate(parts)
