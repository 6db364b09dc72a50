"""One result of every kind that has a picture, of every shipped problem, of each machine some: small, each made once.

`SPECIMENS`: name -> a call that makes the result.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np

import flexopt
from flexopt.model.files import shipped_names
from tests.oracles.free_swing import FreeSwing

LOOP = {"kp": 1e4, "kv": 1e3, "duration": 2.0}
TURN = 0.3  # rad, of the joints from the middle of their limits, every other one twice as far


@cache
def machine(name: str) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", flexopt.FlexoptWarning)
        return flexopt.load(name)


@cache
def posture(name: str) -> tuple[float, ...]:
    """Joints a little off the middle of what their limits allow, the second bent."""
    limits = np.array(machine(name).limits)
    low, high = np.where(np.isfinite(limits), limits, [-1.0, 1.0]).T
    return tuple(map(float, (low + high) / 2 + np.minimum(TURN, (high - low) / 6) * (1 + np.arange(len(low)) % 2)))


def run(name: str) -> Any:
    return flexopt.simulate(machine(name), posture(name), **LOOP)


def ensemble(name: str) -> Any:
    vary = {"kp": np.geomspace(1e3, 1e6, 12)}
    return flexopt.simulate_ensemble(machine(name), posture(name), vary=vary, keep="trajectories", kv=1e3, duration=1.0)


def way(name: str) -> Any:
    limits = dict.fromkeys(machine(name).base_coordinates, (-0.5, 0.5))
    return flexopt.nullspace_trajectory(machine(name), posture(name), base_range=limits)


def identification(name: str) -> Any:
    """From a swing of the machine by another integrator, with noise."""
    count = flexopt.build_plant(machine(name)).n_passive
    swing = FreeSwing(machine(name), posture(name), np.full(count, 2e-3), np.zeros(count))
    time, noise = np.arange(0.0, 6.0, 0.01), np.random.default_rng(0)
    log = {"t": time}
    for column in machine(name).coordinates[:count]:
        log[column] = swing.column(column, time) + 1e-6 * noise.standard_normal(time.size)
    return flexopt.identify(machine(name), log, posture=posture(name), unknown="stiffness")


def atlas(name: str) -> Any:
    return flexopt.atlas(machine(name), posture=posture(name)[2:] or None, cells=(8, 8))


def workspace(name: str, over: str) -> Any:
    held = {"posture": posture(name)} if len(posture(name)) > 2 or over == "base" else {}
    if over == "posture":
        held = {"posture": posture(name)[2:]} if len(posture(name)) > 2 else {}
    return flexopt.map_workspace(machine(name), over=over, points=(9, 8), epsilon_max=False, **held)


def loop(name: str) -> Any:
    return flexopt.map_loop(
        machine(name), posture=posture(name), vary={"kp": (1e3, 1e6), "kv": (1e2, 1e5)}, points=(9, 8)
    )


def verdict(name: str) -> Any:
    return flexopt.verdict(flexopt.load_problem(name), loop={}, members=8, runs=0)


def sensitivity(name: str) -> Any:
    springs = [p for p in machine(name).parameters if "stiffness" in p.name and p.value > 0][:3]
    ranges = {p.name: (0.5 * p.value, 2.0 * p.value) for p in springs}
    return flexopt.sensitivity(machine(name), posture(name), ranges=ranges, samples=64)


def explanation(name: str) -> Any:
    return flexopt.explain(machine(name), posture(name))


def solved(name: str) -> Any:
    return flexopt.solve_problem(flexopt.load_problem(name))


def experiment(name: str) -> Any:
    return flexopt.run_experiment(flexopt.load_experiment(name))


# Of each kind a machine in the plane and one in space with as much on its picture as any: of the atlas and of maps of
# three joints, too; each machine several times.
OF = {
    "run": ("boom-stick-bucket", "excavator", "slewing-excavator"),
    "ensemble": ("excavator", "mobile-manipulator"),
    "way": ("boom-stick-bucket", "excavator", "truck-crane"),
    "identification": ("excavator", "mobile-manipulator"),
    "atlas": ("boom-stick-bucket", "excavator", "truck-crane"),
    "loop": ("boom-stick-bucket", "excavator", "mobile-manipulator"),
    "explanation": ("excavator", "slewing-excavator"),
}
SPATIAL = ("mobile-manipulator", "slewing-excavator", "truck-crane")
EXPERIMENTS = ("article-a", "article-b", "article-move")
STUDIES = ("excavator-study",)
PROBLEMS = tuple(name for name in shipped_names("problems") if name not in (*EXPERIMENTS, *STUDIES))
SPECIMENS: dict[str, Callable[[], Any]] = {
    **{f"problem {name}": partial(solved, name) for name in PROBLEMS},
    **{f"experiment {name}": partial(experiment, name) for name in EXPERIMENTS},
    **{f"run {name}": partial(run, name) for name in OF["run"]},
    **{f"ensemble {name}": partial(ensemble, name) for name in OF["ensemble"]},
    **{f"way {name}": partial(way, name) for name in OF["way"]},
    **{f"identification {name}": partial(identification, name) for name in OF["identification"]},
    **{f"atlas {name}": partial(atlas, name) for name in OF["atlas"]},
    **{f"map end_point {name}": partial(workspace, name, "end_point") for name in ("excavator", "mobile-manipulator")},
    **{f"map posture {name}": partial(workspace, name, "posture") for name in ("boom-stick-bucket", "truck-crane")},
    **{f"map base {name}": partial(workspace, name, "base") for name in SPATIAL},
    **{f"loop {name}": partial(loop, name) for name in OF["loop"]},
    **{f"verdict {name}": partial(verdict, name) for name in ("article", "pipe-laying")},
    **{f"explanation {name}": partial(explanation, name) for name in OF["explanation"]},
    **{f"sensitivity {name}": partial(sensitivity, name) for name in ("excavator", "truck-crane")},
}
