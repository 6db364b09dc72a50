"""Finding and reading the TOML file behind a name or a path."""

from __future__ import annotations

import os
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from flexopt.errors import ModelError
from flexopt.foundation.nearest import hint
from flexopt.foundation.reading import read_bounded
from flexopt.model.file_model import DEPTH_MAX, check_extent

PACKAGE = Path(__file__).resolve().parents[1]
# Fifty times the largest file that a machine of the most bodies needs.
FILE_SIZE_MAX = 500_000
LONG_KEY = re.compile(rf"(?<![^\s.=\[\]{{}},#])(?:[^\s.=\[\]{{}},#]++[ \t]*+\.[ \t]*+){{{DEPTH_MAX}}}")
# Longer words are no file names to any system.
NAME_MAX = 200
# Robot files: a machine file names them.
ROBOT_SUFFIXES = (".urdf", ".xml", ".mjcf", ".xacro", ".sdf")

ShippedKind = Literal["models", "problems"]
WORDS: dict[ShippedKind, str] = {"models": "machine", "problems": "problem"}
KINDS: tuple[ShippedKind, ShippedKind] = ("models", "problems")
# A file with any of these keys is meant as a problem.
PROBLEM_KEYS = frozenset({"machine", "target", "selection", "simulation", "nullspace", "compute"})


@dataclass(frozen=True)
class Source:
    """A file as it was read.

    Attributes:
        data: its keys and tables.
        kind: what it is meant as: the shipped folder it came from, else told from its keys.
        folder: where relative paths in it start.
        name: what messages call it.
    """

    data: dict[str, Any]
    kind: ShippedKind
    folder: Path
    name: str


def shipped_folder(kind: ShippedKind) -> Path:
    """The folder `models` or `problems`: inside an installed package, else beside it in a source tree."""
    inside = PACKAGE / kind
    return inside if inside.is_dir() else PACKAGE.parent / kind


def shipped_names(kind: ShippedKind) -> list[str]:
    """Names that `load` or `load_problem` finds without a path."""
    return sorted(path.stem for path in shipped_folder(kind).glob("*.toml"))


def read_source(name_or_path: str | os.PathLike[str], kinds: tuple[ShippedKind, ...]) -> Source:
    """The file behind a shipped name or a path, of one of the `kinds`.

    Raises:
        ModelError: nothing is there, it cannot be read, is no TOML, is of another kind, or far too large or deep.
    """
    text = os.fsdecode(name_or_path)
    try:
        # A file of the working directory does not take the place of what is shipped.
        found: list[ShippedKind] = [kind for kind in (*kinds, *KINDS) if text in shipped_names(kind)]
        looks = text.endswith((".toml", *ROBOT_SUFFIXES)) or os.sep in text or "/" in text
        if looks or (not found and len(text) <= NAME_MAX and Path(text).is_file()):
            path, named_kind = Path(text), None
            if not path.exists():
                raise ModelError(f"{text}: no such file")
            if path.suffix.lower() in ROBOT_SUFFIXES:
                raise _robot_file(path)
        else:
            named_kind = found[0] if found else None
            if named_kind is None:
                raise _unknown_name(text, kinds)
            path = shipped_folder(named_kind) / f"{text}.toml"
        data = read_toml(path)
    except OSError as error:
        raise ModelError(f"{_cut(text)}: cannot be read ({error.strerror})") from None
    told: ShippedKind = "problems" if PROBLEM_KEYS & data.keys() else "models"
    told = named_kind or told
    if told not in kinds and data:
        raise _wrong_kind(text, data, told)
    shipped = PACKAGE.parent in path.resolve().parents
    name = (
        f"{path.resolve().parent.name}/{path.name}" if named_kind or (shipped and not path.is_absolute()) else str(path)
    )
    check_extent(data, name)
    return Source(data, told, path.parent, name)


def _robot_file(path: Path) -> ModelError:
    return ModelError(
        f"{_cut(str(path))}: is a robot file; give a machine file, which `flexopt new --from` writes: a TOML file "
        f"with name, robot = {path.name!r}, "
        'actuated = ["…"] (its driven joints), [base] stiffness = { z = …, roll = …, pitch = … } (what gives) and '
        '[end_point] link = "…"'
    )


def _unknown_name(text: str, kinds: tuple[ShippedKind, ...]) -> ModelError:
    shipped = "; ".join(f"{kind}: {', '.join(shipped_names(kind))}" for kind in kinds)
    names = [name for kind in kinds for name in shipped_names(kind)]
    meant = hint(text, names, ";")
    wanted = " or ".join(WORDS[kind] for kind in kinds)
    return ModelError(f"no {wanted} is called {_cut(text)!r}{meant} give a path, or one of the shipped {shipped}")


def _wrong_kind(text: str, data: dict[str, Any], told: ShippedKind) -> ModelError:
    if told == "models":
        return ModelError(f"{text!r} is a machine, not a problem")
    if "compute" in data:
        what = "a study, not a machine; `flexopt study run` and load_study take studies"
    elif "simulation" in data:
        what = "an experiment, not a machine; `flexopt simulate` and load_experiment take experiments"
    else:
        what = "a problem, not a machine; `flexopt select` and load_problem take problems"
    return ModelError(f"{text!r} is {what}")


def _cut(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."


def read_toml(path: Path) -> dict[str, Any]:
    """The keys and tables of a TOML file.

    Raises:
        ModelError: it cannot be read, is too large to be a machine or problem file, or is no TOML.
    """
    try:
        text = read_bounded(path, FILE_SIZE_MAX).decode("utf-8")
        # The parser's time and memory grow with the square of the length of such a key.
        if LONG_KEY.search(text):
            raise ModelError(f"{path}: has a key of more than {DEPTH_MAX} words joined by dots")
        return tomllib.loads(text)
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise ModelError(f"{path}: is not valid TOML: it is not UTF-8 text") from None
    except (ValueError, RecursionError) as error:
        if isinstance(error, ModelError):
            raise
        raise ModelError(f"{path}: is not valid TOML: {error}") from None
