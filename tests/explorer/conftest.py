"""A browser for the explorer's tests, and a folder for their pages."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.browser import chromium, pytest_runtest_setup

__all__ = ["chromium", "pytest_runtest_setup"]


@pytest.fixture(scope="session")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of pages."""
    return tmp_path_factory.mktemp("pages")
