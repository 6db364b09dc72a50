"""Which tests are long, and when they run.

`@pytest.mark.long` says it of a test, `@pytest.mark.long("report", "tutorial")` of these of its cases. They search by
another method, or do what others do for one machine more; each takes some seconds. Without options pytest leaves them
out; `--tests long` runs them alone, `--tests all` every test, as does a test's own address (`test_file.py::test_name`).
`.ci/run` runs both halves.
"""

from __future__ import annotations

from collections import defaultdict

import pytest

# Of all tests that were collected, by address: cases that a mark names and that are not there.
ASTRAY = pytest.StashKey[dict[str, set[str]]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """The option."""
    text = "quick: all but the long ones (default); long: those alone; all: both"
    parser.addoption("--tests", choices=("quick", "long", "all"), default="quick", help=text)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out the half that is not asked for."""
    asked, by_address = config.getoption("tests"), any("::" in arg for arg in config.args)
    config.stash[ASTRAY] = {} if by_address else astray(items)
    if asked == "all" or (asked == "quick" and by_address):
        return
    kept, left_out = list[pytest.Item](), list[pytest.Item]()
    for item in items:
        (kept if is_long(item) == (asked == "long") else left_out).append(item)
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
