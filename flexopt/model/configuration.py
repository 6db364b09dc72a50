"""One posture of one machine under one controller: the argument of every call about a posture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexopt.foundation.arrays import BaseLike, PostureLike, Vector
from flexopt.foundation.boundary import Bundle, public, table
from flexopt.foundation.control import Control
from flexopt.foundation.results import Result
from flexopt.model.loop import Loop, LoopLike
from flexopt.model.machine import AnyMachine
from flexopt.model.parameter_values import with_parameters


@dataclass(frozen=True)
class Configuration(Bundle, Result):
    """A machine, where its base stands, how its arm is held, and what controls it; `machine.at(…)` makes one.

    Every call about one posture takes a configuration in place of machine, posture, base, control, gravity and loop.

    Attributes:
        machine: from `flexopt.load`.
        posture: actuated joints (n,), rad or m.
        base: placement (n_b,), m or rad.
        control: `"inverse"`, `"transpose"`, `"damped:LAMBDA"`, or None: the loop's, else the machine's.
        gravity: whether the weight acts.
        loop: the controller, or None: the machine's.

    Example:
        >>> here = flexopt.load("excavator").at((0.0448, -2.0499), loop={"kp": 1e4, "kv": 1e3})
        >>> flexopt.outcome(here).decay > 0
        True
    """

    machine: AnyMachine
    posture: Vector
    base: Vector
    control: Control | None = None
    gravity: bool = False
    loop: Loop | None = None

    DOCUMENT = "machine=machine.name posture base control gravity loop"

    @property
    def arguments(self) -> Mapping[str, Any]:
        """The arguments of a call by name."""
        return {name: getattr(self, name) for name in ("machine", "posture", "base", "control", "gravity", "loop")}


@public("at")
def configuration_at(
    machine: AnyMachine,
    posture: PostureLike,
    *,
    base: BaseLike | None = None,
    control: Control | None = None,
    gravity: bool = False,
    loop: LoopLike | None = None,
) -> Configuration:
    """Make the configuration of `AnyMachine.at`."""
    place = np.zeros(len(machine.base_coordinates)) if base is None else base
    return Configuration(machine, posture, place, control, gravity, loop)  # pyright: ignore[reportArgumentType]


@public("with_values", values=table)
def machine_with_values(machine: AnyMachine, values: Mapping[str, float]) -> AnyMachine:
    """Make the machine of `AnyMachine.with_values`."""
    return with_parameters(machine, values)
