"""From checked options to numbers: the structure of the loop, its constants, its start, its signals.

In: a machine and `SimulationOptions`. Out: a `Scenario` that the runs and the linear analysis share.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, cast

import casadi as ca
import numpy as np

from flexopt.errors import InputError, raise_if_any
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Vector
from flexopt.foundation.boundary import Keywords
from flexopt.foundation.control import Control, control_damping, control_method
from flexopt.foundation.kept import by_machine, by_structure
from flexopt.loop.closed import ClosedLoop, closed_loop
from flexopt.loop.levers import with_servo_gain
from flexopt.loop.rest import design_constants, placed, state_at_rest
from flexopt.loop.robust import robust_law
from flexopt.loop.settings import LoopSettings
from flexopt.loop.structure import JACOBIAN_DAMPING, MODEL, LoopStructure
from flexopt.model import AnyMachine
from flexopt.model.file_model import read_table, validated
from flexopt.model.plausibility import warn_weightless
from flexopt.model.simulation import (
    PART_OF_SAMPLE,
    Path,
    SimulationKeywords,
    SimulationOptions,
    dead_time,
    placement_of,
    taken_early,
)
from flexopt.model.simulation_faults import simulation_faults
from flexopt.plant import build_plant, inverse_kinematics
from flexopt.plant.machine_motion import constant_values, constants_at, motion_of
from flexopt.plant.motion import Motion
from flexopt.plant.singularity import check_regular
from flexopt.plant.statics import check_held, check_settled
from flexopt.simulation.base_path import driven_structure, moved, path_faults
from flexopt.simulation.behaviour import STILL, Grounds
from flexopt.simulation.stepping import Fastest, Stepping, stepping

OFFSET = 0.05  # rad or m


@dataclass(frozen=True)
class Scenario:
    """A loop ready to run.

    Attributes:
        machine, options: what was asked for.
        loop: its graphs.
        posture, base: design configuration.
        p: parameters of the machine that moves, (n_par,); of an ensemble's member its own.
        q_design: all coordinates at equilibrium, (n_q,).
        target: end-point there, (n_task,), m.
        offset: of the joints at the start, (n,), rad or m.
        frequencies_hz, modes: undamped modes with the joints held by nothing, ascending, (m,) and (n_q, m).
        parts: constants by name, for `ClosedLoop.constants`.
        start: states x (n_x,).
        period: of a sample, s.
        samples: how many.
        exact: whether it is there to be linearised and advanced exactly, not to be integrated.
    """

    machine: AnyMachine
    options: SimulationOptions
    loop: ClosedLoop
    posture: Vector
    base: Vector
    p: Vector
    q_design: Vector
    target: Vector
    offset: Vector
    frequencies_hz: Vector
    modes: Vector
    parts: Mapping[str, Any]
    start: Vector
    period: float
    samples: int
    exact: bool = False

    @cached_property
    def constants(self) -> Vector:
        """Constants c (n_c,)."""
        return self.loop.constants.packed(self.parts)[:, 0]

    @property
    def longest_step(self) -> float:
        """Of the integration steps in a sample, s."""
        structure, early = self.loop.structure, np.max(self.parts["early"])
        if not structure.after:
            return float(self.parts["h"])
        return float(max((self.period - early) / (structure.substeps - structure.after), early / structure.after))

    @property
    def resting(self) -> Vector:
        """States x (n_x,) at rest in the design configuration."""
        x: Vector = start_states(self.machine, self.loop, self.parts, self.q_design[:, None])[:, 0]
        return x

    @property
    def times(self) -> Vector:
        """Instants of the samples and the end, (samples + 1,), s."""
        times: Vector = np.arange(self.samples + 1, dtype=np.float64) * self.period
        return times

    def along(self, name: str, path: Path, times: Vector) -> Vector:
        """Points of a path as the loop takes them, from where the base stands at first."""
        points = path.at(times)
        if name == "target":
            return points - _place(self.loop.shape, self.base)
        return moved(self.loop.shape, points, self.base)

    @property
    def still(self) -> Vector:
        """Energy of each mode (m,), J, where every coordinate is off by what counts as rounding."""
        projection = np.reshape(self.parts["modes"], (len(self.frequencies_hz), -1), order="F")
        return 0.5 * self.parts["omega_squared"] * (STILL * np.sum(np.abs(projection), axis=1)) ** 2

    @property
    def grounds(self) -> Grounds:
        """On which runs of it are judged."""
        paths = [path for path in (self.options.base_path, self.options.target_path) if path is not None]
        return Grounds(
            slowest_hz=float(self.frequencies_hz[0]),
            turns=bool(self.loop.shape.base_hinges),
            still=self.still,
            undisturbed_from=max((path.times[-1] for path in paths), default=0.0),
            noisy=self.loop.structure.noisy,
            bends=self.loop.structure.bends,
        )

    def signals(self, rng: np.random.Generator | None = None) -> Vector | None:
        """Signals e (samples, n_e) that is not constant, noise drawn from `rng`; None where there is none."""
        layout, options = self.loop.signals, self.options
        if not layout.total:
            return None
        columns: dict[str, Vector] = {}
        for name, path in (("base", options.base_path), ("target", options.target_path)):
            if path is not None:
                points = self.along(name, path, self.times)
                columns |= {name: points[:-1], f"{name}_rate": np.diff(points, axis=0) / self.period}
        if "noise" in layout.sizes:
            generator = rng or np.random.default_rng(options.seed)
            rows = self.loop.structure.n_task
            size = np.repeat([options.sensor.noise, options.sensor.rate_noise], rows)
            columns["noise"] = generator.standard_normal((self.samples, 2 * rows)) * size
        return np.concatenate([columns[name] for name in layout.sizes], axis=1)


def _place(motion: Motion, base: Vector) -> Vector:
    """What a placement adds to the end-point, (n_task,), m."""
    return ca.evalf(placed(motion, ca.SX(base))).full().ravel()


# Options of a loop as keywords; `checked_options` checks them together.
SIMULATED = Keywords(SimulationOptions, SimulationKeywords, together=True)


def given_options(given: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of a call that are options of a loop."""
    return {name: value for name, value in given.items() if name in SimulationOptions.model_fields}


