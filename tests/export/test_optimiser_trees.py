"""The generated optimiser on machines in space: against `select` and a planar twin, at any budget, with bad inputs."""

from __future__ import annotations

import math
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flexopt
from benchmarks.optimiser import Pair, draw_pairs, value_of
from flexopt.errors import InputError, UnreachableTarget
from flexopt.export import PARTS, ExportReport, export_c, verify_bundle
from flexopt.export.bundle import library_of, machine_of, read_manifest
from flexopt.export.context import build_context
from flexopt.export.optimiser_part import OptimiserPart, draw_target, optimiser
from flexopt.export.verify import optimiser as verify
from flexopt.export.verify.bench import Bench
from flexopt.foundation.quantities import COORDINATE_MAX
from flexopt.model import tree_from_dict
from flexopt.plant import build_plant
from flexopt.plant.reach import outer_reach
from flexopt.selection.proof.check import prove
from tests.export.optimiser_library import Library, assert_feasible, library, problem_of
from tests.export.programs import GCC, MAKE, TARGET
from tests.oracles.spatial import grounded, in_space, random_tree

pytestmark = GCC

SAME = 1e-8
# Positions of machines ten metres long; Newton's method ends at 32 roundings of the largest number that enters.
ROUNDING = 1e-11
SIX_ROWS = ("x", "y", "z", "roll", "pitch", "yaw")


# The optimiser in C knows no ground.
NO_GROUND: Any = {"assume": "limits"}


@dataclass(frozen=True)
class Case:
    """A problem, what `select` makes of it, and a point that the problem's own sample reached."""

    found: flexopt.Selection
    start: np.ndarray

    @property
    def problem(self) -> flexopt.SelectionProblem:
        return self.found.problem

    @property
    def best(self) -> float:
        return self.found.best.objective


def cases(machine: Any, count: int, seed: int, **options: Any) -> list[Case]:
    """Random targets that `select` solves, V with random weights: where V is below 0, that proves little else."""
    rng, plant, made = np.random.default_rng(seed), build_plant(machine), list[Case]()
    for _ in range(10 * count):
        if len(made) == count:
            return made
        weights = rng.uniform(0.1, 1, plant.n_passive).tolist()
        target = draw_target(plant, rng).tolist()
        try:
            found = flexopt.select(machine, target, objective="V", weights=weights, starts=8, **NO_GROUND, **options)
        except (UnreachableTarget, flexopt.NoSolutionFound):
            continue
        scan = found.problem.scan
        k = int(rng.integers(scan.size))
        made.append(Case(found, np.concatenate([scan.base[:, k], scan.posture[:, k]])))
    raise AssertionError("most targets have no solution")


@pytest.fixture(scope="module")
def slewing() -> flexopt.Tree:
    return flexopt.load("slewing-excavator")


@pytest.fixture(scope="module")
def excavator(slewing, tmp_path_factory) -> Library:
    return library(slewing, tmp_path_factory.mktemp("slewing"))


@pytest.fixture(scope="module")
def some(slewing) -> list[Case]:
    return cases(slewing, 3, seed=1)


def assert_back_at_the_optimum(lib: Library, problems: list[Case]) -> None:
    """From nearby, within the default budget: V not below that of the best optimum that IPOPT found."""
    rng = np.random.default_rng(0)
    assert sum(case.best < -1e-3 * case.problem.objective_scale for case in problems) > 0
    for case in problems:
        z, scale = case.found.best.z, case.problem.objective_scale
        start = z + rng.uniform(-0.01, 0.01, z.size)
        away = lib.solve(problem_of(lib, case.problem), start, lib.options(starts=0, budget=1))
        answer = lib.solve(problem_of(lib, case.problem), start)
        assert away.feasible
        assert answer.feasible
        assert_feasible(case.problem, answer, ROUNDING)
        v = value_of(case.problem, answer.z)[0]
        assert answer.value == pytest.approx(v, abs=1e-11 * answer.scale)
        # The optimiser in C steps along slopes alone, and stops short of a kink: there it only never leads down.
        assert v >= case.best - SAME * scale or case.found.best.kinks
        assert v >= away.value


