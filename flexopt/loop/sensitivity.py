"""Which of the numbers that nobody has measured matters: variance-based indices and derivative-based bounds.

In: a machine in a posture, what is uncertain, and a loop where there is one. Out: `Sensitivity`, for every w_i and the
loop's decay.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from flexopt.errors import Fault, InputError, NoSolutionFound, raise_if_any
from flexopt.foundation.arrays import BaseLike, Document, PostureLike, Vector
from flexopt.foundation.boundary import by, public
from flexopt.foundation.control import Control
from flexopt.foundation.documents import provenance
from flexopt.foundation.pictures import Pictured
from flexopt.foundation.plain import listed, plain
from flexopt.foundation.results import Result
from flexopt.loop.evaluation import settings_at
from flexopt.loop.uncertain import UncertainLoop
from flexopt.loop.uncertainty_box import UncertaintyBox
from flexopt.model import AnyMachine
from flexopt.model.loop import Loop, LoopLike
from flexopt.model.uncertainty import GROUND, LATE, RangesLike, Uncertainty
from flexopt.robustness import build_measures
from flexopt.robustness.batches import w_of_few
from flexopt.robustness.residues import MIXED, residue_unit

# Samples, and those of them where slopes are computed; a power of two, as Sobol sequences have it.
SAMPLES, SLOPES, SLOPES_OF_LOOP = 1024, 512, 128
LEAST, MOST = 64, 2**18
# How often the samples are drawn anew for an interval, and the share of all indices that it holds.
DRAWN, SHARE = 200, 0.95
# A bound on a share of the variance below which it is rounding.
NOTHING = 1e-12
# Share of |a_i||b_i| up to which w_i is none, whatever moves it: a joint that is held a microradian aside makes it.
NEGLIGIBLE = 1e-9


@by
def _samples(value: Any) -> int:
    """How many samples: a power of two."""
    given = plain(value)
    if isinstance(given, bool) or not isinstance(given, int) or not LEAST <= given <= MOST or given & (given - 1):
        raise ValueError(f"must be a power of two between {LEAST} and {MOST}")
    return given


@dataclass(frozen=True)
class Sensitivity(Pictured, Result):
    """Which uncertain number matters for what. s outputs, k uncertain numbers.

    Its picture: for each output the first-order and total indices with their intervals, and the bounds from slopes.

    Attributes:
        machine: its name.
        outputs: `"w1"`, … and, with a loop, `"decay"`.  output_units: theirs.
        names: of what is uncertain.
        first: S_i = Var(E[y | x_i]) / Var(y), (s, k): the share of the variance that x_i explains alone.
        total: S_Ti = 1 − Var(E[y | all but x_i]) / Var(y), (s, k): with all that it does together with others.
        first_interval, total_interval: where they lie, (s, k, 2), 95 % of 200 bootstrap samples.
        bound: ν_i / (π² Var(y)), ν_i = E[(∂y/∂u_i)²] with exact slopes, u_i in [0, 1], (s, k). S_Ti is no larger.
        bound_error: its standard error, (s, k).
        mean, deviation: of each output over the samples, (s,).
        samples: base samples; each output was computed (k + 2) times as often.
        crossing: modes, from 0, that change places within the ranges, or trade shapes, in groups. w_i is of the mode
            with the i-th frequency, whichever that is: of these it jumps, or changes within a little, so that slopes at
            samples are no bound (NaN), and what moves one mode past another seems to matter.
        most: for each output the name with the largest total index; `""` where its interval overlaps that of another,
            or modes change places, so that it cannot be told, or where the output does not vary.

    Example:
        >>> ranges = {"base.stiffness.rotation": (5e5, 2e6), "payload.mass": (0.0, 200.0)}
        >>> found = flexopt.sensitivity(flexopt.load("excavator"), (0.9929, -2.6306), ranges=ranges, samples=256)
        >>> found.most[0]
        'payload.mass'
    """

    machine: str
    outputs: tuple[str, ...]
    output_units: tuple[str, ...]
    names: tuple[str, ...]
    first: Vector
    first_interval: Vector
    total: Vector
    total_interval: Vector
    bound: Vector
    bound_error: Vector
    mean: Vector
    deviation: Vector
    samples: int
    crossing: tuple[tuple[int, ...], ...]
    provenance: Document

    DOCUMENT = """
    machine outputs output_units names first first_interval total total_interval bound bound_error mean deviation
    samples crossing most provenance
    """

    @property
    def most(self) -> tuple[str, ...]:
        """See the class."""
        found: list[str] = []
        crossing = {k for group in self.crossing for k in group}
        for s, (total, ends) in enumerate(zip(self.total, self.total_interval, strict=True)):
            if (s in crossing and len(self.names) > 1) or not np.all(np.isfinite(total)):
                found.append("")
                continue
            best = int(np.argmax(total))
            others = [ends[k, 1] for k in range(len(self.names)) if k != best]
            found.append(self.names[best] if not others or ends[best, 0] > max(others) else "")
        return tuple(found)

    @property
    def said(self) -> tuple[str, ...]:
        """For each output the name of `most`, `undecided` or, where it does not vary, `nothing`."""
        known = [bool(np.isfinite(row).all()) for row in self.total]
        return tuple(
            most or ("undecided" if varies else "nothing") for most, varies in zip(self.most, known, strict=True)
        )

    def _most(self, s: int, k: int) -> str:
        """The bound in words; one of all that varies, or more, says nothing."""
        bound, error = self.bound[s, k], 2 * self.bound_error[s, k]
        if math.isnan(bound):
            return "no bound"
        if bound + error < NOTHING:
            return "does nothing"
        return "no bound below 1" if bound + error >= 1 else f"at most {bound:.3g} ± {error:.2g}"

    def __repr__(self) -> str:
        lines = [f"{self.machine}: what matters, over {', '.join(self.names)} ({self.samples} base samples)"]
        width = max(map(len, self.names))
        for s, output in enumerate(self.outputs):
            unit = "in mixed units" if self.output_units[s] == MIXED else self.output_units[s]
            lines.append(f"  {output}: mean {self.mean[s]:.4g}, standard deviation {self.deviation[s]:.3g} {unit}")
            for k, name in enumerate(self.names):
                if not np.isfinite(self.total[s, k]):
                    lines.append(f"    {name:{width}}  does not vary")
                    continue
                one, all_ = self.first_interval[s, k], self.total_interval[s, k]
                lines.append(
                    f"    {name:{width}}  alone {self.first[s, k]:z6.3f} [{one[0]:z6.3f}, {one[1]:z6.3f}]  "
                    f"in all {self.total[s, k]:z6.3f} [{all_[0]:z6.3f}, {all_[1]:z6.3f}]  "
                    f"{self._most(s, k)}"
                )
            why = {"undecided": ": the intervals overlap", "nothing": ", it does not vary"}.get(self.said[s], "")
            if self.said[s] == "undecided" and (group := next((each for each in self.crossing if s in each), ())):
                why = f": modes {listed(str(i + 1) for i in group)} change places or trade shapes within the ranges"
            lines.append(f"    matters most: {self.said[s]}{why}")
        return "\n".join(lines)


@public(samples=_samples)
def sensitivity(
    machine: AnyMachine,
    posture: PostureLike,
    *,
    base: BaseLike | None = None,
    control: Control | None = None,
    gravity: bool = False,
    loop: LoopLike | None = None,
    ranges: RangesLike | None = None,
    samples: int = SAMPLES,
    seed: int = 0,
) -> Sensitivity:
    """Which unknown matters, for each w_i and, with a loop, for how fast it decays: what to measure first.

    Sobol indices by Saltelli's samples (`scipy.stats.sobol_indices`), and bounds from exact derivatives. All uncertain
    numbers are independent and uniform, factors in their logarithm.

    Args:
        machine, posture, base, gravity: as of `flexopt.evaluate`.
        control: Jacobian `"inverse"` (default), `"transpose"` or `"damped:LAMBDA"`.
        loop: the real controller, as of `flexopt.outcome`; by default the machine's `[loop]`. Without one there is no
            decay, and no dead time that could be uncertain.
        ranges: what is uncertain, as of `flexopt.verdict`; by default the machine's `[[uncertainty]]`, or where there
            is none one factor ½ to 2 of all springs.
        samples: base samples, a power of two.
        seed: of the samples.

    Raises:
        InputError, SingularPosture: as `flexopt.evaluate` and `flexopt.outcome`.
        NoSolutionFound: some members of the ranges have no measures.

    Example:
        >>> found = flexopt.sensitivity(flexopt.load("excavator"), (0.9929, -2.6306), samples=64)
        >>> found.outputs, found.names
        (('w1', 'w2', 'w3'), ('stiffness',))
    """
    asked, held = cast("Loop | None", loop or machine.loop), cast(Vector, posture)
    own = machine.uncertainty if asked else tuple(each for each in machine.uncertainty if each.of != (LATE,))
    known = cast("tuple[Uncertainty, ...]", ranges or own or GROUND)
    known_base = cast("Vector | None", base)
    settings, placed = settings_at(machine, held, known_base, control, asked, gravity=gravity, call="sensitivity")
    box = UncertaintyBox(machine, known, settings.dead_time)
    if asked is not None:
        raise_if_any(InputError, "sensitivity", box.faults(settings.rate))
    elif any(each.of == (LATE,) for each in known):
        fault = Fault("ranges", "dead_time goes with a loop, which neither this call nor the machine has", LATE)
        raise_if_any(InputError, "sensitivity", [fault])
    else:
        raise_if_any(InputError, "sensitivity", box.indefinite())
    of = _Outputs(box, held, placed, settings.control, gravity=gravity)
    loops = None if asked is None else UncertainLoop(settings, placed, held, gravity, box)
    a, b = _saltelli(len(known), samples, seed)
    mixed = [np.where(np.arange(len(known)) == k, b, a) for k in range(len(known))]
    members = np.concatenate([a, b, *mixed])
    values = of.values(members)
    if loops is not None:
        values = np.vstack([values, loops.decays(members)[None]])
    missing = np.count_nonzero(~np.isfinite(values).all(axis=0))
    if missing:
        raise NoSolutionFound(
            f"sensitivity: {missing} of {len(members)} members of the ranges have no measures or no loop; narrow them",
            violations={"members": float(missing)}, iterate={},
        )  # fmt: skip
    parts = values.reshape(values.shape[0], len(known) + 2, samples).transpose(1, 0, 2)
    first, total = _indices(parts)
    first_ends, total_ends = _intervals(parts, seed)
    squares = [np.array([of.slopes(u) for u in a[:SLOPES]])]
    if loops is not None:
        squares.append(np.array([_slopes_of_loop(loops, u)[None] for u in a[:SLOPES_OF_LOOP]]))
    deviation = parts[:2].std(axis=(0, 2))
    bound, error = (np.concatenate(each) for each in zip(*map(_mean_square, squares), strict=True))
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.where(_varies(parts), math.pi**2 * deviation**2, np.nan)[:, None]
    crossing = of.crossing(a[:SLOPES])
    for group in crossing:
        bound[list(group)] = math.nan
        error[list(group)] = math.nan
    outputs = (*(f"w{i + 1}" for i in range(of.modes)), *(() if loops is None else ("decay",)))
    units = (*[residue_unit(settings.control, machine.joint_units)] * of.modes, *(() if loops is None else ("1/s",)))
    options = {"posture": posture, "base": placed, "control": settings.control, "gravity": gravity, "samples": samples}
    options |= {"seed": seed, "ranges": [each.model_dump(exclude_none=True) for each in known]}
    options |= {} if asked is None else {"loop": settings.to_dict()}
    return Sensitivity(
        machine=machine.name, outputs=outputs, output_units=units, names=box.names, first=first,
        first_interval=first_ends, total=total, total_interval=total_ends, bound=bound / scale,
        bound_error=error / scale, mean=parts[:2].mean(axis=(0, 2)), deviation=deviation, samples=samples,
        crossing=crossing,
        provenance=provenance(machine, **options),
    )  # fmt: skip


class _Outputs:
    """The w_i of members of the box, and their slopes."""

    def __init__(self, box: UncertaintyBox, posture: Vector, base: Vector, control: Control, *, gravity: bool) -> None:
        self.box, self.posture, self.base = box, posture, base
        self.measures = build_measures(box.machine, control, gravity)
        self.modes = self.measures.plant.n_passive

    def values(self, members: Vector) -> Vector:
        """(m, N); 0 of what is next to nothing in all members."""
        p, _ = self.box.numbers_at(np.array([self.box.theta(u) for u in members]).T)
        postures = np.tile(self.posture[:, None], len(members))
        w = w_of_few(self.measures, self.base, postures, np.ascontiguousarray(p))
        middle = self.box.numbers(0.5 * np.ones(members.shape[1]))[0]
        size = self.measures.w.call([self.base, self.posture, middle])[1].full()
        return np.where(np.abs(w).max(axis=1, keepdims=True) <= NEGLIGIBLE * size, 0.0, w)

    def slopes(self, u: Vector) -> Vector:
        """∂w/∂u (m, k)."""
        p, _ = self.box.numbers(u)
        by_p = self.measures.gradients.call([self.base, self.posture, p])[1].full()
        return np.array([self.box.slopes(u, row, 0.0) for row in by_p])

    def crossing(self, members: Vector) -> tuple[tuple[int, ...], ...]:
        """Groups of modes whose shapes stand in another order in some member than in the middle of the ranges."""
        from scipy.optimize import linear_sum_assignment  # noqa: PLC0415  (loads slowly)
        from scipy.sparse.csgraph import connected_components  # noqa: PLC0415

        if not self.modes:
            return ()
        half = 0.5 * np.ones(members.shape[1])
        middle, plant = self.box.numbers(half)[0], self.measures.plant
        mass: Vector = plant.mass(plant.rest(self.base, self.posture, middle), self.base, middle).full()
        weighted, moved = self._shapes(middle).T @ mass, np.zeros((self.modes, self.modes))
        for u in members:
            shapes = self._shapes(self.box.numbers(u)[0])
            sizes = np.sqrt(np.sum(shapes * (mass @ shapes), axis=0))
            moved[linear_sum_assignment(-np.abs(weighted @ shapes / sizes))] = 1.0
        found: Any = connected_components(moved, directed=False)
        count, group_of = int(found[0]), np.asarray(found[1], dtype=np.intp)
        groups = [tuple(np.flatnonzero(group_of == k).tolist()) for k in range(count)]
        return tuple(group for group in groups if len(group) > 1)

    def _shapes(self, p: Vector) -> Vector:
        """The modes (n_q, m)."""
        at: dict[str, Any] = {"base": self.base, "posture": self.posture, "p": p}
        shapes: Vector = cast(Any, self.measures.values(**at))["modes"].full()
        return shapes


def _slopes_of_loop(loops: UncertainLoop, u: Vector) -> Vector:
    """∂decay/∂u (k,); NaN where eigenvalues meet."""
    point = loops.outcome(u)
    return loops.slopes(u, point, point.decay())


def _saltelli(k: int, samples: int, seed: int) -> tuple[Vector, Vector]:
    """Two independent samples (n, k) from one sequence."""
    from scipy.stats.qmc import Sobol  # noqa: PLC0415  (loads slowly)

    drawn = Sobol(2 * k, seed=seed).random(samples)
    return drawn[:, :k], drawn[:, k:]


def _varies(parts: Vector) -> Any:
    """Which outputs vary by more than rounding, (s,)."""
    return np.ptp(parts, axis=(0, 2)) > 1e-9 * np.abs(parts).max(axis=(0, 2))


def _indices(parts: Vector) -> tuple[Vector, Vector]:
    """First-order and total indices (s, k) of outputs (k + 2, s, n): of both samples, and of each mixed one."""
    from scipy.stats import sobol_indices  # noqa: PLC0415  (loads slowly)

    found, varies = np.full((2, parts.shape[1], parts.shape[0] - 2), np.nan), _varies(parts)
    for s in np.flatnonzero(varies):
        # Twice, as SciPy stumbles over one output of one number.
        y = parts[:, [s, s]]
        known: Any = sobol_indices(func={"f_A": y[0], "f_B": y[1], "f_AB": y[2:]}, n=parts.shape[2])
        found[:, s] = [np.reshape(order, (2, -1))[0] for order in (known.first_order, known.total_order)]
    return found[0], found[1]


def _intervals(parts: Vector, seed: int) -> tuple[Vector, Vector]:
    """Ends (s, k, 2) of both over samples drawn anew from these."""
    rng, n = np.random.default_rng(seed), parts.shape[2]
    drawn = np.array([_indices(parts[:, :, rng.integers(0, n, n)]) for _ in range(DRAWN)])
    ends = np.quantile(drawn, [(1 - SHARE) / 2, (1 + SHARE) / 2], axis=0)
    return ends[:, 0].transpose(1, 2, 0), ends[:, 1].transpose(1, 2, 0)


def _mean_square(slopes: Vector) -> tuple[Vector, Vector]:
    """Mean of the squares of slopes (n, s, k) and its standard error."""
    squares = slopes**2
    return squares.mean(axis=0), squares.std(axis=0, ddof=1) / math.sqrt(len(squares))
