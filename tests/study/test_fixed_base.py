"""A machine that stands where it stands, `placement = []`: every call has an answer or one clear error."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import flexopt
from flexopt.model.tree import tree_from_dict
from flexopt.study.reports.page import report_html

LOOP: dict[str, Any] = {"kp": 1.0, "drive": "velocity", "servo_gain": 1e6, "dead_time": 0.05}
TARGET, OTHER = (6.0, 1.0, 2.5), (6.5, 0.5, 2.0)
pytestmark = pytest.mark.filterwarnings("ignore::flexopt.errors.FlexoptWarning")


@pytest.fixture(scope="module")
def machine() -> Any:
    return tree_from_dict(flexopt.load("slewing-excavator").to_dict() | {"placement": []})


@pytest.fixture(scope="module")
def placed(machine: Any) -> Any:
    """The same that may be placed, and is where the other stands."""
    return tree_from_dict(machine.to_dict() | {"placement": ["x"]})


@pytest.mark.long("decay")
@pytest.mark.parametrize("objective", ["w1", "decay"])
def test_choices_are_those_of_a_machine_that_is_placed_there(machine: Any, placed: Any, objective: str) -> None:
    asked: dict[str, Any] = {"objective": objective, "starts": 3}
    asked |= {} if objective == "w1" else {"loop": LOOP}
    here = flexopt.select(machine, TARGET, **asked)
    there = flexopt.select(placed, TARGET, base=0.0, base_range={"x": (0.0, 0.0)}, **asked)
    assert here.best.evaluation.base.size == 0
    # Climbs from other starts: the same optimum, to what they end at.
    assert here.best.objective == pytest.approx(there.best.objective, rel=1e-4)


@pytest.mark.long
def test_verdicts_with_runs(machine: Any, placed: Any) -> None:
    few: dict[str, Any] = {"starts": 2, "members": 4, "runs": 1, "duration": 2.0}
    here = flexopt.verdict(machine, TARGET, loop=LOOP, **few)
    there = flexopt.verdict(placed, TARGET, base=0.0, base_range={"x": (0.0, 0.0)}, loop=LOOP, **few)
    assert (here.word, here.places[0].decay.least) == (there.word, pytest.approx(there.places[0].decay.least, rel=1e-6))
    assert all(place.base.size == 0 and place.drive == 0.0 for place in here.places)


@pytest.mark.long
@pytest.mark.parametrize("loop", [LOOP, None], ids=["loop", "no loop"])
def test_reports(machine: Any, loop: Any) -> None:
    problem = flexopt.build_selection(machine, TARGET, starts=2)
    report = flexopt.report(problem, points=4, members=4, runs=0, simulation={"duration": 1.0}, loop=loop)
    assert set(report.marks) >= {"chosen"}
    assert "<h2>The closed loop</h2>" in report_html(report)


@pytest.mark.long
def test_several_targets_regions_and_loops_at_many_points(machine: Any, placed: Any) -> None:
    stand = flexopt.select_stand(machine, [TARGET, OTHER], objective="decay", loop=LOOP, starts=2)
    assert stand.base.size == 0
    head = str(stand).splitlines()[0]
    assert head.startswith(f"{machine.name}: 2 targets, Jacobian inverse control")
    assert "led to a verified posture at each of 2 targets" in head
    posture = stand.places[0].evaluation.posture
    here = flexopt.stable_region(machine, posture, loop=LOOP, points=16, boxes=4)
    there = flexopt.stable_region(placed, posture, base=0.0, loop=LOOP, points=16, boxes=4)
    assert here.decay == pytest.approx(there.decay, rel=1e-9)
    assert flexopt.evaluate(machine, posture, base=[]).base.size == 0
    with pytest.raises(flexopt.InputError, match="has no placement coordinate that could move"):
        flexopt.plan_base(machine, [TARGET, OTHER])


@pytest.mark.long("quantities1")
@pytest.mark.parametrize("quantities", [{"compute": "outcome"}, {"compute": "measures", "quantities": ["epsilon_max"]}])
def test_studies(tmp_path: Path, quantities: dict[str, Any]) -> None:
    folder = Path(__file__).parents[2] / "models"
    shipped = (folder / "slewing-excavator.toml").read_text(encoding="utf-8")
    shipped = shipped.replace('"robots/', f'"{folder.as_posix()}/robots/')
    (tmp_path / "fixed.toml").write_text("placement = []\n" + shipped, encoding="utf-8")
    study = flexopt.Study(
        name="fixed", machine=str(tmp_path / "fixed.toml"), posture=[0.2, 0.9, -1.9, -0.4],
        vary=[{"of": "posture.boom", "value": (0.8, 0.9), "count": 2}], **quantities,
    )  # fmt: skip
    found = flexopt.run_study(study, tmp_path / "run", workers=1)
    assert found.complete
    assert found.statuses["ok"] == 2


def test_a_place_for_it_is_refused(machine: Any) -> None:
    for field, given in (("base", 0.0), ("base_range", (0, 1))):
        with pytest.raises(flexopt.InputError, match=f"{field} = .*: must be left out: .* no placement coordinates"):
            flexopt.select(machine, TARGET, **{field: given})
