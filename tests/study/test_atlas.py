"""The atlas holds every robust posture and no other: against the article's machine written anew, and fine grids."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import numpy as np
import pytest
import scipy.optimize
import xarray as xr

import flexopt
from flexopt.errors import InputError
from tests.oracles.article import brute_force, products
from tests.oracles.machines import NumpySource, Structure, draw_machine
from tests.oracles.spatial import in_space
from tests.study.machines import limited
from tests.study.telescopes import Factors, swing, telescope

pytestmark = pytest.mark.filterwarnings("ignore::flexopt.errors.CompilerNotFound")
CONTROLS = ("inverse", "transpose")
# What the article's machine is known to have, ± each.
PAIRS = {"inverse": [(0.782, 1.683), (0.992, -1.406), (2.189, -1.403)], "transpose": [(0.468, -1.614)]}


@cache
def excavator() -> Any:
    return flexopt.load("excavator")


@cache
def whole(control: str) -> flexopt.Atlas:
    return flexopt.atlas(excavator(), control=control)


@pytest.mark.long
@pytest.mark.parametrize("control", CONTROLS)
def test_doubly_robust_postures_of_the_article(control: str) -> None:
    """Without hints: six and two with w_1 = w_2 = 0, the known ones, and no others; likewise every other pair."""
    atlas = whole(control)
    first = np.array([point.posture for point in atlas.doubly_robust if point.modes == (1, 2)])
    known = np.array(sorted([*PAIRS[control], *(tuple(-np.array(pair)) for pair in PAIRS[control])]))
    assert first.shape == known.shape
    np.testing.assert_allclose(first, known, atol=6e-4)  # three digits are known
    for i, j in ((1, 2), (1, 3), (2, 3)):
        ours = np.array([point.posture for point in atlas.doubly_robust if point.modes == (i, j)]).reshape(-1, 2)
        theirs = brute_force(control, i - 1, j - 1).reshape(-1, 2)
        assert ours.shape == theirs.shape
        np.testing.assert_allclose(ours, theirs, atol=1e-9)  # what the solver's own tolerance leaves
    for point in atlas.doubly_robust:
        e = flexopt.evaluate(excavator(), point.posture, control=control)
        for mode in point.modes:
            assert abs(e.w[mode - 1]) <= 1e-14 * atlas.w_largest.max()
            # And of its own size, so that no large measure elsewhere makes it easy.
            assert abs(e.w[mode - 1]) <= 1e-20 * e.scale[mode - 1]
        np.testing.assert_allclose(point.frequencies_hz, e.frequencies_hz, rtol=1e-12)
        np.testing.assert_allclose(point.end_point, e.end_point, atol=1e-12)
        np.testing.assert_allclose(point.scale, e.scale, rtol=1e-10)


@pytest.mark.long
@pytest.mark.parametrize("control", CONTROLS)
def test_curves_are_all_there(control: str) -> None:
    """On lines between those of the atlas's own grid: where a × b changes sign with a·b > 0 there is a curve."""
    atlas, count = whole(control), 0
    fixed = np.linspace(-3.0, 3.0, 41)
    along = np.linspace(-np.pi, np.pi, 4001) + 1e-4
    for axis in range(2):
        for value in fixed:
            boom, stick = (along, np.full(4001, value)) if axis else (np.full(4001, value), along)
            cross, dot = products(boom, stick, control)
            turns = (cross[:-1] * cross[1:] < 0) & (np.minimum(dot[:-1], dot[1:]) > 0)
            for k, mode in np.argwhere(turns):
                here = np.array([(boom[k] + boom[k + 1]) / 2, (stick[k] + stick[k + 1]) / 2])
                points = np.concatenate([c.points for c in atlas.curves if c.mode == mode + 1], axis=1)
                apart = np.abs(np.mod(points - here[:, None] + np.pi, 2 * np.pi) - np.pi).max(axis=0)
                assert apart.min() < atlas.resolution.max() / 2
                count += 1
    assert count > 300


