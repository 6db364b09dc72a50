"""Real schedulers and workers on this machine: the same files, and one sentence where one of them dies."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest

import flexopt
from benchmarks.local_cluster import local_cluster
from tests.large_studies.studies import files, small
from tests.large_studies.test_folder import slow, wait_for

pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("alone") / "study"
    flexopt.run_study(slow(), folder, workers=1)
    return files(folder)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
def test_the_files_are_those_of_one_process(tmp_path: Path) -> None:
    flexopt.run_study(small(), tmp_path / "alone", workers=1)
    with local_cluster(2) as cluster:
        result = flexopt.run_study(small(), tmp_path / "cluster", executor=cluster.address)
    assert result.complete
    assert files(tmp_path / "cluster") == files(tmp_path / "alone")


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("dies", ["worker", "scheduler"])
def test_whoever_dies(dies: str, tmp_path: Path, expected: dict[str, bytes]) -> None:
    folder = tmp_path / "study"
    with local_cluster(2) as cluster:
        process = cluster.workers[0] if dies == "worker" else cluster.scheduler

        def kill() -> None:
            wait_for(folder, 1)
            process.kill()

        killer = threading.Thread(target=kill)
        killer.start()
        if dies == "worker":
            flexopt.run_study(slow(), folder, executor=cluster.address)
        else:
            began = time.monotonic()
            with pytest.raises(flexopt.StudyInterrupted, match="the same call goes on from there"):
                flexopt.run_study(slow(), folder, executor=cluster.address)
            assert time.monotonic() - began < 60
        killer.join()
    flexopt.run_study(slow(), folder, workers=2)
    assert files(folder) == expected


def test_nobody_answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("flexopt.large_studies.engines.ANSWER", 0.5)
    with pytest.raises(flexopt.InputError, match="no Dask scheduler answers there"):
        flexopt.run_study(small(), tmp_path / "study", executor="tcp://127.0.0.1:9")
    with pytest.raises(flexopt.InputError, match=r"must be a concurrent\.futures\.Executor"):
        flexopt.run_study(small(), tmp_path / "study", executor="nowhere")


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
def test_no_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("flexopt.large_studies.engines.PATIENCE", 1.0)
    with local_cluster(0) as cluster, pytest.raises(flexopt.StudyInterrupted, match="has had no workers for 1 s"):
        flexopt.run_study(small(), tmp_path / "study", executor=cluster.address)
