"""The programs that a verification runs: found or named as missing, run with a limit of time."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

COMPILERS = ("cc", "gcc", "clang")
SECONDS = 900.0


class ToolMissing(Exception):
    """A program that is not installed."""


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
    if shutil.which(words[0]) is None:
        raise ToolMissing(f"{words[0]} missing")
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


def host_compiler() -> str:
    """The first C compiler on the path.

    Raises:
        ToolMissing: there is none.
    """
    for name in COMPILERS:
        if shutil.which(name) is not None:
            return name
    raise ToolMissing(f"no C compiler found ({', '.join(COMPILERS)})")


def version(program: str) -> str:
    """First line of what `program --version` says."""
    said = run([program, "--version"], folder=Path.cwd(), may_fail=True).both.strip()
    return said.splitlines()[0] if said else "unknown"
