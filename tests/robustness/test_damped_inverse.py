"""Control by the damped Jacobian inverse: dense NumPy, limits in λ, singular postures, every entry, bad numbers."""

from __future__ import annotations

import json

import numpy as np
import pytest
import scipy.linalg

import flexopt
from flexopt import build_plant, evaluate
from flexopt.cli import main
from flexopt.errors import FlexoptError, InputError, SingularPosture
from flexopt.foundation.control import check_control
from flexopt.model import machine_from_dict, tree_from_dict
from flexopt.robustness.margin import build_margin
from flexopt.robustness.posture_margin import evaluate_margin
from tests.oracles.controls import task_map
from tests.oracles.machines import NumpySource, Structure, draw_machine, regular_posture
from tests.oracles.spatial import grounded
from tests.robustness.test_spatial import ROWS, regular_case

POSTURE = [0.9929, -2.6306]
pytestmark = pytest.mark.filterwarnings("ignore:ε_max:flexopt.errors.FlexoptWarning")


def planar(structure, seed):
    rng = np.random.default_rng(seed)
    data = draw_machine(NumpySource(rng), structure, spread=100.0, damping_ratio=0.02)
    machine = machine_from_dict(data)
    return machine, regular_posture(rng, machine, 10.0), np.array([0.3])


def spatial(counts, rows, seed):
    case = regular_case(seed, counts, ROWS[rows])
    return case.tree, case.posture, case.base


CASES = {
    "planar": lambda: planar(Structure(2, ("x", "y", "rotation"), ()), 1),
    "planar, redundant": lambda: planar(Structure(4, ("x", "rotation"), (1,)), 2),
    "spatial": lambda: spatial((3, 3), 3, 3),
    "spatial, redundant": lambda: spatial((4, 5), 3, 4),
    "spatial, six rows": lambda: spatial((2, 6), 6, 5),
}


def dense_w(machine, posture, base, control):
    """w_i and the scale |a_i||b_i| from K φ = ω² M φ over all coordinates."""
    plant = build_plant(machine)
    p, m = plant.parameter_values, plant.n_passive
    q = plant.rest(base, posture, p)
    modes = scipy.linalg.eigh(plant.stiffness(p).full(), plant.mass(q, base, p).full())[1][:, -m:]
    jacobian = plant.jacobian(q, base, p).full()
    a, b = jacobian @ modes, task_map(jacobian[:, m:], control).T @ modes[m:]
    w = [np.linalg.eigvalsh(np.outer(x, y) + np.outer(y, x))[0] for x, y in zip(a.T, b.T, strict=True)]
    return np.array(w), np.linalg.norm(a, axis=0) * np.linalg.norm(b, axis=0)


@pytest.mark.long("spatial, six rows-0.05", "spatial, six rows-0.7")
@pytest.mark.parametrize("damping", ["0.05", "0.7"])
@pytest.mark.parametrize("name", CASES)
def test_w_and_its_gradient_against_numpy(name, damping):
    machine, posture, base = CASES[name]()
    control = f"damped:{damping}"
    result = evaluate(machine, posture, base=base, control=control)
    w, scale = dense_w(machine, posture, base, control)
    assert np.all(np.abs(result.w - w) <= 1e-10 * scale)
    step = 1e-3
    for k in range(posture.size):

        def moved(by, k=k):
            return dense_w(machine, posture + by * step * np.eye(posture.size)[k], base, control)[0]

        slope = (45 * (moved(1) - moved(-1)) - 9 * (moved(2) - moved(-2)) + moved(3) - moved(-3)) / (60 * step)
        size = np.abs(result.gradient.w).max() + scale.max()
        # Sixth order; rounding of 1e-13 over the step, and the truncation of rows that turn fast.
        assert np.abs(result.gradient.w[:, len(base) + k] - slope).max() <= 1e-8 * size


