"""What the pages show and the tests ask of: every public name by topic, and the methods that users call."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from importlib import import_module
from typing import Any, Literal, get_args, get_origin

import flexopt
from flexopt.foundation.offered import PLUMBING

# Names by topic, a call before the class of its result.
TOPICS: dict[str, tuple[str, str]] = {
    "machines": (
        "Machines and files",
        "load load_robot load_problem load_experiment machine_from_dict tree_from_dict check Check schema Machine Tree "
        "Configuration Problem Experiment Loop Uncertainty",
    ),
    "plant": ("The plant", "build_plant Plant inverse_kinematics build_hydraulics Hydraulics"),
    "measures": (
        "Measures of a posture",
        "evaluate Evaluation explain Explanation build_measures Measures evaluate_w atlas Atlas map_workspace map_loop "
        "WorkspaceMap",
    ),
    "loops": (
        "What the controller does",
        "outcome Outcome stable_region Region sampled_loop stability_border verdict Verdict",
    ),
    "selection": (
        "Choosing a configuration",
        "select Selection Candidate SelectionOptions Constraint build_selection SelectionProblem solve_selection "
        "solve_problem certify Certificate select_stand Stand plan_base BasePlan nullspace_trajectory BaseTrajectory "
        "report Report explore Explorer",
    ),
    "studies": (
        "Large studies and sensitivity",
        "Study Vary load_study run_study StudyResult open_study sensitivity Sensitivity",
    ),
    "simulation": (
        "Simulation and identification",
        "simulate Trajectory SimulationOptions Sensor Actuator Path run_experiment simulate_ensemble Ensemble identify "
        "Identification",
    ),
    "export": ("C and FMU", "export_c ExportReport verify_bundle Verification export_fmu FmuReport"),
    "plants": (
        "Margins of any linear plant",
        "robust_margin RobustMargin optimal_controller ncf_margin gap nu_gap StateSpace",
    ),
    "errors": (
        "Errors and warnings",
        "FlexoptError InputError ModelError UnreachableTarget SingularPosture NotStabilizable NoSolutionFound "
        "MarginNotComputed WrongSlope StudyInterrupted ExportError WriteError FlexoptWarning ImplausibleMachine "
        "CompilerNotFound",
    ),
}

# Names of types in signatures of calls, and what each takes; words of a few come from the type itself.
TYPES: dict[str, tuple[str, str]] = {
    "AnyMachine": ("flexopt.model", "A `flexopt.Machine` or a `flexopt.Tree`, as `flexopt.load` gives them."),
    "ArrayLike": ("flexopt.foundation.arrays", "A number, a list or tuple of numbers, or a NumPy array of them."),
    "MatrixLike": ("flexopt.foundation.arrays", "As `ArrayLike`, or rows of numbers."),
    "ComplexLike": ("flexopt.foundation.arrays", "Complex numbers: one, a list, or an array."),
    "MaskLike": ("flexopt.foundation.arrays", "True and false, a row for each row of a map."),
    "PostureLike": ("flexopt.foundation.arrays", "Actuated joints (n,), rad or m: `[0.99, -2.63]`, or an array."),
    "BaseLike": ("flexopt.foundation.arrays", "Placement (n_b,), m or rad; one number where there is one coordinate."),
    "TargetLike": ("flexopt.foundation.arrays", "A number for each row of the task (n_task,), m, inertial frame."),
    "TargetsLike": ("flexopt.foundation.arrays", "Several of these, (K, n_task)."),
    "GainLike": ("flexopt.foundation.arrays", "One number, or one for each row of the task."),
    "RangeLike": ("flexopt.foundation.arrays", "(lower, upper)."),
    "BaseRangeLike": ("flexopt.foundation.arrays", "(lower, upper) of x, or of some placement coordinates by name."),
    "PointsLike": ("flexopt.foundation.arrays", "Two whole numbers, along x and along y."),
    "TableLike": ("flexopt.foundation.arrays", "A dictionary in the layout of a file's table."),
    "Document": ("flexopt.foundation.arrays", "A dictionary of plain data, as JSON has it."),
    "Progress": ("flexopt.foundation.arrays", "A function of two numbers: how much is done, how much there is."),
    "Vector": ("flexopt.foundation.arrays", "A NumPy array of double precision; its shape is told with its name."),
    "LoopLike": ("flexopt.model.loop", 'A `flexopt.Loop`, a dictionary of its keys, or `"default"`.'),
    "RangesLike": (
        "flexopt.model.uncertainty",
        "What is uncertain: names with their (lower, upper), or a list of `flexopt.Uncertainty`.",
    ),
    "ObjectiveLike": (
        "flexopt.model.own",
        'Words such as `"w1"` or `"w1,epsilon_max"`, a `casadi.Function`, or a list of both in order.',
    ),
    "AnyConstraints": (
        "flexopt.model.constraints",
        "A dictionary in the layout of `[constraints]`, or a list of that, Functions and `flexopt.Constraint`.",
    ),
    "SystemLike": (
        "flexopt.coprime.system",
        "A `flexopt.StateSpace`, a system of python-control or SciPy, matrices (A, B, C) to (A, B, C, D, dt), a gain.",
    ),
    "FrameLike": ("flexopt.identification.log", "A data frame: columns by name."),
    "Control": ("flexopt.foundation.control", '`"inverse"`, `"transpose"` or `"damped:LAMBDA"`.'),
    "Size": ("flexopt.foundation.pictures", '`"screen"`, `"paper"`, `"slide"`, or (width, height), in.'),
    "Theme": ("flexopt.foundation.palette", "Ground of a picture."),
    "Elbow": ("flexopt.model.choices", "Branch of a planar arm."),
    "Feedback": ("flexopt.model.simulation", "Law of the controller."),
    "IntegrationMethod": ("flexopt.model.simulation", "Integrator."),
    "FileKind": ("flexopt.model.file_schema", "Kind of file."),
    "Real": ("flexopt.export.kernels", "Numbers of the C code."),
    "Version": ("flexopt.export.fmu.source", "Of FMI."),
    "FmuKind": ("flexopt.export.fmu.interface", "Of FMU."),
    "Keep": ("flexopt.simulation.members", "What an ensemble keeps."),
    "Over": ("flexopt.study.maps.grid", "What varies over a map."),
    "LoopVerdict": ("flexopt.simulation.verdict", "What a loop does."),
    "Saturation": ("flexopt.plant.hydraulics", "How what exceeds full lever is cut."),
    "TargetKind": ("flexopt.model.targets", "Key of a problem's `[target]`."),
    "OnDescent": ("flexopt.selection.nullspace.trajectory", "What to do before a step that descends."),
}


def words(name: str) -> tuple[str, ...]:
    """Those that a type of `TYPES` consists of; none where it is no choice of words."""
    kind = getattr(import_module(TYPES[name][0]), name)
    return get_args(kind) if get_origin(kind) is Literal else ()


def names(topic: str) -> list[str]:
    """The names of a topic, in the order of its page."""
    return TOPICS[topic][1].split()


def methods(owner: type) -> Iterator[tuple[str, Any]]:
    """Methods that users call: flexopt's own, by the class that defines them (`Class.method`)."""
    for base in owner.__mro__:
        if not base.__module__.startswith("flexopt"):
            continue
        for name, member in vars(base).items():
            function = member.__func__ if isinstance(member, classmethod | staticmethod) else member
            if inspect.isfunction(function) and not name.startswith("_") and name not in PLUMBING:
                yield f"{base.__name__}.{name}", inspect.unwrap(function)


def documented() -> dict[str, Any]:
    """Every public function, class and method that users call, by name; what is inherited once."""
    found: dict[str, Any] = {}
    for name in flexopt.__all__:
        public = getattr(flexopt, name)
        found[name] = inspect.unwrap(public) if inspect.isfunction(public) else public
        if inspect.isclass(public):
            found |= dict(methods(public))
    return found
