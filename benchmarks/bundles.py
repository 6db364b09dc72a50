"""Bundles of C of the shipped machines, built and tested by their own READMEs.

Run: python -m benchmarks.bundles [--machine NAME,…] [--real double|float|both] [--compiler gcc,clang] [--parts A,B,…]

Every machine is exported in every precision; then each command of the README's section on building is followed in a
fresh copy of the folder, with each compiler. Both commands build the library, its self-test and its example, and run
the two. A row says how each ended: 0, or the end of what it said. Beside it stands how much of the workspace each
function with tests of its own accepts. Ends with 1 where anything did not end with 0. Needs make, cmake, the compilers.
"""

from __future__ import annotations

import argparse
import re
import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import flexopt
from benchmarks.timing import table
from flexopt.errors import FlexoptError
from flexopt.export import ExportReport, export_c
from flexopt.export.kernels import Real
from flexopt.export.verify.tools import ProgramOutput, StepFailed, ToolMissing, run
from flexopt.model import shipped_names

REALS: tuple[Real, ...] = ("double", "float")
COMPILERS = ("gcc", "clang")


def readme_commands(folder: Path) -> list[str]:
    """The commands that a bundle's README gives for building and testing it."""
    text = (folder / "README.md").read_text(encoding="utf-8")
    section = re.split(r"^## ", text, flags=re.MULTILINE)[1]
    return [line.strip().split("  #")[0].strip() for line in section.splitlines() if line.startswith("    ")]


def follow(folder: Path, command: str, compiler: str, copy: Path) -> ProgramOutput:
    """Run such a command in a copy of the folder, as it was exported.

    Raises:
        StepFailed: the command does not end with 0.
    """
    shutil.copytree(folder, copy, ignore=shutil.ignore_patterns("verification", "build", "*.o", "*.a"))
    return run(["sh", "-e", "-c", command], folder=copy, environment={"CC": compiler})


def ended(report: ExportReport, compiler: str, scratch: Path) -> list[str]:
    """How each command of the README ended: "0", or a sentence."""
    found: list[str] = []
    for k, command in enumerate(readme_commands(report.folder)):
        try:
            said = follow(report.folder, command, compiler, scratch / f"{compiler}-{k}").both
            passed = "all passed" in said or "100% tests passed" in said
            warned = re.findall(r".*\b(?:warning|error):.*", said)
            found.append((warned or ["0"])[0] if passed else "0, but no test was run")
        except (StepFailed, ToolMissing) as error:
            found.append(" ".join(str(error).split())[-200:])
    return found


def accepted(report: ExportReport) -> str:
    """Share of random inputs inside the limits that each function with tests of its own takes."""
    operations = [o for part in report.manifest["parts"].values() for o in part["operations"] if o["guards"]]
    return ", ".join(f"{o['name']} {100 * o['acceptance']:.0f} %" for o in operations)


def examine(
    names: Sequence[str], reals: Sequence[Real], compilers: Sequence[str], parts: Sequence[str] | None = None
) -> tuple[list[tuple[str, ...]], bool]:
    """Rows of a table, the first its header, and whether all ended with 0."""
    rows: list[tuple[str, ...]] = [("machine", "real", "export", "compiler", "make test", "cmake … ctest", "accepts")]
    fine = True
    for name in names:
        for real in reals:
            with tempfile.TemporaryDirectory(prefix="flexopt-") as folder:
                try:
                    report = export_c(flexopt.load(name), Path(folder) / "bundle", real=real, parts=parts)
                except FlexoptError as error:
                    rows.append((name, real, str(error), "", "", "", ""))
                    fine = False
                    continue
                for compiler in compilers:
                    results = ended(report, compiler, Path(folder))
                    fine = fine and results == ["0"] * 2
                    rows.append((name, real, "0", compiler, *results, accepted(report)))
                    print(f"{name} {real} {compiler}: {', '.join(results)}", file=sys.stderr)
    return rows, fine


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machine", default=",".join(shipped_names("models")), help="all that are shipped by default")
    parser.add_argument("--real", choices=(*REALS, "both"), default="both")
    parser.add_argument("--compiler", default=",".join(COMPILERS))
    parser.add_argument("--parts", help="all that the machine allows by default")
    options = parser.parse_args()
    reals = REALS if options.real == "both" else (options.real,)
    parts = None if options.parts is None else options.parts.split(",")
    rows, fine = examine(options.machine.split(","), reals, options.compiler.split(","), parts)
    print(table("Bundles of the shipped machines, README followed: how each command ended", rows))
    if not fine:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
