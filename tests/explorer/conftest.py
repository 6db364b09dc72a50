"""A browser for the explorer's tests: Debian's Chromium, driven by Playwright; `apt-get install chromium`.

A test that uses it says so by `needs("chromium")`; it is skipped where that is missing. CI accepts no skipped test.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser

from tests.explorer.browser import browser_of


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skips where a program that the test names is missing."""
    names = {str(name) for mark in item.iter_markers("needs") for name in mark.args}
    missing = sorted(name for name in names if shutil.which(name) is None)
    if missing:
        pytest.skip(f"install {' '.join(missing)}")


@pytest.fixture(scope="session")
def chromium() -> Iterator[Browser]:
    """One browser for all tests of a process."""
    with browser_of() as browser:
        yield browser


@pytest.fixture(scope="session")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of pages."""
    return tmp_path_factory.mktemp("pages")
