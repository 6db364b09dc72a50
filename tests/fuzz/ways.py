"""Calls of the Python API and commands, for each kind of mutated file.

A way gets the `Input` and returns a result, which is then shown and described as users do, or for a command its words.
Sizes are small, so that thousands of inputs take minutes; a file that asks for a long computation is only checked.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from random import Random
from typing import Any

import flexopt
from tests.boundary import calls, walk
from tests.boundary.bad_values import BAD
from tests.fuzz import material, mutations


@dataclass
class Input:
    """A mutated input: the file's path as it is given, what else is drawn, and how many bytes the files have."""

    rng: Random
    path: str = ""
    size: int = 0


@dataclass(frozen=True)
class Command:
    """Words of a command; judged by exit code and streams."""

    words: Sequence[str]
    process: bool = False


class PageRunsScript(Exception):
    """A page holds a script that a name brought in."""


Way = Callable[[Input], Any]


def posture_of(machine: Any) -> list[float]:
    """Some posture of any arm."""
    return [0.5, -1.0, 0.7, -0.4, 0.3, 0.2, -0.2, 0.1][: len(machine.joints)]


def _of_machine(call: Callable[[Any], Any]) -> Way:
    return lambda given: call(flexopt.load(given.path))


def _page(written: Any) -> Any:
    """A page that was written, in which no name is code."""
    for path in Path.cwd().rglob("*.html"):
        if "<script>FUZZ" in path.read_text(encoding="utf-8", errors="replace"):
            raise PageRunsScript(path.name)
    return written


def _explored(machine: Any) -> Any:
    return _page(flexopt.explore(machine).save("page.html"))


def _targets(machine: Any) -> list[float]:
    return [1.5, 1.6, 0.8][: len(machine.task_rows)]


def _selected(machine: Any) -> Any:
    """In space a choice takes a minute without a compiler; there it is only set up."""
    if isinstance(machine, flexopt.Machine):
        return flexopt.select(machine, _targets(machine), starts=1, workers=1)
    flexopt.build_selection(machine, _targets(machine))
    return None


LOOP: dict[str, Any] = {"kp": 1e4, "kv": 1e3}
RANGES = {"stiffness": [0.5, 2.0]}
MACHINE: dict[str, tuple[float, Way]] = {
    "check": (4, lambda given: flexopt.check(given.path)),
    "evaluate": (4, _of_machine(lambda m: flexopt.evaluate(m, posture_of(m)))),
    "again": (1, _of_machine(lambda m: (flexopt.machine_from_dict if isinstance(m, flexopt.Machine) else flexopt.tree_from_dict)(m.to_dict()))),
    "evaluate --gravity": (0.7, _of_machine(lambda m: flexopt.evaluate(m, posture_of(m), gravity=True))),
    "evaluate --damped": (0.7, _of_machine(lambda m: flexopt.evaluate(m, posture_of(m), damped=True))),
    "evaluate --loop": (0.7, _of_machine(lambda m: flexopt.evaluate(m, posture_of(m), loop=LOOP))),
    "outcome": (0.5, _of_machine(lambda m: flexopt.outcome(m, posture_of(m), loop=LOOP))),
    "outcome --gravity": (0.3, _of_machine(lambda m: flexopt.outcome(m, posture_of(m), loop=LOOP, gravity=True))),
    "simulate": (0.6, _of_machine(lambda m: flexopt.simulate(m, posture_of(m), duration=0.05, **LOOP))),
    "simulate --gravity": (0.3, _of_machine(lambda m: flexopt.simulate(m, posture_of(m), duration=0.05, gravity=True, **LOOP))),
    "explain": (0.5, _of_machine(lambda m: flexopt.explain(m, posture_of(m)))),
    "explore": (0.5, _of_machine(_explored)),
    "inverse": (0.5, _of_machine(lambda m: flexopt.inverse_kinematics(m, _targets(m)))),
    "select": (0.2, _of_machine(_selected)),
    "export": (0.15, _of_machine(lambda m: flexopt.export_c(m, "out", parts=["kinematics"]))),
    "fmu": (0.15, _of_machine(lambda m: flexopt.export_fmu(m, "out.fmu", posture=posture_of(m), duration=0.02))),
    "map": (0.2, _of_machine(lambda m: flexopt.map_workspace(m, over="posture", posture=posture_of(m), points=(2, 2), threads=1))),
    "atlas": (0.2, _of_machine(lambda m: flexopt.atlas(m, cells=(4, 4), posture=posture_of(m), threads=1))),
    "sensitivity": (0.1, _of_machine(lambda m: flexopt.sensitivity(m, posture_of(m), loop=LOOP, ranges=RANGES, samples=64))),
    "region": (0.02, _of_machine(lambda m: flexopt.stable_region(m, posture_of(m), loop=LOOP, ranges=RANGES, points=2, boxes=1))),
    "law": (0.1, _of_machine(lambda m: flexopt.nullspace_trajectory(m, posture_of(m), duration=0.05))),
}  # fmt: skip


