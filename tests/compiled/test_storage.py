"""The cache on disk: shared, atomic, safe to damage, to delete, and to be without."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
import warnings
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from flexopt.compiled import batch, cache_folder, compilers, find_compiler, libraries, storage
from flexopt.compiled.locks import lock
from flexopt.compiled.storage import digest, find, recall, remember, store
from flexopt.errors import FlexoptWarning
from tests.compiled.comparison import QUIET

pytestmark = pytest.mark.filterwarnings(QUIET)

# The batch, the twin, and the recurrence in wide registers.
LIBRARIES = 3
PROGRAM = """
import sys, time, warnings
import casadi as ca, numpy as np
warnings.simplefilter("ignore")
from flexopt.compiled import accelerate, batch, recurrence
from flexopt.compiled import accelerated, batched
if "cached" in sys.argv:
    def refuse(*_):
        raise AssertionError("C generated again")
    accelerated._source = batched.kernel_source = refuse
    sys.modules["flexopt.compiled.recurrences"].recurrence_source = refuse
x = ca.SX.sym("x", 3)
f = ca.Function("f", [x], [ca.sin(x[0]) * x[1] + ca.sqrt(ca.fabs(x[2]))])
e, c = ca.SX.sym("e", 0), ca.SX.sym("c")
step = ca.Function("step", [x, e, c], [ca.vertcat(c * x[1], x[2], ca.cos(x[0])), x[0]])
points = np.random.default_rng(0).normal(size=(3, 100))
start = time.perf_counter()
b, twin, run = batch(f), accelerate(f), recurrence(step, many=True)
seconds = time.perf_counter() - start
expected = np.sin(points[0]) * points[1] + np.sqrt(np.abs(points[2]))
assert np.allclose(b(points)[0][0], expected, rtol=1e-13)
assert np.isclose(float(twin(points[:, 0])), expected[0])
last = run(points, [0.5], steps=3).last
assert np.allclose(last[2], np.cos(0.5 * points[2]), rtol=1e-13)
assert b.compiled == run.compiled
print(b.compiled, seconds)
"""


def _start(*arguments: str, **environment: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *arguments], stdout=subprocess.PIPE, text=True, env=os.environ | environment
    )


def _finished(process: subprocess.Popen[str]) -> tuple[bool, float]:
    output, _ = process.communicate(timeout=120)
    assert process.returncode == 0
    compiled, seconds = output.split()
    assert compiled == str(find_compiler() is not None)
    return compiled == "True", float(seconds)


def _libraries(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*-*") if path.is_file() and path.suffix in {".so", ".dylib", ".dll"}]


@pytest.mark.long
def test_a_second_process_loads_what_the_first_built(empty_cache: Path) -> None:
    compiled, _ = _finished(_start())
    assert len(_libraries(empty_cache)) == (LIBRARIES if compiled else 0)
    _, seconds = _finished(_start("cached"))
    assert seconds < 1.0  # 5 ms on an idle machine


@pytest.mark.long
def test_processes_at_once(empty_cache: Path) -> None:
    compiled = [_finished(process)[0] for process in [_start() for _ in range(3)]]
    assert len(_libraries(empty_cache)) == (LIBRARIES if compiled[0] else 0), "one process compiles, the others wait"
    _finished(_start("cached"))
    assert not list(empty_cache.rglob(".flexopt-*"))
    assert [path.name for path in empty_cache.glob(".lock*")] in ([".lock"], [])


@pytest.mark.long
@pytest.mark.parametrize("damage", ["emptied", "cut", "changed", "text"])
def test_a_damaged_cache_is_built_again(empty_cache: Path, damage: str) -> None:
    compiled, _ = _finished(_start())
    for path in [path for path in empty_cache.rglob("*") if path.is_file() and path.name != ".lock"]:
        data = bytearray(path.read_bytes())
        if damage == "changed":
            data[len(data) // 2] ^= 255
        new = {"emptied": b"", "cut": data[: len(data) // 2], "changed": data, "text": b"text"}[damage]
        path.write_bytes(new)
    _finished(_start())
    if compiled:
        _finished(_start("cached"))
        assert len(_libraries(empty_cache)) == LIBRARIES


def test_a_cache_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    before = set(Path(tmp_path).rglob("*"))
    _finished(_start(FLEXOPT_CACHE=str(tmp_path / "file" / "cache"), TMPDIR=str(tmp_path)))
    assert set(Path(tmp_path).rglob("*")) == before, "the temporary folder is removed at the end"


@pytest.mark.long
def test_a_cache_that_may_only_be_read(empty_cache: Path) -> None:
    empty_cache.mkdir()
    _finished(_start())
    for path in [empty_cache, *empty_cache.rglob("*")]:
        path.chmod(0o555)
    try:
        _finished(_start("cached"))
    finally:
        for path in [empty_cache, *empty_cache.rglob("*")]:
            path.chmod(0o755)


@pytest.mark.long
def test_killed_while_compiling(empty_cache: Path, tmp_path: Path) -> None:
    good = find_compiler()
    if good is None:
        _finished(_start())
        return
    script, pid = tmp_path / "cc.py", tmp_path / "pid"
    script.write_text(
        f"""
