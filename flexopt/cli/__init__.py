"""The command `flexopt`: evaluate, select, verdict, simulate, map, study, explore, report, export and others.

In: options as text. Out: a result as text or, with `--json`, one JSON document on standard output; progress and errors
go to standard error. Exit codes: 0 success, 2 bad input, 3 a solve that did not converge or a check that failed.
"""

from __future__ import annotations

import atexit
import gc
import os


def main(arguments: list[str] | None = None) -> None:
    """Entry point of the `flexopt` command."""
    # What a command imports and builds lives as long as it does: to search it for garbage takes a tenth of its start.
    gc.set_threshold(100_000)
    # Nor at the end, where the system takes all of it back.
    atexit.register(gc.freeze)
    # To look for plugins of pydantic, which have no say in our files, is to read what every installed package tells.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    from flexopt.cli.commands import run  # noqa: PLC0415

    run(arguments)
