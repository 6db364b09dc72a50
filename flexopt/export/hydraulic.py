"""The map between joint rates and lever commands as operations.

In: a `Context`. Out: operations whose graphs are those of `flexopt.plant.hydraulics`.
"""

from __future__ import annotations

import casadi as ca

from flexopt.export.context import Context, unit_list
from flexopt.export.operations import Guard, Operation
from flexopt.model import AnyMachine
from flexopt.plant import Hydraulics, build_hydraulics

RATE_MAX = 1e4
# Lever arms below a tenth of a millimetre, in single precision a centimetre: rates tell nothing of levers.
SQUARED_MAX, SQUARED_MAX_SINGLE = 1e8, 1e4


def levers(at: Context) -> tuple[Operation, ...]:
    """Levers from joint rates, as they are and within ±1, and joint rates from levers."""
    plant, g, field, units = at.plant, at.plant.graph, at.field, at.machine.joint_units
    hydraulics = build_hydraulics(at.machine)
    rates, lever = ca.SX.sym("rates", plant.n_actuated), ca.SX.sym("lever", plant.n_actuated)
    symbol = {"posture": g.posture, "p": g.p}
    free = hydraulics.lever(rates=rates, **symbol)["lever"]
    uniform = hydraulics.lever_map("uniform")(rates=rates, **symbol)["lever"]
    moved = hydraulics.rates(lever=lever, **symbol)["rates"]
    rate = field("joint_rates", "JOINTS", unit_list(units, "{}/s"), "wanted rates of the actuated joints",
                 low=-RATE_MAX, high=RATE_MAX, sample=(-0.5, 0.5))  # fmt: skip
    given = field("lever", "JOINTS", "1", "lever commands, 1 at full lever", low=-1.0, high=1.0, sample=(-1.0, 1.0))
    one = ca.SX.ones(plant.n_actuated, 1)
    full = sum((ca.fabs(hydraulics.rates(lever=side * one, **symbol)["rates"]) for side in (-1, 1)), start=0 * one)
    scale = "|itself| + that at full lever + what changes of the pins and angles by their own size would make of it"
    outputs = [
        (field("lever", "JOINTS", "1", "lever commands, 1 at full lever; may exceed it", scale=scale), free,
         _size(free, one, g.posture, g.p)),
        (field("saturated_lever", "JOINTS", "1", "the same within -1 and 1, all divided alike so that the end-point "
               "keeps its direction", scale=scale), uniform, _size(free, one, g.posture, g.p)),
    ]  # fmt: skip
    back = [
        (field("joint_rates", "JOINTS", unit_list(units, "{}/s"), "rates of the actuated joints", scale=scale), moved,
         _size(moved, full, g.posture, g.p)),
    ]  # fmt: skip
    arms = [(_guard(at), _squared(hydraulics, g.posture, g.p))] if hydraulics.cylinders else []
    about = (
        "Lever commands from joint rates, for Jacobian inverse control through the operator's levers: with the share "
        "s = (dL/dq) rate / (cylinder's full speed in that direction), or rate / (joint's speed) without a cylinder, "
        "lever = sign (d sign(s) + (1 - d) s), d the dead band. Pins are parameters; speeds and dead bands are not."
    )
    return (
        at.operation("levers", about, [(at.joint_angles, g.posture), (rate, rates)], outputs, arms),
        at.operation(
            "lever_rates", "Joint rates that lever commands give: the inverse of levers, 0 inside the dead band.",
            [(at.joint_angles, g.posture), (given, lever)], back, arms,
        ),
    )  # fmt: skip


def levers_refusal(machine: AnyMachine) -> str:
    """Why a machine has no map of its levers; empty where it has one."""
    missing = machine.joints_without_speed
    return f"the levers of {', '.join(missing)} need a cylinder or a speed" if missing else ""


def _squared(hydraulics: Hydraulics, posture: ca.SX, p: ca.SX) -> ca.SX:
    """Σ (dq/dL)²; NaN where a linkage does not close."""
    ratios = hydraulics.ratios(posture, p)
    return sum((1 / ratios[i, k] ** 2 for i, k in enumerate(hydraulics.joints)), start=ca.SX(0))


def _guard(at: Context) -> Guard:
    text = "sum of the squares of dq/dL, infinite at a dead centre, not a number where a linkage does not close"
    most = SQUARED_MAX_SINGLE if at.single else SQUARED_MAX
    return Guard("squared_dq_dl", text, "SINGULAR_POSTURE", maximum=most)


def _size(result: ca.SX, full: ca.SX, posture: ca.SX, p: ca.SX) -> ca.SX:
    """|y| + |y| at full lever + Σ |∂y/∂x| |x| over angles (of the size 1 rad) and parameters: what rounding may do."""
    by_posture, by_p = ca.fabs(ca.jacobian(result, posture)), ca.fabs(ca.jacobian(result, p))
    return full + ca.fabs(result) + by_posture @ ca.SX.ones(posture.shape[0], 1) + by_p @ ca.fabs(p)
