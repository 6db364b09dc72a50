"""Nonlinear runs of one loop on the members of what is uncertain.

In: a loop in a configuration, members. Out: an ensemble's verdicts, settling times and turns of the base.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexopt.errors import NoSolutionFound
from flexopt.foundation.arrays import Vector
from flexopt.foundation.results import Result
from flexopt.loop.uncertain import UncertainLoop
from flexopt.simulation import simulate_ensemble
from flexopt.simulation.ensemble import Ensemble

# Integration steps in a sample where those that the fastest mode needs are too long.
SHORTER = (8, 64)
SHOWN = ("settling_time", "peak_base_rotation", "growth_rate", "end_error", "peak_error")


@dataclass(frozen=True)
class Runs(Result):
    """What n nonlinear runs show.

    Attributes:
        verdicts: `"converges"`, `"grows"` or `"undecided"` of each, (n,); see `flexopt.Ensemble`.
        settling: of each, s; NaN where it does not.
        turn: largest turn of the base in each, rad.
        decay: as the run shows it, 1/s.
        nearer: whether the end-point ends at most half as far from its target as it ever was.
        duration: of a run, s.

    A run that the integrator could not finish grows where the linear loop does, and is undecided elsewhere.
    """

    verdicts: tuple[str, ...]
    settling: Vector
    turn: Vector
    decay: Vector
    nearer: tuple[bool, ...]
    duration: float

    DOCUMENT = "members converging confirming verdicts settling[s] turn[rad] decay[1/s] nearer duration[s]"

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

    @property
    def confirming(self) -> float:
        """Share of those that converge and bring the end-point nearer."""
        words = zip(self.verdicts, self.nearer, strict=True)
        return sum(word == "converges" and nearer for word, nearer in words) / len(self.verdicts)

    def _share(self, word: str) -> float:
        return self.verdicts.count(word) / len(self.verdicts)


def nonlinear_runs(loop: UncertainLoop, members: Vector, decays: Vector, duration: float) -> Runs:
    """Runs of the nonlinear closed loop from the start of `flexopt.simulate`, one for each member (n, k).

    Measurements wait whole samples in a run: a dead time between them is taken as the longer one. `decays` (n,) are
    those of the linear loops.
    """
    waits = [math.ceil(loop.box.numbers(u)[1] * loop.settings.rate - 1e-6) for u in members]
    verdicts = ["grows" if decay < 0 else "undecided" for decay in decays.tolist()]
    found, nearer = np.full((3, len(members)), np.nan), [False] * len(members)
    for wait in sorted(set(waits)):
        rows = [k for k, each in enumerate(waits) if each == wait]
        for some, ensemble in _ensembles(loop, members, rows, wait / loop.settings.rate, duration):
            data = {name: ensemble.dataset[name].to_numpy() for name in SHOWN}
            found[:, some] = [data["settling_time"], data["peak_base_rotation"], -data["growth_rate"]]
            ends = zip(some, ensemble.verdict.tolist(), data["end_error"], data["peak_error"], strict=True)
            for row, word, end, peak in ends:
                verdicts[row], nearer[row] = word, bool(end <= peak / 2)
    return Runs(tuple(verdicts), *found, nearer=tuple(nearer), duration=duration)


def _ensembles(
    loop: UncertainLoop, members: Vector, rows: list[int], delay: float, duration: float
) -> Iterator[tuple[list[int], Ensemble]]:
    """Ensembles of these members, together where that can be, else one by one with shorter steps; not of all."""
    try:
        yield rows, _ensemble(loop, members[rows], delay, duration, None)
    except NoSolutionFound:
        for row in rows:
            for substeps in SHORTER:
                try:
                    alone = _ensemble(loop, members[[row]], delay, duration, substeps)
                except NoSolutionFound:
                    continue
                yield [row], alone
                break


def _ensemble(loop: UncertainLoop, members: Vector, delay: float, duration: float, substeps: int | None) -> Ensemble:
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
        integrator="gauss", substeps=substeps, duration=duration,
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
