"""What the tests of the C bundle need: compilers, an emulator, an analyser. Where one is missing they are skipped.

On Debian and Ubuntu:
    apt-get install gcc g++ clang make cmake binutils cppcheck gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm
The project's own CI installs them and accepts no skipped test.
"""

from __future__ import annotations

import shutil

import pytest

from flexopt.export.verify.tools import PACKAGES


@pytest.fixture(scope="session", autouse=True)
def tools() -> None:
    """Skips where a program is missing, naming it and its package."""
    missing = {name: package for name, package in PACKAGES.items() if shutil.which(name) is None}
    if missing:
        pytest.skip(f"install {' '.join(sorted(set(missing.values())))} for {', '.join(missing)}")
