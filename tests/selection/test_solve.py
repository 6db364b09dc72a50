"""Solutions are verified, ranked by the stated rule, reproducible; failures come back as errors."""

import inspect
import itertools
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import flexopt
from flexopt.cli import analysis
from flexopt.errors import InputError
from flexopt.model.problem import SelectionKeywords, SharedKeywords, StandKeywords
from flexopt.model.tree import tree_from_dict
from flexopt.selection.objective import Objective
from flexopt.selection.problem import TIE_TOLERANCE
from flexopt.selection.proof.check import prove
from tests.oracles.spatial import in_space

TARGET = (0.0, 1.6)


@pytest.fixture(scope="module")
def machine():
    return flexopt.load("excavator")


@pytest.fixture(scope="module")
def three_links(machine):
    data = machine.to_dict()
    bucket = {"name": "bucket", "length": 0.6, "com": 0.3, "mass": 150.0, "inertia": 12.0, "limits": [-2.5, 2.5]}
    return flexopt.machine_from_dict(data | {"links": [*data["links"], bucket]})


@pytest.fixture(scope="module")
def selection(machine):
    return flexopt.select(machine, TARGET, base=0.0)


def test_a_mode_in_which_the_end_point_never_moves_is_told(machine, selection):
    """A spring across the plane, softer than all others: its mode comes first, and the arm cannot reach it."""
    data = in_space(machine.model_dump(by_alias=True))
    aside = {
        "name": "aside",
        "kind": "slide",
        "axis": [0.0, 1.0, 0.0],
        "passive": True,
        "stiffness": 1e4,
        "damping": 50.0,
    }
    data["bodies"][0]["parent"] = "aside"
    data["bodies"].insert(0, {"name": "aside", "parent": None, "joint": aside})
    tree = tree_from_dict(data)
    sentence = "in none of these does the end-point move in what w1 weighs"
    hidden = flexopt.select(tree, TARGET, base=0.0, objective="w1", starts=4)
    assert sentence in repr(hidden)
    seen = flexopt.select(tree, TARGET, base=0.0, objective="w2", starts=4)
    assert not seen.unmoved
    assert seen.best.objective == pytest.approx(selection.best.objective, abs=1e-9)
    # Here w1 = 0 is an optimum, not a mode out of reach.
    assert not selection.unmoved


def test_candidates_reach_the_target_and_keep_the_margin(machine, selection):
    for candidate in selection.candidates:
        e = candidate.evaluation
        np.testing.assert_allclose(e.end_point, TARGET, atol=1e-8)
        postures = flexopt.inverse_kinematics(machine, TARGET, base=e.base)
        assert min(np.abs(e.posture - posture).max() for posture in postures) < 1e-6
        assert abs(np.sin(e.posture[1])) >= np.sin(np.radians(10.0)) - 1e-8
        assert candidate.objective == e.w[0]


def test_ranking_follows_objective_then_worst_other_measure(selection):
    quantum = TIE_TOLERANCE * selection.problem.objective_scale
    for first, second in itertools.pairwise(selection.candidates):
        if abs(first.objective - second.objective) > 2 * quantum:
            assert first.objective > second.objective
        else:
            assert first.evaluation.w[1:].min() >= second.evaluation.w[1:].min() - 2 * quantum


@pytest.mark.filterwarnings("ignore::flexopt.errors.FlexoptWarning")
@pytest.mark.parametrize("times", [1.0, 100.0])
def test_where_the_margin_ties_the_worst_measure_decides_however_heavy_the_machine(machine, times):
    """A servo gain so small that every ε_max is that of the rigid machine to 1e-9."""
    data = machine.to_dict()
    for body in (data["base"], *data["links"]):
        body |= {key: times * body[key] for key in ("mass", "inertia")}
    data["base"] |= {key: {k: times * x for k, x in data["base"][key].items()} for key in ("stiffness", "damping")}
    heavy = flexopt.machine_from_dict(data)
    found = flexopt.select(heavy, TARGET, objective="epsilon_max", gain=0.1 * times, starts=8, workers=1)
    margins = np.array([candidate.objective for candidate in found.candidates])
    worst = np.array([candidate.w.min() for candidate in found.candidates])
    assert len(margins) > 5
    assert np.ptp(margins) < 1e-9
    assert np.all(np.diff(worst) < 1e-6 * np.abs(worst[1:]))


