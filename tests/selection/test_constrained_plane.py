"""Constraints of planar machines: the scan keeps to them, equalities and small islands are found, starts run in parallel."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import flexopt
from flexopt.foundation.processes import ProcessLost, in_parallel
from flexopt.selection import optima

TARGET = (0.0, 1.6)


@pytest.fixture(scope="module")
def machine():
    return flexopt.load("excavator")


def test_a_bound_on_the_tool_is_kept_and_named(machine):
    free = flexopt.select(machine, TARGET)
    angle = machine.base.rest_angle + free.best.z[1:].sum()
    bounded = flexopt.select(machine, TARGET, constraints={"tool_angle": [angle + 0.05, angle + 0.3]})
    for candidate in bounded.candidates:
        turned = (machine.base.rest_angle + candidate.z[1:].sum() - angle) % (2 * np.pi)
        assert 0.05 - 1e-7 <= turned <= 0.3 + 1e-7
    assert "tool angle" in bounded.best.constraints
    assert bounded.best.objective <= free.best.objective + 1e-15


def test_an_exact_tool_angle_leaves_points(machine):
    """One equation more than the curve has freedom: no point of any grid fulfils it."""
    selection = flexopt.select(machine, TARGET, constraints={"tool_angle": -0.4})
    for candidate in selection.candidates:
        turned = (machine.base.rest_angle + candidate.z[1:].sum() + 0.4 + np.pi) % (2 * np.pi) - np.pi
        assert abs(turned) < 1e-7
        np.testing.assert_allclose(candidate.evaluation.end_point, TARGET, atol=1e-8)


def test_an_island_smaller_than_the_grid_is_found(machine):
    """The grid's steps are some 5 mm here."""
    region = [[1.3001, 1.3005]]
    selection = flexopt.select(machine, TARGET, constraints={"region": region})
    assert all(1.3001 - 1e-8 <= c.z[0] <= 1.3005 + 1e-8 for c in selection.candidates)


def test_a_range_by_name_is_the_pair(machine):
    pair = flexopt.select(machine, TARGET, base_range=(1.0, 1.4))
    table = flexopt.select(machine, TARGET, base_range={"x": (1.0, 1.4)})
    assert repr(pair.to_dict()) == repr(table.to_dict())


def square(number: int) -> int:
    if number == 7:
        raise flexopt.InputError("seven")
    return number * number


def _slowly(number: int) -> int:
    time.sleep(0.05)
    return square(number)


@pytest.mark.parametrize("workers", [1, 3])
def test_results_come_in_order(workers):
    counts = []
    assert in_parallel(_slowly, 6, workers, lambda number, _: counts.append(number)) == [0, 1, 4, 9, 16, 25]
    assert counts == [1, 2, 3, 4, 5, 6]
    assert not multiprocessing.active_children()


@pytest.mark.long
def test_something_else_is_done_meanwhile():
    done, counts = [], []
    assert in_parallel(_slowly, 7, 2, lambda number, _: counts.append(number), lambda: done.append(len(counts))) == [
        0,
        1,
        4,
        9,
        16,
        25,
        36,
    ]
    # After the first, which showed that processes pay, and before any of theirs is read.
    assert done == [1]
    assert counts == [1, 2, 3, 4, 5, 6, 7]
    in_parallel(_slowly, 3, 1, None, lambda: done.append(0))
    assert done == [1]
    with pytest.raises(flexopt.InputError, match="seven"):
        in_parallel(_slowly, 12, 3, None, lambda: None)
    with pytest.raises(ValueError, match="meanwhile"):
        in_parallel(_slowly, 7, 2, None, _fails)
    assert not multiprocessing.active_children()


def _fails() -> None:
    raise ValueError("meanwhile")


MANY = """
import time
from flexopt.foundation.processes import in_parallel
def large(number):
    time.sleep(2e-4)
    return bytes(300_000)
print(len(in_parallel(large, 3000, 2, None, lambda: time.sleep(0.2))))
"""


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="a function of a script's text cannot be sent to spawned processes")
def test_many_large_results_do_not_fill_the_pipes():
    out = subprocess.run([sys.executable, "-c", MANY], capture_output=True, text=True, timeout=60, check=True)
    assert out.stdout.split() == ["3000"], out.stderr


def test_errors_of_a_process_are_raised_here_and_nothing_is_left():
    with pytest.raises(flexopt.InputError, match="seven"):
        in_parallel(_slowly, 12, 3)
    assert not multiprocessing.active_children()


def _killing(number: int, which: tuple[int, ...], times: int, folder: str) -> int:
    """The number; the first so many times that one of these is worked on its process is killed."""
    time.sleep(0.05)
    begun = len([path for path in Path(folder).iterdir() if path.name.startswith(f"{number}-")])
    if number in which and begun < times:
        Path(folder, f"{number}-{begun}").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number


