"""C text of the posture optimiser: `flexopt.selection`'s program solved on a controller.

In: a machine, its controller, what shall be constant. Out: declarations, a configuration with the generated kernels,
and the search of `optimiser_c/`, plain C that compiles with that configuration. No heap, no recursion, bounded loops,
memory owned by the caller; each accepted iterate is feasible, so that the best so far can be used whenever time runs
out.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np

from flexopt.export.context import Context
from flexopt.export.kernels import Kernel, Real, kernel_text
from flexopt.export.naming import CWriter, constants
from flexopt.export.optimiser_kernels import OptimiserKernels, build_optimiser_kernels
from flexopt.export.task_rows import task_frame
from flexopt.foundation.arrays import Array
from flexopt.foundation.quantities import COORDINATE_MAX
from flexopt.model import AnyMachine
from flexopt.model.parameter_ranges import parameter_range
from flexopt.plant import Plant
from flexopt.plant.inverse_kinematics import low_discrepancy
from flexopt.plant.reach import path_to_end_point
from flexopt.robustness.measures import Measures

# The search, and those of its functions that are given memory to work on.
SEARCH = tuple(
    f"optimiser{part}"
    for part in (
        "_constants.h", "_evaluate.h", "_algebra.h", "_project.h", "_plane.h", "_exact.h", "_differences.h", "_climb.h",
        "_starts.h", "_closed_form.h", "_sampled.h", ".c",
    )
)  # fmt: skip
WITH_WORK = {"hold", "value", "model", "slope"}
# Own starts kept, and placements (or points of the redundancy) looked at for them, each elbow; where postures have no
# closed form, points of the whole range in each of so many rounds.
STARTS = 16
CURVE_SAMPLES, SURFACE_SAMPLES, SAMPLES, ROUNDS = 48, 96, 24, 4
BUDGET_MAX = 1_000_000
EPSILON = {"double": 2.0**-52, "float": 2.0**-23}
# A climb ends at this stationarity, the same in V/scale as `flexopt.selection.proof.check`'s; where rounding ends it
# earlier, the second number still counts as stationary. Values of V/scale closer than the third are equal.
TOLERANCES = {"double": (1e-8, 1e-6, 1e-9), "float": (1e-4, 3e-3, 1e-6)}
# With Hessians that are no exact ones the last digits cost more than they bring.
TOLERANCE_MIN = 1e-6
# Stationarity at which climbs are compared.
ROUGH = {"double": 1e-4, "float": 1e-2}
# sin² is a product of as many terms as the task has rows: with many of them more than a few roundings.
MARGIN_EDGE = {"double": 1e-10, "float": 1e-4}
# Instructions of an emulated Cortex-M7 (benchmarks/optimiser.py): an operation of a unit of the budget, what a unit
# takes besides, what a call may take.
PER_OPERATION, PER_UNIT, INSTRUCTIONS = {"double": 2.35, "float": 2.1}, 4200, 4_900_000
# Rounding of positions relative to the reach, in units of the precision; how far off its target an answer may be.
EDGE, TARGET_TOLERANCES = 32, {"double": 128, "float": 8}
# In double precision Newton's method ends at rounding by itself; in single precision its last step but one is close
# enough to end a climb's step, and one or two more bring what an answer needs.
SETTLING = {"double": 0, "float": 2}
# Step of differences of slopes, in scaled variables: the root of a slope's rounding error.
PROBES = {"double": 1e-6, "float": 1e-2}


# Name -> value and meaning. From `FIRST_FAILURE` on there is no answer.
FIRST_FAILURE = 16
STATUSES = {
    "CONVERGED": (0, "a local optimum: feasible, and stationary to the tolerance, or to {enough} where rounding allows "
                  "no more; not proved to be the best of all"),
    "BUDGET_SPENT": (1, "feasible; the budget ended before it was proved stationary, or before every start"),
    "DEADLINE": (2, "the same, ended by expired()"),
    "STALLED": (3, "feasible, not stationary, and no step raises V in this precision; an optimum on a kink, where "
                "a w_i is 0, ends so, too: use it as the others"),
    "NULL_POINTER": (16, "a pointer is NULL; start alone may be"),
    "BAD_WORKSPACE": (17, "the workspace is not aligned as its type asks, or overlaps another argument"),
    "NOT_FINITE": (18, "an input is NaN or infinite"),
    "OUT_OF_RANGE": (19, "bounds reversed, margin or tolerance outside (0, 1), weights negative or all 0, budget, "
                     "starts, a machine parameter outside the range of machine files"),
    "NO_FEASIBLE": (20, "the target is out of reach, or no start led to a feasible point: give one that is near"),
    "ENDED_EARLY": (21, "budget or deadline ended before the first feasible point; whether there is one is not known"),
}  # fmt: skip


@dataclass(frozen=True)
class OptimiserSources:
    """The optimiser as text, to be put into a bundle.

    Attributes:
        header: what users see.
        configuration: the generated functions, all static, and what the search needs to know of the machine; needs the
            header.
        workspace_size: name of the macro with the workspace's size in bytes, `sizeof` of the type of the workspace.
        kernels: the Functions behind it.
        budget: default budget of a call, in evaluations of V: what an emulated Cortex-M7 does within five million
            instructions.
        status_texts: name, without prefix -> value and meaning.
    """

    header: str
    configuration: str
    workspace_size: str
    kernels: OptimiserKernels
    budget: int
    status_texts: Mapping[str, tuple[int, str]]

    @property
    def statuses(self) -> dict[str, int]:
        """Name -> value, without prefix."""
        return {name: value for name, (value, _) in self.status_texts.items()}

    @property
    def source(self) -> str:
        """All in one C file, to be put after the header."""
        chosen = dict(re.findall(r'#define (\w+) "(\w+\.h)"', self.configuration))
        return f"{self.configuration}\n{_amalgamated('optimiser.c', chosen, set())}"


def build_optimiser(at: Context, prefix: str, real: Real) -> OptimiserSources:
    """Write the optimiser of V(z) = Σ α_i w_i(z) subject to r(z) = target, bounds and the singularity margin.

    Target, bounds, margin and α are inputs of every call; so is p unless it is baked. It knows no further constraints:
    of what `flexopt.select` assumes (`flexopt.selection.assumed`) the joint limits alone.

    Args:
        at: the machine, its controller, whether its own p become constants, the margin of the default problem.
        prefix: of every public name, before `_optimiser_`; that of the bundle, whose header declares `real`'s type.
        real: precision.
    """
    kernels, real_type = build_optimiser_kernels(at), f"{prefix}_real"
    text = kernel_text(kernels.functions, real, real_type)
    budget = default_budget(kernels, real)
    margin_deg = math.degrees(math.asin(at.singularity_margin))
    writer = CWriter(prefix, real)
    values = _values(at, kernels, text.kernels) | {
        "p": f"{prefix}_optimiser",
        "P": f"{prefix}_optimiser".upper(),
        "real_type": real_type,
        "budget": budget,
        "margin_deg": margin_deg,
        "sine_squared_min": math.sin(math.radians(margin_deg)) ** 2,
    }
    enough = f"{TOLERANCES[real][1]:g}"
    statuses = {name: (value, text.format(enough=enough)) for name, (value, text) in STATUSES.items()}

    def header(indices: Sequence[str]) -> str:
        return writer.render("optimiser.h", statuses=statuses, first_failure=FIRST_FAILURE, indices=indices, **values)

    # Indices share their prefix with all else in the header.
    taken = re.findall(rf"\b{values['P']}_(\w+)", header(()))
    return OptimiserSources(
        header=header(constants(at.choice, taken)),
        configuration=writer.render("optimiser_config.h", statuses=statuses, kernels=text.text, **values),
        workspace_size=f"{values['P']}_WORKSPACE_SIZE",
        kernels=kernels,
        budget=budget,
        status_texts=statuses,
    )


def optimiser_refusal(machine: AnyMachine) -> str:
    """Why a machine can have no optimiser; empty where it can."""
    if len(machine.joints) < 2:
        return "the optimiser needs two actuated joints or more"
    variables, rows = len(machine.base_coordinates) + len(machine.joints), len(machine.task_rows)
    if variables <= rows:
        return (
            "the optimiser needs more variables than the task has rows, else nothing is left to choose: placement and "
            f"joints are {variables} variables for {rows} rows"
        )
    return ""


def default_budget(kernels: OptimiserKernels, real: Real) -> int:
    """Evaluations of V that cost less than five million instructions of an emulated Cortex-M7."""
    return int(INSTRUCTIONS / (PER_OPERATION[real] * kernels.unit + PER_UNIT))


def bounds_of(machine: AnyMachine) -> list[tuple[float, float]]:
    """Of z: none of the placement, the joints' limits; what is as large as `COORDINATE_MAX` counts as none."""
    placed = [(-COORDINATE_MAX, COORDINATE_MAX)] * len(machine.base_coordinates)
    return placed + [(max(low, -COORDINATE_MAX), min(high, COORDINATE_MAX)) for low, high in machine.limits]


