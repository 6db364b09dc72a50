"""Write files whole: beside the older one, then swapped.

In: a path and what the file shall hold. Out: that file, or a `WriteError` and the older file as it was. A full disk, a
kill or a second writer leaves the older file or the newer one, never a part; every file that flexopt writes for
somebody comes through here.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import re
import secrets
import shutil
import stat
import sys
import time
from collections.abc import Callable, Generator, Iterable, Mapping
from pathlib import Path
from typing import IO, Any

from flexopt.errors import WriteError

if sys.platform != "win32":
    import fcntl

# What a killed process leaves behind has such a name; nobody else's file has.
_FRESH = re.compile(r"\.flexopt-[0-9a-f]{16}\.new")
# Without locks that end with their owner, only age tells what was left behind, s.
_STALE = 86400.0
_AT_FDCWD, _EXCHANGE = -100, 2

Content = str | bytes | bytearray
AnyPath = str | os.PathLike[str]


def write_file(path: AnyPath, content: Content, *, private: bool = False, durable: bool = True) -> None:
    """Write one file; text as UTF-8. A link stays one, and an older file's mode stays.

    Args:
        path: of the file.
        content: what it shall hold.
        private: it belongs to this user, and nobody else may read or write it, whatever an older one was.
        durable: wait until it is on the disk. Else a loss of power may leave less, which its reader must find out.

    Raises:
        WriteError: it cannot be written; the older file is as it was.
    """
    write_files({path: content}, private=private, durable=durable)


def write_files(contents: Mapping[Any, Content], *, private: bool = False, durable: bool = True) -> None:
    """Write several files, path -> content, as `write_file` does. None is swapped before all are written.

    Raises:
        WriteError: one cannot be written.
    """
    with contextlib.ExitStack() as stack:
        ready: list[tuple[Path, Path, IO[bytes], bytes | bytearray]] = []
        for path, content in contents.items():
            data = content.encode() if isinstance(content, str) else content
            with _told(path, len(data)):
                final = Path(os.path.realpath(path))
                if _is_stream(final):
                    final.write_bytes(data)
                    continue
                _check(final)
                fresh, file = stack.enter_context(_beside(final, 0o600 if private else 0o666))
                _fill(file, data, durable=durable)
                ready.append((fresh, final, file, data))
        for fresh, final, file, data in ready:
            with _told(final, len(data)):
                _swap(fresh, final, file, keep=not private)


def check_place(path: AnyPath) -> None:
    """Whether a file can stand there, asked before what takes long to make is made.

    Raises:
        WriteError: it cannot.
    """
    final = Path(os.path.realpath(path))
    with _told(path, 0):
        _check(final)
        final.parent.stat()


def write_parts(path: AnyPath, parts: Iterable[bytes]) -> None:
    """Write one file whose content comes in parts, of which one is in memory at a time; else as `write_file`.

    Raises:
        WriteError: it cannot be written; the older file is as it was.
    """
    size = 0
    with _told(path, 0):
        final = Path(os.path.realpath(path))
        if _is_stream(final):
            with final.open("wb") as stream:
                stream.writelines(parts)
            return
        _check(final)
        with _beside(final) as (fresh, file):
            for part in parts:
                size += len(part)
                with _told(path, size):
                    file.write(part)
            with _told(path, size):
                _fill(file, b"")
                _swap(fresh, final, file, keep=True)


def make_folder(path: AnyPath) -> Path:
    """A folder, made with those above it if missing.

    Raises:
        WriteError: it cannot be made.
    """
    with _told(path, 0):
        Path(path).mkdir(parents=True, exist_ok=True)
    return Path(path)


def replace_folder(path: AnyPath, contents: Mapping[str, Content], keep: Callable[[str], bool]) -> None:
    """Make a folder hold `contents`, path inside it -> content, and what `keep` names of the files that it holds.

    Where the system can exchange two folders in one step, all files change at once; else one after the other.

    Raises:
        WriteError: it cannot be written; nothing has changed (files changed one by one are each old or new).
    """
    folder = Path(os.path.realpath(path))
    data = {name: text.encode() if isinstance(text, str) else text for name, text in contents.items()}
    with _told(path, sum(map(len, data.values()))):
        folder.parent.mkdir(parents=True, exist_ok=True)
        if folder.is_dir() and not os.access(folder.parent, os.W_OK):
            _one_by_one(folder, data, keep)
            return
        with fresh_folder(folder.parent) as fresh:
            new = fresh / "folder"
            for name, content in data.items():
                (new / name).parent.mkdir(parents=True, exist_ok=True)
                with (new / name).open("wb") as file:
                    _fill(file, content)
            _keep_files(folder, new, keep)
            if not _put(new, folder):
                _one_by_one(folder, data, keep)
                return
            # What came into the older folder meanwhile.
            _keep_files(new, folder, keep)


def _check(final: Path) -> None:
    """What opening the file for writing would have refused."""
    if final.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if final.exists() and not os.access(final, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))


def _is_stream(path: Path) -> bool:
    """Whether a path names a pipe or a device, which cannot be swapped."""
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    return not stat.S_ISREG(mode) and not stat.S_ISDIR(mode)


@contextlib.contextmanager
def _told(path: AnyPath, size: int) -> Generator[None]:
    """What the system refuses as one sentence."""
    try:
        yield
    except WriteError:
        raise
    except OSError as error:
        reason = error.strerror or str(error)
        folder = Path(os.path.realpath(path)).parent
        if error.errno == errno.ENOENT and not folder.is_dir():
            reason = f"there is no folder {str(folder)!r}"
        elif error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            free = ""
            with contextlib.suppress(OSError):
                free = f", {_amount(shutil.disk_usage(folder).free)} free on its disk"
            reason = f"{reason}: {_amount(size)} needed{free}; what was there is as it was"
        message = f"{os.fspath(path)!r} cannot be written ({reason})"
        raise WriteError(message, path=os.fspath(path), size=size, code=error.errno) from error


def _amount(size: int) -> str:
    """Bytes in a unit that can be read."""
    unit, power = next(((u, p) for u, p in (("GB", 3), ("MB", 2), ("kB", 1)) if size >= 1000**p), ("bytes", 0))
    return f"{size / 1000**power:.3g} {unit}" if power else f"{size} {unit}"


def _fill(file: IO[bytes], data: bytes | bytearray, *, durable: bool = True) -> None:
    """Write and bring to the disk, so that the swap never comes before the content."""
    file.write(data)
    file.flush()
    if not durable:
        return
    with contextlib.suppress(OSError) if sys.platform == "darwin" else contextlib.nullcontext():
        os.fsync(file.fileno())


@contextlib.contextmanager
def _beside(final: Path, mode: int = 0o666) -> Generator[tuple[Path, IO[bytes]]]:
    """An empty file of this process in the same folder, removed unless it was swapped."""
    _sweep(final.parent)
    fresh = final.parent / _fresh_name()
    handle = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), mode)
    file = os.fdopen(handle, "wb")
    try:
        _hold(handle)
        yield fresh, file
    finally:
        # A write that failed is tried again on closing.
        with contextlib.suppress(OSError):
            file.close()
        with contextlib.suppress(OSError):
            fresh.unlink(missing_ok=True)


def _swap(fresh: Path, final: Path, file: IO[bytes], *, keep: bool) -> None:
    """Put the file in the place of the older one; `keep` its mode and, where that is allowed, its owner."""
    with contextlib.suppress(FileNotFoundError):
        if keep and sys.platform != "win32":
            old = final.stat()
            with contextlib.suppress(OSError):
                if (old.st_uid, old.st_gid) != (os.geteuid(), os.getegid()):
                    os.fchown(file.fileno(), old.st_uid, old.st_gid)
            os.fchmod(file.fileno(), stat.S_IMODE(old.st_mode) & 0o777)
    if sys.platform == "win32":
        file.close()
    fresh.replace(final)


def _fresh_name() -> str:
    return f".flexopt-{secrets.token_hex(8)}.new"


@contextlib.contextmanager
def fresh_folder(parent: Path, *, private: bool = False) -> Generator[Path]:
    """An empty folder of this process inside another, removed with what it holds at the end, or after a kill."""
    _sweep(parent)
    fresh = parent / _fresh_name()
    fresh.mkdir(mode=0o700 if private else 0o777)
    with contextlib.ExitStack() as stack:
        if sys.platform != "win32":  # where folders cannot be opened
            handle = os.open(fresh, os.O_RDONLY)
            stack.callback(os.close, handle)
            _hold(handle)
        stack.callback(shutil.rmtree, fresh, ignore_errors=True)
        yield fresh


def _hold(handle: int) -> bool:
    """Lock an open file for as long as this process lives and has it open; whether that worked."""
    if sys.platform == "win32":
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _sweep(folder: Path) -> None:
    """Remove what processes that were killed left in a folder."""
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for path in [Path(entry.path) for entry in entries if _FRESH.fullmatch(entry.name)]:
            with contextlib.suppress(OSError):
                if _is_left(path):
                    shutil.rmtree(path) if path.is_dir() else path.unlink()


def _is_left(path: Path) -> bool:
    age = time.time() - path.lstat().st_mtime
    if sys.platform == "win32":
        return age > _STALE
    if age < 1.0:  # its owner may be about to lock it
        return False
    handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
    try:
        return _hold(handle)
    finally:
        os.close(handle)


def _keep_files(source: Path, target: Path, keep: Callable[[str], bool]) -> None:
    """Let the files of `source` that `keep` names be in `target`, too, unless it has others of their names."""
    for path in sorted(source.rglob("*")) if source.is_dir() else []:
        name = path.relative_to(source).as_posix()
        copy = target / name
        if path.is_dir() and not path.is_symlink():
            if keep(f"{name}/"):
                copy.mkdir(parents=True, exist_ok=True)
        elif keep(name) and not os.path.lexists(copy):
            copy.parent.mkdir(parents=True, exist_ok=True)
            try:
                os.link(path, copy, follow_symlinks=False)
            except (OSError, NotImplementedError):
                shutil.copy2(path, copy, follow_symlinks=False)


def _put(new: Path, folder: Path) -> bool:
    """Put a folder in the place of another, which comes to lie where it was; False where that takes several steps."""
    for _ in range(3):
        try:
            if not folder.exists():
                new.rename(folder)
                return True
        except OSError as error:
            if error.errno not in (errno.EEXIST, errno.ENOTEMPTY):
                raise
        if _exchanged(new, folder):
            with contextlib.suppress(OSError):
                folder.chmod(stat.S_IMODE(new.stat().st_mode))
            return True
        if folder.exists():
            return False
    return False


def _exchanged(first: Path, second: Path) -> bool:
    """Exchange two folders in one step; False where the system does not do that."""
    a, b = os.fsencode(first), os.fsencode(second)
    try:
        library = ctypes.CDLL(None, use_errno=True)
        if sys.platform == "darwin":
            return library.renamex_np(a, b, ctypes.c_uint(_EXCHANGE)) == 0
        return library.renameat2(_AT_FDCWD, a, _AT_FDCWD, b, ctypes.c_uint(_EXCHANGE)) == 0
    except (AttributeError, OSError, TypeError):
        return False


def _one_by_one(folder: Path, contents: Mapping[str, bytes | bytearray], keep: Callable[[str], bool]) -> None:
    """Each file swapped on its own; then those that are neither new nor kept removed."""
    for name in contents:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
    write_files({folder / name: content for name, content in contents.items()})
    for path in sorted(folder.rglob("*"), reverse=True):
        name = path.relative_to(folder).as_posix()
        if path.is_dir() and not path.is_symlink():
            with contextlib.suppress(OSError):  # not empty
                if not keep(f"{name}/"):
                    path.rmdir()
        elif name not in contents and not keep(name):
            path.unlink()
