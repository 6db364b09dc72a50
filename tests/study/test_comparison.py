"""Saved results beside each other: what the files hold, what was asked differently, what cannot be compared."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

import flexopt
from flexopt.study.comparison import ComparedRow, compare_saved
from tests.cli.command import Command

pytestmark = pytest.mark.filterwarnings("ignore::flexopt.errors.FlexoptWarning")
POSTURES = {"present": (0.9929, -2.6306), "chosen": (0.0448, -2.0499)}


def save(folder: Path, name: str, result: Any) -> str:
    path = folder / f"{name}.json"
    path.write_text(json.dumps(result.to_dict(), allow_nan=False), encoding="utf-8")
    return str(path)


@pytest.fixture
def command(capsys: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Command:
    monkeypatch.chdir(tmp_path)
    return Command(capsys, tmp_path)


def rows_of(document: dict[str, Any]) -> dict[str, list[Any]]:
    return {row["label"]: row["values"] for row in document["rows"]}


def test_runs(command: Command, tmp_path: Path) -> None:
    machine = flexopt.load("excavator")
    runs = {n: flexopt.simulate(machine, p, kp=1e5, kv=2e3, duration=4.0) for n, p in POSTURES.items()}
    files = [save(tmp_path, name, run) for name, run in runs.items()]
    outcome = command("compare", *files, "--plot", "runs.png", "--out", "both.json", "--json")
    assert outcome.code == 0, outcome.stderr
    document = outcome.document
    assert document == json.loads((tmp_path / "both.json").read_text())
    assert document["kind"] == "run"
    assert document["names"] == list(runs)
    rows = rows_of(document)
    assert rows["verdict"] == [run.verdict for run in runs.values()] == ["grows", "converges"]
    assert rows["decay of the base in the run"] == [-run.growth_rate for run in runs.values()]
    assert rows["largest rotation of the base"] == [run.peak_base_rotation for run in runs.values()]
    assert [name for name, _ in document["differences"]] == ["posture"]
    table = command("compare", *files)
    assert table.code == 0
    shown = re.findall(r"([−-]?[0-9.]+) ± ([0-9.]+)", table.stdout)
    for run, (number, doubt) in zip(runs.values(), shown, strict=True):
        # Two digits of the doubt, and none of the number below them.
        assert float(doubt) == float(f"{run.growth_rate_error:.1e}")
        assert len(number.partition(".")[2]) == len(doubt.partition(".")[2])
        assert abs(float(number) + run.growth_rate) <= 0.05 * run.growth_rate_error
    with Image.open(tmp_path / "runs.png") as drawn:
        assert drawn.size[0] > 1000


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (0.49941, 0.8, "0.50 ± 0.80"),
        (-0.19946, 0.012, "-0.199 ± 0.012"),
        (-1e-3, 0.5, "0.00 ± 0.50"),
        (1234.5, 150.0, "1230 ± 150"),
        (1.234e-12, 3e-13, "1.23e-12 ± 3.0e-13"),
        (0.0, 3e-4, "0.00000 ± 0.00030"),
        (0.382583, 1e-12, "0.38258"),
        (0.5, None, "0.5"),
        (0.5, float("inf"), "0.5 ± inf"),
    ],
)
def test_numbers_have_no_digits_below_their_doubt(value: float, error: float | None, text: str) -> None:
    assert ComparedRow("decay", "1/s", (value,), (error,), None).texts() == [text]


def test_runs_that_are_the_same_show_no_difference(command: Command, tmp_path: Path) -> None:
    """Whoever named what is so by default; what differs is named with what it was by default."""
    machine, posture, gains = flexopt.load("excavator"), POSTURES["chosen"], {"kp": 1e4, "kv": 1e3, "duration": 0.5}
    runs = {
        "plain": flexopt.simulate(machine, posture, **gains),
        "named": flexopt.simulate(
            machine, posture, **gains | {"kp": [1e4, 1e4]}, rate=200.0, feedback="pd", integrator="rk4", base=0.0,
            ki=0.0, sensor={"delay": 0.0}, gravity=False, seed=0, control="inverse",
        ),
        "late": flexopt.simulate(machine, posture, **gains, sensor={"delay": 0.01}),
    }  # fmt: skip
    files = {name: save(tmp_path, name, run) for name, run in runs.items()}
    same = command("compare", files["plain"], files["named"])
    assert same.code == 0, same.stderr
    assert "what it was asked" not in same.stdout
    assert "–" not in same.stdout
    document = command("compare", files["plain"], files["late"], "--json").document
    assert document["differences"] == [["sensor.delay", ["0.0", "0.01"]]]


def test_a_placement_at_zeros_is_told_as_the_others_are(command: Command, tmp_path: Path) -> None:
    machine, options = flexopt.load("mobile-manipulator"), {"kp": 1e3, "kv": 1e2, "duration": 0.2}
    bases = {"unsaid": None, "zeros": (0.0, 0.0, 0.0), "away": (0.5, 0.16, 0.0)}
    files = {
        name: save(tmp_path, name, flexopt.simulate(machine, (0.0, -1.0, 1.5, -0.5, -1.57, 0.0), base=base, **options))
        for name, base in bases.items()
    }
    for first, second, differences in (
        ("zeros", "away", [["base", ["[0.0, 0.0, 0.0]", "[0.5, 0.16, 0.0]"]]]),
        ("unsaid", "away", [["base", ["[0.0, 0.0, 0.0]", "[0.5, 0.16, 0.0]"]]]),
        ("unsaid", "zeros", []),
    ):
        document = command("compare", files[first], files[second], "--json").document
        assert document["differences"] == differences
    # In the plane a placement is a number.
    machine, posture = flexopt.load("excavator"), POSTURES["chosen"]
    planar = [
        save(tmp_path, f"x{x}", flexopt.simulate(machine, posture, base=x or None, **options)) for x in (0.0, 0.5)
    ]
    assert command("compare", *planar, "--json").document["differences"] == [["base", ["0.0", "0.5"]]]


@pytest.mark.long
def test_gains_of_velocity_served_runs_are_the_loop_s(command: Command, tmp_path: Path) -> None:
    machine, posture = flexopt.load("mobile-manipulator"), (0.0, -1.0, 1.5, -0.5, -1.57, 0.0)
    files = [
        save(
            tmp_path,
            f"kp{kp:g}",
            flexopt.simulate(machine, posture, loop={"drive": "velocity", "kp": kp}, duration=0.2),
        )
        for kp in (1.0, 2.0)
    ]
    document = command("compare", *files, "--json").document
    assert document["differences"] == [["kp", ["1.0 1/s", "2.0 1/s"]]]


def test_evaluations_of_other_machines(command: Command, tmp_path: Path) -> None:
    one = flexopt.evaluate(flexopt.load("excavator"), POSTURES["chosen"], loop={"kp": 1e4, "kv": 1e3})
    other = flexopt.evaluate(flexopt.load("boom-stick-bucket"), (-0.6, -1.2, -0.5))
    files = [save(tmp_path, "one", one), save(tmp_path, "other", other)]
    rows = rows_of(command("compare", *files, "--json").document)
    # What one of them lacks is none there.
    assert rows["bucket"] == [None, -0.5]
    assert rows["decay of the loop"] == [one.outcome.decay, None]
    assert rows["frequency 2"] == [one.frequencies_hz[1], other.frequencies_hz[1]]
    table = command("compare", *files).stdout
    assert "machine_sha256" in table
    # Its error is far below the digits that stand there, to which it would give a doubt that they have not.
    assert 0 < one.epsilon_max_error < 1e-12
    assert f"{one.epsilon_max:.5g}" in table
    assert "±" not in table


def test_units_of_gains_and_measures(command: Command, tmp_path: Path) -> None:
    """A gain has the unit of its controller; where two are compared that have different ones, both."""
    machine, loop = flexopt.load("excavator"), {"kp": 1e4, "kv": 1e3}
    found = {
        control: flexopt.evaluate(machine, POSTURES["chosen"], control=control, loop=loop)
        for control in ("inverse", "transpose")
    }
    one, other = (save(tmp_path, name, each) for name, each in found.items())
    same = command("compare", one, one).stdout
    assert "allowed Kp, N m  " in same
    assert "w1, 1/(kg m2)  " in same
    both = command("compare", one, other).stdout
    assert "allowed Kp, N m or N/m  " in both
    assert "w1, 1/(kg m2) or 1/kg  " in both
    # In the picture numbers of two units are not drawn on one axis.
    labels = {
        name: {each.label for each in compare_saved(files).bands}
        for name, files in (("same", [one, one]), ("both", [one, other]))
    }
    assert {"allowed Kp", "w1", "w2", "w3"} <= labels["same"] - labels["both"]
    assert "decay of the loop" in labels["both"]


def test_gains_of_rows_beside_one_for_all_and_other_units_are_not_drawn_together(tmp_path: Path) -> None:
    """A number that stands for all rows is each row's; N m and 1/s share no axis."""
    machine, asked = flexopt.load("excavator"), {"members": 2, "runs": 0, "starts": 2, "base_range": (-0.01, 0.01)}
    loops: list[dict[str, Any]] = [
        {"kp": (1e5, 2e5), "kv": (2e3, 4e3), "rate": 200},
        {"kp": (20.0, 40.0), "kv": 0.0, "rate": 100, "drive": "velocity", "servo_gain": 5e4},
    ]
    found = [flexopt.verdict(machine, (0.0, 1.6), base=0.0, loop=loop, **asked) for loop in loops]
    assert [each.word for each in found] == ["change gains"] * 2
    told = compare_saved([save(tmp_path, name, each) for name, each in zip(("torque", "served"), found, strict=True)])
    rows = {row.label: row for row in told.rows if row.label.startswith("new K")}
    assert list(rows) == ["new Kp 1", "new Kp 2", "new Kv 1", "new Kv 2"]
    assert all(row.apart and None not in row.values for row in rows.values())
    assert [rows[f"new Kv {k}"].values[1] for k in (1, 2)] == [0.0, 0.0]
    assert rows["new Kp 1"].unit == "N m or 1/s"
    assert not [each.label for each in told.bands if each.label.startswith("new K")]


