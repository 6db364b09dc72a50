"""Recurrences: against matrix powers, a loop in NumPy and SciPy; members that do not disturb each other; the fast twin."""

from __future__ import annotations

import os
import platform
import shutil
import sys
import tracemalloc
from importlib.util import find_spec
from pathlib import Path
from unittest import mock

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from flexopt.compiled import Compiler, Recurrence, find_compiler, is_brief, recurrence
from flexopt.errors import InputError
from tests.compiled.chains import Chain, build_chain
from tests.compiled.comparison import QUIET, control_register

pytestmark = pytest.mark.filterwarnings(QUIET)

WAYS = ("compiled", "machine")


def build(way: str, step: ca.Function, **options) -> Recurrence:
    if way == "machine":
        with mock.patch.dict(os.environ, FLEXOPT_COMPILE="0"):
            found = recurrence(step, **options)
        assert not found.compiled
        return found
    found = recurrence(step, **options)
    assert found.compiled == (find_compiler() is not None)
    return found


def linear(n: int = 3) -> ca.Function:
    """x -> A x + B e + b with A, b among the constants; monitors: the first state, and the size of the state."""
    x, e, c = ca.SX.sym("x", n), ca.SX.sym("e", 2), ca.SX.sym("c", n * n + n)
    B = np.arange(2.0 * n).reshape(n, 2) / 10
    next_ = ca.reshape(c[: n * n], n, n) @ x + B @ e + c[n * n :]
    return ca.Function("step", [x, e, c], [next_, ca.vertcat(next_[0], ca.norm_2(next_))])