@pytest.mark.long("inverse")
@pytest.mark.parametrize("control", CONTROLS)
def test_on_curves_the_measure_is_zero(control: str) -> None:
    atlas = whole(control)
    measures = flexopt.build_measures(excavator(), control)
    for curve in atlas.curves:
        regular = np.abs(np.sin(curve.points[1])) > 1e-3
        w = flexopt.evaluate_w(measures, [0.0], curve.points[:, regular]).w[curve.mode - 1]
        # |w_i| ≤ |a_i||b_i| φ², φ some rounding errors between a_i and b_i, which straight arms amplify.
        assert np.all(np.abs(w) <= 1e-20 * curve.scale[regular])
        dot = products(*curve.points[:, regular], control)[1][:, curve.mode - 1]
        assert np.all(dot > 0)
    for curve in atlas.curves:
        for end, at in zip(curve.ends, (curve.first, curve.last), strict=not curve.closed):
            assert end == "singular"
            assert abs(np.sin(at[1])) < 1e-9
    assert {edge.kind for edge in atlas.edges} == {"singular"}
    assert all(np.abs(np.sin(edge.points[1])).max() < 1e-12 for edge in atlas.edges)


@pytest.mark.long
def test_a_finer_grid_finds_the_same() -> None:
    """Half as many cells as the default has find all that the default finds, on the shipped machines in the plane."""
    digger = flexopt.load("boom-stick-bucket")
    cases: list[tuple[Any, dict[str, Any]]] = [
        (excavator(), {"control": "damped:0.5", "gravity": True}),
        (digger, {"posture": [-0.5]}),
        (digger, {"joints": ["stick", "bucket"], "posture": [-1.5], "control": "transpose", "gravity": True}),
    ]
    for machine, options in cases:
        coarse, fine = (flexopt.atlas(machine, cells=(n, n), **options) for n in (64, 128))
        check_alike(coarse, fine)
        for one, other in ((coarse.doubly_robust, fine.doubly_robust), (coarse.vanishing, fine.vanishing)):
            assert len(one) == len(other)
            for p, q in zip(one, other, strict=True):
                np.testing.assert_allclose(p.posture, q.posture, atol=1e-9)


def check_alike(one: flexopt.Atlas, other: flexopt.Atlas) -> None:
    """As many curves of each kind, of the same lengths but for what chords cut off."""

    def kinds(atlas: flexopt.Atlas) -> list[Any]:
        return sorted((c.mode, c.closed, sorted(c.ends), c.length) for c in atlas.curves)

    assert [kind[:3] for kind in kinds(one)] == [kind[:3] for kind in kinds(other)]
    np.testing.assert_allclose([kind[3] for kind in kinds(one)], [kind[3] for kind in kinds(other)], rtol=5e-3)


@pytest.mark.long("1", "2", "0")
@pytest.mark.parametrize("seed", range(4))
def test_random_machines(seed: int) -> None:
    """Machines of any structure: the atlas agrees with a scan of w_i by `evaluate_w` over lines of its own."""
    rng = np.random.default_rng(seed)
    structure = [
        (2, ("x", "rotation"), ()),
        (3, ("y", "rotation"), (0,)),
        (3, ("x", "y", "rotation"), ()),
        (2, ("y",), ()),
    ]
    machine = flexopt.machine_from_dict(draw_machine(NumpySource(rng), Structure(*structure[seed])))
    control = ("inverse", "transpose", "damped:0.3")[seed % 3]
    others = rng.uniform(-1.0, 1.0, len(machine.joints) - 2)
    atlas = flexopt.atlas(machine, control=control, posture=others.tolist() or None, cells=(64, 64))
    measures = flexopt.build_measures(machine, control)
    count = 0
    for axis in range(2):
        for value in rng.uniform(-3.0, 3.0, 8):
            along = np.linspace(-np.pi, np.pi, 2001)
            plane = np.full((2, 2001), value)
            plane[axis] = along
            batch = flexopt.evaluate_w(measures, [0.0], np.vstack([plane, np.repeat(others[:, None], 2001, axis=1)]))
            for mode, w in enumerate(batch.w):
                # A maximum that comes to zero within what the step of the scan can tell, by the fall to its neighbours.
                peak = 1 + np.flatnonzero((w[1:-1] > w[:-2]) & (w[1:-1] > w[2:]))
                peak = peak[np.abs(w[peak]) < 0.2 * np.minimum(w[peak] - w[peak - 1], w[peak] - w[peak + 1])]
                for k in peak:
                    points = [c.points for c in atlas.curves if c.mode == mode + 1]
                    apart = np.mod(np.concatenate(points, axis=1) - plane[:, [k]] + np.pi, 2 * np.pi) - np.pi
                    assert np.abs(apart).max(axis=0).min() < atlas.resolution.max()
                    count += 1
    assert count > 0


