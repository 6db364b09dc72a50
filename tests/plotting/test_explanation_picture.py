"""The picture of an explanation: its arrows and bars are the explanation's own numbers."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.text import Annotation

import flexopt
from flexopt.foundation.palette import LIGHT
from flexopt.study.explanation import WHY
from tests.plotting.looking import faults
from tests.plotting.specimens import OF, explanation
from tests.study.machines import gantry


def arrows(axes):
    """Where each arrow begins and points to, of length 1."""
    drawn = [text for text in axes.texts if isinstance(text, Annotation) and text.arrow_patch is not None]
    return [(np.array(text.xyann), np.subtract(text.xy, text.xyann)) for text in drawn]


def rows_of(figure, modes):
    """The axes of each mode, the bars last."""
    return np.reshape(figure.axes, (modes, -1))


def test_arrows_are_a_and_b_at_the_end_point():
    found = flexopt.explain(flexopt.load("excavator"), (0.9929, -2.6306))
    for i, (scene, _) in enumerate(rows_of(found.plot(), 3)):
        for (begin, along), vector in zip(arrows(scene), (found.a[:, i], found.b[:, i]), strict=True):
            np.testing.assert_allclose(begin, found.evaluation.end_point, atol=1e-9)
            np.testing.assert_allclose(along / np.linalg.norm(along), vector / np.linalg.norm(vector), atol=1e-9)
        angle = np.degrees(found.angle[i])
        assert f"{angle:.3g}°" in scene.get_title(loc="left")


def test_numbers_have_a_minus_sign():
    """Here w_3 rises by less than 1e-4 per rad."""
    found = flexopt.explain(flexopt.load("excavator"), (0.9929, -2.6306))
    titles = " ".join(bars.get_title(loc="left") for _, bars in rows_of(found.plot(), 3))
    assert "e−0" in titles
    assert "-" not in titles


@pytest.mark.long
def test_in_space_both_views_show_their_parts():
    """What one view cannot see the other does: squares of the parts seen add up."""
    found = explanation("truck-crane")
    size = None
    for i, (side, above, _) in enumerate(rows_of(found.plot(), len(found.moves))):
        for seen, over, vector in zip(arrows(side), arrows(above), (found.a[:, i], found.b[:, i]), strict=True):
            unit = vector / np.linalg.norm(vector)
            size = size or np.linalg.norm(over[1]) / np.linalg.norm(unit[:2])
            np.testing.assert_allclose(over[1], size * unit[:2], atol=1e-9)
            assert seen[1][1] == pytest.approx(size * unit[2], abs=1e-9)


def test_bars_are_the_direction():
    found = flexopt.explain(flexopt.load("excavator"), (0.9929, -2.6306))
    for i, (_, bars) in enumerate(rows_of(found.plot(), 3)):
        np.testing.assert_allclose([patch.get_width() for patch in bars.patches], found.moves[i].direction)
        assert [label.get_text() for label in bars.get_yticklabels()] == list(found.variables)


def test_where_there_is_nothing_to_move_it_says_why():
    machine = flexopt.load("excavator")
    best = flexopt.select(machine, (0.0, 1.6), base=0.0, starts=4).best.evaluation
    found = flexopt.explain(machine, best.posture, base=best.base)
    stays = [i for i, move in enumerate(found.moves) if move.variable is None]
    assert stays
    figure = found.plot()
    for i in stays:
        told = " ".join(rows_of(figure, 3)[i, -1].texts[0].get_text().split())
        assert told == f"nothing to move: {WHY[found.moves[i].status]}"
    assert not faults(figure)


@pytest.mark.long("slewing-excavator")
@pytest.mark.parametrize("name", OF["explanation"])
def test_every_arrow_is_inside_its_axes(name):
    figure = explanation(name).plot()
    for axes in figure.axes:
        (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
        for begin, along in arrows(axes):
            x, y = begin + along
            assert left <= x <= right
            assert low <= y <= high


@pytest.mark.long("slewing-excavator")
@pytest.mark.parametrize("name", OF["explanation"])
def test_scenes_below_each_other_have_the_same_limits(name):
    """Only the lowest one's numbers are shown."""
    found = explanation(name)
    figure = found.plot()
    figure.draw_without_rendering()
    scenes = rows_of(figure, len(found.moves))[:, :-1]
    for column in scenes.T:
        np.testing.assert_allclose([axes.get_xlim() for axes in column], [column[-1].get_xlim()] * len(column))
        np.testing.assert_allclose([axes.get_ylim() for axes in column], [column[-1].get_ylim()] * len(column))


def test_colours_have_their_meanings():
    found = flexopt.explain(flexopt.load("excavator"), (0.9929, -2.6306))
    figure = found.plot()
    told = {
        text.get_text(): line
        for text, line in zip(figure.legends[0].get_texts(), figure.legends[0].get_lines(), strict=True)
    }
    assert told["b: feedback pushes it so"].get_color() in LIGHT.series


def test_that_arrows_show_no_angles_is_said() -> None:
    """The angle between a and b counts all task rows."""
    plain = gantry()
    turned = plain | {"end_point": plain["end_point"] | {"rows": ["x", "z", "yaw"], "length": 1.0}}
    titles = [
        flexopt.explain(flexopt.tree_from_dict(data), (1.0, 0.8, 0.4)).plot().get_suptitle() for data in (turned, plain)
    ]
    assert ["angles count yaw, too, of which arrows show nothing" in " ".join(each.split()) for each in titles] == [
        True, False,
    ]  # fmt: skip
