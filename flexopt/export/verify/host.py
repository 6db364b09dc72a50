"""Software in the loop: the bundle built and run on this computer.

In: a `Bench`. Out: checks of its build by its own README, of warnings, of its numbers against Python, of what it does
with faulty calls.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flexopt.export.operations import Operation
from flexopt.export.verify import replay
from flexopt.export.verify.bench import STRICT, Bench, warnings_in
from flexopt.export.verify.checks import Finding, FindingTable, PlannedCheck
from flexopt.export.verify.tools import ProgramOutput, StepFailed, need, run, sanitizing_compiler
from flexopt.foundation.arrays import Array

COMPILERS = (("gcc", "g++"), ("clang", "clang++"))
# What a compiler warns of once it optimises does not depend on the standard: the first is compiled optimised.
STANDARDS = ("c99", "c11")
# Unoptimised: they see no less, and the kernels are compiled in a quarter of the time.
SANITIZERS = ("-O0", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
FUZZ_SEED = 30
COMPARED = 1000


def host_checks(bench: Bench) -> list[PlannedCheck]:
    """Every check of the host."""
    checks = [PlannedCheck(f"README followed, {c}", "host", lambda c=c: _readme(bench, c)) for c, _ in COMPILERS]
    checks += [PlannedCheck(f"no warning, {c}", "host", lambda c=c, p=p: _warnings(bench, c, p)) for c, p in COMPILERS]
    checks += [PlannedCheck(f"equal to Python, {c}", "host", lambda c=c: _agreement(bench, c)) for c, _ in COMPILERS]
    checks.append(PlannedCheck("faulty calls under ASan and UBSan", "host", lambda: _fuzz(bench)))
    return checks


def _readme(bench: Bench, compiler: str) -> Finding:
    """The commands of the README's section on building, in a copy of the folder."""
    commands, faults = readme_commands(bench.folder), list[str]()
    for k, command in enumerate(commands):
        said = follow(bench.folder, command, compiler, bench.scratch / f"readme-{compiler}-{k}")
        faults += warnings_in(said)
        if "all passed" not in said.both and "100% tests passed" not in said.both:
            faults.append(f"`{command}` does not say that the self-test passed")
    said_briefly = "; ".join(" ".join(command.split()) for command in commands)
    return Finding(f"{said_briefly}: no warning, the self-test passes, the example ends well", faults)


def readme_commands(folder: Path) -> list[str]:
    """The commands that a bundle's README gives for building and testing it."""
    text = (folder / "README.md").read_text(encoding="utf-8")
    section = re.split(r"^## ", text, flags=re.MULTILINE)[1]
    return [line.strip().split("  #")[0].strip() for line in section.splitlines() if line.startswith("    ")]


def follow(folder: Path, command: str, compiler: str, copy: Path) -> ProgramOutput:
    """What such a command says in a copy of the folder, as it was exported.

    Raises:
        ToolMissing: a program is not there.
        StepFailed: the command does not end with 0.
    """
    need("make", compiler, *(["cmake"] if "cmake" in command else []))
    shutil.copytree(folder, copy, ignore=shutil.ignore_patterns("verification", "build", "*.o", "*.a"))
    return run(["sh", "-e", "-c", command], folder=copy, environment={"CC": compiler})


