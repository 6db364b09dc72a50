"""Meshes of robot files on the page: read, simplified, quantised and drawn, against shapely's and NumPy's geometry."""

from __future__ import annotations

import sys
from base64 import b64decode
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from playwright.sync_api import Browser, Page
from shapely import union_all
from shapely.geometry import Polygon

import flexopt
from flexopt.errors import FlexoptWarning
from flexopt.explorer import meshes
from flexopt.explorer.meshes import body_meshes
from flexopt.model.robots import robot_from_dict
from flexopt.model.tables import Visual
from flexopt.model.tree import Tree
from flexopt.plant import build_plant
from tests.explorer.browser import drag, opened, settled, state
from tests.model.robots.test_visuals import MJCF, MJCF_MACHINE, WEDGE, frames, in_space

# Shapes of unit size as `Visual` tells them; trimesh's balls and cylinders are fine enough for a picture.
UNIT = {"box": trimesh.creation.box((2, 2, 2)), "sphere": trimesh.creation.icosphere(2),
        "cylinder": trimesh.creation.cylinder(1, 2, sections=24), "mesh": WEDGE}  # fmt: skip
CAPSULES = [{"link": "arm", "start": [0, 0, 0], "end": [1, 0.2, 0.1], "radius": 0.1}]


@pytest.fixture
def robot(tmp_path: Path) -> Tree:
    """A machine of two meshes, shapes, and a capsule."""
    (tmp_path / "parts").mkdir()
    WEDGE.export(tmp_path / "parts" / "wedge.stl")
    (tmp_path / "robot.xml").write_text(MJCF)
    return robot_from_dict(MJCF_MACHINE | {"capsules": CAPSULES}, folder=tmp_path)


def surfaces(tree: Tree, q: np.ndarray) -> np.ndarray:
    """All triangles (k, 3, 3) in space, by Python's frames."""
    of = frames(tree, q)
    found: list[np.ndarray] = []
    for visual in tree.visuals:
        position, matrix = in_space(visual, of)
        found.append((UNIT[visual.shape].vertices @ matrix.T + position)[UNIT[visual.shape].faces])
    return np.concatenate(found)


def drawn(page: Page, view: int) -> dict[str, Any]:
    """The depths that a view's picture has, and how it is seen; as one text, as a list takes Playwright seconds."""
    return page.evaluate(
        """(k) => {
          const view = explorer.views[k], { meshes, shape, theme } = explorer;
          const { depth, fine, canvas, pixels } = meshes.picture(view);
          pixels.fill(0);
          depth.fill(-Infinity);
          meshes.draw(view.canvas.getContext("2d"), view, shape.places, theme.present, theme);
          const bytes = new Uint8Array(depth.buffer, depth.byteOffset, depth.byteLength);
          let text = "";
          for (let k = 0; k < bytes.length; k += 4096) text += String.fromCharCode(...bytes.subarray(k, k + 4096));
          return { depth: btoa(text), width: canvas.width, fine,
            painted: pixels.reduce((n, p) => n + (p !== 0), 0), scale: view.scale, origin: [...view.origin], axes: view.axes };
        }""",
        view,
    )


