"""Slips of unit: each one, put into every shipped machine and into random ones, is told by the right word."""

from __future__ import annotations

import copy
import itertools
import json
import math
import re
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import flexopt
from flexopt import FlexoptError, ImplausibleMachine, InputError, ModelError, machine_from_dict, tree_from_dict
from flexopt.cli.commands import cli
from flexopt.model import AnyMachine
from flexopt.model.plausibility import implausible_numbers
from tests.model.robots.files import URDF, URDF_MACHINE, changed_text, read
from tests.oracles.spatial import grounded, in_space, matrix_of, six
from tests.study.machines import gantry

SHIPPED = ["excavator", "boom-stick-bucket", "slewing-excavator", "truck-crane", "mobile-manipulator"]
DEGREES = 180 / math.pi
Data = dict[str, Any]


def built(data: Data) -> AnyMachine:
    return tree_from_dict(data) if "bodies" in data else machine_from_dict(data)


def told(data: Data) -> list[str]:
    """What a user is told about the machine: the findings, or the faults where it is refused."""
    try:
        return [str(finding) for finding in flexopt.check(built(data)).findings]
    except ModelError as error:
        return [str(fault) for fault in error.faults]


def plausible_machine(seed: int) -> Data:
    """A machine of any size from a hand's reach to a large crane's, its numbers as machines have them."""
    rng = np.random.default_rng(seed)
    count, reach = int(rng.integers(2, 5)), float(10 ** rng.uniform(-0.3, 1.5))
    shares = rng.uniform(0.5, 1.5, count)
    lengths = reach * shares / shares.sum()
    mass = reach**2 * float(10 ** rng.uniform(1, 2.5))
    links = []
    for k, length in enumerate(lengths):
        own = 0.3 * mass * float(rng.uniform(0.5, 1)) / (count * (k + 1))
        inertia = own * (float(rng.uniform(0.22, 0.31)) * length) ** 2
        low = float(rng.uniform(-2.5, 0.0))
        links.append(
            {"name": f"link{k}", "length": float(length), "com": float(length * rng.uniform(0.4, 0.6)), "mass": own,
             "inertia": inertia, "limits": [low, low + float(rng.uniform(1.0, 2.5))]}
        )  # fmt: skip
    for k, link in enumerate(links):
        arms = [sum(lengths[k:i]) + links[i]["com"] for i in range(k, count)]
        holding = 9.81 * sum(arm * one["mass"] for arm, one in zip(arms, links[k:], strict=True))
        link |= {"effort": holding * float(rng.uniform(1.2, 4)), "speed": float(rng.uniform(0.5, 3)) / reach}
    height, chassis = float(rng.uniform(0.05, 0.2)) * reach, 0.7 * mass
    # Under its weight the machine sinks by 0.05 to 3 % of its reach.
    frequency = math.sqrt(9.81 / (reach * 10 ** rng.uniform(-3.3, -1.5))) / (2 * math.pi)
    stiffness = mass * (2 * math.pi * frequency) ** 2
    ratio, size = float(rng.uniform(0.001, 0.1)), float(rng.uniform(0.3, 0.6)) * reach
    springs = {"x": stiffness, "y": stiffness, "rotation": stiffness * size**2}
    damper = 2 * ratio * mass * 2 * math.pi * frequency
    base = {
        "length": height, "com": height * float(rng.uniform(0.3, 1)), "mass": chassis,
        "inertia": chassis * (size / 3) ** 2, "rest_angle": float(rng.uniform(1.2, 1.9)), "stiffness": springs,
        "damping": {"x": damper, "y": damper, "rotation": damper * size**2},
    }  # fmt: skip
    return {"name": f"machine {seed}", "base": base, "links": links}


def bodies(data: Data) -> list[Data]:
    return [body for body in [data.get("base"), *data.get("links", ()), *data.get("bodies", ())] if body]


def arm(data: Data) -> list[Data]:
    """Links between joints."""
    if "links" in data:
        return data["links"]
    driven: set[str] = set()
    for body in data["bodies"]:
        if not body["joint"].get("passive") or body.get("parent") in driven:
            driven.add(body["name"])
    return [body for body in data["bodies"] if body["name"] in driven]


def springs(data: Data) -> Iterator[tuple[Data, Any]]:
    """Each stiffness as the table or matrix that holds it, and its key."""
    for body in bodies(data):
        table = body.get("joint", body).get("stiffness")
        if isinstance(table, dict):
            yield from ((table, key) for key in table)
        elif table is not None:
            yield body.get("joint", body), "stiffness"


def scaled(value: Any, factor: float) -> Any:
    return [scaled(part, factor) for part in value] if isinstance(value, list | tuple) else value * factor


def kilonewton_for_one_spring(data: Data, rng: np.random.Generator) -> None:
    found = list(springs(data))
    if found:
        table, key = found[rng.integers(len(found))]
        table[key] /= 1000
    else:
        kilonewtons(data, rng)


def kilonewtons(data: Data, rng: np.random.Generator) -> None:
    for table, key in springs(data):
        table[key] /= 1000
    if data.get("stiffness_matrix"):
        data["stiffness_matrix"]["matrix"] = scaled(data["stiffness_matrix"]["matrix"], 1e-3)


def millimetres(data: Data, rng: np.random.Generator) -> None:
    for body in bodies(data):
        for key in ("length", "com", "com_offset", "position"):
            if key in body:
                body[key] = scaled(body[key], 1000.0)
    if "end_point" in data:
        data["end_point"]["position"] = scaled(data["end_point"].get("position", [0.0] * 3), 1000.0)
    for key in ("capsules", "cylinders", "support"):
        data.pop(key, None)


def millimetres_of_a_centre(data: Data, rng: np.random.Generator) -> None:
    body = arm(data)[rng.integers(len(arm(data)))]
    body["com"] = scaled(body["com"], 1000.0)


def tonnes(data: Data, rng: np.random.Generator) -> None:
    for body in bodies(data):
        for key in ("mass", "inertia"):
            if key in body:
                body[key] = scaled(body[key], 1e-3)


def tonnes_beside_kilogram_inertia(data: Data, rng: np.random.Generator) -> None:
    for body in bodies(data):
        if "mass" in body:
            body["mass"] /= 1000


def tonnes_of_a_link(data: Data, rng: np.random.Generator) -> None:
    arm(data)[rng.integers(len(arm(data)))]["mass"] /= 1000


def tonnes_of_the_base(data: Data, rng: np.random.Generator) -> None:
    """The body that weighs most of those the arm does not carry."""
    carried = [id(body) for body in arm(data)]
    base = max((b for b in bodies(data) if id(b) not in carried), key=lambda body: body.get("mass", 0.0))
    base["mass"] /= 1000


def tonne_square_metres(data: Data, rng: np.random.Generator) -> None:
    for body in bodies(data):
        body["inertia"] = scaled(body.get("inertia", 1.0), 1e-3)