def assert_equal_or_better(lib: Library, pairs: list[Pair]) -> None:
    """Than IPOPT from the same start, be it on the target or anywhere, once all starts are climbed."""
    assert sum(pair.ipopt > -math.inf for pair in pairs) > len(pairs) / 2
    for pair in pairs:
        answer = lib.solve(problem_of(lib, pair.problem), pair.start, lib.options(budget=5000))
        assert answer.feasible
        assert_feasible(pair.problem, answer, ROUNDING)
        assert value_of(pair.problem, answer.z)[0] >= pair.ipopt - SAME * pair.problem.objective_scale


@pytest.mark.long
def test_back_at_the_optimum_that_select_found(excavator, some):
    assert_back_at_the_optimum(excavator, some)


@pytest.mark.long
def test_as_good_as_ipopt_or_better(slewing, excavator):
    assert_equal_or_better(excavator, draw_pairs(slewing, "inverse", 8, seed=5))


@pytest.mark.long
def test_a_slide(tmp_path):
    crane = flexopt.load("truck-crane")
    assert "m" in crane.joint_units
    lib = library(crane, tmp_path)
    assert_back_at_the_optimum(lib, cases(crane, 2, seed=2))
    assert_equal_or_better(lib, draw_pairs(crane, "inverse", 4, seed=5))


@pytest.mark.long
def test_orientation_rows_and_a_placement_that_turns_only(tmp_path):
    rows = ("x", "y", "z", "yaw")
    machine = tree_from_dict(random_tree(17, rows=rows, counts=(2, 5)) | {"placement": ["yaw"]})
    assert machine.task_rows == rows
    assert_back_at_the_optimum(library(machine, tmp_path), cases(machine, 2, seed=3))


@pytest.mark.long
def test_six_rows_of_the_task_on_the_margin(tmp_path):
    """sin² is a product of six terms then: its rounding must not keep a climb off the margin."""
    rows = ("x", "y", "z", "roll", "pitch", "yaw")
    machine = tree_from_dict(random_tree(17, rows=rows, counts=(2, 7)) | {"placement": []})
    assert_back_at_the_optimum(library(machine, tmp_path), cases(machine, 2, seed=3))


@pytest.mark.long
def test_a_planar_machine_as_a_tree_has_the_same_optima(tmp_path):
    """The planar machine's `select` looks at every placement and both elbows, so its optimum is the global one."""
    planar = flexopt.load("excavator")
    data = planar.to_dict() | {"gravity": planar.gravity}
    lib = library(tree_from_dict(in_space(data)), tmp_path)
    weights, targets = (1.0, 0.5, 2.0), ((0.0, 1.6), (0.4, 0.3), (-0.7, 2.9), (0.2, -0.8))
    for target in targets:
        best = flexopt.select(planar, target, objective="V", weights=weights)
        scale = best.problem.objective_scale
        assert best.best.objective < -1e-3 * scale
        problem = lib.problem(target, weights=weights, sine_squared_min=math.sin(math.radians(10.0)) ** 2)
        answer = lib.solve(problem)
        assert answer.status == "CONVERGED"
        assert answer.value == pytest.approx(best.best.objective, abs=SAME * scale)


@pytest.mark.long
def test_a_climb_from_the_given_start_alone_ends_in_a_proved_optimum(excavator, some):
    for case in some:
        options = excavator.options(starts=0, budget=3000)
        answer = excavator.solve(problem_of(excavator, case.problem), case.start, options)
        assert answer.status == "CONVERGED"
        assert_feasible(case.problem, answer, ROUNDING)
        proof = prove(case.problem, answer.z)
        assert proof.holds, proof.violations
        assert answer.value >= value_of(case.problem, case.start)[0] - SAME * case.problem.objective_scale


@pytest.mark.long
def test_angles_without_bounds_are_unwound(excavator, some):
    case, turn = some[0], 2 * math.pi
    free = ~np.isfinite(case.problem.lower)
    assert [v.name for v, f in zip(case.problem.variables, free, strict=True) if f] == ["base.yaw", "slew"]
    options = excavator.options(starts=0, budget=3000)
    problem = problem_of(excavator, case.problem)
    plain = excavator.solve(problem, case.start, options)
    wound = excavator.solve(problem, case.start + turn * 3 * free, options)
    assert np.all(np.abs(plain.z[free]) <= math.pi)
    assert np.all(np.abs(wound.z[free]) <= math.pi)
    assert wound.value == pytest.approx(plain.value, abs=SAME * plain.scale)


