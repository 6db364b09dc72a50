from __future__ import annotations

from functools import lru_cache

import pytest

from flexopt.simulation import run


@pytest.fixture
def interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs by CasADi's virtual machine; what was compiled before stays for the next test."""
    monkeypatch.setenv("FLEXOPT_COMPILE", "0")
    for name in ("_runner", "_baked_runner", "_singularity"):
        monkeypatch.setattr(run, name, lru_cache(getattr(run, name).__wrapped__))
