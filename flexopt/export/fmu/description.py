"""`modelDescription.xml` of an FMU, for FMI 2.0 and 3.0.

In: an `FmuModel` and its identity. Out: the text. Value references are those of `source.references`.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from xml.etree import ElementTree as ET

from flexopt.export.fmu.model import FmuModel, dependencies
from flexopt.export.fmu.source import Version, references
from flexopt.export.fmu.units import unit_of
from flexopt.export.fmu.variable import Variable
from flexopt.foundation.documents import package_version
from flexopt.foundation.escapes import one_line

_LOG = {"logStatusError": "what was refused, and why", "logStatusWarning": "what needs care"}
_TIME = Variable("time", "s", "simulation time")


@dataclass(frozen=True)
class _Entry:
    """A variable with its place in the description."""

    variable: Variable
    reference: int
    causality: str
    variability: str
    initial: str = ""
    derivative_of: int = 0  # value reference of the state


def describe(model: FmuModel, version: Version, identifier: str, token: str, tool: str) -> str:
    """The description's text.

    Args:
        model: what the FMU computes.
        version: of FMI.
        identifier: name of the library, a C name.
        token: of the library.
        tool: who wrote it.
    """
    entries, three = _entries(model), version == "3.0"
    machine, exchange = model.scenario.machine, model.kind == "model-exchange"
    names = [entry.variable.name for entry in entries]
    served = f"; {model.served.sentence}" if model.served else ""
    root = ET.Element("fmiModelDescription", {
        "fmiVersion": version,
        "modelName": one_line(machine.name),
        "instantiationToken" if three else "guid": token,
        "description": one_line(f"Closed loop of {machine.name} and its task-space controller{served}"),
        "version": package_version("flexopt"),
        "generationTool": tool,
        "variableNamingConvention": "structured" if all(map(_is_structured, names)) else "flat",
    })  # fmt: skip
    if not three:
        root.set("numberOfEventIndicators", "0")
    kind = ET.SubElement(root, "ModelExchange" if exchange else "CoSimulation", {"modelIdentifier": identifier})
    state = "FMUState" if three else "FMUstate"
    kind.set(f"canGetAndSet{state}", "true")
    kind.set(f"canSerialize{state}", "true")
    if not exchange:
        kind.set("canHandleVariableCommunicationStepSize", "true")
        if three:
            kind.set("fixedInternalStepSize", repr(model.scenario.period))
    if not three:
        ET.SubElement(ET.SubElement(kind, "SourceFiles"), "File", {"name": "fmu.c"})
    _units(root, entries)
    categories = ET.SubElement(root, "LogCategories")
    for name, text in _LOG.items():
        ET.SubElement(categories, "Category", {"name": name, "description": text})
    times = {"startTime": 0.0, "stopTime": float(model.scenario.times[-1]), "stepSize": model.scenario.period}
    ET.SubElement(root, "DefaultExperiment", {name: repr(value) for name, value in times.items()})
    variables = ET.SubElement(root, "ModelVariables")
    for entry in entries:
        (_variable_3 if three else _variable_2)(variables, entry, entries)
    _structure(ET.SubElement(root, "ModelStructure"), model, entries, three=three)
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def build_description(identifier: str) -> str:
    """`sources/buildDescription.xml` of FMI 3.0."""
    root = ET.Element("fmiBuildDescription", {"fmiVersion": "3.0"})
    build = ET.SubElement(root, "BuildConfiguration", {"modelIdentifier": identifier})
    files = ET.SubElement(build, "SourceFileSet", {"language": "C99"})
    ET.SubElement(files, "SourceFile", {"name": "fmu.c"})
    ET.SubElement(build, "Library", {"name": "m"})
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _is_structured(name: str) -> bool:
    word = r"[A-Za-z_]\w*(\[\d+\])?"
    return re.fullmatch(rf"der\({word}(\.{word})*\)|{word}(\.{word})*", name, re.ASCII) is not None


def _entries(model: FmuModel) -> list[_Entry]:
    first = references(model)
    found = [_Entry(_TIME, 0, "independent", "continuous")]
    for k, variable in enumerate(model.parameters):
        variability = "tunable" if variable.tunable else "fixed"
        found.append(_Entry(variable, first["PARAMETER"] + k, "parameter", variability, "exact"))
    found += [_Entry(v, first["INPUT"] + k, "input", "continuous") for k, v in enumerate(model.inputs)]
    found += [_Entry(v, first["OUTPUT"] + k, "output", "continuous", "calculated") for k, v in enumerate(model.outputs)]
    found += [
        _Entry(v, first["CALCULATED"] + k, "calculatedParameter", "fixed", "calculated")
        for k, v in enumerate(model.calculated)
    ]
    if model.kind == "model-exchange":
        for k, v in enumerate(model.states):
            found.append(_Entry(v, first["STATE"] + k, "local", "continuous", "calculated"))
        for k, v in enumerate(model.states):
            rate = Variable(f"der({v.name})", _per_second(v.unit), f"rate of {v.name}")
            of = first["STATE"] + k
            found.append(_Entry(rate, first["DERIVATIVE"] + k, "local", "continuous", "calculated", derivative_of=of))
    return found


def _per_second(unit: str) -> str:
    """The unit of a rate."""
    if not unit:
        return ""
    return unit.removesuffix("/s") + "/s²" if unit.endswith("/s") else f"{unit}/s"


def _units(root: ET.Element, entries: list[_Entry]) -> None:
    units = {unit.name: unit for entry in entries if entry.variable.unit for unit in [unit_of(entry.variable.unit)]}
    definitions = ET.SubElement(root, "UnitDefinitions")
    for name in sorted(units):
        exponents = {base: str(power) for base, power in units[name].exponents.items()}
        ET.SubElement(ET.SubElement(definitions, "Unit", {"name": name}), "BaseUnit", exponents)


def _real(entry: _Entry) -> dict[str, str]:
    """Unit, range and start."""
    variable, found = entry.variable, dict[str, str]()
    if variable.unit:
        found["unit"] = unit_of(variable.unit).name
    for name, value in (("min", variable.low), ("max", variable.high)):
        if math.isfinite(value):
            found[name] = repr(value)
    if entry.causality in {"parameter", "input"}:
        found["start"] = repr(variable.start)
    if variable.nominal != 1.0:
        found["nominal"] = repr(variable.nominal)
    return found


def _common(entry: _Entry) -> dict[str, str]:
    found = {
        "name": entry.variable.name,
        "valueReference": str(entry.reference),
        "description": entry.variable.text,
        "causality": entry.causality,
        "variability": entry.variability,
    }
    return found | ({"initial": entry.initial} if entry.initial else {})


def _variable_2(parent: ET.Element, entry: _Entry, entries: list[_Entry]) -> None:
    scalar = ET.SubElement(parent, "ScalarVariable", _common(entry))
    real = ET.SubElement(scalar, "Real", _real(entry))
    if entry.derivative_of:
        index = next(i for i, other in enumerate(entries, 1) if other.reference == entry.derivative_of)
        real.set("derivative", str(index))


def _variable_3(parent: ET.Element, entry: _Entry, _: list[_Entry]) -> None:
    variable = ET.SubElement(parent, "Float64", _common(entry) | _real(entry))
    if entry.derivative_of:
        variable.set("derivative", str(entry.derivative_of))


def _structure(parent: ET.Element, model: FmuModel, entries: list[_Entry], *, three: bool) -> None:
    """Which unknowns there are, and on which inputs and states they depend."""
    first, exchange = references(model), model.kind == "model-exchange"
    index = {entry.reference: i for i, entry in enumerate(entries, 1)}

    def place(reference: int) -> str:
        return str(reference if three else index[reference])

    def knowns(row: list[list[int]]) -> str:
        states, inputs = row
        exposed = [first["STATE"] + k for k in states] if exchange else []
        return " ".join(place(r) for r in sorted([*exposed, *(first["INPUT"] + k for k in inputs)]))

    key = "valueReference" if three else "index"
    groups = {"Outputs": ("Output", first["OUTPUT"], model.show)}
    if exchange:
        groups["Derivatives"] = ("ContinuousStateDerivative", first["DERIVATIVE"], model.rates)
    for group, (element, start, function) in groups.items():
        where = parent if three else ET.SubElement(parent, group)
        for k, row in enumerate(dependencies(function, 0, (0, 1))):
            attributes = {key: place(start + k), "dependencies": knowns(row)}
            ET.SubElement(where, element if three else "Unknown", attributes)
    where = parent if three else ET.SubElement(parent, "InitialUnknowns")
    for entry in entries:
        if entry.initial == "calculated":
            ET.SubElement(where, "InitialUnknown" if three else "Unknown", {key: place(entry.reference)})
