"""JSON Schema of the files: what the readers take it takes, what it refuses they refuse, and it leaves no key unsaid."""

from __future__ import annotations

import copy
import json
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

import flexopt
from flexopt.model.file_model import FileModel
from flexopt.model.file_schema import MODELS, key_sentences
from flexopt.model.files import shipped_folder, shipped_names

LOADERS = {"machine": flexopt.load, "problem": flexopt.load_problem, "experiment": flexopt.load_experiment,
           "study": flexopt.load_study}  # fmt: skip
VALIDATORS = {kind: Draft202012Validator(flexopt.schema(kind)) for kind in MODELS}


def shipped() -> Iterator[tuple[str, Path, dict[str, Any]]]:
    for folder in ("models", "problems"):
        for name in shipped_names(folder):
            path = shipped_folder(folder) / f"{name}.toml"
            data = tomllib.loads(path.read_text(encoding="utf-8"))
            told = {"simulation": "experiment", "compute": "study"}
            kind = next((kind for key, kind in told.items() if key in data), "problem")
            yield ("machine" if folder == "models" else kind), path, data


SHIPPED = list(shipped())


def read(kind: str, data: dict[str, Any], folder: Path) -> None:
    """As the loader reads a file in that folder."""
    from flexopt.model.files import Source  # noqa: PLC0415
    from flexopt.model.reading import _experiment, _machine, _problem  # noqa: PLC0415
    from flexopt.model.study_file import study_from  # noqa: PLC0415

    source = Source(data, "models" if kind == "machine" else "problems", folder, "file")
    {"machine": _machine, "problem": _problem, "experiment": _experiment, "study": study_from}[kind](source)


def places(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """Every table, list and value in a file, and where it stands."""
    yield path, data
    inner = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in inner:
        yield from places(value, (*path, key))


def changed(data: dict[str, Any], path: tuple[Any, ...], value: Any) -> dict[str, Any]:
    twin = copy.deepcopy(data)
    here: Any = twin
    for key in path[:-1]:
        here = here[key]
    here[path[-1]] = value
    return twin


def faulty(data: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Files with one fault, of which each is that of a key alone."""
    for path, value in places(data):
        where = ".".join(map(str, path))
        if isinstance(value, dict):
            yield f"{where}: unknown key", changed({"": data}, ("", *path), value | {"no_such_key": 1})[""]
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield f"{where}: text", changed(data, path, "much")
            yield f"{where}: too large", changed(data, path, 1e300)
        elif isinstance(value, list):
            yield f"{where}: true", changed(data, path, True)


@pytest.mark.parametrize("kind", MODELS)
def test_it_is_a_schema_and_json(kind: str) -> None:
    layout = flexopt.schema(kind)
    assert layout["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    Draft202012Validator.check_schema(layout)
    assert json.loads(json.dumps(layout, allow_nan=False)) == layout


@pytest.mark.parametrize(("kind", "path", "data"), SHIPPED, ids=lambda x: x.stem if isinstance(x, Path) else "")
def test_every_shipped_file_passes_and_no_fault_of_a_key_does(kind: str, path: Path, data: dict[str, Any]) -> None:
    """The readers judge each faulty file, too: what the schema refuses, they refuse."""
    validator = VALIDATORS[kind]
    assert [error.message for error in validator.iter_errors(data)] == []
    passed: list[str] = []
    cases = list(faulty(data))
    assert len(cases) >= 10
    looked_at = range(0, len(cases), len(cases) // 6)
    for number, (name, wrong) in enumerate(cases):
        if validator.is_valid(wrong):
            passed.append(name)
        elif number in looked_at:
            with pytest.raises(flexopt.ModelError):
                read(kind, wrong, path.parent)
    assert passed == []


@pytest.mark.parametrize(
    ("kind", "data", "said"),
    [
        ("machine", {"name": "m"}, "'base' is a required property"),
        ("machine", {"name": "m", "robot": "m.urdf"}, "'actuated' is a required property"),
        ("machine", {"name": "m", "robot": "m.urdf", "actuated": ["a"], "end_point": {}}, "is not valid under any"),
        ("problem", {"name": "p", "machine": "excavator", "target": {}}, "is not valid under any"),
        ("problem", {"name": "p", "machine": "excavator"}, "'target' is a required property"),
        ("experiment", {"name": "e", "machine": "excavator"}, "'simulation' is a required property"),
        ("experiment", {"schema": 2, "name": "e", "machine": "m", "simulation": {}}, "1 was expected"),
    ],
)
def test_what_is_missing_is_named(kind: str, data: dict[str, Any], said: str) -> None:
    assert any(said in error.message for error in VALIDATORS[kind].iter_errors(data))


def test_words_in_place_of_tables() -> None:
    """Collision capsules, and kinds of obstacles, are told apart as the readers do."""
    _, _, crane = next(each for each in SHIPPED if each[1].stem == "truck-crane")
    assert VALIDATORS["machine"].is_valid(crane | {"capsules": "collision"})
    assert not VALIDATORS["machine"].is_valid(crane | {"capsules": "visual"})
    _, _, pipe = next(each for each in SHIPPED if each[1].stem == "pipe-laying")
    ball = {"center": [0.0, 0.0, 1.0], "radius": 0.5}
    clearance = {"distance": 0.2, "obstacles": [ball]}
    assert not VALIDATORS["problem"].is_valid(pipe | {"constraints": {"clearance": clearance}})
    clearance = {"distance": 0.2, "obstacles": [{"kind": "sphere"} | ball]}
    assert VALIDATORS["problem"].is_valid(pipe | {"constraints": {"clearance": clearance}})


def undocumented(layout: dict[str, Any]) -> list[str]:
    return [
        f"{name}.{key}"
        for name, table in layout["$defs"].items()
        for key, given in table["properties"].items()
        if not re.search(r"\w{2,}", given.get("description", ""))
    ]


def test_every_key_is_documented() -> None:
    count = 0
    for kind in MODELS:
        layout = flexopt.schema(kind)
        assert undocumented(layout) == []
        assert all(table["description"] for table in layout["$defs"].values())
        count += sum(len(table["properties"]) for table in layout["$defs"].values())
    assert count > 150
    # The same look finds a key of which nothing is said.
    bare = {"$defs": {"T": {"properties": {"a": {"type": "number"}, "b": {"description": "of the body."}}}}}
    assert undocumented(bare) == ["T.a"]


class Said(FileModel):
    """A table.

    Attributes:
        one, two: of both,
            in two lines.
        three: alone.

    Raises:
        InputError: never.
    """

    one: float = 0.0
    two: float = 0.0
    three: float = 0.0
    four: float = 0.0


def test_sentences_come_from_the_docstring() -> None:
    both = "of both, in two lines."
    assert key_sentences(Said) == {"one": both, "two": both, "three": "alone."}


def test_every_number_has_its_range_and_physical_ones_their_unit() -> None:
    link = flexopt.schema("machine")["$defs"]["Link"]["properties"]
    assert (link["mass"]["x-unit"], link["mass"]["exclusiveMinimum"], link["mass"]["maximum"]) == ("kg", 0.0, 1e9)
    assert link["joint_damping"]["default"] == 0.0
    unbounded = [
        f"{name}.{key}"
        for kind in MODELS
        for name, table in flexopt.schema(kind)["$defs"].items()
        for key, given in table["properties"].items()
        if given.get("type") in ("number", "integer") and not {"maximum", "enum"} & given.keys()
    ]
    assert unbounded == []
