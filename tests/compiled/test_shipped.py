"""What is computed at many points or over many steps for shipped machines runs compiled, in the form made for that.

A graph that no longer compiles gives the same results a hundred times more slowly: only this test would tell.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

import flexopt
from flexopt.compiled import Batch, batch, find_compiler, lanes, recurrence
from flexopt.foundation import kept
from flexopt.model import AnyMachine, shipped_names
from flexopt.plant import build_plant
from flexopt.robustness.margin import build_margin
from flexopt.simulation import run
from flexopt.study.maps import follow, points
from tests.compiled.comparison import QUIET
from tests.model.test_shipped_machines import POSTURES

pytestmark = pytest.mark.filterwarnings(QUIET)

MACHINES = shipped_names("models")
REGULAR = {"excavator": (0.9929, -2.6306)} | POSTURES


BATCHED: dict[str, Callable[[AnyMachine], Batch]] = {
    "w": lambda machine: flexopt.build_measures(machine).quick_batch,
    "w with gradient": lambda machine: flexopt.build_measures(machine).quick_batch_with_gradient,
    "distance from singularity": lambda machine: batch(build_plant(machine).singularity_sine_squared),
    "measures of maps": lambda machine: batch(points._measures_of_many(flexopt.build_measures(machine)).function),
    "task at rest": lambda machine: batch(follow._task_at_rest(machine).function),
    "task as it sags": lambda machine: batch(follow._task_as_it_sags(machine).function),
}


@pytest.fixture(autouse=True)
def _quickly(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is too long for a compiler stays it; the rest, but for the excavator's, is compiled without optimisation."""
    if request.node.callspec.params["name"] != "excavator":
        monkeypatch.setattr(lanes, "LEVELS", tuple((most, ("-O0",)) for most, _ in lanes.LEVELS))


# With the gradient come all instructions of w alone: of the others what compiles with it compiles without.
@pytest.mark.long(
    "w with gradient-mobile-manipulator",
    "w with gradient-slewing-excavator",
    "w with gradient-truck-crane",
    "measures of maps-mobile-manipulator",
    "measures of maps-slewing-excavator",
    "measures of maps-truck-crane",
    "measures of maps-excavator",
    "w with gradient-boom-stick-bucket",
    "distance from singularity-mobile-manipulator",
    "measures of maps-boom-stick-bucket",
)
@pytest.mark.parametrize(
    ("what", "name"), [(what, name) for what in BATCHED for name in MACHINES if what != "w" or name == "excavator"]
)
def test_at_many_points(what: str, name: str) -> None:
    assert BATCHED[what](flexopt.load(name)).compiled == (find_compiler() is not None)


@pytest.mark.long
@pytest.mark.parametrize(("name", "control"), [*((name, "inverse") for name in MACHINES), ("excavator", "transpose")])
def test_margin_is_the_compact_form(name: str, control: str) -> None:
    margin = build_margin(flexopt.load(name), control)
    compact, used = replace(margin, compact=True).values, margin.batched
    if find_compiler() is None:
        assert not used.compiled
        return
    assert used.compiled
    assert used.function.n_instructions() == compact.n_instructions()
    assert used.function.serialize() == compact.serialize()
    assert used.function.serialize() != margin.values.serialize()


@pytest.mark.long
@pytest.mark.parametrize("name", MACHINES)
@pytest.mark.filterwarnings("ignore::flexopt.errors.FlexoptWarning")
def test_closed_loop(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []
    for maker in (batch, recurrence):
        keep = lambda *given, maker=maker, **options: made.append(maker(*given, **options)) or made[-1]  # noqa: E731
        monkeypatch.setattr(run, maker.__name__, keep)
    kept.forget_all()
    flexopt.simulate(flexopt.load(name), REGULAR[name], duration=0.1)
    assert len(made) >= 2
    assert [each.compiled for each in made] == [find_compiler() is not None] * len(made)
