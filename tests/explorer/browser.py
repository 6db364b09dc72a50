"""The explorer's page in Chromium, as the tests and the benchmark drive it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Page

import flexopt
from flexopt.explorer.exploring import Explorer
from flexopt.model import AnyMachine
from tests.browser import page_of

POSTURE = [1.0, -2.0]


@cache
def explored(name: str) -> tuple[AnyMachine, Explorer]:
    """A shipped machine and its page, at a posture that suits it."""
    machine = flexopt.load(name)
    return machine, flexopt.explore(machine, POSTURE if name == "excavator" else None)


@contextmanager
def opened(browser: Browser, explorer: Explorer, folder: Path, **context: Any) -> Iterator[Page]:
    """The page of a machine, computed and drawn for the first time; errors and requests of any host fail."""
    path = folder / f"{explorer.machine}.html"
    explorer.save(path)
    with page_of(browser, path, **context) as page:
        page.wait_for_function("window.explorer && explorer.log.first !== undefined")
        yield page


def drag(page: Page, handle: str, dx: float, dy: float, steps: int = 8) -> None:
    """Drag a handle by some pixels with the mouse."""
    button = page.locator(handle).first
    button.scroll_into_view_if_needed()
    box = button.bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + dx, y + dy, steps=steps)
    settled(page)
    page.mouse.up()
    settled(page)


def settled(page: Page) -> None:
    """Wait until what was asked for is computed and drawn."""
    page.wait_for_function("!explorer.pull && !explorer.changed")
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


def state(page: Page) -> dict[str, Any]:
    """Configuration and numbers as the page has them."""
    return page.evaluate(
        """() => ({
          base: [...explorer.base], posture: [...explorer.posture], target: [...explorer.target],
          modes: explorer.modes, decay: explorer.verdict?.decay, note: explorer.note, scale: explorer.views[0].scale,
          word: document.body.dataset.word, text: document.getElementById("verdict").textContent,
        })"""
    )
