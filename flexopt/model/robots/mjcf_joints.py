"""One <joint> or <freejoint> of an MJCF body as a `Joint`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flexopt.model.robots.description import Joint, JointKind, unit_axis
from flexopt.model.robots.elements import Element, check_text
from flexopt.model.robots.geometry import Pose
from flexopt.model.robots.mjcf_actuators import bounded
from flexopt.model.robots.mjcf_settings import Settings

KINDS: dict[str, JointKind] = {"hinge": "hinge", "slide": "slide", "free": "free"}


def read_joint(settings: Settings, element: Element, name: str, frame: Pose, *, free: bool) -> Joint | None:
    """The joint, or None after a fault.

    Args:
        settings: compiler settings; faults are added to theirs.
        element: the element, with its defaults.
        name: its name, or the one it is given.
        frame: where its `pos` and `axis` start from, in the body.
        free: whether it was written <freejoint>.
    """
    faults = settings.faults
    element = replace(element, attributes=element.attributes | {"name": name})
    kind = "free" if free else element.attributes.get("type", "hinge")
    if kind == "free":
        return Joint(name, "free", element, np.array([0.0, 0.0, 1.0]), np.zeros(3))
    if kind == "ball":
        sentence = "is a ball joint: write three hinges in its place, each with its own axis and stiffness"
        faults.add(element, sentence)
        return None
    kind = check_text(faults, element, "type", tuple(KINDS), "hinge")
    if "springdamper" in element.attributes:
        faults.add(element, "springdamper is not read: say stiffness and damping")
    if faults.number(element, "armature") < 0:
        faults.add(element, "armature must not be negative", value=element.attributes["armature"])
    for key in ("stiffness", "damping"):
        if len(element.attributes.get(key, "").split()) > 1:
            faults.add(element, f"{key} is a polynomial; only a linear one (one number) is read")
            element.attributes.pop(key)
        if faults.number(element, key) < 0:
            faults.add(element, f"{key} must not be negative", value=element.attributes[key])
    for key in ("frictionloss", "springyield"):
        if faults.number(element, key):
            faults.warn(element, f"{key} {element.attributes[key]} is left out")
    scale = settings.angle if kind == "hinge" else 1.0
    return Joint(
        name=name,
        kind=KINDS[kind],
        element=element,
        axis=frame.rotation @ unit_axis(faults, element, "axis", (0.0, 0.0, 1.0), element),
        anchor=(frame @ Pose(faults.numbers(element, "pos", 3, (0.0, 0.0, 0.0)))).position,
        zero=scale * faults.number(element, "ref"),
        stiffness=max(faults.number(element, "stiffness"), 0.0),
        damping=max(faults.number(element, "damping"), 0.0),
        rest=scale * faults.number(element, "springref"),
        limits=_limits(settings, element, scale),
        effort=bounded(settings, element, "actuatorfrcrange", "actuatorfrclimited"),
        armature=faults.number(element, "armature"),
    )


def _limits(settings: Settings, element: Element, scale: float) -> tuple[float, float] | None:
    """`range` in rad or m, where it counts."""
    faults = settings.faults
    limited = check_text(faults, element, "limited", ("auto", "true", "false"), "auto")
    lower, upper = (scale * float(end) for end in faults.numbers(element, "range", 2, (0.0, 0.0)))
    if limited == "false" or (limited == "auto" and lower == upper):
        return None
    if limited == "auto" and not settings.auto_limits:
        faults.add(element, "has range but not limited, and autolimits is off: say limited true or false")
    if lower >= upper:
        text = element.attributes.get("range", "missing")
        faults.add(element, "is limited and needs a range, its lower end below the upper", value=text)
        return None
    return lower, upper
