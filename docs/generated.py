"""Pages that the code writes: the reference by topic, the keys of files, the errors."""

from __future__ import annotations

import inspect
import re
import shutil
from pathlib import Path
from typing import Any

import click

import flexopt
from docs import gallery
from docs.public import TOPICS, TYPES, names, words
from flexopt.cli.commands import cli
from flexopt.cli.examples import EXAMPLES
from flexopt.foundation.offered import PLUMBING
from flexopt.model.file_schema import MODELS

NOTEBOOKS = Path(__file__).resolve().parents[1] / "notebooks"
IMPORTED = """Examples run as they stand after

```{code-block} python
import casadi as ca
import numpy as np
import flexopt
```

Examples of a result go on from those of the call that makes it, those of a method from its class's.
"""
TYPES_SAID = (
    "What signatures in the reference, in editors and in `help` say. Every value is checked when a call begins, in "
    "units and ranges that its `Args` tell; integers stand for floats, and nothing but numbers for numbers."
)
INTRODUCTIONS = {
    "machine": "A machine file has the keys of `Machine` or, where it has the key `robot`, those of `Overlay`.",
    "problem": "A problem file has the keys of `Problem`.",
    "study": "A study file, what `flexopt study run` carries out, has the keys of `Study`.",
    "experiment": "An experiment file, a simulation in a file, has the keys of `Experiment`.",
}
# What to do about each: the docstring of the class says what it means.
REMEDIES = {
    "FlexoptError": "Catch this one to catch all of them.",
    "InputError": "The message names every argument that is wrong, its unit and its range. Mend these and call again.",
    "ModelError": "The message lists every fault of the file with its key. `flexopt check FILE` shows the same list.",
    "UnreachableTarget": "Move the base into `base_intervals`, or choose a target that is nearer by `miss`.",
    "SingularPosture": "Bend the arm: move `joint` away from `angle`.",
    "NotStabilizable": "Damp the mode that `mode` names, or give the plant an input or output that reaches it.",
    "NoSolutionFound": "Read `violations`: a constraint that is violated at every start may exclude all "
    "configurations. Ask for less (`constraints`, `base_range`, `assume`), or try more starts (`starts`).",
    "MarginNotComputed": "The plant is scaled too badly, or damped too lightly. Ask for `w1`, which needs no ε_max.",
    "WrongSlope": "Nothing was solved. Where an own Function takes part, look whether it is smooth; else report it.",
    "ExportError": "Leave the part out (`parts`), or choose a control that has an equivalent in C.",
    "StudyInterrupted": "Mend what the sentence names (room on the disk, workers, the scheduler) and make the same "
    "call again: it goes on from the chunks that are there.",
    "WriteError": "Make room, make the folder, or choose another path. What was there before is as it was.",
    "FlexoptWarning": "The result is right. Read the sentence before you use it.",
    "ImplausibleMachine": "Run `flexopt check FILE`: it names each number, and the unit that was probably meant.",
    "CompilerNotFound": "Nothing needs mending: results are the same. For speed install a C compiler, or the extra "
    "`compiler`; `flexopt doctor` tells what was found.",
}


def write_pages(folder: Path) -> None:
    """All of them, those that are as they were left alone, so that Sphinx builds only what changed."""
    pages = {f"reference-{topic}.md": reference(topic) for topic in TOPICS}
    pages |= {f"keys-{kind}.md": keys(kind) for kind in MODELS}
    pages |= {"errors.md": errors(), "commands.md": commands(), "gallery.md": gallery.page(), "types.md": types()}
    folder.mkdir(exist_ok=True)
    for old in folder.glob("*.md"):
        if old.name not in pages:
            old.unlink()
    for name, text in pages.items():
        page = folder / name
        if not page.exists() or page.read_text(encoding="utf-8") != text:
            page.write_text(text, encoding="utf-8")
    notebooks = folder / "notebooks"
    shutil.rmtree(notebooks, ignore_errors=True)
    shutil.copytree(NOTEBOOKS, notebooks, ignore=shutil.ignore_patterns("*.py", ".*"))


def reference(topic: str) -> str:
    """Each name of a topic from its docstring."""
    parts = [f"# {TOPICS[topic][0]}", IMPORTED]
    for name in names(topic):
        public = getattr(flexopt, name)
        error = inspect.isclass(public) and issubclass(public, Exception)
        options = ["   :show-inheritance:"] if error else []
        if inspect.isclass(public):
            hidden = ", ".join(sorted(PLUMBING | set(getattr(public, "model_fields", ()))))
            stop = ", ".join(base.__name__ for base in public.__mro__ if not base.__module__.startswith("flexopt"))
            options += [
                "   :members:",
                f"   :inherited-members: {stop}",
                f"   :exclude-members: {hidden}, model_config, with_traceback, add_note",
            ]
        directive = "autoclass" if inspect.isclass(public) else "autofunction"
        shown = [f".. {directive}:: flexopt.{name}", *options]
        parts.append("\n".join([f"## {name}", "", "```{eval-rst}", *shown, "```"]))
    return "\n\n".join(parts) + "\n"


