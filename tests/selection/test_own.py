"""Objectives and constraints of the user's own: beside those that flexopt has, beside other methods, and every fault."""

from __future__ import annotations

import json
import math
import pickle
import re
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import minimize_scalar

import flexopt
from benchmarks.own import OtherOwn, asked, random_goal, sags, torques
from flexopt.model.own import check_function
from flexopt.selection.own import OwnGraphs, known_quantities
from flexopt.selection.proof.check import prove
from tests.oracles.gradient_cases import near_repeated
from tests.oracles.machines import Structure, arm_at_rest, random_machine, regular_posture

TARGET = (0.0, 1.6)
EXCAVATOR, SLEWING, ARM = (flexopt.load(name) for name in ("excavator", "slewing-excavator", "boom-stick-bucket"))
AHEAD, BELOW = (4.7, 2.0, -1.4), (5.15, -1.45)


def symbols(machine: Any = EXCAVATOR) -> dict[str, ca.MX]:
    return {name: ca.MX.sym(name, quantity.size) for name, quantity in known_quantities(machine).items()}


def function(name: str, expression: Any, **inputs: ca.MX) -> ca.Function:
    return ca.Function(name, list(inputs.values()), [expression], list(inputs), ["v"])


Q = symbols()


# Beside what flexopt has.


def not_seen_through(machine: Any, alpha: Any, size: float) -> ca.Function:
    """An increasing function of Σ αi wi that is not that sum itself."""
    w = symbols(machine)["w"]
    return function("own", size * ca.atan(ca.dot(ca.DM(alpha), w) / size), w=w)


@pytest.mark.long("machine1-target1")
@pytest.mark.parametrize(("machine", "target"), [(EXCAVATOR, TARGET), (SLEWING, AHEAD)])
def test_an_increasing_function_of_a_measure_is_best_where_the_measure_is(machine: Any, target: Any) -> None:
    m = flexopt.build_plant(machine).n_passive
    alpha = np.linspace(1.0, 0.3, m)
    theirs = flexopt.select(machine, target, objective="V", weights=alpha.tolist(), starts=4)
    size = theirs.problem.objective_scale
    ours = flexopt.select(machine, target, objective=not_seen_through(machine, alpha, size), starts=4)
    assert ours.problem.objective.own is not None
    value = size * math.tan(ours.best.objective / size)
    assert value == pytest.approx(theirs.best.objective, abs=1e-8 * size)


@pytest.mark.long("machine1-target1")
@pytest.mark.parametrize(("machine", "target"), [(EXCAVATOR, TARGET), (ARM, BELOW)])
def test_a_measure_given_as_a_function_is_that_measure(machine: Any, target: Any) -> None:
    """What is known of w_1 holds: that 0 is the most there is, and the surface that has it."""
    w1 = ca.MX.sym("w1")
    ours = flexopt.select(machine, target, objective=function("mine", w1, w1=w1), starts=6)
    theirs = flexopt.select(machine, target, objective="w1", starts=6)
    assert ours.best.unsurpassed
    assert ours.problem.name == "mine"
    np.testing.assert_array_equal(ours.best.z, theirs.best.z)
    assert [candidate.dimension for candidate in ours.candidates] == [c.dimension for c in theirs.candidates]


@pytest.mark.parametrize(
    ("expression", "alpha"),
    [
        (Q["w"][0] + 2 * Q["w"][1], (1.0, 2.0, 0.0)),
        (ca.dot(ca.DM([0, 0, 3]), Q["w"]), (0.0, 0.0, 3.0)),
        (-Q["w"][0], None),
        (Q["w"][0] + 1, None),
        (Q["w"][0] * Q["w"][1], None),
        (ca.fmin(Q["w"][0], Q["w"][1]), None),
        (ca.mmin(Q["w"]), None),
    ],
)
def test_sums_of_measures_are_seen_through(expression: ca.MX, alpha: Any) -> None:
    problem = flexopt.build_selection(EXCAVATOR, TARGET, objective=function("mine", expression, w=Q["w"]))
    assert problem.objective.alpha == (alpha or (0.0, 0.0, 0.0))
    assert (problem.objective.own is None) == (alpha is not None)


