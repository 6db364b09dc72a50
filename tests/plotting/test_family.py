"""All pictures are of one family: no text on another, a unit on every axis, one signature, one table of colours."""

from __future__ import annotations

import subprocess
import sys
import warnings
from functools import cache
from io import BytesIO
from typing import Any

import matplotlib
import numpy as np
import pytest
from IPython.core.formatters import DisplayFormatter
from matplotlib.colors import to_hex, to_rgb
from matplotlib.container import BarContainer
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.transforms import Bbox
from PIL import Image

import flexopt
from flexopt.foundation.palette import DARK, LIGHT, PALETTES
from flexopt.foundation.pictures import Pictured, drawers
from flexopt.plotting import several
from flexopt.plotting.ensemble import ABOVE
from flexopt.plotting.machine import draw_target
from flexopt.plotting.sheet import DOTS_OTHERWISE, PAGE, SLIDE, styled
from flexopt.study import page
from flexopt.study.maps.workspace_map import WorkspaceMap
from tests.plotting.looking import drawn, faults, without_units
from tests.plotting.specimens import SPECIMENS

pytestmark = pytest.mark.filterwarnings("ignore::flexopt.errors.CompilerNotFound")
# One of each kind, and those with most on them.
DENSE = (
    "problem article", "problem pipe-laying", "problem stations", "problem trench", "way truck-crane", "run slewing-excavator",
    "ensemble excavator", "atlas truck-crane", "loop excavator", "identification excavator",
)  # fmt: skip


@cache
def made(name: str) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", flexopt.FlexoptWarning)
        return SPECIMENS[name]()


@cache
def two_members() -> flexopt.Ensemble:
    return flexopt.simulate_ensemble(
        flexopt.load("excavator"), (0.0448, -2.0499), vary={"kp": [1e4, 1e5]}, kv=2e3, duration=0.5
    )


@pytest.mark.long(
    "problem pipe-laying",
    "problem stations",
    "problem trench",
    "identification excavator",
    "identification mobile-manipulator",
    "atlas excavator",
    "atlas truck-crane",
    "map posture truck-crane",
    "map base slewing-excavator",
    "map base truck-crane",
    "verdict pipe-laying",
    "explanation slewing-excavator",
    "problem article-transpose",
    "experiment article-move",
    "run slewing-excavator",
    "ensemble excavator",
    "way truck-crane",
    "map end_point mobile-manipulator",
    "map base mobile-manipulator",
    "ensemble mobile-manipulator",
    "map end_point excavator",
    "map posture boom-stick-bucket",
    "verdict article",
    "sensitivity truck-crane",
)
@pytest.mark.parametrize("name", SPECIMENS)
def test_no_text_lies_on_another_and_every_axis_has_a_unit(name):
    figure = made(name).plot()
    assert not faults(figure)
    assert not without_units(figure)


@pytest.mark.long(
    "problem pipe-laying-paper",
    "problem stations-paper",
    "problem trench-paper",
    "atlas truck-crane-paper",
    "identification excavator-paper",
    "problem pipe-laying-slide",
    "problem stations-slide",
    "problem trench-slide",
    "way truck-crane-slide",
    "atlas truck-crane-slide",
    "identification excavator-slide",
    "problem article-slide",
)
@pytest.mark.parametrize("size", ["paper", "slide"])
@pytest.mark.parametrize("name", DENSE)
def test_other_sizes_have_room_too(name, size):
    assert not faults(made(name).plot(size=size, theme="dark"))


def test_faults_are_found():
    figure = Figure()
    axes = figure.add_subplot(xlabel="x, m", ylabel="height")
    axes.plot([0, 1], [0, 1])
    axes.text(0.5, 0.5, "one")
    axes.text(0.5, 0.5, "another")
    axes.text(2.0, 0.5, "far away")
    assert faults(figure) == ["'one' on 'another'", "'far away' cut off"]
    assert without_units(figure) == ["y axis 'height' of ''"]