def _search(name: str) -> str:
    """A file of the search."""
    return (files("flexopt.export") / "optimiser_c" / name).read_text(encoding="utf-8")


def _amalgamated(name: str, chosen: Mapping[str, str], seen: set[str]) -> str:
    """A file of the search with those that it includes in their places, each once, without guards."""

    def included(match: re.Match[str]) -> str:
        file = match[1].strip('"')
        file = chosen.get(file, file)
        if file in seen or file not in SEARCH:
            return ""
        seen.add(file)
        return _amalgamated(file, chosen, seen)

    text = re.sub(r"(?m)^#(ifndef|define) OPTIMISER_\w+_H\n|^#endif /\* OPTIMISER_\w+_H \*/\n", "", _search(name))
    return re.sub(r"(?m)^#include (.*)\n", included, text)


def _values(at: Context, kernels: OptimiserKernels, texts: Mapping[str, Kernel]) -> dict[str, Any]:
    """What header and configuration ask for."""
    real: Real = "float" if at.single else "double"
    plant, machine = at.plant, at.machine
    bounds = bounds_of(machine)
    ranges = [parameter_range(parameter) for parameter in machine.parameters]
    idle = _idle(at.measures)
    tolerance, enough, tie = TOLERANCES[real]
    exact, many_rows = kernels.exact_second, plant.n_task > 3
    still = [0] * plant.n_actuated
    with_work = {name for name, kernel in texts.items() if set(kernel.parameters) - {"arg", "res"}}
    if not with_work <= WITH_WORK or any("iw" in kernel.parameters for kernel in texts.values()):
        raise ValueError(f"{', '.join(sorted(with_work))}: memory that the search does not give")
    return (
        _sampling(plant, kernels)
        | _placing(plant)
        | {
            "machine": machine,
            "control": at.control,
            "variables": at.choice,
            "n_base": plant.n_base,
            "n_task": plant.n_task,
            "task_frame": task_frame(machine),
            "n_modes": plant.n_passive,
            "n_held": max(1, kernels.hold.size1_out(0)),
            "n_work": max(1, *(kernel.sz_w for kernel in texts.values())),
            "parameter_names": plant.parameter_names,
            "parameters_at_run_time": not at.baked,
            "parameters": [parameter.value for parameter in machine.parameters],
            "parameters_low": [low for low, _ in ranges],
            "parameters_high": [high for _, high in ranges],
            "lower": [low for low, _ in bounds],
            "upper": [high for _, high in bounds],
            "unbounded": COORDINATE_MAX,
            "exact": exact,
            "closed_form": kernels.posture is not None,
            "kernel_table": texts,
            "with_work": WITH_WORK,
            "cost_slope": kernels.model_cost if exact else kernels.slope_cost,
            "cost_model": kernels.model_cost,
            "projections": kernels.projections,
            "starts": STARTS,
            "budget_max": BUDGET_MAX,
            "pi": math.pi,
            "epsilon": EPSILON[real],
            "tolerance": tolerance if exact else max(tolerance, TOLERANCE_MIN),
            "enough": enough,
            "tie": tie,
            "rough": ROUGH[real],
            "probe": PROBES[real],
            "settling": SETTLING[real],
            "edge": EDGE,
            "margin_edge": MARGIN_EDGE[real] if many_rows else 0.0,
            "target_tolerance": TARGET_TOLERANCES[real] * EPSILON[real],
            "margin_tolerance": 4 * (MARGIN_EDGE[real] if many_rows else EDGE * EPSILON[real]),
            "angles": [int(unit == "rad") for unit in at.choice_units],
            "spare": [*_spare(plant, idle), *still],
            "base_idle": kernels.posture is None and all(idle),
        }
    )


