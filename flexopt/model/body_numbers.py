"""Lengths, masses, inertias and drives of a machine's bodies, one layout for whatever file it came from.

In: a validated machine. Out: its `BodyNumbers`, which `plausibility.py` compares with each other.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from flexopt.foundation.arrays import Array
from flexopt.model.kinematic_tree import TreeBody
from flexopt.model.machine import AnyMachine
from flexopt.model.planar import Machine
from flexopt.model.tree import Tree
from flexopt.model.tree_quantities import symmetric

# Share of a principal moment that comes of rounding.
ALIKE = 1e-9
# Share of the weight that pushes sideways, where a joint does not hold it.
ASIDE = 0.1
# Of x, y, z, in a tree file.
UP = 2


@dataclass
class BodyNumbers:
    """One body as the checks see it; joints and springs of the body that it moves with. SI.

    Attributes:
        where: its field and name.
        length: to the farthest joint or the end-point that it carries; 0 where it carries none.
        size: the farthest that anything is known to be from its joint;  extent: of its capsules from end to end.
        com: distance of its centre of mass;  along: the same along `length`;  aside: across it.
        variance: ∫ x² dm / m of its mass about its centre, along `length` (in the plane all of it);  across: the
            largest across it (0 in the plane).
        path: from its parent's joint to its own at most.
        link: whether it is a link between joints, whose mass lies along it.
        moments: principal ones of its inertia; in the plane the one;  about_centre: the largest that it has about its
            centre if the given ones are about its joint, NaN where no body has such ones.
        hinge: whether its joint turns;  bears: share of the weight that its joint holds, at least `ASIDE`, that of a
            slide that is level and of a hinge that stands upright;  springs: of each whether it turns, its stiffness,
            and that share of it;  effort, speed: of the drive (infinite: none);  limits: of the joint;  rest: its rest
            value;  joint: the joint's field and name;  driven: its name, where an actuator moves it;  end: whether
            `length` is that to the end-point of a tree.
    """

    where: str
    length: float
    size: float
    com: float
    along: float
    aside: float
    mass: float
    inertia: float
    variance: float
    across: float
    path: float
    link: bool
    extent: float = 0.0
    moments: tuple[float, ...] = ()
    about_centre: float = 0.0
    hinge: bool = True
    bears: float = 1.0
    springs: dict[str, tuple[bool, float, float]] = field(default_factory=dict[str, tuple[bool, float, float]])
    effort: float = math.inf
    speed: float = math.inf
    limits: tuple[float, float] | None = None
    rest: tuple[str, float] | None = None
    joint: str = ""
    driven: str = ""
    end: bool = False
    children: list[BodyNumbers] = field(default_factory=list["BodyNumbers"])

    @property
    def reached(self) -> str:
        """What `length` is called."""
        return f"end-point from the joint of {self.where}" if self.end else f"{self.where}.length"

    def outward(self, start: float = 0.0) -> Iterator[tuple[BodyNumbers, float]]:
        """This body and those it carries, with the farthest that each one's joint can be from this one's."""
        waiting = [(self, start)]
        while waiting:
            part, path = waiting.pop()
            yield part, path
            waiting += [(child, path + child.path) for child in part.children]

    @property
    def same(self) -> tuple[str, ...]:
        """Mass and principal moments, but for rounding: what bodies have in common whose numbers were copied."""
        least = 1e-9 * self.inertia
        return tuple(f"{x:.8g}" if abs(x) > least else "0" for x in (self.mass, *self.moments))

    @property
    def weight(self) -> tuple[float, float]:
        """Mass carried, kg, and its largest first moment about the joint, kg m."""
        carried = [(part.mass, part.mass * (path + part.com)) for part, path in self.outward()]
        return sum(mass for mass, _ in carried), sum(moment for _, moment in carried)


def body_numbers(machine: AnyMachine) -> tuple[list[BodyNumbers], float]:
    """The bodies from the base outwards, and how far the end-point can be, m."""
    if isinstance(machine, Machine):
        return _planar(machine)
    assert isinstance(machine, Tree)
    return _spatial(machine)


def _planar(machine: Machine) -> tuple[list[BodyNumbers], float]:
    """Bodies of a planar machine from the base outwards, and how far the end-point can be from the ground point."""
    base = machine.base
    springs = {
        f"base.stiffness.{d}": (d == "rotation", float(getattr(base.stiffness, d)), ASIDE if d == "x" else 1.0)
        for d in machine.free_base_directions
    }
    part = BodyNumbers(
        where="base", length=base.length, size=_capsules(machine, "base"), com=math.hypot(base.com, base.com_offset),
        along=base.com, aside=base.com_offset, mass=base.mass, inertia=base.inertia,
        variance=base.inertia / base.mass, across=0.0, path=0.0, link=False, springs=springs,
        rest=("base.rest_angle", base.rest_angle), joint="base", moments=(base.inertia,),
    )  # fmt: skip
    parts = [part]
    for index, link in enumerate(machine.links):
        where = f"links[{index}] ({link.name})"
        inner = BodyNumbers(
            where=where, length=link.length, size=_capsules(machine, link.name), extent=_extent(machine, link.name),
            com=math.hypot(link.com, link.com_offset), along=link.com, aside=link.com_offset, mass=link.mass,
            inertia=link.inertia, variance=link.inertia / link.mass, across=0.0, path=parts[-1].length, link=True,
            springs={f"{where}.stiffness": (True, link.stiffness, 1.0)} if link.passive and link.stiffness else {},
            effort=link.effort or math.inf, speed=link.speed or math.inf, limits=link.limits,
            rest=(f"{where}.rest", link.rest) if link.passive else None, joint=where, moments=(link.inertia,),
            driven="" if link.passive else link.name,
            about_centre=link.inertia - link.mass * (link.com**2 + link.com_offset**2),
        )  # fmt: skip
        parts[-1].children.append(inner)
        parts.append(inner)
    _load(parts[-1], machine.payload.mass, parts[-1].length)
    return parts, sum(part.length for part in parts)


def _load(part: BodyNumbers, mass: float, distance: float) -> None:
    """Hang the payload on the end-point's body."""
    if mass:
        load = BodyNumbers(
            where="payload", length=0.0, size=0.0, com=0.0, along=0.0, aside=0.0, mass=mass, inertia=0.0, variance=0.0,
            across=0.0, path=distance, link=False,
        )  # fmt: skip
        part.children.append(load)


