"""Every Function that a solver or a climb is given, beside differences, at points that are no optimum.

What is walked is found in the source: a solver that is made elsewhere, or a derivative that is taken in a function that
the table does not name, fails the test until it is walked, too.
"""

import ast
from dataclasses import replace
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import flexopt
from flexopt.loop.lag import LaggedModes
from flexopt.loop.outcome import MEASURES, LoopPoint
from flexopt.loop.settings import loop_settings
from flexopt.loop.small_motions import BY, DEAD_TIME
from flexopt.model.constraints import Constraints
from flexopt.model.files import shipped_names
from flexopt.model.own import check_function
from flexopt.plant.inverse_kinematics import held_steps, reach_steps
from flexopt.robustness.atlas import fields as atlas_fields
from flexopt.selection.ascent.model import Step
from flexopt.selection.nlp import program as program_module
from flexopt.selection.nlp import solvers
from flexopt.selection.nlp.assembly import IPOPT_OPTIONS
from flexopt.selection.nlp.program import row_gradients
from flexopt.selection.nullspace import law
from flexopt.selection.objective import Objective
from flexopt.selection.own import OwnTerm, known_quantities
from flexopt.selection.several.plan import _along
from flexopt.selection.several.standing import one_placement
from flexopt.selection.several.targets import build_problems
from flexopt.selection.starts import starting_points
from tests.oracles.machines import arm_at_rest, random_machine, regular_posture
from tests.oracles.slopes import POINTS, away, best_of, differences, of_function, of_solver
from tests.selection.test_spatial import CONSTRAINTS, PRESENT, slewing

# Differences of sixth order over 2e-3 of a machine's size lose less than this of smooth graphs.
FIRST, SECOND = 2e-6, 2e-5
ROOT = Path(flexopt.__file__).parent
SOLVER_MAKERS = {"nlpsol", "qpsol", "conic", "rootfinder", "integrator", "Opti", "dpleqsol", "simpleIRK", "collocation"}
DERIVATIVES = {"jacobian", "gradient", "hessian", "jtimes", "forward", "reverse", "tangent"}
# Where solvers are made, and how each is walked here.
MADE = {
    ("selection/nlp/solvers.py", "make_solver"): "the one place",
    ("study/doctor.py", "_ipopt"): "(x − 1)² in one variable, to see that IPOPT runs",
}
ASKED = {("selection/nlp/assembly.py", "build_solver")}
# Where derivatives are taken of what a solver or a climb is given: the test that walks them.
TAKEN = {
    ("algebra/feasible.py", "feasible_steps"): "test_steps_onto_rows",
    ("loop/lag.py", "slopes"): "test_what_modes_get_to_feel",
    ("loop/small_motions.py", "slopes"): "test_the_real_loop",
    ("loop/small_motions.py", "disturbance_slopes"): "test_the_real_loop",
    ("robustness/atlas/fields.py", "_function"): "test_the_atlas",
    ("robustness/expansion.py", "_machine_slope"): "test_single",
    ("robustness/expansion.py", "_machine_curvature"): "test_single",
    ("robustness/expansion.py", "_machine_jacobian"): "test_single",
    ("robustness/expansion.py", "jacobian"): "test_the_nullspace_law",
    ("robustness/margin.py", "_reverse_sweep"): "test_the_nullspace_law",
    ("robustness/measures.py", "end_point_gradient"): "test_the_independent_ones",
    ("robustness/mode_terms.py", "slopes"): "test_single",
    ("robustness/mode_terms.py", "second_slopes"): "test_single",
    ("robustness/mode_terms.py", "pull"): "test_single",
    ("robustness/mode_terms.py", "bent"): "test_single",
    ("selection/nlp/configuration.py", "row_slopes"): "test_single",
    ("selection/nlp/configuration.py", "row_curvature"): "test_single",
    ("selection/nlp/program.py", "_extra_slopes"): "test_the_independent_ones",
    ("selection/own/graphs.py", "_inner_slope"): "test_own_ones",
    ("selection/own/graphs.py", "_inner_curvature"): "test_own_ones",
    ("selection/own/graphs.py", "_outer_slope"): "test_own_ones",
    ("selection/own/graphs.py", "_outer_curvature"): "test_own_ones",
}
ROOMS = (
    "selection",
    "algebra",
    "robustness",
    "loop/small_motions.py",
    "loop/lag.py",
    "plant/inverse_kinematics.py",
)
walked: set[str] = set()


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def calls_in(path: Path, names: set[str]) -> set[tuple[str, str]]:
    """Functions of a file that call one of these as an attribute (`ca.nlpsol`) or by name, with the file."""
    found: set[tuple[str, str]] = set()
    for outer in ast.walk(parsed(path)):
        if not isinstance(outer, ast.FunctionDef):
            continue
        for node in ast.walk(outer):
            if isinstance(node, ast.Call):
                called = node.func
                name = called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")
                value = called.value if isinstance(called, ast.Attribute) else None
                # `self.expansion.jacobian` is our own.
                owner = getattr(value, "id", "own" if isinstance(value, ast.Attribute | ast.Subscript) else "")
                if name in names and owner in ("", "ca", "casadi"):
                    found.add((path.relative_to(ROOT).as_posix(), outer.name))
    return found


