"""Gains that suit a machine, for closed loops of which nobody said more.

In: a machine in a configuration. Out: Kp, Kv and the damping of an arm's self-motion, as `flexopt.simulate` takes them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from flexopt.errors import FlexoptError
from flexopt.loop.gains import rigid_gains
from flexopt.model import AnyMachine
from flexopt.robustness import Evaluation
from flexopt.simulation import sampled_loop

# How often the corner is halved in search of a stable loop.
HALVINGS = 6


def default_gains(
    machine: AnyMachine, stand: Evaluation, rate: float, loop: Mapping[str, Any] | None = None
) -> dict[str, float]:
    """`rigid_gains` with the highest corner, halved again and again, whose sampled linear loop is stable, exactly.

    Where none of them is (no PD control may be, in a posture), those of the highest corner.

    Args:
        machine: the machine.
        stand: its configuration, and control.
        rate: of the samples, Hz.
        loop: further options of `flexopt.sampled_loop`: sensor, actuator and the like.
    """
    options: dict[str, Any] = {"control": stand.control, "rate": rate} | dict(loop or {})
    options = {name: value for name, value in options.items() if name not in ("integrator", "substeps")}
    for halving in range(HALVINGS + 1):
        gains = rigid_gains(machine, stand, rate, 0.5**halving)
        here: dict[str, Any] = gains | options | {"base": stand.base}
        try:
            stable = sampled_loop(machine, stand.posture, **here).stable
        except FlexoptError:
            break
        if stable:
            return gains
    return rigid_gains(machine, stand, rate)
