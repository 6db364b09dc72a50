"""Every argument of every public name is given the bad list: `python -m tests.boundary.walk [NAME …] [--out FILE]`.

What a call does with a bad value is an outcome: `refused` (a FlexoptError), `raw` (any other exception) or `accepted`.
An argument that is not done in time ends the process with a traceback of where it hangs. Runs in a folder of its own.
"""

from __future__ import annotations

import argparse
import faulthandler
import inspect
import io
import json
import os
import shutil
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any, NamedTuple

import flexopt
from flexopt.selection.outcomes.measures import MEASURES
from flexopt.study import page
from tests.boundary.bad_values import BAD
from tests.boundary.calls import CONSTRUCTORS, FUNCTIONS, LONG, METHODS, OBJECTS

# Longer than all bad values of an argument take, on a busy machine, too.
SECONDS_MAX = 120


class Call(NamedTuple):
    """Something public that takes arguments: `name` or `Class.method`, what is called, and good arguments."""

    name: str
    function: Callable[..., Any]
    good: Callable[[], dict[str, Any]]


def public_methods(owner: type) -> Iterator[tuple[str, Any]]:
    """Methods of a class that flexopt defines, its bases' too, and that take arguments."""
    for name, member in inspect.getmembers(owner, inspect.isfunction):
        own = (getattr(inspect.unwrap(member), "__module__", "") or "").startswith("flexopt")
        if own and not name.startswith("_") and len(inspect.signature(member).parameters) > 1:
            yield name, member


def calls() -> Iterator[Call]:
    """All that is public and takes arguments. KeyError: something new has no good call yet in `calls`."""
    for name in flexopt.__all__:
        found = getattr(flexopt, name)
        if not isinstance(found, type):
            yield Call(name, found, FUNCTIONS[name])
            continue
        if name in CONSTRUCTORS:
            yield Call(name, found, CONSTRUCTORS[name])
        for method, _ in public_methods(found):
            good = METHODS[f"{name}.{method}"]
            yield Call(f"{name}.{method}", lambda n=name, m=method, **given: getattr(_object(n), m)(**given), good)


_objects: dict[str, Any] = {}


def _object(name: str) -> Any:
    if name not in _objects:
        _objects[name] = OBJECTS[name]()
    return _objects[name]


def signature(call: Call) -> Mapping[str, inspect.Parameter]:
    """Parameters by name, `self` aside."""
    function: Any = call.function
    if "." in call.name:
        owner, method = call.name.split(".")
        function = getattr(getattr(flexopt, owner), method)
    if hasattr(function, "model_rebuild"):
        function.model_rebuild()  # Pydantic tells the fields once the class is in use
    found = dict(inspect.signature(function).parameters)
    found.pop("self", None)
    return found


def run(call: Call, given: Mapping[str, Any]) -> None:
    """Call it; arguments that are None in the good call are left out."""
    kinds = {name: parameter.kind for name, parameter in signature(call).items()}
    named = dict(given)
    positional: tuple[Any, ...] = ()
    for name, kind in kinds.items():
        if kind is inspect.Parameter.VAR_KEYWORD:
            named |= named.pop(name, None) or {}
        elif kind is inspect.Parameter.VAR_POSITIONAL:
            positional = named.pop(name)
    with warnings.catch_warnings(), redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        if "." in call.name:
            owner, method = call.name.split(".")
            getattr(_object(owner), method)(*positional, **named)
        else:
            call.function(*positional, **named)


def cases(call: Call) -> Iterator[tuple[str, dict[str, Any], Callable[[Any], dict[str, Any]]]]:
    """Each argument: its name, the other good arguments, and how a value is put in."""
    good = call.good()
    for name, parameter in signature(call).items():
        others = {key: value for key, value in good.items() if key != name and value is not None}
        if parameter.kind is inspect.Parameter.VAR_KEYWORD:
            for key, value in (good[name] or {}).items():
                rest = {k: v for k, v in good[name].items() if k != key}
                yield f"{name}.{key}", others, lambda bad, key=key, rest=rest, name=name: {name: rest | {key: bad}}
                del value
        elif parameter.kind is inspect.Parameter.VAR_POSITIONAL:
            yield name, others, lambda bad, name=name: {name: (bad,)}
        else:
            yield name, others, lambda bad, name=name: {name: bad}


def outcome(call: Call, given: Mapping[str, Any]) -> tuple[str, str]:
    """What becomes of a call, and the message."""
    try:
        run(call, given)
    except flexopt.FlexoptError as error:
        return "refused", f"{type(error).__name__}: {error}"[:300]
    except BaseException as error:  # any other is what this looks for
        return "raw", f"{type(error).__name__}: {error!s}"[:300]
    finally:
        _remove(Path(BAD["text"]()))
    return "accepted", ""


def _remove(written: Path) -> None:
    """What a call wrote under a bad name, so that the next finds the folder as it was."""
    if written.is_dir():
        shutil.rmtree(written)
    written.unlink(missing_ok=True)


def walk(names: list[str]) -> Iterator[dict[str, str]]:
    """A row for each argument and bad value of the calls of these names, or of all."""
    for call in calls():
        if names and call.name not in names and call.name.partition(".")[0] not in names:
            continue
        faulthandler.dump_traceback_later(SECONDS_MAX, exit=True)
        if call.name not in LONG:
            # Unless the good call is taken, a refusal says nothing.
            given = {key: value for key, value in call.good().items() if value is not None}
            kind, message = outcome(call, given)
            yield {"call": call.name, "argument": "", "bad": "nothing", "outcome": kind, "message": message}
        for argument, others, put in cases(call):
            faulthandler.dump_traceback_later(SECONDS_MAX, exit=True)
            parameter = signature(call).get(argument)
            for bad, make in BAD.items():
                if bad == "None" and parameter is not None and parameter.default is None:
                    continue  # left out, as by default
                kind, message = outcome(call, {**others, **put(make())})
                yield {"call": call.name, "argument": argument, "bad": bad, "outcome": kind, "message": message}
    faulthandler.cancel_dump_traceback_later()


def main() -> None:
    """Walk, print what is not refused and the counts."""
    parser = argparse.ArgumentParser()
    parser.add_argument("names", nargs="*")
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    out = asked.out.resolve() if asked.out else None
    folder, before = tempfile.mkdtemp(prefix="flexopt-boundary-"), Path.cwd()
    shutil.copytree(Path(flexopt.__file__).parents[1] / "models", folder, dirs_exist_ok=True)
    os.chdir(folder)
    for measure in map(type, MEASURES.values()):
        # Whether a call is taken depends neither on how well it searches nor on the pictures of its pages.
        measure.looked, measure.stages = 20, ((2, 2),)
    page._png = lambda figure: ""
    rows: list[dict[str, str]] = []
    try:
        for row in walk(asked.names):
            rows.append(row)
            if row["outcome"] != ("refused" if row["argument"] else "accepted"):
                print(f"{row['outcome']:8} {row['call']}({row['argument']}) {row['bad']}: {row['message']}", flush=True)
    finally:
        os.chdir(before)
        shutil.rmtree(folder, ignore_errors=True)
        if out is not None:
            out.write_text(json.dumps(rows), encoding="utf-8")
    rows = [row for row in rows if row["argument"]]
    counts = Counter(row["outcome"] for row in rows)
    print(f"{len({row['call'] for row in rows})} calls, {len({(r['call'], r['argument']) for r in rows})} arguments, "
          f"{len(rows)} bad values: " + ", ".join(f"{n} {k}" for k, n in sorted(counts.items())))  # fmt: skip


if __name__ == "__main__":
    main()
