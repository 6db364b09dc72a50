"""The points of a study, beside NumPy's and SciPy's."""

from __future__ import annotations

import shutil
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.stats import kstest, qmc

import flexopt
from flexopt.large_studies.points import StudyPoints
from flexopt.model.study_axes import study_axes
from tests.large_studies.studies import small

MODELS = Path(__file__).parents[2] / "models"


def columns(study: flexopt.Study, order: list[int] | None = None) -> np.ndarray:
    points = StudyPoints(study)
    numbers = list(range(study.chunks)) if order is None else order
    found = {k: points.columns(k) for k in numbers}
    return np.concatenate([found[k] for k in sorted(found)], axis=1)


def test_a_grid_runs_through_its_last_axis_fastest() -> None:
    boom, stick = np.linspace(0.1, 1.4, 10), np.linspace(-2.8, 0.0, 12)
    soil = np.geomspace(0.5, 2.0, 5)
    expected = [axis.ravel() for axis in np.meshgrid(boom, stick, soil, indexing="ij")]
    found = columns(small())
    np.testing.assert_allclose(found, expected, rtol=1e-14, atol=1e-15)
    assert (found.min(axis=1) == [0.1, -2.8, 0.5]).all()
    assert (found.max(axis=1) == [1.4, 0.0, 2.0]).all()


def sampled(points: str, **changes: object) -> flexopt.Study:
    vary = [{"of": "posture.boom", "value": [0.1, 1.4]}, {"of": "posture.stick", "value": [-2.8, -0.1]}]
    return small(vary=vary, points=points, count=1000, **changes)


def test_a_sobol_sequence_is_scipys_in_any_order_of_chunks() -> None:
    study = sampled("sobol", seed=3)
    expected = qmc.scale(qmc.Sobol(2, bits=32, seed=3).random(1024)[:1000], [0.1, -2.8], [1.4, -0.1]).T
    np.testing.assert_allclose(columns(study), expected, rtol=1e-14)
    assert (columns(study, [5, 1, 7, 0, 2, 6, 4, 3]) == columns(study)).all()
    # SciPy's warning of a first draw that is no power of two, here of 100, is none of the study's.
    assert (columns(sampled("sobol", seed=3, chunk=100)) == columns(study)).all()


def test_random_points_are_even_and_each_chunk_has_its_own() -> None:
    found = columns(sampled("random", seed=1))
    assert kstest(found[0], "uniform", (0.1, 1.3)).pvalue > 1e-3
    assert np.unique(found[0]).size == 1000
    assert (columns(sampled("random", seed=1), [3, 0, 2, 1, 7, 6, 5, 4]) == found).all()
    assert (columns(sampled("random", seed=2)) != found).any()


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"vary": [{"of": "posture.bom", "value": [0, 1], "count": 3}]}, "did you mean 'boom'"),
        ({"vary": [{"of": "posture.boom", "value": [0, 100], "count": 3}]}, "must lie between"),
        ({"vary": [{"of": "posture.boom", "value": [0, 1], "count": 3}]}, "posture: is needed, 2 numbers: stick"),
        ({"vary": [{"of": "kp", "value": [1, 2], "count": 3}]}, "does not vary with compute = 'measures'"),
        ({"vary": [{"of": "stiffness", "value": [1, 2], "count": 3}]}, "give factor"),
        ({"vary": [{"of": "stifness", "factor": [1, 2], "count": 3}]}, "did you mean 'stiffness'"),
        ({"posture": [1.0]}, "must be 2 numbers"),
        ({"vary": [{"of": "base.mass", "factor": [1, 2], "count": 2}, {"of": "base.*", "value": [1, 2], "count": 2}]}, "goes with one parameter"),
    ],
)  # fmt: skip
def test_what_does_not_fit_the_machine_is_named(changes: dict[str, object], sentence: str) -> None:
    with pytest.raises(flexopt.InputError) as caught:
        StudyPoints(small(**changes))
    assert sentence in str(caught.value)


