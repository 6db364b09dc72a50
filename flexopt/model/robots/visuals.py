"""Visual geometry of robot files: what a picture draws of a link, files of meshes among it.

In: <visual> of URDF, <geom> of MJCF with the meshes of its <asset>. Out: `LinkVisual`s in the link's frame. Nothing of
it changes a number, so that nothing in it is a fault: what cannot be drawn keeps the sentence that says why.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path, PureWindowsPath
from urllib.parse import unquote
from urllib.request import url2pathname

import numpy as np

from flexopt.foundation.arrays import Array
from flexopt.foundation.quantities import LENGTH_MAX
from flexopt.model.robots.collisions import URDF_SHAPES
from flexopt.model.robots.elements import Element, Faults
from flexopt.model.robots.geometry import Pose, from_quaternion
from flexopt.model.robots.mjcf_geoms import SIZES, geom_size
from flexopt.model.robots.mjcf_settings import MAIN, Settings

# Groups of geoms that MuJoCo's viewer shows unasked; files in use keep collision geometry in the others.
SHOWN_GROUPS = (0, 1, 2)
# Where ROS looks for packages, and what stands between these folders and a package's own.
PACKAGE_FOLDERS = {"ROS_PACKAGE_PATH": "", "AMENT_PREFIX_PATH": "share"}

Origin = Callable[[Faults, Element, Element], Pose]


@dataclass(frozen=True, eq=False)
class LinkVisual:
    """A mesh or a shape of unit size: its points v lie at `matrix` v + `position`, m, in the link's frame.

    Attributes:
        shape: `"mesh"`, or `"box"`, `"sphere"`, `"cylinder"` as in `Visual`.
        file: of a mesh, found or as the robot file names it.
        why: it cannot be drawn; empty where it can.
    """

    shape: str
    matrix: Array = field(default_factory=lambda: np.eye(3))
    position: Array = field(default_factory=lambda: np.zeros(3))
    file: str = ""
    why: str = ""

    def seen_from(self, pose: Pose) -> LinkVisual:
        """The same, in the frame in which `pose` gives this one's."""
        moved = replace(
            self, matrix=pose.rotation @ self.matrix, position=pose.position + pose.rotation @ self.position
        )
        if np.abs([*moved.matrix, moved.position]).max() <= LENGTH_MAX:
            return moved
        return LinkVisual(self.shape, file=self.file, why=self.why or f"reaches beyond {LENGTH_MAX:g} m")


def urdf_visuals(link: Element, origin: Origin, folder: Path) -> tuple[LinkVisual, ...]:
    """Those of a URDF link.

    Args:
        link: the element.
        origin: reads the <origin> of an element that is part of another.
        folder: of the robot file.
    """
    return tuple(seen for visual in link.all("visual") for seen in _urdf_visual(link, visual, origin, folder))


def _urdf_visual(link: Element, visual: Element, origin: Origin, folder: Path) -> tuple[LinkVisual, ...]:
    faults = Faults()
    holder = visual.first("geometry")
    shape = holder.children[0] if holder is not None and holder.children else None
    if shape is None:
        return (LinkVisual("mesh", why=f"{visual.place}: <visual> has no shape"),)
    pose, size = origin(faults, visual, link), np.ones(3)
    if shape.tag == "mesh":
        size = faults.numbers(shape, "scale", 3, (1.0, 1.0, 1.0), link)
    elif shape.tag == "box":
        size = faults.numbers(shape, "size", 3, (0.0, 0.0, 0.0), link) / 2
    elif shape.tag in URDF_SHAPES:
        size = np.array([factor * faults.number(shape, key, 0.0, link) for key, factor in URDF_SHAPES[shape.tag]])
    else:
        return (LinkVisual("mesh", why=f"{shape.place}: <{shape.tag}> is no shape that is drawn"),)
    if faults.faults:
        return (LinkVisual("mesh", why=f"{faults.faults[0].field} {faults.faults[0].sentence}"),)
    if shape.tag == "mesh":
        name = shape.attributes.get("filename", "").strip()
        return (_mesh(name, np.diag(size), np.zeros(3), folder, shape).seen_from(pose),)
    return _shape(shape.tag, [float(part) for part in size], pose, shape)


def mjcf_meshes(root: Element, settings: Settings, folder: Path) -> dict[str, LinkVisual]:
    """The meshes of an MJCF file by name: vertices v become S Rᵀ (v − p), with its scale, `refpos` and `refquat`.

    Args:
        root: the root element, included files in place.
        settings: of the compiler.
        folder: of the robot file.
    """
    compiler: dict[str, str] = {}
    for element in root.all("compiler"):
        compiler |= element.attributes
    inside = compiler.get("meshdir", compiler.get("assetdir", ""))
    stripped = compiler.get("strippath", "false") == "true"
    found: dict[str, LinkVisual] = {}
    for asset in root.all("asset"):
        for written in asset.all("mesh"):
            quiet = replace(settings, faults=Faults())
            mesh = quiet.resolved(written, MAIN)
            file = mesh.attributes.get("file", "").strip()
            name = mesh.attributes.get("name") or PureWindowsPath(file).stem
            scale = quiet.faults.numbers(mesh, "scale", 3, (1.0, 1.0, 1.0))
            place = quiet.faults.numbers(mesh, "refpos", 3, (0.0, 0.0, 0.0))
            turn = quiet.faults.numbers(mesh, "refquat", 4, (1.0, 0.0, 0.0, 0.0))
            matrix = np.diag(scale) @ (from_quaternion(turn).T if turn.any() else np.eye(3))
            where = PureWindowsPath(file).name if stripped else file
            path = (Path(inside) / where).as_posix() if file else ""
            found[name] = _mesh(path, matrix, -matrix @ place, folder, mesh)
            if quiet.faults.faults:
                found[name] = LinkVisual("mesh", file=file, why=quiet.faults.faults[0].sentence)
    return found


