"""`flexopt export` and `flexopt verify`."""

from __future__ import annotations

import sys
from typing import Any

import click

from flexopt.cli.common import (
    CONTROL,
    FAILED,
    GAIN,
    JSON,
    check_folder,
    number,
    option,
    option_names,
    print_json,
    progress_bar,
    read,
    say,
    warnings_to_stderr,
    whole,
)
from flexopt.cli.fmu import fmu_options, write_fmu
from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.model import load


class _WithParts(click.Command):
    """Its help names the parts of a bundle."""

    def format_help_text(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Fill in the parts where they are asked for: they stand on everything that is exported."""
        from flexopt.export import PARTS  # noqa: PLC0415  (only this help needs it)

        named = ", ".join(f"{name} ({part.title})" for name, part in PARTS.items())
        self.help = (self.help or "").replace("{parts}", named)
        super().format_help_text(ctx, formatter)


@click.command("export", cls=_WithParts, short_help="C for the machine's controller, or an FMU of its loop.")
@click.argument("machine")
@option("--out", metavar="DIR", help="Folder to write; one that exists is replaced if it is an unchanged bundle.")
@option("--parts", metavar="A,B,…", help="Some of those named above; by default all that the machine allows.")
@option("--real", metavar="double|float", help="Precision of every computation (double by default).")
@CONTROL
@GAIN
@option("--baked", is_flag=True, help="The machine's parameters as constants.")
@option("--singularity-margin-deg", metavar="DEG", help="Distance from singular postures (1 by default).")
@option(
    "--limit-allowance-deg", metavar="DEG", help="How far beyond its limits a hinge may be measured (5 by default)."
)
@option("--limit-allowance-m", metavar="M", help="The same of a slide (0.05 by default).")
@option("--prefix", metavar="NAME", help="Of every C name (from the machine's name by default).")
@option("--overwrite", is_flag=True, help="Replace a bundle of which files were changed by hand, too.")
@fmu_options
@JSON
def export_command(as_json: bool, machine: str, out: str | None, **options: Any) -> None:
    """C for the controller of MACHINE (a name or a file): a folder that compiles and explains itself.

    Parts: {parts}. With --fmu, an FMU of the closed loop instead.
    """
    _check_kind(options | {"out": out})
    if options["fmu"] is not None:
        write_fmu(machine, options, as_json)
        return
    from flexopt.export import export_c  # noqa: PLC0415  (only this command needs it)

    loaded = read(load, machine)
    if out is None:
        raise InputError("export: --out DIR is missing: where shall the folder be written?")
    check_folder("--out", out)
    numbers = {name: options[name] for name in ("singularity_margin_deg", "limit_allowance_deg", "limit_allowance_m")}
    given: dict[str, Any] = {
        "parts": None if options["parts"] is None else [part.strip() for part in options["parts"].split(",")],
        "real": options["real"],
        "control": options["control"],
        "gain": None if options["gain"] is None else number(options["gain"]),
        **{name: None if value is None else number(value) for name, value in numbers.items()},
        "prefix": options["prefix"],
    }
    settings = {name: value for name, value in given.items() if value is not None}
    with option_names(options | {"folder": out}), warnings_to_stderr(as_json):
        report = export_c(loaded, out, baked=bool(options["baked"]), overwrite=bool(options["overwrite"]), **settings)
    if as_json:
        print_json(report.to_dict())
    else:
        say(repr(report))


def _check_kind(options: dict[str, Any]) -> None:
    """No option of the bundle with --fmu, none of the FMU without it."""
    of_bundle = ("out", "parts", "real", "baked", "singularity_margin_deg", "limit_allowance_deg", "limit_allowance_m",
                 "prefix", "overwrite")  # fmt: skip
    fmu = options["fmu"] is not None
    other = of_bundle if fmu else set(options) - {*of_bundle, "fmu", "control", "gain"}
    sentence = "does not go with --fmu" if fmu else "goes with --fmu only"
    faults = [
        Fault(f"--{name.replace('_', '-')}", sentence, "given" if value is True else repr(value))
        for name, value in options.items()
        if name in other and value not in (None, False, ())
    ]
    raise_if_any(InputError, "export", faults)


@click.command("verify", short_help="Examine exported C: numbers, compilers, processors.")
@click.argument("folder", metavar="DIR")
@option("--target", metavar="host|cortex-m4f|cortex-m7", help="One target (all by default).")
@option("--inputs", metavar="N", help="Random inputs for each function (1000 by default).")
@option("--fuzz-calls", metavar="N", help="Faulty calls for each function (10000 by default).")
@JSON
def verify_command(as_json: bool, folder: str, **options: Any) -> None:
    """Examine the bundle in DIR: compilers, Python's numbers, sanitizers, emulated processors, objects, MISRA.

    Writes verification/report.html and report.json inside it. Missing tools are named. Exit code 3 where a check
    failed, or where the target asked for could not be verified.
    """
    from flexopt.export import verify_bundle  # noqa: PLC0415  (only this command needs it)

    given: dict[str, Any] = {
        "target": options["target"],
        "inputs": whole(options["inputs"]),
        "fuzz_calls": whole(options["fuzz_calls"]),
    }
    settings = {name: value for name, value in given.items() if value is not None}
    with option_names(options), warnings_to_stderr(as_json), progress_bar("targets") as progress:
        result = verify_bundle(folder, progress=progress, **settings)
    if as_json:
        print_json(result.to_dict())
    else:
        say(f"{result!r}\n\nreport: {result.page}")
    if not result.passed or (options["target"] is not None and not result.complete):
        sys.exit(FAILED)
