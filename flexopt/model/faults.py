"""Every fault of a file as sentences: those of single keys, found by pydantic, and those that concern several."""

from __future__ import annotations

import datetime
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar, cast

from pydantic import ValidationError

from flexopt.errors import Fault, InputError, ModelError, raise_if_any
from flexopt.foundation.nearest import hint
from flexopt.foundation.plain import Unreadable, plain_table, shown
from flexopt.model.cylinder_faults import cylinder_faults
from flexopt.model.planar import BASE_DIRECTIONS
from flexopt.model.tables import FileModel

RESERVED_LINK_NAMES = ("base", "payload", "gravity")
# Far beyond any machine; what is larger is refused at once, before its parts are looked at.
DEPTH_MAX = 30
ENTRIES_MAX = 1000
BODIES_MAX = 250

Table = Mapping[str, Any]
Model = TypeVar("Model", bound=FileModel)


def read_table(data: Any, origin: str, layout: str, kind: type[InputError] = ModelError) -> dict[str, Any]:
    """What a caller passes as a table: plain data whose lists are tuples, or an error of that kind."""
    table = plain_table(data)
    if not isinstance(table, dict):
        what = f"which {table.sentence}" if isinstance(table, Unreadable) else f"not {type(data).__name__}"
        raise kind(f"{origin}: must be a dictionary in the layout of {layout}, {what}")
    check_extent(cast(Table, table), origin, kind)
    return cast(dict[str, Any], table)


def validated(
    model: type[Model],
    data: Table,
    origin: str,
    structural: Iterable[Fault],
    kind: type[InputError] = ModelError,
) -> Model:
    """The model of `data`, or an error of that kind with the faults of single keys and the `structural` ones."""
    check_extent(data, origin, kind)
    try:
        result = model.model_validate(data)
    except ValidationError as error:
        result = None
        faults = model_faults(model, data, error)
    else:
        faults = []
    seen = {fault.field for fault in faults}
    faults += [fault for fault in structural if fault.field not in seen]
    raise_if_any(kind, origin, faults)
    assert result is not None
    return result


def check_extent(data: Table, origin: str, kind: type[InputError] = ModelError) -> None:
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
            table = cast(Table, value)
            if len(table) > ENTRIES_MAX:
                faults.append(Fault(path or "file", f"has {len(table)} keys; at most {ENTRIES_MAX} are read"))
                continue
            waiting += [(f"{path}.{key}" if path else str(key), part, depth + 1) for key, part in table.items()]
            continue
        parts = cast(list[Any], value)
        tables = sum(1 for part in parts if isinstance(part, Mapping))
        most = BODIES_MAX if path in ("links", "bodies") else ENTRIES_MAX
        if tables > most:
            faults.append(Fault(path, f"has {tables} tables; at most {most} are read"))
            continue
        waiting += [(path, part, depth + 1) for part in parts if isinstance(part, Mapping | list | tuple)]
    raise_if_any(kind, origin, faults)


def model_faults(model: type[FileModel], data: Table, error: ValidationError) -> list[Fault]:
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


def _fault(model: type[FileModel], data: Table, entry: dict[str, Any]) -> Fault:
    location: tuple[str | int, ...] = entry["loc"]
    field = _field_path(data, location)
    kind, value = str(entry["type"]), entry["input"]
    key = str(location[-1]) if location else ""
    if kind == "extra_forbidden":
        return Fault(field, "unknown key" + _nearest(key, _valid_keys(model, location[:-1])))
    if kind == "missing":
        return Fault(field, "is required and missing")
    shown = _short(value)
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
    return Fault(field, wanted.get(kind, str(entry["msg"])), shown)


def _field_path(data: Table, location: tuple[str | int, ...]) -> str:
    """`links[1].mass` with the link's name beside it, for a path of keys and indices."""
    path, here = "", cast(Any, data)
    for part in location:
        if isinstance(part, int):
            path += f"[{part}]"
            items = cast(list[Any], here) if isinstance(here, list | tuple) else []
            here = items[part] if part < len(items) else None
            name = _table({"here": here}, "here").get("name")
            if isinstance(name, str) and name:
                path += f" ({name})"
        else:
            path += f".{part}" if path else part
            here = _table({"here": here}, "here").get(part)
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


def _nearest(word: str, valid: list[str]) -> str:
    return hint(word, valid, f"; valid here: {', '.join(valid)}" if valid else "")


def _short(value: Any) -> str:
    """A value as TOML would write it, cut where it is long."""
    if isinstance(value, bool):
        text = str(value).lower()
    elif isinstance(value, datetime.date | datetime.time):
        text = value.isoformat()
    else:
        text = shown(_lists(value))
    return text


