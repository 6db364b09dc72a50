"""The gallery: every kind of picture with the lines that made it, drawn when the pages are built, light and dark."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

import flexopt

FOLDER = "gallery"
INTRODUCTION = """Each picture is drawn by the lines above it when these pages are built. One colour has one meaning in
all of them: blue is what stands now, orange what is proposed, red grows, teal settles, violet is undecided.
[Sizes, themes and your own axes](../howto/pictures.md) are the same for every result."""


@dataclass(frozen=True)
class Exhibit:
    """A picture of the gallery.

    Attributes:
        name: of its file; title, sentence: of its section.
        kind, form: whose picture it is, as in `flexopt.foundation.pictures`.
        code: makes `result` and draws it; "FILE" stands for the file's name.
    """

    name: str
    title: str
    sentence: str
    kind: str
    code: str
    form: str = "picture"

    @property
    def suffix(self) -> str:
        """Of its file."""
        return ".gif" if self.form == "film" else ".png"


EXHIBITS = (
    Exhibit(
        "selection", "Where to stand", "The machine now and as proposed, and every w_i along the redundancy.",
        "Selection",
        'problem = flexopt.load_problem("article")\nresult = flexopt.solve_problem(problem)\nresult.plot("FILE")',
    ),
    Exhibit(
        "selection-in-space", "In space, among obstacles",
        "From the side and from above; what may stand where is in the legend.", "Selection",
        'problem = flexopt.load_problem("pipe-laying")\nresult = flexopt.solve_problem(problem)\nresult.plot("FILE")',
    ),
    Exhibit(
        "stand", "One place for several targets", "The worst target in orange, the others grey.", "Stand",
        'problem = flexopt.load_problem("stations")\nresult = flexopt.solve_problem(problem)\nresult.plot("FILE")',
    ),
    Exhibit(
        "plan", "A way of the base", "A film strip: each shot with the one before it in grey.", "BasePlan",
        'problem = flexopt.load_problem("trench")\nresult = flexopt.solve_problem(problem)\nresult.plot("FILE")',
    ),
    Exhibit(
        "base-trajectory", "The base climbs by itself", "The nullspace law, the end-point held.", "BaseTrajectory",
        'machine = flexopt.load("excavator")\n'
        "result = flexopt.nullspace_trajectory(machine, (0.9929, -2.6306), base_range=(-1.5, 1.0))\n"
        'result.plot("FILE")',
    ),
    Exhibit(
        "run", "A run of the closed loop", "Dashed: the envelope from which the decay was found.", "Trajectory",
        'machine = flexopt.load("excavator")\nresult = flexopt.simulate(machine, (0.9929, -2.6306))\n'
        'result.plot("FILE")',
    ),
    Exhibit(
        "film", "The same run as a film", "Deflections of the base are shown fifty times as large.", "Trajectory",
        'machine = flexopt.load("excavator")\nresult = flexopt.simulate(machine, (0.9929, -2.6306), duration=2.0)\n'
        'result.animate("FILE", magnify=50.0)',
        form="film",
    ),
    Exhibit(
        "ensemble", "Many runs", "Verdicts over what varies; bands hold half and nine tenths of the members.",
        "Ensemble",
        'machine = flexopt.load("excavator")\nvary = {"kv": np.geomspace(3e2, 3e4, 60)}\n'
        "result = flexopt.simulate_ensemble(\n"
        '    machine, (0.0448, -2.0499), vary=vary, kp=1e5, duration=4.0, keep="trajectories"\n)\n'
        'result.plot("FILE")',
    ),
    Exhibit(
        "map", "A map of the workspace", "Frequencies, measures and where feedback acts in phase.", "WorkspaceMap",
        'machine = flexopt.load("excavator")\n'
        "result = flexopt.map_workspace(machine, points=(81, 81), epsilon_max=False)\n"
        'result.plot("FILE")',
    ),
    Exhibit(
        "map-of-the-base", "A map of the placement", "The star marks the best place of each panel.", "WorkspaceMap",
        'machine = flexopt.load("mobile-manipulator")\nposture = (0.4, -1.0, 1.6, -0.6, 1.57, 0.0)\n'
        'result = flexopt.map_workspace(machine, over="base", posture=posture, points=(41, 41), epsilon_max=False)\n'
        'result.plot("FILE")',
    ),
    Exhibit(
        "map-of-the-loop", "A map of the loop", "Teal settles, red grows, black is the border.", "WorkspaceMap",
        'machine = flexopt.load("excavator")\nvary = {"kp": (1e3, 1e6), "kv": (1e2, 1e5)}\n'
        "result = flexopt.map_loop(machine, posture=(0.0448, -2.0499), vary=vary, points=(60, 60))\n"
        'result.plot("FILE")',
    ),
    Exhibit(
        "verdict", "Does it pay to move?", "Every place over all that is uncertain, from the worst to the best seen.",
        "Verdict",
        'problem, loop = flexopt.load_problem("article"), {"kp": 1e4, "kv": 1e3}\n'
        'result = flexopt.verdict(problem, loop=loop, ranges={"stiffness": (0.5, 2.0)}, members=16, runs=0)\n'
        'result.plot("FILE")',
    ),
    Exhibit(
        "explanation", "Why a posture is good or bad",
        "How the end-point moves in each mode and how feedback pushes it, and what to move.", "Explanation",
        'machine = flexopt.load("excavator")\nresult = flexopt.explain(machine, (0.9929, -2.6306))\n'
        'result.plot("FILE")',
    ),
    Exhibit(
        "sensitivity", "Which unknown matters", "What each explains of every measure, alone and in all.",
        "Sensitivity",
        'machine = flexopt.load("excavator")\nranges = {"stiffness": (0.5, 2.0), "payload.mass": (0.0, 400.0)}\n'
        "result = flexopt.sensitivity(machine, (0.0448, -2.0499), ranges=ranges, samples=256)\n"
        'result.plot("FILE")',
    ),
    Exhibit(
        "atlas", "All robust postures", "Where w_i = 0 over two joints, and where the end-point then is.", "Atlas",
        'machine = flexopt.load("excavator")\nresult = flexopt.atlas(machine, cells=(64, 64))\nresult.plot("FILE")',
    ),
    Exhibit(
        "identification", "What a log says", "Log and fit of a free swing, residuals with twice their size.",
        "Identification",
        "t = np.arange(0, 5, 0.01)\n"
        "noise = 2e-5 * np.random.default_rng(1).standard_normal(t.size)\n"
        'log = {"t [s]": t, "gyro_z [rad/s]": 2e-3 * np.exp(-0.2 * t) * np.cos(12 * t) + noise}\n'
        'machine = flexopt.load("excavator")\n'
        'result = flexopt.identify(machine, log, posture=(0.5, -1.2), unknown="base.*.rotation")\n'
        'result.plot("FILE")',
    ),
)  # fmt: skip


def page() -> str:
    """The gallery's page; `write_pictures` draws what it shows."""
    parts = ["# Gallery", INTRODUCTION, "```python\nimport numpy as np\nimport flexopt\n```"]
    for exhibit in EXHIBITS:
        file = exhibit.name + exhibit.suffix
        parts.append(f"## {exhibit.title}\n\n{exhibit.sentence}")
        parts.append(f"```python\n{exhibit.code.replace('FILE', file)}\n```")
        shown = zip(files_of(exhibit, Path(FOLDER)), ("light", "dark"), strict=True)
        parts += [
            f"```{{figure}} {image.as_posix()}\n:alt: {exhibit.title}\n:figclass: only-{theme}\n```"
            for image, theme in shown
        ]
    return "\n\n".join(parts) + "\n"


