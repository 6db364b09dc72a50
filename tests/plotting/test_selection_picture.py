"""The picture shows the numbers of the result: its artists carry them."""

import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

import flexopt
from flexopt.plotting.scene import Actor, draw_scene
from flexopt.plotting.selection import _shares, draw_candidates
from flexopt.plotting.shape import chain, views
from tests.plotting.looking import drawn


@pytest.fixture(scope="module")
def selection():
    return flexopt.solve_problem(flexopt.load_problem("article"))


def test_artists_carry_the_result(selection):
    figure = selection.plot()
    machines, *panels = figure.axes
    best, initial = selection.best.evaluation, selection.initial
    assert len(panels) == best.w.size
    outlines = [patch.get_path().vertices for patch in machines.patches]
    tip = best.skeleton[:, -1]
    assert min(np.abs(outline - tip).sum(axis=1).min() for outline in outlines) < 0.2
    np.testing.assert_allclose(tip, selection.problem.target, atol=1e-8)
    for mode, panel in enumerate(panels):
        drawn = {line.get_label(): line.get_xydata() for line in panel.lines}
        np.testing.assert_allclose(drawn["chosen"], [[best.base[0], best.w[mode]]])
        np.testing.assert_allclose(drawn["present"], [[initial.base[0], initial.w[mode]]])
        scan = selection.problem.scan
        up = scan.elbow < 0
        np.testing.assert_allclose(drawn["elbow up"], np.column_stack([scan.base[0, up], scan.w[mode, up]]))
        low, high = panel.get_ylim()
        assert low < min(best.w[mode], initial.w[mode]) <= high


def test_what_breaks_a_constraint_is_dotted(selection):
    """By the tool's angle, which hinges on a level base turn by the sum of theirs; without constraints nothing is."""
    low, high = -0.5, 0.5
    angled = flexopt.select(flexopt.load("excavator"), (0.0, 1.6), constraints={"tool_angle": (low, high)})
    figure, scan = angled.plot(), angled.problem.scan
    assert [text.get_text() for text in figure.legends[0].get_texts()].count("breaks a constraint") == 1
    assert "breaks a constraint" not in [text.get_text() for text in selection.plot().legends[0].get_texts()]
    # Of the last link of one drawn skeleton, and from there.
    first = flexopt.evaluate(flexopt.load("excavator"), scan.posture[:, 0], base=scan.base[:, 0]).skeleton
    angles = np.arctan2(*(first[:, -1] - first[:, -2])[::-1]) + np.sum(scan.posture - scan.posture[:, :1], axis=0)
    keeps = (angles >= low) & (angles <= high)
    assert 0.1 < keeps.mean() < 0.9
    for mode, panel in enumerate(figure.axes[1:]):
        shown = dict[str, np.ndarray]()
        for style in ("-", ":"):
            at = [
                line.get_xydata()
                for line in panel.lines
                if line.get_linestyle() == style and line.get_marker() == "None"
            ]
            shown[style] = np.vstack([points[np.isfinite(points).all(axis=1)] for points in at])
        for k in range(0, scan.size, 7):
            point = np.array([scan.base[0, k], scan.w[mode, k]])
            solid, dotted = (np.any(np.all(points == point, axis=1)) for points in (shown["-"], shown[":"]))
            assert solid == keeps[k]
            # Next to an end of it a dotted curve begins where the other ends.
            assert dotted == (not keeps[k]) or not keeps[max(k - 1, 0) : k + 2].all()


@pytest.mark.long
def test_a_loop_that_does_less_than_it_must_is_dotted_too():
    """By the outcome at single points."""
    machine, least = flexopt.load("excavator"), {"outcome": {"decay": 0.01}}
    loop = {"kp": 1e4, "kv": 1e3}
    chosen = flexopt.select(machine, (0.0, 1.6), base=0.0, objective="settling", loop=loop, constraints=least, starts=2)
    scan, broken, own = chosen.problem.scan, chosen.broken_along_redundancy(), chosen.settings[0].fixed
    looked = range(0, scan.size, 97)
    decays = [flexopt.outcome(machine, scan.posture[:, k], base=scan.base[:, k], loop=own).decay for k in looked]
    assert [decay < 0.01 for decay in decays] == broken[list(looked)].tolist()
    assert 0 < np.mean(broken) < 1


GIVEN = {"kp": 1e4, "kv": (500.0, 2000.0), "dead_time": 0.01, "rate": 200.0}


