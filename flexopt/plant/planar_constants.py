"""A planar chain prepared for its equations of motion: which parts it has, and the constants they need.

In: a planar machine and its parameters as graphs. Out: its `PlanarStructure` and the constants of `PlanarMotion`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

from flexopt.model import Machine
from flexopt.plant.planar import moments


@dataclass(frozen=True)
class PlanarStructure:
    """What decides the graph: which parts exist, not how large they are. Equal structures share compiled code.

    Attributes:
        translations: free directions of the base among `"x"`, `"y"`.
        rotation: whether the base can turn.
        passive: of each link, whether its hinge is passive.
        zeros: constants that are exactly zero and are left out of the graph.
    """

    translations: tuple[str, ...]
    rotation: bool
    passive: tuple[bool, ...]
    zeros: frozenset[str] = frozenset()

    @property
    def rows(self) -> tuple[str, ...]:
        """Task rows."""
        return ("x", "y")

    @property
    def placement(self) -> tuple[str, ...]:
        """Placement coordinates."""
        return ("x",)


def full_structure(machine: Machine) -> PlanarStructure:
    """A machine's structure with every constant kept, for parameters that vary."""
    free = machine.free_base_directions
    return PlanarStructure(
        tuple(direction for direction in free if direction != "rotation"),
        "rotation" in free,
        tuple(link.passive for link in machine.links),
    )


def constant_graphs(machine: Machine, value: Mapping[str, ca.SX]) -> dict[str, ca.SX]:
    """The constants of the motion by name, from the parameters by name."""
    bodies = ["base", *(link.name for link in machine.links)]
    of, whole = moments(dict(value), bodies), full_structure(machine)
    both = len(whole.translations) == 2
    # Quotients are constants of their own, so that no step divides by what never changes.
    result = {
        "total": of.total,
        "inverse_total": 1 / of.total,
        "inverse_root_total": 1 / ca.sqrt(of.total),
        "gravity": value["gravity"],
    }
    if not whole.rotation:
        result |= {"base_cos": ca.cos(value["base.rest_angle"]), "base_sin": ca.sin(value["base.rest_angle"])}
    for direction in whole.translations:
        for word in ("stiffness", "damping"):
            result[f"{word}_{direction}"] = value[f"base.{word}.{direction}"]
            result[f"{word}_{direction}_m"] = value[f"base.{word}.{direction}"] / of.total
    for k, body in enumerate(bodies):
        result |= {f"a{k}": of.a[k], f"b{k}": of.b[k], f"length{k}": value[f"{body}.length"]}
        result |= {f"am{k}": of.a[k] / of.total, f"bm{k}": of.b[k] / of.total}
        for m in range(k + 1):
            s, t = of.s[k][m], of.t[k][m]
            if both:
                s -= (of.a[k] * of.a[m] + of.b[k] * of.b[m]) / of.total
                t -= (of.a[k] * of.b[m] - of.b[k] * of.a[m]) / of.total
            result[f"s{k}_{m}"] = s
            if m < k:
                result[f"t{k}_{m}"] = t
    if both:
        first = 0 if whole.rotation else 1
        result["inverse_pivot"] = 1 / result[f"s{first}_{first}"]
    if whole.rotation:
        result |= {"stiffness0": value["base.stiffness.rotation"], "damping0": value["base.damping.rotation"]}
    result["rest0"] = value["base.rest_angle"]
    for k, link in enumerate(machine.links, 1):
        if link.passive:
            result |= {f"stiffness{k}": value[f"{link.name}.stiffness"], f"rest{k}": value[f"{link.name}.rest"]}
            result |= {f"damping{k}": value[f"{link.name}.damping"]}
        else:
            result |= {f"damping{k}": value[f"{link.name}.joint_damping"]}
    return result
