"""The C text of an FMU: one file that holds the model's tables, the generated kernels, and the interface.

In: an `FmuModel`. Out: the text of `sources/fmu.c`, without the identity that only the whole text can give.
"""

from __future__ import annotations

from typing import Literal

from flexopt.export.fmu.model import FmuModel
from flexopt.export.kernels import kernel_text
from flexopt.export.naming import wrapped
from flexopt.foundation.rendering import render

Version = Literal["2.0", "3.0"]
VERSIONS: tuple[Version, ...] = ("2.0", "3.0")

# The kernels' inputs and outputs as arguments of the wrappers: name of the Function -> wrapper, arguments.
_WRAPPERS = {
    "setup": ("compute_setup", ("a",), ("c", "x", "point", "guards")),
    "show": ("compute_outputs", ("x", "i", "c"), ("y",)),
    "sample": ("compute_step", ("x", "i", "c"), ("x_next", "residual")),
    "rates": ("compute_rates", ("x", "i", "c"), ("x_rate",)),
}


def references(model: FmuModel) -> dict[str, int]:
    """First value reference of each group of variables; that of the time is 0."""
    exposed = len(model.states) if model.kind == "model-exchange" else 0
    groups = {"INPUT": len(model.parameters), "OUTPUT": len(model.inputs), "CALCULATED": len(model.outputs),
              "STATE": len(model.calculated), "DERIVATIVE": exposed}  # fmt: skip
    found, at = {"PARAMETER": 1}, 1
    for name, before in groups.items():
        at += before
        found[name] = at
    return found


def body(model: FmuModel) -> str:
    """Tables, kernels and their wrappers: all that depends on the model.

    Raises:
        Unsupported: a Function contains what cannot be generated.
    """
    text = kernel_text(model.functions, "double", "double")
    exchange = model.kind == "model-exchange"
    widest = max(kernel.sz_w for kernel in text.kernels.values())
    sizes: dict[str, int | str] = {
        "MODEL_EXCHANGE": int(exchange),
        "N_PARAMETERS": len(model.parameters),
        "N_VALUES": model.n_values,
        "N_INPUTS": len(model.inputs),
        "N_OUTPUTS": len(model.outputs),
        "N_CALCULATED": len(model.calculated),
        "N_STATES": len(model.states),
        "N_DERIVATIVES": len(model.states) if exchange else 0,
        "N_CONSTANTS": model.loop.constants.total,
        "N_GUARDS": len(model.guards),
        "N_WORK": max(1, widest),
        "N_PLACEMENT_INPUTS": len(model.moving),
    }
    sizes |= {f"FIRST_{name}": at for name, at in references(model).items() if name != "PARAMETER"}
    sizes |= {"SAMPLE_PERIOD": repr(model.scenario.period), "RESIDUAL_MAX": repr(model.residual_max)}
    wrappers = [(*_WRAPPERS[f.name()], text.kernels[f.name()]) for f in model.functions]
    return render(
        "export/fmu/templates/model.c", sizes=sizes, model=model, kernels=text.text, wrappers=wrappers, wrapped=wrapped,
        real=_real,
    )  # fmt: skip


def source(version: Version, title: str, content: str, token: str, key: int) -> str:
    """The whole file.

    Args:
        version: of FMI.
        title: one line.
        content: from `body`.
        token: identifies the model, as the description has it.
        key: 64 bits that states of this model carry.
    """
    file = "export/fmu/templates/fmu.c"
    return render(file, version=version, title=title, content=content, token=token, key=key)


def _real(value: float) -> str:
    if value in (float("inf"), float("-inf")):
        return "HUGE_VAL" if value > 0 else "-HUGE_VAL"
    return repr(float(value))