def _lists(value: Any) -> Any:
    """Tuples as the lists that were written."""
    return [_lists(part) for part in cast(tuple[Any, ...], value)] if isinstance(value, tuple) else value


def _table(data: Any, key: str) -> dict[str, Any]:
    value = cast(dict[str, Any], data).get(key) if isinstance(data, dict) else None
    return cast(dict[str, Any], value) if isinstance(value, dict) else {}


def machine_faults(data: Table) -> list[Fault]:
    """Faults that concern several keys at once; looked for even where single keys are faulty."""
    base = _table(data, "base")
    stiffness, damping = _table(base, "stiffness"), _table(base, "damping")
    faults = [
        Fault(f"base.damping.{direction}", f"needs base.stiffness.{direction}; without it the base is rigid")
        for direction in damping
        if direction in BASE_DIRECTIONS and direction not in stiffness
    ]
    links_value = data.get("links")
    entries = cast(tuple[Any, ...], links_value) if isinstance(links_value, tuple) else ()
    links = [cast(dict[str, Any], link) for link in entries if isinstance(link, dict)]
    if links and len(links) == len(entries):
        faults += _link_faults(links)
        faults += capsule_faults(data, ["base", *(link.get("name") for link in links)], 2)
        passive = [link for link in links if link.get("passive") is True]
        hinges = {str(link.get("name")): "hinge" for link in links if link not in passive}
        faults += cylinder_faults(data, hinges, [link.get("name") for link in passive], 2)
        count = len(links) - len(passive)
        if count < 2:
            sentence = (
                "an end-point in the plane, with two task rows x and y, needs at least two; add a link or make a "
                "passive one actuated, or describe a tree whose end_point.rows are fewer"
            )
            faults.append(Fault("links (actuated joints)", sentence, str(count)))
        gives = any(stiffness.get(direction) is not None for direction in BASE_DIRECTIONS)
        if base and not passive and not gives:
            faults.append(
                Fault("base.stiffness", "no passive coordinate: give x, y or rotation, or make a joint passive")
            )
    return faults


def _link_faults(links: list[dict[str, Any]]) -> list[Fault]:
    faults: list[Fault] = []
    names: list[str] = []
    for index, link in enumerate(links):
        name = link.get("name")
        where = f"links[{index}] ({name})"
        if isinstance(name, str):
            if name in RESERVED_LINK_NAMES or not name.strip():
                faults.append(Fault(f"{where}.name", "is reserved or blank; choose another", _short(name)))
            if name in names:
                faults.append(Fault(f"{where}.name", "is taken by an earlier link; names must differ", _short(name)))
            names.append(name)
        if link.get("passive") is True:
            if "stiffness" not in link:
                faults.append(Fault(f"{where}.stiffness", "a passive joint needs one, in N m/rad"))
            wrong = [key for key in ("limits", "effort", "speed", "joint_damping") if key in link]
            reason = "belongs to an actuated joint; a passive one has stiffness, damping and rest"
        else:
            wrong = [key for key in ("stiffness", "damping", "rest") if key in link]
            reason = "belongs to a passive joint; add passive = true"
        faults += [Fault(f"{where}.{key}", reason, _short(link[key])) for key in wrong]
    return faults


def capsule_faults(data: Table, bodies: list[Any], dimension: int) -> list[Fault]:
    """Capsules of bodies that are not there, and ends with too few or too many coordinates."""
    value = data.get("capsules")
    faults: list[Fault] = []
    for index, entry in enumerate(cast(tuple[Any, ...], value) if isinstance(value, list | tuple) else ()):
        capsule = _table({"entry": entry}, "entry")
        body = capsule.get("body")
        if isinstance(body, str) and body and body not in bodies:
            named = _nearest(body, [name for name in bodies if isinstance(name, str)])
            faults.append(Fault(f"capsules[{index}].body", f"is no body's name{named}", _short(body)))
        for key in ("start", "end"):
            place = capsule.get(key)
            if isinstance(place, list | tuple) and len(cast(list[Any], place)) == 5 - dimension:
                wanted = "two numbers [along, left]" if dimension == 2 else "three numbers [x, y, z]"
                faults.append(Fault(f"capsules[{index}].{key}", f"must be {wanted} in m", _short(place)))
    return faults


def problem_faults(data: Table) -> list[Fault]:
    """As `machine_faults`, for a problem."""
    selection = _table(data, "selection")
    if selection.get("objective") == "V" and "weights" not in selection:
        return [Fault("selection.weights", "objective V = Σ αi wi needs its weights α")]
    return []