def _idle(measures: Measures) -> list[bool]:
    """Whether each variable of the base leaves every w_i as it is: shifts do, and turns where the task turns along."""
    plant, rng = measures.plant, np.random.default_rng(0)

    def w(base: Array, posture: Array) -> Array:
        return measures.w.call([base, posture, plant.parameter_values])[0].full().ravel()

    base, posture = rng.uniform(0.2, 0.4, plant.n_base), rng.uniform(0.2, 0.4, plant.n_actuated)
    here, size = w(base, posture), measures.w.call([base, posture, plant.parameter_values])[1].full().ravel()
    moved = [w(base + 0.5 * np.eye(plant.n_base)[i], posture) for i in range(plant.n_base)]
    return [bool(np.all(np.abs(there - here) <= 1e-9 * size)) for there in moved]


def _spare(plant: Plant, idle: Sequence[bool]) -> list[int]:
    """1 for each idle variable of the base that other idle ones make up for as far as the end-point goes, else 0.

    A turn that the task does not follow changes every w_i: where only such a one makes up for a shift, both are needed.
    """
    at = [np.linspace(0.3, 0.4, count) for count in (plant.n_base, plant.n_actuated)]
    jacobian = plant.base_jacobian.call([*at, plant.parameter_values])[0].full()[:, : plant.n_base]
    kept = [i for i in range(plant.n_base) if idle[i]]
    for i in reversed(kept):
        others = [j for j in kept if j != i]
        if np.linalg.matrix_rank(jacobian[:, others]) == np.linalg.matrix_rank(jacobian[:, kept]):
            kept = others
    return [int(idle[i] and i not in kept) for i in range(plant.n_base)]


