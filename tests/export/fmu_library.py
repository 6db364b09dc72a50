"""FMUs in FMPy: what their tests share. Runs, references, trajectories by the names of variables, single instances."""

from __future__ import annotations

import csv
import ctypes
import math
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    FMU2Slave,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)
from fmpy.fmi3 import FMU3Slave

import flexopt
from flexopt.export.fmu import FmuReport
from flexopt.export.fmu.guards import RK4_LIMIT, RK4_REAL_LIMIT
from flexopt.export.fmu.model import FmuModel
from flexopt.simulation.scenario import Scenario

VERSIONS = ("2.0", "3.0")
WARNINGS = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion", "-Werror"]
# Trajectories of one loop by two orders of operations: rounding, not amplified where the loop converges.
TOLERANCE = 1e-10


def reference(report: FmuReport) -> np.ndarray:
    with report.reference.open(newline="", encoding="utf-8") as file:
        names, *rows = csv.reader(file)
    return np.array([tuple(map(float, row)) for row in rows], dtype=[(name, "f8") for name in names])


def run(report: FmuReport, **options: Any) -> np.ndarray:
    settings = {"output": list(report.outputs), "output_interval": report.period} | options
    return fmpy.simulate_fmu(str(report.path), **settings)


def difference(a: Any, b: Any, names: Any) -> dict[str, float]:
    """Largest difference of each variable as a share of its size, or of 1 where that is larger."""
    return {n: float(np.abs(a[n] - b[n]).max() / max(1.0, np.abs(b[n]).max())) for n in names}


def worst(a: Any, b: Any, names: Any) -> float:
    found = difference(a, b, names)
    print(max(found.items(), key=lambda pair: pair[1]))
    return max(found.values())


def shown(trajectory: flexopt.Trajectory) -> dict[str, np.ndarray]:
    """A trajectory by the names of an FMU's outputs."""
    t = trajectory
    columns = {f"q.{name}": t.q[:, k] for k, name in enumerate(t.coordinates)}
    columns |= {f"v.{name}": t.v[:, k] for k, name in enumerate(t.coordinates)}
    columns |= {f"torque.{name}": t.torque[:, k] for k, name in enumerate(t.joints)}
    columns |= {
        f"{g}.{axis}": getattr(t, g)[:, k] for g in ("end_point", "error") for k, axis in enumerate(t.model.task_rows)
    }
    columns |= {f"deflection.{name}": t.deflection[:, k] for k, name in enumerate(t.coordinates[: t.n_passive])}
    return columns | {"energy": t.energy}


@dataclass
class Slave:
    """An instance of an FMU with its log, called as FMPy calls it."""

    fmu: Any
    log: list[str]
    references: dict[str, int]
    keep: Any

    def real(self, *names: str) -> list[float]:
        get = self.fmu.getReal if isinstance(self.fmu, FMU2Slave) else self.fmu.getFloat64
        return list(get([self.references[name] for name in names]))

    def set(self, **values: float) -> None:
        self.set_many({name.replace("__", "."): value for name, value in values.items()})

    def set_many(self, values: dict[str, float]) -> None:
        put = self.fmu.setReal if isinstance(self.fmu, FMU2Slave) else self.fmu.setFloat64
        put([self.references[name] for name in values], list(values.values()))

    def start(self, at: float = 0.0) -> Slave:
        if isinstance(self.fmu, FMU2Slave):
            self.fmu.setupExperiment(startTime=at)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=at)
        self.fmu.exitInitializationMode()
        return self

    def step(self, at: float, size: float) -> None:
        self.fmu.doStep(currentCommunicationPoint=at, communicationStepSize=size)

    def refuses(self, words: str, call: Any, *arguments: Any, **named: Any) -> None:
        """That a call ends with fmi2Error or fmi3Error, and one message that holds these words."""
        self.log.clear()
        with pytest.raises(FMICallException) as refused:
            call(*arguments, **named)
        assert refused.value.status == 3
        assert len(self.log) == 1
        assert words in self.log[0]


LIBC = ctypes.CDLL(None)
LIBC.calloc.restype = ctypes.c_void_p
LIBC.calloc.argtypes = [ctypes.c_size_t, ctypes.c_size_t]
LIBC.free.argtypes = [ctypes.c_void_p]


@contextmanager
def opened(report: FmuReport, folder: Path, token: str | None = None) -> Iterator[Slave]:
    description = fmpy.read_model_description(str(report.path))
    unzipped = folder / f"{report.path.stem}-unzipped"
    if not unzipped.exists():
        fmpy.extract(str(report.path), str(unzipped))
    log: list[str] = []
    settings = {
        "guid": token or description.guid, "unzipDirectory": str(unzipped), "instanceName": "one",
        "modelIdentifier": description.coSimulation.modelIdentifier,
    }  # fmt: skip
    references = {v.name: v.valueReference for v in description.modelVariables}
    if report.version == "2.0":
        fmu: Any = FMU2Slave(**settings)
        callbacks = fmi2CallbackFunctions()
        # The message is variadic: "%s" comes first, and the text is in the next argument's register.
        logger = ctypes.CFUNCTYPE(
            None, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p, ctypes.c_char_p
        )(lambda _, name, status, category, form, text: log.append(text.decode()))
        callbacks.logger = ctypes.cast(logger, fmi2CallbackLoggerTYPE)
        callbacks.allocateMemory = ctypes.cast(LIBC.calloc, fmi2CallbackAllocateMemoryTYPE)
        callbacks.freeMemory = ctypes.cast(LIBC.free, fmi2CallbackFreeMemoryTYPE)
        keep: Any = (callbacks, logger)
        fmu.instantiate(callbacks=callbacks, loggingOn=True)
    else:
        fmu = FMU3Slave(**settings)
        keep = lambda env, status, category, text: log.append(text.decode())  # noqa: E731
        fmu.instantiate(loggingOn=True, logMessage=keep)
    try:
        yield Slave(fmu, log, references, keep)
    finally:
        fmu.freeInstance()


def sources(report: FmuReport, folder: Path) -> Path:
    with zipfile.ZipFile(report.path) as archive:
        text = archive.read("sources/fmu.c")
    (folder / "fmu.c").write_bytes(text)
    return folder / "fmu.c"


def check_setup(scenario: Scenario, bandwidth_hz: float) -> None:
    """That an FMU computes from its start values the constants, the start and the target of their scenario."""
    model: Any = FmuModel(scenario, "co-simulation", None)
    a = [v.start for v in (*model.parameters, *model.inputs[: len(model.moving)])]
    c, x, point, guards = (part.full().ravel() for part in model.setup.call([a]))
    for name, where in model.loop.constants.slices.items():
        if name not in {"u_design", "modes", "omega_squared"}:
            expected = np.ravel(scenario.parts[name])
            np.testing.assert_allclose(c[where], expected, rtol=1e-12, atol=1e-13, err_msg=name)
    np.testing.assert_allclose(x, scenario.start, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(point, scenario.target, rtol=1e-12, atol=1e-12)
    for guard, value in zip(model.guards, guards, strict=True):
        assert guard.low <= value <= guard.high, guard.text
    # The bound on the fastest mode is one, and a close one: m^(1/512).
    fastest = 2 * math.pi * max(scenario.frequencies_hz[-1], bandwidth_hz * RK4_LIMIT / RK4_REAL_LIMIT)
    most = len(scenario.frequencies_hz) ** (1 / 512)
    assert 1 - 1e-9 < guards[-1] * RK4_LIMIT / (fastest * scenario.parts["h"]) < most * (1 + 1e-9)