def note_options(arguments: Arguments, given: Mapping[str, Any]) -> None:
    """Note the faults of a call's options of a loop."""
    arguments.collect("", lambda: checked_options(arguments.call, arguments.of, given_options(given)))


def checked_options(call: str, machine: AnyMachine | None, given: Mapping[str, Any]) -> SimulationOptions:
    """Options of a call, or one error with every fault; without a machine, with those that need none."""
    table = {name: value for name, value in given.items() if value is not None}
    options = validated(SimulationOptions, read_table(table, call, "[simulation]", InputError), call, kind=InputError)
    if machine is not None:
        raise_if_any(InputError, call, simulation_faults(options, machine) + path_faults(machine, options))
    return options


def build_scenario(
    machine: AnyMachine,
    options: SimulationOptions,
    zeros: frozenset[str] | None = None,
    *,
    watched: bool = False,
    exact: bool = False,
    settings: LoopSettings | None = None,
    delays: Vector | None = None,
) -> Scenario:
    """The scenario of checked options.

    Args:
        machine: from `flexopt.load`.
        options: checked.
        zeros: constants that are zero for all machines of an ensemble, whose controllers then keep this machine's
            numbers; None for this machine alone.
        watched: whether steps give what is judged.
        exact: whether it is there to be linearised and advanced exactly: no step is then too long.
        settings: of a real loop, whose drives may brake their joints, within the machine's damping.
        delays: of the members of an ensemble, as many samples begun as the options', s; by default all as these.

    Raises:
        SingularPosture: Jv loses rank in the design posture.
        UnreachableTarget: no posture reaches `end_point`.
        InputError: the springs do not hold the machine; the step is too long for an explicit method.
        NoSolutionFound: the static deflection did not converge.
    """
    # Members of an ensemble may have gravity of their own.
    braking = 0.0 if settings is None else settings.braking
    warn_weightless(machine, asked=options.gravity and zeros is None)
    design = _design(machine, *design_configuration(machine, options), options.gravity, options.control)
    options = with_servo_gain(machine, options, design.posture)
    period = 1 / options.rate
    servo = 2 * math.pi * max(options.actuator.bandwidth_hz or (0.0,))
    fastest = Fastest(design.poles, 2 * math.pi * float(design.frequencies_hz[-1]), servo, design.damper)
    steps = Stepping(1) if exact else stepping(options, fastest)
    waits, early = dead_time(options)
    each = np.array([early]) if delays is None else taken_early(delays, waits, period)
    structure = replace(_structure(machine, options, steps), delay=waits)
    # Of whole samples alone the newest measurement is that of the sample's start.
    if not exact and waits and np.any((each > 0) & (each * options.rate < 1 - PART_OF_SAMPLE)):
        shares = steps.substeps * options.rate * np.array([period - each.min(), each.max()]) - PART_OF_SAMPLE
        before, after = (max(1, math.ceil(share)) for share in shares.tolist())
        structure = replace(structure, substeps=before + after, after=after)
    structure = replace(structure, watched=watched, method="rk4" if exact else structure.method, served=braking > 0)
    if zeros is not None:
        structure = replace(structure, motion=replace(structure.motion, zeros=zeros), own_model=True)
    parts: dict[str, Any] = dict(constant_values(machine))
    parts |= {f"{MODEL}{name}": value for name, value in parts.items()}
    shape = motion_of(structure.motion, {})
    n, rows = shape.n_joints, shape.n_task
    parts |= {
        "h": period / structure.substeps,
        "early": early,
        "target": design.target - _place(shape, design.base),
    }
    held = design_constants(shape, ca.SX(design.q[:-n]), ca.SX(design.base))
    parts |= {name: ca.evalf(value).full().ravel() for name, value in held.items()}
    parts |= {name: np.broadcast_to(getattr(options, name), rows) for name in ("kp", "kv", "ki")}
    parts |= {"servo_gain": options.actuator.servo_gain, "braking": [braking] * n}
    parts |= {"integral_limit": options.integral_limit, "nullspace_damping": options.nullspace_damping}
    parts |= {JACOBIAN_DAMPING: control_damping(options.control) or 0.0}
    parts |= {"resolution": [options.sensor.resolution] * rows}
    parts |= {"rate_resolution": [options.sensor.rate_resolution] * rows}
    parts |= {"filter": 2 * math.pi * (options.sensor.filter_hz or 0.0)}
    actuator = options.actuator
    for name, value in (
        ("torque_limit", actuator.torque_limit),
        ("dead_band", actuator.dead_band),
        ("rate_limit", actuator.rate_limit),
        ("bandwidth", actuator.bandwidth_hz and [2 * math.pi * hz for hz in actuator.bandwidth_hz]),
    ):
        if value is not None:
            parts[name] = np.broadcast_to(value, n)
    if options.feedback == "robust":
        law = robust_law(
            machine, tuple(design.posture), tuple(design.base), options.control, options.gravity, options.gain,
            period if options.hold else 0.0,
        )  # fmt: skip
        structure = replace(structure, order=law.n_states)
        parts |= {name: getattr(law, name).ravel(order="F") for name in "ABCD"}
    loop = closed_loop(structure)
    parts |= _modal(loop, machine, design, parts)
    offset = default_offset(n) if options.offset is None else np.array(options.offset)
    q_start = np.concatenate([design.q[:-n], design.q[-n:] + offset])
    return Scenario(
        machine=machine,
        options=options,
        loop=loop,
        posture=design.posture,
        base=design.base,
        p=build_plant(machine).parameter_values.full().ravel(),
        q_design=design.q,
        target=design.target,
        offset=offset,
        frequencies_hz=design.frequencies_hz,
        modes=design.modes,
        parts=parts,
        start=start_states(machine, loop, parts, q_start[:, None])[:, 0],
        period=period,
        samples=max(1, round(options.duration * options.rate)),
        exact=exact,
    )


