"""Pages on paper: HTML printed to PDF by a browser that is installed, without a window and without the network.

In: a page's text. Out: the PDF's bytes, or one error that says what to install.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from abc import abstractmethod
from pathlib import Path

from flexopt.errors import FlexoptError, InputError
from flexopt.foundation.boundary import path, public
from flexopt.foundation.writing import write_file

# Browsers that print without a window, by the names of their programs.
NAMES = (
    "chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge", "microsoft-edge",
    "microsoft-edge-stable",
)  # fmt: skip
# Where systems put them that do not put them on the PATH.
MAC = tuple(
    f"/Applications/{name}.app/Contents/MacOS/{name}" for name in ("Google Chrome", "Chromium", "Microsoft Edge")
)
WINDOWS = ("Google/Chrome/Application/chrome.exe", "Microsoft/Edge/Application/msedge.exe")
LONGEST = 120.0  # s


def find_browser() -> str:
    """The program that prints.

    Raises:
        InputError: none is found.
    """
    found = next((path for path in map(shutil.which, NAMES) if path), None) or next(
        (str(path) for path in _places() if path.is_file()), None
    )
    if found is None:
        raise InputError(
            "a PDF needs a browser, and none is found: install Chromium, Google Chrome or Microsoft Edge "
            "(Debian: apt-get install chromium), or print the HTML page from any browser"
        )
    return found


def _places() -> list[Path]:
    if sys.platform == "darwin":
        return [Path(path) for path in MAC]
    if sys.platform == "win32":
        roots = [
            os.environ[name] for name in ("ProgramFiles", "ProgramFiles(x86)", "LocalAppData") if name in os.environ
        ]
        return [Path(root) / name for root in roots for name in WINDOWS]
    return []


def printed(html: str) -> bytes:
    """The page as PDF.

    Raises:
        InputError: there is no browser.
        FlexoptError: the browser printed nothing.
    """
    browser = find_browser()
    # Below the home, because browsers in packages of their own may not read the system's folder for temporary files.
    home = Path.home() if "/snap/" in os.path.realpath(browser) else None
    try:
        with tempfile.TemporaryDirectory(dir=home, ignore_cleanup_errors=True) as folder:
            data, why = _print(browser, html, Path(folder))
    except OSError as error:
        data, why = b"", str(error)
    if data.startswith(b"%PDF"):
        return data
    raise FlexoptError(f"{browser!r} printed no PDF ({why}); print the HTML page from a browser instead")


def _print(browser: str, html: str, folder: Path) -> tuple[bytes, str]:
    """What the browser printed, nothing where it did not, and how it ended."""
    page, paper = folder / "page.html", folder / "page.pdf"
    write_file(page, html)
    # Without this switch it does not start for the superuser, as in containers; the page is our own.
    alone = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
    command = [
        browser, "--headless", *alone, "--disable-gpu", "--no-first-run", "--no-pdf-header-footer",
        f"--user-data-dir={folder / 'profile'}", f"--print-to-pdf={paper}", page.as_uri(),
    ]  # fmt: skip
    try:
        done = subprocess.run(command, capture_output=True, timeout=LONGEST, check=False)
    except subprocess.TimeoutExpired:
        return b"", f"it took longer than {LONGEST:g} s"
    said = done.stderr.decode(errors="replace").strip().splitlines()
    why = f"exit code {done.returncode}{', ' + said[-1] if said else ''}"
    return paper.read_bytes() if paper.is_file() else b"", why


class Printed:
    """A result with a page."""

    @abstractmethod
    def _html(self) -> str:
        """The page, which needs no other file."""

    @public(path=path(".pdf"))
    def to_pdf(self, path: str | os.PathLike[str]) -> None:
        """Write the page as it is on paper, all folds open, through a browser that is installed.

        Args:
            path: file to write, `.pdf`.

        Raises:
            InputError: there is no browser; the message says what to install.
            FlexoptError: the browser printed nothing.
            WriteError: the file cannot be written.

        Example:
            >>> import contextlib
            >>> with contextlib.suppress(flexopt.InputError):  # where no browser is found
            ...     answer.to_pdf("verdict.pdf")
        """
        write_file(path, printed(self._html()))