@pytest.mark.long
def test_a_narrowed_range_is_kept_and_costs_something(slewing, excavator, some):
    """Ranges that the free optimum lies outside of, next to a point that reaches the target."""
    worse = 0
    for case in some:
        at = case.start
        ranges = {"x": (at[0] - 0.2, at[0] + 0.2), "y": (at[1], at[1] + 0.3), "yaw": (at[2] - 0.1, at[2] + 0.05)}
        alpha = case.problem.objective.weights.tolist()
        narrow = flexopt.build_selection(
            slewing, case.problem.target, objective="V", weights=alpha, base_range=ranges, **NO_GROUND
        )
        answer = excavator.solve(problem_of(excavator, narrow), case.start)
        assert answer.feasible
        assert_feasible(narrow, answer, ROUNDING)
        # To the last digit of the bounds, which are given in the precision of the call.
        assert np.all((narrow.lower <= answer.z) & (answer.z <= narrow.upper))
        worse += answer.value < case.best - 1e-6 * case.problem.objective_scale
    assert worse > 0


@pytest.mark.long
def test_equal_bounds_hold_a_coordinate(excavator, some):
    for case in some:
        problem = problem_of(excavator, case.problem)
        held = (0, 1, 2, 4)  # the placement and the boom: as many variables stay as the target has rows
        for i in held:
            problem.lower[i] = problem.upper[i] = case.start[i]
        answer = excavator.solve(problem, case.start)
        assert answer.feasible
        assert_feasible(case.problem, answer, ROUNDING)
        np.testing.assert_array_equal(answer.z[list(held)], case.start[list(held)])
        problem.lower[4], problem.upper[4] = -0.829, 1.012
        more = excavator.solve(problem, case.start)
        assert more.value >= answer.value - SAME * answer.scale
        np.testing.assert_array_equal(more.z[:3], case.start[:3])


@pytest.mark.long
def test_every_budget_gives_a_feasible_point_and_more_never_a_worse_one(excavator, some):
    """What a call does is the beginning of what it does with more budget, but for ties."""
    case, values = some[0], list[float]()
    problem = problem_of(excavator, case.problem)
    of_start, _ = value_of(case.problem, case.start)
    for budget in [*range(1, 40), *range(40, 500, 23)]:
        answer = excavator.solve(problem, case.start, excavator.options(budget=budget))
        if answer.status == "ENDED_EARLY":
            assert not values
            continue
        assert answer.value >= max(values, default=-math.inf) - SAME * case.problem.objective_scale
        values.append(answer.value)
        assert_feasible(case.problem, answer, ROUNDING)
        assert answer.cost <= budget
        # The projection onto the target moves the start by its own rounding.
        assert answer.value >= of_start - SAME * case.problem.objective_scale
    assert len(values) > 30
    assert values[-1] > of_start + 1e-3 * case.problem.objective_scale


def test_deadline_at_any_moment(excavator, some):
    case, last = some[1], -math.inf
    problem, statuses = problem_of(excavator, case.problem), set()
    for polls in range(60):
        left = [polls]

        def expired(_: Any, left: list[int] = left) -> int:
            left[0] -= 1
            return int(left[0] < 0)

        answer = excavator.solve(problem, case.start, excavator.options(expired))
        statuses.add(answer.status)
        if answer.status == "ENDED_EARLY":
            assert last == -math.inf
            continue
        assert_feasible(case.problem, answer, ROUNDING)
        assert answer.value >= last
        last = answer.value
    assert {"ENDED_EARLY", "DEADLINE"} <= statuses <= {"ENDED_EARLY", "DEADLINE", "CONVERGED"}


def test_parameters_at_run_time(excavator, some):
    """The optimiser of one machine given another's parameters solves the other's problem."""
    heavy = tree_from_dict(some[0].problem.machine.to_dict() | {"payload": {"mass": 800.0}})
    assert heavy.parameters != some[0].problem.machine.parameters
    selection = flexopt.build_selection(
        heavy, some[0].problem.target, objective="V", weights=[1.0] * 6, starts=8, **NO_GROUND
    )
    problem = problem_of(excavator, selection)
    problem.parameters[:] = [parameter.value for parameter in heavy.parameters]
    answer = excavator.solve(problem, None, excavator.options(budget=3000))
    assert answer.feasible
    assert_feasible(selection, answer, ROUNDING)
    assert answer.value == pytest.approx(value_of(selection, answer.z)[0], abs=1e-11 * answer.scale)


