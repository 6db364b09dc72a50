"""Every operation in a machine's graphs is known in extended precision; one that is not ends in a sentence."""

import casadi as ca
import numpy as np
import pytest

import flexopt
from flexopt.compiled import extended as module
from flexopt.compiled.extended import extended
from flexopt.errors import FlexoptWarning, NoSolutionFound
from flexopt.foundation import kept
from flexopt.model import shipped_names
from flexopt.robustness import damped
from flexopt.robustness.margin import build_margin
from tests.oracles.spatial import random_tree

ROWS = [
    ("x",),
    ("x", "z"),
    ("x", "y", "z"),
    ("x", "y", "z", "roll", "pitch", "yaw"),
    ("roll", "pitch", "yaw"),
    ("yaw",),
]
CONTROLS = ["inverse", "transpose", "damped:0.1"]


def check(machine, control, gravity):
    margin = build_margin(machine, control, gravity)
    for function in (margin.plant_at, damped._matrices(machine, control, gravity)):
        assert not extended(function).unknown


@pytest.mark.parametrize("gravity", [False, True])
@pytest.mark.parametrize("control", CONTROLS)
@pytest.mark.parametrize("name", shipped_names("models"))
def test_shipped_machines(name, control, gravity):
    check(flexopt.load(name), control, gravity)


@pytest.mark.parametrize("control", CONTROLS)
@pytest.mark.parametrize("rows", ROWS, ids="-".join)
def test_trees_with_every_kind_of_row(rows, control):
    check(flexopt.tree_from_dict(random_tree(len(rows), rows=rows, counts=(2, 7))), control, gravity=False)


@pytest.fixture
def built_anew():
    """Graphs are translated anew within a test, and again after it."""
    extended.cache_clear()
    kept.forget_all()
    yield
    extended.cache_clear()
    kept.forget_all()


@pytest.mark.usefixtures("built_anew")
def test_one_that_is_not_known_ends_in_a_sentence(monkeypatch):
    monkeypatch.delitem(module.OPERATIONS, ca.OP_SIN)
    machine = flexopt.load("excavator")
    sentence = "could not be computed.*operation .* is not known"
    with pytest.warns(FlexoptWarning, match="ε_max " + sentence):
        result = flexopt.evaluate(machine, [0.99, -2.63])
    assert result.epsilon_max_status == "not computed"
    assert np.all(np.isnan(result.gradient.epsilon_max))
    with pytest.raises(NoSolutionFound, match="damped modes " + sentence):
        flexopt.evaluate(machine, [0.99, -2.63], damped=True)
