"""The compiled twin: names, defaults, derivatives, and its use in a nonlinear program."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from flexopt.compiled import accelerate, batch, find_compiler
from tests.compiled.comparison import QUIET, control_register

pytestmark = pytest.mark.filterwarnings(QUIET)


def _problem() -> ca.Function:
    """Objective and constraint with a curved Hessian; `step` is also the name of a function of the C library."""
    x, p = ca.SX.sym("x", 4), ca.SX.sym("p")
    f = ca.sin(x[0]) * x[1] * p + x[2] ** 3 + (x[0] - 2) ** 4 + x[1] ** 2 + x[3] ** 2 * ca.exp(x[1])
    g = ca.vertcat(x[0] * x[1] * x[2], x[2] - x[3] ** 2)
    return ca.Function("step", [x, p], [f, g], ["x", "p"], ["f", "g"], {"default_in": [0.0, 1.3]})


def test_names_shapes_and_defaults_are_kept() -> None:
    function, twin = _problem(), accelerate(_problem())
    assert twin.name_in() == function.name_in()
    assert twin.name_out() == function.name_out()
    assert [twin.size_in(k) for k in range(2)] == [function.size_in(k) for k in range(2)]
    assert twin.default_in(1) == 1.3
    assert twin.name() == ("step" if find_compiler() is None else "flexopt_step")
    np.testing.assert_allclose(twin(x=[1, 2, 3, 4])["f"], function(x=[1, 2, 3, 4])["f"], rtol=1e-14)


def test_accelerating_twice_changes_nothing() -> None:
    twin = accelerate(_problem())
    assert accelerate(twin).name() == twin.name()


def _derivatives(function: ca.Function) -> ca.Function:
    x = ca.MX.sym("x", 4)
    f, g = function(x, 1.7)
    hessian, gradient = ca.hessian(f, x)
    bent = ca.jacobian(ca.gradient(ca.dot(g, g), x), x)
    product = ca.jtimes(g, x, x)
    return ca.Function("d", [x], [gradient, hessian, ca.jacobian(g, x), bent, product, ca.jtimes(g, x, g, True)])


def test_derivatives_to_second_order() -> None:
    expected, twin = _derivatives(_problem()), _derivatives(accelerate(_problem()))
    for seed in range(3):
        x = np.random.default_rng(seed).normal(size=4)
        for a, b in zip(twin.call([x]), expected.call([x]), strict=True):
            np.testing.assert_allclose(np.array(a), np.array(b), rtol=1e-12, atol=1e-13)


def test_the_twins_own_jacobian() -> None:
    x = np.arange(1.0, 5.0)
    jacobians = [function.jacobian()(x=x, p=1.0) for function in (_problem(), accelerate(_problem()))]
    for name in ("jac_f_x", "jac_g_x", "jac_f_p"):
        np.testing.assert_allclose(jacobians[1][name].full(), jacobians[0][name].full(), rtol=1e-13)


def test_what_is_declared_constant_stays_so() -> None:
    x, s = ca.SX.sym("x", 2), ca.MX.sym("s", 2)
    held = accelerate(ca.Function("hold", [x], [x**2], {"is_diff_out": [False]}))
    derivative = ca.Function("d", [s], [ca.jacobian(held(s), s)])
    assert not derivative([1, 2]).full().any()


@pytest.mark.parametrize("order", [1, 2])
def test_ipopt_takes_the_same_way(order: int) -> None:
    results = []
    quiet = {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes"}
    if order == 1:
        quiet["ipopt.hessian_approximation"] = "limited-memory"
    for function in (_problem(), accelerate(_problem(), order=order)):
        x = ca.MX.sym("x", 4)
        f, g = function(x, 1.3)
        solver = ca.nlpsol("s", "ipopt", {"x": x, "f": f, "g": g}, quiet)
        solution = solver(x0=[0.1, 0.2, 0.3, 0.4], lbg=[0, 0], ubg=[1, 1])
        assert solver.stats()["success"]
        results.append((solver.stats()["iter_count"], solution["x"].full()))
    assert abs(results[0][0] - results[1][0]) <= 1
    np.testing.assert_allclose(results[1][1], results[0][1], rtol=1e-6, atol=1e-7)


def test_a_callback_is_left_as_it_is() -> None:
    class Twice(ca.Callback):
        def __init__(self) -> None:
            ca.Callback.__init__(self)
            self.construct("twice", {})

        def eval(self, arguments: list[ca.DM]) -> list[ca.DM]:
            return [2 * arguments[0]]

    callback = Twice()
    assert accelerate(callback) is callback
    evaluate = batch(callback)
    assert not evaluate.compiled
    assert evaluate([[1.0, 2.0, 3.0]])[0].tolist() == [[2.0, 4.0, 6.0]]


def test_a_graph_that_calls_another_library() -> None:
    x = ca.MX.sym("x", 4)
    outer = ca.Function("outer", [x], [2 * accelerate(_problem())(x, 1.0)[0]])
    if find_compiler() is not None:
        assert accelerate(outer) is outer
        assert not batch(outer).compiled
        assert not batch(accelerate(_problem())).compiled
    points = np.random.default_rng(0).normal(size=(4, 5))
    (result,) = batch(outer)(points)
    for k in range(5):
        assert result[0, k] == pytest.approx(2 * float(_problem()(points[:, k], 1.0)[0]), rel=1e-13)


def test_the_floating_point_mode_of_the_process_is_untouched() -> None:
    before = control_register()
    x = ca.SX.sym("x")
    function = ca.Function("mode", [x], [x / 4])
    (result,) = batch(function)([[2.2250738585072014e-308] * 9])
    assert (result > 0).all(), "the lanes keep denormals"
    assert float(accelerate(function)(2.2250738585072014e-308)) > 0
    assert np.all(np.array([2.2250738585072014e-308]) / 4 > 0)
    assert control_register() == before
