"""Machine and problem files: what is read, what the content hash sees, and that junk ends in a named fault."""

from __future__ import annotations

import copy
import datetime
import json
import math
import re
import tomllib
from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pydantic
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import flexopt
from flexopt import FlexoptError, InputError, Machine, ModelError, SingularPosture
from flexopt.model import shipped_names
from tests.oracles.machines import MachineDict, machines

MODELS = Path(__file__).parents[2] / "models"
EXCAVATOR = tomllib.loads((MODELS / "excavator.toml").read_text(encoding="utf-8"))

# The article's Table 1 and the rest angle of its text, SI.
TABLE_1 = {
    "base.length": 0.541,
    "base.com": 0.563,
    "base.mass": 5291.5,
    "base.inertia": 1020.7,
    "base.rest_angle": 1.2451,
    "base.stiffness.x": 4e7,
    "base.stiffness.y": 4e7,
    "base.stiffness.rotation": 1.112e6,
    "base.damping.x": 50.0,
    "base.damping.y": 50.0,
    "base.damping.rotation": 25.0,
    "boom.length": 1.918,
    "boom.com": 1.067,
    "boom.mass": 766.6,
    "boom.inertia": 214.9,
    "stick.length": 1.097,
    "stick.com": 0.613,
    "stick.mass": 458.2,
    "stick.inertia": 93.6,
}
# What the article leaves out, at its neutral value.
BESIDE_TABLE_1 = {
    "base.com_offset": 0.0,
    "boom.com_offset": 0.0,
    "boom.joint_damping": 0.0,
    "stick.com_offset": 0.0,
    "stick.joint_damping": 0.0,
    "payload.mass": 0.0,
    "gravity": 9.81,
}


def excavator_dict() -> MachineDict:
    return copy.deepcopy(EXCAVATOR)


def changed(path: tuple[str | int, ...], value: Any) -> MachineDict:
    data = excavator_dict()
    put(data, path, value)
    return data


def put(data: Any, path: tuple[str | int, ...], value: Any) -> None:
    for part in path[:-1]:
        data = data.setdefault(part, {}) if isinstance(part, str) else data[part]
    if value is DELETED:
        data.pop(path[-1], None)
    else:
        data[path[-1]] = value


class Deleted:
    def __repr__(self) -> str:
        return "deleted"


DELETED = Deleted()


def test_excavator_is_the_articles_table_1() -> None:
    values = {parameter.name: parameter.value for parameter in flexopt.load("excavator").parameters}
    assert values == TABLE_1 | BESIDE_TABLE_1


def test_excavator_joints() -> None:
    machine = flexopt.load("excavator")
    assert machine.joints == ("boom", "stick")
    assert machine.free_base_directions == ("x", "y", "rotation")
    assert machine.base_coordinates == ("x",)
    assert machine.limits == ((-math.inf, math.inf),) * 2


def test_every_shipped_file_loads_by_name_and_by_path() -> None:
    assert "excavator" in shipped_names("models")
    for name in shipped_names("models"):
        by_name = flexopt.load(name)
        assert by_name == flexopt.load(MODELS / f"{name}.toml") == flexopt.load(str(MODELS / f"{name}.toml"))
        assert by_name.source
    assert {"article", "article-a"} < set(shipped_names("problems"))
    for name in shipped_names("problems"):
        path = MODELS.parent / "problems" / f"{name}.toml"
        text = path.read_text()
        read = flexopt.load_experiment if "[simulation]" in text else flexopt.load_problem
        read = flexopt.load_study if "\ncompute = " in text else read
        assert read(name) == read(path)
        assert read(name).loaded_machine == flexopt.load(read(name).machine)
        assert read(name).source


def test_article_problem_says_what_the_article_says() -> None:
    problem = flexopt.load_problem("article")
    arguments = problem.select_arguments()
    assert arguments["machine"] == flexopt.load("excavator")
    assert arguments["target"] == (0.0, 1.6)
    assert (arguments["objective"], arguments["control"], arguments["base"]) == ("w1", "inverse", (0.0,))
    assert flexopt.load_problem("article-transpose").select_arguments()["control"] == "transpose"


def test_machine_path_starts_from_the_problem_file(tmp_path: Path) -> None:
    folder = tmp_path / "work"
    folder.mkdir()
    text = (MODELS / "excavator.toml").read_text(encoding="utf-8").replace('name = "excavator"', 'name = "mine"')
    (folder / "mine.toml").write_text(text, encoding="utf-8")
    lines = 'name = "p"\nmachine = "mine.toml"\n[target]\nend_point = [0, 1]\n'
    (folder / "problem.toml").write_text(lines, encoding="utf-8")
    assert flexopt.load_problem(folder / "problem.toml").loaded_machine.name == "mine"


