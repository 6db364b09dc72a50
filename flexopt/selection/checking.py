"""A machine, problem or experiment looked over before anything is computed: its faults, and what is hardly meant."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from flexopt.errors import Fault, FlexoptWarning, ModelError
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Document
from flexopt.foundation.boundary import TABLE, instance, path, public
from flexopt.foundation.documents import provenance
from flexopt.foundation.escapes import toml_key
from flexopt.foundation.plain import counted
from flexopt.foundation.results import Result
from flexopt.model import AnyMachine, Problem, load_file
from flexopt.model.constraints import Constraints
from flexopt.model.files import KINDS, ROBOT_SUFFIXES, read_source
from flexopt.model.plausibility import REACH_MAX, WITHIN, ImplausibleNumber, distant_ranges
from flexopt.model.simulation import Experiment
from flexopt.model.study import Study
from flexopt.model.study_file import study_from
from flexopt.robustness.plausibility import implausibilities, slow_rate
from flexopt.selection.assumed import left_out
from flexopt.selection.problem_file import problem_refusals

# A start displacement beyond this, rad, is a quarter turn: hardly a disturbance.
OFFSET_MAX = math.pi / 2
NAME_SHOWN = 200


@dataclass(frozen=True)
class Check(Result):
    """What `flexopt.check` found.

    Attributes:
        name: of what was looked at, or the path that was given.
        kind: `"machine"`, `"problem"`, `"experiment"`, `"study"` or `"robot"` (a URDF or MJCF file); None where it
            could not be told.
        machine: the machine's name; None where it could not be read.
        faults: what must be mended before anything can be computed.
        findings: numbers that are allowed but hardly meant.
        warnings: sentences of the reader about what it left out or found odd.

    Example:
        >>> found = flexopt.check("excavator")
        >>> found.faults, found.findings
        ((), ())
    """

    DOCUMENT = "status name kind machine faults findings warnings provenance"

    name: str
    kind: str | None
    machine: str | None
    faults: tuple[Fault, ...]
    findings: tuple[ImplausibleNumber, ...]
    warnings: tuple[str, ...]
    provenance: Document = field(repr=False)

    @property
    def status(self) -> str:
        """`"faults"`, `"warnings"` or `"good"`."""
        return "faults" if self.faults else "warnings" if self.findings or self.warnings else "good"

    def __repr__(self) -> str:
        counts = (
            (len(self.faults), "fault", ""),
            (len(self.findings), "number that is hardly meant", "numbers that are hardly meant"),
            (len(self.warnings), "warning", ""),
        )
        told = ", ".join(counted(*each) for each in counts if each[0]) or "nothing to mend"
        lines = [f"{self.kind or 'file'} {self.name!r}: {told}"]
        lines += [f"  fault: {fault}" for fault in self.faults]
        lines += [f"  hardly meant: {finding}" for finding in self.findings]
        return "\n".join([*lines, *(f"  warning: {sentence}" for sentence in self.warnings)])


def _given(arguments: Arguments, field: str, value: Any) -> Any:
    if isinstance(value, str | os.PathLike):
        return path(limited=False)(arguments, field, value)
    if isinstance(value, Problem | Experiment):
        return TABLE["problem" if isinstance(value, Problem) else "experiment"](arguments, field, value)
    sentence = "a machine, a problem, an experiment or a study, or the name or path of one"
    return instance((AnyMachine, Study), sentence)(arguments, field, value)


@public(machine_or_path=_given)
def check(machine_or_path: AnyMachine | Problem | Experiment | Study | str | os.PathLike[str]) -> Check:
    """Every fault of a file, and every number of its machine that is allowed but hardly meant.

    Looked for are slips of unit: kN for N, mm for m, tonnes and grams, degrees, inertia about the pivot. A link's
    radius of gyration is compared with its length, springs and drives with the weight that they carry, the total mass
    with the square of the reach, the first mode with 0.1 to 100 Hz and with the loop's rate, modal damping with the
    critical one, the reach with 100 m, ranges of what is uncertain with the file's own number. Three or more bodies of
    an arm that have the same mass and inertia though one is longer than another have placeholders for them. Faults of a
    problem are also those that a selection of it refuses.

    Args:
        machine_or_path: a machine, problem, experiment or study, or the name or path of one; a URDF or MJCF file, too.

    Raises:
        InputError: it is none of these. Faults of a file are no error here but part of the result.

    Example:
        >>> import flexopt
        >>> flexopt.check("excavator")
        machine 'excavator': nothing to mend
    """
    if isinstance(machine_or_path, AnyMachine | Problem | Experiment | Study):
        return _checked(machine_or_path, ())
    name = os.fsdecode(machine_or_path)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", FlexoptWarning)
        try:
            if name.lower().endswith(ROBOT_SUFFIXES):
                return _checked_robot(name)
            source = read_source(machine_or_path, KINDS)
            loaded = study_from(source) if "compute" in source.data else load_file(machine_or_path)
        except ModelError as error:
            word = name if len(name) <= NAME_SHOWN else name[: NAME_SHOWN - 3] + "..."
            faults = error.faults or (Fault(word, str(error).removeprefix(f"{name}: ")),)
            return Check(word, None, None, tuple(faults), (), _sentences(caught), provenance())
    return _checked(loaded, _sentences(caught))


def _sentences(caught: list[warnings.WarningMessage]) -> tuple[str, ...]:
    messages = [warning.message for warning in caught]
    return tuple(remark for message in messages if isinstance(message, FlexoptWarning) for remark in message.remarks)


def _checked_robot(name: str) -> Check:
    """A robot file alone: what it says, not yet a machine."""
    from flexopt.model.robots.reading import read_description  # noqa: PLC0415  (readers that few machines need)

    robot, faults = read_description(Path(name), Path(name).name)
    stuck = tuple(
        f"{joint.element.place}: {joint.element.label}: its limits {joint.stuck} leave no room; "
        f"to drive it say others in [joints.{toml_key(joint.name)}] of the machine file"
        for link in robot.links
        for joint in link.joints
        if joint.stuck and joint.drivable
    )
    return Check(robot.name or name, "robot", None, tuple(faults), (), (*robot.warnings, *stuck), provenance())


def _checked(loaded: AnyMachine | Problem | Experiment | Study, sentences: tuple[str, ...]) -> Check:
    machine = loaded if isinstance(loaded, AnyMachine) else loaded.loaded_machine
    kind = "machine" if loaded is machine else type(loaded).__name__.lower()
    found, faults = [*implausibilities(machine)], tuple[Fault, ...]()
    loop = (loaded.loop if isinstance(loaded, AnyMachine | Problem) else None) or machine.loop
    found += slow_rate(machine, loop) if loop is not None else ()
    if isinstance(loaded, Problem):
        asked = loaded.constraints or Constraints()
        found += [*_targets(loaded), *distant_ranges(machine, loaded.uncertainty)]
        found += distant_ranges(machine, asked.within or (), WITHIN)
        refused = problem_refusals(loaded)
        faults = tuple(fault for fault in refused if not _of_the_present(fault))
        sentences = (*sentences, *(str(fault) for fault in refused if _of_the_present(fault)))
        left = left_out(machine, asked)
        sentences = (*sentences, *(f"constraints.{each.name}: {each.sentence}" for each in left))
    elif isinstance(loaded, Experiment):
        found += _offsets(loaded)
    return Check(loaded.name, kind, machine.name, faults, tuple(found), sentences, provenance(machine))


def _of_the_present(fault: Fault) -> bool:
    """Whether it tells what travel counts from and the file does not say, which a call may."""
    return fault.field in ("constraints.travel.base", "constraints.travel.posture") and not fault.value


def _targets(problem: Problem) -> Iterator[ImplausibleNumber]:
    target = problem.target
    given = getattr(target, target.kind)
    points: list[tuple[float, ...]] = [given] if target.kind == "end_point" else list(given)
    for point in points:
        if max(map(abs, point)) > REACH_MAX:
            text = f"[{', '.join(f'{x:g}' for x in point)}] m"
            yield ImplausibleNumber(
                f"target.{target.kind}", text, f"lies beyond {REACH_MAX:g} m", "probably in mm, not m"
            )
            return


def _offsets(experiment: Experiment) -> Iterator[ImplausibleNumber]:
    machine = experiment.loaded_machine
    offset = experiment.simulation.offset or ()
    for joint, unit, value in zip(machine.joints, machine.joint_units, offset, strict=False):
        if unit == "rad" and abs(value) > OFFSET_MAX:
            meant = f"probably degrees: {math.radians(value):.4g} rad"
            yield ImplausibleNumber(
                f"simulation.offset ({joint})", f"{value:g} rad", "is more than a quarter turn", meant
            )
