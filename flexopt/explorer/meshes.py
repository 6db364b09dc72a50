"""What a page draws of a machine's bodies besides capsules: meshes and shapes, each body's as one mesh of triangles.

In: the machine's visuals. Out: for each body corners, quantised to 16 bits of its box, and triangles; sentences on what
is left out. Files are read by trimesh and simplified by fast-simplification, both of the extra `meshes`.
"""

from __future__ import annotations

import base64
import io
import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Vector
from flexopt.foundation.plain import counted
from flexopt.foundation.reading import read_bounded
from flexopt.model.tables import Visual

# Triangles of a whole page: more are simplified, for a picture must be drawn within a frame.
TRIANGLES = 20_000
# Bytes of one file, and triangles of all that are still simplified.
FILE_MAX, READ_MAX = 100_000_000, 2_000_000
SUFFIXES = (".stl", ".obj", ".dae")
NEEDED = 'drawing them needs trimesh: pip install "flexopt[meshes]"'
WITHOUT = "Meshes and shapes of the robot file are drawn where flexopt's extra meshes is installed."
# What it says of textures and the like matters to nobody here.
logging.getLogger("trimesh").addHandler(logging.NullHandler())
# A simplified mesh may have so many times its share of the triangles. Meshes in pieces resist: corners that are so near
# to each other, as shares of the mesh's size, are then made one first.
MISSED, GRIDS = 1.5, (0.0, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1)
STEPS = 2**16 - 1
_READING: Mapping[str, Mapping[str, Any]] = {".obj": {"skip_materials": True}}

Faces = NDArray[np.int64]
# Corners (n, 3), m, and numbers of those of each triangle (k, 3).
MeshPart = tuple[Vector, Faces]


class _Unreadable(Exception):
    """A mesh that is left out, and why."""


@dataclass(frozen=True, eq=False)
class BodyMesh:
    """Triangles of one body, in its axes.

    Attributes:
        body: its name; None for the anchor frame.
        corners: (n, 3), m.
        triangles: numbers of their corners (k, 3).
    """

    body: str | None
    corners: Vector
    triangles: Faces


@dataclass(frozen=True, eq=False)
class Meshes:
    """What a page draws of bodies.

    Attributes:
        bodies: of which something is drawn.
        given: triangles before they were simplified.
        left_out: what is not drawn, and why.
        note: why nothing is drawn.
    """

    bodies: tuple[BodyMesh, ...] = ()
    given: int = 0
    left_out: tuple[str, ...] = ()
    note: str = ""

    @property
    def triangles(self) -> int:
        """How many there are."""
        return sum(len(mesh.triangles) for mesh in self.bodies)

    def layout(self, names: Sequence[str]) -> list[dict[str, Any]]:
        """For the page; bodies as numbers of `names`, the anchor frame as −1."""
        return [_packed(mesh, -1 if mesh.body is None else names.index(mesh.body)) for mesh in self.bodies]

    @property
    def told(self) -> str:
        """For the page, which names no file of the machine that it was made on."""
        if self.note:
            return self.note
        of = f", simplified from {self.given}" if self.given > self.triangles else ""
        drawn = f"Meshes: {self.triangles} triangles{of}." if self.bodies else ""
        count = len(self.left_out)
        missing = f"Not drawn: {counted(count, 'mesh', 'meshes')}; capsules, if any, stay there." if count else ""
        return " ".join(filter(None, [drawn, missing]))


def body_meshes(visuals: Iterable[Visual], most: int = TRIANGLES) -> Meshes:
    """Those of a machine; `most`: triangles of all together."""
    visuals = tuple(visuals)
    if not visuals:
        return Meshes()
    try:
        trimesh = import_module("trimesh")
    except ImportError:
        files = {visual.file for visual in visuals if visual.shape == "mesh"}
        return Meshes(left_out=(f"{counted(len(files), 'mesh', 'meshes')}: {NEEDED}",) if files else (), note=WITHOUT)
    known: dict[tuple[str, str], MeshPart | str] = {}
    placed: list[tuple[Visual, tuple[str, str]]] = []
    counts: list[int] = []
    beyond: list[str] = []
    for visual in visuals:
        key = visual.shape, visual.file
        if visual.why:
            known[visual.shape, visual.why] = f"{visual.file} ({visual.why})" if visual.file else visual.why
            continue
        if key not in known:
            try:
                known[key] = _read(trimesh, visual.file) if visual.shape == "mesh" else _shape(trimesh, visual.shape)
            except _Unreadable as error:
                known[key] = f"{visual.file} ({error})"
        found = known[key]
        if not isinstance(found, str):
            counts.append(len(found[1]))
            if sum(counts) > READ_MAX:
                beyond.append(f"{visual.file or visual.shape} and what follows (more than {READ_MAX} triangles)")
                counts.pop()
                break
            placed.append((visual, key))
    allowed, parts, seen = _allowed(counts, most), dict[str | None, list[MeshPart]](), set[tuple[str, str]]()
    for visual, key in placed:
        found = known[key]
        if key not in seen and not isinstance(found, str) and len(found[1]) > allowed:
            try:
                found = known[key] = _simplified(found, allowed)
            except _Unreadable as error:
                found = known[key] = f"{visual.file or visual.shape} ({error})"
        seen.add(key)
        if not isinstance(found, str):
            corners = found[0] @ np.array(visual.matrix).T + np.array(visual.position)
            parts.setdefault(visual.body, []).append((corners, found[1]))
    left_out = [*(found for found in known.values() if isinstance(found, str)), *beyond]
    drawn = [_joined(body, of_body) for body, of_body in parts.items()]
    return Meshes(tuple(drawn), sum(counts), tuple(left_out))


