"""The article, computed once for the whole room, by the command that users run."""

from __future__ import annotations

import io
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple

import pytest

import flexopt.article
from flexopt.article import Reproduction
from flexopt.article import page as article_page
from flexopt.cli import main
from flexopt.study import page


class Run(NamedTuple):
    """What one `flexopt reproduce --json --out FOLDER` computed, told and wrote."""

    result: Reproduction
    stages: list[tuple[int, int]]
    stdout: str
    folder: Path
    pictures: dict[str, page.Picture]


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """On maps of 101 × 101 points, of which the defaults have 400 × 400."""
    results, stages, text = list[Reproduction](), list[tuple[int, int]](), io.StringIO()
    folder, compute = tmp_path_factory.mktemp("report") / "new" / "folder", flexopt.article.reproduce
    drawn, draw = dict[str, page.Picture](), page.pictures

    def coarse(*, progress) -> Reproduction:
        def both(done: int, total: int) -> None:
            stages.append((done, total))
            progress(done, total)

        results.append(compute(points=(101, 101), progress=both))
        return results[-1]

    def recorded(*arguments) -> dict[str, page.Picture]:
        drawn.update(draw(*arguments))
        return drawn

    with pytest.MonkeyPatch.context() as patch, redirect_stdout(text), redirect_stderr(io.StringIO()):
        patch.setattr(flexopt.article, "reproduce", coarse)
        patch.setattr(article_page, "pictures", recorded)
        main(["reproduce", "--json", "--out", str(folder)])
    return Run(results[0], stages, text.getvalue(), folder, drawn)


@pytest.fixture(scope="session")
def result(run: Run) -> Reproduction:
    return run.result


@pytest.fixture(scope="session")
def files(run: Run) -> tuple[Path, Path]:
    """The page and the numbers beside it."""
    return run.folder / "report.html", run.folder / "report.json"
