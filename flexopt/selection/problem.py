"""The configuration problem as a nonlinear program that can be inspected before it is solved."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from flexopt.errors import UnreachableTarget
from flexopt.model import AnyMachine, Machine
from flexopt.model.arguments import Arguments, Vector
from flexopt.model.problem import (
    ELBOWS,
    SINGULARITY_MARGIN_DEG,
    Control,
    Elbow,
    check_gain,
    check_margin_deg,
    check_seed,
    check_starts,
)
from flexopt.model.quantities import COORDINATE_MAX, check_pair
from flexopt.plant.reach import clipped, reach, unreachable
from flexopt.plant.statics import not_held
from flexopt.robustness.measures import Measures
from flexopt.selection.objective import Objective, Quantities, quantities, read_objectives
from flexopt.selection.scan import Scan, scan_redundancy

QUIET: dict[str, Any] = {"print_time": False, "error_on_fail": False}
IPOPT_OPTIONS: dict[str, Any] = QUIET | {
    "ipopt": {
        "print_level": 0,
        "sb": "yes",
        "tol": 1e-10,
        "constr_viol_tol": 1e-12,
        "acceptable_iter": 0,
        "max_iter": 200,
        "mu_init": 1e-4,
        "bound_relax_factor": 0.0,
    }
}
SQP_OPTIONS: dict[str, Any] = QUIET | {
    "qpsol": "qrqp",
    "qpsol_options": {"print_iter": False, "print_header": False, "print_info": False, "error_on_fail": False},
    "hessian_approximation": "limited-memory",
    "lbfgs_memory": 5,
    "print_header": False,
    "print_iteration": False,
    "print_status": False,
    "max_iter": 100,
    "tol_du": 1e-7,
    "tol_pr": 1e-10,
    "min_step_size": 1e-12,
}


@dataclass(frozen=True)
class Variable:
    """A decision variable: bounds and the scale that IPOPT sees it in, all in `unit`."""

    name: str
    unit: str
    lower: float
    upper: float
    scale: float


@dataclass(frozen=True)
class Constraint:
    """A constraint lower ≤ c(z) ≤ upper, divided by `scale` before IPOPT sees it."""

    name: str
    unit: str
    lower: float
    upper: float
    scale: float


@dataclass(frozen=True)
class SelectionProblem:
    """argmax V(z), V = Σ αi wi + β ε_max, over z = [base, posture] with r(z) = target (article, section 4).

    Attributes:
        machine, target: what is asked for; target (n_task,), m, inertial frame.
        objectives: what is maximised, in order of importance: each one among the configurations that keep those before.
        kept: values of V_1, V_2, … that a solution must keep, for the objectives before the one being solved.
        control, gravity, gain: as in `flexopt.evaluate`.
        variables: the placement, then the actuated joints.
        constraints: the target's rows, then the distance from singular postures as sin² of the margin.
        objective_scales: of each objective: typical |a||b| of its modes, or β of ε_max; V is divided by it before
            IPOPT sees it.
        scan: the redundancy seen coarsely; its peaks are the starts.
        present_base: where the machine stands now, for the tie-break and the initial posture, or None.
        elbow: branch of the initial posture.
        singularity_margin: rad.
        starts: how many peaks are tried at most, or None for the default;  seed: of the scan's sample.
    """

    machine: Machine
    target: Vector
    objectives: tuple[Objective, ...]
    kept: tuple[float, ...]
    control: Control
    gravity: bool
    gain: float
    variables: tuple[Variable, ...]
    constraints: tuple[Constraint, ...]
    objective_scales: tuple[float, ...]
    scan: Scan = field(repr=False)
    present_base: Vector | None
    elbow: Elbow
    singularity_margin: float
    starts: int | None
    seed: int

    @property
    def quantities(self) -> Quantities:
        """The Functions that the objectives are made of."""
        return quantities(self.machine, self.control, self.gravity, self.gain)

    @property
    def measures(self) -> Measures:
        """The measures' Functions of this problem."""
        return self.quantities.measures

    @property
    def name(self) -> str:
        """Names of the objectives, in order."""
        return ",".join(objective.name for objective in self.objectives)

    @property
    def objective(self) -> Objective:
        """The objective being solved: the first whose value is not kept."""
        return self.objectives[len(self.kept)]

    @property
    def objective_scale(self) -> float:
        """Its scale."""
        return self.objective_scales[len(self.kept)]

    @property
    def lower(self) -> Vector:
        """Lower bounds of z."""
        return np.array([v.lower for v in self.variables])

    @property
    def upper(self) -> Vector:
        """Upper bounds of z."""
        return np.array([v.upper for v in self.variables])

    @property
    def shift(self) -> tuple[Vector, Vector]:
        """Shifts of z (n_z,) and of the target (n_task,), m, that put the target at the origin for IPOPT.

        Moving placement and target together changes nothing else; far from the inertial origin the last digits of their
        difference would be lost.
        """
        of_z, of_target = np.zeros(len(self.variables)), np.zeros(self.target.size)
        axes = {"base.x": 0, "base.y": 1, "base.z": 2}
        for k, variable in enumerate(self.variables):
            if variable.name in axes:
                axis = axes[variable.name]
                of_z[k] = of_target[axis] = self.target[axis]
        return of_z, of_target

    @property
    def scale(self) -> Vector:
        """Scales of z."""
        return np.array([v.scale for v in self.variables])

    def solver(self) -> ca.Function:
        """IPOPT on this problem: x = (z − shift) / scale, exact Hessian; its parameter: shifted target, then p."""
        return build_solver(
            (self.machine, self.control, self.gravity, self.gain),
            self.objectives[: len(self.kept) + 1],
            self.objective_scales,
            tuple(self.scale.tolist()),
        )

    def to_dict(self) -> dict[str, Any]:
        """Target, objective, variables with bounds, constraints."""
        return {
            "target": self.target.tolist(),
            "objective": self.name,
            "weights": self.objectives[0].weights.tolist(),
            "objective_scale": self.objective_scales[0],
            "objectives": [
                {"name": objective.name, "weights": objective.weights.tolist(), "scale": size}
                for objective, size in zip(self.objectives, self.objective_scales, strict=True)
            ],
            "control": self.control,
            "gravity": self.gravity,
            "variables": [vars(v) for v in self.variables],
            "constraints": [vars(c) for c in self.constraints],
            "gain": self.gain,
            "singularity_margin": self.singularity_margin,
            "present_base": None if self.present_base is None else self.present_base.tolist(),
            "starts": self.starts,
            "seed": self.seed,
            "scanned_points": self.scan.size,
        }