def _allowed(counts: Sequence[int], most: int) -> int:
    """Triangles that each mesh may have, so that those of all are not more: meshes of few leave theirs to others."""
    left = most
    for k, count in enumerate(sorted(counts)):
        if count * (len(counts) - k) > left:
            return left // (len(counts) - k)
        left -= count
    return most


def _shape(trimesh: Any, shape: str) -> tuple[Vector, Faces]:
    made = {
        "box": lambda: trimesh.creation.box(extents=(2.0, 2.0, 2.0)),
        "sphere": lambda: trimesh.creation.icosphere(subdivisions=2, radius=1.0),
        "cylinder": lambda: trimesh.creation.cylinder(radius=1.0, height=2.0, sections=24),
    }[shape]()
    return np.asarray(made.vertices, dtype=np.float64), np.asarray(made.faces, dtype=np.int64)


def _read(trimesh: Any, file: str) -> tuple[Vector, Faces]:
    """A file's corners, in its own unit but COLLADA's, which says it, in m, and triangles."""
    path, kind = Path(file), Path(file).suffix.lower()
    if kind not in SUFFIXES:
        raise _Unreadable(f"is none of {', '.join(SUFFIXES)}")
    try:
        content = read_bounded(path, FILE_MAX)
    except OSError as error:
        raise _Unreadable(error.strerror or str(error)) from None
    try:
        # From bytes, so that no other file is opened that this one names.
        scene: Any = trimesh.load_scene(io.BytesIO(content), file_type=kind[1:], **_READING.get(kind, {}))
        units = {part.units for part in scene.geometry.values()} if kind == ".dae" else set[str]()
        unit = trimesh.units.unit_conversion(units.pop(), "meters") if len(units) == 1 else 1.0
        mesh = scene.to_mesh()
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        corners = unit * np.array(mesh.vertices, dtype=np.float64)
        triangles = np.array(mesh.faces, dtype=np.int64)
    except Exception as error:  # a foreign reader's, which may be any
        raise _Unreadable(f"cannot be read: {_first_line(error)}") from None
    if not (len(triangles) and np.isfinite(corners).all()):
        raise _Unreadable("has no triangles" if not len(triangles) else "has corners that are no numbers")
    return corners, triangles


def _first_line(error: Exception) -> str:
    text = str(error).strip() or type(error).__name__
    return text.splitlines()[0][:120]


def _joined(body: str | None, parts: Sequence[MeshPart]) -> BodyMesh:
    starts = np.cumsum([0, *(len(corners) for corners, _ in parts)])
    corners = np.concatenate([corners for corners, _ in parts])
    triangles = [start + triangles for start, (_, triangles) in zip(starts, parts, strict=False)]
    return BodyMesh(body, corners, np.concatenate(triangles))


def _simplified(mesh: MeshPart, wanted: int) -> MeshPart:
    """With so many triangles."""
    try:
        simplify: Any = import_module("fast_simplification").simplify
    except ImportError:
        sentence = f'{len(mesh[1])} triangles; fewer by fast-simplification: pip install "flexopt[meshes]"'
        raise _Unreadable(sentence) from None
    for share in GRIDS:
        corners, triangles = _on_grid(*mesh, share)
        if len(triangles) > wanted:
            corners, triangles = simplify(corners, triangles.astype(np.int32), target_count=wanted)
        if 0 < len(triangles) <= MISSED * wanted:
            return np.asarray(corners, dtype=np.float64), np.asarray(triangles, dtype=np.int64)
    raise _Unreadable(f"{len(mesh[1])} triangles, which cannot be simplified to {wanted}")


def _on_grid(corners: Vector, triangles: Faces, share: float) -> tuple[Vector, Faces]:
    """Corners within a share of the mesh's size made one, and the triangles that are left; all of them for 0."""
    if share == 0:
        return corners, triangles
    step = share * float((corners.max(axis=0) - corners.min(axis=0)).max())
    cells, numbers = np.unique(np.round(corners / step), axis=0, return_inverse=True)
    moved: Faces = numbers.ravel()[triangles]
    a, b, c = moved.T
    return step * cells, moved[(a != b) & (b != c) & (c != a)]


def _packed(mesh: BodyMesh, body: int) -> dict[str, Any]:
    low: Vector = mesh.corners.min(axis=0)
    step: Vector = np.maximum(mesh.corners.max(axis=0) - low, 1e-9) / STEPS
    corners: Any = np.round((mesh.corners - low) / step).astype("<u2")
    wide = len(corners) > STEPS + 1
    triangles: Any = mesh.triangles.astype("<u4" if wide else "<u2")
    return {
        "body": body,
        "low": low.tolist(),
        "step": step.tolist(),
        "wide": wide,
        "corners": base64.b64encode(corners.tobytes()).decode(),
        "triangles": base64.b64encode(triangles.tobytes()).decode(),
    }
