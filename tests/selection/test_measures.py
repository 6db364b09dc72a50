"""Configurations chosen by what gains, dead times and soils the loop bears, beside scans that climb nothing."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy import optimize

import flexopt
from flexopt.loop.settings import loop_settings
from flexopt.loop.uncertain import UncertainLoop
from flexopt.loop.uncertainty_box import UncertaintyBox
from flexopt.model.choices import OUTCOMES, SETTLING, SWING
from flexopt.model.loop import Loop
from flexopt.model.parameter_values import with_parameters
from flexopt.model.uncertainty import GROUND, Uncertainty
from flexopt.selection.outcomes.borders import Line
from flexopt.selection.outcomes.climb import climbed
from flexopt.selection.outcomes.measures import MEASURES
from flexopt.selection.outcomes.program import OutcomeProgram
from flexopt.selection.outcomes.result import OutcomeSelection
from flexopt.selection.places import FEASIBLE
from flexopt.selection.starts import moved
from tests.selection.loops import EXCAVATOR, POSTURE, TARGET, posture_at, told, worth

LATE = {"kp": 1e4, "kv": 1e3, "dead_time": 0.02}
LOOPS: dict[str, dict[str, float]] = {"allowed_gain": LATE, "delay_margin": LATE | {"dead_time": 0.0}, "allowance": LATE,
                                      "radius": LATE | {"dead_time": 0.01}}  # fmt: skip


@pytest.fixture
def _few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Points that are looked at first, and climbs from them: enough for these wide basins."""
    for measure in MEASURES.values():
        monkeypatch.setattr(type(measure), "looked", 150)
        monkeypatch.setattr(type(measure), "stages", ((12, 6), (5, 10)))


@pytest.mark.long
@pytest.mark.parametrize("name", LOOPS)
def test_nothing_that_a_scan_sees_is_better(name: str, request: pytest.FixtureRequest) -> None:
    """From all points by the allowed gain alone: what is looked at is the same of all."""
    if name != "allowed_gain":
        request.getfixturevalue("_few")
    found = flexopt.select(EXCAVATOR, TARGET, objective=name, loop=LOOPS[name], starts=8)
    assert isinstance(found, OutcomeSelection)
    places = itertools.product(np.linspace(-3.3, 3.3, 25).tolist(), ("up", "down"))
    best = max(worth(name, x, posture_at(x, elbow), LOOPS[name]) for x, elbow in places)
    # A radius is told to 1e-3 of its logarithm.
    assert found.best.objective >= best * (1 - 3e-3 if name == "radius" else 1)
    e = found.best.evaluation
    here = told(name, float(e.base[0]), tuple(e.posture.tolist()), LOOPS[name])
    assert found.best.objective == pytest.approx(here, rel=3e-3 if name == "radius" else 1e-6)
    assert f"objective {name}" in repr(found)
    assert found.to_dict()["measure"] == name


def line(rate: Callable[[float], float], own: bool = False) -> Line:
    """Of rates alone."""
    return Line(lambda _: pytest.fail("no loop"), rate, 0.0, own, lambda *_: pytest.fail("no slopes"))


@pytest.mark.parametrize("place", [0.41, 0.9, 0.955, 0.98])
def test_where_a_rate_comes_near_to_zero_before_a_border(place: float) -> None:
    """Close before the border, too, where another motion takes the rate to zero."""
    found = line(lambda x: min(1e-3 + (x - place) ** 2, 400 * (1.0 - x)))
    assert found.nearest(1.0)[0] == pytest.approx(place, abs=1e-5)
    assert found.border(1.0) == 1.0
    assert line(lambda x: min((x - place) ** 2 - 1e-6, 400 * (1.0 - x))).border(1.0) == pytest.approx(place - 1e-3)


@pytest.mark.parametrize("rate", [lambda x: 1.0 - x, lambda x: x, lambda x: 1.0 - x**2, lambda x: x * (1.0 - x)])
def test_rates_that_only_fall_or_rise_come_near_to_zero_nowhere(rate: Callable[[float], float]) -> None:
    assert not line(rate).nearest(1.0)
    assert line(rate, own=True).nearest(1.0) == ([0.0] if rate(0.1) > rate(0.0) else [])


