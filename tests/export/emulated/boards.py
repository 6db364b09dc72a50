"""Processor in the loop: the bundle on an emulated Cortex-M, its numbers, instructions, stack and memory.

In: a `Bench` and a board. Out: findings. Instructions are counted by the board's clock under QEMU's `-icount`, where
every instruction takes the same time; they are instructions, not cycles.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from flexopt.export.operations import Operation
from flexopt.export.verify import replay
from flexopt.export.verify.bench import Bench
from flexopt.export.verify.checks import Finding, FindingTable
from flexopt.export.verify.host import compared
from flexopt.export.verify.tools import ProgramOutput, StepFailed, run
from tests.export.emulated import objects

COMPILER = "arm-none-eabi-gcc"
EMULATOR = "qemu-system-arm"
SPEEDUP = 10.0
# Instructions of `target_calibrate`.
CALIBRATION = 4_000_000
HERE = Path(__file__).parent
_TEMPLATES = Environment(
    loader=FileSystemLoader(HERE), undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, autoescape=False
)


@dataclass(frozen=True)
class Board:
    """An emulated board.

    Attributes:
        machine: QEMU's name of it.
        flags: of the compiler.
    """

    machine: str
    flags: tuple[str, ...]


BOARDS = {
    "cortex-m4f": Board("mps2-an386", ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16")),
    "cortex-m7": Board("mps2-an500", ("-mcpu=cortex-m7", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv5-d16")),
}


def flags_of(board: Board) -> list[str]:
    """How the library is compiled for a board."""
    return ["-std=c99", "-O2", *board.flags]


def agreement(bench: Bench, name: str) -> Finding:
    """The library on a board against Python; instructions and stack of each function."""
    board = BOARDS[name]
    built = objects.accounted(bench, name, COMPILER, flags_of(board))
    program = _program(bench, board, f"driver-{name}", [bench.folder / "test" / "driver.c", *built.values()])
    operations = bench.library.all_operations
    blocks = [
        replay.block(k, o, bench.samples[o.name].inputs, repeats=_repeats(o)) for k, o in enumerate(operations)
    ]  # fmt: skip
    calls, said = bench.scratch / f"{name}.bin", bench.scratch / f"{name}-answers.bin"
    replay.write_calls(calls, blocks, single=bench.single)
    _emulate(bench, board, program, [calls.name, said.name])
    calibration, answers = replay.read_answers(said, blocks, single=bench.single)
    found = compared(bench, blocks, answers)
    per_tick = CALIBRATION / calibration
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


def memory(bench: Bench, name: str) -> Finding:
    """Flash and RAM of each part."""
    built = objects.accounted(bench, name, COMPILER, flags_of(BOARDS[name]))
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


def against_plain(bench: Bench) -> Finding:
    """Row 3 of the bars: kernel to kernel, at least ten times fewer instructions than CasADi's own export."""
    board, library, writer = BOARDS["cortex-m4f"], bench.library, bench.library.writer
    operation = next(o for o in library.operations["controller"] if o.name == "torque_inverse")
    options = {"with_header": True, "casadi_real": "float", "casadi_int": "int"}
    generator = ca.CodeGenerator("plain", options)
    generator.add(operation.kernel)
    generator.generate(f"{bench.scratch}/")
    row = bench.samples[operation.name].inputs[0]
    text = _TEMPLATES.get_template("compare.c").render(
        prefix=library.prefix, PREFIX=writer.upper, listed=writer.listed, o=operation, kernel=operation.kernel,
        row=row[: operation.n_in].tolist(), parameters=row[operation.n_in :].tolist(), baked=library.baked,
    )  # fmt: skip
    (bench.scratch / "compare.c").write_text(text)
    common = next(source for source in bench.sources if source.stem == f"{library.prefix}_common")
    sources = [bench.scratch / "compare.c", bench.scratch / "plain.c", common]
    program = _program(bench, board, "compare", sources, extra=[f"-I{bench.scratch}"])
    said = _emulate(bench, board, program, []).out
    found = {name: int(value) for name, value in re.findall(r"(\w+) (\d+)", said)}
    per_call = CALIBRATION / found["calibration"] / found["calls"]
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
    flags = [
        "-std=gnu99", "-O2", *board.flags, "-DFLEXOPT_TARGET", *extra, "--specs=rdimon.specs",
        f"-T{HERE / 'link.ld'}", "-Wl,--no-warn-rwx-segments",
    ]  # fmt: skip
    return bench.program(f"{name}.elf", COMPILER, [HERE / "startup.c", *sources], flags)


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
