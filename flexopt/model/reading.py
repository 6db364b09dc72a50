"""From a name, a path or a dictionary to a validated machine or problem, with every fault in one message."""

from __future__ import annotations

import difflib
import os
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar, cast

from pydantic import ValidationError

from flexopt.errors import Fault, ModelError, raise_if_any
from flexopt.model.machine import BASE_DIRECTIONS, FileModel, Machine
from flexopt.model.problem import Problem

PACKAGE = Path(__file__).resolve().parents[1]
SUPPORTED_SCHEMA = 1
RESERVED_LINK_NAMES = ("base", "payload", "gravity")
FILE_SIZE_MAX = 4_000_000

Table = Mapping[str, Any]
Model = TypeVar("Model", bound=FileModel)


def shipped_folder(kind: str) -> Path:
    """The folder `models` or `problems`: inside an installed package, else beside it in a source tree."""
    inside = PACKAGE / kind
    return inside if inside.is_dir() else PACKAGE.parent / kind


def shipped_names(kind: str) -> list[str]:
    """Names that `load` or `load_problem` finds without a path."""
    return sorted(path.stem for path in shipped_folder(kind).glob("*.toml"))


def load(name_or_path: str | os.PathLike[str]) -> Machine:
    """Read and validate a machine.

    Args:
        name_or_path: a name (`"excavator"` finds the shipped `models/excavator.toml`) or the path of a TOML file.

    Raises:
        ModelError: the file is missing, is no TOML, or has faults; the message lists every one.
    """
    path = find_file(name_or_path, "models")
    return machine_from_dict(_read_toml(path), origin=_display(path))


def load_problem(name_or_path: str | os.PathLike[str]) -> Problem:
    """Read and validate a configuration problem; its machine is loaded with it.

    Args:
        name_or_path: a name (`"article"` finds the shipped `problems/article.toml`) or the path of a TOML file.
            A relative path in its `machine` key starts from the problem file's folder.

    Raises:
        ModelError: as for `load`, for the problem and for its machine.
    """
    path = find_file(name_or_path, "problems")
    origin = _display(path)
    data = _read_toml(path)
    problem = _validated(Problem, data, origin, _problem_faults(data))
    reference = problem.machine
    beside = path.parent / reference
    return problem.with_machine(load(beside if beside.suffix == ".toml" and beside.exists() else reference))


def machine_from_dict(data: Table, *, origin: str = "machine") -> Machine:
    """Validate a dictionary in the layout of a machine file.

    Args:
        data: the tables and keys of a machine file.
        origin: what the message calls the source.

    Raises:
        ModelError: lists every fault.
    """
    named = _with_link_names(data)
    return _validated(Machine, named, origin, _machine_faults(named))


def looks_like_problem(name_or_path: str) -> bool:
    """Whether the name or path holds a problem (it names a machine) rather than a machine."""
    if _is_path(name_or_path):
        path = find_file(name_or_path, "models")
        return "machine" in _read_toml(path)
    return name_or_path not in shipped_names("models") and name_or_path in shipped_names("problems")


def find_file(name_or_path: str | os.PathLike[str], kind: str) -> Path:
    """The file behind a name or a path, or `ModelError` with the nearest names."""
    text = os.fspath(name_or_path)
    if not text or "\0" in text:
        raise ModelError(f"an empty or unusable name was given where a machine or problem is wanted: {text!r}")
    if _is_path(text):
        path = Path(text)
        if path.is_dir():
            raise ModelError(f"{text}: is a folder; give the TOML file itself")
        if not path.exists():
            raise ModelError(f"{text}: no such file")
        return path
    path = shipped_folder(kind) / f"{text}.toml"
    if not path.is_file():
        names = shipped_names(kind)
        hint = _nearest(text, names)
        raise ModelError(f"no {kind[:-1]} is called {text!r}{hint} (shipped: {', '.join(names)}; or give a path)")
    return path


def _is_path(text: str) -> bool:
    return text.endswith(".toml") or os.sep in text or "/" in text or Path(text).exists()


def _display(path: Path) -> str:
    shipped = PACKAGE in path.parents or PACKAGE.parent in path.parents
    return f"{path.parent.name}/{path.name}" if shipped else str(path)


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > FILE_SIZE_MAX:
            raise ModelError(f"{path}: larger than {FILE_SIZE_MAX // 1_000_000} MB; this is no machine or problem file")
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise ModelError(f"{path}: is not UTF-8 text") from None
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ModelError(f"{path}: is not valid TOML: {error}") from None


