"""What the commands share: options, text to numbers, progress, files, JSON on standard output."""

from __future__ import annotations

import json
import os
import re
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn, TypeVar, cast

import click

from flexopt.cli.completing import of_option
from flexopt.cli.terminal import VOICE, Colour, fitted, painted
from flexopt.errors import Fault, FlexoptError, FlexoptWarning, ImplausibleMachine, InputError, WriteError, raise_if_any
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.boundary import TABLE
from flexopt.foundation.control import CONTROLS, DAMPED
from flexopt.foundation.escapes import terminal
from flexopt.foundation.pictures import SIZES
from flexopt.foundation.writing import write_file
from flexopt.model.choices import ELBOWS
from flexopt.model.uncertainty import RangesLike, kind_of

OUTPUT_LOST, BAD_INPUT, FAILED, ABORTED = 1, 2, 3, 130
FILE_NAME_MAX = 255
# Of the clock, s.
TICK = 1.0
# How often a log hears of progress, s.
SELDOM = 30.0
# What brakes a redundant arm's self-motion: a key of loops and of runs.
BRAKE = "nullspace_damping"
# Keys of tables that sentences advise, and what stands for their value.
ADVISED = {f"loop.{BRAKE}": "C", "loop.torque_limit": "N", "actuator.torque_limit": "N"}
# How sentences begin on what was not given.
NEEDED = ("is needed", "needs ")
PICTURES = (".png", ".svg", ".pdf")
# How names end that are given to a folder by mistake.
PAGES = (".html", ".pdf", ".json")

T = TypeVar("T")
Decorator = Callable[[Callable[..., None]], Callable[..., None]]


def option(*names: str, **settings: Any) -> Decorator:
    """An option of a command, whose value the shell completes."""
    settings["shell_complete"] = of_option(names[0], settings.get("metavar"))
    return cast(Decorator, click.option(*names, **settings))


def value(name: str, metavar: str, text: str, read: Callable[[str], Any] = str, *, multiple: bool = False) -> Decorator:
    """An option with a value: what stands for it, what it does, and what is made of its text."""
    return option(name, metavar=metavar, help=text, type=read, multiple=multiple)


def together(*options: Decorator) -> Decorator:
    """Several options as one, in the order in which the help has them."""

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        for each in reversed(options):
            command = each(command)
        return command

    return decorate


def of_picture(text: str) -> Decorator:
    """`--plot` with what it draws, and how large and on which ground: `check_picture` takes them."""
    return together(value("--plot", "FILE.png", text), of_sheet("--plot"))


def of_sheet(draws: str) -> Decorator:
    """How large, and on which ground, what another option draws is."""
    sizes = f"With {draws}: how large, {', '.join(SIZES)} or W,H in inches (screen by default)."
    return together(
        value("--size", "|".join((*SIZES, "W,H")), sizes, _size),
        value("--theme", "light|dark", f"With {draws}: on which ground (light by default)."),
    )


def check_sheet(
    arguments: Arguments, options: dict[str, Any], draws: str, *, given: bool, film: bool = False
) -> dict[str, Any]:
    """Takes the options of `of_sheet` out of all, notes what cannot be drawn, gives what was asked for."""
    asked = {name: wanted for name in ("size", "theme") if (wanted := options.pop(name)) is not None}
    for name, wanted in asked.items():
        TABLE[name](arguments, f"--{name}", wanted)
        if not given and not (film and name == "theme"):
            arguments.note(f"--{name}", f"goes with {draws}", typed(wanted))
    return asked


def _size(text: str) -> Any:
    """A word, or two numbers."""
    return tuple(numbers(text)) if "," in text else text.strip()


