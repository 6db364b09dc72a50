"""Closed-loop runs against MuJoCo: same machine, Runge–Kutta of order 4, same hold, controller by MuJoCo's kinematics."""

from __future__ import annotations

import numpy as np
import pytest

from tests.oracles.machines import Structure
from tests.oracles.mujoco_loop import mujoco_run
from tests.simulation.loops import Case, run, stable_case

STEPS = 800
# Angles and displacements, rad and m, of order one; rates, which may be larger, as a share of their largest.
ABSOLUTE, OF_RATES = 1e-12, 1e-11

# Links, where the base gives, passive links: 2 to 5 links with every kind of rigid direction.
STRUCTURES = [
    Structure(2, ("x", "y", "rotation"), ()),
    Structure(2, ("rotation",), ()),
    Structure(3, ("x",), (0,)),
    Structure(3, ("y", "rotation"), ()),
    Structure(4, ("x", "y"), (2,)),
    Structure(5, ("x", "y", "rotation"), (1, 3)),
]
MORE = [
    Structure(2, ("x",), ()),
    Structure(2, ("y",), ()),
    Structure(2, ("x", "y"), ()),
    Structure(3, ("x", "y", "rotation"), (1,)),
    Structure(3, (), (0,)),
    Structure(4, ("x", "rotation"), ()),
    Structure(4, (), (1, 3)),
    Structure(5, ("x", "y", "rotation"), ()),
]


def compare(case: Case) -> None:
    made = case.scenario
    options = case.options
    trajectory = run(made)
    q, v = mujoco_run(
        case.data,
        made.q_design,
        np.concatenate([made.q_design[: -len(made.posture)], made.posture + options["offset"]]),
        base=options["base"],
        control=options["control"],
        kp=options["kp"],
        kv=options["kv"],
        period=made.period,
        steps=STEPS,
        gravity=options.get("gravity", False),
        compensated=options.get("gravity", False) and options.get("gravity_compensation", True),
        nullspace_damping=options.get("nullspace_damping", 0.0),
    )
    assert trajectory.q.shape == q.shape == (STEPS + 1, len(made.q_design))
    # The arm moves, and the base with it.
    assert np.abs(v).max() > 0.05
    assert np.abs(trajectory.deflection).max() > 2e-6
    assert np.abs(trajectory.q - q).max() <= ABSOLUTE
    assert np.abs(trajectory.v - v).max() <= OF_RATES * max(1.0, np.abs(v).max())


@pytest.mark.long
@pytest.mark.parametrize("control", ["inverse", "transpose"])
@pytest.mark.parametrize("structure", STRUCTURES, ids=str)
@pytest.mark.usefixtures("interpreted")
def test_every_rigid_direction(structure, control):
    compare(stable_case(1, structure, control, samples=STEPS))


def in_turns(structures: list[Structure]) -> list[tuple[Structure, str]]:
    """Each with one of the controllers, which know nothing of what the base and the passive links are."""
    return [(structure, ("inverse", "transpose")[k % 2]) for k, structure in enumerate(structures)]


@pytest.mark.long("(4, ('x', 'y'), (2,))-inverse", "(5, ('x', 'y', 'rotation'), (1, 3))-transpose")
@pytest.mark.parametrize(("structure", "control"), in_turns(STRUCTURES), ids=str)
def test_compiled(structure, control):
    compare(stable_case(1, structure, control, samples=STEPS))


@pytest.mark.long("(5, ('x', 'y', 'rotation'), ())-transpose")
@pytest.mark.parametrize(("structure", "control"), in_turns(MORE), ids=str)
@pytest.mark.usefixtures("interpreted")
def test_more_machines(structure, control):
    compare(stable_case(2, structure, control, samples=STEPS))


@pytest.mark.parametrize(
    ("structure", "compensation"),
    [(STRUCTURES[0], True), (STRUCTURES[2], True), (STRUCTURES[2], False), (STRUCTURES[3], False), (MORE[6], True)],
    ids=str,
)
@pytest.mark.usefixtures("interpreted")
def test_under_gravity(structure, compensation):
    compare(stable_case(4, structure, "inverse", samples=STEPS, gravity=True, gravity_compensation=compensation))
