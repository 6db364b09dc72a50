"""One integration step of the closed loop as a graph, by methods that differ in what they keep.

In: a `Field`, the right-hand sides as graph builders. Out: the state after h. Explicit Runge–Kutta methods take any
`Frame` of directions; Gauss's implicit one is applied to u and its momentum p = M w, where it is symplectic, by
fixed-point iterations whose last change comes out as `residual`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import casadi as ca

from flexopt.plant.motion import Directions
from flexopt.simulation.directions import Computed, Frame
from flexopt.simulation.tableaus import Table, Tableau


@dataclass(frozen=True)
class State:
    """What an integrator advances: coordinates u and rates w (n_q,), and first-order states z (n_z,)."""

    u: ca.SX
    w: ca.SX
    z: ca.SX


class Field(Protocol):
    """The right-hand sides at a time `t` after the start of the sample, `frame` the step's directions."""

    @property
    def n_translations(self) -> int:
        """Entries of u before the angles."""
        ...

    def rates(self, t: ca.SX, state: State, along: Directions, frame: Frame) -> State:
        """Rates of u, w and z."""
        ...

    def momentum(self, w: ca.SX, along: Directions) -> ca.SX:
        """M_u w."""
        ...

    def rates_of_momentum(self, momentum: ca.SX, along: Directions) -> ca.SX:
        """M_u⁻¹ p."""
        ...

    def momentum_rates(self, t: ca.SX, state: State, along: Directions, frame: Frame) -> State:
        """Rates of u, of the momentum (in the place of w: all forces, and the kinetic energy's gradient) and of z."""
        ...


def explicit_step(field: Field, tableau: Tableau, h: ca.SX, t: ca.SX, start: State, frame: Frame) -> State:
    """The state after h by an explicit method; `frame` holds the directions at the start."""
    rates: list[State] = []
    for i in range(len(tableau.b)):
        change = _combined(rates, tableau.a[i, :i])
        if change is None:
            now, along = start, frame.turned(None)
        else:
            now = State(start.u + h * change.u, start.w + h * change.w, start.z + h * change.z)
            along = frame.turned(h * change.u[field.n_translations :])
        rates.append(field.rates(t + float(tableau.c[i]) * h, now, along, frame))
    change = _combined(rates, tableau.b)
    assert change is not None
    return State(start.u + h * change.u, start.w + h * change.w, start.z + h * change.z)


def _combined(rates: Sequence[State], factors: Table) -> State | None:
    """Σ factor · rate, or None where every factor is zero."""
    used = [(float(factor), rate) for factor, rate in zip(factors, rates, strict=True) if factor]
    if not used:
        return None
    # Equal factors are taken out, as in (k1 + 2 (k2 + k3) + k4) / 6.
    groups: dict[float, list[State]] = {}
    for factor, rate in used:
        groups.setdefault(factor, []).append(rate)
    sums = [(factor, _added(members)) for factor, members in groups.items()]
    return _added([State(f * s.u, f * s.w, f * s.z) if f != 1 else s for f, s in sums])


def _added(states: Sequence[State]) -> State:
    total = states[0]
    for state in states[1:]:
        total = State(total.u + state.u, total.w + state.w, total.z + state.z)
    return total


@dataclass(frozen=True)
class GaussStep:
    """A step of Gauss's method in parts: `start`, then `iterate` again and again, then `finish`.

    The unknowns are the rates of u, p and z at all stages, stacked; one change beyond rounding remains as `residual`,
    relative to their size.
    """

    start: ca.SX
    iterate: ca.SX
    finish: State
    residual: ca.SX
    unknowns: ca.SX


def gauss_step(field: Field, tableau: Tableau, h: ca.SX, t: ca.SX, state: State) -> GaussStep:
    """The parts of one implicit step from `state`."""
    n, n_z, k, stages = state.u.shape[0], state.z.shape[0], field.n_translations, len(tableau.b)
    size = 2 * n + n_z
    here = Computed(state.u[k:])
    at_start = here.turned(None)
    p = field.momentum(state.w, at_start)
    first = _column(field.momentum_rates(t, state, at_start, here))

    unknowns = ca.SX.sym("stages", size * stages)
    rates = [unknowns[size * i : size * (i + 1)] for i in range(stages)]
    renewed: list[ca.SX] = []
    for i in range(stages):
        change = sum((float(tableau.a[i, j]) * rates[j] for j in range(stages)), start=ca.SX.zeros(size, 1))
        u = state.u + h * change[:n]
        frame = Computed(u[k:])
        along = frame.turned(None)
        w = field.rates_of_momentum(p + h * change[n : 2 * n], along)
        now = State(u, w, state.z + h * change[2 * n :])
        at = t + float(tableau.c[i]) * h
        renewed.append(_column(field.momentum_rates(at, now, along, frame)))
    iterate = ca.vertcat(*renewed)

    change = sum((float(b) * rate for b, rate in zip(tableau.b, rates, strict=True)), start=ca.SX.zeros(size, 1))
    u = state.u + h * change[:n]
    w = field.rates_of_momentum(p + h * change[n : 2 * n], Computed(u[k:]).turned(None))
    difference = iterate - unknowns
    # Rates of u alone: those of p and z follow from them and have other units.
    rows = [size * i + row for i in range(stages) for row in range(n)]
    residual = ca.dot(difference[rows], difference[rows]) / (ca.dot(iterate[rows], iterate[rows]) + _FLOOR)
    return GaussStep(
        start=ca.repmat(first, stages, 1),
        iterate=iterate,
        finish=State(u, w, state.z + h * change[2 * n :]),
        residual=residual,
        unknowns=unknowns,
    )


# Square of a rate, (m/s)² or (rad/s)², below which changes do not matter.
_FLOOR = 1e-18


def _column(rates: State) -> ca.SX:
    return ca.vertcat(rates.u, rates.w, rates.z)
