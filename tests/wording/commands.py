"""Quick command lines by snapshot, and how they are run and masked."""

from __future__ import annotations

import io
import os
import platform
import re
import shlex
import warnings
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import numpy as np

from flexopt.cli import main
from flexopt.cli.commands import COMMANDS

FOLDER = Path(__file__).parent
EXCAVATOR = "excavator --posture 1,-2"
BUCKET = "boom-stick-bucket --posture -0.9,-1.2,-0.8"
CRANE = "truck-crane --posture 1.2,0.8,-0.9,1.5"
AT = "excavator --end-point 0,1.6 --base 0 --starts 1"
LOOP = "--loop kp=1e4 --loop kv=1e3"

# Commands run one after another in a folder that has `bad.toml`, `own.toml`, `small.toml` and `swing.csv`.
LINES: dict[str, tuple[str, ...]] = {
    "atlas": ("atlas excavator --x-range 0.5,1.5 --y-range -2,-1 --cells 8,8",),
    "check": (
        "check excavator",
        "check pipe-laying",
        "check article-a",
        "check excavator-study",
        "check bad.toml",
        "check nowhere",
    ),
    "compare": (
        f"evaluate {EXCAVATOR} --json > one.json",
        "evaluate excavator --posture 0.5,-1.5 --json > two.json",
        "compare one.json two.json",
    ),
    "completion": ("completion bash",),
    "doctor": ("doctor",),
    "evaluate": (
        f"evaluate {EXCAVATOR}",
        f"evaluate {EXCAVATOR} --damped --gravity",
        f"evaluate {EXCAVATOR} {LOOP}",
        f"evaluate {BUCKET} --loop default",
        f"evaluate {CRANE}",
        "evaluate excavator --end-point 0,9",
        "evaluate excavator --posture 1",
    ),
    "explain": (f"explain {EXCAVATOR}", f"explain {BUCKET} --loop default"),
    "explore": (f"explore {EXCAVATOR} --out page.html",),
    "export": (
        "export excavator --out bundle --parts kinematics",
        "export excavator --out bundle --parts nothing",
    ),
    "identify": ("identify excavator swing.csv --posture 1,-2 --unknown base.*.rotation",),
    "map": (
        "map excavator --points 4,3",
        f"map {EXCAVATOR} --vary kp=1e3,1e5 --vary kv=1e2,1e4 --points 3,3",
    ),
    "new": ("new digger.toml --yes",),
    "region": (f"region {EXCAVATOR} --boxes 0", f"region {BUCKET} --boxes 0"),
    "report": ("report own.toml --points 3 --out report", "report nowhere --out report"),
    "schema": ("schema study --out study.json",),
    "select": (
        "select article --starts 2",
        f"select {AT}",
        f"select {AT} --objective decay {LOOP}",
        "select boom-stick-bucket --end-point 7,0.5 --base 0 --starts 1",
        "select excavator --end-point 0,99",
        "select excavator",
    ),
    "sensitivity": (f"sensitivity {EXCAVATOR} --ranges payload.mass=0,500 --samples 64",),
    "simulate": (
        f"simulate {EXCAVATOR} --kp 1e5 --kv 2e3 --duration 0.5",
        "simulate article-b --duration 1",
        f"simulate {BUCKET} --loop default --duration 0.2",
    ),
    "study": ("study run small.toml --out folder", "study status folder", "study export folder --out small.csv"),
    "verdict": (
        f"verdict own.toml {LOOP} --members 2 --runs 1 --duration 1",
        "verdict own.toml --loop default --members 2 --runs 0",
        "verdict excavator --end-point 0,1.6",
    ),
    "verify": ("verify nowhere",),
    "help": ("--help", *(f"{name} --help" for name in sorted(COMMANDS))),
}

BAD = """schema = 1
name = "bad"
[base]
length = -0.5
mass = "heavy"
"""
OWN = """schema = 1
name = "own"
machine = "excavator"
[target]
end_point = [0.0, 1.6]
[selection]
base = [0.0]
starts = 2
"""
STUDY = """schema = 1
name = "small"
machine = "excavator"
compute = "measures"
quantities = ["w"]
posture = [1.0, -2.0]
[[vary]]
of = "posture.boom"
value = [0.5, 1.0]
count = 2
"""
# Of `doctor`: what is found on this machine.
FOUND_HERE = re.compile(r"^\s*\S+\s+(C compiler: ).*$", re.MULTILINE)
PROGRESS = re.compile(r"^\w+ \d+/\d+$")
NUMBER = re.compile(r"(?<!\w)[-+±−]?\d+(?:\.\d+)*(?:e[-+]?\d+)?")


def printed(snapshot: str) -> str:
    """What the commands of a snapshot print, masked."""
    with TemporaryDirectory() as folder, chdir(folder):
        _write_inputs(Path(folder))
        return "\n".join(f"$ flexopt {line}\n{_run(line, folder)}" for line in LINES[snapshot])


def masked(text: str, folder: str = "") -> str:
    """Every number as #, every run of spaces, rules and bars as one, and nothing of this machine."""
    for found, word in ((folder, "FOLDER"), (platform.system(), "SYSTEM"), (platform.machine(), "PROCESSOR")):
        text = text.replace(found, word) if found else text
    text = FOUND_HERE.sub(r"\1…", text)
    text = NUMBER.sub("#", text)
    text = re.sub(r"([ ─━═█▇#])\1+", r"\1", text)
    return "\n".join(line.strip() for line in text.splitlines()) + "\n"


def _run(line: str, folder: str) -> str:
    """Standard output, then standard error without progress, both masked, then the exit status where it is not 0."""
    line, _, file = line.partition(" > ")
    out, err, code = io.StringIO(), io.StringIO(), 0
    environment = {"COLUMNS": "80", "LINES": "24", "FLEXOPT_COMPILE": "0", "NO_COLOR": "1"}
    with (
        patch.dict(os.environ, environment),
        patch("flexopt.cli.common.SELDOM", 3600.0),
        warnings.catch_warnings(),
        redirect_stdout(out),
        redirect_stderr(err),
    ):
        try:
            main(shlex.split(line))
        except SystemExit as leave:
            code = leave.code if isinstance(leave.code, int) else 0
    told = [each for each in err.getvalue().splitlines() if not PROGRESS.match(each)]
    if file:
        Path(file).write_text(out.getvalue(), encoding="utf-8")
    text = ("" if file else out.getvalue()) + "".join(f"{each}\n" for each in told)
    return (masked(text, folder) if text else "") + (f"exit status {code}\n" if code else "")


def _write_inputs(folder: Path) -> None:
    (folder / "bad.toml").write_text(BAD, encoding="utf-8")
    (folder / "own.toml").write_text(OWN, encoding="utf-8")
    (folder / "small.toml").write_text(STUDY, encoding="utf-8")
    t = np.arange(200) / 100
    noise = 1e-5 * np.random.default_rng(1).standard_normal(t.size)
    swing = 0.01 * np.exp(-0.5 * t) * np.cos(12 * t) + noise
    rows = "".join(f"{float(a)!r},{float(b)!r}\n" for a, b in zip(t, swing, strict=True))
    (folder / "swing.csv").write_text(f"t [s],gyro_z [rad/s]\n{rows}", encoding="utf-8")
