"""The variables of an FMU, with units, descriptions, ranges and start values.

In: a `Scenario` and its run. Out: an `Interface`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import casadi as ca
import numpy as np

from flexopt.algebra.layout import Layout
from flexopt.export.control import RATE_MAX
from flexopt.export.fmu.settings import Groups, Served, settings
from flexopt.export.fmu.variable import EFFORT, Variable, words
from flexopt.export.task_rows import row_text
from flexopt.foundation.arrays import Vector
from flexopt.foundation.quantities import COORDINATE_MAX, coordinate_max
from flexopt.loop.closed import ClosedLoop, closed_loop
from flexopt.model.parameter_ranges import parameter_range
from flexopt.model.simulation import NOISE
from flexopt.plant import Plant, build_plant
from flexopt.plant.machine_motion import full_structure, motion_of
from flexopt.plant.motion import Motion
from flexopt.simulation.base_path import moved
from flexopt.simulation.scenario import Scenario
from flexopt.simulation.trajectory import Trajectory

FmuKind = Literal["co-simulation", "model-exchange"]
KINDS: tuple[FmuKind, ...] = ("co-simulation", "model-exchange")
NOMINAL_MIN = 1e-6


@dataclass(frozen=True)
class Interface:
    """Variables of one FMU.

    The vector a of values is that of the parameters, and last the placement at the start as far as that is an input.
    The inputs i have the layout `given`; positions are inertial.

    Attributes:
        scenario: the run from which every start value is taken.
        kind: who integrates.
        run: of the scenario, from which the sizes of the states are taken.
        served: of a velocity-served loop, what it was before it was written in torques.
    """

    scenario: Scenario
    kind: FmuKind
    run: Trajectory
    served: Served | None = None

    @cached_property
    def plant(self) -> Plant:
        """The machine's plant."""
        return build_plant(self.scenario.machine)

    @cached_property
    def loop(self) -> ClosedLoop:
        """The loop with nothing left out that a parameter could bring, target and base as signals."""
        structure = replace(
            self.scenario.loop.structure,
            motion=full_structure(self.scenario.machine),
            moving_target=True,
            moving_base=bool(self.moving),
            watched=False,
        )
        return closed_loop(structure)

    @cached_property
    def motion(self) -> Motion:
        """The machine's motion, without numbers."""
        return self.loop.shape

    @cached_property
    def moving(self) -> tuple[str, ...]:
        """Placement coordinates that are inputs; the others are parameters."""
        return moving_placement(motion_of(full_structure(self.scenario.machine), {}))

    @cached_property
    def parameters(self) -> tuple[Variable, ...]:
        """What the master may set before a run, and what is tunable during it, in the order of a.

        Pins of cylinders, which end the machine's, are left out: levers are part of the loop's structure.
        """
        found = [
            Variable(f"machine.{p.name}", p.unit, self._text(p.name), p.value, *parameter_range(p))
            for p in self.scenario.machine.parameters[: self.n_machine]
        ]
        for variables in self.settings.values():
            found += variables
        return tuple(found)

    def _text(self, parameter: str) -> str:
        return words(parameter) + (self.served.of_parameter(parameter) if self.served else "")

    @cached_property
    def n_machine(self) -> int:
        """Parameters of the machine that the FMU has."""
        return len(self.scenario.machine.list_parameters())

    @cached_property
    def settings(self) -> Groups:
        """Entries of a after the machine's parameters."""
        found = settings(self.scenario, self.loop.structure, self.served)
        still = [v for name, v in self._placement.items() if name not in self.moving]
        return found | ({"placement": still} if still else {})

    @cached_property
    def _placement(self) -> dict[str, Variable]:
        """By coordinate."""
        machine, found = self.scenario.machine, dict[str, Variable]()
        for name, unit, value in zip(
            machine.base_coordinates, machine.base_units, self.scenario.base.tolist(), strict=True
        ):
            moves = "; where it is when initialisation ends, it stands at first" if name in self.moving else ""
            text = f"where the base stands, {name}, inertial frame{moves}"
            most = coordinate_max(unit)
            found[name] = Variable(f"placement.{name}", unit, text, value, -most, most)
        return found

    @cached_property
    def given(self) -> Layout:
        """Layout of i."""
        rows, moving = len(self.scenario.machine.task_rows), len(self.moving)
        sizes = {"placement": moving, "placement_rate": moving, "target": rows, "target_rate": rows}
        return Layout(sizes | ({"noise": 2 * rows} if "noise" in self.loop.signals.sizes else {}))

    @cached_property
    def inputs(self) -> tuple[Variable, ...]:
        """What the master may set at every step."""
        found = [self._placement[name] for name in self.moving]
        found += [self._rate(f"placement.{name}") for name in self.moving]
        machine = self.scenario.machine
        rows = machine.task_rows
        found += [
            Variable(f"target.{row}", "m", f"where the end-point shall be, {row_text(machine, row)}", value,
                     -COORDINATE_MAX, COORDINATE_MAX)
            for row, value in zip(rows, self.scenario.target.tolist(), strict=True)
        ]  # fmt: skip
        found += [self._rate(f"target.{row}") for row in rows]
        if "noise" in self.given.sizes:
            for suffix, unit in (("", "m"), ("_rate", "m/s")):
                text = f"error of the measured end-point{' rate' if suffix else ''}"
                found += [
                    Variable(f"sensor.noise.{row}{suffix}", unit, f"{text}, {row}", 0.0, -NOISE.high, NOISE.high)
                    for row in rows
                ]
        return tuple(found)

    @staticmethod
    def _rate(of: str) -> Variable:
        text = f"rate of {of}, at which it moves on through a step"
        return Variable(f"{of}_rate", "m/s", text, 0.0, -RATE_MAX, RATE_MAX)

    @cached_property
    def rate_of(self) -> tuple[int, ...]:
        """Of each input, which one is its rate; −1 for none."""
        found = [-1] * self.given.total
        for name, where in self.given.slices.items():
            if f"{name}_rate" in self.given.slices:
                rates = self.given.slices[f"{name}_rate"]
                found[where] = range(rates.start, rates.stop)
        return tuple(found)

    @cached_property
    def outputs(self) -> tuple[Variable, ...]:
        """What the FMU shows, in the order of `show`."""
        machine, plant = self.scenario.machine, self.plant
        coordinates = list(zip(plant.coordinates, plant.graph.coordinate_units, strict=True))
        found = [
            Variable(f"{letter}.{name}", f"{unit}{per}", f"{name}: {what}")
            for letter, per, what in (("q", "", "coordinate"), ("v", "/s", "rate of the coordinate"))
            for name, unit in coordinates
        ]
        found += [
            Variable(f"end_point.{row}", "m", f"end-point, {row_text(machine, row)}") for row in machine.task_rows
        ]
        found += [Variable(f"error.{row}", "m", f"target less end-point, {row}") for row in machine.task_rows]
        found += [
            Variable(f"torque.{joint}", EFFORT[unit][1], f"{joint}: {EFFORT[unit][0]} that its drive gives from now on")
            for joint, unit in coordinates[plant.n_passive :]
        ]
        found.append(Variable("energy", "J", "kinetic, of the springs, and of the weight where it acts"))
        found += [
            Variable(f"deflection.{name}", unit, f"{name}: less its value at equilibrium")
            for name, unit in coordinates[: plant.n_passive]
        ]
        return tuple(found)

    @cached_property
    def calculated(self) -> tuple[Variable, ...]:
        """What follows from the parameters."""
        text, machine = "end-point in the posture at equilibrium", self.scenario.machine
        return tuple(
            Variable(f"rest_end_point.{row}", "m", f"{text}, {row_text(machine, row)}") for row in machine.task_rows
        )

    @cached_property
    def states(self) -> tuple[Variable, ...]:
        """The loop's states x, in its order; the queue of a delayed sensor among them."""
        found = [
            Variable(f"state.{name}{suffix}", f"{unit}{per}", f"{text}{rate}")
            for suffix, per, rate in (("", "", ""), ("_rate", "/s", "; its rate"))
            for name, unit, text in self._coordinates()
        ]
        machine, sizes = self.scenario.machine, self.loop.states.sizes
        if sizes["torque"]:
            found += [
                Variable(f"state.torque.{joint}", EFFORT[unit][1], f"{joint}: {EFFORT[unit][0]} of the servo")
                for joint, unit in zip(machine.joints, machine.joint_units, strict=True)
            ]
        kinds = {"law": "of the feedback law", "filter": "filtered measurement", "queue": "measurement on its way"}
        for name, text in kinds.items():
            found += [Variable(f"state.{name}[{k + 1}]", "", f"state {k + 1} {text}") for k in range(sizes[name])]
        return tuple(replace(v, nominal=size) for v, size in zip(found, self._nominals, strict=True))

    def _coordinates(self) -> list[tuple[str, str, str]]:
        """Name, unit and text of each entry of u: a coordinate of q, or where q has differences, an absolute angle."""
        motion, to_q = self.motion, self.loop.to_q
        symbols = {name: ca.SX.sym(name) for name in motion.structure.constants}
        offset = motion_of(self.loop.structure.motion, symbols).offset
        drawn = {entry for entry, _ in motion.absorbed.values()}
        found: list[tuple[str, str, str]] = []
        for k in range(motion.n):
            row = int(np.argmax(to_q[:, k]))
            name, unit = self.plant.coordinates[row], self.plant.graph.coordinate_units[row]
            if np.count_nonzero(to_q[row]) > 1 or not offset[row].is_zero():
                found.append((f"{name}.angle", unit, f"{name}: angle from the horizontal"))
            else:
                text = "from where the base stands at first" if k in drawn else "coordinate"
                found.append((name, unit, f"{name}: {text}"))
        return found

    @cached_property
    def _nominals(self) -> list[float]:
        """Sizes of the states in the run, powers of ten; 1 for angles, which an integrator sees as they are."""
        loop, run, motion = self.loop, self.run, self.motion
        u, w = (np.linalg.solve(loop.to_q, rows) for rows in (run.q.T, run.v.T))
        for name, (entry, sign) in motion.absorbed.items():
            u[entry] += sign * self._driven[:, motion.placement.index(name)]
        # Of the servo's state the run shows what is left beside its braking.
        braking = np.broadcast_to(self.scenario.parts["braking"], len(self.scenario.machine.joints))
        torque = run.torque.T + braking[:, None] * run.v.T[-len(braking) :]
        largest = np.ones(loop.states.total)
        for name, rows in (("u", u), ("w", w), ("torque", torque)):
            if loop.states.sizes[name]:
                largest[loop.states.slices[name]] = np.max(np.abs(rows), axis=1, initial=0.0, where=np.isfinite(rows))
        largest[motion.n_translations : motion.n] = 1.0
        return [10.0 ** math.floor(math.log10(max(size, NOMINAL_MIN))) for size in largest.tolist()]

    @property
    def _driven(self) -> Vector:
        """What the run adds to u less q, (K, n_b): coordinates count from the first placement, not from the anchor."""
        base = self.run.base
        return moved(self.motion, base, base[0]) if self.motion.follows else np.broadcast_to(-base[0], base.shape)


def moving_placement(motion: Motion) -> tuple[str, ...]:
    """Placement coordinates that may move during a run: those along which springs carry the machine.

    A base that may be turned gives in x and y or in neither: else a movement along one would jerk it along the other.
    """
    moving = tuple(name for name in motion.placement if name in motion.absorbed)
    return moving if "yaw" not in motion.placement or len(moving) == len("xy") else ()
