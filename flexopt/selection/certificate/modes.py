"""Every w_i over whole cells: Taylor models of modes and measures from those of K_p, M̄ and F = [A; B].

With X the modes in a cell's middle, H = Xᵀ M̄ X is nearly diagonal there and G = Xᵀ K_p X nearly I. Polynomials Y(t),
found order by order from H y = μ G y, make Ĥ = Yᵀ H Y and Ĝ = Yᵀ G Y nearly diagonal in the whole cell. What is left
beside their diagonals proves the rest: where the equations of an eigenvector e_i + e of Ĥ v = μ Ĝ v, solved for e_j by
its diagonal, map a box |e_j| ≤ E_j into itself, the box holds a solution (Brouwer); m of them whose eigenvalues are
apart are all there are. Bounds by components, not by norms, keep what stiff and soft modes have in common small.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from flexopt.compiled.taylor import DEGREE, FloatArray, TaylorModel, dot
from flexopt.robustness.modes import CLUSTER_TOLERANCE

TaylorMatrix = list[list[TaylorModel]]
_ONE = TaylorModel.constant(1.0)
# Rounding of a few operations on numbers that are bounds.
_UP = 1.0 + 1e-12
# Frequencies nearer than this, relative, may be one to whoever computes in doubles.
_APART = 2.0 * CLUSTER_TOLERANCE
# Steps that improve the modes in the middle, whose small parts eigenvalue solvers round.
_IMPROVED = 2


@dataclass(frozen=True)
class _Nearly:
    """Ĥ and Ĝ, bounds on their entries' absolute values (m, m, N), and the eigenvalues' models μ̂_i = Ĥ_ii / Ĝ_ii."""

    h: TaylorMatrix
    g: TaylorMatrix
    sizes_h: FloatArray
    sizes_g: FloatArray
    mu: list[TaylorModel]


@np.errstate(all="ignore")
def enclosed_measures(stiffness: TaylorMatrix, mass: TaylorMatrix, factors: TaylorMatrix) -> list[TaylorModel]:
    """The w_i in order of ascending frequency.

    Unknown (r infinite) where frequencies come too close in a cell.

    Args:
        stiffness, mass: K_p and M̄ (m, m), the former the same in all cells.
        factors: [A; B], (2r, m), r ≥ 2.
    """
    m, count = len(mass), max(x.c.shape[1] for row in mass for x in row)
    middle = _modes_in_the_middle(stiffness, mass, count)
    h, g = (_symmetric(_transposed(_turned(_transposed(_turned(x, middle)), middle))) for x in (mass, stiffness))
    shapes = _shapes(h, count)
    nearly = _nearly_diagonal(h, g, shapes, count)
    f = _product(_turned(factors, middle), shapes)
    boxes = [_box(nearly, i) for i in range(m)]
    # How far from each other 1/ω² are, relative, from below.
    least = np.full(count, np.inf)
    for i, j in combinations(range(m), 2):
        between = (nearly.mu[i] - nearly.mu[j]).bounds[0] * (1 - 1e-12) - boxes[i][1] - boxes[j][1]
        least = np.minimum(least, between / nearly.mu[i].largest)
    known = np.where(least > _APART, 0.0, np.inf)
    return [_measure(nearly, f, i, np.maximum(boxes[i][0], known)) for i in range(m)]


def _modes_in_the_middle(stiffness: TaylorMatrix, mass: TaylorMatrix, count: int) -> FloatArray:
    """X (m, m, N): the modes in the cells' middles with Xᵀ K_p X = I, by ascending frequency."""
    k, m0 = (
        np.array([[np.broadcast_to(x.c[0], (count,)) for x in row] for row in rows]).transpose(2, 0, 1)
        for rows in (stiffness, mass)
    )
    usable = np.all(np.isfinite(k), axis=(1, 2)) & np.all(np.isfinite(m0), axis=(1, 2))
    k, m0 = (np.where(usable[:, None, None], x, np.eye(len(mass))) for x in (k, m0))
    inverse = np.linalg.inv(np.linalg.cholesky(k.astype(float)))
    _, vectors = np.linalg.eigh(inverse @ m0.astype(float) @ inverse.transpose(0, 2, 1))
    x = inverse.transpose(0, 2, 1) @ vectors[:, :, ::-1]
    for _ in range(_IMPROVED):
        h, g = (x.transpose(0, 2, 1) @ matrix @ x for matrix in (m0, k))
        mu = np.diagonal(h, axis1=1, axis2=2) / np.diagonal(g, axis1=1, axis2=2)
        step = (h - mu[:, None, :] * g) / (mu[:, None, :] - mu[:, :, None])
        better = x @ (np.eye(len(mass)) + np.where(np.abs(step) < 0.5, step, 0.0))
        x = better / np.sqrt(np.einsum("nji,njk,nki->ni", better, k, better))[:, None, :]
    return x.transpose(1, 2, 0)


