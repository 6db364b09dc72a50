"""Selection for machines in space: never below an independent sample, inside every constraint, the same on any number of processes."""

import numpy as np
import pinocchio as pin
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

import flexopt
from flexopt.model.tree import tree_from_dict
from flexopt.plant import build_plant
from flexopt.plant.inverse_kinematics import REACHED, solve_postures
from flexopt.robustness.measures import build_measures
from flexopt.selection.broken import resting
from flexopt.selection.proof.check import prove
from tests.oracles.spatial import grounded, pinocchio_tree, random_tree

LIMITS = [[-3.1, 3.1], [-0.9, 1.0], [-2.6, -0.4], [-2.4, 0.6]]
EFFORTS = [4e5, 6e5, 4e5, 1e5]
TARGET = (3.5, 1.0, 1.2)
SUPPORT = [[1.9, 1.2], [-1.8, 1.2], [-1.8, -1.2], [1.9, -1.2]]
YARD, TRENCH = [[-6, -6], [6, -6], [6, 6], [-6, 6]], [[1, 1], [2, 1], [2, 2], [1, 2]]
TANK = {"name": "tank", "kind": "sphere", "center": [3.0, 2.6, 1.0], "radius": 0.5}
CONSTRAINTS = {
    "joint_margin": 0.05,
    "manipulability": 0.5,
    "region": [YARD],
    "keep_out": [TRENCH],
    "holds": "footprint",
    "self_clearance": 0.05,
    "tip_over_margin": 0.2,
    "holding": 0.8,
    "tool_angle": [-1.2, 1.2],
    "clearance": {"distance": 0.2, "ground": 0.0, "obstacles": [TANK]},
    "travel": {"cost": 1e-4},
}
PRESENT = {"base": (0.0, 0.0, 0.0), "posture": (0.3, 0.4, -1.2, -0.5)}
WEIGHTS = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)


def slewing() -> dict:
    data = grounded(4, 0, coupled=False)
    for body, limits, effort in zip(data["bodies"][6:], LIMITS, EFFORTS, strict=True):
        body["joint"] |= {"limits": limits, "effort": effort}
    data["support"] = {"polygon": SUPPORT}
    data["capsules"] = [
        {"body": f"arm{k}", "start": [0, 0, 0], "end": [end, 0, 0], "radius": 0.15}
        for k, end in ((1, 1.9), (2, 1.9), (3, 1.5))
    ]
    return data


@pytest.fixture(scope="module")
def machine():
    return tree_from_dict(slewing())


@pytest.fixture(scope="module")
def constrained(machine):
    return flexopt.select(machine, TARGET, objective="V", weights=WEIGHTS, constraints=CONSTRAINTS, starts=6, **PRESENT)


def projected(machine, target, low, high, count, seed):
    """Random configurations moved onto the target by SciPy, with Pinocchio's kinematics: none of our own code."""
    oracle, rng = pinocchio_tree(machine), np.random.default_rng(seed)
    n_p = sum(bool(b["joint"].get("passive")) for b in machine["bodies"])
    rest = np.array([b["joint"].get("rest", 0.0) for b in machine["bodies"] if b["joint"].get("passive")])
    found = []
    while len(found) < count:
        start = rng.uniform(low, high)

        def off(z):
            return oracle.task(np.concatenate([rest[:n_p], z[3:]]), z[:3])[0] - target

        solved = least_squares(off, start, bounds=(low, high), xtol=1e-14, ftol=1e-14, gtol=1e-14)
        if np.abs(solved.fun).max() < 1e-8:
            found.append(solved.x)
    return np.array(found).T