@pytest.mark.long
def test_distance_from_the_present_base_breaks_the_last_tie(machine):
    """A symmetric pair of optima: equal in every measure, so the nearer to the present base comes first."""
    data = machine.to_dict()
    data["base"] |= {"rest_angle": np.pi / 2}
    symmetric = flexopt.machine_from_dict(data)
    right = flexopt.select(symmetric, TARGET, base=2.0)
    left = flexopt.select(symmetric, TARGET, base=-2.0)
    assert right.best.evaluation.base[0] > 0 > left.best.evaluation.base[0]
    np.testing.assert_allclose(right.best.evaluation.base, -left.best.evaluation.base, atol=1e-6)


def test_the_proof_rejects_what_is_no_maximum(selection):
    problem = selection.problem
    best = selection.best.evaluation
    z = np.concatenate([best.base, best.posture])
    assert prove(problem, z).holds
    assert "target x" in prove(problem, z + np.array([1e-5, 0, 0])).violations
    # Any other point of the redundancy reaches the target but is not stationary.
    k = int(np.argmin(np.abs(problem.scan.base[0] - best.base[0] - 0.2)))
    elsewhere = np.concatenate([problem.scan.base[:, k], problem.scan.posture[:, k]])
    assert set(prove(problem, elsewhere).violations) == {"first-order optimality"}
    # A minimum along the redundancy is stationary but bends the wrong way.
    up = np.flatnonzero(problem.scan.elbow < 0)
    values = problem.scan.objective[up]
    inner = np.flatnonzero((values[1:-1] < values[:-2]) & (values[1:-1] < values[2:]))
    low = up[inner[np.argmin(np.abs(problem.scan.base[0, up[inner]]))] + 1]
    start = np.concatenate([problem.scan.base[:, low], problem.scan.posture[:, low]])
    minimum = _refine_stationary(problem, start)
    assert set(prove(problem, minimum).violations) == {"second-order optimality"}
    outside = replace(
        problem, variables=(replace(problem.variables[0], upper=best.base[0] - 0.1), *problem.variables[1:])
    )
    assert prove(outside, z).violations["base.x range"] == pytest.approx(0.1)
    tight = replace(problem.constraints[-1], lower=0.9999)
    narrow = replace(problem, constraints=(*problem.constraints[:-1], tight))
    assert "singularity margin" in prove(narrow, z).violations


def _refine_stationary(problem, z):
    """Bisection on the slope of V along the redundancy, from a bracket around a scan point."""

    def at(x):
        return flexopt.inverse_kinematics(problem.machine, TARGET, base=x, elbow="up")[0]

    def slope(x):
        posture = at(x)
        p = problem.measures.plant.parameter_values
        out = problem.measures.gradients.call([x, posture, p])
        gradient, jacobian = out[0].full()[0], out[2].full()
        tangent = np.linalg.svd(jacobian)[2][-1]
        return float(gradient @ tangent * np.sign(tangent[0]))

    low, high = z[0] - 0.05, z[0] + 0.05
    assert slope(low) < 0 < slope(high)
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if slope(middle) < 0 else (low, middle)
    return np.concatenate([[low], at(low)])


def test_an_impossible_problem_raises_with_the_violated_constraint(selection):
    impossible = replace(selection.problem, target=np.array([0.0, 40.0]))
    with pytest.raises(flexopt.NoSolutionFound, match="target y by") as caught:
        flexopt.solve_selection(impossible)
    assert caught.value.violations["target y"] > 30.0
    assert set(caught.value.iterate) == {"base.x", "boom", "stick"}


