"""`flexopt.explore`: a machine or a problem as one page that computes in the browser.

In: a machine with a posture, or a problem, whose best configuration is found first. Out: an `Explorer`.
"""

from __future__ import annotations

import html
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np

from flexopt.errors import FlexoptWarning
from flexopt.explorer.contents import SLIDE, TURN, contents, size_of
from flexopt.explorer.graphs import explorer_functions
from flexopt.explorer.javascript import script_of
from flexopt.explorer.meshes import Meshes, body_meshes
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import BaseLike, Document, PostureLike, Progress, Vector
from flexopt.foundation.boundary import anything, path, public
from flexopt.foundation.control import Control
from flexopt.foundation.documents import json_ready, provenance
from flexopt.foundation.palette import LIGHT, PALETTES
from flexopt.foundation.quantities import whole_number
from flexopt.foundation.rendering import render
from flexopt.foundation.results import Result
from flexopt.foundation.warned import warn_user
from flexopt.foundation.writing import write_file
from flexopt.loop.evaluation import settings_at
from flexopt.model import AnyMachine, Problem
from flexopt.model.loop import Loop, LoopLike
from flexopt.model.problem import judged_by
from flexopt.model.uncertainty import Uncertainty
from flexopt.plant import build_plant
from flexopt.robustness.evaluation import Evaluation
from flexopt.robustness.measures import build_measures
from flexopt.selection import SelectionProblem, select, select_stand, solve_selection
from flexopt.selection.constraints.ground import standing_height
from flexopt.study.asked import one_placement
from flexopt.study.verdicts.place_loops import held_at, held_now

# What a problem would say.
NOTHING_ASKED: dict[str, Any] = {
    "target": None,
    "ground": None,
    "which": "",
    "by": "",
    "objective": None,
    "weights": None,
}
# Height of the page in a notebook, px.
HEIGHT = 900
PRESENT, BEST = "present", "recommended"
# Postures that are tried where none is given.
TRIED = 64
# Of the meshes that are left out, so many are named in a warning.
NAMED = 5