def test_a_target_too_high_leaves_the_result_alone(slewing, excavator):
    center, radius = outer_reach(build_plant(slewing))
    problem = excavator.problem((0.0, 0.0, center[2] + 1.01 * radius))
    result = excavator.Result(value=7.0, cost=11)
    for start in (None, np.zeros(7)):
        answer = excavator.solve(problem, start, excavator.options(budget=100_000), result)
        assert answer.status == "NO_FEASIBLE"
        assert (answer.value, answer.cost) == (7.0, 11)


@pytest.mark.parametrize("turn", [(0.0, 0.0), (0.7, 0.7), (-0.2, 0.1), (-COORDINATE_MAX, COORDINATE_MAX)])
@pytest.mark.parametrize("beside", [0.0, 0.7])
def test_a_target_out_of_reach_of_every_placement_is_refused_at_once(slewing, excavator, turn, beside):
    """Where the slewing axis is put by the plant's own skeleton; one that may turn counts as one that turns any way."""
    plant, rng = build_plant(slewing), np.random.default_rng(16)
    own = {parameter.name: parameter.value for parameter in slewing.parameters}
    own |= {"house.position.x": beside, "house.position.y": -beside / 2}
    p, radius = list(own.values()), outer_reach(plant)[1]
    problem = excavator.default_problem()
    lower, upper = np.array(problem.lower), np.array(problem.upper)
    lower[:3], upper[:3] = [-0.5, 0.2, turn[0]], [-0.5, 1.0, turn[1]]

    def refused(target: np.ndarray, budget: int = 1) -> bool:
        given = excavator.problem(target, lower=lower, upper=upper, parameters=p)
        return excavator.solve(given, None, excavator.options(budget=budget)).status == "NO_FEASIBLE"

    placements = rng.uniform(lower[:3], np.minimum(upper[:3], lower[:3] + 2 * np.pi), (40, 3))
    slew = 1 + [body.name for body in slewing.bodies].index("house")
    first = np.array([plant.skeleton(plant.rest(b, np.zeros(4), p), b, p).full()[:, slew] for b in placements])
    assert np.ptp(first[:, 2]) == 0.0
    for axis in first:
        ray = rng.normal(size=3)
        assert not refused(axis + 0.999 * radius * ray / np.linalg.norm(ray))
    # As far as the corner of the box, the circle about it and the arm reach, and a little farther.
    middle = np.array([-0.5, 1.0])
    circle = 0.0 if turn[0] == turn[1] else beside * math.hypot(1, 0.5)
    middle = (
        middle if circle else first[np.argmax(first[:, 1]), :2] + [0.0, 1.0 - placements[np.argmax(first[:, 1]), 1]]
    )
    for angle in (0.0, 0.9, math.pi / 2):
        ray = np.array([math.cos(angle), math.sin(angle)])
        for share, expected in ((0.999, False), (1.002, True)):
            target = np.array([*(middle + (circle + share * radius) * ray), first[0, 2]])
            assert refused(target) == expected
            assert not expected or refused(target, excavator.default_options().budget)


@pytest.mark.parametrize(
    ("status", "field", "index", "value"),
    [
        ("NOT_FINITE", "target", 2, math.nan),
        ("NOT_FINITE", "lower", 2, -math.inf),
        ("NOT_FINITE", "start", 6, math.inf),
        ("NOT_FINITE", "weights", 5, math.nan),
        ("NOT_FINITE", "parameters", "gravity", math.nan),
        ("OUT_OF_RANGE", "target", 2, 2e6),
        ("OUT_OF_RANGE", "lower", 6, 3.0),
        ("OUT_OF_RANGE", "upper", 2, 2e6),
        ("OUT_OF_RANGE", "weights", 5, -1.0),
        ("OUT_OF_RANGE", "parameters", "payload.mass", -1.0),
    ],
)
def test_bad_input_is_refused_and_the_result_left_alone(excavator, some, status, field, index, value):
    case = some[0]
    if field == "parameters":
        index = [parameter.name for parameter in case.problem.machine.parameters].index(index)
    problem, start = problem_of(excavator, case.problem), case.start.copy()
    assert excavator.solve(problem, start, excavator.options(starts=0)).feasible
    (start if field == "start" else getattr(problem, field))[index] = value
    answer = excavator.solve(problem, start, result=excavator.Result(value=7.0, cost=11))
    assert answer.status == status
    assert (answer.value, answer.cost) == (7.0, 11)


