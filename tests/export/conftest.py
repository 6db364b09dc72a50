"""What the tests of the C bundle need: compilers, an emulator, an analyser. A test asks for those that it uses.

A test that uses a program says so by `needs("gcc", "make")` as a mark; it is skipped where one of them is missing, and
no other test is. On Debian and Ubuntu all of them come with
    apt-get install gcc g++ clang make cmake binutils cppcheck gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm
The project's own CI installs them and accepts no skipped test.
"""

from __future__ import annotations

import shutil

import pytest

from tests.export.programs import PACKAGES


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skips where a program that the test names is missing, naming it and its package."""
    names = dict.fromkeys(str(name) for mark in item.iter_markers("needs") for name in mark.args)
    missing = {name: PACKAGES[name] for name in names if shutil.which(name) is None}
    if missing:
        pytest.skip(f"install {' '.join(sorted(set(missing.values())))} for {', '.join(missing)}")