def about_the_pivots(data: Data, rng: np.random.Generator) -> None:
    for body in arm(data):
        if "bodies" not in data:
            body["inertia"] += body["mass"] * (body["com"] ** 2 + body.get("com_offset", 0.0) ** 2)
        elif "mass" in body:
            centre = np.array(body.get("com", [0.0] * 3))
            shift = body["mass"] * (centre @ centre * np.eye(3) - np.outer(centre, centre))
            body["inertia"] = six(matrix_of(body.get("inertia", [0.0] * 6)) + shift)


def degrees(data: Data, rng: np.random.Generator) -> None:
    turned = 0
    for body in arm(data):
        joint = body.get("joint", body)
        if joint.get("limits") and joint.get("kind", "hinge") == "hinge":
            joint["limits"] = scaled(joint["limits"], DEGREES)
            turned += 1
    if not turned:
        data["base"]["rest_angle"] *= DEGREES


def kilonewton_metres(data: Data, rng: np.random.Generator) -> None:
    for body in arm(data):
        joint = body.get("joint", body)
        joint["effort"] = joint.get("effort", 1.0) / 1000


def degrees_per_second(data: Data, rng: np.random.Generator) -> None:
    for body in arm(data):
        joint = body.get("joint", body)
        joint["speed"] = joint.get("speed", 2.0) * DEGREES


def dampers(data: Data, rng: np.random.Generator) -> None:
    """Ten times the critical damping, from the modes themselves."""
    machine = built(data)
    posture = [0.5 * (max(low, -1.0) + min(high, 1.0)) + 0.1 for low, high in machine.limits]
    values = flexopt.build_measures(machine).values(posture=posture, p=[p.value for p in machine.parameters])
    worst = float(values["zeta"].full().min())
    for body in bodies(data):
        table = body.get("joint", body)
        if table.get("damping") is not None and (table is body or table.get("passive")):
            given = table["damping"]
            factor = 30.0 / worst
            table["damping"] = {k: v * factor for k, v in given.items()} if isinstance(given, dict) else given * factor
    if data.get("damping_matrix"):
        data["damping_matrix"]["matrix"] = scaled(data["damping_matrix"]["matrix"], 30.0 / worst)


SLIPS: dict[str, tuple[Callable[[Data, np.random.Generator], None], str]] = {
    "kN for one spring": (kilonewton_for_one_spring, r"probably in kN"),
    "kN for all springs": (kilonewtons, r"probably in kN"),
    "mm": (millimetres, r"in mm"),
    "mm for one centre of mass": (millimetres_of_a_centre, r"in mm"),
    "tonnes": (tonnes, r"in tonnes"),
    "tonnes and kg m²": (tonnes_beside_kilogram_inertia, r"in tonnes"),
    "tonnes of one link": (tonnes_of_a_link, r"in tonnes"),
    "tonnes of the base": (tonnes_of_the_base, r"in tonnes"),
    "inertia about the pivots": (about_the_pivots, r"about the pivot"),
    "degrees": (degrees, r"degrees"),
    "kN m": (kilonewton_metres, r"probably in kN"),
    "degrees per second": (degrees_per_second, r"degrees/s"),
    "dampers": (dampers, r"of critical.*dampers are probably"),
}  # fmt: skip


def shipped(name: str) -> Data:
    data = json.loads(json.dumps(flexopt.load(name).to_dict()))
    if name == "excavator":
        for link in data["links"]:  # it has neither drives nor limits
            link |= {"effort": 6e4, "speed": 0.6, "limits": [-2.5, 1.5]}
    return data


@pytest.mark.parametrize("slip", SLIPS)
@pytest.mark.parametrize("name", SHIPPED)
def test_slips_in_shipped_machines(name: str, slip: str) -> None:
    spoil, word = SLIPS[slip]
    data = shipped(name)
    assert told(data) == []
    spoil(data, np.random.default_rng(1))
    sentences = told(data)
    assert any(re.search(word, sentence) for sentence in sentences), sentences


@pytest.mark.parametrize(("prefix", "factor", "per_mm"), [("k", 1e-3, "N/mm"), ("M", 1e-6, "kN/mm")])
@pytest.mark.parametrize("name", ["excavator", "boom-stick-bucket"])
def test_the_prefix_of_a_stiffness_is_that_at_which_the_machine_stands(
    name: str, prefix: str, factor: float, per_mm: str
) -> None:
    """Of a stiffness in MN/m, kN/m would let it sink by metres."""
    for key, unit in (("y", f"N/m or {per_mm}"), ("rotation", "N m/rad")):
        data = shipped(name)
        if key not in (table := data["base"]["stiffness"]):
            continue
        own = table[key]
        table[key] = factor * own
        (sentence,) = [each for each in told(data) if f"base.stiffness.{key} = " in each]
        assert f"probably in {prefix}{unit}: {own:g} " in sentence


@pytest.mark.parametrize(("key", "factor", "word"), [("force", 1e-3, "in kN"), ("speed", 1e3, "in mm/s")])
@pytest.mark.parametrize("name", ["boom-stick-bucket", "slewing-excavator"])
def test_slips_of_cylinders(name: str, key: str, factor: float, word: str) -> None:
    """Each cylinder by itself, and what was meant with its number."""
    for k, own in enumerate(shipped(name)["cylinders"]):
        data = shipped(name)
        data["cylinders"][k][key] = scaled(own[key], factor)
        (sentence,) = told(data)
        assert sentence.startswith(f"cylinders[{k}] ({own['name']}).{key} = {factor * max(own[key]):g} ")
        assert f"probably {word}: {max(own[key]):g} " in sentence


def test_a_tool_at_the_end_of_a_long_boom_is_quick() -> None:
    """A short lever moves the tool alone, 1.7 m, however far the boom reaches."""
    data = shipped("boom-stick-bucket")
    for link, length in zip(data["links"], (14.0, 12.0), strict=False):
        link |= {"length": length, "com": length / 2, "com_offset": 0.0, "inertia": link["mass"] * length**2 / 12}
    data["links"][2]["limits"] = [-0.9, 0.9]
    data["cylinders"] = [
        {"name": "tool cylinder", "joint": "bucket", "base_point": [11.5, 0.06], "rod_point": [0.0, 0.06],
         "length": [0.4, 0.6], "speed": [0.5, 0.4], "force": [2e5, 3e5]}
    ]  # fmt: skip
    assert not any("cylinder" in sentence for sentence in told(data))


@pytest.mark.long("dampers")
@pytest.mark.parametrize("slip", SLIPS)
def test_slips_in_random_machines(slip: str) -> None:
    """In the plane and in space; each finding of a link names it."""
    spoil, word = SLIPS[slip]
    missed = []
    for seed in range(20):
        data = plausible_machine(seed)
        data = _in_space(data) if seed % 2 and slip != "degrees" else data
        spoil(data, np.random.default_rng(seed))
        sentences = told(data)
        missed += [] if any(re.search(word, sentence) for sentence in sentences) else [(seed, sentences)]
        names = [body.get("name", "base") for body in bodies(data)] + [
            b["joint"]["name"] for b in data.get("bodies", ())
        ]
        assert all(any(name in sentence for name in [*names, "mass", "mode", "end-point"]) for sentence in sentences)
    # A spring may be so stiff that a thousandth of it still carries the machine: of soft machines the slip is told.
    assert len(missed) <= (4 if "kN" in slip else 1), missed


