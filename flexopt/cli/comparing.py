"""`flexopt compare`: saved results beside each other."""

from __future__ import annotations

import click

from flexopt.cli.common import JSON, PICTURES, check_output, hand_out, value
from flexopt.cli.completing import argument


@click.command("compare", short_help="Saved results beside each other, as a table and a picture.")
@argument("results", nargs=-1, required=True)
@value("--plot", "PATH", "Draw every quantity, a dot for each result: .png, .svg or .pdf.")
@value("--out", "PATH", "Write the JSON document to a file, too.")
@JSON
def compare_command(as_json: bool, results: tuple[str, ...], plot: str | None, out: str | None) -> None:
    """RESULTS, two or more files of one kind, beside each other: JSON documents as --json prints them.

    Evaluations, selections, verdicts, runs and reports; first what they were asked differently.
    """
    from flexopt.study.comparison import compare_saved  # noqa: PLC0415  (only this command needs it)

    check_output("--plot", plot, PICTURES)
    check_output("--out", out, (".json",))
    hand_out(compare_saved(results), out, plot, as_json=as_json)
