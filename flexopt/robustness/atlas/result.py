"""The result of `flexopt.atlas`: curves and points of robust postures, their summary, dataset, file and picture."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Document, Vector
from flexopt.foundation.documents import Gridded
from flexopt.foundation.pictures import Pictured
from flexopt.foundation.plain import counted
from flexopt.foundation.results import Result
from flexopt.robustness.atlas.fields import postures_of
from flexopt.robustness.residues import posture_unit, residue_unit

if TYPE_CHECKING:
    import xarray as xr

# Postures of a point that are written out.
DIGITS = 4


@dataclass(frozen=True)
class RobustCurve(Result):
    """A curve of postures on which w_i = 0.

    Attributes:
        mode: i, counted from 1 by ascending frequency.
        closed: whether it returns to where it began.
        ends: why it ends, two words; none where it is closed. "limit": of a joint, or of the range asked for;
            "singular": a singular posture; "a = 0", "b = 0": beyond it a_i and b_i are opposed; "equal frequencies":
            of two modes; "undefined": beyond it there is no measure, as where nothing holds the machine.
        length: in joint space, rad (m).
        vanishing: "a" where a_i is 0 all along it, as of a telescope whose mass lies on its line; else empty.
        points: (2, K), the two joints along it, rad or m; of a closed one the last is the first.
        end_point: (r, K), m.
        frequency_hz: of the mode, (K,).
        scale: |a_i||b_i|, (K,); NaN at an end that is singular.
    """

    DOCUMENT: ClassVar[str] = "mode closed ends length vanishing vertices=size first last"

    mode: int
    closed: bool
    ends: tuple[str, ...]
    length: float
    vanishing: str
    points: Vector = field(repr=False)
    end_point: Vector = field(repr=False)
    frequency_hz: Vector = field(repr=False)
    scale: Vector = field(repr=False)

    @property
    def size(self) -> int:
        """Number of points."""
        return self.points.shape[1]

    @property
    def first(self) -> Vector:
        """Where it begins, (2,)."""
        return self.points[:, 0]

    @property
    def last(self) -> Vector:
        """Where it ends, (2,)."""
        return self.points[:, -1]


@dataclass(frozen=True)
class RobustPoint(Result):
    """A posture by itself: robust, doubly robust, or where one mode's curve turns from robust to opposed.

    Attributes:
        modes: of those i with w_i = 0, counted from 1.
        vanishing: "a" or "b" where a_i or b_i is 0 (the end-point does not move in that mode, or no force on it excites
            the mode); empty of doubly robust postures.
        posture: (n,), rad or m.
        w: w_1 to w_m, (m,).
        scale: |a_i||b_i|, (m,).
        frequencies_hz: (m,).
        end_point: (r,), m.
    """

    DOCUMENT: ClassVar[str] = "modes vanishing posture w scale frequencies_hz end_point[m]"

    modes: tuple[int, ...]
    vanishing: str
    posture: Vector
    w: Vector
    scale: Vector
    frequencies_hz: Vector
    end_point: Vector


@dataclass(frozen=True)
class EdgeCurve(Result):
    """Postures from which the two joints cannot move the end-point to all sides.

    What they reach is bounded or folded there, so that the edge of the workspace is among these.

    Attributes:
        kind: "singular", where Jv loses rank; "fold", where other joints could move the end-point on; "limit", of a
            joint or of the range asked for.
        closed: whether it returns to where it began.
        points: (2, K), the two joints along it, rad or m.
        end_point: (r, K), m.
    """

    DOCUMENT: ClassVar[str] = "kind closed vertices=size"

    kind: str
    closed: bool
    points: Vector = field(repr=False)
    end_point: Vector = field(repr=False)

    @property
    def size(self) -> int:
        """Number of points."""
        return self.points.shape[1]


@dataclass(frozen=True)
class Atlas(Pictured, Gridded, Result):
    """All robust postures of a machine over two of its joints.

    Attributes:
        machine, control, gravity, base: as in `flexopt.evaluate`.
        joints: names of all actuated joints.
        joint_units: of these, "rad" or "m".
        rows: names of the task rows.
        varied: names of the two joints that vary, along x and y.
        fixed: (n − 2,), the others, in order, rad or m.
        x_range, y_range: of the two.
        periodic: which of them turns all round.
        limits: (2, 2), low and high of the two, infinite where there is none.
        cells: of the grid, along x and y.
        resolution: size of a cell, (2,), rad or m; loops that are smaller may be missed.
        curves: w_i = 0, by mode; with three task rows only in planes of symmetry.
        isolated: postures with w_i = 0 by themselves, by mode; with three task rows.
        doubly_robust: postures with w_i = w_j = 0, by modes.
        vanishing: postures with a_i = 0 or b_i = 0, at which curves end.
        edges: of the workspace, and folds inside it; with three task rows singular postures alone, if not redundant.
        singular: (n, K), singular postures by themselves, of a redundant arm with two task rows.
        everywhere: modes whose a_i and b_i are parallel in every posture: they have no curves.
        robust_share: share of the grid on which w_i is zero, (m,): more than none where a_i and b_i are parallel over
            whole regions, as in a plane of symmetry.
        w_largest: the largest |w_i| on the grid, (m,).
        unmapped: share of the grid without measures: frequencies that are shared, or nothing that holds the machine.
        provenance: machine, versions and options.

    Example:
        >>> found.varied
        ('boom', 'stick')
        >>> found.doubly_robust == () or found.doubly_robust[0].posture.shape
        (2,)
    """

    DOCUMENT: ClassVar[str] = (
        "machine control gravity base joints joint_units rows varied fixed x_range y_range periodic limits cells "
        "resolution curves isolated doubly_robust vanishing edges singular everywhere w_largest robust_share "
        "unmapped provenance"
    )

    machine: str
    control: str
    gravity: bool
    base: Vector
    joints: tuple[str, ...]
    joint_units: tuple[str, ...]
    rows: tuple[str, ...]
    varied: tuple[str, str]
    fixed: Vector
    x_range: tuple[float, float]
    y_range: tuple[float, float]
    periodic: tuple[bool, bool]
    limits: Vector
    cells: tuple[int, int]
    resolution: Vector
    curves: tuple[RobustCurve, ...] = field(repr=False)
    isolated: tuple[RobustPoint, ...] = field(repr=False)
    doubly_robust: tuple[RobustPoint, ...] = field(repr=False)
    vanishing: tuple[RobustPoint, ...] = field(repr=False)
    edges: tuple[EdgeCurve, ...] = field(repr=False)
    singular: Vector = field(repr=False)
    everywhere: tuple[int, ...]
    w_largest: Vector
    robust_share: Vector
    unmapped: float
    provenance: Document = field(repr=False)

    @property
    def modes(self) -> int:
        """Number of modes."""
        return self.w_largest.size

    @property
    def dataset(self) -> xr.Dataset:
        """Everything as an xarray.Dataset.

        Curves stand one behind the other along `vertex`: `curve` says which, from 0; of it `curve_mode`,
        `curve_closed`, `curve_ends`. `posture` (joint, vertex), `end_point` (row, vertex), `frequency_hz` and `scale`
        (vertex). Along `point` isolated, doubly robust, vanishing postures: `point_posture` (joint, point),
        `point_modes` and `point_kind`, `point_w` and `point_scale` (mode, point), `point_end_point` (row, point). Edges
        likewise: `edge_posture` (joint, edge_vertex), `edge_end_point`, `edge`, `edge_kind`. What there is none of is
        left out.
        """
        import xarray as xr  # noqa: PLC0415  (slow to import)

        filled = {name: each for name, each in self._variables().items() if each[1].size}
        return xr.Dataset(filled, self._coordinates(), self._attributes())

    def _variables(self) -> dict[str, Any]:
        unit, points = (
            residue_unit(self.control, self.joint_units),
            (*self.isolated, *self.doubly_robust, *self.vanishing),
        )
        n, r, m = len(self.joints), len(self.rows), self.modes

        def beside(parts: list[Vector], rows: int | None = None) -> Vector:
            empty = np.zeros(0 if rows is None else (rows, 0))
            return np.concatenate([*parts, empty], axis=-1)

        def columns(parts: list[Vector], rows: int) -> Vector:
            return np.stack(parts, axis=1) if parts else np.zeros((rows, 0))

        def numbers(curves: tuple[RobustCurve, ...] | tuple[EdgeCurve, ...]) -> NDArray[np.int32]:
            return np.repeat(np.arange(len(curves), dtype=np.int32), [curve.size for curve in curves])

        rad = {"units": posture_unit(self.joint_units)}
        posture = "actuated joints, relative, counter-clockwise positive"
        metres, residue = {"units": "m", "long_name": "end-point at rest"}, {"units": unit, "long_name": "|a_i||b_i|"}
        return {
            "curve": ("vertex", numbers(self.curves), {"long_name": "number of the curve, from 0"}),
            "posture": (
                ("joint", "vertex"), beside([self._postures(c.points) for c in self.curves], n),
                {**rad, "long_name": posture},
            ),
            "end_point": (("row", "vertex"), beside([c.end_point for c in self.curves], r), metres),
            "frequency_hz": ("vertex", beside([c.frequency_hz for c in self.curves]), {"units": "Hz"}),
            "scale": ("vertex", beside([c.scale for c in self.curves]), residue),
            "curve_mode": ("curve_number", np.array([c.mode for c in self.curves], dtype=np.int32), {}),
            "curve_closed": ("curve_number", np.array([c.closed for c in self.curves], dtype=np.int8), {}),
            "curve_ends": ("curve_number", np.array([" to ".join(c.ends) for c in self.curves], dtype=str), {}),
            "point_posture": (("joint", "point"), columns([p.posture for p in points], n), rad),
            "point_end_point": (("row", "point"), columns([p.end_point for p in points], r), metres),
            "point_w": (("mode", "point"), columns([p.w for p in points], m), {"units": unit, "long_name": "w_i"}),
            "point_scale": (("mode", "point"), columns([p.scale for p in points], m), residue),
            "point_modes": ("point", np.array([",".join(map(str, p.modes)) for p in points], dtype=str), {}),
            "point_kind": ("point", np.array([_kind(p) for p in points], dtype=str), {}),
            "edge": ("edge_vertex", numbers(self.edges), {"long_name": "number of the edge, from 0"}),
            "edge_posture": (
                ("joint", "edge_vertex"), beside([self._postures(e.points) for e in self.edges], n),
                {**rad, "long_name": posture},
            ),
            "edge_end_point": (("row", "edge_vertex"), beside([e.end_point for e in self.edges], r), metres),
            "edge_kind": ("edge_number", np.array([e.kind for e in self.edges], dtype=str), {}),
            "singular_posture": (("joint", "singular"), self.singular, rad),
        }  # fmt: skip

    def _postures(self, points: Vector) -> Vector:
        return postures_of([self.joints.index(name) for name in self.varied], self.fixed, points)

    def _coordinates(self) -> dict[str, Any]:
        modes = np.arange(1, self.modes + 1, dtype=np.int32)
        return {"joint": list(self.joints), "row": list(self.rows), "mode": modes}

    def _attributes(self) -> dict[str, Any]:
        return {
            "title": self.title,
            "machine": self.machine,
            "control": self.control,
            "gravity": str(self.gravity).lower(),
            "varied": ", ".join(self.varied),
            "resolution": self.resolution,
            "note": self.said,
            "provenance": json.dumps(self.provenance),
        }

    @property
    def units(self) -> tuple[str, str]:
        """Of the two joints that vary."""
        first, second = (self.joint_units[self.joints.index(name)] for name in self.varied)
        return first, second

    @property
    def held(self) -> list[tuple[str, float, str]]:
        """The joints that do not vary: name, where, and "rad" or "m"."""
        others = [
            (name, unit) for name, unit in zip(self.joints, self.joint_units, strict=True) if name not in self.varied
        ]
        return [(name, float(value), unit) for (name, unit), value in zip(others, self.fixed, strict=True)]

    @property
    def title(self) -> str:
        """One line about it."""
        return f"{self.machine}: robust postures under Jacobian {self.control} control"

    @property
    def said(self) -> str:
        """What is found, and what is not."""
        sizes = " × ".join(f"{size:.3g} {unit}" for size, unit in zip(self.resolution, self.units, strict=True))
        what = "curve wider" if len(self.rows) < 3 else "point on curves of one component of a × b wider"
        return f"every {what} than one cell of {sizes}; smaller loops may be missed"

    def __repr__(self) -> str:
        fixed = ", ".join(f"{name} {value:g} {unit}" for name, value, unit in self.held)
        spans = ", ".join(
            f"{name} {low:g} to {high:g} {unit}{' (all round)' * closes}"
            for name, (low, high), unit, closes in zip(
                self.varied, (self.x_range, self.y_range), self.units, self.periodic, strict=True
            )
        )
        lines = [f"{self.title}, {spans}{f'; {fixed} held' if fixed else ''}"]
        lines += [f"  mode {mode}: {self._curves_of(mode)}" for mode in range(1, self.modes + 1)]
        if self.doubly_robust:
            lines.append(
                f"  doubly robust, two measures are zero ({', '.join(self.joints)}, {posture_unit(self.joint_units)}):"
            )
            lines += [f"    w{p.modes[0]} = w{p.modes[1]} = 0 at {_posture(p)}" for p in self.doubly_robust]
        elif len(self.rows) < 3:
            lines.append("  no posture in which two measures are zero")
        if self.unmapped:
            lines.append(f"  {100 * self.unmapped:.1f} % of the grid has no measures (equal frequencies, or unheld)")
        return "\n".join([*lines, f"  resolution: {self.said}"])

    def _curves_of(self, mode: int) -> str:
        share = f"w{mode} = 0 in {100 * self.robust_share[mode - 1]:.3g} % of all postures"
        if mode in self.everywhere:
            return f"a and b are parallel in every posture: no curves; {share}"
        own, points = [c for c in self.curves if c.mode == mode], [p for p in self.isolated if p.modes == (mode,)]
        if points and not own:
            listed = ", ".join(_posture(point) for point in points)
            return f"w{mode} = 0 at {counted(len(points), 'posture')}: {listed}"
        if not own:
            return share if self.robust_share[mode - 1] > 0 else f"w{mode} = 0 nowhere"
        closed = sum(curve.closed for curve in own)
        ends = [end for curve in own for end in curve.ends]
        listed = ", ".join(f"{ends.count(end)} at {_WHERE[end]}" for end in _WHERE if end in ends)
        loops = f", {closed} closed" if closed else ""
        still = sum(bool(curve.vanishing) for curve in own)
        told = f"{counted(len(own), 'curve')} w{mode} = 0{loops}" + (f", {still} with a = 0 all along" if still else "")
        told += f"; ends: {listed}" if listed else ""
        return told + (f"; {share}" if self.robust_share[mode - 1] > 0 else "")


_WHERE = {
    "limit": "a limit", "singular": "a singular posture", "a = 0": "a = 0", "b = 0": "b = 0",
    "equal frequencies": "equal frequencies", "undefined": "the border of what is defined",
}  # fmt: skip


def _posture(point: RobustPoint) -> str:
    return f"({', '.join(f'{x:.{DIGITS}f}' for x in point.posture)})"


def _kind(point: RobustPoint) -> str:
    return f"{point.vanishing} = 0" if point.vanishing else "robust" if len(point.modes) == 1 else "doubly robust"
