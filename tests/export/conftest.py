"""What the tests of the C bundle need: compilers, an emulator, an analyser. Nothing is skipped where one is missing.

On Debian and Ubuntu:
    apt-get install gcc g++ clang make cmake binutils cppcheck gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm
"""

from __future__ import annotations

import shutil

import pytest

from flexopt.export.verify.tools import PACKAGES


@pytest.fixture(scope="session")
def tools() -> None:
    """Fails where a program is missing, naming it and its package."""
    missing = {name: package for name, package in PACKAGES.items() if shutil.which(name) is None}
    assert not missing, f"install {' '.join(sorted(set(missing.values())))} for {', '.join(missing)}"