def build_selection(
    machine: AnyMachine,
    target: Any,
    *,
    objective: str = "w1",
    control: Control = "inverse",
    weights: Sequence[float] | None = None,
    gravity: bool = False,
    gain: float = 5e5,
    base: Any = None,
    base_range: tuple[float, float] | None = None,
    elbow: Elbow = "up",
    singularity_margin_deg: float = SINGULARITY_MARGIN_DEG,
    starts: int | None = None,
    seed: int = 0,
) -> SelectionProblem:
    """Set up the choice of placement and posture for a target of the end-point.

    Args:
        machine: from `flexopt.load`.
        target: end-point (2,), m, inertial frame.
        objective: `"w1"`, `"w2"`, …, `"epsilon_max"`, or `"V"` = Σ αi wi + β ε_max; or several in order of importance,
            separated by commas: `"w1,epsilon_max"` maximises ε_max among the configurations that keep the best w1.
        control: Jacobian `"inverse"` or `"transpose"`.
        weights: α of `"V"`, one for each mode, and β after them where ε_max shall take part.
        gravity: measures and end-point under static deflection.
        gain: servo gain kr of ε_max.
        base: present placement x, m: breaks ties and gives the initial posture.
        base_range: (lower, upper) of the placement, m; all placements from which the arm reaches by default.
        elbow: branch of the initial posture.
        singularity_margin_deg: distance from singular postures: for two links the angle that θ3 keeps from straight and
            from folded, for more in the root mean square over pairs of segments.
        starts: how many starts IPOPT tries at most; by default every peak of the scan, up to 64.
        seed: of the scan where the redundancy has two degrees and more.

    Raises:
        InputError: arguments of wrong shape, not finite or out of range, all in one message.
        UnreachableTarget: no placement in the range reaches the target inside limits and margin.
    """
    arguments = Arguments("select")
    machine = arguments.planar(machine)
    point = arguments.point(target, "target")
    control = arguments.control(control)
    arguments.choice("elbow", elbow, ELBOWS)
    arguments.flag("gravity", gravity)
    kr = arguments.checked("gain", gain, check_gain, 1.0)
    present = None if base is None else arguments.base(machine, base)
    if base_range is not None:
        base_range = arguments.checked(
            "base_range",
            base_range,
            lambda v: check_pair(v, "m", -COORDINATE_MAX, COORDINATE_MAX, allow_equal=True),
            (0.0, 1.0),
        )
    margin = math.radians(arguments.checked("singularity_margin_deg", singularity_margin_deg, check_margin_deg, 10.0))
    if starts is not None:
        arguments.checked("starts", starts, check_starts, 1)
    arguments.checked("seed", seed, check_seed, 0)
    objectives = read_objectives(arguments, machine, objective, weights)
    arguments.done()

    functions = quantities(machine, control, gravity, kr)
    measures, plant = functions.measures, functions.measures.plant
    annulus = reach(plant, margin)
    intervals = annulus.base_intervals(point)
    if not intervals:
        raise unreachable(plant, point, None, margin=margin)
    if base_range is None:
        # Beyond the margin's own ends, so that the margin and not the range is what stops the base.
        whole = reach(plant).base_intervals(point)
        base_range = (whole[0][0], whole[-1][1])
    scan = scan_redundancy(functions, point, clipped(intervals, base_range), objectives[0], math.sin(margin) ** 2, seed)
    if scan.size == 0 and scan.unsound:
        raise not_held()
    if scan.size == 0:
        raise _why_unreachable(measures, point, base_range, margin, scan.reached)
    factors = measures.w.call([scan.base, scan.posture, plant.parameter_values])[1].full()
    scales = tuple(float(np.median(o.alpha @ factors)) + o.beta or 1.0 for o in objectives)
    variables = [Variable(f"base.{name}", "m", *base_range, annulus.outer) for name in machine.base_coordinates]
    variables += [
        Variable(name, "rad", low, high, 1.0) for name, (low, high) in zip(machine.joints, machine.limits, strict=True)
    ]
    constraints = [
        Constraint(f"target {axis}", "m", value, value, annulus.outer)
        for axis, value in zip("xyz", point.tolist(), strict=False)
    ]
    constraints.append(Constraint("singularity margin", "sin²", math.sin(margin) ** 2, math.inf, 1.0))
    return SelectionProblem(
        machine=machine,
        target=point,
        objectives=objectives,
        kept=(),
        control=control,
        gravity=gravity,
        gain=kr,
        variables=tuple(variables),
        constraints=tuple(constraints),
        objective_scales=scales,
        scan=scan,
        present_base=present,
        elbow=elbow,
        singularity_margin=margin,
        starts=starts,
        seed=seed,
    )


