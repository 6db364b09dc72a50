"""One sample of the linearised loop, exactly: matrix exponentials between the samples, any dead time.

In: a loop, a state in which it rests, its signals and constants. Out: Φ of x_{k+1} = Φ x_k. No integration method is
involved, so no damping of its own hides a mode.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, cast

import casadi as ca
import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.foundation.kept import by_structure
from flexopt.loop.closed import ClosedLoop, closed_loop
from flexopt.loop.directions import Computed
from flexopt.loop.flow import Flow
from flexopt.loop.sample import Sample
from flexopt.loop.structure import LoopStructure

# Newton steps to the state of rest, and the largest remainder of what counts as rest, m, rad or relative.
STEPS, REST = 12, 1e-9
# Rounding of a state, in units of itself or of 1: gains make much of it.
ROUNDING = 64 * float(np.finfo(float).eps)


@dataclass(frozen=True)
class Tangent:
    """The linear loop about rest, in the loop's states x = [s, law, queue], s = [u, w, torque (and a continuous law)].

    Attributes:
        flow, drive: A (n_s, n_s) and B (n_s, n) of ṡ = A s + B τ, τ the command that is held.
        command: G (n, n_x), τ = G x at the start of a sample.
        law: L (n_law, n_x), the sampled law's states at the next sample.
        queue: Q (n_queue, n_x), measurements on their way at the next sample.
        moved: how far the state of rest is from being one: what one sample changes, (n_x,).
        rounding: how much of that may be what the loop makes of rounding, (n_x,).
        measured: rows of one measurement, the last of the queue being the newest.
    """

    flow: Vector
    drive: Vector
    command: Vector
    law: Vector
    queue: Vector
    moved: Vector
    rounding: Vector
    measured: int

    def sample(self, period: float, early: float = 0.0) -> Vector:
        """Φ (n_x, n_x) of x_{k+1} = Φ x_k.

        With s(t_k + h) = e^{Ah} s_k + Γ(h) G x_k, Γ(h) = ∫₀ʰ e^{As} ds B. The newest measurement is taken `early`
        before the end of the sample, so that a queue of l + 1 of them is a dead time of l `period` + `early`, s.
        """
        n = len(self.flow)
        held, driven = exponential(self.flow, self.drive, period)
        queue, wide = self.queue, np.zeros((n, self.command.shape[1] - n))
        if early:
            between, pushed = exponential(self.flow, self.drive, period - early)
            newest = self.queue[-self.measured :, :n]
            queue = np.vstack(
                [self.queue[: -self.measured], newest @ (np.hstack([between, wide]) + pushed @ self.command)]
            )
        return np.vstack([np.hstack([held, wide]) + driven @ self.command, self.law, queue])


def exponential(flow: Vector, drive: Vector, span: float) -> tuple[Vector, Vector]:
    """(e^{Ah}, Γ(h)) from one exponential of the block matrix (Van Loan 1978); of stacks (N, …, …), too."""
    if flow.ndim == 2:
        return _kept_exponential(flow.tobytes(), drive.tobytes(), len(flow), drive.shape[1], span)
    return _exponential(flow, drive, span)


@lru_cache(maxsize=16)
def _kept_exponential(flow: bytes, drive: bytes, n: int, m: int, span: float) -> tuple[Vector, Vector]:
    """The like, kept: along a sweep over gains the plant stays the same."""
    return _exponential(np.frombuffer(flow).reshape(n, n), np.frombuffer(drive).reshape(n, m), span)


def _exponential(flow: Vector, drive: Vector, span: float) -> tuple[Vector, Vector]:
    from scipy.linalg import expm  # noqa: PLC0415  (loads slowly)

    n, m = drive.shape[-2:]
    block: Vector = np.zeros((*flow.shape[:-2], n + m, n + m))
    block[..., :n, :n], block[..., :n, n:] = flow, drive
    whole = expm(block * span)
    whole.setflags(write=False)
    return whole[..., :n, :n], whole[..., :n, n:]


def graphs_about_rest(structure: LoopStructure) -> tuple[ca.Function, ca.Function]:
    """What `tangent` evaluates: between the samples, and at a sample's start."""
    return _between(structure), _at(structure)


def tangent(structure: LoopStructure, x: Vector, e: Vector, c: Vector, carried: Vector | None = None) -> Tangent:
    """The linear loop about a state x (n_x,), with signals e and constants c.

    `carried`: torques or forces of the joints (n,) besides the command.
    """
    between, at = graphs_about_rest(structure)
    command, kept, waiting, by_command, by_kept, by_waiting = (np.array(m) for m in at.call([x, e, c])[:6])
    whole = command if carried is None else command.ravel() + carried
    rates, flow, drive = (np.array(m) for m in between.call([x[: closed_loop(structure).n_continuous], whole, e, c]))
    n = len(flow)
    period = float(c[closed_loop(structure).constants.slices["h"]][0]) * structure.substeps
    laws, queue = x[n : n + len(kept)], x[n + len(kept) :]
    moved = np.concatenate([period * rates.ravel(), kept.ravel() - laws, waiting.ravel() - queue])
    by_x = np.abs(drive) @ np.abs(by_command)
    by_x[:, :n] += np.abs(flow)
    rounding = ROUNDING * np.vstack([period * by_x, np.abs(by_kept), np.abs(by_waiting)]) @ (1.0 + np.abs(x))
    return Tangent(flow, drive, by_command, by_kept, by_waiting, moved, rounding, 2 * structure.n_task)


