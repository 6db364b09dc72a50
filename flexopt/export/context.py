"""What the parts of a bundle are built from: the plant, the options, array sizes, ranges, inputs that several share.

In: a machine and the options of an export. Out: a `Context`, which turns graphs into an `Operation`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from flexopt.export.operations import Field, Guard, Operation, Parameters, Sizes
from flexopt.model import AnyMachine, Machine
from flexopt.model.machine import Parameter
from flexopt.model.problem import Control
from flexopt.model.quantities import ANGLE_MAX, COORDINATE_MAX, LENGTH_MAX
from flexopt.plant import Plant, build_plant
from flexopt.robustness.measures import Measures, build_measures

# Smallest positive normal number in single precision: what must be greater than 0 is at least this.
POSITIVE = 1.1754944e-38
# In single precision modes lose too many digits nearer than this to singular postures.
SINGLE_SINE = math.sin(math.radians(10.0))

_PARAMETER_RANGES = {
    "length": (POSITIVE, LENGTH_MAX), "com": (-LENGTH_MAX, LENGTH_MAX), "com_offset": (-LENGTH_MAX, LENGTH_MAX),
    "mass": (POSITIVE, 1e9), "inertia": (POSITIVE, 1e15), "stiffness": (POSITIVE, 1e15), "damping": (0.0, 1e12),
    "joint_damping": (0.0, 1e12), "rest": (-ANGLE_MAX, ANGLE_MAX), "rest_angle": (-ANGLE_MAX, ANGLE_MAX),
    "base.length": (0.0, LENGTH_MAX), "payload.mass": (0.0, 1e9), "gravity": (0.0, 1e3),
}  # fmt: skip


@dataclass(frozen=True)
class Context:
    """What the parts are built from.

    Attributes:
        plant: the machine's plant.
        control: of the measures, of the nullspace step and of ε_max.
        gain: servo gain kr about which ε_max is tested.
        single: whether the C code computes in single precision.
        baked: whether the machine's parameters become constants.
        singularity_margin: smallest mean sine of the angles between the arm's segments.
    """

    plant: Plant
    control: Control
    gain: float
    single: bool
    baked: bool
    singularity_margin: float

    @property
    def machine(self) -> AnyMachine:
        """The machine."""
        return self.plant.machine

    @cached_property
    def sizes(self) -> Sizes:
        """Array sizes by name."""
        plant = self.plant
        return Sizes(
            {
                "TASK": plant.n_task,
                "COORDINATES": plant.n_coordinates,
                "JOINTS": plant.n_actuated,
                "PLACEMENT": plant.n_base,
                "CHOICE": plant.n_base + plant.n_actuated,
                "MODES": plant.n_passive,
            }
        )

    @cached_property
    def parameters(self) -> Parameters:
        """The machine's parameters and their ranges."""
        listed = self.machine.parameters
        low, high = zip(*(parameter_range(p) for p in listed), strict=True)
        names, values, units = zip(*listed, strict=True)
        return Parameters(names, units, values, low, high, self.single)

    @cached_property
    def measures(self) -> Measures:
        """The measures w_i."""
        return build_measures(self.machine, self.control)

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
        """The actuated joints as an input."""
        low, high = zip(*((max(a, -ANGLE_MAX), min(b, ANGLE_MAX)) for a, b in self.machine.limits), strict=True)
        near = (tuple(max(a, -math.pi) for a in low), tuple(min(b, math.pi) for b in high))
        text = "angles of the actuated joints, each relative to the body before it"
        return self.sizes.field("joint_angles", "JOINTS", "rad", text, low=low, high=high, sample=near)

    @cached_property
    def placement(self) -> Field:
        """Where the base stands, as an input."""
        text = "where the base stands, inertial frame"
        limit = COORDINATE_MAX
        return self.sizes.field("placement", "PLACEMENT", "m", text, low=-limit, high=limit, sample=(-2.0, 2.0))

    def regular(self, *, modal: bool = False) -> Guard:
        """The arm is far enough from a singular posture; for what stands on modes, farther in single precision."""
        sine = SINGLE_SINE if modal and self.single else 0.0
        return Guard(
            "sine_squared",
            "squared mean sine of the angles between the arm's segments, 0 where Jv loses rank",
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
        fields = [field for field, _ in inputs]
        symbols = [symbol for _, symbol in inputs]
        if self.placement_matters and "placement" not in [field.name for field in fields]:
            fields, symbols = [*fields, self.placement], [*symbols, g.base]
        names = [field.name for field in fields]
        # Row-major, as C has it.
        results = [ca.densify(ca.vec(graph.T)) for _, graph, _ in outputs] + [graph for _, graph in guards]
        result_names = [field.name for field, _, _ in outputs] + [guard.name for guard, _ in guards]
        kernel = self._function(name, symbols, results, names, result_names)
        sizes = [ca.densify(size) for _, _, size in outputs]
        scales = self._function(f"{name}_scales", symbols, sizes, names, result_names[: len(outputs)])
        return Operation(
            name, text, tuple(fields), tuple(field for field, _, _ in outputs), tuple(guard for guard, _ in guards),
            kernel, scales,
        )  # fmt: skip

    def _function(
        self, name: str, symbols: list[ca.SX], graphs: list[ca.SX], names: list[str], results: list[str]
    ) -> ca.Function:
        p = self.plant.graph.p
        options = {"cse": True}
        if self.baked:
            values = ca.SX(self.plant.parameter_values)
            constants = [ca.substitute(graph, p, values) for graph in graphs]
            return ca.Function(name, symbols, constants, names, results, options)
        return ca.Function(name, [*symbols, p], graphs, [*names, "p"], results, options)


def parameter_range(parameter: Parameter) -> tuple[float, float]:
    """Allowed range of a machine's parameter, as in a machine file."""
    parts = parameter.name.split(".")
    if parts[0] == "base" and len(parts) == 3:
        return _PARAMETER_RANGES[parts[1]]
    return _PARAMETER_RANGES.get(parameter.name) or _PARAMETER_RANGES[parts[-1]]


def build_context(
    machine: Machine, *, control: Control, gain: float, single: bool, baked: bool, singularity_margin_deg: float
) -> Context:
    """What the parts of this machine are built from."""
    sine = math.sin(math.radians(singularity_margin_deg))
    return Context(build_plant(machine), control, gain, single, baked, sine)


def sine_squared(at: Context) -> ca.SX:
    """The plant's distance from singular postures, for `Context.regular`."""
    return at.plant.singularity_sine_squared(at.base, at.plant.graph.posture, at.plant.graph.p)
