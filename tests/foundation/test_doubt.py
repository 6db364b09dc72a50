"""A number is shown as far as its doubt lets it be known."""

import math
import re

import numpy as np
import pytest

from flexopt.foundation.doubt import BELOW, with_doubt

SHOWN = re.compile(r"-?\d+(\.\d+)?(e[+-]\d+)? ± (inf|\d+(\.\d+)?(e[+-]\d+)?)")


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (0.3, 1.3, "0.3 ± 1.3"),
        (1.23412, 0.0119, "1.234 ± 0.012"),
        (3.0, 1e9, "3 ± 1.0e+09"),
        (3e-15, 4e-14, "3e-15 ± 4.0e-14"),
        (1.5, math.inf, "1.5 ± inf"),
    ],
)
def test_digits_end_where_the_doubt_begins(value: float, error: float, text: str) -> None:
    assert with_doubt(value, error) == text


def test_what_is_shown_holds_what_was_meant() -> None:
    rng = np.random.default_rng(0)
    for _ in range(2000):
        value, error = rng.normal() * 10 ** rng.uniform(-12, 12), 10 ** rng.uniform(-14, 14)
        text = with_doubt(value, error)
        if error < BELOW * abs(value):
            assert float(text) == pytest.approx(value, rel=5e-5)
            continue
        assert SHOWN.fullmatch(text), text
        shown, doubt = (float(each) for each in text.split(" ± "))
        # Two digits of the doubt: it is off by 5 % at most, and the number by less than half of its last shown digit,
        # or all of itself where the doubt is larger by far.
        assert doubt == pytest.approx(error, rel=0.0501)
        assert abs(shown - value) <= 0.0501 * error
