"""The members of an ensemble: what varies from one to the next, where each starts, the linear loop of each.

In: a scenario, and checked arrays with one row for each member. Out: constants, start states and signals of groups of
members, and their `SampledLoop`s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, cast

import numpy as np

from flexopt.compiled.threaded import Interpreter
from flexopt.errors import FlexoptError
from flexopt.foundation.arrays import Vector
from flexopt.loop.loop_motions import NOWHERE_HELD
from flexopt.model import AnyMachine
from flexopt.model.simulation import taken_early
from flexopt.plant.machine_motion import constant_names, constants
from flexopt.simulation.linear import SampledLoop, bare_scenario, where_held
from flexopt.simulation.run import signals_at_end
from flexopt.simulation.scenario import Scenario, start_states
from flexopt.simulation.verdict import Arrived, about, arrived_at, growth_about, may_be_too_weak, too_weak

Keep = Literal["measures", "trajectories"]


@dataclass(frozen=True)
class Plan:
    """What every group of members needs."""

    scenario: Scenario
    zeros: frozenset[str] | None
    varied: dict[str, Vector]
    motion: dict[str, Vector]
    n: int
    keep: Keep

    def parts(self, rows: slice) -> dict[str, Any]:
        """Constants by name, (size, members) where they vary."""
        return dict(self.scenario.parts) | self.varying(rows)

    def varying(self, rows: slice) -> dict[str, Vector]:
        """Those that vary, (size, members)."""
        parts: dict[str, Vector] = {name: values[rows][None, :] for name, values in self.motion.items()}
        n_task = self.scenario.loop.structure.n_task
        for name in ("kp", "kv", "ki"):
            if name in self.varied:
                parts[name] = np.broadcast_to(self.varied[name].reshape(self.n, -1).T[:, rows], (n_task, count(rows)))
        if "delay" in self.varied:
            waits, period = self.scenario.loop.structure.delay, self.scenario.period
            parts["early"] = taken_early(self.varied["delay"][rows], waits, period)[None, :]
        return parts

    def start(self, rows: slice) -> Vector:
        """States x (n_x, members)."""
        s, width = self.scenario, count(rows)
        m = len(s.q_design) - len(s.posture)
        q = np.repeat(s.q_design[:, None], width, axis=1)
        q[m:] += self.varied["offset"][rows].T if "offset" in self.varied else s.offset[:, None]
        if "deflection" in self.varied:
            q[:m] += self.varied["deflection"][rows].T
        # What has been measured before the start is of the member itself.
        own = parameters_of_members(s.machine, {name: values[rows] for name, values in self.varied.items()}, width)
        x = start_states(s.machine, s.loop, s.parts, q, own)
        if "rates" in self.varied:
            x[s.loop.states.slices["w"]] = np.linalg.solve(s.loop.to_q, self.varied["rates"][rows].T)
        return x

    def signals(self, rows: slice) -> Vector | None:
        """Signals e (steps, n_e) or (steps, n_e, members): noise of its own for every member."""
        s = self.scenario
        if "noise" not in s.loop.signals.sizes:
            return s.signals()
        each = [s.signals(np.random.default_rng([s.options.seed, k])) for k in range(rows.start, rows.stop)]
        return np.stack(cast(list[Vector], each), axis=2)


def count(rows: slice) -> int:
    """How many."""
    return rows.stop - rows.start


def member_loops(plan: Plan, ends: Vector | None, among: Sequence[int] | None = None) -> list[SampledLoop | str]:
    """The linear loop of every member, or of those `among` them; members that differ in their start alone share one."""
    asked = range(plan.n) if among is None else among
    s, loops = plan.scenario, dict[bytes, SampledLoop | str]()
    try:
        bare = bare_scenario(s.machine, s.options, plan.zeros, paths=ends is not None)
    except FlexoptError as error:
        return [str(error)] * len(asked)
    e = np.zeros(bare.loop.signals.total)
    if ends is not None:
        signals = s.signals()
        assert signals is not None
        e = signals_at_end(s, signals)[0, : len(e)]
    varying, found = plan.varying(slice(0, plan.n)), list[SampledLoop | str]()
    p = parameters_of_members(s.machine, plan.varied, plan.n)
    for k in asked:
        own = {name: np.ascontiguousarray(values[:, k]) for name, values in varying.items()}
        key = b"".join([*(value.tobytes() for value in own.values()), b"" if ends is None else ends[:, k].tobytes()])
        if key not in loops:
            here = replace(bare, parts={**bare.parts, **own}, p=p[:, k])
            x = where_held(here) if ends is None else ends[:, k]
            loops[key] = NOWHERE_HELD if x is None else about(here, x, e)
        found.append(loops[key])
    return found


@dataclass(frozen=True)
class Members:
    """The loop of each member that was run, of which reasons ask.

    Attributes:
        plan: of the ensemble.
        last: states of all members at the end (n_x, N), where their arms have a self-motion or `moved`; else None.
        moved: whether base or target were.
        table: of a file, in which the limits of its drives are.
    """

    plan: Plan
    last: Vector | None
    moved: bool
    table: str = "actuator"

    def of(self, k: int) -> Member:
        """Of one member."""
        return Member(self, k)

    @cached_property
    def exact(self) -> Scenario | None:
        """The scenario of all members, to be advanced exactly; None where there is none."""
        return self._bare(exact=True)

    @cached_property
    def stepped(self) -> Scenario | None:
        """The like, to be advanced as the integrator does."""
        return self._bare(exact=False)

    def _bare(self, *, exact: bool) -> Scenario | None:
        s, delays = self.plan.scenario, self.plan.varied.get("delay")
        try:
            return bare_scenario(s.machine, s.options, self.plan.zeros, exact=exact, paths=self.moved, delays=delays)
        except FlexoptError:
            return None

    @cached_property
    def parameters(self) -> Vector:
        """Of all members (n_par, N)."""
        return parameters_of_members(self.plan.scenario.machine, self.plan.varied, self.plan.n)


@dataclass(frozen=True)
class Member:
    """One member's loop; see `verdict.Ran`."""

    among: Members = field(repr=False)
    k: int

    @property
    def integrator(self) -> str:
        """Of the run."""
        return self.among.plan.scenario.options.integrator

    @property
    def too_weak(self) -> str:
        """See `verdict.Ran`."""
        options = self.among.plan.scenario.options
        if not may_be_too_weak(options) or (here := self._own(self.among.exact)) is None:
            return ""
        x = self._last if self.among.moved else where_held(here)
        # What feedback holds nowhere is weighed by its design.
        x = here.resting if x is None else x
        return too_weak(here, x, self._signals(here), options.actuator, self.among.table)

    def integrated(self) -> float | None:
        """See `verdict.Ran`."""
        here = self._own(self.among.stepped)
        if here is None:
            return None
        x = self._last if self.among.moved else where_held(here)
        return None if x is None else growth_about(here, x, self._signals(here))

    def arrived(self) -> Arrived | None:
        """See `verdict.Ran`."""
        here, x = self._own(self.among.exact), self._last
        return None if self.among.moved or here is None or x is None else arrived_at(here, x, self._signals(here))

    @property
    def _last(self) -> Vector | None:
        return None if self.among.last is None else self.among.last[:, self.k]

    def _own(self, bare: Scenario | None) -> Scenario | None:
        if bare is None:
            return None
        rows = slice(self.k, self.k + 1)
        own = {name: np.ascontiguousarray(values[:, 0]) for name, values in self.among.plan.varying(rows).items()}
        return replace(bare, parts={**bare.parts, **own}, p=self.among.parameters[:, self.k])

    def _signals(self, here: Scenario) -> Vector:
        total, s = here.loop.signals.total, self.among.plan.scenario
        signals = s.signals() if self.among.moved else None
        return np.zeros(total) if signals is None else signals_at_end(s, signals)[0, :total]


def parameters_of_members(machine: AnyMachine, varied: Mapping[str, Vector], n: int) -> Vector:
    """Parameters (n_par, n), those that vary in the place of the machine's own."""
    own = [varied.get(name, np.full(n, value)) for name, value, _ in machine.parameters]
    return np.array(own)


def motion_constants(
    machine: AnyMachine, varied: Mapping[str, Vector], n: int
) -> tuple[frozenset[str] | None, dict[str, Vector]]:
    """Constants of the motion that vary, (N,) each, and those that are zero for all; None where none varies."""
    if not varied:
        return None, {}
    function = constants(machine)
    p = parameters_of_members(machine, varied, n)
    # By the virtual machine, as those of one simulation are: the same bits, and sooner than they could be compiled.
    columns = dict(zip(constant_names(machine), Interpreter(function)(p)[0], strict=True))
    zeros = frozenset(name for name, value in columns.items() if not np.any(value))
    return zeros, {name: value for name, value in columns.items() if name not in zeros}