def test_an_allowed_gain_that_there_is_not_is_none(command: Command, tmp_path: Path) -> None:
    """In words as in the evaluation's own; in the document the number that it has there."""
    machine, loops = flexopt.load("excavator"), ({"kp": 1e4, "kv": 1e3}, {"kp": 1e3, "kv": 0.0, "dead_time": 0.1})
    found = [flexopt.evaluate(machine, POSTURES["chosen"], loop=loop) for loop in loops]
    assert found[1].outcome.allowed_gain == 0
    assert "allowed gain Kp none" in repr(found[1])
    files = [save(tmp_path, name, each) for name, each in zip(("damped", "late"), found, strict=True)]
    table = command("compare", *files).stdout
    assert re.search(r"(?m)^allowed Kp, N m .* none$", table)
    assert re.search(r"(?m)^none: the loop decays with no gains that were looked at, from 0.0001 of these up", table)
    assert rows_of(command("compare", *files, "--json").document)["allowed Kp"][1] == 0
    assert "none:" not in command("compare", files[0], files[0]).stdout


def test_the_rate_that_stands_for_falling_is_a_word(command: Command, tmp_path: Path) -> None:
    asked: dict[str, Any] = {"members": 2, "runs": 0, "starts": 1, "base": 0.0, "gravity": True}
    asked |= {"loop": {"kp": 2e3, "kv": 5e2, "rate": 200}}
    loads = {"light": (0, 100), "heavy": (0, 1500)}
    found = [
        flexopt.verdict(flexopt.load("excavator"), (0.0, 1.6), ranges={"payload.mass": each}, **asked)
        for each in loads.values()
    ]
    files = [save(tmp_path, name, each) for name, each in zip(loads, found, strict=True)]
    rows = rows_of(command("compare", *files, "--json", "--plot", "beside.png").document)
    assert rows["staying: slowest decay"] == [found[0].places[0].decay.least, "falls"]
    assert found[1].places[0].decay.least < -1e5
    with Image.open(tmp_path / "beside.png") as picture:
        assert picture.width > 500
    table = command("compare", *files).stdout
    assert re.search(r"(?m)^staying: slowest decay, 1/s +[-0-9.]+ +falls$", table)
    assert re.search(r"(?m)^falls: the feedback is not found to hold the weight", table)
    assert "e+05" not in table
    assert "falls" not in command("compare", files[0], files[0]).stdout


