"""Machines, problems and experiments as validated data.

In: TOML files or dictionaries. Out: frozen `Machine`, `Tree`, `Problem` and `Experiment` objects, or one `ModelError`
that lists every fault. Nothing symbolic.
"""

from typing import TYPE_CHECKING

from flexopt.foundation.later import later
from flexopt.model import boundary as boundary
from flexopt.model.files import shipped_names as shipped_names
from flexopt.model.machine import AnyMachine as AnyMachine
from flexopt.model.machine import Parameter as Parameter
from flexopt.model.planar import Machine as Machine
from flexopt.model.reading import load as load
from flexopt.model.reading import load_any as load_any
from flexopt.model.reading import load_experiment as load_experiment
from flexopt.model.reading import load_file as load_file
from flexopt.model.reading import load_problem as load_problem
from flexopt.model.reading import load_simulated as load_simulated
from flexopt.model.reading import machine_from_dict as machine_from_dict
from flexopt.model.tables import Capsule as Capsule
from flexopt.model.tree import Tree as Tree
from flexopt.model.tree import tree_from_dict as tree_from_dict

if TYPE_CHECKING:
    from flexopt.model.problem import Problem as Problem
    from flexopt.model.problem import SelectionOptions as SelectionOptions

__getattr__ = later(__name__, problem="Problem SelectionOptions")
