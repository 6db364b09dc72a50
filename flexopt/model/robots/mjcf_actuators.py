"""What the actuators of an MJCF model can give at most, joint by joint, where that is plain.

Plain is: one actuator acts on the joint itself, and its force is bounded by `forcerange`, or by the `ctrlrange` of what
is a motor: a <motor>, or a <general> with a fixed gain and no bias, as which MuJoCo saves one. The first of `gear`
leads from the actuator to the joint.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from flexopt.model.robots.elements import Element, check_text
from flexopt.model.robots.mjcf_settings import MAIN, SERVO, Settings

# Dynamics of an actuator that end at its control.
FOLLOWING = ("none", "filter", "filterexact")


def drive_efforts(root: Element, settings: Settings) -> Mapping[str, float]:
    """Largest torque or force either way, N m or N, by the name of the joint."""
    found: dict[str, list[float | None]] = {}
    for section in root.all("actuator"):
        for child in section.children:
            element = replace(settings.resolved(replace(child, tag="actuator"), MAIN), tag=child.tag)
            for key in ("joint", "jointinparent"):
                if key in element.attributes:
                    found.setdefault(element.attributes[key], []).append(_effort(settings, element))
    return {name: given[0] for name, given in found.items() if len(given) == 1 and given[0] is not None}


def _effort(settings: Settings, element: Element) -> float | None:
    gear = abs(float(settings.faults.numbers(element, "gear", range(1, 7), (1.0,))[0]))
    force = bounded(settings, element, "forcerange", "forcelimited")
    if force is None and (gain := _gain(settings, element)) is not None:
        control = bounded(settings, element, "ctrlrange", "ctrllimited")
        force = None if control is None else gain * control
    return gear * force if force and gear > 0 else None


def _gain(settings: Settings, element: Element) -> float | None:
    """Force for each unit of control, of what is a motor; None of a servo, of a muscle, and of what integrates."""
    own = element.attributes
    if element.tag == "motor":
        return 1.0
    plain = own.get("gaintype", "fixed") == "fixed" and own.get("biastype", "none") == "none"
    plain = plain and own.get("gainprm") != SERVO["gainprm"]
    if element.tag != "general" or not plain or own.get("dyntype", "none") not in FOLLOWING:
        return None
    return abs(float(settings.faults.numbers(element, "gainprm", range(1, 11), (1.0,))[0]))


def bounded(settings: Settings, element: Element, key: str, flag: str) -> float | None:
    """The smaller of how far a range reaches up and down from zero; None where it does not bound both."""
    limited = check_text(settings.faults, element, flag, ("auto", "true", "false"), "auto")
    if key not in element.attributes or limited == "false" or (limited == "auto" and not settings.auto_limits):
        return None
    low, high = settings.faults.numbers(element, key, 2, (0.0, 0.0))
    reach = float(np.minimum(-low, high))
    return reach if reach > 0 else None
