"""One step of the machine as an operation: hardware in the loop.

In: a `Context`. Out: an operation whose graph is the closed loop's own step.
"""

from __future__ import annotations

import casadi as ca

from flexopt.algebra import solve_spd
from flexopt.export.context import Context, unit_list
from flexopt.export.control import torque_unit
from flexopt.export.operations import Operation
from flexopt.foundation.quantities import POSITIVE
from flexopt.loop.machine_step import machine_step
from flexopt.plant import Plant

RATE_MAX, TORQUE_MAX, STEP_MAX = 1e4, 1e12, 0.1


def simulator(at: Context) -> tuple[Operation, ...]:
    """One step of classical RK4 with held joint torques."""
    plant, g, field = at.plant, at.plant.graph, at.field
    v, torque, h = ca.SX.sym("v", plant.n_coordinates), ca.SX.sym("torque", plant.n_actuated), ca.SX.sym("h")
    result = machine_step(at.machine)(q=g.q, v=v, torque=torque, base=g.base, p=g.p, h=h)
    size_q, size_v = _sizes(plant, v, torque, h)

    units = g.coordinate_units
    placed = [(at.placement, g.base)] if plant.n_base else []
    inputs = [
        (at.coordinates(0.02, measured=False), g.q),
        (field("rates", "COORDINATES", unit_list(units, "{}/s"), "rates v = dq/dt", low=-RATE_MAX, high=RATE_MAX,
               sample=(-0.3, 0.3)), v),
        (field("torque", "JOINTS", torque_unit(at), "of the actuated joints, held during the step", low=-TORQUE_MAX,
               high=TORQUE_MAX, sample=(-1e3, 1e3)), torque),
        *placed,
        (field("step", "", "s", "length h of the step; well below 2.8/(largest angular frequency)", low=POSITIVE,
               high=STEP_MAX, sample=(1e-4, 2e-3), logarithmic=True), h),
    ]  # fmt: skip
    outputs = [
        (field("next_coordinates", "COORDINATES", unit_list(units), "q at the end of the step",
               scale="|q| + |placement| + h times the rates' scale"), result["q_next"], size_q),
        (field("next_rates", "COORDINATES", unit_list(units, "{}/s"), "v at the end of the step",
               scale="|v| + h times a bound of the acceleration's terms"), result["v_next"], size_v),
    ]  # fmt: skip
    about = (
        "One step of classical RK4 of the machine itself, torques held, without its weight: M(q) dv/dt + h(q, v) + "
        "K (q - q_rest) + D v = [0; torque]. RK4 is stable while (largest angular frequency) * h < 2.8 and damps above "
        "about 0.5; a joint that dampers brake at a rate in 1/s wants (rate) * h < 2.8 as well. Take several short "
        "steps in a sample of the controller."
    )
    return (at.operation("machine_step", about, inputs, outputs, []),)


def _sizes(plant: Plant, v: ca.SX, torque: ca.SX, h: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Bounds of what the four stages add up, so that errors are judged by the numbers they come from."""
    g, n, m = plant.graph, plant.n_coordinates, plant.n_passive
    mass = plant.mass(g.q, g.base, g.p)
    inverse = solve_spd(mass, ca.SX.eye(n))
    away = ca.norm_2(g.q - plant.rest(g.base, g.q[m:], g.p))
    driven = ca.norm_fro(inverse[:, m:]) * ca.norm_2(torque)
    spring = ca.norm_fro(inverse @ plant.stiffness(g.p))
    damper = ca.norm_fro(inverse @ plant.damping(g.p))
    turning = ca.norm_fro(inverse) * ca.norm_fro(mass)
    rate, stage_away, stage_rate = ca.norm_2(v), away, ca.norm_2(v)
    for part in (0.5, 0.5, 1.0, 1.0):
        acceleration = driven + spring * stage_away + damper * stage_rate + turning * stage_rate**2
        stage_away, stage_rate = away + part * h * stage_rate, rate + part * h * acceleration
    return ca.norm_2(g.q) + ca.norm_2(g.base) + h * stage_rate, stage_rate
