"""`flexopt completion`."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from flexopt.cli.common import JSON, print_json
from flexopt.cli.completing import SHELLS, argument
from flexopt.errors import Fault, InputError

VARIABLE = "_FLEXOPT_COMPLETE"


@click.command("completion", short_help="A script for the tab key: commands, machines, values.")
@argument("shell", metavar="|".join(SHELLS))
@JSON
def completion_command(as_json: bool, shell: str) -> None:
    """The script for a shell that completes commands, machines, problems and values with the tab key.

    Of bash, in ~/.bashrc: eval "$(flexopt completion bash)"; of zsh the same in ~/.zshrc; of fish: flexopt completion
    fish > ~/.config/fish/completions/flexopt.fish
    """
    kind = get_completion_class(shell) if shell in SHELLS else None
    if kind is None:
        sentence = f"must be {', '.join(SHELLS)}"
        raise InputError(f"completion: SHELL = {shell!r}: {sentence}", [Fault("SHELL", sentence, shell)])
    made = kind(click.get_current_context().find_root().command, {}, "flexopt", VARIABLE)
    # Not `source()`, which starts bash to ask for its version.
    script = made.source_template % made.source_vars()
    if as_json:
        print_json({"shell": shell, "script": script})
    else:
        click.echo(script)
