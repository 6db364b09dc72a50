"""What is called: small calls of every public function on every shipped machine and problem.

`CASES` has an entry for each call; `EXEMPT` names what no call covers, and why. A case returns a document, of which
`numbers.py` keeps the numbers. Whoever renames or merges calls changes the adapters here and leaves `kept/` as it is.
"""

from __future__ import annotations

import json
import os
import re
import tempfile
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import chdir
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np

import flexopt
from tests.golden.numbers import Kept, numbers

ROOT = Path(__file__).parents[2]


class Subject(NamedTuple):
    """A configuration of a shipped machine, and a target that it reaches."""

    posture: Sequence[float]
    base: Sequence[float]
    target: Sequence[float]
    second_target: Sequence[float]


SUBJECTS = {
    "excavator": Subject([1.0, -2.0], [0.1], [0.0, 1.6], [0.2, 1.6]),
    "boom-stick-bucket": Subject([-0.9, -1.2, -0.8], [0.1], [7.0, 0.5], [6.5, 0.5]),
    "slewing-excavator": Subject([0.3, 0.55, -1.2, -0.8], [0.1, -0.2, 0.3], [6.5, 1.5, 1.0], [6.0, 1.5, 1.0]),
    "truck-crane": Subject([1.2, 0.8, -0.9, 1.5], [0.1, -0.2, 0.3], [3.0, 4.0, 3.0], [3.0, 4.5, 3.0]),
    "mobile-manipulator": Subject(
        [0.4, -1.0, 1.6, -0.6, 1.57, 0.0], [0.1, -0.2, 0.3], [0.9, 0.2, 1.2], [0.8, 0.3, 1.2]
    ),
}
PROBLEMS = ("article", "article-transpose", "pipe-laying", "stations", "trench")
EXPERIMENTS = ("article-a", "article-b", "article-move")
STUDIES = ("excavator-study",)
PLANAR = ("excavator", "boom-stick-bucket")
IN_SPACE = ("slewing-excavator", "truck-crane", "mobile-manipulator")
WITH_CYLINDERS = ("boom-stick-bucket", "slewing-excavator", "truck-crane")

# A torque loop with all that [loop] may say, and a velocity loop.
TORQUE_LOOP = {
    "drive": "torque",
    "feedback": "pid",
    "kp": 2e4,
    "kv": 4e3,
    "ki": 2e3,
    "rate": 100.0,
    "dead_time": 0.004,
    "filter_hz": 30.0,
}
VELOCITY_LOOP = {"drive": "velocity", "kp": 1.0, "rate": 100.0, "dead_time": 0.01, "bandwidth_hz": 6.0}
RANGES = {"stiffness": [0.5, 2.0], "payload.mass": [0.0, 10.0]}


class Case(NamedTuple):
    """One call; which public functions it covers; whether it takes more than a second or two."""

    call: Callable[[], Any]
    covers: frozenset[str]
    long: bool


# Cases that take more than a second of a processor; the quick ones take a minute together.
LONG = (
    "verdict-article",
    "verdict-[pst]*",
    "verdict_runs-*",
    "report-*",
    "select_outcome-boom-stick-bucket:*",
    "select_outcome-excavator:allowed_gain",
    "select-*:epsilon_max",
    "solve_problem-[pst]*",
    "export_c-[bstm]*",
    "export_fmu-*",
    "plan_base-boom-stick-bucket",
    *(f"evaluate-{name}:loop" for name in IN_SPACE),
    *(f"outcome-{name}:[tvg]*" for name in IN_SPACE),
    *(f"select-{name}:w1" for name in IN_SPACE),
    *(
        f"{call}-{name}"
        for name in IN_SPACE
        for call in ("stable_region", "select_stand", "plan_base", "simulate_loop", "sensitivity", "atlas")
    ),
    "study-truck-crane:outcome",
)
CASES: dict[str, Case] = {}


