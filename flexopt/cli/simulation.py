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
    warnings_to_stderr,
    whole,
    write_output,
)
from flexopt.errors import InputError
from flexopt.model import Experiment, load_simulated
from flexopt.simulation import run_experiment, simulate

FILMS = (".gif", ".html")


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
@option("--seed", metavar="N", help="Seed of the measurement noise of an experiment file.")
@option("--out", metavar="PATH", help="Write every sample: .nc or .csv.")
@option("--plot", metavar="PATH", help="Draw the run: .png, .svg or .pdf.")
@option("--animate", metavar="PATH", help="Draw the moving machine: .gif or .html.")
@JSON
def simulate_command(as_json: bool, machine: str, **options: Any) -> None:
    """Nonlinear closed loop of MACHINE: a machine with --posture or --end-point, or an experiment (name or file)."""
    for name, suffixes in (("out", (".nc", ".csv")), ("plot", PICTURES), ("animate", FILMS)):
        check_output(f"--{name}", options[name], suffixes)
    loaded = read(load_simulated, machine)
    given = simulate_arguments(options)
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
        click.echo("\n".join([repr(result), *(f"{what}: {path}" for what, path in files.items())]))


def simulate_arguments(options: dict[str, Any]) -> dict[str, Any]:
    """Arguments of `flexopt.simulate` from the options that were given."""
    lists = {name: numbers(options[name]) for name in ("posture", "end_point", "offset", "kp", "kv", "ki")}
    single = {name: None if options[name] is None else number(options[name]) for name in ("gain", "duration", "rate")}
    words = {name: options[name] for name in ("elbow", "control", "feedback", "integrator")}
    flags = {"gravity": True if options["gravity"] else None, "hold": False if options["continuous"] else None}
    counts = {"substeps": whole(options["substeps"]), "seed": whole(options["seed"])}
    everything = lists | single | words | flags | counts | {"base": placement(options["base"])}
    return {name: value for name, value in everything.items() if value is not None}
