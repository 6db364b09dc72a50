"""The terms of eigenvectors' change against derivatives of the perturbed pencil."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from flexopt.algebra import expanded_vectors
from tests.oracles.perturbation import perturbed_pencil


@pytest.mark.parametrize("size", range(1, 8))
@pytest.mark.parametrize("repeated", [False, True])
@pytest.mark.parametrize("stiff", [False, True])
def test_terms_are_derivatives_of_the_perturbed_pencil(size, repeated, stiff):
    rng = np.random.default_rng(size)
    values, same = np.cumsum(rng.uniform(0.5, 2.0, size)), np.eye(size)
    if repeated and size > 1:
        values[1], same[0, 1], same[1, 0] = values[0], 1.0, 1.0
    e, v = (x + x.T for x in rng.standard_normal((2, size, size)))
    if not stiff:
        e[:] = 0
    t, held = ca.SX.sym("t"), (ca.SX(values), ca.SX(ca.DM.eye(size)), ca.SX(same))
    vectors = perturbed_pencil(ca.diag(held[0]) + t * ca.SX(e), held[1] + t * ca.SX(v), *held)[1]
    first = ca.jacobian(ca.vec(ca.densify(vectors)), t)
    derivatives = ca.Function("derivatives", [t], [first, ca.jacobian(first, t)])
    expected = [x.full().reshape(size, size, order="F") for x in derivatives(0.0)]

    terms = expanded_vectors(ca.SX(e) if stiff else ca.SX(size, size), ca.SX(v), held[0], held[2])
    got = [ca.evalf(ca.densify(term)).full() for term in terms]
    for ours, theirs in zip(got, (expected[0], expected[1] / 2), strict=True):
        assert np.linalg.norm(ours - theirs) <= 1e-13 * size * np.linalg.norm(theirs)