def _why_unreachable(
    measures: Measures, target: Vector, base_range: tuple[float, float], margin: float, reached: bool
) -> UnreachableTarget:
    """The error when no point of the redundancy was left."""
    plant = measures.plant
    if reached:
        why = (
            "every posture that reaches it breaks a joint limit or comes closer than "
            f"{math.degrees(margin):.4g}° to a singular posture"
        )
        return unreachable(plant, target, None, why, margin)
    annulus = reach(plant, margin)
    nearest = min(
        (np.array([np.clip(x, *base_range)]) for span in annulus.base_intervals(target) for x in span),
        key=lambda b: annulus.miss(target, b),
        default=np.array([np.clip(target[0] - annulus.center[0], *base_range)]),
    )
    return unreachable(plant, target, nearest, margin=margin)


@lru_cache(maxsize=32)
def build_solver(
    what: tuple[Machine, Control, bool, float],
    objectives: tuple[Objective, ...],
    objective_scales: tuple[float, ...],
    scale: tuple[float, ...],
) -> ca.Function:
    """Minimise −V in scaled variables (kept between calls); the objectives before the last are constraints.

    IPOPT with exact Hessian where everything is smooth. Where ε_max takes part, V is the smaller of two branches, and
    the largest t below both is sought (epigraph) by sequential quadratic programming: its subproblem sees both
    branches, so that a step near a kink does not depend on which of them is the smaller one just now.
    """
    functions = quantities(*what)
    plant = functions.measures.plant
    n_z, last = plant.n_base + plant.n_actuated, objectives[-1]
    x = ca.MX.sym("x", n_z + (1 if last.has_kinks else 0))
    parameters = ca.MX.sym("parameters", plant.n_task + len(plant.parameter_names))
    target, p = parameters[: plant.n_task], parameters[plant.n_task :]
    z = x[:n_z] * ca.DM(list(scale))
    base, posture = z[: plant.n_base], z[plant.n_base :]
    end_point = functions.measures.nested.call([base, posture, p])[1]
    constraints = [(end_point - target) / scale[0], plant.singularity_sine_squared(base, posture, p)]
    for objective, size in zip(objectives[:-1], objective_scales, strict=False):
        constraints += [branch / size for branch in functions.expression(objective, base, posture, p)]
    branches = [b / objective_scales[len(objectives) - 1] for b in functions.expression(last, base, posture, p)]
    if last.has_kinks:
        constraints += [branch - x[n_z] for branch in branches]
    nlp = {"x": x, "p": parameters, "f": -x[n_z] if last.has_kinks else -branches[0], "g": ca.vertcat(*constraints)}
    if any(objective.has_kinks for objective in objectives):
        return ca.nlpsol("selection", "sqpmethod", nlp, SQP_OPTIONS)
    return ca.nlpsol("selection", "ipopt", nlp, IPOPT_OPTIONS)
