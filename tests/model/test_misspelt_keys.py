"""A misspelt key is one fault: what is missing or wrong for want of it alone is none of its own."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

import flexopt
from flexopt.model.files import shipped_folder


def faults(text: str) -> list[str]:
    with pytest.raises(flexopt.ModelError) as caught:
        flexopt.machine_from_dict(tomllib.loads(text))
    return [str(fault) for fault in caught.value.faults]


@pytest.mark.parametrize(
    ("right", "wrong", "expected"),
    [
        ("length", "lenght", ["base.lenght: unknown key; did you mean 'length'?"]),
        # Its parts are looked at as if it were written right, and so is what needs it: dampers need springs.
        ("[base.stiffness]", "[base.stifness]", ["base.stifness: unknown key; did you mean 'stiffness'?"]),
        (
            "[base.stiffness]\nx = 4e7",
            "[base.stifness]\nx = 'soft'",
            ["base.stifness: unknown key; did you mean 'stiffness'?", "base.stiffness.x = 'soft': must be a number"],
        ),
        # A table in two parts, of which one is misspelt.
        ("[base]", "[bas]", ["bas: unknown key; did you mean 'base'?"]),
        # Links without names get theirs then, too.
        ("[[links]]", "[[lnks]]", ["lnks: unknown key; did you mean 'links'?"]),
        # A key that is there twice, once misspelt, explains nothing.
        ("mass = 5291.5", "mass = 5291.5\nmas = 1.0", ["base.mas: unknown key; did you mean 'mass'?"]),
        ("mass = 5291.5", "weight = 5291.5", ["base.mass: is required and missing", "base.weight: unknown key"]),
    ],
)
def test_one_fault_for_each(right: str, wrong: str, expected: list[str]) -> None:
    text = (shipped_folder("models") / "excavator.toml").read_text(encoding="utf-8")
    text = text.replace(right, wrong).replace('name = "boom"', "")
    found = faults(text.replace("lenght", "length").replace("length", "lenght", 1) if wrong == "lenght" else text)
    assert len(found) == len(expected), found
    assert all(each.startswith(start) for each, start in zip(found, expected, strict=True)), found


def test_a_problems_target(tmp_path: Path) -> None:
    """With the faults that the target has itself, of the machine, too."""
    text = (shipped_folder("problems") / "article.toml").read_text(encoding="utf-8")
    path = tmp_path / "problem.toml"
    path.write_text(text.replace("[target]", "[targt]").replace("[0.0, 1.6]", "[0.0, 1.6, 2.0]"), encoding="utf-8")
    with pytest.raises(flexopt.ModelError) as caught:
        flexopt.load_problem(path)
    one, other = caught.value.faults
    assert str(one) == "targt: unknown key; did you mean 'target'?"
    assert (other.field, other.value) == ("target.end_point", "[0.0, 1.6, 2.0]")
