"""`flexopt verdict`, and the last lines of `flexopt select` where a controller is known."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import flexopt
from tests.cli.command import Command

LOOP = {"kp": 1e4, "kv": 1e3}
B = (0.0448, -2.0499)
GROUND = {"stiffness": (0.5, 2.0)}
# The head of a problem file.
OWN = """schema = 1
name = "own"
machine = "excavator"
[target]
end_point = [0.0, 1.6]
[selection]
"""


@pytest.mark.long
def test_places_are_sought_under_the_control_of_the_loop_that_is_given(command: Command) -> None:
    transpose = ("--loop", "control=transpose", "--loop", "kp=1e4", "--loop", "kv=1e3", "--json")
    (command.folder / "own.toml").write_text(f"{OWN}base = [0.0]\nstarts = 1\n", encoding="utf-8")
    (command.folder / "other.toml").write_text(f'{OWN}base = [0.0]\ncontrol = "inverse"\n', encoding="utf-8")
    few, at = ("--members", "2", "--runs", "0"), ("--end-point", "0,1.6", "--base", "0")
    for words in (("verdict", "own.toml", *few), ("verdict", "excavator", *at, *few)):
        assert command(*words, *transpose).document["settings"]["control"] == "transpose"
    for words in (("select", "own.toml"), ("select", "excavator", *at, "--starts", "1")):
        assert command(*words, *transpose).document["problem"]["control"] == "transpose"
    # A choice that could not be judged is not sought either.
    for words in (
        ("verdict", "other.toml", *few),
        ("select", "other.toml"),
        ("select", "excavator", *at, "--control", "inverse"),
    ):
        refused = command(*words, *transpose)
        assert refused.code == 2
        assert "control = 'transpose': is not the control that is asked for, inverse" in refused.message
        assert "best" not in refused.document
    (command.folder / "other.toml").write_text(
        f'{OWN}base = [0.0]\ncontrol = "inverse"\n[loop]\ncontrol = "transpose"\n', encoding="utf-8"
    )
    told = command("check", "other.toml")
    assert told.code == 2
    assert (
        "selection.control = 'inverse': is not the control of the loop by which verdicts judge, transpose"
        in told.stdout
    )


@pytest.mark.long
def test_the_command_says_what_python_says(command: Command) -> None:
    words = ("--loop", "kp=1e4", "--loop", "kv=1e3", "--ranges", "stiffness=0.5,2")
    found = flexopt.verdict(flexopt.load_problem("article"), loop=LOOP, ranges=GROUND, members=8, runs=2)
    few = ("--members", "8", "--runs", "2")
    document = command("verdict", "article", *words, *few, "--json").document
    assert document["word"] == found.word
    assert document["places"] == found.to_dict()["places"]
    shown = command("verdict", "article", *words, *few).stdout
    assert found.reason in shown
    for place in found.places:
        assert f"  {place.name}: x {place.base[0]:.4f} m; boom {place.posture[0]:.4f}, stick" in shown
    assert shown.count("how the arm is held was not given") == 1
    selected = command("select", "article", *words)
    assert f"verdict: {found.word.upper()}" in selected.stdout
    assert "verdict" not in command("select", "article", "--json").document


@pytest.mark.long
def test_the_weight_can_be_asked_for_beside_a_problem_file(command: Command, tmp_path: Path) -> None:
    text = f"""{OWN}base = [0.0]
starts = 2
"""
    (tmp_path / "own.toml").write_text(text, encoding="utf-8")
    (tmp_path / "weight.toml").write_text(text + "gravity = true\n", encoding="utf-8")
    few = ("--members", "2", "--runs", "0", "--json")
    asked, own = (command("verdict", *words, *few).document for words in (("own.toml", "--gravity"), ("weight.toml",)))
    assert asked["places"] == own["places"]
    assert asked["places"] != command("verdict", "own.toml", *few).document["places"]


@pytest.mark.long
def test_a_choice_is_handed_out_before_its_verdict(
    command: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Whose runs take minutes for an arm of many joints; here it ends at once."""
    picture = tmp_path / "choice.png"

    def none(*_: Any, **settings: Any) -> None:
        settings["progress"](1, 4)
        assert picture.exists()
        raise flexopt.InputError("no verdict")

    monkeypatch.setattr("flexopt.study.verdict", none)
    found = command("select", "article", "--loop", "kp=1e4", "--plot", str(picture))
    assert "Best by w1, whether it pays is told below" in found.stdout
    told = found.stderr.splitlines()
    assert "the verdict follows, which may take minutes" in told
    assert "no verdict" in told[-1]


def test_what_a_file_calls_uncertain_counts_for_an_objective_of_the_command(command: Command, tmp_path: Path) -> None:
    text = f"""{OWN}objective = "OBJECTIVE"
base_range = [-2.0, -1.0]
starts = 1
[loop]
kp = [1e4]
kv = [1e3]
[[uncertainty]]
of = "stiffness"
factor = [0.5, 2.0]
"""
    for word in ("w1", "decay"):
        (tmp_path / f"{word}.toml").write_text(text.replace("OBJECTIVE", word), encoding="utf-8")
    asked, own = (
        command("select", *words, "--json").document for words in (("w1.toml", "--objective", "decay"), ("decay.toml",))
    )
    assert own["uncertainty"]
    for key in ("uncertainty", "best", "measure"):
        assert asked[key] == own[key]


