"""What signatures say: types by name, none of which is anything at all."""

from __future__ import annotations

import builtins
import inspect
import re
from collections.abc import Iterator
from typing import Any

import pytest
from pydantic import BaseModel

import flexopt
from docs.public import TYPES, documented
from flexopt import errors

# `Any`, `object`, and containers that do not say what they hold.
VAGUE = re.compile(r"\b(Any|object)\b|\b(dict|list|tuple|set|Mapping|Sequence|Iterable|Callable|NDArray)\b(?!\[)")
# Why some may say it all the same.
REASONS = {
    "Constraint.function": "given as a casadi.Function, kept with its digest",
    "Certificate._log": "the log's own, read by the checker alone",
    "return": "of an error's to_dict: a document, below the room that has the name for it",
}
# Other packages' classes, and what type hints themselves are made of.
FOREIGN = {
    "Axes", "Callable", "Executor", "Figure", "Iterator", "Literal", "Mapping", "NDArray", "None", "Self", "Sequence",
    "SubFigure", "Unpack", "ca", "np", "os", "xr",
}  # fmt: skip
# Types of flexopt's own that a result or a machine gives, to be handed back.
HANDED_BACK = {"Cylinder", "Fault", "Objective", "OverrideKeywords", "Subject", "Target"}


def written(annotation: Any) -> str:
    if annotation is inspect.Signature.empty:
        return ""
    return annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)


def signatures() -> Iterator[tuple[str, inspect.Signature]]:
    for name, public in documented().items():
        shown = getattr(flexopt, name) if name in flexopt.__all__ else public
        # Tables have a key for each argument, whose type the table of keys tells; errors are not made by users.
        if inspect.isclass(shown) and issubclass(shown, BaseException | BaseModel):
            continue
        yield name, inspect.signature(shown)


def annotations(*, returned: bool) -> Iterator[tuple[str, str, str]]:
    for call, signature in signatures():
        for name, parameter in signature.parameters.items():
            yield call, name, written(parameter.annotation)
        if returned:
            yield call, "return", written(signature.return_annotation)


def is_excused(call: str, name: str) -> bool:
    if name == "return":
        return issubclass(getattr(errors, call.partition(".")[0], object), Exception)
    return name in REASONS or f"{call}.{name}" in REASONS


def test_no_signature_takes_or_gives_anything_at_all() -> None:
    vague = [(call, name, text) for call, name, text in annotations(returned=True) if VAGUE.search(text)]
    assert [each for each in vague if not is_excused(each[0], each[1])] == []
    assert vague, "nothing is excused: take REASONS out"


@pytest.mark.parametrize("text", ["Any", "object", "dict", "list | None", "Mapping[str, Any]", "tuple"])
def test_vague_ones_are_seen(text: str) -> None:
    assert VAGUE.search(text)


@pytest.mark.parametrize("text", ["dict[str, float]", "PostureLike | None", "Callable[[int, int], None]", "AnyMachine"])
def test_others_are_not(text: str) -> None:
    assert not VAGUE.search(text)


def test_every_argument_of_a_call_has_a_type() -> None:
    bare = [
        (call, name) for call, name, text in annotations(returned=False) if not text and name not in ("self", "cls")
    ]
    assert bare == []


def test_names_of_types_are_told() -> None:
    """Each that arguments of calls have stands on the page of types, and none stands there for nothing."""
    calls = [(call, text) for call, _, text in annotations(returned=False) if not is_result(call)]
    used = {word for _, text in calls for word in re.findall(r"(?<![\w.'\"])[A-Za-z]\w*", text)}
    known = {*flexopt.__all__, *FOREIGN, *HANDED_BACK, *vars(builtins)}
    assert used - known - TYPES.keys() == set()
    everywhere = {word for *_, text in annotations(returned=True) for word in re.findall(r"\w+", text)}
    assert TYPES.keys() - everywhere == set()


def is_result(call: str) -> bool:
    """Whether its arguments are fields of what flexopt gives, which nobody calls by themselves."""
    made = getattr(flexopt, call, None)
    return inspect.isclass(made)


def test_keywords_are_spelt_out() -> None:
    """As a person reads them: by the name of the type, not what it stands for."""
    told = inspect.signature(flexopt.simulate).parameters
    assert told["kp"].annotation == "GainLike | None"
    assert inspect.signature(flexopt.select).parameters["base"].annotation == "BaseLike | None"
