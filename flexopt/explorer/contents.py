"""What a page is told of a machine besides its graphs: names, units, limits, numbers of its loop, configurations.

In: a machine, its loop's numbers, the configurations to show. Out: plain data, as JSON takes them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from flexopt.explorer.graphs import moving_placement
from flexopt.explorer.meshes import Meshes
from flexopt.foundation.arrays import Vector
from flexopt.foundation.control import control_damping
from flexopt.foundation.rounding import ROUNDING
from flexopt.loop.loop_motions import STRAINS
from flexopt.loop.settings import LoopSettings
from flexopt.loop.small_motions import DEAD_TIME
from flexopt.loop.spectrum import INVARIANT, OWN, neutral_directions
from flexopt.model import AnyMachine
from flexopt.model.loop import DELAY_MAX
from flexopt.model.simulation import PART_OF_SAMPLE
from flexopt.model.uncertainty import SPRINGS, Uncertainty, parameters_of
from flexopt.plant import build_plant
from flexopt.plant.plant import STATIC_ITERATIONS
from flexopt.robustness.evaluation import UNREACHED
from flexopt.robustness.measures import SOLVE_TOLERANCE
from flexopt.robustness.modes import CLUSTER_TOLERANCE
from flexopt.robustness.residues import residue_unit

# A joint without limits is shown over a whole turn or this way, m, about zero.
TURN, SLIDE = math.pi, 1.0
# Of the mass of all bodies: the heaviest payload on the slider. Longest dead time on the slider, s.
PAYLOAD_SHARE, DEAD_TIME_MAX = 0.1, 0.2
PAYLOAD = "payload.mass"


def contents(
    machine: AnyMachine,
    settings: LoopSettings,
    functions: Mapping[str, ca.Function],
    configurations: Mapping[str, tuple[Vector, Vector]],
    meshes: Meshes,
    *,
    gravity: bool,
    uncertainty: Sequence[Uncertainty],
) -> dict[str, Any]:
    """All that the page is told.

    Args:
        machine: which.
        settings: numbers of its loop.
        functions: what the page computes with.
        configurations: named (base, posture)s, the first of which is shown at first.
        meshes: of its bodies.
        gravity: whether under the weight.
        uncertainty: what is known between two numbers only.
    """
    plant = build_plant(machine)
    names = [parameter.name for parameter in machine.parameters]
    values = [parameter.value for parameter in machine.parameters]
    payload = names.index(PAYLOAD) if PAYLOAD in names else None
    shown = {
        name: {"base": base.tolist(), "posture": posture.tolist()} for name, (base, posture) in configurations.items()
    }
    return {
        "name": machine.name,
        "description": machine.description,
        "coordinates": list(plant.coordinates),
        "joints": list(machine.joints),
        "joint_units": list(machine.joint_units),
        "unreached": UNREACHED,
        "rounding": ROUNDING,
        "limits": [[x if math.isfinite(x) else None for x in pair] for pair in machine.limits],
        "ranges": [_range(pair, unit) for pair, unit in zip(machine.limits, machine.joint_units, strict=True)],
        "placement": list(machine.base_coordinates),
        "placement_units": list(machine.base_units),
        "moving": moving_placement(functions),
        "rows": list(machine.task_rows),
        "n_passive": plant.n_passive,
        "n_task": plant.n_task,
        "dimensions": functions["skeleton"].size1_out(0),
        "segments": [list(pair) for pair in plant.graph.segments],
        "frames": list(plant.frames.names) if "frames" in functions else [],
        "capsules": [
            {"body": plant.frames.names.index(c.body), "start": list(c.start), "end": list(c.end), "radius": c.radius}
            for c in machine.capsules
        ],
        "meshes": meshes.layout(plant.frames.names),
        "meshes_note": meshes.told,
        "weight": {"steps": STATIC_ITERATIONS, "tolerance": SOLVE_TOLERANCE} if gravity else None,
        "support": [list(point) for point in machine.support_points],
        "size": size_of(machine, *next(iter(configurations.values()))),
        "parameters": values,
        "springs": list(parameters_of((SPRINGS,), machine)),
        "payload": payload,
        "payload_max": None if payload is None else _payload_max(machine, values[payload], uncertainty),
        "control": settings.control,
        "damped": control_damping(settings.control) is not None,
        "unit": residue_unit(settings.control, machine.joint_units),
        "cluster_tolerance": CLUSTER_TOLERANCE,
        "configurations": shown,
        "loop": _loop(machine, settings, gravity=gravity),
    }


def _range(limits: tuple[float, float], unit: str) -> list[float]:
    whole = TURN if unit == "rad" else SLIDE
    return [limit if math.isfinite(limit) else end for limit, end in zip(limits, (-whole, whole), strict=True)]


def size_of(machine: AnyMachine, base: Vector, posture: Vector) -> float:
    """Length of all segments, m."""
    plant = build_plant(machine)
    p = plant.parameter_values
    points = plant.skeleton.call([plant.rest(base, posture, p), base, p])[0].full()
    return float(sum(np.linalg.norm(points[:, j] - points[:, i]) for i, j in plant.graph.segments))


def _payload_max(machine: AnyMachine, present: float, uncertainty: Sequence[Uncertainty]) -> float:
    """A round number of kg above the present payload, and not below the heaviest that may be carried."""
    total = sum(parameter.value for parameter in machine.parameters if parameter.unit == "kg")
    known = [
        each for each in uncertainty if PAYLOAD in {machine.parameters[k].name for k in parameters_of(each.of, machine)}
    ]
    own = max([each.value[1] for each in known if each.value], default=present)
    heaviest = own * math.prod(each.factor[1] for each in known if each.factor)
    wanted = max(2 * present, PAYLOAD_SHARE * total, heaviest)
    step = 10.0 ** math.floor(math.log10(wanted))
    return math.ceil(wanted / step) * step


def _loop(machine: AnyMachine, settings: LoopSettings, *, gravity: bool) -> dict[str, Any]:
    motions, plant, numbers = settings.motions(machine, gravity=gravity), build_plant(machine), settings.numbers
    period = 1 / settings.rate
    return {
        "description": repr(settings).splitlines()[0],
        "sources": dict(settings.sources),
        "drive": settings.drive,
        "numbers": {name: value.tolist() for name, value in numbers.items() if name != "period"},
        "units": dict(zip(("kp", "kv", "ki"), settings.gain_units, strict=True)),
        "period": period,
        DEAD_TIME: settings.dead_time,
        "dead_time_max": max(min(DEAD_TIME_MAX, DELAY_MAX * period), settings.dead_time),
        "part_of_sample": PART_OF_SAMPLE,
        "invariant": INVARIANT,
        "own": OWN,
        "strains": STRAINS,
        "neutral": neutral_directions(motions.structure, plant.n_actuated, settings.kp, settings.ki),
        "excess": plant.n_actuated - plant.n_task,
        "to_q": motions.loop.to_q.ravel(order="F").tolist(),
        # What velocity servos add to the parameters: κ counts their damping as the joints' own.
        "braking": (motions.drive_damping * settings.servo_gain).tolist() if settings.servo_gain else None,
    }
