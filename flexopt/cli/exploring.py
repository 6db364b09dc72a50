"""`flexopt explore`."""

from __future__ import annotations

from typing import Any

import click

from flexopt.cli.common import (
    BASE,
    CONTROL,
    GRAVITY,
    JSON,
    check_output,
    given,
    numbers,
    read,
    tell,
    value,
    whole,
    working,
    write_output,
)
from flexopt.cli.judging import LOOP, real_loop
from flexopt.foundation.writing import write_file
from flexopt.model import Problem, load_any

PAGE = "flexopt-explorer.html"


@click.command("explore", short_help="One page to move a machine on, in any browser.")
@click.argument("machine")
@value("--posture", "A,B,…", "Of a machine: how it is held at first, rad (slides: m).", numbers)
@BASE
@CONTROL
@GRAVITY
@LOOP
@value("--target", "K", "Of a problem of several targets: which one is shown, from 1 on (1 by default).", whole)
@value("--out", "FILE.html", f"The page ({PAGE} by default).")
@JSON
def explore_command(as_json: bool, machine: str, out: str | None, **options: Any) -> None:
    """Write a page on which MACHINE (a name or a file of a machine or problem) is moved with the mouse.

    End-point and base can be dragged; modes, w_i, a map of them and how fast the loop decays follow. The browser
    computes it all, without network or server. Of a problem the configuration that is best by its objective is
    computed and shown, too; of several targets (end_points) the placement for all, held as for one. A problem with a
    path is refused.
    """
    from flexopt.explorer import explore  # noqa: PLC0415  (only this command needs it)

    path = out or PAGE
    check_output("--out", path, (".html",))
    loaded = read(load_any, machine)
    own = loaded.loop or loaded.loaded_machine.loop if isinstance(loaded, Problem) else loaded.loop
    with working(options, True, "starts") as progress:
        result = explore(loaded, loop=real_loop(own, options.pop("loop")), progress=progress, **given(options))
    write_output("--out", path, lambda: write_file(path, result.page))
    tell(result, f"\n\npage: {path}", as_json=as_json)
