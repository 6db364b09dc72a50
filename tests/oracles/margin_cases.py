"""Random machines, planar and in space, ordinary and extreme, for ε_max: one generator for tests and benchmark."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexopt.model import machine_from_dict, tree_from_dict
from flexopt.robustness.margin import Margin, build_margin
from flexopt.robustness.measures import build_measures
from tests.oracles.machines import NumpySource, draw_machine, draw_structure
from tests.oracles.spatial import random_tree

EXTREMES = ("stiff", "soft", "light damping", "heavy", "repeated", "far gain")


@dataclass(frozen=True)
class MarginCase:
    """A machine in a posture under a controller, and what is extreme about it."""

    margin: Margin
    base: np.ndarray
    posture: np.ndarray
    kr: float
    kind: str

    @property
    def n_states(self) -> int:
        return self.margin.n_states


def _springs(data: dict[str, Any]) -> list[tuple[dict[str, Any], str, str]]:
    """(table, key of the stiffness, key of the damping) for each passive coordinate of either kind of machine."""
    found = []
    if "bodies" in data:
        return [(b["joint"], "stiffness", "damping") for b in data["bodies"] if b["joint"].get("passive")]
    base = data["base"]
    found += [(base, direction, direction) for direction in base["stiffness"]]
    return found + [(link, "stiffness", "damping") for link in data["links"] if link.get("passive")]


def _scale(data: dict[str, Any], rng: np.random.Generator, stiffness: tuple[float, float], damping: float) -> None:
    for table, k, d in _springs(data):
        by = 10.0 ** rng.uniform(*stiffness)
        if k in ("x", "y", "rotation"):
            table["stiffness"][k] *= by
            table.setdefault("damping", {})[d] = table.get("damping", {}).get(d, 0.0) * by**0.5 * damping
        else:
            table[k] *= by
            table[d] = table.get(d, 0.0) * by**0.5 * damping


def _make_extreme(data: dict[str, Any], kind: str, rng: np.random.Generator) -> None:
    if kind == "stiff":
        _scale(data, rng, (0, 9), 1.0)
    elif kind == "soft":
        _scale(data, rng, (-8, 0), 1.0)
    elif kind == "light damping":
        _scale(data, rng, (0, 0), 10.0 ** rng.uniform(-12, -3))
    elif kind == "heavy":
        for body in data.get("bodies", data.get("links")):
            by = 10.0 ** rng.uniform(-6, 6)
            body["mass"] *= by
            body["inertia"] = (np.array(body["inertia"]) * by).tolist()
    elif kind == "repeated":
        springs = _springs(data)
        for table, k, _ in springs:
            near = 1.0 + 1e-7 * rng.uniform(-1, 1)
            if k in ("x", "y"):
                table["stiffness"][k] = table["stiffness"].get("x", table["stiffness"][k]) * near


def margin_case(k: int) -> MarginCase:
    """Case k: every fourth one extreme, every other one in space, the three controllers in turn."""
    for attempt in range(50):
        rng = np.random.default_rng([k, attempt, 12])
        kind = EXTREMES[k // 4 % len(EXTREMES)] if k % 4 == 3 else "ordinary"
        control = ("inverse", "transpose", f"damped:{10.0 ** rng.uniform(-2, 0):.3g}")[k % 3]
        if k // 2 % 2:
            m, n = int(rng.integers(1, 7)), int(rng.integers(1, 5))
            rows = (("z",), ("x", "z"), ("x", "y", "z"))[min(n, 3) - 1]
            data = copy.deepcopy(random_tree(int(rng.integers(1 << 30)), rows=rows, counts=(m, n)))
            build = tree_from_dict
        else:
            source = NumpySource(rng)
            data = draw_machine(source, draw_structure(source))
            build = machine_from_dict
        _make_extreme(data, kind, rng)
        machine = build(data)
        base, posture = rng.uniform(-1, 1, len(machine.base_coordinates)), rng.uniform(-2.5, 2.5, len(machine.joints))
        measures, margin = build_measures(machine, control), build_margin(machine, control)
        p = margin.plant.parameter_values
        v = measures.values(base=base, posture=posture, p=p)
        jv = np.linalg.svd(margin.plant.rigid_jacobian(margin.plant.rest(base, posture, p), base, p).full())[1]
        if not (jv[-1] > 0.02 * jv[0] and float(v["omega_squared"][0]) > 0):
            continue
        # The gain that puts the rigid part's crossing near the first mode, and some decades about it.
        natural = float(v["omega_squared"][0]) / float(np.linalg.norm(v["rigid"].full()))
        decades = 6.0 if kind == "far gain" else 1.5
        return MarginCase(margin, base, posture, natural * 10.0 ** rng.uniform(-decades, decades), kind)
    raise AssertionError("no regular posture found")
