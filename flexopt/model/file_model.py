"""Tables of files as validated data: what they are built on, how they are read, and every fault as a sentence."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeVar, cast

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from flexopt.errors import Fault, InputError, ModelError, raise_if_any
from flexopt.foundation.nearest import hint_or_list, nearest
from flexopt.foundation.offered import PLUMBING
from flexopt.foundation.plain import Unreadable, plain_table, shown
from flexopt.foundation.quantities import Schema, entries

# Far beyond any machine; what is larger is refused at once, before its parts are looked at.
DEPTH_MAX = 30
ENTRIES_MAX = 1000
BODIES_MAX = 250
# Keys of a table that a message names.
KEYS_TOLD = 8

FileTable = Mapping[str, Any]
PYDANTIC = frozenset(name for name in dir(BaseModel) if not name.startswith("_"))


class _Named(type(BaseModel)):
    """Classes of tables complete like their objects: their keys, and what users call."""

    def __dir__(cls) -> list[str]:
        return _offered(cast(type[BaseModel], cls), super().__dir__())


def _offered(kind: type[BaseModel], names: Iterable[str]) -> list[str]:
    """Without what comes from Pydantic, and what flexopt's own classes ask of each other."""
    ours = [base for base in kind.__mro__ if not issubclass(BaseModel, base)]
    own = {name for base in ours for name in vars(base) if not name.startswith("model_")}
    listed = {*names, *kind.model_fields}
    return sorted(name for name in listed - PLUMBING if name in own or name not in PYDANTIC)


class FileModel(BaseModel, metaclass=_Named):
    """Common to every table of a file: closed (no unknown key), frozen, strict."""

    # Built when first used: a process that reads a machine needs no schema of problems.
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, defer_build=True)

    def __dir__(self) -> list[str]:
        """What completes in a notebook: the table's own."""
        return _offered(type(self), super().__dir__())

    def __repr_args__(self) -> Iterable[tuple[str | None, Any]]:
        """What is not at its default."""
        fields = type(self).model_fields
        for name, value in super().__repr_args__():
            if name not in fields or value != fields[name].get_default(call_default_factory=True):
                yield name, value


class Described(FileModel):
    """What every file says of itself.

    Attributes:
        schema: version of the layout, 1.
        name: what results, pictures and messages call it.
        description: what it is, for people.
        source: where its numbers come from.
    """

    schema_version: Schema = Field(default=1, alias="schema")
    name: str = Field(min_length=1)
    description: str = ""
    source: str = ""


class BuiltByCall(FileModel):
    """A table that users also build by a call, whose faults come in flexopt's own words."""

    def __init__(self, **data: Any) -> None:
        table = plain_table(data)
        try:
            super().__init__(**table)
        except ValidationError as error:
            raise_if_any(InputError, type(self).__name__, faults_as_meant(type(self), table, error)[0])
            raise
        raise_if_any(InputError, type(self).__name__, self.structural_faults())

    # Pydantic then validates nested tables without it: their faults are the outer table's.
    __init__.__pydantic_base_init__ = True  # pyright: ignore[reportFunctionMemberAccess]

    def structural_faults(self) -> list[Fault]:
        """What does not fit together."""
        return []


Model = TypeVar("Model", bound=FileModel)


def read_table(data: Any, origin: str, layout: str, kind: type[InputError] = ModelError) -> dict[str, Any]:
    """What a caller passes as a table: plain data whose lists are tuples, or an error of that kind."""
    table = plain_table(data)
    if not isinstance(table, dict):
        what = f"which {table.sentence}" if isinstance(table, Unreadable) else f"not {type(data).__name__}"
        raise kind(f"{origin}: must be a dictionary in the layout of {layout}, {what}")
    check_extent(cast(FileTable, table), origin, kind)
    return cast(dict[str, Any], table)