def case(covers: str, subjects: Iterable[str], *, name: str = "") -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Make a case of a function for each subject."""

    def add(function: Callable[..., Any]) -> Callable[..., Any]:
        call = name or function.__name__.rstrip("_")
        for subject in subjects:
            full = f"{call}-{subject}"
            is_long = any(fnmatchcase(full, pattern) for pattern in LONG)
            CASES[full] = Case(lambda subject=subject: function(subject), frozenset(covers.split()), is_long)
        return function

    return add


def computed(name: str) -> Kept:
    """The numbers of a case, in an empty folder.

    Without `FLEXOPT_COMPILE`, graphs run on CasADi's own machine: compiling takes most of the time of so small calls.
    """
    environment = {"FLEXOPT_COMPILE": os.environ.get("FLEXOPT_COMPILE", "0")}
    with (
        patch.dict(os.environ, environment),
        tempfile.TemporaryDirectory() as folder,
        chdir(folder),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")
        return numbers(CASES[name].call())


@cache
def machine(name: str) -> Any:
    return flexopt.load(name)


@cache
def problem(name: str) -> Any:
    return flexopt.load_problem(name)


def at(name: str) -> dict[str, Any]:
    """Where a machine stands, as arguments."""
    return {"machine": machine(name), "posture": SUBJECTS[name].posture, "base": SUBJECTS[name].base}


def functions(owner: Any, names: str, **inputs: Any) -> dict[str, Any]:
    """Values of CasADi Functions, each with the inputs that it takes."""
    found: dict[str, Any] = {}
    for name in names.split():
        function = getattr(owner, name)
        given = {key: inputs[key] for key in function.name_in() if key in inputs}
        found |= {f"{name}.{output}": value.full() for output, value in function.call(given).items()}
    return found


# --- files ------------------------------------------------------------------------------------------------------------


@case("load", SUBJECTS)
def load(name: str) -> Any:
    loaded = flexopt.load(name)
    return {"file": loaded.to_dict(), "parameters": {each.name: each.value for each in loaded.parameters}}


@case("machine_from_dict tree_from_dict load", SUBJECTS)
def from_dict(name: str) -> Any:
    make = flexopt.machine_from_dict if name in PLANAR else flexopt.tree_from_dict
    made = make(flexopt.load(name).to_dict())
    return {each.name: each.value for each in made.parameters}


@case("load_robot", IN_SPACE)
def load_robot(name: str) -> Any:
    return {each.name: each.value for each in flexopt.load_robot(ROOT / "models" / f"{name}.toml").parameters}


@case("load_problem", PROBLEMS)
def load_problem(name: str) -> Any:
    return flexopt.load_problem(name).model_dump(exclude={"loaded_machine"})


@case("load_experiment", EXPERIMENTS)
def load_experiment(name: str) -> Any:
    return flexopt.load_experiment(name).model_dump(exclude={"loaded_machine"})


@case("load_study", STUDIES)
def load_study(name: str) -> Any:
    return flexopt.load_study(name).model_dump(exclude={"subject", "loaded_machine"})


@case("schema", ["machine", "problem", "experiment", "study"])
def schema(kind: str) -> Any:
    """The bounds and defaults that are numbers."""
    document = flexopt.schema(kind)
    return numbers(document) | {"definitions": len(document.get("$defs", {}))}


@case("check", [*SUBJECTS, *PROBLEMS, *EXPERIMENTS, *STUDIES])
def check(name: str) -> Any:
    """How many faults, findings and warnings."""
    document = flexopt.check(name).to_dict()
    return {"good": document["status"] == "good"} | {
        key: len(document[key]) for key in ("faults", "findings", "warnings")
    }


# --- plant ------------------------------------------------------------------------------------------------------------


@case("build_plant", SUBJECTS)
def build_plant(name: str) -> Any:
    plant = flexopt.build_plant(machine(name))
    subject = SUBJECTS[name]
    posture, base, p = np.array(subject.posture), np.array(subject.base), plant.parameter_values
    rest = plant.rest(base=base, posture=posture, p=p)["q"].full().ravel()
    q = rest + 1e-2 * np.cos(np.arange(rest.size))
    v = 0.1 * np.sin(1.0 + np.arange(rest.size))
    return functions(
        plant,
        "end_point skeleton body_frames end_rotation centre_of_mass jacobian rigid_jacobian base_jacobian mass bias "
        "gravity most_weight stiffness damping rest singularity_sine_squared singularity_gradient deflected held "
        "gravity_stiffness sagging_jacobian",
        q=q,
        v=v,
        base=base,
        posture=posture,
        p=p,
        target=plant.end_point(q=rest, base=base, p=p)["r"],
    )


@case("build_hydraulics", WITH_CYLINDERS)
def build_hydraulics(name: str) -> Any:
    hydraulics = flexopt.build_hydraulics(machine(name))
    subject, plant = SUBJECTS[name], hydraulics.plant
    p, base = plant.parameter_values, np.array(subject.base)
    q = plant.rest(base=base, posture=np.array(subject.posture), p=p)["q"].full().ravel()
    n = len(subject.posture)
    wave = np.cos(np.arange(n))
    inputs = {"posture": q[-n:], "p": p, "torque": 1e3 * wave, "rates": 0.1 * wave, "lever": 0.3 * wave}
    found = functions(hydraulics, "lengths ratios forces joint_efforts lever rates", **inputs)
    states = [[state.length, state.ratio, state.force] for state in hydraulics.states(q, base)]
    return found | {"states": states}


@case("build_measures", [f"{name}-{control}" for name in SUBJECTS for control in ("inverse", "transpose")])
def build_measures(subject: str) -> Any:
    name, _, control = subject.rpartition("-")
    measures = flexopt.build_measures(machine(name), control)
    own = SUBJECTS[name]
    inputs = {
        "base": np.array(own.base),
        "posture": np.array(own.posture),
        "p": measures.plant.parameter_values,
        "alpha": np.ones(measures.plant.n_passive),
    }
    return functions(measures, "w gradients w_with_gradient weighted_gradient quick", **inputs)


@case("inverse_kinematics", SUBJECTS)
def inverse_kinematics(name: str) -> Any:
    subject = SUBJECTS[name]
    found = flexopt.inverse_kinematics(machine(name), subject.target, base=subject.base, seed=1)
    plant = flexopt.build_plant(machine(name))
    p, base = plant.parameter_values, np.array(subject.base)
    reached = [
        plant.end_point(q=plant.rest(base=base, posture=posture, p=p)["q"], base=base, p=p)["r"].full().ravel()
        for posture in found
    ]
    return {"postures": sorted([list(map(float, posture)) for posture in found]), "end_points": reached}


# --- measures ---------------------------------------------------------------------------------------------------------

EVALUATIONS: dict[str, dict[str, Any]] = {
    "inverse": {"control": "inverse"},
    "transpose": {"control": "transpose"},
    "gravity": {"control": "inverse", "gravity": True},
    "damped": {"control": "inverse", "damped": True},
    "loop": {"loop": {}},
}


def _pairs(subjects: Iterable[str], variants: Iterable[str]) -> list[str]:
    variants = tuple(variants)
    return [f"{name}:{variant}" for name in subjects for variant in variants]


@case("evaluate", _pairs(SUBJECTS, EVALUATIONS))
def evaluate(subject: str) -> Any:
    name, _, variant = subject.partition(":")
    return without_loop_gradient(flexopt.evaluate(**at(name), **EVALUATIONS[variant]).to_dict())


def without_loop_gradient(document: dict[str, Any]) -> dict[str, Any]:
    """A document whose loop has no gradient, which the cases of `outcome` keep."""
    loop = document.get("outcome")
    if loop:
        loop = {key: value for key, value in loop.items() if key != "gradient"}
    return document | {"outcome": loop}


@case("evaluate_w", SUBJECTS)
def evaluate_w(name: str) -> Any:
    subject, measures = SUBJECTS[name], flexopt.build_measures(machine(name))
    postures = np.array(subject.posture)[:, None] + 0.05 * np.arange(6)[None, :]
    found = flexopt.evaluate_w(measures, subject.base, postures, gradient=True)
    return {"w": found.w, "w_posture": found.w_posture, "singular": found.singular, "unheld": found.unheld}


@case("explain", _pairs(SUBJECTS, ["plain", "loop"]))
def explain(subject: str) -> Any:
    name, _, variant = subject.partition(":")
    return without_loop_gradient(flexopt.explain(**at(name), loop={} if variant == "loop" else None).to_dict())


@case("atlas", SUBJECTS)
def atlas(name: str) -> Any:
    arguments = at(name)
    posture = arguments.pop("posture")
    first, second = (0, 1) if len(posture) == 2 else (-2, -1)
    joints = [machine(name).joints[first], machine(name).joints[second]]
    found = flexopt.atlas(
        **arguments,
        joints=joints,
        posture=posture[:first] if len(posture) > 2 else None,
        x_range=(posture[first] - 0.4, posture[first] + 0.4),
        y_range=(posture[second] - 0.3, posture[second] + 0.3),
        cells=(12, 12),
        threads=1,
    )
    return numbers(found.to_dict(), drop=("vertices",))


# --- the loop ---------------------------------------------------------------------------------------------------------

OUTCOMES: dict[str, dict[str, Any]] = {
    "own": {"loop": {}},
    "torque": {"loop": TORQUE_LOOP},
    "velocity": {"loop": VELOCITY_LOOP},
    "gravity": {"loop": {}, "gravity": True},
    "transpose": {"loop": {}, "control": "transpose"},
}


@case("outcome", _pairs(SUBJECTS, OUTCOMES))
def outcome(subject: str) -> Any:
    name, _, variant = subject.partition(":")
    given = OUTCOMES[variant]
    if name == "excavator":
        # It names no speeds; and the gradients of peaks of a resonance without damping depend on rounding.
        other = {"velocity": VELOCITY_LOOP | {"servo_gain": 1e4}, "transpose": {"kp": 1e3, "kv": 5e2}}
        given = given | ({"loop": other[variant]} if variant in other else {})
    return flexopt.outcome(**at(name), **given).to_dict()


@case("sensitivity", SUBJECTS)
def sensitivity(name: str) -> Any:
    return flexopt.sensitivity(**at(name), loop={}, ranges=RANGES, samples=64, seed=1).to_dict()


@case("stable_region", SUBJECTS)
def stable_region(name: str) -> Any:
    document = flexopt.stable_region(**at(name), loop={}, ranges=RANGES, points=8, boxes=40).to_dict()
    return {key: document[key] for key in document if key != "boxes"}


@case("map_loop", SUBJECTS)
def map_loop(name: str) -> Any:
    vary = {"kp": (0.5, 5.0) if name != "excavator" else (1e2, 1e5), "dead_time": (0.0, 0.02)}
    found = flexopt.map_loop(**at(name), vary=vary, loop={"kv": 1e3} if name == "excavator" else {}, points=(3, 3))
    return arrays(found.dataset)


def arrays(dataset: Any) -> dict[str, Any]:
    """Variables of an xarray dataset that are numbers."""
    found = {str(name): dataset[name].values for name in dataset.variables}
    return {name: values for name, values in found.items() if values.dtype.kind in "fiub"}


MAPS = [*_pairs(PLANAR, ["end_point", "posture"]), *_pairs(IN_SPACE, ["base"])]


@case("map_workspace", MAPS)
def map_workspace(subject: str) -> Any:
    name, _, over = subject.partition(":")
    own = SUBJECTS[name]
    given: dict[str, Any] = {"over": over, "points": (4, 3), "threads": 1}
    if over == "posture":
        x, y = own.posture[:2]
        given |= {"joints": machine(name).joints[:2], "x_range": (x - 0.3, x + 0.3), "y_range": (y - 0.3, y + 0.3)}
        given |= {"base": own.base, "posture": own.posture[2:] or None}
    elif over == "end_point":
        x, y = own.target
        given |= {"x_range": (x - 0.2, x + 0.2), "y_range": (y - 0.2, y + 0.2)}
        given |= {} if name == "excavator" else {"posture": own.posture}
    else:
        given |= {"end_point": own.target, "base": own.base, "posture": own.posture}
    return arrays(flexopt.map_workspace(machine(name), **given).dataset)


# --- selection --------------------------------------------------------------------------------------------------------

# Of a configuration in a selection: what it is, and how good.
OF_BEST = [
    "base",
    "posture",
    "end_point",
    "objective",
    "w",
    "scale",
    "frequencies_hz",
    "damping_ratios",
    "epsilon_max",
    "rigid",
    "dimension",
    "constraints",
    "loop",
    "gains",
    "target",
]


def configuration(document: Mapping[str, Any]) -> dict[str, Any]:
    """A chosen configuration: what it is, and how good."""
    found = {key: document[key] for key in OF_BEST if key in document}
    if "constraints" in found:
        found["constraints"] = {
            name: {key: own[key] for key in ("value", "lower", "upper")} for name, own in found["constraints"].items()
        }
    return found


def answer(document: Mapping[str, Any]) -> dict[str, Any]:
    """The answer of a selection, a stand or a plan: the best, how good all others are, and what was asked."""
    found: dict[str, Any] = {"converged": document["converged"], "problem": asked(document["problem"])}
    if "best" in document:
        found["best"] = configuration(document["best"])
        found["objectives"] = sorted((each["objective"] for each in document["candidates"]), reverse=True)
    for key in ("base", "posture", "V", "worth", "standing", "time", "still", "between", "travelled", "worst"):
        if key in document:
            found[key] = document[key]
    if "places" in document:
        found["places"] = [configuration(place) for place in document["places"]]
    for key in ("initial", "outcomes", "loop", "gains"):
        if isinstance(document.get(key), Mapping):
            found[key] = configuration(document[key]) if key == "initial" else document[key]
    return found


def asked(document: Mapping[str, Any]) -> dict[str, Any]:
    """The program: bounds and scales of its variables and constraints."""
    return {key: document[key] for key in ("objective_scale", "weights", "variables", "constraints", "travel")}


@case("build_selection", SUBJECTS)
def build_selection(name: str) -> Any:
    built = flexopt.build_selection(machine(name), SUBJECTS[name].target, **_present(name), **_search(name))
    z = np.array([*SUBJECTS[name].base, *SUBJECTS[name].posture])
    return {"problem": asked(built.to_dict()), "rows": built.rows(z), "factors": built.factors(z)}


def _present(name: str) -> dict[str, Any]:
    return {"base": SUBJECTS[name].base, "posture": SUBJECTS[name].posture}


def _search(name: str) -> dict[str, Any]:
    return {"starts": 2 if name in PLANAR else 1, "seed": 3}


def _objective(name: str, objective: str) -> dict[str, Any]:
    """An objective, V with all modes alike."""
    ones = {"weights": [1.0] * flexopt.build_plant(machine(name)).n_passive}
    return {"objective": objective} | (ones if objective == "V" else {})


@case("select", [*_pairs(SUBJECTS, ["w1", "V"]), *_pairs(PLANAR, ["epsilon_max"])])
def select(subject: str) -> Any:
    name, _, objective = subject.partition(":")
    own = SUBJECTS[name]
    given = _present(name) | _search(name) | _objective(name, objective)
    return answer(flexopt.select(machine(name), own.target, **given, workers=1).to_dict())


@case("select", [*_pairs(PLANAR, ["decay"]), "excavator:allowed_gain"], name="select_outcome")
def select_outcome(subject: str) -> Any:
    name, _, objective = subject.partition(":")
    given = _present(name) | {"starts": 1, "workers": 1, "objective": objective, "loop": {}}
    given |= {"ranges": {"stiffness": [0.5, 2.0]}} if subject == "excavator:decay" else {}
    return answer(flexopt.select(machine(name), SUBJECTS[name].target, **given).to_dict())


@case("build_selection solve_selection", ["excavator"])
def solve_selection(name: str) -> Any:
    built = flexopt.build_selection(machine(name), SUBJECTS[name].target, **_present(name), **_search(name))
    return answer(flexopt.solve_selection(built, workers=1).to_dict())


@case("certify", ["article", "article-transpose"])
def certify(name: str) -> Any:
    found = flexopt.certify(flexopt.solve_problem(problem(name), workers=1)).to_dict()
    return {"proven": found["verdict"] == "proven"} | {key: found[key] for key in ("value", "upper", "scale")}


@case("certify select", ["boom-stick-bucket"], name="certify_bound")
def certify_bound(name: str) -> Any:
    own = SUBJECTS[name]
    chosen = flexopt.select(machine(name), own.target, base=own.base, **_search(name), workers=1)
    found = flexopt.certify(chosen, gap=1e-2).to_dict()
    return {"proven": found["verdict"] == "proven"} | {key: found[key] for key in ("value", "scale")}


@case("select_stand", SUBJECTS)
def select_stand(name: str) -> Any:
    own = SUBJECTS[name]
    given = _present(name) | _search(name) | _objective(name, "V")
    return answer(flexopt.select_stand(machine(name), [own.target, own.second_target], **given, workers=1).to_dict())


@case("plan_base", SUBJECTS)
def plan_base(name: str) -> Any:
    own = SUBJECTS[name]
    given = _present(name) | _search(name) | _objective(name, "V")
    targets = [own.target, own.second_target]
    return answer(flexopt.plan_base(machine(name), targets, **given, duration=10.0, workers=1).to_dict())


@case("solve_problem", PROBLEMS)
def solve_problem(name: str) -> Any:
    return answer(flexopt.solve_problem(problem(name), workers=1).to_dict())


@case("nullspace_trajectory", SUBJECTS)
def nullspace_trajectory(name: str) -> Any:
    document = flexopt.nullspace_trajectory(**at(name), duration=0.2, rate=50.0).to_dict()
    return {key: document[key] for key in document if key not in ("initial", "final")}


# --- decisions --------------------------------------------------------------------------------------------------------

# Of a place in a verdict.
OF_PLACE = [
    "base",
    "posture",
    "w",
    "drive",
    "turn",
    "decay",
    "stable_share",
    "slowest_hz",
    "drift",
    "rests_off",
    "allowed_gain",
    "delay_margin",
    "settling",
    "swing",
]


def decision(document: Mapping[str, Any]) -> dict[str, Any]:
    """A decision: whether to move, whereto, and the measures of the places that were compared."""
    places = document["places"]
    return {
        "moves": document["word"] == "move",
        "stays": document["word"] == "stay",
        "judged": document["judged"],
        "members": document["members"],
        "present_off": document["present_off"],
        "places": [{key: place[key] for key in OF_PLACE} for place in places],
        "settings": document["settings"],
    }


@case("verdict", PROBLEMS)
def verdict(name: str) -> Any:
    return decision(flexopt.verdict(problem(name), members=2, runs=0).to_dict())


@case("verdict", ["excavator", "boom-stick-bucket"], name="verdict_runs")
def verdict_runs(name: str) -> Any:
    own = SUBJECTS[name]
    document = flexopt.verdict(
        machine(name), own.target, **_present(name), starts=1, loop={}, members=2, runs=1, duration=1.0
    ).to_dict()
    runs = [
        {key: place["runs"][key] for key in ("settling", "turn", "converging")}
        for place in document["places"]
        if place["runs"]
    ]
    return decision(document) | {"runs": runs}


@case("report", ["article", "trench"])
def report(name: str) -> Any:
    document = flexopt.report(
        problem(name), loop={}, simulation={"duration": 0.5}, points=3, members=2, runs=0
    ).to_dict()
    found = {key: document[key] for key in ("mode_shares", "simulation", "gains")}
    found["loops"] = numbers(document["loops"], drop=("gradient",))
    found["selection"] = answer(document["selection"])
    return found | ({"verdict": decision(document["verdict"])} if document["verdict"] else {})


@case("explore", SUBJECTS)
def explore(name: str) -> Any:
    return _page(flexopt.explore(machine(name), SUBJECTS[name].posture, base=SUBJECTS[name].base))


@case("explore", ["article"], name="explore_problem")
def explore_problem(name: str) -> Any:
    return _page(flexopt.explore(problem(name)))


def _page(explorer: Any) -> Any:
    """The numbers that the page computes with."""
    found = re.search(r"^const DATA = (\{.*\});$", explorer.page, re.MULTILINE)
    assert found is not None
    return numbers(json.loads(found[1]), drop=("meshes", "palettes")) | {
        "configurations": explorer.to_dict()["configurations"]
    }


# --- runs -------------------------------------------------------------------------------------------------------------


def runs(name: str) -> dict[str, Any]:
    """A short run of a machine under a torque loop that suits its masses."""
    gains = {
        "excavator": (1e5, 2e3),
        "boom-stick-bucket": (1e6, 2e5),
        "slewing-excavator": (1e6, 2e5),
        "truck-crane": (1e5, 2e4),
        "mobile-manipulator": (2e3, 2e2),
    }[name]
    offset = [1e-3] * len(SUBJECTS[name].posture)
    return at(name) | {"kp": gains[0], "kv": gains[1], "offset": offset, "duration": 0.5, "rate": 200.0}


RUNS: dict[str, dict[str, Any]] = {
    "plain": {},
    "hold": {"hold": True, "feedback": "pid", "ki": 1e3, "integrator": "rk4", "substeps": 2},
    "faults": {
        "hold": True,
        "seed": 5,
        "sensor": {"noise": 1e-4, "delay": 0.01, "filter_hz": 30.0},
        "actuator": {"bandwidth_hz": 8.0, "dead_band": 1.0},
    },
    "gravity": {"gravity": True, "hold": True, "control": "transpose"},
}


def trajectory(found: Any) -> dict[str, Any]:
    """A run: its measures and its samples."""
    document = found.to_dict()
    measures = [
        "growth_rate",
        "growth_rate_error",
        "linear_growth_rate",
        "settling_time",
        "overshoot",
        "end_error",
        "peak_base_rotation",
        "residual_oscillation",
        "frequencies_hz",
    ]
    return (
        {key: document[key] for key in measures}
        | {
            "converges": document["verdict"] == "converges",
            "grows": document["verdict"] == "grows",
        }
        | {key: np.asarray(getattr(found, key)) for key in ("q", "error", "torque", "energy", "base")}
    )


@case("simulate", [*_pairs(PLANAR, RUNS), *_pairs(IN_SPACE, ["plain", "faults"])])
def simulate(subject: str) -> Any:
    name, _, variant = subject.partition(":")
    return trajectory(flexopt.simulate(**runs(name) | RUNS[variant]))


@case("simulate", SUBJECTS, name="simulate_loop")
def simulate_loop(name: str) -> Any:
    given = at(name) | {"offset": [1e-3] * len(SUBJECTS[name].posture), "duration": 0.5, "loop": {}}
    return trajectory(flexopt.simulate(**given))


@case("simulate_ensemble", SUBJECTS)
def simulate_ensemble(name: str) -> Any:
    given = runs(name) | {"duration": 0.2}
    kp = given["kp"]
    found = flexopt.simulate_ensemble(**given, vary={"kp": [0.5 * kp, kp, 2 * kp]}, threads=1)
    return numbers(found.to_dict()) | numbers(arrays(found.dataset))


@case("run_experiment", EXPERIMENTS)
def run_experiment(name: str) -> Any:
    return trajectory(flexopt.run_experiment(flexopt.load_experiment(name), duration=1.0))


def _linear(name: str) -> dict[str, Any]:
    return {key: value for key, value in runs(name).items() if key not in ("duration", "offset")} | {"hold": True}


@case("sampled_loop", SUBJECTS)
def sampled_loop(name: str) -> Any:
    found = flexopt.sampled_loop(**_linear(name))
    return found.to_dict() | {"moduli": np.sort(np.abs(found.multipliers))[::-1]}


@case("stability_border", SUBJECTS)
def stability_border(name: str) -> Any:
    return flexopt.stability_border(**_linear(name)).to_dict()


# --- identification ---------------------------------------------------------------------------------------------------


@case("identify", PLANAR)
def identify(name: str) -> Any:
    """A free swing of two modes, with noise."""
    own = SUBJECTS[name]
    frequencies = flexopt.evaluate(machine(name), own.posture, base=own.base).frequencies_hz
    t = np.arange(300) / 100
    rng = np.random.default_rng(1)
    swing = 0.01 * np.exp(-0.5 * t) * np.cos(2 * np.pi * 0.95 * frequencies[0] * t)
    log = {"t": t, "gyro_z": swing + 1e-5 * rng.standard_normal(t.size)}
    document = flexopt.identify(
        machine(name), log, posture=own.posture, base=own.base, unknown="base.*.rotation"
    ).to_dict()
    return {key: document[key] for key in ("converged", "values", "intervals", "factors", "modes", "columns")}


# --- studies ----------------------------------------------------------------------------------------------------------


@case("run_study open_study load_study", STUDIES)
def run_study(name: str) -> Any:
    """A shipped study on three values of each axis."""
    shipped = flexopt.load_study(name)
    axes = [axis.model_copy(update={"count": 3}) for axis in shipped.vary]
    return _study(shipped.model_copy(update={"vary": tuple(axes)}))


STUDIED: dict[str, dict[str, Any]] = {
    "measures": {"compute": "measures"},
    "outcome": {"compute": "outcome", "loop": {"rate": 100.0}},
}


@case("run_study open_study", _pairs(SUBJECTS, STUDIED), name="study")
def study(subject: str) -> Any:
    name, _, variant = subject.partition(":")
    own, joint = SUBJECTS[name], machine(name).joints[1]
    at_joint = own.posture[1]
    vary = [
        {"of": f"posture.{joint}", "value": [at_joint - 0.1, at_joint + 0.1], "count": 3},
        {"of": "stiffness", "factor": [0.5, 2.0], "count": 2},
    ]
    return _study(
        flexopt.Study(name="small", machine=name, vary=vary, posture=own.posture, base=own.base, **STUDIED[variant])
    )


def _study(study: Any) -> Any:
    flexopt.run_study(study, "study", workers=1)
    found = flexopt.open_study("study")
    document = found.to_dict()
    return {key: document[key] for key in ("points", "done", "complete", "statuses")} | arrays(found.dataset())


# --- export -----------------------------------------------------------------------------------------------------------


@case("export_c", SUBJECTS)
def export_c(name: str) -> Any:
    """The numbers of the bundle's vectors: inputs, outputs and allowed errors of every function."""
    flexopt.export_c(**at(name), folder="bundle", loop={})
    text = "".join(path.read_text(encoding="utf-8") for path in Path("bundle/test").glob("*_vectors.h"))
    found = re.findall(r"(\w+)_vectors\[\d+\] = \{([^}]*)\}", text)
    return {
        function: [float(word) for word in body.replace("\n", " ").split(",") if word.strip()]
        for function, body in found
    }


