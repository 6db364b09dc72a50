"""Time of one RK4 step of machines in space: beside the planar closed form, beside MuJoCo.

Run: python -m benchmarks.spatial

Every row takes the same 2,000 steps of 5 ms from the same state, with gravity, one member in a tight loop. The actuated
joints are held by a torque that is set at the start of each step: τ = hold − P (q − q_0) − D v, one P and D for all. ns
are the least of interleaved rounds. Ours are the compiled `Recurrence`, constants at run time, cosines and sines
carried along by small rotations as in `flexopt.simulate`; MuJoCo runs `mj_step` in a loop in C with everything switched
off that the machine has not. Differences are the largest of
any coordinate or rate after 100 steps and after all, from the row named first.
"""

from __future__ import annotations

import ctypes
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

import flexopt
from benchmarks.simulation.peers import STRICT, Missing, _built, _folder
from benchmarks.timing import table
from flexopt.compiled import recurrence
from flexopt.loop.directions import Carried, Computed, stacked
from flexopt.loop.integrators import State, classical_step
from flexopt.model.tree import tree_from_dict
from flexopt.plant.chain_motion import ChainMotion
from flexopt.plant.graph import build_graph
from flexopt.plant.machine_motion import constant_values, structure_of
from flexopt.plant.plant import Plant
from flexopt.plant.tree_constants import constant_graphs
from flexopt.plant.tree_motion import TreeMotion
from flexopt.plant.tree_structure import skeleton
from tests.oracles.spatial import grounded, in_space, mujoco_tree

STEP, STEPS, ROUNDS = 0.005, 2000, 15
HELD = (2e5, 4e3)  # N m/rad, N m s/rad

MUJOCO = r"""
#include <mujoco/mujoco.h>
#define PUBLIC __attribute__((visibility("default")))
typedef struct { mjModel *model; mjData *data; } simulation;
PUBLIC simulation *spatial_load(const char *path) {
  simulation *s = mju_malloc(sizeof(simulation));
  s->model = mj_loadModel(path, NULL);
  s->data = mj_makeData(s->model);
  return s;
}
// joint[0 .. n-1]: addresses of the actuated joints; hold and start (n).
PUBLIC void spatial_run(simulation *s, double *q, double *v, const int *joint, const double *hold,
                        const double *start, int n, double p, double d, long steps) {
  int nv = (int)s->model->nv;
  mj_resetData(s->model, s->data);
  mju_copy(s->data->qpos, q, nv), mju_copy(s->data->qvel, v, nv);
  for (long k = 0; k < steps; ++k) {
    for (int i = 0; i < n; ++i) {
      int j = joint[i];
      s->data->qfrc_applied[j] = hold[i] - p * (s->data->qpos[j] - start[i]) - d * s->data->qvel[j];
    }
    mj_step(s->model, s->data);
  }
  mju_copy(q, s->data->qpos, nv), mju_copy(v, s->data->qvel, nv);
}
"""


@dataclass(frozen=True)
class Case:
    """A start state in q, passive first, and what holds the actuated joints."""

    q: np.ndarray
    v: np.ndarray
    hold: np.ndarray
    n_passive: int


@dataclass
class _Flow:
    """A `Field` for `classical_step`: torque held over the step."""

    motion: Any
    torque: ca.SX

    @property
    def n_translations(self) -> int:
        return self.motion.n_translations

    def rates(self, t: ca.SX, state: State, along: Any) -> State:  # noqa: ARG002 - nothing depends on time
        base = ca.SX.zeros(3, 1)
        given = (self.torque, base, base)
        if isinstance(self.motion, ChainMotion):
            given = (self.torque, base[0], base[0])
        acceleration = self.motion.acceleration(state.u, state.w, along, *given, gravity=True)
        return State(state.w, acceleration, state.z)