def _in_space(data: Data) -> Data:
    tree = in_space(data | {"end_point": {}, "gravity": 9.81})
    for body, link in zip(tree["bodies"][-len(data["links"]) :], data["links"], strict=True):
        body["joint"] |= {key: link[key] for key in ("limits", "effort", "speed")}
    return tree


@pytest.mark.long
def test_plausible_machines_are_not_warned_of() -> None:
    spoken = {}
    for seed in range(200):
        data = plausible_machine(seed)
        sentences = told(_in_space(data) if seed % 4 == 3 else data)
        if sentences:
            spoken[seed] = sentences
    assert len(spoken) <= 2, spoken


@pytest.mark.parametrize("name", [*SHIPPED, "article", "trench", "pipe-laying", "stations", "article-a", "article-b"])
def test_nothing_shipped_is_warned_of(name: str) -> None:
    found = flexopt.check(name)
    assert (found.status, found.findings, found.faults, found.warnings) == ("good", (), (), ())


def test_what_was_meant_is_told_with_its_number() -> None:
    data = shipped("boom-stick-bucket")
    stick = data["links"][1]
    stick["inertia"] += stick["mass"] * (stick["com"] ** 2 + stick["com_offset"] ** 2)
    data["base"]["stiffness"]["y"] /= 1000
    found = flexopt.check(built(data)).findings
    assert [finding.field for finding in found] == ["base.stiffness.y", "links[1] (stick).inertia"]
    assert found[0].value == "45200 N/m"
    assert "kN/m or N/mm: 4.52e+07 N/m" in found[0].meant
    assert "is some 1.1e+03 kg m²" in found[1].meant


def spoiled() -> AnyMachine:
    data = shipped("excavator")
    kilonewtons(data, np.random.default_rng(0))
    return built(data)


@pytest.mark.parametrize("name", SHIPPED)
def test_an_inertia_about_the_pivot_is_told_with_the_one_about_the_centre(name: str) -> None:
    """By the parallel axis theorem: what the file had before it was shifted."""
    data = shipped(name)
    given = {body["name"]: body.get("inertia") for body in arm(data)}
    about_the_pivots(data, np.random.default_rng(0))
    sentences = [sentence for sentence in told(data) if "about the pivot" in sentence]
    assert sentences
    for sentence in sentences:
        inertia = next(value for called, value in given.items() if called in sentence.split("=")[0])
        largest = inertia if np.isscalar(inertia) else float(np.linalg.eigvalsh(matrix_of(inertia))[-1])
        assert sentence.endswith(f"about which it is some {largest:.3g} kg m²")


def test_an_inertia_that_is_possible_about_the_centre_alone_is_not_called_one_about_the_pivot() -> None:
    """A wrist of the Unitree Z1 as its maker's file has it: about the joint no body has these moments."""
    data = grounded(3, 0)
    wrist = [1.7605e-4, 5.5896e-4, 5.386e-4, 4e-7, 5.689e-5, -1.3e-7]
    centre, mass = np.array([0.03121533, 0.0, 0.00646316]), 0.38938492
    about = np.linalg.eigvalsh(matrix_of(wrist) - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre)))
    assert about[0] > 0
    assert about[0] + about[1] < about[2]
    arm1 = next(body for body in data["bodies"] if body["name"] == "arm1")
    # 40 times as large: as long as its neighbour is far.
    arm1 |= {"mass": mass * 40**3, "com": (40 * centre).tolist(), "inertia": scaled(wrist, 40**5)}
    next(body for body in data["bodies"] if body["name"] == "arm2")["position"] = [40 * 0.0492, 0.0, 0.0]
    assert not [sentence for sentence in told(data) if "arm1'.inertia" in sentence]
    # One that a body may have about its joint is told of.
    arm1["inertia"] = scaled(wrist, 1.3 * 40**5)
    possible = [sentence for sentence in told(data) if "arm1'.inertia" in sentence]
    assert [sentence for sentence in possible if "about the pivot" in sentence]


RAM = 420.0 * np.array([0.03, 1.8**2 / 12, 1.8**2 / 12])  # a bar of 1.8 m, kg m²


@pytest.mark.parametrize("centre", [-0.4, 0.0, 0.25])
@pytest.mark.parametrize("end", [None, 0.4])
def test_a_ram_is_not_judged_as_a_link_between_pivots(centre: float, end: float | None) -> None:
    """It slides through its joint, behind which it reaches far; what is off by a thousand is told all the same."""
    data = gantry()
    if end is not None:
        data["capsules"] = [{"body": "ram", "start": [centre - 0.8, 0, 0], "end": [end, 0, 0], "radius": 0.2}]
    ram = next(body for body in data["bodies"] if body["name"] == "ram")
    ram |= {"com": [centre, 0.0, 0.0], "inertia": [*RAM.tolist(), 0.0, 0.0, 0.0]}
    assert told(data) == []
    for key, factor, meant in (
        ("mass", 1e-3, "the mass may be in tonnes, 420 kg"),
        ("inertia", 1e6, "the inertia in kg mm², 113.4 kg m²"),
    ):
        wrong = copy.deepcopy(data)
        next(body for body in wrong["bodies"] if body["name"] == "ram")[key] = scaled(ram[key], factor)
        (sentence,) = (sentence for sentence in told(wrong) if sentence.startswith("body 'ram'.inertia"))
        assert meant in sentence


def test_results_warn_once_each() -> None:
    machine = spoiled()
    for call in (
        lambda: flexopt.evaluate(machine, (0.5, -1.0)),
        lambda: flexopt.select(machine, (0.0, 1.6), starts=1, workers=1),
        lambda: flexopt.select_stand(machine, [(0.0, 1.6), (0.5, 1.6)], starts=1, workers=1),
    ):
        with pytest.warns(
            ImplausibleMachine, match=r"2 numbers are not plausible .`flexopt check` tells all."
        ) as caught:
            call()
        assert sum(issubclass(warning.category, ImplausibleMachine) for warning in caught) == 1
    with pytest.warns(ImplausibleMachine) as caught:
        flexopt.evaluate(machine, (0.5, -1.0))
    assert caught[0].filename == __file__


@pytest.mark.parametrize(
    ("name", "joint", "sinks"),
    [("excavator", "x", False), ("excavator", "y", True), ("truck-crane", "base.x", False),
     ("truck-crane", "base.z", True), ("truck-crane", "base.yaw", False), ("truck-crane", "base.roll", True)],
)  # fmt: skip
def test_what_carries_no_weight_may_be_soft(name: str, joint: str, sinks: bool) -> None:
    """Moorings, or rubber about the upright axis: nothing sinks on them."""
    data = shipped(name)
    if name == "excavator":
        data["base"]["stiffness"][joint] = 4e4
    else:
        coupled = data["stiffness_matrix"]
        k = coupled["joints"].index(joint)
        coupled["matrix"][k] = [0.0] * 6
        for row in coupled["matrix"]:
            row[k] = 0.0
        coupled["matrix"][k][k] = 3e4 if joint in ("base.x", "base.z") else 1e5
    assert any("the spring" in sentence for sentence in told(data)) == sinks


