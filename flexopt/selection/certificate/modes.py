"""Every w_i over whole cells: Taylor models of modes and measures from those of K_p, M̄ and F = [A; B].

With X the modes in a cell's middle, H = Xᵀ M̄ X is nearly diagonal and G = Xᵀ K_p X nearly I. Polynomials y_i(t), μ_i(t)
follow order by order from H y = μ G y; what they leave of it, |H y − μ G y| ≤ δ in the cell, bounds their errors:
an eigenvalue is within δ of μ_i, and where the others are a gap away, y_i is within an angle asin(δ / gap) of its
eigenvector (Davis and Kahan, SIAM Journal on Numerical Analysis 7(1), 1970).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from flexopt.compiled.taylor import DEGREE, Array, TaylorModel, dot
from flexopt.robustness.modes import CLUSTER_TOLERANCE

Matrix = list[list[TaylorModel]]
_ONE = TaylorModel.constant(1.0)
# Rounding of a few operations on numbers that are bounds.
_UP = 1.0 + 1e-12
# Frequencies nearer than this, relative, may be one to whoever computes in doubles.
_APART = 2.0 * CLUSTER_TOLERANCE


@dataclass(frozen=True)
class _Mode:
    """A mode in the axes X: y (m,) with y_i = 1, μ = 1/ω², and the bound on its residual, (N,)."""

    y: list[TaylorModel]
    mu: TaylorModel
    residual: Array


def enclosed_measures(stiffness: Matrix, mass: Matrix, factors: Matrix) -> tuple[list[TaylorModel], Array]:
    """The w_i in order of ascending frequency, and how far from each other neighbouring 1/ω² are, relative, (N,).

    Unknown (r infinite) where frequencies come too close in a cell.

    Args:
        stiffness, mass: K_p and M̄ (m, m), the former the same in all cells.
        factors: [A; B], (2r, m), r ≥ 2.
    """
    m, count = len(mass), max(x.c.shape[1] for row in mass for x in row)
    axes = _modes_in_the_middle(stiffness, mass, count)
    h, g, f = (_times(_turned(axes, left, x), axes) for left, x in ((True, mass), (True, stiffness), (False, factors)))
    off = np.sqrt(sum((g[i][j] - (_ONE if i == j else _ONE - _ONE)).largest ** 2 for i in range(m) for j in range(m)))
    off = np.broadcast_to(off * _UP, (count,))
    modes = [_mode(h, g, i, off) for i in range(m)]
    apart, least = np.full((m, count), np.inf), np.full(count, np.inf)
    for i, j in combinations(range(m), 2):
        between = (modes[i].mu - modes[j].mu).bounds[0]
        others = (modes[j].residual, modes[i].residual)
        for k, residual in zip((i, j), others, strict=True):
            apart[k] = np.minimum(apart[k], between * (1 - 1e-12) - residual)
        true = between - modes[i].residual - modes[j].residual
        least = np.minimum(least, true / modes[i].mu.largest)
    n_task = len(f) // 2
    sizes = [np.sqrt(sum(x.largest**2 for row in part for x in row)) * _UP for part in (f[:n_task], f[n_task:])]
    return [_measure(mode, f, g, apart[i], least, off, sizes) for i, mode in enumerate(modes)], least


def _modes_in_the_middle(stiffness: Matrix, mass: Matrix, count: int) -> Array:
    """X (m, m, N): the modes in the cells' middles with Xᵀ K_p X = I, by ascending frequency."""
    k, m0 = (
        np.array([[np.broadcast_to(x.c[0], (count,)) for x in row] for row in rows]).transpose(2, 0, 1)
        for rows in (stiffness, mass)
    )
    usable = np.all(np.isfinite(k), axis=(1, 2)) & np.all(np.isfinite(m0), axis=(1, 2))
    k, m0 = (np.where(usable[:, None, None], x, np.eye(len(mass))) for x in (k, m0))
    inverse = np.linalg.inv(np.linalg.cholesky(k))
    _, vectors = np.linalg.eigh(inverse @ m0 @ inverse.transpose(0, 2, 1))
    return (inverse.transpose(0, 2, 1) @ vectors[:, :, ::-1]).transpose(1, 2, 0)


def _turned(axes: Array, left: bool, rows: Matrix) -> Matrix:
    """Xᵀ R, or R where `left` is not wanted."""
    if not left:
        return rows
    columns = list(zip(*rows, strict=True))
    return [[_combined(axes[:, i], column) for column in columns] for i in range(axes.shape[1])]


