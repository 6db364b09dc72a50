"""What the parts of a bundle are built from: the plant, the options, array sizes, ranges, inputs that several share.

In: a machine and the options of an export. Out: a `Context`, which turns graphs into an `Operation`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, cast

import casadi as ca
import numpy as np

from flexopt.export.operations import Field, Guard, Operation, Parameters, operation_of
from flexopt.foundation.control import Control
from flexopt.foundation.quantities import COORDINATE_MAX, coordinate_max
from flexopt.loop.settings import LoopSettings
from flexopt.model import AnyMachine
from flexopt.model.parameter_ranges import parameter_range
from flexopt.plant import Plant, build_plant
from flexopt.robustness.measures import Measures

# In single precision modes lose too many digits nearer than this to singular postures, degrees.
SINGLE_MARGIN_DEG = 10.0

# How far measured joints may lie beyond the machine's limits, degrees and m: above what sensors are calibrated to, end
# stops give and a loop overshoots, below what a sensor that lost its count or its wire shows.
LIMIT_ALLOWANCE_DEG, LIMIT_ALLOWANCE_M = 5.0, 0.05
# How far angles that turn freely may have been counted on, rad: single precision still tells 6e-5 rad there.
TURNED_MAX = {False: 1e6, True: 1e3}

# How far a parameter that is 0 is drawn from it.
AWAY_FROM_ZERO = {"m": 0.02, "rad": 0.02}
# Samples of a joint or a placement coordinate without limits: a turn, or as far each way, m.
NEAR = {"rad": math.pi, "m": 2.0}


@dataclass(frozen=True)
class Context:
    """What the parts are built from.

    Attributes:
        plant: the machine's plant.
        control: of the measures, of the nullspace step and of ε_max.
        gain: servo gain kr about which ε_max is tested.
        single: whether the C code computes in single precision.
        baked: whether the machine's parameters become constants.
        singularity_margin: square root of the smallest `Plant.singularity_sine_squared`.
        limit_allowance: unit -> how far measured joints may lie beyond their limits, rad and m.
        judged_loop: the real controller and what it does in a posture, from `judged_loop`; None where none was given.
    """

    plant: Plant
    control: Control
    gain: float
    single: bool
    baked: bool
    singularity_margin: float
    limit_allowance: Mapping[str, float]
    judged_loop: Mapping[str, Any] | None = None

    @cached_property
    def loop(self) -> LoopSettings | None:
        """The numbers of the real controller."""
        if self.judged_loop is None:
            return None
        entries = cast("dict[str, Any]", self.judged_loop["settings"])
        own = {each.name: entries[each.name] for each in fields(LoopSettings)}
        numbers: dict[str, Any] = {name: np.array(cast(Any, x)) for name, x in own.items() if isinstance(x, list)}
        numbers["joint_units"] = tuple(own["joint_units"])
        return LoopSettings(**own | numbers)

    @property
    def machine(self) -> AnyMachine:
        """The machine."""
        return self.plant.machine

    @cached_property
    def sizes(self) -> dict[str, int]:
        """Array sizes by name."""
        plant = self.plant
        return {
            "TASK": plant.n_task,
            "COORDINATES": plant.n_coordinates,
            "JOINTS": plant.n_actuated,
            "PLACEMENT": plant.n_base,
            "CHOICE": plant.n_base + plant.n_actuated,
            "MODES": plant.n_passive,
        }

    def field(
        self,
        name: str,
        dimensions: str,
        unit: str,
        text: str,
        *,
        low: float | tuple[float, ...] = 0.0,
        high: float | tuple[float, ...] = 0.0,
        sample: tuple[float | tuple[float, ...], float | tuple[float, ...]] | None = None,
        logarithmic: bool = False,
        design: tuple[tuple[float, ...], tuple[float, ...]] | None = None,
        turning: tuple[bool, ...] = (),
        scale: str = "",
    ) -> Field:
        """A field whose dimensions are given by name, `"TASK JOINTS"`; numbers stand for all elements."""
        names = tuple(dimensions.split())
        shape = tuple(self.sizes[n] for n in names)
        length = math.prod(shape)

        def spread(value: float | tuple[float, ...]) -> tuple[float, ...]:
            return value if isinstance(value, tuple) else (value,) * length

        drawn = None if sample is None else (spread(sample[0]), spread(sample[1]))
        return Field(
            name, names, shape, unit, text, spread(low), spread(high), drawn, logarithmic, design, turning, scale
        )

    @property
    def choice(self) -> tuple[str, ...]:
        """Names of the variables z: the placement, then the actuated joints."""
        machine = self.machine
        return (*(f"base.{name}" for name in machine.base_coordinates), *machine.joints)

    @property
    def choice_units(self) -> tuple[str, ...]:
        """Unit of each, m or rad."""
        return (*self.machine.base_units, *self.machine.joint_units)

    @cached_property
    def parameters(self) -> Parameters:
        """The machine's parameters and their ranges."""
        listed = self.machine.parameters
        low, high = zip(*(parameter_range(p) for p in listed), strict=True)
        names, values, units = zip(*listed, strict=True)
        spread = tuple(0.2 * abs(p.value) if p.value else AWAY_FROM_ZERO.get(p.unit, 0.0) for p in listed)
        return Parameters(names, units, values, low, high, spread, self.single)

    @cached_property
    def measures(self) -> Measures:
        """The measures w_i."""
        return Measures(self.plant, self.control, False)

    @cached_property
    def placement_matters(self) -> bool:
        """Whether the inertia or the Jacobian at rest depend on where the base stands; in the plane they do not."""
        g = self.plant.graph
        at = self.plant.operating_point(g.base, g.posture, g.p)
        return ca.depends_on(ca.veccat(at.mass, at.jacobian), g.base)

    @property
    def base(self) -> ca.SX:
        """Placement for what does not depend on it, unless it does."""
        return self.plant.graph.base if self.placement_matters else ca.SX.zeros(self.plant.n_base, 1)

    @cached_property
    def joint_angles(self) -> Field:
        """The actuated joints as an input: measurements."""
        units, limits = self.machine.joint_units, self.machine.limits
        most = [self.counted_max(unit) for unit in units]
        design = _transposed(
            [self._stored(max(low, -far), min(high, far)) for far, (low, high) in zip(most, limits, strict=True)]
        )
        wide = [
            self._stored(max(low - self.limit_allowance[unit], -far), min(high + self.limit_allowance[unit], far))
            for unit, far, (low, high) in zip(units, most, limits, strict=True)
        ]
        low, high = _transposed(wide)
        near = _transposed([_near(unit, *pair) for unit, *pair in zip(units, *design, strict=True)])
        turning = tuple(unit == "rad" and not np.isfinite(pair).any() for unit, pair in zip(units, limits, strict=True))
        text = "actuated joints, each relative to the body before it"
        return self.field("joint_angles", "JOINTS", unit_list(units), text, low=low, high=high, sample=near,
                          design=design, turning=turning)  # fmt: skip

    def counted_max(self, unit: str) -> float:
        """How far a coordinate in m or rad may be from zero where angles count on from turn to turn."""
        return TURNED_MAX[self.single] if unit == "rad" else COORDINATE_MAX

    def _stored(self, *values: float) -> tuple[float, ...]:
        """Numbers as the bundle's precision holds them."""
        return tuple(float(np.float32(value)) if self.single else float(value) for value in values)

    @cached_property
    def placement(self) -> Field:
        """Where the base stands, as an input; only for machines that can be placed."""
        units = self.machine.base_units
        limit = self._stored(*(self.counted_max(unit) for unit in units))
        near = _transposed([_near(unit, -high, high) for unit, high in zip(units, limit, strict=True)])
        turning = tuple(unit == "rad" for unit in units)
        text = "where the base stands, inertial frame"
        return self.field("placement", "PLACEMENT", unit_list(units), text, low=tuple(-x for x in limit),
                          high=limit, sample=near, turning=turning)  # fmt: skip

    def coordinates(self, away: float, *, measured: bool) -> Field:
        """All coordinates q as an input; samples of the passive ones lie up to `away` (m or rad) from rest.

        Measured joints have their limits; those of a simulation go where it takes them, and count on.
        """
        plant, joints = self.plant, self.joint_angles
        assert joints.sample is not None
        m, units = plant.n_passive, plant.graph.coordinate_units
        middle = np.mean(joints.sample, axis=0)
        rest = plant.rest.call([ca.DM.zeros(plant.n_base, 1), ca.DM(middle), plant.parameter_values])[0]
        passive = [float(x) for x in rest.full().ravel()[:m]]
        free = (*(coordinate_max(unit) for unit in units[:m]), *(self.counted_max(unit) for unit in units[m:]))
        high = self._stored(*free)
        low, design, turning = tuple(-x for x in high), None, ()
        if measured:
            assert joints.design is not None
            low, high = (*low[:m], *joints.low), (*high[:m], *joints.high)
            design = ((*low[:m], *joints.design[0]), (*high[:m], *joints.design[1]))
            turning = (*(False for _ in range(m)), *joints.turning)
        near = tuple((*(x + side * away for x in passive), *joints.sample[side > 0]) for side in (-1, 1))
        text = f"q = [passive; actuated]: displacements in m, relative angles in rad{self._counted(middle)}"
        sample = (near[0], near[1])
        return self.field("coordinates", "COORDINATES", unit_list(units), text, low=low, high=high, sample=sample,
                          design=design, turning=turning)  # fmt: skip

    def _counted(self, posture: Any) -> str:
        """Which coordinates count from where the placement does, and so hold it; and what is not 0 at rest."""
        plant, names = self.plant, self.machine.coordinates
        here, there = (
            plant.rest.call([ca.DM(base), ca.DM(posture), plant.parameter_values])[0].full().ravel()
            for base in (np.zeros(plant.n_base), np.ones(plant.n_base))
        )
        moved = [name for name, shift in zip(names, there - here, strict=False) if abs(shift) > 0.5]
        told = f"; {', '.join(moved)} in the inertial frame: at rest where the base is placed" if moved else ""
        # As of a link that stands upright.
        turned = {name: x for name, x in zip(names, here[: plant.n_passive].tolist(), strict=False) if x}
        return told + "".join(f"; {name} at rest {x:.9g}" for name, x in turned.items() if name not in moved)

    @cached_property
    def arm_length(self) -> float:
        """Length of the bodies from joint to joint with the joints at 0, m: a measure of the machine's size."""
        plant, p, base = self.plant, self.plant.parameter_values, ca.DM.zeros(self.plant.n_base, 1)
        rest = plant.rest.call([base, ca.DM.zeros(plant.n_actuated, 1), p])[0]
        points = plant.skeleton.call([rest, base, p])[0].full()
        return float(np.linalg.norm(np.diff(points[:, 1:], axis=1), axis=0).sum())

    def regular(self, *, modal: bool = False) -> Guard:
        """The arm is far enough from a singular posture; for what stands on modes, farther in single precision."""
        sine = math.sin(math.radians(SINGLE_MARGIN_DEG)) if modal and self.single else 0.0
        return Guard(
            "sine_squared",
            "distance from singular postures as a squared mean sine: at most 1, and 0 where Jv loses rank",
            "SINGULAR_POSTURE",
            minimum=max(self.singularity_margin, sine) ** 2,
        )

    def operation(
        self,
        name: str,
        text: str,
        inputs: list[tuple[Field, ca.SX]],
        outputs: list[tuple[Field, ca.SX, ca.SX]],
        guards: list[tuple[Guard, ca.SX]],
    ) -> Operation:
        """An operation from graphs: inputs with their symbols, outputs with their graphs and sizes."""
        g = self.plant.graph
        if self.placement_matters and "placement" not in [field.name for field, _ in inputs]:
            inputs = [*inputs, (self.placement, g.base)]

        def known(graph: ca.SX) -> ca.SX:
            return ca.substitute(graph, g.p, ca.SX(self.plant.parameter_values)) if self.baked else graph

        # Row-major, as C has it.
        results = [
            (field, known(ca.densify(ca.vec(graph.T))), known(ca.densify(size))) for field, graph, size in outputs
        ]
        checked, p = [(guard, known(graph)) for guard, graph in guards], [] if self.baked else [g.p]
        return operation_of(name, text, inputs, p, results, checked, {"cse": True})


