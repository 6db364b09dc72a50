"""Distances of a segment from solids: MuJoCo, the hull of the swept box (Qhull), and what happens at odd places."""

from __future__ import annotations

from itertools import product

import casadi as ca
import mujoco
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from flexopt.selection.constraints.segment_distance import (
    PARALLEL,
    from_box,
    from_segment,
    from_sphere,
    point_from_box,
)
from tests.selection.constraints.derivatives import all_finite, difference_error, with_derivatives


def box_function(d: int) -> ca.Function:
    """Inputs middle, half-way along, half sides: so that the length follows from the inputs when differentiated."""
    middle, along, half = ca.SX.sym("middle", d), ca.SX.sym("along", d), ca.SX.sym("half", d)
    length = ca.SX.sym("length")
    distance = from_box(middle - along / 2, middle + along / 2, length, half)
    return ca.Function("box", [middle, along, length, half], [distance])


BOX = {d: box_function(d) for d in (2, 3)}
BOX_DERIVATIVES = {d: with_derivatives(function) for d, function in BOX.items()}


def box_distance(start, end, half) -> float:
    start, end = np.asarray(start, float), np.asarray(end, float)
    return float(BOX[start.size]((start + end) / 2, end - start, np.linalg.norm(end - start), half))


def oracle(start, end, half) -> float:
    """Depth from the hull of the box swept by the segment; else the least distance, by ternary search on a convex function."""
    corners = np.array(list(product(*((-side, side) for side in half))))
    depth = ConvexHull(np.vstack([corners - start, corners - end])).equations[:, -1].max()
    if depth < 0:
        return float(depth)
    low, high = 0.0, 1.0
    at = lambda s: np.linalg.norm(np.maximum(np.abs(start + s * (end - start)) - half, 0))  # noqa: E731
    for _ in range(120):
        a, b = low + (high - low) / 3, high - (high - low) / 3
        low, high = (low, b) if at(a) <= at(b) else (a, high)
    return float(min(at(low), at(0.0), at(1.0)))


@pytest.mark.parametrize("d", [2, 3])
def test_box_distance_is_exact_inside_and_outside(d):
    rng = np.random.default_rng(d)
    inside = 0
    for _ in range(600):
        half = rng.uniform(0.1, 1, d)
        start = rng.uniform(-1.3, 1.3, d)
        end = start + rng.uniform(-1.5, 1.5, d) * rng.choice([0.0, 1.0, 1e-7, 1.0], d)
        if np.linalg.norm(end - start) < 1e-6:
            continue
        expected = oracle(start, end, half)
        inside += expected < 0
        assert abs(box_distance(start, end, half) - expected) <= 1e-14
    assert inside > 40


@pytest.fixture(scope="module")
def mujoco_distance():
    """Distance of a capsule from a box, sphere or plane, whose sizes and poses are set anew for each call."""

    def measure(kind, start, end, radius, size, center=(0.0, 0.0, 0.0), turn=None):
        spec = mujoco.MjSpec()
        spec.worldbody.add_geom(name="solid", type=kind, size=size, pos=center, quat=turn or [1, 0, 0, 0])
        spec.worldbody.add_geom(
            name="capsule", type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[radius, 0, 0], fromto=[*start, *end]
        )
        model = spec.compile()
        # The distance from a box is found iteratively; its own tolerance is 1e-6 m.
        model.opt.ccd_tolerance, model.opt.ccd_iterations = 1e-13, 1000
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        return mujoco.mj_geomDistance(model, data, 0, 1, 100.0, None)

    return measure


@pytest.mark.long
def test_capsules_and_boxes_in_mujoco(mujoco_distance):
    """Where the axis is outside: what MuJoCo calls depth beyond that is the depth of one contact, not the shortest way out."""
    rng = np.random.default_rng(0)
    overlapping = 0
    for _ in range(1000):
        half, radius = rng.uniform(0.1, 1, 3), rng.uniform(0.05, 0.5)
        start = rng.uniform(-3, 3, 3)
        end = start + rng.uniform(-2, 2, 3)
        distance = box_distance(start, end, half)
        if distance > 0:
            overlapping += distance < radius
            measured = mujoco_distance(mujoco.mjtGeom.mjGEOM_BOX, start, end, radius, half)
            assert abs(distance - radius - measured) <= 1e-12
    assert overlapping > 30


@pytest.mark.long
def test_capsules_and_spheres_in_mujoco(mujoco_distance):
    start, end, center = (ca.SX.sym(name, 3) for name in ("start", "end", "center"))
    length, radius = ca.SX.sym("length"), ca.SX.sym("radius")
    function = ca.Function(
        "sphere", [start, end, length, center, radius], [from_sphere([start, end], length, center, radius)]
    )
    rng = np.random.default_rng(1)
    for _ in range(1000):
        a, b, c = rng.uniform(-1, 1, (3, 3))
        radius, other = rng.uniform(0.05, 0.5, 2)
        measured = mujoco_distance(mujoco.mjtGeom.mjGEOM_SPHERE, a, b, radius, [other, 0, 0], c)
        assert abs(float(function(a, b, np.linalg.norm(b - a), c, other)) - radius - measured) <= 1e-14


