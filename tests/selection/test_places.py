"""Placements in areas that an even sample leaves out, beside the areas themselves."""

from __future__ import annotations

import numpy as np
import shapely
from shapely import affinity

import flexopt
from flexopt.model.constraints import read_constraints
from flexopt.selection.places import even_places, places_left_out


def test_a_tight_yard_is_looked_into_beside_a_wide_one() -> None:
    """In each of them the whole footprint stands, and off a rock; nothing is added where enough was known."""
    machine = flexopt.load("slewing-excavator")
    plant, own = flexopt.build_plant(machine), shapely.Polygon(machine.support_points)
    tight = affinity.rotate(own.buffer(0.05, join_style="mitre"), 0.4, origin=(0, 0), use_radians=True)
    yards = [affinity.translate(tight, 2.0, -1.0), shapely.box(-9.0, 2.0, 9.0, 9.0)]
    rock = shapely.box(0.0, 4.0, 2.0, 6.0)
    corners = [list(map(list, area.exterior.coords))[:-1] for area in [*yards, rock]]
    asked = read_constraints({"region": corners[:2], "keep_out": corners[2:]})
    low, high = np.array([-9.0, -9.0, -3.0]), np.array([9.0, 9.0, 3.0])
    known = even_places(low, high, 401, 512, 0)
    found = places_left_out(plant, asked, low, high, known, 0)
    stands = [
        affinity.translate(affinity.rotate(own, yaw, origin=(0, 0), use_radians=True), x, y) for x, y, yaw in found.T
    ]
    inside = [[yard.buffer(1e-5).contains(stand) for stand in stands] for yard in yards]
    assert np.any(inside, axis=0).all()
    assert sum(inside[0]) >= 8
    assert max(rock.intersection(stand).area for stand in stands) < 1e-5
    both = np.concatenate([known, *[found] * 65], axis=1)
    assert places_left_out(plant, asked, low, high, both, 0).size == 0
