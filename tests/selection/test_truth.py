"""Mixed and ordered objectives beside a scan that shares nothing with the solvers: `benchmarks.selection_truth`, shortly."""

import dataclasses
import math

import numpy as np
import pytest

import flexopt
from benchmarks.selection_truth import cases, examined, machines, scanned
from flexopt.model import tree_from_dict
from flexopt.selection import optima
from flexopt.selection.nlp.program import single
from flexopt.selection.problem import value_at
from flexopt.selection.proof import check
from flexopt.selection.seen import better_than, seen_values, settled
from tests.cli.command import Command
from tests.oracles.spatial import random_tree

TARGET = (0.0, 1.6)
# Of the objective's scale: what a scan may be better by.
BAR = 1e-7


@pytest.fixture(scope="module")
def machine():
    return flexopt.load("excavator")


@pytest.mark.long
@pytest.mark.parametrize("seed", [6])
def test_never_below_a_scan_of_its_own(seed):
    rows = examined(2000, 1, next(iter(machines([seed]))), ("inverse",))
    assert len(rows) == len(list(cases(2, 1.0)))
    for *what, off, _, failure in rows:
        assert not failure, (what, failure)
        assert off <= BAR, what


@pytest.mark.long
def test_the_scan_tells_where_a_selection_falls_short(machine):
    """With a single start the selection stays on a lower hill; the guard takes the scan's best for a start."""
    scan = scanned(machine, np.array(TARGET), "inverse", 4000, 0)
    problem = flexopt.build_selection(machine, TARGET, objective="epsilon_max")
    poor = dataclasses.replace(problem, starts=1)
    values = seen_values(poor)
    assert better_than(poor, float(values.max()) - 1e-3, values) is not None
    assert better_than(poor, float(values.max()) + 1e-3, values) is None
    worst = np.vstack([problem.scan.base, problem.scan.posture])[:, values.argmin()]
    _, (found, attempts, _) = optima.first_optima(poor, [worst], 1, None)
    assert max(value_at(poor, z) for z, _, _ in found) >= max(values.max(), scan.epsilon.max()) - BAR
    assert len(attempts) > 1


@pytest.mark.parametrize(
    ("seed", "rows", "passive", "posture"),
    [
        (21, ("x", "y", "z"), 3, (0.1693552473135489, 0.33568190465348025, -0.6574434033244657)),
        (28, ("x", "z"), 3, (0.6158287265229816, 0.42513364249210506)),
        (52, ("x", "z"), 2, (0.11876207301646713, 0.031269726703885725)),
    ],
)
def test_a_few_postures_alone_reach_a_target(seed, rows, passive, posture):
    """V is so steep across the target that it is more a nanometre beside it: that is no better configuration seen."""
    data = random_tree(seed, rows=rows, counts=(passive, len(rows)))
    tree = tree_from_dict(data | {"placement": []})
    target = flexopt.evaluate(tree, posture).end_point
    found = flexopt.select(tree, target, starts=3, singularity_margin_deg=1.0, workers=1)
    each = [flexopt.evaluate(tree, other).w[0] for other in flexopt.inverse_kinematics(tree, target)]
    assert found.best.objective == pytest.approx(max(each), rel=1e-6)


def test_a_climb_that_ends_a_little_below_is_followed(machine):
    """Climbs at random end below their tops: one below the best optimum may lie on a higher hill."""
    problem = flexopt.build_selection(machine, TARGET, objective="epsilon_max")
    z, values = np.vstack([problem.scan.base, problem.scan.posture]), seen_values(problem)
    _, (found, attempts, _) = optima.first_optima(problem, [z[:, values.argmax()]], 1, None)
    high = max(found, key=lambda item: value_at(problem, item[0]))
    near = np.abs((z - high[0][:, None]) / problem.scale[:, None]).max(axis=0)
    point = z[:, np.where(near > 0.05, near, np.inf).argmin()]
    short = (value_at(problem, high[0]) - value_at(problem, point)) / problem.objective_scale
    assert short > 1e-5
    # As if the point, which is no optimum, were the only one known: it is not better than that, but as good.
    known = [(point, *high[1:])]
    assert optima._higher(problem, known, attempts, [point], 1)[0] == known
    more, tried, _ = optima._higher(problem, known, attempts, [point], 1, optima.BELOW)
    assert len(tried) == len(attempts) + 1
    assert value_at(problem, more[-1][0]) == pytest.approx(value_at(problem, high[0]), abs=1e-9)


def test_a_better_point_that_leads_nowhere_is_an_error(machine, monkeypatch):
    problem = flexopt.build_selection(machine, TARGET)
    monkeypatch.setattr(optima, "seen_values", lambda problem: np.full(problem.scan.size, 1.0))
    monkeypatch.setattr(optima, "better_than", lambda problem, value, values: problem.wrapped(np.zeros(3)))
    with pytest.raises(flexopt.NoSolutionFound, match="of a configuration that was seen"):
        flexopt.solve_selection(problem)


