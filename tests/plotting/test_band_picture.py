"""The panel of one measure, as a report shows it beside others: narrow, and its letters apart."""

from __future__ import annotations

import pytest
from matplotlib.figure import Figure

from flexopt.plotting.bands import Bands, Row, plot_band
from tests.plotting.looking import faults


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