def validated(
    model: type[Model],
    data: dict[str, Any],
    origin: str,
    structural: Callable[[dict[str, Any]], Iterable[Fault]] = lambda _: (),
    kind: type[InputError] = ModelError,
    completed: Callable[[dict[str, Any]], dict[str, Any]] = lambda data: data,
) -> Model:
    """The model of `data`, or an error of that kind with the faults of single keys and the `structural` ones.

    `completed` puts to a table what users may leave out.
    """
    meant, result, faults = completed(data), None, list[Fault]()
    try:
        result = model.model_validate(meant)
    except ValidationError as error:
        faults, meant = faults_as_meant(model, meant, error, completed)
    seen = {fault.field for fault in faults}
    faults += [fault for fault in structural(meant) if fault.field not in seen]
    raise_if_any(kind, origin, faults)
    assert result is not None
    return result


def faults_as_meant(
    model: type[FileModel],
    data: dict[str, Any],
    error: ValidationError,
    completed: Callable[[dict[str, Any]], dict[str, Any]] = lambda data: data,
) -> tuple[list[Fault], dict[str, Any]]:
    """The faults of single keys, and the table with unknown ones taken for those that were probably meant.

    What would be missing, or wrong, for want of these alone is no fault of its own.
    """
    unknown, meant = list[Fault](), data
    for entry in error.errors():
        if entry["type"] == "extra_forbidden":
            near = nearest(str(entry["loc"][-1]), _valid_keys(model, entry["loc"][:-1]))
            renamed = None if near is None else _renamed(meant, entry["loc"], near)
            if renamed is not None:
                meant = renamed
                unknown.append(_fault(model, data, cast(dict[str, Any], entry)))
    if not unknown:
        return model_faults(model, data, error), data
    meant = completed(meant)
    try:
        model.model_validate(meant)
    except ValidationError as further:
        faults, meant = faults_as_meant(model, meant, further, completed)
        return unknown + faults, meant
    return unknown, meant


def _renamed(data: Any, location: Sequence[str | int], key: str) -> Any:
    """The table with another key for that at `location`; None where it has both, and they are no parts of one table."""
    here, *rest = location
    if rest:
        inner = data[here] if isinstance(here, int) else table_of(data).get(here)
        changed = None if inner is None else _renamed(inner, rest, key)
        if changed is None:
            return None
        if isinstance(here, int):
            return (*data[:here], changed, *data[here + 1 :])
        return data | {here: changed}
    table = table_of(data)
    if here not in table:
        return None
    value: Any = table[here]
    if key in table:
        one, other = table_of(value), table_of(table[key])
        if not one or not other or one.keys() & other.keys():
            return None
        value = other | one
    return {word: part for word, part in table.items() if word != here} | {key: value}


def check_extent(data: FileTable, origin: str, kind: type[InputError] = ModelError) -> None:
    """Refuse tables that are nested too deep or have too many keys, and lists of too many tables."""
    faults: list[Fault] = []
    seen: dict[int, int] = {}
    waiting: list[tuple[str, Any, int]] = [("", data, 0)]
    while waiting:
        path, value, depth = waiting.pop()
        identity = id(cast(object, value))
        if not isinstance(value, Mapping | list | tuple) or seen.get(identity, -1) >= depth:
            continue
        seen[identity] = depth
        if depth > DEPTH_MAX:
            faults.append(Fault(path.split(".")[0], f"tables or lists are nested more than {DEPTH_MAX} deep"))
            break
        if isinstance(value, Mapping):
            table = cast(FileTable, value)
            if len(table) > ENTRIES_MAX:
                faults.append(Fault(path or "file", f"has {len(table)} keys; at most {ENTRIES_MAX} are read"))
                continue
            waiting += [(f"{path}.{key}" if path else str(key), part, depth + 1) for key, part in table.items()]
            continue
        parts = entries(value)
        tables = sum(1 for part in parts if isinstance(part, Mapping))
        most = BODIES_MAX if path in ("links", "bodies") else ENTRIES_MAX
        if tables > most:
            faults.append(Fault(path, f"has {tables} tables; at most {most} are read"))
            continue
        waiting += [(path, part, depth + 1) for part in parts if isinstance(part, Mapping | list | tuple)]
    raise_if_any(kind, origin, faults)


