"""What a problem's end-point shall reach, as validated data: the tables [target] and [motion].

In: tables of a problem file. Out: frozen `Target` and `PathMotion`, and what is wrong between them and [selection]. How
many numbers a target has is the machine's to say.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, cast

from flexopt.errors import Fault
from flexopt.foundation.quantities import COORDINATE_MAX, check_number, check_numbers, checked
from flexopt.model.file_model import FileModel, table_of

TARGETS_MAX = 1000
RATE_MAX, TIME_MAX, SHARE_MAX = 1e3, 1e6, 1e6
# Keys of [target], of which a problem has exactly one, with the keys of [selection] that go with it only.
TargetKind = Literal["end_point", "end_points", "path"]
KINDS: dict[TargetKind, tuple[str, ...]] = {
    "end_point": ("gain", "elbow", "slack"),
    "end_points": ("combine", "shares"),
    "path": (),
}
Numbers = tuple[float, ...]


def check_any_numbers(value: Any) -> Numbers:
    """One number or several, m or rad; the machine says how many."""
    return _numbers(value, "m or rad", -COORDINATE_MAX, COORDINATE_MAX)


def check_any_shares(value: Any) -> Numbers:
    """Shares of targets in a sum; their number is the targets'."""
    return _numbers(value, "", 0.0, SHARE_MAX)


def _numbers(value: Any, unit: str, low: float, high: float) -> Numbers:
    parts = list(cast(list[Any], value)) if isinstance(value, list | tuple) else [value]
    if not parts:
        raise ValueError("must be a number or a list of numbers")
    return check_numbers(parts, [f"entry {i + 1}" for i in range(len(parts))], unit, low=low, high=high)


def _check_targets(value: Any, least: int) -> tuple[Numbers, ...]:
    rows = list(cast(list[Any], value)) if isinstance(value, list | tuple) else []
    if not least <= len(rows) <= TARGETS_MAX:
        raise ValueError(f"must be a list of {least} to {TARGETS_MAX} targets, each a list of numbers in m")
    targets: list[Numbers] = []
    sentences: list[str] = []
    for k, row in enumerate(rows, 1):
        try:
            targets.append(check_any_numbers(row))
        except ValueError as error:
            sentences.append(f"target {k}: {error}")
    if sentences:
        raise ValueError("; ".join(sentences))
    return tuple(targets)


def _check_end_points(value: Any) -> tuple[Numbers, ...]:
    return _check_targets(value, 1)


def _check_path(value: Any) -> tuple[Numbers, ...]:
    return _check_targets(value, 2)


def _check_rates(value: Any) -> Numbers:
    return _numbers(value, "m/s or rad/s", 0.0, RATE_MAX)


def _check_times(value: Any) -> Numbers:
    return _numbers(value, "s", 0.0, TIME_MAX)


def _check_duration(value: Any) -> float:
    return check_number(value, "s", above=0.0, high=TIME_MAX)


class Target(FileModel):
    """What the end-point shall reach; a target has a number for each row of the machine's task, m, inertial frame.

    A file has exactly one of the three.

    Attributes:
        end_point: one target, for `flexopt.select`.
        end_points: several, all to be reached from one placement, for `flexopt.select_stand`.
        path: several in order, between which the base may move, for `flexopt.plan_base`.
    """

    end_point: Annotated[Numbers, checked(check_any_numbers)] | None = None
    end_points: Annotated[tuple[Numbers, ...], checked(_check_end_points)] | None = None
    path: Annotated[tuple[Numbers, ...], checked(_check_path)] | None = None

    @property
    def kind(self) -> TargetKind:
        """Which of the three it is."""
        return next(kind for kind in KINDS if getattr(self, kind) is not None)


class PathMotion(FileModel):
    """How a path is gone along; see `flexopt.plan_base`, whose defaults hold for what is left out.

    Attributes:
        times: when each target is due, s, increasing from 0;  duration: of the whole, s, the times then evenly spaced.
        max_base_rate: of each placement coordinate, or one number for all, m/s and rad/s.
        max_joint_rate: of each actuated joint, or one number for all, rad/s or m/s.
        start: where the base stands at the first target, m and rad.
    """

    times: Annotated[Numbers, checked(_check_times)] | None = None
    duration: Annotated[float, checked(_check_duration)] | None = None
    max_base_rate: Annotated[Numbers, checked(_check_rates)] | None = None
    max_joint_rate: Annotated[Numbers, checked(_check_rates)] | None = None
    start: Annotated[Numbers, checked(check_any_numbers)] | None = None


def problem_faults(data: Mapping[str, Any]) -> list[Fault]:
    """Faults that concern several keys at once: of [target], [motion] and [selection]."""
    target, selection, faults = data.get("target"), table_of(data.get("selection")), list[Fault]()
    if selection.get("objective") == "V" and "weights" not in selection:
        faults.append(Fault("selection.weights", "objective V = Σ αi wi needs its weights α"))
    if not isinstance(target, Mapping):
        return faults
    given = [key for key in KINDS if key in cast(Mapping[str, Any], target)]
    if len(given) != 1:
        one_of = "needs exactly one of end_point, end_points and path"
        return [*faults, Fault("target", f"{one_of}, not {' and '.join(given)}" if given else one_of)]
    if "motion" in data and given != ["path"]:
        faults.append(Fault("motion", "goes with a path: targets in order, as target.path"))
    faults += [
        Fault(f"selection.{key}", f"goes with target.{kind}, not with target.{given[0]}")
        for kind, keys in KINDS.items()
        for key in keys
        if key in selection and kind != given[0]
    ]
    return faults
