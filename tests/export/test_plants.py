"""A bundle is of one plant, whatever else a long process has built and let go."""

from __future__ import annotations

import flexopt
from flexopt.export.context import build_context
from flexopt.foundation import kept


def test_measures_are_of_the_plant_that_the_bundle_is_of() -> None:
    machine = flexopt.load("excavator")
    flexopt.build_measures(machine)
    # As where a process has built more plants than are kept.
    kept.forget_all()
    options = {"control": "inverse", "gain": 1e5, "single": False, "baked": False, "singularity_margin_deg": 10.0}
    at = build_context(machine, **options)
    assert at.measures.plant is at.plant
