"""The parts of a bundle. A part is one entry of `PARTS` and becomes one C file.

In: nothing. Out: for each part its title and what builds its operations from a `Context`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from flexopt.export.context import Context
from flexopt.export.control import controller, kinematics
from flexopt.export.hydraulic import levers, levers_refusal
from flexopt.export.loop_step import loop_step
from flexopt.export.modal import margin, measures, nullspace
from flexopt.export.operations import Operation
from flexopt.export.simulator import simulator
from flexopt.model import AnyMachine


def _takes_all(_: AnyMachine) -> str:
    return ""


@dataclass(frozen=True)
class Part:
    """A selectable part: one C file.

    Attributes:
        title: what it is for.
        build: its operations.
        refusal: why a machine cannot have it, in a sentence; empty where it can.
    """

    title: str
    build: Callable[[Context], tuple[Operation, ...]]
    refusal: Callable[[AnyMachine], str] = _takes_all


# The part that only a bundle with a loop has.
LOOP = "loop"
PARTS: dict[str, Part] = {
    "kinematics": Part("end-point and Jacobians", kinematics),
    "controller": Part("task-space controller step", controller),
    LOOP: Part("one sample of the machine's real controller, of a [loop] that is given", loop_step),
    "levers": Part("lever commands of hydraulic cylinders", levers, refusal=levers_refusal),
    "measures": Part("measures w_i, V and its gradient", measures),
    "nullspace": Part("nullspace update of base and joints", nullspace),
    "margin": Part("robust stability margin", margin),
    "simulator": Part("one step of the machine, for hardware in the loop", simulator),
}
