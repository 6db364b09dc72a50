"""The map around what was chosen, on a problem that says where the machine may stand."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import shapely
from shapely import affinity

import flexopt
from flexopt.study.reports import page
from flexopt.study.reports.surroundings import marks_in, surroundings

BARRED, POSTURE = ((1.0, -2.0), (2.0, -2.0), (2.0, 1.0), (1.0, 1.0)), (0.2, 0.5, -1.2, -0.5)


@pytest.mark.long
@pytest.mark.parametrize("gravity", [False, True])
def test_a_map_of_placements_is_blank_where_the_machine_may_not_stand(gravity: bool) -> None:
    """The footprint beside the barred area by Shapely; the range is the map's; the chosen place is within."""
    machine = flexopt.load("slewing-excavator")
    target = flexopt.evaluate(machine, POSTURE).end_point
    asked = {"keep_out": [BARRED]}
    chosen = flexopt.select(
        machine, target, base=(0.0, 0.0, 0.0), base_range={"x": (-3.0, 3.0), "y": (-3.0, 3.0)}, starts=2,
        constraints=asked, gravity=gravity,
    )  # fmt: skip
    found = surroundings(chosen, 16)
    assert found is not None
    x, y = (np.asarray(found.dataset[f"base_{name}"].values) for name in "xy")
    assert (x.min(), x.max(), y.min(), y.max()) == (-3.0, 3.0, -3.0, 3.0)
    w = np.asarray(found.dataset["w"].values)[0]
    yaw, own, rock = chosen.best.z[2], shapely.Polygon(machine.support_points), shapely.Polygon(BARRED)
    turned, tried = affinity.rotate(own, yaw, origin=(0, 0), use_radians=True), 0
    for (row, column), value in np.ndenumerate(w):
        stand = affinity.translate(turned, x[column], y[row])
        tried += int(overlaps := rock.intersection(stand).area > 1e-6)
        assert not overlaps or np.isnan(value)
    assert 0 < tried < w.size
    assert np.isfinite(w).mean() > 0.1
    marks = marks_in(chosen, found)
    assert {"chosen", "present"} <= set(marks)
    # The end-point lies beside the plane.
    assert target[0] > 3.0
    assert "end-point" not in marks


@pytest.mark.long
def test_across_a_way_that_is_held_the_map_shows_how_it_would_be() -> None:
    """As of a machine on rails: no placement of the plane but one line could be stood on."""
    machine = flexopt.load("slewing-excavator")
    target = flexopt.evaluate(machine, POSTURE).end_point
    held = {"x": (-3.0, 3.0), "y": (0.0, 0.0)}
    chosen = flexopt.select(machine, target, base=(0.0, 0.0, 0.0), base_range=held, starts=2)
    found = surroundings(chosen, 12)
    assert found is not None
    assert np.isfinite(np.asarray(found.dataset["w"].values)[0]).mean() > 0.2
    assert "reached, regular and allowed by the problem, as if y were free" in repr(found)
    shown: Any = SimpleNamespace(map=found, marks={}, selection=chosen)
    assert page._map_caption(shown).endswith(" The base is held along y: there the map shows how it would be.")


@pytest.mark.long
def test_a_map_that_shows_nothing_says_why() -> None:
    """Where one may stand is narrower than the map's spacing: nothing is out of reach there."""
    machine = flexopt.load("slewing-excavator")
    target = flexopt.evaluate(machine, POSTURE).end_point
    slit = [(0.05, 0.05), (0.06, 0.05), (0.06, 0.06), (0.05, 0.06)]
    chosen = flexopt.select(
        machine, target, base=(0.0, 0.0, 0.0), base_range={"x": (-3.0, 3.0), "y": (-3.0, 3.0)}, starts=1,
        posture=POSTURE, constraints={"region": [slit], "holds": "point"},
    )  # fmt: skip
    found = surroundings(chosen, 8)
    assert found is not None
    assert "0.0 % of 64 points are reached, regular and allowed by the problem" in repr(found)
    shown: Any = SimpleNamespace(map=found, marks=marks_in(chosen, found), selection=chosen)
    assert page._map_caption(shown).endswith(page.NOWHERE)
    shown.map = replace(found, dataset=found.dataset.fillna(1.0))
    assert page.NOWHERE not in page._map_caption(shown)