def _placing(plant: Plant) -> dict[str, Any]:
    """How the placement carries the machine along the task's rows: where the search tells what is out of reach.

    None of the rows where slides lengthen the arm.
    """
    machine = plant.machine
    rows, names = machine.task_rows, machine.base_coordinates
    lengthens = not plant.closed_form and bool(path_to_end_point(machine)[1])
    turns = "yaw" in names and {"x", "y"} <= set(rows)
    carried = [not lengthens and row in ("x", "y", "z") and (turns or "yaw" not in names or row == "z") for row in rows]
    shifts = [names.index(row) if row in names and row in ("x", "y", "z") else -1 for row in rows]
    rng = np.random.default_rng(0)
    own: Array = plant.parameter_values.full().ravel()

    def end_point(base: Array, posture: Array, p: Array) -> Array:
        return plant.end_point.call([plant.rest.call([base, posture, p])[0], base, p])[0].full().ravel()

    for _ in range(4):
        # Of other machines of the kind, too: parameters are an input.
        p: Array = (own + 0.01 * (own == 0.0)) * rng.uniform(0.9, 1.1, own.size)
        base, posture = rng.uniform(-1, 1, plant.n_base), rng.uniform(-1, 1, plant.n_actuated)
        at_origin, there = end_point(0 * base, posture, p), end_point(base, posture, p)
        expected = at_origin.copy()
        if turns:
            x, y, yaw = rows.index("x"), rows.index("y"), base[names.index("yaw")]
            turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
            expected[[x, y]] = turn @ at_origin[[x, y]]
        expected += [base[i] if i >= 0 else 0.0 for i in shifts]
        same = np.abs(there - expected) <= 1e-9 * (1 + np.abs(there))
        carried = [ok and bool(here) for ok, here in zip(carried, same, strict=True)]
    if turns and not all(carried[rows.index(row)] for row in "xy"):
        # Where one of both is not known, turns bring that into the other.
        carried = [ok and row == "z" for ok, row in zip(carried, rows, strict=True)]
    return {
        "placed_rows": [int(ok) for ok in carried],
        "shifted_by": shifts,
        "turned_by": names.index("yaw") if turns else -1,
        "turned_rows": [rows.index(row) if turns else -1 for row in "xy"],
    }


def _sampling(plant: Plant, kernels: OptimiserKernels) -> dict[str, Any]:
    """How the redundancy is sampled: in closed form placements and `units`, else all variables in their ranges."""
    machine = plant.machine
    if kernels.posture is not None:
        units = plant.n_actuated - 2
        dimensions, samples = units + 1, SURFACE_SAMPLES if units else CURVE_SAMPLES
        of_kind = {"step_max": 0.5, "projection_steps": 15, "units": units, "samples": samples, "rounds": 1}
    else:
        rows = [machine.task_rows.index(c) if c in machine.task_rows else -1 for c in machine.base_coordinates]
        dimensions = plant.n_base + plant.n_actuated
        of_kind = {"step_max": 0.8, "projection_steps": 8, "samples": SAMPLES, "rounds": ROUNDS}
        of_kind |= {"rows_of": [*rows, *[-1] * plant.n_actuated]}
    # low_discrepancy's first two points, one step apart.
    pair = low_discrepancy(dimensions, 2, 0)
    return of_kind | {"sample_steps": ((pair[:, 1] - pair[:, 0]) % 1.0).tolist()}