def test_a_constraint_that_nothing_at_the_target_keeps_is_named():
    """The boom stands on the ground: 2 m over it is more than its own capsule is anywhere near its root."""
    data = flexopt.load("excavator").to_dict()
    data |= {"capsules": [{"body": "boom", "start": [0.0, 0.0], "end": [0.5, 0.0], "radius": 0.05}]}
    floor = {"kind": "half_plane", "name": "floor", "point": [0.0, -1.0], "normal": [0.0, 1.0]}
    asked = {"clearance": {"distance": 2.0, "obstacles": [floor]}}
    machine = flexopt.machine_from_dict(data)
    with pytest.raises(flexopt.NoSolutionFound) as caught:
        flexopt.select(machine, (0.0, 1.6), base=0.0, starts=2, constraints=asked)
    words = r"of \d+ configurations at the target that were looked at none keeps (.*) short at best"
    found = re.search(words, str(caught.value))
    assert found is not None
    assert "clearance of boom" in found[1]
    assert "floor" in found[1]
    # Of rows at corners, too, each is told once, there where it is broken most.
    soft = asked | {"within": {"stiffness": (0.5, 1.0)}}
    with pytest.raises(flexopt.NoSolutionFound) as caught:
        flexopt.select(machine, (0.0, 1.6), base=0.0, starts=2, constraints=soft, gravity=True)
    broken, none = str(caught.value).split(" none keeps ")
    start = re.escape("clearance of boom (start) from floor")
    assert len(re.findall(start, none)) == len(re.findall(start, broken)) == 1
    assert sum(bool(re.match(start, name)) for name in caught.value.violations) == 2
    # A distance that some keep is not told.
    less = {"clearance": asked["clearance"] | {"distance": 1.0}}
    possible = flexopt.select(machine, (0.0, 1.6), base=0.0, starts=2, constraints=less)
    best = next(row for name, row in possible.best.constraints.items() if "floor" in name)
    assert best.value >= 1.0 - 1e-6


def test_an_objective_that_is_not_a_number_raises(selection):
    """IPOPT stops at once; nothing that it leaves behind may come back as an answer."""
    broken = replace(selection.problem, objectives=(Objective("V", (np.nan, 0.0, 0.0), 0.0),))
    with pytest.raises(flexopt.NoSolutionFound):
        flexopt.solve_selection(broken)


@pytest.mark.long
def test_the_same_seed_gives_the_same_bytes(three_links):
    first, second = (flexopt.select(three_links, TARGET, starts=3, seed=3).to_dict() for _ in range(2))
    assert repr(first) == repr(second)


@pytest.mark.long
def test_a_redundant_arm_is_solved_and_flagged(three_links):
    selection = flexopt.select(three_links, TARGET, starts=5)
    assert selection.best.objective > -1e-12
    for candidate in selection.candidates:
        assert candidate.evaluation.self_motion_unstabilised
        np.testing.assert_allclose(candidate.evaluation.end_point, TARGET, atol=1e-8)
        assert abs(candidate.evaluation.posture[2]) <= 2.5 + 1e-9
    assert len(selection.attempts) == 5


def test_a_fixed_base_leaves_the_branches(machine):
    selection = flexopt.select(machine, TARGET, base_range=(0.0, 0.0))
    assert [c.evaluation.base[0] for c in selection.candidates] == [0.0, 0.0]
    branches = flexopt.inverse_kinematics(machine, TARGET)
    found = sorted(c.evaluation.posture.tolist() for c in selection.candidates)
    np.testing.assert_allclose(found, sorted(b.tolist() for b in branches), atol=1e-9)


def test_bounds_are_kept_and_named_where_the_optimum_rests_on_them(machine):
    selection = flexopt.select(machine, TARGET, base_range=(1.0, 1.4))
    assert all(1.0 - 1e-8 <= c.evaluation.base[0] <= 1.4 + 1e-8 for c in selection.candidates)
    assert any("base.x upper bound" in c.active for c in selection.candidates)


def test_joint_limits_hold(machine):
    data = machine.to_dict()
    boom, stick = data["links"]
    limited = flexopt.machine_from_dict(data | {"links": [boom, stick | {"limits": [-2.0, -1.6]}]})
    selection = flexopt.select(limited, TARGET)
    assert all(-2.0 - 1e-8 <= c.evaluation.posture[1] <= -1.6 + 1e-8 for c in selection.candidates)
    free = flexopt.select(machine, TARGET)
    assert selection.best.objective <= free.best.objective + 1e-15


@pytest.mark.long
def test_weighted_objective_and_single_modes(machine):
    weights = (0.2, 0.5, 0.3)
    weighted = flexopt.select(machine, TARGET, objective="V", weights=weights)
    assert weighted.best.objective == pytest.approx(float(np.dot(weights, weighted.best.evaluation.w)), rel=1e-12)
    for mode in (2, 3):
        single = flexopt.select(machine, TARGET, objective=f"w{mode}")
        assert single.best.objective == single.best.evaluation.w[mode - 1]
        # The weighted optimum cannot beat the optimum of one of its modes in that mode.
        assert single.best.objective >= weighted.best.evaluation.w[mode - 1] - 1e-15


