"""The sentence on constraints, beside the values in the document."""

from __future__ import annotations

import math
import re
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import flexopt
from flexopt.model.constraints import read_constraints
from flexopt.selection.broken import cornerless, resting
from flexopt.selection.constraint_values import ConstraintValue, nearest_told, resting_told, violations_told

NAMES = ("clearance of a from b", "clearance of c from d", "clearance of e from f", "tip-over margin from edge x")
ASKED = read_constraints({"manipulability": 2.0})


@given(st.lists(st.lists(st.floats(-9, 9), min_size=4, max_size=4), min_size=1, max_size=3))
def test_of_each_kind_the_nearest_is_told(values: list[list[float]]) -> None:
    places = [{name: ConstraintValue(x, -1.0, 1.0, "m") for name, x in zip(NAMES, row, strict=True)} for row in values]
    told = nearest_told(ASKED, places, {})
    room = 1 - abs(np.array(values))
    for kind, part in (("clearance", room[:, :3]), ("tip-over", room[:, 3:])):
        found = re.search(rf"{kind}.*?(-?[\d.e-]+) m \(-1 to 1 m\)(?: at target (\d))?", told)
        assert found is not None
        # Four digits are shown.
        assert 1 - abs(float(found[1])) == pytest.approx(part.min(), abs=2e-3)
        k = int(found[2] or 1) - 1
        assert part[k].min() == pytest.approx(part.min(), abs=1e-12)
        assert (found[2] is not None) == (len(values) > 1)


def test_corners_of_a_constraint_are_of_one_kind() -> None:
    """One's own constraint may be called so, too, and is no corner."""
    names = (
        "tool angle",
        "tool angle where payload.mass is 9 kg",
        "room where height is 2 m",
        "room where height is 3 m",
    )
    places = [{name: ConstraintValue(x, -1.0, 1.0, "rad") for name, x in zip(names, (0.1, 0.9, 0.2, 0.3), strict=True)}]
    told = nearest_told(ASKED, places, {names[1]: names[0]})
    assert [name for name in names if f"{name} 0." in told] == [*names[1:]]
    assert "tool angle 0." not in told


@pytest.mark.parametrize(
    ("value", "bounds", "unit", "text"),
    [
        (-2.220446049250313e-16, (0.0, np.inf), "m", "0 m (at least 0 m)"),
        (1.31836e-28, (-0.5, 0.5), "rad", "0 rad (-0.5 to 0.5 rad)"),
        (-2e-10, (-3e4, 3e4), "N", "0 N (-3e+04 to 3e+04 N)"),
        (-2e-10, (0.0, np.inf), "m", "-2e-10 m (at least 0 m)"),
        (2e-7, (-3e4, 3e4), "N", "2e-07 N (-3e+04 to 3e+04 N)"),
        (np.nan, (0.0, np.inf), "m", "no number (at least 0 m)"),
        (-np.inf, (0.0, np.inf), "", "-inf (at least 0)"),
    ],
)
def test_rounding_is_told_as_zero(value: float, bounds: tuple[float, float], unit: str, text: str) -> None:
    """Doubles have 16 digits: three are left to what cancels in a distance of metres, or in a load of its bounds' size."""
    assert str(ConstraintValue(value, *bounds, unit)) == text


@pytest.mark.parametrize(
    ("value", "bounds", "text"),
    [
        (-1.30004, (-1.8, -1.30003), "-1.3 rad (-1.8 to -1.3 rad)"),
        (-1.29999, (-1.8, -1.3), "-1.29999 rad (-1.8 to -1.3 rad)"),
        (1.3, (1.30004, np.inf), "1.3 rad (at least 1.30004 rad)"),
        (0.2 - 3e-5, (0.2, np.inf), "0.19997 rad (at least 0.2 rad)"),
        (0.2 - 3e-8, (0.2, np.inf), "0.2 rad (at least 0.2 rad)"),
        (0.1984, (0.2, np.inf), "0.1984 rad (at least 0.2 rad)"),
    ],
)
def test_what_breaks_a_bound_is_not_told_as_that_bound(value: float, bounds: tuple[float, float], text: str) -> None:
    assert str(ConstraintValue(value, *bounds, "rad")) == text


