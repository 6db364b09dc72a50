"""NumPy's numbers and arrays, tuples and path objects are as good as Python's own."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flexopt
from flexopt.errors import InputError
from flexopt.robustness import build_measures, evaluate_w
from tests.boundary.calls import POSTURE, STATE_SPACE, TARGET, excavator

NUMBERS: dict[str, Callable[[float], Any]] = {
    "float64": np.float64, "float32": np.float32, "0-d array": np.array, "int64": lambda x: np.int64(int(x)),
    "int": int, "longdouble": np.longdouble,
}  # fmt: skip
LISTS: dict[str, Callable[[list[float]], Any]] = {
    "tuple": tuple, "array": np.array, "float32 array": lambda v: np.array(v, dtype=np.float32),
    "list of NumPy's": lambda v: [np.float64(x) for x in v], "objects": lambda v: np.array(v, dtype=object),
}  # fmt: skip


@pytest.mark.parametrize("spelling", NUMBERS)
def test_numbers(spelling: str) -> None:
    number = NUMBERS[spelling]
    plain = flexopt.evaluate(excavator(), POSTURE, gain=700, base=2)
    assert flexopt.evaluate(excavator(), POSTURE, gain=number(700), base=number(2)).to_dict() == plain.to_dict()
    assert flexopt.Sensor(noise=number(1)) == flexopt.Sensor(noise=1.0)
    data = excavator().to_dict()
    data["base"] |= {"mass": number(700)}
    assert flexopt.machine_from_dict(data).content_hash == flexopt.Machine(**data).content_hash
    assert flexopt.machine_from_dict(data).base.mass == 700.0


@pytest.mark.parametrize("spelling", LISTS)
def test_lists(spelling: str) -> None:
    spelt = LISTS[spelling]
    # Exact in single precision, too.
    posture, limits = [1.0, -2.0], [-3.0, 3.0]
    assert flexopt.evaluate(excavator(), spelt(posture)).to_dict() == flexopt.evaluate(excavator(), posture).to_dict()
    found, wanted = (flexopt.inverse_kinematics(excavator(), target) for target in (spelt([0.5, 1.5]), [0.5, 1.5]))
    assert np.array_equal(found, wanted)
    data = excavator().to_dict()
    links = [dict(link, limits=spelt(limits)) for link in data["links"]]
    assert flexopt.machine_from_dict(data | {"links": links}).limits == ((-3.0, 3.0), (-3.0, 3.0))
    path = flexopt.Path(times=spelt([0.0, 1.0]), points=[spelt([0.0, 1.0]), spelt([1.0, 1.0])])
    assert path.points == ((0.0, 1.0), (1.0, 1.0))
    weights = spelt([1.0, 0.0, 0.0])
    assert flexopt.build_selection(excavator(), TARGET, objective="V", weights=weights, starts=np.int64(1)).starts == 1


def test_words_flags_and_paths(tmp_path: Path) -> None:
    run = flexopt.simulate(excavator(), POSTURE, control=np.str_("inverse"), hold=np.bool_(True), duration=0.05)
    for path in (tmp_path / "a.csv", str(tmp_path / "b.csv"), os.fspath(tmp_path / "c.csv")):
        run.to_csv(path)
        assert Path(path).is_file()
    assert flexopt.evaluate(excavator(), POSTURE, damped=np.False_).damped is None


def test_systems_and_points() -> None:
    lists, arrays = (
        flexopt.StateSpace(**STATE_SPACE),
        {k: np.array(v, dtype=np.float32) for k, v in STATE_SPACE.items()},
    )
    assert float(flexopt.robust_margin(lists)) == float(flexopt.robust_margin(**arrays))
    measures = build_measures(excavator())
    of_lists, of_arrays = (evaluate_w(measures, 0, spelt([[1.0, 1.5], [-2.0, -1.0]])) for spelt in (list, np.array))
    assert np.array_equal(of_lists.w, of_arrays.w)


@pytest.mark.long
def test_singular_points_are_marked() -> None:
    """As `evaluate` refuses them: straight, folded, nearly straight; the others stay."""
    postures = np.array([[1.0, 1.0, 1.0, 1.0, np.nan], [0.0, -2.0, 1e-8, np.pi, -2.0]])
    for gravity in (False, True):
        found = evaluate_w(build_measures(excavator(), gravity=gravity), 0.0, postures, gradient=True)
        assert found.singular.tolist() == [True, False, True, True, True]
        assert np.array_equal(np.isnan(found.w).all(axis=0), found.singular)
        assert np.array_equal(np.isnan(found.w_posture).any(axis=(0, 1)), found.singular)
        assert not found.unheld[:4].any()
    for posture in postures.T[[0, 2, 3]]:
        with pytest.raises(flexopt.SingularPosture):
            flexopt.evaluate(excavator(), posture)


def test_all_faults_at_once_and_words_near() -> None:
    with pytest.raises(InputError) as caught:
        flexopt.evaluate(None, POSTURE, gain=-1, gravity=2)
    assert [fault.field for fault in caught.value.faults] == ["machine", "gain", "gravity"]
    with pytest.raises(InputError, match="did you mean 'gain'"):
        flexopt.evaluate(excavator(), POSTURE, gian=1)
    with pytest.raises(InputError, match="missing a required argument: 'posture'"):
        flexopt.evaluate(excavator())


def test_threads_cannot_hang() -> None:
    measures = build_measures(excavator())
    arguments = [0.0], np.array(POSTURE), np.array(measures.plant.parameter_values).ravel()
    assert measures.quick_batch(*arguments, threads=2**63)[0].shape == (3, 1)
    with pytest.raises(InputError, match="threads"):
        evaluate_w(measures, [0.0], POSTURE, threads=2**63)
