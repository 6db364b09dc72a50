"""Symmetric eigenproblems of any size as SX graphs.

The iteration (`symmetric_eigen`) and the closed form (`direct_eigen`) are meant for values only: derivatives come from
`flexopt.algebra.expansion`.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca

from flexopt.algebra.dense import TINY, safe_norm

ROUNDING = 1.1e-16
# A full matrix hardly ever settles in fewer sweeps.
SURE_SWEEPS = 4

# 2 cos(acos(h) / 3) for h in [0, 1], to 1.2e-6: coefficients of h⁰, h¹, …
_THIRD_OF_ANGLE = (1.73205196, 0.33324513, -0.09510725, 0.04395557, -0.01810834, 0.00396381)


def symmetric_eigen(matrix: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Eigenvalues (m, 1), ascending, and eigenvectors (m, m) of a symmetric matrix, by cyclic Jacobi sweeps.

    Jacobi keeps the relative accuracy of small eigenvalues of graded positive definite matrices (Demmel and Veselić,
    1992), which soft and stiff base directions side by side produce. The number of sweeps is fixed, so the graph has
    no branches.
    """
    size = matrix.shape[0]
    first, sweep, order = _steps(size)
    state = first.call([ca.densify(matrix)])
    for _ in range(1, _sweeps(size)):
        state = sweep.call(state)
    values, vectors = order.call(state)
    return values, vectors


@lru_cache(maxsize=8)
def called_eigen(size: int) -> ca.Function:
    """A symmetric matrix (size, size) -> what `symmetric_eigen` gives, by calls of one sweep: a fraction of its C.

    Sweeps that would change nothing are left out.
    """
    _, sweep, order = _steps(size)
    a, vectors = ca.SX.sym("A", size, size), ca.SX.sym("V", size, size)
    settled = ca.Function("settled", [a], [_settled(a)])
    as_it_is = ca.Function("as_it_is", [a, vectors], [a, vectors])
    sweep_unless = ca.Function.if_else("sweep_unless", as_it_is, sweep)
    matrix = ca.MX.sym("matrix", size, size)
    state = [matrix, ca.densify(ca.MX.eye(size))]
    for k in range(_sweeps(size)):
        state = sweep.call(state) if k < SURE_SWEEPS else sweep_unless.call([settled.call(state[:1])[0], *state])
    return ca.Function("symmetric_eigen", [matrix], order.call(state), ["matrix"], ["values", "vectors"])


@lru_cache(maxsize=8)
def _steps(size: int) -> tuple[ca.Function, ca.Function, ca.Function]:
    """A matrix -> itself and the unit matrix after one sweep; with vectors -> the same; and -> both in order."""
    a, vectors = ca.SX.sym("A", size, size), ca.SX.sym("V", size, size)
    sweep = ca.Function("sweep", [a, vectors], [ca.densify(x) for x in _sweep(a, vectors)], {"cse": True})
    # The zeros of the unit matrix fold.
    first = ca.Function("first_sweep", [a], sweep.call([a, ca.densify(ca.SX.eye(size))]), {"cse": True})
    order = ca.Function("ascending", [a, vectors], list(_sorted(ca.diag(a), vectors)), {"cse": True})
    return first, sweep, order


