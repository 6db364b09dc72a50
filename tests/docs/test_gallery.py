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


def picture(file: Path) -> Image.Image:
    with Image.open(file) as opened:
        return opened.convert("RGB")


@pytest.mark.parametrize("exhibit", gallery.EXHIBITS, ids=lambda exhibit: exhibit.name)
def test_its_lines_draw_it(exhibit, tmp_path: Path):
    result = gallery.draw(exhibit, tmp_path)
    assert type(result).__name__ == exhibit.kind
    files = gallery.files_of(exhibit, tmp_path)
    light, *dark = [picture(file) for file in files]
    assert sum(light.getpixel((1, 1))) > 700
    for image in dark:
        assert image.size == light.size
        assert sum(image.getpixel((1, 1))) < 100


def test_the_page_shows_all_of_it(tmp_path: Path):
    page = gallery.page()
    shown = set(re.findall(rf"{gallery.FOLDER}/([\w.-]+)", page))
    assert shown == {file.name for exhibit in gallery.EXHIBITS for file in gallery.files_of(exhibit, tmp_path)}
    assert "FILE" not in page


def test_what_is_newer_than_the_code_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(gallery, "EXHIBITS", [e for e in gallery.EXHIBITS if e.name == "run"])
    gallery.write_pictures(tmp_path)
    files = sorted((tmp_path / gallery.FOLDER).iterdir())
    before = [file.stat().st_mtime_ns for file in files]
    gallery.write_pictures(tmp_path)
    assert [file.stat().st_mtime_ns for file in files] == before
    assert [file.name for file in files] == ["run-dark.png", "run.png"]