@pytest.mark.long("spatial, six rows")
@pytest.mark.parametrize("name", ["planar", "spatial", "spatial, six rows"])
def test_margin_and_its_gradient_against_the_general_solver(name):
    """A, B, C from NumPy, the arm without self-motion, its joints as states."""
    machine, posture, base = CASES[name]()
    control, gain = "damped:0.4", 100.0
    plant = build_plant(machine)
    p, m, n = plant.parameter_values, plant.n_passive, plant.n_coordinates

    def epsilon(at):
        q = plant.rest(base, at, p)
        mass, jacobian = plant.mass(q, base, p).full(), plant.jacobian(q, base, p).full()
        drive = np.vstack([np.zeros((m, plant.n_task)), task_map(jacobian[:, m:], control)])
        top = -np.linalg.solve(mass, np.hstack([plant.damping(p).full(), plant.stiffness(p).full()]))
        a = np.vstack([top, np.eye(n, 2 * n)])
        b = np.vstack([np.linalg.solve(mass, drive), np.zeros((n, plant.n_task))])
        return float(flexopt.robust_margin(a, gain * b, np.hstack([0 * jacobian, jacobian])))

    result = evaluate_margin(build_margin(machine, control), base, posture, gain)
    assert result.epsilon_max == pytest.approx(epsilon(posture), rel=1e-9)
    step = 2e-3
    for k in range(posture.size):
        values = [epsilon(posture + by * step * np.eye(posture.size)[k]) for by in (1, -1, 2, -2)]
        slope = (8 * (values[0] - values[1]) - (values[2] - values[3])) / (12 * step)
        assert result.z[len(base) + k] == pytest.approx(slope, abs=1e-6 * max(1.0, np.abs(result.z).max()))


@pytest.mark.parametrize("name", ["planar", "spatial, redundant"])
def test_little_damping_tends_to_the_inverse_as_its_square(name):
    machine, posture, base = CASES[name]()
    plain = evaluate(machine, posture, base=base)
    apart = []
    for damping in (1e-2, 1e-3):
        result = evaluate(machine, posture, base=base, control=f"damped:{damping}")
        apart.append([np.abs(result.w - plain.w).max(), abs(result.epsilon_max - plain.epsilon_max)])
    order = np.log10(np.array(apart[0]) / apart[1])
    assert np.all(np.abs(order - 2) < 0.05), order


@pytest.mark.parametrize("name", ["planar", "spatial, redundant"])
def test_much_damping_tends_to_the_transpose_over_its_square(name):
    machine, posture, base = CASES[name]()
    transpose = evaluate(machine, posture, base=base, control="transpose")
    errors = []
    for damping in (1e3, 1e4):
        result = evaluate(machine, posture, base=base, control=f"damped:{damping}", gain=5e5 * damping**2)
        errors.append(np.abs(result.w * damping**2 - transpose.w).max() / transpose.scale.max())
        assert result.epsilon_max == pytest.approx(transpose.epsilon_max, rel=1e-4)
    assert errors[0] < 1e-4
    assert errors[1] < 2e-2 * errors[0]


@pytest.mark.long
def test_a_singular_posture_has_measures_and_runs():
    machine = flexopt.load("excavator")
    straight = [0.9, 0.0]
    for control in ("inverse", "transpose", "damped:1e-9"):
        with pytest.raises(SingularPosture, match="bend stick"):
            evaluate(machine, straight, control=control)
    with pytest.warns(flexopt.FlexoptWarning, match="no feedback of the end-point stabilises"):
        result = evaluate(machine, straight, control="damped:0.2")
    w, scale = dense_w(machine, np.array(straight), np.zeros(1), "damped:0.2")
    assert result.condition > 1e12
    assert np.all(np.abs(result.w - w) <= 1e-10 * scale)
    assert result.epsilon_max is None
    assert np.all(np.isfinite(result.gradient.w))
    tree = tree_from_dict(grounded(4, 0))
    with pytest.raises(SingularPosture):
        evaluate(tree, [0.2, 0.3, 0.0, 0.0])
    w, scale = dense_w(tree, np.array([0.2, 0.3, 0.0, 0.0]), np.zeros(3), "damped:0.2")
    assert np.all(np.abs(evaluate(tree, [0.2, 0.3, 0.0, 0.0], control="damped:0.2").w - w) <= 1e-10 * scale)
    run = flexopt.simulate(machine, straight, control="damped:0.2", duration=0.5, kp=1e4, kv=1e3)
    assert np.all(np.isfinite(run.torque))
    assert run.control == "damped:0.2"
    with pytest.raises(SingularPosture):
        flexopt.simulate(machine, straight, duration=0.5)


BAD = ["damped", "damped:", "damped:0", "damped:-0.1", "damped:nan", "damped:inf", "damped:two", "damped:1e300", "damp:1",
       "damped:0.1:2", "Damped:0.1", "", 3, ["damped:0.1"]]  # fmt: skip


