"""Many closed loops at once: start states, gains and machine parameters that vary from member to member.

In: the options of `simulate`, and arrays with one row for each member. Out: an `Ensemble`, one dataset. Members go
through the compiled loop side by side, in groups that keep nothing but window maxima unless their samples are wanted,
so memory does not grow with the number of steps.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, Unpack, cast

import numpy as np
from numpy.typing import NDArray

from flexopt.compiled import Batch, Recurrence
from flexopt.errors import Fault, FlexoptWarning, InputError, raise_if_any
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Document, MatrixLike, PostureLike, Progress, Vector
from flexopt.foundation.boundary import array_of, of_machine, path, public, words
from flexopt.foundation.documents import json_ready, provenance, write_netcdf
from flexopt.foundation.pictures import Pictured
from flexopt.foundation.plain import shown
from flexopt.foundation.results import Tabled
from flexopt.foundation.turns import available_cores
from flexopt.foundation.warned import warn_user
from flexopt.loop.settings import LoopSettings
from flexopt.model import AnyMachine
from flexopt.model.loop import DELAY_MAX, GAINS, Loop, LoopLike
from flexopt.model.parameter_ranges import parameter_range
from flexopt.model.simulation import SimulationKeywords, SimulationOptions, on_their_way
from flexopt.model.simulation_faults import own_loop
from flexopt.plant import build_plant
from flexopt.simulation.behaviour import Behaviour, behaviour
from flexopt.simulation.linear import SampledLoop, coordinates
from flexopt.simulation.members import (
    Keep,
    Members,
    Plan,
    member_loops,
    motion_constants,
    parameters_of_members,
)
from flexopt.simulation.real_loop import in_shorter_steps, with_loop
from flexopt.simulation.run import (
    OUTGREW,
    check_residual,
    grew,
    moves,
    note_run,
    runners,
    signals_at_end,
    table_of_limits,
    unfollowed,
)
from flexopt.simulation.scenario import SIMULATED, build_scenario, checked_options
from flexopt.simulation.verdict import Judgement, LoopVerdict, grounds_of, judge

if TYPE_CHECKING:
    import xarray as xr

WINDOWS = 250  # at most, for the measures of a member
GROUP = 512  # members that go through together on one core
BYTES_MAX = 4e9  # of samples kept

VERDICTS: tuple[LoopVerdict, ...] = ("converges", "grows", "undecided")
WORDS = {"converges": "converge", "grows": "grow", "undecided": "undecided"}


@dataclass(frozen=True, eq=False)
class Ensemble(Pictured, Tabled):
    """Measures of N members, one dataset.

    Its picture: the growth rate of each over what varies; with trajectories also bands of them over time.

    Attributes:
        dataset: xarray.Dataset over `member`: `grows`, `growth_rate`, `growth_rate_error`, `settling_time`,
            `start_error`, `peak_error`, `end_error`, `peak_base_rotation`, `residual_oscillation`, `finite_until` (see
            `simulation.behaviour.Behaviour`; a member that grows may outrun the implicit integrator there, which a
            warning tells), what was varied, and with `keep="trajectories"` also `q`, `v`,
            `end_point`, `error`, `torque`, `energy` over `time`. `grows` is what the runs alone show.
        linear_growth_rate: (N,) of the linear loop of each member, exact between the samples, 1/s; NaN where it rests
            nowhere. Computed when asked for, some 0.5 ms for each different loop.
        verdict: (N,) `"converges"`, `"grows"` or `"undecided"`, as of `Trajectory`: of run and eigenvalues together.

    Example:
        >>> machine, posture = flexopt.load("excavator"), (0.0448, -2.0499)
        >>> ensemble = flexopt.simulate_ensemble(machine, posture, vary={"kp": [1e4, 1e5]}, kv=2e3)
        >>> ensemble.verdict.tolist()
        ['converges', 'converges']
    """

    dataset: xr.Dataset
    provenance: Document = field(repr=False)
    plan: Plan = field(repr=False)
    measures: tuple[Behaviour, ...] = field(repr=False)
    ends: Vector | None = field(repr=False)

    @property
    def moved(self) -> bool:
        """Whether base or target were."""
        return moves(self.plan.scenario)

    @cached_property
    def linear_loops(self) -> list[SampledLoop | str]:
        """Of each member, exact between the samples; a sentence where it rests nowhere."""
        return member_loops(self.plan, self.ends if self.moved else None)

    @cached_property
    def last_postures(self) -> Vector | None:
        """In which each member ends, (N, n), rad or m, where arms have a self-motion, along which they may creep."""
        s, n = self.plan.scenario, self.plan.scenario.loop.shape.n_joints
        if self.ends is None:
            return None
        own = parameters_of_members(s.machine, self.plan.varied, self.plan.n)
        return np.array([coordinates(s, x, p)[-n:] for x, p in zip(self.ends.T, own.T, strict=True)])

    @cached_property
    def linear_growth_rate(self) -> Vector:
        """See the class."""
        return np.array([math.nan if isinstance(loop, str) else loop.growth_rate for loop in self.linear_loops])

    @cached_property
    def verdict(self) -> NDArray[np.str_]:
        """See the class."""
        return np.array([each.verdict for each in judged_beside(self, self.linear_loops)])

    @public(verdict=words(*VERDICTS))
    def share(self, verdict: LoopVerdict) -> float:
        """Share of the members with a verdict.

        Example:
            >>> ensemble.share("converges")
            1.0
        """
        return float(np.count_nonzero(self.verdict == verdict) / self.n_members)

    @property
    def n_members(self) -> int:
        """Number of members."""
        return int(self.dataset.sizes["member"])

    @property
    def growing(self) -> float:
        """Share of the members whose oscillation grows in the run."""
        return float(self.dataset["grows"].mean())

    def to_dict(self) -> Document:
        """JSON-ready summary: shares, and 5th, 50th and 95th percentiles.

        Keys: `members`; `growing`, by the runs alone; `verdicts` (verdict -> share); `percentiles`; `provenance`.

        Example:
            >>> ensemble.to_dict()["members"]
            2
        """
        quantiles = {
            name: self._quantiles(self.dataset[name].to_numpy())
            for name in ("growth_rate", "settling_time", "peak_error", "end_error", "peak_base_rotation")
        }
        quantiles["linear_growth_rate"] = self._quantiles(self.linear_growth_rate)
        document = {
            "members": self.n_members,
            "growing": self.growing,
            "verdicts": {word: self.share(word) for word in VERDICTS},
            "percentiles": {"levels": [5, 50, 95], **quantiles},
            "provenance": self.provenance,
        }
        return cast(dict[str, Any], json_ready(document))

    @staticmethod
    def _quantiles(values: Vector) -> list[float]:
        """Of the values that are finite."""
        finite = values[np.isfinite(values)]
        return np.percentile(finite, [5, 50, 95]).tolist() if finite.size else [math.nan] * 3

    @public(path=path())
    def to_netcdf(self, path: str | os.PathLike[str]) -> None:
        """Write the dataset and the provenance to a netCDF file.

        Raises:
            WriteError: the file cannot be written.

        Example:
            >>> ensemble.to_netcdf("ensemble.nc")
        """
        data = self.dataset.copy()
        data["grows"] = cast(Any, data["grows"]).astype("int8")
        data["linear_growth_rate"] = ("member", self.linear_growth_rate, {"units": "1/s"})
        codes = [VERDICTS.index(cast(LoopVerdict, str(word))) for word in self.verdict]
        meanings = {"flag_values": list(range(len(VERDICTS))), "flag_meanings": " ".join(VERDICTS)}
        data["verdict"] = ("member", np.array(codes, dtype="int8"), meanings)
        data.attrs["flexopt"] = json.dumps(self.to_dict())
        write_netcdf(path, data)

    def __repr__(self) -> str:
        d = self.dataset
        decay = self._quantiles(-d["growth_rate"].to_numpy())
        shares = ", ".join(f"{100 * self.share(word):.1f} % {WORDS[word]}" for word in VERDICTS)
        return (
            f"Ensemble({self.n_members} members: {shares}; decay "
            f"{decay[0]:+.3g} … {decay[1]:+.3g} … {decay[2]:+.3g}/s (5, 50, 95 %))"
        )


def judged_beside(ensemble: Ensemble, loops: Iterable[SampledLoop | str]) -> list[Judgement]:
    """Of each member its run beside the eigenvalues of a linear loop; a sentence where there is none."""
    shown = (share.shown(k) for share in ensemble.measures for k in range(len(share.grows)))
    members = Members(ensemble.plan, ensemble.ends, ensemble.moved)
    both = enumerate(zip(shown, loops, strict=True))
    return [judge(run, loop, rests=ensemble.moved, ran=members.of(k)) for k, (run, loop) in both]


def _vary(arguments: Arguments, machine: AnyMachine, field: str, value: Any) -> dict[str, Vector]:
    """The arrays, all with the same number of rows."""
    plant = build_plant(machine)
    parameters = {parameter.name: parameter.unit for parameter in machine.parameters}
    widths: dict[str, tuple[int, ...]] = {
        "offset": (plant.n_actuated,), "deflection": (plant.n_passive,), "rates": (plant.n_coordinates,),
        "kp": (0, plant.n_task), "kv": (0, plant.n_task), "ki": (0, plant.n_task), "delay": (0,),
    }  # fmt: skip
    widths |= dict.fromkeys(parameters, (0,))
    arrays: dict[str, Vector] = {}
    if not isinstance(value, Mapping) or not value:
        arguments.note(field, "must be a dictionary of arrays, one row for each member", value)
        return arrays
    for name, given in cast(Mapping[Any, Any], value).items():
        where = f"{field}[{shown(name)}]"
        if name not in widths:
            words = ", ".join([*list(widths)[:7], "or a parameter of the machine: " + ", ".join(parameters)])
            arguments.faults.append(Fault(where, f"is not something that varies; known are {words}"))
            continue
        shapes = [("members",) if width == 0 else ("members", width) for width in widths[name]]
        array = array_of(*shapes)(arguments, where, given)
        if array is not None and not len(array):
            arguments.note(where, "must have the shape (members, …), with at least one member", given)
        elif array is not None:
            arguments.faults += _range_faults(machine, name, array)
            arrays[name] = array
    lengths = {name: len(array) for name, array in arrays.items()}
    if len(set(lengths.values())) > 1:
        arguments.faults.append(Fault(field, f"needs one number of members, not {lengths}"))
    return arrays


@public(together=note_run, vary=of_machine(_vary), keep=words("measures", "trajectories"), keywords=SIMULATED)
def simulate_ensemble(
    machine: AnyMachine,
    posture: PostureLike | None = None,
    *,
    vary: Mapping[str, MatrixLike],
    keep: Keep = "measures",
    threads: int | None = None,
    progress: Progress | None = None,
    loop: LoopLike | None = None,
    options: SimulationOptions | None = None,  # noqa: ARG001 - its fields come as keywords
    **keywords: Unpack[SimulationKeywords],
) -> Ensemble:
    """Many runs of `simulate` at once.

    Args:
        machine, posture, options, keywords: as for `flexopt.simulate`; they hold for every member where `vary` says
            nothing.
        vary: arrays with one row for each of N members, by name: `"offset"` (N, n), rad or m; `"deflection"` (N, m),
            passive coordinates at the start less their equilibrium, m or rad; `"rates"` (N, n_q), rates at the start;
            `"kp"`, `"kv"`, `"ki"` (N,) or (N, n_task); `"delay"` (N,), `sensor.delay` of each, s, all within one sample
            (l, l + 1] / rate; any of the machine's parameters, `"payload.mass"` for example
            (N,). Where parameters vary, the controller keeps the numbers of `machine`: it does not know.
        keep: `"measures"` (default), or `"trajectories"` for every sample of every member, too.
        threads: among how many the members are divided; all cores by default. The results do not depend on it.
        progress: called with the number of members done and N.
        loop: the real controller, as of `flexopt.simulate`; gains in `vary` stand in place of its own, in their units.
            By default the machine's `[loop]`, unless an option or gains in `vary` say of the loop.

    Raises:
        InputError: arguments are not usable (all faults in one message); the samples to keep exceed 4 GB.
        others: as `flexopt.simulate`.

    With noise every member draws its own, from `seed` and its number.

    Example:
        >>> machine, posture = flexopt.load("excavator"), (0.0448, -2.0499)
        >>> loads = {"payload.mass": [0.0, 200.0, 400.0]}
        >>> ensemble = flexopt.simulate_ensemble(machine, posture, vary=loads, kp=1e4, kv=1e3)
        >>> ensemble.dataset["growth_rate"].sizes["member"]
        3
    """
    given: dict[str, Any] = {"posture": posture} | keywords
    asked = dict(cast(Mapping[str, Vector], vary))
    varied, real = asked, cast("Loop | None", loop) or own_loop(machine, given | asked)
    settings: LoopSettings | None = None
    own = machine
    if real is not None:
        machine, given, settings = with_loop(machine, real, given, "simulate_ensemble")
        # What drives brake is brake in every member, on top of its own damping.
        pairs = zip(own.parameters, machine.parameters, strict=True)
        brakes = {before.name: after.value - before.value for before, after in pairs}
        # Gains are those of the loop, which may ask for rates.
        gains = {name: (settings.braking or 1.0) * asked[name] for name in GAINS if name in asked}
        varied = {name: values + brakes.get(name, 0.0) for name, values in asked.items()} | gains

    def run(given: dict[str, Any]) -> Ensemble:
        asked_for = checked = checked_options("simulate_ensemble", machine, given)
        delays = varied.get("delay")
        if delays is not None:
            _check_delays(delays, checked.rate)
            sensor = checked.sensor.model_dump(exclude_unset=True) | {"delay": float(delays.max())}
            checked = checked_options("simulate_ensemble", machine, given | {"sensor": sensor})
        if checked.feedback != "pid" and np.any(varied.get("ki", 0.0)):
            raise_if_any(InputError, "simulate_ensemble", [Fault("vary['ki']", 'goes with feedback = "pid"')])
        n = len(next(iter(varied.values())))
        names = [parameter.name for parameter in machine.parameters]
        zeros, motion = motion_constants(machine, {k: v for k, v in varied.items() if k in names}, n)
        s = build_scenario(machine, checked, zeros, watched=True, settings=settings, delays=delays)
        plan, redundant = Plan(s, zeros, varied, motion, n, keep), s.loop.shape.n_joints > s.loop.shape.n_task
        _check_room(plan)
        shares = _run(plan, threads or available_cores(), progress)
        _warn_of_outgrown(shares)
        ends = np.concatenate([share.last for share in shares], axis=1) if moves(s) or redundant else None
        _warn_of_too_weak(Members(plan, ends, moves(s), table_of_limits(settings)))
        shapes = {name: list(np.shape(value)) for name, value in asked.items()}
        return Ensemble(
            _dataset(plan, asked, shares),
            provenance(own, vary=shapes, keep=keep, **asked_for.model_dump(exclude_unset=True)),
            plan,
            tuple(share.measures for share in shares),
            ends,
        )

    return in_shorter_steps(run, given, real)


def _check_delays(delays: Vector, rate: float) -> None:
    """Refuse dead times that one loop does not have: with other measurements on their way, or too many."""
    faults, waits = list[Fault](), {on_their_way(delay, rate) for delay in delays.tolist()}
    if len(waits) > 1:
        sentence = f"must be as many samples of {1 / rate:g} s rounded up; make an ensemble for each number"
        faults.append(Fault("vary['delay']", sentence, f"{min(waits)} to {max(waits)} samples"))
    elif max(waits) > DELAY_MAX:
        sentence = f"must be at most {DELAY_MAX} samples of {1 / rate:g} s"
        faults.append(Fault("vary['delay']", sentence, f"{delays.max():g}"))
    raise_if_any(InputError, "simulate_ensemble", faults)


def _check_room(plan: Plan) -> None:
    """Refuse samples that would not fit into memory, before anything runs."""
    if plan.keep != "trajectories":
        return
    outputs = plan.scenario.loop.outputs
    numbers = sum(outputs.size1_out(k) for k in range(outputs.n_out())) * (plan.scenario.samples + 1) * plan.n
    if 8 * numbers > BYTES_MAX:
        raise InputError(
            f"simulate_ensemble: keep = trajectories would take {8e-9 * numbers:.3g} GB for {plan.n} members of "
            f"{plan.scenario.samples} samples (allowed: {1e-9 * BYTES_MAX:g} GB); keep = measures needs none of it"
        )


@dataclass(frozen=True)
class _Share:
    """One group's results; `outgrown`: whether a member outgrew what the implicit integrator follows."""

    measures: Behaviour
    samples: dict[str, Vector]
    last: Vector
    outgrown: NDArray[np.bool_]


