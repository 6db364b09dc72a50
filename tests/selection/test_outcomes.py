"""Configurations chosen by what the loop does: its decay, with gains and in the worst case."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import differential_evolution

import flexopt
from benchmarks.codesign import KP, KV, decay
from flexopt.loop.settings import loop_settings
from flexopt.loop.uncertain import UncertainLoop
from flexopt.loop.uncertainty_box import UncertaintyBox
from flexopt.model import machine_from_dict, tree_from_dict
from flexopt.model.loop import Loop
from flexopt.selection.outcomes.choice import climbs, distinct_optima
from flexopt.selection.outcomes.climb import first_order
from flexopt.selection.outcomes.measures import MEASURES
from flexopt.selection.outcomes.program import OutcomeProgram, worst_of
from flexopt.selection.outcomes.result import OutcomeSelection
from flexopt.selection.places import FEASIBLE
from flexopt.selection.starts import moved
from tests.cli.command import Command
from tests.oracles.spatial import in_space

EXCAVATOR, TARGET = flexopt.load("excavator"), (0.0, 1.6)
FIXED = {"kp": 1e4, "kv": 1e3}
RANGED = {"kp_range": KP, "kv_range": KV}
# Starts: enough for these basins, which are wide.
FEW = 6


def chosen(objective: str = "decay", **options: Any) -> OutcomeSelection:
    """Once for tests that ask the same."""
    return _chosen(objective, json.dumps(options, sort_keys=True))


@cache
def _chosen(objective: str, options: str) -> OutcomeSelection:
    found = flexopt.select(EXCAVATOR, TARGET, objective=objective, **json.loads(options))
    assert isinstance(found, OutcomeSelection)
    return found


@pytest.mark.long
def test_a_base_that_the_task_does_not_see_stays_where_it_is() -> None:
    """Of a task of the height alone placements are all alike: each posture is one optimum, held from where it stands."""
    data = in_space(EXCAVATOR.model_dump(by_alias=True))
    data["end_point"]["rows"] = ["z"]
    loop = FIXED | {"nullspace_damping": 3e3, "drive": "torque"}
    options: dict[str, Any] = {"base": 0.7, "posture": (0.9929, -2.6306), "objective": "decay", "loop": loop}
    found = flexopt.select(tree_from_dict(data), (1.6,), **options, starts=FEW)
    postures = np.array([each.evaluation.posture for each in found.candidates])
    assert [each.evaluation.base[0] for each in found.candidates] == [0.7] * len(postures)
    apart = np.abs(postures[:, None] - postures).max(axis=2)[~np.eye(len(postures), dtype=bool)]
    assert apart.min(initial=1.0) > 1e-2
    # As many climbs ended as were begun: those that ended at the same posture elsewhere are no optima of their own.
    assert len(postures) < len(found.attempts)


@pytest.mark.long
def test_the_curve_behind_a_worst_case_is_the_worst_case() -> None:
    """What a picture shows along the redundancy beside members of its own, drawn at random: they know little worse."""
    ranges = [{"of": f"base.stiffness.{name}", "factor": (0.5, 2.0)} for name in ("x", "y", "rotation")]
    ranges += [{"of": "damping", "factor": (0.3, 2.0)}, {"of": "dead_time", "value": (0.0, 0.02)}]
    found = flexopt.select(EXCAVATOR, TARGET, base=0.0, objective="decay", loop=FIXED, ranges=ranges, starts=FEW)
    assert isinstance(found, OutcomeSelection)
    along = found.along_redundancy()
    assert along is not None
    scan, settings = found.problem.scan, found.settings[0]
    box = UncertaintyBox(EXCAVATOR, found.uncertainty, settings.dead_time)
    drawn, size = np.random.default_rng(0).random((256, len(ranges))), np.ptp(along[np.isfinite(along)])
    for k in range(0, scan.size, scan.size // 9):
        loop = UncertainLoop(settings, scan.base[:, k], scan.posture[:, k], False, box)
        # Of the curve's height; the members were sought at some points alone.
        assert along[k] <= loop.decays(drawn).min() + 1e-3 * size
    best = found.best
    at = int(np.argmin(np.linalg.norm(scan.z - best.z[:, None], axis=0)))
    assert along[at] == pytest.approx(best.objective, abs=1e-3 * size)


@pytest.mark.long
def test_the_best_decay_of_given_gains_is_that_of_a_scan() -> None:
    """Placements along both elbows, 1,001 each; gains of the article's loop with 20 ms of dead time."""
    found = chosen(loop=FIXED | {"dead_time": 0.02}, starts=FEW)
    scan = max(
        decay(x, elbow, 1e4, 1e3, 0.02, worst=False) for elbow in ("up", "down") for x in np.linspace(-3.4, 3.4, 1001)
    )
    # The scan steps over the peak's tip.
    assert found.best.objective == pytest.approx(scan, rel=1e-2)
    assert found.best.objective >= scan - 1e-9
    assert found.best.target_error < 1e-8
    assert "objective decay" in found.plot().get_suptitle()
    assert found.best.stationarity < 1e-4
    outcome = found.best.evaluation.outcome
    assert isinstance(outcome, flexopt.Outcome)
    assert outcome.decay == pytest.approx(found.best.objective)
    # What is said of the choice, on a report's page too, is said of the loop's measure.
    doubted = replace(found, unverified=1.5)
    assert doubted.remarks[0].startswith("a climb that could not be verified came to decay 1.5;")
    assert f"  {doubted.remarks[0]}\n" in f"{doubted!r}\n"


