"""One integration step of the machine alone, its joint torques given: for a simulator in the loop with other code.

In: a machine. Out: a Function of coordinates, torques, placement, parameters and step, from the graphs of the closed
loop.
"""

from __future__ import annotations

import casadi as ca

from flexopt.foundation.kept import by_structure
from flexopt.loop.closed import closed_loop
from flexopt.loop.directions import Computed
from flexopt.loop.flow import Flow
from flexopt.loop.integrators import State, classical_step
from flexopt.loop.structure import LoopStructure
from flexopt.model import AnyMachine
from flexopt.plant.machine_motion import constants_at, full_structure, motion_of


@by_structure
def machine_step(machine: AnyMachine, *, gravity: bool = False) -> ca.Function:
    """M(q) v̇ + h(q, v) + g(q) + K (q − q_rest) + D v = [0; τ_a] over one step of classical RK4, τ_a held.

    Args:
        machine: from `flexopt.load`.
        gravity: whether the weight acts.

    Returns:
        Function of q, v (n_q,), torque (n,), N m or N, base (n_b,), m or rad, p (n_par,) and h, s, with outputs q_next
        and v_next.
    """
    structure = LoopStructure(full_structure(machine), law="none", gravity=gravity)
    loop = closed_loop(structure)
    shape = loop.shape
    n, m = shape.n, shape.n_joints
    q, v, torque = ca.SX.sym("q", n), ca.SX.sym("v", n), ca.SX.sym("torque", m)
    base, h = ca.SX.sym("base", structure.n_base), ca.SX.sym("h")
    p = ca.SX.sym("p", len(machine.parameters))

    values = constants_at(machine, p)
    sizes = loop.constants.sizes
    given = values | {"h": h}
    entries = [given.get(name, ca.SX.zeros(size, 1)) for name, size in sizes.items()]
    flow = Flow(structure, loop.layouts, torque, ca.SX(0, 1), ca.vertcat(*entries))

    shift = motion_of(structure.motion, values).origin(base)
    to_q = shape.to_q
    to_u = ca.inv(to_q)
    start = State(ca.SX(to_u) @ (q - shift), ca.SX(to_u) @ v, ca.SX(0, 1))
    after, _ = classical_step(flow, h, ca.SX(0), start, Computed(shape.angles(start.u)))
    outputs = [ca.densify(ca.SX(to_q) @ after.u + shift), ca.densify(ca.SX(to_q) @ after.w)]
    names = ["q", "v", "torque", "base", "p", "h"]
    return ca.Function("machine_step", [q, v, torque, base, p, h], outputs, names, ["q_next", "v_next"], {"cse": True})
