"""What a selection assumes unasked: the ground against points of MuJoCo's capsules, joint limits, how far to drive."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import flexopt
from flexopt import InputError
from flexopt.model.constraints import Constraints
from flexopt.model.robots import robot_from_dict
from flexopt.plant import build_plant
from flexopt.plant.reach import outer_reach
from flexopt.selection.assumed import assumed
from flexopt.selection.constraints import build_constraints
from flexopt.selection.constraints.ground import _joints
from tests.oracles.cylinders import digger
from tests.oracles.spatial import grounded, random_tree
from tests.selection.constraints.scenes import at_rest, listed, mujoco_scene, random_capsules

ROBOTS = Path(__file__).parents[2] / "models" / "robots"
# An excavator as others publish one: where its bodies are, and nothing of what they fill or stand on.
PUBLIC = {
    "name": "public",
    "robot": "slewing-excavator.urdf",
    "actuated": ["slew", "boom", "stick", "bucket"],
    "base": {"stiffness": [3.4e7, 3.4e7, 4.5e7, 1.3e8, 1.1e8, 1.4e8], "damping": [1e5, 1e5, 1e5, 4e5, 4e5, 4e5]},
    "end_point": {"link": "teeth"},
}


def of(machine, targets, *, assume="everything", constraints=None, present=None, bounded=()):
    points = np.array(targets, dtype=float)
    kept, known = constraints or Constraints(), present is not None
    return assumed(build_plant(machine), assume, points, kept, present, frozenset(bounded), given=known)


@pytest.mark.parametrize("seed", range(6))
def test_the_ground_against_points_of_capsules(seed):
    """Lowest points of sampled capsules and origins of joints, by MuJoCo: the rows are their heights, no more, no less."""
    rng = np.random.default_rng(seed)
    data = random_tree(seed, counts=(2, 6))
    names = [body["name"] for body in data["bodies"]]
    filled = [name for name in names if rng.random() < 0.6]
    capsules = random_capsules(rng, filled, 3) if filled else []
    machine = flexopt.tree_from_dict(data | {"capsules": capsules})
    plant, height = build_plant(machine), float(rng.uniform(-1, 1))
    rows = build_constraints(plant, Constraints(), height)
    parents = {body["name"]: body.get("parent") for body in data["bodies"]}

    def from_end_point_on(name):
        while name is not None and name != data["end_point"]["body"]:
            name = parents[name]
        return name is not None

    base = np.array([*rng.uniform(-2, 2, 2), rng.uniform(-3, 3)])
    scene = mujoco_scene(data, capsules, [], base)

    def heights(posture):
        """Lowest of each capsule's points and origin of each joint, m."""
        scene.set(at_rest(plant, base, posture), np.zeros(len(names)))
        found = {}
        around = rng.normal(size=(3, 400))
        around /= np.linalg.norm(around, axis=0)
        around[:, 0] = (0, 0, -1)
        for k, capsule in enumerate(capsules):
            body = scene.data.body(f"body {capsule['body']}")
            ends = [body.xpos + body.xmat.reshape(3, 3) @ np.array(capsule[end]) for end in ("start", "end")]
            along = ends[0][:, None] + np.subtract(ends[1], ends[0])[:, None] * np.linspace(0, 1, 11)
            points = along[:, :, None] + capsule["radius"] * around[:, None, :]
            found["capsule", k] = float(points[2].min())
        for name in names:
            found["joint", name] = float(scene.data.body(f"body {name}").xpos[2])
        return found

    postures = [rng.uniform(-1.5, 1.5, plant.n_actuated) for _ in range(4)]
    seen = [heights(posture) for posture in postures]
    kept = [
        key
        for key in seen[0]
        if not from_end_point_on(parents[key[1]] if key[0] == "joint" else capsules[key[1]]["body"])
        and not (key[0] == "joint" and (parents[key[1]] is None or parents[key[1]] in filled))
        and np.ptp([each[key] for each in seen]) > 1e-6
    ]
    for posture, each in zip(postures, seen, strict=True):
        values = rows.report(base, posture, plant.parameter_values, rows.constants).full().ravel()
        lowest = min((each[key] for key in kept), default=math.inf) - height
        assert values.min(initial=math.inf) == pytest.approx(lowest, abs=1e-12)
    assert rows.placed is False
    assert all("assumed ground" in label for label in listed(rows).labels)