def _warnings(bench: Bench, compiler: str, cpp: str) -> Finding:
    need(compiler, cpp)
    for standard in STANDARDS:
        objects = _strict_objects(bench, compiler, standard)
        # The programs print numbers as double; only the library is free of it.
        flags = [f"-std={standard}", "-O1", *STRICT]
        for program in (bench.folder / "test" / "selftest.c", bench.folder / "examples" / "main.c"):
            name = f"{program.stem}-{compiler}-{standard}"
            run([bench.program(name, compiler, [program, *objects], flags)], folder=bench.scratch)
    sources = [bench.folder / "test" / "cpp_check.cpp", bench.folder / "examples" / "ros2_node.cpp"]
    built = [source for source in sources if source.exists()]
    for source in built:
        flags = ["-std=c++17", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
        objects = _strict_objects(bench, compiler, STANDARDS[0])
        run([bench.program(f"{source.stem}-{compiler}", cpp, [source, *objects], flags)], folder=bench.scratch)
    flags = " ".join(bench.strict(compiler))
    return Finding(f"{', '.join(STANDARDS)} with {flags}; self-test and example run; C++17: "
                   f"{', '.join(source.name for source in built)}")  # fmt: skip


def _strict_objects(bench: Bench, compiler: str, standard: str) -> list[Path]:
    level = "-O2" if standard == STANDARDS[0] else "-O0"
    flags = [f"-std={standard}", level, *bench.strict(compiler)]
    return list(bench.objects(f"strict-{compiler}-{standard}", compiler, flags).values())


def _agreement(bench: Bench, compiler: str) -> Finding:
    objects = _strict_objects(bench, compiler, STANDARDS[0])
    driver = _driver(bench, f"driver-{compiler}", compiler, objects, ["-std=c99", "-O2"])
    blocks = [
        replay.block(k, o, bench.samples[o.name].inputs) for k, o in enumerate(bench.library.all_operations)
    ]  # fmt: skip
    calls, said = bench.scratch / "calls.bin", bench.scratch / "answers.bin"
    replay.write_calls(calls, blocks, single=bench.single)
    run([driver, calls, said], folder=bench.scratch)
    _, answers = replay.read_answers(said, blocks, single=bench.single)
    return agreement(bench, blocks, answers)


def agreement(bench: Bench, blocks: list[replay.Block], answers: list[replay.Answers]) -> Finding:
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


def _driver(bench: Bench, name: str, compiler: str, library: list[Path], flags: list[str]) -> Path:
    return bench.program(name, compiler, [bench.folder / "test" / "driver.c", *library], flags)


def _fuzz(bench: Bench) -> Finding:
    compiler = sanitizing_compiler(SANITIZERS, bench.scratch)
    objects = list(bench.objects("sanitized", compiler, ["-std=c99", *SANITIZERS]).values())
    driver = _driver(bench, "driver-sanitized", compiler, objects, ["-std=c99", *SANITIZERS])
    blocks = [_faulty(bench, k, o) for k, o in enumerate(bench.library.all_operations)]
    calls, said = bench.scratch / "faulty.bin", bench.scratch / "faulty-answers.bin"
    replay.write_calls(calls, blocks, single=bench.single)
    try:
        run([driver, calls, said], folder=bench.scratch)
    except StepFailed as error:
        return Finding("", [str(error)])
    _, answers = replay.read_answers(said, blocks, single=bench.single)
    rows: list[tuple[object, ...]] = []
    faults: list[str] = []
    for b, a in zip(blocks, answers, strict=True):
        row, found = _judged(bench, b, a)
        rows.append(row)
        faults += found
    header = ("function", "calls", "succeeded", "equal to Python of those compared", *replay.NAMES[1:])
    table = FindingTable("Faulty calls, by the status they got", header, tuple(rows))
    total = sum(len(b.rows) for b in blocks)
    sentence = f"{total} calls with {compiler}: no sanitizer complained, no silent success, refused outputs untouched"
    return Finding(sentence, faults, [table])


def _faulty(bench: Bench, index: int, operation: Operation) -> replay.Block:
    """Calls of which most have a bad pointer or some absurd numbers."""
    rng = np.random.default_rng(FUZZ_SEED + index)
    count = bench.fuzz_calls
    good = operation.draw(bench.library.context.parameters, min(count, 500), FUZZ_SEED).inputs
    rows = np.resize(good, (count, good.shape[1])).copy()
    faults = np.zeros(count, np.uint32)
    kind = rng.random(count)
    pointers = kind < 0.2
    faults[pointers] = 1 << rng.integers(0, 6, int(pointers.sum()))
    if operation.baked:
        faults[faults == replay.NULL_PARAMETERS] = replay.NULL_IN
    absurd = np.flatnonzero((kind >= 0.2) & (kind < 0.9))
    low, high = _ranges(bench, operation)
    tiny = [5e-324, -5e-324, 1e-310] if not bench.single else [1e-45, -1e-45, 1e-39]
    huge = [1e300, -1.7e308, 1e31] if not bench.single else [1e37, -3.4e38, 1e31]
    for _ in range(3):
        some = absurd[rng.random(absurd.size) < 0.6]
        column = rng.integers(0, rows.shape[1], some.size)
        absurdities = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, *tiny, *huge])
        value = rng.choice(absurdities, some.size)
        edge = rng.random(some.size)
        value = np.where(edge < 0.15, low[column], np.where(edge < 0.3, high[column], value))
        rows[some, column] = value
    return replay.block(index, operation, bench.library.context.parameters.rounded(rows), faults=faults)


