"""Graphs built once and kept: for each structure one record, and only the records used last.

Graphs take a machine's parameters as symbols. An object of two machines that differ in parameters alone has one
`symbolic` twin, whose parameters are NaN: graphs are built of the twin, and both objects share them. A record holds all
that was built for one structure; its memory is freed as a whole.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import fields
from functools import cached_property, lru_cache, wraps
from typing import Any, ParamSpec, Self, TypeVar, cast, overload

from flexopt.foundation.turns import TURN

P = ParamSpec("P")
T = TypeVar("T")

# Structures, and machines with their numbers, that have a record.
RECORDS = 8
# Results of one function in the record of a structure: graphs; of a machine: mostly numbers.
GRAPHS, NUMBERS = 32, 256

Record = dict[Any, Any]
_of_structures: OrderedDict[Hashable, Record] = OrderedDict()
_of_machines: OrderedDict[Hashable, Record] = OrderedDict()


class Structural:
    """A frozen dataclass with graphs; its first field is, or leads to, the machine or the structure of the record."""

    @property
    def has_own_numbers(self) -> bool:
        """Whether its graphs contain the numbers of its machine, so that no other object shares them."""
        return False

    @property
    def described(self) -> Hashable:
        """The machine, or the structure, that it is about."""
        first = getattr(self, fields(cast(Any, self))[0].name)
        return first.described if isinstance(first, Structural) else first

    @property
    def symbolic(self) -> Self:
        """The same object without values of parameters; equal objects have one twin, itself among them."""
        known = vars(self)
        if "_twin" not in known:
            known["_twin"] = twin = self._build_twin()
            # None instead of a reference to itself, which would outlive the record until cycles are collected.
            vars(twin)["_twin"] = None
        return self if known["_twin"] is None else known["_twin"]

    def _build_twin(self) -> Self:
        given = (getattr(self, field.name) for field in fields(cast(Any, self)))
        twin = self if self.has_own_numbers else type(self)(*map(without_values, given))
        records = _of_machines if self.has_own_numbers else _of_structures
        return _record(records, twin.described).setdefault(twin, twin)


def without_values(argument: Any) -> Any:
    """The argument, or its symbolic twin."""
    return argument.symbolic if isinstance(argument, Structural) else argument


class structural_property(cached_property[T]):  # noqa: N801  (used as a decorator)
    """A `cached_property` that all objects with the same symbolic twin share; its value has no numbers of a machine."""

    @overload
    def __get__(self, instance: None, owner: type[Any] | None = None) -> Self: ...
    @overload
    def __get__(self, instance: object, owner: type[Any] | None = None) -> T: ...
    def __get__(self, instance: Any, owner: type[Any] | None = None) -> Any:
        if instance is None:
            return self
        found = cast(Any, super()).__get__(instance.symbolic, owner)
        assert not isinstance(found, Structural), "it would have no numbers"
        vars(instance)[cast(str, self.attrname)] = found
        return found


def by_structure(function: Callable[P, T]) -> Callable[P, T]:
    """Call the function with symbolic twins of its arguments, once for each structure.

    The first argument is `Structural`; the others are hashable.
    """
    return _kept(function, _of_structures, GRAPHS, without_values)


def by_machine(function: Callable[P, T]) -> Callable[P, T]:
    """Call the function once for the same arguments; the first one is `Structural`, here with its numbers."""
    return _kept(function, _of_machines, NUMBERS, lambda argument: argument)


def _kept(
    function: Callable[P, T], records: OrderedDict[Hashable, Record], most: int, key: Callable[[Any], Any]
) -> Callable[P, T]:
    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        record = _record(records, key(args[0]).described)
        if function not in record:
            record.setdefault(function, lru_cache(most)(function))
        return record[function](*map(key, args), **{name: key(value) for name, value in kwargs.items()})

    return call


def _record(records: OrderedDict[Hashable, Record], key: Hashable) -> Record:
    """The record under a key; the one unused for longest goes."""
    with TURN:
        found = records.setdefault(key, {})
        records.move_to_end(key)
        while len(records) > RECORDS:
            records.popitem(last=False)
        return found


def forget_all() -> None:
    """Free all records."""
    _of_structures.clear()
    _of_machines.clear()
