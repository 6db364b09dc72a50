"""What stays above a ground that nobody asked for: see `flexopt.selection.assumed`.

Of every body that actuated joints raise and lower, but the end-point's and those that it carries: its capsules, as of
`clearance`, or where it has none the joints that it carries, a row each: height above the ground, m.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from flexopt.foundation.kept import by_machine
from flexopt.model import AnyMachine, Capsule
from flexopt.model.constraints import Constraints
from flexopt.plant import Plant, build_plant
from flexopt.selection.constraints import clearance
from flexopt.selection.constraints.kind import ConstraintKind, Group, ScaledConstraint, Scene

NAME = "the assumed ground"
# What differs by less than this in height, m, over so many postures, no joint raises.
STILL, SEEN = 1e-9, 4


def _no_groups(_: Plant, __: Constraints) -> list[Group]:
    """It is asked for by nobody."""
    return []


def ground_groups(plant: Plant, height: float) -> list[Group]:
    """The rows, for a ground at this height, m."""
    capsules, carried = _above(plant.machine)
    groups = [clearance.group(plant.machine.capsules, "ground", list(capsules), (height,), NAME, 0.0)]
    labels = [f"height of the joint {joint} above {NAME}" for joint in _joints(plant, carried)]
    groups.append(Group("ground", carried, (height,), tuple(ScaledConstraint(x, "m", 0.0, math.inf) for x in labels)))
    return [group for group in groups if group.rows]


def kept_above(plant: Plant) -> str:
    """What `ground_groups` has rows of, and that it stays above; empty where there is nothing."""
    capsules, carried = _above(plant.machine)
    bodies = list(dict.fromkeys(plant.machine.capsules[k].called for k in capsules))
    joints = [f"the joint{'s' * (len(carried) > 1)} {', '.join(_joints(plant, carried))}"] if carried else []
    verb = "stays" if len(bodies) + len(carried) == 1 else "stay"
    return f"{', '.join([*bodies, *joints])} {verb} above" if bodies or joints else ""


def _joints(plant: Plant, carried: Sequence[str]) -> list[str]:
    """Of these bodies, by name: a slide's joint is rarely called as what slides."""
    named = {body.name: body.joint.name for body in plant.machine.kinematic_tree.bodies}
    return [named[body] for body in carried]


def standing_height(machine: AnyMachine) -> float:
    """Height of the ground that a machine stands on, m: 0, that of the anchor frame, with a support or nothing lower.

    Without a support it is as low as the capsules of bodies that no actuated joint moves, the machine at rest.
    """
    return 0.0 if machine.support_points else min([0.0, *(height for _, height in lowest(machine))])


@by_machine
def lowest(machine: AnyMachine) -> tuple[tuple[Capsule, float], ...]:
    """Capsules of bodies that no actuated joint moves, and how low each reaches, m, the machine at rest."""
    plant = build_plant(machine)
    still = [capsule for capsule in machine.capsules if not clearance.is_moved(plant, capsule.body)]
    if not still:
        return ()
    g, base = plant.graph, np.zeros(plant.n_base)
    scene = Scene(plant, g.base, g.posture, g.p)
    ends = [ca.fmin(*(scene.point(c.body, at)[-1] for at in (c.start, c.end))) - c.radius for c in still]
    heights = ca.Function("lowest", [g.base, g.posture, g.p], [ca.vertcat(*ends)])
    found = heights(base, np.zeros(plant.n_actuated), plant.parameter_values).full().ravel()
    return tuple(zip(still, found.tolist(), strict=True))


@by_machine
def _above(machine: AnyMachine) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """Capsules (their numbers) and bodies (their joints) whose height some actuated joint changes."""
    plant, tree = build_plant(machine), machine.kinematic_tree
    parents = {body.name: body.parent for body in tree.bodies}
    working, end = set[str | None](), tree.end_point.body
    for name, parent in parents.items():  # each after its parent
        if name == end or parent in working:
            working.add(name)
    g = plant.graph
    scene = Scene(plant, g.base, g.posture, g.p)
    postures = np.random.default_rng(0).uniform(-1, 1, (plant.n_actuated, SEEN))

    def raised(body: str, at: tuple[float, ...]) -> bool:
        height = ca.Function("height", [g.base, g.posture, g.p], [scene.point(body, at)[-1]])
        seen = height.call([np.zeros(plant.n_base), postures, plant.parameter_values])[0].full()
        return bool(np.ptp(seen) > STILL)

    filled = {capsule.body for capsule in machine.capsules}
    capsules = tuple(
        k
        for k, capsule in enumerate(machine.capsules)
        if capsule.body not in working and (raised(capsule.body, capsule.start) or raised(capsule.body, capsule.end))
    )
    origin = (0.0,) * scene.dimension
    carried = tuple(
        name
        for name in plant.frames.names
        if (carrier := parents[name]) is not None and carrier not in filled | working and raised(name, origin)
    )
    return capsules, carried


def _graph(scene: Scene, shape: Any, c: ca.SX) -> list[ca.SX]:
    return [scene.point(body, (0.0,) * scene.dimension)[-1] - c[0] for body in shape]


KIND = ConstraintKind(_no_groups, _graph)
