"""Programs that tests of the C bundle use, as the mark `needs` takes them."""

from __future__ import annotations

import pytest

# Program -> what brings it on Debian and Ubuntu.
PACKAGES = {
    "gcc": "gcc", "g++": "g++", "clang": "clang", "clang++": "clang", "make": "make", "cmake": "cmake",
    "nm": "binutils", "objdump": "binutils", "cppcheck": "cppcheck",
    "arm-none-eabi-gcc": "gcc-arm-none-eabi libnewlib-arm-none-eabi", "arm-none-eabi-nm": "binutils-arm-none-eabi",
    "arm-none-eabi-objdump": "binutils-arm-none-eabi", "qemu-system-arm": "qemu-system-arm",
}  # fmt: skip
HOST_PROGRAMS = ("gcc", "g++", "clang", "clang++", "make", "cmake", "nm", "objdump", "cppcheck")
TARGET_PROGRAMS = ("arm-none-eabi-gcc", "arm-none-eabi-nm", "arm-none-eabi-objdump", "qemu-system-arm")

GCC = pytest.mark.needs("gcc")
MAKE = pytest.mark.needs("gcc", "make")
# What `tests.export.emulated` uses on the host, and for emulated boards.
HOST = pytest.mark.needs(*HOST_PROGRAMS)
TARGET = pytest.mark.needs(*TARGET_PROGRAMS)
