"""How a closed loop stands at rest, as graphs: what it holds of its design, and its state there.

In: a plant, the equations of motion of a loop's structure, a configuration. Out: constants and a state, from numbers
for a run and from symbols for a model whose parameters a master sets.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple, TypeVar

import casadi as ca
import numpy as np

from flexopt.algebra import apply_pseudo_inverse, solve_spd
from flexopt.foundation.arrays import Vector
from flexopt.foundation.control import Control
from flexopt.loop.closed import ClosedLoop
from flexopt.plant import Plant
from flexopt.plant.control import task_to_joints
from flexopt.plant.motion import Motion

T = TypeVar("T")
# Stages from the design's parameters to those of the machine, along which the rest is followed by a Newton step each,
# steps at the end, and how many times as many stages follow it where these lose it.
STAGES, LAST, FINER = 32, 5, 4
# The share of that way on which the machine is relieved, before it is loaded.
RELIEVED = 0.5
# Of a spring's stiffness, added where two are weighed, that what nothing holds divides nothing by zero.
UNSPRUNG = 1e-14
# How far a step moves a coordinate at most, and how much more than twice as far as the one before, rad, or of the arm's
# length: longer ones are where the rest ends, and lead to another elbow. How far the last one may.
FARTHEST, SUDDEN, ARRIVED = 0.1, 0.01, 1e-6


def design_constants(motion: Motion, passive: ca.SX, base: ca.SX) -> dict[str, ca.SX]:
    """The design as a loop's constants: its passive coordinates (m,) from where the placement draws them."""
    relative = passive - motion.drawn(base)[: passive.shape[0]]
    hinges = relative[motion.hinges]
    directions = ca.vec(ca.horzcat(ca.cos(hinges), ca.sin(hinges)).T)
    return {"base": base, "design": relative, "design_directions": directions}


def placed(motion: Motion, base: ca.SX) -> ca.SX:
    """What a placement adds to the end-point, (n_task,), m."""
    return ca.vertcat(*motion.on_rows(ca.vertsplit(base), ca.SX(0)))


class Design(NamedTuple):
    """What a controller takes its machine for, with the parameters of the machine's file, in one configuration.

    Attributes:
        base: placement (n_b,);  posture: of the joints (n,);  p: parameters (n_par,).
        deflection: the passive coordinates (m,) in the static deflection.
        target: where the end-point is then (n_task,), and is to be.
        toward: Jv⁺ (n, n_task), along which feedback turns the joints.
    """

    base: ca.SX
    posture: ca.SX
    p: ca.SX
    deflection: ca.SX
    target: ca.SX
    toward: ca.SX


class Held(NamedTuple):
    """A machine with other parameters p where feedback holds it, whose controller carries the weight of its `Design`.

    Attributes:
        q: all coordinates (n_q,).
        force: f (n_task,) of the law, which carries what the weight is more: E f = g_a(q; p) − g_a(q; file), by least
            squares where the arm is redundant: nothing holds its self-motion.
        error: e (n_task,) that stands: f_i/Kp_i, and 0 in rows whose error is integrated, or not fed back.
        unheld: g_a(q; p) − g_a(q; file) − E f (n,), which drives the self-motion of a redundant arm.
    """

    q: ca.SX
    force: ca.SX
    error: ca.SX
    unheld: ca.SX


def design_of(plant: Plant, base: ca.SX, posture: ca.SX, deflection: ca.SX) -> Design:
    """The design of the machine's own parameters; `deflection` (m,) from `Plant.deflected`."""
    p = ca.SX(plant.parameter_values)
    at = plant.operating_point(base, posture, p, deflection)
    toward = apply_pseudo_inverse(at.rigid_jacobian, ca.SX.eye(plant.n_task))
    return Design(base, posture, p, at.q[: plant.n_passive], at.end_point, toward)


def held_at(plant: Plant, control: Control, design: Design, p: ca.SX, v: ca.SX, kp: ca.SX, ki: ca.SX) -> Held:
    """Where v = [q_p; y] says: passive coordinates (m,), joints turned by Jv⁺ y. Kp and Ki (n_task,) make forces."""
    q = ca.vertcat(v[: plant.n_passive], design.posture + design.toward @ v[plant.n_passive :])
    return _held_in(plant, control, design, p, q, kp, ki)


def _held_in(plant: Plant, control: Control, design: Design, p: ca.SX, q: ca.SX, kp: ca.SX, ki: ca.SX) -> Held:
    m, base = plant.n_passive, design.base
    taken = ca.vertcat(design.deflection, q[m:])
    into = task_to_joints(plant.rigid_jacobian(taken, base, design.p), control, ca.SX.eye(plant.n_task))
    more = plant.gravity(q, base, p)[m:] - plant.gravity(taken, base, design.p)[m:]
    force = solve_spd(into.T @ into, into.T @ more)
    fed_back = ca.logic_and(kp > 0, ca.logic_not(ki > 0))
    error = ca.if_else(fed_back, force / ca.if_else(fed_back, kp, 1), 0)
    return Held(q, force, error, more - into @ force)


def _off(plant: Plant, design: Design, held: Held, p: ca.SX, springs: ca.SX) -> ca.SX:
    """K_p (q_p − q_p,rest) + g_p(q), and how far the end-point is from e short of its target: 0 at rest."""
    m, base, q = plant.n_passive, design.base, held.q
    pulls = springs @ (q[:m] - plant.rest(base, design.posture, p)[:m])
    aside = plant.end_point(q, base, p) + held.error - design.target
    return ca.vertcat(pulls + plant.gravity(q, base, p)[:m], aside)


