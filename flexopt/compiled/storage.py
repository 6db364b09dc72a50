"""Compiled libraries on disk, shared by the processes of one user.

In: keys (digests of all that a library depends on) and freshly built files. Out: paths of complete libraries. A library
runs as soon as it is loaded, so the folder and what is read from it must belong to this user and be writable by nobody
else; where that is not so a folder of this process alone serves. The name of a library ends with the digest of its
content, which is checked before it is loaded: a damaged file is as good as none. Files appear whole, those that have
lain unused longest go when the folder grows beyond `FLEXOPT_CACHE_MB`, and the folder may be deleted at any time.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import os
import platform
import shutil
import stat
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Generator
from functools import cache
from pathlib import Path

from flexopt.compiled.locks import lock
from flexopt.errors import FlexoptWarning
from flexopt.foundation.writing import fresh_folder, write_file

MEGABYTES = 512.0
# Bytes of one library.
LIBRARY_MAX = 1_000_000_000
# Pruning leaves this share of the limit, and nothing that was used in the last seconds.
_LEFT, _RECENT = 0.8, 60.0
_FORGOTTEN = 86400.0
# Longer than any compilation may take: the process that has a key's lock may be stopped.
_PATIENCE = 180.0
_IN_USE = ".lock"


def digest(*parts: str | bytes) -> str:
    """40 hexadecimal digits that stand for the parts and where one ends and the next begins."""
    total = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        total.update(len(data).to_bytes(8, "little") + data)
    return total.hexdigest()[:40]


def cache_folder() -> Path:
    """`FLEXOPT_CACHE`, or the folder `flexopt` among this user's caches; it need not exist."""
    chosen = os.environ.get("FLEXOPT_CACHE")
    if chosen:
        return Path(chosen)
    if platform.system() == "Windows" and os.environ.get("LOCALAPPDATA"):
        return Path(os.environ["LOCALAPPDATA"]) / "flexopt" / "cache"
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "flexopt"


def find(key: str, suffix: str) -> Path | None:
    """The library stored under `key`, if it is whole and nobody else can have written it."""
    for folder in _folders():
        with contextlib.suppress(OSError):
            # What is not this user's stays where it is: it is neither loaded nor touched.
            for path in sorted(folder.glob(f"{key}-*{suffix}")):
                data = _read(path)
                if data is None:
                    continue
                if path.name == f"{key}-{digest(data)}{suffix}":
                    _touch(path)
                    return path
                path.unlink(missing_ok=True)
    return None


def store(key: str, suffix: str, build: Callable[[Path], None]) -> Path:
    """Let `build` write a library and keep it under `key`; what `build` raises passes through.

    Raises:
        OSError: there is no room for it anywhere.
    """
    with scratch() as folder:
        fresh = folder / f"library{suffix}"
        build(fresh)
        data = fresh.read_bytes()
    path = _write(f"{key}-{digest(data)}{suffix}", data)
    _prune(path.parent)
    return path


def remember(key: str, text: str) -> None:
    """Keep a short text under `key`, if there is room."""
    with contextlib.suppress(OSError):
        _write(f"{key}.txt", f"{digest(text)} {text}".encode())


def recall(key: str) -> str | None:
    """The text kept under `key`, if it is whole and nobody else can have written it."""
    for folder in _folders():
        with contextlib.suppress(OSError, ValueError):
            path = folder / f"{key}.txt"
            check, _, text = (_read(path) or b"").decode().partition(" ")
            if check == digest(text):
                _touch(path)
                return text
    return None


@contextlib.contextmanager
def alone(key: str) -> Generator[None]:
    """One process of this user at a time for each key; the others wait. A process that is killed holds nobody up."""
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):
            stack.enter_context(lock(_made(_root()) / f".lock-{key}", seconds=_PATIENCE, remove=True))
        yield


@contextlib.contextmanager
def in_use() -> Generator[None]:
    """Nothing is pruned meanwhile: around checking that a library is there, and loading it."""
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):
            stack.enter_context(lock(_root() / _IN_USE, shared=True, seconds=2.0))
        yield


@contextlib.contextmanager
def scratch() -> Generator[Path]:
    """A folder for the files of one compilation: in the cache, else where temporary files go.

    Raises:
        OSError: neither can be written.
    """
    with contextlib.ExitStack() as stack:
        try:
            folder = stack.enter_context(fresh_folder(_made(_root()), private=True))
        except OSError:
            made = tempfile.TemporaryDirectory(prefix="flexopt-", ignore_cleanup_errors=True)
            folder = Path(stack.enter_context(made))
        yield folder


def _folders() -> list[Path]:
    """Where libraries may be."""
    try:
        found = [_root()]
    except OSError:  # no folder at all
        return []
    return [*found, *([_temporary()] if _temporary.cache_info().currsize and _temporary() not in found else [])]


