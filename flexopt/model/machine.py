"""What every machine has, whatever file it came from: all that is computed downstream asks for no more."""

from __future__ import annotations

import hashlib
import math
from abc import abstractmethod
from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Self, cast

import numpy as np
from pydantic import Field, PrivateAttr

from flexopt.errors import Fault, InputError, ModelError, raise_if_any
from flexopt.foundation.arrays import BaseLike, Document, PostureLike
from flexopt.foundation.boundary import flag, of_machine, public, table
from flexopt.foundation.control import Control
from flexopt.foundation.kept import Structural
from flexopt.foundation.plain import shown
from flexopt.foundation.quantities import (
    JOINT_VALUE,
    Acceleration,
)
from flexopt.model.configuration import Configuration
from flexopt.model.file_model import BuiltByCall, Described
from flexopt.model.hydraulics import Cylinder, JointFrame
from flexopt.model.kinematic_tree import KinematicTree, units_of
from flexopt.model.loop import Loop, LoopLike, check_loop, loop_faults
from flexopt.model.parameter_values import places, with_parameters
from flexopt.model.strokes import CylinderTravel, usable_range
from flexopt.model.tables import Capsule, Visual
from flexopt.model.tree_quantities import axes_about, snapped_rows
from flexopt.model.uncertainty import Uncertainty, uncertainty_faults


class Parameter(NamedTuple):
    """One entry of the parameter vector p."""

    name: str
    value: float
    unit: str


NamedParameter = tuple[str, Parameter]


