"""Logs of a free swing by other means than the fit's: SciPy's DOP853 with error control on the plant's numeric M, h, K, D.

Columns are told from positions and rotations by their definitions: rates of the base from differences of its rotation
matrix, the accelerometer from second differences of its place.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

from flexopt.identification.measured import imu_body
from flexopt.model import AnyMachine
from flexopt.plant import build_plant


class FreeSwing:
    """A machine with its arm held, swinging from a displacement and a velocity of its passive coordinates."""

    def __init__(self, machine: AnyMachine, posture: Any, displaced: Any, speed: Any, *, gravity: bool = False) -> None:
        self.machine, self.plant, self.posture = machine, build_plant(machine), np.asarray(posture, dtype=float)
        plant, self.m = self.plant, self.plant.n_passive
        self.p, self.base = plant.parameter_values, ca.DM.zeros(plant.n_base)
        self.rest = plant.rest(self.base, self.posture, self.p).full().ravel()
        self.springs, self.dampers = plant.stiffness(self.p).full(), plant.damping(self.p).full()
        q, v = ca.SX.sym("q", plant.n_coordinates), ca.SX.sym("v", plant.n_coordinates)
        force = plant.bias(q, v, self.base, self.p)
        if gravity:
            force += plant.gravity(q, self.base, self.p)
        self.inertia = ca.Function("inertia", [q, v], [plant.mass(q, self.base, self.p), force])
        self.start = np.concatenate([self.rest[: self.m] + displaced, speed])
        self._solution: Any = None

    def rate(self, _t: float, x: np.ndarray) -> np.ndarray:
        m = self.m
        q, v = np.concatenate([x[:m], self.posture]), np.concatenate([x[m:], np.zeros(len(self.posture))])
        mass, bias = (part.full() for part in self.inertia.call([q, v]))
        force = bias.ravel() + self.springs @ (q - self.rest) + self.dampers @ v
        return np.concatenate([x[m:], np.linalg.solve(mass[:m, :m], -force[:m])])

    def states(self, time: Any) -> np.ndarray:
        """(N, 2m) at these times."""
        time = np.asarray(time, dtype=float)
        if self._solution is None or self._solution.t[-1] < time[-1]:
            self._solution = solve_ivp(
                self.rate, (0.0, float(time[-1]) + 1e-2), self.start, method="DOP853", rtol=1e-9, atol=1e-12,
                dense_output=True,
            )  # fmt: skip
        return self._solution.sol(time).T

    def frame(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Place and axes of the body that carries the arm."""
        q = np.concatenate([x[: self.m], self.posture])
        origins, rotations = (part.full() for part in self.plant.body_frames(q, self.base, self.p))
        k, d = self.plant.frames.names.index(str(imu_body(self.machine))), origins.shape[0]
        return origins[:, k], rotations[:, k * d : (k + 1) * d]

    def column(self, name: str, time: Any, imu: Any = None) -> np.ndarray:
        """A measured quantity, SI."""
        x, names = self.states(time), self.machine.coordinates[: self.m]
        if name in names:
            return x[:, names.index(name)]
        if name.removesuffix(".rate") in names:
            return x[:, self.m + names.index(name.removesuffix(".rate"))]
        kind, axis = name.replace(".", "_").rsplit("_", 1)
        axes = self.machine.kinematic_tree.axes
        if kind == "end_point":
            return np.array([self.tip(row)[axes.index(axis)] for row in x])
        if kind == "gyro":
            h = 1e-4
            turns = [(self.frame(row)[1], self.rotated(row, h), self.rotated(row, -h)) for row in x]
            spins = [now.T @ (after - before) / (2 * h) for now, after, before in turns]
            i, j = {"x": (2, 1), "y": (0, 2), "z": (1, 0)}[axis]
            return np.array([spin[i, j] for spin in spins])
        assert kind == "acc", name
        up = np.zeros(len(axes))
        up[-1] = float(self.machine.gravity)
        found = []
        for row in x:
            rates, h = self.rate(0.0, row), 1e-3
            v, a = row[self.m :], rates[self.m :]
            steps = [row[: self.m] + k * h * v + 0.5 * (k * h) ** 2 * a for k in (-1, 0, 1)]
            r = [self.frame(np.concatenate([q, v])) for q in steps]
            places = [o + turn @ (np.zeros(len(axes)) if imu is None else np.asarray(imu)) for o, turn in r]
            found.append(r[1][1].T @ ((places[0] - 2 * places[1] + places[2]) / h**2 + up))
        return np.array(found)[:, axes.index(axis)]

    def rotated(self, row: np.ndarray, h: float) -> np.ndarray:
        return self.frame(np.concatenate([row[: self.m] + h * row[self.m :], row[self.m :]]))[1]

    def tip(self, row: np.ndarray) -> np.ndarray:
        q = np.concatenate([row[: self.m], self.posture])
        return self.plant.skeleton(q, self.base, self.p).full()[:, -1]

    def log(
        self, names: Sequence[str], time: Any, noise: float = 0.0, seed: int = 0, imu: Any = None
    ) -> dict[str, np.ndarray]:
        """Columns by name, with white noise that is this share of what each one moves at most."""
        rng, found = np.random.default_rng(seed), {"t": np.asarray(time, dtype=float)}
        for name in names:
            clean = self.column(name, time, imu)
            found[name] = clean + noise * np.abs(clean - clean.mean()).max() * rng.standard_normal(len(clean))
        return found
