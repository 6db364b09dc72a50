"""In which place other gains are changed to, of places whose decays and runs are given."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

import flexopt
from flexopt.foundation.arrays import Vector
from flexopt.model.loop import Loop
from flexopt.study.verdicts import changed_gains
from flexopt.study.verdicts.changed_gains import ChangedGains, GainChange
from flexopt.study.verdicts.decision import Place
from flexopt.study.verdicts.gain_search import at_ends

GROUNDS = np.linspace(1.0, 1.2, 40)


class Case(NamedTuple):
    """Slowest decays by place, with the present gains and others; drives; what runs of the others refute; what is told."""

    now: dict[str, float]
    then: dict[str, float]
    drives: dict[str, float]
    refuted: tuple[str, ...]
    place: str
    staying: bool


@pytest.mark.parametrize(
    "case",
    [
        # A move with the present gains does as much as staying with others: the drive is spared.
        Case({"stay": -1.0, "near": 1.0}, {"stay": 1.2, "near": 2.0}, {"near": 3.0}, (), "stay", staying=False),
        # No place is stable with the present gains.
        Case({"stay": -1.0, "near": -1.0}, {"stay": 1.2, "near": 2.0}, {"near": 3.0}, (), "near", staying=True),
        Case({"stay": -1.0, "near": -1.0}, {"stay": 1.9, "near": 2.0}, {"near": 3.0}, (), "stay", staying=False),
        # Runs refute some.
        Case({"stay": -1.0, "near": -1.0}, {"stay": 1.9, "near": 1.5}, {"near": 3.0}, ("stay",), "near", staying=False),
        Case(
            {"stay": -1.0, "near": -1.0, "far": -1.0}, {"stay": 1.0, "near": 2.0, "far": 1.9}, {"near": 3.0, "far": 4.0},
            ("near",), "far", staying=True,
        ),
        Case({"stay": -1.0, "near": -1.0}, {"stay": 1.0, "near": 2.0}, {"near": 3.0}, ("near",), "stay", staying=False),
        Case({"near": -1.0, "far": -1.0}, {"near": 1.0, "far": 0.95}, {"near": 3.0, "far": 4.0}, (), "near", staying=False),
    ],
)  # fmt: skip
def test_where_gains_are_changed(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = SimpleNamespace(
        feedback="pd", kp=np.array([2.0]), kv=np.array([1.0]), gain_units=("N m", "N m s", "N m/s")
    )
    loop: Any = SimpleNamespace(settings=settings)

    def places(slowest: dict[str, float]) -> dict[str, Place]:
        return {name: Place(name, each * GROUNDS, each, case.drives.get(name, 0.0)) for name, each in slowest.items()}

    def fastest(_: GainChange, name: str) -> Any:
        return SimpleNamespace(place=places(case.then)[name])

    def lowest(_: GainChange, tried: Any) -> ChangedGains:
        confirming = 0.0 if tried.place.name in case.refuted else 1.0
        return ChangedGains(tried.place, loop, SimpleNamespace(confirming=confirming, reasons=("far off",)))  # type: ignore[arg-type]

    monkeypatch.setattr(changed_gains.GainChange, "_fastest", fastest)
    monkeypatch.setattr(changed_gains.GainChange, "_lowest", lowest)
    found = GainChange(Loop(), places(case.now), {}, {}, {}, np.zeros((1, 1)), lambda _: None).best()
    assert found.place.name == case.place
    told = f"staying with kp 2 N m, kv 1 N m s is stable on every ground, too: slowest decay {case.then.get('stay')}/s"
    assert (found.staying == told.replace(".0/s", "/s")) == case.staying


@dataclass(frozen=True)
class Gains:
    """What gains are lowered of."""

    kp: Vector
    kv: Vector
    ki: Vector
    feedback: str = "pd"


@dataclass(frozen=True)
class Bordered:
    """A loop that decays at 1/s up to the gain that a member names, and grows from there on."""

    settings: Gains

    def with_settings(self, settings: Gains) -> Bordered:
        return Bordered(settings)

    def decays(self, members: Vector) -> Vector:
        return np.where(self.settings.kp[0] < members[:, 0], 1.0, -1.0)[None]

    def slowest(self, members: Vector, decays: Vector) -> SimpleNamespace:
        worst = int(decays.min(axis=0).argmin())
        return SimpleNamespace(decay=float(decays.min()), member=members[worst])


@pytest.mark.parametrize("border", [1.2, 1.9, 2.5])
def test_twice_the_gains_hold_on_every_member(border: float) -> None:
    """Not only on the few that the gains were sought for, which know of no border here."""
    loop: Any = Bordered(Gains(np.array([1.0]), np.array([1.0]), np.zeros(1)))
    points = np.array([[10.0], [border]])
    known = {"stay": Place("stay", np.array([-1.0, -1.0]), -1.0, 0.0)}
    change = GainChange(Loop(), known, {"stay": loop}, {}, {}, points, lambda _: None)
    fastest = changed_gains._Tried(Place("stay", np.ones(2), 1.0, 0.0), loop, points[:1])
    gain = float(change._lowest(fastest).loop.settings.kp[0])
    assert 2 * gain < border
    assert gain == 1.0 or 2 * gain > 0.8 * border  # Steps of 2^(1/4).


def gains(kp: float, kv: float) -> Any:
    return SimpleNamespace(kp=np.full(2, kp), kv=np.full(2, kv))


@pytest.mark.parametrize(
    ("found", "ranges", "told"),
    [
        ((123.1, 120.9), {}, "no lower ones were tried than 0.01 times the present ones"),
        ((123100.0, 120900.0), {}, "no higher ones were tried than 10 times the present ones"),
        ((200.0, 196.4), {}, ""),
        ((50.0, 5.0), {"kp_range": (10.0, 100.0), "kv_range": (5.0, 50.0)}, "kv is the lower end of its range"),
        ((99.99, 5.0), {"kp_range": (10.0, 100.0), "kv_range": (5.0, 50.0)}, "kp is the upper end of its range and kv"),
        ((50.0, 7.0), {"kp_range": (10.0, 100.0), "kv_range": (7.0, 7.0)}, ""),
        ((50.0, 5.1), {"kp_range": (10.0, 100.0), "kv_range": (5.0, 50.0)}, ""),
        (
            (50.0, 1e-6),
            {"kp_range": (10.0, 100.0), "kv_range": (0.0, 1.0)},
            "kv is the least of its range that is tried, 1e-06",
        ),
        ((50.0, 1.0), {"kp_range": (10.0, 100.0), "kv_range": (0.0, 1.0)}, "kv is the upper end of its range"),
    ],
)
def test_gains_at_an_end_of_what_was_tried_are_told(
    found: tuple[float, float], ranges: dict[str, Any], told: str
) -> None:
    said = at_ends(gains(*found), Loop(**ranges), gains(12310.0, 12090.0))
    assert said.startswith(told)
    assert bool(said) == bool(told)


@pytest.mark.long
def test_gains_are_changed_to_the_lowest_that_were_tried_and_that_is_said() -> None:
    """With half of these gains the loop decays faster."""
    machine, loop = flexopt.load("excavator"), {"dead_time": 0.05, "drive": "torque", "kp": 12311.0, "kv": 12085.0}
    chosen = flexopt.select(machine, (0.151, 1.838), base=0.0, starts=6)
    found = flexopt.verdict(chosen, loop=loop, ranges={"stiffness": (0.4, 2.5)}, members=32, runs=0)
    assert found.word == "change gains"
    assert found.gains["kp"][0] == pytest.approx(123.11)
    assert "no lower ones were tried than 0.01 times the present ones: kp_range and kv_range" in found.sentence
