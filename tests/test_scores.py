"""What the score table says of the machine that its numbers were taken on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from benchmarks.score import this_machine

CORES = "".join(
    f"processor\t: {k}\ncpu family\t: 25\nmodel\t\t: 1\nmodel name\t: AMD EPYC\nstepping\t: 1\ncore id\t\t: {k}\n"
    "flags\t\t: fpu avx512f\n\n"
    for k in range(2)
)


def test_a_processor_is_told_by_family_and_model(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where other lines have the same number, too: scores are kept by processor, and a name alone is that of many."""
    read = Path.read_text

    def shown(path: Path, *arguments: Any, **options: Any) -> str:
        return CORES if path.as_posix() == "/proc/cpuinfo" else read(path, *arguments, **options)

    monkeypatch.setattr(Path, "read_text", shown)
    machine = this_machine()
    assert machine["processor"] == "AMD EPYC, family 25, model 1"
    assert machine["vectors"] == "AVX-512"
