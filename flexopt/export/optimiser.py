"""C text of the posture optimiser: `flexopt.selection`'s program solved on a controller.

In: a machine, its controller, what shall be constant. Out: declarations and one C source, made of the generated
kernels and the hand-written search of `templates/optimiser.c`. No heap, no recursion, bounded loops, memory owned by
the caller; each accepted iterate is feasible, so that the best so far can be used whenever time runs out.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np

from flexopt.errors import Fault
from flexopt.export.context import Context, build_context
from flexopt.export.kernels import Kernel, Real, kernel_text, single_precision
from flexopt.export.naming import constants, number, text_of
from flexopt.export.operations import Array
from flexopt.export.optimiser_kernels import OptimiserKernels, build_optimiser_kernels
from flexopt.export.parameters import parameter_range
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.boundary import TABLE
from flexopt.foundation.control import Control
from flexopt.foundation.quantities import COORDINATE_MAX
from flexopt.model import AnyMachine
from flexopt.model.problem import SINGULARITY_MARGIN_DEG, check_margin_deg, check_weights
from flexopt.plant.inverse_kinematics import low_discrepancy
from flexopt.plant.reach import path_to_end_point
from flexopt.robustness.measures import Measures, build_measures

# Own starts kept, and placements (or points of the redundancy) looked at for them, each elbow; where postures have no
# closed form, points of the whole range in each of so many rounds.
STARTS = 16
CURVE_SAMPLES, SURFACE_SAMPLES, SAMPLES, ROUNDS = 48, 96, 24, 4
BUDGET, BUDGET_MAX = 480, 1_000_000
EPSILON = {"double": 2.0**-52, "float": 2.0**-23}
# A climb ends at this stationarity, the same in V/scale as `flexopt.selection.check`'s; where rounding ends it
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


@dataclass(frozen=True)
class OptimiserSources:
    """The optimiser as text, to be put into a bundle.

    Attributes:
        header: declarations for the public header, without an include guard; needs nothing included.
        kernels_text: the generated functions, all static.
        search_text: what is written by hand and calls them; needs <math.h>, <stddef.h>, <stdint.h> and the header.
        workspace_size: name of the macro with the workspace's size in bytes, `sizeof` of the type of the workspace.
        documentation: what goes in, what comes out, what each status means.
        kernels: the Functions behind it.
        model_cost: cost of one step's derivatives in units of the budget, one evaluation of V.
        budget: default budget of a call.
        statuses: name -> value, without prefix.
    """

    header: str
    kernels_text: str
    search_text: str
    workspace_size: str
    documentation: str
    kernels: OptimiserKernels
    model_cost: int
    budget: int
    statuses: Mapping[str, int]

    @property
    def source(self) -> str:
        """Both texts: the C file after its includes."""
        return f"{self.kernels_text}\n{self.search_text}"


def build_optimiser(
    machine: AnyMachine,
    *,
    control: Control = "inverse",
    gravity: bool = False,
    weights: Sequence[float] | None = None,
    baked: bool = False,
    singularity_margin_deg: float = SINGULARITY_MARGIN_DEG,
    prefix: str = "flexopt",
    real: Real = "double",
    real_type: str | None = None,
    budget: int | None = None,
) -> OptimiserSources:
    """Write the optimiser of V(z) = Σ α_i w_i(z) subject to r(z) = target, bounds and the singularity margin.

    Target, bounds and margin are inputs of every call; so are α and p unless they are baked.

    Args:
        machine: from `flexopt.load`.
        control, gravity, singularity_margin_deg: as in `flexopt.build_selection`; the margin is the default of the
            generated problem.
        weights: α (m,) as constants; inputs by default.
        baked: the machine's own p as constants; inputs by default.
        prefix: of every public name, before `_optimiser_`.
        real: precision.
        real_type: name of the C type, `real` itself by default.
        budget: default budget of a call, in evaluations of V; by default what an emulated Cortex-M7 does within five
            million instructions.

    Raises:
        InputError: an argument is of the wrong kind or out of range, all in one message.
    """
    arguments = Arguments("build_optimiser")
    machine = TABLE["machine"](arguments, "machine", machine)
    arguments.done()
    control = arguments.control(control)
    arguments.flag("gravity", gravity)
    arguments.flag("baked", baked)
    margin = arguments.checked("singularity_margin_deg", singularity_margin_deg, check_margin_deg, 10.0)
    real = arguments.choice("real", real, ("double", "float"))
    if budget is not None:
        budget = arguments.checked("budget", budget, _check_budget, BUDGET)
    arguments.checked("prefix", prefix, _check_prefix, "flexopt")
    refusal = "" if arguments.faults else optimiser_refusal(machine)
    arguments.faults += [Fault("machine", refusal, machine.name)] * bool(refusal)
    arguments.done()
    at = build_context(
        machine, control=control, gain=1.0, single=real == "float", baked=baked, singularity_margin_deg=margin
    )
    measures = build_measures(machine, control, gravity)
    if gravity and not measures.plant.closed_form:
        sentence = "the optimiser takes the static deflection into account for planar machines only"
        arguments.faults.append(Fault("gravity", sentence, "True"))
        arguments.done()
    if weights is not None:
        alpha = arguments.checked("weights", weights, check_weights, (1.0,))
        if len(alpha) != measures.plant.n_passive:
            sentence = f"{machine.name} has {measures.plant.n_passive} modes, so as many weights are needed"
            arguments.faults.append(Fault("weights", sentence, str(tuple(weights))))
        arguments.done()
        weights = alpha
    kernels = build_optimiser_kernels(at, measures, weights=weights)
    text = kernel_text(kernels.functions, real, real_type or real)
    budget = budget or default_budget(kernels, real)
    values = _values(at, measures, kernels, text.kernels, weights is None, real, margin, budget)
    values |= {"p": f"{prefix}_optimiser", "P": f"{prefix}_optimiser".upper(), "real": real_type or real}
    header = _filled(_template("optimiser.h"), values, real)
    values |= {
        "DERIVATIVES": _template("optimiser_exact.c" if kernels.exact_second else "optimiser_differences.c"),
        "SAMPLING": _template("optimiser_sampled.c" if kernels.posture is None else "optimiser_closed_form.c"),
    }
    body = _calls(_filled(_template("optimiser.c"), values, real), text.kernels)
    enumerated = header[header.index("typedef enum") : header.index(f"}} {values['p']}_status")]
    statuses = {name: int(value) for name, value in re.findall(rf"{values['P']}_(\w+) = (\d+)", enumerated)}
    documentation = header[: header.index("*/") + 2] + "\n" + re.sub(r"(?s)^.*?(?=typedef enum)", "", header)
    return OptimiserSources(
        header=header,
        kernels_text=text.text,
        search_text=body,
        workspace_size=f"{values['P']}_WORKSPACE_SIZE",
        documentation=documentation,
        kernels=kernels,
        model_cost=kernels.model_cost,
        budget=budget,
        statuses=statuses,
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
    return BUDGET if kernels.exact_second else int(INSTRUCTIONS / (PER_OPERATION[real] * kernels.unit + PER_UNIT))


def _check_budget(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= BUDGET_MAX:
        raise ValueError(f"must be a whole number between 1 and {BUDGET_MAX}, in evaluations of V")
    return value


def _check_prefix(value: Any) -> str:
    if not isinstance(value, str) or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,40}", value):
        raise ValueError("must be a C identifier of at most 41 letters, digits and underscores")
    return value


def _template(name: str) -> str:
    return (files("flexopt.export") / "templates" / name).read_text(encoding="utf-8")


def _values(
    at: Context,
    measures: Measures,
    kernels: OptimiserKernels,
    texts: Mapping[str, Kernel],
    weights_at_run_time: bool,
    real: Real,
    margin_deg: float,
    budget: int,
) -> dict[str, str]:
    """What the templates leave open."""
    plant, machine = measures.plant, measures.plant.machine
    n_z = plant.n_base + plant.n_actuated
    units = [*machine.base_units, *machine.joint_units]
    names = [f"base.{c}" for c in machine.base_coordinates] + list(machine.joints)
    bounds = [(-COORDINATE_MAX, COORDINATE_MAX)] * plant.n_base
    bounds += [(max(low, -COORDINATE_MAX), min(high, COORDINATE_MAX)) for low, high in machine.limits]
    ranges = [parameter_range(parameter) for parameter in machine.parameters]
    idle = _idle(measures)
    tolerance, enough, tie = TOLERANCES[real]
    if not kernels.exact_second:
        tolerance = max(tolerance, TOLERANCE_MIN)
    sizes = {f"ARG_{name}": str(kernel.sz_arg) for name, kernel in texts.items()}
    sizes |= {f"RES_{name}": str(kernel.sz_res) for name, kernel in texts.items()}
    second = [("end_point_hessian", "@P@_N_TASK * "), ("sine_squared_hessian", "")]
    fields = [f"  @real@ {name}[{rows}@P@_N_Z * @P@_N_Z];\n" for name, rows in second]
    return sizes | _sampling(measures, kernels, real) | {
        "MACHINE": text_of(machine.name),
        "CONTROL": f"Jacobian {measures.control}",
        "GRAVITY": ", under static deflection" if measures.gravity else "",
        "VARIABLES": ", ".join(map(text_of, names)),
        "INDICES": ",\n".join(f"    @P@_{name} = {k}" for k, name in enumerate(constants(names))),
        "N_Z": str(n_z),
        "N_B": str(plant.n_base),
        "N_TASK": str(plant.n_task),
        "N_MODES": str(plant.n_passive),
        "N_P": str(len(plant.parameter_names)),
        "N_HELD": str(max(1, kernels.hold.size1_out(0))),
        "N_WORK": str(max(1, *(kernel.sz_w for kernel in texts.values()))),
        "SECOND": "".join(fields) if kernels.exact_second else "",
        **_eigenvectors(kernels, plant.n_passive),
        "HESSIAN": "exact Hessian" if kernels.exact_second else "Hessian by differences of exact slopes",
        "COST_SLOPE": str(kernels.model_cost if kernels.exact_second else kernels.slope_cost),
        "BASE_IDLE": str(int(kernels.posture is None and all(idle))),
        "ROUGH": number(ROUGH[real], real),
        "MARGIN_EDGE": number(MARGIN_EDGE[real], real) if plant.n_task > 3 else "EDGE",
        "PROJECTIONS": str(kernels.projections),
        "ROUNDS": str(ROUNDS) if kernels.posture is None else "1",
        "SPARE": ", ".join(map(str, [*_spare(measures, idle), *[0] * plant.n_actuated])),
        "PROBE": number(PROBES[real], real),
        "ANGLES": ", ".join(str(int(unit == "rad")) for unit in units),
        "WEIGHTS_AT_RUN_TIME": str(int(weights_at_run_time)),
        "PARAMETERS_AT_RUN_TIME": str(int(not at.baked)),
        "PARAMETERS": ", ".join(map(text_of, plant.parameter_names)),
        "STARTS": str(STARTS),
        "COST_MODEL": str(kernels.model_cost),
        "BUDGET": str(budget),
        "BUDGET_MAX": str(BUDGET_MAX),
        "MARGIN_DEG": f"{margin_deg:g}",
        "SINE_SQUARED_MIN": number(math.sin(math.radians(margin_deg)) ** 2, real),
        "LOWER": ", ".join(number(low, real) for low, _ in bounds),
        "UPPER": ", ".join(number(high, real) for _, high in bounds),
        "P_LOW": ", ".join(number(low, real) for low, _ in ranges),
        "P_HIGH": ", ".join(number(high, real) for _, high in ranges),
        "P_VALUES": ", ".join(number(parameter.value, real) for parameter in machine.parameters),
        "PI": number(math.pi, real),
        "TWO_PI": number(2 * math.pi, real),
        "EPSILON": number(EPSILON[real], real),
        "TOLERANCE": number(tolerance, real),
        "STATIONARY_ENOUGH": number(enough, real),
        "TIE": number(tie, real),
        "SETTLING": str(SETTLING[real]),
        "TARGET_TOLERANCE": number(TARGET_TOLERANCES[real] * EPSILON[real], real),
        "MARGIN_TOLERANCE": number(4 * (MARGIN_EDGE[real] if plant.n_task > 3 else EDGE * EPSILON[real]), real),
        "EDGE": f"{EDGE}.0",
        "FIXED_ROWS": ", ".join(map(str, _fixed_rows(measures))),
    }  # fmt: skip


def _idle(measures: Measures) -> list[bool]:
    """Whether each variable of the base leaves every w_i as it is: shifts do, and turns where the task turns along."""
    plant, rng = measures.plant, np.random.default_rng(0)

    def w(base: Array, posture: Array) -> Array:
        return measures.w.call([base, posture, plant.parameter_values])[0].full().ravel()

    base, posture = rng.uniform(0.2, 0.4, plant.n_base), rng.uniform(0.2, 0.4, plant.n_actuated)
    here, size = w(base, posture), measures.w.call([base, posture, plant.parameter_values])[1].full().ravel()
    moved = [w(base + 0.5 * np.eye(plant.n_base)[i], posture) for i in range(plant.n_base)]
    return [bool(np.all(np.abs(there - here) <= 1e-9 * size)) for there in moved]


def _spare(measures: Measures, idle: Sequence[bool]) -> list[int]:
    """1 for each idle variable of the base that the others make up for as far as the end-point goes, else 0."""
    plant = measures.plant
    at = [np.linspace(0.3, 0.4, count) for count in (plant.n_base, plant.n_actuated)]
    jacobian = plant.base_jacobian.call([*at, plant.parameter_values])[0].full()[:, : plant.n_base]
    kept = list(range(plant.n_base))
    for i in reversed(range(plant.n_base)):
        others = [j for j in kept if j != i]
        if idle[i] and np.linalg.matrix_rank(jacobian[:, others]) == np.linalg.matrix_rank(jacobian[:, kept]):
            kept = others
    return [int(i not in kept) for i in range(plant.n_base)]


def _fixed_rows(measures: Measures) -> list[int]:
    """1 for each row of the task in which no placement moves the arm and no slide or deflection lengthens it."""
    plant, machine = measures.plant, measures.plant.machine
    if measures.gravity or (not plant.closed_form and path_to_end_point(machine)[1]):
        return [0] * plant.n_task
    turns = "rad" in machine.base_units
    moved = {*machine.base_coordinates, *("x", "y") * turns}
    return [int(row in ("x", "y", "z") and row not in moved) for row in machine.task_rows]


def _eigenvectors(kernels: OptimiserKernels, modes: int) -> dict[str, str]:
    """How the eigenvectors of one point are handed to the next one, where iterations start from them."""
    if kernels.exact_second:
        return dict.fromkeys(("NEAR", "NEXT", "REMEMBER", "FORGET", "NEAR_FIELDS"), "")
    size = modes * modes
    loop = f"  for (int i = 0; i < {size}; i++) {{\n    s->near[i] = {{}};\n  }}\n"
    return {
        "NEAR": ", s->near",
        "NEXT": ", s->next",
        "REMEMBER": loop.replace("{}", "s->next[i]"),
        "FORGET": loop.replace("{}", f"((i % {modes + 1}) == 0) ? R(1.0) : R(0.0)"),
        "NEAR_FIELDS": f"  @real@ near[{size}];\n  @real@ next[{size}];\n",
    }


def _sampling(measures: Measures, kernels: OptimiserKernels, real: Real) -> dict[str, str]:
    """How the redundancy is sampled: in closed form placements and `units`, else all variables in their ranges."""
    plant, machine = measures.plant, measures.plant.machine
    if kernels.posture is not None:
        units = plant.n_actuated - 2
        of_kind = {"STEP_MAX": number(0.5, real), "PROJECTION_STEPS": "15"}
        of_kind |= {"UNITS": str(units), "SAMPLES": str(SURFACE_SAMPLES if units else CURVE_SAMPLES)}
        dimensions = units + 1
    else:
        rows = [machine.task_rows.index(c) if c in machine.task_rows else -1 for c in machine.base_coordinates]
        # Longer steps and fewer of them, as each costs many times more.
        of_kind = {
            "STEP_MAX": number(0.8, real),
            "PROJECTION_STEPS": "8",
            "SAMPLES": str(SAMPLES),
            "ROWS_OF": ", ".join(map(str, [*rows, *[-1] * plant.n_actuated])),
        }
        dimensions = plant.n_base + plant.n_actuated
    # low_discrepancy's first two points, one step apart.
    pair = low_discrepancy(dimensions, 2, 0)
    return of_kind | {"STEPS": ", ".join(number(s, real) for s in (pair[:, 1] - pair[:, 0]) % 1.0)}


def _filled(template: str, values: Mapping[str, str], real: Real) -> str:
    """The template with its places filled and its constants and functions in the precision."""
    text = template
    for _ in range(3):  # some values have places themselves
        text = re.sub(r"@(\w+)@", lambda match: values[match[1]], text)
    text = re.sub(r"\bR\(([^()]+)\)", r"\1", text)
    return single_precision(text) if real == "float" else text


def _calls(text: str, kernels: Mapping[str, Kernel]) -> str:
    """Calls of the kernels with the parameters that each takes."""

    def call(match: re.Match[str]) -> str:
        kernel = kernels[match[1]]
        passed = {"arg": match[2], "res": match[3], "w": "s->work"}
        if not set(kernel.parameters) <= set(passed):
            raise ValueError(f"{kernel.name}: needs whole numbers to work on")
        unused = "".join(f"(void){passed[name]}; " for name in ("arg", "res") if name not in kernel.parameters)
        return f"{unused}(void){kernel.name}({', '.join(passed[name] for name in kernel.parameters)});"

    return re.sub(r"\(void\)KERNEL_(\w+)\((\w+), (\w+)\);", call, text)