@pytest.mark.long
@pytest.mark.usefixtures("_few")
def test_an_optimum_at_which_the_way_to_its_border_closes_is_verified() -> None:
    """Allowed gains jump there: at the border of another motion the rate of a first one touches zero before."""
    found = flexopt.select(EXCAVATOR, (0.0, 1.6), objective="allowed_gain", loop={"kp": 25.8, "kv": 196.0}, starts=8)
    assert isinstance(found, OutcomeSelection)
    assert found.unverified is None
    x, posture = float(found.best.evaluation.base[0]), found.best.evaluation.posture
    elbow = min(("up", "down"), key=lambda word: float(np.abs(np.subtract(posture_at(x, word), posture)).max()))
    near = [worth("allowed_gain", x + step, posture_at(x + step, elbow), {"kp": 25.8, "kv": 196.0})
            for step in (-1e-3, -1e-5, 1e-5, 1e-3)]  # fmt: skip
    assert max(near) < found.best.objective * (1 + 1e-9)
    assert min(near) < 0.8 * found.best.objective


@pytest.mark.long
@pytest.mark.usefixtures("_few")
def test_an_optimum_at_which_the_loop_itself_begins_to_grow_is_verified() -> None:
    """A delay margin there ends at once, as another motion decays the better the later the loop is."""
    loop, target = {"kp": 7.02e3, "kv": 3.4e3, "dead_time": 0.013}, (0.4, 2.4)
    found = flexopt.select(EXCAVATOR, target, objective="delay_margin", loop=loop, starts=8)
    assert isinstance(found, OutcomeSelection)
    assert found.unverified is None
    x, posture = float(found.best.evaluation.base[0]), found.best.evaluation.posture
    elbow = min(("up", "down"), key=lambda word: float(np.abs(np.subtract(posture_at(x, word, target), posture)).max()))
    near = [worth("delay_margin", x + step, posture_at(x + step, elbow, target), loop)
            for step in (-1e-3, -1e-5, 1e-5, 1e-3)]  # fmt: skip
    assert max(near) < found.best.objective * (1 + 1e-9)
    assert min(near) == -math.inf
    assert max(near) > 0.999 * found.best.objective


LOADED = "excavator, a load that is not known"
CASES = [(name, machine) for name in OUTCOMES for machine in ("excavator", LOADED, "slewing-excavator")]
GAINS = {
    "excavator": {"kp": 1e4, "kv": 1e3},
    LOADED: {"kp": 1e5, "kv": 2e4},
    "slewing-excavator": {"kp": 3e6, "kv": 6e5},
}
TARGETS = {"excavator": TARGET, LOADED: TARGET, "slewing-excavator": (6.0, 2.0, 1.0)}


