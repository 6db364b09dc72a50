"""Nonlinear runs of one loop on the members of what is uncertain.

In: a loop in a configuration, members. Out: an ensemble's verdicts, settling times and turns of the base.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.foundation.results import Result
from flexopt.loop.uncertain import UncertainLoop
from flexopt.simulation import simulate_ensemble
from flexopt.simulation.ensemble import Ensemble


@dataclass(frozen=True)
class Runs(Result):
    """What n nonlinear runs show.

    Attributes:
        verdicts: `"converges"`, `"grows"` or `"undecided"` of each, (n,); see `flexopt.Ensemble`.
        settling: of each, s; NaN where it does not.
        turn: largest turn of the base in each, rad.
        decay: as the run shows it, 1/s.
        duration: of a run, s.
    """

    verdicts: tuple[str, ...]
    settling: Vector
    turn: Vector
    decay: Vector
    duration: float

    DOCUMENT = "members converging verdicts settling[s] turn[rad] decay[1/s] duration[s]"

    @property
    def members(self) -> int:
        """How many."""
        return len(self.verdicts)

    @property
    def converging(self) -> float:
        """Share of them."""
        return self._share("converges")

    @property
    def growing(self) -> float:
        """Share of those that grow."""
        return self._share("grows")

    @property
    def undecided(self) -> float:
        """Share of those of which run and eigenvalues do not say the same, or the run is too short."""
        return self._share("undecided")

    def _share(self, word: str) -> float:
        return self.verdicts.count(word) / len(self.verdicts)


def nonlinear_runs(loop: UncertainLoop, members: Vector, duration: float) -> Runs:
    """Runs of the nonlinear closed loop from the start of `flexopt.simulate`, one for each member (n, k).

    Measurements wait whole samples in a run: a dead time between them is taken as the longer one.
    """
    waits = [math.ceil(loop.box.numbers(u)[1] * loop.settings.rate - 1e-6) for u in members]
    verdicts, found = [""] * len(members), np.zeros((3, len(members)))
    for wait in sorted(set(waits)):
        rows = [k for k, each in enumerate(waits) if each == wait]
        ensemble = _ensemble(loop, members[rows], wait / loop.settings.rate, duration)
        data = ensemble.dataset
        shown = [data[name].to_numpy() for name in ("settling_time", "peak_base_rotation", "growth_rate")]
        found[:, rows] = [shown[0], shown[1], -shown[2]]
        for row, word in zip(rows, ensemble.verdict.tolist(), strict=True):
            verdicts[row] = word
    return Runs(tuple(verdicts), *found, duration=duration)


def _ensemble(loop: UncertainLoop, members: Vector, delay: float, duration: float) -> Ensemble:
    s, machine = loop.settings, loop.box.machine
    varied = np.array([loop.box.numbers(u)[0] for u in members])
    gain, actuator = 1.0, _actuator(loop)
    if s.drive == "velocity":
        # A servo gain makes torques of the rates asked for, and brakes the joints.
        gain = float(s.servo_gain or 1.0)
        varied += s.motions(machine, gravity=loop.gravity).drive_damping * gain
    nominal = loop.box.nominal
    moved = np.flatnonzero(np.any(varied != nominal, axis=0)).tolist() or [0]
    sensor: dict[str, Any] = {"delay": delay} | ({} if s.filter_hz is None else {"filter_hz": s.filter_hz})
    return simulate_ensemble(
        machine, loop.posture, base=loop.base, vary={machine.parameters[k].name: varied[:, k] for k in moved},
        control=s.control, feedback=s.feedback, kp=gain * s.kp, kv=gain * s.kv, ki=gain * s.ki, rate=s.rate,
        sensor=sensor, actuator=actuator, nullspace_damping=s.nullspace_damping, gravity=loop.gravity,
        integrator="gauss", duration=duration,
    )  # fmt: skip


def _actuator(loop: UncertainLoop) -> dict[str, Any]:
    """What the drives make of the command, as `flexopt.Actuator` takes it."""
    s, machine = loop.settings, loop.box.machine
    found: dict[str, Any] = {} if s.bandwidth_hz is None else {"bandwidth_hz": s.bandwidth_hz.tolist()}
    limits = {"torque_limit": s.torque_limit, "rate_limit": s.rate_limit}
    found |= {name: limit.tolist() for name, limit in limits.items() if limit is not None}
    if s.drive == "velocity" and not machine.joints_without_speed:
        found |= {"levers": "each", "servo_gain": s.servo_gain}
    return found
