"""The parts of a bundle. A part is one entry of `PARTS` and becomes one C file.

In: nothing. Out: for each part its title and what builds its operations from a `Context`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from flexopt.export.context import Context
from flexopt.export.control import controller, kinematics
from flexopt.export.modal import margin, measures, nullspace
from flexopt.export.operations import Operation


@dataclass(frozen=True)
class Part:
    """A selectable part: one C file.

    Attributes:
        title: what it is for.
        build: its operations.
    """

    title: str
    build: Callable[[Context], tuple[Operation, ...]]


PARTS: dict[str, Part] = {
    "kinematics": Part("end-point and Jacobians", kinematics),
    "controller": Part("task-space controller step", controller),
    "measures": Part("measures w_i, V and its gradient", measures),
    "nullspace": Part("nullspace update of base and joints", nullspace),
    "margin": Part("robust stability margin", margin),
}