def _words(*words: str, weight: float = 1) -> tuple[float, Way]:
    """A command; `@` is the mutated file, `~` a posture as long as its arm, mostly."""

    def of(given: Input) -> Command:
        posture = ",".join(map(str, [0.5, -1.0, 0.7, -0.4][: given.rng.choice((2, 2, 3, 4))]))
        found = [{"@": given.path, "~": posture}.get(word, word) for word in words]
        if given.rng.random() < 0.4:
            found.append("--json")
        return Command(found, process=given.rng.random() < 0.01)

    return weight, of


MACHINE_COMMANDS = {
    "check": _words("check", "@", weight=4),
    "evaluate": _words("evaluate", "@", "--posture", "~", weight=4),
    "evaluate --loop": _words("evaluate", "@", "--posture", "~", "--loop", "kp=1e4", "--loop", "kv=1e3", weight=0.5),
    "explore": _words("explore", "@", "--out", "page.html", weight=0.4),
    "simulate": _words("simulate", "@", "--posture", "~", "--duration", "0.05", weight=0.4),
    "explain": _words("explain", "@", "--posture", "~", weight=0.3),
    "select": _words("select", "@", "--end-point", "0,1.6", "--starts", "1", "--workers", "1", weight=0.1),
    "plot": _words("explain", "@", "--posture", "~", "--plot", "why.png", weight=0.05),
    "export": _words("export", "@", "--parts", "kinematics", "--out", "out", weight=0.1),
}
ROBOT = MACHINE | {"robot": (2, lambda given: flexopt.load_robot(given.path))}
# Of a robot file the machine file beside it names it.
BESIDE: dict[str, tuple[float, Way]] = {
    name: (weight, lambda given, way=way: way(Input(given.rng, "main.toml"))) for name, (weight, way) in ROBOT.items()
}
ROBOT_FILE: dict[str, tuple[float, Way]] = BESIDE | {
    "check": (2, lambda given: flexopt.check(given.path)),
}
ROBOT_COMMANDS = {
    name: (weight, lambda given, way=way: way(Input(given.rng, "main.toml")))
    for name, (weight, way) in MACHINE_COMMANDS.items()
} | {
    "check": _words("check", "@", weight=2),
    "new": _words("new", "--from", "@", "--out", "new.toml", "--yes", weight=2),
}


def _solved(given: Input) -> Any:
    problem = flexopt.load_problem(given.path)
    options = problem.selection.model_dump(exclude_unset=True) | {"starts": 1}
    quick = isinstance(problem.machine, str) and problem.machine == "excavator" and problem.target.end_point is not None
    if not quick or problem.selection.objective in flexopt.selection.outcomes.measures.MEASURES:
        return problem
    again = problem.model_copy(update={"selection": type(problem.selection)(**options)})
    return flexopt.solve_problem(again, workers=1)


def _ran(given: Input) -> Any:
    experiment = flexopt.load_experiment(given.path)
    return flexopt.run_experiment(experiment, overrides={"duration": 0.05, "rate": 200.0, "substeps": 1})


def _studied(given: Input) -> Any:
    study = flexopt.load_study(given.path)
    total = 1
    for axis in study.vary:
        total *= axis.count or 1
    small = study.compute == "measures" and (study.count or total) <= 20
    return flexopt.run_study(study, "out", workers=1) if small else study


