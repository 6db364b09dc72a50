"""The article's closed loops, Figs. 9 to 12, with the gains that it does not print stated.

In: the shipped experiment `article-move`, which states them, and postures to stand in. Out: `ClosedLoops`: nonlinear
runs and base trajectories, and the poles of the sampled linear loop beside them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from flexopt.article.tables import TARGET, X_MOBILE
from flexopt.foundation.arrays import Document, Vector
from flexopt.foundation.results import Result
from flexopt.model import AnyMachine, load_experiment
from flexopt.plant import inverse_kinematics
from flexopt.robustness import Evaluation, evaluate
from flexopt.selection import BaseTrajectory, Selection, nullspace_trajectory
from flexopt.simulation import SampledLoop, Trajectory, sampled_loop, simulate
from flexopt.simulation.linear import EXACT

EXPERIMENT = "article-move"
OPTIMUM = "optimised (addition)"
WITH, WITHOUT = "base adjusted", "not adjusted"
# The second pair: its poles lie closer to the border, so it takes longer to tell.
LOW_GAINS, LOW_SECONDS = {"kp": 1e4, "kv": 1e3}, 60.0
FIGURE_9_SECONDS, FIGURE_11_SECONDS = 10.0, 15.0
# As long as the beating of its close poles takes to die away.
ROBUST_SECONDS = 40.0
# Integrates a nonlinear run without error that would show: what the machine itself would do.
ACCURATE = "dop853"
# Of the way without a stop, which is only drawn.
CLIMB_HZ = 50.0
# Samples of a base trajectory to one that the JSON document holds.
THINNED = 20


@dataclass(frozen=True)
class LoopRow(Result):
    """One posture with one pair of gains: poles nearest to instability, and the nonlinear run.

    Attributes:
        stand: the posture's name.
        kp, kv: gains.
        stated: the sampled linear loop as the stated integrator makes it, its own damping included.
        accurate: the sampled linear loop itself, exact between the samples.
        run: the nonlinear loop with the stated integrator.
    """

    DOCUMENT = """
    posture=stand kp kv growth_rate_stated_integrator=stated.growth_rate[1/s]
    frequency_stated_integrator_hz=stated.frequency_hz growth_rate_accurate=accurate.growth_rate[1/s]
    frequency_accurate_hz=accurate.frequency_hz run
    """

    stand: str
    kp: float
    kv: float
    stated: SampledLoop
    accurate: SampledLoop
    run: Trajectory = field(repr=False)


@dataclass(frozen=True)
class RobustRow(Result):
    """The controller that attains ε_max, at posture A: the sampled linear loop, and a nonlinear run.

    `integrator` is that of the linear loop, `"exact"` or the stated one.
    """

    DOCUMENT = "integrator growth_rate=linear.growth_rate[1/s] frequency_hz=linear.frequency_hz run"

    integrator: str
    linear: SampledLoop
    run: Trajectory | None = field(repr=False)


@dataclass(frozen=True)
class ClosedLoops:
    """Figs. 9 to 12 and the numbers beside them.

    Attributes:
        stated: gains, start, rate, integrator and limits of the base's motion, by the names of the experiment file.
        stands: postures A and B of Table 2 and the optimised one, every measure of each.
        rows: each of them with both pairs of gains, the stated pair first; `figure9` takes its runs from here.
        stopped: Fig. 10, uphill on w_1 from A to the article's x_mobile.
        climb: the same without a stop, at 50 samples a second.
        adjustment: Figs. 11 and 12, the runs with and without base adjustment.
        low_adjustment: the run with base adjustment and the second pair of gains.
        from_rest: with base adjustment, started on the target: what the motion itself excites.
        robust: the controller that attains ε_max at posture A.
    """

    stated: dict[str, Any]
    stands: dict[str, Evaluation] = field(repr=False)
    rows: tuple[LoopRow, ...]
    stopped: BaseTrajectory = field(repr=False)
    climb: BaseTrajectory = field(repr=False)
    adjustment: dict[str, Trajectory] = field(repr=False)
    low_adjustment: Trajectory = field(repr=False)
    from_rest: Trajectory = field(repr=False)
    robust: tuple[RobustRow, ...]

    @property
    def figure9(self) -> dict[str, Trajectory]:
        """Runs with the stated gains, by posture."""
        return {row.stand: row.run for row in self.rows[: len(self.stands)]}

    @property
    def pairs(self) -> tuple[tuple[float, float], ...]:
        """The two pairs (Kp, Kv)."""
        return tuple((row.kp, row.kv) for row in self.rows[:: len(self.stands)])

    @property
    def sentence(self) -> str:
        """What is stated and what is not the article's."""
        s = self.stated
        start = ", ".join(f"{x:+g}" for x in s["offset"])
        return (
            "The article prints neither gains nor the start of its runs. Stated here: Jacobian "
            f"{s['control']} control, Kp = {s['kp']:g} N m, Kv = {s['kv']:g} N m s, the arm's joints displaced by "
            f"({start}) rad at the start, {s['integrator'].upper()} at {s['rate']:g} Hz, gravity compensated. The base "
            f"moves at most {s['max_base_rate']:g} m/s with {s['max_base_acceleration']:g} m/s², uphill on "
            f"{s['objective']} with a scalar kξ, and stops at Table 2's x_mobile = {X_MOBILE['B']:g} m: the law alone "
            f"goes on to {float(self.climb.base[-1, 0]):.3f} m. The optimised posture is an addition."
        )

    def to_dict(self) -> Document:
        """JSON-ready but for arrays.

        Keys: `stated`; `postures` (name: base, m, posture, rad, w, epsilon_max); `loops` (a row for each posture and
        pair of gains); `figure10` (`stopped`, `unlimited`); `figures11and12` (name: run); `second_gains_adjustment`,
        `adjustment_from_rest` (runs); `robust_controller_at_A` (a row for each integrator); `sentence`.
        """
        postures = {
            name: {"base": e.base, "posture": e.posture, "w": e.w, "epsilon_max": e.epsilon_max}
            for name, e in self.stands.items()
        }
        return {
            "stated": self.stated,
            "postures": postures,
            "loops": [row.to_dict() for row in self.rows],
            "figure10": {"stopped": climb_numbers(self.stopped), "unlimited": climb_numbers(self.climb)},
            "figures11and12": {name: run.to_dict() for name, run in self.adjustment.items()},
            "second_gains_adjustment": self.low_adjustment.to_dict(),
            "adjustment_from_rest": self.from_rest.to_dict() | {"peak_error": peak_error(self.from_rest)},
            "robust_controller_at_A": [row.to_dict() for row in self.robust],
            "sentence": self.sentence,
        }


