"""Whether a machine stands and is held with other numbers, beside equilibria that SciPy finds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import root

import flexopt
from flexopt.selection.held import not_standing


@pytest.fixture(scope="module")
def chosen() -> flexopt.Selection:
    machine = flexopt.load("boom-stick-bucket")
    return flexopt.select(machine, (6.0, 1.0), base=0.0, gravity=True, starts=1)


# So soft that the arm turns by up to half a radian, and that nothing holds it.
@pytest.mark.parametrize(
    ("soft", "load", "stands"),
    [(0.5, 4000.0, True), (0.015, 4000.0, True), (0.01, 4000.0, True), (0.008, 1000.0, True), (0.002, 1000.0, False)],
)
def test_what_is_held_on_soft_springs_under_a_heavy_load_does_not_fall(
    chosen: flexopt.Selection, soft: float, load: float, stands: bool
) -> None:
    quantities, z = chosen.problem.quantities, chosen.best.z
    plant = quantities.measures.plant
    nominal = plant.parameter_values.full().ravel()
    p = np.array([
        value * (soft if name.startswith("base.stiffness") else 1.0) if name != "payload.mass" else load
        for name, value in zip(plant.parameter_names, nominal, strict=True)
    ])  # fmt: skip
    base, posture = z[: plant.n_base], z[plant.n_base :]
    stiffness, m = plant.stiffness(p).full()[: plant.n_passive, : plant.n_passive], plant.n_passive
    sagged = np.append(plant.deflected.call([base, posture, nominal])[0].full(), posture)
    target = plant.end_point.call([sagged, base, nominal])[0].full().ravel()
    toward = np.linalg.pinv(plant.rigid_jacobian.call([sagged, base, nominal])[0].full())

    def left(x: np.ndarray) -> Any:
        q = np.append(x[:m], posture + toward @ x[m:])
        weight = plant.gravity.call([q, base, p])[0].full().ravel()[:m]
        rest = plant.rest.call([base, posture, p])[0].full().ravel()[:m]
        off = plant.end_point.call([q, base, p])[0].full().ravel() - target
        return np.append((weight + stiffness @ (x[:m] - rest)) / stiffness.diagonal(), off)

    found: Any = root(left, np.append(sagged[:m], np.zeros(plant.n_task)), tol=1e-12)
    # Where it does not stand one that lies fallen over may be found.
    held = found.success and np.abs(left(found.x)).max() < 1e-8 and np.abs(found.x[m:]).max() < 5.0
    assert held == stands
    assert (not_standing(quantities, z, p) == {}) == stands
    if stands:
        turned = plant.held.call([base, posture, p, target])[0].full().ravel()
        sagged = np.append(plant.deflected.call([base, turned, p])[0].full(), turned)
        np.testing.assert_allclose(plant.end_point.call([sagged, base, p])[0].full().ravel(), target, atol=1e-9)
        # Along Jv⁺ where it begins the way is straight; as the arm turns it bends.
        bent = 0.1 * np.abs(turned - posture).max() ** 2
        np.testing.assert_allclose(turned, posture + toward @ found.x[m:], rtol=0, atol=bent)