def test_where_the_ground_is_known():
    slewing = flexopt.load("slewing-excavator")
    assert of(slewing, [[7, 0, 1]]).ground == 0.0
    assert of(slewing, [[7, 0, 1]]).named[0].sentence == "boom, stick stay above the ground, whose height is 0 m"
    # Targets below are dug for; a problem's own ground goes before; a word switches it off.
    assert of(slewing, [[7, 0, 1], [7, 0, -0.1]]).ground is None
    assert of(slewing, [[7, 0, 1]], constraints=Constraints(clearance={"distance": 0.1, "ground": -1.0})).ground is None
    assert of(slewing, [[7, 0, 1]], assume="limits,reach").ground is None
    # What stands in for a support: volumes of what stands still; and nothing where the machine may run on a rail.
    data = grounded(3, 0, coupled=False)
    low = {"body": "chassis", "start": [0, 0, 0.1], "end": [1, 0, 0.2], "radius": 0.5}
    tree = flexopt.tree_from_dict
    assert of(tree(data), [[2, 0, 1]]).ground == 0.0
    assert of(tree(data | {"capsules": [low]}), [[2, 0, 1]]).ground == pytest.approx(-0.4)
    assert of(tree(data | {"placement": ["x"]}), [[2, 0, 1]]).ground is None
    supported = {"polygon": [[1, 1], [-1, 1], [-1, -1], [1, -1]]}
    assert of(tree(data | {"capsules": [low], "placement": ["x"], "support": supported}), [[2, 0, 1]]).ground == 0.0
    assert of(flexopt.load("excavator"), [[0, 1.6]]).ground is None
    assert of(flexopt.load("boom-stick-bucket"), [[7, 1.6]]).ground == 0.0


@pytest.mark.long
def test_an_excavator_of_others_keeps_its_boom_out_of_the_ground():
    """Without the assumption its best configuration has a pin below ground; pins by Pinocchio."""
    machine = robot_from_dict(PUBLIC, folder=ROBOTS)
    model = pin.buildModelFromUrdf(str(ROBOTS / PUBLIC["robot"]))

    def lowest(found):
        cosine_and_sine, rest = np.array([1.0, 0.0]), found.best.evaluation.posture[1:]  # a slew that has no limits
        data = model.createData()
        pin.forwardKinematics(model, data, np.concatenate([cosine_and_sine, rest]))
        return min(data.oMi[model.getJointId(name)].translation[2] for name in ("stick", "bucket"))

    options = {"base": (0.0, 0.0, 0.0), "starts": 2, "workers": 1}
    found = flexopt.select(machine, (7.0, 1.0, 0.5), **options)
    free = flexopt.select(machine, (7.0, 1.0, 0.5), assume="limits", **options)
    assert lowest(found) > -1e-7
    assert lowest(free) < -0.1
    names = [each["name"] for each in found.to_dict()["problem"]["assumed"]]
    assert names == ["ground", "limits", "reach", "capsules"]
    assert "assumed (ground): the joints stick, bucket stay above the ground" in repr(found)
    assert [each.name for each in free.problem.assumed] == ["limits", "capsules"]


def test_bodies_without_a_volume_are_named_where_a_clearance_is_asked_for():
    """A massless one is none, and those that are chosen by name are chosen."""
    tank = {"name": "tank", "kind": "sphere", "center": [3.5, 4.5, 1.5], "radius": 1.5}
    machine = flexopt.load("mobile-manipulator")
    named = of(
        machine, [(1.0, 0.0, 1.0)], constraints=Constraints(clearance={"distance": 0.1, "obstacles": [tank]})
    ).named
    (bare,) = (each for each in named if each.name == "clearance")
    assert (bare.value, bare.unit) == (2.0, "bodies")
    assert bare.sentence.endswith("so nothing of shoulder, wrist 1")
    chosen = Constraints(clearance={"distance": 0.1, "obstacles": [tank], "bodies": ["forearm"]})
    whole = flexopt.load("slewing-excavator")
    everywhere = Constraints(clearance={"distance": 0.1, "obstacles": [tank]})
    for found in (
        of(machine, [(1.0, 0.0, 1.0)], constraints=chosen),
        of(whole, [(7.0, 1.0, 1.0)], constraints=everywhere),
    ):
        assert "clearance" not in [each.name for each in found.named]