def peak_error(run: Trajectory) -> float:
    """Largest |r_d − r|, m."""
    return float(np.sqrt(np.nanmax(np.sum(run.error**2, axis=1))))


def workspace_x(climb: BaseTrajectory) -> Vector:
    """X of the end-point in the workspace frame at both ends, (2,), m."""
    return np.array([climb.target[0] - float(e.skeleton[0, 1]) for e in (climb.initial, climb.final)])


def climb_numbers(climb: BaseTrajectory) -> dict[str, Any]:
    """Ends of a base trajectory, and every `THINNED`th sample of its time, s, base, m, and V."""
    kept = [*range(0, climb.time.size - 1, THINNED), climb.time.size - 1]
    return {
        "duration": climb.time[-1], "base_end": climb.base[-1], "posture_end": climb.posture[-1],
        "workspace_x_end": workspace_x(climb)[1], "V_start": climb.V[0], "V_end": climb.V[-1],
        "largest_base_rate": np.abs(climb.base_rate).max(), "largest_end_point_error": climb.end_point_error.max(),
        "stop": climb.status, "time": climb.time[kept], "base": climb.base[kept], "V": climb.V[kept],
    }  # fmt: skip


def article_stands(machine: AnyMachine, selection: Selection, gain: float) -> dict[str, Evaluation]:
    """Postures A and B of Table 2 from its inertial end-point and x_mobile, and the best local optimum."""
    found: dict[str, Evaluation] = {}
    for name, base in X_MOBILE.items():
        posture = inverse_kinematics(machine, TARGET, base=base, elbow="up")[0]
        found[name] = evaluate(machine, posture, base=base, gain=gain)
    best = selection.best.evaluation
    return found | {OPTIMUM: evaluate(machine, best.posture, base=best.base, gain=gain)}


