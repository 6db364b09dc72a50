"""Random machines in the layout of a machine file: the same recipe as a Hypothesis strategy and as a seeded generator."""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np
from hypothesis import strategies as st

from flexopt.model import Machine, machine_from_dict

MachineDict = dict[str, Any]
DIRECTIONS = ("x", "y", "rotation")


class Source(Protocol):
    """Where the random numbers come from."""

    def uniform(self, low: float, high: float) -> float: ...

    def integer(self, low: int, high: int) -> int: ...


class NumpySource:
    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng

    def uniform(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high))

    def integer(self, low: int, high: int) -> int:
        return int(self.rng.integers(low, high + 1))


class HypothesisSource:
    def __init__(self, draw: Any) -> None:
        self.draw = draw

    def uniform(self, low: float, high: float) -> float:
        return self.draw(st.floats(low, high, allow_subnormal=False))

    def integer(self, low: int, high: int) -> int:
        return self.draw(st.integers(low, high))


class Structure(tuple[int, tuple[str, ...], tuple[int, ...]]):
    """What decides the machine's coordinates: number of links, directions in which the base gives, passive links."""

    __slots__ = ()

    def __new__(cls, n: int, free: tuple[str, ...], passive: tuple[int, ...]) -> Structure:
        return super().__new__(cls, (n, free, passive))

    @property
    def n_passive(self) -> int:
        return len(self[1]) + len(self[2])


def draw_structure(
    source: Source, *, n_min: int = 2, n_max: int = 5, m_max: int = 5, passive_joints: bool = True
) -> Structure:
    """At least one passive coordinate, at least two actuated joints."""
    n = source.integer(n_min, n_max)
    most = min(n - 2, 2) if passive_joints else 0
    wanted = source.integer(0, 1) * source.integer(0, most)
    free: tuple[str, ...] = ()
    code = source.integer(0 if wanted else 1, 7)
    free = tuple(d for bit, d in enumerate(DIRECTIONS) if code >> bit & 1)
    rest = list(range(n))
    passive = tuple(sorted(rest.pop(source.integer(0, len(rest) - 1)) for _ in range(wanted)))
    while len(free) + len(passive) > m_max:
        free, passive = (free[1:], passive) if free else (free, passive[1:])
    return Structure(n, free, passive)


def draw_machine(
    source: Source,
    structure: Structure,
    *,
    spread: float = 1e4,
    damping_ratio: float = 0.05,
    joint_damping: bool = True,
    equal_xy: bool = False,
    frequency: tuple[float, float] = (0.5, 3.0),
) -> MachineDict:
    """A machine of that structure.

    `spread` bounds the ratio of the largest to the smallest stiffness, rotational ones divided by the square of the
    machine's size so that they compare with N/m. `frequency` (Hz) is that of the whole mass on the softest spring.
    """
    n, free, passive = structure
    scale = 10 ** source.uniform(0, 3)
    links: list[dict[str, Any]] = []
    # Lengths that may be zero are rounded: MuJoCo takes frames closer than 1e-6 m for one.
    for index in range(n):
        length, mass = source.uniform(0.3, 2.0), scale * source.uniform(0.3, 3.0)
        links.append(
            {
                "name": f"joint{index + 1}",
                "length": length,
                "com": round(length * source.uniform(-0.2, 1.3), 4),
                "com_offset": round(length * source.uniform(-0.3, 0.3) * source.integer(0, 1), 4),
                "mass": mass,
                "inertia": mass * length**2 * source.uniform(0.03, 0.3),
            }
        )
    base_length, base_mass = round(source.uniform(0.0, 1.5), 4), scale * source.uniform(0.5, 10.0)
    size = base_length + sum(link["length"] for link in links)
    total = base_mass + sum(link["mass"] for link in links)
    reference = total * (2 * math.pi * source.uniform(*frequency)) ** 2

    def spring() -> float:
        return reference * spread ** source.uniform(0.0, 1.0)

    def damper(stiffness: float, mass: float) -> float:
        return damping_ratio * source.uniform(0.0, 1.0) * 2 * math.sqrt(stiffness * mass)

    base: dict[str, Any] = {
        "length": base_length,
        "com": round(source.uniform(-0.5, 1.5), 4),
        "com_offset": round(source.uniform(-0.4, 0.4), 4),
        "mass": base_mass,
        "inertia": base_mass * source.uniform(0.05, 1.0),
        "rest_angle": source.uniform(-3.0, 3.0),
        "stiffness": {d: spring() * (size**2 if d == "rotation" else 1.0) for d in free},
    }
    if equal_xy and "x" in free and "y" in free:
        base["stiffness"]["y"] = base["stiffness"]["x"]
    base["damping"] = {
        d: damper(k, total * (size**2 if d == "rotation" else 1.0)) for d, k in base["stiffness"].items()
    }
    for index, link in enumerate(links):
        if index in passive:
            stiffness = spring() * size**2
            link |= {
                "passive": True,
                "stiffness": stiffness,
                "damping": damper(stiffness, total * size**2),
                "rest": source.uniform(-1.5, 1.5),
            }
        elif joint_damping:
            link["joint_damping"] = source.uniform(0.0, 1.0) * scale * source.integer(0, 1)
    return {
        "name": f"random-{n}-{'-'.join(free)}-{'-'.join(map(str, passive))}",
        "gravity": source.uniform(1.0, 12.0),
        "base": base,
        "links": links,
        "payload": {"mass": scale * source.uniform(0.0, 1.0) * source.integer(0, 1)},
    }


