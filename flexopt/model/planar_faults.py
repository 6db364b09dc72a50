"""Faults of a planar machine file that concern several keys at once."""

from __future__ import annotations

from typing import Any, Literal

from flexopt.errors import Fault
from flexopt.model.file_model import FileTable, quoted, table_of, tables_of
from flexopt.model.part_faults import capsule_faults, cylinder_faults

BASE_DIRECTIONS: tuple[Literal["x", "y", "rotation"], ...] = ("x", "y", "rotation")
# What coordinates and parameters that are no link's are called.
RESERVED_LINK_NAMES = ("base", "payload", "gravity", *(f"base.{direction}" for direction in BASE_DIRECTIONS))


def machine_faults(data: FileTable) -> list[Fault]:
    """Faults that concern several keys at once; looked for even where single keys are faulty."""
    base = table_of(data.get("base"))
    stiffness, damping = table_of(base.get("stiffness")), table_of(base.get("damping"))
    faults = [
        Fault(f"base.damping.{direction}", f"needs base.stiffness.{direction}; without it the base is rigid")
        for direction in damping
        if direction in BASE_DIRECTIONS and direction not in stiffness
    ]
    links = tables_of(data.get("links"))
    if links and all(links):
        faults += _link_faults(links)
        faults += capsule_faults(data, ["base", *(link.get("name") for link in links)], 2)
        passive = [link for link in links if link.get("passive") is True]
        hinges = {str(link.get("name")): "hinge" for link in links if link not in passive}
        faults += cylinder_faults(data, hinges, [link.get("name") for link in passive], 2)
        count = len(links) - len(passive)
        if count < 2:
            sentence = (
                "an end-point in the plane, with two task rows x and y, needs at least two; add a link or make a "
                "passive one actuated, or describe a tree whose end_point.rows are fewer"
            )
            faults.append(Fault("links (actuated joints)", sentence, str(count)))
        gives = any(stiffness.get(direction) is not None for direction in BASE_DIRECTIONS)
        if base and not passive and not gives:
            faults.append(
                Fault("base.stiffness", "no passive coordinate: give x, y or rotation, or make a joint passive")
            )
    return faults


def _link_faults(links: list[dict[str, Any]]) -> list[Fault]:
    faults: list[Fault] = []
    names: list[str] = []
    for index, link in enumerate(links):
        name = link.get("name")
        where = f"links[{index}] ({name})"
        if isinstance(name, str):
            if name in RESERVED_LINK_NAMES or not name.strip():
                faults.append(Fault(f"{where}.name", "is reserved or blank; choose another", quoted(name)))
            if name in names:
                faults.append(Fault(f"{where}.name", "is taken by an earlier link; names must differ", quoted(name)))
            names.append(name)
        if link.get("passive") is True:
            if "stiffness" not in link:
                faults.append(Fault(f"{where}.stiffness", "a passive joint needs one, in N m/rad"))
            wrong = [key for key in ("limits", "effort", "speed", "joint_damping") if key in link]
            reason = "belongs to an actuated joint; a passive one has stiffness, damping and rest"
        else:
            wrong = [key for key in ("stiffness", "damping", "rest") if key in link]
            reason = "belongs to a passive joint; add passive = true"
        faults += [Fault(f"{where}.{key}", reason, quoted(link[key])) for key in wrong]
    return faults