def _modal(loop: ClosedLoop, machine: AnyMachine, design: _Design, parts: Mapping[str, Any]) -> dict[str, Any]:
    """What projects states on the flexible modes: Φᵀ M in the coordinates u, and ω²."""
    plant = build_plant(machine)
    mass = plant.mass(design.q, design.base, plant.parameter_values).full()
    projection = design.modes.T @ mass @ loop.to_q
    omega = 2 * np.pi * design.frequencies_hz
    return {
        "u_design": start_states(machine, loop, parts, design.q[:, None])[loop.states.slices["u"], 0],
        "modes": projection.ravel(order="F"),
        "omega_squared": omega**2,
    }


@dataclass(frozen=True)
class _Design:
    """The configuration about which the controller works."""

    posture: Vector
    base: Vector
    q: Vector
    target: Vector
    frequencies_hz: Vector
    modes: Vector
    poles: Vector
    damper: float


@by_machine
def _reaching(
    machine: AnyMachine, end_point: tuple[float, ...], elbow: Any, base: tuple[float, ...], gravity: bool
) -> tuple[float, ...]:
    elbow = elbow or ("up" if build_plant(machine).closed_form else None)
    return tuple(inverse_kinematics(machine, end_point, base=base, gravity=gravity, elbow=elbow)[0])