@pytest.mark.long
def test_limits_ranges_and_slides() -> None:
    machine = limited()
    atlas = flexopt.atlas(machine, cells=(48, 48))
    low, high = np.array(machine.limits).T
    assert (np.array(atlas.x_range), np.array(atlas.y_range)) == pytest.approx(np.array([low, high]).T)
    assert atlas.periodic == (False, False)
    for curve in atlas.curves:
        assert np.all(curve.points >= low[:, None] - 1e-12)
        assert np.all(curve.points <= high[:, None] + 1e-12)
        for end, at in zip(curve.ends, (curve.first, curve.last), strict=not curve.closed):
            on_limit = min(np.abs(at - low).min(), np.abs(at - high).min()) < 1e-9
            assert (end == "limit") == on_limit
    assert any("limit" in curve.ends for curve in atlas.curves)
    part = flexopt.atlas(excavator(), x_range=(0.5, 1.5), y_range=(-2.0, -1.0), cells=(32, 32))
    assert [p.modes for p in part.doubly_robust] == [(1, 2)]
    swapped = flexopt.atlas(
        excavator(), joints=["stick", "boom"], x_range=(-2.0, -1.0), y_range=(0.5, 1.5), cells=(32, 32)
    )
    np.testing.assert_allclose(swapped.doubly_robust[0].posture, part.doubly_robust[0].posture, atol=1e-12)


def test_where_curves_turn_a_factor_vanishes() -> None:
    digger = flexopt.load("boom-stick-bucket")
    atlas = flexopt.atlas(digger, posture=[-0.5])
    (point,) = atlas.vanishing
    assert (point.modes, point.vanishing) == ((1,), "b")
    values = flexopt.build_measures(digger).values
    at = values.call([0.0, point.posture, flexopt.build_plant(digger).parameter_values])
    a, b = (at[values.name_out().index(name)].full()[:, 0] for name in "ab")
    assert np.linalg.norm(b) < 1e-12 * np.linalg.norm(a)
    (curve,) = (c for c in atlas.curves if c.mode == 1)
    assert set(curve.ends) == {"b = 0", "limit"}


def assert_complete(
    atlas: flexopt.Atlas, machine: Any, control: str, *, rng: Any, lines: int = 5, gravity: bool = False
) -> None:
    """On lines between those of the atlas's own grid: where SciPy finds w_i = 0, from a_i and b_i, there is a curve."""
    factors, ranges = Factors(machine, control, gravity=gravity), (atlas.x_range, atlas.y_range)
    varied = [atlas.joints.index(name) for name in atlas.varied]
    posture = np.zeros(len(atlas.joints))
    posture[[k for k in range(len(posture)) if k not in varied]] = atlas.fixed
    count = [0, 0]
    for axis in range(2):
        for value in rng.uniform(*ranges[axis], lines):
            posture[varied[axis]] = value
            for which, mode, root in factors.roots(posture, varied[1 - axis], ranges[1 - axis]):
                if mode + 1 in atlas.everywhere:
                    continue
                own = [c.points for c in atlas.curves if c.mode == mode + 1 and bool(c.vanishing) == (which == 0)]
                apart = np.concatenate(own, axis=1) - root[varied][:, None]
                assert np.abs(apart / atlas.resolution[:, None]).max(axis=0).min() < 0.5
                count[which] += 1
    assert min(count) > 0
    for curve in atlas.curves:
        assert "undefined" not in curve.ends


@pytest.mark.parametrize("control", CONTROLS)
def test_where_a_keeps_to_a_line_it_is_zero_along_whole_curves(control: str) -> None:
    """A telescope with its mass on its line: beside a_i = 0, on both sides, w_i is |a_i| times what it is."""
    machine = telescope()
    atlas = flexopt.atlas(machine, control=control, cells=(32, 32))
    factors = Factors(machine, control)
    for mode in (1, 2):
        (curve,) = (c for c in atlas.curves if c.mode == mode and c.vanishing)
        assert curve.ends == ("limit", "limit")
        assert sorted((curve.first[1], curve.last[1])) == [0.0, 2.0]
        for lift, extend in curve.points[:, ::7].T:
            roots = factors.roots([lift, extend], 0, (lift - 0.04, lift + 0.03), 3)
            (root,) = (root for which, k, root in roots if (which, k) == (0, mode - 1))
            assert root[0] == pytest.approx(lift, abs=1e-9)  # rounding of a through its slope
    # And nothing else: not in pieces, and every end is told.
    assert len(atlas.curves) == 4
    assert {end for c in atlas.curves for end in c.ends} == {"limit", "b = 0"}
    assert_complete(atlas, machine, control, rng=np.random.default_rng(1))


