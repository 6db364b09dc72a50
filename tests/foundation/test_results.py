"""Results as documents: keys, units, tables of notebooks."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from html.parser import HTMLParser
from importlib import import_module
from pkgutil import walk_packages

import numpy as np
import pytest

import flexopt
from flexopt.foundation.escapes import markup
from flexopt.foundation.results import Result


@dataclass(frozen=True)
class Inner(Result):
    DOCUMENT = "size[m]"

    size: float
    hidden: float = 0.0


@dataclass(frozen=True)
class Outer(Result):
    DOCUMENT = "name inner many poles nested.first=pair nested.second=inner.size[m] nothing"

    name: str
    inner: Inner
    many: np.ndarray
    poles: tuple[complex, ...]
    pair: tuple[float, float]
    nothing: None = None


OUTER = Outer("<b>rig</b>", Inner(2.5), np.zeros((20, 3)), (1 - 2j,), (math.nan, math.inf))


class Cells(HTMLParser):
    """Texts of a table's cells."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: object) -> None:
        assert tag in {"table", "tbody", "tr", "th", "td", "pre", "details", "summary"}
        if tag == "tr":
            self.rows.append([])
        if tag in {"th", "td"}:
            self.rows[-1].append("")

    def handle_data(self, data: str) -> None:
        if self.rows and self.rows[-1]:
            self.rows[-1][-1] += data.strip()


def test_a_document_has_its_keys_in_order_and_plain_data() -> None:
    document = OUTER.to_dict()
    assert list(document) == ["name", "inner", "many", "poles", "nested", "nothing"]
    assert document["inner"] == {"size": 2.5}
    assert document["poles"] == [[1.0, -2.0]]
    assert document["nested"] == {"first": [None, None], "second": 2.5}


def test_a_table_shows_names_numbers_and_units_and_nobodys_markup() -> None:
    rows = {row[0]: row[1:] for row in Cells(OUTER._repr_html_()).rows}
    assert rows["name"] == ["<b>rig</b>", ""]
    assert rows["many"] == ["20 × 3 entries", ""]
    assert rows["nested.second"] == ["2.5", "m"]
    assert rows["inner.size"] == ["2.5", "m"]
    assert rows["nothing"] == ["–", ""]


def _kinds(kind: type[Result]) -> Iterator[type[Result]]:
    for each in kind.__subclasses__():
        yield each
        yield from _kinds(each)


def test_every_key_of_every_result_is_an_attribute_of_it() -> None:
    for module in walk_packages(flexopt.__path__, "flexopt."):
        import_module(module.name)
    own = {kind for kind in _kinds(Result) if kind.__module__.startswith("flexopt.")}
    assert len(own) > 15
    for kind in own:
        assert is_dataclass(kind)
        known = {field.name for field in fields(kind)} | set(dir(kind))
        asked = {attribute.partition(".")[0] for _, attribute, _ in kind.document_keys()}
        assert asked <= known, kind


@pytest.mark.parametrize("name", ["excavator", "slewing-excavator"])
def test_an_evaluation_shows_itself_in_a_notebook(name: str) -> None:
    machine = flexopt.load(name)
    posture = [0.4, 0.7, -1.2, -0.5][-len(machine.joints) :]
    evaluation = flexopt.evaluate(machine, posture)
    rows = {row[0]: row[1:] for row in Cells(evaluation._repr_html_()).rows}
    assert rows["machine"][0] == machine.name
    assert rows["frequencies_hz"][1] == "Hz"
    assert rows["epsilon_max"][0] == f"{evaluation.epsilon_max:.6g}"
    assert not any(key.startswith("provenance") for key in rows)
    # What it says of itself as text stays in sight.
    lines = evaluation._repr_html_().splitlines()
    assert all(markup(line) in lines for line in repr(evaluation).splitlines())
