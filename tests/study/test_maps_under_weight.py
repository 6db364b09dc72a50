"""Under gravity a map's end-points are those of the machine as it sags: by SciPy from Pinocchio's weight and kinematics.

Springs and weight, end-point and target are one system of equations in passive and actuated coordinates at once.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.optimize import root

import flexopt
from flexopt.model import machine_from_dict
from flexopt.model.tree import tree_from_dict
from flexopt.study.reports.surroundings import marks_in, surroundings
from tests.oracles.lagrange import rest_values, springs_and_dampers
from tests.oracles.machines import NumpySource, Structure, draw_machine, regular_posture
from tests.oracles.pinocchio_chain import pinocchio_chain
from tests.oracles.spatial import grounded, pinocchio_tree
from tests.study.machines import limited
from tests.study.test_surroundings import behind_wall

pytestmark = pytest.mark.filterwarnings("ignore::flexopt.errors.CompilerNotFound")
REFERENCE = (0.3, -0.9, 1.3)
Numbers = Callable[[np.ndarray], np.ndarray]


class Oracle(NamedTuple):
    """Of passive and actuated coordinates q: what springs and weight leave over, m or rad of each spring; r, m."""

    left: Numbers
    end_point: Numbers
    rest: np.ndarray


def chain(joints: int, seed: int) -> tuple[Any, np.ndarray, Oracle]:
    """A random planar chain on soft springs, a regular posture, and the same at the placement 0 in Pinocchio."""
    rng = np.random.default_rng(seed)
    data = draw_machine(
        NumpySource(rng), Structure(joints, ("x", "y", "rotation"), ()), spread=3.0, frequency=(2.0, 3.0)
    ) | {"gravity": 9.81}
    machine, own = machine_from_dict(data), pinocchio_chain(data, 0.0)
    stiffness, rest = np.diag(springs_and_dampers(data)[0])[:3], rest_values(data, 0.0, np.zeros(joints))[:3]
    oracle = Oracle(lambda q: q[:3] - rest + own.gravity(q)[:3] / stiffness, own.end_point, rest)
    return machine, regular_posture(rng, machine), oracle


def soft(arm: int) -> tuple[Any, dict[str, Any]]:
    """A machine in space on six soft springs, which sags by centimetres."""
    data = grounded(arm, 0)
    data["stiffness_matrix"]["matrix"] = (0.05 * np.array(data["stiffness_matrix"]["matrix"])).tolist()
    return tree_from_dict(data), data


def in_space(data: dict[str, Any], base: np.ndarray) -> Oracle:
    own, stiffness = pinocchio_tree(data), np.array(data["stiffness_matrix"]["matrix"])
    return Oracle(
        lambda q: q[:6] + np.linalg.solve(stiffness, own.gravity(q)[:6]), lambda q: own.task(q, base)[0], np.zeros(6)
    )


def on_target(oracle: Oracle, target: np.ndarray, start: np.ndarray) -> np.ndarray:
    """The posture, with as many joints as task rows, from one that is a little off."""
    m = oracle.rest.size
    found: Any = root(
        lambda q: np.append(oracle.left(q), oracle.end_point(q) - target), np.append(oracle.rest, start), tol=1e-13
    )
    assert np.abs(found.fun).max() < 1e-10
    return found.x[m:]


def sagged(oracle: Oracle, posture: np.ndarray) -> np.ndarray:
    """The end-point where springs and weight balance, the arm held."""
    found: Any = root(lambda passive: oracle.left(np.append(passive, posture)), oracle.rest, tol=1e-13)
    assert np.abs(found.fun).max() < 1e-11
    return oracle.end_point(np.append(found.x, posture))


def aside(oracle: Oracle, posture: np.ndarray, reference: np.ndarray) -> float:
    """How much of the way to the reference leaves the end-point of a redundant arm where it is, as springs give way.

    Nothing at the posture nearest to it. Slopes by differences over 2e-4, which leave about their square.
    """
    steps = 1e-4 * np.eye(posture.size)
    slopes = [(sagged(oracle, posture + step) - sagged(oracle, posture - step)) / 2e-4 for step in steps]
    free = np.linalg.svd(np.array(slopes).T)[2][-1]
    return float(abs(free @ (reference - posture)))


def turned(posture: np.ndarray, other: np.ndarray) -> float:
    """How far apart, whole turns aside."""
    return float(np.abs(np.exp(1j * posture) - np.exp(1j * other)).max())


def some(found: flexopt.WorkspaceMap, count: int) -> np.ndarray:
    """Points that are regular: near others a posture depends on its end-point without bound."""
    cells = np.argwhere(found.array("condition") < 8.0)
    assert len(cells) >= count
    return np.random.default_rng(0).permutation(cells)[:count]


PLAIN: dict[str, Any] = {"epsilon_max": False, "gravity": True}


@pytest.mark.parametrize("elbow", ["up", "down"])
@pytest.mark.parametrize("seed", [0, 1])
def test_two_hinges_in_the_plane(seed: int, elbow: Any) -> None:
    """In the workspace frame, which begins where the first joint is at rest."""
    machine, _, oracle = chain(2, seed)
    found = flexopt.map_workspace(machine, elbow=elbow, points=(17, 16), **PLAIN)
    base, signs = machine.base, set[float]()
    joint = base.length * np.array([np.cos(base.rest_angle), np.sin(base.rest_angle)])
    for row, column in some(found, 8):
        target = joint + np.array([found.array("x")[column], found.array("y")[row]])
        posture = found.array("posture")[:, row, column]
        assert turned(on_target(oracle, target, posture + 0.05), posture) < 1e-8
        at_rest = oracle.end_point(np.append(oracle.rest, posture))
        assert np.abs(at_rest - target).max() > 1e-2
        signs.add(float(np.sign(np.sin(posture[1]))))
    assert signs == {-1.0 if elbow == "up" else 1.0}
    plain = flexopt.map_workspace(machine, elbow=elbow, points=(17, 16), epsilon_max=False)
    # What sags reaches less far up, and farther down.
    lost = np.argwhere((plain.array("reachable") == 1) & (found.array("reachable") == 0))[:, 0]
    won = np.argwhere((plain.array("reachable") == 0) & (found.array("reachable") == 1))[:, 0]
    assert lost.size == 0 or won.size == 0 or lost.mean() > won.mean()
    assert won.size


def test_joint_limits_are_those_of_the_posture_that_sags_onto_the_point() -> None:
    """Of the same arm without limits those whose joints, turned to the limits' middle, keep them."""
    machine = limited()
    free = {"name": "free", **machine.to_dict()}
    free["links"] = [{k: v for k, v in link.items() if k != "limits"} for link in free["links"]]
    bounded, whole = (
        flexopt.map_workspace(each, points=(31, 30), **PLAIN) for each in (machine, machine_from_dict(free))
    )
    low, high = np.array(machine.limits).T[:, :, None, None]
    posture = whole.array("posture")
    posture += 2 * np.pi * np.rint(((low + high) / 2 - posture) / (2 * np.pi))
    with np.errstate(invalid="ignore"):
        kept = np.all((posture >= low) & (posture <= high), axis=0)
    np.testing.assert_array_equal(bounded.array("reachable") == 1, kept)
    assert 10 < kept.sum() < 0.7 * whole.array("reachable").sum()
    np.testing.assert_allclose(bounded.array("posture")[:, kept], posture[:, kept], atol=1e-9)


