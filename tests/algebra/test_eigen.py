"""Jacobi eigenvalues and the perturbed pencil against NumPy and mpmath; derivatives against differences in 40 digits."""

from __future__ import annotations

from functools import cache

import casadi as ca
import mpmath
import numpy as np
import pytest

from flexopt.algebra import clusters, direct_eigen, reciprocal, symmetric_eigen
from tests.oracles.perturbation import perturbed_pencil

SIZES = range(1, 13)
EPS = np.finfo(float).eps


@cache
def jacobi(size):
    matrix = ca.SX.sym("A", size, size)
    return ca.Function("eigen", [matrix], list(symmetric_eigen(matrix)), {"cse": True})


def solved(matrix):
    values, vectors = jacobi(len(matrix))(matrix)
    return values.full().ravel(), vectors.full()


def random_orthogonal(rng, size):
    return np.linalg.qr(rng.standard_normal((size, size)))[0]


def check_decomposition(matrix, values, vectors):
    size, norm = len(matrix), np.linalg.norm(matrix)
    assert np.all(np.diff(values) >= 0)
    assert np.linalg.norm(vectors.T @ vectors - np.eye(size)) <= 20 * size * EPS
    assert np.linalg.norm(matrix @ vectors - vectors * values) <= 20 * size * EPS * norm


@pytest.mark.parametrize("size", SIZES)
def test_random_matrices(size):
    rng = np.random.default_rng(size)
    for _ in range(10):
        matrix = rng.standard_normal((size, size))
        matrix = matrix + matrix.T
        values, vectors = solved(matrix)
        check_decomposition(matrix, values, vectors)
        assert np.abs(values - np.linalg.eigvalsh(matrix)).max() <= 20 * size * EPS * np.linalg.norm(matrix)


@pytest.mark.parametrize("size", SIZES)
def test_small_eigenvalues_of_graded_matrices_keep_their_digits(size):
    """D B D with a well-conditioned B: Jacobi's relative error is eps cond B, whatever D (Demmel and Veselić, 1992)."""
    rng = np.random.default_rng(100 + size)
    for _ in range(5):
        gram = rng.standard_normal((size, 3 * size))
        core = gram @ gram.T
        core /= np.sqrt(np.outer(np.diag(core), np.diag(core)))
        grading = 10 ** rng.uniform(-6, 6, size)
        matrix = grading[:, None] * core * grading[None, :]
        matrix = (matrix + matrix.T) / 2
        values, vectors = solved(matrix)
        with mpmath.workdps(60):
            exact, _ = mpmath.eigsy(mpmath.matrix(matrix.tolist()))
            exact = sorted(exact)
            relative = max(abs(float((mpmath.mpf(v) - e) / e)) for v, e in zip(values.tolist(), exact, strict=True))
        assert relative <= 50 * size * EPS * np.linalg.cond(core)
        assert np.linalg.norm(vectors.T @ vectors - np.eye(size)) <= 20 * size * EPS