@pytest.mark.long("allowed_gain-loop2", "decay-loop0")
@pytest.mark.parametrize(("objective", "loop"), [("decay", GIVEN), ("decay", {"rate": 200.0}), ("allowed_gain", GIVEN)])
def test_what_the_loop_does_has_its_panel(objective, loop):
    """By the outcome at single points; of an allowed gain, which stacks of loops do not tell, the candidates alone."""
    machine = flexopt.load("excavator")
    chosen = flexopt.select(machine, (0.0, 1.6), base=0.4, objective=objective, loop=loop, starts=4)
    _, *panels = chosen.plot().axes
    assert len(panels) == chosen.best.evaluation.w.size + 1
    drawn = {line.get_label(): line.get_xydata() for line in panels[-1].lines}
    best, initial, scan = chosen.best, chosen.initial, chosen.problem.scan
    np.testing.assert_allclose(drawn["chosen"], [[best.evaluation.base[0], best.objective]])
    np.testing.assert_allclose(drawn["present"], [[initial.base[0], chosen.present]])
    assert panels[-1].get_ylabel() == f"objective {objective}, {chosen.objective_unit}"
    assert ("elbow up" in drawn) == (objective == "decay")
    if objective == "decay":
        up, own = np.flatnonzero(scan.elbow < 0), chosen.settings[0].fixed
        for k in (0, up.size // 3, up.size - 1):
            at = scan.posture[:, up[k]], scan.base[:, up[k]]
            expected = flexopt.outcome(machine, at[0], base=at[1], loop=own).decay
            assert drawn["elbow up"][k] == pytest.approx([at[1][0], expected], rel=1e-9)


def test_a_mode_that_is_not_reached_has_no_share():
    """The table tells none; a bar of its rounding would look like a number."""
    stand = flexopt.evaluate(flexopt.load("mobile-manipulator"), [0.0, -1.0, 1.5, -0.5, -1.57, 0.0])
    assert np.isfinite(_shares(stand)).all()
    hidden = replace(stand, scale=stand.scale * [1.0, 1e-13, 1.0], w=stand.w * [1.0, 1e-13, 1.0])
    assert repr(hidden).count("–   –") == 1
    assert np.isnan(_shares(hidden)).tolist() == [False, True, False]


@pytest.mark.parametrize("turn", [*range(0, 360, 30), None])
def test_the_name_of_the_target_lies_on_no_link(turn):
    """Two machines that come to it from directions at a right angle to each other; by Matplotlib's own boxes.

    None: they come from all four sides but one.
    """
    figure = Figure(figsize=(5.0, 5.0))
    axes = figure.add_subplot()
    target = np.array([0.3, 1.5])
    actors = []
    for angle in np.deg2rad([turn, turn + 90] if turn is not None else [45, 135, 225]):
        away = np.array([np.cos(angle), np.sin(angle)])
        skeleton = target[:, None] + np.outer(away, [2.4, 2.0, 1.2, 0.0])
        actors.append(Actor(chain(skeleton), "C0"))
    draw_scene(axes, views(actors[0].shape)[0], actors, target, name="target")
    (name,) = [text for text in axes.texts if text.get_text() == "target"]
    box = name.get_window_extent(drawn(figure))
    assert axes.get_window_extent().contains(box.x0, box.y0)
    assert axes.get_window_extent().contains(box.x1, box.y1)
    links = [patch for patch in axes.patches if type(patch) is Polygon]
    assert len(links) == 3 * len(actors)
    seen = [link.get_transform().transform_path(link.get_path()) for link in links]
    assert not [k for k, outline in enumerate(seen) if outline.intersects_bbox(box)]


@pytest.mark.long
def test_files(selection, tmp_path):
    selection.plot(tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    selection.plot(tmp_path / "a.svg")
    assert ET.parse(tmp_path / "a.svg").getroot().tag.endswith("svg")


@pytest.mark.long
def test_plotting_needs_no_display_and_changes_no_settings():
    """In a fresh process, since the other tests may have loaded a backend."""
    code = (
        "import sys, flexopt, matplotlib as mpl; before = dict(mpl.rcParams.copy()); "
        "flexopt.solve_problem(flexopt.load_problem('article')).plot(); "
        "assert 'matplotlib.pyplot' not in sys.modules; after = dict(mpl.rcParams.copy()); "
        "assert all(after[k] == before[k] for k in before if k != 'backend')"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.long
def test_redundant_arm_and_two_intervals_are_drawn():
    machine = flexopt.load("excavator")
    data = machine.to_dict()
    bucket = {"name": "bucket", "length": 0.6, "com": 0.3, "mass": 150.0, "inertia": 12.0}
    redundant = flexopt.machine_from_dict(data | {"links": [*data["links"], bucket]})
    figure = flexopt.select(redundant, (0.0, 1.6), starts=4).plot()
    assert len(figure.axes) == 4
    # At the shoulder's height the placements fall into two intervals: four curves, none across the hole.
    low = flexopt.select(machine, (0.0, 0.6))
    lines = [line.get_xdata() for line in low.plot().axes[1].lines if np.size(line.get_xdata()) > 20]
    assert len(lines) == 4
    assert all(np.abs(np.diff(x)).max() < 0.1 for x in lines)


def test_bars_of_a_mode_stand_over_its_label():
    """Of both panels, also where a mode has no share and so no bar in one of them."""
    found = flexopt.select(flexopt.load("excavator"), (0.0, 1.6), starts=2)
    stand = found.best.evaluation
    hidden = replace(stand, scale=stand.scale * [1e-13, 1.0, 1.0], w=stand.w * [1e-13, 1.0, 1.0])
    figure = Figure()
    panels = figure.subplots(3)
    best = replace(found.best, evaluate=lambda: hidden)
    draw_candidates(panels, replace(found, best=best, candidates=(best,), initial=None))
    assert panels[0].get_xlim() == panels[1].get_xlim()
    assert panels[0].get_xlim()[0] < 0 < 2 < panels[0].get_xlim()[1]
