"""The programs that a verification runs: found or named as missing, run with a limit of time."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from flexopt.foundation.writing import write_file

# Program -> what brings it on Debian and Ubuntu.
PACKAGES = {
    "gcc": "gcc", "g++": "g++", "clang": "clang", "clang++": "clang", "make": "make", "cmake": "cmake",
    "nm": "binutils", "objdump": "binutils", "cppcheck": "cppcheck",
    "arm-none-eabi-gcc": "gcc-arm-none-eabi libnewlib-arm-none-eabi", "arm-none-eabi-nm": "binutils-arm-none-eabi",
    "arm-none-eabi-objdump": "binutils-arm-none-eabi", "qemu-system-arm": "qemu-system-arm",
}  # fmt: skip
SECONDS = 900.0


class ToolMissing(Exception):
    """Programs that are not installed.

    Attributes:
        names: which.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)
        packages = " ".join(dict.fromkeys(PACKAGES[name] for name in names))
        super().__init__(f"{', '.join(names)} missing (apt-get install {packages})")


class StepFailed(Exception):
    """A program ended with an error, or took too long; the message is the end of what it said."""


@dataclass(frozen=True)
class ProgramOutput:
    """What a program printed."""

    out: str
    err: str

    @property
    def both(self) -> str:
        """Standard output, then standard error."""
        return self.out + self.err


def need(*names: str) -> None:
    """Raise `ToolMissing` unless all programs are there."""
    missing = [name for name in names if shutil.which(name) is None]
    if missing:
        raise ToolMissing(missing)


def run(
    command: Sequence[str | Path],
    *,
    folder: Path,
    environment: dict[str, str] | None = None,
    seconds: float = SECONDS,
    may_fail: bool = False,
) -> ProgramOutput:
    """Run a program that is there.

    Raises:
        ToolMissing: it is not there.
        StepFailed: it failed, unless `may_fail`, or ran out of time.
    """
    words = [str(word) for word in command]
    if "/" not in words[0]:
        need(words[0])
    try:
        done = subprocess.run(
            words, cwd=folder, env=os.environ | {"LC_ALL": "C"} | (environment or {}), stdin=subprocess.DEVNULL,
            capture_output=True, text=True, errors="replace", timeout=seconds, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired as error:
        raise StepFailed(f"{words[0]} took longer than {seconds:g} s") from error
    if done.returncode != 0 and not may_fail:
        said = (done.stderr.strip() or done.stdout.strip())[-1500:]
        raise StepFailed(f"{' '.join(words[:1])} ended with {done.returncode}: {said}")
    return ProgramOutput(done.stdout, done.stderr)


def sanitizing_compiler(flags: Sequence[str], folder: Path) -> str:
    """The first of clang and gcc that is there with the libraries of its sanitizers.

    Raises:
        ToolMissing: neither is.
    """
    source = folder / "sanitizers.c"
    write_file(source, "int main(void) { return 0; }\n")
    for compiler in ("clang", "gcc"):
        try:
            run([compiler, *flags, source, "-o", folder / "sanitizers"], folder=folder)
        except (ToolMissing, StepFailed):
            continue
        return compiler
    raise ToolMissing(["gcc"])


def version(program: str) -> str:
    """First line of what `program --version` says."""
    said = run([program, "--version"], folder=Path.cwd(), may_fail=True).both.strip()
    return said.splitlines()[0] if said else "unknown"
