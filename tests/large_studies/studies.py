"""Small studies, and what of their folders is compared."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import flexopt


def small(**changes: Any) -> flexopt.Study:
    """w of the excavator at 600 points in five chunks, of which the last is smaller."""
    table: dict[str, Any] = {
        "name": "small", "machine": "excavator", "compute": "measures", "quantities": ["w", "w_posture"], "chunk": 128,
        "vary": [
            {"of": "posture.boom", "value": [0.1, 1.4], "count": 10},
            {"of": "posture.stick", "value": [-2.8, 0.0], "count": 12},
            {"of": "stiffness", "factor": [0.5, 2.0], "count": 5},
        ],
    }  # fmt: skip
    return flexopt.Study(**(table | changes))


def files(folder: Path) -> dict[str, bytes]:
    """The study and its chunks, byte by byte."""
    found = {path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*.nc"))}
    return found | {"study.json": (folder / "study.json").read_bytes()}
