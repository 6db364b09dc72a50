"""The sampled loop linearised about its equilibrium: multipliers, growth rate, gains between which it is stable.

In: the same options as `simulate`, and the same graphs. Between the samples the linear plant is advanced exactly,
unless an integrator is asked for: integrators damp fast modes by themselves. Out: eigenvalues, with what no feedback
holds (the self-motion of a redundant arm: an undriven eigenvalue 1) taken out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any, Unpack, cast

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.errors import InputError
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Vector
from flexopt.foundation.boundary import Keywords, number, public
from flexopt.loop.closed import closed_loop
from flexopt.loop.structure import LoopStructure
from flexopt.loop.tangent import Tangent, still, tangent
from flexopt.model import AnyMachine
from flexopt.model.simulation import LinearKeywords, SimulationOptions, dead_time
from flexopt.plant import build_plant
from flexopt.simulation.scenario import Scenario, build_scenario, checked_options, given_options

EXACT = "exact"
# Share of the largest singular value of Φ − 1 below which a direction stays where it is.
INVARIANT = 1e-10
# Share of its kinetic energy in the self-motion above which a motion is that.
OWN = 0.9
# Gains searched for the stability border.
KP_LOW, KP_HIGH, KP_POINTS = 1e1, 1e9, 400
# Relative width to which a narrow interval between two of them is looked for.
NARROW = 1e-3


@dataclass(frozen=True)
class SampledLoop:
    """The linear loop x_{k+1} = Φ x_k about equilibrium.

    Attributes:
        multipliers: eigenvalues of Φ, largest first; what nothing holds left out.
        period: of a sample, s.
        neutral: how many eigenvalues 1 were taken out, of what nothing drives or brakes: the self-motion of a redundant
            arm, and directions without gain.
        drift: growth rates of the self-motion where weight or damping act on it, 1/s; taken out, too: an arm that
            drifts while its end-point stays is no oscillation.
        integrator: how the plant is advanced between samples: `"exact"`, or the method asked for.
        rounding: of a growth rate, 1/s: what is nearer to zero is neither growth nor decay.
    """

    multipliers: NDArray[np.complex128]
    period: float
    neutral: int = 0
    drift: tuple[float, ...] = ()
    integrator: str = EXACT
    rounding: float = 0.0

    @property
    def growth_rate(self) -> float:
        """Max ln|μ| / T, 1/s: below 0 the loop is stable."""
        return float(np.log(np.abs(self.multipliers[0])) / self.period)

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Ln μ / T, rad/s, imaginary parts up to the Nyquist frequency."""
        return cast(NDArray[np.complex128], np.log(self.multipliers) / self.period)

    @property
    def frequency_hz(self) -> float:
        """Of the pole nearest to instability, Hz."""
        return abs(float(np.angle(self.multipliers[0]))) / (2 * np.pi * self.period)

    @property
    def stable(self) -> bool:
        """Whether all multipliers lie inside the unit circle."""
        return bool(np.abs(self.multipliers[0]) < 1.0)

    def __repr__(self) -> str:
        word = "stable" if self.stable else "unstable"
        how = "" if self.integrator == EXACT else f" by {self.integrator}"
        return (
            f"SampledLoop({word}{how}: {self.growth_rate:+.4g}/s at {self.frequency_hz:.4g} Hz, "
            f"{len(self.multipliers)} multipliers)"
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


def _note(arguments: Arguments, given: Mapping[str, Any]) -> None:
    arguments.collect("", lambda: linear_options(arguments.of, given_options(given), arguments.call))


_LINEAR = Keywords(SimulationOptions, LinearKeywords, together=True)


@public(together=_note, keywords=_LINEAR)
def sampled_loop(
    machine: AnyMachine,
    posture: Any = None,
    *,
    options: SimulationOptions | None = None,  # noqa: ARG001 - its fields come as keywords
    **keywords: Unpack[LinearKeywords],
) -> SampledLoop:
    """Multipliers of the loop that `simulate` runs, at its equilibrium.

    Between the samples x(t + h) = e^{Ah} x(t) + ∫₀ʰ e^{As} ds B τ, exactly. Limits, dead bands and rounding of
    measurements are left out: they do not exist for vanishing motions. Paths are left out: the base stands, and the
    target.

    Args:
        machine, posture, options, keywords: as for `flexopt.simulate`, but `integrator`: `"exact"` (default), or a
            method whose own error is then part of the loop (`"rk4"` is the article's; at 5 ms it damps modes of 13 Hz
            and more); and `sensor.delay`, which may be any time (with `"exact"`).

    Raises:
        InputError: as `simulate`; or the design posture is no equilibrium (weight without compensation).
    """
    return linearised(linear_scenario(machine, {"posture": posture} | keywords, "sampled_loop"))


@public(together=_note, ratio=number("s", low=0.0, high=1e9), keywords=_LINEAR)
def stability_border(
    machine: AnyMachine,
    posture: Any = None,
    *,
    ratio: float | None = None,
    options: SimulationOptions | None = None,  # noqa: ARG001 - its fields come as keywords
    **keywords: Unpack[LinearKeywords],
) -> StabilityBorder:
    """Gains Kp for which the sampled linear loop is stable.

    Args:
        machine, posture, options, keywords: as for `flexopt.sampled_loop`; `kp` is ignored.
        ratio: hold Kv = ratio · Kp (s) instead of Kv.

    Raises:
        InputError: as `sampled_loop`.
    """
    from scipy.optimize import brentq  # noqa: PLC0415  (loads slowly)

    scenario = linear_scenario(machine, {"posture": posture} | keywords, "stability_border")
    kv = float(scenario.options.kv[0])

    def growth(exponent: float) -> float:
        kp = 10.0**exponent
        rows = scenario.loop.structure.n_task
        parts = {"kp": np.full(rows, kp), "kv": np.full(rows, ratio * kp if ratio is not None else kv)}
        return linearised(replace(scenario, parts={**scenario.parts, **parts})).growth_rate

    low, high = math.log10(KP_LOW), math.log10(KP_HIGH)
    grid = _with_narrow(growth, np.linspace(low, high, KP_POINTS).tolist())
    stable = np.array([value < 0 for _, value in grid])
    edges = np.flatnonzero(stable[1:] != stable[:-1])
    roots = [float(10 ** brentq(growth, grid[i][0], grid[i + 1][0], xtol=1e-10)) for i in edges.tolist()]
    ends = ([KP_LOW] if stable[0] else []) + roots + ([KP_HIGH] if stable[-1] else [])
    intervals = tuple(zip(ends[::2], ends[1::2], strict=True))
    return StabilityBorder(intervals, (KP_LOW, KP_HIGH), kv if ratio is None else ratio, ratio is not None)


def _with_narrow(growth: Callable[[float], float], grid: list[float]) -> list[tuple[float, float]]:
    """Exponents and growth rates, ascending, with the extremes between them that change the sign.

    An interval narrower than the grid shows as a valley above zero, or a gap as a hill below it.
    """
    from scipy.optimize import minimize_scalar  # noqa: PLC0415  (loads slowly)

    values = [growth(x) for x in grid]
    found = list(zip(grid, values, strict=True))
    for before, here, after, left, right in zip(values, values[1:], values[2:], grid, grid[2:], strict=False):
        sign = 1.0 if here > 0 else -1.0
        # A valley of |growth|, all of one sign.
        if sign * here <= sign * before and sign * here <= sign * after and sign * before > 0 and sign * after > 0:
            best: Any = minimize_scalar(
                partial(_times, sign, growth), bounds=(left, right), method="bounded",
                options={"xatol": math.log10(1 + NARROW) / 10},
            )  # fmt: skip
            if best.fun < 0:
                found.append((float(best.x), sign * float(best.fun)))
    return sorted(found)


def _times(sign: float, growth: Callable[[float], float], exponent: float) -> float:
    return sign * growth(exponent)


def linearised(scenario: Scenario) -> SampledLoop:
    """The sampled linear loop of a scenario made by `linear_scenario`."""
    s, structure = scenario, scenario.loop.structure
    x, e, c = s.resting, np.zeros(s.loop.signals.total), s.constants
    here = tangent(structure, x, e, c)
    if not still(structure, here, x):
        moved = float(np.abs(here.moved).max())
        raise InputError(
            "the design posture is no equilibrium: the weight acts and the command does not carry it "
            f"(the states move by {moved:.2g} in one sample); give gravity_compensation = True"
        )
    if s.exact:
        return exactly(s, here)
    return _spectrum(s, np.array(_derivative(structure).call([x, e, c])[0]), s.options.integrator)


def exactly(scenario: Scenario, here: Tangent) -> SampledLoop:
    """The loop about a state of rest, advanced exactly."""
    _, early = dead_time(scenario.options)
    return _spectrum(scenario, here.sample(scenario.period, early), EXACT)


def _spectrum(scenario: Scenario, matrix: Vector, integrator: str) -> SampledLoop:
    from scipy.linalg import matrix_balance  # noqa: PLC0415  (loads slowly)

    if not np.all(np.isfinite(matrix)):
        raise InputError("the linear loop grows beyond the largest number within one sample; give lower gains")
    balanced, (scale, _) = matrix_balance(matrix, permute=False, separate=True)
    held, kept = _without_neutral(np.asarray(balanced, dtype=np.float64), _neutral(scenario))
    removed, excess = len(matrix) - len(held), scenario.loop.shape.n_joints - scenario.loop.shape.n_task
    if excess > 0 and removed < 2 * excess:
        values, vectors = np.linalg.eig(held)
        drifting = _drifting(scenario, values, scale[:, None] * (kept.T @ vectors), 2 * excess - removed)
    else:
        values = np.asarray(np.linalg.eigvals(held), dtype=complex)
        drifting = np.zeros(len(values), dtype=bool)
    rounding = 10 * len(matrix) * np.finfo(float).eps * float(np.linalg.norm(balanced))
    values = np.asarray(values, dtype=np.complex128)
    apart, values = np.real(values[drifting]), values[~drifting]
    values = values[np.argsort(-np.abs(values))]
    drift = tuple(sorted((np.log(apart) / scenario.period).tolist(), reverse=True))
    return SampledLoop(values, scenario.period, removed, drift, integrator, rounding / scenario.period)


def _drifting(scenario: Scenario, values: NDArray[np.complex128], vectors: Any, most: int) -> NDArray[np.bool_]:
    """Which eigenvalues belong to an arm that drifts along its self-motion: real, and its the kinetic energy.

    Weight makes the self-motion of an arm on a base that gives no longer neutral, nor does damping of it.
    """
    s, motion = scenario, scenario.loop.shape
    plant, n, m = build_plant(s.machine), motion.n, motion.n_passive
    p = plant.parameter_values
    joints = np.linalg.svd(plant.rigid_jacobian(s.q_design, s.base, p).full())[2][motion.n_task :].T
    own = np.vstack([np.zeros((m, joints.shape[1])), joints])
    mass: Vector = plant.mass(s.q_design, s.base, p).full()
    rates = np.asarray(s.loop.to_q @ vectors[n : 2 * n], dtype=np.complex128)
    along: NDArray[np.complex128] = own.T @ mass @ rates
    part = np.einsum("ik,ik->k", along.conj(), np.linalg.solve(own.T @ mass @ own, along)).real
    whole = np.einsum("ik,ij,jk->k", rates.conj(), mass, rates).real
    share = np.where((values.imag == 0) & (values.real > 0), part / np.maximum(whole, np.finfo(float).tiny), 0.0)
    drifting = share > OWN
    drifting[np.argsort(-share)[most:]] = False
    return drifting


def linear_scenario(machine: AnyMachine, given: Mapping[str, Any], call: str) -> Scenario:
    """A scenario without what vanishing motions do not feel; exact where no integrator is asked for."""
    options, exact = linear_options(machine, given, call)
    return bare_scenario(machine, options, exact=exact)


def linear_options(machine: AnyMachine | None, given: Mapping[str, Any], call: str) -> tuple[SimulationOptions, bool]:
    """Checked options, and whether the loop is advanced exactly, in which there are no substeps."""
    method = given.get("integrator")
    exact = method is None or (isinstance(method, str) and method == EXACT)
    rest = {name: value for name, value in given.items() if not (exact and name == "integrator")}
    options = checked_options(call, machine, rest, any_delay=exact)
    return options.model_copy(update={"substeps": None}) if exact else options, exact


def bare_scenario(
    machine: AnyMachine,
    options: SimulationOptions,
    zeros: frozenset[str] | None = None,
    *,
    exact: bool = True,
    paths: bool = False,
) -> Scenario:
    """The like of checked options; `zeros` as of `build_scenario`; `paths`: base and target stay signals."""
    bare = {"torque_limit": None, "dead_band": None, "rate_limit": None, "levers": None}
    clean = {"noise": 0.0, "rate_noise": 0.0, "resolution": 0.0, "rate_resolution": 0.0}
    update: dict[str, Any] = {
        "actuator": options.actuator.model_copy(update=bare),
        "sensor": options.sensor.model_copy(update=clean),
        "baked": False,
    }
    update |= {} if paths else {"base_path": None, "target_path": None}
    return build_scenario(machine, options.model_copy(update=update), zeros, exact=exact)


@lru_cache(maxsize=64)
def _derivative(structure: LoopStructure) -> ca.Function:
    """Φ = ∂x_{k+1}/∂x_k of an integrator's own step. Inputs x, e, c."""
    step = closed_loop(structure).step
    symbols = [ca.MX.sym(name, step.size1_in(name)) for name in step.name_in()]
    phi = ca.jacobian(step.call(symbols)[0], symbols[0])
    whole = ca.Function("derivative", symbols, [ca.densify(phi)], step.name_in(), ["phi"])
    return whole.expand() if step.is_a("SXFunction") else whole


def _neutral(scenario: Scenario) -> int:
    """In how many directions the loop may rest elsewhere: self-motion, and task rows that no gain holds."""
    motion, structure = scenario.loop.shape, scenario.loop.structure
    if structure.law == "none":
        return motion.n_joints
    free = motion.n_joints - motion.n_task
    if structure.law not in ("pd", "pid"):
        return free
    kp, ki = (np.broadcast_to(scenario.parts[name], structure.n_task) for name in ("kp", "ki"))
    unheld = kp == 0
    if structure.law == "pid":
        # An integral without gain keeps what it has; a row without either gain rests anywhere.
        return free + int(np.count_nonzero(ki == 0)) + int(np.count_nonzero(unheld & (ki == 0)))
    return free + int(np.count_nonzero(unheld))


def _without_neutral(matrix: Vector, most: int) -> tuple[Vector, Vector]:
    """Φ on what is left when states that stay where they are, then rates that nothing changes, are divided out.

    Both are kernels of Φ − 1, the second of what the first leaves; together a double eigenvalue 1 for each direction.

    Returns:
        The matrix U Φ Uᵀ that is left, and U, orthonormal rows.
    """
    basis = np.eye(len(matrix))
    for _ in range(2):
        if not most:
            break
        _, sizes, rows = np.linalg.svd(matrix - np.eye(len(matrix)))
        most = int(np.count_nonzero(sizes[-most:] < INVARIANT * sizes[0]))
        kept = rows[: len(matrix) - most]
        # Φ v = v on the kernel: in this basis the matrix is block triangular, with 1 in the lower block.
        matrix, basis = np.asarray(kept @ matrix @ kept.T), kept @ basis
    return matrix, basis
