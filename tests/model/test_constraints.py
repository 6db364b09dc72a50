"""The table [constraints]: what it holds, and that every fault of it is named at once."""

from __future__ import annotations

import json

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from flexopt.errors import ModelError
from flexopt.model.constraints import Box, Constraints, HalfPlane, Sphere, read_constraints
from flexopt.model.polygons import EDGE_MIN, check_simple_polygon

WHOLE = {
    "joint_margin": 0.05,
    "manipulability": 0.5,
    "region": [[[0, 0], [4, 0], [4, 4]], [[5, 0], [5, 1], [6, 1], [6, 0]]],
    "keep_out": [[[1, 0.5], [2, 0.5], [2, 1]]],
    "tip_over_margin": 0.4,
    "holding": 0.8,
    "tool_angle": [-2.0, -1.0],
    "clearance": {
        "distance": 0.2,
        "bodies": ["boom", "stick"],
        "ground": 0.0,
        "obstacles": [
            {"name": "tank", "kind": "sphere", "center": [1, 2, 3], "radius": 0.5},
            {"name": "shed", "kind": "box", "center": [1, 2, 3], "size": [1, 1, 2], "yaw": 0.1},
            {"kind": "half_plane", "point": [4, 0, 0], "normal": [-2, 0, 0]},
        ],
    },
    "travel": {"cost": 0.1, "base": [0.0, 0.0, 0.0], "posture": [0.1, 0.2, 0.3]},
}


def faults(table) -> dict[str, str]:
    with pytest.raises(ModelError) as caught:
        read_constraints(table)
    return {fault.field: fault.sentence for fault in caught.value.faults}


def test_a_whole_table():
    read = read_constraints(WHOLE)
    assert read.clearance is not None
    sphere, box, wall = read.clearance.obstacles
    assert isinstance(sphere, Sphere)
    assert isinstance(box, Box)
    assert isinstance(wall, HalfPlane)
    assert wall.normal == (-1.0, 0.0, 0.0)
    # Corners are kept counter-clockwise.
    assert read.region is not None
    assert read.region[1] == ((5.0, 0.0), (6.0, 0.0), (6.0, 1.0), (5.0, 1.0))
    # What was read once is read again, from a dictionary and from JSON; equal ones have equal hashes.
    assert read_constraints(read) is read
    for again in (read.model_dump(), json.loads(read.model_dump_json()), WHOLE):
        assert read_constraints(again) == read
        assert hash(read_constraints(again)) == hash(read)


def test_nothing_binds_by_default():
    assert read_constraints(None) == read_constraints({}) == Constraints()
    assert read_constraints({"tool_angle": 1}).tool_angle == (1.0, 1.0)


def test_numpy_may_stand_for_lists():
    table = {"region": np.array([[[0, 0], [1, 0], [0, 1.0]]]), "tool_angle": np.float64(0.5)}
    assert read_constraints(table) == read_constraints({"region": [[[0, 0], [1, 0], [0, 1]]], "tool_angle": 0.5})