@pytest.mark.long
def test_single_precision(slewing, some, tmp_path):
    """On the target to some roundings of the reach, as a bundle allows; V near that of the doubles."""
    lib = library(slewing, tmp_path, real="float")
    for case in some:
        answer = lib.solve(problem_of(lib, case.problem), case.start)
        assert answer.feasible
        v, error = value_of(case.problem, answer.z)
        assert error <= 5e-5 * outer_reach(build_plant(slewing))[1]
        assert v >= value_of(case.problem, case.start)[0] - 1e-4 * case.problem.objective_scale


def part_of(machine: Any) -> OptimiserPart:
    context = build_context(
        machine, control="inverse", gain=5e5, single=False, baked=False, singularity_margin_deg=10.0
    )
    return optimiser(context, "m", "double")


@pytest.mark.long
def test_a_vectors_z_is_compared_only_where_it_is_the_only_one(slewing):
    """Turning a machine and its arm about the target changes no w_i; without a placement nothing can turn."""
    part = part_of(slewing)
    vectors = part.vectors(1, 2)
    assert not any(vector.unique for vector in vectors)
    for vector in vectors:
        z, turn = vector.z, 0.7
        p, w = build_plant(slewing).parameter_values, part.at.measures.w
        before, _, r_before = w.call([z[:3], z[3:], p])
        c, s, at = math.cos(turn), math.sin(turn), r_before.full()[:2, 0]
        anchor = at + np.array([[c, -s], [s, c]]) @ (z[:2] - at)
        turned = np.array([*anchor, z[2] + turn, *z[3:]])
        after, _, r_after = w.call([turned[:3], turned[3:], p])
        np.testing.assert_allclose(r_after.full().ravel(), r_before.full().ravel(), rtol=0, atol=1e-12)
        np.testing.assert_allclose(after.full(), before.full(), rtol=1e-9, atol=1e-9 * vector.scale)
    fixed = part_of(tree_from_dict(random_tree(3, counts=(2, 4)) | {"placement": []}))
    assert all(vector.unique for vector in fixed.vectors(2, 2))


def bench_of(report: ExportReport, scratch: Path, inputs: int, fuzz_calls: int) -> Bench:
    scratch.mkdir()
    manifest = read_manifest(report.folder)
    return Bench(report.folder, scratch, manifest, library_of(manifest), inputs, fuzz_calls)


@pytest.fixture(scope="module")
def bound(tmp_path_factory) -> ExportReport:
    """A bundle of a machine without a placement."""
    machine = tree_from_dict(random_tree(4, counts=(2, 4)) | {"placement": []})
    return export_c(machine, tmp_path_factory.mktemp("bound") / "b", parts=["optimiser"])


@pytest.mark.long
def test_a_bundle_without_a_placement(bound, tmp_path):
    report, machine = bound, machine_of(bound.manifest)
    entry = report.manifest["parts"]["optimiser"]
    assert entry["variables"] == list(machine.joints)
    assert entry["units"] == list(machine.joint_units) == ["m", "rad", "rad", "rad"]
    assert {field["name"]: field["shape"] for field in entry["inputs"]}["target"] == [3]
    bench = bench_of(report, tmp_path / "scratch", 6, 10_000)
    objects = list(bench.objects("plain", "gcc", ["-std=c99", "-O0"]).values())
    selftest = bench.program("selftest", "gcc", [report.folder / "test" / "selftest.c", *objects], ["-std=c99"])
    said = subprocess.run([selftest], capture_output=True, text=True, check=True).stdout
    assert "all passed" in said
    assert "4 problems, V lower than IPOPT's" in said
    runner = verify.host_runner(bench, "gcc", objects)
    agreed, fuzzed = verify.agreement(bench, runner), verify.faulty_calls(bench, runner)
    assert agreed.faults == fuzzed.faults == []
    assert dict(agreed.tables[0].rows)["the same V as IPOPT's best, or a better one"] == 6
    counts = dict(fuzzed.tables[0].rows)
    assert sum(counts.values()) == 1_000
    # Some answers with a feasible configuration, and every refusal.
    assert counts["CONVERGED"] + counts["BUDGET_SPENT"] > 100
    refusals = ("NULL_POINTER", "BAD_WORKSPACE", "NOT_FINITE", "OUT_OF_RANGE", "ENDED_EARLY")
    assert all(counts[status] > 0 for status in refusals)


