"""`holding` where cylinders have forces: rows are the cylinders' own, against the virtual work of the arm's weight."""

from __future__ import annotations

import numpy as np
import pytest

import flexopt
from flexopt.model.constraints import read_constraints
from flexopt.plant import build_plant
from flexopt.selection.constraints import build_constraints
from tests.oracles.cylinders import DIGGER, digger, length_in_plane
from tests.selection.constraints.scenes import listed


def test_holding_is_that_of_the_cylinders() -> None:
    data = digger()
    data["links"][2]["effort"] = 2e3
    data["cylinders"][1]["force"] = [4e4, 0.0]
    plant = build_plant(flexopt.machine_from_dict(data))
    rows = build_constraints(plant, read_constraints({"holding": 0.8}))
    assert listed(rows).labels == (
        "holding of boom by boom cylinder",
        "holding of stick by stick cylinder",
        "holding of bucket",
    )
    assert listed(rows).units == ("N", "N", "N m")
    np.testing.assert_allclose(listed(rows).lower, [-4e4, -3.2e4, -1.6e3], rtol=1e-15)
    np.testing.assert_allclose(listed(rows).upper, [7.2e4, 0.0, 1.6e3], rtol=1e-15)
    assert listed(rows).scales.tolist() == [9e4, 4e4, 2e3]
    posture, p = np.array([-0.3, -1.3, -0.4]), plant.parameter_values
    values = rows.function(0.0, posture, p, rows.constants).full().ravel()
    torque = plant.gravity(plant.rest(0.0, posture, p), 0.0, p).full().ravel()[plant.n_passive :]
    for k, parent in ((0, 0.5), (1, 2.0)):
        ends = [length_in_plane(DIGGER["cylinders"][k], parent, posture[k] + step) for step in (-1e-4, 1e-4)]
        # Central differences: an error of the order of 1e-8.
        assert values[k] == pytest.approx(torque[k] * 2e-4 / (ends[1] - ends[0]), rel=1e-6)
    assert values[2] == pytest.approx(torque[2], rel=1e-14)


def test_cylinders_without_force_hold_nothing() -> None:
    data = digger()
    for cylinder in data["cylinders"]:
        cylinder.pop("force", None)
    plant = build_plant(flexopt.machine_from_dict(data))
    with pytest.raises(flexopt.InputError, match=r"force \(N\) to their cylinders"):
        build_constraints(plant, read_constraints({"holding": 0.8}))
