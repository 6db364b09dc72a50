"""How far the full plant is from the rigid one, in the gap and the ν-gap, as the machine's damping grows.

In: a machine and named postures. Out: a `GapSweep`: the distances beside w_1 and ε_max, and what they say of the
article's link between the two, "seen in the GAP metric between the rigid body excavator system and the total flexible
system".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexopt.article.curves import rank_correlation
from flexopt.coprime import gap, nu_gap
from flexopt.coprime.margin import RIGID_MARGIN
from flexopt.errors import FlexoptError
from flexopt.foundation.arrays import Vector
from flexopt.foundation.control import Control
from flexopt.foundation.results import Result
from flexopt.foundation.turns import in_turn
from flexopt.model import AnyMachine
from flexopt.robustness import build_measures
from flexopt.robustness.margin import build_margin

FACTORS = (1.0, 10.0, 100.0, 1e3, 1e4)


@dataclass(frozen=True)
class GapSweep(Result):
    """Rows are postures (k,), columns factors of the damping (f,).

    Attributes:
        control, gain: the plant is kr P, the rigid one kr R_0/s².
        factors: of every damper of the machine, (f,).
        names: of the postures.
        posture: (k, n), rad.
        w1: (k,), of the undamped plant.
        epsilon_max, gap, nu_gap: (k, f); NaN where not computable.
    """

    DOCUMENT = """
    control gain factors names posture w1 epsilon_max gap nu_gap within
    correlation_nu_gap_epsilon_max=correlation_epsilon correlation_nu_gap_w1=correlation_w1 holds_at_own_damping
    sentence
    """

    control: Control
    gain: float
    factors: tuple[float, ...]
    names: tuple[str, ...]
    posture: Vector
    w1: Vector
    epsilon_max: Vector
    gap: Vector
    nu_gap: Vector

    @property
    def within(self) -> tuple[int, ...]:
        """For each factor, how many postures are nearer to their rigid plant than its ε_max, sin(π/8)."""
        return tuple(int(np.count_nonzero(column < RIGID_MARGIN)) for column in self.nu_gap.T)

    @property
    def correlation_epsilon(self) -> tuple[float, ...]:
        """For each factor, Spearman's correlation over the postures of the ν-gap with ε_max (the link wants −1)."""
        return tuple(rank_correlation(g, e) for g, e in zip(self.nu_gap.T, self.epsilon_max.T, strict=True))

    @property
    def correlation_w1(self) -> tuple[float, ...]:
        """The like with w_1."""
        return tuple(rank_correlation(g, self.w1) for g in self.nu_gap.T)

    @property
    def holds_at_own_damping(self) -> bool:
        """Whether the ν-gap is below the rigid plant's margin anywhere at the machine's own damping."""
        return self.within[0] > 0

    @property
    def sentence(self) -> str:
        """What the numbers say."""
        low, high = float(np.nanmin(self.nu_gap[:, 0])), float(np.nanmax(self.nu_gap[:, 0]))
        first = next((f for f, n in zip(self.factors, self.within, strict=True) if n), None)
        text = (
            f"At the machine's own damping the ν-gap between rigid and full plant lies between {low:.5f} and "
            f"{high:.5f} at {len(self.names)} postures, robust ones among them; "
        )
        if self.holds_at_own_damping:
            text += f"{self.within[0]} of them are nearer than ε_max = {RIGID_MARGIN:.4f} of the rigid plant, so that "
            text += "the link through the gap holds there. "
        else:
            text += f"none is nearer than ε_max = {RIGID_MARGIN:.4f} of the rigid plant, so that the gap guarantees "
            text += "nothing: the link through the gap fails as a number. "
        if first is None:
            text += f"No factor up to {self.factors[-1]:g} of the damping changes that"
        elif first > self.factors[0]:
            text += f"It takes {first:g} times the damping before any of them is"
        else:
            text += "More damping brings no new case"
        text += f" (as near: {', '.join(f'{n} at × {f:g}' for f, n in zip(self.factors, self.within, strict=True))}). "
        own, last = self.correlation_epsilon[0], self.correlation_epsilon[-1]
        order = "As an order it shows" if own <= -0.5 else "As an order it does not show either"
        return text + (
            f"{order}: the rank correlation of the ν-gap with ε_max is {own:+.2f} at the machine's damping and "
            f"{last:+.2f} at {self.factors[-1]:g} times it (the link wants −1); with w_1 it is "
            f"{self.correlation_w1[0]:+.2f} and {self.correlation_w1[-1]:+.2f}."
        )


@in_turn
def sweep_gaps(
    machine: AnyMachine,
    postures: Mapping[str, Vector],
    *,
    control: Control = "inverse",
    gain: float = 5e5,
    factors: tuple[float, ...] = FACTORS,
) -> GapSweep:
    """Gap, ν-gap, w_1 and ε_max at `postures` (name -> (n,), rad), the machine's dampers multiplied by each factor."""
    margin, measures = build_margin(machine, control), build_measures(machine, control)
    plant = margin.plant
    dampers = np.array(["damping" in name for name in plant.parameter_names])
    own, base = np.array(plant.parameter_values).ravel(), np.zeros(plant.n_base)
    shape = (len(postures), len(factors))
    epsilon, wide, nu, w1 = np.empty(shape), np.empty(shape), np.empty(shape), np.empty(shape[0])
    for row, posture in enumerate(postures.values()):
        v = measures.values(base=base, posture=posture, p=own)
        w1[row] = float(v["w"][0])
        rigid = _rigid_plant(gain * v["rigid"].full())
        for column, factor in enumerate(factors):
            p = np.where(dampers, factor * own, own)
            a, b, c = (x.full() for x in margin.physical_plant.call([base, posture, p]))
            full = (a, gain * b, c)
            epsilon[row, column] = float(margin.values.call([base, posture, p, gain])[0][0])
            wide[row, column] = _distance(gap, rigid, full)
            nu[row, column] = _distance(nu_gap, rigid, full)
    angles = np.array(list(postures.values()))
    return GapSweep(control, gain, factors, tuple(postures), angles, w1, epsilon, wide, nu)


def _rigid_plant(residue: Vector) -> tuple[Vector, Vector, Vector]:
    """(A, B, C) of residue/s²."""
    identity, zero = np.eye(residue.shape[0]), np.zeros(residue.shape)
    a = np.block([[zero, identity], [zero, zero]])
    return a, np.vstack([zero, residue]), np.hstack([identity, zero])


def _distance(measure: Callable[[Any, Any], float], one: Any, two: Any) -> float:
    try:
        return measure(one, two)
    except FlexoptError:
        return math.nan
