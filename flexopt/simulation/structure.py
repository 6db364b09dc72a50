"""What parts a closed loop has, and how its vectors are laid out.

In: choices. Out: `LoopStructure`, the key under which graphs and compiled code are kept, and the `Layout` of states x,
signals e and constants c.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.model.problem import Control
from flexopt.plant.motion import Motion, Structure
from flexopt.simulation.feedback import FeedbackLaw, Law

Method = Literal["rk4", "dop853", "gauss"]
METHODS: tuple[Method, ...] = ("rk4", "dop853", "gauss")
N_TASK = 2


@dataclass(frozen=True)
class LoopStructure:
    """What parts a loop has; every number is a constant and not part of it.

    Attributes:
        motion: the machine's structure.
        control: how forces at the end-point become joint torques.
        law, order: task-space feedback, and the number of states of a state-space law.
        sampled: the command is computed at the start of each sample and held; else at every stage of the integrator.
        method, substeps, iterations: integration; iterations of the implicit method.
        gravity, compensated: whether weight acts, and whether the command carries the arm's.
        delay: whole samples between measurement and command.
        quantised, noisy: of the measurement.
        limited, lagging, rate_limited, dead_band: of the actuators.
        nullspace_damped: whether a damper acts on the arm's self-motion.
        moving_base, moving_target: whether they come as signals instead of constants.
        watched: whether a step gives what is judged (see `Sample.monitor`); else it is taken from the samples.
        own_model: whether the controller has constants of its own for geometry and weight, in place of the machine's.
    """

    motion: Structure
    control: Control = "inverse"
    law: Law = "pd"
    order: int = 0
    sampled: bool = True
    method: Method = "rk4"
    substeps: int = 1
    iterations: int = 0
    gravity: bool = False
    compensated: bool = False
    delay: int = 0
    quantised: bool = False
    noisy: bool = False
    limited: bool = False
    lagging: bool = False
    rate_limited: bool = False
    dead_band: bool = False
    nullspace_damped: bool = False
    moving_base: bool = False
    moving_target: bool = False
    own_model: bool = False
    watched: bool = False


MODEL = "model_"  # prefix of a controller's own constants


class Layout:
    """Named parts of a column."""

    def __init__(self, sizes: Mapping[str, int]) -> None:
        self.sizes = dict(sizes)
        self.total = sum(self.sizes.values())
        starts = [0, *accumulate(self.sizes.values())]
        self.slices = {
            name: slice(start, start + size) for (name, size), start in zip(sizes.items(), starts, strict=False)
        }

    def split(self, column: ca.SX) -> dict[str, ca.SX]:
        """The parts of a column by name."""
        return {name: column[part] for name, part in self.slices.items()}

    def packed(self, parts: Mapping[str, Any]) -> NDArray[np.float64]:
        """One array (total, 1) or (total, N) from parts (size,) or (size, N), those for all members repeated."""
        columns = [np.asarray(parts[name], dtype=np.float64) for name in self.sizes]
        n = max((part.size // size for part, size in zip(columns, self.sizes.values(), strict=True) if size), default=1)
        result = np.empty((self.total, n))
        for part, where, size in zip(columns, self.slices.values(), self.sizes.values(), strict=True):
            result[where] = part.reshape(size, -1) if size else 0.0
        return result


def constant_sizes(structure: LoopStructure, law: FeedbackLaw) -> dict[str, int]:
    """Entries of c: the motion's constants, and those of controller, sensors and actuators."""
    s, shape = structure, Motion(structure.motion, {})
    n = len(shape.joints)
    sizes = {name: 1 for name in motion_constant_names(shape) if name not in s.motion.zeros}
    sizes |= {f"{MODEL}{name}": 1 for name in sizes if s.own_model and is_known(name)}
    sizes |= {"h": 1, "design": shape.n_translations + len(shape.hinges), "design_directions": 2 * len(shape.hinges)}
    m = shape.n_translations + len(shape.hinges)
    sizes |= {"u_design": shape.n, "modes": m * shape.n, "omega_squared": m}
    sizes["base"] = 1
    sizes |= {} if s.moving_target else {"target": N_TASK}
    sizes |= law.constants
    sizes |= {"resolution": N_TASK, "rate_resolution": N_TASK} if s.quantised else {}
    for part, name, size in (
        (s.limited, "torque_limit", n),
        (s.dead_band, "dead_band", n),
        (s.lagging, "bandwidth", n),
        (s.rate_limited, "rate_limit", n),
        (s.nullspace_damped, "nullspace_damping", 1),
    ):
        sizes |= {name: size} if part else {}
    return sizes


def is_known(name: str) -> bool:
    """Whether a controller uses this constant of the motion: for its Jacobian, or to carry the weight."""
    return name == "gravity" or name.startswith("length") or (name[0] in "ab" and name[1:].isdigit())


def state_sizes(structure: LoopStructure, law: FeedbackLaw) -> dict[str, int]:
    """Entries of x: u, w, torque of lagging actuators, states of the law, measurements on their way."""
    s, shape = structure, Motion(structure.motion, {})
    n, torques = shape.n, len(shape.joints) if s.lagging else 0
    return {"u": n, "w": n, "torque": torques, "law": law.n_states, "queue": 2 * N_TASK * s.delay}


def signal_sizes(structure: LoopStructure) -> dict[str, int]:
    """Entries of e: what changes from sample to sample."""
    s = structure
    sizes = {"base": 1, "base_rate": 1} if s.moving_base else {}
    sizes |= {"target": N_TASK, "target_rate": N_TASK} if s.moving_target else {}
    return sizes | ({"noise": 2 * N_TASK} if s.noisy else {})


def motion_constant_names(motion: Motion) -> list[str]:
    """Names of all constants of a structure, in the order of `plant.motion.constants`."""
    s = motion.structure
    both = len(s.translations) == 2
    names = ["total", "inverse_total", "inverse_root_total", "gravity"] + (
        [] if s.rotation else ["base_cos", "base_sin"]
    )
    for direction in s.translations:
        names += [f"{word}_{direction}{per}" for word in ("stiffness", "damping") for per in ("", "_m")]
    for k in range(motion.n_bodies):
        names += [f"a{k}", f"b{k}", f"length{k}", f"am{k}", f"bm{k}"]
        for m in range(k + 1):
            names += [f"s{k}_{m}"] + ([f"t{k}_{m}"] if m < k else [])
    names += ["inverse_pivot"] if both else []
    names += ["stiffness0", "damping0"] if s.rotation else []
    names.append("rest0")
    for k, passive in enumerate(s.passive, 1):
        names += [f"stiffness{k}", f"rest{k}", f"damping{k}"] if passive else [f"damping{k}"]
    return names
