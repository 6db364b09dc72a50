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
    given,
    number,
    option,
    read,
    tell,
    value,
    whole,
    working,
)
from flexopt.cli.completing import argument
from flexopt.cli.fmu import fmu_options, write_fmu
from flexopt.cli.judging import LOOP, real_loop
from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.escapes import of_option_list
from flexopt.model import load

# Options of a bundle that an FMU has not.
OF_BUNDLE = (
    "out", "parts", "real", "baked", "singularity_margin_deg", "limit_allowance_deg", "limit_allowance_m", "prefix",
)  # fmt: skip
# What a bundle takes with a loop: where its margins are told.
OF_LOOP = ("loop", "posture", "base")


class _WithParts(click.Command):
    """Its help names the parts of a bundle."""

    def format_help_text(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Fill in the parts where they are asked for: they stand on everything that is exported."""
        from flexopt.export import PARTS  # noqa: PLC0415  (only this help needs it)

        named = ", ".join(f"{name} ({part.title})" for name, part in PARTS.items())
        self.help = (self.help or "").replace("{parts}", named)
        super().format_help_text(ctx, formatter)


@click.command("export", cls=_WithParts, short_help="C for the machine's controller, or an FMU of its loop.")
@argument("machine")
@value("--out", "DIR", "Folder to write; one that holds a bundle needs --overwrite.")
@value("--parts", "A,B,…", "Some of those named above; by default all that the machine allows.", of_option_list)
@value("--real", "double|float", "Precision of every computation (double by default).")
@CONTROL
@GAIN
@option("--baked", is_flag=True, help="The machine's parameters as constants.")
@value(
    "--singularity-margin-deg",
    "DEG",
    "Distance from singular postures (1 by default); with --real float measures, nullspace, margin keep 10 at least.",
    number,
)
@value("--limit-allowance-deg", "DEG", "How far beyond its limits a hinge may be measured (5 by default).", number)
@value("--limit-allowance-m", "M", "The same of a slide (0.05 by default).", number)
@value("--prefix", "NAME", "Of every C name (from the machine's name by default).")
@option("--overwrite", is_flag=True, help="Replace the bundle or the FMU that is there.")
@LOOP
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
    settings = given(
        options, *(name for name in OF_BUNDLE if name != "out"), "overwrite", "control", "gain", "posture", "base"
    )
    settings |= given({"loop": real_loop(loaded.loop, options["loop"])})
    with working(options | {"out": out}, as_json):
        report = export_c(loaded, out, **settings)
    tell(report, as_json=as_json)


def _check_kind(options: dict[str, Any]) -> None:
    """No option of the bundle with --fmu, none of the FMU without it."""
    fmu = options["fmu"] is not None
    other = OF_BUNDLE if fmu else set(options) - {*OF_BUNDLE, *OF_LOOP, "fmu", "overwrite", "control", "gain"}
    sentence = "does not go with --fmu" if fmu else "goes with --fmu only"
    faults = [
        Fault(f"--{name.replace('_', '-')}", sentence, "given" if value is True else repr(value))
        for name, value in options.items()
        if name in other and value not in (None, False, ())
    ]
    raise_if_any(InputError, "export", faults)


@click.command("verify", short_help="Build exported C here and compare it with Python.")
@argument("folder", metavar="DIR")
@value("--inputs", "N", "Random inputs for each function (1000 by default).", whole)
@JSON
def verify_command(as_json: bool, folder: str, **options: Any) -> None:
    """Build the bundle in DIR with this computer's C compiler, run its self-test, and compare it with Python.

    Writes verification/report.html and report.json inside it, check by check. Exit code 3 where a check failed or could
    not be made.
    """
    from flexopt.export import verify_bundle  # noqa: PLC0415  (only this command needs it)

    with working(options, as_json, "checks") as progress:
        result = verify_bundle(folder, progress=progress, **given(options))
    tell(result, f"\n\nreport: {result.page}", as_json=as_json)
    if not result.passed:
        sys.exit(FAILED)