def test_points_and_boxes():
    point, half = ca.SX.sym("point", 3), ca.SX.sym("half", 3)
    function = ca.Function("point", [point, half], [point_from_box(point, half)])
    rng = np.random.default_rng(2)
    for _ in range(500):
        at, sides = rng.uniform(-1.5, 1.5, 3), rng.uniform(0.1, 1, 3)
        # A segment so short that the box cannot tell.
        short = np.array([1e-7, 0, 0])
        assert abs(float(function(at, sides)) - oracle(at - short, at + short, sides)) <= 2e-7
        beyond = np.maximum(np.abs(at) - sides, 0)
        expected = np.linalg.norm(beyond) if beyond.any() else (np.abs(at) - sides).max()
        assert abs(float(function(at, sides)) - expected) <= 1e-15
    assert all_finite(with_derivatives(function), np.zeros(3), np.ones(3))
    assert all_finite(with_derivatives(function), np.ones(3), np.ones(3))


@pytest.mark.long("3")
@pytest.mark.parametrize("d", [2, 3])
def test_gradient_agrees_with_central_differences(d):
    rng = np.random.default_rng(10 + d)
    errors = []
    for _ in range(400):
        along = rng.normal(size=d)
        arguments = [rng.uniform(-1.5, 1.5, d), along, [np.linalg.norm(along)], rng.uniform(0.1, 1, d)]
        errors.append(difference_error(BOX_DERIVATIVES[d], arguments))
    # A few of so many points lie within a step of a kink: where two ways out are equally long.
    assert np.quantile(errors, 0.98) <= 1e-7
    assert max(errors) < 2.0


@pytest.mark.long
@pytest.mark.parametrize("d", [2, 3])
def test_gradient_is_clean_where_segment_and_box_are_nearly_parallel(d):
    """No end can change the distance faster than it moves, however small the tilt."""
    rng = np.random.default_rng(20 + d)
    checked = 0
    for _ in range(6000):
        along = rng.choice([0.0, 1.0, -1.0], d) + rng.choice([0, 1, -1], d) * 10.0 ** rng.uniform(-18, 0, d)
        middle = rng.choice([0, 0.5, 1, 1.5, -1, 2], d) + rng.choice([0, 1], d) * 10.0 ** rng.uniform(-18, 0, d)
        length = float(np.linalg.norm(along))
        if length < 1e-2:
            continue
        value, gradient, _ = BOX_DERIVATIVES[d](middle, along, length, np.ones(d))
        # An axis that all but touches the box has no direction to it; capsules have a radius.
        if 0 < float(value) < 1e-6:
            continue
        by_middle, by_along, by_length = np.split(gradient.full().ravel()[: 2 * d + 1], [d, 2 * d])
        turning = by_along + by_length * along / length
        checked += 1
        for side in (-1, 1):
            assert np.linalg.norm(by_middle / 2 + side * turning) <= 1 + 1e-6
    assert checked > 3000


def test_an_axis_inside_the_box_is_led_out():
    """Descending along the gradient raises the distance at the rate 1 until it is positive."""
    middle, along, half = np.array([0.2, -0.1, 0.3]), np.array([0.5, 0.2, -0.1]), np.array([0.6, 0.7, 0.8])
    length = np.linalg.norm(along)
    before = float(BOX[3](middle, along, length, half))
    assert before < 0
    gradient = BOX_DERIVATIVES[3](middle, along, length, half)[1].full().ravel()[:3]
    assert np.linalg.norm(gradient) == pytest.approx(1.0, abs=1e-12)
    after = float(BOX[3](middle + 0.999999 * -before * gradient, along, length, half))
    assert after == pytest.approx(before * 1e-6, rel=1e-6)
    assert float(BOX[3](middle + 2 * -before * gradient, along, length, half)) > 0


numbers = st.one_of(
    st.sampled_from([0.0, 1.0, -1.0, 0.5, -0.5, 2.0, 1e-17, -1e-17, PARALLEL, 1e-8]), st.floats(-3, 3, width=16)
)


