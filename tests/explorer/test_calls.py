"""The call and the command: what they take, refuse and write."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest

import flexopt
from flexopt.cli import main
from flexopt.errors import InputError, SingularPosture
from tests.explorer.browser import POSTURE, explored


def test_a_page_names_no_host_and_stays_small() -> None:
    page = explored("excavator")[1].page
    assert "://" not in page
    assert "src=" not in page
    assert len(page.encode()) < 2**20
    assert explored("slewing-excavator")[1].bytes < 4 * 2**20


def test_names_are_text_and_no_markup() -> None:
    data = flexopt.load("excavator").to_dict() | {"description": "</script><b>bold</b> & <!-- so"}
    page = flexopt.explore(flexopt.machine_from_dict(data), POSTURE).page
    assert "<b>bold" not in page
    assert page.count("</script>") == 2


def test_the_first_posture_is_within_limits_that_are_far_from_zero() -> None:
    data = flexopt.load("excavator").to_dict()
    data["links"][0]["limits"], data["links"][1]["limits"] = [3.5, 5.5], [-6.0, -4.0]
    _, (boom, stick) = flexopt.explore(flexopt.machine_from_dict(data)).configurations["present"]
    assert 3.5 < boom < 5.5
    assert -6.0 < stick < -4.0


def slider_end(page: str) -> float:
    found = re.search(r'"payload_max": ([0-9.e+]+)', page)
    assert found is not None
    return float(found[1])


@pytest.mark.parametrize(
    ("known", "least"),
    [
        ([{"value": [0.0, 7300.0]}], 7300.0),
        ([{"factor": [0.5, 60.0]}], 6000.0),
        ([{"value": [0.0, 1.0]}], 0.0),
        ([{"factor": [0.5, 6.0]}, {"factor": [0.5, 10.0]}], 6000.0),
    ],
)
def test_the_slider_of_the_payload_goes_to_the_heaviest_that_may_be_carried(
    known: list[dict[str, Any]], least: float
) -> None:
    """Never below what there is without a range."""
    data = flexopt.load("excavator").to_dict() | {"payload": {"mass": 100.0}}
    plain = slider_end(flexopt.explore(flexopt.machine_from_dict(data), POSTURE).page)
    ranged = flexopt.machine_from_dict(data | {"uncertainty": [{"of": "payload.mass"} | one for one in known]})
    assert slider_end(flexopt.explore(ranged, POSTURE).page) == max(plain, math.ceil(least / 1000) * 1000)


@pytest.mark.long
def test_present_is_the_posture_that_a_verdict_judges() -> None:
    """Nobody says how the arm is held; the one way that `select` takes turns the tool too far."""
    asked: dict[str, Any] = {"base": 0.8, "starts": 2, "constraints": {"tool_angle": [-3.0, 0.0]}}
    problem = flexopt.build_selection(flexopt.load("excavator"), (0.0, 1.6), **asked)
    judged = flexopt.verdict(problem, loop={"kp": 100.0, "kv": 50.0}, runs=0, members=2)
    assert judged.places[0].drive == 0
    base, posture = flexopt.explore(problem).configurations["present"]
    assert base == pytest.approx([0.8])
    assert posture == pytest.approx(judged.places[0].posture, abs=1e-9)


def test_faults_are_named_together() -> None:
    with pytest.raises(InputError, match=r"(?s)posture.*base") as caught:
        flexopt.explore(flexopt.load("excavator"), [1.0], base=[1.0, 2.0])
    assert {fault.field for fault in caught.value.faults} == {"posture", "base"}
    with pytest.raises(InputError, match="the problem brings its own"):
        flexopt.explore(flexopt.load_problem("article"), POSTURE)
    with pytest.raises(InputError, match=r"must ask for one placement.*not target\.path"):
        flexopt.explore(flexopt.load_problem("trench"))
    with pytest.raises(InputError, match="must be a machine or a problem"):
        flexopt.explore("excavator")
    with pytest.raises(SingularPosture):
        flexopt.explore(flexopt.load("excavator"), [1.0, 0.0])
    with pytest.raises(InputError, match=r"must end in \.html"):
        explored("excavator")[1].save("page.txt")


def test_the_command_writes_the_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "page.html"
    main(
        [
            "explore",
            "excavator",
            "--posture",
            "1,-2",
            "--loop",
            "kp=1e4",
            "--loop",
            "kv=1e3",
            "--out",
            str(out),
            "--json",
        ]
    )
    document = json.loads(capsys.readouterr().out)
    assert out.stat().st_size == document["bytes"]
    assert document["configurations"]["present"] == {"base": [0.0], "posture": POSTURE}
    with pytest.raises(SystemExit) as left:
        main(["explore", "article", "--posture", "1,-2", "--out", str(out)])
    assert left.value.code == 2
    assert "--posture: goes with a machine" in capsys.readouterr().err.replace(" = [1.0, -2.0]", "")
    with pytest.raises(SystemExit) as left:
        main(["explore", "article", "--gravity", "--out", str(out)])
    assert left.value.code == 2
    assert "--gravity: goes with a machine" in capsys.readouterr().err.replace(" = True", "")
    main(["explore", "excavator", "--posture", "1,-2", "--gravity", "--out", str(out)])
    assert "under the machine" in out.read_text(encoding="utf-8")


@pytest.mark.long
def test_a_problem_by_what_the_loop_does() -> None:
    """Its recommended configuration is that of `select`, with the loop of the file and with one of the call's."""
    problem = flexopt.load_problem("article")
    own = problem.selection.model_copy(update={"objective": "decay", "starts": 2})
    loop = flexopt.Loop(kp=1e4, kv=1e3)
    asked = problem.model_copy(update={"selection": own, "loop": loop})
    found = flexopt.select(**asked.select_arguments())
    for page in (flexopt.explore(asked), flexopt.explore(asked.model_copy(update={"loop": None}), loop=loop)):
        assert page.configurations["recommended"][1] == pytest.approx(found.best.evaluation.posture)


