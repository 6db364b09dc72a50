"""A run as a moving picture.

In: a trajectory. Out: a `.gif`, or a `.html` that needs nothing else. Frames are drawn over a background that stays.
"""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import base64
import io
import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor

from flexopt.foundation.arguments import Arguments
from flexopt.foundation.boundary import instance, number, path, public
from flexopt.foundation.palette import PALETTES, Palette, Theme
from flexopt.foundation.pictures import draws
from flexopt.foundation.rendering import render
from flexopt.foundation.writing import check_place, write_file
from flexopt.plotting.sheet import styled
from flexopt.plotting.stage import Film, Stage
from flexopt.plotting.stage_space import SpaceStage
from flexopt.simulation.trajectory import Trajectory

FRAMES_MAX = 250
SHORTEST_FRAME = 4  # hundredths of a second, in which GIF counts: 25 frames a second
FILM = (0.2, 600.0)  # s
TRACE_POINTS = 4000
# What is so near to the ground's colour, of 255, is it.
COLORS, NEAR = 64, 8
TRANSPARENT = COLORS  # the palette's next entry


def _lasts(arguments: Arguments, given: Mapping[str, Any]) -> None:
    """The film must be neither too short nor too long."""
    trajectory, rate = given["trajectory"], given["speed"]
    if trajectory is None or rate is None:
        return
    alive = _alive(trajectory)
    seconds = float(trajectory.time[alive[-1]]) / rate if alive.size else 0.0
    if not FILM[0] <= seconds <= FILM[1]:
        lasts = f"the film would last {seconds:.3g} s; it must last {FILM[0]:g} to {FILM[1]:g} s"
        if seconds > 0:
            lasts += f", so speed must lie between {seconds * rate / FILM[1]:.3g} and {seconds * rate / FILM[0]:.3g}"
        arguments.note("speed", lasts, rate)


def _alive(trajectory: Trajectory) -> NDArray[np.int64]:
    """Samples whose numbers are finite."""
    return np.flatnonzero(np.all(np.isfinite(trajectory.q), axis=1))


@draws("Trajectory", "film")
@public(
    trajectory=instance(Trajectory, "a Trajectory, from flexopt.simulate for example"),
    path=path(".gif", ".html"),
    speed=number("", above=0.0, high=1e9),
    magnify=number("", low=0.0, high=1e6),
    together=_lasts,
)
def animate_trajectory(
    trajectory: Trajectory,
    path: str | os.PathLike[str],
    *,
    speed: float = 1.0,
    magnify: float = 1.0,
    theme: Theme = "light",
) -> None:
    """Write a run as a film of at most 250 frames, 25 a second where that suffices; fewer a second in longer films.

    Passive coordinates are drawn at equilibrium + `magnify` · deflection, and with them the arm and its end-point. A
    run that diverges ends with its last number.

    Args:
        trajectory: from `flexopt.simulate`.
        path: file to write, `.gif` or `.html` (one file with a slider, opens without a network).
        speed: of the film, relative to the machine.
        magnify: factor on the deflections of the passive coordinates.
        theme: `"light"` or `"dark"` ground.

    Raises:
        InputError: arguments are not usable, all faults in one message.
        WriteError: the file cannot be written.
    """
    check_place(path)
    alive = _alive(trajectory)
    film = _film(trajectory, alive, float(trajectory.time[alive[-1]]) / speed, speed, magnify)
    with styled(theme) as inks:
        images = list(_frames(film, inks))
    if Path(path).suffix.lower() == ".gif":
        buffer, (still, *others) = io.BytesIO(), images
        still.save(buffer, "GIF", save_all=True, append_images=others, duration=10 * film.delay, loop=0, optimize=True)
        write_file(path, buffer.getvalue())
    else:
        write_file(path, _page(film, images, theme))


def _film(t: Trajectory, alive: NDArray[np.int64], seconds: float, rate: float, factor: float) -> Film:
    every = max(1, len(alive) // TRACE_POINTS)
    delay = max(SHORTEST_FRAME, math.ceil(100 * seconds / FRAMES_MAX - 1e-9))
    count = max(2, math.floor(100 * seconds / delay + 1e-9))
    shots = np.searchsorted(t.time[alive], rate * delay / 100 * np.arange(count) - 1e-9).clip(0, len(alive) - 1)
    kept = np.unique(np.concatenate([np.arange(0, len(alive), every), shots]))
    rows = alive[kept]
    q, base, deflection = t.q[rows].copy(), t.base[rows], t.deflection[rows]
    q[:, : t.n_passive] -= deflection
    anchor = t.skeletons(q, base)[:, 0]
    q[:, : t.n_passive] += factor * deflection
    caption = f"speed × {rate:g}; deflections " + ("in true size" if factor == 1 else f"× {factor:g}")
    skeleton = t.skeletons(q, base)
    frames = np.searchsorted(kept, shots)
    return Film(t, t.time[rows], q, base, skeleton, anchor, t.target[rows], frames, delay, caption)


def _frames(film: Film, inks: Palette) -> Iterator[Image.Image]:
    """The frames, with one palette for all, in which the ground is what it is."""
    stage = Stage(film) if film.skeleton.shape[2] == 2 else SpaceStage(film)

    def shot(k: int) -> Image.Image:
        return Image.fromarray(stage.shot(k))

    palette = shot(int(film.frames[-1])).quantize(COLORS, dither=Image.Dither.NONE)
    levels = np.reshape(palette.getpalette() or [], (-1, 3))
    ground = np.array(ImageColor.getrgb(inks.page))
    levels[np.abs(levels - ground).max(axis=1) < NEAR] = ground
    palette.putpalette(levels.ravel().tolist())
    for k in film.frames:
        yield shot(int(k)).quantize(palette=palette, dither=Image.Dither.NONE)


def _page(film: Film, images: list[Image.Image], theme: Theme) -> str:
    """A page with a player: the first frame, and of each frame the pixels that differ from it."""
    first = np.asarray(images[0])
    overlays: list[str] = []
    for image in images:
        pixels = np.asarray(image)
        overlay = Image.fromarray(np.where(pixels == first, TRANSPARENT, pixels).astype(np.uint8), "P")
        overlay.putpalette([*(image.getpalette() or [])[: 3 * COLORS], 255, 255, 255])
        overlays.append(_data_url(overlay, transparency=TRANSPARENT))
    return render(
        "plotting/player.html",
        title=f"{film.trajectory.machine}, {film.caption}",
        still=_data_url(images[0]),
        frames=overlays,
        delay=10 * film.delay,
        theme=theme,
        inks=PALETTES[theme],
    )


def _data_url(image: Image.Image, **options: Any) -> str:
    stream = io.BytesIO()
    image.save(stream, "PNG", optimize=False, **options)
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode("ascii")
