"""Constraints `within` intervals of a machine's numbers, against machines whose files have these numbers."""

from __future__ import annotations

from itertools import product
from typing import Any

import casadi as ca
import numpy as np
import pytest

import flexopt
from flexopt.model.constraints import read_constraints
from flexopt.plant import build_plant
from flexopt.selection.constraints import build_constraints, constraint_labels
from flexopt.selection.constraints.building import ConstraintSet

SUPPORTED = {"excavator": {"support": {"span": [-1.8, 1.9]}}}
PLANAR = ("excavator", "boom-stick-bucket")
SHIPPED = (*PLANAR, "slewing-excavator", "truck-crane", "mobile-manipulator")


def supported(name: str) -> Any:
    machine = flexopt.load(name)
    data = machine.to_dict() | SUPPORTED.get(name, {})
    return flexopt.machine_from_dict(data) if name in PLANAR else flexopt.tree_from_dict(data)


def masses(machine: Any) -> list[str]:
    """Names of two masses that the arm carries: its payload and a body's."""
    names = [each.name for each in machine.parameters if each.name.endswith(".mass") and each.value > 0]
    return [names[-1], names[-2]]


def with_numbers(machine: Any, numbers: dict[str, float]) -> np.ndarray:
    p = {each.name: each.value for each in machine.parameters} | numbers
    return np.array([p[each.name] for each in machine.parameters])


def values(machine: Any, rows: ConstraintSet, base: np.ndarray, posture: np.ndarray, p: Any) -> dict[str, float]:
    found = rows.function(base, posture, p, rows.constants).full().ravel()
    assert rows.report(base, posture, p, rows.constants).shape == (len(rows), 1)
    return dict(zip([row.name for row in rows.rows], found.tolist(), strict=True))


@pytest.mark.parametrize("name", SHIPPED)
def test_rows_at_corners_are_those_with_other_numbers(name: str) -> None:
    machine = supported(name)
    plant, rng = build_plant(machine), np.random.default_rng(3)
    first, second = masses(machine)
    own = {each.name: each.value for each in machine.parameters}
    asked: dict[str, Any] = {"tip_over_margin": 0.1, "manipulability": 0.1}
    asked |= {"holding": 0.8} if any(np.isfinite(machine.efforts)) or machine.cylinders else {}
    # From its own number on: that corner is not kept twice.
    ends = {first: (own[first], 1.5 * own[first]), second: (0.8 * own[second], 1.2 * own[second])}
    rows = build_constraints(plant, read_constraints(asked | {"within": ends}))
    plain = build_constraints(plant, read_constraints(asked))
    p, base, posture = plant.parameter_values, rng.normal(size=plant.n_base), rng.normal(size=plant.n_actuated)
    found, seen = values(machine, rows, base, posture, p), 0
    assert list(found)[: len(plain)] == [row.name for row in plain.rows]
    assert len(found) == len(rows)
    for one, other in product(ends[first], ends[second]):
        expected = values(machine, plain, base, posture, with_numbers(machine, {first: one, second: other}))
        told = [f"{name} is {x:.4g} kg" for name, x in ((first, one), (second, other)) if x != own[name]]
        order = sorted(told, key=lambda each: [q.name for q in machine.parameters].index(each.split(" is ")[0]))
        where = f" where {' and '.join(order)}"
        for label, value in expected.items():
            if label + where in found:
                assert found[label + where] == pytest.approx(value, rel=1e-12, abs=1e-9)
                seen += 1
            else:
                # What depends on neither has no row of its own there.
                assert value == pytest.approx(found[label], rel=1e-12, abs=1e-12)
    assert seen == len(rows) - len(plain) > 0
    kept = {row.name: (row.lower, row.upper, row.scale, row.unit) for row in rows.rows}
    assert all(kept[label] == kept[label.split(" where ")[0]] for label in kept)
    assert constraint_labels(plant, read_constraints(asked | {"within": ends})) == list(found)


def test_factors_and_several_numbers_of_one_interval() -> None:
    machine = supported("boom-stick-bucket")
    plant = build_plant(machine)
    asked = {"tip_over_margin": 0.1, "within": [{"of": "*.mass", "factor": [0.5, 2.0]}]}
    rows = build_constraints(plant, read_constraints(asked))
    assert len(rows) == 6
    base, posture = np.array([0.3]), np.array([-0.9, -1.2, -0.4])
    found = values(machine, rows, base, posture, plant.parameter_values)
    # Of all masses together the centre of mass is where it was.
    each = np.array(list(found.values())).reshape(3, 2)
    assert each == pytest.approx(np.tile(each[0], (3, 1)), rel=1e-12)


