"""What a control makes of forces at the end-point, from the singular values of Jv."""

from __future__ import annotations

import numpy as np


def task_map(jv: np.ndarray, control: str) -> np.ndarray:
    """V f(S) Uᵀ of Jv = U S Vᵀ with f(s) = s (transpose), 1/s (inverse) or s / (s² + λ²) (damped), (n, r)."""
    u, s, vt = np.linalg.svd(jv, full_matrices=False)
    if control == "transpose":
        shares = s
    elif control == "inverse":
        shares = np.divide(1.0, s, out=np.zeros_like(s), where=s > 1e-15 * s[0])
    else:
        shares = s / (s**2 + float(control.removeprefix("damped:")) ** 2)
    return vt.T @ (shares[:, None] * u.T)
