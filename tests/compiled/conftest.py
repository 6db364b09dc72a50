from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from flexopt.compiled import compilers


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FLEXOPT_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture
def fresh(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """As a process in which nothing has been searched or told yet."""
    monkeypatch.delenv("FLEXOPT_COMPILE", raising=False)
    monkeypatch.setattr(compilers, "_warned", False)
    compilers._search.cache_clear()
    yield
    compilers._search.cache_clear()


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fresh: None) -> Path:
    folder = tmp_path / "cache"
    monkeypatch.setenv("FLEXOPT_CACHE", str(folder))
    return folder
