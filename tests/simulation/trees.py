"""Closed loops of random trees in space that are stable and well damped, and what their tests share."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from flexopt import build_plant
from flexopt.errors import FlexoptError
from flexopt.model import tree_from_dict
from tests.oracles.spatial import random_tree
from tests.simulation.loops import Case, run, scenario, state_matrix

BASE = np.array([0.7, -0.4, 0.9])


def damped_tree(rng: np.random.Generator, seed: int, counts: tuple[int, int], rows: tuple[str, ...]) -> dict[str, Any]:
    """A random tree whose springs give each passive joint alone 1 to 4 Hz, half critically damped."""
    data = random_tree(seed, rows=rows, counts=counts)
    tree = tree_from_dict(data)
    plant = build_plant(tree)
    q = plant.rest(np.zeros(3), np.zeros(counts[1]), plant.parameter_values)
    inertia = np.diag(plant.mass(q, np.zeros(3), plant.parameter_values).full())
    passive = [body["joint"] for body in data["bodies"] if body["joint"]["passive"]]
    for joint, own in zip(passive, inertia, strict=False):
        omega = 2 * math.pi * rng.uniform(1.0, 4.0)
        joint |= {"stiffness": float(own * omega**2), "damping": float(own * omega)}
    return data


def stable_tree(
    seed: int, counts: tuple[int, int], control: str, rows: tuple[str, ...] = ("x", "y", "z"), *, samples: int = 500,
    **options: Any,
) -> Case:  # fmt: skip
    """The first random tree from `seed` with gains that let the sampled loop decay; see `loops.stable_case`."""
    while True:
        seed += 1000
        rng = np.random.default_rng(seed)
        data = damped_tree(rng, seed, counts, rows)
        tree = tree_from_dict(data)
        plant, n = build_plant(tree), counts[1]
        p = plant.parameter_values
        posture = rng.uniform(-1.0, 1.0, n)
        q = plant.rest(BASE, posture, p).full().ravel()
        rigid = plant.rigid_jacobian(q, BASE, p).full()
        if np.linalg.cond(rigid) > 8.0:
            continue
        reach = np.linalg.norm(rigid, 2) ** 2
        inertia = np.linalg.eigvalsh(plant.mass(q, BASE, p).full()[-n:, -n:])[-1]
        inertia *= 1.0 if control == "inverse" else 1 / reach
        offset = 0.1 * rng.uniform(0.3, 1.0, n) * rng.choice([-1.0, 1.0], n)
        for corner in (10.0, 5.0, 2.5, 1.2):
            kp = inertia * corner**2 * rng.uniform(0.5, 1.5, plant.n_task)
            given = {"posture": posture, "base": BASE, "control": control, "kp": kp, "kv": 2 * kp / corner}
            given |= {"offset": offset, "duration": 0.1, "rate": 100.0, "substeps": 100} | options
            if n > plant.n_task:
                given["nullspace_damping"] = 2 * inertia * (1.0 if control == "inverse" else reach)
            try:
                made = scenario(tree, **given)
            except FlexoptError:  # falls over under gravity
                break
            rate = math.ceil(2 * math.pi * made.frequencies_hz[-1] / 5) * 10.0
            given |= {"rate": rate, "duration": samples / rate, "substeps": options.get("substeps", 1)}
            case = Case(data, tree, given)
            poles = np.sort(np.abs(np.linalg.eigvals(state_matrix(case.scenario))))
            settled = poles[: len(poles) - (n - plant.n_task)]
            if settled[-1] < math.exp(-0.1 / rate) and np.all(np.abs(run(case.scenario).v) < 5):
                return case
