"""The quantities that own objectives and constraints may be functions of: one table, of names, units and graphs.

In: a machine. Out: for each name what it is, its unit, its length, and its SX graph. Everything but the w_i is a graph
of placement, posture and p, and of solutions that iterations give: static deflection and modes, about which it is exact
to second order. The w_i come from `robustness.expansion`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

import casadi as ca

from flexopt.foundation.kept import by_structure
from flexopt.model import AnyMachine
from flexopt.plant import Plant, build_hydraulics, build_plant
from flexopt.robustness.measures import Measures
from flexopt.robustness.modal import ModalGraphs
from flexopt.selection.constraints.manipulability import squared_manipulability


@dataclass(frozen=True)
class Sight:
    """A machine as SX graphs, each made when first asked for.

    Attributes:
        measures: of the machine, its controller and gravity option.
        static: passive coordinates under the machine's weight, from an iteration, (m,).
    """

    measures: Measures
    static: ca.SX

    @property
    def plant(self) -> Plant:
        """The machine's plant."""
        return self.measures.plant

    @property
    def at(self) -> list[ca.SX]:
        """Symbols of base, posture, p."""
        return self.measures.inputs

    @cached_property
    def rest(self) -> list[ca.SX]:
        """Inputs q, base, p of Functions of a configuration, the passive coordinates at rest."""
        base, posture, p = self.at
        return [self.plant.rest(base, posture, p), base, p]

    @cached_property
    def deflected(self) -> list[ca.SX]:
        """The same, under the machine's weight."""
        base, posture, p = self.at
        return [self.plant.operating_point(base, posture, p, self.static).q, base, p]

    @property
    def standing(self) -> list[ca.SX]:
        """The same as flexopt's constraints count it: at rest, or with the gravity option under the weight."""
        return self.deflected if self.measures.gravity else self.rest

    @property
    def torques(self) -> ca.SX:
        """What holds the arm, (n,)."""
        return self.plant.gravity(*self.standing)[self.plant.n_passive :]

    @property
    def cylinder_forces(self) -> ca.SX:
        """The same by cylinders."""
        return build_hydraulics(self.plant.machine).forces(self.at[1], self.torques, self.at[2])

    @property
    def manipulability(self) -> ca.SX:
        """Yoshikawa's."""
        return ca.sqrt(squared_manipulability(self.plant.rigid_jacobian(*self.standing)))

    @property
    def deflection(self) -> ca.SX:
        """How far the passive coordinates give way, (m,)."""
        return (self.deflected[0] - self.rest[0])[: self.plant.n_passive]

    @property
    def sag(self) -> ca.SX:
        """How far the end-point does, (n_task,)."""
        return self.plant.end_point(*self.deflected) - self.plant.end_point(*self.rest)

    @cached_property
    def modal(self) -> ModalGraphs:
        """The modes."""
        return ModalGraphs(self.measures.expansion)


@dataclass(frozen=True)
class KnownQuantity:
    """A quantity that own functions may take.

    Attributes:
        name, unit: of it;  size: number of entries;  sentence: what it is.
        graph: its SX graph; None of the w_i.
        static, modal: whether it needs the static deflection, or the modes.
        modes: of the w_i which.
    """

    name: str
    unit: str
    size: int
    sentence: str
    graph: Callable[[Sight], ca.SX] | None = None
    static: bool = False
    modal: bool = False
    modes: tuple[int, ...] = ()

    def __str__(self) -> str:
        unit = f", {self.unit}" if self.unit else ""
        return f"{self.name} ({self.size},){unit}: {self.sentence}"


@by_structure
def known_quantities(machine: AnyMachine) -> Mapping[str, KnownQuantity]:
    """All quantities of a machine, by name."""
    plant = build_plant(machine)
    m, n, dimension = plant.n_passive, plant.n_actuated, plant.frames.dimension
    joints, passive = _units(machine.joint_units), _units(machine.coordinate_units[: plant.n_passive])
    efforts = _units(tuple({"rad": "N m", "m": "N"}[unit] for unit in machine.joint_units))
    places, rest = ", ".join(machine.base_coordinates) or "none", "at rest, with gravity as the machine sags"
    found = [
        KnownQuantity("base", _units(machine.base_units), plant.n_base, f"placement ({places})", lambda s: s.at[0]),
        KnownQuantity("posture", joints, n, f"actuated joints ({', '.join(machine.joints)})", lambda s: s.at[1]),
        KnownQuantity("p", "", len(plant.parameter_names), "parameters, in the order of Machine.parameters",
                 lambda s: s.at[2]),
        KnownQuantity("w", "1/kg or 1/(kg m²), as R_i", m, "measures w_i of all modes, lowest frequency first",
                 modes=tuple(range(m)), modal=True),
        *(KnownQuantity(f"w{i + 1}", "as w", 1, f"w_{i + 1} alone", modes=(i,), modal=True) for i in range(m)),
        KnownQuantity("frequencies", "Hz", m, "natural frequencies, ascending", lambda s: s.modal.omega / math.tau,
                 modal=True),
        KnownQuantity("damping_ratios", "", m, "of the modes, to first order in the damping", lambda s: s.modal.zeta,
                 modal=True),
        KnownQuantity("allowance", "N s/m, N m s or 1", m,
                 "κ_i = 4 ζ_i ω_i / |w_i|: the largest velocity gain, whatever its directions, before mode i grows",
                 lambda s: s.modal.allowance, modal=True),
        KnownQuantity("end_point", "m", plant.n_task, f"end-point r, inertial frame, {rest}",
                 lambda s: s.plant.end_point(*s.standing)),
        KnownQuantity("centre_of_mass", "m", dimension, f"of the whole machine, inertial frame, {rest}",
                 lambda s: s.plant.centre_of_mass(*s.standing)),
        KnownQuantity("torques", efforts, n, f"what each actuated joint holds against the weight, {rest}",
                 lambda s: s.torques),
        KnownQuantity("manipulability", "", 1, "sqrt(det(Jv Jvᵀ)), Yoshikawa 1985", lambda s: s.manipulability),
        KnownQuantity("singularity", "", 1,
                 "sin² of the distance from singular postures, Plant.singularity_sine_squared",
                 lambda s: s.plant.singularity_sine_squared(*s.at)),
        KnownQuantity("deflection", passive, m, "of the passive coordinates under the weight, the arm held",
                 lambda s: s.deflection, static=True),
        KnownQuantity("sag", "m", plant.n_task, "way of the end-point from rest under the weight, the arm held",
                 lambda s: s.sag, static=True),
    ]  # fmt: skip
    if machine.cylinders:
        names = ", ".join(cylinder.name for cylinder in machine.cylinders)
        sentence = f"what each cylinder ({names}) holds against the weight, positive where it pushes"
        found.append(
            KnownQuantity("cylinder_forces", "N", len(machine.cylinders), sentence, lambda s: s.cylinder_forces)
        )
    return MappingProxyType({quantity.name: quantity for quantity in found})


def _units(units: tuple[str, ...]) -> str:
    return " or ".join(dict.fromkeys(units))
