"""Loops whose machine is known between two numbers: members, slopes, the slowest of the box."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

import flexopt
from flexopt.loop.settings import loop_settings
from flexopt.loop.small_motions import DEAD_TIME
from flexopt.loop.uncertain import UncertainLoop
from flexopt.loop.uncertainty_box import UncertaintyBox, matters_most
from flexopt.model import AnyMachine
from flexopt.model.loop import Loop
from flexopt.model.uncertainty import Uncertainty

KNOWN = (
    Uncertainty(of="stiffness", factor=(0.5, 2.0)),
    Uncertainty(of="payload.mass", value=(0.0, 100.0)),
    Uncertainty(of="dead_time", value=(0.0, 0.013)),
)
CASES = {
    "excavator": ((0.992, -1.4056), {"kp": 1e4, "kv": 1e3}),
    "slewing-excavator": ((0.2, 0.5, -1.2, -0.5), {"kp": 3e6, "kv": 6e5}),
    "mobile-manipulator": ((0.1, -1.0, 1.2, 0.3, 0.4, 0.1), {"kp": 1e4, "kv": 1e3}),
}


def made(name: str) -> UncertainLoop:
    posture, gains = CASES[name]
    machine = flexopt.load(name)
    stand = flexopt.evaluate(machine, posture)
    settings = loop_settings(machine, Loop(control="inverse", **gains), stand)
    return UncertainLoop(settings, stand.base, stand.posture, False, UncertaintyBox(machine, KNOWN, settings.dead_time))


@pytest.mark.long("slewing-excavator", "mobile-manipulator")
@pytest.mark.parametrize("name", CASES)
def test_a_member_is_the_machine_with_these_numbers(name: str) -> None:
    """Its file with the stiffness halved, evaluated by itself."""
    loop, machine = made(name), flexopt.load(name)
    u = np.array([0.0, 0.37, 0.61])
    told = loop.box.told(u)
    data = halved(machine.to_dict())
    data["payload"] = dict(data.get("payload", {})) | {"mass": told["payload.mass"]}
    other = type(machine).model_validate(data)
    posture, gains = CASES[name]
    found = flexopt.outcome(other, posture, loop=gains | {"dead_time": told["dead_time"]})
    assert loop.outcome(u).decay().value == pytest.approx(found.decay, rel=1e-9, abs=1e-9)
    assert told["stiffness"] == pytest.approx(0.5)


def halved(data: dict) -> dict:
    """Every spring of a passive coordinate, wherever a file has it."""
    if data.get("stiffness_matrix"):
        matrix = data["stiffness_matrix"]
        data["stiffness_matrix"] = matrix | {"matrix": tuple(tuple(x / 2 for x in row) for row in matrix["matrix"])}
    if "base" in data and "stiffness" in data["base"]:
        springs = {name: x / 2 for name, x in data["base"]["stiffness"].items()}
        data["base"] = data["base"] | {"stiffness": springs}
    bodies = [
        body | {"joint": body["joint"] | {"stiffness": body["joint"]["stiffness"] / 2}}
        if body["joint"].get("passive") and body["joint"].get("stiffness") else body
        for body in data.get("bodies", ())
    ]  # fmt: skip
    return data | ({"bodies": tuple(bodies)} if bodies else {})


@pytest.mark.long("mobile-manipulator")
@pytest.mark.parametrize("name", CASES)
def test_slopes_by_the_box(name: str) -> None:
    loop, u, step = made(name), np.array([0.31, 0.42, 0.33]), 1e-5
    outcome = loop.outcome(u)
    by = outcome.gradient(outcome.decay())
    slopes = loop.box.slopes(u, by["p"], float(by[DEAD_TIME][0]))
    central = [
        (loop.outcome(u + step * e).decay().value - loop.outcome(u - step * e).decay().value) / (2 * step)
        for e in np.eye(3)
    ]
    # Differences of second order at a step of 1e-5 keep some five digits.
    assert slopes == pytest.approx(central, rel=1e-4, abs=1e-5 * max(1.0, float(np.abs(slopes).max())))


@pytest.mark.parametrize("name", CASES)
def test_no_member_is_slower_than_the_slowest(name: str) -> None:
    loop = made(name)
    members = loop.box.members(16)
    assert len(members) == 16
    slowest, where = loop.slowest(members, loop.decays(members))
    assert slowest == pytest.approx(loop.outcome(where).decay().value, rel=1e-9)
    assert slowest <= loop.decays(loop.box.members(200, seed=5)).min() + 1e-9


# Name, mass, inertia about its axes, centre of mass; joint, kind, origin, axis.
SPRAYER = (
    ("carrier", 13000, (9000, 26000, 28000), "0.1 0 1.05", None),
    ("column", 500, (40, 45, 35), "0.05 0 0.2", ("slew", "revolute", "1.2 0 1.5", "0 0 1")),
    ("boom", 820, (30, 720, 720), "1.6 0 0.05", ("lift", "revolute", "0.1 0 0.4", "0 -1 0")),
    ("tele", 310, (8, 150, 150), "0.9 0 0", ("telescope", "prismatic", "1.6 0 0", "1 0 0")),
    ("second", 190, (4, 55, 55), "0.8 0 0.02", ("tilt", "revolute", "2 0 0", "0 -1 0")),
    ("nozzle", 75, (1, 3.5, 3.5), "0.25 0 0", ("swing", "revolute", "1.7 0 0", "0 -1 0")),
)


def sprayer(folder: Path) -> AnyMachine:
    """A manipulator for tunnel linings: five joints on a carrier that gives in six directions."""
    text, parent = "<robot name='sprayer'>", ""
    for name, mass, (xx, yy, zz), com, joint in SPRAYER:
        text += f"<link name='{name}'><inertial><origin xyz='{com}'/><mass value='{mass}'/><inertia ixx='{xx}' "
        text += f"iyy='{yy}' izz='{zz}' ixy='0' ixz='0' iyz='0'/></inertial></link>"
        if joint is not None:
            own, kind, origin, axis = joint
            text += f"<joint name='{own}' type='{kind}'><parent link='{parent}'/><child link='{name}'/><origin "
            text += (
                f"xyz='{origin}'/><axis xyz='{axis}'/><limit lower='-2' upper='2.2' effort='1e5' velocity='1'/></joint>"
            )
        parent = name
    (folder / "sprayer.urdf").write_text(text + "</robot>", encoding="utf-8")
    (folder / "sprayer.toml").write_text(
        """
