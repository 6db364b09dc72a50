"""Choices where modes exchange their numbers, against another method: `python -m benchmarks.edges`.

Weights of neighbouring modes that differ as much as can be, and tool angles that leave little: V jumps where two
frequencies meet, and the most that can be had often lies at that edge. Else as `benchmarks.choice`.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from benchmarks.choice import Other, Row, beside, chosen, compare
from flexopt.foundation.arrays import Vector

CASES, WEIGHTS = 40, (0.0, 0.02, 0.05, 0.2, 0.5, 1.0)


def uneven(name: str, number: int) -> tuple[Any, Vector, dict[str, Any]]:
    """A machine, a random target that it reaches, and options of `flexopt.select`."""
    machine, target, options = chosen(name, number)
    rng = np.random.default_rng([number, len(name)])
    weights = rng.choice(WEIGHTS, len(options["weights"]))
    weights[int(rng.integers(len(weights)))] = 1.0
    low = float(rng.uniform(-1.6, 0.0))
    kinds = {"tool_angle": [low, low + 0.5]} if len(machine.joints) > 2 else None
    return machine, target, options | {"weights": weights.tolist(), "constraints": kinds}


def examined(samples: int, case: tuple[str, int]) -> Row:
    """As `beside`."""
    return beside(samples, case, uneven(*case), functools.partial(Other, seed=case[1]))


if __name__ == "__main__":
    compare(__doc__ or "", CASES, examined)