SAME = """
links = [
  { inertia = 2.149e2, mass = 766.60, com = 1.067, length = 1.918, name = 'boom' },  # reversed, inline
  { inertia = 93.6, mass = 458.2, com = 0.613, length = 1.097, name = 'stick', joint_damping = 0, passive = false },
]
payload.mass = 0
gravity = 9.81
base = { rest_angle = 1.2451, inertia = 1_020.7, mass = 5.2915e3, com = 0.563, com_offset = -0.0, length = 541e-3, \
stiffness = { rotation = 1112000, y = 40000000, x = 4e7 }, damping = { x = 50, y = 50, rotation = 25 } }
"""


def test_content_hash_sees_content_and_not_formatting() -> None:
    head = {key: EXCAVATOR[key] for key in ("name", "description", "source")}
    same = flexopt.machine_from_dict(head | tomllib.loads(SAME))
    original = flexopt.load("excavator")
    assert same == original
    assert same.content_hash == original.content_hash
    assert hash(same) == hash(original)


NUMBERS = [
    ("base", "length"),
    ("base", "rest_angle"),
    ("base", "stiffness", "x"),
    ("base", "damping", "rotation"),
    ("links", 0, "mass"),
    ("links", 1, "com"),
]


@pytest.mark.parametrize("path", NUMBERS, ids=lambda path: ".".join(map(str, path)))
def test_content_hash_changes_with_the_last_digit_of_a_number(path: tuple[str | int, ...]) -> None:
    value: Any = EXCAVATOR
    for part in path:
        value = value[part]
    original = flexopt.machine_from_dict(EXCAVATOR)
    nudged = flexopt.machine_from_dict(changed(path, math.nextafter(value, math.inf)))
    assert nudged != original
    assert nudged.content_hash != original.content_hash


ADDITIONS = [("payload", "mass"), ("links", 0, "com_offset"), ("links", 1, "joint_damping"), ("gravity",)]


@pytest.mark.parametrize("path", ADDITIONS, ids=lambda path: ".".join(map(str, path)))
def test_content_hash_changes_with_what_is_added(path: tuple[str | int, ...]) -> None:
    original = flexopt.machine_from_dict(EXCAVATOR)
    assert flexopt.machine_from_dict(changed(path, 0.25)).content_hash != original.content_hash


@settings(max_examples=40, derandomize=True)
@given(machines())
def test_to_dict_round_trips(drawn: tuple[MachineDict, Machine]) -> None:
    _, machine = drawn
    again = flexopt.machine_from_dict(machine.to_dict())
    through_json = flexopt.machine_from_dict(json.loads(json.dumps(machine.to_dict())))
    assert machine == again == through_json
    assert machine.content_hash == again.content_hash == through_json.content_hash


def test_to_dict_keeps_limits_and_passive_joints() -> None:
    data = excavator_dict()
    data["links"].append({"name": "flex", "length": 0.5, "com": 0.2, "mass": 10.0, "inertia": 1.0})
    data["links"][0]["limits"] = [-1.0, 2.0]
    data["links"][2] |= {"passive": True, "stiffness": 1e5, "damping": 3.0, "rest": 0.1}
    machine = flexopt.machine_from_dict(flexopt.machine_from_dict(data).to_dict())
    assert machine.limits == ((-1.0, 2.0), (-math.inf, math.inf))
    assert machine.joints == ("boom", "stick")
    assert (machine.links[2].stiffness, machine.links[2].damping, machine.links[2].rest) == (1e5, 3.0, 0.1)


def test_links_without_names_are_numbered() -> None:
    data = excavator_dict()
    del data["links"][0]["name"], data["links"][1]["name"]
    assert flexopt.machine_from_dict(data).joints == ("link1", "link2")
    data["links"][0]["name"] = "boom"
    assert flexopt.machine_from_dict(data).joints == ("boom", "link2")
    data["links"][0]["name"] = "link2"
    with pytest.raises(ModelError, match="link2"):
        flexopt.machine_from_dict(data)


def test_reading_leaves_the_dictionary_alone() -> None:
    data = excavator_dict()
    del data["links"][0]["name"]
    before = copy.deepcopy(data)
    flexopt.machine_from_dict(data)
    assert data == before


