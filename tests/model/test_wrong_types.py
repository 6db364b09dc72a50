"""Every place of every table is given values of another type, one after the other: a FlexoptError, or it is allowed."""

from __future__ import annotations

import re
import tomllib
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import flexopt
from flexopt.model.files import shipped_folder
from flexopt.model.robots import robot_from_dict
from tests.boundary.calls import CONSTRUCTORS
from tests.fuzz import material

MODELS = shipped_folder("models")
# A table, a list of tables, nothing, an empty list, text, a number too large for a double.
VALUES: tuple[Any, ...] = ({"x": 1.0}, [{"x": 1}], None, [], "x", 10**400)
TABLES: dict[str, tuple[Callable[[Any], Any], Callable[[], Any]]] = {
    "planar machine": (flexopt.machine_from_dict, lambda: flexopt.load("boom-stick-bucket").to_dict()),
    "whole machine": (flexopt.machine_from_dict, CONSTRUCTORS["Machine"]),
    "spatial machine": (flexopt.tree_from_dict, lambda: flexopt.load("slewing-excavator").to_dict()),
    "machine of a robot file": (
        lambda data: robot_from_dict(data, folder=MODELS),
        lambda: tomllib.loads((MODELS / "slewing-excavator.toml").read_text(encoding="utf-8")),
    ),
    "problem": (lambda data: flexopt.Problem(**data), lambda: tomllib.loads(material.PROBLEM)),
    "experiment": (lambda data: flexopt.Experiment(**data), CONSTRUCTORS["Experiment"]),
    "study": (lambda data: flexopt.Study(**data), CONSTRUCTORS["Study"]),
    "loop": (lambda data: flexopt.Loop(**data), CONSTRUCTORS["Loop"]),
}


def thawed(data: Any) -> Any:
    """A copy of lists and tables that can be changed."""
    if isinstance(data, dict):
        return {key: thawed(inner) for key, inner in data.items()}
    return [thawed(inner) for inner in data] if isinstance(data, list | tuple) else data


def places(data: Any) -> Iterator[tuple[Any, Any, str]]:
    """What holds each value, its key there, and the way to it: of each key in a list of tables the last alone."""
    found: dict[str, tuple[Any, Any, str]] = {}
    waiting: list[tuple[Any, str]] = [(data, "")]
    while waiting:
        inner, way = waiting.pop()
        keys: list[Any] = (
            list(inner) if isinstance(inner, dict) else list(range(len(inner))) if isinstance(inner, list) else []
        )
        for key in keys:
            found[re.sub(r"\.\d+", ".*", f"{way}.{key}")] = (inner, key, f"{way}.{key}")
            waiting.append((inner[key], f"{way}.{key}"))
    yield from found.values()


def raw_errors(make: Callable[[Any], Any], data: Any) -> list[str]:
    """Places and values at which another exception than flexopt's comes."""
    found: list[str] = []
    for inner, key, way in places(data):
        good = inner[key]
        for value in VALUES:
            inner[key] = value
            try:
                make(thawed(data))
            except flexopt.FlexoptError:
                pass
            except Exception as error:  # noqa: BLE001, RUF100  # any other is what this looks for
                found.append(f"{way} = {str(value)[:20]}: {type(error).__name__}: {error}")
        inner[key] = good
    return found


@pytest.mark.parametrize("kind", [pytest.param(kind, id=kind) for kind in TABLES])
def test_wrong_types_anywhere(kind: str) -> None:
    make, good = TABLES[kind]
    data = thawed(good())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", flexopt.FlexoptWarning)
        assert len(list(places(data))) >= 10
        assert raw_errors(make, data) == []


EDGES = ("5e-324", "1e-300", "1e-29", "-1e-12", "0", "1e30", "1e400", "nan")


@pytest.mark.parametrize("file", ["slewing-excavator.urdf", "truck-crane.xml", "mobile-manipulator.xml"])
def test_edges_of_numbers_in_robot_files(file: str, tmp_path: Path) -> None:
    """The last of each attribute of each element is given numbers as large and as small as can be written."""
    name = file.partition(".")[0]
    overlay = (MODELS / f"{name}.toml").read_text(encoding="utf-8").replace("robots/", "")
    (tmp_path / "machine.toml").write_text(overlay, encoding="utf-8")
    root = ElementTree.parse(MODELS / "robots" / file).getroot()
    numbers = {
        (element.tag, key, len(text.split())): (element, key, text)
        for element in root.iter()
        for key, text in element.attrib.items()
        if re.fullmatch(r"[-+.\de\s]+", text)
    }
    assert len(numbers) >= 8
    found: list[str] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", flexopt.FlexoptWarning)
        for element, key, text in numbers.values():
            for edge in EDGES:
                element.set(key, " ".join([edge, *text.split()[1:]]))
                (tmp_path / file).write_text(ElementTree.tostring(root, encoding="unicode"), encoding="utf-8")
                try:
                    flexopt.load(tmp_path / "machine.toml")
                except flexopt.FlexoptError:
                    pass
                except Exception as error:  # noqa: BLE001, RUF100  # any other is what this looks for
                    found.append(f"<{element.tag}> {key} = {edge}: {type(error).__name__}: {error}")
            element.set(key, text)
    assert found == []


def test_a_raw_error_is_found() -> None:
    def careless(data: Any) -> Any:
        return len(data["a"])

    assert raw_errors(careless, {"a": [1]}) == [
        ".a = None: TypeError: object of type 'NoneType' has no len()",
        f".a = {str(10**400)[:20]}: TypeError: object of type 'int' has no len()",
    ]


@pytest.mark.parametrize("name", ["boom-stick-bucket", "slewing-excavator", "truck-crane"])
def test_a_number_too_large_for_a_double_is_beyond_a_limit(name: str) -> None:
    machine = flexopt.load(name)
    low, high = np.transpose(machine.limits)
    middle = [float(q) for q in np.clip(np.zeros(len(low)), low, high)]
    for k in range(len(middle)):
        for value in (10**400, -(10**400)):
            with pytest.raises(flexopt.InputError, match="posture"):
                flexopt.evaluate(machine, [*middle[:k], value, *middle[k + 1 :]])
