"""Maps of a loop in one posture over what its controller or its machine may have: gains, dead time, soil, payload.

In: a machine in a posture, its loop, two of these and their ranges. Out: a `WorkspaceMap` of how fast the loop decays.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import BaseLike, PointsLike, PostureLike, Progress, RangeLike, Vector
from flexopt.foundation.boundary import of_machine, public
from flexopt.foundation.control import Control
from flexopt.foundation.plain import shown
from flexopt.foundation.quantities import Quantity, pair
from flexopt.loop.evaluation import settings_at
from flexopt.loop.loop_motions import falling
from flexopt.loop.many import decays, expect_decays
from flexopt.loop.settings import LoopSettings
from flexopt.loop.small_motions import DEAD_TIME
from flexopt.loop.uncertainty_box import UncertaintyBox
from flexopt.model import AnyMachine
from flexopt.model.loop import GAINS, LOOP_GAINS, Loop, LoopLike, loop_of_varied
from flexopt.model.uncertainty import LATE, Uncertainty, kind_of, parameters_of, uncertainty_faults
from flexopt.robustness.evaluation import in_words
from flexopt.study.maps.grid import Axis, Grid
from flexopt.study.maps.workspace import TWO_POINTS
from flexopt.study.maps.workspace_map import WorkspaceMap, finished_map, loop_dataset

POINTS = (200, 200)


@dataclass(frozen=True)
class Varied:
    """One of the two that vary.

    Attributes:
        name: a gain, `dead_time`, a parameter, or a word for several;  low, high: ends, in its unit.
        unit, sentence: of it.
        of: what it is of the machine or its dead time; None of a gain.
    """

    name: str
    low: float
    high: float
    unit: str
    sentence: str
    of: Uncertainty | None = None

    def axis(self, points: int) -> Axis:
        """Evenly spaced; in the logarithm of what multiplies."""
        if self.of is None or self.of.factor is not None:
            return Axis(self.name, np.geomspace(self.low, self.high, points), self.unit, self.sentence)
        return Axis(self.name, np.linspace(self.low, self.high, points), self.unit, self.sentence)


def _varied(arguments: Arguments, machine: AnyMachine, field: str, value: Any) -> list[Varied]:
    """The two that vary; notes what does not fit."""
    if not isinstance(value, Mapping) or len(cast(Mapping[Any, Any], value)) != 2:
        sentence = f"must be two names with their (lower, upper): of {', '.join(GAINS)}, {LATE}, stiffness, damping "
        arguments.note(field, f"{sentence}(factors) and the machine's parameters", value)
        return []
    found = list[Varied]()
    for name, ends in cast(Mapping[Any, Any], value).items():
        key = f"{field}[{shown(name)}]"
        if name in GAINS:
            begins_at_0 = isinstance(ends, Sequence) and [*cast(Sequence[Any], ends)][:1] == [0]
            if begins_at_0:
                arguments.note(key, "lower end must be greater than 0, as gains vary along a logarithmic axis", ends)
            positive = pair(Quantity(LOOP_GAINS[name].unit, above=0.0, high=LOOP_GAINS[name].high))
            low, high = arguments.checked(key, (1.0, 2.0) if begins_at_0 else ends, positive, (1.0, 2.0))
            found.append(Varied(name, low, high, "", GAINS[name]))
        else:
            found += _of_machine(arguments, machine, key, name, ends)
    entries = [set(parameters_of(each.of.of, machine)) if each.of else set[int]() for each in found]
    if len(found) == 2 and entries[0] & entries[1]:
        arguments.note(field, "names the same parameter twice", value)
    return found


def _of_machine(arguments: Arguments, machine: AnyMachine, field: str, name: Any, ends: Any) -> list[Varied]:
    table = {"of": name, kind_of(name): ends}
    each = arguments.collect(field, lambda: Uncertainty(**table))
    if not isinstance(each, Uncertainty):
        return []
    faults = [Fault(field, fault.sentence, fault.value) for fault in uncertainty_faults([each], machine)]
    low, high = each.value or each.factor or (0.0, 1.0)
    if low == high:
        faults.append(Fault(field, "is empty: the lower end must be below the upper end", f"{low:g}"))
    arguments.faults += faults
    if each.of == (LATE,):
        return [Varied(name, low, high, "s", "dead time of the loop", each)]
    entries = parameters_of(each.of, machine)
    unit = "1" if each.factor else machine.parameters[entries[0]].unit if entries else ""
    return [Varied(str(name), low, high, unit or "1", f"factor of {name}" if each.factor else str(name), each)]


@public(vary=of_machine(_varied), points=TWO_POINTS)
def map_loop(
    machine: AnyMachine,
    posture: PostureLike,
    vary: Mapping[str, RangeLike],
    *,
    base: BaseLike | None = None,
    control: Control | None = None,
    gravity: bool = False,
    loop: LoopLike | None = None,
    points: PointsLike | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> WorkspaceMap:
    """How fast the sampled loop of one posture decays over a plane of gains, dead time or the machine's numbers.

    The decay of the slowest motion, −ln max|μ| / T with the multipliers μ of the exact sampled loop, as of
    `flexopt.outcome`; positive where the loop is stable. Points are looked at one by one: what lies between them is not
    proven. Under gravity the controller carries the weight of the machine's own numbers, whatever load or springs a
    point has, as of `flexopt.stable_region`: another load draws the arm to where feedback holds it.

    Args:
        machine, posture, base, control, gravity, loop: as of `flexopt.outcome`; without a loop, the machine's own
            included, gains that vary are those of torques.
        vary: two names with their (lower, upper), the first along x: `kp`, `kv`, `ki` (of all task rows alike; evenly
            in the logarithm), `dead_time`, s, `stiffness` or `damping` (factors of all springs or dampers of the
            passive coordinates, evenly in the logarithm), a parameter of the machine, in its unit.
        points: numbers of points (along x, along y); (200, 200).
        threads: how many to compute with; all processors by default. The numbers do not depend on it.
        progress: called with the number of loops done and of all.

    Returns:
        A map with `decay`, 1/s, and `loop_frequency_hz`, of the slowest motion, over the two axes; NaN where the arm
        falls, for feedback is not found to hold the load.

    Raises:
        InputError, SingularPosture, NoSolutionFound: as `flexopt.outcome`, and where a parameter moves the end-point.

    Example:
        >>> machine, gains = flexopt.load("excavator"), {"kp": (1e3, 1e5), "dead_time": (0, 0.02)}
        >>> found = flexopt.map_loop(machine, (0.0448, -2.0499), gains, loop={"kv": 1e3}, points=(20, 20))
        >>> found.dataset["decay"].dims
        ('dead_time', 'kp')
    """
    size = POINTS if points is None else cast(tuple[int, int], points)
    x, y = cast(list[Varied], vary)
    asked = loop_of_varied(cast("Loop | None", loop), machine, [each.name for each in (x, y)])
    held = cast(Vector, posture)
    known_base = cast("Vector | None", base)
    settings, placed = settings_at(machine, held, known_base, control, asked, gravity=gravity, call="map_loop")
    box = UncertaintyBox(machine, tuple(each.of for each in (x, y) if each.of), settings.dead_time)
    raise_if_any(InputError, "map_loop", _unfit(settings, box, (x, y)))
    gain_units = dict[str, str](zip(GAINS, settings.gain_units, strict=True))
    x, y = (replace(each, unit=gain_units.get(each.name, each.unit) or "1") for each in (x, y))
    columns, rows = x.axis(size[0]), y.axis(size[1])
    count = columns.values.size * rows.values.size
    expect_decays(count, machine, settings, gravity=gravity, own_model=True)
    over = {x: np.tile(columns.values, rows.values.size), y: np.repeat(rows.values, columns.values.size)}
    p, late = box.numbers_at(np.array([values for each, values in over.items() if each.of]).reshape(-1, count))
    varied = {"p": p, DEAD_TIME: late[None]}
    varied |= {each.name: np.tile(values, (getattr(settings, each.name).size, 1))
               for each, values in over.items() if not each.of}  # fmt: skip
    varied |= {"base": np.tile(placed[:, None], count), "posture": np.tile(held[:, None], count)}
    result = decays(machine, settings, varied, gravity=gravity, own_model=True, threads=threads, progress=progress)
    # The rate that stands for an arm that falls is no rate to draw.
    falls = result.decay <= falling(settings.rate)
    result.decay[falls] = result.frequency_hz[falls] = math.nan
    shape = rows.values.size, columns.values.size
    where = np.broadcast_to(held[:, None, None], (held.size, *shape))
    grid = Grid(
        rows, columns, where, np.ones(shape, dtype=bool), np.broadcast_to(placed[:, None, None], (placed.size, *shape))
    )
    options = {"control": settings.control, "gravity": gravity, "over": "loop", "posture": held.tolist(),
               "base": placed.tolist(), "vary": {each.name: [each.low, each.high] for each in (x, y)},
               "points": list(size), "loop": settings.to_dict()}  # fmt: skip
    dataset = loop_dataset(grid, result, machine)
    present = {each.name: _present(machine, settings, each) for each in (x, y)}
    # Numbers that nobody gave follow from the machine.
    name = "proposed" if {x.name, y.name} & (settings.sources.keys() - {DEAD_TIME}) else "present"
    marks = {name: (present[x.name], present[y.name])} if all(map(math.isfinite, present.values())) else {}
    marks = {name: at for name, at in marks.items() if x.low <= at[0] <= x.high and y.low <= at[1] <= y.high}
    title = f"{machine.name}: loop over {x.name} and {y.name}"
    frame = f"one posture, {in_words(machine.joints, held, machine.joint_units)}"
    told = {"loop": f"{repr(settings).splitlines()[0]}; {x.name} and {y.name} as they vary"}
    return finished_map(machine, options, dataset, title, frame, marks, told)


def _unfit(settings: LoopSettings, box: UncertaintyBox, varied: tuple[Varied, ...]) -> list[Fault]:
    """What a loop has not, what moves the end-point, and dead times beyond what a loop is told of."""
    faults = list[Fault]()
    if settings.feedback != "pid" and any(each.name == "ki" for each in varied):
        faults.append(Fault("vary['ki']", "needs a loop with feedback = 'pid'"))
    for each in varied:
        if each.of:
            alone = replace(box, uncertainty=(each.of,))
            faults += [Fault(f"vary[{each.name!r}]", f.sentence, f.value) for f in alone.faults(settings.rate)]
    return faults


def _present(machine: AnyMachine, settings: LoopSettings, each: Varied) -> float:
    """Where the loop is now; NaN where its rows differ."""
    if each.of is None:
        gains = getattr(settings, each.name)
        return float(gains[0]) if np.all(gains == gains[0]) else math.nan
    if each.of.of == (LATE,):
        return settings.dead_time
    return 1.0 if each.of.factor else float(machine.parameters[parameters_of(each.of.of, machine)[0]].value)
