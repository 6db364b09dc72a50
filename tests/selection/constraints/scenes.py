"""Random machines with capsules among random obstacles, and the same scene in MuJoCo, seen from the anchor frame."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np

from flexopt.plant.plant import Plant
from flexopt.selection.constraints import ConstraintSet
from tests.oracles.spatial import MujocoTree, mujoco_tree, pin_quaternion

Data = dict[str, Any]
GEOM = mujoco.mjtGeom


def listed(rows: ConstraintSet) -> SimpleNamespace:
    """What the rows are called, their units, bounds and scales, each in a row of its own."""
    told = [(row.name, row.unit, row.lower, row.upper, row.scale) for row in rows.rows]
    labels, units, *numbers = zip(*told, strict=True)
    lower, upper, scales = map(np.array, numbers)
    return SimpleNamespace(labels=labels, units=units, lower=lower, upper=upper, scales=scales)


def least_by_label(rows: ConstraintSet, values: np.ndarray) -> dict[str, float]:
    """Of rows that are called alike, which hold one quantity together, the least."""
    assert len(values) == len(rows)
    found: dict[str, float] = {}
    for row, value in zip(rows.rows, values.tolist(), strict=True):
        found[row.name] = min(value, found.get(row.name, math.inf))
    return found


def random_capsules(rng: np.random.Generator, bodies: list[str], d: int) -> list[Data]:
    """One or two on every body, some of them balls."""
    made: list[Data] = []
    for body in bodies:
        for _ in range(int(rng.integers(1, 3))):
            start, radius = rng.uniform(-0.5, 0.5, d), float(rng.uniform(0.05, 0.3))
            end = start if rng.random() < 0.2 else rng.uniform(-0.8, 0.8, d)
            made.append({"body": body, "start": start.tolist(), "end": end.tolist(), "radius": radius})
    return made


def random_obstacles(rng: np.random.Generator, d: int, reach: float) -> list[Data]:
    def place() -> list[float]:
        return rng.uniform(-reach, reach, d).tolist()

    normal = rng.normal(size=d).tolist()
    return [
        {"kind": "sphere", "name": "tank", "center": place(), "radius": float(rng.uniform(0.2, 1))},
        {"kind": "box", "center": place(), "size": rng.uniform(0.3, 2, d).tolist(), "yaw": float(rng.uniform(-3, 3))},
        {"kind": "half_plane", "name": "wall", "point": place(), "normal": normal},
    ]


def mujoco_scene(data: Data, capsules: list[Data], obstacles: list[Data], base: np.ndarray) -> MujocoTree:
    """Geoms capsule0 …, obstacle0 …; the obstacles moved so that the anchor frame stands at the origin."""
    x, y, yaw = base
    turn = np.array([[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])

    def add(spec: Any, made: dict[str | None, Any]) -> None:
        for k, capsule in enumerate(capsules):
            size = [capsule["radius"], 0, 0]
            if capsule["start"] == capsule["end"]:
                shape = {"type": GEOM.mjGEOM_SPHERE, "pos": capsule["start"]}
            else:
                shape = {"type": GEOM.mjGEOM_CAPSULE, "fromto": [*capsule["start"], *capsule["end"]]}
            made[capsule["body"]].add_geom(name=f"capsule{k}", size=size, mass=0, **shape)
        for k, obstacle in enumerate(obstacles):
            center = turn.T @ (np.array(obstacle.get("center", obstacle.get("point"))) - [x, y, 0])
            if obstacle["kind"] == "sphere":
                shape = {"type": GEOM.mjGEOM_SPHERE, "size": [obstacle["radius"], 0, 0]}
            elif obstacle["kind"] == "box":
                half = (obstacle.get("yaw", 0.0) - yaw) / 2
                shape = {"type": GEOM.mjGEOM_BOX, "size": np.array(obstacle["size"]) / 2}
                shape["quat"] = [math.cos(half), 0, 0, math.sin(half)]
                if obstacle.get("upright"):  # turned in the plane x, z instead: about −y
                    shape["quat"] = [math.cos(half), 0, -math.sin(half), 0]
            else:
                normal = turn.T @ np.array(obstacle["normal"]) / np.linalg.norm(obstacle["normal"])
                shape = {"type": GEOM.mjGEOM_PLANE, "size": [0, 0, 1], "quat": quaternion_to(normal)}
            spec.worldbody.add_geom(name=f"obstacle{k}", pos=center, **shape)

    return mujoco_tree(data, add)


def quaternion_to(normal: np.ndarray) -> list[float]:
    """A rotation that takes z to `normal`."""
    across = np.eye(3)[np.argmin(np.abs(normal))]
    x = np.cross(across, normal)
    x /= np.linalg.norm(x)
    return pin_quaternion(np.stack([x, np.cross(normal, x), normal], axis=1))


def distance(chain: MujocoTree, capsule: int, obstacle: int) -> float:
    """As MuJoCo measures it; from boxes iteratively, to a tolerance of its own."""
    model = chain.model
    model.opt.ccd_tolerance, model.opt.ccd_iterations = 1e-13, 1000
    one, other = model.geom(f"obstacle{obstacle}").id, model.geom(f"capsule{capsule}").id
    return mujoco.mj_geomDistance(model, chain.data, one, other, 1e3, None)


def at_rest(plant: Plant, base: Any, posture: Any) -> np.ndarray:
    return plant.rest(base, posture, plant.parameter_values).full().ravel()
