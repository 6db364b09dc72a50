"""Pieces of an HTML page that needs no other file.

In: text, numbers and figures. Out: HTML.
"""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexopt.foundation import writing
from flexopt.foundation.escapes import markup
from flexopt.foundation.writing import make_folder

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1080px; margin: 2em auto; padding: 0 1em; color: #1d2126; }
h1 { font-size: 1.5em } h2 { font-size: 1.2em; margin-top: 2em; border-bottom: 1px solid #d5d9de }
table { border-collapse: collapse; margin: 1em 0; font-size: 0.9em }
th, td { padding: 0.25em 0.7em; border-bottom: 1px solid #e3e6ea; text-align: left; vertical-align: top }
td.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap }
.holds { color: #1b7a4b; font-weight: 600 } .fails { color: #b3261e; font-weight: 600 }
figure { margin: 1em 0 } img { max-width: 100%; height: auto } figcaption { font-size: 0.9em; color: #4a5058 }
footer { margin-top: 3em; font-size: 0.8em; color: #6b7178; overflow-wrap: anywhere }
"""


def page(title: str, body: Iterable[str], provenance: Any) -> str:
    """A whole page; the provenance goes to its foot."""
    head = f'<meta charset="utf-8"><title>{markup(title)}</title><style>{STYLE}</style>'
    lines = [f"<h1>{markup(title)}</h1>", *body, f"<footer>{markup(json.dumps(provenance))}</footer>"]
    return f'<!doctype html>\n<html lang="en"><head>{head}</head><body>\n' + "\n".join(lines) + "\n</body></html>\n"


def paragraph(text: str) -> str:
    """A paragraph; nothing where there is no text."""
    return f"<p>{markup(text)}</p>" if text else ""


def heading(text: str) -> str:
    """The heading of a section."""
    return f"<h2>{markup(text)}</h2>"


def picture(figure: Figure, caption: str) -> str:
    """A figure with its caption, the picture inside."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)  # pyright: ignore[reportUnknownMemberType]
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    text = markup(caption)
    return f'<figure><img alt="{text}" src="data:image/png;base64,{data}"><figcaption>{text}</figcaption></figure>'


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; cells that read as numbers are set right."""

    def cell(text: str) -> str:
        number = text[:1] in tuple("+-−0123456789–") and len(text) < 32
        return f"<td{' class=number' if number else ''}>{markup(text)}</td>"

    head = "".join(f"<th>{markup(name)}</th>" for name in header)
    lines = "\n".join("<tr>" + "".join(cell(text) for text in row) + "</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>\n{lines}\n</tbody></table>"


def write_files(folder: Path, text: str, document: dict[str, Any]) -> tuple[Path, Path]:
    """Write `report.html` and `report.json` into `folder`, made if missing."""
    web, data = make_folder(folder) / "report.html", folder / "report.json"
    writing.write_files({data: json.dumps(document, indent=2, allow_nan=False) + "\n", web: text})
    return web, data
