"""From a name, a path or a dictionary to a validated machine or problem."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any, cast

from flexopt.errors import ModelError
from flexopt.model.faults import Table, machine_faults, problem_faults, validated
from flexopt.model.files import KINDS, Source, read_source
from flexopt.model.machine import Machine
from flexopt.model.problem import Problem


def load(name_or_path: str | os.PathLike[str]) -> Machine:
    """Read and validate a machine.

    Args:
        name_or_path: a name (`"excavator"` finds the shipped `models/excavator.toml`) or the path of a TOML file.

    Raises:
        ModelError: the file is missing, is no TOML, or has faults; the message lists every one.
    """
    source = read_source(name_or_path, ("models",))
    return machine_from_dict(source.data, origin=source.name)


def load_problem(name_or_path: str | os.PathLike[str]) -> Problem:
    """Read and validate a configuration problem; its machine is loaded with it.

    Args:
        name_or_path: a name (`"article"` finds the shipped `problems/article.toml`) or the path of a TOML file.
            A relative path in its `machine` key starts from the problem file's folder.

    Raises:
        ModelError: as for `load`, for the problem and for its machine.
    """
    return _problem(read_source(name_or_path, ("problems",)))


def load_any(name_or_path: str | os.PathLike[str]) -> Machine | Problem:
    """A machine or a problem, whichever the name or file is.

    Raises:
        ModelError: as for `load` and `load_problem`.
    """
    source = read_source(name_or_path, KINDS)
    return _problem(source) if source.kind == "problems" else machine_from_dict(source.data, origin=source.name)


def machine_from_dict(data: Table, *, origin: str = "machine") -> Machine:
    """Validate a dictionary in the layout of a machine file.

    Args:
        data: the tables and keys of a machine file.
        origin: what the message calls the source.

    Raises:
        ModelError: lists every fault.
    """
    if not isinstance(data, Mapping):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise ModelError(f"{origin}: must be a dictionary in the layout of a machine file, not {type(data).__name__}")
    named = _with_link_names(data)
    return validated(Machine, named, origin, machine_faults(named))


def _problem(source: Source) -> Problem:
    problem = validated(Problem, source.data, source.name, problem_faults(source.data))
    beside = source.folder / problem.machine
    is_file = problem.machine.endswith(".toml") and beside.exists()
    return problem.with_machine(load(beside if is_file else problem.machine))


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
