"""Pictures of maps and of the article show the numbers of the results: their artists carry them."""

from itertools import combinations

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

import flexopt
from flexopt.article import curve, sweep_gaps
from flexopt.article import pictures as article
from flexopt.foundation.palette import LIGHT
from flexopt.plotting.fields import FieldPlane, draw_field, draw_signed, label_plane
from flexopt.plotting.ticks import between_powers, digits_of, shown
from tests.plotting.looking import faults

pytestmark = pytest.mark.filterwarnings("ignore::flexopt.errors.CompilerNotFound")


@pytest.fixture(scope="module")
def excavator():
    return flexopt.load("excavator")


@pytest.fixture(scope="module")
def maps(excavator):
    return {c: flexopt.map_workspace(excavator, control=c, points=(31, 29)) for c in ("transpose", "inverse")}


def images(figure):
    """Title -> array of each panel with an image (colour bars have none)."""
    return {axes.get_title(): axes.images[0].get_array().filled(np.nan) for axes in figure.axes if axes.images}


@pytest.mark.long
def test_map(maps, tmp_path):
    result = maps["inverse"]
    figure = result.plot(tmp_path / "map.png")
    assert (tmp_path / "map.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    shown = images(figure)
    for mode in range(3):
        np.testing.assert_array_equal(shown[f"mode {mode + 1}: frequency"], result.array("frequency_hz")[mode])
        np.testing.assert_array_equal(shown[f"mode {mode + 1}: $w_{mode + 1}$"], result.array("w")[mode])
        np.testing.assert_array_equal(shown[f"mode {mode + 1}: in phase (yellow)"], result.array("in_phase")[mode])
    np.testing.assert_array_equal(shown["robust stability margin"], result.array("epsilon_max"))
    image = figure.axes[0].images[0]
    left, right, bottom, top = image.get_extent()
    step = 6.03 / 30
    np.testing.assert_allclose([left, right], [-3.015 - step / 2, 3.015 + step / 2])
    assert bottom == pytest.approx(-3.015 - 6.03 / 56)
    assert top == -bottom
    assert image.origin == "lower"
    assert figure.axes[0].get_xlabel() == ""
    assert any("workspace frame" in axes.get_xlabel() for axes in figure.axes)


@pytest.mark.parametrize("draw", [draw_field, draw_signed])
def test_what_is_nowhere_a_number_has_no_bar_of_colours(draw):
    """Matplotlib's own range of nothing is −0.1 to 0.1."""
    plane, values = FieldPlane(np.arange(4.0), np.arange(3.0), "x", "y"), np.full((3, 4), np.nan)
    empty, (one, other) = Figure().add_subplot(), Figure().subplots(1, 2)
    draw(empty, plane, values, label="w")
    assert not empty.child_axes
    assert len(empty.images) == 1
    values[1, 1] = 2.0
    draw(one, plane, values, label="w")
    assert len(one.child_axes) == 1
    assert not other.child_axes


@pytest.mark.long
def test_on_a_slide_rows_of_a_map_are_columns(maps):
    """Eleven panels in four rows were a fifteenth of its width each."""
    figure = maps["inverse"].plot(size="slide")
    assert list(images(figure))[:3] == ["mode 1: frequency", "mode 1: $w_1$", "mode 1: in phase (yellow)"]
    assert set(images(figure)) == set(images(maps["inverse"].plot()))
    assert figure.axes[0].get_window_extent().width > 0.08 * figure.bbox.width
    assert list(images(maps["inverse"].plot(size="paper")))[:2] == ["mode 1: frequency", "mode 2: frequency"]


def test_map_of_little(excavator):
    geometry = flexopt.map_workspace(excavator, points=(5, 4), measures=False, epsilon_max=False)
    assert list(images(geometry.plot())) == ["condition of the rigid-body Jacobian"]
    over = flexopt.map_workspace(excavator, points=(5, 4), over="posture", epsilon_max=False)
    assert any(axes.get_xlabel() == "angle of boom, rad" for axes in over.plot().axes)
    nothing = flexopt.map_workspace(excavator, points=(3, 3), x_range=(5, 6))
    nothing.plot()


def test_figure_5_draws_the_intersection_and_both_postures(maps):
    arms = {"A": np.array([[0.0, 1.0, 1.5], [0.0, 1.0, 0.5]]), "B": np.array([[0.0, -1.0, 0.5], [0.0, 1.0, 1.2]])}
    figure = article.plot_figure5(maps["inverse"].dataset, arms)
    regions = maps["inverse"].array("in_phase")
    shown = images(figure)
    assert list(shown) == ["(a) mode 1", "(b) mode 2", "(c) mode 3", "(d) modes 1 and 2 (intersection)"]
    for values, expected in zip(shown.values(), [*regions, regions[0] * regions[1]], strict=True):
        np.testing.assert_array_equal(values, expected)
    for axes in figure.axes:
        drawn = {line.get_label(): line for line in axes.lines}
        for name, arm in arms.items():
            line = drawn[f"posture {name}"]
            np.testing.assert_array_equal(line.get_xydata(), arm.T)
            assert line.get_color() == LIGHT.mark
        low, high = axes.images[0].get_clim()
        assert (low, high) == (0.0, 1.0)


@pytest.mark.long
def test_the_article_s_figures_fit_a_page_and_a_slide(maps):
    transpose, inverse = maps["transpose"].dataset, maps["inverse"].dataset
    own = article.plot_figure7(transpose, inverse)
    page = article.plot_figure7(transpose, inverse, size="paper")
    width, height = page.get_size_inches()
    assert width == pytest.approx(7.16)
    assert 1 <= height / width / (own.get_size_inches()[1] / own.get_size_inches()[0]) < 1.2
    assert tuple(article.plot_figure7(transpose, inverse, size="slide").get_size_inches()) == (10.0, 5.625)
    letters = [min(text.get_fontsize() for text in figure.findobj(Text)) for figure in (page, own)]
    assert letters[0] < letters[1]
    # Nothing is cut: with its own letters the titles of this page would run into each other.
    page.draw_without_rendering()
    titles = [axes.title.get_window_extent() for axes in page.axes if axes.get_title()]
    assert len(titles) == 6
    assert all(not one.overlaps(other) for one, other in combinations(titles, 2))


def test_figures_6_and_7_in_the_article_s_order(maps):
    transpose, inverse = maps["transpose"], maps["inverse"]
    shown = images(article.plot_figure6(transpose.dataset, inverse.dataset, {}))
    # kr of the transpose is a force's gain, of the inverse a torque's.
    assert [title.split(", kr = ")[0] for title in shown] == ["(a) Jacobian transpose", "(b) Jacobian inverse"]
    assert [title.split()[-1] for title in shown] == ["N/m", "m"]
    for values, result in zip(shown.values(), (transpose, inverse), strict=True):
        np.testing.assert_array_equal(values, result.array("epsilon_max"))
    shown = images(article.plot_figure7(transpose.dataset, inverse.dataset))
    expected = [*transpose.array("w"), *inverse.array("w")]
    assert [title[:3] for title in shown] == ["(a)", "(b)", "(c)", "(d)", "(e)", "(f)"]
    for (title, values), w in zip(shown.items(), expected, strict=True):
        np.testing.assert_array_equal(values, w)
        assert "Hz" in title


@pytest.mark.long
def test_figure_8(excavator):
    curves = [curve(excavator, 1.087, control=control, elbow="up") for control in ("transpose", "inverse")]
    figure = article.plot_figure8(*curves, {"A": -0.1733})
    left, right = figure.axes[:2], figure.axes[2:]
    panels = [figure.axes[0], figure.axes[2]], [figure.axes[1], figure.axes[3]]
    assert len(left) == len(right) == 2
    for epsilon_axes, w_axes, expected in zip(*panels, curves, strict=True):
        lines = {line.get_label(): line.get_xydata() for line in (*epsilon_axes.lines, *w_axes.lines)}
        np.testing.assert_array_equal(lines["$\\epsilon_{max}$"], np.column_stack([expected.x, expected.epsilon_max]))
        np.testing.assert_array_equal(lines["$w_1$"], np.column_stack([expected.x, expected.w[0]]))
        assert any(np.all(np.asarray(line.get_xdata()) == -0.1733) for line in epsilon_axes.lines)
        low, high = epsilon_axes.get_ylim()
        assert low < expected.epsilon_max[expected.regular].min() + 0.02
        assert high > 0.3827
    # The legend lay upon w_1 at -2.8 m.
    figure.draw_without_rendering()
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["$\\epsilon_{max}$", "$w_1$"]
    assert not any(
        axes.get_legend() or axes.get_tightbbox().overlaps(legend.get_window_extent()) for axes in figure.axes
    )


@pytest.mark.long
@pytest.mark.parametrize("size", ["screen", "paper"])
def test_names_in_figure_8_lie_on_no_line(excavator, size):
    marks = {"A": -0.1733, "B, printed point": 1.32687, "B, point of its measures": 1.5575}
    short = curve(excavator, 1.087, control="inverse", elbow="up")
    figure = article.plot_figure8(short, short, marks, size=size)
    figure.draw_without_rendering()
    names = [text for text in figure.axes[0].texts if text.get_text() in marks]
    assert len(names) == 3
    lines = [figure.axes[0].transData.transform((x, 0.0))[0] for x in marks.values()]
    for box in (name.get_window_extent() for name in names):
        assert not any(box.x0 < x < box.x1 for x in lines)


@pytest.mark.long
def test_curves_are_broken_where_the_arm_does_not_reach(excavator):
    low = curve(excavator, 0.3, control="inverse", elbow="up")
    figure = article.plot_figure8(low, low, {})
    data = figure.axes[0].lines[0].get_xydata()
    assert np.isnan(data).any()


def test_gap_picture(excavator):
    sweep = sweep_gaps(
        excavator, {"A": np.array([0.9929, -2.6306]), "optimum 1": np.array([1.8982, -1.465])}, factors=(1.0, 1e3)
    )
    figure = article.plot_gaps(sweep)
    for axes, values in zip(figure.axes, (sweep.nu_gap, sweep.epsilon_max), strict=True):
        for line, row in zip(axes.lines, values, strict=False):
            np.testing.assert_array_equal(line.get_xydata(), np.column_stack([sweep.factors, row]))


def test_rounding_is_drawn_in_one_colour():
    """The rigid part of a slewed crane does not depend on slew and lift but for rounding."""
    rounding = 3.5e-5 * (1 + 1e-15 * np.random.default_rng(1).normal(size=(6, 5)))
    plane = FieldPlane(np.arange(5.0), np.arange(6.0), "x", "y")
    fields = {"rounding": rounding, "negative": -rounding, "nothing": 0 * rounding, "field": rounding.cumsum(axis=0)}
    for clipped in (True, False):
        for name, values in fields.items():
            axes = Figure().add_subplot()
            draw_field(axes, plane, values, label="", clipped=clipped)
            image = axes.images[0]
            spread = np.ptp(image.norm(image.get_array()))
            assert spread == pytest.approx(1.0, abs=0.2) if name == "field" else spread < 1e-12


def test_the_bar_of_a_measure_ends_at_its_bound():
    """The best point of a grid is hardly ever 0 itself; what is far from 0 ends where it ends."""
    plane, shares = FieldPlane(np.arange(5.0), np.arange(6.0), "x", "y"), np.linspace(0.0, 1.0, 30).reshape(6, 5)
    for best, at_zero in ((-1e-8, True), (-1e-5, False)):
        axes = Figure().add_subplot()
        draw_field(axes, plane, best - 1e-4 * shares, label="w, 1/kg", clipped=True)
        (bar,) = axes.child_axes
        low, high = bar.get_ylim()
        assert (0.0 in [tick for tick in bar.get_yticks() if low <= tick <= high]) == at_zero


@pytest.mark.parametrize("turned", [False, True])
def test_the_border_of_stability_runs_between_the_cells_that_it_separates(turned):
    """Slow where it settles, quick to grow beyond 4.9, as where another motion becomes the slowest; a cell is unknown."""
    x, y = np.geomspace(1.0, 1e3, 10), np.arange(5.0)
    decay = np.tile(np.minimum(0.1, 30.0 * (np.log10(47.0) - np.log10(x))), (5, 1))
    decay[2, 5] = np.nan
    settles = [float(np.log10(x[x < 47.0].max())), float(np.log10(x[x > 47.0].min()))]
    plane = FieldPlane(x, y, "", "", (True, False))
    if turned:
        plane, decay = FieldPlane(y, x, "", "", (False, True)), decay.T
    axes = Figure().add_subplot()
    draw_signed(axes, plane, decay, label="")
    (lines,) = axes.collections
    drawn = np.array(lines.get_segments())
    across, along = (drawn[..., 1], drawn[..., 0]) if turned else (drawn[..., 0], drawn[..., 1])
    np.testing.assert_allclose(across, np.mean(settles), atol=1e-12)
    np.testing.assert_allclose(along, [[-0.5, 0.5], [0.5, 1.5], [2.5, 3.5], [3.5, 4.5]], atol=1e-12)


NARROW = [(1.1e4, 1.9e4), (2.1e4, 4.9e4), (550.0, 900.0), (0.2, 5.0), (3e3, 9e3), (1e3, 1e6), (0.5, 60.0)]


@pytest.mark.parametrize("ends", NARROW)
def test_a_logarithmic_axis_has_numbers_to_read_it_by(ends):
    """Two at least, as they are where there are no powers of ten enough."""
    values = np.geomspace(*ends, 12)
    axes = Figure().add_subplot()
    plane = FieldPlane(values, values, "x", "y", (True, True))
    draw_field(axes, plane, np.outer(values, values), label="z, m")
    label_plane(axes, plane, "")
    low, high = axes.get_xlim()
    told = [axes.xaxis.get_major_formatter()(t, 0) for t in axes.get_xticks() if low <= t <= high]
    assert len(told) >= 2
    if ends[1] < 100 * ends[0]:
        assert all(ends[0] * 0.999 <= float(number) <= ends[1] * 1.001 for number in told)


def test_an_even_axis_over_a_narrow_range_is_no_logarithmic_one(excavator):
    """Its numbers are told apart: in three digits, as those of gains, all of them were 1.5."""
    ends = {"x_range": (1.5, 1.5001), "y_range": (-2.0, -1.0)}
    chart = flexopt.map_workspace(excavator, over="posture", points=(8, 4), measures=False, epsilon_max=False, **ends)
    axes = chart.plot().axes[0]
    left, right = axes.get_xlim()
    assert (left, right) == (pytest.approx(1.5, abs=1e-5), pytest.approx(1.5001, abs=1e-5))
    low, high = 1e4, 1.0005e4
    gains = {"kp": (low, high), "dead_time": (0.0, 0.01)}
    loop = flexopt.map_loop(excavator, (0.0448, -2.0499), gains, loop={"kv": 1e3}, points=(5, 3))
    assert loop.plot().axes[0].get_xlim()[1] == pytest.approx(np.log10(high), abs=1e-4)


@pytest.mark.parametrize("span", [(1e4, 4e5), (2e3, 1.9e5), (1e-5, 5e-4), (5e5, 2e6), (0.3, 20.0)])
@pytest.mark.parametrize("size", ["screen", "paper", "slide"])
def test_numbers_of_short_logarithmic_axes_lie_on_no_other(excavator, span, size):
    loop = flexopt.map_loop(
        excavator, (0.0448, -2.0499), {"kp": span, "kv": (1e2, 4e3)}, loop={"kp": 1e3, "kv": 1e3}, points=(5, 5)
    )
    assert faults(loop.plot(size=size)) == []


def test_numbers_beside_ticks_of_a_narrow_range_differ() -> None:
    rng = np.random.default_rng(0)
    for _ in range(300):
        low = 10 ** rng.uniform(-12, 12)
        ticks = between_powers(low, low * (1 + 10 ** rng.uniform(-8, 2)), 4)
        numbers = [shown(tick, digits_of(ticks)) for tick in ticks]
        assert len(set(numbers)) == len(numbers) > 1
    assert digits_of([1.0, 2.0, 5.0]) == 3
