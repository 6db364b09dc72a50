"""The FMU of `flexopt export MACHINE --fmu PATH`: its options, and what they do."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from flexopt.cli.common import BASE, ELBOW, END_POINT, option, option_names, print_json, read, say, warnings_to_stderr
from flexopt.cli.simulation import simulate_arguments
from flexopt.errors import InputError
from flexopt.model import load

_OPTIONS = (
    option(
        "--fmu", metavar="PATH", help="Write an FMU of the closed loop instead: .fmu, its reference trajectory beside."
    ),
    option("--fmi", metavar="2.0|3.0", help="With --fmu: version of FMI (2.0 by default)."),
    option(
        "--kind", metavar="co-simulation|model-exchange", help="With --fmu: who integrates (co-simulation by default)."
    ),
    option("--posture", metavar="A,B,…", help="With --fmu: actuated joints about which to work, rad or m."),
    END_POINT,
    ELBOW,
    BASE,
    option("--feedback", metavar="pd|pid|robust|none", help="With --fmu, as of simulate."),
    option("--kp", metavar="KP", help="With --fmu, as of simulate."),
    option("--kv", metavar="KV", help="With --fmu, as of simulate."),
    option("--ki", metavar="KI", help="With --fmu, as of simulate."),
    option("--integral-limit", metavar="N", help="With --fmu, as of simulate."),
    option("--duration", metavar="S", help="With --fmu: of the reference trajectory, s."),
    option("--rate", metavar="HZ", help="With --fmu: sampling rate (200 by default)."),
    option("--continuous", is_flag=True, help="With --fmu: a continuous controller."),
    option("--offset", metavar="A,B,…", help="With --fmu: displacement of the joints at the start, rad or m."),
    option("--integrator", metavar="rk4|dop853|gauss", help="With --fmu: integration method."),
    option("--substeps", metavar="N", help="With --fmu: integration steps in a sample."),
    option("--gravity", is_flag=True, help="With --fmu: the weight acts."),
    option("--uncompensated", is_flag=True, help="With --fmu, as of simulate."),
    option("--nullspace-damping", metavar="C", help="With --fmu, as of simulate."),
    option("--sensor", metavar="NAME=VALUE", multiple=True, help="With --fmu, as of simulate."),
    option("--actuator", metavar="NAME=VALUE[,…]", multiple=True, help="With --fmu, as of simulate."),
)


# What `simulate` alone offers: the noise of an FMU comes in through its inputs.
_OF_SIMULATE: dict[str, Any] = {"seed": None}


def fmu_options(command: Callable[..., None]) -> Callable[..., None]:
    """The options of an FMU but --control and --gain, which `export` has."""
    for each in reversed(_OPTIONS):
        command = each(command)
    return command


def write_fmu(machine: str, options: dict[str, Any], as_json: bool) -> None:
    """Write the FMU that `options` (with `control` and `gain`) ask for, and say what was written."""
    from flexopt.export.fmu import export_fmu  # noqa: PLC0415  (only this command needs it)

    loaded, given = read(load, machine), simulate_arguments(_OF_SIMULATE | options)
    if "posture" not in given and "end_point" not in given:
        raise InputError("export: an FMU needs --posture or --end-point")
    named = {"version": options["fmi"], "kind": options["kind"]}
    given |= {name: value for name, value in named.items() if value is not None}
    with option_names(options | {"path": options["fmu"], "version": options["fmi"]}), warnings_to_stderr(as_json):
        report = export_fmu(loaded, options["fmu"], **given)
    if as_json:
        print_json(report.to_dict())
    else:
        say(repr(report))
