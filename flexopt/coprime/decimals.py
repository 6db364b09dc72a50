"""Dense linear algebra on arrays of decimals, real and complex: elimination, Cholesky factors, small eigenproblems."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal, getcontext

import numpy as np
from numpy.typing import NDArray

from flexopt.compiled.extended import Exact, exact, largest

SWEEPS = 60


def unit(n: int) -> Exact:
    """The unit matrix (n, n)."""
    return exact(np.eye(n))


def symmetric(matrix: Exact) -> Exact:
    """The mean of a matrix and its transpose."""
    return (matrix + matrix.T) / 2


def times(left: Exact, right: Exact) -> Exact:
    """The product of matrices in which many elements are 0: those cost as much as others."""
    product = np.full((left.shape[0], right.shape[1]), Decimal(0), dtype=object)
    columns, rows = left.T.astype(bool), right.astype(bool)
    for k in range(left.shape[1]):
        i, j = np.flatnonzero(columns[k]), np.flatnonzero(rows[k])
        product[np.ix_(i, j)] += np.multiply.outer(left[i, k], right[k, j])
    return product


def solve(matrix: Exact, right: Exact) -> Exact:
    """matrix⁻¹ right (n, k), by elimination with pivots; LinAlgError where it is singular."""
    n = matrix.shape[0]
    a = np.concatenate([matrix, right], axis=1)
    for k in range(n):
        pivot = max(range(k, n), key=lambda i: abs(a[i, k]))
        if not a[pivot, k] or not a[pivot, k].is_finite():
            raise np.linalg.LinAlgError("singular in extended precision")
        if pivot != k:
            a[[k, pivot]] = a[[pivot, k]]
        a[k, k + 1 :] = a[k, k + 1 :] / a[k, k]
        # Most matrices here have many zeros, which cost as much as other numbers.
        rows, columns = k + 1 + np.flatnonzero(a[k + 1 :, k]), k + 1 + np.flatnonzero(a[k, k + 1 :])
        a[np.ix_(rows, columns)] -= np.multiply.outer(a[rows, k], a[k, columns])
    for k in range(n - 1, 0, -1):
        rows, columns = np.flatnonzero(a[:k, k]), n + np.flatnonzero(a[k, n:])
        a[np.ix_(rows, columns)] -= np.multiply.outer(a[rows, k], a[k, columns])
    return a[:, n:]


def null_space(matrix: Exact, tolerance: Decimal) -> tuple[list[int], list[int], Exact]:
    """Columns P and F, and W, with matrix x = 0 exactly where x_P = −W x_F.

    By elimination with pivots from everywhere; those below `tolerance` times the first count as zero.
    """
    a, first, columns = matrix.copy(), Decimal(0), list(range(matrix.shape[1]))
    count = 0
    for k in range(min(a.shape)):
        left = np.abs(a[k:, k:]).ravel()
        i, j = divmod(max(range(left.size), key=lambda index: left[index]), a.shape[1] - k)
        pivot = abs(a[k + i, k + j])
        first = first or pivot
        if pivot <= tolerance * first:
            break
        a[[k, k + i]] = a[[k + i, k]]
        a[:, [k, k + j]] = a[:, [k + j, k]]
        columns[k], columns[k + j] = columns[k + j], columns[k]
        a[k + 1 :, k:] -= np.multiply.outer(a[k + 1 :, k] / a[k, k], a[k, k:])
        count = k + 1
    return columns[:count], columns[count:], solve(a[:count, :count], a[:count, count:])


def cholesky(matrix: Exact) -> Exact:
    """Lower triangular L with L Lᵀ = matrix; LinAlgError where it is not positive definite."""
    n, a = matrix.shape[0], matrix.copy()
    for k in range(n):
        if not a[k, k] > 0:
            raise np.linalg.LinAlgError("not positive definite")
        a[k, k] = a[k, k].sqrt()
        a[k + 1 :, k] = a[k + 1 :, k] / a[k, k]
        a[k + 1 :, k + 1 :] -= np.multiply.outer(a[k + 1 :, k], a[k + 1 :, k])
        a[k, k + 1 :] = Decimal(0)
    return a


def symmetric_eigen(matrix: Exact) -> tuple[Exact, Exact]:
    """Eigenvalues (k,), descending, and vectors (k, k) of a small symmetric matrix, by cyclic rotations."""
    k = matrix.shape[0]
    S, turn = matrix.copy(), unit(k)
    smallest = Decimal(10) ** -(getcontext().prec - 4)
    pairs = [(i, j) for i in range(k) for j in range(i + 1, k)]
    for _ in range(SWEEPS):
        diagonal = max(abs(x) for x in S.diagonal())
        if all(abs(S[i, j]) <= smallest * diagonal for i, j in pairs):
            break
        for i, j in pairs:
            if S[i, j]:
                theta = (S[j, j] - S[i, i]) / (2 * S[i, j])
                tangent = Decimal(1).copy_sign(theta) / (abs(theta) + (1 + theta * theta).sqrt())
                cosine = 1 / (1 + tangent * tangent).sqrt()
                sine = tangent * cosine
                for M in (S, turn):
                    M[:, i], M[:, j] = M[:, i] * cosine - M[:, j] * sine, M[:, i] * sine + M[:, j] * cosine
                S[i, :], S[j, :] = S[i, :] * cosine - S[j, :] * sine, S[i, :] * sine + S[j, :] * cosine
    values = S.diagonal().copy()
    order = sorted(range(k), key=lambda i: -values[i])
    return values[order], turn[:, order]


@dataclass(frozen=True, eq=False)
class Complex:
    """A complex array of decimals."""

    re: Exact
    im: Exact

    @classmethod
    def of(cls, values: NDArray[np.complex128]) -> Complex:
        """From doubles."""
        return cls(exact(values.real), exact(values.imag))

    def __add__(self, other: Complex) -> Complex:
        return Complex(self.re + other.re, self.im + other.im)

    def __mul__(self, other: Complex) -> Complex:
        return Complex(self.re * other.re - self.im * other.im, self.re * other.im + self.im * other.re)

    def times(self, factor: Exact | Decimal | int) -> Complex:
        """Each part times real numbers."""
        return Complex(self.re * factor, self.im * factor)

    def conjugate(self) -> Complex:
        """The conjugate."""
        return Complex(self.re, -self.im)

    def left(self, matrix: Exact) -> Complex:
        """A real matrix times self."""
        return Complex(matrix @ self.re, matrix @ self.im)

    def outer(self, other: Complex) -> Complex:
        """Outer product, self otherᵀ."""
        product = np.multiply.outer
        real = product(self.re, other.re) - product(self.im, other.im)
        return Complex(real, product(self.re, other.im) + product(self.im, other.re))

    def dot(self, other: Complex) -> Complex:
        """Product selfᵀ other, nothing conjugated."""
        return Complex(self.re @ other.re - self.im @ other.im, self.re @ other.im + self.im @ other.re)


def solve_complex(matrix: Complex, right: Complex) -> Complex:
    """matrix⁻¹ right of a complex symmetric matrix, real and imaginary parts side by side, rows and columns scaled."""
    sizes: list[Decimal] = [
        max(sum((abs(x) for x in (*a, *b)), Decimal(0)), Decimal("1e-300"))
        for a, b in zip(matrix.re, matrix.im, strict=True)
    ]
    by = np.array([1 / size.sqrt() for size in sizes], dtype=object)
    re, im = (by[:, None] * part * by for part in (matrix.re, matrix.im))
    whole = np.block([[re, -im], [im, re]])
    found = solve(whole, np.concatenate([right.re * by, right.im * by])[:, None])[:, 0]
    k = len(by)
    return Complex(found[:k] * by, found[k:] * by)


def refined_mode(A: Exact, value: complex, vector: NDArray[np.complex128]) -> tuple[Complex, Complex]:
    """A simple eigenvalue of A and its vector, from approximate ones, by Newton's method; else LinAlgError."""
    n, zero = A.shape[0], A * 0
    fixed = Complex.of(np.asarray(np.conj(vector) / np.vdot(vector, vector).real, dtype=np.complex128))
    lam, x = Complex.of(np.array([value], dtype=np.complex128)), Complex.of(vector)
    for _ in range(8):
        shifted = Complex(A - unit(n) * lam.re[0], zero - unit(n) * lam.im[0])
        bordered = [np.full((n + 1, n + 1), Decimal(0), dtype=object) for _ in range(2)]
        for whole, inner, edge, row in zip(
            bordered, (shifted.re, shifted.im), (x.re, x.im), (fixed.re, fixed.im), strict=True
        ):
            whole[:n, :n], whole[:n, n], whole[n, :n] = inner, -edge, row
        image = x.left(A) + (lam * x).times(-1)
        off = Complex(np.append(image.re, fixed.dot(x).re - 1), np.append(image.im, fixed.dot(x).im))
        step = solve_complex(Complex(*bordered), off.times(-1))
        x, lam = x + Complex(step.re[:n], step.im[:n]), lam + Complex(step.re[n:], step.im[n:])
        if max(largest(step.re), largest(step.im)) <= 10.0 ** (12 - getcontext().prec):
            return lam, x
    raise np.linalg.LinAlgError("the mode does not converge")
