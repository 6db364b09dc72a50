"""The pages that the code writes: every public name, every key of every file, every error, every command."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import click.testing
import pytest

import flexopt
from docs import generated
from docs.public import TOPICS, names
from flexopt import errors
from flexopt.cli.commands import COMMANDS, cli
from flexopt.model.file_schema import MODELS


def test_every_public_name_is_in_the_reference() -> None:
    listed = [name for topic in TOPICS for name in names(topic)]
    assert sorted(listed) == sorted(flexopt.__all__)
    written = "\n".join(generated.reference(topic) for topic in TOPICS)
    shown = re.findall(r"^\.\. auto(?:class|function):: flexopt\.(\w+)$", written, re.MULTILINE)
    assert sorted(shown) == sorted(flexopt.__all__)
    assert [name for name in flexopt.__all__ if not inspect.getdoc(getattr(flexopt, name))] == []


@pytest.mark.parametrize("kind", MODELS)
def test_every_key_has_its_row(kind: str) -> None:
    """With its sentence; ranges and units stand where the schema has them."""
    page = generated.keys(kind)
    tables = dict(re.findall(r"^## (\w+)\n(.*?)(?=^## |\Z)", page, re.MULTILINE | re.DOTALL))
    layout = flexopt.schema(kind)["$defs"]
    assert tables.keys() == layout.keys()
    for name, table in layout.items():
        rows = {cells[0]: cells for cells in re.findall(r"^\| `(\w+)` \|" + r"(.*?) \|" * 5 + "$", tables[name], re.M)}
        assert rows.keys() == table["properties"].keys(), name
        for key, given in table["properties"].items():
            _, kind_of, unit, span, default, what = rows[key]
            assert kind_of.strip()
            assert what.strip()
            assert ("x-unit" in given) <= bool(unit.strip())
            assert ("maximum" in given) <= bool(span.strip())
            assert (key in table.get("required", ())) == (default.strip() == "required")


def test_a_table_says_where_it_stands() -> None:
    assert "In a file: `[[links]]`." in generated.keys("machine")
    assert "In a file: `[constraints.clearance]`." in generated.keys("problem")
    assert "In a file: `[[constraints.clearance.obstacles]]`." in generated.keys("problem")
    assert "In a file: `[joints.NAME]`." in generated.keys("machine")


def test_every_error_says_what_to_do() -> None:
    page = generated.errors()
    kinds = [kind for kind in vars(errors).values() if inspect.isclass(kind) and issubclass(kind, Exception)]
    sections = dict(re.findall(r"^## (\w+)\n(.*?)(?=^## |\Z)", page, re.MULTILINE | re.DOTALL))
    assert sections.keys() == {kind.__name__ for kind in kinds}
    assert [name for name, text in sections.items() if "What to do: " not in text] == []
    assert set(generated.REMEDIES) == set(sections)


def test_every_command_has_its_help() -> None:
    sections = dict(
        re.findall(r"^## flexopt ([\w ]+)\n(.*?)(?=^## |\Z)", generated.commands(), re.MULTILINE | re.DOTALL)
    )
    assert sorted(name for name in sections if " " not in name) == sorted(COMMANDS)
    assert "study run" in sections
    for name, text in sections.items():
        said = click.testing.CliRunner().invoke(cli, [*name.split(), "--help"], prog_name="flexopt").output
        usage = re.findall(rf"flexopt {name}.*", said)[0]
        assert usage.strip() in text
        options = re.findall(r"^  (?:-\w, )?(--[\w-]+)", said, re.MULTILINE)
        assert options
        assert [option for option in options if not re.search(rf"^`.*{option}\b", text, re.MULTILINE)] == []


def test_pages_are_written_once(tmp_path: Path) -> None:
    """What is as it was is left alone, what nobody writes any more goes."""
    (tmp_path / "old.md").write_text("old")
    generated.write_pages(tmp_path)
    assert not (tmp_path / "old.md").exists()
    before = {page.name: page.stat().st_mtime_ns for page in tmp_path.glob("*.md")}
    generated.write_pages(tmp_path)
    assert {page.name: page.stat().st_mtime_ns for page in tmp_path.glob("*.md")} == before
