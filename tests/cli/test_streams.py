"""Output to a stream that is full or closed: exit status 1, at most one sentence, no traceback."""

from __future__ import annotations

import shlex
import subprocess
import sys

import pytest

COMMANDS = {
    "evaluate": "evaluate excavator --posture 0.9929,-2.6306",
    "json": "evaluate excavator --posture 0.9929,-2.6306 --json",
    "error": "evaluate excavator --posture 0.9929 --json",
    "help": "select --help",
    "version": "--version",
    "completion": "completion bash",
    "schema": "schema machine",
}
# A command in whose middle another package warns.
WARNS = """
import sys, warnings
import flexopt.robustness.evaluation as evaluation
before = evaluation.check_regular
def warned(*arguments):
    warnings.warn("of no interest", RuntimeWarning, stacklevel=1)
    return before(*arguments)
evaluation.check_regular = warned
from flexopt.cli import main
main(sys.argv[1:])
"""
FLEXOPT = f"{shlex.quote(sys.executable)} -m flexopt"


def shell(line: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["bash", "-c", line], capture_output=True, text=True, encoding="utf-8", check=False)


@pytest.mark.needs("bash")
@pytest.mark.parametrize("end", ["> /dev/full", ">&-"])
@pytest.mark.parametrize("name", list(COMMANDS))
def test_output_that_is_lost_ends_with_one_sentence(name: str, end: str) -> None:
    done = shell(f"{FLEXOPT} {COMMANDS[name]} {end}")
    assert done.returncode == 1
    assert done.stderr.startswith("flexopt: output is lost: ")
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.needs("bash")
def test_a_reader_that_leaves_ends_the_command() -> None:
    """`head` goes before the command has written; as with other programs that needs no sentence."""
    done = shell(f"set -o pipefail; {FLEXOPT} {COMMANDS['evaluate']} | true")
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) <= 1


@pytest.mark.needs("bash")
@pytest.mark.parametrize("end", ["2> /dev/full", "2>&-"])
def test_errors_that_cannot_be_said_keep_the_result_whole(end: str) -> None:
    whole, done = (shell(f"{FLEXOPT} {COMMANDS['json']} {each}") for each in ("", end))
    assert (done.returncode, done.stdout) == (0, whole.stdout)
    assert shell(f"{FLEXOPT} {COMMANDS['error']} {end}").returncode in (1, 2)


@pytest.mark.parametrize("options", [[], ["--verbose"]])
def test_warnings_of_other_packages_are_for_those_who_ask(options: list[str]) -> None:
    command = [sys.executable, "-c", WARNS, *options, *COMMANDS["json"].split()]
    done = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", check=True)
    assert ("of no interest" in done.stderr) == bool(options)
