"""`flexopt compare`: saved results beside each other."""

from __future__ import annotations

from typing import Any

import click

from flexopt.cli.common import JSON, OUT, handing_out, of_picture
from flexopt.cli.completing import argument


@click.command("compare", short_help="Saved results beside each other, as a table and a picture.")
@argument("results", nargs=-1, required=True)
@of_picture("Draw each quantity in one unit, a ring for each result: .png, .svg or .pdf.")
@OUT
@JSON
def compare_command(as_json: bool, results: tuple[str, ...], **options: Any) -> None:
    """RESULTS, two or more files of one kind, beside each other: JSON documents as --json prints them.

    Evaluations, selections, verdicts, runs and reports; first what they were asked differently.
    """
    from flexopt.study.comparison import compare_saved  # noqa: PLC0415  (only this command needs it)

    hand_out = handing_out(options, ".json", as_json=as_json)
    hand_out(compare_saved(results))