def _opened(given: Input) -> Any:
    result = flexopt.open_study("study")
    way = given.rng.randrange(5)
    if way == 0:
        return result.dataset()
    if way == 1:
        return result.to_csv("out.csv")
    if way == 2:
        return result.to_netcdf("out.nc")
    if way == 3:
        return result.reduce("mean")
    return result


def _continued(given: Input) -> Any:
    study = flexopt.Study(**tomllib.loads(material.STUDY))
    return flexopt.run_study(study, "study", workers=1)


def _cached(given: Input) -> Any:
    """The cache's own reading, of every key that is there."""
    storage = import_module("flexopt.compiled.storage")
    os.environ["FLEXOPT_CACHE"] = str(Path("cache").resolve())
    found: list[Any] = []
    for path in sorted(Path("cache").iterdir()) if Path("cache").is_dir() else []:
        key = path.stem.partition("-")[0]
        found += [storage.recall(path.stem), storage.find(key, path.suffix)]
    return len(found)


# A good call of verify, which is small; its arguments as options of the command.
VERIFY = calls.FUNCTIONS["verify_bundle"]()
VERIFY_WORDS = [
    word
    for name, value in VERIFY.items()
    if name not in ("folder", "progress")
    for word in (f"--{name.replace('_', '-')}", str(value))
]


def _verified(given: Input) -> Any:
    return flexopt.verify_bundle(**{name: value for name, value in VERIFY.items() if name != "progress"})


def _argument(given: Input) -> Any:
    """A public call with one argument that nobody should pass, or a good one's mutation."""
    rng = given.rng
    call = rng.choice(_quick_calls())
    named = [case for case in walk.cases(call) if not case[0].startswith("progress")]
    name, others, put = rng.choice(named)
    if rng.random() < 0.3:
        bad = BAD[rng.choice(list(BAD))]()
    else:
        bad = mutations.structure(rng, call.good().get(name.partition(".")[0]))
    return walk.run(call, {**others, **put(bad)})


def _quick_calls() -> list[walk.Call]:
    return [call for call in walk.calls() if call.name in QUICK]


# Of the public calls those that end within a second.
QUICK = {
    "build_hydraulics", "build_measures", "build_plant", "check", "evaluate", "evaluate_w", "explain", "gap", "load",
    "load_experiment", "load_problem", "load_robot", "load_study", "machine_from_dict", "inverse_kinematics", "ncf_margin",
    "nu_gap", "optimal_controller", "outcome", "robust_margin", "sampled_loop", "schema", "simulate", "tree_from_dict",
    "nullspace_trajectory", "Actuator", "Constraint", "Experiment", "Hydraulics", "Loop", "Machine", "Measures", "Path",
    "Problem", "Uncertainty", "SelectionOptions", "SimulationOptions", "Sensor", "StateSpace", "Study", "Vary", "Tree",
    "identify", "atlas", "export_fmu", "build_selection",
}  # fmt: skip


MACHINES = ("excavator", "boom-stick-bucket", "slewing-excavator", "truck-crane", "mobile-manipulator")


