"""Measures and outcomes of all points of a chunk at once, by compiled code.

In: a study's points as columns. Out: arrays by quantity, and a status for each point. Which code computes is settled
before the first point: results must not depend on what the process has computed before.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexopt.errors import InputError
from flexopt.foundation.arrays import Vector, in_columns
from flexopt.large_studies.status import FAILED, NO_EQUILIBRIUM, NO_NUMBER, OK, SINGULAR
from flexopt.loop.evaluation import settings_at
from flexopt.loop.many import decays, expect_decays
from flexopt.loop.outcome import MEASURES
from flexopt.loop.settings import LoopSettings
from flexopt.loop.small_motions import DEAD_TIME
from flexopt.loop.uncertainty_box import UncertaintyBox
from flexopt.model.loop import GAINS, control_of, loop_of_varied, under_control
from flexopt.model.study import POINTS_MAX, Study
from flexopt.model.study_axes import StudyAxis
from flexopt.model.uncertainty import LATE, Uncertainty
from flexopt.plant.machine_motion import motion_of, structure_of
from flexopt.robustness import build_measures
from flexopt.robustness.batches import unsound, w_at
from flexopt.robustness.residues import residue_unit

# Points at a time: their numbers stay in the processor's caches.
BLOCK = 2**14
QUICK = frozenset({"w", "w_posture"})
Arrays = dict[str, NDArray[Any]]
StatusCodes = NDArray[np.int8]


class PointNumbers:
    """What a point's configuration and parameters are, from what varies.

    Attributes:
        study: which.
        axes: what varies.
    """

    def __init__(self, study: Study, axes: tuple[StudyAxis, ...]) -> None:
        self.study, self.axes, self.machine = study, axes, study.loaded_machine
        own = np.array([parameter.value for parameter in self.machine.parameters])
        joints = study.posture if study.posture is not None else self._middle()
        placed = study.base if study.base is not None else np.zeros(len(self.machine.base_coordinates))
        self.own: dict[str, Vector] = {"posture": np.array(joints), "base": np.array(placed), "parameters": own}

    def _middle(self) -> Vector:
        """Of what varies: every joint does, or the study would say how the others are held."""
        found = np.zeros(len(self.machine.joints))
        for axis in self.axes:
            if axis.kind == "posture":
                found[axis.entries[0]] = (axis.low + axis.high) / 2
        return found

    def at(self, columns: Vector) -> dict[str, Vector]:
        """`posture` (n, N), `base` (n_b, N) or (n_b,), `parameters` likewise; of gains and dead time (N,)."""
        found: dict[str, Vector] = {}
        for axis, values in zip(self.axes, columns, strict=True):
            if axis.kind in self.own:
                if axis.kind not in found:
                    found[axis.kind] = self._spread(axis.kind, values.size)
                whole = found[axis.kind]
                chosen = list(axis.entries)
                # Factors of one parameter multiply each other.
                whole[chosen] = whole[chosen] * values if axis.factor else values
            else:
                found[axis.kind] = values
        if "posture" not in found:
            found["posture"] = self._spread("posture", columns.shape[1])
        return {"base": self.own["base"], "parameters": self.own["parameters"]} | found

    def _spread(self, kind: str, count: int) -> Vector:
        """What does not vary, at every point; in a quarter of the time of `numpy.tile`."""
        own = self.own[kind]
        whole = np.empty((own.size, count))
        whole[:] = own[:, None]
        return whole


class ManyMeasures:
    """Measures of a chunk's postures."""

    def __init__(self, study: Study, axes: tuple[StudyAxis, ...]) -> None:
        self.study, self.numbers = study, PointNumbers(study, axes)
        self.machine, self.control = self.numbers.machine, study.control or "inverse"
        self.measures = build_measures(self.machine, self.control, study.gravity)
        self.quick = QUICK.issuperset(study.kept)

    @cached_property
    def shapes(self) -> dict[str, tuple[str, ...]]:
        """Dimensions of each quantity before those of the points."""
        known = {"w": ("mode",), "w_posture": ("mode", "joint"), "frequency_hz": ("mode",), "scale": ("mode",)}
        return {name: known.get(name, ()) for name in self.study.kept}

    @property
    def units(self) -> dict[str, str]:
        """Of each quantity."""
        residue = residue_unit(self.control, self.machine.joint_units)
        by_joint = f"{residue} per joint unit" if residue != "1" else "1 per joint unit"
        known = {"frequency_hz": "Hz", "rigid": residue, "w": residue, "scale": residue, "w_posture": by_joint}
        return {name: known.get(name, "1") for name in self.study.kept}

    def variables(self, count: int) -> dict[str, tuple[tuple[str, ...], tuple[int, ...], str]]:
        """Dimensions, shape and kind of what `fill` fills, `status` last."""
        sizes = {"mode": self.measures.plant.n_passive, "joint": len(self.machine.joints)}
        found = {
            name: ((*dims, "point"), (*(sizes[dim] for dim in dims), count), "f8") for name, dims in self.shapes.items()
        }
        return found | {"status": (("point",), (count,), "i1")}

    def __call__(self, columns: Vector) -> tuple[Arrays, StatusCodes, list[str]]:
        """Arrays (…, N), status (N,), and no reasons: the status says all."""
        found = {name: np.empty(shape, kind) for name, (_, shape, kind) in self.variables(columns.shape[1]).items()}
        status = found.pop("status")
        self.fill(columns, found, status)
        return found, status, []

    def fill(self, columns: Vector, arrays: Mapping[str, NDArray[Any]], status: StatusCodes) -> None:
        """The same into arrays that are there, of any byte order."""
        for start in range(0, columns.shape[1], BLOCK):
            here = slice(start, min(start + BLOCK, columns.shape[1]))
            values, status[here] = self._block(self.numbers.at(columns[:, here]))
            for name in self.shapes:
                arrays[name][..., here] = values[name]

    def _block(self, at: Mapping[str, Vector]) -> tuple[Mapping[str, Vector | None], StatusCodes]:
        postures, bases, p = at["posture"], at["base"], at["parameters"]
        gradient = "w_posture" in self.study.kept
        quick = w_at(self.measures, bases, postures, p, gradient=gradient)
        # One that is no number spoils the sum.
        status = np.where(np.isfinite(quick.w.sum(axis=0)), np.int8(OK), np.int8(NO_NUMBER))
        for fault, which in ((NO_EQUILIBRIUM, quick.unheld), (SINGULAR, quick.singular)):
            if which.any():
                status[np.broadcast_to(which, status.shape)] = fault
        found: dict[str, Vector | None] = {"w": quick.w, "w_posture": quick.w_posture}
        if not self.quick:
            from flexopt.study.maps.points import evaluate_points  # noqa: PLC0415  (its room loads slowly)

            count = postures.shape[1]
            whole = evaluate_points(
                self.machine,
                postures,
                bases=np.broadcast_to(in_columns(bases), (len(bases), count)),
                parameters=p if p.ndim == 2 else None,
                control=self.control,
                gain=self.study.gain,
                gravity=self.study.gravity,
                epsilon_max="epsilon_max" in self.study.kept,
                threads=1,
                expected=POINTS_MAX,
            )
            found |= {name: getattr(whole, name) for name in self.study.kept if name not in QUICK}
        return found, status


