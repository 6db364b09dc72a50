"""The result of one run: samples, measures, pictures, files."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Document, Vector
from flexopt.foundation.boundary import array_of, path, public
from flexopt.foundation.documents import write_netcdf
from flexopt.foundation.doubt import with_doubt
from flexopt.foundation.palette import Theme
from flexopt.foundation.pictures import Pictured, drawn
from flexopt.foundation.results import Result
from flexopt.foundation.writing import write_file
from flexopt.loop.settings import LoopSettings
from flexopt.loop.spectrum import slow_self_motion
from flexopt.model import AnyMachine
from flexopt.plant import build_plant
from flexopt.simulation.behaviour import Shown
from flexopt.simulation.linear import SampledLoop
from flexopt.simulation.verdict import Ended, Judgement, alternating, beating, judge

if TYPE_CHECKING:
    import xarray as xr

# A share by which the integrator changes the linear loop's decay from which on that is told.
NOTICED = 0.1


def _as_many(arguments: Arguments, given: Mapping[str, Any]) -> None:
    q, base = given["q"], given["base"]
    if q is not None and base is not None and len(q) != len(base):
        arguments.note("base", f"needs a row for each of the {len(q)} configurations", base)


@dataclass(frozen=True, eq=False)
class Trajectory(Pictured, Result):
    """A closed-loop run. K samples from the start to the end; SI and rad.

    Its picture: end-point error, base oscillation and torques over time.

    Attributes:
        machine, control, coordinates, joints: names.
        n_passive: how many of the coordinates are passive; they come first.
        time: (K,), s.
        q, v: coordinates and rates (K, n_q), passive first.
        end_point, error: r and r_d − r (K, n_task), m, inertial frame.
        torque: by which the drives act on the joints from each sample on (K, n), N m, or N on slides; of drives that
            serve rates with the servo's braking, servo_gain · rate, taken off.
        energy: kinetic, of the springs and, where it acts, of the weight (K,), J.
        deflection: passive coordinates less their values at equilibrium (K, m).
        base: placement, the anchor of the springs (K, n_b), m or rad.
        target: of the end-point, (K, n_task), m.
        run: what the run alone shows of growth: its tendency, `run.word`, and how sure that is.
        ended: the loop that was run, and where it came to.
        linear: the linear loop about the posture that was asked for, of a base or target that moved about the rest at
            the run's end, exact between the samples, whatever integrated the run (computed when asked for); None where
            the loop has no such rest. A redundant arm may come to rest beside that posture: then the run shows another
            decay.
        verdict: of the base's oscillation, `"converges"` or `"grows"` where the run and the eigenvalues of `linear` say
            the same, `"undecided"` where they do not, or the run is shorter than four periods of the slowest mode, or
            the eigenvalues are 1 to rounding, or nothing holds the arm, for a `torque_limit` is below the weight at
            rest; where there is no `linear`, the run's own, if significant.
        verdict_reason: both, in a sentence.
        growth_rate, growth_rate_error: of the base's amplitude in the run and its standard error, 1/s: of the
            largest mode that grows, or else of the one that decays slowest; None where it never moved. See
            `simulation.behaviour.Behaviour`. What motions of `linear` that beat more slowly than the second half of
            the run lasts may make of the slope is in it; `fit_error` is without.
        linear_growth_rate: of `linear`, 1/s.
        integrated_growth_rate: of the same loop as the run's integrator makes it, 1/s (computed when asked for); None
            where it has no such loop.
        self_motion_rate: of a redundant arm, the largest rate of a joint at the end that leaves the end-point where it
            is, rad/s or m/s; None where there is no such motion. It is no part of the verdict.
        settling_time: after which |e| stays below 2 % of its start, s; None where it does not.
        overshoot: how far the end-point went beyond its target, as a share of the error at the start; None where base
            or target move.
        end_error: |e| at the end, m; None where the run left the finite numbers.
        peak_base_rotation: largest deflection from equilibrium of a hinge by which the base turns, rad; of an elastic
            root of the arm, which turns about an axis of the base, it is none. None where the base has no hinge.
        residual_oscillation: largest energy of each flexible mode in the last period of the slowest, (m,), J. The modes
            are those where the run begins, without a controller: what a base or target that moves leads to has others.
        frequencies_hz: of these modes, (m,).
        model: the machine.
        skeleton: points as in `Plant.skeleton` at each sample (K, points, 2 or 3), m.
        warnings: sentences.
        loop: the numbers of a `loop` that was given, and where they come from; else None.

    Example:
        >>> machine = flexopt.load("excavator")
        >>> run = flexopt.simulate(machine, (0.9929, -2.6306), kp=1e5, kv=2e3)
        >>> run.q.shape, run.coordinates
        ((2001, 5), ('base.x', 'base.y', 'base.rotation', 'boom', 'stick'))
        >>> run.linear_growth_rate > 0
        True
    """

    DOCUMENT = """
    machine control verdict growth_rate[1/s] growth_rate_error[1/s] run_verdict=run.word linear_growth_rate[1/s]
    verdict_reason self_motion_rate[1/s] settling_time[s] overshoot end_error[m] peak_base_rotation[rad]
    residual_oscillation frequencies_hz[Hz] duration[s] samples warnings loop provenance
    """

    machine: str
    control: str
    coordinates: tuple[str, ...]
    joints: tuple[str, ...]
    n_passive: int
    time: Vector
    q: Vector
    v: Vector
    end_point: Vector
    error: Vector
    torque: Vector
    energy: Vector
    deflection: Vector
    base: Vector
    target: Vector
    run: Shown
    ended: Ended = field(repr=False)
    growth_rate: float | None
    fit_error: float | None
    settling_time: float | None
    overshoot: float | None
    end_error: float | None
    peak_base_rotation: float | None
    residual_oscillation: Vector
    frequencies_hz: Vector
    self_motion_rate: float | None
    warnings: tuple[str, ...]
    provenance: Document = field(repr=False)
    model: AnyMachine = field(repr=False)
    loop: LoopSettings | None = None

    @cached_property
    def _linear(self) -> SampledLoop | str:
        return self.ended.linear()

    @property
    def linear(self) -> SampledLoop | None:
        """See the class."""
        return None if isinstance(self._linear, str) else self._linear

    @property
    def linear_growth_rate(self) -> float | None:
        """See the class."""
        return None if self.linear is None else self.linear.growth_rate

    @property
    def growth_rate_error(self) -> float | None:
        """See the class."""
        return None if self.fit_error is None else math.hypot(self.fit_error, beating(self._linear, self.run.duration))

    @cached_property
    def integrated_growth_rate(self) -> float | None:
        """See the class."""
        return self.ended.integrated()

    @cached_property
    def _judgement(self) -> Judgement:
        return judge(self.run, self._linear, self.ended)

    @property
    def finite_until(self) -> float:
        """Time up to which every number of the run is finite, s."""
        return self.run.ended

    @property
    def verdict(self) -> str:  # a Literal, by which a completer of notebooks breaks
        """See the class."""
        return self._judgement.verdict

    @property
    def duration(self) -> float:
        """Of the run, s."""
        return float(self.time[-1])

    @property
    def samples(self) -> int:
        """How many there are."""
        return len(self.time)

    @property
    def verdict_reason(self) -> str:
        """See the class."""
        return self._judgement.reason

    @property
    def torque_units(self) -> tuple[str, ...]:
        """Unit of each joint's torque, N m or N."""
        return tuple("N m" if unit == "rad" else "N" for unit in self.model.joint_units)

    @cached_property
    def skeleton(self) -> Vector:
        """See the class."""
        return self.skeletons(self.q, self.base)

    @public(
        sizes=lambda self: {"n_q": self.q.shape[1], "n_b": self.base.shape[1]},
        q=array_of(("K", "n_q"), finite=False),
        base=array_of(("K", "n_b"), finite=False),
        together=_as_many,
    )
    def skeletons(self, q: Vector, base: Vector) -> Vector:
        """Points as in `Plant.skeleton` in K configurations (K, n_q) and placements (K, n_b).

        Returns:
            (K, points, 2 or 3), m.

        Example:
            >>> run.skeletons(run.q[:2], run.base[:2]).shape
            (2, 4, 2)
        """
        plant, n = build_plant(self.model), len(q)
        p = np.repeat(plant.parameter_values.full(), n, axis=1)
        points = plant.skeleton.map(n).call([q.T, base.T, p])[0].full()
        return points.T.reshape(n, -1, plant.skeleton.size1_out(0))

    @cached_property
    def dataset(self) -> xr.Dataset:
        """Every sample with named axes and units."""
        import xarray as xr  # noqa: PLC0415  (slow to import)

        axes, torque_units = list(self.model.task_rows), " or ".join(dict.fromkeys(self.torque_units))
        units = {"coordinate": "m or rad", "joint": torque_units}
        passive = list(self.coordinates[: self.n_passive])
        variables = {
            "q": (("time", "coordinate"), self.q, {"units": units["coordinate"]}),
            "v": (("time", "coordinate"), self.v, {"units": "m/s or rad/s"}),
            "end_point": (("time", "axis"), self.end_point, {"units": "m", "frame": "inertial"}),
            "error": (("time", "axis"), self.error, {"units": "m"}),
            "torque": (("time", "joint"), self.torque, {"units": units["joint"]}),
            "energy": ("time", self.energy, {"units": "J"}),
            "deflection": (("time", "passive"), self.deflection, {"units": "m or rad"}),
            "base": (("time", "placement"), self.base, {"units": " or ".join(dict.fromkeys(self.model.base_units))}),
            "target": (("time", "axis"), self.target, {"units": "m", "frame": "inertial"}),
        }
        labels = {
            "time": ("time", self.time, {"units": "s"}), "coordinate": list(self.coordinates), "axis": axes,
            "joint": list(self.joints), "passive": passive, "placement": list(self.model.base_coordinates),
        }  # fmt: skip
        return xr.Dataset(variables, labels, {"verdict": self.verdict, "machine": self.machine})

    @public(path=path())
    def to_netcdf(self, path: str | os.PathLike[str]) -> None:
        """Write every sample, the measures and the provenance to a netCDF file.

        Raises:
            WriteError: the file cannot be written.

        Example:
            >>> run.to_netcdf("run.nc")
        """
        import json  # noqa: PLC0415

        data = self.dataset.copy()
        data.attrs["flexopt"] = json.dumps(self.to_dict())
        write_netcdf(path, data)

    @public(path=path())
    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write every sample as a line: time, q, v, end-point, error, torque, energy; the header names them.

        Raises:
            WriteError: the file cannot be written.

        Example:
            >>> run.to_csv("run.csv")
        """
        names = ["time_s", *(f"q_{c}" for c in self.coordinates), *(f"v_{c}" for c in self.coordinates)]
        for word in ("end_point", "error"):
            names += [f"{word}_{axis}_m" for axis in self.model.task_rows]
        names += [f"torque_{j}_{unit.replace(' ', '')}" for j, unit in zip(self.joints, self.torque_units, strict=True)]
        names.append("energy_J")
        columns = [self.time[:, None], self.q, self.v, self.end_point, self.error, self.torque, self.energy[:, None]]
        lines = [",".join(names)]
        lines += [",".join(map(repr, row)) for row in np.concatenate(columns, axis=1).tolist()]
        write_file(path, "\n".join(lines) + "\n")

    def animate(
        self, path: str | os.PathLike[str], *, speed: float = 1.0, magnify: float = 1.0, theme: Theme = "light"
    ) -> None:
        """Write a moving picture of the machine: `.gif` or `.html`, which open anywhere.

        Args:
            path: the file.
            speed: of the film, relative to the machine.
            magnify: factor on the base's deflections, which are small.
            theme: `"light"` or `"dark"` ground.

        Example:
            >>> run = flexopt.simulate(machine, (0.9929, -2.6306), duration=0.2)
            >>> run.animate("run.gif", magnify=20.0)
        """
        drawn(self, path, form="film", speed=speed, magnify=magnify, theme=theme)

    def __repr__(self) -> str:
        def number(value: float | None, text: str) -> str:
            return "–" if value is None else text.format(value)

        rotation = number(self.peak_base_rotation, "{:.4g} rad")
        modes = ", ".join(
            f"{hz:.2f} Hz {f'{e:.2e} J' if math.isfinite(e) else '–'}"
            for hz, e in zip(self.frequencies_hz, self.residual_oscillation, strict=True)
        )
        own, linear = self.growth_rate, self.linear_growth_rate
        shown = "–" if own is None else f"{with_doubt(-own, self.growth_rate_error, 4, '+')}/s"
        exact = "–" if linear is None else f"{-linear:+z.4g}/s"
        why = "" if self.linear is None else alternating(self.linear, self.ended)
        at = ""
        if self.linear is not None and why:
            at = f" at {self.linear.frequency_hz:.4g} Hz{why}"
        elif self.linear is not None and self.linear.aperiodic:
            hertz = self.linear.frequency_hz
            at = f" at {hertz:.4g} Hz, which hardly swings" if hertz else ", a motion without oscillation"
        beyond = "" if self.overshoot is None else f"overshoot {100 * self.overshoot:.1f} %, "
        settles = f"does not settle in {self.time[-1]:g} s"
        if self.settling_time is not None:
            settles = f"settles in {self.settling_time:.3f} s"
        verdict = "may grow or not, undecided" if self.verdict == "undecided" else self.verdict
        # Of a base or a target that moves there is no overshoot.
        whose = "its modes" if self.overshoot is not None else "the modes that it had at the start"
        lines = [
            f"{self.machine}, Jacobian {self.control} control, {self.time[-1]:g} s: the oscillation {verdict} "
            f"(decay {shown} of the base in the run, {exact} of the linear loop{at})",
            f"  end-point: {settles}, {beyond}{number(self.end_error, '{:.3e} m')} off at the end",
            f"  base: turns by up to {rotation}; left in {whose}: {modes}",
        ]
        if linear is not None and self.linear is not None:
            lines += [f"  {sentence}" for sentence in slow_self_motion(self.linear.drift, -linear)]
        if self.loop is not None:
            lines[1:1] = [f"  {line}" for line in repr(self.loop).splitlines()]
        if self.run.levelled:
            lines.append(
                f"  a mode of the base grew to {self.run.grown:.2g} times its first amplitude; the run's decay is that "
                "of its second half, where it hardly grew further: it was too large for the linear loop by then"
            )
        if self.verdict == "undecided":
            lines.insert(1, f"  undecided: {self.verdict_reason}")
        elif linear is None:
            lines.insert(1, f"  {self.verdict_reason}")
        made = self.integrated_growth_rate
        if self.linear is not None and made is not None:
            rate = self.linear.growth_rate
            if abs(made - rate) > NOTICED * abs(rate) + self.linear.rounding:
                lines.append(
                    f"  integrator {self.ended.options.integrator}: makes the linear loop's decay {-made:+z.4g}/s"
                )
        if self.self_motion_rate is not None:
            units = " or ".join(dict.fromkeys(f"{unit}/s" for unit in self.model.joint_units))
            lines.append(f"  self-motion of the arm at the end: {self.self_motion_rate:.3g} {units}")
        return "\n".join([*lines, *(f"  warning: {warning}" for warning in self.warnings)])
