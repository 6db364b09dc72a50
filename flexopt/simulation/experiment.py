"""A simulation as a file describes it.

In: an `Experiment`. Out: its `Trajectory`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Unpack, cast

from flexopt.errors import InputError
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.boundary import anything, public
from flexopt.model.loop import Loop, LoopLike, control_of, rate_of
from flexopt.model.simulation import Experiment, OverrideKeywords
from flexopt.model.simulation_faults import own_loop
from flexopt.selection import nullspace_trajectory
from flexopt.simulation.real_loop import note_loop
from flexopt.simulation.run import simulate
from flexopt.simulation.scenario import checked_options, design_configuration
from flexopt.simulation.trajectory import Trajectory


def _given(experiment: Experiment, overrides: Mapping[str, Any]) -> dict[str, Any]:
    """The file's options, and others in place of some."""
    options, others = experiment.simulation, {k: value for k, value in overrides.items() if value is not None}
    given = {name: getattr(options, name) for name in options.model_fields_set} | others
    if "posture" in others:
        given.pop("end_point", None)
    elif "end_point" in others:
        given.pop("posture", None)
    return given


def _note(arguments: Arguments, given: Mapping[str, Any]) -> None:
    experiment = given["experiment"]
    if experiment is not None:
        options = _given(experiment, given["overrides"])
        arguments.collect("", lambda: checked_options(arguments.call, arguments.of, options))
        note_loop(arguments, options | {"loop": given["loop"] or experiment.loop})


@public(together=_note, overrides=anything)
def run_experiment(
    experiment: Experiment,
    *,
    loop: LoopLike | None = None,
    **overrides: Unpack[OverrideKeywords],
) -> Trajectory:
    """Run what a file describes.

    With a table `[nullspace]` the base moves by the nullspace law from the posture and placement of `[simulation]`.

    Args:
        experiment: from `flexopt.load_experiment`.
        loop: the real controller, as of `flexopt.simulate`, in place of the file's `[loop]`, or else the machine's.
        overrides: arguments of `flexopt.simulate` that take the place of the file's; None leaves the file's.

    Raises:
        InputError and others: as `flexopt.simulate` and `flexopt.nullspace_trajectory`; or the file gives both a
            `base_path` and `[nullspace]`.

    Example:
        >>> flexopt.run_experiment(flexopt.load_experiment("article-a"), duration=5.0).verdict
        'grows'
    """
    machine, given = experiment.loaded_machine, _given(experiment, overrides)
    law, real = experiment.nullspace, cast("Loop | None", loop or experiment.loop) or own_loop(machine, given)
    if law is None:
        return simulate(machine, **given, loop=real)
    if given.get("base_path") is not None:
        raise InputError(f"{experiment.name}: base_path and [nullspace] both move the base; give one of them")
    options = checked_options("run_experiment", machine, given)
    posture, base = design_configuration(machine, options)
    control = control_of(given.get("control"), real, machine)
    climb = nullspace_trajectory(
        machine, posture, base=base, control=control, gravity=options.gravity, gain=options.gain,
        rate=options.rate if real is None else rate_of(real, machine), **law.model_dump(),
    )  # fmt: skip
    whole: dict[str, Any] = given | {"base_path": climb.path}
    return simulate(machine, **whole, loop=real)
