"""A verification as one JSON file and one HTML page that needs no other.

In: a `Verification`. Out: text.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from flexopt.export.verify.checks import Check, Table
from flexopt.foundation.escapes import markup

if TYPE_CHECKING:
    from flexopt.export.verify.verification import Verification

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1080px; margin: 2em auto; padding: 0 1em; color: #1d2126; }
h1 { font-size: 1.5em } h2 { font-size: 1.2em; margin-top: 2em; border-bottom: 1px solid #d5d9de } h3 { font-size: 1em }
table { border-collapse: collapse; margin: 0.6em 0 1.4em; font-size: 0.9em }
th, td { padding: 0.25em 0.7em; border-bottom: 1px solid #e3e6ea; text-align: left; vertical-align: top }
td.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap }
.passed { color: #1b7a4b; font-weight: 600 } .failed { color: #b3261e; font-weight: 600 }
.not { color: #8a5a00; font-weight: 600 }
"""


def report_html(result: Verification) -> str:
    """The page."""
    title = f"Verification of {result.machine} ({result.real})"
    body = [
        f"<h1>{markup(title)}</h1>",
        f"<p>{markup(result.sentence)}</p>",
        f"<p>Bundle sha256 {result.bundle_sha256}.</p>",
        *(f"<p class=not>Not verified: {markup(line)}</p>" for line in result.not_verified),
        "<h2>Checks</h2>",
        _summary(result.checks),
        *(_details(check) for check in result.checks if check.tables),
        "<h2>Tools</h2>",
        _grid(("tool", "version"), tuple(result.tools.items())),
    ]
    head = f'<meta charset="utf-8"><title>{markup(title)}</title><style>{_STYLE}</style>'
    return f'<!doctype html>\n<html lang="en"><head>{head}</head><body>\n' + "\n".join(body) + "\n</body></html>\n"


def _summary(checks: tuple[Check, ...]) -> str:
    rows = "\n".join(
        f"<tr><td>{c.target}</td><td>{markup(c.name)}</td><td class={c.state.split()[0]}>{c.state}</td>"
        f"<td>{markup(c.finding)}</td></tr>"
        for c in checks
    )
    return f"<table><tr><th>target</th><th>check</th><th>state</th><th>finding</th></tr>\n{rows}\n</table>"


def _details(check: Check) -> str:
    head = f"<h2>{check.target}: {markup(check.name)}</h2>"
    return head + "".join(f"<h3>{markup(t.title)}</h3>{_table(t)}" for t in check.tables)


def _table(table: Table) -> str:
    return _grid(table.header, table.rows)


def _grid(header: tuple[str, ...], rows: tuple[tuple[Any, ...], ...]) -> str:
    head = "".join(f"<th>{markup(name)}</th>" for name in header)
    lines = "\n".join("<tr>" + "".join(_cell(value) for value in row) + "</tr>" for row in rows)
    return f"<table><tr>{head}</tr>\n{lines}\n</table>"


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return f"<td class=number>{value:.2e}</td>"
    if isinstance(value, int):
        return f"<td class=number>{value:,}</td>"
    return f"<td>{markup(str(value))}</td>"
