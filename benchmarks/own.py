"""Own objectives and constraints beside another method, that of `benchmarks.choice`, by numbers that know no graphs.

Run: python -m benchmarks.own [--cases N] [--machines NAME …] [--samples N] [--workers N]

Random smooth functions of placement, posture, w_i and the end-point's sag are maximised, with a bound on the torques
that hold the arm. The other method has their values from formulas in NumPy, w_i and the static forces from public
Functions. The gap is how much better it is, as a share of the objective's scale.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

import flexopt
from benchmarks.choice import Other, Row, beside, chosen, compare
from flexopt.foundation.arrays import Vector

# Repetitions of q_p = rest − K_p⁻¹ g_p(q): springs are far stiffer than the weight moves.
SETTLING = 15
Value = Callable[[Any, Any, Any, Any], Any]


def sags(machine: Any, bases: Vector, postures: Vector) -> Vector:
    """Ways of the end-point under the weight (n_task, N), by repeated static forces of public Functions."""
    plant = flexopt.build_plant(machine)
    m, p = plant.n_passive, plant.parameter_values
    rest = plant.rest.call([bases, postures, p])[0].full()
    stiffness, q = plant.stiffness(p).full()[:m, :m], rest.copy()
    for _ in range(SETTLING):
        q[:m] = rest[:m] - np.linalg.solve(stiffness, plant.gravity.call([q, bases, p])[0].full()[:m])
    ends = [plant.end_point.call([at, bases, p])[0].full() for at in (q, rest)]
    way: Vector = ends[0] - ends[1]
    return way


def torques(machine: Any, bases: Vector, postures: Vector) -> Vector:
    """What holds the arm at rest, (n, N)."""
    plant = flexopt.build_plant(machine)
    q = plant.rest.call([bases, postures, plant.parameter_values])[0].full()
    found: Vector = plant.gravity.call([q, bases, plant.parameter_values])[0].full()[plant.n_passive :]
    return found


def random_goal(rng: np.random.Generator, machine: Any, size: float) -> tuple[Value, ca.Function]:
    """A smooth function of base, posture, w and sag: for numbers, by rows, and as a `casadi.Function`."""
    plant = flexopt.build_plant(machine)
    n, m, r = plant.n_actuated, plant.n_passive, plant.n_task
    a, b, c = rng.uniform(-1, 1, n), rng.uniform(0.2, 1, m), rng.uniform(-1, 1, r)
    shift = rng.uniform(-1, 1)

    def value(base: Any, posture: Any, w: Any, sag: Any) -> Any:
        sine = ca.sin if isinstance(base, ca.MX) else np.sin
        swing = sum(a[k] * sine(posture[k] + 0.3 * base[0]) for k in range(n))
        measures = sum(b[k] * w[k] for k in range(m)) / size
        return 0.3 * swing + measures - 0.05 * (base[0] - shift) ** 2 + sum(c[k] * sag[k] for k in range(r))

    inputs = [ca.MX.sym("base", plant.n_base), ca.MX.sym("posture", n), ca.MX.sym("w", m), ca.MX.sym("sag", r)]
    return value, ca.Function("goal", inputs, [value(*inputs)], ["base", "posture", "w", "sag"], ["value"])


class OtherOwn(Other):
    """The other method on an own objective and a bound on the torques."""

    def __init__(self, problem: flexopt.SelectionProblem, seed: int, value: Value, most: float) -> None:
        super().__init__(problem, seed)
        self.value, self.most = value, most
        self.alpha = np.zeros_like(self.alpha)

    def values(self, z: Vector) -> Vector:
        """U (N,); −∞ where anything is broken."""
        allowed, found = super().values(z), np.full(z.shape[1], -np.inf)
        good = np.flatnonzero(np.isfinite(allowed))
        if good.size:
            base, posture = z[: self.n_base, good], z[self.n_base :, good]
            machine = self.problem.machine
            w = self.measures.w.call([base, posture, self.p])[0].full()
            held = np.sum((torques(machine, base, posture) / self.most) ** 2, axis=0) <= 1.0
            worth = self.value(base, posture, w, sags(machine, base, posture))
            found[good] = np.where(held & np.isfinite(worth), worth + allowed[good], -np.inf)
        return found


def asked(name: str, number: int) -> tuple[Any, Vector, dict[str, Any], Value, float]:
    """A machine, a target, options of `flexopt.select`, the objective's formula, and the bound of the torques."""
    machine, target, options = chosen(name, number)
    rng = np.random.default_rng([number, 1])
    plain = flexopt.build_selection(machine, target, **options)
    value, goal = random_goal(rng, machine, plain.objective_scale)
    sizes = np.linalg.norm(torques(machine, plain.scan.base, plain.scan.posture), axis=0)
    most = float(np.quantile(sizes, rng.uniform(0.3, 0.9)))
    symbol = ca.MX.sym("torques", plain.measures.plant.n_actuated)
    held = ca.Function("held", [symbol], [ca.sumsqr(symbol / most)], ["torques"], ["share"])
    constraints = [flexopt.Constraint(held, upper=1.0), options["constraints"] or {}]
    return machine, target, options | {"objective": goal, "weights": None, "constraints": constraints}, value, most


def examined(samples: int, case: tuple[str, int]) -> Row:
    """As `beside`."""
    machine, target, options, value, most = asked(*case)
    other = functools.partial(OtherOwn, seed=case[1], value=value, most=most)
    return beside(samples, case, (machine, target, options), other)


if __name__ == "__main__":
    compare(__doc__ or "", 40, examined)