def design_configuration(
    machine: AnyMachine, options: SimulationOptions
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Posture (n,) and base (n_b,) about which a run works."""
    base, end_point = placement_of(options, machine), options.end_point
    if end_point is None:
        return cast("tuple[float, ...]", options.posture), base
    return _reaching(machine, end_point, options.elbow, base, options.gravity), base


@by_machine
def _design(
    machine: AnyMachine, posture: tuple[float, ...], base: tuple[float, ...], gravity: bool, control: Control
) -> _Design:
    plant, angles, placement = build_plant(machine), np.array(posture), np.array(base)
    p, m = plant.parameter_values, plant.n_passive
    q = plant.rest(placement, angles, p).full().ravel()
    check_regular(plant, q, placement, control)
    stiffness = plant.stiffness(p).full()
    if gravity:
        q[:m] = plant.deflected(placement, angles, p).full().ravel()
        check_settled(plant, q, placement)
        stiffness = check_held(plant, q, placement)
    mass: Vector = plant.mass.call([q, placement, p])[0].full()
    frequencies, modes = _flexible_modes(stiffness, mass, m)
    target = plant.end_point.call([q, placement, p])[0].full().ravel()
    dampers: Vector = plant.damping(p).full()
    damper = float(np.abs(np.linalg.eigvals(np.linalg.solve(mass, dampers))).max())
    motion = np.block(
        [[np.zeros_like(mass), np.eye(len(mass))], [-np.linalg.solve(mass, np.hstack([stiffness, dampers]))]]
    )
    return _Design(angles, placement, q, target, frequencies, modes, np.linalg.eigvals(motion).astype(complex), damper)


def _flexible_modes(stiffness: Vector, mass: Vector, m: int) -> tuple[Vector, Vector]:
    """The m flexible frequencies, Hz, ascending, and mass-normalised modes (n_q, m)."""
    root = np.linalg.cholesky(mass)
    inverse = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(inverse @ stiffness @ inverse.T)
    frequencies: Vector = np.sqrt(np.maximum(values[-m:], 0.0)) / (2 * math.pi)
    modes: Vector = np.asarray(inverse.T @ vectors[:, -m:], dtype=np.float64)
    return frequencies, modes


def _structure(machine: AnyMachine, options: SimulationOptions, steps: Stepping) -> LoopStructure:
    sensor, actuator = options.sensor, options.actuator
    laws: dict[str, Any] = {"robust": "state_space"}
    return LoopStructure(
        motion=driven_structure(machine, options),
        control=control_method(options.control),
        law=laws.get(options.feedback, options.feedback),
        sampled=options.hold,
        method=options.integrator,
        substeps=steps.substeps,
        iterations=steps.iterations,
        damped=steps.damped,
        stiff=steps.stiff,
        gravity=options.gravity,
        compensated=options.gravity and options.gravity_compensation,
        quantised=bool(sensor.resolution or sensor.rate_resolution),
        noisy=bool(sensor.noise or sensor.rate_noise),
        filtered=sensor.filter_hz is not None,
        limited=actuator.torque_limit is not None,
        lagging=actuator.bandwidth_hz is not None,
        rate_limited=actuator.rate_limit is not None,
        dead_band=actuator.dead_band is not None,
        nullspace_damped=options.nullspace_damping > 0,
        levers=actuator.levers,
        hydraulic=None if actuator.levers is None else machine,
        moving_base=options.base_path is not None,
        moving_target=options.target_path is not None,
    )


def default_offset(n: int) -> Vector:
    """The displacement of the joints (n,) at the start where none is given: ±0.05 rad or m in turn."""
    return np.array([OFFSET if k % 2 == 0 else -OFFSET for k in range(n)])


def start_states(
    machine: AnyMachine, loop: ClosedLoop, parts: Mapping[str, Any], q: Vector, p: Vector | None = None
) -> Vector:
    """States x (n_x, N) at rest in configurations q (n_q, N); p (n_par, N): None of the machine itself."""
    function = _at_rest(machine, loop.structure)
    numbers = build_plant(machine).parameter_values if p is None else p
    x: Vector = function(q, np.atleast_1d(parts["base"]), numbers).full()
    return x


@by_structure
def _at_rest(machine: AnyMachine, structure: LoopStructure) -> ca.Function:
    """The state at rest. Inputs q, base, p; output x."""
    plant = build_plant(machine)
    q, base, p = (ca.SX.sym(name, n) for name, n in (("q", plant.n_coordinates), ("base", plant.n_base),
                  ("p", len(plant.parameter_names))))  # fmt: skip
    motion = motion_of(structure.motion, constants_at(machine, p))
    x = state_at_rest(closed_loop(structure), plant, motion, q, base, p)
    return ca.Function("at_rest", [q, base, p], [ca.densify(x)], ["q", "base", "p"], ["x"], {"cse": True})