@pytest.mark.parametrize("seed", [0, 1])
def test_three_hinges_in_the_plane(seed: int) -> None:
    """The nearest of those with which it sags onto the target."""
    machine, reference, oracle = chain(3, seed)
    found = flexopt.map_workspace(machine, posture=reference, base=0.0, points=(11, 10), **PLAIN)
    off = list[float]()
    for row, column in some(found, 9):
        target = np.array([found.array("x")[column], found.array("y")[row]])
        posture = found.array("posture")[:, row, column]
        np.testing.assert_allclose(sagged(oracle, posture), target, atol=1e-9)
        off.append(aside(oracle, posture, reference))
        assert np.abs(oracle.end_point(np.append(oracle.rest, posture)) - target).max() > 3e-3
    # Some ways to the nearest posture, gravity or not, take more steps than are made.
    assert np.median(off) < 1e-6


@pytest.mark.parametrize("arm", [3, 4])
@pytest.mark.parametrize("over", ["end_point", "base"])
def test_in_space(over: Any, arm: int) -> None:
    """The end-point on each point of a plane, and held from each placement, the base turned."""
    machine, data = soft(arm)
    reference, base = np.array([*REFERENCE, 0.4][:arm]), np.array([0.1, 0.0, 0.2])
    found = flexopt.map_workspace(machine, over=over, posture=reference, base=base, points=(8, 7), **PLAIN)
    end_point = flexopt.evaluate(machine, reference, base=base, gravity=True).end_point
    np.testing.assert_allclose(found.options["end_point"], end_point, atol=1e-12)
    off = list[float]()
    for row, column in some(found, 7):
        target, placed = end_point.copy(), base.copy()
        (target if over == "end_point" else placed)[:2] = [found.array(axis)[k] for axis, k in zip(
            found.axes[::-1], (column, row), strict=True)]  # fmt: skip
        posture, oracle = found.array("posture")[:, row, column], in_space(data, placed)
        if arm == 3:
            assert turned(on_target(oracle, target, posture + 0.02), posture) < 1e-8
        else:
            np.testing.assert_allclose(sagged(oracle, posture), target, atol=1e-9)
            off.append(aside(oracle, posture, reference))
        assert np.abs(oracle.end_point(np.append(oracle.rest, posture)) - target).max() > 1e-2
    assert not off or np.median(off) < 1e-6


