"""`flexopt new`: a machine file to begin with, from a few answers or from a robot file."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from flexopt.cli.common import (
    JSON,
    check_output,
    numbers,
    option,
    print_json,
    say,
    typed,
    value,
    write_output,
)
from flexopt.cli.completing import argument
from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.documents import provenance
from flexopt.foundation.escapes import of_option_list
from flexopt.foundation.plain import counted
from flexopt.foundation.quantities import ANGLE, INERTIA, LENGTH, LENGTH_OR_ZERO, MASS, Quantity
from flexopt.foundation.quantities import several as entries_or_one
from flexopt.foundation.writing import write_file

if TYPE_CHECKING:
    from flexopt.study.new_files.machine import Ground, NewMachine

LINKS = (2, 8)
FROM_MODE, FROM_RATIO, FREE, NONE = "frequency", "ratio", "free", "none"
PLANAR, SPATIAL = ("x", "y", "rotation"), ("x", "y", "z", "roll", "pitch", "yaw")
FREQUENCY = Quantity("Hz", above=0.0, high=1e3)
RATIO = Quantity("", low=0.0, high=0.99)
LINEAR, TURNING = (Quantity("N/m", above=0.0, high=1e15), Quantity("N m/rad", above=0.0, high=1e15))
LINEAR_DAMPING, TURNING_DAMPING = (Quantity("N s/m", low=0.0, high=1e12), Quantity("N m s/rad", low=0.0, high=1e12))


@dataclass
class Question:
    """What is asked: its option's name, the words of the question, its check and its proposal, given what is known."""

    name: str
    text: str
    read: Callable[[Any, Mapping[str, Any]], Any]
    proposal: Callable[[Mapping[str, Any]], str]
    wanted: Callable[[Mapping[str, Any]], bool] = field(default=lambda _: True)


def several(quantity: Quantity, count: Callable[[Mapping[str, Any]], int]) -> Callable[[Any, Mapping[str, Any]], Any]:
    """As many numbers of a quantity."""

    def read(text: Any, known: Mapping[str, Any]) -> tuple[float, ...]:
        parts, wanted = numbers(str(text)), count(known)
        if len(parts) != wanted:
            raise ValueError(f"must be {wanted} numbers with commas between them, not {len(parts)}")
        return tuple(quantity(part) for part in parts)

    return read


def one(quantity: Quantity) -> Callable[[Any, Mapping[str, Any]], Any]:
    """One number of a quantity."""
    return lambda text, _: several(quantity, lambda _: 1)(text, {})[0]


def word_or(word: str, read: Callable[[Any, Mapping[str, Any]], Any]) -> Callable[[Any, Mapping[str, Any]], Any]:
    """None for that word."""
    return lambda text, known: None if str(text).strip() == word else read(text, known)


def _name(text: Any, _: Mapping[str, Any]) -> str:
    if not str(text).strip() or len(str(text)) > 100:
        raise ValueError("must be a name of at most 100 letters")
    return str(text).strip()


def _count(text: Any, _: Mapping[str, Any]) -> int:
    try:
        count = int(str(text))
    except ValueError:
        count = 0
    if not LINKS[0] <= count <= LINKS[1]:
        raise ValueError(f"must be a whole number from {LINKS[0]} to {LINKS[1]}: a point in the plane needs two joints")
    return count


def _limits(text: Any, known: Mapping[str, Any]) -> tuple[tuple[float, float], ...]:
    pairs = [numbers(part) for part in str(text).split(";")]
    if len(pairs) != known["links"]:
        raise ValueError(f"must be {known['links']} pairs LO,HI with semicolons between them, or {FREE}")
    found: list[tuple[float, float]] = []
    for pair in pairs:
        if len(pair) != 2:
            raise ValueError("each must be a pair LO,HI")
        low, high = (ANGLE(end) for end in pair)
        if not low < high:
            raise ValueError(f"the lower end {low:g} must be below the upper end {high:g}")
        found.append((low, high))
    return tuple(found)


def _gives(directions: tuple[str, ...], least: int) -> Callable[[Any, Mapping[str, Any]], tuple[str, ...]]:
    def read(text: Any, _: Mapping[str, Any]) -> tuple[str, ...]:
        words = [] if least == 0 and str(text).strip() == NONE else of_option_list(str(text))
        wrong = [word for word in words if word not in directions]
        if wrong or len(words) < least:
            listed = ",".join(directions)
            raise ValueError(f"must be some of {listed}" + (f", or {NONE}" if least == 0 else ""))
        return tuple(direction for direction in directions if direction in words)

    return read