def _numbers(given: Input) -> Any:
    """A computation with arguments drawn over all orders of magnitude, most of them allowed."""
    rng = given.rng
    machine = flexopt.load(rng.choice(MACHINES))

    def wide(low: float, high: float) -> float:
        return 10 ** rng.uniform(low, high)

    posture = [rng.choice((rng.uniform(-3.2, 3.2), 0.0, rng.uniform(-1, 1), 1e-9)) for _ in machine.joints]
    base = [rng.choice((0.0, rng.uniform(-10, 10), wide(-9, 6))) for _ in machine.base_coordinates]
    loop: dict[str, Any] = {"kp": wide(-3, 9), "kv": wide(-3, 9)}
    further = {
        "rate": wide(0, 4), "dead_time": rng.choice((0.0, wide(-7, 0))), "ki": wide(-3, 9), "feedback": rng.choice(("pd", "pid")),
        "filter_hz": wide(-2, 4), "bandwidth_hz": wide(-2, 4), "drive": rng.choice(("torque", "velocity")), "servo_gain": wide(-3, 9),
        "torque_limit": wide(-6, 9), "rate_limit": wide(-6, 9), "nullspace_damping": rng.choice((0.0, wide(-6, 9))),
        "control": rng.choice(("inverse", "transpose", f"damped:{wide(-9, 6)}")),
    }  # fmt: skip
    loop |= {key: value for key, value in further.items() if rng.random() < 0.3}
    where: dict[str, Any] = {"base": base, "gravity": rng.random() < 0.3}
    ranges = {rng.choice(("stiffness", "damping", "payload.mass", "dead_time")): sorted((wide(-6, 3), wide(-6, 3)))}
    run = {
        key: loop[key] for key in ("kp", "kv", "rate", "ki", "feedback", "nullspace_damping", "control") if key in loop
    }
    run |= {"substeps": rng.choice((1, 5)), "integrator": rng.choice(("rk4", "dop853", "gauss")), "duration": 0.05}
    calls_: dict[str, Callable[[], Any]] = {
        "evaluate": lambda: flexopt.evaluate(machine, posture, damped=rng.random() < 0.5, gain=wide(-6, 12), **where),
        "loop": lambda: flexopt.evaluate(machine, posture, loop=loop, **where),
        "outcome": lambda: flexopt.outcome(machine, posture, loop=loop, **where),
        "explain": lambda: flexopt.explain(machine, posture, loop=loop, **where),
        "simulate": lambda: flexopt.simulate(machine, posture, **where, **(run | {"rate": min(run.get("rate", 200.0), 2000.0)})),
        "sensitivity": lambda: flexopt.sensitivity(machine, posture, loop=loop, ranges=ranges, samples=64, **where),
        "region": lambda: flexopt.stable_region(machine, posture, loop=loop, ranges=ranges, points=2, boxes=1, **where),
        "border": lambda: flexopt.sampled_loop(machine, posture, **where, **run),
        "map": lambda: flexopt.map_loop(machine, posture, vary={"kp": (1e-3, wide(0, 9)), "dead_time": (0.0, wide(-4, 0))},
                                        loop=loop, points=(2, 2), threads=1, **where),
    }  # fmt: skip
    if not isinstance(machine, flexopt.Machine):
        del calls_["region"]  # what it proves of a machine in space takes a minute
    return calls_[rng.choice(list(calls_))]()


def _dictionary(given: Input) -> Any:
    """Tables of a machine, a problem, an experiment or a study from Python, with a mutation or two."""
    rng = given.rng
    makers: dict[str, tuple[Callable[..., Any], Callable[[], Any]]] = {
        "machine": (flexopt.machine_from_dict, lambda: calls.excavator().to_dict()),
        "tree": (flexopt.tree_from_dict, lambda: calls.tree().to_dict()),
        "problem": (
            lambda data: flexopt.Problem(**data),
            lambda: tomllib.loads(material.PROBLEM),
        ),
        "study": (
            lambda data: flexopt.Study(**data),
            lambda: tomllib.loads(material.STUDY),
        ),
        "loop": (lambda data: flexopt.Loop(**data), calls.CONSTRUCTORS["Loop"]),
    }
    make, good = makers[rng.choice(list(makers))]
    data = good()
    for _ in range(rng.choice((1, 1, 2, 3))):
        data = mutations.structure(rng, data)
    if isinstance(data, dict) and data and rng.random() < 0.2:
        data[rng.choice(list(data))] = BAD[rng.choice(list(BAD))]()
    if make is not makers["machine"][0] and make is not makers["tree"][0]:
        data = {str(key): inner for key, inner in data.items()} if isinstance(data, dict) else {}
    made = make(data)
    return flexopt.evaluate(made, posture_of(made)) if isinstance(made, flexopt.Machine | flexopt.Tree) else made


