"""A machine's hydraulic cylinders as graphs: lengths, lever arms, forces, and the map from joint rates to levers.

In: a machine with `cylinders`. Out: `Hydraulics`, named Functions of the posture. The operator's levers set the speeds
of cylinders (article, section 3.2.2), so Jacobian inverse control, whose output are joint rates, reaches the machine
through `lever`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import casadi as ca
import numpy as np

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arrays import Vector
from flexopt.foundation.boundary import array_of, instance, public, public_class, words
from flexopt.foundation.kept import Structural, structural_property
from flexopt.model import AnyMachine
from flexopt.model.hydraulics import Cylinder, pin_to_pin
from flexopt.plant.plant import Plant, build_plant

Saturation = Literal["none", "each", "uniform"]
# A smaller share of the full speed is rest: no lever jumps over its dead band for a rounding error.
REST = 1e-9


class CylinderState(NamedTuple):
    """A cylinder in a posture.

    Attributes:
        length, stroke: pin to pin, and the ends of what it can be, m.
        ratio: its lever arm dL/dq, m/rad; of a slide 1.
        force: that holds the machine's weight, N, positive where it pushes.
    """

    name: str
    joint: str
    length: float
    stroke: tuple[float, float]
    ratio: float
    force: float

    def __str__(self) -> str:
        low, high = self.stroke
        # Of a hinge m/rad, which is a length; of a slide 1.
        arm = f"lever arm {self.ratio:.4f} m" if self.ratio != 1 else "along its slide"
        return f"{self.name}: {self.length:.4f} m of {low:g} to {high:g} m; {arm}; {self.force:.4g} N hold gravity"


_SATURATION = words("none", "each", "uniform")


@public_class(plant=instance(Plant, "a Plant, from flexopt.build_plant"))
@dataclass(frozen=True)
class Hydraulics(Structural):
    """The n_c cylinders of a machine with n actuated joints. Every Function takes its inputs by name.

    Postures (n,) are in rad or m, rates in rad/s or m/s, p (n_par,) are the machine's parameters, among them the pins.
    A cylinder's length L_i depends on its own joint alone; r_i = dL_i/dq is its lever arm, m/rad, of a slide 1.

    Attributes:
        plant: the machine's plant.

    Example:
        >>> hydraulics = flexopt.build_hydraulics(flexopt.load("boom-stick-bucket"))
        >>> p = hydraulics.plant.parameter_values
        >>> hydraulics.lever(posture=[0.5, -1.2, -0.5], rates=[0.1, 0.0, 0.0], p=p)["lever"]
        DM([-0.114856, 0, 0])
    """

    plant: Plant

    @property
    def cylinders(self) -> tuple[Cylinder, ...]:
        """In the order of the file."""
        return self.plant.machine.cylinders

    @property
    def joints(self) -> tuple[int, ...]:
        """Of each cylinder, the index of its joint among the actuated ones."""
        names = self.plant.machine.joints
        return tuple(names.index(cylinder.joint) for cylinder in self.cylinders)

    @structural_property
    def _lengths(self) -> ca.SX:
        g, machine = self.plant.graph, self.plant.machine
        value = {name: g.p[k] for k, name in enumerate(self.plant.parameter_names)}
        found: list[ca.SX] = []
        for cylinder, joint in zip(self.cylinders, self.joints, strict=True):
            q = g.posture[joint]
            reach = pin_to_pin(cylinder, machine.joint_frame(cylinder.joint), value, (q, ca.cos(q), ca.sin(q)))
            found.append(reach.length)
        return _column(found)

    @structural_property
    def _arms(self) -> list[ca.SX]:
        """r_i."""
        posture = self.plant.graph.posture
        return [ca.jacobian(self._lengths[i], posture[joint]) for i, joint in enumerate(self.joints)]

    @structural_property
    def lengths(self) -> ca.Function:
        """L(q), (n_c,), m, pin to pin; NaN where a linkage does not close. Inputs posture, p."""
        return self._function("cylinder_lengths", {}, [self._lengths], ["L"])

    @structural_property
    def ratios(self) -> ca.Function:
        """∂L/∂q, (n_c, n), m/rad or 1; r_i in row i. Inputs posture, p."""
        jacobian = ca.SX.zeros(len(self.cylinders), self.plant.n_actuated)
        for i, (joint, arm) in enumerate(zip(self.joints, self._arms, strict=True)):
            jacobian[i, joint] = arm
        return self._function("cylinder_ratios", {}, [jacobian], ["L_q"])

    @structural_property
    def forces(self) -> ca.Function:
        """F_i = τ/r_i, (n_c,), N, positive where it pushes: the virtual work F δL is τ δq.

        Inputs posture, torque (n,), N m or N, p.
        """
        torque = ca.SX.sym("torque", self.plant.n_actuated)
        found = [torque[joint] / arm for joint, arm in zip(self.joints, self._arms, strict=True)]
        return self._function("cylinder_forces", {"torque": torque}, [_column(found)], ["force"])

    @structural_property
    def joint_efforts(self) -> ca.Function:
        """Least and greatest torque or force of the joints, (n, 2), N m or N. Inputs posture, p.

        Of a joint whose cylinder has a `force`: −pull · r to push · r, and the reverse where r is negative. Of any
        other ± the machine's `efforts`, infinite where none is given.
        """
        given = ca.SX(ca.DM(list(self.plant.machine.efforts)))
        efforts = ca.horzcat(-given, given)
        for cylinder, joint, arm in zip(self.cylinders, self.joints, self._arms, strict=True):
            if cylinder.force is not None:
                pull, push = -cylinder.force[0] * arm, cylinder.force[1] * arm
                efforts[joint, :] = ca.horzcat(ca.fmin(pull, push), ca.fmax(pull, push))
        return self._function("joint_efforts", {}, [efforts], ["efforts"])

    @structural_property
    def lever(self) -> ca.Function:
        """`lever_map` without saturation."""
        return self.lever_map()

    @public(saturation=_SATURATION)
    def lever_map(self, saturation: Saturation = "none") -> ca.Function:
        """Lever commands u (n,) from joint rates, 1 at full lever. Inputs posture, rates (n,), p; output lever.

        With s the share of the full speed, L̇_i/speed_i with the speed of the direction in which the cylinder moves, or
        q̇/speed of a joint without cylinder: u = σ (d sign s + (1 − d) s), σ the lever's sign and d its dead band; where
        |s| is below 1e-9, u = σ (1 − d) s.

        Args:
            saturation: `"none"`; `"each"` cuts every s at ±1; `"uniform"` divides all by the largest |s| above 1, so
                that the end-point keeps its direction and loses speed alone.

        Raises:
            InputError: a joint has neither cylinder nor speed.

        Example:
            >>> hydraulics = flexopt.build_hydraulics(flexopt.load("boom-stick-bucket"))
            >>> p = hydraulics.plant.parameter_values
            >>> hydraulics.lever_map("each")(posture=[0.5, -1.2, -0.5], rates=[9.0, 0.0, 0.0], p=p)["lever"]
            DM([-1, 0, 0])
        """
        self._check_speeds()
        rates = ca.SX.sym("rates", self.plant.n_actuated)
        shares = [rate / speed for rate, speed in zip(ca.vertsplit(rates), self.plant.machine.speeds, strict=True)]
        for cylinder, joint, arm in zip(self.cylinders, self.joints, self._arms, strict=True):
            moved = arm * rates[joint]
            retract, extend = cylinder.speed
            shares[joint] = moved / ca.if_else(moved < 0, retract, extend)
        share = ca.vertcat(*shares)
        if saturation == "each":
            share = ca.fmax(-1, ca.fmin(1, share))
        elif saturation == "uniform":
            share /= ca.fmax(1, ca.mmax(ca.fabs(share)))

        def moved_lever(k: int, sign: float, dead: float) -> ca.SX:
            jump = ca.if_else(ca.fabs(share[k]) < REST, 0, ca.sign(share[k])) if dead else 0
            return sign * (dead * jump + (1 - dead) * share[k])

        name = "lever" if saturation == "none" else f"lever_saturated_{saturation}"
        return self._function(name, {"rates": rates}, [self._by_joint(moved_lever)], ["lever"])

    @public(saturation=_SATURATION)
    def driven(self, saturation: Saturation) -> ca.Function:
        """Joint rates (n,) that come of wanted ones when they pass through the levers. Inputs posture, rates, p.

        What full levers cannot give is cut; see `lever_map`. Output rates.

        Example:
            >>> hydraulics = flexopt.build_hydraulics(flexopt.load("boom-stick-bucket"))
            >>> p = hydraulics.plant.parameter_values
            >>> found = hydraulics.driven("each")(posture=[0.5, -1.2, -0.5], rates=[9.0, 0.0, 0.0], p=p)
            >>> float(found["driven"][0]) < 9.0
            True
        """
        g, rates = self.plant.graph, ca.SX.sym("rates", self.plant.n_actuated)
        lever = self.lever_map(saturation)(g.posture, rates, g.p)
        return self._function("driven_rates", {"rates": rates}, [self.rates(g.posture, lever, g.p)], ["driven"])

    @structural_property
    def rates(self) -> ca.Function:
        """Joint rates (n,) that levers u (n,) give, the inverse of `lever`. Inputs posture, lever, p; output rates.

        In the dead band nothing moves; beyond ±1 the map goes on along its line.

        Raises:
            InputError: a joint has neither cylinder nor speed.
        """
        self._check_speeds()
        lever = ca.SX.sym("lever", self.plant.n_actuated)

        def share(k: int, sign: float, dead: float) -> ca.SX:
            signed = sign * lever[k]
            return ca.sign(signed) * ca.fmax(ca.fabs(signed) - dead, 0) / (1 - dead)

        shares = self._by_joint(share)
        rates = [part * speed for part, speed in zip(ca.vertsplit(shares), self.plant.machine.speeds, strict=True)]
        for cylinder, joint, arm in zip(self.cylinders, self.joints, self._arms, strict=True):
            retract, extend = cylinder.speed
            rates[joint] = shares[joint] * ca.if_else(shares[joint] < 0, retract, extend) / arm
        return self._function("lever_rates", {"lever": lever}, [ca.vertcat(*rates)], ["rates"])

    @public(
        machine=lambda self: self.plant.machine,
        sizes=lambda self: {"n_q": self.plant.n_coordinates},
        q=array_of(("n_q",)),
    )
    def states(self, q: Vector, base: Vector) -> tuple[CylinderState, ...]:
        """Every cylinder at a configuration q (n_q,) of the machine's plant, the placement being `base` (n_b,).

        Example:
            >>> hydraulics = flexopt.build_hydraulics(flexopt.load("boom-stick-bucket"))
            >>> [state.name for state in hydraulics.states([0, 0, 0, 0.5, -1.2, -0.5], [0.0])]
            ['boom cylinder', 'stick cylinder', 'bucket cylinder']
        """
        plant, p = self.plant, self.plant.parameter_values
        posture = np.asarray(q)[plant.n_passive :]
        torque = plant.gravity(q, base, p)[plant.n_passive :]
        lengths, forces = self.lengths(posture, p).full().ravel(), self.forces(posture, torque, p).full().ravel()
        arms = self.ratios(posture, p).full()
        return tuple(
            CylinderState(c.name, c.joint, float(lengths[i]), c.length, float(arms[i, joint]), float(forces[i]))
            for i, (c, joint) in enumerate(zip(self.cylinders, self.joints, strict=True))
        )

    def _by_joint(self, entry: Callable[[int, float, float], ca.SX]) -> ca.SX:
        """A column with an entry for each joint, from its index and its lever's sign and dead band."""
        driven = dict(zip(self.joints, self.cylinders, strict=True))
        found: list[ca.SX] = []
        for k in range(self.plant.n_actuated):
            cylinder = driven.get(k)
            found.append(entry(k, cylinder.lever_sign, cylinder.dead_band) if cylinder else entry(k, 1, 0.0))
        return _column(found)

    def _check_speeds(self) -> None:
        machine = self.plant.machine
        sentence = "has neither a cylinder nor a speed, so its lever's full stroke has no meaning; give it one"
        faults = [Fault(f"joint {name}", sentence) for name in machine.joints_without_speed]
        raise_if_any(InputError, f"levers of {machine.name}", faults)

    def _function(self, name: str, inputs: dict[str, ca.SX], outputs: list[ca.SX], names: list[str]) -> ca.Function:
        g = self.plant.graph
        every = {"posture": g.posture} | inputs | {"p": g.p}
        # A forgotten input would silently be 0; NaN shows.
        options = {"cse": True, "default_in": [float("nan")] * len(every)}
        return ca.Function(name, list(every.values()), [ca.densify(x) for x in outputs], list(every), names, options)

    def __repr__(self) -> str:
        listed = ", ".join(f"{cylinder.name} on {cylinder.joint}" for cylinder in self.cylinders) or "no cylinders"
        return f"Hydraulics({self.plant.machine.name!r}: {listed})"


def _column(entries: list[ca.SX]) -> ca.SX:
    return ca.vertcat(*entries) if entries else ca.SX(0, 1)


@public()
def build_hydraulics(machine: AnyMachine) -> Hydraulics:
    """The hydraulics of a machine, planar or in space (its graphs are built once for each structure and kept).

    A machine without cylinders has the maps of its motors: `lever` and `joint_efforts` from its speeds and efforts.

    Example:
        >>> hydraulics = flexopt.build_hydraulics(flexopt.load("boom-stick-bucket"))
        >>> [cylinder.name for cylinder in hydraulics.plant.machine.cylinders]
        ['boom cylinder', 'stick cylinder', 'bucket cylinder']
    """
    return Hydraulics(build_plant(machine))
