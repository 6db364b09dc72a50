"""The configuration problem as a nonlinear program that can be inspected before it is solved."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from flexopt.errors import Fault, UnreachableTarget
from flexopt.model import Machine
from flexopt.model.arguments import Arguments, Vector
from flexopt.model.problem import (
    ELBOWS,
    SINGULARITY_MARGIN_DEG,
    Control,
    Elbow,
    check_gain,
    check_margin_deg,
    check_objective,
    check_seed,
    check_starts,
    check_weights,
)
from flexopt.model.quantities import COORDINATE_MAX, check_pair
from flexopt.plant.reach import clipped, reach, unreachable
from flexopt.plant.statics import not_held
from flexopt.robustness.measures import Measures, build_measures
from flexopt.selection.scan import Scan, scan_redundancy


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
    """argmax V(z), V = Σ αi wi, over z = [base, posture] with r(z) = target (article, section 4).

    Attributes:
        machine, target: what is asked for; target (n_task,), m, inertial frame.
        objective: its name, `"w1"`, …, or `"V"`;  weights: α, (m,).
        control, gravity, gain: as in `flexopt.evaluate`.
        variables: the placement, then the actuated joints.
        constraints: the target's rows, then the distance from singular postures as sin² of the margin.
        objective_scale: typical |a||b| of the modes in V; V is divided by it before IPOPT sees it.
        scan: the redundancy seen coarsely; its peaks are the starts.
        present_base: where the machine stands now, for the tie-break and the initial posture, or None.
        elbow: branch of the initial posture.
        singularity_margin: rad.
        starts: how many peaks are tried at most, or None for the default;  seed: of the scan's sample.
    """

    machine: Machine
    target: Vector
    objective: str
    weights: Vector
    control: Control
    gravity: bool
    gain: float
    variables: tuple[Variable, ...]
    constraints: tuple[Constraint, ...]
    objective_scale: float
    scan: Scan = field(repr=False)
    present_base: Vector | None
    elbow: Elbow
    singularity_margin: float
    starts: int | None
    seed: int

    @property
    def measures(self) -> Measures:
        """The measures' Functions of this problem."""
        return build_measures(self.machine, self.control, self.gravity)

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
            self.machine,
            self.control,
            self.gravity,
            tuple(self.weights.tolist()),
            tuple(self.scale.tolist()),
            self.objective_scale,
        )

    def to_dict(self) -> dict[str, Any]:
        """Target, objective, variables with bounds, constraints."""
        return {
            "target": self.target.tolist(),
            "objective": self.objective,
            "weights": self.weights.tolist(),
            "control": self.control,
            "gravity": self.gravity,
            "variables": [vars(v) for v in self.variables],
            "constraints": [vars(c) for c in self.constraints],
            "objective_scale": self.objective_scale,
            "singularity_margin": self.singularity_margin,
            "present_base": None if self.present_base is None else self.present_base.tolist(),
            "starts": self.starts,
            "seed": self.seed,
            "scanned_points": self.scan.size,
        }


def build_selection(
    machine: Machine,
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
        objective: `"w1"`, `"w2"`, … or `"V"` = Σ αi wi.
        control: Jacobian `"inverse"` or `"transpose"`.
        weights: α of `"V"`, one for each mode.
        gravity: measures and end-point under static deflection.
        gain: servo gain kr, for ε_max in the candidates' evaluations.
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
    machine = arguments.machine(machine)
    point = arguments.point(target, "target")
    control = arguments.control(control)
    arguments.choice("elbow", elbow, ELBOWS)
    arguments.flag("gravity", gravity)
    kr = arguments.checked("gain", gain, check_gain, 1.0)
    present = None if base is None else arguments.base(base)
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
    alpha = _weights(arguments, machine, objective, weights)
    arguments.done()

    measures = build_measures(machine, control, gravity)
    plant = measures.plant
    annulus = reach(plant, margin)
    intervals = annulus.base_intervals(point)
    if not intervals:
        raise unreachable(plant, point, None, margin=margin)
    if base_range is None:
        # Beyond the margin's own ends, so that the margin and not the range is what stops the base.
        whole = reach(plant).base_intervals(point)
        base_range = (whole[0][0], whole[-1][1])
    scan = scan_redundancy(measures, point, clipped(intervals, base_range), alpha, math.sin(margin) ** 2, seed)
    if scan.size == 0 and scan.unsound:
        raise not_held()
    if scan.size == 0:
        raise _why_unreachable(measures, point, base_range, margin, scan.reached)
    factors = measures.w.call([scan.base, scan.posture, plant.parameter_values])[1].full()
    objective_scale = float(np.median(alpha @ factors)) or 1.0
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
        objective=objective,
        weights=alpha,
        control=control,
        gravity=gravity,
        gain=kr,
        variables=tuple(variables),
        constraints=tuple(constraints),
        objective_scale=objective_scale,
        scan=scan,
        present_base=present,
        elbow=elbow,
        singularity_margin=margin,
        starts=starts,
        seed=seed,
    )


def _weights(arguments: Arguments, machine: Machine, objective: Any, weights: Any) -> Vector:
    """α of the objective, (m,)."""
    m = build_measures(machine).plant.n_passive
    name = arguments.checked("objective", objective, check_objective, "w1")
    if name != "V":
        if weights is not None:
            arguments.faults.append(Fault("weights", f"go with objective V only, not with {name}", str(weights)))
        mode = int(name[1:])
        if mode > m:
            arguments.faults.append(Fault("objective", f"{machine.name} has {m} modes: w1 to w{m}, or V", repr(name)))
            mode = 1
        return np.eye(m)[mode - 1]
    if weights is None:
        arguments.faults.append(Fault("weights", f"objective V needs {m} of them, one for each mode"))
        return np.ones(m)
    alpha = np.array(arguments.checked("weights", weights, check_weights, (1.0,) * m))
    if alpha.size != m:
        arguments.faults.append(
            Fault("weights", f"{machine.name} has {m} modes, so {m} weights are needed", str(weights))
        )
        return np.ones(m)
    return alpha


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
    machine: Machine,
    control: Control,
    gravity: bool,
    weights: tuple[float, ...],
    scale: tuple[float, ...],
    objective_scale: float,
) -> ca.Function:
    """IPOPT with exact Hessian on min −V / objective_scale in x = z / scale (kept between calls)."""
    measures = build_measures(machine, control, gravity)
    plant = measures.plant
    x = ca.MX.sym("x", plant.n_base + plant.n_actuated)
    parameters = ca.MX.sym("parameters", plant.n_task + len(plant.parameter_names))
    target, p = parameters[: plant.n_task], parameters[plant.n_task :]
    z = x * ca.DM(list(scale))
    base, posture = z[: plant.n_base], z[plant.n_base :]
    w, end_point = measures.nested.call([base, posture, p])
    margin = plant.singularity_sine_squared(base, posture, p)
    nlp = {
        "x": x,
        "p": parameters,
        "f": -ca.dot(ca.DM(list(weights)), w) / objective_scale,
        "g": ca.vertcat((end_point - target) / scale[0], margin),
    }
    options = {
        "print_time": False,
        "error_on_fail": False,
        "ipopt": {
            "print_level": 0,
            "sb": "yes",
            "tol": 1e-10,
            "constr_viol_tol": 1e-12,
            "acceptable_iter": 0,
            "max_iter": 200,
            "mu_init": 1e-4,
            "bound_relax_factor": 0.0,
        },
    }
    return ca.nlpsol("selection", "ipopt", nlp, options)
