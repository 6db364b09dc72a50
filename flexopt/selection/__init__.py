"""Choosing a configuration: a nonlinear program over placement and posture, its starts, its solutions, their proof.

In: a machine and a target for the end-point. Out: a `Selection` of verified local optima, ranked, or an error that says
what stands in the way; or a `BaseTrajectory` from where the machine stands.
"""

from flexopt.selection.base_trajectory import BaseTrajectory as BaseTrajectory
from flexopt.selection.nullspace import nullspace_trajectory as nullspace_trajectory
from flexopt.selection.problem import SelectionProblem as SelectionProblem
from flexopt.selection.problem import build_selection as build_selection
from flexopt.selection.result import Candidate as Candidate
from flexopt.selection.result import Selection as Selection
from flexopt.selection.solve import select as select
from flexopt.selection.solve import solve_problem as solve_problem
from flexopt.selection.solve import solve_selection as solve_selection
