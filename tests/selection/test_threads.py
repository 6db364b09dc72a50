"""Several threads at once: no crash, and what each call gives alone. `python -m benchmarks.threads` does it at length."""

import os
import subprocess
import sys
import threading

import pytest

import flexopt
from flexopt.foundation.turns import TURN, in_turn

# Of what is public these touch no graph: they read files, or compute with NumPy and SciPy alone.
WITHOUT_GRAPHS = {
    "gap", "load", "load_experiment", "load_problem", "load_robot", "machine_from_dict", "ncf_margin", "nu_gap",
    "optimal_controller", "robust_margin", "tree_from_dict",
}  # fmt: skip
# This one waits for others, which take turns.
WAITS = {"run_study"}
# These build graphs, which CasADi's own locks allow, and evaluate none.
BUILD = {"build_hydraulics", "build_measures", "build_plant"}


def test_every_public_call_takes_turns():
    names = [name for name in dir(flexopt) if not name.startswith("_") and name not in WITHOUT_GRAPHS | BUILD | WAITS]
    calls = {name: getattr(flexopt, name) for name in names}
    functions = {name: call for name, call in calls.items() if callable(call) and not isinstance(call, type)}
    assert {"select", "evaluate", "simulate", "export_c"} <= set(functions)
    turn = in_turn(lambda: None).__code__
    for name, call in functions.items():
        if call.__module__.startswith("flexopt"):
            assert call.__code__ is turn, f"{name} may be called by two threads at once"


@pytest.mark.long
@pytest.mark.parametrize("name", ["select", "all of them, mixed"])
def test_threads_at_once(name):
    """In a process of its own: what goes wrong is a crash."""
    code = f"from benchmarks.threads import differing; print(*differing({name!r}, 4, 4))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["0", "16"]


if hasattr(os, "fork"):

    def test_a_fork_waits_for_its_turn():
        begun, end, forked = threading.Event(), threading.Event(), threading.Event()

        def computes():
            with TURN:
                begun.set()
                end.wait(30)
                assert not forked.is_set()

        thread = threading.Thread(target=computes)
        thread.start()
        begun.wait(30)
        threading.Timer(0.2, end.set).start()
        child = os.fork()
        if child == 0:
            os._exit(0 if TURN.acquire(timeout=10) else 1)
        forked.set()
        thread.join()
        assert os.waitpid(child, 0)[1] == 0