def kind_and_own(kind: str) -> tuple[dict[str, Any], flexopt.Constraint]:
    """A kind of constraint, and the same by quantities."""
    machine, q = ARM, symbols(ARM)
    if kind == "joint_margin":
        low, high = (ca.DM(ends) for ends in zip(*machine.limits, strict=True))
        inside = ca.vertcat(q["posture"] - low, high - q["posture"])
        return {kind: 0.1}, flexopt.Constraint(function(kind, inside, posture=q["posture"]), lower=0.1, unit="rad")
    if kind == "manipulability":
        return {kind: 25.0}, flexopt.Constraint(function(kind, q[kind], **{kind: q[kind]}), lower=25.0, unit="m^2")
    pull, push = (ca.DM([cylinder.force[k] for cylinder in machine.cylinders]) for k in (0, 1))
    forces = q["cylinder_forces"]
    share = ca.vertcat(forces / push, -forces / pull)
    return {kind: 0.3}, flexopt.Constraint(function(kind, share, cylinder_forces=forces), upper=0.3)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["joint_margin", "manipulability", "holding"])
def test_an_own_constraint_that_is_a_kind_leaves_the_same_optimum(kind: str) -> None:
    theirs, ours = kind_and_own(kind)
    options: dict[str, Any] = {"objective": "V", "weights": [1.0] * 3, "starts": 8}
    without = flexopt.select(ARM, BELOW, **options)
    built_in = flexopt.select(ARM, BELOW, constraints=theirs, **options)
    own = flexopt.select(ARM, BELOW, constraints=[ours], **options)
    size = built_in.problem.objective_scale
    assert own.best.objective == pytest.approx(built_in.best.objective, abs=1e-6 * size)
    assert built_in.best.objective < without.best.objective - 1e-6 * size, "the constraint does not bind"
    assert any(name.startswith(kind) for name in own.best.active)
    for row in own.problem.own_constraints:
        value = own.best.constraints[row.name]
        assert value.lower - 1e-7 * row.scale <= value.value <= value.upper + 1e-7 * row.scale


@pytest.mark.long
def test_in_order_with_others() -> None:
    """w_1 first, then the least torque among what keeps it: as the kept value bounds it as a constraint."""
    least = function("least_torque", -ca.sumsqr(Q["torques"]) / 1e9, torques=Q["torques"])
    both = flexopt.select(EXCAVATOR, TARGET, objective=["w1", least], slack=1e-3)
    assert both.problem.name == "w1,least_torque"
    at_least = both.kept[0].at_least
    w1 = flexopt.Constraint(function("w1_kept", Q["w1"], w1=Q["w1"]), lower=at_least)
    alone = flexopt.select(EXCAVATOR, TARGET, objective=least, constraints=[w1])
    value = least(gravity_of(EXCAVATOR, both.best.z))
    assert float(value) == pytest.approx(alone.best.objective, rel=1e-6)
    assert flexopt.select(EXCAVATOR, TARGET, objective=[least, "epsilon_max"], slack=0.1).kept[0].objective == (
        "least_torque"
    )


def gravity_of(machine: Any, z: np.ndarray) -> np.ndarray:
    """Torques at rest, by public Functions."""
    n_b = len(machine.base_coordinates)
    return torques(machine, z[:n_b, None], z[n_b:, None]).ravel()


# Beside other methods.


def sag_of(machine: Any, base: Any, posture: Any) -> np.ndarray:
    """How far the end-point gives way, by public Functions."""
    return sags(machine, np.reshape(base, (-1, 1)), np.reshape(posture, (-1, 1))).ravel()