def types() -> str:
    """Names of types in signatures, and what each takes."""
    rows = ["# Types in signatures", TYPES_SAID, "| name | what |\n| --- | --- |"]
    for name, (_, sentence) in TYPES.items():
        listed = ", ".join(f'`"{word}"`' for word in words(name))
        told = f"{sentence.rstrip('.')}: {listed}." if listed else sentence
        rows[-1] += f"\n| `{name}` | {_cell(told)} |"
    return "\n\n".join(rows) + "\n"


def keys(kind: Any) -> str:
    """Every key of a kind of file, a table for each of its tables, from its JSON Schema."""
    layout = flexopt.schema(kind)
    parts = [
        f"# Keys of {kind} files",
        f"{INTRODUCTIONS[kind]} `flexopt schema {kind} --out {kind}.json` writes the same for editors, as JSON Schema.",
        "Units are SI and angles radians. A key without a default is required; one with – may be left out.",
    ]
    roots = [model.__name__ for model in MODELS[kind]]
    headers = dict.fromkeys(roots, "")
    for root in roots:
        headers = _headers(layout["$defs"], root, "") | headers
    for name in sorted(layout["$defs"], key=lambda name: (name not in roots, name)):
        table = layout["$defs"][name]
        where = f"In a file: {headers[name]}. " if headers[name] else ""
        parts.append(f"## {name}\n\n{where}{_cell(table['description'])}")
        rows = ["| key | type | unit | range | default | what |", "| --- | --- | --- | --- | --- | --- |"]
        for key, given in table["properties"].items():
            required = key in table.get("required", ())
            default = "required" if required else _default(given.get("default"))
            cells = (f"`{key}`", _type(given), _unit(given), _range(given), default, _cell(given["description"]))
            rows.append(f"| {' | '.join(cells)} |")
        parts.append("\n".join(["```{container} keys", *rows, "```"]))
    return "\n\n".join(parts) + "\n"


def _headers(tables: dict[str, Any], name: str, path: str) -> dict[str, str]:
    """How a file begins each table that lies in another, by the name of its class."""
    found: dict[str, str] = {}
    for key, given in tables[name]["properties"].items():
        listed, inside = _tables(given, 0)
        for table, depth in inside.items():
            place = f"{path}{key}" + (".NAME" if listed else "")
            header = f"`[[{place}]]`" if depth else f"`[{place}]`"
            found |= {table: header} | _headers(tables, table, f"{place}.") | found
    return found


def _tables(given: Any, depth: int) -> tuple[bool, dict[str, int]]:
    """Whether a key holds tables by name, and the classes of its tables: 1 in lists, else 0."""
    if "$ref" in given:
        return False, {given["$ref"].rpartition("/")[2]: depth}
    by_name = isinstance(given.get("additionalProperties"), dict)
    ways = [*given.get("anyOf", ()), *given.get("oneOf", ())]
    found: dict[str, int] = {}
    for way in [*ways, *([given["additionalProperties"]] if by_name else [])]:
        found |= _tables(way, depth)[1]
    if given.get("type") == "array" and isinstance(given.get("items"), dict):
        found |= _tables(given["items"], 1)[1]
    return by_name, found


def errors() -> str:
    """Each error and warning: what it means, what it carries, and what to do."""
    from flexopt import errors as module  # noqa: PLC0415

    parts = [
        "# Errors and what to do",
        "Every error that flexopt raises on purpose is a `FlexoptError`. On the command line bad input ends with exit "
        "code 2, a solve that did not converge or a check that failed with 3. `--json` prints the error as a document.",
    ]
    kinds = [
        kind
        for kind in vars(module).values()
        if inspect.isclass(kind) and issubclass(kind, FlexoptKinds) and kind.__module__ == module.__name__
    ]
    for kind in kinds:
        docstring = inspect.cleandoc(kind.__doc__ or "").partition("\n\nExample:")[0]
        text, _, attributes = docstring.partition("\n\nAttributes:\n")
        parts.append(f"## {kind.__name__}\n\n{_cell(text)}")
        listed = [" ".join(entry.split()) for entry in re.split(r"\n(?=    \w)", "\n" + attributes) if entry.strip()]
        if listed:
            named = [entry.partition(": ") for entry in listed]
            parts.append("\n".join(f"- `{name}`: {_cell(said)}" for name, _, said in named))
        parts.append(f"What to do: {REMEDIES[kind.__name__]}")
    return "\n\n".join(parts) + "\n"


