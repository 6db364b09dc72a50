"""How a closed loop stands at rest, as graphs: what it holds of its design, and its state there.

In: a plant, the equations of motion of a loop's structure, a configuration. Out: constants and a state, from numbers
for a run and from symbols for a model whose parameters a master sets.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

import casadi as ca

from flexopt.loop.closed import ClosedLoop
from flexopt.plant import Plant
from flexopt.plant.motion import Motion

T = TypeVar("T")


def design_constants(motion: Motion, passive: ca.SX, base: ca.SX) -> dict[str, ca.SX]:
    """The design as a loop's constants: its passive coordinates (m,) from where the placement draws them."""
    relative = passive - motion.drawn(base)[: passive.shape[0]]
    hinges = relative[motion.hinges]
    directions = ca.vec(ca.horzcat(ca.cos(hinges), ca.sin(hinges)).T)
    return {"base": base, "design": relative, "design_directions": directions}


def placed(motion: Motion, base: ca.SX) -> ca.SX:
    """What a placement adds to the end-point, (n_task,), m."""
    return ca.vertcat(*motion.on_rows(ca.vertsplit(base), ca.SX(0)))


def state_at_rest(loop: ClosedLoop, plant: Plant, motion: Motion, q: ca.SX, base: ca.SX, p: ca.SX) -> ca.SX:
    """State x (n_x,) at rest in q.

    Servos start with the torque that carries the weight; filters and measurements on their way show the start.
    """
    parts = {name: ca.SX.zeros(size, 1) for name, size in loop.states.sizes.items()}
    parts["u"] = ca.solve(ca.SX(motion.to_q), q - motion.origin(base))
    if loop.structure.compensated and loop.structure.lagging:
        parts["torque"] = plant.gravity(q, base, p)[plant.n_passive :]
    point = plant.end_point(q, base, p) - placed(motion, base)
    measured = ca.vertcat(point, ca.SX.zeros(plant.n_task, 1))
    parts["queue"] = ca.repmat(measured, loop.structure.delay, 1)
    if loop.structure.filtered:
        parts["filter"] = measured
    return ca.vertcat(*parts.values())


def in_base_axes(away: Mapping[str, T], cosine: T, sine: T, nothing: T) -> dict[str, T]:
    """A change of placement by names, x and y in the axes in which a base of that yaw stands."""
    x, y = away.get("x", nothing), away.get("y", nothing)
    return dict(away) | {"x": x * cosine + y * sine, "y": y * cosine - x * sine}  # type: ignore[operator]