@pytest.mark.long(
    "radius-slewing-excavator",
    "settling-excavator",
    "swing-excavator",
    "radius-excavator, a load that is not known",
    "settling-excavator, a load that is not known",
    "swing-excavator, a load that is not known",
    "decay-slewing-excavator",
    "allowed_gain-slewing-excavator",
    "delay_margin-slewing-excavator",
    "allowance-slewing-excavator",
    "settling-slewing-excavator",
    "swing-slewing-excavator",
)
@pytest.mark.parametrize(("name", "which"), CASES)
def test_slopes_at_points_that_are_no_optimum(name: str, which: str) -> None:
    """Of what must stay above zero, by everything that varies and by the level, beside differences."""
    machine, gains, loaded = flexopt.load(which.split(",", maxsplit=1)[0]), GAINS[which], which == LOADED
    problem = flexopt.build_selection(machine, TARGETS[which], gravity=loaded)
    n_base = len(machine.base_coordinates)
    # A move is told of a loop that decays.
    late = 0.0011 if name in (SETTLING, SWING) else 0.0071
    for k in np.flatnonzero(problem.scan.violation <= FEASIBLE)[5:].tolist():
        z, left = moved(problem, np.concatenate([problem.scan.base[:, [k]], problem.scan.posture[:, [k]]]), 1)
        assert left[0] <= FEASIBLE
        stand = flexopt.evaluate(machine, z[n_base:, 0], base=z[:n_base, 0], gravity=loaded)
        settings = loop_settings(machine, Loop(control="inverse", dead_time=late, **gains), stand)
        stable = settings.outcome(machine, stand.base, stand.posture, gravity=loaded).loop.stable
        if stable or name not in (SETTLING, SWING):
            break
    unknown = (Uncertainty(of="payload.mass", value=(300.0, 900.0)),) if loaded else ()
    box = UncertaintyBox(machine, unknown + (GROUND if name == "radius" else ()), late)
    loop = UncertainLoop(settings, stand.base, stand.posture, loaded, box)
    members = np.full((int(loaded), len(box.uncertainty)), 0.7)
    ranges = {} if name == "allowance" else {"kp": (1.0, 1e8), "kv": (1.0, 1e8)}
    program = OutcomeProgram(problem, loop, ranges, members, 0.1, MEASURES[name])
    y = np.append(z[:, 0] / problem.scale, np.log([gains[each] for each in ranges]))
    # Levels that have nothing to do with the value there; of gains the way to one begins with those there are.
    levels = {"delay_margin": [0.13], "radius": [0.3], "allowed_gain": [math.log(x * gains["kp"]) for x in (0.7, 1.7)]}
    for level in levels.get(name, [0.1]):
        _slopes_are_differences(program, y, level)


def _slopes_are_differences(program: OutcomeProgram, y: np.ndarray, level: float) -> None:
    found, step = program.branches(y, level), 1e-4
    ways = [*np.eye(y.size), None]
    for i, way in enumerate(ways):
        sides = [program.branches(y, level + sign * step) if way is None else program.branches(y + sign * step * way, level)
                 for sign in (1.0, -1.0)]  # fmt: skip
        count = min(len(found.values), *(len(side.values) for side in sides))
        central = (sides[0].values[:count] - sides[1].values[:count]) / (2 * step)
        ours = found.by_level[:count] if way is None else found.slopes[:count, i]
        # Differences keep some six digits, fewer of places between, which do not move with the level and are found to
        # 1e-3 of a grid's step, whatever this step is.
        size = np.where(found.by_level[:count] == 0, 1e-3, 1e-4) * max(1.0, float(np.abs(found.slopes).max()))
        assert np.all(np.abs(ours - central) <= size + 1e-4 * np.abs(central))


def _loaded(kp: float, base: float) -> tuple[OutcomeProgram, np.ndarray]:
    """A choice of the largest allowed gain with a load up to 900 kg, and a place on it, from an independent solver."""
    machine = with_parameters(EXCAVATOR, {"payload.mass": 450.0})
    posture = optimize.fsolve(
        lambda q: flexopt.evaluate(machine, q, base=base, gravity=True).end_point - np.array([2.2, 0.4]), (-1.765, 1.52)
    )
    stand = flexopt.evaluate(machine, posture, base=base, gravity=True)
    settings = loop_settings(machine, Loop(kp=kp, kv=kp / 5, rate=100.0), stand, gravity=True)
    box = UncertaintyBox(machine, (Uncertainty(of="payload.mass", value=(0.0, 900.0)),), 0.0)
    loop = UncertainLoop(settings, stand.base, stand.posture, True, box)
    problem = flexopt.build_selection(machine, (2.2, 0.4), gravity=True)
    program = OutcomeProgram(problem, loop, {}, np.array([[1.0]]), 1.0, MEASURES["allowed_gain"])
    return program, np.append(base, posture) / problem.scale


@pytest.mark.parametrize("base", [-0.24, -0.3])
def test_present_gains_above_the_border_change_no_choice_of_the_largest(base: float) -> None:
    """Along one ratio of gains it is the same; with the lowest the arm falls, which is nothing to it."""
    (low, start), (high, _) = _loaded(1e5, base), _loaded(1e6, base)
    assert high.value(start) == pytest.approx(low.value(start), rel=1e-9)
    ends = [climbed(program, start) for program in (low, high)]
    assert all(end is not None and end.holds for end in ends)
    values = [end.value for end in ends if end is not None]
    assert values[1] == pytest.approx(values[0], rel=1e-6)
    assert values[0] > 1.1 * low.value(start)


