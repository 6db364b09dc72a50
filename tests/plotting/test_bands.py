"""Panels of bands: as many beside each other as the sheet has most room for."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from flexopt.plotting.bands import Bands, Row, plot_verdict


@pytest.mark.parametrize(
    ("count", "size", "columns"),
    [(5, "screen", 1), (5, "paper", 1), (5, "slide", 2), (1, "slide", 1), (5, (20.0, 5.0), 3)],
)
def test_panels_of_a_wide_sheet_stand_beside_each_other(count: int, size: object, columns: int) -> None:
    rows = tuple(Row(name, 1.0, 2.0, 3.0, "1 s") for name in ("stay", "candidate 1", "candidate 2", "candidate 3"))
    bands = [Bands(f"measure {k}", "s", True, rows, "stay", "candidate 1") for k in range(count)]
    figure = plot_verdict(SimpleNamespace(bands=bands, heading="a machine: move"), size=size)  # type: ignore[arg-type]
    assert len(figure.axes) == count
    # A problem has any name.
    odd = plot_verdict(SimpleNamespace(bands=bands, heading="bay $\\frac$ 2: move"))  # type: ignore[arg-type]
    odd.draw_without_rendering()
    assert len({round(axes.get_position().x0, 2) for axes in figure.axes}) == columns
