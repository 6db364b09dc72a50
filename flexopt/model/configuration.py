"""One posture of one machine under one controller: the argument of every call about a posture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from flexopt.foundation.arrays import Vector
from flexopt.foundation.boundary import Bundle
from flexopt.foundation.control import Control
from flexopt.foundation.results import Result
from flexopt.model.loop import Loop

if TYPE_CHECKING:
    from flexopt.model.machine import AnyMachine


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