def model_faults(model: type[FileModel], data: FileTable, error: ValidationError) -> list[Fault]:
    """What pydantic found wrong, as sentences; faults of parts that were built by a call of their own keep theirs."""
    faults: list[Fault] = []
    for entry in error.errors():
        inner = entry.get("ctx", {}).get("error")
        if isinstance(inner, InputError) and inner.faults:
            path = _field_path(data, entry["loc"])
            faults += [Fault(f"{path}.{fault.field}", fault.sentence, fault.value) for fault in inner.faults]
        elif not (entry["type"] == "too_short" and entry["input"]):  # its entries are faulty, and named
            faults.append(_fault(model, data, cast(dict[str, Any], entry)))
    return faults


def _fault(model: type[FileModel], data: FileTable, entry: dict[str, Any]) -> Fault:
    location: tuple[str | int, ...] = entry["loc"]
    field = _field_path(data, location)
    kind, value = str(entry["type"]), entry["input"]
    key = str(location[-1]) if location else ""
    if kind == "extra_forbidden":
        return Fault(field, "unknown key" + hint_or_list(key, _valid_keys(model, location[:-1])))
    if kind == "missing":
        return Fault(field, "is required and missing")
    shown = quoted(value)
    if kind == "quantity":
        return Fault(field, str(entry["msg"]), shown)
    if kind == "literal_error":
        valid = str(cast(dict[str, Any], entry["ctx"])["expected"]).replace("'", "")
        return Fault(field, f"must be {valid}", shown)
    if kind == "too_short":
        return Fault(field, "must not be empty" if key != "links" else "at least one link is needed", shown)
    if kind == "string_too_short":
        return Fault(field, "must not be empty", shown)
    wanted = {
        "string_type": "must be text",
        "string_unicode": "must be text; it holds half of a character",
        "bool_type": "must be true or false",
        "tuple_type": "must be a list",
        "dict_type": "must be a table",
        "model_type": "must be a table",
        "model_attributes_type": "must be a table",
        "int_type": "must be a whole number",
    }
    keys = _valid_keys(model, location) if kind.startswith("model_") and location else []
    told = f"; its keys: {', '.join(keys)}" if 0 < len(keys) <= KEYS_TOLD else ""
    return Fault(field, wanted.get(kind, str(entry["msg"])) + told, shown)


def _field_path(data: FileTable, location: tuple[str | int, ...]) -> str:
    """`links[1].mass` with the link's name beside it, for a path of keys and indices."""
    path, here = "", cast(Any, data)
    for part in location:
        if isinstance(part, int):
            here = dict(enumerate(entries(here))).get(part)
            path = named(path, part, table_of(here))
        else:
            path += f".{part}" if path else part
            here = table_of(here).get(part)
    return path or "file"


def _valid_keys(model: type[FileModel], location: tuple[str | int, ...]) -> list[str]:
    """Keys that the table at `location` may have."""
    here: Any = model
    for part in location:
        if isinstance(part, str):
            annotation = next((f.annotation for n, f in here.model_fields.items() if part in (n, f.alias)), None)
            candidates = [annotation, *getattr(annotation, "__args__", ())]
            here = next((c for c in candidates if isinstance(c, type) and issubclass(c, FileModel)), None)
            if here is None:
                return []
    return [field.alias or name for name, field in here.model_fields.items()]


def quoted(value: Any) -> str:
    """A value as TOML would write it, cut where it is long."""
    if isinstance(value, bool):
        return str(value).lower()
    return value.isoformat() if isinstance(value, datetime.date | datetime.time) else shown(_lists(value))


def _lists(value: Any) -> Any:
    """Tuples as the lists that were written."""
    return [_lists(part) for part in entries(value)] if isinstance(value, tuple) else value


def named(key: str, index: int, entry: FileTable) -> str:
    """An entry of a list of tables as messages call it: `links[1] (stick)`."""
    name = entry.get("name")
    return f"{key}[{index}]" + (f" ({name})" if isinstance(name, str) and name else "")


def table_of(value: Any) -> dict[str, Any]:
    """A table as it stands in a file; an empty one for whatever is none."""
    return cast(dict[str, Any], value) if isinstance(value, dict) else {}


def tables_of(value: Any) -> list[dict[str, Any]]:
    """A list of tables, empty ones in place of entries that are none."""
    return [table_of(entry) for entry in entries(value)]
