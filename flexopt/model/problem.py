"""A configuration problem as validated data: a machine, a target for its end-point, and how to choose."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Annotated, Any, Literal, cast

from pydantic import Field, PrivateAttr

from flexopt.model.machine import AnyMachine, FileModel
from flexopt.model.quantities import (
    COORDINATE_MAX,
    BaseRange,
    check_number,
    check_numbers,
    check_schema,
    checked,
    coordinate_max,
)

Control = Literal["inverse", "transpose"]
Elbow = Literal["up", "down"]
CONTROLS: tuple[Control, ...] = ("inverse", "transpose")
ELBOWS: tuple[Elbow, ...] = ("up", "down")
SINGULARITY_MARGIN_DEG = 10.0
STARTS_MAX = 10_000


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


def check_point(value: Any) -> tuple[float, ...]:
    """A point in the plane, inertial frame, m."""
    if not isinstance(value, list | tuple) or len(cast(list[Any], value)) != 2:
        raise ValueError("must be two numbers x, y in m, inertial frame")
    return check_numbers(cast(list[Any], value), ["x", "y"], "m", low=-COORDINATE_MAX, high=COORDINATE_MAX)


def check_margin_deg(value: Any) -> float:
    """An angle from singular postures, degrees."""
    return check_number(value, "°", low=0.01, high=80.0)


def check_gain(value: Any) -> float:
    """The servo gain kr of ε_max."""
    return check_number(value, "", above=0.0, high=1e15)


def check_starts(value: Any) -> int:
    """How many starts at most."""
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= STARTS_MAX:
        raise ValueError(f"must be a whole number between 1 and {STARTS_MAX}")
    return value


def check_seed(value: Any) -> int:
    """A seed."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**32:
        raise ValueError("must be a whole number between 0 and 2³² − 1")
    return value


def check_base(value: Any) -> tuple[float, ...]:
    """A placement of a planar machine: one number x in m (alone or in a list)."""
    return check_placement(value, ("x",), ("m",))


def check_placement(value: Any, names: Sequence[str], units: Sequence[str]) -> tuple[float, ...]:
    """A number for each placement coordinate; one alone needs no list."""
    parts = list(cast(list[Any], value)) if isinstance(value, list | tuple) else [value]
    if len(parts) != len(names):
        count = "one number" if len(names) == 1 else f"{len(names)} numbers"
        listed = ", ".join(f"{name}, in {unit}" for name, unit in zip(names, units, strict=True))
        raise ValueError(f"must be {count}: the machine is placed by {listed or 'nothing'}")
    numbers: list[float] = []
    sentences: list[str] = []
    for part, name, unit in zip(parts, names, units, strict=True):
        try:
            numbers.append(check_number(part, unit, low=-coordinate_max(unit), high=coordinate_max(unit)))
        except ValueError as error:
            sentences.append(f"{name} {error}" if len(names) > 1 else str(error))
    if sentences:
        raise ValueError("; ".join(sentences))
    return tuple(numbers)


class Target(FileModel):
    """Where the end-point shall be."""

    end_point: Annotated[tuple[float, ...], checked(check_point)]


class SelectionOptions(FileModel):
    """How to choose among the configurations that reach the target (keys of `[selection]`)."""

    objective: Annotated[str, checked(check_objective)] = "w1"
    weights: Annotated[tuple[float, ...], checked(check_weights)] | None = None
    control: Control = "inverse"
    gravity: bool = False
    gain: Annotated[float, checked(check_gain)] = 5e5
    base: Annotated[tuple[float, ...], checked(check_base)] | None = None
    base_range: BaseRange | None = None
    elbow: Elbow = "up"
    singularity_margin_deg: Annotated[float, checked(check_margin_deg)] = SINGULARITY_MARGIN_DEG
    starts: Annotated[int, checked(check_starts)] | None = None
    seed: Annotated[int, checked(check_seed)] = 0


class Problem(FileModel):
    """A configuration problem (`flexopt.load_problem` reads one from a file)."""

    schema_version: Annotated[int, checked(check_schema)] = Field(default=1, alias="schema")
    name: str = Field(min_length=1)
    description: str = ""
    source: str = ""
    machine: str = Field(min_length=1)
    target: Target
    selection: SelectionOptions = SelectionOptions()

    _loaded: AnyMachine | None = PrivateAttr(default=None)

    def with_machine(self, machine: AnyMachine) -> Problem:
        """The same problem, holding its machine."""
        twin = self.model_copy()
        twin._loaded = machine
        return twin

    @property
    def loaded_machine(self) -> AnyMachine:
        """The machine that the file names."""
        assert self._loaded is not None
        return self._loaded

    def select_arguments(self) -> dict[str, Any]:
        """The arguments of `flexopt.select` that the file amounts to."""
        return {"machine": self.loaded_machine, "target": self.target.end_point} | self.selection.model_dump()
