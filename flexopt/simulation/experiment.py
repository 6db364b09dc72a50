"""A simulation as a file describes it.

In: an `Experiment`. Out: its `Trajectory`.
"""

from __future__ import annotations

from typing import Any

from flexopt.compiled.turns import in_turn
from flexopt.errors import InputError
from flexopt.model import Experiment
from flexopt.plant import inverse_kinematics
from flexopt.selection import nullspace_trajectory
from flexopt.simulation.run import simulate
from flexopt.simulation.trajectory import Trajectory


@in_turn
def run_experiment(experiment: Experiment, **overrides: Any) -> Trajectory:
    """Run what a file describes.

    With a table `[nullspace]` the base moves by the nullspace law from the posture and placement of `[simulation]`.

    Args:
        experiment: from `flexopt.load_experiment`.
        overrides: arguments of `flexopt.simulate` that take the place of the file's.

    Raises:
        InputError and others: as `flexopt.simulate` and `flexopt.nullspace_trajectory`; or the file gives both a
            `base_path` and `[nullspace]`.
    """
    machine, options = experiment.loaded_machine, experiment.simulation
    given = {name: getattr(options, name) for name in options.model_fields_set} | overrides
    if "posture" in overrides:
        given.pop("end_point", None)
    elif "end_point" in overrides:
        given.pop("posture", None)
    law = experiment.nullspace
    if law is None:
        return simulate(machine, **given)
    if given.get("base_path") is not None:
        raise InputError(f"{experiment.name}: base_path and [nullspace] both move the base; give one of them")
    base, posture = given.get("base", 0.0), given.get("posture")
    gravity, control = bool(given.get("gravity", False)), given.get("control", "inverse")
    if posture is None:
        elbow = given.get("elbow", "up")
        posture = inverse_kinematics(machine, given["end_point"], base=base, gravity=gravity, elbow=elbow)[0]
    climb = nullspace_trajectory(
        machine, posture, base=base, control=control, gravity=gravity, gain=given.get("gain", 5e5),
        rate=given.get("rate", 200.0), **law.model_dump(),
    )  # fmt: skip
    return simulate(machine, **given, base_path=climb.path)