def _capsules(machine: AnyMachine, body: str) -> float:
    """How far the body's capsules reach from its joint."""
    ends = [(end, c.radius) for c in machine.capsules if c.body == body for end in (c.start, c.end)]
    return max((math.hypot(*end) + radius for end, radius in ends), default=0.0)


def _extent(machine: AnyMachine, body: str) -> float:
    """How far the body's capsules reach from end to end."""
    ends = [(end, c.radius) for c in machine.capsules if c.body == body for end in (c.start, c.end)]
    return max((math.dist(a, b) + ra + rb for a, ra in ends for b, rb in ends), default=0.0)


def _spatial(machine: Tree) -> tuple[list[BodyNumbers], float]:
    """Bodies of a spatial machine, and how far the end-point can be from the first body that has mass."""
    children: dict[str, list[TreeBody]] = {body.name: [] for body in machine.bodies}
    for body in machine.bodies:
        if body.parent is not None:
            children[body.parent].append(body)
    coupled = machine.stiffness_matrix
    stiff = {} if coupled is None else {n: coupled.matrix[k][k] for k, n in enumerate(coupled.joints)}
    parts, bears = dict[str, BodyNumbers](), _borne(machine)
    actuated: set[str] = set()
    for body in machine.bodies:
        carried = [_farthest(child) for child in children[body.name]]
        carried += [np.array(machine.end_point.position)] if machine.end_point.body == body.name else []
        part = _body(machine, body, carried, stiff.get(body.joint.name, body.joint.stiffness), bears[body.name])
        moved = body.parent in actuated
        if not body.joint.passive or moved:
            actuated.add(body.name)
        # An arm's links are those on driven joints and beyond.
        part.link = body.name in actuated
        parts[body.name] = part
        if body.parent is not None:
            parts[body.parent].children.append(part)
    end = parts[machine.end_point.body]
    _load(end, machine.payload.mass, float(np.linalg.norm(machine.end_point.position)))
    reach, name = float(np.linalg.norm(machine.end_point.position)), machine.end_point.body
    above = {body.name: body.parent for body in machine.bodies}
    while above[name] is not None:
        reach += parts[name].path
        name = str(above[name])
    return list(parts.values()), max(reach, 1e-3, *(part.com for part in parts.values()))


