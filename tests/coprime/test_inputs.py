"""Bad input gets one clear error; other libraries' objects are taken."""

from __future__ import annotations

import subprocess
import sys
import warnings

import control
import numpy as np
import pytest
import scipy.signal
from hypothesis import given, settings

from flexopt.coprime import (
    StateSpace,
    gap,
    hinf_norm,
    ncf_margin,
    nu_gap,
    optimal_controller,
    robust_margin,
    state_space,
)
from flexopt.errors import FlexoptError, FlexoptWarning, InputError, NotStabilizable
from tests.coprime.plants import chain, in_coordinates, seeds


def block(mode: np.ndarray, seed: int, *, reached: bool, seen: bool) -> StateSpace:
    """A random plant of four states beside `mode`, which escapes the input or the output, in dense coordinates."""
    rng = np.random.default_rng(seed)
    k = mode.shape[0]
    A = np.zeros((4 + k, 4 + k))
    A[:4, :4], A[4:, 4:] = rng.normal(size=(4, 4)) - np.eye(4), mode
    B, C = rng.normal(size=(4 + k, 1)), rng.normal(size=(1, 4 + k))
    if not reached:
        B[4:] = 0
    if not seen:
        C[:, 4:] = 0
    return in_coordinates(StateSpace(A, B, C, np.zeros((1, 1))), np.linalg.qr(rng.normal(size=(4 + k, 4 + k)))[0] * 2)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("kind", ["stabilizable", "detectable"])
@pytest.mark.parametrize(
    ("mode", "value"),
    [
        ([[0.7]], 0.7),
        ([[0.0]], 0.0),
        ([[0.0, 3.0], [-3.0, 0.0]], 3j),
        ([[0.2, 3.0], [-3.0, 0.2]], 0.2 + 3j),
        ([[0.0, 1.0], [0.0, 0.0]], 0.0),  # a double pole: rounding scatters it by 1e-8
        ([[1.0, 1.0], [0.0, 1.0]], 1.0),
    ],
)
def test_the_mode_that_escapes_is_named(mode, value, kind, seed):
    plant = block(np.array(mode), seed, reached=kind == "detectable", seen=kind == "stabilizable")
    for call in (robust_margin, optimal_controller, lambda p: gap(p, p), lambda p: nu_gap(p, p)):
        with pytest.raises(NotStabilizable, match=f"not {kind}") as caught:
            call(plant)
        assert caught.value.kind == kind
        assert abs(complex(caught.value.mode.real, abs(caught.value.mode.imag)) - value) < 1e-6
        assert caught.value.to_dict()["kind"] == kind


def test_the_mode_is_in_the_callers_unit():
    with pytest.raises(NotStabilizable, match="1e\\+12 rad/s") as caught:
        robust_margin(np.diag([1e12, -1.0]), [[0.0], [1.0]], [[1.0, 1.0]])
    assert caught.value.mode == pytest.approx(1e12)


@pytest.mark.parametrize("seed", range(4))
def test_a_damped_mode_may_escape(seed):
    plant = block(np.array([[-6e-4, 3.0], [-3.0, -6e-4]]), seed, reached=False, seen=True)
    assert 0 < float(robust_margin(plant)) < 1


def test_sampled_modes_on_the_circle():
    with pytest.raises(NotStabilizable) as caught:
        robust_margin(np.diag([0.5, -1.0]), [[1.0], [0.0]], [[1.0, 1.0]], dt=0.1)
    assert caught.value.mode == pytest.approx(-1.0)


def test_one_input_cannot_move_equal_unstable_poles():
    with pytest.raises(NotStabilizable):
        robust_margin(np.eye(2), np.ones((2, 1)), np.eye(2))
    assert float(robust_margin(np.eye(2), np.eye(2), np.eye(2))) == pytest.approx(np.sin(np.pi / 8), rel=1e-12)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (([[np.nan]], [[1.0]], [[np.inf]]), ["A: must be finite", "C: must be finite", "2 faults"]),
        (([], [], []), ["at least one input and one output"]),
        (([[1.0, 2.0]], [1.0, 2.0], [[1.0]]), ["A: must be square", "B: needs as many rows"]),
        (([[1.0]], [[1.0]], [[1.0, 2.0]], [[1.0, 2.0], [3.0, 4.0]]), ["C: needs as many columns"]),
        (([[1.0]], [[1.0]], [[1.0]], [[1.0, 2.0]]), ["D: must have shape (1, 1)"]),
        (([[1j]], [[1.0]], [[1.0]]), ["not complex"]),
        (([["a"]], [[1.0]], [[1.0]]), ["real numbers"]),
        (([[1.0, 2.0], [3.0]], [[1.0]], [[1.0]]), ["different lengths"]),
        (([[1e200]], [[1.0]], [[1.0]]), ["1e+100"]),
        ((np.zeros((1, 1, 1)), [[1.0]], [[1.0]]), ["at most two dimensions"]),
        (([[1.0]], [[1.0]], None), ["C: is missing"]),
        (("excavator",), ["must be a system"]),
        ((None,), ["must be a system"]),
        ((([[1.0]], [[1.0]], [[1.0]], None, -0.1),), ["dt = -0.1"]),
        ((([[1.0]], [[1.0]], [[1.0]], None, "fast"),), ["dt"]),
    ],
)
@pytest.mark.parametrize("call", [robust_margin, optimal_controller])
def test_every_fault_in_one_sentence(call, arguments, words):
    with pytest.raises(InputError) as caught:
        call(*arguments)
    for word in words:
        assert word in str(caught.value)


