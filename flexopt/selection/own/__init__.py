"""Objectives and constraints of the user's own: Functions of what is computed anyway, and their derivatives.

In: a `casadi.Function` whose inputs are named by quantities. Out: it as a Function of placement, posture and
parameters, with exact slopes and second derivatives, and how it pulls at every w_i, whose kinks it inherits.
"""

from flexopt.selection.own.graphs import OwnGraphs as OwnGraphs
from flexopt.selection.own.graphs import OwnTerm as OwnTerm
from flexopt.selection.own.quantities import known_quantities as known_quantities
from flexopt.selection.own.reading import own_faults as own_faults
from flexopt.selection.own.reading import weights_of as weights_of
