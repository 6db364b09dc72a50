"""A machine with other numbers: values of parameters, by name, put back into its description.

In: a machine and values by the names of `Machine.parameters`. Out: the machine as if its file had said them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.nearest import hint
from flexopt.foundation.plain import shown
from flexopt.model.hydraulics import AXES
from flexopt.model.kinematic_tree import INERTIA_ENTRIES

if TYPE_CHECKING:
    from flexopt.model.machine import AnyMachine

# Keys and indices from a description's top to a number.
KeyPath = tuple[str | int, ...]


def with_parameters(machine: AnyMachine, values: Mapping[str, float]) -> AnyMachine:
    """The machine with these parameters, SI, by their names; all others as they were.

    Raises:
        InputError: no such parameter, one that no key of the description holds alone, or a value that it cannot have.
    """
    told, faults = machine.model_dump(by_alias=True), list[Fault]()
    known = [parameter.name for parameter in machine.parameters]
    for name, value in values.items():
        if name not in known:
            faults.append(Fault(name, f"is no parameter of {machine.name}{hint(name, known)}"))
            continue
        found_at = list(places(told, name))
        for *outer, last in found_at:
            inside: Any = told
            for key in outer:
                inside[key] = list(inside[key]) if isinstance(inside[key], tuple) else inside[key]
                inside = inside[key]
            inside[last] = value
        if not found_at:
            faults.append(Fault(name, "cannot be set alone", shown(value)))
    raise_if_any(InputError, "with_values", faults)
    found = type(machine)(**told)
    now = {parameter.name: parameter.value for parameter in found.parameters}
    missed = [name for name, value in values.items() if now.get(name) != value]
    raise_if_any(InputError, "with_values", [Fault(name, "cannot be set alone") for name in missed])
    return found


def places(told: dict[str, Any], name: str) -> Iterator[KeyPath]:
    """Where a description holds a parameter."""
    if name == "payload.mass":
        yield ("payload", "mass")
    elif name == "gravity":
        yield ("gravity",)
    elif found := list(_in_cylinders(told, name)):
        yield from found
    elif "links" in told:
        yield from _in_chain(told, name)
    else:
        yield from _in_tree(told, name)


def _in_cylinders(told: dict[str, Any], name: str) -> Iterator[KeyPath]:
    for i, cylinder in enumerate(told["cylinders"]):
        owner, _, key = name.removeprefix(f"{cylinder['name']}.").rpartition(".")
        at = ("cylinders", i, *(owner.split(".") if owner else ()))
        if name.startswith(f"{cylinder['name']}."):
            yield (*at, AXES.index(key)) if key in AXES else (*at, key)


def _in_chain(told: dict[str, Any], name: str) -> Iterator[KeyPath]:
    owner, _, key = name.partition(".")
    if owner == "base":
        table, _, direction = key.partition(".")
        yield ("base", table, direction) if direction else ("base", table)
        return
    for i, link in enumerate(told["links"]):
        if name == f"{link['name']}.{key}" and key in link:
            yield ("links", i, key)


def _in_tree(told: dict[str, Any], name: str) -> Iterator[KeyPath]:
    for word in ("stiffness", "damping"):
        coupling = told.get(f"{word}_matrix") or {"joints": ()}
        for i, a in enumerate(coupling["joints"]):
            for j, b in enumerate(coupling["joints"][i:], i):
                if name == f"{word}.{a}.{b}":
                    yield from {(f"{word}_matrix", "matrix", i, j), (f"{word}_matrix", "matrix", j, i)}
    owner, _, key = name.rpartition(".")
    if owner == "end_point.position" and key in "xyz":
        yield ("end_point", "position", "xyz".index(key))
    for i, body in enumerate(told["bodies"]):
        if owner == body["joint"]["name"] and key in ("armature", "stiffness", "damping", "joint_damping", "rest"):
            yield ("bodies", i, "joint", key)
        elif name == f"{body['name']}.mass":
            yield ("bodies", i, "mass")
        elif owner == f"{body['name']}.inertia" and key in INERTIA_ENTRIES:
            yield ("bodies", i, "inertia", INERTIA_ENTRIES.index(key))
        elif owner in (f"{body['name']}.position", f"{body['name']}.com") and key in "xyz":
            yield ("bodies", i, owner.rpartition(".")[2], "xyz".index(key))
