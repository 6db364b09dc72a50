"""Kinematics and the task-space controller as operations.

In: a `Context`. Out: operations whose graphs are the plant's own.
"""

from __future__ import annotations

import casadi as ca

from flexopt.export.context import Context, sine_squared, unit_list
from flexopt.export.operations import Field, Operation
from flexopt.export.task_rows import task_frame
from flexopt.foundation.control import CONTROLS, Control, control_damping, control_method, gain_units
from flexopt.foundation.quantities import COORDINATE_MAX
from flexopt.loop.feedback import joint_torque, nullspace_torque
from flexopt.plant import Plant
from flexopt.plant.control import task_to_joints

RATE_MAX = 1e4
GAIN_MAX = 1e12
# Laws of the end-point's error, in simulated runs too, take the weight for compensated.
WEIGHT = " The torque does not carry the arm's weight: what does is added to it, or the drives hold it."


def damps_self_motion(plant: Plant, control: Control) -> bool:
    """Whether the law has a damper on the arm's self-motion: the inverse of an arm with more joints than task rows."""
    return control == "inverse" and plant.n_actuated > plant.n_task


def task_space_torque(plant: Plant, control: Control) -> ca.Function:
    """τ_a = Jvᵀ f (transpose), Jv⁺ f (inverse) or J⁺_λ f (damped), f = Kp (r_target − r) + Kv (ṙ_target − ṙ).

    Jv at the measured joints, passive coordinates at rest: the controller knows the arm on rigid ground alone. Where
    the law `damps_self_motion`, −d (I − Jv⁺ Jv) q̇_a is added. Inputs base, posture, r, r_rate, target, target_rate
    (n_task,), kp, kv, then rates (n,) and damping d where they are needed, p; outputs torque (n,) and torque_size, an
    upper bound of its terms.
    """
    g, r = plant.graph, plant.n_task
    point, rate, target, target_rate = (ca.SX.sym(n, r) for n in ("r", "r_rate", "target", "target_rate"))
    kp, kv = ca.SX.sym("kp"), ca.SX.sym("kv")
    jv = plant.rigid_jacobian(plant.rest(g.base, g.posture, g.p), g.base, g.p)
    error, error_rate = target - point, target_rate - rate
    force = kp * error + kv * error_rate
    torque = joint_torque(jv, force, control)
    spread = task_to_joints(jv, control, ca.SX.eye(r))
    size = ca.norm_fro(spread) * (kp * ca.norm_2(error) + kv * ca.norm_2(error_rate))
    inputs = [g.base, g.posture, point, rate, target, target_rate, kp, kv]
    names = ["base", "posture", "r", "r_rate", "target", "target_rate", "kp", "kv"]
    if damps_self_motion(plant, control):
        rates, damping = ca.SX.sym("rates", plant.n_actuated), ca.SX.sym("damping")
        torque, size = torque + nullspace_torque(jv, rates, damping), size + damping * ca.norm_2(rates)
        inputs, names = [*inputs, rates, damping], [*names, "rates", "damping"]
    inputs, names = [*inputs, g.p], [*names, "p"]
    return ca.Function(f"torque_{control_method(control)}", inputs, [torque, size], names, ["torque", "torque_size"])


def kinematics(at: Context) -> tuple[Operation, ...]:
    """End-point and Jacobians."""
    plant, g, field = at.plant, at.plant.graph, at.field
    arguments = (g.q, g.base, g.p)
    end_point, jacobian, rigid = (f(*arguments) for f in (plant.end_point, plant.jacobian, plant.rigid_jacobian))
    inputs = [(at.coordinates(0.1, measured=True), g.q)]
    placed = ca.depends_on(ca.veccat(end_point, jacobian), g.base)
    if placed:
        inputs.append((at.placement, g.base))
    # Heights alone do not depend on where the base stands, but the skeleton does.
    skeleton = plant.skeleton(g.q, g.base if placed else ca.SX.zeros(plant.n_base, 1), g.p)
    size = ca.norm_2(skeleton[:, 0]) + sum(ca.norm_2(s) for s in ca.horzsplit(ca.diff(skeleton, 1, 1)))
    by_coordinate, by_joint = (unit_list(units, "m/{}") for units in (g.coordinate_units, at.machine.joint_units))
    outputs = [
        (field("end_point", "TASK", "m", f"end-point r(q), {task_frame(at.machine)}",
               scale="|ground point| + the bodies' lengths"), end_point, size),
        (field("jacobian", "TASK COORDINATES", by_coordinate, "J = dr/dq", scale="Frobenius norm"), jacobian,
         ca.norm_fro(jacobian)),
        (field("rigid_jacobian", "TASK JOINTS", by_joint, "Jv = dr/dq_a at this q; control takes it with the base at "
               "rest", scale="Frobenius norm"), rigid, ca.norm_fro(rigid)),
    ]  # fmt: skip
    return (at.operation("kinematics", "End-point and its Jacobians at any configuration.", inputs, outputs, []),)


