"""The sampled loop linearised about its equilibrium: multipliers, growth rate, gains between which it is stable.

In: the same options as `simulate`, and the same graphs. Between the samples the linear plant is advanced exactly,
unless an integrator is asked for: integrators damp fast modes by themselves. Out: eigenvalues, with what no feedback
holds (the self-motion of a redundant arm: an undriven eigenvalue 1) taken out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Unpack

import casadi as ca
import numpy as np

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import PostureLike, Vector
from flexopt.foundation.boundary import Keywords, number, public
from flexopt.foundation.control import Control
from flexopt.foundation.kept import by_structure
from flexopt.foundation.results import Result
from flexopt.loop.borders import HIGH, LOW, stable_intervals
from flexopt.loop.closed import closed_loop
from flexopt.loop.gains import rigid_gains_at
from flexopt.loop.outcome import UNDAMPED, LoopPoint
from flexopt.loop.rest import resting_rows
from flexopt.loop.small_motions import SmallMotions
from flexopt.loop.spectrum import EXACT, OwnMotion, SampledLoop, neutral_directions, spectrum
from flexopt.loop.structure import LoopStructure
from flexopt.loop.tangent import SelfMotion, Tangent, still, tangent
from flexopt.model import AnyMachine
from flexopt.model.simulation import LinearKeywords, SimulationOptions
from flexopt.plant import build_plant
from flexopt.simulation.scenario import Scenario, build_scenario, checked_options, given_options, start_states


@dataclass(frozen=True)
class StabilityBorder(Result):
    """Intervals of the gain Kp in which the sampled linear loop is stable, Kv as it stands.

    Attributes:
        intervals: (lower, upper) of Kp, in its unit; the ends of the search where it did not meet a border. Nothing is
            said of gains beyond these.
        searched: (lower, upper) of the search.
        kv: the other gain, one for each task row where these differ, or its ratio to Kp where that was held, s.
        ratio: whether Kv / Kp was held instead of Kv.
    """

    intervals: tuple[tuple[float, float], ...]
    searched: tuple[float, float]
    kv: float | tuple[float, ...]
    ratio: bool

    DOCUMENT = "intervals searched kv ratio largest"

    @property
    def largest(self) -> float | None:
        """The largest Kp of the lowest interval; None where no gain that was searched is stable."""
        return self.intervals[0][1] if self.intervals else None


def _note(arguments: Arguments, given: Mapping[str, Any]) -> None:
    arguments.collect("", lambda: linear_options(arguments.of, given_options(given), arguments.call))


_LINEAR = Keywords(SimulationOptions, LinearKeywords, together=True)


@public(together=_note, keywords=_LINEAR)
def sampled_loop(
    machine: AnyMachine,
    posture: PostureLike | None = None,
    *,
    options: SimulationOptions | None = None,  # noqa: ARG001 - its fields come as keywords
    **keywords: Unpack[LinearKeywords],
) -> SampledLoop:
    """Multipliers of the loop that `simulate` runs with the same options, at its equilibrium.

    Of the options that are given alone: the machine's own `[loop]` is not taken. What that does is `flexopt.outcome`.

    Between the samples x(t + h) = e^{Ah} x(t) + ∫₀ʰ e^{As} ds B τ, exactly. Limits, dead bands and rounding of
    measurements are left out: they do not exist for vanishing motions. Paths are left out: the base stands, and the
    target.

    Args:
        machine, posture, options, keywords: as for `flexopt.simulate`, but `integrator`: `"exact"` (default), or a
            method whose own error is then part of the loop (`"rk4"` is the article's; at 5 ms it damps modes of 13 Hz
            and more).

    Raises:
        InputError: as `simulate`; or the design posture is no equilibrium (weight without compensation).

    Example:
        >>> machine = flexopt.load("excavator")
        >>> loop = flexopt.sampled_loop(machine, (0.0448, -2.0499), kp=1e4, kv=1e3)
        >>> loop.growth_rate < 0
        True
    """
    return linearised(linear_scenario(machine, {"posture": posture} | keywords, "sampled_loop"))


@public(together=_note, ratio=number("s", low=0.0, high=1e9), keywords=_LINEAR)
def stability_border(
    machine: AnyMachine,
    posture: PostureLike | None = None,
    *,
    ratio: float | None = None,
    options: SimulationOptions | None = None,  # noqa: ARG001 - its fields come as keywords
    **keywords: Unpack[LinearKeywords],
) -> StabilityBorder:
    """Gains Kp for which the sampled linear loop is stable, from 10⁻⁴ to 10⁴ times one that the machine may have.

    Of the options that are given alone: the machine's own `[loop]` is not taken. What that bears is
    `flexopt.outcome(…).gain_intervals`.

    Args:
        machine, posture, options, keywords: as for `flexopt.sampled_loop`; `kp`, its first where rows differ, is the
            one about which is searched. By default that is one as heavy as the machine in the posture: a corner at 0.3
            of its lowest mode, and at most 0.25 rad in a sample.
        ratio: hold Kv = ratio · Kp (s) instead of Kv.

    Raises:
        InputError: as `sampled_loop`; the feedback has no Kp.

    Example:
        >>> machine = flexopt.load("excavator")
        >>> border = flexopt.stability_border(machine, (0.0448, -2.0499), kv=2e3)
        >>> round(float(border.intervals[0][1]), -4)  # N m
        800000.0
    """
    scenario = linear_scenario(machine, {"posture": posture} | keywords, "stability_border")
    feedback = scenario.options.feedback
    if feedback not in ("pd", "pid"):
        fault = Fault("feedback", "has no gain Kp whose border could be looked for; pd and pid have", repr(feedback))
        raise_if_any(InputError, "stability_border", [fault])
    kv, rows, middle = scenario.options.kv, scenario.loop.structure.n_task, _middle_kp(scenario)

    def growth(exponent: float) -> float:
        kp = middle * 10.0**exponent
        parts = {"kp": np.full(rows, kp), "kv": np.broadcast_to(kv if ratio is None else ratio * kp, rows)}
        return linearised(replace(scenario, parts={**scenario.parts, **parts})).growth_rate

    found = stable_intervals(growth, UNDAMPED / scenario.period)
    intervals = tuple((middle * lower, middle * upper) for lower, upper in found)
    searched = middle * 10**LOW, middle * 10**HIGH
    held = kv[0] if len(set(kv)) == 1 else kv
    return StabilityBorder(intervals, searched, held if ratio is None else ratio, ratio is not None)


def _middle_kp(scenario: Scenario) -> float:
    """About which a border is searched: what is given, else what suits the arm's masses."""
    s = scenario
    given = [kp for kp in s.options.kp if kp > 0 and "kp" in s.options.model_fields_set]
    return (
        given[0]
        if given
        else rigid_gains_at(
            s.machine, s.q_design, s.base, s.options.control, float(s.frequencies_hz.min()), s.options.rate
        )["kp"]
    )


