"""What HTML reports share: figures as data of their templates, and both files of a report.

In: figures, a template with its values. Out: HTML that needs no other file.
"""

from __future__ import annotations

import base64
import io
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from flexopt.foundation import writing
from flexopt.foundation.writing import make_folder

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from flexopt.simulation import Trajectory

# Names of columns and rows of text, as `pieces.html` draws them; None where there is nothing to show.
Table = tuple[Sequence[str], Sequence[Sequence[str]]] | None


# Inches from which a picture scrolls where the page is narrow, in place of becoming too small to read.
WIDE = 7.0


class Picture(NamedTuple):
    """A figure in a page: PNG in Base64, its caption, and whether it is wide."""

    data: str
    caption: str
    wide: bool


def picture(figure: Figure, caption: str) -> Picture:
    """A figure with its caption."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)  # pyright: ignore[reportUnknownMemberType]
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    return Picture(data, caption, bool(figure.get_figwidth() > WIDE))


def run_figures(runs: Mapping[str, Trajectory]) -> dict[str, Figure]:
    """Pictures of closed loops by name: `loops` of several side by side, and each as `run …`."""
    from flexopt.plotting import plot_trajectories  # noqa: PLC0415  (matplotlib is slow to import)

    together = {"loops": plot_trajectories(runs)} if len(runs) > 1 else {}
    return together | {f"run {name}": run.plot() for name, run in runs.items()}


def begun(text: str) -> str:
    """Text with a capital at its beginning."""
    return text[:1].upper() + text[1:]


def number(value: float | None, digits: int = 5) -> str:
    """A number in a page; – where there is none."""
    if value is None or not math.isfinite(value):
        return "–"
    return f"{value:.{digits}g}".replace("-", "−")


def write_files(folder: Path, text: str, document: dict[str, Any]) -> tuple[Path, Path]:
    """Write `report.html` and `report.json` into `folder`, made if missing."""
    web, data = make_folder(folder) / "report.html", folder / "report.json"
    writing.write_files({data: json.dumps(document, indent=2, allow_nan=False) + "\n", web: text})
    return web, data