def sources(*rooms: str) -> list[Path]:
    places = [ROOT / room for room in rooms]
    return [path for place in places for path in ([place] if place.is_file() else sorted(place.rglob("*.py")))]


@pytest.mark.long
def test_solvers_are_made_in_one_place():
    made = {place for path in sources(".") for place in calls_in(path, SOLVER_MAKERS)}
    assert made == set(MADE)
    assert {place for path in sources(".") for place in calls_in(path, {"make_solver"})} == ASKED


@pytest.mark.long
def test_every_derivative_is_walked():
    taken = {place for path in sources(*ROOMS) for place in calls_in(path, DERIVATIVES)}
    assert taken == set(TAKEN)
    assert set(TAKEN.values()) <= set(globals())


@pytest.mark.parametrize("wrong", ["grad_f", "jac_g", "hess_lag", None])
def test_what_is_wrong_by_a_thousandth_is_seen(wrong):
    x, p = ca.MX.sym("x", 2), ca.MX.sym("p")
    f, g = ca.sin(x[0]) * x[1] + p, ca.vertcat(x[0] * x[1], ca.exp(x[0]))
    of_f, of_g = ca.MX.sym("of_f"), ca.MX.sym("of_g", 2)
    second = ca.triu(ca.densify(ca.hessian(of_f * f + ca.dot(of_g, g), x)[0]))
    off = {name: 1.001 if name == wrong else 1.0 for name in ("grad_f", "jac_g", "hess_lag")}
    given = {
        "grad_f": ca.Function("grad_f", [x, p], [f, off["grad_f"] * ca.gradient(f, x)]),
        "jac_g": ca.Function("jac_g", [x, p], [g, off["jac_g"] * ca.jacobian(g, x)]),
        "hess_lag": ca.Function("hess_lag", [x, p, of_f, of_g], [off["hess_lag"] * second]),
    }
    solver = solvers.make_solver("toy", {"x": x, "p": p, "f": f, "g": g}, IPOPT_OPTIONS | given)
    found = of_solver(solver, np.array([0.3, 1.2]), np.array([2.0]), np.random.default_rng(0))
    assert (found["first"] > FIRST or found["second"] > SECOND) == (wrong is not None)


def of_branched(functions, problem, x, parameters, rng):
    """Second derivatives of an ascent's program without ε_max, beside differences of its slopes."""
    n_rows, objectives = functions.curvature.size1_in(3), problem.objectives[: len(problem.kept) + 1]
    pulls, row_pulls = rng.uniform(0.5, 1.5, len(objectives)), rng.uniform(-1, 1, n_rows)

    def lagrangian(y):
        _, _, last_x, g_x, epsilon_x = (out.full() for out in functions.model.call([y, parameters]))
        total, slopes = row_pulls @ g_x[:n_rows], [*g_x[n_rows:], *last_x]
        for pull, objective, size in zip(pulls, objectives, problem.objective_scales, strict=False):
            total = total + pull * (slopes[0] - objective.beta / size * (epsilon_x[0] if objective.beta else 0.0))
            slopes = slopes[2 if objective.has_kinks else 1 :]
        return total

    given = functions.curvature.call([x, parameters, pulls, row_pulls])[0].full()
    return away(given, lagrangian, x)


