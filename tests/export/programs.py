"""Programs that tests of the C bundle use, as the mark `needs` takes them."""

from __future__ import annotations

import pytest

HOST_PROGRAMS = ("gcc", "g++", "clang", "clang++", "make", "cmake", "nm", "objdump", "cppcheck")
TARGET_PROGRAMS = ("arm-none-eabi-gcc", "arm-none-eabi-nm", "arm-none-eabi-objdump", "qemu-system-arm", "cppcheck")

GCC = pytest.mark.needs("gcc")
MAKE = pytest.mark.needs("gcc", "make")
# `flexopt verify` of one target, complete.
HOST = pytest.mark.needs(*HOST_PROGRAMS)
TARGET = pytest.mark.needs(*TARGET_PROGRAMS)