def test_a_base_that_rests_on_its_side_has_a_slew_drive_that_lifts() -> None:
    """Its axis is level then, and the drive holds the arm's weight."""
    for rest, told_of in ((0.0, False), (math.pi / 2, True)):
        data = shipped("truck-crane")
        joints = {body["joint"]["name"]: body["joint"] for body in data["bodies"]}
        joints["base.pitch"]["rest"] = rest
        joints["slew"]["effort"] = 500.0
        assert any("slew'.effort" in sentence for sentence in told(data)) == told_of, told(data)


def test_a_good_machine_is_evaluated_in_silence() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        flexopt.evaluate(flexopt.load("excavator"), (0.5, -1.0))


def test_angles_beyond_any_turn_ask_for_degrees(tmp_path: Path) -> None:
    data = shipped("boom-stick-bucket")
    data["base"]["rest_angle"] *= DEGREES
    assert "is it in degrees?" in told(data)[0]
    data = shipped("slewing-excavator")
    data["bodies"][-1]["joint"]["limits"] = [-145.0, 30.0]
    assert "is it in degrees?" in told(data)[0]
    text = changed_text(URDF, 'lower="-0.5" upper="1.4"', 'lower="-30" upper="80"')
    with pytest.warns(
        flexopt.FlexoptWarning, match=r"joint 'boom': limits -30 to 80 rad .* in degrees .* -0.5236 to 1.396 rad"
    ):
        read(tmp_path, text, URDF_MACHINE)


def test_problems_and_experiments(tmp_path: Path) -> None:
    (tmp_path / "far.toml").write_text('name = "far"\nmachine = "excavator"\n[target]\nend_point = [0, 1600]\n')
    found = flexopt.check(tmp_path / "far.toml")
    assert (found.kind, found.machine, found.status) == ("problem", "excavator", "warnings")
    assert "probably in mm" in found.findings[0].meant
    (tmp_path / "run.toml").write_text(
        'name = "run"\nmachine = "excavator"\n[simulation]\nbase = 0.0\nposture = [0.5, -1.0]\noffset = [5.0, 0.0]\n'
    )
    assert "probably degrees" in flexopt.check(str(tmp_path / "run.toml")).findings[0].meant


@pytest.mark.parametrize("value", [None, 3, [], {}, object()])
def test_what_cannot_be_checked(value: Any) -> None:
    with pytest.raises(InputError, match="machine_or_path"):
        flexopt.check(value)


def test_faults_of_files_are_part_of_the_result(tmp_path: Path) -> None:
    assert flexopt.check("excavtor").faults[0].sentence.count("did you mean 'excavator'?") == 1
    (tmp_path / "arm.urdf").write_text(changed_text(URDF, 'lower="-0.5"', 'lover="-0.5"'))
    (tmp_path / "arm.sdf").write_text("<sdf version='1.7'/>")
    assert "convert SDF to URDF first" in repr(flexopt.check(tmp_path / "arm.sdf"))
    robot = flexopt.check(tmp_path / "arm.urdf")
    assert (robot.kind, robot.status) == ("robot", "faults")
    assert "did you mean 'lower'?" in robot.faults[0].sentence
    broken = tmp_path / "broken.toml"
    broken.write_text('name = "a"\nmas = 3\n[base]\n')
    assert len(flexopt.check(broken).faults) > 5