def of_factors(functions, x, parameters):
    """Slopes of a_i and b_i, which cones stand on, beside differences, in units of the largest of each mode."""
    f, given, _ = (out.full() for out in functions.factors.call([x, parameters]))
    sizes = np.repeat(np.abs(f).max(axis=0), f.shape[0])
    return away(given / sizes[:, None],
                lambda y: functions.factors.call([y, parameters])[0].full().T.ravel() / sizes, x)  # fmt: skip


class _WalkedError(Exception):
    """What stops a solve that was only made to be walked."""


@pytest.fixture
def walk(monkeypatch):
    """Instead of solving, check what the solver is given near the start."""
    now = []

    def checked(function, parameters, given, independent, start, bounds):
        rng = np.random.default_rng(1)
        spread = [start + 5e-2 * rng.uniform(-1, 1, start.size) for _ in range(POINTS)]
        points = [np.clip(x, bounds.x_lower, bounds.x_upper) for x in spread]

        def check(x):
            if function.name() != "model":
                return of_solver(function, x, parameters, rng)
            return {
                "first": away(given(x).rows()[1], lambda y: given(y).rows()[0], x),
                "second": of_branched(given.args[0], now[0], x, parameters, rng),
                "factors": of_factors(given.args[0], x, parameters),
            }

        found = best_of(check, points, FIRST, second=SECOND)
        walked.add(f"{function.name()} {function.class_name()}")
        assert found["first"] < FIRST, found
        assert found.get("second", 0.0) < SECOND, found
        assert found.get("factors", 0.0) < FIRST, found
        raise _WalkedError

    solvers._confirmed.clear()
    monkeypatch.setattr(solvers, "confirm", checked)

    def go(problem, *args):
        program = program_module.single(problem) if isinstance(problem, flexopt.SelectionProblem) else problem
        now[:] = [program.first]
        with pytest.raises(_WalkedError):
            program.solve(*args)
        with pytest.raises(_WalkedError):
            program.climbed(*args, 1)

    yield go
    solvers._confirmed.clear()


def every_stage(problem):
    """The problem of each of its objectives in order, the earlier ones kept a little below what the start has."""
    start = starting_points(problem)[0]
    yield problem, start
    for objective, size in zip(problem.objectives[:-1], problem.objective_scales, strict=False):
        level = float(problem.branches(objective, start)[0][0]) - 0.1 * size
        problem = replace(problem, kept=(*problem.kept, level))
        yield problem, start


def machine_of(name):
    if isinstance(name, str):
        machine = flexopt.load(name)
        posture = np.array([sum(ends) / 2 if np.isfinite(ends).all() else 0.4 for ends in machine.limits])
        base = np.zeros(len(machine.base_coordinates))
        plant = flexopt.build_plant(machine)
        return machine, plant.end_point(
            plant.rest(base, posture, plant.parameter_values), base, plant.parameter_values
        ).full().ravel()
    rng = np.random.default_rng(name)
    machine = random_machine(rng)[1]
    return machine, arm_at_rest(machine, regular_posture(rng, machine))[1]


def maximising(problem, *objectives):
    """The problem with other objectives, given by α (one number for all modes) and β: no scan of ε_max is needed."""
    m = problem.measures.plant.n_passive
    wanted = tuple(Objective(f"V{k}", (alpha,) * m, beta) for k, (alpha, beta) in enumerate(objectives))
    sizes = tuple(alpha * problem.objective_scale + beta for alpha, beta in objectives)
    return replace(problem, objectives=wanted, objective_scales=sizes)


SHIPPED = ("excavator", "boom-stick-bucket", "slewing-excavator", "truck-crane", "mobile-manipulator")


@pytest.mark.long("slewing-excavator", "truck-crane", "mobile-manipulator")
@pytest.mark.parametrize("name", [*SHIPPED, 1, 4])
def test_single(walk, name):
    """w_i with exact second derivatives, and a mix with ε_max."""
    machine, target = machine_of(name)
    problem = flexopt.build_selection(machine, target, starts=2)
    start = starting_points(problem)[0]
    walk(maximising(problem, (1.0, 0.0)), start)
    walk(maximising(problem, (1.0, problem.objective_scale)), start)