def linearised(scenario: Scenario) -> SampledLoop:
    """The sampled linear loop of a scenario made by `linear_scenario`."""
    s, structure = scenario, scenario.loop.structure
    x, e, c = s.resting, np.zeros(s.loop.signals.total), s.constants
    here = tangent(structure, x, e, c)
    if not still(structure, here, x):
        moved = float(np.abs(here.moved).max())
        raise InputError(
            "the design posture is no equilibrium: the weight acts and the command does not carry it "
            f"(the states move by {moved:.2g} in one sample); give gravity_compensation = True"
        )
    return loop_about(s, x, e, here)


def loop_about(scenario: Scenario, x: Vector, e: Vector, here: Tangent) -> SampledLoop:
    """The loop about a state of rest x, advanced exactly, or as the scenario's integrator does."""
    s = scenario
    if s.exact:
        return _spectrum(s, x, here.sample(s.period, float(np.ravel(s.parts["early"])[0])), EXACT)
    derivative = _derivative(s.loop.structure).call([x, e, s.constants])[0]
    return _spectrum(s, x, np.array(derivative), s.options.integrator)


def _spectrum(scenario: Scenario, x: Vector, matrix: Vector, integrator: str) -> SampledLoop:
    """With the self-motion of the posture in which the loop rests: under weight that may be another than by design."""
    s = scenario
    most = neutral_directions(s.loop.structure, s.loop.shape.n_joints, s.parts.get("kp"), s.parts.get("ki"))
    excess = s.loop.shape.n_joints - s.loop.shape.n_task
    plant, q = build_plant(s.machine), coordinates(s, x)

    def own() -> OwnMotion:
        found = OwnMotion.at(plant, q, s.base, s.p, s.loop.to_q)
        if s.options.gravity:
            m, file = plant.n_passive, plant.parameter_values if s.loop.structure.own_model else s.p
            gains = (s.parts.get(name, np.zeros(plant.n_task)) for name in ("kp", "ki"))
            at = [q, s.base, s.q_design[:m], file, s.p, *gains]
            found = found.creeping_along(_resting_rows(s.machine, s.options.control).call(at)[0].full())
        return found

    return spectrum(matrix, s.period, most, excess, own, integrator)


@by_structure
def _resting_rows(machine: AnyMachine, control: Control) -> ca.Function:
    return resting_rows(build_plant(machine), control)


