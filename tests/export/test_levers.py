"""The lever map in C against Python's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import flexopt
from flexopt.export import export_c
from flexopt.model import AnyMachine, tree_from_dict
from flexopt.plant import build_hydraulics
from tests.export.bundle_library import BundleLibrary
from tests.export.programs import GCC
from tests.oracles.cylinders import digger, digger_in_space
from tests.oracles.spatial import in_space

pytestmark = GCC


def plane() -> AnyMachine:
    return flexopt.machine_from_dict(digger())


def space() -> AnyMachine:
    data = digger_in_space(in_space(digger()))
    del data["cylinders"][0]
    boom = next(body for body in data["bodies"] if body["name"] == "boom")
    boom["joint"]["speed"] = 0.3
    return tree_from_dict(data)


@pytest.mark.parametrize("make", [plane, space])
@pytest.mark.parametrize("baked", [False, True])
def test_c_agrees_with_python(make, baked: bool, tmp_path: Path) -> None:
    machine = make()
    library = BundleLibrary(export_c(machine, tmp_path / "b", parts=["levers"], prefix="m", baked=baked), tmp_path)
    found, rng = build_hydraulics(machine), np.random.default_rng(2)
    p = found.plant.parameter_values
    low, high = np.array(machine.limits).T
    for _ in range(20):
        posture, rates = rng.uniform(low, high), rng.uniform(-1, 1, 3)
        status, out = library("levers", joint_angles=posture, joint_rates=rates)
        assert status == "OK"
        expected = found.lever(posture, rates, p).full().ravel()
        np.testing.assert_allclose(out["lever"], expected, rtol=2e-15, atol=2e-15)
        expected = found.lever_map("uniform")(posture, rates, p).full().ravel()
        np.testing.assert_allclose(out["saturated_lever"], expected, rtol=2e-15, atol=2e-15)
        status, back = library("lever_rates", joint_angles=posture, lever=out["saturated_lever"])
        assert status == "OK"
        expected = found.rates(posture, out["saturated_lever"], p).full().ravel()
        np.testing.assert_allclose(back["joint_rates"], expected, rtol=2e-15, atol=2e-15)
        np.testing.assert_allclose(back["joint_rates"] / np.max(np.abs(back["joint_rates"])), rates / np.max(np.abs(rates)),
                                   rtol=0, atol=1e-14)  # fmt: skip


def test_pins_are_parameters_and_a_linkage_that_does_not_close_is_refused(tmp_path: Path) -> None:
    machine = plane()
    library = BundleLibrary(export_c(machine, tmp_path / "b", parts=["levers"], prefix="m"), tmp_path)
    names, loaded = [parameter.name for parameter in machine.parameters], list(library.defaults)
    inputs = {"joint_angles": [0.0, -1.0, 0.0], "joint_rates": [0.1, 0.1, 0.1]}
    before = library("levers", **inputs)[1]["lever"]
    data = digger()
    data["cylinders"][0]["rod_point"][0] = 1.0
    loaded[names.index("boom cylinder.rod_point.x")] = 1.0
    status, out = library("levers", parameters=loaded, **inputs)
    changed = build_hydraulics(flexopt.machine_from_dict(data))
    expected = changed.lever(*inputs.values(), changed.plant.parameter_values).full().ravel()
    assert status == "OK"
    np.testing.assert_allclose(out["lever"], expected, rtol=2e-15)
    assert abs(out["lever"][0] / before[0] - 1) > 1e-2
    loaded[names.index("bucket cylinder.rocker.coupler")] = 3.0
    status, out = library("levers", parameters=loaded, **inputs)
    assert status == "SINGULAR_POSTURE"
    assert np.all(out["lever"] == -7.0)


@pytest.mark.long
def test_machines_without_speeds_have_no_levers(tmp_path: Path) -> None:
    machine = flexopt.load("excavator")
    with pytest.raises(flexopt.InputError, match="the levers of boom, stick need a cylinder or a speed"):
        export_c(machine, tmp_path / "b", parts=["levers"])
    assert "levers" in export_c(machine, tmp_path / "c", parts=None).left_out
