"""A late sampled loop by another way than flexopt's: ball arithmetic of 420 bits, and nonlinear runs written out.

The plant is M, K, D, J and Jv at rest; the command is late, x⁺ = e^{AT} x + B₀ f_{k−l} + B₁ f_{k−l−1} for a dead time of
l T + δ, behind it servos of first order. Nothing of `flexopt.loop` takes part.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np
from flint import acb, acb_mat, arb, arb_mat

from flexopt import build_plant
from flexopt.model import AnyMachine
from tests.oracles.high_precision import BITS, balls, evaluate_graph

STEP = arb(10) ** -30


@lru_cache(maxsize=16)
def at_rest(machine: AnyMachine) -> ca.Function:
    """(base, posture, p) -> M, K, D, J, Jv of the machine at rest, without weight."""
    plant = build_plant(machine)
    g, m = plant.graph, plant.n_passive
    jacobian = ca.jacobian(g.end_point, g.q)
    found = ca.substitute([g.mass, g.stiffness, g.damping, jacobian, jacobian[:, m:]], [g.q], [g.rest])
    return ca.Function("at_rest", [g.base, g.posture, g.p], [ca.densify(x) for x in found])


def matrix(rows: int, columns: int, entries: Callable[[int, int], Any]) -> arb_mat:
    return arb_mat(rows, columns, [entries(i, j) for i in range(rows) for j in range(columns)])


def block(of: arb_mat, rows: range, columns: range) -> arb_mat:
    return arb_mat(len(rows), len(columns), [of[i, j] for i in rows for j in columns])


@dataclass(frozen=True)
class LateLoop:
    """PD control of an end-point, the numbers floats or balls."""

    machine: AnyMachine
    posture: Any
    control: str
    kp: Any
    kv: Any
    period: float
    dead_time: Any = 0.0
    bandwidth_hz: Any = None
    p: Any = None

    @property
    def numbers(self) -> list[list[arb]]:
        plant = build_plant(self.machine)
        p = plant.parameter_values.full().ravel() if self.p is None else self.p
        return [[arb(0)] * plant.n_base, balls(self.posture), balls(p)]

    @cached_property
    def plant(self) -> tuple[arb_mat, arb_mat, arb_mat]:
        """A, B of f and C of [r; ṙ], states [v, q, τ of servos]."""
        mass, stiffness, damping, jacobian, rigid = evaluate_graph(at_rest(self.machine), self.numbers)
        n, r, joints = mass.nrows(), rigid.nrows(), rigid.ncols()
        wide = rigid.transpose()
        spread = wide if self.control == "transpose" else wide * (rigid * wide).inv()
        inverse, lag = mass.inv(), joints if self.bandwidth_hz is not None else 0
        into = arb_mat(n, joints, [arb(i - n + joints == j) for i in range(n) for j in range(joints)])
        pulls = inverse * into
        back, slow = inverse * stiffness, inverse * damping
        size = 2 * n + lag
        a, b, c = arb_mat(size, size), arb_mat(size, r), arb_mat(2 * r, size)
        driven = pulls * spread
        for i in range(n):
            a[n + i, i] = arb(1)
            for j in range(n):
                a[i, j], a[i, n + j] = -slow[i, j], -back[i, j]
            for j in range(lag):
                a[i, 2 * n + j] = pulls[i, j]
            for j in range(0 if lag else r):
                b[i, j] = driven[i, j]
        for k in range(lag):
            corner = 2 * arb.pi() * balls(self.bandwidth_hz)[k]
            a[2 * n + k, 2 * n + k] = -corner
            for j in range(r):
                b[2 * n + k, j] = corner * spread[k, j]
        for i in range(r):
            for j in range(n):
                c[i, n + j] = c[r + i, j] = jacobian[i, j]
        return a, b, c

    def advanced(self, span: Any) -> tuple[arb_mat, arb_mat]:
        """e^{Ah} and ∫ e^{As} ds B."""
        a, b, _ = self.plant
        n, r = a.nrows(), b.ncols()
        whole = matrix(n + r, n + r, lambda i, j: (a[i, j] if j < n else b[i, j - n]) * span if i < n else arb(0)).exp()
        return block(whole, range(n), range(n)), block(whole, range(n), range(n, n + r))

    @cached_property
    def sampled(self) -> tuple[arb_mat, arb_mat, arb_mat]:
        """Φ₀, Γ and F: states with the forces on their way, the newest first."""
        _, b, c = self.plant
        n, r = b.nrows(), b.ncols()
        period = arb(self.period)
        late = balls([self.dead_time])[0]
        whole = int(float(late.mid()) / self.period + 1e-9)
        rest = late - whole * period
        held, driven = self.advanced(period)
        terms = {whole: driven}
        if abs(float(rest.mid())) > 1e-9 * self.period:
            after, first = self.advanced(period - rest)
            terms = {whole: first, whole + 1: after * self.advanced(rest)[1]}
        waiting = max(terms)
        size = n + r * waiting
        opened, into, force = arb_mat(size, size), arb_mat(size, r), arb_mat(r, size)
        for i in range(n):
            for j in range(n):
                opened[i, j] = held[i, j]
            for age, term in terms.items():
                for j in range(r):
                    if age:
                        opened[i, n + r * (age - 1) + j] = term[i, j]
                    else:
                        into[i, j] = term[i, j]
        for k in range(r if waiting else 0):
            into[n + k, k] = arb(1)
        for k in range(n + r, size):
            opened[k, k - r] = arb(1)
        kp, kv = (balls([x] * r if np.ndim(x) == 0 else x) for x in (self.kp, self.kv))
        for i in range(r):
            for j in range(n):
                force[i, j] = -(kp[i] * c[i, j] + kv[i] * c[r + i, j])
        return opened, into, force

    @cached_property
    def multipliers(self) -> list[acb]:
        """Eigenvalues, what nothing holds left out, largest first."""
        opened, into, force = self.sampled
        found = acb_mat(opened + into * force).eig(algorithm="approx", nonstop=True, tol=arb(2) ** (20 - BITS))
        excess = len(self.machine.joints) - len(self.machine.task_rows)
        held = sorted(found, key=lambda x: float(abs(x - 1).mid()))[2 * excess :]
        return sorted(held, key=lambda x: -float(abs(x).mid()))

    def growth(self, near: complex | None = None) -> arb:
        """Ln|μ| / T of the largest multiplier, or of that next to a value."""
        chosen = self.multipliers[0]
        if near is not None:
            chosen = min(self.multipliers, key=lambda x: abs(complex(x.mid()) - near))
        return (abs(chosen).mid()).log() / self.period

    def damping_ratio(self, near: complex) -> arb:
        mu = min(self.multipliers, key=lambda x: abs(complex(x.mid()) - near)).mid()
        s = mu.log() / self.period
        return (-s.real / abs(s)).mid()

    def gain(self, angle: arb, feed: int, sign: int) -> arb:
        """σmax of feed/2 · I + sign · F (e^{jθ} − Φ)⁻¹ Γ."""
        opened, into, force = self.sampled
        closed, z = acb_mat(opened + into * force), acb(0, angle).exp()
        for k in range(closed.nrows()):
            for j in range(closed.nrows()):
                closed[k, j] = (z if k == j else acb(0)) - closed[k, j]
        response = acb_mat(force) * closed.solve(acb_mat(into)) * sign
        for k in range(response.nrows()):
            response[k, k] += acb(feed) / 2
        adjoint = acb_mat(response.ncols(), response.nrows(),
                          [response[i, j].conjugate() for j in range(response.ncols()) for i in range(response.nrows())])  # fmt: skip
        sizes = (adjoint * response).eig(algorithm="approx", nonstop=True, tol=arb(2) ** (20 - BITS))
        return max((x.real.mid() for x in sizes), key=float).sqrt()

    def peak(self, angle: float, feed: int, sign: int) -> arb:
        """The largest of it, near an angle."""
        h, at = arb(10) ** -18, arb(angle)
        for _ in range(4):
            low, here, high = (self.gain(at + k * h, feed, sign) for k in (-1, 0, 1))
            at = (at - h * (high - low) / (2 * (high - 2 * here + low))).mid()
        return self.gain(at, feed, sign)

    def h2_norm(self) -> arb:
        """Root of the end-point's variance where commands change, by white noise of unit intensity on the base.

        The states here are those at the measurements; the command that they lead to comes `rest` after one.
        """
        a, _, c = self.plant
        mass = evaluate_graph(at_rest(self.machine), self.numbers)[0].inv()
        n, m, half = a.nrows(), build_plant(self.machine).n_passive, c.nrows() // 2
        into = matrix(n, m, lambda i, j: mass[i, j] if i < mass.nrows() else arb(0))
        square = into * into.transpose()

        def noise(span: Any) -> arb_mat:
            whole = matrix(2 * n, 2 * n, lambda i, j: span * (
                a[i, j] if max(i, j) < n else square[i, j - n] if i < n else -a[j - n, i - n] if j >= n else arb(0)
            )).exp()  # fmt: skip
            held = block(whole, range(n), range(n))
            return block(whole, range(n), range(n, 2 * n)) * held.transpose()

        opened, force_in, force = self.sampled
        closed, size = opened + force_in * force, opened.nrows()
        come = noise(arb(self.period))
        x = matrix(size, size, lambda i, j: come[i, j] if max(i, j) < n else arb(0))
        for _ in range(60):
            # Rounding that balls have taken up is left out; 420 bits have enough of them.
            x, closed = (x + closed * x * closed.transpose()).mid(), (closed * closed).mid()
        late = balls([self.dead_time])[0]
        whole = int(float(late.mid()) / self.period + 1e-9)
        rest, (held, driven) = late - whole * self.period, self.advanced(late - whole * self.period)
        first = n + half * whole
        moved = matrix(n, size, lambda i, j: held[i, j] if j < n
                       else driven[i, j - first] if first <= j < first + half else arb(0))  # fmt: skip
        covariance = moved * x * moved.transpose() + noise(rest)
        shown = block(c, range(half), range(n))
        return (shown * covariance * shown.transpose()).trace().mid().sqrt()

    @cached_property
    def moves(self) -> tuple[list[arb_mat], list[arb_mat], list[arb_mat], arb]:
        """Of the standard move along each task row: s and f at the start, x at the first measurement after, and when.

        The joints are displaced by Jv⁺, the springs at rest; all forces on their way are those of the start.
        """
        a, b, c = self.plant
        opened, _, _ = self.sampled
        n, r, m = a.nrows(), b.ncols(), build_plant(self.machine).n_passive
        rigid = evaluate_graph(at_rest(self.machine), self.numbers)[4]
        back = rigid.transpose() * (rigid * rigid.transpose()).inv()
        kp, kv = (balls([x] * r if np.ndim(x) == 0 else x) for x in (self.kp, self.kv))
        first = rigid.ncols() + 2 * m
        late = balls([self.dead_time])[0]
        whole = int(float(late.mid()) / self.period + 1e-9)
        rest = late - whole * arb(self.period)
        offset = arb(self.period) - rest if abs(float(rest.mid())) > 1e-9 * self.period else arb(0)
        held, driven = self.advanced(offset)
        starts, forces, states = list[arb_mat](), list[arb_mat](), list[arb_mat]()
        for row in range(r):
            s = matrix(n, 1, lambda i, _, row=row: back[i - first, row] if 0 <= i - first < rigid.ncols() else arb(0))
            seen = c * s
            f = matrix(r, 1, lambda i, _, seen=seen: -(kp[i] * seen[i, 0] + kv[i] * seen[r + i, 0]))
            there = held * s + driven * f
            x = matrix(opened.nrows(), 1, lambda i, _, s=there, f=f: s[i, 0] if i < n else f[(i - n) % r, 0])
            starts, forces, states = [*starts, s], [*forces, f], [*states, x]
        return starts, forces, states, offset

    def moving(self, time: arb, row: int) -> tuple[arb_mat, arb_mat]:
        """s and its rate at a time of the standard move along a task row."""
        a, b, _ = self.plant
        starts, forces, states, offset = self.moves
        n, r = b.nrows(), b.ncols()
        late = balls([self.dead_time])[0]
        whole = int(float(late.mid()) / self.period + 1e-9)
        if float(time.mid()) < float(offset.mid()):
            s, f, left = starts[row], forces[row], time
        else:
            opened, into, force = self.sampled
            k = int(float((time - offset).mid()) / self.period)
            x, power, count = states[row], opened + into * force, k
            while count:
                if count % 2:
                    x = (power * x).mid()
                power, count = (power * power).mid(), count // 2
            s, left, rest = (
                block(x, range(n), range(1)),
                time - offset - k * arb(self.period),
                late - whole * arb(self.period),
            )
            aged = [force * x, *(block(x, range(n + r * j, n + r * j + r), range(1)) for j in range(whole + 1)
                                 if n + r * j < x.nrows())]  # fmt: skip
            f = aged[whole]
            if abs(float(rest.mid())) > 1e-9 * self.period:
                if float(left.mid()) <= float(rest.mid()):
                    f = aged[whole + 1]
                else:
                    held, driven = self.advanced(rest)
                    s, left = held * s + driven * aged[whole + 1], left - rest
        held, driven = self.advanced(left)
        s = held * s + driven * f
        return s, a * s + b * f

    def settling(self, start: float, row: int, band: float) -> arb:
        """The time next to `start` at which the end-point's error is the band's edge."""
        c, time = self.plant[2], arb(start)
        half = c.nrows() // 2
        for _ in range(5):
            s, rate = self.moving(time, row)
            e, v = c * s, c * rate
            height = sum((e[i, 0] * e[i, 0] for i in range(half)), -(arb(band) ** 2))
            time = (time - height / (2 * sum((e[i, 0] * v[i, 0] for i in range(half)), arb(0)))).mid()
        return time

    def swing(self, start: float, row: int, coordinate: int) -> arb:
        """The deflection of a passive coordinate where it is largest next to a time."""
        time, of = arb(start), evaluate_graph(at_rest(self.machine), self.numbers)[0].nrows()
        for _ in range(5):
            s, rate = self.moving(time, row)
            time = (time - s[coordinate, 0] / rate[coordinate, 0]).mid()
        return abs(self.moving(time, row)[0][of + coordinate, 0]).mid()

    def border(self, name: str, start: float) -> arb:
        """The value of a number next to `start` at which the loop neither grows nor decays, others as they are.

        `"factor"` multiplies all gains.
        """

        def at(x: arb) -> LateLoop:
            if name == "factor":
                return replace(self, kp=[x * k for k in balls(self.kp)], kv=[x * k for k in balls(self.kv)])
            return replace(self, **{name: x})

        first = at(arb(start))
        near = complex(first.multipliers[0].mid())
        x, y = arb(start), arb(start) * (1 + arb(10) ** -8)
        of_x, of_y = (at(v).growth(near) for v in (x, y))
        for _ in range(6):
            x, of_x, y = y, of_y, (y - of_y * (y - x) / (of_y - of_x)).mid()
            of_y = at(y).growth(near)
            if abs(float((y - x).mid())) < 1e-45 * abs(start):
                break
        return y


def directional(value: Callable[[Mapping[str, Any]], arb], at: Mapping[str, Any], along: Mapping[str, Any]) -> float:
    """Derivative of a value along changes of several numbers, by a difference in balls."""

    def moved(sign: int) -> arb:
        shifted = {}
        for name, change in along.items():
            new = [x + sign * STEP * arb(float(d)) for x, d in zip(balls(at[name]), np.ravel(change), strict=True)]
            shifted[name] = new if np.ndim(at[name]) else new[0]
        return value(dict(at) | shifted)

    return float(((moved(1) - moved(-1)) / (2 * STEP)).mid())


class NonlinearRun:
    """The machine and its late controller in RK4 steps of a few hundredths of the fastest mode's radian."""

    def __init__(self, loop: LateLoop) -> None:
        plant = build_plant(loop.machine)
        g, p, m = plant.graph, plant.parameter_values, plant.n_passive
        n, joints, r = plant.n_coordinates, plant.n_actuated, plant.n_task
        self.sizes, self.period = (n, joints if loop.bandwidth_hz is not None else 0, r), loop.period
        base = ca.DM.zeros(plant.n_base)
        self.rest = plant.rest(base, loop.posture, p)
        mass, bias, jacobian, point = ca.substitute(
            [g.mass, g.bias, ca.jacobian(g.end_point, g.q), g.end_point], [g.p, g.base], [ca.SX(p), ca.SX(base)]
        )
        torque, lag = ca.SX.sym("torque", joints), self.sizes[1]
        command, h = ca.SX.sym("command", joints), ca.SX.sym("h")
        acting = torque if lag else command
        pull = -bias - plant.stiffness(p) @ (g.q - self.rest) - plant.damping(p) @ g.v
        pull += ca.vertcat(ca.SX.zeros(m, 1), acting)
        corner = 2 * math.pi * ca.DM(loop.bandwidth_hz if lag else [0.0] * joints)
        y = ca.vertcat(g.q, g.v, torque)
        rate = ca.Function("rate", [y, command], [ca.vertcat(g.v, ca.solve(mass, pull), corner * (command - torque))])
        k1 = rate(y, command)
        k2 = rate(y + h / 2 * k1, command)
        k3 = rate(y + h / 2 * k2, command)
        k4 = rate(y + h * k3, command)
        step = ca.Function("step", [y, command, h], [y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)], {"cse": True})
        a = np.array([[float(x.mid()) for x in row] for row in loop.plant[0].table()])
        fastest = float(np.abs(np.linalg.eigvals(a)).max())
        samples = loop.dead_time / loop.period
        self.waiting, self.early = math.ceil(samples - 1e-9), (samples - math.floor(samples + 1e-9)) * loop.period
        counts = [max(1, math.ceil(fastest * h / 0.04)) for h in (loop.period - self.early, self.early)]
        self.spans = [(step.mapaccum(k).slice("many", [0, 1, 2], [0]), k, h)
                      for k, h in zip(counts, (loop.period - self.early, self.early), strict=True) if h > 1e-12]  # fmt: skip
        believed = ca.vertcat(self.rest[:m], g.q[m:])
        jv = ca.substitute(jacobian[:, m:], g.q, believed)
        f = ca.SX.sym("f", r)
        spread = jv.T @ f if loop.control == "transpose" else jv.T @ ca.solve(jv @ jv.T, f)
        self.spread = ca.Function("spread", [g.q, f], [spread])
        target = plant.end_point(self.rest, base, p)
        asked = np.ravel(loop.kp) * (target - point) - np.ravel(loop.kv) * (jacobian @ g.v)
        self.force = ca.Function("force", [g.q, g.v], [asked])

    def __call__(self, away: np.ndarray, forces: list[np.ndarray], samples: int) -> tuple[np.ndarray, list[np.ndarray]]:
        """From [q − q_rest, v, torque] and forces on their way, oldest first, to those after so many samples."""
        n, lag, _ = self.sizes
        joints = self.spread.size1_out(0)
        y = np.concatenate([away[:n] + self.rest.full().ravel(), away[n : 2 * n], np.resize(away[2 * n :], joints) if lag else np.zeros(joints)])  # fmt: skip
        queue = list(forces)
        for _ in range(samples):
            if self.early <= 1e-12:
                queue.append(self.force(y[:n], y[n : 2 * n]).full().ravel())
            command = self.spread(y[:n], queue.pop(0))
            for k, (many, count, span) in enumerate(self.spans):
                y = many(y, command, span / count)[:, -1].full().ravel()
                if k == 0 and self.early > 1e-12:
                    queue.append(self.force(y[:n], y[n : 2 * n]).full().ravel())
        return np.concatenate([y[:n] - self.rest.full().ravel(), y[n : 2 * n], y[2 * n :] if lag else []]), queue