@dataclass(frozen=True)
class SelfMotion:
    """The self-motion of an arm, which feedback of its end-point holds nowhere: it is taken as it stands.

    Attributes:
        held: in which directions (k, n_x) of the state it must not move.
        along: state -> torques or forces at the joints (n, k) that drive it, and that no feedback gives.
    """

    held: Vector
    along: Callable[[Vector], Vector]


def at_rest(
    structure: LoopStructure, x: Vector, e: Vector, c: Vector, own: SelfMotion | None = None
) -> tuple[Vector, Tangent] | None:
    """The state of rest that Newton's method finds from x, and the linear loop there; None where it finds none.

    Where states of rest form a family it is the one nearest to x. `own`: held as if its joints were braked; what would
    drive it, as a weight that the controller does not know, is carried.
    """
    found = _at_rest(structure, x, e, c, own, scaled=False)
    # Of states of sizes far apart some may look like none, as angles beside torques.
    return _at_rest(structure, x, e, c, own, scaled=True) if found is None else found


def _at_rest(
    structure: LoopStructure, x: Vector, e: Vector, c: Vector, own: SelfMotion | None, *, scaled: bool
) -> tuple[Vector, Tangent] | None:
    """`at_rest`, the nearest state told by states in units of what they change the loop by, where these are scaled."""
    count = 0 if own is None else len(own.held)
    brake = np.zeros(count)
    for _ in range(STEPS):
        along = np.zeros((0, 0)) if own is None else own.along(x)
        here = tangent(structure, x, e, c, None if own is None else along @ brake)
        if not np.all(np.isfinite(here.moved)):
            return None
        n = len(here.flow)
        period = float(c[closed_loop(structure).constants.slices["h"]][0]) * structure.substeps
        by_brake = np.zeros((len(x), count))
        if own is not None:
            by_brake[:n] = period * here.drive @ along
        if still(structure, here, x):
            return x, here
        by_x = np.hstack([here.flow, np.zeros((n, len(x) - n))]) + here.drive @ here.command
        change = np.hstack([np.vstack([period * by_x, here.law, here.queue]), by_brake])
        change[n:, : len(x)] -= np.eye(len(x))[n:]
        # What nothing drives stays: an integral with Ki = 0 carries no load.
        change[:, n + np.flatnonzero(~change[n:].any(axis=1))] = 0.0
        size = np.maximum(np.abs(change).max(axis=1), np.finfo(float).tiny)
        change, moved = change / size[:, None], here.moved / size
        if own is not None:
            change = np.vstack([change, np.hstack([own.held, np.zeros((count, count))])])
            moved = np.append(moved, np.zeros(count))
        unit = np.linalg.norm(change, axis=0) if scaled else np.ones(change.shape[1])
        unit[unit == 0] = 1.0
        newton = np.asarray(cast(Any, np.linalg.lstsq)(change / unit, moved, rcond=1e-12)[0], dtype=np.float64) / unit
        x, brake = x - newton[: len(x)], brake - newton[len(x) :]
    return None


def still(structure: LoopStructure, here: Tangent, x: Vector) -> bool:
    """Whether one sample leaves the state where it is, but for rounding; torques and laws relative to their size."""
    n = 2 * closed_loop(structure).shape.n
    moved = np.abs(here.moved) - here.rounding
    return bool(np.all(moved[:n] <= REST) and np.all(moved[n:] <= REST * (1.0 + np.abs(x[n:]))))


@by_structure
def _between(structure: LoopStructure) -> ca.Function:
    """Rates of s and their derivatives by s and by the held command. Inputs s, command, e, c."""
    loop = closed_loop(structure)
    s = ca.SX.sym("s", loop.n_continuous)
    command = ca.SX.sym("command", loop.shape.n_joints if structure.sampled else 0)
    e, c = ca.SX.sym("e", loop.signals.total), ca.SX.sym("c", loop.constants.total)
    flow, state = Flow(structure, loop.layouts, command, e, c), loop.state(s)
    rates = flow.rates(ca.SX(0), state, Computed(loop.shape.angles(state.u)).start.pairs)
    column = rates.column
    outputs = [column, ca.jacobian(column, s), ca.jacobian(column, command)]
    dense, names = [ca.densify(value) for value in outputs], ["rates", "flow", "drive"]
    return ca.Function("between", [s, command, e, c], dense, ["s", "command", "e", "c"], names, {"cse": True})


@by_structure
def _at(structure: LoopStructure) -> ca.Function:
    """Command, the law's states and the queue after a sample's start, and their derivatives by x. Inputs x, e, c.

    Then how the command is made of the law's force f: ∂f/∂x, ∂command/∂f, and ∂command/∂x of a force that stays.
    """
    loop: ClosedLoop = closed_loop(structure)
    x, e, c = (ca.SX.sym(n, part.total) for n, part in (("x", loop.states), ("e", loop.signals), ("c", loop.constants)))
    at = Sample(structure, loop.layouts, x, e, c, Computed(loop.shape.angles(loop.states.split(x)["u"])))
    command = at.command() if structure.sampled else ca.SX.zeros(0, 1)
    values = [command, *at.successors()]
    asked, force = at.force(), ca.SX.sym("f", structure.n_task)
    of_force = at.command(force)
    made = ca.substitute([ca.jacobian(of_force, force), ca.jacobian(of_force, x)], [force], [asked])
    slopes = [*(ca.jacobian(value, x) for value in values), ca.jacobian(asked, x), *made]
    outputs = [ca.densify(value) for value in (*values, *slopes)]
    names = ["command", "law", "queue", "by_command", "by_law", "by_queue", "by_force", "spread", "direct"]
    return ca.Function("at_sample", [x, e, c], outputs, ["x", "e", "c"], names, {"cse": True})