@pytest.mark.parametrize("joints", [2, 3])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_map_has_the_measures_of_the_configuration_that_it_is_about(joints: int, seed: int) -> None:
    """At its mark, in the middle of an odd number of points."""
    _, chosen, *_ = behind_wall(joints, seed, gravity=True)
    e, machine = chosen.best.evaluation, chosen.problem.machine
    whole = surroundings(chosen, 4)
    assert whole is not None
    x, y = marks_in(chosen, whole)["chosen"]
    how: dict[str, Any] = {name: whole.options[name] for name in ("elbow", "posture", "base") if name in whole.options}
    found = flexopt.map_workspace(
        machine, x_range=(x - 0.1, x + 0.1), y_range=(y - 0.1, y + 0.1), points=(5, 5), gravity=True, **how
    )
    assert marks_in(chosen, found)["chosen"] == pytest.approx((found.array("x")[2], found.array("y")[2]), abs=1e-12)
    middle = {name: found.array(name)[..., 2, 2] for name in map(str, found.dataset.data_vars)}
    np.testing.assert_allclose(middle["posture"], e.posture, atol=1e-9)
    np.testing.assert_allclose(middle["frequency_hz"], e.frequencies_hz, rtol=1e-9)
    np.testing.assert_allclose(middle["rigid"], e.rigid, rtol=1e-8)
    np.testing.assert_allclose(middle["w"], e.w, atol=1e-8 * e.scale.max())
    np.testing.assert_allclose(middle["epsilon_max"], e.epsilon_max, rtol=1e-6)


def test_places_that_keep_a_clearance_as_the_machine_sags_are_shown() -> None:
    """Held by springs unloaded, above the ground by less than it sags, all of them would break it."""
    _, data = soft(3)
    data["capsules"] = [{"body": "arm2", "start": [1.5, 0.0, 0.0], "end": [1.5, 0.0, 0.0], "radius": 0.05}]
    machine = tree_from_dict(data)
    target = np.array([2.6, 0.2, 0.17])
    (posture, *_) = flexopt.inverse_kinematics(machine, target, gravity=True)
    chosen = flexopt.select(
        machine, target, base=(0.0, 0.0, 0.0), posture=posture, gravity=True, starts=2,
        base_range={"x": (-0.2, 0.2), "y": (-0.2, 0.2), "yaw": (-0.1, 0.1)},
        constraints={"clearance": {"distance": 0.1, "ground": 0.0}},
    )  # fmt: skip
    found = surroundings(chosen, 5)
    assert found is not None
    shown = np.isfinite(found.array("condition"))
    assert shown.all()
    for row, column in np.argwhere(shown)[::6]:
        base = np.array([found.array("base_x")[column], found.array("base_y")[row], chosen.best.evaluation.base[2]])
        oracle, q = in_space(data, base), found.array("posture")[:, row, column]
        assert sagged(oracle, q)[2] - 0.05 >= 0.1
        assert oracle.end_point(np.append(oracle.rest, q))[2] - target[2] > 0.02
    e = chosen.best.evaluation
    x, y = ((place - 0.1, place + 0.1) for place in e.base[:2])
    around = flexopt.map_workspace(
        machine, over="base", posture=e.posture, base=e.base, end_point=target, x_range=x, y_range=y, points=(3, 3),
        gravity=True,
    )  # fmt: skip
    # The selection is on the target to its own tolerance, far below this.
    np.testing.assert_allclose(around.array("posture")[:, 1, 1], e.posture, atol=1e-9)
    for name, value in {"frequency_hz": e.frequencies_hz, "scale": e.scale, "rigid": e.rigid}.items():
        np.testing.assert_allclose(around.array(name)[..., 1, 1], value, rtol=1e-8)
    np.testing.assert_allclose(around.array("w")[:, 1, 1], e.w, atol=1e-9 * e.scale.max())


@pytest.mark.filterwarnings("ignore::flexopt.errors.ImplausibleMachine")
def test_what_falls_is_not_reached() -> None:
    """A spring that holds the machine in some postures, and one that does in none."""

    def on_spring(rotation: float) -> Any:
        data = flexopt.load("excavator").to_dict()
        data["base"]["stiffness"]["rotation"] = rotation
        return machine_from_dict(data)

    machine = on_spring(3.5e4)
    found = flexopt.map_workspace(machine, points=(15, 15), **PLAIN)
    reached = found.array("reachable") == 1
    np.testing.assert_array_equal(np.isfinite(found.array("rigid")), reached)
    assert 0 < reached.sum() < 0.5 * flexopt.map_workspace(machine, points=(15, 15)).array("reachable").sum()
    for row, column in np.argwhere(reached)[::10]:
        flexopt.evaluate(machine, found.array("posture")[:, row, column], gravity=True)
    assert not flexopt.map_workspace(on_spring(1e4), points=(4, 4), **PLAIN).array("reachable").any()
    with pytest.raises(flexopt.InputError, match="the springs do not hold the machine"):
        flexopt.map_workspace(on_spring(1e4), posture=[0.9, -1.4], points=(4, 4), **PLAIN)
