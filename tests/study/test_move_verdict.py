"""Does it pay to move? Verdicts on shipped problems, beside what their parts say by themselves."""

from __future__ import annotations

import copy
import json
import math
import re
import warnings
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import flexopt
from flexopt.foundation.plain import listed
from flexopt.loop.evaluation import settings_at
from flexopt.loop.levers import full_rates
from flexopt.loop.settings import loop_settings
from flexopt.loop.uncertain import UncertainLoop
from flexopt.loop.uncertainty_box import UncertaintyBox
from flexopt.model.loop import Loop
from flexopt.model.problem import SelectionOptions
from flexopt.model.uncertainty import Uncertainty
from flexopt.selection.broken import broken, broken_names
from flexopt.selection.outcomes.result import OutcomeSelection
from flexopt.selection.solve import constraint_values
from flexopt.study import page
from flexopt.study.page import with_minus
from flexopt.study.verdicts import confirmation, remarks
from flexopt.study.verdicts import verdict as verdict_module
from flexopt.study.verdicts.broken_places import Breaks, broken_standing, broken_within
from flexopt.study.verdicts.confirmation import GIVES_WAY, Runs, nonlinear_runs, tilts
from flexopt.study.verdicts.decision import spoken
from flexopt.study.verdicts.drawbacks import SO_LITTLE
from flexopt.study.verdicts.page import stable_told
from flexopt.study.verdicts.place_loops import besides_driving, configurations_of, held_at, unreached
from flexopt.study.verdicts.place_verdict import PlaceVerdict
from flexopt.study.verdicts.places import allowed, told
from flexopt.study.verdicts.result import GROUND_ASSUMED
from tests.plotting.looking import without_pictures
from tests.selection.constraints.test_under_weight import held as held_on_target
from tests.study.machines import gantry
from tests.study.telescopes import telescope

ARTICLE = {"kp": 1e4, "kv": 1e3}


def judged(name: str, **options: object) -> flexopt.Verdict:
    return flexopt.verdict(flexopt.load_problem(name), **options)  # type: ignore[arg-type]


@pytest.mark.long
def test_the_articles_machine_moves() -> None:
    """Posture A grows with these gains; it drives off, and a nonlinear ensemble over its ground says the same."""
    found = judged("article", loop=ARTICLE)
    assert found.word == "move"
    stay = found.places[0]
    chosen = next(place for place in found.places if place.name == found.place)
    assert stay.decay.greatest < 0 < chosen.decay.least
    assert chosen.better == 1.0
    # How the arm is held was not given, so that no joint is said to move.
    assert found.reason.endswith(f", for a drive of {chosen.drive:.3g} m")
    assert chosen.runs is not None
    assert chosen.runs.converging == 1.0
    assert stay.runs is not None
    assert stay.runs.growing == 1.0
    factors = np.geomspace(0.5, 2.0, 40)
    machine = flexopt.load("excavator")
    springs = {name: factors * value for name, value, _ in machine.parameters if name.startswith("base.stiffness")}
    ensemble = flexopt.simulate_ensemble(
        machine, chosen.posture, base=chosen.base, vary=springs, integrator="gauss", duration=20.0, **ARTICLE
    )
    assert ensemble.share("converges") == 1.0
    assert -ensemble.linear_growth_rate.max() == pytest.approx(chosen.decay.least, rel=1e-3)


@pytest.mark.long
def test_a_move_says_which_joint_moves_most() -> None:
    held, loop = np.array([0.9929, -2.6306]), {"kp": 1e4, "kv": 1e3}
    few: dict[str, Any] = {"starts": 4, "members": 4, "runs": 0}
    found = flexopt.verdict(flexopt.load("excavator"), (0.0, 1.6), base=0.0, posture=held, loop=loop, **few)
    assert found.word == "move"
    chosen = next(place for place in found.places if place.name == found.place)
    # Joints without limits go the short way round.
    assert abs(chosen.posture - held).max() > np.pi
    away = np.angle(np.exp(1j * (chosen.posture - held)))
    most = int(np.argmax(abs(away)))
    move = f"{('boom', 'stick')[most]} by {away[most]:+.3g} rad, other joints less"
    assert found.reason.endswith(f", for a drive of {chosen.drive:.3g} m, {move}")
    assert "no nonlinear run was made" in repr(found)
    # Where every run confirms there is no doubt to tell.
    confirmed = flexopt.verdict(flexopt.load("excavator"), (0.0, 1.6), base=0.0, loop=loop, **few | {"runs": 1})
    assert any(place.runs and not any(place.runs.reasons) for place in confirmed.places)
    doubted = {place.name for place in confirmed.places if place.runs and any(place.runs.reasons)}
    assert set(remarks.doubts(confirmed)) <= doubted
    assert not any(each.endswith(": ") for each in remarks.doubts(confirmed).values())
    assert "confirm: \n" not in f"{confirmed!r}\n"
    told = "a climb that could not be verified came to w1 -0.125; more starts may settle it"
    further = replace(found, selection=replace(found.selection, unverified=-0.125))
    assert told in repr(further)
    assert told.capitalize().replace("-", "−") in further._html()
    assert "a climb that could not" not in repr(found)
    left = "the weight is left out, of the linear loops and of the runs"
    assert left in repr(found)
    assert left.capitalize() in found._html()


@pytest.mark.parametrize("seed", range(6))
def test_a_move_says_the_largest_turn_and_the_largest_slide(seed: int) -> None:
    """Radians are not to be compared with metres."""
    rng = np.random.default_rng(seed)
    machine = telescope(True, rng=rng)
    low, high = np.array(machine.limits).T
    held, there = (flexopt.evaluate(machine, low + rng.uniform(size=3) * (high - low), base=[0.0]) for _ in range(2))
    target = held.end_point
    problem = flexopt.build_selection(machine, target, base=0.0, posture=held.posture)
    lift, fold, extend = there.posture - held.posture
    turn = f"lift by {lift:+.3g} rad" if abs(lift) > abs(fold) else f"fold by {fold:+.3g} rad"
    assert besides_driving(problem, 0.0, (there,)) == f"{turn}, extend by {extend:+.3g} m, other joints less"
    # Of what hardly moves nothing is said.
    stays = held.posture + np.array([2e-4, -0.3, 0.05])
    assert besides_driving(problem, 0.0, (flexopt.evaluate(machine, stays, base=[0.0]),)) == (
        "fold by -0.3 rad, extend by +0.05 m"
    )


@pytest.mark.long
def test_values_are_those_of_evaluate() -> None:
    found = judged("article", loop=ARTICLE, members=2, runs=0)
    for place in found.places:
        alone = flexopt.outcome(flexopt.load("excavator"), place.posture, base=place.base, loop=ARTICLE)
        assert place.decay.nominal == pytest.approx(alone.decay)
        assert place.allowed_gain.nominal == pytest.approx(alone.allowed_gain)
        assert place.delay_margin.nominal == pytest.approx(alone.delay_margin, nan_ok=True)
        assert place.swing.nominal == pytest.approx(0.1 * alone.swing, nan_ok=True)
        assert place.runs is None
    assert "swing of the base, of a move by 0.1 m" in repr(found)


@pytest.mark.long
def test_the_decision_is_the_same_for_the_selection_and_its_problem() -> None:
    selection = flexopt.solve_problem(flexopt.load_problem("article"))
    assert isinstance(selection, flexopt.Selection)
    told = list[tuple[int, int]]()
    one = flexopt.verdict(selection, loop=ARTICLE, runs=0, progress=lambda *stage: told.append(stage))
    other = judged("article", loop=ARTICLE, runs=0)
    done = [done for done, total in told if total == 100]
    assert done == sorted(set(done))
    assert {20, 40, 60, 80, 100} <= set(done)
    assert len(done) == len(told)
    assert (one.word, one.place, one.reason) == (other.word, other.place, other.reason)
    # What the selection recommends is told of though three others decay faster, and how many more there are.
    assert len(one.places) == 4
    assert "8 candidates were judged; shown are the 3 that are stable on the most grounds" in repr(one)
    last = selection.candidates[-1]
    turned = replace(selection, best=last, candidates=tuple(reversed(selection.candidates)))
    worse = flexopt.verdict(turned, loop=ARTICLE, members=2, runs=0)
    names = [place.name for place in worse.places]
    assert (names[0], names[-1], len(names), worse.judged) == ("stay", "candidate 1", 5, 8)
    assert "and candidate 1, which comes first by w1" in repr(worse)
    recommended = worse.places[-1]
    assert max(place.decay.nominal for place in worse.places[1:-1]) > recommended.decay.nominal
    alone = flexopt.outcome(flexopt.load("excavator"), last.evaluation.posture, base=recommended.base, loop=ARTICLE)
    assert recommended.decay.nominal == pytest.approx(alone.decay)


@pytest.mark.long
def test_a_present_place_that_no_integrator_follows_grows() -> None:
    """With the gains that suit the machine the present place grows faster than steps of the run bear."""
    found = judged("article", runs=2, members=4)
    assert found.places[0].runs is not None
    assert found.places[0].runs.growing == 1.0
    assert found.word == "move"


@pytest.mark.long
def test_drives_that_give_nothing_confirm_nothing() -> None:
    found = judged("article", loop=ARTICLE | {"torque_limit": 0.0}, runs=2, members=4)
    assert all(place.runs is not None and place.runs.confirming == 0.0 for place in found.places)
    assert found.word == "cannot tell"


@pytest.mark.long
def test_what_grows_is_not_said_to_settle_late(tmp_path: Path) -> None:
    found = judged("article", loop=ARTICLE, members=2, runs=0)
    assert found.places[0].decay.least < 0
    found.to_html(tmp_path / "verdict.html")
    words = (tmp_path / "verdict.html").read_text(encoding="utf-8")
    assert "over 60 s" not in words
    # As the text does, the page says that nobody gave the present posture, and that the gains are given.
    assert "Staying is judged in a posture that reaches the target: how the arm is held was not given." in words
    assert "Kp 1e+04 N m, Kv 1000 N m s" in words
    assert found.handed_on == ""


