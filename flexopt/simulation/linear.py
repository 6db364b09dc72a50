"""The sampled loop linearised about its equilibrium: multipliers, growth rate, gains between which it is stable.

In: the same options as `simulate`, and the same graph: the derivative of one sample by the states. Out: eigenvalues,
with the self-motion of a redundant arm (an undriven double eigenvalue 1) taken out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, cast

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.compiled.turns import in_turn
from flexopt.errors import InputError
from flexopt.model import AnyMachine
from flexopt.model.arguments import Vector
from flexopt.simulation.loop import closed_loop
from flexopt.simulation.scenario import Scenario, build_scenario, checked_options, start_states
from flexopt.simulation.structure import LoopStructure

EQUILIBRIUM = 1e-9
INVARIANT = 1e-8
# Gains searched for the stability border.
KP_LOW, KP_HIGH, KP_POINTS = 1e1, 1e9, 400


@dataclass(frozen=True)
class SampledLoop:
    """The linear loop x_{k+1} = Φ x_k about equilibrium.

    Attributes:
        multipliers: eigenvalues of Φ, largest first; self-motion left out.
        period: of a sample, s.
    """

    multipliers: NDArray[np.complex128]
    period: float

    @property
    def growth_rate(self) -> float:
        """Max ln|μ| / T, 1/s: below 0 the loop is stable."""
        return float(np.log(np.abs(self.multipliers[0])) / self.period)

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Ln μ / T, rad/s, imaginary parts up to the Nyquist frequency."""
        return cast(NDArray[np.complex128], np.log(self.multipliers) / self.period)

    @property
    def stable(self) -> bool:
        """Whether all multipliers lie inside the unit circle."""
        return bool(np.abs(self.multipliers[0]) < 1.0)

    def __repr__(self) -> str:
        word = "stable" if self.stable else "unstable"
        frequency = abs(self.poles[0].imag) / (2 * np.pi)
        return (
            f"SampledLoop({word}: {self.growth_rate:+.4g}/s at {frequency:.4g} Hz, {len(self.multipliers)} multipliers)"
        )


@dataclass(frozen=True)
class StabilityBorder:
    """Intervals of the gain Kp in which the sampled linear loop is stable, Kv as it stands.

    Attributes:
        intervals: (lower, upper) in N/m and the like; the ends of the search where it did not meet a border.
        searched: (lower, upper) of the search.
        kv: the other gain, or its ratio to Kp where that was held, s.
        ratio: whether Kv / Kp was held instead of Kv.
    """

    intervals: tuple[tuple[float, float], ...]
    searched: tuple[float, float]
    kv: float
    ratio: bool

    @property
    def largest(self) -> float | None:
        """The largest Kp of the lowest interval; None where no gain is stable."""
        return self.intervals[0][1] if self.intervals else None


@in_turn
def sampled_loop(machine: AnyMachine, posture: Any = None, **options: Any) -> SampledLoop:
    """Multipliers of the loop that `simulate` runs, at its equilibrium.

    Limits, dead bands and rounding of measurements are left out: they do not exist for vanishing motions.

    Args:
        machine, posture, options: as for `flexopt.simulate`.

    Raises:
        InputError: as `simulate`; or the design posture is no equilibrium (weight without compensation).
    """
    return linearised(_scenario(machine, {"posture": posture, **options}, "sampled_loop"))


@in_turn
def stability_border(
    machine: AnyMachine, posture: Any = None, *, ratio: float | None = None, **options: Any
) -> StabilityBorder:
    """Gains Kp for which the sampled linear loop is stable.

    Args:
        machine, posture, options: as for `flexopt.simulate`; `kp` is ignored.
        ratio: hold Kv = ratio · Kp (s) instead of Kv.

    Raises:
        InputError: as `simulate`.
    """
    from scipy.optimize import brentq  # noqa: PLC0415  (loads slowly)

    scenario = _scenario(machine, {"posture": posture, **options}, "stability_border")
    kv = float(scenario.options.kv[0])

    def growth(exponent: float) -> float:
        kp = 10.0**exponent
        rows = scenario.loop.structure.n_task
        parts = {"kp": np.full(rows, kp), "kv": np.full(rows, ratio * kp if ratio is not None else kv)}
        return linearised(replace(scenario, parts={**scenario.parts, **parts})).growth_rate

    low, high = math.log10(KP_LOW), math.log10(KP_HIGH)
    grid = [low + (high - low) * k / (KP_POINTS - 1) for k in range(KP_POINTS)]
    stable = np.array([growth(x) < 0 for x in grid])
    edges = np.flatnonzero(stable[1:] != stable[:-1])
    roots = [float(10 ** brentq(growth, grid[i], grid[i + 1], xtol=1e-10)) for i in edges.tolist()]
    ends = ([KP_LOW] if stable[0] else []) + roots + ([KP_HIGH] if stable[-1] else [])
    intervals = tuple(zip(ends[::2], ends[1::2], strict=True))
    return StabilityBorder(intervals, (KP_LOW, KP_HIGH), kv if ratio is None else ratio, ratio is not None)


