"""The generated optimiser as a shared library, called from Python."""

from __future__ import annotations

import ctypes
import math
import re
import subprocess
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.optimiser import value_of
from flexopt.export.context import build_context
from flexopt.export.kernels import Real
from flexopt.export.optimiser import OptimiserSources, build_optimiser
from flexopt.foundation.control import Control
from flexopt.foundation.quantities import COORDINATE_MAX
from flexopt.model import AnyMachine

WARNINGS = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror"]
INCLUDES = "#include <math.h>\n#include <stddef.h>\n#include <stdint.h>\n"
PREFIX = "case_optimiser"
EXPIRED = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)


@dataclass(frozen=True)
class Answer:
    """What a call gave; the result's fields are those before the call where it failed."""

    status: str
    z: np.ndarray
    value: float
    scale: float
    target_error: float
    bound_violation: float
    margin_slack: float
    stationarity: float
    cost: int
    iterations: int
    starts: int

    @property
    def feasible(self) -> bool:
        """Whether the status promises a feasible configuration."""
        return self.status in {"CONVERGED", "BUDGET_SPENT", "DEADLINE", "STALLED"}


class Library:
    """One compiled optimiser."""

    def __init__(
        self, sources: OptimiserSources, machine: AnyMachine, folder: Path, flags: list[str], real: str
    ) -> None:
        self.sources, self.real = sources, ctypes.c_float if real == "float" else ctypes.c_double
        kernels = sources.kernels
        self.n_z = kernels.position.numel_in(0) + kernels.position.numel_in(1)
        self.n_task, self.n_modes = kernels.position.numel_out(0), kernels.value.numel_in(4)
        macros = dict(re.findall(r"#define \w+?_(WEIGHTS|PARAMETERS)_AT_RUN_TIME +([01])", sources.header))
        assert macros["WEIGHTS"] == "1"
        self.parameters_at_run_time = macros["PARAMETERS"] == "1"
        text = c_text(sources, real)
        text += f"size_t {PREFIX}_workspace_bytes(void);\n"
        text += f"size_t {PREFIX}_workspace_bytes(void) {{ return {sources.workspace_size}; }}\n"
        (folder / "optimiser.c").write_text(text)
        library = folder / "liboptimiser.so"
        command = ["gcc", *WARNINGS, *flags, "-shared", "-fPIC", "-o", str(library), str(folder / "optimiser.c"), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[:4000]
        self.c = ctypes.CDLL(str(library))
        size = getattr(self.c, f"{PREFIX}_workspace_bytes")
        size.restype = ctypes.c_size_t
        self.workspace = (ctypes.c_byte * (size() + 64))()
        self.Problem, self.Options, self.Result = self._types(len(machine.parameters))

    def _types(self, n_parameters: int) -> tuple[Any, Any, Any]:
        real, vector = self.real, self.real * self.n_z
        problem = [("target", real * self.n_task), ("lower", vector), ("upper", vector), ("sine_squared_min", real)]
        problem.append(("weights", real * self.n_modes))
        if self.parameters_at_run_time:
            problem.append(("parameters", real * n_parameters))
        options = [("budget", ctypes.c_int), ("starts", ctypes.c_int), ("tolerance", real)]
        options += [("expired", EXPIRED), ("context", ctypes.c_void_p)]
        names = ("value", "scale", "target_error", "bound_violation", "margin_slack", "stationarity")
        result = [("z", vector), *((name, real) for name in names)]
        result += [(name, ctypes.c_int) for name in ("cost", "iterations", "starts")]
        fields = {"Problem": problem, "Options": options, "Result": result}
        made = [type(name, (ctypes.Structure,), {"_fields_": value}) for name, value in fields.items()]
        return made[0], made[1], made[2]

    def default_problem(self) -> Any:
        problem = self.Problem()
        assert self.c[f"{PREFIX}_default_problem"](ctypes.byref(problem)) == 0
        return problem

    def default_options(self) -> Any:
        options = self.Options()
        assert self.c[f"{PREFIX}_default_options"](ctypes.byref(options)) == 0
        return options

    def problem(self, target: Any, **changes: Any) -> Any:
        """The default problem with a target and changed fields."""
        problem = self.default_problem()
        for name, value in ({"target": target} | changes).items():
            if np.ndim(value):
                getattr(problem, name)[:] = [float(v) for v in value]
            else:
                setattr(problem, name, value)
        return problem

    def options(self, expired: Any = None, **changes: Any) -> Any:
        options = self.default_options()
        for name, value in changes.items():
            setattr(options, name, value)
        if expired is not None:
            options.expired = EXPIRED(expired)
        return options

    def solve(self, problem: Any, start: Any = None, options: Any = None, result: Any = None) -> Answer:
        """One call."""
        options = self.options() if options is None else options
        given = None if start is None else (self.real * self.n_z)(*[float(v) for v in start])
        result = self.Result() if result is None else result
        place = -(-ctypes.addressof(self.workspace) // 64) * 64
        status = self.c[f"{PREFIX}_solve"](
            ctypes.byref(problem),
            given,
            ctypes.byref(options),
            ctypes.c_void_p(place),
            ctypes.byref(result),
        )
        names = {value: name for name, value in self.sources.statuses.items()}
        values = {name: getattr(result, name) for name, _ in self.Result._fields_ if name != "z"}
        return Answer(status=names[status], z=np.array(result.z), **values)


@lru_cache(maxsize=16)
def sources_of(
    machine: AnyMachine, *, control: Control = "inverse", real: Real = "double", baked: bool = False
) -> OptimiserSources:
    """The optimiser of a machine."""
    at = build_context(
        machine, control=control, gain=1.0, single=real == "float", baked=baked, singularity_margin_deg=10.0
    )
    return build_optimiser(at, "case", real)


def header_of(sources: OptimiserSources, real: str) -> str:
    """The header, with what it takes from the bundle's own."""
    included = '#include "case_control.h"\n'
    assert sources.header.count(included) == 1
    return sources.header.replace(included, f"typedef {real} case_real;\n")


def c_text(sources: OptimiserSources, real: str) -> str:
    """All in one C file."""
    return f"{INCLUDES}{header_of(sources, real)}\n{sources.source}\n"


def library(machine: AnyMachine, folder: Path, flags: tuple[str, ...] = ("-O0",), **options: Any) -> Library:
    """Compiled with all warnings as errors."""
    sources = sources_of(machine, **options)
    return Library(sources, machine, folder, list(flags), options.get("real", "double"))


def problem_of(lib: Library, selection: Any) -> Any:
    """A selection problem as the library takes it."""
    bounds = [b.clip(-COORDINATE_MAX, COORDINATE_MAX) for b in (selection.lower, selection.upper)]
    margin, weights = math.sin(selection.singularity_margin) ** 2, selection.objective.alpha
    return lib.problem(selection.target, lower=bounds[0], upper=bounds[1], sine_squared_min=margin, weights=weights)


def assert_feasible(selection: Any, answer: Answer, tolerance: float = 1e-12) -> None:
    """Checked by flexopt's own Functions; Newton's method ends at rounding, far below the tolerance."""
    _, error = value_of(selection, answer.z)
    assert error <= tolerance * (1 + np.abs(selection.target).max())
    assert np.all(answer.z >= selection.lower)
    assert np.all(answer.z <= selection.upper)
    plant = selection.measures.plant
    at = [answer.z[: plant.n_base], answer.z[plant.n_base :], plant.parameter_values]
    sine = float(plant.singularity_sine_squared.call(at)[0])
    assert sine >= math.sin(selection.singularity_margin) ** 2 - tolerance
    assert answer.target_error == pytest.approx(error, abs=tolerance)
    assert answer.bound_violation == 0.0
