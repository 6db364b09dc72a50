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
from flexopt.loop.characteristic import Characteristic, NotCovered
from flexopt.loop.characteristic_cells import Cells, cells_of
from flexopt.loop.uncertain import UncertainLoop
from flexopt.model.uncertainty import LATE

# Decay that is certified, 1/s: what rounding makes of eigenvalues is less.
DECAY = 1e-6
# The first cell of frequency in units of the Nyquist frequency, and the ratio of one cell's end to the last's.
FIRST, RATIO = 0.004, 1.12
# How often cells of frequency are halved in a box before the box is, and how many boxes are looked at.
HALVINGS, BOXES = 1, 400
# With masses: how many times smaller a box is than the one that its function was made for, when that is made again.
AGAIN = 8.0
# Cells of a box that are halved at most.
CELLS = 48
# Boxes that no longer are divided: share of the whole's width, all of them together.
SMALLEST = 2.0**-8


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
        decay: ρ, 1/s, that holds where a leaf's loop decays.
        sentence: why nothing is proven, where nothing is.
    """

    leaves: tuple[Leaf, ...]
    cells: int
    boxes: int
    decay: float
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


@dataclass
class Search:
    """Branch and bound over a box.

    Attributes:
        loop: the loop and its box.
        decay: ρ, 1/s.
        most: boxes that are looked at.
        order: which boxes first, by their ends; the largest by default.
    """

    loop: UncertainLoop
    decay: float = DECAY
    most: int = BOXES
    order: Callable[[Vector, Vector], float] | None = None

    def __post_init__(self) -> None:
        self.looked, self.cells = 0, 0
        self.heap: list[_Box] = []
        k = len(self.loop.box.uncertainty)
        for low, high in self._roots(np.zeros(k), np.ones(k)):
            self._begin(low, high)

    @cached_property
    def whole(self) -> Characteristic:
        """That of the whole box."""
        return self._of(np.zeros(len(self.loop.box.uncertainty)), np.ones(len(self.loop.box.uncertainty)))

    def _of(self, low: Vector, high: Vector) -> Characteristic:
        return Characteristic(self.loop, self.loop.box.theta(low), self.loop.box.theta(high), self.decay)

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
        self.looked += 1
        heapq.heappush(self.heap, _Box(order, self.looked, low, high, left, of, root))

    def run(self) -> Iterator[tuple[Vector, Vector, bool]]:
        """Ends of boxes that together are the whole, and whether zero is excluded there, as they are found."""
        while self.heap:
            box = heapq.heappop(self.heap)
            left = box.cells
            for _ in range(HALVINGS):
                if not 0 < len(left.low) <= CELLS:
                    break
                left = left.halves()
                self.cells += len(left.low)
                left = _failing(left)
            if len(left.low) and box.of.masses and float(np.prod(box.high - box.low)) * AGAIN <= box.root:
                box, left = self._again(box, left)
            if not len(left.low):
                yield box.low, box.high, True
            elif self.looked >= self.most or not (axes := self._axes(box)):
                yield box.low, box.high, False
            else:
                self._divide(box, left, axes)

    def _again(self, box: _Box, left: Cells) -> tuple[_Box, Cells]:
        """The cells that are left of a box from their own function: remainders are smaller over smaller boxes."""
        around = box.of.around or box.of
        of = replace(self._of(box.low, box.high), around=around)
        cells = cells_of(of, left.low, left.high)
        self.cells += len(cells.low)
        return replace(box, of=of, root=float(np.prod(box.high - box.low))), _failing(cells)

    def _axes(self, box: _Box) -> list[int]:
        """Directions in which a box may be divided."""
        return [k for k in range(len(box.low)) if box.high[k] - box.low[k] > SMALLEST and not self._fixed[k]]

    def _divide(self, box: _Box, left: Cells, axes: list[int]) -> None:
        """In the direction, of some, that leaves the fewest cells."""
        middle = (box.low + box.high) / 2
        a, at, b = (self.loop.box.theta(u) for u in (box.low, middle, box.high))
        parts = [part for k in axes for part in left.split(k, float((at[k] - a[k]) / (b[k] - a[k])))]
        self.cells += sum(len(part.low) for part in parts)
        stay = np.split(~parts[0].joined(parts[1:]).exclude_zero, len(parts))
        scores = [
            (int(stay[2 * i].sum() + stay[2 * i + 1].sum()), -(box.high[k] - box.low[k])) for i, k in enumerate(axes)
        ]
        best = min(range(len(axes)), key=scores.__getitem__)
        k, (lower, upper) = axes[best], (box.high.copy(), box.low.copy())
        lower[k] = upper[k] = middle[k]
        for (low, high), i in (((box.low, lower), 2 * best), ((upper, box.high), 2 * best + 1)):
            self._push(low, high, parts[i].chosen(stay[i]), box.of, box.root)

    @cached_property
    def _fixed(self) -> list[bool]:
        """Of which directions nothing is uncertain."""
        k = len(self.loop.box.uncertainty)
        same: list[bool] = (self.loop.box.theta(np.zeros(k)) == self.loop.box.theta(np.ones(k))).tolist()
        return same


def _failing(cells: Cells) -> Cells:
    return cells.chosen(~cells.exclude_zero) if len(cells.low) else cells


def certify(loop: UncertainLoop, *, decay: float = DECAY, boxes: int = BOXES) -> RegionProof:
    """What is proven of a loop over its box."""
    try:
        search = Search(loop, decay, boxes)
        ends = list(search.run())
        excluded = [(low + high) / 2 for low, high, each in ends if each]
        decays = iter(loop.decays(np.array(excluded)).tolist() if excluded else ())
        words = (_word(next(decays), decay) if each else None for _, _, each in ends)
        leaves = tuple(Leaf(low, high, word) for (low, high, _), word in zip(ends, words, strict=True))
        return RegionProof(leaves, search.cells, search.looked, decay)
    except NotCovered as fault:
        k = len(loop.box.uncertainty)
        return RegionProof((Leaf(np.zeros(k), np.ones(k), None),), 0, 0, decay, str(fault))


def _word(found: float, decay: float) -> bool | None:
    return None if math.isnan(found) else found > decay


def certified_radius(loop: UncertainLoop, size: float, *, decay: float = DECAY, boxes: int = BOXES) -> float:
    """The largest s found, up to e^size, so that the loop is proven to decay with every factor within [1/s, s].

    The box of the loop is that of e^size. Boxes are looked at from the nominal machine outwards, until one is not
    proven to decay. 1 where nothing is proven.
    """

    def away(low: Vector, high: Vector) -> float:
        return float(np.maximum(np.maximum(low - 0.5, 0.5 - high), 0.0).max())

    try:
        # One after another: the first that does not decay ends it.
        for low, high, excluded in Search(loop, decay, boxes, away).run():
            if not excluded or not loop.decays((low + high)[None] / 2)[0] > decay:
                return math.exp(2 * size * away(low, high))
    except NotCovered:
        return 1.0
    return math.exp(size)