def check_picture(options: dict[str, Any], *, film: bool = False) -> Callable[[Any], None]:
    """Takes the options of `of_picture` out of all, refuses what cannot be written, gives what draws a result.

    A `film`, too, is on the ground of --theme.
    """
    plot = options.pop("plot")
    check_output("--plot", plot, PICTURES)
    arguments = Arguments("--plot")
    asked = check_sheet(arguments, options, "--plot", given=plot is not None, film=film)
    arguments.done()

    def draw(result: Any) -> None:
        if plot is not None:
            write_output("--plot", plot, lambda: result.plot(plot, **asked))

    return draw


def say(text: str, *, err: bool = False, colour: Colour | None = None) -> None:
    """Print text, whatever letters are in it, as wide as the terminal is."""
    # Not `click.echo`, which writes UTF-8 where the terminal has only ASCII.
    stream = sys.stderr if err else sys.stdout
    print(painted(fitted(terminal(as_options(text)), stream), colour, stream), file=stream, flush=True)


def say_once(text: str) -> None:
    """Print to the error stream what the command has not said yet, unless it is to be quiet."""
    said = click.get_current_context().meta.setdefault("flexopt.said", set[str]())
    if text not in said and not VOICE.quiet:
        said.add(text)
        say(text, err=True)


def as_options(text: str) -> str:
    """A key that a sentence advises, as the command that prints it takes it."""
    context = click.get_current_context(silent=True)
    options = {word for each in context.command.params for word in each.opts} if context is not None else set[str]()
    for key, letter in ADVISED.items():
        table, name = key.split(".")
        if f"--{table}" in options:
            text = re.sub(rf"\b{key} (?=brakes|lets)", f"--{table} {name}={letter} ", text)
    word = f"--{BRAKE.replace('_', '-')}"
    return text.replace(f"; {BRAKE} brakes", f"; {word} brakes") if word in options else text


def print_json(document: dict[str, Any]) -> None:
    """Print one document; NaN is refused."""
    click.echo(json.dumps(document, indent=2, allow_nan=False))


@contextmanager
def option_names(options: dict[str, Any]) -> Generator[None]:
    """Faults of arguments under the names of the options they were given by; meanwhile a clock runs."""
    spelled = {"target": "end_point", "end-point": "end_point", "executor": "dask", "folder": "out"}
    no_options = {"machine_or_problem": "MACHINE"}
    asked = dict(options)
    try:
        with clock():
            yield
    except InputError as error:
        renamed: list[Fault] = []
        for fault in error.faults:
            name, rest = cast(re.Match[str], re.match(r"([\w-]*)(.*)", fault.field, re.DOTALL)).groups()
            word = name if name in asked else spelled.get(name, name)
            # What no option gave may be a file's.
            missing = word in asked and asked[word] is None and fault.value in (None, "None")
            given = asked.get(word) not in (None, ()) or (missing and fault.sentence.startswith(NEEDED))
            field = (
                f"--{word.replace('_', '-')}{re.sub(r'^[.]', ' ', rest)}"
                if given
                else no_options.get(fault.field, fault.field)
            )
            renamed.append(Fault(field, fault.sentence, None if missing else fault.value))
        # A sentence that was not made of its faults stays as it is, unless an option gave what it speaks of.
        if type(error) is InputError and (error.heading or renamed != list(error.faults)):
            # A command that calls another's function, as verdict calls select, goes by its own name.
            command = click.get_current_context().command_path.partition(" ")[2]
            raise_if_any(InputError, command if error.heading.isidentifier() else error.heading or command, renamed)
        raise


@contextmanager
def warnings_to_stderr(as_json: bool) -> Generator[None]:
    """Print flexopt's warnings on standard error; in text they are part of the result itself.

    That a machine is not plausible is part of no result. Warnings of other packages are for `--verbose` alone.
    """
    caught: list[warnings.WarningMessage] = []
    told = VOICE.warned
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", FlexoptWarning)
            yield
    finally:
        for warning in caught:
            message = warning.message
            sentence = str(message)
            if VOICE.verbose and isinstance(message, FlexoptWarning):
                sentence = "; ".join(message.remarks)
            if not issubclass(warning.category, FlexoptWarning):
                if VOICE.verbose:
                    warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
            elif (as_json or issubclass(warning.category, ImplausibleMachine)) and sentence not in told:
                told.add(sentence)
                if not VOICE.quiet:
                    say(f"flexopt: warning: {sentence}", err=True, colour="yellow")


