"""The system's Chromium, driven by Playwright, as tests and benchmarks use it; `apt-get install chromium`.

A test that uses it says so by `needs("chromium")`; it is skipped where that is missing. CI accepts no skipped test.
The one conftest of all tests imports the fixture and the hook from here: a process takes one of these browsers.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page


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


@contextmanager
def browser_of() -> Iterator[Browser]:
    """The system's Chromium, without a window."""
    from playwright.sync_api import sync_playwright  # noqa: PLC0415  (most tests use no browser)

    with sync_playwright() as tool:
        # As root it runs only without its sandbox.
        browser = tool.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def page_of(browser: Browser, path: Path, **context: Any) -> Iterator[Page]:
    """A page from a file; errors in it and requests of any host fail."""
    wrong = list[str]()
    place = browser.new_context(**{"viewport": {"width": 1280, "height": 1000}, "offline": True} | context)
    # Machines that test may be busy; what hangs still ends.
    place.set_default_timeout(120_000)
    page = place.new_page()
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("console", lambda line: wrong.append(line.text) if line.type == "error" else None)
    page.on("request", lambda request: wrong.append(request.url) if not request.url.startswith("file:") else None)
    page.goto(path.as_uri())
    yield page
    place.close()
    assert wrong == []


# Of each table that is shown: how far it and its box reach, px, whether its box scrolls, and whether there is more of it.
_TABLES = """[...document.querySelectorAll("table")].filter((each) => each.checkVisibility()).map((each) => {
  const box = each.closest(".scroll"), right = (one) => one.getBoundingClientRect().right;
  return { table: right(each), box: box && right(box), scrolls: box && getComputedStyle(box).overflowX === "auto",
    more: box && box.scrollWidth > box.clientWidth };
})"""


def wide_tables(page: Page, width: int) -> int:
    """How many tables scroll inside their boxes; none of them, and nothing else, makes the page wider than `width`."""
    assert page.evaluate("document.documentElement.scrollWidth") <= page.evaluate(
        "document.documentElement.clientWidth"
    )
    found = page.evaluate(_TABLES)
    assert found
    for each in found:
        if each["box"] is None:
            assert each["table"] <= width + 1
        else:
            assert each["box"] <= width + 1
            assert each["scrolls"] or not each["more"]
    return sum(bool(each["more"]) for each in found)


def on_paper(page: Page, width: int) -> None:
    """No table is cut off at the side of a sheet that is `width` px wide."""
    page.emulate_media(media="print")
    found = page.evaluate(_TABLES)
    assert found
    assert max(each["table"] for each in found) <= width + 1