@pytest.mark.parametrize("d", [2, 3])
def test_no_place_gives_nan(d):
    """Parallel, touching, through corners and edges, centred: value, gradient and Hessian are finite."""

    @settings(max_examples=300)
    @given(st.lists(numbers, min_size=d, max_size=d), st.lists(numbers, min_size=d, max_size=d))
    @example([0.0] * d, [1.0] + [0.0] * (d - 1))
    @example([0.0, 1.0, 1.0][:d], [2.0] + [0.0] * (d - 1))  # along an edge of the box
    @example([1.0, 1.0, 1.0][:d], [1.0, -1.0, 0.0][:d])  # through a corner
    @example([0.5, 0.5, 0.5][:d], [0.0, 1e-8, 0.0][:d])  # hardly longer than a point
    @example([0.75, 0.75, 0.75][:d], [0.0, 1e-8, 0.0][:d])
    def check(middle, along):
        length = float(np.linalg.norm(along))
        if length > 1e-9:
            arguments = [np.array(middle), np.array(along), length, np.ones(d)]
            assert all_finite(BOX_DERIVATIVES[d], *arguments)
            gradient = BOX_DERIVATIVES[d](*arguments)[1].full().ravel()[:d]
            assert np.linalg.norm(gradient) <= np.sqrt(d) + 1e-9
            # The direction of a short axis has the digits that its ends leave: each is rounded to half a unit in its
            # last place, and lengths of the size of the box and its place are told along it.
            size = 1 + float(np.abs(middle).max())
            allowed = 1e-12 + 2 * PARALLEL * length + np.finfo(float).eps * size**2 / length
            assert abs(float(BOX[d](*arguments)) - oracle_of(arguments)) <= allowed

    check()


def oracle_of(arguments) -> float:
    middle, along, _, half = arguments
    try:
        return oracle(middle - along / 2, middle + along / 2, half)
    except Exception as error:  # Qhull refuses slivers
        if type(error).__name__ != "QhullError":
            raise
        return float(BOX[middle.size](*arguments))


def test_spheres_give_no_nan():
    start, end, center = (ca.SX.sym(name, 3) for name in ("start", "end", "center"))
    for ends in ([start, end], [start]):
        value = from_sphere(ends, 1.0, center, ca.SX(0.3))
        function = with_derivatives(ca.Function("sphere", [start, end, center], [value]))
        for at in ([0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]):
            assert all_finite(function, np.zeros(3), np.array([1.0, 0, 0]), np.array(at))


def pair_function(d: int) -> ca.Function:
    """Inputs the ends; lengths follow from them."""
    a, b, c, e = (ca.SX.sym(name, d) for name in "abce")
    distance = from_segment([a, b], ca.norm_2(b - a), [c, e], ca.norm_2(e - c))
    return ca.Function("pair", [a, b, c, e], [distance])


PAIR = {d: pair_function(d) for d in (2, 3)}
PAIR_DERIVATIVES = {d: with_derivatives(function) for d, function in PAIR.items()}


def pair_oracle(a, b, c, e) -> float:
    """Depth of the origin in the hull of the differences, where it has one; else the least of a convex function."""
    differences = np.array([x - y for x in (a, b) for y in (c, e)])
    if len(a) == 2:
        depth = ConvexHull(differences).equations[:, -1].max()
        if depth < 0:
            return float(depth)

    def nearest(s):
        at = a + s * (b - a)
        t = np.clip((at - c) @ (e - c) / ((e - c) @ (e - c)), 0, 1)
        return np.linalg.norm(at - c - t * (e - c))

    low, high = 0.0, 1.0
    for _ in range(120):
        one, other = low + (high - low) / 3, high - (high - low) / 3
        low, high = (low, other) if nearest(one) <= nearest(other) else (one, high)
    return float(min(nearest(low), nearest(0.0), nearest(1.0)))


@pytest.mark.long
@pytest.mark.parametrize("d", [2, 3])
def test_distance_of_segments(d):
    rng = np.random.default_rng(d)
    met = 0
    for _ in range(600):
        a, b, c, e = rng.uniform(-1, 1, (4, d))
        if rng.random() < 0.2:  # parallel to rounding
            e = c + rng.uniform(0.3, 2) * (b - a) + 1e-8 * rng.uniform(-1, 1, d)
        expected = pair_oracle(a, b, c, e)
        assert float(PAIR[d](a, b, c, e)) == pytest.approx(expected, abs=1e-8)
        assert float(PAIR[d](c, e, b, a)) == pytest.approx(expected, abs=1e-8)
        met += expected < 0
    assert (met > 50) == (d == 2)


@pytest.mark.parametrize("d", [2, 3])
def test_derivatives_of_the_distance_of_segments(d):
    rng = np.random.default_rng(d)
    points = rng.uniform(-1, 1, (60, 4, d))
    assert np.quantile([difference_error(PAIR_DERIVATIVES[d], list(four)) for four in points], 0.9) <= 1e-6
    x, y = np.eye(d)[:2]
    odd = [
        (0 * x, x, 0 * x, x),
        (0 * x, x, x, 2 * x),
        (0 * x, x, y, x + y),
        (-x, x, -y, y),
        (0 * x, x, x / 2, x / 2 + y),
    ]
    assert all(all_finite(PAIR_DERIVATIVES[d], *four) for four in odd)
    ball = [ca.SX.sym("p", d)]
    function = ca.Function("ball", ball, [from_segment(ball, 0.0, [ca.SX(ca.DM(y)), ca.SX(ca.DM(x + y))], 1.0)])
    assert float(function(0.5 * x)) == pytest.approx(1.0, abs=1e-15)
