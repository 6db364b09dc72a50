"""How staying is held where it breaks a constraint, where an arm rests, and what of the unknown would tell."""

from __future__ import annotations

import math
import re
from types import SimpleNamespace
from typing import Any, cast

import casadi as ca
import numpy as np
import pytest

import flexopt
from flexopt.loop.beside_decay import BesideDecay
from flexopt.loop.evaluation import settings_at
from flexopt.loop.uncertain import UncertainLoop
from flexopt.loop.uncertainty_box import UncertaintyBox
from flexopt.model.uncertainty import Uncertainty
from flexopt.selection.broken import broken
from flexopt.selection.problem import with_angles
from flexopt.study.verdicts.confirmation import _ensemble, nonlinear_runs
from flexopt.study.verdicts.place_loops import held_otherwise
from flexopt.study.verdicts.remarks import rests_beside
from tests.study.machines import three_links

LOOP = {"kp": 1e4, "kv": 1e3}
TARGETS = [(0.0, 1.6), (-0.3, 1.7)]


@pytest.mark.long
def test_a_placement_that_may_not_be_stood_on_is_held_as_well_as_any() -> None:
    """All postures break an area alike: the best of them is taken, as where the area is free."""
    machine = three_links()
    free, barred = (
        flexopt.verdict(
            flexopt.select_stand(machine, TARGETS, base=0.0, starts=2, constraints=asked),
            loop=LOOP, members=2, runs=0,
        )
        for asked in ({}, {"keep_out": [(-0.1, 0.1)]})
    )  # fmt: skip
    stay, held = free.places[0], barred.places[0]
    assert stay.name == held.name == "stay"
    # The objective's greatest value is 0 of a self-motion's whole part: up to rounding of w1, 5e-5 elsewhere.
    assert held.w[:, 0] == pytest.approx(stay.w[:, 0], abs=1e-9)
    assert barred.present_breaks
    assert "held as breaks the least and is best of these by w1 at each target," in barred.reason
    assert barred.taken.startswith("the postures that break the least at each target and are best of these by w1:")
    assert free.taken.startswith("the postures that are best by w1 at each target:")


@pytest.fixture(scope="module")
def heavy() -> flexopt.Verdict:
    """An arm that decays with the payload of its file, and grows or falls with much less and much more."""
    machine = flexopt.load("boom-stick-bucket")
    chosen = flexopt.select(machine, (6.0, 1.0), base=0.0, starts=2, gravity=True)
    return flexopt.verdict(chosen, loop="default", ranges={"payload.mass": (500.0, 4000.0)}, members=6, runs=0)


@pytest.mark.long
def test_where_the_numbers_of_the_file_decay_measuring_tells(heavy: flexopt.Verdict) -> None:
    """On all members it grows, and a narrow range about the file's number gives the answer that is promised."""
    assert heavy.word == "cannot tell"
    assert all(place.decay.least < 0 < place.decay.nominal for place in heavy.places)
    assert heavy.measure.startswith("to tell, measure payload.mass: with the numbers of the file ")
    close = flexopt.verdict(
        heavy.selection, loop="default", ranges={"payload.mass": (980.0, 1020.0)}, members=4, runs=0
    )
    assert close.word != "cannot tell"


@pytest.mark.long
def test_an_arm_that_nobody_gave_stands_above_the_assumed_ground_where_it_can() -> None:
    """From here one of the postures that reach the target has the stick in the ground; staying is not that one."""
    machine, target = flexopt.load("boom-stick-bucket"), (5.0, 1.0)
    chosen = flexopt.select(machine, target, base=0.0, starts=4)
    assert chosen.initial is not None
    assert "from the assumed ground" in broken(chosen.problem, chosen.initial.z)
    found = flexopt.verdict(chosen, loop="default", members=2, runs=0)
    stay = found.places[0]
    held = np.concatenate([stay.base, stay.posture])
    assert (stay.name, broken(chosen.problem, held)) == ("stay", "")
    assert flexopt.evaluate(machine, stay.posture, base=stay.base).end_point == pytest.approx(target, abs=1e-6)
    assert "another than the choice's present one, which breaks constraints" in found.taken
    # What was given is judged as it is.
    given = flexopt.select(machine, target, base=0.0, posture=chosen.initial.posture, starts=1)
    assert flexopt.verdict(given, loop="default", members=2, runs=0).places[0].posture == pytest.approx(
        chosen.initial.posture
    )