@pytest.mark.long("objectives2-transpose-True", "objectives3-inverse-False")
@pytest.mark.parametrize(
    ("objectives", "control", "gravity"),
    [
        ([(1.0, 0.0), (0.5, 0.0)], "transpose", False),
        ([(1.0, 0.0), (0.0, 1.0)], "damped:0.3", False),
        ([(0.0, 1.0), (1.0, 0.0)], "transpose", True),
        ([(1.0, 1e-3), (0.0, 1.0), (1.0, 0.0)], "inverse", False),
        ([(1.0, 0.0), (0.5, 0.0)], "damped:0.3", True),
    ],
)
def test_in_order(walk, objectives, control, gravity):
    machine, target = machine_of("excavator")
    problem = flexopt.build_selection(machine, target, control=control, gravity=gravity)
    for stage, start in every_stage(maximising(problem, *objectives)):
        walk(stage, start)


# What a loop must do at least has branches of its own, walked over in test_measures.
def constrained(*, gravity=False):
    asked = CONSTRAINTS | {"within": [{"of": "arm3.mass", "factor": (0.7, 1.5)}]}
    assert set(asked) == set(Constraints.model_fields) - {"own", "outcome"}, "a kind of constraint is not walked"
    machine = flexopt.tree_from_dict(slewing())
    options = {"constraints": asked, "starts": 2, "gravity": gravity, **PRESENT}
    return flexopt.build_selection(machine, (3.5, 1.0, 1.2), **options)


@pytest.mark.long("two", "sagged")
@pytest.mark.parametrize(
    ("objectives", "gravity"),
    [
        pytest.param([(1.0, 0.0)], False, id="one"),
        pytest.param([(1.0, 0.0), (0.0, 1.0)], False, id="two"),
        pytest.param([(1.0, 0.0)], True, id="sagged"),
    ],
)
def test_every_kind_of_constraint(walk, objectives, gravity):
    for stage, start in every_stage(maximising(constrained(gravity=gravity), *objectives)):
        walk(stage, start)


# In space under gravity there is all that is without it, and what it adds.
@pytest.mark.long
@pytest.mark.parametrize(("name", "gravity"), [("excavator", False), ("excavator", True), ("slewing-excavator", True)])
def test_own_ones(walk, name, gravity):
    """Every quantity, squared and times another, as objective and as constraint, and in order with others."""
    machine, target = machine_of(name)
    plain = flexopt.build_selection(machine, target, starts=2, gravity=gravity)
    start = starting_points(plain)[0]
    for own in own_functions(machine, plain, start):
        options = {"starts": 2, "gravity": gravity, "constraints": [flexopt.Constraint(own, lower=-1e3, name="kept")]}
        problem = flexopt.build_selection(machine, target, objective=[own, "w1"], **options)
        walk(problem, start)
        walk(replace(problem, kept=(*problem.kept, -1e3)), start)


def own_functions(machine, problem, start):
    """Two Functions of half of a machine's quantities each, of typical size 1."""
    known, rng = dict(known_quantities(machine)), np.random.default_rng(3)
    del known["p"]
    n_base = problem.measures.plant.n_base
    for names in (list(known)[::2], list(known)[1::2]):
        symbols, total = {name: ca.MX.sym(name, known[name].size) for name in names}, ca.MX(0)
        for name, symbol in symbols.items():
            own = OwnTerm(check_function(ca.Function("one", [symbol], [symbol], [name], ["v"])))
            size = np.abs(problem.quantities.of_own(own, start[:n_base], start[n_base:])).max()
            x = symbol / max(size, 1e-6)
            total += ca.dot(rng.uniform(0.5, 1.0, symbol.shape[0]), x + x**2) * (1 + total) / len(names)
        yield ca.Function("own", list(symbols.values()), [total], names, ["v"])


GOALS = ("worst", "weighted", "motion")


def several(goal):
    """A program of two targets, and a point of it."""
    machine = flexopt.load("excavator")
    targets = np.array([(0.0, 1.6), (0.2, 1.5)])
    problems = build_problems("test", machine, targets, "targets", flexopt.SelectionOptions(), None)
    if goal == "motion":
        together = _along(problems, np.array([0.0, 1.0]), np.full(3, 0.5), None).kept(-0.1)
    else:
        together = one_placement(problems, np.array([0.3, 0.7]), weighted=goal == "weighted")
    return together, together.packed([starting_points(problem)[0] for problem in problems])


@pytest.mark.parametrize("goal", GOALS)
def test_several(walk, goal):
    walk(*several(goal))
    assert program_module.run is solvers.run


