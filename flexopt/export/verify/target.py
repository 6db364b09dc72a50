"""Processor in the loop: the bundle on an emulated Cortex-M, its numbers, instructions, stack and memory.

In: a `Bench` and a target. Out: checks. Instructions are counted by the board's clock under QEMU's `-icount`, where
every instruction takes the same time; they are instructions, not cycles.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np

from flexopt.export.operations import Operation
from flexopt.export.verify import objects, replay
from flexopt.export.verify.bench import Bench
from flexopt.export.verify.checks import Finding, FindingTable, PlannedCheck, VerifyTarget
from flexopt.export.verify.host import agreement
from flexopt.export.verify.tools import ProgramOutput, StepFailed, need, run
from flexopt.foundation.writing import write_file

COMPILER = "arm-none-eabi-gcc"
EMULATOR = "qemu-system-arm"
SPEEDUP = 10.0


@dataclass(frozen=True)
class Board:
    """An emulated board.

    Attributes:
        machine: QEMU's name of it.
        flags: of the compiler.
    """

    machine: str
    flags: tuple[str, ...]


BOARDS: dict[VerifyTarget, Board] = {
    "cortex-m4f": Board("mps2-an386", ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16")),
    "cortex-m7": Board("mps2-an500", ("-mcpu=cortex-m7", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv5-d16")),
}


def target_checks(bench: Bench, target: VerifyTarget) -> list[PlannedCheck]:
    """Every check of one board."""
    board = BOARDS[target]
    flags = ["-std=c99", "-O2", *board.flags]
    checks = [
        PlannedCheck("equal to Python; instructions, stack", target, lambda: _agreement(bench, board, target, flags)),
        PlannedCheck("flash and RAM by part", target, lambda: _memory(bench, target, flags)),
        objects.objects_check(bench, target, COMPILER, flags),
    ]
    if bench.single and target == "cortex-m4f" and "controller" in bench.library.operations:
        checks.append(PlannedCheck("against the plain CasADi export", target, lambda: _against_plain(bench, board)))
    return checks


def _agreement(bench: Bench, board: Board, target: VerifyTarget, flags: Sequence[str]) -> Finding:
    need(COMPILER, EMULATOR)
    built = objects.accounted(bench, target, COMPILER, flags)
    program = _program(bench, board, f"driver-{target}", [bench.folder / "test" / "driver.c", *built.values()])
    operations = bench.library.all_operations
    blocks = [
        replay.block(k, o, bench.samples[o.name].inputs, repeats=_repeats(o)) for k, o in enumerate(operations)
    ]  # fmt: skip
    calls, said = bench.scratch / f"{target}.bin", bench.scratch / f"{target}-answers.bin"
    replay.write_calls(calls, blocks, single=bench.single)
    _emulate(bench, board, program, [calls.name, said.name])
    calibration, answers = replay.read_answers(said, blocks, single=bench.single)
    found = agreement(bench, blocks, answers)
    per_tick = replay.CALIBRATION / calibration
    rows: list[tuple[object, ...]] = []
    for b, a in zip(blocks, answers, strict=True):
        counts = np.round(a.ticks * per_tick / b.repeats)
        rows.append((b.operation.name, int(counts.max()), int(counts.mean()), int(counts.min()), a.stack))
    header = ("function", "instructions, most", "mean", "least", "stack of a call, bytes (painted)")
    title = (
        f"One call with its checks, {board.machine} ({per_tick:.3g} instructions a tick, repeated for small functions)"
    )
    table = FindingTable(title, header, tuple(rows))
    return Finding(found.sentence, found.faults, [*found.tables, table])


def _repeats(operation: Operation) -> int:
    """So many that the clock's tick of some 40 instructions does not show."""
    return max(1, 4000 // max(1, operation.kernel.n_instructions())) if operation.kernel.is_a("SXFunction") else 1


def _memory(bench: Bench, target: VerifyTarget, flags: Sequence[str]) -> Finding:
    need(COMPILER, "arm-none-eabi-objdump")
    built = objects.accounted(bench, target, COMPILER, flags)
    graph = objects.call_graph(built)
    rows: list[tuple[object, ...]] = []
    real = 4 if bench.single else 8
    for part, path in built.items():
        sizes = objects.section_sizes("arm-none-eabi-objdump", path)
        names = [f"{bench.library.prefix}_{o.name}" for o in bench.library.operations.get(part, ())]
        stack = max((graph.stack_from(name) for name in names), default=0)
        space = max((bench.library.workspace(o) for o in bench.library.operations.get(part, ())), default=0) * real
        rows.append((part, sizes["flash"], sizes["ram"], space, stack))
    header = ("part", "flash, bytes", "static RAM, bytes", "workspace, bytes", "stack of its own functions, bytes")
    total = sum(int(row[1]) for row in rows)  # type: ignore[call-overload]
    table = FindingTable("Memory by part (-O2; the mathematical library not counted)", header, tuple(rows))
    return Finding(f"{total} bytes of flash for all parts, no static RAM", [], [table])


def _against_plain(bench: Bench, board: Board) -> Finding:
    """Row 3 of the bars: kernel to kernel, at least ten times fewer instructions than CasADi's own export."""
    need(COMPILER, EMULATOR)
    library = bench.library
    operation = next(o for o in library.operations["controller"] if o.name == "torque_inverse")
    options = {"with_header": True, "casadi_real": "float", "casadi_int": "int"}
    generator = ca.CodeGenerator("plain", options)
    generator.add(operation.kernel)
    generator.generate(f"{bench.scratch}/")
    row = bench.samples[operation.name].inputs[0]
    text = library.writer.render(
        "target/compare.c", o=operation, kernel=operation.kernel, row=row[: operation.n_in].tolist(),
        parameters=row[operation.n_in :].tolist(), baked=library.baked,
    )  # fmt: skip
    write_file(bench.scratch / "compare.c", text)
    common = next(source for source in bench.sources if source.stem == f"{library.prefix}_common")
    sources = [bench.scratch / "compare.c", bench.scratch / "plain.c", common]
    program = _program(bench, board, "compare", sources, extra=[f"-I{bench.scratch}"])
    said = _emulate(bench, board, program, []).out
    found = {name: int(value) for name, value in re.findall(r"(\w+) (\d+)", said)}
    per_call = replay.CALIBRATION / found["calibration"] / found["calls"]
    plain, kernel, whole = (found[name] * per_call for name in ("plain", "kernel", "whole"))
    ratio = plain / kernel
    rows = (
        ("CasADi's own export, casadi_real = float", round(plain), f"{ratio:.1f}"),
        ("the bundle's kernel", round(kernel), "1"),
        ("the bundle's function, with checks", round(whole), f"{whole / kernel:.1f}"),
        ("the checks alone", round(whole - kernel), f"{(whole - kernel) / kernel:.1f}"),
    )
    table = FindingTable(
        "Controller step (Jacobian inverse), instructions of a call", ("who", "instructions", "ratio"), rows
    )
    faults = [] if ratio >= SPEEDUP else [f"only {ratio:.1f} times fewer instructions than CasADi's own export"]
    sentence = f"{ratio:.1f} times fewer instructions than CasADi's own single-precision export, kernel to kernel"
    return Finding(sentence, faults, [table])


def _program(bench: Bench, board: Board, name: str, sources: Sequence[Path], extra: Sequence[str] = ()) -> Path:
    """Link for a board, with semihosting."""
    for file in ("startup.c", "link.ld"):
        write_file(bench.scratch / file, bench.library.writer.render(f"target/{file}"))
    flags = [
        "-std=gnu99", "-O2", *board.flags, "-DFLEXOPT_TARGET", *extra, "--specs=rdimon.specs",
        f"-T{bench.scratch / 'link.ld'}", "-Wl,--no-warn-rwx-segments",
    ]  # fmt: skip
    return bench.program(f"{name}.elf", COMPILER, [bench.scratch / "startup.c", *sources], flags)


def _emulate(bench: Bench, board: Board, program: Path, arguments: Sequence[str]) -> ProgramOutput:
    names = "".join(f",arg={word}" for word in [program.stem, *arguments])
    command = [
        EMULATOR, "-M", board.machine, "-icount", "shift=0", "-display", "none", "-serial", "null", "-monitor", "none",
        "-semihosting-config", f"enable=on,target=native{names}", "-kernel", program,
    ]  # fmt: skip
    try:
        return run(command, folder=bench.scratch)
    except StepFailed as error:
        raise StepFailed(f"on {board.machine}: {error}") from error
