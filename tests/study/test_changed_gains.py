"""In which place other gains are changed to, of places whose decays and runs are given."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

from flexopt.model.loop import Loop
from flexopt.study.verdicts import changed_gains
from flexopt.study.verdicts.changed_gains import ChangedGains, GainChange
from flexopt.study.verdicts.decision import Place

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
