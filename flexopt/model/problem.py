"""A configuration problem as validated data: a machine, a target for its end-point, and how to choose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, TypedDict, cast

from pydantic import Field

from flexopt.errors import Fault
from flexopt.foundation.arrays import BaseLike, BaseRangeLike, Document, PostureLike
from flexopt.foundation.boundary import TABLE
from flexopt.foundation.control import Control, check_control
from flexopt.foundation.coordinates import check_base_range
from flexopt.foundation.quantities import (
    COORDINATE,
    a_list,
    accepting,
    pair,
)
from flexopt.model.boundary import holding_machine
from flexopt.model.choices import (
    EVERYTHING,
    GAIN,
    MARGIN_DEG,
    SEED,
    SINGULARITY_MARGIN_DEG,
    SLACK,
    SLACK_SHARE,
    STARTS,
    Combine,
    Elbow,
    asks_for_loop,
    check_assume,
    check_weights,
)
from flexopt.model.constraints import Constraints
from flexopt.model.file_model import BuiltByCall
from flexopt.model.loop import Loop, control_of
from flexopt.model.machine import OnMachine
from flexopt.model.own import ObjectiveLike, check_objectives
from flexopt.model.targets import (
    KINDS,
    PLACEMENT,
    SOME_COORDINATES,
    SOME_SHARES,
    PathMotion,
    Target,
    TargetKind,
    problem_faults,
)
from flexopt.model.uncertainty import Uncertainty

# What the calls that solve a problem name the keys of [target].
TARGET_ARGUMENTS = {"end_point": "target", "end_points": "targets", "path": "path"}
# Coordinates that some machine may be placed by.
PLACEMENTS = ("x", "y", "yaw")


if TYPE_CHECKING:
    # What those who write options may give; that is checked, and made plain, when they are made.
    _Objective: TypeAlias = ObjectiveLike
    _Base: TypeAlias = BaseLike
    _Posture: TypeAlias = PostureLike
    _BaseRange: TypeAlias = BaseRangeLike
else:
    _Objective = _Base = _Posture = _BaseRange = Any

_RANGES = {name: a_list(COORDINATE["rad" if name == "yaw" else "m"].accepts or {}, 2, 2) for name in PLACEMENTS}


@accepting({"anyOf": [_RANGES["x"], {"type": "object", "properties": _RANGES, "additionalProperties": False}]})
def _check_any_range(value: Any) -> Any:
    """A range as a file may have it: a pair for a machine placed by x, or a table of pairs."""
    if isinstance(value, Mapping):
        table = cast(Mapping[str, Any], value)
        units = ["rad" if name == "yaw" else "m" for name in PLACEMENTS]
        return check_base_range(table, PLACEMENTS, units)
    return pair(COORDINATE["m"], allow_equal=True)(value)


class SelectionOptions(BuiltByCall):
    """How to choose among the configurations that reach a target or targets: the keys of a file's `[selection]`.

    `flexopt.select`, `build_selection`, `select_stand` and `plan_base` take it as their argument `options`, and its
    fields as keywords, too; a keyword goes before the field.

    Attributes:
        objective: `"w1"`, `"w2"`, …, `"epsilon_max"`, or `"V"` = Σ αi wi + β ε_max; or several in order of importance,
            separated by commas: `"w1,epsilon_max"` maximises ε_max among the configurations that keep the best w1 to
            within `slack`. Of several targets: one, without ε_max. Or a `casadi.Function` of named quantities with one
            number as output, which is maximised (page "My own objective and constraints"), alone or in a list
            in order with others: `["w1", f]`.
        weights: α of `"V"`, one for each mode, and β after them where ε_max shall take part.
        control: Jacobian `"inverse"`, `"transpose"` or `"damped:LAMBDA"`, as in `flexopt.evaluate`; by default that of
            the loop, of a call, a problem or the machine, else inverse.
        gravity: measures and end-point under static deflection.
        gain: of a single target: servo gain kr of ε_max.
        base: present placement (n_b,), m or rad: breaks ties and gives the initial posture.
        posture: present posture (n,), rad or m: with `base` the initial configuration. Of several targets, which have a
            posture each, no more than what a cost of travel counts from.
        base_range: where the base may stand: (lower, upper) of x, or a table such as {"x": (lower, upper), "yaw": …}
            with the placement coordinates that are bounded. By default all placements from which the arm reaches, and
            see `assume`; where the task does not say where that is, within the arm's reach of the present placement.
            yaw is free, and its whole turns never count. A verdict does not let the base stay outside of it.
        elbow: of a single target: branch of the initial posture of a planar arm, where no posture is given.
        singularity_margin_deg: distance from singular postures: for two links the angle that θ3 keeps from straight and
            from folded, for more in the root mean square over pairs of segments; in space see
            `Plant.singularity_sine_squared`.
        starts: how many starts are tried at most. By default of a single target 32, and in space, where these leave it
            open what is best, rounds of 8 more for as long as they find better; in the plane every peak of the scan, up
            to 64; of a stand 8 placements where targets leave one degree of freedom, else 32; of a plan 3 ways, besides
            standing still and postures carried along. Points seen on the way to be better are climbed from, too. By
            what the loop does so many of the points that are looked at make some steps, 96 by default; the best 8 of
            where these lead, and the present configuration, are climbed to the end.
        seed: of the sample that the starts come from.
        assume: what holds where nothing else is asked for: `"everything"`, `"nothing"`, or some of
            `"ground,limits,reach"`, see `flexopt.selection.assumed`. `"ground"`: above the ground on which the machine
            stands all keeps that joints move, the end-point's body and targets below ground aside; `"limits"`: joints
            keep the limits of the machine's file; `"reach"`: from the present placement `base`, or zeros of a
            machine on the ground, no coordinate moves farther than the arm reaches. What was assumed is named in the
            result.
        slack: of a single target: what an objective may give up for the next one, as a share of its best value, or of
            Σ αi |a_i||b_i| where that is more: w_i are best at 0. 1e-5 lets a_i and b_i of w_i turn by 0.3° from each
            other.
        combine: of a stand: `"worst"` maximises the smallest V_k, `"weighted"` the sum Σ share_k V_k.
        shares: of the targets in the sum, (K,), positive; even by default.

    Example:
        >>> options = flexopt.SelectionOptions(objective="V", weights=[1, 1, 1], base=0.0, starts=8)
        >>> machine = flexopt.load("excavator")
        >>> print(f"{flexopt.select(machine, (0.0, 1.6), options=options).best.objective:.3e}")
        -1.240e-05
    """

    objective: Annotated[_Objective, check_objectives] = "w1"
    weights: Annotated[tuple[float, ...], check_weights] | None = None
    control: Annotated[Control, check_control] | None = None
    gravity: bool = False
    gain: Annotated[float, GAIN] = 5e5
    base: Annotated[_Base, PLACEMENT] | None = None
    posture: Annotated[_Posture, SOME_COORDINATES] | None = None
    base_range: Annotated[_BaseRange, _check_any_range] | None = None
    elbow: Elbow = "up"
    singularity_margin_deg: Annotated[float, MARGIN_DEG] = SINGULARITY_MARGIN_DEG
    starts: Annotated[int, STARTS] | None = None
    seed: Annotated[int, SEED] = 0
    assume: Annotated[str, check_assume] = EVERYTHING
    slack: Annotated[float, SLACK_SHARE] = SLACK
    combine: Combine = "worst"
    shares: Annotated[tuple[float, ...], SOME_SHARES] | None = None

    @classmethod
    def of(cls, kind: TargetKind) -> tuple[str, ...]:
        """The fields that go with a kind of target.

        Example:
            >>> flexopt.SelectionOptions.of("end_points")[-2:]
            ('combine', 'shares')
        """
        others = {key for other, keys in KINDS.items() if other != kind for key in keys}
        return tuple(name for name in cls.model_fields if name not in others)


class SharedKeywords(TypedDict, total=False):
    """Fields of `SelectionOptions` as keywords of a call, for type checkers: those of every kind of target."""

    objective: ObjectiveLike
    weights: Sequence[float] | None
    control: Control | None
    gravity: bool
    base: BaseLike | None
    posture: PostureLike | None
    base_range: BaseRangeLike | None
    singularity_margin_deg: float
    starts: int | None
    seed: int
    assume: str


class SelectionKeywords(SharedKeywords, total=False):
    """Those of a single target."""

    gain: float
    elbow: Elbow
    slack: float


class StandKeywords(SharedKeywords, total=False):
    """Those of several targets from one placement."""

    combine: str
    shares: Sequence[float] | None


class Problem(OnMachine):
    """A configuration problem (`flexopt.load_problem` reads one from a file).

    Attributes:
        target: what the end-point shall reach.
        motion: how a path is gone along.
        selection: how to choose.
        constraints: what a configuration must keep.
        loop: the real controller; what is left out follows from the machine.
        uncertainty: what nobody has measured; in place of the machine's.

    Example:
        >>> problem = flexopt.load_problem("article")
        >>> problem.target.end_point, problem.machine
        ((0.0, 1.6), 'excavator')
    """

    LOADER = "flexopt.load_problem"
    target: Target
    motion: PathMotion | None = None
    selection: SelectionOptions = Field(default_factory=SelectionOptions)
    constraints: Constraints | None = None
    loop: Loop | None = None
    uncertainty: tuple[Uncertainty, ...] = ()

    def structural_faults(self) -> list[Fault]:
        """As of a file."""
        return problem_faults(self.model_dump(by_alias=True, exclude_unset=True))

    def select_arguments(self) -> Document:
        """The arguments that the file amounts to: of `flexopt.select`, `select_stand` or `plan_base`, by its target.

        Example:
            >>> flexopt.load_problem("article").select_arguments()["target"]
            (0.0, 1.6)
        """
        kind = self.target.kind
        options = {name: getattr(self.selection, name) for name in SelectionOptions.of(kind)}
        options |= {"machine": self.loaded_machine, "constraints": self.constraints}
        options[TARGET_ARGUMENTS[kind]] = getattr(self.target, kind)
        options["control"] = control_of(self.selection.control, self.loop, self.loaded_machine)
        if asks_for_loop(self.selection.objective, self.constraints):
            options |= {"loop": self.loop, "ranges": self.uncertainty or None}
        return options | (self.motion or PathMotion()).model_dump() if kind == "path" else options


def judged_by(problem: Problem, loop: Loop | None, uncertainty: tuple[Uncertainty, ...] | None) -> Problem:
    """A problem with a controller, and with what is uncertain, in place of its own; where None with its own."""
    given = {"loop": loop, "uncertainty": uncertainty}
    return problem.model_copy(update={name: value for name, value in given.items() if value})


TABLE["problem"] = holding_machine(Problem, "a Problem, from flexopt.load_problem")
