"""flexopt: configurations of machines on a compliant base in which end-point feedback does not excite the base."""

from importlib import import_module
from typing import TYPE_CHECKING

from flexopt.errors import CompilerNotFound as CompilerNotFound
from flexopt.errors import ExportError as ExportError
from flexopt.errors import FlexoptError as FlexoptError
from flexopt.errors import FlexoptWarning as FlexoptWarning
from flexopt.errors import ImplausibleMachine as ImplausibleMachine
from flexopt.errors import InputError as InputError
from flexopt.errors import MarginNotComputed as MarginNotComputed
from flexopt.errors import ModelError as ModelError
from flexopt.errors import NoSolutionFound as NoSolutionFound
from flexopt.errors import NotStabilizable as NotStabilizable
from flexopt.errors import SingularPosture as SingularPosture
from flexopt.errors import StudyInterrupted as StudyInterrupted
from flexopt.errors import UnreachableTarget as UnreachableTarget
from flexopt.errors import WriteError as WriteError
from flexopt.errors import WrongSlope as WrongSlope
from flexopt.foundation.later import later as _later

if TYPE_CHECKING:
    from flexopt.coprime import RobustMargin as RobustMargin
    from flexopt.coprime import StateSpace as StateSpace
    from flexopt.coprime import gap as gap
    from flexopt.coprime import ncf_margin as ncf_margin
    from flexopt.coprime import nu_gap as nu_gap
    from flexopt.coprime import optimal_controller as optimal_controller
    from flexopt.coprime import robust_margin as robust_margin
    from flexopt.explorer import Explorer as Explorer
    from flexopt.explorer import explore as explore
    from flexopt.export import ExportReport as ExportReport
    from flexopt.export import Verification as Verification
    from flexopt.export import export_c as export_c
    from flexopt.export import verify_bundle as verify_bundle
    from flexopt.export.fmu import FmuReport as FmuReport
    from flexopt.export.fmu import export_fmu as export_fmu
    from flexopt.identification import Identification as Identification
    from flexopt.identification import identify as identify
    from flexopt.large_studies import StudyResult as StudyResult
    from flexopt.large_studies import open_study as open_study
    from flexopt.large_studies import run_study as run_study
    from flexopt.loop.certified.region import Region as Region
    from flexopt.loop.certified.region import stable_region as stable_region
    from flexopt.loop.evaluation import Outcome as Outcome
    from flexopt.loop.evaluation import outcome as outcome
    from flexopt.loop.sensitivity import Sensitivity as Sensitivity
    from flexopt.loop.sensitivity import sensitivity as sensitivity
    from flexopt.model import Machine as Machine
    from flexopt.model import Problem as Problem
    from flexopt.model import SelectionOptions as SelectionOptions
    from flexopt.model import Tree as Tree
    from flexopt.model import load as load
    from flexopt.model import load_experiment as load_experiment
    from flexopt.model import load_problem as load_problem
    from flexopt.model import machine_from_dict as machine_from_dict
    from flexopt.model import tree_from_dict as tree_from_dict
    from flexopt.model.configuration import Configuration as Configuration
    from flexopt.model.file_schema import schema as schema
    from flexopt.model.loop import Loop as Loop
    from flexopt.model.own import Constraint as Constraint
    from flexopt.model.robots import load_robot as load_robot
    from flexopt.model.simulation import Experiment as Experiment
    from flexopt.model.simulation import SimulationOptions as SimulationOptions
    from flexopt.model.study import Study as Study
    from flexopt.model.study import Vary as Vary
    from flexopt.model.study_file import load_study as load_study
    from flexopt.model.uncertainty import Uncertainty as Uncertainty
    from flexopt.plant import Hydraulics as Hydraulics
    from flexopt.plant import Plant as Plant
    from flexopt.plant import build_hydraulics as build_hydraulics
    from flexopt.plant import build_plant as build_plant
    from flexopt.plant import inverse_kinematics as inverse_kinematics
    from flexopt.robustness import Evaluation as Evaluation
    from flexopt.robustness import Measures as Measures
    from flexopt.robustness import build_measures as build_measures
    from flexopt.robustness import evaluate as evaluate
    from flexopt.robustness import evaluate_w as evaluate_w
    from flexopt.robustness.atlas import Atlas as Atlas
    from flexopt.selection import BasePlan as BasePlan
    from flexopt.selection import BaseTrajectory as BaseTrajectory
    from flexopt.selection import Candidate as Candidate
    from flexopt.selection import Certificate as Certificate
    from flexopt.selection import Selection as Selection
    from flexopt.selection import SelectionProblem as SelectionProblem
    from flexopt.selection import Stand as Stand
    from flexopt.selection import build_selection as build_selection
    from flexopt.selection import certify as certify
    from flexopt.selection import nullspace_trajectory as nullspace_trajectory
    from flexopt.selection import plan_base as plan_base
    from flexopt.selection import select as select
    from flexopt.selection import select_stand as select_stand
    from flexopt.selection import solve_problem as solve_problem
    from flexopt.selection import solve_selection as solve_selection
    from flexopt.selection.checking import Check as Check
    from flexopt.selection.checking import check as check
    from flexopt.simulation import Actuator as Actuator
    from flexopt.simulation import Ensemble as Ensemble
    from flexopt.simulation import Path as Path
    from flexopt.simulation import Sensor as Sensor
    from flexopt.simulation import Trajectory as Trajectory
    from flexopt.simulation import run_experiment as run_experiment
    from flexopt.simulation import sampled_loop as sampled_loop
    from flexopt.simulation import simulate as simulate
    from flexopt.simulation import simulate_ensemble as simulate_ensemble
    from flexopt.simulation import stability_border as stability_border
    from flexopt.study import Explanation as Explanation
    from flexopt.study import Report as Report
    from flexopt.study import Verdict as Verdict
    from flexopt.study import WorkspaceMap as WorkspaceMap
    from flexopt.study import atlas as atlas
    from flexopt.study import explain as explain
    from flexopt.study import map_loop as map_loop
    from flexopt.study import map_workspace as map_workspace
    from flexopt.study import report as report
    from flexopt.study import verdict as verdict

