"""A bundle as a shared library, called from Python by ctypes."""

from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

from flexopt.export import ExportReport


class BundleLibrary:
    """The C functions of one bundle, by their names without the prefix."""

    def __init__(self, report: ExportReport, folder: Path) -> None:
        self.manifest, self.prefix, self.folder = report.manifest, report.prefix, report.folder
        self.machine = report.manifest["machine"]["name"]
        path = folder / f"lib{report.prefix}.so"
        sources = sorted((report.folder / "src").glob("*.c"))
        include = f"-I{report.folder / 'include'}"
        command = ["gcc", "-std=c99", "-O0", "-shared", "-fPIC", include, *map(str, sources), "-o", str(path), "-lm"]
        subprocess.run(command, check=True, capture_output=True)
        self.c = ctypes.CDLL(str(path))
        self.real = ctypes.c_float if report.manifest["options"]["real"] == "float" else ctypes.c_double
        self.operations = {o["name"]: o for part in report.manifest["parts"].values() for o in part["operations"]}
        self.defaults = [parameter["value"] for parameter in report.manifest["parameters"]]

    def structure(self, fields: list[dict[str, Any]]) -> type[ctypes.Structure]:
        members = []
        for field in fields:
            kind: Any = self.real
            for size in reversed(field["shape"]):
                kind = kind * size
            members.append((field["name"], kind))
        return type("Struct", (ctypes.Structure,), {"_fields_": members})

    def __call__(self, name: str, parameters: list[float] | None = None, **inputs: Any) -> tuple[str, dict[str, Any]]:
        """Status and outputs; outputs hold −7 wherever the function did not write."""
        operation = self.operations[name]
        given = self.structure(operation["inputs"])()
        for field in operation["inputs"]:
            value = np.asarray(inputs[field["name"]], float)
            setattr(given, field["name"], _filled(getattr(given, field["name"]), value))
        answer = self.structure(operation["outputs"])()
        ctypes.memset(ctypes.byref(answer), 0, ctypes.sizeof(answer))
        for field in operation["outputs"]:
            value = np.full(field["shape"], -7.0)
            setattr(answer, field["name"], _filled(getattr(answer, field["name"]), value))
        p = (self.real * max(1, len(self.defaults)))(*(self.defaults if parameters is None else parameters))
        workspace = (self.real * operation["workspace_reals"])()
        arguments: list[Any] = [ctypes.byref(given)]
        arguments += [ctypes.byref(p)] if self.defaults else []
        arguments += [ctypes.byref(answer), workspace, ctypes.c_size_t(len(workspace))]
        code = getattr(self.c, operation["c_name"])(*arguments)
        names = {value: key for key, value in self.manifest["statuses"].items()}
        return names[code], {f["name"]: np.array(getattr(answer, f["name"])) for f in operation["outputs"]}


def _filled(target: Any, value: np.ndarray) -> Any:
    if value.ndim == 0:
        return float(value)
    for k, part in enumerate(value):
        target[k] = _filled(target[k], part)
    return target