def coordinates(scenario: Scenario, x: Vector, p: Vector | None = None) -> Vector:
    """All coordinates (n_q,) in a state; p (n_par,) of the machine that moves, None: of the scenario."""
    s = scenario
    own = (s.p if p is None else p)[:, None]
    design = start_states(s.machine, s.loop, s.parts, s.q_design[:, None], own)[:, 0]
    return s.q_design + s.loop.to_q @ (x - design)[: s.loop.shape.n]


def self_motion(scenario: Scenario, x: Vector) -> SelfMotion | None:
    """Of an arm with more joints than task rows whose weight acts, as it stands in a state x; else None.

    Commands act on the joints as torques, so that a brake is a command, too; a continuous law has none.
    """
    s, plant = scenario, build_plant(scenario.machine)
    if s.loop.shape.n_joints <= s.loop.shape.n_task or not (s.options.gravity and s.loop.structure.sampled):
        return None
    m = plant.n_passive

    def along(there: Vector) -> Vector:
        # As the controller takes the arm, on the base that its design has.
        taken = np.append(s.q_design[:m], coordinates(s, there)[m:])
        return OwnMotion.at(plant, taken, s.base, plant.parameter_values, s.loop.to_q).directions[m:]

    held = along(x).T @ s.loop.to_q[m:]
    return SelfMotion(np.hstack([held, np.zeros((len(held), len(x) - held.shape[1]))]), along)


def where_held(scenario: Scenario) -> Vector | None:
    """The state from which a loop's rest is found: where feedback holds the machine, None where it does so nowhere.

    Under a weight that the controller does not know that is far from its design, and of a redundant arm one of a
    family: `flexopt.loop.rest` follows it, so that runs are judged beside the loop that outcomes tell of. An integral
    with Ki = 0, which carries nothing, is none.
    """
    s, structure = scenario, scenario.loop.structure
    known = not (s.options.gravity and structure.own_model and structure.compensated)
    if known or s.options.feedback not in ("pd", "pid"):
        return s.resting
    integral = s.options.feedback == "pid"
    motions = SmallMotions(s.machine, s.options.control, gravity=True, integral=integral, own_model=True)
    gains = {name: s.parts[name] for name in ("kp", "ki")[: 1 + integral]}
    at = {"base": s.base, "posture": s.posture, "p": s.p, "servo_gain": np.ones(1)}
    point = LoopPoint(motions, motions.numbers(at | gains), 0.0)
    if not point.rests:
        return None
    x: Vector = start_states(s.machine, s.loop, s.parts, point.configuration[:, None], s.p[:, None])[:, 0]
    return x


def linear_scenario(machine: AnyMachine, given: Mapping[str, Any], call: str) -> Scenario:
    """A scenario without what vanishing motions do not feel; exact where no integrator is asked for."""
    options, exact = linear_options(machine, given, call)
    return bare_scenario(machine, options, exact=exact)


def linear_options(machine: AnyMachine | None, given: Mapping[str, Any], call: str) -> tuple[SimulationOptions, bool]:
    """Checked options, and whether the loop is advanced exactly, in which there are no substeps."""
    method = given.get("integrator")
    exact = method is None or (isinstance(method, str) and method == EXACT)
    rest = {name: value for name, value in given.items() if not (exact and name == "integrator")}
    options = checked_options(call, machine, rest)
    return options.model_copy(update={"substeps": None}) if exact else options, exact


def bare_scenario(
    machine: AnyMachine,
    options: SimulationOptions,
    zeros: frozenset[str] | None = None,
    *,
    exact: bool = True,
    paths: bool = False,
    delays: Vector | None = None,
) -> Scenario:
    """The like of checked options; `zeros`, `delays` as of `build_scenario`; `paths`: base and target stay signals."""
    bare = {"torque_limit": None, "dead_band": None, "rate_limit": None, "levers": None}
    clean = {"noise": 0.0, "rate_noise": 0.0, "resolution": 0.0, "rate_resolution": 0.0}
    update: dict[str, Any] = {
        "actuator": options.actuator.model_copy(update=bare),
        "sensor": options.sensor.model_copy(update=clean),
        "baked": False,
    }
    update |= {} if paths else {"base_path": None, "target_path": None}
    return build_scenario(machine, options.model_copy(update=update), zeros, exact=exact, delays=delays)


@by_structure
def _derivative(structure: LoopStructure) -> ca.Function:
    """Φ = ∂x_{k+1}/∂x_k of an integrator's own step. Inputs x, e, c."""
    step = closed_loop(structure).step
    symbols = [ca.MX.sym(name, step.size1_in(name)) for name in step.name_in()]
    phi = ca.jacobian(step.call(symbols)[0], symbols[0])
    whole = ca.Function("derivative", symbols, [ca.densify(phi)], step.name_in(), ["phi"])
    return whole.expand() if step.is_a("SXFunction") else whole
