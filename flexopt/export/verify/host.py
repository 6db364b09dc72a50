"""Software in the loop: the bundle built and run on this computer.

In: a `Bench`. Out: checks of its self-test, and of its numbers against Python.
"""

from __future__ import annotations

from pathlib import Path

from flexopt.export.bundle import COMPILE_FLAGS
from flexopt.export.verify import replay
from flexopt.export.verify.bench import Bench
from flexopt.export.verify.checks import Finding, FindingTable, PlannedCheck
from flexopt.export.verify.tools import host_compiler, run


def host_checks(bench: Bench) -> list[PlannedCheck]:
    """Every check that runs the bundle's C."""
    return [
        PlannedCheck("self-test", lambda: _self_test(bench)),
        PlannedCheck("equal to Python", lambda: agreement(bench, _built(bench, "driver"))),
    ]


def _built(bench: Bench, name: str) -> Path:
    """One of the bundle's test programs, by the compiler of this computer."""
    compiler = host_compiler()
    objects = bench.objects("host", compiler, COMPILE_FLAGS).values()
    return bench.program(name, compiler, [bench.folder / "test" / f"{name}.c", *objects], COMPILE_FLAGS)


def _self_test(bench: Bench) -> Finding:
    said = run([_built(bench, "selftest")], folder=bench.scratch).out
    faults = [] if "all passed" in said else ["the self-test does not report that all passed"]
    return Finding("built, recorded vectors and refusals pass", faults)


def agreement(bench: Bench, driver: Path) -> Finding:
    """Compare a driver of this computer with Python on random inputs."""
    operations = bench.library.all_operations
    blocks = [replay.block(k, o, bench.samples[o.name].inputs) for k, o in enumerate(operations)]
    calls, said = bench.scratch / "calls.bin", bench.scratch / "answers.bin"
    replay.write_calls(calls, blocks, single=bench.single)
    run([driver, calls, said], folder=bench.scratch)
    _, answers = replay.read_answers(said, blocks, single=bench.single)
    return compared(bench, blocks, answers)


def compared(bench: Bench, blocks: list[replay.Block], answers: list[replay.Answers]) -> Finding:
    """The finding about numbers, common to all targets."""
    rows: list[tuple[object, ...]] = []
    faults: list[str] = []
    for b, a in zip(blocks, answers, strict=True):
        of_function, wrong = replay.compare(b.operation, bench.samples[b.operation.name], a, bench.tolerance)
        rows += of_function
        faults += wrong
    worst = max(float(row[3]) for row in rows)  # type: ignore[arg-type]
    header = ("function", "output", "scale", "largest error / scale", "calls compared", "not accurate")
    table = FindingTable(f"Against Python, {bench.inputs} random inputs with random parameters", header, tuple(rows))
    sentence = f"largest error {worst:.2g} of the output's scale, allowed {bench.tolerance:g}"
    return Finding(sentence, faults, [table])
