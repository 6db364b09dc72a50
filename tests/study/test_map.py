"""A map says at each point what `evaluate` says there, knows where it ends, and survives its file."""

import json
import subprocess
import sys
import warnings

import numpy as np
import pytest
import xarray as xr

import flexopt
from flexopt.foundation import kept
from flexopt.study.maps import points
from flexopt.study.maps.planes import Plane
from tests.study.machines import limited, three_links

pytestmark = pytest.mark.filterwarnings("ignore::flexopt.errors.CompilerNotFound")
SIZE = (25, 21)


@pytest.fixture(scope="module")
def excavator():
    return flexopt.load("excavator")


@pytest.fixture(scope="module", params=["inverse", "transpose"])
def workspace(request, excavator):
    return flexopt.map_workspace(excavator, control=request.param, points=SIZE)


def mapped(result):
    return np.argwhere(np.isfinite(result.array("condition")))


def check_point(result, machine, row, column, *, gravity=False):
    """Every variable at one point against `evaluate` at its posture."""
    at = {name: result.array(name)[..., row, column] for name in map(str, result.dataset.data_vars)}
    e = flexopt.evaluate(machine, at["posture"], control=result.options["control"], gravity=gravity)
    close = {"rtol": 1e-9, "atol": 0}
    np.testing.assert_allclose(at["frequency_hz"], e.frequencies_hz, **close)
    np.testing.assert_allclose(at["scale"], e.scale, **close)
    np.testing.assert_allclose(at["w"], e.w, rtol=1e-9, atol=1e-12 * e.scale.max())
    np.testing.assert_allclose(at["rigid"], e.rigid, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(at["condition"], e.condition, **close)
    np.testing.assert_allclose(at["epsilon_max"], e.epsilon_max, **close)
    assert tuple(at["in_phase"] == 1) == e.in_phase
    assert tuple(at["in_phase_strict"] == 1) == e.in_phase_strict
    return e


def test_values_are_those_of_evaluate(workspace, excavator):
    places = np.random.default_rng(1).permutation(mapped(workspace))[:25]
    for row, column in places:
        e = check_point(workspace, excavator, row, column)
        origin = e.skeleton[:, 1]
        point = workspace.array("x")[column], workspace.array("y")[row]
        np.testing.assert_allclose(e.end_point - origin, point, atol=1e-12)
        assert e.posture[1] < 0


def test_under_gravity(excavator):
    result = flexopt.map_workspace(excavator, gravity=True, points=(9, 7))
    plain = flexopt.map_workspace(excavator, points=(9, 7))
    for row, column in mapped(result)[::5]:
        check_point(result, excavator, row, column, gravity=True)
    assert np.nanmax(np.abs(result.array("w") - plain.array("w"))) > 1e-7
    # The weight is held where the map says, over end-points; over the posture that is what the map says.
    for row, column in mapped(result)[::5]:
        e = flexopt.evaluate(excavator, result.array("posture")[:, row, column], gravity=True)
        first_joint = flexopt.evaluate(excavator, e.posture).skeleton[:, 1]
        point = result.array("x")[column], result.array("y")[row]
        np.testing.assert_allclose(e.end_point - first_joint, point, atol=1e-9)
    both = [flexopt.map_workspace(excavator, over="posture", gravity=g, points=(9, 7)) for g in (True, False)]
    np.testing.assert_array_equal(*(each.array("posture") for each in both))


def test_nan_beyond_the_reach_only(workspace):
    x, y = np.meshgrid(workspace.array("x"), workspace.array("y"))
    distance = np.hypot(x, y)
    reached = (distance > 1.918 - 1.097) & (distance < 1.918 + 1.097)
    on_edge = np.abs(distance - 3.015) < 1e-9
    np.testing.assert_array_equal((workspace.array("reachable") == 1)[~on_edge], reached[~on_edge])
    # The square touches the edge of the reach in four points, where the arm is straight: reached, but singular.
    for name in ("condition", "epsilon_max", "rigid"):
        np.testing.assert_array_equal(np.isfinite(workspace.array(name))[~on_edge], reached[~on_edge])
        assert not np.isfinite(workspace.array(name)[on_edge]).any()
    for name in ("w", "frequency_hz", "scale", "in_phase", "in_phase_strict"):
        np.testing.assert_array_equal(np.isfinite(workspace.array(name)).all(axis=0)[~on_edge], reached[~on_edge])


def test_joint_limits(excavator):
    result = flexopt.map_workspace(limited(), points=(41, 41), epsilon_max=False)
    free = flexopt.map_workspace(excavator, points=(41, 41), epsilon_max=False)
    boom, stick = free.array("posture")
    with np.errstate(invalid="ignore"):
        turned = boom + 2 * np.pi * np.ceil((-0.5 - boom) / (2 * np.pi))
        allowed = (turned <= 1.5) & (stick >= -2.5) & (stick <= -0.5)
    np.testing.assert_array_equal(result.array("reachable") == 1, allowed)
    assert 0 < allowed.sum() < np.isfinite(boom).sum()
    np.testing.assert_allclose(result.array("w")[:, allowed], free.array("w")[:, allowed], rtol=1e-9, atol=1e-16)


def test_elbow_branches(excavator):
    down = flexopt.map_workspace(excavator, elbow="down", points=(13, 13))
    for row, column in mapped(down)[::12]:
        assert check_point(down, excavator, row, column).posture[1] > 0


def test_elbow_branches_mirror(excavator):
    # Mirrored about the base's axis the arm has the other elbow; kx = ky, so that nothing else changes.
    result = flexopt.map_workspace(excavator, over="posture", points=(14, 12))
    for name in ("w", "frequency_hz", "rigid", "epsilon_max"):
        values = result.array(name)
        np.testing.assert_allclose(values, values[..., ::-1, ::-1], rtol=1e-8, atol=1e-12)
    assert result.axes == ("angle_2", "angle_1")
    assert result.dataset["angle_1"].attrs["long_name"] == "angle of boom"


def test_redundant_arm_over_its_posture():
    machine = three_links()
    result = flexopt.map_workspace(
        machine, over="posture", posture=[0.7], points=(7, 5), x_range=(-1, 1), y_range=(-2, -1)
    )
    np.testing.assert_array_equal(result.array("posture")[2], 0.7)
    for row, column in mapped(result)[::6]:
        check_point(result, machine, row, column)


def test_threads_change_nothing(excavator):
    one, two = (flexopt.map_workspace(excavator, points=(31, 31), threads=threads) for threads in (1, 2))
    assert one.dataset.identical(two.dataset)


def test_without_a_compiler(excavator, monkeypatch):
    fast = flexopt.map_workspace(excavator, points=(11, 11))
    monkeypatch.setenv("FLEXOPT_COMPILE", "0")
    kept.forget_all()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        slow = flexopt.map_workspace(excavator, points=(11, 11))
    kept.forget_all()
    for name in ("w", "epsilon_max", "frequency_hz"):
        np.testing.assert_allclose(slow.array(name), fast.array(name), rtol=1e-9, atol=1e-14)


def test_what_was_not_asked_for_is_left_out(excavator):
    geometry = flexopt.map_workspace(excavator, points=(5, 5), measures=False, epsilon_max=False)
    assert set(geometry.dataset.data_vars) == {"posture", "reachable", "condition"}
    assert "in_phase" not in geometry.to_dict()
    margins = flexopt.map_workspace(excavator, points=(5, 5), measures=False)
    assert "epsilon_max" in margins.dataset
    assert "w" not in margins.dataset
    repr(geometry), repr(margins)


def test_nothing_within_reach(excavator):
    result = flexopt.map_workspace(excavator, x_range=(5, 6), y_range=(5, 6), points=(3, 3))
    assert not np.isfinite(result.array("w")).any()
    document = result.to_dict()
    assert document["mapped"] == 0
    assert document["variables"]["w"]["mean"] == [None, None, None]
    json.dumps(document, allow_nan=False)
    assert "0.0 %" in repr(result)


def test_progress(excavator, monkeypatch):
    monkeypatch.setattr(points, "CHUNK", 100)
    calls = []
    result = flexopt.map_workspace(excavator, points=SIZE, progress=lambda done, total: calls.append((done, total)))
    count = int(result.array("reachable").sum())
    assert calls == [*((done, count) for done in range(0, count, 100)), (count, count)]
    whole = flexopt.map_workspace(excavator, points=SIZE)
    np.testing.assert_array_equal(whole.array("posture"), result.array("posture"))
    # A chunk's edge may fall inside a group of lanes: the same to rounding.
    np.testing.assert_allclose(whole.array("epsilon_max"), result.array("epsilon_max"), rtol=1e-12)


def test_netcdf(workspace, tmp_path):
    workspace.to_netcdf(tmp_path / "map.nc")
    back = xr.load_dataset(tmp_path / "map.nc", engine="scipy")
    assert back.equals(workspace.dataset)
    assert set(back.dims) == {"mode", "joint", "y", "x"}
    assert back["reachable"].dtype == bool
    units = {"frequency_hz": "Hz", "posture": "rad", "epsilon_max": "1", "x": "m", "y": "m"}
    units["w"] = {"inverse": "1/(kg m2)", "transpose": "1/kg"}[workspace.options["control"]]
    assert {name: back[name].attrs["units"] for name in units} == units
    for name in back.data_vars:
        assert back[name].attrs["long_name"]
        assert back[name].attrs["description"]
    assert "first joint" in back.attrs["frame"]
    provenance = json.loads(back.attrs["provenance"])
    assert provenance == json.loads(json.dumps(workspace.provenance))
    assert provenance["machine_sha256"] == flexopt.load("excavator").content_hash
    assert provenance["options"]["points"] == list(SIZE)
    with pytest.raises(flexopt.InputError, match=r"must end in \.nc"):
        workspace.to_netcdf(tmp_path / "map.txt")


def test_summary(workspace):
    document = json.loads(json.dumps(workspace.to_dict(), allow_nan=False))
    w = workspace.array("w")
    np.testing.assert_allclose(document["variables"]["w"]["mean"], np.nanmean(w.reshape(3, -1), axis=1))
    np.testing.assert_allclose(document["variables"]["epsilon_max"]["max"], [np.nanmax(workspace.array("epsilon_max"))])
    first = workspace.array("in_phase")[0]
    assert document["in_phase"]["modes"][0] == pytest.approx(np.nanmean(first))
    assert document["in_phase"]["first_two"] <= min(document["in_phase"]["modes"][:2])
    assert all(s <= i for s, i in zip(document["in_phase_strict"]["modes"], document["in_phase"]["modes"], strict=True))
    best = document["best_epsilon_max"]
    e = flexopt.evaluate(flexopt.load("excavator"), best["posture"], control=workspace.options["control"])
    assert e.epsilon_max == pytest.approx(best["value"], rel=1e-9)
    assert document["provenance"]["options"]["control"] == workspace.options["control"]
    for word in ("frame: workspace: axes of the inertial frame", "epsilon_max", "frequency_hz 3", "Hz", "in phase"):
        assert word in repr(workspace)


def test_every_fault_is_named(excavator):
    bad = {
        "control": "both", "gain": -1.0, "gravity": 1, "elbow": "left", "points": (1, 2.5), "threads": 0,
        "x_range": (2.0, 1.0), "y_range": (0.0, float("nan")), "posture": [1.0],
    }  # fmt: skip
    with pytest.raises(flexopt.InputError) as caught:
        flexopt.map_workspace(excavator, **bad)
    assert {fault.field for fault in caught.value.faults} == set(bad)
    sentences = {fault.field: fault.sentence for fault in caught.value.faults}
    assert "between 2 and 10000" in sentences["points"]
    assert "in m" in sentences["x_range"]


@pytest.mark.parametrize(
    ("options", "field", "words"),
    [
        ({}, "over", "two actuated joints, not 3"),
        ({"over": "posture"}, "posture", "needs 1 angle in rad"),
        ({"over": "posture", "posture": [1.0, 2.0]}, "posture", "bucket"),
        ({"over": "posture", "posture": "abc"}, "posture (bucket)", "must be a number"),
        ({"over": "posture", "posture": [99.0]}, "posture (bucket)", "between"),
        ({"over": "posture", "posture": [0.0], "x_range": (-20, 20)}, "x_range", "rad"),
        ({"over": "joints"}, "over", "end_point or posture"),
    ],
)
def test_redundant_arms_need_a_posture(options, field, words):
    with pytest.raises(flexopt.InputError) as caught:
        flexopt.map_workspace(three_links(), points=(3, 3), **options)
    assert words in {fault.field: fault.sentence for fault in caught.value.faults}[field]


def test_no_machine():
    with pytest.raises(flexopt.InputError, match="must be a Machine"):
        flexopt.map_workspace("excavator")  # pyright: ignore[reportArgumentType]


def test_import_stays_light():
    code = "import sys, flexopt; assert not {'xarray', 'pandas', 'matplotlib', 'flexopt.study'} & set(sys.modules), 'slow import'"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_where_the_base_stands_is_said_by_name() -> None:
    """One coordinate or several, each with its unit."""
    plane = Plane("end_point", True, base=np.array([-0.443, 0.0, 0.1]), placed=(("x", "y", "yaw"), ("m", "m", "rad")))
    assert plane.frame == "inertial, with the base at x -0.4430, y 0.0000 m, yaw 0.1000 rad"
    one = Plane("end_point", True, base=np.array([-0.443]), placed=(("x",), ("m",)))
    assert one.frame == "inertial, with the base at x -0.4430 m"