class Ours:
    """The compiled loop of a `Motion`, by any builder of accelerations that has their interface."""

    def __init__(
        self, build: Callable[[Any], Any], values: dict[str, float], zeros: frozenset[str], case: Case
    ) -> None:
        names = [name for name in values if name not in zeros]
        k = len(case.hold)
        symbols, held = ca.SX.sym("c", len(names)), ca.SX.sym("held", 2 * k)
        motion = build({name: symbols[i] for i, name in enumerate(names)})
        self.to_q, n = motion.to_q.full(), motion.n
        x, c = ca.SX.sym("x", 2 * n), ca.vertcat(symbols, held)
        start = State(x[:n], x[n:], ca.SX.zeros(0, 1))
        q, v = ca.mtimes(motion.to_q, start.u), ca.mtimes(motion.to_q, start.w)
        m = case.n_passive
        torque = held[:k] - HELD[0] * (q[m:] - held[k:]) - HELD[1] * v[m:]
        flow, h, t = _Flow(motion, torque), ca.SX(STEP), ca.SX(0)
        e, none = ca.SX.sym("e", 0), ca.SX.zeros(0, 1)
        after, _ = classical_step(flow, h, t, start, Computed(motion.angles(start.u)))
        options = {"cse": True}
        step = ca.Function("spatial_step", [x, e, c], [ca.vertcat(after.u, after.w), none], options)
        pairs = ca.SX.sym("pairs", 2 * (n - motion.n_translations))
        carried = Carried(pairs)
        after, heading = classical_step(flow, h, t, start, carried)
        results = [ca.vertcat(after.u, after.w), stacked(heading.pairs), none, carried.turn]
        fast = ca.Function("spatial_fast", [x, pairs, e, c], results, options)
        exact = stacked(Computed(motion.angles(start.u)).start.pairs)
        refresh = ca.Function("spatial_refresh", [x, c], [exact], options)
        self.runner = recurrence(step, fast=fast, refresh=refresh)
        if not self.runner.compiled:
            raise Missing("no compiler")
        self.instructions = fast.n_instructions()
        self.c = np.concatenate([[values[name] for name in names], case.hold, case.q[m:]])
        to_u = np.linalg.inv(self.to_q)
        self.x = np.concatenate([to_u @ case.q, to_u @ case.v])

    def run(self, steps: int) -> tuple[np.ndarray, float]:
        """State in q after the steps, and seconds of the loop: a call without steps is taken off."""
        idle = min(self._timed(0)[1] for _ in range(3))
        last, seconds = self._timed(steps)
        n = len(self.to_q)
        return np.concatenate([self.to_q @ last[:n], self.to_q @ last[n:]]), seconds - idle

    def _timed(self, steps: int) -> tuple[np.ndarray, float]:
        begin = time.perf_counter()
        last = self.runner(self.x, self.c, steps=steps, stride=max(1, steps), keep="monitors").last[:, 0]
        return last, time.perf_counter() - begin


class Mujoco:
    """`mj_step` in a loop in C."""

    def __init__(self, data: dict[str, Any], case: Case) -> None:
        try:
            mujoco: Any = import_module("mujoco")  # an optional peer
        except ImportError as error:
            raise Missing(f"no MuJoCo ({error})") from error
        folder = Path(mujoco.__file__).parent
        shared = sorted([*folder.glob("libmujoco*.so*"), *folder.glob("libmujoco*.dylib")])
        if not shared:
            raise Missing("the MuJoCo package has no library to link")
        with tempfile.NamedTemporaryFile("w", dir=_folder(), suffix=".c", delete=False) as file:
            file.write(MUJOCO)
        link = ("-x", "none", str(shared[0]), f"-Wl,-rpath,{folder}")
        library = _built(file.name, (*STRICT, f"-I{folder / 'include'}"), link)
        doubles, integers = ctypes.POINTER(ctypes.c_double), ctypes.POINTER(ctypes.c_int)
        self._run = library.spatial_run
        self._run.argtypes = [ctypes.c_void_p, doubles, doubles, integers, doubles, doubles, ctypes.c_int,
                              ctypes.c_double, ctypes.c_double, ctypes.c_long]  # fmt: skip
        self._run.restype = None
        library.spatial_load.restype, library.spatial_load.argtypes = ctypes.c_void_p, [ctypes.c_char_p]
        tree = mujoco_tree(data)
        model, self.order, self.case = tree.model, np.array(tree.order), case
        model.opt.timestep, model.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_RK4
        kept = {"mjDSBL_SPRING", "mjDSBL_DAMPER", "mjDSBL_GRAVITY"}
        for name, bit in mujoco.mjtDisableBit.__members__.items():
            if name.startswith("mjDSBL_") and name not in kept:
                model.opt.disableflags |= bit.value
        path = _folder() / "spatial.mjb"
        mujoco.mj_saveModel(model, str(path), None)
        self._simulation = library.spatial_load(str(path).encode())

    def run(self, steps: int) -> tuple[np.ndarray, float]:
        """State in q after the steps, and seconds."""
        case, n = self.case, len(self.order)
        q, v = np.zeros(n), np.zeros(n)
        q[self.order], v[self.order] = case.q, case.v
        joint = np.array(self.order[case.n_passive :], dtype=np.int32)
        doubles = ctypes.POINTER(ctypes.c_double)
        start = np.ascontiguousarray(case.q[case.n_passive :])
        given = [a.ctypes.data_as(doubles) for a in (q, v)]
        rest = [a.ctypes.data_as(doubles) for a in (case.hold, start)]
        begin = time.perf_counter()
        self._run(
            self._simulation,
            *given,
            joint.ctypes.data_as(ctypes.POINTER(ctypes.c_int)),
            *rest,
            len(joint),
            *HELD,
            steps,
        )
        seconds = time.perf_counter() - begin
        return np.concatenate([q[self.order], v[self.order]]), seconds


