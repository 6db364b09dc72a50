"""A configuration problem as validated data: a machine, a target for its end-point, and how to choose."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal, cast

from pydantic import Field, PrivateAttr

from flexopt.errors import Fault, InputError, ModelError, raise_if_any
from flexopt.foundation.control import Control, check_control
from flexopt.foundation.coordinates import check_base_range
from flexopt.foundation.plain import shown
from flexopt.foundation.quantities import (
    COORDINATE_MAX,
    check_number,
    check_numbers,
    check_pair,
    check_schema,
    check_whole,
    checked,
)
from flexopt.model.constraints import Constraints
from flexopt.model.machine import AnyMachine, FileModel
from flexopt.model.tables import BuiltByCall
from flexopt.model.targets import KINDS, Motion, Target, check_any_numbers, check_any_shares, target_faults

Elbow = Literal["up", "down"]
ELBOWS: tuple[Elbow, ...] = ("up", "down")
# How the targets that share a placement count: the worst one, or all by their shares.
Combine = Literal["worst", "weighted"]
COMBINES: tuple[Combine, ...] = ("worst", "weighted")
SINGULARITY_MARGIN_DEG = 10.0
# The best maxima of the excavator's ε_max differ by 4e-5 of it and more.
SLACK = 1e-5
STARTS_MAX = 10_000
# What the calls that solve a problem name the keys of [target].
TARGET_ARGUMENTS = {"end_point": "target", "end_points": "targets", "path": "path"}
# Coordinates that some machine may be placed by.
PLACEMENTS = ("x", "y", "yaw")


def check_objective(value: Any) -> str:
    """`w1`, `w2`, …, `V`, `epsilon_max`, or several of them in order, separated by commas."""
    words = value.replace(" ", "").split(",") if isinstance(value, str) else []
    if not words or not all(re.fullmatch(r"V|epsilon_max|w[1-9][0-9]?", word) for word in words):
        raise ValueError(
            "must be w1, w2, … (one mode), V (a weighted sum) or epsilon_max, or several of them in order of "
            "importance, separated by commas"
        )
    if len(set(words)) < len(words):
        raise ValueError("names the same objective twice")
    return ",".join(words)


def check_weights(value: Any) -> tuple[float, ...]:
    """The weights α of V = Σ αi wi: non-negative, not all zero."""
    if not isinstance(value, list | tuple) or not value:
        raise ValueError("must be a list of numbers, one for each mode")
    values = cast(list[Any], value)
    weights = check_numbers(values, [f"α{i + 1}" for i in range(len(values))], "", low=0.0, high=1e6)
    if not any(weights):
        raise ValueError("at least one weight must be positive")
    return weights


def check_margin_deg(value: Any) -> float:
    """An angle from singular postures, degrees."""
    return check_number(value, "°", low=0.01, high=80.0)


def check_gain(value: Any) -> float:
    """The servo gain kr of ε_max."""
    return check_number(value, "", above=0.0, high=1e15)


def check_starts(value: Any) -> int:
    """How many starts at most."""
    return check_whole(value, 1, STARTS_MAX)


def check_seed(value: Any) -> int:
    """A seed."""
    return check_whole(value, 0, 2**32 - 1, "2³² − 1")


def check_slack(value: Any) -> float:
    """What an objective may give up for the next one, as a share."""
    return check_number(value, "", low=1e-7, high=1.0)


def _check_any_range(value: Any) -> Any:
    """A range as a file may have it: a pair for a machine placed by x, or a table of pairs."""
    if isinstance(value, Mapping):
        table = cast(Mapping[str, Any], value)
        units = ["rad" if name == "yaw" else "m" for name in PLACEMENTS]
        return check_base_range(table, PLACEMENTS, units)
    return check_pair(value, "m", -COORDINATE_MAX, COORDINATE_MAX, allow_equal=True)


class SelectionOptions(FileModel):
    """How to choose among the configurations that reach the target or targets (keys of `[selection]`).

    `gain`, `elbow` and `slack` go with a single `end_point`, `combine` and `shares` with `end_points`.
    """

    objective: Annotated[str, checked(check_objective)] = "w1"
    weights: Annotated[tuple[float, ...], checked(check_weights)] | None = None
    control: Annotated[Control, checked(check_control)] = "inverse"
    gravity: bool = False
    gain: Annotated[float, checked(check_gain)] = 5e5
    base: Annotated[tuple[float, ...], checked(check_any_numbers)] | None = None
    posture: Annotated[tuple[float, ...], checked(check_any_numbers)] | None = None
    base_range: Annotated[Any, checked(_check_any_range)] | None = None
    elbow: Elbow = "up"
    singularity_margin_deg: Annotated[float, checked(check_margin_deg)] = SINGULARITY_MARGIN_DEG
    starts: Annotated[int, checked(check_starts)] | None = None
    seed: Annotated[int, checked(check_seed)] = 0
    slack: Annotated[float, checked(check_slack)] = SLACK
    combine: Combine = "worst"
    shares: Annotated[tuple[float, ...], checked(check_any_shares)] | None = None


class Problem(BuiltByCall):
    """A configuration problem (`flexopt.load_problem` reads one from a file)."""

    schema_version: Annotated[int, checked(check_schema)] = Field(default=1, alias="schema")
    name: str = Field(min_length=1)
    description: str = ""
    source: str = ""
    machine: str = Field(min_length=1)
    target: Target
    motion: Motion | None = None
    selection: SelectionOptions = SelectionOptions()
    constraints: Constraints | None = None

    _loaded: AnyMachine | None = PrivateAttr(default=None)

    def structural_faults(self) -> list[Fault]:
        """As of a file."""
        from flexopt.model.faults import problem_faults  # noqa: PLC0415  (which knows the tables)

        table = self.model_dump(by_alias=True, exclude_unset=True)
        return [*problem_faults(table), *target_faults(table)]

    def with_machine(self, machine: AnyMachine) -> Problem:
        """The same problem, holding its machine."""
        if not isinstance(machine, AnyMachine):  # pyright: ignore[reportUnnecessaryIsInstance]
            sentence = 'must be a Machine, from flexopt.load("excavator") for example'
            raise_if_any(InputError, "with_machine", [Fault("machine", sentence, shown(machine))])
        twin = self.model_copy()
        twin._loaded = machine
        return twin

    @property
    def loaded_machine(self) -> AnyMachine:
        """The machine that the file names."""
        if self._loaded is None:
            raise ModelError("holds no machine: flexopt.load_problem gives one that does, or with_machine")
        return self._loaded

    def select_arguments(self) -> dict[str, Any]:
        """The arguments that the file amounts to: of `flexopt.select`, `select_stand` or `plan_base`, by its target."""
        kind = self.target.kind
        others = {key for other, keys in KINDS.items() if other != kind for key in keys}
        options = {key: value for key, value in self.selection.model_dump().items() if key not in others}
        options |= {"machine": self.loaded_machine, "constraints": self.constraints}
        options[TARGET_ARGUMENTS[kind]] = getattr(self.target, kind)
        return options | (self.motion or Motion()).model_dump() if kind == "path" else options
