"""What HTML reports share: figures as data of their templates, and both files of a report.

In: figures, a template with its values. Out: HTML that needs no other file.
"""

from __future__ import annotations

import base64
import io
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from flexopt.foundation import writing
from flexopt.foundation.palette import Theme
from flexopt.foundation.writing import make_folder

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL import Image

    from flexopt.simulation import Trajectory

# Names of columns, `OfNumbers` where they hold these, and rows of text, as `pieces.html` draws them; None where there
# is nothing to show.
PageTable = tuple[Sequence[str], Sequence[Sequence[str]]] | None


# Inches from which a picture scrolls where the page is narrow, in place of becoming too small to read.
WIDE = 7.0
# Colours of a picture in a page; none of its points is off by more than a few parts in 255.
COLOURS = 256
DOTS = 110  # per inch
# Of zlib: the greatest takes three times as long and saves 1 to 2 %.
COMPRESSION = 8
# A hyphen that stands for a minus: before a number, of no word and no other number before it; or in an exponent.
MINUS = re.compile(r"(?<![\w.)\]-])-(?=\.?\d)|(?<=\de)-(?=\d)")
# Coordinates below it are where a search came to rest beside 0, m or rad.
NEAR_ZERO = 1e-7


class Picture(NamedTuple):
    """A figure in a page: PNG in Base64 on either ground, its caption, and whether it is wide."""

    light: str
    dark: str
    caption: str
    wide: bool


def picture(draw: Callable[[Theme], Figure], caption: str) -> Picture:
    """A figure with its caption."""
    return pictures(lambda theme: {caption: draw(theme)})[caption]


def pictures(draw: Callable[[Theme], Mapping[str, Figure]]) -> dict[str, Picture]:
    """Figures by name, which are their captions, too."""
    light, dark = draw("light"), draw("dark")
    return {name: _on_both(figure, dark[name], name) for name, figure in light.items()}


def _on_both(light: Figure, dark: Figure, name: str) -> Picture:
    """A picture of two figures that differ in nothing but colours: what is found out for one serves both."""
    from flexopt.plotting.sheet import placed_as  # noqa: PLC0415  (matplotlib is slow to import)

    drawn = _png(light)
    placed_as(dark, light)
    return Picture(drawn, _png(dark), name, light.get_figwidth() > WIDE)


def _png(figure: Figure) -> str:
    """As PNG in Base64, in so few colours that both grounds take less room than one does in all of them."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415  (which only pages need)
    from PIL import Image  # noqa: PLC0415

    figure.set_dpi(DOTS)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    written = io.BytesIO()
    points = few_colours(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]))
    points.save(written, "PNG", compress_level=COMPRESSION)
    return base64.b64encode(written.getvalue()).decode("ascii")


def few_colours(full: Image.Image) -> Image.Image:
    """A picture with a palette: of Pillow's ways to choose one that which keeps rare colours, those of thin lines."""
    from PIL import Image  # noqa: PLC0415

    return full.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)


def run_figures(runs: Mapping[str, Trajectory], *, theme: Theme = "light") -> dict[str, Figure]:
    """Pictures of closed loops by name: `loops` of several side by side, and each as `run …`."""
    from flexopt.plotting import plot_trajectories  # noqa: PLC0415  (matplotlib is slow to import)

    together = {"loops": plot_trajectories(runs, theme=theme)} if len(runs) > 1 else {}
    return together | {f"run {name}": run.plot(theme=theme) for name, run in runs.items()}


def begun(text: str) -> str:
    """Text with a capital at its beginning."""
    return text[:1].upper() + text[1:]


def with_minus(text: str) -> str:
    """Text with the minus sign before its negative numbers and exponents, in place of the hyphen."""
    return MINUS.sub("−", text)


def sentence(text: str) -> str:
    """A clause as a sentence of a page; empty where there is none."""
    return text and f"{begun(with_minus(text))}."


def number(value: float | None, digits: int = 5) -> str:
    """A number in a page; – where there is none."""
    if value is None or not math.isfinite(value):
        return "–"
    return with_minus(f"{value + 0.0:.{digits}g}")  # −0.0 is 0


def coordinate(value: float, digits: int = 5) -> str:
    """A coordinate, m or rad, in a page: 0 where nobody could tell it from that."""
    return number(value if abs(value) > NEAR_ZERO else 0.0, digits)


def write_files(folder: Path, text: str, document: dict[str, Any]) -> tuple[Path, Path]:
    """Write `report.html` and `report.json` into `folder`, made if missing."""
    web, data = make_folder(folder) / "report.html", folder / "report.json"
    writing.write_files({data: json.dumps(document, indent=2, allow_nan=False) + "\n", web: text})
    return web, data
