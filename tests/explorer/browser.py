"""Chromium as the tests and the benchmark drive it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Page, sync_playwright

import flexopt
from flexopt.explorer.exploring import Explorer
from flexopt.model import AnyMachine

POSTURE = [1.0, -2.0]


@cache
def explored(name: str) -> tuple[AnyMachine, Explorer]:
    """A shipped machine and its page, at a posture that suits it."""
    machine = flexopt.load(name)
    return machine, flexopt.explore(machine, POSTURE if name == "excavator" else None)


@contextmanager
def browser_of() -> Iterator[Browser]:
    """The system's Chromium, without a window."""
    with sync_playwright() as tool:
        # As root it runs only without its sandbox.
        browser = tool.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def opened(browser: Browser, explorer: Explorer, folder: Path, **context: Any) -> Iterator[Page]:
    """The page of a machine, computed and drawn for the first time; errors and requests of any host fail."""
    path, wrong = folder / f"{explorer.machine}.html", list[str]()
    explorer.save(path)
    options = {"viewport": {"width": 1280, "height": 1000}, "offline": True} | context
    place = browser.new_context(**options)
    page = place.new_page()
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("console", lambda line: wrong.append(line.text) if line.type == "error" else None)
    page.on("request", lambda request: wrong.append(request.url) if not request.url.startswith("file:") else None)
    page.goto(path.as_uri())
    page.wait_for_function("window.explorer && explorer.log.first !== undefined")
    yield page
    place.close()
    assert wrong == []


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
