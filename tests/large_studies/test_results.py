"""What is read, reduced and exported, beside NumPy, xarray and pandas on the whole."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import flexopt
from flexopt.large_studies.singly import ManySelections
from flexopt.model.study_axes import study_axes
from tests.large_studies.studies import small


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> flexopt.StudyResult:
    return flexopt.run_study(small(), tmp_path_factory.mktemp("results") / "study", workers=1)


@pytest.fixture(scope="module")
def whole(result: flexopt.StudyResult) -> xr.Dataset:
    return xr.concat(list(result.datasets()), "point")


def test_the_whole_is_lazy(result: flexopt.StudyResult, whole: xr.Dataset) -> None:
    found = result.dataset()
    assert found["w"].chunks is not None
    assert found["w"].chunks[-1] == (128, 128, 128, 128, 88)
    xr.testing.assert_equal(found.load(), whole)
    assert whole["joint"].values.tolist() == ["boom", "stick"]
    assert found["w"].attrs["units"]


@pytest.mark.parametrize(
    "over", [["stiffness"], ["posture.boom", "posture.stick"], None, ["posture.stick", "stiffness"]]
)
@pytest.mark.parametrize("how", ["min", "max", "mean"])
def test_reductions(result: flexopt.StudyResult, whole: xr.Dataset, how: str, over: list[str] | None) -> None:
    names = ["posture.boom", "posture.stick", "stiffness"]
    found = result.reduce("w", how, over)
    box = whole["w"].values.reshape(3, 10, 12, 5)
    axes = tuple(1 + k for k, name in enumerate(names) if over is None or name in over)
    with np.errstate(all="ignore"), pytest.warns() if over == ["stiffness"] else np.errstate():
        expected = getattr(np, f"nan{how}")(box, axis=axes)
    np.testing.assert_allclose(found["w"].values, expected, rtol=1e-12)
    assert (found["points"].values == np.isfinite(box).sum(axis=axes)).all()
    if how == "mean":
        return
    # Where it was: the numbers there are those.
    for name in over or names:
        assert set(np.unique(found[f"at.{name}"].values[np.isfinite(found["w"].values)])) <= set(whole[name].values)
    if over is None:
        for mode in range(3):
            at = {name: float(found[f"at.{name}"].values[mode]) for name in names}
            here = np.all([whole[name].values == value for name, value in at.items()], axis=0)
            assert whole["w"].values[mode, here] == found["w"].values[mode]


def test_quantiles_are_exact(result: flexopt.StudyResult, whole: xr.Dataset) -> None:
    shares = [0.001, 0.25, 0.5, 0.9, 1.0]
    found = result.quantiles("w_posture", shares)
    values = whole["w_posture"].values
    sound = values[..., np.isfinite(values).all(axis=(0, 1))]
    expected = np.quantile(sound, shares, axis=-1, method="inverted_cdf")
    assert (found["w_posture"].values == expected).all()
    assert (expected < 0).any()
    assert (expected > 0).any()


def test_infinite_numbers_count(tmp_path: Path) -> None:
    """Of a loop so weak that no border was met, the largest stable gain is infinite: that is the greatest of all."""
    study = flexopt.Study(
        name="weak", machine="excavator", compute="outcome", quantities=["allowed_gain", "swing"], posture=[0.0448, -2.0499],
        loop={"kp": 1.0, "kv": 0.1}, vary=[{"of": "kp", "value": [1e-3, 1e4], "count": 2}],
    )  # fmt: skip
    result = flexopt.run_study(study, tmp_path / "study", workers=1)
    found = {how: result.reduce("allowed_gain", how) for how in ("min", "max", "mean")}
    assert [float(each["allowed_gain"]) for each in found.values()] == [0.0, np.inf, np.inf]
    assert [float(found[how]["at.kp"]) for how in ("min", "max")] == [1e4, 1e-3]
    assert result.quantiles("allowed_gain", [0.5, 1.0])["allowed_gain"].values.tolist() == [0.0, np.inf]
    units = {name: result.dataset()[name].attrs["units"] for name in ("allowed_gain", "swing")}
    assert units == {"allowed_gain": "N m", "swing": "rad/m"}


def test_one_netcdf_file(result: flexopt.StudyResult, whole: xr.Dataset, tmp_path: Path) -> None:
    result.to_netcdf(tmp_path / "all.nc")
    with xr.open_dataset(tmp_path / "all.nc") as found:
        assert found.encoding["unlimited_dims"] == {"point"}
        for name in ("w", "w_posture", "status", "posture.boom", "posture.stick", "stiffness"):
            np.testing.assert_array_equal(found[name].transpose(..., "point").values, whole[name].values)
        assert found["w"].attrs["units"] == whole["w"].attrs["units"]


def test_one_csv_file(result: flexopt.StudyResult, whole: xr.Dataset, tmp_path: Path) -> None:
    result.to_csv(tmp_path / "all.csv")
    found = pd.read_csv(tmp_path / "all.csv")
    assert len(found) == 600
    np.testing.assert_allclose(found["w_posture.2.stick"], whole["w_posture"].values[1, 1], rtol=1e-14)
    assert (found["status"] == "singular").sum() == 50


def test_reasons_are_exported(tmp_path: Path) -> None:
    study = flexopt.Study(
        name="far", problem="article", compute="selection", chunk=1,
        vary=[{"of": "base.x", "value": [-1.0, 0.5], "count": 1}, {"of": "target.y", "value": [1.6, 7.0], "count": 2}],
    )  # fmt: skip
    result = flexopt.run_study(study, tmp_path / "study", workers=1)
    assert result.dataset()["w"].attrs["units"] == result.dataset()["objective"].attrs["units"] == "1/(kg m2)"
    result.to_netcdf(tmp_path / "all.nc")
    result.to_csv(tmp_path / "all.csv")
    with xr.open_dataset(tmp_path / "all.nc") as found:
        assert b"cannot reach" in found["reason"].values[1]
        assert found["status"].values.tolist() == [0, 4]
    written = pd.read_csv(tmp_path / "all.csv")
    assert "cannot reach" in written["reason"][1]
    # What varies and the answer both have an x.
    assert written["base.x"].tolist() == [-1.0, -1.0]
    assert written["best.base.x"][0] == pytest.approx(float(result.dataset()["base"][0, 0]))


@pytest.mark.parametrize(
    ("objective", "least", "unit"),
    [("w1,w2", None, "1/(kg m2)"), ("V", None, "1/(kg m2)"), ("epsilon_max,w1", None, "1"), ("decay", None, "1/s"),
     ("w1,decay", None, "1/s"), ("decay,w1", None, "1/(kg m2)"), ("epsilon_max,w1", {"decay": 0.01}, "1/(kg m2)")],
)  # fmt: skip
def test_the_unit_of_an_objective_is_that_of_the_one_that_is_told(objective: str, least: Any, unit: str) -> None:
    weights = (1.0, 1.0, 1.0) if objective == "V" else None
    problem = flexopt.Problem(
        name="any", machine="excavator", target={"end_point": (0.0, 1.6)}, constraints={"outcome": least},
        selection={"objective": objective, "weights": weights}, loop={"kp": 1e4, "kv": 1e3},
    ).with_machine(flexopt.load("excavator"))  # fmt: skip
    vary = [{"of": "target.y", "value": [1.5, 1.6], "count": 2}]
    study = flexopt.Study(name="any", problem="any", compute="selection", vary=vary).with_subject(problem)
    assert ManySelections(study, study_axes(study)).units["objective"] == unit


def test_what_there_is_not_is_refused(result: flexopt.StudyResult) -> None:
    with pytest.raises(flexopt.InputError, match="is none of the study's: w, w_posture"):
        result.reduce("decay", "min")
    with pytest.raises(flexopt.InputError, match=r"does not vary: posture\.boom"):
        result.reduce("w", "min", ["kp"])
    with pytest.raises(flexopt.InputError, match="greater than 0 and at most 1"):
        result.quantiles("w", [0.0])


def test_without_dask_small_ones_are_read_whole(
    result: flexopt.StudyResult, whole: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "dask.array", None)
    xr.testing.assert_equal(result.dataset(), whole)
    monkeypatch.setattr("flexopt.large_studies.result.IN_MEMORY", 1000)
    with pytest.raises(flexopt.InputError, match="needs dask"):
        result.dataset()