@pytest.mark.long
def test_an_end_that_could_not_be_verified_is_told(machine, monkeypatch):
    problem = flexopt.build_selection(machine, TARGET, objective="epsilon_max")
    whole = flexopt.solve_selection(problem)
    assert whole.unverified is None
    high, low = whole.best.objective, whole.candidates[-1].objective
    assert low < high - 1e-6

    def doubted(program, z):
        proof = check.prove_program(program, z)
        violations = {"second-order optimality": 1.0} if value_at(program.first, z) > low + 1e-9 else {}
        return dataclasses.replace(proof, violations=proof.violations | violations)

    monkeypatch.setattr(optima, "prove_program", doubted)
    monkeypatch.setattr(optima, "prove", lambda problem, z: doubted(single(problem), z))
    monkeypatch.setattr(optima, "polished", lambda program, x, proof: (x, proof))
    monkeypatch.setattr(optima, "seen_values", lambda problem: np.full(problem.scan.size, -np.inf))
    selection = flexopt.solve_selection(problem, workers=1)
    assert selection.best.objective == pytest.approx(low, abs=1e-9)
    assert selection.unverified == pytest.approx(high, abs=1e-9)
    assert selection.to_dict()["unverified"] == selection.unverified
    assert f"could not be verified came to epsilon_max {high:.6g}" in repr(selection)
    ordered = flexopt.build_selection(machine, TARGET, objective="epsilon_max,w1")
    (kept,) = flexopt.solve_selection(ordered, workers=1).kept
    assert kept.unverified == pytest.approx(high, abs=1e-9)
    assert f"came to epsilon_max {high:.6g}" in str(kept)


def test_points_are_moved_onto_the_rows_under_gravity(machine):
    problem = flexopt.build_selection(machine, TARGET, gravity=True)
    z = np.append(problem.scan.base[:, 100], problem.scan.posture[:, 100])
    # A scan's points reach the target as the machine sags, to the rounds in which the arm is held.
    assert np.abs(problem.rows(z)[:2] - problem.target).max() < 1e-6
    z[1:] += 0.01
    assert np.abs(problem.rows(z)[:2] - problem.target).max() > 1e-3
    there = settled(problem, z)
    assert np.abs(problem.rows(there)[:2] - problem.target).max() < 1e-8


@pytest.mark.long("epsilon_max,w1-0.001", "epsilon_max,w1-None")
@pytest.mark.parametrize(("objective", "slack"), [("epsilon_max,w1", None), ("epsilon_max,w1", 1e-3), ("w1,w2", 1e-4)])
def test_the_slack_is_a_share_of_the_value_and_stated(machine, objective, slack):
    share = {} if slack is None else {"slack": slack}
    selection = flexopt.select(machine, TARGET, objective=objective, workers=1, **share)
    (kept,) = selection.kept
    first, size = selection.problem.objectives[0], selection.problem.objective_scales[0]
    allowed = (slack or 1e-5) * max(abs(kept.best), size - first.beta)
    assert math.isclose(kept.best - kept.at_least, allowed, rel_tol=1e-9)
    unit = " 1/(kg m2)" if kept.objective == "w1" else ""
    assert f"{kept.objective} kept: at least {kept.at_least:.6g}{unit}, " in repr(selection)
    assert selection.to_dict()["kept"] == [vars(kept) | {"at_most": None}]
    for candidate in selection.candidates:
        value = first.value(candidate.w, candidate.evaluation.epsilon_max)
        assert value >= kept.at_least - 1e-8 * size


@pytest.mark.long
def test_the_slack_decides_between_good_optima(machine):
    """The best maxima of ε_max are 4e-5 of it apart: only a slack above that lets the second objective choose."""
    fine, coarse = (
        flexopt.select(machine, TARGET, objective="epsilon_max,w1", slack=s, workers=1) for s in (1e-5, 1e-3)
    )
    assert coarse.best.w[0] > fine.best.w[0]
    assert fine.best.evaluation.epsilon_max > coarse.best.evaluation.epsilon_max


@pytest.mark.long
def test_the_slack_in_a_file_and_on_the_command_line(tmp_path, capsys):
    text = f"""
schema = 1
name = "ordered"
machine = "excavator"
[target]
end_point = {list(TARGET)}
[selection]
objective = "w1,w2"
slack = 1e-3
"""
    path = tmp_path / "ordered.toml"
    path.write_text(text, encoding="utf-8")
    assert flexopt.load_problem(path).select_arguments()["slack"] == 1e-3
    command = Command(capsys, tmp_path)
    for given, slack in (([], 1e-3), (["--slack", "2e-3"], 2e-3)):
        document = command("select", str(path), "--json", *given).document
        assert document["problem"]["slack"] == slack
    assert document["kept"][0]["best"] > document["kept"][0]["at_least"]


@pytest.mark.parametrize("slack", [0.0, -1e-3, 2.0, float("nan"), "much", True])
def test_a_slack_out_of_range_is_named(machine, slack):
    with pytest.raises(flexopt.InputError, match="slack"):
        flexopt.build_selection(machine, TARGET, slack=slack)
