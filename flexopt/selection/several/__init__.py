"""Several configurations chosen together: one placement for many targets, a way of the base along a path of targets.

In: a machine and targets. Out: `Stand` and `BasePlan`, whose every configuration is checked like a selection's.
"""

from flexopt.selection.several.plan import plan_base as plan_base
from flexopt.selection.several.results import BasePlan as BasePlan
from flexopt.selection.several.results import FixedPlacement as FixedPlacement
from flexopt.selection.several.results import Stand as Stand
from flexopt.selection.several.results import TargetConfiguration as TargetConfiguration
from flexopt.selection.several.stand import select_stand as select_stand