def _root() -> Path:
    """The cache folder, or where others may have written into it a private one, told once.

    Links are resolved first: what was checked is what is opened, wherever a link leads later.
    """
    root = Path(os.path.realpath(cache_folder()))
    reason = _mistrust(root)
    if not reason:
        return root
    _tell(f"the compile cache {str(root)!r} is not used: {reason}; a folder of this process alone takes its place. "
          "FLEXOPT_CACHE names another one")  # fmt: skip
    return _temporary()


def _mistrust(root: Path) -> str:
    """Empty if nobody but this user (and root) can have put something into the folder; else the reason."""
    if sys.platform == "win32":  # the folder lies among this user's own
        return ""
    try:
        for folder in (root, *root.parents):
            try:
                status = folder.stat()
            except (FileNotFoundError, NotADirectoryError):
                continue
            if folder == root and status.st_uid != os.geteuid():
                return "it belongs to another user"
            if folder == root and status.st_mode & 0o022:
                return "others may write into it"
            if status.st_uid not in (0, os.geteuid()):
                return f"{str(folder)!r} above it belongs to another user"
            if status.st_mode & 0o022 and not status.st_mode & stat.S_ISVTX and not _is_own_group(status):
                return f"others may write into {str(folder)!r} above it"
    except OSError as error:
        return error.strerror or str(error)
    return ""


def _is_own_group(status: os.stat_result) -> bool:
    """Whether a folder's group may write into it, others may not, and the group is of its owner alone."""
    if sys.platform == "win32" or status.st_mode & 0o002:
        return False
    import grp  # noqa: PLC0415  (not on Windows)
    import pwd  # noqa: PLC0415

    try:
        group, owner = grp.getgrgid(status.st_gid), pwd.getpwuid(status.st_uid)
    except KeyError:
        return False
    return group.gr_name == owner.pw_name and not set(group.gr_mem) - {owner.pw_name}


def _read(path: Path) -> bytes | None:
    """What a file holds; None unless it is a file of this user's, into which nobody else may write."""
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0))
    with os.fdopen(handle, "rb") as file:
        status = os.fstat(handle)
        ours = sys.platform == "win32" or (status.st_uid == os.geteuid() and not status.st_mode & 0o022)
        good = ours and stat.S_ISREG(status.st_mode) and status.st_size <= LIBRARY_MAX
        return file.read() if good else None


def _touch(path: Path) -> None:
    """Note that the file was used."""
    with contextlib.suppress(OSError):
        if time.time() - path.stat().st_mtime > _RECENT / 2:
            os.utime(path)


@cache
def _temporary() -> Path:
    """A folder of this process alone, for a cache that cannot be written or trusted."""
    folder = Path(tempfile.mkdtemp(prefix="flexopt-cache-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _made(root: Path) -> Path:
    root.mkdir(parents=True, exist_ok=True, mode=0o700)
    return root


def _write(name: str, data: bytes) -> Path:
    root = _root()
    try:
        return _write_in(root, name, data)
    except OSError:
        return _write_in(_temporary(), name, data)


def _write_in(root: Path, name: str, data: bytes) -> Path:
    """Write a file; one written by somebody else meanwhile is as good."""
    final = _made(root) / name
    try:
        write_file(final, data, private=True)
    except OSError:
        # Windows does not replace a library that is loaded.
        with contextlib.suppress(OSError):
            if _read(final) == data:
                return final
        raise
    return final


def _prune(root: Path) -> None:
    """Remove what has lain unused longest where the folder has grown beyond its bound."""
    most = 1e6 * _megabytes()
    with contextlib.suppress(OSError):
        for path in root.glob(".lock-*"):  # of processes that were killed
            if time.time() - path.stat().st_mtime > _FORGOTTEN:
                path.unlink()
        paths = [path for path in root.rglob("*") if not any(p.startswith(".") for p in path.relative_to(root).parts)]
        found = [(path.stat(), path) for path in paths if path.is_file()]
        size = sum(status.st_size for status, _ in found)
        if size <= most:
            return
        with lock(root / _IN_USE, seconds=0.0):
            for status, path in sorted(found, key=lambda pair: pair[0].st_mtime):
                used = max(status.st_mtime, path.stat().st_mtime)
                if size <= _LEFT * most:
                    return
                if time.time() - used > _RECENT:
                    path.unlink()
                    size -= status.st_size


def _megabytes() -> float:
    try:
        return max(0.0, float(os.environ.get("FLEXOPT_CACHE_MB", MEGABYTES)))
    except ValueError:
        return MEGABYTES


@cache
def _tell(message: str) -> None:
    warnings.warn(message, FlexoptWarning, stacklevel=2)
