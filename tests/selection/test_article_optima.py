"""Every local maximum of w1 at workspace y = 1.087 that theory lists, found without hints."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

import flexopt
from flexopt.selection.scan import GRID_POINTS

# Workspace x of the local maxima, and for the two that are not zero their value: (elbow, x, w1 or 0).
LISTED = {
    "inverse": [
        ("up", -2.03, 0.0),
        ("up", 2.15, 0.0),
        ("down", -1.79, 0.0),
        ("down", -0.41, -2.3e-6),
        ("down", 2.01, 0.0),
        ("down", 2.75, 0.0),
    ],
    "transpose": [
        ("up", -2.21, 0.0),
        ("up", 1.45, 0.0),
        ("down", -1.25, 0.0),
        ("down", -0.15, -1.7e-5),
        ("down", 2.09, 0.0),
    ],
}


@pytest.fixture(scope="module")
def machine():
    return flexopt.load("excavator")


@pytest.fixture(scope="module")
def target(machine):
    """A point at workspace height 1.087 m, put at inertial x = 0."""
    shoulder = flexopt.build_plant(machine).arm_segments(p=flexopt.build_plant(machine).parameter_values)["first_joint"]
    return (0.0, 1.087 + float(shoulder[1])), float(shoulder[0])


@pytest.mark.long("inverse")
@pytest.mark.parametrize("control", ["inverse", "transpose"])
def test_every_listed_maximum_is_found(machine, target, control):
    point, shoulder_x = target
    selection = flexopt.select(machine, point, control=control)
    free = [c for c in selection.candidates if not c.active]
    found = {
        (("up" if c.evaluation.posture[1] < 0 else "down"), round(-c.evaluation.base[0] - shoulder_x, 6)): c.objective
        for c in free
    }
    for elbow, x, w1 in LISTED[control]:
        # The list prints x to centimetres as read off a scan; the dense search below confirms ours to 1e-9 m.
        near = [value for (e, found_x), value in found.items() if e == elbow and abs(found_x - x) <= 0.01]
        assert len(near) == 1, (elbow, x, found)
        if w1 == 0.0:
            assert -1e-20 < near[0] <= 0.0
        else:
            assert near[0] == pytest.approx(w1, rel=0.03)
    assert len(free) == len(LISTED[control])


@pytest.mark.long
def test_maxima_near_the_straight_arm_appear_with_a_smaller_margin(machine, target):
    point, shoulder_x = target
    selection = flexopt.select(machine, point, singularity_margin_deg=1.0)
    found = [-c.evaluation.base[0] - shoulder_x for c in selection.candidates if not c.active]
    for x in (-2.809, 2.810):
        assert min(abs(f - x) for f in found) < 1e-3


@pytest.mark.long("inverse")
@pytest.mark.parametrize("control", ["inverse", "transpose"])
def test_no_better_point_in_a_dense_scan(machine, target, control):
    """SciPy's scalar search inside every bracket of a fine scan, over both branches, against the candidates."""
    point, _ = target
    problem = flexopt.build_selection(machine, point, control=control)
    selection = flexopt.solve_selection(problem)
    best = selection.best.objective
    assert best >= problem.scan.objective.max() - 1e-15
    assert problem.scan.size > 1.5 * GRID_POINTS
    measures, p = problem.measures, problem.measures.plant.parameter_values
    values = {
        (round(float(c.evaluation.base[0]), 5), bool(c.evaluation.posture[1] < 0)): c.objective
        for c in selection.candidates
    }

    def negative_w1(x, elbow):
        try:
            posture = flexopt.inverse_kinematics(machine, point, base=x, elbow=elbow)[0]
        except flexopt.UnreachableTarget:
            return 1.0
        return -float(measures.w.call([x, posture, p])[0][0])

    for (x, up), value in values.items():
        elbow = "up" if up else "down"
        local = minimize_scalar(
            negative_w1, bounds=(x - 0.02, x + 0.02), args=(elbow,), method="bounded", options={"xatol": 1e-10}
        )
        posture = flexopt.inverse_kinematics(machine, point, base=local.x, elbow=elbow)[0]
        if abs(np.sin(posture[1])) >= np.sin(np.radians(10.0)):
            assert -local.fun <= value + 1e-14