def test_an_integral_gain_varies_in_a_loop_that_has_one() -> None:
    vary = [{"of": "ki", "value": [0.0, 1e4], "count": 2}]
    changes = {"compute": "outcome", "quantities": ["decay"], "posture": [0.0448, -2.0499], "vary": vary}
    with pytest.raises(flexopt.InputError, match="needs a loop with feedback = 'pid'"):
        StudyPoints(small(**changes))
    assert StudyPoints(small(**changes, loop={"kp": 1e4, "kv": 1e3, "feedback": "pid"})).axes[0].kind == "ki"


def test_what_no_file_holds_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    base = ca.MX.sym("base")
    own = ca.Function("not_behind", [base], [base + 5], ["base"], ["way"])
    article = flexopt.load_problem("article")
    problem = flexopt.Problem(
        name="own", machine="excavator", target={"end_point": (0.0, 1.6)}, constraints={"own": [own]}
    ).with_machine(article.loaded_machine)
    vary = [{"of": "target.y", "value": [1.5, 1.6], "count": 2}]
    study = flexopt.Study(name="own", problem="article", compute="selection", vary=vary).with_subject(problem)
    with pytest.raises(flexopt.InputError, match="own Functions among its constraints"):
        flexopt.run_study(study, tmp_path / "study")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"machine": None}, "measures needs machine"),
        ({"problem": "article"}, "no other of machine, problem, experiment"),
        ({"points": "sobol"}, "is the study's"),
        ({"points": "sobol", "count": 2**31, "vary": [{"of": "kp", "value": [1, 2]}]}, "at most 1073741824 points"),
        ({"quantities": ["decay"]}, "measures has w,"),
        ({"vary": []}, "must not be empty"),
        ({"vary": [{"of": "posture.boom", "value": [0, 1]}]}, "is required in a grid"),
        ({"vary": [{"of": "posture.boom", "value": [1, 0], "count": 2}]}, "reversed"),
        ({"vary": [{"of": "kp", "value": [0, 1], "count": 2, "scale": "log"}]}, "must be greater than 0"),
    ],
)
def test_what_does_not_fit_together_is_named(changes: dict[str, object], sentence: str) -> None:
    with pytest.raises(flexopt.InputError) as caught:
        small(**changes)
    assert sentence in str(caught.value)


def test_a_study_in_its_folder_is_the_same_study() -> None:
    from flexopt.large_studies.folder import digest_of  # noqa: PLC0415
    from flexopt.model.study_file import described, study_of  # noqa: PLC0415

    for name, more in (("excavator", {}), ("slewing-excavator", {"posture": [0.0, 0.3, -1.0, 0.1]})):
        vary = [{"of": "posture.boom", "value": [0.1, 0.4], "count": 3}]
        study = small(machine=name, vary=vary, **({"posture": [0.3, -1.0]} | more))
        again = study_of(described(study))
        assert digest_of(again) == digest_of(study)
        assert again.loaded_machine == study.loaded_machine
        assert digest_of(study) != digest_of(
            small(machine=name, vary=vary, seed=1, **({"posture": [0.3, -1.0]} | more))
        )


def test_orientation_rows_of_a_target_are_in_metres(tmp_path: Path) -> None:
    """They are the rotation vector times a length."""
    shutil.copytree(MODELS, tmp_path, dirs_exist_ok=True)
    machine, problem = tmp_path / "slewing-excavator.toml", tmp_path / "problem.toml"
    text = machine.read_text(encoding="utf-8")
    machine.write_text(text.replace("[end_point]", '[end_point]\nrows = ["x", "y", "z", "yaw"]'), encoding="utf-8")
    problem.write_text(
        'name = "turned"\nmachine = "slewing-excavator.toml"\n[target]\nend_point = [1.0, 0.5, 1.0, 0.1]\n'
        '[selection]\nobjective = "w1"\n',
        encoding="utf-8",
    )
    vary = [{"of": f"target.{row}", "value": [0.0, 0.1], "count": 2} for row in ("x", "yaw")]
    study = flexopt.Study(name="turned", problem=str(problem), compute="selection", vary=vary)
    assert [axis.unit for axis in study_axes(study)] == ["m", "m"]
