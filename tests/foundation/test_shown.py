"""How objects show themselves: every result as a table that scrolls, short texts, and completion without Pydantic."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from html.parser import HTMLParser
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages

import pytest
from pydantic import BaseModel

import flexopt
from flexopt.foundation.results import COLUMNS, Result, Tabled
from flexopt.model.file_model import FileModel
from tests.boundary.calls import OBJECTS

# Of a page of 120 columns; the tables of what results print.
LETTERS_MAX, LINES_MAX = 1900, 20
# Of what is no result, one line of a notebook.
LINE_MAX = 200
# Objects that are asked to do things, and things to ask with: no results.
TOOLS = {
    "Actuator", "Constraint", "Experiment", "Hydraulics", "Machine", "Measures", "Path", "Plant", "Problem",
    "SelectionOptions", "SelectionProblem", "Sensor", "Study", "Tree", "Vary",
}  # fmt: skip


class Page(HTMLParser):
    """Tags in order with their styles, and whether all are closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.styles: list[tuple[str, str]] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.open.append(tag)
        self.styles.append((tag, dict(attrs).get("style") or ""))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def objects(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, object]]:
    """An object of each public class that has some; files go into a folder of their own."""
    before = Path.cwd()
    os.chdir(tmp_path_factory.mktemp("objects"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield {name: make() for name, make in OBJECTS.items()}
    os.chdir(before)


def below(kind: type) -> Iterator[type]:
    for each in kind.__subclasses__():
        yield each
        yield from below(each)


@pytest.mark.long
def test_every_result_is_a_table_that_scrolls(objects: dict[str, object]) -> None:
    # The explorer shows its page.
    shown = {name: found for name, found in objects.items() if name not in TOOLS | {"Explorer"}}
    assert len(shown) > 15
    for name, found in shown.items():
        assert isinstance(found, Tabled), name
        page = Page(found._repr_html_())
        assert page.open == [], name
        (table,) = [style for tag, style in page.styles if tag == "table"]
        assert "white-space: nowrap" in table, name
        assert "overflow-x: auto" in table, name
        own = type(found).__repr__ is not Result.shortly
        blocks = [style for tag, style in page.styles if tag == "pre"]
        assert bool(blocks) == own, name
        # Notebooks otherwise choose letters of many widths, and break words anywhere.
        assert all("font-family: monospace" in style and "word-break: normal" in style for style in blocks), name
        wide = any(COLUMNS.search(line.strip()) for line in repr(found).splitlines())
        assert not own or any("overflow-x: auto" in style for style in blocks) == wide, name


@pytest.mark.long
def test_texts_are_short(objects: dict[str, object]) -> None:
    for name, found in objects.items():
        text = repr(found)
        assert len(text) <= LETTERS_MAX, (name, text)
        assert len(text.splitlines()) <= LINES_MAX, (name, text)
        if name in TOOLS:
            assert len(text) <= LINE_MAX, (name, text)
            assert "\n" not in text, (name, text)


def test_no_class_of_results_prints_what_dataclasses_print() -> None:
    """Whole arrays, that is: every class has a text of its own, or the short one."""
    for module in walk_packages(flexopt.__path__, "flexopt."):
        import_module(module.name)
    kinds = [kind for kind in below(Result) if kind.__module__.startswith("flexopt.")]
    assert len(kinds) > 25
    assert [kind for kind in kinds if hasattr(kind.__repr__, "__wrapped__")] == []
    assert any(kind.__repr__ is Result.shortly for kind in kinds)


def test_the_short_text_names_the_first_keys_with_units() -> None:
    found = flexopt.outcome(flexopt.load("excavator"), [1.0, -2.0], loop={"kp": 1e4, "kv": 1e3}).settings
    assert Result.shortly(found).startswith(
        "LoopSettings(control=inverse, feedback=pd, drive=torque, kp=[10000, 10000]"
    )
    assert "rate=" in Result.shortly(found)
    assert " Hz" in Result.shortly(found)
    assert len(Result.shortly(found)) < 260


@pytest.mark.long
def test_completion_offers_what_a_table_has(objects: dict[str, object]) -> None:
    tables = [found for found in objects.values() if isinstance(found, FileModel)]
    assert len(tables) > 5
    pydantic = {name for name in dir(BaseModel) if not name.startswith("_")}
    for found in tables:
        offered = {name for name in dir(found) if not name.startswith("_")}
        assert not offered & pydantic
        assert set(type(found).model_fields) <= offered
    machine = objects["Machine"]
    assert {"joints", "limits", "links", "base", "to_dict", "content_hash", "parameters"} <= set(dir(machine))
    # What is not offered is there all the same.
    assert machine.model_dump()["name"] == "boom-stick-bucket"


def test_a_table_prints_what_is_not_at_its_default() -> None:
    assert repr(flexopt.Sensor()) == "Sensor()"
    assert repr(flexopt.Sensor(noise=0.1)) == "Sensor(noise=0.1)"
    assert repr(flexopt.load_problem("article")) == "Problem('article' about machine 'excavator')"


@pytest.mark.parametrize("limits", [(-2.00006, 2.00007), (-2.00004, 2.00003), (-2.5, 2.5)])
def test_a_posture_at_its_limits_can_be_given_as_texts_tell_it(limits: tuple[float, float]) -> None:
    """Four digits after the point may round a limit outwards; what is farther beyond is a fault."""
    data = flexopt.load("excavator").to_dict()
    data["links"][1]["limits"] = limits
    machine = flexopt.machine_from_dict(data)
    for limit, out in zip(limits, (-1.0, 1.0), strict=True):
        told = float(f"{limit:.4f}")
        found = flexopt.evaluate(machine, [0.3, told])
        # Inwards it is the number given.
        assert found.posture[1] == (limit if (told - limit) * out > 0 else told)
        assert f"{told:.4f}" in str(found)
        with pytest.raises(flexopt.InputError, match="must lie between"):
            flexopt.evaluate(machine, [0.3, limit + 1.1e-4 * out])