@pytest.mark.long("5-None", "3-int")
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere these are too few to start processes for")
@pytest.mark.parametrize(("workers", "ahead"), [(2, None), (3, int), (5, None)])
def test_what_a_killed_process_worked_on_is_done_again(tmp_path, workers, ahead):
    task = partial(_killing, which=(4, 7, 11), times=1, folder=str(tmp_path))
    assert in_parallel(task, 12, workers, meanwhile=ahead) == list(range(12))
    assert len(list(tmp_path.iterdir())) == 3
    assert not multiprocessing.active_children()


def _large(number: int) -> bytes:
    time.sleep(0.05)
    return bytes([number]) * 5_000_000


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere these are too few to start processes for")
def test_a_number_whose_process_is_killed_amid_its_answer_is_done_again():
    """More than a pipe holds: it waits until somebody reads."""

    def kill() -> None:
        time.sleep(0.5)
        multiprocessing.active_children()[0].kill()

    assert in_parallel(_large, 6, 2, meanwhile=kill) == [bytes([number]) * 5_000_000 for number in range(6)]


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere these are too few to start processes for")
def test_what_kills_every_process_is_named_and_the_rest_is_done(tmp_path):
    task = partial(_killing, which=(4,), times=9, folder=str(tmp_path))
    told = []

    def lost(number: int, sentence: str) -> int:
        told.append(sentence)
        return -number

    assert in_parallel(task, 8, 2, lost=lost) == [0, 1, 2, 3, -4, 5, 6, 7]
    assert len(told) == 1
    assert "ended from outside (signal 9) each of 2 times" in told[0]
    with pytest.raises(ProcessLost, match="number 5: its process was ended from outside"):
        in_parallel(task, 8, 2)
    assert not multiprocessing.active_children()


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere these are too few to start processes for")
def test_a_start_whose_processes_are_killed_costs_the_others_nothing(monkeypatch):
    """Of the processes that solve, each that comes to the third start is killed."""
    problem = flexopt.build_selection(flexopt.load("excavator"), (0.0, 1.6))
    whole = flexopt.solve_selection(problem, workers=1)
    third, parent, solve = whole.attempts[2].start, os.getpid(), optima._solve_start

    def killed(problem, starts, number):
        time.sleep(0.1)
        if os.getpid() != parent and tuple(starts[number]) == third:
            os.kill(os.getpid(), signal.SIGKILL)
        return solve(problem, starts, number)

    monkeypatch.setattr(optima, "_solve_start", killed)
    selection = flexopt.solve_selection(problem, workers=2)
    assert "ended from outside" in selection.attempts[2].outcome
    assert [a.start for a in selection.attempts] == [a.start for a in whole.attempts]
    assert {tuple(c.z) for c in selection.candidates} <= {tuple(c.z) for c in whole.candidates}


INTERRUPTED = """
import os, signal, threading, time, multiprocessing
from flexopt.foundation.processes import in_parallel
# Where the tests run in the background, interrupts are ignored from the start.
signal.signal(signal.SIGINT, signal.default_int_handler)
def interrupt():
    # Python loses one that falls into a finaliser: ask again.
    while True:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(5.0)
timer = threading.Timer(1.0, interrupt)
timer.daemon = True
timer.start()
try:
    in_parallel(lambda number: time.sleep(0.3), 200, 2)
except KeyboardInterrupt:
    print("interrupted", len(multiprocessing.active_children()))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="a lambda cannot be sent to spawned processes")
def test_an_interrupt_ends_the_processes():
    out = subprocess.run([sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, timeout=60, check=True)
    assert out.stdout.split() == ["interrupted", "0"], out.stderr


KILLED = """
import multiprocessing, threading, time
from flexopt.foundation.processes import in_parallel
def tell():
    while len(children := multiprocessing.active_children()) < 2:
        time.sleep(0.01)
    print(*[child.pid for child in children], flush=True)
threading.Thread(target=tell, daemon=True).start()
in_parallel(lambda number: time.sleep(0.1), 2000, 2)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="a lambda cannot be sent to spawned processes")
def test_processes_end_with_a_parent_that_is_killed():
    with subprocess.Popen([sys.executable, "-c", KILLED], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        left = [int(pid) for pid in parent.stdout.readline().split()]
        parent.kill()
    assert len(left) == 2
    for _ in range(600):
        left = [pid for pid in left if _state(pid) != "Z"]
        if not left:
            break
        time.sleep(0.05)
    assert not left


def _state(pid: int) -> str:
    """Z where it has ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0]
    except OSError:  # nobody knows it any more
        return "Z"


def _in_a_daemon(connection) -> None:
    connection.send(in_parallel(_slowly, 5, 2))


def test_where_processes_may_not_start_the_work_is_done_here():
    ours, theirs = multiprocessing.Pipe()
    daemon = multiprocessing.get_context("fork" if sys.platform == "linux" else "spawn").Process(
        target=_in_a_daemon, args=(theirs,), daemon=True
    )
    daemon.start()
    assert ours.recv() == [0, 1, 4, 9, 16]
    daemon.join()
