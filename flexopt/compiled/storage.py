"""Compiled libraries on disk, shared by processes.

In: keys (digests of all that a library depends on) and freshly built files. Out: paths of complete libraries. The name
of a library ends with the digest of its content, which is checked before it is loaded: a damaged file is as good as
none. Files appear by renaming, so nobody sees half of one; the folder may be deleted at any time.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import os
import platform
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

_STALE_SECONDS = 86400.0


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
    """The library stored under `key`, if it is whole."""
    for folder in _folders():
        with contextlib.suppress(OSError):
            for path in (folder / key[:2]).glob(f"{key}-*{suffix}"):
                if path.name == _name(key, path, suffix):
                    return path
                path.unlink(missing_ok=True)
    return None


def store(key: str, suffix: str, build: Callable[[Path], None]) -> Path:
    """Let `build` write a library and keep it under `key`; what `build` raises passes through."""
    with tempfile.TemporaryDirectory(prefix="flexopt-", ignore_cleanup_errors=True) as folder:
        fresh = Path(folder) / f"library{suffix}"
        build(fresh)
        name, data = _name(key, fresh, suffix), fresh.read_bytes()
    return _write(Path(key[:2]) / name, data)


def remember(key: str, text: str) -> None:
    """Keep a short text under `key`."""
    _write(Path(f"{key}.txt"), f"{digest(text)} {text}".encode())


def recall(key: str) -> str | None:
    """The text kept under `key`, if it is whole."""
    for folder in _folders():
        with contextlib.suppress(OSError, ValueError):
            check, _, text = (folder / f"{key}.txt").read_text(encoding="utf-8").partition(" ")
            if check == digest(text):
                return text
    return None


def _name(key: str, path: Path, suffix: str) -> str:
    return f"{key}-{digest(path.read_bytes())}{suffix}"


def _folders() -> Iterator[Path]:
    yield cache_folder()
    if _temporary.cache_info().currsize:
        yield _temporary()


@cache
def _temporary() -> Path:
    """A folder of this process alone, for a cache that cannot be written."""
    folder = Path(tempfile.mkdtemp(prefix="flexopt-cache-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _write(relative: Path, data: bytes) -> Path:
    try:
        return _write_in(cache_folder(), relative, data)
    except OSError:
        return _write_in(_temporary(), relative, data)


def _write_in(root: Path, relative: Path, data: bytes) -> Path:
    """Write a file under another name and rename it; one written by somebody else meanwhile is as good."""
    final = root / relative
    root.mkdir(parents=True, exist_ok=True, mode=0o700)
    final.parent.mkdir(exist_ok=True)
    _sweep(final.parent)
    handle, name = tempfile.mkstemp(prefix=".new-", dir=final.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        Path(name).replace(final)
    except OSError:
        Path(name).unlink(missing_ok=True)
        # Windows does not replace a library that is loaded.
        if not (final.exists() and final.read_bytes() == data):
            raise
    return final


def _sweep(folder: Path) -> None:
    """Remove what processes that were killed left behind."""
    with contextlib.suppress(OSError):
        for path in folder.glob(".new-*"):
            if time.time() - path.stat().st_mtime > _STALE_SECONDS:
                path.unlink(missing_ok=True)
