"""`python -m tests.wording [NAME…]` prints how snapshots differ; `--write` renews them."""

from __future__ import annotations

import argparse
import difflib
import sys

from tests.wording.commands import FOLDER, LINES, printed


def main() -> int:
    """Compare or renew; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tests.wording", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", choices=[[], *LINES])
    parser.add_argument("--write", action="store_true", help="renew the snapshots")
    given, differing = parser.parse_args(), 0
    for name in given.names or LINES:
        path, now = FOLDER / f"{name}.txt", printed(name)
        if given.write:
            path.write_text(now, encoding="utf-8")
            continue
        before = path.read_text(encoding="utf-8") if path.exists() else ""
        differing += before != now
        sys.stdout.writelines(difflib.unified_diff(before.splitlines(True), now.splitlines(True), str(path), "now"))
    return int(bool(differing))


sys.exit(main())