@pytest.mark.long
def test_selections_and_verdicts(command: Command, tmp_path: Path) -> None:
    found = [flexopt.solve_problem(flexopt.load_problem(name)) for name in ("article", "article-transpose")]
    files = [save(tmp_path, name, each) for name, each in zip(("inverse", "transpose"), found, strict=True)]
    document = command("compare", *files, "--json").document
    rows = rows_of(document)
    assert rows["boom"] == [each.best.evaluation.posture[0] for each in found]
    # 1e-28 is rounding, not a difference between two places that are both perfect.
    assert rows["w1"] == [pytest.approx(0.0, abs=1e-30)] * 2
    assert ["control", ["inverse", "transpose"]] in document["differences"]
    # What is chosen by has a unit, as ε_max has none.
    units = {row["label"]: row["unit"] for row in document["rows"]}
    assert units["objective"] == "1/(kg m2) or 1/kg"
    margin = save(
        tmp_path, "margin", flexopt.select(found[0].problem.machine, (0.0, 1.6), objective="epsilon_max", starts=4)
    )
    assert "objective, 1/(kg m2) or no unit " in command("compare", files[0], margin).stdout
    assert "objective  " in command("compare", margin, margin).stdout
    verdicts = [flexopt.verdict(found[0], loop={"kp": kp, "kv": kp / 10}, members=2, runs=0) for kp in (1e4, 3e4)]
    files = [save(tmp_path, name, each) for name, each in zip("ab", verdicts, strict=True)]
    document = command("compare", *files, "--json", "--plot", "beside.png").document
    # Reasons are sentences, which go on in further lines of the table and lose none of their words.
    table = command("compare", *files).stdout
    assert max(len(each.reason) for each in verdicts) > 40
    assert all(word in table.split() for each in verdicts for word in each.reason.split())
    rows = rows_of(document)
    assert rows["word"] == [each.word for each in verdicts]
    assert ["loop.kp", ["[10000.0, 10000.0]", "[30000.0, 30000.0]"]] in document["differences"]
    assert rows["staying: slowest decay"] == [each.places[0].decay.least for each in verdicts]
    pointed = [next((p for p in each.places if p.name == each.place), None) for each in verdicts]
    assert any(pointed)
    assert rows["its place: least allowed Kp"] == [place and place.allowed_gain.least for place in pointed]
    units = {row["label"]: row["unit"] for row in document["rows"]}
    assert units["staying: least allowed Kp"] == "N m"
    assert units["its place: largest base swing, move of 0.1 m"] == "rad"


