"""The result of `map_workspace`: an xarray.Dataset with units, its summary, its file and its picture.

xarray is imported when the first map is made: it takes longer to import than all of flexopt.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Document, MaskLike, Vector
from flexopt.foundation.boundary import array_of, by, check_text, public
from flexopt.foundation.coordinates import check_point
from flexopt.foundation.documents import Gridded, json_ready, provenance
from flexopt.foundation.palette import Theme
from flexopt.foundation.pictures import Size, drawn
from flexopt.foundation.plain import shown
from flexopt.foundation.quantities import whole_number
from flexopt.foundation.results import Tabled
from flexopt.foundation.rounding import ROUNDING
from flexopt.loop.loop_motions import NOWHERE_HELD
from flexopt.loop.many import Decays
from flexopt.model import AnyMachine
from flexopt.robustness.residues import posture_unit, residue_unit
from flexopt.study.maps.grid import Grid
from flexopt.study.maps.points import PointValues

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure


def _sizes(of: Any) -> dict[str, int]:
    """Shape of the map."""
    rows, columns = of.axes
    return {"n_y": of.dataset.sizes[rows], "n_x": of.dataset.sizes[columns]}


def _modes(arguments: Arguments, field: str, value: Any) -> Any:
    """Numbers of modes."""
    return tuple(arguments.checked(field, mode, whole_number(1, 1000), 1) for mode in value)


def _marks(arguments: Arguments, field: str, value: Any) -> dict[str, tuple[float, float]]:
    """Points of the plane by name."""
    if not isinstance(value, Mapping) or not all(isinstance(name, str) for name in cast(Mapping[Any, Any], value)):
        arguments.note(field, "must be a dictionary, name -> (x, y)", value)
        return {}
    points = cast(Mapping[str, Any], value)
    found: dict[str, tuple[float, float]] = {}
    for name, point in points.items():
        x, y = arguments.checked(f"{field}[{shown(name)}]", point, check_point, (0.0, 0.0))
        found[name] = x, y
    return found


@dataclass(frozen=True)
class WorkspaceMap(Gridded, Tabled):
    """Quantities over a grid; NaN where the arm does not reach, breaks a limit or is singular.

    Attributes:
        machine: its name.
        options: those of the call, ranges and points included.
        dataset: variables with the dimensions (mode, y, x): `frequency_hz`, `w`, `scale` (|a_i||b_i|), `in_phase`
            (1 where trace R_i > 0, else 0), `in_phase_strict` (1 where each diagonal element of R_i ≥ 0, to rounding);
            (y, x): `rigid` (λmin(R_0 + R_0ᵀ)), `epsilon_max`, `condition` (cond Jv), `reachable`; (joint, y, x):
            `posture`. Over the posture the dimensions are called `angle_2` and `angle_1` in place of y and x (joint k:
            `angle_k`, or `slide_k`), over the base `base_y` and `base_x` (or `base_yaw`), over a plane of the task by
            its rows.
            Where a loop was given, (y, x): `decay` of the sampled loop, 1/s, and `loop_frequency_hz`, of its slowest
            motion; of a map over the loop's own numbers these alone, the dimensions called by what varies.
            Each variable has `units` (of `posture`, where they differ, one for each joint), `long_name` and
            `description`. Attributes: `title`, `machine`, `control`, `gain`, `gravity`, `over`, `elbow`, `frame`,
            `loop` (its numbers in words), `marks` (JSON, name -> point of the plane), `provenance`.
        provenance: machine, versions and options.

    Example:
        >>> chart.dataset["w"].dims
        ('mode', 'y', 'x')
    """

    machine: str
    options: Document
    dataset: xr.Dataset = field(repr=False)
    provenance: Document = field(repr=False)

    @public(name=by(check_text))
    def array(self, name: str) -> Vector:
        """A variable as an array.

        Raises:
            InputError: the map has none of that name.

        Example:
            >>> chart.array("frequency_hz").shape
            (3, 8, 8)
        """
        if name not in self.dataset.variables:
            listed = ", ".join(map(str, self.dataset.variables))
            raise_if_any(
                InputError, "array", [Fault("name", f"is no variable of the map; it has {listed}", shown(name))]
            )
        return np.asarray(self.dataset[name].values, dtype=float)

    @property
    def axes(self) -> tuple[str, str]:
        """Names of the last two dimensions, rows first."""
        rows, columns = (str(name) for name in self.dataset["reachable"].dims)
        return rows, columns

    @public(sizes=_sizes, mask=array_of(("n_y", "n_x"), kinds="biuf"))
    def fraction(self, mask: MaskLike) -> float:
        """Share of the mapped points (reachable and regular) where `mask` (n_y, n_x) holds; NaN where there are none.

        Example:
            >>> 0 < chart.fraction(chart.array("w")[0] > -1e-5) < 1
            True
        """
        mapped = self._mapped
        count = np.count_nonzero(mapped)
        return float(np.count_nonzero(np.asarray(mask, dtype=bool) & mapped) / count) if count else math.nan

    @property
    def _mapped(self) -> Any:
        # Of one posture every point counts, those at which it falls, too.
        return np.isfinite(self.array("condition")) if "condition" in self.dataset else self.array("reachable") > 0

    @public(modes=_modes)
    def in_phase_fraction(self, *modes: int, strict: bool = False) -> float:
        """Share of the mapped points where all `modes` (counted from 1) are in phase.

        Example:
            >>> 0 < chart.in_phase_fraction(1) < 1
            True
        """
        numbers = range(1, self.dataset.sizes.get("mode", 0) + 1)
        if not modes or any(mode not in numbers for mode in modes):
            sentence = f"must be among the map's modes, {numbers.start} to {numbers.stop - 1}"
            sentence = sentence if numbers else "needs a map with measures"
            raise_if_any(InputError, "in_phase_fraction", [Fault("modes", sentence, shown(modes))])
        in_phase = self.array("in_phase_strict" if strict else "in_phase")
        return self.fraction(np.all(in_phase[[mode - 1 for mode in modes]] == 1, axis=0))

    @public(marks=_marks)
    def plot(
        self,
        path: str | os.PathLike[str] | None = None,
        *,
        marks: Mapping[str, tuple[float, float]] | None = None,
        ax: Axes | Figure | SubFigure | None = None,
        size: Size = "screen",
        theme: Theme = "light",
    ) -> Figure:
        """Frequencies, w_i, in-phase regions and ε_max; written to `path` (`.png`, `.svg`, `.pdf`) where one is given.

        Over the placement a star in each panel of a measure marks where that is best.

        Args:
            path: the file.
            marks: points of the plane to show, name -> (x, y), in place of the map's own.
            ax, size, theme: where, how large and on which ground; as of every picture, `Trajectory.plot`.

        Raises:
            InputError: unusable arguments, or an Axes for several panels.
            WriteError: the file cannot be written.

        Example:
            >>> figure = chart.plot("map.png")
        """
        return drawn(self, path, ax=ax, size=size, theme=theme, marks=marks)

    def to_dict(self) -> Document:
        """JSON-ready summary: ranges, means and shares of the area, with provenance; the arrays go to netCDF.

        Example:
            >>> chart.to_dict()["machine"]
            'excavator'
        """
        rows, columns = self.axes
        mapped = self._mapped
        extent = {name: self.array(name) for name in (columns, rows)}
        axes = {n: {"low": v[0], "high": v[-1], "points": v.size, "unit": _unit(self, n)} for n, v in extent.items()}
        document: dict[str, Any] = {
            "machine": self.machine,
            "control": self.options["control"],
            "gain": self.options.get("gain"),
            "gravity": self.options["gravity"],
            "over": self.options["over"],
            "elbow": self.options.get("elbow"),
            "axes": axes,
            "points": int(mapped.size),
            "reachable": float(self.array("reachable").mean()),
            "mapped": float(mapped.mean()),
            "variables": {name: self._summary(name) for name in map(str, self.dataset.data_vars) if name in SUMMARISED},
        }
        if "in_phase" in self.dataset:
            modes = range(1, self.dataset.sizes["mode"] + 1)
            document["in_phase"] = self._shares(modes, strict=False)
            document["in_phase_strict"] = self._shares(modes, strict=True)
        if "decay" in self.dataset:
            document["stable"] = self.fraction(self.array("decay") > 0)
            document["loop"] = self.options["loop"]
        if self.options["over"] == "loop":
            document["falls"] = self.fraction(np.isnan(self.array("decay")))
        for name, key in (("epsilon_max", "best_epsilon_max"), ("w", "best_w1"), ("decay", "best_decay")):
            if name in self.dataset and mapped.any():
                document[key] = self._best(self.array(name) if name != "w" else self.array(name)[0])
        return json_ready(document | {"provenance": self.provenance})

    def _axis_told(self, name: str) -> str:
        """With the joint that it is of."""
        what = str(self.dataset[name].attrs["long_name"])
        return f"{name} ({what})" if self.options["over"] == "posture" else name

    def __repr__(self) -> str:
        document = self.to_dict()
        axes = ", ".join(
            f"{self._axis_told(n)} {a['low']:g} to {a['high']:g} {a['unit']} ({a['points']} points)"
            for n, a in document["axes"].items()
        )
        lines = [
            f"{self.machine}: Jacobian {self.options['control']} control over {axes}",
            *(f"  {name}: {self.dataset.attrs[name]}" for name in ("frame", "loop") if name in self.dataset.attrs),
        ]
        if self.options["over"] != "loop":
            share = f"{100 * document['mapped']:.1f} % of {document['points']} points"
            lines.append(f"  {share} are {self.dataset.attrs.get('mapped', 'reached and regular')}")
        for name, entry in document["variables"].items():
            for number, (low, mean, high) in enumerate(zip(entry["min"], entry["mean"], entry["max"], strict=True)):
                label = f"{name} {number + 1}" if len(entry["min"]) > 1 else name
                numbers = "  ".join("         –" if v is None else f"{v:10.4g}" for v in (low, mean, high))
                lines.append(f"  {label:16} min, mean, max {numbers} {entry['unit']}".rstrip())
        # Of no point there is no share.
        told = document if document["mapped"] else {}
        if "in_phase" in told:
            for key, title in (("in_phase", "in phase"), ("in_phase_strict", "strictly so")):
                shares = document[key]
                each = ", ".join(f"{100 * share:.1f} %" for share in shares["modes"])
                both = (
                    "" if shares["first_two"] is None else f"; the first two together {100 * shares['first_two']:.1f} %"
                )
                lines.append(f"  {title}: modes {each}{both}")
        if "stable" in told:
            lines.append(f"  the sampled loop is stable at {100 * document['stable']:.1f} % of these points")
        if told.get("falls"):
            lines.append(f"  at {100 * document['falls']:.1f} % of them the arm falls: there {NOWHERE_HELD}")
        return "\n".join(lines)

    def _shares(self, modes: range, *, strict: bool) -> dict[str, Any]:
        both = self.in_phase_fraction(1, 2, strict=strict) if len(modes) > 1 else None
        return {"modes": [self.in_phase_fraction(mode, strict=strict) for mode in modes], "first_two": both}

    def _summary(self, name: str) -> dict[str, Any]:
        values = self.array(name)
        values = values.reshape(values.shape[0] if values.ndim == 3 else 1, -1)
        with np.errstate(all="ignore"):
            finite = [row[np.isfinite(row)] for row in values]

            def each(function: Callable[[Vector], Any]) -> list[float | None]:
                return [float(function(row)) if row.size else None for row in finite]

            return {"unit": _unit(self, name), "min": each(np.min), "mean": each(np.mean), "max": each(np.max)}

    def _best(self, values: Vector) -> dict[str, Any] | None:
        if not np.isfinite(values).any():
            return None
        row, column = np.unravel_index(int(np.nanargmax(values)), values.shape)
        rows, columns = self.axes
        at = {columns: float(self.array(columns)[column]), rows: float(self.array(rows)[row])}
        return at | {"posture": self.array("posture")[:, row, column], "value": float(values[row, column])}


def finished_map(
    machine: AnyMachine,
    options: Document,
    dataset: xr.Dataset,
    title: str,
    frame: str,
    marks: Mapping[str, tuple[float, float]],
    more: Mapping[str, Any],
) -> WorkspaceMap:
    """The map of a dataset, which is told what it is of, and `more`."""
    where = provenance(machine, **options)
    dataset.attrs |= {
        "title": title, "machine": machine.name, "control": options["control"], "frame": frame, **more,
        "gravity": str(options["gravity"]).lower(), "over": options["over"], "marks": json.dumps(marks),
        "provenance": json.dumps(where),
    }  # fmt: skip
    return WorkspaceMap(machine.name, options, dataset, where)


def _unit(result: WorkspaceMap, name: str) -> str:
    unit = cast(str, result.dataset[name].attrs["units"])
    return "" if unit == "1" else unit


# Of these the summary has ranges and means.
SUMMARISED = ("frequency_hz", "w", "rigid", "epsilon_max", "decay", "loop_frequency_hz", "condition")
# name -> unit, long name, description; the dimensions follow from the arrays.
DESCRIPTIONS = {
    "frequency_hz": ("Hz", "natural frequency", "undamped, ω_i / 2π, in ascending order"),
    "w": (
        "{residue}",
        "measure w_i",
        "λmin(R_i + R_iᵀ): below 0 feedback may excite the mode, from 0 on it cannot",
    ),
    "scale": ("{residue}", "size of the residue", "|a_i||b_i| of R_i = a_i b_iᵀ, to compare w_i with"),
    "in_phase": ("1", "in phase", "1 where trace R_i > 0, 0 where not"),
    "in_phase_strict": ("1", "strictly in phase", "1 where every diagonal element of R_i is at least 0, 0 where not"),
    "rigid": ("{residue}", "passivity of the rigid part", "λmin(R_0 + R_0ᵀ); negative where R_0/s² is not passive"),
    "epsilon_max": ("1", "robust stability margin ε_max", "of the damped plant times the servo gain kr"),
    "decay": ("1/s", "decay of the loop", "of the slowest motion of the exact sampled loop; negative where it grows"),
    "loop_frequency_hz": ("Hz", "frequency of the slowest motion", "of the exact sampled loop"),
    "posture": ("rad", "posture", "actuated joints; angles relative, counter-clockwise positive"),
    "reachable": ("1", "reachable", "whether a posture within the joint limits belongs to the point"),
    "condition": ("1", "condition of Jv", "ratio of the singular values of the rigid-body Jacobian"),
}


def workspace_dataset(
    grid: Grid,
    values: PointValues,
    machine: AnyMachine,
    *,
    measures: bool,
    margins: bool,
    control: str,
    loop: Decays | None = None,
) -> xr.Dataset:
    """Arrays with their axes, units and descriptions; `loop`: of the same points as the values."""
    regular = np.isfinite(values.rigid)

    def spread(array: Vector) -> Vector:
        full = np.full((*array.shape[:-1], *grid.reachable.shape), np.nan)
        full[..., grid.reachable] = np.where(regular, array, np.nan)
        return full

    plane, mode = (grid.y.name, grid.x.name), ("mode",)
    fields: dict[str, tuple[tuple[str, ...], Any]] = {}
    if measures:
        fields["frequency_hz"] = (mode + plane, spread(values.frequency_hz))
        fields["w"] = (mode + plane, spread(values.w))
        fields["scale"] = (mode + plane, spread(values.scale))
        fields["in_phase"] = (mode + plane, spread((values.trace > 0).astype(float)))
        strict = values.least_diagonal >= -ROUNDING * values.scale
        fields["in_phase_strict"] = (mode + plane, spread(strict.astype(float)))
        fields["rigid"] = (plane, spread(values.rigid))
    if margins:
        fields["epsilon_max"] = (plane, spread(values.epsilon_max))
    if loop is not None:
        fields["decay"] = (plane, spread(loop.decay))
        fields["loop_frequency_hz"] = (plane, spread(loop.frequency_hz))
    fields["condition"] = (plane, spread(values.condition))
    dataset = _dataset(grid, fields, machine, control)
    if measures:
        numbers = list(range(1, values.w.shape[0] + 1))
        said = {"units": "1", "long_name": "vibration mode, by ascending frequency"}
        dataset.coords["mode"] = (mode, numbers, said)
    return dataset


def loop_dataset(grid: Grid, loop: Decays, machine: AnyMachine) -> xr.Dataset:
    """The like of one posture, with other numbers at every point."""
    plane, shape = (grid.y.name, grid.x.name), grid.reachable.shape
    fields = {"decay": loop.decay, "loop_frequency_hz": loop.frequency_hz}
    return _dataset(grid, {name: (plane, values.reshape(shape)) for name, values in fields.items()}, machine, "")


def import_xarray() -> None:
    """xarray, and what it imports with its first array."""
    import xarray as xr  # noqa: PLC0415  (slow to import)

    xr.Variable(("point",), [0.0])


def _dataset(
    grid: Grid, fields: Mapping[str, tuple[tuple[str, ...], Any]], machine: AnyMachine, control: str
) -> xr.Dataset:
    import xarray as xr  # noqa: PLC0415  (slow to import)

    plane, joint = (grid.y.name, grid.x.name), ("joint",)
    whole = {**fields, "posture": (joint + plane, grid.posture), "reachable": (plane, grid.reachable)}
    variables = {name: (*entry, _attributes(name, control, machine.joint_units)) for name, entry in whole.items()}
    coordinates: dict[str, Any] = {
        axis.name: ((axis.name,), axis.values, {"units": axis.unit, "long_name": axis.long_name})
        for axis in (grid.y, grid.x)
    }
    coordinates["joint"] = (joint, list(machine.joints), {"long_name": "actuated joint"})
    return xr.Dataset(variables, coordinates)


def _attributes(name: str, control: str, joint_units: tuple[str, ...]) -> dict[str, str]:
    units, long_name, description = DESCRIPTIONS[name]
    residue = residue_unit(control, joint_units)
    return {
        "units": posture_unit(joint_units) if name == "posture" else units.replace("{residue}", residue),
        "long_name": long_name,
        "description": description,
    }
