"""The C text of an FMU: one file that holds the model's tables, the generated kernels, and the interface.

In: an `FmuModel`. Out: the text of `sources/fmu.c`, without the identity that only the whole text can give.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from string import Template
from typing import Literal

import casadi as ca

from flexopt.export.fmu.model import FmuModel
from flexopt.export.fmu.variable import Variable
from flexopt.export.kernels import Kernel, kernel_text
from flexopt.export.naming import text_of, wrapped

Version = Literal["2.0", "3.0"]
VERSIONS: tuple[Version, ...] = ("2.0", "3.0")

_HEAD = """#include <math.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
"""
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
    sizes = {
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
    lines = [f"#define {name} {value}" for name, value in sizes.items()]
    lines.append(f"#define SAMPLE_PERIOD {model.scenario.period!r}")
    lines.append(f"#define RESIDUAL_MAX {model.residual_max!r}")
    lines += _tables("parameter", model.parameters)
    tunable = ", ".join(str(int(variable.tunable)) for variable in model.parameters)
    lines.append(_table("unsigned char parameter_tunable", len(model.parameters), tunable))
    lines += _tables("input", model.inputs)
    if exchange:
        lines.append(_numbers("state_nominal", [variable.nominal for variable in model.states]))
    else:
        lines.append(_table("int input_rate", len(model.inputs), ", ".join(map(str, model.rate_of))))
    lines.append(_texts("output_name", [variable.name for variable in model.outputs]))
    lines.append(_numbers("guard_low", [guard.low for guard in model.guards]))
    lines.append(_numbers("guard_high", [guard.high for guard in model.guards]))
    lines.append(_texts("guard_text", [guard.text for guard in model.guards]))
    wrappers = [_wrapper(function, text.kernels[function.name()]) for function in model.functions]
    return "\n".join([*lines, "", text.text, *wrappers])


def source(version: Version, title: str, content: str, token: str, key: int) -> str:
    """The whole file.

    Args:
        version: of FMI.
        title: one line.
        content: from `body`.
        token: identifies the model, as the description has it.
        key: 64 bits that states of this model carry.
    """
    identity = f'#define MODEL_TOKEN "{token}"\n#define MODEL_KEY 0x{key:016x}ULL\n'
    interface = Template(template(f"fmi{version[0]}.c")).substitute(common=template("common.c"))
    return f"/* {text_of(title)} */\n\n{_HEAD}\n{identity}{content}\n{interface}"


def template(file: str) -> str:
    """A template of this folder as it stands."""
    return files("flexopt.export.fmu").joinpath("templates").joinpath(file).read_text(encoding="utf-8")


def _wrapper(function: ca.Function, kernel: Kernel) -> str:
    """A C function with one pointer for each input and output, and the workspace."""
    name, inputs, outputs = _WRAPPERS[function.name()]
    parameters = [f"const double *{i}" for i in inputs] + [f"double *{o}" for o in outputs]
    lines = [f"static void {name}({', '.join(parameters)}, double *w) {{"]
    used = kernel.parameters
    if "arg" in used:
        lines.append(f"  const double *arg[{kernel.sz_arg}] = {{{', '.join(inputs)}}};")
    if "res" in used:
        lines.append(f"  double *res[{kernel.sz_res}] = {{{', '.join(outputs)}}};")
    if "iw" in used:
        lines.append(f"  int iw[{max(1, kernel.sz_iw)}];")
    if "w" not in used:
        lines.append("  (void)w;")
    return "\n".join([*lines, f"  (void){kernel.name}({', '.join(used)});", "}", ""])


def _tables(group: str, variables: Sequence[Variable]) -> list[str]:
    return [
        _texts(f"{group}_name", [variable.name for variable in variables]),
        _numbers(f"{group}_start", [variable.start for variable in variables]),
        _numbers(f"{group}_low", [variable.low for variable in variables]),
        _numbers(f"{group}_high", [variable.high for variable in variables]),
    ]


def _numbers(name: str, values: Sequence[float]) -> str:
    return _table(f"double {name}", len(values), ", ".join(map(_number, values)))


def _number(value: float) -> str:
    if value in (float("inf"), float("-inf")):
        return "HUGE_VAL" if value > 0 else "-HUGE_VAL"
    return repr(float(value))


def _texts(name: str, texts: Sequence[str]) -> str:
    lines = ",\n".join(f'  "{text_of(text)}"' for text in texts)
    return f"static const char *const {name}[{len(texts)}] = {{\n{lines}\n}};"


def _table(declaration: str, size: int, entries: str) -> str:
    return f"static const {declaration}[{size}] = {{\n{wrapped(entries, '  ')}\n}};"