@pytest.mark.parametrize("below", [0.02, 1.0, 4.0])
def test_slopes_below_what_a_loop_bears_that_grows_with_its_present_gains(below: float) -> None:
    """There every member is asked for its own border alone, and keeps a level below whatever it does at that."""
    program, start = _loaded(1e6, -0.3)
    level = program.level(program.value(start)) - below
    found = program.branches(start, level)
    assert found.values[0] == pytest.approx(below, rel=1e-9)
    assert found.by_level[0] == -1.0
    _slopes_are_differences(program, start, level)


def test_a_loop_that_grows_keeps_an_allowed_gain_below_its_own() -> None:
    asked: dict[str, Any] = {
        "gravity": True, "objective": "allowance", "loop": {"kp": 1e6, "kv": 1e5, "rate": 200.0}, "starts": 3,
    }  # fmt: skip
    free = flexopt.select(EXCAVATOR, (0.22364, 1.53065), **asked)
    found = flexopt.select(EXCAVATOR, (0.22364, 1.53065), **asked, constraints={"outcome": {"allowed_gain": 60.0}})
    (lowest, _), *_ = free.best.evaluation.outcome.gain_intervals
    assert lowest > 60.0
    assert found.best.objective == pytest.approx(free.best.objective, rel=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("kp", [354.0, 2953.0])
def test_an_optimum_is_verified_from_present_gains_far_below_it(kp: float) -> None:
    """More than three decades, or less: beside it another border, a decade below, takes over."""
    loop = {"kp": kp, "kv": kp * 0.032304028917348765, "dead_time": 0.005, "rate": 100.0}
    found = flexopt.select(
        EXCAVATOR, (0.0, 0.846580127037903), objective="allowed_gain", loop=loop, starts=8, base_range=(2.0, 2.5)
    )
    assert isinstance(found, OutcomeSelection)
    assert found.unverified is None
    # The value that both came to, one of them 3.4 decades above its gains; the border beside is at 5.8e4.
    assert found.best.objective == pytest.approx(885952.0, rel=1e-6)


@pytest.mark.parametrize("least", [60.0, 500.0])
def test_a_loop_that_decays_keeps_an_allowed_gain_below_its_own(least: float) -> None:
    """Whatever it does there: under its weight it grows with gains below 120."""
    asked: dict[str, Any] = {
        "gravity": True, "objective": "decay", "loop": {"kp": 725.0, "kv": 72.5, "rate": 200.0}, "starts": 3,
    }  # fmt: skip
    target = (0.22364, 1.53065)
    free = flexopt.select(EXCAVATOR, target, **asked)
    found = flexopt.select(EXCAVATOR, target, **asked, constraints={"outcome": {"allowed_gain": least}})
    assert isinstance(free, OutcomeSelection)
    assert isinstance(found, OutcomeSelection)
    assert free.best.evaluation.outcome.gain_intervals[0][0] > 100.0
    assert found.unverified is None
    assert found.best.objective == pytest.approx(free.best.objective, rel=1e-6)


@pytest.mark.long
def test_the_worst_over_a_soil_is_no_better_anywhere_in_it() -> None:
    ranges = {"stiffness": (0.7, 1.5)}
    found = flexopt.select(EXCAVATOR, TARGET, objective="allowance", loop=LATE, ranges=ranges, starts=6)
    e = found.best.evaluation
    springs = [parameter.name for parameter in EXCAVATOR.parameters if "stiffness" in parameter.name]
    own = {parameter.name: parameter.value for parameter in EXCAVATOR.parameters}
    for factor in (0.7, 1.0, 1.5):
        soil = with_parameters(EXCAVATOR, {name: own[name] * factor for name in springs})
        value = float(np.min(flexopt.outcome(soil, e.posture, base=e.base, loop=LATE).allowance))
        assert value >= found.best.objective * (1 - 1e-9)


@pytest.mark.long
@pytest.mark.usefixtures("_few")
def test_gains_are_chosen_for_the_largest_dead_time() -> None:
    loop = {"kp_range": (1e3, 1e5), "kv_range": (1e2, 1e4)}
    found = flexopt.select(EXCAVATOR, TARGET, objective="delay_margin", loop=loop, base=0.5, starts=1)
    assert isinstance(found, OutcomeSelection)
    e, (gains, *_) = found.best.evaluation, found.gains
    again = flexopt.outcome(EXCAVATOR, e.posture, base=e.base, loop=gains)
    assert again.delay_margin == pytest.approx(found.best.objective, rel=1e-6)
    for name, (low, high) in (("kp", loop["kp_range"]), ("kv", loop["kv_range"])):
        for other in (0.8 * gains[name], 1.25 * gains[name]):
            if low <= other <= high:
                beside = flexopt.outcome(EXCAVATOR, e.posture, base=e.base, loop=gains | {name: other})
                assert not beside.delay_margin > found.best.objective * (1 + 1e-6)


def test_what_a_measure_cannot_be_had_of() -> None:
    for name, options, sentence in (
        ("allowed_gain", {"loop": {"kp": 0.0, "kv": 1e3}}, "asks for the largest Kp"),
        ("allowance", {"loop": {"kp_range": (1.0, 1e5)}}, "does not depend on"),
        ("radius", {"loop": LATE, "ranges": {"dead_time": (0.0, 0.01)}}, "must be factors"),
    ):
        with pytest.raises(flexopt.InputError, match=sentence):
            flexopt.select(EXCAVATOR, TARGET, objective=name, **options)
    with pytest.raises(flexopt.InputError, match="asks for the largest Kp") as refused:
        flexopt.select(EXCAVATOR, TARGET, loop={"kp": 0.0, "kv": 1e3}, constraints={"outcome": {"allowed_gain": 1e3}})
    # There it is a constraint, and w1 the objective.
    assert "objective" not in str(refused.value)
    with pytest.raises(flexopt.NoSolutionFound, match="every loop grows"):
        flexopt.select(EXCAVATOR, TARGET, objective="delay_margin", loop={"kp": 1e9, "kv": 1e9, "dead_time": 0.05})


@pytest.mark.long
def test_several_factors_have_one_radius() -> None:
    each = tuple(Uncertainty(of=(name,), factor=(0.5, 2.0)) for name in ("base.stiffness.y", "base.stiffness.rotation"))
    given = Loop(control="inverse", **LOOPS["radius"])
    settings = loop_settings(EXCAVATOR, given, flexopt.evaluate(EXCAVATOR, POSTURE))
    loop = UncertainLoop(settings, np.zeros(1), np.array(POSTURE), False, UncertaintyBox(EXCAVATOR, each, 0.01))
    found = MEASURES["radius"].value(loop, loop.outcome())
    region = flexopt.stable_region(EXCAVATOR, POSTURE, loop=LOOPS["radius"], ranges=each, boxes=0)
    assert found == pytest.approx(region.radius, rel=3e-3)


@pytest.mark.long
def test_least_outcomes_bind_where_they_must() -> None:
    """The best V without them decays less; with them it is kept to the bound, and no better place of a scan keeps it."""
    free = flexopt.select(EXCAVATOR, TARGET, objective="V", weights=[1.0, 0.3, 0.3])
    least = {"decay": 0.01, "delay_margin": 0.002}
    found = flexopt.select(
        EXCAVATOR, TARGET, objective="V", weights=[1.0, 0.3, 0.3], loop=LATE, constraints={"outcome": least}
    )
    assert isinstance(found, OutcomeSelection)
    assert found.best.objective < free.best.objective
    e = found.best.evaluation
    assert e.outcome.decay == pytest.approx(0.01, rel=1e-5)
    assert found.best.constraints["decay"].value == pytest.approx(e.outcome.decay)
    assert found.best.constraints["delay_margin"].value >= 0.002
    assert found.measure == "V"
    best, alpha, measures = -math.inf, np.array([1.0, 0.3, 0.3]), flexopt.build_measures(EXCAVATOR)
    for x, elbow in itertools.product(np.linspace(-3.3, 3.3, 51).tolist(), ("up", "down")):
        posture = posture_at(x, elbow)
        if posture is None:
            continue
        value = float(alpha @ flexopt.evaluate_w(measures, np.array([[x]]), np.array(posture)[:, None]).w[:, 0])
        if value > best and told("decay", x, posture, LATE) >= 0.01:
            best = value
    assert found.best.objective >= best - 1e-12


@pytest.mark.long
def test_least_outcomes_are_lifted_to_and_refused() -> None:
    high = flexopt.select(
        EXCAVATOR, TARGET, objective="allowance", loop=LATE, constraints={"outcome": {"decay": 0.09}}, starts=24
    )
    # Of 1,500 points one in a thousand decays as fast; the others climb there.
    assert high.best.constraints["decay"].value >= 0.09 * (1 - 2e-6)
    with pytest.raises(flexopt.NoSolutionFound, match="must do, decay at least 5"):
        flexopt.select(EXCAVATOR, TARGET, loop=LATE, constraints={"outcome": {"decay": 5.0}}, starts=4)
    for options, sentence in (
        ({"objective": "w1,epsilon_max", "loop": LATE}, "beside the constraint outcome"),
        ({"objective": "decay", "loop": LATE, "ranges": {"dead_time": (0.0, 0.01)}}, "do not go with a least radius"),
    ):
        with pytest.raises(flexopt.InputError, match=sentence):
            flexopt.select(EXCAVATOR, TARGET, constraints={"outcome": {"radius": 1.5}}, **options)  # type: ignore[arg-type]
    with pytest.raises(flexopt.InputError, match="it wants a loop"):
        flexopt.build_selection(EXCAVATOR, TARGET, constraints={"outcome": {"decay": 0.1}})


@pytest.mark.long
def test_with_a_load_that_is_not_known_no_place_of_a_scan_bears_more_gain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each by decays of many gains, the arm where feedback holds it with each; with low ones it falls."""
    monkeypatch.setattr(type(MEASURES["allowed_gain"]), "looked", 40)
    monkeypatch.setattr(type(MEASURES["allowed_gain"]), "stages", ((8, 4), (3, 8)))
    gains, ranges = {"kp": 1e5, "kv": 2e4}, {"payload.mass": (0.0, 900.0)}
    machine = with_parameters(EXCAVATOR, {"payload.mass": 450.0})
    found = flexopt.select(
        machine, (2.2, 0.4), objective="allowed_gain", loop=gains, ranges=ranges, gravity=True, starts=2
    )
    assert isinstance(found, OutcomeSelection)
    assert found.unverified is None
    factors = np.geomspace(1.0, 100.0, 161)

    def bears(x: float, posture: np.ndarray) -> float:
        """The first of the gains with which a load lets it grow."""
        stand = flexopt.evaluate(machine, posture, base=x, gravity=True)
        settings = loop_settings(machine, Loop(control="inverse", **gains), stand)
        box = UncertaintyBox(machine, (Uncertainty(of="payload.mass", value=(0.0, 900.0)),), settings.dead_time)
        loop = UncertainLoop(settings, stand.base, stand.posture, True, box)
        decays = loop.decays(np.linspace(0.0, 1.0, 5)[:, None], factors).reshape(len(factors), -1).min(axis=1)
        grows = np.flatnonzero(~(decays > 0))
        return gains["kp"] * (factors[max(grows[0] - 1, 0)] * (grows[0] > 0) if grows.size else factors[-1])

    best = found.best.evaluation
    told = bears(float(best.base[0]), best.posture)
    step = factors[1] / factors[0]
    assert told <= found.best.objective * (1 + 1e-9) <= told * step * (1 + 1e-6)
    problem = flexopt.build_selection(machine, (2.2, 0.4), gravity=True)
    seen = [
        bears(float(problem.scan.base[0, k]), problem.scan.posture[:, k])
        for k in np.flatnonzero(problem.scan.violation <= FEASIBLE)[::40].tolist()
    ]
    assert len(seen) > 20
    assert max(seen) <= found.best.objective * (1 + 1e-9)