@pytest.mark.parametrize("size", SIZES)
def test_clustered_and_repeated_eigenvalues(size):
    rng = np.random.default_rng(200 + size)
    for step in (0.0, 1e-15, 1e-12, 1e-9, 1e-6):
        values = np.repeat(rng.uniform(1, 10, (size + 1) // 2), 2)[:size]
        values = values + step * rng.standard_normal(size)
        turn = random_orthogonal(rng, size)
        matrix = turn * values @ turn.T
        matrix = (matrix + matrix.T) / 2
        got, vectors = solved(matrix)
        check_decomposition(matrix, got, vectors)
        assert np.abs(got - np.sort(values)).max() <= 20 * size * EPS * 10


@pytest.mark.parametrize("size", SIZES)
def test_two_eigenvalues_repeated_many_times(size):
    """Slowest for cyclic rotations: noise turns equal pairs by 45° and refills entries that were zero."""
    rng = np.random.default_rng(400 + size)
    for _ in range(60):
        values = np.where(rng.random(size) < 0.5, 1.0, 5.0)
        turn = random_orthogonal(rng, size)
        matrix = turn * values @ turn.T
        matrix = (matrix + matrix.T) / 2
        check_decomposition(matrix, *solved(matrix))


@pytest.mark.parametrize("size", SIZES)
def test_diagonal_zero_and_identity_matrices_are_exact(size):
    rng = np.random.default_rng(300 + size)
    diagonal = rng.standard_normal(size)
    values, vectors = solved(np.diag(diagonal))
    assert np.array_equal(values, np.sort(diagonal))
    assert np.array_equal(np.abs(vectors), np.eye(size)[:, np.argsort(diagonal)])
    for special in (np.zeros((size, size)), np.eye(size)):
        values, vectors = solved(special)
        assert np.array_equal(values, np.diag(special))
        assert np.array_equal(vectors, np.eye(size))


@pytest.mark.parametrize("scale", [1e-100, 1e-30, 1e30, 1e100])
def test_scale_of_the_matrix_does_not_matter(scale):
    rng = np.random.default_rng(4)
    matrix = rng.standard_normal((5, 5))
    matrix = matrix + matrix.T
    check_decomposition(matrix * scale, *solved(matrix * scale))


@pytest.mark.parametrize("size", [2, 3, 4, 6])
def test_one_strong_coupling_in_a_zero_matrix(size):
    matrix = np.zeros((size, size))
    matrix[0, -1] = matrix[-1, 0] = 3.0
    values, vectors = solved(matrix)
    check_decomposition(matrix, values, vectors)
    assert np.allclose(values[[0, -1]], [-3.0, 3.0], rtol=EPS, atol=0)


def test_cluster_mask_links_neighbours_in_a_chain():
    values = ca.SX.sym("v", 5)
    mask = ca.Function("mask", [values], [clusters(values, 1e-3)])
    expected = np.eye(5)
    expected[:2, :2] = expected[2:, 2:] = 1.0
    # 3.000, 3.002 and 3.004 hang together pairwise, although the ends differ by more than the tolerance.
    assert np.array_equal(mask([1.0, 1.0005, 3.0, 3.002, 3.004]).full(), expected)
    assert np.array_equal(mask([1.0, 2.0, 3.0, 4.0, 5.0]).full(), np.eye(5))
    assert np.array_equal(mask([2.0] * 5).full(), np.ones((5, 5)))
    # The mean decides, so the tolerance is symmetric: 1e-3 is inside, a little more is outside.
    assert mask([1.0, 1.001, 3.0, 4.0, 5.0]).full()[0, 1] == 1.0
    assert mask([1.0, 1.0011, 3.0, 4.0, 5.0]).full()[0, 1] == 0.0


def pencil(seed, size):
    """K(t) = K0 + t K1 + t² K2 and M(t) alike, positive definite at 0, as double matrices."""
    rng = np.random.default_rng(seed)

    def symmetric():
        matrix = rng.standard_normal((size, size))
        return matrix + matrix.T

    mass = rng.standard_normal((size, 2 * size))
    turn = random_orthogonal(rng, size)
    spread = np.cumsum(rng.uniform(1.0, 3.0, size))
    mass = mass @ mass.T / (2 * size) + np.eye(size)
    lower = np.linalg.cholesky(mass)
    stiffness = lower @ (turn * spread @ turn.T) @ lower.T
    return [(stiffness + stiffness.T) / 2, symmetric(), symmetric()], [mass, 0.2 * symmetric(), 0.2 * symmetric()]


def exact_pairs(stiffness, mass, t):
    """Ascending eigenpairs at t, M-normalised, in mpmath."""
    k, m = (
        sum((t**power * mpmath.matrix(part.tolist()) for power, part in enumerate(parts)), mpmath.zeros(len(parts[0])))
        for parts in (stiffness, mass)
    )
    inverse = mpmath.cholesky(m) ** -1
    scaled = inverse * k * inverse.T
    values, vectors = mpmath.eigsy((scaled + scaled.T) / 2)
    return values, inverse.T * vectors


@pytest.mark.parametrize("size", [1, 2, 3, 5, 8])
def test_pencil_is_exact_to_second_order(size):
    stiffness, mass = pencil(size, size)
    t = ca.SX.sym("t")
    k, m = (sum(ca.DM(part) * t**power for power, part in enumerate(parts)) for parts in (stiffness, mass))
    with mpmath.workdps(40):
        values0, vectors0 = exact_pairs(stiffness, mass, mpmath.mpf(0))
        held_values = np.array([float(v) for v in values0])
        held_vectors = np.array(vectors0.tolist(), dtype=float)
        step = mpmath.mpf(10) ** -8
        around = []
        for sign in (-1, 1):
            values, vectors = exact_pairs(stiffness, mass, sign * step)
            for i in range(size):
                if (vectors[:, i].T * mpmath.matrix(mass[0].tolist()) * vectors0[:, i])[0] < 0:
                    vectors[:, i] = -vectors[:, i]
            around.append((values, vectors))
        (low, low_vectors), (high, high_vectors) = around
        # Errors of these differences: step² = 1e-16 times a fourth derivative.
        first = [float((high[i] - low[i]) / (2 * step)) for i in range(size)]
        second = [float((high[i] - 2 * values0[i] + low[i]) / step**2) for i in range(size)]
        first_vectors = np.array(((high_vectors - low_vectors) / (2 * step)).tolist(), dtype=float)
        second_vectors = np.array(((high_vectors - 2 * vectors0 + low_vectors) / step**2).tolist(), dtype=float)
    values, vectors = perturbed_pencil(k, m, ca.SX(held_values), ca.SX(held_vectors), ca.SX(ca.DM.eye(size)))
    d_values, d_vectors = ca.jacobian(values, t), ca.reshape(ca.jacobian(ca.vec(vectors), t), size, size)
    h_values, h_vectors = ca.jacobian(d_values, t), ca.reshape(ca.jacobian(ca.vec(d_vectors), t), size, size)
    outputs = [values, vectors, d_values, d_vectors, h_values, h_vectors]
    got = [x.full() for x in ca.Function("pencil", [t], [ca.densify(o) for o in outputs])(0.0)]
    expected = [held_values, held_vectors, first, first_vectors, second, second_vectors]
    for ours, theirs in zip(got, expected, strict=True):
        exact = np.asarray(theirs).reshape(ours.shape)
        assert np.linalg.norm(ours - exact) <= 1e-11 * np.linalg.norm(exact)


def test_sums_over_a_cluster_are_smooth_where_eigenvalues_repeat():
    """Σ φφᵀ and Σ λ over a repeated pair: first and second derivatives equal those of the exact spectral projector."""
    rng = np.random.default_rng(9)
    size, pair = 4, [1, 2]
    stiffness, mass = pencil(3, size)
    lower = np.linalg.cholesky(mass[0])
    turn = random_orthogonal(rng, size)
    repeated = np.array([1.0, 4.0, 4.0, 9.0])
    matrix = lower @ (turn * repeated @ turn.T) @ lower.T
    stiffness[0] = (matrix + matrix.T) / 2
    held = np.linalg.solve(lower.T, turn)
    t = ca.SX.sym("t")
    k, m = (sum(ca.DM(part) * t**power for power, part in enumerate(parts)) for parts in (stiffness, mass))
    same = np.eye(size)
    same[1, 2] = same[2, 1] = 1.0
    values, vectors = perturbed_pencil(k, m, ca.SX(repeated), ca.SX(held), ca.SX(same))
    projector = vectors[:, pair] @ vectors[:, pair].T
    slope = ca.jacobian(ca.vec(projector), t)
    curvature = ca.jacobian(slope, t)
    sum_values = ca.sum(values[pair])
    got = ca.Function("sums", [t], [slope, curvature, ca.jacobian(sum_values, t), ca.hessian(sum_values, t)[0]])(0.0)
    with mpmath.workdps(50):
        step, points = mpmath.mpf(10) ** -8, []
        for sign in (-1, 0, 1):
            exact_values, exact_vectors = exact_pairs(stiffness, mass, sign * step)
            chosen = exact_vectors[:, 1:3]
            points.append((chosen * chosen.T, exact_values[1] + exact_values[2]))
        (p0, s0), (p1, s1), (p2, s2) = points
        expected = [
            (p2 - p0) / (2 * step),
            (p2 - 2 * p1 + p0) / step**2,
            mpmath.matrix([[(s2 - s0) / (2 * step)]]),
            mpmath.matrix([[(s2 - 2 * s1 + s0) / step**2]]),
        ]
    for ours, theirs in zip(got, expected, strict=True):
        exact = np.array(theirs.tolist(), dtype=float)
        actual = ours.full().reshape(exact.shape, order="F")
        # The doubles repeat an eigenvalue only to 1e-15: over the step of 1e-8 that shows at 1e-7.
        assert np.linalg.norm(actual - exact) <= 1e-7 * (1 + np.linalg.norm(exact))


@cache
def direct(size):
    matrix = ca.SX.sym("A", size, size)
    return ca.Function("direct", [matrix], list(direct_eigen(matrix)), {"cse": True})


def spectrum_matrix(rng, values):
    q = random_orthogonal(rng, len(values))
    matrix = (q * values) @ q.T
    return (matrix + matrix.T) / 2


def graded_matrix(rng, size, spread):
    root = spread ** -rng.uniform(0.0, 0.5, size)
    return root[:, None] * spectrum_matrix(rng, rng.uniform(0.3, 2.0, size)) * root


def descending_in_50_digits(matrix):
    """Eigenvalues and unit eigenvectors."""
    with mpmath.workdps(50):
        values, vectors = mpmath.eigsy(mpmath.matrix(matrix.tolist()))
        order = sorted(range(len(matrix)), key=lambda k: -values[k])
        columns = [[float(vectors[i, k]) for k in order] for i in range(len(matrix))]
        return np.array([float(values[k]) for k in order]), np.array(columns)


DIRECT_CASES = {
    "random": lambda rng, size: spectrum_matrix(rng, rng.uniform(0.1, 3.0, size)),
    "graded": lambda rng, size: graded_matrix(rng, size, 1e4),
    "very graded": lambda rng, size: graded_matrix(rng, size, 1e8),
    "largest two close": lambda rng, size: spectrum_matrix(rng, np.array([1.0, 1.0 - 1e-4, 0.3])[:size]),
    "smallest two close": lambda rng, size: spectrum_matrix(rng, np.array([0.1, 0.1 - 1e-5, 1.0])[:size]),
    "three close": lambda rng, size: spectrum_matrix(rng, np.array([1.0, 1.0002, 1.00041])[:size]),
    "equal spacing": lambda rng, size: spectrum_matrix(rng, np.array([1.0, 2.0, 3.0])[:size]),
    "diagonal": lambda rng, size: np.diag(rng.uniform(0.1, 3.0, size)),
}


@pytest.mark.parametrize("size", [2, 3])
@pytest.mark.parametrize("name", DIRECT_CASES)
def test_direct_vectors_are_good_to_rounding_over_the_gap(name, size):
    rng = np.random.default_rng(size)
    for _ in range(20):
        matrix = DIRECT_CASES[name](rng, size)
        vectors, gap = (result.full() for result in direct(size)(matrix))
        vectors = vectors / np.linalg.norm(vectors, axis=0)
        values, expected = descending_in_50_digits(matrix)
        expected = expected * np.sign(np.sum(vectors * expected, axis=0))
        assert np.abs(vectors - expected).max() <= 10 * EPS / gap
        smallest = np.min(2 * (values[:-1] - values[1:]) / (values[:-1] + values[1:]))
        assert smallest * (1 - 1e-9) <= gap <= 3 * smallest * (1 + 1e-9)


@pytest.mark.parametrize("matrix", [np.eye(2), np.eye(3), np.diag([2.0, 2.0, 1.0]), np.diag([2.0, 1.0, 1.0])])
def test_direct_gap_of_repeated_eigenvalues_is_never_trusted(matrix):
    gap = float(direct(len(matrix))(matrix)[1])
    assert not gap >= 1e-12


def test_direct_sizes():
    vectors, gap = direct_eigen(ca.SX.sym("A", 1, 1))
    assert float(vectors) == 1
    assert float(gap) == 2
    with pytest.raises(ValueError, match="at most 3"):
        direct_eigen(ca.SX.sym("A", 4, 4))


def test_reciprocal_stays_a_shared_division():
    x, y = ca.SX.sym("x"), ca.SX.sym("y", 3)
    function = ca.Function("f", [x, y], [y * reciprocal(x)], {"cse": True})
    codes = [function.instruction_id(k) for k in range(function.n_instructions())]
    assert codes.count(ca.OP_DIV) + codes.count(ca.OP_INV) == 1
    assert np.array_equal(function(3.0, [1.0, 2.0, 3.0]).full().ravel(), np.array([1.0, 2.0, 3.0]) * (1.0 / 3.0))
