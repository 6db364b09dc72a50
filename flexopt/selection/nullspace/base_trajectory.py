"""What the nullspace law returns, and how its path is timed so that the base keeps to an acceleration.

In: samples of a path along which the end-point stays put. Out: a `BaseTrajectory`; `retimed` gives the same path
another timing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Document, Vector
from flexopt.foundation.control import Control
from flexopt.foundation.pictures import Pictured
from flexopt.foundation.results import Result
from flexopt.model import AnyMachine
from flexopt.model.simulation import Path
from flexopt.robustness.evaluation import Evaluation


class Stop(Enum):
    """Why a trajectory ends where it does, as sentences."""

    GAIN = "the gain in V fell below min_gain: V is, or nearly is, stationary along the nullspace"
    SUMMIT = "V rises no further along the law's direction, not even over a thousandth of its step"
    BASE_RANGE = "the base reached the end of base_range"
    JOINT_LIMIT = "a joint reached its limit"
    SINGULAR = "the posture came as close to a singular one as singularity_margin_deg allows"
    DURATION = "the duration is over"
    DESCENDS = "V would descend: the matrix step_gain turns the law's step downhill (ξᵀ Δz < 0), as a scalar cannot"
    KINK = "V has a kink here, where the two largest eigenvalues of XZ meet: the law would go to and fro across it"
    UNSOLVED = "beyond this point the end-point could not be kept in its place, or V is no number"


@dataclass(frozen=True)
class Descent:
    """V[index + 1] = V[index] − amount, amount > 0; `predicted`: whether ξᵀ Δz < 0 said so beforehand."""

    index: int
    amount: float
    predicted: bool


@dataclass(frozen=True)
class BaseTrajectory(Pictured, Result):
    """A motion of base and arm that climbs V while the end-point stays put. N samples; SI and rad.

    Its picture: the machine at start and end, and the base's position and rate and V over time.

    The base is meant piecewise linear in time: base[k + 1] = base[k] + base_rate[k] (time[k + 1] − time[k]).

    Attributes:
        machine: the machine's name;  model: the machine;  objective, control: what V is.
        base_coordinates, joints: names.
        target: where the end-point stays, (n_task,), m, inertial frame.
        time: (N,), s, from 0.
        base: placements (N, n_b), m or rad.
        base_rate: (N, n_b), m/s or rad/s, from each sample to the next; 0 at the last one.
        posture: actuated joints (N, n), rad or m.
        V: the objective (N,).
        gradient: ξ = ∂V/∂z, z = [base, posture], (N, n_b + n); at a kink of ε_max that of the smaller branch.
        prediction: ξᵀ Δz, (N,): first-order change of V over the law's step, limits left aside.
        end_point_error: |r − target|, (N,), m.
        stop: why it ends.
        descents: every sample after which V is lower.
        initial, final: every measure at the ends.

    Example:
        >>> bool(climb.end_point_error.max() < 1e-6)
        True
    """

    DOCUMENT = """
    machine objective control base_coordinates joints target[m] time[s] base base_rate posture V gradient prediction
    end_point_error[m] stop status descents initial final provenance
    """

    machine: str
    model: AnyMachine = field(repr=False)
    objective: str
    control: Control
    base_coordinates: tuple[str, ...]
    joints: tuple[str, ...]
    target: Vector
    time: Vector
    base: Vector
    base_rate: Vector
    posture: Vector
    V: Vector
    gradient: Vector
    prediction: Vector
    end_point_error: Vector
    stop: Stop
    descents: tuple[Descent, ...]
    initial: Evaluation
    final: Evaluation
    provenance: Document = field(repr=False)

    @property
    def path(self) -> Path:
        """The base's motion as `flexopt.simulate` takes it."""
        return Path.model_validate({"times": self.time.tolist(), "points": tuple(self.base.tolist())})

    @property
    def status(self) -> str:
        """Why it ends, a sentence."""
        return self.stop.value

    def __repr__(self) -> str:
        point = ", ".join(f"{x:.4g}" for x in self.target)
        names = (*self.base_coordinates, *self.joints)
        lines = [
            f"{self.machine}: end-point kept at ({point}) m, Jacobian {self.control} control, objective "
            f"{self.objective}: {self.time.size} samples, {self.time[-1]:.4g} s",
            f"  {'time':>8} " + " ".join(f"{name:>9}" for name in names) + f"{'V':>13}",
        ]
        for k in sorted({0, self.time.size // 2, self.time.size - 1}):
            numbers = " ".join(f"{x:9.4f}" for x in (*self.base[k], *self.posture[k]))
            lines.append(f"  {self.time[k]:8.3f} {numbers}{self.V[k]:13.4e}")
        lengths = [k for k, unit in enumerate(self.model.base_units) if unit == "m"]
        fastest = float(np.linalg.norm(self.base_rate[:, lengths], axis=1).max())
        lines.append(f"  base at most {fastest:.4g} m/s, end-point off by at most {self.end_point_error.max():.1e} m")
        if self.descents:
            total = sum(descent.amount for descent in self.descents)
            lines.append(f"  V descends {len(self.descents)} times, by {total:.3g} in all")
        return "\n".join([*lines, f"  {self.status}"])


def retimed(base: Vector, rate: float, acceleration: float, duration: float) -> tuple[list[tuple[int, float]], bool]:
    """Time a path of the base so that it starts and ends at rest and keeps to an acceleration along the path.

    The base goes no faster than on the given samples, 1/rate apart; where it turns back it rests.

    Args:
        base: (M, n_b), samples of the path.
        rate: of the samples, given and returned, Hz.
        acceleration: m/s².
        duration: s; the path is cut short where it would take longer.

    Returns:
        For each sample the interval of the path and how far into it, as a share; and whether the path was cut short.
    """
    steps = np.diff(base, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    count = _longest(steps, lengths, rate, acceleration, duration)
    if count == 0:
        return [(0, 0.0)], len(lengths) > 0
    speeds = _speeds(steps[:count], lengths[:count], rate, acceleration)
    times = _times(speeds, lengths[:count], rate, acceleration)
    ends = np.concatenate([[0.0], np.cumsum(times)])
    whole_time = float(times.sum())
    samples = math.ceil(whole_time * rate - 1e-9)
    # Stretched to a whole number of intervals, which makes it slower, never faster.
    at = np.linspace(0.0, whole_time, samples + 1, dtype=np.float64)[:-1]
    interval: NDArray[np.int64] = np.clip(np.searchsorted(ends, at, side="right") - 1, 0, count - 1)
    since, whole = at - ends[interval], times[interval]
    start, end = speeds[interval], speeds[interval + 1]
    # Constant acceleration inside an interval; from rest to rest, up and down; without length, evenly.
    share = since / whole
    moving = start + end > 0
    way = since * (start + (end - start) * since / (2 * whole))
    share[moving] = (way[moving] / lengths[interval][moving]).clip(0.0, 1.0)
    hop = ~moving & (lengths[interval] > 0)
    share[hop] = np.where(share[hop] < 0.5, 2 * share[hop] ** 2, 1 - 2 * (1 - share[hop]) ** 2)
    timed = [(int(k), float(part)) for k, part in zip(interval, share, strict=True)]
    return [*timed, (count - 1, 1.0)], count < len(lengths)


def _longest(steps: Vector, lengths: Vector, rate: float, acceleration: float, duration: float) -> int:
    """How many intervals of the path, ending at rest, fit into the duration."""
    most = int(duration * rate + 1e-9) / rate

    def fits(count: int) -> bool:
        speeds = _speeds(steps[:count], lengths[:count], rate, acceleration)
        return float(_times(speeds, lengths[:count], rate, acceleration).sum()) <= most + 1e-12

    low, high = 0, len(lengths)
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (middle, high) if fits(middle) else (low, middle - 1)
    return low


def _speeds(steps: Vector, lengths: Vector, rate: float, acceleration: float) -> Vector:
    """Speeds at the ends of the intervals, (M + 1,): as given at most, u_{j+1}² − u_j² = ±2 a Δs at most."""
    allowed = np.zeros(len(lengths) + 1)
    allowed[1:-1] = np.minimum(lengths[:-1], lengths[1:]) * rate
    allowed[1:-1][np.sum(steps[:-1] * steps[1:], axis=1) < 0] = 0.0
    squares, gains = (allowed**2).tolist(), (2 * acceleration * lengths).tolist()
    for j, gain in enumerate(gains):
        squares[j + 1] = min(squares[j + 1], squares[j] + gain)
    for j in range(len(gains) - 1, -1, -1):
        squares[j] = min(squares[j], squares[j + 1] + gains[j])
    return np.sqrt(np.array(squares))


def _times(speeds: Vector, lengths: Vector, rate: float, acceleration: float) -> Vector:
    """How long each interval takes, (M,), s; one in which the base stands still takes 1/rate."""
    both = speeds[:-1] + speeds[1:]
    hop = 2 * np.sqrt(lengths / acceleration)
    return np.where(lengths == 0, 1 / rate, np.where(both > 0, 2 * lengths / np.where(both > 0, both, 1.0), hop))
