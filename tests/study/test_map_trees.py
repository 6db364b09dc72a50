"""Maps of machines in space: over joints, over planes of the task, over the placement."""

import json

import numpy as np
import pytest
import xarray as xr

import flexopt
from flexopt.compiled.threaded import Interpreter
from flexopt.model.tree import tree_from_dict
from flexopt.plant import build_plant
from flexopt.robustness.margin import build_margin
from flexopt.study.maps import follow
from flexopt.study.maps.grid import task_ranges
from flexopt.study.maps.points import _measures_of_many
from tests.cli.command import Command
from tests.oracles.spatial import grounded, in_space, random_tree
from tests.study.machines import gantry, three_links

pytestmark = pytest.mark.filterwarnings("ignore::flexopt.errors.CompilerNotFound")
REFERENCE = [0.3, -0.9, 1.3]


@pytest.fixture(scope="module")
def excavator():
    return flexopt.load("excavator")


@pytest.fixture(scope="module")
def twin(excavator):
    """The excavator, sent through space."""
    return tree_from_dict(in_space({"gravity": 9.81} | excavator.to_dict()))


@pytest.fixture(scope="module")
def slewing():
    """Six passive coordinates, placed by x, y and yaw."""
    return tree_from_dict(grounded(3, 0))


def placement(result, machine, row, column):
    base = np.array(result.options.get("base", np.zeros(len(machine.base_coordinates))), dtype=float)
    for axis, index in zip(result.axes, (row, column), strict=True):
        if axis.startswith("base_"):
            base[machine.base_coordinates.index(axis[5:])] = result.array(axis)[index]
    return base


def random_cells(result, count, seed=0):
    cells = np.argwhere(np.isfinite(result.array("condition")))
    assert len(cells) >= count
    return np.random.default_rng(seed).permutation(cells)[:count]


def check_cells(result, machine, *, count=3):
    """What the map says at random cells against `evaluate`; the evaluations."""
    found = []
    for row, column in random_cells(result, count):
        at = {name: result.array(name)[..., row, column] for name in map(str, result.dataset.data_vars)}
        e = flexopt.evaluate(
            machine, at["posture"], base=placement(result, machine, row, column), control=result.options["control"]
        )
        np.testing.assert_allclose(at["frequency_hz"], e.frequencies_hz, rtol=1e-9)
        np.testing.assert_allclose(at["w"], e.w, rtol=1e-7, atol=1e-11 * e.scale.max())
        np.testing.assert_allclose(at["rigid"], e.rigid, rtol=1e-8, atol=1e-14)
        np.testing.assert_allclose(at["condition"], e.condition, rtol=1e-8)
        assert tuple(at["in_phase"] == 1) == e.in_phase
        # Doubling with the fixed scaling of a batch: its residual may be 1e-8 where frequencies are far apart.
        np.testing.assert_allclose(at["epsilon_max"], e.epsilon_max, rtol=1e-6)
        found.append((row, column, e))
    return found


def check_quickly(result, machine, *, count=4):
    """As `check_cells`, frequencies and w_i alone, which are made much sooner; cells with base, posture and r."""
    values = flexopt.build_measures(machine, result.options["control"]).values
    p = build_plant(machine).parameter_values
    for row, column in random_cells(result, count):
        base, posture = placement(result, machine, row, column), result.array("posture")[:, row, column]
        v = {name: value.full() for name, value in values(base=base, posture=posture, p=p).items()}
        scale = np.linalg.norm(v["a"], axis=0) * np.linalg.norm(v["b"], axis=0)
        hertz = np.sqrt(v["omega_squared"].ravel()) / (2 * np.pi)
        np.testing.assert_allclose(result.array("frequency_hz")[:, row, column], hertz, rtol=1e-9)
        np.testing.assert_allclose(
            result.array("w")[:, row, column], v["w"].ravel(), rtol=1e-7, atol=1e-11 * scale.max()
        )
        yield row, column, base, posture, v["end_point"].ravel()


