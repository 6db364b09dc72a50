"""`flexopt check`."""

from __future__ import annotations

import sys

import click

from flexopt.cli.common import BAD_INPUT, JSON, tell
from flexopt.cli.completing import argument
from flexopt.selection.checking import check


@click.command("check", short_help="Faults of a file, and numbers that are hardly meant.")
@argument("file")
@JSON
def check_command(as_json: bool, file: str) -> None:
    """Every fault of FILE, and every number of its machine that is allowed but hardly meant: kN for N, mm for m.

    FILE is a machine, a problem, an experiment or a study (name or file), or a URDF or MJCF file. Ends with 2 where
    there are faults, with 0 where there are only warnings.
    """
    result = check(file)
    tell(result, as_json=as_json)
    if result.faults:
        sys.exit(BAD_INPUT)
