"""Measures and margins of machines in space: an independent dense eigenproblem, Appendix B, SLICOT, the plane."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg

import flexopt
from flexopt import build_measures, build_plant, evaluate
from flexopt.cli import main
from flexopt.coprime import StateSpace
from flexopt.errors import InputError, ModelError, SingularPosture
from flexopt.model import Tree, machine_from_dict, tree_from_dict
from flexopt.plant import Plant
from flexopt.robustness import evaluate_w
from flexopt.robustness.margin import build_margin
from flexopt.robustness.posture_margin import evaluate_margin
from tests.coprime.oracles import refined_epsilon, slicot_epsilon
from tests.model.robots.files import URDF
from tests.model.test_shipped_machines import POSTURES
from tests.oracles.controls import task_map
from tests.oracles.gradient_cases import Case, compare, relative_gap
from tests.oracles.machines import NumpySource, Structure, draw_machine
from tests.oracles.spatial import grounded, in_space, random_tree

ROWS = {1: ("z",), 2: ("x", "yaw"), 3: ("x", "y", "z"), 6: ("x", "y", "z", "roll", "pitch", "yaw")}
# Passive coordinates and task rows; every number of either, the largest together.
COUNTS = [(1 + k % 12, (1, 2, 3, 6)[(k + k // 12) % 4]) for k in range(24)]
RELATIVE = 1e-9
CONTROLS = ("inverse", "transpose", "damped:0.2")

MACHINE_FILE = """
name = "arm on tracks"
robot = "arm.urdf"
actuated = ["slew", "boom", "extend"]
locked = { finger_a = 0.04 }

[base]
stiffness = { z = 4e6, roll = 2e6, pitch = 3e6 }
damping = { z = 2e4, roll = 1e4, pitch = 1e4 }
point = [0.1, 0.2, -0.4]

