"""The picture of an atlas shows its curves and points: its artists carry them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flexopt

pytestmark = pytest.mark.filterwarnings("ignore::flexopt.errors.CompilerNotFound")


@pytest.fixture(scope="module")
def atlas() -> flexopt.Atlas:
    return flexopt.atlas(flexopt.load("excavator"), cells=(48, 48))


def lines(axes: Any) -> list[Any]:
    return [np.array(line.get_data(), dtype=float) for line in axes.lines]


@pytest.mark.long
def test_curves_and_points(atlas: flexopt.Atlas, tmp_path: Path) -> None:
    figure = atlas.plot(tmp_path / "atlas.png")
    joints, task = figure.axes
    assert (joints.get_xlabel(), joints.get_ylabel()) == ("boom, rad", "stick, rad")
    assert task.get_xlabel() == "x, m (inertial frame)"
    drawn = lines(joints)
    for curve in atlas.curves:
        # Broken where it crosses the end of a turn, and whole.
        shown = [line for line in drawn if line.shape[1] >= curve.size]
        assert any({*map(tuple, curve.points.T)} <= {*map(tuple, line.T)} for line in shown)
        assert any(np.array_equal(line, curve.end_point) for line in lines(task))
    for pair in ((1, 2), (2, 3)):
        points = np.array([point.posture for point in atlas.doubly_robust if point.modes == pair]).T
        assert any(np.array_equal(line, points) for line in drawn)
    # No line runs back across the plane where a curve goes on at the other end of a turn.
    assert max(np.nanmax(np.abs(np.diff(line, axis=1))) for line in drawn if line.shape[1] > 20) < 1.0
    assert any(np.isnan(line).any() for line in drawn)


def test_joints_that_are_held_have_their_unit() -> None:
    atlas = flexopt.atlas(flexopt.load("boom-stick-bucket"), posture=[-0.5], cells=(8, 8))
    assert atlas.plot().axes[0].get_title().replace("\N{NO-BREAK SPACE}", " ") == "robust postures, bucket = -0.5 rad"
    assert "bucket -0.5 rad held" in repr(atlas)


@pytest.mark.long
def test_names_of_all_that_is_drawn(atlas: flexopt.Atlas) -> None:
    (legend,) = atlas.plot().legends
    texts = [text.get_text() for text in legend.get_texts()]
    assert texts[:1] == ["singular postures: edge of the workspace"]
    assert {"$w_{1} = 0$", "$w_{2} = 0$", "$w_{3} = 0$", "$w_{1} = w_{2} = 0$", "$w_{2} = w_{3} = 0$"} <= set(texts)
    assert len(texts) == len(set(texts))
    colours = [line.get_color() for line in legend.get_lines()]
    styles = [line.get_linestyle() for line in legend.get_lines()]
    assert len(set(zip(colours, map(str, styles), strict=True))) >= 4


@pytest.mark.long
@pytest.mark.parametrize("width", [4.0, 16.0])
def test_narrow_and_wide(width: float, tmp_path: Path) -> None:
    atlas = flexopt.atlas(flexopt.load("boom-stick-bucket"), posture=[-0.5], cells=(32, 32))
    figure = atlas.plot(tmp_path / "atlas.png", size=(width, 9.0))
    first, second = (axes.get_position() for axes in figure.axes)
    assert (first.x1 <= second.x0) == (width == 16.0)
    assert (first.y0 >= second.y1) == (width == 4.0)
    assert figure.get_figwidth() == width
    (legend,) = figure.legends
    shown = legend.get_window_extent()
    assert shown.x0 >= 0
    assert shown.x1 <= figure.bbox.x1
    assert "beyond the joints' limits" in [text.get_text() for text in legend.get_texts()]
