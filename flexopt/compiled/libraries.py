"""Libraries: found in the cache, or compiled and kept there, and loaded.

In: the CasADi Functions that a library depends on, and who writes its source. Out: the library, or None.
"""

from __future__ import annotations

import contextlib
import ctypes
from collections.abc import Callable, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Literal, TypeVar

import casadi as ca

from flexopt.compiled.compilers import (
    CompilationFailed,
    Compiler,
    find_compiler,
    in_background,
    library_suffix,
    tell_failure,
)
from flexopt.compiled.lanes import level
from flexopt.compiled.storage import alone, digest, find, in_use, store

T = TypeVar("T")
Level = Callable[[str], tuple[str, ...] | None]
# Functions of libraries, one each.
ENTRIES = ("flexopt_kernel", "flexopt_recurrence")
# Keys of graphs that the compiler refused in this process.
_hopeless = set[str]()


def load(
    functions: Sequence[ca.Function], purpose: str, source: Callable[[], str], chosen: Level = level
) -> ctypes.CDLL | None:
    """The library of lanes that `source` describes, which is called only if the cache does not hold it.

    Args:
        functions: what the library depends on; messages name the first.
        purpose: tells libraries of the same Functions apart.
        source: writes the translation unit; may raise `RuntimeError` where CasADi cannot generate a graph.
        chosen: how hard to optimise it; another choice wants another purpose.
    """
    return opened(functions, purpose, source, chosen, "c++", _library)


def begin(
    functions: Sequence[ca.Function], purpose: str, source: Callable[[], str]
) -> Callable[[], ctypes.CDLL | None]:
    """What `load` does, with the compiler at work in the background: call the result to wait for it.

    `source` is called here and now, as graphs are not for several threads.
    """
    compiler = find_compiler()
    key = None if compiler is None else key_of(functions, compiler, purpose)
    if compiler is None or key is None or _is_known(key):
        return lambda: load(functions, purpose, source)
    name, done = functions[0].name(), list[Path | None]()
    try:
        text = source()
    except RuntimeError:  # CasADi cannot generate it
        return lambda: None
    thread = in_background(lambda: done.append(_fetched(name, lambda: text, level, "c++", compiler, key)))

    def wait() -> ctypes.CDLL | None:
        thread.join()
        # A process that was forked meanwhile has no such thread, and nothing done.
        return None if done == [None] else load(functions, purpose, lambda: text)

    return wait


def opened(
    functions: Sequence[ca.Function],
    purpose: str,
    source: Callable[[], str],
    chosen: Level,
    language: Literal["c", "c++"],
    opener: Callable[[Path], T],
) -> T | None:
    """What `opener` makes of the library; see `load`. `chosen` says how hard to optimise a source, or None: not."""
    compiler = find_compiler()
    key = None if compiler is None else key_of(functions, compiler, purpose)
    if compiler is None or key is None:
        return None
    reason = ""
    # It may be deleted between being found and being loaded; what cannot be loaded is built once more.
    for _ in range(2):
        path = _fetched(functions[0].name(), source, chosen, language, compiler, key)
        if path is None:
            return None
        with in_use():
            try:
                return opener(path)
            except (OSError, RuntimeError) as error:
                reason = f"{path} could not be loaded ({error})"
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)
    tell_failure(reason)
    return None


def _library(path: Path) -> ctypes.CDLL:
    library = ctypes.CDLL(str(path))
    if not any(hasattr(library, name) for name in ENTRIES):
        raise OSError("it has no function of a kernel")
    return library


def is_kept(functions: Sequence[ca.Function], purpose: str) -> bool:
    """Whether the cache says what becomes of a library: it holds it, or that it cannot be had."""
    compiler = find_compiler()
    key = None if compiler is None else key_of(functions, compiler, purpose)
    return key is None or _is_known(key)


def _is_known(key: str) -> bool:
    return key in _hopeless or find(key, library_suffix()) is not None


def key_of(functions: Sequence[ca.Function], compiler: Compiler, purpose: str) -> str | None:
    """Digest of all that a library depends on: graphs, purpose, compiler, processor, CasADi, and this room.

    None of Functions that cannot be serialised: Callbacks.
    """
    try:
        graphs = [function.serialize() for function in functions]
    except RuntimeError:
        return None
    return digest(*graphs, purpose, compiler.identity, *compiler.target, ca.CasadiMeta.version(), _room())


@cache
def _room() -> str:
    """Digest of this room's own text."""
    here = files("flexopt.compiled")
    names = sorted(entry.name for entry in here.iterdir() if entry.name.endswith((".py", ".hpp")))
    return digest(*(here.joinpath(name).read_bytes() for name in names))


def _fetched(
    name: str, source: Callable[[], str], chosen: Level, language: str, compiler: Compiler, key: str
) -> Path | None:
    """The library in the cache; if it is not there one process compiles it, the others wait."""
    found = find(key, library_suffix())
    if found is not None or key in _hopeless:
        return found
    with alone(key):
        found = find(key, library_suffix())
        if found is not None or key in _hopeless:
            return found
        return _built(name, source, chosen, language, compiler, key)


def _built(
    name: str, source: Callable[[], str], chosen: Level, language: str, compiler: Compiler, key: str
) -> Path | None:
    try:
        text = source()
    except RuntimeError:  # CasADi cannot generate or differentiate it
        return None
    hard = chosen(text)
    if hard is None:
        return None
    try:
        return store(key, library_suffix(), lambda path: compiler.build(text, path, language=language, level=hard))
    except CompilationFailed as failure:
        if failure.by_source:
            # Not on disk: a full one, too, makes compilers complain about a place in the source.
            _hopeless.add(key)
        else:
            tell_failure(f"{name} could not be compiled ({failure})")
    except OSError as error:
        tell_failure(f"{name} could not be compiled (no room for its library: {error.strerror or error})")
    return None