def _times(rows: Matrix, axes: Array) -> Matrix:
    return [[_combined(axes[:, j], row) for j in range(axes.shape[1])] for row in rows]


def _combined(numbers: Array, models: list[TaylorModel] | tuple[TaylorModel, ...]) -> TaylorModel:
    total, *others = (model.scaled(number, 0.0) for number, model in zip(numbers, models, strict=True))
    for other in others:
        total = total + other
    return total


def _mode(h: Matrix, g: Matrix, i: int, off: Array) -> _Mode:
    """The i-th mode's polynomials, and what they leave of H y = μ G y in the norm of G."""
    m, count = len(h), off.size
    c = np.zeros((DEGREE + 1, m, m, count))
    for j in range(m):
        for k in range(m):
            c[: len(h[j][k].c), j, k] = h[j][k].c
    y, mu = np.zeros((DEGREE + 1, m, count)), np.zeros((DEGREE + 1, count))
    y[0, i], mu[0] = 1.0, c[0, i, i]
    with np.errstate(all="ignore"):
        for order in range(1, DEGREE + 1):
            pushed = sum(np.einsum("jkn,kn->jn", c[k], y[order - k]) for k in range(1, order + 1))
            mu[order] = pushed[i]
            rest = pushed - sum((mu[k] * y[order - k] for k in range(1, order)), start=np.zeros((m, count)))
            for j in range(m):
                if j != i:
                    y[order, j] = rest[j] / (mu[0] - c[0, j, j])
    y, mu = np.nan_to_num(y), np.nan_to_num(mu)
    exact = np.zeros(count)
    models = [_ONE if j == i else TaylorModel(y[:, j], exact) for j in range(m)]
    value = TaylorModel(mu, exact)
    left = [dot(h[j], models) - value * dot(g[j], models) for j in range(m)]
    with np.errstate(all="ignore"):
        residual = np.sqrt(sum(x.largest**2 for x in left)) / (1.0 - off) * _UP
    return _Mode(models, value, np.where((off < 0.1) & np.isfinite(residual), residual, np.inf))


def _measure(
    mode: _Mode, f: Matrix, g: Matrix, apart: Array, least: Array, off: Array, sizes: list[Array]
) -> TaylorModel:
    """W = (a·b − |a||b|) / (μ yᵀ G y) with a = A X y, b = B X y, and what the mode's error does to them."""
    with np.errstate(all="ignore"):
        sine = np.where((apart > 0) & (least > _APART), mode.residual / apart, np.inf)
        sine = np.where(sine < 0.5, sine, np.inf)
        tangent = sine / np.sqrt(1.0 - sine * sine) * _UP
        length = np.sqrt(sum(x.largest**2 for x in mode.y) * (1.0 + off) / (1.0 - off)) * _UP
    n_task = len(f) // 2
    a, b = (
        [dot(row, mode.y).widened(tangent * length * size) for row in rows]
        for rows, size in zip((f[:n_task], f[n_task:]), sizes, strict=True)
    )
    square = dot(mode.y, [dot(row, mode.y) for row in g])
    share = (mode.mu.widened(mode.residual) * square).inverse()
    short = sine * sine
    share = share * TaylorModel((1.0 - short / 2)[None, :], short / 2 * _UP) if np.all(np.isfinite(short)) else (
        share * TaylorModel(np.where(np.isfinite(short), 1.0 - short / 2, 0.0)[None, :], short * _UP)
    )  # fmt: skip
    product = (dot(a, a) * dot(b, b)).sqrt()
    return _not_positive((dot(a, b) - product) * share, a, b, share)


def _not_positive(w: TaylorModel, a: list[TaylorModel], b: list[TaylorModel], share: TaylorModel) -> TaylorModel:
    """W, and where it has a kink, at |a| or |b| = 0, what is known of it anyway: −2|a||b| ≤ a·b − |a||b| ≤ 0."""
    with np.errstate(all="ignore"):
        size = np.sqrt(sum(x.largest**2 for x in a) * sum(x.largest**2 for x in b)) * share.largest * _UP
    known = TaylorModel.between(-2.0 * size, np.zeros_like(size))
    crude = ~np.isfinite(w.r) & np.isfinite(size)
    return TaylorModel(np.where(crude, 0.0, w.c) + _first(crude, known.c), np.where(crude, known.r, w.r))


def _first(where: Array, c: Array) -> Array:
    """Coefficients that are c_0 in some cells, and 0 else."""
    found = np.zeros((DEGREE + 1, where.size))
    found[0] = np.where(where, c[0], 0.0)
    return found