@pytest.mark.long
def test_under_gravity_the_deflected_end_point_is_on_the_target(machine):
    selection = flexopt.select(machine, TARGET, gravity=True, base=0.0)
    assert selection.initial is not None
    for evaluation in (selection.initial, *(c.evaluation for c in selection.candidates)):
        np.testing.assert_allclose(evaluation.end_point, TARGET, atol=1e-8)
        assert np.abs(evaluation.static_deflection).max() > 1e-4


def test_progress_counts_every_start(machine):
    seen = []
    selection = flexopt.select(machine, TARGET, starts=3, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(1, 3), (2, 3), (3, 3)]
    assert len(selection.attempts) == 3


def test_unreachable_targets_say_by_how_much_and_from_where(machine):
    with pytest.raises(flexopt.UnreachableTarget, match="no base position") as caught:
        flexopt.select(machine, (0.0, 9.0))
    assert caught.value.base_intervals == ()
    with pytest.raises(flexopt.UnreachableTarget, match="within reach with the base at") as caught:
        flexopt.select(machine, TARGET, base_range=(5.0, 6.0))
    low, high = caught.value.base_intervals[-1]
    assert flexopt.select(machine, TARGET, base_range=(low, high)).converged
    # The miss is measured along the line to the first joint; walking to the interval takes at least as far.
    assert 0 < caught.value.miss <= 5.0 - high


@pytest.mark.parametrize("posture", [(-1.8361, 0.03), (-2.82, 0.02), (1.43, -0.03)])
def test_what_only_the_sagging_machine_reaches_is_chosen(machine, posture):
    """A nearly straight arm sinks by more than it is bent; below itself it reaches lower than from any placement."""
    target = flexopt.evaluate(machine, posture, gravity=True).end_point
    asked = {"base": 0.0, "base_range": (-1e-5, 1e-5), "singularity_margin_deg": 0.1, "starts": 2}
    with pytest.raises(flexopt.UnreachableTarget):
        flexopt.select(machine, target, **asked)
    best = flexopt.select(machine, target, gravity=True, **asked).best.evaluation
    again = flexopt.evaluate(machine, best.posture, base=best.base, gravity=True)
    np.testing.assert_allclose(again.end_point, target, atol=1e-8)
    with pytest.raises(flexopt.UnreachableTarget, match="closer than 9° to a singular posture"):
        flexopt.select(machine, target, gravity=True, **asked | {"singularity_margin_deg": 9})
    away = target + 0.05 * (target - (0.17, 0.51))
    with pytest.raises(flexopt.UnreachableTarget, match="of the machine as it sags") as caught:
        flexopt.select(machine, away, gravity=True, **asked)
    assert 0.05 < caught.value.miss < 0.2


def test_beside_joint_limits_the_base_makes_up_for_the_sag(machine):
    """A wider range of the base loses nothing; by default it goes as far as the sagging machine reaches from."""
    data = machine.to_dict()
    limits = ((-0.8, -0.6), (-0.15, -0.10))
    links = [dict(link) | {"limits": ends} for link, ends in zip(data["links"], limits, strict=True)]
    narrow = flexopt.machine_from_dict(data | {"links": tuple(links)})
    target = flexopt.evaluate(narrow, (-0.605, -0.11), base=0.0, gravity=True).end_point
    asked = {"objective": "w1", "gravity": True, "singularity_margin_deg": 1.0}
    ranges = [{"base_range": (0.0, 0.0), "base": 0.0}, {"base_range": (-2.0, 2.0)}, {}]
    found = [flexopt.select(narrow, target, **asked, **each).best for each in ranges]
    for best in found:
        again = flexopt.evaluate(narrow, best.evaluation.posture, base=best.evaluation.base, gravity=True)
        np.testing.assert_allclose(again.end_point, target, atol=1e-8)
    np.testing.assert_allclose(found[0].evaluation.posture, (-0.605, -0.11), atol=1e-6)
    assert found[1].objective > found[0].objective
    assert found[2].objective == pytest.approx(found[1].objective, rel=1e-6)
    # With springs unloaded it is reached from farther away alone, which the error says.
    far = dict(asked, base_range=(-6.0, -5.0))
    with pytest.raises(flexopt.UnreachableTarget, match="with springs unloaded"):
        flexopt.select(narrow, target, **far)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "target", "margin"),
    [("boom-stick-bucket", (6.3242, 9.5624), 5.0), ("slewing-excavator", (6.32247, 0.0, 9.5634), 0.5)],
)
def test_in_corners_of_the_limits_the_base_makes_up_for_the_sag(name, target, margin):
    asked = {"objective": "w1", "gravity": True, "singularity_margin_deg": margin, "starts": 3}
    best = flexopt.select(flexopt.load(name), target, **asked).best.evaluation
    again = flexopt.evaluate(flexopt.load(name), best.posture, base=best.base, gravity=True)
    np.testing.assert_allclose(again.end_point, target, atol=1e-8)