@pytest.mark.long
def test_the_present_configuration_is_worth_its_worst_where_candidates_are() -> None:
    """By the slowest decay on a grid of the box: in one column no number is of one ground alone."""
    ranges = {"stiffness": (0.5, 2.0), "damping": (0.7, 1.5)}
    found = chosen(loop=FIXED, base=0.0, posture=[0.9929, -2.6306], ranges=ranges, starts=2)
    fixed, worst = found.settings[0].fixed, math.inf
    for soft, damped in itertools.product(np.linspace(0.5, 2.0, 9), np.linspace(0.7, 1.5, 5)):
        data = EXCAVATOR.to_dict()
        for table, factor in (("stiffness", soft), ("damping", damped)):
            data["base"][table] = {name: factor * value for name, value in data["base"][table].items()}
        machine = flexopt.machine_from_dict(data)
        worst = min(worst, flexopt.outcome(machine, [0.9929, -2.6306], base=0.0, loop=fixed).decay)
    assert found.present is not None
    assert worst * (1 + 1e-2 * np.sign(-worst)) <= found.present <= worst + 1e-9
    assert "own numbers" not in repr(found)


def test_there_is_something_to_gain_where_the_present_configuration_is_elsewhere() -> None:
    """A loop that decays faster than any at the target, held 3 m away from it."""
    posture = [-1.899, -1.828]
    away = chosen(loop=FIXED, base=0.0, posture=posture, starts=2)
    assert away.present is not None
    assert away.present > away.best.objective
    assert "not at the target" in away.present_told
    assert away.nothing_to_gain == ""
    there = flexopt.evaluate(EXCAVATOR, away.best.evaluation.posture, base=away.best.evaluation.base)
    told = "the search found nothing as good as the present configuration, which has more "
    assert replace(away, initial=there).nothing_to_gain.startswith(told)
    alike = replace(away, initial=there, present=away.best.objective)
    assert alike.nothing_to_gain.startswith("nothing to gain: the present configuration has as much ")