def _warn_of_outgrown(shares: list[_Share]) -> None:
    """Tell how many members outgrew the integrator, and the first of them to do so."""
    outgrown = np.flatnonzero(np.concatenate([share.outgrown for share in shares]))
    if not outgrown.size:
        return
    until = np.concatenate([share.measures.finite_until for share in shares])
    first = int(outgrown[np.argmin(until[outgrown])])
    who = f"member {first}" if outgrown.size == 1 else f"{outgrown.size} members"
    at = f"at {until[first]:.4g} s" + ("" if outgrown.size == 1 else f" and later, member {first} first")
    warn_user(f"{who} {OUTGREW} {at}; what follows is not a number", FlexoptWarning)


def _warn_of_too_weak(members: Members) -> None:
    """Tell how many members are too heavy for their drives, and why the first of them is."""
    n = members.plan.n
    told = {k: why for k in range(n) if (why := members.of(k).too_weak)}
    if told:
        first = next(iter(told))
        who = f"member {first}" if len(told) == 1 else f"{len(told)} of {n} members, member {first} first"
        warn_user(f"{who}: {told[first]}", FlexoptWarning)


def _run(plan: Plan, threads: int, progress: Progress | None) -> list[_Share]:
    runner, shown, _ = runners(plan.scenario.loop.structure, steps=plan.n * plan.scenario.samples)
    size = GROUP * threads
    shares: list[_Share] = []
    for begin in range(0, plan.n, size):
        rows = slice(begin, min(plan.n, begin + size))
        shares.append(_group(plan, rows, runner, shown, threads))
        if progress is not None:
            progress(rows.stop, plan.n)
    return shares


