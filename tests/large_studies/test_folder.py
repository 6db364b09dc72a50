"""Nothing lost, nothing mixed: the files of a study whoever computes them, and after what happens to them."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import flexopt
from flexopt.large_studies import chunk
from flexopt.large_studies.folder import open_folder
from tests.large_studies.studies import files, small

ROOT = Path(flexopt.__file__).parents[1]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("undisturbed") / "study"
    flexopt.run_study(small(), folder, workers=1)
    return files(folder)


def test_the_files_are_the_same_whoever_computes_them(tmp_path: Path, undisturbed: dict[str, bytes]) -> None:
    assert len(undisturbed) == 6
    flexopt.run_study(small(), tmp_path / "two", workers=2)
    with ThreadPoolExecutor(3) as pool:
        flexopt.run_study(small(), tmp_path / "threads", executor=pool, workers=3)
    # Backwards, as nobody would.
    flexopt.run_study(small(), tmp_path / "backwards", workers=1)
    for path in (tmp_path / "backwards").rglob("*.nc"):
        path.unlink()
    held = open_folder(tmp_path / "backwards")
    for number in reversed(range(5)):
        assert chunk.finish_chunk(str(held.path), held.digest, number).how == "computed"
    assert files(tmp_path / "two") == undisturbed
    assert files(tmp_path / "threads") == undisturbed
    assert files(tmp_path / "backwards") == undisturbed


def test_what_is_missing_or_was_altered_is_computed_again(tmp_path: Path, undisturbed: dict[str, bytes]) -> None:
    folder = tmp_path / "study"
    flexopt.run_study(small(), folder, workers=1)
    first, second, third, *_ = sorted(folder.rglob("*.nc"))
    first.write_bytes(first.read_bytes()[:-100])
    content = bytearray(second.read_bytes())
    content[-1] ^= 1
    second.write_bytes(content)
    third.unlink()
    with pytest.raises(flexopt.InputError, match="has 4 of 5 chunks"):
        flexopt.open_study(folder).dataset()
    with pytest.warns(flexopt.FlexoptWarning, match="chunks 0, 1 were truncated or altered"):
        result = flexopt.run_study(small(), folder, workers=2)
    assert result.mended == (0, 1)
    assert "2 chunks were truncated" in repr(result)
    assert files(folder) == undisturbed
    assert flexopt.run_study(small(), folder, workers=2).mended == ()


def test_a_reader_refuses_an_altered_chunk(tmp_path: Path) -> None:
    flexopt.run_study(small(), tmp_path / "study", workers=1)
    path = sorted((tmp_path / "study").rglob("*.nc"))[3]
    path.write_bytes(path.read_bytes().replace(b"\x3f", b"\x3e", 1))
    result = flexopt.open_study(tmp_path / "study")
    with pytest.raises(flexopt.InputError, match="chunk 3 was truncated or altered"):
        result.reduce("w", "max")


def test_a_folder_that_holds_something_else_is_refused(tmp_path: Path) -> None:
    flexopt.run_study(small(), tmp_path / "study", workers=1)
    before = files(tmp_path / "study")
    with pytest.raises(flexopt.InputError, match="holds another study") as caught:
        flexopt.run_study(small(seed=4, chunk=64), tmp_path / "study", workers=1)
    assert {fault.field for fault in caught.value.faults} == {"seed", "chunk"}
    assert files(tmp_path / "study") == before
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "letter.txt").write_text("dear")
    with pytest.raises(flexopt.InputError, match=r"there is letter\.txt"):
        flexopt.run_study(small(), tmp_path / "other", workers=1)
    with pytest.raises(flexopt.InputError, match="it is a file"):
        flexopt.run_study(small(), tmp_path / "other" / "letter.txt", workers=1)


def test_numbers_that_would_come_out_otherwise_are_not_mixed(tmp_path: Path) -> None:
    flexopt.run_study(small(), tmp_path / "study", workers=1)
    document = tmp_path / "study" / "study.json"
    told = json.loads(document.read_text())
    told["made_by"]["bits"] = "00000000"
    document.write_text(json.dumps(told))
    with pytest.raises(flexopt.InputError, match="begun where numbers come out otherwise \\(bits 00000000 there"):
        flexopt.run_study(small(), tmp_path / "study", workers=1)
    told["study"]["seed"] = 7
    document.write_text(json.dumps(told))
    with pytest.raises(flexopt.InputError, match="was changed"):
        flexopt.open_study(tmp_path / "study")
    document.write_text("{")
    with pytest.raises(flexopt.InputError, match="cannot be read"):
        flexopt.open_study(tmp_path / "study")


def start(folder: Path, **environment: str) -> subprocess.Popen[bytes]:
    """A driver of its own, of selections that take a while."""
    program = (
        "import flexopt, signal, sys\n"
        # What runs in the background of a shell ignores it, and hands that on.
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "if __name__ == '__main__':\n"
        "    from tests.large_studies.test_folder import slow\n"
        "    flexopt.run_study(slow(), sys.argv[1], workers=2)\n"
    )
    script = folder.parent / "driver.py"
    script.write_text(program)
    known = os.environ | {"PYTHONPATH": str(ROOT)} | environment
    return subprocess.Popen([sys.executable, str(script), str(folder)], env=known, stderr=subprocess.DEVNULL)


def slow() -> flexopt.Study:
    return flexopt.Study(
        name="slow", problem="article", compute="selection", chunk=2,
        vary=[{"of": "target.x", "value": [-0.4, 0.4], "count": 12}],
    )  # fmt: skip


@pytest.fixture(scope="module")
def slow_files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("slow") / "study"
    flexopt.run_study(slow(), folder, workers=1)
    return files(folder)


def wait_for(folder: Path, chunks: int) -> None:
    end = time.monotonic() + 60
    while len(list(folder.rglob("*.nc"))) < chunks and time.monotonic() < end:
        time.sleep(0.01)


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_a_driver_that_ends_loses_what_is_in_flight_at_most(
    number: int, tmp_path: Path, slow_files: dict[str, bytes]
) -> None:
    folder = tmp_path / "study"
    driver = start(folder)
    wait_for(folder, 2)
    driver.send_signal(number)
    assert driver.wait(30) != 0
    time.sleep(0.5)  # its processes see that it is gone
    there = {name: content for name, content in files(folder).items() if name in slow_files}
    assert len(there) >= 3
    assert all(slow_files[name] == content for name, content in there.items())
    flexopt.run_study(slow(), folder, workers=2)
    assert files(folder) == slow_files


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_a_worker_that_is_killed_is_replaced(tmp_path: Path, slow_files: dict[str, bytes]) -> None:
    folder = tmp_path / "study"
    driver = start(folder)
    wait_for(folder, 2)
    children = Path(f"/proc/{driver.pid}/task/{driver.pid}/children")
    if not children.exists():
        driver.kill()
        pytest.skip("no /proc")
    ours = [int(child) for child in children.read_text().split()]
    os.kill(ours[0], signal.SIGKILL)
    assert driver.wait(60) == 0
    assert files(folder) == slow_files


@pytest.mark.skipif(sys.platform == "win32", reason="limits")
def test_a_full_disk_stops_the_study_in_one_sentence(tmp_path: Path, undisturbed: dict[str, bytes]) -> None:
    folder = tmp_path / "study"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    was = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (8000, before[1]))
    try:
        with pytest.raises(flexopt.StudyInterrupted) as caught:
            flexopt.run_study(small(), folder, workers=1)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, was)
    assert "cannot be written" in str(caught.value)
    assert "the same call goes on from there" in str(caught.value)
    assert (caught.value.done, caught.value.chunks) == (0, 5)
    flexopt.run_study(small(), folder, workers=1)
    assert files(folder) == undisturbed