[end_point]
link = "tool"
offset = [0.0, 0.0, 0.1]
"""


class Dense:
    """A tree at rest in a posture, and its vibration modes from K φ = ω² M φ over all coordinates."""

    def __init__(self, tree: Tree, posture: np.ndarray, base: np.ndarray) -> None:
        self.tree, self.posture, self.base = tree, posture, base
        self.plant = plant = build_plant(tree)
        self.p, self.m = plant.parameter_values, plant.n_passive
        q = plant.rest(base, posture, self.p)
        self.mass, self.stiffness = plant.mass(q, base, self.p).full(), plant.stiffness(self.p).full()
        self.jacobian = plant.jacobian(q, base, self.p).full()
        values, modes = scipy.linalg.eigh(self.stiffness, self.mass)
        self.omega_squared, self.modes = values[-self.m :], modes[:, -self.m :]

    def factors(self, control: str) -> tuple[np.ndarray, np.ndarray]:
        into = task_map(self.jacobian[:, self.m :], control)
        return self.jacobian @ self.modes, into.T @ self.modes[self.m :]

    @property
    def regular(self) -> bool:
        """Whether accuracy is stated here: cond Jv, the gaps, and a task that sees every mode."""
        rigid = self.jacobian[:, self.m :]
        a, b = self.factors("inverse")
        seen = np.linalg.norm(a, axis=0) * np.linalg.norm(b, axis=0)
        smallest = np.linalg.svd(rigid, compute_uv=False)[-1]
        close = relative_gap(self.omega_squared) > 1e-2
        return bool(smallest > 0.05 * np.linalg.norm(rigid, 2) and smallest > 0.05 and close and seen.min() > 1e-9)


def regular_case(seed: int, counts: tuple[int, int], rows: tuple[str, ...]) -> Dense:
    for k in range(300):
        tree = tree_from_dict(random_tree(1000 * seed + k, rows=rows, counts=counts))
        rng = np.random.default_rng(k)
        case = Dense(tree, rng.uniform(-1, 1, counts[1]), rng.uniform(-1, 1, 3))
        if case.regular:
            return case
    raise AssertionError("no regular tree found")


@pytest.mark.long("11-12-6", "7-8-6")
@pytest.mark.parametrize(("k", "m", "r"), [(k, *counts) for k, counts in enumerate(COUNTS)][:12])
def test_modes_residues_and_w_are_those_of_the_dense_eigenproblem(k, m, r):
    # Every other machine has a joint more than task rows.
    case = regular_case(m + r, (m, r + m % 2), ROWS[r])
    control = CONTROLS[k // 2 % 3]
    values = build_measures(case.tree, control).values(base=case.base, posture=case.posture, p=case.p)
    v = {name: value.full() for name, value in values.items()}
    a, b = case.factors(control)
    assert np.allclose(v["omega_squared"].ravel(), case.omega_squared, rtol=RELATIVE, atol=0)
    for i in range(m):
        scale = np.linalg.norm(a[:, i]) * np.linalg.norm(b[:, i])
        residue = np.outer(a[:, i], b[:, i])
        assert np.abs(np.outer(v["a"][:, i], v["b"][:, i]) - residue).max() <= RELATIVE * scale
        w = np.linalg.eigvalsh(residue + residue.T)[0]
        assert abs(v["w"][i, 0] - w) <= RELATIVE * scale
        if r == 1:
            assert abs(v["w"][i, 0] - 2 * a[0, i] * b[0, i]) <= RELATIVE * scale
        else:
            assert v["w"][i, 0] <= 0


# 45 digits take their time: a second for each small machine, ten for the larger ones.
@pytest.mark.long("3-6-6")
@pytest.mark.parametrize(("m", "n", "r"), [(1, 2, 1), (2, 2, 2), (3, 4, 3), (5, 1, 1), (4, 3, 3), (3, 6, 6), (7, 3, 2)])
def test_w_and_its_gradient_against_appendix_b(m, n, r):
    case = regular_case(50 + m, (m, n), ROWS[r])
    for comparison in compare(Case(case.tree, case.posture, 1e2, 1e-2, 20.0)):
        assert comparison.values.max() <= RELATIVE
        assert comparison.errors.max() <= RELATIVE


@pytest.mark.parametrize("rows", [("x", "z"), ("z",), ("y", "roll", "yaw"), ("x", "y", "z")])
def test_gradients_by_placement_and_parameters_against_differences(rows):
    tree = tree_from_dict(grounded(4, 1) | {"end_point": grounded(4, 1)["end_point"] | {"rows": list(rows)}})
    measures, posture, base = build_measures(tree), np.array([0.3, 0.5, -0.9, 0.2]), np.array([1.0, -2.0, 0.4])
    p = measures.plant.parameter_values.full().ravel()
    w_z, w_p, _ = (x.full() for x in measures.gradients.call([base, posture, p]))
    scale = measures.w.call([base, posture, p])[1].full().ravel()

    def difference(k: int, at: np.ndarray, step: float) -> np.ndarray:
        def w(shift: float) -> np.ndarray:
            moved = at.copy()
            moved[k] += shift
            given = [moved, posture, p] if at is base else [base, posture, moved]
            return measures.w.call(given)[0].full().ravel()

        # Fourth order.
        return (8 * (w(step) - w(-step)) - (w(2 * step) - w(-2 * step))) / (12 * step)

    for k in range(3):
        # Rounding 1e-13 over the step.
        assert np.abs(w_z[:, k] - difference(k, base, 1e-3)).max() <= 1e-9 * scale.max()
    # Where it stands does not matter, and how it is turned only to a task that does not turn with it.
    assert np.abs(w_z[:, :2]).max() == 0
    if rows == ("x", "y", "z"):
        assert np.abs(w_z[:, 2]).max() <= 1e-12 * scale.max()
    else:
        assert np.abs(w_z[:, 2]).max() > 1e-6 * scale.max() or rows == ("z",)
    for k in np.flatnonzero(np.abs(p) > 1e-3):
        expected = difference(k, p, 1e-3 * abs(p[k])) * abs(p[k])
        assert np.abs(w_p[:, k] * abs(p[k]) - expected).max() <= 1e-8 * scale.max()


def scaled_plant(tree: Tree, posture: np.ndarray, base: np.ndarray, kr: float) -> StateSpace:
    margin = build_margin(tree)
    p = margin.plant.parameter_values
    a, b, c = (x.full() for x in margin.scaled_plant.call([base, posture, p, kr, margin.hold(base, posture, p, kr)]))
    return StateSpace(a, b, c, np.zeros((c.shape[0], b.shape[1])))


def slicot_margin(tree: Tree, posture: np.ndarray, base: np.ndarray, kr: float) -> tuple[float, int]:
    plant = scaled_plant(tree, posture, base, kr)
    return slicot_epsilon(plant), plant.A.shape[0]


@pytest.mark.long
def test_margin_of_six_and_four_joints_against_slicot():
    tree, posture, base = tree_from_dict(grounded(4, 0)), np.array([0.3, 0.5, -0.95, 0.2]), np.array([1.0, 2.0, 0.1])
    expected, n_states = slicot_margin(tree, posture, base, 5e5)
    result = evaluate(tree, posture, base=base)
    assert n_states == 18
    assert result.epsilon_max == pytest.approx(expected, rel=1e-10)
    assert result.epsilon_max_residual < 1e-10
    assert result.self_motion_unstabilised
    assert result.gradient.variables == ("x", "y", "yaw", "a0", "a1", "a2", "a3")
    # Derivatives by joints against differences; the margin's rounding of 1e-13 over the step.
    step = 1e-3
    for k in range(4):
        values = [
            evaluate_margin(build_margin(tree), base, posture + shift * np.eye(4)[k], 5e5).epsilon_max
            for shift in (step, -step, 2 * step, -2 * step)
        ]
        slope = (8 * (values[0] - values[1]) - (values[2] - values[3])) / (12 * step)
        assert result.gradient.epsilon_max[3 + k] == pytest.approx(slope, abs=1e-8)
    assert np.abs(result.gradient.epsilon_max[:3]).max() < 1e-10


@pytest.mark.long
@pytest.mark.parametrize(("counts", "rows"), [((12, 3), ROWS[3]), ((12, 2), ROWS[2]), ((9, 6), ROWS[6])])
def test_margin_of_thirty_states_against_slicot(counts, rows):
    case = regular_case(7 * counts[1], counts, rows)
    margin = evaluate_margin(build_margin(case.tree), case.base, case.posture, 1e3)
    expected, n_states = slicot_margin(case.tree, case.posture, case.base, 1e3)
    assert n_states == 2 * (counts[0] + len(rows))
    assert margin.epsilon_max == pytest.approx(expected, rel=1e-10)
    assert margin.residual < 1e-10


def margin_case(k: int) -> tuple[Dense, float]:
    """Random trees with up to 12 passive coordinates and 6 rows, 36 states, and gains over five decades.

    From the 24th on all have six rows and 30 states or more.
    """
    m, r = COUNTS[k] if k < 24 else (9 + k % 4, 6)
    return regular_case(m + r + (k >= 24) * k, (m, r + m % 2), ROWS[r]), 10.0 ** (1 + 5 * (7 * k % 24) / 23)


# 1 to 12 passive coordinates, all rows, the largest together; `python -m benchmarks.margin_accuracy` tries 200 machines.
@pytest.mark.long("11", "10", "20", "14")
@pytest.mark.parametrize("k", [0, 5, 10, 11, 14, 17, 20, 23])
def test_margins_of_random_trees_up_to_36_states(k):
    case, kr = margin_case(k)
    margin = evaluate_margin(build_margin(case.tree), case.base, case.posture, kr)
    plant = scaled_plant(case.tree, case.posture, case.base, kr)
    # Above the residual allowed the general solver serves, which is not corrected, and the warning says so.
    assert margin.epsilon_max == pytest.approx(refined_epsilon(plant), rel=1e-7 if margin.warning else 1e-9)
    assert not margin.warning or kr > 1e5
    # SLICOT itself is off by up to 1e-7 where the gain is high and ε_max small; where it is right it agrees.
    slicot = slicot_epsilon(plant)
    assert margin.warning or margin.epsilon_max == pytest.approx(
        slicot, rel=max(1e-9, 10 * abs(slicot / refined_epsilon(plant) - 1))
    )


@pytest.mark.parametrize(("name", "posture"), sorted((n, q) for n, q in POSTURES.items() if n != "boom-stick-bucket"))
@pytest.mark.parametrize("kr", [1e3, 5e5])
def test_margin_of_shipped_machines_however_placed(name, posture, kr):
    """As many of the largest eigenvalues of X Z nearly meet as there are task rows: only their span is well defined."""
    machine, q = flexopt.load(name), np.array(posture)
    margin = build_margin(machine)
    bases = [np.array([1.0, 2.0, yaw]) for yaw in (0.0, 0.4, 1.3, 2.9)]
    found = [evaluate_margin(margin, base, q, kr) for base in bases]
    assert all(result.residual < 1e-9 for result in found)
    turns_with_it = machine.end_point.rows == ("x", "y", "z")
    for base, result in zip(bases, found, strict=True):
        assert result.epsilon_max == pytest.approx(refined_epsilon(scaled_plant(machine, q, base, kr)), rel=1e-10)
        assert not turns_with_it or result.epsilon_max == pytest.approx(found[0].epsilon_max, rel=1e-11)


@pytest.mark.parametrize("options", [{}, {"control": "transpose"}, {"gravity": True}, {"damped": True}])
@pytest.mark.parametrize("seed", [None, 1, 2])
def test_a_planar_machine_in_space_evaluates_alike(seed, options):
    if seed is None:
        data, posture = {"gravity": 9.81} | flexopt.load("excavator").to_dict(), [0.9929, -2.6306]
    else:
        structure = Structure(3, ("x", "y", "rotation"), (1,))
        data = draw_machine(NumpySource(np.random.default_rng(seed)), structure, spread=100.0, damping_ratio=0.01)
        posture = [1.1, -1.7]
    planar = machine_from_dict(data)
    flat = evaluate(planar, posture, base=0.4, **options)
    space = evaluate(tree_from_dict(in_space(data)), posture, base=0.4, **options)
    scale = flat.scale
    assert np.allclose(space.frequencies_hz, flat.frequencies_hz, rtol=1e-10, atol=0)
    assert np.allclose(space.damping_ratios, flat.damping_ratios, rtol=1e-10, atol=0)
    assert np.abs(space.w - flat.w).max() <= 1e-10 * scale.max()
    assert np.all(np.abs(space.w - flat.w) <= 1e-10 * scale)
    assert np.abs(space.residues - flat.residues).max() <= 1e-10 * scale.max()
    assert np.allclose(space.rigid_residue, flat.rigid_residue, rtol=0, atol=1e-10 * np.abs(flat.rigid_residue).max())
    assert np.abs(space.gradient.w - flat.gradient.w).max() <= 1e-10 * np.abs(flat.gradient.w).max()
    assert np.allclose(space.end_point, flat.end_point, rtol=0, atol=1e-10)
    assert np.allclose(space.static_deflection, flat.static_deflection, rtol=0, atol=1e-12)
    assert space.condition == pytest.approx(flat.condition, rel=1e-10)
    assert space.epsilon_max == pytest.approx(flat.epsilon_max, rel=1e-10)
    # Lyapunov equations with poles this near to the axis multiply rounding by 1/ζ.
    assert np.allclose(space.gradient.epsilon_max, flat.gradient.epsilon_max, rtol=0, atol=1e-8)
    assert (space.in_phase, space.in_phase_strict) == (flat.in_phase, flat.in_phase_strict)
    assert repr(space).replace("planar,", f"{planar.name},") == repr(flat)


@pytest.mark.long
def test_many_points_at_once_are_those_one_by_one():
    case, rng = regular_case(3, (3, 3), ROWS[3]), np.random.default_rng(0)
    measures = build_measures(case.tree)
    bases, postures = rng.uniform(-1, 1, (3, 20)), case.posture[:, None] + rng.uniform(-0.05, 0.05, (3, 20))
    together = evaluate_w(measures, bases, postures, gradient=True)
    for k in range(20):
        w, scale, _ = measures.w.call([bases[:, k], postures[:, k], measures.plant.parameter_values])
        assert np.abs(together.w[:, k] - w.full().ravel()).max() <= 1e-10 * scale.full().max()
    w_z = measures.gradients.call([bases[:, 0], postures[:, 0], measures.plant.parameter_values])[0].full()
    assert np.abs(together.w_posture[:, :, 0] - w_z[:, 3:]).max() <= 1e-8 * np.abs(w_z).max()


def written(folder: Path, text: str = MACHINE_FILE) -> Path:
    (folder / "arm.urdf").write_text(URDF)
    (folder / "tracks.toml").write_text(text)
    return folder / "tracks.toml"


def test_a_machine_file_with_a_robot_loads_and_evaluates(tmp_path, capsys):
    path = written(tmp_path)
    machine = flexopt.load(path)
    assert isinstance(machine, Tree)
    assert (machine.joints, machine.joint_units) == (("slew", "boom", "extend"), ("rad", "rad", "m"))
    result = evaluate(machine, [0.3, 0.5, 0.4], base=[1, 2, 0.1])
    main(["evaluate", str(path), "--posture", "0.3,0.5,0.4", "--base", "1,2,0.1", "--json"])
    document = json.loads(capsys.readouterr().out)
    assert document["w"] == result.w.tolist()
    assert document["base_units"] == ["m", "m", "rad"]
    assert document["joint_units"] == ["rad", "rad", "m"]
    assert document["provenance"]["machine_sha256"] == machine.content_hash
    main(["evaluate", str(path), "--posture", "0.3,0.5,0.4", "--base", "1,2,0.1"])
    shown = capsys.readouterr().out
    assert "base x 1.0000, y 2.0000 m, yaw 0.1000 rad; slew 0.3000, boom 0.5000 rad, extend 0.4000 m;" in shown
    # The origin, where no placement is given.
    at_origin = evaluate(machine, [0.3, 0.5, 0.4])
    assert np.array_equal(at_origin.base, np.zeros(3))
    fixed = tree_from_dict(machine.to_dict() | {"placement": ()})
    assert np.allclose(evaluate(fixed, [0.3, 0.5, 0.4]).w, at_origin.w, rtol=1e-9)
    assert "base fixed;" in repr(evaluate(fixed, [0.3, 0.5, 0.4], base=[]))


def test_a_robot_file_alone_and_a_faulty_machine_file(tmp_path):
    path = written(tmp_path)
    for name in ("arm.urdf", "arm.xml", "arm.URDF"):
        (tmp_path / name).write_text(URDF)
        with pytest.raises(ModelError, match=rf"is a robot file; give a machine file.*robot = '{name}'"):
            flexopt.load(tmp_path / name)
    with pytest.raises(ModelError, match=r"none\.urdf: no such file"):
        flexopt.load("none.urdf")
    path.write_text(MACHINE_FILE.replace('"boom"', '"bom"').replace("4e6", "-4e6"))
    with pytest.raises(ModelError, match=r"tracks\.toml") as caught:
        flexopt.load(path)
    assert "base.stiffness" in str(caught.value)
    assert tomllib.loads(MACHINE_FILE)["actuated"] == ["slew", "boom", "extend"]


@pytest.fixture(scope="module")
def tree():
    return tree_from_dict(grounded(4, 0))


@pytest.mark.parametrize(
    ("arguments", "sentences"),
    [
        ({"base": 0.0}, ["base = 0.0: must be 3 numbers: the machine is placed by x, in m, y, in m, yaw, in rad"]),
        ({"base": [0, "a", 99]}, ["y must be a number, not text", "yaw must lie between -12.5664 and 12.5664 rad"]),
        ({"posture": [0.1]}, ["needs 4 angles in rad, one for each actuated joint (a0, a1, a2, a3), not 1"]),
        ({"posture": [0, 0, 99, 0], "base": [1, 2]}, ["posture (a2) = 99", "base = [1, 2]", "2 faults"]),
        ({"base": [0, 0, float("nan")]}, ["yaw must be finite"]),
    ],
)
def test_bad_placements_and_postures(tree, arguments, sentences):
    with pytest.raises(InputError) as caught:
        evaluate(tree, **({"posture": [0, 0.5, -0.5, 0.2]} | arguments))
    for sentence in sentences:
        assert sentence in str(caught.value)


def test_slides_are_asked_for_in_metres(tmp_path):
    machine = flexopt.load(written(tmp_path))
    with pytest.raises(InputError, match=r"posture \(extend\) = 2: must lie between 0 and 0.8 m"):
        evaluate(machine, [0, 0, 2])
    with pytest.raises(InputError, match=r"needs 3 numbers, .* \(slew in rad, boom in rad, extend in m\), not 2"):
        evaluate(machine, [0, 0])


def test_singular_postures_in_space(tree):
    with pytest.raises(SingularPosture, match=r"do not move all 3 task rows .*bend a[23]"):
        evaluate(tree, [0.2, 0.3, 0.0, 0.0])
    upright = grounded(1, 0)
    upright["bodies"][-1]["joint"]["axis"] = [0.0, -1.0, 0.0]
    upright["end_point"]["rows"] = ["z"]
    with pytest.raises(SingularPosture, match="do not move the task row"):
        evaluate(tree_from_dict(upright), [np.pi / 2])


def test_what_has_a_closed_form_in_the_plane_only_says_so(tree):
    plant: Plant = build_plant(tree)
    for name in ("posture_at", "arm_segments", "reaching"):
        with pytest.raises(InputError, match="is a spatial machine; its postures have no closed form"):
            getattr(plant, name)


@pytest.mark.long(
    "simulate --posture 0.1,0.4,0.2 --duration 0.1", "select --end-point 2.3,2.4,1.8 --base 0,0,0 --starts 4"
)
@pytest.mark.parametrize(
    "command",
    [
        "evaluate --end-point 2.3,2.4,1.8",
        "select --end-point 2.3,2.4,1.8 --base 0,0,0 --starts 4",
        "map --over posture --posture 0.3 --points 3,3",
        "simulate --posture 0.1,0.4,0.2 --duration 0.1",
        "export --out bundle --parts kinematics,controller",
    ],
)
def test_commands_take_a_robot(command, tmp_path, capsys, monkeypatch):
    path = written(tmp_path)
    monkeypatch.chdir(tmp_path)
    name, *options = command.split()
    main([name, str(path), *options, "--json"])
    assert json.loads(capsys.readouterr().out)["provenance"]


@pytest.mark.long
def test_units_of_hinges_and_slides(tmp_path: Path) -> None:
    """An arm that has both: gains in one unit for each kind, measures in none, and a text that says so."""
    slewing, telescope = flexopt.load("slewing-excavator"), flexopt.load("truck-crane")
    plain = repr(flexopt.evaluate(slewing, POSTURES["slewing-excavator"]))
    assert "1/(kg m2); cond Jv" in plain
    assert "at gain kr = 500000 N m\n" in plain
    assert "mixed" not in plain
    text = repr(flexopt.evaluate(telescope, POSTURES["truck-crane"], loop={"kp": 1e4, "kv": 1e3}))
    assert "at gain kr = 500000 N m or N/m\n" in text
    assert "mixed units: 1/(kg m2) of hinges, 1/kg of slides" in text
    assert "Kp 1e+04 N m or N/m, Kv 1000 N m s or N s/m" in text
    lines = text.splitlines()
    head = next(line for line in lines if "κ, N m s or N s/m" in line)
    # Columns end below their heads.
    below = lines[lines.index(head) + 1]
    assert head.index("κ, isotropic") - 2 == head.index("κ, N m s or N s/m") + len("κ, N m s or N s/m")
    assert below[: head.index("κ, isotropic") - 2].rstrip()[-1].isdigit()


def test_what_is_rounding_is_shown_as_zero() -> None:
    """Where a and b are parallel the document has 1e-30 and the table 0."""
    found = flexopt.select(flexopt.load("excavator"), (0.0, 1.6), starts=4).best.evaluation
    assert 0 < abs(found.w[0]) < 1e-13 * found.scale[0]
    rows = [line.split() for line in repr(found).splitlines()[2:5]]
    assert [float(row[4]) for row in rows] == pytest.approx([0.0, *found.w[1:]], rel=1e-5, abs=0)
    assert float(rows[0][5]) == 0


SCARA = """<mujoco><compiler angle="radian"/><worldbody><body name="cart" pos="0 0 0.2">
<inertial pos="0 0 0.1" mass="60" diaginertia="2.5 3 3.5"/><body name="column" pos="0.1 0 0.25">
<joint name="lift" type="slide" axis="0 0 1" range="0 0.6"/><inertial pos="0 0 0" mass="9" diaginertia=".05 .05 .03"/>
<body name="upper" pos="0 0 0.1"><joint name="shoulder" axis="0 0 1"/>
<inertial pos="0.16 0 0" mass="5" diaginertia=".01 .06 .06"/><body name="fore" pos="0.35 0 0">
<joint name="elbow" axis="0 0 1"/><inertial pos="0.14 0 0" mass="3" diaginertia=".01 .03 .03"/>
<site name="tool" pos="0.3 0 -0.15"/></body></body></body></body></worldbody></mujoco>"""


def test_a_mode_that_no_feedback_excites_has_no_phase(tmp_path):
    """A heaving base and hinges that stand upright: its quotient of two roundings is no measure."""
    (tmp_path / "scara.xml").write_text(SCARA, encoding="utf-8")
    (tmp_path / "scara.toml").write_text(
        'name = "scara"\nrobot = "scara.xml"\nactuated = ["lift", "shoulder", "elbow"]\n'
        "[base]\nstiffness = { z = 1.2e5, roll = 2.4e4, pitch = 2.5e4 }\n"
        "damping = { z = 130.0, roll = 25.0, pitch = 27.0 }\n[end_point]\nsite = 'tool'\n"
    )
    found = flexopt.evaluate(flexopt.load(tmp_path / "scara.toml"), [0.3, 0.4, -0.9])
    hidden = found.scale < 1e-12 * found.scale.max()
    assert hidden.any()
    assert not hidden.all()
    rows = repr(found).splitlines()[2:5]
    assert [row.endswith("–") for row in rows] == hidden.tolist()
    assert "the end-point does not move in that mode" in repr(found)
    assert "does not move in that mode" not in repr(flexopt.evaluate(flexopt.load("excavator"), (0.5, -1.2)))
    loop = {"kp": 1e3, "kv": 1e2, "drive": "torque", "dead_time": 0.01}
    why = flexopt.explain(flexopt.load(tmp_path / "scara.toml"), [0.3, 0.4, -0.9], loop=loop)
    assert [move.status == "unexcited" for move in why.moves] == hidden.tolist()
    assert np.isnan(why.angle).tolist() == hidden.tolist()
    assert np.isnan(why.outcome.lag_reserve).tolist() == hidden.tolist()
    assert np.isnan(why.outcome.gradient["lag_reserve"]["posture"]).all(axis=1).tolist() == hidden.tolist()
    assert ["a and b" in each for each in why.sentences] == (~hidden).tolist()
    assert "nan" not in repr(why) + repr(why.outcome)


@pytest.mark.parametrize("control", ["inverse", "transpose"])
@pytest.mark.parametrize("ulp", range(4))
def test_a_row_in_which_a_mode_does_nothing_does_not_make_it_out_of_phase(control, ulp):
    # The sixth mode moves the end-point sideways alone: what its vertical row holds is rounding of either sign.
    posture = np.array([np.pi, 0.5, -1.5, 0.1]) * (1 + ulp * 2.0**-51)
    result = evaluate(flexopt.load("slewing-excavator"), posture, base=(4.18, -6.0, -1.954), control=control)
    assert abs(result.w[5]) < 1e-12 * result.scale[5]
    assert result.in_phase_strict[5]
