"""A realistic recurrence: a chain of bodies on springs under a held joint controller, one RK4 step.

In absolute angles φ with the base translations eliminated: S_ij = s_ij cos(φi − φj) is the inertia, and the same s_ij
with the sine gives the velocity terms. `exact` evaluates cos and sin; `fast` carries them along by small rotations.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

LIMIT = 0.06


@dataclass(frozen=True)
class Chain:
    step: ca.Function
    fast: ca.Function
    refresh: ca.Function
    n: int
    links: int

    def start(self, n_members: int, seed: int = 0) -> np.ndarray:
        return 0.05 * np.random.default_rng(seed).normal(size=(self.n, n_members))

    @property
    def reference(self) -> np.ndarray:
        return np.linspace(0.5, -0.4, self.links)


def _solve(S: list[list[ca.SX]], r: list[ca.SX]) -> list[ca.SX]:
    """S⁻¹ r for a symmetric S by S = L D Lᵀ."""
    n = len(r)
    L: list[list[ca.SX]] = [[ca.SX(0)] * n for _ in range(n)]
    D, inverse, y = [ca.SX(0)] * n, [ca.SX(0)] * n, list(r)
    for j in range(n):
        D[j] = S[j][j] - sum(L[j][k] ** 2 * D[k] for k in range(j))
        inverse[j] = 1 / D[j]
        for i in range(j + 1, n):
            L[i][j] = (S[i][j] - sum(L[i][k] * L[j][k] * D[k] for k in range(j))) * inverse[j]
    for i in range(n):
        y[i] -= sum(L[i][k] * y[k] for k in range(i))
    y = [a * b for a, b in zip(y, inverse, strict=True)]
    for i in reversed(range(n)):
        y[i] -= sum(L[k][i] * y[k] for k in range(i + 1, n))
    return y


def build_chain(links: int = 3, seed: int = 0, h: float = 1e-3) -> Chain:
    rng = np.random.default_rng(seed)
    mass, inertia, length = rng.uniform(1, 5, links), rng.uniform(0.05, 0.3, links), rng.uniform(0.6, 1.4, links)
    com, spring, damping = length * rng.uniform(0.3, 0.7, links), rng.uniform(2e3, 8e3, 2), rng.uniform(2, 20)
    kp, kv = rng.uniform(50, 150, links), rng.uniform(5, 15, links)
    total = mass.sum()
    moment = np.array([mass[i] * com[i] + mass[i + 1 :].sum() * length[i] for i in range(links)])
    s = np.diag([inertia[i] + mass[i] * com[i] ** 2 + mass[i + 1 :].sum() * length[i] ** 2 for i in range(links)])
    for i in range(links):
        for j in range(i + 1, links):
            s[i, j] = s[j, i] = length[i] * moment[j]
    s -= np.outer(moment, moment) / total

    n_q = links + 2
    x, e, c, d = ca.SX.sym("x", 2 * n_q), ca.SX.sym("e", links), ca.SX.sym("c", links), ca.SX.sym("d", 2 * links)
    q, v = x[:n_q], x[n_q:]

    def acceleration(q: ca.SX, v: ca.SX, cos: ca.SX, sin: ca.SX, torque: list[ca.SX]) -> ca.SX:
        force = -spring * q[:2] - damping * v[:2]
        right = [torque[i] + moment[i] / total * (sin[i] * force[0] - cos[i] * force[1]) for i in range(links)]
        S = [[ca.SX(s[i, i])] * links for i in range(links)]
        for i in range(links):
            for j in range(links):
                if i != j:
                    S[i][j] = s[i, j] * (cos[i] * cos[j] + sin[i] * sin[j])
                    right[i] -= s[i, j] * (sin[i] * cos[j] - cos[i] * sin[j]) * v[2 + j] ** 2
        a = _solve(S, right)
        ax = force[0] + sum(moment[i] * (sin[i] * a[i] + cos[i] * v[2 + i] ** 2) for i in range(links))
        ay = force[1] - sum(moment[i] * (cos[i] * a[i] - sin[i] * v[2 + i] ** 2) for i in range(links))
        return ca.vertcat(ax * (1 / total), ay * (1 / total), *a)

    relative = [q[2 + i] - (q[1 + i] if i else 0) for i in range(links)]
    rate = [v[2 + i] - (v[1 + i] if i else 0) for i in range(links)]
    joint = [-kp[i] * (relative[i] - c[i]) - kv[i] * rate[i] + e[i] for i in range(links)]
    torque = [joint[i] - (joint[i + 1] if i + 1 < links else 0) for i in range(links)]

    def turned(angle: ca.SX) -> tuple[ca.SX, ca.SX]:
        """The carried cosines and sines after turning by `angle`."""
        z = angle**2
        sin = angle * (1 + z * (-1 / 6 + z * (1 / 120 - z * (1 / 5040))))
        cos = 1 + z * (-0.5 + z * (1 / 24 + z * (-1 / 720 + z * (1 / 40320))))
        return d[:links] * cos - d[links:] * sin, d[links:] * cos + d[:links] * sin

    def rk4(carried: bool) -> tuple[ca.SX, ca.SX, ca.SX]:
        turns: list[ca.SX] = []

        def rates(dq: ca.SX, dv: ca.SX) -> tuple[ca.SX, ca.SX]:
            turns.append(dq[2:])
            cos, sin = turned(dq[2:]) if carried else (ca.cos(q[2:] + dq[2:]), ca.sin(q[2:] + dq[2:]))
            return v + dv, acceleration(q + dq, v + dv, cos, sin, torque)

        nothing = ca.SX.zeros(n_q)
        k1 = rates(nothing, nothing)
        k2 = rates(h / 2 * k1[0], h / 2 * k1[1])
        k3 = rates(h / 2 * k2[0], h / 2 * k2[1])
        k4 = rates(h * k3[0], h * k3[1])
        dq, dv = (h / 6 * (a + 2 * b + 2 * c + d) for a, b, c, d in zip(k1, k2, k3, k4, strict=True))
        turns.append(dq[2:])
        d_next = ca.vertcat(*turned(dq[2:]))
        return ca.vertcat(q + dq, v + dv), d_next, ca.norm_inf(ca.vertcat(*turns)) * (1 / LIMIT)

    def monitor(x: ca.SX) -> ca.SX:
        return ca.vertcat(ca.norm_2(x[:2]), ca.norm_inf(x[2:n_q]))

    exact, (fast, d_next, turn) = rk4(False)[0], rk4(True)
    names, options = (["x", "e", "c"], ["x_next", "monitor"]), {"cse": True}
    return Chain(
        step=ca.Function("step", [x, e, c], [exact, monitor(exact)], *names, options),
        fast=ca.Function("fast", [x, d, e, c], [fast, d_next, monitor(fast), turn], ["x", "d", "e", "c"],
                         ["x_next", "d_next", "monitor", "turn"], options),
        refresh=ca.Function("refresh", [x, c], [ca.vertcat(ca.cos(q[2:]), ca.sin(q[2:]))], ["x", "c"], ["d"]),
        n=2 * n_q, links=links,
    )  # fmt: skip