def close_loops(machine: AnyMachine, stands: Mapping[str, Evaluation]) -> ClosedLoops:
    """Run everything; `stands` from `article_stands`."""
    experiment = load_experiment(EXPERIMENT)
    options, law = experiment.simulation, experiment.nullspace
    assert law is not None
    (kp,), (kv,) = options.kp, options.kv
    given: dict[str, Any] = {"offset": options.offset, "control": options.control, "feedback": options.feedback}
    given |= {"rate": options.rate, "integrator": options.integrator}
    stop: dict[str, Any] = {"base_range": (X_MOBILE["B"], X_MOBILE["A"])}
    stated = given | {"kp": kp, "kv": kv} | law.model_dump(exclude_none=True, exclude={"duration"}) | stop

    pairs: tuple[tuple[dict[str, float], float], ...]
    pairs = (({"kp": kp, "kv": kv}, FIGURE_9_SECONDS), (LOW_GAINS, LOW_SECONDS))
    a = stands["A"]
    moving: dict[str, Any] = law.model_dump() | {"base": a.base, "control": options.control, "rate": options.rate}
    free: dict[str, Any] = moving | {"base_range": None, "rate": CLIMB_HZ}
    stopped = nullspace_trajectory(machine, a.posture, **moving | stop)
    climb = nullspace_trajectory(machine, a.posture, **free)
    rows = tuple(
        _row(machine, name, stand, gains, given | {"duration": seconds})
        for gains, seconds in pairs
        for name, stand in stands.items()
    )
    driven: dict[str, Any] = given | pairs[0][0] | {"base": a.base, "duration": FIGURE_11_SECONDS}

    def run(**more: Any) -> Trajectory:
        options: dict[str, Any] = driven | {"base_path": stopped.path} | more
        return simulate(machine, a.posture, **options)

    return ClosedLoops(
        stated=stated,
        stands=dict(stands),
        rows=rows,
        stopped=stopped,
        climb=climb,
        adjustment={WITH: run(), WITHOUT: run(base_path=None)},
        low_adjustment=run(**LOW_GAINS, duration=LOW_SECONDS),
        from_rest=run(offset=[0.0] * a.posture.size),
        robust=_robust_rows(machine, a, given),
    )


def _row(machine: AnyMachine, name: str, stand: Evaluation, gains: dict[str, float], given: dict[str, Any]) -> LoopRow:
    options: dict[str, Any] = given | gains | {"base": stand.base}
    exactly: dict[str, Any] = options | {"integrator": EXACT}
    return LoopRow(
        stand=name,
        kp=gains["kp"],
        kv=gains["kv"],
        stated=sampled_loop(machine, stand.posture, **options),
        accurate=sampled_loop(machine, stand.posture, **exactly),
        run=simulate(machine, stand.posture, **options),
    )


def _robust_rows(machine: AnyMachine, stand: Evaluation, given: dict[str, Any]) -> tuple[RobustRow, ...]:
    """With the stated integrator, which shows the loop falsely, no run."""
    options: dict[str, Any] = given | {"feedback": "robust", "base": stand.base}
    exact: dict[str, Any] = options | {"integrator": EXACT}
    accurate: dict[str, Any] = options | {"integrator": ACCURATE, "duration": ROBUST_SECONDS}
    return (
        RobustRow(given["integrator"], sampled_loop(machine, stand.posture, **options), None),
        RobustRow(EXACT, sampled_loop(machine, stand.posture, **exact), simulate(machine, stand.posture, **accurate)),
    )