@pytest.mark.long
def test_every_kind_of_picture_is_looked_at():
    kinds = {kind for kind, form in drawers() if form == "picture"}
    # One of each group; problems have answers of several kinds.
    groups = {name if name.startswith("problem") else name.split()[0]: name for name in SPECIMENS}
    assert {type(made(name)).__name__ for name in groups.values()} == kinds


def test_one_signature():
    import inspect  # noqa: PLC0415

    plots = [inspect.signature(getattr(flexopt, kind).plot) for kind, form in drawers() if form == "picture"]
    for signature in plots:
        assert {"path", "ax", "size", "theme"} <= set(signature.parameters)
        assert signature.parameters["size"].default == "screen"
        assert signature.parameters["theme"].default == "light"
    assert sum("plot" in vars(getattr(flexopt, kind)) for kind, _ in drawers()) == 1  # the map's, which takes marks
    assert "plot" in vars(Pictured)
    assert issubclass(flexopt.WorkspaceMap, WorkspaceMap)


@pytest.mark.parametrize(
    ("size", "inches", "dots"), [("slide", SLIDE, (1920, 1080)), ((5.0, 4.0), (5.0, 4.0), (750, 600))]
)
def test_sizes(size, inches, dots, tmp_path):
    figure = made("run excavator").plot(tmp_path / "a.png", size=size)
    np.testing.assert_allclose(figure.get_size_inches(), inches)
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.size == dots


@pytest.mark.long
@pytest.mark.parametrize("name", ["explanation excavator", "loop excavator"])
def test_places_found_once_are_those_found_again(name, tmp_path):
    """A page's dark picture takes them from the light one; a file is not drawn a first time for them."""
    result = made(name)
    embedded = page.picture(lambda theme: result.plot(theme=theme), "")
    assert embedded.dark == page.picture(lambda _: result.plot(theme="dark"), "").light
    figure = result.plot(tmp_path / "a.png")
    assert isinstance(figure.get_layout_engine(), ConstrainedLayoutEngine)
    with styled():
        result.plot().savefig(tmp_path / "b.png", dpi=DOTS_OTHERWISE)
    with Image.open(tmp_path / "a.png") as one, Image.open(tmp_path / "b.png") as two:
        assert one.tobytes() == two.tobytes()


@pytest.mark.long
def test_a_page_is_as_wide_as_a_page():
    for name in DENSE:
        width, height = made(name).plot(size="paper").get_size_inches()
        assert width == PAGE[0]
        assert height <= PAGE[1]


@pytest.mark.long("dark")
@pytest.mark.parametrize("theme", PALETTES)
def test_ground_letters_and_meanings_are_the_theme_s(theme, tmp_path):
    inks = PALETTES[theme]
    figure = made("problem article").plot(tmp_path / "a.png", theme=theme)
    assert to_hex(figure.get_facecolor()) == inks.page
    scene, panel = figure.axes[:2]
    assert to_hex(scene.get_facecolor()) == inks.page
    assert to_hex(scene.xaxis.label.get_color()) == inks.text
    assert {to_hex(label.get_color()) for label in scene.get_xticklabels()} == {inks.text}
    drawn = {line.get_label(): to_hex(line.get_color()) for line in panel.lines}
    assert drawn["chosen"] == inks.chosen
    assert drawn["present"] == inks.present
    faces = {to_hex(patch.get_facecolor()) for patch in scene.patches}
    assert {inks.chosen, inks.present, inks.ground, inks.base} <= faces
    with Image.open(tmp_path / "a.png") as picture:
        red, green, blue = picture.convert("RGB").getpixel((2, 2))
    assert f"#{red:02x}{green:02x}{blue:02x}" == inks.page


def test_verdicts_have_their_colours():
    ensemble = made("ensemble excavator")
    figure = ensemble.plot()
    names = {"converges": LIGHT.settles, "grows": LIGHT.grows, "undecided": LIGHT.undecided}
    shown = {
        to_hex(line.get_color()): line.get_xydata() for line in figure.axes[0].lines if line.get_marker() != "None"
    }
    assert set(shown) == {names[word] for word in set(ensemble.verdict)}
    kp = np.asarray(ensemble.dataset["kp"])
    for word, color in names.items():
        if color in shown:
            expected = np.column_stack([kp, -ensemble.linear_growth_rate])[ensemble.verdict == word]
            np.testing.assert_array_equal(shown[color], expected)


