"""Whether a machine stands and is held with other numbers, beside equilibria that SciPy finds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import root

import flexopt
from flexopt.foundation.arrays import Vector
from flexopt.selection.broken import broken_on, falls_within
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


def test_a_way_on_which_the_machine_falls_over_at_one_share_alone_is_told_of() -> None:
    """An excavator on a soft base under 7 t that raises its arm for a moment: by SciPy's roots it lies fallen then."""
    data = flexopt.load("excavator").to_dict()
    data["base"]["stiffness"]["rotation"], data["payload"] = 2e5, {"mass": 0.0}
    machine = flexopt.machine_from_dict(data)
    within = [{"of": "payload.mass", "value": [0.0, 7000.0]}]
    given: dict[str, Any] = {"gravity": True, "base": 0.0, "starts": 1, "assume": "nothing"}
    kept = {"tool_angle": [-3.14, 3.14], "within": within}
    problem = flexopt.build_selection(machine, (1.0, 1.6), constraints=kept, **given)
    plant, shares = problem.measures.plant, np.linspace(0.0, 1.0, 65)[1:-1]
    low, raised = np.array([0.0, 0.99, -2.63]), np.array([0.0, -0.3, -0.5])

    def way(share: Vector) -> tuple[Vector, NDArray[np.bool_]]:
        # Up between two of the shares before and after.
        up = np.exp(-(((share - 0.5) / 1e-3) ** 2))
        return low[:, None] + (raised - low)[:, None] * up, np.ones(share.size, dtype=bool)

    p = plant.parameter_values.full().ravel()
    p[plant.parameter_names.index("payload.mass")] = 7000.0

    def stable(posture: Vector) -> list[float]:
        """Tilts at which the springs hold the machine under the load."""
        stiffness: Vector = plant.stiffness.call([p])[0].full()[:3, :3]
        rest: Vector = plant.rest.call([0.0, posture, p])[0].full().ravel()[:3]

        def left(x: Vector) -> Any:
            weight = plant.gravity.call([np.append(x, posture), 0.0, p])[0].full().ravel()[:3]
            return (weight + stiffness @ (x - rest)) / stiffness.diagonal()

        found = [root(left, rest + np.array([0.0, 0.0, tilt]), tol=1e-12) for tilt in np.linspace(-1.5, 1.5, 31)]
        stands: list[Vector] = [each.x for each in found if np.abs(left(each.x)).max() < 1e-9]
        turning = (plant.gravity_stiffness.call([np.append(x, posture), 0.0, p])[0].full() for x in stands)
        held = [np.linalg.eigvalsh(stiffness + each)[0] > 0 for each in turning]
        return [x[2] - rest[2] for x, holds in zip(stands, held, strict=True) if holds]

    assert np.abs(stable(low[1:])).max() < 0.1
    assert np.abs(stable(raised[1:])).min() > 1.0
    falls = [bool(falls_within(problem, z)) for z in way(shares)[0].T]
    assert falls == [k == shares.size // 2 for k in range(shares.size)]
    assert "where payload.mass is 7000 kg" in broken_on(problem, way, shares)
