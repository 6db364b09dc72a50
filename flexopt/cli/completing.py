"""What the shell may complete: machines, problems, and the values of options."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable
from typing import Any

import click
from click.shell_completion import CompletionItem

from flexopt.errors import FlexoptError, FlexoptWarning
from flexopt.foundation.control import CONTROLS, DAMPED
from flexopt.model.choices import ASSUMPTIONS, ELBOWS, EVERYTHING, NOTHING, OUTCOMES
from flexopt.model.files import shipped_names

Complete = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]
WordsOf = Callable[[click.Context], Iterable[str]]

SHELLS = ("bash", "zsh", "fish")
LITERAL = re.compile(r"[a-z0-9][a-z0-9._-]*|V")
FILE = re.compile(r"PATH|FILE|ROBOT|CSV")


def _items(words: Iterable[str], incomplete: str) -> list[CompletionItem]:
    """Words that go on; behind commas the last one."""
    before, comma, last = incomplete.rpartition(",")
    return [CompletionItem(f"{before}{comma}{word}") for word in words if word.startswith(last)]


def _of(words: WordsOf, *, files: bool = False) -> Complete:
    def complete(ctx: click.Context, _: click.Parameter, incomplete: str) -> list[CompletionItem]:
        found = _items(words(ctx), incomplete)
        return found if found or not files else [CompletionItem(incomplete, type="file")]

    return complete


def _path(kind: str) -> Complete:
    return lambda _ctx, _parameter, incomplete: [CompletionItem(incomplete, type=kind)]


def _modes(ctx: click.Context) -> list[str]:
    machine = _machine(ctx)
    count = 3 if machine is None else len(machine.build_tree().passive)
    return [f"w{k + 1}" for k in range(count)]


def _machine(ctx: click.Context) -> Any:
    """The machine that stands on the line already, where it can be read."""
    from flexopt.model import Problem, load_any  # noqa: PLC0415  (only these values need it)

    # An option that still lacks its value keeps click from counting arguments.
    name: Any = ctx.params.get("machine") or ctx.params.get("problem") or next(iter(ctx.args), "")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FlexoptWarning)
            found = load_any(name)
        return found.loaded_machine if isinstance(found, Problem) else found
    except FlexoptError:
        return None


def _joints(ctx: click.Context) -> Iterable[str]:
    machine = _machine(ctx)
    return () if machine is None else machine.joints


def _loop_keys(_: click.Context) -> list[str]:
    from flexopt.model.loop import DEFAULT_LOOP, Loop  # noqa: PLC0415  (only this value needs it)

    return [DEFAULT_LOOP, *(f"{key}=" for key in Loop.model_fields)]


def _parameters(ctx: click.Context) -> list[str]:
    machine = _machine(ctx)
    return [] if machine is None else [parameter.name for parameter in machine.parameters]


def _ranges(ctx: click.Context) -> list[str]:
    return [f"{word}=" for word in ("stiffness", "damping", "dead_time", *_parameters(ctx))]


def _varied(ctx: click.Context) -> list[str]:
    from flexopt.model.loop import GAINS  # noqa: PLC0415  (only this value needs it)

    return [*(f"{gain}=" for gain in GAINS), *_ranges(ctx)]


def _shipped(*kinds: Any) -> WordsOf:
    return lambda _: sorted({name for kind in kinds for name in shipped_names(kind)})


OPTIONS: dict[str, Complete] = {
    "assume": _of(lambda _: (EVERYTHING, NOTHING, *ASSUMPTIONS)),
    "control": _of(lambda _: (*CONTROLS, f"{DAMPED}:")),
    "elbow": _of(lambda _: ELBOWS),
    "experiment": _of(_shipped("problems"), files=True),
    "joints": _of(_joints),
    "loop": _of(_loop_keys),
    "objective": _of(lambda ctx: (*_modes(ctx), "V", "epsilon_max", *OUTCOMES)),
    "ranges": _of(_ranges),
    "unknown": _of(lambda ctx: ("stiffness", "damping", *_parameters(ctx))),
    "vary": _of(_varied),
}
ARGUMENTS: dict[str, Complete] = {
    "file": _of(_shipped("models", "problems"), files=True),
    "folder": _path("dir"),
    "log": _path("file"),
    "machine": _of(_shipped("models"), files=True),
    "machine or problem": _of(_shipped("models", "problems"), files=True),
    "results": _path("file"),
    "problem": _of(_shipped("problems", "models"), files=True),
    "study": _of(_shipped("problems"), files=True),
    "shell": _of(lambda _: SHELLS),
}


def of_option(name: str, metavar: str | None) -> Complete | None:
    """What completes the value of an option: of its own, a path, or the words of what stands for it."""
    own = OPTIONS.get(name.removeprefix("--"))
    if own is not None or metavar is None:
        return own
    if FILE.search(metavar):
        return _path("file")
    if metavar == "DIR":
        return _path("dir")
    words = [word for word in metavar.split("|") if LITERAL.fullmatch(word)]
    return _of(lambda _: words) if words else None


def argument(name: str, of: str | None = None, **settings: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """An argument of a command that the shell completes, as the one of `ARGUMENTS` that `of` or its name says."""
    return click.argument(name, shell_complete=ARGUMENTS[of or name], **settings)
