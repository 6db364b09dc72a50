"""Short runs and small maps take less time than the compilation of their graphs: pictures are those of interpreted ones."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from flexopt.loop import many
from flexopt.plant import plant
from flexopt.robustness import margin, measures
from flexopt.simulation import run
from flexopt.study.maps import follow, points

# What holds graphs that are compiled, or now are not: other rooms in this process make their own.
HELD = (
    measures.measures_of, margin.build_margin, plant._built, points._batches, run._runner, run._baked_runner,
    follow._task_at_rest, follow._task_as_it_sags, many._stacked_matrices,
)  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def _interpreted() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FLEXOPT_COMPILE", "0")
        yield
    for held in HELD:
        held.cache_clear()
