"""`flexopt simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from flexopt.cli.common import (
    BASE,
    CONTROL,
    ELBOW,
    END_POINT,
    GAIN,
    JSON,
    PICTURES,
    check_output,
    number,
    numbers,
    option,
    option_names,
    placement,
    print_json,
    read,
    say,
    warnings_to_stderr,
    whole,
    write_output,
)
from flexopt.errors import InputError
from flexopt.model import load_simulated
from flexopt.model.simulation import Experiment
from flexopt.simulation import run_experiment, simulate

FILMS = (".gif", ".html")
# Arguments of `flexopt.simulate` that are no options of the command.
ELSEWHERE = ("base_path", "target_path", "baked")


@click.command("simulate", short_help="The nonlinear closed loop, run and judged.")
@click.argument("machine")
@option("--posture", metavar="A,B,…", help="Actuated joints about which to work, rad or m.")
@END_POINT
@ELBOW
@BASE
@CONTROL
@option("--feedback", metavar="pd|pid|robust|none", help="Task-space feedback (pd by default); robust attains ε_max.")
@option("--kp", metavar="KP", help="Gain on the end-point error, one number or one for each task row (1e5 by default).")
@option("--kv", metavar="KV", help="Gain on its rate (2e3 by default).")
@option("--ki", metavar="KI", help="With pid: gain on its integral.")
@option("--integral-limit", metavar="N", help="With pid: largest contribution of the integral on each axis.")
@GAIN
@option("--duration", metavar="S", help="Seconds (10 by default).")
@option("--rate", metavar="HZ", help="Sampling rate (200 by default).")
@option("--continuous", is_flag=True, help="A continuous controller instead of a sampled one that holds its command.")
@option(
    "--offset", metavar="A,B,…", help="Displacement of the joints at the start, rad or m (+0.05, −0.05, … by default)."
)
@option("--integrator", metavar="rk4|dop853|gauss", help="Integration method (rk4, the article's, by default).")
@option("--substeps", metavar="N", help="Integration steps in a sample.")
@option("--gravity", is_flag=True, help="The weight acts; the command carries the arm's.")
@option("--uncompensated", is_flag=True, help="With --gravity: the command does not carry the arm's weight.")
@option("--nullspace-damping", metavar="C", help="Damping of a redundant arm's self-motion, N m s/rad or N s/m.")
@option(
    "--sensor",
    metavar="NAME=VALUE",
    multiple=True,
    help="Of the measurement, may be repeated: noise, rate_noise, resolution, rate_resolution, m and m/s; delay, s.",
)
@option(
    "--actuator",
    metavar="NAME=VALUE[,…]",
    multiple=True,
    help="Of the drives, may be repeated: torque_limit, dead_band, bandwidth_hz, rate_limit, one number or one for "
    "each joint; levers=each or levers=uniform; servo_gain.",
)
@option("--seed", metavar="N", help="Seed of the measurement noise.")
@option("--out", metavar="PATH", help="Write every sample: .nc or .csv.")
@option("--plot", metavar="PATH", help="Draw the run: .png, .svg or .pdf.")
@option("--animate", metavar="PATH", help="Draw the moving machine: .gif or .html.")
@JSON
def simulate_command(as_json: bool, machine: str, **options: Any) -> None:
    """Nonlinear closed loop of MACHINE: a machine with --posture or --end-point, or an experiment (name or file).

    A driven base and a moving target (base_path, target_path), and baked, code for one set of numbers alone, are given
    in an experiment file's [simulation] or in Python (flexopt.simulate).
    """
    for name, suffixes in (("out", (".nc", ".csv")), ("plot", PICTURES), ("animate", FILMS)):
        check_output(f"--{name}", options[name], suffixes)
    loaded = read(load_simulated, machine)
    given = simulate_arguments(options)
    if isinstance(loaded, Experiment):
        # Given entries of a table take the place of the file's, the others stay.
        for name in {"sensor", "actuator"} & given.keys():
            given[name] = getattr(loaded.simulation, name).model_dump(exclude_unset=True) | given[name]
    with option_names(options), warnings_to_stderr(as_json):
        if isinstance(loaded, Experiment):
            result = run_experiment(loaded, **given)
        else:
            if "posture" not in given and "end_point" not in given:
                raise InputError("simulate: a machine needs --posture or --end-point; an experiment brings its own")
            result = simulate(loaded, **given)
    out, plot, film = options["out"], options["plot"], options["animate"]
    if out is not None:
        save = result.to_netcdf if Path(out).suffix.lower() == ".nc" else result.to_csv
        write_output("--out", out, lambda: save(out))
    if plot is not None:
        write_output("--plot", plot, lambda: result.plot(plot))
    if film is not None:
        write_output("--animate", film, lambda: result.animate(film))
    files = {name: path for name, path in (("data", out), ("plot", plot), ("animation", film)) if path is not None}
    if as_json:
        print_json(result.to_dict() | {"files": files})
    else:
        say("\n".join([repr(result), *(f"{what}: {path}" for what, path in files.items())]))


def simulate_arguments(options: dict[str, Any]) -> dict[str, Any]:
    """Arguments of `flexopt.simulate` from the options that were given."""
    lists = {name: numbers(options[name]) for name in ("posture", "end_point", "offset", "kp", "kv", "ki")}
    names = ("gain", "duration", "rate", "integral_limit", "nullspace_damping")
    single = {name: None if options[name] is None else number(options[name]) for name in names}
    words = {name: options[name] for name in ("elbow", "control", "feedback", "integrator")}
    flags = {"gravity": True if options["gravity"] else None, "hold": False if options["continuous"] else None}
    flags["gravity_compensation"] = False if options["uncompensated"] else None
    tables = {name: table(f"--{name}", options[name]) for name in ("sensor", "actuator")}
    counts = {"substeps": whole(options["substeps"]), "seed": whole(options["seed"])}
    everything = lists | single | words | flags | tables | counts | {"base": placement(options["base"])}
    return {name: value for name, value in everything.items() if value is not None}


def table(name: str, entries: tuple[str, ...]) -> dict[str, Any] | None:
    """`("delay=0.02", "noise=1e-3")` as a table, numbers as numbers; None where nothing was given."""
    found: dict[str, Any] = {}
    for entry in entries:
        key, equals, value = entry.partition("=")
        if not equals or not key.strip():
            raise InputError(f"{name} = {entry!r}: must be NAME=VALUE")
        if key.strip() in found:
            raise InputError(f"{name} = {entry!r}: {key.strip()} is given twice")
        found[key.strip()] = placement(value)
    return found or None