def run(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(cli, ["check", *arguments], standalone_mode=False)
    if isinstance(result.exception, FlexoptError):
        raise result.exception
    return (result.exit_code, result.stdout)


def test_the_command(tmp_path: Path) -> None:
    assert run("excavator") == (0, "machine 'excavator': nothing to mend\n")
    text = (Path(__file__).parents[2] / "models" / "excavator.toml").read_text()
    soft = tmp_path / "soft.toml"
    soft.write_text(text.replace("1.112e6 ", "1.112e3 "))
    code, output = run(str(soft))
    assert (code, output.count("hardly meant: ")) == (0, 1)
    code, output = run(str(soft), "--json")
    document = json.loads(output)
    assert (code, document["status"], document["findings"][0]["field"]) == (0, "warnings", "base.stiffness.rotation")
    soft.write_text(text.replace("mass = 766.6", "mas = 766.6"))
    code, output = run(str(soft), "--json")
    assert (code, json.loads(output)["status"]) == (2, "faults")
    assert run(str(soft))[0] == 2


def test_mutating_does_not_touch_the_original() -> None:
    data = plausible_machine(3)
    before = copy.deepcopy(data)
    _in_space(data)
    assert data == before


def test_an_end_point_in_its_bodys_joint_leaves_the_body_without_a_length() -> None:
    """As of a telescope whose tool's place is not told yet: its centre of mass, 3 m out, is no slip; 3000 m is one."""
    data = flexopt.load("truck-crane").to_dict()
    last = next(body for body in data["bodies"] if body["name"] == data["end_point"]["body"])
    data["end_point"]["position"] = [0.0, 0.0, 0.0]
    last["com"] = [2.0, 0.0, 0.0]
    found = [finding.field for finding in flexopt.check(tree_from_dict(data)).findings]
    assert not any(field.endswith(".com") for field in found)
    last["com"] = [2000.0, 0.0, 0.0]
    found = [finding.field for finding in flexopt.check(tree_from_dict(data)).findings]
    assert any(field.endswith(".com") for field in found)


def test_a_chassis_far_behind_the_foot_of_its_arm_is_none_in_mm_where_its_inertia_says_how_large_it_is() -> None:
    """As in the file of a loader whose root frame is where the arm stands, well before the middle."""
    data = flexopt.load("slewing-excavator").to_dict()
    names = {body["name"]: body for body in data["bodies"]}
    carrier = names[next(body["parent"] for body in data["bodies"] if body["joint"]["name"] == "slew")]
    slew = next(body for body in data["bodies"] if body["joint"]["name"] == "slew")
    slew["position"], data["capsules"] = [0.0, 0.0, 0.15], []
    far = {"mass": 15800.0, "inertia": [14500.0, 61000.0, 64000.0, 0.0, 900.0, 0.0]}

    def findings(com: list[float], inertia: float = 1.0) -> list[str]:
        carrier.update(far | {"com": com, "inertia": (inertia * np.array(far["inertia"])).tolist()})
        return [
            finding.field for finding in flexopt.check(tree_from_dict(data)).findings if finding.field.endswith(".com")
        ]

    assert findings([-2.35, 0.72, 0.30]) == []
    # Too far for a body so small, and beyond all the arm's reach, whatever the unit of the inertia is.
    assert findings([-2.35, 0.72, 0.30], 1e-2) != []
    assert findings([-1350.0, 720.0, 300.0]) != []
    assert findings([-1350.0, 720.0, 300.0], 1e6) != []


def test_a_machine_whose_payload_is_all_its_mass_is_checked() -> None:
    """Rotors make its joints independent."""
    bodies = [
        {"name": name, "parent": parent, "joint": {"name": f"to {name}", "armature": 5.0} | joint}
        for name, parent, joint in (
            ("deck", None, {"kind": "slide", "axis": [0, 0, 1], "passive": True, "stiffness": 1e5}),
            ("boom", "deck", {"kind": "hinge", "axis": [0, 1, 0]}),
            ("stick", "boom", {"kind": "hinge", "axis": [0, 1, 0]}),
        )
    ]
    bodies[2]["position"] = [1.0, 0.0, 0.0]
    end = {"body": "stick", "position": [1.0, 0.0, 0.0], "rows": ["x", "z"]}
    data = {"name": "light", "bodies": bodies, "placement": ["x"], "end_point": end, "payload": {"mass": 10.0}}
    tree = tree_from_dict(data)
    assert flexopt.check(tree).findings == ()


def test_a_centre_of_mass_to_the_side_is_told_by_its_own_key() -> None:
    data = flexopt.load("excavator").to_dict()
    data["base"]["com_offset"] = -300.0
    found = flexopt.check(flexopt.machine_from_dict(data)).findings[0]
    assert (found.field, found.value) == ("base.com_offset", "-300 m")
    assert found.meant == "probably in mm: -0.3 m"


@pytest.mark.parametrize("name", SHIPPED)
def test_capsules_and_supports_in_mm_are_told(name: str) -> None:
    given = flexopt.load(name).to_dict()
    tried = 0
    for key in ("start", "end", "radius"):
        data = copy.deepcopy(given)
        for number, capsule in enumerate(data.get("capsules") or []):
            if np.linalg.norm(np.atleast_1d(capsule[key])) < 0.1:
                continue
            data["capsules"][number][key] = (1000 * np.array(capsule[key])).tolist()
            assert f"capsules[{number}] of {capsule['body']}, {key}" in [each.field for each in _findings(data)]
            tried += 1
    for key in ("span", "polygon"):
        if key in (given.get("support") or {}):
            data = copy.deepcopy(given)
            data["support"][key] = (1000 * np.array(given["support"][key])).tolist()
            assert [each.field for each in _findings(data)] == ["support"]
            tried += 1
    assert tried or not (given.get("capsules") or given.get("support"))


@pytest.mark.parametrize("name", SHIPPED)
def test_a_root_link_in_mm_is_told(name: str) -> None:
    data = flexopt.load(name).to_dict()
    for body in data.get("bodies", [])[:1]:
        body["position"] = [0.0, 0.0, 597.0]
        assert "position of the root link" in [each.field for each in _findings(data)]
        body["position"] = [0.0, 0.0, 0.597]
        assert "position of the root link" not in [each.field for each in _findings(data)]


def _findings(data: Data) -> tuple[Any, ...]:
    return flexopt.check(built(data)).findings


def test_a_period_for_a_rate_is_told(tmp_path: Path) -> None:
    data = flexopt.load("excavator").to_dict() | {"loop": {"rate": 0.01}}
    (found,) = flexopt.check(flexopt.machine_from_dict(data)).findings
    assert (found.field, found.value, found.meant) == ("loop.rate", "0.01 Hz", "probably the period in s: 100 Hz")
    text = 'name = "p"\nmachine = "excavator"\n[target]\nend_point = [0, 1.6]\n[loop]\nrate = {}\n'
    (tmp_path / "p.toml").write_text(text.format(0.01))
    assert flexopt.check(tmp_path / "p.toml").findings[0].field == "loop.rate"
    (tmp_path / "p.toml").write_text(text.format(20))
    assert flexopt.check(tmp_path / "p.toml").findings == ()


def test_weights_that_a_selection_refuses_are_told(tmp_path: Path) -> None:
    text = 'name = "p"\nmachine = "excavator"\n[target]\nend_point = [0, 1.6]\n[selection]\nobjective = "V"\nweights = {}\n'
    (tmp_path / "p.toml").write_text(text.format([1] * 5))
    [fault] = flexopt.check(tmp_path / "p.toml").faults
    assert fault.field == "selection.weights"
    assert fault.sentence == "excavator has 3 modes, so 3 weights are needed, or 4 with the last for ε_max"
    for allowed in (3, 4):
        (tmp_path / "p.toml").write_text(text.format([1] * allowed))
        assert flexopt.check(tmp_path / "p.toml").status == "good"


@pytest.mark.parametrize("target", ["end_point = [0, 1.6]", "end_points = [[0, 1.6], [0.2, 1.4]]"])
def test_what_a_cost_of_travel_wants_is_told_of_one_target_and_of_several(target: str, tmp_path: Path) -> None:
    text = f'name = "p"\nmachine = "excavator"\n[target]\n{target}\n[constraints.travel]\ncost = 0.1\nbase = 0.0\n'
    (tmp_path / "p.toml").write_text(text)
    (sentence,) = flexopt.check(tmp_path / "p.toml").warnings
    assert sentence.startswith("constraints.travel.posture: is required: the cost of travel counts from the present")
    (tmp_path / "p.toml").write_text(text + "posture = [0.0448, -2.0499]\n")
    assert flexopt.check(tmp_path / "p.toml").warnings == ()


def test_rates_and_times_of_outcomes_have_their_own_units(tmp_path: Path) -> None:
    bounds = "[constraints.outcome]\ndecay = 1e9\ndelay_margin = 1e9\n"
    (tmp_path / "p.toml").write_text('name = "p"\nmachine = "excavator"\n[target]\nend_point = [0, 1.6]\n' + bounds)
    decay, margin = flexopt.check(tmp_path / "p.toml").faults
    assert decay.sentence.endswith("1e+06 1/s")
    assert margin.sentence.endswith("1e+06 s")


def test_a_clearance_of_a_machine_without_volumes_is_told(tmp_path: Path) -> None:
    text = (
        'name = "job"\nmachine = "excavator"\n[target]\nend_point = [0.0, 1.6]\n'
        "[constraints.clearance]\ndistance = 0.1\nground = 0.0\n"
    )
    (tmp_path / "job.toml").write_text(text, encoding="utf-8")
    told = repr(flexopt.check(tmp_path / "job.toml"))
    assert "constraints.clearance: needs the volumes of bodies, and excavator has none: add tables [[capsules]]" in told
    with pytest.raises(flexopt.InputError, match="needs the volumes of bodies"):
        flexopt.solve_problem(flexopt.load_problem(tmp_path / "job.toml"))
    (tmp_path / "job.toml").write_text(text.replace("excavator", "boom-stick-bucket"), encoding="utf-8")
    assert "capsules" not in repr(flexopt.check(tmp_path / "job.toml"))


IN_THE_PLANE, IN_SPACE = "boom-stick-bucket", "slewing-excavator"
BOX = "clearance = {{ distance = 0.1, obstacles = [{{ kind = 'box', center = {}, size = {} }}] }}"
REFUSED: dict[str, tuple[str, str, set[str]]] = {
    "box in space": (
        IN_THE_PLANE, BOX.format("[9.0, 2.0, 0.0]", "[1.0, 4.0, 1.0]"),
        {"constraints.clearance.obstacles[0].center", "constraints.clearance.obstacles[0].size"},
    ),
    "box in the plane": (
        IN_SPACE, BOX.format("[9.0, 2.0]", "[1.0, 4.0, 1.0]"), {"constraints.clearance.obstacles[0].center"},
    ),
    "intervals in space": (
        IN_SPACE, "region = [[0, 1]]\nkeep_out = [[[0, 0], [1, 0], [0, 1]], [1.6, 3.0]]",
        {"constraints.region[0]", "constraints.keep_out[1]"},
    ),
    "a polygon in the plane": (IN_THE_PLANE, "region = [[[0, 0], [1, 0], [0, 1]]]", {"constraints.region[0]"}),
    "a body that there is not": (
        IN_THE_PLANE, "clearance = { distance = 0.1, ground = 0.0, bodies = ['boum'] }", {"constraints.clearance.bodies"},
    ),
    "no support": ("excavator", "tip_over_margin = 0.1", {"constraints.tip_over_margin"}),
    "no efforts": ("excavator", "holding = 0.5", {"constraints.holding"}),
    "a margin beyond the limits": (IN_THE_PLANE, "joint_margin = 3.1", {"constraints.joint_margin"}),
}  # fmt: skip


@pytest.mark.parametrize("several", [False, True])
@pytest.mark.parametrize("case", REFUSED)
def test_all_that_a_selection_refuses_of_constraints_is_told(case: str, several: bool, tmp_path: Path) -> None:
    machine, constraints, fields = REFUSED[case]
    point = "[5.0, 0.5, 1.0]" if machine == IN_SPACE else "[5.0, 1.0]"
    target = f"end_points = [{point}, {point}]" if several else f"end_point = {point}"
    text = f'name = "p"\nmachine = "{machine}"\n[target]\n{target}\n[constraints]\n{constraints}\n'
    (tmp_path / "p.toml").write_text(text, encoding="utf-8")
    found = flexopt.check(tmp_path / "p.toml").faults
    assert {fault.field for fault in found} == fields
    with pytest.raises(flexopt.InputError) as caught:
        flexopt.solve_problem(flexopt.load_problem(tmp_path / "p.toml"))
    assert caught.value.faults == found


def test_a_posture_that_a_selection_refuses_is_told_by_its_table(tmp_path: Path) -> None:
    text = 'name = "p"\nmachine = "boom-stick-bucket"\n[target]\nend_points = [[5.0, 1.0, 2.0]]\n'
    (tmp_path / "p.toml").write_text(text + "[selection]\nbase = 0\nposture = [5.0, 0.0, 0.0]\n", encoding="utf-8")
    told = [fault.field for fault in flexopt.check(tmp_path / "p.toml").faults]
    assert any(field.startswith("selection.posture (boom)") for field in told)
    assert any(field.startswith("target.end_points") for field in told)


@pytest.mark.parametrize("name", ["excavator", "boom-stick-bucket"])
def test_an_inertia_in_tonnes_is_told_of_each_body_in_the_plane(name: str) -> None:
    data = shipped(name)
    tonne_square_metres(data, np.random.default_rng(0))
    found = [finding for finding in _findings(data) if "in t m²" in finding.meant]
    assert len(found) == len(bodies(data))
    data = shipped(name)
    assert f"in t m²: {data['base']['inertia']:g} kg m²" in found[0].meant


def test_a_base_whose_angle_is_from_the_vertical_is_told() -> None:
    data = shipped("boom-stick-bucket")
    data["base"]["rest_angle"] = 0.0
    assert "base.rest_angle" in [finding.field for finding in _findings(data)]
    assert any("it is from the horizontal: 1.5708 is upright" in sentence for sentence in told(data))


def light(mass: float) -> Data:
    """A demolition robot whose base has dampers for 4.1 t, and this mass, kg."""
    springs = {"x": 2.86535e6, "y": 2.86535e6, "rotation": 6.32766e6}
    dampers = {"x": 9772.17, "y": 9772.17, "rotation": 21580.2}
    base = {"length": 1.35, "com": 0.675, "mass": mass, "inertia": 0.1914 * mass, "rest_angle": math.pi / 2}
    links = [
        {"name": f"link{k}", "length": length, "com": length / 2, "mass": own, "inertia": own * length**2 / 12}
        for k, (length, own) in enumerate(((1.75, 480.0), (1.25, 290.0), (1.05, 410.0)))
    ]
    return {"name": "light", "base": base | {"stiffness": springs, "damping": dampers}, "links": links}


def test_a_base_too_light_for_its_arm_is_not_taken_for_dampers_too_large() -> None:
    assert told(light(4100.0)) == []
    (sentence,) = told(light(4.1))
    assert sentence.startswith("base.mass = 4.1 kg: is little for what carries an arm of 1180 kg")
    assert "4100 kg" in sentence
    foot = told(light(15.0))
    assert foot
    assert all("the base is probably too light" in sentence for sentence in foot)


def test_dampers_too_large_are_told_as_such() -> None:
    data = light(4100.0)
    data["base"]["damping"] = {name: 1000 * value for name, value in data["base"]["damping"].items()}
    assert all("dampers are probably too large" in sentence for sentence in told(data))


def test_the_length_that_is_too_long_is_the_one_named() -> None:
    data = shipped("boom-stick-bucket")
    del data["cylinders"]
    data["links"][1]["length"] *= 1000
    sentences = told(data)
    assert len(sentences) == 2
    assert all("links[1] (stick).length" in sentence for sentence in sentences)
    data = shipped("slewing-excavator")
    data["end_point"]["position"] = scaled(data["end_point"]["position"], 1000.0)
    assert all("end-point from the joint of body 'bucket'" in sentence for sentence in told(data))


@pytest.mark.parametrize(
    ("range_", "meant"),
    [
        ({"of": "base.stiffness.y", "value": [0.5, 2.0]}, "that would be [2e+07, 8e+07] N/m"),
        ({"of": "stiffness", "factor": [50, 200]}, "probably in per cent: [0.5, 2]"),
        ({"of": "base.mass", "value": [5.0, 6.0]}, "is it in another unit?"),
    ],
)
def test_a_range_far_from_the_files_number_is_told(range_: Data, meant: str) -> None:
    excavator = flexopt.load("excavator")
    (found,) = _findings(excavator.to_dict() | {"uncertainty": [range_]})
    assert found.field == f"range of {range_['of']}"
    assert meant in found.meant
    with pytest.warns(ImplausibleMachine, match="lies far from") as caught:
        flexopt.stable_region(excavator, (0.04, -2.0), loop={"kp": 1e4, "kv": 1e3}, ranges=[range_], points=2, boxes=0)
    assert [warning.filename for warning in caught if "far from" in str(warning.message)] == [__file__]


def test_corners_of_constraints_far_from_the_files_number_are_told(tmp_path: Path) -> None:
    """A load in tonnes."""
    file = tmp_path / "lift.toml"
    file.write_text(
        'name = "lift"\nmachine = "boom-stick-bucket"\n[target]\nend_point = [6.0, 1.0]\n'
        '[constraints]\nholding = 0.9\nwithin = [{ of = "payload.mass", value = [0.25, 1.05] }]\n'
    )
    (found,) = flexopt.check(str(file)).findings
    assert found.field == "constraints.within of payload.mass"
    with pytest.warns(ImplausibleMachine, match="constraints.within of payload.mass") as caught:
        flexopt.build_selection(
            flexopt.load("boom-stick-bucket"), (6.0, 1.0),
            constraints={"holding": 0.9, "within": [{"of": "payload.mass", "value": (0.25, 1.05)}]},
        )  # fmt: skip
    assert [warning.filename for warning in caught if "far from" in str(warning.message)] == [__file__]


def test_a_centre_of_mass_counts_from_the_joint() -> None:
    """Of a root link from where its springs act, which is told where the range leaves out the file's own number."""
    digger, name = flexopt.load("slewing-excavator"), "house.com.x"
    (own,) = (each.value for each in digger.parameters if each.name == name)
    for away, told in ((0.0, False), (0.4, True), (-3.0, True)):
        value = sorted((own + away - 0.1, own + away + 0.1))
        found = _findings(digger.to_dict() | {"uncertainty": [{"of": name, "value": value}]})
        assert [each.field for each in found] == [f"range of {name}"] * told
        assert all("counts from the body's joint" in each.meant for each in found)
    # Far off, of whatever sign, it may be in another unit.
    (found,) = _findings(digger.to_dict() | {"uncertainty": [{"of": name, "value": [99 * own - 1, 99 * own + 1]}]})
    assert "lies far from" in found.sentence


def test_a_problems_range_is_looked_at(tmp_path: Path) -> None:
    text = 'name = "p"\nmachine = "excavator"\n[target]\nend_point = [0, 1.6]\n'
    (tmp_path / "p.toml").write_text(text + '[[uncertainty]]\nof = "base.mass"\nvalue = [5, 6]\n', encoding="utf-8")
    assert flexopt.check(tmp_path / "p.toml").findings[0].field == "range of base.mass"


def test_ranges_about_the_files_number_or_of_nothing_are_not_told() -> None:
    given = flexopt.load("excavator").to_dict()
    near = [{"of": "base.stiffness.y", "value": [2e7, 9e7]}, {"of": "payload.mass", "value": [100, 200]}]
    late = [{"of": "dead_time", "value": [0.0, 0.1]}, {"of": "damping", "factor": [0.2, 0.5]}]
    assert _findings(given | {"uncertainty": near + late}) == ()


def test_a_dead_time_in_ms_is_asked_for(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"dead_time = 5: must be at most 100 samples of 0.005 s; is it in ms\?"):
        flexopt.evaluate(flexopt.load("excavator"), (0.5, -1.0), loop={"kp": 1e4, "dead_time": 5, "rate": 200})
    with pytest.raises(InputError, match=r"10 s at 0.01 Hz, 0.1: .*; is the rate the period in s\?"):
        flexopt.simulate(flexopt.load("excavator"), (0.5, -1.0), rate=0.01)


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ('rpy="0 0 0.4"', 'rpy="0 0 90"', r"rpy 0 0 90 rad turns by more than .*; in degrees it would be 0 0 1.5708"),
        ('<mass value="80"/>', '<mass value="0"/>', r"boom_link' <inertial>: has moments of inertia and no mass"),
    ],
)
def test_what_a_robot_file_says_oddly(tmp_path: Path, old: str, new: str, word: str) -> None:
    with pytest.warns(flexopt.FlexoptWarning, match=word):
        read(tmp_path, changed_text(URDF, old, new), URDF_MACHINE)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (
            {"actuated": ["boom", "slew", "extend"]},
            "actuated: is not in the order .* postures have: slew, boom, extend",
        ),
        (
            {"end_point": {"link": "stick", "length": 0.4}},
            "end_point.length: scales roll, pitch and yaw .* offset says",
        ),
    ],
)
def test_what_a_machine_file_says_oddly_of_a_robot(tmp_path: Path, change: Data, word: str) -> None:
    with pytest.warns(flexopt.FlexoptWarning, match=word):
        read(tmp_path, URDF, URDF_MACHINE | change)


