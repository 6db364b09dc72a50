"""The range of a parameter, which exported C and FMUs hold, is the range of the key that it comes from."""

from __future__ import annotations

import json
from itertools import pairwise
from typing import Any, cast

import pytest

import flexopt
from flexopt.errors import Fault, ModelError
from flexopt.model import machine_from_dict, shipped_names, tree_from_dict
from flexopt.model.parameter_ranges import parameter_range

BODY, JOINT = ("position", "mass", "com", "inertia"), ("stiffness", "damping", "rest", "joint_damping", "armature")
ENTRIES: dict[str | int, int] = dict(
    zip(("x", "y", "z", "xx", "yy", "zz", "xy", "xz", "yz"), (0, 1, 2, *range(6)), strict=True)
)
BOUNDS = ("must lie between", "must be greater than")


def place(machine: flexopt.Machine | flexopt.Tree, name: str) -> list[str | int]:
    """Keys and indices that lead to a parameter in the machine's dictionary."""
    found: list[str | int] = list(name.split("."))
    for table in ("links", "cylinders", "bodies"):
        for index, entry in enumerate(machine.to_dict().get(table, ())):
            inner: dict[str, Any] = entry.get("joint", {}) if table == "bodies" else {}
            for owner, within, known in ((entry, (), BODY), (inner, ("joint",), JOINT)):
                keys = name.removeprefix(f"{owner.get('name')}.").split(".")
                if len(keys) < len(name.split(".")) and (table != "bodies" or keys[0] in known):
                    found = [table, index, *within, *keys]
    if len(found) > 1 and found[-2] not in ("stiffness", "damping"):
        found[-1] = ENTRIES.get(found[-1], found[-1])
    return found


def faults_of(machine: flexopt.Machine | flexopt.Tree, path: list[str | int], value: float) -> list[Fault]:
    """What is wrong with the machine where one number is another."""
    data = json.loads(machine.model_dump_json(by_alias=True, exclude_defaults=True))
    here: Any = data
    for key, inner in pairwise(path):
        if isinstance(here, dict) and key not in here:
            here[key] = [0.0] * (2 if isinstance(machine, flexopt.Machine) else 3) if isinstance(inner, int) else {}
        here = cast(Any, here[key])
    here[path[-1]] = value
    try:
        (machine_from_dict if isinstance(machine, flexopt.Machine) else tree_from_dict)(data)
    except ModelError as error:
        return list(error.faults)
    return []


@pytest.mark.long("slewing-excavator", "truck-crane", "mobile-manipulator", "boom-stick-bucket")
@pytest.mark.parametrize("name", shipped_names("models"))
def test_a_parameter_may_be_what_its_key_may_be(name: str) -> None:
    """But entries of matrices over joints, which are bounded together."""
    machine = flexopt.load(name)
    for parameter in machine.parameters:
        if parameter.name.startswith(("stiffness.", "damping.")):
            continue
        path, (low, high) = place(machine, parameter.name), parameter_range(parameter)
        assert low <= parameter.value <= high
        for end in (low, high):
            bounded = [f for f in faults_of(machine, path, end) if any(word in f.sentence for word in BOUNDS)]
            assert bounded == [], (parameter, end)
        # A body of a tree may have no mass: then it has no such parameter.
        below = low * (1 + 1e-9) if low < 0 else -1.0 if low == 0 or isinstance(machine, flexopt.Tree) else 0.0
        for beyond in (high * (1 + 1e-9), below):
            assert faults_of(machine, path, beyond), (parameter, beyond)
