"""Faults of cylinders and capsules, in the plane and in space: what single keys do not show."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from flexopt.errors import Fault
from flexopt.foundation.nearest import hint_or_list
from flexopt.foundation.quantities import entries
from flexopt.model.file_model import FileTable, named, quoted, table_of, tables_of

HINGE_KEYS = ("base_point", "rod_point", "rocker")


def cylinder_faults(data: FileTable, joints: FileTable, passive: Sequence[Any], dimension: int) -> list[Fault]:
    """Faults of `[[cylinders]]` as they were written.

    Args:
        data: the file's tables.
        joints: kind of each actuated joint.
        passive: names of the passive ones.
        dimension: coordinates of a point, 2 or 3.
    """
    faults: list[Fault] = []
    names: list[str] = []
    driven: dict[str, str] = {}
    for index, table in enumerate(tables_of(data.get("cylinders"))):
        if not table:
            continue
        name, joint, where = table.get("name"), table.get("joint"), named("cylinders", index, table)
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


def _geometry_faults(where: str, table: FileTable, kind: Any) -> list[Fault]:
    if kind == "slide":
        sentence = "belongs to the cylinder of a hinge; that of a slide is as long as `offset` + q"
        return [Fault(f"{where}.{key}", sentence) for key in HINGE_KEYS if key in table]
    faults = [] if "base_point" in table else [Fault(f"{where}.base_point", "is required and missing")]
    if ("rod_point" in table) == ("rocker" in table):
        faults.append(Fault(where, "needs either rod_point or, with a linkage, rocker"))
    if "offset" in table:
        faults.append(Fault(f"{where}.offset", "belongs to the cylinder of a slide", repr(table["offset"])))
    return faults


def _pin_faults(where: str, table: FileTable, dimension: int) -> list[Fault]:
    rocker = table_of(table.get("rocker"))
    pins = {key: table.get(key) for key in ("base_point", "rod_point")}
    return _size_faults(
        where, pins | {f"rocker.{key}": rocker.get(key) for key in ("pivot", "coupler_point")}, dimension
    )


def _size_faults(where: str, places: FileTable, dimension: int) -> list[Fault]:
    """Places in the plane that have three coordinates, or places in space that have two."""
    wanted = "two numbers [along, left]" if dimension == 2 else "three numbers [x, y, z]"
    return [
        Fault(f"{where}.{key}", f"must be {wanted} in m", quoted(place))
        for key, place in places.items()
        if len(entries(place)) == 5 - dimension
    ]


def capsule_faults(data: FileTable, bodies: list[Any], dimension: int) -> list[Fault]:
    """Capsules of bodies that are not there, and ends with too few or too many coordinates."""
    faults = unknown_bodies(data, "capsules", bodies)
    for index, capsule in enumerate(tables_of(data.get("capsules"))):
        faults += _size_faults(f"capsules[{index}]", {key: capsule.get(key) for key in ("start", "end")}, dimension)
    return faults


def unknown_bodies(data: FileTable, word: str, bodies: list[Any]) -> list[Fault]:
    """Tables, capsules say, of bodies that are not there."""
    faults: list[Fault] = []
    for index, table in enumerate(tables_of(data.get(word))):
        body = table.get("body")
        if isinstance(body, str) and body and body not in bodies:
            meant = hint_or_list(body, [name for name in bodies if isinstance(name, str)])
            faults.append(Fault(f"{word}[{index}].body", f"is no body's name{meant}", quoted(body)))
    return faults
