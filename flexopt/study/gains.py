"""Which gains a posture allows: the sampled linear loop over Kp and Kv, borders in Kp, and nonlinear runs as the test.

In: a machine and postures to stand in. Out: a `GainMap`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Vector
from flexopt.foundation.results import Result
from flexopt.model import AnyMachine
from flexopt.robustness import Evaluation
from flexopt.simulation import StabilityBorder, sampled_loop, simulate_ensemble, stability_border
from flexopt.simulation.linear import EXACT, linear_scenario, linearised

KP, KV = (1e2, 1e7), (1e1, 1e6)
# Of the grid on each side; of these every second is run.
POINTS, EVERY = 31, 2
# Small enough for the linear loop to hold, long enough for a slow mode to show.
OFFSET, SECONDS = 0.005, 60.0
KV_HELD, RATIOS = 2e3, (0.02, 0.1)
# Just beyond a border: which mode goes.
BEYOND = 1.01


@dataclass(frozen=True)
class BorderRow(Result):
    """Gains Kp that one posture allows, Kv or Kv/Kp held.

    Attributes:
        stand: the posture's name.
        held: what is held, in words.
        integrator: of the plant between samples, `"exact"` for none.
        border: the intervals.
        frequency_hz: of the pole that becomes unstable just beyond the lowest interval; None without one.
    """

    DOCUMENT = """
    posture=stand held integrator intervals=border.intervals searched=border.searched frequency_beyond_hz=frequency_hz
    """

    stand: str
    held: str
    integrator: str
    border: StabilityBorder
    frequency_hz: float | None

    @property
    def text(self) -> str:
        """The intervals, the ends of the search told as such."""
        low, high = self.border.searched
        words: list[str] = []
        for start, end in self.border.intervals:
            lowest, highest = ", as low as was looked," * (start <= low), ", as far as was looked" * (end >= high)
            words.append(f"from {start:.4g}{lowest} up to {end:.4g}{highest}")
        return "; ".join(words) or f"none from {low:.4g} to {high:.4g}"


@dataclass(frozen=True)
class Disagreement:
    """A pair of gains at which the nonlinear run and the eigenvalues say different things: its verdict is undecided."""

    stand: str
    kp: float
    kv: float
    growth_rate: float
    grows: bool


@dataclass(frozen=True)
class GainMap(Result):
    """Growth rates of the sampled linear loop over Kp and Kv, and nonlinear verdicts on a coarser grid.

    Attributes:
        names: of the postures (s,).
        kp, kv: (k,), (l,).
        growth_rate: of the loop itself, exact between the samples, (s, l, k), 1/s; below 0 it is stable.
        stated_growth_rate: of the loop as the runs' integrator makes it, the like.
        tested_kp, tested_kv: (k',), (l',), every second of them.
        grows: what the nonlinear runs show, (s, l', k').
        offset, duration: of these, rad and s.
        borders: in Kp.
        integrator: of the runs.
    """

    DOCUMENT = """
    postures=names kp kv growth_rate[1/s] stated_growth_rate[1/s] integrator hidden tested_kp tested_kv grows
    offset[rad] duration[s] band[1/s] sentence disagreements borders
    """

    names: tuple[str, ...]
    kp: Vector
    kv: Vector
    growth_rate: Vector = field(repr=False)
    stated_growth_rate: Vector = field(repr=False)
    tested_kp: Vector = field(repr=False)
    tested_kv: Vector = field(repr=False)
    grows: NDArray[np.bool_] = field(repr=False)
    offset: float
    duration: float
    borders: tuple[BorderRow, ...]
    integrator: str = "rk4"

    @property
    def disagreements(self) -> tuple[Disagreement, ...]:
        """Where the runs contradict the eigenvalues of the loop."""
        return self._differing(self.growth_rate[:, ::EVERY, ::EVERY])

    @property
    def own_disagreements(self) -> tuple[Disagreement, ...]:
        """Where they contradict the eigenvalues of the loop that their integrator makes of it."""
        return self._differing(self.stated_growth_rate[:, ::EVERY, ::EVERY])

    @property
    def hidden(self) -> int:
        """How many runs decay because their integrator damps: its loop is stable there and the loop itself is not."""
        rates, stated = (x[:, ::EVERY, ::EVERY] for x in (self.growth_rate, self.stated_growth_rate))
        return int(np.count_nonzero(~self.grows & (rates >= 0) & (stated < 0)))

    def _differing(self, rates: Vector) -> tuple[Disagreement, ...]:
        at: list[list[int]] = np.argwhere(self.grows != (rates >= 0)).tolist()
        return tuple(
            Disagreement(
                self.names[i], float(self.tested_kp[k]), float(self.tested_kv[j]), float(rates[i, j, k]),
                bool(self.grows[i, j, k]),
            )
            for i, j, k in at
        )  # fmt: skip

    @property
    def band(self) -> float:
        """Largest |growth rate| at which run and eigenvalues of its own loop disagree, 1/s; 0 where they never do."""
        return max((abs(d.growth_rate) for d in self.own_disagreements), default=0.0)

    @property
    def sentence(self) -> str:
        """How well the verdicts agree."""
        own, total = self.own_disagreements, self.grows.size
        text = (
            f"Of {total} nonlinear runs over {self.duration:g} s by {self.integrator.upper()}, {self.offset:g} rad off "
            f"at the start, {total - len(self.disagreements)} grow or converge as the eigenvalues of the sampled "
            "linear loop say. "
        )
        if self.hidden:
            text += f"{self.hidden} decay only because {self.integrator.upper()} damps: the loop itself grows there. "
        if not own:
            return text + "None disagrees with the eigenvalues of the loop that the integrator makes of it."
        inside = int(np.count_nonzero(np.abs(self.stated_growth_rate[:, ::EVERY, ::EVERY]) <= self.band))
        return text + (
            f"The {len(own)} that disagree with the eigenvalues of the loop that the integrator makes of it all lie "
            f"where that grows or decays by no more than {self.band:.4f}/s, a factor of "
            f"{np.exp(self.band * self.duration):.2f} in the whole run ({inside} runs lie in that band)."
        )

    def border(self, stand: str, held: str, integrator: str) -> BorderRow:
        """One row."""
        return next(row for row in self.borders if (row.stand, row.held, row.integrator) == (stand, held, integrator))


def held_words(ratio: float | None, kv: float = KV_HELD) -> str:
    """What is held along a border, in words."""
    return f"Kv = {kv:g}" if ratio is None else f"Kv/Kp = {ratio:g} s"


def map_gains(machine: AnyMachine, stands: Mapping[str, Evaluation], stated: Mapping[str, Any]) -> GainMap:
    """Compute the map.

    Args:
        machine: the machine.
        stands: name -> posture with its base.
        stated: control, feedback, rate and integrator of the runs.
    """
    given: dict[str, Any] = {name: stated[name] for name in ("control", "feedback", "rate", "integrator")}
    kp, kv = np.geomspace(*KP, POINTS), np.geomspace(*KV, POINTS)
    tested_kp, tested_kv = kp[::EVERY], kv[::EVERY]
    grows = _verdicts(machine, stands, given, stated["offset"], tested_kp, tested_kv)
    rates, stated_rates = (
        [
            _growth_rates(machine, given | {"base": s.base, "posture": s.posture, "integrator": method}, kp, kv)
            for s in stands.values()
        ]
        for method in (EXACT, given["integrator"])
    )
    methods = (str(given["integrator"]), EXACT)
    borders = tuple(
        border_row(machine, name, stands[name], given | {"integrator": method}, ratio)
        for method, ratio, name in product(methods, (None, *RATIOS), stands)
    )
    return GainMap(
        names=tuple(stands),
        kp=kp,
        kv=kv,
        growth_rate=np.array(rates),
        stated_growth_rate=np.array(stated_rates),
        tested_kp=tested_kp,
        tested_kv=tested_kv,
        grows=grows,
        offset=OFFSET,
        duration=SECONDS,
        borders=borders,
        integrator=str(given["integrator"]),
    )


def _verdicts(
    machine: AnyMachine, stands: Mapping[str, Evaluation], given: dict[str, Any], towards: Any, kp: Vector, kv: Vector
) -> NDArray[np.bool_]:
    """(s, l', k'): whether the nonlinear runs grow, displaced by `OFFSET` in the signs of `towards`."""
    pairs = np.meshgrid(kp, kv)
    vary = {"kp": pairs[0].ravel(), "kv": pairs[1].ravel()}
    options: dict[str, Any] = given | {"offset": OFFSET * np.sign(towards), "duration": SECONDS}
    verdicts = [
        simulate_ensemble(machine, stand.posture, base=stand.base, vary=vary, **options).dataset["grows"].to_numpy()
        for stand in stands.values()
    ]
    return np.array(verdicts).reshape(-1, kv.size, kp.size)


def _growth_rates(machine: AnyMachine, options: Mapping[str, Any], kp: Vector, kv: Vector) -> Vector:
    """(l, k), 1/s. As `sampled_loop` at every pair, the scenario built once."""
    s = linear_scenario(machine, options, "map_gains")
    rows = s.loop.structure.n_task
    rates = [
        linearised(replace(s, parts={**s.parts, "kp": np.full(rows, p), "kv": np.full(rows, v)})).growth_rate
        for v, p in product(kv, kp)
    ]
    return np.array(rates).reshape(kv.size, kp.size)


def border_row(
    machine: AnyMachine,
    name: str,
    stand: Evaluation,
    given: Mapping[str, Any],
    ratio: float | None,
    kv: float = KV_HELD,
) -> BorderRow:
    """Stable Kp of one posture, Kv held, or its ratio to Kp.

    Args:
        machine: the machine.
        name: of the posture.
        stand: the posture with its base.
        given: options of `sampled_loop` but posture, base and Kv; Kp as of `stability_border`.
        ratio: Kv/Kp, s, or None.
        kv: held where the ratio is not.
    """
    options: dict[str, Any] = {**given, "base": stand.base, "kv": kv}
    border = stability_border(machine, stand.posture, ratio=ratio, **options)
    frequency, largest = None, border.largest
    if largest is not None and largest < border.searched[1]:
        kp = BEYOND * largest
        beyond: dict[str, Any] = options | {"kp": kp, "kv": kv if ratio is None else ratio * kp}
        frequency = sampled_loop(machine, stand.posture, **beyond).frequency_hz
    return BorderRow(name, held_words(ratio, kv), str(given.get("integrator", EXACT)), border, frequency)
