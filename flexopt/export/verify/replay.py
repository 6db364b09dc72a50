"""Calls recorded for the driver, what it answered, and the comparison with Python.

In: an operation with samples. Out: the driver's input file; from its output file, statuses, ticks and outputs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flexopt.export.operations import Operation, Samples
from flexopt.export.sources import STATUSES, WITH_OUTPUT
from flexopt.export.verify.tools import StepFailed
from flexopt.foundation.arrays import Array
from flexopt.foundation.writing import write_file

CODES = {name: k for k, name in enumerate(STATUSES)}
NAMES = tuple(STATUSES)
WRITTEN = [CODES[name] for name in WITH_OUTPUT]

WordArray = NDArray[np.uint32]


@dataclass(frozen=True)
class Block:
    """Calls of one function.

    Attributes:
        index: of the function in the bundle's table.
        operation: the function.
        rows: inputs and parameters, (calls, n).
        repeats: how often each call is made, for the clock.
        faults: bits for each call.
    """

    index: int
    operation: Operation
    rows: Array
    repeats: int
    faults: WordArray


@dataclass(frozen=True)
class Answers:
    """What the driver answered to one block.

    Attributes:
        status: (calls,).
        ticks: of all repeats, (calls,).
        untouched: whether the output is as before, (calls,).
        outputs: (calls, n_out).
        stack: bytes of one call; 0 on the host.
    """

    status: WordArray
    ticks: WordArray
    untouched: NDArray[np.bool_]
    outputs: Array
    stack: int


def block(index: int, operation: Operation, rows: Array, *, repeats: int = 1, faults: WordArray | None = None) -> Block:
    """Calls without faults, unless they are given."""
    made = np.zeros(len(rows), np.uint32) if faults is None else faults
    return Block(index, operation, rows, repeats, made)


def write_calls(path: Path, blocks: Sequence[Block], *, single: bool) -> None:
    """The driver's input file."""
    real = np.float32 if single else np.float64
    data = bytearray()
    for b in blocks:
        data += np.array([b.index, len(b.rows), b.repeats, 0], np.uint32).tobytes()
        kind = np.dtype([("fault", np.uint32), ("row", real, (b.rows.shape[1],))])
        records = np.zeros(len(b.rows), kind)
        records["fault"] = b.faults
        with np.errstate(over="ignore", under="ignore"):
            records["row"] = b.rows
        data += records.tobytes()
    write_file(path, bytes(data))


def read_answers(path: Path, blocks: Sequence[Block], *, single: bool) -> tuple[int, list[Answers]]:
    """The ticks of a known number of instructions, 0 on the host, and the answers to each block."""
    data = path.read_bytes()
    real = np.float32 if single else np.float64
    calibration, offset = int(np.frombuffer(data, np.uint32, 1)[0]), 4
    answers: list[Answers] = []
    for b in blocks:
        kind = np.dtype([("words", np.uint32, (3,)), ("out", real, (b.operation.n_out,))])
        if len(data) < offset + len(b.rows) * kind.itemsize + 4:
            raise StepFailed("the driver's output file is too short")
        records = np.frombuffer(data, kind, len(b.rows), offset)
        offset += records.nbytes
        stack = int(np.frombuffer(data, np.uint32, 1, offset)[0])
        offset += 4
        words = records["words"]
        outputs = records["out"].astype(np.float64)
        answers.append(Answers(words[:, 0], words[:, 1], words[:, 2] != 0, outputs, stack))
    return calibration, answers


def compare(
    operation: Operation, samples: Samples, answers: Answers, tolerance: float
) -> tuple[list[tuple[object, ...]], list[str]]:
    """Errors of each output against the samples', where C did not say NOT_ACCURATE; what is wrong, in sentences.

    Of each output: function, output, its scale in words, largest error as a share of its scale, how many calls
    succeeded, and how many ended as not accurate.
    """
    name, faults = operation.name, list[str]()
    good = np.isin(answers.status, WRITTEN)
    refused = answers.status == CODES["NOT_ACCURATE"]
    mistaken = good & ((answers.status == CODES["BEYOND_LIMIT"]) != samples.beyond)
    if mistaken.any():
        faults.append(f"{name}: {int(mistaken.sum())} of {len(good)} calls were wrong about joints beyond their limits")
    for code in {int(code) for code in answers.status[~good & ~refused]}:
        count = int((answers.status == code).sum())
        said = NAMES[code] if code < len(NAMES) else f"status {code}"
        faults.append(f"{name}: {count} of {len(good)} calls that Python accepts gave {said}")
    # Single precision may refuse what it cannot compute well; most it must compute.
    if refused.sum() > len(good) // 4 or not good.any():
        faults.append(f"{name}: {int(refused.sum())} of {len(good)} calls would not be accurate")
    with np.errstate(all="ignore"):
        share = np.abs(answers.outputs - samples.outputs)[good] / samples.scales[good]
    # Outputs that are exactly equal agree even where the scale is 0.
    share[(answers.outputs == samples.outputs)[good]] = 0.0
    rows: list[tuple[object, ...]] = []
    offset = 0
    for field in operation.outputs:
        part = share[:, offset : offset + field.length]
        worst = float(part.max()) if part.size else 0.0
        rows.append((name, field.name, field.scale, worst, int(good.sum()), int(refused.sum())))
        if not worst <= tolerance:
            faults.append(
                f"{name}.{field.name}: off by {worst:.2g} of its scale ({field.scale}), allowed {tolerance:g}"
            )
        offset += field.length
    return rows, faults