def _validated(model: type[Model], data: Table, origin: str, structural: Iterable[Fault]) -> Model:
    faults: list[Fault] = []
    result: Model | None = None
    try:
        result = model.model_validate(data)
    except ValidationError as error:
        faults = [_fault(model, data, cast(dict[str, Any], entry)) for entry in error.errors()]
    seen = {fault.field for fault in faults}
    faults += [fault for fault in structural if fault.field not in seen]
    raise_if_any(ModelError, origin, faults)
    assert result is not None
    return result


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
    if key == "schema":
        return Fault(field, f"unknown schema version; this flexopt reads version {SUPPORTED_SCHEMA}", shown)
    if kind == "too_short":
        return Fault(field, "must not be empty" if key != "links" else "at least one link is needed", shown)
    if kind == "string_too_short":
        return Fault(field, "must not be empty", shown)
    wanted = {
        "string_type": "must be text",
        "bool_type": "must be true or false",
        "tuple_type": "must be a list",
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
    close = difflib.get_close_matches(word, valid, n=1, cutoff=0.5)
    if close:
        return f"; did you mean {close[0]!r}?"
    return f"; valid here: {', '.join(valid)}" if valid else ""


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _with_link_names(data: Table) -> dict[str, Any]:
    """Number the links that have no name, so that parameters and joints can be told apart."""
    links = data.get("links")
    if not isinstance(links, list | tuple):
        return dict(data)
    named = [
        {"name": f"link{i}"} | cast(dict[str, Any], link) if isinstance(link, dict) else link
        for i, link in enumerate(cast(list[Any], links), start=1)
    ]
    return dict(data) | {"links": tuple(named)}


def _table(data: Any, key: str) -> dict[str, Any]:
    value = cast(dict[str, Any], data).get(key) if isinstance(data, dict) else None
    return cast(dict[str, Any], value) if isinstance(value, dict) else {}


def _machine_faults(data: Table) -> list[Fault]:
    """Faults that concern several keys at once; looked for even where single keys are faulty."""
    base = _table(data, "base")
    stiffness, damping = _table(base, "stiffness"), _table(base, "damping")
    faults = [
        Fault(f"base.damping.{direction}", f"needs base.stiffness.{direction}; without it the base is rigid")
        for direction in damping
        if direction in BASE_DIRECTIONS and direction not in stiffness
    ]
    links_value = data.get("links")
    if isinstance(links_value, tuple):
        links = [cast(dict[str, Any], link) for link in cast(tuple[Any, ...], links_value) if isinstance(link, dict)]
        faults += _link_faults(links)
        passive = [link for link in links if link.get("passive") is True]
        if links and len(links) - len(passive) < 2:
            count = len(links) - len(passive)
            faults.append(Fault("links (actuated joints)", "an end-point in the plane needs at least two", str(count)))
        if not passive and not any(direction in stiffness for direction in BASE_DIRECTIONS):
            faults.append(
                Fault("base.stiffness", "no passive coordinate: give x, y or rotation, or make a joint passive")
            )
    return faults


def _link_faults(links: list[dict[str, Any]]) -> list[Fault]:
    faults: list[Fault] = []
    names: list[Any] = []
    for index, link in enumerate(links):
        name = link.get("name")
        where = f"links[{index}] ({name})"
        if name in RESERVED_LINK_NAMES or (isinstance(name, str) and not name.strip()):
            faults.append(Fault(f"{where}.name", "is reserved or blank; choose another", _short(name)))
        if name in names:
            faults.append(Fault(f"{where}.name", "is taken by an earlier link; names must differ", _short(name)))
        names.append(name)
        if link.get("passive") is True:
            if "stiffness" not in link:
                faults.append(Fault(f"{where}.stiffness", "a passive joint needs one, in N m/rad"))
            wrong = [key for key in ("limits", "joint_damping") if key in link]
            reason = "belongs to an actuated joint; a passive one has stiffness, damping and rest"
        else:
            wrong = [key for key in ("stiffness", "damping", "rest") if key in link]
            reason = "belongs to a passive joint; add passive = true"
        faults += [Fault(f"{where}.{key}", reason, _short(link[key])) for key in wrong]
    return faults


def _problem_faults(data: Table) -> list[Fault]:
    selection = _table(data, "selection")
    if selection.get("objective") == "V" and "weights" not in selection:
        return [Fault("selection.weights", "objective V = Σ αi wi needs its weights α")]
    return []
