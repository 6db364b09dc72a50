"""Studies in files: the TOML file that a user writes, and the document that whoever computes a part of it reads.

In: a path, or a study. Out: a `Study` that holds its machine, problem or experiment; or plain data.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any

from flexopt.errors import ModelError, raise_if_any
from flexopt.foundation.boundary import public
from flexopt.model.file_model import read_table, validated
from flexopt.model.files import Source, read_source
from flexopt.model.planar import Machine
from flexopt.model.problem import Problem
from flexopt.model.simulation import Experiment
from flexopt.model.study import SUBJECTS, Study
from flexopt.model.study_axes import study_axes
from flexopt.model.tree import Tree


@public(error=ModelError)
def load_study(name_or_path: str | os.PathLike[str]) -> Study:
    """Read and validate a study; its machine, problem or experiment is loaded with it.

    Args:
        name_or_path: a name (`"excavator-study"` finds the shipped `problems/excavator-study.toml`) or the path of a
            TOML file. A relative path in its `machine`, `problem` or `experiment` starts from the file's folder.

    Raises:
        ModelError: as for `load`, for the study and for what it is about.

    Example:
        >>> flexopt.load_study("excavator-study").chunks
        4
    """
    return study_from(read_source(name_or_path, ("problems",)))


def study_from(source: Source) -> Study:
    """The study of a file that was read."""
    if "compute" not in source.data:
        raise ModelError(f"{source.name}: is no study: it has no key compute")
    study = validated(Study, read_table(source.data, source.name, "a study file"), source.name)
    raise_if_any(ModelError, source.name, study.structural_faults())
    word = next(word for word in SUBJECTS if getattr(study, word) is not None)
    name = getattr(study, word)
    beside = source.folder / name
    study = study.with_subject(SUBJECTS[word](beside if name.endswith(".toml") and beside.exists() else name))
    try:
        study_axes(study)
    except ModelError:
        raise
    except ValueError as error:
        faults = getattr(error, "faults", ())
        raise_if_any(ModelError, source.name, faults)
        raise ModelError(f"{source.name}: {error}") from None
    return study


def described(study: Study) -> dict[str, Any]:
    """The study with its subject, as plain data that JSON holds exactly: what `study_of` takes back."""
    subject, machine = study.subject, study.loaded_machine
    table: dict[str, Any] = {"study": _plain(study), "machine": _plain(machine), "kind": type(machine).__name__}
    if subject is not machine:
        table["subject"] = _plain(subject)
    return table


def _plain(model: Any) -> dict[str, Any]:
    try:
        return json.loads(model.model_dump_json(by_alias=True, exclude_unset=True))
    except ValueError as error:
        raise ModelError(f"{model.name}: cannot be written into a file ({error})") from None


def study_of(table: Mapping[str, Any]) -> Study:
    """The study of `described`, holding its subject."""
    machine = {"Machine": Machine, "Tree": Tree}[table["kind"]](**table["machine"])
    study = Study(**table["study"])
    if "subject" not in table:
        return study.with_subject(machine)
    kind = Problem if study.compute == "selection" else Experiment
    return study.with_subject(kind(**table["subject"]).with_machine(machine))