def test_same_map_in_the_plane_and_in_space(excavator, twin):
    options = {"over": "posture", "points": (13, 11), "joints": ("stick", "boom")}
    plane, space = (flexopt.map_workspace(machine, **options) for machine in (excavator, twin))
    assert space.axes == plane.axes == ("angle_1", "angle_2")
    for name in ("frequency_hz", "w", "scale", "in_phase", "in_phase_strict", "rigid", "epsilon_max", "condition"):
        np.testing.assert_allclose(space.array(name), plane.array(name), rtol=1e-8, atol=1e-13, err_msg=name)
    np.testing.assert_array_equal(space.array("posture"), plane.array("posture"))


def test_followed_postures_are_those_of_the_closed_form(excavator, twin):
    closed = flexopt.map_workspace(excavator, points=(31, 27), epsilon_max=False)
    plant = build_plant(twin)
    shoulder = plant.skeleton(plant.rest(0.0, [0.0, 0.0], plant.parameter_values), 0.0, plant.parameter_values)
    x, z = shoulder.full()[[0, 2], 4]
    reach = closed.options["x_range"][1]
    followed = flexopt.map_workspace(
        twin, posture=[0.9, -2.6], x_range=(x - reach, x + reach), y_range=(z - reach, z + reach), points=(31, 27),
        epsilon_max=False,
    )  # fmt: skip
    assert followed.axes == ("z", "x")
    mapped = np.isfinite(closed.array("condition"))
    # Four cells touch the very edge of the reach, where the arm is straight: rounding decides of them.
    inside = np.hypot(*np.meshgrid(closed.array("x"), closed.array("y"))) < reach - 1e-9
    np.testing.assert_array_equal(np.isfinite(followed.array("condition"))[inside], mapped[inside])
    turned = np.exp(1j * followed.array("posture")) - np.exp(1j * closed.array("posture"))
    np.testing.assert_allclose(np.abs(turned[:, mapped]), 0.0, atol=1e-8)
    np.testing.assert_allclose(followed.array("w")[:, mapped], closed.array("w")[:, mapped], rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize(("seed", "control"), [(10, "transpose"), (12, "inverse")])
def test_random_trees_over_joints(seed, control):
    """Hinges and slides, branched or not."""
    machine = tree_from_dict(random_tree(seed, counts=(2, 4)))
    rng = np.random.default_rng(seed)
    chosen = [machine.joints[k] for k in rng.permutation(4)[:2]]
    others = rng.uniform(-0.5, 0.5, 2)
    result = flexopt.map_workspace(
        machine, over="posture", joints=chosen, posture=others, points=(5, 4), control=control, x_range=(-0.7, 0.9),
        y_range=(-0.4, 0.8),
    )  # fmt: skip
    words = {"rad": "angle", "m": "slide"}
    units = dict(zip(machine.joints, machine.joint_units, strict=True))
    for axis, joint in zip(result.axes[::-1], chosen, strict=True):
        assert axis == f"{words[units[joint]]}_{machine.joints.index(joint) + 1}"
        assert result.dataset[axis].attrs["units"] == units[joint]
        np.testing.assert_array_equal(
            np.unique(result.array("posture")[machine.joints.index(joint)]), result.array(axis)
        )
    check_cells(result, machine)


@pytest.mark.parametrize("seed", [12])
def test_redundant_tree_takes_the_posture_nearest_to_the_reference(seed):
    machine = tree_from_dict(random_tree(seed, counts=(2, 5)))
    plant = build_plant(machine)
    p = plant.parameter_values
    reference, base = np.full(5, 0.1), np.zeros(plant.n_base)
    r = plant.end_point(plant.rest(base, reference, p), base, p).full().ravel()
    span = [(float(r[k]) - 0.25, float(r[k]) + 0.25) for k in (0, 2)]
    result = flexopt.map_workspace(
        machine, posture=reference, rows=("x", "z"), x_range=span[0], y_range=span[1], points=(7, 6), epsilon_max=False
    )
    assert result.array("reachable").mean() > 0.5
    for row, column, _, posture, end_point in check_quickly(result, machine):
        target = np.array([result.array("x")[column], r[1], result.array("z")[row]])
        np.testing.assert_allclose(end_point, target, atol=1e-9)
        jacobian = plant.rigid_jacobian(plant.rest(base, posture, p), base, p).full()
        towards = reference - posture
        # What leads to the reference, the end-point held, is nothing: the distance is stationary.
        left = towards - np.linalg.pinv(jacobian) @ jacobian @ towards
        np.testing.assert_allclose(left, 0.0, atol=1e-7)


def test_redundant_planar_arm_over_end_points():
    machine = three_links()
    result = flexopt.map_workspace(machine, posture=[0.9, -1.4, -0.5], points=(9, 8), base=-0.5, epsilon_max=False)
    assert result.dataset.attrs["frame"].startswith("inertial")
    for row, column, base, _, end_point in check_quickly(result, machine):
        np.testing.assert_allclose(end_point, [result.array("x")[column], result.array("y")[row]], atol=1e-9)
        assert base[0] == -0.5


def test_a_plane_of_end_points_holds_all_that_is_reached():
    """By default: to what the arm stretched out reaches, with limits to the farthest of many postures and beyond none."""
    machine = three_links()
    plant = build_plant(machine)
    ends = task_ranges(plant, np.zeros(plant.n_base))
    shoulder = plant.arm_segments(p=plant.parameter_values)["first_joint"].full().ravel()
    length = sum(link.length for link in machine.links)
    np.testing.assert_allclose(ends, np.column_stack([shoulder - length, shoulder + length]), atol=1e-6)
    limits = np.array([[-0.3, 1.2], [-2.0, 0.4], [-0.5, 0.5]])
    data = machine.to_dict()
    data["links"] = [{**link, "limits": pair} for link, pair in zip(data["links"], limits.tolist(), strict=True)]
    narrow = build_plant(flexopt.machine_from_dict(data))
    (low, high), postures = limits.T, np.random.default_rng(0).random((4000, 3))
    reached = np.array([
        narrow.end_point(narrow.rest(np.zeros(1), q, p := narrow.parameter_values), np.zeros(1), p).full().ravel()
        for q in low + (high - low) * postures
    ])  # fmt: skip
    ends = np.array(task_ranges(narrow, np.zeros(1)))
    assert np.all(ends[:, 0] <= reached.min(axis=0) + 1e-9)
    assert np.all(ends[:, 1] >= reached.max(axis=0) - 1e-9)
    assert np.all(ends[:, 1] < reached.max(axis=0) + 0.1)


@pytest.mark.parametrize("coordinates", [("x", "y"), ("yaw", "x")])
def test_where_to_stand(slewing, coordinates):
    plant = build_plant(slewing)
    target = [2.2, 0.6, 1.1]
    result = flexopt.map_workspace(
        slewing, over="base", coordinates=coordinates, posture=REFERENCE, end_point=target, base=[0.1, 0.0, 0.2],
        points=(7, 6), epsilon_max=False,
    )  # fmt: skip
    assert result.axes == (f"base_{coordinates[1]}", f"base_{coordinates[0]}")
    assert 0.2 < result.array("reachable").mean() < 1.0
    signs = set()
    held = {"x": 0.1, "y": 0.0, "yaw": 0.2}
    for row, column, base, posture, end_point in check_quickly(result, slewing):
        np.testing.assert_allclose(end_point, target, atol=1e-9)
        at = held | {
            coordinates[0]: result.array(result.axes[1])[column],
            coordinates[1]: result.array(result.axes[0])[row],
        }
        assert base.tolist() == [at[name] for name in slewing.base_coordinates]
        p = plant.parameter_values
        jacobian = plant.rigid_jacobian(plant.rest(base, posture, p), base, p)
        signs.add(np.sign(np.linalg.det(jacobian.full())))
    assert len(signs) == 1
    marks = json.loads(result.dataset.attrs["marks"])
    assert marks["reference"] == [held[name] for name in coordinates]
    assert ("end-point" in marks) == ("yaw" not in coordinates)


HELD = {"over": "base", "posture": [1.45, 0.17, 0.2837941], "base": [0.5, 0.16, 0.0], "end_point": [2.4, 0.3, 1.5]}


def test_a_map_of_few_points_shows_where_a_short_arm_may_stand():
    """Against its geometry: x and y of the end-point from reach and swivel."""
    result = flexopt.map_workspace(tree_from_dict(gantry()), points=(12, 12), epsilon_max=False, measures=False, **HELD)
    # In the row x from 1.25 m + 0.1 m, the head turned back as far as it goes, to all of it; in y the head's 0.5 m.
    ends = 2.4 - 1.25 - 1.7 - 0.5, 2.4 - 1.25 - 0.1 - 0.5 * np.cos(2.2)
    np.testing.assert_allclose(result.options["x_range"], ends, atol=1e-6)
    np.testing.assert_allclose(result.options["y_range"], (-0.2, 0.8), atol=1e-6)
    x, y = np.meshgrid(result.array("base_x"), result.array("base_y"))
    inside = np.abs(y - 0.3) < 0.5 - 1e-6
    swivel = np.arcsin(np.where(inside, (0.3 - y) / 0.5, 0.0))
    reach = 2.4 - x - 1.25 - 0.5 * np.cos(swivel)
    possible = (reach >= 0.1) & (reach <= 1.7)
    assert 0.4 < possible[inside].mean() < 0.9
    np.testing.assert_array_equal((result.array("reachable") == 1)[inside], possible[inside])
    wanted = np.array([np.full_like(x, 1.45), reach, swivel])[:, inside & possible]
    np.testing.assert_allclose(result.array("posture")[:, inside & possible], wanted, atol=1e-8)


def test_a_base_between_points_that_do_not_reach_is_told_as_such():
    machine = tree_from_dict(gantry())
    wide = {"x_range": (-3.9, 8.7), "y_range": (-6.0, 6.6), "epsilon_max": False, "measures": False}
    with pytest.raises(
        flexopt.InputError, match=r"1\.15 m along x and 1.15 m along y apart, is the end-point"
    ) as caught:
        flexopt.map_workspace(machine, points=(12, 12), **HELD, **wide)
    (fault,) = caught.value.faults
    assert (fault.field, fault.value) == ("points", "(12, 12)")
    assert "it is with the base at x 0.5000, y 0.1600 m, yaw 0.0000 rad: ask for more points" in fault.sentence
    assert flexopt.map_workspace(machine, points=(13, 13), **HELD, **wide).array("reachable").sum() == 2


def test_points_that_reach_are_found_however_far_the_base_stands():
    machine = tree_from_dict(gantry())
    held = HELD | {"points": (48, 48), "epsilon_max": False, "measures": False}
    near, far = (
        flexopt.map_workspace(machine, **held | {"base": base}).array("reachable")[1:-1]
        for base in ([0.5, 0.16, 0.0], [9.0, 9.0, 0.0])
    )
    assert near.any()
    np.testing.assert_array_equal(far, near)
    held |= {"end_point": [2.4, 0.3, 9.0]}
    with pytest.raises(
        flexopt.UnreachableTarget, match=r"stays 6\.35 m off .*; nor is it reached from any point"
    ) as caught:
        flexopt.map_workspace(machine, **held)
    assert caught.value.miss == pytest.approx(9.0 - 2.65, abs=1e-6)


def test_margins_of_six_passive_coordinates(slewing):
    calls = []
    result = flexopt.map_workspace(
        slewing, over="base", posture=REFERENCE, points=(3, 3), x_range=(-0.4, 0.6), y_range=(-0.5, 0.5),
        progress=lambda done, total: calls.append((done, total)),
    )  # fmt: skip
    # Nine postures that are followed, then as many as were found.
    found = int(result.array("reachable").sum())
    assert calls[-1] == (9 + found, 9 + found)
    assert [call for call in calls if call[1] == 18 and 0 < call[0] < 9]
    assert sorted(done for done, _ in calls) == [done for done, _ in calls]
    function, p = build_margin(slewing).physical_plant, build_plant(slewing).parameter_values
    for row, column, base, posture, _ in check_quickly(result, slewing):
        a, b, c = (matrix.full() for matrix in function.call([base, posture, p]))
        # By the general Riccati solvers, which leave some 1e-6 here: 18 states, and no modal scaling.
        epsilon = float(flexopt.robust_margin(a, result.options["gain"] * b, c))
        np.testing.assert_allclose(result.array("epsilon_max")[row, column], epsilon, rtol=2e-5)


def test_limits_are_kept():
    data = grounded(3, 0)
    limits = {"a1": [-1.2, -0.2], "a2": [0.4, 1.6]}
    for body in data["bodies"]:
        if body["joint"]["name"] in limits:
            body["joint"]["limits"] = limits[body["joint"]["name"]]
    machine = tree_from_dict(data)
    options = {"rows": ("x", "z"), "posture": REFERENCE, "points": (13, 12), "epsilon_max": False, "measures": False}
    bounded, free = (flexopt.map_workspace(m, **options) for m in (machine, tree_from_dict(grounded(3, 0))))
    reached = bounded.array("reachable") == 1
    assert 0 < reached.sum() < (free.array("reachable") == 1).sum()
    posture = bounded.array("posture")[:, reached]
    for name, (low, high) in limits.items():
        values = posture[machine.joints.index(name)]
        assert values.min() >= low
        assert values.max() <= high


def test_task_of_one_row():
    machine = tree_from_dict(random_tree(3, counts=(2, 3), rows=("z",)))
    result = flexopt.map_workspace(
        machine, over="posture", posture=[0.2], points=(4, 3), x_range=(-1, 1), y_range=(0, 1)
    )
    check_cells(result, machine)
    with pytest.raises(flexopt.InputError, match=r"needs two task rows, not 1 \(z\)"):
        flexopt.map_workspace(machine, posture=[0.2, 0.1, 0.0])


def test_file_of_hinges_and_slides(tmp_path):
    machine = next(
        m
        for m in (tree_from_dict(random_tree(seed, counts=(2, 3))) for seed in range(40))
        if set(m.joint_units) == {"rad", "m"}
    )
    result = flexopt.map_workspace(machine, over="posture", posture=[0.1], points=(3, 3), epsilon_max=False)
    result.to_netcdf(tmp_path / "map.nc")
    back = xr.load_dataset(tmp_path / "map.nc", engine="scipy")
    assert back.equals(result.dataset)
    assert back["posture"].attrs["units"] == ", ".join(machine.joint_units)
    repr(result)
    json.dumps(result.to_dict(), allow_nan=False)


def test_threads_change_nothing(slewing):
    function = _measures_of_many(flexopt.build_measures(slewing)).function
    plant = build_plant(slewing)
    postures = np.random.default_rng(0).uniform(-1, 1, (3, 67))
    p = plant.parameter_values.full().ravel()
    one, three = (Interpreter(function)(np.zeros(3), postures, p, threads=n) for n in (1, 3))
    for a, b in zip(one, three, strict=True):
        np.testing.assert_array_equal(a, b)


BAD = {
    "unknown joint": ({"over": "posture", "posture": [0.1], "joints": ("a1", "bom")}, "joints", "'bom' not among"),
    "same joint twice": ({"over": "posture", "posture": [0.1], "joints": ("a1", "a1")}, "joints", "twice"),
    "one joint": ({"over": "posture", "posture": [0.1], "joints": "a1"}, "joints", "must be two names"),
    "numbers for joints": ({"over": "posture", "posture": [0.1], "joints": (0, 1)}, "joints", "must be two names"),
    "others missing": ({"over": "posture", "joints": ("a0", "a2")}, "posture", "do not vary (a1)"),
    "no reference": ({}, "over", "give the posture to start from"),
    "no reference to stand": ({"over": "base"}, "posture", "a0, a1, a2"),
    "unknown row": ({"rows": ("x", "pitch"), "posture": REFERENCE}, "rows", "'pitch' not among the task rows: x, y, z"),
    "unknown coordinate": ({"over": "base", "coordinates": ("x", "z"), "posture": REFERENCE}, "coordinates", "'z'"),
    "short reference": ({"posture": [0.1, 0.2]}, "posture", "needs 3 angles"),
    "short end-point": ({"over": "base", "posture": REFERENCE, "end_point": [1, 2]}, "end_point", "3 numbers x, y, z"),
    "base": ({"over": "base", "posture": REFERENCE, "base": [1.0]}, "base", "x, in m, y, in m, yaw, in rad"),
    "joints over the base": ({"over": "base", "posture": REFERENCE, "joints": ("a0", "a1")}, "joints", "goes with"),
    "rows over the posture": ({"over": "posture", "posture": [0.1], "rows": ("x", "y")}, "rows", "goes with"),
    "end-point over the posture": ({"over": "posture", "posture": [0.1], "end_point": [1, 2, 3]}, "end_point", "goes"),
    "range of yaw": (
        {"over": "base", "posture": REFERENCE, "coordinates": ("x", "yaw"), "y_range": (-99, 99)}, "y_range", "rad",
    ),
    "range of x": ({"over": "base", "posture": REFERENCE, "x_range": (1, 0)}, "x_range", "in m"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_faults(slewing, case):
    options, field, words = BAD[case]
    with pytest.raises(flexopt.InputError) as caught:
        flexopt.map_workspace(slewing, points=(3, 3), **options)
    assert words in {fault.field: fault.sentence for fault in caught.value.faults}[field]


def test_planar_arms_are_told_what_they_cannot_have(excavator):
    with pytest.raises(flexopt.InputError) as caught:
        flexopt.map_workspace(excavator, rows=("x", "y"), base=1.0, end_point=[0, 1])
    assert {fault.field for fault in caught.value.faults} == {"rows", "base", "end_point"}
    with pytest.raises(flexopt.InputError, match="needs two placement coordinates, not 1"):
        flexopt.map_workspace(excavator, over="base", posture=[1.0, -1.0])


def test_unreachable_from_where_it_stands(slewing):
    with pytest.raises(flexopt.UnreachableTarget, match="cannot reach") as caught:
        flexopt.map_workspace(slewing, over="base", posture=REFERENCE, end_point=[2.0, 0.0, 50.0], points=(4, 4))
    assert caught.value.miss > 40


def test_command(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command = Command(capsys, tmp_path)
    swapped = command.json("map", "excavator", "--over", "posture", "--joints", "stick,boom", "--points", "4,3")
    assert list(swapped["axes"]) == ["angle_2", "angle_1"]
    assert swapped["axes"]["angle_2"]["points"] == 4
    outcome = command("map", "excavator", "--over", "posture", "--joints", "boom,boom")
    assert outcome.code == 2
    assert "--joints = ['boom', 'boom']: names the same one twice" in outcome.stderr
    outcome = command("map", "excavator", "--over", "base", "--posture", "1,-1", "--coordinates", "x,y")
    assert "--over = 'base': needs two placement coordinates" in outcome.stderr


@pytest.mark.long
def test_a_cell_beside_a_joints_limit_is_reached_from_its_other_side():
    """Where the slew's two ends meet, cells about one that was missed hold it near either end."""
    crane = flexopt.load("truck-crane")
    found = flexopt.map_workspace(crane, posture=(0.6, 0.5, -1.0, 0.8), epsilon_max=False, points=(40, 40))
    reached = found.dataset.reachable.values
    beside = sum(np.roll(reached, shift, axis).astype(int) for axis in (0, 1) for shift in (1, -1))
    assert not np.any((beside >= 3) & ~reached)
    slew = found.array("posture")[0]
    assert np.nanmax(slew) > 3.0 > -2.0 > np.nanmin(slew)
    for row, column in random_cells(found, 6):
        there = flexopt.evaluate(crane, found.array("posture")[:, row, column])
        assert there.end_point[:2] == pytest.approx([found.array("x")[column], found.array("y")[row]], abs=1e-9)


def test_no_cell_is_tried_twice_from_the_same_neighbour(monkeypatch):
    tried, solve = [], follow.Solver.solve

    def noted(self, target, base, start):
        tried.extend(map(bytes, np.vstack([target, base, start]).T.copy()))
        return solve(self, target, base, start)

    monkeypatch.setattr(follow.Solver, "solve", noted)
    crane = flexopt.load("truck-crane")
    found = flexopt.map_workspace(crane, posture=(0.6, 0.5, -1.0, 0.8), epsilon_max=False, points=(12, 12))
    assert not found.dataset.reachable.values.all()
    assert len(set(tried)) == len(tried)
