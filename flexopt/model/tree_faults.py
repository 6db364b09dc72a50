"""Faults of a spatial machine that concern several fields at once."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from flexopt.errors import Fault
from flexopt.foundation.quantities import ANGLE, ANGLE_MAX, COORDINATE_MAX, degrees_hint, entries
from flexopt.model.file_model import named, quoted, table_of, tables_of
from flexopt.model.part_faults import capsule_faults, cylinder_faults, unknown_bodies
from flexopt.model.tree_quantities import check_square

# What messages call a body, and its table.
Bodies = list[tuple[str, dict[str, Any]]]


def tree_faults(data: dict[str, Any]) -> list[Fault]:
    """Faults that concern several fields at once; looked for even where single fields are faulty."""
    listed = tables_of(data.get("bodies"))
    bodies = [(named("bodies", index, body), body) for index, body in enumerate(listed) if body]
    if not listed:
        return [Fault("bodies", "at least one body is needed")] if isinstance(data.get("bodies"), tuple) else []
    names: list[Any] = [body.get("name") for _, body in bodies]
    links = [*names, *(body.get("parent") for _, body in bodies), table_of(data.get("end_point")).get("body")]
    # A name that is no text says nothing of what it names; the keys' own faults are told elsewhere.
    if len(bodies) != len(listed) or not all(isinstance(name, str | None) for name in links):
        return []
    faults = _order_faults(bodies) + _name_faults(bodies)
    coupled: dict[str, tuple[str, ...]] = {}
    passive = [_joint(body).get("name") for _, body in bodies if _joint(body).get("passive") is True]
    for word in ("stiffness", "damping"):
        table = table_of(data.get(f"{word}_matrix"))
        coupled[word] = tuple(name for name in entries(table.get("joints")) if isinstance(name, str))
        if table:
            faults += _matrix_faults(f"{word}_matrix", table, coupled[word], passive, definite=word == "stiffness")
    for where, body in bodies:
        faults += _joint_faults(where, _joint(body), coupled)
    faults += _massless_faults(bodies, data)
    faults += capsule_faults(data, names, 3) + unknown_bodies(data, "visuals", names)
    kinds = {str(_joint(b).get("name")): _joint(b).get("kind") for _, b in bodies if not _joint(b).get("passive")}
    faults += cylinder_faults(data, kinds, passive, 3)
    if not passive:
        faults.append(Fault("bodies", "no passive joint: at least one needs passive = true and a stiffness"))
    faults += _end_point_faults(table_of(data.get("end_point")), bodies)
    faults += _repeats("placement", data.get("placement"))
    return faults


def _joint(body: dict[str, Any]) -> dict[str, Any]:
    return table_of(body.get("joint"))


def _order_faults(bodies: Bodies) -> list[Fault]:
    faults: list[Fault] = []
    every, seen = {body.get("name") for _, body in bodies}, set[Any]()
    for where, body in bodies:
        parent = body.get("parent")
        if parent is not None and parent not in seen:
            why = "comes later; a body must follow its parent" if parent in every else "is no body's name"
            faults.append(Fault(f"{where}.parent", why, quoted(parent)))
        seen.add(body.get("name"))
    return faults


def _name_faults(bodies: Bodies) -> list[Fault]:
    faults: list[Fault] = []
    for what, names, suffix in (
        ("body", [body.get("name") for _, body in bodies], ".name"),
        ("joint", [_joint(body).get("name") for _, body in bodies], ".joint.name"),
    ):
        for k, ((where, _), name) in enumerate(zip(bodies, names, strict=True)):
            field = f"{where}{suffix}"
            if name in names[:k] and isinstance(name, str):
                faults.append(Fault(field, f"is taken by an earlier {what}; names must differ", quoted(name)))
            if name in ("payload", "gravity", "end_point", "stiffness", "damping"):
                faults.append(Fault(field, "is reserved; choose another", quoted(name)))
    return faults


def _joint_faults(where: str, joint: dict[str, Any], coupled: dict[str, tuple[str, ...]]) -> list[Fault]:
    faults: list[Fault] = []
    name = joint.get("name")
    if joint.get("passive") is True:
        if name in coupled["stiffness"]:
            if joint.get("stiffness") is not None:
                faults.append(Fault(f"{where}.joint.stiffness", "is given twice: stiffness_matrix names this joint"))
        elif joint.get("stiffness") is None:
            faults.append(Fault(f"{where}.joint.stiffness", "a passive joint needs one, in N m/rad or N/m"))
        if name in coupled["damping"] and joint.get("damping"):
            faults.append(Fault(f"{where}.joint.damping", "is given twice: damping_matrix names this joint"))
        wrong = [key for key in ("limits", "effort", "speed", "joint_damping") if joint.get(key)]
        reason = "belongs to an actuated joint; a passive one has stiffness, damping and rest"
    else:
        wrong = [key for key in ("stiffness", "damping", "rest") if joint.get(key)]
        reason = "belongs to a passive joint; add passive = true"
    faults += [Fault(f"{where}.joint.{key}", reason, quoted(joint[key])) for key in wrong]
    if joint.get("kind") == "hinge":
        for key, values in (("rest", [joint.get("rest")]), ("limits", entries(joint.get("limits")))):
            wide = [v for v in values if isinstance(v, int | float) and ANGLE_MAX < abs(v) <= COORDINATE_MAX]
            if wide:
                hint = degrees_hint("rad", max(wide, key=abs))
                faults.append(Fault(f"{where}.joint.{key}", f"{ANGLE.allowed}{hint}", quoted(joint[key])))
    return faults


def _matrix_faults(
    field: str, table: dict[str, Any], names: tuple[str, ...], passive: list[Any], *, definite: bool
) -> list[Fault]:
    faults = [
        Fault(f"{field}.joints", "is no passive joint's name", quoted(name)) for name in names if name not in passive
    ]
    faults += _repeats(f"{field}.joints", table.get("joints"))
    try:
        matrix = np.array(check_square(table.get("matrix")))
    except ValueError:
        return faults  # reported beside the field
    if len(matrix) != len(names):
        sentence = f"must be {len(names)} × {len(names)}, a row for each joint"
        return [*faults, Fault(f"{field}.matrix", sentence, f"{len(matrix)} × {len(matrix)}")]
    diagonal = np.diag(matrix)
    # In units of its diagonal, where metres and radians do not show.
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    least = float(np.linalg.eigvalsh(matrix / np.outer(scale, scale))[0])
    if (definite and least <= 1e-12) or least < -1e-12:
        word = "positive definite" if definite else "positive semidefinite"
        sentence = f"must be {word}; its least eigenvalue, scaled by its diagonal, is {least:.3g}"
        if definite and not diagonal.all():
            sentence += ": what is rigid is left out, of a [base] by a table of the directions that give"
        faults.append(Fault(f"{field}.matrix", sentence))
    return faults


def _massless_faults(bodies: Bodies, data: dict[str, Any]) -> list[Fault]:
    """Joints beyond which there is no mass."""
    carries = {body.get("name"): bool(body.get("mass")) or _any(body.get("inertia")) for _, body in bodies}
    payload = table_of(data.get("payload")).get("mass")
    if payload:
        carries[table_of(data.get("end_point")).get("body")] = True
    for _, body in reversed(bodies):
        if carries.get(body.get("name")) and body.get("parent") in carries:
            carries[body.get("parent")] = True
    return [
        Fault(
            f"{where}.mass",
            "the joint moves nothing: it has no armature, and neither this body nor one beyond it has mass",
        )
        for where, body in bodies
        if not (carries.get(body.get("name")) or _joint(body).get("armature"))
    ]


def _any(value: Any) -> bool:
    return any(entries(value))


def _end_point_faults(end_point: dict[str, Any], bodies: Bodies) -> list[Fault]:
    faults: list[Fault] = []
    body = end_point.get("body")
    if isinstance(body, str) and body and body not in {b.get("name") for _, b in bodies}:
        faults.append(Fault("end_point.body", "is no body's name", quoted(body)))
    rows = end_point.get("rows", ("x", "y", "z"))
    faults += _repeats("end_point.rows", rows)
    count = len(entries(rows)) if isinstance(rows, tuple) else 1
    if not count:
        faults.append(Fault("end_point.rows", "must not be empty"))
    actuated = [_joint(b) for _, b in bodies if _joint(b).get("passive") is not True]
    if len(actuated) < count:
        names = ", ".join(str(joint.get("name")) for joint in actuated)
        sentence = (
            f"{count} task rows need at least {count} actuated joints; there are {len(actuated)}"
            f"{f' ({names})' if names else ''}: actuate more joints, or take fewer rows"
        )
        faults.append(Fault("end_point.rows", sentence, quoted(rows)))
    return faults


def _repeats(field: str, value: Any) -> list[Fault]:
    counts = Counter(map(str, entries(value)))
    return [Fault(field, "is listed twice", repr(entry)) for entry, count in counts.items() if count > 1]
