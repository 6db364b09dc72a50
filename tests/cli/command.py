"""Runs the command in-process and writes machine and problem files with chosen faults."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

from flexopt.cli import main

# Keys as a path, values as they stand in the file, so that a row can hold what no Python value could say.
MACHINE = {
    "schema": "1",
    "name": '"digger"',
    "base.length": "0.541",
    "base.com": "0.563",
    "base.mass": "5291.5",
    "base.inertia": "1020.7",
    "base.rest_angle": "1.2451",
    "base.stiffness.x": "4e7",
    "base.stiffness.y": "4e7",
    "base.stiffness.rotation": "1.112e6",
    "links[0].name": '"boom"',
    "links[0].length": "1.918",
    "links[0].com": "1.067",
    "links[0].mass": "766.6",
    "links[0].inertia": "214.9",
    "links[1].name": '"stick"',
    "links[1].length": "1.097",
    "links[1].com": "0.613",
    "links[1].mass": "458.2",
    "links[1].inertia": "93.6",
}
THIRD_LINK = {
    "links[2].name": '"bucket"',
    "links[2].length": "0.6",
    "links[2].com": "0.3",
    "links[2].mass": "100.0",
    "links[2].inertia": "10.0",
}
PROBLEM = {
    "schema": "1",
    "name": '"dig"',
    "machine": '"excavator"',
    "target.end_point": "[0.0, 1.6]",
}
Patch = dict[str, str | None]


def toml(entries: dict[str, str], patch: Patch) -> str:
    """A file of `entries` where each key of `patch`, and everything below it, is replaced, or left out for None."""
    lines = dict(entries)
    for key, value in patch.items():
        for old in [k for k in lines if k == key or k.startswith((f"{key}.", f"{key}["))]:
            del lines[old]
        if value is not None:
            lines[key] = value
    text = "".join(f"{k} = {v}\n" for k, v in lines.items() if not k.startswith("links["))
    for index in range(5):
        own = {k.partition("].")[2]: v for k, v in lines.items() if k.startswith(f"links[{index}].")}
        text += "[[links]]\n" + "".join(f"{k} = {v}\n" for k, v in own.items()) if own else ""
    return text


@dataclass(frozen=True)
class Done:
    """What one call left behind."""

    code: int
    stdout: str
    stderr: str

    @property
    def document(self) -> dict[str, Any]:
        """The one JSON document on standard output."""
        return strict_json(self.stdout)

    @property
    def message(self) -> str:
        """Standard error without the progress of a solve, and without the doubt about a machine whose numbers are odd."""
        return re.sub(r"^(starts \d+/\d+|flexopt: warning: machine .* not plausible .*)\n", "", self.stderr, flags=re.M)


def strict_json(text: str) -> dict[str, Any]:
    """JSON as the standard has it: NaN and Infinity are no numbers, and nothing follows the document."""

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    return json.loads(text, parse_constant=refuse)


class Command:
    """Calls `flexopt.cli.main` and collects code, standard output and standard error."""

    def __init__(self, capsys: pytest.CaptureFixture[str], folder: Path) -> None:
        self.capsys, self.folder = capsys, folder

    def __call__(self, *arguments: str) -> Done:
        self.capsys.readouterr()
        code: Any = 0
        try:
            # However long a busy machine takes, its seconds are no part of the output here.
            with patch("flexopt.cli.common.SELDOM", 3600.0):
                main(list(arguments))
        except SystemExit as leave:
            code = leave.code
        captured = self.capsys.readouterr()
        return Done(code, captured.out, captured.err)

    def json(self, *arguments: str) -> dict[str, Any]:
        """The document of a call that succeeds."""
        outcome = self(*arguments, "--json")
        assert outcome.code == 0, outcome.stderr
        return outcome.document

    def write(self, name: str, content: str | bytes | None) -> None:
        """A file in the folder where the command runs; None makes a folder of that name."""
        path = self.folder / name
        if content is None:
            path.mkdir()
        elif isinstance(content, bytes):
            path.write_bytes(content)
        else:
            path.write_text(content, encoding="utf-8")
