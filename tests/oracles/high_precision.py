"""ε_max and its directional derivatives in ball arithmetic of 420 bits (FLINT): another way than flexopt's throughout.

The plant's graph is evaluated instruction by instruction; X and Z come from the sign function of the Hamiltonian, λmax(XZ)
from its eigenvalues, derivatives from differences over a step of 1e-50.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca
import flint
import numpy as np
import scipy.linalg
from flint import acb_mat, arb, arb_mat

from flexopt.robustness.margin import Margin
from flexopt.robustness.posture_margin import PostureMargin, evaluate_margin

BITS = 420
flint.ctx.prec = BITS
STEP = arb(10) ** -50
OPERATIONS = {
    ca.OP_ADD: lambda a, b: a + b,
    ca.OP_SUB: lambda a, b: a - b,
    ca.OP_MUL: lambda a, b: a * b,
    ca.OP_DIV: lambda a, b: a / b,
    ca.OP_NEG: lambda a, b: -a,
    ca.OP_SQ: lambda a, b: a * a,
    ca.OP_TWICE: lambda a, b: a + a,
    ca.OP_INV: lambda a, b: 1 / a,
    ca.OP_SQRT: lambda a, b: a.sqrt(),
    ca.OP_SIN: lambda a, b: a.sin(),
    ca.OP_COS: lambda a, b: a.cos(),
    ca.OP_FABS: lambda a, b: abs(a),
    ca.OP_ATAN2: arb.atan2,
}


def balls(values) -> list[arb]:
    # Whatever else works with balls in this process may have left another precision.
    flint.ctx.prec = BITS
    return [x if isinstance(x, arb) else arb(float(x)) for x in np.asarray(values, dtype=object).ravel()]


def evaluate_graph(function: ca.Function, inputs: list[list[arb]]) -> list[arb_mat]:
    """Outputs of an expanded, dense Function."""
    flint.ctx.prec = BITS
    work: dict[int, arb] = {}
    outputs = [[arb(0)] * function.numel_out(k) for k in range(function.n_out())]
    for k in range(function.n_instructions()):
        operation, out, given = (
            function.instruction_id(k),
            function.instruction_output(k),
            function.instruction_input(k),
        )
        if operation == ca.OP_INPUT:
            work[out[0]] = inputs[given[0]][given[1]]
        elif operation == ca.OP_CONST:
            work[out[0]] = arb(function.instruction_constant(k))
        elif operation == ca.OP_OUTPUT:
            outputs[out[0]][out[1]] = work[given[0]]
        else:
            work[out[0]] = OPERATIONS[operation](work[given[0]], work[given[-1]])
    shapes = [function.size_out(k) for k in range(function.n_out())]
    return [
        arb_mat([[flat[j * rows + i] for j in range(columns)] for i in range(rows)])
        for flat, (rows, columns) in zip(outputs, shapes, strict=True)
    ]


def _middle(matrix: arb_mat) -> arb_mat:
    return arb_mat([[x.mid() for x in row] for row in matrix.tolist()])


def _largest(matrix: arb_mat) -> float:
    return max(abs(float(x.mid())) for row in matrix.tolist() for x in row)


def _blocks(rows: list[list[arb_mat]]) -> arb_mat:
    return arb_mat([[x for m in row for x in m.tolist()[i]] for row in rows for i in range(row[0].nrows())])


def _sign(matrix: arb_mat) -> arb_mat:
    """Newton's iteration for the matrix sign function, scaled by the determinant at first."""
    n = matrix.nrows()
    for k in range(400):
        inverse = _middle(matrix.inv())
        by = arb(1)
        if k < 60:
            log = float(abs(matrix.det()).log().mid()) / n
            by = (arb(log)).exp().mid() if abs(log) > 1e-3 else arb(1)
        following = _middle((matrix / by + inverse * by) / 2)
        change = _largest(following - matrix) / _largest(following)
        matrix = following
        if change < 1e-90:
            return matrix
    raise ArithmeticError("the sign iteration does not converge")


def epsilon(a: arb_mat, b: arb_mat, c: arb_mat) -> arb:
    """ε_max of (A, B, C), D = 0."""
    n = a.nrows()
    hamiltonian = _blocks([[a, -(b * b.transpose())], [-(c.transpose() * c), -a.transpose()]])
    rows = _sign(hamiltonian).tolist()
    up = arb_mat([[rows[i][j] for j in range(n)] for i in range(2 * n)])
    low = arb_mat([[rows[i][j + n] for j in range(n)] for i in range(2 * n)])
    eye = arb_mat([[1 if i % n == j else 0 for j in range(n)] for i in range(n)])
    zero = arb_mat(n, n)
    first, second = _blocks([[eye], [zero]]), _blocks([[zero], [eye]])

    def least_squares(matrix: arb_mat, right: arb_mat) -> arb_mat:
        return _middle((matrix.transpose() * matrix).solve(matrix.transpose() * right))

    x = least_squares(low + second, -(up + first))
    z = least_squares(up - first, low - second)
    product = _middle(x * z)
    values = acb_mat(product).eig(algorithm="approx")
    return 1 / (1 + max((v.real.mid() for v in values), key=float)).sqrt()