@pytest.mark.long
@MAKE
@pytest.mark.parametrize(
    ("seed", "rows", "counts"),
    [
        # What a shift of the base moves only its turn could move, too, and that changes every w_i: both are needed.
        (4, ("z", "x"), (2, 2)),
        # Starts so steep, near singular postures, that a step from them leads to other optima, are none to compare from.
        (5, ("x", "z", "pitch"), (2, 3)),
        (111, ("x", "z", "pitch"), (1, 3)),
    ],
)
def test_the_self_test_of_tasks_that_do_not_turn_along(seed, rows, counts, tmp_path):
    report = export_c(tree_from_dict(random_tree(seed, rows=rows, counts=counts)), tmp_path / "b", parts=["optimiser"])
    command = ["make", "-s", "-C", str(report.folder), "CFLAGS=-O0", "test"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    assert "all passed" in done.stdout


def test_an_arm_that_no_mode_moves_along_the_task_has_no_optimiser(tmp_path):
    machine = tree_from_dict(random_tree(136, rows=("x",), counts=(1, 3)))
    with pytest.raises(flexopt.ExportError, match="V is 0 everywhere"):
        export_c(machine, tmp_path / "b", parts=["optimiser"])


@pytest.mark.long
@TARGET
def test_a_bundle_on_an_emulated_processor(bound):
    """The same problems as on this computer; `python -m benchmarks.optimiser` counts shipped machines' instructions."""
    result = verify_bundle(bound.folder, target="cortex-m7", inputs=6)
    assert result.passed and result.complete, repr(result)  # noqa: PT018
    tables = {
        table.title: dict(table.rows) for check in result.checks for table in check.tables if len(table.header) == 2
    }
    solved = tables["Posture optimiser"]
    assert solved["the same V as IPOPT's best, or a better one"] == solved["problems"] == 6
    assert 100_000 < solved["instructions, most"] <= verify.INSTRUCTIONS


def test_too_few_variables_are_refused(tmp_path):
    three = grounded(3, 1)
    one = random_tree(3, rows=("x",), counts=(2, 1))
    refusal = PARTS["optimiser"].refusal
    assert refusal(tree_from_dict(three)) == ""
    assert "3 variables for 3 rows" in refusal(tree_from_dict(three | {"placement": []}))
    assert "two actuated joints" in refusal(tree_from_dict(one))
    with pytest.raises(InputError, match="more variables than the task has rows"):
        export_c(tree_from_dict(three | {"placement": []}), tmp_path / "b", parts=["optimiser"])


@pytest.mark.needs("gcc")
@pytest.mark.long
def test_another_optimum_nearly_as_high_is_no_failure_of_the_self_test(tmp_path):
    """Of a lift whose w_i have a second, local optimum at a limit of its boom, lower by 0.0004 of V's scale."""
    lengths = (("boom", 6.2, 2.9, 0.0, 1450, 4900, (-1.9, 0.6)), ("jib", 4.8, 2.2, 0.0, 820, 1650, (-2.6, 2.6)),
               ("head", 1.6, 0.9, 0.1, 780, 190, (-2.2, 2.2)))  # fmt: skip
    names = ("name", "length", "com", "com_offset", "mass", "inertia", "limits")
    machine = flexopt.model.machine_from_dict({
        "name": "lift",
        "base": {
            "length": 2.1, "com": 0.9, "com_offset": 0.35, "mass": 11500, "inertia": 16500, "rest_angle": 1.5707963,
            "stiffness": {"x": 1.8e6, "y": 2.6e6, "rotation": 8e6}, "damping": {"x": 9e3, "y": 1.6e4, "rotation": 3.5e4},
        },
        "links": [dict(zip(names, link, strict=True)) for link in lengths],
    })  # fmt: skip
    report = export_c(machine, tmp_path / "b", parts=["optimiser"])
    bench = bench_of(report, tmp_path / "scratch", 6, 1_000)
    objects = list(bench.objects("plain", "gcc", ["-std=c99", "-O2"]).values())
    selftest = bench.program("selftest", "gcc", [report.folder / "test" / "selftest.c", *objects], ["-std=c99"])
    # Which of them the search finds, rounding may decide.
    assert "all passed" in subprocess.run([selftest], capture_output=True, text=True, check=True).stdout
