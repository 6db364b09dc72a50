"""The panel of one measure, as a report shows it beside others: narrow, and its letters apart."""

from __future__ import annotations

import math

import numpy as np
import pytest
from matplotlib.figure import Figure

from flexopt.plotting.bands import Bands, Row, plot_band
from tests.plotting.looking import drawn, faults, texts


@pytest.mark.parametrize(
    ("label", "unit"),
    [*(("allowed Kp", unit) for unit in ("N m", "N s/m", "1/s", "N m or N/m")), ("base swing, move of 0.1 m", "mrad")],
)
@pytest.mark.parametrize("times", [1.0, 1e4, 1e-5])
@pytest.mark.parametrize("border", [0.45, 3.0])
def test_no_letters_of_a_narrow_panel_are_on_others(label: str, unit: str, times: float, border: float) -> None:
    rows = tuple(
        Row(name, times * least, times * nominal, times * greatest, f"{times * least:.4g} {unit}")
        for name, least, nominal, greatest in (("stay", 1.5, 2.8, 4.3), ("candidate 2", 6.6, 12.0, 18.0))
    )
    bands = Bands(label, unit, True, rows, "stay", "candidate 2", (border * times, "Kp now"))
    figure = plot_band(bands)
    assert faults(figure) == []
    assert borders(figure, border * times) == [(-0.6, 1.6)]


def borders(figure: Figure, at: float) -> list[tuple[float, float]]:
    """From where to where the lines at a border go."""
    lines = [line for line in figure.axes[0].get_lines() if list(line.get_xdata()) == [at, at]]
    return [(float(low), float(high)) for low, high in (line.get_ydata() for line in lines)]


@pytest.mark.parametrize("own", [0.1, 10.0])
def test_a_row_with_a_border_of_its_own_is_beside_that(own: float) -> None:
    """And every other one beside that of all, wherever the row is."""
    for place, spans in ((0, [(0.5, 3.6)]), (1, [(-0.6, 0.5), (1.5, 3.6)]), (3, [(-0.6, 2.5)])):
        rows = tuple(Row(f"{k}", 2.0, 3.0, 4.0, "2 N m", own if k == place else None) for k in range(4))
        figure = plot_band(Bands("allowed Kp", "N m", True, rows, "0", "3", (1.0, "Kp now")))
        assert borders(figure, 1.0) == spans
        assert borders(figure, own) == [
            (max(place - 0.5, -0.6) if place else -0.6, place + (0.6 if place == 3 else 0.5))
        ]
        assert faults(figure) == []


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("seed", range(4))
def test_a_bar_that_falls_leaves_the_axis_to_other_numbers(seed: int, theme: str) -> None:
    """It goes to the axis' end and says so above itself; one that falls everywhere is a mark there."""
    rng, below = np.random.default_rng(seed), -math.inf
    numbers = 10.0 ** rng.integers(-3, 4) * np.sort(rng.normal(size=(3, 3)))
    rows = [Row(f"candidate {k}", *map(float, three), f"{three[0]:.4g} 1/s") for k, three in enumerate(numbers)]
    rows[1:1] = [
        Row("stay", below, rows[0].nominal, rows[0].greatest, "falls"),
        Row("new gains", below, below, below, "falls"),
    ]
    figure = plot_band(Bands("decay", "1/s", True, tuple(rows), "stay", "new gains", (0.0, "grows")), theme=theme)
    assert faults(figure) == []
    axes, renderer = figure.axes[0], drawn(figure)
    low, high = axes.get_xlim()
    span = max(numbers.max(), 0.0) - min(numbers.min(), 0.0)
    assert high - low < 1.5 * span
    bars = {line.get_ydata()[0]: line for line in axes.get_lines() if line.get_linewidth() == 7}
    assert bars[1].get_xdata()[0] == bars[2].get_xdata()[0] == bars[2].get_xdata()[1] == low < numbers.min()
    written = [text.get_window_extent(renderer) for text in texts(figure) if text.get_text() == "falls"]
    said = [box for box in written if box.x1 < axes.bbox.x1]
    assert len(said) == len(written) / 2 == 2
    for box in said:
        at = axes.transData.inverted().transform((box.x0, box.y0))
        assert low < at[0] < low + 0.05 * (high - low)
        assert not any(box.overlaps(bar.get_window_extent(renderer)) for bar in bars.values())


def test_where_all_fall_the_axis_has_the_border_alone() -> None:
    row = (-math.inf, -math.inf, -math.inf, "falls")
    figure = plot_band(Bands("decay", "1/s", True, (Row("stay", *row), Row("1", *row)), "stay", "1", (0.0, "grows")))
    assert faults(figure) == []
    assert list(figure.axes[0].get_xticks()) == [0.0]