def test_progress_of_a_problem_is_told() -> None:
    told = list[tuple[int, int]]()
    flexopt.explore(flexopt.load_problem("article"), progress=lambda *done: told.append(done))
    assert told[-1][0] == told[-1][1] > 0


def test_of_several_targets_one_is_shown(tmp_path: Path) -> None:
    """The placement of `select_stand` with the posture at that target, the first by default."""
    file = tmp_path / "stand.toml"
    file.write_text(
        'schema = 1\nname = "stand"\nmachine = "excavator"\n[target]\nend_points = [[0.0, 1.6], [0.2, 1.4]]\n'
        '[selection]\nobjective = "w1"\nbase = 0.0\nstarts = 2\n'
    )
    problem = flexopt.load_problem(str(file))
    places = flexopt.select_stand(**problem.select_arguments()).places
    for chosen, number in ((None, 1), (2, 2)):
        explorer = flexopt.explore(problem, target=chosen)
        base, posture = explorer.configurations["recommended"]
        assert base == pytest.approx(places[number - 1].evaluation.base)
        assert posture == pytest.approx(places[number - 1].evaluation.posture)
        assert explorer.configurations["present"][0] == pytest.approx([0.0])
        assert f'"which": "target {number} of 2"' in explorer.page
    for wrong in (0, 3, 1.5, True):
        with pytest.raises(InputError, match=r"target.*must be a whole number between 1 and 2"):
            flexopt.explore(problem, target=wrong)
    for other in (flexopt.load("excavator"), flexopt.load_problem("article")):
        with pytest.raises(InputError, match=r"target.*goes with a problem of several targets") as caught:
            flexopt.explore(other, target=1)
        assert len(caught.value.faults) == 1


def test_the_command_names_its_option(capsys: pytest.CaptureFixture[str]) -> None:
    for problem, number, sentence in (
        ("stations", "4", "--target = 4: must be a whole number between 1 and 3"),
        ("article", "1", "--target = 1: goes with a problem of several targets"),
    ):
        with pytest.raises(SystemExit) as left:
            main(["explore", problem, "--target", number])
        assert left.value.code == 2
        assert sentence in capsys.readouterr().err


def test_the_ground_is_the_one_that_clearances_are_kept_from() -> None:
    """What is asked for; else that of the machine's own standing, as the assumption says it, whatever it sags by."""

    def ground(page: str) -> float:
        found = re.search(r'"ground": (-?[0-9.e-]+)', page)
        assert found
        return float(found[1])

    machine = flexopt.load("boom-stick-bucket")
    assert ground(flexopt.explore(machine, gravity=True).page) == 0.0
    asked: dict[str, Any] = {"base": 0.0, "starts": 1, "gravity": True, "base_range": (0.0, 0.0)}
    for height in (0.0, -0.3):
        below = {"clearance": {"distance": 0.05, "ground": height}}
        problem = flexopt.build_selection(machine, (6.0, 1.0), constraints=below, **asked)
        assert ground(flexopt.explore(problem).page) == height
