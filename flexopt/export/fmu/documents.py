"""What an FMU carries for its reader: a page, and the reference trajectory.

In: an `FmuModel`. Out: texts.
"""

from __future__ import annotations

from collections.abc import Mapping
from string import Template

import numpy as np

from flexopt.export.fmu.model import FmuModel
from flexopt.export.fmu.source import Version, template
from flexopt.export.fmu.variable import Variable
from flexopt.foundation.arrays import Vector
from flexopt.foundation.escapes import markup


def reference_table(model: FmuModel) -> str:
    """Time, inputs and outputs at every sample; the columns are named as the variables."""
    run = model.run
    inputs = [_column(model, variable) for variable in model.inputs]
    outputs = [run.q, run.v, run.end_point, run.error, run.torque, run.energy[:, None], run.deflection]
    table = np.column_stack([run.time, *inputs, *outputs])
    names = ["time", *(v.name for v in model.inputs), *(v.name for v in model.outputs)]
    quoted = [f'"{name.replace(chr(34), chr(34) * 2)}"' if set(name) & set(',"') else name for name in names]
    rows = [",".join(map(repr, row)) for row in table.tolist()]
    return "\n".join([",".join(quoted), *rows]) + "\n"


def _column(model: FmuModel, variable: Variable) -> Vector:
    """An input at every sample of the run; a rate is that of the sample which begins."""
    run, machine = model.run, model.scenario.machine
    group, _, axis = variable.name.partition(".")
    names, points = {
        "placement": (machine.base_coordinates, run.base),
        "target": (machine.task_rows, run.target),
    }.get(group, ((), run.base))
    if not names:
        return np.zeros(len(run.time))
    column: Vector = points[:, names.index(axis.removesuffix("_rate"))]
    if axis.endswith("_rate"):
        rates = np.diff(column) / model.scenario.period
        return np.append(rates, rates[-1])
    return column


def page(model: FmuModel, version: Version, tool: str) -> str:
    """`index.html`: what the FMU is, and its variables."""
    machine = model.scenario.machine

    def rows(variables: tuple[Variable, ...], *, start: bool) -> str:
        return "\n".join(
            f"<tr><td><code>{markup(v.name)}</code></td><td>{markup(v.unit)}</td><td>{markup(v.text)}</td>"
            + (f"<td>{v.start:g}</td><td>{v.low:g} … {v.high:g}</td>" if start else "")
            + "</tr>"
            for v in variables
        )

    values: Mapping[str, str] = {
        "name": markup(machine.name),
        "about": markup(machine.description),
        "version": version,
        "kind": model.kind,
        "period": f"{model.scenario.period:g}",
        "control": model.scenario.options.control,
        "feedback": model.scenario.options.feedback,
        "sha256": machine.content_hash,
        "tool": tool,
        "parameters": rows(model.parameters, start=True),
        "inputs": rows(model.inputs, start=True),
        "outputs": rows(model.outputs, start=False),
        "calculated": rows(model.calculated, start=False),
        "advances": template(f"{model.kind}.html"),
    }
    advances = Template(values["advances"]).substitute(period=values["period"])
    return Template(template("index.html")).substitute({**values, "advances": advances})