def test_where_a_is_zero_along_curves_two_of_them_are_doubly_robust() -> None:
    machine = telescope(folds=True)
    atlas = flexopt.atlas(machine, joints=["lift", "fold"], posture=[1.0], cells=(32, 32))
    (point,) = atlas.doubly_robust
    factors = Factors(machine, "inverse")
    held = factors(point.posture[:, None])[1][:, :, 0]

    def both(z: Any) -> Any:
        """a of the second mode, and what b of the first one has along the telescope."""
        values, modes = factors(np.array([[*z, 1.0]]).T)
        return (values[[1, 0], [0, 1], 0] * np.sign(np.sum(modes[:, :, 0] * held, axis=0))) / 1e-4

    solved = scipy.optimize.fsolve(both, point.posture[:2] + np.array([0.02, -0.03]), xtol=1e-12)
    np.testing.assert_allclose(point.posture[:2], solved, atol=1e-9)
    w = flexopt.evaluate_w(flexopt.build_measures(machine), [0.0], point.posture[:, None]).w[:, 0]
    assert np.abs(w).max() < 1e-13 * atlas.w_largest.max()  # rounding of a in that of w's scale


@pytest.mark.long
@pytest.mark.parametrize("control", ["inverse", "transpose", "damped:0.3"])
@pytest.mark.parametrize("seed", range(3))
def test_random_machines_whose_a_keeps_to_a_line(control: str, seed: int) -> None:
    """Telescopes of one hinge and of two, and arms that end at their centre of percussion, over singular postures."""
    for machine, options in (
        (telescope(rng=np.random.default_rng(seed)), {}),
        (telescope(True, rng=np.random.default_rng(seed)), {"joints": ["fold", "extend"], "posture": [0.5]}),
        (telescope(True, rng=np.random.default_rng(seed)), {"joints": ["lift", "fold"], "posture": [0.5]}),
        (swing(np.random.default_rng(seed)), {}),
    ):
        atlas = flexopt.atlas(machine, control=control, cells=(48, 48), gravity=seed == 2, **options)
        rng = np.random.default_rng([seed, 1])
        assert_complete(atlas, machine, control, rng=rng, gravity=seed == 2)
        measures = flexopt.build_measures(machine, control, seed == 2)
        for point in atlas.doubly_robust:
            w = flexopt.evaluate_w(measures, [0.0], point.posture[:, None]).w[:, 0]
            assert np.abs(w[[mode - 1 for mode in point.modes]]).max() < 1e-12 * atlas.w_largest.max()


@pytest.mark.long
def test_a_telescope_in_a_plane_of_symmetry() -> None:
    machine = flexopt.load("truck-crane")
    atlas = flexopt.atlas(machine, joints=["lift", "knuckle"], posture=[0.0, 1.0], cells=(48, 48))
    assert {curve.mode for curve in atlas.curves if curve.vanishing} == {1, 3, 5}
    assert_complete(atlas, machine, "inverse", rng=np.random.default_rng(2))


