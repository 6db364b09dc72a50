"""The variables of an FMU, with units, descriptions, ranges and start values.

In: a `Scenario` and its run. Out: an `Interface`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from flexopt.export.context import parameter_range
from flexopt.export.control import RATE_MAX
from flexopt.model.quantities import ANGLE_MAX, COORDINATE_MAX
from flexopt.model.simulation import GAIN_MAX
from flexopt.plant import Plant, build_plant
from flexopt.plant.motion import Motion, full_structure
from flexopt.simulation.loop import ClosedLoop, closed_loop
from flexopt.simulation.scenario import Scenario
from flexopt.simulation.structure import N_TASK
from flexopt.simulation.trajectory import Trajectory

Kind = Literal["co-simulation", "model-exchange"]
KINDS: tuple[Kind, ...] = ("co-simulation", "model-exchange")
AXES = ("x", "y", "z")[:N_TASK]
TORQUE_MAX, NOISE_MAX = 1e12, 1e3
NOMINAL_MIN = 1e-6


@dataclass(frozen=True)
class Variable:
    """A real variable of an FMU.

    Attributes:
        name: structured.
        unit: SI, as `units.unit_of` reads it.
        text: what it is.
        start: of what the master sets.
        low, high: its allowed range.
        tunable: whether it may change during a run.
        nominal: of a state, its size.
    """

    name: str
    unit: str
    text: str
    start: float = 0.0
    low: float = -math.inf
    high: float = math.inf
    tunable: bool = False
    nominal: float = 1.0

    def __post_init__(self) -> None:
        # Names of links come from machine files; XML and FMI's flat names know no control characters.
        for field in ("name", "text"):
            value: str = getattr(self, field)
            object.__setattr__(self, field, printable(value))


@dataclass(frozen=True)
class Interface:
    """Variables of one FMU.

    The vector a of values is that of the parameters, and last the placement at the start where that is an input. The
    inputs have the layout of the loop's signals; positions are inertial.

    Attributes:
        scenario: the run from which every start value is taken.
        kind: who integrates.
        run: of the scenario, from which the sizes of the states are taken.
    """

    scenario: Scenario
    kind: Kind
    run: Trajectory

    @cached_property
    def plant(self) -> Plant:
        """The machine's plant."""
        return build_plant(self.scenario.machine)

    @cached_property
    def loop(self) -> ClosedLoop:
        """The loop with nothing left out that a parameter could bring, target and base as signals."""
        machine = self.scenario.machine
        structure = replace(
            self.scenario.loop.structure,
            motion=full_structure(machine),
            moving_target=True,
            moving_base="x" in machine.free_base_directions,
            watched=False,
        )
        return closed_loop(structure)

    @cached_property
    def motion(self) -> Motion:
        """The machine's motion, without numbers."""
        return Motion(self.loop.structure.motion, {})

    @property
    def placement_moves(self) -> bool:
        """Whether the placement is an input; else it is a parameter."""
        return self.loop.structure.moving_base

    @cached_property
    def parameters(self) -> tuple[Variable, ...]:
        """What the master may set before a run, and what is tunable during it, in the order of a."""
        found = [
            Variable(f"machine.{p.name}", p.unit, f"{_words(p.name)}", p.value, *parameter_range(p))
            for p in self.scenario.machine.parameters
        ]
        for variables in self.settings.values():
            found += variables
        return tuple(found)

    @cached_property
    def settings(self) -> dict[str, list[Variable]]:
        """Entries of a after the machine's parameters."""
        s, machine, options = self.scenario, self.scenario.machine, self.scenario.options
        structure, joints = self.loop.structure, self.scenario.machine.joints

        def of_joints(group: str, unit: str, text: str, values: Any, low: float, high: float, *, tunable: bool) -> Any:
            spread = tuple(values) * len(joints) if len(values) == 1 else tuple(values)
            return [
                Variable(f"{group}.{joint}", unit, f"{joint}: {text}", float(value), low, high, tunable)
                for joint, value in zip(joints, spread, strict=True)
            ]

        found: dict[str, list[Variable]] = {
            "posture": [
                Variable(f"posture.{joint}", "rad", f"{joint}: angle about which the controller works", float(angle),
                         max(low, -ANGLE_MAX), min(high, ANGLE_MAX))
                for joint, angle, (low, high) in zip(joints, s.posture, machine.limits, strict=True)
            ],
            "offset": of_joints("start_offset", "rad", "displacement at the start", s.offset, -ANGLE_MAX, ANGLE_MAX,
                                tunable=False),
        }  # fmt: skip
        force = "N" if options.control == "transpose" else "N m"
        gains = {"kp": ("proportional gain", _gain_unit(force, "m")), "kv": ("derivative gain", _gain_unit(force, "v"))}
        if structure.law == "pid":
            gains["ki"] = ("integral gain", _gain_unit(force, "i"))
        if structure.law in {"pd", "pid"}:
            for name, (text, unit) in gains.items():
                values = getattr(options, name)
                spread = values * N_TASK if len(values) == 1 else values
                found[name] = [
                    Variable(f"controller.{name}.{axis}", unit, f"{text}, axis {axis}", value, 0.0, GAIN_MAX, True)
                    for axis, value in zip(AXES, spread, strict=True)
                ]
        if structure.law == "pid":
            text, limit = "largest integral part of the force, each axis", options.integral_limit
            unit = force if force == "N" else "N m²"
            found["integral_limit"] = [Variable("controller.integral_limit", unit, text, limit, 0.0, GAIN_MAX, True)]
        if structure.nullspace_damped:
            text, value = "damping of the arm's self-motion", options.nullspace_damping
            found["nullspace_damping"] = [
                Variable("controller.nullspace_damping", "N m s/rad", text, value, 0.0, TORQUE_MAX, True)
            ]
        if structure.quantised:
            for name, unit, what in (("resolution", "m", "position"), ("rate_resolution", "m/s", "rate")):
                text = f"step to which the measured {what} is rounded; 0: not rounded"
                value = float(getattr(options.sensor, name))
                found[name] = [Variable(f"sensor.{name}", unit, text, value, 0.0, NOISE_MAX, True)]
        actuator = options.actuator
        for name, unit, text, value in (
            ("torque_limit", "N m", "largest torque asked for", actuator.torque_limit),
            ("dead_band", "N m", "command below which nothing happens", actuator.dead_band),
            ("rate_limit", "N m/s", "largest rate of the torque", actuator.rate_limit),
        ):
            if value is not None:
                found[name] = of_joints(f"actuator.{name}", unit, text, value, 0.0, TORQUE_MAX, tunable=True)
        if actuator.bandwidth_hz is not None:
            text = "bandwidth of the servo"
            found["bandwidth_hz"] = of_joints("actuator.bandwidth", "Hz", text, actuator.bandwidth_hz, 1e-3, 1e6,
                                              tunable=True)  # fmt: skip
        if not self.placement_moves:
            found["placement"] = [self._placement]
        return found

    @property
    def _placement(self) -> Variable:
        moves = "; where it is when initialisation ends, it stands at first" if self.placement_moves else ""
        text = f"where the base stands, inertial frame{moves}"
        return Variable("placement.x", "m", text, float(self.scenario.base[0]), -COORDINATE_MAX, COORDINATE_MAX)

    @cached_property
    def inputs(self) -> tuple[Variable, ...]:
        """What the master may set at every step, in the order of the loop's signals."""
        found: list[Variable] = []
        if self.placement_moves:
            rate = "rate of the placement, at which it moves on through a step"
            found += [self._placement, Variable("placement.x_rate", "m/s", rate, 0.0, -RATE_MAX, RATE_MAX)]
        found += [
            Variable(f"target.{axis}", "m", f"where the end-point shall be, {axis}, inertial frame", float(value),
                     -COORDINATE_MAX, COORDINATE_MAX)
            for axis, value in zip(AXES, self.scenario.target, strict=True)
        ]  # fmt: skip
        found += [
            Variable(f"target.{axis}_rate", "m/s", f"rate of target.{axis}, at which it moves on through a step", 0.0,
                     -RATE_MAX, RATE_MAX)
            for axis in AXES
        ]  # fmt: skip
        if "noise" in self.loop.signals.sizes:
            for suffix, unit in (("", "m"), ("_rate", "m/s")):
                text = f"error of the measured end-point{' rate' if suffix else ''}"
                found += [
                    Variable(f"sensor.noise.{axis}{suffix}", unit, f"{text}, {axis}", 0.0, -NOISE_MAX, NOISE_MAX)
                    for axis in AXES
                ]
        return tuple(found)

    @cached_property
    def rate_of(self) -> tuple[int, ...]:
        """Of each input, which one is its rate; −1 for none."""
        layout = self.loop.signals
        found = [-1] * layout.total
        for name, where in layout.slices.items():
            if f"{name}_rate" in layout.slices:
                rates = layout.slices[f"{name}_rate"]
                found[where] = range(rates.start, rates.stop)
        return tuple(found)

    @cached_property
    def outputs(self) -> tuple[Variable, ...]:
        """What the FMU shows, in the order of `show`."""
        plant, units = self.plant, self.plant.graph.coordinate_units
        found = [
            Variable(f"{letter}.{name}", f"{unit}{per}", f"{name}: {what}")
            for letter, per, what in (("q", "", "coordinate"), ("v", "/s", "rate of the coordinate"))
            for name, unit in zip(plant.coordinates, units, strict=True)
        ]
        found += [Variable(f"end_point.{axis}", "m", f"end-point, {axis}, inertial frame") for axis in AXES]
        found += [Variable(f"error.{axis}", "m", f"target less end-point, {axis}") for axis in AXES]
        found += [
            Variable(f"torque.{j}", "N m", f"{j}: torque that acts from now on") for j in self.scenario.machine.joints
        ]
        found.append(Variable("energy", "J", "kinetic, of the springs, and of the weight where it acts"))
        found += [
            Variable(f"deflection.{name}", unit, f"{name}: less its value at equilibrium")
            for name, unit in zip(plant.coordinates[: plant.n_passive], units, strict=False)
        ]
        return tuple(found)

    @cached_property
    def calculated(self) -> tuple[Variable, ...]:
        """What follows from the parameters."""
        text = "end-point in the posture at equilibrium"
        return tuple(Variable(f"rest_end_point.{axis}", "m", f"{text}, {axis}, inertial frame") for axis in AXES)

    @cached_property
    def states(self) -> tuple[Variable, ...]:
        """The loop's states x, in its order; the queue of a delayed sensor among them."""
        bodies = ["base", *(link.name for link in self.scenario.machine.links)][self.motion.first :]
        translations = self.loop.structure.motion.translations
        found: list[Variable] = []
        for suffix, per in (("", ""), ("_rate", "/s")):
            found += [
                Variable(f"state.base.{d}{suffix}", f"m{per}", f"base, {d}, from where it stands at first{_of(suffix)}")
                for d in translations
            ]
            found += [
                Variable(f"state.{body}.angle{suffix}", f"rad{per}", f"{body}: angle from the horizontal{_of(suffix)}")
                for body in bodies
            ]
        sizes = self.loop.states.sizes
        if sizes["torque"]:
            joints = self.scenario.machine.joints
            found += [Variable(f"state.torque.{j}", "N m", f"{j}: torque of the servo") for j in joints]
        for name, text in (("law", "of the feedback law"), ("queue", "measurement on its way")):
            found += [Variable(f"state.{name}[{k + 1}]", "", f"state {k + 1} {text}") for k in range(sizes[name])]
        return tuple(replace(v, nominal=size) for v, size in zip(found, self._nominals, strict=True))

    @cached_property
    def _nominals(self) -> list[float]:
        """Sizes of the states in the run, powers of ten; 1 for angles, which an integrator sees as they are."""
        loop, run = self.loop, self.run
        u, w = (np.linalg.solve(loop.to_q, rows) for rows in (run.q.T, run.v.T))
        if "x" in loop.structure.motion.translations:
            u[0] -= run.base[0, 0]
        largest = np.ones(loop.states.total)
        for name, rows in (("u", u), ("w", w), ("torque", run.torque.T)):
            if loop.states.sizes[name]:
                largest[loop.states.slices[name]] = np.max(np.abs(rows), axis=1, initial=0.0, where=np.isfinite(rows))
        largest[self.motion.n_translations : self.motion.n] = 1.0
        return [10.0 ** math.floor(math.log10(max(size, NOMINAL_MIN))) for size in largest.tolist()]


def _words(name: str) -> str:
    *owner, last = name.split(".")
    what = last.replace("_", " ").replace("com", "centre of mass")
    return f"{' '.join(owner)}: {what}" if owner else what


def _gain_unit(force: str, of: Literal["m", "v", "i"]) -> str:
    """Unit of a gain from error (m), its rate (v) or its integral (i) to f, which inverse control measures in N m²."""
    if force == "N":
        return {"m": "N/m", "v": "N s/m", "i": "N/(m s)"}[of]
    return {"m": "N m", "v": "N m s", "i": "N m/s"}[of]


def _of(suffix: str) -> str:
    return "; its rate" if suffix else ""


def printable(text: str) -> str:
    """Text without control characters."""
    return "".join(c if c.isprintable() else " " for c in text)