def commands() -> str:
    """Every command as its `--help` has it, in lists that fit any screen."""
    parts = [
        "# The command line",
        "Every command takes `--json`, which prints one JSON document on standard output and nothing else there; "
        "progress and warnings go to standard error. Exit codes: 0 success; 2 bad input, singular postures and "
        "unreachable targets among it; 3 a solve that did not converge or a check that failed.",
    ]
    whole = click.Context(cli, info_name="flexopt", help_option_names=["-h", "--help"])
    return "\n\n".join([*parts, *_commands(cli, whole)]) + "\n"


def _commands(group: Any, within: click.Context) -> list[str]:
    """Those of a group, with theirs."""
    parts: list[str] = []
    for name in group.list_commands(within):
        command = group.get_command(within, name)
        assert command is not None
        context = click.Context(command, info_name=name, parent=within)
        usage = " ".join([context.command_path, *command.collect_usage_pieces(context)])
        said, _, _ = inspect.cleandoc(command.help or "").partition("\f")
        parts += [f"## {context.command_path}", f"```text\n{usage}\n```"]
        parts += [_cell(paragraph) for paragraph in said.split("\n\n")]
        records = [parameter.get_help_record(context) for parameter in command.get_params(context)]
        parts += [f"`{option}`\n: {_cell(text)}" for option, text in filter(None, records) if text]
        if isinstance(command, click.Group):
            parts += _commands(command, context)
        shown = EXAMPLES.get(name) if within.parent is None else None
        parts += ["```sh\n" + "\n".join(shown) + "\n```"] if shown else []
    return parts


FlexoptKinds = (flexopt.FlexoptError, flexopt.FlexoptWarning)


def _cell(text: str) -> str:
    """A sentence of a docstring in a table."""
    parts = re.split(r"(`[^`]*`)", " ".join(text.split()))
    parts[::2] = [re.sub(r"([|*<\[\]$\\_])", r"\\\1", part) for part in parts[::2]]
    parts[1::2] = [part.replace("|", "\\|") for part in parts[1::2]]
    return "".join(parts)


def _type(given: dict[str, Any]) -> str:
    if "anyOf" in given or "oneOf" in given:
        words = [_type(way) for way in given.get("anyOf") or given["oneOf"]]
        return " or ".join(dict.fromkeys(words))
    if "const" in given or "enum" in given:
        values = given.get("enum") or [given["const"]]
        return " or ".join(f"`{value!r}`".replace("'", '"') for value in values)
    if "$ref" in given:
        name = given["$ref"].rpartition("/")[2]
        return f"table [{name}](#{name.lower()})"
    kind = given.get("type")
    if kind == "array":
        least, most = given.get("minItems"), given.get("maxItems")
        count = f" of {least}" if least is not None and least == most else f" of {least} to {most}" if most else ""
        inner = given.get("items", {}) or next(iter(given.get("prefixItems", [])), {})
        return f"list{count}: {_type(inner)}" if inner else f"list{count}"
    if kind == "object":
        inner = given.get("additionalProperties")
        named = f" by name: {_type(inner)}" if isinstance(inner, dict) else ""
        by = ", ".join(f"`{name}`" for name in given.get("properties", {}))
        return f"table{named}" + (f" of {by}" if by else "")
    return {"string": "text", "integer": "whole number", "boolean": "true or false", "number": "number"}.get(kind, "")


def _numbers(given: Any) -> list[dict[str, Any]]:
    """The numbers inside a key's schema."""
    if isinstance(given, list):
        return [found for part in given for found in _numbers(part)]
    if not isinstance(given, dict):
        return []
    if given.get("type") in ("number", "integer"):
        return [given]
    return [found for word, part in given.items() if word != "default" for found in _numbers(part)]


def _unit(given: dict[str, Any]) -> str:
    units = dict.fromkeys(number["x-unit"] for number in _numbers(given) if "x-unit" in number)
    return " or ".join(units)


def _range(given: dict[str, Any]) -> str:
    found: dict[str, None] = {}
    for number in _numbers(given):
        low, above, high = (number.get(word) for word in ("minimum", "exclusiveMinimum", "maximum"))
        if high is not None:
            found[f"{low:g} … {high:g}" if above is None else f"above {above:g}, to {high:g}"] = None
    return "; ".join(found)


def _default(value: Any) -> str:
    return "–" if value is None else f"`{str(value).lower() if isinstance(value, bool) else value}`"