name = "sprayer"
robot = "sprayer.urdf"
actuated = ["slew", "lift", "telescope", "tilt", "swing"]
placement = ["x", "y", "yaw"]
[base]
stiffness = { x = 5.0e6, y = 4.0e6, z = 9.0e6, roll = 1.4e7, pitch = 2.6e7, yaw = 2.0e7 }
damping = { x = 1.2e4, y = 1.1e4, z = 2.2e4, roll = 3.5e4, pitch = 7.0e4, yaw = 4.0e4 }
[end_point]
link = "nozzle"
offset = [0.5, 0.0, 0.0]
rows = ["x", "y", "z"]
""",
        encoding="utf-8",
    )
    return flexopt.load(folder / "sprayer.toml")


@pytest.mark.long
def test_a_pocket_in_which_two_frequencies_meet_is_found(tmp_path: Path) -> None:
    """At a stiffness of 1.2 a mode of the base comes to the frequency of the loop's own motion, which then grows.

    The slowest members lie elsewhere, at another payload; a line of members through the pocket knows how slow it is.
    """
    machine, posture = sprayer(tmp_path), np.array([0.23, 0.70, 0.60, -1.30, 0.60])
    loop = {"kp": 3.65e4, "kv": 1.369e4, "ki": 9125.0, "drive": "torque", "feedback": "pid", "rate": 100.0}
    settings = flexopt.outcome(machine, posture, loop=loop | {"dead_time": 0.03, "nullspace_damping": 80.0}).settings
    known = (
        Uncertainty(of="stiffness", factor=(0.5, 1.6)),
        Uncertainty(of="damping", factor=(0.4, 2.0)),
        Uncertainty(of="payload.mass", value=(0.0, 90.0)),
        Uncertainty(of="dead_time", value=(0.02, 0.05)),
    )
    uncertain = UncertainLoop(settings, np.zeros(3), posture, False, UncertaintyBox(machine, known, 0.03))
    members = uncertain.box.members(32)
    line = np.zeros((81, 4))
    line[:, 0], line[:, 3] = np.linspace(0.0, 1.0, 81), 1.0
    least = float(uncertain.decays(line).min())
    assert least < 0 < uncertain.decays(members).min()
    slowest, where = uncertain.slowest(members, uncertain.decays(members))
    assert slowest <= least
    assert slowest == pytest.approx(uncertain.outcome(where).decay().value, rel=1e-9)


def test_slopes_of_a_frequency() -> None:
    """Of each oscillation, by the box, beside differences."""
    loop, u, step = made("excavator"), np.array([0.31, 0.42, 0.33]), 1e-5
    at = loop.outcome(u)
    for k in np.flatnonzero(at.upper.imag > 0)[:3].tolist():
        omega = at.frequency(k)
        beside = [
            min((loop.outcome(u + sign * step * e).frequency(j).value for j in range(len(at.upper))),
                key=lambda value: abs(value - omega.value))
            for e in np.eye(3) for sign in (1, -1)
        ]  # fmt: skip
        central = (np.array(beside[::2]) - beside[1::2]) / (2 * step)
        assert loop.slopes(u, at, omega) == pytest.approx(central, rel=1e-4, abs=1e-5 * np.abs(central).max())


@pytest.mark.long("posture1-gains1", "posture2-gains2")
@pytest.mark.parametrize(
    ("posture", "gains"), [((0.94, -1.74), {"kp": 1e4, "kv": 1e3}), ((0.41, -1.19), {}), ((0.32, -1.19), {})]
)
def test_no_member_of_a_grid_allows_less_than_the_least_gain(
    posture: tuple[float, float], gains: dict[str, float]
) -> None:
    """What the gain may be is least at a corner in the last case alone."""
    machine = flexopt.load("excavator")
    stand = flexopt.evaluate(machine, posture)
    settings = loop_settings(machine, Loop(dead_time=0.03, **gains), stand)
    known = (Uncertainty(of="stiffness", factor=(0.6, 1.6)), Uncertainty(of="dead_time", value=(0.02, 0.05)))
    box = UncertaintyBox(machine, known, settings.dead_time)
    loop = UncertainLoop(settings, stand.base, stand.posture, False, box)
    corners = min(loop.outcome(u).allowed_gain().value for u in box.corners(2))
    members = box.members(64)
    _, slowest = loop.slowest(members, loop.decays(members))
    least = min([corners, *(gain for gain, _ in loop.lower_gains(members, corners, slowest))])
    side = np.linspace(0.0, 1.0, 6)
    grid = min(loop.outcome(np.array([a, b])).allowed_gain().value for a in side for b in side)
    assert least <= grid * (1 + 1e-9)
    assert (least < 0.99 * corners) == (posture != (0.32, -1.19))


@pytest.mark.long
def test_regions_end_where_the_loop_grows() -> None:
    """Just inside its radius a box is stable wherever it is looked at, and just outside it grows at a named point."""
    springs = [{"of": f"base.stiffness.{name}", "factor": (0.5, 2.0)} for name in ("x", "rotation")]
    ground = [*springs, {"of": "damping", "factor": (0.5, 2.0)}]
    machine, posture, gains = flexopt.load("excavator"), (0.0448, -2.0499), {"kp": 1e4, "kv": 1e3}
    found = flexopt.stable_region(machine, posture, loop=gains, ranges=ground, points=16)
    assert found.stable
    assert found.guaranteed
    assert 1.0 < found.radius_guaranteed <= found.radius
    assert 2.0 < found.radius < 10.0
    inside = [entry | {"factor": (1.001 / found.radius, 0.999 * found.radius)} for entry in ground]
    outside = [entry | {"factor": (0.998 / found.radius, 1.002 * found.radius)} for entry in ground]
    assert flexopt.stable_region(machine, posture, loop=gains, ranges=inside, points=60).decay > 0
    assert not flexopt.stable_region(machine, posture, loop=gains, ranges=outside, points=16).stable
    p = {name: value for name, value, _ in machine.parameters}
    factors = found.radius_critical
    data = machine.to_dict()
    data["base"]["stiffness"] = data["base"]["stiffness"] | {
        name: p[f"base.stiffness.{name}"] * factors[f"base.stiffness.{name}"] for name in ("x", "rotation")
    }
    data["base"]["damping"] = {name: factors["damping"] * x for name, x in data["base"]["damping"].items()}
    assert flexopt.outcome(flexopt.machine_from_dict(data), posture, loop=gains).decay < 0


def test_a_radius_without_factors_is_none() -> None:
    found = flexopt.stable_region(
        flexopt.load("excavator"), (0.0448, -2.0499), loop={"kp": 1e4, "kv": 1e3}, ranges={"payload.mass": (0, 50)}
    )
    assert np.isnan(found.radius)
    assert found.stable


def test_what_matters_most() -> None:
    loop = made("excavator")
    members = loop.box.members(32)
    assert matters_most(loop.box, members, (3 * members[:, 1] + 0.1 * members[:, 0]).tolist())[0] == "payload.mass"
    assert matters_most(loop.box, members, [1.0] * 32) == ("", 0.0)
    # What is large in the middle goes with nothing: its correlation is chance.
    name, rank = matters_most(loop.box, members, (-np.abs(members - 0.5).sum(axis=1)).tolist())
    assert name == ""
    assert 0 < abs(rank) < 0.5


@pytest.mark.parametrize("beside", [0.0, 4e-16, 2e-11])
def test_ends_of_intervals_are_told_as_they_were_given(beside: float) -> None:
    """Factors are the exponentials of logarithms, and searches come to an end to rounding; in between it is e^(ln …)."""
    ends = {"stiffness": (0.7, 1.4), "damping": (0.4, 1.6), "payload.mass": (3.1, 8.3), "dead_time": (0.007, 0.02)}
    known = [Uncertainty(of=name, factor=pair) for name, pair in ends.items() if name in ("stiffness", "damping")]
    known += [Uncertainty(of=name, value=pair) for name, pair in ends.items() if name not in ("stiffness", "damping")]
    box = UncertaintyBox(flexopt.load("excavator"), tuple(known), 0.01)
    for corner in itertools.product((0, 1), repeat=4):
        u = np.abs(np.array(corner) - beside)
        told = box.told(u)
        assert [repr(value) for value in told.values()] == [
            repr(ends[k][end]) for k, end in zip(ends, corner, strict=True)
        ]
    middle = box.told(np.full(4, 0.25))
    assert middle["damping"] == pytest.approx(0.4 * (1.6 / 0.4) ** 0.25)
    assert middle["payload.mass"] == pytest.approx(3.1 + 0.25 * (8.3 - 3.1))
    # A thousandth away is no end.
    assert box.told(np.full(4, 1e-3))["dead_time"] == pytest.approx(0.007 + 1e-3 * 0.013, rel=1e-12)


def test_a_motion_that_is_the_slowest_in_a_narrow_part_of_the_box_is_found() -> None:
    """Two motions come near to each other there; none of eight members, nor a search from the slowest, lies in it."""
    machine = flexopt.load("excavator")
    loop = flexopt.Loop(drive="torque", kp=(5860.0, 1039.0), kv=(3556.0, 2630.0), dead_time=0.03)
    evaluation = flexopt.evaluate(machine, [1.194, -1.224])
    settings = loop_settings(machine, loop, evaluation, gravity=False)
    ranges = (Uncertainty(of="stiffness", factor=(0.4, 2.5)), Uncertainty(of="dead_time", value=(0.01, 0.1)))
    box = UncertaintyBox(machine, ranges, settings.dead_time)
    uncertain = UncertainLoop(settings, evaluation.base, evaluation.posture, gravity=False, box=box)
    ends = np.linspace(0.0, 1.0, 41)
    everywhere = np.array([(a, b) for a in ends for b in ends])
    worst = float(uncertain.decays(everywhere).min())
    members = box.members(8)
    decays = uncertain.decays(members)
    assert decays.min() > worst / 4 > worst
    slowest, where = uncertain.slowest(members, decays)
    assert slowest <= worst + 1e-9
    assert uncertain.outcome(where).decay().value == pytest.approx(slowest)


def test_springs_that_hold_the_base_no_more_are_refused() -> None:
    """Told by an eigenvalue of the matrix itself; by each of the calls, with a loop and without."""
    machine, posture = flexopt.load("slewing-excavator"), CASES["slewing-excavator"][0]
    own = {each.name: each.value for each in machine.parameters}
    across = "stiffness.base.x.base.pitch"
    assert own["stiffness.base.x.base.z"] == 0
    # Pitch hangs on heave, too: of the three together the determinant is 0 there.
    heave = own["stiffness.base.z.base.pitch"] ** 2 / own["stiffness.base.z.base.z"]
    most = float(np.sqrt(own["stiffness.base.x.base.x"] * (own["stiffness.base.pitch.base.pitch"] - heave)))
    sentence = "ranges: the springs' stiffness matrix is not positive definite where stiffness.base.x.base.pitch is"
    for share, refused in ((0.99, False), (1.01, True)):
        box = UncertaintyBox(machine, (Uncertainty(of=across, value=(0.0, share * most)),), 0.0)
        assert bool(box.indefinite()) == refused
    ranges, loop = {across: (0.0, 1.01 * most), "payload.mass": (900.0, 1100.0)}, {"kp": 3e6, "kv": 6e5}
    with pytest.raises(flexopt.InputError, match=sentence):
        flexopt.sensitivity(machine, posture, ranges=ranges, samples=64)
    with pytest.raises(flexopt.InputError, match=sentence):
        flexopt.sensitivity(machine, posture, ranges=ranges, samples=64, loop=loop)
    with pytest.raises(flexopt.InputError, match=sentence):
        flexopt.stable_region(machine, posture, ranges=ranges, loop=loop)
    data = machine.to_dict()
    held = data["stiffness_matrix"]["joints"]
    of_joint = {body["joint"]["name"]: body["joint"] for body in data["bodies"] if body["joint"]["name"] in held}
    dampers = np.diag([of_joint[name].pop("damping") for name in held])
    matrix = flexopt.tree_from_dict(data | {"damping_matrix": {"joints": held, "matrix": dampers.tolist()}})
    for most, word in ((1e3, None), (1e6, "damping.base.x.base.pitch is 1e+06 N s")):
        box = UncertaintyBox(matrix, (Uncertainty(of="damping.base.x.base.pitch", value=(0.0, most)),), 0.0)
        told = [fault.sentence for fault in box.indefinite()]
        assert told == ([] if word is None else [f"the dampers' matrix is not positive semidefinite where {word}"])


@pytest.mark.long("posture0-5839.0-336.0", "posture2-8209.0-344.0")
@pytest.mark.parametrize(
    ("posture", "kp", "kv"),
    [((1.2894, -1.7237), 5839.0, 336.0), ((1.1378, -0.9658), 1156.0, 664.0), ((1.0962, -1.2049), 8209.0, 344.0)],
)
def test_the_least_delay_margin_lies_between_members(posture: tuple[float, float], kp: float, kv: float) -> None:
    """At a stiffness within, where corners and few members bear up to a quarter more; against a fine grid."""
    machine = flexopt.load("excavator")
    stand = flexopt.evaluate(machine, posture, base=[0.0])
    settings = loop_settings(machine, Loop(control="inverse", kp=kp, kv=kv, rate=100.0, dead_time=0.0), stand)
    known = (Uncertainty(of="stiffness", factor=(0.4, 2.5)), Uncertainty(of="damping", factor=(1.0, 4.0)))
    loop = UncertainLoop(settings, stand.base, stand.posture, False, UncertaintyBox(machine, known, 0.0))
    members = loop.box.members(8)
    few = [(loop.outcome(u), u) for u in loop.box.corners(2)]
    values, further = loop.worst("delay_margin", few, members, members[0])
    least = min([*values, *(value for value, _ in further)])
    grid = [loop.outcome(np.array([x, 0.0])).delay_margin().value for x in np.linspace(0.0, 1.0, 101)]
    assert least < 0.97 * min(values)
    assert least <= 1.01 * min(grid)
    at = min(further)[1]
    assert loop.outcome(at).delay_margin().value == pytest.approx(least, rel=1e-9)


@pytest.mark.long("posture0-9300000.0-1060000.0", "posture2-8100000.0-990000.0")
@pytest.mark.parametrize(
    ("posture", "kp", "kv"),
    [
        ((0.46, 0.85, -0.88, -0.33), 9.30e6, 1.06e6),
        ((0.16, 0.68, -1.26, -0.68), 16.51e6, 1.41e6),
        ((0.53, 0.88, -1.03, -0.2), 8.10e6, 0.99e6),
    ],
)
def test_the_longest_settling_lies_between_members(posture: tuple[float, ...], kp: float, kv: float) -> None:
    """At a stiffness within, where an excursion still leaves the band, by up to a quarter later; against a grid."""
    machine = flexopt.load("slewing-excavator")
    stand = flexopt.evaluate(machine, posture)
    settings = loop_settings(machine, Loop(control="inverse", kp=kp, kv=kv, rate=100.0, dead_time=0.0), stand)
    known = (Uncertainty(of="stiffness", factor=(0.5, 2.0)), Uncertainty(of="damping", factor=(0.7, 4.0)))
    loop = UncertainLoop(settings, stand.base, stand.posture, False, UncertaintyBox(machine, known, 0.0))
    few = [(loop.outcome(u), u) for u in [*loop.box.corners(2), loop.least_decay[1]]]
    values, further = loop.worst("settling", few, loop.box.members(8), loop.least_decay[1])
    longest, at = max(further, key=lambda each: each[0])
    levels = np.linspace(0.0, 1.0, 26)
    grid = [loop.outcome(np.array([x, y])).settling().value for x in levels for y in (0.0, 0.5, 1.0)]
    assert longest > 1.02 * max(values)
    # A jump may lie up to a twentieth of the interval from the nearest member of a line.
    assert longest >= 0.99 * max(grid)
    assert loop.outcome(at).settling().value == pytest.approx(longest, rel=1e-9)


def box_of(names: tuple[str, ...]) -> UncertaintyBox:
    """Of parameters of the excavator, each from 1 to 2 of its unit."""
    known = tuple(Uncertainty(of=name, value=(1.0, 2.0)) for name in names)
    return UncertaintyBox(flexopt.load("excavator"), known, 0.0)


NAMES = tuple(each.name for each in flexopt.load("excavator").parameters if each.value > 0)[:7]


@pytest.mark.parametrize(("count", "most", "together"), [
    (3, 3, 3), (4, 3, 3), (7, 3, 2), (5, 4, 3), (7, 4, 3), (6, 5, 5), (3, 1, 1), (3, 2, 2), (5, 2, 1),
])  # fmt: skip
def test_few_corners_have_the_ends_of_so_many_intervals_in_every_way(count: int, most: int, together: int) -> None:
    corners = box_of(NAMES[:count]).corners(most)
    assert len(corners) == 2 ** min(count, most)
    for columns in itertools.combinations(range(count), together):
        seen, times = np.unique(corners[:, columns], axis=0, return_counts=True)
        assert len(seen) == 2**together
        assert len(set(times.tolist())) == 1


@pytest.mark.parametrize("runs", [1, 2, 3, 4, 16])
def test_members_are_the_same_in_whatever_order_intervals_are_named(runs: int) -> None:
    """And of those that are run both ends of every interval, where more than one is."""
    names = NAMES[:5]
    first = box_of(names).members(64, 3, runs)
    assert len(np.unique(first, axis=0)) == len(first) == 64
    np.testing.assert_array_equal(first[:runs].min(axis=0), 0.0)
    if runs > 1:
        np.testing.assert_array_equal(first[:runs].max(axis=0), 1.0)
    order = np.random.default_rng(runs).permutation(5)
    again = box_of(tuple(names[k] for k in order)).members(64, 3, runs)
    np.testing.assert_array_equal(again, first[:, order])


def test_what_a_choice_by_the_worst_counts_beside_its_ranges_is_said() -> None:
    """The machine's own numbers are always among the members."""
    machine = flexopt.load("excavator")
    own = {each.name: each.value for each in machine.parameters}

    def told(*each: Uncertainty) -> str:
        return UncertaintyBox(machine, each, 0.01).judged_over

    mass, late = own["base.mass"], Uncertainty(of="dead_time", value=(0.0, 0.02))
    inside = Uncertainty(of="base.mass", value=(0.5 * mass, 2 * mass))
    outside = Uncertainty(of="base.mass", value=(1.5 * mass, 2 * mass))
    assert told() == ""
    assert told(inside, late) == "base.mass, dead_time"
    assert told(outside, late) == "base.mass, dead_time, and with the own numbers, which lie outside"
