"""Choosing a configuration: a nonlinear program over placement and posture, its starts, its solutions, their proof.

In: a machine and a target for the end-point. Out: a `Selection` of verified local optima, ranked, or an error that says
what stands in the way; or a `BaseTrajectory` from where the machine stands. Several targets: a `Stand` or a `BasePlan`.
"""

from flexopt.selection.build import build_selection as build_selection
from flexopt.selection.certificate import Certificate as Certificate
from flexopt.selection.certificate import certify as certify
from flexopt.selection.nullspace.base_trajectory import BaseTrajectory as BaseTrajectory
from flexopt.selection.nullspace.trajectory import nullspace_trajectory as nullspace_trajectory
from flexopt.selection.problem import SelectionProblem as SelectionProblem
from flexopt.selection.problem_file import solve_problem as solve_problem
from flexopt.selection.result import Candidate as Candidate
from flexopt.selection.result import Selection as Selection
from flexopt.selection.several import BasePlan as BasePlan
from flexopt.selection.several import Stand as Stand
from flexopt.selection.several import plan_base as plan_base
from flexopt.selection.several import select_stand as select_stand
from flexopt.selection.solve import select as select
from flexopt.selection.solve import solve_selection as solve_selection