def scanned(machine: Any, target: np.ndarray, value: Any, margin: float) -> float:
    """The best of a planar machine of two joints over a grid of placements, refined without slopes."""
    plant, problem = flexopt.build_plant(machine), flexopt.build_selection(machine, target)
    low, high, measures = problem.lower[0], problem.upper[0], flexopt.build_measures(machine)

    def at(x: float, elbow: str) -> float:
        try:
            posture = flexopt.inverse_kinematics(machine, target, base=x, elbow=elbow)[0]
            if float(plant.singularity_sine_squared([x], posture, plant.parameter_values)) < math.sin(margin) ** 2:
                return -1e9
            w = measures.w([x], posture, plant.parameter_values)[0].full().ravel()
        except flexopt.FlexoptError:
            return -1e9
        return float(value([x], posture, w, sag_of(machine, [x], posture)))

    best, grid = -math.inf, np.linspace(low, high, 40)
    for elbow in ("up", "down"):
        values = [at(x, elbow) for x in grid]
        for k in np.argsort(values)[-2:]:
            ends = grid[max(k - 1, 0)], grid[min(k + 1, grid.size - 1)]
            found = minimize_scalar(lambda x, e=elbow: -at(x, e), bounds=ends, method="bounded")
            best = max(best, values[k], -float(found.fun))
    return best


@pytest.mark.long("1")
@pytest.mark.filterwarnings("ignore:ε_max:flexopt.errors.FlexoptWarning")
@pytest.mark.parametrize("seed", [None, 1])
def test_a_scan_finds_nothing_better(seed: int | None) -> None:
    machine, target, rng = EXCAVATOR, np.array(TARGET), np.random.default_rng(100 if seed is None else seed)
    if seed is not None:
        machine = random_machine(rng, Structure(2, ("x", "y", "rotation"), ()))[1]
        target = arm_at_rest(machine, regular_posture(rng, machine))[1]
    problem = flexopt.build_selection(machine, target)
    value, goal = random_goal(rng, machine, problem.objective_scale)
    best = flexopt.select(machine, target, objective=goal).best
    # A grid of 40 placements, the best refined: the scan may miss the last digits, never by more than it is coarse.
    other = scanned(machine, target, value, problem.singularity_margin)
    assert best.objective >= other - 1e-7
    assert best.objective <= other + 1e-2
    told = value(best.z[:1], best.z[1:], best.w, sag_of(machine, best.z[:1], best.z[1:]))
    assert best.objective == pytest.approx(float(told), rel=1e-8, abs=1e-8)


@pytest.mark.long
@pytest.mark.parametrize(("name", "number"), [("slewing-excavator", 0), ("boom-stick-bucket", 3)])
def test_a_method_without_slopes_finds_nothing_better(name: str, number: int) -> None:
    """With constraints of both kinds; `python -m benchmarks.own` tries more."""
    machine, target, options, value, most = asked(name, number)
    selection = flexopt.select(machine, target, **options)
    other, _ = OtherOwn(selection.problem, number, value, most).best(60, 12, 40)
    assert other <= selection.best.objective + 1e-4 * selection.problem.objective_scale
    z, n_b = selection.best.z, len(machine.base_coordinates)
    assert np.linalg.norm(gravity_of(machine, z)) <= most * (1 + 1e-7)
    told = value(z[:n_b], z[n_b:], selection.best.w, sag_of(machine, z[:n_b], z[n_b:]))
    travel = selection.problem.travel_cost(selection.problem.objective, z)[0]
    assert selection.best.objective == pytest.approx(float(told - travel), rel=1e-7, abs=1e-7)


# Kinks.


def pipe_laying(**changes: Any) -> dict[str, Any]:
    """A small part of the shipped problem, whose best configuration stands on b_5 = 0, without travel."""
    arguments = flexopt.load_problem("pipe-laying").select_arguments()
    constraints = {name: getattr(arguments["constraints"], name) for name in arguments["constraints"].model_fields_set}
    del constraints["travel"]
    base_range = {"x": (3.88, 4.48), "y": (-6.0, -5.7), "yaw": (-2.25, -1.65)}
    return arguments | {"constraints": constraints, "base_range": base_range, "starts": 8} | changes


