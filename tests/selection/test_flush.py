"""Choices that lay a capsule along a box, where its clearance is two rows: each is judged by a scan around it."""

from __future__ import annotations

from itertools import product

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import fsolve

import flexopt
from tests.selection.constraints.test_segment_distance import oracle

CLEARANCE, RADIUS = 0.05, 0.3
CENTER, SIZE = np.array([3.5, 0.5]), np.array([4.0, 2.0])
TARGET = np.array([5.7, 0.9])


def reaching_over() -> flexopt.Machine:
    """A digger whose stick alone has a volume, about the line from pin to pin, and whose joints turn all the way."""
    data = flexopt.load("boom-stick-bucket").to_dict()
    data.pop("cylinders")
    for link in data["links"]:
        link["limits"] = [-6.0, 6.0]
    length = data["links"][1]["length"]
    data["capsules"] = [{"body": "stick", "start": [0.0, 0.0], "end": [length, 0.0], "radius": RADIUS}]
    return flexopt.machine_from_dict(data)


@pytest.mark.long
def test_the_lowest_way_over_a_box_lies_along_it() -> None:
    machine = reaching_over()
    plant = flexopt.build_plant(machine)
    p, centre = plant.parameter_values, ca.SX.sym("centre", 2)
    low = ca.Function("low", [centre], [-centre[1]], ["centre_of_mass"], ["height"])
    box = {"kind": "box", "center": CENTER.tolist(), "size": SIZE.tolist()}
    kept = {"clearance": {"distance": CLEARANCE, "obstacles": [box]}}
    chosen = flexopt.select(machine, TARGET, objective=low, constraints=kept, assume="nothing", base_range=(-12, 16))
    stick = [plant.frames.names.index(name) for name in ("stick", "bucket")]

    def height_and_room(base: float, posture: np.ndarray) -> tuple[float, float]:
        """Height of the centre of mass, and the room that the clearance leaves, by a search along the axis."""
        q = plant.rest(base, posture, p)
        pins = plant.body_frames(q, base, p)[0].full().T[stick] - CENTER
        return float(plant.centre_of_mass(q, base, p)[1]), oracle(*pins, SIZE / 2) - RADIUS - CLEARANCE

    def off_target(two: np.ndarray, base: float, bucket: float) -> np.ndarray:
        return plant.end_point(plant.rest(base, [*two, bucket], p), base, p).full().ravel() - TARGET

    flush = seen = 0
    clearances = [row.name.startswith("clearance") for row in chosen.problem.constraints]
    assert sum(clearances) == 2
    for candidate in chosen.candidates:
        (base,), posture = candidate.evaluation.base, candidate.evaluation.posture
        if (chosen.problem.rows(np.append(base, posture))[clearances] > CLEARANCE + 1e-9).any():
            continue
        flush += 1
        assert candidate.active == ("clearance of stick from obstacle 1",)
        least, room = height_and_room(base, posture)
        assert abs(room) <= 1e-9
        for aside, turned in product(np.linspace(-0.1, 0.1, 21), repeat=2):
            at, bucket = base + aside, posture[2] + turned
            two, _, reached, _ = fsolve(off_target, posture[:2], args=(at, bucket), full_output=True)
            if reached == 1:
                height, room = height_and_room(at, np.append(two, bucket))
                seen += 1
                assert height > least - 1e-9 or room < 1e-9
    assert flush >= 2
    assert seen > 400 * flush
