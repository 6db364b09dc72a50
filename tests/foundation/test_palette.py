"""Colours that mean different things look different, to colour-blind eyes, too, and stand out from their ground."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from colorspacious import cspace_convert

from flexopt.foundation.palette import PALETTES, THEMES, Palette

# Colours that stand side by side in one picture, and must be told apart by colour alone.
TOGETHER = (
    ("present", "chosen", "other"),
    ("grows", "settles", "undecided"),
    ("chosen", "grows"),
    ("allowed", "forbidden"),
    ("in_phase", "out_of_phase"),
    ("measured", "fitted"),
    ("present", "chosen", "base", "ground"),
)
# How eyes see: all cones, or one of three kinds missing (Machado et al. 2009), at full severity.
EYES = {"all": None, "no red": "protanomaly", "no green": "deuteranomaly", "no blue": "tritanomaly"}
# Least distance in CAM02-UCS: 10 is easy to see side by side.
TOLD_APART = 15.0
ON_PAGE = (
    "text",
    "muted",
    "present",
    "chosen",
    "grows",
    "settles",
    "undecided",
    "target",
    "focus",
    "allowed",
    "forbidden",
)


def rgb(color: str) -> np.ndarray:
    return np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)]) / 255


def distance(one: str, other: str, eye: str | None) -> float:
    space = "sRGB1" if eye is None else {"name": "sRGB1+CVD", "cvd_type": eye, "severity": 100}
    points = [
        np.array(cspace_convert(np.clip(cspace_convert(rgb(x), space, "sRGB1"), 0, 1), "sRGB1", "CAM02-UCS"))
        for x in (one, other)
    ]
    return float(np.linalg.norm(points[0] - points[1]))


def contrast(one: str, other: str) -> float:
    """As WCAG 2 defines it."""
    light = []
    for color in (one, other):
        linear = np.where(rgb(color) <= 0.04045, rgb(color) / 12.92, ((rgb(color) + 0.055) / 1.055) ** 2.4)
        light.append(float(linear @ [0.2126, 0.7152, 0.0722]))
    return (max(light) + 0.05) / (min(light) + 0.05)


@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize("eye", ["all", "no red", "no green"])
def test_meanings_are_told_apart(theme, eye):
    inks = PALETTES[theme].named()
    for group in TOGETHER:
        for one, other in combinations(group, 2):
            assert distance(inks[one], inks[other], EYES[eye]) >= TOLD_APART, (one, other)


@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize("eye", ["all", "no red", "no green"])
def test_lines_of_a_series_are_told_apart(theme, eye):
    for one, other in combinations(PALETTES[theme].series, 2):
        assert distance(one, other, EYES[eye]) >= TOLD_APART, (one, other)


@pytest.mark.parametrize("theme", THEMES)
def test_a_series_means_nothing_else(theme):
    palette = PALETTES[theme]
    for color in palette.series:
        for meaning in ("present", "chosen", "grows", "settles"):
            assert distance(color, getattr(palette, meaning), None) >= TOLD_APART, (color, meaning)


@pytest.mark.parametrize("theme", THEMES)
def test_colours_stand_out_from_their_ground(theme):
    palette: Palette = PALETTES[theme]
    for name in ON_PAGE:
        assert contrast(getattr(palette, name), palette.page) >= (4.5 if name in ("text", "muted") else 3.0), name


def test_css_names_every_colour():
    for theme in THEMES:
        variables = PALETTES[theme].css()
        assert set(PALETTES[theme].named().values()) <= set(variables.values())
        assert [variables[f"series-{k + 1}"] for k in range(6)] == list(PALETTES[theme].series)
        assert not any("_" in name for name in variables)