COMMANDS = (
    "evaluate excavator --posture 0.9929,-2.6306 --base 0.5 --gain 5e5 --control inverse --json",
    "evaluate excavator --end-point 0,1.6 --elbow up --base 0 --loop kp=1e4 --loop kv=1e3",
    "evaluate truck-crane --posture 0.3,0.4,-1.2,0.5 --control damped:0.1 --base 0,0,0",
    "check excavator --json",
    "explain excavator --posture 0.9929,-2.6306 --base 0 --out why.json",
    "simulate excavator --posture 1,-2 --duration 0.05 --rate 200 --kp 1e4 --kv 1e3 --offset 0.05,-0.05 --integrator rk4",
    "simulate excavator --posture 1,-2 --duration 0.05 --sensor noise=1e-3 --actuator bandwidth_hz=5 --substeps 2 --seed 3",
    "explore excavator --posture 1,-2 --base 0 --out page.html",
    "export excavator --parts kinematics --real double --prefix small --out out --singularity-margin-deg 1",
    "export excavator --fmu out.fmu --posture 1,-2 --fmi 2.0 --kind co-simulation --duration 0.02",
    "select excavator --end-point 0,1.6 --starts 1 --workers 1 --base-range -4,4 --objective V --weights 1,0,0 --seed 1",
    "schema machine", "completion bash", "study status none --json", "compare a.json b.json --json",
    "new new.toml --yes --name digger --links 2 --lengths 1,1 --masses 10,10 --gives x,y,rotation --frequency 2 --ratio 0.02",
    "sensitivity excavator --posture 1,-2 --loop kp=1e4 --loop kv=1e3 --ranges stiffness=0.5,2 --samples 64",
    "map excavator --points 2,2 --x-range 0.5,1 --over posture --joints boom,stick --out map.nc",
    "atlas excavator --cells 4,4 --joints boom,stick --x-range 0.5,1.5 --y-range -2,-1 --json",
    "identify excavator log.csv --posture 1,-2 --unknown stiffness --window 0,2 --imu 0,0",
)  # fmt: skip


def _told(given: Input) -> Command:
    """A command with one word changed."""
    rng = given.rng
    words = rng.choice(COMMANDS).split()
    k = rng.randrange(len(words))
    way = rng.randrange(6)
    if way == 0:
        del words[k]
    elif way == 1:
        words.insert(k, rng.choice((*words, *mutations.NAMES)))
    elif way == 2:
        words[k] = rng.choice((*mutations.NAMES, *mutations.NUMBER_WORDS))
    else:
        numbered = [i for i, word in enumerate(words) if mutations.NUMBER.search(word)]
        k = rng.choice(numbered) if numbered else k
        words[k] = mutations.words(rng, words[k])
    # The system gives a program no NUL and no word longer than this.
    return Command([word.replace("\0", "")[:100_000] for word in words] or ["--help"], process=rng.random() < 0.01)


def _process(given: Input) -> Command:
    return Command(["simulate", "excavator", "--posture", "1,-2", "--duration", "0.02"], process=True)


def _raw(given: Input) -> Any:
    raise ZeroDivisionError("planted")


def _hang(given: Input) -> Any:
    while True:
        pass


def _hog(given: Input) -> Any:
    return [b"x" * 2**24 for _ in range(256)]  # 4 GB at most, should nobody watch


def _killed(given: Input) -> Any:
    os.abort()


def _checked_proof(given: Input) -> Any:
    """The checker of certificates, as a program of its own."""
    return import_module("flexopt.selection.certificate.check").main([given.path])


def _compared(given: Input) -> Any:
    return import_module("flexopt.study.comparison").compare_saved([given.path, "other.json"])


def _fmu(given: Input) -> Any:
    return flexopt.export_fmu(calls.excavator(), given.path, posture=calls.POSTURE, duration=0.02)


def _identified(given: Input) -> Any:
    return flexopt.identify(
        calls.excavator(), given.path, unknown="base.*.rotation", posture=given.rng.choice((None, calls.POSTURE))
    )


Ways = dict[str, tuple[float, Way]]


@dataclass(frozen=True)
class Kind:
    """A kind of input: how often, how many of its files may be mutated, and what is done with it."""

    share: float
    files: str
    api: Ways
    shell: Ways


