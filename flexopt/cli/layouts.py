"""`flexopt schema`."""

from __future__ import annotations

import json

import click

from flexopt.cli.common import JSON, check_output, print_json, value, write_output
from flexopt.foundation.writing import write_file
from flexopt.model.file_schema import FileKind, schema


@click.command("schema", short_help="The layout of a kind of file, as JSON Schema for editors.")
@click.argument("kind", metavar="machine|problem|experiment|study")
@value("--out", "PATH", "Write it to a file, .json, in place of standard output.")
@JSON
def schema_command(as_json: bool, kind: FileKind, out: str | None) -> None:
    """The keys of a kind of file as JSON Schema (2020-12): what each is, its unit, range and default.

    Editors that know TOML complete and check files by it. In VS Code, with the extension Even Better TOML, and others
    that use Taplo, the first line of a file names it: #:schema ./machine.json
    """
    check_output("--out", out, (".json",))
    layout = schema(kind)
    if out is None or as_json:
        print_json(layout)
    if out is not None:
        text = json.dumps(layout, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
        write_output("--out", out, lambda: write_file(out, text))