@pytest.mark.long
def test_postures_in_which_a_telescope_keeps_a_at_zero_in_space() -> None:
    """Off the plane of symmetry a has two components across the telescope: it is 0 in postures, and SciPy finds them."""
    machine = flexopt.load("truck-crane")
    atlas = flexopt.atlas(machine, joints=["lift", "knuckle"], posture=[0.8, 1.0], cells=(48, 48))
    values, p = flexopt.build_measures(machine).values, flexopt.build_plant(machine).parameter_values
    a_at, modes_at = (values.name_out().index(name) for name in ("a", "modes"))

    def factors(z: Any) -> tuple[Any, Any]:
        out = values.call([np.zeros(3), np.array([0.8, *z, 1.0]), p])
        return out[a_at].full(), out[modes_at].full()

    axes = [np.linspace(*span, 31) for span in (atlas.x_range, atlas.y_range)]
    grid = np.array([[factors((x, y))[0] for y in axes[1]] for x in axes[0]])
    sizes, found = np.linalg.norm(grid, axis=2), list[tuple[float, ...]]()
    for mode in range(sizes.shape[-1]):
        size = np.pad(sizes[..., mode], 1, constant_values=np.inf)
        beside = [size[1 + i : 32 + i, 1 + j : 32 + j] for i in (-1, 0, 1) for j in (-1, 0, 1)]
        for i, j in np.argwhere(size[1:-1, 1:-1] <= np.min(beside, axis=0)):
            start = np.array([axes[0][i], axes[1][j]])
            held = factors(start)[1][:, mode]

            def a(z: Any, mode: int = mode, held: Any = held) -> Any:
                a, modes = factors(z)
                return a[:, mode] * np.sign(modes[:, mode] @ held) / sizes[..., mode].max()

            solved = scipy.optimize.least_squares(a, start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
            inside = all(axis[0] <= z <= axis[-1] for axis, z in zip(axes, solved.x, strict=True))
            if inside and np.linalg.norm(solved.fun) < 1e-9:
                found.append((mode + 1, *solved.x))
    zero = sorted(
        (q.modes[0], *q.posture[1:3]) for q in atlas.isolated if q.scale[q.modes[0] - 1] < 1e-12 * q.scale.max()
    )
    assert len(zero) == len(found) > 0
    np.testing.assert_allclose(zero, sorted(found), atol=1e-7)  # differences of SciPy's slopes


def test_modes_that_are_parallel_everywhere() -> None:
    """A crane on rails that give along x: to move the trolley along x takes the end-point nowhere in the one mode."""
    carriage = {"name": "rail", "kind": "slide", "axis": [1.0, 0.0, 0.0], "passive": True, "stiffness": 1e5}
    bodies: list[Any] = [{"name": "rail", "parent": None, "joint": carriage, "mass": 500.0}]
    for name, parent, axis in (("trolley", "rail", [1.0, 0.0, 0.0]), ("hoist", "trolley", [0.0, 0.0, 1.0])):
        bodies.append({"name": name, "parent": parent, "joint": {"name": name, "kind": "slide", "axis": axis}})
        bodies[-1] |= {"mass": 100.0}
    data = {"name": "gantry", "bodies": bodies, "end_point": {"body": "hoist", "rows": ["x", "z"]}, "gravity": 9.81}
    atlas = flexopt.atlas(flexopt.tree_from_dict(data), cells=(8, 8))
    assert atlas.everywhere == (1,)
    assert atlas.curves == ()
    assert "parallel in every posture" in repr(atlas)


@pytest.mark.long
def test_the_same_machine_as_a_tree_in_space() -> None:
    atlas = flexopt.atlas(flexopt.tree_from_dict(in_space({**excavator().to_dict(), "gravity": 9.81})))
    for one, other in zip(atlas.doubly_robust, whole("inverse").doubly_robust, strict=True):
        np.testing.assert_allclose(one.posture, other.posture, atol=1e-10)
    check_alike(atlas, whole("inverse"))


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "joints", "others"),
    [("slewing-excavator", ["slew", "boom"], [-1.2, -0.5]), ("truck-crane", ["slew", "lift"], [-0.8, 1.5])],
)
def test_points_of_machines_in_space(name: str, joints: list[str], others: list[float]) -> None:
    """With three task rows a ∥ b in postures by themselves: those that a scan and SciPy find, and no others."""
    machine = flexopt.load(name)
    span = {"x_range": (0.4, 2.8), "y_range": (-0.25, 1.0)}
    atlas = flexopt.atlas(machine, joints=joints, posture=others, cells=(48, 48), **span)
    for point in atlas.isolated:
        e = flexopt.evaluate(machine, point.posture)
        assert abs(e.w[point.modes[0] - 1]) <= 1e-20 * e.scale[point.modes[0] - 1]
    found = sorted((p.modes[0], *p.posture[:2]) for p in atlas.isolated)
    expected = scanned(machine, others, **span)
    assert len(expected) > 1
    assert len(found) == len(expected)
    np.testing.assert_allclose(found, expected, atol=1e-6)


