"""What nobody has measured, as data: names, faults, files."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flexopt
from flexopt.model import tree_from_dict
from flexopt.model.uncertainty import GROUND, Uncertainty, parameters_of, uncertainty_faults
from tests.oracles.spatial import grounded

SHIPPED = ("boom-stick-bucket", "excavator", "mobile-manipulator", "slewing-excavator", "truck-crane")
FOLDER = Path(__file__).parents[2] / "models"


@pytest.mark.parametrize("name", SHIPPED)
def test_the_ground_is_every_spring_of_a_passive_coordinate(name: str) -> None:
    """Twice as stiff, and modes without weight are as many times faster."""
    machine = flexopt.load(name)
    plant = flexopt.build_plant(machine)
    chosen, p = parameters_of(GROUND[0].of, machine), plant.parameter_values.full().ravel()
    assert not uncertainty_faults(GROUND, machine)
    before = plant.stiffness(p).full()
    p[list(chosen)] *= 2
    assert plant.stiffness(p).full() == pytest.approx(2 * before)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"of": "payload.mas", "value": (0, 1)}, "did you mean 'payload.mass'"),
        ({"of": "payload.mass", "factor": (1, 2)}, "multiplies 0"),
        ({"of": "base.stiffness.*", "value": (1, 2)}, "goes with one parameter"),
        ({"of": "payload.mass", "value": (-1, 2)}, "must lie between 0 and"),
    ],
)
def test_what_does_not_go_with_the_machine(given: dict[str, Any], sentence: str) -> None:
    with pytest.raises(flexopt.InputError, match="ranges"):
        flexopt.verdict(flexopt.load_problem("article"), ranges=[given])
    faults = uncertainty_faults((Uncertainty(**given),), flexopt.load("excavator"))
    assert sentence in faults[0].sentence


BASE = ("base.x", "base.y", "base.z", "base.roll", "base.pitch", "base.yaw")


@pytest.mark.parametrize("seed", range(1, 5))
def test_an_entry_of_a_matrix_is_found_by_its_parts(seed: int) -> None:
    """NumPy's entries of random matrices are the values of the parameters that are named."""
    rng, data = np.random.default_rng(seed), grounded(2 + seed, seed)
    coordinates = dict(zip(data["stiffness_matrix"]["joints"], BASE, strict=True))
    for word in ("stiffness_matrix", "damping_matrix"):
        data[word]["joints"] = list(BASE)
    for body in data["bodies"]:
        body["joint"]["name"] = coordinates.get(body["joint"]["name"], body["joint"]["name"])
    machine = tree_from_dict(data)
    values = {parameter.name: parameter.value for parameter in machine.parameters}
    for word in ("stiffness", "damping"):
        joints, matrix = data[f"{word}_matrix"]["joints"], np.array(data[f"{word}_matrix"]["matrix"])
        for i, j in zip(*np.triu_indices(len(joints)), strict=True):
            parts = [*dict.fromkeys([word, *joints[i].split("."), *joints[j].split(".")])]
            given = ".".join(rng.permutation(parts))
            [fault] = uncertainty_faults([Uncertainty(of=given, factor=(0.5, 2.0))], machine)
            meant = fault.sentence.partition("did you mean ")[2].strip("'?")
            assert values[meant] == pytest.approx(matrix[i, j], rel=1e-12), given


def test_one_parameter_is_uncertain_once_but_for_factors() -> None:
    both = (Uncertainty(of="stiffness", factor=(1, 2)), Uncertainty(of="base.stiffness.x", value=(1e6, 2e6)))
    assert "stiffness concerns, too" in uncertainty_faults(both, flexopt.load("excavator"))[0].sentence
    factors = (both[0], Uncertainty(of="base.stiffness.x", factor=(0.5, 1)))
    assert not uncertainty_faults(factors, flexopt.load("excavator"))


def test_a_name_that_looks_like_a_pattern_is_found() -> None:
    data = flexopt.load("excavator").to_dict()
    data["links"] = [link | {"name": f"link[{k}]"} for k, link in enumerate(data["links"])]
    machine = flexopt.machine_from_dict(data)
    names = [parameter.name for parameter in machine.parameters]
    assert parameters_of(("link[1].mass",), machine) == (names.index("link[1].mass"),)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"of": "stiffness"}, "give one of the two"),
        ({"of": "stiffness", "factor": (1, 2), "value": (1, 2)}, "give one of the two"),
        ({"of": "dead_time", "factor": (1, 2)}, "needs it"),
        ({"of": ("dead_time", "stiffness"), "factor": (1, 2)}, "stands alone"),
        ({"of": "dead_time", "value": (0, 11)}, "between 0 and 10 s"),
        ({"of": "stiffness", "factor": (2, 1)}, "reversed"),
        ({"of": "payload.mass", "factor": (0, 2)}, "0 among them, are a value"),
    ],
)
def test_what_does_not_fit_together(given: dict[str, Any], sentence: str) -> None:
    with pytest.raises(flexopt.InputError, match=sentence):
        Uncertainty(**given)


@pytest.mark.parametrize("name", SHIPPED)
def test_a_file_brings_its_own(name: str, tmp_path: Path) -> None:
    text = (FOLDER / f"{name}.toml").read_text(encoding="utf-8")
    own = '\n[[uncertainty]]\nof = "stiffness"\nfactor = [0.5, 2.0]\n'
    shutil.copytree(FOLDER / "robots", tmp_path / "robots")
    path = tmp_path / "own.toml"
    path.write_text(text + own, encoding="utf-8")
    machine, plain = flexopt.load(path), flexopt.load(name)
    assert machine.uncertainty == GROUND
    assert machine != plain
    assert machine.model_copy(update={"uncertainty": ()}).parameters == plain.parameters
    path.write_text(text + own.replace("stiffness", "stifness"), encoding="utf-8")
    with pytest.raises(flexopt.ModelError, match="stifness"):
        flexopt.load(path)