@pytest.mark.long
def test_a_kink_of_a_measure_is_one_of_its_functions_and_proved() -> None:
    theirs = flexopt.select(**pipe_laying())
    assert theirs.best.kinks
    size, alpha = theirs.problem.objective_scale, theirs.problem.objective.alpha
    own = not_seen_through(SLEWING, alpha, size)
    ours = flexopt.select(**pipe_laying(objective=own, weights=None))
    assert size * math.tan(ours.best.objective / size) == pytest.approx(theirs.best.objective, abs=1e-7 * size)
    assert list(ours.best.kinks) == list(theirs.best.kinks)
    # The pull at w_i, over its scale, is what the cone weighs.
    np.testing.assert_allclose(list(ours.best.kinks.values()), list(theirs.best.kinks.values()), rtol=1e-3)
    # Where V falls with w_5, it rises from the kink in two directions, whatever the slopes beside say.
    w = symbols(SLEWING)["w"]
    turned = flexopt.build_selection(**pipe_laying(objective=function("turned", -w[4], w=w), weights=None))
    violations = prove(turned, theirs.best.z).violations
    assert "kink of w5, on which V falls with it" in violations


@pytest.mark.long
def test_a_kink_of_a_measure_in_a_constraint_is_proved() -> None:
    """w_1 best, with Σ αi wi at least what nearly its best has, which stands on a kink: as in order with a slack."""
    theirs = flexopt.select(**pipe_laying(objective="V,w1", slack=1e-3, starts=4))
    size, alpha = theirs.problem.objective_scales[0], theirs.problem.objectives[0].alpha
    own = not_seen_through(SLEWING, alpha, size)
    least = size * math.atan(theirs.kept[0].at_least / size)
    arguments = pipe_laying(objective="w1", weights=None, starts=4)
    arguments["constraints"] = [arguments["constraints"], flexopt.Constraint(own, lower=least, name="enough")]
    best = flexopt.select(**arguments).best
    assert "enough" in best.active
    assert best.constraints["enough"].value >= least - 1e-7 * size
    assert best.objective == pytest.approx(theirs.best.w[0], abs=1e-6 * theirs.problem.objective_scales[1])


def test_frequencies_that_are_one_are_left_undecided() -> None:
    case = near_repeated(np.random.default_rng(0), 0.0, condition=20.0)
    _, target = arm_at_rest(case.machine, case.posture)
    frequencies = symbols(case.machine)["frequencies"]
    goal = function("first_frequency", frequencies[0], frequencies=frequencies)
    problem = flexopt.build_selection(case.machine, target, objective=goal, starts=1, singularity_margin_deg=0.5)
    proof = prove(problem, np.append(np.zeros(1), case.posture))
    assert "frequencies of first_frequency that are one" in proof.violations


# Several targets, files, other processes, pictures.


@pytest.mark.long
def test_several_targets() -> None:
    targets, sag = [(0.0, 1.6), (0.2, 1.5)], Q["sag"]
    w1 = function("w1_steeper", 1e-3 * ca.sin(1e3 * Q["w1"]), w1=Q["w1"])
    at_most = flexopt.Constraint(function("sag_length", ca.norm_2(sag), sag=sag), upper=0.004, unit="m")
    free = flexopt.select_stand(EXCAVATOR, targets, objective=w1)
    theirs = flexopt.select_stand(EXCAVATOR, targets, objective="w1")
    assert free.worth == pytest.approx(theirs.worth, abs=1e-10)
    bound = flexopt.select_stand(EXCAVATOR, targets, objective=w1, constraints=[at_most])
    lengths = [np.linalg.norm(sag_of(EXCAVATOR, p.evaluation.base, p.evaluation.posture)) for p in bound.places]
    assert max(lengths) <= 0.004 + 1e-9
    told = [place.constraints["sag_length"].value for place in bound.places]
    np.testing.assert_allclose(told, lengths, rtol=1e-8)
    assert bound.worth < free.worth
    plan = flexopt.plan_base(EXCAVATOR, targets, objective=w1, constraints=[at_most], starts=1)
    assert min(place.objective for place in plan.places) >= bound.worth - 1e-12


