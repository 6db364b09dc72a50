"""Short runs and small maps take less time than the compilation of their graphs: pictures are those of interpreted ones."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from flexopt.foundation import kept


@pytest.fixture(scope="module", autouse=True)
def _interpreted() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FLEXOPT_COMPILE", "0")
        yield
    # Other rooms in this process make their own graphs, which may be compiled.
    kept.forget_all()
