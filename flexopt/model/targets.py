"""What a problem's end-point shall reach, as validated data: the tables [target] and [motion].

In: tables of a problem file. Out: frozen `Target` and `PathMotion`, and what is wrong between them and [selection]. How
many numbers a target has is the machine's to say.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, cast

from pydantic import ConfigDict

from flexopt.errors import Fault
from flexopt.foundation.arrays import Numbers
from flexopt.foundation.quantities import COORDINATE_MAX, DURATION, Quantity, list_of, numbers_in
from flexopt.model.choices import TARGETS_MAX
from flexopt.model.file_model import FileModel, table_of

# Keys of [target], of which a problem has exactly one, with the keys of [selection] that go with it only.
TargetKind = Literal["end_point", "end_points", "path"]
KINDS: dict[TargetKind, tuple[str, ...]] = {
    "end_point": ("gain", "elbow", "slack"),
    "end_points": ("combine", "shares"),
    "path": (),
}


# The machine says how many, and which of them are angles; the targets how many shares.
_COORDINATE = Quantity("m or rad", low=-COORDINATE_MAX, high=COORDINATE_MAX)
SOME_COORDINATES = numbers_in(_COORDINATE)
# None of a machine that stands where it stands.
PLACEMENT = numbers_in(_COORDINATE, least=0)
SOME_SHARES = numbers_in(Quantity("", above=0.0, high=1e6))
RATES = numbers_in(Quantity("m/s or rad/s", low=0.0, high=1e3))
TIMES = numbers_in(Quantity("s", low=0.0, high=1e6))
_TO_REACH = f"to {TARGETS_MAX} targets, each a list of numbers in m"
_TARGETS, _PATH = (list_of(f"{k} {_TO_REACH}", SOME_COORDINATES, "target {}:", k, TARGETS_MAX) for k in (1, 2))


class Target(FileModel):
    """What the end-point shall reach; a target has a number for each row of the machine's task, m, inertial frame.

    A file has exactly one of the three.

    Attributes:
        end_point: one target, for `flexopt.select`.
        end_points: several, all to be reached from one placement, for `flexopt.select_stand`.
        path: several in order, between which the base may move, for `flexopt.plan_base`.
    """

    model_config = ConfigDict(json_schema_extra={"oneOf": [{"required": [key]} for key in KINDS]})

    end_point: Annotated[Numbers, SOME_COORDINATES] | None = None
    end_points: Annotated[tuple[Numbers, ...], _TARGETS] | None = None
    path: Annotated[tuple[Numbers, ...], _PATH] | None = None

    @property
    def kind(self) -> TargetKind:
        """Which of the three it is."""
        return next(kind for kind in KINDS if getattr(self, kind) is not None)


class PathMotion(FileModel):
    """How a path is gone along; see `flexopt.plan_base`, whose defaults hold for what is left out.

    Attributes:
        times: when each target is due, s, increasing from 0.
        duration: of the whole, s, the times then evenly spaced.
        max_base_rate: of each placement coordinate, or one number for all, m/s and rad/s.
        max_joint_rate: of each actuated joint, or one number for all, rad/s or m/s.
        start: where the base stands at the first target, m and rad.
    """

    times: Annotated[Numbers, TIMES] | None = None
    duration: Annotated[float, DURATION] | None = None
    max_base_rate: Annotated[Numbers, RATES] | None = None
    max_joint_rate: Annotated[Numbers, RATES] | None = None
    start: Annotated[Numbers, PLACEMENT] | None = None


def problem_faults(data: Mapping[str, Any]) -> list[Fault]:
    """Faults that concern several keys at once: of [target], [motion] and [selection]."""
    target, selection, faults = data.get("target"), table_of(data.get("selection")), list[Fault]()
    if selection.get("objective") == "V" and selection.get("weights") is None:
        faults.append(Fault("selection.weights", "objective V = Σ αi wi needs its weights α"))
    if not isinstance(target, Mapping):
        return faults
    given = [key for key in KINDS if cast(Mapping[str, Any], target).get(key) is not None]
    if len(given) != 1:
        one_of = "needs exactly one of end_point, end_points and path"
        return [*faults, Fault("target", f"{one_of}, not {' and '.join(given)}" if given else one_of)]
    if data.get("motion") is not None and given != ["path"]:
        faults.append(Fault("motion", "goes with a path: targets in order, as target.path"))
    faults += [
        Fault(f"selection.{key}", f"goes with target.{kind}, not with target.{given[0]}")
        for kind, keys in KINDS.items()
        for key in keys
        if selection.get(key) is not None and kind != given[0]
    ]
    return faults