@pytest.mark.long
def test_results_are_data_and_drawn(tmp_path: Path) -> None:
    least = function("least_torque", -ca.sumsqr(Q["torques"]) / 1e9, torques=Q["torques"])
    at_most = flexopt.Constraint(function("sag_length", ca.norm_2(Q["sag"]), sag=Q["sag"]), upper=0.005, unit="m")
    options = {"objective": least, "constraints": [at_most, {"joint_margin": 0.01}], "base": 0.0, "starts": 4}
    selection = flexopt.select(EXCAVATOR, TARGET, workers=2, **options)
    again = flexopt.select(EXCAVATOR, TARGET, workers=1, **options)
    np.testing.assert_array_equal(selection.best.z, again.best.z)
    document = json.loads(json.dumps(selection.to_dict(), allow_nan=False))
    assert document["problem"]["objective"] == "least_torque"
    assert document["best"]["constraints"]["sag_length"]["upper"] == 0.005
    assert "sag_length" in [row["name"] for row in document["problem"]["constraints"]]
    assert "least_torque" in repr(selection)
    selection.plot(tmp_path / "own.png")
    problem = pickle.loads(pickle.dumps(selection.problem))
    assert problem.objectives == selection.problem.objectives
    assert prove(problem, selection.best.z).holds
    with pytest.raises(flexopt.InputError, match="has Functions of its own"):
        flexopt.certify(selection)


def test_options_carry_them() -> None:
    w1 = function("steeper", 1e-3 * ca.sin(1e3 * Q["w1"]), w1=Q["w1"])
    options = flexopt.SelectionOptions(objective=["w2", w1], starts=2)
    problem = flexopt.build_selection(EXCAVATOR, TARGET, options=options)
    assert problem.name == "w2,steeper"
    data = {"name": "small", "machine": "excavator", "target": {"end_point": TARGET}}
    made = flexopt.Problem(**data, selection={"objective": w1, "starts": 2}).with_machine(EXCAVATOR)
    assert flexopt.solve_problem(made).problem.name == "steeper"


@pytest.mark.long
def test_every_quantity_is_what_is_computed_elsewhere() -> None:
    machine, plant = SLEWING, flexopt.build_plant(SLEWING)
    z = np.array([0.3, -0.2, 0.4, 0.3, 0.1, -1.2, -0.5])
    base, posture, p = z[:3], z[3:], plant.parameter_values
    told, rest = flexopt.evaluate(machine, posture, base=base), plant.rest(base, posture, p)
    sagged = np.append(plant.deflected(base, posture, p).full(), posture)
    jacobian = plant.rigid_jacobian(rest, base, p).full()
    wanted = {
        "base": base,
        "posture": posture,
        "p": p.full(),
        "w": told.w,
        **{f"w{i + 1}": w for i, w in enumerate(told.w)},
        "frequencies": told.frequencies_hz,
        "damping_ratios": told.damping_ratios,
        "allowance": 8 * math.pi * told.damping_ratios * told.frequencies_hz / np.abs(told.w),
        "end_point": told.end_point,
        "centre_of_mass": plant.centre_of_mass(rest, base, p).full(),
        "torques": gravity_of(machine, z),
        "manipulability": math.sqrt(np.linalg.det(jacobian @ jacobian.T)),
        "singularity": float(plant.singularity_sine_squared(base, posture, p)),
        "deflection": (plant.deflected(base, posture, p) - rest[:6]).full(),
        "sag": sag_of(machine, base, posture),
        "cylinder_forces": flexopt.build_hydraulics(machine).forces(posture, gravity_of(machine, z), p).full(),
    }
    held = plant.gravity(sagged, base, p).full().ravel()[plant.n_passive :]
    under_weight = {
        "end_point": plant.end_point(sagged, base, p).full(),
        "centre_of_mass": plant.centre_of_mass(sagged, base, p).full(),
        "torques": held,
        "cylinder_forces": flexopt.build_hydraulics(machine).forces(posture, held, p).full(),
    }
    for gravity in (False, True):
        assert set(wanted) == set(known_quantities(machine))
        wanted |= under_weight if gravity else {}
        for name, symbol in symbols(machine).items():
            own = check_function(function("one", symbol, **{name: symbol}))
            graphs = OwnGraphs(flexopt.build_measures(machine, gravity=gravity), own)
            found = graphs.values_at(base, posture, p, 0, 0).full().ravel()
            if gravity and name.startswith(("w", "f", "damping", "allowance")):
                continue
            np.testing.assert_allclose(found, np.ravel(wanted[name]), rtol=1e-7, atol=1e-11)