def _transposed(rows: TaylorMatrix) -> TaylorMatrix:
    return [list(column) for column in zip(*rows, strict=True)]


def _symmetric(rows: TaylorMatrix) -> TaylorMatrix:
    """The same with what is above the diagonal below it, too."""
    return [[rows[min(i, j)][max(i, j)] for j in range(len(rows))] for i in range(len(rows))]


def _turned(rows: TaylorMatrix, axes: FloatArray) -> TaylorMatrix:
    """Rows times a matrix of numbers (m, m, N)."""
    return [[_combined(axes[:, j], row) for j in range(axes.shape[1])] for row in rows]


def _combined(numbers: FloatArray, models: list[TaylorModel]) -> TaylorModel:
    total, *others = (model.scaled(number) for number, model in zip(numbers, models, strict=True))
    for other in others:
        total = total + other
    return total


def _product(rows: TaylorMatrix, others: TaylorMatrix) -> TaylorMatrix:
    return [[dot(row, column) for column in _transposed(others)] for row in rows]


def _shapes(h: TaylorMatrix, count: int) -> TaylorMatrix:
    """Y (m, m), exact polynomials with Y_ii = 1: the modes in the axes X, to rounding and the degree kept."""
    m = len(h)
    kind = h[0][0].c.dtype
    c = np.zeros((DEGREE + 1, m, m, count), dtype=kind)
    for j in range(m):
        for k in range(m):
            c[: len(h[j][k].c), j, k] = h[j][k].c
    shapes: TaylorMatrix = [[_ONE] * m for _ in range(m)]
    for i in range(m):
        y, mu = np.zeros((DEGREE + 1, m, count), dtype=kind), np.zeros((DEGREE + 1, count), dtype=kind)
        y[0, i], mu[0] = 1.0, c[0, i, i]
        for order in range(1, DEGREE + 1):
            pushed = np.einsum("ojkn,okn->jn", c[1 : order + 1], y[order - 1 :: -1][:order])
            mu[order] = pushed[i]
            rest = pushed - sum((mu[k] * y[order - k] for k in range(1, order)), start=np.zeros((m, count)))
            for j in range(m):
                if j != i:
                    y[order, j] = rest[j] / (mu[0] - c[0, j, j])
        y = np.nan_to_num(y, posinf=0.0, neginf=0.0)
        for j in range(m):
            if j != i:
                shapes[j][i] = TaylorModel(y[:, j], np.zeros(count))
    return shapes


def _nearly_diagonal(h: TaylorMatrix, g: TaylorMatrix, shapes: TaylorMatrix, count: int) -> _Nearly:
    """Ĥ and Ĝ."""
    turned = _transposed(shapes)
    h, g = (_product(turned, _product(x, shapes)) for x in (h, g))
    sizes_h, sizes_g = (
        np.array([[np.broadcast_to(x.largest, (count,)) for x in row] for row in each]) for each in (h, g)
    )
    mu = [h[i][i] * g[i][i].inverse() for i in range(len(h))]
    return _Nearly(h, g, sizes_h, sizes_g, mu)