def test_below_itself_both_elbows_of_the_sagging_machine_are_looked_at(machine):
    """Steps from a straight arm lead to one side alone; the other's w_1 is thousands of times as good here."""
    arm = flexopt.build_plant(machine).arm_segments(p=flexopt.build_plant(machine).parameter_values)
    target = arm["first_joint"].full().ravel() - np.array([0.0, float(arm["lengths"].full().sum()) + 5e-4])
    postures = flexopt.inverse_kinematics(machine, target, gravity=True)
    best = max(flexopt.evaluate(machine, posture, gravity=True).w[0] for posture in postures)
    found = flexopt.select(
        machine, target, gravity=True, objective="w1", base=0.0, base_range=(0.0, 0.0), singularity_margin_deg=1
    )
    assert len(postures) == len(found.candidates) == 2
    assert found.best.objective == pytest.approx(best, rel=1e-6)


@pytest.mark.parametrize("margin", [10.0, 0.05])
def test_what_is_reached_with_springs_unloaded_alone_is_told_as_out_of_reach(machine, margin):
    """Upwards, where the machine as it sags is lower."""
    arm = flexopt.build_plant(machine).arm_segments(p=flexopt.build_plant(machine).parameter_values)
    target = arm["first_joint"].full().ravel() + np.array([0.0, float(arm["lengths"].full().sum()) - 1e-3])
    asked = {"base": 0.0, "base_range": (-1e-5, 1e-5), "singularity_margin_deg": margin}
    with pytest.raises(flexopt.UnreachableTarget) as by_posture:
        flexopt.inverse_kinematics(machine, target, gravity=True)
    with pytest.raises(flexopt.UnreachableTarget, match="of the machine as it sags") as caught:
        flexopt.select(machine, target, gravity=True, **asked)
    assert caught.value.miss == pytest.approx(by_posture.value.miss, rel=0.02)
    assert caught.value.miss > 2e-3


def test_unreachable_target_of_three_joints(three_links):
    with pytest.raises(flexopt.UnreachableTarget, match="within reach with the base at"):
        flexopt.select(three_links, TARGET, base_range=(50.0, 51.0))


@pytest.mark.long
@settings(max_examples=8, derandomize=True)
@given(x=st.floats(-3.0, 3.0), y=st.floats(-1.5, 3.2), control=st.sampled_from(["inverse", "transpose"]))
def test_any_reachable_target_gives_verified_candidates_or_one_clear_error(x, y, control):
    machine = flexopt.load("excavator")
    selection = flexopt.select(machine, (x, y), control=control)
    for candidate in selection.candidates:
        np.testing.assert_allclose(candidate.evaluation.end_point, (x, y), atol=1e-8)
        assert candidate.stationarity <= 1e-6
    assert selection.best.objective >= selection.problem.scan.objective.max() - 1e-9 * selection.problem.objective_scale


def test_options_are_one_object_or_keywords(machine):
    """The same answer however they are given; a keyword goes before the field; what does not belong is named."""
    target = (0.0, 1.6)
    options = flexopt.SelectionOptions(objective="w2", control="transpose", singularity_margin_deg=20.0)
    by_object = flexopt.build_selection(machine, target, options=options)
    by_keyword = flexopt.build_selection(machine, target, **options.model_dump(exclude_unset=True))
    assert by_object.to_dict() == by_keyword.to_dict()
    assert flexopt.build_selection(machine, target, options=options, objective="w1").name == "w1"
    with pytest.raises(InputError, match="gain") as caught:
        flexopt.select_stand(machine, [target], options=flexopt.SelectionOptions(gain=1e5, base=(0.0, 1.0)))
    assert [fault.field for fault in caught.value.faults] == ["options.gain", "base"]