def test_members_that_differ_in_much_stand_side_by_side():
    """Over their number, which is no quantity: evenly, at whole numbers."""
    gains = np.geomspace(5e2, 2e3, 30)
    ensemble = flexopt.simulate_ensemble(
        flexopt.load("excavator"), (0.992, -1.4056), vary={"kp": 10 * gains, "kv": gains}, duration=0.1
    )
    (panel,) = ensemble.plot().axes
    assert panel.get_xscale() == "linear"
    ticks = panel.get_xticks()
    np.testing.assert_array_equal(ticks, np.round(ticks))


def test_a_damping_that_varies_is_shown_as_it_was_asked_for():
    """Drives that serve rates brake their joints beside it."""
    dampings, loop = [0.0, 200.0, 400.0], {"drive": "velocity", "servo_gain": 1e5, "kp": 1.0, "kv": 0.0}
    ensemble = flexopt.simulate_ensemble(
        flexopt.load("excavator"), (0.0448, -2.0499), vary={"boom.joint_damping": dampings}, loop=loop, duration=0.2
    )
    (panel,) = ensemble.plot().axes
    shown = np.concatenate([line.get_xdata() for line in panel.get_lines()[:-1]])
    assert sorted(shown.tolist()) == dampings


def test_gains_that_vary_have_the_unit_that_the_loop_gives_them():
    loop = {"drive": "velocity", "servo_gain": 1e5, "kp": 1.0, "kv": 0.0}
    machine, posture = flexopt.load("excavator"), (0.0448, -2.0499)
    of_rates = flexopt.simulate_ensemble(machine, posture, vary={"kp": [0.5, 1.0]}, loop=loop, duration=0.2)
    assert of_rates.plot().axes[0].get_xlabel() == "kp, 1/s"
    assert two_members().plot().axes[0].get_xlabel() == "kp, N m"


def test_bands_hold_the_quantiles():
    ensemble = made("ensemble excavator")
    error = ensemble.plot().axes[1]
    norm = 1e3 * np.linalg.norm(np.asarray(ensemble.dataset["error"]), axis=-1)
    norm = np.where(norm < ABOVE, norm, ABOVE)
    words = [word for word in ("converges", "grows", "undecided") if (ensemble.verdict == word).any()]
    assert len(error.lines) == len(words)
    assert len(error.collections) == 2 * len(words)
    for k, word in enumerate(words):
        members = norm[ensemble.verdict == word]
        np.testing.assert_allclose(error.lines[k].get_ydata(), np.median(members, axis=0))
        for band, share in zip(error.collections[2 * k : 2 * k + 2], (0.05, 0.25), strict=True):
            corners = band.get_paths()[0].vertices
            low, high = np.quantile(members, [share, 1 - share], axis=0)
            assert corners[:, 1].min() == pytest.approx(low.min())
            assert corners[:, 1].max() == pytest.approx(high.max())


def test_the_best_place_is_where_the_measure_is_largest():
    chart = made("map base slewing-excavator")
    panels = {axes.get_title(): axes for axes in chart.plot().axes}
    rows, columns = chart.axes
    for mode, w in enumerate(chart.array("w")):
        (star,) = [line for line in panels[f"mode {mode + 1}: $w_{mode + 1}$"].lines if line.get_marker() == "*"]
        x, y = star.get_xydata()[0]
        at = chart.dataset["w"][mode].sel({columns: x, rows: y}, method="nearest")
        assert float(at) == np.nanmax(w)