@case("export_fmu", ["excavator", "slewing-excavator"])
def export_fmu(name: str) -> Any:
    """The run that lies beside the FMU for comparison."""
    report = flexopt.export_fmu(path="small.fmu", **runs(name) | {"duration": 0.1}, hold=True)
    lines = Path(report.reference).read_text(encoding="utf-8").splitlines()
    columns = [word.strip('"') for word in lines[0].split(",")]
    table = np.array([[float(word) for word in line.split(",")] for line in lines[1:]])
    return {"period": report.period, "run": dict(zip(columns, table.T, strict=True))}


# --- any linear plant -------------------------------------------------------------------------------------------------

SYSTEM = (
    np.array([[-0.1, 2.0, 0.0], [-2.0, -0.1, 0.3], [0.0, 0.0, -1.5]]),
    np.array([[0.0], [1.0], [0.5]]),
    np.array([[1.0, 0.0, 0.2]]),
    np.zeros((1, 1)),
)
OTHER = (SYSTEM[0] * 1.1, *SYSTEM[1:])
DISCRETE = (np.array([[0.9, 0.2], [-0.1, 1.02]]), np.array([[0.0], [0.1]]), np.array([[1.0, 0.0]]), np.zeros((1, 1)))


@case("robust_margin", ["continuous", "discrete"])
def robust_margin(which: str) -> Any:
    system, dt = (SYSTEM, 0.0) if which == "continuous" else (DISCRETE, 0.05)
    document = flexopt.robust_margin(*system, dt=dt).to_dict()
    return {key: document[key] for key in ("epsilon_max", "X", "Z", "condition")}


@case("optimal_controller ncf_margin", ["continuous"])
def optimal_controller(_: str) -> Any:
    """The controller's frequency response, which no change of its states alters, and the margin that it attains."""
    controller = flexopt.optimal_controller(*SYSTEM)
    return {
        "response": controller.at([0.1j, 1j, 2j, 10j]),
        "margin": flexopt.ncf_margin(SYSTEM, controller),
        "margin_of_gain": flexopt.ncf_margin(SYSTEM, 0.3),
    }


@case("gap nu_gap", ["continuous"])
def gap(_: str) -> Any:
    return {"gap": flexopt.gap(SYSTEM, OTHER), "nu_gap": flexopt.nu_gap(SYSTEM, OTHER)}


# Public functions that no call covers, each with its reason.
EXEMPT = {
    "verify_bundle": "runs compilers of this machine for a minute; tests/export compares its numbers with Python's"
}
