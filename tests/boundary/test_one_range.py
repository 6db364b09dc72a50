"""What a file's key may be is what the call's argument of that name may be: the same sentence refuses both."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from typing import Any

import pytest

import flexopt
from flexopt.errors import InputError
from flexopt.model.file_model import FileModel, validated
from flexopt.model.simulation import NullspaceOptions
from flexopt.model.targets import PathMotion
from tests.boundary.calls import POSTURE, TARGET, excavator

# How many of these there must be, or what they are bounded by, is the machine's to say.
OF_MACHINE = {"base", "posture", "start", "base_range"}
CASES: list[tuple[type[FileModel], Callable[..., Any], dict[str, Any], int]] = [
    (flexopt.SelectionOptions, flexopt.select, {"target": TARGET}, 5),
    (flexopt.SelectionOptions, flexopt.select_stand, {"targets": [TARGET], "combine": "weighted"}, 4),
    (PathMotion, flexopt.plan_base, {"path": [TARGET, TARGET]}, 4),
    (NullspaceOptions, flexopt.nullspace_trajectory, {"posture": POSTURE}, 3),
]


def sentences(name: str, read: Callable[[], object]) -> set[str]:
    """What is said about that name."""
    with pytest.raises(InputError) as caught:
        read()
    return {fault.sentence for fault in caught.value.faults if fault.field == name}


@pytest.mark.parametrize(("model", "call", "good", "least"), CASES)
def test_the_same_range(model: type[FileModel], call: Callable[..., Any], good: dict[str, Any], least: int) -> None:
    both = (model.model_fields.keys() & inspect.signature(call).parameters.keys()) - OF_MACHINE
    compared: set[str] = set()
    for name in sorted(both):
        for bad in (math.nan, 1e300, -1e300):
            of_file = sentences(name, lambda n=name, b=bad: validated(model, {n: b}, "file", kind=InputError))
            if not any("number" in each or "must lie" in each or "must be greater" in each for each in of_file):
                continue  # a word or a flag
            compared.add(name)
            of_call = sentences(name, lambda n=name, b=bad: call(excavator(), **good | {n: b}))
            assert of_call == of_file, (name, bad)
    assert len(compared) >= least