def test_every_fault_is_named_at_once():
    found = faults(
        {
            "joint_margin": -0.1,
            "manipulability": 0,
            "region": [],
            "keep_out": [[2, 1], [[0, 0], [1, 1]]],
            "tip_over_margin": float("nan"),
            "holding": 1.2,
            "tool_angle": [0, 7],
            "tool_angel": 1,
            "clearance": {
                "bodies": ["boom", "boom"],
                "grund": 0,
                "obstacles": [
                    {"name": "tank", "kind": "spere", "center": [0, 0]},
                    {"name": "shed", "kind": "box", "center": [0], "size": [1, 0], "radius": 1},
                    {"kind": "half_plane", "point": [0, 0], "normal": [0, 0]},
                    7,
                ],
            },
            "travel": {"cost": 0, "base": "x"},
        }
    )
    assert found == {
        "joint_margin": "must lie between 0 and 12.5664 rad or m",
        "manipulability": "must be greater than 0 and at most 1e+12",
        "region": "must be a list of areas, m: polygons [[[x, y], …], …] or, of a planar machine, intervals of x, "
        "[[lower, upper], …]",
        "keep_out": "entry 0 is reversed or empty: the lower end must be below the upper end, in m; "
        "entry 1 must be 3 to 500 corners [x, y] in m",
        "tip_over_margin": "must be finite; it must lie between 0 and 10000 m",
        "holding": "must be greater than 0 and at most 1 of each joint's effort",
        "tool_angle": "must be in order and less than a turn, 2π rad, wide",
        "tool_angel": "unknown key; did you mean 'tool_angle'?",
        "clearance.distance": "is required and missing",
        "clearance.bodies": "names the same body twice",
        "clearance.grund": "unknown key; did you mean 'ground'?",
        "clearance.obstacles[0] (tank)": "kind must be sphere or box or half_plane; did you mean 'sphere'?",
        "clearance.obstacles[1] (shed).center": "must be numbers in m: [x, y] in the plane, [x, y, z] in space",
        "clearance.obstacles[1] (shed).size": "must be whole lengths of the sides, each greater than 0 m",
        "clearance.obstacles[1] (shed).radius": "unknown key; valid here: kind, name, center, size, yaw",
        "clearance.obstacles[2].normal": "must point somewhere: its length is 0",
        "clearance.obstacles[3]": "must be a table with kind = sphere or box or half_plane",
        "travel.cost": "must be greater than 0 and at most 1e+12",
        "travel.base": "must be a number, not text; it must lie between -1e+06 and 1e+06 m or rad",
    }


@pytest.mark.parametrize(
    ("areas", "words"),
    [([-6.0, 2.7], "must be a list of areas, m: "), ([[0.0, 1.0], 3.0], "entry 1 must be ")],
)
@pytest.mark.parametrize("field", ["region", "keep_out"])
def test_areas_that_may_be_of_a_planar_machine_or_not_are_told_both_forms(field, areas, words):
    with pytest.raises(ModelError) as caught:
        read_constraints({field: areas})
    assert words in str(caught.value)
    assert "[lower, upper]" in str(caught.value)
    assert "[[x, y], …]" in str(caught.value)
    assert getattr(read_constraints({field: [[-6.0, 2.7]]}), field) == ((-6.0, 2.7),)


@pytest.mark.parametrize(
    ("polygon", "words"),
    [
        ([[0, 0], [1, 0]], "3 to 500 corners"),
        ([[0, 0], [1, 0], [1, 1], [1, 1]], "corners 2 and 3 in one place"),
        ([[0, 0], [2, 2], [2, 0], [0, 2]], "its edge from corner 0 to corner 1 meets that from corner 2 to corner 3"),
        ([[0, 0], [2, 0], [1, 0]], "is not simple"),
        ([[0, 0], [2, 0], [2, 1], [2, 0.5], [2, -1]], "is not simple"),
        ([[0, 0], [4, 0], [4, 2], [2, 0], [0, 2]], "is not simple"),  # a corner touches an edge
        ([[0, 0], [1, 0], [1, float("inf")]], "corner 2 y must be finite"),
        ([[0, 0], [1, 0], [1, 1, 1]], "corner 2 is not"),
        ([[0, 0], [1, 0], [1, 2e6]], "must lie between -1e+06 and 1e+06 m"),
        ("abc", "3 to 500 corners"),
    ],
)
def test_polygons_that_are_none(polygon, words):
    with pytest.raises(ValueError, match=r".") as caught:
        check_simple_polygon(polygon)
    assert words in str(caught.value)


corners = st.lists(st.tuples(st.integers(-3, 3), st.integers(-3, 3)), min_size=3, max_size=7)


@settings(max_examples=500)
@given(corners)
def test_simple_is_what_shapely_calls_valid(polygon):
    shape = shapely.Polygon(polygon)
    assert EDGE_MIN < 1  # corners of a grid are equal or far apart
    repeated = any(a == b for a, b in zip(polygon, [*polygon[1:], polygon[0]], strict=True))
    try:
        kept = check_simple_polygon([list(corner) for corner in polygon])
    except ValueError:
        assert repeated or not shape.is_valid
        return
    assert shape.is_valid
    assert shapely.Polygon(kept).exterior.is_ccw
    assert set(kept) == set(polygon)
    assert kept[0] == polygon[0]
