"""The map around what was chosen, on a problem that says where the machine may stand."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import shapely
from scipy.optimize import fsolve
from shapely import affinity

import flexopt
from flexopt.model import machine_from_dict
from flexopt.study.reports import page
from flexopt.study.reports.surroundings import marks_in, stands_of, surroundings
from tests.oracles.lagrange import rest_values, springs_and_dampers
from tests.oracles.machines import NumpySource, Structure, draw_machine, regular_posture
from tests.oracles.pinocchio_chain import pinocchio_chain

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
@pytest.mark.parametrize("y", [(-3.0, 3.0), (0.055, 0.055)])
def test_a_map_that_shows_nothing_says_why(y: tuple[float, float]) -> None:
    """Where one may stand is narrower than the map's spacing: nothing is out of reach there.

    Along a way that is held nothing is broken, as the map shows how it would be.
    """
    machine = flexopt.load("slewing-excavator")
    target = flexopt.evaluate(machine, POSTURE).end_point
    slit = [(0.05, 0.05), (0.06, 0.05), (0.06, 0.06), (0.05, 0.06)]
    chosen = flexopt.select(
        machine, target, base=(0.0, 0.055, 0.0), base_range={"x": (-3.0, 3.0), "y": y}, starts=1,
        posture=POSTURE, constraints={"region": [slit], "holds": "point"},
    )  # fmt: skip
    found = surroundings(chosen, 8)
    assert found is not None
    assert "0.0 % of 64 points are reached, regular and allowed by the problem" in repr(found)
    shown: Any = SimpleNamespace(map=found, marks=marks_in(chosen, found), selection=chosen)
    told = page._map_caption(shown)
    assert told.startswith("No map is drawn: none of its 64 points is allowed; the nearest to the chosen configuration")
    # The slit's corner from the nearest of 8 points over 6 m: 3/7 m − 0.06 m.
    assert re.search(
        r"at x 0\.4286 m, y 0\.\d+ m, breaks distance inside region, −0\.3686 m \(at least 0 m\)\. A", told
    )
    assert told.endswith("Another posture at such a point may still do.")
    assert "in phase" not in repr(found)
    assert found.to_dict()["in_phase"]["modes"][0] is None
    assert not page._panels(shown)
    shown.map = replace(found, dataset=found.dataset.fillna(1.0))
    assert "No map is drawn" not in page._map_caption(shown)
    assert page._panels(shown)


def behind_wall(joints: int, seed: int, *, gravity: bool) -> tuple[dict[str, Any], flexopt.Selection, float, float]:
    """A random chain on soft springs with a ball at its end-point, and what is chosen on one side of a level wall.

    With the wall's height, and 1 where what is above it is allowed, −1 where what is below.
    """
    rng = np.random.default_rng(seed)
    data = draw_machine(
        NumpySource(rng), Structure(joints, ("x", "y", "rotation"), ()), spread=3.0, frequency=(2.0, 3.0)
    )
    data["gravity"], last = 9.81, data["links"][-1]
    tip = [last["length"], 0.0]
    data["capsules"] = [{"body": last["name"], "start": tip, "end": tip, "radius": 0.1}]
    machine = machine_from_dict(data)
    posture = regular_posture(rng, machine)
    target = flexopt.evaluate(machine, posture, gravity=gravity).end_point
    side = 1.0 if target[1] > data["base"]["length"] * np.sin(data["base"]["rest_angle"]) else -1.0
    height = target[1] - 0.3 * side
    wall = {"name": "wall", "kind": "half_plane", "point": [0.0, height], "normal": [0.0, side]}
    constraints = {"clearance": {"distance": 0.05, "obstacles": [wall]}}
    chosen = flexopt.select(
        machine, target, base=0.0, posture=posture, starts=2, constraints=constraints, gravity=gravity
    )
    return data, chosen, height, side


@pytest.mark.long("1-True")
@pytest.mark.parametrize("gravity", [False, True])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_map_of_end_points_is_blank_where_a_constraint_is_broken(seed: int, *, gravity: bool) -> None:
    """Where Pinocchio's weight and SciPy's root have the ball at the end-point: beyond the wall or not."""
    data, chosen, height, side = behind_wall(3, seed, gravity=gravity)
    found = surroundings(chosen, 16)
    assert found is not None
    assert found.options["over"] == "end_point"
    every = flexopt.map_workspace(chosen.problem.machine, **found.options)
    whole, postures = every.array("condition"), every.array("posture")
    base, stiffness = float(chosen.best.evaluation.base[0]), np.diag(springs_and_dampers(data)[0])[:3]
    chain, clear = pinocchio_chain(data, base), np.full(whole.shape, np.nan)
    for row, column in np.argwhere(np.isfinite(whole)):
        q = rest_values(data, base, postures[:, row, column])

        def off(moved: Any, q: Any = q) -> Any:
            return moved + chain.gravity(q + np.append(moved, np.zeros(3)))[:3] / stiffness

        sag = fsolve(off, np.zeros(3)) if gravity else np.zeros(3)
        tip = chain.end_point(q + np.append(sag, np.zeros(3)))
        clear[row, column] = side * (tip[1] - height) - 0.15
    shown = np.isfinite(found.array("condition"))
    assert not shown[clear < -1e-6].any()
    # A nearly straight arm breaks the constraint on what is singular, too.
    assert shown[(clear > 1e-6) & (whole < 5.0)].all()
    assert min(np.sum(clear < -1e-6), np.sum(shown)) > 10
    assert "allowed by the problem" in repr(found)
    assert ("as it sags" in found.dataset.attrs["frame"]) == gravity


@pytest.mark.long("1-3")
@pytest.mark.parametrize("joints", [2, 3])
@pytest.mark.parametrize("seed", [0, 1])
def test_marks_are_in_the_maps_own_coordinates(joints: int, seed: int) -> None:
    """Of the end-point under the weight, by Pinocchio and SciPy, from the first joint at rest in a closed form's map."""
    data, chosen, *_ = behind_wall(joints, seed, gravity=True)
    found = surroundings(chosen, 8)
    assert found is not None
    marks, stands = marks_in(chosen, found), stands_of(chosen, None)
    assert "chosen" in marks
    stiffness = np.diag(springs_and_dampers(data)[0])[:3]
    for name, place in marks.items():
        stand = stands[name]
        chain, q = pinocchio_chain(data, stand.base[0]), rest_values(data, stand.base[0], stand.posture)

        def off(moved: Any, chain: Any = chain, q: Any = q) -> Any:
            return moved + chain.gravity(q + np.append(moved, np.zeros(joints)))[:3] / stiffness

        sagged = chain.end_point(q + np.append(fsolve(off, np.zeros(3), xtol=1e-13), np.zeros(joints)))
        angle, length = data["base"]["rest_angle"], data["base"]["length"]
        joint = np.array([stand.base[0] + length * np.cos(angle), length * np.sin(angle)])
        np.testing.assert_allclose(place, sagged - (joint if joints == 2 else 0.0), atol=1e-9)
        assert np.abs(chain.end_point(q) - sagged).max() > 1e-2