class AnyMachine(BuiltByCall, Described, Structural):
    """What every machine has, planar or spatial; all that is computed downstream of the plant asks for no more.

    Attributes:
        gravity: acceleration of free fall.
        capsules: what the bodies fill, for clearances.
        cylinders: what drives the joints.
        loop: the controller that the machine has.
        uncertainty: what nobody has measured of it.
    """

    gravity: Acceleration = 9.81
    capsules: tuple[Capsule, ...] = ()
    cylinders: tuple[Cylinder, ...] = ()
    loop: Loop | None = None
    uncertainty: tuple[Uncertainty, ...] = ()

    @abstractmethod
    def build_tree(self) -> KinematicTree:
        """See `kinematic_tree`."""

    @cached_property
    def kinematic_tree(self) -> KinematicTree:
        """The machine as bodies and joints: all that is computed from it starts there."""
        return self.build_tree()

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of q: the passive joints, then the actuated ones."""
        tree = self.kinematic_tree
        return tuple(body.joint.name for body in (*tree.passive, *tree.actuated))

    @property
    def coordinate_units(self) -> tuple[str, ...]:
        """Unit of each entry of q."""
        return (*units_of(self.kinematic_tree.passive), *self.joint_units)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the actuated joints, from the base outwards."""
        return tuple(body.joint.name for body in self.kinematic_tree.actuated)

    @property
    def joint_units(self) -> tuple[str, ...]:
        """Unit of each actuated joint, rad or m."""
        return units_of(self.kinematic_tree.actuated)

    @property
    def joint_limits(self) -> tuple[tuple[float, float], ...]:
        """Limits of the actuated joints as they were given, rad or m; infinite where none are."""
        unlimited = (-float("inf"), float("inf"))
        return tuple(body.joint.limits or unlimited for body in self.kinematic_tree.actuated)

    def joint_frame(self, joint: str) -> JointFrame:
        """How an actuated joint stands between the bodies that it joins; its axis is the third of its frame.

        Example:
            >>> machine = flexopt.load("boom-stick-bucket")
            >>> machine.joint_frame("boom").slide
            False
        """
        self._check_joint("joint_frame", joint)
        tree = self.kinematic_tree
        i = next(i for i, body in enumerate(tree.bodies) if body.joint.name == joint)
        body = tree.bodies[i]
        of_body = axes_about(body.joint.axis)
        of_parent = snapped_rows(np.array(of_body) @ np.array(body.rotation).T)
        x, y, z = (tree.entries.get(f"offset{i}.{axis}", "") for axis in "xyz")
        return JointFrame(body.joint.kind == "slide", (x, y, z), of_parent, of_body)

    def _check_joint(self, call: str, joint: Any) -> None:
        """Raise where that is no name of an actuated joint."""
        if not isinstance(joint, str) or joint not in self.joints:
            sentence = f"must be an actuated joint: {', '.join(self.joints)}"
            raise_if_any(InputError, call, [Fault("joint", sentence, shown(joint))])

    def travel(self, cylinder: Cylinder) -> CylinderTravel:
        """A cylinder's length over its joint's coordinate, as numbers.

        Example:
            >>> machine = flexopt.load("boom-stick-bucket")
            >>> cylinder = machine.cylinders[0]
            >>> round(machine.travel(cylinder).length(0.4), 3)  # m, pin to pin
            3.033
        """
        if not isinstance(cylinder, Cylinder) or cylinder not in self.cylinders:  # pyright: ignore[reportUnnecessaryIsInstance]
            raise_if_any(InputError, "travel", [Fault("cylinder", "must be one of `cylinders`", shown(cylinder))])
        return CylinderTravel(
            cylinder, self.joint_frame(cylinder.joint), {name: value for name, value, _ in self.parameters}
        )

    @property
    def joints_without_speed(self) -> tuple[str, ...]:
        """Actuated joints with neither cylinder nor speed, of which no lever can be told."""
        driven = {cylinder.joint for cylinder in self.cylinders}
        pairs = zip(self.joints, self.speeds, strict=True)
        return tuple(joint for joint, speed in pairs if joint not in driven and speed == float("inf"))

    def beyond_stroke(self, joint: str, q: float) -> str:
        """The end of a sentence about a value that its joint cannot take, where that is its cylinder's doing.

        Example:
            >>> machine = flexopt.load("boom-stick-bucket")
            >>> machine.beyond_stroke("boom", 3.0)
            '; boom cylinder would be 1.395 m long, its stroke is 1.745 to 3.005 m'
        """
        self._check_joint("beyond_stroke", joint)
        try:
            q = JOINT_VALUE(q)
        except ValueError as error:
            raise_if_any(InputError, "beyond_stroke", [Fault("q", str(error), shown(q))])
        return next((self.travel(c).beyond_stroke(q) for c in self.cylinders if c.joint == joint), "")

    @cached_property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """What the limits of the actuated joints and the strokes of their cylinders allow, rad or m; else infinite."""
        found = dict(zip(self.joints, self.joint_limits, strict=True))
        ranges = zip(self.cylinders, self.stroke_ranges, strict=True)
        return tuple((found | {cylinder.joint: part for cylinder, (part, _) in ranges}).values())

    @cached_property
    def stroke_ranges(self) -> tuple[tuple[tuple[float, float], list[Fault]], ...]:
        """Of each cylinder, the range that it leaves its joint within the joint's limits, and what is wrong with it."""
        given = dict(zip(self.joints, self.joint_limits, strict=True))
        return tuple(
            usable_range(self.travel(cylinder), given[cylinder.joint], f"cylinders[{index}] ({cylinder.name})")
            for index, cylinder in enumerate(self.cylinders)
        )

    def part_faults(self) -> list[Fault]:
        """What is wrong with the cylinders' strokes, and what of loop and uncertainty does not go with the machine."""
        found = [fault for _, faults in self.stroke_ranges for fault in faults] + uncertainty_faults(
            self.uncertainty, self
        )
        return found if self.loop is None else found + loop_faults(self.loop, self, "loop.")

    @property
    def efforts(self) -> tuple[float, ...]:
        """Largest torque or force of the actuated joints either way, N m or N; infinite where none is given."""
        return tuple(body.joint.effort or float("inf") for body in self.kinematic_tree.actuated)

    @property
    def speeds(self) -> tuple[float, ...]:
        """Largest speed of the actuated joints either way, rad/s or m/s; infinite where none is given."""
        return tuple(body.joint.speed or float("inf") for body in self.kinematic_tree.actuated)

    @property
    @abstractmethod
    def support_points(self) -> tuple[tuple[float, ...], ...]:
        """What the undercarriage stands on, m, in the anchor frame; empty where none is given.

        In the plane the two ends (x,), rear first; in space the corners (x, y) of a convex polygon, counter-clockwise.
        """

    @property
    def visual_shapes(self) -> tuple[Visual, ...]:
        """What pictures draw of the bodies beside their capsules; empty where nothing is given."""
        return ()

    @property
    def damped_joints(self) -> bool:
        """Whether any actuated joint has friction."""
        return any(body.joint.joint_damping > 0 for body in self.kinematic_tree.actuated)

    @property
    def base_coordinates(self) -> tuple[str, ...]:
        """Names of the placement coordinates that the operator chooses."""
        return self.kinematic_tree.placement

    @property
    def base_units(self) -> tuple[str, ...]:
        """Unit of each placement coordinate, m or rad."""
        return tuple("rad" if name == "yaw" else "m" for name in self.base_coordinates)

    @property
    def task_rows(self) -> tuple[str, ...]:
        """Names of the end-point's coordinates: x, y, z, and in space roll, pitch, yaw."""
        return self.kinematic_tree.end_point.rows

    @abstractmethod
    def parameter_entries(self) -> list[NamedParameter]:
        """The parameters but those of cylinders, in order, and which of `KinematicTree.entries` each is."""

    def list_parameters(self) -> list[Parameter]:
        """The parameters but those of cylinders.

        Example:
            >>> machine = flexopt.load("excavator")
            >>> machine.list_parameters()[0]
            Parameter(name='base.length', value=0.541, unit='m')
        """
        return [parameter for _, parameter in self.parameter_entries()]

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameter vector p with this machine's values: geometry, inertia, springs, dampers, payload, gravity."""
        pins = [Parameter(name, value, "m") for c in self.cylinders for name, value in c.numbers().items()]
        return (*self.list_parameters(), *pins)

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 of the validated content: the same for two descriptions that say the same, however they look."""
        absent: dict[str, Any] = {name: True for name in ("loop", "uncertainty") if not getattr(self, name)}
        # Neither says anything of the mechanism.
        absent |= {"visuals": True, "capsules": {"__all__": {"label"}}}
        return hashlib.sha256(self.model_dump_json(by_alias=True, exclude=absent).encode()).hexdigest()

    @public(machine=lambda machine: machine, gravity=flag, loop=of_machine(check_loop))
    def at(
        self,
        posture: PostureLike,
        *,
        base: BaseLike | None = None,
        control: Control | None = None,
        gravity: bool = False,
        loop: LoopLike | None = None,
    ) -> Configuration:
        """Return the machine in one posture under one controller, which calls take in place of these arguments.

        Args:
            posture: actuated joints (n,), rad or m.
            base: placement (n_b,), m or rad; zeros by default.
            control: `"inverse"`, `"transpose"` or `"damped:LAMBDA"`; by default that of the loop.
            gravity: whether the weight acts.
            loop: `flexopt.Loop` or a dictionary of its fields; by default the machine's.

        Raises:
            InputError: a value of wrong shape, not finite or out of range; all faults in one message.

        Example:
            >>> here = flexopt.load("excavator").at((0.9929, -2.6306), base=0.5)
            >>> flexopt.evaluate(here).w.shape
            (3,)
        """
        place = np.zeros(len(self.base_coordinates)) if base is None else base
        return Configuration(self, cast(Any, posture), cast(Any, place), control, gravity, cast(Any, loop))

    @public(values=table)
    def with_values(self, values: Mapping[str, float]) -> Self:
        """Return the machine with other numbers, by names of `parameters`, in SI units.

        Raises:
            InputError: a name that `parameters` lacks, or a value that it cannot have.

        Example:
            >>> flexopt.load("excavator").with_values({"payload.mass": 300.0}).payload.mass
            300.0
        """
        return cast(Self, with_parameters(self, values))

    @property
    def described(self) -> Self:
        """Itself."""
        return self

    def _build_twin(self) -> Self:
        """The machine with NaN for all parameters that a key of its description holds alone.

        Its hash is of what is left: names, joints, axes, limits, capsules, cylinders, controller, uncertainty.
        """
        told = self.model_dump(by_alias=True)
        blank: dict[str | int, Any] = {}
        for name, _, _ in self.list_parameters():
            for *outer, last in places(told, name):
                inside = blank
                for key in outer:
                    inside = inside.setdefault(key, {})
                inside[last] = None
        twin: Self = _blanked(self, blank)
        for name in vars(twin).keys() - type(self).model_fields.keys():
            del vars(twin)[name]
        # JSON has one word, null, for NaN and for what is absent.
        known = [twin.content_hash, *(f"{name} {value}" for name, value, _ in twin.parameters)]
        vars(twin).update(content_hash=hashlib.sha256("\n".join(known).encode()).hexdigest())
        return twin

    def to_dict(self) -> Document:
        """The machine as a dictionary, keys at their defaults left out: what it was validated from takes it back.

        Example:
            >>> machine = flexopt.load("excavator")
            >>> machine.to_dict()["base"]["mass"]
            5291.5
            >>> flexopt.machine_from_dict(machine.to_dict()) == machine
            True
        """
        return self.model_dump(by_alias=True, exclude_defaults=True)

    def __hash__(self) -> int:
        return hash(self.content_hash)

    def __eq__(self, other: object) -> bool:
        # Field by field would take longer than many a call that looks for its machine among those it knows.
        if self is other or not isinstance(other, AnyMachine):
            return self is other
        # Constraints name capsules, of which the hash knows no labels.
        labels = [[capsule.label for capsule in machine.capsules] for machine in (self, other)]
        return type(self) is type(other) and self.content_hash == other.content_hash and labels[0] == labels[1]

    def __str__(self) -> str:
        return repr(self)


def _blanked(part: Any, keys: Mapping[str | int, Any] | None) -> Any:
    """A part of a description with NaN at these keys."""
    if keys is None:
        return math.nan
    if isinstance(part, tuple):
        parts = cast("tuple[Any, ...]", part)
        return tuple(_blanked(each, keys[i]) if i in keys else each for i, each in enumerate(parts))
    return part.model_copy(update={key: _blanked(getattr(part, str(key)), below) for key, below in keys.items()})


class OnMachine(BuiltByCall, Described):
    """A file that names the machine that it is about, and holds it once it is loaded.

    Attributes:
        machine: name of a shipped machine, or path of a machine file, from this file's folder.
    """

    LOADER: ClassVar[str]
    machine: str = Field(min_length=1)

    _loaded: AnyMachine | None = PrivateAttr(default=None)

    def with_machine(self, machine: AnyMachine) -> Self:
        """The same, holding its machine.

        Example:
            >>> problem = flexopt.load_problem("article")
            >>> heavy = problem.loaded_machine.to_dict() | {"payload": {"mass": 300.0}}
            >>> problem.with_machine(flexopt.machine_from_dict(heavy)).loaded_machine.payload.mass
            300.0
        """
        if not isinstance(machine, AnyMachine):  # pyright: ignore[reportUnnecessaryIsInstance]
            sentence = 'must be a Machine, from flexopt.load("excavator") for example'
            raise_if_any(InputError, "with_machine", [Fault("machine", sentence, shown(machine))])
        twin = self.model_copy()
        twin._loaded = machine
        return twin

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r} about machine {self.machine!r})"

    def __str__(self) -> str:
        return repr(self)

    @property
    def loaded_machine(self) -> AnyMachine:
        """The machine that the file names."""
        if self._loaded is None:
            raise ModelError(f"holds no machine: {self.LOADER} gives one that does, or with_machine")
        return self._loaded