def mjcf_visuals(
    settings: Settings, geom: Element, frame: Pose, of: Element, meshes: Mapping[str, LinkVisual]
) -> tuple[LinkVisual, ...]:
    """Those of a geom with its defaults, `frame` being where its `pos` starts from; none where it is not shown."""
    quiet = replace(settings, faults=Faults())
    faults, shape = quiet.faults, geom.attributes.get("type", "sphere")
    colour = faults.numbers(geom, "rgba", (3, 4), (0.5, 0.5, 0.5, 1.0), of)
    hidden = faults.number(geom, "group", 0.0, of) not in SHOWN_GROUPS or (len(colour) == 4 and colour[3] == 0)
    if hidden or shape not in ("mesh", *SIZES):
        return ()
    if shape != "mesh" and "mesh" in geom.attributes:
        return (LinkVisual(shape, why=f"{geom.place}: is fitted to a mesh, which is not done here"),)
    if shape == "mesh":
        name = geom.attributes.get("mesh", "")
        if name not in meshes:
            return (LinkVisual("mesh", file=name, why=f"{geom.place}: is no <mesh> of the file"),)
        seen, pose = meshes[name], frame @ quiet.pose(geom, of)
        found: tuple[LinkVisual, ...] = (seen.seen_from(pose),)
    else:
        size, pose = geom_size(quiet, geom, shape, of), frame @ quiet.pose(geom, of)
        found = () if size is None else _shape(shape, size, pose, geom)
    if faults.faults:
        return (LinkVisual(shape, why=f"{faults.faults[0].field} {faults.faults[0].sentence}"),)
    return found


def _mesh(name: str, matrix: Array, position: Array, folder: Path, element: Element) -> LinkVisual:
    if not name:
        return LinkVisual("mesh", why=f"{element.place}: <mesh> names no file")
    return LinkVisual("mesh", matrix, position, file=located(name, folder))


def _shape(shape: str, size: list[float], pose: Pose, element: Element) -> tuple[LinkVisual, ...]:
    """Of these half-sizes, centred in `pose`; of cylinders and capsules the axis is z. A capsule is three."""
    if min(size) <= 0:
        return (LinkVisual("mesh", why=f"{element.place}: <{shape}> has a size that is not positive"),)
    if shape in ("box", "ellipsoid"):
        return (LinkVisual("box" if shape == "box" else "sphere", np.diag(size)).seen_from(pose),)
    ball = LinkVisual("sphere", size[0] * np.eye(3))
    if shape == "sphere":
        return (ball.seen_from(pose),)
    bar = LinkVisual("cylinder", np.diag([size[0], size[0], size[1]])).seen_from(pose)
    ends = [replace(ball, position=np.array([0.0, 0.0, end])).seen_from(pose) for end in (-size[1], size[1])]
    return (bar, *ends) if shape == "capsule" else (bar,)


def located(name: str, folder: Path) -> str:
    """The file that a robot file in `folder` means by `name`, whole; as it is written where there is none.

    `package://NAME/…` and `model://NAME/…` are looked for in the folders of ROS_PACKAGE_PATH and AMENT_PREFIX_PATH,
    then beside, and in, the folders that the robot file lies in.
    """
    scheme, _, rest = name.partition("://")
    scheme = scheme.lower() if rest else ""
    tried: list[Path] = []
    if scheme in ("package", "model"):
        package, _, inside = rest.partition("/")
        tried = _in_package(package, inside, folder)
    elif scheme == "file":
        tried = [Path(url2pathname(unquote(rest[rest.find("/") :])))]
    elif not scheme:
        tried = [folder / name.replace("\\", "/")]
    return next((str(path.resolve()) for path in tried if _is_file(path)), name)


def _in_package(package: str, inside: str, folder: Path) -> list[Path]:
    found: list[Path] = []
    for variable, between in PACKAGE_FOLDERS.items():
        for root in filter(None, os.environ.get(variable, "").split(os.pathsep)):
            found += [Path(root) / between / package / inside]
            found += [Path(root) / inside] if Path(root).name == package else []
    above = [folder.resolve(), *folder.resolve().parents]
    found += [path / inside for path in above if path.name == package] + [path / package / inside for path in above]
    # A checkout may have another name than its package.
    return found + [path / inside for path in above]


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False
