"""A library of lanes: found in the cache, or compiled and kept there, and loaded.

In: the CasADi Functions that it depends on, and who writes its C++ source. Out: the library, or None.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from pathlib import Path

import casadi as ca

from flexopt.compiled.accelerated import function_key
from flexopt.compiled.compilers import CompilationFailed, Compiler, find_compiler, library_suffix, tell_failure
from flexopt.compiled.lanes import level
from flexopt.compiled.storage import digest, find, recall, remember, store


def load(functions: Sequence[ca.Function], purpose: str, source: Callable[[], str]) -> ctypes.CDLL | None:
    """The library that `source` describes, which is called only if the cache does not hold it.

    Args:
        functions: what the library depends on; messages name the first.
        purpose: tells libraries of the same Functions apart.
        source: writes the translation unit; may raise `RuntimeError` where CasADi cannot generate a graph.
    """
    compiler = find_compiler()
    if compiler is None:
        return None
    try:
        key = digest(*(function_key(function, compiler, purpose) for function in functions))
    except RuntimeError:  # a Callback cannot be serialised
        return None
    found = find(key, library_suffix())
    if found is None and recall(key) is None:
        found = _built(functions[0].name(), source, compiler, key)
    if found is None:
        return None
    try:
        return ctypes.CDLL(str(found))
    except OSError as error:
        tell_failure(f"{found} could not be loaded ({error})")
        return None


def _built(name: str, source: Callable[[], str], compiler: Compiler, key: str) -> Path | None:
    try:
        text = source()
    except RuntimeError:  # CasADi cannot generate it
        return None
    chosen = level(text)
    if chosen is None:
        return None
    try:
        return store(key, library_suffix(), lambda path: compiler.build(text, path, language="c++", level=chosen))
    except CompilationFailed as failure:
        if failure.by_source:
            remember(key, "the graph decides its course by numbers, or CasADi does not generate it")
        else:
            tell_failure(f"{name} could not be compiled ({failure})")
    return None
