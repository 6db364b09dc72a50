"""Faults of hydraulic cylinders: what single keys do not show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

from flexopt.errors import Fault, ModelError, raise_if_any
from flexopt.model.machine import AnyMachine

HINGE_KEYS = ("base_point", "rod_point", "rocker")


def cylinder_faults(
    data: Mapping[str, Any], joints: Mapping[str, Any], passive: Sequence[Any], dimension: int
) -> list[Fault]:
    """Faults of `[[cylinders]]` as they were written.

    Args:
        data: the file's tables.
        joints: kind of each actuated joint.
        passive: names of the passive ones.
        dimension: coordinates of a point, 2 or 3.
    """
    value = data.get("cylinders")
    faults: list[Fault] = []
    names: list[str] = []
    driven: dict[str, str] = {}
    for index, entry in enumerate(cast(Sequence[Any], value) if isinstance(value, list | tuple) else ()):
        if not isinstance(entry, dict):
            continue
        table = cast(dict[str, Any], entry)
        name, joint = table.get("name"), table.get("joint")
        where = f"cylinders[{index}]" + (f" ({name})" if isinstance(name, str) and name else "")
        if isinstance(name, str) and name in names:
            faults.append(Fault(f"{where}.name", "is taken by an earlier cylinder; names must differ", repr(name)))
        names += [name] if isinstance(name, str) else []
        faults += _pin_faults(where, table, dimension)
        if not isinstance(joint, str) or not joint:
            continue
        if joint not in joints:
            listed = f"the actuated joints are {', '.join(joints)}"
            why = "is a passive joint, which nothing drives" if joint in passive else "is no joint's name"
            faults.append(Fault(f"{where}.joint", f"{why}; {listed}", repr(joint)))
            continue
        if joint in driven:
            faults.append(Fault(f"{where}.joint", f"is driven by {driven[joint]!r} already", repr(joint)))
        driven.setdefault(joint, str(name))
        faults += _geometry_faults(where, table, joints[joint])
    return faults


def _geometry_faults(where: str, table: dict[str, Any], kind: Any) -> list[Fault]:
    if kind == "slide":
        sentence = "belongs to the cylinder of a hinge; that of a slide is as long as `offset` + q"
        return [Fault(f"{where}.{key}", sentence) for key in HINGE_KEYS if key in table]
    faults = [] if "base_point" in table else [Fault(f"{where}.base_point", "is required and missing")]
    if ("rod_point" in table) == ("rocker" in table):
        faults.append(Fault(where, "needs either rod_point or, with a linkage, rocker"))
    if "offset" in table:
        faults.append(Fault(f"{where}.offset", "belongs to the cylinder of a slide", repr(table["offset"])))
    return faults


def _pin_faults(where: str, table: dict[str, Any], dimension: int) -> list[Fault]:
    rocker = cast(dict[str, Any], table["rocker"]) if isinstance(table.get("rocker"), dict) else {}
    pins = {key: table.get(key) for key in ("base_point", "rod_point")}
    pins |= {f"rocker.{key}": rocker.get(key) for key in ("pivot", "coupler_point")}
    wanted = "two numbers [along, left]" if dimension == 2 else "three numbers [x, y, z]"
    return [
        Fault(f"{where}.{key}", f"must be {wanted} in m", repr(list(cast(Sequence[Any], pin))))
        for key, pin in pins.items()
        if isinstance(pin, list | tuple) and len(cast(Sequence[Any], pin)) == 5 - dimension
    ]


def check_strokes(machine: AnyMachine, origin: str) -> None:
    """Raise where a cylinder's stroke or linkage does not go together with the limits of its joint.

    Raises:
        ModelError: lists every fault.
    """
    raise_if_any(ModelError, origin, machine.stroke_faults())
