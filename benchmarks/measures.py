"""Time of all w_i of one posture, beside SciPy's and NumPy's eigensolvers on the same matrices.

Run: python -m benchmarks.measures

The peers get M, K, J and Jv ready made and solve the eigenproblem and the residues; flexopt's time includes computing
those matrices from the posture. No peer gives a gradient.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

import flexopt
from benchmarks.timing import median_seconds, table

POSTURES = 2000


def main() -> None:
    """Print the table."""
    machine = flexopt.load("excavator")
    measures = flexopt.build_measures(machine, "inverse")
    plant = measures.plant
    p, m = plant.parameter_values, plant.n_passive
    rng = np.random.default_rng(0)
    postures = np.vstack(
        [rng.uniform(-3, 3, POSTURES), rng.choice([-1, 1], POSTURES) * rng.uniform(0.2, 2.9, POSTURES)]
    )
    bases = np.zeros((1, POSTURES))
    stiffness = plant.stiffness(p).full()
    mass, jacobian = np.empty((POSTURES, 5, 5)), np.empty((POSTURES, 2, 5))
    for k in range(POSTURES):
        q = plant.rest(0, postures[:, k], p)
        mass[k], jacobian[k] = plant.mass(q, 0, p).full(), plant.jacobian(q, 0, p).full()
    inverse = np.linalg.inv(jacobian[:, :, m:])

    def scipy_loop() -> np.ndarray:
        w = np.empty((POSTURES, m))
        for k in range(POSTURES):
            _, modes = scipy.linalg.eigh(stiffness, mass[k])
            a, b = jacobian[k] @ modes[:, -m:], inverse[k].T @ modes[m:, -m:]
            w[k] = np.sum(a * b, axis=0) - np.linalg.norm(a, axis=0) * np.linalg.norm(b, axis=0)
        return w

    def numpy_batched() -> np.ndarray:
        root = np.sqrt(np.diag(stiffness)[:m])
        flexibility = np.linalg.inv(mass)
        values, z = np.linalg.eigh(root[:, None] * flexibility[:, :m, :m] * root)
        modes = flexibility[:, :, :m] @ (root[:, None] * z) / np.sqrt(values)[:, None, :]
        a, b = jacobian @ modes, inverse.transpose(0, 2, 1) @ modes[:, m:]
        return np.sum(a * b, axis=1) - np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)

    def ours() -> np.ndarray:
        return measures.w.call([bases, postures, p])[0].full().T

    def ours_with_gradients() -> object:
        return measures.gradients.call([bases, postures, p])

    reference = scipy_loop()
    timed = {"SciPy eigh, loop": scipy_loop, "NumPy eigh, batched": numpy_batched, "flexopt, CasADi VM": ours}
    timed["flexopt, gradients by base, posture and all parameters"] = ours_with_gradients
    rows: list[tuple[str, ...]] = [
        ("who", "µs a posture", "ratio to flexopt", "largest difference from SciPy / |w|max")
    ]
    seconds = {name: median_seconds(work) / POSTURES for name, work in timed.items()}
    base = seconds["flexopt, CasADi VM"]
    for name, work in timed.items():
        difference = (
            "" if work is ours_with_gradients else f"{np.abs(work() - reference).max() / np.abs(reference).max():.1e}"
        )
        rows.append((name, f"{1e6 * seconds[name]:.2f}", f"{seconds[name] / base:.2f}", difference))
    print(table(f"All w_i of a posture, {POSTURES} random postures of the excavator, one core", rows))


if __name__ == "__main__":
    main()
