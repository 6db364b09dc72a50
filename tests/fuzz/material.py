"""The good files that are mutated: small ones of every kind that flexopt reads, made by flexopt itself."""

from __future__ import annotations

import contextlib
import io
import json
import os
import shutil
import subprocess
import sys
import tomllib
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

import flexopt
from flexopt.cli import main
from flexopt.model.files import shipped_folder
from tests.boundary import calls
from tests.model.robots.files import URDF

# Every kind of constraint that a machine in the plane may have, and what else a problem file may hold.
PROBLEM = """schema = 1
name = "small"
machine = "excavator"

[target]
end_point = [0.0, 1.6]

[selection]
objective = "V"
weights = [1.0, 0.5, 0.2]
control = "inverse"
base = 0.0
posture = [1.0, -2.0]
base_range = [-4.0, 4.0]
singularity_margin_deg = 10.0
starts = 1
seed = 3

[constraints]
joint_margin = 0.05
manipulability = 0.1
tool_angle = [-3.0, 1.6]
region = [[-3.0, 3.0]]
keep_out = [[1.0, 1.5]]

[constraints.travel]
cost = 1e-3

[loop]
kp = 1e4
kv = 1e3
rate = 100.0
dead_time = 0.01

[[uncertainty]]
of = "base.stiffness.rotation"
factor = [0.5, 2.0]
"""
STUDY = """schema = 1
name = "small"
machine = "excavator"
compute = "measures"
quantities = ["w", "w_posture"]
chunk = 3

[[vary]]
of = "posture.boom"
value = [0.1, 1.4]
count = 2

[[vary]]
of = "posture.stick"
value = [-2.8, -0.3]
count = 2

[[vary]]
of = "base.stiffness.rotation"
factor = [0.5, 2.0]
count = 2
scale = "log"
"""
MESHED = """name = "meshed"
robot = "meshed.urdf"
actuated = ["slew", "boom", "extend"]
lock_others = true

[base]
stiffness = { z = 1e6, roll = 1e6, pitch = 1e6 }

[end_point]
link = "stick"
"""


def build(folder: Path, kinds: Iterable[str]) -> None:
    """Write those of some kinds: a folder for each kind, in it one for each specimen."""
    written = {
        "saved": _saved,
        "proof": _proof,
        "folder": _folder,
        "bundle": _bundle,
        "fmu": _fmu,
        "cache": _cache,
        "mesh": _meshes,
    }
    before = Path.cwd()
    with warnings.catch_warnings(), contextlib.redirect_stderr(io.StringIO()):
        warnings.simplefilter("ignore")
        try:
            _texts(folder)
            for kind in sorted({*kinds} & {*written}):
                written[kind](folder)
        finally:
            os.chdir(before)


def _made(folder: Path, name: str) -> Path:
    """A specimen's folder, which is the working directory from now on."""
    made = folder / name
    made.mkdir(parents=True)
    os.chdir(made)
    return made


def _texts(folder: Path) -> None:
    """Write files as people do."""
    models, problems = shipped_folder("models"), shipped_folder("problems")
    for name in ("excavator", "boom-stick-bucket"):
        shutil.copy(models / f"{name}.toml", _made(folder, f"machine/{name}") / "main.toml")
    for kind, name, robot in (
        ("urdf", "slewing-excavator", "urdf"),
        ("mjcf", "truck-crane", "xml"),
        ("mjcf", "mobile-manipulator", "xml"),
    ):
        for kind_of in (kind, "overlay"):
            made = _made(folder, f"{kind_of}/{name}")
            text = (models / f"{name}.toml").read_text(encoding="utf-8")
            Path("main.toml").write_text(text.replace(f"robots/{name}.{robot}", f"main.{robot}"), encoding="utf-8")
            shutil.copy(models / "robots" / f"{name}.{robot}", made / f"main.{robot}")
    made = _made(folder, "problem/small") / "main.toml"
    made.write_text(PROBLEM, encoding="utf-8")
    for path in sorted(problems.glob("*.toml")):
        kind = (
            "experiment"
            if "[simulation]" in (text := path.read_text(encoding="utf-8"))
            else "study"
            if "compute" in text
            else "problem"
        )
        shutil.copy(path, _made(folder, f"{kind}/{path.stem}") / "main.toml")
    (_made(folder, "study/small") / "main.toml").write_text(STUDY, encoding="utf-8")
    swing = calls.swing()
    rows = "".join(f"{t:.4f},{gyro:.8g},1.0,-2.0\n" for t, gyro in zip(swing["t"], swing["gyro_z"], strict=True))
    text = f"# a log\nt [s],gyro_z [rad/s],boom [rad],stick [rad]\n{rows}"
    (_made(folder, "log/comma") / "main.csv").write_text(text, encoding="utf-8")
    (_made(folder, "log/semicolon") / "main.csv").write_text(text.replace(",", ";").replace(".", ","), encoding="utf-8")