def _without_unseen(a: arb_mat, b: arb_mat, c: arb_mat) -> tuple[arb_mat, arb_mat, arb_mat]:
    """The plant without states x with A x = 0 and C x = 0: the free motion of a redundant arm, where it is undamped.

    Coordinates are those of the orthogonal complement of the kernel of [A; C].
    """
    rows = a.tolist() + c.tolist()
    n = a.nrows()
    stacked = arb_mat(rows)
    plain = np.array([[float(x.mid()) for x in row] for row in rows])
    plain = plain / np.abs(plain).max(axis=0)
    rank = int(np.linalg.matrix_rank(plain, tol=1e-13 * np.linalg.norm(plain)))
    if rank == n:
        return a, b, c
    # Rows of the stacked matrix span the complement of its kernel: ξ = Q x with Q some `rank` independent rows.
    chosen = scipy.linalg.qr(plain.T, pivoting=True, mode="r")[1][:rank]
    q = arb_mat([stacked.tolist()[int(i)] for i in chosen])
    right = q.transpose() * (q * q.transpose()).inv()
    return _middle(q * a * right), _middle(q * b), _middle(c * right)


class MarginOracle:
    """ε_max of a `Margin` at a posture, for the machine's numbers taken as exact."""

    def __init__(self, margin, base, posture, kr: float) -> None:
        self.margin = margin
        p = margin.plant.parameter_values.full().ravel()
        held = margin.hold.call([base, posture, p, kr])[0]
        deflection, rate, forward = (x.full() for x in margin.coordinates.call([held]))
        if not np.all(np.isfinite(forward)):
            forward, rate = np.eye(len(forward)), np.ones((1, 1))
        # Coordinates near unity, for the sign iteration; which ones does not matter.
        self.deflection, self.rate, self.forward = balls(deflection), arb(float(rate[0, 0])), forward
        self.point = [balls(x) for x in (base, posture, p, [kr])]

    def value(self, shift: list[np.ndarray] | None = None) -> arb:
        """ε_max at the point moved by STEP · shift (base, posture, p, kr)."""
        at = self.point
        if shift is not None:
            at = [[x + STEP * float(s) for x, s in zip(xs, ss, strict=True)] for xs, ss in zip(at, shift, strict=True)]
        a, b, c = evaluate_graph(self.margin.plant_at, [*at[:3], self.deflection])
        t = arb_mat(self.forward.tolist())
        back = t.inv()
        a, b = back * a * t / self.rate, back * b * (at[3][0] / self.rate)
        return epsilon(*_without_unseen(_middle(a), _middle(b), _middle(c * t)))

    def slope(self, here: arb, shift: list[np.ndarray]) -> float:
        """Derivative along `shift`."""
        return float(((self.value(shift) - here) / STEP).mid())


@dataclass(frozen=True)
class Comparison:
    """What `evaluate_margin` gives beside the oracle: errors and bounds of ε_max, and of two directional derivatives.

    `epsilon` is the oracle's, NaN where it has none; `found` is flexopt's answer.
    """

    found: PostureMargin
    epsilon: float
    error: float
    slopes: tuple[tuple[float, float, float], ...]  # derivative, its error, its bound

    @property
    def within(self) -> bool:
        """Whether every number told is within its bound; what the oracle itself rounds to a double is allowed."""
        if self.found.epsilon_max is None:
            return not self.found.unstabilizable or not self.epsilon > 1e-12
        told = [(e, bound, value) for value, e, bound in self.slopes if np.isfinite(value)]
        return self.error <= self.found.error and all(e <= bound + 2.0**-52 * abs(value) for e, bound, value in told)

    @property
    def complete(self) -> bool:
        """Whether ε_max and its gradient are there."""
        return self.found.epsilon_max is not None and bool(np.all(np.isfinite(self.found.z)))


def compare(margin: Margin, base, posture, kr: float, seed: int) -> Comparison:
    """flexopt's answer and the oracle's; derivatives along a random direction of placement and joints, and of p and kr."""
    found = evaluate_margin(margin, base, posture, kr)
    oracle = MarginOracle(margin, base, posture, kr)
    try:
        here = oracle.value()
    except (ZeroDivisionError, ArithmeticError):
        return Comparison(found, math.nan, math.nan, ())
    if found.epsilon_max is None:
        return Comparison(found, float(here), math.nan, ())
    rng = np.random.default_rng(seed)
    p = margin.plant.parameter_values.full().ravel()
    none = [np.zeros(len(base)), np.zeros(len(posture)), np.zeros(len(p)), np.zeros(1)]
    z = [rng.normal(size=len(base)), rng.normal(size=len(posture)), *none[2:]]
    by_p = [*none[:2], p * rng.normal(size=len(p)), np.array([kr])]
    slopes = []
    gradient = np.concatenate([found.z, found.p, [found.kr]])
    errors = np.concatenate([found.z_error, found.p_error, [found.kr_error]])
    for shift in (z, by_p):
        along = np.concatenate(shift)
        value, bound = float(gradient @ along), float(errors @ np.abs(along))
        # The sum itself is rounded.
        bound += 2.0**-50 * float(np.abs(gradient) @ np.abs(along))
        slopes.append((value, abs(value - oracle.slope(here, shift)), bound))
    return Comparison(found, float(here), abs(float((here - found.epsilon_max).mid())), tuple(slopes))