def test_nothing_is_told_where_nothing_was_asked() -> None:
    places = [{"singularity margin": ConstraintValue(0.5, 0.03, np.inf, "sin²")}]
    for asked in ({}, {"travel": {"cost": 0.1}}):
        assert nearest_told(read_constraints(asked), places, {}) == ""


@pytest.mark.parametrize("margin", [0.0, 0.1])
def test_an_asked_margin_of_joints_has_a_value_for_each(margin: float) -> None:
    digger = flexopt.load("boom-stick-bucket")
    found = flexopt.select(digger, (7.0, 1.0), base=0.0, constraints={"joint_margin": margin}, starts=1, workers=1)
    values, held = found.to_dict()["best"]["constraints"], found.best.evaluation.posture
    least = min(
        (
            (min(q - low, high - q), name)
            for name, q, (low, high) in zip(digger.joints, held, digger.limits, strict=True)
        )
    )
    for name, q, (low, high) in zip(digger.joints, held, digger.limits, strict=True):
        row = values[f"joint margin of {name}"]
        assert (row["lower"], row["unit"]) == (margin, "rad")
        # Two differences of numbers of some rad.
        assert row["value"] == pytest.approx(min(q - low, high - q), abs=1e-14)
    assert f"joint margin of {least[1]} {least[0]:.4g} rad (at least {margin:g} rad)" in repr(found)


def test_a_weighted_sum_has_its_own_column() -> None:
    machine, weights = flexopt.load("excavator"), [1.0, 0.5, 2.0]
    options: dict[str, Any] = {"base": 0.0, "starts": 2, "workers": 1}
    found = flexopt.select(machine, (0.0, 1.6), objective="V", weights=weights, **options)
    heads, first, *_, now = [line.split() for line in repr(found).splitlines()[1 : 3 + len(found.candidates)]]
    assert now[0] == "now"
    for row in (first, now):
        told = dict(zip(heads[1:], map(float, row[1 : len(heads)]), strict=True))
        # Five digits are shown.
        assert told["V"] == pytest.approx(weights @ np.array([told[f"w{i}"] for i in (1, 2, 3)]), rel=1e-3)
    for name in ("w1", "epsilon_max"):
        assert " V " not in repr(flexopt.select(machine, (0.0, 1.6), objective=name, **options)).splitlines()[1]


def test_selections_and_stands_tell_them() -> None:
    machine, asked = flexopt.load("excavator"), {"manipulability": 2.0}
    lengths = [link["length"] for link in machine.to_dict()["links"]]
    options: dict[str, Any] = {"constraints": asked, "starts": 2, "workers": 1}
    one = flexopt.select(machine, (0.0, 1.6), base=0.0, **options)
    stand = flexopt.select_stand(machine, [(0.0, 1.6), (0.2, 1.4)], **options)
    for shown, places, e in (
        (repr(one), [one.best.constraints], [one.best.evaluation]),
        (repr(stand), [place.constraints for place in stand.places], [p.evaluation for p in stand.places]),
    ):
        told = re.search(r"manipulability ([\d.]+) m\^2 \(at least 2 m\^2\)", shown)
        assert told is not None
        least = min(each["manipulability"].value for each in places)
        assert float(told[1]) == pytest.approx(least, rel=1e-3)
        # Of two joints l1 l2 |sin q2|.
        own = [lengths[0] * lengths[1] * abs(np.sin(each.posture[1])) for each in e]
        assert least == pytest.approx(min(own), rel=1e-9)
    assert "constraints, of each kind" not in repr(flexopt.select(machine, (0.0, 1.6), base=0.0, starts=2, workers=1))


