"""What each kind of file may say, as JSON Schema: for editors, for the pages of the documentation.

In: the models that read the files. Out: one dictionary. Types, ranges and defaults are the models' own, sentences are
those of their docstrings.
"""

from __future__ import annotations

import inspect
import re
from typing import Any, Literal, cast, get_args

from pydantic.json_schema import GenerateJsonSchema, models_json_schema

from flexopt.foundation.arrays import Document
from flexopt.foundation.boundary import public, words
from flexopt.foundation.quantities import JsonSchema
from flexopt.model.file_model import FileModel
from flexopt.model.planar import Machine
from flexopt.model.problem import Problem
from flexopt.model.robots.overlay import Overlay
from flexopt.model.robots.reading import COLLISION
from flexopt.model.simulation import Experiment
from flexopt.model.study import Study

FileKind = Literal["machine", "problem", "experiment", "study"]
# What reads each kind of file; a machine file that names a robot file has keys of its own.
MODELS: dict[FileKind, tuple[type[FileModel], ...]] = {
    "machine": (Machine, Overlay),
    "problem": (Problem,),
    "experiment": (Experiment,),
    "study": (Study,),
}
DIALECT = GenerateJsonSchema.schema_dialect
_ENTRY = re.compile(r"^(\w+(?:, \w+)*): (.*)$")


@public(kind=words(*MODELS))
def schema(kind: FileKind) -> Document:
    """The layout of a kind of file as JSON Schema (2020-12), by which editors complete and check its keys.

    A key's `description` says what it is, `x-unit` its unit, `minimum`, `exclusiveMinimum` and `maximum` its range,
    `default` what holds where it is left out. What several keys must be together is left to `flexopt.check`.

    Args:
        kind: `"machine"`, `"problem"`, `"experiment"` or `"study"`.

    Raises:
        InputError: it is another word.

    Example:
        >>> layout = flexopt.schema("machine")
        >>> mass = layout["$defs"]["Link"]["properties"]["mass"]
        >>> mass["description"], mass["x-unit"], mass["exclusiveMinimum"], mass["maximum"]
        ('of the link.', 'kg', 0.0, 1000000000.0)
    """
    models = MODELS[kind]
    parts = _models(models)  # built before anything asks for their layout, or for a default that is one of them
    refs, found = models_json_schema([(model, "validation") for model in models], ref_template="#/$defs/{model}")
    tables = cast(dict[str, JsonSchema], found["$defs"])
    for name, model in parts.items():
        _say(tables[name], model)
    ways = [refs[model, "validation"] for model in models]
    layout: JsonSchema = {"$schema": DIALECT, "title": f"flexopt {kind} file", "type": "object"}
    if len(ways) == 1:
        return layout | ways[0] | {"$defs": tables}
    # Each by what it requires, so that an editor names the keys of the one that is meant.
    return layout | {"if": {"required": ["robot"]}, "then": ways[1], "else": ways[0], "$defs": tables}


def key_sentences(model: type[FileModel]) -> dict[str, str]:
    """What the docstring of a table, and of those that it extends, says of each key (section `Attributes`)."""
    found: dict[str, str] = {}
    for kind in reversed(model.__mro__):
        if not issubclass(kind, FileModel):
            continue  # pydantic's own
        docstring = inspect.cleandoc(kind.__dict__.get("__doc__") or "")
        section = re.split(r"^\w+:\n", docstring.partition("Attributes:\n")[2], maxsplit=1, flags=re.MULTILINE)[0]
        names: list[str] = []
        for line in inspect.cleandoc(section).splitlines():
            entry = _ENTRY.match(line)
            if entry:
                names = entry[1].split(", ")
                found |= dict.fromkeys(names, entry[2])
            elif line.strip():
                found |= {name: f"{found[name]} {line.strip()}" for name in names}
    return found


def _models(roots: tuple[type[FileModel], ...]) -> dict[str, type[FileModel]]:
    """Every table of these files, by the name of its class."""
    found: dict[str, type[FileModel]] = {}
    waiting: list[Any] = list(roots)
    while waiting:
        part = waiting.pop()
        if isinstance(part, type) and issubclass(part, FileModel):
            if part.__name__ not in found:
                found[part.__name__] = part
                part.model_rebuild()
                waiting += [field.annotation for field in part.model_fields.values()]
        else:
            waiting += get_args(part)
    return found


def _say(table: JsonSchema, model: type[FileModel]) -> None:
    """A table with its sentences, without what files cannot say."""
    sentences = key_sentences(model)
    docstring = inspect.cleandoc(model.__doc__ or "")
    table["description"] = " ".join(docstring.partition("Attributes:")[0].split())
    table.pop("title", None)
    keys = cast(dict[str, JsonSchema], table["properties"])
    if model.__name__ == "Constraints":
        del keys["own"]  # Functions, which files have not
    for key, given in list(keys.items()):
        keys[key] = _key(given) | {"description": sentences.get(key, "")}
        if isinstance(given.get("const"), str):  # the word that tells kinds of tables apart
            table.setdefault("required", []).insert(0, key)
    if model is Overlay:
        keys["capsules"] = {"description": sentences["capsules"]} | {
            "anyOf": [{word: keys["capsules"][word] for word in ("type", "items")}, {"const": COLLISION}]
        }


def _key(given: JsonSchema) -> JsonSchema:
    """A key without null, which TOML has not, without pydantic's titles and without defaults that say nothing."""
    key = {word: value for word, value in given.items() if word != "title"}
    ways = [way for way in key.get("anyOf", ()) if way != {"type": "null"}]
    if len(ways) == 1:
        key = {word: value for word, value in key.items() if word != "anyOf"} | ways[0]
    elif ways:
        key["anyOf"] = ways
    for part in key.pop("allOf", ()):  # as older versions of pydantic put a reference beside a default
        key |= part
    if isinstance(default := key.get("default"), dict) or default in (None, "", [], ()):
        key.pop("default", None)
    return key
