"""Which tests are long, and when they run.

`@pytest.mark.long` says it of a test, `@pytest.mark.long("report", "tutorial")` of these of its cases. They search by
another method, or do what others do for one machine more; each takes some seconds. Without options pytest leaves them
out; `--tests long` runs them alone, `--tests all` every test, as does a test's own address (`test_file.py::test_name`).
With `--part 2/4` only the second of four parts of the long ones is run, parted by what their addresses hash to. `.ci/run`
runs one part, which follows from the commit: all of them take longer than a check of every change may.
"""

from __future__ import annotations

import argparse
import re
from collections import defaultdict
from zlib import crc32

import pytest

# Of all tests that were collected, by address: cases that a mark names and that are not there.
ASTRAY = pytest.StashKey[dict[str, set[str]]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """The options."""
    text = "quick: all but the long ones (default); long: those alone; all: both"
    parser.addoption("--tests", choices=("quick", "long", "all"), default="quick", help=text)
    parser.addoption(
        "--part", type=part, default=(1, 1), metavar="K/N", help="of the long ones only the K-th of N parts"
    )


def part(text: str) -> tuple[int, int]:
    """Which part, of how many."""
    if (found := re.fullmatch(r"(\d+)/(\d+)", text)) and 1 <= int(found[1]) <= int(found[2]):
        return int(found[1]), int(found[2])
    raise argparse.ArgumentTypeError(f"{text!r} is not K/N with 1 ≤ K ≤ N")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out the half that is not asked for."""
    asked, by_address = config.getoption("tests"), any("::" in arg for arg in config.args)
    config.stash[ASTRAY] = {} if by_address else astray(items)
    if asked == "quick" and by_address:
        return
    this, parts = config.getoption("part")
    kept, left_out = list[pytest.Item](), list[pytest.Item]()
    for item in items:
        # An address is the same on every machine; Python's own hash is another in every process.
        runs = (
            asked != "quick" and crc32(item.nodeid.encode()) % parts == this - 1 if is_long(item) else asked != "long"
        )
        (kept if runs else left_out).append(item)
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        items[:] = kept


def is_long(item: pytest.Item) -> bool:
    """Whether a mark names the test, or its case."""
    mark = item.get_closest_marker("long")
    return mark is not None and (not mark.args or case_of(item) in mark.args)


def astray(items: list[pytest.Item]) -> dict[str, set[str]]:
    """Cases that marks name and that are not there, by test: none of that name would be left out."""
    found, named = defaultdict[str, set[str]](set), dict[str, set[str]]()
    for item in items:
        mark, test = item.get_closest_marker("long"), item.nodeid.partition("[")[0]
        found[test].add(case_of(item))
        if mark is not None:
            named[test] = set(mark.args)
    return {test: cases - found[test] for test, cases in named.items() if cases - found[test]}


def case_of(item: pytest.Item) -> str:
    """As in the test's address; empty where it has none."""
    return item.callspec.id if hasattr(item, "callspec") else ""