def _box(nearly: _Nearly, i: int) -> tuple[FloatArray, FloatArray]:
    """Bounds E (m, N) on e, 0 of e_i, and on the error of μ̂_i, (N,); infinite where no box maps into itself."""
    m, count = len(nearly.h), nearly.sizes_g.shape[-1]
    mu, others = nearly.mu[i], [j for j in range(m) if j != i]
    off = (nearly.sizes_h + mu.largest * nearly.sizes_g) * _UP
    off[i, i] = (nearly.h[i][i] - mu * nearly.g[i][i]).largest
    gap = np.full((m, count), np.inf)
    for j in others:
        low, high = (nearly.h[j][j] - mu * nearly.g[j][j]).bounds
        gap[j] = np.maximum(np.maximum(low, -high), 0.0) * (1 - 1e-12)
    own = nearly.g[i][i].bounds[0]

    def mapped(e: FloatArray) -> tuple[FloatArray, FloatArray]:
        moved = off[i, i] + sum((off[i, j] * e[j] for j in others), start=np.zeros(count))
        least = own * (1 - 1e-12) - sum((nearly.sizes_g[i, j] * e[j] for j in others), start=np.zeros(count)) * _UP
        shift = np.where(least > 0, moved / least, np.inf) * _UP
        found = np.zeros((m, count))
        for j in others:
            pushed = off[j, i] + sum((off[j, k] * e[k] for k in others if k != j), start=np.zeros(count))
            along = nearly.sizes_g[j, i] + sum((nearly.sizes_g[j, k] * e[k] for k in others), start=np.zeros(count))
            found[j] = (pushed + shift * along) / gap[j] * _UP + 1e-290
        return found, shift

    box = 2.0 * mapped(mapped(np.zeros((m, count)))[0])[0]
    found, shift = mapped(box)
    holds = np.all((found <= box) & np.isfinite(box), axis=0) & np.isfinite(shift)
    return np.where(holds, box, np.inf), np.where(holds, shift, np.inf)


def _measure(nearly: _Nearly, f: TaylorMatrix, i: int, box: FloatArray) -> TaylorModel:
    """W = (a·b − |a||b|) / (vᵀ H v) with a = A v, b = B v of the eigenvector v, whatever it is in its box."""
    m, n_task = len(nearly.h), len(f) // 2
    others = [j for j in range(m) if j != i]
    ends = [
        row[i].widened(sum((row[j].largest * box[j] for j in others), start=np.zeros(box.shape[1])) * _UP) for row in f
    ]
    sizes = nearly.sizes_h
    short = sum((sizes[j, k] * box[j] * box[k] for j in others for k in others), start=np.zeros(box.shape[1]))
    short = short + sum((2.0 * sizes[i, j] * box[j] for j in others), start=np.zeros(box.shape[1]))
    share = nearly.h[i][i].widened(short * _UP).inverse()
    a, b = ends[:n_task], ends[n_task:]
    product = (dot(a, a) * dot(b, b)).sqrt()
    return _not_positive((dot(a, b) - product) * share, a, b, share)


def _not_positive(w: TaylorModel, a: list[TaylorModel], b: list[TaylorModel], share: TaylorModel) -> TaylorModel:
    """W, and where it has a kink, at |a| or |b| = 0, what is known of it anyway: −2|a||b| ≤ a·b − |a||b| ≤ 0."""
    size = np.sqrt(sum(x.largest**2 for x in a) * sum(x.largest**2 for x in b)) * share.largest * _UP
    known = TaylorModel.between(-2.0 * size, np.zeros_like(size))
    crude = ~np.isfinite(w.r) & np.isfinite(size)
    c = np.where(crude, 0.0, w.c)
    c[0] += np.where(crude, known.c[0], 0.0)
    return TaylorModel(c, np.where(crude, known.r, w.r))