@pytest.mark.parametrize("theme", PALETTES)
def test_numbers_of_targets_are_read_on_an_arm(theme):
    """Around each is the ground that letters lie on: on a surface of the arm's colour, pixels of it."""
    inks = PALETTES[theme]
    with styled(theme):
        figure = Figure(figsize=(2.0, 2.0))
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), facecolor=inks.chosen, xlim=(0, 1), ylim=(0, 1))
        several._number(axes, np.array([[0.2, 0.8], [0.2, 0.8]]))
        figure.savefig(picture := BytesIO(), format="png", facecolor=inks.chosen)
    halo = np.array(to_rgb(inks.halo)) * 255
    seen = np.asarray(Image.open(picture).convert("RGB"), dtype=float)
    assert (np.abs(seen - halo).max(axis=2) < 3).sum() > 40


@pytest.mark.parametrize("seed", range(12))
def test_numbers_of_targets_lie_on_no_cross_and_on_no_other_number(seed):
    """Wherever targets are, on top of each other, in a row or alone."""
    random = np.random.default_rng(seed)
    count, spread = int(random.integers(2, 13)), float(random.choice([0.02, 0.1, 0.4, 1.0]))
    marks = 0.5 + spread * (random.random((2, count)) - 0.5) * np.array([[1.0], [random.choice([0.0, 1.0])]])
    figure = Figure(figsize=(3.5, 3.0))
    axes = figure.add_subplot(xlim=(0, 1), ylim=(0, 1))
    draw_target(axes, marks)
    several._number(axes, marks)
    renderer = drawn(figure)
    point = figure.dpi / 72
    (crosses,) = [line for line in axes.lines if line.get_marker() == "+"]
    arm = crosses.get_markersize() / 2 * point
    at = axes.transData.transform(marks.T)
    boxes = {text.get_text(): text.get_window_extent(renderer) for text in axes.texts if text.get_text()}
    told = sorted(int(number) for text in boxes for number in text.split(", "))
    assert told == (list(range(1, count + 1)) if count <= several.GHOSTS else [1, count])
    for text, box in boxes.items():
        assert axes.bbox.contains(*box.min)
        assert axes.bbox.contains(*box.max)
        others = [other for name, other in boxes.items() if name != text]
        assert not any(box.overlaps(each) for each in [*others, *(Bbox([mark - arm, mark + arm]) for mark in at)])


def test_a_plan_is_a_film_strip():
    plan = made("problem trench")
    figure = plan.plot()
    shots = [axes for axes in figure.axes if axes.get_title(loc="left").startswith("target")]
    assert 3 <= len(shots) <= 6
    for axes in shots:
        number = int(axes.get_title(loc="left").split()[1])
        place = plan.places[number - 1].evaluation
        ends = [patch.get_path().vertices for patch in axes.patches if to_hex(patch.get_facecolor()) == LIGHT.chosen]
        tip = min(float(np.linalg.norm(outline - place.skeleton[:, -1], axis=1).min()) for outline in ends)
        assert tip < 0.05
    assert len({tuple(axes.get_xlim()) for axes in shots}) == 1


def test_intervals_are_seen_on_bars_as_dark_as_they_are():
    panel = made("sensitivity excavator").plot().axes[0]
    for bars in panel.containers:
        if isinstance(bars, BarContainer):
            _, caps, lines = bars.errorbar.lines
            assert all(part.get_path_effects() for part in (*caps, *lines))


def test_all_that_a_sensitivity_draws_has_a_name():
    (legend,) = made("sensitivity excavator").plot().legends
    names = [text.get_text() for text in legend.get_texts()]
    assert names == ["at most, by slopes", "alone", "in all", "95 % interval"]


@pytest.mark.long
def test_what_may_stand_where_is_said_and_marked():
    figure = made("problem pipe-laying").plot()  # holds = "point"
    above = figure.axes[1]
    said = above.get_legend_handles_labels()[1]
    assert "the anchor point (ring) may stand here" in said
    assert "the anchor point (ring) may not stand here" in said
    selection = made("problem pipe-laying")
    rings = [line.get_xydata()[0] for line in above.lines if line.get_markeredgecolor() == LIGHT.allowed]
    for e in (selection.initial, selection.best.evaluation):
        assert min(np.abs(ring - e.base[:2]).max() for ring in rings) < 0.05