def test_parameters_in_order_with_units() -> None:
    data = excavator_dict()
    del data["base"]["stiffness"]["x"], data["base"]["damping"]["x"]
    data["links"].insert(1, {"name": "flex", "length": 0.5, "com": 0.2, "mass": 10.0, "inertia": 1.0})
    data["links"][1] |= {"passive": True, "stiffness": 1e5, "damping": 3.0, "rest": 0.1}
    data["payload"] = {"mass": 7.0}
    parameters = flexopt.machine_from_dict(data).parameters
    body = [("length", "m"), ("com", "m"), ("com_offset", "m"), ("mass", "kg"), ("inertia", "kg m²")]
    expected = [(f"base.{key}", unit) for key, unit in body] + [("base.rest_angle", "rad")]
    expected += [("base.stiffness.y", "N/m"), ("base.damping.y", "N s/m")]
    expected += [("base.stiffness.rotation", "N m/rad"), ("base.damping.rotation", "N m s/rad")]
    joint = [("joint_damping", "N m s/rad")]
    spring = [("stiffness", "N m/rad"), ("damping", "N m s/rad"), ("rest", "rad")]
    for name, own in (("boom", joint), ("flex", spring), ("stick", joint)):
        expected += [(f"{name}.{key}", unit) for key, unit in body + own]
    expected += [("payload.mass", "kg"), ("gravity", "m/s²")]
    assert [(p.name, p.unit) for p in parameters] == expected
    values = {p.name: p.value for p in parameters}
    assert (values["flex.stiffness"], values["flex.rest"], values["payload.mass"]) == (1e5, 0.1, 7.0)


def test_machines_and_problems_are_frozen() -> None:
    machine, problem = flexopt.load("excavator"), flexopt.load_problem("article")
    before = machine.content_hash
    for owner, name in (
        (machine, "name"),
        (machine.base, "mass"),
        (machine.base.stiffness, "x"),
        (machine.links[0], "length"),
        (machine.payload, "mass"),
        (problem.selection, "objective"),
        (problem.target, "end_point"),
    ):
        with pytest.raises(pydantic.ValidationError, match="frozen"):
            setattr(owner, name, getattr(owner, name))
    with pytest.raises(TypeError):
        machine.links[0] = machine.links[1]  # type: ignore[index]
    assert machine.content_hash == before


def test_error_lists_its_faults_one_by_one() -> None:
    data = changed(("base", "mass"), -1.0)
    data["links"][1]["length"] = "long"
    with pytest.raises(ModelError) as caught:
        flexopt.machine_from_dict(data, origin="mine")
    assert str(caught.value).startswith("mine (2 faults)")
    assert [(f.field, f.value) for f in caught.value.faults] == [
        ("base.mass", "-1.0"),
        ("links[1] (stick).length", "'long'"),
    ]


@pytest.mark.parametrize("junk", [None, [], "excavator", 3, {}, {1: 2}, {"links": None}, {"base": []}], ids=repr)
def test_what_is_no_machine_at_all(junk: Any) -> None:
    with pytest.raises(ModelError, match="machine"):
        flexopt.machine_from_dict(junk)


@pytest.mark.parametrize("junk", [None, 3, b"excavator", ["excavator"], EXCAVATOR], ids=lambda j: type(j).__name__)
@pytest.mark.parametrize("reader", [flexopt.load, flexopt.load_problem])
def test_what_is_no_name_at_all(reader: Any, junk: Any) -> None:
    with pytest.raises(InputError, match=r"name|path"):
        reader(junk)


@pytest.mark.parametrize(
    ("reader", "name", "sentence"),
    [
        (flexopt.load, "article", "is a problem, not a machine; `flexopt select`"),
        (flexopt.load, "article-a", "is an experiment, not a machine; `flexopt simulate`"),
        (flexopt.load, "excavator-study", "is a study, not a machine; `flexopt study run`"),
        (flexopt.load_problem, "excavator", "is a machine, not a problem"),
    ],
)
def test_a_file_of_another_kind_is_told_as_what_it_is(reader: Any, name: str, sentence: str) -> None:
    folder = "problems" if reader is flexopt.load else "models"
    for named in (name, str(Path(__file__).parents[2] / folder / f"{name}.toml")):
        with pytest.raises(ModelError, match=sentence):
            reader(named)


class Thing:
    """An object that nobody expected."""


