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

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.writing import write_file


def write(call: str, figure: Figure, path: str | os.PathLike[str] | None, *, dpi: float = 200) -> None:
    """Write a figure where asked."""
    if path is None:
        return
    known = sorted(figure.canvas.get_supported_filetypes())
    suffix = Path(path).suffix[1:].lower()
    if suffix not in known:
        sentence = "must end in " + ", ".join(f".{each}" for each in known)
        raise_if_any(InputError, call, [Fault("path", sentence, os.fspath(path))])
    buffer = io.BytesIO()
    figure.savefig(buffer, format=suffix, dpi=dpi)
    write_file(path, buffer.getvalue())