def arm_of(lengths: list[float], mass: float = 2.0, inertia: float = 0.01) -> Data:
    """In the plane, on a base of 20 kg, every link with the same mass and inertia."""
    links = [
        {"name": f"link{k}", "length": length, "com": length / 2, "mass": mass, "inertia": inertia}
        for k, length in enumerate(lengths)
    ]
    base = {
        "length": 0.3, "com": 0.15, "mass": 20.0, "inertia": 0.4, "rest_angle": 1.57,
        "stiffness": {"x": 4e5, "y": 4e5, "rotation": 2e4}, "damping": {"x": 50.0, "y": 50.0, "rotation": 5.0},
    }  # fmt: skip
    return {"name": "copies", "gravity": 9.81, "base": base, "links": links}


def test_placeholders_for_masses_and_inertias_are_told() -> None:
    """In the plane and in space; not links that are as long as each other, nor two alone, nor legs side by side."""
    copied = arm_of([0.5, 0.3, 0.4])
    for data in (copied, in_space(copied)):
        (finding,) = [each for each in told(data) if "placeholder" in each]
        assert finding.startswith("mass and inertia = 2 kg and 0.01 kg m²: are exactly the same of ")
        assert "0.3 to 0.5 m long" in finding
        assert all(f"link{k}" in finding for k in range(3))
    modules, pair = arm_of([0.4, 0.4, 0.4]), arm_of([0.5, 0.3])
    weighed = arm_of([0.5, 0.3, 0.4])
    weighed["links"][1]["mass"] = 2.001
    legs = in_space(copied)
    for body in legs["bodies"][-3:]:
        body["parent"] = legs["bodies"][-4]["name"]
    for data in (modules, in_space(modules), pair, weighed, legs):
        assert not [each for each in told(data) if "placeholder" in each]


