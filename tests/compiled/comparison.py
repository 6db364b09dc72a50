"""The same Function in the virtual machine, in compiled C, and several points at a time, in one call."""

from __future__ import annotations

import ctypes
import os
import platform
import sys
from collections.abc import Sequence
from unittest import mock

import casadi as ca
import numpy as np

from flexopt.compiled import Batch, accelerate, batch, find_compiler

# A machine without compiler takes the way through the virtual machine in every test, and says so once.
QUIET = "ignore::flexopt.errors.CompilerNotFound"


def interpreted(function: ca.Function) -> Batch:
    with mock.patch.dict(os.environ, FLEXOPT_COMPILE="0"):
        return batch(function)


def one_by_one(function: ca.Function, arrays: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Plain calls, a point at a time: what everything else must agree with."""
    n = max(a.shape[1] for a in arrays)
    columns = []
    for k in range(n):
        point = [a[:, min(k, a.shape[1] - 1)] for a in arrays]
        shaped = [x.reshape(function.size_in(i), order="F") for i, x in enumerate(point)]
        columns.append([np.array(ca.densify(y)).ravel(order="F") for y in function.call(shaped)])
    return [np.array([column[k] for column in columns]).T for k in range(function.n_out())]


def check_agreement(
    function: ca.Function,
    arrays: Sequence[np.ndarray],
    *,
    rtol: float = 1e-13,
    atol: float = 0.0,
    compiles: bool = True,
) -> list[np.ndarray]:
    """Compare every way of evaluation; `compiles`: whether the lanes must be able to take it."""
    expected = one_by_one(function, arrays)
    lanes, machine = batch(function), interpreted(function)
    assert lanes.compiled == (compiles and find_compiler() is not None)
    assert not machine.compiled
    twin = accelerate(function, order=0)
    scalar = one_by_one(twin, arrays)
    for k, name in enumerate(function.name_out()):
        for way, result in (("lanes", lanes(*arrays)), ("machine", machine(*arrays)), ("scalar", scalar)):
            assert result[k].flags.c_contiguous or way == "scalar"
            np.testing.assert_allclose(result[k], expected[k], rtol=rtol, atol=atol, err_msg=f"{name} by {way}")
    return expected


def control_register() -> bytes:
    """The floating-point environment of this thread, as the C library stores it; status flags left out."""
    if sys.platform != "linux" or platform.machine() != "x86_64":
        return b""
    environment = ctypes.create_string_buffer(64)
    ctypes.CDLL("libm.so.6").fegetenv(environment)
    return environment.raw[:2] + (int.from_bytes(environment.raw[28:32], "little") & ~0x3F).to_bytes(4, "little")
