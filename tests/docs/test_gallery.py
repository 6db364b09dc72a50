"""The gallery shows every kind of picture, and its lines draw what it shows."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from PIL import Image

from docs import gallery
from flexopt.foundation.pictures import drawers

pytestmark = pytest.mark.filterwarnings("ignore::flexopt.errors.CompilerNotFound")


def test_every_kind_of_picture_is_there():
    assert {(exhibit.kind, exhibit.form) for exhibit in gallery.EXHIBITS} == set(drawers())
    assert len({exhibit.name for exhibit in gallery.EXHIBITS}) == len(gallery.EXHIBITS)


# Seconds each, on machines in space or over maps: the build of the pages in .ci/run draws and looks at all.
LONG = ("stand", "selection-in-space", "plan", "map-of-the-base", "map", "atlas")
QUICK = [exhibit for exhibit in gallery.EXHIBITS if exhibit.name not in LONG]


@pytest.mark.long
@pytest.mark.parametrize("exhibit", QUICK, ids=lambda exhibit: exhibit.name)
def test_its_lines_draw_it(exhibit: gallery.Exhibit, tmp_path: Path):
    assert type(gallery.draw(exhibit, tmp_path)).__name__ == exhibit.kind


def test_the_build_draws_all_of_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    drawn: list[str] = []
    monkeypatch.setattr(gallery, "draw", lambda exhibit, _: drawn.append(exhibit.name))
    gallery.write_pictures(tmp_path)
    assert drawn == [exhibit.name for exhibit in gallery.EXHIBITS]
    assert set(LONG) < set(drawn)


@pytest.mark.parametrize(
    ("kind", "light", "dark", "words"),
    [
        ("Trajectory", "white", "white", "grounds"),
        ("Trajectory", "black", "black", "grounds"),
        ("Atlas", "white", "black", "shows a Trajectory, not a Atlas"),
    ],
)
def test_what_is_drawn_wrongly_ends_the_build(kind: str, light: str, dark: str, words: str, tmp_path: Path):
    result = type("Trajectory", (), {})()
    exhibit = gallery.Exhibit("x", "", "", kind, "")
    for ground, file in zip((light, dark), gallery.files_of(exhibit, tmp_path), strict=True):
        Image.new("RGB", (4, 4), ground).save(file)
    with pytest.raises(ValueError, match=words):
        gallery.looked_at(exhibit, result, *gallery.files_of(exhibit, tmp_path))


def test_the_page_shows_all_of_it(tmp_path: Path):
    page = gallery.page()
    shown = set(re.findall(rf"{gallery.FOLDER}/([\w.-]+)", page))
    assert shown == {file.name for exhibit in gallery.EXHIBITS for file in gallery.files_of(exhibit, tmp_path)}
    assert "FILE" not in page


@pytest.mark.long
def test_what_is_newer_than_the_code_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(gallery, "EXHIBITS", [e for e in gallery.EXHIBITS if e.name == "run"])
    gallery.write_pictures(tmp_path)
    files = sorted((tmp_path / gallery.FOLDER).iterdir())
    before = [file.stat().st_mtime_ns for file in files]
    gallery.write_pictures(tmp_path)
    assert [file.stat().st_mtime_ns for file in files] == before
    assert [file.name for file in files] == ["run-dark.png", "run.png"]
