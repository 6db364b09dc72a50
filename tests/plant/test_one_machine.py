"""One machine from three file formats: the description cannot change a result."""

from __future__ import annotations

import pytest

from flexopt import load
from tests.oracles.machines import Structure
from tests.oracles.one_machine import differences, random_dict

# Three links, two of them actuated, and a base that slides but cannot turn.
STRUCTURE = Structure(3, ("x", "y"), (1,))


# What searches, runs and bundles make of an arm of two joints is asked of the random machine below.
@pytest.mark.long("boom-stick-bucket-True")
@pytest.mark.parametrize(("name", "searches"), [("excavator", False), ("boom-stick-bucket", True)])
def test_shipped_machines(name, searches, tmp_path):
    found = differences(load(name).to_dict(), tmp_path, seed=0, searches=searches)
    assert max(found.values()) <= 1e-12, found


@pytest.mark.long
def test_a_random_machine(tmp_path):
    found = differences(random_dict(2, STRUCTURE), tmp_path, seed=2)
    assert max(found.values()) <= 1e-12, found


@pytest.mark.parametrize("seed", range(6))
def test_graphs_of_any_structure(seed, tmp_path):
    found = differences(random_dict(seed), tmp_path, seed=seed, searches=False)
    assert max(found.values()) <= 1e-11, found
