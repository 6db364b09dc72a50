"""The sampled linear loop by SciPy's discretisation and python-control's feedback: PD control, any dead time.

Nothing of `flexopt.simulation` takes part. Here the command is late, where the simulator's measurement is: x⁺ = e^{AT} x
+ B₀ f_{k−l} + B₁ f_{k−l−1} for a dead time of l T + δ.
"""

from __future__ import annotations

import control as python_control
import numpy as np
from scipy.signal import cont2discrete

from flexopt.model import AnyMachine
from flexopt.plant import build_plant

Vector = np.ndarray


def held_plant(machine: AnyMachine, posture: Vector, control: str, base: Vector | None = None) -> tuple[Vector, ...]:
    """A, B and the output [r − r_d; ṙ] of the plant about rest, x = [v; q − q_d]."""
    plant = build_plant(machine)
    base = np.zeros(plant.n_base) if base is None else base
    a, b, c = (x.full() for x in plant.linearisation(control).call([base, posture, plant.parameter_values]))
    n = len(a) // 2
    return a, b, np.vstack([c, np.hstack([c[:, n:], np.zeros((len(c), n))])])


def multipliers(
    machine: AnyMachine,
    posture: Vector,
    *,
    control: str,
    kp: float,
    kv: float,
    period: float,
    dead_time: float = 0.0,
    base: Vector | None = None,
) -> Vector:
    """Eigenvalues of one sample, a double 1 for each degree of redundancy left out, largest first."""
    a, b, c = held_plant(machine, posture, control, base)
    r, whole = b.shape[1], int(dead_time / period + 1e-9)
    late = max(dead_time - whole * period, 0.0)
    no = np.zeros((len(c), r))
    advanced, driven, *_ = cont2discrete((a, b, c, no), period, method="zoh")
    inputs = [driven]
    if late > 1e-9 * period:
        rest, first, *_ = cont2discrete((a, b, c, no), period - late, method="zoh")
        inputs = [first, rest @ cont2discrete((a, b, c, no), late, method="zoh")[1]]
    # Forces on their way, the newest first; the plant feels those of `whole` samples ago, and before.
    n, waiting = len(a), whole + len(inputs) - 1
    size = n + r * waiting
    f, g = np.zeros((size, size)), np.zeros((size, r))
    f[:n, :n] = advanced
    for k, driven in enumerate(inputs):
        age = whole + k
        if age == 0:
            g[:n] = driven
        else:
            f[:n, n + r * (age - 1) : n + r * age] = driven
    if waiting:
        g[n : n + r] = np.eye(r)
        f[n + r :, n : n + r * (waiting - 1)] = np.eye(r * (waiting - 1))
    h = np.hstack([c, np.zeros((len(c), r * waiting))])
    held = python_control.ss(f, g, h, no, period, remove_useless_states=False)
    gains = python_control.ss([], [], [], np.hstack([kp * np.eye(r), kv * np.eye(r)]), period)
    values = np.linalg.eigvals(python_control.feedback(held, gains).A)
    excess = len(machine.joints) - r
    values = values[np.argsort(np.abs(values - 1))][2 * excess :]
    return values[np.argsort(-np.abs(values))]


def growth_rate(machine: AnyMachine, posture: Vector, **options: object) -> float:
    """Largest ln|μ|/T, 1/s; options of `multipliers`."""
    values = multipliers(machine, posture, **options)  # type: ignore[arg-type]
    return float(np.log(np.abs(values[0])) / options["period"])  # type: ignore[operator]
