"""One integration step of the closed loop as a graph, by methods that differ in what they keep.

In: a `VectorField`, the right-hand sides as graph builders. Out: the state after h. Explicit Runge–Kutta methods take
any `TurningFrame` of directions; Gauss's implicit one is applied to u and its momentum p = M w, where it is symplectic,
by fixed-point iterations whose last change comes out as `residual`. Strong dampers enter these as a linear part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import casadi as ca
import numpy as np

from flexopt.algebra.dense import solve_spd
from flexopt.foundation.arrays import Array
from flexopt.loop.directions import Computed, Heading, TurningFrame
from flexopt.loop.tableaus import Tableau
from flexopt.plant.motion import Directions


@dataclass(frozen=True)
class State:
    """What an integrator advances: coordinates u and rates w (n_q,), and first-order states z (n_z,)."""

    u: ca.SX
    w: ca.SX
    z: ca.SX

    @property
    def column(self) -> ca.SX:
        """[u, w, z]."""
        return ca.vertcat(self.u, self.w, self.z)


class VectorField(Protocol):
    """The right-hand sides at a time `t` after the start of the sample, the bodies pointing `along`."""

    @property
    def n_translations(self) -> int:
        """Entries of u before the angles."""
        ...

    def rates(self, t: ca.SX, state: State, along: Directions) -> State:
        """Rates of u, w and z."""
        ...

    def momentum(self, u: ca.SX, w: ca.SX, along: Directions) -> ca.SX:
        """M_u w."""
        ...

    def rates_of_momentum(self, u: ca.SX, momentum: ca.SX, along: Directions) -> ca.SX:
        """M_u⁻¹ p."""
        ...

    def damping(self, u: ca.SX, along: Directions) -> ca.SX:
        """D_u of the dampers' force −D_u w, symmetric."""
        ...

    def momentum_rates(self, t: ca.SX, state: State, along: Directions) -> State:
        """Rates of u, of the momentum (in the place of w: all forces, and the kinetic energy's gradient) and of z."""
        ...


def classical_step(field: VectorField, h: ca.SX, t: ca.SX, start: State, frame: TurningFrame) -> tuple[State, Heading]:
    """The state after h by the classical fourth-order method, and where the bodies point then.

    As u̇ = w, its stages lie at u + h w/2, u + h w/2 + h² a₁/4 and u + h w + h² a₂/2, and it ends at
    u + h w + h² (a₁ + a₂ + a₃)/6 (Nyström's form): one larger rotation, its double, and very small ones.
    """
    k, half = field.n_translations, 0.5 * h
    quarter, sixth = half * half, (1 / 6) * (h * h)
    first = field.rates(t, start, frame.start.pairs)

    u = start.u + half * start.w
    mid = frame.turned(half * start.w[k:])
    now = State(u, start.w + half * first.w, start.z + half * first.z)
    second = field.rates(t + half, now, mid.pairs)

    heading = frame.nudged(mid, quarter * first.w[k:])
    now = State(u + quarter * first.w, start.w + half * second.w, start.z + half * second.z)
    third = field.rates(t + half, now, heading.pairs)

    u, end = start.u + h * start.w, frame.doubled(mid)
    heading = frame.nudged(end, 2 * quarter * second.w[k:])
    now = State(u + 2 * quarter * second.w, start.w + h * third.w, start.z + h * third.z)
    fourth = field.rates(t + h, now, heading.pairs)

    inner = second.w + third.w
    three = first.w + inner
    after = State(
        u + sixth * three,
        start.w + (1 / 6) * h * (three + inner + fourth.w),
        start.z + (1 / 6) * h * (first.z + 2 * (second.z + third.z) + fourth.z),
    )
    return after, frame.nudged(end, sixth * three[k:])


def explicit_step(
    field: VectorField, tableau: Tableau, h: ca.SX, t: ca.SX, start: State, frame: TurningFrame
) -> tuple[State, Heading]:
    """The state after h by any explicit method, and where the bodies point then."""
    k = field.n_translations
    rates: list[State] = []
    for i in range(len(tableau.b)):
        change = _combined(rates, tableau.a[i, :i])
        now, heading = start, frame.start
        if change is not None:
            now = State(start.u + h * change.u, start.w + h * change.w, start.z + h * change.z)
            heading = frame.turned(h * change.u[k:])
        rates.append(field.rates(t + float(tableau.c[i]) * h, now, heading.pairs))
    change = _combined(rates, tableau.b)
    assert change is not None
    after = State(start.u + h * change.u, start.w + h * change.w, start.z + h * change.z)
    return after, frame.turned(h * change.u[k:])


def _combined(rates: Sequence[State], factors: Array) -> State | None:
    """Σ factor · rate, or None where every factor is zero."""
    used = [(float(factor), rate) for factor, rate in zip(factors, rates, strict=True) if factor]
    if not used:
        return None
    return _added([State(factor * rate.u, factor * rate.w, factor * rate.z) for factor, rate in used])


def _added(states: Sequence[State]) -> State:
    total = states[0]
    for state in states[1:]:
        total = State(total.u + state.u, total.w + state.w, total.z + state.z)
    return total


@dataclass(frozen=True)
class ImplicitStep:
    """A step of an implicit method in parts: `start`, then `iterate` again and again, then `finish`.

    The unknowns are the rates of u, p and z at all stages, stacked; one change beyond rounding remains as `residual`,
    relative to their size. `factors` are of the start, iterations take them as `known`; none without strong dampers.
    """

    start: ca.SX
    iterate: ca.SX
    finish: State
    residual: ca.SX
    unknowns: ca.SX
    factors: ca.SX
    known: ca.SX