def along_the_target(machine, z, target, low, high, count, seed):
    """Many more of them: steps along the redundancy, moved back by Newton's method on a numerical Jacobian."""
    plant, rng = build_plant(machine), np.random.default_rng(seed)
    p = plant.parameter_values
    out = np.repeat(z, -(-count // z.shape[1]), axis=1)[:, :count]
    out = np.clip(out + rng.normal(scale=0.4, size=out.shape), low[:, None], high[:, None])

    def task(x):
        q = plant.rest.call([x[:3], x[3:], p])[0]
        return plant.end_point.call([q, x[:3], p])[0].full()

    left, steps = np.arange(count), 1e-6 * np.eye(len(low))
    for _ in range(30):
        here = task(out[:, left])
        off = here - np.array(target)[:, None]
        still = np.abs(off).max(axis=0) > 1e-13
        left, here, off = left[still], here[:, still], off[:, still]
        x = out[:, left]
        slopes = np.stack([(task(x + step[:, None]) - here) / 1e-6 for step in steps], axis=2)
        back = np.linalg.pinv(slopes.transpose(1, 0, 2)) @ off.T[:, :, None]
        out[:, left] = np.clip(x - back[:, :, 0].T, low[:, None], high[:, None])
    return out[:, np.abs(task(out) - np.array(target)[:, None]).max(axis=0) < 1e-8]


BOX = (
    np.array([-2.0, -4.0, -3.1, *(limit[0] for limit in LIMITS)]),
    np.array([8.0, 6.0, 3.1, *(limit[1] for limit in LIMITS)]),
)


@pytest.fixture(scope="module")
def dense(machine):
    z = projected(slewing(), np.array(TARGET), *BOX, 24, seed=1)
    return along_the_target(machine, z, TARGET, *BOX, 6_000, seed=2)


@pytest.mark.long
@pytest.mark.parametrize("objective", ["w1", "V"])
def test_never_below_thousands_of_feasible_points(machine, dense, objective):
    weights = WEIGHTS if objective == "V" else None
    ranges = {name: (BOX[0][k], BOX[1][k]) for k, name in enumerate(("x", "y", "yaw"))}
    selection = flexopt.select(machine, TARGET, objective=objective, weights=weights, base_range=ranges, starts=8)
    z = dense
    assert z.shape[1] >= 4_500
    measures = build_measures(machine)
    p = measures.plant.parameter_values
    w = measures.w.call([z[:3], z[3:], p])[0].full()
    regular = (
        measures.plant.singularity_sine_squared.call([z[:3], z[3:], p])[0].full()[0] >= np.sin(np.radians(10)) ** 2
    )
    values = (np.array(weights) @ w if weights else w[0])[regular]
    assert selection.best.objective >= values.max() - 1e-9 * selection.problem.objective_scale


@pytest.mark.long
def test_the_result_does_not_depend_on_the_number_of_processes(machine, monkeypatch):
    problem = flexopt.build_selection(machine, TARGET, objective="V", weights=WEIGHTS, starts=3, seed=4)
    alone = flexopt.solve_selection(problem, workers=1)
    monkeypatch.setattr("flexopt.foundation.processes.WORTH_FORKING", 0.0)
    spread = flexopt.solve_selection(problem, workers=3)
    assert repr(alone.to_dict()) == repr(spread.to_dict())
    again = flexopt.select(machine, TARGET, objective="V", weights=WEIGHTS, starts=3, seed=4, workers=1)
    assert repr(again.to_dict()) == repr(alone.to_dict())


@pytest.mark.long
def test_every_kind_of_constraint_is_kept_by_independent_formulas(machine, constrained):
    """Pinocchio's frames and gravity, plain geometry."""
    data = slewing()
    oracle = pinocchio_tree(data)
    masses = np.array([body.get("mass", 0.0) for body in data["bodies"]])
    for candidate in constrained.candidates:
        base, posture = candidate.z[:3], candidate.z[3:]
        q = np.concatenate([np.zeros(6), posture])
        np.testing.assert_allclose(oracle.task(q, base)[0], TARGET, atol=1e-8)
        low, high = np.array(LIMITS).T
        assert np.all(posture >= low + 0.05 - 1e-8)
        assert np.all(posture <= high - 0.05 + 1e-8)
        jacobian = oracle.task(q, base)[1][:, 6:]
        assert np.sqrt(np.linalg.det(jacobian @ jacobian.T)) >= 0.5 - 1e-6
        assert np.all(np.abs(base[:2]) <= 6 + 1e-7)
        assert not np.all((base[:2] > 1 + 1e-6) & (base[:2] < 2 - 1e-6))
        held = oracle.gravity(q)[6:]
        assert np.all(np.abs(held) <= 0.8 * np.array(EFFORTS) * (1 + 1e-6))
        centre = centre_of_mass(oracle, data, q, masses)
        assert min(centre[0] + 1.8, 1.9 - centre[0], centre[1] + 1.2, 1.2 - centre[1]) >= 0.2 - 1e-6
        _, rotation = oracle.frame(q, base)
        assert -1.2 - 1e-6 <= np.arctan2(rotation[2, 0], rotation[2, 2]) <= 1.2 + 1e-6
        for start, end in capsule_axes(oracle, data, q, base):
            points = start + np.linspace(0, 1, 2001)[:, None] * (end - start)
            assert np.linalg.norm(points - TANK["center"], axis=1).min() - 0.15 - 0.5 >= 0.2 - 1e-6
            assert points[:, 2].min() - 0.15 >= 0.2 - 1e-6


def body_frames(oracle, data, q):
    pin.forwardKinematics(oracle.model, oracle.data, oracle._own(q))
    return [oracle.data.oMi[oracle.model.getJointId(body["joint"]["name"])] for body in data["bodies"]]


def centre_of_mass(oracle, data, q, masses):
    points = [
        f.act(np.array(b.get("com", [0.0] * 3)))
        for f, b in zip(body_frames(oracle, data, q), data["bodies"], strict=True)
    ]
    return masses @ np.array(points) / masses.sum()


def capsule_axes(oracle, data, q, base):
    c, s = np.cos(base[2]), np.sin(base[2])
    turn, shift = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array([base[0], base[1], 0.0])
    frames = dict(zip((body["name"] for body in data["bodies"]), body_frames(oracle, data, q), strict=True))
    for capsule in data["capsules"]:
        frame = frames[capsule["body"]]
        yield tuple(turn @ frame.act(np.array(capsule[end], dtype=float)) + shift for end in ("start", "end"))


def test_results_name_the_constraints(constrained):
    document = constrained.to_dict()
    best = document["best"]
    assert best["base_coordinates"] == ["x", "y", "yaw"]
    assert len(best["base"]) == 3
    assert len(best["posture"]) == 4
    labels = {row["name"] for row in document["problem"]["constraints"]}
    assert (
        set(best["active"])
        - {f"{v['name']} {end} bound" for v in document["problem"]["variables"] for end in ("lower", "upper")}
        <= labels
    )
    tool = best["constraints"]["tool angle"]
    assert tool["lower"] == -1.2
    assert tool["unit"] == "rad"
    assert -1.2 - 1e-6 <= tool["value"] <= 1.2 + 1e-6
    assert "w6" in repr(constrained)


@pytest.mark.long
def test_travel_keeps_the_machine_where_it_is(machine):
    free = flexopt.select(machine, TARGET, starts=3, **PRESENT)
    dear = flexopt.select(machine, TARGET, starts=3, constraints={"travel": {"cost": 1e3}}, **PRESENT)
    now = np.concatenate([PRESENT["base"], PRESENT["posture"]])

    def away(selection):
        return np.linalg.norm((selection.best.z - now) / selection.problem.scale)

    assert away(dear) < away(free)
    size = dear.problem.objective_scale
    assert dear.best.objective == pytest.approx(dear.best.w[0] - 1e3 * size * away(dear) ** 2, rel=1e-9)


@pytest.mark.long
def test_a_zero_of_the_objective_is_proved_next_to_where_a_vanishes(machine):
    """V = 0 is the largest value there is; differences of gradients near a_i = 0 may not reject it."""
    selection = flexopt.select(machine, TARGET, starts=4)
    problem = selection.problem
    assert problem.bounded_by_zero
    proof = prove(problem, selection.best.z)
    assert proof.unsurpassed
    assert proof.holds


@pytest.mark.long
def test_what_cannot_be_kept_is_named(machine):
    """The support is 2.4 m wide: no point is 1.3 m from both edges."""
    with pytest.raises(flexopt.NoSolutionFound, match="tip-over margin from edge") as caught:
        flexopt.select(machine, TARGET, starts=2, constraints={"tip_over_margin": 1.3}, workers=1)
    assert any(name.startswith("tip-over") for name in caught.value.violations)
    assert " m" in str(caught.value)


@pytest.mark.parametrize(("constraints", "name"), [
    ({"manipulability": 1e6}, "manipulability"),
    ({"keep_out": [[[-30.0, -30.0], [40.0, -30.0], [40.0, 30.0], [-30.0, 30.0]]]}, "distance from keep_out[0]"),
])  # fmt: skip
def test_nor_where_no_climb_comes_near_is_it_unnamed(machine, constraints, name):
    with pytest.raises(flexopt.NoSolutionFound, match=r"the best iterate .* violates") as caught:
        flexopt.select(machine, TARGET, constraints=constraints, objective="w1", starts=2, workers=1)
    assert caught.value.violations[name] > 1


def test_unreachable_targets_say_by_how_much(machine):
    with pytest.raises(flexopt.UnreachableTarget, match="m or more above what the arm reaches") as caught:
        flexopt.select(machine, (0.0, 0.0, 30.0))
    assert caught.value.miss > 20
    with pytest.raises(flexopt.UnreachableTarget) as caught:
        flexopt.select(machine, TARGET, base_range={"x": (50.0, 51.0)})
    # The arm reaches 5.8 m from its first joint at most.
    assert 40 < caught.value.miss < 47
    # Beside areas, too, for one target and several.
    area = [[-4.0, -7.0], [13.0, -7.0], [13.0, 7.0], [-4.0, 7.0]]
    for kind in ("region", "keep_out"):
        asked = {"base_range": {"x": (-2.0, 12.0), "y": (-6.0, 6.0), "yaw": (-1.0, 1.0)}, "constraints": {kind: [area]}}
        with pytest.raises(flexopt.UnreachableTarget, match=r"cannot reach x 60, .* m off"):
            flexopt.select(machine, (60.0, 0.0, 1.0), **asked)
        stands = [(60.0, 0.0, 1.0), (61.0, 0.0, 1.0)]
        with pytest.raises(flexopt.UnreachableTarget, match=r"targets\[1\]: .* cannot reach x 61"):
            flexopt.select_stand(machine, stands, workers=1, **asked)


def test_what_only_the_sagging_machine_reaches_is_chosen():
    """From a corner of its joints' ranges; with springs unloaded it is out of their limits."""
    machine = flexopt.load("slewing-excavator")
    low, high = np.array(machine.limits).T
    corner = np.where(np.isfinite(high), high - 2e-4, 0.3)
    target = flexopt.evaluate(machine, corner, base=(0.0, 0.0, 0.0), gravity=True).end_point
    with pytest.raises(flexopt.UnreachableTarget):
        flexopt.inverse_kinematics(machine, target, base=(0.0, 0.0, 0.0))
    found = flexopt.select(
        machine, target, base=(0.0, 0.0, 0.0), gravity=True, objective="w1", starts=1, workers=1,
        base_range=dict.fromkeys(machine.base_coordinates, (-0.0001, 0.0001)), assume="limits",
        singularity_margin_deg=0.1,
    )  # fmt: skip
    np.testing.assert_allclose(found.best.evaluation.end_point, target, atol=1e-6)
    assert np.all((found.best.evaluation.posture >= low - 1e-9) & (found.best.evaluation.posture <= high + 1e-9))


def test_faults_are_named_all_at_once(machine):
    with pytest.raises(flexopt.InputError) as caught:
        flexopt.select(
            machine, (0.0, float("nan")), base=(0.0,), base_range={"z": (0, 1), "x": (2, 1)}, posture=(9.0, 0, 0, 0),
            constraints={"joint_margin": 2.0, "holding": -1}, workers=0,
        )  # fmt: skip
    text = str(caught.value)
    for part in ("target", "x, y, z", "base", "'z' is no placement coordinate", "reversed", "posture (a0)", "holding"):
        assert part in text
    with pytest.raises(flexopt.InputError, match=r"constraints\.joint_margin = 2: leaves nothing of the joint"):
        flexopt.select(machine, TARGET, constraints={"joint_margin": 2.0})
    with pytest.raises(flexopt.InputError, match=r"constraints.travel.posture: is required"):
        flexopt.select(machine, TARGET, base=(0, 0, 0), constraints={"travel": {"cost": 1.0}})
    with pytest.raises(flexopt.InputError, match="workers = 0"):
        flexopt.select(machine, TARGET, workers=0)


def test_a_fixed_placement(machine):
    ranges = {"x": (0.4, 0.4), "y": (0.0, 0.0), "yaw": (0.2, 0.2)}
    selection = flexopt.select(machine, TARGET, base_range=ranges, starts=3)
    for candidate in selection.candidates:
        np.testing.assert_allclose(candidate.z[:3], [0.4, 0.0, 0.2], atol=1e-12)


def test_a_machine_without_placement():
    tree = tree_from_dict(slewing() | {"placement": []})
    selection = flexopt.select(tree, (3.5, 1.0, 1.2), starts=3)
    assert selection.best.evaluation.base.size == 0
    assert selection.to_dict()["best"]["base"] == []


def test_inverse_kinematics_finds_every_branch_of_a_regular_arm():
    """Slew, boom and stick on a point: forwards and over the back, elbow up and down."""
    tree = tree_from_dict(grounded(3, 0, coupled=False))
    plant = build_plant(tree)
    postures = flexopt.inverse_kinematics(tree, (2.5, 0.8, 0.9), base=(0.1, 0.2, 0.3))
    assert len(postures) == 4
    for posture in postures:
        q = np.concatenate([np.zeros(6), posture])
        np.testing.assert_allclose(
            plant.end_point(q, [0.1, 0.2, 0.3], plant.parameter_values).full().ravel(), (2.5, 0.8, 0.9), atol=1e-9
        )
    with pytest.raises(flexopt.UnreachableTarget, match="m off") as caught:
        flexopt.inverse_kinematics(tree, (20.0, 0.0, 1.4))
    assert caught.value.miss == pytest.approx(20.0 - 0.4 - 1.9 - 1.5, abs=0.02)


@settings(max_examples=15, derandomize=True)
@given(seed=st.integers(0, 10_000))
def test_random_trees_reach_what_pinocchio_says_they_do(seed):
    """A target made from a known posture is reached again, from starts near and far."""
    data = random_tree(seed, rows=("x", "y", "z"))
    tree = tree_from_dict(data)
    plant, rng = build_plant(tree), np.random.default_rng(seed)
    posture, base = rng.uniform(-1, 1, plant.n_actuated), rng.uniform(-1, 1, 3)
    rest = np.array([b["joint"]["rest"] for b in data["bodies"] if b["joint"]["passive"]])
    oracle = pinocchio_tree(data)
    target = oracle.task(np.concatenate([rest, posture]), base)[0]
    starts = np.column_stack([posture, posture + 0.05, *rng.uniform(-2, 2, (20, plant.n_actuated))])
    found, left = solve_postures(plant, target, base, starts)
    assert left[0] <= REACHED
    for k in np.flatnonzero(left <= REACHED):
        again = oracle.task(np.concatenate([rest, found[:, k]]), base)[0]
        np.testing.assert_allclose(again, target, atol=1e-8)


@pytest.mark.long
def test_a_curve_whose_best_third_is_one_point_is_started_from_all_along() -> None:
    """A crane that stands still: much of the sample lies on the telescope's limit, and there w_1 is best."""
    crane, still = flexopt.load("truck-crane"), {"x": [0.0, 0.0], "y": [0.0, 0.0], "yaw": [0.0, 0.0]}
    found = flexopt.select(crane, (6.0, 3.0, 2.0), base=[0.0, 0.0, 0.0], base_range=still, starts=32, workers=1)
    assert len(found.attempts) == 32
    assert found.best.evaluation.w[0] == pytest.approx(-1.7428e-6, rel=1e-4)
    # The other end of the curve, on the limit of the knuckle.
    assert found.candidates[1].evaluation.w[0] == pytest.approx(-2.5276e-6, rel=1e-4)
    assert "none was given" in repr(found)
    held = list(found.initial.posture) if found.initial is not None else []
    given = flexopt.select(
        crane, (6.0, 3.0, 2.0), base=[0.0, 0.0, 0.0], posture=held, base_range=still, starts=1, workers=1
    )
    assert "none was given" not in repr(given)


def test_both_sides_of_a_straight_arm_are_started_from_first() -> None:
    """A crane's knuckle bends up or down, and never quite straightens: each side has a best posture of its own."""
    crane, still = flexopt.load("truck-crane"), {"x": [0.0, 0.0], "y": [0.0, 0.0], "yaw": [0.0, 0.0]}
    asked = {"base": [0.0, 0.0, 0.0], "base_range": still}
    found = flexopt.select(crane, (5.0, 2.0, 2.5), starts=4, workers=1, **asked)
    scan = flexopt.build_selection(crane, (5.0, 2.0, 2.5), starts=64, **asked).scan
    sides = [float(scan.objective[side].max()) for side in (scan.posture[2] < 0, scan.posture[2] > 0)]
    for candidate, seen in zip(found.candidates, sides, strict=True):
        assert candidate.objective >= seen
        assert candidate.objective == pytest.approx(seen, rel=1e-3)


def test_a_target_straight_ahead_is_chosen_for() -> None:
    """There the slew is 0 to rounding, on either side; beside it nothing is."""
    excavator, still = flexopt.load("slewing-excavator"), {"x": [0.0, 0.0], "y": [0.0, 0.0], "yaw": [0.0, 0.0]}
    ahead, beside = (
        flexopt.select(excavator, (7.0, y, 2.5), base_range=still, starts=4, workers=1).best for y in (0.0, 1e-4)
    )
    assert abs(ahead.z[3]) < 1e-12
    assert ahead.objective == pytest.approx(beside.objective, rel=1e-3)


@pytest.mark.long
def test_every_hill_of_curves_in_space_is_started_from_first() -> None:
    """Eleven hills, some of which end where the arm would come too near to a singular posture."""
    tree = tree_from_dict(random_tree(10, counts=(2, 4)))
    plant, posture = build_plant(tree), np.random.default_rng(10).uniform(-0.8, 0.8, 4)
    rest = [body.joint.rest for body in tree.passive_bodies]
    target = plant.end_point([*rest, *posture], [0.0, 0.0, 0.0], plant.parameter_values).full().ravel()
    still = {"x": [0.0, 0.0], "y": [0.0, 0.0], "yaw": [0.0, 0.0]}
    few, many = (
        flexopt.select(tree, target, base=[0.0, 0.0, 0.0], base_range=still, starts=count, workers=1)
        for count in (8, 32)
    )
    assert len(many.candidates) == 11
    values = [candidate.objective for candidate in many.candidates]
    assert [candidate.objective for candidate in few.candidates] == pytest.approx(values[:8], rel=1e-6)


@pytest.mark.long
def test_a_place_flush_with_an_area_is_an_optimum() -> None:
    """One that is allowed by Shapely's word and good by `evaluate`'s, where the outriggers lie along an area's edge."""
    region = [
        [6.354, 1.6835],
        [2.3788, 4.2261],
        [-1.4237, 5.5243],
        [-3.2498, 5.2054],
        [-5.5708, -0.2947],
        [1.5688, -4.9056],
    ]
    area = [[3.1517, 4.0362], [0.0216, 4.9366], [0.2758, 4.4153], [1.4957, 0.6736]]
    crane, target = flexopt.load("truck-crane"), [1.503877, 2.962513, -1.177455]
    base, posture = [0.39609, -0.964563, -0.272861], [1.568712, 0.639387, -1.83455, 3.2]
    known = flexopt.evaluate(crane, posture, base=base)
    assert np.allclose(known.end_point, target, atol=1e-4)
    c, s = np.cos(base[2]), np.sin(base[2])
    corners = np.array(crane.support_points) @ np.array([[c, s], [-s, c]]) + base[:2]
    footprint = shapely.Polygon(corners)
    assert shapely.Polygon(region).buffer(1e-4).contains(footprint)
    assert footprint.buffer(-1e-4).disjoint(shapely.Polygon(area))
    ranges = {"x": [-4, 4], "y": [-4, 4], "yaw": [-1.5, 1.5]}
    constraints = {"region": [region], "keep_out": [area], "holds": "footprint"}
    options = {"objective": "V", "weights": [1.0] * 6, "base_range": ranges, "starts": 8}
    found = flexopt.select(crane, target, constraints=constraints, **options)
    assert found.best.objective >= float(known.w.sum()) * 1.001
    assert "distance from keep_out[0]" in found.best.active


def test_corners_that_touch_a_forbidden_area_together_are_told_once():
    machine = flexopt.load("slewing-excavator")
    front = max(x for x, _ in machine.support_points)
    area = [[front, -9.0], [20.0, -9.0], [20.0, 9.0], [front, 9.0]]
    posture = [0.0, 0.375, -1.206, -1.0083]
    target = flexopt.evaluate(machine, posture, base=[0.0] * 3).end_point
    problem = flexopt.build_selection(machine, target, base=[0.0] * 3, constraints={"keep_out": [area]})
    assert resting(problem, np.array([0.0, 0.0, 0.0, *posture])).count("distance from keep_out[0]") == 1


def test_an_arm_that_is_always_singular_is_refused_and_nothing_else_is_printed(capfd):
    """Its joints move all rows in no posture; no solver is asked."""
    machine = tree_from_dict(random_tree(104, rows=("x", "y", "z", "roll"), counts=(3, 3)))
    target = [0.9569489132709212, -3.1053215935498977, 2.1675971175054016]
    weights = [0.7098202889184134, 0.543859899923019, 0.9223694568046157]
    with pytest.raises(flexopt.InputError, match="in no posture do the joints move all task rows"):
        flexopt.select(machine, target, objective="V", weights=weights, starts=2, assume="limits", workers=1)
    assert capfd.readouterr().err == ""