@pytest.mark.long
def test_a_verdict_to_change_gains_is_compared_with_these(command: Command, tmp_path: Path) -> None:
    """Its place grows with the present gains on some ground, so that there is no longest settling with them."""
    chosen = flexopt.solve_problem(flexopt.load_problem("article"))
    few: dict[str, Any] = {"members": 2, "runs": 0}
    verdicts = [flexopt.verdict(chosen, loop={"kp": 1e4, "kv": 1e3, "dead_time": late}, **few) for late in (0.0, 0.05)]
    changed = verdicts[1]
    assert [each.word for each in verdicts] == ["move", "change gains"]
    assert changed.with_gains is not None
    files = [save(tmp_path, name, each) for name, each in zip("ab", verdicts, strict=True)]
    rows = rows_of(command("compare", *files, "--json").document)
    assert [rows["new Kp"], rows["new Kv"]] == [[None, changed.gains["kp"][0]], [None, changed.gains["kv"][0]]]
    assert rows["its place: slowest decay"][1] == changed.with_gains.decay.least > 0
    assert rows["its place: least delay margin"][1] == changed.with_gains.delay_margin.least


def test_the_verdict_inside_a_choice_is_told_apart(command: Command, tmp_path: Path) -> None:
    """Its controller and its ground are no part of what the choice was asked."""
    at = ("excavator", "--end-point", "0,1.6", "--base", "0", "--starts", "1", "--json")
    for name, more in (("plain", ()), ("judged", ("--loop", "kp=1e4"))):
        (tmp_path / f"{name}.json").write_text(command("select", *at, *more).stdout, encoding="utf-8")
    document = command("compare", "plain.json", "judged.json", "--json").document
    told = [name for name, _ in document["differences"]]
    assert len(set(told)) == len(told)
    assert {"verdict.loop.kp", "verdict.uncertain"} <= set(told)
    assert "loop.kp" not in told


def asked_differently(command: Command, tmp_path: Path, *results: Any) -> dict[str, list[str]]:
    """What the table begins with, by name."""
    files = [save(tmp_path, f"{k}", each) for k, each in enumerate(results)]
    return dict(command("compare", *files, "--json").document["differences"])


def test_selections_that_were_asked_differently_say_so(command: Command, tmp_path: Path) -> None:
    """Constraints, allowed placements and where the machine stands now are part of the question, as the target is."""
    machine, target = flexopt.load("excavator"), (0.0, 1.6)
    free = flexopt.select(machine, target, starts=2)
    kept = flexopt.select(machine, target, starts=2, constraints={"keep_out": [[1.0, 2.0]]})
    assert asked_differently(command, tmp_path, free, kept) == {"constraints.keep_out": ["–", "[[1.0, 2.0]]"]}
    near = flexopt.select(machine, target, starts=2, base_range=(-1.0, 1.0))
    assert asked_differently(command, tmp_path, free, near)["placements.base.x"][1] == "[-1.0, 1.0]"
    stands = flexopt.select(machine, target, starts=2, base=0.5)
    assert asked_differently(command, tmp_path, free, stands)["base"] == ["null", "[0.5]"]
    stand = [flexopt.select_stand(machine, [target, (0.2, 1.4)], starts=1, constraints=each, workers=1)
             for each in (None, {"joint_margin": 0.1})]  # fmt: skip
    assert stand[0].provenance["options"]["constraints"] != stand[1].provenance["options"]["constraints"]