@pytest.mark.long
@pytest.mark.parametrize("place", ["candidate 1", "candidate 2", "stay"])
def test_the_picture_of_a_choice_shows_the_place_of_its_verdict(
    place: str, command: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    judged = SimpleNamespace(place=place, to_dict=dict)
    monkeypatch.setattr("flexopt.study.verdict", lambda *_, **__: judged)
    drawn = list[Any]()
    monkeypatch.setattr("flexopt.selection.Selection.plot", lambda selection, *_, **__: drawn.append(selection))
    found = command("select", "article", "--loop", "kp=1e4", "--plot", str(tmp_path / "choice.png"))
    first = drawn[0].candidates[0]
    assert drawn[0].best is first
    said = f"the picture shows {place} as the chosen one, of which the verdict speaks"
    if place == "candidate 2":
        assert len(drawn) == 2
        assert drawn[1].best is drawn[1].candidates[1]
        assert drawn[1].best.evaluation.base != first.evaluation.base
        assert said in found.stderr
    else:
        assert len(drawn) == 1
        assert "the picture shows" not in found.stderr
    drawn.clear()
    assert "the picture" not in command("select", "article", "--loop", "kp=1e4").stderr
    assert not drawn


@pytest.mark.long
def test_places_can_be_chosen_by_a_weighted_sum_and_what_was_not_given_is_named(command: Command) -> None:
    asked = ("excavator", "--end-point", "0,1.6", "--base", "0", "--objective", "V", "--weights", "1,0.5,0.5")
    words = ("--loop", "kp=1e4", "--members", "2", "--runs", "0")
    shown = command("verdict", *asked, *words).stdout
    assert (
        "not given of the loop, so proposed: drive (gains without a drive are those of torques), rate, kv, dead_time"
        in shown
    )
    problem = flexopt.build_selection(
        flexopt.load("excavator"), (0.0, 1.6), base=0.0, objective="V", weights=(1.0, 0.5, 0.5)
    )
    found = flexopt.verdict(problem, loop={"kp": 1e4}, members=2, runs=0)
    assert shown.strip() == repr(found)
    # The gain that follows from the present posture would be another at a candidate; handed on it is the one judged.
    written = re.search(r"to keep it: loop=(.*), in the shell (.*)", shown)
    assert written is not None
    handed = json.loads(written[1])
    first, *more = re.findall(r"--loop \S+", written[2])
    assert first == "--loop default"
    options = dict(option.removeprefix("--loop ").split("=") for option in more)
    assert handed == {"drive": "torque", "kp": 1e4, "kv": float(options["kv"]), "rate": 200.0}
    assert list(options) == list(handed)
    place = next(each for each in found.places if each.name != "stay")
    machine = flexopt.load("excavator")
    kept, anew = (
        flexopt.outcome(machine, place.posture, base=place.base, loop=loop).decay for loop in (handed, {"kp": 1e4})
    )
    assert kept == pytest.approx(place.decay.nominal, rel=1e-6)
    assert anew != pytest.approx(place.decay.nominal, rel=1e-2)


@pytest.mark.parametrize(
    ("own", "words", "handed"),
    [
        ({"rate": 200.0, "dead_time": 0.05}, ["dead_time=0"], {"dead_time": 0.0}),
        ({"feedback": "pid", "ki": 300.0, "rate": 200.0}, ["feedback=pd", "ki=0"], {"feedback": "pd"}),
        ({"control": "transpose", "rate": 200.0}, ["control=inverse"], {"control": "inverse"}),
    ],
    ids=["dead time", "integral", "control"],
)
def test_the_loop_that_is_handed_on_is_the_one_that_was_judged(
    own: dict[str, Any], words: list[str], handed: dict[str, Any], command: Command
) -> None:
    """Where a key of the file's own was given its default, too, which the line does not name."""
    source = (Path(__file__).parents[2] / "models" / "excavator.toml").read_text(encoding="utf-8")
    table = "\n".join(f"{key} = {value!r}" for key, value in own.items())
    Path("own.toml").write_text(f"{source}\n[loop]\n{table}\n", encoding="utf-8")
    given = [part for word in words for part in ("--loop", word)]
    few = ("--members", "2", "--runs", "0", "--ranges", "stiffness=0.9,1.1")
    shown = command(
        "verdict", "own.toml", "--end-point", "0,1.6", "--base", "0", *given, *few, "--out", "own.json"
    ).stdout
    found = json.loads(Path("own.json").read_text(encoding="utf-8"))
    line = re.search(r"in the shell (--loop .*?)(?:;|\n)", shown)
    assert line is not None
    place = found["places"][1]
    where = ("--posture", ",".join(map(str, place["posture"])), "--base", str(place["base"][0]))
    there = json.loads(command("evaluate", "own.toml", *where, *line[1].split(), "--json").stdout)["outcome"]
    assert there["decay"] == pytest.approx(place["decay"]["nominal"], rel=1e-6)
    assert handed.items() <= there["settings"].items()


@pytest.mark.long
def test_a_present_posture_beside_the_target_is_told(command: Command) -> None:
    """And numbers that are uncertain have their units."""
    asked = ("excavator", "--end-point", "0,1.6", "--base", "0", "--posture", "0.5,-1.5")
    words = ("--loop", "kp=1e4", "--loop", "kv=1e3", "--ranges", "payload.mass=0,200", "--members", "2", "--runs", "0")
    point = flexopt.evaluate(flexopt.load("excavator"), (0.5, -1.5)).end_point
    sentence = f"holds the end-point at ({point[0]:.4g}, {point[1]:.4g}) m, not at the target but"
    shown = command("verdict", *asked, *words).stdout
    assert shown.count(sentence) == 1
    assert f"{sentence} {np.hypot(*(point - (0.0, 1.6))):.3g} m away" in shown
    assert "uncertain: payload.mass 0 to 200 kg; 2 members" in shown
    for objective in ("w1", "decay"):
        chosen = command("select", *asked, "--objective", objective, "--loop", "kp=1e4", "--starts", "2").stdout
        rows = [line for line in chosen.splitlines() if line.startswith("   now ")]
        assert [sentence in row for row in rows] == [True]


def test_regions_are_those_of_python(command: Command) -> None:
    words = ("--loop", "kp=1e4", "--loop", "kv=1e3", "--ranges", "stiffness=0.5,2", "--points", "16")
    found = flexopt.stable_region(flexopt.load("excavator"), B, loop=LOOP, ranges=GROUND, points=16)
    said = command("region", "excavator", "--posture", "0.0448,-2.0499", *words)
    assert said.stdout.strip() == repr(found)
    document = command("region", "excavator", "--posture", "0.0448,-2.0499", *words, "--json").document
    assert document["guaranteed"] is True
    assert document == found.to_dict()
    unproven = command("region", "excavator", "--posture", "0.0448,-2.0499", *words, "--boxes", "0", "--json").document
    assert unproven["guaranteed"] is False


def test_the_command_refuses(command: Command) -> None:
    for words, sentence in (
        (("verdict", "excavator"), "--end-point"),
        (("verdict", "article", "--base", "1"), "brings its own"),
        (("verdict", "article", "--ranges", "mass=1,2"), "ranges[0].of"),
        (("region", "excavator"), "--posture, --end-point"),
        (("region", "slewing-excavator", "--end-point", "5,0,30"), "cannot reach"),
        (("verdict", "truck-crane", "--end-point", "5,0,3", "--base", "0"), "verdict: --base = 0.0: must be 3 numbers"),
        (("region", "excavator", "--posture", "0,-1", "--ranges", "mass=1,2"), "ranges[0].of"),
        (("region", "excavator", "--posture", "0,-1", "--boxes", "-1"), "--boxes"),
        (("select", "stations", "--loop", "kq=1"), "unknown key"),
        (("select", "trench", "--objective", "decay,swing"), "must be a single one"),
        (("select", "article", "--loop", "kq=1"), "unknown key"),
        (("select", "article", "--ranges", "stiffnes=1,2"), "did you mean"),
        (("select", "excavator", "--end-point", "0,1.6", "--loop", "kp=1e4"), "--base"),
        (("verdict", "article", "--ranges", "boom.length=1,2"), "moves the end-point"),
        (("verdict", "article", "--ranges", "dead_time=0,2"), "100 samples"),
        (("verdict", "article", "--loop", "kp_range=0,0"), "must end above 0"),
        (("verdict", "article", "--weights", "1,1,1"), "brings its own"),
        (("verdict", "excavator", "--end-point", "0,1.6", "--base", "0", "--objective", "V"), "--weights: is needed"),
    ):
        refused = command(*words)
        assert refused.code == 2
        assert sentence in refused.stderr


@pytest.mark.long
def test_a_verdict_runs_beyond_limits_that_are_left_out(command: Command) -> None:
    """No limits are assumed here, and no run has any."""
    command.write(
        "free.toml",
        'schema = 1\nname = "free"\nmachine = "slewing-excavator"\n'
        "[target]\nend_points = [[5.5, 0.5, 1.0], [5.0, 1.5, 0.5]]\n"
        '[selection]\nobjective = "w1"\nassume = "nothing"\nstarts = 1\nseed = 1\n'
        "base = [0.0, 0.0, 0.0]\nposture = [0.0, 0.3, -1.0, -1.0]\n",
    )
    found = command("select", "free.toml", "--loop", "kp=1e4", "--loop", "kv=1e3", "--json", "--out", "free.json")
    assert found.code == 0
    document = found.document
    assert document["places"]
    beyond = [place for place in document["verdict"]["places"] if place["beyond_limits"]]
    assert beyond
    assert all(place["runs"]["members"] == 16 for place in beyond)
    assert json.loads(Path("free.json").read_text(encoding="utf-8")) == document
