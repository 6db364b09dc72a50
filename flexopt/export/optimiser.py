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

from flexopt.errors import Fault
from flexopt.export.kernels import Kernel, Real, kernel_text, single_precision
from flexopt.export.naming import constants, number, text_of
from flexopt.export.optimiser_kernels import OptimiserKernels, build_optimiser_kernels
from flexopt.export.parameters import parameter_range
from flexopt.model import Machine
from flexopt.model.arguments import Arguments
from flexopt.model.problem import SINGULARITY_MARGIN_DEG, Control, check_margin_deg, check_weights
from flexopt.model.quantities import COORDINATE_MAX
from flexopt.plant.inverse_kinematics import low_discrepancy
from flexopt.robustness.measures import Measures, build_measures

# Own starts kept, and placements (or points of the redundancy) looked at for them, each elbow.
STARTS = 8
CURVE_SAMPLES, SURFACE_SAMPLES = 48, 96
# A unit costs an emulated Cortex-M7 10,240 instructions at most for the excavator (benchmarks/optimiser.py).
BUDGET, BUDGET_MAX = 480, 1_000_000
EPSILON = {"double": 2.0**-52, "float": 2.0**-23}
# A climb ends at this stationarity, the same in V/scale as `flexopt.selection.check`'s; where rounding ends it
# earlier, the second number still counts as stationary. Values of V/scale closer than the third are equal.
TOLERANCES = {"double": (1e-8, 1e-6, 1e-9), "float": (1e-4, 3e-3, 1e-6)}


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
        statuses: name -> value, without prefix.
    """

    header: str
    kernels_text: str
    search_text: str
    workspace_size: str
    documentation: str
    kernels: OptimiserKernels
    model_cost: int
    statuses: Mapping[str, int]

    @property
    def source(self) -> str:
        """Both texts: the C file after its includes."""
        return f"{self.kernels_text}\n{self.search_text}"


def build_optimiser(
    machine: Machine,
    *,
    control: Control = "inverse",
    gravity: bool = False,
    weights: Sequence[float] | None = None,
    baked: bool = False,
    singularity_margin_deg: float = SINGULARITY_MARGIN_DEG,
    prefix: str = "flexopt",
    real: Real = "double",
    real_type: str | None = None,
    budget: int = BUDGET,
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
        budget: default budget of a call, in evaluations of V.

    Raises:
        InputError: an argument is of the wrong kind or out of range, all in one message.
    """
    arguments = Arguments("build_optimiser")
    machine = arguments.planar(machine)
    control = arguments.control(control)
    arguments.flag("gravity", gravity)
    arguments.flag("baked", baked)
    margin = arguments.checked("singularity_margin_deg", singularity_margin_deg, check_margin_deg, 10.0)
    real = arguments.choice("real", real, ("double", "float"))
    budget = arguments.checked("budget", budget, _check_budget, BUDGET)
    arguments.checked("prefix", prefix, _check_prefix, "flexopt")
    if len(machine.joints) < 2:
        arguments.faults.append(Fault("machine", "the optimiser needs two actuated joints or more", machine.name))
    arguments.done()
    measures = build_measures(machine, control, gravity)
    if (measures.plant.n_base, measures.plant.n_task) != (1, 2):
        sentence = "the optimiser takes planar machines: its own starts need their inverse kinematics in closed form"
        arguments.faults.append(Fault("machine", sentence, machine.name))
        arguments.done()
    if weights is not None:
        alpha = arguments.checked("weights", weights, check_weights, (1.0,))
        if len(alpha) != measures.plant.n_passive:
            sentence = f"{machine.name} has {measures.plant.n_passive} modes, so as many weights are needed"
            arguments.faults.append(Fault("weights", sentence, str(tuple(weights))))
        arguments.done()
        weights = alpha
    kernels = build_optimiser_kernels(measures, weights=weights, baked=baked)
    text = kernel_text(kernels.functions, real, real_type or real)
    values = _values(measures, kernels, weights is None, baked, real, margin, budget)
    values |= {"p": f"{prefix}_optimiser", "P": f"{prefix}_optimiser".upper(), "real": real_type or real}
    header = _filled(_template("optimiser.h"), values, real)
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
        statuses=statuses,
    )


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
    measures: Measures,
    kernels: OptimiserKernels,
    weights_at_run_time: bool,
    baked: bool,
    real: Real,
    margin_deg: float,
    budget: int,
) -> dict[str, str]:
    """What the templates leave open."""
    plant, machine = measures.plant, measures.plant.machine
    n_z, units = plant.n_base + plant.n_actuated, plant.n_actuated - 2
    names = [f"base.{c}" for c in machine.base_coordinates] + list(machine.joints)
    bounds = [(-COORDINATE_MAX, COORDINATE_MAX)] * plant.n_base
    bounds += [(max(low, -COORDINATE_MAX), min(high, COORDINATE_MAX)) for low, high in machine.limits]
    ranges = [parameter_range(parameter) for parameter in machine.parameters]
    tolerance, enough, tie = TOLERANCES[real]
    # low_discrepancy's first two points, one step apart.
    pair = low_discrepancy(units + 1, 2, 0)
    steps = (pair[:, 1] - pair[:, 0]) % 1.0
    return {
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
        "N_HELD": str(max(1, measures.held.shape[0])),
        "WEIGHTS_AT_RUN_TIME": str(int(weights_at_run_time)),
        "PARAMETERS_AT_RUN_TIME": str(int(not baked)),
        "PARAMETERS": ", ".join(map(text_of, plant.parameter_names)),
        "STARTS": str(STARTS),
        "UNITS": str(units),
        "SAMPLES": str(SURFACE_SAMPLES if units else CURVE_SAMPLES),
        "STEPS": ", ".join(number(s, real) for s in steps),
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
    }


def _filled(template: str, values: Mapping[str, str], real: Real) -> str:
    """The template with its places filled and its constants and functions in the precision."""
    text = template
    for _ in range(2):  # some values have places themselves
        text = re.sub(r"@(\w+)@", lambda match: values[match[1]], text)
    text = re.sub(r"\bR\(([^()]+)\)", r"\1", text)
    return single_precision(text) if real == "float" else text


def _calls(text: str, kernels: Mapping[str, Kernel]) -> str:
    """Calls of the kernels with the parameters that each takes."""

    def call(match: re.Match[str]) -> str:
        kernel = kernels[match[1]]
        passed = {"arg": match[2], "res": match[3]}
        if not set(kernel.parameters) <= set(passed):
            raise ValueError(f"{kernel.name}: needs a work vector")  # SX graphs have none
        unused = "".join(f"(void){passed[name]}; " for name in passed if name not in kernel.parameters)
        return f"{unused}(void){kernel.name}({', '.join(passed[name] for name in kernel.parameters)});"

    return re.sub(r"\(void\)KERNEL_(\w+)\((\w+), (\w+)\);", call, text)
