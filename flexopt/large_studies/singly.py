"""Selections and simulations, one point after the other.

In: a study's points as columns. Out: arrays by quantity, a status and a reason for each point. A machine's numbers that
vary are put into its description, so that each point has a machine of its own, as if a file had said so.
"""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from flexopt.errors import FlexoptWarning, InputError
from flexopt.foundation.arrays import Vector
from flexopt.large_studies.status import OK, status_of
from flexopt.model.choices import DECAY, DELAY_MARGIN, RADIUS, SETTLING, asks_for_loop
from flexopt.model.loop import GAINS
from flexopt.model.machine import AnyMachine
from flexopt.model.parameter_values import with_parameters
from flexopt.model.problem import Problem
from flexopt.model.simulation import Experiment
from flexopt.model.simulation_faults import loop_of_runs
from flexopt.model.study import Study
from flexopt.model.study_axes import StudyAxis
from flexopt.plant import build_plant
from flexopt.robustness.residues import residue_unit
from flexopt.selection import select
from flexopt.simulation import run_experiment


class OneByOne(ABC):
    """What selections and simulations have in common."""

    def __init__(self, study: Study, axes: tuple[StudyAxis, ...]) -> None:
        self.study, self.axes, self.machine = study, axes, study.loaded_machine
        self.own = np.array([parameter.value for parameter in self.machine.parameters])
        if any(axis.kind == "parameters" for axis in axes):
            # What no key of the description holds alone is refused before anything runs.
            with_parameters(self.machine, self.parameters(np.array([axis.low for axis in axes])))
        self.sizes = {
            "mode": build_plant(self.machine).n_passive,
            "joint": len(self.machine.joints),
            "placement": len(self.machine.base_coordinates),
        }

    @property
    def shapes(self) -> dict[str, tuple[str, ...]]:
        """Dimensions of each quantity before those of the points."""
        known = {"w": ("mode",), "posture": ("joint",), "base": ("placement",)}
        return {name: known.get(name, ()) for name in self.study.kept}

    @property
    def units(self) -> dict[str, str]:
        """Of each quantity."""
        known = {"linear_growth_rate": "1/s", "growth_rate": "1/s", "growth_rate_error": "1/s", "finite_until": "s"}
        known |= {"end_error": "m", "settling_time": "s", "peak_base_rotation": "rad"}
        return {name: known.get(name, "1") for name in self.study.kept}

    def parameters(self, column: Vector) -> dict[str, float]:
        """Values of the parameters that vary, by name."""
        p = self.own.copy()
        chosen: list[int] = []
        for axis, value in zip(self.axes, column.tolist(), strict=True):
            if axis.kind == "parameters":
                entries = list(axis.entries)
                p[entries] = p[entries] * value if axis.factor else value
                chosen += entries
        return {self.machine.parameters[k].name: float(p[k]) for k in dict.fromkeys(chosen)}

    def varied_machine(self, column: Vector) -> AnyMachine:
        """The machine of a point."""
        values = self.parameters(column)
        return with_parameters(self.machine, values) if values else self.machine

    def placed(self, kind: str, column: Vector, present: Any) -> Any:
        """A list of numbers some of which vary; None where none does and there is none."""
        at = {axis.entries[0]: float(x) for axis, x in zip(self.axes, column, strict=True) if axis.kind == kind}
        if not at:
            return present
        if present is None:
            present = np.zeros({"base": self.sizes["placement"], "posture": self.sizes["joint"]}[kind])
        whole = np.array(present, dtype=float).reshape(-1)
        for entry, value in at.items():
            whole[entry] = value
        return whole.tolist()

    def __call__(self, columns: Vector) -> tuple[dict[str, NDArray[Any]], NDArray[np.int8], list[str]]:
        """Arrays (…, N), status (N,), and a reason for each point that has one."""
        count = columns.shape[1]
        found = {
            name: np.full((*(self.sizes[dim] for dim in dims), count), np.nan) for name, dims in self.shapes.items()
        }
        status, reasons = np.full(count, OK, dtype=np.int8), [""] * count
        for k in range(count):
            try:
                with warnings.catch_warnings():
                    # They are part of a single result; here nobody reads them.
                    warnings.simplefilter("ignore", FlexoptWarning)
                    values = self.one(columns[:, k])
                for name, array in found.items():
                    value = values[name]
                    array[..., k] = np.nan if value is None else value
            except Exception as error:
                status[k], reasons[k] = status_of(error)
        return found, status, reasons

    @abstractmethod
    def one(self, column: Vector) -> Mapping[str, Any]:
        """The numbers of a point by quantity; None where there is none."""


class ManySelections(OneByOne):
    """A selection at every point."""

    @property
    def units(self) -> dict[str, str]:
        """See `OneByOne`."""
        problem = cast(Problem, self.study.subject)
        residue = residue_unit(problem.select_arguments()["control"], self.machine.joint_units)
        names = str(problem.selection.objective).split(",")
        # Where the loop is asked the last objective is told, as `select` has it.
        told = names[-1 if asks_for_loop(",".join(names), problem.select_arguments()["constraints"]) else 0]
        of_loop = {DECAY: "1/s", DELAY_MARGIN: "s", SETTLING: "s", RADIUS: "1"}
        unit = residue if told == "V" or told[1:].isdigit() else "1" if told == "epsilon_max" else f"that of {told}"
        known = {"posture": "rad or m", "base": "m or rad", "w": residue, "objective": of_loop.get(told, unit)}
        return {name: known.get(name, "1") for name in self.study.kept}

    def one(self, column: Vector) -> Mapping[str, Any]:
        """Of the best configuration."""
        problem = cast(Problem, self.study.subject)
        given: dict[str, Any] = problem.select_arguments() | {"machine": self.varied_machine(column), "workers": 1}
        given["target"] = self.placed("target", column, given["target"])
        given["base"] = self.placed("base", column, given["base"])
        best = select(**given).best
        at = best.evaluation
        found: dict[str, Any] = {"objective": best.objective, "w": best.w, "base": at.base, "posture": at.posture}
        return found | {"epsilon_max": at.epsilon_max}


class ManySimulations(OneByOne):
    """A simulation at every point."""

    def __init__(self, study: Study, axes: tuple[StudyAxis, ...]) -> None:
        super().__init__(study, axes)
        experiment = cast(Experiment, study.subject)
        held = {axis.entries[0] for axis in axes if axis.kind == "posture"}
        if held and experiment.simulation.posture is None and len(held) < self.sizes["joint"]:
            raise InputError(f"study {study.name!r}: vary: some joints vary, and the experiment's posture is not given")

    def one(self, column: Vector) -> Mapping[str, Any]:
        """Of the run."""
        experiment = cast(Experiment, self.study.subject)
        options, loop = experiment.simulation, loop_of_runs(experiment)
        gains = {axis.kind: float(x) for axis, x in zip(self.axes, column, strict=True) if axis.kind in GAINS}
        # A [loop] says its gains itself, else the run's options do.
        overrides: dict[str, Any] = {} if loop else dict(gains)
        loop = loop and loop.model_copy(update={name: (gain,) for name, gain in gains.items()})
        for kind in ("posture", "base"):
            if any(axis.kind == kind for axis in self.axes):
                overrides[kind] = self.placed(kind, column, getattr(options, kind))
        run = run_experiment(experiment.with_machine(self.varied_machine(column)), loop=loop, **overrides)
        return {name: getattr(run, name) for name in self.study.kept}