def test_type_checkers_are_told_every_option():
    told = {"end_point": SelectionKeywords, "end_points": StandKeywords, "path": SharedKeywords}
    for kind, keywords in told.items():
        assert set(keywords.__annotations__) == set(flexopt.SelectionOptions.of(kind))


@pytest.mark.parametrize("call", [flexopt.build_selection, flexopt.select, flexopt.select_stand, flexopt.plan_base])
def test_every_argument_has_a_type(call):
    """Also those that are fields of the options; notebooks and editors show them."""
    parameters = inspect.signature(call).parameters.values()
    assert [parameter.name for parameter in parameters if parameter.annotation is inspect.Parameter.empty] == []


@pytest.fixture(scope="module")
def from_a_placement(machine):
    return flexopt.select(machine, (0.0, 1.6), base=0.0, starts=1, workers=1)


def test_the_row_of_the_present_says_where_no_posture_was_given(machine, from_a_placement) -> None:
    assert "reach the target from there: none was given" in repr(from_a_placement)
    held = flexopt.select(machine, (0.0, 1.6), base=0.0, posture=[0.0448, -2.0499], starts=1, workers=1)
    assert "none was given" not in repr(held)


def test_the_last_line_of_the_command_rounds_as_the_table_does(from_a_placement) -> None:
    best, there = from_a_placement.best, from_a_placement.best.evaluation
    nearly = replace(there, w=np.array([-1e-10 * from_a_placement.problem.first_scale, *there.w[1:]]))
    chosen = replace(best, w=nearly.w, evaluate=lambda: nearly)
    text = analysis._selection_text(replace(from_a_placement, best=chosen, candidates=(chosen,)), judged=False)
    assert text.endswith("in the present posture, 0.00000e+00 in the chosen one")


def test_rounding_of_the_other_measures_is_told_as_0_as_in_the_table(from_a_placement) -> None:
    best, there = from_a_placement.best, from_a_placement.best.evaluation
    none = replace(there, w=there.w * [1.0, 1e-25, 1e-25])
    chosen = replace(best, w=none.w, dimension=1, evaluate=lambda: none)
    found = replace(from_a_placement, best=chosen, candidates=(chosen,))
    assert "worst of the other w_i 0, " in found.decided_by


def test_what_the_present_configuration_breaks_is_told(machine) -> None:
    """The arm is nearer to straight, sin² 0.1 = 0.01, than the margin's sin² 10° = 0.03 allows; to stay was offered."""
    posture = [0.5, -0.1]
    target, asked = flexopt.evaluate(machine, posture).end_point, {"base": 0.0, "posture": posture}
    found = flexopt.select(machine, target, **asked, starts=1, workers=1)
    now = next(line for line in repr(found).splitlines() if line.startswith("   now"))
    assert now.endswith("breaks singularity margin")
    judged = flexopt.verdict(found, loop={"kp": 1e4, "kv": 1e3}, members=2, runs=0)
    assert "-0.1000 rad (breaks singularity margin)" in repr(judged)
    allowed = flexopt.select(machine, target, **asked, singularity_margin_deg=1.0, starts=1, workers=1)
    assert "breaks" not in repr(allowed)
    ranged = flexopt.select(machine, (0.0, 1.6), base=0.0, base_range=(-3.0, -1.0), starts=1, workers=1)
    assert "breaks base_range of x, 0 m (-3 to -1 m)" in repr(ranged)


def test_nothing_to_gain_is_told_in_the_scale_of_what_was_sought(machine) -> None:
    """That of ε_max is no |a||b|."""
    found = flexopt.select(machine, TARGET, objective="epsilon_max", starts=1, workers=1)
    again = flexopt.select(
        machine, TARGET, objective="epsilon_max", base=found.best.z[:1], posture=found.best.z[1:], starts=1, workers=1
    )
    assert again.nothing_to_gain.endswith("has as much epsilon_max, to 0.0001 of its scale")
