"""Figures as files.

In: a figure and a path. Out: the file; its ending chooses the format.
"""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import io
import os
from pathlib import Path

from matplotlib.figure import Figure

from flexopt.foundation.writing import write_file


def write(figure: Figure, path: str | os.PathLike[str] | None, *, dpi: float = 200) -> None:
    """Write a figure where asked; the path's ending, which the boundary has checked, chooses the format."""
    if path is None:
        return
    buffer = io.BytesIO()
    figure.savefig(buffer, format=Path(path).suffix[1:].lower(), dpi=dpi)
    write_file(path, buffer.getvalue())
