"""What a configuration must keep besides the target: rows of a nonlinear program as graphs, a module for each kind.

In: a plant and validated `Constraints`. Out: a `ConstraintSet`: names, units, bounds, scales and one Function.
"""

from flexopt.selection.constraints.building import KINDS as KINDS
from flexopt.selection.constraints.building import ConstraintSet as ConstraintSet
from flexopt.selection.constraints.building import build_constraints as build_constraints
from flexopt.selection.constraints.building import constraint_faults as constraint_faults
from flexopt.selection.constraints.building import constraint_labels as constraint_labels