@pytest.mark.long
def test_a_present_posture_beside_the_target_is_told_on_the_page_and_in_the_document(tmp_path: Path) -> None:
    machine, posture = flexopt.load("excavator"), (1.02, -2.6)
    problem = flexopt.build_selection(machine, (0.0, 1.6), base=0.0, posture=posture, starts=2)
    found = flexopt.verdict(problem, loop={"kp": 1e4, "kv": 1e3}, members=2, runs=0)
    point = flexopt.evaluate(machine, posture).end_point
    off = float(np.hypot(*(point - (0.0, 1.6))))
    document = found.to_dict()
    np.testing.assert_allclose(document["present_end_point"], [point], atol=1e-9)
    assert document["present_off"] == pytest.approx(off, abs=1e-9)
    assert f"not at the target but {off:.3g} m away" in repr(found)
    assert f"the end-point {off:.3g} m off its target; without a posture it is judged at the target" in found.reason
    found.to_html(tmp_path / "verdict.html")
    words = (tmp_path / "verdict.html").read_text(encoding="utf-8")
    assert f"<p>Stay: {with_minus(found.present_told)}.</p>" in words
    there = flexopt.verdict(machine, (0.0, 1.6), base=0.0, loop={"kp": 1e4, "kv": 1e3}, starts=2, members=2, runs=0)
    assert there.present_told == ""
    assert "staying is judged as" not in there.reason
    assert there.to_dict()["present_off"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.long
def test_a_place_that_is_not_allowed_is_none_to_stay_at(tmp_path: Path) -> None:
    """The excavator at its optimum, which nothing beats, and a trench dug below it: word, reason, document and page."""
    machine, target = flexopt.load("excavator"), (0.0, 1.6)
    best = flexopt.select(machine, target, base=0.0, starts=4).best.evaluation
    there = {"base": best.base, "posture": best.posture, "starts": 4, "members": 4, "runs": 1, "duration": 5.0}
    loop = {"kp": 1e4, "kv": 1e3}
    free = flexopt.verdict(machine, target, loop=loop, **there)
    assert (free.word, free.present_breaks) == ("stay", "")
    trench = [float(best.base[0]) - 0.3, float(best.base[0]) + 0.4]
    found = flexopt.verdict(machine, target, loop=loop, constraints={"keep_out": [trench]}, **there)
    assert found.word == "move"
    breaks = "breaks distance from keep_out[0], -0.3 m (at least 0 m)"
    assert found.reason.startswith(f"the present place {breaks}; slowest decay there ")
    place = next(place for place in found.places if place.name == found.place)
    assert not trench[0] < place.base[0] < trench[1]
    assert found.to_dict()["present_breaks"] == breaks
    found.to_html(tmp_path / "verdict.html")
    words = (tmp_path / "verdict.html").read_text(encoding="utf-8")
    assert f"<p>Stay: {with_minus(breaks)}.</p>" in words


@pytest.mark.long
def test_staying_is_said_against_all_places_that_were_judged(tmp_path: Path) -> None:
    """Three are stable on more grounds than another that decays faster on three of five: by the rule that decides."""
    base, posture = 1.8625277871038002, (1.8981784500546635, -1.4650435368568973)
    loop = {"kp": 1e5, "kv": 1e3, "dead_time": 0.005, "drive": "torque"}
    ground = {"stiffness": (0.5, 2.0), "damping": (0.5, 2.0), "payload.mass": (0.0, 300.0)}
    machine, target = flexopt.load("excavator"), (0.0, 1.6)
    found = flexopt.verdict(machine, target, base=base, posture=posture, loop=loop, ranges=ground, runs=0)
    assert found.word == "cannot tell"
    assert "but not stable on every one" in found.reason
    other = found.places[-1]
    assert (other.name, len(found.places)) == (found.place, 5)
    assert other.better > 0.5
    assert f"and {other.name}, which decays faster than the present place on the most grounds" in repr(found)
    # The page sends nobody anywhere.
    found.to_html(tmp_path / "verdict.html")
    words = (tmp_path / "verdict.html").read_text(encoding="utf-8")
    assert f"Orange: {other.name}, which the numbers above are of." in words
    assert "sends" not in words


def test_no_border_of_the_gain_is_one_above_the_highest_that_was_tried() -> None:
    assert allowed(math.inf, "N m", 1e8) == "above 1e+08 N m"
    assert allowed(5e4, "N m", 1e8) == "5e+04 N m"
    assert allowed(math.nan, "N m", 1e8) == "–"
    assert allowed(0.0, "N m", 1e8) == "none"
    assert told(math.inf, 1e3, " ms") == "no border"


@pytest.mark.long
def test_runs_take_dead_times_between_samples() -> None:
    """Of 2 ms; with a whole sample, 20 ms, the same loop grows."""
    machine, posture = flexopt.load("excavator"), (0.0448, -2.0499)
    loop = {"kp": 3e4, "kv": 3e3, "rate": 50.0, "dead_time": 0.002}
    late = flexopt.outcome(machine, posture, loop=loop | {"dead_time": 0.02})
    target = flexopt.evaluate(machine, posture).end_point
    found = flexopt.verdict(
        machine, target, base=0.0, posture=posture, loop=loop, ranges={"stiffness": (0.99, 1.01)}, starts=1, runs=2
    )
    stay = found.places[0]
    assert late.decay < 0 < stay.decay.least
    assert stay.runs is not None
    assert stay.runs.converging == 1.0


@pytest.mark.long
def test_gains_are_changed_where_no_place_bears_them() -> None:
    """At 20 ms of dead time no place found bears Kp 1e5 and Kv 2e3; smaller ones it does."""
    found = judged("article", loop={"kp": 1e5, "kv": 2e3, "dead_time": 0.02}, runs=0)
    assert found.word in {"change gains", "cannot tell"}
    if found.word == "change gains":
        assert found.gains["kp"][0] < 1e5


@pytest.mark.long
def test_where_every_place_grows_on_every_ground_nothing_is_to_be_measured(tmp_path: Path) -> None:
    """Nor is a bar of the page another's than the present place's, of whose numbers it speaks."""
    found = judged("article", loop={"kp": 1e7, "kv": 1e3}, runs=0, members=4)
    assert (found.word, found.place) == ("cannot tell", "")
    assert all(place.decay.greatest < 0 for place in found.places)
    assert found.measure == "nothing to measure: with the present gains every place grows on all 4 grounds looked at"
    found.to_html(tmp_path / "verdict.html")
    words = (tmp_path / "verdict.html").read_text(encoding="utf-8")
    assert found.measure[1:] in words
    assert "Orange" not in words


@pytest.mark.long
def test_where_no_gains_are_found_it_says_which_were_tried_and_how_others_are(tmp_path: Path) -> None:
    """With so little Kv for its Kp no multiple of the gains is stable; ranges, which are named, have some that are."""
    loop = {"kp": 1e7, "kv": 1e2, "dead_time": 0.02}
    found = judged("article", loop=loop, runs=0, members=4)
    assert found.word == "cannot tell"
    assert (
        "nor with 0.01 to 10 times these, all by one factor; kp_range and kv_range of the loop have others tried"
        in found.sentence
    )
    ranges = {"kp_range": (1.0, 1e7), "kv_range": (1.0, 1e5)}
    other = judged("article", loop=loop | ranges, runs=0, members=4)
    assert other.word == "change gains"
    # What the new gains bear is told as it is where they are asked for.
    new = other.with_gains
    again = judged("article", loop=loop | {name: values[0] for name, values in other.gains.items()}, runs=0, members=4)
    asked = next(place for place in again.places if place.name == other.place)
    for measure in ("decay", "allowed_gain", "delay_margin"):
        assert getattr(new, measure).least == pytest.approx(getattr(asked, measure).least, rel=1e-4)
    assert f"{1e3 * new.delay_margin.least:.4g} ms" in next(x for x in str(other).splitlines() if "new gains  " in x)
    # And it is asked for as the verdict writes it, not with the gains to change away from.
    words = re.search(r"the loop with the new gains: loop=(.*), in the shell (.*)", repr(other))
    assert words
    given = json.loads(words[1])
    there = flexopt.outcome(other.problems[0].machine, new.posture, base=new.base, loop=given)
    assert there.decay == pytest.approx(new.decay.nominal, rel=1e-6)
    assert words[2] == " ".join(["--loop default", *(f"--loop {name}={number}" for name, number in given.items())])
    assert other.to_dict()["new_settings"]["kp"] == other.gains["kp"]
    other.to_html(tmp_path / "verdict.html")
    assert words[2] in re.sub(r"</?span[^>]*>", "", (tmp_path / "verdict.html").read_text(encoding="utf-8"))


@pytest.mark.long
def test_what_new_gains_are_worse_by_is_told(tmp_path: Path) -> None:
    """They are sought by the decay alone, which goes up to where little dead time more makes the loop grow."""
    ranges = {"kp_range": (1e2, 1e6), "kv_range": (1e2, 1e5)}
    machine, stands = flexopt.load("excavator"), {"base": 1.8625, "posture": (1.8982, -1.4650)}
    loop = {"kp": 1e3, "kv": 1e3, "dead_time": 0.01} | ranges
    found = flexopt.verdict(machine, (0.0, 1.6), **stands, loop=loop, members=4, runs=0, starts=4)
    assert found.word == "change gains"
    new, stay = found.with_gains, found.places[0]
    assert new.delay_margin.least < 0.9 * stay.delay_margin.least
    told = (
        f"bears {1e3 * new.delay_margin.least:.4g} instead of {1e3 * stay.delay_margin.least:.4g} ms more of dead time"
    )
    assert told in found.drawbacks
    room, now = new.allowed_gain.least / found.gains["kp"][0], stay.allowed_gain.least / loop["kp"]
    assert f"bears {room:.4g} instead of {now:.4g} times its gains" in found.drawbacks
    assert found.to_dict()["with_gains"]["delay_margin"]["least"] == new.delay_margin.least
    # Bars have a row of it, which is told of.
    for bars in found.bands:
        assert [row.name for row in bars.rows] == [*(place.name for place in found.places), "new gains"]
        assert bars.told == "new gains"
        own = found.gains["kp"][0] if bars.label == "allowed Kp" else None
        assert [row.border for row in bars.rows] == [*(None for _ in found.places), own]
    assert found.bands[0].rows[-1].least == new.decay.least
    found.to_html(tmp_path / "verdict.html")
    words = (tmp_path / "verdict.html").read_text(encoding="utf-8")
    assert "Left of the arrow: stay, with the gains as they are" in words
    assert "The same controller everywhere but in the row of new gains: " in words
    assert re.search(r'<tr class="told"><th scope="row">new gains</th>', words)
    assert len(re.findall(r'<tr class="told">', words)) == 2
    # What breaks whatever the gains is no matter of the new ones.
    load, late = "breaks tool angle, 0.3 rad, where payload.mass is 0 kg", "breaks decay 0.01 1/s (at least 0.02 1/s)"
    told = replace(found, with_gains=replace(new, breaking=Breaks(by_loop=late, somewhere=load))).drawbacks
    assert f"with the new gains the present place {late}; every place found breaks constraints on some ground: " in told
    assert told.endswith(f"on some ground: the present place {load}")


@pytest.mark.long
def test_with_other_gains_what_staying_does_is_told() -> None:
    """Where it is sent elsewhere with some, staying with its own is told, and is as the same loop is asked for."""
    asked: dict[str, Any] = {"base": 0.0, "starts": 3, "members": 4, "runs": 0}
    asked |= {"ranges": {"stiffness": (0.6, 1.6)}}
    loop: dict[str, Any] = {"drive": "velocity", "kp": 30.0, "kv": 0.0, "servo_gain": 1e5, "dead_time": 0.05}
    machine = flexopt.load("boom-stick-bucket")
    found = flexopt.verdict(machine, (6.0, 1.0), loop=loop, **asked)
    assert (found.word, found.places[0].name) == ("change gains", "stay")
    assert found.place != "stay"
    told = re.search(
        r"; staying with kp (\S+) 1/s, kv 0 is stable on every ground, too: slowest decay (\S+)/s", found.reason
    )
    assert told
    again = flexopt.verdict(machine, (6.0, 1.0), loop=loop | {"kp": float(told[1])}, **asked).places[0]
    assert again.decay.least == pytest.approx(float(told[2]), rel=2e-3)
    assert found.with_gains is not None
    assert found.with_gains.decay.least > 1.1 * again.decay.least
    # Where it stands is told where the machine may stay there, and beside what is compared alone.
    new, stands = found.with_gains, ", beside the present ones where it stands"
    for words, off, slow in (
        (f" there{stands}", math.nan, 2.0),
        (f" there{stands}, and comes to rest 0.9 m off the target", 0.9, 2.0),
        ("it comes to rest 0.9 m off the target there", 0.9, 1.0),
    ):
        stay = replace(found.places[0], decay=replace(found.places[0].decay, least=slow * new.decay.least))
        stay = replace(stay, rests_off=math.nan, settling=new.settling, swing=new.swing, delay_margin=new.delay_margin)
        stay = replace(stay, allowed_gain=replace(new.allowed_gain, least=0.0))
        told = replace(found, places=(stay, *found.places[1:]), with_gains=replace(new, rests_off=off)).drawbacks
        assert told.split("; ")[0].endswith(words), (told, words)
        assert stands not in replace(found, places=found.places[1:], with_gains=replace(new, rests_off=off)).drawbacks


@pytest.mark.long
def test_what_new_gains_do_is_part_of_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes as long as a place does; nothing is left to do when all is told to be done."""
    told, when = list[int](), list[int]()
    own = verdict_module.judged_with_gains
    monkeypatch.setattr(verdict_module, "judged_with_gains", lambda *of: (when.append(told[-1]), own(*of))[1])
    found = judged(
        "article", loop=ARTICLE | {"dead_time": 0.05}, runs=0, members=2, progress=lambda done, _: told.append(done)
    )
    assert found.word == "change gains"
    assert when[0] < 100 == told[-1]


@pytest.mark.long
def test_new_gains_have_room_below_those_that_grow() -> None:
    """The decay hardly rises up to twice these gains, and right above another motion grows."""
    data = gantry()
    found = flexopt.verdict(
        flexopt.tree_from_dict(data), (1.2, 0.3, 1.5), base=(0.0, 0.0, 0.0), loop={"kp": 1e5, "kv": 2e4},
        members=4, runs=0, starts=4,
    )  # fmt: skip
    assert found.word == "change gains"
    new = found.with_gains
    assert new is not None
    grounds = list[Any]()
    for factor in (0.5, 1.0, 2.0):
        other = copy.deepcopy(data)
        for body in other["bodies"][:3]:
            body["joint"]["stiffness"] *= factor
        grounds.append(flexopt.tree_from_dict(other))

    def decay(times: float) -> float:
        gains = {name: times * values[0] for name, values in found.gains.items()}
        return min(flexopt.outcome(ground, new.posture, base=new.base, loop=gains).decay for ground in grounds)

    best = max(map(decay, np.linspace(1.0, 2.4, 15)))
    assert decay(1.0) >= 0.9 * best * (1 - 1e-2)
    # Twice as high ones hold.
    assert decay(2.0) >= 0.99 * best > 0.0 > decay(2.6)
    # The room that the row tells.
    assert new.allowed_gain.least / found.gains["kp"][0] > 2.0


@pytest.mark.long
def test_a_damper_that_is_too_much_for_the_sampling_rate_is_named() -> None:
    """A damper d of the self-motion of inertia m alternates from d T / m = 2 on, whatever the gains."""
    digger, posture = flexopt.load("boom-stick-bucket"), np.array([-0.9, -1.2, -0.5])
    target = flexopt.evaluate(digger, posture).end_point

    def sentence(damping: float) -> str:
        loop: dict[str, Any] = {"kp": 1e4, "kv": 1e3, "rate": 100.0, "drive": "torque", "nullspace_damping": damping}
        few: dict[str, Any] = {"starts": 2, "members": 2, "runs": 0}
        return flexopt.verdict(digger, target, base=0.0, posture=posture, loop=loop, **few).sentence

    assert "it grows at 50 Hz, half the sampling rate" in sentence(1e9)
    assert "half the sampling rate: the damper of the self-motion is too much for 100 Hz" in sentence(1e9)
    assert "half the sampling rate" not in sentence(1e3)


@pytest.mark.long("kv follows", "velocity")
@pytest.mark.parametrize(
    ("loop", "told"),
    [
        (
            {"kp_range": (10.0, 1e5), "kv_range": (10.0, 1e4), "rate": 100.0},
            "the gains kp and kv were chosen with candidate 1; to keep them",
        ),
        (
            {"kp_range": (0.1, 20.0), "drive": "velocity", "servo_gain": 2e4, "dead_time": 0.02, "filter_hz": 8.0},
            "the gain kp was chosen with candidate 1; to keep it",
        ),
        (
            {"kp_range": (1e3, 1e5)},
            "the gain kp was chosen with candidate 1; the gain kv follows from the posture of the present place and "
            "would be another elsewhere; to keep them",
        ),
    ],
    ids=["torque", "velocity", "kv follows"],
)
def test_gains_that_were_chosen_are_handed_on_with_their_digits(loop: dict[str, Any], told: str) -> None:
    """At an optimum in a kink four digits would be another loop, and so would gains alone of another drive."""
    machine = flexopt.load("excavator")
    few: dict[str, Any] = {"base": 0.0, "objective": "decay", "starts": 2, "members": 2, "runs": 0}
    found = flexopt.verdict(machine, (0.0, 1.6), loop=loop, **few)
    words = re.search(rf"{told}(?: as now)?: loop=(.*), in the shell (.*)", repr(found))
    assert words
    assert found.handed_on.count("in the shell") == 1
    place = next(each for each in found.places if each.name == "candidate 1")
    kept = json.loads(words[1])
    there = flexopt.outcome(machine, place.posture, base=place.base, loop=kept)
    assert there.decay == pytest.approx(place.decay.nominal, rel=1e-6)
    assert set(found.selection.gains[0]) <= set(kept)
    assert words[2] == " ".join(["--loop default", *(f"--loop {name}={number}" for name, number in kept.items())])


@pytest.mark.long
def test_candidates_that_differ_in_their_gains_alone_are_one_place() -> None:
    """The places have the gains of today: what was found twice with other gains would stand there twice."""
    machine, loop = flexopt.load("excavator"), {"kp": 1e4, "kv": 1e3, "kp_range": (1e4, 1e5)}
    few: dict[str, Any] = {"base": 0.0, "objective": "w1", "starts": 2, "members": 3, "runs": 0}
    found = flexopt.verdict(machine, (0.0, 1.6), loop=loop, constraints={"outcome": {"decay": 0.016}}, **few)
    assert isinstance(found.selection, OutcomeSelection)
    first, second = found.selection.candidates
    # Far closer than configurations that count as one.
    assert np.allclose(first.z, second.z, atol=1e-6)
    assert found.selection.gains[0]["kp"] > 1.5 * found.selection.gains[1]["kp"]
    assert [place.name for place in found.places] == ["stay", "candidate 1"]
    assert found.judged == 1
    assert "candidate 2 differs from candidate 1 in its gains alone" in repr(found)


@pytest.mark.long
def test_gains_that_are_given_beside_their_ranges_are_those_of_today() -> None:
    """The choice takes others from the ranges; staying with those that the machine has now is another matter."""
    machine, today = flexopt.load("excavator"), {"kp": 1e4, "kv": 1e3}
    few: dict[str, Any] = {"base": 0.0, "objective": "decay", "starts": 4, "members": 4, "runs": 0}
    found = flexopt.verdict(machine, (0.0, 1.6), loop=today | {"kp_range": (1e3, 1e5)}, **few)
    assert isinstance(found.selection, OutcomeSelection)
    chosen = found.selection.gains[0]["kp"]
    assert chosen > 2 * today["kp"]
    assert set(found.settings.kp.tolist()) == {today["kp"]}
    for place in found.places:
        there = flexopt.outcome(machine, place.posture, base=place.base, loop=today)
        assert place.decay.nominal == pytest.approx(there.decay, rel=1e-9)
    assert f"candidate 1 was chosen with kp {chosen:.4g} N m; places are compared with the gains" in found.handed_on
    assert "kp" not in found.settings.sources
    # So does the choice tell of the present configuration.
    now = found.places[0]
    assert found.selection.present == pytest.approx(now.decay.nominal, rel=1e-9)
    assert found.selection.initial is not None
    assert found.selection.initial.outcome.decay == pytest.approx(now.decay.nominal, rel=1e-9)
    row = next(line for line in repr(found.selection).splitlines() if line.startswith("   now "))
    assert "1e+04" in row.split()
    # Without one of today they are judged with those that were chosen, and say so.
    other = flexopt.verdict(machine, (0.0, 1.6), loop={"kv": 1e3, "kp_range": (1e3, 1e5)}, **few)
    assert other.settings.kp[0] == pytest.approx(chosen, rel=1e-6)
    assert other.to_dict()["settings"]["sources"]["kp"] == "chosen with the configuration"
    assert "so proposed: drive (gains without a drive are those of torques), rate, dead_time" in repr(other)
    # What neither says, Kv here, is the same in both.
    alone = flexopt.verdict(machine, (0.0, 1.6), loop={"kp_range": (1e3, 1e5)}, **few)
    first = next(place for place in alone.places if place.name == "candidate 1")
    assert first.decay.nominal == pytest.approx(alone.selection.best.objective, rel=1e-9)


@pytest.mark.long
def test_what_a_loop_does_with_the_gains_of_today_is_told_of_places_chosen_with_others() -> None:
    """By w1 with a least decay, which only gains from the range have."""
    machine, today = flexopt.load("excavator"), {"kp": 1e4, "kv": 1e3}
    few: dict[str, Any] = {"base": 0.0, "objective": "w1", "starts": 2, "members": 4, "runs": 0}
    asked: dict[str, Any] = {"constraints": {"outcome": {"decay": 0.016}}, "loop": today | {"kp_range": (1e4, 1e5)}}
    found = flexopt.verdict(machine, (0.0, 1.6), **asked, **few)
    # A loop that grows has no delay margin at all.
    grown = flexopt.verdict(
        machine, (0.0, 1.6), objective="decay", loop=today | {"kp_range": (1e4, 1e5)},
        constraints={"outcome": {"delay_margin": 1e-3}}, base=0.0, starts=2, members=4, runs=0,
    )  # fmt: skip
    assert "delay_margin, of which there is none where it grows (at least 0.001 s)" in grown.present_breaks
    for place in found.places:
        assert place.decay.nominal < 0.016
        told = found.present_breaks if place.name == "stay" else place.breaks
        assert re.search(r"breaks decay \S+ 1/s \(at least 0.016", told), told


@pytest.mark.long
def test_ranges_of_gains_spare_a_drive() -> None:
    found = judged("article", loop=ARTICLE | {"kp_range": (1.0, 1e5), "kv_range": (1.0, 1e4)}, runs=0)
    assert found.word in {"move", "change gains"}


def test_what_is_asked_for_without_a_present_place(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = flexopt.build_selection(flexopt.load("excavator"), (0.0, 1.6))
    with pytest.raises(flexopt.InputError, match="where the machine stands now"):
        flexopt.verdict(problem)
    excavator = flexopt.load("excavator")
    with pytest.raises(flexopt.InputError, match="where the machine stands now"):
        flexopt.verdict(flexopt.select_stand(excavator, [(0.0, 1.6), (0.2, 1.4)], starts=1))
    # Before places are sought.
    for name in ("select", "solve_selection", "solve_problem"):
        monkeypatch.setattr(f"flexopt.study.verdicts.chosen.{name}", None)
    unplaced = flexopt.load_problem("article").model_copy(update={"selection": SelectionOptions()})
    for asked in ((excavator, (0.0, 1.6)), (unplaced,), (problem,)):
        with pytest.raises(flexopt.InputError, match="where the machine stands now"):
            flexopt.verdict(*asked)
    monkeypatch.undo()
    with pytest.raises(flexopt.InputError, match="control that is asked for"):
        flexopt.verdict(flexopt.load_problem("article"), loop={"control": "transpose"})


TARGETS = [(0.0, 1.6), (0.2, 1.4)]
FEW: dict[str, Any] = {"loop": ARTICLE, "members": 8, "runs": 2, "duration": 5.0}


def alone(machine: flexopt.Machine, stand: tuple[Any, Any]) -> flexopt.Outcome:
    return flexopt.outcome(machine, stand[1], base=stand[0], loop=ARTICLE)


@pytest.mark.long
def test_of_several_targets_the_worst_counts() -> None:
    """Each number is the worst of those that `outcome` and ensembles give at the targets one by one."""
    machine = flexopt.load("excavator")
    stand = flexopt.select_stand(machine, TARGETS, starts=4, base=0.0, workers=1)
    found = flexopt.verdict(stand, **FEW)
    stay, first = found.places[0], next(place for place in found.places if place.name == "candidate 1")
    assert np.allclose(found.targets, TARGETS)
    assert np.allclose(stay.base, 0.0)
    assert np.allclose(first.posture, [place.evaluation.posture for place in stand.places])
    assert first.drive == pytest.approx(abs(stand.base[0]))
    for place in found.places:
        outcomes = [alone(machine, each) for each in place.stands]
        assert len(outcomes) == len(TARGETS)
        for (base, posture), target in zip(place.stands, TARGETS, strict=True):
            assert np.allclose(flexopt.evaluate(machine, posture, base=base).end_point, target, atol=1e-8)
        assert place.decay.nominal == pytest.approx(min(each.decay for each in outcomes))
        assert place.allowed_gain.nominal == pytest.approx(
            np.min([each.allowed_gain for each in outcomes]), nan_ok=True
        )
        assert place.swing.nominal == pytest.approx(0.1 * np.max([each.swing for each in outcomes]), nan_ok=True)
        slowest = [-np.inf, -np.inf]
        for k, (base, posture) in enumerate(place.stands):
            springs = {
                name: value * place.slowest_at["stiffness"]
                for name, value, _ in machine.parameters
                if name.startswith("base.stiffness")
            }
            varied = {name: np.array([value]) for name, value in springs.items()}
            run = flexopt.simulate_ensemble(machine, posture, base=base, vary=varied, duration=1.0, **ARTICLE)
            slowest[k] = float(run.linear_growth_rate[0])
        assert place.slowest_target == int(np.argmax(slowest))
        assert place.decay.least == pytest.approx(-max(slowest), rel=1e-6)
        assert place.runs is not None
        assert place.runs.members == 2
    lines = repr(found).splitlines()
    assert any("the worst of 2 targets" in line for line in lines)
    assert sum(line.startswith("    target 2: ") for line in lines) == len(found.places)
    assert sum(line.endswith("(the slowest)") for line in lines) == len(found.places)


@pytest.mark.long
def test_a_posture_that_was_given_is_not_called_missing() -> None:
    """Of several targets no one posture is how the arm is held; only where none is known that is said."""
    machine, words = flexopt.load("excavator"), "how the arm is held was not given"
    for given, missing in (({"posture": (0.9929, -2.6302)}, False), ({}, True)):
        stand = flexopt.select_stand(machine, TARGETS, starts=2, base=0.0, workers=1, **given)
        found = repr(flexopt.verdict(stand, loop=ARTICLE, members=2, runs=0))
        assert "the postures that are best by w1 at each target" in found
        assert (words in found) == missing
        assert ("the one that was given is not used" in found) != missing
        assert ("posture: decides nothing" in repr(stand)) != missing


@pytest.mark.long
@pytest.mark.parametrize(("damping", "told"), [(0.0, True), (1e4, False)])
def test_a_self_motion_that_nothing_brakes_is_told(
    damping: float, told: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All places grow with these gains, and the runs with smaller ones drift: a damper is what is missing."""
    machine = flexopt.load("boom-stick-bucket")
    loop = {"kp": 1e9, "kv": 1e7, "dead_time": 0.02, "nullspace_damping": damping}
    selection = flexopt.select(machine, (7.0, 1.0), base=0.0, posture=(-0.6, -1.2, -0.7), starts=2, workers=1)
    found = flexopt.verdict(selection, loop=loop, members=2, runs=1, duration=5.0)
    assert all(place.runs is None or not place.runs.undecided for place in found.places)
    assert found.word == "cannot tell" or not told
    # With any other word, too, and on the page.
    for each in (found, replace(found, word="move", place="candidate 1")):
        assert ("loop.nullspace_damping brakes it" in repr(each)) == told
        brakes = "the controller does not brake the arm's self-motion, neither in these runs nor in the linear loop"
        assert (brakes in repr(each)) == told
    monkeypatch.setattr(page, "_png", lambda figure: "")
    found.to_html(tmp_path / "verdict.html")
    shown = (tmp_path / "verdict.html").read_text(encoding="utf-8")
    assert ("nor in the linear loop; loop.nullspace_damping brakes it" in shown) == told
    # Drives that follow rates hold it.
    served = replace(found, settings=replace(found.settings, drive="velocity", servo_gain=1e5))
    assert "does not brake the arm's self-motion" not in repr(served)


@pytest.mark.long
def test_what_the_loop_was_proposed_is_named_where_nothing_can_be_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The servo gain, unless it is given; and the damper of a self-motion that drifts away."""
    data = flexopt.load("boom-stick-bucket").to_dict() | {"cylinders": []}
    # The weakest joint: its effort over its speed is what a servo gain for all can be.
    data["links"] = [*data["links"][:2], data["links"][2] | {"effort": 300.0, "speed": 1.0}]
    machine = flexopt.machine_from_dict(data)
    selection = flexopt.select(machine, (7.0, 1.0), base=0.0, starts=2, workers=1)
    few: dict[str, Any] = {"members": 2, "runs": 0}
    found = flexopt.verdict(selection, loop={"drive": "velocity"}, **few)
    words = "servo gain, 300 N m s/rad, is what the weakest joint bears: with loop.servo_gain, the number of"
    monkeypatch.setattr(page, "_png", lambda figure: "")
    for word in ("cannot tell", "move"):
        told = replace(found, word=word, place="candidate 1")
        told.to_html(tmp_path / "verdict.html")
        assert (words in repr(told)) == (words in (tmp_path / "verdict.html").read_text(encoding="utf-8"))
        assert (words in repr(told)) == (word == "cannot tell")
    given = flexopt.verdict(selection, loop={"drive": "velocity", "servo_gain": 300.0}, **few)
    assert "weakest joint" not in repr(replace(given, word="cannot tell"))
    drifting = replace(found, places=tuple(replace(place, drift=0.5) for place in found.places))
    assert re.search(r"drifts away: .* loop\.nullspace_damping says how the controller brakes it", repr(drifting))
    # What is said of the slowest motion of several places is said once, with the number of each.
    shares = 0.6 + 0.01 * np.arange(len(found.places))
    mixed = replace(found, places=tuple(replace(p, self_motion=x) for p, x in zip(found.places, shares, strict=True)))
    numbers = listed(f"{100 * share:.3g}" for share in shares)
    assert f"is to {numbers} % of its kinetic energy the arm's self-motion, which below 90 %" in repr(mixed)


@pytest.mark.long
def test_the_drift_that_is_told_is_the_worst() -> None:
    """Beside eigenvalues of samples on an even scan of the springs: the arm drifts fastest at an end of their range."""
    machine = flexopt.load("boom-stick-bucket")
    loop = {"drive": "torque", "rate": 200.0, "kp": 5.42e5, "kv": 3.6e5, "nullspace_damping": 200.0, "dead_time": 0.0}
    selection = flexopt.select(machine, (7.0, 1.0), base=0.0, gravity=True, starts=2, workers=1)
    found = flexopt.verdict(selection, loop=loop, ranges={"stiffness": (0.5, 2.0)}, members=2, runs=0)
    springs = [".stiffness" in parameter.name for parameter in machine.parameters]
    sentences = dict[float, str]()
    for place in found.places:
        rates = dict[float, float]()
        for factor in (0.5, 0.7, 0.9, 1.1, 1.4, 2.0):
            p = np.array([each.value for each in machine.parameters]) * np.where(springs, factor, 1.0)
            at = found.settings.outcome(
                machine, place.base, place.posture, gravity=True, parameters=p, dead_time=0.0, own_model=True
            )
            rates[factor] = float(np.log(np.abs(np.linalg.eigvals(at.sample.matrix)).max()) / at.period)
        worst = max(rates, key=lambda factor: rates[factor])
        assert place.decay.least > 0
        assert place.drift == pytest.approx(rates[worst], rel=1e-6)
        assert place.drift_at == {"stiffness": pytest.approx(worst)}
        sentences[rates[worst]] = (
            f"in {1 / rates[worst]:.3g} s at worst, in {spoken(place.name)} at stiffness {worst:g}"
        )
        assert rates[worst] > 1.1 * max(rates[0.9], rates[1.1])
    assert sentences[max(sentences)] in repr(found)


@pytest.mark.long
def test_a_target_that_grows_grows() -> None:
    """At the first of these targets the present place grows with these gains, at the second it decays."""
    machine = flexopt.load("excavator")
    stand = flexopt.select_stand(machine, [(0.0, 1.6), (2.0, 0.8)], starts=2, base=0.0, workers=1)
    stay = flexopt.verdict(stand, **FEW | {"duration": 30.0}).places[0]
    decays = [alone(machine, each).decay for each in stay.stands]
    assert min(decays) < 0 < max(decays)
    assert stay.runs is not None
    assert stay.runs.growing == 1.0
    assert stay.stable_share == 0.0


@pytest.mark.long("16")
@pytest.mark.parametrize("members", [4, 16])
def test_delay_margins_are_looked_at_on_every_ground(members: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of one interval and of four, whose corners are more than the few that everything is asked of."""
    held = {"base": 1.8625, "posture": (1.898, -1.465), "loop": {"kp": 2e3, "kv": 500.0, "dead_time": 0.01}}
    ground: dict[str, Any] = {"stiffness": (0.9, 1.1)}
    if members == 16:
        ground |= {"damping": (0.9, 1.1), "payload.mass": (0.0, 9.0), "stick.mass": (370.0, 375.0)}
    seen, asked = set[tuple[float, ...]](), UncertainLoop.outcome

    def outcome(self: UncertainLoop, u: Any = None) -> Any:
        seen.add(() if u is None else tuple(u))
        return asked(self, u)

    monkeypatch.setattr(UncertainLoop, "outcome", outcome)
    machine = flexopt.load("excavator")
    found = flexopt.verdict(machine, (0.0, 1.6), ranges=ground, members=members, runs=0, starts=2, **held)
    assert all(math.isfinite(found.places[k].delay_margin.least) for k in (0, 1))
    box = UncertaintyBox(machine, found.uncertainty, found.settings.dead_time)
    assert {tuple(u) for u in box.members(members, found.selection.problem.seed)} <= seen


@pytest.mark.long
def test_what_the_loop_must_do_at_least_counts_at_every_target() -> None:
    """Where the present place grows at the first target alone, that is what it breaks; judged by `outcome`."""
    machine, targets, least = flexopt.load("excavator"), [(0.0, 1.6), (1.6, 1.0)], 0.001
    stand = flexopt.select_stand(
        machine, targets, starts=2, base=0.0, workers=1, loop=ARTICLE, constraints={"outcome": {"decay": least}}
    )
    found = flexopt.verdict(stand, **FEW | {"runs": 0})
    kept = [alone(machine, each).decay >= least for each in found.places[0].stands]
    assert kept == [False, True]
    assert found.word == "move"
    assert found.present_breaks.startswith("at target 1 breaks decay -")
    assert "target 2" not in found.present_breaks
    assert found.to_dict()["present_breaks"] in found.reason


@pytest.mark.long
def test_along_a_path_the_way_is_beside_standing_still() -> None:
    machine = flexopt.load("excavator")
    plan = flexopt.plan_base(machine, TARGETS, starts=1, base=0.0, workers=1, duration=20.0)
    found = flexopt.verdict(plan, **FEW)
    by_name = {place.name: place for place in found.places}
    way, still = by_name["candidate 1"], by_name["candidate 2"]
    assert np.allclose(way.base, plan.base)
    assert way.drive == pytest.approx(abs(plan.base[0, 0]) + plan.travelled[0])
    assert plan.still is not None
    assert np.allclose(still.base, plan.still.base)
    assert still.drive == pytest.approx(abs(plan.still.base[0]))
    assert np.allclose(by_name["stay"].base, 0.0)
    # A given start is where the machine stands now, and then nothing stands still elsewhere.
    begun = flexopt.plan_base(machine, TARGETS, starts=1, start=plan.base[0], workers=1, duration=20.0)
    names = [place.name for place in flexopt.verdict(begun, **FEW | {"runs": 0}).places]
    assert names == ["stay", "candidate 1"]


@pytest.mark.long
def test_the_worst_of_margins_is_met_at_whatever_corner_it_is() -> None:
    """Of four intervals: the last, dead time, is the one that matters most, and three have their corners looked at."""
    machine = flexopt.load("excavator")
    factors, values = {"stiffness": (0.6, 1.6), "damping": (0.5, 2.0)}, {"payload.mass": (0.0, 300.0)}
    late, loop = (0.0, 0.03), {"drive": "torque", "kp": 2e3, "kv": 500.0}
    ranges = [flexopt.Uncertainty(of=[name], factor=factor) for name, factor in factors.items()]
    ranges += [flexopt.Uncertainty(of=[name], value=value) for name, value in values.items()]
    ranges.append(flexopt.Uncertainty(of=["dead_time"], value=late))
    few: dict[str, Any] = {"starts": 4, "members": 16, "runs": 0}
    found = flexopt.verdict(machine, (0.0, 1.6), base=0.0, posture=[0.9929, -2.6306], loop=loop, ranges=ranges, **few)
    best = max(found.places, key=lambda place: place.decay.least)
    assert best.decay.least > 0
    outcomes: list[flexopt.Outcome] = []
    for stiffness, damping, mass, dead_time in product(*factors.values(), *values.values(), late):
        data = machine.to_dict()
        for name, factor in (("stiffness", stiffness), ("damping", damping)):
            data["base"][name] = {key: factor * value for key, value in data["base"][name].items()}
        data["payload"] = (data.get("payload") or {}) | {"mass": mass}
        there = flexopt.machine_from_dict(data)
        outcomes.append(flexopt.outcome(there, best.posture, base=best.base, loop=loop | {"dead_time": dead_time}))
    # Within the box it may be worse still.
    assert best.allowed_gain.least <= (1 + 1e-9) * min(each.allowed_gain for each in outcomes)
    assert best.delay_margin.least <= (1 + 1e-9) * min(each.delay_margin for each in outcomes)
    assert best.swing.greatest >= (1 - 1e-9) * 0.1 * max(each.swing for each in outcomes)


def test_a_place_without_an_allowed_gain_says_which_gains_were_looked_at() -> None:
    """With so high gains that lower ones than were looked at are stable; the page says so, too."""
    posture, loop = (0.9929, -2.6306), {"kp": 1e5, "kv": 1e6, "drive": "torque"}
    machine = flexopt.load("excavator")
    found = flexopt.verdict(machine, (0.0, 1.6), base=0.0, posture=posture, loop=loop, members=2, runs=0, starts=1)
    assert found.places[0].allowed_gain.least == 0.0
    assert flexopt.outcome(machine, posture, loop=loop | {name: 1e-5 * loop[name] for name in ("kp", "kv")}).decay > 0
    assert re.findall("none: .*", repr(found)) == [
        "none: on some ground it decays with no gains that were looked at, from 0.0001 of these up to these, in their "
        "ratio; lower or higher ones may do"
    ]
    assert found.no_gain.capitalize() in found._html()


def test_the_allowed_gain_of_a_place_that_grows_says_that_lower_ones_may_grow() -> None:
    """A place whose least allowed gain is above the border of another ground, which bears less, and then more again."""
    machine = flexopt.load("excavator")
    loop = {"kp": 1e4, "kv": 1e3}
    judged = flexopt.verdict(machine, (0.0, 1.6), base=0.0, loop=loop, members=2, runs=0, starts=2)
    decays = [replace(place, decay=replace(place.decay, least=1.0)) for place in judged.places]
    free, stay = replace(judged, places=tuple(decays)), decays[0]
    assert free.lower_gains == ""
    grows = replace(stay, decay=replace(stay.decay, least=-1.0))
    found = replace(free, places=(grows, *free.places[1:]))
    assert found.lower_gains.startswith("allowed Kp of the present place: with the present gains it grows")
    assert f"  {found.lower_gains}\n" in repr(found)
    assert found.lower_gains[1:] in found._html()
    # Of what has none, or no border, another sentence or the word itself tells.
    for gain in (0.0, math.inf, math.nan):
        other = replace(grows, allowed_gain=replace(stay.allowed_gain, least=gain))
        assert replace(free, places=(other, *free.places[1:])).lower_gains == ""


def test_what_is_worse_where_it_moves_is_told() -> None:
    """The word goes by the decay; what else is worse stands beside it, on the page and in the document, too."""
    found = judged("article", loop=ARTICLE, members=2, runs=0)
    assert found.word == "move"
    assert found.drawbacks == ""
    k = next(k for k, place in enumerate(found.places) if place.name == found.place)
    band = found.places[0].decay
    stay = replace(
        found.places[0], settling=replace(band, greatest=10.0), swing=replace(band, greatest=1e-3),
        allowed_gain=replace(band, least=2e4), delay_margin=replace(band, least=0.02),
    )  # fmt: skip

    def told_of(**worst: float) -> str:
        ends = {"settling": "greatest", "swing": "greatest", "allowed_gain": "least", "delay_margin": "least"}
        there = {name: replace(getattr(stay, name), **{end: worst.get(name, getattr(getattr(stay, name), end))})
                 for name, end in ends.items()}  # fmt: skip
        places = [stay, *found.places[1:]]
        places[k] = replace(found.places[k], **there)
        return replace(found, places=tuple(places)).drawbacks

    assert told_of() == ""
    assert told_of(settling=10.9, swing=1.09e-3, allowed_gain=1.81e4, delay_margin=0.0181) == ""
    assert told_of(settling=5.0, swing=5e-4, allowed_gain=math.inf, delay_margin=math.inf) == ""
    assert told_of(settling=20.0) == "in the worst case it settles in 20 instead of 10 s there"
    assert told_of(settling=math.nan) == "in the worst case it does not settle in a minute instead of in 10 s there"
    assert told_of(swing=2e-3, delay_margin=0.01) == (
        "in the worst case it moves the base by 2 instead of 1 mrad in a move of 0.1 m, "
        "bears 10 instead of 20 ms more of dead time there"
    )
    assert told_of(allowed_gain=1e4) == "in the worst case it bears Kp up to 1e+04 instead of 2e+04 N m there"
    assert "drawbacks" in found.to_dict()
    # Up to what a move counts as settled within it rests at the target; where nothing holds it, it rests nowhere.
    for now, rests, words in (
        (1e-3, 1.9e-3, ""),
        (1e-3, 5e-3, "in the worst case it comes to rest 0.005 instead of 0.001 m off the target there"),
        (math.nan, 5e-3, ""),
        (math.nan, 5e-2, "in the worst case it comes to rest 0.05 m off the target there"),
    ):
        places = [replace(stay, rests_off=now, decay=replace(stay.decay, least=0.1)), *found.places[1:]]
        places[k] = replace(places[0], name=found.place, rests_off=rests)
        assert replace(found, places=tuple(places)).drawbacks == words
    places[0] = replace(places[0], rests_off=1e-3, decay=replace(stay.decay, least=-0.1))
    apart = "instead of 0.001 m (where it stands, not counting where it grows) off the target there"
    assert replace(found, places=tuple(places)).drawbacks.endswith(f"it comes to rest 0.05 {apart}")
    # What has no border where it stands has one there.
    endless = replace(band, least=math.inf)
    stay = replace(stay, allowed_gain=endless, delay_margin=endless)
    assert told_of() == ""
    assert told_of(allowed_gain=1e4, delay_margin=0.01) == (
        f"in the worst case it bears Kp up to 1e+04 instead of above {found.settings.highest_kp:.4g} N m, "
        "bears 10 instead of any number of ms more of dead time there"
    )


@pytest.mark.long
def test_what_objectives_before_keep_is_no_constraint_to_stay_by() -> None:
    """Nobody asked for a least w1: a place that has less of it than the best may be stayed at all the same."""
    found = flexopt.select(
        flexopt.load("excavator"), (0.0, 1.6), objective="w1,decay", base=0.0, loop=ARTICLE, starts=2
    )
    now = found.initial
    assert now is not None
    assert now.w[0] < found.kept[0].at_least
    assert "breaks w1" in found.present_told
    judged_now = flexopt.verdict(found, loop=ARTICLE, members=2, runs=0)
    assert judged_now.present_breaks == ""
    assert judged_now.places[0].name == "stay"


def test_the_targets_that_the_present_placement_does_not_reach_are_named() -> None:
    """The arm's first joint stands 0.173 m from the base's place and 0.513 m high, and the arm reaches from 0.82 to 3.01 m."""
    machine = flexopt.load("excavator")
    targets, at = [(0.0, 0.8), (1.0, 0.8)], np.array([0.173103, 0.512559])
    for base in (0.0, 1.5):
        stand = flexopt.select_stand(
            machine, targets, base=(base,), base_range={"x": (-4, 4)}, objective="w1", starts=1, workers=1
        )
        far = [np.hypot(*(np.array(target) - at - [base, 0])) for target in targets]
        off = [k for k, distance in enumerate(far, start=1) if not 0.821 <= distance <= 3.015]
        assert off == ([1] if base == 0.0 else [2])
        assert f"does not reach target {off[0]} within" in unreached(stand)
        assert "stay" not in configurations_of(stand)
    far_away = flexopt.select_stand(machine, targets, base=(9.0,), objective="w1", starts=1, workers=1)
    assert "does not reach targets 1 and 2 within" in unreached(far_away)


BENT = [(0.0, 1.6), (0.1, 1.5)]


def limited(low: float, high: float) -> tuple[flexopt.Machine, list[float]]:
    """The excavator with limits of its stick, and by how much that is bent, either way, at each target from x = 0."""
    data = flexopt.load("excavator").to_dict()
    data["links"][1]["limits"] = [low, high]
    first, second = (link["length"] for link in data["links"])
    bends = list[float]()
    for target in BENT:
        away = math.dist(target, (0.173103, 0.512559))  # from where the first joint stands
        bends.append(math.acos((away**2 - first**2 - second**2) / (2 * first * second)))
    return flexopt.machine_from_dict(data), bends


@pytest.mark.parametrize("kind", ["stand", "way", "by the loop"])
def test_a_placement_from_which_a_joint_goes_beyond_its_limits_is_none_to_stay_at(kind: str) -> None:
    """The elbow by the law of cosines; where the other elbow keeps the limits the arm is held so."""
    few: dict[str, Any] = {"base": 0.0, "starts": 1, "workers": 1}
    for low, high in ((-2.0, 2.0), (-2.7, 2.4), (-2.2, 2.9)):
        machine, bends = limited(low, high)
        off = [k for k, bend in enumerate(bends, start=1) if not (-bend >= low or bend <= high)]
        if kind == "way":
            found = flexopt.plan_base(machine, BENT, duration=20.0, **few)
        elif kind == "stand":
            found = flexopt.select_stand(machine, BENT, **few)
        else:
            found = flexopt.select_stand(machine, BENT, objective="decay", loop=ARTICLE, **few)
        places = configurations_of(found)
        assert ("stay" in places) == (not off)
        if not off:
            assert [e.posture[1] for e in places["stay"]] == pytest.approx(bends, abs=1e-5)
            continue
        which = f"target {off[0]}" if len(off) == 1 else "targets 1 and 2"
        assert f"does not reach {which} within its limits" in unreached(found)
        if isinstance(found, flexopt.Stand):
            assert [held_at(found, k) is None for k in (0, 1)] == [k in off for k in (1, 2)]


@pytest.mark.long
def test_runs_need_no_present_place_that_is_beyond_a_joints_limits() -> None:
    machine, _ = limited(-2.0, 2.0)
    stand = flexopt.select_stand(machine, BENT, base=0.0, starts=2, workers=1)
    found = flexopt.verdict(stand, loop=ARTICLE, members=2, runs=1, duration=2.0)
    assert "does not reach targets 1 and 2 within its limits" in found.reason
    assert all(place.name != "stay" for place in found.places)


def test_a_margin_of_the_joints_that_was_asked_for_is_broken_as_constraints_are() -> None:
    """By the room that the elbow leaves to the nearer limit, with one target, its posture given or not, and several."""
    (machine, bends), least = limited(-2.8, 2.4), 0.3
    few: dict[str, Any] = {"base": 0.0, "starts": 2, "constraints": {"joint_margin": least}}
    broken_by = [f"breaks joint margin of stick, {2.8 - bend:.4g} rad (at least {least} rad)" for bend in bends]
    stand = flexopt.select_stand(machine, BENT, workers=1, **few)
    whole = "; ".join(f"at target {k} {each}" for k, each in enumerate(broken_by, start=1))
    for found, breaks in (
        (flexopt.select(machine, BENT[0], **few), broken_by[0]),
        (flexopt.select(machine, BENT[0], posture=(0.9929, -bends[0]), **few), broken_by[0]),
        (stand, whole),
    ):
        stay = configurations_of(found)["stay"]
        # Nothing is asked of a loop.
        assert broken_standing(found, [(e.base, e.posture) for e in stay]) == breaks
        if isinstance(found, flexopt.Selection):
            assert found.present_told.endswith(breaks)


OWN = {"kp": 1e4, "kv": 1e3, "dead_time": 0.02}


@pytest.mark.long
@pytest.mark.parametrize(
    "sought", [{"constraints": {"outcome": {"decay": 0.005}}}, {"objective": "decay"}], ids=["least", "objective"]
)
def test_what_is_sought_of_the_loop_is_sought_of_the_one_that_is_judged(sought: dict[str, Any]) -> None:
    """Of a machine and of a problem file without a loop; a loop that the call brings counts for places and verdict."""
    machine, few = flexopt.load("excavator"), {"members": 4, "runs": 0}
    asked: dict[str, Any] = {"base": 0.0, "posture": (0.9929, -2.6302), "starts": 8}
    brought = {"loop": OWN, "ranges": {"stiffness": (0.5, 2.0)} if "objective" in sought else None}
    chosen = flexopt.select(machine, (0.0, 1.6), **brought, **asked, **sought)
    options = asked | {name: value for name, value in sought.items() if name == "objective"}
    rest = {name: value for name, value in sought.items() if name == "constraints"}
    problem = flexopt.Problem(
        name="own", machine="excavator", target={"end_point": (0.0, 1.6)}, selection=options, **rest
    ).with_machine(machine)
    verdicts = [flexopt.verdict(problem, **brought, **few)]
    if "objective" in sought:
        verdicts.append(flexopt.verdict(machine, (0.0, 1.6), **brought, **few, **asked, **sought))
        verdicts.append(flexopt.report(problem, **brought, points=4, **few).verdict)
    for verdict in verdicts:
        assert isinstance(verdict.selection, flexopt.Selection)
        found = [candidate.objective for candidate in verdict.selection.candidates]
        assert found == pytest.approx([candidate.objective for candidate in chosen.candidates], rel=1e-9)
        assert verdict.settings.dead_time == OWN["dead_time"]


def test_on_what_a_place_rests_is_told(tmp_path: Path) -> None:
    """Joints at their limits, of which runs know nothing; as the choice has it of its candidates."""
    machine = flexopt.load("excavator")
    chosen = flexopt.select(machine, (0.0, 1.6), base=0.3, base_range={"x": (0.2, 0.5)}, starts=4)
    verdict = flexopt.verdict(chosen, loop={"kp": 1e4, "kv": 1e3}, members=4, runs=1, duration=5.0)
    for k, candidate in enumerate(chosen.candidates, start=1):
        place = next((each for each in verdict.places if each.name == f"candidate {k}"), None)
        if place is not None:
            assert set(candidate.active) - set(candidate.kinks) <= set(place.rests_on[0])
            assert place.to_dict()["rests_on"] == [list(place.rests_on[0])]
    resting = [place for place in verdict.places if place.rests_on[0]]
    assert resting
    assert all(place.rest in repr(verdict) for place in resting)
    verdict.to_html(tmp_path / "verdict.html")
    text = (tmp_path / "verdict.html").read_text(encoding="utf-8")
    assert all(place.rest.split(" ", 1)[1] in text for place in resting)


@pytest.mark.long
def test_a_place_may_rest_on_what_its_loop_must_do_at_least() -> None:
    """Candidates by w3 that just decay as fast as they must; and a bound that nobody gave is named as assumed."""
    machine, loop = flexopt.load("excavator"), {"kp": 1e4, "kv": 1e3}
    few: dict[str, Any] = {"members": 4, "runs": 0}
    least = {"outcome": {"decay": 0.013}}
    found = flexopt.verdict(
        machine, (0.0, 1.6), base=0.0, loop=loop, objective="w3", constraints=least, starts=4, **few
    )
    just = [place for place in found.places if abs(place.decay.nominal - 0.013) < 1e-9]
    assert just
    assert all("decay" in place.rests_on[0] for place in just)
    far = flexopt.verdict(machine, (0.3, 0.3), base=1.5, loop=loop, **few)
    (drive,) = [each.value for each in far.problems[0].assumed if each.name == "reach"]
    for place in far.places:
        at_end = math.isclose(abs(float(place.base[0]) - 1.5), drive, abs_tol=1e-5)
        assert any(name.endswith("bound (assumed: reach)") for name in place.rests_on[0]) == at_end
    assert all(sentence in repr(far) for sentence in far.assumed)
    assert far.to_dict()["assumed"] == far.assumed == [*map(str, far.problems[0].assumed), GROUND_ASSUMED]
    assert replace(far, uncertainty=tuple(copy.deepcopy(far.uncertainty))).assumed == far.assumed
    told = flexopt.verdict(machine, (0.3, 0.3), base=1.5, loop=loop, ranges={"stiffness": (0.5, 2.0)}, **few)
    assert told.assumed == far.assumed[:-1]


def test_what_all_targets_rest_on_is_told_once() -> None:
    found = flexopt.verdict(
        flexopt.load("excavator"), (0.0, 1.6), base=0.0, loop={"kp": 1e4}, starts=2, members=2, runs=0
    )
    place = replace(
        found.places[0], rests_on=(("base.x upper bound", "decay"), ("base.x upper bound", "boom lower bound"))
    )
    assert place.rest == "stay rests on base.x upper bound, decay at target 1, boom lower bound at target 2"
    assert replace(place, rests_on=((), ())).rest == ""
    # An end of a joint in the file's numbers or at a corner: runs go beyond it all the same. One of the base is no joint's.
    runs = Runs(("converges",), np.ones(1), np.ones(1), np.ones(1), (True,), ("",), 5.0)
    for name, stops in (("boom lower bound", True), ("limits of boom where stiffness is 1.4", True), ("decay", False),
                        ("base.x upper bound", False)):  # fmt: skip
        assert ("runs know no end stops" in replace(place, runs=runs, rests_on=((name,), ())).rest) == stops


def value_of(machine: Any, name: str) -> float:
    return next(each.value for each in machine.parameters if each.name == name)


@pytest.mark.long
def test_a_place_that_cannot_hold_a_heavier_load_is_told() -> None:
    """Choices keep the share of efforts with the file's payload; with more of it the joints' own torques say."""
    machine = flexopt.load("boom-stick-bucket")
    asked: dict[str, Any] = {
        "base": 0.0, "constraints": {"holding": 0.9}, "loop": "default", "starts": 2, "members": 4, "runs": 0,
    }  # fmt: skip
    load = value_of(machine, "payload.mass")
    words = list[list[str]]()
    for heaviest in (1.001 * load, 4e4):
        # Those that no constraint depends on, before it, hide nothing.
        ground = {
            f"{word}.{d}": (0.9, 1.1) for word in ("base.stiffness", "base.damping") for d in ("x", "y", "rotation")
        }
        ground = {name: tuple(end * value_of(machine, name) for end in ends) for name, ends in ground.items()}
        ground |= {"dead_time": (0.0, 0.01), "payload.mass": (load, heaviest)}
        found = flexopt.verdict(machine, (7.0, 1.0), ranges=ground, **asked)
        words.append([place.breaks for place in found.places])
        assert all((place.broken in repr(found)) for place in found.places)
        assert [place["breaks"] for place in found.to_dict()["places"]] == words[-1]
    assert not any(words[0])
    assert any(words[1])
    data = machine.to_dict()
    data["payload"]["mass"] = 4e4
    heavy = flexopt.machine_from_dict(data)
    strongest = [max(each["force"]) for each in data["cylinders"]]
    for place in found.places:
        there = flexopt.evaluate(heavy, place.posture, base=place.base).cylinders
        too_much = [abs(each.force) > 0.9 * most for each, most in zip(there, strongest, strict=True)]
        assert any(too_much) <= bool(place.breaks)
        for each, much in zip(there, too_much, strict=True):
            assert (each.name in place.breaks) >= much
        if place.breaks:
            assert place.breaks.startswith("breaks holding of ")
            assert place.breaks.endswith(" where payload.mass is 4e+04 kg")


def overloaded(place: PlaceVerdict, heaviest: float, times: float = 1.0) -> list[set[str]]:
    """At each target the joints whose cylinders bear less than what they hold of this load, by `evaluate` alone.

    `times`: of all other masses.
    """
    data = flexopt.load("boom-stick-bucket").to_dict()
    data["payload"]["mass"] = heaviest
    for body in (data["base"], *data["links"]):
        body["mass"] *= times
    heavy = flexopt.machine_from_dict(data)
    pushes, pulls = ({each["name"]: each["force"][k] for each in data["cylinders"]} for k in (1, 0))
    found = list[set[str]]()
    for base, posture in place.stands:
        held = flexopt.evaluate(heavy, posture, base=base).cylinders
        found.append({c.name for c in held if c.force > 0.9 * pushes[c.name] or -c.force > 0.9 * pulls[c.name]})
    return found


@pytest.mark.long("targets0-2500.0-move", "targets1-4500.0-move", "targets3-4500.0-move", "targets4-4000.0-move")
@pytest.mark.parametrize(
    ("targets", "heaviest", "word"),
    [
        ([(5.0, -1.0)], 2500.0, "move"),  # candidate 1 breaks it, others do not
        ([(5.0, -1.0)], 4500.0, "move"),  # the present place, too
        ([(6.0, 3.0)], 3300.0, "stay"),  # there is but one candidate
        ([(5.0, -1.0), (6.0, -1.0)], 4500.0, "move"),  # at one target, at each
        ([(6.0, 1.0), (7.0, 2.0)], 4000.0, "move"),  # every place breaks it
    ],
)
def test_no_machine_is_sent_where_it_cannot_hold_the_heaviest_load(
    targets: list[tuple[float, float]], heaviest: float, word: str
) -> None:
    """Where another place keeps constraints on every ground; what a place breaks is judged by `evaluate` alone."""
    machine = flexopt.load("boom-stick-bucket")
    asked: dict[str, Any] = {"base": 0.0, "constraints": {"holding": 0.9}, "starts": 6}
    if len(targets) > 1:
        chosen: Any = flexopt.select_stand(machine, targets, **asked)
    else:
        chosen = flexopt.select(machine, targets[0], **asked)
    ranges = {"payload.mass": (1000.0, heaviest), "stiffness": (0.5, 2.0)}
    found = flexopt.verdict(chosen, loop="default", ranges=ranges, members=4, runs=0)
    broken = {place.name: overloaded(place, heaviest) for place in found.places}
    for place in found.places:
        every = set.union(*broken[place.name])
        assert bool(place.breaks) == bool(every)
        for name in every:
            at = [k for k, names in enumerate(broken[place.name], start=1) if name in names]
            where = "" if len(at) == len(targets) else f" at target {' and '.join(map(str, at))}"
            assert f"by {name}{where}" in place.breaks
    keeping = [name for name, each in broken.items() if not any(each)]
    assert found.word == word
    if keeping:
        assert found.place in keeping
        assert {name for name in broken if name not in keeping} == {*found.excluded} & set(broken)
        assert not found.drawbacks.startswith("every place")
        if any(broken["stay"]):
            # How the arm is held was not given.
            how = (
                "held as is best by w1 at each target"
                if len(targets) > 1
                else "in one of the postures that reach the target"
            )
            assert found.reason.startswith(f"the present place, {how}, {found.places[0].breaks}")
            assert ("; nor is it stable on every ground: " in found.reason) == (found.places[0].decay.least <= 0)
            assert found.exclusions["stay"].startswith(found.places[0].breaks)
            assert "the present place is none to stay at: another place keeps constraints on every" in repr(found)
        if word == "stay":
            assert "no place found by w1 that keeps the constraints" in found.reason
            # Each of those left out is in the table, as there are so few.
            assert found.places[1].better == 1.0
            assert "candidate 1 decays at least 10 % faster on 100 % of the grounds, but breaks" in found.reason
    else:
        assert found.excluded == ()
        there = next(place for place in found.places if place.name == found.place)
        assert f"every place found breaks constraints on some ground: {there.name} {there.breaks}" in found.drawbacks
    assert found.to_dict()["excluded"] == list(found.excluded)


@pytest.mark.long
def test_a_load_that_is_known_but_another_than_the_files_counts_alike() -> None:
    """An interval of one number, which nothing moves within."""
    machine = flexopt.load("boom-stick-bucket")
    chosen = flexopt.select(machine, (5.0, -1.0), base=0.0, constraints={"holding": 0.9}, starts=6)
    alike = [
        flexopt.verdict(chosen, loop="default", ranges={"payload.mass": (low, 2500.0)}, members=4, runs=0)
        for low in (2499.0, 2500.0)
    ]
    assert alike[0].excluded == alike[1].excluded == ("candidate 1",)


def test_own_constraints_are_looked_at_with_other_loads_too() -> None:
    """A bound on the boom's torque, against the weight's of a machine whose file has the load."""
    machine, heaviest, most = flexopt.load("boom-stick-bucket"), 3000.0, 2.6e5
    x = ca.MX.sym("torques", 3)
    own = flexopt.Constraint(ca.Function("boom_torque", [x], [x[0]], ["torques"], ["o"]), lower=-most, upper=most)
    chosen = flexopt.select(machine, (6.0, 2.0), base=0.0, constraints=[own], starts=5)
    found = flexopt.verdict(chosen, loop="default", ranges={"payload.mass": (0.0, heaviest)}, members=4, runs=0)
    data = machine.to_dict()
    data["payload"]["mass"] = heaviest
    plant = flexopt.build_plant(flexopt.machine_from_dict(data))
    for place in found.places:
        q = plant.rest(place.base, place.posture, plant.parameter_values)
        torque = float(plant.gravity(q, place.base, plant.parameter_values)[plant.n_passive])
        assert bool(place.breaks) == (abs(torque) > most)
        told = re.fullmatch(
            r"(breaks boom_torque, (\S+) \(-2.6e\+05 to 2.6e\+05\), where payload.mass is 3000 kg)?",
            place.breaks,
        )
        assert told is not None
        assert not place.breaks or float(told[2]) == pytest.approx(torque, rel=1e-3)
    assert found.excluded == ("stay", "candidate 1")
    # Which `constraints.within` keeps with the file's numbers; of others it is told what it does.
    assert "constraints.within" not in repr(found)
    broken = found.places[0]
    told = replace(broken, breaking=broken.breaking._replace(sought="some"))
    both = repr(replace(found, places=(told, *found.places[1:])))
    assert both.count("constraints.within of these numbers keeps constraints there, too, all but Functions of one") == 1
    assert found.place == "candidate 2"
    shown = {place.name: place.breaks for place in found.places}
    assert found.exclusions == {name: shown[name] for name in found.excluded}
    assert found.to_dict()["exclusions"] == found.exclusions


@pytest.mark.parametrize(("beyond", "barred"), [(0.005, False), (0.02, True)])
def test_what_is_broken_by_less_than_loads_are_known_to_is_told_and_bars_nothing(beyond: float, barred: bool) -> None:
    """A bound on the boom's torque, passed by half a per cent and by two with the load of a corner."""
    machine, most = flexopt.load("boom-stick-bucket"), 2.6e5
    x = ca.MX.sym("torques", 3)
    own = flexopt.Constraint(ca.Function("boom_torque", [x], [x[0]], ["torques"], ["o"]), lower=-most, upper=most)
    chosen = flexopt.select(machine, (6.0, 2.0), base=0.0, constraints=[own], starts=5)
    plant, first = flexopt.build_plant(machine), chosen.candidates[0].evaluation
    data, torques = machine.to_dict(), list[float]()
    for mass in (0.0, 1000.0):
        data["payload"]["mass"] = mass
        p = flexopt.build_plant(flexopt.machine_from_dict(data)).parameter_values
        q = plant.rest(first.base, first.posture, p)
        torques.append(abs(float(plant.gravity(q, first.base, p)[plant.n_passive])))
    heaviest = 1000.0 * ((1.0 + beyond) * most - torques[0]) / (torques[1] - torques[0])
    found = flexopt.verdict(chosen, loop="default", ranges={"payload.mass": (0.0, heaviest)}, members=4, runs=0)
    broken = {place.name: place.breaks for place in found.places}
    assert broken["candidate 1"].startswith(f"breaks boom_torque, {(1 + beyond) * most:.4g} ")
    assert not broken["candidate 2"]
    assert ("candidate 1" in found.excluded) == barred
    told = replace(found, word="move", place="candidate 1").drawbacks
    assert f"candidate 1 {broken['candidate 1']}" in told
    # Of one that counts as kept nothing is said of all others.
    assert told.endswith(SO_LITTLE) == ("every place found" not in told) == (not barred)


@pytest.mark.long
def test_the_sentences_about_other_places_are_of_the_tables_numbers() -> None:
    """Why no nearer place, a slower decay than where a trench was dug, and how the arm is held beside an obstacle."""
    machine, target = flexopt.load("boom-stick-bucket"), (6.3, 1.6)
    few: dict[str, Any] = {"loop": "default", "members": 4, "runs": 0, "starts": 4}
    free = flexopt.verdict(machine, target, base=0.0, constraints={"tip_over_margin": 0.3}, **few)
    places = {place.name: place for place in free.places}
    there = places[free.place]
    told = re.fullmatch(r"(\S+ \d+) is nearer, (\S+) m away, but its slowest decay is (\S+)/s only", free.passed_over)
    assert (free.word, told is not None) == ("move", True)
    near = places[told[1]]
    assert 1e-3 < near.drive < 0.9 * there.drive
    assert (float(told[2]), float(told[3])) == pytest.approx((near.drive, near.decay.least), rel=5e-3)
    assert near.decay.least < 0.9 * there.decay.least
    assert free.to_dict()["passed_over"] == free.passed_over
    now = max(flexopt.verdict(machine, (7.0, 1.0), base=0.0, **few).places, key=lambda place: place.decay.least)
    x = float(now.base[0])
    dug: dict[str, Any] = {"keep_out": [[x - 0.8, x + 0.8]]}
    found = flexopt.verdict(machine, (7.0, 1.0), base=now.base, posture=now.posture, constraints=dug, **few)
    decays = [place.decay.least for place in found.places if place.name in ("stay", found.place)]
    assert found.word == "move"
    assert decays[1] < 0.9 * decays[0]
    assert f"decays at {decays[1]:.4g} instead of {decays[0]:.4g} 1/s" in found.drawbacks
    box = {"kind": "box", "center": [5.5, 4.4], "size": [0.4, 0.4]}
    asked: dict[str, Any] = {"clearance": {"distance": 0.1, "obstacles": [box]}}
    for obstacles, other in ((asked, True), ({}, False)):
        held = flexopt.verdict(machine, (6.1, 3.5), base=0.0, constraints=obstacles, **few)
        assert ("another than the choice's present one, which breaks" in held.taken) == other
        first = held.selection
        assert isinstance(first, flexopt.Selection)
        assert (np.abs(first.initial.posture - held.places[0].posture).max() > 1e-3) == other


@pytest.mark.long("4-; and 1 more breaks some", "6-; and 3 more break some")
@pytest.mark.parametrize(
    ("count", "end"), [(1, ""), (3, ""), (4, "; and 1 more breaks some"), (6, "; and 3 more break some")]
)
def test_what_is_left_out_says_what_it_breaks(count: int, end: str) -> None:
    """Three of them in full."""
    chosen = flexopt.select(flexopt.load("excavator"), (0.0, 1.6), base=0.0, starts=4)
    answer = flexopt.verdict(chosen, loop={"kp": 1e4, "kv": 1e3}, members=4, runs=0)
    kept = len([place for place in answer.places if place.name != "stay"])
    exclusions = {f"candidate {40 + k}": f"breaks holding of joint {k}" for k in range(count)}
    found = replace(answer, exclusions=exclusions, judged=kept + count)
    assert found.excluded == tuple(exclusions)
    told = found.left_out.partition("candidates were judged; ")[2]
    each = [f"; {name} {breaks}" for name, breaks in exclusions.items()]
    assert told.endswith("".join(each[:3]) + end)
    assert not any(part in told for part in each[3:])


@pytest.mark.long
def test_a_broken_constraint_is_told_where_it_is_broken_most() -> None:
    """By the weight's torque at every corner: of loads that break either bound, and of a bucket never the file's."""
    machine = flexopt.load("boom-stick-bucket")
    x = ca.MX.sym("torques", 3)
    torque = ca.Function("boom_torque", [x], [x[0]], ["torques"], ["o"])
    own = flexopt.Constraint(torque, lower=1.854e5, upper=2.056e5)
    chosen = flexopt.select(machine, (6.0, 2.0), base=0.0, constraints=[own], starts=5)
    ranges = {"payload.mass": (790.0, 3000.0), "bucket.mass": (1200.0, 1500.0)}
    found = flexopt.verdict(chosen, loop="default", ranges=ranges, members=4, runs=0)
    names = [parameter.name for parameter in machine.parameters]
    plant = flexopt.build_plant(machine)

    def at(place: PlaceVerdict, payload: float, bucket: float) -> float:
        p = plant.parameter_values.full().ravel()
        p[[names.index("payload.mass"), names.index("bucket.mass")]] = payload, bucket
        q = plant.rest(place.base, place.posture, p)
        return float(plant.gravity(q, place.base, p)[plant.n_passive])

    for place in found.places:
        told = re.fullmatch(r"breaks boom_torque, (\S+) \(1.854e\+05 to 2.056e\+05\), where (.*)", place.breaks)
        if place.name == "stay" and told is None:
            continue
        assert told is not None
        values = {ends: at(place, *ends) for ends in product((790.0, 3000.0), (1200.0, 1500.0))}
        off = {ends: max(1.854e5 - value, value - 2.056e5) for ends, value in values.items()}
        worst = max(off, key=lambda ends: off[ends])
        assert float(told[1]) == pytest.approx(values[worst], rel=5e-4)
        assert told[2] == f"bucket.mass is {worst[1]:g} kg and payload.mass is {worst[0]:g} kg"


@pytest.mark.long
def test_a_linkage_that_does_not_close_on_some_ground_holds_nothing_there() -> None:
    """Whichever end of the interval it is; what is broken at the other end, nearer to the file's, is found alone."""
    data = flexopt.load("boom-stick-bucket").to_dict()
    data["payload"]["mass"] = 4000.0
    machine = flexopt.machine_from_dict(data)
    chosen = flexopt.select(machine, (7.0, 1.0), base=0.0, constraints={"holding": 0.9}, starts=4)
    name, own = "bucket cylinder.rocker.coupler_point.x", -0.011
    for ends, what in (((-1.511, 0.139), "no number"), ((own, 0.139), r"\S+ N"), ((-1.511, own), "no number")):
        ranges = {name: ends}
        found = flexopt.verdict(chosen, loop="default", ranges=ranges, members=4, runs=0)
        pattern = rf"breaks holding of bucket by bucket cylinder, {what} \(.*\), where {re.escape(name)} is \S+ m"
        assert any(re.fullmatch(pattern, place.breaks) for place in found.places)


@pytest.mark.long
def test_names_of_obstacles_are_no_corners() -> None:
    """What is said of one, whatever it is called, is said of the other; two of them are two."""
    data = flexopt.load("boom-stick-bucket").to_dict()
    data["base"]["stiffness"] = {name: 0.1 * own for name, own in data["base"]["stiffness"].items()}
    machine = flexopt.machine_from_dict(data)
    told = list[list[str]]()
    for name in ("wall", "wall where trucks pass"):
        box = {"kind": "box", "name": name, "center": [5.0, 3.0], "size": [0.4, 1.0]}
        asked: dict[str, Any] = {"clearance": {"distance": 0.05, "obstacles": [box]}}
        chosen = flexopt.select(machine, (7.0, 1.0), base=0.0, constraints=asked, starts=4, gravity=True)
        found = flexopt.verdict(chosen, loop="default", ranges={"stiffness": (0.3, 1.0)}, members=4, runs=0)
        told.append([place.breaks.replace(name, "…") for place in found.places])
    assert any(told[0])
    assert told[0] == told[1]
    boxes = [{"kind": "box", "name": f"wall where {who} work", "center": center, "size": [0.4, 1.0]}
             for who, center in (("men", [5.0, 3.0]), ("trucks", [4.2, 3.2]))]  # fmt: skip
    # Every capsule is nearer to either than this: each is told or counted.
    asked = {"clearance": {"distance": 9.0, "obstacles": boxes}}
    problem = flexopt.build_selection(machine, (7.0, 1.0), base=0.0, constraints=asked)
    z = np.array([0.0, 0.9, -1.2, -0.8])
    names = broken_names(problem, z, asked=True)
    assert len({name.partition(" from ")[2] for name in names}) == 2
    assert broken(problem, z, asked=True).endswith(f" and {len(names) - 3} more")


def test_what_grows_between_the_members_is_not_stable_everywhere() -> None:
    """A search from the members finds it: then the share is of these alone."""
    assert stable_told(1.0, -0.2) == "100 % of the members"
    assert stable_told(1.0, 0.2) == "100 %"
    assert stable_told(0.5, -0.2) == "50 %"


def test_of_many_intervals_each_constraint_is_looked_at_where_its_own_room_falls() -> None:
    """Six move the tip-over margin more than the seventh, which alone breaks what a joint holds."""
    data = flexopt.load("boom-stick-bucket").to_dict()
    data["payload"]["mass"] = 4000.0
    machine = flexopt.machine_from_dict(data)
    heavy: dict[str, Any] = {"bucket.mass": (899.0, 905.0)}
    others: dict[str, Any] = {"base.mass": (17000.0, 21000.0), "base.com": (1.0, 1.2), "base.com_offset": (0.7, 0.95),
                              "boom.mass": (1300.0, 1600.0), "stick.mass": (700.0, 1000.0),
                              "boom.com_offset": (0.3, 0.6)}  # fmt: skip
    asked: dict[str, Any] = {"holding": 0.85, "tip_over_margin": 0.05}
    chosen = flexopt.select(machine, (8.0, 1.0), base=0.0, base_range=(-1.0, 0.0), constraints=asked, starts=4)
    uncertain = tuple(flexopt.Uncertainty(of=name, value=ends) for name, ends in (others | heavy).items())
    stand = [(each.base, each.posture) for each in configurations_of(chosen)["candidate 1"]]
    told, _, sought = broken_within(chosen, stand, UncertaintyBox(machine, uncertain, 0.0))
    assert sought == "all"
    # As of a machine whose file has that number, by how much, is what `evaluate` says.
    data["links"][2]["mass"] = 905.0
    held = flexopt.evaluate(flexopt.machine_from_dict(data), stand[0][1], base=stand[0][0]).cylinders[1]
    assert held.name == "stick cylinder"
    assert told.startswith(f"breaks holding of stick by stick cylinder, {held.force:.4g} N (")
    assert told.endswith("where bucket.mass is 905 kg")


@pytest.mark.long
@pytest.mark.parametrize("turned", [False, True])
def test_factors_of_one_number_multiply_where_constraints_are_looked_at(turned: bool) -> None:
    """Masses known to a tenth, and the payload besides: the heaviest payload is told, whichever comes first."""
    machine = flexopt.load("boom-stick-bucket")
    of = [
        flexopt.Uncertainty(of="payload.mass", factor=(0.5, 4.0)),
        flexopt.Uncertainty(of="*.mass", factor=(0.9, 1.2)),
    ]
    ranges = of[::-1] if turned else of
    chosen = flexopt.select(machine, (6.0, 2.0), base=0.0, constraints={"holding": 0.9}, starts=4)
    found = flexopt.verdict(chosen, loop="default", ranges=ranges, members=4, runs=0)
    load = flexopt.load("boom-stick-bucket").to_dict()["payload"]["mass"]
    corners = [(factor * times * load, times) for factor, times in product((0.5, 4.0), (0.9, 1.2))]
    breaking = {
        place.name: [k for k, at in enumerate(corners) if any(overloaded(place, *at))] for place in found.places
    }
    assert any(breaking.values())
    for place in found.places:
        assert bool(place.breaks) == bool(breaking[place.name])
        assert not place.breaks or f"payload.mass is {4.8 * load:g} kg" in place.breaks


@pytest.mark.long
def test_what_a_choice_keeps_at_corners_no_verdict_finds_broken_there() -> None:
    """Soft ground, a redundant arm that rests on a wall at a corner: how it is held there goes by no other corner."""
    data = flexopt.load("boom-stick-bucket").to_dict()
    data["base"]["stiffness"] = {name: 0.15 * own for name, own in data["base"]["stiffness"].items()}
    ground = {"payload.mass": (0.0, 1500.0), "stiffness": (0.5, 2.0)}
    wall = {"kind": "box", "name": "wall", "center": [4.5, 1.2], "size": [0.4, 2.4]}
    asked: dict[str, Any] = {"within": ground, "clearance": {"distance": 0.2, "obstacles": [wall]}}
    machine = flexopt.machine_from_dict(data)
    chosen = flexopt.select(machine, (6.5, 1.0), base=0.0, constraints=asked, gravity=True, starts=8)
    found = flexopt.verdict(chosen, loop="default", ranges=dict(reversed(ground.items())), members=4, runs=0)
    candidates = [place for place in found.places if place.name != "stay"]
    assert any("from wall where" in name for place in candidates for name in place.rests_on[0])
    assert not any(place.breaks for place in candidates)
    assert found.exclusions == {}


@pytest.mark.long
def test_staying_where_every_place_breaks_constraints_is_told() -> None:
    """Rows at corners of `within` have their numbers beside those of the ranges."""
    machine = flexopt.load("boom-stick-bucket")
    asked: dict[str, Any] = {"holding": 0.9, "within": {"payload.mass": (0.0, 2500.0)}}
    chosen = flexopt.select(machine, (7.0, 1.0), base=0.0, constraints=asked, starts=2, base_range=(-0.05, 0.05))
    ranges = {"payload.mass": (0.0, 9000.0)}
    found = flexopt.verdict(chosen, loop="default", ranges=ranges, members=4, runs=0)
    assert all(place.breaks for place in found.places)
    assert found.excluded == ()
    if found.word in ("stay", "move"):
        assert "every place found breaks constraints on some ground: " in found.drawbacks
    heavy = flexopt.verdict(chosen, loop="default", ranges={"stick.mass": (1000.0, 2e4)}, members=4, runs=0)
    sentences = [place.breaks for place in heavy.places if "payload" in place.breaks]
    assert sentences
    # The interval of `within` that the ranges have nothing of is one of its own.
    assert all(re.search(r"where .*\bpayload.mass is 2500 kg", sentence) for sentence in sentences)
    assert all(re.search(r"where .*\bstick.mass is 2e\+04 kg", sentence) for sentence in sentences)


@pytest.mark.long
def test_drives_without_a_speed_have_no_full_lever() -> None:
    """A verdict on an unknown load is one all the same."""
    loop: dict[str, Any] = {"kp": 1.0, "kv": 0.0, "drive": "velocity", "servo_gain": 1e4}
    few: dict[str, Any] = {"starts": 2, "members": 2, "runs": 2, "duration": 4.0}
    asked: dict[str, Any] = {"base": 0.0, "gravity": True, "ranges": {"payload.mass": (0.0, 300.0)}}
    found = flexopt.verdict(flexopt.load("excavator"), (0.0, 1.6), loop=loop, **asked, **few)
    reasons = [why for place in found.places if place.runs for why in place.runs.reasons]
    assert any("m off" in why for why in reasons)
    assert not any("full lever" in why for why in reasons)


@pytest.mark.long
@pytest.mark.parametrize("softer", [0.01, 0.003])
def test_runs_of_slow_machines_last_ten_periods(softer: float) -> None:
    """Of 3 s nothing can be told of them, which is said."""
    data = flexopt.load("excavator").to_dict()
    for table in (data["base"]["stiffness"], data["base"]["damping"]):
        table |= {name: softer * value for name, value in table.items()}
    machine = flexopt.machine_from_dict(data)
    few: dict[str, Any] = {
        "starts": 2,
        "members": 4,
        "runs": 2,
        "base": 0.0,
        "loop": {"kp": 1e3, "kv": 1e3, "rate": 20.0},
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", flexopt.ImplausibleMachine)
        found, cut = (flexopt.verdict(machine, (0.0, 1.6), duration=given, **few) for given in (None, 3.0))
        slowest = [flexopt.evaluate(machine, p.posture, base=p.base).frequencies_hz.min() for p in found.places]
    assert (found.word, found.place, cut.word) == ("move", "candidate 1", "cannot tell")
    stay, first, *_ = found.places
    assert stay.runs is not None
    assert first.runs is not None
    assert first.runs.verdicts == ("converges", "converges")
    assert first.runs.duration == pytest.approx(10 / slowest[1], rel=1e-12)
    # Of what grows no run is to confirm that it is stable.
    assert stay.runs.growing == 1
    assert [place.unconfirmed for place in (stay, first)] == ["", ""]
    # What the sentence tells stands once.
    assert "candidate 1 (undecided: the run of 3 s" in cut.sentence
    others = [line for line in repr(cut).splitlines() if "the run of 3 s" in line and "CANNOT TELL" not in line]
    assert not any(line.lstrip().startswith("candidate 1") for line in others)
    assert "too short to tell" in cut.places[1].unconfirmed


@pytest.mark.long
def test_an_arm_that_creeps_under_its_weight_is_judged_by_its_swing() -> None:
    """Of springs that the controller does not know; along its self-motion the arm rests nowhere."""
    machine, posture = flexopt.load("boom-stick-bucket"), np.array([-1.2167, -1.6538, -2.1765])
    stand = flexopt.evaluate(machine, posture, base=1.6282, gravity=True)
    settings = loop_settings(machine, Loop(nullspace_damping=2e4), stand, gravity=True)
    box = UncertaintyBox(machine, (Uncertainty(of="stiffness", factor=(0.6, 1.6)),), settings.dead_time)
    loop, members = UncertainLoop(settings, stand.base, posture, True, box), box.corners(1)
    runs = nonlinear_runs(loop, members, loop.decays(members), 20.0)
    assert (loop.decays(members) > 0).all()
    assert runs.verdicts == ("converges", "converges")


@pytest.mark.long
def test_what_lies_outside_the_ranges_is_none_of_the_worst() -> None:
    """The same posture and ranges, of two files that differ in a payload which the ranges replace."""
    found = list[flexopt.Verdict]()
    for load in (2500.0, 300.0):
        data = flexopt.load("boom-stick-bucket").to_dict()
        data["payload"]["mass"] = load
        machine = flexopt.machine_from_dict(data)
        loop = {"kp": 1.0, "kv": 0.1, "drive": "velocity", "servo_gain": 1e5, "rate": 50.0}
        options: dict[str, Any] = {"base": 0.0, "posture": (-0.9, -1.2, -0.4), "starts": 1}
        chosen = flexopt.select(machine, (7.0, 1.0), **options)
        found.append(flexopt.verdict(chosen, loop=loop, ranges={"payload.mass": (2000.0, 3000.0)}, members=8, runs=0))
    inside, outside = (verdict.places[0] for verdict in found)
    assert inside.name == outside.name == "stay"
    for measure in ("allowed_gain", "delay_margin", "settling", "swing"):
        ends = [(getattr(place, measure).least, getattr(place, measure).greatest) for place in (inside, outside)]
        # The file's own load is looked at, too, where it lies in the range; the search goes on from it.
        assert ends[1] == pytest.approx(ends[0], rel=0.02), measure
        worst = {"allowed_gain": 0, "delay_margin": 0, "settling": 1, "swing": 1}[measure]
        assert ends[1][worst] == pytest.approx(ends[0][worst], rel=1e-3)
    assert outside.decay.greatest <= inside.decay.greatest * (1 + 1e-9)


@pytest.mark.long
def test_a_load_that_the_controller_does_not_know_is_named_where_the_arm_stays_off() -> None:
    """Without an integral part the arm hangs where P feedback carries the difference; with one runs confirm."""
    machine = flexopt.load("boom-stick-bucket")
    problem = flexopt.build_selection(machine, (6.0, 1.0), base=0.0, starts=2, gravity=True)
    chosen = flexopt.solve_selection(problem)
    loop: dict[str, Any] = {"kp": 1.0, "kv": 0.0, "drive": "velocity", "servo_gain": 1e5}
    asked: dict[str, Any] = {"ranges": {"payload.mass": (500.0, 1500.0)}, "members": 4, "runs": 2}
    found = flexopt.verdict(chosen, loop=loop, **asked)
    assert found.word == "cannot tell"
    assert found.reason.count("the controller carries the load of the machine's file") == 1
    assert found.reason.count("m off") > 1
    assert found.reason.count("feedback pid") == 1
    assert "100 % converge (0 % confirm)" in repr(found)
    assert "weight is left out" not in repr(found)
    assert all(place.runs is not None and set(place.runs.verdicts) == {"converges"} for place in found.places)
    integrating = flexopt.verdict(chosen, loop=loop | {"feedback": "pid", "ki": 0.2}, **asked)
    assert all(place.runs is not None and not any(place.runs.reasons) for place in integrating.places)
    # Five time constants of the slowest loop, which a minute holds; less does not do, and the sentence says what does.
    for place in integrating.places:
        assert place.runs is not None
        assert place.runs.duration == pytest.approx(5 / place.decay.least, rel=0.02)
        assert 20 < place.runs.duration < 60
    # Rounded up, of the slowest member: the first that is told of may be a faster one.
    short = flexopt.verdict(chosen, loop=loop | {"feedback": "pid", "ki": 0.2}, duration=10.0, **asked)
    # Where one is long enough for a place, higher gains may hold the arm on its target there.
    assert short.word in ("cannot tell", "change gains")
    told = re.findall(
        r"the run is short, (.+?) time constants of the slowest motion \(5 of the slowest on any ground take (.+?) s\)",
        short.reason,
    )
    assert told
    for constants, seconds in told:
        assert 10.0 * 5 / float(constants) <= 1.05 * float(seconds) < 1.3 * 10.0 * 5 / float(constants)
    long = max(float(seconds) for _, seconds in told)
    again = flexopt.verdict(chosen, loop=loop | {"feedback": "pid", "ki": 0.2}, duration=long, **asked)
    assert all(place.runs is not None and not any(place.runs.reasons) for place in again.places)
    # Where full levers do not bear the load an integral part does not help either: the moment of a point mass.
    weak = flexopt.verdict(
        chosen, loop=loop | {"feedback": "pid", "ki": 0.2, "servo_gain": 1e4}, duration=20.0, **asked
    )
    words = r"at (\w+) the load is another than the file's by (\S+) N m, of which a full lever bears ([^;]+);"
    told = re.findall(words, weak.reason)
    assert told
    own = next(each.value for each in machine.parameters if each.name == "payload.mass")
    possible = dict[str, list[float]]()
    for place in weak.places:
        skeleton = flexopt.evaluate(machine, place.posture, base=place.base).skeleton
        # From the tip back: an end-point, and a pin for each joint.
        for joint, pin in zip(machine.joints, skeleton[0, -1 - len(machine.joints) : -1], strict=True):
            moments = [abs(mass - own) * 9.81 * abs(skeleton[0, -1] - pin) for mass in (500.0, 1500.0)]
            possible.setdefault(joint, []).extend(moments)
    for joint, load, bears in told:
        assert float(bears) < float(load)
        # Three digits; members are the ends of the interval and what lies between.
        assert min(abs(float(load) / moment - 1) for moment in possible[joint]) < 0.01
    assert weak.reason.count("a larger loop.servo_gain bears more") == 1
    # The stiffness alone leaves the weight as the controller knows it.
    known = flexopt.verdict(chosen, loop=loop, ranges={"stiffness": (0.5, 2.0)}, members=2, runs=2)
    assert all(place.runs is not None and not any(place.runs.reasons) for place in known.places)


@pytest.mark.parametrize(("servo_gain", "holds"), [(31350.0, False), (32340.0, True)])
def test_a_run_does_not_confirm_what_no_full_lever_holds(servo_gain: float, holds: bool) -> None:
    """A redundant arm creeps under a load that its controller does not know; where it ends tells what its levers bear.

    In the posture that it is asked to hold they bear it in neither case. The weight's moment about the boom's pin where
    the arm ends is that of a point mass.
    """
    machine, posture = flexopt.load("boom-stick-bucket"), np.array((-1.2, -1.5, -0.8))
    asked = flexopt.Loop(
        drive="velocity",
        feedback="pid",
        kp=3.0,
        ki=0.6,
        kv=0.0,
        servo_gain=servo_gain,
        nullspace_damping=1e4,
        rate=100.0,
    )
    settings = settings_at(machine, posture, np.zeros(1), None, asked, gravity=True, call="test")[0]
    box = UncertaintyBox(machine, (flexopt.Uncertainty(of="payload.mass", value=(650.0, 1350.0)),), 0.0)
    loop, lightest = UncertainLoop(settings, np.zeros(1), posture, True, box), np.zeros((1, 1))
    runs = nonlinear_runs(loop, lightest, loop.decays(lightest), 158.0)
    assert (runs.verdicts, runs.nearer) == (("converges",), (True,))
    (why,) = runs.reasons
    if holds:
        assert not why
        return
    told = re.fullmatch(
        rf"{GIVES_WAY} at boom the load is another than the file's by (\S+) N m, all that a full lever bears; "
        "a larger loop.servo_gain bears more",
        why,
    )
    assert told is not None
    load = float(told[1])
    crept = confirmation._ensemble(loop, lightest, 158.0, None).last_postures
    assert crept is not None
    skeleton = flexopt.evaluate(machine, crept[0]).skeleton
    own = next(each.value for each in machine.parameters if each.name == "payload.mass")
    # The design's weight bends the springs a little further.
    assert load == pytest.approx((own - 650.0) * 9.81 * (skeleton[0, -1] - skeleton[0, -4]), rel=5e-3)
    # It has crept to where it hangs on its full lever, as the drive's rate there tells.
    assert load == pytest.approx(servo_gain * full_rates(machine, crept[0])[0, 0], rel=5e-3)


def test_an_arm_that_fell_off_its_levers_is_told_of_those() -> None:
    """Where it came to hang they bear the load, which they do not where it was to be held: an integral is no remedy."""
    machine, posture = flexopt.load("boom-stick-bucket"), np.array((-1.2, -1.5, -0.8))
    asked = flexopt.Loop(drive="velocity", kp=3.0, kv=0.0, servo_gain=2e4, nullspace_damping=1e4, rate=100.0)
    settings = settings_at(machine, posture, np.zeros(1), None, asked, gravity=True, call="test")[0]
    box = UncertaintyBox(machine, (flexopt.Uncertainty(of="payload.mass", value=(650.0, 1350.0)),), 0.0)
    loop, heaviest = UncertainLoop(settings, np.zeros(1), posture, True, box), np.ones((1, 1))
    (why,) = nonlinear_runs(loop, heaviest, loop.decays(heaviest), 60.0).reasons
    assert re.search(r"m off, .*, and at boom the load is another .*, of which a full lever bears", why), why
    assert "integral part" not in why


def test_springs_that_draw_the_arm_off_are_named() -> None:
    """Where they explain most of what the end-point is off; an integral part brings it to its target."""
    machine, posture = flexopt.load("excavator"), np.array((0.6, -1.6))

    def named(loop: dict[str, Any], share: float) -> str:
        asked = flexopt.Loop(drive="torque", kp=1e5, kv=1e4, **loop)
        settings = settings_at(machine, posture, np.zeros(1), None, asked, gravity=True, call="test")[0]
        box = UncertaintyBox(machine, (flexopt.Uncertainty(of="stiffness", factor=(0.5, 2.0)),), settings.dead_time)
        uncertain = UncertainLoop(settings, np.zeros(1), posture, True, box)
        # As far as the end-point of a machine with springs half as stiff hangs from its target.
        softer = {f"base.stiffness.{d}": 0.5 * getattr(machine.base.stiffness, d) for d in ("x", "y", "rotation")}
        run = flexopt.simulate_ensemble(
            machine, posture, loop=asked, gravity=True, duration=60.0, vary={name: [x] for name, x in softer.items()}
        )
        return tilts(uncertain, np.zeros(1), share * max(float(run.dataset["end_error"][0]), 1e-4))

    assert "an integral part takes it to the target" in named({}, 1.0)
    assert named({}, 3.0) == ""
    assert named({"feedback": "pid", "ki": 2e4}, 1.0) == ""


@pytest.mark.long
def test_gains_are_tried_where_one_may_neither_stay_nor_move(tmp_path: Path) -> None:
    """Staying grows on a ground, and a place that is stable on all is better on too few: that place bears lower gains."""
    machine, held = flexopt.load("excavator"), (0.0448, -2.0499)
    target = flexopt.evaluate(machine, held).end_point
    loop = {"drive": "torque", "kp": 1e4, "kv": 1e3, "dead_time": 0.02}
    few: dict[str, Any] = {"starts": 2, "members": 4, "runs": 1, "duration": 120.0}
    found = flexopt.verdict(machine, target, base=0.0, posture=held, loop=loop, **few)
    stay, *others = found.places
    stable = [place for place in others if place.decay.least > 0]
    assert stay.decay.least < 0
    assert stable
    assert max(place.better for place in stable) < 0.95
    assert found.word == "change gains"
    new = found.with_gains
    assert new is not None
    # Every number as where these gains are asked for, of a region, too, and runs as of the other places.
    asked = loop | {name: gains[0] for name, gains in found.gains.items()}
    region = flexopt.stable_region(
        machine, new.posture, base=new.base, loop=asked, ranges={"stiffness": (0.5, 2.0)}, boxes=0
    )
    assert new.decay.least == pytest.approx(region.decay, rel=1e-3)
    assert region.decay > 1.1 * max(place.decay.least for place in stable)
    assert new.runs is not None
    assert new.runs.confirming == 1.0
    row = next(line for line in str(found).splitlines() if line.startswith("  new gains"))
    assert row.endswith(new.shown_runs)
    found.to_html(tmp_path / "verdict.html")
    assert ">new gains<" in (tmp_path / "verdict.html").read_text(encoding="utf-8")


@pytest.mark.long
def test_what_a_place_breaks_where_feedback_holds_it_beside_its_target_is_told() -> None:
    """A narrow tool angle, which the file's load keeps; a run of another load ends beyond it."""
    machine, held, low = flexopt.load("excavator"), (0.0448, -2.0499), 0.7 * 458.2
    target, loads = flexopt.evaluate(machine, held, gravity=True).end_point, {"stick.mass": (low, 458.2)}
    loop = {"drive": "velocity", "servo_gain": 2e5, "kp": 1.0, "kv": 0.0, "rate": 200.0}
    few: dict[str, Any] = {"base": 0.0, "posture": held, "gravity": True, "starts": 1}
    free = flexopt.select(machine, target, constraints={"tool_angle": (-3.0, 3.0)}, **few)
    own = next(
        value for name, value in constraint_values(free.problem, np.array([0.0, *held])).items() if "tool" in name
    )
    narrow = {"tool_angle": (own.value - 1e-3, own.value + 1e-3)}
    found = flexopt.verdict(
        flexopt.select(machine, target, constraints=narrow, **few), loop=loop, ranges=loads, members=2, runs=0
    )  # fmt: skip
    stay = found.places[0]
    assert (stay.name, stay.breaks) == ("stay", "")
    runs = flexopt.simulate_ensemble(
        machine, held, loop=loop, gravity=True, duration=15.0 / stay.decay.least, vary={"stick.mass": [low]},
        keep="trajectories",
    )  # fmt: skip
    # The angle of the stick on level ground: the base's turn is a part of it, which sags by the file's load, too.
    by_file = 1.2451 + flexopt.evaluate(machine, held, gravity=True).static_deflection[-1] + sum(held)
    turned = float(runs.dataset["q"].to_numpy()[0, -1, 2:].sum()) - by_file
    words = re.fullmatch(r"breaks tool angle, (\S+) rad \(.*, where stick.mass is 320.7 kg", stay.breaks_at_rest)
    assert words, stay.breaks_at_rest
    assert abs(turned) > 2e-3
    assert float(words[1]) == pytest.approx(own.value + turned, abs=5e-4)
    assert f"stay, at rest beside its target, {stay.breaks_at_rest}" in repr(found)
    assert stay.breaks_at_rest in repr(found).splitlines()[-1]
    # What dampers do is nothing of a rest.
    damped = flexopt.verdict(found.selection, loop=loop, ranges=loads | {"damping": (0.6, 1.5)}, members=2, runs=0)
    assert damped.places[0].breaks_at_rest == stay.breaks_at_rest
    integral = flexopt.verdict(
        found.selection, loop=loop | {"feedback": "pid", "ki": 0.2}, ranges=loads, members=2, runs=0
    )  # fmt: skip
    assert integral.places[0].breaks_at_rest == ""
    # Where the base stands is not of how the arm is held.
    elsewhere = few | {"base_range": {"x": (0.5, 1.5)}, "starts": 2}
    outside = flexopt.verdict(
        flexopt.select(machine, target, **elsewhere), loop=loop, ranges=loads, members=2, runs=0
    ).places[0]
    assert outside.rests_off > 0.01
    assert outside.breaks_at_rest == ""
    # Where other places keep it, the machine is sent to one of these, unless what is broken is hardly anything of what
    # is allowed: 0.8 % of half of 2.2 rad, and with a lighter load 1.5 %.
    wide = {"tool_angle": (-3.0, own.value + 1e-3)}
    others = flexopt.select(machine, target, constraints=wide, **few | {"starts": 4})
    hardly, moved = (
        flexopt.verdict(others, loop=loop, ranges={"stick.mass": (share * 458.2, 458.2)}, members=2, runs=0)
        for share in (0.7, 0.5)
    )
    assert hardly.places[0].breaks_at_rest
    assert (hardly.places[0].breaking.barring, hardly.exclusions) == ("", {})
    kept = {place.name: place.breaks_at_rest == "" for place in moved.places}
    assert kept.pop("stay") is False
    assert set(kept.values()) == {True}
    assert moved.word == "move"
    assert moved.reason.startswith(f"the present place at rest beside its target {moved.places[0].breaks_at_rest}; ")
    assert moved.exclusions
    assert all(each.startswith("at rest beside its target breaks tool angle, ") for each in moved.exclusions.values())


@pytest.mark.long
def test_limits_that_are_assumed_count_on_other_springs_and_at_rest() -> None:
    """Where the arm is held on its target with other springs, and where runs end, beside it."""
    data = flexopt.load("excavator").to_dict() | {"gravity": 9.81}
    for link, ends in zip(data["links"], ([-1.22, 1.6], [-2.8, 1.485]), strict=True):
        link["limits"] = ends
    machine = flexopt.machine_from_dict(data)
    loop: dict[str, Any] = {"drive": "torque", "kp": 1e4, "kv": 1e3, "rate": 200.0}
    few: dict[str, Any] = {"base": 0.0, "gravity": True, "base_range": {"x": (-3.0, 1.0)}, "starts": 4}
    chosen = flexopt.select(machine, (0.0, 1.6), posture=(0.9929, -2.6302), **few)
    springs = {"of": "stiffness", "factor": (0.15, 2.0)}
    judged: dict[str, Any] = {"ranges": [springs], "members": 2, "runs": 0}
    found = flexopt.verdict(chosen, loop=loop, **judged)
    first = next(place for place in found.places if place.name == "candidate 1")
    own = {each.name: each.value for each in machine.parameters}
    numbers = [name for name in own if "stiffness" in name]

    def held_with(factor: float) -> dict[str, float]:
        p = np.array([value * (factor if name in numbers else 1.0) for name, value in own.items()])
        return dict(zip(machine.joints, held_on_target(machine, first.base, first.posture, p), strict=True))

    for joint, factor in (("stick", 0.15), ("boom", 2.0)):
        told = re.search(rf"breaks limits of {joint}, (\S+) rad [^,]*, where stiffness is {factor:g} of", first.breaks)
        assert told, first.breaks
        assert float(told[1]) == pytest.approx(held_with(factor)[joint], abs=6e-4)
    runs = flexopt.simulate_ensemble(
        machine, first.posture, base=first.base, loop=loop, gravity=True, duration=15.0 / first.decay.least,
        vary={name: [2.0 * own[name]] for name in numbers}, keep="trajectories",
    )  # fmt: skip
    rests = re.fullmatch(
        r"breaks limits of boom, (\S+) rad \(.*\), where stiffness is 2 of the file's", first.breaks_at_rest
    )
    assert rests, first.breaks_at_rest
    assert float(rests[1]) == pytest.approx(float(runs.dataset["q"].to_numpy()[0, -1, 3]), abs=6e-4)
    assert found.place != "candidate 1"
    assert first.breaking.barring == "somewhere"
    assert "candidate 1 is none to go to: another place keeps constraints on every ground, to 1 %" in repr(found)
    integral = flexopt.verdict(chosen, loop=loop | {"feedback": "pid", "ki": 2e3}, **judged)
    there = next(place for place in integral.places if place.name == "candidate 1")
    assert (there.breaks, there.breaks_at_rest) == (first.breaks, "")
    # Limits that were left out bind nothing.
    free = flexopt.select(machine, (0.0, 1.6), assume="ground,reach", **few)
    left_out = flexopt.verdict(free, loop=loop, **judged)
    assert not any("limits" in place.breaks + place.breaks_at_rest for place in left_out.places)


@pytest.mark.long
def test_a_place_that_decays_is_not_left_for_what_it_breaks_at_rest_where_all_others_grow() -> None:
    """A tool angle that staying breaks by milliradians beside its target; what grows is not beside its target."""
    machine, target = flexopt.load("excavator"), (0.0, 1.6)
    held = flexopt.inverse_kinematics(machine, target, base=-0.1, gravity=True, elbow="down")[0]
    loop = {"drive": "torque", "kp": 233392.57, "kv": 9469.76, "rate": 200.0, "dead_time": 0.02}
    given: dict[str, Any] = {"base": -0.1, "posture": held, "gravity": True, "starts": 4}
    at_target = flexopt.evaluate(machine, held, base=-0.1, gravity=True)
    own = 1.2451 + at_target.static_deflection[-1] + sum(held)
    chosen = flexopt.select(machine, target, constraints={"tool_angle": (own - 3.0, own + 1e-3)}, **given)
    found = flexopt.verdict(chosen, loop=loop, ranges={"payload.mass": (0.0, 150.0)}, members=2, runs=0)
    stay, *others = found.places
    assert stay.breaks_at_rest
    assert stay.decay.least > 0
    assert all(place.decay.least < 0 for place in others)
    assert (found.word, found.place) == ("stay", "stay")
    assert f"at rest beside its target the present place {stay.breaks_at_rest}" in found.drawbacks


@pytest.mark.long
def test_how_far_beside_its_target_the_end_point_rests_is_told() -> None:
    """Of the corners of what is uncertain, as nonlinear runs of these end; a move is settled within 2 mm of 0.1 m."""
    machine, low, high = flexopt.load("excavator"), 0.7 * 458.2, 1.3 * 458.2
    loop = {"drive": "velocity", "servo_gain": 2e5, "kp": 1.0, "kv": 0.0, "rate": 200.0, "dead_time": 0.013}
    few: dict[str, Any] = {"ranges": {"stick.mass": (low, high), "base.stiffness.rotation": (6e5, 1.2e6)}}
    few |= {"members": 4, "runs": 0}
    chosen = flexopt.select(machine, (0.0, 1.6), base=0.0, starts=2, gravity=True)
    found = flexopt.verdict(chosen, loop=loop, **few)
    place = max(found.places, key=lambda place: place.decay.least)
    corners = np.array([*product((low, high), (6e5, 1.2e6))])
    runs = flexopt.simulate_ensemble(
        machine, place.posture, base=place.base, loop=loop, gravity=True, duration=15.0 / place.decay.least,
        vary=dict(zip(few["ranges"], corners.T.tolist(), strict=True)),
    )  # fmt: skip
    off = runs.dataset["end_error"].to_numpy()
    assert place.rests_off == pytest.approx(off.max(), rel=1e-3)
    assert [*place.rests_off_at.values()] == pytest.approx(corners[off.argmax()])
    # No other corner is taken for the worst.
    assert off.max() > 1.02 * np.sort(off)[-2]
    farthest = max(found.places, key=lambda place: place.rests_off)
    told = f"off its target at rest, by {farthest.rests_off:.3g} m ({spoken(farthest.name)} at "
    assert told in repr(found)
    assert told in found._html()
    assert repr(found).count("feedback pid") == 1
    each = found.to_dict()["places"]
    assert [one["rests_off"] for one in each] == [place.rests_off for place in found.places]
    # Of what an integral part brings there no word, nor of less than a settled move is off.
    integral = flexopt.verdict(chosen, loop=loop | {"feedback": "pid", "ki": 0.2}, **few)
    assert [(place.rests_off, place.rests_off_at) for place in integral.places] == [(0.0, {})] * len(integral.places)
    assert "off its target at rest" not in repr(integral)
    grows = [replace(place, rests_off=0.02, decay=replace(place.decay, least=-0.1)) for place in found.places]
    assert "by 0.02 m (the present place at stick.mass " in remarks.rests_beside(replace(found, places=(grows[0],)))
    assert ", not counting where it grows), the most" in remarks.rests_beside(replace(found, places=(grows[0],)))
    near = replace(found, places=tuple(replace(place, rests_off=0.00199) for place in found.places))
    assert "off its target at rest" not in repr(near)


@pytest.mark.long
def test_another_loop_is_judged_alike_in_every_place() -> None:
    """With lower gains than the choice had no place decays as it must: that is no reason to move."""
    machine, held, base = flexopt.load("excavator"), (-1.2479, 1.4872), -2.1859
    target = flexopt.evaluate(machine, held, base=base).end_point
    found = flexopt.select(
        machine, target, objective="w1", loop={"kp": 1e4, "kv": 1e3}, constraints={"outcome": {"decay": 0.012}},
        base=base, posture=held, starts=2,
    )  # fmt: skip
    lower = {"kp": 3e3, "kv": 1e2}
    told = flexopt.verdict(found, loop=lower, members=4, runs=0)
    assert told.word == "stay"
    stay, *others = told.places
    assert told.present_breaks.startswith("breaks decay 0.00474")
    assert others
    for place in others:
        decay = flexopt.outcome(machine, place.posture, base=place.base, loop=lower).decay
        assert place.breaks == f"breaks decay {decay:.4g} 1/s (at least 0.012 1/s)"
    every = "every place found breaks constraints with the present gains: the present place "
    assert f"{every}{told.present_breaks}" in told.drawbacks
    assert stay.breaks == ""


@pytest.mark.long
def test_other_gains_do_what_the_loop_must_do_at_least() -> None:
    """The fastest of all gains in these ranges bear 5 ms of dead time more, where 16 ms are asked for."""
    machine, held, base = flexopt.load("excavator"), (-1.2479, 1.4872), -2.1859
    target = flexopt.evaluate(machine, held, base=base).end_point
    now = {"kp": 1e4, "kv": 1e3}
    least = 0.9 * flexopt.outcome(machine, held, base=base, loop=now).delay_margin
    ranged = now | {"kp_range": (1e3, 1e6), "kv_range": (1e2, 1e5)}
    told = flexopt.verdict(
        machine, target, objective="w1", loop=ranged, constraints={"outcome": {"delay_margin": least}}, base=base,
        posture=held, starts=2, members=4, runs=0,
    )  # fmt: skip
    assert told.word == "change gains"
    new = told.with_gains
    assert new is not None
    assert new.breaks == ""
    loop = now | {name: gains[0] for name, gains in told.gains.items()}
    at = flexopt.outcome(machine, new.posture, base=new.base, loop=loop)
    assert at.delay_margin >= (1 - 1e-6) * least
    assert at.decay > 1.1 * flexopt.outcome(machine, held, base=base, loop=now).decay


def test_why_what_decays_fast_does_not_settle_is_told(tmp_path: Path) -> None:
    """A load that is not there draws the arm to where its self-motion is a saddle: one way grows, the other is slow."""
    machine, loop = flexopt.load("slewing-excavator"), {"kp": 4.5e5, "kv": 2.5e5, "drive": "torque", "dead_time": 0.005}
    base, posture = np.array([4.0117, 2.6077, 0.0754]), np.array([-1.0949, -0.03, -2.618, -0.6301])
    here = flexopt.evaluate(machine, posture, base=base, gravity=True)
    settings = loop_settings(machine, Loop(**loop), here, gravity=True)
    box = UncertaintyBox(machine, (Uncertainty(of="payload.mass", value=(0.0, 1500.0)),), settings.dead_time)
    empty = UncertainLoop(settings, base, posture, True, box).outcome(np.zeros(1))
    move = empty.move
    assert move is not None
    assert empty.decay().value > 1.0
    assert math.isnan(empty.settling().value)
    # What is left of the move goes as the slowest of what decays, by NumPy's eigenvalues alone.
    rates = np.log(np.abs(np.linalg.eigvals(move.sample.matrix))) / move.sample.period
    slow = float(rates[rates < 0].max())
    assert -slow < 0.1
    sizes = [
        np.linalg.norm(np.linalg.matrix_power(move.matrix, round(t / move.sample.period)) @ move.start)
        for t in (20.0, 60.0)
    ]
    assert math.log(sizes[1] / sizes[0]) / 40.0 == pytest.approx(slow, rel=1e-3)
    digger, stiff = flexopt.load("excavator"), {"kp": 1e4, "kv": 1e3}
    found = flexopt.verdict(digger, (0.0, 1.6), base=0.0, loop=stiff, starts=1, members=2, runs=0)
    assert remarks.lingers(found) == ""
    first, *others = found.places
    late = replace(first.settling, greatest=math.nan)
    changed = replace(first, settling=late, decay=replace(first.decay, least=1.0), drift=0.03)
    told = replace(found, places=(changed, *others))
    (late,) = (each for each in remarks.on_the_loop(told) if each == remarks.lingers(told))
    assert late.startswith("the present place decays fast and yet does not settle in a minute on some ground: ")
    assert late in repr(told)
    told.to_html(tmp_path / "verdict.html")
    assert "dies away slowly there and takes the end-point with it" in (tmp_path / "verdict.html").read_text("utf-8")
    # Of a decay that is slow itself there is nothing to say.
    slower = replace(changed, decay=replace(first.decay, least=0.05))
    assert remarks.lingers(replace(found, places=(slower, *others))) == ""


def test_the_rate_that_stands_for_falling_is_no_number_to_read() -> None:
    """The largest number's growth within a sample, by NumPy; JSON has it, text, page and picture say what it is."""
    asked: dict[str, Any] = {"members": 2, "runs": 0, "starts": 1, "ranges": {"payload.mass": (0, 1500)}}
    loop = {"kp": 2e3, "kv": 5e2, "rate": 200}
    found = flexopt.verdict(flexopt.load("excavator"), (0.0, 1.6), base=0.0, gravity=True, loop=loop, **asked)
    rate = -200 * np.log(np.finfo(float).max)
    assert [place["decay"]["least"] for place in found.to_dict()["places"]] == pytest.approx([rate] * len(found.places))
    shown = f"{rate:.4g}"
    for place in found.places:
        [line] = [line for line in repr(found).splitlines() if line.startswith(f"  {place.name}  ")]
        assert f" {place.decay.nominal:+.4g}/s, falls " in line
    assert "falls: on some ground the feedback is not found to hold the weight" in repr(found)
    written = without_pictures(found._html())
    assert shown not in repr(found)
    assert with_minus(shown) not in written
    assert re.search(r"slowest decay</dt><dd><data value=\"-1\d{5}[.\d]*\">falls</data>", written)
    assert written.count(">falls</td>") == len(found.places)
    decay = found.bands[0]
    assert [(row.least, row.nominal, row.worst) for row in decay.rows] == [
        (-math.inf, place.decay.nominal, "falls") for place in found.places
    ]


def test_each_place_that_a_sentence_names_has_its_row(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where it is none of those that are shown for their decay, too: the best that breaks constraints somewhere."""
    chosen = flexopt.select(flexopt.load("excavator"), (0.0, 1.6), base=0.0, starts=6)
    judged: dict[str, Any] = {"loop": {"kp": 1e4, "kv": 1e3}, "members": 4, "runs": 1, "duration": 2.0}
    free = flexopt.verdict(chosen, **judged | {"runs": 0})
    breaks = Breaks(somewhere="breaks holding of boom, where stiffness is 2 of the file's", barring="somewhere")

    def with_all_barred(found: dict[str, Breaks], *_: Any) -> dict[str, Breaks]:
        return {name: Breaks() if name == "stay" else breaks for name in found}

    monkeypatch.setattr(verdict_module, "with_barring", with_all_barred)
    monkeypatch.setattr(verdict_module, "first_places", lambda names, *_: names[-1:])
    found = flexopt.verdict(chosen, **judged)
    rows = {place.name: place for place in found.places}
    named = set(re.findall(r"candidate \d+", found.reason))
    assert named
    assert named <= set(rows)
    # As many as before without it: the last in rank, and the first of the choice.
    assert len(named - {"candidate 1", found.places[1].name}) == 1
    assert all(f"\n  {name} " in repr(found) and rows[name].runs is not None for name in named)
    assert set(rows) == {place["name"] for place in found.to_dict()["places"]}
    both = named & {place.name for place in free.places}
    assert both
    for place in free.places:
        if place.name in both:
            row = rows[place.name]
            # The search ends within 1e-6 of its rate.
            assert (row.drive, row.better) == pytest.approx((place.drive, place.better))
            assert row.decay.least == pytest.approx(place.decay.least, rel=1e-6)
