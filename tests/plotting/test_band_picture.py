"""The panel of one measure, as a report shows it beside others: narrow, and its letters apart."""

from __future__ import annotations

import pytest

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
    assert faults(plot_band(bands)) == []
