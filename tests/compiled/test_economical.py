"""Compiled once that pays: what is counted, what is decided by it, and that neither path changes the numbers."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from flexopt.compiled import Economical, batch, find_compiler
from flexopt.compiled.cost import COMPILE_SECONDS, OPERATION_SECONDS, compilation_seconds, evaluation_seconds
from tests.compiled.comparison import QUIET

pytestmark = pytest.mark.filterwarnings(QUIET)

POINTS = np.random.default_rng(0).normal(size=(3, 100))


def _function(name: str = "f", steps: int = 50) -> ca.Function:
    x = ca.SX.sym("x", 3)
    y = x
    for _ in range(steps):
        y = ca.sin(y) + 0.1 * x * y[[1, 2, 0]]
    return ca.Function(name, [x], [y], ["x"], ["y"])


def _expected(steps: int = 50) -> np.ndarray:
    y = POINTS
    for _ in range(steps):
        y = np.sin(y) + 0.1 * POINTS * y[[1, 2, 0]]
    return y


def test_operations_are_counted_as_often_as_they_are_made_and_compiled_once() -> None:
    inner, x = _function("inner"), ca.MX.sym("x", 3)
    y = x
    for _ in range(7):
        y = inner(y)
    outer = ca.Function("outer", [x], [y])
    once = evaluation_seconds(inner)
    assert once == OPERATION_SECONDS * inner.n_instructions()
    assert evaluation_seconds(outer) == pytest.approx(7 * once, rel=0.1)
    assert compilation_seconds(outer) == pytest.approx(compilation_seconds(inner), rel=0.1)
    assert compilation_seconds(inner) == COMPILE_SECONDS * inner.n_instructions()
    assert evaluation_seconds(inner.map(5)) == pytest.approx(5 * once)


def test_products_and_choices_are_counted() -> None:
    a, b = ca.MX.sym("a", 20, 30), ca.MX.sym("b", 30, 40)
    product = ca.Function("product", [a, b], [a @ b])
    assert evaluation_seconds(product) == pytest.approx(OPERATION_SECONDS * 2 * 20 * 30 * 40, rel=0.2)
    inner = _function("inner")
    x = ca.MX.sym("x", 3)
    chosen = ca.Function.if_else("chosen", inner, ca.Function("same", [x], [x]))
    outer = ca.Function("outer", [x], chosen.call([x[0] > 0, x]))
    assert 0.1 * evaluation_seconds(inner) < evaluation_seconds(outer) < evaluation_seconds(inner)


@pytest.mark.long
def test_few_points_are_not_compiled_and_many_are(empty_cache: Path) -> None:
    few, many = Economical(_function()), Economical(_function())
    few.expect(int(0.4 * few.worth))
    values = few(POINTS)[0]
    assert not few.compiled
    assert not list(empty_cache.glob("*.so"))
    many.expect(int(2 * many.worth))
    again = many(POINTS)[0]
    assert many.compiled == (find_compiler() is not None)
    np.testing.assert_allclose(values, _expected(), rtol=1e-11)
    np.testing.assert_allclose(again, values, rtol=1e-11)


@pytest.mark.long
def test_what_is_kept_is_used_for_few_points_too(empty_cache: Path) -> None:
    kept = batch(_function())
    other = Economical(_function())
    other.expect(1)
    assert other.compiled == kept.compiled


@pytest.mark.long
def test_points_add_up(empty_cache: Path) -> None:
    economical = Economical(_function())
    economical.worth = 250.0
    seen: list[bool] = []
    for _ in range(4):
        economical.expect(100)
        seen.append(economical.compiled)
        economical(POINTS)
    compiles = find_compiler() is not None
    assert seen == [False, False, compiles, compiles]


@pytest.mark.long
def test_a_compiler_that_is_done_early_changes_no_bit(empty_cache: Path) -> None:
    """From half the cost on it works in the background; what a call takes does not depend on when it is done."""
    early, late = Economical(_function()), Economical(_function())
    early.worth = late.worth = 150.0
    early.expect(100)
    if early._begun is not None:
        early._begun()
    late.expect(100)
    early._decided = late._decided = False
    assert not early.compiled
    np.testing.assert_array_equal(early(POINTS)[0], late(POINTS)[0])


@pytest.mark.long
def test_threads_change_neither_the_choice_nor_the_numbers(empty_cache: Path) -> None:
    for points in (1, 10**9):
        economical = Economical(_function(f"f{points}"))
        economical.expect(points)
        one = economical(POINTS, threads=1)[0]
        three = economical(POINTS, threads=3)[0]
        np.testing.assert_array_equal(one, three)


def test_without_a_compiler(empty_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FLEXOPT_COMPILE", "0")
    economical = Economical(_function())
    economical.expect(10**9)
    assert not economical.compiled
    np.testing.assert_allclose(economical(POINTS)[0], _expected(), rtol=1e-11)


ENDING = """
import sys, warnings
warnings.simplefilter("error")
import casadi as ca
from flexopt.compiled import Economical
x = ca.SX.sym("x", 3)
y = x
for _ in range(3000):
    y = ca.sin(y) + x * y[[1, 2, 0]]
economical = Economical(ca.Function("long", [x], [y]))
economical.expect(10**9)
print("begun", flush=True)
"""


@pytest.mark.long
def test_a_process_that_ends_does_not_wait_for_its_compiler(empty_cache: Path) -> None:
    if find_compiler() is None:
        return
    begin = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-c", ENDING], capture_output=True, text=True, check=False, timeout=120, env=os.environ
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "begun\n", "")
    assert not list(empty_cache.glob(".flexopt-*")), f"after {time.monotonic() - begin:.1f} s"
    assert not list(empty_cache.glob(".lock-*"))
