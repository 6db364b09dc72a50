"""What is proven of a sampled loop over a box of uncertain numbers: where it decays, where it grows, where neither.

In: an uncertain loop. Out: `RegionProof`. The characteristic function has no zero on e^{(jω − ρ)T}, ω in [0, π/T], for
any member of a box where the hull of its control points leaves zero out in every cell of ω (zero exclusion): the number
of eigenvalues outside that circle is then the same all over the box, and the eigenvalues of one member tell it. Boxes
of which this does not hold are halved.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.loop.certified.characteristic import Characteristic, NotCovered
from flexopt.loop.certified.characteristic_cells import Cells, cells_of
from flexopt.loop.uncertain import UncertainLoop
from flexopt.model.uncertainty import LATE

# Decay that is certified, 1/s: what rounding makes of eigenvalues is less.
DECAY = 1e-6
# The first cell of frequency in units of the Nyquist frequency, and the ratio of one cell's end to the last's.
FIRST, RATIO = 0.004, 1.12
# How often cells of frequency are halved in a box before the box is, and how many boxes are looked at.
HALVINGS, BOXES = 1, 1500
# A function is made again for a box so many times smaller than the one that it was made for, where remainders are what
# leaves so many of its cells open, unless that costs more than so many times its share of the boxes that are left to
# look at: in boxes, and in rows of its matrices for each.
AGAIN, PAYS, WORTH = 4.0, 0.3, 1.0
COSTS, ROWS = 12.0, 1500.0
# Cells of a box that are halved at most.
CELLS = 48
# Boxes that no longer are divided: share of the whole's width, all of them together.
SMALLEST = 2.0**-8


Spent = Callable[[float], None]


@dataclass(frozen=True)
class Leaf:
    """A box of u in [0, 1]^k (`UncertaintyBox`), and what is known of the loop in it.

    Attributes:
        low, high: its ends.
        decays: whether the loop does all over it; None where nothing is proven.
    """

    low: Vector
    high: Vector
    decays: bool | None

    @property
    def volume(self) -> float:
        """Share of the whole box."""
        return float(np.prod(self.high - self.low))


@dataclass(frozen=True)
class RegionProof:
    """Leaves that together are the box.

    Attributes:
        leaves: of it.
        cells: how many cells of frequency were looked at, over all boxes.
        boxes: how many boxes.
        sentence: why nothing is proven, where nothing is.
    """

    leaves: tuple[Leaf, ...]
    cells: int
    boxes: int
    sentence: str = ""

    def share(self, decays: bool | None) -> float:
        """Of the box, in the logarithms of factors."""
        return sum(leaf.volume for leaf in self.leaves if leaf.decays is decays)


@dataclass(order=True, frozen=True)
class _Box:
    """One to be looked at: first come, first served within an order."""

    order: float
    count: int
    low: Vector = field(compare=False)
    high: Vector = field(compare=False)
    cells: Cells = field(compare=False)
    of: Characteristic = field(compare=False)
    root: float = field(compare=False)

    @property
    def volume(self) -> float:
        """Share of the whole box."""
        return float(np.prod(self.high - self.low))


@dataclass
class Search:
    """Branch and bound over a box.

    Attributes:
        loop: the loop and its box.
        most: boxes that are looked at, less where functions are made again, which cost as many as that takes.
        order: which boxes first, by their ends; the largest by default.
        told: called with how much of `most` is spent, as boxes are looked at.
    """

    loop: UncertainLoop
    most: int = BOXES
    order: Callable[[Vector, Vector], float] | None = None
    told: Spent | None = None

    def __post_init__(self) -> None:
        self.looked, self.cells, self.spent, self.open = 0, 0, 0.0, 1.0
        self.heap: list[_Box] = []
        k = len(self.loop.box.uncertainty)
        for low, high in self._roots(np.zeros(k), np.ones(k)):
            self._begin(low, high)

    def _of(self, low: Vector, high: Vector) -> Characteristic:
        return Characteristic(self.loop, self.loop.box.theta(low), self.loop.box.theta(high), DECAY)

    def _roots(self, low: Vector, high: Vector) -> Iterator[tuple[Vector, Vector]]:
        """The box in parts within which the dead time stays in one sample."""
        late = [i for i, each in enumerate(self.loop.box.uncertainty) if each.of == (LATE,)]
        if not late:
            yield low, high
            return
        ends = self.loop.box.uncertainty[late[0]].value or (0.0, 0.0)
        rate = self.loop.settings.rate
        first, last = math.floor(ends[0] * rate + 1e-9) + 1, math.ceil(ends[1] * rate - 1e-9)
        cuts = [(n / rate - ends[0]) / (ends[1] - ends[0]) for n in range(first, last)] if ends[1] > ends[0] else []
        for a, b in zip([0.0, *cuts], [*cuts, 1.0], strict=True):
            here = low.copy(), high.copy()
            here[0][late[0]], here[1][late[0]] = a, b
            yield here

    def _begin(self, low: Vector, high: Vector) -> None:
        of = self._of(low, high)
        of.check()
        edges = [0.0, FIRST * of.nyquist]
        while edges[-1] < of.nyquist:
            edges.append(min(edges[-1] * RATIO, of.nyquist))
        at = np.array(edges)
        cells = cells_of(of, at[:-1], at[1:])
        self.cells += len(cells.low)
        self._push(low, high, _failing(cells), of, float(np.prod(high - low)))

    def _push(self, low: Vector, high: Vector, left: Cells, of: Characteristic, root: float) -> None:
        order = -float(np.prod(high - low)) if self.order is None else self.order(low, high)
        self.looked, self.spent = self.looked + 1, self.spent + 1
        heapq.heappush(self.heap, _Box(order, self.looked, low, high, left, of, root))

    def run(self) -> Iterator[tuple[Vector, Vector, bool]]:
        """Ends of boxes that together are the whole, and whether zero is excluded there, as they are found."""
        while self.heap:
            box = heapq.heappop(self.heap)
            left = box.cells
            if self.told is not None:
                self.told(min(self.spent, self.most))
            for _ in range(HALVINGS):
                if not 0 < len(left.low) <= CELLS:
                    break
                left = left.halves()
                self.cells += len(left.low)
                left = _failing(left)
            if len(left.low) and self._pays(box, left):
                box, left = self._again(box, left)
            axes = self._axes(box) if len(left.low) and self.spent < self.most else []
            if axes:
                self._divide(box, left, axes)
                continue
            self.open -= box.volume
            yield box.low, box.high, not len(left.low)

    def _pays(self, box: _Box, left: Cells) -> bool:
        """Whether a function of its own is worth its time."""
        if box.volume * AGAIN > box.root:
            return False
        of_remainders = left.open_by_remainders(PAYS)
        share = box.volume / self.open if self.order is None else 1.0
        # Cells that remainders leave open stay so in the parts of a box.
        worth = WORTH * share * (self.most - self.spent) * of_remainders
        return of_remainders >= PAYS and self._costs(box, left) * (1 - of_remainders) <= worth

    @staticmethod
    def _costs(box: _Box, left: Cells) -> float:
        """Of a function of its own, in boxes."""
        return COSTS + left.points.size * box.of.size / ROWS

    def _again(self, box: _Box, left: Cells) -> tuple[_Box, Cells]:
        """The cells that are left of a box from their own function: remainders are smaller over smaller boxes."""
        self.spent += self._costs(box, left)
        of = replace(self._of(box.low, box.high), around=box.of.around or box.of)
        cells = cells_of(of, left.low, left.high)
        self.cells += len(cells.low)
        return replace(box, of=of, root=box.volume), _failing(cells)

    def _axes(self, box: _Box) -> list[int]:
        """Directions in which a box may be divided."""
        return [k for k in range(len(box.low)) if box.high[k] - box.low[k] > SMALLEST and not self._fixed[k]]

    def _divide(self, box: _Box, left: Cells, axes: list[int]) -> None:
        """In the direction, of some, that leaves the fewest cells."""
        middle = (box.low + box.high) / 2
        a, at, b = (self.loop.box.theta(u) for u in (box.low, middle, box.high))
        split = {k: float((at[k] - a[k]) / (b[k] - a[k])) for k in axes}
        still_open = left.open_halves(split)
        k = min(axes, key=lambda k: (still_open[k], box.low[k] - box.high[k]))
        lower, upper = box.high.copy(), box.low.copy()
        lower[k] = upper[k] = middle[k]
        parts = left.split(k, split[k])
        self.cells += sum(len(part.low) for part in parts)
        for (low, high), part in zip(((box.low, lower), (upper, box.high)), parts, strict=True):
            self._push(low, high, _failing(part), box.of, box.root)

    @cached_property
    def _fixed(self) -> list[bool]:
        """Of which directions nothing is uncertain."""
        k = len(self.loop.box.uncertainty)
        same: list[bool] = (self.loop.box.theta(np.zeros(k)) == self.loop.box.theta(np.ones(k))).tolist()
        return same


def _failing(cells: Cells) -> Cells:
    return cells.chosen(~cells.exclude_zero) if len(cells.low) else cells


def certify(loop: UncertainLoop, *, boxes: int = BOXES, told: Spent | None = None) -> RegionProof:
    """What is proven of a loop over its box; `told` as of `Search`."""
    try:
        search = Search(loop, boxes, told=told)
        ends = list(search.run())
        excluded = [(low + high) / 2 for low, high, each in ends if each]
        decays = iter(loop.decays(np.array(excluded)).tolist() if excluded else ())
        words = (_word(next(decays)) if each else None for _, _, each in ends)
        leaves = tuple(Leaf(low, high, word) for (low, high, _), word in zip(ends, words, strict=True))
        return RegionProof(leaves, search.cells, search.looked)
    except NotCovered as fault:
        k = len(loop.box.uncertainty)
        return RegionProof((Leaf(np.zeros(k), np.ones(k), None),), 0, 0, str(fault))


def _word(found: float) -> bool | None:
    return None if math.isnan(found) else found > DECAY


def certified_radius(loop: UncertainLoop, size: float, *, boxes: int = BOXES, told: Spent | None = None) -> float:
    """The largest s found, up to e^size, so that the loop is proven to decay with every factor within [1/s, s].

    The box of the loop is that of e^size. Boxes are looked at from the nominal machine outwards, until one is not
    proven to decay. 1 where nothing is proven.
    """

    def away(low: Vector, high: Vector) -> float:
        return float(np.maximum(np.maximum(low - 0.5, 0.5 - high), 0.0).max())

    try:
        # One after another: the first that does not decay ends it.
        for low, high, excluded in Search(loop, boxes, away, told).run():
            if not excluded or not loop.decays((low + high)[None] / 2)[0] > DECAY:
                return math.exp(2 * size * away(low, high))
    except NotCovered:
        return 1.0
    return math.exp(size)
