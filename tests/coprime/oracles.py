"""Independent ways to the same numbers: SciPy, SLICOT, Gramians, 60 digits, finite sections, dense grids."""

from __future__ import annotations

import math

import mpmath as mp
import numpy as np
import scipy.linalg as sla
import slycot

from flexopt.coprime import StateSpace


def riccati_terms(plant: StateSpace) -> tuple[np.ndarray, ...]:
    A, B, C, D = plant.A, plant.B, plant.C, plant.D
    S, R = np.eye(D.shape[1]) + D.T @ D, np.eye(D.shape[0]) + D @ D.T
    F = A - B @ np.linalg.inv(S) @ D.T @ C
    return F, S, R, B @ np.linalg.inv(S) @ B.T, C.T @ np.linalg.inv(R) @ C


def epsilon_of(X: np.ndarray, Z: np.ndarray) -> float:
    return 1.0 / math.sqrt(1.0 + float(np.max(np.linalg.eigvals(X @ Z).real)))


def scipy_epsilon(plant: StateSpace) -> float:
    F, S, R, G, H = riccati_terms(plant)
    solve = sla.solve_discrete_are if plant.dt else sla.solve_continuous_are
    return epsilon_of(solve(F, plant.B, H, S), solve(F.T, plant.C.T, G, R))


def slicot_epsilon(plant: StateSpace) -> float:
    F, _, _, G, H = riccati_terms(plant)
    n = F.shape[0]
    options = {"dico": "D", "hinv": "D", "sort": "U"} if plant.dt else {"dico": "C"}
    X = slycot.sb02md(n, F.copy(), G.copy(), H.copy(), **options)[0]
    Z = slycot.sb02md(n, F.T.copy(), H.copy(), G.copy(), **options)[0]
    return epsilon_of(X, Z)


def hankel_epsilon(plant: StateSpace) -> float:
    """sqrt(1 − ‖[N; M]‖_H²) from Gramians of the normalized right coprime factors, with SciPy's X."""
    A, B, C, D = plant.A, plant.B, plant.C, plant.D
    F, S, _, _, H = riccati_terms(plant)
    X = sla.solve_continuous_are(F, B, H, S)
    gain = -np.linalg.solve(S, D.T @ C + B.T @ X)
    root = np.linalg.inv(sla.sqrtm(S).real)
    loop, out = A + B @ gain, np.vstack([C + D @ gain, gain])
    P = sla.solve_continuous_lyapunov(loop, -(B @ root) @ (B @ root).T)
    Q = sla.solve_continuous_lyapunov(loop.T, -out.T @ out)
    return math.sqrt(1.0 - float(np.max(np.linalg.eigvals(P @ Q).real)))


def exact_epsilon(plant: StateSpace, digits: int = 60) -> float:
    """Hamiltonian eigenvectors in `digits` digits, for D = 0."""
    with mp.workdps(digits):
        n = plant.A.shape[0]
        A, B, C = (mp.matrix(M.tolist()) for M in (plant.A, plant.B, plant.C))
        G, H = B * B.T, C.T * C
        ham = mp.matrix(2 * n, 2 * n)
        for i in range(n):
            for j in range(n):
                ham[i, j], ham[i, j + n], ham[i + n, j], ham[i + n, j + n] = A[i, j], -G[i, j], -H[i, j], -A[j, i]
        values, vectors = mp.eig(ham)

        def blocks(columns: list[int]) -> tuple[mp.matrix, mp.matrix]:
            upper, lower = mp.matrix(n, n), mp.matrix(n, n)
            for k, column in enumerate(columns):
                for i in range(n):
                    upper[i, k], lower[i, k] = vectors[i, column], vectors[i + n, column]
            return upper, lower

        stable_up, stable_low = blocks([k for k in range(2 * n) if mp.re(values[k]) < 0])
        unstable_up, unstable_low = blocks([k for k in range(2 * n) if mp.re(values[k]) > 0])
        X, Z = stable_low * mp.inverse(stable_up), -unstable_up * mp.inverse(unstable_low)
        largest = max(mp.re(v) for v in mp.eig(X * Z, left=False, right=False))
        return float(1 / mp.sqrt(1 + largest))


