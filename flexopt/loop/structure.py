"""What parts a closed loop has, and how its vectors are laid out.

In: choices. Out: `LoopStructure`, the key under which graphs and compiled code are kept, and the sizes of the parts of
states x, signals e and constants c.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Self

from flexopt.foundation.control import DAMPED, Control
from flexopt.foundation.kept import Structural
from flexopt.loop.feedback import FeedbackLaw, Law
from flexopt.model import AnyMachine
from flexopt.model.simulation import IntegrationMethod
from flexopt.plant.machine_motion import motion_of
from flexopt.plant.tree_structure import Skeleton


@dataclass(frozen=True)
class LoopStructure(Structural):
    """What parts a loop has; every number is a constant and not part of it.

    Attributes:
        motion: the machine's structure.
        control: how forces at the end-point become joint torques, `"damped"` without its number.
        law, order: task-space feedback, and the number of states of a state-space law.
        sampled: the command is computed at the start of each sample and held; else at every stage of the integrator.
        method, substeps, iterations: integration; iterations of the implicit method.
        damped: whether these take dampers as strong ones, see `integrators.StrongDampers`.
        stiff: whether the implicit method is Radau's, which brings to rest in a step what dampers brake in a small part
            of it; Gauss's would leave it swinging from step to step.
        gravity, compensated: whether weight acts, and whether the command carries the arm's.
        delay: measurements on their way to the command.
        after: integration steps of a sample behind the newest of them; 0 where it is taken at the sample's start.
        quantised, noisy, filtered: of the measurement.
        limited, lagging, rate_limited, dead_band: of the actuators.
        nullspace_damped: whether a damper acts on the arm's self-motion.
        served: whether drives serve rates, and brake their joints; that is within the machine's damping.
        moving_base, moving_target: whether they come as signals instead of constants.
        watched: whether a step gives what is judged (see `Sample.monitor`); else it is taken from the samples.
        levers, hydraulic: how joint rates that pass through levers are cut, and the machine whose levers they are: all
            numbers of that map are part of the structure.
        own_model: whether the controller has constants of its own for geometry and weight, in place of the machine's.
    """

    motion: Skeleton
    control: Control = "inverse"
    law: Law = "pd"
    order: int = 0
    sampled: bool = True
    method: IntegrationMethod = "rk4"
    substeps: int = 1
    iterations: int = 0
    damped: bool = False
    stiff: bool = False
    gravity: bool = False
    compensated: bool = False
    delay: int = 0
    after: int = 0
    quantised: bool = False
    noisy: bool = False
    filtered: bool = False
    limited: bool = False
    lagging: bool = False
    rate_limited: bool = False
    dead_band: bool = False
    nullspace_damped: bool = False
    served: bool = False
    moving_base: bool = False
    moving_target: bool = False
    levers: Literal["each", "uniform"] | None = None
    hydraulic: AnyMachine | None = None
    own_model: bool = False
    watched: bool = False

    @property
    def symbolic(self) -> Self:
        """Itself: the numbers of `hydraulic` are part of it."""
        return self

    @property
    def n_task(self) -> int:
        """Task rows."""
        return len(self.motion.rows)

    @property
    def redundant(self) -> bool:
        """Whether the arm has a self-motion, which the controller does not hold."""
        return self.law != "none" and motion_of(self.motion, {}).n_joints > self.n_task

    @property
    def drifting(self) -> bool:
        """Whether nothing brakes it either."""
        return self.redundant and not self.nullspace_damped

    @property
    def bends(self) -> bool:
        """Whether the base may come to rest elsewhere than by design, bent without moving.

        Where the arm drifts; and under weight that of other members of an ensemble, of a machine that moves away, or of
        an arm whose self-motion is braked but not held.
        """
        moves = self.redundant or self.own_model or self.moving_base or self.moving_target
        return self.drifting or (self.gravity and moves)

    @property
    def n_base(self) -> int:
        """Placement coordinates."""
        return len(self.motion.placement)


JACOBIAN_DAMPING = "jacobian_damping"  # λ of a damped control
MODEL = "model_"  # prefix of a controller's own constants


def constant_sizes(structure: LoopStructure, law: FeedbackLaw) -> dict[str, int]:
    """Entries of c: the motion's constants, and those of controller, sensors and actuators."""
    s, shape = structure, motion_of(structure.motion, {})
    n, m, hinges, known = shape.n_joints, shape.n_passive, len(shape.hinges), set(shape.known_names)
    sizes = {name: 1 for name in shape.structure.constants if name not in s.motion.zeros}
    sizes |= {f"{MODEL}{name}": 1 for name in sizes if s.own_model and name in known}
    sizes |= {"h": 1, "design": m, "design_directions": 2 * hinges}
    sizes |= {"u_design": shape.n, "modes": m * shape.n, "omega_squared": m}
    sizes["base"] = s.n_base
    sizes |= {} if s.moving_target else {"target": s.n_task}
    sizes |= law.constants
    sizes |= {"resolution": s.n_task, "rate_resolution": s.n_task} if s.quantised else {}
    for part, name, size in (
        (s.after > 0, "early", 1),
        (s.filtered, "filter", 1),
        (s.limited, "torque_limit", n),
        (s.dead_band, "dead_band", n),
        (s.lagging, "bandwidth", n),
        (s.rate_limited, "rate_limit", n),
        (s.nullspace_damped, "nullspace_damping", 1),
        (s.served, "braking", n),
        (s.hydraulic is not None, "servo_gain", 1),
        (s.control == DAMPED, JACOBIAN_DAMPING, 1),
    ):
        sizes |= {name: size} if part else {}
    return sizes


def state_sizes(structure: LoopStructure, law: FeedbackLaw) -> dict[str, int]:
    """Entries of x: u, w, torque of lagging actuators, states of the law, what a filter has, what is on its way."""
    s, shape = structure, motion_of(structure.motion, {})
    n, torques = shape.n, shape.n_joints if s.lagging else 0
    measured = 2 * s.n_task
    sizes = {"u": n, "w": n, "torque": torques, "law": law.n_states}
    return sizes | {"filter": measured * s.filtered, "queue": measured * s.delay}


def signal_sizes(structure: LoopStructure) -> dict[str, int]:
    """Entries of e: what changes from sample to sample."""
    s, driven = structure, len(motion_of(structure.motion, {}).drive)
    sizes = {"base": driven, "base_rate": driven} if s.moving_base else {}
    sizes |= {"target": s.n_task, "target_rate": s.n_task} if s.moving_target else {}
    return sizes | ({"noise": 2 * s.n_task} if s.noisy else {})