def test_a_wrist_of_no_size_is_not_judged_by_it() -> None:
    """Its axes meet, its centre lies where they do: nothing tells how large it is."""
    data = grounded(3, 0, coupled=False)
    round_ball = [1e-3, 1e-3, 1e-3, 0.0, 0.0, 0.0]
    joint = {"name": "w1", "kind": "hinge", "axis": [1.0, 0.0, 0.0]}
    wrist = {"name": "wrist", "parent": "arm2", "joint": joint, "position": [1.0, 0.0, 0.0], "mass": 1.0}
    hand = {"name": "hand", "parent": "wrist", "joint": joint | {"name": "w2", "axis": [0.0, 1.0, 0.0]}}
    hand |= {"position": [0.0, 0.0, 0.0], "mass": 1.0, "com": [0.1, 0.0, 0.0], "inertia": round_ball}
    data["bodies"] += [wrist | {"com": [0.0, 0.0, 0.0], "inertia": round_ball}, hand]
    data["end_point"] = {"body": "hand", "position": [0.3, 0.0, 0.0], "rows": ["x", "y", "z"]}
    assert not [line for line in told(data) if "wrist" in line]
    wrist["com"] = [0.002, 0.0, 0.0]
    data["bodies"][-2] = wrist | {"inertia": round_ball}
    assert not [line for line in told(data) if "wrist" in line]
    # In kg cm² it is.
    data["bodies"][-2] = wrist | {"inertia": [1e4 * x for x in round_ball]}
    assert [line for line in told(data) if "wrist" in line and "times the size" in line]