def _farthest(child: TreeBody) -> Array:
    """Where its joint has it at most, in the parent's frame."""
    place, joint = np.array(child.position), child.joint
    if joint.kind == "hinge" or joint.limits is None:
        return place
    axis = np.array(child.rotation) @ np.array(joint.axis)
    return max((place + end * axis for end in joint.limits), key=lambda point: float(np.linalg.norm(point)))


def _borne(machine: Tree) -> dict[str, float]:
    """The share of the weight that each body's joint holds; 1 where the drives before it can tilt its axis."""
    rotations, level, shares = dict[str, Array](), dict[str, bool](), dict[str, float]()
    for body in machine.bodies:
        joint, before = body.joint, body.parent
        rotations[body.name] = (np.eye(3) if before is None else rotations[before]) @ np.array(body.rotation)
        axis = rotations[body.name] @ np.array(joint.axis)
        upright = min(abs(float(axis[UP])) / float(np.linalg.norm(axis)), 1.0)
        turns, stays = joint.kind == "hinge", before is None or level[before]
        shares[body.name] = max(math.sqrt(1 - upright**2) if turns else upright, ASIDE) if stays else 1.0
        level[body.name] = stays and (joint.passive or not turns or shares[body.name] == ASIDE)
        if joint.passive and turns and joint.rest:
            rotations[body.name] = _about(axis, joint.rest) @ rotations[body.name]
    return shares


def _about(axis: Array, angle: float) -> Array:
    """A turn about an axis through the origin, (3, 3) (Rodrigues)."""
    across = np.cross(np.eye(3), axis / np.linalg.norm(axis))
    turned: Array = np.eye(3) + math.sin(angle) * across + (1 - math.cos(angle)) * across @ across
    return turned


def _body(
    machine: Tree, body: TreeBody, carried: Sequence[Array], stiffness: float | None, bears: float
) -> BodyNumbers:
    far = max(carried, key=lambda point: float(np.linalg.norm(point)), default=np.zeros(3))
    com, length = np.array(body.com), float(np.linalg.norm(far))
    tensor = symmetric(*body.inertia)
    moments = np.linalg.eigvalsh(tensor)
    # Second moments of the mass about its centre, per kg: tr(I)/2 · 1 − I.
    spread = (np.trace(tensor) / 2 * np.eye(3) - tensor) / body.mass if body.mass else np.zeros((3, 3))
    along: Array = far / length if length > 0 else np.linalg.eigh(spread)[1][:, -1]
    aside = com - (com @ along) * along
    projector = np.eye(3) - np.outer(along, along)
    shifted = tensor - body.mass * (com @ com * np.eye(3) - np.outer(com, com))
    joint = body.joint
    hinge = joint.kind == "hinge"
    travel = 0.0 if hinge or joint.limits is None else max(map(abs, joint.limits))
    where, moved = f"body {body.name!r}", f"joint {joint.name!r}"
    return BodyNumbers(
        where=where, length=length, size=_capsules(machine, body.name), extent=_extent(machine, body.name),
        com=float(np.linalg.norm(com)), along=float(com @ along), aside=float(np.linalg.norm(aside)), mass=body.mass,
        about_centre=_largest(*np.linalg.eigvalsh(shifted).tolist()),
        inertia=float(moments[-1]), moments=tuple(moments.tolist()), variance=max(float(along @ spread @ along), 0.0),
        across=max(float(np.linalg.eigvalsh(projector @ spread @ projector)[-1]), 0.0),
        path=float(np.linalg.norm(body.position)) + travel, link=False, hinge=hinge,
        bears=bears, springs={f"{moved}.stiffness": (hinge, stiffness, bears)} if joint.passive and stiffness else {},
        effort=joint.effort or math.inf, speed=joint.speed or math.inf, limits=joint.limits,
        rest=(f"{moved}.rest", joint.rest) if joint.passive and hinge else None, joint=moved,
        driven="" if joint.passive else joint.name,
        end=machine.end_point.body == body.name and np.array_equal(far, machine.end_point.position),
    )  # fmt: skip


def _largest(least: float, middle: float, most: float) -> float:
    """Of principal moments in order; NaN where they are none of a body: one is negative, or above the others' sum."""
    return most if least >= 0 and least + middle >= most * (1 - ALIKE) else math.nan
