"""Nothing leans on what a cache happens to hold: the machines that one process meets may be more than it keeps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import flexopt
from flexopt.plant import plant as plants
from flexopt.selection.nlp.configuration import build_configuration

MACHINE = flexopt.load("excavator")


def forget(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plants are built anew each time, of other symbols, as when pushed out of the records."""
    for name in ("_built", "_graph"):
        monkeypatch.setattr(plants, name, getattr(plants, name).__wrapped__)


@pytest.mark.parametrize("gravity", [False, True])
def test_functions_of_one_configuration_are_of_the_same_symbols(gravity: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each is made when it is first asked for; the rows that hold the weight are the same by both ways to them."""
    forget(monkeypatch)
    made = build_configuration(MACHINE, gravity=gravity)
    p, z = np.array(made.measures.plant.parameter_values.full().ravel()), [[0.0], [1.0, -1.5]]
    held = made.measures.hold.call([*z, p])[0]
    rows = made.row_values.call([*z, p, [], held])[0].full()
    np.testing.assert_allclose(made.rows_alone.call([*z, p, []])[0].full(), rows, rtol=1e-9, atol=1e-12)
    assert made.row_slopes.call([*z, p, [], held])[1].shape == (made.n_rows, 3)


def test_a_verdict_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a machine that falls: other ways to hold the weight are looked for at the choice's targets."""
    asked: dict[str, Any] = {"base": 0.0, "gravity": True, "starts": 1, "members": 2, "runs": 0}
    asked |= {"loop": {"kp": 2e3, "kv": 5e2, "rate": 200}, "ranges": {"payload.mass": (0, 1500)}}
    before = flexopt.verdict(MACHINE, (0.0, 1.6), **asked)
    forget(monkeypatch)
    anew = flexopt.verdict(MACHINE, (0.0, 1.6), **asked)
    assert anew.reason == before.reason
    assert [place.decay.nominal for place in anew.places] == [place.decay.nominal for place in before.places]