def test_what_stands_below_the_ground_is_named_where_a_clearance_from_it_is_asked_for():
    """What no joint moves keeps none: it is named where its capsule is below the ground, or where it was asked for."""

    def named(machine, **asked):
        found = of(machine, [(7.0, 1.0, 2.5)], constraints=Constraints(clearance={"distance": 0.2, **asked})).named
        return [each.sentence for each in found if each.name == "clearance"]

    whole = flexopt.load("slewing-excavator")
    assert named(whole, ground=0.0) == []
    (asked,) = named(whole, ground=0.0, bodies=["undercarriage", "stick"])
    assert asked.endswith("so not undercarriage (+0 m)")
    (below,) = named(whole, ground=0.18)
    assert below.endswith("so not undercarriage (-0.18 m)")
    assert named(whole, ground=-0.3, bodies=["undercarriage", "stick"]) == []
    tank = {"name": "tank", "kind": "sphere", "center": [3.5, 4.5, 1.5], "radius": 1.5}
    assert named(whole, obstacles=[tank], bodies=["undercarriage"]) == []


@pytest.mark.parametrize("without", [(), ("stick",), ("boom", "bucket"), ("boom", "stick", "bucket")])
def test_joints_that_nothing_is_known_to_hold_are_named_where_holding_is_asked_for(without):
    """All joints that have no row, where some have one; a cylinder's force holds, too."""
    data = digger()
    data["cylinders"] = [cylinder for cylinder in data["cylinders"] if cylinder["joint"] not in without]
    data["links"][2] = {name: value for name, value in data["links"][2].items() if name != "effort"}
    if "bucket" not in without:
        data["links"][2]["effort"] = 2e3
    machine = flexopt.machine_from_dict(data)
    kept = Constraints(holding=0.8)
    named = [each for each in of(machine, [(2.0, 1.0)], constraints=kept).named if each.name == "holding"]
    if not without or len(without) == 3:
        assert named == []
        return
    labels = listed(build_constraints(build_plant(machine), kept)).labels
    missing = [joint for joint in machine.joints if not any(joint in label.split() for label in labels)]
    assert missing == list(without)
    assert named[0].sentence.endswith(f"alone, so not {', '.join(missing)}")
    assert (named[0].value, named[0].unit) == (len(missing), "joints")
    assert "holding" not in [each.name for each in of(machine, [(2.0, 1.0)]).named]


@pytest.mark.parametrize("target", ["end_point = [7.0, 1.0]", "end_points = [[7.0, 1.0], [7.2, 1.0]]"])
def test_what_holding_leaves_out_is_told_in_text_document_and_check(target, tmp_path):
    text = (ROBOTS.parent / "boom-stick-bucket.toml").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith(("effort = 4.0e5", "force = [2.64e5"))]
    (tmp_path / "machine.toml").write_text("\n".join(lines), encoding="utf-8")
    asked = f"[target]\n{target}\n[selection]\nstarts = 1\n[constraints]\nholding = 0.8\n"
    (tmp_path / "p.toml").write_text(f'name = "p"\nmachine = "machine.toml"\n{asked}', encoding="utf-8")
    said = "held is what has an effort, or a cylinder with a force, alone, so not stick"
    found = flexopt.solve_problem(flexopt.load_problem(tmp_path / "p.toml"), workers=1)
    assert f"assumed (holding): {said}" in repr(found)
    assert said in json.dumps(found.to_dict(), ensure_ascii=False)
    assert flexopt.check(tmp_path / "p.toml").warnings == (f"constraints.holding: {said}",)


def test_that_nothing_has_a_volume_is_named():
    """Whatever is assumed, for no word switches it off."""
    data = flexopt.load("excavator").to_dict()
    (said,) = of(flexopt.machine_from_dict(data), [[0.0, 1.6]], assume="nothing").named
    assert (said.name, said.value, said.unit) == ("capsules", 3.0, "bodies")
    assert said.sentence == "bodies may pass through each other, for the machine has no [[capsules]]"
    column = {"body": "base", "start": [0.0, 0.0], "end": [0.5, 0.0], "radius": 0.3}
    assert of(flexopt.machine_from_dict(data | {"capsules": [column]}), [[0.0, 1.6]], assume="nothing").named == ()