def responses(plant: StateSpace, omega: np.ndarray) -> np.ndarray:
    s = np.exp(1j * omega) if plant.dt else 1j * omega
    eye = np.eye(plant.A.shape[0])
    return plant.C @ np.linalg.solve(s[:, None, None] * eye - plant.A, plant.B[None] + 0j) + plant.D


def chordal(P1: StateSpace, P2: StateSpace, omega: np.ndarray) -> np.ndarray:
    """σmax((I + P2P2*)^(−1/2) (P1 − P2) (I + P1*P1)^(−1/2)) at each frequency."""
    found = []
    for a, b in zip(responses(P1, omega), responses(P2, omega), strict=True):
        left = np.linalg.cholesky(np.eye(b.shape[0]) + b @ b.conj().T)
        right = np.linalg.cholesky(np.eye(a.shape[1]) + a.conj().T @ a)
        inner = np.linalg.solve(left, a - b) @ np.linalg.inv(right).conj().T
        found.append(np.linalg.norm(inner, 2))
    return np.array(found)


def section_gap(P1: StateSpace, P2: StateSpace, length: int = 150, tail: int = 150) -> float:
    """‖(I − Π₂)Π₁‖ of the graphs of two sampled plants, inputs of `length` samples; grows to the directed gap."""
    total = length + tail

    def toeplitz(plant: StateSpace) -> np.ndarray:
        A, B, C, D = plant.A, plant.B, plant.C, plant.D
        F, S, _, _, H = riccati_terms(plant)
        X = sla.solve_discrete_are(F, B, H, S)
        inner = S + B.T @ X @ B
        gain = -np.linalg.solve(inner, D.T @ C + B.T @ X @ A)
        root = np.linalg.inv(sla.sqrtm(inner).real)
        loop, out = A + B @ gain, np.vstack([C + D @ gain, gain])
        blocks, x = [np.vstack([D, np.eye(D.shape[1])]) @ root], B @ root
        for _ in range(total - 1):
            blocks.append(out @ x)
            x = loop @ x
        rows, columns = blocks[0].shape
        T = np.zeros((rows * total, columns * length))
        for j in range(length):
            T[rows * j :, columns * j : columns * (j + 1)] = np.vstack(blocks[: total - j])
        return T

    first, second = toeplitz(P1), toeplitz(P2)
    return float(np.linalg.norm(first - second @ (second.T @ first), 2))


def refined_epsilon(plant: StateSpace) -> float:
    """SciPy's solutions for D = 0 put right by Newton's method with residuals in extended precision, and λ like them.

    Where a double's 64-bit mantissa is all there is (not on x86), it is as good as SciPy's.
    """
    A, B, C = (M.astype(np.longdouble) for M in (plant.A, plant.B, plant.C))

    def solved(F: np.ndarray, G: np.ndarray, H: np.ndarray) -> np.ndarray:
        plain = [M.astype(float) for M in (F, G, H)]
        unit = np.eye(G.shape[1])
        X = sla.solve_continuous_are(plain[0], plain[1], plain[2].T @ plain[2], unit).astype(np.longdouble)
        for _ in range(4):
            XG = X @ G
            residual = F.T @ X + X @ F - XG @ XG.T + H.T @ H
            change = sla.solve_continuous_lyapunov((F - G @ XG.T).astype(float).T, -residual.astype(float))
            X = X + (change + change.T) / 2
        return X

    X, Z = solved(A, B, C), solved(A.T, C.T, B.T)
    product = X @ Z
    values, vectors = np.linalg.eig(product.astype(float))
    r = vectors[:, np.argmax(values.real)].real.astype(np.longdouble)
    for _ in range(3):
        left = Z @ r
        value = (left @ (product @ r)) / (left @ r)
        bordered = np.block([[(product - value * np.eye(len(r))).astype(float), r.astype(float)[:, None]],
                             [left.astype(float)[None, :], np.zeros((1, 1))]])  # fmt: skip
        wrong = np.append((value * r - product @ r).astype(float), 0.0)
        r = r + np.linalg.solve(bordered, wrong)[:-1]
    left = Z @ r
    return float(1 / np.sqrt(1 + (left @ (product @ r)) / (left @ r)))
