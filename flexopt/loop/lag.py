"""What each mode gets to feel of the real controller: allowances, lag at its frequency, first-order decay.

In: the loop for small motions. Out: Functions of placement, posture, parameters, gains and dead time, with exact
derivatives. The feedback that mode i sees is F(jω) = K(jω) H(jω) e^{−jω(d + T/2)} sinc(ωT/2), H of filter and servos.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.foundation.kept import Structural, structural_property
from flexopt.loop.small_motions import BY, CONFIGURATION, DEAD_TIME, INPUTS, SmallMotions
from flexopt.plant.control import task_to_joints_transposed
from flexopt.robustness.evaluation import unreached
from flexopt.robustness.measures import Measures, build_measures
from flexopt.robustness.modal import ModalGraphs

# Of a rate, by which a motion of the loop is a mode that no loop changes.
OWN = 1e-6
# Real and imaginary part.
RealImaginary = tuple[ca.SX, ca.SX]


@dataclass(frozen=True)
class LaggedModes(Structural):
    """Functions of `INPUTS`, dead_time and period (1,), s; m modes.

    Outputs, (m,) each: `allowance`, `allowance_isotropic`: see `ModalGraphs`. `lag` ψ_i, rad: of the feedback of the
    end-point's rate behind the end-point's rate at ω_i, ω (d + T/2) + atan(Kp/(ω Kv)) and what filter and servos add;
    gains that differ between rows, and servos between joints, by their means. `lag_reserve`, rad: to the lag at which
    the sign of what isotropic gains do to the mode turns, positive while they damp it. `first_order_decay`
    ζω + Im(bᵀ F(jω) a) / (2ω), 1/s: half of 2ζω + Im(bᵀ F a) / ω. `w_lagged`: λmin of the Hermitian part of
    2 e^{jψ} R_i, which is w_i without lag: a·b cos ψ − sqrt(|a|²|b|² − (a·b)² sin² ψ).
    """

    motions: SmallMotions

    NAMES = ("allowance", "allowance_isotropic", "lag", "lag_reserve", "first_order_decay", "w_lagged")

    @cached_property
    def measures(self) -> Measures:
        """Of the machine."""
        return build_measures(self.motions.machine, self.motions.control, self.motions.gravity)

    @structural_property
    def _symbols(self) -> dict[str, ca.SX]:
        # Those of the measures' own plant: caches may have dropped the one that the motions were made of.
        at = self.measures.plant.graph
        of = self.motions.symbols | {"base": at.base, "posture": at.posture, "p": at.p}
        return {name: of[name] for name in (*INPUTS, "period")} | {DEAD_TIME: ca.SX.sym(DEAD_TIME)}

    @structural_property
    def _graphs(self) -> dict[str, ca.SX]:
        modal, plant = ModalGraphs(self.measures.expansion), self.motions.plant
        (a, b), omega, jacobian = modal.factors, modal.omega, modal.expansion.point.rigid_jacobian
        lags, decays = list[ca.SX](), list[ca.SX]()
        for i in range(plant.n_passive):
            w, (real, imaginary) = omega[i], self._servo(omega[i])
            decays.append(self._decay(modal.zeta[i] * w, w, a[:, i], modal.shapes[plant.n_passive :, i], jacobian))
            mean = [ca.sum(x) / plant.n_task for x in self._law(w)]
            drives = ca.sum(ca.atan2(-imaginary, real)) / plant.n_actuated
            lags.append(self._behind(w)[0] + ca.atan2(*mean) + drives)
        lag = ca.vertcat(*lags)
        product, lengths = ca.sum1(a * b).T, (ca.sum1(a**2) * ca.sum1(b**2)).T
        wrapped = ca.fabs(lag - math.tau * ca.floor(lag / math.tau + 0.5))
        reserve = (math.pi / 2 - wrapped) * ca.if_else(product < 0, -1, 1)
        turned = 2 * product * ca.cos(lag)
        if plant.n_task > 1:
            turned = product * ca.cos(lag) - ca.sqrt(lengths - (product * ca.sin(lag)) ** 2)
        values = (modal.allowance, modal.allowance_isotropic, lag, reserve, ca.vertcat(*decays), turned)
        return dict(zip(self.NAMES, values, strict=True))

    def _law(self, w: ca.SX) -> RealImaginary:
        """Kp + jω Kv + Ki / (jω), (r,) each."""
        s, gain = self._symbols, self._symbols["servo_gain"] if self.motions.served else 1
        kp, kv, ki = (gain * s[name] for name in ("kp", "kv", "ki"))
        return kp, kv * w - (ki / w if self.motions.integral else 0)

    def _decay(self, own: ca.SX, w: ca.SX, a: ca.SX, joints: ca.SX, jacobian: ca.SX) -> ca.SX:
        """To first order, of a mode that by itself decays at `own`; `joints`: their part of φ."""
        behind, size = self._behind(w)
        into = [task_to_joints_transposed(jacobian, self.motions.control, part * joints) for part in self._servo(w)]
        late = size * ca.cos(behind), -size * ca.sin(behind)
        _, imaginary = _product(_dot(into, _times(self._law(w), a)), late)
        return own + imaginary / (2 * w)

    @structural_property
    def of_known(self) -> ca.Function:
        """(own, omega (m,), a (r, m), joints (n, m), Jv, gains, drives, period, dead_time) -> `first_order_decay`.

        Of modes that are known: own ζ_i ω_i, with the joints' velocity servos, and the joints' part of φ_i.
        """
        plant = self.motions.plant
        m, r, n = plant.n_passive, plant.n_task, plant.n_actuated
        shapes = {"own": (m, 1), "omega": (m, 1), "a": (r, m), "joints": (n, m), "Jv": (r, n)}
        of = {name: ca.SX.sym(name, *shape) for name, shape in shapes.items()}
        decays = [
            self._decay(of["own"][i], of["omega"][i], of["a"][:, i], of["joints"][:, i], of["Jv"]) for i in range(m)
        ]
        given = of | {name: x for name, x in self._symbols.items() if name not in CONFIGURATION}
        return ca.Function("of_known", [*given.values()], [ca.vertcat(*decays)], [*given], ["first_order_decay"])

    def _behind(self, w: ca.SX) -> tuple[ca.SX, ca.SX]:
        """By which angle dead time, hold and filter are behind, and what they leave of the size."""
        s = self._symbols
        half = w * s["period"] / 2
        angle, size = w * s[DEAD_TIME] + half, ca.sin(half) / half
        if self.motions.filtered:
            kept = ca.exp(-2 * math.pi * s["filter_hz"] * s["period"])
            real, imaginary = 1 - kept * ca.cos(2 * half), kept * ca.sin(2 * half)
            angle, size = angle + ca.atan2(imaginary, real), size * (1 - kept) / ca.sqrt(real**2 + imaginary**2)
        return angle, size

    def _servo(self, w: ca.SX) -> RealImaginary:
        """1 / (1 + jω/ω_s) of each joint, (n,)."""
        n = self.motions.plant.n_actuated
        if not self.motions.lagging:
            return ca.SX.ones(n, 1), ca.SX.zeros(n, 1)
        ratio = w / (2 * math.pi * self._symbols["bandwidth_hz"])
        return 1 / (1 + ratio**2), -ratio / (1 + ratio**2)

    def _function(self, name: str, outputs: Mapping[str, ca.SX]) -> ca.Function:
        """A Function of the symbols alone: the modes are found, and held, within it."""
        s, expansion = self._symbols, self.measures.expansion
        served = self.motions.drive_damping * (s["servo_gain"] if self.motions.served else 0)
        dense = [ca.densify(output) for output in outputs.values()]
        inner = ca.Function("inner", [*s.values(), *expansion.held_parts.values()], dense)
        given: dict[str, Any] = {name: ca.MX.sym(name, symbol.shape[0]) for name, symbol in s.items()}
        braked = ca.Function("braked", [s["p"], s["servo_gain"]], [s["p"] + served])
        inside = given | {"p": braked.call([given["p"], given["servo_gain"]])[0]}
        held = expansion.parts(self.measures.hold.call([inside[x] for x in ("base", "posture", "p")])[0])
        found = inner.call([*inside.values(), *held.values()])
        return ca.Function(name, list(given.values()), found, list(given), list(outputs))

    @structural_property
    def values(self) -> ca.Function:
        """-> the measures, by name."""
        return self._function("lagged_modes", self._graphs)

    @structural_property
    def slopes(self) -> ca.Function:
        """-> the derivatives of each measure by each of `INPUTS` and dead_time: `allowance_posture` and the like."""
        s, found = self._symbols, dict[str, ca.SX]()
        chain = {name: s[name] for name in BY}
        for name, graph in self._graphs.items():
            found |= {f"{name}_{by}": ca.jacobian(graph, symbol) for by, symbol in chain.items()}
            # A servo gain is a damper of the joints, too.
            if self.motions.served:
                found[f"{name}_servo_gain"] += found[f"{name}_p"] @ self.motions.drive_damping
        return self._function("lagged_mode_slopes", found)

    def at(
        self, numbers: Mapping[str, Vector], dead_time: float
    ) -> tuple[dict[str, Vector], dict[str, dict[str, Vector]]]:
        """Measures (m,), and the derivative of each by each of `INPUTS` and dead_time, (m, size)."""
        given = self._given(numbers, dead_time)
        values = {name: x.full().ravel() for name, x in zip(self.NAMES, self.values.call(given), strict=True)}
        found = dict(zip(self.slopes.name_out(), self.slopes.call(given), strict=True))
        return values, {name: {by: np.array(found[f"{name}_{by}"]) for by in BY} for name in self.NAMES}

    def _given(self, numbers: Mapping[str, Vector], dead_time: float) -> list[Vector | float]:
        return [dead_time if name == DEAD_TIME else numbers[name] for name in self._symbols]

    def is_unseen(self, numbers: Mapping[str, Vector], decay: float, rounding: float) -> bool:
        """Whether a motion of this decay, 1/s, is a mode that neither moves the end-point nor is excited by it.

        Its decay is its own, whatever the loop.
        """
        size = self.measures.w.call([numbers[name] for name in ("base", "posture", "p")])[1].full().ravel()
        hidden = unreached(size)
        if not hidden.any():
            return False
        given = self._given(numbers, 0.0)
        own = self.values.call(given)[self.NAMES.index("first_order_decay")].full().ravel()[hidden]
        return bool(np.any(np.abs(own - decay) <= OWN * np.abs(own) + rounding))


def _times(x: RealImaginary, y: ca.SX) -> RealImaginary:
    return x[0] * y, x[1] * y


def _product(x: RealImaginary, y: RealImaginary) -> RealImaginary:
    return x[0] * y[0] - x[1] * y[1], x[0] * y[1] + x[1] * y[0]


def _dot(x: Any, y: RealImaginary) -> RealImaginary:
    return ca.dot(x[0], y[0]) - ca.dot(x[1], y[1]), ca.dot(x[0], y[1]) + ca.dot(x[1], y[0])
