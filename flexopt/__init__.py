"""flexopt: configurations of machines on a compliant base in which end-point feedback does not excite the base."""

from flexopt.errors import FlexoptError as FlexoptError
from flexopt.errors import FlexoptWarning as FlexoptWarning
from flexopt.errors import InputError as InputError
from flexopt.errors import ModelError as ModelError
from flexopt.errors import NoSolutionFound as NoSolutionFound
from flexopt.errors import SingularPosture as SingularPosture
from flexopt.errors import UnreachableTarget as UnreachableTarget
from flexopt.model import Machine as Machine
from flexopt.model import Problem as Problem
from flexopt.model import load as load
from flexopt.model import load_problem as load_problem
from flexopt.model import machine_from_dict as machine_from_dict
from flexopt.plant import Plant as Plant
from flexopt.plant import build_plant as build_plant
from flexopt.plant import inverse_kinematics as inverse_kinematics
from flexopt.robustness import Evaluation as Evaluation
from flexopt.robustness import Measures as Measures
from flexopt.robustness import build_measures as build_measures
from flexopt.robustness import evaluate as evaluate
from flexopt.selection import Candidate as Candidate
from flexopt.selection import Selection as Selection
from flexopt.selection import SelectionProblem as SelectionProblem
from flexopt.selection import build_selection as build_selection
from flexopt.selection import select as select
from flexopt.selection import solve_problem as solve_problem
from flexopt.selection import solve_selection as solve_selection
