"""The generated optimiser against IPOPT and the independent proof, at every budget and deadline, with bad inputs."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flexopt
from benchmarks.optimiser import draw_pairs, value_of
from flexopt.export import optimiser_part
from flexopt.export.context import build_context
from flexopt.export.optimiser import SEARCH
from flexopt.foundation.quantities import COORDINATE_MAX
from flexopt.plant import build_plant
from flexopt.plant.reach import reach
from flexopt.selection.proof.check import prove
from tests.export.optimiser_library import (
    WARNINGS,
    Library,
    assert_feasible,
    c_text,
    header_of,
    library,
    problem_of,
    sources_of,
)
from tests.export.programs import GCC
from tests.oracles.machines import random_machine

pytestmark = GCC

TARGET = (0.0, 1.6)
# IPOPT's own tolerance is 1e-10; an answer this far below it, relative to the problem's scale, is another one.
SAME = 1e-8


@pytest.fixture(scope="module")
def machine() -> flexopt.Machine:
    return flexopt.load("excavator")


@pytest.fixture(scope="module")
def three_joints(machine):
    data = machine.to_dict()
    bucket = {"name": "bucket", "length": 0.6, "com": 0.3, "mass": 150.0, "inertia": 12.0, "limits": [-2.5, 2.5]}
    return flexopt.machine_from_dict(data | {"links": [*data["links"], bucket]})


@pytest.fixture(scope="module")
def random_one():
    return random_machine(np.random.default_rng(5))[1]


@pytest.fixture(scope="module")
def excavator(machine, tmp_path_factory) -> Library:
    return library(machine, tmp_path_factory.mktemp("excavator"))


def assert_equal_or_better(lib: Library, pairs: list[Any], share: float = 1.0) -> None:
    good = 0
    for pair in pairs:
        answer = lib.solve(problem_of(lib, pair.problem), pair.start)
        assert answer.feasible
        assert_feasible(pair.problem, answer)
        v, _ = value_of(pair.problem, answer.z)
        scale = pair.problem.objective_scale
        assert answer.value == pytest.approx(v, abs=1e-12 * scale)
        good += v >= pair.ipopt - SAME * scale
    assert good >= share * len(pairs)


@pytest.mark.long
@pytest.mark.parametrize("control", ["inverse", "transpose"])
def test_same_optimum_as_ipopt_or_a_better_one(machine, control, tmp_path):
    lib = library(machine, tmp_path, control=control)
    assert_equal_or_better(lib, draw_pairs(machine, control, 25, seed=3))


@pytest.mark.long
def test_three_joints(three_joints, tmp_path):
    assert_equal_or_better(library(three_joints, tmp_path), draw_pairs(three_joints, "inverse", 12, seed=4))


@pytest.mark.long
def test_a_random_machine(random_one, tmp_path):
    # Four joints: the surface of configurations has three dimensions, and a sample of it finds not every peak.
    assert_equal_or_better(library(random_one, tmp_path), draw_pairs(random_one, "inverse", 12, seed=5), share=0.9)


@pytest.mark.long
def test_joint_limits(machine, tmp_path):
    data = machine.to_dict()
    data["links"][0]["limits"], data["links"][1]["limits"] = [-0.5, 1.2], [-2.6, -0.4]
    limited = flexopt.machine_from_dict(data)
    assert_equal_or_better(library(limited, tmp_path), draw_pairs(limited, "inverse", 15, seed=6))


@pytest.mark.long
def test_a_climb_from_the_given_start_alone_ends_in_a_proved_optimum(machine, excavator):
    """First- and second-order conditions by functions that the C code does not contain."""
    for pair in draw_pairs(machine, "inverse", 15, seed=7):
        answer = excavator.solve(problem_of(excavator, pair.problem), pair.start, excavator.options(starts=0))
        assert answer.status == "CONVERGED"
        assert answer.stationarity <= 1e-6
        proof = prove(pair.problem, answer.z)
        assert proof.holds, proof.violations


@pytest.mark.long
def test_own_starts_alone_find_the_best_of_select(machine, excavator):
    for target in ((0.0, 1.6), (0.4, 0.3), (-0.7, 2.9)):
        best = flexopt.select(machine, target, objective="w2")
        selection = best.problem
        answer = excavator.solve(problem_of(excavator, selection))
        assert answer.value >= best.best.objective - SAME * selection.objective_scale


def test_constants_baked_in_give_the_same_answers(machine, excavator, tmp_path):
    baked = library(machine, tmp_path, baked=True)
    assert not baked.parameters_at_run_time
    wide = excavator.solve(excavator.problem(TARGET, weights=(1.0, 0.0, 0.5)))
    narrow = baked.solve(baked.problem(TARGET, weights=(1.0, 0.0, 0.5)))
    assert narrow.status == wide.status == "CONVERGED"
    # Constants folded in are rounded elsewhere, and a tie may be broken otherwise: equal in value.
    assert narrow.value == pytest.approx(wide.value, abs=SAME * wide.scale)


def test_parameters_at_run_time(machine, excavator):
    """The optimiser of one machine given another's parameters solves the other's problem."""
    loaded = flexopt.machine_from_dict(machine.to_dict() | {"payload": {"mass": 300.0}})
    selection = flexopt.build_selection(loaded, TARGET, objective="V", weights=(1.0, 1.0, 1.0))
    problem = problem_of(excavator, selection)
    problem.parameters[:] = [parameter.value for parameter in loaded.parameters]
    answer = excavator.solve(problem)
    assert answer.status == "CONVERGED"
    proof = prove(selection, answer.z)
    assert proof.holds, proof.violations
    assert answer.value == pytest.approx(value_of(selection, answer.z)[0], rel=1e-10)


@pytest.mark.long
def test_every_budget_gives_a_feasible_point_and_more_never_a_worse_one(machine, excavator, three_joints, tmp_path):
    cases = [(excavator, pair) for pair in draw_pairs(machine, "inverse", 4, seed=8)]
    lib = library(three_joints, tmp_path)
    cases += [(lib, pair) for pair in draw_pairs(three_joints, "inverse", 2, seed=9)]
    for lib, pair in cases:
        problem, last = problem_of(lib, pair.problem), -math.inf
        complete = lib.solve(problem, pair.start, lib.options(budget=3000))
        for budget in [*range(1, 60), *range(60, complete.cost + 10, 7)]:
            answer = lib.solve(problem, pair.start, lib.options(budget=budget))
            if answer.status == "ENDED_EARLY":
                assert last == -math.inf
                continue
            # Converged, what was given up would be climbed again with more.
            converged = answer.status == "CONVERGED" and answer.stationarity <= lib.options().tolerance
            assert answer.status == "BUDGET_SPENT" or converged or budget >= complete.cost
            assert_feasible(pair.problem, answer)
            assert answer.cost <= budget
            assert answer.value >= last
            last = answer.value
        assert last == complete.value


def test_deadline_at_any_moment(machine, excavator):
    pair = draw_pairs(machine, "inverse", 1, seed=10)[0]
    problem, last = problem_of(excavator, pair.problem), -math.inf
    for polls in range(80):
        left = [polls]

        def expired(_: Any, left: list[int] = left) -> int:
            left[0] -= 1
            return int(left[0] < 0)

        answer = excavator.solve(problem, pair.start, excavator.options(expired))
        if answer.status == "ENDED_EARLY":
            assert last == -math.inf
            continue
        assert answer.status in {"DEADLINE", "CONVERGED"}
        assert_feasible(pair.problem, answer)
        assert answer.value >= last
        last = answer.value
    assert last > -math.inf


def test_continued_from_its_own_answer_it_ends_where_one_long_call_does(machine, excavator):
    pair = draw_pairs(machine, "transpose", 1, seed=11)[0]
    problem = problem_of(excavator, pair.problem)
    whole = excavator.solve(problem, pair.start, excavator.options(starts=0))
    z = pair.start
    for _ in range(30):
        answer = excavator.solve(problem, z, excavator.options(starts=0, budget=12))
        z = answer.z
    assert whole.status == answer.status == "CONVERGED"
    np.testing.assert_allclose(answer.z, whole.z, atol=1e-6)


def test_fixed_placement_leaves_the_better_elbow(machine, excavator):
    selection = flexopt.build_selection(machine, TARGET, base_range=(0.3, 0.3))
    answer = excavator.solve(problem_of(excavator, selection))
    assert answer.status == "CONVERGED"
    values = [
        value_of(selection, np.concatenate([[0.3], posture]))[0]
        for posture in flexopt.inverse_kinematics(machine, TARGET, base=0.3)
    ]
    assert answer.value == pytest.approx(max(values), rel=1e-12)
    assert answer.z[0] == 0.3


@pytest.mark.parametrize("bend", [0.0, 1e-9, math.pi])
def test_singular_start_is_brought_to_the_margin(machine, excavator, bend):
    selection = flexopt.build_selection(machine, TARGET)
    answer = excavator.solve(
        problem_of(excavator, selection), [0.5, 0.4, bend], excavator.options(starts=0, budget=200)
    )
    assert answer.status == "CONVERGED"
    assert_feasible(selection, answer)


def test_where_the_projection_fails_a_posture_in_closed_form_serves(machine, excavator):
    rng = np.random.default_rng(12)
    selection = flexopt.build_selection(machine, TARGET)
    for _ in range(40):
        start = [rng.uniform(-1e5, 1e5), *rng.uniform(-300, 300, 2)]
        answer = excavator.solve(problem_of(excavator, selection), start, excavator.options(starts=0))
        assert answer.status == "CONVERGED"
        assert_feasible(selection, answer)


def test_unreachable_target_leaves_the_result_alone(machine, excavator):
    outer = reach(build_plant(machine)).outer
    problem = excavator.problem((0.0, 2 * outer))
    result = excavator.Result(value=7.0, cost=11)
    for start in (None, (0.0, 0.3, -1.0)):
        answer = excavator.solve(problem, start, result=result)
        assert answer.status == "NO_FEASIBLE"
        assert (answer.value, answer.cost) == (7.0, 11)


@pytest.mark.parametrize(("low", "high"), [(0.0, 0.0), (-3.0, 0.5), (-COORDINATE_MAX, 0.5)])
def test_a_target_out_of_reach_of_every_placement_is_refused_at_once(machine, excavator, low, high):
    """By the distance from the nearest first joint, not row by row; just inside and the budget alone ends the call."""
    at, lower, upper = reach(build_plant(machine)), list(excavator.default_problem().lower), [high, 3.0, 3.0]
    lower[0] = low
    for angle in (0.0, 0.7, 1.4):
        ray = np.array([math.cos(angle), math.sin(angle)])
        for share, status in ((1.002, "NO_FEASIBLE"), (0.999, "ENDED_EARLY")):
            target = at.center + [high, 0.0] + share * at.outer * ray
            problem = excavator.problem(target, lower=lower, upper=upper)
            assert excavator.solve(problem, None, excavator.options(budget=1)).status == status


def test_nothing_within_reach_is_refused(machine, excavator):
    """Almost stretched arms inside random bounds, some ten thousand reaches away."""
    plant, rng = build_plant(machine), np.random.default_rng(15)
    for far in (1.0, 1e5):
        for _ in range(50):
            z = np.array([rng.uniform(-far, far), rng.uniform(-3, 3), rng.choice([-1, 1]) * rng.uniform(1e-3, 0.1)])
            room = rng.uniform(0, 1, (2, 3)) * rng.choice([0.0, 1.0], (2, 3))
            target = plant.end_point(plant.rest(z[0], z[1:], plant.parameter_values), z[0], plant.parameter_values)
            bounds = {"lower": z - room[0], "upper": z + room[1], "sine_squared_min": 1e-8}
            problem = excavator.problem(target.full().ravel(), **bounds)
            assert excavator.solve(problem, z, excavator.options(starts=0, budget=1)).feasible


def changed(name: str, value: Any, index: int | None = None) -> Any:
    def change(problem: Any, options: Any, start: list[float]) -> None:
        which, _, field = name.partition(".")
        owner = {"start": start, "problem": problem, "options": options}[which]
        if owner is start:
            start[index or 0] = value
        elif index is None:
            setattr(owner, field, value)
        else:
            getattr(owner, field)[index] = value

    return change


BAD = [
    ("NOT_FINITE", changed("problem.target", math.nan, 1)),
    ("NOT_FINITE", changed("problem.target", math.inf, 0)),
    ("NOT_FINITE", changed("problem.lower", -math.inf, 0)),
    ("NOT_FINITE", changed("problem.weights", math.nan, 2)),
    ("NOT_FINITE", changed("problem.parameters", math.inf, 3)),
    ("NOT_FINITE", changed("problem.sine_squared_min", math.nan)),
    ("NOT_FINITE", changed("options.tolerance", math.nan)),
    ("NOT_FINITE", changed("start", math.nan, 1)),
    ("OUT_OF_RANGE", changed("problem.target", 2e6, 1)),
    ("OUT_OF_RANGE", changed("problem.lower", 5e5, 0)),
    ("OUT_OF_RANGE", changed("problem.upper", 2e6, 0)),
    ("OUT_OF_RANGE", changed("problem.weights", -1.0, 0)),
    ("OUT_OF_RANGE", changed("problem.parameters", -1.0, 3)),
    ("OUT_OF_RANGE", changed("problem.sine_squared_min", 0.0)),
    ("OUT_OF_RANGE", changed("problem.sine_squared_min", 1.0)),
    ("OUT_OF_RANGE", changed("options.tolerance", 0.0)),
    ("OUT_OF_RANGE", changed("options.budget", 0)),
    ("OUT_OF_RANGE", changed("options.budget", 2_000_000)),
    ("OUT_OF_RANGE", changed("options.starts", -1)),
    ("OUT_OF_RANGE", changed("options.starts", 1000)),
]


@pytest.mark.parametrize(("status", "change"), BAD)
def test_bad_input_is_refused_and_the_result_left_alone(excavator, status, change):
    problem, options, start = excavator.problem(TARGET), excavator.options(), [0.0, 0.3, -1.0]
    problem.upper[0] = 1e5
    change(problem, options, start)
    answer = excavator.solve(problem, start, options, excavator.Result(value=7.0, cost=11))
    assert answer.status == status
    assert (answer.value, answer.cost) == (7.0, 11)


def test_all_weights_zero_are_refused(excavator):
    assert excavator.solve(excavator.problem(TARGET, weights=(0.0, 0.0, 0.0))).status == "OUT_OF_RANGE"


def test_what_the_workspace_held_before_does_not_matter(machine, excavator):
    pair = draw_pairs(machine, "inverse", 1, seed=13)[0]
    problem, answers = problem_of(excavator, pair.problem), []
    for byte in (0x00, 0xFF, 0x7F):
        for k in range(len(excavator.workspace)):
            excavator.workspace[k] = byte - 256 if byte > 127 else byte
        answers.append(excavator.solve(problem, pair.start))
    assert all(np.array_equal(answer.z, answers[0].z) for answer in answers)
    assert len({answer.cost for answer in answers}) == 1


@pytest.mark.long("gcc-c99-False", "gcc-c99-True", "clang-c99-False")
@pytest.mark.parametrize(
    ("compiler", "standard", "in_space"),
    [
        ("gcc", "c99", False),
        ("gcc", "c11", False),
        ("clang", "c99", False),
        ("clang", "c11", False),
        ("gcc", "c99", True),
    ],
)
def test_compiles_without_a_warning(three_joints, tmp_path, compiler, standard, in_space):
    """Optimised: some warnings come only then, and do not depend on the standard."""
    if shutil.which(compiler) is None:
        pytest.skip(f"needs {compiler}")
    sources = sources_of(flexopt.load("slewing-excavator") if in_space else three_joints, baked=not in_space)
    (tmp_path / "optimiser.c").write_text(c_text(sources, "double"))
    flags = [f"-std={standard}", *WARNINGS[1:]]
    level = "-O1" if standard == "c99" else "-fsyntax-only"
    done = subprocess.run(
        [compiler, *flags, level, "-c", "optimiser.c"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[:2000]


@pytest.mark.parametrize("names", [("h", "budget", "stalled"), ("n_z", "a b", "a_b"), ("while", "NULL", "x")])
def test_joints_may_have_any_names(three_joints, names, tmp_path):
    """Those of the header itself, names that C spells alike, words of C: each variable keeps an index of its own."""
    data = three_joints.to_dict()
    links = [link | {"name": name} for link, name in zip(data["links"], names, strict=True)]
    sources = sources_of(flexopt.machine_from_dict(data | {"links": links}))
    indices = re.search(r"(?s)Index of each variable.*?enum \{(.*?)\}", sources.header)[1]
    words = re.findall(r"CASE_OPTIMISER_\w+", indices)
    assert len(words) == 4
    asserted = "".join(f"typedef char index_{k}[({word} == {k}) ? 1 : -1];\n" for k, word in enumerate(words))
    (tmp_path / "optimiser.c").write_text(c_text(sources, "double") + asserted)
    subprocess.run(["gcc", *WARNINGS, "-fsyntax-only", str(tmp_path / "optimiser.c")], check=True)


@pytest.mark.long
@pytest.mark.parametrize(("name", "real"), [("excavator", "double"), ("slewing-excavator", "float")])
def test_the_search_is_plain_c_that_tools_can_read(name, real, tmp_path):
    """Every file compiles by itself with the generated configuration; bundles hold the same text in one file."""
    sources = sources_of(flexopt.load(name), real=real)
    package = Path(flexopt.__file__).parent / "export" / "optimiser_c"
    guard = '#ifndef OPTIMISER_CONFIG_H\n#define OPTIMISER_CONFIG_H\n\n#include "optimiser.h"\n'
    (tmp_path / "optimiser_config.h").write_text(f"{guard}{sources.configuration}\n#endif\n")
    (tmp_path / "optimiser.h").write_text(header_of(sources, real))
    (tmp_path / "whole.c").write_text(f"{header_of(sources, real)}\n{sources.source}")
    assert {path.name for path in package.iterdir()} == set(SEARCH)
    included = re.findall(r'define (?:SECOND_DERIVATIVES|STARTS_FROM) "(.*)"', sources.configuration)
    variants = {"optimiser_exact.h", "optimiser_differences.h", "optimiser_closed_form.h", "optimiser_sampled.h"}
    for file in sorted(set(SEARCH) - (variants - set(included))):
        # What a header alone does not use, others do.
        alone = ["gcc", "-x", "c", *WARNINGS, "-Wno-unused-function", "-fsyntax-only", "-I.", str(package / file)]
        subprocess.run(alone, cwd=tmp_path, check=True)
    defined = []
    for file in (str(package / "optimiser.c"), "whole.c"):
        subprocess.run(["gcc", *WARNINGS, "-O0", "-I.", "-c", file, "-o", "file.o"], cwd=tmp_path, check=True)
        defined.append(
            subprocess.run(["objdump", "-d", "file.o"], cwd=tmp_path, check=True, capture_output=True).stdout
        )
    assert defined[0] == defined[1]


@pytest.mark.long
def test_single_precision(machine, tmp_path):
    """On the target to 32 roundings of the reach times the largest angle, 36 µm; V within 1e-5 of the scale of IPOPT's."""
    lib = library(machine, tmp_path, real="float")
    for pair in draw_pairs(machine, "inverse", 20, seed=14):
        answer = lib.solve(problem_of(lib, pair.problem), pair.start)
        assert answer.feasible
        v, error = value_of(pair.problem, answer.z)
        assert error <= 5e-5
        assert v >= pair.ipopt - 1e-5 * pair.problem.objective_scale


def test_the_same_call_writes_the_same_text(machine):
    first, second = (sources_of.__wrapped__(machine) for _ in range(2))
    assert (first.header, first.source) == (second.header, second.source)


def test_the_last_target_drawn_counts(machine, monkeypatch):
    monkeypatch.setattr(optimiser_part, "DRAWS_MAX", 1)
    context = build_context(machine, control="inverse", gain=1.0, single=False, baked=False, singularity_margin_deg=1.0)
    assert len(optimiser_part.optimiser(context, "case", "double").vectors(1, 3)) == 1
