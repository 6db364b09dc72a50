"""The group of all commands, each imported when it is asked for, and how a command ends."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import sys
import time
from importlib import import_module
from pathlib import Path

import click

from flexopt.cli.common import ABORTED, OUTPUT_LOST, leave_with, print_json, say, warnings_to_stderr
from flexopt.cli.examples import epilog
from flexopt.cli.terminal import VOICE
from flexopt.errors import FlexoptError, InputError
from flexopt.foundation.documents import build_version, json_ready, package_version
from flexopt.foundation.escapes import TERMINAL

# Commands and their modules, imported when they are asked for: what one needs takes longest.
COMMANDS = {
    "evaluate": "analysis",
    "explore": "exploring",
    "select": "analysis",
    "simulate": "simulation",
    "atlas": "atlas",
    "identify": "identifying",
    "map": "studies",
    "new": "new",
    "verdict": "judging",
    "region": "judging",
    "report": "studies",
    "compare": "comparing",
    "reproduce": "studies",
    "explain": "explaining",
    "export": "bundles",
    "verify": "bundles",
    "check": "checking",
    "schema": "layouts",
    "completion": "shell",
    "study": "large_studies",
    "sensitivity": "large_studies",
    "doctor": "studies",
}


class _Commands(click.Group):
    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - as click has it
        """By name."""
        return sorted(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002 - as click has it
        """From its module."""
        if cmd_name not in COMMANDS:
            return None
        command: click.Command = getattr(import_module(f"flexopt.cli.{COMMANDS[cmd_name]}"), f"{cmd_name}_command")
        command.epilog = epilog(cmd_name)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """As click, but with the commands that are spelt like an unknown one, which not every version of it names."""
        if args[0] not in COMMANDS and not args[0].startswith("-") and not ctx.resilient_parsing:
            from difflib import get_close_matches  # noqa: PLC0415  (which only mistakes need)

            near = " or ".join(repr(name) for name in get_close_matches(args[0], COMMANDS))
            ctx.fail(f"No such command {args[0]!r}.{near and f' Did you mean {near}?'}")
        return super().resolve_command(ctx, args)


def _version(context: click.Context, _option: click.Parameter, asked: bool) -> None:
    """Print the version and the build."""
    if asked and not context.resilient_parsing:
        say(f"flexopt, version {build_version()}")
        context.exit()


@click.group(
    cls=_Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120},
    epilog=epilog(""),
)
@click.option(
    "--version", is_flag=True, is_eager=True, expose_value=False, callback=_version, help="Print version and build."
)
@click.option("-q", "--quiet", is_flag=True, help="No progress and no warnings: results and errors alone.")
@click.option("-v", "--verbose", is_flag=True, help="Versions, time, and where an error arose, on standard error.")
@click.option("--no-color", "no_colour", is_flag=True, help="No colours; as the environment's NO_COLOR.")
def cli(quiet: bool, verbose: bool, no_colour: bool) -> None:
    """Configurations of a machine on a compliant base in which end-point feedback does not excite the base.

    Options of all commands stand before the command: flexopt --quiet select …
    """
    if quiet and verbose:
        raise InputError("flexopt: --quiet and --verbose do not go together")
    VOICE.quiet, VOICE.verbose, VOICE.colour = quiet, verbose, not no_colour


def run(arguments: list[str] | None = None) -> None:
    """Run one command, of these arguments or of the process's own; leave by its exit code."""
    if sys.stderr is None:  # pyright: ignore[reportUnnecessaryComparison]  (closed when the process began)
        sys.stderr = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115
    try:
        if sys.stdout is None:  # pyright: ignore[reportUnnecessaryComparison]
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        _run(arguments)
    except OSError as error:
        _lose_output(error)


def _lose_output(error: OSError) -> None:
    """Say that a stream takes no more, and leave with 1; Python would say it again when it flushes at its end."""
    with contextlib.suppress(OSError):
        print(f"flexopt: output is lost: {error.strerror}", file=sys.stderr, flush=True)
    nothing = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        # Streams of tests and notebooks are no files.
        with contextlib.suppress(OSError, AttributeError, ValueError):
            os.dup2(nothing, stream.fileno())
    sys.exit(OUTPUT_LOST)


def _run(arguments: list[str] | None) -> None:
    given = (sys.argv[1:] if arguments is None else arguments) or ["--help"]
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=TERMINAL)  # Greek letters on a console that has none
    VOICE.quiet, VOICE.verbose, VOICE.colour = False, False, True
    VOICE.warned.clear()
    began = time.perf_counter()
    try:
        # What is computed when a result is shown may warn, too.
        with warnings_to_stderr("--json" in given):
            cli.main(args=given, prog_name="flexopt", standalone_mode=False)
    except click.exceptions.Exit as leave:
        sys.exit(leave.exit_code)
    except (click.Abort, KeyboardInterrupt):
        say("Aborted", err=True)
        sys.exit(ABORTED)
    except click.ClickException as error:
        _fail(InputError(error.format_message()), "--json" in given)
    except FlexoptError as error:
        _fail(error, "--json" in given)
    finally:
        if VOICE.verbose:
            versions = ", ".join(f"{name} {package_version(name)}" for name in ("casadi", "numpy"))
            took, python = time.perf_counter() - began, sys.version.split()[0]
            say(f"flexopt: {took:.2f} s; flexopt {build_version()}, {versions}, Python {python}", err=True)


def _fail(error: FlexoptError, as_json: bool) -> None:
    if as_json:
        print_json({"status": "failed", "converged": False, "error": json_ready(error.to_dict())})
    leave_with(error)