def test_the_worked_example_and_the_table_of_the_page() -> None:
    """The lines of the page on own objectives run, and give what is said there; its table names every quantity."""
    text = (Path(__file__).parents[2] / "docs" / "howto" / "own-objective.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```python\n(import casadi as ca\n.*?)```", text, re.DOTALL)
    names: dict[str, Any] = {"flexopt": flexopt, "machine": EXCAVATOR}
    exec(block, names)
    choice, said = names["choice"], float(re.findall(r"sag_length\"\].value  # ([0-9.]+) m", block)[0])
    assert choice.best.constraints["sag_length"].value == pytest.approx(said, rel=2e-3)
    listed = set(re.findall(r"`(\w+)`", text[text.index("| input | what it is |") : text.index("An unknown name")]))
    assert set(known_quantities(SLEWING)) - {f"w{i}" for i in range(3, 7)} == listed - {"Machine", "gravity"}


# What is wrong with them.


def refused(match: str, **arguments: Any) -> None:
    with pytest.raises(flexopt.InputError, match=match):
        flexopt.select(EXCAVATOR, TARGET, **arguments)


POSTURE, W1 = Q["posture"], Q["w1"]


class Plain(ca.Callback):
    def __init__(self) -> None:
        ca.Callback.__init__(self)
        self.construct("plain", {})

    def eval(self, given: list[ca.DM]) -> list[ca.DM]:
        return [given[0]]


@pytest.mark.parametrize(
    ("own", "match"),
    [
        (ca.Function("f", [POSTURE], [POSTURE[0]]), r"no quantities \('i0'\).*(?s:.*)centre_of_mass \(2,\), m"),
        (ca.Function("f", [POSTURE], [POSTURE[0]], ["postur"], ["v"]), "did you mean 'posture'"),
        (ca.Function("f", [Q["w"]], [Q["w"][0]], ["posture"], ["v"]), r"input posture of shape \(3, 1\).*\(2, 1\)"),
        (function("f", POSTURE, posture=POSTURE), r"one number, not an output of shape \(2, 1\)"),
        (ca.Function("f", [POSTURE], [POSTURE[0], POSTURE[1]], ["posture"], ["u", "v"]), "one output, not 2"),
        (ca.Function("f", [], [1.0], [], ["v"]), "has no inputs"),
        (ca.Function("f", [W1], [W1], ["epsilon_max"], ["v"]), "epsilon_max, of which no second derivatives"),
        (function("f", ca.log(POSTURE[0] - 100), posture=POSTURE), "not a finite number at any configuration"),
        ({"w": 1}, "w1, w2, .*or a casadi.Function"),
        ([3], "must be a casadi.Function"),
        (["w1", "w1"], "names the same objective twice"),
        ([function("w1", W1 * W1, w1=W1), "w1"], "names the same objective twice"),
    ],
)
def test_bad_objectives(own: Any, match: str) -> None:
    refused(match, objective=own)


def test_what_has_no_derivatives_or_wrong_ones() -> None:
    plain = Plain()
    refused("Callback", objective=ca.Function("f", [POSTURE], [plain(POSTURE[0])], ["posture"], ["v"]))
    refused("Callback", constraints=[plain])
    x = ca.MX.sym("x", 2)
    wrong = ca.Function("jac_inner", [x, ca.MX.sym("y")], [2 * ca.cos(x.T)], ["x", "out_y"], ["jac_y_x"])
    options = {"custom_jacobian": wrong, "jac_penalty": 0, "never_inline": True}
    inner = ca.Function("inner", [x], [ca.sum1(ca.sin(x))], ["x"], ["y"], options)
    refused("brings derivatives", objective=function("f", inner(POSTURE), posture=POSTURE))