@pytest.mark.parametrize(
    ("within", "sentence"),
    [
        ({"payload.mas": (0.0, 1.0)}, "payload.mass"),
        ({"dead_time": (0.0, 0.01)}, "is a number of the loop"),
        ({"stick.length": (2.0, 4.0)}, "moves the end-point (stick.length)"),
        ({"base.stiffness.x": (1e5, 2e6)}, "that was asked for depends on it"),
        ({f"{body}.mass": (1.0, 2000.0) for body in ("base", "boom", "stick", "bucket", "payload")}, "at most 4"),
        ({"payload.mass": (2.0, 1.0)}, "constraints.within[0].value"),
        ([], "must be a list"),
        (3.0, "must be a list"),
    ],
)
def test_what_does_not_go_together_is_told(within: Any, sentence: str) -> None:
    with pytest.raises(flexopt.InputError) as caught:
        flexopt.build_selection(
            flexopt.load("boom-stick-bucket"), (7.0, 1.0), constraints={"holding": 0.9, "within": within}
        )
    assert sentence in str(caught.value)
    assert "constraints" in str(caught.value)


@pytest.mark.long
def test_a_choice_keeps_what_the_heaviest_load_needs() -> None:
    """Where the best with the file's payload cannot hold it; by `evaluate` of a machine whose file has it."""
    machine, target, heaviest = flexopt.load("boom-stick-bucket"), (5.0, -1.0), 2500.0
    options: dict[str, Any] = {"base": 0.0, "starts": 6}
    asked = {"holding": 0.9, "within": {"payload.mass": (0.0, heaviest)}}
    kept = flexopt.select(machine, target, constraints=asked, **options)
    plain = flexopt.select(machine, target, constraints={"holding": 0.9}, **options)
    data = machine.to_dict()
    most = {each["name"]: 0.9 * np.array(each["force"]) for each in data["cylinders"]}

    def worst(candidate: Any, load: float) -> float:
        data["payload"]["mass"] = load
        there, at = flexopt.machine_from_dict(data), candidate.evaluation
        held = flexopt.evaluate(there, at.posture, base=at.base).cylinders
        return max(max(each.force / most[each.name][1], -each.force / most[each.name][0]) for each in held)

    assert max(worst(each, heaviest) for each in plain.candidates) > 1.01
    for each in kept.candidates:
        assert max(worst(each, load) for load in (0.0, 1000.0, heaviest)) <= 1 + 1e-6
    found = flexopt.verdict(kept, loop="default", ranges={"payload.mass": (0.0, heaviest)}, members=4, runs=0)
    assert not any(place.breaks for place in found.places)
    assert not found.excluded


def test_own_constraints_are_said_to_be_kept_with_the_files_numbers() -> None:
    own = ca.Function("heavy", [p := ca.MX.sym("p", len(flexopt.load("excavator").parameters))], [p[0]], ["p"], ["g"])
    asked = [own, {"within": {"payload.mass": (0.0, 500.0)}}]
    with pytest.raises(flexopt.InputError, match="constraints of your own are kept with the file's numbers"):
        flexopt.build_selection(flexopt.load("excavator"), (0.0, 1.6), constraints=asked)


@pytest.mark.parametrize("name", SHIPPED[1:])
def test_at_each_corner_the_arm_is_held_once_whatever_is_asked(name: str) -> None:
    """Under its weight that is most of the graph: with further kinds it grows by their own rows only."""
    machine = supported(name)
    plant, (load, _) = build_plant(machine), masses(machine)
    own = next(each.value for each in machine.parameters if each.name == load)

    def size(within: dict[str, Any], **asked: Any) -> int:
        rows = build_constraints(plant, read_constraints(asked | within), gravity=True)
        assert len({row.corner for row in rows.rows} - {""}) == 2 * len(within)
        return rows.function.n_instructions()

    less, more = {"tip_over_margin": 0.1}, {"tip_over_margin": 0.1, "self_clearance": 0.01}
    within = {"within": {load: (0.5 * own, 2.0 * own)}}
    # Those rows with three numbers instead of one.
    assert size(within, **more) - size(within, **less) <= 3 * (size({}, **more) - size({}, **less))