JUNK = st.one_of(
    st.floats(),
    st.integers(),
    st.booleans(),
    st.text(max_size=8),
    st.binary(max_size=4),
    st.complex_numbers(),
    st.sampled_from(
        [
            10**400,
            -(10**400),
            "1.0",
            "nan",
            [],
            {},
            (),
            set(),
            [1.0, -1.0],
            [[1.0]],
            {"x": {"x": 1}},
            {1: 2},
            datetime.date(1979, 5, 27),
            Decimal("NaN"),
            Decimal(3),
            Fraction(1, 3),
            np.float64(2.0),
            np.float32(2.0),
            np.int64(2),
            np.nan,
            np.array(2.0),
            np.array([1.0, 2.0]),
            np.array(["a"], dtype=object),
            range(2),
            Thing(),
            Thing,
            math.sin,
        ]
    ),
    st.lists(st.one_of(st.floats(), st.text(max_size=3)), max_size=3),
)


def leaves(data: Any, path: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    if isinstance(data, dict):
        return [leaf for key, value in data.items() for leaf in leaves(value, (*path, key))]
    if isinstance(data, list):
        return [leaf for index, value in enumerate(data) for leaf in leaves(value, (*path, index))]
    return [path]


UNKNOWN = [("bsae",), ("base", "mas"), ("base", "stiffness", "z"), ("links", 0, "colour"), ("payload", "weight")]
TABLES = [("base",), ("base", "stiffness"), ("base", "damping"), ("links",), ("links", 0), ("payload",), ("schema",)]
SPARE = [("links", 1, key) for key in ("limits", "passive", "stiffness", "rest", "com_offset", "joint_damping")]


def attempt(call: Callable[[], Any]) -> Any:
    """What the call returns, or the error that flexopt raises on purpose; any other goes on."""
    try:
        return call()
    except FlexoptError as error:
        return error


def fault_fields(data: MachineDict) -> set[str]:
    """Fields that the error names, without the link's name, which may be junk itself; empty for a sound machine."""
    result = attempt(lambda: flexopt.machine_from_dict(data))
    if isinstance(result, Machine):
        return set()
    assert type(result) is ModelError
    assert result.faults
    assert all(str(fault) in str(result) for fault in result.faults)
    return {re.sub(r" \(.*\)", "", fault.field, flags=re.DOTALL) for fault in result.faults}


def spelled(path: tuple[str | int, ...]) -> str:
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path).removeprefix(".")


@pytest.mark.long
@settings(max_examples=400, derandomize=True)
@given(
    st.dictionaries(
        st.sampled_from(leaves(EXCAVATOR) + UNKNOWN), st.one_of(st.just(DELETED), JUNK), min_size=1, max_size=4
    )
)
@example({("links", 0, "name"): np.array([1.0, 2.0])})
@example({("base", "mass"): 10**400, ("links", 1, "length"): np.array([1.0, 2.0]), ("bsae",): Thing()})
def test_junk_in_single_keys_is_named(junk: dict[tuple[str | int, ...], Any]) -> None:
    together = excavator_dict()
    for path, value in junk.items():
        put(together, path, value)
    named = fault_fields(together)
    for path, value in junk.items():
        # A key that is wrong by itself is wrong in company.
        if spelled(path) in fault_fields(changed(path, value)):
            assert spelled(path) in named


@pytest.mark.long
@settings(max_examples=200, derandomize=True)
@given(st.lists(st.tuples(st.sampled_from(TABLES + SPARE + UNKNOWN), JUNK), min_size=1, max_size=3))
def test_junk_in_place_of_tables_is_refused(junk: list[tuple[tuple[str | int, ...], Any]]) -> None:
    data = excavator_dict()
    for path, value in junk:
        try:
            put(data, path, value)
        except (TypeError, AttributeError, IndexError, KeyError, ValueError):
            continue  # an earlier piece of junk took the place of this one's table
    fault_fields(data)


@pytest.mark.long
@settings(max_examples=300, derandomize=True)
@given(
    st.fixed_dictionaries(
        {"posture": st.one_of(JUNK, st.none(), st.lists(st.floats(-4, 4), min_size=2, max_size=2))},
        optional={
            "base": st.one_of(JUNK, st.none()),
            "control": st.one_of(JUNK, st.none(), st.sampled_from(["inverse", "transpose"])),
            "gain": st.one_of(JUNK, st.none()),
            "damped": JUNK,
            "gravity": JUNK,
        },
    )
)
def test_junk_arguments_of_evaluate(arguments: dict[str, Any]) -> None:
    machine = flexopt.load("excavator")
    result = attempt(lambda: flexopt.evaluate(machine, **arguments))
    if isinstance(result, flexopt.Evaluation):
        assert np.all(np.isfinite(result.w))
    else:
        assert isinstance(result, InputError)
        assert result.faults or isinstance(result, SingularPosture)


