"""Files that are written over older ones: the older or the newer, whole, whatever happens in between."""

from __future__ import annotations

import ast
import errno
import multiprocessing
import os
import re
import stat
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NoReturn

import pytest

import flexopt
from flexopt.errors import FlexoptError, WriteError
from flexopt.foundation import writing
from flexopt.foundation.writing import replace_folder, write_file, write_files

POSIX = os.name == "posix"
ROOM = Path(flexopt.__file__).parent


def _names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def _no_space(*_: Any, **__: Any) -> NoReturn:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_file_is_written_with_the_mode_that_opening_it_would_give(tmp_path: Path) -> None:
    (tmp_path / "plain").write_bytes(b"")
    write_file(tmp_path / "one", "Käse\n")
    assert (tmp_path / "one").read_bytes() == "Käse\n".encode()
    assert (tmp_path / "one").stat().st_mode == (tmp_path / "plain").stat().st_mode
    assert _names(tmp_path) == ["one", "plain"]


@pytest.mark.parametrize("mode", [0o600, 0o644, 0o664] if POSIX else [])
def test_an_older_file_keeps_its_mode_and_a_link_stays_one(tmp_path: Path, mode: int) -> None:
    (tmp_path / "far").mkdir()
    older, link = tmp_path / "far" / "older", tmp_path / "link"
    older.write_bytes(b"older")
    older.chmod(mode)
    link.symlink_to(older)
    write_file(link, b"newer")
    assert link.is_symlink()
    assert older.read_bytes() == b"newer"
    assert stat.S_IMODE(older.stat().st_mode) == mode


def test_devices_and_pipes_are_written_through(tmp_path: Path) -> None:
    write_file(os.devnull, b"x")
    assert not Path(os.devnull).is_file()
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    for write, content in ((write_file, b"one two"), (writing.write_parts, iter([b"one ", b"two"]))):
        write(pipe, content)
        assert os.read(reader, 99) == b"one two"
    os.close(reader)
    assert pipe.is_fifo()


@pytest.mark.parametrize("where", ["fsync", "replace", "write"])
def test_a_full_disk_leaves_the_older_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    one.write_bytes(b"older")
    two.write_bytes(b"older")
    if where == "fsync":
        monkeypatch.setattr(writing.os, "fsync", _no_space)
    elif where == "replace":
        monkeypatch.setattr(Path, "replace", _no_space)
    else:
        monkeypatch.setattr(writing, "_fill", _no_space)
    with pytest.raises(
        WriteError, match=r"'.*one' cannot be written \(.*: 1.5 kB needed, .* free on its disk"
    ) as caught:
        write_files({one: b"x" * 1500, two: b"newer"})
    assert isinstance(caught.value, FlexoptError)
    assert isinstance(caught.value, OSError)
    assert (caught.value.errno, caught.value.size, caught.value.path) == (errno.ENOSPC, 1500, str(one))
    assert "\n" not in str(caught.value)
    assert one.read_bytes() == two.read_bytes() == b"older"
    assert _names(tmp_path) == ["one", "two"]


def test_none_of_several_files_is_swapped_before_all_are_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "one").write_bytes(b"older")
    filled, fill = [], writing._fill

    def fails_later(file: Any, data: bytes, **_: Any) -> None:
        if filled:
            _no_space()
        filled.append(data)
        fill(file, data)

    monkeypatch.setattr(writing, "_fill", fails_later)
    with pytest.raises(WriteError, match="two"):
        write_files({tmp_path / "one": b"newer", tmp_path / "two": b"newer"})
    assert (tmp_path / "one").read_bytes() == b"older"
    assert _names(tmp_path) == ["one"]


def test_what_is_no_place_for_a_file_is_said_in_a_sentence(tmp_path: Path) -> None:
    for path, reason in ((tmp_path, "directory"), (tmp_path / "none" / "file", "there is no folder")):
        for write in (lambda path: write_file(path, b""), writing.check_place):
            with pytest.raises(WriteError, match=rf"cannot be written \(.*{reason}"):
                write(path)
    writing.check_place(tmp_path / "file")
    assert not (tmp_path / "file").exists()