KINDS: dict[str, Kind] = {
    "machine": Kind(16, "main.toml", MACHINE, MACHINE_COMMANDS),
    "overlay": Kind(9, "main.toml", MACHINE, MACHINE_COMMANDS | {"select": (0, MACHINE_COMMANDS["select"][1])}),
    "urdf": Kind(9, "main.urdf", ROBOT_FILE, ROBOT_COMMANDS),
    "mjcf": Kind(11, "main.xml", ROBOT_FILE, ROBOT_COMMANDS),
    "problem": Kind(
        9, "main.toml",
        {"check": (4, lambda given: flexopt.check(given.path)), "load": (2, lambda given: flexopt.load_problem(given.path)), "solve": (2, _solved)},
        {"check": _words("check", "@", weight=4)},
    ),
    "experiment": Kind(
        5, "main.toml", {"check": (2, lambda given: flexopt.check(given.path)), "run": (3, _ran)},
        {"check": _words("check", "@", weight=2), "simulate": _words("simulate", "@", "--duration", "0.05", "--rate", "200", weight=2)},
    ),
    "study": Kind(
        5, "main.toml", {"check": (2, lambda given: flexopt.check(given.path)), "run": (2, _studied)},
        {"check": _words("check", "@", weight=2)},
    ),
    "folder": Kind(
        5, "study/**/*", {"open": (4, _opened), "go on": (0.4, _continued)},
        {"status": _words("study", "status", "study", weight=2), "export": _words("study", "export", "study", "--out", "out.csv")},
    ),
    "log": Kind(
        5, "main.csv", {"identify": (1, _identified)},
        {"identify": _words("identify", "excavator", "@", "--posture", "1,-2", "--unknown", "base.*.rotation")},
    ),
    "saved": Kind(
        5, "main.json", {"compare": (1, _compared)},
        {"compare": _words("compare", "@", "other.json", weight=4), "plot": _words("compare", "@", "other.json", "--plot", "a.png", weight=0.2)},
    ),
    "proof": Kind(4, "main.json", {"check": (1, _checked_proof)}, {"check": _words("check", "@")}),
    "bundle": Kind(
        3, "bundle/**/*", {"verify": (1, _verified)},
        {"verify": _words("verify", "bundle", *VERIFY_WORDS)},
    ),
    "fmu": Kind(
        2, "main.fmu", {"export": (1, _fmu)},
        {"export": _words("export", "excavator", "--fmu", "@", "--posture", "1,-2", "--duration", "0.02")},
    ),
    "mesh": Kind(3, "main.*", {"explore": (1, lambda given: _explored(flexopt.load("main.toml")))}, {"explore": _words("explore", "main.toml")}),
    "cache": Kind(1, "cache/*", {"read": (1, _cached)}, {"simulate": (0.15, _process)}),
    "arguments": Kind(18, "", {"call": (1, _argument), "numbers": (1.2, _numbers), "dictionary": (1, _dictionary)}, {"command": (1, _told)}),
}  # fmt: skip
# Faults that the fuzzer must find; never drawn.
PLANTED: dict[str, Kind] = {
    "planted-raw": Kind(0, "", {"raw": (1, _raw)}, {}),
    "planted-hang": Kind(0, "", {"hang": (1, _hang)}, {}),
    "planted-hog": Kind(0, "", {"hog": (1, _hog)}, {}),
    "planted-abort": Kind(0, "", {"abort": (1, _killed)}, {}),
    "planted-warning": Kind(
        0, "", {"warning": (1, lambda given: warnings.warn("planted", RuntimeWarning, stacklevel=1))}, {}
    ),
}


def in_a_process(words: Sequence[str]) -> tuple[int, str, str]:
    """A command as a shell runs it: its exit code and streams."""
    done = subprocess.run(
        [sys.executable, "-c", "from flexopt.cli import main; main()", *words],
        env=os.environ | {"PYTHONIOENCODING": "utf-8", "FLEXOPT_COMPILE": "1"}, capture_output=True, check=False,
        stdin=subprocess.DEVNULL, encoding="utf-8", errors="replace",
    )  # fmt: skip
    return done.returncode, done.stdout, done.stderr
