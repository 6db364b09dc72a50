"""Compiled code that takes minutes: an interrupt is answered while it runs."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

# One member, 10¹¹ steps: hours.
PROGRAM = """
import casadi as ca
from flexopt.compiled import recurrence
x, e, c = ca.SX.sym("x"), ca.SX.sym("e", 0), ca.SX.sym("c")
run = recurrence(ca.Function("step", [x, e, c], [ca.sin(c * x), x]))
assert run.compiled
print("begun", flush=True)
run([0.5], [0.9], steps=10**11, stride=10**11, keep="monitors")
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no process is interrupted alone there")
def test_an_interrupt_is_answered_while_compiled_code_runs() -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "begun\n"
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
    finally:
        process.kill()
    assert "KeyboardInterrupt" in said
    assert process.returncode != 0