@pytest.mark.parametrize("exchange", [True, False])
def test_a_folder_is_replaced_and_keeps_what_is_not_ours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, exchange: bool
) -> None:
    if not exchange:
        monkeypatch.setattr(writing, "_exchanged", lambda *_: False)
    folder = tmp_path / "folder"
    replace_folder(folder, {"a/one": "1", "two": "2", "a/gone": "3"}, lambda _: False)
    (folder / "build" / "deep" / "empty").mkdir(parents=True)
    (folder / "build" / "deep" / "mine").write_bytes(b"mine")
    os.utime(folder / "build" / "deep" / "mine", (1, 1))
    replace_folder(folder, {"a/one": "11", "three/four": "4"}, lambda name: name.startswith("build/"))
    found = {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    assert found == {"a/one": b"11", "three/four": b"4", "build/deep/mine": b"mine"}
    assert (folder / "build" / "deep" / "empty").is_dir()
    assert (folder / "build" / "deep" / "mine").stat().st_mtime == 1
    assert _names(tmp_path) == ["folder"]


def test_a_full_disk_leaves_the_older_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "folder"
    replace_folder(folder, {"one": "1", "two": "2"}, lambda _: False)
    monkeypatch.setattr(writing.os, "fsync", _no_space)
    with pytest.raises(WriteError, match=r"folder.*8 bytes needed"):
        replace_folder(folder, {"one": "newer", "new": "new"}, lambda _: False)
    assert _names(folder) == ["one", "two"]
    assert (folder / "one").read_text(encoding="utf-8") == "1"
    assert _names(tmp_path) == ["folder"]


def _replace_often(folder: str, text: str) -> None:
    for _ in range(20):
        replace_folder(folder, {"one": text, "two": text}, lambda _: False)
        write_file(f"{folder}.txt", text * 1000)


def test_writers_at_once_all_succeed(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    context = multiprocessing.get_context("spawn")
    writers = [context.Process(target=_replace_often, args=(str(folder), text)) for text in "abc"]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join(120)
        assert writer.exitcode == 0
    assert (folder / "one").read_bytes() == (folder / "two").read_bytes()
    assert len(set((tmp_path / "folder.txt").read_text(encoding="utf-8"))) == 1
    assert _names(tmp_path) == ["folder", "folder.txt"]


KILLED = """
import sys
from flexopt.foundation.writing import replace_folder, write_file
print("ready", flush=True)
while True:
    for text in "ab":
        write_file(sys.argv[1] + "/file", text * 300_000)
        replace_folder(sys.argv[1] + "/folder", {name: text * 1000 for name in "pqr"}, lambda name: False)
"""


def test_killed_at_any_moment(tmp_path: Path) -> None:
    written = 0
    for k in range(6):
        with subprocess.Popen([sys.executable, "-c", KILLED, str(tmp_path)], stdout=subprocess.PIPE) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == b"ready\n"
            time.sleep(0.03 + 0.007 * k)
            process.kill()
        if (tmp_path / "file").exists():
            written += 1
            assert (tmp_path / "file").read_bytes() in (b"a" * 300_000, b"b" * 300_000)
        if (tmp_path / "folder").exists():
            parts = {(tmp_path / "folder" / name).read_bytes() for name in "pqr"}
            assert parts in ({b"a" * 1000}, {b"b" * 1000}), "all files of one time"
    assert written
    for path in tmp_path.glob(".flexopt-*"):
        os.utime(path, (0, 0))
    write_file(tmp_path / "last", b"")
    assert not list(tmp_path.glob(".flexopt-*")), "the next writer removes what was left"


def test_a_living_writers_file_is_not_swept(tmp_path: Path) -> None:
    if not POSIX:
        return
    with writing._beside(tmp_path / "file") as (fresh, _):
        os.utime(fresh, (0, 0))
        write_file(tmp_path / "other", b"")
        assert fresh.exists()


# What follows keeps other ways of writing out of the package.
_ALLOWED = {"foundation/writing.py"}
_METHODS = {"write_text", "write_bytes", "tofile", "to_csv", "to_pickle", "savetxt", "savez", "hardlink_to"}
_BUFFERED = {"savefig", "save", "to_netcdf", "ZipFile", "dump", "generate"}
# Methods of flexopt's own results have these names, too; a
# file that serves as a lock is empty; pandas gives text where it gets no path.
_OWN = {
    ("compiled/locks.py", "open"),
    ("cli/common.py", "to_netcdf"),
    ("cli/simulation.py", "save"),
    ("cli/studies.py", "to_netcdf"),
    ("large_studies/exporting.py", "to_csv"),
}


def _buffers(tree: ast.AST) -> set[str]:
    """Names of memory: parameters and variables that are `io.BytesIO`."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and "BytesIO()" in ast.unparse(node.value):
            found |= {name.id for name in ast.walk(node.targets[0]) if isinstance(name, ast.Name)}
    return found


def _mode(call: ast.Call, position: int) -> str:
    given = [keyword.value for keyword in call.keywords if keyword.arg == "mode"] + call.args[position : position + 1]
    return str(given[0].value) if given and isinstance(given[0], ast.Constant) else "r" if not given else "w"


def _writes(text: str, name: str) -> Iterator[str]:
    tree = ast.parse(text)
    buffers = _buffers(tree)
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        place = f"{name}:{node.lineno}: {ast.unparse(node)[:80]}"
        if called in ("open", "fdopen"):
            builtin = isinstance(node.func, ast.Name) or ast.unparse(node.func) in ("os.fdopen", "io.open")
            if ast.unparse(node.func) == "os.open":
                if "O_RDONLY" not in place and (name, called) not in _OWN:
                    yield place
            elif set("wax+") & set(_mode(node, 1 if builtin else 0)):
                yield place
        elif called in _METHODS and (name, called) not in _OWN:
            yield place
        elif called in _BUFFERED and (name, called) not in _OWN and node.args:
            first = node.args[0]
            if not (isinstance(first, ast.Name) and first.id in buffers) and _takes_a_path(called, node):
                yield place


def _takes_a_path(called: str, node: ast.Call) -> bool:
    if called == "ZipFile":
        return len(node.args) > 1  # a mode: without one it is read
    return True


def test_parts_are_one_file_or_none(tmp_path: Path) -> None:
    path = tmp_path / "file"
    writing.write_parts(path, iter([b"one ", b"", b"two"]))
    assert path.read_bytes() == b"one two"

    def broken() -> Iterator[bytes]:
        yield b"three"
        raise OSError(28, "No space left on device")

    with pytest.raises(WriteError, match="No space left"):
        writing.write_parts(path, broken())
    assert path.read_bytes() == b"one two"
    assert [each.name for each in tmp_path.iterdir()] == ["file"]


@pytest.mark.long
def test_nothing_else_writes_files() -> None:
    found: list[str] = []
    for path in sorted(ROOM.rglob("*.py")):
        name = path.relative_to(ROOM).as_posix()
        if name not in _ALLOWED:
            found += _writes(path.read_text(encoding="utf-8"), name)
    assert not found, "use flexopt.foundation.writing: " + "\n".join(found)


@pytest.mark.parametrize(
    "line",
    ["open(p, 'w')", "p.open('wb')", "open(p, mode='a')", "p.write_text('')", "p.write_bytes(b'')", "os.open(p, 1)",
     "figure.savefig(path)", "data.to_netcdf(path)", "image.save(path)", "zipfile.ZipFile(p, 'w')", "open(p, mode)"],
)  # fmt: skip
def test_the_search_finds_each_way(line: str) -> None:
    assert list(_writes(line, "x.py"))


@pytest.mark.parametrize(
    "line", ["open(p)", "p.open('rb')", "b = io.BytesIO()\nf.savefig(b, format='png')", "data.to_netcdf(engine='scipy')",
             "zipfile.ZipFile(p)"],
)  # fmt: skip
def test_the_search_leaves_reading_alone(line: str) -> None:
    assert not list(_writes(line, "x.py"))


WATCHED = """
import os, sys, warnings
import numpy as np
warnings.simplefilter("ignore")
os.chdir(sys.argv[1])
import flexopt
from flexopt.plotting import animate_trajectory
machine = flexopt.load("excavator")
run = flexopt.simulate(machine, (1.0, -1.4), duration=0.2)
group = flexopt.simulate_ensemble(machine, (1.0, -1.4), vary={"kp": [1e5, 2e5]}, duration=0.1)
plane = flexopt.map_workspace(machine, points=(3, 3), over="posture", epsilon_max=False)
choice = flexopt.select(machine, (0.0, 1.6), starts=1, workers=1)
opened = []
def watch(event, arguments):
    if event == "open" and isinstance(arguments[0], str):
        flags = arguments[2] or 0
        if flags & (os.O_WRONLY | os.O_RDWR):
            opened.append(os.path.realpath(arguments[0]))
sys.addaudithook(watch)
writers = {
    "run.csv": run.to_csv, "run.nc": run.to_netcdf, "run.png": run.plot, "run.svg": run.plot, "run.pdf": run.plot,
    "run.gif": run.animate, "run.html": run.animate, "group.nc": group.to_netcdf, "map.nc": plane.to_netcdf,
    "map.png": plane.plot, "choice.png": choice.plot,
    "bundle": lambda path: flexopt.export_c(machine, path, parts=["kinematics"]),
    "loop.fmu": lambda path: flexopt.export_fmu(machine, path, (1.0, -1.4), duration=0.5),
}
# By a writer that another has shown to go over an older one.
AGAIN = ("run.svg", "run.pdf", "group.nc", "map.nc", "map.png", "choice.png", "run.html")
for name, write in writers.items():
    for _ in range(1 if name in AGAIN else 2):  # over an older one, too
        write(name)
        here = [path for path in opened if path.startswith(os.path.realpath(sys.argv[1]))]
        assert here, name
        for path in here:
            assert ".flexopt-" in path and ".new" in path, path
        opened.clear()
print("watched", len(writers))
"""


@pytest.mark.long
def test_every_writer_goes_through_it(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", WATCHED, str(tmp_path)], capture_output=True, text=True, check=False, timeout=600,
        env=os.environ | {"FLEXOPT_COMPILE": "0"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    assert re.search(r"watched 13", done.stdout)


def _export_often(path: str) -> None:
    machine = flexopt.load("excavator")
    flexopt.export_fmu(machine, path, (1.0, -1.4), duration=0.5)


def _at_once(task: Callable[..., None], path: Path, count: int) -> list[int | None]:
    context = multiprocessing.get_context("spawn")
    processes = [context.Process(target=task, args=(str(path),)) for _ in range(count)]
    for process in processes:
        process.start()
    for process in processes:
        process.join(300)
    return [process.exitcode for process in processes]


@pytest.mark.long
def test_two_exports_of_one_fmu_at_once(tmp_path: Path) -> None:
    assert _at_once(_export_often, tmp_path / "loop.fmu", 2) == [0, 0]
    assert _names(tmp_path) == ["loop.fmu", "loop_reference.csv"]


def test_a_users_files_in_build_stay(tmp_path: Path) -> None:
    folder, machine = tmp_path / "bundle", flexopt.load("excavator")
    flexopt.export_c(machine, folder, parts=["kinematics"])
    (folder / "build").mkdir()
    (folder / "build" / "notes.txt").write_text("mine", encoding="utf-8")
    (folder / "src" / "excavator_common.o").write_bytes(b"")
    flexopt.export_c(machine, folder, parts=["kinematics", "controller"], overwrite=True)
    assert (folder / "build" / "notes.txt").read_text(encoding="utf-8") == "mine"
    flexopt.export_c(machine, folder, parts=["kinematics"], real="float", overwrite=True)
    assert (folder / "build" / "notes.txt").read_text(encoding="utf-8") == "mine"