def linearised(scenario: Scenario) -> SampledLoop:
    """The sampled linear loop of a scenario made by `_scenario`."""
    s, loop = scenario, scenario.loop
    x = start_states(s.machine, loop, s.parts, s.q_design[:, None])
    e = _still(s)
    c = s.constants
    step, phi = loop.step, _derivative(loop.structure)
    moved = step.call([x, e, c])[0].full() - x
    if float(np.abs(moved).max()) > EQUILIBRIUM:
        raise InputError(
            "the design posture is no equilibrium: the weight acts and the command does not carry it "
            f"(the states move by {np.abs(moved).max():.2g} in one sample); give gravity_compensation = True"
        )
    matrix = np.array(phi.call([x, e, c])[0])
    removed = 0
    for basis in _self_motions(s, x[:, 0], c):
        matrix, rank = _without(matrix, basis)
        removed += rank
    values = np.asarray(np.linalg.eigvals(matrix), dtype=complex)
    values = values[np.argsort(-np.abs(values))]
    return SampledLoop(values[: len(values) - removed], s.period)


def _scenario(machine: AnyMachine, given: Mapping[str, Any], call: str) -> Scenario:
    """A scenario without what vanishing motions do not feel."""
    options = checked_options(call, machine, given)
    bare = {"torque_limit": None, "dead_band": None, "rate_limit": None, "levers": None}
    exact = {"noise": 0.0, "rate_noise": 0.0, "resolution": 0.0, "rate_resolution": 0.0}
    still = options.model_copy(
        update={
            "actuator": options.actuator.model_copy(update=bare),
            "sensor": options.sensor.model_copy(update=exact),
            "base_path": None,
            "target_path": None,
            "baked": False,
        }
    )
    return build_scenario(machine, still)


def _still(scenario: Scenario) -> Vector:
    return np.zeros(scenario.loop.signals.total)


@lru_cache(maxsize=64)
def _derivative(structure: LoopStructure) -> ca.Function:
    """Φ = ∂x_{k+1}/∂x_k. Inputs x, e, c."""
    step = closed_loop(structure).step
    symbols = [ca.MX.sym(name, step.size1_in(name)) for name in step.name_in()]
    phi = ca.jacobian(step.call(symbols)[0], symbols[0])
    whole = ca.Function("derivative", symbols, [ca.densify(phi)], step.name_in(), ["phi"])
    return whole.expand() if step.is_a("SXFunction") else whole


def _self_motions(scenario: Scenario, x: Vector, c: Vector) -> list[Vector]:
    """Bases of the states that the end-point neither sees nor moves: the arm's self-motion, then its rate."""
    loop = scenario.loop
    motion = loop.shape
    n, excess = motion.n, motion.n_joints - motion.n_task
    if excess <= 0:
        return []
    rows = loop.outputs.name_out().index("end_point")
    symbol = [ca.MX.sym(name, loop.outputs.size1_in(name)) for name in loop.outputs.name_in()]
    jacobian = ca.jacobian(loop.outputs.call(symbol)[rows], symbol[0])
    by_u = np.array(ca.Function("J", symbol, [jacobian]).call([x, _still(scenario), c])[0])[:, :n]
    # Columns of the actuated joints, in u.
    joints = np.linalg.inv(loop.to_q)[:, motion.n_passive :]
    kernel = np.linalg.svd(by_u @ joints)[2][motion.n_task :].T
    position, rate = np.zeros((len(x), excess)), np.zeros((len(x), excess))
    position[:n], rate[n : 2 * n] = joints @ kernel, joints @ kernel
    return [position, rate]


def _without(matrix: Vector, basis: Vector) -> tuple[Vector, int]:
    """The matrix with the eigenvalues of an invariant subspace put to 0, and how many; unchanged where it is none."""
    q, _ = np.linalg.qr(basis)
    image = matrix @ q
    if np.linalg.norm(image - q @ (q.T @ image)) > INVARIANT * max(1.0, float(np.linalg.norm(image))):
        return matrix, 0
    complement = np.eye(len(q)) - q @ q.T
    return np.asarray(complement @ matrix @ complement), q.shape[1]