@pytest.mark.parametrize("law", [{"kv": 24e3}, {"feedback": "pid", "ki": 4e3, "kv": 24e3}], ids=["pd", "pid"])
@pytest.mark.parametrize(
    ("name", "posture"),
    [("boom-stick-bucket", (-1.56, -0.702, -1.786)), ("slewing-excavator", (-1.19, -0.653, -2.115, -0.754))],
)
def test_the_linear_loop_of_a_run_is_that_of_the_verdict_where_the_arm_creeps(
    name: str, posture: tuple[float, ...], law: dict[str, Any]
) -> None:
    """Under a payload that the controller does not know it would come to rest far away, after hours, or nowhere."""
    machine = flexopt.load(name)
    loop = flexopt.Loop(control="transpose", drive="torque", kp=42e3, rate=100.0, nullspace_damping=1e5, **law)
    at = np.array(posture)
    settings, base = settings_at(machine, at, None, None, loop, gravity=True, call="test")
    file = machine.payload.mass or 200.0
    box = UncertaintyBox(machine, (Uncertainty(of=("payload.mass",), value=(0.5 * file, 1.5 * file)),), 0.0)
    members, here = np.array([[0.0], [0.4], [1.0]]), UncertainLoop(settings, base, at, True, box)
    decays = here.decays(members)
    # Both find the rest by Newton's method, to 1e-9.
    assert -_ensemble(here, members, 1.0, None).linear_growth_rate == pytest.approx(decays, rel=1e-6)
    if name == "boom-stick-bucket" and "ki" not in law:
        assert decays.min() > 1.0
        assert nonlinear_runs(here, members, decays, 5.0).verdicts == ("converges",) * 3


@pytest.mark.long
def test_outside_its_range_the_base_does_not_stay() -> None:
    """Where it decays, and an arm that is held beside the target is told of there, too."""
    few: dict[str, Any] = {"base": -2.1859, "starts": 2}
    machine, held = flexopt.load("excavator"), (-1.2479, 1.4872)
    judged: dict[str, Any] = {"loop": LOOP, "members": 2, "runs": 0}
    found = flexopt.verdict(machine, TARGETS[0], posture=held, base_range={"x": (0.5, 1.5)}, **few, **judged)
    breaks = "breaks base_range of x, -2.186 m (0.5 to 1.5 m)"
    assert found.present_breaks == breaks
    assert found.places[0].decay.least > 0
    assert found.word != "stay"
    assert f"the present place {breaks}" in found.sentence
    free = flexopt.verdict(machine, TARGETS[0], posture=held, base_range={"x": (-3.0, 1.5)}, **few, **judged)
    assert free.present_breaks == ""
    beside = flexopt.verdict(
        machine, TARGETS[0], posture=(-1.2479, 1.3), base_range={"x": (0.5, 1.5)}, **few, **judged
    )  # fmt: skip
    off = float(np.linalg.norm(flexopt.evaluate(machine, (-1.2479, 1.3), base=-2.1859).end_point - TARGETS[0]))
    assert f"the present place, the end-point {off:.3g} m off its target, {breaks}" in beside.sentence


@pytest.mark.long
def test_what_grows_rests_nowhere(heavy: flexopt.Verdict) -> None:
    """Beside the decays of all members at once, and where each is held."""
    assert heavy.uncertainty
    box = UncertaintyBox(heavy.selection.problem.machine, tuple(heavy.uncertainty), heavy.settings.dead_time)
    members = np.linspace(0.0, 1.0, 13)[:, None]
    for place in heavy.places:
        loop = UncertainLoop(heavy.settings, place.base, place.posture, True, box)
        decays, target = loop.decays(members), loop.outcome().end_point
        ends = [loop.outcome(u).end_point for u in members[decays > 0]]
        known = [float(np.linalg.norm(end - target)) for end in ends]
        assert 0 < len(known) < len(members)
        assert BesideDecay.of(loop, members).rests_off == pytest.approx(max(known))
        # Of the members that the verdict looked at all grow.
        assert np.isnan(place.rests_off)
    assert rests_beside(heavy) == ""


def test_a_distance_that_counts_angles_says_so() -> None:
    """Of a drill that is held upright, say."""
    upright, point = (SimpleNamespace(task_rows=rows) for rows in (("x", "z", "pitch"), ("x", "z")))
    assert with_angles(cast(Any, upright)) == " (pitch counted as angle times end_point.length)"
    assert with_angles(cast(Any, point)) == ""