@pytest.mark.parametrize("goal", GOALS)
def test_an_ascent_of_several(goal):
    """What is put together of several configurations: sums and rows, their slopes, and those of the cones."""
    program, x = several(goal)
    (ascent, start), rng = program.ascent(x), np.random.default_rng(4)

    def check(x):
        at = ascent.at(x)
        step = Step(np.full(x.size, 1e-9), 0.0, rng.uniform(0.5, 1.5, at.values.size),
                    rng.uniform(-1, 1, at.rows.size), {}, np.eye(x.size), coupled=False)  # fmt: skip
        second = ascent._second(at, step, 1e-9)
        assert not second.cones

        def lagrangian(y):
            there = ascent.at(y)
            return second.free @ (step.row_pulls @ there.row_slopes - step.pulls @ there.slopes)

        along = differences(lagrangian, x) @ second.free.T
        cones = np.vstack([cone.slopes for cone in at.cones])
        sizes = np.linalg.norm(cones, axis=1, keepdims=True)
        return {
            "first": max(away(at.slopes, lambda y: ascent.at(y).values, x),
                         away(at.row_slopes, lambda y: ascent.at(y).rows, x),
                         away(ascent.rows(x)[1], lambda y: ascent.rows(y)[0], x)),
            "second": float(np.abs(second.smooth - along).max() / max(1.0, np.abs(along).max())),
            "cones": float(np.abs((cones - differences(
                lambda y: np.concatenate([cone.value for cone in ascent.at(y).cones]), x)) / sizes).max()),
        }  # fmt: skip

    found = best_of(check, [start + 2e-2 * rng.uniform(-1, 1, start.size) for _ in range(POINTS)], FIRST, second=SECOND)
    assert found["first"] < FIRST, found
    assert found["second"] < SECOND, found
    assert found["cones"] < FIRST, found


@pytest.mark.parametrize(
    "problem", [constrained, lambda: flexopt.build_selection(flexopt.load("excavator"), (0.0, 1.6))]
)
def test_the_independent_ones(problem):
    """What solvers are compared with, and what proofs and the steps onto constraints go by."""
    problem = problem()
    start = starting_points(problem)[0]
    rng, n = np.random.default_rng(2), start.size

    def check(z):
        rows = differences(problem.rows, z)
        v = differences(lambda at: problem.branches(problem.objective, at)[0], z)
        given = row_gradients(problem, z), problem.branches(problem.objective, z)[1]
        size = np.abs(v).max()
        return {
            "rows": float((np.abs(given[0] - rows) / np.maximum(1.0, np.abs(rows).max(axis=1, keepdims=True))).max()),
            "V": float(np.abs(given[1] - v).max() / size),
        }

    points = [start + 2e-2 * rng.uniform(-1, 1, n) * problem.scale for _ in range(POINTS)]
    found = best_of(check, points, FIRST)
    assert max(found.values()) < FIRST, found


@pytest.mark.long
@pytest.mark.parametrize("spatial", [False, True])
def test_the_nullspace_law(spatial):
    machine, posture = flexopt.load("excavator"), np.array([0.9, -1.3])
    if spatial:
        machine, posture = flexopt.tree_from_dict(slewing()), np.array([0.3, 0.4, -1.2, -0.5])
    plant = flexopt.build_plant(machine)
    base, p = np.full(plant.n_base, 0.1), plant.parameter_values.full().ravel()
    scale = np.abs(flexopt.build_measures(machine).w.call([base, posture, p])[1].full()).max()
    point, end_point = law._functions(machine, "inverse", False)
    given = [base, posture, p]

    def scaled(function, outputs):
        symbols = function.mx_in()
        found = function.call(symbols)
        return ca.Function("scaled", symbols, [found[k] / size for k, size in outputs])

    assert of_function(scaled(point, [(0, scale), (1, scale)]), given, 0, 1, [0, 1]) < FIRST
    assert of_function(point, given, 2, 3, [0, 1]) < FIRST
    assert of_function(end_point, given, 0, 1, [0, 1]) < FIRST
    margin = law._margin_gradients(machine, "inverse", False)
    found = margin.call([*given, 5e5])
    expected = differences(
        lambda z: margin.call([z[: base.size], z[base.size :], p, 5e5])[0].full().ravel(), np.concatenate(given[:2])
    )
    assert np.abs(found[1].full()[:2] - expected).max() < FIRST