def _ranges(bench: Bench, operation: Operation) -> tuple[Array, Array]:
    """Allowed ranges of the inputs and of the parameters, as C has them."""
    p = bench.library.context.parameters
    sides: list[Array] = []
    for side in ("low", "high"):
        values = [v for field in operation.inputs for v in getattr(field, side)]
        values += [] if operation.baked else list(getattr(p, side))
        sides.append(p.rounded(np.array(values)))
    return sides[0], sides[1]


def _judged(bench: Bench, b: replay.Block, a: replay.Answers) -> tuple[tuple[object, ...], list[str]]:
    """A row of the table, and what is wrong."""
    operation, faults = b.operation, list[str]()
    ok = np.isin(a.status, replay.WRITTEN)
    low, high = _ranges(bench, operation)
    n_in = operation.n_in
    checked = np.zeros(b.rows.shape[1], bool)
    checked[:n_in] = True
    if not operation.baked:
        checked[[n_in + k for k in bench.library.used_parameters(operation)]] = True
    with np.errstate(invalid="ignore"):
        in_range = ((b.rows >= low) & (b.rows <= high) | ~checked).all(axis=1)
    callable_ = b.faults == 0

    def note(which: NDArray[np.bool_], sentence: str) -> None:
        if which.any():
            faults.append(f"{operation.name}: {int(which.sum())} calls {sentence}, such as number {which.argmax()}")

    note(ok & ~callable_, "with a bad pointer succeeded")
    note(ok & ~in_range, "with an input outside its range succeeded")
    note(ok & ~np.isfinite(a.outputs).all(axis=1), "succeeded with an output that is not finite")
    note(~ok & ~a.untouched, "that were refused wrote output")
    # Calls with sound parameters are compared; a machine of absurd masses has no reference to compare with.
    sound = callable_ & in_range & _sound_parameters(bench, b, n_in)
    compared = np.flatnonzero(sound)[:COMPARED]
    reference = operation.reference(b.rows[compared])
    taken = reference.accepted & ok[compared]
    missed = reference.accepted & ~ok[compared] & (a.status[compared] != replay.CODES["NOT_ACCURATE"])
    # Squares of larger results leave the finite numbers of the bundle's precision on the way.
    largest = np.sqrt(np.finfo(np.float32 if bench.single else np.float64).max)
    with np.errstate(invalid="ignore"):
        lost = (np.abs(reference.outputs) > largest).any(axis=1)
    missed &= ~(lost & (a.status[compared] == replay.CODES["NUMERICAL_FAILURE"]))
    if missed.any():
        faults.append(f"{operation.name}: {int(missed.sum())} calls that Python accepts were refused")
    with np.errstate(all="ignore"):
        outputs, expected = a.outputs[compared], reference.outputs
        # Results below the smallest normal number lose digits, whoever computes them.
        allowed = bench.tolerance * reference.scales + np.finfo(np.float32 if bench.single else np.float64).tiny
        equal = (np.abs(outputs - expected) <= allowed) | (outputs == expected)
        refused_by_guard = ~reference.accepted & ok[compared]
    if (taken & ((a.status[compared] == replay.CODES["BEYOND_LIMIT"]) != reference.beyond)).any():
        faults.append(f"{operation.name}: successes are wrong about joints beyond their limits")
    if (taken & ~equal.all(axis=1)).any():
        faults.append(f"{operation.name}: {int((taken & ~equal.all(axis=1)).sum())} successes differ from Python")
    if refused_by_guard.sum() > 0:
        faults.append(f"{operation.name}: {int(refused_by_guard.sum())} calls that Python's guards refuse succeeded")
    counts = [int((a.status == code).sum()) for code in range(1, len(replay.NAMES))]
    shown = f"{int((taken & equal.all(axis=1)).sum())} of {int(taken.sum())}"
    return (operation.name, len(b.rows), int(ok.sum()), shown, *counts), faults


def _sound_parameters(bench: Bench, b: replay.Block, n_in: int) -> NDArray[np.bool_]:
    if b.operation.baked:
        return np.ones(len(b.rows), bool)
    return bench.library.context.parameters.near(b.rows[:, n_in:])