def scanned(machine: Any, others: list[float], x_range: Any, y_range: Any) -> list[tuple[float, ...]]:
    """(mode, two joints) with a ∥ b: cells in which both x and z of a × b change sign, then SciPy's least squares."""
    values, p = flexopt.build_measures(machine).values, flexopt.build_plant(machine).parameter_values
    names, count = values.name_out(), 81
    grid = np.array(np.meshgrid(np.linspace(*x_range, count), np.linspace(*y_range, count), indexing="ij"))
    postures = np.vstack([grid.reshape(2, -1), np.repeat(np.array(others)[:, None], count**2, axis=1)])
    given = [np.zeros((3, count**2)), postures, np.repeat(p.full(), count**2, axis=1)]
    every = values.map(count**2).call(given)
    a, b = (every[names.index(name)].full().reshape(3, count, count, -1) for name in "ab")
    positive = np.cross(a, b, axis=0)[[0, 2]] > 0
    corners = [positive[:, i : i + count - 1, j : j + count - 1] for i in (0, 1) for j in (0, 1)]
    changes = np.all(np.any(corners, axis=0) & ~np.all(corners, axis=0), axis=0)
    found: list[tuple[float, ...]] = []
    for i, j, mode in np.argwhere(changes):

        def angle(z: Any, mode: int = mode) -> Any:
            """Sines, and the cosine, of the angle between a and b."""
            out = values.call([np.zeros(3), np.array([*z, *others]), p])
            a, b = (
                out[names.index(name)].full()[:, mode] / np.linalg.norm(out[names.index(name)].full()[:, mode])
                for name in "ab"
            )
            return np.cross(a, b), a @ b

        start = (grid[:, i, j] + grid[:, i + 1, j + 1]) / 2
        solved = scipy.optimize.least_squares(lambda z, f=angle: f(z)[0], start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
        inside = all(low < z < high for z, (low, high) in zip(solved.x, (x_range, y_range), strict=True))
        if inside and solved.cost < 1e-18 and np.abs(solved.x - start).max() < 0.1 and angle(solved.x)[1] > 0:
            new = (mode + 1.0, *solved.x)
            if all(np.abs(np.subtract(new, known)).max() > 1e-4 for known in found):
                found.append(new)
    return sorted(found)


@pytest.mark.long
def test_in_a_plane_of_symmetry_machines_in_space_have_curves() -> None:
    """Without slew the modes in the arm's plane have a × b across it, those out of it none at all."""
    machine = flexopt.load("slewing-excavator")
    atlas = flexopt.atlas(machine, joints=["boom", "stick"], posture=[0.0, -0.5], cells=(32, 32))
    assert atlas.everywhere == (6,)
    assert {curve.mode for curve in atlas.curves} == {1, 3, 4}
    for curve in atlas.curves:
        for k in (0, curve.size // 2, -1):
            posture = [0.0, *curve.points[:, k], -0.5]
            e = flexopt.evaluate(machine, posture)
            assert abs(e.w[curve.mode - 1]) <= 1e-16 * e.scale.max()
    assert np.flatnonzero(atlas.robust_share > 0.3).tolist() == [1, 4]


def test_document_dataset_and_file(tmp_path: Any) -> None:
    atlas = whole("inverse")
    document = atlas.to_dict()
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert [curve["mode"] for curve in document["curves"]] == [1, 1, 1, 2, 2, 3, 3, 3]
    assert len(document["doubly_robust"]) == 12
    dataset = atlas.dataset
    for number, curve in enumerate(atlas.curves):
        own = dataset["curve"].values == number
        np.testing.assert_array_equal(dataset["posture"].values[:, own], curve.points)
        np.testing.assert_array_equal(dataset["scale"].values[own], curve.scale)
        assert dataset["curve_mode"].values[number] == curve.mode
    atlas.to_netcdf(tmp_path / "atlas.nc")
    read = xr.load_dataset(tmp_path / "atlas.nc", engine="scipy")
    np.testing.assert_array_equal(read["point_posture"], dataset["point_posture"])
    assert "smaller loops may be missed" in read.attrs["note"]


def test_what_cannot_be_mapped_is_said() -> None:
    data: Any = flexopt.load("truck-crane").to_dict()
    data["end_point"] |= {"rows": ["z"]}
    with pytest.raises(
        InputError, match=r"has a task of 1 row \(z\); over two joints w_i = 0 is curves where it has two"
    ):
        flexopt.atlas(flexopt.tree_from_dict(data), posture=[-0.8, 1.5])
    with pytest.raises(InputError, match="4 faults") as error:
        flexopt.atlas(excavator(), joints=["boom", "boom"], cells=(3, 3), x_range=(0.0, 9.0), control="both")
    assert {fault.field for fault in error.value.faults} == {"joints", "cells", "x_range", "control"}
    with pytest.raises(InputError, match="outside the limits of boom"):
        flexopt.atlas(flexopt.load("boom-stick-bucket"), posture=[-0.5], x_range=(0.0, 1.0))