def test_names_that_read_like_corners_are_none_of_what_a_place_rests_on() -> None:
    """Obstacles whose names end as corners do, by themselves and at corners."""
    machine, heights = flexopt.load("boom-stick-bucket"), (2, 3)
    data = machine.to_dict() | {"capsules": [{"body": "boom", "start": [0.0, 0.0], "end": [5.7, 0.0], "radius": 0.2}]}
    walls = [
        {"kind": "half_plane", "name": f"wall where height is {x} m", "point": [9.0, x], "normal": [-1.0, 0.0]}
        for x in heights
    ]
    asked = {"clearance": {"distance": 0.1, "obstacles": walls}, "within": {"payload.mass": (0.0, 900.0)}}
    machine = flexopt.machine_from_dict(data)
    problem = flexopt.build_selection(machine, (7.0, 1.0), base=0.0, constraints=asked, gravity=True)
    away = [f"clearance of boom (start) from wall where height is {x} m" for x in heights]
    assert set(away) <= {row.name for row in problem.constraints}
    at_corners, loads = cornerless(problem), [f" where payload.mass is {x} kg" for x in (0, 900)]
    assert {away[0] + loads[0], away[1] + loads[1]} <= {row.name for row in problem.constraints}
    assert resting_told(away, at_corners) == away
    assert resting_told([name + load for name in away for load in loads], at_corners) == [
        f"{name} (at 2 corners of within)" for name in away
    ]
    assert resting_told([away[0], away[0] + loads[0], away[1]], at_corners) == [
        f"{away[0]} (also at 1 corner of within)",
        away[1],
    ]


def test_own_constraints_whose_names_read_like_corners_are_all_told() -> None:
    machine, b = flexopt.load("excavator"), ca.SX.sym("base", 1)
    rooms = {f"room where height is {x} m": ca.Function("f", [b], [b**x], ["base"], ["value"]) for x in (2, 4)}
    asked = [flexopt.Constraint(room, upper=-5.0, name=name, unit="m") for name, room in rooms.items()]
    with pytest.raises(flexopt.NoSolutionFound) as caught:
        flexopt.select(machine, (0.0, 1.6), base=0.0, starts=2, constraints=asked)
    assert set(rooms) <= set(caught.value.violations)
    for name in rooms:
        assert f"{name} by {caught.value.violations[name]:.3g} m" in str(caught.value)


@pytest.mark.parametrize("turned", [False, True])
def test_what_is_no_number_at_a_corner_is_the_worst_of_it(turned: bool) -> None:
    sizes = {"holding where x is 1 m": math.nan, "holding where x is 2 m": 3.0, "tool angle": 2.0}
    at_corners = {name: "holding" for name in sizes if "where" in name}
    told = violations_told(dict(reversed(sizes.items())) if turned else sizes, at_corners, {"tool angle": "rad"})
    assert sorted(told.split("; ")) == ["holding where x is 1 m, no number", "tool angle by 2 rad"]
    assert violations_told(sizes, at_corners, {}, most=1) == "holding where x is 1 m, no number"


def test_a_joint_that_keeps_a_margin_rests_on_that_and_not_on_its_end() -> None:
    """And a placement as far as nobody allowed rests on the assumed drive."""
    machine = flexopt.load("boom-stick-bucket")
    for margin, told in ((0.0, "boom upper bound"), (0.2, "boom upper bound less joint_margin")):
        problem = flexopt.build_selection(machine, (7.0, 1.0), base=0.4, constraints={"joint_margin": margin})
        z = np.array([0.5, problem.upper[1], -1.5, -0.5])
        assert resting(problem, z) == [told]
        z[0] = problem.upper[0]
        assert resting(problem, z) == ["base.x upper bound (assumed: reach)", told]


@pytest.mark.parametrize("scale", [1e-3, 1.0, 720.0])
def test_by_which_share_of_what_is_allowed_a_constraint_is_broken(scale: float) -> None:
    """In any unit, and of a value between two bounds wherever its zero is."""
    for shift in (0.0, 40.0):
        between = ConstraintValue((shift + 1.02) * scale, (shift - 1.0) * scale, (shift + 1.0) * scale, "N m")
        assert between.beyond_allowed == pytest.approx(0.02, rel=1e-9)  # 40 cancels two of sixteen digits
    assert ConstraintValue(0.9 * scale, scale, math.inf, "m").beyond_allowed == pytest.approx(0.1)
    assert ConstraintValue(-1.1 * scale, -scale, math.inf, "m").beyond_allowed == pytest.approx(0.1)
    assert ConstraintValue(scale / 2, -math.inf, scale, "m").beyond_allowed == pytest.approx(0.0)
    for value in (ConstraintValue(-1e-9 * scale, 0.0, math.inf, "m"), ConstraintValue(math.nan, -1.0, 1.0, "m")):
        assert value.beyond_allowed == math.inf