def change_of_rest(plant: Plant, control: Control) -> ca.Function:
    """(v, the fields of `Design`, other, springs, kp, ki) -> by what Newton's method changes v towards where it rests.

    v as of `held_at`, `other` the parameters p of the machine, `springs` K_p of its passive coordinates.
    """
    g, r, m = plant.graph, plant.n_task, plant.n_passive
    sizes = {"deflection": m, "target": r, "kp": r, "ki": r, "other": g.p.shape[0]}
    s = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
    springs = ca.SX.sym("springs", m, m)
    toward, v = ca.SX.sym("toward", plant.n_actuated, r), ca.SX.sym("v", m + r)
    design = Design(g.base, g.posture, g.p, s["deflection"], s["target"], toward)
    off = _off(plant, design, held_at(plant, control, design, s["other"], v, s["kp"], s["ki"]), s["other"], springs)
    change = ca.densify(-ca.solve(ca.jacobian(off, v), off))
    inputs = {"v": v} | design._asdict() | {"other": s["other"], "springs": springs, "kp": s["kp"], "ki": s["ki"]}
    return ca.Function("change_of_rest", list(inputs.values()), [change], list(inputs), ["change"], {"cse": True})


def resting_rows(plant: Plant, control: Control) -> ca.Function:
    """(q, base, deflection, file, p, kp, ki) -> rows (m + n_task, n_q) along whose kernel a loop rests, too.

    What is 0 at rest (`change_of_rest`), by q: along its self-motion, which no feedback holds, a redundant arm creeps
    from one rest to another, on its base and with its end-point as they then are.

    q (n_q,) where it rests; `deflection`, `file`: of its `Design`, sag and parameters; Kp and Ki make forces.
    """
    g, r, m = plant.graph, plant.n_task, plant.n_passive
    q, sag, kp, ki = (
        ca.SX.sym(name, n) for name, n in (("q", m + plant.n_actuated), ("deflection", m), ("kp", r), ("ki", r))
    )
    file = ca.SX.sym("file", g.p.shape[0])
    # What a design aims at, and along what it is turned, moves no rest.
    design = Design(g.base, q[m:], file, sag, ca.SX.zeros(r), ca.SX.zeros(plant.n_actuated, r))
    held = _held_in(plant, control, design, g.p, q, kp, ki)
    rows = ca.jacobian(_off(plant, design, held, g.p, plant.stiffness(g.p)[:m, :m]), q)
    names = ["q", "base", "deflection", "file", "p", "kp", "ki"]
    given = [q, g.base, sag, file, g.p, kp, ki]
    return ca.Function("resting_rows", given, [ca.densify(rows)], names, ["rows"], {"cse": True})


def way_to_rest(plant: Plant, other: ca.MX) -> Callable[[float], tuple[ca.MX, ca.MX]]:
    """From a share of the way from the machine's own parameters to others to those there (n_par,), and K_p (m, m).

    In the first half what relieves the machine: every parameter goes to the lower of both, as weights do, and springs
    to K_own + K_other − 2 K_other (K_own + K_other)⁻¹ K_own, the contraharmonic mean, which is near the stiffer of
    both. In the second what loads it: weights grow, and springs give way. Each time compliances K_p⁻¹ go straight. So
    one spring under a load sags no farther on the way than at its ends, and none gives way before others, in whatever
    axes. Where the machine itself has no spring the other's is there from the start.
    """
    m, own = plant.n_passive, plant.parameter_values
    before: Vector = plant.stiffness.call([own])[0].full()[:m, :m]
    sizes, directions = np.linalg.eigh(before)
    free = directions[:, sizes <= UNSPRUNG * sizes.max(initial=0.0)]
    kept, after = ca.DM(free @ free.T), plant.stiffness(other)[:m, :m]
    start, between, least = ca.DM(before) + kept @ after @ kept, _springs_between(m), ca.fmin(own, other)
    stiffest = start + after - between(start, after, 0.5)

    def at(share: float) -> tuple[ca.MX, ca.MX]:
        if share <= RELIEVED:
            part = share / RELIEVED
            return own + part * (least - own), between(start, stiffest, part)
        part = (share - RELIEVED) / (1 - RELIEVED)
        return least + part * (other - least), after if share == 1 else between(stiffest, after, part)

    return at


def _springs_between(m: int) -> ca.Function:
    """(first, second, share) -> springs (m, m) whose compliance is that share of the way from one's to the other's.

    K_2 ((1 − share) K_2 + share K_1)⁻¹ K_1.
    """
    first, second, share = ca.SX.sym("first", m, m), ca.SX.sym("second", m, m), ca.SX.sym("share")
    mean = (1 - share) * second + share * first
    # What neither has a spring along stays free.
    mean += ca.diag(ca.if_else(ca.diag(mean) > 0, UNSPRUNG * ca.diag(mean), 1))
    found = second @ solve_spd(mean, first)
    return ca.Function("springs_between", [first, second, share], [found], {"cse": True})


def state_at_rest(
    loop: ClosedLoop, plant: Plant, motion: Motion, q: ca.SX, base: ca.SX, p: ca.SX, law: ca.SX | None = None
) -> ca.SX:
    """State x (n_x,) at rest in q, with a law's states (0 by default).

    Servos start with the torque that carries the weight; filters and measurements on their way show the start.
    """
    parts = {name: ca.SX.zeros(size, 1) for name, size in loop.states.sizes.items()}
    if law is not None:
        parts["law"] = law
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
