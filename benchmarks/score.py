"""Rows of the score table, and a machine's description to go with them.

A module of this package takes part by a function `rows(quick) -> list[Row]` at its top level; `python -m benchmarks`
finds it by its text, and calls it in a process of its own, so that no row depends on what ran before it. `quick` asks
for as few repetitions as show that everything runs. Every row says what ran, as the code that ran tells.
"""

from __future__ import annotations

import ast
import os
import platform
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from flexopt.compiled import Batch, Recurrence, find_compiler

HERE = Path(__file__).resolve().parent


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        what: what is measured, and beside what; the same text from run to run.
        value: a ratio, or seconds.
        bar: what it shall reach; None: it is told only.
        at_least: whether `value` shall be at least `bar`; else at most.
        ran: by what means, as the code that ran says: compiled or not, lanes, threads.
    """

    what: str
    value: float
    bar: float | None
    at_least: bool
    ran: str

    @property
    def met(self) -> bool:
        """Whether the bar is reached."""
        return self.bar is None or (self.value >= self.bar if self.at_least else self.value <= self.bar)


def means(runner: Batch | Recurrence, threads: int = 1, members: int = 1) -> str:
    """What runs a Function: compiled code and its lanes, or the virtual machine."""
    lanes = runner.lanes if isinstance(runner, Batch) else runner.lanes(members)
    how = f"compiled, {lanes} lanes" if runner.compiled else "virtual machine"
    return f"{how}, {threads} thread{'s' * (threads > 1)}"


def modules() -> tuple[list[str], list[str]]:
    """Modules that have rows, and other commands of this package."""
    with_rows, others = list[str](), list[str]()
    for path in sorted([*HERE.glob("*.py"), *HERE.glob("*/__main__.py")]):
        if path.parent == HERE and path.stem in {"__init__", "__main__"}:
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
        names = {node.name for node in functions}
        name = f"{HERE.name}.{path.stem if path.parent == HERE else path.parent.name + '.__main__'}"
        if any(node.name == "rows" and [a.arg for a in node.args.args] == ["quick"] for node in functions):
            with_rows.append(name)
        elif "main" in names:
            others.append(name.removesuffix(".__main__"))
    return with_rows, others


def _processor() -> dict[str, str]:
    """What the system tells of it, by name; of cores that say the same thing what the last says."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return {}
    return dict([part.strip() for part in line.split(":", 1)] for line in lines if ":" in line)


def has_avx512() -> bool:
    """Whether the processor says that it has AVX-512."""
    return "avx512f" in _processor().get("flags", "").split()


def this_machine() -> dict[str, str]:
    """What the numbers were taken on."""
    compiler, by_name = find_compiler(), _processor()
    # A name alone may be that of many: "AMD EPYC" runs vectors of 512 bits in halves or whole.
    kind = [f"{name.removeprefix('cpu ')} {by_name[name]}" for name in ("cpu family", "model") if name in by_name]
    packages = ["numpy", "scipy", "casadi", "slycot", "numba", "mujoco"]
    return {
        "processor": ", ".join([by_name.get("model name", platform.processor() or platform.machine()), *kind]),
        "vectors": "AVX-512" if has_avx512() else "no AVX-512",
        "cores": str(os.cpu_count()),
        "compiler": " ".join(compiler.command) if compiler else "none",
        "python": platform.python_version(),
        **{name: found for name in packages if (found := _version(name))},
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""