def build_context(
    machine: AnyMachine,
    *,
    control: Control,
    gain: float,
    single: bool,
    baked: bool,
    singularity_margin_deg: float,
    limit_allowance_deg: float = LIMIT_ALLOWANCE_DEG,
    limit_allowance_m: float = LIMIT_ALLOWANCE_M,
    loop: Mapping[str, Any] | None = None,
) -> Context:
    """What the parts of this machine are built from."""
    sine = math.sin(math.radians(singularity_margin_deg))
    allowance = {"rad": math.radians(limit_allowance_deg), "m": limit_allowance_m}
    return Context(build_plant(machine), control, gain, single, baked, sine, allowance, loop)


def sine_squared(at: Context) -> ca.SX:
    """The plant's distance from singular postures, for `Context.regular`."""
    return at.plant.singularity_sine_squared(at.base, at.plant.graph.posture, at.plant.graph.p)


def _near(unit: str, low: float, high: float) -> tuple[float, float]:
    """The part of a range that is near 0, or near its own end."""
    near = NEAR[unit]
    below, above = max(low, -near), min(high, near)
    if below < above:
        return below, above
    return (low, min(high, low + near)) if low > 0 else (max(low, high - near), high)


def _transposed(pairs: Sequence[tuple[float, ...]]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    return tuple(low for low, _ in pairs), tuple(high for _, high in pairs)


def unit_list(units: Sequence[str], pattern: str = "{}") -> str:
    """Units of a vector, each once."""
    return ", ".join(pattern.format(unit) for unit in dict.fromkeys(units))