def test_that_capsules_may_meet_is_named_until_they_may_not():
    machine = flexopt.load("slewing-excavator")
    (said,) = of(machine, [(7.0, 1.0, 1.0)], assume="nothing").named
    assert (said.name, said.unit) == ("self_clearance", "pairs of capsules")
    kept = Constraints(self_clearance=0.05)
    apart = flexopt.build_selection(machine, (7.0, 1.0, 1.0), constraints=kept, assume="nothing").constraint_set
    assert apart is not None
    # Two rows each.
    assert said.value == len(apart) / 2
    assert of(machine, [(7.0, 1.0, 1.0)], constraints=kept, assume="nothing").named == ()


def test_how_far_to_drive():
    machine = flexopt.load("slewing-excavator")
    problem = flexopt.build_selection(machine, (7.0, 1.0, 1.0), base=(1.0, 2.0, 0.3), starts=1)
    drive = next(each for each in problem.assumed if each.name == "reach")
    center, outer = outer_reach(build_plant(machine))
    assert drive.value == pytest.approx(outer + math.hypot(center[0], center[1]))
    for k, now in enumerate((1.0, 2.0)):
        assert problem.lower[k] >= now - drive.value
        assert problem.upper[k] <= now + drive.value
    assert problem.upper[0] == 1.0 + drive.value  # closer than what reaches the target
    assert not np.isfinite(problem.lower[2])
    # A target out of reach from here is driven to, and no farther than to where it lies.
    far = flexopt.build_selection(machine, (40.0, 1.0, 1.0), base=(1.0, 2.0, 0.3), starts=1)
    assert far.upper[0] == 40.0
    assert far.lower[0] == pytest.approx(40.0 - drive.value, rel=0.01)
    # Without a present placement it stands at zeros, and the sentence says so.
    at_zeros = flexopt.build_selection(machine, (7.0, 1.0, 1.0), starts=1)
    assert at_zeros.upper[0] == drive.value
    assert "from zeros" in next(each for each in at_zeros.assumed if each.name == "reach").sentence
    assert "from where it stands" in drive.sentence
    # Where nothing stands on the ground zeros mean nothing, and where the range is given, nothing is claimed.
    article = flexopt.build_selection(flexopt.load("excavator"), (0.0, 1.6), starts=1)
    ranged = {"base": (1.0, 2.0, 0.3), "base_range": {"x": (-50, 50), "y": (-50, 50)}}
    problem = flexopt.build_selection(machine, (7.0, 1.0, 1.0), starts=1, **ranged)
    for each in (article, problem):
        assert "reach" not in [assumption.name for assumption in each.assumed]
    assert problem.upper[0] == 50.0
    # One coordinate bounded, the other not.
    given = {"base": (1.0, 2.0, 0.3), "base_range": {"x": (-50, 50)}}
    problem = flexopt.build_selection(machine, (7.0, 1.0, 1.0), starts=1, **given)
    assert problem.upper[0] == 50.0
    assert problem.upper[1] < 15.0
    assert "along y" in next(each for each in problem.assumed if each.name == "reach").sentence


def test_the_words():
    machine = flexopt.load("boom-stick-bucket")
    options = {"base": 0.0, "starts": 1}
    everything = flexopt.build_selection(machine, (7.0, 1.0), **options)
    assert [each.name for each in everything.assumed] == ["ground", "limits", "reach", "self_clearance"]
    nothing = flexopt.build_selection(machine, (7.0, 1.0), assume="nothing", **options)
    assert [each.name for each in nothing.assumed] == ["self_clearance"]
    assert nothing.constraint_set is None
    assert not np.isfinite(nothing.lower[1:]).any()
    assert nothing.lower[0] < everything.lower[0] or nothing.upper[0] > everything.upper[0]
    limits = flexopt.build_selection(machine, (7.0, 1.0), assume="limits", **options)
    assert np.array_equal(limits.lower[1:], everything.lower[1:])
    assert flexopt.SelectionOptions(assume="reach, ground").assume == "reach,ground"
    for wrong in ("everything,ground", "grounds", "", 3, ["ground"]):
        with pytest.raises(InputError, match="must be everything, nothing, or some of ground, limits, reach"):
            flexopt.build_selection(machine, (7.0, 1.0), assume=wrong)


