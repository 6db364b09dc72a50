"""Whether a machine stands and is held with other numbers, beside equilibria that SciPy finds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize, root

import flexopt
from flexopt.foundation.arrays import Vector
from flexopt.model import AnyMachine
from flexopt.plant import Plant
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
        bent = 0.2 * np.abs(turned - posture).max() ** 2
        np.testing.assert_allclose(turned, posture + toward @ found.x[m:], rtol=0, atol=bent)


def test_a_machine_out_of_reach_of_its_target_falls_not_over() -> None:
    """A stretched arm on springs so stiff that it sags less; by SciPy it stands, and comes 1 cm short of the target."""
    machine, springs = flexopt.load("excavator"), (1.112e6, 5.6e6)
    now = np.array([-0.9, -0.07])
    target = flexopt.evaluate(machine, now, base=0.0, gravity=True).end_point
    asked: Any = {"base": 0.0, "posture": now, "gravity": True, "singularity_margin_deg": 3.0, "starts": 2}
    selection = flexopt.select(machine, target, base_range=(-0.5, 0.5), **asked)
    plant = selection.problem.measures.plant
    p = plant.parameter_values.full().ravel()
    p[plant.parameter_names.index("base.stiffness.rotation")] = springs[1]

    def hangs(q: NDArray[np.float64]) -> NDArray[np.float64]:
        found = plant.deflected.call([0.0, q, p])[0].full().ravel()
        stiffness = plant.stiffness(p).full()[:3, :3]
        rest = plant.rest.call([0.0, q, p])[0].full().ravel()[:3]
        at = np.append(found, q)
        np.testing.assert_allclose(
            stiffness @ (found - rest), -plant.gravity.call([at, 0.0, p])[0].full().ravel()[:3], rtol=1e-9, atol=1e-4
        )
        assert np.linalg.eigvalsh(stiffness + plant.gravity_stiffness(at, 0.0, p).full()).min() > 0
        return plant.end_point.call([at, 0.0, p])[0].full().ravel()

    nearest = min(
        minimize(lambda q: np.hypot(*(hangs(q) - target)), now + np.array([0.0, bend]), method="Nelder-Mead").fun
        for bend in (-0.1, 0.1)
    )
    assert nearest > 5e-3
    assert not_standing(selection.problem.quantities, np.append(0.0, now), p).keys() == {"hold of the target"}
    # By the way out that a verdict tells a place is chosen that is held with either spring.
    within = {"base.stiffness.rotation": springs}
    kept = flexopt.select(machine, target, base_range=(-0.5, 0.5), constraints={"within": within}, **asked)
    assert kept.present_told.startswith("breaks hold of the target where base.stiffness.rotation is 5.6e+06")
    assert not_standing(kept.problem.quantities, kept.best.z, p) == {}


def continued(plant: Plant, posture: Vector, nominal: Vector, p: Vector) -> Vector | None:
    """By SciPy how a machine without redundancy stands on its target as its numbers go to p, (n_q,), or None.

    In steps, from where it hangs with the nominal ones; None where there is no root near the last, or it falls over.
    """
    m, steps, base = plant.n_passive, 40, np.zeros(plant.n_base)
    q = np.append(plant.deflected.call([base, posture, nominal])[0].full(), posture)
    target = plant.end_point.call([q, base, nominal])[0].full().ravel()
    stiffness: Vector = plant.stiffness.call([p])[0].full()[:m, :m]
    for share in np.linspace(0.0, 1.0, steps + 1)[1:].tolist():
        now = nominal + share * (p - nominal)

        def left(q: Vector, now: Vector = now) -> Any:
            rest = plant.rest.call([base, q[m:], now])[0].full().ravel()[:m]
            weight = plant.gravity.call([q, base, now])[0].full().ravel()[:m]
            off = plant.end_point.call([q, base, now])[0].full().ravel() - target
            return np.append((weight + stiffness @ (q[:m] - rest)) / stiffness.diagonal(), off)

        found: Vector = root(left, q, tol=1e-12).x
        falling = plant.gravity_stiffness.call([found, base, now])[0].full()
        # The largest step that is no jump to another equilibrium.
        if np.abs(left(found)).max() > 1e-9 or np.abs(found - q).max() > 0.3:
            return None
        if np.linalg.eigvalsh(stiffness + falling)[0] <= 0:
            return None
        q = found
    return q


def excavator_on(rotation: float) -> AnyMachine:
    data = flexopt.load("excavator").to_dict()
    data["base"]["stiffness"]["rotation"], data["payload"] = rotation, {"mass": 0.0}
    return flexopt.machine_from_dict(data)


@pytest.mark.parametrize(("rotation", "load"), [(8e4, 500.0), (1.6e5, 2000.0), (3e5, 4000.0)])
def test_whatever_scipy_holds_on_its_target_step_by_step_counts_as_held(rotation: float, load: float) -> None:
    """A raised arm, so that the base gives by up to 0.8 rad."""
    machine = excavator_on(rotation)
    plant = flexopt.build_plant(machine)
    quantities = flexopt.build_selection(machine, (1.0, 1.6), gravity=True, base=0.0, starts=1).quantities
    nominal = plant.parameter_values.full().ravel()
    p = nominal.copy()
    p[plant.parameter_names.index("payload.mass")] = load
    tilts = list[float]()
    for x in (-1.85, 0.75, 1.4, 2.05):
        for posture in flexopt.inverse_kinematics(machine, (x, 2.6), base=0.0):
            if (stands := continued(plant, posture, nominal, p)) is None:
                continue
            base = np.zeros(plant.n_base)
            tilts.append(abs(float((stands - plant.rest.call([base, posture, p])[0].full().ravel())[2])))
            assert not_standing(quantities, np.append(0.0, posture), p) == {}
            sagged = np.append(plant.deflected.call([base, posture, nominal])[0].full(), posture)
            target = plant.end_point.call([sagged, base, nominal])[0]
            turned, passive = plant.held.call([base, posture, p, target])
            # To how far Newton's method may be off (`HELD_OFF`), over the arm's length of some 3 m.
            np.testing.assert_allclose(np.append(passive.full(), turned.full()), stands, rtol=0, atol=1e-5)
    assert len(tilts) > 5
    assert max(tilts) > 0.3


def test_a_way_on_which_the_machine_falls_over_at_one_share_alone_is_told_of() -> None:
    """An excavator on a soft base under 12 t that raises its arm for a moment: SciPy finds no equilibrium then."""
    machine = excavator_on(2e5)
    within = [{"of": "payload.mass", "value": [0.0, 12000.0]}]
    given: dict[str, Any] = {"gravity": True, "base": 0.0, "starts": 1, "assume": "nothing"}
    kept = {"tool_angle": [-3.14, 3.14], "within": within}
    problem = flexopt.build_selection(machine, (1.0, 1.6), constraints=kept, **given)
    plant, shares = problem.measures.plant, np.linspace(0.0, 1.0, 65)[1:-1]
    low, raised = np.array([0.0, -1.5, -1.5]), np.array([0.0, -0.3, -0.5])

    def way(share: Vector) -> tuple[Vector, NDArray[np.bool_]]:
        # Up between two of the shares before and after.
        up = np.exp(-(((share - 0.5) / 1e-3) ** 2))
        return low[:, None] + (raised - low)[:, None] * up, np.ones(share.size, dtype=bool)

    nominal = plant.parameter_values.full().ravel()
    p = nominal.copy()
    p[plant.parameter_names.index("payload.mass")] = 12000.0
    assert continued(plant, low[1:], nominal, p) is not None
    assert continued(plant, raised[1:], nominal, p) is None
    falls = [bool(falls_within(problem, z)) for z in way(shares)[0].T]
    assert falls == [k == shares.size // 2 for k in range(shares.size)]
    assert "where payload.mass is 1.2e+04 kg" in broken_on(problem, way, shares)


@pytest.mark.parametrize("load", [0.0, 100.0, 500.0])
def test_near_a_singular_posture_a_machine_on_soft_springs_is_held_as_scipy_holds_it(load: float) -> None:
    machine = excavator_on(7e4)
    plant, posture = flexopt.build_plant(machine), np.array([-0.18940939, -2.91976889])
    nominal = plant.parameter_values.full().ravel()
    p = nominal.copy()
    p[plant.parameter_names.index("payload.mass")] = load
    assert continued(plant, posture, nominal, p) is not None
    quantities = flexopt.build_selection(machine, (1.0, 1.6), gravity=True, base=0.0, starts=1).quantities
    assert not_standing(quantities, np.append(0.0, posture), p) == {}


# On springs so soft that steps from where these are at rest end elsewhere.
@pytest.mark.parametrize(("first", "second"), [(-2.0379, 0.0206), (-1.6376, 2.3655)])
def test_with_its_own_numbers_a_machine_is_held_where_scipy_has_it_hang(first: float, second: float) -> None:
    machine = excavator_on(4e4)
    plant, base, posture = flexopt.build_plant(machine), np.zeros(1), np.array([first, second])
    own = plant.parameter_values.full().ravel()
    m, stiffness = plant.n_passive, plant.stiffness.call([own])[0].full()
    stiffness = stiffness[: plant.n_passive, : plant.n_passive]
    rest = plant.rest.call([base, posture, own])[0].full().ravel()[:m]

    def left(x: Vector) -> Any:
        weight = plant.gravity.call([np.append(x, posture), base, own])[0].full().ravel()[:m]
        return (weight + stiffness @ (x - rest)) / stiffness.diagonal()

    found: Any = root(left, rest, tol=1e-12)
    assert found.success
    hangs = np.append(found.x, posture)
    assert np.linalg.eigvalsh(stiffness + plant.gravity_stiffness.call([hangs, base, own])[0].full())[0] > 0
    sags = plant.deflected.call([base, posture, own])[0].full().ravel()
    # Both to some 1e-12 of angles of order 1.
    np.testing.assert_allclose(sags, found.x, rtol=0, atol=1e-9)
    quantities = flexopt.build_selection(machine, (1.0, 1.6), gravity=True, base=0.0, starts=1).quantities
    assert not_standing(quantities, np.append(base, posture), own) == {}