def test_a_notebook_shows_a_picture_that_is_a_cells_value():
    """As IPython finds out what to show, without `%matplotlib inline`."""
    figure = made("run excavator").plot()
    shown, _ = DisplayFormatter().format(figure)
    with Image.open(BytesIO(shown["image/png"])) as image:
        assert image.size == tuple((figure.get_size_inches() * figure.dpi).astype(int))
        assert len(image.getcolors(1 << 20)) > 10


def test_own_axes():
    """A picture of one panel goes into anyone's axes, of several into a part of a figure, and nothing else changes."""
    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    left, right = figure.subfigures(1, 2)
    axes = left.add_subplot()
    assert two_members().plot(ax=axes) is figure
    assert axes.get_ylabel() == "decay, 1/s"
    assert made("run excavator").plot(ax=right, theme="dark") is figure
    assert len(right.axes) == 6
    assert len(left.axes) == 1
    assert to_hex(right.get_facecolor()) == DARK.page
    assert to_hex(figure.get_facecolor()) == "#ffffff"
    np.testing.assert_allclose(figure.get_size_inches(), (9.0, 4.0))
    whole = Figure(layout="constrained")
    assert made("problem article").plot(ax=whole) is whole
    assert not faults(whole)


@pytest.mark.parametrize("size", [8.0, 13.0])
def test_letters_and_grid_of_own_axes_go_together(size):
    """Title and legend are as large as what the axes have beside them already, and lie on nothing."""
    with matplotlib.rc_context({"font.size": size, "grid.color": "#ff0000", "grid.linewidth": 3.0}):
        figure = Figure(figsize=(6.0, 4.0), layout="constrained")
        axes = figure.add_subplot()
    two_members().plot(ax=axes)
    assert not faults(figure)
    beside = {axes.xaxis.label.get_fontsize(), *(text.get_fontsize() for text in axes.get_xticklabels())}
    above = [axes.title.get_fontsize(), *(text.get_fontsize() for text in axes.get_legend().get_texts())]
    assert beside == {size}
    assert all(0.8 * size < letters <= size for letters in above)
    grid = axes.get_xgridlines()[0]
    assert to_hex(grid.get_color()) == LIGHT.grid
    assert grid.get_linewidth() < 1.0


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"size": "poster"}, ("size", "paper", "slide", "screen", "'poster'", "60 in")),
        ({"size": (1.0, 4.0)}, ("size", "2 to 60 in")),
        ({"size": (3.0, float("nan"))}, ("size",)),
        ({"theme": "blue", "size": 3}, ("theme", "light or dark", "size")),
        ({"ax": 3}, ("ax", "Axes, Figure or SubFigure")),
        ({"ax": Figure().add_subplot()}, ("several panels", "empty Figure or SubFigure")),
        ({"ax": Figure().add_subplot().get_figure()}, ("empty", "axes")),
        ({"ax": Figure().add_subplot(projection="polar")}, ("projection",)),
        (
            {"ax": Figure().add_subplot(), "size": "paper", "theme": "x", "path": "a.bmp"},
            ("panels", "size", "theme", ".png"),
        ),
        ({"ax": Figure(), "size": "paper"}, ("size", "does not go with ax")),
    ],
)
def test_bad_arguments_are_one_clear_error(given, words):
    with pytest.raises(flexopt.InputError) as caught:
        made("run excavator").plot(**given)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.long
def test_settings_of_matplotlib_stay_the_user_s():
    code = (
        "import flexopt, matplotlib as mpl; mpl.rcParams['font.size'] = 17.0; before = dict(mpl.rcParams.copy()); "
        "flexopt.simulate(flexopt.load('excavator'), (0.9929, -2.6306), duration=0.5).plot(theme='dark'); "
        "after = dict(mpl.rcParams.copy()); assert all(after[k] == before[k] for k in before if k != 'backend')"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
