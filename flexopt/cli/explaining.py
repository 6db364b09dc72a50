"""`flexopt explain`."""

from __future__ import annotations

from typing import Any

import click

from flexopt.cli.common import JSON, OUT, given, handing_out, of_picture, read, working
from flexopt.cli.completing import argument
from flexopt.cli.judging import LOOP, real_loop
from flexopt.cli.postures import asked_posture, configuration
from flexopt.model import load


@click.command("explain", short_help="Why a posture is good or bad, and what to move which way.")
@argument("machine")
@configuration
@LOOP
@of_picture("Draw each mode's arrows and what to move: .png, .svg or .pdf.")
@OUT
@JSON
def explain_command(as_json: bool, machine: str, **options: Any) -> None:
    """Why a posture of MACHINE (a name or a file) is good or bad, mode by mode, and what to move and which way.

    For each mode its size |a||b|, the angle between a, how the end-point moves in it, and b, how feedback acts on it,
    its damping and, with a loop, the lag reserve; and what raises w most while the end-point stays.
    """
    from flexopt.study.explanation import explain  # noqa: PLC0415  (only this command needs it)

    hand_out = handing_out(options, ".json", as_json=as_json)
    loaded = read(load, machine)
    with working(options, as_json):
        loop = real_loop(loaded.loop, options.pop("loop"))
        posture = asked_posture("explain", loaded, options, loop)
        result = explain(loaded, posture, loop=loop, **given(options, "base", "control", "gravity"))
    hand_out(result)