def test_options_beside_a_system_are_refused():
    with pytest.raises(InputError, match="brings its own") as caught:
        robust_margin(chain(2), D=[[1.0]], dt=0.1)
    assert len(caught.value.faults) == 2


def test_pairs_must_fit():
    with pytest.raises(InputError, match="different sampling periods"):
        gap((0.5, 1.0, 1.0, 0.0, 0.1), (0.5, 1.0, 1.0, 0.0, 0.2))
    with pytest.raises(InputError, match="different sampling periods"):
        nu_gap((0.5, 1.0, 1.0, 0.0, 0.1), (0.5, 1.0, 1.0))
    with pytest.raises(InputError, match="controller needs 1 outputs"):
        ncf_margin(chain(1), np.eye(2))
    with pytest.raises(InputError) as caught:
        ncf_margin((np.nan, 1.0, 1.0), (1.0, np.inf, 1.0), sign=0)
    assert {f.field for f in caught.value.faults} == {"sign", "P.A", "K.B"}
    assert ncf_margin((0.5, 1.0, 1.0, 0.0, 0.1), 0.5) > 0  # a gain has every sampling period


def test_python_control_and_scipy_objects():
    s = control.tf("s")
    expected = float(robust_margin(*chain(2)))
    for system in (
        control.ss(1 / s**2),
        1 / s**2,
        control.ss(*chain(2), 0),
        scipy.signal.StateSpace(*chain(2), np.zeros((1, 1))),
        scipy.signal.TransferFunction([1.0], [1.0, 0.0, 0.0]),
        state_space(chain(2)),
        list(chain(2)),
    ):
        assert float(robust_margin(system)) == pytest.approx(expected, rel=1e-12)
    assert state_space(control.ss(0.5, 1, 1, 0, True)).dt == 1.0
    assert state_space(control.ss(0.5, 1, 1, 0, 0.25)).dt == 0.25
    assert state_space(control.ss([], [], [], [[2.0]], None)).dt == 0.0
    with pytest.raises(InputError, match="cannot be realised"):
        robust_margin(s)


def test_importing_is_fast():
    code = "import sys, flexopt.coprime; assert 'scipy.linalg' not in sys.modules and 'control' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.long
@settings(derandomize=True, max_examples=60)
@given(seeds)
def test_any_numbers_give_a_value_or_a_sentence(seed):
    """Entries up to 1e±100 with zeros among them: never NaN, never another library's exception or warning."""
    rng = np.random.default_rng(seed)
    n, m, p = int(rng.integers(0, 5)), int(rng.integers(1, 3)), int(rng.integers(1, 3))
    span = float(rng.choice([1, 8, 30, 100]))

    def draw(*shape: int) -> np.ndarray:
        return rng.choice([-1, 0, 1, 1], size=shape) * 10.0 ** rng.uniform(-span, span, size=shape)

    plant = (draw(n, n), draw(n, m), draw(p, n), draw(p, m), float(rng.choice([0.0, 1.0])))
    other = (plant[0] * (1 + 0.1 * rng.normal(size=(n, n))), *plant[1:])
    K = draw(m, p)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FlexoptWarning)
        for call in (
            lambda: float(robust_margin(plant)),
            lambda: ncf_margin(plant, optimal_controller(plant)),
            lambda: gap(plant, other),
            lambda: nu_gap(plant, other),
            lambda: ncf_margin(plant, K),
            lambda: min(1.0, hinf_norm(plant)),
        ):
            try:
                value = call()
            except FlexoptError:
                continue
            assert 0.0 <= value <= 1.0