def _springs(linear: Quantity, turning: Quantity) -> Callable[[Any, Mapping[str, Any]], tuple[float, ...]]:
    def read(text: Any, known: Mapping[str, Any]) -> tuple[float, ...]:
        parts = numbers(str(text))
        if len(parts) != len(known["gives"]):
            raise ValueError(f"must be a number for each of {','.join(known['gives'])}")
        return tuple((linear if d in "xyz" else turning)(x) for d, x in zip(known["gives"], parts, strict=True))

    return read


def _of_ground(
    gives: str, directions: tuple[str, ...], least: int, reach: Callable[[Mapping[str, Any]], float]
) -> list[Question]:
    """What the machine stands on."""

    def some(known: Mapping[str, Any]) -> bool:
        return bool(known["gives"])

    def proposed(known: Mapping[str, Any]) -> str:
        from flexopt.study.new_files.machine import usual_frequency  # noqa: PLC0415

        return f"{usual_frequency(reach(known)):g}"

    empty = f" (or {NONE}: the robot file has springs of its own)" if least == 0 else ""
    return [
        Question(
            "gives", f"Directions in which the base gives, of {','.join(directions)}{empty}",
            _gives(directions, least), lambda _: gives,
        ),
        Question(
            "stiffness",
            f"Stiffness of each, N/m or N m/rad, greater than 0, or {FROM_MODE} if only how fast it swings is known",
            word_or(FROM_MODE, _springs(LINEAR, TURNING)), lambda _: FROM_MODE, some,
        ),
        Question(
            "damping",
            f"Damping of each, N s/m or N m s/rad, at least 0, or {FROM_RATIO} if only the swing's ratio is known",
            word_or(FROM_RATIO, _springs(LINEAR_DAMPING, TURNING_DAMPING)), lambda _: FROM_RATIO, some,
        ),
        Question(
            "frequency", "Frequency of its swing, the arm held, Hz, up to 1000", one(FREQUENCY), proposed,
            lambda known: some(known) and known["stiffness"] is None,
        ),
        Question(
            "ratio", "Damping ratio of that swing, 0 to 0.99", one(RATIO), lambda _: "0.02",
            lambda known: some(known) and known["damping"] is None,
        ),
    ]  # fmt: skip


def _of_plane(name: str, count: str) -> list[Question]:
    """A planar machine; `count`: of its links, as proposed."""

    def links(known: Mapping[str, Any]) -> int:
        return known["links"]

    def rods(known: Mapping[str, Any]) -> str:
        return ",".join(f"{m * x**2 / 12:.6g}" for m, x in zip(known["masses"], known["lengths"], strict=True))

    return [
        Question("name", "Name of the machine", _name, lambda _: name),
        Question("links", f"Number of links with a driven joint, {LINKS[0]} to {LINKS[1]}", _count, lambda _: count),
        Question(
            "lengths", "Lengths of the links, m, greater than 0", several(LENGTH, links),
            lambda known: ",".join(f"{2 * 0.6**k:.3g}" for k in range(known["links"])),
        ),
        Question(
            "masses", "Masses of the links, kg, greater than 0", several(MASS, links),
            lambda known: ",".join(f"{400 * x:.3g}" for x in known["lengths"]),
        ),
        Question(
            "inertias", "Inertias of the links about their centres of mass, kg m², proposed as slender rods",
            several(INERTIA, links), rods,
        ),
        Question(
            "limits",
            f"Joint limits LO,HI;LO,HI…, rad, relative to the body before, each from -12.5 to 12.5, or {FREE}",
            word_or(FREE, _limits), lambda _: FREE,
        ),
        Question(
            "base_length", "Height of the first joint above the ground point, m, at least 0", one(LENGTH_OR_ZERO),
            lambda _: "0.5",
        ),
        Question(
            "base_mass", "Mass of the base, kg, greater than 0", one(MASS),
            lambda known: f"{5 * sum(known['masses']):.3g}",
        ),
        Question(
            "base_inertia", "Inertia of the base about its centre of mass, kg m²", one(INERTIA),
            lambda known: f"{known['base_mass'] * (known['lengths'][0] / 4) ** 2:.6g}",
        ),
        *_of_ground(",".join(PLANAR), PLANAR, 1, lambda known: known["base_length"] + sum(known["lengths"])),
    ]  # fmt: skip


def _links_given(options: Mapping[str, Any]) -> str:
    """How many links those options tell of that have a number for each; 2 where none does."""
    given = (options[word] for word in ("lengths", "masses", "inertias") if options[word] is not None)
    count = len(numbers(next(given, "")))
    return str(count if LINKS[0] <= count <= LINKS[1] else LINKS[0])