@pytest.mark.parametrize("value", BAD)
def test_bad_dampings_are_one_clear_error(value):
    with pytest.raises(InputError) as caught:
        evaluate(flexopt.load("excavator"), POSTURE, control=value)
    assert "control" in str(caught.value)
    assert "inverse, transpose or damped:LAMBDA" in str(caught.value)
    assert len(caught.value.faults) == 1


def test_equal_dampings_are_equal_words():
    assert {check_control(f"damped:{text}") for text in ("0.1", "0.10", "1e-1", " 0.1 ", ".1")} == {"damped:0.1"}
    assert check_control("damped:2.0") == "damped:2"
    machine = flexopt.load("excavator")
    result = evaluate(machine, POSTURE, control="damped:0.10")
    assert result.control == "damped:0.1"
    assert result.to_dict()["control"] == result.provenance["options"]["control"] == "damped:0.1"
    assert evaluate(machine, POSTURE, control="damped:1e-1").w.tolist() == result.w.tolist()


def test_command_line_and_files(tmp_path, capsys):
    expected = evaluate(flexopt.load("excavator"), POSTURE, control="damped:0.3")
    main(["evaluate", "excavator", "--posture", "0.9929,-2.6306", "--control", "damped:0.30", "--json"])
    document = json.loads(capsys.readouterr().out)
    assert document["control"] == "damped:0.3"
    assert document["w"] == expected.w.tolist()
    with pytest.raises(SystemExit) as leave:
        main(["evaluate", "excavator", "--posture", "0.9929,-2.6306", "--control", "damped:-1"])
    assert leave.value.code == 2
    assert "--control = 'damped:-1': must be inverse, transpose or damped:LAMBDA" in capsys.readouterr().err
    text = 'name = "dig"\nmachine = "excavator"\n'
    (tmp_path / "dig.toml").write_text(f'{text}target.end_point = [2.0, 0.5]\nselection.control = "damped:0.20"\n')
    problem = flexopt.load_problem(tmp_path / "dig.toml")
    assert problem.selection.control == "damped:0.2"
    (tmp_path / "run.toml").write_text(f'{text}[simulation]\nposture = {POSTURE}\ncontrol = "damped:0"\n')
    with pytest.raises(FlexoptError, match="damped:LAMBDA") as caught:
        flexopt.load_experiment(tmp_path / "run.toml")
    assert "simulation.control = 'damped:0'" in str(caught.value)


def test_a_selection_under_damped_control():
    chosen = flexopt.select(flexopt.load("excavator"), (2.0, 0.5), control="damped:0.5", starts=3)
    best = chosen.best.evaluation
    w, scale = dense_w(flexopt.load("excavator"), best.posture, best.base, "damped:0.5")
    assert best.control == chosen.to_dict()["best"]["control"] == "damped:0.5"
    assert np.all(np.abs(best.w - w) <= 1e-9 * scale)


FEW = """
name = "few"
robot = "arm.urdf"
actuated = ["slew", "boom"]
locked = { finger_a = 0.04, extend = 0.4 }
[base]
stiffness = { z = 4e6 }
[end_point]
link = "tool"
"""


@pytest.mark.parametrize("command", ["evaluate --posture 0,0", "select --end-point 1,1", "simulate --posture 0,0",
                                     "export --out x", "map"])  # fmt: skip
def test_fewer_joints_than_task_rows_are_refused_at_every_entry(command, tmp_path, capsys, monkeypatch):
    from tests.model.robots.files import URDF  # noqa: PLC0415

    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.urdf").write_text(URDF)
    (tmp_path / "few.toml").write_text(FEW)
    name, *options = command.split()
    with pytest.raises(SystemExit) as leave:
        main([name, "few.toml", *options])
    assert leave.value.code == 2
    message = capsys.readouterr().err
    sentence = (
        "3 task rows need at least 3 actuated joints; there are 2 (slew, boom): actuate more joints, or take fewer"
    )
    assert sentence in " ".join(message.split())


def test_fewer_joints_than_task_rows_in_dictionaries():
    data = grounded(2, 0)
    with pytest.raises(flexopt.ModelError, match=r"3 task rows need .* there are 2 \(a0, a1\): actuate more joints"):
        tree_from_dict(data)
    data = flexopt.load("excavator").to_dict()
    with pytest.raises(flexopt.ModelError, match="two task rows x and y, needs at least two; add a link"):
        machine_from_dict(data | {"links": data["links"][:1]})