def agree(tree: Tree, page: Page, view: int) -> None:
    """The picture covers the projected triangles, and each of its pixels has the depth of the nearest."""
    at, seen = state(page), drawn(page, view)
    plant = build_plant(tree)
    q = plant.rest(at["base"], at["posture"], plant.parameter_values).full().ravel()
    u, v = np.array(seen["axes"])
    axes, fine = np.array([u, v, np.cross(u, v)]), seen["fine"]
    flat = surfaces(tree, q) @ axes.T
    x = fine * (seen["origin"][0] + seen["scale"] * flat[..., 0])
    y = fine * (seen["origin"][1] - seen["scale"] * flat[..., 1])
    z = flat[..., 2]
    outlines = union_all([Polygon(zip(*corners, strict=True)).buffer(0) for corners in zip(x, y, strict=True)])
    depth = np.frombuffer(b64decode(seen["depth"]), "<f4").astype(float).reshape(-1, seen["width"])
    covered = np.argwhere(depth != -np.inf)
    assert len(covered) == seen["painted"] > 500
    box = Polygon([(0, 0), (depth.shape[1], 0), (depth.shape[1], depth.shape[0]), (0, depth.shape[0])])
    assert len(covered) == pytest.approx(outlines.intersection(box).area, rel=0.02)
    rng, size, (a, b, c) = np.random.default_rng(0), float(np.ptp(z)), np.moveaxis(np.stack([x, y], axis=-1), 1, 0)
    compared = 0
    for row, column in rng.permutation(covered)[:80]:
        point = np.array([column + 0.5, row + 0.5])
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = np.stack([cross(b - point, c - point), cross(c - point, a - point), cross(a - point, b - point)])
            shares /= cross(b - a, c - a)
        inside, touched = (shares > 1e-3).all(axis=0), (shares > -1e-3).all(axis=0)
        if not inside.any() or touched.sum() != inside.sum():
            continue  # on an edge either side is right
        depths = (shares.T * z).sum(axis=1)
        assert depth[row, column] == pytest.approx(depths[inside].max(), abs=1e-3 * size)
        compared += 1
    assert compared > 40


def cross(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    return p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]


@pytest.mark.long
@pytest.mark.needs("chromium")
def test_meshes_are_where_python_has_them(chromium: Browser, pages: Path, robot: Tree) -> None:
    """In both views, after drags of the end-point, keys, and turns of the picture."""
    explorer = flexopt.explore(robot, [0.4, 0.7])
    with opened(chromium, explorer, pages) as page:
        page.locator("#motion").select_option("off")
        agree(robot, page, 0)
        agree(robot, page, 1)
        before = state(page)["posture"]
        drag(page, ".handle.end", 25, -30)
        page.locator("canvas.turning").focus()
        page.keyboard.press("ArrowLeft")
        page.keyboard.press("ArrowUp")
        settled(page)
        assert not np.allclose(state(page)["posture"], before, atol=1e-3)
        agree(robot, page, 0)
        agree(robot, page, 1)


@pytest.mark.long
@pytest.mark.needs("chromium")
def test_meshes_stand_for_the_capsules_of_their_bodies(chromium: Browser, pages: Path, robot: Tree) -> None:
    explorer = flexopt.explore(robot, [0.4, 0.7])
    picture = "explorer.views[0].canvas.toDataURL()"
    with opened(chromium, explorer, pages) as page:
        page.locator("#motion").select_option("off")
        note = page.locator("#meshes-note").inner_text()
        assert f"{explorer.triangles} triangles" in note
        with_meshes = page.evaluate(picture)
        page.locator("#show-meshes").uncheck()
        settled(page)
        assert page.evaluate(picture) != with_meshes
        page.locator("#show-meshes").check()
        settled(page)
        assert page.evaluate(picture) == with_meshes
    assert str(explorer.triangles) in repr(explorer)
    assert 0 < explorer.mesh_bytes < explorer.bytes
    plain = robot.model_copy(update={"visuals": ()})
    without = flexopt.explore(plain, [0.4, 0.7])
    assert without.triangles == without.mesh_bytes == 0
    with opened(chromium, without, pages) as page:
        assert page.locator("#meshes-shown").is_hidden()