def answers(questions: list[Question], options: Mapping[str, Any], *, ask: bool) -> dict[str, Any]:
    """Every answer: the option's, else what is typed (`ask`), else the proposal. Faulty options come first."""
    if ask:
        answers(questions, options, ask=False)
    known, faults = dict[str, Any](), list[Fault]()
    for question in questions:
        if not question.wanted(known):
            known[question.name] = None
            if options.get(question.name) is not None:
                sentence = "is told already by the other options"
                faults.append(Fault(_spelt(question.name), sentence, typed(options[question.name])))
            continue
        given, proposal = options.get(question.name), question.proposal(known)
        if given is not None or not ask:
            try:
                known[question.name] = question.read(proposal if given is None else given, known)
            except ValueError as error:
                faults.append(Fault(_spelt(question.name), str(error), None if given is None else typed(given)))
                # What the later ones are checked with.
                known[question.name] = question.read(proposal, known)
            continue

        def read(text: str, question: Question = question) -> Any:
            try:
                return (question.read(text, known),)
            except ValueError as error:
                raise click.BadParameter(str(error)) from None

        try:
            known[question.name] = click.prompt(question.text, default=proposal, value_proc=read, err=True)[0]
        except click.Abort as abort:
            # Ctrl-C ends the command; where no more can be typed it is told what to do instead.
            if not isinstance(abort.__context__, EOFError):
                raise
            asked = f"{question.text!r} has no answer, for the input ended"
            raise InputError(f"new: {asked}; {_spelt(question.name)} gives it, --yes takes what is proposed") from None
    raise_if_any(InputError, "new", faults)
    return known


def _spelt(name: str) -> str:
    return f"--{name.replace('_', '-')}"


