"""The numbers of single points, beside those of the calls for one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import flexopt
from flexopt.model.parameter_values import with_parameters
from tests.large_studies.studies import small


def of(machine: flexopt.Machine, factor: float, **others: float) -> flexopt.Machine:
    """With stiffer springs under it."""
    springs = ("base.stiffness.x", "base.stiffness.y", "base.stiffness.rotation")
    own = {parameter.name: parameter.value for parameter in machine.parameters}
    return with_parameters(machine, {name: factor * own[name] for name in springs} | others)


def test_measures(tmp_path: Path) -> None:
    quantities = ["w", "w_posture", "frequency_hz", "condition"]
    result = flexopt.run_study(small(quantities=quantities, chunk=100), tmp_path / "study", workers=1)
    assert result.statuses["singular"] == 50  # the stick straight
    assert result.statuses["ok"] == 550
    found = result.dataset().load()
    for k in (0, 77, 340, 594):
        at = found.isel(point=k)
        posture = float(at["posture.boom"]), float(at["posture.stick"])
        one = flexopt.evaluate(of(flexopt.load("excavator"), float(at["stiffness"])), posture)
        assert int(at["status"]) == 0
        np.testing.assert_allclose(at["w"], one.w, rtol=0, atol=1e-12 * np.abs(one.w).max())
        np.testing.assert_allclose(at["frequency_hz"], one.frequencies_hz, rtol=1e-10)
        slopes = one.gradient.w[:, 1:]
        np.testing.assert_allclose(at["w_posture"], slopes, rtol=0, atol=1e-9 * np.abs(slopes).max())
    singular = found["status"].values == 1
    assert np.isnan(found["w"].values[:, singular]).all()
    assert (found["posture.stick"].values[singular] == 0).all()


@pytest.mark.long
def test_outcomes(tmp_path: Path) -> None:
    study = flexopt.Study(
        name="loops", machine="excavator", compute="outcome", quantities=["decay", "delay_margin"], posture=[0.0448, -2.0499],
        loop={"kp": 1e4, "kv": 1e3}, points="sobol", count=8, chunk=4, seed=1,
        vary=[{"of": "kp", "value": [1e3, 1e5], "scale": "log"}, {"of": "dead_time", "value": [0.0, 0.01]},
              {"of": "stiffness", "factor": [0.5, 2.0]}, {"of": "payload.mass", "value": [0.0, 400.0]}],
    )  # fmt: skip
    found = flexopt.run_study(study, tmp_path / "study", workers=1).dataset().load()
    for k in (0, 5):
        at = found.isel(point=k)
        machine = of(flexopt.load("excavator"), float(at["stiffness"]), **{"payload.mass": float(at["payload.mass"])})
        loop = {"kp": float(at["kp"]), "kv": 1e3, "dead_time": float(at["dead_time"])}
        one = flexopt.outcome(machine, (0.0448, -2.0499), loop=loop)
        assert float(at["decay"]) == pytest.approx(one.decay, rel=1e-6, abs=1e-10)
        assert float(at["delay_margin"]) == pytest.approx(one.delay_margin, rel=1e-6, nan_ok=True)


def test_another_control_than_that_of_the_machine_file_s_own_loop(tmp_path: Path) -> None:
    """The way out that is told: an empty loop in its stead."""
    text = (Path(__file__).parents[2] / "models" / "excavator.toml").read_text(encoding="utf-8")
    served = tmp_path / "served.toml"
    served.write_text(f'{text}\n[loop]\ndrive = "velocity"\nservo_gain = 1e4\nkp = 1.0\n', encoding="utf-8")
    vary = '[[vary]]\nof = "posture.boom"\nvalue = [0.2, 1.2]\ncount = 2\n'
    head = 'schema = 1\nname = "loops"\nmachine = "served.toml"\ncompute = "outcome"\ncontrol = "transpose"\n'
    study = tmp_path / "study.toml"
    study.write_text(f"{head}posture = [0.0, -2.0]\n{vary}", encoding="utf-8")
    with pytest.raises(flexopt.FlexoptError, match="an empty table loop of a study or in a file"):
        flexopt.run_study(flexopt.load_study(study), tmp_path / "refused", workers=1)
    study.write_text(f"{head}posture = [0.0, -2.0]\n[loop]\n{vary}", encoding="utf-8")
    assert flexopt.run_study(flexopt.load_study(study), tmp_path / "done", workers=1).statuses["ok"] == 2


def test_selections(tmp_path: Path) -> None:
    study = flexopt.Study(
        name="choices", problem="article", compute="selection", chunk=2,
        vary=[{"of": "target.y", "value": [1.6, 7.0], "count": 2}, {"of": "stiffness", "factor": [1.0, 2.0], "count": 2}],
    )  # fmt: skip
    result = flexopt.run_study(study, tmp_path / "study", workers=2)
    assert (result.statuses["ok"], result.statuses["unreachable"]) == (2, 2)
    found = result.dataset().load()
    best = flexopt.solve_problem(flexopt.load_problem("article"), workers=1).best
    np.testing.assert_allclose(found["posture"].values[:, 0], best.evaluation.posture, atol=1e-9)
    np.testing.assert_allclose(found["base"].values[:, 0], best.evaluation.base, atol=1e-9)
    assert "cannot reach" in str(found["reason"].values[2])
    assert np.isnan(found["objective"].values[2:]).all()


def test_simulations(tmp_path: Path) -> None:
    study = flexopt.Study(
        name="runs", experiment="article-a", compute="simulation",
        vary=[{"of": "kp", "value": [1e4, 1e5], "count": 2}, {"of": "payload.mass", "value": [0.0, 200.0], "count": 2}],
    )  # fmt: skip
    found = flexopt.run_study(study, tmp_path / "study", workers=1).dataset().load()
    experiment = flexopt.load_experiment("article-a")
    one = flexopt.run_experiment(experiment.with_machine(of(experiment.loaded_machine, 1.0, **{"payload.mass": 200.0})))
    assert float(found["linear_growth_rate"][3]) == pytest.approx(one.linear_growth_rate, rel=1e-9)
    assert float(found["end_error"][3]) == pytest.approx(one.end_error, rel=1e-6)


@pytest.mark.parametrize("owner", ["experiment", "machine"])
def test_simulations_of_an_experiment_that_has_a_loop(owner: str, tmp_path: Path) -> None:
    """Gains vary in its `[loop]`, or its machine's; what else that says stays."""
    file, loop = tmp_path / "own.toml", {"kp": 1e5, "kv": 1e3, "rate": 100.0}
    told = "\n[loop]\n" + "\n".join(f"{name} = {value}" for name, value in loop.items())
    machine = (Path(__file__).parents[2] / "models" / "excavator.toml").read_text()
    (tmp_path / "machine.toml").write_text(machine + (told if owner == "machine" else ""))
    text = 'name = "own"\nmachine = "machine.toml"\n[simulation]\nposture = [0.0448, -2.0499]\nduration = 1.0'
    file.write_text(text + (told if owner == "experiment" else ""))

    def study(of: str) -> flexopt.Study:
        return flexopt.Study(
            name="runs", experiment=str(file), compute="simulation", quantities=["linear_growth_rate"],
            vary=[{"of": of, "value": [1e4, 2e4], "count": 2}],
        )  # fmt: skip

    found = flexopt.run_study(study("kp"), tmp_path / "study", workers=1).dataset().load()
    options = {"posture": (0.0448, -2.0499), "duration": 1.0}
    each = [flexopt.simulate(flexopt.load("excavator"), loop=loop | {"kp": kp}, **options) for kp in (1e4, 2e4)]
    np.testing.assert_allclose(found["linear_growth_rate"], [run.linear_growth_rate for run in each], rtol=1e-12)
    with pytest.raises(flexopt.InputError, match="needs a loop with feedback = 'pid'"):
        flexopt.run_study(study("ki"), tmp_path / "none", workers=1)


@pytest.mark.long
def test_a_machine_of_another_kind_under_its_weight(tmp_path: Path) -> None:
    study = flexopt.Study(
        name="hangs", machine="boom-stick-bucket", compute="measures", gravity=True, posture=[-0.8, -1.2, -0.5], points="random",
        count=64, vary=[{"of": "posture.boom", "value": [-1.2, -0.6]}, {"of": "stiffness", "factor": [1e-3, 1.0]}],
    )  # fmt: skip
    found = flexopt.run_study(study, tmp_path / "study", workers=1).dataset().load()
    kept = np.flatnonzero(found["status"].values == 0)
    assert kept.size > 0
    at = found.isel(point=int(kept[0]))
    machine = of(flexopt.load("boom-stick-bucket"), float(at["stiffness"]))
    one = flexopt.evaluate(machine, (float(at["posture.boom"]), -1.2, -0.5), gravity=True)
    np.testing.assert_allclose(at["w"], one.w, rtol=0, atol=1e-10 * np.abs(one.w).max())
