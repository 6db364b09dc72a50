"""Why gains are not to be changed where others were tried: true by the numbers of every place."""

from __future__ import annotations

import json
import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import flexopt
from flexopt.foundation.arrays import Vector
from flexopt.model.loop import Loop
from flexopt.study import page
from flexopt.study.page import with_minus
from flexopt.study.verdicts import changed_gains
from flexopt.study.verdicts.changed_gains import ChangedGains, GainChange, Sought
from flexopt.study.verdicts.decision import Place, decide
from flexopt.study.verdicts.gain_search import tried_gains
from flexopt.study.verdicts.kept_gains import gains_kept

NUMBER = r"(-?[\d.]+(?:e[+-]\d+)?)"
# To the three digits that are told.
TOLD = 6e-3


def places(rng: np.random.Generator, low: float, high: float) -> dict[str, Place]:
    """Three at random, in some of which most grounds decay faster than the slowest by far."""
    found = dict[str, Place]()
    for name, drive in (("stay", 0.0), ("candidate 1", 2.0), ("candidate 2", 4.0)):
        slowest, spread = rng.uniform(low, high), rng.choice([0.0, 0.0, 2.0])
        decays = slowest + spread * np.abs(slowest) * rng.uniform(size=20)
        decays[0] = slowest
        found[name] = Place(name, decays, float(slowest), drive)
    return found


