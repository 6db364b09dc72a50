"""Graphs are shared by machines of one structure, and by no others; few structures are kept."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import flexopt
from flexopt.foundation import kept
from flexopt.model.parameter_values import with_parameters
from tests.oracles.machines import random_machine
from tests.oracles.spatial import random_tree

Data = dict[str, Any]
SHIPPED = ("excavator", "boom-stick-bucket", "mobile-manipulator", "slewing-excavator", "truck-crane")
# Random machines in the plane have seeds below 100, those in space above.
RANDOM = (0, 1, 101, 102)


def built(data: Data) -> Any:
    return flexopt.tree_from_dict(data) if "bodies" in data else flexopt.machine_from_dict(data)


def of_kind(kind: str | int) -> Any:
    if isinstance(kind, str):
        return flexopt.load(kind)
    return random_machine(np.random.default_rng(kind))[1] if kind < 100 else built(random_tree(kind))


def with_other_numbers(machine: Any, seed: int) -> Any:
    """The same structure with other values of all parameters but pins of cylinders; zeros become values."""
    rng, pins = np.random.default_rng(seed), {name for c in machine.cylinders for name in c.numbers()}
    factors = {unit: float(rng.uniform(0.9, 1.1)) for unit in sorted({p.unit for p in machine.parameters})}
    factors |= dict.fromkeys(("kg", "kg m²"), float(rng.uniform(0.8, 1.25)))
    values = {p.name: p.value * factors[p.unit] for p in machine.parameters if p.name not in pins}
    zero = [name for name, value in values.items() if value == 0 and not name.endswith(("damping", "mass"))]
    values |= dict.fromkeys(zero if seed % 2 else (), 0.01)
    return with_parameters(machine, values)


def posture_of(machine: Any) -> np.ndarray:
    low, high = np.clip(machine.limits, -2.0, 2.0).T
    return low + np.linspace(0.55, 0.7, len(low)) * (high - low)


def plant_numbers(machine: Any) -> Any:
    plant, posture = flexopt.build_plant(machine), posture_of(machine)
    base, p = np.zeros(plant.n_base), plant.parameter_values
    q = plant.rest(base, posture, p)
    found = [q, plant.mass(q, base, p), plant.end_point(q, base, p), plant.gravity(q, base, p), plant.stiffness(p)]
    return [machine.limits, *(each.full().tolist() for each in (*found, plant.deflected(base, posture, p)))]


def reached(machine: Any) -> Any:
    plant, posture = flexopt.build_plant(machine), posture_of(machine)
    base, p = np.zeros(plant.n_base), plant.parameter_values
    target = plant.end_point(plant.rest(base, posture, p), base, p).full().ravel()
    return flexopt.inverse_kinematics(machine, target)


def evaluated(**options: Any) -> Callable[[Any], Any]:
    return lambda machine: flexopt.evaluate(machine, posture_of(machine), **options).to_dict()


def found(machine: Any, gravity: bool) -> Any:
    return flexopt.outcome(machine, posture_of(machine), gravity=gravity).to_dict()


def run(machine: Any) -> Any:
    result = flexopt.simulate(machine, posture_of(machine), duration=0.2)
    return [result.q.tolist(), result.end_point.tolist()]


CALLS: dict[str, Callable[[Any], Any]] = {
    "plant": plant_numbers,
    "inverse kinematics": reached,
    "evaluate": evaluated(),
    "evaluate with gravity": evaluated(gravity=True, control="transpose"),
    "evaluate damped": evaluated(control="damped:0.1"),
    "check": lambda machine: str(flexopt.check(machine)),
    "outcome": lambda machine: found(machine, False),
}
LONG_CALLS: dict[str, Callable[[Any], Any]] = {
    "outcome with gravity": lambda machine: found(machine, True),
    "simulate": run,
    "map": lambda machine: flexopt.map_joints(machine, points=(5, 5)).dataset.to_dict(),
}


def result_of(call: Callable[[Any], Any], machine: Any) -> str:
    try:
        return repr(call(machine))
    except flexopt.FlexoptError as error:
        return f"{type(error).__name__}: {error}"


def compare(kind: str | int, calls: dict[str, Callable[[Any], Any]]) -> None:
    """Results of interleaved calls, and of each call with nothing kept, bit for bit."""
    machine = of_kind(kind)
    machines = [machine, *(with_other_numbers(machine, seed) for seed in (1, 2))]
    kept.forget_all()
    together = [[result_of(call, each) for each in machines] for call in calls.values()]
    assert len({each.symbolic for each in machines}) == 1
    for name, call, results in zip(calls, calls.values(), together, strict=True):
        for each, result in zip(machines, results, strict=True):
            kept.forget_all()
            assert result == result_of(call, each), f"{name} of {each.name}"


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", ["excavator", *RANDOM[::2]])
def test_interleaved_calls_give_what_each_gives_alone(kind: str | int) -> None:
    compare(kind, CALLS)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", [*SHIPPED, *RANDOM])
def test_more_interleaved_calls_give_what_each_gives_alone(kind: str | int) -> None:
    compare(kind, CALLS | LONG_CALLS)


def changed(*keys: str | int, value: Any) -> Callable[[Data], None]:
    def change(data: Data) -> None:
        inside: Any = data
        for key in keys[:-1]:
            inside = inside[key]
        inside[keys[-1]] = value

    return change


def swap(joint: Data) -> None:
    joint["kind"] = "slide" if joint["kind"] == "hinge" else "hinge"


def elastic(data: Data) -> None:
    cylinders = [each for each in data["cylinders"] if each["joint"] != data["links"][-1]["name"]]
    link = {key: value for key, value in data["links"][-1].items() if key not in ("limits", "effort", "speed")}
    data |= {"cylinders": cylinders, "links": [*data["links"][:-1], link | SPRING]}


SPRING = {"passive": True, "stiffness": 1e6, "damping": 10.0}
DETAILS = {
    "axis": (101, changed("bodies", 0, "joint", "axis", value=[0.0, 0.6, 0.8])),
    "kind of joint": (101, lambda data: swap(data["bodies"][0]["joint"])),
    "rotation": (101, changed("bodies", 1, "rotation", value=[0.1, 0.2, 0.3])),
    "parent": (102, changed("bodies", -1, "parent", value="b0")),
    "name of a joint": (101, changed("bodies", 0, "joint", "name", value="other")),
    "rotor": ("mobile-manipulator", changed("bodies", -1, "joint", "armature", value=0.0)),
    "rigid direction": ("excavator", lambda data: [data["base"][key].pop("x") for key in ("stiffness", "damping")]),
    "elastic joint": ("boom-stick-bucket", elastic),
    "limits": ("excavator", changed("links", 0, "limits", value=[-1.0, 1.0])),
    "pin of a cylinder": ("boom-stick-bucket", changed("cylinders", 0, "base_point", value=[1.1, -0.3])),
    "volume": ("slewing-excavator", changed("capsules", 0, "radius", value=0.111)),
}


@pytest.mark.parametrize("detail", DETAILS)
def test_machines_that_differ_in_a_detail_share_nothing(detail: str) -> None:
    kind, change = DETAILS[detail]
    machine = of_kind(kind)
    data = machine.to_dict()
    change(data)
    other = built(data)
    assert machine.symbolic != other.symbolic
    one, two = (flexopt.build_plant(each) for each in (machine, other))
    assert one.graph is not two.graph
    results = [result_of(plant_numbers, each) for each in (machine, other)]
    for each, result in zip((machine, other), results, strict=True):
        kept.forget_all()
        assert result_of(plant_numbers, each) == result


def test_symbolic_machines_have_no_values() -> None:
    for kind in (*SHIPPED, *RANDOM):
        machine = of_kind(kind)
        pins = {name for cylinder in machine.cylinders for name in cylinder.numbers()}
        told = {p.name for p in machine.symbolic.parameters if not np.isnan(p.value)}
        assert told == pins
        assert machine.symbolic.symbolic is machine.symbolic


@pytest.mark.filterwarnings("ignore")
def test_few_structures_are_kept() -> None:
    """Nothing but the records holds graphs: those of an evicted structure are freed, without collection of cycles."""
    kept.forget_all()
    gc.collect()
    gc.disable()
    try:
        graphs = []
        for seed in range(kept.RECORDS + 4):
            machine = random_machine(np.random.default_rng(seed))[1]
            result_of(evaluated(), machine)
            graphs.append(weakref.ref(flexopt.build_plant(machine).graph))
        alive = {id(graph()) for graph in graphs if graph() is not None}
    finally:
        gc.enable()
    assert 1 <= len(alive) <= kept.RECORDS


@pytest.mark.filterwarnings("ignore")
def test_other_masses_build_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    machine = flexopt.load("excavator")
    flexopt.evaluate(machine, posture_of(machine), gravity=True)
    from flexopt.plant import plant as plants  # noqa: PLC0415

    monkeypatch.setattr(plants, "build_graph", lambda *_: pytest.fail("a graph was built again"))
    for seed in (1, 2):
        other = with_other_numbers(machine, seed)
        flexopt.evaluate(other, posture_of(other), gravity=True)
