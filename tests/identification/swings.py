"""One swing of a machine in the plane and one in space, integrated by SciPy, with the truth behind them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

import flexopt
from flexopt.model import AnyMachine
from flexopt.model.parameter_values import with_parameters
from flexopt.model.uncertainty import parameters_of
from tests.oracles.free_swing import FreeSwing


@dataclass(frozen=True)
class Swung:
    """A machine, what its numbers truly are, and how it swings."""

    machine: AnyMachine
    posture: tuple[float, ...]
    truth: dict[str, float]
    swing: FreeSwing
    time: np.ndarray

    def log(self, *columns: str, noise: float = 0.01, seed: int = 0, **more: Any) -> dict[str, np.ndarray]:
        return self.swing.log(columns, self.time, noise, seed, **more)


@cache
def planar() -> Swung:
    return _swung("boom-stick-bucket", (-0.6, -1.2, -0.7), [3e-3, -4e-3, 4e-3], 3.0)


@cache
def spatial() -> Swung:
    return _swung("slewing-excavator", (0.5, 0.09, -1.2, -0.7), [3e-3, -3e-3, 3e-3, 3e-3, 4e-3, -3e-3], 1.5)


def _swung(name: str, posture: tuple[float, ...], displaced: list[float], duration: float) -> Swung:
    machine, rng = flexopt.load(name), np.random.default_rng(4)
    entries = [machine.parameters[i] for i in parameters_of(("stiffness", "damping"), machine)]
    truth = {each.name: each.value * float(np.exp(rng.uniform(-0.5, 0.5))) for each in entries if each.value}
    swing = FreeSwing(with_parameters(machine, truth), posture, displaced, np.zeros(len(displaced)))
    return Swung(machine, posture, truth, swing, np.arange(round(duration * 100) + 1) / 100)