class StrongDampers:
    """Corrections by which iterations on momentum rates converge however strong the dampers are.

    Of a change of the rates K (n, s) dampers leave what I + h kron(A, B) makes of it, B = D_u M_u⁻¹ at the start of the
    step. That is solved: the tableau's A = T Λ T⁻¹ is taken apart into its real eigenvalues and pairs a ± ib (Hairer
    and Wanner 1996, IV.8), each of which needs one inverse (n, n):

        (I + h a B)⁻¹ = M_u (M_u + h a D_u)⁻¹,    ((I + h a B)² + (h b B)²)⁻¹ = M_u (M_u + 2 h a D_u + h² |λ|² D_u B)⁻¹.
    """

    def __init__(self, tableau: Tableau, h: ca.SX) -> None:
        values, vectors = np.linalg.eig(tableau.a)
        self._h, self._values = h, [value for value in values if value.imag >= 0]
        columns: list[Array] = []
        for value, vector in zip(values, vectors.T, strict=True):
            if value.imag >= 0:
                columns += [vector.real, vector.imag] if value.imag else [vector.real]
        self._to_stages = np.stack(columns, axis=1)
        self._from_stages = np.linalg.inv(self._to_stages)

    def factors(self, mass: ca.SX, damping: ca.SX) -> ca.SX:
        """B and the inverses side by side, (n, n (1 + eigenvalues with b ≥ 0))."""
        h, b = self._h, solve_spd(mass, damping).T
        inner = [
            mass + (2 * h * v.real * damping + h**2 * abs(v) ** 2 * (b @ damping) if v.imag else h * v.real * damping)
            for v in self._values
        ]
        return ca.horzcat(b, *[solve_spd(each, mass).T for each in inner])

    def corrected(self, factors: ca.SX, left: ca.SX) -> ca.SX:
        """The change of K (n, s) after which nothing of `left` (n, s) remains."""
        n, h = left.shape[0], self._h
        b, *inverses = ca.horzsplit(factors, n)
        apart, solved, k = left @ ca.SX(self._from_stages.T), list[ca.SX](), 0
        for value, inverse in zip(self._values, inverses, strict=True):
            one = apart[:, k]
            if value.imag:
                two = apart[:, k + 1]
                solved += [
                    inverse @ (one + h * (b @ (value.real * one - value.imag * two))),
                    inverse @ (two + h * (b @ (value.real * two + value.imag * one))),
                ]
            else:
                solved.append(inverse @ one)
            k = len(solved)
        return ca.horzcat(*solved) @ ca.SX(self._to_stages.T)


def implicit_step(
    field: VectorField, tableau: Tableau, h: ca.SX, t: ca.SX, state: State, *, damped: bool
) -> ImplicitStep:
    """The parts of one implicit step from `state`; `damped`: whether by `StrongDampers`."""
    n, n_z, k, stages = state.u.shape[0], state.z.shape[0], field.n_translations, len(tableau.b)
    size = 2 * n + n_z
    at_start = Computed(state.u[k:]).start.pairs
    p = field.momentum(state.u, state.w, at_start)
    first = field.momentum_rates(t, state, at_start).column

    unknowns = ca.SX.sym("stages", size * stages)
    rates = [unknowns[size * i : size * (i + 1)] for i in range(stages)]
    renewed: list[ca.SX] = []
    for i in range(stages):
        change = sum((float(tableau.a[i, j]) * rates[j] for j in range(stages)), start=ca.SX.zeros(size, 1))
        u = state.u + h * change[:n]
        along = Computed(u[k:]).start.pairs
        w = field.rates_of_momentum(u, p + h * change[n : 2 * n], along)
        now = State(u, w, state.z + h * change[2 * n :])
        at = t + float(tableau.c[i]) * h
        renewed.append(field.momentum_rates(at, now, along).column)
    factors = known = ca.SX(n, 0)
    if damped:
        dampers, probe = StrongDampers(tableau, h), ca.SX.sym("w", n)
        mass = ca.jacobian(field.momentum(state.u, probe, at_start), probe)
        factors = dampers.factors(mass, field.damping(state.u, at_start))
        known = ca.SX.sym("factors", *factors.shape)
        left = ca.horzcat(*[(now - was)[n : 2 * n] for now, was in zip(renewed, rates, strict=True)])
        change = dampers.corrected(known, left)
        renewed = [
            ca.vertcat(now[:n], was[n : 2 * n] + change[:, i], now[2 * n :])
            for i, (now, was) in enumerate(zip(renewed, rates, strict=True))
        ]
    iterate = ca.vertcat(*renewed)

    change = sum((float(b) * rate for b, rate in zip(tableau.b, rates, strict=True)), start=ca.SX.zeros(size, 1))
    u = state.u + h * change[:n]
    w = field.rates_of_momentum(u, p + h * change[n : 2 * n], Computed(u[k:]).start.pairs)
    difference = iterate - unknowns
    # Rates of u alone: those of p and z follow from them and have other units.
    rows = [size * i + row for i in range(stages) for row in range(n)]
    least = _FLOOR + (_ROUNDED / h) ** 2
    residual = ca.dot(difference[rows], difference[rows]) / (ca.dot(iterate[rows], iterate[rows]) + least)
    return ImplicitStep(
        start=ca.repmat(first, stages, 1),
        iterate=iterate,
        finish=State(u, w, state.z + h * change[2 * n :]),
        residual=residual,
        unknowns=unknowns,
        factors=factors,
        known=known,
    )


# Square of a rate, (m/s)² or (rad/s)², to which changes of slower ones are compared: at rest only rounding is left.
_FLOOR = 1e-6
# Steps h are as short as the fastest mode asks, ω h ≈ 0.3: what springs make in one of the rounding ε of coordinates,
# ε ω² h, then grows as 1/h. Beside so much over h, m or rad, it is no change of 1e-10.
_ROUNDED = 8e-7
