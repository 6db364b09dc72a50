"""`flexopt identify`."""

from __future__ import annotations

from itertools import chain
from typing import Any

import click

from flexopt.cli.common import (
    BASE,
    GRAVITY,
    JSON,
    OUT,
    given,
    handing_out,
    numbers,
    of_picture,
    read,
    value,
    working,
)
from flexopt.cli.completing import argument
from flexopt.foundation.escapes import of_option_list
from flexopt.model import load


@click.command("identify", short_help="Springs, dampers and load from a log of how the machine swings.")
@argument("machine")
@argument("log")
@value("--posture", "A,B,…", "How the arm is held, rad (slides: m); by default where the log's joints stand.", numbers)
@BASE
@value(
    "--unknown", "NAMES", "What is not known: stiffness,damping (the default), payload.mass and so on.", of_option_list,
    multiple=True,
)  # fmt: skip
@value("--window", "FROM,TO", "Part of the log, s; by default all after the arm's last motion.", numbers)
@value(
    "--imu",
    "X,Y[,Z]",
    "Where the accelerometer sits on the body that carries the arm, m, from its springs' point (there by default).",
    numbers,
)
@GRAVITY
@of_picture("Draw log, fit and residuals: .png, .svg or .pdf.")
@OUT
@JSON
def identify_command(as_json: bool, machine: str, log: str, **options: Any) -> None:
    """Springs, dampers and load of MACHINE (a name or a file) from LOG: a CSV file of a free swing, the arm held.

    Its first line names the columns: t [s] and some of gyro_x [rad/s], base.pitch [deg], end_point.x [mm], acc_x [g],
    joints such as boom [rad]; the page "Unknown ground" has the table.
    """
    from flexopt.identification import identify  # noqa: PLC0415  (only this command needs it)

    hand_out = handing_out(options, ".json", as_json=as_json)
    loaded = read(load, machine)
    options["unknown"] = [*chain.from_iterable(options["unknown"])] or None
    with working(options, as_json, "stages") as progress:
        result = identify(loaded, log, progress=progress, **given(options))
    hand_out(result)