@contextmanager
def clock() -> Generator[None]:
    """Seconds on standard error, and how far the command is where that is known; seldom where that is a log."""
    if VOICE.quiet:
        yield
        return
    live = sys.stderr.isatty()
    word, done, shown = click.get_current_context().command_path.partition(" ")[2], threading.Event(), list[str]()

    def tick() -> None:
        begun = time.monotonic()
        while not done.wait(TICK if live else SELDOM):
            passed = time.monotonic() - begun
            if VOICE.progress is not None:
                VOICE.progress(passed)
            elif not live:
                click.echo(f"{word}: {passed:.0f} s", err=True)
            else:
                shown.append(f"\r{word}: {len(shown) + 1} s")
                click.echo(shown[-1], nl=False, err=True)

    thread = threading.Thread(target=tick, daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()
        if shown:
            click.echo(f"\r{' ' * len(shown[-1])}\r", nl=False, err=True)


def read(load: Callable[[str], T], name: str) -> T:
    """What `load` reads from a name or file, its warnings as lines on standard error."""
    with warnings_to_stderr(True):
        return load(name)


class _Lines:
    """How far something is, for a log: with the clock's seconds, and at the end what was not said yet."""

    def __init__(self, what: str) -> None:
        self.what, self.at, self.said = what, "", ""

    def show(self, done: int, total: int) -> None:
        """Note it."""
        self.at = f"{self.what} {done}/{total}"

    def tick(self, passed: float) -> None:
        """Say it, after so many seconds."""
        self.said = self.at
        click.echo(f"{self.at or f'{self.what}: 0 so far'}, {passed:.0f} s", err=True)

    def end(self) -> None:
        """Say what was not said yet."""
        if self.at != self.said:
            click.echo(self.at, err=True)


@contextmanager
def progress_bar(of: str) -> Generator[Callable[[int, int], None]]:
    """A bar on standard error where that is a terminal, else lines; both with seconds while a `clock` runs.

    None with --quiet, and where nothing says of what.
    """
    if VOICE.quiet or not of:
        yield lambda _done, _total: None
        return
    try:
        if not sys.stderr.isatty():
            lines = _Lines(of)
            VOICE.progress = lines.tick
            yield lines.show
            lines.end()
            return
        with click.progressbar(length=1, label=of, file=sys.stderr, show_pos=True) as bar:
            # The clock is a thread of its own.
            drawing = threading.Lock()

            def show(done: int, total: int) -> None:
                with drawing:
                    bar.length = total
                    bar.update(done - bar.pos)

            def tick(passed: float) -> None:
                with drawing:
                    if VOICE.progress is not None:
                        bar.label = f"{of}, {passed:.0f} s"
                        bar.render_progress()

            VOICE.progress = tick
            yield show
            with drawing:
                VOICE.progress = None
    finally:
        VOICE.progress = None


@contextmanager
def working(options: dict[str, Any], as_json: bool, of: str = "") -> Generator[Callable[[int, int], None]]:
    """A call: faults by the names of these options, warnings as lines, and where `of` says of what, how far it is."""
    with option_names(options), warnings_to_stderr(as_json), progress_bar(of) as progress:
        yield progress


def announce(stage: str, *, always: bool = False) -> None:
    """Say on standard error what comes now, where no bar shows it, or `always`; nothing with --quiet."""
    if not VOICE.quiet and (always or not sys.stderr.isatty()):
        say(stage, err=True)


def check_folder(option: str, path: str) -> None:
    """Find out that a folder cannot be made before the work is done."""
    target = Path(path)
    made = next((folder for folder in (target, *target.parents) if folder.exists()), None)
    if made is None or not made.is_dir():
        raise InputError(f"{option} = {path!r}: {str(made or target)!r} is no folder")
    if target.suffix.lower() in PAGES and not target.exists():
        raise InputError(f"{option} = {path!r}: a folder is made of this name, and {target.suffix} ends that of a file")


def check_output(option: str, path: str | None, suffixes: tuple[str, ...]) -> None:
    """Find out that a file cannot be written before the work is done."""
    if path is None:
        return
    target = Path(path)
    length = len(os.fsencode(target.name))
    if length > FILE_NAME_MAX:
        raise InputError(f"{option}: the file name is too long, {length} bytes of {FILE_NAME_MAX}")
    if target.suffix.lower() not in suffixes:
        raise InputError(f"{option} = {path!r}: the name must end in {' or '.join(suffixes)}{_writing(target.suffix)}")
    if target.is_dir() or not target.parent.is_dir():
        raise InputError(f"{option} = {path!r}: there is no folder {str(target.parent)!r} to write a file into")


def _writing(suffix: str) -> str:
    """Which option of the command that runs writes files of this ending, in words; empty where none does."""
    kinds, context = {"--html": (".html",), "--pdf": (".pdf",), "--plot": PICTURES}, click.get_current_context()
    own = {name for each in context.command.params for name in each.opts}
    found = [option for option, endings in kinds.items() if option in own and suffix.lower() in endings]
    return f"; {' or '.join(found)} writes {suffix}" if found else ""


def check_pdf(path: str | None) -> None:
    """Find out that a page cannot be printed before the work is done."""
    from flexopt.foundation.printing import find_browser  # noqa: PLC0415  (only pages need it)

    check_output("--pdf", path, (".pdf",))
    if path is not None:
        find_browser()


def write_output(option: str, path: str, write: Callable[[], object]) -> None:
    """Run `write`; what the system refuses is bad input of the option."""
    try:
        write()
    except WriteError as error:
        raise WriteError(f"{option} = {path!r}: {error}", path=error.path, size=error.size, code=error.errno) from error


def write_result(result: Any, out: str) -> None:
    """A result's file by its name: the document, a table of samples or, of any other name, netCDF."""
    kind = Path(out).suffix.lower()
    if kind == ".json":
        text = json.dumps(result.to_dict(), indent=2, allow_nan=False) + "\n"
        write_output("--out", out, lambda: write_file(out, text))
    else:
        write_output("--out", out, lambda: (result.to_csv if kind == ".csv" else result.to_netcdf)(out))


def tell(result: Any, more: str = "", *, as_json: bool) -> None:
    """A result on standard output: one JSON document, or text and what there is `more` to say."""
    if as_json:
        print_json(result.to_dict())
    else:
        say(f"{result!r}{more}")


def handing_out(options: dict[str, Any], *suffixes: str, as_json: bool) -> Callable[[Any], None]:
    """Takes --out and those of `of_picture` out of all options, refuses what cannot be written.

    Gives what writes a result's files, whose names end in `suffixes`, and its picture, and tells it.
    """
    out, draw = options.pop("out"), check_picture(options) if "plot" in options else None
    check_output("--out", out, suffixes)

    def hand_out(result: Any) -> None:
        if out is not None:
            write_result(result, out)
        if draw is not None:
            draw(result)
        tell(result, as_json=as_json)

    return hand_out


def given(options: Mapping[str, Any], *names: str) -> dict[str, Any]:
    """Options of these names, or all, that were given."""
    chosen = {name: options[name] for name in names or options}
    return {name: value for name, value in chosen.items() if value is not None and value is not False}


def typed(value: Any) -> str:
    """What was read from an option, as it is typed."""
    if isinstance(value, list):
        return ",".join(map(typed, cast(list[Any], value)))
    return f"{value:g}" if isinstance(value, float) else str(value)


def number(text: str) -> Any:
    """A number, or the text as it stands, for the checks to name."""
    try:
        return text.strip() if "_" in text else float(text)
    except ValueError:
        return text.strip()


def whole(text: str) -> Any:
    """A whole number where it is one."""
    value = number(text)
    return int(value) if isinstance(value, float) and value.is_integer() else value


def numbers(text: str) -> list[Any]:
    """`1,2.5` as numbers; what is no number stays text, for the checks to name."""
    return [number(part) for part in text.split(",")]


def wholes(text: str) -> list[Any]:
    """`1,2` as whole numbers."""
    return [whole(part) for part in text.split(",")]


def placement(text: str) -> Any:
    """A placement: one number alone, or a list."""
    parts = numbers(text)
    return parts[0] if len(parts) == 1 else parts


def table(name: str, entries: tuple[str, ...], read: Callable[[str], Any] = placement) -> dict[str, Any] | None:
    """`("delay=0.02", "noise=1e-3")` as a table, numbers as numbers; None where nothing was given."""
    found: dict[str, Any] = {}
    for entry in entries:
        key, equals, value = entry.partition("=")
        if not equals or not key.strip():
            raise InputError(f"{name} = {entry!r}: must be NAME=VALUE")
        several = re.split(r"[\s,;]+(?=[A-Za-z_][\w.*]*=)", entry.strip())
        if len(several) > 1:
            raise InputError(f"{name} = {entry!r}: give each its own: {' '.join(f'{name} {each}' for each in several)}")
        if key.strip() in found:
            raise InputError(f"{name} = {entry!r}: {key.strip()} is given twice")
        found[key.strip()] = read(value)
    return found or None


def ranges_table(entries: tuple[str, ...]) -> RangesLike | None:
    """What `--ranges` names, as calls take it; of ends as x0.5,x2 one factor of all that is meant by the name."""
    factors = [re.fullmatch(r"\s*([^=\s]+)\s*=\s*x([^,]+),\s*x(.+)", entry) for entry in entries]
    if not any(factors):
        return table("--ranges", entries)
    found = list[dict[str, Any]]()
    for entry, factor in zip(entries, factors, strict=True):
        if factor:
            found.append({"of": factor[1], "factor": placement(f"{factor[2]},{factor[3]}")})
        else:
            found += [{"of": name, kind_of(name): ends} for name, ends in (table("--ranges", (entry,)) or {}).items()]
    return found


JSON = option("--json", "as_json", is_flag=True, help="Print one JSON document.")
OUT = value("--out", "PATH", "Write the JSON document to a file, too.")
CONTROL = option(
    "--control", metavar="|".join((*CONTROLS, f"{DAMPED}:LAMBDA")),
    help="Jacobian inverse, transpose, or damped inverse with LAMBDA > 0 in the unit of Jv's entries; by default that "
    "of the loop, else inverse.",
)  # fmt: skip
GRAVITY = option("--gravity", is_flag=True, help="Measures under static deflection.")
PDF = value("--pdf", "FILE", "Print the page to a PDF, too; needs Chromium, Chrome or Edge.")
WEIGHTS = value("--weights", "A1,A2,…", "Weights α of the objective V = Σ αi wi, and β of ε_max after them.", numbers)
GAIN = value("--gain", "KR", "Servo gain of the margin ε_max (5e5 by default).", number)
BASE = value("--base", "X[,Y,YAW]", "Placement of the base, m and rad: in a choice, where it stands now.", placement)
END_POINT = value("--end-point", "X,Y[,Z]", "Target of the end-point, inertial frame, m.", numbers)
ELBOW = option(
    "--elbow", metavar="|".join(ELBOWS),
    help="With --end-point: which branch of a planar arm; up: the last joint is negative (of two joints by default up, "
    "of more both).",
)  # fmt: skip


def leave_with(error: FlexoptError) -> NoReturn:
    """Say what went wrong, and end with its code."""
    if VOICE.verbose:
        say("".join(traceback.format_exception(error)).rstrip(), err=True)
    say(f"flexopt: {error}", err=True, colour="red")
    sys.exit(BAD_INPUT if isinstance(error, InputError) else FAILED)