@pytest.mark.parametrize(
    "junk", [None, "excavator", EXCAVATOR, Path("excavator.toml"), Machine], ids=lambda j: str(type(j))
)
def test_evaluate_wants_a_machine(junk: Any) -> None:
    with pytest.raises(InputError, match="machine") as caught:
        flexopt.evaluate(junk, [1.0, -2.0])
    assert "load" in str(caught.value)


def test_a_problem_file_says_what_is_uncertain(tmp_path: Path) -> None:
    """As the guides have it; entries of a list of tables come from TOML as lists."""
    path = tmp_path / "uncertain.toml"
    text = 'name = "u"\nmachine = "excavator"\n[target]\nend_point = [0.0, 1.6]\n[loop]\nkp = 1e4\n'
    path.write_text(f'{text}[[uncertainty]]\nof = "stiffness"\nfactor = [0.5, 2.0]\n', encoding="utf-8")
    known = flexopt.load_problem(path)
    assert [each.model_dump(exclude_none=True) for each in known.uncertainty] == [
        {"of": ("stiffness",), "factor": (0.5, 2.0)}
    ]
    assert flexopt.check(path).faults == ()
    path.write_text(f'{text}[[uncertainty]]\nof = "stiffness"\nfactor = [2.0, 0.5]\n', encoding="utf-8")
    with pytest.raises(flexopt.ModelError, match=r"uncertainty\[0\]"):
        flexopt.load_problem(path)


def test_what_is_none_in_a_problem_is_left_out() -> None:
    named = {"name": "p", "machine": "excavator"}
    target = {"end_point": (0.0, 1.6), "path": None}
    problem = flexopt.Problem(**named, target=target, motion=None, selection={"shares": None, "weights": None})
    assert problem.target.kind == "end_point"
    with pytest.raises(InputError, match="needs its weights"):
        flexopt.Problem(**named, target=target, selection={"objective": "V", "weights": None})


@pytest.mark.parametrize("name", ["base.x", "base.rotation"])
def test_no_link_is_called_as_a_coordinate_of_the_base(name: str) -> None:
    with pytest.raises(ModelError, match="is reserved or blank"):
        flexopt.machine_from_dict(changed(("links", 0, "name"), name))


def test_what_a_machine_lacks_for_a_constraint_is_told_before_a_selection(tmp_path: Path) -> None:
    path = tmp_path / "lacking.toml"
    text = 'name = "l"\nmachine = "excavator"\n[target]\nend_point = [0.0, 1.6]\n[constraints]\ntip_over_margin = 0.2\n'
    path.write_text(text, encoding="utf-8")
    (fault,) = flexopt.check(path).faults
    assert fault.field == "constraints.tip_over_margin"
    assert "[support]" in fault.sentence
    with pytest.raises(InputError, match="tip_over_margin"):
        flexopt.solve_problem(flexopt.load_problem(path))


def test_what_travel_counts_from_is_told_before_a_selection(tmp_path: Path) -> None:
    path = tmp_path / "travel.toml"
    text = 'name = "t"\nmachine = "excavator"\n[target]\nend_point = [0.0, 1.6]\n[constraints.travel]\ncost = 0.01\n'
    stands = "[selection]\nbase = 0.0\n"
    path.write_text(text + stands, encoding="utf-8")
    (sentence,) = flexopt.check(path).warnings
    assert "constraints.travel" in sentence
    assert "give it here, or as posture of the call or of [selection]" in sentence
    with pytest.raises(InputError, match=r"travel\.posture.*\[selection\]"):
        flexopt.solve_problem(flexopt.load_problem(path))
    path.write_text(f"{text}{stands}posture = [0.9929, -2.6302]\n", encoding="utf-8")
    assert not flexopt.check(path).warnings


@pytest.mark.parametrize("name", ["excavator", "article", "article-a", "excavator-study"])
def test_what_was_loaded_is_checked_as_its_file(name: str) -> None:
    load = {"excavator": flexopt.load, "article": flexopt.load_problem, "article-a": flexopt.load_experiment}
    loaded = load.get(name, flexopt.load_study)(name)
    assert flexopt.check(loaded).to_dict()["faults"] == flexopt.check(name).to_dict()["faults"] == []