@pytest.mark.long
def test_gains_are_chosen_with_the_configuration() -> None:
    """Not worse than an evolution strategy about the best zone, and what is said is what the loop does."""
    found = chosen(loop=RANGED | {"dead_time": 0.02}, starts=2 * FEW)
    gains = found.gains[0]
    base = float(found.best.evaluation.base[0])
    other: Any = differential_evolution(
        lambda x: -decay(x[0], "down", math.exp(x[1]), math.exp(x[2]), 0.02, worst=False),
        [(base - 0.4, base + 0.4), tuple(np.log(KP)), tuple(np.log(KV))], maxiter=12, popsize=6, rng=3, polish=False,
    )  # fmt: skip
    assert found.best.objective >= -0.99 * float(other.fun)
    again = flexopt.outcome(
        EXCAVATOR, found.best.evaluation.posture, base=found.best.evaluation.base, loop=gains | {"dead_time": 0.02}
    )
    assert again.decay == pytest.approx(found.best.objective, rel=1e-6)
    # Several times as fast as any posture at the article's gains, and much more fragile.
    assert found.best.objective > 5 * chosen(loop=FIXED | {"dead_time": 0.02}, starts=FEW).best.objective
    assert found.radii[0] < 1.5


@pytest.mark.long
def test_the_worst_case_is_no_better_anywhere_in_its_box() -> None:
    ranges = {"stiffness": (0.5, 2.0), "dead_time": (0.0, 0.01)}
    found = chosen(loop=FIXED, ranges=ranges, starts=FEW)
    nominal = chosen(loop=FIXED, starts=FEW)
    assert 0 < found.best.objective < nominal.best.objective
    e = found.best.evaluation
    region = flexopt.stable_region(EXCAVATOR, e.posture, base=e.base, loop=FIXED, ranges=ranges, points=200)
    assert region.decay == pytest.approx(found.best.objective, rel=2e-3)
    before = nominal.best.evaluation
    assert region.decay >= (
        flexopt.stable_region(EXCAVATOR, before.posture, base=before.base, loop=FIXED, ranges=ranges).decay - 1e-9
    )


@pytest.mark.long
def test_what_the_machine_says_is_uncertain_counts() -> None:
    soil = {"of": "stiffness", "factor": [0.5, 2.0]}
    doubtful = machine_from_dict(EXCAVATOR.to_dict() | {"uncertainty": [soil]})
    asked: dict[str, Any] = {"objective": "decay", "loop": FIXED, "base": 0.0, "starts": 2, "workers": 1}
    of_file = flexopt.select(doubtful, TARGET, **asked)
    given = flexopt.select(EXCAVATOR, TARGET, ranges=[soil], **asked)
    nominal = flexopt.select(EXCAVATOR, TARGET, **asked)
    assert isinstance(of_file, OutcomeSelection)
    assert "objective decay, worst over stiffness" in repr(of_file)
    assert of_file.best.objective == pytest.approx(given.best.objective, rel=1e-9)
    assert of_file.best.objective < 0.99 * nominal.best.objective
    # What was sought, not the w_i whose starts it takes.
    document = of_file.to_dict()
    assert [each["factor"] for each in document["uncertainty"]] == [[0.5, 2.0]]
    assert (document["problem"]["objective"], document["problem"]["weights"]) == ("decay", None)
    assert [each["name"] for each in document["problem"]["objectives"]] == ["decay"]


@pytest.mark.long
def test_a_radius_is_of_all_springs_whatever_else_is_uncertain() -> None:
    load = {"of": "payload.mass", "value": [0.0, 50.0]}
    doubtful = machine_from_dict(EXCAVATOR.to_dict() | {"uncertainty": [load]})
    asked: dict[str, Any] = {"objective": "radius", "loop": FIXED, "base": 0.0, "starts": 2, "workers": 1}
    found = [flexopt.select(machine, TARGET, **asked).best.objective for machine in (doubtful, EXCAVATOR)]
    assert found[0] == pytest.approx(found[1], rel=1e-9)


