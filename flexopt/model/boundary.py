"""What the boundary knows of machines and problems, by the argument's name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexopt.errors import ImplausibleMachine, InputError, ModelError
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.boundary import TABLE, ArgumentCheck, by, flag, of_machine, words
from flexopt.foundation.coordinates import check_base_range
from flexopt.foundation.quantities import entries
from flexopt.foundation.warned import warn_user
from flexopt.model.choices import (
    ELBOWS,
    GAIN,
    MARGIN_DEG,
    SEED,
    SLACK_SHARE,
    STARTS,
    TARGETS_MAX,
    check_assume,
    check_objective,
    check_weights,
)
from flexopt.model.file_model import read_table, validated
from flexopt.model.loop import check_loop
from flexopt.model.machine import AnyMachine
from flexopt.model.plausibility import distant_ranges, warn_weightless
from flexopt.model.uncertainty import Uncertainty, ranges_by_place, uncertainty_faults


def targets(least: int) -> ArgumentCheck:
    """Several targets of the machine's task, (K, n_task), m."""

    def check(arguments: Arguments, machine: AnyMachine, field: str, value: Any) -> NDArray[np.float64] | None:
        listed = arguments.checked(field, value, entries, None)
        if listed is None:
            return None
        if not least <= len(listed) <= TARGETS_MAX:
            arguments.note(field, f"must be a list of {least} to {TARGETS_MAX} targets", value)
            return None
        return np.array([arguments.point(row, f"{field}[{k}]", machine) for k, row in enumerate(listed)])

    return of_machine(check)


def _machine(arguments: Arguments, field: str, value: Any) -> Any:
    if not isinstance(value, AnyMachine):
        arguments.note(field, 'must be a Machine, from flexopt.load("excavator") for example', value)
        return None
    arguments.of = value
    return value


def holding_machine(kind: type, sentence: str) -> ArgumentCheck:
    """A problem or an experiment, which must hold its machine."""

    def check(arguments: Arguments, field: str, value: Any) -> Any:
        if not isinstance(value, kind):
            arguments.note(field, f"must be {sentence}", value)
            return value
        try:
            arguments.of = value.loaded_machine
        except ModelError as error:
            arguments.note(field, str(error), value.name)
        return value

    return check


def _base_range(arguments: Arguments, machine: AnyMachine, field: str, value: Any) -> Any:
    names, units = machine.base_coordinates, machine.base_units
    return arguments.checked(field, value, lambda v: check_base_range(v, names, units), None)


def _constraints(arguments: Arguments, field: str, value: Any) -> Any:
    from flexopt.model.constraints import read_constraints  # noqa: PLC0415  (which few calls need)

    return arguments.collect(field, lambda: read_constraints(value))


def _gravity(arguments: Arguments, field: str, value: Any) -> Any:
    wanted = flag(arguments, field, value)
    if isinstance(arguments.of, AnyMachine):
        warn_weightless(arguments.of, asked=wanted is True)
    return wanted


def _ranges(arguments: Arguments, machine: AnyMachine, field: str, value: Any) -> Any:
    """A table from names to (lower, upper), or a list of `Uncertainty`s or of their tables."""
    given: Any = arguments.checked(field, value, lambda v: v, [])
    if isinstance(given, Mapping | list | tuple) and not given and not arguments.faulty(field):
        arguments.note(field, "must not be empty", value)
    tables = ranges_by_place(given)
    found = [arguments.collect(f"{field}{where}", lambda each=each: _uncertain(each)) for where, each in tables.items()]
    known = tuple(each for each in found if each is not None)
    if len(known) == len(tables):
        arguments.faults += uncertainty_faults(known, machine, field)
        for finding in () if arguments.faults else distant_ranges(machine, known):
            warn_user(str(finding), ImplausibleMachine)
    return known


def _uncertain(given: Any) -> Uncertainty:
    if isinstance(given, Uncertainty):
        return given
    return validated(Uncertainty, read_table(given, "an entry", "[[uncertainty]]", InputError), "", kind=InputError)


TABLE.update(
    {
        "machine": _machine,
        "gravity": _gravity,
        "loop": of_machine(check_loop),
        "ranges": of_machine(_ranges),
        "elbow": words(*ELBOWS),
        "gain": by(GAIN),
        "singularity_margin_deg": by(MARGIN_DEG),
        "seed": by(SEED),
        "slack": by(SLACK_SHARE),
        "starts": by(STARTS),
        "objective": by(check_objective),
        "weights": by(check_weights),
        "assume": by(check_assume),
        "base_range": of_machine(_base_range),
        "constraints": _constraints,
    }
)
