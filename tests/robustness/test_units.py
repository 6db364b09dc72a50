"""Units as pages and pictures print them."""

import pytest

from flexopt.robustness.residues import written_unit


@pytest.mark.parametrize(
    ("unit", "written"),
    [("1/(kg m2)", "1/(kg m²)"), ("m^3", "m³"), ("1/kg", "1/kg"), ("mixed", "mixed units"), ("N m", "N m"), ("", "")],
)
def test_written(unit: str, written: str) -> None:
    assert written_unit(unit) == written
