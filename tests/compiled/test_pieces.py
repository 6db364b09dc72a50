"""Long straight-line functions in pieces give the same numbers."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from flexopt.compiled import batch, find_compiler, lanes, pieces
from tests.compiled.comparison import QUIET

pytestmark = pytest.mark.filterwarnings(QUIET)


def long_function(steps: int) -> ca.Function:
    """Values that live through many pieces, results on the way, choices and trigonometry."""
    x, y = ca.SX.sym("x", 3), ca.SX.sym("y", 2)
    state, kept = ca.vertcat(x, y), []
    for k in range(steps):
        turned = ca.vertcat(*(ca.sin(state[i]) + 0.3 * state[i - 1] for i in range(5)))
        state = ca.if_else(state[0] > 0, turned, turned - 0.1 * x[k % 3])
        if k % 50 == 0:
            kept.append(state[k % 5])
    return ca.Function("long", [x, y], [state, ca.vertcat(*kept, x[0])], ["x", "y"], ["state", "kept"])


@pytest.mark.long("7", "10000")
@pytest.mark.parametrize("piece", [1, 7, 10_000])
def test_pieces_compute_what_the_whole_does(monkeypatch, piece):
    if find_compiler() is None:
        pytest.skip("no compiler")
    steps = 3 if piece == 1 else 60
    function = long_function(steps)
    monkeypatch.setattr(lanes, "SHORT", 0)
    monkeypatch.setattr(lanes, "in_pieces", lambda given: pieces.in_pieces(given, long=10, piece=piece))
    monkeypatch.setattr("flexopt.compiled.libraries.key_of", lambda f, c, p: f"pieces-{piece}-{c.identity}-{p}")
    cut = batch(function)
    assert cut.compiled
    x, y = np.random.default_rng(0).normal(size=(3, 37)), np.random.default_rng(1).normal(size=(2, 37))
    source = lanes.kernel_source(function)
    assert (source.count("__attribute__((noinline)) void casadi_f0_") > 2) == (piece < 10_000)
    expected = function.map(37).call([x, y])
    for ours, theirs in zip(cut(x, y), expected, strict=True):
        np.testing.assert_allclose(ours, theirs.full(), rtol=1e-13, atol=1e-13)


def test_short_functions_and_loops_stay_whole():
    function = long_function(3)
    assert "casadi_f0_0" not in lanes.kernel_source(function)
    symbols = function.mx_in()
    looped = ca.Function("looped", symbols, function.map(2).call([ca.repmat(v, 1, 2) for v in symbols]))
    assert "casadi_f0_0" not in lanes.kernel_source(looped)


def test_how_hard_to_optimise_depends_on_the_longest_function():
    line = "  a=b;\n"
    block = "static int f(void) {\n" + line * 15_000 + "}\n"
    assert lanes.level(block) == ("-O2", "-fno-tree-sra")
    assert lanes.level(("static int f(void) {\n" + line * 5000 + "}\n") * 20) == ("-O2",)
    assert lanes.level(block * 20) is None
    assert lanes.level("static int f(void) {\n" + line * 50_000 + "}\n") is None


def test_what_depends_on_parameters_alone_is_computed_beforehand(monkeypatch):
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p", 4)
    known = ca.sqrt(1 + p[0] ** 2) * ca.cos(p[1] * p[2])
    function = ca.Function(
        "f", [x, p], [ca.vertcat(known * x[0] + p[3], known, ca.sin(x[1]) / known)], ["x", "p"], ["y"]
    )
    rng = np.random.default_rng(0)
    points, fixed, moving = rng.normal(size=(2, 37)), rng.normal(size=4), rng.normal(size=(4, 37))
    evaluate = batch(function)
    one, all_alike = evaluate(points, fixed)[0], evaluate(points, np.tile(fixed[:, None], 37))[0]
    assert np.array_equal(one, all_alike)
    for given, found in ((np.tile(fixed[:, None], 37), one), (moving, evaluate(points, moving)[0])):
        np.testing.assert_allclose(found, function.map(37)(points, given).full(), rtol=1e-14, atol=1e-15)
    if find_compiler() is None:
        return
    assert "casadi_f0_before(given, w)" in lanes.kernel_source(function)
    # Two groups side by side, what is known beforehand, or one group after the other with all of it: the same bits.
    monkeypatch.setattr(lanes, "SHORT", 0)
    monkeypatch.setattr("flexopt.compiled.libraries.key_of", lambda f, c, p: f"single-{c.identity}-{p}")
    assert "_before" not in lanes.kernel_source(function)
    assert np.array_equal(batch(function)(points, fixed)[0], one)
    assert np.array_equal(batch(function)(points, moving)[0], evaluate(points, moving)[0])
