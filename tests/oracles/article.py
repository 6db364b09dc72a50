"""Residues of the article's machine in plain NumPy, and by them all its postures with two measures zero, by brute force.

Nothing of flexopt enters: Table 1's numbers, all five coordinates, LAPACK's eigenvectors, SciPy's solver.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import scipy.optimize


def article(boom: Any, stick: Any, control: str) -> tuple[Any, Any]:
    """a_i and b_i, (N, 2, 3), of the article's Table 1 in plain NumPy: all coordinates, no reduction, no closed form.

    Under inverse control b_i times det Jv = l_1 l_2 sin θ3.
    """
    lb, lgb, l1, lg1, l2, lg2 = 0.541, 0.563, 1.918, 1.067, 1.097, 0.613
    t1 = np.full(np.shape(boom), 1.2451)
    t12, t123 = t1 + boom, t1 + boom + stick
    zero, one = np.zeros_like(t1), np.ones_like(t1)

    def turned(angle: Any, length: float) -> Any:
        """How a bar's end moves when it turns."""
        return length * np.stack([-np.sin(angle), np.cos(angle)])

    def jacobian(*bars: tuple[Any, float, int]) -> Any:
        """Of a point at the end of bars that turn with θ1 to θ_k, by q, (N, 2, 5)."""
        columns = [np.stack([one, zero]), np.stack([zero, one])]
        columns += [sum((turned(a, x) for a, x, k in bars if k >= j), start=np.zeros((2, *t1.shape))) for j in range(3)]
        return np.moveaxis(np.array(columns), (0, 1), (-1, -2))

    base, boom_, tip = (t1, lb, 0), (t12, l1, 1), (t123, l2, 2)
    bodies = [
        (5291.5, 1020.7, jacobian((t1, lgb, 0)), [0, 0, 1, 0, 0]),
        (766.6, 214.9, jacobian(base, (t12, lg1, 1)), [0, 0, 1, 1, 0]),
        (458.2, 93.6, jacobian(base, boom_, (t123, lg2, 2)), [0, 0, 1, 1, 1]),
    ]
    mass = sum(m * np.swapaxes(j, -1, -2) @ j + i * np.outer(r, r) for m, i, j, r in bodies)
    root = np.linalg.inv(np.linalg.cholesky(mass))
    stiffness = root @ np.diag([4e7, 4e7, 1.112e6, 0, 0]) @ np.swapaxes(root, -1, -2)
    modes = (np.swapaxes(root, -1, -2) @ np.linalg.eigh(stiffness)[1])[..., 2:]
    j = jacobian(base, boom_, tip)
    jv = j[..., 3:]
    cofactors = np.stack([[jv[..., 1, 1], -jv[..., 1, 0]], [-jv[..., 0, 1], jv[..., 0, 0]]])
    on_joints = jv if control == "transpose" else np.moveaxis(cofactors, (0, 1), (-2, -1))
    return j @ modes, on_joints @ modes[..., 3:, :]


def products(boom: Any, stick: Any, control: str) -> tuple[Any, Any]:
    """a × b, with b as `article` has it, and a·b with its own sign, (N, 3)."""
    a, b = article(boom, stick, control)
    sign = np.sign(np.sin(stick))[..., None] if control == "inverse" else 1.0
    cross = a[..., 0, :] * b[..., 1, :] - a[..., 1, :] * b[..., 0, :]
    return cross, np.sum(a * b, axis=-2) * sign


LINE = -np.pi + 2 * np.pi * (np.arange(401) + 0.37) / 400


@cache
def _grid(control: str) -> Any:
    """Cross products of all modes over the grid."""
    return products(*np.meshgrid(LINE, LINE, indexing="ij"), control)[0]


def brute_force(control: str, i: int, j: int) -> Any:
    """All postures with w_i = w_j = 0: cells of a 400 × 400 grid where both cross products change sign, then a solver."""
    cross = _grid(control)[..., [i, j]]
    positive = cross > 0
    corners = [positive[:-1, :-1], positive[1:, :-1], positive[:-1, 1:], positive[1:, 1:]]
    changes = np.all(np.any(corners, axis=0) & ~np.all(corners, axis=0), axis=-1)
    found: list[Any] = []
    for row, column in np.argwhere(changes):
        start = np.array([LINE[row], LINE[column]]) + np.pi / 400
        scale = np.abs(cross[row : row + 2, column : column + 2]).max(axis=(0, 1))

        def both(z: Any, scale: Any = scale) -> Any:
            return products(z[:1], z[1:], control)[0][0, [i, j]] / scale

        z, _, status, _ = scipy.optimize.fsolve(both, start, full_output=True, xtol=1e-13)
        robust = products(z[:1], z[1:], control)[1][0, [i, j]] > 0
        if status == 1 and np.abs(z - start).max() < 0.1 and robust.all() and abs(np.sin(z[1])) > 1e-3:
            z = np.mod(z + np.pi, 2 * np.pi) - np.pi
            if all(np.abs(z - known).max() > 1e-6 for known in found):
                found.append(z)
    return np.array(sorted(map(tuple, found)))