def judge(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> tuple[str, Any, dict[str, Any]]:
    """The sentence, the decision, and what they follow from."""
    settings = SimpleNamespace(
        feedback="pd", kp=np.array([2.0]), kv=np.array([1.0]), gain_units=("N m", "N m s", "N m/s")
    )
    loop: Any = SimpleNamespace(settings=settings, with_settings=lambda _: loop)
    now, then = places(rng, -0.5, 1.0), places(rng, -0.5, 1.5)
    doubts = {name: "drawn off" for name in now if rng.uniform() < 0.25}
    refuted = {name for name in now if rng.uniform() < 0.3}

    def lowest(_: GainChange, tried: Any, __: Any = None) -> ChangedGains:
        runs: Any = SimpleNamespace(confirming=float(tried.place.name not in refuted), reasons=("far off",))
        return ChangedGains(tried.place, loop, runs)

    def shared(_: GainChange, name: str, __: Any) -> tuple[Place, Vector]:
        return now[name]._replace(slowest=-1.0), np.zeros(1)

    fastest = {name: SimpleNamespace(place=place, loop=loop) for name, place in then.items()}
    monkeypatch.setattr(changed_gains.GainChange, "_fastest", lambda _, name: fastest[name])
    monkeypatch.setattr(changed_gains.GainChange, "_lowest", lowest)
    monkeypatch.setattr(changed_gains.GainChange, "_with", shared)
    asked = Loop(kp_range=(10.0, 100.0), kv_range=(10.0, 100.0))
    loops = dict.fromkeys(now, loop)
    sought = GainChange(asked, now, loops, {}, doubts, np.zeros((1, 1)), lambda _: None).sought()
    changed = sought.changed
    confirmed, against = (changed, None) if changed and changed.doubt is None else (None, changed)
    decision = decide(
        now["stay"], [now["candidate 1"], now["candidate 2"]], confirmed and confirmed.place, doubts, tried="others",
        refuted=against and against.place, doubt=(against and against.doubt) or "",
        gains=changed.in_words if changed else "",
    )  # fmt: skip
    told = gains_kept(asked, sought, decision, now, doubts)
    return told, decision, {"now": now, "then": then, "doubts": doubts, "refuted": refuted}


def check(told: str, decision: Any, given: dict[str, Any]) -> None:
    """That a sentence is so."""
    now, then = given["now"], given["then"]
    if decision.word == "change gains" or "with other gains (kp 2 N m, kv 1 N m s)" in decision.reason:
        assert not told
        return
    sound = [place for name, place in now.items() if place.slowest > 0 and name not in given["doubts"]]
    if decision.word == "move":
        sound = [now[decision.place]]
        then = {name: place for name, place in then.items() if place.drive < sound[0].drive}
    best = max(then.values(), key=lambda place: place.slowest)
    had = max([place.slowest for place in sound], default=None)
    but = r"(, but nonlinear runs do not confirm it \(far off.*\))?"
    also = rf"; the present place is stable on every ground with kp 2 .*: slowest decay {NUMBER}/s{but}$"
    stay = re.search(also, told)
    if stay is not None:
        assert (stay[2] is not None) == ("stay" in given["refuted"])
        told = told[: stay.start()]
        assert float(stay[1]) == pytest.approx(then["stay"].slowest, rel=TOLD)
    may = now["stay"].slowest > 0 and "stay" not in given["doubts"]
    assert (stay is not None) == (
        decision.word == "cannot tell" and not may and best.name != "stay" and then["stay"].slowest > 0
    )
    numbers = re.search(rf"decay found is {NUMBER}/s, at (.*?) with kp 2 .*?(?:, against {NUMBER}/s at|$|, but)", told)
    assert numbers
    assert float(numbers[1]) == pytest.approx(best.slowest, rel=TOLD)
    assert numbers[2] == best.name.replace("stay", "the present place")
    assert (had is None) == (numbers[3] is None)
    assert had is None or float(numbers[3]) == pytest.approx(had, rel=TOLD)
    if "place stable on every ground" in told:
        # Of a move nearer places alone are looked at.
        assert ("keeps a nearer place" in told) == (decision.word == "move")
        assert best.slowest <= 0
    elif "in a nearer place" in told:
        assert decision.word == "move"
        assert best.slowest < had
    elif "in the worst case" in told:
        assert best.slowest <= 1.1 * had
    elif "runs do not confirm" in told:
        assert best.name in given["refuted"]
    else:
        # On the grounds, as by the rule itself.
        share = re.search(rf"than staying (as it is|with others) on {NUMBER} % of the grounds only", told)
        assert share
        stay = (now if share[1] == "as it is" else given["then"])["stay"].decays
        better = (best.decays - stay > 0.1 * np.abs(stay)) | ((best.decays > 0) & (stay <= 0))
        assert float(share[2]) == pytest.approx(100 * better.mean(), abs=0.5)
        assert better.mean() < 0.95


def test_what_is_said_of_gains_that_are_kept_is_so(monkeypatch: pytest.MonkeyPatch) -> None:
    all_told = list[str]()
    for seed in range(1000):
        told, decision, given = judge(np.random.default_rng(seed), monkeypatch)
        check(told, decision, given)
        all_told.append(told)
    for words in (
        "keeps a place stable", "keeps a nearer place stable", "in a nearer place", "in the worst case",
        "do not confirm", "grounds only", "; the present place is stable", "far off)",
    ):  # fmt: skip
        assert any(words in told for told in all_told)


def test_of_gains_times_one_factor_it_is_said_what_the_present_place_does_with_them() -> None:
    """Where it grows with the present ones, and what there is elsewhere is as good."""
    settings = SimpleNamespace(
        feedback="pd", kp=np.array([2.0]), kv=np.array([1.0]), gain_units=("N m", "N m s", "N m/s")
    )
    loop: Any = SimpleNamespace(settings=settings)
    grows = Place("stay", np.array([-1.0, 1.0]), -1.0, 0.0)
    other = Place("candidate 1", np.array([0.157, 0.2]), 0.157, 1.0)
    calmed = grows._replace(decays=np.array([0.154, 0.2]), slowest=0.154)
    fastest = {place.name: ChangedGains(place, loop, None) for place in (calmed, other)}
    decision = decide(grows, [other], tried=tried_gains(Loop(kp=1.0)))
    told = gains_kept(
        Loop(kp=1.0), Sought(None, fastest, None, {}), decision, {"stay": grows, "candidate 1": other}, {}
    )
    assert told.startswith(
        "of gains 0.01 to 10 times the present ones none decays 10 % faster in the worst case than what there is"
    )
    assert told.endswith(
        "; the present place is stable on every ground with kp 2 N m, kv 1 N m s: slowest decay 0.154/s"
    )


def test_nothing_is_said_of_gains_without_ranges_and_that_none_were_tried_where_no_place_was_judged() -> None:
    decision = decide(None, [])
    assert gains_kept(Loop(kp=1.0), None, decision, {}, {}) == ""
    told = gains_kept(Loop(kp_range=(1.0, 2.0)), None, decision, {}, {})
    assert told.startswith("of other gains within kp_range none were tried")


@pytest.mark.long
def test_a_verdict_that_keeps_its_gains_says_what_others_do(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """In text, page and document; and with these gains the place decays so."""
    chosen = flexopt.select(flexopt.load("excavator"), (0.0, 1.6), base=0.0, starts=4, workers=1)
    loop, few = {"kp": 1e4, "kv": 1e3}, {"members": 4, "runs": 0}
    found = flexopt.verdict(chosen, loop=loop | {"kp_range": (9e3, 1.1e4)}, **few)  # type: ignore[arg-type]
    assert found.word == "move"
    assert found.with_gains is None
    assert "of other gains within kp_range none " in found.gains_kept
    assert found.gains_kept in repr(found)
    assert json.loads(json.dumps(found.to_dict()))["gains_kept"] == found.gains_kept
    monkeypatch.setattr(page, "_png", lambda figure: "")
    found.to_html(tmp_path / "verdict.html")
    words = (tmp_path / "verdict.html").read_text(encoding="utf-8")
    assert with_minus(found.gains_kept[1:]) in words
    assert "The same controller everywhere: " in words
    told = re.search(rf"found is {NUMBER}/s, at (candidate .) with kp {NUMBER} N m", found.gains_kept)
    assert told
    alone = flexopt.verdict(chosen, loop=loop | {"kp": float(told[3])}, **few)  # type: ignore[arg-type]
    there = next(place for place in alone.places if place.name == told[2])
    assert there.decay.least == pytest.approx(float(told[1]), rel=TOLD)
    assert not alone.gains_kept