@pytest.mark.parametrize(
    ("name", "gains"),
    [
        ("excavator", FIXED),
        ("slewing-excavator", {"kp": 3e6, "kv": 6e5}),
        ("boom-stick-bucket", {"kp": 1e6, "kv": 2e5}),
    ],
)
def test_slopes_at_points_that_are_no_optimum(
    name: str, gains: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of every branch and row, by everything that varies, beside differences of second order."""
    machine = flexopt.load(name)
    target = {"excavator": (0.0, 1.6), "slewing-excavator": (6.0, 2.0, 1.0), "boom-stick-bucket": (4.0, 1.0)}[name]
    problem = flexopt.build_selection(machine, target)
    n_base = len(machine.base_coordinates)
    k = int(np.flatnonzero(problem.scan.violation <= FEASIBLE)[5])
    z = np.concatenate([problem.scan.base[:, k], problem.scan.posture[:, k]])
    z, left = moved(problem, z[:, None], 1)
    assert left[0] <= FEASIBLE
    stand = flexopt.evaluate(machine, z[n_base:, 0], base=z[:n_base, 0])
    settings = loop_settings(machine, Loop(control="inverse", dead_time=0.0071, **gains), stand)
    loop = UncertainLoop(settings, stand.base, stand.posture, False, UncertaintyBox(machine, (), 0.0071))
    ranges = {"kp": (1.0, 1e8), "kv": (1.0, 1e8)}
    program = OutcomeProgram(problem, loop, ranges, np.zeros((0, 0)), 0.1)
    y = np.append(z[:, 0] / problem.scale, np.log([gains["kp"], gains["kv"]]))
    level = program.level(program.value(y))
    found, rows = program.branches(y, level), program.row_slopes(y)
    step = 1e-5
    for i, way in enumerate(np.eye(y.size) * step):
        up, down = program.branches(y + way, level), program.branches(y - way, level)
        count = min(len(up.values), len(down.values), len(found.values))
        central = (up.values[:count] - down.values[:count]) / (2 * step)
        # At a step of 1e-5 differences keep some six digits of what varies on this scale.
        size = 1e-5 * max(1.0, float(np.abs(found.slopes).max()))
        np.testing.assert_allclose(found.slopes[:count, i], central, rtol=1e-5, atol=size)
        changed = (program.rows(y + way) - program.rows(y - way)) / (2 * step)
        np.testing.assert_allclose(rows[:, i], changed, rtol=1e-6, atol=1e-6)
    assert 0 < first_order(program, y, program.value(y))[0] < math.inf
    # What has no slope, as where two multipliers meet, proves nothing.
    unknown = replace(found, slopes=np.full_like(found.slopes, np.nan))
    monkeypatch.setattr(OutcomeProgram, "branches", lambda *_: unknown)
    assert first_order(program, y, program.value(y))[0] == math.inf
    # Nor does a least branch that no level moves, where the point does not reach the level.
    stuck = replace(found, values=np.append(-0.2, found.values[1:]), by_level=np.append(0.0, found.by_level[1:]))
    monkeypatch.setattr(OutcomeProgram, "branches", lambda *_: stuck)
    assert first_order(program, y, program.value(y))[0] == math.inf


@pytest.mark.long("truck-crane")
@pytest.mark.parametrize("name", ["excavator", "truck-crane"])
def test_under_gravity_the_target_is_reached(name: str) -> None:
    target = {"excavator": (0.0, 1.6), "truck-crane": (4.75, 1.47, 4.14)}[name]
    found = flexopt.select(flexopt.load(name), target, objective="decay", gravity=True, starts=1)
    assert all(candidate.target_error < 1e-8 for candidate in found.candidates)
    e = found.best.evaluation
    assert e.end_point == pytest.approx(target, abs=1e-8)


@pytest.mark.long
def test_what_does_not_go_together() -> None:
    for options, sentence in (
        ({"objective": "decay", "weights": [1, 0, 0]}, "weights"),
        ({"objective": "w1", "loop": FIXED}, "goes with an objective of the loop"),
        ({"objective": "decay,speed"}, "must be w1"),
        ({"objective": "w_1, decy"}, "did you mean 'w1'.; did you mean 'decay'.$"),
        ({"objective": "nothing at all"}, "separated by commas$"),
        ({"objective": "decay", "control": "inverse", "loop": {"control": "transpose"}}, "control that is asked for"),
    ):
        with pytest.raises(flexopt.InputError, match=sentence):
            flexopt.select(EXCAVATOR, TARGET, **options)  # type: ignore[arg-type]
    with pytest.raises(flexopt.InputError, match="it wants a loop"):
        flexopt.build_selection(EXCAVATOR, TARGET, objective="decay")
    with pytest.raises(flexopt.InputError, match="no bound over whole cells"):
        flexopt.certify(chosen(loop=FIXED, starts=FEW))


@pytest.mark.long
def test_a_verdict_on_it_has_the_gains_that_were_chosen() -> None:
    loop = RANGED | {"dead_time": 0.02}
    found = chosen(loop=loop, base=0.0, starts=2 * FEW)
    judged = flexopt.verdict(found, loop=loop, ranges={"stiffness": (0.99, 1.01)}, runs=0)
    assert judged.settings.kp == pytest.approx([found.gains[0]["kp"]] * 2)
    assert judged.word in {"move", "change gains"}


@pytest.mark.long
def test_a_problem_file_and_the_command(tmp_path: Any, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.chdir(tmp_path)
    text = "\n".join([
        'name = "own"', 'machine = "excavator"', "[target]", "end_point = [0.0, 1.6]", "[selection]",
        'objective = "decay"', "starts = 2", "base = 0.0", "[loop]", "kp = 1e4", "kv = 1e3", "dead_time = 0.02",
    ])  # fmt: skip
    (tmp_path / "own.toml").write_text(text, encoding="utf-8")
    found = flexopt.solve_problem(flexopt.load_problem("own.toml"))
    assert isinstance(found, OutcomeSelection)
    assert found.best.objective > 0
    command = Command(capsys, tmp_path)
    shown = command("select", "own.toml")
    assert "objective decay" in shown.stdout
    assert "verdict: MOVE" in shown.stdout
    document = command("select", "own.toml", "--json").document
    assert document["measure"] == "decay"
    assert document["best"]["outcome"]["decay"] == pytest.approx(found.best.objective)
    words = ("--loop", "kp=1e4", "--loop", "kv=1e3", "--loop", "dead_time=0.02", "--starts", "2", "--json")
    same = command("select", "article", "--objective", "decay", *words).document
    assert same["best"]["objective"] == pytest.approx(found.best.objective, rel=1e-9)


@pytest.mark.long("delay_margin-50.0", "allowed_gain-200.0")
@pytest.mark.parametrize(("objective", "gain"), [("allowed_gain", 200.0), ("delay_margin", 50.0)])
def test_the_worst_of_a_gain_and_of_a_margin_is_that_of_the_verdict(objective: str, gain: float) -> None:
    """Of the same place; and no member drawn at random knows a worse one."""
    ground = [{"of": f"base.stiffness.{name}", "factor": (0.5, 2.0)} for name in ("x", "y", "rotation")]
    ground += [{"of": "damping", "factor": (0.3, 2.0)}, {"of": "dead_time", "value": (0.0, 0.02)}]
    posture, gains = (0.9929, -2.6306), {"kp": gain, "kv": 0.2 * gain}
    options: dict[str, Any] = {"base": 0.0, "posture": posture, "ranges": ground, "loop": gains}
    told = flexopt.verdict(EXCAVATOR, TARGET, runs=0, starts=1, **options)
    box = UncertaintyBox(EXCAVATOR, told.uncertainty, told.settings.dead_time)
    loop = UncertainLoop(told.settings, np.zeros(1), np.array(posture), False, box)
    worst, where = worst_of(loop, MEASURES[objective])
    assert worst == pytest.approx(getattr(told.places[0], objective).least, rel=1e-6)
    assert worst == pytest.approx(getattr(loop.outcome(where), objective)().value, rel=1e-9)
    drawn = np.random.default_rng(0).random((60, len(ground)))
    assert worst <= min(getattr(loop.outcome(u), objective)().value for u in drawn)


def test_no_joint_is_held_whole_turns_away() -> None:
    """A climb may wind joints without limits; what is told is within half a turn of 0, and as good."""
    asked: dict[str, Any] = {"objective": "decay", "loop": {"kp": 1e4, "kv": 1e3}, "workers": 1}
    found = flexopt.select(EXCAVATOR, (0.0, 1.6), base=1.3, constraints={"region": [(-1.75, -1.649999999)]}, **asked)
    assert isinstance(found, OutcomeSelection)
    program = OutcomeProgram(**found.asked.parts(found.problem, found.best.evaluation))
    start = found.best.z / found.problem.scale
    # Where a climb begins two turns away it ends there, too.
    far = start + np.array([0.0, 2 * math.tau, -math.tau])
    (end,) = climbs(program, [far], 1, None)
    assert np.abs(end.y[1:]).max() <= math.pi
    assert end.value == pytest.approx(found.best.objective, rel=1e-6)
    assert np.abs([candidate.z[1:] for candidate in found.candidates]).max() <= math.pi


@pytest.mark.long
def test_the_present_configuration_is_climbed_from() -> None:
    """A choice from where its own optimum stands has no less than that."""
    options: dict[str, Any] = {"objective": "decay", "loop": FIXED | {"dead_time": 0.02}, "starts": 1}
    best = flexopt.select(EXCAVATOR, TARGET, base=0.0, **options).candidates[-1]
    at = best.evaluation
    again = flexopt.select(EXCAVATOR, TARGET, base=at.base, posture=at.posture, **options)
    assert again.best.objective >= best.objective - 1e-9
    assert any(np.abs(each.z - best.z).max() < 1e-4 for each in again.candidates)


def test_where_no_climb_ends_at_an_optimum_the_best_is_told() -> None:
    """What stopped it, which others of what is uncertain alone may have done where there are some."""
    asked: dict[str, Any] = {"objective": "decay", "loop": FIXED, "starts": 1, "workers": 1}
    found = flexopt.select(EXCAVATOR, TARGET, base=0.0, **asked)
    assert isinstance(found, OutcomeSelection)
    program = OutcomeProgram(**found.asked.parts(found.problem, found.best.evaluation))
    (end,) = climbs(program, [found.best.z / found.problem.scale], 1, None)
    assert end.holds
    ends = (
        (replace(end, stationarity=0.3), "where the gradient is not zero, 3.0e-01", {"first-order optimality": 0.3}),
        (replace(end, stationarity=math.inf), "where it has no slope", {}),
        (replace(end, undone=True), "which others of what is uncertain undo", {}),
    )
    for left, words, short in ends:
        with pytest.raises(flexopt.NoSolutionFound, match=f"the best came to {end.value:.6g}, {words}") as caught:
            distinct_optima(program, [None, left])
        assert caught.value.violations == short


def test_where_no_step_leads_onto_the_constraints_these_are_named() -> None:
    """A margin wider than half the undercarriage, by what the loop does."""
    machine = flexopt.load("boom-stick-bucket")
    span = machine.to_dict()["support"]["span"]
    asked = {"tip_over_margin": 0.52 * (span[1] - span[0])}
    with pytest.raises(flexopt.NoSolutionFound) as caught:
        flexopt.select(
            machine, (7.0, 1.0), base=0.0, posture=(-0.9, -1.2, -0.4), objective="decay", constraints=asked, starts=2
        )
    assert "tip-over margin from x" in str(caught.value)


TELESCOPE_URDF = """
<robot name="telescope">
  <link name="chassis"><inertial><origin xyz="-0.3 0 1.1"/><mass value="15500"/>
    <inertia ixx="14000" iyy="36000" izz="42000" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="boom"><inertial><origin xyz="1.5 0 0.05"/><mass value="480"/>
    <inertia ixx="12" iyy="430" izz="430" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="jib"><inertial><origin xyz="1.2 0 0.1"/><mass value="330"/>
    <inertia ixx="9" iyy="190" izz="190" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="tube"><inertial><origin xyz="-0.4 0 0"/><mass value="240"/>
    <inertia ixx="5" iyy="120" izz="120" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="lift" type="revolute"><parent link="chassis"/><child link="boom"/><origin xyz="0.6 0 2.7"/>
    <axis xyz="0 -1 0"/><limit lower="-0.3" upper="1.3" effort="90000" velocity="0.4"/></joint>
  <joint name="fold" type="revolute"><parent link="boom"/><child link="jib"/><origin xyz="3.2 0 0"/>
    <axis xyz="0 -1 0"/><limit lower="-2.8" upper="-0.2" effort="50000" velocity="0.5"/></joint>
  <joint name="extend" type="prismatic"><parent link="jib"/><child link="tube"/><origin xyz="2.4 0 0"/>
    <axis xyz="1 0 0"/><limit lower="0.0" upper="2.0" effort="20000" velocity="0.3"/></joint>
</robot>
"""
TELESCOPE = """
schema = 1
name = "telescope"
robot = "telescope.urdf"
actuated = ["lift", "fold", "extend"]
placement = ["x"]
[base]
stiffness = { z = 6e6, pitch = 2.4e7 }
damping = { z = 2.5e4, pitch = 9e4 }
[end_point]
link = "tube"
offset = [0.9, 0.0, 0.0]
rows = ["x", "z"]
"""


@pytest.mark.long
def test_what_the_loop_must_do_at_least_loses_no_optimum_that_does_it(tmp_path: Path) -> None:
    """On a kink, where a mode does not move the end-point: slopes of the loop's branches tell nothing there."""
    (tmp_path / "telescope.urdf").write_text(TELESCOPE_URDF, encoding="utf-8")
    (tmp_path / "telescope.toml").write_text(TELESCOPE, encoding="utf-8")
    machine = flexopt.load(tmp_path / "telescope.toml")
    loop = {"drive": "torque", "kp": 2.5e4, "kv": 9e3, "rate": 100.0, "dead_time": 0.03, "nullspace_damping": 2e3}
    few: dict[str, Any] = {"base": 0.0, "objective": "V", "weights": [1, 1], "starts": 6, "workers": 1}
    margin = {"joint_margin": 0.05}
    free = flexopt.select(machine, (4.2, 0.0), constraints=margin, **few)
    assert list(free.best.kinks) == ["kink of w2: a2 = 0"]
    at = free.best.evaluation
    assert flexopt.outcome(machine, at.posture, base=at.base, loop=loop).decay > 0.6
    found = flexopt.select(machine, (4.2, 0.0), constraints=margin | {"outcome": {"decay": 0.5}}, loop=loop, **few)
    assert found.best.objective == pytest.approx(free.best.objective, abs=1e-9 * free.problem.objective_scale)
    np.testing.assert_allclose(found.best.z, free.best.z, atol=1e-6)
    assert found.unverified is None
    # Where it does not do it, the optimum is none.
    other = flexopt.select(machine, (4.2, 0.0), constraints=margin | {"outcome": {"decay": 0.7}}, loop=loop, **few)
    assert np.abs(other.best.z - free.best.z).max() > 1e-2


@pytest.mark.long
def test_a_gain_at_the_foot_of_a_range_from_nothing_is_told_as_the_least_that_is_tried() -> None:
    """It is sought by its logarithm, and so slow a loop with so much dead time is best with none."""
    loop = {"kp": 1.0, "kv_range": (0.0, 1.0), "dead_time": 0.1, "drive": "velocity", "servo_gain": 2e4}
    asked: dict[str, Any] = {"base": 0.0, "base_range": (-0.2, 0.2), "objective": "decay", "starts": 1}
    found = flexopt.select(EXCAVATOR, TARGET, loop=loop, **asked)
    assert isinstance(found, OutcomeSelection)
    assert found.gains[0]["kv"] == pytest.approx(1e-6)
    assert "loop.kv lower bound" in found.candidates[0].active
    assert "loop.kv is the least of its range that is tried, 1e-06, for 0 has no logarithm" in repr(found)
    higher = {**loop, "kv_range": (1e-6, 1.0)}
    assert "that is tried" not in repr(flexopt.select(EXCAVATOR, TARGET, loop=higher, **asked))
