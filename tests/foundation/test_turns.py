"""Public calls compute with one thread of BLAS and leave the caller's number as it was."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from flexopt.foundation.turns import in_turn, one_blas_thread


def threads() -> set[int]:
    """Of all the BLAS libraries that are loaded."""
    assert np.linalg.norm(np.ones(2)) > 0
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_one_thread_within_turns_also_nested_and_after_an_error() -> None:
    @in_turn
    def fails() -> None:
        assert threads() == {1}
        raise ValueError

    with threadpool_limits(limits=2, user_api="blas"):
        assert threads() == {2}
        with one_blas_thread():
            assert threads() == {1}
            assert in_turn(threads)() == {1}
            assert threads() == {1}
        assert threads() == {2}
        try:
            fails()
        except ValueError:
            assert threads() == {2}


WITHIN = """
import json, sys
import numpy as np
import flexopt
from threadpoolctl import threadpool_info

def threads():
    return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]

before, seen = threads(), []
flexopt.map_loop(flexopt.load("excavator"), (0.04, -2.05), {"kp": (1e3, 1e5), "kv": (1e2, 1e4)}, points=(3, 3),
                 progress=lambda *_: seen.append(threads()))
assert "scipy.linalg" in sys.modules
print(json.dumps([before, seen, threads()]))
"""


@pytest.mark.long
@pytest.mark.parametrize("asked", ["", "OPENBLAS=2", "OPENBLAS=1", "OMP=1"])
def test_public_calls_compute_with_one_thread_in_libraries_that_are_loaded_meanwhile_too(asked: str) -> None:
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    library, _, count = asked.partition("=")
    environment |= {f"{library}_NUM_THREADS": count} if asked else {}
    told = subprocess.run([sys.executable, "-c", WITHIN], env=environment, check=True, capture_output=True, text=True)
    before, seen, after = json.loads(told.stdout)
    assert seen
    assert {count for each in seen for count in each} == {1}
    # Where SciPy brings a library of its own, it has as many threads afterwards as NumPy's.
    assert set(after) == set(before)
