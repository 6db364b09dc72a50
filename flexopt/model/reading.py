"""From a name, a path or a dictionary to a validated machine, problem or experiment."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, cast

from flexopt.errors import Fault, ModelError, raise_if_any
from flexopt.foundation.arrays import TableLike
from flexopt.foundation.boundary import public
from flexopt.foundation.coordinates import check_placement, check_task
from flexopt.foundation.quantities import entries
from flexopt.model.file_model import FileTable, quoted, read_table, table_of, validated
from flexopt.model.files import KINDS, Source, read_source
from flexopt.model.loop import loop_faults
from flexopt.model.planar import Machine
from flexopt.model.planar_faults import machine_faults
from flexopt.model.tree import Tree
from flexopt.model.uncertainty import uncertainty_faults

if TYPE_CHECKING:
    from flexopt.model.problem import Problem
    from flexopt.model.simulation import Experiment

# Keys, springs of a base among them, that files of planar machines do not have.
IN_SPACE = {"root", "actuated", "locked", "lock_others", "ignore", "placement", "joints", "z", "roll", "pitch", "yaw"}


@public(error=ModelError)
def load(name_or_path: str | os.PathLike[str]) -> Machine | Tree:
    """Read and validate a machine: a planar one, or a spatial one where the file names a robot file (key `robot`).

    Args:
        name_or_path: a name (`"excavator"` finds the shipped `models/excavator.toml`) or the path of a TOML file.
            The path of a robot file starts from the machine file's folder; see `flexopt.model.robots.reading`.

    Raises:
        ModelError: a file is missing, cannot be read, or has faults; the message lists every one.

    Example:
        >>> flexopt.load("excavator")
        Machine('excavator': base gives in x, y, rotation; actuated joints: boom, stick)
    """
    return _machine(read_source(name_or_path, ("models",)))


@public(error=ModelError)
def load_problem(name_or_path: str | os.PathLike[str]) -> Problem:
    """Read and validate a configuration problem; its machine is loaded with it.

    Args:
        name_or_path: a name (`"article"` finds the shipped `problems/article.toml`) or the path of a TOML file.
            A relative path in its `machine` key starts from the problem file's folder.

    Raises:
        ModelError: as for `load`, for the problem and for its machine.

    Example:
        >>> flexopt.load_problem("stations").target.kind
        'end_points'
    """
    return _problem(read_source(name_or_path, ("problems",)))


@public(error=ModelError)
def load_experiment(name_or_path: str | os.PathLike[str]) -> Experiment:
    """Read and validate an experiment, a simulation in a file; its machine is loaded with it.

    Args:
        name_or_path: a name (`"article-a"` finds the shipped `problems/article-a.toml`) or the path of a TOML file.
            A relative path in its `machine` key starts from the file's folder.

    Raises:
        ModelError: as for `load`, for the experiment and for its machine.

    Example:
        >>> flexopt.load_experiment("article-move").nullspace.max_base_rate
        0.25
    """
    return _experiment(read_source(name_or_path, ("problems",)))


@public(error=ModelError)
def load_simulated(name_or_path: str | os.PathLike[str]) -> Machine | Tree | Experiment:
    """A machine or an experiment, whichever the name or file is.

    Raises:
        ModelError: as for `load` and `load_experiment`.
    """
    source = read_source(name_or_path, KINDS)
    return _experiment(source) if source.kind == "problems" else _machine(source)


@public(error=ModelError)
def load_any(name_or_path: str | os.PathLike[str]) -> Machine | Tree | Problem:
    """A machine or a problem, whichever the name or file is.

    Raises:
        ModelError: as for `load` and `load_problem`.
    """
    source = read_source(name_or_path, KINDS)
    return _problem(source) if source.kind == "problems" else _machine(source)


def load_file(name_or_path: str | os.PathLike[str]) -> Machine | Tree | Problem | Experiment:
    """A machine, a problem or an experiment, whichever the name or file is.

    Raises:
        ModelError: as for `load`, `load_problem` and `load_experiment`.
    """
    source = read_source(name_or_path, KINDS)
    if source.kind == "models":
        return _machine(source)
    return _experiment(source) if "simulation" in source.data else _problem(source)


@public(error=ModelError)
def machine_from_dict(data: TableLike, *, origin: str = "machine") -> Machine:
    """Validate a dictionary in the layout of a machine file.

    Args:
        data: the tables and keys of a machine file.
        origin: what the message calls the source.

    Raises:
        ModelError: lists every fault.

    Example:
        >>> from flexopt.model.files import shipped_folder
        >>> import tomllib
        >>> data = tomllib.loads((shipped_folder("models") / "excavator.toml").read_text())
        >>> data["payload"] = {"mass": 250.0}
        >>> flexopt.machine_from_dict(data).payload.mass
        250.0
    """
    table = read_table(data, origin, "a machine file")
    if "bodies" in table:
        raise ModelError(f"{origin}: has bodies, as a machine in space: flexopt.tree_from_dict takes it")
    machine = validated(Machine, table, origin, machine_faults, completed=_with_link_names)
    raise_if_any(ModelError, origin, machine.part_faults())
    return machine


def _machine(source: Source) -> Machine | Tree:
    # Of a machine in space that does not name its robot that alone is told.
    if "robot" in source.data or _in_space(source.data):
        from flexopt.model.robots import robot_from_dict  # noqa: PLC0415  (readers that few machines need)

        return robot_from_dict(source.data, folder=source.folder, origin=source.name)
    return machine_from_dict(source.data, origin=source.name)


def _in_space(data: dict[str, Any]) -> bool:
    """Whether a file without `robot` says what only machines in space have."""
    base = _table(data, "base")
    said = {*data, *_table(base, "stiffness"), *_table(base, "damping")}
    named = bool(said & IN_SPACE) or isinstance(data.get("end_point"), dict)
    return named and not said & {"links", "link"}


def _table(data: dict[str, Any], key: str) -> dict[str, Any]:
    found = data.get(key)
    return cast(dict[str, Any], found) if isinstance(found, dict) else {}


def _experiment(source: Source) -> Experiment:
    from flexopt.model.simulation import Experiment  # noqa: PLC0415  (what no file asks for is not loaded)
    from flexopt.model.simulation_faults import experiment_faults  # noqa: PLC0415

    if "compute" in source.data:
        raise ModelError(f"{source.name}: is a study, not an experiment; `flexopt study run` takes it")
    if "simulation" not in source.data:
        raise ModelError(f"{source.name}: is a configuration problem, not an experiment: it has no table [simulation]")
    experiment = validated(Experiment, read_table(source.data, source.name, "an experiment file"), source.name)
    machine = _machine_of(source, experiment.machine)
    raise_if_any(ModelError, source.name, experiment_faults(experiment, machine))
    return experiment.with_machine(machine)


def _problem(source: Source) -> Problem:
    from flexopt.model.problem import Problem  # noqa: PLC0415  (what no file asks for is not loaded)
    from flexopt.model.targets import problem_faults  # noqa: PLC0415

    if "simulation" in source.data:
        raise ModelError(f"{source.name}: is an experiment, not a configuration problem; `flexopt simulate` takes it")
    if "compute" in source.data:
        raise ModelError(f"{source.name}: is a study, not a configuration problem; `flexopt study run` takes it")
    table = read_table(source.data, source.name, "a problem file")
    name = source.data.get("machine")
    machine: Machine | Tree | None = None
    try:
        machine = _machine_of(source, name) if isinstance(name, str) and name else None
    except ModelError as error:
        # What is wrong with the problem itself comes first.
        validated(Problem, table, source.name, problem_faults)
        raise error from None

    def structural(table: FileTable) -> list[Fault]:
        return problem_faults(table) + ([] if machine is None else _size_faults(table, machine))

    problem = validated(Problem, table, source.name, structural)
    assert machine is not None
    own = uncertainty_faults(problem.uncertainty, machine)
    if problem.loop is not None:
        own += loop_faults(problem.loop, machine, "loop.")
    raise_if_any(ModelError, source.name, own)
    return problem.with_machine(machine)


def _size_faults(data: FileTable, machine: Machine | Tree) -> list[Fault]:
    """Lists of numbers that are not as long as the machine's task, placement or arm."""

    def placed(value: Any) -> Any:
        return check_placement(value, machine.base_coordinates, machine.base_units)

    def held(value: Any) -> Any:
        return check_placement(value, machine.joints, machine.joint_units, what="held")

    checks: tuple[tuple[str, str, Callable[[Any], Any]], ...] = (
        ("target", "end_point", lambda value: check_task(value, machine.task_rows)),
        ("selection", "base", placed),
        ("selection", "posture", held),
    )
    faults: list[Fault] = []
    for table, key, check in checks:
        value = table_of(data.get(table)).get(key)
        if isinstance(value, tuple | int | float) and not isinstance(value, bool):
            try:
                check(value)
            except ValueError as error:
                faults.append(Fault(f"{table}.{key}", str(error), quoted(value)))
    return faults


def _machine_of(source: Source, name: str) -> Machine | Tree:
    """The machine that a file names, beside it or among the shipped."""
    beside = source.folder / name
    return load(beside if name.endswith(".toml") and beside.exists() else name)


def _with_link_names(data: dict[str, Any]) -> dict[str, Any]:
    """Number the links that have no name, so that parameters and joints can be told apart."""
    if not isinstance(data.get("links"), tuple):
        return data
    numbered = enumerate(entries(data["links"]), start=1)
    named: list[Any] = [{"name": f"link{i}"} | table_of(x) if isinstance(x, dict) else x for i, x in numbered]
    return data | {"links": tuple(named)}