@pytest.mark.parametrize("target", [(5.0, 1.6), (3.4, 1.6)])
def test_held_beside_a_target_that_is_out_of_reach_there_is_no_staying(target: tuple[float, float]) -> None:
    """In whichever posture the arm is held; and what bounds a search is no limit of a machine."""
    machine, held = flexopt.load("excavator"), (0.0448, -2.0499)
    with pytest.raises(flexopt.UnreachableTarget):
        flexopt.inverse_kinematics(machine, target, base=0.0)
    few: dict[str, Any] = {"base": 0.0, "loop": LOOP, "members": 2, "runs": 0, "starts": 2}
    found = flexopt.verdict(machine, target, posture=held, **few)
    assert found.stay is None
    assert "from the present placement the arm does not reach the target within its limits" in found.sentence
    assert found.word == flexopt.verdict(machine, target, **few).word == "move"
    assert "limits of base" not in repr(found) + repr(found.selection)


@pytest.mark.parametrize(("kp", "of"), [(1.0, "half of its largest"), (0.4, "as far as it began")])
def test_how_near_the_end_point_had_to_come_is_told(kp: float, of: str) -> None:
    """Beside how far off it is under a load that the controller does not know, of the errors of the run itself."""
    machine, at = flexopt.load("excavator"), np.array([0.0448, -2.0499])
    loop = flexopt.Loop(kp=kp, kv=0.0, drive="velocity", servo_gain=1e5)
    settings, base = settings_at(machine, at, None, None, loop, gravity=True, call="test")
    box = UncertaintyBox(machine, (Uncertainty(of=("payload.mass",), value=(0.0, 400.0)),), 0.0)
    members, here = np.array([[1.0]]), UncertainLoop(settings, base, at, True, box)
    decays = here.decays(members)
    duration = 6.0 / float(decays[0])
    why = nonlinear_runs(here, members, decays, duration).reasons[0]
    errors = _ensemble(here, members, duration, None).dataset
    start, peak, end = (float(errors[f"{name}_error"][0]) for name in ("start", "peak", "end"))
    told = re.search(rf"in the end it is (\S+) m off, where at most (\S+) m \({of}\) would confirm", why)
    assert told, (why, start, peak, end)
    assert (float(told[1]), float(told[2])) == pytest.approx((end, min(peak / 2, start)), rel=1e-3)  # four digits
    assert float(told[1]) > float(told[2])


@pytest.mark.parametrize(
    ("limits", "others"),
    [
        pytest.param(((-1.0, 1.4), (-2.9, -0.2)), False, id="one-elbow"),
        pytest.param(((-math.pi, math.pi), (-2.9, 2.9)), True, marks=pytest.mark.long, id="both-elbows"),
    ],
)
def test_that_another_posture_may_break_none_is_said_where_there_is_one(
    limits: tuple[tuple[float, float], ...], others: bool
) -> None:
    """With a heavier payload the boom bears too much; the arm's other elbow is a posture of its own."""
    data = flexopt.load("excavator").to_dict() | {"payload": {"mass": 100.0}}
    links = [dict(link) | {"limits": ends} for link, ends in zip(data["links"], limits, strict=True)]
    machine, target = flexopt.machine_from_dict(data | {"links": links}), (1.6, 1.0)
    torques = ca.MX.sym("torques", 2)
    torque = ca.Function("boom_torque", [torques], [torques[0]], ["torques"], ["boom_torque"])
    own = flexopt.Constraint(torque, lower=-1.8e4, upper=1.8e4)
    chosen = flexopt.select(machine, target, base=0.0, constraints=[own], starts=3, workers=1)
    few: dict[str, Any] = {"members": 4, "runs": 0}
    found = flexopt.verdict(chosen, loop={"kp": 3e4, "kv": 3e3}, ranges={"payload.mass": (0.0, 600.0)}, **few)
    assert (len(flexopt.inverse_kinematics(machine, target, base=0.0)) > 1) == others
    assert "breaks boom_torque" in found.reason
    assert ("held in another posture it may break none" in found.reason) == others
    assert ("in one of the postures that reach the target" in found.reason) == others
    # Which keeps constraints of the user's own with the file's numbers.
    assert "constraints.within" not in found.reason
    assert all(place.breaks == place.broken.removeprefix(f"{place.name} ") for place in found.places)


