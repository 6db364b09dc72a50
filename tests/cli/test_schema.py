"""`flexopt schema`: what `flexopt.schema` gives, on standard output or in a file."""

from __future__ import annotations

import json
from pathlib import Path

import flexopt
from flexopt.model.file_schema import MODELS
from tests.cli.command import Command


def test_the_command(command: Command) -> None:
    for kind in MODELS:
        assert json.loads(command("schema", kind).stdout) == flexopt.schema(kind)
    command("schema", "machine", "--out", "machine.json")
    assert json.loads(Path("machine.json").read_text(encoding="utf-8")) == flexopt.schema("machine")
    assert command("schema", "robot").code == 2
    assert "machine or problem or experiment" in command("schema", "robot").stderr
    assert command("schema", "machine", "--out", "machine.toml").code == 2