def _group(plan: Plan, rows: slice, runner: Recurrence, shown: Batch, threads: int) -> _Share:
    s = plan.scenario
    stride = 1 if plan.keep == "trajectories" else math.ceil(s.samples / WINDOWS)
    c, start, e = s.loop.constants.packed(plan.parts(rows)), plan.start(rows), plan.signals(rows)
    keep: Literal["records", "monitors"] = "records" if plan.keep == "trajectories" else "monitors"
    records = runner(start, c, steps=s.samples, e=e, stride=stride, threads=threads, keep=keep)
    structure = s.loop.structure
    until = _followed(plan, rows, runner, records.monitor)
    end = np.zeros((0, 1)) if e is None else signals_at_end(s, e if e.ndim == 3 else e[:, :, None])[0]
    names = shown.function.name_out()
    at_end = shown(records.last, end, c, threads=threads)[names.index("monitor")]
    edges = np.concatenate([[0.0], records.k * s.period])
    watched = records.monitor[:, :-1] if structure.method == "gauss" else records.monitor
    outgrown, last = until <= s.samples, records.last
    if outgrown.any():
        unknown = outgrown & (np.arange(len(watched))[:, None] >= until // stride)
        watched = np.where(unknown[:, None], np.nan, watched)
        at_end, last = np.where(outgrown, np.nan, at_end), np.where(outgrown, np.nan, last)
    end_error, end_rotation = np.sqrt(at_end[:2])
    measures = behaviour(edges, watched, end_error, grounds_of(s), end_rotation)
    measures = replace(measures, finite_until=np.where(outgrown, until * s.period, measures.finite_until))
    samples: dict[str, Vector] = {}
    if plan.keep == "trajectories":
        x = np.concatenate([start[None], records.x])
        unknown = np.arange(len(x))[:, None] >= until
        samples = _samples(shown, np.where(unknown[:, None], np.nan, x), e, end, c, threads)
    return _Share(measures, samples, last, outgrown)


def _followed(plan: Plan, rows: slice, runner: Recurrence, monitor: Vector) -> NDArray[np.intp]:
    """The first sample (members,) to which the implicit integrator does not follow a member; beyond the end for others.

    Members that outgrow it run once more, every sample watched: whether and where, as in a run of its own.

    Raises:
        NoSolutionFound: some member that it does not follow does not grow, or base or target move.
    """
    s, structure = plan.scenario, plan.scenario.loop.structure
    until = np.full(monitor.shape[2], s.samples + 1)
    beyond = np.flatnonzero(unfollowed(structure, monitor) < len(monitor))
    if moves(s) and beyond.size:
        check_residual(structure, monitor)
    linear = member_loops(plan, None, [rows.start + int(k) for k in beyond]) if beyond.size else []
    for k, loop in zip(beyond.tolist(), linear, strict=True):
        one = slice(rows.start + k, rows.start + k + 1)
        run = runner(
            plan.start(one), s.loop.constants.packed(plan.parts(one)), steps=s.samples, e=plan.signals(one), stride=1,
            keep="monitors",
        )  # fmt: skip
        at = int(unfollowed(structure, run.monitor)[0])
        if not grew(loop, run.monitor[: at + 1, 0, 0]):
            check_residual(structure, run.monitor)
        until[k] = at + 1
    return until


def _samples(shown: Batch, x: Vector, e: Vector | None, end: Vector, c: Vector, threads: int) -> dict[str, Vector]:
    """Outputs of every state: name -> (members, samples, rows)."""
    k, _, n = x.shape
    flat = np.ascontiguousarray(x.transpose(1, 0, 2)).reshape(x.shape[1], k * n)
    constants_of = c if c.shape[1] == 1 else np.tile(c, (1, k))
    signals = np.zeros((0, 1))
    if e is not None:
        whole = np.concatenate([np.broadcast_to(e.reshape(k - 1, e.shape[1], -1), (k - 1, e.shape[1], n)),
                                np.broadcast_to(end[None], (1, e.shape[1], n))])  # fmt: skip
        signals = np.ascontiguousarray(whole.transpose(1, 0, 2)).reshape(e.shape[1], k * n)
    values = shown(flat, signals, constants_of, threads=threads)
    return {
        name: value.reshape(-1, k, n).transpose(2, 1, 0)
        for name, value in zip(shown.function.name_out(), values, strict=True)
    }


def _dataset(plan: Plan, varied: Mapping[str, Vector], shares: list[_Share]) -> xr.Dataset:
    import xarray as xr  # noqa: PLC0415  (slow to import)

    s, plant = plan.scenario, build_plant(plan.scenario.machine)
    units = {
        "growth_rate": "1/s", "growth_rate_error": "1/s", "settling_time": "s",
        "start_error": "m", "peak_error": "m", "end_error": "m", "peak_base_rotation": "rad", "finite_until": "s",
    }  # fmt: skip
    variables: dict[str, Any] = {}
    for name in ("grows", *units):
        values = np.concatenate([getattr(share.measures, name) for share in shares])
        variables[name] = ("member", values, {"units": units.get(name, "")})
    left = np.concatenate([share.measures.residual_oscillation for share in shares], axis=1).T
    variables["residual_oscillation"] = (("member", "mode"), left, {"units": "J"})
    axis = {"offset": "joint", "deflection": "passive", "rates": "coordinate", "kp": "axis", "kv": "axis", "ki": "axis"}
    unit = {parameter.name: parameter.unit for parameter in s.machine.parameters} | {"delay": "s"}
    for name, values in varied.items():
        dims = ("member", axis.get(name, "axis"))[: values.ndim]
        variables[name if name not in variables else f"varied.{name}"] = (dims, values, {"units": unit.get(name, "")})
    coordinates: dict[str, Any] = {"axis": list(s.machine.task_rows), "joint": list(s.machine.joints)}
    coordinates["mode"] = np.arange(1, left.shape[1] + 1)
    coordinates |= {"coordinate": list(plant.coordinates), "passive": list(plant.coordinates[: plant.n_passive])}
    if plan.keep == "trajectories":
        axes = {
            "q": "coordinate",
            "v": "coordinate",
            "end_point": "axis",
            "error": "axis",
            "torque": "joint",
            "energy": None,
        }
        for name, label in axes.items():
            values = np.concatenate([share.samples[name] for share in shares])
            dims = ("member", "time", label) if label else ("member", "time")
            variables[name] = (dims, values if label else values[:, :, 0])
        coordinates["time"] = ("time", s.times, {"units": "s"})
    used = {dim for entry in variables.values() for dim in ([entry[0]] if isinstance(entry[0], str) else entry[0])}
    return xr.Dataset(variables, {name: value for name, value in coordinates.items() if name in used})


def _range_faults(machine: AnyMachine, name: str, array: Vector) -> list[Fault]:
    """Values that a machine file would not be allowed to have, or negative gains."""
    if name in ("kp", "kv", "ki", "delay") and np.any(array < 0):
        return [Fault(f"vary[{name!r}]", "must not be negative", f"{array.min():g}")]
    parameter = next((parameter for parameter in machine.parameters if parameter.name == name), None)
    if parameter is None:
        return []
    low, high = parameter_range(parameter)
    if low > 0 and np.any(array <= 0):
        return [Fault(f"vary[{name!r}]", f"must be greater than 0 {parameter.unit}", f"{array.min():g}")]
    if low == 0 and np.any(array < 0):
        return [Fault(f"vary[{name!r}]", f"must not be negative ({parameter.unit})", f"{array.min():g}")]
    if np.any(np.abs(array) > high):
        sentence = f"must be at most {high:g} {parameter.unit} in size"
        return [Fault(f"vary[{name!r}]", sentence, f"{np.abs(array).max():g}")]
    return []
