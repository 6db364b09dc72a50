"""What an FMU carries for its reader: a page, and the reference trajectory.

In: an `FmuModel`. Out: texts.
"""

from __future__ import annotations

import numpy as np

from flexopt.export.fmu.model import FmuModel
from flexopt.export.fmu.source import Version
from flexopt.export.fmu.variable import Variable
from flexopt.foundation.arrays import Vector
from flexopt.foundation.rendering import render


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
    scenario = model.scenario
    title = f"{scenario.machine.name}: closed loop"
    return render(
        "export/fmu/templates/index.html", title=title, model=model, scenario=scenario, version=version, tool=tool
    )