@pytest.mark.parametrize("control", ["inverse", "transpose"])
@pytest.mark.parametrize("name", ["excavator", "boom-stick-bucket", "slewing-excavator"])
def test_the_atlas(name, control):
    """Slopes of a_i, b_i (times det Jv) and Jv, which its curves are followed by, beside differences."""
    machine = flexopt.load(name)
    fields = atlas_fields._function(machine, control, False).function
    plant = flexopt.build_plant(machine)
    p, n_base = plant.parameter_values, plant.n_base
    names = fields.name_out()

    def at(z, which):
        return fields.call([z[:n_base], z[n_base:], p])[names.index(which)].full()

    def check(z):
        sizes = np.repeat(np.abs(at(z, "f")).max(axis=0), at(z, "f").shape[0])
        posture = np.arange(z.size)[n_base:]
        size = np.abs(at(z, "jv")).max()

        def jv(q):
            there = z.copy()
            there[posture] = q
            return at(there, "jv").ravel() / size

        return {
            "first": away(at(z, "f_z") / sizes[:, None], lambda there: at(there, "f").T.ravel() / sizes, z),
            "jv": away(at(z, "jv_z") / size, jv, z[posture]),
        }

    rng = np.random.default_rng(2)
    points = [np.r_[np.zeros(n_base), rng.uniform(-1.2, 1.2, plant.n_actuated)] for _ in range(POINTS)]
    found = best_of(check, points, FIRST)
    assert found["first"] < FIRST
    assert found["jv"] < FIRST


@pytest.mark.long("True")
@pytest.mark.parametrize("spatial", [False, True])
def test_steps_onto_rows(spatial):
    """With the right slopes the steps are Newton's: a call from nearby leads to round-off."""
    problem = constrained() if spatial else flexopt.build_selection(flexopt.load("excavator"), (0.0, 1.6))
    start, free = starting_points(problem)[0], (problem.lower < problem.upper).astype(float)
    rng, p = np.random.default_rng(3), problem.measures.plant.parameter_values
    bounds = problem.lower, problem.upper, free, problem.scale
    near = np.clip(start + 1e-3 * rng.uniform(-1, 1, start.size) * problem.scale, problem.lower, problem.upper)
    left = problem.configuration.feasible.call([near, 1e-9, *bounds, *problem.row_bounds, p, problem.constants])[2]
    assert float(left) < 1e-13
    target, scale = problem.target, problem.row_bounds[2][: problem.target.size]
    left = reach_steps(problem.machine).call([near, 1e-9, *bounds, target, target, scale, p])[2]
    assert float(left) < 1e-13


@pytest.mark.parametrize("name", shipped_names("models"))
def test_steps_that_hold_a_machine_as_it_sags(name):
    """By differences of what is solved, where nothing holds; and a call from beside a static equilibrium leads to it."""
    machine = flexopt.load(name)
    plant, rng = flexopt.build_plant(machine), np.random.default_rng(5)
    g, p, m, n_b = plant.graph, plant.parameter_values, plant.n_passive, plant.n_base
    low, high = np.clip(np.array(machine.limits), -1.5, 1.5).T
    base, posture = rng.uniform(-0.3, 0.3, n_b), low + (high - low) * rng.uniform(0.2, 0.8, low.size)
    at = ca.vertcat(g.base, g.q)
    rows, slopes_of = (
        ca.Function("of", [at, g.p], [ca.densify(x)]) for x in (plant.held_rows, ca.jacobian(plant.held_rows, at))
    )
    springs = np.diag(plant.stiffness(p).full())[:m]
    size = np.append(springs, np.ones(plant.n_task))
    q = np.concatenate([plant.deflected(base, posture, p).full().ravel(), posture])
    beside = np.concatenate([base, q + 1e-2 * rng.standard_normal(q.size)])
    slopes = slopes_of(beside, p).full()
    assert away(slopes / size[:, None], lambda z: rows(z, p).full().ravel() / size, beside) < FIRST
    target = plant.end_point(q, base, p).full().ravel()
    near = np.concatenate([base, q + 1e-3 * rng.standard_normal(q.size)])
    free = np.append(np.zeros(n_b), np.ones(q.size))
    bounds = np.full(near.size, -np.inf), np.full(near.size, np.inf), free, np.ones(near.size)
    wanted = np.append(np.zeros(m), target)
    left = held_steps(machine).call([near, 1e-9, *bounds, wanted, wanted, size, p])[2]
    # Of a redundant arm steps are damped where springs and rows differ by orders of magnitude.
    assert float(left) < 1e-12


