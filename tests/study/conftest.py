"""A browser for the tests of pages."""

from tests.browser import chromium, pytest_runtest_setup

__all__ = ["chromium", "pytest_runtest_setup"]