@pytest.mark.parametrize("mended", list(itertools.product((False, True), repeat=3)))
def test_inertias_are_told_whichever_way_their_bodies_point(mended: tuple[bool, ...]) -> None:
    """Three wrists 9 cm long with the one flat inertia of a body of half a metre: two are long across it, one along."""
    data = grounded(3, 0, coupled=False)
    flat, meant = [0.11, 0.11, 0.22, 0.0, 0.0, 0.0], [2.6e-3, 2.6e-3, 2.2e-3, 0.0, 0.0, 0.0]
    # Each longest radius of gyration is more than 4.5 lengths, or less than half of one.
    assert math.sqrt(0.22 / 1.2) > 4.5 * 0.095
    assert math.sqrt(2.6e-3 / 1.2) < 0.5 * 0.095
    parent, place = data["bodies"][-1]["name"], [0.4, 0.0, 0.0]
    for k, (own, way) in enumerate(zip(mended, ([0.0, 0.095, 0.0], [0.0, 0.0, 0.095], [0.095, 0.0, 0.0]), strict=True)):
        joint = {"name": f"turn{k}", "kind": "hinge", "axis": [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]][k % 2]}
        wrist = {"name": f"wrist{k}", "parent": parent, "joint": joint, "position": place, "mass": 1.2}
        data["bodies"].append(wrist | {"com": [0.0, 0.0, 0.0], "inertia": meant if own else flat})
        parent, place = f"wrist{k}", way
    data["end_point"] = {"body": parent, "position": place, "rows": ["x", "y", "z"]}
    found = [finding.field for finding in _findings(data) if "radius of gyration" in finding.sentence]
    assert found == [f"body 'wrist{k}'.inertia" for k in range(3) if not mended[k]]


@pytest.mark.parametrize("call", ["evaluate", "simulate", "select"])
def test_gravity_that_the_file_has_at_zero_is_told_once(call: str) -> None:
    """Robot files for kinematics often have it so; all numbers would be those without it, unsaid."""
    options: Data = {"evaluate": {}, "simulate": {"duration": 0.1}, "select": {"starts": 1}}[call]
    where = [3.0, 1.0] if call == "select" else [0.5, 1.0]
    for gravity, count in ((0.0, 1), (9.81, 0)):
        data = shipped("excavator") | {"name": f"weightless for {call}", "gravity": gravity}
        machine = flexopt.machine_from_dict(data)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            getattr(flexopt, call)(machine, where, gravity=True, **options)
            getattr(flexopt, call)(machine, where, **options)
        assert sum("gravity = 0 m/s²" in str(each.message) for each in caught) == count


def test_rows_that_no_joint_moves_are_told() -> None:
    """Three hinges about one axis, and a file that asks for all three rows: no posture moves them, whatever is bent."""
    data = in_space(arm_of([0.5, 0.3, 0.4]))
    assert not [each for each in told(data) if each.startswith("end_point.rows")]
    data["end_point"]["rows"] = ["x", "y", "z"]
    (finding,) = [each for each in told(data) if each.startswith("end_point.rows")]
    assert "in no posture do the joints move all of them; what they move is ['x', 'z']" in finding
    machine = tree_from_dict(data)
    with pytest.raises(flexopt.SingularPosture, match=r"no more than x, z: take rows = \['x', 'z'\]") as singular:
        flexopt.evaluate(machine, [0.3, 0.5, -0.9])
    assert "bend" not in str(singular.value)
    with pytest.raises(InputError, match=r"machine = planar: in no posture do the joints move all task rows"):
        flexopt.build_selection(machine, [0.6, 0.0, 0.9], base=np.zeros(len(machine.base_coordinates)))
    with pytest.raises(InputError, match="in no posture do the joints move all task rows"):
        flexopt.build_selection(machine, [0.6, 0.0, 0.9], control="damped:0.1")
    # A single singular posture of a machine whose joints move all rows is another matter.
    with pytest.raises(flexopt.SingularPosture, match="; bend "):
        flexopt.evaluate(tree_from_dict(in_space(arm_of([0.5, 0.3]))), [0.3, 0.0])
    # A base that turns takes the arm's plane into the rows.
    turned = in_space(arm_of([0.5, 0.3])) | {"placement": ["x", "y", "yaw"]}
    turned["end_point"]["rows"] = ["y", "z"]
    assert not [each for each in told(turned) if each.startswith("end_point.rows")]
    flexopt.evaluate(tree_from_dict(turned), [0.3, 0.8], base=[0.0, 0.0, math.pi / 2])


def test_capsules_say_how_long_a_body_is() -> None:
    """A mast with a sledge on it is longer than the way to its next joint, and has the inertia of its length."""
    data = flexopt.load("excavator").to_dict()
    boom = data["links"][0]
    length, mass = boom["length"], boom["mass"]
    mast = boom | {"inertia": mass * (2.2 * length) ** 2 / 12, "com": 0.6 * length}
    data |= {"links": [mast, *data["links"][1:]], "capsules": []}
    assert any(each.field.endswith("inertia") for each in _findings(data))
    capsule = {"body": boom["name"], "start": [-0.5 * length, 0.0], "end": [1.7 * length, 0.0], "radius": 0.05}
    assert _findings(data | {"capsules": [capsule]}) == ()
    # A beam that a joint holds in its middle, seen as a link to its one end, which is no longer than twice that.
    beam = boom | {"inertia": mass * (2 * length) ** 2 / 12, "com": 0.05 * length}
    data["links"][0] = beam
    assert any(each.field.endswith("inertia") for each in _findings(data))
    capsule |= {"start": [-0.9 * length, 0.0], "end": [0.9 * length, 0.0]}
    assert _findings(data | {"capsules": [capsule]}) == ()
    # One that ends at the next joint excuses nothing.
    capsule |= {"start": [0.0, 0.0], "end": [length, 0.0]}
    assert any(each.field.endswith("inertia") for each in _findings(data | {"capsules": [capsule]}))


def test_the_damper_of_a_joint_that_overdamps_a_mode_is_named() -> None:
    """A drive that holds, as robot files have it of a lift."""
    data = light(4100.0)
    data["links"][1]["joint_damping"] = 1e9
    sentences = told(data)
    assert sentences
    assert all("it is the damper of the joint link1, probably" in sentence for sentence in sentences)


def test_soft_springs_of_what_hangs_are_told_by_the_ropes_that_have_them() -> None:
    """A pendulum of length l has m g / l to the side."""
    data = flexopt.load("excavator").to_dict()
    mass = data["base"]["mass"] + sum(link["mass"] for link in data["links"])
    springs = data["base"]["stiffness"] | {"x": mass * 9.81 / 12.0}
    found = implausible_numbers(machine_from_dict(data | {"base": data["base"] | {"stiffness": springs}}))
    assert [each.field for each in found] == ["base.stiffness.x"]
    assert found[0].meant.endswith(", unless it hangs by ropes of some 12 m")