@dataclass(frozen=True)
class Explorer(Result):
    """A page that shows a machine and computes with its own graphs; a notebook shows it by itself.

    Attributes:
        machine: its name.
        configurations: (base (n_b,), posture (n,)) by name: `present` and, of a problem, `recommended`.
        page: the whole page, HTML.
        triangles: of the meshes on it.
        mesh_bytes: of the page that are meshes.
        provenance: machine, versions and options.

    Example:
        >>> import flexopt
        >>> sorted(flexopt.explore(flexopt.load_problem("article")).configurations)
        ['present', 'recommended']
    """

    DOCUMENT = "machine configurations=stands bytes triangles mesh_bytes provenance"

    machine: str
    configurations: Mapping[str, tuple[Vector, Vector]]
    page: str = field(repr=False)
    triangles: int
    mesh_bytes: int
    provenance: Document = field(repr=False)

    @public(path=path(".html", parent=True))
    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the page to a file, `.html`.

        Raises:
            InputError: the name does not end in `.html`, or there is no such folder.
            WriteError: the file cannot be written.

        Example:
            >>> flexopt.explore(flexopt.load("excavator")).save("page.html")
        """
        write_file(path, self.page)

    @property
    def bytes(self) -> int:
        """Size of the page."""
        return len(self.page.encode())

    @property
    def stands(self) -> dict[str, dict[str, Vector]]:
        """The configurations as tables."""
        return {name: {"base": base, "posture": posture} for name, (base, posture) in self.configurations.items()}

    def _repr_html_(self) -> str:
        title = html.escape(f"flexopt explorer: {self.machine}")
        return (
            f'<iframe title="{title}" srcdoc="{html.escape(self.page)}" '
            f'style="width: 100%; height: {HEIGHT}px; border: 1px solid #8888"></iframe>'
        )

    def __repr__(self) -> str:
        words = " and ".join(self.configurations)
        meshes = (
            f", {self.mesh_bytes / 1e3:.0f} kB of it meshes of {self.triangles} triangles" if self.triangles else ""
        )
        return f"Explorer({self.machine}: {words} configuration, page of {self.bytes / 1e3:.0f} kB{meshes})"


def _explored(arguments: Arguments, field: str, value: Any) -> Any:
    """A machine, or a problem of one placement."""
    if isinstance(value, AnyMachine):
        arguments.of = value
        return value
    if isinstance(value, Problem | SelectionProblem):
        return one_placement(arguments, field, value)
    arguments.note(field, "must be a machine or a problem, from flexopt.load or flexopt.load_problem", value)
    return value


def _together(arguments: Arguments, given: Mapping[str, Any]) -> None:
    """A problem brings control and configuration; one of several targets lets choose among them."""
    asked, chosen = given["machine_or_problem"], given["target"]
    if isinstance(asked, Problem) and asked.target.end_points is not None:
        arguments.checked("target", 1 if chosen is None else chosen, whole_number(1, len(asked.target.end_points)), 1)
    elif chosen is not None:
        arguments.note("target", "goes with a problem of several targets, target.end_points", chosen)
    if isinstance(asked, Problem | SelectionProblem):
        for name in ("posture", "base", "control", "gravity"):
            if given[name] is not None and given[name] is not False:
                arguments.note(name, "goes with a machine; the problem brings its own", given[name])


@public(machine_or_problem=_explored, target=anything, together=_together)
def explore(
    machine_or_problem: AnyMachine | Problem | SelectionProblem,
    posture: PostureLike | None = None,
    *,
    base: BaseLike | None = None,
    control: Control | None = None,
    gravity: bool = False,
    loop: LoopLike | None = None,
    target: int | None = None,
    progress: Progress | None = None,
) -> Explorer:
    """One HTML page on which a machine is moved with the mouse, computed in the browser with its own graphs.

    The end-point and the base can be dragged. The page shows, for each mode of K φ = ω² M φ, frequency, w_i, |a_i||b_i|
    and the angle between a_i and b_i; a map of w_i or V = Σ αi wi over two joints; and how fast the sampled loop of
    given gains, dead time, payload and soil decays or grows. It needs no network and no server. A machine in space is
    drawn with the meshes of its robot file, where the extra `meshes` is installed, else with its capsules.

    Args:
        machine_or_problem: from `flexopt.load`, `flexopt.load_problem` or `flexopt.build_selection`. Of a problem the
            recommended configuration, the best by its objective, is computed and shown as a ghost; `flexopt.verdict`
            looks at other candidates, too, and may send the machine to one of these. Of several targets
            (`target.end_points`) it is the placement for all of them with the posture of one; a path (`target.path`) is
            refused.
        posture: of a machine: the actuated joints at first, (n,), rad or m; by default one far from singular ones.
        base: of a machine: its placement at first, (n_b,), m and rad; 0 by default.
        control: of a machine: Jacobian `"inverse"`, `"transpose"` or `"damped:LAMBDA"`; by default the loop's.
        gravity: of a machine: everything under static deflection, as in `flexopt.evaluate`.
        loop: the real controller, as in `flexopt.outcome`; the machine's own by default.
        target: of a problem of several targets: the number of the one that is shown, from 1 on; the first by default.
        progress: of a problem: called with the number of starts done and of all, as it is solved.

    Returns:
        An `Explorer`: `.save("page.html")`; a notebook shows it by itself.

    Raises:
        InputError: an argument is not usable; the start is a singular posture; the springs do not hold the weight.

    Warns:
        FlexoptWarning: a mesh of the robot file is not drawn, and why; the capsules of its body stay.

    Example:
        >>> import flexopt
        >>> page = flexopt.explore(flexopt.load("excavator"), [1.0, -2.0])
        >>> page.save("excavator.html")
    """
    known = cast("Loop | None", loop)
    if isinstance(machine_or_problem, AnyMachine):
        machine = machine_or_problem
        place = np.zeros(len(machine.base_coordinates)) if base is None else cast(Vector, base)
        start = _open_posture(machine, place) if posture is None else cast(Vector, posture)
        return _page(machine, {PRESENT: (place, start)}, control, known, gravity, {"title": machine.name})
    asked = (
        judged_by(machine_or_problem, known, None) if isinstance(machine_or_problem, Problem) else machine_or_problem
    )
    problem, stands, which, by = _solved(asked, target or 1, progress)
    configurations = {name: (stand.base, stand.posture) for name, stand in stands.items() if stand is not None}
    title, own = (asked.name, asked.loop) if isinstance(asked, Problem) else (problem.machine.name, None)
    sought = problem.objectives[-1]
    told = {"title": title, "target": problem.target.tolist(), "which": which, "by": by}
    told |= {"objective": sought.name, "weights": sought.alpha}
    told["ground"] = problem.asked.clearance and problem.asked.clearance.ground
    known = own if known is None else known
    uncertain = asked.uncertainty if isinstance(asked, Problem) else ()
    return _page(problem.machine, configurations, problem.control, known, problem.gravity, told, uncertain)


def _solved(
    asked: Problem | SelectionProblem, number: int, progress: Progress | None
) -> tuple[SelectionProblem, dict[str, Evaluation | None], str, str]:
    """The problem of one target, its configurations by name, which of several targets it is, and what is best by."""
    if isinstance(asked, SelectionProblem):
        found = solve_selection(asked, progress=progress)
    elif asked.target.end_points is not None:
        stand = select_stand(**asked.select_arguments(), progress=progress)
        problem, best = stand.problems[number - 1], stand.places[number - 1].evaluation
        which = f"target {number} of {len(stand.places)}"
        # As a verdict has it.
        return problem, {PRESENT: held_at(stand, number - 1), BEST: best}, which, stand.objective
    else:
        found = select(**asked.select_arguments(), progress=progress)
    now = None if found.initial is None else held_now(found.problem, found.initial)
    return found.problem, {PRESENT: now, BEST: found.best.evaluation}, "", found.objective


def _page(
    machine: AnyMachine,
    configurations: Mapping[str, tuple[Vector, Vector]],
    control: Control | None,
    loop: Loop | None,
    gravity: bool,
    told: Mapping[str, Any],
    uncertainty: Sequence[Uncertainty] = (),
) -> Explorer:
    """The page of configurations by name, the first of which it shows at first; `told`: title and target."""
    base, posture = next(iter(configurations.values()))
    settings, _ = settings_at(machine, posture, base, control, loop, gravity=gravity, call="explore")
    measures = build_measures(machine, settings.control, gravity)
    meshes = body_meshes(machine.visual_shapes)
    _warn_of(meshes)
    motions, bodies = settings.motions(machine, gravity=gravity), bool(machine.capsules or meshes.bodies)
    functions = explorer_functions(measures, motions, frames=bodies)
    data = contents(
        machine,
        settings,
        functions,
        configurations,
        meshes,
        gravity=gravity,
        uncertainty=uncertainty or machine.uncertainty,
    )
    data |= NOTHING_ASKED | dict(told)
    # That which clearances are kept from, else that on which it stands.
    data["ground"] = standing_height(machine) if data["ground"] is None else data["ground"]
    page = render(
        "explorer/templates/page.html",
        # Inside a script element nothing may look like its end.
        data=json.dumps(json_ready(data), allow_nan=False, ensure_ascii=False).replace("<", "\\u003c"),
        graphs={name: script_of(function) for name, function in functions.items()},
        title=told["title"],
        weight=gravity,
        palettes=PALETTES,
        inks=json.dumps(LIGHT.named() | {"series": LIGHT.series}),
    )
    return Explorer(
        machine=machine.name,
        configurations=dict(configurations),
        page=page,
        triangles=meshes.triangles,
        mesh_bytes=sum(len(mesh[key]) for mesh in data["meshes"] for key in ("corners", "triangles")),
        provenance=provenance(machine, control=settings.control, gravity=gravity),
    )


def _warn_of(meshes: Meshes) -> None:
    if meshes.left_out:
        more = len(meshes.left_out) - NAMED
        listed = [*meshes.left_out[:NAMED], *([f"and {more} more"] if more > 0 else [])]
        sentence = f"explore: not drawn, where capsules, if any, stay: {'; '.join(listed)}"
        if any("package://" in each for each in listed):
            sentence += "; ROS_PACKAGE_PATH names the folders that packages lie in"
        warn_user(sentence, FlexoptWarning)


def _open_posture(machine: AnyMachine, base: Vector) -> Vector:
    """Of some postures within the limits, always the same, one far from singular, stretched out, above ground."""
    rng, ranges = np.random.default_rng(0), map(_range_near_zero, machine.limits, machine.joint_units)
    low, high = np.array(list(ranges)).T
    tried = low + (high - low) * rng.uniform(0.15, 0.85, (TRIED, len(low)))
    found: Vector = tried[int(np.argmax([_openness(machine, base, posture) for posture in tried]))]
    return found


def _range_near_zero(limits: tuple[float, float], unit: str) -> tuple[float, float]:
    """What of a joint's range is within half a turn or a metre of zero; all of it where that is nothing."""
    most = TURN if unit == "rad" else SLIDE
    low, high = max(limits[0], -most), min(limits[1], most)
    return (low, high) if low < high else limits


def _openness(machine: AnyMachine, base: Vector, posture: Vector) -> float:
    """`singularity_sine_squared` + how far out the end-point is, of the machine's size; 1 less where a part is low."""
    plant = build_plant(machine)
    p = plant.parameter_values
    points = plant.skeleton.call([plant.rest(base, posture, p), base, p])[0].full()
    out = np.linalg.norm(points[:-1, -1] - points[:-1, 0]) / size_of(machine, base, posture)
    sine_squared = float(plant.singularity_sine_squared(base, posture, p))
    return sine_squared + float(out) - float(np.any(points[-1, 1:] < points[-1, 0]))