def loop(x: np.ndarray, c: np.ndarray, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`linear` in NumPy for one member: states (steps, n) and monitors (steps, 2)."""
    n = len(x)
    A, b, B = c[: n * n].reshape(n, n, order="F"), c[n * n :], np.arange(2.0 * n).reshape(n, 2) / 10
    states = []
    for now in e:
        x = A @ x + B @ now + b
        states.append(x)
    states = np.array(states).reshape(len(e), n)
    return states, np.stack([states[:, 0], np.linalg.norm(states, axis=1)], axis=1)


def members(n_members: int, steps: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    c = np.vstack([rng.uniform(-0.5, 0.5, (9, n_members)), rng.normal(size=(3, n_members))])
    return rng.normal(size=(3, n_members)), c, rng.normal(size=(steps, 2, n_members))


@pytest.fixture(scope="module", params=WAYS)
def affine(request: pytest.FixtureRequest) -> Recurrence:
    return build(request.param, linear())


@pytest.fixture(scope="module")
def chain() -> Chain:
    return build_chain()


@pytest.fixture(scope="module")
def carried(chain: Chain) -> Recurrence:
    return build("compiled", chain.step, fast=chain.fast, refresh=chain.refresh)


def test_powers_of_a_matrix(affine: Recurrence) -> None:
    A, x0 = np.array([[0.9, 0.2, 0.0], [-0.2, 0.9, 0.1], [0.0, 0.0, 0.5]]), np.array([1.0, -2.0, 3.0])
    result = affine(x0, np.append(A.ravel(order="F"), np.zeros(3)), steps=60, e=np.zeros(2))
    assert result.k.tolist() == list(range(1, 61))
    for k in (1, 7, 60):
        np.testing.assert_allclose(result.x[k - 1, :, 0], np.linalg.matrix_power(A, k) @ x0, rtol=1e-12, atol=1e-14)
    np.testing.assert_array_equal(result.last, result.x[-1])


@pytest.mark.parametrize("n_members", [1, 2, 7, 8, 9, 17])
@pytest.mark.parametrize(("steps", "stride"), [(1, 1), (1, 5), (20, 1), (20, 5), (23, 5), (20, 20), (290, 100)])
def test_records_and_monitors(affine: Recurrence, n_members: int, steps: int, stride: int) -> None:
    x0, c, e = members(n_members, steps)
    result = affine(x0, c, steps=steps, e=e, stride=stride, threads=2)
    ends = [min(end, steps) for end in range(stride, steps + stride, stride)]
    assert result.k.tolist() == ends
    assert result.x.shape == (len(ends), 3, n_members)
    assert result.monitor.shape == (len(ends), 2, n_members)
    for i in range(n_members):
        x, monitor = loop(x0[:, i], c[:, i], e[:, :, i])
        np.testing.assert_allclose(result.x[:, :, i], x[result.k - 1], rtol=1e-11, atol=1e-13)
        np.testing.assert_allclose(result.last[:, i], x[-1], rtol=1e-11, atol=1e-13)
        windows = [monitor[end - 1 - (end - 1) % stride : end].max(axis=0) for end in ends]
        np.testing.assert_allclose(result.monitor[:, :, i], windows, rtol=1e-11, atol=1e-13)
    only = affine(x0, c, steps=steps, e=e, stride=stride, keep="monitors")
    assert only.x.shape == (0, 3, n_members)
    assert only.monitor.tobytes() == result.monitor.tobytes()
    assert only.last.tobytes() == result.last.tobytes()


def test_what_enters_may_be_shared(affine: Recurrence) -> None:
    x0, c, e = members(11, 30)
    for shared, full in (
        (e[0, :, 0], np.broadcast_to(e[0, :, :1], e.shape)),
        (e[0, :, :1], np.broadcast_to(e[0, :, :1], e.shape)),
        (e[:, :, 0], np.broadcast_to(e[:, :, :1], e.shape)),
        (e[:, :, :1], np.broadcast_to(e[:, :, :1], e.shape)),
    ):
        expected = affine(x0, c, steps=30, e=np.ascontiguousarray(full))
        assert affine(x0, c, steps=30, e=shared).x.tobytes() == expected.x.tobytes()
        assert affine(x0, c, steps=30, e=full).x.tobytes() == expected.x.tobytes()
    one = affine(x0[:, 0], c, steps=30, e=e)
    assert one.x.tobytes() == affine(np.tile(x0[:, :1], 11), c, steps=30, e=e).x.tobytes()
    assert affine(x0, c[:, 0], steps=30, e=e).x.tobytes() == affine(x0, c[:, :1], steps=30, e=e).x.tobytes()


@pytest.mark.parametrize("layout", ["Fortran", "strided", "reversed", "lists", "read-only", "unaligned"])
def test_arrays_in_any_layout(affine: Recurrence, layout: str) -> None:
    def unaligned(a: np.ndarray) -> np.ndarray:
        return np.frombuffer(b"_" + a.tobytes(), np.uint8)[1:].view(a.dtype).reshape(a.shape)

    def fixed(a: np.ndarray) -> np.ndarray:
        a.flags.writeable = False
        return a

    change = {"Fortran": np.asfortranarray, "strided": lambda a: np.repeat(a, 3, axis=-1)[..., ::3],
              "reversed": lambda a: np.ascontiguousarray(a[..., ::-1])[..., ::-1], "lists": np.ndarray.tolist,
              "read-only": fixed, "unaligned": unaligned}[layout]  # fmt: skip
    x0, c, e = members(19, 12)
    expected = affine(x0, c, steps=12, e=e).x
    assert affine(change(x0), change(c), steps=12, e=change(e)).x.tobytes() == expected.tobytes()


@pytest.mark.parametrize("steps", [0, 3])
@pytest.mark.parametrize("n_members", [0, 1, 9])
def test_no_steps_and_no_members(affine: Recurrence, steps: int, n_members: int) -> None:
    x0, c, e = members(n_members, steps)
    result = affine(x0, c, steps=steps, e=e)
    assert result.x.shape == (steps, 3, n_members)
    assert result.monitor.shape == (steps, 2, n_members)
    assert result.last.shape == (3, n_members)
    if steps == 0:
        np.testing.assert_array_equal(result.last, x0)


@pytest.mark.parametrize("way", WAYS)
def test_nothing_enters_nothing_is_monitored(way: str) -> None:
    x, e, c = ca.SX.sym("x"), ca.SX.sym("e", 0), ca.SX.sym("c", 0)
    run = build(way, ca.Function("step", [x, e, c], [x / 2, ca.SX(0, 1)]))
    result = run([1.0], [], steps=10)
    np.testing.assert_array_equal(result.x[:, 0, 0], 0.5 ** np.arange(1, 11))
    assert result.monitor.shape == (10, 0, 1)
    assert run([[1.0, 2.0]], np.zeros((0, 2)), steps=3, e=np.zeros((3, 0))).last.tolist() == [[0.125, 0.25]]


@pytest.mark.parametrize("way", WAYS)
def test_structural_zeros(way: str) -> None:
    x, e, c = ca.SX.sym("x", 3), ca.SX.sym("e", ca.Sparsity(2, 1)), ca.SX.sym("c", 2)
    step = ca.Function("step", [x, e, c], [ca.vertcat(x[1], ca.SX(1, 1), c[0]), ca.SX(1, 1)])
    for function in (step, ca.Function("outer", *_outer(step))):
        result = build(way, function)(np.arange(3.0), [5.0, 6.0], steps=2, e=[1.0, 2.0])
        assert result.x[:, :, 0].tolist() == [[1.0, 0.0, 5.0], [0.0, 0.0, 5.0]]
        assert result.monitor.ravel().tolist() == [0.0, 0.0]


def _outer(step: ca.Function) -> tuple[list[ca.MX], list[ca.MX]]:
    symbols = [ca.MX.sym(f"s{k}", *step.size_in(k)) for k in range(3)]
    return symbols, list(step.call(symbols))


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("kind", ["calls", "mapaccum", "fold"])
def test_a_step_of_many_substeps(way: str, kind: str) -> None:
    """A pendulum, whose step calls the same kernel ten times, against SciPy's DOP853."""
    x, e, c = ca.SX.sym("x", 2), ca.SX.sym("e"), ca.SX.sym("c")
    rate = ca.Function("rate", [x, e, c], [ca.vertcat(x[1], -c * ca.sin(x[0]) + e)])
    h, k1 = 0.001, rate(x, e, c)
    k2 = rate(x + h / 2 * k1, e, c)
    k3 = rate(x + h / 2 * k2, e, c)
    k4 = rate(x + h * k3, e, c)
    kernel = ca.Function("kernel", [x, e, c], [x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])
    X, E, C = ca.MX.sym("X", 2), ca.MX.sym("E"), ca.MX.sym("C")
    if kind == "calls":
        now = X
        for _ in range(10):
            now = kernel(now, E, C)
    elif kind == "mapaccum":
        now = kernel.mapaccum(10)(X, E, C)[:, -1]
    else:
        now = kernel.fold(10)(X, E, C)
    run = build(way, ca.Function("step", [X, E, C], [now, ca.fabs(now[0])]))
    result = run([[2.0, 0.3, -1.0], [0.0, 1.0, 2.0]], [[9.81, 5.0, 2.0]], steps=300, e=[0.4])
    for i, (start, g) in enumerate(zip([(2.0, 0.0), (0.3, 1.0), (-1.0, 2.0)], [9.81, 5.0, 2.0], strict=True)):
        solution = solve_ivp(lambda _, y, g=g: [y[1], 0.4 - g * np.sin(y[0])], (0, 3), start, "DOP853",
                             rtol=1e-12, atol=1e-12, t_eval=np.arange(1, 301) * 0.01)  # fmt: skip
        # RK4's own error at h = 1 ms over 3 s is below 1e-11; SciPy's tolerance adds up to some 1e-11.
        np.testing.assert_allclose(result.x[:, :, i], solution.y.T, rtol=0, atol=2e-10)


@pytest.mark.long
@given(st.integers(0, 1000), st.integers(1, 4))
@settings(max_examples=4)
def test_fast_and_exact_agree_for_random_machines(seed: int, links: int) -> None:
    chain = build_chain(links, seed)
    fast = build("compiled", chain.step, fast=chain.fast, refresh=chain.refresh)
    exact = build("machine", chain.step)
    x0, e = chain.start(3, seed), np.random.default_rng(seed).normal(size=(400, links))
    results = [run(x0, chain.reference, steps=400, e=e, stride=7) for run in (fast, exact)]
    for name in ("x", "monitor", "last"):
        np.testing.assert_allclose(*(getattr(r, name) for r in results), rtol=1e-12, atol=1e-12)


@pytest.mark.long
def test_the_fast_step_matches_plain_calls(chain: Chain, carried: Recurrence) -> None:
    x0, x = chain.start(1)[:, 0], chain.start(1)[:, 0]
    for _ in range(50):
        x = np.array(chain.step(x, 0.1, chain.reference)[0]).ravel()
    result = carried(x0, chain.reference, steps=50, e=np.full(chain.links, 0.1))
    np.testing.assert_allclose(result.last[:, 0], x, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_a_member_gives_the_same_bits_in_any_company(chain: Chain, carried: Recurrence, threads: int) -> None:
    """Also where some members leave the fast step's range, and one is lost."""
    if not carried.compiled:
        pytest.skip("the virtual machine takes members one by one")
    n = 67
    x0, e = chain.start(n), np.random.default_rng(1).normal(size=(300, chain.links, n))
    x0[-1, 5::9] += 120.0
    x0[2, 13] = np.nan
    x0[7, 21] = 1e150
    together = carried(x0, chain.reference, steps=300, e=e, stride=10, threads=threads)
    for at in (slice(0, 1), slice(5, 6), slice(13, 14), slice(21, 22), slice(3, 12), slice(20, 28), slice(60, 67)):
        part = carried(x0[:, at], chain.reference, steps=300, e=e[:, :, at], stride=10)
        for name in ("x", "monitor", "last"):
            expected = np.ascontiguousarray(getattr(together, name)[..., at])
            np.testing.assert_array_equal(getattr(part, name), expected)
    assert np.isfinite(together.last[:, np.isfinite(x0).all(axis=0) & (np.arange(n) != 21)]).all()


def _counting() -> dict[str, ca.Function]:
    """Counts up by one; the fast step gives nonsense from 5 to 8, where it says so; d counts steps since a refresh."""
    x, d, e, c = ca.SX.sym("x", 2), ca.SX.sym("d"), ca.SX.sym("e", 0), ca.SX.sym("c", 3)
    inside = ca.if_else(ca.logic_and(x[0] >= c[0], x[0] < c[1]), 1, 0)
    turn = ca.if_else(inside > 0, c[2], 1)
    names = ["x", "d", "e", "c"], ["x_next", "d_next", "monitor", "turn"]
    return {
        "step": ca.Function("step", [x, e, c], [ca.vertcat(x[0] + 1, x[1] + 1), ca.vertcat(0, x[0])]),
        "fast": ca.Function("fast", [x, d, e, c], [ca.vertcat(x[0] + 1 + 1000 * inside, x[1]), d + 1, ca.vertcat(d, x[0]), turn], *names),
        "refresh": ca.Function("refresh", [x, c], [x[0] * 0]),
    }  # fmt: skip


@pytest.mark.parametrize("turn", [1.0001, np.nan, np.inf])
def test_the_guard_and_the_refresh(turn: float) -> None:
    run = build("compiled", **_counting(), every=7)
    if not run.compiled:
        pytest.skip("compiled code only")
    bounds = np.array([[50.0, 5.0, 0.0], [0.0, 8.0, 30.0], [turn] * 3])
    result = run([0.0, 0.0], bounds, steps=30)
    for i, (low, high) in enumerate([(50, 0), (5, 8), (0, 30)]):
        k = np.arange(30)
        exact = (k >= low) & (k < high)
        np.testing.assert_array_equal(result.x[:, 0, i], k + 1)
        np.testing.assert_array_equal(result.x[:, 1, i], np.cumsum(exact), "only the exact step counts here")
        since = np.zeros(30)
        for step in k[1:]:
            since[step] = 0 if step % 7 == 0 or exact[step - 1] else since[step - 1] + 1
        np.testing.assert_array_equal(result.monitor[:, 0, i], np.where(exact, 0, since))
    assert build("compiled", **_counting(), every=7)([0.0, 0.0], [0, 0, 2.0], steps=30, stride=30).monitor[0, 0, 0] == 6
    assert build("compiled", **_counting())([0.0, 0.0], [0, 0, 2.0], steps=130, stride=130).monitor[0, 0, 0] == 99


def test_a_lost_member_no_longer_asks_for_the_exact_step() -> None:
    """The second state counts exact steps; `turn` is 1 + c."""
    x, d, e, c = ca.SX.sym("x", 2), ca.SX.sym("d"), ca.SX.sym("e", 0), ca.SX.sym("c")
    run = build(
        "compiled",
        ca.Function("step", [x, e, c], [ca.vertcat(x[0], x[1] + 1), ca.SX(0, 1)]),
        fast=ca.Function("fast", [x, d, e, c], [x, d, ca.SX(0, 1), 1 + c]),
        refresh=ca.Function("refresh", [x, c], [x[0]]),
    )
    if not run.compiled:
        pytest.skip("compiled code only")
    start = np.array([[0.0, np.nan, 0.0, np.nan], np.zeros(4)])
    last = run(start, [[0.0, np.nan, np.nan, 1.0]], steps=20, stride=20).last
    assert last[1].tolist() == [0.0, 1.0, 20.0, 20.0]


def test_beyond_the_limit_the_exact_step_serves(chain: Chain, carried: Recurrence) -> None:
    """The last body spins at 120 rad/s: 0.12 rad a step, twice what the polynomials reach."""
    x0 = chain.start(3)
    x0[-1, 1] = 120.0
    exact = build("machine", chain.step)
    results = [run(x0, chain.reference, steps=200, e=np.zeros(chain.links)) for run in (carried, exact)]
    np.testing.assert_allclose(results[0].x, results[1].x, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("way", WAYS)
def test_states_that_are_not_finite_propagate(way: str) -> None:
    x, e, c = ca.SX.sym("x", 2), ca.SX.sym("e", 0), ca.SX.sym("c")
    run = build(way, ca.Function("step", [x, e, c], [ca.vertcat(c * x[0], ca.fmin(x[1], x[0])), x[0]]))
    x0 = np.array([[1.0, 1.0, np.nan, 0.0, -np.inf], [np.inf, np.nan, 1.0, np.inf, 0.0]])
    result = run(x0, [[4.0, 0.5, 2.0, 2.0, 2.0]], steps=600, stride=600)
    assert result.last[0, [0, 1, 3]].tolist() == [np.inf, 0.5**600, 0.0]
    assert np.isnan(result.last[0, 2])
    assert result.last[0, 4] == -np.inf
    assert result.last[1, [0, 3]].tolist() == [1.0, 0.0], "an infinite start that the step gets rid of"
    assert np.isnan(result.monitor[0, 0, 2])
    assert result.monitor[0, 0, 1] == 1.0


@pytest.mark.parametrize("way", WAYS)
def test_a_monitor_is_nan_in_the_window_in_which_it_was(way: str) -> None:
    x, e, c = ca.SX.sym("x"), ca.SX.sym("e"), ca.SX.sym("c", 0)
    run = build(way, ca.Function("step", [x, e, c], [x, e]))
    e = np.array([1.0, np.nan, 5.0, 3.0, -1.0, -2.0, -np.inf])
    result = run([0.0], [], steps=7, e=e[:, None], stride=2)
    np.testing.assert_array_equal(result.monitor[:, 0, 0], [np.nan, 5.0, -1.0, -np.inf])


def test_a_diverging_member_and_a_nan_start(chain: Chain, carried: Recurrence) -> None:
    x0 = chain.start(8)
    expected = carried(x0, chain.reference, steps=500, e=np.zeros(chain.links))
    x0[5, 3], x0[6, 4] = np.nan, 1e200
    result = carried(x0, chain.reference, steps=500, e=np.zeros(chain.links))
    assert np.isnan(result.last[:, 3]).all()
    assert not np.isfinite(result.last[:, 4]).any()
    others = [0, 1, 2, 5, 6, 7]
    np.testing.assert_array_equal(result.x[..., others], expected.x[..., others])


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_what_decides_its_course_by_numbers_is_left_to_the_virtual_machine() -> None:
    x, e, c = ca.MX.sym("x"), ca.MX.sym("e"), ca.MX.sym("c")
    y, p = ca.SX.sym("y"), ca.SX.sym("p")
    root = ca.rootfinder("root", "newton", ca.Function("g", [y, p], [y**3 + y - p]))
    step = ca.Function("step", [x, e, c], [root(0.0, x) + e, x])
    for _ in range(2):  # the second time it is known
        run = recurrence(step)
        assert not run.compiled
    assert "virtual machine" in repr(run)
    result = run([[2.0, 10.0]], [0.0], steps=20, e=[1.0])
    before = np.vstack([[[2.0, 10.0]], result.x[:-1, 0]])
    after = result.x[:, 0] - 1.0
    np.testing.assert_allclose(after**3 + after, before, rtol=1e-10)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_step_that_fails_is_nan_from_there_on() -> None:
    x, e, c = ca.MX.sym("x"), ca.MX.sym("e", 0), ca.MX.sym("c", 0)
    y, p = ca.SX.sym("y"), ca.SX.sym("p")
    root = ca.rootfinder("root", "newton", ca.Function("g", [y, p], [y**2 - p]), {"max_iter": 40})
    run = recurrence(ca.Function("step", [x, e, c], [x - 1 + ca.fmin(root(1.0, x), 0), x]))
    result = run([[10.5, 400.5]], [], steps=300)
    np.testing.assert_allclose(result.x[:10, 0, 0], 10.5 - np.arange(1, 11))
    assert np.isnan(result.x[12:, 0, 0]).all()
    np.testing.assert_allclose(result.x[:, 0, 1], 400.5 - np.arange(1, 301))


def test_wrong_calls_are_refused_with_every_fault(affine: Recurrence) -> None:
    x0, c, e = members(9, 5)
    with pytest.raises(InputError) as caught:
        affine(x0[:2], c.T, steps=-1, e=np.zeros((3, 3)), stride=0, threads=0, keep="all")  # pyright: ignore
    text = str(caught.value)
    for part in ("7 faults", "steps = -1", "stride = 0", "threads = 0", "keep = 'all': must be one of records, monitors",
                 "x0: must have the shape (3, number of members) or (3,), not (2, 9)", "not (9, 12)",
                 "e: must have the shape (2,), (-1, 2) or (-1, 2, number of members), not (3, 3)"):  # fmt: skip
        assert part in text
    for arguments, options, part in (
        ((x0, c[:, :8]), {"e": e}, "x0: 9, c: 8, e: 9"), ((x0, c), {}, "e: must be given"),
        ((x0, c), {"e": e[:4]}, "not (4, 2, 9)"), (("x", c), {"e": e}, "x0: must be numbers"),
        ((x0[..., None], c), {"e": e}, "not (3, 9, 1)"), ((x0, c), {"e": e, "stride": 1.5}, "stride = 1.5"),
        ((x0, c), {"e": e, "threads": True}, "threads = True"), ((3.0, c), {"e": e}, "not ()"),
    ):  # fmt: skip
        with pytest.raises(InputError) as caught:
            affine(*arguments, steps=5, **options)
        assert part in str(caught.value)


def test_functions_that_do_not_belong_together() -> None:
    parts = _counting()
    x = ca.SX.sym("x", 2)
    with pytest.raises(InputError, match="one needs the other"):
        recurrence(parts["step"], fast=parts["fast"])
    with pytest.raises(InputError, match="one needs the other"):
        recurrence(parts["step"], refresh=parts["refresh"])
    with pytest.raises(InputError) as caught:
        recurrence(ca.Function("f", [x], [x]), fast=parts["step"], refresh=parts["refresh"], every=0)
    for part in ("3 faults", "step: must take x, e, c and give x, monitor, not 1 inputs", "fast: must take x, d, e, c",
                 "every = 0"):  # fmt: skip
        assert part in str(caught.value)
    with pytest.raises(InputError, match=r"refresh: x must have the shape \(2, 1\), not \(3, 1\)"):
        recurrence(
            parts["step"],
            fast=parts["fast"],
            refresh=ca.Function("r", [ca.SX.sym("x", 3), ca.SX.sym("c", 3)], [ca.SX(0)]),
        )
    m = ca.SX.sym("m", 2, 2)
    square = ca.Function("f", [m, x, ca.SX.sym("c")], [m, x])
    with pytest.raises(InputError, match=r"x must have the shape \(4, 1\), not \(2, 2\)"):
        recurrence(square)


def test_memory_does_not_grow_with_the_steps() -> None:
    x, e, c = ca.SX.sym("x", 2), ca.SX.sym("e"), ca.SX.sym("c")
    step = ca.Function("step", [x, e, c], [ca.vertcat(x[0] + 0.01 * x[1], x[1] - 0.01 * c * x[0] + e), x[0]])
    run = recurrence(step)
    if not run.compiled:
        pytest.skip("takes minutes")
    x0, c0, e0 = np.ones((2, 100_000)), np.linspace(1, 2, 100_000)[None], np.zeros((2000, 1))
    tracemalloc.start()
    try:
        result = run(x0, c0, steps=2000, e=e0, stride=2000, keep="monitors")
        assert tracemalloc.get_traced_memory()[1] < 10e6
    finally:
        tracemalloc.stop()
    assert np.isfinite(result.last).all()


def test_the_floating_point_mode_of_the_process_is_untouched(carried: Recurrence, chain: Chain) -> None:
    before = control_register()
    x, e, c = ca.SX.sym("x"), ca.SX.sym("e", 0), ca.SX.sym("c", 0)
    run = recurrence(ca.Function("step", [x, e, c], [x / 4, x]))
    assert run([2.2250738585072014e-308], [], steps=3).last[0, 0] == 2.2250738585072014e-308 / 64
    carried(chain.start(3), chain.reference, steps=3, e=np.zeros(chain.links), threads=2)
    assert np.all(np.array([2.2250738585072014e-308]) / 4 > 0)
    assert control_register() == before


def _compilers() -> list[str]:
    """Commands; on x86 the system's also for processors with four lanes, and with two. Zig is clang in a wheel."""
    fewer = ("", " -mno-avx512f", " -mno-avx -mno-fma") if platform.machine() in {"x86_64", "AMD64"} else ("",)
    found = [name + flags for name in ("g++", "clang++") if shutil.which(name) for flags in fewer]
    return found + ([f"'{sys.executable}' -m ziglang c++"] if find_spec("ziglang") else [])


@pytest.mark.long
@pytest.mark.parametrize("name", _compilers())
def test_each_compiler(fresh: None, monkeypatch: pytest.MonkeyPatch, chain: Chain, name: str) -> None:
    monkeypatch.setenv("FLEXOPT_CXX", name)
    run = recurrence(chain.step, fast=chain.fast, refresh=chain.refresh)
    assert run.compiled
    x0 = chain.start(11)
    x0[-1, 4] = 120.0
    options = {"steps": 300, "e": np.zeros(chain.links)}
    together = run(x0, chain.reference, **options)
    np.testing.assert_allclose(
        together.x, build("machine", chain.step)(x0, chain.reference, **options).x, rtol=1e-11, atol=1e-11
    )
    for i in (0, 4, 10):
        alone = run(x0[:, i], chain.reference, **options)
        np.testing.assert_array_equal(alone.x[..., 0], together.x[..., i])


@pytest.mark.long
@pytest.mark.parametrize("name", [name for name in ("g++", "clang++") if shutil.which(name)])
def test_what_runs_briefly_is_compiled_sooner_to_the_same_bits(
    empty_cache: Path, monkeypatch: pytest.MonkeyPatch, chain: Chain, name: str
) -> None:
    levels, compiled = list[str](), Compiler.build

    def build(self, *arguments, **options) -> None:
        levels.append(options["level"][0])
        compiled(self, *arguments, **options)

    monkeypatch.setenv("FLEXOPT_CXX", name)
    assert find_compiler() is not None
    monkeypatch.setattr(Compiler, "build", build)
    brief, whole, again = (
        recurrence(chain.step, fast=chain.fast, refresh=chain.refresh, brief=brief) for brief in (True, False, True)
    )
    # What the cache holds is used, however hard it was to make.
    assert levels == ["-O1", "-O2"]
    x0, options = chain.start(3), {"steps": 300, "e": np.zeros(chain.links)}
    first, *others = (run(x0, chain.reference, **options) for run in (whole, brief, again))
    for other in others:
        assert other.x.tobytes() == first.x.tobytes()
        assert other.monitor.tobytes() == first.monitor.tobytes()


def test_how_many_steps_are_few() -> None:
    """By counts: some millions of a straight-line step, fewer of one that does more than it says, more of many members."""
    assert is_brief(linear(), 1_000_000)
    assert not is_brief(linear(), 10_000_000)
    assert is_brief(linear(), 5_000_000, many=True)
    x, e, c = ca.MX.sym("x", 3), ca.MX.sym("e", 2), ca.MX.sym("c", 12)
    state, watched = linear().mapaccum(50)(x, ca.repmat(e, 1, 50), ca.repmat(c, 1, 50))
    assert not is_brief(ca.Function("fifty", [x, e, c], [state[:, -1], watched[:, -1]]), 1_000_000)


def test_the_cache_may_be_deleted_while_in_use(empty_cache: Path) -> None:
    x0, c, e = members(3, 5)
    first = recurrence(linear())
    shutil.rmtree(empty_cache, ignore_errors=True)
    np.testing.assert_array_equal(first(x0, c, steps=5, e=e).x, recurrence(linear())(x0, c, steps=5, e=e).x)