import os, subprocess, sys, time
if "flexopt_answer" in open(next(a for a in sys.argv if a.endswith((".c", ".cpp")))).read():
    sys.exit(subprocess.call({list(good.command)!r} + sys.argv[1:]))
open(sys.argv[sys.argv.index("-o") + 1], "w").write("half a library")
open({str(pid)!r} + ".new", "w").write(str(os.getpid()))
os.replace({str(pid)!r} + ".new", {str(pid)!r})
time.sleep(60)
""",
        encoding="utf-8",
    )
    process = _start(FLEXOPT_CXX=f"'{sys.executable}' '{script}'")
    deadline = time.monotonic() + 60
    while not pid.exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    process.kill()
    process.communicate()
    os.kill(int(pid.read_text(encoding="utf-8")), 9)
    assert not _libraries(empty_cache)
    _finished(_start())


def test_the_cache_may_be_deleted_while_in_use(empty_cache: Path) -> None:
    x = ca.SX.sym("x")
    function = ca.Function("f", [x], [x + 1])
    first = batch(function)
    shutil.rmtree(empty_cache, ignore_errors=True)
    np.testing.assert_array_equal(first([[1.0, 2.0]])[0], [[2.0, 3.0]])
    np.testing.assert_array_equal(batch(function)([[1.0, 2.0]])[0], [[2.0, 3.0]])


def test_texts_and_files_come_back_whole_or_not_at_all(empty_cache: Path) -> None:
    key = digest("a", b"b")
    assert key != digest("ab", b"")
    assert recall(key) is None
    assert find(key, ".so") is None
    remember(key, "two words")
    assert recall(key) == "two words"
    path = store(key, ".so", lambda library: library.write_bytes(b"content") and None)
    assert find(key, ".so") == path
    path.write_bytes(b"conten")
    assert find(key, ".so") is None
    assert not path.exists()


def test_where_the_cache_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("FLEXOPT_CACHE", str(tmp_path))
    assert cache_folder() == tmp_path
    monkeypatch.delenv("FLEXOPT_CACHE")
    if sys.platform != "win32":
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
        assert cache_folder() == tmp_path / "xdg" / "flexopt"
        monkeypatch.delenv("XDG_CACHE_HOME")
        assert cache_folder() == Path.home() / ".cache" / "flexopt"


def test_what_killed_processes_left_is_swept(empty_cache: Path) -> None:
    remember("one", "1")
    old, new = empty_cache / f".flexopt-{'0' * 16}.new", empty_cache / f".flexopt-{'1' * 16}.new"
    for path in (old, new):
        path.write_bytes(b"")
    os.utime(old, (0, 0))
    remember("two", "2")
    assert not old.exists()
    assert new.exists()


def _foreign(path: Path, how: str) -> None:
    """Let somebody else be able to have written a file or a folder."""
    if how == "owner":
        os.chown(path, 12345, -1)
    elif how == "group" and os.geteuid() == 0:
        os.chown(path, -1, 12345)
        path.chmod(path.stat().st_mode | 0o020)
    else:
        path.chmod(path.stat().st_mode | {"group": 0o020, "world": 0o002}[how])


WAYS = [] if sys.platform == "win32" else ["group", "world", *(["owner"] if os.geteuid() == 0 else [])]


@pytest.mark.parametrize("how", WAYS)
@pytest.mark.parametrize("what", ["folder", "above", "files"])
def test_what_others_may_have_written_is_not_loaded(
    empty_cache: Path, monkeypatch: pytest.MonkeyPatch, what: str, how: str
) -> None:
    root = empty_cache / "inner"
    monkeypatch.setenv("FLEXOPT_CACHE", str(root))
    key = digest("key")
    path = store(key, ".so", lambda library: library.write_bytes(b"content") and None)
    remember(key, "flags")
    assert path.parent == root
    assert (find(key, ".so"), recall(key)) == (path, "flags")
    for place in {"folder": [root], "above": [empty_cache], "files": [path, root / f"{key}.txt"]}[what]:
        _foreign(place, how)
    monkeypatch.setattr(storage, "_temporary", cache(storage._temporary.__wrapped__))
    if what == "files":
        assert find(key, ".so") is None
        assert recall(key) is None
        assert path.exists(), "not ours to remove"
        again = store(key, ".so", lambda library: library.write_bytes(b"content") and None)
        assert again == path
        assert find(key, ".so") == path
        return
    storage._tell.cache_clear()
    if what == "above" and how == "group" and os.geteuid() != 0:
        return  # it may be the user's own group
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        assert find(key, ".so") is None
        assert recall(key) is None
        own = store(key, ".so", lambda library: library.write_bytes(b"content") and None)
        remember(key, "flags")
        assert (find(key, ".so"), recall(key)) == (own, "flags")
    assert [warning.category for warning in told] == [FlexoptWarning]
    assert "is not used: " in str(told[0].message)
    assert root not in own.parents
    assert own.parent.stat().st_mode & 0o777 == 0o700


def test_a_link_is_not_followed(empty_cache: Path, tmp_path: Path) -> None:
    key, real = digest("key"), tmp_path / "real.so"
    path = store(key, ".so", lambda library: library.write_bytes(b"content") and None)
    path.rename(real)
    path.symlink_to(real)
    assert find(key, ".so") is None


def test_the_cache_is_bounded_and_loses_what_was_used_least_recently(
    empty_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FLEXOPT_CACHE_MB", "0.01")

    def stored(name: str, size: int = 3000) -> Path:
        return store(digest(name), ".so", lambda library: library.write_bytes(name.encode() * size) and None)

    old = [stored(name) for name in "abc"]
    for k, path in enumerate(old):
        os.utime(path, (k + 1, k + 1))
    assert find(digest("a"), ".so") == old[0], "used again: now the last to go"
    with storage.in_use():
        stored("d")
        assert all(path.exists() for path in old), "not while somebody loads"
    recent = stored("e")
    assert [path.exists() for path in old] == [True, False, False]
    assert recent.exists(), "what was used in the last minute stays, though the bound is passed"
    assert sum(path.stat().st_size for path in empty_cache.glob("*.so")) <= 10_000


HOLDER = """
import sys, time
from flexopt.compiled.storage import alone
with alone("key"):
    print("held", flush=True)
    time.sleep(60)