@pytest.mark.long
def test_what_the_loop_must_do_at_least_is_part_of_the_question(command: Command, tmp_path: Path) -> None:
    asked: dict[str, Any] = {"objective": "decay", "loop": {"kp": 1e4, "kv": 1e3}, "starts": 1, "workers": 1}
    found = [
        flexopt.select(flexopt.load("excavator"), (0.0, 1.6), constraints={"outcome": {"allowed_gain": least}}, **asked)
        for least in (1.5e4, 2e4)
    ]
    told = asked_differently(command, tmp_path, *found)
    assert told == {"constraints.outcome.allowed_gain": ["15000.0", "20000.0"]}


@pytest.mark.long
def test_loops_and_targets_that_differ_are_told(command: Command, tmp_path: Path) -> None:
    machine, target = flexopt.load("excavator"), (0.0, 1.6)
    fast = [
        flexopt.select(machine, target, objective="decay", loop={"kp": kp, "kv": 1e3}, workers=1) for kp in (1e4, 2e4)
    ]
    assert asked_differently(command, tmp_path, *fast) == {"loop.kp": ["[10000.0]", "[20000.0]"]}
    few: dict[str, Any] = {"base": 0.0, "starts": 2, "loop": {"kp": 1e4, "kv": 1e3}, "members": 2, "runs": 0}
    verdicts = [flexopt.verdict(machine, (x, 1.6), **few) for x in (0.0, 0.1)]
    assert asked_differently(command, tmp_path, *verdicts)["selection.target"] == ["[0.0, 1.6]", "[0.1, 1.6]"]


def test_faults(command: Command, tmp_path: Path) -> None:
    machine = flexopt.load("excavator")
    good = save(tmp_path, "good", flexopt.evaluate(machine, POSTURES["chosen"]))
    run = save(tmp_path, "run", flexopt.simulate(machine, POSTURES["chosen"], duration=0.1))
    for name, text in (("text.json", "not JSON"), ("list.json", "[1, 2]"), ("foreign.json", '{"w": 1}')):
        (tmp_path / name).write_text(text)
    (tmp_path / "bytes.json").write_bytes(b"\xff\xfe\x00")
    deep = tmp_path / "deep.json"
    deep.write_text("[" * 100_000 + "]" * 100_000)
    for arguments, words in (
        ((good,), ["two files or more"]),
        ((good, run), ["run", "evaluation", "of one kind"]),
        (
            (good, "none.json", "text.json", "list.json", "foreign.json", "bytes.json", "deep.json", "."),
            ["7 faults", "none.json"],
        ),
        ((good, good, "--plot", "x.txt"), ["--plot"]),
    ):
        outcome = command("compare", *arguments)
        assert outcome.code == 2, arguments
        assert "Traceback" not in outcome.stderr
        for word in words:
            assert word in outcome.stderr
    # The same file twice, and files of one name, are told apart.
    (tmp_path / "other").mkdir()
    twin = save(tmp_path / "other", "good", flexopt.evaluate(machine, POSTURES["present"]))
    assert command("compare", good, twin, "--json").document["names"] == [good, twin]
    assert command("compare", good, good, "--json").document["names"] == [f"1: {good}", f"2: {good}"]


@pytest.mark.parametrize("broken", [{"w": "x", "epsilon_max": [[]], "base": 3}, {"w": None, "epsilon_max": {"a": 1}}])
def test_documents_that_were_changed_by_hand(broken: dict[str, Any], command: Command, tmp_path: Path) -> None:
    document = flexopt.evaluate(flexopt.load("excavator"), POSTURES["chosen"]).to_dict()
    for name, data in (("a", document | {"provenance": 3}), ("b", document | broken)):
        (tmp_path / f"{name}.json").write_text(json.dumps(data))
    outcome = command("compare", "a.json", "b.json", "--plot", "x.png")
    assert outcome.code == 0, outcome.stderr
    assert "Traceback" not in outcome.stderr
