"""Examples that stand below every command's help, by the command's name; machines and problems are shipped ones."""

from __future__ import annotations

import re
import shutil
import textwrap

from flexopt.cli.terminal import WIDTH_MIN

# An option and the space before its value.
OPTION = re.compile(r"(--\S+) (?!-)")
# What each is worth, briefly: lines of a terminal of 80 columns.
EXAMPLES: dict[str, tuple[str, ...]] = {
    "": ("flexopt evaluate excavator --posture 0.9929,-2.6306", "flexopt verdict article --loop kp=1e4 --loop kv=1e3"),
    "atlas": ("flexopt atlas excavator --plot atlas.png", "flexopt atlas excavator --cells 64,64 --json"),
    "check": ("flexopt check excavator", "flexopt check article"),
    "compare": (
        "flexopt compare before.json after.json --plot beside.png",
        "flexopt compare a.json b.json c.json --json",
    ),
    "completion": ('eval "$(flexopt completion bash)"', "flexopt completion fish"),
    "doctor": ("flexopt doctor",),
    "evaluate": (
        "flexopt evaluate excavator --posture 0.9929,-2.6306",
        "flexopt evaluate excavator --end-point 0,1.6 --elbow up --json",
    ),
    "explain": (
        "flexopt explain excavator --posture 0.9929,-2.6306 --plot why.png",
        "flexopt explain truck-crane --posture 0.3,0.4,-1.2,0.5 --loop default",
    ),
    "explore": (
        "flexopt explore excavator --posture 1,-2 --out excavator.html",
        "flexopt explore truck-crane --gravity --out crane.html",
        "flexopt explore article --out article.html",
    ),
    "export": (
        "flexopt export excavator --out bundle --parts controller,measures",
        "flexopt export excavator --fmu loop.fmu --posture 0.0448,-2.0499",
    ),
    "identify": (
        "flexopt identify excavator swing.csv --posture 0.5,-1.2",
        "flexopt identify slewing-excavator swing.csv --unknown stiffness,damping",
    ),
    "map": (
        "flexopt map excavator --plot map.png --out map.nc",
        "flexopt map excavator --posture 0.0448,-2.0499 --vary kp=1e3,1e6 --vary kv=1,1e4",
    ),
    "new": ("flexopt new digger.toml", "flexopt new --from robot.urdf --out machine.toml --yes"),
    "region": (
        "flexopt region excavator --posture 0.0448,-2.0499 --loop kp=1e4 --loop kv=1e3 --ranges stiffness=0.5,2",
    ),
    "report": (
        "flexopt report article --loop default --out report",
        "flexopt report excavator --end-point 0,1.6 --base 0 --pdf report.pdf",
    ),
    "reproduce": ("flexopt reproduce --out report", "flexopt reproduce --out report --figures pdf"),
    "schema": ("flexopt schema machine --out machine.json", "flexopt schema problem --json"),
    "select": ("flexopt select excavator --end-point 0,1.6 --base 0", "flexopt select article --plot choice.png"),
    "sensitivity": (
        "flexopt sensitivity excavator --posture 0.9929,-2.6306 --ranges payload.mass=0,500",
        "flexopt sensitivity excavator --posture 0.9929,-2.6306 --ranges payload.mass=0,500 --loop kp=1e4 --plot a.png",
    ),
    "study": (
        "flexopt study run excavator-study --out soils --workers 2",
        "flexopt study status soils",
        "flexopt study export soils --out soils.nc",
    ),
    "simulate": (
        "flexopt simulate excavator --posture 0.0448,-2.0499 --kp 1e5 --kv 2e3",
        "flexopt simulate article-a --plot run.png",
    ),
    "verdict": (
        "flexopt verdict article --loop kp=1e4 --loop kv=1e3",
        "flexopt verdict article --loop default --ranges stiffness=0.5,2 --html verdict.html",
    ),
    "verify": ("flexopt verify bundle", "flexopt verify bundle --inputs 100"),
}


def epilog(command: str) -> str:
    """The examples of a command, as wide as the terminal is; the first letter keeps click from filling their lines."""
    width = max(WIDTH_MIN, shutil.get_terminal_size().columns) - 8
    wrapper = textwrap.TextWrapper(width, break_long_words=False, break_on_hyphens=False)
    # An option stays on one line with its value.
    kept = (OPTION.sub("\\1\u00a0", line) for line in EXAMPLES[command])
    folded = (" \\\n      ".join(wrapper.wrap(line)).replace("\u00a0", " ") for line in kept)
    return "\n".join(["\b", "Examples:", *(f"  {line}" for line in folded)])