class ManyOutcomes:
    """What the real loop does in a chunk's postures."""

    def __init__(self, study: Study, axes: tuple[StudyAxis, ...]) -> None:
        self.study, self.axes, self.numbers = study, axes, PointNumbers(study, axes)
        self.machine = self.numbers.machine
        loop = loop_of_varied(study.loop, self.machine, [axis.kind for axis in axes])
        control = control_of(study.control, loop, self.machine)
        loop = under_control(loop, self.machine, control, f"study {study.name!r}")
        own = self.numbers.own
        self.settings, _ = settings_at(
            self.machine,
            own["posture"],
            own["base"],
            control,
            loop,
            gravity=study.gravity,
            call=f"study {study.name!r}",
        )
        self._check()
        self.measures = build_measures(self.machine, self.settings.control, study.gravity)
        self.batched = {"decay", "frequency_hz"}.issuperset(study.kept)
        expect_decays(POINTS_MAX, self.machine, self.settings, gravity=study.gravity)

    def _check(self) -> None:
        """Dead times beyond what a loop is told of."""
        for axis in self.axes:
            if axis.kind == DEAD_TIME:
                ends = Uncertainty(of=(LATE,), value=(axis.low, axis.high))
                faults = UncertaintyBox(self.machine, (ends,), self.settings.dead_time).faults(self.settings.rate)
                if faults:
                    raise InputError(f"study {self.study.name!r}: vary ({axis.name}): {faults[0].sentence}", faults)

    @property
    def shapes(self) -> dict[str, tuple[str, ...]]:
        """Each quantity is one number."""
        return dict.fromkeys(self.study.kept, ())

    @property
    def units(self) -> dict[str, str]:
        """Of each quantity."""
        swing = "rad/m" if motion_of(structure_of(self.machine), {}).base_hinges else "1"
        known = {"decay": "1/s", "frequency_hz": "Hz", "delay_margin": "s", "settling": "s", "swing": swing}
        known |= {"allowed_gain": self.settings.gain_units[0], "h2_norm": "m"}
        return {name: known.get(name, "1") for name in self.study.kept}

    def __call__(self, columns: Vector) -> tuple[Arrays, StatusCodes, list[str]]:
        """Arrays (N,), status (N,) and, where points are computed one by one, reasons."""
        at, count = self.numbers.at(columns), columns.shape[1]
        bases = np.broadcast_to(in_columns(at["base"]), (len(at["base"]), count))
        varied = {"posture": at["posture"], "base": np.ascontiguousarray(bases)}
        if at["parameters"].ndim == 2:
            varied["p"] = at["parameters"]
        for name in GAINS:
            if name in at:
                varied[name] = np.tile(at[name], (getattr(self.settings, name).size, 1))
        if LATE in at:
            varied[DEAD_TIME] = at[LATE][None]
        singular, unheld = unsound(self.measures, at["base"], at["posture"], at["parameters"])
        status = np.full(count, OK, dtype=np.int8)
        status[np.broadcast_to(unheld, count)] = NO_EQUILIBRIUM
        status[np.broadcast_to(singular, count)] = SINGULAR
        found: Arrays = {name: np.full(count, np.nan) for name in self.study.kept}
        sound, reasons = np.flatnonzero(status == OK), [""] * (0 if self.batched else count)
        chosen = {name: np.ascontiguousarray(values[:, sound]) for name, values in varied.items()}
        if sound.size:
            known = decays(self.machine, self.settings, chosen, gravity=self.study.gravity, threads=1)
            for name, values in (("decay", known.decay), ("frequency_hz", known.frequency_hz)):
                if name in found:
                    found[name][sound] = values
            status[sound[~np.isfinite(known.decay)]] = NO_NUMBER
        if not self.batched:
            for k in np.flatnonzero(status == OK).tolist():
                try:
                    self._one(found, k, {name: values[:, k] for name, values in varied.items()})
                except (ArithmeticError, ValueError, RuntimeError, np.linalg.LinAlgError) as error:
                    status[k], reasons[k] = FAILED, f"{type(error).__name__}: {error}"
        return found, status, reasons

    def _one(self, found: Arrays, k: int, at: Mapping[str, Vector]) -> None:
        """Those numbers of a loop that take it alone."""
        settings: LoopSettings = replace(self.settings, **{name: at[name] for name in GAINS if name in at})
        late = float(at[DEAD_TIME][0]) if DEAD_TIME in at else None
        point = settings.outcome(
            self.machine, at["base"], at["posture"], gravity=self.study.gravity, parameters=at.get("p"), dead_time=late
        )
        for name in self.study.kept:
            if name not in ("decay", "frequency_hz"):
                found[name][k] = MEASURES[name](point).value
