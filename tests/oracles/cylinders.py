"""A digger with three cylinders, and cylinders' lengths from loop equations that SciPy solves."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

Data = dict[str, Any]

DIGGER: Data = {
    "name": "digger",
    "gravity": 9.81,
    "base": {"length": 0.5, "com": 0.4, "mass": 5000.0, "inertia": 1000.0, "rest_angle": 1.2,
             "stiffness": {"x": 4e7, "y": 4e7, "rotation": 1.1e6}, "damping": {"x": 50.0, "rotation": 25.0}},
    "links": [
        {"name": "boom", "length": 2.0, "com": 1.0, "mass": 300.0, "inertia": 100.0, "limits": [-1.0, 0.3]},
        {"name": "stick", "length": 1.1, "com": 0.5, "mass": 150.0, "inertia": 20.0, "limits": [-2.6, -0.6]},
        {"name": "bucket", "length": 0.6, "com": 0.3, "mass": 80.0, "inertia": 4.0, "limits": [-2.2, 0.7]},
    ],
    "cylinders": [
        {"name": "boom cylinder", "joint": "boom", "base_point": [0.45, -0.35], "rod_point": [0.95, 0.25],
         "length": [0.7, 1.4], "speed": [0.2, 0.15], "force": [5e4, 9e4]},
        {"name": "stick cylinder", "joint": "stick", "base_point": [0.9, 0.35], "rod_point": [-0.3, 0.15],
         "length": [0.6, 1.3], "speed": [0.25, 0.18], "force": [4e4, 7e4], "lever_sign": -1, "dead_band": 0.1},
        {"name": "bucket cylinder", "joint": "bucket", "base_point": [0.2, 0.25],
         "rocker": {"pivot": [0.95, 0.0], "length": 0.3, "coupler": 0.28, "coupler_point": [-0.03, 0.18], "branch": 1},
         "length": [0.3, 1.3], "speed": [0.3, 0.2]},
    ],
}  # fmt: skip


def digger() -> Data:
    return copy.deepcopy(DIGGER)


def digger_in_space(tree: Data) -> Data:
    """The cylinders of a planar machine on its twin from `spatial.in_space`: left of a body is up."""
    cylinders = copy.deepcopy(DIGGER["cylinders"])
    for cylinder in cylinders:
        rocker = cylinder.get("rocker", {})
        for table, key in ((cylinder, "base_point"), (cylinder, "rod_point"), (rocker, "pivot"),
                           (rocker, "coupler_point")):  # fmt: skip
            if key in table:
                table[key] = [table[key][0], 0.0, table[key][1]]
    limits = {link["name"]: link["limits"] for link in DIGGER["links"]}
    for body in tree["bodies"]:
        if body["name"] in limits:
            body["joint"]["limits"] = limits[body["name"]]
    return tree | {"cylinders": cylinders}


def length_in_space(cylinder: Data, body: Data, q: float) -> float:
    """Pin to pin, for the cylinder of a hinge, from rotation vectors and a bracketed root of the loop equation."""
    axis = np.array(body["joint"]["axis"]) / np.linalg.norm(body["joint"]["axis"])
    turned = Rotation.from_matrix(body["rotation"]) * Rotation.from_rotvec(q * axis)
    origin = np.array(body["position"])
    base = np.array(cylinder["base_point"])
    if "rocker" not in cylinder:
        return float(np.linalg.norm(base - origin - turned.apply(cylinder["rod_point"])))
    rocker = cylinder["rocker"]
    pivot, joined = np.array(rocker["pivot"]), origin + turned.apply(rocker["coupler_point"])
    along = Rotation.from_matrix(body["rotation"]).apply(axis)
    # The rocker sweeps half a turn to either side of the line to the coupler point: one root of the loop on each side.
    towards = joined - pivot - along * (along @ (joined - pivot))
    towards /= np.linalg.norm(towards)

    def point(angle: float, forward: float, left: float) -> np.ndarray:
        turn = Rotation.from_rotvec(angle * along)
        return pivot + turn.apply(forward * towards) + turn.apply(left * np.cross(along, towards))

    def loop(angle: float) -> float:
        return float(np.linalg.norm(point(angle, rocker["length"], 0.0) - joined) - rocker["coupler"])

    angle = brentq(loop, 0.0, rocker["branch"] * np.pi, xtol=1e-15, rtol=1e-15)
    forward, left = rocker.get("rod_offset", [0.0, 0.0])
    return float(np.linalg.norm(base - point(angle, rocker["length"] + forward, left)))


def length_in_plane(cylinder: Data, parent_length: float, q: float) -> float:
    """The same for a planar machine, whose joint stands at the end of the body that carries it."""
    raised = copy.deepcopy(cylinder)
    for table in (raised, raised.get("rocker", {})):
        for key in ("base_point", "rod_point", "pivot", "coupler_point"):
            if key in table:
                table[key] = [*table[key], 0.0]
    joint = {"axis": [0.0, 0.0, 1.0]}
    body = {"joint": joint, "rotation": np.eye(3), "position": [parent_length, 0.0, 0.0]}
    return length_in_space(raised, body, q)
