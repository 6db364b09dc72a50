"""Every public function, class and method that users call has an example in its docstring, and all of them run."""

from __future__ import annotations

import doctest
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import flexopt
from docs.public import documented

FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
PUBLIC = documented()
# Whose examples go on from those of the call that makes them: the call takes seconds.
MADE_BY = {
    "Atlas": "atlas",
    "BasePlan": "plan_base",
    "BaseTrajectory": "nullspace_trajectory",
    "ExportReport": "export_c",
    "FmuReport": "export_fmu",
    "Gridded": "map_workspace",
    "Identification": "identify",
    "Printed": "verdict",
    "Report": "report",
    "StudyResult": "Study",
    "open_study": "Study",
    "run_study": "Study",
    "Verdict": "verdict",
    "Verification": "verify_bundle",
    "WorkspaceMap": "map_workspace",
}


def examples(named: Any) -> list[doctest.Example]:
    """Those in the docstring itself, not an inherited one, that run."""
    docstring = (vars(named)["__doc__"] if isinstance(named, type) else named.__doc__) or ""
    found = doctest.DocTestParser().get_examples(docstring)
    return [example for example in found if not example.options.get(doctest.SKIP)]


def without(names: dict[str, Any]) -> list[str]:
    return [name for name, named in names.items() if not examples(named)]


def first_of(name: str) -> str:
    """Whose example starts those that `name` is part of: a class's that of its methods, a call's that of its result."""
    owner = name.partition(".")[0]
    return MADE_BY.get(owner, owner)


def sequences() -> dict[str, list[str]]:
    """Names whose examples run one after the other, by the first; inherited methods by themselves."""
    found: dict[str, list[str]] = {}
    for name in sorted(PUBLIC, key=lambda name: (name not in MADE_BY.values(), "." in name)):
        found.setdefault(first_of(name), []).append(name)
    return found


SEQUENCES = sequences()


def test_everything_public_has_an_example() -> None:
    assert len(PUBLIC) > 130
    assert without(PUBLIC) == []

    class Bare:
        """No example."""

        def skipped(self) -> None:
            """One that is not run.

            >>> 1 + 1  # doctest: +SKIP
            3
            """

    assert without({"Bare": Bare, "Bare.skipped": Bare.skipped}) == ["Bare", "Bare.skipped"]


@pytest.mark.long(
    "report",
    "verdict",
    "verify_bundle",
    "map_workspace",
    "Ensemble",
    "SelectionProblem",
    "simulate_ensemble",
    "export_fmu",
    "identify",
    "Actuator",
)
@pytest.mark.parametrize("first", SEQUENCES)
def test_the_examples_run(first: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In an empty folder, with what the reference's first page says is imported."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"flexopt": flexopt, "np": np, "ca": ca}
    said: list[str] = []
    for name in SEQUENCES[first]:
        test = doctest.DocTest(examples(PUBLIC[name]), names, name, None, None, None)
        doctest.DocTestRunner(optionflags=FLAGS, verbose=False).run(test, out=said.append, clear_globs=False)
        names |= test.globs
    assert not said, "".join(said)