@click.command("new", short_help="A commented machine file, from a few answers or a robot file.")
@argument("file", "log", required=False)
@value("--from", "ROBOT", "A URDF or MJCF file to write the machine file around.")
@value("--out", "FILE", "The file to write, as FILE (the machine's name with .toml by default).")
@option("--yes", is_flag=True, help="Ask nothing: what no option says is proposed.")
@option("--force", is_flag=True, help="Write over a file that is there.")
@value("--name", "NAME", "Of the machine.")
@value("--links", "N", "Number of links, 2 to 8.")
@value("--lengths", "A,B,…", "Of the links, m.")
@value("--masses", "A,B,…", "Of the links, kg.")
@value("--inertias", "A,B,…", "Of the links about their centres of mass, kg m² (slender rods by default).")
@value("--limits", f"LO,HI;LO,HI…|{FREE}", "Of the joints, rad, relative to the body before.")
@value("--base-length", "H", "Height of the first joint above the ground point, m.")
@value("--base-mass", "M", "Of the base, kg.")
@value("--base-inertia", "I", "Of the base about its centre of mass, kg m².")
@value("--gives", "x,y,rotation", f"Directions in which the base gives; of a robot file some of {','.join(SPATIAL)}.")
@value("--stiffness", f"A,B,…|{FROM_MODE}", "Of these directions, N/m and N m/rad; or from how it swings.")
@value("--damping", f"A,B,…|{FROM_RATIO}", "Of these directions, N s/m and N m s/rad; or from how it swings.")
@value("--frequency", "HZ", "Of the slowest swing with the arm held, from which stiffnesses follow.")
@value("--ratio", "ZETA", "Damping ratio of that swing, from which dampers follow.")
@value(
    "--actuated",
    "A,B,…",
    "Of a robot file: joints that the controller moves (all on the way to the end-point with "
    "room between their limits). In double quotes what has a comma.",
)
@value(
    "--tip",
    "LINK",
    "Of a robot file: the link, or site, at the end-point (of the longest chain: a tool's frame, or before a hand).",
)
@JSON
def new_command(as_json: bool, file: str | None, out: str | None, yes: bool, force: bool, **options: Any) -> None:
    """Write a commented machine FILE: a planar one by a few answers, or with --from one around a robot file.

    Each question has an option, for scripts; --yes asks nothing. What is written can be read, checked and evaluated.
    """
    robot, end = options.pop("from"), ""
    if file is not None and out is not None:
        raise InputError("new: give the file to write once", [Fault("--out", "is given as FILE, too", out)])
    target = file or out
    check_output("FILE", target, (".toml",))
    _refuse_existing(target, force)
    stem = None if target is None else Path(target).stem
    if robot is None:
        alone = [Fault(f"--{word}", "goes with --from", options[word]) for word in ("actuated", "tip") if options[word]]
        raise_if_any(InputError, "new", alone)
        questions = _of_plane(stem or "machine", _links_given(options))
        known = answers(questions, options, ask=not yes)
        path = target or _file_name(known["name"])
        _refuse_existing(path, force)
        made = _planar(known, questions, options)
    else:
        from flexopt.study.new_files.overlay import overlay_file  # noqa: PLC0415
        from flexopt.study.new_files.robot_chain import read_chain  # noqa: PLC0415

        own = {q.name for q in _of_plane("", "")} - {"name", "gives", "stiffness", "damping", "frequency", "ratio"}
        planar = [Fault(_spelt(word), "goes with a planar machine, without --from", options[word])
                  for word in sorted(own) if options[word] is not None]  # fmt: skip
        raise_if_any(InputError, "new", planar)
        actuated = None if options["actuated"] is None else of_option_list(options["actuated"])
        chain = read_chain(Path(robot), options["tip"], actuated)
        if chain.hand or chain.chosen:
            place = "beside" if chain.chosen else "behind"
            stands = "stands" if len(chain.hand) == 1 else "stand"
            still = f"{counted(len(chain.hand), 'joint')} {place} it, as of a hand, {stands} still"
            told = [chain.chosen, still if chain.hand else ""]
            where = f"site {chain.site} on link {chain.end}" if chain.site else f"link {chain.end}"
            why = "; ".join(filter(None, told))
            end = f"The end-point is {where}: {why}. --tip names another."
        based = chain.floats or not chain.sprung
        questions = [
            Question("name", "Name of the machine", _name, lambda _: stem or chain.name),
            *_of_ground(chain.gives if based else NONE, SPATIAL, 1 if based else 0, lambda _: chain.reach),
        ]
        known = answers(questions, options, ask=not yes)
        path = target or _file_name(known["name"])
        _refuse_existing(path, force)
        ground = _ground(known, _proposed(known, questions, options), alone=chain.sprung)
        made = overlay_file(chain, known["name"], Path(path).parent, ground)
    write_output("FILE", path, lambda: write_file(path, made.text))
    posture = ",".join(f"{x:g}" for x in made.posture)
    shown = shlex.quote(path)
    steps = [f"flexopt check {shown}", f"flexopt evaluate {shown} --posture {posture}"]
    if as_json:
        print_json({"file": path, "machine": made.machine.name, "joints": list(made.machine.joints),
                    "posture": list(made.posture), "next": steps, "provenance": provenance(made.machine)})  # fmt: skip
        return
    say(f"{path}: {made.machine!r}")
    for sentence in filter(None, (end, made.held and f"In the machine {made.held}.")):
        say(sentence)
    say("Next: fill in what is marked as proposed; then")
    say("\n".join(f"  {step}" for step in steps))


def _planar(known: Mapping[str, Any], questions: list[Question], options: Mapping[str, Any]) -> NewMachine:
    """The machine of these answers."""
    from flexopt.study.new_files.machine import planar_file  # noqa: PLC0415  (only this command needs it)

    given = {word: known[word] for word in ("name", "lengths", "masses", "limits", "base_length", "base_mass")}
    proposed = _proposed(known, questions, options)
    given |= {word: None if word in proposed else known[word] for word in ("inertias", "base_inertia")}
    return planar_file(ground=_ground(known, proposed), **given)


def _ground(known: Mapping[str, Any], proposed: set[str], *, alone: bool = False) -> Ground:
    from flexopt.study.new_files.machine import Ground  # noqa: PLC0415

    words = ("gives", "stiffness", "damping", "frequency", "ratio")
    given = {word: known[word] for word in words if known[word] is not None}
    return Ground(alone=alone, proposed=tuple(word for word in ("frequency", "ratio") if word in proposed), **given)


def _proposed(known: Mapping[str, Any], questions: list[Question], options: Mapping[str, Any]) -> set[str]:
    """Which answers are proposals that nobody touched, and are called so in the file."""
    open_ones = [q for q in questions if options.get(q.name) is None and known[q.name] is not None]
    return {q.name for q in open_ones if entries_or_one(known[q.name]) == numbers(q.proposal(known))}


def _file_name(name: str) -> str:
    """A file for a machine of that name."""
    return (re.sub(r"[^\w.-]+", "-", name).strip("-.") or "machine") + ".toml"


def _refuse_existing(path: str | None, force: bool) -> None:
    if path is not None and not force and Path(path).exists():
        raise InputError(f"new: FILE = {path!r}: is there already; --force writes over it")