__version__ = "0.1.0"

__all__ = [
    "Actuator",
    "Atlas",
    "BasePlan",
    "BaseTrajectory",
    "Candidate",
    "Certificate",
    "Check",
    "CompilerNotFound",
    "Configuration",
    "Constraint",
    "Ensemble",
    "Evaluation",
    "Experiment",
    "Explanation",
    "Explorer",
    "ExportError",
    "ExportReport",
    "FlexoptError",
    "FlexoptWarning",
    "FmuReport",
    "Hydraulics",
    "Identification",
    "ImplausibleMachine",
    "InputError",
    "Loop",
    "Machine",
    "MarginNotComputed",
    "Measures",
    "ModelError",
    "NoSolutionFound",
    "NotStabilizable",
    "Outcome",
    "Path",
    "Plant",
    "Problem",
    "Region",
    "Report",
    "RobustMargin",
    "Selection",
    "SelectionOptions",
    "SelectionProblem",
    "Sensitivity",
    "Sensor",
    "SimulationOptions",
    "SingularPosture",
    "Stand",
    "StateSpace",
    "Study",
    "StudyInterrupted",
    "StudyResult",
    "Trajectory",
    "Tree",
    "Uncertainty",
    "UnreachableTarget",
    "Vary",
    "Verdict",
    "Verification",
    "WorkspaceMap",
    "WriteError",
    "WrongSlope",
    "atlas",
    "build_hydraulics",
    "build_measures",
    "build_plant",
    "build_selection",
    "certify",
    "check",
    "evaluate",
    "evaluate_w",
    "explain",
    "explore",
    "export_c",
    "export_fmu",
    "gap",
    "identify",
    "inverse_kinematics",
    "load",
    "load_experiment",
    "load_problem",
    "load_robot",
    "load_study",
    "machine_from_dict",
    "map_loop",
    "map_workspace",
    "ncf_margin",
    "nu_gap",
    "nullspace_trajectory",
    "open_study",
    "optimal_controller",
    "outcome",
    "plan_base",
    "report",
    "robust_margin",
    "run_experiment",
    "run_study",
    "sampled_loop",
    "schema",
    "select",
    "select_stand",
    "sensitivity",
    "simulate",
    "simulate_ensemble",
    "solve_problem",
    "solve_selection",
    "stability_border",
    "stable_region",
    "tree_from_dict",
    "verdict",
    "verify_bundle",
]

# What is imported when first asked for, by module: an import that needs nothing else takes milliseconds.
_LATER = {
    "coprime": "RobustMargin StateSpace gap ncf_margin nu_gap optimal_controller robust_margin",
    "explorer": "Explorer explore",
    "export": "ExportReport Verification export_c verify_bundle",
    "export.fmu": "FmuReport export_fmu",
    "identification": "Identification identify",
    "large_studies": "StudyResult open_study run_study",
    "loop.evaluation": "Outcome outcome",
    "loop.certified.region": "Region stable_region",
    "loop.sensitivity": "Sensitivity sensitivity",
    "model": (
        "Machine Problem SelectionOptions Tree load load_experiment load_problem machine_from_dict tree_from_dict"
    ),
    "model.configuration": "Configuration",
    "model.file_schema": "schema",
    "model.loop": "Loop",
    "model.own": "Constraint",
    "model.robots": "load_robot",
    "model.simulation": "Experiment SimulationOptions",
    "model.study": "Study Vary",
    "model.study_file": "load_study",
    "model.uncertainty": "Uncertainty",
    "plant": "Hydraulics Plant build_hydraulics build_plant inverse_kinematics",
    "robustness": "Evaluation Measures build_measures evaluate evaluate_w",
    "robustness.atlas": "Atlas",
    "selection": (
        "BasePlan BaseTrajectory Candidate Certificate Selection SelectionProblem Stand build_selection "
        "certify nullspace_trajectory plan_base select select_stand solve_problem solve_selection"
    ),
    "selection.checking": "Check check",
    "simulation": (
        "Actuator Ensemble Path Sensor Trajectory run_experiment sampled_loop simulate simulate_ensemble "
        "stability_border"
    ),
    "study": "Explanation Verdict Report WorkspaceMap atlas explain map_loop map_workspace report verdict",
}
_ROOMS = {module.partition(".")[0] for module in _LATER}
_named = _later(__name__, **_LATER)


def __getattr__(name: str) -> object:
    """A public name, or a room, imported when it is first asked for."""
    return import_module(f"flexopt.{name}") if name in _ROOMS else _named(name)


def __dir__() -> list[str]:
    dunders = {name for name in globals() if name.startswith("__")}
    return sorted({*dunders, *_ROOMS, *__all__})