def test_the_article_is_as_it_was():
    """No ground is known of its machine, and its reach was what bounded it."""
    machine = flexopt.load("excavator")
    found = flexopt.select(machine, (0.0, 1.6), base=0.0, workers=1)
    before = flexopt.select(machine, (0.0, 1.6), base=0.0, assume="limits", workers=1)
    assert [candidate.z.tolist() for candidate in found.candidates] == [c.z.tolist() for c in before.candidates]
    assert found.problem.constraint_set is None
    assert [each.name for each in found.problem.assumed] == ["reach", "capsules"]


def test_targets_of_one_choice_are_seen_together():
    """A way into the ground knows none; a far target lets the base drive at every one."""
    machine = flexopt.load("boom-stick-bucket")
    assert of(machine, [[7.0, 1.0], [7.0, -1.0]]).ground is None
    both = of(machine, [[7.0, 1.0], [30.0, 1.0]], present=np.array([0.0]))
    assert both.drive == 30.0
    stand = flexopt.select_stand(machine, [(7.0, 1.0), (6.5, 1.2)], base=0.0, starts=1, workers=1)
    assert {each.name for each in stand.problems[0].assumed} == {"ground", "limits", "reach", "self_clearance"}
    assert "assumed (ground): boom, stick stay above" in repr(stand)
    assert stand.to_dict()["problem"]["assumed"][0]["value"] == 0.0
    values = [value.value for place in stand.places for value in place.constraints.values()]
    assert min(values) > -1e-7


def test_what_may_be_in_the_way_is_told():
    """A pin cannot be above ground where the target is 0.1 m above it and the tool is held upright below its pin."""
    machine = flexopt.load("boom-stick-bucket")
    with pytest.raises(
        flexopt.NoSolutionFound, match=r"assumed \(ground\): boom, stick stay above .* `assume` leaves it"
    ):
        flexopt.select(machine, (7.0, 0.1), constraints={"tool_angle": math.pi / 2}, starts=2, workers=1)


def test_the_ground_names_joints_by_their_own_names() -> None:
    """A telescope's slide is no joint `telescope`."""
    crane = flexopt.load("truck-crane")
    tree = crane.kinematic_tree
    named = _joints(build_plant(crane), [body.name for body in tree.bodies])
    assert named == [body.joint.name for body in tree.bodies]
    assert "extend" in named
    assert "telescope" not in named


@pytest.mark.long("0.1")
@pytest.mark.parametrize("margin", [0.0, 0.1])
def test_a_joint_margin_is_kept_whatever_is_assumed(margin):
    machine = flexopt.load("slewing-excavator")
    found = flexopt.select(
        machine, (5.5, 0.5, 1.0), base=(0.0, 0.0, 0.0), objective="w1", starts=2, seed=1, assume="nothing",
        constraints={"joint_margin": margin}, workers=1,
    )  # fmt: skip
    low, high = np.array(machine.limits).T
    for candidate in found.candidates:
        q = candidate.evaluation.posture
        assert np.all(q >= low + margin - 1e-9)
        assert np.all(q <= high - margin + 1e-9)


@pytest.mark.long
def test_answers_to_any_question_say_what_was_assumed_in_their_provenance() -> None:
    """By modes, by the loop, of several targets: else a comparison tells a difference that is none."""
    machine = flexopt.load("boom-stick-bucket")
    few: dict[str, Any] = {"base": 0.0, "starts": 1}
    chosen = [flexopt.select(machine, (7.0, 1.0), objective=word, **few) for word in ("w1", "decay")]
    chosen.append(flexopt.select_stand(machine, [(7.0, 1.0)], **few))
    told = [answer.provenance["options"]["assumed"] for answer in chosen]
    assert [each["name"] for each in told[0]] == ["ground", "limits", "reach", "self_clearance"]
    assert told[1] == told[2] == told[0]