def test_all_solvers_were_walked(walk):
    """In a process that runs the whole file: IPOPT on one and on several configurations, and the ascent."""
    test_several(walk, "worst")
    problem = flexopt.build_selection(flexopt.load("excavator"), (0.0, 1.6))
    for stage, start in every_stage(maximising(problem, (1.0, 0.0), (0.0, 1.0))):
        walk(stage, start)
    assert walked >= {"selection IpoptInterface", "model MXFunction", "several IpoptInterface"}


@pytest.mark.long
@pytest.mark.parametrize(
    ("shipped", "measures"),
    [("excavator", tuple(MEASURES)), ("slewing-excavator", ("decay",))],
    ids=["excavator", "slewing-excavator"],
)
def test_the_real_loop(shipped, measures):
    """What a loop does by everything it depends on."""
    machine, rng = flexopt.load(shipped), np.random.default_rng(5)
    posture = np.array([sum(ends) / 2 if np.isfinite(ends).all() else 0.4 for ends in machine.limits])
    stand = flexopt.evaluate(machine, posture)
    loop = flexopt.Loop(dead_time=0.0137, rate=100.0, bandwidth_hz=8.0, filter_hz=30.0, drive="torque", feedback="pd")
    settings = loop_settings(machine, loop, stand)
    here = settings.outcome(machine, stand.base, stand.posture, gravity=False)
    given = {by: np.atleast_1d(here.numbers.get(by, settings.dead_time)) for by in BY}
    period = {"period": np.array([1 / settings.rate])}
    for name in measures:

        def measured(moved, name=name):
            numbers = {by: x for by, x in moved.items() if by != DEAD_TIME}
            point = LoopPoint(here.motions, here.motions.numbers(numbers | period), float(moved[DEAD_TIME][0]))
            return point, MEASURES[name](point)

        point, found = measured(given)
        if not np.isfinite(found.value):
            continue
        slopes = point.gradient(found)
        for by in BY:
            # In units of each input's own size.
            scale = np.abs(given[by]) if by != "posture" else np.ones(given[by].size)

            def value(x, by=by, scale=scale, size=found.value):
                return np.array([measured(given | {by: given[by] + scale * x})[1].value / size])

            # 1e-3 of a size is far for an eigenvalue: differences of sixth order over 1e-4.
            chosen = rng.permutation(given[by].size)[:2]
            along = np.eye(given[by].size)[chosen]
            expected = differences(lambda t, v=value, a=along: v(t @ a), np.zeros(len(chosen)), 1e-4)
            np.testing.assert_allclose(
                slopes[by] * scale / found.value @ along.T,
                expected.ravel(),
                atol=FIRST * max(1.0, np.abs(expected).max(initial=0)),
            )


def test_what_modes_get_to_feel():
    """Allowances, lag and first-order decay by everything they depend on."""
    machine, rng = flexopt.load("excavator"), np.random.default_rng(6)
    stand = flexopt.evaluate(machine, (0.3, -1.7))
    settings = loop_settings(machine, flexopt.Loop(kp=3e2, kv=30.0, dead_time=0.0137, bandwidth_hz=8.0), stand)
    here = settings.outcome(machine, stand.base, stand.posture, gravity=False)
    modes = LaggedModes(here.motions)
    given = dict(here.numbers) | {"dead_time": np.array([settings.dead_time])}
    values, slopes = modes.at(here.numbers, settings.dead_time)
    for by in BY:
        scale = np.abs(given[by]) if by != "posture" else np.ones(2)
        along = np.eye(scale.size)[rng.permutation(scale.size)[:3]]
        for k, (name, value) in enumerate(values.items()):
            known = np.isfinite(value)
            size = np.abs(value[known]).max(initial=1e-300)

            def moved(t, by=by, k=k, along=along, scale=scale, size=size, known=known):
                at = [given[x] + (scale * (t @ along) if x == by else 0) for x in modes.values.name_in()]
                return modes.values.call(at)[k].full().ravel()[known] / size

            expected = differences(moved, np.zeros(len(along)), 1e-4)
            found = (slopes[name][by] * scale / size)[known] @ along.T
            np.testing.assert_allclose(found, expected, atol=FIRST * max(1.0, np.abs(expected).max(initial=0)))