def _sweeps(size: int) -> int:
    return {1: 0, 2: 1, 3: 5, 4: 6}.get(size, 8 + size // 4)


def _sweep(a: ca.SX, vectors: ca.SX) -> tuple[ca.SX, ca.SX]:
    for p in range(a.shape[0] - 1):
        for q in range(p + 1, a.shape[0]):
            a, vectors = _rotate(a, vectors, p, q)
    return a, vectors


def _negligible(a: ca.SX, p: int, q: int) -> ca.SX:
    """Whether a[p, q] is below the rounding: noise must not turn a pair of equal values, which would refill zeros."""
    return a[p, q] ** 2 <= ROUNDING**2 * ca.fabs(a[p, p] * a[q, q])


def _settled(a: ca.SX) -> ca.SX:
    """1 where a sweep would change nothing, else 0."""
    pairs = [(p, q) for q in range(a.shape[0]) for p in range(q)]
    return sum((_negligible(a, p, q) for p, q in pairs), start=ca.SX(0)) == len(pairs)


def _rotate(a: ca.SX, vectors: ca.SX, p: int, q: int) -> tuple[ca.SX, ca.SX]:
    """One Jacobi rotation that zeroes a[p, q]; the smaller of the two angles, so sweeps converge."""
    off = ca.if_else(_negligible(a, p, q), 0.0, a[p, q])
    half_gap = (a[q, q] - a[p, p]) / 2
    sign = ca.if_else(half_gap < 0, -1.0, 1.0)
    tangent = sign * off / (ca.fabs(half_gap) + ca.sqrt(half_gap**2 + off**2 + TINY))
    cosine = 1 / ca.sqrt(1 + tangent**2)
    sine = tangent * cosine
    rotated = ca.SX(a)
    rotated[p, p] = a[p, p] - tangent * off
    rotated[q, q] = a[q, q] + tangent * off
    rotated[p, q] = rotated[q, p] = 0
    for k in range(a.shape[0]):
        if k not in (p, q):
            rotated[k, p] = rotated[p, k] = cosine * a[k, p] - sine * a[k, q]
            rotated[k, q] = rotated[q, k] = sine * a[k, p] + cosine * a[k, q]
    turned = ca.SX(vectors)
    turned[:, p] = cosine * vectors[:, p] - sine * vectors[:, q]
    turned[:, q] = sine * vectors[:, p] + cosine * vectors[:, q]
    return rotated, turned


def _sorted(values: ca.SX, vectors: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Ascending order by a bubble of compare-and-swap steps."""
    values, vectors = ca.SX(values), ca.SX(vectors)
    size = values.shape[0]
    for end in range(size - 1, 0, -1):
        for k in range(end):
            swap = values[k + 1] < values[k]
            low, high = values[k], values[k + 1]
            values[k], values[k + 1] = ca.if_else(swap, high, low), ca.if_else(swap, low, high)
            left, right = vectors[:, k], vectors[:, k + 1]
            vectors[:, k], vectors[:, k + 1] = ca.if_else(swap, right, left), ca.if_else(swap, left, right)
    return values, vectors


def clusters(values: ca.SX, tolerance: float) -> ca.SX:
    """(m, m) matrix of ones where two of the ascending, positive `values` belong to one cluster, else zeros.

    Neighbours closer than `tolerance` relative to their mean are of one cluster, and so are their neighbours.
    """
    size = values.shape[0]
    same = ca.SX(ca.DM.ones(size, size))
    for i in range(size):
        linked = ca.SX(1)
        for j in range(i + 1, size):
            close = values[j] - values[j - 1] <= tolerance * (values[j] + values[j - 1]) / 2
            linked = linked * ca.if_else(close, 1.0, 0.0)
            same[i, j] = same[j, i] = linked
    return same


def direct_eigen(matrix: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Eigenvectors of a positive definite matrix up to 3×3 without iteration, for many points at a time.

    In 3×3 the eigenvalue that stands apart, at one end of the spectrum, has a well conditioned vector, a column of
    adj(A − λI); one rotation solves what is left in the plane normal to it. That plane is taken from A if the vector's
    eigenvalue is the smallest and from adj A, whose order is the reverse, if it is the largest: so nothing is lost
    beside it where the matrix is graded.

    Returns:
        vectors: (m, m), orthogonal columns of any length, by descending eigenvalue.
        gap: the smallest (λ_i − λ_j) / mean(λ_i, λ_j), within a factor 3 from above. The relative error of the vectors
            is some 1e-15 / gap; a repeated eigenvalue may give NaN.
    """
    size = matrix.shape[0]
    if size > 3:
        raise ValueError(f"direct_eigen: at most 3 rows, not {size}")
    if size == 1:
        return ca.SX(1), ca.SX(2)
    if size == 2:
        small, large, gap = _plane_eigen(matrix)
        return ca.horzcat(large, small), gap
    apart, is_largest = _vector_apart(matrix)
    plane = _normal_plane(apart)
    small, large, gap = _plane_eigen(plane.T @ _choose(is_largest, _adjugate(matrix), matrix) @ plane)
    small, large = plane @ small, plane @ large
    return ca.horzcat(_choose(is_largest, apart, large), small, _choose(is_largest, large, apart)), gap


def reciprocal(x: ca.SX) -> ca.SX:
    """1 / x as one division, however often it is used: CasADi turns y * (1 / x) back into y / x."""
    return 2 / (2 * x)


def _plane_eigen(matrix: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Vectors (2, 1) of the smaller and the larger eigenvalue of a 2×2 matrix, of any length, and their gap."""
    off, half_gap = matrix[0, 1], (matrix[1, 1] - matrix[0, 0]) / 2
    radius = ca.sqrt(half_gap**2 + off**2 + TINY)
    long, ordered = ca.fabs(half_gap) + radius, half_gap >= 0
    first, second = _choose(ordered, long, -off), _choose(ordered, -off, long)
    gap = 4 * radius / (matrix[0, 0] + matrix[1, 1])
    return ca.vertcat(first, second), ca.vertcat(-second, first), gap


def _vector_apart(matrix: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Eigenvector (3, 1), of any length, of the largest or smallest eigenvalue, whichever is farther from the middle.

    With B = A − mean(λ) I and p² = tr(B²) / 6 the eigenvalues of B / p are 2 cos of three angles; the one apart is
    ±t with t³ − 3t = |det B| / p³, √3 ≤ t ≤ 2, by a polynomial and one step of Halley's method.
    """
    identity = ca.SX(ca.DM.eye(3))
    deviator = matrix - ca.trace(matrix) * (1 / 3) * identity
    square = ca.sumsqr(deviator) * (1 / 6) + TINY
    length = ca.sqrt(square)
    adjugate = _adjugate(deviator)
    determinant = ca.dot(deviator[:, 0], adjugate[:, 0])
    is_largest = determinant >= 0
    cosine = ca.fmin(ca.fabs(determinant) / (2 * length * square), 1)
    t = ca.SX(0)
    for coefficient in reversed(_THIRD_OF_ANGLE):
        t = t * cosine + coefficient
    error, slope = (t**2 - 3) * t - 2 * cosine, 3 * (t**2 - 1)
    t = t - error * slope / (slope**2 - 3 * t * error)
    value = (2 * is_largest - 1) * t * length
    rank_one = adjugate + value * deviator + value**2 * identity
    best, column = rank_one[0, 0], rank_one[:, 0]
    for k in (1, 2):
        better = rank_one[k, k] > best
        best, column = ca.fmax(rank_one[k, k], best), _choose(better, rank_one[:, k], column)
    return column, is_largest


def _normal_plane(vector: ca.SX) -> ca.SX:
    """Orthonormal basis (3, 2) of the plane normal to a vector: two columns of Householder's reflection."""
    length = safe_norm(vector)
    sign = 2 * (vector[2] >= 0) - 1
    mirror = vector + sign * length * ca.SX([0, 0, 1])
    return ca.SX(ca.DM.eye(3))[:, :2] - mirror @ (mirror[:2].T * reciprocal(length * (length + ca.fabs(vector[2]))))


def _adjugate(matrix: ca.SX) -> ca.SX:
    """Of a symmetric 3×3 matrix."""
    result = ca.SX.zeros(3, 3)
    for i in range(3):
        for j in range(i + 1):
            a, b, c, d = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            result[i, j] = result[j, i] = matrix[a, c] * matrix[b, d] - matrix[a, d] * matrix[b, c]
    return result


def _choose(condition: ca.SX, yes: ca.SX, no: ca.SX) -> ca.SX:
    """`yes` where the condition is 1, `no` where it is 0; both finite. Cheaper in lanes than `if_else`."""
    return condition * yes + (1 - condition) * no
