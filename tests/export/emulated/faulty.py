"""Faulty calls of a bundle under sanitizers: bad pointers, absurd numbers.

In: a `Bench`. Out: a finding: no sanitizer complains, nothing succeeds silently, refused outputs are untouched.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flexopt.export.operations import Operation, Parameters
from flexopt.export.verify import replay
from flexopt.export.verify.bench import Bench
from flexopt.export.verify.checks import Finding, FindingTable
from flexopt.export.verify.tools import StepFailed, run
from flexopt.foundation.arrays import Array

# Bits of the faults that the driver makes.
NULL_IN, NULL_PARAMETERS = 1, 2
FAULT_COUNT = 6
# Unoptimised: they see no less, and the kernels are compiled in a quarter of the time.
SANITIZERS = ("-O0", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
FUZZ_SEED = 30
COMPARED = 1000


def fuzzed(bench: Bench, count: int) -> Finding:
    """Make `count` calls of each function, of which most are faulty."""
    compiler, flags = "gcc", ["-std=c99", *SANITIZERS]
    objects = bench.objects("sanitized", compiler, flags).values()
    driver = bench.program("driver-sanitized", compiler, [bench.folder / "test" / "driver.c", *objects], flags)
    blocks = [_faulty(bench, k, o, count) for k, o in enumerate(bench.library.all_operations)]
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


def _faulty(bench: Bench, index: int, operation: Operation, count: int) -> replay.Block:
    """Calls of which most have a bad pointer or some absurd numbers."""
    rng = np.random.default_rng(FUZZ_SEED + index)
    good = operation.draw(bench.library.context.parameters, min(count, 500), FUZZ_SEED).inputs
    rows = np.resize(good, (count, good.shape[1])).copy()
    faults = np.zeros(count, np.uint32)
    kind = rng.random(count)
    pointers = kind < 0.2
    faults[pointers] = 1 << rng.integers(0, FAULT_COUNT, int(pointers.sum()))
    if operation.baked:
        faults[faults == NULL_PARAMETERS] = NULL_IN
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


def near(parameters: Parameters, rows: Array) -> NDArray[np.bool_]:
    """Whether all values of a row (count, n_par) are as close to the machine's own as those drawn."""
    with np.errstate(invalid="ignore"):
        close = np.abs(rows - np.asarray(parameters.values)) <= 1.05 * np.asarray(parameters.spread)
    return np.asarray(close.all(axis=1))


def _sound_parameters(bench: Bench, b: replay.Block, n_in: int) -> NDArray[np.bool_]:
    if b.operation.baked:
        return np.ones(len(b.rows), bool)
    return near(bench.library.context.parameters, b.rows[:, n_in:])