@pytest.mark.long
@pytest.mark.needs("chromium")
def test_what_stands_on_the_ground_moves_with_the_placement(chromium: Browser, pages: Path, robot: Tree) -> None:
    pedestal = Visual(shape="box", matrix=((0.5, 0, 0), (0, 0.3, 0), (0, 0, 0.2)), position=(0.2, 0.0, 0.1))
    machine = robot.model_copy(update={"visuals": (pedestal,)})
    explorer = flexopt.explore(machine, [0.4, 0.7], base=[1.0, -2.0, 0.5])
    with opened(chromium, explorer, pages) as page:
        place = page.evaluate(
            "(() => { const p = explorer.shape.places.at(-1); return [...p.origin, ...p.rotation]; })()"
        )
    assert np.allclose(place[:3], [1, -2, 0], atol=1e-12)
    c, s = np.cos(0.5), np.sin(0.5)
    assert np.allclose(place[3:], [c, s, 0, -s, c, 0, 0, 0, 1], atol=1e-12)


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "obj", "dae"])
def test_formats(tmp_path: Path, kind: str) -> None:
    """The same corners and area from each; COLLADA in its own unit."""
    file = tmp_path / f"wedge.{kind.split('_', maxsplit=1)[0]}"
    WEDGE.export(file, file_type=kind)
    if kind == "dae":
        text = file.read_text()
        assert '<unit meter="1' in text or "<unit" not in text
        unit = '<unit name="centimeter" meter="0.01"/>'
        text = (
            text.replace("<asset>", f"<asset>{unit}", 1)
            if "<unit" not in text
            else text.replace('meter="1.0"', 'meter="0.01"').replace('meter="1"', 'meter="0.01"')
        )
        file.write_text(text)
    turned = ((0.0, -2.0, 0.0), (2.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    found = body_meshes([Visual(body="b", file=str(file), matrix=turned, position=(1.0, 2.0, 3.0))])
    assert found.left_out == ()
    (mesh,) = found.bodies
    unit = 0.01 if kind == "dae" else 1.0
    placed = unit * WEDGE.vertices @ np.array(turned).T + [1, 2, 3]
    assert len(mesh.corners) == 5
    apart = np.linalg.norm(mesh.corners[:, None] - placed[None], axis=2)
    assert apart.min(axis=0).max() < 1e-6
    assert len(mesh.triangles) == 6


@pytest.mark.long
def test_a_million_triangles_are_simplified(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=8)
    assert len(ball.faces) > 1_000_000
    ball.export(tmp_path / "ball.stl")
    found = body_meshes([Visual(body="b", file=str(tmp_path / "ball.stl")), Visual(body="c", shape="box")])
    assert found.given == len(ball.faces) + 12
    assert meshes.TRIANGLES / 2 < found.triangles <= meshes.MISSED * meshes.TRIANGLES
    assert f"simplified from {found.given}" in found.told
    assert np.allclose(np.linalg.norm(found.bodies[0].corners, axis=1), 1, atol=2e-3)


def test_meshes_in_pieces_are_simplified_or_refused(tmp_path: Path) -> None:
    """Thousands of loose pins on a ball, which no decimation takes away; and triangles all over a cube."""
    pin, rng = trimesh.creation.icosphere(0, radius=2e-3), np.random.default_rng(0)
    at = rng.normal(size=(4000, 3))
    pins = [pin.vertices + place for place in at / np.linalg.norm(at, axis=1)[:, None]]
    faces = [pin.faces + len(pin.vertices) * k for k in range(len(pins))]
    trimesh.Trimesh(np.concatenate(pins), np.concatenate(faces)).export(tmp_path / "pins.stl")
    found = body_meshes([Visual(body="b", file=str(tmp_path / "pins.stl"))], most=10_000)
    assert 0 < found.triangles <= meshes.MISSED * 10_000
    assert np.allclose(np.linalg.norm(found.bodies[0].corners, axis=1), 1, atol=0.02)
    soup = rng.uniform(size=(40_000, 3, 3))
    trimesh.Trimesh(soup.reshape(-1, 3), np.arange(120_000).reshape(-1, 3)).export(tmp_path / "soup.stl")
    found = body_meshes([Visual(body="b", file=str(tmp_path / "soup.stl"))], most=100)
    assert found.triangles <= 150
    assert found.bodies or "cannot be simplified to 100" in found.left_out[0]


def test_meshes_of_one_body_have_a_share_each(tmp_path: Path) -> None:
    """As of a robot whose trunk, screen and other arm are held fast: no one takes what the others need."""
    visuals: list[Visual] = []
    for k, subdivisions in enumerate((1, 4, 5, 6)):
        file = tmp_path / f"ball{k}.stl"
        trimesh.creation.icosphere(subdivisions).export(file)
        visuals.append(Visual(body="b", file=str(file), position=(3.0 * k, 0.0, 0.0)))
    found = body_meshes(visuals, most=2000)
    assert not found.left_out
    corners, triangles = found.bodies[0].corners, found.bodies[0].triangles
    of_ball = np.round(corners[triangles[:, 0], 0] / 3).astype(int)
    counts = np.bincount(of_ball)
    assert counts[0] == 80
    assert counts.sum() <= meshes.MISSED * 2000
    assert counts[1:].min() >= 0.9 * counts[1:].max()
    middles = np.stack([3.0 * np.arange(4), np.zeros(4), np.zeros(4)], axis=1)
    assert np.allclose(np.linalg.norm(corners[triangles[:, 0]] - middles[of_ball], axis=1), 1, atol=0.03)


def test_what_was_drawn_before_too_much_was_read_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trimesh.creation.icosphere(4).export(tmp_path / "ball.stl")
    monkeypatch.setattr(meshes, "READ_MAX", 50_000)
    visuals = [Visual(body=f"b{k}", file=str(tmp_path / "ball.stl")) for k in range(12)]
    found = body_meshes(visuals)
    assert len(found.bodies) == 9
    assert len(found.left_out) == 1
    assert "ball.stl and what follows" in found.left_out[0]


@given(st.lists(st.integers(1, 10**6), min_size=1, max_size=30), st.integers(100, 10**5))
def test_small_bodies_leave_their_triangles_to_large_ones(counts: list[int], most: int) -> None:
    """No more than may be all together, as many as may be, and no body cut below one that is kept whole."""
    allowed = meshes._allowed(counts, most)
    kept = [min(count, allowed) for count in counts]
    assert sum(kept) <= most
    assert sum(kept) == sum(counts) or sum(kept) > most - len(counts)


def test_what_is_too_large_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    WEDGE.export(tmp_path / "wedge.stl")
    visual = Visual(body="b", file=str(tmp_path / "wedge.stl"))
    monkeypatch.setattr(meshes, "READ_MAX", 5)
    assert "wedge.stl and what follows (more than 5 triangles)" in body_meshes([visual]).left_out[0]
    monkeypatch.setattr(meshes, "FILE_MAX", 100)
    assert "is larger than" in body_meshes([visual]).left_out[0]


BROKEN = {
    "a.stl": (b"solid nothing", "a.stl ("),
    "b.obj": (b"", "b.obj ("),
    "c.dae": (b"<COLLADA", "c.dae (cannot be read"),
    "d.ply": (b"ply", "is none of .stl, .obj, .dae"),
    "e.stl": (b"\0" * 80 + b"\xff\xff\xff\x7f", "e.stl ("),
    "f.stl": (None, "f.stl (No such file"),
}


def test_one_warning_names_what_is_not_drawn(robot: Tree, tmp_path: Path) -> None:
    """And the capsules stay."""
    files = []
    for name, (content, _) in BROKEN.items():
        files.append(tmp_path / name)
        if content is not None:
            files[-1].write_bytes(content)
    wrong = tuple(Visual(body="arm", file=str(file)) for file in files)
    with pytest.warns(FlexoptWarning, match="capsules, if any, stay") as caught:
        explorer = flexopt.explore(robot.model_copy(update={"visuals": wrong}), [0.4, 0.7])
    (warning,) = [each for each in caught if "not drawn" in str(each.message)]
    assert "and 1 more" in str(warning.message)
    assert warning.filename == __file__
    assert explorer.triangles == 0
    assert "Not drawn: 6 meshes; capsules, if any, stay there." in explorer.page
    assert str(tmp_path) not in explorer.page
    left_out = body_meshes(wrong).left_out
    for (_, sentence), found in zip(BROKEN.values(), left_out, strict=True):
        assert sentence in found


def test_without_the_extra(robot: Tree, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.warns(FlexoptWarning, match=r"1 mesh.*pip install \"flexopt\[meshes\]\""):
        explorer = flexopt.explore(robot, [0.4, 0.7])
    assert explorer.triangles == 0
    # Shapes alone are no reason to warn: capsules show as much.
    shapes = tuple(visual for visual in robot.visuals if visual.shape != "mesh")
    explorer = flexopt.explore(robot.model_copy(update={"visuals": shapes}), [0.4, 0.7])
    assert "extra meshes is installed" in explorer.page
