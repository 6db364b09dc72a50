"""One BLAS thread and few rounds of the garbage collector for each process of tests, which are left out; a browser.

No test is timed: what hypothesis takes for slow is a machine that has other work.
"""

from __future__ import annotations

import gc
import os
import re
import sys
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from hypothesis import HealthCheck, settings

from tests.browser import chromium, pytest_runtest_setup
from tests.long_tests import pytest_addoption, pytest_collection_modifyitems

__all__ = [
    "chromium",
    "pytest_addoption",
    "pytest_collection_modifyitems",
    "pytest_ignore_collect",
    "pytest_runtest_setup",
]

# Before NumPy comes in, here and in the processes of pytest-xdist, each of which would have as many threads as there
# are processors, that wait for each other.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ.setdefault(name, "1")

settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")

# Graphs make hundreds of thousands of objects without cycles; looking for some among them takes an eighth of all time.
gc.set_threshold(200_000, 20, 100)

ROOT = Path(__file__).resolve().parents[1]
# Oracles without wheels, by platform: the same as the markers in pyproject.toml.
WITHOUT = {"win32": ("pinocchio", "example_robot_data"), "darwin": ("slycot",)}
# FLEXOPT_TESTS_WITHOUT names further ones, where old versions of other packages are tried that they cannot live with.
_told = os.environ.get("FLEXOPT_TESTS_WITHOUT", "").split()
missing: tuple[str, ...] = (*(name for name in WITHOUT.get(sys.platform, ()) if find_spec(name) is None), *_told)

_IMPORT = re.compile(r"^\s*(?:from|import)\s+([\w.]+)(?:\s+import\s+([\w, ]+))?", re.MULTILINE)


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """Leave out files that need what is missing; None lets pytest decide."""
    if missing and collection_path.suffix == ".py" and collection_path.name.startswith("test_"):
        return needs(collection_path, missing) or None
    return None


@cache
def needs(path: Path, names: tuple[str, ...]) -> bool:
    """Whether a file imports one of the modules, itself or by what it imports from the tests and benchmarks."""
    seen, waiting = set[Path](), [path]
    while waiting:
        file = waiting.pop()
        if file in seen or not file.exists():
            continue
        seen.add(file)
        for module, parts in _IMPORT.findall(file.read_text(encoding="utf-8")):
            top, *rest = module.split(".")
            if top in names:
                return True
            if top in {"tests", "benchmarks"}:
                place = ROOT.joinpath(top, *rest)
                waiting += [place.with_suffix(".py"), *(place / f"{part.strip()}.py" for part in parts.split(","))]
    return False
