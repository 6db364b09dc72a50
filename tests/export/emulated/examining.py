"""Everything that is examined of a bundle: on the host, or on one emulated board."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from benchmarks.bundles import ended
from flexopt.export import ExportReport
from flexopt.export.bundle import library_of, read_manifest
from flexopt.export.verify.bench import Bench
from flexopt.export.verify.checks import Finding
from tests.export.emulated import boards, compilers, faulty, misra, objects

# Position-independent code would put constants with pointers where only the linker writes.
HOST_FLAGS = ("-std=c99", "-O2", "-fno-pic")


def opened(folder: Path, scratch: Path, inputs: int = 10) -> Bench:
    """Open a bundle for examination."""
    manifest = read_manifest(folder)
    scratch.mkdir()
    return Bench(folder, scratch, manifest, library_of(manifest), inputs)


def examine_host(report: ExportReport, scratch: Path, inputs: int, calls: int) -> dict[str, Finding]:
    """Examine a bundle on this computer by every compiler, sanitizer and analyser.

    Raises:
        StepFailed: a compiler warns, or a program does not end with 0.
    """
    bench = opened(report.folder, scratch, inputs)
    for compiler in compilers.COMPILERS:
        assert ended(report, compiler, scratch) == ["0", "0"]
        compilers.build_strictly(bench, compiler)
    found = {f"equal to Python, {compiler}": compilers.agreement(bench, compiler) for compiler in compilers.COMPILERS}
    found |= {"faulty calls": faulty.fuzzed(bench, calls)}
    found |= {"objects": objects.examined(bench, "host", "gcc", HOST_FLAGS), "MISRA": misra.examined(bench)}
    return without_faults(found)


def examine_board(folder: Path, scratch: Path, name: str, inputs: int) -> dict[str, Finding]:
    """Examine a bundle on an emulated board."""
    bench = opened(folder, scratch, inputs)
    flags = boards.flags_of(boards.BOARDS[name])
    found = {"equal to Python": boards.agreement(bench, name), "memory": boards.memory(bench, name)}
    found |= {"objects": objects.examined(bench, name, boards.COMPILER, flags)}
    if bench.single and name == "cortex-m4f" and "controller" in bench.library.operations:
        found |= {"plain": boards.against_plain(bench)}
    return without_faults(found)


def without_faults(found: Mapping[str, Finding]) -> dict[str, Finding]:
    """Assert that nothing is wrong."""
    faults = {name: finding.faults for name, finding in found.items() if finding.faults}
    assert not faults
    return dict(found)
