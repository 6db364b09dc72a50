"""One good call of every public function, constructor and method: small, so that all of them run in seconds.

`FUNCTIONS` has an entry for each function of `flexopt.__all__`, `CONSTRUCTORS` for each class that users make objects
of, `OBJECTS` an object of every other class; `METHODS` the arguments of methods that need some.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

import flexopt
from flexopt.model.hydraulics import Cylinder

POSTURE, TARGET = [1.0, -2.0], [0.0, 1.6]
LOOP = {"kp": 1e4, "kv": 1e3, "duration": 0.5, "rate": 100.0}
STATE_SPACE = {"A": [[-1.0, 1.0], [0.0, -2.0]], "B": [[0.0], [1.0]], "C": [[1.0, 0.0]], "D": [[0.0]], "dt": 0.0}
PLANTS = tuple(np.array(STATE_SPACE[name]) for name in "ABCD")


@cache
def excavator() -> flexopt.Machine | flexopt.Tree:
    return flexopt.load("excavator")


@cache
def hydraulic() -> flexopt.Machine | flexopt.Tree:
    """A machine with cylinders."""
    return flexopt.load("boom-stick-bucket")


@cache
def tree() -> flexopt.Machine | flexopt.Tree:
    """A machine in space, with cylinders."""
    return flexopt.load("slewing-excavator")


@cache
def selection() -> flexopt.Selection:
    return flexopt.select(excavator(), TARGET, starts=1, workers=1)


@cache
def problem() -> flexopt.Problem:
    data = {"name": "small", "machine": "excavator", "target": {"end_point": TARGET}, "selection": {"starts": 1}}
    return flexopt.Problem(**data).with_machine(excavator())


@cache
def experiment() -> flexopt.Experiment:
    simulation = {"posture": POSTURE, **LOOP}
    return flexopt.Experiment(name="small", machine="excavator", simulation=simulation).with_machine(excavator())


@cache
def trajectory() -> flexopt.Trajectory:
    return flexopt.simulate(excavator(), POSTURE, **LOOP)


@cache
def workspace() -> flexopt.WorkspaceMap:
    return flexopt.map_workspace(excavator(), points=(4, 4), epsilon_max=False, threads=1)


@cache
def study() -> flexopt.Study:
    """Four points."""
    vary = [{"of": "posture.boom", "value": [0.5, 1.0], "count": 4}]
    return flexopt.Study(name="small", machine="excavator", compute="measures", vary=vary, posture=POSTURE)


@cache
def atlas() -> flexopt.Atlas:
    return flexopt.atlas(excavator(), x_range=(0.5, 1.5), y_range=(-2.0, -1.0), cells=(8, 8), threads=1)


@cache
def swing() -> dict[str, Any]:
    """A log of one oscillation that decays."""
    t = np.arange(200) / 100
    noise = 1e-5 * np.random.default_rng(1).standard_normal(t.size)
    return {"t": t, "gyro_z": 0.01 * np.exp(-0.5 * t) * np.cos(12 * t) + noise}


@cache
def identification() -> flexopt.Identification:
    return flexopt.identify(excavator(), swing(), posture=POSTURE, unknown="base.*.rotation")


@cache
def state_space() -> flexopt.StateSpace:
    return flexopt.StateSpace(**STATE_SPACE)


@cache
def report() -> flexopt.Report:
    """Of a base with one passive coordinate: a page is a picture for each mode and more."""
    data = excavator().to_dict()
    data["base"] = {name: value for name, value in data["base"].items() if name != "damping"}
    data["base"]["stiffness"] = {"rotation": data["base"]["stiffness"]["rotation"]}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return flexopt.report(problem().with_machine(flexopt.machine_from_dict(data)), points=3, simulation=LOOP)


@cache
def verdict() -> flexopt.Verdict:
    return flexopt.verdict(excavator(), TARGET, base=0.0, loop={"kp": 1e4, "kv": 1e3}, starts=1, members=2, runs=0)


def _machine(**given: Any) -> dict[str, Any]:
    return {"machine": excavator(), **given}


SELECT = {
    "objective": "V",
    "control": "inverse",
    "weights": [1.0, 0.0, 0.0],
    "gravity": False,
    "base": 0.0,
    "posture": POSTURE,
    "base_range": (-4.0, 4.0),
    "constraints": {"joint_margin": 0.01},
    "singularity_margin_deg": 10.0,
    "starts": 1,
    "seed": 0,
    "assume": "ground,limits",
    "options": flexopt.SelectionOptions(seed=1),
}
RUN = {"workers": 1, "progress": print}
SIMULATE = {
    "end_point": None,
    "elbow": None,
    "base": 0.0,
    "control": "inverse",
    "feedback": "pid",
    "kp": 1e4,
    "kv": [1e3, 1e3],
    "ki": 1.0,
    "integral_limit": 1e6,
    "gain": 5e5,
    "offset": [0.01, -0.01],
    "duration": 0.02,
    "rate": 100.0,
    "hold": True,
    "integrator": "rk4",
    "substeps": 2,
    "gravity": False,
    "gravity_compensation": True,
    "nullspace_damping": 0.0,
    "sensor": {"noise": 0.0},
    "actuator": {"torque_limit": 1e6},
    "base_path": {"times": [0, 1], "points": [[0.0], [0.1]]},
    "target_path": None,
    "seed": 0,
    "baked": False,
    "options": flexopt.SimulationOptions(hold=True),
}

# Name -> arguments; None stands for an argument that is left out, of which another takes the place.
FUNCTIONS: dict[str, Callable[[], dict[str, Any]]] = {
    "atlas": lambda: _machine(
        control="inverse",
        gravity=False,
        joints=["boom", "stick"],
        posture=None,
        base=0.0,
        x_range=(0.5, 1.5),
        y_range=(-2.0, -1.0),
        cells=(8, 8),
        threads=1,
    ),
    "build_hydraulics": _machine,
    "build_measures": lambda: _machine(control="inverse", gravity=False),
    "build_plant": _machine,
    "certify": lambda: {"selection": selection(), "gap": 1e-5},
    "build_selection": lambda: _machine(target=TARGET, gain=5e5, elbow="up", slack=1e-6, **SELECT),
    "check": lambda: {"machine_or_path": excavator()},
    "evaluate": lambda: _machine(
        posture=POSTURE, base=0.0, control="inverse", gain=5e5, damped=False, gravity=False, loop={"kp": 1e4, "kv": 1e3}
    ),
    "evaluate_w": lambda: {
        "measures": flexopt.build_measures(excavator()),
        "bases": [0.0],
        "postures": [[1.0, 1.1], [-2.0, -1.9]],
        "threads": 1,
        "gradient": False,
    },
    "explore": lambda: {
        "machine_or_problem": excavator(),
        "posture": POSTURE,
        "base": 0.0,
        "control": "inverse",
        "gravity": False,
        "loop": {"kp": 1e4, "kv": 1e3},
        "target": None,
        "progress": print,
    },
    "explain": lambda: _machine(
        posture=POSTURE, base=0.0, control="inverse", gravity=False, loop={"kp": 1e4, "kv": 1e3}
    ),
    "export_c": lambda: _machine(
        folder="bundle",
        parts=["kinematics"],
        real="double",
        control="inverse",
        gain=5e5,
        baked=False,
        singularity_margin_deg=1.0,
        limit_allowance_deg=1.0,
        limit_allowance_m=0.01,
        prefix="small",
        overwrite=True,
        loop={"kp": 1e4, "kv": 1e3},
        posture=POSTURE,
        base=0.0,
    ),
    "export_fmu": lambda: _machine(
        loop=None,
        path="small.fmu",
        posture=POSTURE,
        version="2.0",
        kind="co-simulation",
        overwrite=True,
        **SIMULATE | {"seed": None, "baked": None},
    ),
    "gap": lambda: {"P1": PLANTS, "P2": PLANTS},
    "identify": lambda: _machine(
        log=swing(),
        posture=POSTURE,
        base=0.0,
        unknown="base.*.rotation",
        gravity=False,
        window=[0.0, 2.0],
        imu=[0.0, 0.0],
        progress=print,
    ),
    "inverse_kinematics": lambda: _machine(target=TARGET, base=0.5, gravity=False, elbow="up", seed=0),
    "load": lambda: {"name_or_path": "excavator"},
    "load_experiment": lambda: {"name_or_path": "article-a"},
    "load_problem": lambda: {"name_or_path": "article"},
    "load_study": lambda: {"name_or_path": "excavator-study"},
    "load_robot": lambda: {"path": "truck-crane.toml"},
    "machine_from_dict": lambda: {"data": excavator().to_dict(), "origin": "here"},
    "map_loop": lambda: _machine(
        posture=POSTURE,
        vary={"kp": (1e3, 1e5), "dead_time": (0.0, 0.02)},
        base=0.0,
        control="inverse",
        gravity=False,
        loop={"kp": 1e4, "kv": 1e3},
        points=(3, 3),
        threads=1,
        progress=print,
    ),
    "map_workspace": lambda: _machine(
        control="inverse",
        gain=5e5,
        gravity=False,
        over="posture",
        joints=["boom", "stick"],
        rows=None,
        coordinates=None,
        posture=None,
        end_point=None,
        base=0.0,
        x_range=(0.5, 1.0),
        y_range=(-2.0, -1.0),
        points=(3, 3),
        elbow="up",
        measures=True,
        epsilon_max=False,
        loop=None,
        threads=1,
        progress=print,
    ),
    "schema": lambda: {"kind": "machine"},
    "ncf_margin": lambda: {"P": PLANTS, "K": 0.1, "sign": -1},
    "nu_gap": lambda: {"P1": PLANTS, "P2": PLANTS},
    "nullspace_trajectory": lambda: _machine(
        posture=POSTURE,
        base=0.0,
        objective="V",
        weights=[1.0, 0.0, 0.0],
        control="inverse",
        gain=5e5,
        gravity=False,
        step_gain=1.0,
        metric=[1.0, 1.0, 1.0],
        rate=100.0,
        max_base_rate=0.25,
        max_turn_rate=0.25,
        max_joint_rate=1.0,
        max_base_acceleration=1.0,
        base_range=(-1.0, 1.0),
        singularity_margin_deg=10.0,
        min_gain=1e-9,
        duration=0.05,
        on_descent="stop",
    ),
    "open_study": lambda: {"folder": flexopt.run_study(study(), "opened", workers=1).folder},
    "optimal_controller": lambda: STATE_SPACE,
    "outcome": lambda: _machine(
        posture=POSTURE, base=0.0, control="inverse", gravity=False, loop={"kp": 1e4, "kv": 1e3}
    ),
    "plan_base": lambda: _machine(
        path=[[0.0, 1.6], [0.1, 1.6]],
        times=[0.0, 5.0],
        duration=None,
        max_base_rate=0.5,
        max_joint_rate=[1.0, 1.0],
        start=None,
        **SELECT | {"objective": "decay", "weights": None},
        loop={"kp": 1e4, "kv": 1e3},
        ranges={"stiffness": [0.5, 2.0]},
        **RUN,
    ),
    "report": lambda: {
        "problem": problem(),
        "experiment": experiment(),
        "simulation": {"duration": 0.1},
        "loop": {"kp": 1e4, "kv": 1e3},
        "ranges": {"stiffness": [0.5, 2.0]},
        "points": 3,
        "members": 2,
        "runs": 1,
        "progress": print,
    },
    "robust_margin": lambda: STATE_SPACE,
    "run_experiment": lambda: {"experiment": experiment(), "loop": None, "overrides": {"duration": 0.02}},
    "run_study": lambda: {
        "study": study(),
        "folder": "study",
        "executor": ThreadPoolExecutor(1),
        "workers": 1,
        "progress": print,
    },
    "sampled_loop": lambda: _machine(posture=POSTURE, **SIMULATE),
    "select": lambda: _machine(
        target=TARGET,
        gain=5e5,
        elbow="up",
        slack=1e-6,
        **SELECT | {"objective": "decay", "weights": None},
        loop={"kp": 1e4, "kv": 1e3},
        ranges={"stiffness": [0.5, 2.0]},
        **RUN,
    ),
    "select_stand": lambda: _machine(
        targets=[TARGET, [0.1, 1.6]],
        combine="worst",
        shares=None,
        **SELECT | {"objective": "decay", "weights": None},
        loop={"kp": 1e4, "kv": 1e3},
        ranges={"stiffness": [0.5, 2.0]},
        **RUN,
    ),
    "sensitivity": lambda: _machine(
        posture=POSTURE,
        base=0.0,
        control="inverse",
        gravity=False,
        loop={"kp": 1e4, "kv": 1e3},
        ranges={"stiffness": [0.5, 2.0]},
        samples=64,
        seed=0,
    ),
    "simulate": lambda: _machine(posture=POSTURE, loop=None, **SIMULATE),
    "simulate_ensemble": lambda: _machine(
        posture=POSTURE, vary={"kp": [1e4, 2e4]}, keep="measures", threads=1, progress=print, loop=None, **SIMULATE
    ),
    "solve_problem": lambda: {"problem": problem(), **RUN},
    "solve_selection": lambda: {"problem": selection().problem, **RUN},
    "stability_border": lambda: _machine(posture=POSTURE, ratio=0.01, **SIMULATE),
    "stable_region": lambda: _machine(
        posture=POSTURE,
        base=0.0,
        control="inverse",
        gravity=False,
        loop={"kp": 1e4, "kv": 1e3},
        ranges={"stiffness": [0.5, 2.0]},
        points=2,
        boxes=1,
        progress=print,
    ),
    "tree_from_dict": lambda: {"data": tree().to_dict(), "origin": "here"},
    "verdict": lambda: {
        "problem": excavator(),
        "target": TARGET,
        **SELECT,
        "base": [0.0],
        "gain": 5e5,
        "elbow": "up",
        "slack": 1e-6,
        "progress": print,
        "loop": {"kp": 1e4, "kv": 1e3},
        "ranges": {"stiffness": [0.5, 2.0]},
        "members": 2,
        "runs": 1,
        "duration": 0.1,
    },
    "verify_bundle": lambda: {
        "folder": "bundle",
        "inputs": 1,
        "progress": print,
    },
}

# Their good calls take minutes, or a browser; they run in the tests of their own rooms.
LONG = ("verify_bundle", "Report.to_pdf", "Verdict.to_pdf")

CONSTRUCTORS: dict[str, Callable[[], dict[str, Any]]] = {
    "Actuator": lambda: {
        "torque_limit": 1e4,
        "dead_band": 1.0,
        "bandwidth_hz": 5.0,
        "rate_limit": 1e5,
        "levers": None,
        "servo_gain": 1.0,
    },
    "Constraint": lambda: {"function": _own(), "lower": 0.0, "upper": 1.0, "unit": "rad", "name": "mine"},
    "Experiment": lambda: {
        "schema": 1,
        "name": "small",
        "description": "",
        "source": "",
        "machine": "excavator",
        "simulation": {"posture": POSTURE},
        "loop": {"kp": 1e4, "kv": 1e3},
        "nullspace": None,
    },
    "Hydraulics": lambda: {"plant": flexopt.build_plant(hydraulic())},
    "Loop": lambda: {
        "control": "inverse",
        "feedback": "pid",
        "kp": 1e4,
        "kv": [1e3, 1e3],
        "ki": 10.0,
        "kp_range": [1.0, 1e6],
        "kv_range": [1.0, 1e6],
        "rate": 100.0,
        "dead_time": 0.0131,
        "filter_hz": 20.0,
        "bandwidth_hz": 5.0,
        "drive": "velocity",
        "servo_gain": 1e4,
        "torque_limit": 1e4,
        "rate_limit": 1e5,
        "nullspace_damping": 0.0,
    },
    "Machine": lambda: (
        {
            "schema": 1,
            "description": "",
            "source": "",
            "gravity": 9.81,
            "capsules": (),
            "cylinders": (),
            "loop": {"rate": 100.0},
            "uncertainty": [{"of": "payload.mass", "value": [0.0, 10.0]}],
            "payload": {"mass": 0.0},
            "support": None,
        }
        | excavator().to_dict()
    ),
    "Measures": lambda: {"plant": flexopt.build_plant(excavator()), "control": "inverse", "gravity": False},
    "Path": lambda: {"times": [0.0, 1.0], "points": [[0.0], [1.0]]},
    "Plant": lambda: {"machine": excavator(), "graph": flexopt.build_plant(excavator()).graph},
    "Problem": lambda: {
        "schema": 1,
        "name": "small",
        "description": "",
        "source": "",
        "machine": "excavator",
        "target": {"end_point": TARGET},
        "motion": None,
        "selection": {"starts": 1},
        "constraints": None,
        "loop": {"rate": 100.0},
        "uncertainty": [{"of": "payload.mass", "value": [0.0, 10.0]}],
    },
    "Uncertainty": lambda: {"of": "stiffness", "factor": [0.5, 2.0], "value": None},
    "SelectionOptions": lambda: (
        {key: value for key, value in SELECT.items() if key not in ("constraints", "options")}
        | {"base": [0.0], "gain": 5e5, "elbow": "up", "slack": 1e-6, "combine": "worst", "shares": [1.0]}
    ),
    "SimulationOptions": lambda: (
        {key: value for key, value in SIMULATE.items() if key != "options"} | {"posture": POSTURE}
    ),
    "Sensor": lambda: {
        "noise": 0.0,
        "rate_noise": 0.0,
        "resolution": 0.0,
        "rate_resolution": 0.0,
        "delay": 0.0,
        "filter_hz": 20.0,
    },
    "StateSpace": lambda: STATE_SPACE,
    "Study": lambda: {
        "schema": 1,
        "name": "small",
        "description": "",
        "source": "",
        "machine": "excavator",
        "problem": None,
        "experiment": None,
        "compute": "outcome",
        "quantities": ["decay"],
        "vary": [{"of": "kp", "value": [1e3, 1e4]}],
        "points": "sobol",
        "count": 4,
        "seed": 0,
        "chunk": 2,
        "posture": POSTURE,
        "base": [0.0],
        "control": "inverse",
        "gravity": False,
        "gain": 5e5,
        "loop": {"kv": 1e3},
    },
    "Vary": lambda: {"of": "stiffness", "value": None, "factor": [0.5, 2.0], "count": 3, "scale": "log"},
    "Tree": lambda: (
        {
            "schema": 1,
            "description": "",
            "source": "",
            "gravity": 9.81,
            "capsules": (),
            "cylinders": (),
            "loop": {"rate": 100.0},
            "uncertainty": [{"of": "payload.mass", "value": [0.0, 10.0]}],
            "stiffness_matrix": None,
            "damping_matrix": None,
            "payload": {"mass": 0.0},
            "support": None,
            "placement": ["x", "y", "yaw"],
            "visuals": (),
        }
        | tree().to_dict()
    ),
}

# An object of each class that has methods.
OBJECTS: dict[str, Callable[[], Any]] = {
    "Atlas": atlas,
    "BasePlan": lambda: flexopt.plan_base(excavator(), [[0.0, 1.6], [0.1, 1.6]], starts=1, workers=1),
    "BaseTrajectory": lambda: flexopt.nullspace_trajectory(excavator(), POSTURE, duration=0.05),
    "Candidate": lambda: selection().best,
    "Certificate": lambda: flexopt.certify(selection()),
    "Configuration": lambda: excavator().at(POSTURE),
    "Constraint": lambda: flexopt.Constraint(_own()),
    "Ensemble": lambda: flexopt.simulate_ensemble(excavator(), POSTURE, vary={"kp": [1e4, 2e4]}, threads=1, **LOOP),
    "Evaluation": lambda: flexopt.evaluate(excavator(), POSTURE),
    "Experiment": experiment,
    "Explorer": lambda: flexopt.explore(excavator(), POSTURE),
    "Explanation": lambda: flexopt.explain(excavator(), POSTURE),
    "ExportReport": lambda: flexopt.export_c(excavator(), "bundle", parts=["kinematics"], overwrite=True),
    "FmuReport": lambda: flexopt.export_fmu(excavator(), "small.fmu", POSTURE, **LOOP),
    "Hydraulics": lambda: flexopt.build_hydraulics(hydraulic()),
    "Identification": identification,
    "Machine": hydraulic,
    "Measures": lambda: flexopt.build_measures(excavator()),
    "Path": lambda: flexopt.Path(times=[0.0, 1.0], points=[[0.0], [1.0]]),
    "Plant": lambda: flexopt.build_plant(excavator()),
    "Problem": problem,
    "SelectionOptions": flexopt.SelectionOptions,
    "Report": report,
    "RobustMargin": lambda: flexopt.robust_margin(state_space()),
    "Selection": selection,
    "SelectionProblem": lambda: selection().problem,
    "Sensor": flexopt.Sensor,
    "Actuator": flexopt.Actuator,
    "Stand": lambda: flexopt.select_stand(excavator(), [TARGET, [0.1, 1.6]], starts=1, workers=1),
    "StateSpace": state_space,
    "Sensitivity": lambda: flexopt.sensitivity(excavator(), POSTURE, samples=64),
    "Study": study,
    "StudyResult": lambda: flexopt.run_study(study(), "result", workers=1),
    "Vary": lambda: flexopt.Vary(of="stiffness", factor=(0.5, 2.0)),
    "Trajectory": trajectory,
    "Tree": tree,
    "Verdict": verdict,
    "WorkspaceMap": workspace,
}


def _graph(name: str) -> ca.SX:
    return getattr(flexopt.build_plant(excavator()).graph, name)


def _z() -> list[float]:
    return selection().best.z.tolist()


def _objective() -> Any:
    return selection().problem.objective


def _own() -> ca.Function:
    posture = ca.MX.sym("posture", 2)
    return ca.Function("mine", [posture], [posture[0]], ["posture"], ["angle"])


def _pin() -> Cylinder:
    return hydraulic().cylinders[0]


PICTURE = {"ax": None, "size": (6.0, 5.0), "theme": "dark"}
METHODS: dict[str, Callable[[], dict[str, Any]]] = {
    "Atlas.plot": lambda: {"path": "atlas.png", **PICTURE},
    "Atlas.to_netcdf": lambda: {"path": "atlas.nc"},
    "BasePlan.plot": lambda: {"path": "plan.png", **PICTURE},
    "BaseTrajectory.plot": lambda: {"path": "base.png", **PICTURE},
    "Ensemble.plot": lambda: {"path": "ensemble.png", **PICTURE},
    "Ensemble.share": lambda: {"verdict": "converges"},
    "Ensemble.to_netcdf": lambda: {"path": "ensemble.nc"},
    "Experiment.with_machine": _machine,
    "Explorer.save": lambda: {"path": "page.html"},
    "Hydraulics.driven": lambda: {"saturation": "each"},
    "Hydraulics.lever_map": lambda: {"saturation": "each"},
    "Hydraulics.states": lambda: {
        "q": [0.0] * flexopt.build_plant(hydraulic()).n_coordinates,
        "base": [0.0] * len(hydraulic().base_coordinates),
    },
    "Explanation.plot": lambda: {"path": "why.png", **PICTURE},
    "Identification.plot": lambda: {"path": "identification.png", **PICTURE},
    "Machine.at": lambda: {
        "posture": (-1.0, -1.0, -0.5),
        "base": 0.0,
        "control": "inverse",
        "gravity": True,
        "loop": {"kp": 1e4},
    },
    "Machine.with_values": lambda: {"values": {"payload.mass": 10.0}},
    "Machine.beyond_stroke": lambda: {"joint": "boom", "q": 0.0},
    "Machine.joint_frame": lambda: {"joint": "boom"},
    "Machine.travel": lambda: {"cylinder": _pin()},
    "Path.at": lambda: {"times": [0.0, 0.5]},
    "Plant.linearisation": lambda: {"control": "inverse", "gravity": False},
    "Plant.operating_point": lambda: {
        "base": _graph("base"),
        "posture": _graph("posture"),
        "p": _graph("p"),
        "deflection": None,
    },
    "Problem.with_machine": _machine,
    "Report.figures": lambda: {"theme": "dark"},
    "Report.mode_shares": lambda: {"stand": report().stands["chosen"]},
    "Report.to_pdf": lambda: {"path": "report.pdf"},
    "Report.write": lambda: {"folder": "report"},
    "Certificate.write_log": lambda: {"path": "log.json"},
    "Selection.plot": lambda: {"path": "selection.png", **PICTURE},
    "SelectionProblem.branches": lambda: {"objective": _objective(), "z": _z(), "exact": True},
    "SelectionProblem.factors": lambda: {"z": _z()},
    "SelectionProblem.given_up": lambda: {"best": 0.1},
    "SelectionProblem.own_values": lambda: {"z": _z()},
    "SelectionProblem.rows": lambda: {"z": _z()},
    "SelectionProblem.solver": lambda: {"quick": False},
    "SelectionProblem.travel_cost": lambda: {"objective": _objective(), "z": _z()},
    "SelectionProblem.wrapped": lambda: {"z": _z()},
    "Stand.plot": lambda: {"path": "stand.png", **PICTURE},
    "StateSpace.at": lambda: {"points": [1j, 2j]},
    "Sensitivity.plot": lambda: {"path": "sensitivity.png", **PICTURE},
    "Study.with_subject": lambda: {"subject": excavator()},
    "StudyResult.quantiles": lambda: {"quantity": "w", "shares": [0.5]},
    "StudyResult.reduce": lambda: {"quantity": "w", "how": "min", "over": ["posture.boom"]},
    "StudyResult.to_csv": lambda: {"path": "study.csv"},
    "StudyResult.to_netcdf": lambda: {"path": "study.nc"},
    "Trajectory.animate": lambda: {"path": "run.gif", "speed": 1.0, "magnify": 1.0, "theme": "dark"},
    "Trajectory.plot": lambda: {"path": "run.png", **PICTURE},
    "Trajectory.skeletons": lambda: {"q": trajectory().q[:2], "base": trajectory().base[:2]},
    "Trajectory.to_csv": lambda: {"path": "run.csv"},
    "Trajectory.to_netcdf": lambda: {"path": "run.nc"},
    "Tree.at": lambda: {
        "posture": (0.2, 0.5, -1.2, -0.5),
        "base": None,
        "control": "inverse",
        "gravity": True,
        "loop": {"kp": 1e4},
    },
    "Tree.with_values": lambda: {"values": {"payload.mass": 10.0}},
    "Tree.beyond_stroke": lambda: {"joint": tree().joints[0], "q": 0.0},
    "Tree.joint_frame": lambda: {"joint": tree().joints[0]},
    "Tree.travel": lambda: {"cylinder": tree().cylinders[0]},
    "Verdict.plot": lambda: {"path": "verdict.png", **PICTURE},
    "Verdict.to_html": lambda: {"path": "verdict.html"},
    "Verdict.to_pdf": lambda: {"path": "verdict.pdf"},
    "WorkspaceMap.array": lambda: {"name": "w"},
    "WorkspaceMap.fraction": lambda: {"mask": np.ones((4, 4), dtype=bool)},
    "WorkspaceMap.in_phase_fraction": lambda: {"modes": (1, 2), "strict": False},
    "WorkspaceMap.plot": lambda: {"path": "map.png", "marks": {"here": (0.0, 1.0)}, **PICTURE},
    "WorkspaceMap.to_netcdf": lambda: {"path": "map.nc"},
}