def random_machine(
    rng: np.random.Generator, structure: Structure | None = None, **options: Any
) -> tuple[MachineDict, Machine]:
    """The dictionary and the machine built from it."""
    source = NumpySource(rng)
    data = draw_machine(source, structure or draw_structure(source), **options)
    return data, machine_from_dict(data)


def heavier(data: dict[str, Any], factor: float) -> Machine:
    """A machine whose masses, inertias, springs and dampers are all so many times those of the data."""
    base, links = dict(data["base"]), [dict(link) for link in data["links"]]
    for body in (base, *links):
        body |= {name: factor * body[name] for name in ("mass", "inertia")}
    for name in ("stiffness", "damping"):
        base[name] = {way: factor * value for way, value in base[name].items()}
    return machine_from_dict(data | {"base": base, "links": links})


@st.composite
def machines(draw: Any, structure: dict[str, Any] | None = None, **options: Any) -> tuple[MachineDict, Machine]:
    """Strategy for the same: `structure` holds options of `draw_structure`, the rest goes to `draw_machine`."""
    source = HypothesisSource(draw)
    data = draw_machine(source, draw_structure(source, **(structure or {})), **options)
    return data, machine_from_dict(data)


seeds = st.integers(0, 2**32 - 1)


def random_posture(rng: np.random.Generator, machine: Machine) -> np.ndarray:
    return rng.uniform(-math.pi, math.pi, len(machine.joints))


def regular_posture(rng: np.random.Generator, machine: Machine, condition: float = 30.0) -> np.ndarray:
    """A random posture with cond Jv below `condition`, passive joints at rest: the best of 300 where none is."""
    postures = [random_posture(rng, machine)]
    while condition_at_rest(machine, postures[-1]) >= condition:
        postures.append(random_posture(rng, machine))
        if len(postures) == 300:
            # One very short segment beside long ones keeps every posture above the bound.
            return min(postures, key=lambda posture: condition_at_rest(machine, posture))
    return postures[-1]


def arm_at_rest(machine: Machine, posture: np.ndarray, base: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Actuated joints (n, 2) and end-point (2,), passive coordinates at rest, from the geometry alone."""
    angle, command = machine.base.rest_angle, iter(posture)
    tip = np.array([base, 0.0]) + machine.base.length * np.array([math.cos(angle), math.sin(angle)])
    joints = []
    for link in machine.links:
        angle += link.rest if link.passive else float(next(command))
        if not link.passive:
            joints.append(tip)
        tip = tip + link.length * np.array([math.cos(angle), math.sin(angle)])
    return np.array(joints), tip


def condition_at_rest(machine: Machine, posture: np.ndarray) -> float:
    """cond Jv: column i of Jv is the vector from joint i to the end-point, turned by 90°."""
    joints, tip = arm_at_rest(machine, posture)
    return float(np.linalg.cond(tip - joints))


def segment_lengths(machine: Machine) -> np.ndarray:
    """Distances between actuated joints, and from the last one to the end-point."""
    joints, tip = arm_at_rest(machine, np.zeros(len(machine.joints)))
    return np.linalg.norm(np.diff(np.vstack([joints, tip]), axis=0), axis=1)
