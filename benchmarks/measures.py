"""Time of all w_i of one posture, beside SciPy's and NumPy's eigensolvers on the same matrices.

Run: python -m benchmarks.measures

The peers get M, K, J and Jv ready made and solve the eigenproblem and the residues; flexopt's time includes computing
those matrices from the posture. No peer gives a gradient.
"""

from __future__ import annotations

import numpy as np

import flexopt
from benchmarks.batches import FEW, peers, random_postures
from benchmarks.timing import median_seconds, table

POSTURES = 2000
LOOP, OURS = "SciPy eigh, loop", "flexopt, CasADi VM"


def main() -> None:
    """Print the table."""
    measures = flexopt.build_measures(flexopt.load("excavator"), "inverse")
    postures, bases, p = random_postures(POSTURES), np.zeros((1, POSTURES)), measures.plant.parameter_values
    others = peers(measures, postures)

    def ours() -> np.ndarray:
        return measures.w.call([bases, postures, p])[0].full()

    values = {LOOP: others.scipy_loop, "NumPy eigh, batched": others.numpy_batched, OURS: ours}
    gradients = {
        "flexopt, gradients by base, posture and all parameters": lambda: measures.gradients.call([bases, postures, p])
    }
    reference = others.scipy_loop()
    rows: list[tuple[str, ...]] = [
        ("who", "µs a posture", "ratio to flexopt", "largest difference from SciPy / |w|max")
    ]
    seconds = {
        name: median_seconds(work) / (FEW if name == LOOP else POSTURES) for name, work in (values | gradients).items()
    }
    for name, each in seconds.items():
        off = ""
        if name in values:
            off = f"{np.abs(values[name]()[:, :FEW] - reference).max() / np.abs(reference).max():.1e}"
        rows.append((name, f"{1e6 * each:.2f}", f"{each / seconds[OURS]:.2f}", off))
    print(table(f"All w_i of a posture, {POSTURES} random postures of the excavator, one core", rows))


if __name__ == "__main__":
    main()