def write_pictures(folder: Path) -> None:
    """Draw what is missing or older than the code that draws it."""
    sources = [*Path(flexopt.__file__).parent.rglob("*.py"), Path(__file__)]
    newest = max(source.stat().st_mtime for source in sources)
    place = folder / FOLDER
    place.mkdir(parents=True, exist_ok=True)
    for exhibit in EXHIBITS:
        files = files_of(exhibit, place)
        if not all(file.exists() and file.stat().st_mtime > newest for file in files):
            draw(exhibit, place)


def files_of(exhibit: Exhibit, place: Path) -> list[Path]:
    """Its files in a folder, the light one first."""
    return [place / f"{exhibit.name}{theme}{exhibit.suffix}" for theme in ("", "-dark")]


def draw(exhibit: Exhibit, place: Path) -> Any:
    """Run its lines, and draw the result once more on dark ground; the result.

    Raises:
        ValueError: the result is of another kind, or a picture has not the ground or the size that it should.
    """
    light, dark = files_of(exhibit, place)
    names: dict[str, Any] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", flexopt.FlexoptWarning)
        exec("import numpy as np\nimport flexopt\n" + exhibit.code.replace('"FILE"', repr(str(light))), names)
        drawn = exhibit.code.splitlines()[-1].removesuffix(")")
        exec(drawn.replace('"FILE"', repr(str(dark))) + ', theme="dark")', names)
    looked_at(exhibit, names["result"], light, dark)
    return names["result"]


def looked_at(exhibit: Exhibit, result: Any, light: Path, dark: Path) -> None:
    """As `draw` says: what is wrong ends the build of the pages."""
    corners, sizes = [], []
    for file in (light, dark):
        with Image.open(file) as opened:
            corners.append(sum(opened.convert("RGB").getpixel((1, 1))))
            sizes.append(opened.size)
    if type(result).__name__ != exhibit.kind:
        raise ValueError(f"{exhibit.name}: shows a {type(result).__name__}, not a {exhibit.kind}")
    if corners[0] <= 700 or corners[1] >= 100 or sizes[0] != sizes[1]:
        raise ValueError(f"{exhibit.name}: grounds {corners} of 765, sizes {sizes}")