def test_weights_go_with_words_only() -> None:
    refused("weights.*go with objective V only, not with f", objective=function("f", W1, w1=W1), weights=[1, 1, 1])


def test_bad_constraints() -> None:
    own = function("f", W1, w1=W1)
    refused(r"constraints \(f\).*one of|no quantities", constraints=[ca.Function("f", [W1], [W1], ["w9"], ["v"])])
    refused("names must differ", constraints=[own, own])
    alike = function("manipulability", POSTURE[0], posture=POSTURE)
    refused(r"constraints \(manipulability\).*names must differ", constraints=[{"manipulability": 0.5}, alike])
    assert flexopt.build_selection(EXCAVATOR, TARGET, constraints=[alike]).own_constraints[0].name == "manipulability"
    refused("entry 0 must be a casadi.Function", constraints=[3])
    refused("stands in two tables", constraints=[{"holding": 0.5}, own, {"holding": 0.6}])
    refused("not a finite number", constraints=[function("f", ca.log(W1 - 1), w1=W1)])
    with pytest.raises(flexopt.InputError, match="must be above lower"):
        flexopt.Constraint(own, lower=2.0, upper=1.0)
    with pytest.raises(flexopt.InputError, match=r"(?s)function = 3.*unit"):
        flexopt.Constraint(3, unit=5)  # type: ignore[arg-type]
    boom = flexopt.Constraint(function("f", POSTURE[0], posture=POSTURE), lower=9.0, unit="rad")
    with pytest.raises(flexopt.NoSolutionFound, match=r"keep f .*violates f by \S+ rad") as caught:
        flexopt.select(EXCAVATOR, TARGET, constraints=[boom])
    assert caught.value.violations["f"] == pytest.approx(9.0 - caught.value.iterate["boom"], rel=1e-9)


@pytest.mark.parametrize("size", [1.0, 1e7])
def test_measures_beside_it_are_shown_whatever_its_size(size: float) -> None:
    goal = function("own", -size * ca.fmax(ca.fabs(Q["torques"][0]), ca.fabs(Q["torques"][1])), torques=Q["torques"])
    found = flexopt.select(EXCAVATOR, TARGET, objective=goal, base=0.0, starts=2, workers=1)
    heads, *rows = [line.split() for line in repr(found).splitlines()[1 : 3 + len(found.candidates)]]
    assert found.initial is not None
    for row, e in ((rows[0], found.best.evaluation), (rows[-1], found.initial)):
        told = dict(zip(heads[1:], row[1:], strict=False))
        shown = [float(told[f"w{i + 1}"]) for i in range(e.w.size)]
        # What is 0 but for rounding is shown as 0.
        np.testing.assert_allclose(shown, e.w, rtol=1e-3, atol=1e-9 * e.scale.max())


def test_files_have_none(tmp_path: Path) -> None:
    text = 'name = "own"\nmachine = "excavator"\n[target]\nend_point = [0.0, 1.6]\n[constraints]\nown = ["sag"]\n'
    path = tmp_path / "own.toml"
    path.write_text(text)
    with pytest.raises(flexopt.FlexoptError, match="files have none"):
        flexopt.load_problem(path)


def test_the_present_configuration_is_said_to_break_what_it_breaks():
    """No better place was missed where it is better by what is not allowed."""
    start = (0.9929, -2.6302)
    away = Q["posture"] - ca.DM(start)
    near = function("near", -away.T @ away, posture=Q["posture"])
    lowest = flexopt.Constraint(function("floor", Q["w"][0], w=Q["w"]), lower=-1e-6)
    found = flexopt.select(EXCAVATOR, TARGET, base=0.0, posture=start, objective=near, constraints=[lowest], starts=4)
    assert found.best.objective < -0.01  # the present one has 0
    assert "breaks floor" in found.present_told
    assert not found.nothing_to_gain
    free = flexopt.select(EXCAVATOR, TARGET, base=0.0, posture=start, objective=near, starts=4)
    assert "breaks" not in free.present_told
