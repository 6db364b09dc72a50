"""What the pages show and the tests ask of: every public name by topic, and the methods that users call."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any

import flexopt

# Names by topic, a call before the class of its result.
TOPICS: dict[str, tuple[str, str]] = {
    "machines": (
        "Machines and files",
        "load load_robot load_problem load_experiment machine_from_dict tree_from_dict check Check schema Machine Tree "
        "Problem Experiment Loop Uncertainty",
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
        "MarginNotComputed WrongSlope StudyInterrupted ExportError WriteError FlexoptWarning ImplausibleMachine",
    ),
}
# What classes of flexopt's own ask of each other: no user calls it.
PLUMBING = frozenset({
    "build_tree", "document", "document_keys", "model_post_init", "parameter_entries", "part_faults", "shortly",
    "structural_faults",
})  # fmt: skip


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