def _command(*arguments: str) -> str:
    """Run a command; return what it prints."""
    with contextlib.redirect_stdout(io.StringIO()) as printed, contextlib.suppress(SystemExit):
        main(list(arguments))
    return printed.getvalue()


def _saved(folder: Path) -> None:
    evaluate = ("evaluate", "excavator", "--json", "--loop", "default", "--posture")
    saved = {
        "evaluation": ((*evaluate, "1,-2"), (*evaluate, "0.9,-2.2")),
        "selection": (("select", "excavator", "--end-point", "0,1.6", "--starts", "1", "--json"),) * 2,
        "run": (("simulate", "excavator", "--posture", "1,-2", "--duration", "0.1", "--json"),) * 2,
        "verdict": (
            ("verdict", "excavator", "--end-point", "0,1.6", "--base", "0", "--loop", "kp=1e4", "--loop", "kv=1e3",
             "--members", "2", "--runs", "0", "--json"),) * 2,
    }  # fmt: skip
    for name, (first, second) in saved.items():
        made = _made(folder, f"saved/{name}")
        texts = [_command(*first)]
        texts += [texts[0] if second == first else _command(*second)]
        for file, text in zip(("main.json", "other.json"), texts, strict=True):
            (made / file).write_text(text, encoding="utf-8")
            json.loads(text)


def _proof(folder: Path) -> None:
    file = str(_made(folder, "proof/w1") / "main.json")
    _command("select", "excavator", "--end-point", "0,1.6", "--starts", "1", "--certify", "--proof", file)
    json.loads(Path(file).read_text(encoding="utf-8"))


def _folder(folder: Path) -> None:
    _made(folder, "folder/small")
    flexopt.run_study(flexopt.Study(**tomllib.loads(STUDY)), "study", workers=1)


def _bundle(folder: Path) -> None:
    _made(folder, "bundle/kinematics")
    flexopt.export_c(calls.excavator(), "bundle", parts=["kinematics"])


def _fmu(folder: Path) -> None:
    _made(folder, "fmu/sources")
    flexopt.export_fmu(calls.excavator(), "main.fmu", posture=calls.POSTURE, duration=0.05)


def _cache(folder: Path) -> None:
    """Fill a compile cache by a run, if there is a compiler."""
    made = _made(folder, "cache/kernels")
    (made / "cache").mkdir(mode=0o700)
    words = ["simulate", "excavator", "--posture", "1,-2", "--duration", "0.02"]
    environment = os.environ | {"FLEXOPT_CACHE": str(made / "cache"), "FLEXOPT_COMPILE": "1"}
    subprocess.run(
        [sys.executable, "-c", "from flexopt.cli import main; main()", *words],
        env=environment,
        check=True,
        capture_output=True,
    )


def _meshes(folder: Path) -> None:
    """Write a robot that names a mesh of each kind."""
    import trimesh  # noqa: PLC0415  (which only meshes need)

    made = _made(folder, "mesh/three")
    (made / "main.toml").write_text(MESHED, encoding="utf-8")
    visual = '<visual><geometry><mesh filename="{}"/></geometry></visual>'
    text = URDF.replace("package://nowhere/chassis.stl", "main.stl")
    for link, file in (("turret", "main.obj"), ("boom_link", "main.dae")):
        text = text.replace(f'<link name="{link}">', f'<link name="{link}">{visual.format(file)}')
    (made / "meshed.urdf").write_text(text, encoding="utf-8")
    box: Any = trimesh.creation.icosphere(subdivisions=1)
    box.apply_scale(np.array([1.0, 0.5, 0.2]))
    for suffix in ("stl", "obj", "dae"):
        box.export(str(made / f"main.{suffix}"))
