"""`flexopt atlas`."""

from __future__ import annotations

from typing import Any

import click

from flexopt.cli.common import (
    CONTROL,
    GRAVITY,
    JSON,
    given,
    handing_out,
    numbers,
    of_picture,
    placement,
    read,
    value,
    wholes,
    working,
)
from flexopt.cli.completing import argument
from flexopt.foundation.escapes import of_option_list
from flexopt.model import load


@click.command("atlas", short_help="All robust postures over two joints: where w_i = 0.")
@argument("machine")
@CONTROL
@GRAVITY
@value("--joints", "A,B", "The two that vary, along x and y (the first two by default).", of_option_list)
@value("--posture", "A,…", "The joints that do not vary, rad (slides: m).", numbers)
@value("--base", "X[,Y,YAW]", "Placement, m and rad (0 by default): it moves the end-points.", placement)
@value("--x-range", "LO,HI", "Of the first that varies, rad or m; its limits or a whole turn by default.", numbers)
@value("--y-range", "LO,HI", "Of the second that varies, rad or m; its limits or a whole turn by default.", numbers)
@value("--cells", "N,M", "Of the grid on which curves are found (128,128): smaller loops may be missed.", wholes)
@value("--out", "FILE.nc|FILE.json", "Write all curves and points to a netCDF file, or the document as JSON.")
@of_picture("Draw the atlas: .png, .svg or .pdf.")
@JSON
def atlas_command(as_json: bool, machine: str, **options: Any) -> None:
    """All robust postures of MACHINE (a name or a file) over two of its joints.

    With two task rows curves w_i = 0, the points where two of them meet (w_i = w_j = 0), those where they end, singular
    postures, limits and the edge of the workspace; with three the points w_i = 0.
    """
    from flexopt.study import atlas  # noqa: PLC0415  (only this command needs it)

    hand_out = handing_out(options, ".nc", ".json", as_json=as_json)
    loaded = read(load, machine)
    with working(options, as_json):
        result = atlas(loaded, **given(options))
    hand_out(result)