def controller(at: Context) -> tuple[Operation, ...]:
    """The control step, Jacobian transpose and inverse, and the damped inverse where the bundle's control is that."""
    damped = () if at.control in CONTROLS else (_torque(at, at.control),)
    return (_torque(at, "transpose"), _torque(at, "inverse"), *damped)


def _torque(at: Context, control: Control) -> Operation:
    plant, g, field = at.plant, at.plant.graph, at.field
    law = task_space_torque(plant, control)
    damped_freely = damps_self_motion(plant, control)
    names = ("r", "r_rate", "target", "target_rate", "kp", "kv", *(("rates", "damping") if damped_freely else ()))
    symbol = {name: ca.SX.sym(name, law.size1_in(name)) for name in names}
    result = law(base=at.base, posture=g.posture, p=g.p, **symbol)
    torque, size = result["torque"], result["torque_size"]

    units = gain_units(control, at.machine.joint_units)
    kp = field("proportional_gain", "", units[0], "Kp", high=GAIN_MAX, sample=(1e3, 1e6))
    kv = field("derivative_gain", "", units[1], "Kv", high=GAIN_MAX, sample=(1e2, 1e5))
    inputs = [
        (at.joint_angles, g.posture),
        (position(at, "measured_point", "end-point r, measured"), symbol["r"]),
        (speed(at, "measured_rate", "its rate, measured"), symbol["r_rate"]),
        (position(at, "target_point", "where the end-point shall be"), symbol["target"]),
        (speed(at, "target_rate", "its rate"), symbol["target_rate"]),
        (kp, symbol["kp"]),
        (kv, symbol["kv"]),
    ]
    if damped_freely:
        of_joints = unit_list(at.machine.joint_units, "{}/s")
        units = ["N m s/rad" if unit == "rad" else "N s/m" for unit in at.machine.joint_units]
        inputs += [
            (field("joint_rates", "JOINTS", of_joints, "rates of the actuated joints, measured", low=-RATE_MAX,
                   high=RATE_MAX, sample=(-0.5, 0.5)), symbol["rates"]),
            (field("nullspace_damping", "", unit_list(units), "d, a damper on the self-motion, which the end-point "
                   "does not show and nothing else holds; 0 for none", high=GAIN_MAX, sample=(0.0, 1e4)),
             symbol["damping"]),
        ]  # fmt: skip
    damping, method = control_damping(control), control_method(control)
    matrix = {"transpose": "Jv^T", "inverse": "Jv^+"}.get(method, "Jv^T (Jv Jv^T + lambda^2 I)^-1")
    scale = f"|{matrix}| times (Kp |error| + Kv |error rate|)"
    output = field("torque", "JOINTS", torque_unit(at), f"of the actuated joints: {matrix} f", scale=scale)
    guards = [(at.regular(), sine_squared(at))] if control == "inverse" else []
    text = (
        f"Task-space controller, Jacobian {method}: torque = {matrix} f with f = Kp (target_point - measured_point) + "
        "Kv (target_rate - measured_rate). Jv at the measured joints, passive coordinates at rest."
    )
    force, spread = force_units(at), _spread_units(at)
    if control == "inverse":
        text += f" f is in {force}: Jv^+ is in {spread} (Moore-Penrose where the arm is redundant)."
    if damped_freely:
        text += " A damper on the self-motion is added: -nullspace_damping (I - Jv^+ Jv) joint_rates."
        scale += " + nullspace_damping times |joint_rates|"
    if damping is not None:
        text += f" f is in {force}, and lambda = {damping:g} in the unit of Jv's entries. No posture is refused."
    text += WEIGHT
    return at.operation(f"torque_{method}", text, inputs, [(output, torque, size)], guards)


def force_units(at: Context) -> str:
    """Unit of f under an inverse: of arms of hinges, of slides, of both."""
    return _by_joint(at, "N m^2", "N", "for")


def _spread_units(at: Context) -> str:
    """Unit of the inverse."""
    return _by_joint(at, "rad/m", "m/m", "of")


def _by_joint(at: Context, hinges: str, slides: str, word: str) -> str:
    there = set(at.machine.joint_units)
    if len(there) == 1:
        return hinges if "rad" in there else slides
    return f"{hinges} {word} hinges and {slides} {word} slides"


def position(at: Context, name: str, text: str) -> Field:
    """A point as an input."""
    limit = COORDINATE_MAX
    return at.field(name, "TASK", "m", f"{text}, {task_frame(at.machine)}", low=-limit, high=limit, sample=(-3.0, 3.0))


def speed(at: Context, name: str, text: str) -> Field:
    """Its rate."""
    return at.field(
        name, "TASK", "m/s", f"{text}, {task_frame(at.machine)}", low=-RATE_MAX, high=RATE_MAX, sample=(-1.0, 1.0)
    )


def torque_unit(at: Context) -> str:
    """Units of what the joints give."""
    return unit_list([{"rad": "N m", "m": "N"}[unit] for unit in at.machine.joint_units])