@pytest.mark.parametrize(
    ("slew", "boom", "stick", "others"),
    [
        ((-1.5, 1.5), (-1.4, 0.5), (0.1, 2.7), False),
        # By whole turns of the slew nothing is held otherwise.
        ((-6.6, 6.6), (-1.4, 0.5), (0.1, 2.7), False),
        ((-1.5, 1.5), (-1.4, 2.5), (-2.7, 2.7), True),
    ],
)
def test_steps_that_end_in_one_posture_are_no_other(
    slew: tuple[float, float], boom: tuple[float, float], stick: tuple[float, float], others: bool
) -> None:
    """A crane in space: every sample that reaches its target leads to the one elbow that the limits allow, or to both."""
    car = {"name": "pitch", "kind": "hinge", "axis": (0, 1, 0), "passive": True, "stiffness": 3e5, "damping": 1e3}
    bodies: list[dict[str, Any]] = [
        {"name": "car", "parent": None, "joint": car, "mass": 900.0, "inertia": (90.0, 95.0, 99.0, 0, 0, 0)}
    ]
    for name, axis, position, limits in (
        ("slew", (0, 0, 1), (0, 0, 1.0), slew),
        ("boom", (0, 1, 0), (0, 0, 0.5), boom),
        ("stick", (0, 1, 0), (1.5, 0, 0), stick),
    ):
        joint = {"name": name, "kind": "hinge", "axis": axis, "limits": limits}
        bodies.append({"name": name, "parent": bodies[-1]["name"], "joint": joint, "position": position, "mass": 50.0,
                       "com": (0.5, 0, 0), "inertia": (5.0, 6.0, 5.5, 0, 0, 0)})  # fmt: skip
    end_point = {"body": "stick", "position": (1.2, 0, 0), "rows": ("x", "y", "z")}
    machine = flexopt.tree_from_dict({"name": "crane", "bodies": bodies, "end_point": end_point, "placement": ("x",)})
    problem = flexopt.build_selection(machine, (1.8, 0.3, 1.5), base=0.0)
    assert (len(flexopt.inverse_kinematics(machine, (1.8, 0.3, 1.5), base=0.0)) > 1) == others
    assert held_otherwise(problem) == others


@pytest.mark.parametrize(("off", "counts"), [(0.6, True), (0.0, False)])
def test_a_roll_of_the_tool_is_another_posture_where_a_clearance_depends_on_it(off: float, counts: bool) -> None:
    """One elbow alone is within the limits; what the tool carries lies beside the axis of its roll, or on it."""
    car = {"name": "pitch", "kind": "hinge", "axis": (0, 1, 0), "passive": True, "stiffness": 1e5, "damping": 1e3}
    bodies: list[dict[str, Any]] = [
        {"name": "car", "parent": None, "joint": car, "mass": 900.0, "inertia": (90.0, 95.0, 99.0, 0, 0, 0)}
    ]
    for name, axis, position, limits, mass in (
        ("slew", (0, 0, 1), (0, 0, 1.0), (-1.5, 1.5), 50.0),
        ("boom", (0, 1, 0), (0, 0, 0.5), (-1.4, 0.5), 50.0),
        ("stick", (0, 1, 0), (1.5, 0, 0), (0.1, 2.7), 50.0),
        ("roll", (1, 0, 0), (0.8, 0, 0), (-1.5, 1.5), 10.0),
    ):
        joint = {"name": name, "kind": "hinge", "axis": axis, "limits": limits}
        bodies.append({"name": name, "parent": bodies[-1]["name"], "joint": joint, "position": position, "mass": mass,
                       "com": (0.2, 0, 0), "inertia": (0.5, 1.0, 1.0, 0, 0, 0)})  # fmt: skip
    machine = flexopt.tree_from_dict(
        {
            "name": "tool",
            "bodies": bodies,
            "end_point": {"body": "roll", "position": (0.4, 0, 0), "rows": ("x", "y", "z")},
            "placement": ("x",),
            "capsules": [{"body": "roll", "start": (0.0, -off, 0), "end": (0.1, -off, 0), "radius": 0.05}],
        }
    )
    target, kept = (1.8, 0.3, 1.5), {"clearance": {"distance": 0.0, "ground": 1.2}}
    problem = flexopt.build_selection(machine, target, base=0.0, constraints=kept)
    assert held_otherwise(problem) == counts
    assert not held_otherwise(flexopt.build_selection(machine, target, base=0.0))
    x = ca.MX.sym("posture", 4)
    own = flexopt.Constraint(ca.Function("turned", [x], [x[3]], ["posture"], ["o"]), lower=-1.2, upper=1.2)
    assert held_otherwise(flexopt.build_selection(machine, target, base=0.0, constraints=[own]))