"""


def test_a_killed_process_holds_nobody_up(empty_cache: Path) -> None:
    holder = subprocess.Popen([sys.executable, "-c", HOLDER], stdout=subprocess.PIPE)
    assert holder.stdout is not None
    assert holder.stdout.readline() == b"held\n"
    if sys.platform != "win32":
        with pytest.raises(BlockingIOError), lock(empty_cache / ".lock-key", seconds=0.0):
            pass
    holder.kill()
    holder.communicate()
    with storage.alone("key"):
        pass
    assert not (empty_cache / ".lock-key").exists()


def test_no_room_for_anything(empty_cache: Path, tmp_path: Path) -> None:
    """Neither the cache nor the folder for temporary files can be written."""
    (tmp_path / "file").write_bytes(b"")
    nowhere = str(tmp_path / "file" / "none")
    code = "import os, tempfile; tempfile._candidate_tempdir_list = lambda: [os.environ['TMPDIR']]\n"
    done = subprocess.run(
        [sys.executable, "-c", code + PROGRAM.replace('simplefilter("ignore")', 'simplefilter("always")')],
        capture_output=True, text=True, env=os.environ | {"FLEXOPT_CACHE": nowhere, "TMPDIR": nowhere}, timeout=120,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("False"), "the virtual machine serves"
    if find_compiler() is not None:
        assert done.stderr.count("CompilerNotFound") == 1
        assert "no room for its files" in done.stderr


def _function() -> ca.Function:
    x = ca.SX.sym("x", 3)
    return ca.Function("f", [x], [ca.sin(x[0]) * x[1] + x[2]])


@pytest.mark.skipif(sys.platform == "win32", reason="built by the system's compiler")
def test_a_library_without_its_function_is_built_again(empty_cache: Path, tmp_path: Path) -> None:
    assert batch(_function()).compiled
    (path,) = empty_cache.glob("*.so")
    (tmp_path / "empty.c").write_text("int nothing;\n")
    subprocess.run(["cc", "-shared", "-fPIC", "-o", tmp_path / "empty.so", tmp_path / "empty.c"], check=True)
    content = (tmp_path / "empty.so").read_bytes()
    path.unlink()
    planted = empty_cache / f"{path.name.partition('-')[0]}-{digest(content)}.so"
    planted.write_bytes(content)
    planted.chmod(0o600)
    kernel = batch(_function())
    assert kernel.compiled
    np.testing.assert_allclose(kernel(np.ones((3, 4)))[0][0], np.sin(1.0) + 1.0, rtol=1e-13)


@pytest.mark.skipif(sys.platform == "win32", reason="a script as compiler")
def test_a_failure_is_not_kept_on_disk(empty_cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A full disk, of which a compiler complains at a place in the source."""
    find_compiler()
    real, full = compilers.Compiler.build, "source.cpp:1:1: fatal error: error writing to -: No space left on device"

    def build(*_: object, **__: object) -> None:
        raise compilers.CompilationFailed("cc ended with 1", full)

    monkeypatch.setattr(compilers.Compiler, "build", build)
    assert not batch(_function()).compiled
    monkeypatch.setattr(compilers.Compiler, "build", real)
    # As another process, which knows nothing of it.
    monkeypatch.setattr(libraries, "_hopeless", set())
    assert batch(_function()).compiled


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege there")
def test_what_was_checked_is_what_is_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A link that leads elsewhere once the folder was looked at: names are resolved before."""
    own, theirs, link = (tmp_path / name for name in ("own", "theirs", "link"))
    own.mkdir(mode=0o700)
    theirs.mkdir()
    theirs.chmod(0o777)
    link.symlink_to(own)
    monkeypatch.setenv("FLEXOPT_CACHE", str(link))
    mistrust = storage._mistrust

    def switched(root: Path) -> str:
        reason = mistrust(root)
        link.unlink(missing_ok=True)
        link.symlink_to(theirs)
        return reason

    monkeypatch.setattr(storage, "_mistrust", switched)
    store("key", ".so", lambda fresh: fresh.write_bytes(b"library"))
    assert not list(theirs.iterdir())
