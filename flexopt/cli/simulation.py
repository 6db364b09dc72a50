"""`flexopt simulate`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import click

from flexopt.cli.common import (
    CONTROL,
    GAIN,
    JSON,
    Decorator,
    check_output,
    check_picture,
    given,
    number,
    numbers,
    of_picture,
    option,
    print_json,
    read,
    say,
    table,
    together,
    value,
    whole,
    working,
    write_output,
    write_result,
)
from flexopt.cli.completing import argument
from flexopt.cli.judging import LOOP, real_loop
from flexopt.cli.postures import elbow_faults
from flexopt.cli.terminal import VOICE
from flexopt.errors import InputError, raise_if_any
from flexopt.model import AnyMachine, load_simulated
from flexopt.model.simulation import Actuator, Experiment, Sensor, SimulationOptions
from flexopt.model.simulation_faults import own_loop
from flexopt.simulation import run_experiment, simulate

FILMS = (".gif", ".html")
# Fields of `SimulationOptions`, what stands for their values where their types do not say, and what they do.
TEXTS = {
    "posture": ("A,B,…", "Actuated joints about which to work, rad or m."),
    "end_point": ("X,Y[,Z]", "Target of the end-point of an arm of two joints, inertial frame, m."),
    "elbow": ("", "With --end-point: which of its two postures; up (by default): the last joint is negative."),
    "base": ("X[,Y,YAW]", "Placement of the base, m and rad."),
    "feedback": ("", "Task-space feedback (pd by default); robust attains ε_max."),
    "kp": ("KP", "Gain on the end-point error, one number or one for each task row (1e5 by default)."),
    "kv": ("KV", "Gain on its rate (2e3 by default)."),
    "ki": ("KI", "With pid: gain on its integral."),
    "integral_limit": ("N", "With pid: largest contribution of the integral on each axis."),
    "duration": ("S", "Seconds (10 by default)."),
    "rate": ("HZ", "Sampling rate (200 by default)."),
    "hold": ("", "A continuous controller instead of a sampled one that holds its command."),
    "offset": ("A,B,…", "Displacement of the joints at the start, rad or m (+0.05, −0.05, … by default)."),
    "integrator": ("", "Integration method (rk4, the article's, by default)."),
    "substeps": ("N", "Integration steps in a sample; one more where it measures within."),
    "gravity": ("", "The weight acts; the command carries the arm's."),
    "gravity_compensation": ("", "With --gravity: the command does not carry the arm's weight."),
    "nullspace_damping": ("C", "Damping of a redundant arm's self-motion, N m s/rad or N s/m."),
    "sensor": (
        "NAME=VALUE",
        "Of the measurement, may be repeated: noise, rate_noise, resolution, rate_resolution, m and m/s; delay, s; "
        "filter_hz.",
    ),
    "actuator": (
        "NAME=VALUE[,…]",
        "Of the drives, may be repeated: torque_limit, dead_band, bandwidth_hz, rate_limit, one number or one for each "
        "joint; levers=each or levers=uniform; servo_gain.",
    ),
    "seed": ("N", "Seed of the measurement noise."),
}
# Of a machine without a [loop], and of one whose [loop] other options displace.
UNSAID = "no gains are given, so those of the reproduced article are taken; {instead}"
PROPOSED, OWN = "--loop default takes what suits the machine", "--kp and --kv take others"
BESIDE = (
    "options of the loop stand in place of the file's whole [loop], rate, dead time and filter included{gains}; "
    "--loop KEY=VALUE replaces one of its keys"
)
# Fields whose option says no, and its name.
NEGATED = {"hold": "continuous", "gravity_compensation": "uncompensated"}
# Arguments of `flexopt.simulate` that are no options of the command.
ELSEWHERE = ("base_path", "target_path", "baked")
READERS: dict[Any, Callable[[str], Any]] = {float: number, int: whole, tuple: numbers}


def loop_options(lead: str, *fields: str) -> Decorator:
    """Options for these fields of `SimulationOptions`, by their types; in the help of each, `lead` says with what."""
    return together(*(_loop_option(lead, name) for name in fields))


def _loop_option(lead: str, name: str) -> Decorator:
    metavar, text = TEXTS[name]
    if lead:
        also = text.startswith("With ")
        whole_lead = f"{lead} or --loop" if name in ("posture", "base") else lead
        text = f"{lead} and {text.removeprefix('With ')}" if also else f"{whole_lead}: {text[0].lower()}{text[1:]}"
    word = f"--{NEGATED.get(name, name).replace('_', '-')}"
    kind = type_of(SimulationOptions.model_fields[name].annotation)
    if kind is bool:
        return option(word, is_flag=True, help=text)
    if kind in (Sensor, Actuator):
        return value(word, metavar, text, multiple=True)
    return value(word, metavar or "|".join(get_args(kind)), text, READERS.get(get_origin(kind) or kind, str))


def type_of(annotation: Any) -> Any:
    """The type behind `Annotated[…]` and `… | None`."""
    while get_origin(annotation) in (Annotated, Union, UnionType):
        annotation = get_args(annotation)[0]
    return annotation


@click.command("simulate", short_help="The nonlinear closed loop, run and judged.")
@argument("machine", "machine or problem")
@loop_options("", *TEXTS)
@CONTROL
@GAIN
@LOOP
@value("--out", "PATH", "Write every sample, .nc or .csv, or what --json prints, .json.")
@of_picture("Draw the run: .png, .svg or .pdf.")
@value("--animate", "PATH", "Draw the moving machine, on the ground of --theme: .gif or .html.")
@JSON
def simulate_command(as_json: bool, machine: str, **options: Any) -> None:
    """Nonlinear closed loop of MACHINE: a machine with --posture or --end-point, or an experiment (name or file).

    Without --kp, --kv and other options of the loop the file's [loop] is run, if it has one.

    A driven base and a moving target (base_path, target_path), and baked, code for one set of numbers alone, are given
    in an experiment file's [simulation] or in Python (flexopt.simulate).
    """
    for name, suffixes in (("out", (".nc", ".csv", ".json")), ("animate", FILMS)):
        check_output(f"--{name}", options[name], suffixes)
    plot = options["plot"]
    asked_theme = given(options, "theme")
    draw = check_picture(options, film=options["animate"] is not None)
    loaded = read(load_simulated, machine)
    entries = options.pop("loop")
    asked = simulate_arguments(options)
    if isinstance(loaded, Experiment):
        # Given entries of a table take the place of the file's, the others stay.
        for name in {"sensor", "actuator"} & asked.keys():
            asked[name] = getattr(loaded.simulation, name).model_dump(exclude_unset=True) | asked[name]
    with working(options, as_json):
        if isinstance(loaded, Experiment):
            own = loaded.loop or loaded.loaded_machine.loop
            result = run_experiment(loaded, loop=real_loop(own, entries), **asked)
        else:
            if "posture" not in asked and "end_point" not in asked:
                raise InputError("simulate: a machine needs --posture or --end-point; an experiment brings its own")
            raise_if_any(InputError, "simulate", elbow_faults(loaded, options, options["posture"]))
            real = real_loop(loaded.loop, entries)
            tell_gains(loaded, real, asked)
            result = simulate(loaded, loop=real, **asked)
    out, film = options["out"], options["animate"]
    if out is not None:
        write_result(result, out)
    draw(result)
    if film is not None:
        write_output("--animate", film, lambda: result.animate(film, **asked_theme))
    files = {name: path for name, path in (("data", out), ("plot", plot), ("animation", film)) if path is not None}
    if as_json:
        print_json(result.to_dict() | {"files": files})
    else:
        say("\n".join([repr(result), *(f"{what}: {path}" for what, path in files.items())]))


def tell_gains(machine: AnyMachine, real: Any, asked: Mapping[str, Any], sampled: bool = True) -> None:
    """Say whose loop and gains a run has that got none; `sampled`: the machine's own `[loop]` can be taken."""
    taken = real is not None or (sampled and own_loop(machine, asked) is not None)
    gained = bool({"kp", "kv", "feedback"} & asked.keys())
    if taken or VOICE.quiet or (gained and machine.loop is None):
        return
    beside = BESIDE.format(gains="" if gained else ", and the gains are those of the reproduced article")
    unsaid = UNSAID.format(instead=PROPOSED if sampled else OWN)
    say(f"flexopt: {unsaid if machine.loop is None else beside}", err=True)


def simulate_arguments(options: dict[str, Any]) -> dict[str, Any]:
    """Arguments of `flexopt.simulate` from the options that were given."""
    asked = given(options, *[name for name in SimulationOptions.model_fields if name in options])
    asked |= {name: table(f"--{name}", entries) for name, entries in asked.items() if name in ("sensor", "actuator")}
    asked |= {name: False for name, word in NEGATED.items() if options[word]}
    return {name: value for name, value in asked.items() if value is not None}
