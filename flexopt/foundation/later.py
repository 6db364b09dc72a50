"""Names of a room that are imported when they are first asked for: what a process does not use it does not load."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module


def later(room: str, **modules: str) -> Callable[[str], object]:
    """The `__getattr__` of a room: of each of its modules the names that it has, separated by white space."""
    where = {name: module for module, names in modules.items() for name in names.split()}

    def find(name: str) -> object:
        if name not in where:
            raise AttributeError(f"module {room!r} has no attribute {name!r}")
        found = getattr(import_module(f"{room}.{where[name]}"), name)
        setattr(sys.modules[room], name, found)
        return found

    return find