def spatial(tree: Any, case: Case) -> Ours:
    """A tree through the recursions, also where its structure has a closed form."""
    given = {parameter.name: ca.SX(parameter.value) for parameter in tree.parameters}
    values = {name: float(ca.evalf(graph)) for name, graph in constant_graphs(tree.kinematic_tree, given).items()}
    zeros = frozenset(name for name, value in values.items() if value == 0)
    structure = replace(skeleton(tree.kinematic_tree), zeros=zeros, local=True)
    return Ours(lambda value: TreeMotion(structure, value), values, zeros, case)


def closed_form(machine: Any, case: Case) -> Ours:
    """A chain in a plane by its closed form."""
    structure = structure_of(machine)
    return Ours(lambda value: ChainMotion(structure, value), constant_values(machine), structure.zeros, case)


def case_of(plant: Any, posture: np.ndarray, base: Any, offset: float = 0.03) -> Case:
    """Passive joints at rest and displaced arm, weight held at the undisplaced posture."""
    p, m = plant.parameter_values, plant.n_passive
    q = plant.rest(base, posture, p).full().ravel()
    hold = plant.gravity(q, base, p).full().ravel()[m:].copy()
    q[m:] += offset
    return Case(q, np.zeros_like(q), hold, m)


def compare(title: str, rows: dict[str, Any]) -> dict[str, float]:
    """Print a table; seconds of a run of each."""
    least = dict.fromkeys(rows, np.inf)
    for _ in range(ROUNDS):
        for name, row in rows.items():
            least[name] = min(least[name], row.run(STEPS)[1])
    first = next(iter(rows))
    references = {k: rows[first].run(k)[0] for k in (STEPS // 20, STEPS)}
    lines: list[tuple[str, ...]] = [("who", "ns a step", f"this / {first}", "difference", "instructions")]
    for name, row in rows.items():
        difference = max(np.abs(row.run(k)[0] - reference).max() for k, reference in references.items())
        time_, ratio = f"{1e9 * least[name] / STEPS:.0f}", f"{least[name] / least[first]:.2f}"
        lines.append((name, time_, ratio, f"{difference:.1e}", str(getattr(row, "instructions", "–"))))
    print(table(title, lines))
    return least


def main() -> None:
    """Print the tables."""
    machine = flexopt.load("excavator")
    plant = flexopt.build_plant(machine)
    case = case_of(plant, np.array([0.0448, -2.0499]), 0.0)
    tree = tree_from_dict(in_space(machine.model_dump(by_alias=True)))
    rows = {"closed form": closed_form(machine, case), "spatial path": spatial(tree, case)}
    least = compare("The excavator, 3 + 2 coordinates in the plane", rows)
    print(f"spatial path / closed form: {least['spatial path'] / least['closed form']:.2f} (bar: at most 3)\n")

    for arm, bar in ((4, "bar: at least 5"), (7, "no bar")):
        data = grounded(arm, 0, coupled=False)
        tree = tree_from_dict(data)
        case = case_of(Plant(tree, build_graph(tree)), np.linspace(0.4, -0.5, arm), np.zeros(3))
        rows = {"flexopt": spatial(tree, case)}
        try:
            rows["MuJoCo, all C"] = Mujoco(data, case)
        except Missing as reason:
            print(f"MuJoCo: {reason}")
        least = compare(f"Six ground coordinates and {arm} joints in space", rows)
        if "MuJoCo, all C" in rows:
            print(f"MuJoCo / flexopt: {least['MuJoCo, all C'] / least['flexopt']:.1f} ({bar})\n")


if __name__ == "__main__":
    main()
