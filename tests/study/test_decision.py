"""The rule of a verdict, in cases that leave no doubt."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import flexopt
from flexopt.loop.uncertainty_box import UncertaintyBox, matters_most
from flexopt.model.loop import Loop
from flexopt.model.uncertainty import Uncertainty
from flexopt.study.verdicts import reasons
from flexopt.study.verdicts.broken_places import Breaks
from flexopt.study.verdicts.decision import Decision, Place, decide, deciding, faster, ranked, told_in
from flexopt.study.verdicts.gain_search import tried_gains
from flexopt.study.verdicts.places import gains_in_words
from flexopt.study.verdicts.reasons import best_barred, with_barred
from flexopt.study.verdicts.told_places import first_places, overlooked, shares_better, with_barring

GROUNDS = np.linspace(0.5, 2.0, 40)


def place(name: str, decays: np.ndarray, drive: float = 0.0) -> Place:
    return Place(name, decays, float(decays.min()), drive)


STAY = place("stay", GROUNDS)


def test_a_place_that_is_better_everywhere_is_moved_to() -> None:
    word = decide(STAY, [place("far", 3 * GROUNDS, 9.0), place("near", 2.8 * GROUNDS, 2.0)])
    assert (word.word, word.place) == ("move", "near")
    assert word.reason.startswith("decays at least 10 % faster on 100 % of the grounds; ")
    assert word.reason.endswith(", for a drive of 2 m")
    also = place("near", 2.8 * GROUNDS, 2.0)._replace(otherwise="boom by -0.4 rad")
    assert decide(STAY, [also]).reason.endswith(", for a drive of 2 m, boom by -0.4 rad")
    # What solves leave of a base that stays is no way.
    assert decide(STAY, [place("near", 3 * GROUNDS, 6e-11)]).reason.endswith(", for a drive of 0 m")


def test_places_that_break_constraints_on_some_ground_count_where_all_do() -> None:
    def fit(breaks: dict[str, Breaks]) -> list[str]:
        judged = with_barring(breaks, lambda name: name != grows_at, lambda name: name != misses)
        return [name for name, each in judged.items() if not each.barring]

    grows_at, misses, kept, broken = (
        "",
        "",
        Breaks(),
        Breaks(somewhere="breaks holding of boom where payload.mass is 3000 kg"),
    )
    assert fit({"stay": kept, "candidate 1": broken, "candidate 2": kept}) == ["stay", "candidate 2"]
    assert fit({"stay": broken, "candidate 1": broken}) == ["stay", "candidate 1"]
    standing = Breaks(standing="breaks clearance of boom")
    assert fit({"stay": standing, "candidate 1": broken}) == ["candidate 1"]
    assert fit({"stay": standing}) == []
    beside = Breaks(at_rest="breaks tool angle, 0.3 rad, where payload.mass is 3000 kg")
    assert fit({"stay": beside, "candidate 1": broken, "candidate 2": kept}) == ["candidate 2"]
    assert fit({"stay": beside, "candidate 1": broken, "candidate 2": beside}) == ["stay", "candidate 2"]
    assert fit({"stay": broken, "candidate 1": broken._replace(at_rest=beside.at_rest)}) == ["stay"]
    # By less than weights and springs are known to, it is as one that keeps them.
    hardly = beside._replace(hardly=frozenset({"at_rest"}))
    assert fit({"stay": kept, "candidate 1": hardly, "candidate 2": beside}) == ["stay", "candidate 1"]
    assert fit({"stay": broken, "candidate 1": hardly, "candidate 2": beside}) == ["candidate 1"]
    by_little = broken._replace(hardly=frozenset({"somewhere"}))
    assert fit({"stay": kept, "candidate 1": by_little, "candidate 2": broken}) == ["stay", "candidate 1"]
    both = by_little._replace(at_rest=beside.at_rest)
    assert fit({"stay": kept, "candidate 1": both}) == ["stay"]
    assert fit({"stay": kept, "candidate 1": broken._replace(hardly=hardly.hardly)}) == ["stay"]
    # What grows is nowhere at rest, and no better than what breaks something there.
    grows_at = "candidate 2"
    assert fit({"stay": beside, "candidate 2": kept}) == ["stay", "candidate 2"]
    assert fit({"stay": beside, "candidate 1": kept, "candidate 2": kept}) == [
        "candidate 1",
        "candidate 2",
    ]
    by_loop = Breaks(by_loop="breaks decay 0.01 1/s (at least 0.02 1/s)")
    assert fit({"stay": by_loop, "candidate 1": broken, "candidate 2": kept}) == ["candidate 2"]
    # Where the arm is held beside its target that takes no place out, but one at the target takes it out.
    misses = "stay"
    assert fit({"stay": kept, "candidate 1": broken}) == ["stay", "candidate 1"]
    assert fit({"stay": kept, "candidate 1": by_loop, "candidate 2": beside}) == ["stay", "candidate 2"]
    assert fit({"stay": broken, "candidate 1": kept}) == ["candidate 1"]
    misses = ""
    # By what each is: one that breaks several kinds by the first that others keep.
    many = {"stay": standing, "candidate 1": by_loop._replace(at_rest=beside.at_rest), "candidate 2": broken}
    for kind, of in (({"candidate 1": by_loop}, "by_loop"), ({"candidate 1": beside}, "at_rest")):
        judged = with_barring({"stay": standing, "candidate 2": kept} | kind, lambda _: True, lambda _: True)
        assert [judged[name].barring for name in ("stay", "candidate 1", "candidate 2")] == ["standing", of, ""]
    assert [each.barring for each in with_barring(many, lambda _: True, lambda _: True).values()] == [
        "standing",
        "by_loop",
        "",
    ]
    # Where no loop does what it must, that tells no place from another.
    assert fit({"stay": by_loop, "candidate 1": by_loop}) == ["stay", "candidate 1"]
    assert "no place found that keeps the constraints dec" in decide(STAY, [], barred=True).reason
    assert decide(STAY, [], sought="w1").reason.startswith("no place found by w1 decays")
    grows = place("stay", GROUNDS - 1.0)
    told = decide(grows, [], place("candidate 1", GROUNDS), barred=True, gains="kp 1 1/s")
    assert told.word == "change gains"
    assert told.reason.endswith("no place found that keeps the constraints is stable on every ground")
    refuted = decide(grows, [], refuted=place("candidate 1", GROUNDS), doubt="the run of 20 s grows", gains="kp 1 1/s")
    assert refuted.word == "cannot tell"
    assert refuted.reason.endswith("but nonlinear runs do not confirm that: the run of 20 s grows")
    refuted = decide(grows, [], refuted=place("candidate 1", GROUNDS), doubt="breaks holding of boom", gains="kp 1 1/s")
    assert refuted.reason.endswith("(kp 1 1/s) candidate 1 is, but then it breaks holding of boom")


def test_places_that_a_search_finds_slower_than_their_members_give_way() -> None:
    """Of random places the first three are those of all by what the search finds, which few are asked."""
    rng = np.random.default_rng(5)
    for _ in range(200):
        decays = {f"candidate {k}": rng.uniform(-0.1, 1.0) + rng.uniform(0, 0.5, 12) for k in range(1, 10)}
        found = {name: float(own.min() - rng.exponential(0.05)) for name, own in decays.items()}
        asked = list[str]()

        def slowest(name: str, asked: list[str] = asked, found: dict[str, float] = found) -> float:
            asked.append(name)
            return found[name]

        first = first_places(ranked(decays), decays, slowest)
        every = sorted(decays, key=lambda name: (np.mean(decays[name] > 0), found[name]), reverse=True)
        assert first == every[:3]
        assert len(set(asked)) == len(asked)


def test_of_mirrored_places_the_nearer_one_is_spoken_of() -> None:
    """Whatever their order; they differ by rounding."""
    far, near = place("far", 2.8 * GROUNDS, 11.0), place("near", 2.8 * GROUNDS * (1 - 1e-10), 1.5)
    for pair in ([far, near], [near, far]):
        half = [each._replace(decays=np.where(np.arange(GROUNDS.size) % 2, each.decays, 0.5)) for each in pair]
        assert (found := decide(STAY, half)).word == "cannot tell"
        assert found.place == "near"
        assert decide(place("stay", -GROUNDS), [each._replace(decays=-GROUNDS) for each in pair]).place == "near"


def test_what_decays_is_not_told_to_decay_so_much_faster_than_what_grows() -> None:
    found = decide(place("stay", -GROUNDS), [place("near", 0.1 * GROUNDS, 2.0)])
    assert found.reason.startswith("stable on every ground, which the present place is not; slowest decay ")


def test_a_tenth_is_not_enough_when_it_is_not_a_tenth() -> None:
    assert decide(STAY, [place("near", 1.05 * GROUNDS)]).word == "stay"
    assert decide(STAY, [place("near", 1.15 * GROUNDS)]).word == "move"


def test_what_grows_somewhere_is_no_place() -> None:
    assert decide(STAY, [place("near", 3 * (GROUNDS - 0.6))]).word == "cannot tell"
    assert decide(place("stay", -GROUNDS), [place("near", 0.1 * GROUNDS)]).word == "move"
    assert decide(place("stay", -GROUNDS), [place("near", -0.5 * GROUNDS)]).word == "cannot tell"


def test_better_on_some_grounds_only() -> None:
    mixed = np.where(np.arange(40) < 20, 2.0, 0.7) * GROUNDS
    found = decide(STAY, [place("near", mixed)])
    assert (found.word, found.place) == ("cannot tell", "near")
    assert found.reason == "near decays at least 10 % faster on 50 % of the grounds only"


def test_nothing_is_said_that_runs_do_not_confirm() -> None:
    better = place("near", 2 * GROUNDS)
    assert decide(STAY, [better], unconfirmed={"near": ""}).reason.endswith("nonlinear runs do not confirm it")
    assert decide(STAY, [], unconfirmed={"stay": ""}).word == "cannot tell"
    for stay, others in ((STAY, []), (STAY, [better]), (place("stay", -GROUNDS), [better])):
        told = decide(stay, others, unconfirmed={"stay": "the end-point is 0.4 m off", "near": "it is 0.5 m off"})
        assert told.word == "cannot tell"
        assert told.reason.endswith("(it is 0.5 m off)" if others else "(the end-point is 0.4 m off)")
    # Each with its own; what is why of all once.
    two = [better, place("far", GROUNDS)]
    ends = {
        "confirm the present place and far (A); nor near (B)": {"stay": "A", "near": "B", "far": "A"},
        "confirm the present place (A), near (B) and far (C)": {"stay": "A", "near": "B", "far": "C"},
        "confirm the present place (A; C), near (C) and far (B; C)": {"stay": "A; C", "near": "C", "far": "B; C"},
        "confirm the present place and near (it is 0.1 and 0.2 m off; C); nor far (B)": {
            "stay": "it is 0.1 m off; C",
            "near": "it is 0.2 m off; C",
            "far": "B",
        },
        "confirm the present place and near (it is 0.1 and 0.2 m off); nor far (B); C": {
            "stay": "it is 0.1 m off; C",
            "near": "it is 0.2 m off; C",
            "far": "B; C",
        },
        "confirm the present place, near and far (0.1, 0.2 and 0.2 m in 2, 3 and 4 s)": {
            "stay": "0.1 m in 2 s",
            "near": "0.2 m in 3 s",
            "far": "0.2 m in 4 s",
        },
        "confirm the present place (0.1 m in 2 s of 5), near (0.2 m in 3 s of 5) and far (0.2 m in 4 s of 6)": {
            "stay": "0.1 m in 2 s of 5",
            "near": "0.2 m in 3 s of 5",
            "far": "0.2 m in 4 s of 6",
        },
        "confirm the present place, near and far (A)": {"stay": "A", "near": "A", "far": "A"},
    }
    for words, doubts in ends.items():
        reason = decide(STAY, two, unconfirmed=doubts).reason
        assert reason.endswith(words)
        # So that no line beside it tells of one again, but with another number.
        for why in doubts.values():
            first = why.split("; ")[0]
            assert told_in(reason, first)
            assert not told_in(reason, first.replace("0.", "7.")) or "0." not in first
    assert decide(place("stay", -GROUNDS), [better], unconfirmed={"near": ""}).word == "cannot tell"


def test_gains_that_spare_the_drive() -> None:
    move = place("near", 2 * GROUNDS, 5.0)
    spared = decide(STAY, [move], place("stay", 2.5 * GROUNDS))
    assert spared.word == "change gains"
    assert ", more than near has with the present ones, 1/s" in spared.reason
    alike = decide(STAY, [move], place("stay", 2.1 * GROUNDS))
    assert ", as much as near has with the present ones, 1/s" in alike.reason
    assert decide(STAY, [move], place("stay", 1.5 * GROUNDS)).word == "move"
    assert decide(STAY, [], place("stay", 1.05 * GROUNDS)).word == "stay"
    assert decide(place("stay", -GROUNDS), [], place("stay", 0.1 * GROUNDS)).word == "change gains"
    assert decide(place("stay", -GROUNDS), [], place("stay", -GROUNDS)).word == "cannot tell"


def test_other_gains_are_not_praised_by_what_is_not_so() -> None:
    """A place that is stable with the present gains is not told to grow: what speaks against it is told."""
    grows, near, changed = place("stay", -GROUNDS), place("near", 2 * GROUNDS), place("near", 2.5 * GROUNDS)
    doubted = decide(grows, [near], changed, unconfirmed={"stay": "", "near": ""})
    assert doubted.word == "change gains"
    assert doubted.reason.endswith(
        "with the present ones near is stable on every ground, too, but nonlinear runs do not confirm it"
    )
    both = decide(grows, [near, place("far", GROUNDS)], changed, unconfirmed={"near": "", "far": ""})
    assert both.reason.endswith("near and far are stable on every ground, too, but nonlinear runs do not confirm them")
    partly = place("stay", np.where(np.arange(40) < 4, -1.0, 1.0) * GROUNDS)
    mostly = place("near", np.where(np.arange(40) < 36, 2.0, 1.0) * GROUNDS)
    told = decide(partly, [place("far", GROUNDS), mostly], place("near", 3 * GROUNDS))
    assert told.word == "change gains"
    assert told.reason.endswith(
        "with the present ones near is stable on every ground, too, but decays at least 10 % faster than the present place on 90 % "
        "of them only"
    )
    nowhere = decide(grows, [place("near", -GROUNDS)], changed)
    assert nowhere.reason.endswith("with the present ones no place found is stable on every ground")


def test_what_a_move_alone_brings_is_no_merit_of_other_gains() -> None:
    """A place that decays as fast with the present gains, if not enough faster than the present one on enough grounds."""
    halved = np.where(np.arange(40) < 24, 1.3, 1.0) * GROUNDS
    move = Place("near", halved, 0.62, 1.1)
    told = decide(STAY, [move], Place("near", 1.3 * GROUNDS, 0.62, 1.1))
    assert told.word == "cannot tell"
    other = decide(STAY, [move], Place("near", 1.6 * GROUNDS, 0.8, 1.1))
    assert other.word == "change gains"
    assert other.reason.endswith("with the present ones 0.62/s at most, at near")


def test_a_place_that_runs_refute_is_none_to_stay_at_with_the_present_gains() -> None:
    """Gains that runs confirm are told though they decay more slowly; all that decays faster is told to be refuted."""
    near, slower = place("near", 1.19 * GROUNDS, 1.0), place("stay", 0.9 * GROUNDS)
    found = decide(STAY, [], slower, {"stay": "it is off"})
    assert (found.word, found.place) == ("change gains", "stay")
    assert found.reason == (
        "with the new gains the slowest decay at the present place is 0.45/s; with the present ones the present place "
        "is stable on every ground, too, but nonlinear runs do not confirm it (it is off)"
    )
    assert decide(STAY, [], slower).word == "stay"
    both = decide(STAY, [near], place("near", 1.2 * GROUNDS, 1.0), {"stay": "it is off", "near": "it is off"})
    assert both.word == "change gains"
    assert both.reason.endswith(
        "the present place and near are stable on every ground, too, but nonlinear runs do not confirm them (it is off)"
    )
    one = decide(STAY, [near], place("stay", 1.2 * GROUNDS), {"near": "it is off"})
    assert one.word == "change gains"
    assert one.reason.endswith(
        "with the present ones 0.5/s at most where nonlinear runs confirm it, at the present place; they do not "
        "confirm near (it is off)"
    )
    other = decide(STAY, [place("near", 0.5 * GROUNDS, 1.0)], place("near", 0.8 * GROUNDS, 1.0), {"stay": "it is off"})
    assert other.word == "change gains"
    assert other.reason.endswith("at near; they do not confirm the present place (it is off)")
    # Not worth it beside what runs confirm.
    assert decide(STAY, [near], place("near", 1.2 * GROUNDS, 1.0), {"stay": "it is off"}).word != "change gains"


def test_no_place_is_said_to_be_better_nowhere_without_a_look_at_all() -> None:
    """Three places are as good as staying; a fourth, which grows on one ground, decays faster on all others."""
    alike = {f"candidate {k}": GROUNDS for k in (1, 2, 3)}
    grows = np.where(np.arange(40) == 0, -1.0, 2.0) * GROUNDS
    decays = {"stay": GROUNDS, **alike, "candidate 4": grows}
    told = ["stay", *ranked(alike)]
    assert overlooked(shares_better(decays), told) == ["candidate 4"]
    assert overlooked(shares_better({**decays, "candidate 4": GROUNDS}), told) == []
    # What is told of speaks against staying itself, or there is no staying.
    assert overlooked(shares_better({**decays, "candidate 2": 1.2 * GROUNDS}), told) == []
    assert overlooked(shares_better({**alike, "candidate 4": grows}), told[1:]) == []


def test_staying_tells_the_most_that_any_place_that_was_judged_is_better_on() -> None:
    """Of four that are shown none is better anywhere, another is on one ground of forty."""
    stay, alike = Place("stay", GROUNDS, 0.5, 0.0), Place("near", GROUNDS, 0.5, 0.1)
    told = decide(stay, [alike], most=1 / 40)
    assert told.word == "stay"
    assert "no place found decays at least 10 % faster on more than 2 % of the grounds" in told.reason
    assert "on any ground" in decide(stay, [alike]).reason
    few = place("near", np.where(np.arange(40) < 2, 2.0, 1.0) * GROUNDS)
    assert "on more than 5 % of the grounds" in decide(stay, [few], most=1 / 40).reason


def test_a_place_that_grows_fast_on_one_ground_goes_before_one_that_grows_slowly_on_most() -> None:
    nearly, mostly = np.array([0.5, 0.5, 0.5, -28.0]), np.array([0.5, -0.1, -0.1, -27.0])
    assert ranked({"mostly": mostly, "nearly": nearly}) == ["nearly", "mostly"]
    assert ranked({"slow": np.array([0.1, 0.2]), "fast": np.array([0.3, 0.2])}) == ["fast", "slow"]


def test_reasons_say_what_is_so() -> None:
    """A rival is told for what keeps it from being one; nothing is said of gains that were not tried."""
    grows = place("near", np.where(np.arange(40) == 0, -1.0, 10.0) * GROUNDS)
    found = decide(STAY, [grows])
    assert (found.word, found.reason) == (
        "cannot tell",
        "near decays at least 10 % faster on 98 % of the grounds, but not stable on every one",
    )
    worst = Place("near", 2 * GROUNDS, 0.5, 1.0)
    assert "not in its worst case" in decide(STAY, [worst]).reason
    partly = place("stay", np.where(np.arange(40) < 4, -1.0, 1.0) * GROUNDS)
    found = decide(partly, [place("near", 0.1 * GROUNDS)])
    assert found.reason == (
        "near is stable on every ground, and the present place is not, but decays at least 10 % faster on 10 % of the "
        "grounds only"
    )
    near, changed = place("near", 0.1 * GROUNDS), place("stay", GROUNDS)
    others = tried_gains(Loop(kp=1e4, kv=1e3))
    none = decide(partly, [near], place("stay", 0.1 * GROUNDS), tried=others)
    assert none.reason.endswith(f"; no gains worth a change are found with {others}")
    refuted = decide(partly, [near], tried="others", refuted=changed, doubt="it is short", gains="kp 2")
    assert refuted.reason.endswith(
        "; with other gains (kp 2) the present place decays at least 10 % faster in the worst case, but nonlinear runs "
        "do not confirm that: it is short"
    )
    shaky = decide(STAY, [], unconfirmed={"stay": "why"}, tried="others", refuted=changed, doubt="it is short")
    nor = "nonlinear runs do not confirm the present place (why); nor the present place with other gains"
    assert shaky.reason == f"{nor}: it is short"
    # What is why without them, too, is not told again.
    for doubt, told in (("why", ""), ("", ""), ("it is short; why", ": it is short")):
        again = decide(STAY, [], unconfirmed={"stay": "why"}, tried="others", refuted=changed, doubt=doubt)
        assert again.reason == f"{nor}{told}"
    doubted = decide(STAY, [place("near", GROUNDS)], unconfirmed={"stay": ""})
    assert doubted.reason == (
        "nonlinear runs do not confirm the present place, and near, which they confirm, decays at least 10 % faster on "
        "none that was looked at"
    )
    assert "gains" not in found.reason
    nowhere = decide(place("stay", -GROUNDS), [place("near", -GROUNDS)])
    assert nowhere.reason.endswith("with the present gains")
    assert decide(place("stay", -GROUNDS), [], tried="others").reason.endswith(
        "with the present gains, nor with others"
    )


@pytest.mark.parametrize(
    ("times", "word"), [(0.95, "change gains"), (0.6, "change gains"), (0.56, "change gains"), (0.54, "cannot tell")]
)
def test_where_runs_refute_the_present_place_gains_that_they_confirm_there_need_not_be_faster(
    times: float, word: str
) -> None:
    """Unless a place to move to, 0.6 times as fast as staying was, decays a tenth faster than staying with them."""
    stay, near, doubts = place("stay", GROUNDS), place("near", 0.6 * GROUNDS), {"stay": "far off"}
    changed = place("stay", times * GROUNDS)
    assert (1.1 * times < 0.6) == (word == "cannot tell")
    found = decide(stay, [near], changed, doubts)
    assert found.word == word
    # As others do where runs do not confirm them: they are not said to be faster where they are not.
    refuted = decide(stay, [near], None, doubts, refuted=changed, doubt="it is short", gains="kp 2", tried="others")
    does = "decays at least 10 % faster in the worst case" if times > 0.66 else "is stable on every ground, too"
    told = f"; with other gains (kp 2) the present place {does}, but nonlinear runs do not confirm that: it is short"
    assert refuted.reason.endswith(
        told if word == "change gains" else "; no gains worth a change are found with others"
    )
    # One that is stable without them, and that runs confirm, is changed to what is faster alone.
    assert decide(stay, [near], changed).word == "stay"


def test_gains_that_runs_do_not_confirm_are_not_said_to_grow() -> None:
    grows = place("stay", -GROUNDS)
    refuted = decide(grows, [], tried="others", refuted=place("stay", GROUNDS))
    assert refuted.reason.endswith("with other gains the present place is, but nonlinear runs do not confirm that")
    assert "nor with others" in decide(grows, [], tried="others", refuted=grows).reason
    named = decide(grows, [], tried="others", refuted=place("stay", GROUNDS), gains="kp 0.4, kv 0.015")
    assert "; with other gains (kp 0.4, kv 0.015) the present place is, but" in named.reason


def test_what_tells_growing_from_stable_grounds_is_to_be_measured() -> None:
    """Elsewhere the gain by moving follows the ground; whether the place can be had follows another number."""
    payload = np.tile([-1.0, 1.0, 1.0, 1.0], 10)
    stay = place("stay", np.where(payload < 0, -5.0, GROUNDS))
    near = place("near", np.where(payload < 0, -5.0 - GROUNDS, GROUNDS**2))
    decision = decide(stay, [near])
    assert decision.word == "cannot tell"
    what, values = deciding(decision, {"stay": stay, "near": near}, stay)
    assert what == "whether the present place is stable"
    assert np.array_equal(values, payload)
    gained = place("near", np.where(np.arange(40) < 20, 2.0, 0.7) * GROUNDS)
    what, values = deciding(decide(STAY, [gained]), {"stay": STAY, "near": gained}, STAY)
    assert what == "whether near decays at least 10 % faster"
    assert np.array_equal(values > 0, faster(gained.decays, STAY.decays))
    few = place("near", np.where(np.arange(40) < 2, 2.0, 0.7) * GROUNDS)
    what, values = deciding(Decision("cannot tell", "near", ""), {"stay": STAY, "near": few}, STAY)
    assert what == "whether near decays at least 10 % faster"
    assert np.array_equal(values > 0, faster(few.decays, STAY.decays))
    # A thousandth more on some grounds and less on others decides nothing.
    alike = place("near", np.where(np.arange(40) < 20, 1.001, 0.999) * GROUNDS)
    _, values = deciding(decide(STAY, [alike], unconfirmed={"stay": ""}), {"stay": STAY, "near": alike}, STAY)
    assert values.max() < 0
    alone = decide(STAY, [], unconfirmed={"stay": "why"})
    what, values = deciding(alone, {"stay": STAY}, STAY)
    assert what == "the decay at the present place"
    assert np.array_equal(values, STAY.decays)
    # By the share of the decay, as the word: a load that takes as much from both tells, though what is gained in 1/s
    # falls with it.
    load = np.linspace(0.0, 1.0, 40)
    slower, other = (
        place("stay", 10.0 * np.exp(-3 * load)),
        place("near", 10.0 * np.exp(-3 * load) * (1.05 + 0.1 * load)),
    )
    _, values = deciding(decide(slower, [other]), {"stay": slower, "near": other}, slower)
    assert np.all(np.diff(values) >= 0)
    assert values.min() < 0 < values.max()
    assert np.array_equal(values > 0, faster(other.decays, slower.decays))
    # Whatever decays is better than what does not.
    still, rival = place("stay", np.where(load < 0.5, 0.0, 1.0)), place("near", 0.5 + load)
    _, values = deciding(Decision("cannot tell", "near", ""), {"stay": still, "near": rival}, still)
    assert np.array_equal(values > 0, faster(rival.decays, still.decays))
    found_by_search = Place("near", GROUNDS, -0.1, 0.0)
    what, values = deciding(
        decide(grows := place("stay", -GROUNDS), [found_by_search]), {"near": found_by_search}, grows
    )
    assert what == "how far near is from growing"
    assert values.min() < 0 < values.max()


@pytest.mark.parametrize("loss", [1e-4, 0.015, 0.09, -0.015, -0.09])
@pytest.mark.parametrize(("share", "count"), [(0.08, 64), (0.15, 64), (0.75, 64), (0.08, 16), (0.04, 32), (0.9, 16)])
def test_a_number_that_orders_what_decides_nothing_is_not_to_be_measured(loss: float, share: float, count: int) -> None:
    """A move gains a third on soft grounds, and loses or gains a little elsewhere with the load: soil decides."""
    of = (
        flexopt.Uncertainty(of=("payload.mass",), value=(0.0, 300.0)),
        flexopt.Uncertainty(of=("stiffness",), factor=(0.5, 2.0)),
    )
    box = UncertaintyBox(flexopt.load("excavator"), of, 0.0)
    members = box.members(count, 0)
    loads, soils = members.T
    soft = soils <= np.quantile(soils, share)
    stay, near = place("stay", np.ones(count)), place("near", np.where(soft, 1.3, 1.0 - loss * loads))
    decision = decide(stay, [near])
    assert decision.word == "cannot tell"
    _, values = deciding(decision, {"stay": stay, "near": near}, stay)
    name, rank = matters_most(box, members, values.tolist())
    assert name in (("stiffness",) if soft.sum() > 2 else ("stiffness", ""))
    assert rank < 0


def test_out_of_reach_from_here() -> None:
    assert decide(None, [place("near", GROUNDS)]).word == "move"
    assert decide(None, [place("near", -GROUNDS)]).word == "cannot tell"


@pytest.mark.parametrize(
    ("word", "shares", "told"),
    [
        ("stay", {"candidate 1": 0.2, "candidate 2": 1.0, "candidate 3": 1.0}, "candidate 2"),
        ("cannot tell", {"candidate 1": 0.5}, "candidate 1"),
        ("stay", {"candidate 1": 0.05}, ""),
        ("stay", {}, ""),
        ("move", {"candidate 1": 1.0}, ""),
    ],
)
def test_a_better_place_that_breaks_constraints_somewhere_is_told(
    word: Any, shares: dict[str, float], told: str
) -> None:
    """The first of those that are better on the most grounds."""
    somewhere = Breaks(somewhere="breaks holding of boom where payload.mass is 3000 kg", barring="somewhere")
    breaks = dict.fromkeys(shares, somewhere)
    found = with_barred(Decision(word, "stay", "because"), best_barred(shares, breaks), breaks).reason
    share = 100 * max(shares.values(), default=0.0)
    better = f"; {told} decays at least 10 % faster on {share:.0f} % of the grounds, but breaks constraints on some: "
    assert found == "because" + f"{better}constraints.within seeks places that keep them there" * bool(told)
    unsought = {name: somewhere._replace(sought="none") for name in shares}
    found = with_barred(Decision(word, "stay", "because"), best_barred(shares, unsought), unsought).reason
    assert found == "because" + better.removesuffix(": ") * bool(told)
    at_rest = "breaks tool angle, 0.3 rad, where payload.mass is 3000 kg"
    beside = dict.fromkeys(shares, Breaks(at_rest=at_rest, barring="at_rest"))
    decision = with_barred(Decision(word, "stay", "because"), best_barred(shares, beside), beside)
    assert (f"of the grounds, but at rest beside its target {at_rest}: an integral part" in decision.reason) is bool(
        told
    )
    # No choice seeks places that keep constraints there: that none was found that does is no reason to stay.
    assert (decision.word, decision.place) == (("cannot tell", told) if told and word == "stay" else (word, "stay"))
    # What a loop does not do with its own numbers is told elsewhere.
    of_loop = dict.fromkeys(shares, Breaks(by_loop="breaks decay of the loop, 0.01/s", barring="by_loop"))
    assert with_barred(Decision(word, "stay", "because"), best_barred(shares, of_loop), of_loop).reason == "because"
    # One of each kind, though what breaks constraints on some ground is better on more grounds.
    both = {"candidate 8": 0.9, "candidate 9": 0.4}
    kinds = {"candidate 8": somewhere, "candidate 9": Breaks(at_rest=at_rest, barring="at_rest")}
    decision = with_barred(Decision("stay", "stay", "because"), best_barred(both, kinds), kinds)
    assert (decision.word, decision.place) == ("cannot tell", "candidate 9")
    assert "candidate 8 decays at least 10 % faster on 90 % of the grounds" in decision.reason


def test_why_it_is_no_nearer_place_is_told() -> None:
    stay, best = place("stay", GROUNDS), place("candidate 3", 3.0 * GROUNDS, 4.0)

    def told_of(near: Place, unconfirmed: dict[str, str] | None = None, there: Place | None = stay) -> str:
        found = decide(there, [best, near], unconfirmed=unconfirmed or {})
        assert (found.word, found.place) == ("move", "candidate 3")
        return found.passed_over

    begun = "candidate 1 is nearer, 2 m away, but "
    few = place("candidate 1", np.where(np.arange(40) < 37, 3.0, 1.0) * GROUNDS, 2.0)
    assert told_of(few) == f"{begun}decays at least 10 % faster on 92 % of the grounds only"
    assert told_of(few._replace(slowest=-0.1)) == f"{begun}is not stable on every ground"
    slower = place("candidate 1", 2.0 * GROUNDS, 2.0)
    assert told_of(slower) == f"{begun}its slowest decay is 1/s only"
    assert told_of(slower, there=None) == f"{begun}its slowest decay is 1/s only"
    alike = place("candidate 1", 3.0 * GROUNDS, 2.0)
    assert told_of(alike, {"candidate 1": "it ends 2 cm off"}) == (
        f"{begun}nonlinear runs do not confirm it (it ends 2 cm off)"
    )
    assert told_of(alike._replace(slowest=0.54)) == f"{begun}not in its worst case"
    assert told_of(place("candidate 1", GROUNDS, 2.0)) == ""
    assert told_of(slower._replace(drive=3.9)) == ""
    assert told_of(slower._replace(drive=5.0)) == ""
    # Where there is no staying it is none to be better than.
    assert told_of(place("candidate 1", GROUNDS, 2.0), there=None) == f"{begun}its slowest decay is 0.5/s only"
    assert decide(stay, [slower]).passed_over == ""


def test_of_places_as_near_the_fastest_is_moved_to() -> None:
    """A drive that is shorter by rounding decides nothing, nor a turn; of mirrored ones the first is taken."""
    far, near = place("candidate 1", 3.1 * GROUNDS, 4.8 + 6e-15), place("candidate 2", 3.0 * GROUNDS, 4.8)
    assert decide(STAY, [near, far]).place == "candidate 1"
    assert decide(STAY, [near, far._replace(turn=1e-4)]).place == "candidate 1"
    assert decide(STAY, [near, far._replace(turn=0.5)]).place == "candidate 2"
    assert decide(STAY, [near._replace(drive=2.0), far]).place == "candidate 2"
    mirrored = far._replace(name="candidate 10", decays=(1 + 1e-12) * far.decays, slowest=(1 + 1e-12) * far.slowest)
    assert decide(STAY, [mirrored, near, far]).place == "candidate 1"


@pytest.mark.parametrize(
    ("one", "other", "is_faster"), [(1.2, 1.0, True), (1.05, 1.0, False), (-0.5, -1.0, True), (0.1, -0.1, True)]
)
def test_faster(one: float, other: float, is_faster: bool) -> None:
    assert bool(faster(np.array(one), np.array(other))) is is_faster


def test_where_there_is_no_staying_a_stable_place_is_enough() -> None:
    """A slower one, too; the reason is why there is none."""
    slower, absent = place("near", 0.5 * GROUNDS, 2.0), "the present place breaks tip-over"
    assert decide(STAY, [slower]).word == "stay"
    found = decide(None, [slower], absent=absent)
    assert (found.word, found.place) == ("move", "near")
    assert found.reason == f"{absent}; slowest decay there {slower.slowest:.3g}/s, for a drive of 2 m"
    assert decide(None, [slower], unconfirmed={"near": ""}, absent=absent).word == "cannot tell"
    assert decide(None, [place("near", -GROUNDS)], absent=absent).word == "cannot tell"


def test_where_few_grounds_grow_the_decay_itself_decides() -> None:
    """A single one of eight, the heaviest load, tells nothing by its sign alone."""
    loads = np.linspace(0.0, 3.0, 8)
    rival = Place("candidate 1", 0.5 - 0.18 * loads, -0.04, 1.0)
    stay = Place("stay", -np.ones(8), -1.0, 0.0)
    what, values = deciding(decide(stay, [rival]), {"stay": stay, "candidate 1": rival}, stay)
    assert what == "how far candidate 1 is from growing"
    assert values == pytest.approx(rival.decays - rival.decays.mean())


def test_gains_of_several_task_rows_are_told_each() -> None:
    """One number where they are one."""
    assert gains_in_words({"kp": [4.0, 6.0, 4.0], "kv": [1.0, 1.0, 1.0]}, ("N m", "N m s")) == (
        "kp [4, 6, 4] N m, kv 1 N m s"
    )


def test_what_alone_parts_a_few_grounds_is_named() -> None:
    """Two of eight grounds, of which no correlation is sure; of as many that nothing parts more members are asked for."""
    uncertain = (Uncertainty(of="stiffness", factor=(0.7, 1.3)), Uncertainty(of="payload.mass", value=(250.0, 1050.0)))
    box = UncertaintyBox(flexopt.load("excavator"), uncertain, 0.0)
    members = np.array([(0, 0), (0, 1), (1, 0), (1, 1), (0.3, 0.6), (0.5, 0.2), (0.7, 0.8), (0.9, 0.4)], dtype=float)
    stay = place("stay", np.ones(8))

    def told(fails: np.ndarray) -> str:
        first = place("candidate 1", np.where(fails, 1.05, 1.3), 2.0)
        decision = decide(stay, [first], None, {})
        assert (decision.word, decision.place) == ("cannot tell", "candidate 1")
        return reasons.to_measure(decision, box, members, {"stay": stay, "candidate 1": first}, stay, {}, {})

    light = members[:, 1] == 0
    assert matters_most(box, members, np.where(light, -1.0, 1.0).tolist())[0] == ""
    assert told(light).startswith(
        "to tell, measure payload.mass, which alone parts the 8 grounds looked at by whether "
    )
    other = told(np.arange(8) == 4)
    assert other.startswith("no single measurement is seen to tell: on the 8 grounds looked at ")
    assert other.endswith("; on as many as the usual 64 members it may be")


def test_nothing_to_measure_is_said_of_the_places_that_may_be_sent_to() -> None:
    """Where all of these break something, too, they break the least."""
    box = UncertaintyBox(flexopt.load("excavator"), (Uncertainty(of="payload.mass", value=(250.0, 1050.0)),), 0.0)
    decays = {"stay": np.ones(4), "candidate 1": -np.ones(4)}
    bands: Any = {name: SimpleNamespace(decay=SimpleNamespace(nominal=own[0])) for name, own in decays.items()}
    known, stands = {"candidate 1": place("candidate 1", decays["candidate 1"])}, Breaks(standing="breaks clearance")

    def told(first: Breaks) -> str:
        breaks = {"stay": stands, "candidate 1": first}
        decision = Decision("cannot tell", "", "")
        return reasons.to_measure(decision, box, np.linspace(250, 1050, 4)[:, None], known, None, bands, breaks)

    grows = "nothing to measure: with the present gains every place that breaks {} grows on all 4 grounds looked at"
    assert told(Breaks()) == grows.format("nothing")
    assert told(Breaks(by_loop="breaks decay")) == grows.format("the least")


def test_a_decay_that_stands_for_falling_is_told_in_words() -> None:
    falls = Place("stay", -1.4e5 * np.ones(8), -1.4e5, 0.0, falls=True)
    told = decide(falls, [Place("near", 0.5 * np.ones(8), 0.5, 1.0)])
    assert told.word == "move"
    assert "slowest decay 0.5/s instead of none (the arm falls), for a drive of 1 m" in told.reason


@pytest.mark.parametrize(("slowest", "told"), [(-19.94, "-19.9/s"), (0.0, "0/s"), (0.3, "")])
def test_that_a_place_is_not_stable_is_told_with_its_slowest_decay(slowest: float, told: str) -> None:
    """None that is stable."""
    grows = Place("stay", np.full(4, slowest), slowest, 0.0).grows_told
    assert grows == (told and f"; nor is it stable on every ground: slowest decay {told}")
